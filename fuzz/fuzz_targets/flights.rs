//! Any bytes as what describes a flight: MicMac's and MMVII's XML, OpenSfM's JSON, camera tables, points in images; a
//! camera of film.
#![no_main]

mod common;

use autoref_flight::read::{image_points, micmac, opensfm, tables};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some(file) = common::file(data, &[".xml", ".json", ".csv", ".txt", ".toml"]) else { return };
    let path = file.path();
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("xml") => {
            let _ = micmac::read_orientation(path);
            let _ = micmac::read_ground_points(path);
            let _ = micmac::read_image_points(path);
            if let Ok(camera) = micmac::read_camera(path) {
                let _ = camera.project([0.1, -0.2, 1.0]);
                let _ = camera.ray([10.0, 20.0]);
            }
        }
        Some("json") => {
            let _ = opensfm::read(path);
        }
        Some("toml") => {
            let _ = autoref_film::load_camera(&path.to_string_lossy());
        }
        _ => {
            let _ = tables::cameras(path);
            let _ = image_points::read(path);
        }
    }
});
