//! Choosing the reader.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{Georeference, RasterSource, ReaderChoice, gdal, tiff, tile_folder};
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

/// The georeference inside a file: what a world file, an `.aux.xml` or other files beside it say does not count.
/// `bytes`: where GDAL finds what the file held earlier, when that is meant.
///
/// # Errors
/// When the file is missing, broken or no raster.
pub fn georeference_inside(path: &Path, page: usize, bytes: Option<&Path>) -> Result<Georeference> {
    gdal::initialise_gdal(0);
    check_file(path)?;
    let (directory, options) = match tiff::is_tiff(path)? {
        // GDAL is not told the neighbours of a directory: the sources are named instead.
        true => (tiff::Directories::read(path)?.page(page)?, Some(&["GEOREF_SOURCES=INTERNAL"][..])),
        false => (0, None),
    };
    let name = gdal::GdalName::new(bytes.unwrap_or(path), directory).name;
    let facts = gdal::GdalName { path: path.to_path_buf(), name }.open_alone(options)?;
    Ok(Georeference { transform: facts.geotransform, crs_wkt: facts.crs_wkt })
}

/// The georeference that GDAL finds at `path`, an absolute one. Where that is a symbolic link, the files beside the
/// link count, not those beside what it leads to.
///
/// # Errors
/// When the file is missing, broken or no raster.
pub fn georeference_at(path: &Path, page: usize) -> Result<Georeference> {
    gdal::initialise_gdal(0);
    check_file(path)?;
    let directory = match tiff::is_tiff(path)? {
        true => tiff::Directories::read(path)?.page(page)?,
        false => 0,
    };
    let facts = gdal::GdalName::new(path, directory).facts()?;
    Ok(Georeference { transform: facts.geotransform, crs_wkt: facts.crs_wkt })
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
