//! What comes of an adjustment: cameras, points and blunders.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::survey::Role;
use crate::bundle::Summary;
use crate::camera::{Camera, Parameter};
use crate::pose::Pose;
use crate::read::Reconstruction;

/// A gross error: the point, the photograph when it is of one image, and by how much.
#[derive(Clone, Debug, PartialEq)]
pub struct Blunder {
    pub gcp: String,
    /// Photograph, or `None` when the point on the ground is wrong.
    pub photograph: Option<usize>,
    /// Estimated error: pixels (x, y) or metres (x, y, z of the world); nothing of an image point that its
    /// camera looks away from.
    pub by: Vec<f64>,
    /// Its size in units of its own standard deviation.
    pub test: f64,
}

/// A GCP after the adjustment.
#[derive(Clone, Debug)]
pub struct AdjustedPoint {
    pub name: String,
    pub role: Role,
    pub xyz: Vector3<f64>,
    /// Adjusted (or, of check points, intersected) − surveyed.
    pub residual: Option<Vector3<f64>>,
    pub covariance: Option<Matrix3<f64>>,
    /// Photograph, residual in pixels (predicted − measured).
    pub image: Vec<(usize, [f64; 2])>,
}

/// A photograph after the adjustment.
#[derive(Clone, Debug)]
pub struct AdjustedCamera {
    pub photograph: usize,
    pub pose: Pose,
    pub covariance: Option<SMatrix<f64, 6, 6>>,
    /// Of its ties, √(mean of squared distances).
    pub rms_px: f64,
    pub ties: usize,
}

/// The result.
#[derive(Clone, Debug)]
pub struct Adjustment {
    pub cameras: Vec<Camera>,
    pub interior_sigmas: Vec<Vec<(Parameter, f64)>>,
    pub photographs: Vec<AdjustedCamera>,
    pub points: Vec<AdjustedPoint>,
    pub blunders: Vec<Blunder>,
    pub tie_rms_px: f64,
    pub tie_mean_px: f64,
    pub sigma_tie_px: f64,
    pub ties: usize,
    pub dropped_ties: usize,
    pub summary: Summary,
    /// The adjusted ties in the world's frame.
    pub model: Reconstruction,
    pub notes: Vec<String>,
}
