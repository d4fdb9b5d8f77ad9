//! Levenberg and Marquardt's iteration.

use nalgebra::{Rotation3, Vector3};

use super::normal::{Curvature, Factored, Layout, MOST_INTERIOR, Reduced, Step};
use super::{Loss, Problem};
use crate::error::{Error, Result};

#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub loss: Loss,
    pub most_iterations: usize,
    /// Ends when a step lowers the cost by less than this part of it.
    pub least_gain: f64,
}

impl Default for Options {
    fn default() -> Self {
        Options { loss: Loss::Huber(3.0), most_iterations: 100, least_gain: 1e-10 }
    }
}

/// Share of the foretold fall of the cost above which the linear model is believed.
const FORETOLD: f64 = 0.75;

/// Why the iteration ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ended {
    /// The cost falls no more.
    Converged,
    /// The limit of iterations was reached.
    OutOfIterations,
    /// No damping finds a lower cost.
    Stuck,
}

#[derive(Clone, Copy, Debug)]
pub struct Summary {
    pub first_cost: f64,
    pub cost: f64,
    pub iterations: usize,
    pub ended: Ended,
}

/// Adjusts the problem in place.
///
/// # Errors
/// When a number is not finite, an index points nowhere, or more than 13 parameters of one camera are adjusted.
pub fn solve(problem: &mut Problem, options: &Options) -> Result<Summary> {
    check(problem)?;
    let layout = Layout::new(problem);
    let first_cost = problem.cost(options.loss);
    let mut cost = first_cost;
    let (mut damping, mut grow) = (1e-4, 2.0);
    for iteration in 0..options.most_iterations {
        let mut accepted = false;
        // 60 doublings that grow are a damping of 10^500: stuck long before.
        for _ in 0..30 {
            let reduced = Reduced::new(problem, &layout, options.loss, Curvature::Whole, damping);
            if reduced.slope < 1e-12 * (1.0 + cost.sqrt()) {
                return Ok(Summary { first_cost, cost, iterations: iteration, ended: Ended::Converged });
            }
            let Some(step) = reduced.step() else {
                damping *= grow;
                grow *= 2.0;
                continue;
            };
            let next = moved(problem, &layout, &step);
            let next_cost = next.cost(options.loss);
            let ratio = (cost - next_cost) / step.gain.max(f64::MIN_POSITIVE);
            if next_cost.is_finite() && next_cost < cost {
                let fall = cost - next_cost;
                *problem = next;
                // Nielsen's rule, faster where the model foretells the fall: long blocks bend by what damping must not hold.
                let least = if ratio > FORETOLD { 0.05 } else { 1.0 / 3.0 };
                damping = (damping * (1.0 - (2.0 * ratio.clamp(0.0, 1.0) - 1.0).powi(3)).max(least)).max(1e-14);
                grow = 2.0;
                let done = fall <= options.least_gain * cost;
                cost = next_cost;
                if done {
                    return Ok(Summary { first_cost, cost, iterations: iteration + 1, ended: Ended::Converged });
                }
                accepted = true;
                break;
            }
            if step.gain <= options.least_gain * cost {
                // Rounding, not the model, decides from here on.
                return Ok(Summary { first_cost, cost, iterations: iteration, ended: Ended::Converged });
            }
            damping *= grow;
            grow *= 2.0;
        }
        if !accepted {
            return Ok(Summary { first_cost, cost, iterations: iteration, ended: Ended::Stuck });
        }
    }
    Ok(Summary { first_cost, cost, iterations: options.most_iterations, ended: Ended::OutOfIterations })
}

/// The normal equations at the present values, for covariances; `None` when the datum is not fixed by what was measured.
pub fn factor(problem: &Problem, loss: Loss) -> Option<Factored> {
    let layout = Layout::new(problem);
    Reduced::new(problem, &layout, loss, Curvature::Weights, 0.0).factored(layout)
}

fn moved(problem: &Problem, layout: &Layout, step: &Step) -> Problem {
    let mut next = problem.clone();
    for (i, frame) in next.frames.iter_mut().enumerate() {
        let at = layout.frame_at[i];
        let part = |k: usize| Vector3::new(step.reduced[at + k], step.reduced[at + k + 1], step.reduced[at + k + 2]);
        frame.pose.rotation = Rotation3::new(part(0)).matrix() * frame.pose.rotation;
        frame.pose.rotation = tidy(frame.pose.rotation);
        frame.pose.centre += part(3);
    }
    for (i, camera) in next.cameras.iter_mut().enumerate() {
        for (k, p) in layout.active[i].iter().enumerate() {
            let value = camera.camera.get(*p) + step.reduced[layout.interior_at[i] + k];
            camera.camera.set(*p, value);
        }
    }
    for (point, step) in next.points.iter_mut().zip(&step.points) {
        point.xyz += step;
    }
    next
}

/// One step of Newton towards the nearest rotation: rounding must not add up over iterations.
fn tidy(r: nalgebra::Matrix3<f64>) -> nalgebra::Matrix3<f64> {
    r * (nalgebra::Matrix3::identity() * 3.0 - r.transpose() * r) * 0.5
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
