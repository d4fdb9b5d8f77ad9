//! Pixels of a copy of the photograph: what one slip in the whole list would mend.

use super::choice::choose;
use super::resection::Resection;
use super::seen::{Focal, ResectOptions, Seen};
use crate::camera::Camera;

/// Points that fit better, and none of which is called wrong, are not asked.
const MISFIT: f64 = 4.0;
/// A slip explains the misfit of all points where, without it, this part of it is left.
const EXPLAINED: f64 = 0.25;
/// With fewer, anything fits.
const FEWEST: usize = 5;

/// What all pixels are to be multiplied by, where they are those of a frame of half or of twice the size.
pub(super) fn pixels_times(camera: &Camera, seen: &[Seen], options: &ResectOptions, found: &Resection) -> Option<f64> {
    let is_misfit = found.widened > if found.blunders.is_empty() { MISFIT } else { 1.0 };
    if !is_misfit || seen.len() < FEWEST || options.focal == Focal::Sought {
        return None;
    }
    let most = EXPLAINED * squares(found).sqrt();
    let fits = |factor: &f64| {
        let scaled: Vec<Seen> = seen.iter().map(|s| Seen { pixel: s.pixel.map(|v| v * factor), ..s.clone() }).collect();
        if !scaled.iter().all(|s| camera.contains(s.pixel)) {
            return false;
        }
        let other = choose(camera, &scaled, options).best;
        other.is_some_and(|other| {
            let is_no_worse = other.widened < found.widened && other.blunders.len() <= found.blunders.len();
            is_no_worse && squares(&other).sqrt() < most
        })
    };
    [2.0, 0.5].into_iter().find(fits)
}

/// The sum of the squares of all residuals, those of wrong points too; infinite with a point behind the camera.
fn squares(found: &Resection) -> f64 {
    found.residuals_px.iter().map(|r| r.map_or(f64::INFINITY, |[x, y]| x * x + y * y)).sum()
}
