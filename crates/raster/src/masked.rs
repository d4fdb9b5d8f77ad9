//! Alpha bands and masks: which cells a file says are there.

use std::path::Path;

use gdal::raster::RasterBand;

use crate::error::{Error, Result};

/// Whether a band has an alpha band or a mask beside it; a nodata value is none.
///
/// # Errors
/// When GDAL cannot say what masks the band.
pub fn has_mask(path: &Path, band: &RasterBand<'_>) -> Result<bool> {
    let flags = band.mask_flags().map_err(|e| Error::gdal(path, e))?;
    Ok(!flags.is_all_valid() && !flags.is_nodata())
}

/// Makes the cells of a window NaN that the mask of a band leaves out. `at` is column and row, `values` go row by row.
///
/// # Errors
/// When the mask cannot be read.
pub fn leave_out(
    path: &Path,
    band: &RasterBand<'_>,
    at: (isize, isize),
    size: (usize, usize),
    values: &mut [f64],
) -> Result<()> {
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let mut there = vec![0u8; size.0 * size.1];
    band.open_mask_band().and_then(|mask| mask.read_into_slice(at, size, size, &mut there, None)).map_err(failed)?;
    values.iter_mut().zip(&there).filter(|(_, there)| **there == 0).for_each(|(value, _)| *value = f64::NAN);
    Ok(())
}
