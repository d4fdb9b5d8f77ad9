//! One frame: search, constellation, second look, checks, inner orientation.

use std::path::Path;
use std::time::Instant;

use super::check::agreement;
use super::constellation::{Assembly, Naming, assemble, namings};
use super::inner::{Observation, Pose, distance, fit_pose, residual_um, solve};
use super::refine::refine;
use super::search::{Levels, Peak, climb, search, settle};
use super::template::{Model, Picture, draw};
use super::types::{Camera, FrameResult, FrameStatus, InnerModel, MarkFind, MarkStatus};
use super::window::{around, open_scan, read_grey};
use crate::coords::PixelPoint;
use crate::error::Result;
use crate::raster::RasterSource;

/// How frames are looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct FindOptions {
    /// Size of a scanned pixel on the film; `None`: from the film's and the scan's sizes.
    pub pixel_um: Option<f64>,
    /// The inner orientation that is solved when marks allow it.
    pub model: InnerModel,
    /// Clockwise turn of the frames in the scans, 0, 90, 180 or 270; `None`: found.
    pub turn_deg: Option<f64>,
    /// Whether the scans show the film from the wrong side; `None`: found.
    pub mirrored: Option<bool>,
    /// Side of the search box as a share of the frame's longer side.
    pub box_share: f64,
    /// How far a mark may lie from where the others put it: micrometres on the film, but never below `agreement_px`.
    pub agreement_um: f64,
    pub agreement_px: f64,
}

impl Default for FindOptions {
    /// The box is that of the 2017 thesis. The real Wild frame keeps its corners within 20 µm of an affine transform; 2.5 px leave room for that on
    /// coarse scans and still show an error of 5 px in one mark.
    fn default() -> Self {
        FindOptions {
            pixel_um: None,
            model: InnerModel::Affine,
            turn_deg: None,
            mirrored: None,
            box_share: 0.10,
            agreement_um: 40.0,
            agreement_px: 2.5,
        }
    }
}

/// The search box grows by these factors while too few marks are found.
const GROWTH: [f64; 3] = [1.0, 2.0, 3.6];
/// Peaks kept per search box.
const PEAKS: usize = 10;
/// A mark that correlates less is looked at by a person.
const GOOD_SCORE: f64 = 0.5;
/// How far a reference point is found from where its shape puts it, millimetres: the shape's error in front of terrain.
const HOLE_MM: f64 = 0.05;
/// A centre less certain than this is looked at by a person, pixels.
const GOOD_SIGMA_PX: f64 = 0.5;

/// A camera ready for work: its shapes drawn or read once for a whole roll.
#[derive(Clone, Debug)]
pub struct Finder {
    pub camera: Camera,
    film: Vec<[f64; 2]>,
    turns_deg: Vec<f64>,
    centre: [f64; 2],
    /// For every mark, its shape; marks that look alike share one.
    class: Vec<usize>,
    models: Vec<Model>,
}

/// One search box, done.
struct Slot {
    class: usize,
    /// Direction of the shape's inward axis in the scan, and of its right, as quarters of a turn.
    linear: [f64; 4],
    centre: PixelPoint,
    half_px: f64,
    peaks: Vec<Peak>,
}

/// A mark after the second look.
#[derive(Clone, Debug)]
struct Measured {
    centre: PixelPoint,
    covariance_px2: Option<[f64; 3]>,
    score: f64,
    /// Why it is not to be trusted by itself.
    reason: Option<String>,
}

impl Finder {
    /// # Errors
    /// When a learned template cannot be read.
    pub fn new(camera: &Camera) -> Result<Finder> {
        let mut models: Vec<Model> = vec![];
        let mut class = vec![];
        for mark in &camera.marks {
            let model = Model::of(&mark.kind)?;
            let known = models.iter().position(|m| *m == model);
            class.push(known.unwrap_or(models.len()));
            if known.is_none() {
                models.push(model);
            }
        }
        Ok(Finder::assembled(camera, class, models))
    }

    /// With a model for every mark, whatever kinds the camera names.
    pub(super) fn with_models(camera: &Camera, models: Vec<Model>) -> Finder {
        Finder::assembled(camera, (0..models.len()).collect(), models)
    }

    fn assembled(camera: &Camera, class: Vec<usize>, models: Vec<Model>) -> Finder {
        Finder {
            film: camera.film_points(),
            turns_deg: camera.turns_deg(),
            centre: camera.film_centre(),
            camera: camera.clone(),
            class,
            models,
        }
    }

    fn size_mm(&self) -> f64 {
        self.camera.film_size_mm[0].max(self.camera.film_size_mm[1])
    }

    fn model(&self, mark: usize) -> &Model {
        &self.models[self.class[mark]]
    }

    /// The marks and the inner orientation of one scan. Finding nothing is no error: the status says so.
    ///
    /// # Errors
    /// Those of reading the scan.
    pub fn find(&self, source: &dyn RasterSource, options: &FindOptions) -> Result<FrameResult> {
        let started = Instant::now();
        let info = source.info();
        let mut result = FrameResult {
            path: info.path.clone(),
            name: info.path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            width: info.width,
            height: info.height,
            status: FrameStatus::Failed { reasons: vec!["no two marks fit the camera".into()] },
            marks: vec![],
            inner: None,
            notes: vec![],
            elapsed_s: 0.0,
        };
        match self.assembly(source, options)? {
            Some(assembly) => self.second_look(source, options, &assembly, &mut result)?,
            None => {
                result.marks = self.camera.marks.iter().map(|m| missing(&m.name, None, "not found")).collect();
            }
        }
        result.elapsed_s = started.elapsed().as_secs_f64();
        Ok(result)
    }

    /// Turns and mirrorings to try, the usual first.
    fn orientations(&self, options: &FindOptions) -> Vec<(f64, bool)> {
        let turns = options.turn_deg.map_or(vec![0.0, 180.0, 90.0, 270.0], |t| vec![t]);
        let mirrors = options.mirrored.map_or(vec![false, true], |m| vec![m]);
        mirrors.iter().flat_map(|m| turns.iter().map(move |t| (*t, *m))).collect()
    }

    /// Possible sizes of a pixel, micrometres, the likeliest first.
    fn pixel_sizes_um(&self, source: &dyn RasterSource, options: &FindOptions) -> Vec<f64> {
        if let Some(size) = options.pixel_um {
            return vec![size];
        }
        let (width, height) = (source.info().width as f64, source.info().height as f64);
        let [a, b] = self.camera.film_size_mm;
        // The scan shows the film's longer side along its own.
        let (film_long, film_short) = (a.max(b), a.min(b));
        let (long, short) = (width.max(height), width.min(height));
        let (by_short, by_long) = (1e3 * film_short / short, 1e3 * film_long / long);
        if (by_short / by_long - 1.0).abs() < 0.02 { vec![0.5 * (by_short + by_long)] } else { vec![by_short, by_long] }
    }

    fn assembly(&self, source: &dyn RasterSource, options: &FindOptions) -> Result<Option<Assembly>> {
        let info = source.info();
        let middle = PixelPoint { x: 0.5 * info.width as f64, y: 0.5 * info.height as f64 };
        let wanted = self.film.len().min(3);
        let mut best: Option<Assembly> = None;
        for growth in GROWTH {
            for pixel_um in self.pixel_sizes_um(source, options) {
                let half_px = 0.5 * options.box_share * growth * info.width.max(info.height) as f64;
                let mut slots: Vec<Slot> = vec![];
                for (turn_deg, mirrored) in self.orientations(options) {
                    let assumed = Pose::about(self.centre, middle, 1e3 / pixel_um, turn_deg, mirrored);
                    let peaks = (0..self.film.len())
                        .map(|k| self.slot(source, &mut slots, k, &assumed, half_px))
                        .collect::<Result<Vec<_>>>()?;
                    let Some(found) = assemble(&self.film, &peaks, &assumed) else { continue };
                    let chosen_only = keep_chosen(found, &peaks);
                    if best.as_ref().is_none_or(|b| chosen_only.score > b.score + 1e-9) {
                        best = Some(chosen_only);
                    }
                }
                if best.as_ref().is_some_and(|b| b.marks() == self.film.len()) {
                    return Ok(best);
                }
            }
            if best.as_ref().is_some_and(|b| b.marks() >= wanted.max(self.film.len() - 1)) {
                break;
            }
        }
        Ok(best)
    }

    /// The peaks of mark `k` under `assumed`, from a box searched before where shape and place are the same.
    fn slot(
        &self,
        source: &dyn RasterSource,
        slots: &mut Vec<Slot>,
        k: usize,
        assumed: &Pose,
        half_px: f64,
    ) -> Result<Vec<Peak>> {
        let centre = assumed.apply(self.film[k]);
        let linear = assumed.shape_linear(self.turns_deg[k]);
        let alike = |a: &[f64; 4], b: &[f64; 4]| {
            let unit = assumed.px_per_mm();
            let close = |i: usize, sign: f64| (a[i] - sign * b[i]).abs() < 0.05 * unit;
            let same_inward = close(1, 1.0) && close(3, 1.0);
            let same_right = close(0, 1.0) && close(2, 1.0);
            let flipped = close(0, -1.0) && close(2, -1.0);
            same_inward && (same_right || (flipped && self.model(k).is_symmetric()))
        };
        let known = slots.iter().find(|s| {
            s.class == self.class[k] && alike(&s.linear, &linear) && distance(s.centre, centre) < 0.3 * s.half_px
        });
        if let Some(slot) = known {
            return Ok(slot.peaks.clone());
        }
        // A wide mark needs room to be moved in.
        let half_px = half_px.max((self.model(k).radius_mm() + 0.03 * self.size_mm()) * assumed.px_per_mm());
        let peaks = match around(centre, half_px, half_px, &source.info().bounds()) {
            Some(window) => search(source, window, &Picture::new(self.model(k), linear), PEAKS)?,
            None => vec![],
        };
        slots.push(Slot { class: self.class[k], linear, centre, half_px, peaks: peaks.clone() });
        Ok(peaks)
    }

    /// Measures every mark under the assembly's pose, names them, checks them and solves.
    fn second_look(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        assembly: &Assembly,
        result: &mut FrameResult,
    ) -> Result<()> {
        let mut pose = assembly.pose;
        let mut measured: Vec<Option<Measured>> = vec![None; self.film.len()];
        // Twice: the first round's pose is that of coarse peaks.
        for round in 0..2 {
            for (k, slot) in measured.iter_mut().enumerate() {
                if slot.as_ref().is_some_and(|m| m.reason.is_none()) && round > 0 {
                    continue;
                }
                *slot = self.measure(source, &pose, k)?;
            }
            let sound = |m: &Measured| m.reason.is_none();
            let points: Vec<_> = (0..self.film.len())
                .filter_map(|k| measured[k].as_ref().filter(|m| sound(m)).map(|m| (self.film[k], m.centre)))
                .collect();
            if points.len() < 3 {
                break;
            }
            let Some(next) = fit_pose(&points, pose.mirrored) else { break };
            let agreed = agreement(&points, pose.mirrored, 3.0 * options.agreement_px).iter().all(|a| a.agrees);
            if agreed {
                pose = next;
            }
            if agreed && points.len() == self.film.len() {
                break;
            }
        }
        let naming = self.name_marks(options, &mut pose, &mut measured, result);
        self.judge(options, &pose, &measured, naming, result);
        Ok(())
    }

    /// One mark under a pose that is known to a fraction of a millimetre.
    fn measure(&self, source: &dyn RasterSource, pose: &Pose, k: usize) -> Result<Option<Measured>> {
        let model = self.model(k);
        let linear = pose.shape_linear(self.turns_deg[k]);
        let predicted = pose.apply(self.film[k]);
        let unit = pose.px_per_mm();
        let bounds = source.info().bounds();
        let (half, out, inward) = model.reach_mm();
        let inside = [(-half, -out), (half, -out), (-half, inward), (half, inward)].iter().all(|(u, v)| {
            let x = predicted.x + linear[0] * u + linear[1] * v;
            let y = predicted.y + linear[2] * u + linear[3] * v;
            x > 0.0 && y > 0.0 && x < bounds.width as f64 && y < bounds.height as f64
        });
        if !inside {
            return self.point_only(source, model, linear, predicted, unit);
        }
        let half_px = (model.radius_mm() * 1.1 + 0.6) * unit + 8.0;
        let Some(window) = around(predicted, half_px, half_px, &source.info().bounds()) else { return Ok(None) };
        let picture = Picture::new(model, linear);
        let peaks = search(source, window, &picture, 3)?;
        // Near the prediction, not merely the best: the box also holds what is beside the mark.
        let near = |p: &&Peak| distance(p.centre, predicted) < 0.6 * unit + 4.0;
        let Some(body) = peaks.iter().filter(near).max_by(|a, b| a.score.total_cmp(&b.score)) else {
            return self.point_only(source, model, linear, predicted, unit);
        };
        let levels = Levels::of(&picture);
        let body = settle(source, body.centre, &picture, levels.rank, levels.fine)?.unwrap_or(*body);
        Ok(Some(self.place(source, model, linear, &body, unit)?))
    }

    /// A hole where the other marks put it although the shape around it is not recognised, as in front of dark water.
    fn point_only(
        &self,
        source: &dyn RasterSource,
        model: &Model,
        linear: [f64; 4],
        predicted: PixelPoint,
        unit: f64,
    ) -> Result<Option<Measured>> {
        let Some(radius_mm) = model.point_radius_mm() else { return Ok(None) };
        let half_px = (1.6 * radius_mm + 0.3) * unit + 8.0;
        let Some(window) = around(predicted, half_px, half_px, &source.info().bounds()) else { return Ok(None) };
        let grey = read_grey(source, window, 1)?;
        let template = draw(model, linear, 1.0, Some(radius_mm));
        let peak = template.and_then(|t| climb(&grey, &t, predicted, (0.3 * unit).ceil() as i64, |_| 0.0));
        let Some(peak) = peak.filter(|p| p.score >= GOOD_SCORE) else { return Ok(None) };
        let refined = refine(&grey, model, linear, peak.centre, radius_mm).filter(|r| r.contrast > 0.0);
        Ok(refined.map(|r| Measured {
            centre: r.centre,
            covariance_px2: Some(r.covariance_px2),
            score: peak.score,
            reason: Some("only its hole is seen, not its shape".to_owned()),
        }))
    }

    /// From the shape's place to the reference point, with everything that makes it doubtful by itself.
    fn place(
        &self,
        source: &dyn RasterSource,
        model: &Model,
        linear: [f64; 4],
        body: &Peak,
        unit: f64,
    ) -> Result<Measured> {
        let point_mm = model.point_radius_mm();
        let radius_mm = point_mm.unwrap_or(1.5 * model.radius_mm());
        let half_px = 1.6 * radius_mm * unit + 12.0;
        let mut measured = Measured { centre: body.centre, covariance_px2: None, score: body.score, reason: None };
        let Some(window) = around(body.centre, half_px, half_px, &source.info().bounds()) else { return Ok(measured) };
        let grey = read_grey(source, window, 1)?;
        let mut start = body.centre;
        let mut reasons = vec![];
        if let Some(radius) = point_mm {
            let point = draw(model, linear, 1.0, Some(radius));
            // Specks look like holes too: far from where the shape puts it a hole must be seen so much better.
            let reach = (0.7 * radius * unit).ceil() as i64 + 2;
            let doubt = |p: PixelPoint| 0.1 * (distance(p, start) / (HOLE_MM * unit + 0.5)).powi(2);
            match point.and_then(|t| climb(&grey, &t, start, reach, doubt)) {
                Some(p) if p.score >= GOOD_SCORE => start = p.centre,
                found => reasons.push(format!(
                    "its hole is not seen (correlation {:.2}); placed by the teeth",
                    found.map_or(0.0, |p| p.score)
                )),
            }
        }
        if reasons.is_empty() {
            match refine(&grey, model, linear, start, radius_mm) {
                Some(r) if r.contrast > 0.0 => {
                    measured.centre = r.centre;
                    measured.covariance_px2 = Some(r.covariance_px2);
                    let sigma = r.covariance_px2[0].max(r.covariance_px2[2]).sqrt();
                    if sigma > GOOD_SIGMA_PX {
                        reasons.push(format!("its centre is only known to {sigma:.1} px"));
                    }
                }
                _ => reasons.push("its centre does not settle; placed by correlation".to_owned()),
            }
        }
        let apart = distance(measured.centre, body.centre);
        if apart > HOLE_MM * unit + 1.5 {
            reasons.push(format!("its point lies {apart:.1} px from where its shape puts it; placed by the shape"));
            (measured.centre, measured.covariance_px2) = (body.centre, None);
        }
        if body.score < GOOD_SCORE {
            reasons.push(format!("its shape is barely recognised (correlation {:.2})", body.score));
        }
        measured.reason = (!reasons.is_empty()).then(|| reasons.join("; "));
        Ok(measured)
    }

    /// Puts the right names to the marks: of all turns of the frame the one whose calibrated positions fit best. Returns
    /// why the names are doubtful, when they are.
    fn name_marks(
        &self,
        options: &FindOptions,
        pose: &mut Pose,
        measured: &mut Vec<Option<Measured>>,
        result: &mut FrameResult,
    ) -> Option<String> {
        if !self.models.iter().all(Model::is_symmetric) {
            return None;
        }
        let located = |sound: bool| -> Vec<(usize, PixelPoint)> {
            let usable = |m: &&Measured| m.reason.is_none() || !sound;
            (0..self.film.len()).filter_map(|k| Some((k, measured[k].as_ref().filter(usable)?.centre))).collect()
        };
        // Names need places that are right to some pixels only.
        let places = Some(located(true)).filter(|p| p.len() >= 3).unwrap_or_else(|| located(false));
        let allowed = self.orientations(options);
        let all = namings(&self.film, self.centre, &places, pose, &allowed, |a, b| self.class[a] == self.class[b]);
        let best = all.first()?;
        // The usual orientation wins among those that fit as well.
        let as_good: Vec<&Naming> = all.iter().filter(|n| n.rms_px < best.rms_px + 1.2).collect();
        let taken = allowed
            .iter()
            .find_map(|(t, m)| as_good.iter().find(|n| n.turn_deg == *t && n.mirrored == *m))
            .copied()
            .unwrap_or(best)
            .clone();
        let mut doubt = None;
        if as_good.len() > 1 {
            let said = "the marks' positions do not tell how the frame is turned";
            if self.tells_turns(pose) {
                doubt = Some(format!("{said}; taken as {}", orientation_text(&taken)));
            } else {
                result.notes.push(format!("{said} with this camera; taken as {}", orientation_text(&taken)));
            }
        }
        let before = std::mem::replace(measured, vec![None; self.film.len()]);
        let from: Vec<usize> = places.iter().map(|p| p.0).collect();
        // Places that took no part in the naming follow it through the pose it gives.
        let points: Vec<_> = taken.names.iter().zip(&places).map(|(n, (_, p))| (self.film[*n], *p)).collect();
        if let Some(next) = fit_pose(&points, taken.mirrored) {
            *pose = next;
        }
        for (k, m) in before.into_iter().enumerate() {
            let Some(m) = m else { continue };
            let name = match from.iter().position(|f| *f == k) {
                Some(i) => Some(taken.names[i]),
                None => (0..self.film.len()).min_by(|&a, &b| {
                    let d = |j: usize| distance(pose.apply(self.film[j]), m.centre);
                    d(a).total_cmp(&d(b))
                }),
            };
            if let Some(slot) = name.map(|n| &mut measured[n])
                && slot.is_none()
            {
                *slot = Some(m);
            }
        }
        doubt
    }

    /// Whether the calibrated positions are far enough from symmetric for a scan of this scale.
    fn tells_turns(&self, pose: &Pose) -> bool {
        let places: Vec<(usize, PixelPoint)> =
            self.film.iter().enumerate().map(|(k, mm)| (k, pose.apply(*mm))).collect();
        let allowed: Vec<(f64, bool)> =
            [0.0, 90.0, 180.0, 270.0].iter().flat_map(|t| [(*t, false), (*t, true)]).collect();
        let all = namings(&self.film, self.centre, &places, pose, &allowed, |a, b| self.class[a] == self.class[b]);
        all.get(1).is_none_or(|second| second.rms_px > 3.0)
    }

    fn judge(
        &self,
        options: &FindOptions,
        pose: &Pose,
        measured: &[Option<Measured>],
        doubtful_names: Option<String>,
        result: &mut FrameResult,
    ) {
        let tolerance_px = (options.agreement_um / 1e3 * pose.px_per_mm()).max(options.agreement_px);
        let sound: Vec<usize> =
            (0..self.film.len()).filter(|k| measured[*k].as_ref().is_some_and(|m| m.reason.is_none())).collect();
        let places = |list: &[usize]| -> Vec<([f64; 2], PixelPoint)> {
            list.iter().filter_map(|k| Some((self.film[*k], measured[*k].as_ref()?.centre))).collect()
        };
        let compared = agreement(&places(&sound), pose.mirrored, tolerance_px);
        let good: Vec<usize> = sound.iter().zip(&compared).filter(|(_, a)| a.agrees).map(|(k, _)| *k).collect();
        let others_pose = fit_pose(&places(&good), pose.mirrored).filter(|_| good.len() >= 2);
        for (k, mark) in self.camera.marks.iter().enumerate() {
            let verdict = sound.iter().position(|s| *s == k).map(|i| &compared[i]);
            let predicted = verdict.and_then(|v| v.predicted).or(others_pose.map(|p| p.apply(self.film[k])));
            result.marks.push(match &measured[k] {
                None => missing(&mark.name, predicted, self.why_missing(predicted, result)),
                Some(m) => {
                    let reason = m.reason.clone().or(verdict.and_then(|v| v.reason.clone())).or(doubtful_names.clone());
                    MarkFind {
                        mark: mark.name.clone(),
                        status: if reason.is_none() { MarkStatus::Ok } else { MarkStatus::Doubtful },
                        centre: Some(m.centre),
                        covariance_px2: m.covariance_px2,
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
                    covariance_px2: m.covariance_px2.unwrap_or([1.0, 0.0, 1.0]),
                })
            })
            .collect();
        let mut reasons: Vec<String> = doubtful_names.into_iter().collect();
        for m in result.marks.iter().filter(|m| m.status != MarkStatus::Ok) {
            let reason = m.reason.as_deref().unwrap_or_default();
            if !reasons.iter().any(|r| r == reason) {
                reasons.push(format!("mark {}: {reason}", m.mark));
            }
        }
        let Some(inner) = solve(&self.camera, &observations, options.model, pose.mirrored) else {
            reasons.insert(0, format!("{} marks to be trusted: no inner orientation", observations.len()));
            result.status = FrameStatus::Failed { reasons };
            return;
        };
        for m in &mut result.marks {
            let mm = self.camera.marks.iter().find(|c| c.name == m.mark).and_then(|c| c.x_mm.zip(c.y_mm));
            m.residual_um = mm.zip(m.centre).and_then(|(mm, p)| residual_um(&inner, [mm.0, mm.1], p));
        }
        if observations.len() < self.film.len() {
            reasons.insert(0, format!("solved with {} of {} marks", observations.len(), self.film.len()));
        }
        if inner.mirrored {
            result.notes.push("the scan shows the film from the wrong side (mirrored)".into());
        }
        result.inner = Some(inner);
        result.status = if reasons.is_empty() { FrameStatus::Ok } else { FrameStatus::Doubtful { reasons } };
    }
}

fn missing(name: &str, predicted: Option<PixelPoint>, reason: &str) -> MarkFind {
    MarkFind {
        mark: name.to_owned(),
        status: MarkStatus::Missing,
        centre: None,
        covariance_px2: None,
        predicted,
        score: None,
        residual_um: None,
        reason: Some(reason.to_owned()),
    }
}

fn orientation_text(naming: &Naming) -> String {
    let mirrored = if naming.mirrored { ", mirrored" } else { "" };
    format!("turned by {:.0}°{mirrored}", naming.turn_deg)
}

/// Leaves only the chosen peaks' agreement in the score: what counts between orientations is also how well they fit.
fn keep_chosen(mut assembly: Assembly, peaks: &[Vec<Peak>]) -> Assembly {
    assembly.score = assembly.chosen.iter().enumerate().filter_map(|(k, c)| Some(peaks[k][(*c)?].score)).sum();
    assembly
}

/// Opens and examines one scan; what goes wrong with it becomes its status.
pub fn find_frame(finder: &Finder, path: &Path, options: &FindOptions) -> FrameResult {
    let started = Instant::now();
    let result = open_scan(path).and_then(|source| finder.find(source.as_ref(), options));
    match result {
        Ok(mut frame) => {
            frame.path = path.to_path_buf();
            frame.elapsed_s = started.elapsed().as_secs_f64();
            frame
        }
        Err(error) => FrameResult {
            path: path.to_path_buf(),
            name: path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            width: 0,
            height: 0,
            status: FrameStatus::Failed { reasons: vec![error.to_string()] },
            marks: vec![],
            inner: None,
            notes: vec![],
            elapsed_s: started.elapsed().as_secs_f64(),
        },
    }
}
