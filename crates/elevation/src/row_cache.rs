//! GDAL's cache of blocks, as large as its functions need that go through a raster row by row: where a row of blocks
//! does not fit, each block is decoded again for each row of cells.
#![allow(unsafe_code)]

use std::path::Path;

use gdal::Dataset;

use crate::error::{Error, Result};

/// What a run takes beside rows of blocks.
const LIBRARIES_BYTES: u64 = 64 << 20;
/// Side of the blocks that are written, at most.
const BLOCK_PX: u64 = 256;
/// Cells in a row of blocks that is written, at most: wide rasters get lower blocks.
const ROW_CELLS: u64 = 1 << 21;
const LEAST_BLOCK_PX: u64 = 16;
/// Bytes of a cell that is written, at most: a height, or red, green, blue and opacity.
const CELL_BYTES: u64 = 4;

/// Rows of the blocks in which a raster of this width is written.
pub(crate) fn block_rows(width: u64) -> u64 {
    let mut rows = BLOCK_PX;
    while rows > LEAST_BLOCK_PX && rows * width > ROW_CELLS {
        rows /= 2;
    }
    rows
}

/// Bytes of a row of the blocks that are written.
fn written_row_bytes(width: u64, height: u64) -> u64 {
    width.next_multiple_of(BLOCK_PX) * block_rows(width).min(height) * CELL_BYTES
}

/// What becomes of the rows that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Use {
    /// Nothing that the cache holds.
    Followed,
    /// A raster of the same size, in blocks of [`block_rows`].
    Copied,
}

/// Holds the cache at its size; gives it back its former one when it is dropped.
pub(crate) struct RowCache {
    before: i64,
}

/// Rows of the blocks that a virtual raster reads from, which it does not tell.
const BELOW_VIRTUAL: usize = 512;
/// How much GDAL copies at a time.
const SWATH: &str = "GDAL_SWATH_SIZE";

impl RowCache {
    /// Room for a row of blocks of the first band, and for those that are written.
    ///
    /// # Errors
    /// [`Error::Limit`] when the memory does not hold them, and when the raster has no band.
    pub(crate) fn hold(path: &Path, dataset: &Dataset, purpose: Use, memory_budget_bytes: u64) -> Result<RowCache> {
        let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
        let (across, mut down) = band.block_size();
        if dataset.driver().short_name() == "VRT" {
            down = down.max(BELOW_VIRTUAL);
        }
        let (width, height) = (dataset.raster_size().0 as u64, dataset.raster_size().1 as u64);
        let down = (down as u64).min(height);
        let read_bytes = width.next_multiple_of(across.max(1) as u64) * down * u64::from(band.band_type().bytes());
        let row_bytes = match purpose {
            Use::Followed => 0,
            Use::Copied => written_row_bytes(width, height),
        };
        // The rows that are computed and those that are written; what is copied lies beside the cache.
        let cache_bytes = read_bytes + 2 * row_bytes;
        let needed = LIBRARIES_BYTES + cache_bytes + row_bytes;
        if needed > memory_budget_bytes {
            return Err(Error::Limit {
                what: format!("{}: a row of its blocks, {width} cells wide and {down} high", path.display()),
                needed,
                allowed: memory_budget_bytes,
                remedy: format!("give --memory {}M, or write it in lower blocks", needed.div_ceil(1 << 20)),
            });
        }
        if purpose == Use::Copied {
            // Whole rows of blocks: for a part of a row GDAL would compute whole rows again.
            gdal::config::set_config_option(SWATH, &row_bytes.to_string()).map_err(|e| Error::gdal(path, e))?;
        }
        // SAFETY: both calls read or set one number of GDAL's, under its own lock.
        let before = unsafe {
            let before = gdal_sys::GDALGetCacheMax64();
            gdal_sys::GDALSetCacheMax64(before.max(cache_bytes as i64 + (1 << 20)));
            before
        };
        Ok(RowCache { before })
    }
}

impl Drop for RowCache {
    fn drop(&mut self) {
        gdal::config::clear_config_option(SWATH).expect("the key holds no zero byte");
        // SAFETY: sets one number of GDAL's, under its own lock.
        unsafe { gdal_sys::GDALSetCacheMax64(self.before) }
    }
}
