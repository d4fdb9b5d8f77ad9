//! Choosing the reader.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{RasterSource, ReaderChoice, SampleType, gdal, tiff, tile_folder};
use crate::bounded;
use crate::error::{Error, Result};

/// Opens `path` with the reader that fits.
///
/// `cache_bytes` bounds what the source may keep of decoded blocks between reads; `page` is the image to read, counted
/// over the full-resolution images of the file (masks and overviews do not count; 0 is the first).
///
/// Paths that begin with `/vsi` are GDAL's and are given to it as they are.
///
/// # Errors
/// When the file is missing, broken, or of a kind that no reader takes; the message says what exactly.
pub fn open(path: &Path, choice: ReaderChoice, page: usize, cache_bytes: u64) -> Result<Arc<dyn RasterSource>> {
    gdal::initialise_gdal(cache_bytes);
    let local = !path.to_string_lossy().starts_with("/vsi");
    if !local {
        if choice.is_native() {
            return Err(Error::usage(
                format!("{}: the native reader reads local files only", path.display()),
                "use --reader auto or gdal",
            ));
        }
        return Ok(Arc::new(gdal::open_gdal(path, page, cache_bytes)?));
    }
    if tile_folder::is_tile_folder(path) {
        if choice.is_native() {
            return Err(Error::unsupported(path, "tiles by the native reader", "use --reader auto or gdal"));
        }
        let name = gdal_name(path, page)?;
        return Ok(Arc::new(gdal::open_name(gdal::GdalName { path: path.to_path_buf(), name }, cache_bytes)?));
    }
    check_file(path)?;
    if !tiff::is_tiff(path)? {
        if choice.is_native() {
            return Err(Error::unsupported(path, "not a TIFF file", "use --reader auto or gdal"));
        }
        if page > 0 {
            return Err(Error::usage(
                format!("{}: page {page} of a file that is no TIFF", path.display()),
                "leave --page away",
            ));
        }
        return Ok(Arc::new(gdal::open_gdal(path, 0, cache_bytes)?));
    }
    // Walked for GDAL as well: it alone knows which directory the page is, and refuses cycles.
    let directories = tiff::Directories::read(path)?;
    let directory = directories.page(page)?;
    let opened = match choice {
        ReaderChoice::Gdal => return Ok(Arc::new(gdal::open_gdal(path, directory, cache_bytes)?)),
        ReaderChoice::Mapped => tiff::open_mapped(&directories, directory, cache_bytes),
        ReaderChoice::Auto | ReaderChoice::Native => tiff::open(&directories, directory, cache_bytes),
    };
    let native_error = match opened {
        Ok(source) => return Ok(Arc::new(source)),
        Err(error) => error,
    };
    let can_pass = matches!(native_error, Error::Unsupported { .. } | Error::Limit { .. });
    if choice.is_native() || !can_pass {
        return Err(native_error);
    }
    tracing::info!("the native reader passes on to GDAL: {native_error}");
    let source = gdal::open_gdal(path, directory, cache_bytes)?;
    Ok(Arc::new(source))
}

/// Width and height of image `page` in pixels, of whatever GDAL opens.
///
/// # Errors
/// When the file is missing, broken or no raster.
pub fn size(path: &Path, page: usize) -> Result<(u64, u64)> {
    let (width, height) = open_dataset(path, page)?.1.raster_size();
    Ok((width as u64, height as u64))
}

/// Opens image `page` of a file, or a folder or list of tiles, with GDAL, and gives the name by which GDAL knows it.
///
/// # Errors
/// When the file is missing, broken or no raster.
pub fn open_dataset(path: &Path, page: usize) -> Result<(PathBuf, ::gdal::Dataset)> {
    gdal::initialise_gdal(0);
    let name = gdal_name(path, page)?;
    let dataset = gdal::GdalName { path: path.to_path_buf(), name: name.clone() }.open()?;
    Ok((name, dataset))
}

/// What GDAL opens: an absolute path, a page of one, or a virtual raster of tiles.
fn gdal_name(path: &Path, page: usize) -> Result<PathBuf> {
    if path.to_string_lossy().starts_with("/vsi") {
        return Ok(path.to_path_buf());
    }
    if tile_folder::is_tile_folder(path) {
        if page > 0 {
            return Err(Error::usage(format!("{}: page {page} of tiles", path.display()), "leave --page away"));
        }
        return tile_folder::TileFolder::open(path)?.virtual_file();
    }
    check_file(path)?;
    let absolute = std::fs::canonicalize(path).map_err(|e| Error::io(path, "resolve", e))?;
    let directory = match tiff::is_tiff(path)? {
        true => tiff::Directories::read(path)?.page(page)?,
        false => 0,
    };
    Ok(gdal::GdalName::new(&absolute, directory).name)
}

/// Refuses what is no file with bytes in it, in words.
fn check_file(path: &Path) -> Result<()> {
    bounded::refuse_endless(path)?;
    let metadata = std::fs::metadata(path).map_err(|e| Error::io(path, "open", e))?;
    if metadata.is_dir() {
        return Err(Error::format(path, "path", "is a directory, not an image file"));
    }
    if metadata.is_file() && metadata.len() == 0 {
        return Err(Error::format(path, "file", "is empty (0 bytes)"));
    }
    Ok(())
}

/// The value of full white: all bits that NBITS (or BitsPerSample) names; else, of 16-bit samples, MaxSampleValue when
/// it is one less than a power of two above 8 bits, as for 12-bit cameras (any other value is a statistic of the image,
/// which the TIFF specification forbids to use for display).
pub(super) fn white_of(sample: SampleType, bits: Option<u32>, max_sample_value: Option<u64>) -> u16 {
    let width = 8 * sample.bytes() as u32;
    if let Some(bits) = bits.filter(|bits| (1..width).contains(bits)) {
        return ((1u32 << bits) - 1) as u16;
    }
    match (sample, max_sample_value) {
        (SampleType::U8, _) => 255,
        (SampleType::U16, Some(max)) if (512..65_535).contains(&(max + 1)) && (max + 1).is_power_of_two() => max as u16,
        (SampleType::U16, _) => 65_535,
    }
}

/// A path as a shell takes it.
pub(super) fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=,".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text;
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

/// The command that makes a tiled copy.
pub(super) fn retile_remedy(path: &Path) -> String {
    format!(
        "retile it: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE -co PREDICTOR=2 -co BIGTIFF=IF_SAFER {} tiled.tif, \
         or raise --memory",
        quoted(path)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_follows_the_bits() {
        assert_eq!(white_of(SampleType::U8, None, Some(100)), 255);
        assert_eq!(white_of(SampleType::U8, Some(1), None), 1);
        assert_eq!(white_of(SampleType::U16, Some(12), None), 4095);
        assert_eq!(white_of(SampleType::U16, None, Some(2047)), 2047);
        assert_eq!(white_of(SampleType::U16, None, Some(3000)), 65_535);
        assert_eq!(white_of(SampleType::U16, None, Some(65_535)), 65_535);
        assert_eq!(white_of(SampleType::U16, Some(16), None), 65_535);
    }

    #[test]
    fn paths_are_quoted_for_the_shell() {
        assert_eq!(quoted(Path::new("/a/b.tif")), "/a/b.tif");
        assert_eq!(quoted(Path::new("a b's.tif")), r"'a b'\''s.tif'");
    }
}
