//! Errors over the deviations that are stated of them.

use autoref_flight::adjust::{Adjustment, GroundPoint};
use autoref_flight::read::Reconstruction;
use nalgebra::Rotation3;

/// Sums of squares of errors over stated deviations, and how many: of directions, positions, interior and points.
#[derive(Default)]
pub struct Normalised([(f64, usize); 4]);

impl Normalised {
    /// Whether deviations were stated at all.
    pub fn add(&mut self, found: &Adjustment, truth: &Reconstruction, points: &[GroundPoint]) -> bool {
        if found.photographs.iter().any(|a| a.covariance.is_none()) {
            assert!(found.notes.iter().any(|note| note.contains("no covariances")), "{:?}", found.notes);
            return false;
        }
        let mut add = |k: usize, error: f64, sigma: f64| {
            self.0[k].0 += (error / sigma).powi(2);
            self.0[k].1 += 1;
        };
        for (a, b) in found.photographs.iter().zip(&truth.photographs) {
            let c = a.covariance.expect("all frames have one");
            let turn = Rotation3::from_matrix_unchecked(a.pose.rotation * b.pose.rotation.transpose()).scaled_axis();
            for i in 0..3 {
                add(0, turn[i], c[(i, i)].sqrt());
                add(1, a.pose.centre[i] - b.pose.centre[i], c[(i + 3, i + 3)].sqrt());
            }
        }
        for (p, s) in &found.interior_sigmas[0] {
            add(2, found.cameras[0].get(*p) - truth.cameras[0].get(*p), *s);
        }
        for (a, b) in found.points.iter().zip(points) {
            let c = a.covariance.expect("the datum is fixed");
            for i in 0..3 {
                add(3, a.xyz[i] - b.xyz[i], c[(i, i)].sqrt());
            }
        }
        true
    }

    pub fn rms(&self) -> [f64; 4] {
        self.0.map(|(sum, n)| (sum / n as f64).sqrt())
    }
}
