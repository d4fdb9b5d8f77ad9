//! Whether what places a block shows it as in a mirror. Three points or positions fit a mirror image as well as the
//! block itself, and so do more of them that lie on a plane, where a similarity turns the block over: cameras that
//! looked down look up, from below the ground.

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix3, Vector3};

use super::options::RoughPose;
use crate::intersect::datum;
use crate::pose::Similarity;
use crate::read::Reconstruction;

/// A block that what places it fits no better than it would with east and north exchanged, which is true where its
/// cameras look up as they are and would look down then, or where it fits far better.
#[derive(Clone, Copy, Debug)]
pub struct UpsideDown {
    /// GCPs place it, not its cameras' positions.
    pub by_gcps: bool,
    /// Median elevation of what the frames show, degrees above the horizon.
    pub looks_deg: f64,
    /// Frames whose stated direction looks below the horizon, and frames whose direction is stated.
    pub stated_down: [usize; 2],
    /// RMS of what the points or positions miss by, metres: as they are stated, and exchanged.
    pub misses_m: [f64; 2],
    /// Exchanged they fit far better: only the mirror image is true.
    pub fits_exchanged: bool,
}

/// Elevations that are neither up nor down, degrees: in a street frames see houses above them.
const LEVEL_DEG: f64 = 15.0;

impl UpsideDown {
    /// Whether the frames look up.
    pub fn looks_up(&self) -> bool {
        self.looks_deg > LEVEL_DEG
    }

    /// Whether nothing but a mirror image is likely: exchanged they fit far better, the frames look up steeply, which
    /// those that are taken from the ground seldom do, or most directions that were stated look down.
    pub fn is_plain(&self) -> bool {
        const STEEP_DEG: f64 = 45.0;
        let [down, stated] = self.stated_down;
        self.fits_exchanged || self.looks_deg > STEEP_DEG || 2 * down > stated
    }
}

/// What places a block: where the model has its GCPs, or its cameras, and where these are known to lie.
pub(super) struct Placing {
    pub by_gcps: bool,
    pub from: Vec<Vector3<f64>>,
    pub to: Vec<Vector3<f64>>,
    /// What half of them are known to at least, metres (1σ).
    pub sigma_m: f64,
}

/// `placed`: what brings the model to the ground.
pub(super) fn upside_down(
    model: &Reconstruction,
    rough: &[Option<RoughPose>],
    placed: &Similarity,
    by: &Placing,
) -> Option<UpsideDown> {
    /// A fit that is worse by more is another, and one that is better by more is the true one, of so many and more.
    const WORSE: f64 = 1.5;
    const BETTER: f64 = 0.25;
    const FEWEST: usize = 5;
    /// Of more, those that miss by no more standard deviations are not fitted anew.
    const MANY: usize = 30;
    const MISFIT: f64 = 2.0;
    /// Share of the block's extent below which a miss is none.
    const NOTHING: f64 = 1e-4;
    let Placing { by_gcps, from, to, sigma_m } = by;
    let views = views(model);
    let looks_deg = elevation_deg(&views, &placed.rotation)?;
    // The middle one, which single wrong ones do not move, and the mean square, in which positions in a row show it.
    let miss = |by: &Similarity, to: &[Vector3<f64>]| {
        let mut misses: Vec<f64> = from.iter().zip(to).map(|(from, to)| (by.apply(from) - to).norm()).collect();
        let squares: f64 = misses.iter().map(|miss| miss * miss).sum();
        Some([upper_median(&mut misses)?, (squares / misses.len() as f64).sqrt()])
    };
    let up = looks_deg > LEVEL_DEG;
    // What is wrong with GCPs that fit badly is told elsewhere.
    if !up && (*by_gcps || (from.len() > MANY && miss(placed, to)?[1] < MISFIT * sigma_m)) {
        return None;
    }
    let elevations = rough.iter().flatten().filter(|rough| rough.sigma_rad.is_finite());
    let elevations: Vec<f64> =
        elevations.map(|rough| rough.pose.rotation[(2, 2)].clamp(-1.0, 1.0).asin().to_degrees()).collect();
    let stated = |test: fn(f64) -> bool| elevations.iter().filter(|deg| test(**deg)).count();
    // Frames that are said to look up may do so.
    if up && 2 * stated(|deg| deg > LEVEL_DEG) > elevations.len() {
        return None;
    }
    let exchanged: Vec<Vector3<f64>> = to.iter().map(|at| Vector3::new(at.y, at.x, at.z)).collect();
    // Directions may have placed the block: both are to be as free.
    let [own, other] = [datum(from, to)?, datum(from, &exchanged)?];
    let [stated_m, stated_rms_m] = miss(&own, to)?;
    let [exchanged_m, exchanged_rms_m] = miss(&other, &exchanged)?;
    let extent_m = to.iter().map(|at| (at - to[0]).norm()).fold(0.0, f64::max);
    let nothing_m = NOTHING * extent_m;
    let better = |other_m: f64, stated_m: f64| stated_m > nothing_m && other_m < BETTER * stated_m;
    let fits_exchanged =
        from.len() >= FEWEST && (better(exchanged_m, stated_m) || better(exchanged_rms_m, stated_rms_m));
    let turns_over = up && elevation_deg(&views, &other.rotation)? < -LEVEL_DEG;
    let fits_no_worse = exchanged_m <= WORSE * stated_m.max(nothing_m);
    if !(fits_exchanged || turns_over && fits_no_worse) {
        return None;
    }
    Some(UpsideDown {
        by_gcps: *by_gcps,
        looks_deg,
        stated_down: [stated(|deg| deg < -LEVEL_DEG), elevations.len()],
        misses_m: [stated_rms_m, exchanged_rms_m],
        fits_exchanged,
    })
}

/// Where each frame looks, in the model: the mean direction to its ties, or along its axis where it has none.
fn views(model: &Reconstruction) -> Vec<Vector3<f64>> {
    let mut to_ties = vec![Vector3::zeros(); model.photographs.len()];
    for tie in &model.ties {
        for (frame, _) in &tie.seen {
            let away = tie.xyz - model.photographs[*frame].pose.centre;
            to_ties[*frame] += away.try_normalize(0.0).unwrap_or_default();
        }
    }
    let axes = model.photographs.iter().map(|p| p.pose.rotation.row(2).transpose());
    to_ties.iter().zip(axes).map(|(mean, axis)| mean.try_normalize(1e-9).unwrap_or(axis)).collect()
}

/// The median elevation of views that are turned to the ground.
fn elevation_deg(views: &[Vector3<f64>], rotation: &Matrix3<f64>) -> Option<f64> {
    let mut elevations: Vec<f64> = views.iter().map(|view| (rotation * view).z.clamp(-1.0, 1.0).asin()).collect();
    upper_median(&mut elevations).map(f64::to_degrees)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adjust::{GroundPoint, on_ground};
    use crate::pose::{Pose, YawPitchRoll};
    use crate::read::{Photograph, TiePoint};
    use autoref_raster::random::SplitMix64;

    /// Frames in two rows of a flight, `pitch_deg` against the horizon, 500 m away from what they see; heights of the
    /// cameras scatter by `relief_m`. The model has its own scale and direction.
    fn flight(pitch_deg: f64, relief_m: f64) -> (Reconstruction, Vec<Vector3<f64>>) {
        let mut random = SplitMix64(3);
        let turned = Pose::looking(Vector3::zeros(), YawPitchRoll { yaw_deg: 70.0, pitch_deg: 12.0, roll_deg: 5.0 });
        let mut model = Reconstruction::default();
        let mut places = Vec::new();
        for i in 0..10 {
            let (column, row) = (f64::from(i % 5), f64::from(i / 5));
            let at = Vector3::new(220.0 * column, 260.0 * row, 600.0 + relief_m * (random.unit() - 0.5));
            let pose = Pose::looking(at, YawPitchRoll { yaw_deg: 90.0 + 2.0 * column, pitch_deg, roll_deg: 0.0 });
            let sees = at + 500.0 * pose.rotation.row(2).transpose();
            let to_model = |x: &Vector3<f64>| turned.rotation * x * 0.01;
            let pose = Pose { rotation: pose.rotation * turned.rotation.transpose(), centre: to_model(&at) };
            model.photographs.push(Photograph { name: format!("F{i}"), camera: 0, pose });
            model.ties.push(TiePoint { xyz: to_model(&sees), seen: vec![(i as usize, [0.0; 2])] });
            places.push(at);
        }
        (model, places)
    }

    fn told(model: &Reconstruction, places: &[Vector3<f64>], pitch_deg: Option<f64>) -> Option<UpsideDown> {
        let mut random = SplitMix64(7);
        let rough = |at: &Vector3<f64>| {
            let angles = YawPitchRoll { yaw_deg: 90.0, pitch_deg: pitch_deg.unwrap_or(0.0), roll_deg: 0.0 };
            let off = Vector3::from_fn(|_, _| 4.0 * (random.unit() - 0.5));
            let sigma_rad = if pitch_deg.is_some() { 0.03 } else { f64::INFINITY };
            Some(RoughPose { pose: Pose::looking(at + off, angles), sigma_m: Vector3::repeat(3.0), sigma_rad })
        };
        let rough: Vec<Option<RoughPose>> = places.iter().map(rough).collect();
        on_ground(model, &[] as &[GroundPoint], &rough).expect("ten positions").upside_down
    }

    fn exchanged(places: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        places.iter().map(|at| Vector3::new(at.y, at.x, at.z)).collect()
    }

    #[test]
    fn exchanged_positions_hang_a_block_upside_down() {
        for (pitch_deg, relief_m) in [(-90.0, 0.0), (-80.0, 20.0), (-50.0, 8.0), (-30.0, 80.0), (-30.0, 0.0)] {
            let (model, places) = flight(pitch_deg, relief_m);
            assert!(told(&model, &places, None).is_none(), "{pitch_deg}: right positions");
            let found = told(&model, &exchanged(&places), None).expect("exchanged positions");
            assert!(!found.by_gcps && (found.looks_deg + pitch_deg).abs() < 12.0, "{found:?}");
            assert_eq!(found.is_plain(), pitch_deg < -45.0 || relief_m > 0.0, "{found:?}");
            assert!(told(&model, &exchanged(&places), Some(pitch_deg)).is_some_and(|found| found.is_plain()));
        }
    }

    #[test]
    fn frames_that_do_look_up_are_told_by_where_they_stood() {
        let (model, places) = flight(30.0, 30.0);
        assert!(told(&model, &places, None).is_none(), "their heights fit one hand alone");
        let (model, places) = flight(30.0, 0.0);
        assert!(told(&model, &places, None).is_some_and(|found| !found.is_plain()), "on a level nothing tells");
        let (model, places) = flight(0.0, 0.0);
        assert!(told(&model, &exchanged(&places), None).is_none(), "level views");
    }
}
