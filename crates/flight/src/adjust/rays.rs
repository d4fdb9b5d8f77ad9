//! Image points of a GCP against each other, whatever its survey is worth.
//!
//! A survey of 2 m is 400 px wide under a drone ten metres up: measured against it no image point is wrong. The ties
//! hold the frames to a fraction of a pixel, so the rays of a point tell which of them passes the others by.

use autoref_raster::ranks::upper_median;
use nalgebra::Vector3;

use crate::bundle::{Observation, Problem};
use crate::intersect::intersect;

/// Times the spread within which rays of one point meet.
pub(super) const MEET: f64 = 4.0;
/// Pairs of rays that are tried for one point; of more, some.
const MOST_PAIRS: usize = 300;
/// The median length of a normal 2-vector, in σ.
const MEDIAN_LENGTH: f64 = 1.1774;

/// A point where most of its rays meet, and the measurements that pass it by, by their numbers.
pub(super) struct Apart {
    pub point: usize,
    pub meet: Vector3<f64>,
    pub wrong: Vec<usize>,
}

/// A GCP with three image points or more, the number of each in the problem before it.
struct Bundle {
    point: usize,
    seen: Vec<(usize, Observation)>,
}

/// The GCPs whose rays meet but for some that pass by at more than `times` what is usual.
pub(super) fn apart(problem: &Problem, ties: usize, times: f64) -> Vec<Apart> {
    let bundles = bundles(problem, ties);
    let places: Vec<Vec<Vector3<f64>>> = bundles.iter().map(|b| candidates(problem, b)).collect();
    // First by what is stated, then by what the block shows: one that is bent has wider rays.
    let mut spread = 0.0;
    for _ in 0..2 {
        let mut misses: Vec<f64> = Vec::new();
        for (bundle, places) in bundles.iter().zip(&places) {
            if let Some(at) = best(problem, bundle, places, times, spread) {
                misses.extend(bundle.seen.iter().map(|(_, o)| miss_px(problem, o, &at)));
            }
        }
        let middle = upper_median(&mut misses).filter(|m| m.is_finite());
        spread = middle.unwrap_or(0.0) / MEDIAN_LENGTH;
    }
    let judge = |(bundle, places): (&Bundle, &Vec<Vector3<f64>>)| {
        let meet = best(problem, bundle, places, times, spread)?;
        let off = |o: &Observation| miss_px(problem, o, &meet) / spread.max(o.sigma_px);
        let agree = bundle.seen.iter().filter(|(_, o)| off(o) <= MEET).count();
        let wrong: Vec<usize> = bundle.seen.iter().filter(|(_, o)| off(o) > times).map(|(index, _)| *index).collect();
        (agree >= 2 && agree > wrong.len() && !wrong.is_empty()).then_some(Apart { point: bundle.point, meet, wrong })
    };
    bundles.iter().zip(&places).filter_map(judge).collect()
}

fn bundles(problem: &Problem, ties: usize) -> Vec<Bundle> {
    let of = |point| Bundle { point, seen: Vec::new() };
    let mut all: Vec<Bundle> = (ties..problem.points.len()).map(of).collect();
    for (index, o) in problem.observations.iter().enumerate().filter(|(_, o)| o.point >= ties) {
        all[o.point - ties].seen.push((index, *o));
    }
    all.retain(|b| b.seen.len() >= 3);
    all
}

/// Where two rays each meet: one gross error leaves those of the others right.
fn candidates(problem: &Problem, bundle: &Bundle) -> Vec<Vector3<f64>> {
    let n = bundle.seen.len();
    let step = (n * (n - 1) / 2).div_ceil(MOST_PAIRS).max(1);
    let pairs = (0..n).flat_map(|i| (0..i).map(move |j| (j, i))).step_by(step);
    pairs.filter_map(|(i, j)| meet(problem, [&bundle.seen[i].1, &bundle.seen[j].1])).collect()
}

fn meet(problem: &Problem, two: [&Observation; 2]) -> Option<Vector3<f64>> {
    let cameras = two.map(|o| problem.cameras[problem.frames[o.frame].camera].camera.clone());
    let poses = [0, 1].map(|i| (i, problem.frames[two[i].frame].pose));
    intersect(&cameras, &poses, &two.map(|o| o.pixel)).filter(|x| x.iter().all(|v| v.is_finite()))
}

/// The place that most rays pass; of places alike the one nearest the survey, which tells apart what two rays make of
/// each other by chance.
fn best(problem: &Problem, bundle: &Bundle, places: &[Vector3<f64>], times: f64, spread: f64) -> Option<Vector3<f64>> {
    let cost = |x: &Vector3<f64>| {
        let rays: f64 =
            bundle.seen.iter().map(|(_, o)| (miss_px(problem, o, x) / spread.max(o.sigma_px)).min(times).powi(2)).sum();
        let survey = problem.points[bundle.point].survey;
        rays + survey.map_or(0.0, |(at, sigma)| (x - at).component_div(&sigma).norm_squared().min(times * times))
    };
    let mut best: Option<(f64, Vector3<f64>)> = None;
    for x in places {
        let cost = cost(x);
        if best.is_none_or(|b| cost < b.0) {
            best = Some((cost, *x));
        }
    }
    best.map(|b| b.1)
}

/// How far from its measurement a place is seen, pixels; infinite where the camera does not see it.
fn miss_px(problem: &Problem, o: &Observation, x: &Vector3<f64>) -> f64 {
    let frame = &problem.frames[o.frame];
    let camera = &problem.cameras[frame.camera].camera;
    camera.residual(frame.pose.to_camera(x).into(), o.pixel).map_or(f64::INFINITY, |[x, y]| x.hypot(y))
}
