//! Any bytes as outlines of masks: TOML and GeoJSON, and the words of --sample and --teach.
#![no_main]

mod common;

use autoref_terrain::shapes;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some(file) = common::file(data, &[".toml", ".geojson", ".txt"]) else { return };
    if file.path().extension().is_some_and(|end| end == "txt") {
        if let Ok(text) = std::str::from_utf8(&data[1..]) {
            let _ = (shapes::parse_sample(text), shapes::parse_lesson(text), shapes::meaning(text));
        }
        return;
    }
    for shape in shapes::read(file.path()).into_iter().flatten() {
        let [x0, y0, x1, y1] = shape.bounds();
        let _ = (shape.contains([x0, y0]), shape.contains([(x0 + x1) / 2.0, (y0 + y1) / 2.0]));
        let _ = shape.check_inside(file.path(), 100, 80);
    }
});
