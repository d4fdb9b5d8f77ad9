//! Points that a photograph sees, and what is known besides.

use nalgebra::Vector3;

/// A point with its pixel.
#[derive(Clone, Debug)]
pub struct Seen {
    pub name: String,
    pub xyz: Vector3<f64>,
    /// 1σ on the ground, metres; 0 of what is exact.
    pub sigma_m: Vector3<f64>,
    pub pixel: [f64; 2],
}

/// What is known besides the points.
#[derive(Clone, Debug)]
pub struct ResectOptions {
    /// 1σ of the points in the image.
    pub sigma_px: f64,
    /// Known position with standard deviations.
    pub position: Option<(Vector3<f64>, Vector3<f64>)>,
    /// Whether the focal length is sought too.
    pub focal: Focal,
    /// Residuals beyond this many of their own standard deviations name a blunder.
    pub critical: f64,
}

/// Whether the focal length is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Focal {
    Known,
    Sought,
}

impl Focal {
    /// Points that fix a pose, but for the few others that fit as well.
    pub(super) fn fewest(self) -> usize {
        match self {
            Focal::Known => 3,
            Focal::Sought => 4,
        }
    }
}

impl Default for ResectOptions {
    fn default() -> Self {
        ResectOptions { sigma_px: 1.0, position: None, focal: Focal::Known, critical: 4.0 }
    }
}
