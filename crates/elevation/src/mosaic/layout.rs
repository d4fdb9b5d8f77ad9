//! The grid of a mosaic, and the sources and the index that lie on it.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use autoref_raster::protected::protect;

use crate::couple::TURN_DEGREES;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::output;

use super::alike::{check_alike, check_one_crs};
use super::companion::{companion_path, companions, open_companion};
use super::rule::Choice;
use super::source::{SNAP_PX, Source};
use super::turn;

/// Blocks of a TIFF whose places are listed in less than two gigabytes.
const MOST_BLOCKS: f64 = 1e8;

/// Opens all sources, and lays out the grid that holds them: cells of the first one's size and phase.
///
/// # Errors
/// When `resolution` is no positive length, there is no input, a source or companion cannot be opened, sources differ
/// in bands, type of samples, what bands mean, palette or CRS, two of them have one companion, a companion does not lie
/// on its source, or the grid has more than 2³¹ − 1 rows or columns, or more blocks than a file.
pub fn open_all(inputs: &[PathBuf], choice: &Choice, resolution: Option<f64>) -> Result<(Vec<Source>, Grid)> {
    if resolution.is_some_and(|r| !(r > 0.0 && r.is_finite())) {
        return Err(Error::usage("--resolution is no positive length", "give the side of a cell in map units"));
    }
    let mut sources: Vec<Source> = inputs.iter().map(|path| Source::open(path)).collect::<Result<_>>()?;
    check_alike(&sources)?;
    companions(inputs, choice).iter().for_each(|path| protect(path));
    turn::bring_together(&mut sources);
    let origin = sources[0].grid;
    let (step_x, step_y) = resolution.map_or((origin.step_x, origin.step_y), |r| (r, -r));
    let bounds = sources
        .iter()
        .map(|s| s.grid.bounds())
        .fold(origin.bounds(), |a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]);
    // Whole cells from the first one's corner; a hundredth of a cell is no reason for another one.
    let cells = |from: f64, to: f64, step: f64| ((to - from) / step.abs() - SNAP_PX).ceil().max(0.0);
    let turn = turn::one_turn(&sources, bounds);
    let west = turn.unwrap_or(bounds[0]);
    let (left, up) = (cells(west, origin.x0, step_x), cells(origin.y0, bounds[3], step_y));
    let across = match turn {
        Some(_) => cells(0.0, TURN_DEGREES, step_x),
        None => left + cells(origin.x0, bounds[2], step_x),
    };
    let grid = Grid {
        x0: origin.x0 - left * step_x,
        y0: origin.y0 - up * step_y,
        step_x,
        step_y,
        width: across.max(1.0) as u64,
        height: (up + cells(bounds[1], origin.y0, step_y)).max(1.0) as u64,
    };
    let block_px = output::block_px(sources[0].bands);
    let blocks = grid.width.div_ceil(block_px) as f64 * grid.height.div_ceil(block_px) as f64 * sources[0].bands as f64;
    if grid.width.max(grid.height) > i32::MAX as u64 || blocks > MOST_BLOCKS {
        return Err(Error::usage(
            format!("a mosaic of {} x {} cells", grid.width, grid.height),
            "give a larger --resolution, or look for a source far away from the others",
        ));
    }
    let mut taken = HashMap::new();
    for source in &mut sources {
        if turn.is_some() {
            turn::place_in(source, &grid)?;
        }
        source.snap(&grid);
        source.again.iter_mut().for_each(|again| again.snap(&grid));
        if let Choice::Min(pattern) = choice {
            let path = companion_path(&source.path, pattern);
            if let Some(other) = taken.insert(path.clone(), source.path.clone()) {
                return Err(Error::usage(
                    format!(
                        "{} is the companion of {} and of {}",
                        path.display(),
                        other.display(),
                        source.path.display()
                    ),
                    "give each source a companion of its own, named by the whole {stem}",
                ));
            }
            for again in &mut source.again {
                again.companion = Some(Box::new(open_companion(again, path.clone(), &grid)?));
            }
            source.companion = Some(Box::new(open_companion(source, path, &grid)?));
        }
    }
    Ok((sources, grid))
}

/// An index raster, which must have the mosaic's grid and the CRS of its sources.
///
/// # Errors
/// When it cannot be opened, or has another grid than `grid`, or another CRS than `first`.
pub fn open_index(path: &Path, first: &Source, grid: &Grid) -> Result<Source> {
    let mut index = Source::open(path)?;
    check_one_crs(first, &index).map_err(|e| match e {
        Error::Unsupported { what, remedy, .. } => Error::unsupported(path, what, remedy),
        other => other,
    })?;
    index.snap(grid);
    let same = index.on_grid && (index.grid.x0, index.grid.y0) == (grid.x0, grid.y0);
    if !same || (index.grid.width, index.grid.height) != (grid.width, grid.height) {
        return Err(Error::unsupported(
            path,
            "an index on another grid than the mosaic's",
            "write it with --write-index",
        ));
    }
    index.bands = 1;
    Ok(index)
}
