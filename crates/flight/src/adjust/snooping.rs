//! Gross errors of GCPs: Baarda's data snooping, and what makes the block itself doubtful.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2, Vector3};

use super::adjusted::{AdjustedPoint, Blunder};
use super::astray::Astray;
use super::options::AdjustOptions;
use super::screening::{GROSS, Screened};
use super::survey::{GroundPoint, Role};
use crate::bundle::{
    BundleFrame, Deviations, Ended, FROM_NEAR, Factored, HELD_M, Loss, Moved, Observation, Options, Problem, Summary,
    Treatment, factor, solve,
};
use crate::camera::Parameter;
use crate::error::{Error, Result};
use crate::read::Reconstruction;
use autoref_raster::words::some_of;

/// What the last adjustment makes of ties that do not fit.
pub(super) const LOSS: Loss = Loss::Huber(3.0);

/// The end of the adjustment, without what was wrong.
pub(super) struct Snooped {
    pub blunders: Vec<Blunder>,
    pub summary: Summary,
    /// `None` where something is not determined.
    pub factored: Option<Factored>,
}

/// Adjusts, takes the worst observation of a GCP out where it is a blunder, and adjusts again, until none is left. A
/// GCP that runs away is brought back, and what drove it off is set aside.
///
/// # Errors
/// When the adjustment fails, or most measurements are called wrong.
pub(super) fn snoop(
    problem: &mut Problem,
    ties: usize,
    control: &[&GroundPoint],
    options: &AdjustOptions,
    screened: &mut Screened,
) -> Result<Snooped> {
    // The block comes from a minimum, of other weights or with a measurement more.
    let solving = Options { loss: LOSS, damping: FROM_NEAR, ..Options::default() };
    let mut blunders = Vec::new();
    loop {
        refuse_most(control, &blunders, screened, ties)?;
        hold(problem, ties, control);
        hold_frames(problem);
        let before = problem.clone();
        let summary = solve(problem, &solving)?;
        // Out there the tests' straight lines hold no more: what is wrong shows where the block stood before.
        if let Some(index) = driver(&before, problem, ties) {
            *problem = before;
            screened.set_aside(problem, index);
            continue;
        }
        let factored = factor(problem, solving.loss);
        let surveyed = problem.points[ties..].iter().filter(|p| p.survey.is_some()).count();
        let tested = factored.as_ref().filter(|_| surveyed > 3 && blunders.len() < control.len());
        let Some((blunder, what)) = tested.and_then(|f| worst(problem, f, ties, control, options)) else {
            return Ok(Snooped { blunders, summary, factored });
        };
        blunders.push(blunder);
        match what {
            Worst::Survey(point) => problem.points[point].survey = None,
            Worst::Image(index) => {
                problem.observations.remove(index);
            }
        }
    }
}

/// Of more than half of the measurements nothing says that it is they that are wrong, and no search goes on.
///
/// # Errors
/// When so many are called wrong.
fn refuse_most(control: &[&GroundPoint], blunders: &[Blunder], screened: &Screened, ties: usize) -> Result<()> {
    /// Fewer measurements say nothing of most of them.
    const FEWEST: usize = 10;
    let measured: usize = control.iter().map(|p| p.seen.len()).sum();
    let of_survey = |name: &str| control.iter().filter(|p| p.name == name).map(|p| p.seen.len()).sum::<usize>();
    let named = blunders.iter().map(|b| if b.photograph.is_some() { 1 } else { of_survey(&b.gcp) });
    let wrong = named.sum::<usize>() + screened.measurements(ties, control);
    if measured < FEWEST || 2 * wrong <= measured {
        return Ok(());
    }
    Err(Error::no_result(
        format!("{wrong} of {measured} measurements of GCPs contradict the block, and nothing says which are right"),
        "check the coordinates, their CRS and order, what is stated of them, and the names of points and frames",
    ))
}

/// What drove a GCP off: of all that moved farther than they were from a camera that shows them, or to its other side,
/// the image point that fitted worst before. `None` where none moved so, or none fitted badly.
fn driver(before: &Problem, after: &Problem, ties: usize) -> Option<usize> {
    let ran_off = |o: &Observation| {
        let (from, to) = (before.points[o.point].xyz, after.points[o.point].xyz);
        let away = (from - before.frames[o.frame].pose.centre).norm();
        let in_front = |p: &Problem| {
            let frame = &p.frames[o.frame];
            p.cameras[frame.camera].camera.faces(frame.pose.to_camera(&p.points[o.point].xyz).into(), o.pixel)
        };
        // Frames move too, and take their points along.
        let shift = after.frames[o.frame].pose.centre - before.frames[o.frame].pose.centre;
        (to - from - shift).norm() > away || (in_front(before) && !in_front(after))
    };
    let gcps = || before.observations.iter().enumerate().filter(|(_, o)| o.point >= ties);
    let mut gone: Vec<usize> = gcps().filter(|(_, o)| ran_off(o)).map(|(_, o)| o.point).collect();
    gone.dedup();
    let misfit = |o: &Observation| before.residual(o).map_or(f64::INFINITY, |r| r[0].hypot(r[1]) / o.sigma_px);
    let bad = gcps().filter(|(_, o)| gone.contains(&o.point)).map(|(index, o)| (index, misfit(o)));
    bad.filter(|b| b.1 > GROSS).max_by(|a, b| a.1.total_cmp(&b.1)).map(|b| b.0)
}

/// A GCP that nothing holds any more leaves the unknowns determined by a wide survey.
pub(super) fn hold(problem: &mut Problem, ties: usize, control: &[&GroundPoint]) {
    for i in ties..problem.points.len() {
        let seen = problem.observations.iter().filter(|o| o.point == i).count();
        if problem.points[i].survey.is_none() && seen < 2 {
            let at = control[i - ties].xyz;
            problem.points[i].survey = Some((at, Vector3::repeat(1e6)));
        }
    }
}

/// What holds a frame that too little was measured in, beside [`HELD_M`], radians.
const HELD_RAD: f64 = 10.0;

/// A frame of which its image points and priors leave something open leaves the unknowns determined by wide priors,
/// and loses them when its image points come back.
pub(super) fn hold_frames(problem: &mut Problem) {
    let mut known = vec![0; problem.frames.len()];
    problem.observations.iter().for_each(|o| known[o.frame] += 2);
    for (frame, known) in problem.frames.iter_mut().zip(known) {
        frame.position = frame.position.filter(|(_, sigma)| sigma.x != HELD_M);
        frame.direction = frame.direction.filter(|(_, sigma)| *sigma < HELD_RAD);
        let stated = 3 * (usize::from(frame.position.is_some()) + usize::from(frame.direction.is_some()));
        if known + stated < 6 {
            let pose = frame.pose;
            frame.position.get_or_insert((pose.centre, Vector3::repeat(HELD_M)));
            frame.direction.get_or_insert((pose.rotation, HELD_RAD));
        }
    }
}

/// An interior that its frames' image points leave open once their poses have taken theirs is held, and named where
/// there are any: the free terms of one camera would leave all unknowns undetermined.
pub(super) fn hold_interiors(problem: &mut Problem) -> Option<String> {
    let mut measured = vec![0usize; problem.frames.len()];
    problem.observations.iter().for_each(|o| measured[o.frame] += 2);
    let mut held = Vec::new();
    for (i, camera) in problem.cameras.iter_mut().enumerate() {
        let own = || problem.frames.iter().zip(&measured).filter(|(frame, _)| frame.camera == i);
        let spare = |(frame, measured): (&BundleFrame, &usize)| {
            let stated = 3 * (usize::from(frame.position.is_some()) + usize::from(frame.direction.is_some()));
            (measured + stated).saturating_sub(6)
        };
        let free = camera.treatment.iter().filter(|t| **t == Treatment::Free).count();
        if own().map(spare).sum::<usize>() >= free {
            continue;
        }
        camera.treatment.iter_mut().filter(|t| **t == Treatment::Free).for_each(|t| *t = Treatment::Held);
        if own().any(|(_, measured)| *measured > 0) {
            held.push(camera.camera.name.clone());
        }
    }
    (!held.is_empty()).then(|| {
        format!(
            "the interior orientation of these cameras is held, as too few image points fix it: {}; measure more GCPs",
            some_of(&held)
        )
    })
}

/// Frames that nothing fixes: what is said of them is what the reconstruction says.
pub(super) fn unfixed(problem: &Problem, world: &Reconstruction, astray: &[Astray]) -> Option<String> {
    let held = problem.frames.iter().enumerate().filter(|(_, frame)| frame.is_held()).map(|(i, _)| i);
    let held = held.filter(|i| astray.iter().all(|a| a.frame != *i));
    let names: Vec<String> = held.map(|i| world.photographs[i].name.clone()).collect();
    (!names.is_empty()).then(|| {
        format!(
            "fewer than three image points fix these frames, which stay where the reconstruction has them and have no \
             standard deviations: {}; measure GCPs in them",
            some_of(&names)
        )
    })
}

/// A lens that is not as its model, where that is what the deviations of its interior come from, or where no interior
/// is adjusted.
pub(super) fn missing_terms(problem: &Problem, deviations: &Deviations) -> Option<String> {
    let missing = deviations.missing_terms()?;
    let terms = missing.terms.iter().map(|p| p.name()).collect::<Vec<_>>().join(", ");
    // Distortion and an unbounded principal point would take each other's place.
    let bound = missing.terms.iter().find(|p| matches!(p, Parameter::Cx | Parameter::Cy)).map(|p| {
        let width = problem.cameras.iter().map(|c| c.camera.size_px[0]).fold(0.0, f64::max);
        format!(", the principal point within its bounds, as {}={:.0}", p.name(), (0.01 * width).max(1.0))
    });
    let free = format!("let them free (--free, or free under [adjust]){}", bound.unwrap_or_default());
    let Some(Moved { camera, parameter, by }) = missing.moved else {
        return Some(format!(
            "the lens is not as its interior orientation, which is held: with {terms} free the ties would fit better \
             than chance explains, which the deviations count in; {free}"
        ));
    };
    let of = problem.cameras[camera].active().iter().map(|p| p.name()).collect::<Vec<_>>().join(", ");
    let by = match parameter {
        Parameter::F | Parameter::Cx | Parameter::Cy => format!("{by:+.2} px"),
        _ => format!("{by:+.2e}"),
    };
    Some(format!(
        "the lens has more terms than {of} say: with {terms} free the ties would fit better than chance explains, and {} \
         would change by {by}, which its deviation counts in; {free}",
        parameter.name(),
    ))
}

/// Why no standard deviations can be stated; `None` where they can.
pub(super) fn without_sigmas(summary: &Summary, factored: Option<&Factored>) -> Option<&'static str> {
    /// What is hardly determined creeps on: a cost that falls by less in a step is as good as at its end.
    const CREEPS: f64 = 1e-5;
    match (factored, summary.ended) {
        (None, _) => {
            Some("the normal equations are singular: something is not fixed by what was measured; no covariances")
        }
        // Covariances are those of a minimum.
        (_, Ended::OutOfIterations | Ended::Stuck) if summary.last_fall > CREEPS => {
            Some("the adjustment ended before it converged: its cameras may be far off; no covariances")
        }
        (Some(_), _) => None,
    }
}

/// What makes the block itself doubtful: many GCPs called wrong, cameras far from where they are known to have been. A
/// line that is folded between two frames fits its ties, and states small σ.
pub(super) fn contradictions(
    problem: &Problem,
    world: &Reconstruction,
    control: &[&GroundPoint],
    blunders: &[Blunder],
) -> Vec<String> {
    /// A share of the GCPs' measurements, and a number, that are hardly all wrong.
    const MANY: (f64, usize) = (0.1, 3);
    /// Standard deviations.
    const FAR: f64 = 5.0;
    let measured: usize = control.iter().map(|p| p.seen.len()).sum();
    let images = blunders.iter().filter(|b| b.photograph.is_some()).count();
    let counts = [(images, measured, "measurements of GCPs"), (blunders.len() - images, control.len(), "GCPs")];
    let mut notes = Vec::new();
    for (wrong, all, what) in counts {
        if wrong >= MANY.1 && wrong as f64 > MANY.0 * all as f64 {
            notes.push(format!(
                "{wrong} of {all} {what} contradict the block: it may be bent where they lie, and its cameras further off \
                 than their standard deviations say"
            ));
        }
    }
    for (index, photograph) in world.photographs.iter().enumerate() {
        let here = || control.iter().filter(|p| p.seen.iter().any(|(frame, _)| *frame == index));
        let called_wrong = |p: &&&GroundPoint| {
            blunders.iter().any(|b| b.gcp == p.name && b.photograph.is_none_or(|frame| frame == index))
        };
        let (all, wrong) = (here().count(), here().filter(called_wrong).count());
        if all > 0 && all == wrong {
            notes.push(format!(
                "{}: all {all} GCPs measured in it are called wrong: it may be the frame that is, and nothing else tests \
                 it",
                photograph.name
            ));
        }
    }
    for (index, photograph) in world.photographs.iter().enumerate() {
        let Some(off) = problem.position_off(index) else { continue };
        let off = off.amax();
        if off > FAR {
            notes.push(format!(
                "{}: {off:.0} standard deviations from its rough position: the table is wrong, or the block is",
                photograph.name
            ));
        }
    }
    notes
}

/// Check points whose rays do not meet: they, or the block where they lie, are wrong.
pub(super) fn rays_apart(points: &[AdjustedPoint], sigma_image_px: f64) -> Option<String> {
    /// Standard deviations of an image point.
    const APART: f64 = 10.0;
    let miss_px = |p: &AdjustedPoint| p.image.iter().map(|(_, r)| r[0].hypot(r[1])).fold(0.0, f64::max);
    let seen: Vec<(f64, &str)> = points
        .iter()
        .filter(|p| p.role == Role::Check && p.residual.is_some())
        .map(|p| (miss_px(p), p.name.as_str()))
        .collect();
    let apart = seen.iter().filter(|(px, _)| *px > APART * sigma_image_px);
    let (worst_px, name) = apart.clone().max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(format!(
        "{} of {} check points have rays that do not meet (worst {name}, {worst_px:.0} px): their measurements are wrong, \
         or the block is where they lie",
        apart.count(),
        seen.len()
    ))
}

enum Worst {
    Survey(usize),
    Image(usize),
}

/// The largest normalised residual among the GCPs' observations in images and on the ground (Baarda's data snooping,
/// with groups of two and three).
fn worst(
    problem: &Problem,
    factored: &Factored,
    ties: usize,
    control: &[&GroundPoint],
    options: &AdjustOptions,
) -> Option<(Blunder, Worst)> {
    let mut best: Option<(Blunder, Worst)> = None;
    let mut offer = |blunder: Blunder, what: Worst| {
        if blunder.test > options.critical && best.as_ref().is_none_or(|b| blunder.test > b.0.test) {
            best = Some((blunder, what));
        }
    };
    for (i, point) in problem.points.iter().enumerate().skip(ties) {
        let Some((at, sigma)) = point.survey.filter(|s| s.1.max() < 1e5) else { continue };
        let Some((by, test)) = snooped(at - point.xyz, sigma, factored.point(i)) else { continue };
        let name = control[i - ties].name.clone();
        offer(Blunder { gcp: name, photograph: None, by, test }, Worst::Survey(i));
    }
    for (i, o) in problem.observations.iter().enumerate().filter(|(_, o)| o.point >= ties) {
        let (Some(r), Some(predicted)) = (problem.residual(o), factored.predicted(problem, o)) else { continue };
        let sigma = Vector2::repeat(o.sigma_px);
        let Some((by, test)) = snooped(-Vector2::new(r[0], r[1]), sigma, predicted) else { continue };
        let name = control[o.point - ties].name.clone();
        offer(Blunder { gcp: name, photograph: Some(o.frame), by, test }, Worst::Image(i));
    }
    best
}

/// The error of an observation of so many numbers that explains its residual, and its size as a number of σ. `adjusted`
/// is the covariance of what the block makes of it. In directions that the block hardly checks nothing is said; `None`
/// where those are all.
pub(super) fn snooped<const N: usize>(
    residual: SVector<f64, N>,
    sigma: SVector<f64, N>,
    adjusted: SMatrix<f64, N, N>,
) -> Option<(Vec<f64>, f64)> {
    /// Share of an observation that the others check at least.
    const LEAST_REDUNDANCY: f64 = 1e-2;
    let unit = |i: usize, j: usize| f64::from(u8::from(i == j)) - adjusted[(i, j)] / (sigma[i] * sigma[j]);
    let eigen = DMatrix::from_fn(N, N, unit).symmetric_eigen();
    let whitened = DVector::from_fn(N, |i, _| residual[i] / sigma[i]);
    let (mut by, mut sum, mut checked) = (vec![0.0; N], 0.0, 0);
    for (redundancy, direction) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *redundancy >= LEAST_REDUNDANCY {
            let along = direction.dot(&whitened);
            by.iter_mut().enumerate().for_each(|(i, by)| *by += sigma[i] * direction[i] * along / redundancy);
            sum += along * along / redundancy;
            checked += 1;
        }
    }
    // Several numbers at once: as improbable as one normal number of this size.
    (checked > 0).then(|| (by, sum.cbrt_normal(checked)))
}

trait Normalise {
    fn cbrt_normal(self, freedom: u32) -> f64;
}

impl Normalise for f64 {
    /// A χ² value as a number of σ: Wilson and Hilferty's cube root (1931).
    fn cbrt_normal(self, freedom: u32) -> f64 {
        let k = f64::from(freedom);
        ((self / k).cbrt() - (1.0 - 2.0 / (9.0 * k))) / (2.0 / (9.0 * k)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn what_nothing_checks_is_not_guessed() {
        // East and north together are checked along one diagonal only.
        let (sigma, residual) = (Vector3::repeat(25.0), Vector3::new(80.0, 80.0, -10.0));
        let adjusted = 625.0 * Matrix3::new(0.5, -0.5, 0.0, -0.5, 0.5, 0.0, 0.0, 0.0, 0.1) * (1.0 - 1e-12);
        let full = 625.0 * Matrix3::from_diagonal(&Vector3::new(0.5, 0.5, 0.1));
        let (by, test) = snooped(residual, sigma, adjusted).expect("two directions are checked");
        assert!(by.iter().all(|v| v.abs() < 100.0) && test > 3.0, "{by:?} {test}");
        let (by, _) = snooped(residual, sigma, full).expect("all are checked");
        assert!((by[0] - 160.0).abs() < 1e-9 && (by[2] + 10.0 / 0.9).abs() < 1e-9, "{by:?}");
        assert!(snooped(residual, sigma, 625.0 * Matrix3::identity()).is_none());
    }
}
