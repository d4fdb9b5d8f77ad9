//! A block as an adjustment leaves it.

use super::adjusted::Blunder;
use crate::bundle::{Deviations, Problem, Summary};

/// A block that was adjusted, without what was wrong.
pub(super) struct Standing {
    pub problem: Problem,
    /// `None` where they cannot be stated.
    pub deviations: Option<Deviations>,
    pub blunders: Vec<Blunder>,
    pub summary: Summary,
    pub sigma_tie_px: f64,
    pub notes: Vec<String>,
}
