//! A north-up copy: a Cloud Optimized GeoTIFF by GDAL's warper.
//!
//! For programs that refuse rotated GeoTIFFs or draw them unrotated. The copy is warped block by block while GDAL's COG
//! driver asks for it, so memory does not grow with the image; overviews are part of a COG.

mod border;
mod create_copy;
mod grid;
mod vrt;

pub use border::Border;
pub use grid::Grid;

use autoref_raster::failed_to_write;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

use gdal::cpl::CslStringList;
use gdal::raster::GdalDataType;
use gdal::{Dataset, DriverManager, Metadata};

use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::memory_plan;
use autoref_raster::tiff::Directories;

/// How a pixel is made of its neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Resampling {
    Near,
    #[default]
    Bilinear,
    Cubic,
    CubicSpline,
    Lanczos,
    Average,
    Mode,
}

impl Resampling {
    pub const ALL: [Resampling; 7] = [
        Resampling::Near,
        Resampling::Bilinear,
        Resampling::Cubic,
        Resampling::CubicSpline,
        Resampling::Lanczos,
        Resampling::Average,
        Resampling::Mode,
    ];

    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Resampling::Near => "near",
            Resampling::Bilinear => "bilinear",
            Resampling::Cubic => "cubic",
            Resampling::CubicSpline => "cubicspline",
            Resampling::Lanczos => "lanczos",
            Resampling::Average => "average",
            Resampling::Mode => "mode",
        }
    }

    /// As a warped VRT names it.
    fn in_vrt(self) -> &'static str {
        match self {
            Resampling::Near => "NearestNeighbour",
            Resampling::Bilinear => "Bilinear",
            Resampling::Cubic => "Cubic",
            Resampling::CubicSpline => "CubicSpline",
            Resampling::Lanczos => "Lanczos",
            Resampling::Average => "Average",
            Resampling::Mode => "Mode",
        }
    }

    /// For the overviews: values that must not be mixed are not.
    fn of_overviews(self) -> &'static str {
        match self {
            Resampling::Near => "NEAREST",
            Resampling::Mode => "MODE",
            _ => "AVERAGE",
        }
    }
}

/// How the copy is compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    None,
    Lzw,
    #[default]
    Deflate,
    Zstd,
    Jpeg,
    Webp,
}

impl Compression {
    pub const ALL: [Compression; 6] = [
        Compression::None,
        Compression::Lzw,
        Compression::Deflate,
        Compression::Zstd,
        Compression::Jpeg,
        Compression::Webp,
    ];

    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            Compression::None => "none",
            Compression::Lzw => "lzw",
            Compression::Deflate => "deflate",
            Compression::Zstd => "zstd",
            Compression::Jpeg => "jpeg",
            Compression::Webp => "webp",
        }
    }

    fn lossy(self) -> bool {
        matches!(self, Compression::Jpeg | Compression::Webp)
    }
}

macro_rules! named {
    ($kind:ty, $what:literal) => {
        impl fmt::Display for $kind {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(self.name())
            }
        }

        impl FromStr for $kind {
            type Err = String;
            fn from_str(text: &str) -> std::result::Result<Self, String> {
                <$kind>::ALL.into_iter().find(|one| one.name() == text).ok_or_else(|| {
                    let names = <$kind>::ALL.map(<$kind>::name).join(", ");
                    format!("`{text}` is no {}; choose from {names}", $what)
                })
            }
        }
    };
}

named!(Resampling, "resampling");
named!(Compression, "compression");

/// What `--write warp` makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WarpOptions {
    pub resampling: Resampling,
    pub compression: Compression,
    /// 1 to 100, of JPEG and WebP; GDAL's 75 when `None`.
    pub quality: Option<u8>,
    /// Side of a pixel in map units; that of the image when `None`.
    pub resolution: Option<f64>,
    pub border: Border,
    pub memory_budget_bytes: u64,
    pub threads: usize,
}

impl Default for WarpOptions {
    fn default() -> Self {
        WarpOptions {
            resampling: Resampling::default(),
            compression: Compression::default(),
            quality: None,
            resolution: None,
            border: Border::default(),
            memory_budget_bytes: memory_plan::DEFAULT_BUDGET_BYTES,
            threads: 1,
        }
    }
}

/// What one thread takes beside the block cache, measured: the warper's own buffers, blocks on their way to the file.
const FIXED_BYTES: u64 = 72 << 20;
/// What each further thread of the compressor takes, measured (18 MiB) and rounded up.
const THREAD_BYTES: u64 = 24 << 20;
/// The least with which GDAL makes headway.
const SMALLEST_CACHE_BYTES: u64 = 12 << 20;
/// For one step of the warper.
const WARP_BYTES: u64 = 16 << 20;

impl WarpOptions {
    /// Refuses, before any work, what GDAL cannot do with this image.
    ///
    /// # Errors
    /// [`Error::Unsupported`] for a compression that GDAL lacks or that cannot hold such samples, and for palettes;
    /// [`Error::Usage`] for numbers out of range; [`Error::Limit`] when the memory does not suffice.
    pub fn check(&self, image: &Path, page: usize) -> Result<()> {
        if self.resolution.is_some_and(|r| !(r > 0.0 && r.is_finite())) {
            return Err(Error::usage("--resolution is not a positive length", "give the side of a pixel in map units"));
        }
        if self.quality.is_some_and(|q| !(1..=100).contains(&q)) {
            return Err(Error::usage("--quality is not between 1 and 100", "75 is a good value"));
        }
        self.means()?;
        let (_dataset, source) = open(image, page)?;
        self.border_of(&source)?;
        self.check_compression(image, &source)
    }

    fn check_compression(&self, image: &Path, source: &vrt::Source) -> Result<()> {
        let driver = DriverManager::get_driver_by_name("COG").map_err(|e| Error::gdal(image, e))?;
        let offered = driver.metadata_item("DMD_CREATIONOPTIONLIST", "").unwrap_or_default();
        let name = self.compression.name().to_uppercase();
        if !offered.contains(&format!("<Value>{name}</Value>")) {
            let what = format!("{name} compression by this GDAL, which was built without it");
            return Err(Error::unsupported(image, what, "choose another --compress, such as deflate"));
        }
        let kinds: Vec<GdalDataType> = source.colours().map(|(_, band)| band.kind).collect();
        if self.compression.lossy() && kinds.iter().any(|kind| *kind != GdalDataType::UInt8) {
            let what = format!("{name} compression of {} samples", kinds[0].name());
            return Err(Error::unsupported(image, what, "choose deflate, zstd or lzw"));
        }
        let fits = match self.compression {
            Compression::Jpeg => matches!(kinds.len(), 1 | 3),
            Compression::Webp => kinds.len() == 3,
            _ => true,
        };
        if !fits {
            let what = format!("{name} compression of {} bands", kinds.len());
            return Err(Error::unsupported(image, what, "choose deflate, zstd or lzw"));
        }
        Ok(())
    }

    /// What GDAL's block cache may take, and how many threads of those asked for fit beside it.
    ///
    /// Two thirds of what is left are cache: GDAL exceeds it while blocks wait to be written.
    fn means(&self) -> Result<(u64, usize)> {
        let fixed = memory_plan::baseline_bytes() + FIXED_BYTES;
        let left = self.memory_budget_bytes.saturating_sub(fixed);
        let least = SMALLEST_CACHE_BYTES * 3 / 2;
        if left < least {
            return Err(Error::Limit {
                what: "warping does not fit --memory".into(),
                needed: fixed + least,
                allowed: self.memory_budget_bytes,
                remedy: format!("give --memory {}M", (fixed + least).div_ceil(1 << 20)),
            });
        }
        let more = ((left - least) / THREAD_BYTES).min(self.threads.saturating_sub(1) as u64);
        Ok(((left - more * THREAD_BYTES) * 2 / 3, 1 + more as usize))
    }

    /// What the border is in this image.
    fn border_of(&self, source: &vrt::Source) -> Result<Border> {
        let first = source.colours().next().map(|(_, band)| band);
        let border = match (self.border, first) {
            (Border::Auto, Some(band)) => match band.nodata {
                _ if source.alpha.is_some() => Border::Alpha,
                Some(value) if !self.compression.lossy() => Border::Nodata(value),
                None if band.kind.is_signed() && holds(band.kind, Border::ELEVATION_NODATA) => {
                    Border::Nodata(Border::ELEVATION_NODATA)
                }
                _ => Border::Alpha,
            },
            (asked, _) => asked,
        };
        if let (Border::Nodata(value), Some(band)) = (border, first) {
            let holds = holds(band.kind, value);
            if !holds {
                return Err(Error::usage(
                    format!("{value} as nodata does not fit {} samples", band.kind.name()),
                    "give --border alpha or another value",
                ));
            }
            if self.compression.lossy() {
                return Err(Error::usage(
                    format!("a nodata value does not survive {} compression", self.compression),
                    "give --border alpha, or --compress deflate",
                ));
            }
        }
        Ok(border)
    }
}

/// Warps image `page` of `image` into the file `out`, which is replaced when it exists.
///
/// `progress` gets numbers from 0 to 1 and answers whether to go on.
///
/// # Errors
/// Those of [`WarpOptions::check`] but for the memory; [`Error::Gdal`] when GDAL cannot read the image or write the
/// copy (a full disk). Nothing is left behind but what is at `out` itself.
pub fn write(
    image: &Path,
    page: usize,
    out: &Path,
    transform: &GeoTransform,
    crs: Option<&Crs>,
    options: &WarpOptions,
    progress: &dyn Fn(f64) -> bool,
) -> Result<()> {
    let (dataset, source) = open(image, page)?;
    options.check_compression(image, &source)?;
    let grid = Grid::around(transform, source.width, source.height, options.resolution)?;
    let border = options.border_of(&source)?;
    let xml = vrt::xml(&source, transform, &grid, crs, border, options.resampling.in_vrt(), WARP_BYTES)?;
    drop(dataset);
    // Checked before the scan; what the scan has freed since may still count as resident, and is used again.
    let (cache_bytes, threads) = options.means().unwrap_or((SMALLEST_CACHE_BYTES, 1));
    create_copy::set_cache_bytes(cache_bytes);
    let options = WarpOptions { threads, ..*options };
    let made = copy(&xml, image, out, &options, progress).and_then(|()| complete(out));
    remove_leftovers(out);
    made
}

/// First a plain tiled copy, then the COG of it: the COG driver reads every pixel several times, for overviews band by
/// band, and each time the image would be warped again.
fn copy(xml: &str, image: &Path, out: &Path, options: &WarpOptions, progress: &dyn Fn(f64) -> bool) -> Result<()> {
    let failed = |what: String| failed_to_write(out, &what);
    let mut plain = out.as_os_str().to_owned();
    plain.push(".warp.tmp");
    let plain = Path::new(&plain);
    let driver = |name| DriverManager::get_driver_by_name(name).map_err(|e| Error::gdal(out, e));
    let warped = Dataset::open(xml).map_err(|e| Error::gdal(image, e))?;
    let tiff = driver("GTiff")?;
    let creation = plain_options(&tiff, options).map_err(|e| Error::gdal(out, e))?;
    create_copy::create_copy(&warped, &tiff, plain, &creation, &|done| progress(done / 2.0)).map_err(failed)?;
    drop(warped);
    let north_up = Dataset::open(plain).map_err(|e| Error::gdal(out, e))?;
    let creation = creation_options(options).map_err(|e| Error::gdal(out, e))?;
    create_copy::create_copy(&north_up, &driver("COG")?, out, &creation, &|done| progress(0.5 + done / 2.0))
        .map_err(failed)
}

/// Of the copy in between: fast and without loss.
fn plain_options(driver: &gdal::Driver, options: &WarpOptions) -> gdal::errors::Result<CslStringList> {
    let offered = driver.metadata_item("DMD_CREATIONOPTIONLIST", "").unwrap_or_default();
    let zstd = offered.contains("<Value>ZSTD</Value>");
    let mut list = CslStringList::new();
    for (name, value) in [("TILED", "YES"), ("BLOCKXSIZE", "512"), ("BLOCKYSIZE", "512"), ("BIGTIFF", "IF_SAFER")] {
        list.add_name_value(name, value)?;
    }
    list.add_name_value("COMPRESS", if zstd { "ZSTD" } else { "LZW" })?;
    if zstd {
        list.add_name_value("ZSTD_LEVEL", "1")?;
    }
    list.add_name_value("NUM_THREADS", &options.threads.to_string())?;
    Ok(list)
}

fn creation_options(options: &WarpOptions) -> gdal::errors::Result<CslStringList> {
    let mut list = CslStringList::new();
    list.add_name_value("COMPRESS", &options.compression.name().to_uppercase())?;
    list.add_name_value("BIGTIFF", "IF_SAFER")?;
    list.add_name_value("OVERVIEW_RESAMPLING", options.resampling.of_overviews())?;
    list.add_name_value("NUM_THREADS", &options.threads.to_string())?;
    if matches!(options.compression, Compression::Lzw | Compression::Deflate | Compression::Zstd) {
        list.add_name_value("PREDICTOR", "YES")?;
    }
    if options.compression.lossy() {
        let quality = options.quality.unwrap_or(75).to_string();
        list.add_name_value("QUALITY", &quality)?;
        list.add_name_value("OVERVIEW_QUALITY", &quality)?;
    }
    Ok(list)
}

fn open(image: &Path, page: usize) -> Result<(Dataset, vrt::Source)> {
    let (name, dataset) = autoref_raster::open_dataset(image, page)?;
    let source = vrt::Source::of(image, &name, &dataset)?;
    Ok((dataset, source))
}

/// Every block of every directory must lie in the file: GDAL does not always notice a full disk.
fn complete(out: &Path) -> Result<()> {
    use autoref_raster::tiff::container::tag;
    let file = Directories::read(out)?;
    if let Some(what) = &file.broken_tail {
        return Err(Error::format(out, "the copy", what.clone()));
    }
    for index in 0..file.list.len() {
        let offsets = file.numbers(index, tag::TILE_OFFSETS)?.unwrap_or_default();
        let counts = file.numbers(index, tag::TILE_BYTE_COUNTS)?.unwrap_or_default();
        let inside = |(at, count): (&u64, &u64)| at.checked_add(*count).is_some_and(|end| end <= file.len);
        if offsets.is_empty() || offsets.len() != counts.len() || !offsets.iter().zip(&counts).all(inside) {
            return Err(Error::format(out, format!("directory {index}"), "the copy is cut off; is the disk full?"));
        }
    }
    Ok(())
}

/// GDAL's COG driver keeps overviews in files beside the output while it works, and leaves them when it fails.
fn remove_leftovers(out: &Path) {
    let (Some(folder), Some(name)) = (out.parent(), out.file_name()) else { return };
    let Ok(entries) = std::fs::read_dir(if folder.as_os_str().is_empty() { Path::new(".") } else { folder }) else {
        return;
    };
    let name = name.to_string_lossy();
    for entry in entries.flatten() {
        let other = entry.file_name().to_string_lossy().into_owned();
        if other.strip_prefix(name.as_ref()).is_some_and(|rest| rest.ends_with(".tmp") || rest == ".aux.xml") {
            // What cannot be removed is GDAL's temporary file, no output.
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Whether samples of a kind can be a number.
fn holds(kind: GdalDataType, value: f64) -> bool {
    if !kind.is_integer() {
        return true;
    }
    let bits = i32::from(kind.bits());
    let (least, most) = if kind.is_signed() {
        (-(2f64.powi(bits - 1)), 2f64.powi(bits - 1) - 1.0)
    } else {
        (0.0, 2f64.powi(bits) - 1.0)
    };
    value.fract() == 0.0 && (least..=most).contains(&value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_of_samples_holds_the_numbers_that_it_can_store() {
        for (kind, value, is_held) in [
            (GdalDataType::UInt8, 255.0, true),
            (GdalDataType::UInt8, 256.0, false),
            (GdalDataType::UInt8, 0.5, false),
            (GdalDataType::UInt16, -1.0, false),
            (GdalDataType::Int16, -32_768.0, true),
            (GdalDataType::Int16, 32_768.0, false),
            (GdalDataType::UInt32, 4_294_967_295.0, true),
            (GdalDataType::Int32, 2_147_483_648.0, false),
            (GdalDataType::Float32, -9999.5, true),
        ] {
            assert_eq!(holds(kind, value), is_held, "{value} in {}", kind.name());
        }
    }

    #[test]
    fn names_read_back() {
        for resampling in Resampling::ALL {
            assert_eq!(resampling.name().parse(), Ok(resampling));
        }
        for compression in Compression::ALL {
            assert_eq!(compression.name().parse(), Ok(compression));
        }
    }
}
