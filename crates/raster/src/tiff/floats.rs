//! Band 1 of TIFFs of 32-bit floating-point numbers, as elevation models are kept: GDAL undoes the floating-point
//! predictor byte by byte, which takes longer than all else that is asked of a model.

use std::cell::RefCell;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

use super::container::{ByteOrder, Directories, is_tiff};
use super::decompress;
use super::layout::{Codec, Layout, Predictor, Samples};
use super::predictor;
use crate::cache::{Cached, ChunkCache};
use crate::error::{Error, Result};

/// Decoded blocks that are kept, of all files together, where nobody says how much.
const CACHE_BYTES: u64 = 16 << 20;
/// A larger block is decoded by GDAL, which counts it.
const LARGEST_BLOCK_BYTES: u64 = 8 << 20;
/// Blocks of a file, at most: what is left of a key's bits tells the files apart.
const MOST_BLOCKS: u64 = 1 << 40;

static CACHE: OnceLock<ChunkCache<Decoded>> = OnceLock::new();

/// Bounds the decoded blocks that are kept, of all files together. The first call counts.
pub fn bound_float_cache(bytes: u64) {
    CACHE.get_or_init(|| ChunkCache::new(bytes));
}

/// A decoded block, row by row; empty where the file holds none.
#[derive(Clone)]
struct Decoded(Arc<Vec<f32>>);

impl Cached for Decoded {
    fn bytes(&self) -> u64 {
        size_of_val(self.0.as_slice()) as u64
    }
}

#[derive(Default)]
struct Scratch {
    stored: Vec<u8>,
    bytes: Vec<u8>,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// An open file. Threads share it.
pub struct FloatTiff {
    path: PathBuf,
    file: Arc<File>,
    order: ByteOrder,
    layout: Layout,
    kernel: predictor::Kernel,
    /// Tells this file's blocks from those of others.
    number: u64,
}

impl FloatTiff {
    /// `None` where the file is no TIFF of one band of such numbers in lossless blocks of moderate size.
    pub fn open(path: &Path) -> Option<Self> {
        if !is_tiff(path).ok()? {
            return None;
        }
        let all = Directories::read(path).ok()?;
        let layout = Layout::read(&all, 0).ok()?;
        let block_bytes = layout.block_row_bytes().checked_mul(layout.block_height)?;
        let taken = layout.sample == Samples::Float32
            && layout.samples == 1
            && layout.codec != Codec::Jpeg
            && block_bytes <= LARGEST_BLOCK_BYTES
            && layout.blocks_per_plane() < MOST_BLOCKS;
        if !taken {
            return None;
        }
        static FILES: AtomicU64 = AtomicU64::new(0);
        let number = FILES.fetch_add(1, Ordering::Relaxed);
        let (file, order) = (all.file.clone(), all.order);
        Some(FloatTiff {
            path: path.to_path_buf(),
            file,
            order,
            layout,
            kernel: predictor::Kernel::best(),
            number: number & ((1 << 24) - 1),
        })
    }

    /// Columns and rows.
    pub fn size(&self) -> (u64, u64) {
        (self.layout.width, self.layout.height)
    }

    /// The numbers of a window that lies in the raster, row by row; `empty` where the file holds no block.
    ///
    /// # Errors
    /// When the file cannot be read, or a block is broken.
    pub fn read(&self, (x, y): (u64, u64), (width, height): (usize, usize), empty: f64, out: &mut [f64]) -> Result<()> {
        let cache = CACHE.get_or_init(|| ChunkCache::new(CACHE_BYTES));
        let (bw, bh) = (self.layout.block_width, self.layout.block_height);
        let (right, bottom) = (x + width as u64, y + height as u64);
        for row in y / bh..bottom.div_ceil(bh) {
            for column in x / bw..right.div_ceil(bw) {
                let block = row * self.layout.blocks_across() + column;
                let decoded = cache.get(self.number * MOST_BLOCKS + block, || self.decode(block))?;
                let (left, top) = (x.max(column * bw), y.max(row * bh));
                let across = (right.min((column + 1) * bw) - left) as usize;
                for line in top..bottom.min((row + 1) * bh) {
                    let to = &mut out[(line - y) as usize * width + (left - x) as usize..][..across];
                    if decoded.0.is_empty() {
                        to.fill(empty);
                        continue;
                    }
                    let from = ((line - row * bh) * bw + left - column * bw) as usize;
                    to.iter_mut().zip(&decoded.0[from..from + across]).for_each(|(to, v)| *to = f64::from(*v));
                }
            }
        }
        Ok(())
    }

    /// Whether the file holds no block of a window that lies in the raster.
    pub fn is_sparse(&self, (x, y): (u64, u64), (width, height): (usize, usize)) -> bool {
        let (bw, bh) = (self.layout.block_width, self.layout.block_height);
        let (columns, rows) = (x / bw..(x + width as u64).div_ceil(bw), y / bh..(y + height as u64).div_ceil(bh));
        let across = self.layout.blocks_across();
        rows.flat_map(|row| columns.clone().map(move |column| row * across + column))
            .all(|block| self.layout.extent(block).1 == 0)
    }

    fn decode(&self, block: u64) -> Result<Decoded> {
        let layout = &self.layout;
        let (offset, length) = layout.extent(block);
        if length == 0 {
            return Ok(Decoded(Arc::default()));
        }
        let broken = |what: String| Error::format(&self.path, layout.block_name(block), what);
        let rows = layout.block_rows(block / layout.blocks_across());
        let row_bytes = layout.block_row_bytes() as usize;
        let bytes = row_bytes * rows as usize;
        // No codec here makes data much larger.
        if length > 2 * bytes as u64 + (1 << 20) {
            return Err(broken(format!("{length} bytes in the file for {bytes} decoded ones")));
        }
        SCRATCH.with_borrow_mut(|scratch| {
            scratch.stored.resize(length as usize, 0);
            scratch.bytes.resize(bytes, 0);
            self.file
                .read_exact_at(&mut scratch.stored, offset)
                .map_err(|e| Error::io(&self.path, format!("read {length} bytes at {offset}"), e))?;
            decompress::decompress(layout, &scratch.stored, rows, &mut scratch.bytes).map_err(broken)?;
            let mut values = vec![0f32; bytes / 4];
            let lines = values.chunks_exact_mut(row_bytes / 4).zip(scratch.bytes.chunks_exact_mut(row_bytes));
            for (values, bytes) in lines {
                match layout.predictor {
                    Predictor::FloatingPoint => predictor::undo_floats(self.kernel, bytes, values),
                    other => predictor::numbers(bytes, values, self.order, other),
                }
            }
            Ok(Decoded(Arc::new(values)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gdal::raster::{Buffer, RasterCreationOptions};
    use gdal::{Dataset, DriverManager};

    const SIZE: (usize, usize) = (83, 61);

    fn written(path: &Path, options: &[&str]) -> Option<()> {
        let driver = DriverManager::get_driver_by_name("GTiff").ok()?;
        let options = RasterCreationOptions::from_iter(options.iter().copied());
        let made = driver.create_with_band_type_with_options::<f32, _>(path, SIZE.0, SIZE.1, 1, &options);
        let dataset = made.expect("every option is GDAL's");
        let mut band = dataset.rasterband(1).expect("one band");
        band.set_no_data_value(Some(-9999.0)).expect("a number");
        // The last block row stays empty.
        let values = (0..SIZE.0 * 48).map(|i| match i % 97 {
            0 => f32::NAN,
            1 => -0.0,
            2 => f32::NEG_INFINITY,
            _ => (i as f32 * 0.37).sin() * 1e3 + (i / SIZE.0) as f32,
        });
        let mut buffer = Buffer::new((SIZE.0, 48), values.collect::<Vec<f32>>());
        band.write((0, 0), (SIZE.0, 48), &mut buffer).expect("a disk");
        dataset.close().ok()
    }

    #[test]
    fn numbers_are_gdals_to_the_bit() {
        let folder = tempfile::tempdir().expect("a folder");
        let (mut tried, mut sparse) = (0, 0);
        for compress in ["NONE", "LZW", "DEFLATE", "ZSTD", "PACKBITS"] {
            for predictor in ["1", "2", "3"] {
                for layout in [["TILED=YES", "BLOCKXSIZE=32", "BLOCKYSIZE=16"], ["TILED=NO", "BLOCKYSIZE=16", ""]] {
                    for more in [["ENDIANNESS=LITTLE", "SPARSE_OK=TRUE"], ["ENDIANNESS=BIG", "BIGTIFF=YES"]] {
                        let (compress, predictor) = (format!("COMPRESS={compress}"), format!("PREDICTOR={predictor}"));
                        let mut options = vec![compress.as_str()];
                        if !["COMPRESS=NONE", "COMPRESS=PACKBITS"].contains(&options[0]) {
                            options.push(&predictor);
                        }
                        options.extend(layout.into_iter().chain(more).filter(|option| !option.is_empty()));
                        let path = folder.path().join(format!("{tried}.tif"));
                        written(&path, &options).expect("GDAL writes GeoTIFF");
                        let ours = FloatTiff::open(&path).unwrap_or_else(|| panic!("not taken: {options:?}"));
                        assert_eq!(ours.size(), (SIZE.0 as u64, SIZE.1 as u64));
                        let theirs = Dataset::open(&path).expect("GDAL's own file");
                        let band = theirs.rasterband(1).expect("one band");
                        for (at, size) in [((0, 0), SIZE), ((31, 15), (34, 18)), ((82, 60), (1, 1)), ((5, 40), (70, 9))]
                        {
                            let (mut a, mut b) = (vec![0.0f64; size.0 * size.1], vec![0.0f64; size.0 * size.1]);
                            ours.read((at.0 as u64, at.1 as u64), size, -9999.0, &mut a).expect("a whole file");
                            band.read_into_slice(at, size, size, &mut b, None).expect("a whole file");
                            let same = a.iter().zip(&b).all(|(a, b)| a.to_bits() == b.to_bits());
                            assert!(same, "{options:?} at {at:?}");
                            if ours.is_sparse((at.0 as u64, at.1 as u64), size) {
                                assert!(a.iter().all(|v| *v == -9999.0), "{options:?} at {at:?}");
                                sparse += 1;
                            }
                        }
                        tried += 1;
                    }
                }
            }
        }
        assert_eq!((tried, sparse), (5 * 3 * 2 * 2, 5 * 3 * 2));
    }

    #[test]
    fn what_is_not_taken_is_left_to_gdal_and_what_is_broken_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.tif");
        written(&path, &["TILED=YES", "BLOCKXSIZE=32", "BLOCKYSIZE=16", "COMPRESS=DEFLATE"]).expect("GDAL writes it");
        let tiff = FloatTiff::open(&path).expect("a plain model");
        let (offset, length) = tiff.layout.extent(4);
        let mut bytes = std::fs::read(&path).expect("a file");
        bytes[offset as usize..(offset + length) as usize].fill(0x55);
        std::fs::write(&path, bytes).expect("a disk");
        let tiff = FloatTiff::open(&path).expect("only a block is broken");
        let mut out = vec![0.0; 4];
        tiff.read((0, 0), (2, 2), 0.0, &mut out).expect("another block");
        let error = tiff.read((40, 20), (2, 2), 0.0, &mut out).expect_err("zeros are no Deflate").to_string();
        assert!(error.contains("a.tif") && error.contains("tile 4"), "{error}");
        std::fs::write(&path, b"II*\0 nothing more").expect("a disk");
        assert!(FloatTiff::open(&path).is_none() && FloatTiff::open(folder.path()).is_none());
    }
}
