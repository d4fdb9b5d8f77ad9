//! What is taught, and the classifiers that come of it.

use std::path::Path;

use autoref_raster::error::{Error, Result};
use autoref_raster::window::{TileGrid, Window};
use rayon::prelude::*;

use crate::classify::Learned;
use crate::entropy::{RADIUS_PX, entropy};
use crate::features::{FEATURES, PLANES};
use crate::fill::Fill;
use crate::forest::{Example, Forest, Growth};
use crate::frame_scale::{CORE_PX, frame_scale, measured};
use crate::knn::Sample;
use crate::labelled::LabelledMask;
use crate::reduce::Reduced;
use crate::shapes::{Meaning, SAYS_NOTHING, Shape};
use crate::unlike::Known;

/// Features and class of pixels of licensed photographs: [`FEATURES`] bytes, one of 0 (mask) or 1 (keep) and the number
/// of the frame in `teaching/frames.csv` each. `examples/ship.rs` writes it.
static SHIPPED: &[u8] = include_bytes!("shipped.bin");

/// Bytes of a shipped example.
pub const SHIPPED_ROW: usize = FEATURES + 2;

/// The examples that come with the program, with the number of their frame.
pub fn shipped_by_frame() -> Vec<(u8, Example<FEATURES>)> {
    let example = |bytes: &[u8]| {
        let mut features = [0; FEATURES];
        features.copy_from_slice(&bytes[..FEATURES]);
        (bytes[FEATURES + 1], Example { features, keep: bytes[FEATURES] == 1, weight: 1 })
    };
    SHIPPED.chunks_exact(SHIPPED_ROW).map(example).collect()
}

/// The examples that come with the program.
pub fn shipped() -> Vec<Example<FEATURES>> {
    shipped_by_frame().into_iter().map(|(_, example)| example).collect()
}

/// Frames that give the thesis's chain its samples: further ones for the forest do not change its masks.
const SAMPLED_FRAMES: std::ops::RangeInclusive<u8> = 1..=11;

/// Entropy and intensity of shipped examples, 250 of each class, drawn by a fixed stride.
pub fn shipped_samples() -> Vec<Sample> {
    let all: Vec<Example<FEATURES>> = shipped_by_frame()
        .into_iter()
        .filter(|(frame, _)| SAMPLED_FRAMES.contains(frame))
        .map(|(_, example)| example)
        .collect();
    let of = |keep: bool| {
        let class: Vec<_> = all.iter().filter(|example| example.keep == keep).collect();
        let stride = (class.len() / 250).max(1);
        class
            .into_iter()
            .step_by(stride)
            .take(250)
            .map(move |example| Sample {
                entropy: f64::from(example.features[PLANES + 2]) / 28.0,
                intensity: f64::from(example.features[PLANES]) / 255.0,
                keep,
            })
            .collect::<Vec<_>>()
    };
    [of(true), of(false)].concat()
}

/// What a person says of a frame, at the reduced scale: 1 keep, 0 mask, 255 nothing.
pub struct Labels {
    pub width: usize,
    pub height: usize,
    pub values: Vec<u8>,
}

impl Labels {
    /// Nothing is said yet of any pixel of the reduced frame.
    pub fn new(reduced: &Reduced) -> Labels {
        let (width, height) = (reduced.grey.width(), reduced.grey.height());
        Labels { width, height, values: vec![SAYS_NOTHING; width * height] }
    }

    /// Paints the shape: pixels whose centre lies in it. Later shapes win. Answers how many pixels that are.
    pub fn paint(&mut self, shape: &Shape, factor: usize) -> usize {
        let (mut fill, mut count) = (Fill::new(shape, factor), 0);
        for (y, row) in self.values.chunks_exact_mut(self.width.max(1)).enumerate() {
            fill.row(y, self.width, |start, end| {
                row[start..end].fill(shape.meaning.label());
                count += end - start;
            });
        }
        count
    }

    /// Takes over a mask of the frame's size that teaches.
    ///
    /// # Errors
    /// When it cannot be read, has another size than the frame or other values than 0, 1 and 255, or says nothing.
    pub fn read_mask(&mut self, path: &Path, reduced: &Reduced) -> Result<()> {
        let mask = LabelledMask::open(path, reduced)?;
        let width = self.width;
        let values = &mut self.values;
        let [masked, kept, unsaid] =
            mask.each_row(reduced, |y, labels| values[y * width..(y + 1) * width].copy_from_slice(labels))?;
        if masked + kept == 0 {
            return Err(Error::usage(
                format!("{}: every pixel is 255, unknown", path.display()),
                "1 means keep, 0 mask",
            ));
        }
        if kept == 0 && unsaid > 0 {
            tracing::warn!(
                "{}: its values are 0 and 255, so that it teaches what to mask only; write 1 for what is to be kept",
                path.display()
            );
        }
        Ok(())
    }

    /// At most `most` pixels of a class, every k-th in reading order.
    fn drawn(&self, class: u8, most: usize) -> Vec<usize> {
        let count = self.values.iter().filter(|v| **v == class).count();
        let stride = count.div_ceil(most).max(1);
        let all = self.values.iter().enumerate().filter(|(_, v)| **v == class).map(|(i, _)| i);
        all.skip(stride / 2).step_by(stride).collect()
    }
}

/// Taught pixels of a class and frame that take part.
const DRAWN: usize = 3000;

/// The labelled pixels of a frame as examples.
///
/// # Errors
/// When the plane cannot be read.
pub fn examples(reduced: &Reduced, labels: &Labels, most: usize, weight: u32) -> Result<Vec<Example<FEATURES>>> {
    let scale = frame_scale(reduced)?;
    let mut drawn: Vec<(usize, bool)> = labels.drawn(1, most).into_iter().map(|i| (i, true)).collect();
    drawn.extend(labels.drawn(0, most).into_iter().map(|i| (i, false)));
    drawn.retain(|(i, _)| reduced.valid.get(i % labels.width, i / labels.width));
    let grid = TileGrid::new(labels.width as u64, labels.height as u64, CORE_PX, CORE_PX, 0);
    let tiles: Vec<Result<Vec<Example<FEATURES>>>> = (0..grid.len())
        .into_par_iter()
        .map(|id| {
            let core = grid.tile(id).core;
            let place = |i: usize| ((i % labels.width) as u64, (i / labels.width) as u64);
            let here: Vec<&(usize, bool)> =
                drawn.iter().filter(|(i, _)| core.contains(place(*i).0, place(*i).1)).collect();
            if here.is_empty() {
                return Ok(Vec::new());
            }
            let (measured, _) = measured(&reduced.grey, &core, 0)?;
            let example = |&&(i, keep): &&(usize, bool)| {
                let (x, y) = place(i);
                let at = (y - core.y) as usize * measured.width + (x - core.x) as usize;
                Example { features: scale.apply(&measured, at), keep, weight }
            };
            Ok(here.iter().map(example).collect())
        })
        .collect();
    Ok(tiles.into_iter().collect::<Result<Vec<_>>>()?.concat())
}

/// Weight of a taught pixel against one that comes with the program: a frame's 3,000 pixels of each class weigh four
/// times as much as all that ships. Chosen on seven pairs of `docs/masks.md` among 10, 16, 24 and 40.
const TAUGHT_WEIGHT: u32 = 40;

/// What `--method auto` has learned: of what ships and what was taught.
///
/// # Errors
/// When a plane cannot be read.
pub fn learn(taught: &[(&Reduced, &Labels)]) -> Result<Learned> {
    let mut all = shipped();
    let alone = (!taught.is_empty()).then(|| Forest::grow(&all, Growth::default())).flatten();
    for (reduced, labels) in taught {
        all.extend(examples(reduced, labels, DRAWN, TAUGHT_WEIGHT)?);
    }
    let forest = Forest::grow(&all, Growth::default())
        .ok_or_else(|| Error::usage("the forest has examples of one class only", "teach keep and mask"))?;
    Ok(Learned { forest, known: Known::new(&all), shipped: alone })
}

/// The thesis's samples: each shape is laid over with 10 × 10 points, and entropy and intensity are interpolated there.
///
/// # Errors
/// When the plane cannot be read.
pub fn thesis_samples(reduced: &Reduced, shapes: &[&Shape]) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    let plane = &reduced.grey;
    let bounds = Window::whole(plane.width() as u64, plane.height() as u64);
    for shape in shapes.iter().filter(|shape| shape.meaning != Meaning::Unknown) {
        let [left, top, right, bottom] = shape.bounds().map(|v| v / reduced.factor as f64);
        // The pixels around, so that the points' neighbours and their discs are there.
        let first = [left, top].map(|v| (v - 1.0).floor().max(0.0) as u64);
        let size = [right.ceil() as u64 + 2 - first[0], bottom.ceil() as u64 + 2 - first[1]];
        let inner = Window::new(first[0], first[1], size[0], size[1]).intersect(&bounds);
        let read = inner.grown(RADIUS_PX as u64, &bounds);
        let pixels = plane.read(&read)?;
        let (w, h) = (read.width as usize, read.height as usize);
        let bits = entropy(&pixels, w, h, RADIUS_PX, 0..h);
        for j in 0..10 {
            for i in 0..10 {
                let x = left + (f64::from(i) + 0.5) / 10.0 * (right - left);
                let y = top + (f64::from(j) + 0.5) / 10.0 * (bottom - top);
                let full = [x * reduced.factor as f64, y * reduced.factor as f64];
                if !shape.contains(full) {
                    continue;
                }
                let (x, y) = (x - 0.5 - read.x as f64, y - 0.5 - read.y as f64);
                let clamp = |v: f64, n: usize| v.clamp(0.0, (n - 1) as f64);
                let (x, y) = (clamp(x, w), clamp(y, h));
                let (x0, y0) = (x as usize, y as usize);
                let (x1, y1) = ((x0 + 1).min(w - 1), (y0 + 1).min(h - 1));
                let (fx, fy) = (x - x0 as f64, y - y0 as f64);
                let blend = |at: &dyn Fn(usize) -> f64| {
                    let row = |y: usize| at(y * w + x0) * (1.0 - fx) + at(y * w + x1) * fx;
                    row(y0) * (1.0 - fy) + row(y1) * fy
                };
                samples.push(Sample {
                    entropy: blend(&|i| f64::from(bits[i])),
                    intensity: blend(&|i| f64::from(pixels[i])) / 255.0,
                    keep: shape.meaning == Meaning::Keep,
                });
            }
        }
    }
    Ok(samples)
}

/// Samples of a labelled frame for the thesis's classifier: 250 pixels of each class.
///
/// # Errors
/// When the plane cannot be read.
pub fn labelled_samples(reduced: &Reduced, labels: &Labels) -> Result<Vec<Sample>> {
    let bounds = Window::whole(labels.width as u64, labels.height as u64);
    let mut samples = Vec::new();
    for (class, keep) in [(1, true), (0, false)] {
        for i in labels.drawn(class, 250) {
            let (x, y) = ((i % labels.width) as u64, (i / labels.width) as u64);
            let read = Window::new(x, y, 1, 1).grown(RADIUS_PX as u64, &bounds);
            let pixels = reduced.grey.read(&read)?;
            let (w, h) = (read.width as usize, read.height as usize);
            let (dx, dy) = ((x - read.x) as usize, (y - read.y) as usize);
            let bits = entropy(&pixels, w, h, RADIUS_PX, dy..dy + 1)[dx];
            samples.push(Sample { entropy: f64::from(bits), intensity: f64::from(pixels[dy * w + dx]) / 255.0, keep });
        }
    }
    Ok(samples)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_row_has_a_frame_of_the_table() {
        let table: Vec<u8> = include_str!("../teaching/frames.csv")
            .lines()
            .skip(1)
            .map(|line| line.split(',').next().and_then(|n| n.parse().ok()).expect("a number"))
            .collect();
        let mut frames: Vec<u8> = shipped_by_frame().into_iter().map(|(frame, _)| frame).collect();
        assert!(frames.is_sorted());
        frames.dedup();
        assert!(frames.iter().all(|frame| table.contains(frame)));
    }
}
