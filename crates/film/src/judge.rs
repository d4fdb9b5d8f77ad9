//! What a frame's marks are worth together: each held against the others, the interior orientation through those that
//! agree, and the frame's status with its reasons.

use super::check::agreement;
use super::frame::{FindOptions, Finder, missing};
use super::interior::{Observation, Pose, distance, refit, residual_um, solve};
use super::plausible::doubt_of_shape;
use super::remeasure::Measured;
use super::types::{FrameResult, FrameStatus, MarkFind, MarkStatus};
use autoref_raster::coords::PixelPoint;

/// So many marks that agree, and this share of the camera's, need no further one.
const MANY: usize = 6;
const MOST_SHARE: f64 = 0.75;
/// Places of marks that were taught less exactly than this are looked at by a person, pixels.
pub(super) const GOOD_REFERENCE_PX: f64 = 0.5;
/// A mark lies no further from where the others put it, beyond what marks may disagree, than so many standard
/// deviations of the place that it was taught by.
const INEXACT_SIGMAS: f64 = 3.0;
/// 1σ of a centre along one axis where the scanner is sharper or softer than the drawn marks, pixels: crosses of lines
/// of two pixels, drawn by another program with a blur of 0.6 and 1.0 px, were 0.003 to 0.033 px off (RMS), by how they
/// lay between the pixels.
const SHARPNESS_SIGMA_PX: f64 = 0.02;

impl Finder {
    /// Enters the marks, each held against the others, the interior orientation and the status in `result`.
    pub(super) fn judge(
        &self,
        options: &FindOptions,
        pose: &Pose,
        measured: &[Option<Measured>],
        doubtful_names: Option<String>,
        result: &mut FrameResult,
    ) {
        let tolerance_px = options.tolerance_px(pose);
        let mut sound: Vec<usize> =
            (0..self.film.len()).filter(|k| measured[*k].as_ref().is_some_and(|m| m.reason.is_none())).collect();
        let exact: Vec<usize> =
            sound.iter().copied().filter(|k| self.reference_sigma_px(*k, pose) <= GOOD_REFERENCE_PX).collect();
        // A mark that was taught inexactly says nothing against many that were not.
        if self.are_enough(exact.len()) {
            sound = exact;
        }
        let places = |list: &[usize]| -> Vec<([f64; 2], PixelPoint)> {
            list.iter().filter_map(|k| Some((self.film[*k], measured[*k].as_ref()?.centre))).collect()
        };
        let compared = agreement(&places(&sound), pose.mirrored, tolerance_px);
        let good: Vec<usize> = sound.iter().zip(&compared).filter(|(_, a)| a.agrees).map(|(k, _)| *k).collect();
        let others_pose = refit(&places(&good), pose).filter(|_| good.len() >= 2);
        for (k, mark) in self.camera.marks.iter().enumerate() {
            let verdict = sound.iter().position(|s| *s == k).map(|i| &compared[i]);
            let predicted = verdict.and_then(|v| v.predicted).or(others_pose.map(|p| p.apply(self.film[k])));
            result.marks.push(match &measured[k] {
                None => missing(&mark.name, predicted, self.why_missing(predicted, result)),
                Some(m) => {
                    let compared = verdict.map_or_else(|| Some(self.taught_inexactly(k, pose)), |v| v.reason.clone());
                    let reason = m.reason.clone().or(compared).or(doubtful_names.clone());
                    MarkFind {
                        mark: mark.name.clone(),
                        status: if reason.is_none() { MarkStatus::Ok } else { MarkStatus::Doubtful },
                        centre: Some(m.centre),
                        covariance_px2: m.covariance_px2.map(|c| self.with_template(k, c, pose)),
                        predicted,
                        score: Some(m.score),
                        residual_um: None,
                        reason,
                    }
                }
            });
        }
        let used: Vec<usize> = if good.len() >= 3 { good } else { sound };
        self.orient(options, pose, measured, &used, doubtful_names, result);
    }

    fn why_missing(&self, predicted: Option<PixelPoint>, result: &FrameResult) -> &'static str {
        let outside = |p: PixelPoint| p.x < 0.0 || p.y < 0.0 || p.x > result.width as f64 || p.y > result.height as f64;
        if predicted.is_some_and(outside) { "lies outside the scan" } else { "not found" }
    }

    /// The covariance of a measured place, and what its template leaves open: where in it the reference point lies, and
    /// how the scanner blurs it.
    fn with_template(&self, mark: usize, [xx, xy, yy]: [f64; 3], pose: &Pose) -> [f64; 3] {
        let variance = self.reference_sigma_px(mark, pose).powi(2) + SHARPNESS_SIGMA_PX.powi(2);
        [xx + variance, xy, yy + variance]
    }

    /// How well the reference point of a mark is known in its template, pixels along one axis.
    fn reference_sigma_px(&self, mark: usize, pose: &Pose) -> f64 {
        self.model(mark).reference_sigma_um() / 1e3 * pose.px_per_mm()
    }

    fn taught_inexactly(&self, mark: usize, pose: &Pose) -> String {
        let sigma_px = self.reference_sigma_px(mark, pose);
        format!("was taught by a place that is good to {sigma_px:.1} px only")
    }

    /// Whether so many marks that agree need no further one.
    fn are_enough(&self, marks: usize) -> bool {
        marks >= MANY && marks as f64 >= MOST_SHARE * self.film.len() as f64
    }

    /// Marks without a centre of symmetry lie where clicks taught them, by the same for all frames: nothing in a frame
    /// shows it.
    fn doubt_references(&self, pose: &Pose, used: &[usize]) -> Option<String> {
        let squares: f64 = used.iter().map(|k| self.reference_sigma_px(*k, pose).powi(2)).sum();
        let sigma_px = (squares / used.len().max(1) as f64).sqrt();
        (sigma_px > GOOD_REFERENCE_PX).then(|| {
            format!("the marks were taught by places that are good to {sigma_px:.1} px only: teach them again, exactly")
        })
    }

    /// Solves with the marks `used` and gives the frame its status.
    fn orient(
        &self,
        options: &FindOptions,
        pose: &Pose,
        measured: &[Option<Measured>],
        used: &[usize],
        doubtful_names: Option<String>,
        result: &mut FrameResult,
    ) {
        let observations: Vec<Observation> = used
            .iter()
            .filter_map(|&k| {
                let m = measured[k].as_ref()?;
                let mark = &self.camera.marks[k];
                Some(Observation {
                    name: mark.name.clone(),
                    mm: [mark.x_mm?, mark.y_mm?],
                    pixel: m.centre,
                    covariance_px2: m.covariance_px2.map_or([1.0, 0.0, 1.0], |c| self.with_template(k, c, pose)),
                })
            })
            .collect();
        let mut reasons: Vec<String> = doubtful_names.into_iter().collect();
        // Many marks that agree check each other without the one that is not seen, or hardly; one that contradicts them
        // stays a reason.
        let found = observations.len();
        let enough = self.are_enough(found);
        let tolerance_px = |m: &MarkFind| {
            let k = self.camera.marks.iter().position(|c| c.name == m.mark).expect("a find is of a mark of the camera");
            options.tolerance_px(pose) + INEXACT_SIGMAS * self.reference_sigma_px(k, pose)
        };
        let there = |m: &MarkFind| m.centre.zip(m.predicted).is_some_and(|(c, p)| distance(c, p) <= tolerance_px(m));
        let unused = |m: &MarkFind| observations.iter().all(|o| o.name != m.mark);
        let spared = |m: &MarkFind| enough && unused(m) && (m.status == MarkStatus::Missing || there(m));
        for m in result.marks.iter().filter(|m| m.status != MarkStatus::Ok && !spared(m)) {
            let reason = m.reason.as_deref().unwrap_or_default();
            if !reasons.iter().any(|r| r == reason) {
                reasons.push(format!("mark {}: {reason}", m.mark));
            }
        }
        let Some(interior) = solve(&self.camera, &observations, options.model, pose.mirrored) else {
            reasons.insert(0, format!("{} marks to be trusted: no interior orientation", observations.len()));
            result.status = FrameStatus::Failed { reasons };
            return;
        };
        for m in &mut result.marks {
            let mm = self.camera.marks.iter().find(|c| c.name == m.mark).and_then(|c| c.x_mm.zip(c.y_mm));
            m.residual_um = mm.zip(m.centre).and_then(|(mm, p)| residual_um(&interior, [mm.0, mm.1], p));
        }
        if found < self.film.len() {
            let said = format!("solved with {found} of {} marks", self.film.len());
            let lost: Vec<String> = result
                .marks
                .iter()
                .filter(|m| spared(m))
                .map(|m| format!("{} {}", m.mark, m.reason.as_deref().unwrap_or_default()))
                .collect();
            if found + lost.len() == self.film.len() {
                result.notes.push(format!("{said}: {}", lost.join(", ")));
            } else {
                reasons.insert(0, said);
            }
        }
        reasons.extend(self.doubt_references(pose, used));
        reasons.extend(doubt_of_shape(measured, used));
        let most_um = self.most_rmse_um(options, pose);
        if interior.rmse_um > most_um {
            reasons.push(format!(
                "the interior orientation leaves {:.0} µm in the mean, more than film does ({most_um:.0} µm)",
                interior.rmse_um
            ));
        }
        if interior.mirrored.is_mirrored() {
            result.notes.push("the scan shows the film from the wrong side (mirrored)".into());
        }
        result.interior = Some(interior);
        result.status = if reasons.is_empty() { FrameStatus::Ok } else { FrameStatus::Doubtful { reasons } };
    }
}
