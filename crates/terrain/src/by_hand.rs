//! What a person said of a frame, laid over the classifier's mask: at the reduced scale for shares and outlines, to the
//! pixel for the masks that are written.

use std::path::Path;

use autoref_raster::error::{Error, Result};
use autoref_raster::protected::same_file;
use gdal::Dataset;
use gdal::raster::ResampleAlg;

use crate::bits::{Bit, BitMask};
use crate::classify::Classes;
use crate::fill::Fill;
use crate::given::Given;
use crate::labelled::LabelledMask;
use crate::reduce::Reduced;
use crate::shapes::{Meaning, SAYS_NOTHING, Shape};

/// One word of a person, over all that lies before it.
enum Layer<'a> {
    /// Shapes with what each says; later ones win among themselves.
    Shapes(Vec<(&'a Shape, u8)>),
    /// A raster of the frame's size; its pixels of this meaning count.
    Raster(&'a Path, Meaning),
}

/// What was marked as keep, global masks, and what was mended, in this order.
fn layers<'a>(frame: &Path, given: &'a Given) -> Vec<Layer<'a>> {
    let of = |shapes: &'a [Shape]| -> Vec<(&'a Shape, u8)> {
        shapes.iter().filter(|shape| shape.is_of(frame)).map(|shape| (shape, shape.meaning.label())).collect()
    };
    // A sample that names no frame is of the only frame there is. In a list of polygons a lake may be drawn on its
    // shore: there the classifier decides, taught that it is something to mask.
    let samples = of(&given.samples);
    let (keep, mask) = (Meaning::Keep.label(), Meaning::Mask.label());
    let counts = |label: u8, is_listed: bool| label == keep || (label == mask && is_listed);
    let mut layers: Vec<Layer> = Vec::new();
    for one_list in samples.chunk_by(|(a, _), (b, _)| a.file == b.file) {
        let shapes = one_list.iter().filter(|(shape, label)| counts(*label, shape.file.is_some()));
        let label = |label: u8| if label == keep { keep } else { SAYS_NOTHING };
        let shapes: Vec<(&Shape, u8)> = shapes.map(|(shape, said)| (*shape, label(*said))).collect();
        if shapes.iter().any(|(_, label)| *label == keep) {
            layers.push(Layer::Shapes(shapes));
        }
    }
    let lessons = given.lessons.iter().filter(|lesson| same_file(&lesson.frame, frame));
    layers.extend(lessons.map(|lesson| Layer::Raster(&lesson.mask, Meaning::Keep)));
    layers.push(Layer::Shapes(of(&given.global)));
    layers.extend(given.global_mask.as_deref().map(|path| Layer::Raster(path, Meaning::Mask)));
    layers.push(Layer::Shapes(of(&given.mended)));
    layers.retain(|layer| !matches!(layer, Layer::Shapes(shapes) if shapes.is_empty()));
    layers
}

/// Does anything of `given` speak of `frame`?
pub fn speaks_of(frame: &Path, given: &Given) -> bool {
    !layers(frame, given).is_empty()
}

/// What is said of `frame` and lies beside it: nothing comes of it.
pub fn beside<'a>(frame: &Path, width: u64, height: u64, given: &'a Given) -> Vec<String> {
    let of = |option: &'static str, shapes: &'a [Shape]| shapes.iter().map(move |shape| (option, shape));
    let shapes = of("--global", &given.global).chain(of("--mend", &given.mended));
    let lost = shapes.filter(|(_, shape)| {
        let [left, top, right, bottom] = shape.bounds();
        let meets = left < width as f64 && top < height as f64 && right > 0.0 && bottom > 0.0;
        shape.is_of(frame) && !meets
    });
    let told = |(option, shape): (&str, &Shape)| {
        format!("{option}: {} lies outside the frame of {width} × {height} px", shape.place)
    };
    lost.map(told).collect()
}

/// Lays what a person said over `classes`, at the reduced scale.
///
/// # Errors
/// When a mask cannot be read, or has another size than the frame or other values than 0, 1 and 255.
pub fn lay_over(frame: &Path, reduced: &Reduced, given: &Given, classes: &mut Classes) -> Result<()> {
    let (width, height) = (reduced.grey.width(), reduced.grey.height());
    let mut row = vec![SAYS_NOTHING; width];
    for layer in layers(frame, given) {
        match layer {
            Layer::Shapes(shapes) => {
                let mut fills: Vec<(u8, Fill)> =
                    shapes.iter().map(|(shape, label)| (*label, Fill::new(shape, reduced.factor))).collect();
                for y in 0..height {
                    fill_labels(&mut fills, y, &mut row);
                    for (x, &label) in row.iter().enumerate().filter(|(_, label)| **label != SAYS_NOTHING) {
                        classes.keep.set(x, y, label == 1);
                        leave_to_the_person(classes, x, y);
                    }
                }
            }
            Layer::Raster(path, meaning) => {
                let labelled = LabelledMask::open(path, reduced)?;
                labelled.each_row(reduced, |y, labels| {
                    for (x, _) in labels.iter().enumerate().filter(|(_, label)| **label == meaning.label()) {
                        classes.keep.set(x, y, meaning == Meaning::Keep);
                        leave_to_the_person(classes, x, y);
                    }
                })?;
            }
        }
    }
    classes.keep.and(&reduced.valid);
    if let (Some(seen), Some(decided)) = (&mut classes.seen, &classes.decided) {
        seen.retain(decided);
    }
    Ok(())
}

/// The classifier does not decide a pixel of which a person spoke.
fn leave_to_the_person(classes: &mut Classes, x: usize, y: usize) {
    for mask in [&mut classes.unsure, &mut classes.decided].into_iter().flatten() {
        mask.set(x, y, false);
    }
}

/// The labels of a row; later shapes win.
fn fill_labels(fills: &mut [(u8, Fill)], y: usize, row: &mut [u8]) {
    row.fill(SAYS_NOTHING);
    for (label, fill) in fills {
        fill.row(y, row.len(), |start, end| row[start..end].fill(*label));
    }
}

/// A mask at the frame's size: the classifier's cells, and what a person said to the pixel.
pub struct FullMask<'a> {
    pub cells: &'a BitMask,
    /// Cells that hold anything.
    pub valid: &'a BitMask,
    /// Width and height of the frame, px.
    pub size: [usize; 2],
    /// Pixels of the frame that a cell stands for, along a side.
    pub factor: usize,
    layers: Vec<Layer<'a>>,
}

/// A [`Layer`] while rows are taken from it.
enum Open<'a> {
    Shapes(Vec<(u8, Fill)>),
    Raster(&'a Path, Box<Dataset>, u8),
}

impl<'a> FullMask<'a> {
    /// The mask of `cells`, the classifier's, with what `given` says of `frame`.
    pub fn new(frame: &Path, cells: &'a BitMask, reduced: &'a Reduced, given: &'a Given) -> FullMask<'a> {
        FullMask {
            cells,
            valid: &reduced.valid,
            size: [reduced.width as usize, reduced.height as usize],
            factor: reduced.factor,
            layers: layers(frame, given),
        }
    }

    /// Rows of the mask from the top, 1 = keep.
    ///
    /// # Errors
    /// When a mask that a person gave cannot be opened.
    pub fn rows(&self) -> Result<FullRows<'_>> {
        let open = |layer: &Layer<'a>| -> Result<Open<'a>> {
            Ok(match layer {
                Layer::Shapes(shapes) => {
                    Open::Shapes(shapes.iter().map(|(shape, label)| (*label, Fill::new(shape, 1))).collect())
                }
                Layer::Raster(path, meaning) => {
                    let (_, dataset) = autoref_raster::open_dataset(path, 0)?;
                    Open::Raster(path, Box::new(dataset), meaning.label())
                }
            })
        };
        let open = self.layers.iter().map(open).collect::<Result<_>>()?;
        Ok(FullRows { mask: self, open, labels: vec![SAYS_NOTHING; self.size[0]] })
    }
}

/// Rows of a [`FullMask`].
pub struct FullRows<'a> {
    mask: &'a FullMask<'a>,
    open: Vec<Open<'a>>,
    labels: Vec<u8>,
}

impl FullRows<'_> {
    /// Writes row `y` into `line`, 1 = keep. Rows are asked for from the top.
    ///
    /// # Errors
    /// When a mask that a person gave cannot be read.
    ///
    /// # Panics
    /// When `line` is not as wide as the frame.
    pub fn row(&mut self, y: usize, line: &mut [u8]) -> Result<()> {
        let FullMask { cells, valid, factor, .. } = *self.mask;
        let width = line.len();
        assert_eq!(width, self.mask.size[0], "a row of the frame");
        line.fill(0);
        let pixels = |start: usize, end: usize| start * factor..(end * factor).min(width);
        cells.runs(y / factor, Bit::Set, |start, end| line[pixels(start, end)].fill(1));
        for layer in &mut self.open {
            match layer {
                Open::Shapes(fills) => {
                    fill_labels(fills, y, &mut self.labels);
                    line.iter_mut()
                        .zip(&self.labels)
                        .filter(|(_, label)| **label != SAYS_NOTHING)
                        .for_each(|(value, label)| *value = *label);
                }
                Open::Raster(path, dataset, label) => {
                    let failed = |e| Error::gdal(*path, e);
                    let band = dataset.rasterband(1).map_err(failed)?;
                    let row = band
                        .read_as::<f64>((0, y as isize), (width, 1), (width, 1), None::<ResampleAlg>)
                        .map_err(failed)?;
                    let counts = f64::from(*label);
                    line.iter_mut()
                        .zip(row.data())
                        .filter(|(_, given)| **given == counts)
                        .for_each(|(value, _)| *value = *label);
                }
            }
        }
        valid.runs(y / factor, Bit::Clear, |start, end| line[pixels(start, end)].fill(0));
        Ok(())
    }
}
