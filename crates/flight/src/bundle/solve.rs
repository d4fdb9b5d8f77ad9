//! The problem of any size, and its least squares.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::descent::{Descent, Options, Solved, Summary, Way, descend};
use super::layout::{Layout, MOST_INTERIOR};
use super::linear::Curvature;
use super::normal::{Factored, Reduced, SOLVABLE, Step};
use super::problem::{BundleCamera, BundleFrame, BundlePoint, Loss, Problem};
use super::single::{is_single, solve_single};
use super::small::tidy;
use crate::error::{Error, Result};

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
    Ok(descend(&mut Block { tried: Unknowns::of(problem), problem, layout, options }, options))
}

/// All that moves.
struct Unknowns {
    frames: Vec<BundleFrame>,
    cameras: Vec<BundleCamera>,
    points: Vec<BundlePoint>,
    offset: Option<Vector3<f64>>,
}

impl Unknowns {
    fn of(problem: &Problem) -> Self {
        let Problem { frames, cameras, points, offset, .. } = problem;
        Unknowns { frames: frames.clone(), cameras: cameras.clone(), points: points.clone(), offset: *offset }
    }

    /// Changes places with those of the problem, whose observations stay.
    fn exchange(&mut self, problem: &mut Problem) {
        std::mem::swap(&mut self.frames, &mut problem.frames);
        std::mem::swap(&mut self.cameras, &mut problem.cameras);
        std::mem::swap(&mut self.points, &mut problem.points);
        std::mem::swap(&mut self.offset, &mut problem.offset);
    }
}

/// A problem of any size.
struct Block<'a> {
    problem: &'a mut Problem,
    /// Where it was tried last.
    tried: Unknowns,
    layout: Layout,
    options: &'a Options,
}

impl Descent for Block<'_> {
    type Step = Step;

    fn cost(&self) -> f64 {
        self.problem.cost(self.options.loss)
    }

    fn solved(&self, curvature: Curvature, damping: f64, least_slope: f64) -> Solved<Step> {
        let reduced = Reduced::new(self.problem, &self.layout, self.options.loss, curvature, damping);
        if reduced.slope < least_slope {
            return Solved::Level;
        }
        let step = reduced.step(SOLVABLE);
        step.map_or(Solved::Unsolvable, |step| Solved::Step { foretold: step.gain, step })
    }

    fn tried(&mut self, step: &Step, way: Way) -> Option<f64> {
        let (common, reach) = match way {
            Way::Straight(reach) => (Common::none(), reach),
            Way::AsOne => (Common::of_step(self.problem, &self.layout, step), 1.0),
        };
        moved(self.problem, &self.layout, step, reach, &common, &mut self.tried);
        self.tried.exchange(self.problem);
        let cost = self.cost();
        self.tried.exchange(self.problem);
        Some(cost)
    }

    fn accept(&mut self) {
        self.tried.exchange(self.problem);
    }

    /// It stands there still.
    fn refuse(&mut self) {}

    fn is_out_of_bounds(&self) -> bool {
        self.options.lets_go_of(self.problem)
    }
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

/// Where a step leads, gone `reach` times. What is `common` to the step (a turn, a scale, a shift of all) is done
/// exactly, so that the images stay as they are: only what is left follows the straight line of the linear model.
fn moved(problem: &Problem, layout: &Layout, step: &Step, reach: f64, common: &Common, to: &mut Unknowns) {
    for ((frame, at), next) in problem.frames.iter().zip(&layout.frame_at).zip(&mut to.frames) {
        let rotation = frame.pose.rotation;
        let left = part(step, *at) * reach + rotation * common.turn;
        next.pose.rotation = tidy(Rotation3::new(left).matrix() * rotation * common.rotation.transpose());
        next.pose.centre = common.apply(&frame.pose.centre, &(part(step, at + 3) * reach));
    }
    for (i, (camera, next)) in problem.cameras.iter().zip(&mut to.cameras).enumerate() {
        for (k, p) in layout.active[i].iter().enumerate() {
            let value = camera.camera.get(*p) + step.reduced[layout.interior_at[i] + k] * reach;
            next.camera.set(*p, value);
        }
    }
    for ((point, step), next) in problem.points.iter().zip(&step.points).zip(&mut to.points) {
        next.xyz = common.apply(&point.xyz, &(step * reach));
    }
    to.offset = problem.offset.zip(layout.offset_at).map(|(offset, at)| offset + part(step, at) * reach);
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
