//! Virtual rasters as `gdalwarp` makes them.
#![allow(unsafe_code)]

use std::ffi::{CString, c_char};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use gdal::Dataset;

use autoref_raster::failed_to_write;

use crate::error::Result;
use crate::gdal_call::{c_string, failure, last_error};

/// A virtual raster of a dataset of `source`, as it is, made with these options.
///
/// # Errors
/// GDAL's own words, when it cannot.
pub(crate) fn warp_dataset(dataset: &Dataset, source: &Path, out: &Path, options: &[&str]) -> Result<()> {
    let words: Vec<CString> = options.iter().map(|o| c_string(source, o.as_bytes())).collect::<Result<_>>()?;
    let mut pointers: Vec<*mut c_char> = words.iter().map(|w| w.as_ptr().cast_mut()).collect();
    pointers.push(std::ptr::null_mut());
    let name = c_string(out, out.as_os_str().as_bytes())?;
    // SAFETY: the list of options is ended by a null pointer; strings and the dataset outlive the calls, the options
    // are freed once, and the dataset that is made is closed once and not used again.
    let failed = unsafe {
        gdal_sys::CPLErrorReset();
        let options = gdal_sys::GDALWarpAppOptionsNew(pointers.as_mut_ptr(), std::ptr::null_mut());
        if options.is_null() {
            Some(last_error())
        } else {
            let (mut usage, mut from) = (0, dataset.c_dataset());
            let made = gdal_sys::GDALWarp(name.as_ptr(), std::ptr::null_mut(), 1, &mut from, options, &mut usage);
            gdal_sys::GDALWarpAppOptionsFree(options);
            if made.is_null() {
                Some(last_error())
            } else {
                gdal_sys::GDALClose(made);
                failure()
            }
        }
    };
    failed.map_or(Ok(()), |text| Err(failed_to_write(out, &format!("warping {}: {text}", source.display()))))
}
