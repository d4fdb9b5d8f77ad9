//! Pixels that are taught both as ground to keep and as something to mask.

use std::path::Path;

use autoref_raster::error::{Error, Result};

use crate::fill::Fill;
use crate::model::Labels;
use crate::reduce::Reduced;
use crate::shapes::{Meaning, SAYS_NOTHING, Shape};

/// Pixels of the analysis in a row: row, first column, end.
type Run = (usize, usize, usize);

/// A sample with the pixels of the analysis whose centres lie in it.
struct Filled<'a> {
    shape: &'a Shape,
    runs: Vec<Run>,
}

impl<'a> Filled<'a> {
    fn of(shape: &'a Shape, reduced: &Reduced) -> Filled<'a> {
        let (mut fill, mut runs) = (Fill::new(shape, reduced.factor), Vec::new());
        for y in 0..reduced.grey.height() {
            fill.row(y, reduced.grey.width(), |start, end| runs.push((y, start, end)));
        }
        Filled { shape, runs }
    }

    fn pixels(&self) -> usize {
        self.runs.iter().map(|(_, start, end)| end - start).sum()
    }

    /// Pixels that lie in both.
    fn shared(&self, other: &Filled<'_>) -> Shared {
        let mut shared = Shared::default();
        let ([left, top, right, bottom], others) = (self.shape.bounds(), other.shape.bounds());
        if left > others[2] || right < others[0] || top > others[3] || bottom < others[1] {
            return shared;
        }
        for &(y, start, end) in &self.runs {
            let first = other.runs.partition_point(|run| run.0 < y);
            for &(_, from, to) in other.runs[first..].iter().take_while(|run| run.0 == y) {
                shared.add(y, start.max(from), end.min(to));
            }
        }
        shared
    }

    /// Pixels that a mask calls the other side.
    fn denied_by(&self, labels: &Labels) -> Shared {
        let mut shared = Shared::default();
        for &(y, start, end) in &self.runs {
            for x in start..end {
                let label = labels.values[y * labels.width + x];
                if label != SAYS_NOTHING && label != self.shape.meaning.label() {
                    shared.add(y, x, x + 1);
                }
            }
        }
        shared
    }
}

/// Pixels that two of those who teach claim: how many, and left, top, right, bottom.
#[derive(Default)]
struct Shared {
    pixels: usize,
    bounds: Option<[usize; 4]>,
}

impl Shared {
    fn add(&mut self, y: usize, start: usize, end: usize) {
        if start >= end {
            return;
        }
        self.pixels += end - start;
        let [left, top, right, bottom] = self.bounds.unwrap_or([start, y, end, y + 1]);
        self.bounds = Some([left.min(start), top.min(y), right.max(end), bottom.max(y + 1)]);
    }

    /// The refusal, with the place in pixels of the frame; `None` when nothing is shared.
    fn refusal(&self, frame: &Path, reduced: &Reduced, [keep, mask]: [String; 2]) -> Option<Error> {
        let [left, top, right, bottom] = self.bounds?.map(|at| (at * reduced.factor) as u64);
        let (right, bottom) = (right.min(reduced.width), bottom.min(reduced.height));
        Some(Error::usage(
            format!(
                "{}: {keep} says keep and {mask} says mask of the same pixels, {left}, {top} to {right}, {bottom}",
                frame.display()
            ),
            "draw them apart, or leave one of them out",
        ))
    }
}

fn name(shape: &Shape) -> String {
    match &shape.file {
        Some(file) => format!("{} of {}", shape.place, file.display()),
        None => format!("the sample {}", shape.place),
    }
}

/// Of two, the one to keep first.
fn keep_first(keep: bool, one: String, other: String) -> [String; 2] {
    if keep { [one, other] } else { [other, one] }
}

/// Refuses samples, and a mask with its `labels`, that teach the same pixels of the analysis both ways. In one list of
/// polygons a later one lies over earlier ones, so that a lake may be drawn on a shore; but something of each must
/// be left.
///
/// # Errors
/// When two of them contradict each other; the message names both, and the place.
pub(crate) fn check_sides(
    frame: &Path,
    reduced: &Reduced,
    shapes: &[&Shape],
    mask: Option<(&Path, &Labels)>,
) -> Result<()> {
    let sided = shapes.iter().filter(|shape| shape.meaning != Meaning::Unknown);
    let filled: Vec<Filled<'_>> = sided.map(|shape| Filled::of(shape, reduced)).collect();
    for (i, later) in filled.iter().enumerate() {
        let keep = later.shape.meaning == Meaning::Keep;
        let against = |shared: &Shared, other: String| {
            shared.refusal(frame, reduced, keep_first(keep, name(later.shape), other)).map_or(Ok(()), Err)
        };
        for earlier in filled[..i].iter().filter(|earlier| earlier.shape.meaning != later.shape.meaning) {
            let shared = earlier.shared(later);
            let of_one_list = later.shape.file.is_some() && later.shape.file == earlier.shape.file;
            if of_one_list && shared.pixels < earlier.pixels() {
                continue;
            }
            against(&shared, name(earlier.shape))?;
        }
        if let Some((path, labels)) = mask {
            against(&later.denied_by(labels), format!("the mask {}", path.display()))?;
        }
    }
    Ok(())
}
