//! The 7-parameter adjustment by iteration: least squares of scale, rotation and translation, with covariances.
//!
//! After K. Kraus, "Photogrammetry: Geometry from Images and Laser Scans", vol. 1, 2nd edition, 2007: the observation
//! equations are linearised about approximate values and solved again until nothing changes. Kraus takes the
//! approximate values from the affine transform through four points. Those of an orthophoto nearly lie in a plane,
//! where that transform does not exist; so they are taken here from the triangle of the three most widely spread
//! points, by the method of B. K. P. Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987,
//! section 2.A.
//!
//! It ends at the least-squares solution, which is [`super::absolute::Method::Umeyama`]; what it adds is the
//! covariance.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use super::absolute::{AbsoluteOrientation, Centred, PointPair, Undetermined};

/// Steps before giving up; good approximate values need three to six.
const MOST_ITERATIONS: usize = 50;

/// Steps shorter than this, relative to the size of the figure, are rounding.
const SETTLED: f64 = 1e-12;

/// A settled adjustment.
#[derive(Clone, Debug, PartialEq)]
pub struct Adjustment {
    /// The transform with its residuals.
    pub orientation: AbsoluteOrientation,
    /// Steps until nothing changed.
    pub iterations: usize,
    /// Standard deviation of a coordinate, target units: √(Σ residual² / (3n − 7)); `None` without redundancy.
    pub sigma0: Option<f64>,
    /// Covariance of (translation of the centroid x, y, z; scale; rotations about the target's x, y, z in radians),
    /// from `sigma0`; zero without redundancy.
    pub covariance: SMatrix<f64, 7, 7>,
}

/// Scale, rotation and what the target's centroid is moved by.
#[derive(Clone, Copy)]
struct State {
    scale: f64,
    rotation: Matrix3<f64>,
    shift: Vector3<f64>,
}

/// Adjusts the seven parameters; every point counts alike.
///
/// # Errors
/// [`Undetermined::TooFewPoints`] below three points, [`Undetermined::Degenerate`] when one side is collinear,
/// [`Undetermined::NotConverged`] when the steps do not die down (figures that are not similar at all).
pub fn adjust(pairs: &[PointPair]) -> Result<Adjustment, Undetermined> {
    let points = Centred::new(pairs)?;
    let mut state = approximate(&points)?;
    for iteration in 1..=MOST_ITERATIONS {
        let (normal, right) = normal_equations(&points, &state);
        let inverse = normal.cholesky().ok_or(Undetermined::Degenerate)?.inverse();
        let step = inverse * right;
        let next = shortened(&points, &state, &step).ok_or(Undetermined::NotConverged)?;
        state = next;
        if step.norm() < SETTLED {
            return finish(&points, &state, iteration, &inverse);
        }
    }
    Err(Undetermined::NotConverged)
}

/// Rotation and scale from the triangle of the widest three points.
fn approximate(points: &Centred) -> Result<State, Undetermined> {
    let corners = widest_triangle(&points.model);
    let frame = |side: &[Vector3<f64>]| {
        let along = (side[corners[1]] - side[corners[0]]).try_normalize(0.0)?;
        let other = side[corners[2]] - side[corners[0]];
        let across = (other - along * along.dot(&other)).try_normalize(0.0)?;
        Some(Matrix3::from_columns(&[along, across, along.cross(&across)]))
    };
    let (model, target) =
        (frame(&points.model).ok_or(Undetermined::Degenerate)?, frame(&points.target).ok_or(Undetermined::Degenerate)?);
    let length = |side: &[Vector3<f64>]| (side[corners[1]] - side[corners[0]]).norm();
    let scale = length(&points.target) / length(&points.model);
    Ok(State { scale, rotation: target * model.transpose(), shift: Vector3::zeros() })
}

/// The point farthest from the centroid, the one farthest from that, and the one farthest from the line of both.
fn widest_triangle(points: &[Vector3<f64>]) -> [usize; 3] {
    let farthest = |distance: &dyn Fn(&Vector3<f64>) -> f64| {
        (0..points.len())
            .max_by(|a, b| distance(&points[*a]).total_cmp(&distance(&points[*b])))
            .expect("there are three points or more")
    };
    let first = farthest(&|p| p.norm());
    let second = farthest(&|p| (p - points[first]).norm());
    let along = points[second] - points[first];
    [first, second, farthest(&|p| along.cross(&(p - points[first])).norm())]
}

/// What the target's point exceeds the computed one by.
fn misfit(state: &State, model: &Vector3<f64>, target: &Vector3<f64>) -> Vector3<f64> {
    target - state.scale * (state.rotation * model) - state.shift
}

fn sum_of_squares(points: &Centred, state: &State) -> f64 {
    points.target.iter().zip(&points.model).map(|(t, m)| misfit(state, m, t).norm_squared()).sum()
}

/// AᵀA and Aᵀl of the linearised observation equations. The unknowns are the shift (relative to the target's size), the
/// relative change of the scale and three small rotations, so that all are of one order.
fn normal_equations(points: &Centred, state: &State) -> (SMatrix<f64, 7, 7>, SVector<f64, 7>) {
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    let mut right = SVector::<f64, 7>::zeros();
    let unit = unit(points, state);
    for (target, model) in points.target.iter().zip(&points.model) {
        let turned = state.scale * (state.rotation * model);
        let mut row = SMatrix::<f64, 3, 7>::zeros();
        row.fixed_view_mut::<3, 3>(0, 0).fill_diagonal(unit);
        row.fixed_view_mut::<3, 1>(0, 3).copy_from(&turned);
        // d(exp(ω) v) = ω × v = −[v]× ω
        row.fixed_view_mut::<3, 3>(0, 4).copy_from(&-turned.cross_matrix());
        normal += row.transpose() * row;
        right += row.transpose() * misfit(state, model, target);
    }
    (normal, right)
}

/// Root mean square size of the target figure, the unit of the shift.
fn unit(points: &Centred, state: &State) -> f64 {
    state.scale * (points.model_square / points.model.len() as f64).sqrt()
}

/// The state after `step`, or after a fraction of it when the whole makes the sum of squares grow.
fn shortened(points: &Centred, state: &State, step: &SVector<f64, 7>) -> Option<State> {
    let unit = unit(points, state);
    // The last steps change nothing but the rounding, up or down.
    let limit = sum_of_squares(points, state) * (1.0 + 1e-9) + f64::EPSILON * f64::EPSILON * unit * unit;
    let mut fraction = 1.0;
    for _ in 0..20 {
        let part = step * fraction;
        let turn = Rotation3::from_scaled_axis(Vector3::new(part[4], part[5], part[6]));
        let next = State {
            scale: state.scale * (1.0 + part[3]),
            rotation: turn.into_inner() * state.rotation,
            shift: state.shift + unit * Vector3::new(part[0], part[1], part[2]),
        };
        let is_better = next.scale > 0.0 && sum_of_squares(points, &next) <= limit;
        if is_better || step.norm() < SETTLED {
            return Some(next);
        }
        fraction /= 2.0;
    }
    None
}

fn finish(
    points: &Centred,
    state: &State,
    iterations: usize,
    inverse: &SMatrix<f64, 7, 7>,
) -> Result<Adjustment, Undetermined> {
    // Rounding of many products: back to the nearest rotation.
    let rotation = Rotation3::from_matrix(&state.rotation).into_inner();
    let orientation = points.finish(rotation, state.scale, state.shift);
    let squares: f64 = orientation.residuals.iter().map(Vector3::norm_squared).sum();
    let freedom = 3.0 * points.model.len() as f64 - 7.0;
    let sigma0 = Some((squares / freedom).sqrt()).filter(|s| freedom > 0.0 && s.is_finite());
    let mut units = SVector::<f64, 7>::repeat(1.0);
    units.fixed_rows_mut::<3>(0).fill(unit(points, state));
    units[3] = state.scale;
    let units = SMatrix::<f64, 7, 7>::from_diagonal(&units);
    let covariance = units * inverse * units * sigma0.map_or(0.0, |s| s * s);
    Ok(Adjustment { orientation, iterations, sigma0, covariance })
}

#[cfg(test)]
mod tests {
    use super::super::absolute::{Method, solve};
    use super::*;

    /// Five points, turned far, with errors of a unit or so at the target.
    fn noisy_pairs() -> Vec<PointPair> {
        let rotation = Rotation3::from_euler_angles(2.9, -1.2, 2.0).into_inner();
        let models =
            [[0.0, 0.0, 0.0], [900.0, 10.0, 30.0], [40.0, 700.0, -20.0], [300.0, 200.0, 90.0], [600.0, 500.0, 10.0]];
        let errors = [[1.0, -0.5, 0.3], [-0.7, 0.2, 1.1], [0.1, 0.9, -1.3], [-0.4, -0.8, 0.6], [0.2, 0.1, -0.4]];
        models
            .iter()
            .zip(errors)
            .map(|(m, e)| {
                let model = Vector3::from(*m);
                PointPair { model, target: 3.0 * (rotation * model) + Vector3::new(5e5, 7e6, 80.0) + Vector3::from(e) }
            })
            .collect()
    }

    #[test]
    fn the_iteration_ends_at_the_closed_form() {
        let pairs = noisy_pairs();
        let adjusted = adjust(&pairs).expect("it settles");
        let closed = solve(&pairs, Method::Umeyama).expect("well determined");
        assert!(adjusted.iterations < 15, "{}", adjusted.iterations);
        assert!((adjusted.orientation.rotation - closed.rotation).norm() < 1e-9);
        assert!((adjusted.orientation.scale - closed.scale).abs() < 1e-9);
        assert!((adjusted.orientation.rmse - closed.rmse).abs() < 1e-9);
        assert!((adjusted.orientation.translation - closed.translation).norm() < 1e-5);
    }

    #[test]
    fn the_covariance_is_that_of_the_scale_when_the_errors_are_moved_about() {
        let pairs = noisy_pairs();
        let adjusted = adjust(&pairs).expect("it settles");
        let sigma0 = adjusted.sigma0.expect("five points are redundant");
        // The scale of a similarity has the variance σ²/Σ|model|², whatever the rotation.
        let centre = pairs.iter().map(|p| p.model).sum::<Vector3<f64>>() / 5.0;
        let square: f64 = pairs.iter().map(|p| (p.model - centre).norm_squared()).sum();
        let expected = sigma0 * sigma0 / square;
        assert!((adjusted.covariance[(3, 3)] / expected - 1.0).abs() < 1e-4);
        // So has the centroid σ²/n.
        assert!((adjusted.covariance[(0, 0)] / (sigma0 * sigma0 / 5.0) - 1.0).abs() < 1e-4);
    }

    #[test]
    fn three_points_have_redundancy_two_and_collinear_ones_are_refused() {
        let pairs = noisy_pairs();
        let three = adjust(&pairs[..3]).expect("a triangle is enough");
        assert!(three.sigma0.is_some_and(|s| s > 0.0));
        assert_eq!(adjust(&pairs[..2]).err(), Some(Undetermined::TooFewPoints));
        let line: Vec<PointPair> = (0..4)
            .map(|i| PointPair {
                model: Vector3::new(f64::from(i), 0.0, 0.0),
                target: Vector3::new(0.0, f64::from(i), 0.0),
            })
            .collect();
        assert_eq!(adjust(&line).err(), Some(Undetermined::Degenerate));
    }
}
