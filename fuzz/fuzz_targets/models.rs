//! Any bytes as COLMAP's model, binary or text: the first byte chooses, two lengths of two bytes part cameras, images
//! and points.
#![no_main]

use autoref_flight::read::colmap;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let [choice, a, b, c, d, rest @ ..] = data else { return };
    let ending = if choice % 2 == 0 { "bin" } else { "txt" };
    let first = usize::from(u16::from_le_bytes([*a, *b])).min(rest.len());
    let second = (first + usize::from(u16::from_le_bytes([*c, *d]))).min(rest.len());
    let folder = tempfile::tempdir_in("/dev/shm").expect("memory for a small folder");
    let parts = [("cameras", &rest[..first]), ("images", &rest[first..second]), ("points3D", &rest[second..])];
    for (name, bytes) in parts {
        std::fs::write(folder.path().join(format!("{name}.{ending}")), bytes).expect("memory for a small file");
    }
    if let Ok(model) = colmap::read(folder.path()) {
        for camera in &model.cameras {
            let _ = (camera.project([0.1, -0.2, 1.0]), camera.ray([10.0, 20.0]));
        }
        let _ = colmap::text_model(&model);
    }
});
