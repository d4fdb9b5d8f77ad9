//! Space resection: the pose of one photograph from points of known place.
//!
//! Three points give up to four poses (Grunert 1841, as in Haralick et al. 1994, *Review and Analysis of Solutions of
//! the Three Point Perspective Pose Estimation Problem*, eq. 9). Those of all triples are refined by least squares, and
//! the minimum that the points speak for most is taken.

mod choice;
mod refine;
mod resection;
mod seen;
mod slip;
mod testing;
mod three_points;

use nalgebra::Vector3;

pub use self::resection::{Alternative, Resection};
pub use self::seen::{Focal, ResectOptions, Seen};
pub use self::three_points::three_points;
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::line;
use autoref_raster::words::counted;

/// Whether nothing but the errors of the points lies beside one line, or one place. By their σ on the ground, and by
/// that in the image as large as the ground is there.
fn are_in_line(seen: &[Seen], sigma_px: f64) -> bool {
    let places: Vec<Vector3<f64>> = seen.iter().map(|s| s.xyz).collect();
    let pixels: Vec<Vector3<f64>> = seen.iter().map(|s| Vector3::new(s.pixel[0], s.pixel[1], 0.0)).collect();
    let (ground, image) = (line::spread(&places), line::spread(&pixels));
    let sigma_m = (seen.iter().map(|s| s.sigma_m.max().powi(2)).sum::<f64>() / seen.len() as f64).sqrt();
    let metres_per_px = if image.along > 0.0 { ground.along / image.along } else { 0.0 };
    ground.across <= (line::BY_CHANCE * sigma_m).hypot(sigma_px * metres_per_px).max(1e-3 * ground.along)
}

/// Finds the pose; wrong points are named.
///
/// # Errors
/// With fewer than three points (four when the focal length is sought), with points on one line and no position, or
/// when no pose sees them.
pub fn resect(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Result<Resection> {
    let least = options.focal.fewest();
    if seen.len() < least {
        return Err(Error::no_result(
            format!("{} seen in the frame, {least} are needed", counted(seen.len(), "point is", "points are")),
            match options.focal {
                Focal::Known => "measure more points",
                Focal::Sought => "measure more points, or state the focal length",
            },
        ));
    }
    let in_line = || {
        Error::no_result(
            "the points lie on one line, or at one place, as far as their standard deviations tell: the camera may be \
             anywhere on a circle about it",
            "measure a point to the side of it, or give --position",
        )
    };
    // A place beside the line fixes the turn about it.
    if options.position.is_none() && are_in_line(seen, options.sigma_px) {
        return Err(in_line());
    }
    let choice::Choice { best, is_open } = choice::choose(camera, seen, options);
    let best = best.map(|found| Resection { pixels_times: slip::pixels_times(camera, seen, options, &found), ..found });
    best.ok_or_else(|| {
        if are_in_line(seen, options.sigma_px) {
            return in_line();
        }
        if is_open {
            return Error::no_result("the points leave the focal length open", "give it: --f-px, or --camera");
        }
        Error::no_result(
            "no pose sees the points where they were measured",
            "check the focal length, the order of the coordinates and whether pixels count from the upper left corner",
        )
    })
}
