//! Frames whose pose in the reconstruction is wrong from the start: rays of their GCPs go elsewhere, or backwards. One
//! of them would keep every GCP that it shows from telling where the block stands.

use nalgebra::Vector3;

use super::survey::{GroundPoint, Role};
use crate::intersect::intersect_seen;
use crate::read::{Reconstruction, TiePoint};

/// A ray agrees with the others of its point within this share of the image's diagonal: a block that is only bent does.
const NEAR: f64 = 0.1;
/// GCPs that contradict a frame at least, and rays of one that agree.
const FEWEST: usize = 3;
/// Pairs of rays that are tried for one point.
const MOST_PAIRS: usize = 300;

/// A frame that the others contradict.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Astray {
    pub frame: usize,
    against: usize,
    shown: usize,
}

/// Frames that more than half of their GCPs, and three at least, contradict: most rays of such a point meet elsewhere.
/// Not those whose ties fit: there the GCPs are wrong. None where that is half of the frames and more: nothing says
/// then which are wrong.
pub(super) fn frames(model: &Reconstruction, points: &[GroundPoint]) -> Vec<Astray> {
    let mut counts = vec![(0, 0); model.photographs.len()];
    for p in points.iter().filter(|p| p.role == Role::Control && p.seen.len() >= FEWEST) {
        let Some(agrees) = agreeing(model, &p.seen) else { continue };
        for ((frame, _), agrees) in p.seen.iter().zip(agrees) {
            counts[*frame].0 += usize::from(!agrees);
            counts[*frame].1 += 1;
        }
    }
    let tested = counts.iter().filter(|(_, shown)| *shown > 0).count();
    let wrong = |(frame, (against, shown)): (usize, &(usize, usize))| {
        let (against, shown) = (*against, *shown);
        (against >= FEWEST && 2 * against > shown).then_some(Astray { frame, against, shown })
    };
    let mut astray: Vec<Astray> = counts.iter().enumerate().filter_map(wrong).collect();
    astray.retain(|a| !ties_fit(model, a.frame));
    if 2 * astray.len() >= tested { Vec::new() } else { astray }
}

/// Whether a frame sees a point, and about where it was measured.
fn is_near(model: &Reconstruction, x: &Vector3<f64>, (frame, pixel): &(usize, [f64; 2])) -> bool {
    let photograph = &model.photographs[*frame];
    let camera = &model.cameras[photograph.camera];
    let most_px = NEAR * camera.size_px[0].hypot(camera.size_px[1]);
    camera.residual(photograph.pose.to_camera(x).into(), *pixel).is_some_and(|[x, y]| x.hypot(y) <= most_px)
}

/// Whether most of a frame's ties, and three at least, are where it has them.
fn ties_fit(model: &Reconstruction, frame: usize) -> bool {
    let own = |tie: &TiePoint| tie.seen.iter().find(|(i, _)| *i == frame).map(|at| is_near(model, &tie.xyz, at));
    let (fit, all) =
        model.ties.iter().filter_map(own).fold((0, 0), |(fit, all), near| (fit + usize::from(near), all + 1));
    all >= FEWEST && 2 * fit > all
}

/// Which rays of a point meet where most of them do; `None` where no majority of three and more meets.
fn agreeing(model: &Reconstruction, seen: &[(usize, [f64; 2])]) -> Option<Vec<bool>> {
    let all_near = |x: &Vector3<f64>| seen.iter().map(|s| is_near(model, x, s)).collect::<Vec<bool>>();
    let count = |agrees: &[bool]| agrees.iter().filter(|a| **a).count();
    let mut best = intersect_seen(model, seen).map(|x| all_near(&x)).unwrap_or_default();
    // By how far apart they stand in the list, so that no frame is in all pairs that are tried.
    let pairs = (1..seen.len()).flat_map(|gap| (0..seen.len() - gap).map(move |i| (i, i + gap)));
    for (i, j) in pairs.take(MOST_PAIRS) {
        if count(&best) == seen.len() {
            break;
        }
        let Some(x) = intersect_seen(model, &[seen[i], seen[j]]) else { continue };
        let agrees = all_near(&x);
        if count(&agrees) > count(&best) {
            best = agrees;
        }
    }
    (count(&best) >= FEWEST && 2 * count(&best) > seen.len()).then_some(best)
}

/// The block without what was measured in such frames. They stay in the list, so that numbers of frames stay.
pub(super) fn without(
    astray: &[Astray],
    model: &Reconstruction,
    points: &[GroundPoint],
) -> (Reconstruction, Vec<GroundPoint>) {
    let stays = |(frame, _): &(usize, [f64; 2])| astray.iter().all(|a| a.frame != *frame);
    let (mut model, mut points) = (model.clone(), points.to_vec());
    points.iter_mut().for_each(|p| p.seen.retain(stays));
    model.ties.iter_mut().for_each(|tie| tie.seen.retain(stays));
    model.notes.extend(astray.iter().map(|a| {
        format!(
            "{}: set aside, its pose in the reconstruction is wrong: of {} GCPs measured in it {} lie behind it or far \
             from where the other frames have them; orient it again, or place it with `flight resect`",
            model.photographs[a.frame].name, a.shown, a.against
        )
    }));
    (model, points)
}
