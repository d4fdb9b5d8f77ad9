//! The refinement: where every GCP must be, in a window of its own.
//!
//! The scan's candidates already have sub-pixel centres, so a GCP that has a candidate close to where the transform
//! puts it keeps that one. The others are looked for again in a small window with a detector that takes less for
//! granted: where a mark must be, faint paint is worth believing. Each window is read once; nothing else is.
//!
//! ```
//! use autoref_raster::coords::PixelPoint;
//! use autoref_stream::pipeline::PaintDetector;
//! use autoref_stream::profile::Profile;
//! use autoref_raster::RasterSource;
//! use autoref_raster::memory::MemorySource;
//! use autoref_stream::rematch::{Expected, Refinement, rematch};
//! let bare_ground = MemorySource::rgb8(64, 64, vec![90; 64 * 64 * 3]);
//! let detector = PaintDetector::new(Profile::load("orange")?, bare_ground.info(), None)?;
//! let at = |x: f64| Expected { gcp: 0, position: PixelPoint { x, y: 32.0 }, radius_px: 4.0 };
//! let seen = rematch(&bare_ground, &detector, &[], &[], &[at(32.0), at(900.0)])?;
//! assert!(matches!(seen[..], [Refinement::NotFound, Refinement::Outside]));
//! # Ok::<(), autoref_raster::Error>(())
//! ```

use rayon::prelude::*;

use crate::candidate::Candidate;
use crate::candidate::standing::Standing;
use crate::detector::Detector;
use crate::segment::label::{Labeller, Region};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::mask::Mask;
use autoref_raster::ranks::upper_median;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, View};

/// Where a GCP is expected.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// Index in the list of GCPs.
    pub gcp: usize,
    pub position: PixelPoint,
    /// How far from there the mark's centre may be.
    pub radius_px: f64,
}

/// What the refinement saw of one GCP.
#[derive(Clone, Debug)]
pub enum Refinement {
    /// A candidate of the scan is close enough: its index in the list.
    Kept { candidate: usize },
    /// The window showed a mark that the scan had missed.
    Found(Box<Candidate>),
    /// The window lies in the image and shows no mark.
    NotFound,
    /// The GCP lies outside the image.
    Outside,
}

/// How many times the detector may be made stricter for marks that are still missing.
const STRICTER_LOOKS: usize = 4;

/// Looks at every expected GCP; the answers are in the order of the question. Marks that are `taken` by other GCPs are
/// none of theirs, whether the scan or a window shows them.
///
/// What the detector does not see is looked for again with stricter ones ([`Detector::stricter`]): on a red roof the
/// first sees one large region of paint, a stricter one the mark.
///
/// # Errors
/// When a window cannot be read.
pub fn rematch(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    scanned: &[Candidate],
    taken: &[Candidate],
    expected: &[Expected],
) -> Result<Vec<Refinement>> {
    let size_px = (source.info().width as f64, source.info().height as f64);
    let (free, elsewhere) = (Free::among(scanned, taken), marks_elsewhere(scanned, taken));
    let taken = of_marks(taken);
    let known = |expected: &Expected| {
        if !is_inside(expected.position, size_px) {
            return Refinement::Outside;
        }
        free.nearest(expected).map_or(Refinement::NotFound, |candidate| Refinement::Kept { candidate })
    };
    let mut answers: Vec<Refinement> = expected.iter().map(known).collect();
    let windows = Windows { source, taken: &taken, elsewhere: &elsewhere };
    windows.look_again(detector, expected, &mut answers)?;
    let mut stricter: Option<Box<dyn Detector>> = None;
    for _ in 0..STRICTER_LOOKS {
        // A detector costs a table of colours: none is made for nothing.
        if !answers.iter().any(|a| matches!(a, Refinement::NotFound)) {
            break;
        }
        let Some(next) = stricter.as_deref().unwrap_or(detector).stricter() else { break };
        windows.look_again(next.as_ref(), expected, &mut answers)?;
        stricter = Some(next);
    }
    Ok(answers)
}

/// Whole marks of the scan, about as large as those that are taken and measured to a pixel. One that lies within the
/// radius of a place was kept; what a window shows of another one is a piece of a mark that lies elsewhere.
fn marks_elsewhere(scanned: &[Candidate], taken: &[Candidate]) -> Standing {
    const ALIKE: f64 = 3.0;
    let mut areas: Vec<f64> = taken.iter().filter_map(|mark| mark.area_px).collect();
    let usual_px = upper_median(&mut areas);
    let is_mark = |candidate: &&Candidate| {
        let alike = candidate
            .area_px
            .zip(usual_px)
            .is_some_and(|(area_px, usual_px)| (usual_px / ALIKE..=usual_px * ALIKE).contains(&area_px));
        alike && candidate.covariance_px2.is_some_and(|[xx, _, yy]| xx.max(yy) <= 1.0)
    };
    let mut standing = Standing::default();
    standing.add(scanned.iter().filter(is_mark));
    standing
}

/// Where windows are looked in, and the marks that are none of theirs.
struct Windows<'a> {
    source: &'a dyn RasterSource,
    taken: &'a Standing,
    elsewhere: &'a Standing,
}

impl Windows<'_> {
    /// Looks in the windows of all that is still missing.
    fn look_again(&self, detector: &dyn Detector, expected: &[Expected], answers: &mut [Refinement]) -> Result<()> {
        let Windows { source, taken, elsewhere } = self;
        let mut missing: Vec<usize> =
            (0..expected.len()).filter(|&i| matches!(answers[i], Refinement::NotFound)).collect();
        let look = |&i: &usize| -> Result<(usize, Refinement)> {
            let mut found = look_in_window(*source, detector, &expected[i])?;
            found.retain(|candidate| !elsewhere.any_around(candidate));
            let best = Free::of(&found, taken).nearest(&expected[i]);
            Ok((i, best.map_or(Refinement::NotFound, |best| Refinement::Found(Box::new(found[best].clone())))))
        };
        let found: Vec<(usize, Refinement)> = if source.info().sequential {
            // From the top down: the reader cannot go back without starting again.
            missing.sort_by(|&a, &b| expected[a].position.y.total_cmp(&expected[b].position.y));
            missing.iter().map(look).collect::<Result<_>>()?
        } else {
            missing.par_iter().map(look).collect::<Result<_>>()?
        };
        for (i, answer) in found {
            answers[i] = answer;
        }
        Ok(())
    }
}

fn distance(candidate: &Candidate, expected: &Expected) -> f64 {
    (candidate.centre.x - expected.position.x).hypot(candidate.centre.y - expected.position.y)
}

/// Whether a place is in an image of this width and height.
pub(crate) fn is_inside(place: PixelPoint, (width, height): (f64, f64)) -> bool {
    place.x >= 0.0 && place.y >= 0.0 && place.x < width && place.y < height
}

fn of_marks(taken: &[Candidate]) -> Standing {
    let mut standing = Standing::default();
    standing.add(taken.iter());
    standing
}

/// Candidates that are of no mark which is taken, with their indices.
pub(crate) struct Free<'a>(Vec<(usize, &'a Candidate)>);

impl<'a> Free<'a> {
    pub(crate) fn among(candidates: &'a [Candidate], taken: &[Candidate]) -> Free<'a> {
        Free::of(candidates, &of_marks(taken))
    }

    fn of(candidates: &'a [Candidate], taken: &Standing) -> Free<'a> {
        Free(candidates.iter().enumerate().filter(|(_, candidate)| !taken.any_like(candidate)).collect())
    }

    /// Index of the candidate closest to the expected place, within its radius. A centre that is known less well than
    /// the place where it is looked for is none.
    pub(crate) fn nearest(&self, expected: &Expected) -> Option<usize> {
        let is_known = |candidate: &Candidate| {
            candidate.covariance_px2.is_none_or(|[xx, _, yy]| xx.max(yy) <= expected.radius_px * expected.radius_px)
        };
        let known = self.0.iter().filter(|(_, candidate)| is_known(candidate));
        let near = known.map(|(index, candidate)| (*index, distance(candidate, expected)));
        near.filter(|(_, distance)| *distance <= expected.radius_px)
            .min_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(index, _)| index)
    }
}

/// Leaves a mark that several GCPs want to the one it is nearest to, whatever their order in the list.
pub(crate) fn one_gcp_each(expected: &[Expected], scanned: &[Candidate], answers: &mut [Refinement]) {
    let mark = |answer: &Refinement| match answer {
        Refinement::Kept { candidate } => Some(scanned[*candidate].clone()),
        Refinement::Found(mark) => Some((**mark).clone()),
        Refinement::NotFound | Refinement::Outside => None,
    };
    let mut wanted: Vec<(f64, usize, Candidate)> = Vec::new();
    for (i, answer) in answers.iter().enumerate() {
        wanted.extend(mark(answer).map(|mark| (distance(&mark, &expected[i]), i, mark)));
    }
    wanted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut standing = Standing::default();
    for (_, i, mark) in wanted {
        if standing.any_like(&mark) {
            answers[i] = Refinement::NotFound;
        } else {
            standing.add(std::iter::once(&mark));
        }
    }
}

/// Whether a scan with this detector would see a mark about a place.
///
/// # Errors
/// When the window cannot be read.
pub(crate) fn shows_a_mark(
    source: &dyn RasterSource,
    detector: &dyn Detector,
    position: PixelPoint,
    radius_px: f64,
) -> Result<bool> {
    let expected = Expected { gcp: 0, position, radius_px };
    let seen = look_in_window(source, detector, &expected)?;
    Ok(seen.iter().any(|candidate| distance(candidate, &expected) <= radius_px))
}

fn look_in_window(source: &dyn RasterSource, detector: &dyn Detector, expected: &Expected) -> Result<Vec<Candidate>> {
    let info = source.info();
    let pixel = Window::new(expected.position.x as u64, expected.position.y as u64, 1, 1);
    // A mark centred within the radius must lie whole in the core, or its shape would be cut.
    let half_mark = detector.patch_margin_px() + detector.largest_mark_px().div_ceil(2);
    let core = pixel.grown(expected.radius_px.ceil() as u64 + half_mark, &info.bounds());
    let read = core.grown(detector.halo_px() + detector.patch_margin_px(), &info.bounds());
    let block = source.read(read)?;
    let found = |detector: &dyn Detector| {
        let mut mask = Mask::new(read);
        detector.segment(&block, &mut mask);
        // The whole raster as bounds: what is cut by the core's edge is left open, and dropped.
        let regions = Labeller::new().label(&mask, core, info.bounds(), |region| detector.gate(region)).finished;
        let refined = |region: &Region| {
            let window = region.bounds.grown(detector.patch_margin_px(), &info.bounds());
            detector.refine(region, &View { block: &block, window, info })
        };
        regions.iter().flat_map(refined).collect::<Vec<_>>()
    };
    let mut candidates = found(detector);
    let mut standing = Standing::default();
    standing.add(candidates.iter());
    let others = detector.others().into_iter().flat_map(found);
    let others: Vec<Candidate> = others.filter(|candidate| !standing.any_before(candidate)).collect();
    standing.add(others.iter());
    candidates.extend(others);
    candidates.retain(|candidate| !standing.any_around(candidate));
    Ok(candidates)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_centre_that_is_known_less_well_than_its_place_is_none() {
        let at = |x: f64, sigma_px: f64| Candidate {
            covariance_px2: Some([sigma_px * sigma_px, 0.0, 0.01]),
            ..Candidate::at(PixelPoint { x, y: 50.0 })
        };
        let expected = Expected { gcp: 0, position: PixelPoint { x: 50.0, y: 50.0 }, radius_px: 6.0 };
        let nearest = |candidates: &[Candidate]| Free::among(candidates, &[]).nearest(&expected);
        assert_eq!(nearest(&[at(51.0, 334.0), at(52.0, 0.3)]), Some(1));
        assert_eq!(nearest(&[at(51.0, 334.0)]), None);
        assert_eq!(nearest(&[Candidate::at(expected.position)]), Some(0), "of a list without deviations");
    }

    fn mark(x: f64) -> Candidate {
        let at = Candidate::at(PixelPoint { x, y: 50.0 });
        Candidate { area_px: Some(100.0), size_px: Some([10.0, 10.0]), ..at }
    }

    fn expect(gcp: usize, x: f64) -> Expected {
        Expected { gcp, position: PixelPoint { x, y: 50.0 }, radius_px: 30.0 }
    }

    #[test]
    fn a_mark_that_is_taken_is_no_other_gcps() {
        let scanned = [mark(50.0), mark(70.0)];
        assert_eq!(Free::among(&scanned, &[mark(50.2)]).nearest(&expect(0, 52.0)), Some(1));
        assert_eq!(Free::among(&scanned, &[]).nearest(&expect(0, 52.0)), Some(0));
    }

    #[test]
    fn the_nearer_of_two_gcps_has_the_mark_whichever_comes_first() {
        let scanned = [mark(50.0)];
        let kept = Refinement::Kept { candidate: 0 };
        for (first, second) in [(kept.clone(), Refinement::Found(Box::new(mark(50.1)))), (kept.clone(), kept)] {
            for (places, nearer) in [([58.0, 51.0], 1), ([51.0, 58.0], 0)] {
                let expected = [expect(0, places[0]), expect(1, places[1])];
                let mut answers = [first.clone(), second.clone()];
                one_gcp_each(&expected, &scanned, &mut answers);
                assert!(matches!(answers[1 - nearer], Refinement::NotFound), "{answers:?}");
                assert!(!matches!(answers[nearer], Refinement::NotFound), "{answers:?}");
            }
        }
    }
}
