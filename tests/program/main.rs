//! What the program promises on the command line, in the files it writes and in the pages it makes.
#![allow(clippy::unwrap_used)] // a test that fails here says where

mod browser;
#[path = "../common/mod.rs"]
mod common;
#[path = "../../benches/detection/targets.rs"]
#[allow(dead_code)] // the benches use the rest
mod drawn_targets;
#[path = "../../benches/detection/scan.rs"]
#[allow(dead_code)] // the benches use the rest
mod scan;

mod accuracy;
mod cloud;
#[cfg(feature = "coded")]
mod coded;
mod command_line;
mod commands;
mod companions;
mod conversions;
mod detection_commands;
mod dialects;
mod e6;
mod elevation;
mod elevation_voids;
mod faults;
mod film;
mod film_outputs;
mod film_rolls;
mod fixtures;
mod flight;
mod flight_input;
mod flight_solve;
mod full_disk;
mod heights;
mod inputs;
mod main_job;
mod mask;
mod misled;
mod mistakes;
mod orthorectify;
mod outputs;
mod photographs;
mod planning;
mod pumpkins;
mod report;
mod robustness;
mod schema;
mod second_pass;
mod second_run;
mod selftest;
mod signals;
mod solvers;
mod synth_flight;
mod system_calls;
