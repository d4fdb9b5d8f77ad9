//! Frames one after another: what is taught once, a mask and a report for each, and what is done already is left alone.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use autoref_raster::atomic::Transaction;
use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::size_and_time;
use autoref_raster::memory_plan::cache_share_bytes;
use autoref_raster::{RasterSource, ReaderChoice};
use serde::Serialize;

use crate::bits::BitMask;
use crate::by_hand::{self, FullMask};
use crate::classify::{Classes, Classifier, Cleaner, classify};
use crate::clean::Cleaning;
use crate::knn::Neighbours;
use crate::light::Correction;
use crate::model::{self, Labels};
use crate::reduce::{Reading, Reduced, plane_memory, reduce_frame};
use crate::resume::{self, Names};
use crate::shapes::{Lesson, Shape};
use crate::unlike::UNLIKE_SHARE;
use crate::write::{self, MaskCompression};

/// How the ground is told from the rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    Thesis2017,
    Threshold,
    Auto,
}

/// What is written beside the mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Extras {
    /// `NAME_Prob.tif`, 8 bit.
    pub probability: bool,
    /// `NAME_Class.tif`, `NAME_Entropy.tif`, `NAME_Distance.tif`.
    pub explain: bool,
    /// `NAME.EXT.png`, as COLMAP names masks.
    pub colmap: bool,
}

/// Options of a run.
#[derive(Clone, Debug)]
pub struct Options {
    pub method: Method,
    /// Reduction; 0: 4, and for `auto` 1 below 1,500 px, 2 below 3,000 px.
    pub reduce: usize,
    pub neighbours: usize,
    /// Entropy, bit, above which `threshold` keeps.
    pub threshold_bit: f64,
    pub cleaning: Cleaning,
    /// Least share of the image of an area of `auto`.
    pub auto_area_share: f64,
    pub compression: MaskCompression,
    pub extras: Extras,
    /// Corrections of bands and light, one after another, on the reduced frame.
    pub corrections: Vec<Correction>,
    pub tile_px: u64,
    pub memory_budget_bytes: u64,
    pub reader: ReaderChoice,
    pub overwrite: bool,
    pub resume: bool,
}

/// What a person gave.
#[derive(Clone, Debug, Default)]
pub struct Given {
    /// What is taught, and kept whatever the classifier says.
    pub samples: Vec<Shape>,
    pub lessons: Vec<Lesson>,
    /// Joined to every frame's mask: fiducials, text boxes, the film's border.
    pub global: Vec<Shape>,
    /// A global mask of the frames' size, 1 = use.
    pub global_mask: Option<PathBuf>,
    /// Corrections by hand; they have the last word.
    pub mended: Vec<Shape>,
}

/// What became of a frame.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub frame: PathBuf,
    pub status: &'static str,
    pub width: u64,
    pub height: u64,
    pub keep_share: f64,
    pub classes: Shares,
    pub unsure_share: f64,
    /// Share of the frame that is far from all that was taught (`auto`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unlike_share: Option<f64>,
    pub warnings: Vec<String>,
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub mask: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    #[serde(serialize_with = "autoref_raster::path_text::some")]
    pub probability: Option<PathBuf>,
    pub method: &'static str,
    pub reduce: usize,
    /// Names of the files that were written, in the folder of the masks.
    pub outputs: Vec<String>,
    /// What they hold, but for this report: fingerprints by name.
    pub contents: BTreeMap<String, String>,
    pub fingerprint: String,
}

/// Shares of the frame's pixels.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Shares {
    pub keep: f64,
    pub mask: f64,
    /// Pixels that hold nothing; they are masked.
    pub empty: f64,
}

/// A frame's result with what a picture of it needs.
pub struct Done {
    pub report: Report,
    /// The frame and its mask at the reduced scale; `None` when the frame was done before.
    pub picture: Option<(Reduced, BitMask)>,
}

impl Method {
    pub fn name(self) -> &'static str {
        match self {
            Method::Thesis2017 => "thesis-2017",
            Method::Threshold => "threshold",
            Method::Auto => "auto",
        }
    }
}

impl Options {
    fn open(&self, path: &Path) -> Result<Arc<dyn RasterSource>> {
        // A frame is read once; only a margin of two pixels is decoded again.
        let source = autoref_raster::open(path, self.reader, 0, cache_share_bytes(self.memory_budget_bytes) / 2)?;
        if source.info().width == 0 || source.info().height == 0 {
            return Err(Error::format(path, "header", "the frame has no pixels"));
        }
        Ok(source)
    }

    fn factor(&self, width: u64, height: u64) -> usize {
        match (self.reduce, self.method, width.max(height)) {
            (0, Method::Auto, 0..1500) => 1,
            (0, Method::Auto, 1500..3000) => 2,
            (0, ..) => 4,
            (factor, ..) => factor,
        }
    }

    fn reading(&self, source: &dyn RasterSource) -> Reading {
        let factor = self.factor(source.info().width, source.info().height);
        Reading {
            factor,
            smooth: factor > 1 || self.method != Method::Auto,
            tile_px: self.tile_px,
            memory_budget_bytes: self.memory_budget_bytes,
            masks_beside: 0,
        }
    }

    /// The frame at the reduced scale, its light corrected.
    fn reduced(&self, source: &Arc<dyn RasterSource>, reading: &Reading) -> Result<Reduced> {
        let mut reduced = reduce_frame(source, reading)?;
        self.corrections.iter().try_for_each(|c| (c.change)(source.as_ref(), &mut reduced))?;
        Ok(reduced)
    }
}

/// What a run has been taught.
pub struct Taught {
    pub classifier: Classifier,
    /// Changes when a frame or a mask that teaches changes.
    pub(crate) mark: String,
}

/// A frame that something is taught from.
struct TeachingFrame {
    path: PathBuf,
    reduced: Reduced,
    labels: Labels,
}

/// Where the frame that a shape names is: among the frames of the run, or a file.
fn frame_of(shape: &Shape, frames: &[PathBuf]) -> Result<PathBuf> {
    let known: Vec<&PathBuf> = frames.iter().filter(|frame| shape.is_of(frame)).collect();
    match (&shape.frame, &known[..]) {
        (_, [one]) => Ok((*one).clone()),
        (None, _) => Err(Error::usage(
            format!("the sample {} names no frame, and there are {} frames", shape.place, frames.len()),
            "add @FRAME",
        )),
        (Some(name), []) if Path::new(name).is_file() => Ok(name.into()),
        (Some(name), []) => {
            Err(Error::usage(format!("the sample {}: there is no frame {name}", shape.place), "give its path after @"))
        }
        (Some(name), _) => Err(Error::usage(
            format!("the sample {}: {} frames are called {name}", shape.place, known.len()),
            "give its path after @",
        )),
    }
}

/// Reads what is taught and makes the classifier of it.
///
/// # Errors
/// When a frame or mask cannot be read, a sample lies outside its frame, or a class has no samples.
pub fn teach(frames: &[PathBuf], given: &Given, options: &Options) -> Result<Taught> {
    let _span = tracing::info_span!("teach").entered();
    let mut by_frame: Vec<(PathBuf, Vec<&Shape>, Option<&Path>)> = Vec::new();
    let entry = |path: &Path, list: &mut Vec<(PathBuf, Vec<&Shape>, Option<&Path>)>| -> usize {
        list.iter().position(|(known, ..)| known == path).unwrap_or_else(|| {
            list.push((path.to_path_buf(), Vec::new(), None));
            list.len() - 1
        })
    };
    for shape in &given.samples {
        let path = frame_of(shape, frames)?;
        let at = entry(&path, &mut by_frame);
        by_frame[at].1.push(shape);
    }
    for lesson in &given.lessons {
        let at = entry(&lesson.frame, &mut by_frame);
        if by_frame[at].2.replace(&lesson.mask).is_some() {
            return Err(Error::usage(
                format!("{}: two teaching masks are given", lesson.frame.display()),
                "give one --teach a frame",
            ));
        }
    }
    let marks = by_frame.iter().flat_map(|(frame, _, mask)| [Some(frame.as_path()), *mask]);
    let mark = marks.flatten().map(size_and_time).collect::<Vec<_>>().join(" ");
    let classifier = learn(by_frame, options)?;
    Ok(Taught { classifier, mark })
}

/// Makes the classifier of what teaches, frame by frame: samples, and a mask.
fn learn(by_frame: Vec<(PathBuf, Vec<&Shape>, Option<&Path>)>, options: &Options) -> Result<Classifier> {
    if options.method == Method::Threshold {
        return Ok(Classifier::Threshold(options.threshold_bit));
    }
    let mut taught = Vec::new();
    let mut samples = Vec::new();
    for (path, shapes, mask) in by_frame {
        let source = options.open(&path)?;
        let info = source.info();
        shapes.iter().try_for_each(|shape| shape.check_inside(&path, info.width, info.height))?;
        let reduced = options.reduced(&source, &options.reading(source.as_ref()))?;
        let mut labels = Labels::new(&reduced);
        if let Some(mask) = mask {
            labels.read_mask(mask, &reduced)?;
        }
        if options.method == Method::Thesis2017 {
            samples.extend(model::thesis_samples(&reduced, &shapes)?);
            samples.extend(model::labelled_samples(&reduced, &labels)?);
        } else {
            for shape in shapes {
                if labels.paint(shape, reduced.factor) == 0 {
                    return Err(Error::usage(
                        format!("{}: the sample {} holds no pixel's centre", path.display(), shape.place),
                        format!("make it larger; a pixel of the analysis is {0} × {0} px", reduced.factor),
                    ));
                }
            }
            taught.push(TeachingFrame { path, reduced, labels });
        }
    }
    if options.method == Method::Thesis2017 {
        if samples.is_empty() {
            samples = model::shipped_samples();
        }
        for (keep, name) in [(true, "keep"), (false, "mask")] {
            if !samples.iter().any(|sample| sample.keep == keep) {
                return Err(Error::usage(
                    format!("no sample of a class to {name} was given"),
                    "the nearest neighbours need both: add --sample keep=X,Y,W,H@FRAME or mask=X,Y,W,H@FRAME",
                ));
            }
        }
        let neighbours = Neighbours::new(samples, options.neighbours)
            .map_err(|e| Error::usage(e.to_string(), "give more samples or another --k"))?;
        return Ok(Classifier::Neighbours(neighbours));
    }
    for one in &taught {
        tracing::info!("taught by {}", one.path.display());
    }
    let pairs: Vec<(&Reduced, &Labels)> = taught.iter().map(|one| (&one.reduced, &one.labels)).collect();
    Ok(Classifier::Forest(Box::new(model::learn(&pairs)?)))
}

/// Makes the mask of one frame.
///
/// # Errors
/// When the frame cannot be read or an output cannot be written; nothing is left half-written.
pub fn mask_frame(frame: &Path, folder: &Path, taught: &Taught, given: &Given, options: &Options) -> Result<Done> {
    guarded(frame, || make_mask(frame, folder, taught, given, options))
}

/// A fault of ours in one frame is that frame's error: the others of a batch have their masks.
fn guarded<R>(frame: &Path, work: impl FnOnce() -> Result<R>) -> Result<R> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).unwrap_or_else(|fault| {
        let text = fault.downcast_ref::<String>().map(String::as_str);
        let text = text.or(fault.downcast_ref::<&str>().copied()).unwrap_or("no reason is given");
        Err(Error::format(frame, "frame", format!("a fault of this program, please report it: {text}")))
    })
}

fn make_mask(frame: &Path, folder: &Path, taught: &Taught, given: &Given, options: &Options) -> Result<Done> {
    let _span = tracing::info_span!("frame").entered();
    let classifier = &taught.classifier;
    let names = Names::of(frame, folder);
    let fingerprint = resume::fingerprint(frame, taught, given, options);
    let earlier = resume::earlier(&names);
    if options.resume
        && let Some(earlier) = earlier.as_ref().filter(|earlier| earlier.is_whole(&names, &fingerprint))
    {
        return Ok(Done { report: earlier.report(&names), picture: None });
    }
    // With --resume, what is there belongs to a frame that has changed, or to a run that was stopped.
    autoref_raster::atomic::check_outputs(
        &[&names.mask, &names.xml],
        autoref_raster::atomic::Existing::of_flag(options.overwrite || options.resume),
    )?;
    let source = options.open(frame)?;
    let masks_beside = u64::from(by_hand::speaks_of(frame, given)) + 2 * u64::from(options.extras.explain);
    let reading = Reading { masks_beside, ..options.reading(source.as_ref()) };
    let reduced = options.reduced(&source, &reading)?;
    let cleaner = match options.method {
        Method::Auto => Cleaner::Areas(options.auto_area_share),
        _ => Cleaner::Thesis(options.cleaning.clone()),
    };
    let memory = plane_memory(&reading);
    let mut classes = classify(&reduced, classifier, &cleaner, memory)?;
    let told_apart = by_hand::speaks_of(frame, given).then(|| classes.keep.clone());
    by_hand::lay_over(frame, &reduced, given, &mut classes)?;
    if !options.extras.probability {
        classes.probability = None;
    }
    let mut report = report(frame, &names, &reduced, &classes, options, fingerprint);
    report.warnings.extend(by_hand::beside(frame, reduced.width, reduced.height, given));
    // Its share is told; a mask less while the outlines are traced.
    classes.unsure = None;
    let full = FullMask::new(frame, told_apart.as_ref().unwrap_or(&classes.keep), &reduced, given);
    let mut transaction = Transaction::new();
    let size = [reduced.width as usize, reduced.height as usize];
    transaction.stage(&names.mask, |path| write::mask(path, &full, options.compression))?;
    let mask_name = names.mask.file_name().unwrap_or_default().to_string_lossy();
    transaction.stage_bytes(&names.xml, write::micmac_xml(&mask_name, size).as_bytes())?;
    let name = frame.file_name().unwrap_or_default().to_string_lossy();
    let outlines = crate::outline::polygons(&classes.keep, size, reduced.factor, &name);
    transaction.stage_bytes(&names.outlines, outlines.as_bytes())?;
    drop(outlines);
    if let Some(plane) = &classes.probability {
        transaction.stage(&names.probability, |path| write::grey_plane(path, size, reduced.factor, plane))?;
    }
    if options.extras.colmap {
        transaction.stage(&names.colmap, |path| write::colmap(path, &full))?;
    }
    if options.extras.explain {
        crate::explain::stage(&mut transaction, &names, &reduced, classifier, memory)?;
    }
    report.contents =
        transaction.fingerprints()?.into_iter().map(|(path, hex)| (resume::name_of(&path), hex)).collect();
    let json = serde_json::to_string_pretty(&report).expect("a report is plain data");
    transaction.stage_bytes(&names.report, json.as_bytes())?;
    transaction.commit()?;
    if let Some(earlier) = earlier {
        earlier.remove_what_is_stale(&names, &report)?;
    }
    Ok(Done { report, picture: Some((reduced, classes.keep)) })
}

fn report(
    frame: &Path,
    names: &Names,
    reduced: &Reduced,
    classes: &Classes,
    options: &Options,
    fingerprint: String,
) -> Report {
    let (keep, unsure) = (classes.keep.share(), classes.unsure.as_ref().map_or(0.0, BitMask::share));
    let empty = 1.0 - reduced.valid.share();
    let mut warnings = Vec::new();
    if keep < 0.02 {
        warnings.push("almost everything is masked".to_string());
    } else if keep > 0.995 {
        warnings.push("almost nothing is masked".to_string());
    }
    if unsure > 0.15 {
        warnings.push(format!("unsure about {:.0} % of the frame; teach it with --sample or --teach", 100.0 * unsure));
    }
    if let Some(unlike) = classes.unlike.filter(|share| *share > UNLIKE_SHARE) {
        warnings.push(format!(
            "this frame is unlike all teaching frames: {:.0} % of it look like nothing that was taught; teach one of its flight \
             with --teach",
            100.0 * unlike
        ));
    }
    if let Some(share) = classes.kept_though_even.filter(|share| *share > EVEN_SHARE) {
        warnings.push(format!(
            "an even area along the upper border is kept, {:.0} % of the frame: if it is sky, teach it with --sample or \
             --teach",
            100.0 * share
        ));
    }
    if let Some(row) = horizon(&classes.keep) {
        warnings.push(format!("horizon found: nothing is kept above row {}", row * reduced.factor));
    }
    Report {
        frame: frame.into(),
        status: "done",
        width: reduced.width,
        height: reduced.height,
        keep_share: keep,
        classes: Shares { keep, mask: (1.0 - keep - empty).max(0.0), empty },
        unsure_share: unsure,
        unlike_share: classes.unlike,
        warnings,
        mask: names.mask.clone(),
        probability: classes.probability.as_ref().map(|_| names.probability.clone()),
        method: options.method.name(),
        reduce: reduced.factor,
        outputs: names.written(options, classes.probability.is_some()),
        contents: BTreeMap::new(),
        fingerprint,
    }
}

/// Kept in an even area along the upper border: a greater share of the frame is warned of.
const EVEN_SHARE: f64 = 0.1;

/// The first row with ground, when at least a twentieth of the rows above hold none and most columns begin so. Ground
/// under a sky reaches both sides of the frame; a margin all around does not let it.
fn horizon(keep: &BitMask) -> Option<usize> {
    let count = |y: usize| -> u32 { keep.row(y).iter().map(|word| word.count_ones()).sum() };
    let first = (0..keep.height()).find(|&y| count(y) > 0)?;
    let below: u64 = (first..keep.height()).map(|y| u64::from(count(y))).sum();
    let ground = below as f64 / (keep.width() * (keep.height() - first)) as f64;
    let margin = keep.width() / 50;
    let reaches =
        |columns: std::ops::Range<usize>| (first..keep.height()).any(|y| columns.clone().any(|x| keep.get(x, y)));
    let sides = reaches(0..margin + 1) && reaches(keep.width() - margin - 1..keep.width());
    (first * 20 >= keep.height() && ground > 0.2 && sides).then_some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_in_one_frame_is_its_error() {
        let none: Vec<u8> = Vec::new();
        let found = guarded(Path::new("a.tif"), || Ok(none[3]));
        let said = found.expect_err("nothing is there").to_string();
        assert!(said.contains("a.tif") && said.contains("index"), "{said}");
        assert!(guarded(Path::new("a.tif"), || Ok(7)).is_ok_and(|seven| seven == 7));
    }
}
