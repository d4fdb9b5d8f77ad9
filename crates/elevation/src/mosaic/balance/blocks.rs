//! What the overlaps hold: means over blocks of both sources of a pair, and the mean level of each source.

use gdal::raster::GdalDataType;

use crate::error::Result;
use crate::grid::Grid;
use crate::output::{self, Cut};
use crate::resample::Interpolation;
use crate::window::Window;

use super::super::form::range;
use super::super::read::Opened;
use super::super::source::Source;

/// Side of the blocks whose means are compared.
pub const BLOCK_PX: usize = 16;
/// Cells that a block must have of both.
const FEWEST_CELLS: u32 = (BLOCK_PX * BLOCK_PX / 2) as u32;
/// Blocks of a pair that are held at most; beyond, every second, fourth, … column and row of blocks is looked at.
const MOST_BLOCKS: u64 = 4_000_000;
/// Side of the windows that are read.
const WINDOW_PX: u64 = 256;

/// One block of one pair: place, pair, and the means of both sources band by band.
pub struct Block {
    pub place: (u64, u64),
    /// Of the cells that both have.
    pub centre: (f64, f64),
    pub pair: (usize, usize),
    /// NaN where too few cells count: without data, or at the limits of the sample type.
    pub means: Vec<(f64, f64)>,
}

impl Block {
    /// Whether both sources have a mean of this band in it.
    pub fn counts(&self, band: usize) -> bool {
        !self.means[band].0.is_nan()
    }
}

/// Sum and number of the cells of a source in a window, band by band.
struct Seen {
    place: (u64, u64),
    source: usize,
    sums: Vec<(f64, u32)>,
}

/// What one streamed pass over all overlaps finds.
pub struct Gathered {
    /// By pair, row and column.
    pub blocks: Vec<Block>,
    /// The mean of each source, band by band, over the windows that hold its overlaps; NaN where it has none.
    pub levels: Vec<Vec<f64>>,
}

/// How the sources are read.
pub struct Reading<'a> {
    pub sources: &'a [Source],
    pub grid: &'a Grid,
    pub interpolation: Interpolation,
    pub threads: usize,
}

/// What a worker keeps.
#[derive(Default)]
struct Worker {
    opened: Opened,
    blocks: Vec<Block>,
    seen: Vec<Seen>,
}

impl Reading<'_> {
    /// One streamed pass over all overlaps; `covered` is the number of cells of all sources.
    ///
    /// # Errors
    /// When a source or its mask cannot be read.
    pub fn gather(&self, covered: f64) -> Result<Gathered> {
        let mut step = 1u64;
        while covered as u64 / (BLOCK_PX * BLOCK_PX) as u64 / (step * step) > MOST_BLOCKS {
            step *= 2;
        }
        let states = output::produce(
            self.grid,
            Cut { tile_px: WINDOW_PX, block_px: WINDOW_PX },
            self.threads,
            Worker::default,
            |worker, window| {
                if (window.x / WINDOW_PX + window.y / WINDOW_PX).is_multiple_of(step) {
                    self.look(window, worker)?;
                }
                Ok(())
            },
            |_, ()| Ok(()),
        )?;
        let (mut blocks, mut seen) = (Vec::new(), Vec::new());
        for state in states {
            blocks.extend(state.blocks);
            seen.extend(state.seen);
        }
        // The order in which threads came by must not matter.
        blocks.sort_by_key(|b| (b.pair, b.place.1, b.place.0));
        seen.sort_by_key(|s| (s.source, s.place.1, s.place.0));
        let bands = self.sources[0].bands;
        let mut sums = vec![vec![(0.0, 0u64); bands]; self.sources.len()];
        for seen in &seen {
            for (all, here) in sums[seen.source].iter_mut().zip(&seen.sums) {
                *all = (all.0 + here.0, all.1 + u64::from(here.1));
            }
        }
        let mean = |(sum, n): &(f64, u64)| sum / *n as f64;
        Ok(Gathered { blocks, levels: sums.iter().map(|bands| bands.iter().map(mean).collect()).collect() })
    }

    /// One window: the levels of the sources there, and the blocks of all pairs.
    fn look(&self, window: Window, worker: &mut Worker) -> Result<()> {
        let near: Vec<usize> = (0..self.sources.len()).filter(|&i| self.sources[i].meets(self.grid, window)).collect();
        if near.len() < 2 {
            return Ok(());
        }
        let read = |i: &usize| worker.opened.read(&self.sources[*i], self.grid, window, self.interpolation);
        let values: Vec<Vec<f64>> = near.iter().map(read).collect::<Result<_>>()?;
        let area = window.area() as usize;
        for (source, values) in near.iter().zip(&values) {
            let sum = |plane: &[f64]| {
                let known = plane.iter().filter(|v| !v.is_nan());
                known.fold((0.0, 0), |(sum, n), v| (sum + v, n + 1))
            };
            let sums = values.chunks_exact(area).map(sum).collect();
            worker.seen.push(Seen { place: (window.x, window.y), source: *source, sums });
        }
        let limits = limits(self.sources[0].kind);
        for (i, &first) in near.iter().enumerate() {
            for (j, &second) in near.iter().enumerate().skip(i + 1) {
                for y in (0..window.height as usize).step_by(BLOCK_PX) {
                    for x in (0..window.width as usize).step_by(BLOCK_PX) {
                        let block = block(window, (x, y), (&values[i], &values[j]), limits);
                        worker.blocks.extend(block.map(|block| Block { pair: (first, second), ..block }));
                    }
                }
            }
        }
        Ok(())
    }
}

/// The limits of whole-number types: what lies there may have lain beyond.
fn limits(kind: GdalDataType) -> Option<(f64, f64)> {
    let is_float = matches!(kind, GdalDataType::Float32 | GdalDataType::Float64);
    // Half a number within: what was drawn from cells at the limit is there but for rounding.
    let inside = |(least, most): (f64, f64)| (least + 0.5, most - 0.5);
    (!is_float).then(|| inside(range(kind)))
}

/// The block of two sources whose corner lies there in the window, when both have enough cells in a band.
fn block(
    window: Window,
    (x, y): (usize, usize),
    (first, second): (&[f64], &[f64]),
    limits: Option<(f64, f64)>,
) -> Option<Block> {
    let (width, height) = (window.width as usize, window.height as usize);
    let (right, bottom) = ((x + BLOCK_PX).min(width), (y + BLOCK_PX).min(height));
    let at_limit = |value: f64| limits.is_some_and(|(least, most)| value < least || value > most);
    let (mut most_cells, mut centre) = (0, (0.0, 0.0));
    let mut means = Vec::with_capacity(first.len() / (width * height));
    for (first, second) in first.chunks_exact(width * height).zip(second.chunks_exact(width * height)) {
        let (mut cells, mut counted, mut sums, mut place) = (0u32, 0u32, (0.0, 0.0), (0, 0));
        for row in y..bottom {
            let line = row * width + x..row * width + right;
            for (column, (a, b)) in (x..).zip(first[line.clone()].iter().zip(&second[line])) {
                if a.is_nan() || b.is_nan() {
                    continue;
                }
                cells += 1;
                place = (place.0 + column, place.1 + row);
                if !at_limit(*a) && !at_limit(*b) {
                    counted += 1;
                    sums = (sums.0 + a, sums.1 + b);
                }
            }
        }
        if cells > most_cells {
            // Where the cells are: at the edge of a source they fill a part of the block.
            let mean = |sum: usize, from: u64| from as f64 + sum as f64 / f64::from(cells) + 0.5;
            (most_cells, centre) = (cells, (mean(place.0, window.x), mean(place.1, window.y)));
        }
        let n = f64::from(counted);
        means.push(if counted < FEWEST_CELLS { (f64::NAN, f64::NAN) } else { (sums.0 / n, sums.1 / n) });
    }
    let place = (window.x + x as u64, window.y + y as u64);
    (most_cells >= FEWEST_CELLS).then_some(Block { place, centre, pair: (0, 0), means })
}
