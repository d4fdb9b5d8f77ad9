//! Any bytes as a list of GCPs in every dialect: an answer or an error.
#![no_main]

mod common;

use autoref_stream::gcp::{self, GcpOptions};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let endings = [".csv", ".txt", ".points", ".kof", ".xml", ".geojson", ".json"];
    let Some(file) = common::file(data, &endings) else { return };
    let _ = gcp::read(file.path(), &GcpOptions::default());
});
