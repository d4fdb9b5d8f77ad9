//! Calls of GDAL's C functions: words that they take, and the errors that they leave.
#![allow(unsafe_code)]

use std::ffi::{CStr, CString};
use std::path::Path;

use crate::error::{Error, Result};

pub(crate) fn c_string(path: &Path, bytes: &[u8]) -> Result<CString> {
    CString::new(bytes).map_err(|_| Error::usage(format!("{}: a zero byte in a name", path.display()), "rename it"))
}

/// The last error of this thread when it breaks the result.
pub(crate) fn failure() -> Option<String> {
    // SAFETY: takes nothing and reads this thread's error state.
    let kind = unsafe { gdal_sys::CPLGetLastErrorType() };
    matches!(kind, gdal_sys::CPLErr::CE_Failure | gdal_sys::CPLErr::CE_Fatal).then(last_error)
}

pub(crate) fn last_error() -> String {
    // SAFETY: GDAL returns a valid string that lives until this thread's next error; it is copied here.
    let text = unsafe { CStr::from_ptr(gdal_sys::CPLGetLastErrorMsg()) }.to_string_lossy().into_owned();
    if text.is_empty() { "it gives no reason".into() } else { text }
}
