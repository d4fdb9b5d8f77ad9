//! The re-measurement: every mark again under a pose that is known, to a fraction of a pixel, with what makes it
//! doubtful by itself.

use super::check::agreement;
use super::constellation::Assembly;
use super::frame::{FindOptions, Finder};
use super::interior::{Pose, distance, refit};
use super::picture::Picture;
use super::refine::{Refined, Refiner};
use super::search::{GOOD_SCORE, Levels, Peak, climb, near, search, settle};
use super::sketch::{Sketches, refined_mm};
use super::template::{Model, draw, invert};
use super::types::FrameResult;
use super::window::{around, read_grey};
use autoref_raster::RasterSource;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::Result;
use autoref_raster::ranks::median;

/// How far from its prediction a mark is taken, millimetres (and 4 pixels): by the pose of coarse peaks, and by that of
/// marks which agree.
const REACH_MM: f64 = 0.6;
const NEAR_MM: f64 = 0.1;
/// Peaks looked at around a prediction.
const NEAR_PEAKS: usize = 4;
const LINE_PEAKS: usize = 12;
/// What a place is worth less for lying as far from a sure prediction as marks may disagree, as a share of misfitting
/// pixels: specks as large as a dot fit nearly as well as a dot that one of them covers in part.
const ASTRAY: f64 = 0.05;
/// How far a reference point may lie from where the shape puts it when the frame's other marks tell how the shape was
/// drawn, millimetres and pixels, added. In made frames shapes keep to half a pixel.
const POINT_MM: f64 = 0.015;
const POINT_PX: f64 = 0.75;
/// How far a reference point is found from where its shape puts it, millimetres: the shape's error in front of terrain.
const HOLE_MM: f64 = 0.05;
/// Places of two marks that lie no further apart are one, millimetres.
const SAME_PLACE_MM: f64 = 0.1;
/// A centre less certain than this is looked at by a person, pixels.
const GOOD_SIGMA_PX: f64 = 0.5;

/// A mark after the re-measurement.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    pub centre: PixelPoint,
    pub covariance_px2: Option<[f64; 3]>,
    pub score: f64,
    /// Of marks of lines, the share of its pixels and of those around it that do not fit.
    pub misfit: Option<f64>,
    /// Of marks of lines, the standard deviation of a pixel about the drawn mark, of the mark's contrast.
    pub noise: Option<f64>,
    /// Where the whole shape puts the reference point, for marks with a point of their own.
    pub body: Option<PixelPoint>,
    /// Why it is not to be trusted by itself.
    pub reason: Option<String>,
}

/// A mark of lines, drawn to be refined.
struct Lines<'a> {
    refiner: &'a Refiner,
    predicted: PixelPoint,
    /// How far marks may disagree, where others that agree put this one.
    tolerance_px: Option<f64>,
}

impl Lines<'_> {
    /// What a place is worth less for lying far from a sure prediction, as a share of misfitting pixels.
    fn doubt(&self, place: PixelPoint) -> f64 {
        self.tolerance_px.map_or(0.0, |t| ASTRAY * (distance(place, self.predicted) / t).powi(2))
    }
}

impl Finder {
    /// Measures every mark under the assembly's pose, names them, checks them and solves. Returns what is worth knowing
    /// of the names.
    pub(super) fn remeasure(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        assembly: &Assembly,
        result: &mut FrameResult,
    ) -> Result<Option<String>> {
        let mut pose = assembly.pose;
        let sketches = &mut Sketches::default();
        let all = 0..self.film.len();
        let mut measured =
            all.clone().map(|k| self.measure(source, options, sketches, &pose, k, None)).collect::<Result<Vec<_>>>()?;
        self.settle_points(source, &pose, &mut measured)?;
        let mut naming = self.name_marks(options, &mut pose, &mut measured, &assembly.rivals);
        if !self.are_symmetric() && pose.lies_otherwise(&assembly.pose) {
            // Each by its own picture, not by that of the mark it was taken for.
            measured = all.map(|k| self.measure(source, options, sketches, &pose, k, None)).collect::<Result<_>>()?;
            self.settle_points(source, &pose, &mut measured)?;
        }
        // Under the names and the pose of those that agree, the others are looked for again.
        let points = located(&self.film, &measured, |_| true);
        let agreed = agreeing(&self.film, &points, &pose, options.tolerance_px(&pose));
        if agreed.len() >= 3 {
            pose = refit(&placed(&self.film, &agreed), &pose).unwrap_or(pose);
            for (k, slot) in measured.iter_mut().enumerate() {
                let sound = slot.as_ref().is_some_and(|m| m.reason.is_none());
                let agrees = agreed.iter().any(|a| a.0 == k);
                if sound && agrees {
                    continue;
                }
                match self.measure(source, options, sketches, &pose, k, Some(NEAR_MM))? {
                    Some(again) => *slot = Some(again),
                    // What is barely recognised, and not where the others put it, is not the mark.
                    None if !agrees && slot.as_ref().is_some_and(|m| m.score < GOOD_SCORE) => *slot = None,
                    None => {}
                }
            }
            self.settle_points(source, &pose, &mut measured)?;
            naming = self.name_marks(options, &mut pose, &mut measured, &assembly.rivals);
        }
        one_place_each(&self.film, &pose, &mut measured);
        self.judge(options, &pose, &measured, naming.doubt, result);
        Ok(naming.note)
    }

    /// Holds the points of a frame's marks against their shapes. Drawn proportions may be off, but by the same for all
    /// marks of a frame; a point that lies elsewhere is a speck or a scratch, and is looked for again where the shape
    /// puts it.
    fn settle_points(&self, source: &dyn RasterSource, pose: &Pose, measured: &mut [Option<Measured>]) -> Result<()> {
        let unit = pose.px_per_mm();
        let linear = |k: usize| self.linear(pose, k);
        // Point − shape in the shape's own axes, millimetres.
        let offset = |k: usize, m: &Measured| {
            let (body, inverse) = (m.body?, invert(linear(k))?);
            m.covariance_px2?;
            let (dx, dy) = (m.centre.x - body.x, m.centre.y - body.y);
            Some([inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy])
        };
        let known: Vec<[f64; 2]> = measured.iter().enumerate().filter_map(|(k, m)| offset(k, m.as_ref()?)).collect();
        if known.len() < 3 {
            return Ok(());
        }
        let typical = [0, 1].map(|d| median(known.iter().map(|o| o[d]).collect()));
        let tolerance_mm = POINT_MM + POINT_PX / unit;
        for (k, slot) in measured.iter_mut().enumerate() {
            let Some(m) = slot.as_mut() else { continue };
            let Some(body) = m.body else { continue };
            let far = |o: [f64; 2]| (o[0] - typical[0]).hypot(o[1] - typical[1]) > tolerance_mm;
            let off = offset(k, m);
            if off.is_some_and(|o| !far(o)) {
                continue;
            }
            let l = linear(k);
            let expected = PixelPoint {
                x: body.x + l[0] * typical[0] + l[1] * typical[1],
                y: body.y + l[2] * typical[0] + l[3] * typical[1],
            };
            if off.is_some() {
                m.reason = Some("its hole lies beside where its shape puts it; placed by the shape".to_owned());
            }
            let again = self.point_near(source, k, l, expected, tolerance_mm * unit)?;
            if let Some(r) = again.filter(|_| off.is_some()) {
                (m.centre, m.covariance_px2, m.reason) = (r.centre, Some(r.covariance_px2), None);
            } else {
                (m.centre, m.covariance_px2) = (expected, None);
            }
        }
        Ok(())
    }

    /// The point of mark `k` within `reach_px` of a place, refined; `None` when it is not seen there.
    fn point_near(
        &self,
        source: &dyn RasterSource,
        k: usize,
        linear: [f64; 4],
        expected: PixelPoint,
        reach_px: f64,
    ) -> Result<Option<Refined>> {
        let model = self.model(k);
        let Some(radius_mm) = model.point_radius_mm() else { return Ok(None) };
        let half_px = 1.6 * radius_mm * (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt() + 12.0;
        let Some(window) = around(expected, half_px, half_px, &source.info().bounds()) else { return Ok(None) };
        let grey = read_grey(source, window, 1)?;
        let template = draw(model, linear, 1.0, Some(radius_mm));
        let peak = template.and_then(|t| climb(&grey, &t, expected, reach_px.ceil() as i64, |_| 0.0));
        let Some(peak) = peak.filter(|p| p.score >= GOOD_SCORE) else { return Ok(None) };
        let near = |r: &Refined| r.contrast > 0.0 && distance(r.centre, expected) <= reach_px;
        let refiner = Refiner::new(model, linear, radius_mm);
        Ok(refiner.and_then(|r| r.refine(&grey, peak.centre, |_| 0.0)).filter(near))
    }

    /// One mark under a pose that is known to a fraction of a millimetre.
    fn measure<'a>(
        &'a self,
        source: &dyn RasterSource,
        options: &FindOptions,
        sketches: &mut Sketches<'a>,
        pose: &Pose,
        k: usize,
        near_mm: Option<f64>,
    ) -> Result<Option<Measured>> {
        let model = self.model(k);
        let linear = self.linear(pose, k);
        let predicted = pose.apply(self.film[k]);
        let unit = pose.px_per_mm();
        // A mark of lines may lie whole in the scan where its prediction does not quite.
        let slack_px = if model.sectors_deg().is_some() { near_mm.unwrap_or(NEAR_MM) * unit + 4.0 } else { 0.0 };
        let bounds = source.info().bounds();
        let (half, out, inward) = model.reach_mm();
        let inside = [(-half, -out), (half, -out), (-half, inward), (half, inward)].iter().all(|(u, v)| {
            let x = predicted.x + linear[0] * u + linear[1] * v;
            let y = predicted.y + linear[2] * u + linear[3] * v;
            let within = |v: f64, size: u64| v > -slack_px && v < size as f64 + slack_px;
            within(x, bounds.width) && within(y, bounds.height)
        });
        if !inside {
            return self.point_only(source, model, linear, predicted, unit);
        }
        let sketch = sketches.of(model, linear);
        let picture = &sketch.picture;
        let reach_px = near_mm.unwrap_or(REACH_MM) * unit + 4.0;
        let of_lines = model.sectors_deg().and_then(|_| {
            Some(Lines {
                refiner: sketch.refiner()?,
                predicted,
                tolerance_px: near_mm.map(|_| options.tolerance_px(pose)),
            })
        });
        let body = if let Some(lines) = &of_lines {
            self.lines(source, picture, reach_px, lines)?
        } else if near_mm.is_some() {
            near(source, predicted, picture, reach_px, Levels::of(picture).fine, 1)?.first().copied()
        } else {
            self.body(source, predicted, picture)?
        };
        let Some(body) = body else { return self.point_only(source, model, linear, predicted, unit) };
        Ok(Some(self.place(source, model, linear, &body, unit, of_lines)?))
    }

    /// The best place for a mark whose prediction is good to a fraction of a millimetre.
    fn body(&self, source: &dyn RasterSource, predicted: PixelPoint, picture: &Picture) -> Result<Option<Peak>> {
        let unit = picture.px_per_mm();
        let half_px = (picture.model.radius_mm() * 1.1 + 0.6) * unit + 8.0;
        let Some(window) = around(predicted, half_px, half_px, &source.info().bounds()) else { return Ok(None) };
        let peaks = search(source, window, picture, NEAR_PEAKS)?;
        // Near the prediction, not merely the best: the box also holds what is beside the mark.
        let near = |p: &&Peak| distance(p.centre, predicted) < REACH_MM * unit + 4.0;
        let Some(peak) = peaks.iter().filter(near).max_by(|a, b| a.score.total_cmp(&b.score)) else { return Ok(None) };
        let levels = Levels::of(picture);
        Ok(Some(settle(source, peak.centre, picture, levels.rank, levels.fine)?.unwrap_or(*peak)))
    }

    /// The best place for a mark of lines. A scratch beside a line can correlate better than the line itself, so that
    /// the places are told apart by how many pixels do not fit the mark once it is refined there.
    fn lines(
        &self,
        source: &dyn RasterSource,
        picture: &Picture,
        reach_px: f64,
        lines: &Lines,
    ) -> Result<Option<Peak>> {
        let peaks = near(source, lines.predicted, picture, reach_px, Levels::of(picture).rank, LINE_PEAKS)?;
        let half_px = refined_mm(picture.model) * picture.px_per_mm() + reach_px + 12.0;
        let bounds = source.info().bounds();
        let Some(window) = around(lines.predicted, half_px, half_px, &bounds) else { return Ok(None) };
        let grey = read_grey(source, window, 1)?;
        let starts: Vec<PixelPoint> = peaks.iter().map(|p| p.centre).collect();
        let best = lines.refiner.best_of(&grey, &starts, |p| lines.doubt(p));
        Ok(best.map(|(k, r)| Peak { centre: r.centre, score: peaks[k].score }).or(peaks.first().copied()))
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
        let refiner = Refiner::new(model, linear, radius_mm);
        let refined = refiner.and_then(|r| r.refine(&grey, peak.centre, |_| 0.0)).filter(|r| r.contrast > 0.0);
        Ok(refined.map(|r| Measured {
            centre: r.centre,
            covariance_px2: Some(r.covariance_px2),
            score: peak.score,
            misfit: None,
            noise: None,
            body: None,
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
        of_lines: Option<Lines>,
    ) -> Result<Measured> {
        let point_mm = model.point_radius_mm();
        let radius_mm = point_mm.unwrap_or(refined_mm(model));
        let half_px = 1.6 * radius_mm * unit + 12.0;
        let mut measured = Measured {
            centre: body.centre,
            covariance_px2: None,
            score: body.score,
            misfit: None,
            noise: None,
            body: point_mm.map(|_| body.centre),
            reason: None,
        };
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
            let refined = match &of_lines {
                Some(lines) => lines.refiner.refine(&grey, start, |p| lines.doubt(p)),
                None => Refiner::new(model, linear, radius_mm).and_then(|r| r.refine(&grey, start, |_| 0.0)),
            };
            match refined {
                Some(r) if r.contrast > 0.0 => {
                    measured.centre = r.centre;
                    measured.covariance_px2 = Some(r.covariance_px2);
                    measured.misfit = of_lines.as_ref().map(|_| r.misfit);
                    measured.noise = of_lines.as_ref().map(|_| r.sigma / r.contrast);
                    let sigma = r.covariance_px2[0].max(r.covariance_px2[2]).sqrt();
                    if sigma > radius_mm * unit {
                        reasons.push("what is seen does not tell where its centre is".to_owned());
                    } else if sigma > GOOD_SIGMA_PX {
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
}

/// Leaves every place in the scan to one mark, the one that is expected nearest to it.
fn one_place_each(film: &[[f64; 2]], pose: &Pose, measured: &mut [Option<Measured>]) {
    let off = |k: usize, m: &Measured| distance(pose.apply(film[k]), m.centre);
    for a in 0..film.len() {
        for b in a + 1..film.len() {
            let (Some(first), Some(second)) = (&measured[a], &measured[b]) else { continue };
            let same_px =
                (0.5 * distance(pose.apply(film[a]), pose.apply(film[b]))).min(SAME_PLACE_MM * pose.px_per_mm());
            if distance(first.centre, second.centre) <= same_px {
                measured[if off(a, first) <= off(b, second) { b } else { a }] = None;
            }
        }
    }
}

/// Those that agree within `tolerance_px`; where fewer than three do, within three times as much.
fn agreeing(
    film: &[[f64; 2]],
    points: &[(usize, PixelPoint)],
    pose: &Pose,
    tolerance_px: f64,
) -> Vec<(usize, PixelPoint)> {
    let within = |tolerance: f64| -> Vec<(usize, PixelPoint)> {
        let compared = agreement(&placed(film, points), pose.mirrored, tolerance);
        points.iter().zip(compared).filter_map(|(p, a)| a.agrees.then_some(*p)).collect()
    };
    let strict = within(tolerance_px);
    if strict.len() >= 3 { strict } else { within(3.0 * tolerance_px) }
}

/// Mark and place of those measured marks that are wanted.
pub(super) fn located(
    film: &[[f64; 2]],
    measured: &[Option<Measured>],
    wanted: impl Fn(&Measured) -> bool,
) -> Vec<(usize, PixelPoint)> {
    (0..film.len()).filter_map(|k| Some((k, measured[k].as_ref().filter(|m| wanted(m))?.centre))).collect()
}

/// Film point and place.
pub(super) fn placed(film: &[[f64; 2]], located: &[(usize, PixelPoint)]) -> Vec<([f64; 2], PixelPoint)> {
    located.iter().map(|(k, p)| (film[*k], *p)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::Handedness;

    #[test]
    fn two_marks_have_no_place_in_common() {
        let film = [[-20.0, 0.0], [20.0, 0.0], [0.0, 20.0], [0.7, 20.0]];
        let pose = Pose::about([0.0, 0.0], PixelPoint { x: 500.0, y: 500.0 }, 20.0, 0.0, Handedness::AsIs);
        let at = |k: usize, dx: f64| {
            let p = pose.apply(film[k]);
            let centre = PixelPoint { x: p.x + dx, y: p.y };
            let (covariance_px2, misfit, noise) = (None, None, None);
            Some(Measured { centre, covariance_px2, score: 0.9, misfit, noise, body: None, reason: None })
        };
        let kept = |mut measured: Vec<Option<Measured>>| {
            one_place_each(&film, &pose, &mut measured);
            measured.iter().map(Option::is_some).collect::<Vec<_>>()
        };
        assert_eq!(kept(vec![at(0, 0.2), at(1, -0.3), at(2, 0.1), at(3, 0.0)]), [true; 4]);
        assert_eq!(kept(vec![at(0, 0.2), at(1, -0.3), at(2, 13.0), at(3, 0.0)]), [true, true, false, true]);
        assert_eq!(kept(vec![at(0, 0.2), at(1, -0.3), at(2, 0.0), at(3, -13.5)]), [true, true, true, false]);
    }
}
