//! The camera and the frames.

use serde::Serialize;

use crate::cli::flight::project::Focal;
use crate::cli::flight::relative::Flight;
use crate::cli::flight::stage::Stage;
use crate::cli::flight::stage_line::StageLine;

/// The camera and the frames.
#[derive(Debug, Serialize)]
pub struct InteriorStage {
    pub stage: Stage,
    pub frames_listed: usize,
    pub f_px: Option<f64>,
    pub focal: FocalLength,
    pub pp_px: [f64; 2],
    pub size_px: [f64; 2],
    /// Across and down; `None` where the focal length is not known.
    pub field_of_view_deg: [Option<f64>; 2],
    pub frames: Vec<UsedFrame>,
    /// A line about each frame or mask that is not used.
    pub left_out: Vec<String>,
}

impl InteriorStage {
    pub fn of(flight: &Flight<'_>, listed: usize, left_out: &[String]) -> Self {
        let camera = &flight.project.camera;
        let angle = |size: f64| camera.f_px.map(|f| 2.0 * (size / 2.0 / f).atan().to_degrees());
        let frame = |name: &&str| {
            let masks = flight.masks.of(name);
            let names = masks.iter().filter_map(|mask| Some(mask.file_name()?.to_string_lossy().into_owned()));
            UsedFrame { name: name.to_string(), masks: names.collect() }
        };
        InteriorStage {
            stage: Stage::Interior,
            frames_listed: listed,
            f_px: camera.f_px,
            focal: match (camera.f_px, camera.focal) {
                (None, _) => FocalLength::Sought,
                (Some(_), Focal::Held) => FocalLength::Held,
                (Some(_), Focal::Rough) => FocalLength::Rough,
            },
            pp_px: flight.pp_px(),
            size_px: flight.size_px,
            field_of_view_deg: flight.size_px.map(angle),
            frames: flight.ordered.iter().map(frame).collect(),
            left_out: left_out.to_vec(),
        }
    }

    pub fn line(&self) -> StageLine {
        StageLine::Interior { usable: self.frames.len(), listed: self.frames_listed }
    }
}

/// What the focal length is worth.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FocalLength {
    /// Not known.
    Sought,
    Held,
    Rough,
}

/// A frame that can be used, and the file names of its masks.
#[derive(Debug, Serialize)]
pub struct UsedFrame {
    pub name: String,
    pub masks: Vec<String>,
}
