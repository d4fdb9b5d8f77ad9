//! GDAL's CreateCopy with a progress report, which the safe binding does not offer, and the size of GDAL's cache, which
//! it lets nobody change after the first use.
#![allow(unsafe_code)]

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

use gdal::cpl::CslStringList;
use gdal::{Dataset, Driver};

/// Copies `source` to `path` with `driver`. `progress` gets numbers from 0 to 1 and answers whether to go on.
///
/// # Errors
/// GDAL's own words; also for errors that GDAL met while it closed the copy, such as a full disk.
pub fn create_copy(
    source: &Dataset,
    driver: &Driver,
    path: &Path,
    options: &CslStringList,
    progress: &dyn Fn(f64) -> bool,
) -> Result<(), String> {
    let name = CString::new(path.as_os_str().as_bytes()).map_err(|e| e.to_string())?;
    // A pointer to a fat pointer, since C passes thin ones.
    let argument = std::ptr::from_ref(&progress).cast_mut().cast::<c_void>();
    // SAFETY: takes nothing and only clears this thread's last error.
    unsafe { gdal_sys::CPLErrorReset() };
    // SAFETY: driver, source, name, options and the progress argument all outlive the call; the callback casts the
    // argument back to what it is.
    let copy = unsafe {
        gdal_sys::GDALCreateCopy(
            driver.c_driver(),
            name.as_ptr(),
            source.c_dataset(),
            0,
            options.as_ptr(),
            Some(report),
            argument,
        )
    };
    if copy.is_null() {
        return Err(last_error().unwrap_or_else(|| "it gives no reason".into()));
    }
    let met = last_failure();
    // SAFETY: the dataset is ours alone and is not used again.
    unsafe { gdal_sys::GDALClose(copy) };
    match met.or_else(last_failure) {
        Some(failure) => Err(failure),
        None => Ok(()),
    }
}

/// Called by GDAL.
extern "C" fn report(done: f64, _message: *const c_char, argument: *mut c_void) -> c_int {
    // SAFETY: `create_copy` passes a pointer to this type, which it keeps alive until GDAL returns.
    let progress = unsafe { &*argument.cast::<&dyn Fn(f64) -> bool>() };
    c_int::from(progress(done))
}

/// The last error of this thread when it was one that breaks the result, not a warning.
fn last_failure() -> Option<String> {
    // SAFETY: takes nothing and reads this thread's error state.
    let kind = unsafe { gdal_sys::CPLGetLastErrorType() };
    matches!(kind, gdal_sys::CPLErr::CE_Failure | gdal_sys::CPLErr::CE_Fatal)
        .then(|| last_error().unwrap_or_else(|| "it gives no reason".into()))
}

fn last_error() -> Option<String> {
    // SAFETY: GDAL returns a valid string, never null, that lives until this thread's next error; it is copied here.
    let text = unsafe { CStr::from_ptr(gdal_sys::CPLGetLastErrorMsg()) }.to_string_lossy().into_owned();
    (!text.is_empty()).then_some(text)
}

/// Bounds GDAL's block cache from now on.
pub fn set_cache_bytes(bytes: u64) {
    // SAFETY: takes a number; GDAL locks its own cache.
    unsafe { gdal_sys::GDALSetCacheMax64(bytes as i64) };
}
