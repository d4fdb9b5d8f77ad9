//! Any bytes as a profile, a patch, a result, a list of candidates, a table of colours, or a description of tiles.
#![no_main]

mod common;

use autoref_raster::tile_folder::tile_map::TileMap;
use autoref_review::{PatchFile, Subject};
use autoref_stream::georef::candidate_list;
use autoref_stream::learn::read_colours;
use autoref_stream::profile::Profile;
use autoref_stream::result::RunResult;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let Some(file) = common::file(data, &[".toml", ".json", ".csv", ".xml"]) else { return };
    let path = file.path();
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("toml") => {
            if let Ok(profile) = Profile::load(&path.to_string_lossy()) {
                assert!(Profile::parse(&profile.to_toml()).is_ok(), "what it writes it reads");
            }
        }
        Some("json") => {
            let _ = PatchFile::read(path, Subject::Gcps);
            let _ = PatchFile::read(path, Subject::Fiducials);
            let _ = RunResult::read(path);
        }
        Some("csv") => {
            let _ = candidate_list::read_csv(path);
            let _ = read_colours(path);
        }
        _ => {
            let _ = TileMap::read(path);
        }
    }
});
