//! The floor of `benches/compare.sh`: the codec and the predictor alone over the blocks of a TIFF, with two threads.
//!
//!     codec_floor FILE THREADS
//!
//! Offsets come from the `tiff` crate; the compressed bytes are read from the page cache block by block, decoded into
//! one reused buffer a thread, the horizontal predictor undone by the plainest loop the compiler vectorises or not.
//! Nothing is unpacked, classified or kept. Prints seconds.

use std::fs::File;
use std::io::BufReader;
use std::os::unix::fs::FileExt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

use tiff::decoder::{Decoder, Limits};
use tiff::tags::Tag;

struct Blocks {
    offsets: Vec<u64>,
    counts: Vec<u64>,
    compression: u16,
    predictor: u16,
    row_bytes: usize,
    block_bytes: usize,
    jpeg_tables: Option<Vec<u8>>,
}

fn main() -> anyhow::Result<()> {
    let mut args = std::env::args().skip(1);
    let (path, threads) = match (args.next(), args.next()) {
        (Some(path), Some(threads)) => (path, threads.parse::<usize>()?),
        _ => anyhow::bail!("usage: codec_floor FILE THREADS"),
    };
    let blocks = directory(&path)?;
    let started = Instant::now();
    let next = AtomicUsize::new(0);
    std::thread::scope(|scope| {
        let workers: Vec<_> = (0..threads).map(|_| scope.spawn(|| decode_all(&path, &blocks, &next))).collect();
        workers.into_iter().try_for_each(|w| w.join().expect("a decoder does not panic"))
    })?;
    println!("{:.3}", started.elapsed().as_secs_f64());
    Ok(())
}

fn directory(path: &str) -> anyhow::Result<Blocks> {
    let mut decoder = Decoder::new(BufReader::new(File::open(path)?))?.with_limits(Limits::unlimited());
    let (width, _) = decoder.dimensions()?;
    let tiled = decoder.find_tag(Tag::TileWidth)?.is_some();
    let (offsets, counts) = if tiled {
        (decoder.get_tag_u64_vec(Tag::TileOffsets)?, decoder.get_tag_u64_vec(Tag::TileByteCounts)?)
    } else {
        (decoder.get_tag_u64_vec(Tag::StripOffsets)?, decoder.get_tag_u64_vec(Tag::StripByteCounts)?)
    };
    let mut number = |tag: Tag, default: u64| -> anyhow::Result<u64> {
        Ok(decoder.find_tag(tag)?.map(|v| v.into_u64()).transpose()?.unwrap_or(default))
    };
    let samples = number(Tag::SamplesPerPixel, 1)?;
    let block_width = number(Tag::TileWidth, u64::from(width))?;
    let block_height = if tiled { number(Tag::TileLength, 1)? } else { number(Tag::RowsPerStrip, 1)? };
    let compression = number(Tag::Compression, 1)? as u16;
    let predictor = number(Tag::Predictor, 1)? as u16;
    let jpeg_tables = decoder.find_tag(Tag::Unknown(347))?.map(|v| v.into_u8_vec()).transpose()?;
    let row_bytes = (block_width * samples) as usize;
    let block_bytes = row_bytes * block_height as usize;
    Ok(Blocks { offsets, counts, compression, predictor, row_bytes, block_bytes, jpeg_tables })
}

fn decode_all(path: &str, blocks: &Blocks, next: &AtomicUsize) -> anyhow::Result<()> {
    let file = File::open(path)?;
    let mut out = vec![0u8; blocks.block_bytes];
    let mut raw = Vec::new();
    let mut deflate = libdeflater::Decompressor::new();
    let mut zstd = zstd::bulk::Decompressor::new()?;
    // Small strips are taken many at a time, so that the counter is not what is measured.
    let group = ((1 << 20) / blocks.block_bytes.max(1)).max(1);
    loop {
        let first = next.fetch_add(group, Ordering::Relaxed);
        if first >= blocks.offsets.len() {
            return Ok(());
        }
        for i in first..(first + group).min(blocks.offsets.len()) {
            raw.resize(blocks.counts[i] as usize, 0);
            file.read_exact_at(&mut raw, blocks.offsets[i])?;
            let length = match blocks.compression {
                1 => raw.len(),
                8 | 32946 => deflate.zlib_decompress(&raw, &mut out)?,
                50000 => zstd.decompress_to_buffer(&raw, &mut out)?,
                5 => {
                    let mut lzw = weezl::decode::Configuration::with_tiff_size_switch(weezl::BitOrder::Msb, 8).build();
                    let mut decoded = Vec::with_capacity(out.len());
                    lzw.into_vec(&mut decoded).decode_all(&raw).status?;
                    anyhow::ensure!(decoded.len() == out.len() || i + 1 == blocks.offsets.len(), "a short strip");
                    out[..decoded.len()].copy_from_slice(&decoded);
                    decoded.len()
                }
                7 => {
                    let mut stream = blocks.jpeg_tables.clone().unwrap_or_else(|| vec![0xff, 0xd8, 0xff, 0xd9]);
                    stream.truncate(stream.len() - 2);
                    stream.extend_from_slice(&raw[2..]);
                    let mut jpeg =
                        zune_jpeg::JpegDecoder::new(zune_jpeg::zune_core::bytestream::ZCursor::new(&stream[..]));
                    out = jpeg.decode().map_err(|e| anyhow::anyhow!("{e:?}"))?;
                    out.len()
                }
                other => anyhow::bail!("no floor for compression {other}"),
            };
            if blocks.predictor == 2 {
                for row in out[..length].chunks_mut(blocks.row_bytes) {
                    for i in 3..row.len() {
                        row[i] = row[i].wrapping_add(row[i - 3]);
                    }
                }
            }
            std::hint::black_box(&out);
        }
    }
}
