//! Strips too large to be decoded whole: row by row, from the top of a strip down.

use std::sync::{Mutex, PoisonError};

use super::decoder::{Stored, TiffDecoder};
use super::stream::{self, Stream};
use crate::cache::Chunk;
use crate::chunked::Counters;
use crate::error::Result;
use crate::{PieceData, SampleType};

/// Chunks that a stream keeps for threads that come late.
const RECENT_CHUNKS: usize = 8;

impl TiffDecoder {
    /// A chunk of a strip that is decoded row by row. One thread at a time; chunks passed on the way are kept for those
    /// who come late, and going back further starts again at the top of its strip.
    pub(super) fn streamed(&self, id: u64, stream: &Mutex<Stream>, counters: &Counters) -> Result<Chunk> {
        let mut stream = stream.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = stream.recent.iter().position(|(key, _)| *key == id) {
            return Ok(stream.recent.remove(at).expect("it was just found").1);
        }
        let strip = self.grid.tile(id).core.y / self.layout.block_height;
        if id < stream.next || strip * self.layout.block_height > stream.row {
            self.go_to_strip(&mut stream, strip, counters)?;
        }
        loop {
            let chunk = match self.next_chunk(&mut stream, counters) {
                Ok(chunk) => chunk,
                Err(error) => {
                    // The position is unknown now.
                    *stream = Stream::default();
                    return Err(error);
                }
            };
            let key = stream.next;
            stream.next += 1;
            if key == id {
                return Ok(chunk);
            }
            if stream.recent.len() == RECENT_CHUNKS {
                stream.recent.pop_front();
            }
            stream.recent.push_back((key, chunk));
        }
    }

    /// Puts the stream before the first chunk that begins in a strip.
    fn go_to_strip(&self, stream: &mut Stream, strip: u64, counters: &Counters) -> Result<()> {
        let row = strip * self.layout.block_height;
        let next = row.div_ceil(self.grid.tile_height());
        *stream = Stream { next, row, ..Stream::default() };
        // The strip's first rows may belong to a chunk that began in the one before.
        let between = next * self.grid.tile_height() - row;
        if between > 0 {
            let mut passed = self.pool.take(between as usize * self.layout.block_row_bytes() as usize);
            let skipped = self.next_rows(stream, &mut passed, counters);
            self.pool.put(passed);
            skipped.inspect_err(|_| *stream = Stream::default())?;
        }
        Ok(())
    }

    fn next_chunk(&self, stream: &mut Stream, counters: &Counters) -> Result<Chunk> {
        let chunk = self.grid.tile(stream.next).core;
        let row_bytes = self.layout.block_row_bytes() as usize;
        let row_stride = chunk.width as usize * self.samples();
        let mut raw = self.pool.take(row_bytes * chunk.height as usize);
        let stored = self.next_rows(stream, &mut raw, counters)?;
        let bytes = raw.len() as u64;
        if self.info.sample == SampleType::U8 {
            if stored == Stored::InFile {
                self.undo_predictor_u8(&mut raw);
            } else {
                raw.fill(self.fill as u8);
            }
            return Ok(self.chunk_u8(raw, stored, row_stride));
        }
        let mut out = vec![self.fill; raw.len() / 2];
        if stored == Stored::InFile {
            for (from, to) in raw.chunks_exact(row_bytes).zip(out.chunks_exact_mut(row_stride)) {
                self.row_u16(from, to);
            }
        }
        self.pool.put(raw);
        Ok(self.finish(PieceData::U16(out.into()), stored, row_stride, bytes))
    }

    /// The rows that come next, whole rows of bytes as the codec gives them; whether the file holds any of them.
    fn next_rows(&self, stream: &mut Stream, raw: &mut [u8], counters: &Counters) -> Result<Stored> {
        let row_bytes = self.layout.block_row_bytes() as usize;
        let height = (raw.len() / row_bytes) as u64;
        let (mut done, mut stored) = (0, Stored::Nowhere);
        while done < height {
            let strip = stream.row / self.layout.block_height;
            let left = (strip + 1) * self.layout.block_height - stream.row;
            let rows = left.min(height - done);
            let to = &mut raw[done as usize * row_bytes..][..rows as usize * row_bytes];
            let (position, length) = self.layout.extent(strip);
            if stream.row.is_multiple_of(self.layout.block_height) {
                counters.add(u64::from(length > 0), u64::from(length == 0), length);
                stream.strip = match length {
                    0 => None,
                    _ => Some(
                        stream::open(self.layout.codec, &self.file, position, length)
                            .map_err(|e| self.broken(strip, e.to_string()))?,
                    ),
                };
            }
            match &mut stream.strip {
                None => to.fill(0),
                Some(reader) => {
                    let row = stream.row;
                    reader.read_exact(to).map_err(|e| self.broken(strip, format!("near row {row}: {e}")))?;
                    stored = Stored::InFile;
                }
            }
            stream.row += rows;
            done += rows;
        }
        Ok(stored)
    }
}
