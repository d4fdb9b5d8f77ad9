//! A scan with its tones reversed: marks of negatives are dark on a bright border.

use std::sync::Arc;

use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, Samples};

/// White minus every sample of another source.
pub(super) struct Negative<'a>(pub &'a dyn RasterSource);

impl RasterSource for Negative<'_> {
    fn info(&self) -> &RasterInfo {
        self.0.info()
    }

    fn read(&self, window: Window) -> Result<Block> {
        let block = self.0.read(window)?;
        let white = self.info().white;
        let pieces = block.pieces.iter().map(|p| if p.empty { p.clone() } else { reversed(p, white) }).collect();
        Ok(Block { window: block.window, pieces })
    }

    fn prefetch(&self, window: Window) {
        self.0.prefetch(window);
    }

    fn release(&self, window: Window) {
        self.0.release(window);
    }

    fn stats(&self) -> ReadStats {
        self.0.stats()
    }
}

/// A copy of the piece's own pixels, packed.
fn reversed(piece: &Piece, white: u16) -> Piece {
    let Window { x, y, width, height } = piece.window;
    let stride = piece.pixel_stride;
    let row_samples = width as usize * stride;
    let (mut bytes, mut words) = (vec![], vec![]);
    for j in y..y + height {
        // The last pixel of a row may be shorter than the stride; what is added there is nobody's.
        match piece.row(x, j, width).samples {
            Samples::U8(s) => {
                let white = white.min(255) as u8;
                bytes.extend(s.iter().map(|v| white.saturating_sub(*v)));
                bytes.resize((j - y + 1) as usize * row_samples, 0);
            }
            Samples::U16(s) => {
                words.extend(s.iter().map(|v| white.saturating_sub(*v)));
                words.resize((j - y + 1) as usize * row_samples, 0);
            }
        }
    }
    let data = match piece.data {
        PieceData::U16(_) => PieceData::U16(Arc::new(words)),
        PieceData::U8(_) | PieceData::Mapped(..) => PieceData::U8(Arc::new(PooledBytes { bytes, home: None })),
    };
    Piece { window: piece.window, data, offset: 0, row_stride: row_samples, pixel_stride: stride, empty: false }
}
