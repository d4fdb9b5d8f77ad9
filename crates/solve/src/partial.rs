//! Seven parameters from points that are known in full, only in plan or only in height.
//!
//! After K. Kraus, "Photogrammetry: Geometry from Images and Laser Scans", vol. 1, 2nd edition, 2007: each known
//! coordinate of a point is one observation equation. The iteration starts from the similarity in the plane, without
//! roll and pitch, so the model must stand upright within some degrees, as orthophotos and elevation models do.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use crate::absolute::{PointPair, Undetermined};

const MOST_ITERATIONS: usize = 100;
/// Steps shorter than this, relative to the size of the figure, are rounding.
const SETTLED: f64 = 1e-12;
/// Observations that seven parameters need.
const UNKNOWNS: usize = 7;

/// Which coordinates of the target are known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    /// All three.
    Full,
    /// Easting and northing.
    Plan,
    /// Height alone.
    Height,
}

impl Known {
    fn axes(self) -> std::ops::Range<usize> {
        match self {
            Known::Full => 0..3,
            Known::Plan => 0..2,
            Known::Height => 2..3,
        }
    }
}

/// A point with what is known of it. Coordinates of the target that are not known are not looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlPoint {
    /// The point in both systems.
    pub pair: PointPair,
    /// Which of its target's coordinates count.
    pub known: Known,
    /// Relative to the other points; 1 for all counts them alike.
    pub weight: f64,
}

/// A settled adjustment: target = scale · rotation · model + translation.
#[derive(Clone, Debug, PartialEq)]
pub struct PartialAdjustment {
    /// From model axes to target axes.
    pub rotation: Matrix3<f64>,
    /// Target units per model unit.
    pub scale: f64,
    /// Where the model's origin lies, target units.
    pub translation: Vector3<f64>,
    /// Target − computed for each axis; `None` where the target is not known.
    pub residuals: Vec<[Option<f64>; 3]>,
    /// Steps until nothing changed.
    pub iterations: usize,
    /// √(Σ weight · residual² / (observations − 7)); `None` without redundancy.
    pub sigma0: Option<f64>,
}

/// Adjusts the seven parameters.
///
/// # Errors
/// [`Undetermined::TooFewPoints`] with fewer than two points in plan, three heights or seven observations;
/// [`Undetermined::Degenerate`] when they leave a parameter open (heights along a line) or a weight is no positive
/// number; [`Undetermined::NotConverged`] when the steps do not die down.
pub fn adjust(points: &[ControlPoint]) -> Result<PartialAdjustment, Undetermined> {
    let plan: Vec<&ControlPoint> = points.iter().filter(|p| p.known != Known::Height).collect();
    let heights: Vec<&ControlPoint> = points.iter().filter(|p| p.known != Known::Plan).collect();
    let observations = 2 * plan.len() + heights.len();
    if plan.len() < 2 || heights.len() < 3 || observations < UNKNOWNS {
        return Err(Undetermined::TooFewPoints);
    }
    if points.iter().any(|p| !(p.weight > 0.0 && p.weight.is_finite())) {
        return Err(Undetermined::Degenerate);
    }
    // About the middle of what is known, so that eastings of millions lose no digits.
    let mean = |of: &[&ControlPoint], side: fn(&PointPair) -> Vector3<f64>| {
        of.iter().map(|p| side(&p.pair)).sum::<Vector3<f64>>() / of.len() as f64
    };
    let centre = mean(&plan, |p| p.model);
    let mut origin = mean(&plan, |p| p.target);
    origin.z = mean(&heights, |p| p.target).z;
    let model: Vec<Vector3<f64>> = points.iter().map(|p| p.pair.model - centre).collect();
    let target: Vec<Vector3<f64>> = points.iter().map(|p| p.pair.target - origin).collect();
    let (mut scale, mut rotation) = upright(points, &model, &target)?;
    let size = scale * (model.iter().map(Vector3::norm_squared).sum::<f64>() / model.len() as f64).sqrt();
    let mut shift = Vector3::zeros();
    for iteration in 1..=MOST_ITERATIONS {
        let mut normal = SMatrix::<f64, 7, 7>::zeros();
        let mut right = SVector::<f64, 7>::zeros();
        for ((point, m), t) in points.iter().zip(&model).zip(&target) {
            let turned = scale * (rotation * m);
            let misfit = t - turned - shift;
            let mut rows = SMatrix::<f64, 3, 7>::zeros();
            rows.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(size);
            rows.fixed_view_mut::<3, 1>(0, 3).copy_from(&turned);
            rows.fixed_view_mut::<3, 3>(0, 4).copy_from(&-turned.cross_matrix());
            for axis in point.known.axes() {
                let row = rows.row(axis);
                normal += point.weight * row.transpose() * row;
                right += point.weight * misfit[axis] * row.transpose();
            }
        }
        let step = normal.cholesky().ok_or(Undetermined::Degenerate)?.solve(&right);
        if !step.iter().all(|s| s.is_finite()) {
            return Err(Undetermined::Degenerate);
        }
        // A long step is cut: half a radian, or half of the scale.
        let longest = step.fixed_rows::<4>(3).amax();
        let step = if longest > 0.5 { step * (0.5 / longest) } else { step };
        shift += size * Vector3::new(step[0], step[1], step[2]);
        scale *= 1.0 + step[3];
        rotation = Rotation3::from_scaled_axis(Vector3::new(step[4], step[5], step[6])).into_inner() * rotation;
        if step.norm() < SETTLED {
            let rotation = Rotation3::from_matrix(&rotation).into_inner();
            let residuals: Vec<[Option<f64>; 3]> = points
                .iter()
                .zip(model.iter().zip(&target))
                .map(|(point, (m, t))| {
                    let misfit = t - scale * (rotation * m) - shift;
                    std::array::from_fn(|axis| point.known.axes().contains(&axis).then_some(misfit[axis]))
                })
                .collect();
            let squares: f64 = points
                .iter()
                .zip(&residuals)
                .map(|(p, r)| p.weight * r.iter().flatten().map(|v| v * v).sum::<f64>())
                .sum();
            let freedom = observations - UNKNOWNS;
            return Ok(PartialAdjustment {
                rotation,
                scale,
                translation: origin + shift - scale * (rotation * centre),
                residuals,
                iterations: iteration,
                sigma0: (freedom > 0).then(|| (squares / freedom as f64).sqrt()),
            });
        }
    }
    Err(Undetermined::NotConverged)
}

/// Scale and turn about the vertical from the points that are known in plan.
fn upright(
    points: &[ControlPoint],
    model: &[Vector3<f64>],
    target: &[Vector3<f64>],
) -> Result<(f64, Matrix3<f64>), Undetermined> {
    let (mut along, mut across, mut square) = (0.0, 0.0, 0.0);
    for ((_, m), t) in points.iter().zip(model).zip(target).filter(|((p, _), _)| p.known != Known::Height) {
        along += m.x * t.x + m.y * t.y;
        across += m.x * t.y - m.y * t.x;
        square += m.x * m.x + m.y * m.y;
    }
    let length = along.hypot(across);
    if !(square > 0.0 && length > 0.0 && length.is_finite()) {
        return Err(Undetermined::Degenerate);
    }
    Ok((length / square, Rotation3::from_axis_angle(&Vector3::z_axis(), across.atan2(along)).into_inner()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kraus;

    fn points(known: impl Fn(usize) -> Known, noise: f64) -> (Vec<ControlPoint>, Matrix3<f64>) {
        let rotation = Rotation3::from_euler_angles(0.03, -0.05, 2.0).into_inner();
        let models = [
            [0.0, 0.0, 0.0],
            [900.0, 10.0, 30.0],
            [40.0, 700.0, -20.0],
            [300.0, 200.0, 90.0],
            [600.0, 500.0, 10.0],
            [100.0, 900.0, 5.0],
        ];
        let made = models.iter().enumerate().map(|(i, m)| {
            let model = Vector3::from(*m);
            let error = noise * Vector3::new((i as f64).sin(), (2.0 * i as f64).cos(), (3.0 * i as f64).sin());
            let target = 0.5 * (rotation * model) + Vector3::new(570_000.0, 7_032_000.0, 80.0) + error;
            ControlPoint { pair: PointPair { model, target }, known: known(i), weight: 1.0 }
        });
        (made.collect(), rotation)
    }

    #[test]
    fn points_known_in_full_are_krauss_adjustment() {
        let (points, _) = points(|_| Known::Full, 0.4);
        let pairs: Vec<PointPair> = points.iter().map(|p| p.pair).collect();
        let (ours, kraus) = (adjust(&points).expect("settles"), kraus::adjust(&pairs).expect("settles"));
        assert!((ours.rotation - kraus.orientation.rotation).norm() < 1e-9);
        assert!((ours.scale - kraus.orientation.scale).abs() < 1e-11);
        assert!((ours.sigma0.expect("redundant") - kraus.sigma0.expect("redundant")).abs() < 1e-9);
    }

    #[test]
    fn plan_and_height_apart_determine_what_was_put_in_and_the_unknown_is_not_looked_at() {
        let known = |i: usize| [Known::Plan, Known::Plan, Known::Height, Known::Height, Known::Height, Known::Plan][i];
        let (mut points, rotation) = points(known, 0.0);
        for point in &mut points {
            match point.known {
                Known::Plan => point.pair.target.z = f64::NAN,
                Known::Height => (point.pair.target.x, point.pair.target.y) = (f64::NAN, f64::NAN),
                Known::Full => {}
            }
        }
        let solved = adjust(&points).expect("nine observations");
        assert!((solved.rotation - rotation).norm() < 1e-9, "{}", solved.rotation);
        assert!((solved.scale - 0.5).abs() < 1e-11);
        assert_eq!(solved.residuals[0][2], None);
        assert_eq!(solved.residuals[2][0], None);
        assert_eq!(adjust(&points[..3]).err(), Some(Undetermined::TooFewPoints));
    }

    #[test]
    fn a_heavy_point_is_met() {
        let (mut points, _) = points(|_| Known::Full, 0.4);
        let before = adjust(&points).expect("settles").residuals[3][0].expect("known").abs();
        points[3].weight = 1e6;
        assert!(adjust(&points).expect("settles").residuals[3][0].expect("known").abs() < before / 100.0);
    }
}
