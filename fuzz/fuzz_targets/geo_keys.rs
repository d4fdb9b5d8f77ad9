//! Any bytes as a TIFF that gets tags of a georeference and loses them again: byte for byte what it was, or refused.
#![no_main]

mod common;

use autoref_raster::atomic::Edit;
use autoref_raster::coords::GeoTransform;
use autoref_stream::georef::tags::{self, TagOptions, Undo};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some(file) = common::file(data, &[".tif"]) else { return };
    let path = file.path();
    let _ = tags::is_tagged(path);
    let transform = GeoTransform([500_000.0, 0.03, 0.001, 7_000_000.0, 0.001, -0.03]);
    let Ok((mut edit, _)) = tags::prepare(path, 0, &transform, None, &TagOptions::default()) else { return };
    if edit.apply().is_ok() {
        drop(edit);
        assert!(tags::undo(path, Undo::Now).is_ok(), "what it has written it takes back");
    }
    assert!(std::fs::read(path).expect("readable") == data[1..], "the file is not what it was");
});
