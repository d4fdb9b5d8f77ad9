//! A tiled raster as a Cloud Optimized GeoTIFF.

use std::path::Path;

use gdal::Dataset;
use gdal::raster::RasterCreationOptions;

use crate::error::Result;
use crate::failed_to_write;
use crate::written::Written;

/// How overviews are made of the pixels below them; between two numbers of a palette lies none, so that these are taken
/// from one of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overviews {
    Cubic,
    Average,
}

/// Bytes of a block of all bands, at most: GDAL gathers one.
const BLOCK_BYTES: usize = 4 << 20;

/// Copies `plain` to `out` with overviews, compressed by Deflate; blocks that hold nothing take no room.
///
/// # Errors
/// Those of reading `plain` and of writing `out`.
pub fn copy(plain: &Path, out: &Path, overviews: Overviews, threads: usize) -> Result<()> {
    let failed = |e: gdal::errors::GdalError| failed_to_write(out, &e.to_string());
    let source = Dataset::open(plain).map_err(failed)?;
    let sample = source.rasterband(1).map_err(failed)?.band_type().bytes() as usize;
    let fits = |side: &usize| side * side * source.raster_count() * sample <= BLOCK_BYTES;
    let block = format!("BLOCKSIZE={}", [512, 256, 128].into_iter().find(fits).unwrap_or(128));
    let threads = format!("NUM_THREADS={}", threads.max(1));
    let has_palette = source.rasterband(1).map_err(failed)?.color_table().is_some();
    let resampling = match overviews {
        _ if has_palette => "RESAMPLING=NEAREST",
        Overviews::Cubic => "RESAMPLING=CUBIC",
        Overviews::Average => "RESAMPLING=AVERAGE",
    };
    let options = RasterCreationOptions::from_iter([
        "COMPRESS=DEFLATE",
        "PREDICTOR=YES",
        "BIGTIFF=IF_SAFER",
        "SPARSE_OK=TRUE",
        resampling,
        &block,
        &threads,
    ]);
    let driver = gdal::DriverManager::get_driver_by_name("COG").map_err(failed)?;
    // Overviews are the same from pieces of any size; GDAL takes ten megabytes for each, several times.
    gdal::config::set_config_option("GDAL_OVR_CHUNK_MAX_SIZE", "2000000").map_err(failed)?;
    let watch = Written::watch(out);
    let copy = source.create_copy(&driver, out, &options).map_err(failed)?;
    watch.close(copy)
}
