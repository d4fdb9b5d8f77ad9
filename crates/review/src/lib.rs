//! Settling doubtful marks by hand, on record: the patch file that a page saves ([`PatchFile`]).
//!
//! The page of `--report` recomputes the fit while the reviewer works, with the formulas of the solver in the same
//! order of operations, so that a replay gives the numbers that the page showed. The patch is the audit trail: it holds
//! what was done, in order, and nothing that could not be read by a person. This crate imports `autoref-raster` only.
#![warn(missing_docs)]

mod patch_file;

pub use patch_file::{Action, Edit, PatchFile, SCHEMA, SCHEMA_VERSION, Shown, Subject, Target};

/// Variance of a coordinate of a mark that somebody placed by hand, px²: people point to about 0.3 px in an enlarged
/// window. It replaces the fit's own figure, which was not believed.
pub const HAND_VARIANCE_PX2: f64 = 0.09;
