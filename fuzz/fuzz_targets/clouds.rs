//! Any bytes as a point cloud: PLY, LAS, LAZ and text, read to the end or refused.
#![no_main]

mod common;

use autoref_cloud::io;
use autoref_cloud::schema::Batch;
use libfuzzer_sys::fuzz_target;

/// More than any file of these sizes holds; a header that promises more must not make the reader go on.
const MOST_POINTS: usize = 1 << 16;

fuzz_target!(|data: &[u8]| {
    let Some(file) = common::file(data, &[".ply", ".las", ".laz", ".xyz"]) else { return };
    let Ok((_, mut reader)) = io::open(file.path()) else { return };
    let mut batch = Batch { xyz: Vec::new(), raw: Vec::new() };
    let mut points = 0;
    while points < MOST_POINTS && reader.read(&mut batch, 4096).is_ok() && !batch.is_empty() {
        points += batch.len();
    }
});
