//! Positions that count in another datum than the GCPs: a receiver's heights above the ellipsoid beside heights above
//! the geoid. Taken as they stand they bend the block, its focal length first, and right GCPs look wrong.

use std::collections::HashMap;

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix3, Vector3};

use super::positions;
use super::snooping::LOSS;
use super::standing::Standing;
use super::survey::GroundPoint;
use crate::bundle::{BundleCamera, BundleFrame, Problem, Treatment};
use crate::camera::Parameter;

/// χ² of three numbers that one offset in a thousand exceeds by chance.
const CHI2: f64 = 16.27;
/// Standard deviations of a single position that one offset of all does not explain.
const FAR: f64 = 5.0;

/// What GCPs and positions let an offset of all positions be told by.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Testable {
    No,
    /// They show that the two contradict each other, not which is wrong: three GCPs are tested by nothing else, and of
    /// few positions none is.
    Contradiction,
    Offset,
}

/// Whether GCPs place the block without its positions, so that these may be tested.
pub(super) fn testable(problem: &Problem, control: &[&GroundPoint]) -> Testable {
    /// One position alone is that of its frame, and three GCPs place a block.
    const LEAST: (usize, usize) = (2, 3);
    let positions = positions::known(problem).count();
    let placing = control.iter().filter(|p| p.seen.len() >= 2).count();
    if positions < LEAST.0 || placing < LEAST.1 {
        return Testable::No;
    }
    if positions < positions::LEAST || placing == LEAST.1 { Testable::Contradiction } else { Testable::Offset }
}

/// The same with what all positions are off together as one more unknown.
pub(super) fn freed(problem: Problem) -> Problem {
    Problem { offset: positions::middle_shift(&problem, 1.0), ..problem }
}

/// Whether nothing of a block whose positions count as they stand speaks for an offset: GCPs and positions agree, and
/// no GCP is called wrong, which may be one that positions contradict.
pub(super) fn is_doubtless(standing: &Standing) -> bool {
    let Some(deviations) = &standing.deviations else { return false };
    // Where nothing but the positions says where the cameras are, they cannot be off it.
    let off = deviations.offset_of_positions(&standing.problem);
    standing.blunders.is_empty() && off.is_none_or(|(offset, covariance)| chi2(&offset, &covariance) <= CHI2)
}

/// Whether the block is better with an offset of all positions: by more than chance, GCPs' and lens's own errors and
/// what the positions scatter counted in, with no position far from where it then belongs, and with a lower cost than
/// `without`, ties counted alike and a price for everything that is called wrong: a few wrong GCPs, left in, move right
/// positions as an offset of these would.
pub(super) fn is_borne_out(with: &Standing, without: Option<&Standing>) -> bool {
    let Some(offset) = with.problem.offset else { return false };
    let Some(covariance) = with.deviations.as_ref().and_then(|d| d.offset()) else { return false };
    if are_across(&with.problem) {
        return false;
    }
    let is_known = |frame: &usize| !with.problem.frames[*frame].is_held();
    let frames = (0..with.problem.frames.len()).filter(is_known);
    let off: Vec<Vector3<f64>> = frames.filter_map(|frame| with.problem.position_off(frame)).collect();
    // A single position that is wrong shifts the mean of all, but scatters more. The offset took three numbers.
    let freedom = (3 * off.len()).saturating_sub(3).max(1) as f64;
    let variance = (off.iter().map(|off| off.norm_squared()).sum::<f64>() / freedom).max(1.0);
    let farthest = off.iter().map(|off| off.amax()).fold(0.0, f64::max);
    chi2(&offset, &covariance) > CHI2 * variance
        && farthest <= FAR * variance.sqrt()
        && without.is_none_or(|without| {
            let known = |standing: &Standing| positions::known(&standing.problem).count();
            let left_out = known(without).saturating_sub(known(with));
            price(with, &with.problem, left_out) + CHI2 < price(without, &with.problem, 0)
        })
}

/// Whether positions have most cameras above the GCPs and the block has them below: a mirror image and no datum.
fn are_across(problem: &Problem) -> bool {
    let mut heights: Vec<f64> = problem.points.iter().filter_map(|p| Some(p.survey?.0.z)).collect();
    let Some(ground_m) = upper_median(&mut heights) else { return false };
    let known = positions::known(problem).count();
    let across = |(frame, (at, _)): &(&BundleFrame, (Vector3<f64>, Vector3<f64>))| {
        at.z > ground_m && frame.pose.centre.z < ground_m
    };
    2 * positions::known(problem).filter(across).count() > known
}

/// What a block costs with its ties as good as those of `as_good_as`, and with a price for each GCP that is called
/// wrong and each position that was left out.
fn price(standing: &Standing, as_good_as: &Problem, left_out: usize) -> f64 {
    let sigmas_px: HashMap<usize, f64> = as_good_as.observations.iter().map(|o| (o.point, o.sigma_px)).collect();
    let mut problem = standing.problem.clone();
    for o in &mut problem.observations {
        o.sigma_px = sigmas_px.get(&o.point).copied().unwrap_or(o.sigma_px);
    }
    problem.cost(LOSS) + CHI2 * (standing.blunders.len() + left_out) as f64
}

fn chi2(offset: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    covariance.try_inverse().map_or(0.0, |inverse| offset.dot(&(inverse * offset)))
}

/// By how much the positions are off together, and what may be the reason.
pub(super) fn note(standing: &Standing) -> Option<String> {
    let said = contradiction(standing)?;
    Some(format!(
        "{said}; the block stands by the GCPs, and positions count but for what all are off together; bring both to one \
         datum"
    ))
}

/// The same of a block that is too small to tell which is wrong.
pub(super) fn doubt(apart: &Standing) -> Option<String> {
    let said = contradiction(apart)?;
    Some(format!(
        "{said}; with three GCPs or fewer than {} positions nothing tells which of both is wrong, and the cameras, the \
         focal length and the deviations of this block take both for right: measure more GCPs, or leave the positions out",
        positions::LEAST
    ))
}

fn contradiction(standing: &Standing) -> Option<String> {
    /// Standard deviations below which a part is not worth saying.
    const SAID: f64 = 3.0;
    /// What datums differ by at most, in plan and in height (the geoid by 107 m from the ellipsoid), metres.
    const MOST_M: [f64; 2] = [1000.0, 150.0];
    let offset = standing.problem.offset?;
    let covariance = standing.deviations.as_ref().and_then(|d| d.offset())?;
    let [x, y, z] = [0, 1, 2].map(|i| covariance[(i, i)].max(0.0).sqrt());
    let upright = format!("{:.1} m (1σ {z:.1} m) {}", offset.z.abs(), if offset.z > 0.0 { "above" } else { "below" });
    let (plan, sigma) = (offset.xy().norm(), x.max(y));
    let level = format!("{plan:.1} m (1σ {sigma:.1} m) beside");
    let lie = match (offset.z.abs() > SAID * z, plan > SAID * sigma) {
        (true, false) => upright,
        (false, true) => level,
        _ => format!("{upright} and {level}"),
    };
    let is_held = |c: &BundleCamera| c.treatment[Parameter::F as usize] == Treatment::Held;
    let lens = match standing.problem.cameras.iter().any(is_held) {
        true => ", or the focal length, which is held, is wrong",
        false => "",
    };
    let cause = if offset.z.abs() > MOST_M[1] || plan > MOST_M[0] {
        "more than datums differ by: digits that one of both leaves out, positions of another flight"
    } else {
        "another datum of one of both (heights above the ellipsoid beside heights above the geoid), a receiver's offset"
    };
    Some(format!("the positions lie {lie} where the GCPs put the cameras: {cause}, or GCPs that are wrong{lens}"))
}
