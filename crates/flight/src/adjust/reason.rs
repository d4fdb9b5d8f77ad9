//! Why GCPs do not fit a block: what one slip in a whole list would mend.

use autoref_raster::ranks::upper_median;
use autoref_raster::units::FOOT_M;
use nalgebra::Vector3;

use super::survey::GroundPoint;
use crate::error::Error;
use crate::intersect::{datum, intersect_seen};
use crate::read::Reconstruction;

/// Fewer GCPs fit anything.
const FEWEST: usize = 5;
/// A slip explains the misfit where, without it, this part of it is left.
const EXPLAINED: f64 = 0.25;
/// How a list may be wrong as a whole.
struct Slip {
    said: &'static str,
    /// Factor of the pixels.
    pixels: f64,
    place: fn(&Vector3<f64>) -> Vector3<f64>,
}

const SLIPS: [Slip; 5] = [
    Slip {
        said: "they would fit if the heights were in feet, brought to metres",
        pixels: 1.0,
        // International and US survey feet are the same here.
        place: |x| Vector3::new(x.x, x.y, x.z * FOOT_M),
    },
    Slip {
        said: "they would fit if the heights were in metres, and plan in feet",
        pixels: 1.0,
        place: |x| Vector3::new(x.x, x.y, x.z / FOOT_M),
    },
    Slip {
        said: "they would fit with easting and northing exchanged",
        pixels: 1.0,
        place: |x| Vector3::new(x.y, x.x, x.z),
    },
    Slip {
        said: "they would fit if they were measured in frames of half the size: double the pixels",
        pixels: 2.0,
        place: |x| *x,
    },
    Slip {
        said: "they would fit if they were measured in frames of twice the size: halve the pixels",
        pixels: 0.5,
        place: |x| *x,
    },
];

/// The middle miss of the GCPs from where the similarity that most agree with has them, metres; `None` of too few.
pub(super) fn middle_miss(from: &[Vector3<f64>], to: &[Vector3<f64>]) -> Option<f64> {
    if from.len() < FEWEST {
        return None;
    }
    let by = datum(from, to)?;
    let mut misses: Vec<f64> = from.iter().zip(to).map(|(a, b)| (by.apply(a) - b).norm()).collect();
    upper_median(&mut misses)
}

/// The one slip that explains why GCPs do not fit.
pub(super) fn guess(model: &Reconstruction, control: &[&GroundPoint]) -> Option<&'static str> {
    let miss = |pixels: f64, place: fn(&Vector3<f64>) -> Vector3<f64>| {
        let meet = |p: &&&GroundPoint| {
            let seen: Vec<_> = p.seen.iter().map(|(i, at)| (*i, at.map(|v| v * pixels))).collect();
            Some((intersect_seen(model, &seen)?, place(&p.xyz)))
        };
        let (from, to): (Vec<_>, Vec<_>) =
            control.iter().filter(|p| p.seen.len() >= 2).filter_map(|p| meet(&p)).unzip();
        // Rays that do not meet any more are no better fit.
        (2 * from.len() > control.len()).then(|| middle_miss(&from, &to)).flatten()
    };
    let as_it_is = miss(1.0, |x| *x).unwrap_or(f64::INFINITY);
    let tried = SLIPS.iter().filter_map(|slip| Some((miss(slip.pixels, slip.place)?, slip.said)));
    tried.filter(|(left, _)| *left < EXPLAINED * as_it_is).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, said)| said)
}

/// A refusal with the slip that explains it as its remedy.
pub(super) fn explained(error: Error, model: &Reconstruction, control: &[&GroundPoint]) -> Error {
    match (error, guess(model, control)) {
        (Error::NoResult { what, .. }, Some(said)) => Error::no_result(what, said),
        (error, _) => error,
    }
}
