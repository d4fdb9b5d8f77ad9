//! What is taught once for all frames of a run: samples and lessons become the classifier.

use std::path::{Path, PathBuf};

use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::size_and_time;

use crate::classify::Classifier;
use crate::contradiction::check_sides;
use crate::given::Given;
use crate::knn::Neighbours;
use crate::model::{self, Labels};
use crate::options::{Method, Options};
use crate::reduce::Reduced;
use crate::shapes::Shape;

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
/// When a frame or mask cannot be read, a sample lies outside its frame, a class has no samples, or the same pixels are
/// taught both ways.
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
        check_sides(&path, &reduced, &shapes, mask.map(|mask| (mask, &labels)))?;
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
