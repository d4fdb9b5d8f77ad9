//! The pose that was found, with its accuracy.

use nalgebra::SMatrix;

use crate::camera::Camera;
use crate::pose::Pose;

/// The pose with its accuracy.
#[derive(Clone, Debug)]
pub struct Resection {
    pub camera: Camera,
    pub pose: Pose,
    /// Turn (radians) and centre; `None` without redundancy and prior knowledge.
    pub covariance: Option<SMatrix<f64, 6, 6>>,
    /// Predicted − measured, pixels, of every point in order; `None` behind the camera.
    pub residuals_px: Vec<Option<[f64; 2]>>,
    /// Indices of points that were taken out as blunders.
    pub blunders: Vec<usize>,
    /// Of the points kept: √(mean of the squares of the residuals in x and in y).
    pub rms_px: f64,
    /// √(v'Pv / redundancy) with the σ that were stated; `None` without redundancy.
    pub sigma0: Option<f64>,
    /// How many times as large the deviations are as those that follow from what was stated: √(v'Pv / redundancy) where
    /// it is too large for chance, else 1. It is in `covariance`.
    pub widened: f64,
    /// How far from here a known position lies, metres, where points that can do without it contradict it: it was left
    /// out.
    pub position_off_m: Option<f64>,
    /// Where all pixels times this would fit, and as they are they do not: 2 of those of a frame of half the size.
    pub pixels_times: Option<f64>,
    /// Other poses that the points do not rule out: three allow up to four, more of them fewer.
    pub alternatives: Vec<Alternative>,
}

/// Another pose, with its own focal length where that is sought.
#[derive(Clone, Debug)]
pub struct Alternative {
    pub camera: Camera,
    pub pose: Pose,
    /// Turn (radians) and centre, if this pose is the right one; `None` where two poses fall together.
    pub covariance: Option<SMatrix<f64, 6, 6>>,
}
