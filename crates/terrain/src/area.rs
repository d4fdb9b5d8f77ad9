//! Removing connected areas that are too small.
//!
//! The mask is read as runs, row by row; runs that touch along a side are united (4-neighbours). This is
//! `scipy.ndimage.label` with its default structure, and `skimage.morphology.remove_small_objects(…, connectivity=1)`.

use crate::bits::{Bit, BitMask};
use autoref_raster::sets::Sets;

/// Pixels `start..end` of a row.
#[derive(Clone, Copy)]
pub(crate) struct Run {
    pub row: u32,
    pub start: u32,
    pub end: u32,
}

impl Run {
    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        u64::from(self.end - self.start)
    }
}

/// The areas of a mask, as runs of pixels with the area that each belongs to.
pub struct Areas {
    pub(crate) runs: Vec<Run>,
    /// Root of each run's area after [`Areas::of`].
    pub(crate) root: Vec<u32>,
    /// Pixels of the area, at its root.
    pub(crate) pixels: Vec<u64>,
}

impl Areas {
    /// The connected areas of the pixels that are set, or clear.
    pub fn of(mask: &BitMask, bit: Bit) -> Areas {
        let mut runs: Vec<Run> = Vec::new();
        let mut sets = Sets::default();
        let mut above = 0..0;
        for y in 0..mask.height() {
            let first = runs.len();
            mask.runs(y, bit, |start, end| {
                sets.add();
                runs.push(Run { row: y as u32, start: start as u32, end: end as u32 });
            });
            let mut i = above.start;
            for j in first..runs.len() {
                while i < above.end && runs[i].end <= runs[j].start {
                    i += 1;
                }
                let mut k = i;
                while k < above.end && runs[k].start < runs[j].end {
                    sets.unite(k, j);
                    k += 1;
                }
            }
            above = first..runs.len();
        }
        let mut pixels = vec![0; runs.len()];
        let root = sets.roots();
        for (run, root) in runs.iter().zip(&root) {
            pixels[*root as usize] += run.pixels();
        }
        Areas { runs, root, pixels }
    }

    /// Number of areas.
    pub fn len(&self) -> usize {
        self.root.iter().enumerate().filter(|(i, root)| *i as u32 == **root).count()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Calls `run(y, start, end)` for every run of the areas with fewer than `least` pixels.
    pub fn smaller_than(&self, least: f64, mut run: impl FnMut(usize, usize, usize)) {
        for (piece, &root) in self.runs.iter().zip(&self.root) {
            if (self.pixels[root as usize] as f64) < least {
                run(piece.row as usize, piece.start as usize, piece.end as usize);
            }
        }
    }
}

/// Turns over the areas of pixels set, or clear, that hold less than `share` of the image.
pub fn flip_small(mask: &mut BitMask, bit: Bit, share: f64) {
    let least = share * (mask.width() * mask.height()) as f64;
    let areas = Areas::of(mask, bit);
    areas.smaller_than(least, |y, start, end| mask.fill_run(y, start, end, !bit));
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::xorshift;
    use proptest::prelude::*;

    /// Flood fill from every pixel.
    fn by_definition(mask: &BitMask, value: bool, least: f64) -> BitMask {
        let (width, height) = (mask.width(), mask.height());
        let mut out = mask.clone();
        let mut seen = vec![false; width * height];
        for first in 0..width * height {
            let (x, y) = (first % width, first / width);
            if seen[first] || mask.get(x, y) != value {
                continue;
            }
            let (mut area, mut todo) = (vec![first], vec![first]);
            seen[first] = true;
            while let Some(at) = todo.pop() {
                let (x, y) = (at % width, at / width);
                let mut visit = |ok: bool, to: usize| {
                    if ok && !seen[to] && mask.get(to % width, to / width) == value {
                        seen[to] = true;
                        area.push(to);
                        todo.push(to);
                    }
                };
                visit(x > 0, at.wrapping_sub(1));
                visit(x + 1 < width, at + 1);
                visit(y > 0, at.wrapping_sub(width));
                visit(y + 1 < height, at + width);
            }
            if (area.len() as f64) < least {
                area.iter().for_each(|at| out.set(at % width, at / width, !value));
            }
        }
        out
    }

    proptest! {
        #[test]
        fn small_areas_go_and_others_stay(
            width in 1usize..90, height in 1usize..24, seed in any::<u64>(), share in 4u64..13, part in 0.0f64..0.2,
        ) {
            let mut state = seed | 1;
            let mask = BitMask::from_fn(width, height, |_, _| xorshift(&mut state) % 16 < share);
            for (bit, value) in [(Bit::Set, true), (Bit::Clear, false)] {
                let mut ours = mask.clone();
                flip_small(&mut ours, bit, part);
                prop_assert_eq!(ours, by_definition(&mask, value, part * (width * height) as f64));
            }
        }
    }
}
