//! Tiles handed to threads; what they gather is joined at the end.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use crate::error::Result;
use crate::window::{TileGrid, Window};

/// Side of the blocks within which sums are made in one fixed order: tiles are whole multiples of it.
pub const BLOCK_PX: u64 = 16;

/// How the work is cut up. Neither number changes a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Means {
    /// Width of the tiles, brought up to a multiple of [`BLOCK_PX`].
    pub tile_px: u64,
    /// Their height, likewise.
    pub tile_rows_px: u64,
    pub threads: usize,
}

impl Default for Means {
    fn default() -> Self {
        Means::square(512, 1)
    }
}

impl Means {
    /// Square tiles of this side, pixels, worked on by so many threads.
    pub fn square(tile_px: u64, threads: usize) -> Means {
        Means { tile_px, tile_rows_px: tile_px, threads }
    }

    /// Tiles of as many cells, flat and wide: for copies that lie row by row on a disk.
    pub fn flat(self) -> Means {
        const LEAST_ROWS_PX: u64 = 2 * BLOCK_PX;
        let cells = self.tile_px * self.tile_rows_px;
        let rows = (cells.isqrt() / 4).next_multiple_of(BLOCK_PX).max(LEAST_ROWS_PX);
        if rows >= self.tile_rows_px {
            return self;
        }
        Means { tile_px: cells / rows, tile_rows_px: rows, ..self }
    }

    /// Tiles whose cells stay in a core's cache from one step to the next: for copies in memory, where a tile costs no
    /// more than its border.
    pub fn cached(self) -> Means {
        Means { tile_px: self.tile_px.min(256), tile_rows_px: self.tile_rows_px.min(64), ..self }
    }

    /// Tiles small enough that every thread has some of a raster that is no tile long; one thread where starting more
    /// takes as long as the work.
    pub fn shared_out(self, width: u64, height: u64) -> Means {
        const FEWEST_CELLS: u64 = 1 << 17;
        const TILES_A_THREAD: u64 = 4;
        let (cells, threads) = (width * height, self.threads as u64);
        if cells < FEWEST_CELLS {
            return Means { threads: 1, ..self };
        }
        if self.tiles(width, height).len() >= TILES_A_THREAD * threads {
            return self;
        }
        Means::square((cells / (TILES_A_THREAD * threads)).isqrt().max(BLOCK_PX), self.threads)
    }

    /// The tiles of a raster.
    pub fn tiles(&self, width: u64, height: u64) -> TileGrid {
        let [across, down] = [self.tile_px, self.tile_rows_px].map(|px| px.max(1).next_multiple_of(BLOCK_PX));
        TileGrid::new(width, height, across, down, 0)
    }
}

/// Runs `job` over all tiles, `threads` at a time, each with a state of its own, and returns the states.
///
/// # Errors
/// The first error of a job; the others stop at their next tile.
pub fn gather<S: Send>(
    tiles: &TileGrid,
    threads: usize,
    state: impl Fn() -> S + Sync,
    job: impl Fn(&mut S, Window) -> Result<()> + Sync,
) -> Result<Vec<S>> {
    let (next, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let work = || -> Result<S> {
        let mut mine = state();
        while !stop.load(Ordering::Relaxed) {
            let id = next.fetch_add(1, Ordering::Relaxed);
            if id >= tiles.len() {
                break;
            }
            job(&mut mine, tiles.tile(id).core).inspect_err(|_| stop.store(true, Ordering::Relaxed))?;
        }
        Ok(mine)
    };
    let threads = threads.max(1).min(tiles.len().max(1) as usize);
    if threads == 1 {
        return Ok(vec![work()?]);
    }
    std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        handles.into_iter().map(|h| h.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))).collect()
    })
}

/// So many things, made on several threads; the same whatever their number.
pub fn each<T: Send>(count: usize, threads: usize, make: impl Fn(usize) -> T + Sync) -> Vec<T> {
    let threads = threads.clamp(1, count.max(1));
    let make = &make;
    let mut made: Vec<(usize, T)> = std::thread::scope(|scope| {
        let part = |thread: usize| (thread..count).step_by(threads).map(|k| (k, make(k))).collect::<Vec<_>>();
        let others: Vec<_> = (1..threads).map(|thread| scope.spawn(move || part(thread))).collect();
        let mut made = part(0);
        for other in others {
            made.extend(other.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        }
        made
    });
    made.sort_by_key(|(k, _)| *k);
    made.into_iter().map(|(_, made)| made).collect()
}
