//! Strips too large to be decoded whole (often the whole image is one): decoded from the top down, row by row.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::os::unix::fs::FileExt;
use std::sync::Arc;

use super::layout::Codec;
use crate::cache::Chunk;

/// Bytes read from the file at a time.
const BUFFER: usize = 256 << 10;
/// Largest ZSTD window accepted, as a power of two: 16 MiB.
const ZSTD_WINDOW_LOG: u32 = 24;

/// Where the row-by-row decoder stands.
#[derive(Default)]
pub(super) struct Stream {
    /// The chunk that comes next.
    pub(super) next: u64,
    /// Row of the image that comes next.
    pub(super) row: u64,
    pub(super) strip: Option<Box<dyn Read + Send>>,
    /// Chunks decoded on the way to one that was asked for earlier than they were.
    pub(super) recent: VecDeque<(u64, Chunk)>,
}

/// Part of a file as a stream.
struct Extent {
    file: Arc<File>,
    position: u64,
    end: u64,
}

impl Read for Extent {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let wanted = (self.end - self.position).min(out.len() as u64) as usize;
        let got = self.file.read_at(&mut out[..wanted], self.position)?;
        self.position += got as u64;
        Ok(got)
    }
}

/// Whether strips of this codec can be decoded row by row.
pub fn can_stream(codec: Codec) -> bool {
    !matches!(codec, Codec::None | Codec::Jpeg)
}

/// The decoded bytes of `length` bytes at `position`.
///
/// # Errors
/// When the decoder cannot be made.
///
/// # Panics
/// For codecs that [`can_stream`] excludes.
pub fn open(codec: Codec, file: &Arc<File>, position: u64, length: u64) -> io::Result<Box<dyn Read + Send>> {
    let extent = Extent { file: file.clone(), position, end: position + length };
    let buffered = BufReader::with_capacity(BUFFER, extent);
    Ok(match codec {
        Codec::Deflate => Box::new(flate2::bufread::ZlibDecoder::new(buffered)),
        Codec::Zstd => {
            let mut decoder = zstd::stream::read::Decoder::with_buffer(buffered)?;
            decoder.window_log_max(ZSTD_WINDOW_LOG)?;
            Box::new(decoder)
        }
        Codec::Lzw => Box::new(LzwStream {
            input: buffered,
            decoder: weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8),
        }),
        Codec::PackBits => Box::new(PackBitsStream { input: buffered, state: Run::Head }),
        Codec::None | Codec::Jpeg => unreachable!("the caller asks can_stream first"),
    })
}

struct LzwStream<R> {
    input: R,
    decoder: weezl::decode::Decoder,
}

impl<R: BufRead> Read for LzwStream<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        loop {
            let data = self.input.fill_buf()?;
            let at_end = data.is_empty();
            let result = self.decoder.decode_bytes(data, out);
            self.input.consume(result.consumed_in);
            let status = result.status.map_err(|e| io::Error::new(io::ErrorKind::InvalidData, e.to_string()))?;
            let stuck = at_end || matches!(status, weezl::LzwStatus::Done) || out.is_empty();
            if result.consumed_out > 0 || stuck {
                return Ok(result.consumed_out);
            }
        }
    }
}

struct PackBitsStream<R> {
    input: R,
    state: Run,
}

#[derive(Clone, Copy)]
enum Run {
    Head,
    Literal(usize),
    Repeat(usize, u8),
}

impl<R: BufRead> PackBitsStream<R> {
    fn byte(&mut self) -> io::Result<Option<u8>> {
        let byte = self.input.fill_buf()?.first().copied();
        self.input.consume(usize::from(byte.is_some()));
        Ok(byte)
    }
}

impl<R: BufRead> Read for PackBitsStream<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        if out.is_empty() {
            return Ok(0);
        }
        loop {
            match self.state {
                Run::Head => {
                    let Some(head) = self.byte()? else { return Ok(0) };
                    self.state = match head as i8 {
                        -128 => Run::Head,
                        run if run < 0 => {
                            let Some(value) = self.byte()? else { return Ok(0) };
                            Run::Repeat((1 - isize::from(run)) as usize, value)
                        }
                        literal => Run::Literal(literal as usize + 1),
                    };
                }
                Run::Literal(left) => {
                    let data = self.input.fill_buf()?;
                    let count = left.min(out.len()).min(data.len());
                    out[..count].copy_from_slice(&data[..count]);
                    self.input.consume(count);
                    self.state = if count == left { Run::Head } else { Run::Literal(left - count) };
                    return Ok(count);
                }
                Run::Repeat(left, value) => {
                    let count = left.min(out.len());
                    out[..count].fill(value);
                    self.state = if count == left { Run::Head } else { Run::Repeat(left - count, value) };
                    return Ok(count);
                }
            }
        }
    }
}
