//! The datum: a reconstruction brought to the ground as it is, by a similarity.

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix3, Vector3};

use super::options::RoughPose;
use super::survey::{GroundPoint, Role};
use super::upside_down::{Placing, UpsideDown, upside_down};
use super::{astray, reason};
use crate::error::{Error, Result};
use crate::intersect::{datum, intersect_seen};
use crate::line;
use crate::pose::{Pose, Similarity};
use crate::read::Reconstruction;

/// A reconstruction on the ground, its shape unchanged.
#[derive(Clone, Debug)]
pub struct OnGround {
    pub similarity: Similarity,
    /// Where the rays of each point meet − its survey, metres; `None` of points that fewer than two photographs show.
    pub residuals: Vec<Option<Vector3<f64>>>,
    /// The block seems to be placed as its mirror image.
    pub upside_down: Option<UpsideDown>,
}

/// Seven parameters from the control points (three and more, seen in two photographs each), else from the rough poses,
/// and what they leave at every point, check points too. Nothing is adjusted: a block that is bent shows it here.
///
/// # Errors
/// When neither points nor poses fix the datum.
pub fn on_ground(model: &Reconstruction, points: &[GroundPoint], rough: &[Option<RoughPose>]) -> Result<OnGround> {
    let (model, points) = &astray::without(&astray::frames(model, points), model, points);
    let control: Vec<&GroundPoint> = points.iter().filter(|p| p.role == Role::Control && !p.seen.is_empty()).collect();
    let mut pairs = Pairs::of(model, &control);
    let (similarity, by_gcps) = pairs.place(model, &control, rough)?;
    let left = |p: &GroundPoint| {
        let seen = (p.seen.len() >= 2).then_some(&p.seen)?;
        Some(similarity.apply(&intersect_seen(model, seen)?) - p.xyz)
    };
    let residuals = points.iter().map(left).collect();
    let by = if by_gcps { pairs.placing(&control) } else { placing_positions(model, rough) };
    Ok(OnGround { upside_down: upside_down(model, rough, &similarity, &by), similarity, residuals })
}

/// GCPs where their rays meet in the model, and where they were surveyed.
struct Pairs {
    from: Vec<Vector3<f64>>,
    to: Vec<Vector3<f64>>,
    /// Why they do not place the block.
    refused: Option<Error>,
}

impl Pairs {
    fn of(model: &Reconstruction, control: &[&GroundPoint]) -> Self {
        let meeting = control.iter().filter(|p| p.seen.len() >= 2);
        let meeting = meeting.filter_map(|p| Some((intersect_seen(model, &p.seen)?, p.xyz)));
        let (from, to): (Vec<_>, Vec<_>) = meeting.unzip();
        let refused = in_line(control).or_else(|| unlike(model, control, &from, &to));
        Pairs { from, to, refused }
    }

    /// What brings the model to the ground, the GCPs' rays and surveys, else the rough poses; and whether GCPs do.
    fn place(
        &mut self,
        model: &Reconstruction,
        control: &[&GroundPoint],
        rough: &[Option<RoughPose>],
    ) -> Result<(Similarity, bool)> {
        let count = self.from.len();
        let by_gcps = if count >= 3 && self.refused.is_none() { datum(&self.from, &self.to) } else { None };
        if let Some(similarity) = by_gcps {
            return Ok((similarity, true));
        }
        match (by_rough_poses(model, rough), self.refused.take()) {
            (Some(similarity), _) => Ok((similarity, false)),
            (None, Some(error)) if count >= 3 => Err(error),
            (None, _) => Err(reason::explained(unplaced(model, control, count), model, control)),
        }
    }

    fn placing(self, control: &[&GroundPoint]) -> Placing {
        let mut sigmas: Vec<f64> = control.iter().map(|p| p.sigma.max()).collect();
        Placing { by_gcps: true, from: self.from, to: self.to, sigma_m: upper_median(&mut sigmas).unwrap_or(0.0) }
    }
}

fn placing_positions(model: &Reconstruction, rough: &[Option<RoughPose>]) -> Placing {
    let known = || model.photographs.iter().zip(rough).filter_map(|(p, r)| Some((p, r.as_ref()?)));
    let (from, to) = known().map(|(p, r)| (p.pose.centre, r.pose.centre)).unzip();
    let mut sigmas: Vec<f64> = known().map(|(_, r)| r.sigma_m.max()).collect();
    Placing { by_gcps: false, from, to, sigma_m: upper_median(&mut sigmas).unwrap_or(0.0) }
}

/// What brings the model to the ground: the GCPs' rays and surveys, else the rough poses.
pub(super) fn placing(
    model: &Reconstruction,
    control: &[&GroundPoint],
    rough: &[Option<RoughPose>],
) -> Result<Similarity> {
    Ok(Pairs::of(model, control).place(model, control, rough)?.0)
}

/// What is to be said of GCPs that lie on one line but for what they may err: the block would turn about it as its
/// errors have it. `None` where they spread to the side.
fn in_line(control: &[&GroundPoint]) -> Option<Error> {
    /// A set that is wider against its length is no line, however coarse its points are.
    const NARROW: f64 = 0.05;
    let places: Vec<Vector3<f64>> = control.iter().map(|p| p.xyz).collect();
    let spread = line::spread(&places);
    let squares: f64 = control.iter().map(|p| p.sigma.max().powi(2)).sum();
    let sigma_m = (squares / control.len().max(1) as f64).sqrt();
    if spread.across > line::BY_CHANCE * sigma_m || spread.across > NARROW * spread.along {
        return None;
    }
    Some(Error::no_result(
        format!(
            "all {} GCPs lie on one line as far as their standard deviations tell ({:.2} m beside it, σ {sigma_m:.2} m), \
             and the block may turn about it",
            control.len(),
            spread.across
        ),
        "measure a GCP to the side of it, give positions with --cameras, or state --sigma-ground if they are known better",
    ))
}

/// What is to be said of GCPs that no similarity brings to where the block has them, not even half of them to a tenth
/// of their spread: no block is bent so much. `None` where one does.
fn unlike(
    model: &Reconstruction,
    control: &[&GroundPoint],
    from: &[Vector3<f64>],
    to: &[Vector3<f64>],
) -> Option<Error> {
    const BENT: f64 = 0.1;
    let miss_m = reason::middle_miss(from, to)?;
    let spread_m = line::spread(to).along;
    let sigma_m = control.iter().map(|p| p.sigma.max()).fold(0.0, f64::max);
    if miss_m <= BENT * spread_m || miss_m <= line::BY_CHANCE * sigma_m {
        return None;
    }
    let what = format!(
        "the GCPs lie otherwise than the block has them: half of them are {miss_m:.1} m off or more, spread over \
         {spread_m:.0} m"
    );
    let remedy = "check their coordinates, their CRS, and the names of points and frames";
    Some(reason::explained(Error::no_result(what, remedy), model, control))
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
    let spread = upper_median(&mut sigmas).is_some_and(|sigma_m| line::spread(&to).across > sigma_m);
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
    fn gcps_on_a_line_are_told_by_what_they_may_err() {
        let points = |beside_m: f64, sigma_m: f64| -> Vec<GroundPoint> {
            let point = |i: i32| GroundPoint {
                name: i.to_string(),
                xyz: Vector3::new(50.0 * f64::from(i), beside_m * f64::from(i % 2), 0.1 * beside_m * f64::from(i % 3)),
                sigma: Vector3::repeat(sigma_m),
                role: Role::Control,
                seen: Vec::new(),
            };
            (0..8).map(point).collect()
        };
        let told = |points: &[GroundPoint]| in_line(&points.iter().collect::<Vec<_>>()).map(|e| e.to_string());
        assert!(told(&points(0.05, 0.05)).is_some_and(|line| line.contains("one line")));
        assert!(told(&points(0.0, 0.05)).is_some());
        assert!(told(&points(2.0, 0.05)).is_none());
        // Coarse points of a wide block.
        assert!(told(&points(60.0, 50.0)).is_none());
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
}
