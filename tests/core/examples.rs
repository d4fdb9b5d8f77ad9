//! The examples of the library do what they say.

#[path = "../../examples/georeference.rs"]
#[allow(dead_code)] // its `main` reads the arguments
mod georeference;
#[path = "../../examples/own_profile.rs"]
#[allow(dead_code)] // its `main` prints
mod own_profile;

#[test]
fn an_image_is_georeferenced() {
    let folder = tempfile::tempdir().expect("a folder");
    let [image, list, out] = georeference::sample(folder.path());
    let said = georeference::run(&image, &list, &out).expect("solved");
    assert!(said.starts_with("9 of 12 GCPs matched"), "{said}");
    assert_eq!(std::fs::read_to_string(out).expect("a world file").lines().count(), 6);
}

#[test]
fn a_taught_profile_finds_the_other_marks() {
    let mut found = own_profile::found().expect("a scan");
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let truth = [(67.0, 57.0), (187.0, 227.0), (307.0, 87.0)];
    assert_eq!(found.len(), truth.len(), "{found:?}");
    for (at, truth) in found.iter().zip(truth) {
        assert!((at.0 - truth.0).hypot(at.1 - truth.1) < 0.1, "{at:?} for {truth:?}");
    }
}
