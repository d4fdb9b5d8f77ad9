//! Any bytes as a TIFF: every image that opens is read, and nothing may panic, hang or take memory beyond the cache.
#![no_main]

use std::io::Write;

use autoref_raster::tiff::{Directories, FloatTiff, open_pixels};
use autoref_raster::{RasterSource, read_patch};
use autoref_raster::window::Window;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let mut file = tempfile::NamedTempFile::new_in("/dev/shm").expect("memory for a small file");
    file.write_all(data).expect("memory for a small file");
    let Ok(all) = Directories::read(file.path()) else { return };
    for index in 0..all.list.len().min(4) {
        let Ok(source) = open_pixels(&all, index, 1 << 20) else { continue };
        let whole = source.info().bounds();
        for window in [Window::new(0, 0, 700, 300), Window::new(whole.width / 2, whole.height / 2, 300, 500)] {
            let _ = read_patch(&source, window.intersect(&whole));
        }
    }
    let Some(floats) = FloatTiff::open(file.path()) else { return };
    let (width, height) = floats.size();
    let size = (width.min(300) as usize, height.min(200) as usize);
    for at in [(0, 0), ((width - size.0 as u64) / 2, height - size.1 as u64)] {
        let _ = floats.read(at, size, 0.0, &mut vec![0.0; size.0 * size.1]);
    }
});
