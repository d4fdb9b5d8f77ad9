//! The stages of a flight.

use serde::Serialize;

/// The stages in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Frames, masks, focal length and principal point.
    Interior,
    /// Flight lines, and which frames are compared.
    Pairs,
    /// Matches of features between frames.
    Ties,
    /// The frames' orientation to each other.
    Relative,
    /// The block on the ground by seven parameters.
    Gcp,
    /// The adjusted cameras.
    Cameras,
}

impl Stage {
    pub const ALL: [Stage; 6] =
        [Stage::Interior, Stage::Pairs, Stage::Ties, Stage::Relative, Stage::Gcp, Stage::Cameras];

    pub fn name(self) -> &'static str {
        match self {
            Stage::Interior => "interior",
            Stage::Pairs => "pairs",
            Stage::Ties => "ties",
            Stage::Relative => "relative",
            Stage::Gcp => "gcp",
            Stage::Cameras => "cameras",
        }
    }
}
