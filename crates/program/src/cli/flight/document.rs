//! What `flight solve`, `flight adjust` and `flight resect` found, as the JSON documents that they write.

mod block;
mod camera;
mod resected;
mod said;

use autoref_flight::world::World;
use nalgebra::{Matrix3, Vector3};

pub use block::{BlockCamera, CamerasDocument, FrameDifference, LineRecord, PointRecord, RoughDifferences};
#[cfg(test)]
pub use camera::CameraRecord;
pub use resected::ResectionDocument;

/// A difference at a place of the world's frame, turned into the axes of the map: metres.
pub fn in_map(world: &World, at: &Vector3<f64>, difference: &Vector3<f64>) -> [f64; 3] {
    let grid = world.to_map(at).and_then(|m| world.grid(m)).unwrap_or_else(Matrix3::identity);
    (grid.transpose() * difference).into()
}

/// The length of a difference, in its unit.
pub fn length(difference: &[f64; 3]) -> f64 {
    difference.iter().map(|v| v * v).sum::<f64>().sqrt()
}
