//! Black and white targets by their shape: checkers, hourglasses and crosses on plates, in grey.
//!
//! Colour says nothing about them, so the place of the colour test is taken by a response to the middle of the target
//! (`response`) at several scales, computed in integers. Where it is strong enough, the examination fits the two lines
//! that cross (`fit`), follows the arms or quarters outwards for the target's size, and gives centre, covariance and
//! score (`examine`).

mod examine;
pub(crate) mod fit;
pub(crate) mod grey;
mod kernels;
mod response;

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::profile::{Profile, Shape};
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Pixels, RasterInfo};
pub use examine::Seen;
#[cfg(feature = "coded")]
pub(crate) use examine::once_each;
pub use fit::Fit;
use grey::Plane;
use response::{RINGS, respond};

/// What the middle of a target looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motif {
    /// Four quarters (checker) or two triangles that touch (hourglass).
    Saddle,
    /// Two bars that cross.
    Cross,
}

/// One scale that is looked at: level of halving and ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Scale {
    level: u32,
    ring: usize,
}

impl Scale {
    fn radius_px(self) -> f64 {
        RINGS[self.ring].radius * f64::from(1u32 << self.level)
    }

    /// How far from a pixel of a cell the cell's response can see.
    fn support_px(self) -> u64 {
        (RINGS[self.ring].reach as u64 + 1) << self.level
    }
}

/// Levels of halving that are ever used: the largest ring then reaches 96 px.
const MAX_LEVEL: u32 = 4;

/// Finds black and white targets in a raster.
pub struct TargetDetector {
    motif: Motif,
    /// Standard deviation of the angle between the lines about a right one, radians.
    skew: f64,
    side_px: (f64, f64),
    /// Least response, grey levels.
    least: u8,
    min_score: f64,
    scales: Vec<Scale>,
    info: RasterInfo,
    finish: Profile,
}

impl TargetDetector {
    /// # Errors
    /// [`autoref_raster::Error::Usage`] when the profile is not valid, is one of paint, or gives metres and `gsd_m` is
    /// unknown.
    pub fn new(profile: Profile, info: &RasterInfo, gsd_m: Option<f64>) -> Result<TargetDetector> {
        profile.validate()?;
        let (motif, skew) = match profile.shape {
            Shape::Checker => (Motif::Saddle, 0.15),
            Shape::Hourglass => (Motif::Saddle, 0.5),
            Shape::Cross if profile.is_target() => (Motif::Cross, 0.15),
            _ => {
                return Err(autoref_raster::Error::usage(
                    format!("profile \"{}\" is one of paint, not of a black and white target", profile.name),
                    "give shape = \"checker\", \"hourglass\" or \"cross\" without [colour]",
                ));
            }
        };
        let side_px = profile.side_range_px(gsd_m)?;
        Ok(TargetDetector {
            motif,
            skew,
            side_px,
            least: (profile.target.min_contrast * 255.0).round() as u8,
            min_score: profile.examine.min_score,
            scales: scales(motif, side_px),
            info: info.clone(),
            finish: profile,
        })
    }

    /// For places where a target must be: half the contrast and a weak score are enough.
    pub fn relaxed(&self) -> TargetDetector {
        TargetDetector {
            motif: self.motif,
            skew: self.skew,
            side_px: self.side_px,
            least: (self.least / 2).max(8),
            min_score: self.min_score.min(0.0) - 4.0,
            scales: self.scales.clone(),
            info: self.info.clone(),
            finish: self.finish.clone(),
        }
    }

    /// The measurements behind a candidate's score, with the score; `None` when nothing there can be a target.
    pub fn look(&self, region: &Region, pixels: &dyn Pixels) -> Option<(Seen, f64)> {
        examine::look(self, region, pixels)
    }

    /// Levels of halving that are needed.
    fn levels(&self) -> u32 {
        self.scales.iter().map(|s| s.level).max().unwrap_or(0)
    }
}

/// The rings whose radius suits some target of the range.
///
/// A cross answers when the ring cuts its arms, 1.2 to 2.5 bar widths out; bars are a ninth to a fifth of the plate. A
/// saddle answers on every ring inside it, so small ones serve large targets too; they only need to be larger than the
/// blur.
fn scales(motif: Motif, (low, high): (f64, f64)) -> Vec<Scale> {
    let (from, to) = match motif {
        Motif::Cross => (1.2 * low / 9.0, (2.5 * high / 5.0).min(0.35 * high)),
        Motif::Saddle => (low / 4.0, (0.4 * high).min((0.4 * low).max(22.0))),
    };
    let all = (0..=MAX_LEVEL).flat_map(|level| (0..RINGS.len()).map(move |ring| Scale { level, ring }));
    let fitting: Vec<Scale> = all.clone().filter(|s| (from..=to).contains(&s.radius_px())).collect();
    if !fitting.is_empty() {
        return fitting;
    }
    // Smaller than the smallest ring, larger than the largest, or between two: the nearest.
    let aim = ((from + to) / 2.0).ln();
    let distance = |s: &Scale| (s.radius_px().ln() - aim).abs();
    all.min_by(|a, b| distance(a).total_cmp(&distance(b))).into_iter().collect()
}

/// Sets the pixels of all cells that answer.
fn mark(plane: &Plane, scale: Scale, motif: Motif, least: u8, mask: &mut Mask) {
    let ring = &RINGS[scale.ring];
    let size = 1u64 << scale.level;
    let window = mask.window();
    let mut out = Vec::new();
    for row in 0..plane.height {
        let len = respond(plane, ring, row, motif, &mut out);
        for i in (0..len).filter(|&i| out[i] >= least) {
            let (cell_x, cell_y) = (plane.x + (ring.reach + i) as u64, plane.y + row as u64);
            for y in (cell_y * size).max(window.y)..((cell_y + 1) * size).min(window.bottom()) {
                for x in (cell_x * size).max(window.x)..((cell_x + 1) * size).min(window.right()) {
                    mask.set(x, y, true);
                }
            }
        }
    }
}

impl Detector for TargetDetector {
    fn halo_px(&self) -> u64 {
        self.scales.iter().map(|s| s.support_px()).max().unwrap_or(0)
    }

    fn segment_block(&self, block: &Block, mask: &mut Mask) {
        let mut plane = Plane::of_block(block, &self.info);
        for level in 0..=self.levels() {
            if level > 0 {
                plane = plane.halved();
            }
            for &scale in self.scales.iter().filter(|s| s.level == level) {
                mark(&plane, scale, self.motif, self.least, mask);
            }
        }
    }

    fn gate(&self, region: &Region) -> bool {
        region.bounds.width.max(region.bounds.height) <= self.largest_mark_px()
    }

    fn patch_margin_px(&self) -> u64 {
        (examine::REACH_SIDES * self.side_px.1).ceil() as u64 + self.halo_px()
    }

    fn largest_mark_px(&self) -> u64 {
        // The answers of one target lie about its middle, within the largest ring.
        (self.side_px.1 / 2.0).ceil() as u64 + 2
    }

    fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        examine::examine(self, region, pixels)
    }

    /// A square of the target's side that lies as its lines do.
    fn outline(&self, region: &Region, pixels: &dyn Pixels) -> Option<(PixelPoint, Vec<PixelPoint>)> {
        let (seen, _) = examine::look(self, region, pixels)?;
        let centre = PixelPoint { x: seen.fit.x, y: seen.fit.y };
        let (half, (sin, cos)) = (seen.side_px / 2.0, seen.fit.angles[0].sin_cos());
        let corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(u, v)| PixelPoint { x: centre.x + cos * u - sin * v, y: centre.y + sin * u + cos * v });
        Some((centre, corners.to_vec()))
    }

    fn finish(&self, list: Vec<Candidate>) -> Vec<Candidate> {
        crate::candidate::finish(examine::once_each(list), &self.finish)
    }
}
