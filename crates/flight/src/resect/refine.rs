//! A pose from its start to the least squares' minimum, without the points that are wrong.

use nalgebra::{Matrix3, Vector3};

use super::resection::Resection;
use super::seen::{Focal, ResectOptions, Seen};
use super::testing::{excess, far_off, least_share, off_by, worst_points};
use crate::bundle::{
    ANY_FOCAL, BundleCamera, BundleFrame, BundlePoint, Ended, Factored, Loss, Observation, Options, Problem, Treatment,
    Trust, factor, solve,
};
use crate::camera::{Camera, Parameter};
use crate::error::{Error, Result};
use crate::pose::Pose;

/// Focal lengths of cameras, in sides of their images: beyond, an object far off would do as well.
pub(super) const FOCAL_SIDES: std::ops::Range<f64> = 0.15..12.0;

/// A minimum, and what speaks against it: χ² of its points in the image and on the ground, and of a known position.
#[derive(Clone, Debug)]
pub(super) struct Minimum {
    pub found: Resection,
    pub points: f64,
    pub position: f64,
    /// Of the points, before a position pulls that they can do without.
    redundancy: usize,
}

impl Minimum {
    /// How many times as large the points' variance is as was stated; 1 where chance explains it, or nothing tells.
    pub fn scale(&self) -> f64 {
        let sigma0 = (self.redundancy > 0).then(|| (self.points / self.redundancy as f64).sqrt());
        excess(sigma0, self.redundancy).powi(2)
    }
}

fn problem(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions, trust: Trust) -> Problem {
    let mut bundle = BundleCamera::held(camera.clone());
    if options.focal == Focal::Sought {
        bundle = bundle.treat(Parameter::F, Treatment::Free);
    }
    let spread = seen.iter().map(|s| (s.xyz - seen[0].xyz).norm()).fold(0.0, f64::max);
    // Exact points are held by a σ that no residual notices.
    let sigma = |s: &Seen| s.sigma_m.map(|sigma| if sigma > 0.0 { sigma } else { spread * 1e-7 });
    Problem {
        cameras: vec![bundle],
        frames: vec![BundleFrame { camera: 0, pose: *pose, position: options.position, direction: None }],
        points: seen.iter().map(|s| BundlePoint { xyz: s.xyz, survey: Some((s.xyz, sigma(s))) }).collect(),
        observations: seen
            .iter()
            .enumerate()
            .map(|(i, s)| Observation { frame: 0, point: i, pixel: s.pixel, sigma_px: options.sigma_px, trust })
            .collect(),
        offset: None,
    }
}

fn unknowns(options: &ResectOptions) -> usize {
    6 + usize::from(options.focal == Focal::Sought)
}

/// How points are judged. A known position may be what is wrong: where the points can do without it, it has no say.
pub(super) fn judging(seen: &[Seen], options: &ResectOptions) -> ResectOptions {
    let counts = 2 * seen.len() < unknowns(options) + 4;
    ResectOptions { position: options.position.filter(|_| counts), ..options.clone() }
}

/// χ² of three numbers that one position in a thousand exceeds.
const CHI2_POSITION: f64 = 16.27;
/// Of the points, before they contradict a position: fewer fit many cameras.
const LEAST_TO_SPARE: usize = 4;

/// So many points can spare one.
const SPARE_ONE: usize = 5;

/// Where a start led.
pub(super) struct Approached {
    pub camera: Camera,
    pub pose: Pose,
    pub ended: Ended,
}

/// Where a start leads while points may be wrong: what becomes of the focal length there is `at_first`. Few points that
/// cannot spare one stay where they are: robustness would only lead away from the start.
pub(super) fn approached(
    camera: &Camera,
    pose: &Pose,
    seen: &[Seen],
    options: &ResectOptions,
    at_first: Focal,
) -> Result<Approached> {
    if seen.len() < SPARE_ONE {
        return Ok(Approached { camera: camera.clone(), pose: *pose, ended: Ended::Converged });
    }
    /// Starts near a minimum are there by then; what creeps on is left to them.
    const MOST: usize = 50;
    let loss = Loss::Cauchy(2.0);
    let robust = Options { loss, most_iterations: MOST, focal_px: bounds(camera, options), ..Options::default() };
    let first = ResectOptions { focal: at_first, ..judging(seen, options) };
    let mut at = problem(camera, pose, seen, &first, Trust::Robust);
    let ended = solve(&mut at, &robust)?.ended;
    Ok(Approached { camera: at.cameras.swap_remove(0).camera, pose: at.frames[0].pose, ended })
}

/// From where a start led to the end.
pub(super) fn refine(camera: &Camera, pose: &Pose, seen: &[Seen], options: &ResectOptions) -> Result<Minimum> {
    let judged_with = judging(seen, options).position;
    let mut refining = Refining {
        seen,
        options,
        is_judged_with_position: judged_with.is_some(),
        position_counts: judged_with.is_some() || options.position.is_none(),
        camera: camera.clone(),
        pose: *pose,
        kept: (0..seen.len()).collect(),
        blunders: Vec::new(),
        aside: 0,
    };
    if seen.len() >= SPARE_ONE {
        refining.set_aside();
    }
    let mut fit = refining.fit()?;
    while refining.mend(&fit) {
        fit = refining.fit()?;
    }
    // What the points say before a position pulls.
    let ((points, position), redundancy) = (fit.chi2_of(options), fit.redundancy);
    let mut position_off_m = None;
    if !refining.position_counts {
        (fit, position_off_m) = refining.with_position(fit)?;
    }
    let found = Resection { position_off_m, ..refining.resection(&fit)? };
    Ok(Minimum { found, points, position, redundancy })
}

/// Focal lengths, where they are sought, beyond which none comes back.
pub(super) fn bounds(camera: &Camera, options: &ResectOptions) -> [f64; 2] {
    /// Times as far as those of cameras.
    const WIDER: f64 = 2.0;
    let side = camera.size_px[0].max(camera.size_px[1]);
    match options.focal {
        Focal::Known => ANY_FOCAL,
        Focal::Sought => [FOCAL_SIDES.start * side / WIDER, FOCAL_SIDES.end * side * WIDER],
    }
}

/// The least squares of the points that are kept.
struct Fit {
    at: Problem,
    cost: f64,
    redundancy: usize,
    known: usize,
    sigma0: Option<f64>,
    factored: Option<Factored>,
    subset: Vec<Seen>,
}

impl Fit {
    /// χ² of the points, and of the position that is known, whether it counted or not.
    fn chi2_of(&self, options: &ResectOptions) -> (f64, f64) {
        let off = |(at, sigma): &(Vector3<f64>, Vector3<f64>)| {
            (self.at.frames[0].pose.centre - at).component_div(sigma).norm_squared()
        };
        let counted = self.at.frames[0].position.as_ref().map_or(0.0, off);
        (2.0 * self.cost - counted, options.position.as_ref().map_or(0.0, off))
    }

    /// How far a position lies from the camera of these points, where it does so by more than both can err; `None`
    /// where it agrees, and where the points have too little to spare to say so.
    fn contradicts(&self, (at, sigma): &(Vector3<f64>, Vector3<f64>)) -> Option<f64> {
        if self.redundancy < LEAST_TO_SPARE {
            return None;
        }
        let camera = self.factored.as_ref()?.frame(0).fixed_view::<3, 3>(3, 3) * self.variance();
        let off = self.at.frames[0].pose.centre - at;
        let inverse = (camera + Matrix3::from_diagonal(&sigma.component_mul(sigma))).try_inverse()?;
        (off.dot(&(inverse * off)) > CHI2_POSITION).then(|| off.norm())
    }

    /// How many times as large the variance is as was stated.
    fn variance(&self) -> f64 {
        excess(self.sigma0, self.redundancy).powi(2)
    }
}

struct Refining<'a> {
    seen: &'a [Seen],
    options: &'a ResectOptions,
    is_judged_with_position: bool,
    position_counts: bool,
    camera: Camera,
    pose: Pose,
    kept: Vec<usize>,
    blunders: Vec<usize>,
    /// Of the blunders so many, the first, were set aside from afar.
    aside: usize,
}

impl Refining<'_> {
    fn set_aside(&mut self) {
        self.blunders = far_off(&self.camera, &self.pose, self.seen, self.options);
        self.kept.retain(|i| !self.blunders.contains(i));
        self.aside = self.blunders.len();
    }

    fn fit(&mut self) -> Result<Fit> {
        let subset: Vec<Seen> = self.kept.iter().map(|i| self.seen[*i].clone()).collect();
        let position = self.options.position.filter(|_| self.position_counts);
        let now = ResectOptions { position, ..self.options.clone() };
        let mut at = problem(&self.camera, &self.pose, &subset, &now, Trust::Full);
        let plain = Options { loss: Loss::Squared, focal_px: bounds(&self.camera, self.options), ..Options::default() };
        let summary = solve(&mut at, &plain)?;
        (self.camera, self.pose) = (at.cameras[0].camera.clone(), at.frames[0].pose);
        let known = 2 * self.kept.len() + if position.is_some() { 3 } else { 0 };
        let redundancy = known.saturating_sub(unknowns(self.options));
        let sigma0 = (redundancy > 0).then(|| (2.0 * summary.cost / redundancy as f64).sqrt());
        let factored = factor(&at, Loss::Squared);
        Ok(Fit { at, cost: summary.cost, redundancy, known, sigma0, factored, subset })
    }

    /// Puts back what was set aside and is right, or takes the worst point out. Whether anything changed.
    fn mend(&mut self, fit: &Fit) -> bool {
        let Some(factored) = &fit.factored else { return false };
        // What was set aside from afar may be right after all.
        if self.aside > 0 {
            let unit = (fit.sigma0.unwrap_or(1.0) / least_share(fit.redundancy)).max(1.0);
            let off = |i: &usize| off_by(&self.camera, &self.pose, factored, &self.seen[*i], self.options);
            let right = |i: &&usize| off(i) <= self.options.critical * unit;
            let back: Vec<usize> = self.blunders[..self.aside].iter().filter(right).copied().collect();
            self.blunders.retain(|i| !back.contains(i));
            self.aside = 0;
            if !back.is_empty() {
                self.kept.extend(back);
                self.kept.sort_unstable();
                return true;
            }
        }
        // The worst normalised residual, as long as the rest still fixes the pose with something to spare, and only
        // where the points are judged: later on, a wrong position would make some of them look wrong.
        let judged = self.options.position.is_none() || !self.position_counts || self.is_judged_with_position;
        if fit.known < unknowns(self.options) + 3 || self.kept.len() < SPARE_ONE || !judged {
            return false;
        }
        let worst = worst_points(&fit.at, factored, &fit.subset, self.options, (2.0 * fit.cost, fit.redundancy));
        self.blunders.extend(worst.iter().map(|index| self.kept[*index]));
        self.kept.retain(|i| !self.blunders.contains(i));
        !worst.is_empty()
    }

    /// The fit of points and position; of the points alone, with the distance to the position, where both contradict
    /// each other. Along a circle that the points hardly fix, straight deviations do not tell: the position has to
    /// spoil their fit as well.
    fn with_position(&mut self, alone: Fit) -> Result<(Fit, Option<f64>)> {
        self.position_counts = true;
        let off_m = self.options.position.as_ref().and_then(|position| alone.contradicts(position));
        let (camera, pose) = (self.camera.clone(), self.pose);
        let together = self.fit();
        let Some(off_m) = off_m else { return Ok((together?, None)) };
        let most = CHI2_POSITION * alone.variance();
        match together {
            Ok(fit) if 2.0 * (fit.cost - alone.cost) <= most => Ok((fit, None)),
            _ => {
                (self.camera, self.pose) = (camera, pose);
                Ok((alone, Some(off_m)))
            }
        }
    }

    fn resection(mut self, fit: &Fit) -> Result<Resection> {
        let (camera, pose) = (&self.camera, &self.pose);
        let residual = |s: &Seen| camera.residual(pose.to_camera(&s.xyz).into(), s.pixel);
        let residuals_px: Vec<Option<[f64; 2]>> = self.seen.iter().map(residual).collect();
        if self.kept.iter().any(|i| residuals_px[*i].is_none()) {
            return Err(Error::no_result("a point lies behind the camera", "check the points"));
        }
        let widened = excess(fit.sigma0, fit.redundancy);
        let sum: f64 = self.kept.iter().filter_map(|i| residuals_px[*i]).map(|r| r[0] * r[0] + r[1] * r[1]).sum();
        self.blunders.sort_unstable();
        Ok(Resection {
            covariance: fit.factored.as_ref().map(|f| f.frame(0) * widened.powi(2)),
            widened,
            rms_px: (sum / (2 * self.kept.len()) as f64).sqrt(),
            camera: self.camera,
            pose: self.pose,
            residuals_px,
            blunders: self.blunders,
            sigma0: fit.sigma0,
            position_off_m: None,
            alternatives: Vec::new(),
            pixels_times: None,
        })
    }
}
