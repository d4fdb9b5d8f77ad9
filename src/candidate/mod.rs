//! From [`crate::segment::label::Region`] to [`Candidate`]: cheap integer gates first, then an examination of the
//! pixels of what is left.
//!
//! ```
//! use autoref_stream::georef::candidate_list::read_csv;
//! let folder = tempfile::tempdir().expect("a temporary folder");
//! let list = folder.path().join("candidates.csv");
//! std::fs::write(&list, "x,y,score\n120.25,80.5,17\n").expect("writable");
//! let candidates = read_csv(&list)?; // what `detect` writes; x and y are enough
//! assert_eq!((candidates[0].centre.x, candidates[0].score), (120.25, Some(17.0)));
//! # Ok::<(), autoref_raster::Error>(())
//! ```

mod code;
pub(crate) mod descent;
#[cfg(test)]
mod drawn;
mod even;
pub mod evidence;
pub mod examine;
mod figure;
pub mod fit;
pub mod gates;
mod half_turn;
mod hull;
pub(crate) mod inside;
mod jpeg_fit;
mod jpeg_noise;
mod jpeg_planes;
mod jpeg_steps;
pub mod kernels;
mod lights;
mod local;
mod looks;
mod paint_share;
mod pierced;
pub(crate) mod pixel_set;
pub mod prototype_options;
pub mod scene;
pub mod score;
mod shadow;
pub mod split;
pub(crate) mod standing;
mod two_lights;
mod two_lights_jpeg;
mod uncertainty;
mod whole;
pub(crate) mod worn;

use serde::{Deserialize, Serialize};

use autoref_raster::coords::PixelPoint;

pub use code::Code;
pub use examine::{examine, patch_margin_px};
pub use gates::Gates;
pub use prototype_options::finish;

/// A region that may be a mark.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Candidate {
    /// Sub-pixel centre.
    pub centre: PixelPoint,
    /// Covariance of the centre in px²: xx, xy, yy. `None` when unknown (a list from elsewhere).
    pub covariance_px2: Option<[f64; 3]>,
    /// Log-likelihood ratio of "mark" against "background"; higher is better. `None` when unknown.
    pub score: Option<f64>,
    /// Pixels of paint.
    pub area_px: Option<f64>,
    /// Bounding box side lengths, px.
    pub size_px: Option<[f64; 2]>,
    /// Height of the elevation model at the centre, metres, when a list brings it.
    pub elevation_m: Option<f64>,
    /// What a coded target (ArUco, AprilTag) says of itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
    /// Colour of the paint where it is least mixed, sRGB 0..=255; `None` of what is not paint or came from a list.
    #[serde(skip)]
    pub paint: Option<[u8; 3]>,
}

/// What has less area than this is only a part of a mark beside these marks: a field of a chequer, the lit half. Of no
/// marks 0.
pub fn least_whole_area_px<'a>(marks: impl Iterator<Item = &'a Candidate>) -> f64 {
    /// Of the area that three quarters have: marks may be of two sizes.
    const PART: f64 = 0.6;
    let mut areas: Vec<f64> = marks.filter_map(|mark| mark.area_px).collect();
    areas.sort_by(f64::total_cmp);
    areas.get(areas.len() / 4).map_or(0.0, |small| PART * small)
}

impl Candidate {
    /// One of which only the place is known.
    pub fn at(centre: PixelPoint) -> Candidate {
        Candidate {
            centre,
            covariance_px2: None,
            score: None,
            area_px: None,
            size_px: None,
            elevation_m: None,
            code: None,
            paint: None,
        }
    }

    /// Probability that it is a mark, when mark and background are as likely beforehand: 1 / (1 + e^−score). `None`
    /// without a score.
    pub fn probability(&self) -> Option<f64> {
        self.score.map(|score| 1.0 / (1.0 + (-score).exp()))
    }
}
