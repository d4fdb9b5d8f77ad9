//! Writing what was solved so that other programs understand it.

pub mod atomic;
pub mod candidate_list;
pub mod carry;
pub mod crs;
pub mod dialects;
pub mod gcps_vrt;
pub mod heights;
pub mod result;
pub mod sidecar;
pub mod tags;
pub mod warp;
pub mod write;
