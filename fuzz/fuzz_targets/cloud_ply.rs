//! Any bytes as a point cloud in a file that is called PLY.
#![no_main]

mod common;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| common::cloud(data, ".ply"));
