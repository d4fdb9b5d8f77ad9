//! What each stage of a flight found, as its JSON document. A number that is not finite is written as `null`.

mod gcp;
mod interior;
mod pairs;
mod relative;
mod ties;

use serde::Serialize;

use super::document::CamerasDocument;

pub use gcp::GcpStage;
#[cfg(test)]
pub use interior::UsedFrame;
pub use interior::{FocalLength, InteriorStage};
pub use pairs::{FramePlace, PairsStage};
pub use relative::RelativeStage;
#[cfg(test)]
pub use ties::MatchedPair;
pub use ties::{TiedFrame, TiesStage};

/// What the last stage of a run found.
#[derive(Serialize)]
#[serde(untagged)]
pub enum Found {
    Interior(InteriorStage),
    Pairs(PairsStage),
    Ties(TiesStage),
    Relative(RelativeStage),
    Gcp(Box<GcpStage>),
    Cameras(Box<CamerasDocument>),
}
