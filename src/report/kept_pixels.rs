//! Pixels around candidates, copied while the scan has them in hand, so that most chips need no read of their own.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::report::frame::{Frame, Spot};
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, PieceData, PooledBytes, RasterInfo, Samples};

/// What is kept at most: some hundred marks of the usual size. Beyond it the candidates that look least like marks go.
const MAX_BYTES: usize = 4 << 20;

/// The windows around the best candidates so far.
#[derive(Default)]
pub struct KeptPixels {
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    blocks: HashMap<Window, (f64, Block)>,
    bytes: usize,
}

impl KeptPixels {
    /// Copies what the chips of these candidates will show, where the block holds it whole.
    pub fn add(&self, block: &Block, info: &RasterInfo, detector: &dyn Detector, found: &[&Candidate]) {
        for candidate in found {
            let Some(size) = candidate.size_px else { continue };
            let spot = Spot::of_mark(candidate.centre, size[0].max(size[1]));
            let window = Frame::new(&spot, info, detector).read;
            if !block.window.contains_window(&window) {
                continue;
            }
            let copy = copied(block, window);
            let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
            kept.bytes += bytes(&copy);
            kept.blocks.insert(window, (candidate.score.unwrap_or(0.0), copy));
            if kept.bytes > MAX_BYTES {
                kept.drop_the_worse_half();
            }
        }
    }

    /// What was kept of exactly this window.
    pub(super) fn get(&self, window: Window) -> Option<Block> {
        let kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.blocks.get(&window).map(|(_, block)| block.clone())
    }
}

impl Kept {
    fn drop_the_worse_half(&mut self) {
        let mut order: Vec<(f64, Window)> = self.blocks.iter().map(|(window, (score, _))| (*score, *window)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (_, window) in order {
            if self.bytes <= MAX_BYTES / 2 {
                break;
            }
            if let Some((_, block)) = self.blocks.remove(&window) {
                self.bytes -= bytes(&block);
            }
        }
    }
}

fn bytes(block: &Block) -> usize {
    let data = |piece: &Piece| match &piece.data {
        PieceData::U8(buffer) => buffer.bytes.len(),
        PieceData::U16(buffer) => 2 * buffer.len(),
        PieceData::Mapped(..) => 0,
    };
    block.pieces.iter().map(data).sum()
}

/// A part of a block with pixels of its own, so that the block's buffers can go.
fn copied(block: &Block, window: Window) -> Block {
    let pieces = block.pieces.iter().filter_map(|piece| {
        let part = piece.window.intersect(&window);
        (!part.is_empty()).then(|| copied_piece(piece, part))
    });
    Block { window, pieces: pieces.collect() }
}

fn copied_piece(piece: &Piece, window: Window) -> Piece {
    let row_stride = window.width as usize * piece.pixel_stride;
    let (mut bytes, mut words) = (Vec::new(), Vec::new());
    if !piece.empty {
        for y in window.y..window.bottom() {
            // The last pixel of a buffer may lack samples that nobody reads.
            match piece.row(window.x, y, window.width).samples {
                Samples::U8(samples) => {
                    bytes.extend_from_slice(samples);
                    bytes.resize((y + 1 - window.y) as usize * row_stride, 0);
                }
                Samples::U16(samples) => {
                    words.extend_from_slice(samples);
                    words.resize((y + 1 - window.y) as usize * row_stride, 0);
                }
            }
        }
    }
    let data = if words.is_empty() {
        PieceData::U8(Arc::new(PooledBytes { bytes, home: None }))
    } else {
        PieceData::U16(Arc::new(words))
    };
    Piece { window, data, offset: 0, row_stride, pixel_stride: piece.pixel_stride, empty: piece.empty }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;

    #[test]
    fn a_copy_shows_the_same_pixels() {
        let rgb = (0..100 * 80 * 3).map(|i| (i % 253) as u8).collect();
        let source = MemorySource::rgb8(100, 80, rgb);
        let block = source.read(Window::new(10, 5, 60, 70)).expect("in memory");
        let window = Window::new(21, 17, 30, 40);
        let copy = copied(&block, window);
        assert_eq!(copy.patch(window, source.info()).rgb, block.patch(window, source.info()).rgb);
        assert_eq!(bytes(&copy), 30 * 40 * 3);
    }

    #[test]
    fn beyond_the_limit_the_best_stay() {
        let mut kept = Kept::default();
        let source = MemorySource::rgb8(100, 100, vec![0; 30_000]);
        for i in 0..100u64 {
            let window = Window::new(i, 0, 1, 100);
            let copy = copied(&source.read(window).expect("in memory"), window);
            kept.bytes += MAX_BYTES / 100;
            kept.blocks.insert(window, (i as f64, copy));
        }
        kept.bytes = MAX_BYTES / 2 + 300 * 10;
        kept.drop_the_worse_half();
        assert_eq!(kept.blocks.len(), 90);
        assert!(
            kept.blocks.contains_key(&Window::new(99, 0, 1, 100))
                && !kept.blocks.contains_key(&Window::new(9, 0, 1, 100))
        );
    }
}
