//! One block from its bytes in the file to its samples. The decompressors keep their tables from block to block, one
//! set for each thread.

use std::cell::RefCell;

use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use super::jpeg::{self, Wanted};
use super::layout::{Codec, Layout};
use super::lzw;

struct Workers {
    deflate: libdeflater::Decompressor,
    zstd: Option<zstd::bulk::Decompressor<'static>>,
    lzw: lzw::Decoder,
    jpeg: jpeg::Decoder,
    /// Tables and data of a JPEG block, joined.
    joined: Vec<u8>,
}

thread_local! {
    static WORKERS: RefCell<Workers> = RefCell::new(Workers {
        deflate: libdeflater::Decompressor::new(),
        zstd: None,
        lzw: lzw::Decoder::new(),
        jpeg: jpeg::Decoder::new(jpeg::Kernel::best()),
        joined: Vec::new(),
    });
}

/// Fills `out` with the decoded bytes of one block: those of the file, before the predictor is undone and in the file's
/// byte order. `rows` is how many rows of the block are there.
///
/// # Errors
/// In words, when the data are broken or too short.
pub fn decompress(layout: &Layout, data: &[u8], rows: u64, out: &mut [u8]) -> Result<(), String> {
    WORKERS.with_borrow_mut(|workers| match layout.codec {
        Codec::None => {
            let data = data.get(..out.len()).ok_or("the data are too short")?;
            out.copy_from_slice(data);
            Ok(())
        }
        Codec::PackBits => unpack_bits(data, out),
        Codec::Lzw => lzw_block(&mut workers.lzw, data, out),
        Codec::Deflate => deflate(&mut workers.deflate, data, out),
        Codec::Zstd => zstd_block(&mut workers.zstd, data, out),
        Codec::Jpeg => {
            let (width, samples) = (layout.block_width as usize, layout.block_samples());
            let wanted = Wanted { width, rows: rows as usize, samples, ycbcr: layout.ycbcr };
            match workers.jpeg.decode(layout.jpeg_tables.as_deref(), data, wanted, out) {
                Ok(()) => Ok(()),
                Err(jpeg::NotDecoded) => any_jpeg(layout, &mut workers.joined, data, rows, out),
            }
        }
    })
}

fn short(got: usize, out: &[u8]) -> String {
    format!("it holds {got} bytes instead of {}", out.len())
}

/// PackBits: TIFF 6.0, section 9.
fn unpack_bits(mut data: &[u8], out: &mut [u8]) -> Result<(), String> {
    let mut at = 0;
    while at < out.len() {
        let Some((&head, rest)) = data.split_first() else { return Err(short(at, out)) };
        let left = out.len() - at;
        match head as i8 {
            -128 => data = rest,
            run if run < 0 => {
                let Some((&value, rest)) = rest.split_first() else { return Err(short(at, out)) };
                let length = (1 - isize::from(run)) as usize;
                let length = length.min(left);
                out[at..at + length].fill(value);
                at += length;
                data = rest;
            }
            literal => {
                let length = literal as usize + 1;
                let length = length.min(left);
                let Some((bytes, rest)) = rest.split_at_checked(length) else { return Err(short(at, out)) };
                out[at..at + length].copy_from_slice(bytes);
                at += length;
                data = rest;
            }
        }
    }
    Ok(())
}

fn lzw_block(decoder: &mut lzw::Decoder, data: &[u8], out: &mut [u8]) -> Result<(), String> {
    if data.len() >= 2 && data[0] == 0 && data[1] & 1 == 1 {
        return Err("it is LZW of the old kind (before TIFF 5.0)".into());
    }
    match decoder.decode(data, out)? {
        length if length < out.len() => Err(short(length, out)),
        _ => Ok(()),
    }
}

fn deflate(decoder: &mut libdeflater::Decompressor, data: &[u8], out: &mut [u8]) -> Result<(), String> {
    match decoder.zlib_decompress(data, out) {
        Ok(length) if length == out.len() => Ok(()),
        Ok(length) => Err(short(length, out)),
        // More than the block needs, or a wrong check sum at the end: decode only what is needed.
        Err(_) => fill_from(flate2::read::ZlibDecoder::new(data), out, "Deflate"),
    }
}

fn zstd_block(
    decoder: &mut Option<zstd::bulk::Decompressor<'static>>,
    data: &[u8],
    out: &mut [u8],
) -> Result<(), String> {
    let worker = match decoder {
        Some(worker) => worker,
        None => decoder.insert(zstd::bulk::Decompressor::new().map_err(|e| format!("ZSTD: {e}"))?),
    };
    match worker.decompress_to_buffer(data, out) {
        Ok(length) if length == out.len() => Ok(()),
        Ok(length) => Err(short(length, out)),
        Err(_) => {
            let stream = zstd::stream::read::Decoder::with_buffer(data).map_err(|e| format!("ZSTD: {e}"))?;
            fill_from(stream, out, "ZSTD")
        }
    }
}

/// Fills `out` from a stream that may have more to give.
fn fill_from(mut stream: impl std::io::Read, out: &mut [u8], name: &str) -> Result<(), String> {
    let mut filled = 0;
    while filled < out.len() {
        match stream.read(&mut out[filled..]) {
            Ok(0) => return Err(short(filled, out)),
            Ok(count) => filled += count,
            Err(error) => return Err(format!("{name}: {error}")),
        }
    }
    Ok(())
}

/// A JPEG block of whatever kind: an abbreviated stream that needs the tables of tag 347, or a whole one (TIFF
/// Technical Note 2, 1995).
fn any_jpeg(layout: &Layout, joined: &mut Vec<u8>, data: &[u8], rows: u64, out: &mut [u8]) -> Result<(), String> {
    let say =
        |e: zune_jpeg::errors::DecodeErrors| format!("JPEG: {e:?}").split_whitespace().collect::<Vec<_>>().join(" ");
    let stream = match layout.jpeg_tables.as_deref() {
        Some([0xFF, 0xD8, tables @ .., 0xFF, 0xD9]) if data.starts_with(&[0xFF, 0xD8]) => {
            joined.clear();
            joined.extend_from_slice(&[0xFF, 0xD8]);
            joined.extend_from_slice(tables);
            joined.extend_from_slice(&data[2..]);
            joined.as_slice()
        }
        _ => data,
    };
    let limits = |options: DecoderOptions| {
        options.set_max_width(layout.block_width as usize).set_max_height(layout.block_height as usize)
    };
    let mut decoder =
        zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(stream), limits(DecoderOptions::new_fast()));
    decoder.decode_headers().map_err(say)?;
    let samples = layout.block_samples();
    let stored = decoder.input_colorspace().ok_or("JPEG: it has no colour space")?;
    let wanted = match (samples, layout.ycbcr) {
        (1, _) => ColorSpace::Luma,
        (_, true) => ColorSpace::RGB,
        (_, false) => stored,
    };
    if wanted.num_components() != samples || (samples > 1 && stored.num_components() != samples) {
        return Err(format!("JPEG: it has {} components instead of {samples}", stored.num_components()));
    }
    decoder.set_options(limits(DecoderOptions::new_fast()).jpeg_set_out_colorspace(wanted));
    let (width, height) = decoder.dimensions().ok_or("JPEG: it has no size")?;
    if width as u64 != layout.block_width || (height as u64) < rows {
        return Err(format!("JPEG: it is {width} x {height} pixels, the block {} x {rows}", layout.block_width));
    }
    if height as u64 == rows {
        return decoder.decode_into(out).map_err(say);
    }
    // The last strip may be stored at full height.
    let whole = decoder.decode().map_err(say)?;
    out.copy_from_slice(whole.get(..out.len()).ok_or_else(|| short(whole.len(), out))?);
    Ok(())
}
