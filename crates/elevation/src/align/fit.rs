//! One streamed pass over both models: the normal equations of shift and surface, robustly weighted.
//!
//! The linearised model is that of the least-squares z-difference (K. Rosenholm and K. Torlegård, *Three-dimensional
//! absolute orientation of stereo models using digital elevation models*, 1988), of whose seven parameters the shift
//! and the two tilts are kept, and a surface of the second or third degree on request. Where it differs: the estimating
//! equations take the gradient of the template, which no interpolation has touched and whose noise has nothing in
//! common with that of the other model, so that noise does not draw the shift; that gradient is smoothed, for where
//! the ground is rough from cell to cell no interpolation is true ([`super::smooth`]); and the matrix is the mixed
//! product of both models' gradients, which noise does not enlarge.

use crate::error::Result;
use crate::grid::Grid;
use crate::source::Patch;
use crate::stream::{self, BLOCK_PX, Means};
use crate::window::Window;

use super::block::View;
use super::pair::{Moved, MovedBuffers, Pair, mark_stable};
use super::parameters::{SHIFTS, State};
use super::smooth::{REACH_PX, Smooth};
use super::sums::{Flats, Gather, Partial, Sums};
use super::surface::Degree;

/// Cells that say much of the whole: how wide residuals scatter, roughly where the shift lies. Of larger models every
/// n-th part is looked at, n at most [`MOST_APART`].
const ENOUGH_CELLS: u64 = 1_000_000;
const MOST_APART: u64 = 16;

/// Every how many-th row, or row of blocks, is looked at.
pub(super) fn apart(grid: &Grid) -> u64 {
    (grid.width.saturating_mul(grid.height) / ENOUGH_CELLS).clamp(1, MOST_APART)
}

/// The scatter of the residuals, from as many cells as say it well.
///
/// # Errors
/// When a model cannot be read.
pub fn scatter(pair: &Pair<'_>, state: &State, flats: Flats, means: Means) -> Result<Sums> {
    let blocks_apart = apart(&pair.template.grid());
    if blocks_apart > 1 {
        let sums = pass(pair, state, Gather::Scatter { blocks_apart }, flats, means)?;
        // Common ground may lie in a few rows.
        if sums.sloping >= ENOUGH_CELLS / MOST_APART {
            return Ok(sums);
        }
    }
    pass(pair, state, Gather::Residuals, flats, means)
}

/// Buffers of a worker.
struct Worker {
    sums: Sums,
    scratch: MovedBuffers,
    template: Vec<f64>,
    smooth: Smooth,
    other: Vec<f64>,
    stable: Vec<u32>,
}

/// One pass over all cells of the template.
///
/// # Errors
/// When a model cannot be read.
pub fn pass(pair: &Pair<'_>, state: &State, gather: Gather, flats: Flats, means: Means) -> Result<Sums> {
    match state.surface.degree {
        Degree::Level => pass_of::<{ SHIFTS + 1 }>(pair, state, gather, flats, means),
        Degree::Linear => pass_of::<{ SHIFTS + 3 }>(pair, state, gather, flats, means),
        Degree::Quadratic => pass_of::<{ SHIFTS + 6 }>(pair, state, gather, flats, means),
        Degree::Cubic => pass_of::<{ SHIFTS + 10 }>(pair, state, gather, flats, means),
    }
}

/// The same with `N` parameters.
fn pass_of<const N: usize>(pair: &Pair<'_>, state: &State, gather: Gather, flats: Flats, means: Means) -> Result<Sums> {
    let grid = pair.template.grid();
    let blocks = match gather {
        Gather::Scores { block_px, .. } => (grid.width.div_ceil(block_px) * grid.height.div_ceil(block_px)) as usize,
        _ => 0,
    };
    let pass = Pass::<N> { pair, grid, state, gather, flats, other: Moved::of(pair, state.shift) };
    let worker = || Worker {
        sums: Sums::new(N, blocks),
        scratch: MovedBuffers::default(),
        template: Vec::new(),
        smooth: Smooth::default(),
        other: Vec::new(),
        stable: Vec::new(),
    };
    let tiles = means.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, worker, |worker, core| {
        if pair.template.holds_nothing(core.into()) {
            return Ok(());
        }
        let Gather::Scatter { blocks_apart } = gather else { return pass.look(worker, core) };
        // The same rows for any tiling.
        let rows_apart = BLOCK_PX * blocks_apart;
        for y in (core.y.next_multiple_of(rows_apart)..core.bottom()).step_by(rows_apart as usize) {
            pass.look(worker, Window::new(core.x, y, core.width, BLOCK_PX.min(core.bottom() - y)))?;
        }
        Ok(())
    })?;
    let mut whole = Sums::new(N, blocks);
    parts.iter().for_each(|part| whole.merge(&part.sums));
    Ok(whole)
}

/// A pass under way, with `N` parameters.
struct Pass<'a, const N: usize> {
    pair: &'a Pair<'a>,
    grid: Grid,
    state: &'a State,
    gather: Gather,
    flats: Flats,
    other: Moved<'a>,
}

impl<const N: usize> Pass<'_, N> {
    /// Gathers what a window tells.
    fn look(&self, worker: &mut Worker, core: Window) -> Result<()> {
        let (pair, grid) = (self.pair, &self.grid);
        let around = |cells: usize| Patch {
            x: core.x as i64 - cells as i64,
            y: core.y as i64 - cells as i64,
            width: core.width as usize + 2 * cells,
            height: core.height as usize + 2 * cells,
        };
        let patch = around(1);
        // Smoothing takes more cells.
        let margin = if self.gather.solves() { 1 + REACH_PX } else { 1 };
        let wide = around(margin);
        pair.template.read(wide, &mut worker.template)?;
        if self.gather.solves() {
            worker.smooth.take(&worker.template, wide.width);
        } else {
            worker.smooth.clear();
        }
        self.other.read_with(patch, &mut worker.scratch, &mut worker.other)?;
        mark_stable(pair, grid, core, &mut worker.stable);
        let (template, smooth, other) = (&worker.template, worker.smooth.values(), &worker.other);
        let view = View { pair, grid, core, template, margin, smooth, other };
        for y in (0..core.height).step_by(BLOCK_PX as usize) {
            for x in (0..core.width).step_by(BLOCK_PX as usize) {
                let block = Window::new(x, y, BLOCK_PX.min(core.width - x), BLOCK_PX.min(core.height - y));
                let sums = &mut worker.sums;
                let partial: Partial<N> =
                    view.block(block, self.state, (self.gather, self.flats), &worker.stable, sums);
                let index = match self.gather {
                    Gather::Scores { block_px, .. } => {
                        let across = grid.width.div_ceil(block_px);
                        Some(((core.y + y) / block_px * across + (core.x + x) / block_px) as usize)
                    }
                    _ => None,
                };
                sums.take(&partial, index);
            }
        }
        Ok(())
    }
}
