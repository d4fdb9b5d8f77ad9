//! Points that miss by more than is stated of them.

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix2x3, Matrix3, Vector3};

use super::adjusted::AdjustedPoint;
use super::survey::{GroundPoint, Role};
use crate::read::Reconstruction;

/// So many times as far as is stated is no chance, of so many points and more.
const MANY_TIMES: f64 = 3.0;
const FEWEST: usize = 3;

/// What GCPs and check points say of the block when most of them miss by several times their standard deviations.
pub(super) fn notes(
    adjusted: &[AdjustedPoint],
    points: &[GroundPoint],
    model: &Reconstruction,
    sigma_px: f64,
) -> Vec<String> {
    let of_role = |role: Role| adjusted.iter().zip(points).filter(move |(a, _)| a.role == role);
    let check = |(a, p): (&AdjustedPoint, &GroundPoint)| {
        let q = of_rays(&a.xyz, p, model, sigma_px)? + Matrix3::from_diagonal(&p.sigma.component_mul(&p.sigma));
        let residual = a.residual?;
        Some((residual.dot(&(q.try_inverse()? * residual)) / 3.0).sqrt())
    };
    let control =
        |(a, p): (&AdjustedPoint, &GroundPoint)| Some(a.residual?.component_div(&p.sigma).norm() / 3f64.sqrt());
    let said = [
        (middle(of_role(Role::Check).filter_map(check).collect()), "check points", "their survey and their rays allow"),
        (middle(of_role(Role::Control).filter_map(control).collect()), "GCPs", "is stated of their survey"),
    ];
    let line = |(times, what, allowed): (Option<f64>, &str, &str)| {
        let times = times.filter(|times| *times > MANY_TIMES)?;
        Some(format!(
            "half of the {what} miss by {times:.1} times what {allowed} or more: the block is bent by more than its \
             standard deviations say; look at the interior orientation (cx and cy too), at the CRS and at what is stated \
             of the points"
        ))
    };
    said.into_iter().filter_map(line).collect()
}

/// Gives check points the covariance of where their rays meet, cameras taken for known.
pub(super) fn deviations_of_check_points(
    adjusted: &mut [AdjustedPoint],
    points: &[GroundPoint],
    model: &Reconstruction,
    sigma_px: f64,
) {
    for (found, given) in adjusted.iter_mut().zip(points).filter(|(found, _)| found.role == Role::Check) {
        found.covariance = found.residual.and_then(|_| of_rays(&found.xyz, given, model, sigma_px));
    }
}

fn middle(mut all: Vec<f64>) -> Option<f64> {
    if all.len() < FEWEST { None } else { upper_median(&mut all) }
}

/// The covariance of the place where the rays of a point meet, of its measurement alone.
fn of_rays(at: &Vector3<f64>, point: &GroundPoint, model: &Reconstruction, sigma_px: f64) -> Option<Matrix3<f64>> {
    let normal = point.seen.iter().map(|(i, pixel)| {
        let photograph = &model.photographs[*i];
        let local = photograph.pose.to_camera(at);
        let (_, j) = model.cameras[photograph.camera].residual_with_jacobian(local.into(), *pixel);
        let j = Matrix2x3::from_fn(|r, c| j[r][c]) * photograph.pose.rotation;
        j.transpose() * j / sigma_px.powi(2)
    });
    normal.sum::<Matrix3<f64>>().try_inverse()
}
