//! Writing what was solved so that other programs understand it.
pub mod candidate_list;
pub mod crs;
