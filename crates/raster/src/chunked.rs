//! What both readers share: a raster as a grid of chunks, each decoded once and handed out without a copy.

use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use super::cache::{Chunk, ChunkCache};
use super::path_text::quoted;
use super::{Block, Piece, PieceData, RasterInfo, RasterSource, ReadStats, SampleType};
use crate::error::Result;
use crate::window::{TileGrid, Window};

/// Small file blocks are grouped to chunks of about this size, so that a chunk is a good unit of work.
pub const CHUNK_BYTES: u64 = 256 << 10;

/// What a decoder adds to the counts.
#[derive(Debug, Default)]
pub struct Counters {
    pub blocks_decoded: AtomicU64,
    pub blocks_skipped: AtomicU64,
    pub bytes_read: AtomicU64,
}

impl Counters {
    /// Adds blocks decoded, blocks passed over and bytes read.
    pub fn add(&self, decoded: u64, skipped: u64, bytes: u64) {
        self.blocks_decoded.fetch_add(decoded, Ordering::Relaxed);
        self.blocks_skipped.fetch_add(skipped, Ordering::Relaxed);
        self.bytes_read.fetch_add(bytes, Ordering::Relaxed);
    }
}

/// The part of a reader that knows its format.
pub trait ChunkDecoder: Send + Sync {
    fn info(&self) -> &RasterInfo;

    /// The grid of chunks; no halo.
    fn grid(&self) -> &TileGrid;

    /// Decodes chunk `id` of the grid.
    ///
    /// # Errors
    /// When it cannot be read or is broken.
    fn decode(&self, id: u64, counters: &Counters) -> Result<Chunk>;

    fn prefetch(&self, _window: Window) {}

    /// The bytes of `window` will not be wanted again.
    fn release(&self, _window: Window) {}
}

/// A [`RasterSource`] made of a [`ChunkDecoder`] and a cache.
pub struct ChunkedSource<D> {
    decoder: D,
    cache: ChunkCache,
    counters: Counters,
}

impl<D: ChunkDecoder> ChunkedSource<D> {
    /// A source that keeps up to `cache_bytes` of decoded chunks.
    pub fn new(decoder: D, cache_bytes: u64) -> Self {
        ChunkedSource { decoder, cache: ChunkCache::new(cache_bytes), counters: Counters::default() }
    }

    fn piece(&self, id: u64, window: Window) -> Result<Option<Piece>> {
        let chunk_window = self.decoder.grid().tile(id).core;
        let part = chunk_window.intersect(&window);
        if part.is_empty() {
            return Ok(None);
        }
        let chunk = self.cache.get(id, || self.decoder.decode(id, &self.counters))?;
        let offset = chunk.offset
            + (part.y - chunk_window.y) as usize * chunk.row_stride
            + (part.x - chunk_window.x) as usize * chunk.pixel_stride;
        let empty = chunk.data.is_none();
        let data = chunk.data.unwrap_or_else(|| match self.decoder.info().sample {
            SampleType::U8 => PieceData::U8(Default::default()),
            SampleType::U16 => PieceData::U16(Default::default()),
        });
        let (row_stride, pixel_stride) = (chunk.row_stride, chunk.pixel_stride);
        Ok(Some(Piece { window: part, data, offset, row_stride, pixel_stride, empty }))
    }
}

impl<D: ChunkDecoder> RasterSource for ChunkedSource<D> {
    fn info(&self) -> &RasterInfo {
        self.decoder.info()
    }

    fn read(&self, window: Window) -> Result<Block> {
        self.read_seen(window, &mut |_| ())
    }

    fn read_seen(&self, window: Window, see: &mut dyn FnMut(&Piece)) -> Result<Block> {
        let info = self.decoder.info();
        if window.is_empty() || !info.bounds().contains_window(&window) {
            return Err(crate::Error::usage(
                format!("{}: window {window:?} does not lie in the raster", info.path.display()),
                format!("ask for pixels within {} x {}", info.width, info.height),
            ));
        }
        let grid = self.decoder.grid();
        let (first_column, last_column) = (window.x / grid.tile_width(), (window.right() - 1) / grid.tile_width());
        let (first_row, last_row) = (window.y / grid.tile_height(), (window.bottom() - 1) / grid.tile_height());
        let mut pieces = Vec::new();
        for row in first_row..=last_row {
            for column in first_column..=last_column {
                let piece = self.piece(row * grid.columns() + column, window)?;
                piece.iter().for_each(&mut *see);
                pieces.extend(piece);
            }
        }
        Ok(Block { window, pieces })
    }

    fn prefetch(&self, window: Window) {
        self.decoder.prefetch(window);
    }

    fn release(&self, window: Window) {
        let grid = self.decoder.grid();
        self.cache.forget(|id| window.contains_window(&grid.tile(id).core));
        self.decoder.release(window);
    }

    fn stats(&self) -> ReadStats {
        ReadStats {
            blocks_decoded: self.counters.blocks_decoded.load(Ordering::Relaxed),
            blocks_skipped: self.counters.blocks_skipped.load(Ordering::Relaxed),
            bytes_read: self.counters.bytes_read.load(Ordering::Relaxed),
        }
    }
}

/// Chunk size in file blocks, across and down: as many blocks as fill [`CHUNK_BYTES`]. Blocks of more than half of that
/// stay alone: a block on its own is handed out as it was decoded, in a group it is copied.
pub fn group_blocks(block: (u64, u64), raster: (u64, u64), bytes_per_pixel: u64) -> (u64, u64) {
    let block_bytes = (block.0 * block.1).saturating_mul(bytes_per_pixel).max(1);
    let wanted = (CHUNK_BYTES / block_bytes).max(1);
    let across = raster.0.div_ceil(block.0);
    let down = raster.1.div_ceil(block.1);
    if across == 1 {
        return (1, wanted.min(down));
    }
    // About square, so that a chunk serves a tile of any shape.
    let side = (wanted as f64).sqrt().ceil() as u64;
    (side.min(across), side.min(down))
}

/// The command that makes a tiled copy.
pub(crate) fn retile_remedy(path: &Path) -> String {
    format!(
        "retile it: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE -co PREDICTOR=2 -co BIGTIFF=IF_SAFER {} tiled.tif, \
         or raise --memory",
        quoted(path)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_blocks_are_grouped_and_large_ones_are_not() {
        assert_eq!(group_blocks((512, 512), (22_039, 20_051), 3), (1, 1));
        assert_eq!(group_blocks((256, 256), (22_039, 20_051), 3), (1, 1));
        assert_eq!(group_blocks((22_039, 1), (22_039, 20_051), 3), (1, 3));
        assert_eq!(group_blocks((100, 1), (100, 50), 1), (1, 50));
        assert_eq!(group_blocks((16, 16), (10_000, 10_000), 1), (32, 32));
    }
}
