//! The second look: where every GCP must be, in a window of its own.
//!
//! The scan's candidates already have sub-pixel centres, so a GCP that has a candidate close to where the transform
//! puts it keeps that one. The others are looked for again in a small window with a detector that takes less for
//! granted: where a mark must be, faint paint is worth believing. Each window is read once; nothing else is.

use rayon::prelude::*;

use crate::candidate::Candidate;
use crate::coords::PixelPoint;
use crate::error::Result;
use crate::pipeline::Detector;
use crate::raster::RasterSource;
use crate::segment::label::Labeller;
use crate::segment::mask::Mask;
use crate::window::Window;

/// Where a GCP is expected.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Index in the list of GCPs.
    pub gcp: usize,
    pub position: PixelPoint,
    /// How far from there the mark's centre may be.
    pub radius_px: f64,
}

/// What the second look saw of one GCP.
#[derive(Clone, Debug)]
pub enum SecondLook {
    /// A candidate of the scan is close enough: its index in the list.
    Kept { candidate: usize },
    /// The window showed a mark that the scan had missed.
    Found(Box<Candidate>),
    /// The window lies in the image and shows no mark.
    NotFound,
    /// The GCP lies outside the image.
    Outside,
}

/// Looks at every expected GCP; the answers are in the order of the question.
///
/// # Errors
/// When a window cannot be read.
pub fn rematch(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    scanned: &[Candidate],
    expected: &[Expected],
) -> Result<Vec<SecondLook>> {
    let look = |expected: &Expected| -> Result<SecondLook> {
        let info = source.info();
        let (x, y) = (expected.position.x, expected.position.y);
        if !(x >= 0.0 && y >= 0.0 && x < info.width as f64 && y < info.height as f64) {
            return Ok(SecondLook::Outside);
        }
        if let Some(candidate) = nearest(scanned.iter(), expected) {
            return Ok(SecondLook::Kept { candidate });
        }
        let found = look_in_window(source, detector, expected)?;
        let best = nearest(found.iter(), expected);
        Ok(best.map_or(SecondLook::NotFound, |i| SecondLook::Found(Box::new(found[i].clone()))))
    };
    if source.info().sequential {
        // From the top down: the reader cannot go back without starting again.
        let mut order: Vec<usize> = (0..expected.len()).collect();
        order.sort_by(|&a, &b| expected[a].position.y.total_cmp(&expected[b].position.y));
        let mut answers = vec![SecondLook::Outside; expected.len()];
        for i in order {
            answers[i] = look(&expected[i])?;
        }
        return Ok(answers);
    }
    expected.par_iter().map(look).collect()
}

fn distance(candidate: &Candidate, expected: &Expected) -> f64 {
    (candidate.centre.x - expected.position.x).hypot(candidate.centre.y - expected.position.y)
}

/// Index of the candidate closest to the expected place, within its radius.
fn nearest<'a>(candidates: impl Iterator<Item = &'a Candidate>, expected: &Expected) -> Option<usize> {
    candidates
        .map(|candidate| distance(candidate, expected))
        .enumerate()
        .filter(|(_, distance)| *distance <= expected.radius_px)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(index, _)| index)
}

fn look_in_window(source: &dyn RasterSource, detector: &dyn Detector, expected: &Expected) -> Result<Vec<Candidate>> {
    let info = source.info();
    let pixel = Window::new(expected.position.x as u64, expected.position.y as u64, 1, 1);
    // A mark centred within the radius must lie whole in the core, or its shape would be cut.
    let half_mark = detector.patch_margin_px() + detector.largest_mark_px().div_ceil(2);
    let core = pixel.grown(expected.radius_px.ceil() as u64 + half_mark, &info.bounds());
    let read = core.grown(detector.halo_px() + detector.patch_margin_px(), &info.bounds());
    let block = source.read(read)?;
    let mut mask = Mask::new(read);
    detector.segment(&block, &mut mask);
    // The whole raster as bounds: what is cut by the core's edge is left open, and dropped.
    let regions = Labeller::new().label(&mask, core, info.bounds(), |region| detector.gate(region)).finished;
    Ok(regions
        .iter()
        .filter_map(|region| {
            let window = region.bounds.grown(detector.patch_margin_px(), &info.bounds());
            detector.examine(region, &block.patch(window, info))
        })
        .collect())
}
