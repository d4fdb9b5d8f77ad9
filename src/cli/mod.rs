//! One file for each command.

pub mod chips;
pub mod distance;
pub mod sample;
