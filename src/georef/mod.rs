//! Writing what was solved so that other programs understand it.

pub mod atomic;
pub mod candidate_list;
pub mod crs;
pub mod result;
pub mod sidecar;
