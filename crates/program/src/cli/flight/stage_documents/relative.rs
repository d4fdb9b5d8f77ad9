//! The block before it stands on the ground.

use autoref_flight::read::Photograph;
use serde::Serialize;

use crate::cli::flight::relative::Oriented;
use crate::cli::flight::stage::Stage;
use crate::cli::flight::stage_line::StageLine;

/// The block before it stands on the ground.
#[derive(Debug, Serialize)]
pub struct RelativeStage {
    pub stage: Stage,
    pub made_by: &'static str,
    pub frames_registered: usize,
    pub frames_listed: usize,
    /// Names of frames.
    pub not_registered: Vec<String>,
    pub ties: usize,
    pub image_points: usize,
    /// Image points that were laid upon each other in the frames.
    pub image_points_laid: usize,
    pub reprojection_rms_px: Option<f64>,
    pub frames: Vec<OrientedFrame>,
}

impl RelativeStage {
    pub fn of(oriented: &Oriented, names: &[&str], listed: usize) -> Self {
        let model = &oriented.model;
        let mut squares = vec![(0usize, 0.0f64); model.photographs.len()];
        for tie in &model.ties {
            for (i, pixel) in &tie.seen {
                let photograph = &model.photographs[*i];
                let local = photograph.pose.to_camera(&tie.xyz).into();
                if let Some([x, y]) = model.cameras[photograph.camera].residual(local, *pixel) {
                    squares[*i].0 += 1;
                    squares[*i].1 += x * x + y * y;
                }
            }
        }
        let rms = |(count, sum): (usize, f64)| (count > 0).then(|| (sum / count as f64).sqrt());
        let total = squares.iter().fold((0, 0.0), |(n, s), (count, sum)| (n + count, s + sum));
        let frame = |(p, own): (&Photograph, &(usize, f64))| OrientedFrame {
            name: p.name.clone(),
            ties: own.0,
            rms_px: rms(*own),
            centre: p.pose.centre.into(),
        };
        let lost = names.iter().filter(|n| model.find(n).is_none());
        RelativeStage {
            stage: Stage::Relative,
            made_by: oriented.by.words(),
            frames_registered: model.photographs.len(),
            frames_listed: listed,
            not_registered: lost.map(|name| name.to_string()).collect(),
            ties: model.ties.len(),
            image_points: total.0,
            image_points_laid: oriented.laid,
            reprojection_rms_px: rms(total),
            frames: model.photographs.iter().zip(&squares).map(frame).collect(),
        }
    }

    pub fn line(&self) -> StageLine {
        let (registered, listed) = (self.frames_registered, self.frames_listed);
        StageLine::Block { registered, listed, rms_px: self.reprojection_rms_px }
    }
}

/// A frame of the block: the image points that hold it, and its place in the block's own frame.
#[derive(Debug, Serialize)]
pub struct OrientedFrame {
    pub name: String,
    pub ties: usize,
    pub rms_px: Option<f64>,
    pub centre: [f64; 3],
}
