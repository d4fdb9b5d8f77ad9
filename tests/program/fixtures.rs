//! The committed fixtures are what the generator makes, and the program finds in them what they say.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

/// Largest distance from the truth that is accepted of a centre, pixels.
const TRUTH_PX: f64 = 0.25;
/// Differences between machines: the last digits of square roots and logarithms.
const SAME_PX: f64 = 1e-6;

fn rows(csv: &Path) -> Vec<(String, f64, f64)> {
    let text = std::fs::read_to_string(csv).expect("there");
    let mut lines = text.lines();
    assert!(lines.next().expect("a header").starts_with("name,pixel_x,pixel_y,"), "{text}");
    lines
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            (cells[0].to_owned(), cells[1].parse().expect("x"), cells[2].parse().expect("y"))
        })
        .collect()
}

/// Pixels of all bands.
fn pixels(path: &Path) -> Vec<u8> {
    let dataset = gdal::Dataset::open(path).expect("an image");
    (1..=dataset.raster_count())
        .flat_map(|band| {
            let band = dataset.rasterband(band).expect("there");
            band.read_as::<u8>((0, 0), band.size(), band.size(), None).expect("read").data().to_vec()
        })
        .collect()
}

#[test]
fn the_fixtures_are_what_the_generator_makes_and_hold_what_they_say() {
    let committed = crate::common::root().join("fixtures");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let made = Command::new(committed.join("make.sh"))
        .args([Path::new(env!("CARGO_BIN_EXE_autoref-stream")), folder.path()])
        .output()
        .expect("bash starts");
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    for (name, marks) in [("field", 9), ("targets", 7)] {
        let file = |folder: &Path, end: &str| folder.join(format!("{name}{end}"));
        let read = |folder: &Path, end: &str| std::fs::read(file(folder, end)).expect("there");
        assert!(read(&committed, ".geojson") == read(folder.path(), ".geojson"), "{name}.geojson: run `make fixtures`");
        assert!(
            pixels(&file(&committed, ".tif")) == pixels(&file(folder.path(), ".tif")),
            "{name}.tif: run `make fixtures`"
        );
        let (expected, found) = (rows(&file(&committed, ".expected.csv")), rows(&file(folder.path(), ".expected.csv")));
        assert_eq!(expected.len(), marks);
        let truth: Value = serde_json::from_slice(&read(&committed, ".truth.json")).expect("JSON");
        let painted = truth["gcps"].as_array().expect("a list");
        for (e, f) in expected.iter().zip(&found) {
            assert_eq!(e.0, f.0);
            assert!((e.1 - f.1).hypot(e.2 - f.2) < SAME_PX, "{name} {}: {f:?}, expected {e:?}", e.0);
            let mark = painted.iter().find(|p| p["name"] == e.0).expect("painted");
            let (x, y) = (mark["x"].as_f64().expect("x"), mark["y"].as_f64().expect("y"));
            assert!((e.1 - x).hypot(e.2 - y) < TRUTH_PX, "{name} {}: {e:?}, painted at {x}, {y}", e.0);
        }
        assert_eq!(found.len(), marks);
    }
}
