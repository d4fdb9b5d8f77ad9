//! Surveyed points, with where they were seen.

use nalgebra::Vector3;
use serde::Serialize;

/// Whether a point takes part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    Control,
    Check,
}

/// A surveyed point in the world's frame, with where it was seen.
#[derive(Clone, Debug)]
pub struct GroundPoint {
    pub name: String,
    pub xyz: Vector3<f64>,
    /// 1σ, metres.
    pub sigma: Vector3<f64>,
    pub role: Role,
    /// Photograph and pixel.
    pub seen: Vec<(usize, [f64; 2])>,
}
