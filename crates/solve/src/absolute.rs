//! Absolute orientation in space: rotation, one scale and translation from model to target, in closed form.
//!
//! Four methods of the same model target = scale · rotation · model + translation. They give the same rotation on the
//! same points; what differs is the scale. [`Method::Umeyama`] minimises the residuals at the target and so has the
//! smallest RMSE of the four on any points; the symmetric scale of Horn treats both sides alike, so that the inverse
//! problem has the inverse solution.
//!
//! The axes of both sides must be right-handed: image points go in as (x, −y, elevation) when the target is (easting,
//! northing, height).

use nalgebra::{Matrix3, Matrix4, SymmetricEigen, UnitQuaternion, Vector3};

/// One point in both systems.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPair {
    /// In the system to be oriented, right-handed.
    pub model: Vector3<f64>,
    /// In the system of the map.
    pub target: Vector3<f64>,
}

/// How rotation and scale are found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// B. K. P. Horn, "Closed-form solution of absolute orientation using unit quaternions", 1987: the rotation is the
    /// eigenvector of the largest eigenvalue of a symmetric 4 × 4 matrix; symmetric scale.
    Horn,
    /// B. K. P. Horn, H. M. Hilden, S. Negahdaripour, "Closed-form solution of absolute orientation using orthonormal
    /// matrices", 1988: R = M (MᵀM)^(−1/2), completed by the missing axis when the points lie in a plane; symmetric
    /// scale.
    HornHilden,
    /// S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns", 1991, eq. 39–43:
    /// rotation from a singular value decomposition; the scale that minimises the residuals at the target.
    Umeyama,
    /// Umeyama's rotation with the symmetric scale of Horn.
    UmeyamaSymmetricScale,
}

/// A solved orientation: target = scale · rotation · model + translation.
#[derive(Clone, Debug, PartialEq)]
pub struct AbsoluteOrientation {
    /// From model axes to target axes.
    pub rotation: Matrix3<f64>,
    /// Target units per model unit.
    pub scale: f64,
    /// Where the model's origin lies, target units.
    pub translation: Vector3<f64>,
    /// Target − computed, in the order of the pairs, target units.
    pub residuals: Vec<Vector3<f64>>,
    /// √(mean |residual|²), divisor n, target units.
    pub rmse: f64,
}

impl AbsoluteOrientation {
    /// Model → target, target units.
    pub fn apply(&self, model: Vector3<f64>) -> Vector3<f64> {
        self.scale * (self.rotation * model) + self.translation
    }

    /// RMSE of each target axis, divisor n.
    pub fn rmse_by_axis(&self) -> Vector3<f64> {
        let squares: Vector3<f64> = self.residuals.iter().map(|r| r.component_mul(r)).sum();
        (squares / self.residuals.len() as f64).map(f64::sqrt)
    }
}

/// Why no orientation was solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Undetermined {
    /// Three points are needed.
    #[error("too few points")]
    TooFewPoints,
    /// The points of one side lie in one place or on one line, so that a rotation about it is unknown; or a coordinate
    /// is not finite.
    #[error("the points lie in one line or in one place")]
    Degenerate,
    /// The iteration did not settle; closed forms never say this.
    #[error("the iteration did not settle")]
    NotConverged,
}

/// Points on a line within this fraction of their spread leave the rotation about it undetermined.
const COLLINEAR: f64 = 1e-5;

/// Below this ratio of the smallest to the largest singular value the points count as planar.
const PLANAR: f64 = 1e-6;

/// Both sides about their centroids, which leaves rotation and scale.
pub(super) struct Centred {
    pub model: Vec<Vector3<f64>>,
    pub target: Vec<Vector3<f64>>,
    model_centre: Vector3<f64>,
    target_centre: Vector3<f64>,
    /// Of each point.
    weights: Vec<f64>,
    /// Σ weight · |model|², Σ|target|².
    pub model_square: f64,
    target_square: f64,
}

impl Centred {
    /// # Errors
    /// [`Undetermined`] with fewer than three points or when one side is collinear.
    pub fn new(pairs: &[PointPair]) -> Result<Self, Undetermined> {
        Centred::weighted(pairs, vec![1.0; pairs.len()])
    }

    /// About the weighted centroids.
    ///
    /// # Errors
    /// As [`Centred::new`]; when the weights are not one positive number for each pair.
    fn weighted(pairs: &[PointPair], weights: Vec<f64>) -> Result<Self, Undetermined> {
        if pairs.len() < 3 {
            return Err(Undetermined::TooFewPoints);
        }
        if weights.len() != pairs.len() || weights.iter().any(|w| !(*w > 0.0 && w.is_finite())) {
            return Err(Undetermined::Degenerate);
        }
        let (model, model_centre) = centre(pairs.iter().map(|p| p.model), &weights);
        let (target, target_centre) = centre(pairs.iter().map(|p| p.target), &weights);
        let square =
            |points: &[Vector3<f64>]| points.iter().zip(&weights).map(|(p, w)| w * p.norm_squared()).sum::<f64>();
        let (model_square, target_square) = (square(&model), square(&target));
        if !(spans_a_plane(&model, model_square) && spans_a_plane(&target, target_square)) {
            return Err(Undetermined::Degenerate);
        }
        Ok(Centred { model, target, model_centre, target_centre, weights, model_square, target_square })
    }

    /// M = Σ target · modelᵀ, of both sides scaled to unit size (rotations do not change by it).
    fn cross(&self) -> Matrix3<f64> {
        let each = self.target.iter().zip(&self.model).zip(&self.weights);
        let sum: Matrix3<f64> = each.map(|((t, m), w)| *w * (t * m.transpose())).sum();
        sum / (self.model_square * self.target_square).sqrt()
    }

    /// Horn 1987, section 2.E: √(Σ|target|² / Σ|model|²).
    fn symmetric_scale(&self) -> f64 {
        (self.target_square / self.model_square).sqrt()
    }

    /// Least squares for a given rotation: Σ target · (R model) / Σ|model|². With the best rotation this is eq. 42 of
    /// Umeyama 1991, tr(DS)/σ², in which both the covariance and the variance are means over the *points*.
    fn least_squares_scale(&self, rotation: &Matrix3<f64>) -> f64 {
        let each = self.target.iter().zip(&self.model).zip(&self.weights);
        each.map(|((t, m), w)| w * t.dot(&(rotation * m))).sum::<f64>() / self.model_square
    }

    /// Residuals, from the centred points so that coordinates of millions of metres lose no digits.
    pub fn finish(&self, rotation: Matrix3<f64>, scale: f64, shift: Vector3<f64>) -> AbsoluteOrientation {
        let residuals: Vec<Vector3<f64>> =
            self.target.iter().zip(&self.model).map(|(t, m)| t - scale * (rotation * m) - shift).collect();
        let squares: f64 = residuals.iter().map(Vector3::norm_squared).sum();
        AbsoluteOrientation {
            rotation,
            scale,
            translation: self.target_centre + shift - scale * (rotation * self.model_centre),
            rmse: (squares / residuals.len() as f64).sqrt(),
            residuals,
        }
    }
}

fn centre(points: impl Iterator<Item = Vector3<f64>>, weights: &[f64]) -> (Vec<Vector3<f64>>, Vector3<f64>) {
    let points: Vec<Vector3<f64>> = points.collect();
    // About the first point first: a mean of large numbers would be rounded more coarsely than the points.
    let first = points[0];
    let sum: Vector3<f64> = points.iter().zip(weights).map(|(p, w)| *w * (p - first)).sum();
    let mean = sum / weights.iter().sum::<f64>();
    (points.iter().map(|p| (p - first) - mean).collect(), first + mean)
}

fn spans_a_plane(centred: &[Vector3<f64>], square: f64) -> bool {
    if !(square > 0.0 && square.is_finite()) {
        return false;
    }
    let scatter: Matrix3<f64> = centred.iter().map(|p| p * p.transpose()).sum::<Matrix3<f64>>() / square;
    let mut spread: [f64; 3] = scatter.symmetric_eigenvalues().into();
    spread.sort_by(f64::total_cmp);
    spread[1] > COLLINEAR * COLLINEAR * spread[2]
}

/// The orientation of `pairs` by `method`; every point counts alike.
///
/// # Errors
/// [`Undetermined::TooFewPoints`] below three points, [`Undetermined::Degenerate`] when one side is collinear.
pub fn solve(pairs: &[PointPair], method: Method) -> Result<AbsoluteOrientation, Undetermined> {
    by(&Centred::new(pairs)?, method)
}

/// The same with a weight for each point, as section 2.C of Horn 1987 has them; residuals and RMSE stay unweighted.
///
/// # Errors
/// As [`solve`]; [`Undetermined::Degenerate`] too when the weights are not one positive number for each pair.
pub fn solve_weighted(
    pairs: &[PointPair],
    weights: &[f64],
    method: Method,
) -> Result<AbsoluteOrientation, Undetermined> {
    by(&Centred::weighted(pairs, weights.to_vec())?, method)
}

/// Rotations about x, y and z in degrees, with R = Rz(yaw) · Ry(pitch) · Rx(roll): roll, pitch, yaw.
pub fn roll_pitch_yaw_deg(rotation: &Matrix3<f64>) -> [f64; 3] {
    let (roll, pitch, yaw) = nalgebra::Rotation3::from_matrix_unchecked(*rotation).euler_angles();
    [roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees()]
}

fn by(centred: &Centred, method: Method) -> Result<AbsoluteOrientation, Undetermined> {
    let cross = centred.cross();
    let rotation = match method {
        Method::Horn => quaternion_rotation(&cross),
        Method::HornHilden => orthonormal_rotation(&cross)?,
        Method::Umeyama | Method::UmeyamaSymmetricScale => svd_rotation(&cross)?,
    };
    let scale = match method {
        Method::Umeyama => centred.least_squares_scale(&rotation),
        Method::Horn | Method::HornHilden | Method::UmeyamaSymmetricScale => centred.symmetric_scale(),
    };
    // A scale of zero or less: the target is no similar figure of the model at all.
    if !(scale > 0.0 && scale.is_finite()) {
        return Err(Undetermined::Degenerate);
    }
    Ok(centred.finish(rotation, scale, Vector3::zeros()))
}

/// Horn 1987, section 4.A. `cross` is Σ target · modelᵀ, the transpose of Horn's M.
fn quaternion_rotation(cross: &Matrix3<f64>) -> Matrix3<f64> {
    let s = cross.transpose();
    let (yz, zx, xy) = (s[(1, 2)] - s[(2, 1)], s[(2, 0)] - s[(0, 2)], s[(0, 1)] - s[(1, 0)]);
    let (xx, yy, zz) = (s[(0, 0)], s[(1, 1)], s[(2, 2)]);
    let sum = |a: usize, b: usize| s[(a, b)] + s[(b, a)];
    #[rustfmt::skip]
    let n = Matrix4::new(
        xx + yy + zz, yz,           zx,            xy,
        yz,           xx - yy - zz, sum(0, 1),     sum(2, 0),
        zx,           sum(0, 1),    yy - xx - zz,  sum(1, 2),
        xy,           sum(2, 0),    sum(1, 2),     zz - xx - yy,
    );
    let eigen = SymmetricEigen::new(n);
    let q = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix().into_inner()
}

/// Left singular vectors, singular values, right singular vectors.
type Singular = (Matrix3<f64>, Vector3<f64>, Matrix3<f64>);

/// Singular vectors of `cross`, largest singular value first.
fn singular(cross: &Matrix3<f64>) -> Result<Singular, Undetermined> {
    let svd = cross.svd(true, true);
    let (u, v_t) = (svd.u.ok_or(Undetermined::Degenerate)?, svd.v_t.ok_or(Undetermined::Degenerate)?);
    // Points of a plane each, but at right angles: only a line is left of what they share.
    if svd.singular_values[1] <= COLLINEAR * COLLINEAR * svd.singular_values[0] {
        return Err(Undetermined::Degenerate);
    }
    Ok((u, svd.singular_values, v_t.transpose()))
}

/// Horn, Hilden, Negahdaripour 1988: R = M S⁻¹ with S = (MᵀM)^(1/2). Two of its axes are kept and the third is their
/// normal where S has no inverse (the points lie in a plane) and where M S⁻¹ would be a reflection (so noisy in the
/// third direction that its sign flips).
fn orthonormal_rotation(cross: &Matrix3<f64>) -> Result<Matrix3<f64>, Undetermined> {
    // S has the right singular vectors of M as eigenvectors and its singular values as eigenvalues. Taking them from
    // MᵀM would halve the digits, and GCPs of flat country have few to spare.
    let (_, values, axes) = singular(cross)?;
    if values[2] > PLANAR * values[0] && cross.determinant() > 0.0 {
        let inverse_root = axes * Matrix3::from_diagonal(&values.map(f64::recip)) * axes.transpose();
        return Ok(cross * inverse_root);
    }
    let (first, second) = (axes.column(0).into_owned(), axes.column(1).into_owned());
    let (to_first, to_second) = (cross * first / values[0], cross * second / values[1]);
    let normal = to_first.cross(&to_second) * first.cross(&second).transpose();
    Ok(to_first * first.transpose() + to_second * second.transpose() + normal)
}

/// Umeyama 1991, eq. 40 and 43: R = U S Vᵀ with S = diag(1, 1, ±1) such that R is no reflection.
fn svd_rotation(cross: &Matrix3<f64>) -> Result<Matrix3<f64>, Undetermined> {
    let (u, _, v) = singular(cross)?;
    let sign = (u.determinant() * v.determinant()).signum();
    Ok(u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    const METHODS: [Method; 4] = [Method::Horn, Method::HornHilden, Method::Umeyama, Method::UmeyamaSymmetricScale];

    fn moved(models: &[[f64; 3]], rotation: Matrix3<f64>, scale: f64, translation: Vector3<f64>) -> Vec<PointPair> {
        models
            .iter()
            .map(|m| Vector3::from(*m))
            .map(|model| PointPair { model, target: scale * (rotation * model) + translation })
            .collect()
    }

    #[test]
    fn every_method_returns_what_was_put_in_even_in_a_plane_and_at_half_turns() {
        let solid = [[0.0, 0.0, 0.0], [900.0, 10.0, 30.0], [40.0, 700.0, -20.0], [300.0, 200.0, 400.0]];
        let plane = [[0.0, 0.0, 5.0], [900.0, 10.0, 5.0], [40.0, 700.0, 5.0], [300.0, 200.0, 5.0]];
        let translation = Vector3::new(570_000.0, 7_032_000.0, 80.0);
        for models in [&solid[..], &plane[..], &plane[..3]] {
            for angles in [[0.0, 0.0, 0.0], [0.0, 0.0, 180.0], [180.0, 0.0, 0.0], [20.0, -70.0, 130.0]] {
                let [a, b, c] = angles.map(f64::to_radians);
                let rotation = Rotation3::from_euler_angles(a, b, c).into_inner();
                for method in METHODS {
                    let solved = solve(&moved(models, rotation, 0.032, translation), method).expect("well determined");
                    assert!((solved.rotation - rotation).norm() < 1e-8, "{method:?} {angles:?}");
                    assert!((solved.scale - 0.032).abs() < 1e-11, "{method:?} {angles:?}");
                    assert!(solved.rmse < 1e-7, "{method:?}: {}", solved.rmse);
                }
            }
        }
    }

    #[test]
    fn a_mirrored_figure_gets_a_rotation_and_bad_residuals_never_a_reflection() {
        let models = [[0.0, 0.0, 0.0], [9.0, 1.0, 3.0], [4.0, 7.0, -2.0], [3.0, 2.0, 8.0], [1.0, 6.0, 4.0]];
        let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
        let pairs = moved(&models, mirror, 2.0, Vector3::zeros());
        let reference = solve(&pairs, Method::Umeyama).expect("a best rotation exists");
        assert!(reference.rmse > 0.1);
        for method in METHODS {
            let solved = solve(&pairs, method).expect("a best rotation exists");
            assert!((solved.rotation.determinant() - 1.0).abs() < 1e-12, "{method:?}");
            assert!((solved.rotation - reference.rotation).norm() < 1e-9, "{method:?}");
        }
    }

    #[test]
    fn a_weight_of_two_is_the_point_twice() {
        let models = [[0.0, 0.0, 0.0], [9.0, 1.0, 3.0], [4.0, 7.0, -2.0], [3.0, 2.0, 8.0], [1.0, 6.0, 4.0]];
        let mut pairs = moved(&models, Matrix3::identity(), 2.0, Vector3::new(5.7e5, 7.0e6, 80.0));
        pairs[0].target.x += 0.3;
        pairs[3].target.z -= 0.2;
        let twice: Vec<PointPair> = pairs.iter().chain(&pairs[3..4]).copied().collect();
        for method in METHODS {
            let weighted = solve_weighted(&pairs, &[1.0, 1.0, 1.0, 2.0, 1.0], method).expect("determined");
            let doubled = solve(&twice, method).expect("determined");
            assert!((weighted.rotation - doubled.rotation).norm() < 1e-12, "{method:?}");
            assert!((weighted.scale - doubled.scale).abs() < 1e-12, "{method:?}");
        }
        assert_eq!(solve_weighted(&pairs, &[1.0; 4], Method::Horn).err(), Some(Undetermined::Degenerate));
    }

    #[test]
    fn roll_pitch_and_yaw_are_read_back() {
        let rotation = Rotation3::from_euler_angles(0.02, -0.03, 2.5).into_inner();
        let [roll, pitch, yaw] = roll_pitch_yaw_deg(&rotation).map(f64::to_radians);
        assert!((roll - 0.02).abs() < 1e-12 && (pitch + 0.03).abs() < 1e-12 && (yaw - 2.5).abs() < 1e-12);
    }

    #[test]
    fn too_few_and_collinear_points_are_refused() {
        let rotation = Matrix3::identity();
        let line = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [5.0, 10.0, 15.0]];
        let same = [[1.0, 2.0, 3.0]; 4];
        for method in METHODS {
            let error = |points: &[[f64; 3]]| solve(&moved(points, rotation, 1.0, Vector3::zeros()), method).err();
            assert_eq!(error(&line[..2]), Some(Undetermined::TooFewPoints));
            assert_eq!(error(&line), Some(Undetermined::Degenerate));
            assert_eq!(error(&same), Some(Undetermined::Degenerate));
            assert_eq!(error(&[[f64::NAN; 3], [0.0; 3], [1.0; 3]]), Some(Undetermined::Degenerate));
        }
    }
}
