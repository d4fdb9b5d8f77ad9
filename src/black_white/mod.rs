//! Black and white targets by their shape: checkers, hourglasses and crosses on plates, in grey.
//!
//! Colour says nothing about them, so the place of the colour test is taken by a response to the middle of the target
//! (`response`) at several scales, computed in integers. Where it is strong enough, the examination fits the two lines
//! that cross (`fit`), follows the arms or quarters outwards for the target's size, and gives centre, covariance and
//! score (`examine`).

mod examine;
mod extent;
mod fifth_arm;
pub(crate) mod fit;
pub(crate) mod grey;
pub(crate) mod kernels;
mod polish;
mod response;
mod shade;
mod two_lights;
mod view;

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::profile::{Profile, Shape};
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::{Block, Pixels, RasterInfo};
#[cfg(feature = "coded")]
pub(crate) use examine::once_each;
pub use extent::Seen;
use fifth_arm::Disc;
pub use fit::Fit;
use grey::Plane;
use response::{RINGS, respond};
use std::sync::Arc;

/// What the middle of a target looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Motif {
    /// Four quarters (checker) or two triangles that touch (hourglass).
    Saddle,
    /// Two bars that cross.
    Cross,
}

/// What must lie between the arms of a cross.
#[derive(Clone)]
enum Quarters {
    /// The plate, in all four.
    Clear,
    /// The plate in three; the fourth may hold a strip of the plate's number that runs into the crossing. With the
    /// discs of both rings.
    OneOpen(Arc<[Disc; 2]>),
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
    quarters: Quarters,
    /// Standard deviation of the angle between the lines about a right one, radians.
    skew: f64,
    side_px: (f64, f64),
    /// Least response, grey levels.
    least: u8,
    min_score: f64,
    scales: Vec<Scale>,
    info: RasterInfo,
    finish: Profile,
    /// Looks for crosses with a fifth arm in the same pass.
    fifth: Option<Box<TargetDetector>>,
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
        let detector = TargetDetector {
            motif,
            quarters: Quarters::Clear,
            skew,
            side_px,
            least: (profile.target.min_contrast * 255.0).round() as u8,
            min_score: profile.examine.min_score,
            scales: scales(motif, side_px),
            info: info.clone(),
            finish: profile,
            fifth: None,
        };
        let fifth = (motif == Motif::Cross).then(|| Box::new(detector.fifth_arm()));
        let fifth = fifth.filter(|fifth| !fifth.scales.is_empty());
        Ok(TargetDetector { fifth, ..detector })
    }

    /// The same for crosses with a fifth arm. Cells of single pixels, which are most of the work, are left to those
    /// without: what is seen of the smallest plates lies in cells of two.
    fn fifth_arm(&self) -> TargetDetector {
        TargetDetector {
            motif: self.motif,
            quarters: Quarters::OneOpen(Arc::new(fifth_arm::discs())),
            skew: self.skew,
            side_px: self.side_px,
            least: self.least,
            min_score: self.min_score,
            scales: self.scales.iter().copied().filter(|s| s.level > 0).collect(),
            info: self.info.clone(),
            finish: self.finish.clone(),
            fifth: None,
        }
    }

    /// For places where a target must be: half the contrast and a weak score are enough.
    pub fn relaxed(&self) -> TargetDetector {
        TargetDetector {
            motif: self.motif,
            quarters: self.quarters.clone(),
            skew: self.skew,
            side_px: self.side_px,
            least: (self.least / 2).max(8),
            min_score: self.min_score.min(0.0) - 4.0,
            scales: self.scales.clone(),
            info: self.info.clone(),
            finish: self.finish.clone(),
            fifth: self.fifth.as_ref().map(|fifth| Box::new(fifth.relaxed())),
        }
    }

    /// The measurements behind a candidate's score, with the score; `None` when nothing there can be a target.
    pub fn look(&self, region: &Region, pixels: &dyn Pixels) -> Option<(Seen, f64)> {
        examine::look(self, region, pixels)
    }

    /// Calls `each` with every row of grey cells, at every scale.
    fn each_row(&self, block: &Block, mut each: impl FnMut(&Plane, Scale, usize)) {
        let mut plane = Plane::of_block(block, &self.info);
        for level in 0..=self.levels() {
            if level > 0 {
                plane = plane.halved();
            }
            for &scale in self.scales.iter().filter(|s| s.level == level) {
                (0..plane.height).for_each(|row| each(&plane, scale, row));
            }
        }
    }

    /// Whether one quarter between the arms may be anything.
    fn one_open(&self) -> bool {
        matches!(self.quarters, Quarters::OneOpen(_))
    }

    /// Least response at a scale. Without a quarter leaves and roofs answer in the finest cells a few times as often
    /// as in all others; there half as much again is asked for.
    fn least_at(&self, scale: Scale) -> u8 {
        if self.one_open() && scale.level < 2 { self.least.saturating_add(self.least / 2) } else { self.least }
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

/// Sets the pixels of all cells of a row that answer and are `wanted`, by their columns and rows.
fn mark(
    plane: &Plane,
    scale: Scale,
    row: usize,
    answers: (&[u8], u8),
    mask: &mut Mask,
    wanted: impl Fn((usize, usize)) -> bool,
) {
    let (answers, least) = answers;
    let (size, reach) = (1u64 << scale.level, RINGS[scale.ring].reach);
    let window = mask.window();
    for i in (0..answers.len()).filter(|&i| answers[i] >= least && wanted((reach + i, row))) {
        let (cell_x, cell_y) = (plane.x + (reach + i) as u64, plane.y + row as u64);
        for y in (cell_y * size).max(window.y)..((cell_y + 1) * size).min(window.bottom()) {
            for x in (cell_x * size).max(window.x)..((cell_x + 1) * size).min(window.right()) {
                mask.set(x, y, true);
            }
        }
    }
}

impl Detector for TargetDetector {
    fn halo_px(&self) -> u64 {
        self.scales.iter().map(|s| s.support_px()).max().unwrap_or(0)
    }

    fn segment_block(&self, block: &Block, mask: &mut Mask) {
        let (mut out, mut open) = (Vec::new(), Vec::new());
        self.each_row(block, |plane, scale, row| match &self.quarters {
            Quarters::Clear => {
                respond(plane, &RINGS[scale.ring], row, self.motif, &mut out);
                mark(plane, scale, row, (&out, self.least), mask, |_| true);
            }
            Quarters::OneOpen(discs) => {
                fifth_arm::respond(plane, &RINGS[scale.ring], row, &mut out, &mut open);
                let least = self.least_at(scale);
                mark(plane, scale, row, (&open, least), mask, |at| discs[scale.ring].answers(plane, at, least));
            }
        });
    }

    /// The fifth arms are sought where the crosses are, for little more.
    fn segment_blocks(&self, block: &Block, masks: &mut [Mask]) {
        let (Some(fifth), [first, second]) = (&self.fifth, &mut *masks) else {
            return self.segment_block(block, &mut masks[0]);
        };
        let Quarters::OneOpen(discs) = &fifth.quarters else { return self.segment_block(block, first) };
        let (mut out, mut open) = (Vec::new(), Vec::new());
        self.each_row(block, |plane, scale, row| {
            let ring = &RINGS[scale.ring];
            if fifth.scales.contains(&scale) {
                fifth_arm::respond(plane, ring, row, &mut out, &mut open);
                let least = fifth.least_at(scale);
                mark(plane, scale, row, (&open, least), second, |at| discs[scale.ring].answers(plane, at, least));
            } else {
                respond(plane, ring, row, self.motif, &mut out);
            }
            mark(plane, scale, row, (&out, self.least), first, |_| true);
        });
    }

    fn others(&self) -> Vec<&dyn Detector> {
        self.fifth.iter().map(|fifth| fifth.as_ref() as &dyn Detector).collect()
    }

    fn gate(&self, region: &Region) -> bool {
        region.bounds.width.max(region.bounds.height) <= self.largest_mark_px()
    }

    fn patch_margin_px(&self) -> u64 {
        (extent::REACH_SIDES * self.side_px.1).ceil() as u64 + self.halo_px()
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
