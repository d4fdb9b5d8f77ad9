//! The share of paint in each pixel about a region, against the ground around it, and the shape that fits it best.

use nalgebra::{Matrix3, Vector3};

use super::fit::{Fit, Priors, fit, start_cost};
use super::kernels::{Form, Sample, Samples};
use super::scene::{Ground, Scene};
use crate::profile::Shape;

/// The fit sees this far outside the region.
const FIT_REACH_PX: usize = 4;
/// And this far inside: deeper pixels of a large mark say nothing about its place.
const FIT_DEPTH_PX: usize = 6;
/// The fit starts from the centroid of what is so near.
const START_REACH_PX: usize = 2;

/// Fisher's direction from ground to paint.
pub(super) struct Across {
    direction: Vector3<f64>,
    /// Of the mean ground along it.
    origin: f64,
    /// Mahalanobis distance between the two.
    pub contrast: f64,
}

impl Across {
    pub(super) fn between(ground: &Ground, plateau: Vector3<f64>) -> Across {
        // Sensor noise and JPEG: 3 levels, so that flat ground does not make the direction arbitrary.
        let noise = ground.covariance + Matrix3::identity() * 9.0;
        let step = plateau - ground.mean;
        let inverse = noise.cholesky().map_or_else(Matrix3::identity, |c| c.inverse());
        let direction = inverse * step;
        let contrast2 = direction.dot(&step).max(1e-9);
        let origin = direction.dot(&ground.mean) / contrast2;
        Across { direction: direction / contrast2, origin, contrast: contrast2.sqrt() }
    }

    /// Share of paint in each pixel: 0 on the mean ground, 1 on the plateau.
    pub(super) fn shares(&self, scene: &Scene<'_>) -> Vec<f64> {
        scene.along(self.direction, self.origin)
    }
}

pub(super) fn best_fit(scene: &Scene<'_>, shares: &[f64], shape: Shape, ground_sd: f64, rms_limit: f64) -> Option<Fit> {
    let mut samples = Samples::default();
    let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
    let hidden = scene.beside_other().minus(&scene.own);
    let near = |reach_px: usize| scene.own.grown(reach_px).and(&scene.valid).minus(&hidden);
    let middle = |i: usize| ((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
    for i in near(FIT_REACH_PX).minus(&scene.own.shrunk(FIT_DEPTH_PX)).iter() {
        let (x, y) = middle(i);
        samples.push(Sample { x, y, share: shares[i] });
    }
    for i in near(START_REACH_PX).iter() {
        let ((x, y), s) = (middle(i), shares[i].clamp(0.0, 1.0));
        sum += s;
        sx += s * x;
        sy += s * y;
    }
    if sum < 1.0 {
        return None;
    }
    let start = (sx / sum, sy / sum);
    let side = sum.sqrt();
    let aspect = if matches!(shape, Shape::Any | Shape::Square | Shape::Disc) { 0.1 } else { 0.4 };
    let priors =
        Priors { aspect, blur: 0.4, blur_px: 1.2, height: 0.3, slope: 0.02, ground_sd: ground_sd.clamp(0.01, 0.5) };
    // A square's angle repeats after a quarter turn. The form and angle that fit best before any descent are descended
    // from; for the centre it does not matter when a small blurred disc is taken for a square.
    let quarter = std::f64::consts::FRAC_PI_8;
    let starts =
        (0..4).map(|k| (Form::Rectangle, f64::from(k) * quarter, side)).chain([(Form::Disc, 0.0, side * 1.128)]);
    let nearest = |starts: &mut dyn Iterator<Item = (Form, f64, f64)>| {
        starts
            .map(|s| (start_cost(s.0, &samples, start, s.2, s.1, &priors), s))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, s)| s)
    };
    let fitted = |(form, angle, side): (Form, f64, f64)| fit(form, &samples, start, side, angle, priors, rms_limit);
    let allowed = |s: &(Form, f64, f64)| match shape {
        Shape::Square => s.0 == Form::Rectangle,
        Shape::Disc => s.0 == Form::Disc,
        _ => true,
    };
    let chosen = nearest(&mut starts.clone().filter(allowed))?;
    let first = fitted(chosen)?;
    if chosen.0 != Form::Disc || shape == Shape::Disc || first.rms > rms_limit {
        return Some(first);
    }
    // Half covered, a square lies as near to a disc as to itself.
    let square = nearest(&mut starts.filter(|s| s.0 == Form::Rectangle)).and_then(fitted);
    Some(square.filter(|square| square.rms < first.rms).unwrap_or(first))
}
