//! Levenberg and Marquardt's iteration: damped steps down to a minimum.

use super::linear::Curvature;
use super::problem::{Loss, Problem};

/// How far and how long the iteration goes.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub loss: Loss,
    pub most_iterations: usize,
    /// Ends when a step lowers the cost by less than this part of it.
    pub least_gain: f64,
    /// Ends when a focal length leaves these bounds, pixels.
    pub focal_px: [f64; 2],
    /// How strongly the first step is damped: [`FROM_AFAR`] or [`FROM_NEAR`].
    pub damping: f64,
}

/// Damping, as a share of the diagonal, of a start that may be far from the minimum.
pub const FROM_AFAR: f64 = 1e-4;

/// Of one that comes from a minimum of nearly the same problem: it must not hold the slow bends of long lines.
pub const FROM_NEAR: f64 = 1e-10;

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
        let (loss, focal_px, damping) = (Loss::Huber(3.0), ANY_FOCAL, FROM_AFAR);
        Options { loss, most_iterations: 100, least_gain: 1e-10, focal_px, damping }
    }
}

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

/// How the iteration went.
#[derive(Clone, Copy, Debug)]
pub struct Summary {
    pub first_cost: f64,
    pub cost: f64,
    pub iterations: usize,
    pub ended: Ended,
    /// By which part of itself the cost fell in the last step.
    pub last_fall: f64,
}

/// Share of the foretold fall of the cost above which the linear model is believed.
const FORETOLD: f64 = 0.75;
/// A cost that fell by less than this part of it is near its end.
const NEAR: f64 = 0.03;
/// Share of the foretold fall of the cost from which longer steps are tried, and the longest.
const CREEPING: f64 = 1.5;
const FARTHEST_REACH: f64 = 256.0;
/// The shortest part of a step that is tried.
const SHORTEST_REACH: f64 = 1.0 / 64.0;

/// What the damped normal equations say.
pub(super) enum Solved<Step> {
    /// Nothing slopes any more.
    Level,
    /// The matrix is not positive definite.
    Unsolvable,
    Step {
        step: Step,
        /// What the linear model says the cost falls by.
        foretold: f64,
    },
}

/// How a step is gone.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Way {
    /// So many times as far as the linear model says.
    Straight(f64),
    /// What moves as one is moved as one.
    AsOne,
}

/// What is adjusted: where it stands, and where it is tried.
pub(super) trait Descent {
    type Step;
    /// The cost where it stands.
    fn cost(&self) -> f64;
    /// The step from where it stands; level where no slope exceeds `least_slope`.
    fn solved(&self, curvature: Curvature, damping: f64, least_slope: f64) -> Solved<Self::Step>;
    /// The cost a step from where it stands, which is the place that is tried now; `None` where it knows no such way.
    fn tried(&mut self, step: &Self::Step, way: Way) -> Option<f64>;
    /// Stands at the place that was tried last.
    fn accept(&mut self);
    /// Stands where it stood before places were tried.
    fn refuse(&mut self);
    /// Whether it has left its bounds.
    fn is_out_of_bounds(&self) -> bool;
}

/// The place of least cost that one step leads to: its cost, and what of the foretold fall the step itself brought.
/// Parts of the step are tried where all of it leads up and `shorter` asks for them.
fn best_place<D: Descent>(place: &mut D, step: &D::Step, foretold: f64, cost: f64, shorter: bool) -> (f64, f64) {
    let cost_of = |place: &mut D, way| place.tried(step, way).unwrap_or(f64::INFINITY);
    let foretold = foretold.max(f64::MIN_POSITIVE);
    let (mut way, mut last) = (Way::Straight(1.0), Way::Straight(1.0));
    let mut next = cost_of(place, way);
    // Where the straight line leads astray, what moves as one may be what bends it.
    if (!next.is_finite() || cost - next < FORETOLD * foretold)
        && let Some(whole) = place.tried(step, Way::AsOne)
    {
        last = Way::AsOne;
        if whole < next || !next.is_finite() {
            (next, way) = (whole, last);
        }
    }
    let ratio = (cost - next) / foretold;
    // Robust weights foretell too little along what is hardly determined: farther on it falls still.
    let mut reach = 2.0;
    while ratio > CREEPING && reach <= FARTHEST_REACH {
        last = Way::Straight(reach);
        let far = cost_of(place, last);
        if far.is_nan() || far >= next {
            break;
        }
        (next, way) = (far, last);
        reach *= 2.0;
    }
    // Where the loss bends on the way, the way is right and too long.
    let mut reach = 0.5;
    while shorter && (next.is_nan() || next >= cost) && reach >= SHORTEST_REACH {
        (way, last) = (Way::Straight(reach), Way::Straight(reach));
        next = cost_of(place, way);
        reach *= 0.5;
    }
    if last != way {
        next = cost_of(place, way);
    }
    (next, ratio)
}

/// Goes down to the minimum.
pub(super) fn descend<D: Descent>(place: &mut D, options: &Options) -> Summary {
    let first_cost = place.cost();
    let (mut cost, mut last_fall) = (first_cost, 0.0);
    let (mut damping, mut grow) = (options.damping, 2.0);
    // Weights by the loss alone make safe steps from afar; near the end its curvature makes them fast.
    let mut curvature = Curvature::Weights;
    let end = |cost, iterations, ended, last_fall| Summary { first_cost, cost, iterations, ended, last_fall };
    for iteration in 0..options.most_iterations {
        let mut accepted = false;
        // 60 doublings that grow are a damping of 10^500: stuck long before.
        for _ in 0..30 {
            let (step, foretold) = match place.solved(curvature, damping, 1e-12 * (1.0 + cost.sqrt())) {
                Solved::Level => return end(cost, iteration, Ended::Converged, last_fall),
                Solved::Unsolvable => {
                    damping *= grow;
                    grow *= 2.0;
                    continue;
                }
                Solved::Step { step, foretold } => (step, foretold),
            };
            let (next, ratio) = best_place(place, &step, foretold, cost, curvature == Curvature::Whole);
            if next.is_finite() && next < cost {
                place.accept();
                let fall = cost - next;
                last_fall = fall / cost;
                // Nielsen's rule, faster where the model foretells the fall: long blocks bend by what damping must not
                // hold.
                let least = if ratio > FORETOLD { 0.05 } else { 1.0 / 3.0 };
                damping = (damping * (1.0 - (2.0 * ratio.clamp(0.0, 1.0) - 1.0).powi(3)).max(least)).max(1e-14);
                grow = 2.0;
                let done = fall <= options.least_gain * cost;
                curvature = if fall < NEAR * cost { Curvature::Whole } else { Curvature::Weights };
                cost = next;
                if place.is_out_of_bounds() {
                    return end(cost, iteration + 1, Ended::Left, last_fall);
                }
                if done {
                    return end(cost, iteration + 1, Ended::Converged, last_fall);
                }
                accepted = true;
                break;
            }
            place.refuse();
            if foretold <= options.least_gain * cost {
                // Rounding, not the model, decides from here on.
                return end(cost, iteration, Ended::Converged, last_fall);
            }
            if curvature == Curvature::Whole {
                curvature = Curvature::Weights;
                continue;
            }
            damping *= grow;
            grow *= 2.0;
        }
        if !accepted {
            return end(cost, iteration, Ended::Stuck, last_fall);
        }
    }
    end(cost, options.most_iterations, Ended::OutOfIterations, last_fall)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// √(1 + x²): what the curvature says leads three times too far and more from places beyond 1, the weights creep.
    struct Hollow {
        at: f64,
        tried: f64,
    }

    impl Descent for Hollow {
        type Step = f64;
        fn cost(&self) -> f64 {
            self.at.hypot(1.0)
        }
        fn solved(&self, curvature: Curvature, _: f64, least_slope: f64) -> Solved<f64> {
            let slope = self.at / self.at.hypot(1.0);
            if slope.abs() < least_slope {
                return Solved::Level;
            }
            let step = match curvature {
                Curvature::Whole => -self.at * (1.0 + self.at * self.at),
                Curvature::Weights => -0.02 * self.at,
            };
            Solved::Step { step, foretold: -0.5 * step * slope }
        }
        fn tried(&mut self, step: &f64, way: Way) -> Option<f64> {
            let Way::Straight(reach) = way else { return None };
            // No farther than the model says: what is tested are shorter steps.
            self.tried = self.at + step * reach.min(1.0);
            Some(self.tried.hypot(1.0))
        }
        fn accept(&mut self) {
            self.at = self.tried;
        }
        fn refuse(&mut self) {}
        fn is_out_of_bounds(&self) -> bool {
            false
        }
    }

    #[test]
    fn a_step_that_leads_too_far_is_gone_in_part() {
        let options = Options {
            loss: Loss::Squared,
            most_iterations: 100,
            least_gain: 1e-10,
            focal_px: ANY_FOCAL,
            damping: FROM_NEAR,
        };
        let mut place = Hollow { at: 3.0, tried: 0.0 };
        let summary = descend(&mut place, &options);
        assert_eq!(summary.ended, Ended::Converged);
        assert!(place.at.abs() < 1e-4 && summary.iterations < 15, "{} after {}", place.at, summary.iterations);
    }
}
