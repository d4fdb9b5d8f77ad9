//! The datum: a reconstruction brought to the ground as it is, by a similarity.

use nalgebra::{Matrix3, Vector3};

use super::{GroundPoint, Role, RoughPose, astray};
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
    let (model, points) = &astray::without(&astray::frames(model, points), model, points);
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
    move_by.ok_or_else(|| unplaced(model, control, from.len()))
}

/// Why the GCPs, of which the rays of so many meet, do not place the block.
fn unplaced(model: &Reconstruction, control: &[&GroundPoint], meeting: usize) -> Error {
    const MORE: &str = "measure more GCPs in the images, or give rough positions and directions with --cameras";
    let several: Vec<&&GroundPoint> = control.iter().filter(|p| p.seen.len() >= 2).collect();
    if several.len() == meeting || several.len() < 3 {
        let line = if meeting >= 3 { ", and they lie on one line" } else { "" };
        let what = format!("{} GCPs are seen in two photographs or more{line}", several.len());
        return Error::no_result(format!("{what}; 3 are needed to place the block, off one line"), MORE);
    }
    let mut counts = vec![0; model.photographs.len()];
    for p in several.iter().filter(|p| intersect_seen(model, &p.seen).is_none()) {
        p.seen.iter().for_each(|(frame, _)| counts[*frame] += 1);
    }
    // The first of equals.
    let most = (0..counts.len()).max_by_key(|i| (counts[*i], std::cmp::Reverse(*i)));
    let name = most.map_or("", |i| model.photographs[i].name.as_str());
    Error::no_result(
        format!(
            "of {} GCPs that two photographs or more show, the rays of {meeting} meet in front of the cameras; 3 are \
             needed to place the block, off one line",
            several.len()
        ),
        format!("check the poses of the frames, that of {name} first, or leave such frames out"),
    )
}

/// Positions that spread in two directions; else positions and directions together: the rotation is the middle of the
/// directions', scale and shift are those of the positions.
fn by_rough_poses(model: &Reconstruction, rough: &[Option<RoughPose>]) -> Option<Similarity> {
    let all = || model.photographs.iter().zip(rough).filter_map(|(p, r)| Some((&p.pose, r.as_ref()?)));
    let pairs: Vec<(&Pose, &Pose)> =
        all().filter(|(_, r)| r.sigma_rad.is_finite()).map(|(p, r)| (p, &r.pose)).collect();
    let (from, to): (Vec<_>, Vec<_>) = all().map(|(p, r)| (p.centre, r.pose.centre)).unzip();
    let mut sigmas: Vec<f64> = all().map(|(_, r)| r.sigma_m.max()).collect();
    sigmas.sort_by(f64::total_cmp);
    let spread = sigmas.get(sigmas.len() / 2).is_some_and(|sigma_m| across_m(&to) > *sigma_m);
    if pairs.len() < 2 || spread {
        let by_positions = (from.len() >= 3).then(|| datum(&from, &to)).flatten();
        if by_positions.is_some() || pairs.len() < 2 {
            return by_positions;
        }
    }
    by_poses(&pairs)
}

/// The similarity that brings poses to others: the rotation is the middle of the directions', scale and shift are those
/// of the places. `None` where all places are one.
pub(crate) fn by_poses(pairs: &[(&Pose, &Pose)]) -> Option<Similarity> {
    let rotation = middle_rotation(pairs);
    let n = pairs.len() as f64;
    let mean =
        |f: &dyn Fn(&(&Pose, &Pose)) -> Vector3<f64>| pairs.iter().map(f).fold(Vector3::zeros(), |a, b| a + b) / n;
    let (mm, mr) = (mean(&|p| p.0.centre), mean(&|p| p.1.centre));
    let (mut up, mut down) = (0.0, 0.0);
    for (m, r) in pairs {
        let turned = rotation * (m.centre - mm);
        up += turned.dot(&(r.centre - mr));
        down += turned.norm_squared();
    }
    let scale = up / down;
    (scale.is_finite() && scale > 0.0).then(|| Similarity { scale, rotation, shift: mr - rotation * mm * scale })
}

/// How far positions lie beside the line that fits them best, root mean square.
fn across_m(positions: &[Vector3<f64>]) -> f64 {
    let n = positions.len().max(1) as f64;
    let mean = positions.iter().sum::<Vector3<f64>>() / n;
    let about: Matrix3<f64> = positions.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut moments: [f64; 3] = about.symmetric_eigenvalues().into();
    moments.sort_by(f64::total_cmp);
    (moments[1].max(0.0) / n).sqrt()
}

/// The turn from the model to the ground that half of the directions agree on: Weiszfeld's steps towards the rotation
/// with the least sum of distances, which directions turned the other way do not pull along (R. Hartley, K. Aftab, J.
/// Trumpf, "L1 rotation averaging using the Weiszfeld algorithm", 2011; here of chordal distances).
fn middle_rotation(pairs: &[(&Pose, &Pose)]) -> Matrix3<f64> {
    /// Distances below this weigh alike.
    const ALIKE: f64 = 0.05;
    const STEPS: usize = 20;
    // R_rough ≈ R_model Qᵀ → Q ≈ R_roughᵀ R_model.
    let each: Vec<Matrix3<f64>> = pairs.iter().map(|(m, r)| r.rotation.transpose() * m.rotation).collect();
    let mean = |weight: &dyn Fn(&Matrix3<f64>) -> f64| {
        crate::pose::orthonormal(&each.iter().map(|q| q * weight(q)).sum::<Matrix3<f64>>())
    };
    (0..STEPS).fold(mean(&|_| 1.0), |middle, _| mean(&|q| 1.0 / (q - middle).norm().max(ALIKE)))
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;
    use crate::pose::YawPitchRoll;

    fn down(yaw_deg: f64, centre: [f64; 3]) -> Pose {
        Pose::looking(Vector3::from(centre), YawPitchRoll { yaw_deg, pitch_deg: -80.0, roll_deg: 0.0 })
    }

    #[test]
    fn directions_turned_the_other_way_do_not_pull_the_middle_along() {
        let model: Vec<Pose> = (0..9).map(|i| down(0.5 * f64::from(i), [f64::from(i), 0.0, 0.0])).collect();
        // The ground is turned by 40°; four of nine directions are half a turn off.
        let rough: Vec<Pose> = model
            .iter()
            .enumerate()
            .map(|(i, p)| {
                let yaw_deg = p.yaw_pitch_roll().yaw_deg - 40.0 + if i % 2 == 1 { 180.0 } else { 0.0 };
                down(yaw_deg, [0.0; 3])
            })
            .collect();
        let pairs: Vec<(&Pose, &Pose)> = model.iter().zip(&rough).collect();
        let truth = rough[0].rotation.transpose() * model[0].rotation;
        let turn = Rotation3::from_matrix(&(middle_rotation(&pairs).transpose() * truth));
        assert!(turn.angle().to_degrees() < 1.0, "{}", turn.angle().to_degrees());
    }

    #[test]
    fn positions_in_a_row_have_no_width() {
        let row: Vec<Vector3<f64>> = (0..5).map(|i| Vector3::new(100.0 * f64::from(i), 0.0, 500.0)).collect();
        assert!(across_m(&row) < 1e-6);
        let two: Vec<Vector3<f64>> =
            row.iter().flat_map(|p| [p - Vector3::y() * 30.0, p + Vector3::y() * 30.0]).collect();
        assert!((across_m(&two) - 30.0).abs() < 1e-6);
    }
}
