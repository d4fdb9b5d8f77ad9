//! How a block is adjusted, and what is known of it beside its images and points.

use nalgebra::Vector3;

use crate::camera::Parameter;
use crate::pose::Pose;

/// What becomes of the interior orientation, by parameter; what is not named is held.
#[derive(Clone, Debug)]
pub struct AdjustOptions {
    /// 1σ of GCPs in the image.
    pub sigma_image_px: f64,
    /// 1σ of ties in the image; `None` takes it from their residuals.
    pub sigma_tie_px: Option<f64>,
    /// Where the ties come from.
    pub ties: TiesFrom,
    /// What their residuals say of ties is no less than this: windows of two frames that are laid upon each other agree
    /// more closely than they show the same ground.
    pub least_sigma_tie_px: f64,
    /// Parameters, with a standard deviation about the value given, or free.
    pub interior: Vec<(Parameter, Option<f64>)>,
    /// Known poses in the world's frame: position with σ (metres), and direction with σ (radians).
    pub rough: Vec<Option<RoughPose>>,
    /// Normalised residuals beyond this name a blunder.
    pub critical: f64,
}

/// What ties are made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TiesFrom {
    /// They were measured in the images, and say how good the lens is.
    Images,
    /// They stand for the poses of a reconstruction, which its lens made: of the lens they say nothing.
    Poses,
}

/// A pose known roughly.
#[derive(Clone, Copy, Debug)]
pub struct RoughPose {
    pub pose: Pose,
    pub sigma_m: Vector3<f64>,
    pub sigma_rad: f64,
}

impl Default for AdjustOptions {
    fn default() -> Self {
        AdjustOptions {
            sigma_image_px: 1.0,
            sigma_tie_px: None,
            ties: TiesFrom::Images,
            least_sigma_tie_px: 0.02,
            interior: vec![(Parameter::F, None), (Parameter::K1, None)],
            rough: Vec::new(),
            critical: 4.0,
        }
    }
}
