//! Which of all poses is the right one, and which others the points do not rule out.
//!
//! Every minimum is judged by all that it has to explain: χ² of its points in the image and on the ground, a fixed
//! price for each point that it calls wrong (P. J. Rousseeuw and A. M. Leroy, *Robust Regression and Outlier
//! Detection*, 1987, on losses that are bounded so; P. H. S. Torr and A. Zisserman, *MLESAC*, 2000), and a small one
//! for what cameras seldom do.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3};

use super::refine::{Approached, FOCAL_SIDES, Minimum, approached, bounds, judging, refine};
use super::resection::{Alternative, Resection};
use super::seen::{Focal, ResectOptions, Seen};
use super::three_points::starts;
use crate::bundle::Ended;
use crate::camera::{Camera, Parameter};
use crate::pose::{Pose, turn};

/// Starts that are refined, beside the best one of each focal length, of few points and of many.
const BEST_STARTS: usize = 24;
const BEST_STARTS_OF_MANY: usize = 12;
const MANY: usize = 50;
/// So few points leave several poses open: all their starts are refined.
const FEW: usize = 5;
/// Of so few, one that is wrong may hide behind another.
const FEW_TO_SPARE: usize = 7;

/// Points that starts are compared by, at most.
const MOST_ASKED: usize = 200;

/// Price of a point that is called wrong, in χ²: a little more than the least that calls it so.
const CALLED_WRONG: f64 = 18.0;
/// Price of a camera below all its points, and of one that hangs upside-down.
const SELDOM: f64 = 4.0;
/// Minima whose χ² is so much larger are not ruled out: three standard deviations.
const NOT_RULED_OUT: f64 = 9.0;
/// A pose is no other one within so many standard deviations, nor within this share of the distance to its points and
/// this turn, radians, where the deviations do not tell.
const SAME_SIGMAS: f64 = 3.0;
const SAME_PLACE: f64 = 0.01;
const SAME_TURN: f64 = 0.05;
/// A variance so many times what was stated is no reason to look further.
const GOOD: f64 = 9.0;

/// What the search found.
pub(super) struct Choice {
    /// With what it leaves open.
    pub best: Option<Resection>,
    /// Whether a minimum was passed over that leaves the focal length open.
    pub is_open: bool,
}

/// A place to start from, and how badly the points fit there.
struct Start {
    score: f64,
    camera: Camera,
    pose: Pose,
}

/// The minimum that the points speak for most, with the others that they do not rule out.
pub(super) fn choose(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Choice {
    let (minima, is_open) = minima(all_starts(camera, seen, options), seen, options);
    let judge = |m: Minimum| (price(&m, seen, options), m);
    let mut judged: Vec<(f64, Minimum)> = minima.into_iter().map(judge).collect();
    // Where calling one point wrong costs no more than what all of few together do not fit, it may be any of them.
    let least = judged.iter().map(|(price, _)| *price).fold(f64::INFINITY, f64::min);
    if seen.len() <= FEW_TO_SPARE && least + NOT_RULED_OUT > CALLED_WRONG {
        judged.extend((0..seen.len()).flat_map(|wrong| without(wrong, camera, seen, options)).map(judge));
    }
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut judged = judged.into_iter();
    let Some((least, minimum)) = judged.next() else { return Choice { best: None, is_open } };
    let (scale, mut best) = (minimum.scale(), minimum.found);
    let mut others: Vec<Resection> = Vec::new();
    for (_, other) in judged.take_while(|(price, _)| price - least <= NOT_RULED_OUT * scale) {
        let other = other.found;
        if !is_covered(&best, &other, seen) && others.iter().all(|known| !is_one_pose(known, &other, seen)) {
            others.push(other);
        }
    }
    best.alternatives =
        others.into_iter().map(|o| Alternative { camera: o.camera, pose: o.pose, covariance: o.covariance }).collect();
    Choice { best: Some(best), is_open }
}

/// The minima of all points but one.
fn without(wrong: usize, camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Vec<Minimum> {
    let mut rest = seen.to_vec();
    let aside = rest.remove(wrong);
    if rest.len() < options.focal.fewest() {
        return Vec::new();
    }
    let (mut minima, _) = minima(all_starts(camera, &rest, options), &rest, options);
    for Minimum { found, .. } in &mut minima {
        found.blunders.iter_mut().for_each(|i| *i += usize::from(*i >= wrong));
        found.blunders.push(wrong);
        found.blunders.sort_unstable();
        let residual = found.camera.residual(found.pose.to_camera(&aside.xyz).into(), aside.pixel);
        found.residuals_px.insert(wrong, residual);
    }
    minima
}

/// Starts of all focal lengths that come into question, the best first.
fn all_starts(camera: &Camera, seen: &[Seen], options: &ResectOptions) -> Vec<Start> {
    let cameras: Vec<Camera> = match options.focal {
        Focal::Known => vec![camera.clone()],
        Focal::Sought => {
            let side = camera.size_px[0].max(camera.size_px[1]);
            (0..48).map(|i| camera.clone().with(Parameter::F, side * 0.35 * 1.09f64.powi(i))).collect()
        }
    };
    let judging = judging(seen, options);
    // Which starts are good, some tell as well as all.
    let some: Vec<Seen> = seen.iter().step_by(seen.len().div_ceil(MOST_ASKED)).cloned().collect();
    let mut all: Vec<Start> = Vec::new();
    for camera in cameras {
        all.extend(starts(&camera, seen, options).into_iter().map(|pose| Start {
            score: misfit(&camera, &pose, &some, &judging),
            camera: camera.clone(),
            pose,
        }));
    }
    all.sort_by(|a, b| a.score.total_cmp(&b.score));
    all
}

/// Sum of ln(1 + d²) of the points' distances, in the deviations of image and ground, and of a known position's: wrong
/// points count for little, and no scale is needed.
fn misfit(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions) -> f64 {
    const BEHIND: f64 = 1e9;
    let distance = |s: &Seen| {
        let local = pose.to_camera(&s.xyz).into();
        camera.project(local)?;
        let (off, j) = camera.residual_with_jacobian(local, s.pixel);
        let j = Matrix2x3::from_fn(|r, c| j[r][c]) * pose.rotation;
        let ground = Matrix3::from_diagonal(&s.sigma_m.component_mul(&s.sigma_m));
        let q = Matrix2::identity() * options.sigma_px.powi(2) + j * ground * j.transpose();
        let v = Vector2::from(off);
        Some(v.dot(&(q.try_inverse()? * v)))
    };
    let of_points: f64 = seen.iter().map(|s| distance(s).unwrap_or(BEHIND).min(BEHIND).ln_1p()).sum();
    let off = |(at, sigma): &(Vector3<f64>, Vector3<f64>)| (pose.centre - at).component_div(sigma).norm_squared();
    of_points + options.position.as_ref().map_or(0.0, off).ln_1p()
}

/// The minima that the starts lead to, and whether one was passed over that leaves the focal length open.
fn minima(mut starts: Vec<Start>, seen: &[Seen], options: &ResectOptions) -> (Vec<Minimum>, bool) {
    let most = if seen.len() > MANY { BEST_STARTS_OF_MANY } else { BEST_STARTS };
    let few = seen.len() <= FEW;
    let mut found: Vec<Minimum> = Vec::new();
    let mut is_open = false;
    let mut tried: Vec<f64> = Vec::new();
    let (mut ends, mut creeping): (Vec<Approached>, Vec<Approached>) = Default::default();
    let mut taken = 0;
    // Wrong points can lead the best starts to one wrong focal length: the best of each is tried as well.
    starts.retain(|start| {
        let is_new = !tried.contains(&start.camera.f_px());
        if is_new {
            tried.push(start.camera.f_px());
        }
        taken += 1;
        is_new || few || taken <= 4 * most
    });
    let is_good = |m: &Minimum| m.scale() <= GOOD && 3 * m.found.blunders.len() <= seen.len();
    let mut refined = 0;
    for start in starts {
        let good = found.iter().any(is_good);
        if good && !few && refined >= most {
            break;
        }
        // A start beside a minimum leads there.
        if !few && found.iter().any(|m| is_beside(&m.found.pose, &start.pose, seen) && options.focal == Focal::Known) {
            continue;
        }
        refined += 1;
        // Gross errors may carry the focal length away before they are named: it is held until then as well.
        let held_too = (options.focal == Focal::Sought && !good && seen.len() > 4).then_some(Focal::Known);
        for at_first in std::iter::once(options.focal).chain(held_too) {
            let Ok(end) = approached(&start.camera, &start.pose, seen, options, at_first) else { continue };
            let [low, high] = bounds(&end.camera, options);
            if !(low..=high).contains(&end.camera.f_px()) {
                is_open = true;
                continue;
            }
            // What follows depends on nothing but where a start led.
            if ends.iter().any(|known| is_one_end(known, &end, seen)) {
                continue;
            }
            // Of few points all starts are tried: others lead to where these creep.
            if few && end.ended == Ended::OutOfIterations {
                creeping.push(end);
                continue;
            }
            found.extend(ended(&end, seen, options, &mut is_open));
            ends.push(end);
        }
    }
    for end in creeping.iter().take(most) {
        if found.is_empty() {
            found.extend(ended(end, seen, options, &mut is_open));
        }
    }
    (found, is_open)
}

/// The minimum near where a start led; none where no camera has its focal length.
fn ended(end: &Approached, seen: &[Seen], options: &ResectOptions, is_open: &mut bool) -> Option<Minimum> {
    let minimum = refine(&end.camera, &end.pose, seen, options).ok()?;
    let out = options.focal == Focal::Sought && !is_a_cameras(&minimum.found.camera);
    *is_open |= out;
    (!out).then_some(minimum)
}

/// What speaks against a minimum.
fn price(minimum: &Minimum, seen: &[Seen], options: &ResectOptions) -> f64 {
    let found = &minimum.found;
    // A point is wrong by the spread of the others, which may be larger than what was stated.
    let scale = minimum.scale();
    // A position that may be wrong itself counts for no more than a point.
    let position = match judging(seen, options).position {
        Some(_) => minimum.position,
        None => minimum.position.min(CALLED_WRONG),
    };
    let lowest = seen.iter().map(|s| s.xyz.z).fold(f64::INFINITY, f64::min);
    let below = found.pose.centre.z < lowest;
    // Of the image's top in the world, the part upwards: nought of a camera that looks straight down.
    let hangs = -found.pose.rotation[(1, 2)] < -0.5;
    let seldom = [below, hangs].into_iter().filter(|is_so| *is_so).count() as f64 * SELDOM;
    minimum.points + position + scale * (CALLED_WRONG * found.blunders.len() as f64 + seldom)
}

/// Whether it is a focal length that cameras have.
fn is_a_cameras(camera: &Camera) -> bool {
    FOCAL_SIDES.contains(&(camera.f_px() / camera.size_px[0].max(camera.size_px[1])))
}

/// Whether two starts led to one place, but for where the iteration ended.
fn is_one_end(known: &Approached, end: &Approached, seen: &[Seen]) -> bool {
    /// Shares of focal length and distance, and radians: a hundredth of what [`is_beside`] takes for one pose.
    const ONE: f64 = 1e-4;
    let nearest = || seen.iter().map(|s| (s.xyz - known.pose.centre).norm()).fold(f64::INFINITY, f64::min);
    (known.camera.f_px() - end.camera.f_px()).abs() <= ONE * known.camera.f_px()
        && (known.pose.centre - end.pose.centre).norm() <= ONE * nearest()
        && turn(&known.pose.rotation, &end.pose.rotation).norm() <= ONE
}

/// Whether two poses are near each other against the distance to the points.
fn is_beside(a: &Pose, b: &Pose, seen: &[Seen]) -> bool {
    let nearest = seen.iter().map(|s| (s.xyz - a.centre).norm()).fold(f64::INFINITY, f64::min);
    (a.centre - b.centre).norm() <= SAME_PLACE * nearest && turn(&a.rotation, &b.rotation).norm() <= SAME_TURN
}

/// Whether the deviations that are stated of the best minimum cover another one.
fn is_covered(best: &Resection, other: &Resection, seen: &[Seen]) -> bool {
    covers(best, other).unwrap_or_else(|| is_beside(&best.pose, &other.pose, seen))
        || is_of_other_points(best, other, seen)
}

/// Whether two alternatives are one pose: each lies within the deviations that are stated of the other. The wide ones
/// of one alone would hide another that is known well.
fn is_one_pose(a: &Resection, b: &Resection, seen: &[Seen]) -> bool {
    let is_one = match (covers(a, b), covers(b, a)) {
        (Some(there), Some(back)) => there && back,
        _ => is_beside(&a.pose, &b.pose, seen),
    };
    is_one || is_of_other_points(a, b, seen)
}

/// Whether the deviations of a minimum cover another one; `None` where it has none.
fn covers(minimum: &Resection, other: &Resection) -> Option<bool> {
    let covariance = minimum.covariance.as_ref()?;
    let turned = turn(&other.pose.rotation, &minimum.pose.rotation);
    let moved = other.pose.centre - minimum.pose.centre;
    let covers = |i: usize| {
        let by = if i < 3 { turned[i] } else { moved[i - 3] };
        by.abs() <= SAME_SIGMAS * covariance[(i, i)].max(0.0).sqrt()
    };
    Some((0..6).all(covers))
}

/// Minima with other wrong points lie beside each other without being two poses.
fn is_of_other_points(a: &Resection, b: &Resection, seen: &[Seen]) -> bool {
    a.blunders != b.blunders && is_beside(&a.pose, &b.pose, seen)
}
