//! From chunks of the grid to blocks of the file.

use std::cell::RefCell;
use std::os::unix::fs::FileExt;
use std::sync::Mutex;

use super::container::{ByteOrder, Directories};
use super::empty_blocks::{EmptyBlocks, holds_nothing};
use super::layout::{Codec, Layout, Predictor, Samples};
use super::stream::{self, Stream};
use super::{decompress, mapping, predictor};
use crate::cache::Chunk;
use crate::chunked::{CHUNK_BYTES, ChunkDecoder, ChunkedSource, Counters, group_blocks, retile_remedy};
use crate::error::{Error, Result};
use crate::gdal::Facts;
use crate::white::white_of;
use crate::window::{TileGrid, Window};
use crate::{BlockLayout, BufferPool, PieceData, RasterInfo, SampleType};

/// Reads image directory `index` of a file.
///
/// # Errors
/// [`Error::Unsupported`] when GDAL must do it, [`Error::Limit`] when one block is larger than `cache_bytes` and cannot
/// be decoded row by row.
pub fn open(all: &Directories, index: usize, cache_bytes: u64) -> Result<ChunkedSource<TiffDecoder>> {
    Ok(ChunkedSource::new(TiffDecoder::new(all, index, cache_bytes, Georeference::ByGdal)?, cache_bytes))
}

/// Like [`open`], but uncompressed interleaved 8-bit blocks are mapped instead of read into buffers.
///
/// # Errors
/// Those of [`open`].
pub fn open_mapped(all: &Directories, index: usize, cache_bytes: u64) -> Result<ChunkedSource<TiffDecoder>> {
    let mut decoder = TiffDecoder::new(all, index, cache_bytes, Georeference::ByGdal)?;
    decoder.mapped = true;
    Ok(ChunkedSource::new(decoder, cache_bytes))
}

/// Like [`open`], without asking GDAL for the georeference: nothing but this reader touches the file (for fuzzing).
///
/// # Errors
/// Those of [`open`].
pub fn open_pixels(all: &Directories, index: usize, cache_bytes: u64) -> Result<ChunkedSource<TiffDecoder>> {
    Ok(ChunkedSource::new(TiffDecoder::new(all, index, cache_bytes, Georeference::NotAsked)?, cache_bytes))
}

/// Whether the file holds any block of a chunk; a sparse file leaves blocks out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Stored {
    InFile,
    Nowhere,
}

impl Stored {
    fn of(held: bool) -> Self {
        if held { Stored::InFile } else { Stored::Nowhere }
    }
}

impl std::ops::BitOrAssign for Stored {
    fn bitor_assign(&mut self, other: Self) {
        if other == Stored::InFile {
            *self = Stored::InFile;
        }
    }
}

/// Who is asked where the image lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Georeference {
    ByGdal,
    NotAsked,
}

/// Which blocks belong to a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Blocks {
    Touching,
    Inside,
}

#[derive(Default)]
struct Scratch {
    /// Bytes as the file has them.
    data: Vec<u8>,
    /// A decoded block that is copied on.
    block: Vec<u8>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// The part of the native reader that knows TIFF.
pub struct TiffDecoder {
    pub(super) file: std::sync::Arc<std::fs::File>,
    order: ByteOrder,
    pub(super) layout: Layout,
    pub(super) info: RasterInfo,
    pub(super) grid: TileGrid,
    /// Bands of the file in the order in which they are handed out; of interleaved files all.
    planes: Vec<usize>,
    pub(super) pool: BufferPool,
    pub(super) fill: u16,
    kernel: predictor::Kernel,
    mapped: bool,
    hollow: EmptyBlocks,
    /// Only for strips too large to be decoded whole.
    stream: Option<Mutex<Stream>>,
    /// The file is so large that its pages must not push everything else out of memory.
    drop_behind: bool,
}

impl TiffDecoder {
    fn new(all: &Directories, index: usize, cache_bytes: u64, georeference: Georeference) -> Result<Self> {
        let layout = Layout::read(all, index)?;
        let Samples::Unsigned(sample) = layout.sample else {
            let what = "floating-point samples (tag 339 is 3) by the native reader";
            return Err(Error::unsupported(&all.path, what, "use --reader auto or gdal"));
        };
        if all.mask_of(index)?.is_some() || side_file(&all.path, ".msk").exists() {
            let what = "a mask beside the image by the native reader";
            return Err(Error::unsupported(&all.path, what, "use --reader auto or gdal"));
        }
        let (planes, rgb, alpha) = bands_to_read(&layout);
        let pixel_bytes = (planes.len() * layout.sample.bytes()) as u64;
        let block = (layout.block_width, layout.block_height);
        let (width, height) = (layout.width, layout.height);
        let (across, down) = group_blocks(block, (width, height), pixel_bytes);
        let (chunk_width, mut chunk_height) = (block.0 * across, block.1 * down);
        let bytes_of = |rows: u64| chunk_width.saturating_mul(rows).saturating_mul(pixel_bytes);
        // A strip that fills much of the cache is better decoded row by row.
        let too_large = bytes_of(chunk_height) > cache_bytes / 4;
        let streams = too_large && !layout.tiled && !layout.planar && stream::can_stream(layout.codec);
        if streams {
            chunk_height = (CHUNK_BYTES / bytes_of(1)).clamp(1, height);
        }
        let chunk_bytes = bytes_of(chunk_height);
        if chunk_bytes > cache_bytes {
            let (name, codec) = (all.path.display(), layout.codec.name());
            return Err(Error::Limit {
                what: format!("{name}: one {codec} block of {} x {} pixels", block.0, block.1),
                needed: chunk_bytes,
                allowed: cache_bytes,
                remedy: retile_remedy(&all.path),
            });
        }
        let facts = match georeference {
            Georeference::ByGdal => Facts::of_file(&all.path, index),
            Georeference::NotAsked => Facts::default(),
        };
        let info = RasterInfo {
            path: all.path.clone(),
            width,
            height,
            bands: layout.samples,
            sample,
            rgb,
            alpha,
            nodata: facts.nodata.or(layout.nodata),
            white: white_of(sample, None, layout.max_sample_value),
            layout: match layout.tiled {
                true => BlockLayout::Tiles { width: block.0, height: block.1 },
                false => BlockLayout::Strips { rows: block.1 },
            },
            blocks: layout.blocks_per_plane() * if layout.planar { planes.len() as u64 } else { 1 },
            chunk_bytes,
            sequential: streams,
            reader: "native",
            description: describe(all, &layout),
            geotransform: facts.geotransform,
            crs_wkt: facts.crs_wkt,
            resolution_m_per_px: facts.resolution_m_per_px,
        };
        Ok(TiffDecoder {
            file: all.file.clone(),
            order: all.order,
            grid: TileGrid::new(width, height, chunk_width, chunk_height, 0),
            planes,
            pool: BufferPool::for_chunks(chunk_bytes),
            fill: info.fill_value(),
            kernel: predictor::Kernel::best(),
            mapped: false,
            hollow: EmptyBlocks::default(),
            stream: streams.then(Mutex::default),
            drop_behind: all.len > mapping::memory_bytes() / 2,
            layout,
            info,
        })
    }

    pub(super) fn samples(&self) -> usize {
        self.planes.len()
    }

    pub(super) fn broken(&self, block: u64, what: String) -> Error {
        Error::format(&self.info.path, self.layout.block_name(block), what)
    }

    fn pread(&self, out: &mut [u8], offset: u64) -> Result<()> {
        self.file
            .read_exact_at(out, offset)
            .map_err(|e| Error::io(&self.info.path, format!("read {} bytes at {offset}", out.len()), e))
    }

    /// Refuses a block whose bytes are far more than it can decode to: no codec here makes data much larger.
    fn check_length(&self, block: u64, length: u64, decoded: usize) -> Result<()> {
        if length > 2 * decoded as u64 + (1 << 20) {
            return Err(self.broken(block, format!("{length} bytes in the file for {decoded} decoded ones")));
        }
        Ok(())
    }

    /// Decodes one block into `out` (bytes in the file's order, predictor not undone). False when the file holds none.
    fn block(&self, block: u64, out: &mut [u8], counters: &Counters) -> Result<bool> {
        let (offset, length) = self.layout.extent(block);
        if length == 0 {
            counters.add(0, 1, 0);
            return Ok(false);
        }
        counters.add(1, 0, length);
        if self.layout.codec == Codec::None {
            self.pread(out, offset)?;
            return Ok(true);
        }
        self.check_length(block, length, out.len())?;
        SCRATCH.with_borrow_mut(|scratch| {
            scratch.data.resize(length as usize, 0);
            self.pread(&mut scratch.data, offset)?;
            self.decompress(block, &scratch.data, out)
        })?;
        Ok(true)
    }

    fn decompress(&self, block: u64, data: &[u8], out: &mut [u8]) -> Result<()> {
        let rows = out.len() as u64 / self.layout.block_row_bytes();
        decompress::decompress(&self.layout, data, rows, out).map_err(|what| self.broken(block, what))
    }

    pub(super) fn undo_predictor_u8(&self, bytes: &mut [u8]) {
        if self.layout.predictor == Predictor::Horizontal {
            let row_bytes = self.layout.block_row_bytes() as usize;
            predictor::undo_u8(self.kernel, bytes, row_bytes, self.layout.block_samples());
        }
    }

    /// The blocks of one plane that make up a chunk: number and window within the image.
    fn blocks_of(&self, chunk: Window) -> impl Iterator<Item = (u64, Window)> + '_ {
        let (bw, bh) = (self.layout.block_width, self.layout.block_height);
        let rows = chunk.y / bh..chunk.bottom().div_ceil(bh);
        let columns = chunk.x / bw..chunk.right().div_ceil(bw);
        let (across, bounds) = (self.layout.blocks_across(), self.info.bounds());
        rows.flat_map(move |row| columns.clone().map(move |column| (row, column))).map(move |(row, column)| {
            (row * across + column, Window::new(column * bw, row * bh, bw, bh).intersect(&bounds))
        })
    }

    /// Start and length in the file of all blocks of a chunk when they follow each other without a gap.
    fn run_of(&self, chunk: Window) -> Option<(u64, u64)> {
        let mut run: Option<(u64, u64)> = None;
        for (block, _) in self.blocks_of(chunk) {
            let (offset, length) = self.layout.extent(block);
            run = match run {
                _ if length == 0 => return None,
                None => Some((offset, length)),
                Some((start, so_far)) if start + so_far == offset => Some((start, so_far + length)),
                Some(_) => return None,
            };
        }
        run
    }

    /// Interleaved 8-bit strips: they follow each other in memory as in the image, and mostly in the file, so that one
    /// request reads them all.
    fn strips_u8(&self, chunk: Window, counters: &Counters) -> Result<Chunk> {
        let row_bytes = self.layout.block_row_bytes() as usize;
        let mut out = self.pool.take(row_bytes * chunk.height as usize);
        let place = |window: Window| {
            let start = (window.y - chunk.y) as usize * row_bytes;
            start..start + window.height as usize * row_bytes
        };
        let run = self.run_of(chunk).filter(|&(_, length)| length <= 2 * out.len() as u64 + (1 << 20));
        let mut stored = Stored::of(run.is_some());
        match run {
            Some((start, length)) if self.layout.codec == Codec::None => {
                self.pread(&mut out, start)?;
                counters.add(self.blocks_of(chunk).count() as u64, 0, length);
            }
            Some((start, length)) => SCRATCH.with_borrow_mut(|scratch| {
                scratch.data.resize(length as usize, 0);
                self.pread(&mut scratch.data, start)?;
                for (block, window) in self.blocks_of(chunk) {
                    let (offset, length) = self.layout.extent(block);
                    let data = &scratch.data[(offset - start) as usize..][..length as usize];
                    let to = &mut out[place(window)];
                    self.decompress(block, data, to)?;
                    self.undo_predictor_u8(to);
                    counters.add(1, 0, length);
                }
                Ok(())
            })?,
            None => {
                for (block, window) in self.blocks_of(chunk) {
                    stored |= self.block_u8(block, &mut out[place(window)], counters)?;
                }
            }
        }
        Ok(self.chunk_u8(out, stored, row_bytes))
    }

    /// A whole interleaved 8-bit block, ready for use.
    fn block_u8(&self, block: u64, out: &mut [u8], counters: &Counters) -> Result<Stored> {
        let held = self.block(block, out, counters)?;
        if held {
            self.undo_predictor_u8(out);
        } else {
            out.fill(self.fill as u8);
        }
        Ok(Stored::of(held))
    }

    /// One interleaved 8-bit tile, with its padding.
    fn tile_u8(&self, block: u64, counters: &Counters) -> Result<Chunk> {
        let row_bytes = self.layout.block_row_bytes() as usize;
        let mut out = self.pool.take(row_bytes * self.layout.block_height as usize);
        let stored = self.block_u8(block, &mut out, counters)?;
        Ok(self.chunk_u8(out, stored, row_bytes))
    }

    /// A view of the file, where the chunk's blocks lie in it as they are wanted.
    fn view(&self, chunk: Window, counters: &Counters) -> Option<Result<Chunk>> {
        if !self.mapped || self.layout.codec != Codec::None {
            return None;
        }
        let (start, length) = self.run_of(chunk)?;
        counters.add(self.blocks_of(chunk).count() as u64, 0, length);
        let view = mapping::map(&self.file, start, length)
            .map_err(|e| Error::io(&self.info.path, format!("map {length} bytes at {start}"), e));
        Some(view.map(|map| {
            let data = PieceData::Mapped(map, 0);
            self.finish(data, Stored::InFile, self.layout.block_row_bytes() as usize, length)
        }))
    }

    /// A chunk of one compressed block: not decoded where the file's bytes are those of a block that was found to hold
    /// nothing.
    fn unless_hollow(&self, block: u64, counters: &Counters, decode: impl Fn() -> Result<Chunk>) -> Result<Chunk> {
        let (offset, length) = self.layout.extent(block);
        let decoded = self.layout.block_row_bytes() * self.layout.block_height;
        if self.layout.codec == Codec::None || !EmptyBlocks::worth_a_look(&self.info, length, decoded) {
            return decode();
        }
        let mut data = vec![0; length as usize];
        self.pread(&mut data, offset)?;
        let known = self.hollow.knows(&data);
        if known {
            counters.add(0, 1, length);
        }
        let chunk = match known {
            true => None,
            false => Some(decode()?).filter(|chunk| !holds_nothing(chunk, &self.info)),
        };
        Ok(chunk.unwrap_or_else(|| {
            self.hollow.remember(&data);
            Chunk { data: None, offset: 0, row_stride: 0, pixel_stride: self.samples(), bytes: 0 }
        }))
    }

    pub(super) fn chunk_u8(&self, out: Vec<u8>, stored: Stored, row_stride: usize) -> Chunk {
        let bytes = out.len() as u64;
        let data = PieceData::U8(self.pool.share(out));
        self.finish(data, stored, row_stride, bytes)
    }

    /// A chunk without a block in the file is handed out as empty only where its pixels count as holding nothing; zeros
    /// that are valid pixels are given as such.
    pub(super) fn finish(&self, data: PieceData, stored: Stored, row_stride: usize, bytes: u64) -> Chunk {
        let transparent = self.info.alpha.is_some() && self.fill == 0;
        let hollow = stored == Stored::Nowhere && (self.info.nodata_sample() == Some(self.fill) || transparent);
        let (data, bytes) = if hollow { (None, 0) } else { (Some(data), bytes) };
        Chunk { data, offset: 0, row_stride, pixel_stride: self.samples(), bytes }
    }

    /// Everything else: each block is decoded to scratch and its samples are put where they belong.
    fn assembled(&self, chunk: Window, counters: &Counters) -> Result<Chunk> {
        let row_stride = chunk.width as usize * self.samples();
        let count = row_stride * chunk.height as usize;
        let bytes = (count * self.layout.sample.bytes()) as u64;
        let (data, stored) = match self.info.sample {
            SampleType::U8 => {
                let mut out = self.pool.take(count);
                let stored = self.assemble(chunk, counters, &mut out, |raw, row| self.row_u8(raw, row))?;
                (PieceData::U8(self.pool.share(out)), stored)
            }
            SampleType::U16 => {
                let mut out = vec![0; count];
                let stored = self.assemble(chunk, counters, &mut out, |raw, row| self.row_u16(raw, row))?;
                (PieceData::U16(out.into()), stored)
            }
        };
        Ok(self.finish(data, stored, row_stride, bytes))
    }

    /// Samples of one decoded row of a block.
    fn row_u8(&self, raw: &[u8], row: &mut [u8]) {
        row.copy_from_slice(raw);
        self.undo_predictor_u8(row);
    }

    pub(super) fn row_u16(&self, raw: &[u8], row: &mut [u16]) {
        predictor::words(raw, row, self.order);
        if self.layout.predictor == Predictor::Horizontal {
            predictor::undo_u16(self.kernel, row, self.layout.block_samples());
        }
    }

    /// `convert` turns the bytes of a row of a block into samples. Returns whether the file holds any of the blocks.
    fn assemble<T: Copy + Default + TryFrom<u16>>(
        &self,
        chunk: Window,
        counters: &Counters,
        out: &mut [T],
        convert: impl Fn(&[u8], &mut [T]),
    ) -> Result<Stored> {
        let (samples, per_block) = (self.samples(), self.layout.block_samples());
        let fill = T::try_from(self.fill).unwrap_or_default();
        let row_bytes = self.layout.block_row_bytes() as usize;
        let row_stride = chunk.width as usize * samples;
        let mut line = vec![T::default(); self.layout.block_width as usize * per_block];
        let mut stored = Stored::Nowhere;
        // Taken out of the cell: decoding a block borrows the cell too.
        let mut raw = SCRATCH.with_borrow_mut(|scratch| std::mem::take(&mut scratch.block));
        for plane in 0..if self.layout.planar { samples } else { 1 } {
            let first = if self.layout.planar { self.planes[plane] as u64 * self.layout.blocks_per_plane() } else { 0 };
            for (block, window) in self.blocks_of(chunk) {
                let rows = self.layout.block_rows(window.y / self.layout.block_height) as usize;
                raw.resize(row_bytes * rows, 0);
                let held = self.block(first + block, &mut raw, counters)?;
                stored |= Stored::of(held);
                line.fill(fill);
                for y in 0..window.height as usize {
                    let row = (window.y - chunk.y) as usize + y;
                    let start = row * row_stride + (window.x - chunk.x) as usize * samples;
                    let to = &mut out[start..start + window.width as usize * samples];
                    if held {
                        convert(&raw[y * row_bytes..][..row_bytes], &mut line);
                    }
                    if per_block == samples {
                        to.copy_from_slice(&line[..to.len()]);
                    } else {
                        to[plane..].iter_mut().step_by(samples).zip(&line).for_each(|(to, &from)| *to = from);
                    }
                }
            }
        }
        SCRATCH.with_borrow_mut(|scratch| scratch.block = raw);
        Ok(stored)
    }

    /// The parts of the file, offset and length in bytes, that hold the blocks of `window`, in runs as long as
    /// possible.
    fn runs(&self, window: Window, which: Blocks, mut tell: impl FnMut((u64, u64))) {
        let planes: Vec<usize> = if self.layout.planar { self.planes.clone() } else { vec![0] };
        for plane in planes {
            let first = plane as u64 * self.layout.blocks_per_plane();
            let mut run = (0, 0);
            for (block, part) in self.blocks_of(window) {
                if which == Blocks::Inside && !window.contains_window(&part) {
                    continue;
                }
                let (offset, length) = self.layout.extent(first + block);
                if run.0 + run.1 == offset {
                    run.1 += length;
                    continue;
                }
                tell(run);
                run = (offset, length);
            }
            tell(run);
        }
    }
}

impl ChunkDecoder for TiffDecoder {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn grid(&self) -> &TileGrid {
        &self.grid
    }

    fn decode(&self, id: u64, counters: &Counters) -> Result<Chunk> {
        if let Some(stream) = &self.stream {
            return self.streamed(id, stream, counters);
        }
        let chunk = self.grid.tile(id).core;
        let simple = self.info.sample == SampleType::U8 && !self.layout.planar;
        let block = (self.layout.block_width, self.layout.block_height);
        // A grid of one chunk clips its tile; what counts is whether one block fills the chunk.
        let single = self.blocks_of(chunk).take(2).count() == 1;
        let number = chunk.y / block.1 * self.layout.blocks_across() + chunk.x / block.0;
        match (simple, self.layout.tiled) {
            (true, false) => self.view(chunk, counters).unwrap_or_else(|| self.strips_u8(chunk, counters)),
            (true, true) if single => self
                .view(chunk, counters)
                .unwrap_or_else(|| self.unless_hollow(number, counters, || self.tile_u8(number, counters))),
            (false, true) if single && !self.layout.planar => {
                self.unless_hollow(number, counters, || self.assembled(chunk, counters))
            }
            _ => self.assembled(chunk, counters),
        }
    }

    fn prefetch(&self, window: Window) {
        self.runs(window, Blocks::Touching, |run| mapping::read_ahead(&self.file, run));
    }

    fn release(&self, window: Window) {
        if self.drop_behind {
            self.runs(window, Blocks::Inside, |run| mapping::advise(&self.file, run, rustix::fs::Advice::DontNeed));
        }
    }
}

/// Bands in the order in which they are handed out, and where colours and alpha are among them. Interleaved bands are
/// decoded together anyway; of separate planes only those that are needed are read.
fn bands_to_read(layout: &Layout) -> (Vec<usize>, [usize; 3], Option<usize>) {
    if !layout.planar {
        return ((0..layout.samples).collect(), layout.rgb, layout.alpha);
    }
    let mut planes = layout.rgb.to_vec();
    planes.dedup();
    let rgb = if planes.len() == 3 { [0, 1, 2] } else { [0; 3] };
    let alpha = layout.alpha.map(|band| {
        planes.push(band);
        planes.len() - 1
    });
    (planes, rgb, alpha)
}

fn side_file(path: &std::path::Path, ending: &str) -> std::path::PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

fn describe(all: &Directories, layout: &Layout) -> String {
    let kind = if all.big { "BigTIFF" } else { "TIFF" };
    let predictor = if layout.predictor == Predictor::Horizontal { ", predictor 2" } else { "" };
    let blocks = match layout.tiled {
        true => format!("tiles of {} x {}", layout.block_width, layout.block_height),
        false => format!("strips of {} rows", layout.block_height),
    };
    let planar = if layout.planar { ", planar" } else { "" };
    format!("{kind}, {}{predictor}, {blocks}{planar}", layout.codec.name())
}
