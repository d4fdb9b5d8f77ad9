//! Every raster that the native reader does not take, through GDAL.
//!
//! A dataset handle serves one thread at a time, so each concurrent read borrows one from a pool. GDAL's own block cache
//! is bounded by what the plan allows and does the work of the native reader's cache. Palettes are expanded to colours;
//! a mask beside the bands is presented as an alpha sample.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, Once};

use gdal::raster::{ColorInterpretation, GdalDataType, GdalType};
use gdal::{Dataset, Metadata};

use crate::coords::GeoTransform;
use crate::error::{Error, Result};
use crate::raster::{
    Block, BlockLayout, Piece, PieceData, PooledBytes, RasterInfo, RasterSource, ReadStats, SampleType,
};
use crate::window::Window;

/// Formats that GDAL decodes from the top down only: going back means starting again.
const FORWARD_ONLY: [&str; 5] = ["JPEG", "PNG", "GIF", "WEBP", "BIGGIF"];

/// Quiets GDAL's own printing: what it says goes to the log, and what matters comes back as errors.
pub fn init() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        gdal::config::set_error_handler(|class, code, message| {
            tracing::debug!(target: "gdal", ?class, code, "{message}");
        });
        // One reader thread is one thread: our workers are the parallelism.
        let _ = gdal::config::set_config_option("GDAL_NUM_THREADS", "1");
    });
}

/// Where the samples we hand out come from.
#[derive(Clone, Debug)]
enum Channels {
    /// 1-based band numbers.
    Bands(Vec<usize>),
    /// The palette of band 1.
    Palette(Arc<Vec<[u8; 4]>>),
}

/// A raster opened with GDAL.
pub struct GdalSource {
    info: RasterInfo,
    channels: Channels,
    /// The dataset's mask becomes one more sample.
    mask: bool,
    idle: Mutex<Vec<Dataset>>,
    bytes_read: AtomicU64,
    blocks_decoded: AtomicU64,
}

impl GdalSource {
    /// Opens `path`, which may be one of GDAL's virtual names (`/vsicurl/…`, a subdataset).
    ///
    /// # Errors
    /// When GDAL cannot open it, or its samples are no 8- or 16-bit unsigned numbers.
    pub fn open(path: &Path, page: usize, cache_bytes: u64) -> Result<Self> {
        init();
        let _ = gdal::config::set_config_option("GDAL_CACHEMAX", &format!("{}", (cache_bytes >> 20).max(4)));
        let name = paged_name(path, page);
        let dataset = Dataset::open(&name).map_err(|e| Error::gdal(path, e))?;
        let (info, channels, mask) = describe(path, &dataset)?;
        Ok(GdalSource {
            info,
            channels,
            mask,
            idle: Mutex::new(vec![dataset]),
            bytes_read: AtomicU64::new(0),
            blocks_decoded: AtomicU64::new(0),
        })
    }

    fn borrow_dataset(&self) -> Result<Dataset> {
        let idle = self.idle.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop();
        match idle {
            Some(dataset) => Ok(dataset),
            None => Dataset::open(&self.info.path).map_err(|e| Error::gdal(&self.info.path, e)),
        }
    }

    fn samples_per_pixel(&self) -> usize {
        let colours = match &self.channels {
            Channels::Bands(bands) => bands.len(),
            Channels::Palette(_) => 4,
        };
        colours + usize::from(self.mask)
    }

    /// Band by band into an interleaved buffer.
    fn read_interleaved<T: Copy + Default + GdalType + From<u8>>(
        &self,
        window: Window,
        out: &mut Vec<T>,
    ) -> Result<()> {
        let dataset = self.borrow_dataset()?;
        let stride = self.samples_per_pixel();
        let pixels = window.area() as usize;
        out.clear();
        out.resize(pixels * stride, T::default());
        let mut plane = vec![T::default(); pixels];
        let result = (|| -> gdal::errors::Result<()> {
            let mut position = 0;
            match &self.channels {
                Channels::Bands(bands) => {
                    for &band in bands {
                        read_plane(&dataset.rasterband(band)?, window, &mut plane)?;
                        spread(&plane, out, position, stride);
                        position += 1;
                    }
                }
                Channels::Palette(palette) => {
                    let mut indices = vec![0u8; pixels];
                    read_plane(&dataset.rasterband(1)?, window, &mut indices)?;
                    for (pixel, &index) in out.chunks_exact_mut(stride).zip(&indices) {
                        let colour = palette.get(usize::from(index)).copied().unwrap_or([0; 4]);
                        pixel.iter_mut().zip(colour).for_each(|(to, from)| *to = T::from(from));
                    }
                    position = 4;
                }
            }
            if self.mask {
                read_plane(&dataset.rasterband(1)?.open_mask_band()?, window, &mut plane)?;
                spread(&plane, out, position, stride);
            }
            Ok(())
        })();
        result.map_err(|e| {
            let place = format!("window {}×{} at {}, {}", window.width, window.height, window.x, window.y);
            Error::gdal(&self.info.path, format!("{place}: {e}"))
        })?;
        self.idle.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(dataset);
        Ok(())
    }
}

fn read_plane<T: Copy + GdalType>(
    band: &gdal::raster::RasterBand<'_>,
    window: Window,
    plane: &mut [T],
) -> gdal::errors::Result<()> {
    let size = (window.width as usize, window.height as usize);
    band.read_into_slice((window.x as isize, window.y as isize), size, size, plane, None)
}

fn spread<T: Copy>(plane: &[T], out: &mut [T], position: usize, stride: usize) {
    for (pixel, &value) in out.chunks_exact_mut(stride).zip(plane) {
        pixel[position] = value;
    }
}

impl RasterSource for GdalSource {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        debug_assert!(self.info.bounds().contains_window(&window));
        let stride = self.samples_per_pixel();
        let data = match self.info.sample {
            SampleType::U8 => {
                let mut bytes = Vec::new();
                self.read_interleaved(window, &mut bytes)?;
                PieceData::U8(Arc::new(PooledBytes { bytes, home: None }))
            }
            SampleType::U16 => {
                let mut samples = Vec::new();
                self.read_interleaved(window, &mut samples)?;
                PieceData::U16(Arc::new(samples))
            }
        };
        let bytes = window.area() * (stride * self.info.sample.bytes()) as u64;
        self.bytes_read.fetch_add(bytes, Ordering::Relaxed);
        self.blocks_decoded.fetch_add(blocks_met(&self.info, window), Ordering::Relaxed);
        let piece = Piece {
            window,
            data,
            offset: 0,
            row_stride: window.width as usize * stride,
            pixel_stride: stride,
            empty: false,
        };
        Ok(Block { window, pieces: vec![piece] })
    }

    fn stats(&self) -> ReadStats {
        ReadStats {
            blocks_decoded: self.blocks_decoded.load(Ordering::Relaxed),
            blocks_skipped: 0,
            bytes_read: self.bytes_read.load(Ordering::Relaxed),
        }
    }
}

/// Blocks that a window meets: what GDAL would decode if its cache held nothing.
fn blocks_met(info: &RasterInfo, window: Window) -> u64 {
    let (width, height) = match info.layout {
        BlockLayout::Tiles { width, height } => (width, height),
        BlockLayout::Strips { rows } => (info.width, rows),
    };
    let along = |start: u64, end: u64, size: u64| end.div_ceil(size.max(1)) - start / size.max(1);
    along(window.x, window.right(), width) * along(window.y, window.bottom(), height)
}

fn paged_name(path: &Path, page: usize) -> PathBuf {
    if page == 0 { path.to_path_buf() } else { PathBuf::from(format!("GTIFF_DIR:{}:{}", page + 1, path.display())) }
}

fn describe(path: &Path, dataset: &Dataset) -> Result<(RasterInfo, Channels, bool)> {
    let gdal_error = |e| Error::gdal(path, e);
    let (width, height) = dataset.raster_size();
    let count = dataset.raster_count();
    if count == 0 || width == 0 || height == 0 {
        return Err(Error::unsupported(
            path,
            "GDAL finds no raster bands in it (a container or a vector file)",
            "name one of its subdatasets (gdalinfo lists them)",
        ));
    }
    let first = dataset.rasterband(1).map_err(gdal_error)?;
    let sample = sample_type(path, first.band_type())?;
    let palette = first.color_table().filter(|_| count == 1 && sample == SampleType::U8).map(|table| {
        (0..table.entry_count())
            .map(|i| table.entry_as_rgb(i).map_or([0; 4], |e| [e.r as u8, e.g as u8, e.b as u8, e.a as u8]))
            .collect::<Vec<_>>()
    });
    let (channels, rgb, mut alpha) = match palette {
        Some(palette) => (Channels::Palette(Arc::new(palette)), [0, 1, 2], Some(3)),
        None => choose_bands(path, dataset, count)?,
    };
    let mask_flags = first.mask_flags().map_err(gdal_error)?;
    let mask = alpha.is_none() && mask_flags.is_per_dataset() && !mask_flags.is_alpha() && !mask_flags.is_all_valid();
    let colours = match &channels {
        Channels::Bands(bands) => bands.len(),
        Channels::Palette(_) => 4,
    };
    if mask {
        alpha = Some(colours);
    }
    let (block_width, block_height) = first.block_size();
    let layout = if block_width >= width {
        BlockLayout::Strips { rows: block_height.max(1) as u64 }
    } else {
        BlockLayout::Tiles { width: block_width as u64, height: block_height as u64 }
    };
    let bits = first.metadata_item("NBITS", "IMAGE_STRUCTURE").and_then(|text| text.parse::<u32>().ok());
    let driver = dataset.driver().short_name();
    let compression = dataset.metadata_item("COMPRESSION", "IMAGE_STRUCTURE");
    let samples = colours + usize::from(mask);
    let info = RasterInfo {
        path: path.to_path_buf(),
        width: width as u64,
        height: height as u64,
        bands: samples,
        sample,
        rgb,
        alpha,
        nodata: first.no_data_value(),
        white: white_level(sample, bits),
        layout,
        blocks: (width.div_ceil(block_width.max(1)) * height.div_ceil(block_height.max(1))) as u64,
        chunk_bytes: (block_width * block_height * samples * sample.bytes()) as u64,
        sequential: FORWARD_ONLY.contains(&driver.as_str()),
        reader: "gdal",
        description: format!("{driver}{}", compression.map_or(String::new(), |c| format!(", {c}"))),
        geotransform: dataset.geo_transform().ok().map(GeoTransform).filter(|t| t.scale() > 0.0),
        crs_wkt: Some(dataset.projection()).filter(|wkt| !wkt.is_empty()),
        resolution_m_per_px: None,
    };
    Ok((info, channels, mask))
}

fn white_level(sample: SampleType, bits: Option<u32>) -> u16 {
    match (sample, bits) {
        (SampleType::U8, _) => 255,
        (SampleType::U16, Some(bits @ 9..=15)) => (1 << bits) - 1,
        (SampleType::U16, _) => u16::MAX,
    }
}

fn sample_type(path: &Path, data_type: GdalDataType) -> Result<SampleType> {
    match data_type {
        GdalDataType::UInt8 => Ok(SampleType::U8),
        GdalDataType::UInt16 => Ok(SampleType::U16),
        other => Err(Error::unsupported(
            path,
            format!("samples of type {other}; images are 8- or 16-bit unsigned"),
            format!("convert it: gdal_translate -ot Byte -scale {} image.tif", path.display()),
        )),
    }
}

/// Red, green, blue and alpha by their names; else the first three bands; else grey.
type Chosen = (Channels, [usize; 3], Option<usize>);

fn choose_bands(path: &Path, dataset: &Dataset, count: usize) -> Result<Chosen> {
    let mut named = [None; 4];
    let first_type = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?.band_type();
    for index in 1..=count {
        let band = dataset.rasterband(index).map_err(|e| Error::gdal(path, e))?;
        let slot = match band.color_interpretation() {
            ColorInterpretation::RedBand => 0,
            ColorInterpretation::GreenBand => 1,
            ColorInterpretation::BlueBand => 2,
            ColorInterpretation::AlphaBand => 3,
            _ => continue,
        };
        if band.band_type() == first_type {
            named[slot].get_or_insert(index);
        }
    }
    let (mut bands, rgb) = match named {
        [Some(r), Some(g), Some(b), _] => (vec![r, g, b], [0, 1, 2]),
        _ if count >= 3 && named[3].is_none_or(|alpha| alpha > 3) => (vec![1, 2, 3], [0, 1, 2]),
        _ => (vec![1], [0; 3]),
    };
    let alpha = named[3].map(|band| {
        bands.push(band);
        bands.len() - 1
    });
    Ok((Channels::Bands(bands), rgb, alpha))
}
