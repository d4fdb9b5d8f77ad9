//! One frame: search, constellation, re-measurement, checks, interior orientation.

use std::path::Path;
use std::time::Instant;

use super::constellation::{Assembly, assemble, assemble_stretched, chance};
use super::interior::{MOST_STRETCH, Pose, SURE_STRETCH, Stretch, distance};
use super::negative::Negative;
use super::own_white::with_own_white;
use super::resolution::Resolution;
use super::scan::open_scan;
use super::search::{GOOD_SCORE, Peak, search};
use super::sketch::{Sketches, upright};
use super::template::Model;
use super::types::{Camera, FrameResult, FrameStatus, InteriorModel, MarkFind, MarkStatus};
use super::window::around;
use autoref_raster::RasterSource;
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::error::Result;

/// How marks are found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Method {
    /// Correlation with the drawn or learned mark and least squares.
    #[default]
    Correlation,
    /// The steps of the 2017 thesis; three-toothed marks only.
    Thesis2017,
}

/// How frames are looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct FindOptions {
    pub method: Method,
    /// Size of a scanned pixel on the film; `None`: from the film's and the scan's sizes.
    pub pixel_um: Option<f64>,
    /// The interior orientation that is solved when marks allow it.
    pub model: InteriorModel,
    /// Clockwise turn of the frames in the scans, 0, 90, 180 or 270; `None`: found.
    pub turn_deg: Option<f64>,
    /// Whether the scans show the film from the wrong side; `None`: found.
    pub mirrored: Option<Handedness>,
    /// Side of the search box as a share of the frame's longer side.
    pub box_share: f64,
    /// How far a mark may lie from where the others put it: micrometres on the film, but never below `agreement_px`.
    pub agreement_um: f64,
    pub agreement_px: f64,
}

impl Default for FindOptions {
    /// The box is that of the 2017 thesis. The real Wild frame keeps its corners within 20 µm of an affine transform;
    /// 1.5 px leave room for that on coarse scans, and one of four marks that is wrong by no more moves the orientation
    /// by a pixel at most.
    fn default() -> Self {
        FindOptions {
            method: Method::Correlation,
            pixel_um: None,
            model: InteriorModel::Affine,
            turn_deg: None,
            mirrored: None,
            box_share: 0.10,
            agreement_um: 40.0,
            agreement_px: 1.5,
        }
    }
}

impl FindOptions {
    /// How far a mark may lie from where the others put it.
    pub(super) fn tolerance_px(&self, pose: &Pose) -> f64 {
        (self.agreement_um / 1e3 * pose.px_per_mm()).max(self.agreement_px)
    }
}

/// The search box grows by these factors while too few marks are found.
const GROWTH: [f64; 3] = [1.0, 2.0, 3.6];
/// Peaks kept per search box.
const PEAKS: usize = 10;
/// Another way of lying whose marks reach this share of the best correlation is as good: asymmetric marks lose more.
const AS_GOOD: f64 = 0.98;
/// And so is one whose marks lose less in the mean than so many standard deviations of that mean.
const BEYOND_SCATTER: f64 = 3.0;

/// A camera ready for work: its shapes drawn or read once for a whole roll.
#[derive(Clone, Debug)]
pub struct Finder {
    pub camera: Camera,
    pub(super) film: Vec<[f64; 2]>,
    pub(super) turns_deg: Vec<f64>,
    pub(super) centre: [f64; 2],
    /// For every mark, its shape; marks that look alike share one.
    pub(super) class: Vec<usize>,
    pub(super) models: Vec<Model>,
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

    pub(super) fn model(&self, mark: usize) -> &Model {
        &self.models[self.class[mark]]
    }

    /// Shape → scan of a mark under a pose, alike for all that look alike.
    pub(super) fn linear(&self, pose: &Pose, mark: usize) -> [f64; 4] {
        let linear = pose.shape_linear(self.turns_deg[mark]);
        if self.model(mark).is_alike_by_quarters() { upright(linear) } else { linear }
    }

    /// The marks and the interior orientation of one scan. Finding nothing is no error: the status says so.
    ///
    /// # Errors
    /// Those of reading the scan; [`Error::Usage`](autoref_raster::error::Error::Usage) when the method does not know
    /// the camera's marks.
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
            interior: None,
            notes: vec![],
            elapsed_s: 0.0,
        };
        if options.method == Method::Thesis2017 {
            self.find_as_in_2017(source, options, &mut result)?;
        } else {
            let empty = result.clone();
            result = self.look_in_both_tones(source, options, result)?;
            // To find the largest value all pixels are read: of frames only that are not OK without it.
            if !result.is_ok()
                && let Some(scan) = with_own_white(source)?
            {
                result = self.look_in_both_tones(&scan, options, empty)?;
                let white = scan.info().white;
                result.notes.push(format!("the scan's values end at {white} of 16 bits, which is taken for white"));
            }
        }
        result.elapsed_s = started.elapsed().as_secs_f64();
        Ok(result)
    }

    /// As the scan is, and where not all marks are seen with its tones reversed.
    fn look_in_both_tones(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        empty: FrameResult,
    ) -> Result<FrameResult> {
        let stated = Resolution::of_file(&source.info().path);
        let positive = self.look(source, options, stated, empty.clone())?;
        // Specks and letters make up frames in the wrong tones, though hardly of the right size.
        if positive.is_ok() && marks_seen(&positive) == self.film.len() {
            return Ok(positive);
        }
        let mut negative = self.look(&Negative(source), options, stated, empty)?;
        negative.notes.push("the marks are dark on bright: a negative".into());
        let (bright, dark) = (marks_seen(&positive), marks_seen(&negative));
        let reversed = match (positive.is_ok(), negative.is_ok()) {
            (true, false) => false,
            (false, true) => dark >= bright,
            _ => dark > bright,
        };
        Ok(if negative.interior.is_some() && dark > 2 && reversed { negative } else { positive })
    }

    /// As the scan is, bright marks on dark.
    fn look(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        stated: Option<Resolution>,
        mut result: FrameResult,
    ) -> Result<FrameResult> {
        if let Some(assembly) = self.assembly(source, options, stated)? {
            let way = self.remeasure(source, options, &assembly, &mut result)?;
            self.doubt_whole(options, stated, &assembly, &mut result);
            // That it lies otherwise than the camera's file says may be what is wrong with a frame.
            match &mut result.status {
                FrameStatus::Ok => result.notes.extend(way),
                FrameStatus::Doubtful { reasons } | FrameStatus::Failed { reasons } => reasons.extend(way),
            }
        } else {
            result.marks = self.camera.marks.iter().map(|m| missing(&m.name, None, "not found")).collect();
        }
        Ok(result)
    }

    /// Turns and mirrorings to try, the usual first.
    pub(super) fn orientations(&self, options: &FindOptions) -> Vec<(f64, Handedness)> {
        let turns = options.turn_deg.map_or(vec![0.0, 180.0, 90.0, 270.0], |t| vec![t]);
        let mirrors = options.mirrored.map_or(Handedness::BOTH.to_vec(), |m| vec![m]);
        mirrors.iter().flat_map(|m| turns.iter().map(move |t| (*t, *m))).collect()
    }

    /// In how many ways a frame that was found in one of them may lie, as far as options and camera's file do not say.
    /// Where marks do not tell, frames of an upright camera are taken as upright, so that those found so had one way.
    fn open_ways(&self, way: (f64, Handedness), options: &FindOptions) -> usize {
        if self.is_said_upright(way) { 1 } else { self.orientations(options).len() }
    }

    /// Possible sizes of a pixel, micrometres, the likeliest first.
    pub(super) fn pixel_sizes_um(&self, source: &dyn RasterSource, options: &FindOptions) -> Vec<f64> {
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

    /// Sizes of a pixel to try, each with how far the axes differ in scale: first what the file states.
    fn scales(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        stated: Option<Resolution>,
    ) -> Vec<(f64, Stretch)> {
        let sizes_um = self.pixel_sizes_um(source, options);
        let mut scales: Vec<(f64, Stretch)> = sizes_um.iter().map(|um| (*um, Stretch::NONE)).collect();
        let Some(resolution) = stated.filter(|_| options.pixel_um.is_none()) else { return scales };
        let (um, stretch) = (resolution.pixel_um(), resolution.stretch());
        let uneven = (SURE_STRETCH..MOST_STRETCH).contains(&stretch.0.abs());
        let new = uneven || sizes_um.iter().all(|s| (um / s).ln().abs() > 0.02);
        if new && (um / sizes_um[0]).ln().abs() < 0.3 {
            scales.insert(0, (um, if uneven { stretch } else { Stretch::NONE }));
        }
        scales
    }

    fn assembly(
        &self,
        source: &dyn RasterSource,
        options: &FindOptions,
        stated: Option<Resolution>,
    ) -> Result<Option<Assembly>> {
        let info = source.info();
        let middle = PixelPoint { x: 0.5 * info.width as f64, y: 0.5 * info.height as f64 };
        let wanted = self.film.len().min(3);
        let all_ways = self.orientations(options);
        let sizes = self.scales(source, options, stated);
        let mut best: Option<Assembly> = None;
        // Of all boxes.
        let mut ways: Vec<Lie> = vec![];
        let rank = |best: Option<Assembly>, ways: &[Lie]| best.map(|b| Assembly { rivals: rivals(&b, ways), ..b });
        for growth in GROWTH {
            for &(pixel_um, stretch) in &sizes {
                let half_px = 0.5 * options.box_share * growth * info.width.max(info.height) as f64;
                let (mut slots, mut sketches): (Vec<Slot>, _) = (vec![], Sketches::default());
                for &(turn_deg, mirrored) in &all_ways {
                    let even = Pose::about(self.centre, middle, 1e3 / pixel_um, turn_deg, mirrored);
                    let assumed = even.stretched(self.centre, stretch);
                    let peaks = (0..self.film.len())
                        .map(|k| self.slot(source, &mut slots, &mut sketches, k, &assumed, half_px))
                        .collect::<Result<Vec<_>>>()?;
                    let found = assemble(&self.film, &peaks, &assumed);
                    // A stated difference of scale is a prior: without it marks may agree better.
                    let even = if stretch == Stretch::NONE { None } else { assemble(&self.film, &peaks, &even) };
                    let found = even.filter(|e| found.as_ref().is_none_or(|f| e.score > f.score)).or(found);
                    let few = found.as_ref().is_none_or(|f| f.marks() < self.film.len());
                    let stretched = if few { assemble_stretched(&self.film, &peaks, &assumed) } else { None };
                    let more = |s: &Assembly| found.as_ref().is_none_or(|f| s.marks() > f.marks());
                    let Some(found) = stretched.filter(more).or(found) else { continue };
                    let mut chosen_only = keep_chosen(found, &peaks);
                    let open = self.open_ways((turn_deg, mirrored), options);
                    chosen_only.chance = chance(&chosen_only, &peaks, half_px, open, stretch);
                    ways.push(Lie::of((turn_deg, mirrored), &chosen_only, &peaks));
                    if best.as_ref().is_none_or(|b| chosen_only.score > b.score + 1e-9) {
                        best = Some(chosen_only);
                    }
                }
                if best.as_ref().is_some_and(|b| b.marks() == self.film.len()) {
                    return Ok(rank(best, &ways));
                }
            }
            if best.as_ref().is_some_and(|b| b.marks() >= wanted.max(self.film.len() - 1)) {
                break;
            }
        }
        Ok(rank(best, &ways))
    }

    /// The peaks of mark `k` under `assumed`, from a box searched before where shape and place are the same.
    fn slot<'a>(
        &'a self,
        source: &dyn RasterSource,
        slots: &mut Vec<Slot>,
        sketches: &mut Sketches<'a>,
        k: usize,
        assumed: &Pose,
        half_px: f64,
    ) -> Result<Vec<Peak>> {
        let centre = assumed.apply(self.film[k]);
        let linear = self.linear(assumed, k);
        let alike = |a: &[f64; 4], b: &[f64; 4]| {
            let unit = assumed.px_per_mm();
            let close = |i: usize, sign: f64| {
                (a[i] - sign * b[i]).abs() < 0.05 * unit && (a[i + 2] - sign * b[i + 2]).abs() < 0.05 * unit
            };
            let model = self.model(k);
            // Lines at no multiple of 45° lie otherwise in a mirror.
            let mirrored = model.is_symmetric() && model.sectors_deg().is_none_or(|deg| deg.rem_euclid(45.0) == 0.0);
            let right = close(0, 1.0) || (mirrored && close(0, -1.0));
            // Mirrored, a shape that quarters of a turn do not change lies as if turned over either way.
            let inward = close(1, 1.0) || (mirrored && model.is_alike_by_quarters() && close(1, -1.0));
            right && inward
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
            Some(window) => search(source, window, &sketches.of(self.model(k), linear).picture, PEAKS)?,
            None => vec![],
        };
        slots.push(Slot { class: self.class[k], linear, centre, half_px, peaks: peaks.clone() });
        Ok(peaks)
    }
}

/// Marks that look like the camera's.
fn marks_seen(frame: &FrameResult) -> usize {
    let seen =
        |m: &&MarkFind| m.status == MarkStatus::Ok || m.centre.is_some() && m.score.is_some_and(|s| s >= GOOD_SCORE);
    frame.marks.iter().filter(seen).count()
}

pub(super) fn missing(name: &str, predicted: Option<PixelPoint>, reason: &str) -> MarkFind {
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

/// Leaves only the chosen peaks' agreement in the score: what counts between orientations is also how well they fit.
fn keep_chosen(mut assembly: Assembly, peaks: &[Vec<Peak>]) -> Assembly {
    assembly.score = assembly.chosen.iter().enumerate().filter_map(|(k, c)| Some(peaks[k][(*c)?].score)).sum();
    assembly
}

/// A way in which the frame may lie, and how well it fits.
struct Lie {
    way: (f64, Handedness),
    /// The correlation of each mark; `None` of those that were not found.
    scores: Vec<Option<f64>>,
    score: f64,
}

impl Lie {
    fn of(way: (f64, Handedness), assembly: &Assembly, peaks: &[Vec<Peak>]) -> Lie {
        let scores = assembly.chosen.iter().enumerate().map(|(k, c)| Some(peaks[k][(*c)?].score)).collect();
        Lie { way, scores, score: assembly.score }
    }

    fn marks(&self) -> usize {
        self.scores.iter().flatten().count()
    }

    /// Whether the marks look so much better than in another way of lying that it is not by chance: coarse correlations
    /// of one mark scatter by a tenth, and where marks do not look otherwise when turned, by that alone.
    fn is_told_from(&self, other: &Lie) -> bool {
        let falls: Vec<f64> = self.scores.iter().zip(&other.scores).filter_map(|(a, b)| Some((*a)? - (*b)?)).collect();
        let n = falls.len() as f64;
        let mean = falls.iter().sum::<f64>() / n;
        let variance = falls.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0);
        other.score < AS_GOOD * self.score && mean > BEYOND_SCATTER * (variance / n).sqrt()
    }
}

/// The ways in which the frame may lie that fit as well as the assembly taken, as far as correlations tell, its own
/// first.
fn rivals(best: &Assembly, ways: &[Lie]) -> Vec<(f64, Handedness)> {
    let mut all: Vec<&Lie> = ways.iter().filter(|w| w.marks() == best.marks()).collect();
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let Some(first) = all.first().copied() else { return vec![] };
    let mut rivals: Vec<(f64, Handedness)> = vec![];
    for lie in all.into_iter().filter(|lie| !first.is_told_from(lie)) {
        if !rivals.contains(&lie.way) {
            rivals.push(lie.way);
        }
    }
    rivals
}

/// Opens and examines one scan; what goes wrong with it becomes its status.
pub fn find_frame(finder: &Finder, path: &Path, options: &FindOptions) -> FrameResult {
    let _span = tracing::info_span!("frame").entered();
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
            interior: None,
            notes: vec![],
            elapsed_s: started.elapsed().as_secs_f64(),
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lie(turn_deg: f64, scores: [f64; 4]) -> Lie {
        Lie { way: (turn_deg, Handedness::AsIs), scores: scores.map(Some).to_vec(), score: scores.iter().sum() }
    }

    #[test]
    fn frames_of_an_upright_camera_have_one_way_to_lie_where_they_are_found_so() {
        let mut camera = crate::camera::load_camera("rmk-dot").expect("built in");
        let open = |camera: &Camera, turn_deg: f64| {
            let finder = Finder::new(camera).expect("a finder");
            finder.open_ways((turn_deg, Handedness::AsIs), &FindOptions::default())
        };
        camera.upright = false;
        assert_eq!(open(&camera, 0.0), 8);
        camera.upright = true;
        assert_eq!([open(&camera, 0.0), open(&camera, 90.0)], [1, 8]);
    }

    #[test]
    fn what_the_file_says_of_the_axes_is_tried_first() {
        let camera = crate::camera::load_camera("rmk-dot").expect("built in");
        let finder = Finder::new(&camera).expect("a finder");
        let scan = crate::window::GreySource::new(Path::new("a.tif"), 100, 100, vec![0; 10_000]);
        let um = finder.pixel_sizes_um(&scan, &FindOptions::default())[0];
        let first = |x: f64, y: f64| {
            finder.scales(&scan, &FindOptions::default(), Some(Resolution([x * 25_400.0 / um, y * 25_400.0 / um])))[0]
        };
        assert!((first(1.0, 0.98).1.0 - (1.0f64 / 0.98).ln()).abs() < 1e-12);
        assert_eq!(first(1.0, 1.0), (um, Stretch::NONE));
        assert_eq!(first(1.0, 0.7).1, Stretch::NONE, "more than scanners differ by");
    }

    /// Marks that look the same when turned differ by what the coarse grid makes of them; those that do not, all do.
    #[test]
    fn a_way_of_lying_is_told_by_all_marks_not_by_the_scatter_of_some() {
        let right = lie(0.0, [0.93, 0.95, 0.91, 0.96]);
        let turned_rings = lie(90.0, [0.76, 0.96, 0.93, 0.94]);
        assert!(turned_rings.score < AS_GOOD * right.score && !right.is_told_from(&turned_rings));
        assert!(right.is_told_from(&lie(90.0, [0.61, 0.74, 0.66, 0.70])));
        assert!(!right.is_told_from(&lie(90.0, [0.92, 0.94, 0.90, 0.95])), "by all marks, but by next to nothing");
    }
}
