//! Flight lines, and the pairs that are compared.

use serde::Serialize;

use crate::cli::flight::runs::Plan;
use crate::cli::flight::stage::Stage;
use crate::cli::flight::stage_line::StageLine;

/// Flight lines and pairs. Places are metres: of the adjustment's frame where focal length and directions are known,
/// else the table's.
#[derive(Debug, Serialize)]
pub struct PairsStage {
    pub stage: Stage,
    pub lines: Vec<PlannedLine>,
    pub pairs: Vec<PlannedPair>,
    pub frames: Vec<FramePlace>,
}

impl PairsStage {
    pub fn of(plan: &Plan, names: &[&str]) -> Self {
        let name = |i: usize| names[i].to_string();
        let line_of = |frame: usize| plan.lines.iter().position(|l| l.frames.contains(&frame));
        let pair = |(&(a, b), shared): (&(usize, usize), &Option<f64>)| {
            let along_line = line_of(a) == line_of(b);
            PlannedPair { frames: [name(a), name(b)], along_line, shared: *shared }
        };
        let place = |i: usize| FramePlace {
            name: name(i),
            place_m: plan.places_m[i],
            azimuth_deg: plan.azimuths_rad[i].map(|a| a.to_degrees().rem_euclid(360.0)),
        };
        let lines = plan.lines.iter();
        let lines =
            lines.map(|l| PlannedLine { name: l.name.clone(), frames: l.frames.iter().map(|i| name(*i)).collect() });
        PairsStage {
            stage: Stage::Pairs,
            lines: lines.collect(),
            pairs: plan.pairs.iter().zip(&plan.shared).map(pair).collect(),
            frames: (0..names.len()).map(place).collect(),
        }
    }

    pub fn line(&self) -> StageLine {
        StageLine::Pairs { lines: self.lines.len(), pairs: self.pairs.len() }
    }
}

/// A flight line, its frames in their order.
#[derive(Debug, Serialize)]
pub struct PlannedLine {
    pub name: String,
    pub frames: Vec<String>,
}

/// Two frames that are compared.
#[derive(Debug, Serialize)]
pub struct PlannedPair {
    pub frames: [String; 2],
    pub along_line: bool,
    /// Share of a frame whose ground the other sees too; `None` where it is not known.
    pub shared: Option<f64>,
}

/// Where a frame is thought to stand, and the azimuth of its view.
#[derive(Debug, Serialize)]
pub struct FramePlace {
    pub name: String,
    pub place_m: Option<[f64; 2]>,
    pub azimuth_deg: Option<f64>,
}
