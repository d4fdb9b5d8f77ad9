//! Brightness evened out between sources: a gain, an offset and a smooth surface for each band of each source, from
//! their overlaps.
//!
//! Each pair of overlapping sources gives, from means over blocks ([`blocks`]), the blocks that agree ([`start`]) and
//! the ratio of their contrasts ([`relation`]); the graph of overlaps then gives gains, offsets and surfaces
//! ([`adjust`]; L. Chandelier and G. Martinoty, *A radiometric aerial triangulation for the equalization of digital
//! aerial images and orthoimages*, 2009, adjust the same graph).

mod adjust;
mod blocks;
mod notes;
mod relation;
mod start;
mod surface;

use std::path::Path;

use serde::Serialize;

use crate::error::Result;
use crate::grid::Grid;
use crate::window::Window;

use super::form::BandForm;
use adjust::{Band, Ties};
use blocks::{BLOCK_PX, Block};
use surface::{Frame, TERMS, dot};

pub use blocks::Reading;
pub use surface::{Balancing, Surface};

/// Corrections: balanced = gain · value + offset + surface, where the surface is a·u + b·v + c·(u² − ⅓) + d·u·v +
/// e·(v² − ⅓), and u and v run from −1 to 1 over the source, eastwards and southwards.
#[derive(Clone, Debug, Serialize)]
pub struct Balance {
    /// By source, then by band.
    pub gains: Vec<Vec<f64>>,
    pub offsets: Vec<Vec<f64>>,
    /// a to e.
    pub surfaces: Vec<Vec<[f64; TERMS]>>,
    pub overlaps: Vec<Overlap>,
    /// Cells that were balanced beyond the limits of the sample type, and are clipped there; those that lay at the
    /// limits before do not count.
    pub clipped_cells: u64,
    /// What could not be evened out, and why; for people.
    pub notes: Vec<String>,
    /// Differences over the ground, for the page.
    #[serde(skip)]
    pub map: DifferenceMap,
    #[serde(skip)]
    frames: Vec<Frame>,
}

/// Mean sizes of differences, over all bands and pairs, in squares of the mosaic; NaN where there is no overlap.
#[derive(Clone, Debug, Default)]
pub struct DifferenceMap {
    pub width: usize,
    pub height: usize,
    pub before: Vec<f64>,
    pub after: Vec<f64>,
}

/// How two sources differ where they overlap, before and after.
#[derive(Clone, Debug, Serialize)]
pub struct Overlap {
    pub first: usize,
    pub second: usize,
    pub band: usize,
    pub blocks: usize,
    /// Blocks of these that the correction follows; the others have changed.
    pub agreeing_blocks: usize,
    pub mean_before: f64,
    pub mean_after: f64,
    /// Root mean square of the differences of block means.
    pub rms_before: f64,
    pub rms_after: f64,
}

impl Balance {
    /// The correction of a band of a source at a place of the mosaic, in cells.
    pub fn correct(&self, source: usize, band: usize, (x, y): (f64, f64), value: f64) -> f64 {
        let surface = dot(&self.surfaces[source][band], &self.frames[source].basis((x, y)));
        self.gains[source][band] * value + self.offsets[source][band] + surface
    }

    /// Counts the cells of a window that lie beyond the limits of the sample type in some band, and whose source did
    /// not lie at them. `index` has the source of each cell from 1 on, 0 for a mix.
    pub fn clipped(&self, values: &[f64], index: &[u32], window: Window, (least, most): (f64, f64)) -> u64 {
        let clipped = |cell: usize, band: usize, value: f64| {
            if value >= least - 0.5 && value < most + 0.5 || value.is_nan() {
                return false;
            }
            let Some(source) = (index[cell] as usize).checked_sub(1) else { return true };
            let (row, column) = (cell as u64 / window.width, cell as u64 % window.width);
            let place = ((window.x + column) as f64 + 0.5, (window.y + row) as f64 + 0.5);
            let before = (value - self.correct(source, band, place, 0.0)) / self.gains[source][band];
            before > least + 0.5 && before < most - 0.5
        };
        let bands = values.len() / index.len().max(1);
        let any = |cell: &usize| (0..bands).any(|band| clipped(*cell, band, values[band * index.len() + cell]));
        (0..index.len()).filter(any).count() as u64
    }

    /// Keeps how many of the filled cells were clipped, and says so.
    pub fn tell_clipped(&mut self, clipped: u64, filled: u64) {
        self.clipped_cells = clipped;
        self.notes.extend(notes::of_clipped(clipped, filled));
    }
}

/// Squares on the longer side of the page's map.
const MAP_SQUARES: u64 = 96;

/// One streamed pass over all overlaps, and the adjustment.
///
/// # Errors
/// When a source or its mask cannot be read.
pub fn estimate(reading: &Reading, balancing: Balancing) -> Result<Balance> {
    let (sources, grid) = (reading.sources, reading.grid);
    let frames: Vec<Frame> = sources.iter().map(|s| Frame::of(s, grid)).collect();
    let covered = frames.iter().map(|f| 4.0 * f.half.0 * f.half.1).sum();
    let gathered = reading.gather(covered)?;
    let bands = sources[0].bands;
    let mut balance = Balance {
        gains: vec![vec![1.0; bands]; sources.len()],
        offsets: vec![vec![0.0; bands]; sources.len()],
        surfaces: vec![vec![[0.0; TERMS]; bands]; sources.len()],
        overlaps: Vec::new(),
        clipped_cells: 0,
        notes: Vec::new(),
        map: DifferenceMap::default(),
        frames,
    };
    let mut ties = Vec::new();
    // Opacity lies at the limits of its type and counts nowhere; the infrared that passes for opacity does.
    let is_opacity = |band: usize| sources[0].forms.get(band).is_some_and(BandForm::is_alpha);
    for band in 0..bands {
        let levels = gathered.levels.iter().map(|levels| levels[band]).collect();
        let (blocks, threads) = (gathered.blocks.as_slice(), reading.threads);
        let (found, corrections) = Band { band, blocks, levels, frames: &balance.frames, balancing, threads }.adjust();
        for (source, correction) in corrections.into_iter().enumerate() {
            balance.gains[source][band] = correction.gain;
            balance.offsets[source][band] = correction.offset;
            balance.surfaces[source][band] = correction.surface;
        }
        report(&gathered.blocks, &found, &mut balance);
        if !is_opacity(band) || found.agreeing.iter().any(|blocks| *blocks > 0) {
            ties.push(found);
        }
    }
    let names: Vec<&Path> = sources.iter().map(|s| s.path.as_path()).collect();
    balance.notes = notes::of_ties(&ties, &names, balancing.reference);
    balance.map = map(&gathered.blocks, grid, &balance);
    Ok(balance)
}

/// A block's difference, second minus first, before and after.
fn gaps(block: &Block, band: usize, balance: &Balance) -> (f64, f64) {
    let ((i, j), (x, y)) = (block.pair, block.means[band]);
    (y - x, balance.correct(j, band, block.centre, y) - balance.correct(i, band, block.centre, x))
}

/// What the overlaps look like in one band.
fn report(blocks: &[Block], ties: &Ties, balance: &mut Balance) {
    let band = ties.band;
    for (group, agreeing) in blocks.chunk_by(|a, b| a.pair == b.pair).zip(&ties.agreeing) {
        let group: Vec<&Block> = group.iter().filter(|b| b.counts(band)).collect();
        if group.is_empty() {
            continue;
        }
        let n = group.len() as f64;
        let mean = |f: &dyn Fn((f64, f64)) -> f64| group.iter().map(|b| f(gaps(b, band, balance))).sum::<f64>() / n;
        let overlap = Overlap {
            first: group[0].pair.0 + 1,
            second: group[0].pair.1 + 1,
            band: band + 1,
            blocks: group.len(),
            agreeing_blocks: *agreeing,
            mean_before: mean(&|g| g.0),
            mean_after: mean(&|g| g.1),
            rms_before: mean(&|g| g.0 * g.0).sqrt(),
            rms_after: mean(&|g| g.1 * g.1).sqrt(),
        };
        balance.overlaps.push(overlap);
    }
}

/// Where the differences are.
fn map(blocks: &[Block], grid: &Grid, balance: &Balance) -> DifferenceMap {
    let side = grid.width.max(grid.height).div_ceil(MAP_SQUARES).max(BLOCK_PX as u64);
    let (width, height) = (grid.width.div_ceil(side) as usize, grid.height.div_ceil(side) as usize);
    let mut sums = vec![(0.0, 0.0, 0.0); width * height];
    for block in blocks {
        let sum = &mut sums[(block.place.1 / side) as usize * width + (block.place.0 / side) as usize];
        for band in (0..block.means.len()).filter(|band| block.counts(*band)) {
            let (before, after) = gaps(block, band, balance);
            *sum = (sum.0 + before.abs(), sum.1 + after.abs(), sum.2 + 1.0);
        }
    }
    DifferenceMap {
        width,
        height,
        before: sums.iter().map(|s| s.0 / s.2).collect(),
        after: sums.iter().map(|s| s.1 / s.2).collect(),
    }
}
