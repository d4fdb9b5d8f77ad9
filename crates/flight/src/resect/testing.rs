//! Which points a pose contradicts.

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix2, Vector2};

use super::seen::{Focal, ResectOptions, Seen};
use crate::bundle::{Factored, Problem};
use crate::camera::Camera;
use crate::pose::Pose;

/// How far from its pixel a point may be seen, 1σ, pixels: by the measurement and by its place on the ground.
pub(super) fn expected_px(camera: &Camera, pose: &Pose, seen: &Seen, sigma_px: f64) -> f64 {
    sigma_px.hypot(seen.sigma_m.max() * camera.most_px_per_m(pose.to_camera(&seen.xyz).into()))
}

/// Points that lie far from a robust pose: by that of all together, two of ten hide each other.
pub(super) fn far_off(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions) -> Vec<usize> {
    /// Times the spread of all, and the share of all that is not too many.
    const GROSS: f64 = 16.0;
    const MOST: f64 = 0.35;
    /// More than that many measurements must be left: few points fit many poses.
    const LEFT: usize = 8;
    let off: Vec<f64> = seen
        .iter()
        .map(|s| {
            let share = options.sigma_px / expected_px(camera, pose, s, options.sigma_px);
            let residual = camera.residual(pose.to_camera(&s.xyz).into(), s.pixel);
            residual.map_or(f64::INFINITY, |[x, y]| x.hypot(y) * share)
        })
        .collect();
    let Some(median) = upper_median(&mut off.clone()) else { return Vec::new() };
    // The median length of a normal 2-vector is 1.1774 σ.
    let spread = (median / 1.1774).max(options.sigma_px);
    let far: Vec<usize> = (0..seen.len()).filter(|i| off[*i] > GROSS * spread).collect();
    let left = 2 * (seen.len() - far.len());
    let needed = if options.focal == Focal::Sought { 7 + LEFT + 2 } else { 6 + LEFT };
    if far.len() as f64 > MOST * seen.len() as f64 || left < needed { Vec::new() } else { far }
}

/// Of so many squares of normal numbers, the root of the share of their expected sum at a normal quantile (Wilson and
/// Hilferty, 1931).
fn share(redundancy: usize, quantile: f64) -> f64 {
    let ninth = 2.0 / (9.0 * redundancy.max(1) as f64);
    (1.0 - ninth + quantile * ninth.sqrt()).max(0.2).powi(3).sqrt()
}

/// The normal number that one in a hundred exceeds.
const ONE_PERCENT: f64 = 2.326;

/// What one set in a hundred does not reach: points that were chosen because they fit spread less than others.
pub(super) fn least_share(redundancy: usize) -> f64 {
    share(redundancy, -ONE_PERCENT)
}

/// σ₀ where the points fit worse than one set in a hundred would by chance: how many times as large all deviations are
/// as those that follow from what was stated. Else 1.
pub(super) fn excess(sigma0: Option<f64>, redundancy: usize) -> f64 {
    sigma0.filter(|s| *s > share(redundancy, ONE_PERCENT)).unwrap_or(1.0)
}

/// How far a point that took no part lies from where the pose has it, in standard deviations of both.
pub(super) fn off_by(camera: &Camera, pose: &Pose, factored: &Factored, seen: &Seen, options: &ResectOptions) -> f64 {
    let local = pose.to_camera(&seen.xyz);
    let (off, j) = camera.residual_with_jacobian(local.into(), seen.pixel);
    let j = nalgebra::Matrix2x3::from_fn(|r, c| j[r][c]) * pose.rotation;
    // A turn about the camera moves the point by its distance: the covariance of both, in the image.
    let moved = nalgebra::Matrix3x6::from_fn(|r, c| if c < 3 { 0.0 } else { f64::from(u8::from(r == c - 3)) });
    let turned = (pose.rotation.transpose() * local).cross_matrix() * pose.rotation.transpose();
    let all = moved + nalgebra::Matrix3x6::from_fn(|r, c| if c < 3 { turned[(r, c)] } else { 0.0 });
    let q = j * all * factored.frame(0) * all.transpose() * j.transpose()
        + Matrix2::identity() * options.sigma_px.powi(2)
        + j * nalgebra::Matrix3::from_diagonal(&seen.sigma_m.component_mul(&seen.sigma_m)) * j.transpose();
    let v = Vector2::from(off);
    let inverse = q.try_inverse().filter(|_| camera.sees(local.into()));
    inverse.map_or(f64::INFINITY, |inverse| v.dot(&(inverse * v)).sqrt())
}

/// Of so many points one at a time is judged wrong: in larger nets, where none hides another, as many as hold these
/// together.
const NET: usize = 50;

/// The point whose residual is largest against its own standard deviation, if beyond the critical value. The σ stated
/// may be too small for the whole net: then a point is wrong when it is beyond the critical value in units of the
/// others' spread (by their median: several may be wrong), or when the others fit so much better without it as chance
/// would have it for the worst of them once in twenty sets (Fisher's test on the sum of squares that it accounts for,
/// with Bonferroni's bound). `left` is the sum of squares of all and the redundancy. Of a large net the worst ones,
/// by the first of these rules.
pub(super) fn worst_points(
    at: &Problem,
    factored: &Factored,
    seen: &[Seen],
    options: &ResectOptions,
    left: (f64, usize),
) -> Vec<usize> {
    let Some(tests) = normalised(at, factored, seen) else { return Vec::new() };
    let mut worst: Vec<usize> = (0..tests.len()).collect();
    worst.sort_by(|a, b| tests[*b].total_cmp(&tests[*a]));
    // The median length of a normal 2-vector is 1.1774 σ.
    let unit = (tests[worst[(worst.len() - 1) / 2]] / 1.1774).max(1.0);
    worst.truncate((tests.len() / NET).max(1));
    let most = tests[worst[0]];
    let rest = left.1.saturating_sub(2) as f64;
    // Of F with 2 and n degrees of freedom: P(F > x) = (1 + 2x/n)^(−n/2).
    let ratio = most * most / (left.0 - most * most).max(f64::MIN_POSITIVE);
    let by_chance = if rest > 0.0 { (1.0 + ratio).powf(-rest / 2.0) * tests.len() as f64 } else { 1.0 };
    let first = worst[0];
    worst.retain(|i| {
        tests[*i] > options.critical && (tests[*i] > options.critical * unit || (*i == first && by_chance < 0.05))
    });
    worst
}

/// The residual of each point against its standard deviation; `None` where the camera does not see one.
fn normalised(at: &Problem, factored: &Factored, seen: &[Seen]) -> Option<Vec<f64>> {
    let mut tests = Vec::new();
    for (i, o) in at.observations.iter().enumerate() {
        // From where the fit has the point: image and survey of a point that one frame sees share one test.
        let local = at.frames[0].pose.to_camera(&at.points[i].xyz).into();
        let v = Vector2::from(at.cameras[0].camera.residual(local, o.pixel)?);
        // Of the residual: what was stated less what the fit took up.
        let q = Matrix2::identity() * o.sigma_px.powi(2) - factored.predicted(at, o)?;
        let coarse = o.sigma_px / expected_px(&at.cameras[0].camera, &at.frames[0].pose, &seen[i], o.sigma_px);
        let floor = Matrix2::identity() * (1e-3 * (o.sigma_px * coarse).powi(2));
        let test = v.dot(&((q + floor).try_inverse()? * v)).max(0.0).sqrt();
        tests.push(test);
    }
    Some(tests)
}
