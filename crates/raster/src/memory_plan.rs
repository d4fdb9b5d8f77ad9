//! What will be held in memory, worked out before the first read.
//!
//! `--memory` bounds the peak resident size of the whole process, libraries and mapped pages included. What the process
//! already takes when the plan is made (GDAL, PROJ, the colour table) is measured, not guessed; the rest is shared out
//! among the workers. When the wished tiles do not fit they are shrunk, then workers are dropped; when not even one
//! worker with the smallest tile fits, the plan is refused with the numbers.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::window::TileGrid;
use crate::{BlockLayout, RasterInfo};

/// The smallest `--memory` that is accepted: GDAL's libraries alone take 46 MiB.
pub const SMALLEST_BUDGET_BYTES: u64 = 112 << 20;
/// The default of `--memory`.
pub const DEFAULT_BUDGET_BYTES: u64 = 512 << 20;

/// Kept free of the budget for matching, outputs and the allocator's slack.
const RESERVE_BYTES: u64 = 10 << 20;
/// Stack, channel entries and codec state of one worker.
const WORKER_OVERHEAD_BYTES: u64 = 1 << 20;
/// The faces of tiles get what the plan leaves over up to this: enough along a row of tiles of an image 100,000 pixels
/// wide.
const ENOUGH_SEAM_BYTES: u64 = 44 << 20;
/// Pixels of a default tile: enough that few marks straddle edges, little enough to stay near the cache.
const DEFAULT_TILE_PIXELS: u64 = 1024 * 1024;
/// A default band of strips is wide and low: more pixels, or most marks would straddle its edges.
const DEFAULT_BAND_PIXELS: u64 = 4 * DEFAULT_TILE_PIXELS;

/// What the caller asks for.
#[derive(Clone, Debug)]
pub struct PlanOptions {
    /// Side of a tile in pixels, taken literally when it fits; chosen from layout and budget when `None`.
    pub tile_px: Option<u64>,
    pub threads: usize,
    pub memory_budget_bytes: u64,
    /// What the process holds before the scan. Measured by [`resident_bytes`] in the program, fixed in tests.
    pub baseline_bytes: u64,
    /// What the raster source may keep of decoded blocks.
    pub cache_bytes: u64,
}

/// What will be done, with its price.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ScanPlan {
    pub tile_width_px: u64,
    pub tile_height_px: u64,
    pub halo_px: u64,
    pub tiles: u64,
    pub workers: usize,
    pub baseline_bytes: u64,
    pub bytes_per_worker: u64,
    pub cache_bytes: u64,
    /// Pixels along the faces of tiles.
    #[serde(default)]
    pub seam_bytes: u64,
    pub reserve_bytes: u64,
    /// The sum: what the process may take at its peak.
    pub planned_bytes: u64,
    pub memory_budget_bytes: u64,
    /// What was changed to make it fit, in words.
    pub notes: Vec<String>,
    /// Empty in a plan that was read back from a result: the numbers above are what it keeps.
    #[serde(skip, default = "no_tiles")]
    pub grid: TileGrid,
}

fn no_tiles() -> TileGrid {
    TileGrid::new(0, 0, 1, 1, 0)
}

impl ScanPlan {
    /// One line for the log: buffers × size = bytes ≤ budget.
    pub fn line(&self) -> String {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        format!(
            "{} tiles of {}×{} px, halo {} px; {} workers × {:.1} MiB + cache {:.1} MiB + seams {:.1} MiB + base {:.1} MiB + reserve {:.1} MiB = {:.1} MiB ≤ {:.1} MiB",
            self.tiles,
            self.tile_width_px,
            self.tile_height_px,
            self.halo_px,
            self.workers,
            mib(self.bytes_per_worker),
            mib(self.cache_bytes),
            mib(self.seam_bytes),
            mib(self.baseline_bytes),
            mib(self.reserve_bytes),
            mib(self.planned_bytes),
            mib(self.memory_budget_bytes),
        )
    }
}

/// Share of the budget that a raster source may keep of decoded blocks, so that neighbouring tiles need not decode them
/// again. Known before the source is opened.
pub fn cache_share_bytes(memory_budget_bytes: u64) -> u64 {
    // 8 MiB at the smallest budget, 88 MiB at the default.
    (memory_budget_bytes.saturating_sub(SMALLEST_BUDGET_BYTES) / 5 + (8 << 20)).min(memory_budget_bytes / 5)
}

/// Fits the scan into the budget.
///
/// # Errors
/// [`Error::Limit`] with the smallest budget that works, when not even one worker fits.
pub fn plan(info: &RasterInfo, halo_px: u64, options: &PlanOptions) -> Result<ScanPlan> {
    if options.memory_budget_bytes < SMALLEST_BUDGET_BYTES {
        return Err(Error::Limit {
            what: "--memory is below what the libraries need".into(),
            needed: SMALLEST_BUDGET_BYTES,
            allowed: options.memory_budget_bytes,
            remedy: "give --memory 112M or more".into(),
        });
    }
    let mut notes = Vec::new();
    let (mut tile_width, mut tile_height) = wished_tile(info, options.tile_px);
    let mut workers = if info.sequential { options.threads.min(2) } else { options.threads }.max(1);
    let least_seam_bytes = options.cache_bytes / 2;
    // Chunks that are larger than the cache are never kept.
    let cache_bytes = if info.chunk_bytes > options.cache_bytes { 0 } else { options.cache_bytes };
    let fixed = options.baseline_bytes + cache_bytes + least_seam_bytes + RESERVE_BYTES;
    let available = options.memory_budget_bytes.saturating_sub(fixed);
    let fits = |width: u64, height: u64, workers: usize| {
        worker_bytes(info, width, height, halo_px).saturating_mul(workers as u64) <= available
    };
    let wished = (tile_width, tile_height, workers);
    while !fits(tile_width, tile_height, workers) {
        match shrunk(info, tile_width, tile_height) {
            // Better half the workers than tiles so small that they are all halo.
            Some((width, height)) if workers == 1 || width * height >= 256 * 256 => {
                (tile_width, tile_height) = (width, height);
            }
            _ if workers > 1 => workers -= 1,
            _ => {
                let needed = fixed + worker_bytes(info, tile_width, tile_height, halo_px);
                return Err(Error::Limit {
                    what: format!("{}: one unit of reading does not fit the memory budget", info.path.display()),
                    needed,
                    allowed: options.memory_budget_bytes,
                    remedy: format!(
                        "give --memory {}M, or retile the file: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE -co BIGTIFF=IF_SAFER {} tiled.tif",
                        needed.div_ceil(1 << 20),
                        info.path.display()
                    ),
                });
            }
        }
    }
    if wished != (tile_width, tile_height, workers) {
        notes.push(format!(
            "tiles of {}×{} px with {} workers do not fit {} MiB: using {}×{} px with {}",
            wished.0,
            wished.1,
            wished.2,
            options.memory_budget_bytes >> 20,
            tile_width,
            tile_height,
            workers
        ));
    }
    let grid = TileGrid::new(info.width, info.height, tile_width, tile_height, halo_px);
    workers = workers.min(grid.len().max(1) as usize);
    let bytes_per_worker = worker_bytes(info, grid.tile_width(), grid.tile_height(), halo_px);
    // Sizes of tiles are halved until they fit, which leaves something over; what the seams cannot hold is decoded
    // again.
    let left_bytes = available.saturating_sub(bytes_per_worker * workers as u64);
    let spare_bytes = left_bytes.min(ENOUGH_SEAM_BYTES.saturating_sub(least_seam_bytes));
    Ok(ScanPlan {
        tile_width_px: grid.tile_width(),
        tile_height_px: grid.tile_height(),
        halo_px,
        tiles: grid.len(),
        workers,
        baseline_bytes: options.baseline_bytes,
        bytes_per_worker,
        cache_bytes,
        seam_bytes: least_seam_bytes + spare_bytes,
        reserve_bytes: RESERVE_BYTES,
        planned_bytes: fixed + spare_bytes + bytes_per_worker * workers as u64,
        memory_budget_bytes: options.memory_budget_bytes,
        notes,
        grid,
    })
}

/// Width and height of the tiles before the budget is looked at.
fn wished_tile(info: &RasterInfo, tile_px: Option<u64>) -> (u64, u64) {
    match (tile_px, info.layout) {
        (None, BlockLayout::Tiles { width, height }) => {
            let wished = DEFAULT_TILE_PIXELS.isqrt();
            let side = |block: u64| block * (wished / block.max(1)).max(1);
            (side(width).min(info.width), side(height).min(info.height))
        }
        (tile_px, BlockLayout::Strips { rows }) => {
            let pixels = tile_px.map_or(DEFAULT_BAND_PIXELS, |side| side.saturating_mul(side));
            let width = info.width.min(pixels).max(1);
            let mut band = (pixels / width).clamp(1, info.height.max(1));
            if tile_px.is_none() && !info.sequential {
                // While one worker decodes a strip, another that needs rows of it can only wait.
                band = band.max(rows.min(info.height));
            }
            // Whole strips where the band holds at least one.
            (width, if band >= rows { band - band % rows.max(1) } else { band })
        }
        (Some(side), _) => (side.min(info.width), side.min(info.height)),
    }
}

/// The next smaller tile, or `None` when it cannot shrink.
fn shrunk(info: &RasterInfo, width: u64, height: u64) -> Option<(u64, u64)> {
    if let BlockLayout::Strips { rows } = info.layout {
        // A strip is decoded whole whatever the tile's width.
        return match height {
            0 | 1 => None,
            _ if height / 2 >= rows => Some((width, height / 2 / rows * rows)),
            _ => Some((width, height / 2)),
        };
    }
    let (half_width, half_height) = (width.div_ceil(2), height.div_ceil(2));
    (width.max(height) > 64).then_some(if width >= height { (half_width, height) } else { (width, half_height) })
}

/// What one worker holds: the pixels of the read window in whole file blocks (all bands, since they are decoded
/// together), one block being decoded, masks, and the labeller's rows.
fn worker_bytes(info: &RasterInfo, tile_width: u64, tile_height: u64, halo_px: u64) -> u64 {
    let pixel_bytes = (info.bands * info.sample.bytes()) as u64;
    let read_width = (tile_width + 2 * halo_px).min(info.width);
    let read_height = (tile_height + 2 * halo_px).min(info.height);
    let whole_blocks = |size: u64, block: u64, limit: u64, aligned: bool| {
        let overhang = if aligned && halo_px == 0 { 0 } else { block };
        (size.div_ceil(block.max(1)) * block + overhang).min(limit.div_ceil(block.max(1)) * block)
    };
    let (columns, rows) = match info.layout {
        BlockLayout::Tiles { width, height } => (
            whole_blocks(read_width, width, info.width, tile_width.is_multiple_of(width.max(1))),
            whole_blocks(read_height, height, info.height, tile_height.is_multiple_of(height.max(1))),
        ),
        BlockLayout::Strips { rows } => {
            // A strip that streams comes in chunks of a few rows.
            let row_bytes = info.width.saturating_mul(pixel_bytes).max(1);
            let rows = if info.sequential { (info.chunk_bytes / row_bytes).clamp(1, rows.max(1)) } else { rows };
            (info.width, whole_blocks(read_height, rows, info.height, tile_height.is_multiple_of(rows.max(1))))
        }
    };
    let pixels = columns.saturating_mul(rows).saturating_mul(pixel_bytes);
    let masks = 3 * (read_width.div_ceil(64) * 8) * read_height;
    // Two rows of runs at worst, with a node each.
    let labels = read_width * 160;
    pixels + masks + labels + 2 * info.chunk_bytes + WORKER_OVERHEAD_BYTES
}

/// Resident size of this process now, where the system tells it.
pub fn resident_bytes() -> Option<u64> {
    let statm = std::fs::read_to_string("/proc/self/statm").ok()?;
    let pages: u64 = statm.split_whitespace().nth(1)?.parse().ok()?;
    Some(pages * rustix::param::page_size() as u64)
}

/// The largest resident size this process has had, where the system tells it.
pub fn peak_resident_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib * 1024)
}

/// Shared by the commands: what is resident now, or a generous guess where it cannot be measured.
pub fn baseline_bytes() -> u64 {
    resident_bytes().unwrap_or(64 << 20)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RasterSource;
    use crate::memory::MemorySource;

    /// 22,000 × 20,000 px, RGB, in strips of so many rows.
    fn strips(rows: u64, sequential: bool) -> RasterInfo {
        let small = MemorySource::rgb8(1, 1, vec![0; 3]);
        let (width, height) = (22_000, 20_000);
        let chunk_bytes = width * 3 * if sequential { 4 } else { rows };
        RasterInfo {
            width,
            height,
            chunk_bytes,
            sequential,
            layout: BlockLayout::Strips { rows },
            ..small.info().clone()
        }
    }

    fn planned(info: &RasterInfo, tile_px: Option<u64>, memory_mib: u64) -> ScanPlan {
        let memory_budget_bytes = memory_mib << 20;
        let cache_bytes = cache_share_bytes(memory_budget_bytes);
        let options = PlanOptions { tile_px, threads: 2, memory_budget_bytes, baseline_bytes: 40 << 20, cache_bytes };
        plan(info, 0, &options).expect("fits")
    }

    #[test]
    fn two_workers_never_need_the_same_strip() {
        for rows in [1, 16, 100, 256, 300] {
            let plan = planned(&strips(rows, false), None, 512);
            assert_eq!(plan.tile_height_px % rows, 0, "{rows}: {}", plan.line());
            assert_eq!((plan.tile_width_px, plan.workers), (22_000, 2));
        }
        // Unless tiles of another size are asked for, there is no memory for them, or they come row by row anyway.
        for plan in [
            planned(&strips(256, false), Some(1024), 512),
            planned(&strips(256, false), None, 160),
            planned(&strips(20_000, true), None, 512),
        ] {
            assert!(plan.tile_height_px < 256, "{}", plan.line());
        }
    }
}
