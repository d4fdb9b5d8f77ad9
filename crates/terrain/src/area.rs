//! Removing connected areas that are too small.
//!
//! The mask is read as runs, row by row; runs that touch along a side are united (4-neighbours). This is
//! `scipy.ndimage.label` with its default structure, and `skimage.morphology.remove_small_objects(…, connectivity=1)`.

use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::bits::BitMask;
use crate::plane::Plane;

#[derive(Clone, Copy)]
struct Run {
    row: u32,
    start: u32,
    end: u32,
}

/// The areas of a mask, as runs of pixels with the area that each belongs to.
pub struct Areas {
    runs: Vec<Run>,
    /// Root of each run's area after [`Areas::of`].
    root: Vec<u32>,
    /// Pixels of the area, at its root.
    pixels: Vec<u64>,
}

impl Areas {
    /// The connected areas of the pixels that have `value`.
    pub fn of(mask: &BitMask, value: bool) -> Areas {
        let mut runs: Vec<Run> = Vec::new();
        let mut parent: Vec<u32> = Vec::new();
        let mut above = 0..0;
        for y in 0..mask.height() {
            let first = runs.len();
            mask.runs(y, value, |start, end| {
                parent.push(runs.len() as u32);
                runs.push(Run { row: y as u32, start: start as u32, end: end as u32 });
            });
            let mut i = above.start;
            for j in first..runs.len() {
                while i < above.end && runs[i].end <= runs[j].start {
                    i += 1;
                }
                let mut k = i;
                while k < above.end && runs[k].start < runs[j].end {
                    unite(&mut parent, k as u32, j as u32);
                    k += 1;
                }
            }
            above = first..runs.len();
        }
        let mut pixels = vec![0; runs.len()];
        for i in 0..runs.len() {
            let root = find(&mut parent, i as u32);
            pixels[root as usize] += u64::from(runs[i].end - runs[i].start);
        }
        Areas { runs, root: parent, pixels }
    }

    /// Number of areas.
    pub fn len(&self) -> usize {
        self.root.iter().enumerate().filter(|(i, root)| *i as u32 == **root).count()
    }

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

/// Root of `i`, at which all on the path to it point from now on; after `of` every run points at its root.
fn find(parent: &mut [u32], i: u32) -> u32 {
    let mut root = i;
    while parent[root as usize] != root {
        root = parent[root as usize];
    }
    let mut at = i;
    while parent[at as usize] != root {
        at = std::mem::replace(&mut parent[at as usize], root);
    }
    root
}

/// The earlier run becomes the root.
fn unite(parent: &mut [u32], a: u32, b: u32) {
    let (a, b) = (find(parent, a), find(parent, b));
    parent[a.max(b) as usize] = a.min(b);
}

/// Turns over the areas of pixels with `value` that hold less than `share` of the image.
pub fn flip_small(mask: &mut BitMask, value: bool, share: f64) {
    let least = share * (mask.width() * mask.height()) as f64;
    let areas = Areas::of(mask, value);
    areas.smaller_than(least, |y, start, end| mask.fill_run(y, start, end, !value));
}

/// Turns the masked areas over to keep whose mean of `votes` (0 mask … 255 keep) is above `limit`. Pixels outside
/// `valid` take no part; an area of such pixels alone stays.
///
/// # Errors
/// When the plane cannot be read.
pub fn keep_doubtful(mask: &mut BitMask, votes: &Plane, valid: &BitMask, limit: f64) -> Result<()> {
    let areas = Areas::of(mask, false);
    let mut sums = vec![(0u64, 0u64); areas.runs.len()];
    let mut line = Vec::new();
    let mut row = None;
    for (run, &root) in areas.runs.iter().zip(&areas.root) {
        if row != Some(run.row) {
            line = votes.read(&Window::new(0, u64::from(run.row), votes.width() as u64, 1))?;
            row = Some(run.row);
        }
        let (sum, count) = &mut sums[root as usize];
        for x in run.start as usize..run.end as usize {
            if valid.get(x, run.row as usize) {
                *sum += u64::from(line[x]);
                *count += 1;
            }
        }
    }
    for (run, &root) in areas.runs.iter().zip(&areas.root) {
        let (sum, count) = sums[root as usize];
        if sum as f64 > limit * count as f64 {
            mask.fill_run(run.row as usize, run.start as usize, run.end as usize, true);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
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

    #[test]
    fn areas_masked_without_much_evidence_are_kept() {
        // Three areas: votes 30, votes 110, and one that holds nothing.
        let masked = |x: usize| matches!(x % 10, 2..=5);
        let mut mask = BitMask::from_fn(30, 4, |x, _| !masked(x));
        let valid = BitMask::from_fn(30, 4, |x, _| x < 20);
        let mut votes = Plane::new(30, 4, 1000).expect("a plane");
        let values: Vec<u8> = (0..120).map(|i| if i % 30 < 10 { 30 } else { 110 }).collect();
        votes.write(&Window::new(0, 0, 30, 4), &values).expect("written");
        keep_doubtful(&mut mask, &votes, &valid, 102.0).expect("read");
        assert_eq!([3, 13, 23].map(|x| mask.get(x, 2)), [false, true, false]);
    }

    proptest! {
        #[test]
        fn small_areas_go_and_others_stay(
            width in 1usize..90, height in 1usize..24, seed in any::<u64>(), share in 4u64..13, part in 0.0f64..0.2,
        ) {
            let mut state = seed | 1;
            let mask = BitMask::from_fn(width, height, |_, _| {
                state ^= state << 13; state ^= state >> 7; state ^= state << 17;
                state % 16 < share
            });
            for value in [true, false] {
                let mut ours = mask.clone();
                flip_small(&mut ours, value, part);
                prop_assert_eq!(ours, by_definition(&mask, value, part * (width * height) as f64));
            }
        }
    }
}
