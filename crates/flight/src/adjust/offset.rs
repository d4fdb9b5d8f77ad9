//! Positions that count in another datum than the GCPs: a receiver's heights above the ellipsoid beside heights above
//! the geoid. Taken as they stand they bend the block, its focal length first, and right GCPs look wrong.

use nalgebra::{Matrix3, Vector3};

use super::positions;
use super::standing::Standing;
use super::survey::GroundPoint;
use crate::bundle::{BundleCamera, Problem, Treatment};
use crate::camera::Parameter;

/// χ² of three numbers that one offset in a thousand exceeds by chance.
const CHI2: f64 = 16.27;
/// Standard deviations of a single position that one offset of all does not explain.
const FAR: f64 = 5.0;

/// Whether GCPs place the block without its positions, so that these may be tested.
pub(super) fn is_testable(problem: &Problem, control: &[&GroundPoint]) -> bool {
    /// One position alone is that of its frame, and three GCPs place a block.
    const LEAST: (usize, usize) = (2, 3);
    let positions = problem.frames.iter().filter(|f| f.position.is_some()).count();
    let placing = control.iter().filter(|p| p.seen.len() >= 2).count();
    positions >= LEAST.0 && placing >= LEAST.1
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
/// what the positions scatter counted in, with no position far from where it then belongs, and with no more GCPs called
/// wrong than `without`.
pub(super) fn is_borne_out(with: &Standing, without: Option<&Standing>) -> bool {
    let Some(offset) = with.problem.offset else { return false };
    let Some(covariance) = with.deviations.as_ref().and_then(|d| d.offset()) else { return false };
    let off: Vec<Vector3<f64>> =
        (0..with.problem.frames.len()).filter_map(|frame| with.problem.position_off(frame)).collect();
    // A single position that is wrong shifts the mean of all, but scatters more.
    let variance = off.iter().map(|off| off.norm_squared()).sum::<f64>() / (3 * off.len()).max(1) as f64;
    let variance = variance.max(1.0);
    let farthest = off.iter().map(|off| off.amax()).fold(0.0, f64::max);
    chi2(&offset, &covariance) > CHI2 * variance
        && farthest <= FAR * variance.sqrt()
        && without.is_none_or(|without| with.blunders.len() <= without.blunders.len())
}

fn chi2(offset: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    covariance.try_inverse().map_or(0.0, |inverse| offset.dot(&(inverse * offset)))
}

/// By how much the positions are off together, and what may be the reason.
pub(super) fn note(standing: &Standing) -> Option<String> {
    /// Standard deviations below which a part is not worth saying.
    const SAID: f64 = 3.0;
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
    Some(format!(
        "the positions lie {lie} where the GCPs put the cameras: another datum of one of both (heights above the ellipsoid \
         beside heights above the geoid), or a receiver's offset{lens}; the block stands by the GCPs, and positions count \
         but for what all are off together; bring both to one datum"
    ))
}
