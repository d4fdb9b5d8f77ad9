//! File blocks that hold nothing, known by their bytes.
//!
//! A mosaic's corners are blocks whose every pixel is nodata or transparent. One encoder writes all of them alike and
//! short, so the first that is decoded tells the others: a block with the very same bytes in the file has the same
//! pixels, and need not be decoded.

use std::sync::{Arc, Mutex, PoisonError};

use crate::cache::Chunk;
use crate::{PieceData, RasterInfo};

/// Only blocks that shrank to so small a part of their pixels are looked at: ground does not.
const SMALLEST_RATIO: u64 = 48;
/// Encodings that are remembered: a file has one for its full blocks and perhaps others at its edges.
const REMEMBERED: usize = 4;

/// What the blocks without content look like in this file.
#[derive(Default)]
pub(super) struct EmptyBlocks {
    seen: Mutex<Vec<Arc<[u8]>>>,
}

impl EmptyBlocks {
    /// Whether a block of `length` bytes in the file may be one.
    pub fn worth_a_look(info: &RasterInfo, length: u64, decoded: u64) -> bool {
        let can_be = info.alpha.is_some() || info.nodata_sample().is_some();
        can_be && length > 0 && length <= decoded / SMALLEST_RATIO
    }

    /// Whether a block with these bytes was found to hold nothing.
    pub fn knows(&self, data: &[u8]) -> bool {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).iter().any(|seen| **seen == *data)
    }

    /// A block with these bytes holds nothing; the first few are remembered.
    pub fn remember(&self, data: &[u8]) {
        let mut seen = self.seen.lock().unwrap_or_else(PoisonError::into_inner);
        if seen.len() < REMEMBERED && !seen.iter().any(|known| **known == *data) {
            seen.push(data.into());
        }
    }
}

/// Whether every pixel of a chunk is nodata or transparent.
pub(super) fn holds_nothing(chunk: &Chunk, info: &RasterInfo) -> bool {
    let nodata = info.nodata_sample();
    match &chunk.data {
        None => true,
        Some(PieceData::U8(buffer)) => all_empty(&buffer.bytes, chunk.pixel_stride, info, nodata),
        Some(PieceData::U16(buffer)) => all_empty(buffer, chunk.pixel_stride, info, nodata),
        Some(PieceData::Mapped(..)) => false,
    }
}

fn all_empty<T: Copy + Into<u16>>(samples: &[T], stride: usize, info: &RasterInfo, nodata: Option<u16>) -> bool {
    samples.chunks_exact(stride).all(|pixel| {
        info.alpha.is_some_and(|band| pixel[band].into() == 0)
            || nodata.is_some_and(|value| info.rgb.iter().all(|&band| pixel[band].into() == value))
    })
}
