//! Opening rasters and reading windows of them, with what every crate above needs to speak of pixels and places:
//! windows and tiles ([`window`]), coordinates ([`coords`]), coordinate reference systems ([`crs`]), errors
//! ([`error`]), memory plans ([`memory_plan`]) and files that appear whole or not at all ([`atomic`]).
//!
//! This crate imports none of the others. Here and in the writers at the other end of the flow, and nowhere else,
//! raster files are touched.
//!
//! A [`RasterSource`] hands out [`Block`]s: the pixels of a window as a list of [`Piece`]s, one for each file block (or
//! group of strips) that the window meets. A piece is either decoded into a pooled buffer or a view of the mapped file,
//! so that nothing is copied on the way to the segmenter.
//!
//! ```
//! use autoref_raster::RasterSource;
//! use autoref_raster::memory::MemorySource;
//! use autoref_raster::window::Window;
//! let source = MemorySource::rgb8(4, 2, vec![128; 4 * 2 * 3]); // `open` does the same with files
//! let block = source.read(Window::new(1, 0, 2, 2))?;
//! assert_eq!((block.window.width, source.info().bands), (2, 3));
//! # Ok::<(), autoref_raster::Error>(())
//! ```

mod aside;
pub mod atomic;
pub mod bilinear;
pub mod bounded;
mod cache;
pub mod cells;
pub mod child;
mod chunked;
pub mod cloud_optimised;
pub mod coords;
pub mod crs;
pub mod dates;
mod described;
mod elevation;
pub mod error;
pub mod exact_sum;
mod few_bits;
pub mod fingerprint;
mod gdal;
mod height_band;
pub mod jpeg_end;
pub mod keys;
pub mod markup;
pub mod mask;
pub mod masked;
pub mod memory;
pub mod memory_plan;
pub mod normal;
mod open;
pub mod output_folder;
mod parts;
mod patch;
pub mod path_text;
mod pool;
pub mod protected;
pub mod random;
pub mod ranks;
pub mod referred;
pub mod rings;
pub mod sets;
pub mod sidecars;
pub mod simd;
pub mod srgb;
pub mod tiff;
pub mod tile_folder;
pub mod units;
mod white;
pub mod window;
pub mod words;
mod written;

pub use described::{Described, Georeference, with_georeference};
pub use elevation::ElevationModel;
pub use error::{Error, Result};
pub use few_bits::FewBits;
pub use gdal::{GdalSource, hear_gdal, initialise_gdal, vector_options};
pub use height_band::{
    HeightBand, metres_per_value, refuse_signed_bytes, same_unit, set_height_unit, set_unit, unit_of,
};
pub use open::{georeference_at, georeference_inside, open, open_dataset, size};
pub use patch::{Pixels, View, read_patch};
pub use pool::{BufferPool, PooledBytes};
pub use white::with_white;
pub use written::{Written, failed_to_write, free_disk_bytes, is_cut_table, unheard};

use std::path::PathBuf;
use std::sync::Arc;

use crate::coords::GeoTransform;
use crate::window::Window;

/// Which decoder to use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReaderChoice {
    /// Native where it can, GDAL for everything else.
    #[default]
    Auto,
    Native,
    /// Native, with uncompressed blocks of bytes as views of the file instead of copies: several programs that read one
    /// file share its pages. A file that another program cuts off meanwhile ends the process with a signal.
    Mapped,
    Gdal,
}

impl ReaderChoice {
    /// Nothing is passed on to GDAL.
    fn is_native(self) -> bool {
        matches!(self, ReaderChoice::Native | ReaderChoice::Mapped)
    }

    /// As the command line and the JSON write it.
    pub fn name(self) -> &'static str {
        match self {
            ReaderChoice::Auto => "auto",
            ReaderChoice::Native => "native",
            ReaderChoice::Mapped => "mapped",
            ReaderChoice::Gdal => "gdal",
        }
    }
}

/// How samples are stored once decoded. Wider or other types (float, complex) are not images to us: elevation models go
/// through [`crate`]'s GDAL reader as `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleType {
    U8,
    U16,
}

impl SampleType {
    /// Bytes of a sample.
    pub fn bytes(self) -> usize {
        match self {
            SampleType::U8 => 1,
            SampleType::U16 => 2,
        }
    }
}

/// How the file lays its blocks out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockLayout {
    /// Rectangles; edge blocks may be padded in the file, never in what we hand out.
    Tiles { width: u64, height: u64 },
    /// Full-width strips of that many rows.
    Strips { rows: u64 },
}

/// What a raster is, as far as the stages need to know.
#[derive(Clone, Debug)]
pub struct RasterInfo {
    pub path: PathBuf,
    pub width: u64,
    pub height: u64,
    /// Bands in the file, alpha included.
    pub bands: usize,
    pub sample: SampleType,
    /// Where red, green and blue are among the samples of a pixel as handed out; one grey band three times. (Of planar
    /// files only the bands that are needed are read, so this need not be the number of the band in the file.)
    pub rgb: [usize; 3],
    /// Where the alpha (or mask) sample is, likewise.
    pub alpha: Option<usize>,
    /// A pixel whose colour bands all have this value holds nothing.
    pub nodata: Option<f64>,
    /// The value of full white: 255, 65535, or what MaxSampleValue, NBITS or the caller ([`with_white`]) say.
    pub white: u16,
    pub layout: BlockLayout,
    /// Number of blocks in the file, of the bands that are read.
    pub blocks: u64,
    /// Bytes of one decoded unit of reading; the memory plan counts with it.
    pub chunk_bytes: u64,
    /// The source can only be read from the top down without reading again (PNG, JPEG, one-strip files).
    pub sequential: bool,
    /// "native" or "gdal", with the driver's name and compression for the log.
    pub reader: &'static str,
    pub description: String,
    /// An existing georeference, in GDAL's convention (pixel corner), whatever the file's.
    pub geotransform: Option<GeoTransform>,
    /// WKT of an existing CRS.
    pub crs_wkt: Option<String>,
    /// Size of a pixel on the ground from the resolution tags, where they can mean that.
    pub resolution_m_per_px: Option<f64>,
}

impl RasterInfo {
    /// The whole raster.
    pub fn bounds(&self) -> Window {
        Window::whole(self.width, self.height)
    }
    /// Number of pixels.
    pub fn pixels(&self) -> u64 {
        self.width * self.height
    }

    /// The nodata value as a sample, when a sample can have it.
    pub fn nodata_sample(&self) -> Option<u16> {
        let largest = match self.sample {
            SampleType::U8 => 255.0,
            SampleType::U16 => 65_535.0,
        };
        self.nodata.filter(|value| value.fract() == 0.0 && (0.0..=largest).contains(value)).map(|value| value as u16)
    }

    /// What pixels read as where the file holds no block: the nodata value, clamped to the sample type, or zero. This
    /// is what GDAL gives.
    pub fn fill_value(&self) -> u16 {
        let largest = match self.sample {
            SampleType::U8 => 255.0,
            SampleType::U16 => 65_535.0,
        };
        // Not-a-number becomes zero.
        self.nodata.map_or(0, |value| value.round().clamp(0.0, largest) as u16)
    }
}

/// Samples of a piece, native byte order.
#[derive(Clone, Copy, Debug)]
pub enum Samples<'a> {
    U8(&'a [u8]),
    U16(&'a [u16]),
}

/// One row of pixels (or part of it), as the segmenter takes it. Sample `b` of pixel `i` is at
/// `i * pixel_stride + b`.
#[derive(Clone, Copy, Debug)]
pub struct PixelRow<'a> {
    pub samples: Samples<'a>,
    /// Samples from one pixel to the next.
    pub pixel_stride: usize,
    /// Number of pixels.
    pub len: usize,
}

/// Where the samples of a piece lie.
#[derive(Clone, Debug)]
pub enum PieceData {
    U8(Arc<PooledBytes>),
    U16(Arc<Vec<u16>>),
    /// A window of the mapped file, with the offset of the first sample. Bytes only.
    Mapped(Arc<memmap2::Mmap>, usize),
}

/// Pixels of a rectangle, row-major and band-interleaved, all from one file block or group of strips.
#[derive(Clone, Debug)]
pub struct Piece {
    pub window: Window,
    pub data: PieceData,
    /// Index of the sample of the window's first pixel in `data` (the data may hold a larger rectangle).
    pub offset: usize,
    /// Samples from one row to the next.
    pub row_stride: usize,
    /// Samples from one pixel to the next.
    pub pixel_stride: usize,
    /// No pixel here holds anything (sparse block, nodata, zero alpha): not decoded, `data` is empty.
    pub empty: bool,
}

impl Piece {
    /// Part of a row: `len` pixels from column `x` of row `y`, image coordinates, which must lie in the window.
    pub fn row(&self, x: u64, y: u64, len: u64) -> PixelRow<'_> {
        debug_assert!(!self.empty && self.window.contains_window(&Window::new(x, y, len, 1)));
        let first = self.offset
            + (y - self.window.y) as usize * self.row_stride
            + (x - self.window.x) as usize * self.pixel_stride;
        let count =
            (len as usize).saturating_sub(1) * self.pixel_stride + self.pixel_stride.min(self.samples_left(first));
        let samples = match &self.data {
            PieceData::U8(buffer) => Samples::U8(&buffer.bytes[first..first + count]),
            PieceData::U16(buffer) => Samples::U16(&buffer[first..first + count]),
            PieceData::Mapped(map, start) => Samples::U8(&map[start + first..start + first + count]),
        };
        PixelRow { samples, pixel_stride: self.pixel_stride, len: len as usize }
    }

    fn samples_left(&self, first: usize) -> usize {
        match &self.data {
            PieceData::U8(buffer) => buffer.bytes.len() - first,
            PieceData::U16(buffer) => buffer.len() - first,
            PieceData::Mapped(map, start) => map.len() - start - first,
        }
    }
}

/// The pixels of a window: pieces that cover it exactly, in row-major order, none overlapping.
#[derive(Clone, Debug)]
pub struct Block {
    pub window: Window,
    pub pieces: Vec<Piece>,
}

/// A small window copied together: RGB(A) as read, row-major, for everything that looks at one mark at a time.
#[derive(Clone, Debug)]
pub struct Patch {
    pub window: Window,
    /// Three samples a pixel, red, green, blue, scaled by nothing.
    pub rgb: Vec<[u16; 3]>,
    /// False where the pixel holds nothing (nodata, zero alpha, mask).
    pub valid: Vec<bool>,
    /// The value of full white.
    pub white: u16,
}

impl Patch {
    /// The part of the patch in `window`, which is clipped at the patch's own.
    pub fn crop(&self, window: &Window) -> Patch {
        let window = window.intersect(&self.window);
        if window.is_empty() {
            return Patch { window, rgb: Vec::new(), valid: Vec::new(), white: self.white };
        }
        let width = self.window.width as usize;
        let left = (window.x - self.window.x) as usize;
        let rows = (window.y - self.window.y) as usize..(window.bottom() - self.window.y) as usize;
        let count = window.area() as usize;
        let (mut rgb, mut valid) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for first in rows.map(|y| y * width + left) {
            rgb.extend_from_slice(&self.rgb[first..first + window.width as usize]);
            valid.extend_from_slice(&self.valid[first..first + window.width as usize]);
        }
        Patch { window, rgb, valid, white: self.white }
    }
}

/// How much was read, for the report and the tests of "each file block is decoded once".
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReadStats {
    pub blocks_decoded: u64,
    pub blocks_skipped: u64,
    pub bytes_read: u64,
}

/// A raster that can be read in windows by several threads at once.
pub trait RasterSource: Send + Sync {
    fn info(&self) -> &RasterInfo;

    /// The pixels of `window`, which must lie inside the raster.
    ///
    /// # Errors
    /// When the file cannot be read or a block in it is broken; the message names the block.
    fn read(&self, window: Window) -> Result<Block>;

    /// Like [`RasterSource::read`], and shows each piece to `see` as soon as it is there, where that can be before the
    /// others.
    ///
    /// # Errors
    /// Those of [`RasterSource::read`]; `see` may have seen some pieces.
    fn read_seen(&self, window: Window, see: &mut dyn FnMut(&Piece)) -> Result<Block> {
        let block = self.read(window)?;
        block.pieces.iter().for_each(see);
        Ok(block)
    }

    /// The system may fetch the bytes of `window` now; a later read will want them.
    fn prefetch(&self, _window: Window) {}

    /// The pixels of `window` will not be wanted again: what is kept of them may go, from our cache and from the
    /// system's.
    fn release(&self, _window: Window) {}

    /// Everything read so far.
    fn stats(&self) -> ReadStats;
}
