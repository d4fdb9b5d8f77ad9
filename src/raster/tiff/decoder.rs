//! From chunks of the grid to blocks of the file.

use std::cell::RefCell;
use std::fs::File;
use std::os::unix::fs::FileExt;

use super::codec;
use super::container::{ByteOrder, Directories};
use super::layout::{Codec, Layout};
use super::predictor;
use crate::error::{Error, Result};
use crate::raster::cache::Chunk;
use crate::raster::chunked::{ChunkDecoder, ChunkedSource, Counters, group_blocks};
use crate::raster::gdal::Facts;
use crate::raster::{BlockLayout, BufferPool, PieceData, RasterInfo, SampleType};
use crate::window::{TileGrid, Window};

/// Reads image directory `index` of a file.
///
/// # Errors
/// [`Error::Unsupported`] when GDAL must do it, [`Error::Limit`] when one block is larger than `cache_bytes`.
pub fn open(all: &Directories, index: usize, cache_bytes: u64) -> Result<ChunkedSource<TiffDecoder>> {
    Ok(ChunkedSource::new(TiffDecoder::new(all, index, cache_bytes)?, cache_bytes))
}

thread_local! {
    /// Compressed bytes, and a decoded block that is copied on.
    static SCRATCH: RefCell<(Vec<u8>, Vec<u8>)> = const { RefCell::new((Vec::new(), Vec::new())) };
}

/// The part of the native reader that knows TIFF.
pub struct TiffDecoder {
    file: std::sync::Arc<File>,
    order: ByteOrder,
    layout: Layout,
    info: RasterInfo,
    grid: TileGrid,
    /// Bands of the file in the order in which they are handed out; of interleaved files all.
    planes: Vec<usize>,
    pool: BufferPool,
    fill: u16,
    kernel: predictor::Kernel,
}

impl TiffDecoder {
    fn new(all: &Directories, index: usize, cache_bytes: u64) -> Result<Self> {
        let layout = Layout::read(all, index)?;
        if all.mask_of(index)?.is_some() || side_file(&all.path, ".msk").exists() {
            let what = "a mask beside the image by the native reader";
            return Err(Error::unsupported(&all.path, what, "use --reader auto or gdal"));
        }
        let (planes, rgb, alpha) = bands_to_read(&layout);
        let pixel_bytes = (planes.len() * layout.sample.bytes()) as u64;
        let block = (layout.block_width, layout.block_height);
        let group = group_blocks(block, (layout.width, layout.height), pixel_bytes);
        let (width, height) = (layout.width, layout.height);
        let (mut chunk_width, mut chunk_height) = (block.0 * group.0, block.1 * group.1);
        if group == (1, 1) && !layout.tiled {
            chunk_width = chunk_width.min(width);
            chunk_height = chunk_height.min(height);
        }
        let chunk_bytes = chunk_width.saturating_mul(chunk_height).saturating_mul(pixel_bytes);
        if chunk_bytes > cache_bytes {
            return Err(Error::Limit {
                what: format!(
                    "{}: one {} block of {} x {} pixels",
                    all.path.display(),
                    layout.codec.name(),
                    block.0,
                    block.1
                ),
                needed: chunk_bytes,
                allowed: cache_bytes,
                remedy: crate::raster::open::retile_remedy(&all.path),
            });
        }
        let grid = TileGrid::new(width, height, chunk_width, chunk_height, 0);
        let facts = facts(all, index);
        let mut info = RasterInfo {
            path: all.path.clone(),
            width,
            height,
            bands: layout.samples,
            sample: layout.sample,
            rgb,
            alpha,
            nodata: layout.nodata.or(facts.nodata),
            white: crate::raster::open::white_of(layout.sample, None, layout.max_sample_value),
            layout: match layout.tiled {
                true => BlockLayout::Tiles { width: block.0, height: block.1 },
                false => BlockLayout::Strips { rows: block.1 },
            },
            blocks: layout.blocks_per_plane() * if layout.planar { planes.len() as u64 } else { 1 },
            chunk_bytes,
            sequential: false,
            reader: "native",
            description: describe(all, &layout),
            geotransform: facts.geotransform,
            crs_wkt: facts.crs_wkt,
            resolution_m_per_px: facts.resolution_m_per_px,
        };
        if info.nodata.is_some_and(f64::is_nan) {
            info.nodata = None;
        }
        let fill = info.fill_value();
        let pool = BufferPool::new((cache_bytes / 4 / chunk_bytes.max(1)).clamp(2, 64) as usize);
        Ok(TiffDecoder {
            file: all.file.clone(),
            order: all.order,
            layout,
            info,
            grid,
            planes,
            pool,
            fill,
            kernel: predictor::Kernel::best(),
        })
    }

    fn samples(&self) -> usize {
        self.planes.len()
    }

    fn broken(&self, block: u64, what: String) -> Error {
        Error::format(&self.info.path, self.layout.block_name(block), what)
    }

    fn pread(&self, out: &mut [u8], offset: u64) -> Result<()> {
        self.file
            .read_exact_at(out, offset)
            .map_err(|e| Error::io(&self.info.path, format!("read {} bytes at {offset}", out.len()), e))
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
        // No codec here makes data much larger than they were.
        let largest = 2 * out.len() as u64 + (1 << 20);
        if length > largest {
            return Err(self.broken(block, format!("{length} bytes for {} decoded ones", out.len())));
        }
        let rows = out.len() as u64 / self.layout.block_row_bytes();
        SCRATCH.with_borrow_mut(|(data, _)| {
            data.resize(length as usize, 0);
            self.pread(data, offset)?;
            codec::decompress(&self.layout, data, rows, out).map_err(|what| self.broken(block, what))
        })?;
        Ok(true)
    }

    /// A whole interleaved 8-bit block, ready for use.
    fn block_u8(&self, block: u64, out: &mut [u8], counters: &Counters) -> Result<bool> {
        let held = self.block(block, out, counters)?;
        if !held {
            out.fill(self.fill as u8);
        } else if self.layout.predictor {
            predictor::undo_u8(self.kernel, out, self.layout.block_row_bytes() as usize, self.layout.block_samples());
        }
        Ok(held)
    }

    /// The blocks of one plane that make up a chunk: number and window within the image.
    fn blocks_of(&self, chunk: Window) -> impl Iterator<Item = (u64, Window)> + '_ {
        let (bw, bh) = (self.layout.block_width, self.layout.block_height);
        let rows = chunk.y / bh..chunk.bottom().div_ceil(bh);
        let columns = chunk.x / bw..chunk.right().div_ceil(bw);
        let across = self.layout.blocks_across();
        rows.flat_map(move |row| columns.clone().map(move |column| (row * across + column, row, column))).map(
            move |(block, row, column)| {
                (block, Window::new(column * bw, row * bh, bw, bh).intersect(&self.info.bounds()))
            },
        )
    }

    /// Interleaved 8-bit strips: they follow each other in memory as in the image.
    fn strips_u8(&self, chunk: Window, counters: &Counters) -> Result<Chunk> {
        let row_bytes = self.layout.block_row_bytes() as usize;
        let mut out = self.pool.take(row_bytes * chunk.height as usize);
        let mut any = false;
        for (block, window) in self.blocks_of(chunk) {
            let start = (window.y - chunk.y) as usize * row_bytes;
            any |= self.block_u8(block, &mut out[start..start + window.height as usize * row_bytes], counters)?;
        }
        Ok(self.chunk_u8(out, any, row_bytes))
    }

    /// One interleaved 8-bit tile, with its padding.
    fn tile_u8(&self, block: u64, counters: &Counters) -> Result<Chunk> {
        let row_bytes = self.layout.block_row_bytes() as usize;
        let mut out = self.pool.take(row_bytes * self.layout.block_height as usize);
        let any = self.block_u8(block, &mut out, counters)?;
        Ok(self.chunk_u8(out, any, row_bytes))
    }

    fn chunk_u8(&self, out: Vec<u8>, any: bool, row_stride: usize) -> Chunk {
        let bytes = out.len() as u64;
        let data = PieceData::U8(self.pool.share(out));
        self.finish(data, any, row_stride, bytes)
    }

    /// A chunk without a block in the file is handed out as empty only where its pixels count as holding nothing; zeros
    /// that are valid pixels are given as such.
    fn finish(&self, data: PieceData, any: bool, row_stride: usize, bytes: u64) -> Chunk {
        let hollow =
            !any && (self.info.nodata_sample() == Some(self.fill) || (self.info.alpha.is_some() && self.fill == 0));
        let (data, bytes) = if hollow { (None, 0) } else { (Some(data), bytes) };
        Chunk { data, offset: 0, row_stride, pixel_stride: self.samples(), bytes }
    }

    /// Everything else: each block is decoded to scratch and its samples are put where they belong.
    fn assembled(&self, chunk: Window, counters: &Counters) -> Result<Chunk> {
        let samples = self.samples();
        let row_stride = chunk.width as usize * samples;
        let count = row_stride * chunk.height as usize;
        let mut any = false;
        let bytes = (count * self.layout.sample.bytes()) as u64;
        let data = match self.layout.sample {
            SampleType::U8 => {
                let mut out = self.pool.take(count);
                self.assemble(chunk, counters, &mut any, &mut out, |raw, predictor, row, samples| {
                    row.copy_from_slice(raw);
                    if predictor {
                        let row_bytes = row.len();
                        predictor::undo_u8(self.kernel, row, row_bytes, samples);
                    }
                })?;
                PieceData::U8(self.pool.share(out))
            }
            SampleType::U16 => {
                let mut out = vec![0; count];
                let big = self.order == ByteOrder::Big;
                self.assemble(chunk, counters, &mut any, &mut out, |raw, predictor, row, samples| {
                    predictor::words(raw, row, big);
                    if predictor {
                        predictor::undo_u16(self.kernel, row, samples);
                    }
                })?;
                PieceData::U16(out.into())
            }
        };
        Ok(self.finish(data, any, row_stride, bytes))
    }

    /// `convert` turns the bytes of a row into samples.
    fn assemble<T: Copy + Default + TryFrom<u16>>(
        &self,
        chunk: Window,
        counters: &Counters,
        any: &mut bool,
        out: &mut [T],
        convert: impl Fn(&[u8], bool, &mut [T], usize),
    ) -> Result<()> {
        let (samples, stored) = (self.samples(), self.layout.block_samples());
        let row_stride = chunk.width as usize * samples;
        let fill = T::try_from(self.fill).unwrap_or_default();
        let row_bytes = self.layout.block_row_bytes() as usize;
        let mut line = vec![T::default(); self.layout.block_width as usize * stored];
        for plane in 0..if self.layout.planar { samples } else { 1 } {
            let first = if self.layout.planar { self.planes[plane] as u64 * self.layout.blocks_per_plane() } else { 0 };
            for (block, window) in self.blocks_of(chunk) {
                let rows = self.layout.block_rows(window.y / self.layout.block_height) as usize;
                let mut raw = SCRATCH.with_borrow_mut(|(_, raw)| std::mem::take(raw));
                raw.resize(row_bytes * rows, 0);
                let held = self.block(first + block, &mut raw, counters)?;
                *any |= held;
                for y in 0..window.height as usize {
                    let start =
                        ((window.y - chunk.y) as usize + y) * row_stride + (window.x - chunk.x) as usize * samples;
                    let to = &mut out[start..start + window.width as usize * samples];
                    if held {
                        convert(&raw[y * row_bytes..][..row_bytes], self.layout.predictor, &mut line, stored);
                    } else {
                        line.fill(fill);
                    }
                    if stored == samples {
                        to.copy_from_slice(&line[..to.len()]);
                    } else {
                        to[plane..].iter_mut().step_by(samples).zip(&line).for_each(|(to, &from)| *to = from);
                    }
                }
                SCRATCH.with_borrow_mut(|(_, kept)| *kept = raw);
            }
        }
        Ok(())
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
        let chunk = self.grid.tile(id).core;
        let simple = self.layout.sample == SampleType::U8 && !self.layout.planar;
        let single =
            (self.grid.tile_width(), self.grid.tile_height()) == (self.layout.block_width, self.layout.block_height);
        match (simple, self.layout.tiled) {
            (true, false) => self.strips_u8(chunk, counters),
            (true, true) if single => self.tile_u8(id, counters),
            _ => self.assembled(chunk, counters),
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

/// Georeference and CRS as GDAL reads them, from the file and those beside it. A file that GDAL cannot open has none.
fn facts(all: &Directories, index: usize) -> Facts {
    crate::raster::initialise_gdal(0);
    match crate::raster::gdal::GdalName::new(&all.path, index).open() {
        Ok(dataset) => Facts::of(&dataset),
        Err(error) => {
            tracing::debug!("no georeference from GDAL: {error}");
            Facts::default()
        }
    }
}

fn describe(all: &Directories, layout: &Layout) -> String {
    let kind = if all.big { "BigTIFF" } else { "TIFF" };
    let predictor = if layout.predictor { ", predictor 2" } else { "" };
    let blocks = match layout.tiled {
        true => format!("tiles of {} x {}", layout.block_width, layout.block_height),
        false => format!("strips of {} rows", layout.block_height),
    };
    let planar = if layout.planar { ", planar" } else { "" };
    format!("{kind}, {}{predictor}, {blocks}{planar}", layout.codec.name())
}
