//! Settling doubtful marks by hand, on record: the patch file that a page saves ([`patch`]) and its replay ([`mod@replay`]).
//!
//! The page of `--report` recomputes the fit while the reviewer works, with the formulas of [`crate::solve::similarity`]
//! in the same order of operations, so that a replay gives the numbers that the page showed. The patch is the audit
//! trail: it holds what was done, in order, and nothing that could not be read by a person.

pub mod patch;
pub mod replay;

pub use patch::{Action, Edit, Patch, Shown, Subject, Target};
pub use replay::{Replayed, replay};

/// Variance of a coordinate of a mark that somebody placed by hand, px²: people point to about 0.3 px in an enlarged window.
/// It replaces the fit's own figure, which was not believed.
pub const HAND_VARIANCE_PX2: f64 = 0.09;
