//! Options, georeferences and names on the command line that mislead: what is said of them.

use std::path::Path;
use std::process::Command;

use autoref_raster::coords::Handedness;
use autoref_synth::{SynthGcp, SynthSpec, random_gcps};

const CRS: [&str; 2] = ["--crs", "EPSG:25832"];
const GSD_M: f64 = 0.025;
const SIZE_PX: (u64, u64) = (960, 720);

/// Exit code and what was said.
fn program(folder: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let run = Command::new(env!("CARGO_BIN_EXE_autoref-stream")).current_dir(folder).args(arguments).output();
    let output = run.expect("the program starts");
    let text = format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    (output.status.code(), text)
}

#[track_caller]
fn answers((code, text): (Option<i32>, String), expected: i32, words: &[&str]) {
    assert_eq!(code, Some(expected), "{text}");
    for word in words {
        assert!(text.contains(word), "no `{word}` in: {text}");
    }
}

fn list(folder: &Path, gcps: &[SynthGcp]) {
    let rows: String = gcps.iter().map(|g| format!("{},{},{}\n", g.name, g.easting, g.northing)).collect();
    std::fs::write(folder.join("l.csv"), format!("name,easting,northing\n{rows}")).expect("writable");
}

/// An image `a.tif` of nine marks, and `l.csv`.
fn workplace(mirrored: Handedness) -> (tempfile::TempDir, Vec<SynthGcp>) {
    let folder = tempfile::tempdir().expect("a folder");
    let gcps = random_gcps(9, 24.0, 18.0, 4);
    let spec = SynthSpec {
        gcps: gcps.clone(),
        size_px: Some(SIZE_PX),
        gsd_m: GSD_M,
        mirrored: mirrored.into(),
        ..SynthSpec::default()
    };
    autoref_synth::write(&spec, &folder.path().join("a.tif")).expect("a sample");
    list(folder.path(), &gcps);
    (folder, gcps)
}

/// A world file beside the image, about the middle of the list.
fn world_file(folder: &Path, gcps: &[SynthGcp], [a, d, b, e]: [f64; 4]) {
    let n = gcps.len() as f64;
    let (east, north) =
        (gcps.iter().map(|g| g.easting).sum::<f64>() / n, gcps.iter().map(|g| g.northing).sum::<f64>() / n);
    let (x, y) = (SIZE_PX.0 as f64 / 2.0, SIZE_PX.1 as f64 / 2.0);
    let text = format!("{a}\n{d}\n{b}\n{e}\n{}\n{}\n", east - a * x - b * y, north - d * x - e * y);
    std::fs::write(folder.join("a.tfw"), text).expect("writable");
}

/// `--gsd` of another image gave advice to take another prior, and nothing said that the job fits without.
#[test]
fn a_wrong_gsd_and_a_wrong_north_are_blamed() {
    let (folder, _) = workplace(Handedness::AsIs);
    let run = |extra: &[&str]| {
        program(folder.path(), &[&["a.tif", "--gcps", "l.csv", "--no-report", "--overwrite"], &CRS[..], extra].concat())
    };
    answers(run(&["--gsd", "30"]), 1, &["without --gsd it fits at 0.025", "9 points have a mark"]);
    let (code, text) = run(&["--gsd", "0.06"]);
    // The marks were all found: nobody is sent to their own orange.
    let band = |hex: &str, at: usize| i32::from_str_radix(&hex[at..at + 2], 16).expect("a colour");
    let is_orange = |hex: &str| band(hex, 0) > band(hex, 4) + 60;
    assert!(!text.split("--paint \"#").skip(1).any(is_orange), "{text}");
    answers((code, text), 1, &["without --gsd it fits at 0.025"]);
    assert!(!folder.path().join("a.tfw").exists(), "what is refused is not written");
    answers(run(&["--gsd", "0.025"]), 0, &["Matched"]);
}

/// An image whose own georeference says that it is mirrored was refused, and the remedy was not named.
#[test]
fn a_mirrored_image_names_the_option_and_is_solved_where_it_says_so_itself() {
    let (folder, gcps) = workplace(Handedness::Mirrored);
    let job = [&["a.tif", "--gcps", "l.csv", "--no-report", "--overwrite"], &CRS[..]].concat();
    answers(program(folder.path(), &job), 1, &["the image is mirrored", "--allow-mirrored"]);
    world_file(folder.path(), &gcps, [-GSD_M, 0.0, 0.0, -GSD_M]);
    answers(program(folder.path(), &[&job[..], &["--prior", "none"]].concat()), 1, &["--allow-mirrored"]);
    answers(program(folder.path(), &job), 0, &["Matched         9 of 9"]);
}

/// A point that is 0.139 m off was called hidden, and a digit of it mended that leaves 6 cm.
#[test]
fn a_mark_beside_its_listed_place_is_displaced() {
    let (folder, mut gcps) = workplace(Handedness::AsIs);
    gcps[2].easting -= 0.139;
    gcps[2].northing += 0.146;
    list(folder.path(), &gcps);
    let job = [&["a.tif", "--gcps", "l.csv", "--no-report"], &CRS[..]].concat();
    let (code, text) = program(folder.path(), &job);
    answers((code, text.clone()), 0, &["(displaced: a whole mark lies", "dE +0.1", "dN -0.1"]);
    assert!(!text.contains("mistyped") && !text.contains("hidden"), "{text}");
    let json = std::fs::read_to_string(folder.path().join("a.autoref.json")).expect("the result");
    let result: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    let point = &result["not_found"][0];
    assert_eq!(point["reason"], "displaced");
    assert!((point["offset_e_m"].as_f64().expect("a number") - 0.139).abs() < 0.02, "{point}");
    assert!((point["offset_n_m"].as_f64().expect("a number") + 0.146).abs() < 0.02, "{point}");
}

#[test]
fn slips_of_the_command_line_are_told_in_words() {
    let (folder, _) = workplace(Handedness::AsIs);
    let dir = folder.path();
    answers(
        program(dir, &["l.csv", "--gcps", "a.tif"]),
        2,
        &["a.tif: an image, no list of GCPs; the image comes first"],
    );
    answers(
        program(dir, &["apply", "l.csv"]),
        2,
        &["l.csv", "line 1", "no result of a run; name the NAME.autoref.json"],
    );
    let (_, text) = program(dir, &["sample", "a.tif", "--at", "-50,3", "-o", "p.toml"]);
    assert!(text.contains("\"-50,3\" lies outside the image"), "{text}");
    let (code, text) = program(dir, &["a.tif", "--gcps", "l.csv", "--mark-size", "0.4m"]);
    assert!(!text.contains("profile"), "{text}");
    answers((code, text), 2, &["--mark-size gives a length", "--gsd"]);
    answers(program(dir, &["detect", "a.tif", "-o", "l.csv"]), 2, &["exists", "--overwrite", "name another output"]);
}
