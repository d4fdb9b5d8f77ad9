//! Zeros that stand for nothing, though no file says it.

use std::path::Path;

use autoref_elevation::align::{Degree, Method, Outcome};
use autoref_elevation::files::AlignJob;

use super::{SIDE, compare, hills, model, resources};

/// A collar of 0 that no nodata value names is told of, for `dem compare` and `dem align`; the sea is not.
#[test]
fn zeros_that_may_stand_for_nothing_are_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let b = model(&at("b.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let collar = |value: f32| {
        let on_collar = |i: usize| i % SIDE < SIDE / 10;
        hills(0.0, 0.0).iter().enumerate().map(|(i, z)| if on_collar(i) { value } else { *z }).collect::<Vec<_>>()
    };
    let a = model(&at("a.tif"), "EPSG:32633", collar(0.0), -10.0);
    let told = |a: &Path, b: &Path| {
        let compared = compare(a, b, None, &at("c")).warnings.join("; ");
        let job = AlignJob {
            a,
            b,
            method: Method::Auto,
            surface: Degree::Linear,
            stable: None,
            resources: resources(),
            scratch: Some(folder.path()),
        };
        let found = job.run().expect("read");
        let Outcome::Aligned(found) = found.outcome else { panic!("refused") };
        let aligned = found.zeros.notes(found.common_cells, a, b).join("; ");
        let letter = |text: &str| text.chars().next();
        assert_eq!(letter(&aligned), letter(&compared), "{aligned}");
        compared
    };
    assert!(told(&a, &b).starts_with("A is exactly 0 in 10.0 % of the common cells"), "{}", told(&a, &b));
    assert!(told(&b, &a).starts_with("B is exactly 0 in 10.0 % of the common cells"), "{}", told(&b, &a));
    let low = model(&at("low.tif"), "EPSG:32633", collar(1.0), -10.0);
    assert_eq!(told(&low, &b), "");
    let (sea, again) = (model(&at("sea.tif"), "EPSG:32633", collar(0.0), -10.0), a);
    assert_eq!(told(&sea, &again), "");
}
