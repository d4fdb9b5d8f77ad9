//! Positions of cameras that place a block alone, tested as GCPs are elsewhere.

use nalgebra::{Matrix3, Vector3};

use super::snooping::{LOSS, snooped};
use crate::bundle::{Options, Problem, factor, solve};
use crate::error::Result;
use crate::read::Reconstruction;

/// Standard deviations that a position is not off by chance; receivers drift, so more than for GCPs.
const FAR: f64 = 5.0;
/// Share of the positions that may be wrong, and one at least; where more seem to be, the block is in doubt.
const MOST: f64 = 0.2;
/// Fewer positions than this do not tell which of them is wrong.
const LEAST: usize = 5;
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

/// Adjusts, takes the position out that the others contradict most, and adjusts again, until none is left; notes name
/// them. Where more than a fifth or more than [`MOST_ROUNDS`] seem to be wrong, and where fewer than [`LEAST`] are
/// there, all stay.
///
/// # Errors
/// Those of [`solve`].
pub(super) fn snoop(problem: &mut Problem, world: &Reconstruction) -> Result<Vec<String>> {
    let solving = Options { loss: LOSS, ..Options::default() };
    let all = problem.frames.iter().filter(|f| f.position.is_some()).count();
    if all < LEAST {
        return Ok(Vec::new());
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
    let said = out.iter().map(|wrong| {
        let by = wrong.at - problem.frames[wrong.frame].pose.centre;
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
    let off =
        |(at, sigma): &(Vector3<f64>, Vector3<f64>), centre: &Vector3<f64>| (at - centre).component_div(sigma).norm();
    let mut suspects: Vec<(f64, usize)> = (0..problem.frames.len())
        .filter_map(|i| Some((off(problem.frames[i].position.as_ref()?, &problem.frames[i].pose.centre), i)))
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
        let adjusted: Matrix3<f64> = factored.frame(frame).fixed_view::<3, 3>(3, 3).into_owned();
        let (_, test) = snooped(at - problem.frames[frame].pose.centre, sigma, adjusted)?;
        Some(Wrong { frame, at, sigma, test })
    };
    let tested = suspects.into_iter().filter_map(|(_, frame)| test(frame)).filter(|wrong| wrong.test > FAR);
    tested.max_by(|a, b| a.test.total_cmp(&b.test))
}
