//! A reconstruction of free datum brought to the ground: similarity by the GCPs, then bundle adjustment with the GCPs
//! as weighted observations, blunders named, check points compared.

mod adjusted;
mod astray;
mod datum;
mod misfit;
mod offset;
mod options;
mod outcome;
mod positions;
mod rays;
mod reason;
mod screening;
mod snooping;
mod standing;
mod survey;
mod upside_down;

use nalgebra::Vector3;

pub use self::adjusted::{AdjustedCamera, AdjustedPoint, Adjustment, Blunder};
use self::astray::Astray;
pub(crate) use self::datum::by_poses;
use self::datum::placing;
pub use self::datum::{OnGround, on_ground};
use self::offset::Testable;
pub use self::options::{AdjustOptions, RoughPose, TiesFrom};
use self::outcome::End;
use self::positions::Aside;
use self::screening::Screened;
use self::snooping::Snooped;
use self::standing::Standing;
pub use self::survey::{GroundPoint, Role};
pub use self::upside_down::UpsideDown;
use crate::bundle::{
    BundleCamera, BundleFrame, BundlePoint, Deviations, FROM_NEAR, Loss, Observation, Options, Problem, Treatment,
    Trust, solve,
};
use crate::error::{Error, Result};
use crate::intersect::intersect_seen;
use crate::read::Reconstruction;

/// What the worst of the GCPs hid shows in the next round.
const SCREENINGS: usize = 5;

/// Adjusts.
///
/// # Errors
/// When the datum is not fixed: fewer than three GCPs seen in two photographs each, or all on one line, and no rough
/// poses. When more than half of the measurements of GCPs contradict the block. When the block collapses: a focal
/// length that is not positive.
pub fn adjust(model: &Reconstruction, points: &[GroundPoint], options: &AdjustOptions) -> Result<Adjustment> {
    let astray = astray::frames(model, points);
    if astray.is_empty() {
        return adjust_all(model, points, options, &[]);
    }
    let (model, points) = astray::without(&astray, model, points);
    let mut found = adjust_all(&model, &points, options, &astray)?;
    found.photographs.retain(|p| astray.iter().all(|a| a.frame != p.photograph));
    Ok(found)
}

/// Of a block without what was measured in frames that are `astray`.
fn adjust_all(
    model: &Reconstruction,
    points: &[GroundPoint],
    options: &AdjustOptions,
    astray: &[Astray],
) -> Result<Adjustment> {
    let mut notes = model.notes.clone();
    let control: Vec<&GroundPoint> = points.iter().filter(|p| p.role == Role::Control && !p.seen.is_empty()).collect();
    let move_by = placing(model, &control, &options.rough)?;
    let mut world = model.clone();
    for p in &mut world.photographs {
        p.pose = p.pose.moved(&move_by);
    }
    for t in &mut world.ties {
        t.xyz = move_by.apply(&t.xyz);
    }
    let (mut problem, kept) = build(&world, &control, options);
    let ties = kept.len();
    let dropped_ties = world.ties.len() - ties;
    notes.extend(snooping::hold_interiors(&mut problem));

    let block = Block { model, world: &world, control: &control, ties, options };
    let standing = block.standing(problem)?;
    notes.extend(offset::note(&standing));
    let Standing { problem, deviations, blunders, summary, sigma_tie_px, notes: said } = standing;
    notes.extend(said);
    notes.extend(snooping::unfixed(&problem, &world, astray));
    let contradictions = snooping::contradictions(&problem, &world, &control, &blunders);
    if !contradictions.is_empty() {
        notes.extend(reason::guess(model, &control).map(|said| format!("the GCPs do not fit: {said}")));
    }
    notes.extend(contradictions);
    let of_lens = deviations.as_ref().filter(|_| options.ties == TiesFrom::Images);
    notes.extend(of_lens.and_then(|d| snooping::missing_terms(&problem, d)));
    let end = End { problem, deviations, kept, ties, dropped_ties, blunders, summary, sigma_tie_px, notes };
    let mut adjusted = outcome::outcome(&world, points, &control, end);
    adjusted.notes.extend(snooping::rays_apart(&adjusted.points, options.sigma_image_px));
    misfit::deviations_of_check_points(&mut adjusted.points, points, &adjusted.model, options.sigma_image_px);
    let bent = misfit::notes(&adjusted.points, points, &adjusted.model, options.sigma_image_px);
    adjusted.notes.extend(bent);
    Ok(adjusted)
}

/// A block on the ground, and what it is adjusted by.
struct Block<'a> {
    /// As it was read.
    model: &'a Reconstruction,
    /// As it was placed.
    world: &'a Reconstruction,
    control: &'a [&'a GroundPoint],
    ties: usize,
    options: &'a AdjustOptions,
}

impl Block<'_> {
    /// Adjusts with the positions as they stand, and where GCPs then seem to contradict them, with an offset of all.
    fn standing(&self, problem: Problem) -> Result<Standing> {
        let testable = offset::testable(&problem, self.control);
        if testable == Testable::No {
            return self.adjusted(problem);
        }
        let mut as_stated = self.adjusted(problem.clone());
        if as_stated.as_ref().is_ok_and(offset::is_doubtless) {
            return as_stated;
        }
        let Ok(apart) = self.adjusted(offset::freed(problem)) else { return as_stated };
        if !offset::is_borne_out(&apart, as_stated.as_ref().ok()) {
            return as_stated;
        }
        if testable == Testable::Offset {
            return Ok(apart);
        }
        if let Ok(standing) = &mut as_stated {
            standing.notes.extend(offset::doubt(&apart));
        }
        as_stated
    }

    /// First everything may be wrong; then the ties' own accuracy is the unit; then GCPs count in full and are tested.
    fn adjusted(&self, mut problem: Problem) -> Result<Standing> {
        let Block { control, ties, options, .. } = *self;
        let (mut screened, positions_aside) = robustly(&mut problem, ties, control)?;
        let sigmas = options.sigma_tie_px.map_or_else(
            || sigmas_of_ties(&problem, ties).map(|s| s.max(options.least_sigma_tie_px)),
            |stated| [stated; 3],
        );
        let rays = rays_of_ties(&problem, ties);
        for o in &mut problem.observations {
            if o.point < ties {
                o.sigma_px = sigmas[if rays[o.point] == 2 { 1 } else { 2 }];
            } else {
                o.trust = Trust::Full;
            }
        }
        let mut notes = Vec::new();
        if positions::are_tested(&problem, control) {
            notes.extend(positions::snoop(&mut problem, self.world, positions_aside)?);
        }
        let explained = |error| reason::explained(error, self.model, control);
        let mut snooped = snooping::snoop(&mut problem, ties, control, options, &mut screened).map_err(explained)?;
        // What was set aside early may be right after all.
        if snooped.factored.as_ref().is_some_and(|f| screened.readmit(&mut problem, f, options.critical)) {
            let again = snooping::snoop(&mut problem, ties, control, options, &mut screened).map_err(explained)?;
            snooped = Snooped { blunders: snooped.blunders.into_iter().chain(again.blunders).collect(), ..again };
        }
        let Snooped { mut blunders, summary, mut factored } = snooped;
        blunders.splice(..0, screened.blunders(&problem, ties, control));
        if let Some(note) = snooping::without_sigmas(&summary, factored.as_ref()) {
            notes.push(note.into());
            factored = None;
        }
        if let Some(camera) = problem.cameras.iter().map(|c| &c.camera).find(|c| c.f_px().is_nan() || c.f_px() <= 0.0) {
            return Err(Error::no_result(
                format!("the block collapses: its focal length would be {:.0} px", camera.f_px()),
                "check the coordinates and the CRS of the table and of the list, and the focal length",
            ));
        }
        let deviations = factored.map(|f| Deviations::new(&problem, f, snooping::LOSS, ties));
        Ok(Standing { problem, deviations, blunders, summary, sigma_tie_px: sigmas[0], notes })
    }
}

/// Adjusts with everything taken for possibly wrong, and sets aside what is grossly wrong: measurements, and positions
/// where they are tested.
fn robustly(problem: &mut Problem, ties: usize, control: &[&GroundPoint]) -> Result<(Screened, Vec<Aside>)> {
    for o in &mut problem.observations {
        o.trust = Trust::Robust;
    }
    let are_tested = positions::are_tested(problem, control);
    let positions_aside = if are_tested { positions::set_aside(problem) } else { Vec::new() };
    let loss = Loss::Huber(2.0);
    let mut robust = Options { loss, most_iterations: 60, least_gain: 1e-8, ..Options::default() };
    let mut screened = Screened::default();
    screened.screen_rays(problem, ties, screening::MONSTROUS);
    screened.screen(problem, ties, screening::MONSTROUS);
    for _ in 0..SCREENINGS {
        snooping::hold(problem, ties, control);
        snooping::hold_frames(problem);
        solve(problem, &robust)?;
        robust.damping = FROM_NEAR;
        let passed_by = screened.screen_rays(problem, ties, screening::GROSS);
        if !screened.screen(problem, ties, screening::GROSS) && !passed_by {
            break;
        }
    }
    Ok((screened, positions_aside))
}

fn build(world: &Reconstruction, control: &[&GroundPoint], options: &AdjustOptions) -> (Problem, Vec<usize>) {
    let mut problem = Problem::default();
    for camera in &world.cameras {
        let mut bundle = BundleCamera::held(camera.clone());
        for (p, sigma) in &options.interior {
            let treatment = match sigma {
                Some(sigma) => Treatment::Constrained { value: camera.get(*p), sigma: *sigma },
                None => Treatment::Free,
            };
            bundle = bundle.treat(*p, treatment);
        }
        problem.cameras.push(bundle);
    }
    for (i, p) in world.photographs.iter().enumerate() {
        let rough = options.rough.get(i).copied().flatten();
        problem.frames.push(BundleFrame {
            camera: p.camera,
            pose: p.pose,
            position: rough.map(|r| (r.pose.centre, r.sigma_m)),
            direction: rough.filter(|r| r.sigma_rad.is_finite()).map(|r| (r.pose.rotation, r.sigma_rad)),
        });
    }
    let mut kept = Vec::new();
    let start = options.sigma_tie_px.unwrap_or(1.0);
    for (j, tie) in world.ties.iter().enumerate() {
        let faces = |(i, pixel): &(usize, [f64; 2])| {
            let photograph = &world.photographs[*i];
            world.cameras[photograph.camera].faces(photograph.pose.to_camera(&tie.xyz).into(), *pixel)
        };
        if !tie.seen.iter().all(faces) || tie.seen.len() < 2 || !tie.xyz.iter().all(|v| v.is_finite()) {
            continue;
        }
        let point = problem.points.len();
        problem.points.push(BundlePoint { xyz: tie.xyz, survey: None });
        kept.push(j);
        for (frame, pixel) in &tie.seen {
            problem.observations.push(Observation {
                frame: *frame,
                point,
                pixel: *pixel,
                sigma_px: start,
                trust: Trust::Robust,
            });
        }
    }
    for p in control {
        let point = problem.points.len();
        let xyz = start_of(world, p, options.sigma_image_px);
        problem.points.push(BundlePoint { xyz, survey: Some((p.xyz, p.sigma)) });
        for (frame, pixel) in &p.seen {
            problem.observations.push(Observation {
                frame: *frame,
                point,
                pixel: *pixel,
                sigma_px: options.sigma_image_px,
                trust: Trust::Robust,
            });
        }
    }
    (problem, kept)
}

/// Where a GCP starts: at its survey, where its rays meet, or where a ray passes its survey, whichever fits survey and
/// images best. A survey that the first datum puts behind a camera or far from its rays would pull from the wrong side.
fn start_of(world: &Reconstruction, p: &GroundPoint, sigma_px: f64) -> Vector3<f64> {
    let along_rays = p.seen.iter().filter_map(|(i, pixel)| {
        let photograph = &world.photographs[*i];
        let ray = photograph.pose.rotation.transpose()
            * Vector3::from(world.cameras[photograph.camera].ray(*pixel)?).normalize();
        let reach = (p.xyz - photograph.pose.centre).dot(&ray);
        // A survey beside or behind the camera: as far off as it is, but in front.
        let reach = if reach > 0.0 { reach } else { (p.xyz - photograph.pose.centre).norm() };
        Some(photograph.pose.centre + ray * reach)
    });
    let misfit = |x: &Vector3<f64>| {
        let images: f64 = p
            .seen
            .iter()
            .map(|(i, pixel)| {
                let photograph = &world.photographs[*i];
                let camera = &world.cameras[photograph.camera];
                let residual = camera.residual(photograph.pose.to_camera(x).into(), *pixel);
                let off = residual.map_or(f64::INFINITY, |[x, y]| x.hypot(y) / sigma_px);
                Loss::Huber(2.0).at((off * off).min(FARTHEST_START * FARTHEST_START)).0
            })
            .sum();
        images + (x - p.xyz).component_div(&p.sigma).norm_squared()
    };
    let all = std::iter::once(p.xyz).chain(intersect_seen(world, &p.seen)).chain(along_rays);
    all.filter(|x| x.iter().all(|v| v.is_finite())).min_by(|a, b| misfit(a).total_cmp(&misfit(b))).unwrap_or(p.xyz)
}

/// What an image point behind its camera counts as when a start is chosen, in σ.
const FARTHEST_START: f64 = 1e4;

/// Medians of χ² with one and three degrees of freedom, of which Wilson and Hilferty's cube root is too large.
const MEDIANS: [(usize, f64); 2] = [(1, 0.4549), (3, 2.366)];

/// Fewer ties say nothing of their kind.
const LEAST_OF_KIND: usize = 100;

/// How many image points each tie has.
fn rays_of_ties(problem: &Problem, ties: usize) -> Vec<usize> {
    let mut rays = vec![0usize; ties];
    problem.observations.iter().filter(|o| o.point < ties).for_each(|o| rays[o.point] += 1);
    rays
}

/// σ of ties' coordinates: of all, of those of two rays, and of those of more. What ties err along the epipolar line,
/// where relief bends windows, is several times what they err across; of two rays it lies in the point and pulls at
/// nothing, while three rays show it and pull at frames and lens.
fn sigmas_of_ties(problem: &Problem, ties: usize) -> [f64; 3] {
    let rays = rays_of_ties(problem, ties);
    let all = estimate_sigma(problem, ties, |_| true).unwrap_or(1.0);
    let kind = |is: fn(usize) -> bool| {
        let of_it = || rays.iter().filter(|n| **n > 1 && is(**n));
        let enough = of_it().count() >= LEAST_OF_KIND;
        let sigma = enough.then(|| estimate_sigma(problem, ties, |tie| is(rays[tie]))).flatten()?;
        Some((sigma, of_it().sum::<usize>() as f64 / of_it().count() as f64))
    };
    let (Some((two, _)), Some((more, n))) = (kind(|n| n == 2), kind(|n| n > 2)) else { return [all; 3] };
    // Of n rays n - 1 measurements to spare lie across the epipolar lines, and n - 2 along them.
    let along = ((2.0 * n - 3.0) * more * more - (n - 1.0) * two * two) / (n - 2.0);
    [all, two, along.max(two * two).sqrt()]
}

/// σ of a tie's coordinate. A tie that n frames see has 2n − 3 measurements to spare, and the sum of its squared
/// residuals in units of σ² follows χ² of so many degrees of freedom: of two rays only what lies across the epipolar
/// line shows, a quarter of what they err. The median over ties that weigh as much as they have to spare, so that ties
/// seen often count and wrong ones do not; and the share that the frames' unknowns take up.
fn estimate_sigma(problem: &Problem, ties: usize, counts: impl Fn(usize) -> bool) -> Option<f64> {
    let mut sums = vec![(0.0, 0usize); ties];
    for o in problem.observations.iter().filter(|o| o.point < ties && counts(o.point)) {
        if let Some(r) = problem.residual(o) {
            sums[o.point].0 += r[0] * r[0] + r[1] * r[1];
            sums[o.point].1 += 2;
        }
    }
    let of_tie = |(sum, measured): (f64, usize)| {
        let spare = measured.checked_sub(3)?;
        let cube = |n: f64| n * (1.0 - 2.0 / (9.0 * n)).powi(3);
        let median = MEDIANS.iter().find(|(n, _)| *n == spare).map_or_else(|| cube(spare as f64), |(_, m)| *m);
        Some((sum / median, spare))
    };
    let mut variances: Vec<(f64, usize)> = sums.into_iter().filter_map(of_tie).collect();
    variances.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let spare: usize = variances.iter().map(|(_, spare)| spare).sum();
    let mut below = 0;
    let (median, _) = variances.into_iter().find(|(_, own)| {
        below += own;
        2 * below >= spare
    })?;
    Some((median / problem.share_left()).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::pose::Pose;
    use autoref_synth::rng::Rng;
    use nalgebra::Matrix3;

    /// Ties of two and of three rays, whose residuals are such as errors of 0.1 px across and of `along_px` along the
    /// line of the frames leave.
    fn left_by(along_px: f64) -> Problem {
        let mut rng = Rng::new(5, 1, 1);
        let camera = Camera::pinhole("c", [1000.0; 2], 1000.0, [500.0; 2]);
        let mut problem = Problem { cameras: vec![BundleCamera::held(camera)], ..Problem::default() };
        let look = |k: usize| Pose { rotation: Matrix3::identity(), centre: Vector3::new(k as f64, 0.0, 0.0) };
        let frame = |k| BundleFrame { camera: 0, pose: look(k), position: None, direction: None };
        problem.frames = (0..3).map(frame).collect();
        for tie in 0..4000 {
            let xyz = Vector3::new(rng.range(0.0, 2.0), rng.range(-1.0, 1.0), 5.0);
            problem.points.push(BundlePoint { xyz, survey: None });
            let [a, b, c] = [0.1 * rng.normal(), 0.1 * rng.normal(), along_px * rng.normal()];
            let (two, six) = (2f64.sqrt(), 6f64.sqrt());
            let left = match tie % 2 {
                0 => vec![[0.0, a / two], [0.0, -a / two]],
                _ => vec![[c / six, a / two + b / six], [-2.0 * c / six, b / six - a / two], [c / six, -2.0 * b / six]],
            };
            for (frame, left) in left.into_iter().enumerate() {
                let at = problem.cameras[0].camera.project(look(frame).to_camera(&xyz).into()).expect("in front");
                let pixel = [at[0] - left[0], at[1] - left[1]];
                problem.observations.push(Observation {
                    frame,
                    point: tie,
                    pixel,
                    sigma_px: 1.0,
                    trust: Trust::Robust,
                });
            }
        }
        problem
    }

    #[test]
    fn ties_of_three_rays_weigh_by_what_they_err_along_the_line_too() {
        let [all, two, more] = sigmas_of_ties(&left_by(0.1), 4000);
        for sigma in [all, two, more] {
            assert!((sigma - 0.1).abs() < 0.01, "{all} {two} {more}");
        }
        let [_, two, more] = sigmas_of_ties(&left_by(0.5), 4000);
        assert!((two - 0.1).abs() < 0.01 && (0.3..0.6).contains(&more), "{two} {more}");
    }

    #[test]
    fn a_few_ties_of_a_kind_weigh_as_all_do() {
        let mut problem = left_by(0.5);
        problem.observations.retain(|o| o.point % 2 == 0 || o.point < LEAST_OF_KIND);
        let [all, two, more] = sigmas_of_ties(&problem, 4000);
        assert!(all == two && all == more, "{all} {two} {more}");
    }
}
