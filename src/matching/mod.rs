//! Working out which candidate is which GCP, from the pattern alone.
//!
//! [`robust`] is the default: hypotheses from pairs, verified against all GCPs, accepted only when an accident is unlikely
//! enough ([`evidence`]). [`tpp`] is the topological point pattern of the 2016 thesis, kept for comparison; what it proposes
//! must pass the same test of evidence.

mod bitmap;
pub mod doctor;
pub mod evidence;
mod explain;
pub mod field;
pub mod robust;
mod search;
mod settle;
pub mod tpp;

use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::solve::Similarity;

pub use robust::RobustMatcher;
pub use tpp::TppMatcher;

/// What is known before looking at the pattern.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Priors {
    /// Ground size of a pixel, metres: smallest and largest.
    pub gsd_m_per_px: Option<(f64, f64)>,
    /// Rotation of the image, degrees anticlockwise from east: centre and half-width.
    pub rotation_deg: Option<(f64, f64)>,
    /// Width and height of the image, pixels. Without it the candidates' extent stands in.
    pub image_size_px: Option<(f64, f64)>,
}

/// A pattern that was found, accepted or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pattern {
    /// Index of the candidate and of the GCP, in order of the GCPs.
    pub pairs: Vec<(usize, usize)>,
    pub similarity: Similarity,
    /// log₁₀ of the number of patterns as good as this that chance would produce in this list.
    pub log10_false_alarms: f64,
    /// 1σ of a coordinate of the pairs about the similarity, pixels.
    pub noise_px: f64,
    /// GCPs that the similarity puts inside the image.
    pub gcps_in_image: usize,
}

/// What the search did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Effort {
    /// Hypotheses that the priors allow: what the chance of an accident is multiplied by.
    pub hypotheses_possible: f64,
    /// Hypotheses looked at.
    pub hypotheses_tried: u64,
    /// The search ended at its budget before all hypotheses were tried.
    pub budget_spent: bool,
}

/// The answer of a matcher.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum MatchOutcome {
    Solved(Box<Solved>),
    NoMatch(Box<Evidence>),
}

/// A pattern good enough to be believed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Solved {
    pub pattern: Pattern,
    /// The best pattern that says something different.
    pub runner_up: Option<Pattern>,
    pub effort: Effort,
}

/// Why nothing is believed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    pub reason: String,
    /// What would help, in plain words.
    pub advice: Vec<String>,
    /// The best partial pattern.
    pub best: Option<Pattern>,
    pub runner_up: Option<Pattern>,
    pub effort: Effort,
    /// Mistakes in the list that would explain it.
    pub diagnoses: Vec<doctor::Diagnosis>,
}

/// Finds the pattern of the GCPs among the candidates.
pub trait Matcher {
    /// GCPs with the role `check` take no part. The transform is a proper similarity of (x, −y): mirrored images are
    /// never matched; [`doctor`] names them.
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome;
}
