//! What a stage found, in one line: for its own page, and for the table of contents, which reads it back from the
//! documents.

use autoref_raster::words::counted;
use serde::Deserialize;
use serde::de::IgnoredAny;

use super::page::fixed;
use super::stage::Stage;

/// What a stage found, in figures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StageLine {
    /// Frames that can be used, of those listed.
    Interior {
        usable: usize,
        listed: usize,
    },
    Pairs {
        lines: usize,
        pairs: usize,
    },
    /// Ties of all pairs, the pairs that have any, and all that were compared.
    Ties {
        ties: usize,
        tied: usize,
        pairs: usize,
    },
    /// Of the relative orientation and of the adjusted cameras; the RMS in pixels.
    Block {
        registered: usize,
        listed: usize,
        rms_px: Option<f64>,
    },
    /// The RMS of the control points in metres.
    Gcp {
        points: usize,
        rms_m: Option<f64>,
    },
}

impl StageLine {
    /// Text for a page.
    pub fn words(self) -> String {
        match self {
            StageLine::Interior { usable, listed } => format!("{usable} of {listed} frames can be used"),
            StageLine::Pairs { lines, pairs } => {
                let lines = counted(lines, "flight line", "flight lines");
                format!("{lines}, {} to compare", counted(pairs, "pair", "pairs"))
            }
            StageLine::Ties { ties, tied, pairs } => format!("{ties} ties in {tied} of {pairs} pairs"),
            StageLine::Block { registered, listed, rms_px } => {
                format!("{registered} of {listed} frames registered, ties {} px RMS", fixed(rms_px, 2))
            }
            StageLine::Gcp { points, rms_m } => {
                format!("{points} surveyed points; seven parameters leave {} m RMS at control points", fixed(rms_m, 2))
            }
        }
    }

    /// Of pairs that have so many ties each.
    pub fn of_ties(ties_of_pairs: impl Iterator<Item = usize>) -> Self {
        let (mut ties, mut tied, mut pairs) = (0, 0, 0);
        for of_pair in ties_of_pairs {
            ties += of_pair;
            tied += usize::from(of_pair > 0);
            pairs += 1;
        }
        StageLine::Ties { ties, tied, pairs }
    }

    /// From a stage's document; `None` of a text that is none.
    pub fn read(stage: Stage, document: &str) -> Option<Self> {
        Some(match stage {
            Stage::Interior => {
                let read: Frames = serde_json::from_str(document).ok()?;
                StageLine::Interior { usable: read.frames.len(), listed: read.frames_listed }
            }
            Stage::Pairs => {
                let read: Lines = serde_json::from_str(document).ok()?;
                StageLine::Pairs { lines: read.lines.len(), pairs: read.pairs.len() }
            }
            Stage::Ties => {
                let read: Tied = serde_json::from_str(document).ok()?;
                StageLine::of_ties(read.pairs.iter().map(|pair| pair.ties))
            }
            Stage::Relative | Stage::Cameras => {
                let read: Block = serde_json::from_str(document).ok()?;
                let (registered, listed) = (read.frames_registered, read.frames_listed);
                StageLine::Block { registered, listed, rms_px: read.reprojection_rms_px }
            }
            Stage::Gcp => {
                let read: Points = serde_json::from_str(document).ok()?;
                StageLine::Gcp { points: read.points.len(), rms_m: read.gcp_statistics.and_then(|s| s.d.rms) }
            }
        })
    }
}

/// What is read of the document of each stage.
#[derive(Deserialize)]
struct Frames {
    frames: Vec<IgnoredAny>,
    frames_listed: usize,
}

#[derive(Deserialize)]
struct Lines {
    lines: Vec<IgnoredAny>,
    pairs: Vec<IgnoredAny>,
}

#[derive(Deserialize)]
struct Tied {
    pairs: Vec<TiedPair>,
}

#[derive(Deserialize)]
struct TiedPair {
    ties: usize,
}

#[derive(Deserialize)]
struct Block {
    frames_registered: usize,
    frames_listed: usize,
    reprojection_rms_px: Option<f64>,
}

#[derive(Deserialize)]
struct Points {
    points: Vec<IgnoredAny>,
    gcp_statistics: Option<PointStatistics>,
}

#[derive(Deserialize)]
struct PointStatistics {
    d: Distances,
}

#[derive(Deserialize)]
struct Distances {
    rms: Option<f64>,
}
