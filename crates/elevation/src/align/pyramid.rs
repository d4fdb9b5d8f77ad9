//! Both models at several coarsenesses, in memory.

use crate::error::Result;
use crate::grid::Grid;
use crate::source::{Heights, Means as Averaged, MemoryHeights};
use crate::stream::{self, BLOCK_PX, Means};

use super::method::{Method, Options};
use super::pair::Pair;

/// The search looks at so many cells across at most.
pub(super) const SEARCH_CELLS: u64 = 96;
/// Cells that say roughly enough where Nuth and Kääb's iterations begin.
const ROUGH_CELLS: u64 = 500_000;
/// Cells at which the degree of the surface is decided.
const DEGREE_CELLS: u64 = 60_000;

/// Both models at one coarseness, in memory.
pub(super) struct Level {
    factor: u64,
    pub template: MemoryHeights,
    pub other: MemoryHeights,
}

impl Level {
    /// The pair at this level.
    pub fn pair<'a>(&'a self, full: &'a Pair<'a>) -> Pair<'a> {
        // The other's means have about the template's cells already.
        Pair { template: &self.template, other: &self.other, finer: 1, ..*full }
    }
}

/// From fine to coarse. The first holds no more cells than fit in memory.
pub(super) fn pyramid(full: &Pair<'_>, options: &Options<'_>) -> Result<Vec<Level>> {
    let enough = if options.method == Method::NuthKaab { ROUGH_CELLS } else { u64::MAX };
    let limit = options.memory_cells.min(enough).max(4096);
    let factor = factor_for(full, limit);
    let template = load(full.template, factor, options.means)?;
    let other = load(full.other, factor * full.finer, options.means)?;
    let mut levels = vec![Level { factor, template, other }];
    while let Some(last) = levels.last() {
        let (grid, other) = (last.template.grid(), last.other.grid());
        let narrowest = grid.width.min(grid.height).min(other.width.min(other.height));
        if grid.width.max(grid.height) <= SEARCH_CELLS || narrowest < 32 {
            break;
        }
        let template = load(&last.template, 2, options.means)?;
        let other = load(&last.other, 2, options.means)?;
        levels.push(Level { factor: last.factor * 2, template, other });
    }
    Ok(levels)
}

/// Where the degree of the surface is decided: as coarse as with the least memory, whatever there is, and from the
/// cells as they are.
pub(super) fn level_of_degree(full: &Pair<'_>, finest: &Level, options: &Options<'_>) -> Result<Level> {
    let factor = factor_for(full, DEGREE_CELLS);
    // Means of means have other bits.
    let held = finest.factor == 1 && full.finer == 1;
    let (template, other): (&dyn Heights, &dyn Heights) =
        if held { (&finest.template, &finest.other) } else { (full.template, full.other) };
    Ok(Level {
        factor,
        template: load(template, factor, options.means)?,
        other: load(other, factor * full.finer, options.means)?,
    })
}

/// The power of two over which means leave no more than so many cells of the template, and four times as many of the
/// other.
fn factor_for(full: &Pair<'_>, limit: u64) -> u64 {
    let cells = |grid: Grid, factor: u64| (grid.width / factor + 1) * (grid.height / factor + 1);
    let mut factor = 1;
    while cells(full.template.grid(), factor) > limit || cells(full.other.grid(), factor * full.finer) > 4 * limit {
        factor *= 2;
    }
    factor
}

/// Means over blocks, in memory.
fn load(source: &dyn Heights, factor: u64, means: Means) -> Result<MemoryHeights> {
    let averaged = Averaged::new(source, factor);
    let grid = averaged.grid();
    // Tiles as large as before in cells of the source.
    let part = |px: u64| (px / factor).max(BLOCK_PX);
    let side = Means { tile_px: part(means.tile_px), tile_rows_px: part(means.tile_rows_px), ..means };
    let tiles = side.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, Vec::new, |parts, core| {
        if averaged.holds_nothing(core.into()) {
            return Ok(());
        }
        let mut values = Vec::new();
        averaged.read(core.into(), &mut values)?;
        parts.push((core, values));
        Ok(())
    })?;
    let mut whole = vec![f64::NAN; (grid.width * grid.height) as usize];
    for (core, values) in parts.into_iter().flatten() {
        for (row, line) in (core.y..).zip(values.chunks_exact(core.width as usize)) {
            let from = (row * grid.width + core.x) as usize;
            whole[from..from + line.len()].copy_from_slice(line);
        }
    }
    Ok(MemoryHeights::new(grid, whole))
}
