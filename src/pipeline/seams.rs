//! Pixels along the faces of tiles, kept until the regions that straddle them are complete, so that no file block must
//! be kept or decoded again for a mark that lies in two tiles.

use std::collections::HashMap;
use std::sync::Arc;

use crate::detector::Detector;
use crate::segment::label::Region;
use autoref_raster::window::{Tile, TileGrid, Window};
use autoref_raster::{Block, BufferPool, Piece, PieceData, PooledBytes, RasterInfo, Samples};

/// With more parts than this per 1024 pixels of a tile's sides whole bands along the faces are kept instead.
const MANY: u64 = 100;

/// What is kept of one tile: parts of its core, copied out of the file blocks.
#[derive(Default)]
pub(super) struct Seam {
    parts: Vec<Block>,
    bytes: u64,
}

impl Seam {
    /// Whatever of this tile the examination of a straddling region can ask for: a margin along every face for regions
    /// of the neighbours, and the surroundings of its own regions as far as they may grow beyond the face.
    pub fn of_tile<'a>(
        (block, tile): (&Block, &Tile),
        straddling: impl Iterator<Item = &'a Region>,
        open: impl Iterator<Item = &'a Region>,
        detector: &dyn Detector,
        info: &RasterInfo,
        pool: &BufferPool,
    ) -> Seam {
        let (core, bounds, margin) = (tile.core, info.bounds(), detector.patch_margin_px());
        let largest = detector.largest_mark_px();
        let mut wanted: Vec<Window> = faces(core, bounds, margin).to_vec();
        wanted.extend(straddling.map(|region| region.bounds.grown(margin, &bounds)));
        let small = |side: u64| side <= largest;
        wanted.extend(open.map(|region| region.bounds).filter(|b| small(b.width) && small(b.height)).map(|b| {
            // A mark no larger than the largest that holds this part.
            let (x, y) = ((b.right()).saturating_sub(largest), b.bottom().saturating_sub(largest));
            Window { x, y, width: b.x + largest - x, height: b.y + largest - y }.grown(margin, &bounds)
        }));
        if wanted.len() as u64 > MANY * (1 + (core.width + core.height) / 1024) {
            wanted = faces(core, bounds, largest + 2 * margin).to_vec();
        }
        let mut seam = Seam::default();
        for window in joined(wanted.into_iter().map(|window| window.intersect(&core))) {
            seam.parts.push(part_of(block, window, pool));
        }
        seam.bytes = bytes_in(&seam.parts);
        seam
    }

    fn part_with(&self, window: &Window) -> Option<&Block> {
        self.parts.iter().find(|part| part.window.contains_window(window))
    }
}

/// Windows that cover the given ones, in which two are one where that is no larger.
fn joined(windows: impl Iterator<Item = Window>) -> Vec<Window> {
    let mut out: Vec<Window> = Vec::new();
    for mut window in windows.filter(|window| !window.is_empty()) {
        while let Some(i) = out.iter().position(|w| w.union(&window).area() <= w.area() + window.area()) {
            window = out.swap_remove(i).union(&window);
        }
        out.push(window);
    }
    out
}

/// The margin inside each face that is not the raster's edge.
fn faces(core: Window, bounds: Window, margin: u64) -> [Window; 4] {
    let none = Window::new(core.x, core.y, 0, 0);
    let shared = |yes: bool, window: Window| if yes { window.intersect(&core) } else { none };
    [
        shared(core.x > bounds.x, Window { width: margin, ..core }),
        shared(core.y > bounds.y, Window { height: margin, ..core }),
        shared(core.right() < bounds.right(), Window { x: core.right().saturating_sub(margin), width: margin, ..core }),
        shared(
            core.bottom() < bounds.bottom(),
            Window { y: core.bottom().saturating_sub(margin), height: margin, ..core },
        ),
    ]
}

/// Buffers for bands along the longer faces of a grid's tiles. Bands come and go with every tile: in buffers that are
/// used again they need no memory that was not touched before, and leave no holes in it. Samples of 16 bits lie in
/// memory of their own.
pub(super) fn band_pool(grid: &TileGrid, margin_px: u64, info: &RasterInfo) -> BufferPool {
    let longest = grid.tile_width().max(grid.tile_height());
    let band_bytes = longest * margin_px * info.bands as u64;
    BufferPool::new(4 * grid.columns() as usize, band_bytes as usize)
}

/// The part of a block inside a window, in one buffer of its own, from the pool where that is about as large.
fn part_of(block: &Block, window: Window, pool: &BufferPool) -> Block {
    let parts: Vec<(&Piece, Window)> = block
        .pieces
        .iter()
        .map(|piece| (piece, piece.window.intersect(&window)))
        .filter(|(_, part)| !part.is_empty())
        .collect();
    let samples_in = |wide: bool| -> usize {
        let held = parts.iter().filter(|(piece, _)| !piece.empty && is_wide(piece) == wide);
        held.map(|(piece, part)| part.area() as usize * piece.pixel_stride).sum()
    };
    let room = pool.buffer_bytes();
    let is_pooled = (room.div_ceil(2)..=room).contains(&samples_in(false));
    let mut narrow = if is_pooled { pool.take(samples_in(false)) } else { Vec::with_capacity(samples_in(false)) };
    narrow.clear();
    let mut wide: Vec<u16> = Vec::with_capacity(samples_in(true));
    let mut offsets = Vec::with_capacity(parts.len());
    for (piece, part) in &parts {
        offsets.push(if is_wide(piece) { wide.len() } else { narrow.len() });
        if piece.empty {
            continue;
        }
        let row_stride = part.width as usize * piece.pixel_stride;
        for y in part.y..part.bottom() {
            // The last pixel of a row may end where the buffer does: the stride is filled up.
            match piece.row(part.x, y, part.width).samples {
                Samples::U8(row) => {
                    narrow.extend_from_slice(row);
                    narrow.resize(narrow.len() + row_stride - row.len(), 0);
                }
                Samples::U16(row) => {
                    wide.extend_from_slice(row);
                    wide.resize(wide.len() + row_stride - row.len(), 0);
                }
            }
        }
    }
    let narrow = if is_pooled { pool.share(narrow) } else { Arc::new(PooledBytes { bytes: narrow, home: None }) };
    let wide = Arc::new(wide);
    let pieces = parts.into_iter().zip(offsets).map(|((piece, part), offset)| {
        if piece.empty {
            return Piece { window: part, ..piece.clone() };
        }
        let data = if is_wide(piece) { PieceData::U16(wide.clone()) } else { PieceData::U8(narrow.clone()) };
        let row_stride = part.width as usize * piece.pixel_stride;
        Piece { window: part, data, offset, row_stride, ..*piece }
    });
    Block { window, pieces: pieces.collect() }
}

fn is_wide(piece: &Piece) -> bool {
    matches!(piece.data, PieceData::U16(_))
}

/// What the parts take; a part's pieces share one buffer, or one of bytes and one of 16 bits.
fn bytes_in(parts: &[Block]) -> u64 {
    let of_part = |part: &Block| {
        let narrow = part.pieces.iter().find_map(|piece| match &piece.data {
            PieceData::U8(buffer) if !piece.empty => Some(buffer.bytes.capacity()),
            _ => None,
        });
        let wide = part.pieces.iter().find_map(|piece| match &piece.data {
            PieceData::U16(buffer) if !piece.empty => Some(2 * buffer.capacity()),
            _ => None,
        });
        (narrow.unwrap_or(0) + wide.unwrap_or(0)) as u64
    };
    parts.iter().map(of_part).sum()
}

/// The part of a piece inside a window, in the same memory.
fn narrowed(piece: &Piece, window: &Window) -> Option<Piece> {
    let part = piece.window.intersect(window);
    let offset = piece.offset
        + (part.y.saturating_sub(piece.window.y)) as usize * piece.row_stride
        + (part.x.saturating_sub(piece.window.x)) as usize * piece.pixel_stride;
    (!part.is_empty()).then(|| Piece { window: part, offset, ..piece.clone() })
}

/// The seams of the tiles that have come.
pub(super) struct Seams {
    grid: TileGrid,
    kept: HashMap<u64, Seam>,
    bytes: u64,
    capacity_bytes: u64,
    pool: BufferPool,
}

impl Seams {
    /// Keeps at most `capacity_bytes`; what does not fit is read from the file again.
    pub fn new(grid: TileGrid, capacity_bytes: u64, pool: BufferPool) -> Seams {
        Seams { grid, kept: HashMap::new(), bytes: 0, capacity_bytes, pool }
    }

    /// Keeps the seam of a tile while there is room.
    pub fn keep(&mut self, tile: u64, seam: Seam) {
        if self.bytes + seam.bytes <= self.capacity_bytes {
            self.bytes += seam.bytes;
            self.kept.insert(tile, seam);
        }
    }

    /// Keeps of a tile no more than its lowest rows: what a region can ask for when all tiles above and beside it have
    /// come.
    pub fn keep_lowest(&mut self, tile: u64, rows: u64) {
        let core = self.grid.tile(tile).core;
        let lowest =
            Window { y: core.bottom().saturating_sub(rows).max(core.y), height: rows.min(core.height), ..core };
        let Some(seam) = self.kept.get_mut(&tile).filter(|_| rows < core.height) else { return };
        let parts: Vec<Block> = std::mem::take(&mut seam.parts)
            .into_iter()
            .map(|part| match part.window.intersect(&lowest) {
                whole if whole == part.window => part,
                window => part_of(&part, window, &self.pool),
            })
            .filter(|part| !part.window.is_empty())
            .collect();
        let bytes = bytes_in(&parts);
        self.bytes = self.bytes - seam.bytes + bytes;
        *seam = Seam { parts, bytes };
    }

    /// The seam of a tile is needed no more.
    pub fn drop_tile(&mut self, tile: u64) {
        if let Some(seam) = self.kept.remove(&tile) {
            self.bytes -= seam.bytes;
        }
    }

    /// The pixels of a window, when every tile that it reaches into has kept them.
    pub fn block(&self, window: Window) -> Option<Block> {
        let mut pieces = Vec::new();
        for id in self.grid.tiles_of(&window) {
            let part = self.grid.tile(id).core.intersect(&window);
            let kept = self.kept.get(&id)?.part_with(&part)?;
            pieces.extend(kept.pieces.iter().filter_map(|piece| narrowed(piece, &part)));
        }
        Some(Block { window, pieces })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn windows_are_joined_where_that_saves() {
        let windows =
            [Window::new(0, 0, 10, 4), Window::new(8, 0, 10, 4), Window::new(50, 0, 3, 3), Window::new(0, 0, 0, 0)];
        assert_eq!(joined(windows.into_iter()), [Window::new(0, 0, 18, 4), Window::new(50, 0, 3, 3)]);
    }

    #[test]
    fn seams_give_the_pixels_of_the_source_or_nothing() {
        let (width, height) = (50u64, 40u64);
        let samples = (0..width * height * 3).map(|i| (i * 7919 % 251) as u8).collect();
        let source = MemorySource::rgb8(width, height, samples);
        let grid = TileGrid::new(width, height, 20, 20, 0);
        let pool = band_pool(&grid, 4, source.info());
        let mut seams = Seams::new(grid, 1 << 20, pool.clone());
        for tile in grid.iter() {
            let block = source.read(tile.read).expect("in memory");
            let parts: Vec<Block> = joined(faces(tile.core, source.info().bounds(), 4).into_iter())
                .into_iter()
                .map(|window| part_of(&block, window, &pool))
                .collect();
            seams.keep(tile.id, Seam { bytes: bytes_in(&parts), parts });
        }
        let window = Window::new(17, 17, 6, 5);
        let (kept, read) =
            (seams.block(window).expect("at a corner of four tiles"), source.read(window).expect("there"));
        let (kept, read) = (kept.to_patch(source.info()), read.to_patch(source.info()));
        assert_eq!((&kept.rgb, &kept.valid), (&read.rgb, &read.valid));
        assert!(seams.block(Window::new(15, 15, 8, 8)).is_none(), "goes deeper than what was kept");
        let before = seams.bytes;
        (0..3).for_each(|tile| seams.keep_lowest(tile, 6));
        assert!(seams.bytes < before);
        let again = seams.block(window).expect("in the lowest rows").to_patch(source.info());
        assert_eq!(again.rgb, kept.rgb);
        assert!(seams.block(Window::new(18, 2, 4, 4)).is_none(), "above the lowest rows");
        seams.drop_tile(0);
        assert!(seams.block(window).is_none());
    }

    #[test]
    fn a_part_holds_what_its_pieces_hold_whatever_they_are() {
        let side = 12u64;
        let bytes: Vec<u8> = (0..side * side * 3).map(|i| (i * 7919 % 251) as u8).collect();
        let words: Vec<u16> = bytes.iter().map(|v| u16::from(*v) * 257).collect();
        let whole = Window::new(0, 0, side, side);
        let piece = |window: Window, data: PieceData, empty: bool| Piece {
            window,
            data,
            offset: (window.y * side + window.x) as usize * 3,
            row_stride: side as usize * 3,
            pixel_stride: 3,
            empty,
        };
        let narrow = || PieceData::U8(Arc::new(PooledBytes { bytes: bytes.clone(), home: None }));
        let block = Block {
            window: whole,
            pieces: vec![
                piece(Window::new(0, 0, 6, 6), narrow(), false),
                piece(Window::new(6, 0, 6, 6), PieceData::U8(Arc::new(PooledBytes::default())), true),
                piece(Window::new(0, 6, 6, 6), PieceData::U16(Arc::new(words)), false),
                piece(Window::new(6, 6, 6, 6), narrow(), false),
            ],
        };
        let window = Window::new(2, 3, 8, 7);
        // From the pool and without it.
        for buffer_bytes in [100, 10_000] {
            let part = part_of(&block, window, &BufferPool::new(4, buffer_bytes));
            assert_eq!((part.window, part.pieces.len()), (window, 4));
            for (found, from) in part.pieces.iter().zip(&block.pieces) {
                assert_eq!((found.window, found.empty), (from.window.intersect(&window), from.empty));
                for y in (found.window.y..found.window.bottom()).filter(|_| !found.empty) {
                    let [a, b] = [found, from].map(|p| match p.row(found.window.x, y, found.window.width).samples {
                        Samples::U8(row) => row.iter().map(|v| u16::from(*v)).collect(),
                        Samples::U16(row) => row.to_vec(),
                    });
                    assert_eq!(a, b, "row {y}");
                }
            }
        }
    }
}
