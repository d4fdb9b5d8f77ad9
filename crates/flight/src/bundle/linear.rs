//! One observation, linear: its derivatives, weighted.

use nalgebra::{Matrix2, Matrix2x3, SMatrix, Vector2};

use super::layout::{Layout, MOST_INTERIOR};
use super::problem::{Loss, Observation, Problem, Trust};
use super::small::times;

type Matrix2x6 = SMatrix<f64, 2, 6>;

/// What the second derivative of a robust loss counts for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Curvature {
    /// Nothing: observations are weighted by ρ′, as covariances want it.
    Weights,
    /// Along a residual a far observation pulls, but hardly holds: steps that know it converge fast.
    Whole,
}

/// Share of the weight that stays along a residual where the loss is straight or concave.
const LEAST_RADIAL: f64 = 0.02;

/// The weighted derivatives of one observation.
pub(super) struct Linear {
    /// By turn and centre of the pose.
    pub pose: Matrix2x6,
    /// By the active interior parameters.
    pub interior: [Vector2<f64>; MOST_INTERIOR],
    pub point: Matrix2x3<f64>,
    pub residual: Vector2<f64>,
}

/// The derivatives of an observation, weighted by 1/σ and the robust loss; `None` where the camera does not see it.
pub(super) fn linear(
    problem: &Problem,
    layout: &Layout,
    o: &Observation,
    loss: Loss,
    curvature: Curvature,
) -> Option<Linear> {
    let frame = &problem.frames[o.frame];
    let x = &problem.points[o.point].xyz;
    let p = frame.pose.to_camera(x);
    let camera = &problem.cameras[frame.camera].camera;
    if !camera.sees(p.into()) {
        return None;
    }
    let active = &layout.active[frame.camera];
    let mut interior = [Vector2::zeros(); MOST_INTERIOR];
    let (p_at, pixel, count) = (p.into(), o.pixel, active.len());
    let (off, by_p) = if active.is_empty() {
        let (off, j) = camera.residual_with_jacobian(p_at, pixel);
        (off, Matrix2x3::from_fn(|r, c| j[r][c]))
    } else if count <= 1 {
        split::<4>(&camera.residual_with_parameters::<4>(p_at, pixel, active), count, &mut interior)
    } else if count <= 5 {
        split::<8>(&camera.residual_with_parameters::<8>(p_at, pixel, active), count, &mut interior)
    } else {
        split::<16>(&camera.residual_with_parameters::<16>(p_at, pixel, active), count, &mut interior)
    };
    let residual = Vector2::from(off) / o.sigma_px;
    if !residual.iter().all(|v| v.is_finite()) {
        return None;
    }
    let squared = residual.norm_squared();
    let (weight, radial) = match (o.trust, curvature) {
        (Trust::Robust, Curvature::Whole) => (loss.at(squared).1.sqrt(), loss.radial(squared).max(LEAST_RADIAL).sqrt()),
        (Trust::Robust, Curvature::Weights) => (loss.at(squared).1.sqrt(), 1.0),
        (Trust::Full, _) => (1.0, 1.0),
    };
    let scale = weight / o.sigma_px;
    let mut by_p = by_p * scale;
    // The part of the derivatives along the residual shrinks, the residual grows by as much: the slope stays the same.
    let bent = (radial < 1.0).then(|| {
        Matrix2::identity() - residual * residual.transpose() * ((1.0 - radial) / squared.max(f64::MIN_POSITIVE))
    });
    if let Some(m) = bent {
        by_p = times(&m, &by_p);
    }
    let by_x = times(&by_p, &frame.pose.rotation);
    // exp(δ) p ≈ p + δ × p.
    let by_turn = times(&by_p, &-p.cross_matrix());
    let mut pose = Matrix2x6::zeros();
    pose.fixed_columns_mut::<3>(0).copy_from(&by_turn);
    pose.fixed_columns_mut::<3>(3).copy_from(&-by_x);
    for v in &mut interior[..active.len()] {
        *v = bent.map_or(*v, |m| times(&m, v)) * scale;
    }
    Some(Linear { pose, interior, point: by_x, residual: residual * (weight / radial) })
}

fn split<const N: usize>(
    at: &[crate::dual::Dual<N>; 2],
    active: usize,
    interior: &mut [Vector2<f64>; MOST_INTERIOR],
) -> ([f64; 2], Matrix2x3<f64>) {
    for (i, v) in interior[..active].iter_mut().enumerate() {
        *v = Vector2::new(at[0].d[i + 3], at[1].d[i + 3]);
    }
    ([at[0].v, at[1].v], Matrix2x3::from_fn(|r, c| at[r].d[c]))
}
