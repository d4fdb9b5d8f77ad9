//! The finder of 2017, step by step: threshold, corners, constellation of the jaws, hole by distance.
//!
//! After chapter 8 of a master's thesis on the aerial photographs of Svalbard of 1936 (2017; equations 8.2 to 8.15).
//! Lengths that it gives in pixels of its scans are held as lengths on the film, so that scans of other sizes work. Its
//! detector of oriented gradients had to be trained by hand; where it asks that detector, the correlation of the drawn
//! mark is asked here. The constellation is taken from the camera's geometry instead of an annotated picture. What
//! follows (names, agreement between marks, interior orientation) is that of the default finder.

mod corners;
mod hole;
mod threshold;

use super::frame::{FindOptions, Finder};
use super::interior::{Pose, distance, fit_pose};
use super::picture::Picture;
use super::remeasure::{Measured, located, placed};
use super::search::{Peak, search};
use super::template::Linear;
use super::types::{FrameResult, MarkKind};
use super::window::{Grey, around, read_grey};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::mask::morphology::{closed, complement};
use autoref_raster::mask::{Element, Mask};
use autoref_raster::window::Window;
use corners::Constellation;

/// Pixel of the scans that the constants were chosen for, millimetres.
const PIXEL_MM: f64 = 0.0135;
/// Blur before the histogram and before corners and hole, pixels.
const BLUR_PX: f64 = 4.1;
const FINE_BLUR_PX: f64 = 1.1;
/// Smallest feature that is no noise, pixels².
const FEATURE_PX2: f64 = 100.0;
/// Of the closing, pixels.
const CLOSING_PX: f64 = 2.0;
/// Side of the patch that must be darker than its box, pixels.
const PATCH_PX: f64 = 30.0;
/// Mean level of a very dark box, of 255.
const DARK: f32 = 10.0;
/// Half the side of the area in which the hole is looked for, pixels: around a constellation, and around the detector's
/// place.
const HOLE_PX: f64 = 20.0;
const FAR_HOLE_PX: f64 = 50.0;

/// A reference point before it is corrected.
#[derive(Clone, Copy)]
struct Predicted {
    at: PixelPoint,
    by_detector: bool,
    equalised: bool,
}

impl Finder {
    /// The marks of one scan by the finder of 2017.
    ///
    /// # Errors
    /// Those of reading the scan; [`Error::Usage`] for a camera with other marks than three-toothed ones.
    pub(super) fn find_as_in_2017(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        result: &mut FrameResult,
    ) -> Result<()> {
        if let Some(other) = self.camera.marks.iter().find(|m| !matches!(m.kind, MarkKind::ThreeTooth { .. })) {
            return Err(Error::usage(
                format!("the finder of 2017 knows three-toothed marks only; {} is another", other.name),
                "leave --finder away",
            ));
        }
        let info = source.info();
        let middle = PixelPoint { x: 0.5 * info.width as f64, y: 0.5 * info.height as f64 };
        let (turn_deg, mirrored) = self.orientations(options)[0];
        let pixel_um = self.pixel_sizes_um(source, options)[0];
        let assumed = Pose::about(self.centre, middle, 1e3 / pixel_um, turn_deg, mirrored);
        let mut measured = vec![];
        for k in 0..self.film.len() {
            measured.push(self.mark_as_in_2017(source, options, k, &assumed, result)?);
        }
        let points = placed(&self.film, &located(&self.film, &measured, |_| true));
        let mut pose = fit_pose(&points, mirrored).unwrap_or(assumed);
        let naming = self.name_marks(options, &mut pose, &mut measured, &[]);
        result.notes.extend(naming.note);
        self.judge(options, &pose, &measured, naming.doubt, result);
        Ok(())
    }

    fn mark_as_in_2017(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        k: usize,
        assumed: &Pose,
        result: &mut FrameResult,
    ) -> Result<Option<Measured>> {
        let info = source.info();
        let (half_x, half_y) =
            (0.5 * options.box_share * info.width as f64, 0.5 * options.box_share * info.height as f64);
        let Some(window) = around(assumed.apply(self.film[k]), half_x, half_y, &info.bounds()) else { return Ok(None) };
        let linear = assumed.shape_linear(self.turns_deg[k]);
        let picture = Picture::new(self.model(k), linear);
        let detected = search(source, window, &picture, 1)?.first().copied();
        let mut grey = read_grey(source, window, 1)?;
        grey.data.iter_mut().for_each(|v| *v *= 255.0);
        source.release(window);
        let constellation = Constellation::of(&self.camera.marks[k].kind, linear);
        let reach_px = self.model(k).radius_mm() * assumed.px_per_mm();
        let Some(predicted) = predict(&grey, assumed.px_per_mm(), &constellation, detected, reach_px) else {
            return Ok(None);
        };
        if predicted.equalised {
            result.notes.push(format!("{}: equalised before the threshold", self.camera.marks[k].name));
        }
        Ok(Some(correct(&grey, assumed.px_per_mm(), predicted, detected)))
    }
}

/// The reference point from the constellation of the jaws, with the tests of 8.3.5: what fails one is equalised and
/// tried again; what fails then too is where the detector says.
fn predict(
    grey: &Grey,
    px_per_mm: f64,
    constellation: &Constellation,
    detected: Option<Peak>,
    reach_px: f64,
) -> Option<Predicted> {
    let mean = |w: &mut dyn Iterator<Item = f32>| {
        let (sum, n) = w.fold((0.0f64, 0u32), |(s, n), v| (s + f64::from(v), n + 1));
        sum / f64::from(n.max(1))
    };
    let all = mean(&mut grey.data.iter().copied());
    let half = (0.5 * PATCH_PX * PIXEL_MM * px_per_mm).max(2.0);
    let passes = |at: &PixelPoint| {
        let [x, y] = grey.from_scan(*at);
        let range = |c: f64, n: usize| ((c - half).max(0.0) as usize).min(n)..((c + half).max(0.0) as usize).min(n);
        let (columns, rows) = (range(x, grey.width), range(y, grey.height));
        let patch = mean(&mut rows.flat_map(|j| columns.clone().map(move |i| grey.at(i, j))));
        detected.is_none_or(|d| distance(d.centre, *at) <= reach_px) && patch < all
    };
    let ways: &[Way] = if all < f64::from(DARK) { &[Way::VeryDark] } else { &[Way::AsScanned, Way::Equalised] };
    for &way in ways {
        let mask = thresholded(grey, px_per_mm, way);
        let smooth = smoothed(&mask, FINE_BLUR_PX * PIXEL_MM * px_per_mm);
        let points = corners::corners(&smooth, mask.window().width as usize, PIXEL_MM * px_per_mm);
        let found = constellation.find(&points).map(|p| grey.to_scan(p[0], p[1])).filter(passes);
        if let Some(at) = found {
            return Some(Predicted { at, by_detector: false, equalised: way != Way::AsScanned });
        }
    }
    detected.map(|d| Predicted { at: d.centre, by_detector: true, equalised: true })
}

/// How the levels of a scan come to a threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// As they are, unless they have but one peak.
    AsScanned,
    /// Every level as frequent as the others.
    Equalised,
    /// The same of a frame that is very dark.
    VeryDark,
}

/// What is darker than the valley after the mark's peak, without noise.
fn thresholded(grey: &Grey, px_per_mm: f64, way: Way) -> Mask {
    let unit = PIXEL_MM * px_per_mm;
    let blurred = |values: &[f32]| {
        let mut out = values.to_vec();
        super::window::blur(&mut out, grey.width, grey.height, (BLUR_PX * unit).max(0.5));
        out
    };
    let mut levels = blurred(&grey.data);
    let mut histogram = threshold::histogram(&levels);
    let single = threshold::peaks(&histogram) <= 1;
    let equalise = way != Way::AsScanned || single;
    if equalise {
        levels = blurred(&threshold::equalised(&grey.data));
        histogram = threshold::histogram(&levels);
    }
    let limit = match way {
        Way::VeryDark => threshold::flat_after_peak(&histogram),
        _ if equalise => threshold::valley(&histogram, threshold::Peak::Anywhere),
        _ => threshold::valley(&histogram, threshold::Peak::InTheDark),
    };
    let mut mask = Mask::new(Window::whole(grey.width as u64, grey.height as u64));
    for (n, v) in levels.iter().enumerate() {
        if v.round() < f32::from(limit) {
            mask.set((n % grey.width) as u64, (n / grey.width) as u64, true);
        }
    }
    let least = (FEATURE_PX2 * unit * unit).ceil() as u64;
    let mut other = complement(&without_small(&mask, least));
    other = complement(&without_small(&other, least));
    closed(&other, &Element::disc(((CLOSING_PX * unit).round() as u32).max(1)))
}

/// Removes 8-connected regions of fewer than `least_px2` pixels.
fn without_small(mask: &Mask, least_px2: u64) -> Mask {
    let window = mask.window();
    let mut seen = Mask::new(window);
    let mut out = mask.clone();
    for (x, y) in (window.y..window.bottom()).flat_map(|y| (window.x..window.right()).map(move |x| (x, y))) {
        if !mask.get(x, y) || seen.get(x, y) {
            continue;
        }
        seen.set(x, y, true);
        let mut region = vec![(x, y)];
        let mut next = 0;
        while let Some(&(x, y)) = region.get(next) {
            next += 1;
            for v in y.saturating_sub(1).max(window.y)..(y + 2).min(window.bottom()) {
                for u in x.saturating_sub(1).max(window.x)..(x + 2).min(window.right()) {
                    if mask.get(u, v) && !seen.get(u, v) {
                        seen.set(u, v, true);
                        region.push((u, v));
                    }
                }
            }
        }
        if (region.len() as u64) < least_px2 {
            region.iter().for_each(|&(u, v)| out.set(u, v, false));
        }
    }
    out
}

fn smoothed(mask: &Mask, sigma: f64) -> Vec<f32> {
    let w = mask.window();
    let mut values: Vec<f32> = (0..w.width * w.height).map(|n| f32::from(mask.get(n % w.width, n / w.width))).collect();
    super::window::blur(&mut values, w.width as usize, w.height as usize, sigma.max(0.5));
    values
}

/// The middle of the hole near the predicted point, or that point itself where none is seen.
fn correct(grey: &Grey, px_per_mm: f64, predicted: Predicted, detected: Option<Peak>) -> Measured {
    let unit = PIXEL_MM * px_per_mm;
    let half = if predicted.by_detector { FAR_HOLE_PX } else { HOLE_PX } * unit;
    let found = hole::hole(grey, predicted.at, half, unit);
    let reason = match (found, predicted.by_detector) {
        (None, _) => Some("its hole is not seen: placed by its shape".to_owned()),
        (Some(_), true) => Some("its jaws are not found: placed by correlation".to_owned()),
        (Some(_), false) => None,
    };
    Measured {
        centre: found.unwrap_or(predicted.at),
        covariance_px2: None,
        score: detected.map_or(0.0, |d| d.score),
        misfit: None,
        noise: None,
        body: Some(predicted.at),
        reason,
    }
}

/// Shape → scan of a place.
fn to_scan(linear: Linear, u: f64, v: f64) -> [f64; 2] {
    [linear[0] * u + linear[1] * v, linear[2] * u + linear[3] * v]
}
