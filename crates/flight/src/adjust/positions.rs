//! Positions of cameras that place a block alone, or lie off it together, tested as GCPs are elsewhere.

use autoref_raster::ranks::upper_median;
use nalgebra::Vector3;

use super::snooping::{LOSS, snooped};
use super::survey::GroundPoint;
use crate::bundle::{BundleFrame, Options, Problem, factor, solve};
use crate::error::Result;
use crate::read::Reconstruction;

/// Standard deviations that a position is not off by chance; receivers drift, so more than for GCPs.
const FAR: f64 = 5.0;
/// Share of the positions that may be wrong, and one at least; where more seem to be, the block is in doubt.
const MOST: f64 = 0.2;
/// Fewer positions than this do not tell which of them is wrong.
pub(super) const LEAST: usize = 5;
/// Positions that are sought one after another, an adjustment each.
const MOST_ROUNDS: usize = 20;
/// Positions that are tested in a round, those that are farthest off.
const MOST_TESTED: usize = 50;

/// A position that the others contradict.
#[derive(Clone, Debug)]
struct Wrong {
    frame: usize,
    at: Vector3<f64>,
    sigma: Vector3<f64>,
    test: f64,
}

/// A position that takes no part, and its standard deviation.
pub(super) struct Aside {
    frame: usize,
    at: Vector3<f64>,
    sigma: Vector3<f64>,
}

/// Whether positions are tested one by one: they place the block, or GCPs do and what all are off together is sought.
pub(super) fn are_tested(problem: &Problem, control: &[&GroundPoint]) -> bool {
    control.is_empty() || problem.offset.is_some()
}

/// Frames whose position is known, and what is known of it.
pub(super) fn known(problem: &Problem) -> impl Iterator<Item = (&BundleFrame, (Vector3<f64>, Vector3<f64>))> {
    problem.frames.iter().filter(|f| !f.is_held()).filter_map(|f| Some((f, f.position?)))
}

/// The middle of what positions are off, axis by axis, from centres that are `scale` times as large.
pub(super) fn middle_shift(problem: &Problem, scale: f64) -> Option<Vector3<f64>> {
    let shifts: Vec<Vector3<f64>> = known(problem).map(|f| f.1.0 - f.0.pose.centre * scale).collect();
    let middle = |axis: usize| upper_median(&mut shifts.iter().map(|s| s[axis]).collect::<Vec<f64>>());
    Some(Vector3::new(middle(0)?, middle(1)?, middle(2)?))
}

/// Positions that cannot be those of the block's frames, by its shape as it is: from where the scale and the shift that
/// most agree with have them, they lie more than eight times as far as half of the others. Such a position would bend
/// the block, its focal length first, until no test sees it. They are set aside, and the block goes to where the others
/// have it, unless GCPs place it; three in ten at most, and of fewer than [`LEAST`] none.
pub(super) fn set_aside(problem: &mut Problem) -> Vec<Aside> {
    /// Times what half of all miss, or their deviation.
    const GROSS: f64 = 8.0;
    const MOST_GROSS: f64 = 0.3;
    let known = |(i, f): (usize, &BundleFrame)| f.position.map(|(at, sigma)| (i, f.pose.centre, at, sigma));
    let all: Vec<_> = problem.frames.iter().enumerate().filter_map(known).collect();
    if all.len() < LEAST {
        return Vec::new();
    }
    // Of neighbours in the table and of those farther apart, so that large blocks have no more pairs than they need.
    let steps = [1, 2, 3, 5, 8, 13].into_iter().filter(|step| *step < all.len());
    let pairs = steps.flat_map(|step| all.iter().zip(&all[step..]));
    let mut scales: Vec<f64> = pairs.map(|(a, b)| (a.2 - b.2).norm() / (a.1 - b.1).norm()).collect();
    scales.retain(|s| s.is_finite());
    let places = problem.offset.is_none();
    let Some(scale) = (if places { upper_median(&mut scales) } else { Some(1.0) }) else { return Vec::new() };
    let Some(shift) = middle_shift(problem, scale) else { return Vec::new() };
    let miss = |from: &Vector3<f64>, to: &Vector3<f64>| (to - from * scale - shift).norm();
    let mut misses: Vec<f64> = all.iter().map(|(_, from, to, _)| miss(from, to)).collect();
    let usual = upper_median(&mut misses).expect("there are LEAST positions or more");
    let gross = all.iter().filter(|(_, from, to, sigma)| miss(from, to) > GROSS * usual.max(sigma.norm()));
    let aside: Vec<Aside> = gross.map(|(i, _, at, sigma)| Aside { frame: *i, at: *at, sigma: *sigma }).collect();
    if aside.is_empty() || aside.len() as f64 > MOST_GROSS * all.len() as f64 {
        return Vec::new();
    }
    if places {
        for frame in &mut problem.frames {
            frame.pose.centre = frame.pose.centre * scale + shift;
        }
        for point in problem.points.iter_mut().filter(|p| p.survey.is_none()) {
            point.xyz = point.xyz * scale + shift;
        }
    }
    aside.iter().for_each(|one| problem.frames[one.frame].position = None);
    aside
}

/// Adjusts, takes the position out that the others contradict most, and adjusts again, until none is left; notes name
/// them. Where more than a fifth or more than [`MOST_ROUNDS`] seem to be wrong, and where fewer than [`LEAST`] are
/// there, all stay. What was set `aside` before comes back where it agrees.
///
/// # Errors
/// Those of [`solve`].
pub(super) fn snoop(problem: &mut Problem, world: &Reconstruction, aside: Vec<Aside>) -> Result<Vec<String>> {
    let solving = Options { loss: LOSS, ..Options::default() };
    let all = known(problem).count();
    if all < LEAST && aside.is_empty() {
        return Ok(Vec::new());
    }
    let mut gross = Vec::new();
    if !aside.is_empty() {
        solve(problem, &solving)?;
        let factored = factor(problem, LOSS);
        for Aside { frame, at, sigma } in aside {
            let off = at - problem.offset.unwrap_or_default() - problem.frames[frame].pose.centre;
            let variance = factored.as_ref().map_or_else(Vector3::zeros, |f| f.position(frame).diagonal());
            let test = off.component_div(&(variance + sigma.component_mul(&sigma)).map(f64::sqrt)).norm();
            if test > FAR {
                gross.push(Wrong { frame, at, sigma, test });
            } else {
                problem.frames[frame].position = Some((at, sigma));
            }
        }
    }
    let most = ((MOST * all as f64) as usize).min(MOST_ROUNDS);
    let mut out: Vec<Wrong> = Vec::new();
    loop {
        solve(problem, &solving)?;
        let Some(wrong) = worst(problem) else { break };
        problem.frames[wrong.frame].position = None;
        out.push(wrong);
        // What is left must still fix the datum.
        if out.len() > most || factor(problem, LOSS).is_none() {
            for wrong in out.drain(..) {
                problem.frames[wrong.frame].position = Some((wrong.at, wrong.sigma));
            }
            solve(problem, &solving)?;
            break;
        }
    }
    out.splice(..0, gross);
    let said = out.iter().map(|wrong| {
        let by = wrong.at - problem.offset.unwrap_or_default() - problem.frames[wrong.frame].pose.centre;
        format!(
            "{}: its position in the table is {:.1} m off ({:.0} standard deviations by what the others say): left out",
            world.photographs[wrong.frame].name,
            by.norm(),
            wrong.test
        )
    });
    Ok(said.collect())
}

/// The position that is farthest from where the others have it, where that is no chance.
fn worst(problem: &Problem) -> Option<Wrong> {
    let mut suspects: Vec<(f64, usize)> = (0..problem.frames.len())
        .filter_map(|i| Some((problem.position_off(i)?.norm(), i)))
        .filter(|(off, _)| *off > FAR / 2.0)
        .collect();
    suspects.sort_by(|a, b| b.0.total_cmp(&a.0));
    suspects.truncate(MOST_TESTED);
    if suspects.is_empty() {
        return None;
    }
    let factored = factor(problem, LOSS)?;
    let test = |frame: usize| {
        let (at, sigma) = problem.frames[frame].position?;
        let (_, test) = snooped(problem.position_misses(frame)?, sigma, factored.position(frame))?;
        Some(Wrong { frame, at, sigma, test })
    };
    let tested = suspects.into_iter().filter_map(|(_, frame)| test(frame)).filter(|wrong| wrong.test > FAR);
    tested.max_by(|a, b| a.test.total_cmp(&b.test))
}
