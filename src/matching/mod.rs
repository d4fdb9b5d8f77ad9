//! Working out which candidate is which GCP, from the pattern alone.
//!
//! [`robust`] is the default: hypotheses from pairs, verified against all GCPs, accepted only when an accident is
//! unlikely enough ([`evidence`]). [`tpp`] is the topological point pattern of the 2016 thesis, kept for comparison;
//! what it proposes must pass the same test of evidence.
//!
//! ```
//! use autoref_stream::candidate::Candidate;
//! use autoref_raster::coords::{GeoTransform, PixelPoint};
//! use autoref_stream::gcp::Gcp;
//! use autoref_stream::matching::{MatchOutcome, Matcher, Priors, RobustMatcher};
//! let transform = GeoTransform([570_000.0, 0.03, 0.004, 7_032_000.0, 0.004, -0.03]);
//! let pixels = [(120.0, 80.0), (3900.0, 400.0), (2200.0, 2900.0), (700.0, 2100.0), (3100.0, 1700.0), (1500.0, 600.0)];
//! let mut candidates = Vec::new();
//! let mut gcps = Vec::new();
//! for (i, (x, y)) in pixels.into_iter().enumerate() {
//!     let centre = PixelPoint { x, y };
//!     let ground = transform.apply(centre);
//!     gcps.insert(0, Gcp::control(format!("P{i}"), ground.easting, ground.northing)); // in any order
//!     let (covariance_px2, score, area_px, size_px, elevation_m) = (None, None, None, None, None);
//!     let (code, paint) = (None, None);
//!     candidates.push(Candidate { centre, covariance_px2, score, area_px, size_px, elevation_m, code, paint });
//! }
//! let MatchOutcome::Solved(solved) = RobustMatcher::default().find(&candidates, &gcps, &Priors::default()) else {
//!     panic!("six points in a pattern of their own");
//! };
//! assert!(solved.pattern.pairs.iter().all(|&(candidate, gcp)| candidate == 5 - gcp));
//! ```

mod bar;
mod bitmap;
pub(crate) mod close_core;
pub mod diagnosis;
mod distances;
pub(crate) mod doubtful;
mod duplicates;
mod effort;
pub mod evidence;
mod explain;
mod far;
pub mod field;
mod grow;
mod hypotheses;
mod labels;
mod looks;
mod mirrored;
mod names;
mod pairs;
mod predictions;
mod repetition;
mod rivals;
pub mod robust;
mod screening;
mod search;
mod settle;
mod sharpen;
mod targets;
mod time_limit;
pub mod tpp;
mod waiting;
mod weigh;

use autoref_raster::ranks::upper_median;
use serde::{Deserialize, Serialize};

use crate::candidate::Candidate;
use crate::gcp::Gcp;
use autoref_solve::Similarity;

pub use labels::{Labels, number_of_label};
pub use mirrored::MirrorMatcher;
pub use names::NamesAgree;
pub use robust::RobustMatcher;
pub use time_limit::TimeLimit;
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

/// What the image's own georeference or resolution says, whether or not it is believed: the search takes it loosely, so
/// that a figure of the user's helps still.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OfImage {
    pub scale: bool,
    pub north: bool,
}

/// Smallest and largest side of anything that is put out as a mark, metres.
const MARK_SIDE_M: (f64, f64) = (0.01, 10.0);

impl Priors {
    /// The same; where nothing is known of the scale, what the size of the candidates says of it: nobody paints marks
    /// of more than ten metres. Without it, a clump of clutter can look like the whole list seen from far away.
    pub fn with_mark_sizes(&self, candidates: &[Candidate]) -> Priors {
        let mut sides: Vec<f64> =
            candidates.iter().filter_map(|c| c.size_px).map(|[w, h]| w.max(h)).filter(|side| *side > 0.0).collect();
        let Some(median) = upper_median(&mut sides).filter(|_| self.gsd_m_per_px.is_none()) else {
            return self.clone();
        };
        Priors { gsd_m_per_px: Some((MARK_SIDE_M.0 / median, MARK_SIDE_M.1 / median)), ..self.clone() }
    }
}

impl Priors {
    /// Whether the scale narrows a search: known to a factor of ten. What the size of marks says of it is a hundred
    /// times wider.
    fn narrow_by_scale(&self) -> bool {
        const NARROW: f64 = 10.0;
        self.gsd_m_per_px.is_some_and(|(finest, coarsest)| coarsest <= NARROW * finest)
    }
}

/// A pattern that was found, accepted or not.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pattern {
    /// Index of the candidate and of the GCP, in order of the GCPs.
    pub pairs: Vec<(usize, usize)>,
    pub similarity: Similarity,
    /// log₁₀ of the number of patterns as good as this that chance would produce in this list.
    pub log10_false_alarms: f64,
    /// The same with all GCPs in the image taken together, where the former may go by those near the pattern only; the
    /// search asks for it, files do not hold it.
    #[serde(skip)]
    pub log10_whole_false_alarms: f64,
    /// 1σ of a coordinate of the pairs about the similarity, pixels.
    pub noise_px: f64,
    /// The same of all pairs alike and without bounds; the search asks for it, files do not hold it.
    #[serde(skip)]
    pub deviation_px: f64,
    /// GCPs that the similarity puts inside the image.
    pub gcps_in_image: usize,
}

/// What the search did.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "effort::Written", into = "effort::Written")]
pub struct Effort {
    /// Hypotheses that the priors allow: what the number of false alarms is multiplied by.
    pub hypotheses_possible: f64,
    /// Hypotheses looked at.
    pub hypotheses_tried: u64,
    pub ended: SearchEnd,
}

/// How a search ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SearchEnd {
    /// With nothing left to try, or a pattern that settles it.
    #[default]
    Complete,
    /// At its budget, before all hypotheses were tried.
    BudgetSpent,
    /// At the time limit, before its budget.
    TimeLimit,
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
    /// How the names that coded targets bear agree, when they were heeded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub names: Option<NamesAgree>,
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
    pub diagnoses: Vec<diagnosis::Diagnosis>,
}

/// Finds the pattern of the GCPs among the candidates.
pub trait Matcher {
    /// GCPs with the role `check` take no part. The transform is a proper similarity of (x, −y): mirrored images are
    /// matched by [`MirrorMatcher`] only; [`diagnosis`] names them.
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome;
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::PixelPoint;

    #[test]
    fn the_size_of_marks_bounds_the_scale_unless_something_better_is_known() {
        let mark =
            |side: f64| Candidate { size_px: Some([side, side / 2.0]), ..Candidate::at(PixelPoint { x: 0.0, y: 0.0 }) };
        let marks = [mark(10.0), mark(20.0), mark(500.0)];
        let bounded = Priors::default().with_mark_sizes(&marks);
        assert_eq!(bounded.gsd_m_per_px, Some((0.0005, 0.5)));
        let known = Priors { gsd_m_per_px: Some((0.1, 2.0)), ..Priors::default() };
        assert_eq!(known.with_mark_sizes(&marks), known);
        assert_eq!(Priors::default().with_mark_sizes(&[]), Priors::default());
    }
}
