//! A raster held in memory: planted images of the tests, and the customer's tiles in the self-test.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::error::Result;
use crate::window::Window;
use crate::{Block, BlockLayout, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, SampleType};

/// 8-bit RGB pixels, row-major, handed out without copying.
pub struct MemorySource {
    info: RasterInfo,
    pixels: Arc<PooledBytes>,
    reads: AtomicU64,
}

impl MemorySource {
    /// # Panics
    /// When `rgb` does not hold `3 · width · height` samples.
    pub fn rgb8(width: u64, height: u64, rgb: Vec<u8>) -> Self {
        assert_eq!(rgb.len() as u64, 3 * width * height, "three samples a pixel");
        let info = RasterInfo {
            path: "memory".into(),
            width,
            height,
            bands: 3,
            sample: SampleType::U8,
            rgb: [0, 1, 2],
            alpha: None,
            nodata: None,
            white: 255,
            layout: BlockLayout::Strips { rows: 1 },
            blocks: height,
            chunk_bytes: 0,
            sequential: false,
            reader: "memory",
            description: "8-bit RGB in memory".into(),
            geotransform: None,
            crs_wkt: None,
            resolution_m_per_px: None,
        };
        MemorySource { info, pixels: Arc::new(PooledBytes { bytes: rgb, home: None }), reads: AtomicU64::new(0) }
    }
}

impl RasterSource for MemorySource {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        debug_assert!(self.info.bounds().contains_window(&window));
        self.reads.fetch_add(window.area() * 3, Ordering::Relaxed);
        let row_stride = self.info.width as usize * 3;
        let piece = Piece {
            window,
            data: PieceData::U8(self.pixels.clone()),
            offset: window.y as usize * row_stride + window.x as usize * 3,
            row_stride,
            pixel_stride: 3,
            empty: false,
        };
        Ok(Block { window, pieces: vec![piece] })
    }

    fn stats(&self) -> ReadStats {
        ReadStats { bytes_read: self.reads.load(Ordering::Relaxed), ..ReadStats::default() }
    }
}
