//! Levenberg and Marquardt's iteration.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::layout::{Layout, MOST_INTERIOR};
use super::linear::Curvature;
use super::normal::{Factored, Reduced, SOLVABLE, Step};
use super::single::{is_single, solve_single};
use super::{Loss, Problem};
use crate::error::{Error, Result};

#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub loss: Loss,
    pub most_iterations: usize,
    /// Ends when a step lowers the cost by less than this part of it.
    pub least_gain: f64,
    /// Ends when a focal length leaves these bounds, pixels.
    pub focal_px: [f64; 2],
}

/// No bounds of focal lengths.
pub const ANY_FOCAL: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

impl Options {
    /// Whether a focal length is out of bounds.
    pub(super) fn lets_go_of(&self, problem: &Problem) -> bool {
        let [low, high] = self.focal_px;
        !problem.cameras.iter().all(|c| (low..=high).contains(&c.camera.f_px()))
    }
}

impl Default for Options {
    fn default() -> Self {
        Options { loss: Loss::Huber(3.0), most_iterations: 100, least_gain: 1e-10, focal_px: ANY_FOCAL }
    }
}

/// Share of the foretold fall of the cost above which the linear model is believed.
pub(super) const FORETOLD: f64 = 0.75;
/// A cost that fell by less than this part of it is near its end.
pub(super) const NEAR: f64 = 0.03;

/// Share of the foretold fall of the cost from which longer steps are tried, and the longest.
pub(super) const CREEPING: f64 = 1.5;
pub(super) const FARTHEST_REACH: f64 = 256.0;

/// Why the iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The cost falls no more.
    Converged,
    /// The limit of iterations was reached.
    OutOfIterations,
    /// No damping finds a lower cost.
    Stuck,
    /// A focal length left its bounds.
    Left,
}

#[derive(Clone, Copy, Debug)]
pub struct Summary {
    pub first_cost: f64,
    pub cost: f64,
    pub iterations: usize,
    pub ended: Ended,
    /// By which part of itself the cost fell in the last step.
    pub last_fall: f64,
}

/// Adjusts the problem in place.
///
/// # Errors
/// When a number is not finite, an index points nowhere, or more than 13 parameters of one camera are adjusted.
pub fn solve(problem: &mut Problem, options: &Options) -> Result<Summary> {
    check(problem)?;
    if is_single(problem) {
        return Ok(solve_single(problem, options));
    }
    let layout = Layout::new(problem);
    let first_cost = problem.cost(options.loss);
    let (mut cost, mut last_fall) = (first_cost, 0.0);
    let (mut damping, mut grow) = (1e-4, 2.0);
    // Weights by the loss alone make safe steps from afar; near the end its curvature makes them fast.
    let mut curvature = Curvature::Weights;
    let end = |cost, iterations, ended, last_fall| Summary { first_cost, cost, iterations, ended, last_fall };
    for iteration in 0..options.most_iterations {
        let mut accepted = false;
        // 60 doublings that grow are a damping of 10^500: stuck long before.
        for _ in 0..30 {
            let reduced = Reduced::new(problem, &layout, options.loss, curvature, damping);
            if reduced.slope < 1e-12 * (1.0 + cost.sqrt()) {
                return Ok(end(cost, iteration, Ended::Converged, last_fall));
            }
            let Some(step) = reduced.step(SOLVABLE) else {
                damping *= grow;
                grow *= 2.0;
                continue;
            };
            let mut next = moved(problem, &layout, &step, &Common::none());
            let mut next_cost = next.cost(options.loss);
            let foretold = step.gain.max(f64::MIN_POSITIVE);
            // Where the straight line leads astray, what moves as one may be what bends it.
            if !next_cost.is_finite() || cost - next_cost < FORETOLD * foretold {
                let whole = moved(problem, &layout, &step, &Common::of_step(problem, &layout, &step));
                let whole_cost = whole.cost(options.loss);
                if whole_cost < next_cost || !next_cost.is_finite() {
                    (next, next_cost) = (whole, whole_cost);
                }
            }
            let ratio = (cost - next_cost) / foretold;
            // Robust weights foretell too little along what is hardly determined: farther on it falls still.
            let mut reach = 2.0;
            while ratio > CREEPING && reach <= FARTHEST_REACH {
                let far = moved(problem, &layout, &step.times(reach), &Common::none());
                let far_cost = far.cost(options.loss);
                if far_cost.is_nan() || far_cost >= next_cost {
                    break;
                }
                (next, next_cost) = (far, far_cost);
                reach *= 2.0;
            }
            if next_cost.is_finite() && next_cost < cost {
                let fall = cost - next_cost;
                last_fall = fall / cost;
                *problem = next;
                // Nielsen's rule, faster where the model foretells the fall: long blocks bend by what damping must not
                // hold.
                let least = if ratio > FORETOLD { 0.05 } else { 1.0 / 3.0 };
                damping = (damping * (1.0 - (2.0 * ratio.clamp(0.0, 1.0) - 1.0).powi(3)).max(least)).max(1e-14);
                grow = 2.0;
                let done = fall <= options.least_gain * cost;
                curvature = if fall < NEAR * cost { Curvature::Whole } else { Curvature::Weights };
                cost = next_cost;
                if options.lets_go_of(problem) {
                    return Ok(Summary { first_cost, cost, iterations: iteration + 1, ended: Ended::Left, last_fall });
                }
                if done {
                    return Ok(end(cost, iteration + 1, Ended::Converged, last_fall));
                }
                accepted = true;
                break;
            }
            if step.gain <= options.least_gain * cost {
                // Rounding, not the model, decides from here on.
                return Ok(end(cost, iteration, Ended::Converged, last_fall));
            }
            if curvature == Curvature::Whole {
                curvature = Curvature::Weights;
                continue;
            }
            damping *= grow;
            grow *= 2.0;
        }
        if !accepted {
            return Ok(end(cost, iteration, Ended::Stuck, last_fall));
        }
    }
    Ok(end(cost, options.most_iterations, Ended::OutOfIterations, last_fall))
}

/// The normal equations at the present values, for covariances; `None` when the datum is not fixed by what was
/// measured.
pub fn factor(problem: &Problem, loss: Loss) -> Option<Factored> {
    let layout = Layout::new(problem);
    Reduced::new(problem, &layout, loss, Curvature::Weights, 0.0).factored(layout)
}

fn part(step: &Step, at: usize) -> Vector3<f64> {
    Vector3::new(step.reduced[at], step.reduced[at + 1], step.reduced[at + 2])
}

/// The problem after a step. What is `common` to the step (a turn, a scale, a shift of all) is done exactly, so that
/// the images stay as they are: only what is left follows the straight line of the linear model.
fn moved(problem: &Problem, layout: &Layout, step: &Step, common: &Common) -> Problem {
    let mut next = problem.clone();
    for (frame, at) in next.frames.iter_mut().zip(&layout.frame_at) {
        let rotation = frame.pose.rotation;
        let left = part(step, *at) + rotation * common.turn;
        frame.pose.rotation = tidy(Rotation3::new(left).matrix() * rotation * common.rotation.transpose());
        frame.pose.centre = common.apply(&frame.pose.centre, &part(step, at + 3));
    }
    for (i, camera) in next.cameras.iter_mut().enumerate() {
        for (k, p) in layout.active[i].iter().enumerate() {
            let value = camera.camera.get(*p) + step.reduced[layout.interior_at[i] + k];
            camera.camera.set(*p, value);
        }
    }
    for (point, step) in next.points.iter_mut().zip(&step.points) {
        point.xyz = common.apply(&point.xyz, step);
    }
    next
}

/// The similarity that comes nearest to a step of all places.
struct Common {
    middle: Vector3<f64>,
    shift: Vector3<f64>,
    turn: Vector3<f64>,
    growth: f64,
    rotation: Matrix3<f64>,
}

impl Common {
    fn none() -> Self {
        let zero = Vector3::zeros();
        Common { middle: zero, shift: zero, turn: zero, growth: 0.0, rotation: Matrix3::identity() }
    }

    fn of_step(problem: &Problem, layout: &Layout, step: &Step) -> Self {
        let frames = problem.frames.iter().zip(&layout.frame_at);
        let frames = frames.map(|(frame, at)| (frame.pose.centre, part(step, at + 3)));
        Common::of(frames.chain(problem.points.iter().zip(&step.points).map(|(p, step)| (p.xyz, *step))))
    }

    /// Of places and their steps.
    fn of(places: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + Clone) -> Self {
        let n = places.clone().count().max(1) as f64;
        let (at, by) = places.clone().fold((Vector3::zeros(), Vector3::zeros()), |(a, b), (x, d)| (a + x, b + d));
        let (middle, shift) = (at / n, by / n);
        let (mut inertia, mut moment) = (Matrix3::zeros(), Vector3::zeros());
        let (mut along, mut size) = (0.0, 0.0);
        for (x, d) in places {
            let r = x - middle;
            inertia += Matrix3::identity() * r.norm_squared() - r * r.transpose();
            moment += r.cross(&d);
            along += r.dot(&d);
            size += r.norm_squared();
        }
        let turn = inertia.try_inverse().map_or_else(Vector3::zeros, |i| i * moment);
        let growth = if size > 0.0 { along / size } else { 0.0 };
        let fine = turn.iter().all(|v| v.is_finite()) && growth.abs() < 0.7;
        let (turn, growth) = if fine { (turn, growth) } else { (Vector3::zeros(), 0.0) };
        Common { middle, shift, turn, growth, rotation: *Rotation3::new(turn).matrix() }
    }

    /// A place after its step.
    fn apply(&self, x: &Vector3<f64>, step: &Vector3<f64>) -> Vector3<f64> {
        let r = x - self.middle;
        let left = step - self.shift - self.turn.cross(&r) - r * self.growth;
        self.middle + self.shift + self.rotation * r * self.growth.exp() + left
    }
}

/// One step of Newton towards the nearest rotation: rounding must not add up over iterations.
pub(super) fn tidy(r: Matrix3<f64>) -> Matrix3<f64> {
    r * (Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5
}

fn check(problem: &Problem) -> Result<()> {
    let bad = |what: String| Err(Error::usage(what, "correct the input"));
    for (i, c) in problem.cameras.iter().enumerate() {
        if c.active().len() > MOST_INTERIOR {
            return bad(format!("camera {i}: more than {MOST_INTERIOR} interior parameters are to be adjusted"));
        }
        if !c.camera.values.iter().all(|v| v.is_finite()) {
            return bad(format!("camera {i}: a parameter is not finite"));
        }
    }
    for (i, f) in problem.frames.iter().enumerate() {
        if f.camera >= problem.cameras.len()
            || !f.pose.centre.iter().chain(f.pose.rotation.iter()).all(|v| v.is_finite())
        {
            return bad(format!("frame {i}: its camera is missing or its pose is not finite"));
        }
    }
    for (i, p) in problem.points.iter().enumerate() {
        let sigmas = p.survey.is_none_or(|(at, s)| at.iter().all(|v| v.is_finite()) && s.iter().all(|v| *v > 0.0));
        if !sigmas || !p.xyz.iter().all(|v| v.is_finite()) {
            return bad(format!("point {i}: not finite, or a standard deviation is not positive"));
        }
    }
    for (i, o) in problem.observations.iter().enumerate() {
        let fine = o.frame < problem.frames.len() && o.point < problem.points.len() && o.sigma_px > 0.0;
        if !fine || !o.pixel.iter().all(|v| v.is_finite()) {
            return bad(format!("observation {i}: not finite, without σ, or of nothing"));
        }
    }
    Ok(())
}
