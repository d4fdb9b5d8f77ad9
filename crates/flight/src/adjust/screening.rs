//! What is grossly wrong with GCPs, before they count in full: one of them would bend the block so far that no test of
//! its residuals sees it any more.

use autoref_raster::ranks::upper_median;
use nalgebra::{Matrix2, Vector2, Vector3};

use super::adjusted::Blunder;
use super::rays::{self, MEET};
use super::survey::GroundPoint;
use crate::bundle::{Factored, Observation, Problem};
use crate::intersect::intersect;
use crate::pose::Pose;

/// A surveyed place with its standard deviations, metres.
type Survey = (Vector3<f64>, Vector3<f64>);

/// What was set aside.
#[derive(Default)]
pub(super) struct Screened {
    /// Points whose survey is wrong, with it.
    surveys: Vec<(usize, Survey)>,
    images: Vec<Observation>,
}

/// Times the spread of all that is grossly wrong in a block that was adjusted robustly, and in one that was placed as
/// it is, bent.
pub(super) const GROSS: f64 = 8.0;
pub(super) const MONSTROUS: f64 = 50.0;
/// Of more of the measurements nothing says that it is they that are wrong.
const MOST: f64 = 0.4;
/// GCPs that fix a block.
const FEWEST: usize = 4;

/// A GCP's measurement in an image, against where its survey is to be seen.
struct Seen {
    index: usize,
    point: usize,
    off_px: f64,
    /// What the survey's own deviation makes of that.
    ground_px: f64,
}

impl Screened {
    /// Sets aside what is more than `times` the spread of all from the block as it stands: a survey where the rays meet
    /// elsewhere, else single measurements. Whether anything was.
    pub(super) fn screen(&mut self, problem: &mut Problem, ties: usize, times: f64) -> bool {
        let seen = measured(problem, ties);
        let mut all: Vec<f64> = seen.iter().map(|s| s.off_px).collect();
        let Some(median) = upper_median(&mut all) else { return false };
        // The median length of a normal 2-vector is 1.1774 σ.
        let spread = median / 1.1774;
        let gross = |s: &Seen| {
            let sigma = problem.observations[s.index].sigma_px;
            s.off_px > times * (spread.max(sigma).powi(2) + s.ground_px.powi(2)).sqrt()
        };
        let (mut surveys, mut images) = (Vec::new(), Vec::new());
        for point in ties..problem.points.len() {
            let own: Vec<&Seen> = seen.iter().filter(|s| s.point == point).collect();
            let far: Vec<&&Seen> = own.iter().filter(|s| gross(s)).collect();
            if far.is_empty() {
                continue;
            }
            // With what was set aside of it before: a wrong survey shows in one image after another.
            let mut all: Vec<Observation> = own.iter().map(|s| problem.observations[s.index]).collect();
            all.extend(self.images.iter().filter(|o| o.point == point));
            let whole = far.len() == own.len() || all.len() >= 3;
            let elsewhere = all.len() >= 2 && whole && rays_meet(problem, &all, MEET * spread.max(all[0].sigma_px));
            if elsewhere { surveys.push(point) } else { images.extend(far.iter().map(|s| s.index)) }
        }
        let touched = |s: &&Seen| surveys.contains(&s.point) || images.contains(&s.index);
        let wrong = seen.iter().filter(touched).count();
        let mut left: Vec<usize> = seen.iter().filter(|s| !touched(s)).map(|s| s.point).collect();
        left.dedup();
        if wrong == 0 || wrong as f64 > MOST * seen.len() as f64 || left.len() < FEWEST {
            return false;
        }
        images.sort_unstable();
        self.images.extend(images.into_iter().rev().map(|index| problem.observations.remove(index)));
        for point in surveys {
            self.surveys.extend(problem.points[point].survey.take().map(|survey| (point, survey)));
            let (right, others) = self.images.iter().partition(|o| o.point == point);
            self.images = others;
            problem.observations.extend::<Vec<Observation>>(right);
        }
        true
    }

    /// Sets aside image points whose ray passes the others of its GCP by at more than `times` what is usual. Whether
    /// any was.
    pub(super) fn screen_rays(&mut self, problem: &mut Problem, ties: usize, times: f64) -> bool {
        let apart = rays::apart(problem, ties, times);
        let measured = problem.observations.iter().filter(|o| o.point >= ties).count();
        let mut wrong: Vec<usize> = apart.iter().flat_map(|a| a.wrong.iter().copied()).collect();
        if wrong.is_empty() || wrong.len() as f64 > MOST * measured as f64 {
            return false;
        }
        wrong.sort_unstable();
        wrong.into_iter().rev().for_each(|index| self.set_aside(problem, index));
        // The wrong ray may have dragged the point along.
        apart.into_iter().for_each(|a| problem.points[a.point].xyz = a.meet);
        true
    }

    /// Takes an image point out, by its number among the observations.
    pub(super) fn set_aside(&mut self, problem: &mut Problem, index: usize) {
        self.images.push(problem.observations.remove(index));
    }

    /// Puts back what agrees with the block once it stands without it, to `critical` standard deviations. Whether
    /// anything was.
    pub(super) fn readmit(&mut self, problem: &mut Problem, factored: &Factored, critical: f64) -> bool {
        let (before, mut surveys, mut images) = (self.surveys.len() + self.images.len(), Vec::new(), Vec::new());
        for (point, (at, sigma)) in self.surveys.drain(..) {
            let q = factored.point(point) + nalgebra::Matrix3::from_diagonal(&sigma.component_mul(&sigma));
            let off = at - problem.points[point].xyz;
            let test = q.try_inverse().map_or(f64::INFINITY, |inverse| off.dot(&(inverse * off)).sqrt());
            if test <= critical {
                problem.points[point].survey = Some((at, sigma));
            } else {
                surveys.push((point, (at, sigma)));
            }
        }
        for o in self.images.drain(..) {
            let test = problem.residual(&o).zip(factored.predicted(problem, &o)).and_then(|(r, predicted)| {
                let r = Vector2::from(r);
                let q = predicted + Matrix2::identity() * o.sigma_px.powi(2);
                Some(r.dot(&(q.try_inverse()? * r)).sqrt())
            });
            if test.is_some_and(|test| test <= critical) { problem.observations.push(o) } else { images.push(o) }
        }
        (self.surveys, self.images) = (surveys, images);
        self.surveys.len() + self.images.len() < before
    }

    /// How many measurements are aside, with those of a survey that is.
    pub(super) fn measurements(&self, ties: usize, control: &[&GroundPoint]) -> usize {
        let of_surveys = self.surveys.iter().map(|(point, _)| control[*point - ties].seen.len());
        self.images.len() + of_surveys.sum::<usize>()
    }

    /// What stayed aside, by how much it is wrong as the block has it.
    pub(super) fn blunders(&self, problem: &Problem, ties: usize, control: &[&GroundPoint]) -> Vec<Blunder> {
        let survey = |(point, (at, sigma)): &(usize, Survey)| {
            let by = at - problem.points[*point].xyz;
            let test = by.component_div(sigma).norm();
            Blunder {
                gcp: control[*point - ties].name.clone(),
                photograph: None,
                by: by.iter().copied().collect(),
                test,
            }
        };
        let image = |o: &Observation| {
            // Behind the camera a point is seen nowhere, and no number of pixels mends that.
            let by = problem.residual(o).map(|r| vec![-r[0], -r[1]]).unwrap_or_default();
            let name = control[o.point - ties].name.clone();
            let test = if by.is_empty() { f64::INFINITY } else { by[0].hypot(by[1]) / o.sigma_px };
            Blunder { gcp: name, photograph: Some(o.frame), by, test }
        };
        self.surveys.iter().map(survey).chain(self.images.iter().map(image)).collect()
    }
}

/// All measurements of surveyed points, in the order of the points.
fn measured(problem: &Problem, ties: usize) -> Vec<Seen> {
    let mut all: Vec<Seen> = Vec::new();
    for (index, o) in problem.observations.iter().enumerate().filter(|(_, o)| o.point >= ties) {
        let Some((at, sigma)) = problem.points[o.point].survey.filter(|survey| survey.1.max() < 1e5) else { continue };
        let frame = &problem.frames[o.frame];
        let camera = &problem.cameras[frame.camera].camera;
        let local = frame.pose.to_camera(&at).into();
        let off_px = camera.residual(local, o.pixel).map_or(f64::INFINITY, |[x, y]| x.hypot(y));
        let ground_px = sigma.max() * camera.most_px_per_m(local);
        all.push(Seen { index, point: o.point, off_px, ground_px });
    }
    all.sort_by_key(|s| s.point);
    all
}

/// Whether the rays of measurements meet, to so many pixels.
fn rays_meet(problem: &Problem, seen: &[Observation], most_px: f64) -> bool {
    let cameras: Vec<_> = problem.cameras.iter().map(|c| c.camera.clone()).collect();
    let poses: Vec<(usize, Pose)> =
        seen.iter().map(|o| (problem.frames[o.frame].camera, problem.frames[o.frame].pose)).collect();
    let pixels: Vec<[f64; 2]> = seen.iter().map(|o| o.pixel).collect();
    let Some(at) = intersect(&cameras, &poses, &pixels) else { return false };
    poses.iter().zip(&pixels).all(|((camera, pose), pixel)| {
        let residual = cameras[*camera].residual(pose.to_camera(&at).into(), *pixel);
        residual.is_some_and(|[x, y]| x.hypot(y) <= most_px)
    })
}
