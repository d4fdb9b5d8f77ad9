//! What a person should know of a run.

use std::fmt;

/// A remark on a run. What a later step takes back is found by its kind, never by its words.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// No mark lies where that of a GCP must be, but another one near it.
    NearMiss {
        gcp: String,
        off_px: f64,
        off_m: f64,
        /// What the list states of the point, where that explains the distance.
        within_sigma_m: Option<f64>,
    },
    /// These fit badly.
    LookAt { points: Vec<String> },
    /// What nothing takes back, in its words.
    Said(String),
}

impl Warning {
    /// Whether it doubts the mark of this GCP, because none lies where it must be.
    pub fn misses(&self, name: &str) -> bool {
        matches!(self, Warning::NearMiss { gcp, .. } if gcp == name)
    }
}

impl From<String> for Warning {
    fn from(words: String) -> Self {
        Warning::Said(words)
    }
}

impl From<&str> for Warning {
    fn from(words: &str) -> Self {
        Warning::Said(words.into())
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Warning::NearMiss { gcp, off_px, off_m, within_sigma_m: Some(sigma_m) } => write!(
                f,
                "{gcp}: a mark {off_px:.1} px = {off_m:.3} m beside its place lies within its stated accuracy (σ {sigma_m:.3} m): \
                 perhaps its own, but chance may put another there"
            ),
            Warning::NearMiss { gcp, off_px, off_m, within_sigma_m: None } => write!(
                f,
                "{gcp}: no mark where it must be, but one {off_px:.1} px = {off_m:.3} m beside it; mark or survey may be \
                 wrong"
            ),
            Warning::LookAt { points } => write!(f, "look at {}: mark or survey may be wrong", points.join(", ")),
            Warning::Said(words) => f.write_str(words),
        }
    }
}
