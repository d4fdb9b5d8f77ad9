//! What the library promises, without the program.
#![allow(clippy::unwrap_used)] // a test that fails here says where

#[path = "../common/mod.rs"]
mod common;
#[path = "../../benches/detection/targets.rs"]
#[allow(dead_code)] // the benches use the rest
mod drawn_targets;
mod readers_oracle;
#[path = "../../benches/detection/scan.rs"]
#[allow(dead_code)] // the benches use the rest
mod scan;

mod adversity;
mod architecture;
mod detection;
mod diagnosis;
mod examples;
mod gcp_drawings;
mod gcp_instruments;
mod gcp_lists;
mod gcp_readings;
mod gcp_titles;
mod gcp_units;
mod lists_folder;
mod matching;
mod mutations;
mod names;
mod odd_tables;
mod own_ground;
mod reader_facts;
mod readers;
mod repetition;
mod synth;
mod tags;
mod targets;
mod thesis;
mod tile_invariance;
mod unclear_lists;
mod which_first;
mod words;
