//! The datum: a reconstruction brought to the ground as it is, by a similarity.

use nalgebra::{Matrix3, Vector3};

use super::{GroundPoint, Role, RoughPose};
use crate::error::{Error, Result};
use crate::intersect::{datum, intersect_seen};
use crate::pose::{Pose, Similarity};
use crate::read::Reconstruction;

/// A reconstruction on the ground, its shape unchanged.
#[derive(Clone, Debug)]
pub struct OnGround {
    pub similarity: Similarity,
    /// Where the rays of each point meet − its survey, metres; `None` of points that fewer than two photographs show.
    pub residuals: Vec<Option<Vector3<f64>>>,
}

/// Seven parameters from the control points (three and more, seen in two photographs each), else from the rough poses,
/// and what they leave at every point, check points too. Nothing is adjusted: a block that is bent shows it here.
///
/// # Errors
/// When neither points nor poses fix the datum.
pub fn on_ground(model: &Reconstruction, points: &[GroundPoint], rough: &[Option<RoughPose>]) -> Result<OnGround> {
    let control: Vec<&GroundPoint> = points.iter().filter(|p| p.role == Role::Control && !p.seen.is_empty()).collect();
    let similarity = placing(model, &control, rough)?;
    let left = |p: &GroundPoint| {
        let seen = (p.seen.len() >= 2).then_some(&p.seen)?;
        Some(similarity.apply(&intersect_seen(model, seen)?) - p.xyz)
    };
    Ok(OnGround { similarity, residuals: points.iter().map(left).collect() })
}

/// What brings the model to the ground: the GCPs' rays and surveys, else the rough poses.
pub(super) fn placing(
    model: &Reconstruction,
    control: &[&GroundPoint],
    rough: &[Option<RoughPose>],
) -> Result<Similarity> {
    let (mut from, mut to) = (Vec::new(), Vec::new());
    for p in control.iter().filter(|p| p.seen.len() >= 2) {
        if let Some(x) = intersect_seen(model, &p.seen) {
            from.push(x);
            to.push(p.xyz);
        }
    }
    let mut move_by = if from.len() >= 3 { datum(&from, &to) } else { None };
    if move_by.is_none() {
        move_by = by_rough_poses(model, rough);
    }
    move_by.ok_or_else(|| {
        Error::no_result(
            format!(
                "{} GCPs are seen in two photographs or more and off one line; 3 are needed to place the block",
                from.len()
            ),
            "measure more GCPs in the images, or give rough positions and directions with --cameras",
        )
    })
}

/// Positions and directions together: the rotation is the mean of the directions', scale and shift are those of the
/// positions. Without directions, positions off one line.
fn by_rough_poses(model: &Reconstruction, rough: &[Option<RoughPose>]) -> Option<Similarity> {
    let all = || model.photographs.iter().zip(rough).filter_map(|(p, r)| Some((&p.pose, r.as_ref()?)));
    let pairs: Vec<(&Pose, &Pose)> =
        all().filter(|(_, r)| r.sigma_rad.is_finite()).map(|(p, r)| (p, &r.pose)).collect();
    if pairs.len() < 2 {
        let (from, to): (Vec<_>, Vec<_>) = all().map(|(p, r)| (p.centre, r.pose.centre)).unzip();
        return (from.len() >= 3).then(|| datum(&from, &to)).flatten();
    }
    // R_rough ≈ R_model Qᵀ → Q ≈ R_roughᵀ R_model.
    let sum = pairs.iter().map(|(m, r)| r.rotation.transpose() * m.rotation).fold(Matrix3::zeros(), |a, b| a + b);
    let rotation = crate::pose::orthonormal(&sum);
    let n = pairs.len() as f64;
    let mean =
        |f: &dyn Fn(&(&Pose, &Pose)) -> Vector3<f64>| pairs.iter().map(f).fold(Vector3::zeros(), |a, b| a + b) / n;
    let (mm, mr) = (mean(&|p| p.0.centre), mean(&|p| p.1.centre));
    let (mut up, mut down) = (0.0, 0.0);
    for (m, r) in &pairs {
        let turned = rotation * (m.centre - mm);
        up += turned.dot(&(r.centre - mr));
        down += turned.norm_squared();
    }
    let scale = up / down;
    (scale.is_finite() && scale > 0.0).then(|| Similarity { scale, rotation, shift: mr - rotation * mm * scale })
}
