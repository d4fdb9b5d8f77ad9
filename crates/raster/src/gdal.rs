//! Everything that GDAL opens, as a [`super::RasterSource`].
//!
//! GDAL's datasets may move between threads but not be shared by them, so each read takes one from a pool, and a new
//! one is opened when the pool is empty. Formats that can only be read from the top down have one dataset behind a
//! lock.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, PoisonError};

use gdal::errors::CplErrType;
use gdal::raster::{ColorInterpretation, GdalDataType, GdalType, RasterBand};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, Metadata};

use super::cache::Chunk;
use super::chunked::{ChunkDecoder, ChunkedSource, Counters, group_blocks, retile_remedy};
use super::path_text::quoted;
use super::white::white_of;
use super::{BlockLayout, BufferPool, PieceData, RasterInfo, SampleType};
use crate::coords::GeoTransform;
use crate::error::{Error, Result};
use crate::jpeg_end;
use crate::window::{TileGrid, Window};

/// The GDAL reader.
pub type GdalSource = ChunkedSource<GdalDecoder>;

/// GDAL's messages go to the log instead of stderr from now on, and its failures are counted for [`crate::Written`].
pub fn hear_gdal() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        gdal::config::set_error_handler(|kind, number, message| {
            tracing::debug!(target: "gdal", ?kind, number, "{message}");
            // A projection that is not known is asked about and gone without.
            let of_projection =
                ["PROJ", "Cannot find coordinate operations"].iter().any(|word| message.starts_with(word));
            if matches!(kind, CplErrType::Failure | CplErrType::Fatal) && !of_projection {
                super::written::note_failure(message);
            }
        });
    });
}

/// Prepares GDAL once for the whole process: messages go to the log ([`hear_gdal`]), and GDAL's own block cache is
/// bounded by `cache_bytes`. Later calls change nothing.
pub fn initialise_gdal(cache_bytes: u64) {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        hear_gdal();
        // Below 100000 GDAL would read the number as megabytes. Blocks are cached by us: GDAL needs only what one read
        // of several bands meets again.
        let bytes = (cache_bytes / 4).clamp(4 << 20, 64 << 20);
        if std::env::var_os("GDAL_CACHEMAX").is_none() {
            gdal::config::set_config_option("GDAL_CACHEMAX", &bytes.to_string())
                .expect("neither key nor value holds a zero byte");
        }
    });
}

/// Options with which GDAL opens a file of points or polygons and leaves nothing beside it: of GML it writes a
/// description.
pub fn vector_options(path: &Path) -> Option<&'static [&'static str]> {
    let ends = |end: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(end));
    let (gml, xml) = (ends("gml"), ends("xml"));
    (gml || xml).then_some(&["WRITE_GFS=NO"])
}

/// What GDAL is asked to open: a path or one of its own names (`/vsicurl/…`, `GTIFF_DIR:2:a.tif`).
#[derive(Clone, Debug)]
pub(super) struct GdalName {
    /// For messages.
    pub path: PathBuf,
    pub name: PathBuf,
}

impl GdalName {
    /// Directory `page` of a file, counted from 0.
    pub fn new(path: &Path, page: usize) -> Self {
        let name = match page {
            0 => path.to_path_buf(),
            page => PathBuf::from(format!("GTIFF_DIR:{}:{}", page + 1, path.display())),
        };
        GdalName { path: path.to_path_buf(), name }
    }

    /// Opens it for reading.
    ///
    /// # Errors
    /// What GDAL says when no driver recognises the file or the driver cannot open it.
    pub fn open(&self) -> Result<Dataset> {
        let dataset = self.open_with(DatasetOptions::default())?;
        jpeg_end::check(&self.path)?;
        Ok(dataset)
    }

    /// What it says itself: the files beside it are not looked at. `open_options` are the driver's.
    ///
    /// # Errors
    /// As [`GdalName::open`].
    pub fn open_alone(&self, open_options: Option<&[&str]>) -> Result<Facts> {
        // With an empty list GDAL would look for neighbours itself.
        let own = self.path.file_name().unwrap_or_default().to_string_lossy();
        let neighbours = [own.as_ref()];
        let options = DatasetOptions { sibling_files: Some(&neighbours), open_options, ..Default::default() };
        Ok(Facts::of(&self.open_with(options)?))
    }

    /// What GDAL says of it, with the files beside it.
    ///
    /// # Errors
    /// As [`GdalName::open`].
    pub fn facts(&self) -> Result<Facts> {
        Ok(Facts::of(&self.open_with(DatasetOptions::default())?))
    }

    fn open_with(&self, options: DatasetOptions<'_>) -> Result<Dataset> {
        let flags = GdalOpenFlags::GDAL_OF_READONLY
            | GdalOpenFlags::GDAL_OF_RASTER
            | GdalOpenFlags::GDAL_OF_INTERNAL
            | GdalOpenFlags::GDAL_OF_VERBOSE_ERROR;
        Dataset::open_ex(&self.name, DatasetOptions { open_flags: flags, ..options }).map_err(|e| self.error(e))
    }

    fn error(&self, error: gdal::errors::GdalError) -> Error {
        use gdal::errors::GdalError;
        match error {
            GdalError::CplError { msg, .. } | GdalError::NullPointer { msg, .. } if !msg.is_empty() => {
                // GDAL often begins with the name that we print already.
                let name = self.path.display().to_string();
                let said = msg.strip_prefix(&format!("{name}: ")).or(msg.strip_prefix(&format!("{name}, ")));
                Error::gdal(&self.path, said.unwrap_or(&msg))
            }
            GdalError::NullPointer { .. } => Error::gdal(&self.path, "no driver recognises this file"),
            other => Error::gdal(&self.path, other),
        }
    }
}

/// What the pixels of a dataset mean.
#[derive(Clone, Debug)]
struct Meaning {
    /// Numbers (from 1) of the bands to read, in the order in which they are interleaved.
    bands: Vec<usize>,
    rgb: [usize; 3],
    alpha: Option<usize>,
    /// One band of indices into these colours (with alpha).
    palette: Option<Vec<[u8; 4]>>,
    /// The mask band becomes one more sample.
    mask: bool,
    nodata: Option<f64>,
}

impl Meaning {
    /// Samples of a pixel as handed out.
    fn samples(&self) -> usize {
        match &self.palette {
            Some(_) => 4,
            None => self.bands.len() + usize::from(self.mask),
        }
    }
}

/// The part of the GDAL reader that knows GDAL.
pub struct GdalDecoder {
    name: GdalName,
    info: RasterInfo,
    meaning: Meaning,
    grid: TileGrid,
    /// GDAL's blocks in one of our chunks, across and down.
    group: (u64, u64),
    block: (u64, u64),
    pool: BufferPool,
    idle: Mutex<Vec<Dataset>>,
}

/// Opens `path` with GDAL. `page` counts TIFF directories from 0.
///
/// # Errors
/// When GDAL cannot open it, or its samples are not 8- or 16-bit unsigned images, or one of its blocks is larger than
/// `cache_bytes`.
pub(super) fn open_gdal(path: &Path, page: usize, cache_bytes: u64) -> Result<GdalSource> {
    initialise_gdal(cache_bytes);
    open_name(GdalName::new(path, page), cache_bytes)
}

/// The same by GDAL's name for it.
///
/// # Errors
/// Those of [`open_gdal`].
pub(super) fn open_name(mut name: GdalName, cache_bytes: u64) -> Result<GdalSource> {
    let path = &name.path.clone();
    let mut dataset = name.open()?;
    if dataset.raster_count() == 0 {
        let Some(first) = dataset.metadata_item("SUBDATASET_1_NAME", "SUBDATASETS") else {
            return Err(Error::unsupported(path, "GDAL opens it, but it holds no raster", "give an image file"));
        };
        name.name = PathBuf::from(first);
        dataset = name.open()?;
    }
    let decoder = GdalDecoder::new(name, dataset, cache_bytes)?;
    Ok(ChunkedSource::new(decoder, cache_bytes))
}

/// Drivers that decode only forward.
const SEQUENTIAL_DRIVERS: [&str; 5] = ["JPEG", "PNG", "GIF", "BIGGIF", "WEBP"];

impl GdalDecoder {
    fn new(name: GdalName, dataset: Dataset, cache_bytes: u64) -> Result<Self> {
        let gdal = |e| name.error(e);
        let (width, height) = dataset.raster_size();
        let (width, height) = (width as u64, height as u64);
        let first = dataset.rasterband(1).map_err(gdal)?;
        let sample = sample_type(&name.path, &dataset)?;
        let meaning = meaning(&name.path, &dataset)?;
        let driver = dataset.driver().short_name();
        let compression = dataset.metadata_item("COMPRESSION", "IMAGE_STRUCTURE");
        if compression.as_deref() == Some("OJPEG") {
            // Measured: what libtiff gives for such a file depends on the order in which its strips are read.
            let remedy = format!("convert it: gdal_translate {} converted.tif", quoted(&name.path));
            return Err(Error::unsupported(&name.path, "old-style JPEG in TIFF (compression 6)", remedy));
        }
        let (bw, bh) = first.block_size();
        let block = ((bw as u64).clamp(1, width), (bh as u64).clamp(1, height));
        let pixel_bytes = (meaning.samples() * sample.bytes()) as u64;
        // A block is decoded whole, also where the image is smaller.
        let block_bytes = (bw as u64).saturating_mul(bh as u64).saturating_mul(pixel_bytes);
        if block_bytes > cache_bytes {
            return Err(Error::Limit {
                what: format!("{}: one block of {bw} x {bh} pixels", name.path.display()),
                needed: block_bytes,
                allowed: cache_bytes,
                remedy: retile_remedy(&name.path),
            });
        }
        let strips = block.0 == width;
        let group = group_blocks(block, (width, height), pixel_bytes);
        let grid = TileGrid::new(width, height, block.0 * group.0, block.1 * group.1, 0);
        let chunk_bytes = grid.tile_width() * grid.tile_height() * pixel_bytes;
        let facts = Facts::of(&dataset);
        let info = RasterInfo {
            path: name.path.clone(),
            width,
            height,
            bands: dataset.raster_count(),
            sample,
            rgb: meaning.rgb,
            alpha: meaning.alpha,
            nodata: meaning.nodata,
            white: white(&dataset, &first, sample),
            layout: match strips {
                true => BlockLayout::Strips { rows: block.1 },
                false => BlockLayout::Tiles { width: block.0, height: block.1 },
            },
            blocks: width.div_ceil(block.0) * height.div_ceil(block.1),
            chunk_bytes,
            sequential: SEQUENTIAL_DRIVERS.contains(&driver.as_str()),
            reader: "gdal",
            description: match compression {
                Some(compression) => format!("{driver}, {compression}"),
                None => driver,
            },
            geotransform: facts.geotransform,
            crs_wkt: facts.crs_wkt,
            resolution_m_per_px: facts.resolution_m_per_px,
        };
        let pool = BufferPool::for_chunks(chunk_bytes);
        Ok(GdalDecoder { name, info, meaning, grid, group, block, pool, idle: Mutex::new(vec![dataset]) })
    }

    /// Runs `job` with a dataset that no other thread has.
    fn with_dataset<R>(&self, job: impl FnOnce(&Dataset) -> Result<R>) -> Result<R> {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        if self.info.sequential {
            // The lock is kept: a second dataset would decode everything again from the top.
            let dataset = match idle.pop() {
                Some(dataset) => dataset,
                None => self.name.open()?,
            };
            let result = job(&dataset);
            idle.push(dataset);
            return result;
        }
        let dataset = idle.pop();
        drop(idle);
        let dataset = match dataset {
            Some(dataset) => dataset,
            None => self.name.open()?,
        };
        let result = job(&dataset);
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).push(dataset);
        result
    }

    fn read_band<T: Copy + Default + GdalType>(
        &self,
        band: &RasterBand,
        window: Window,
        plane: &mut [T],
        place: &str,
    ) -> Result<()> {
        let size = (window.width as usize, window.height as usize);
        let at_pixel = (window.x as isize, window.y as isize);
        let (read, failure) =
            super::written::failure_during(|| band.read_into_slice(at_pixel, size, size, plane, None));
        read.map_err(|e| match self.name.error(e) {
            Error::Gdal { path, what } => Error::gdal(path, format!("{place}, {}: {what}", at(window))),
            other => other,
        })?;
        match failure {
            Some(what) => Err(Error::gdal(&self.name.path, format!("{place}, {}: {what}", at(window)))),
            None => Ok(()),
        }
    }

    /// All samples of `window`, interleaved into `out`, which has `samples` of them a pixel.
    fn read_samples<T>(&self, dataset: &Dataset, window: Window, out: &mut [T], opaque: T) -> Result<()>
    where
        T: Copy + Default + GdalType + PartialEq,
    {
        let samples = self.meaning.samples();
        let gdal = |e| self.name.error(e);
        if samples == 1 {
            let band = dataset.rasterband(self.meaning.bands[0]).map_err(gdal)?;
            return self.read_band(&band, window, out, "band 1");
        }
        let mut plane = vec![T::default(); window.area() as usize];
        for (index, &number) in self.meaning.bands.iter().enumerate() {
            let band = dataset.rasterband(number).map_err(gdal)?;
            self.read_band(&band, window, &mut plane, &format!("band {number}"))?;
            for (pixel, &value) in out.chunks_exact_mut(samples).zip(&plane) {
                pixel[index] = value;
            }
        }
        if self.meaning.mask {
            let mut mask = vec![0u8; window.area() as usize];
            let band = dataset.rasterband(1).map_err(gdal)?;
            let band = band.open_mask_band().map_err(gdal)?;
            self.read_band(&band, window, &mut mask, "mask")?;
            for (pixel, &value) in out.chunks_exact_mut(samples).zip(&mask) {
                pixel[samples - 1] = if value == 0 { T::default() } else { opaque };
            }
        }
        Ok(())
    }

    fn read_palette(&self, dataset: &Dataset, window: Window, palette: &[[u8; 4]], out: &mut [u8]) -> Result<()> {
        let mut indices = vec![0u16; window.area() as usize];
        let band = dataset.rasterband(1).map_err(|e| self.name.error(e))?;
        self.read_band(&band, window, &mut indices, "band 1")?;
        for (pixel, &index) in out.chunks_exact_mut(4).zip(&indices) {
            // Indices beyond the table are black and hold nothing.
            pixel.copy_from_slice(palette.get(usize::from(index)).unwrap_or(&[0; 4]));
        }
        Ok(())
    }
}

fn at(window: Window) -> String {
    format!("rows {}..{}, columns {}..{}", window.y, window.bottom(), window.x, window.right())
}

impl ChunkDecoder for GdalDecoder {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn grid(&self) -> &TileGrid {
        &self.grid
    }

    fn decode(&self, id: u64, counters: &Counters) -> Result<Chunk> {
        let window = self.grid.tile(id).core;
        let samples = self.meaning.samples();
        let count = window.area() as usize * samples;
        let data = self.with_dataset(|dataset| match (&self.meaning.palette, self.info.sample) {
            (Some(palette), _) => {
                let mut out = self.pool.take(count);
                self.read_palette(dataset, window, palette, &mut out)?;
                Ok(PieceData::U8(self.pool.share(out)))
            }
            (None, SampleType::U8) => {
                let mut out = self.pool.take(count);
                self.read_samples(dataset, window, &mut out, u8::MAX)?;
                Ok(PieceData::U8(self.pool.share(out)))
            }
            (None, SampleType::U16) => {
                let mut out = vec![0u16; count];
                self.read_samples(dataset, window, &mut out, u16::MAX)?;
                Ok(PieceData::U16(out.into()))
            }
        })?;
        let blocks = window.width.div_ceil(self.block.0) * window.height.div_ceil(self.block.1);
        debug_assert!(blocks <= self.group.0 * self.group.1);
        let bytes = (count * self.info.sample.bytes()) as u64;
        // GDAL does not say how many bytes of the file it took.
        counters.add(blocks, 0, 0);
        let row_stride = window.width as usize * samples;
        Ok(Chunk { data: Some(data), offset: 0, row_stride, pixel_stride: samples, bytes })
    }
}

fn sample_type(path: &Path, dataset: &Dataset) -> Result<SampleType> {
    let mut sample = SampleType::U8;
    for number in 1..=dataset.raster_count() {
        let band = dataset.rasterband(number).map_err(|e| Error::gdal(path, e))?;
        match band.band_type() {
            GdalDataType::UInt8 => {}
            GdalDataType::UInt16 => sample = SampleType::U16,
            other => {
                let what = format!("samples of type {} (band {number}) as an image", other.name());
                let remedy = format!("convert it: gdal_translate -ot Byte -scale {} converted.tif", quoted(path));
                return Err(Error::unsupported(path, what, remedy));
            }
        }
        if band.metadata_item("PIXELTYPE", "IMAGE_STRUCTURE").as_deref() == Some("SIGNEDBYTE") {
            let remedy = format!("convert it: gdal_translate -ot Byte -scale {} converted.tif", quoted(path));
            return Err(Error::unsupported(path, "samples of type Int8 as an image", remedy));
        }
    }
    Ok(sample)
}

fn meaning(path: &Path, dataset: &Dataset) -> Result<Meaning> {
    use ColorInterpretation as Colour;
    let gdal = |e| Error::gdal(path, e);
    let count = dataset.raster_count();
    let mut colours = Vec::with_capacity(count);
    for number in 1..=count {
        colours.push(dataset.rasterband(number).map_err(gdal)?.color_interpretation());
    }
    let find = |colour: Colour| colours.iter().position(|c| *c == colour);
    for (colour, name) in [(Colour::CyanBand, "CMYK"), (Colour::HueBand, "HLS"), (Colour::YCbCrSpaceYBand, "YCbCr")] {
        if find(colour).is_some() {
            let remedy = "convert it to RGB first (ImageMagick: convert in.tif -colorspace sRGB out.tif)";
            return Err(Error::unsupported(path, format!("{name} bands"), remedy));
        }
    }
    let first = dataset.rasterband(1).map_err(gdal)?;
    let flags = first.mask_flags().map_err(gdal)?;
    let nodata = first.no_data_value();
    if let (Colour::PaletteIndex, Some(table)) = (&colours[0], first.color_table()) {
        let mut palette = Vec::with_capacity(table.entry_count());
        for index in 0..table.entry_count() {
            let entry = table.entry_as_rgb(index);
            let mut colour = entry.map_or([0; 4], |e| [e.r, e.g, e.b, e.a].map(|v| v.clamp(0, 255) as u8));
            if nodata == Some(index as f64) {
                colour[3] = 0;
            }
            palette.push(colour);
        }
        let rgb = [0, 1, 2];
        return Ok(Meaning { bands: vec![1], rgb, alpha: Some(3), palette: Some(palette), mask: false, nodata: None });
    }
    let alpha = find(Colour::AlphaBand);
    let coloured = match (find(Colour::RedBand), find(Colour::GreenBand), find(Colour::BlueBand)) {
        (Some(red), Some(green), Some(blue)) => vec![red, green, blue],
        _ if count - usize::from(alpha.is_some()) >= 3 => (0..count).filter(|&b| Some(b) != alpha).take(3).collect(),
        _ => vec![(0..count).find(|&b| Some(b) != alpha).unwrap_or(0)],
    };
    let rgb = if coloured.len() == 3 { [0, 1, 2] } else { [0; 3] };
    let mask = alpha.is_none() && flags.is_per_dataset() && !flags.is_all_valid() && !flags.is_nodata();
    let next = coloured.len();
    let bands = coloured.iter().chain(&alpha).map(|b| b + 1).collect();
    let alpha = (alpha.is_some() || mask).then_some(next);
    Ok(Meaning { bands, rgb, alpha, palette: None, mask, nodata })
}

/// The value of full white: see [`white_of`].
fn white(dataset: &Dataset, band: &RasterBand, sample: SampleType) -> u16 {
    let bits = band.metadata_item("NBITS", "IMAGE_STRUCTURE").and_then(|v| v.parse().ok());
    let maximum = dataset.metadata_item("TIFFTAG_MAXSAMPLEVALUE", "").and_then(|v| v.parse().ok());
    if matches!(band.color_interpretation(), ColorInterpretation::PaletteIndex) {
        return 255;
    }
    white_of(sample, bits, maximum)
}

/// What GDAL knows about a file beside its pixels, side files (`.aux.xml`, world files) included.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Facts {
    pub geotransform: Option<GeoTransform>,
    pub crs_wkt: Option<String>,
    pub resolution_m_per_px: Option<f64>,
    pub nodata: Option<f64>,
}

impl Facts {
    /// Of a directory of a file; one that GDAL cannot open has none.
    pub fn of_file(path: &Path, directory: usize) -> Self {
        initialise_gdal(0);
        match GdalName::new(path, directory).open() {
            Ok(dataset) => Facts::of(&dataset),
            Err(error) => {
                tracing::debug!("no georeference from GDAL: {error}");
                Facts::default()
            }
        }
    }

    /// What GDAL says of a dataset.
    pub fn of(dataset: &Dataset) -> Self {
        // GDAL answers with an error when there is none.
        let geotransform = dataset.geo_transform().ok().map(GeoTransform);
        let crs_wkt = Some(dataset.projection()).filter(|wkt| !wkt.is_empty());
        let number = |key: &str| dataset.metadata_item(key, "")?.split_whitespace().next()?.parse::<f64>().ok();
        let unit = match number("TIFFTAG_RESOLUTIONUNIT") {
            Some(2.0) => Some(0.0254),
            Some(3.0) => Some(0.01),
            _ => None,
        };
        let per_unit = number("TIFFTAG_XRESOLUTION").filter(|&r| r > 0.0 && number("TIFFTAG_YRESOLUTION") == Some(r));
        // Scanners and cameras write dots per inch of paper or screen: only values that can be ground count.
        let resolution_m_per_px = unit.zip(per_unit).map(|(u, r)| u / r).filter(|gsd| (0.001..100.0).contains(gsd));
        let nodata = dataset.rasterband(1).ok().and_then(|band| band.no_data_value());
        Facts { geotransform, crs_wkt, resolution_m_per_px, nodata }
    }
}
