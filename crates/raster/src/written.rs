//! Datasets that GDAL writes: nothing counts as written before it lies on the disk.
//!
//! GDAL keeps blocks back until a dataset is closed, and before its version 3.7 closing says nothing of what went
//! wrong. What it tells its error handler meanwhile is counted per thread; a dataset is written when nothing was told.

use std::cell::{Cell, RefCell};
use std::path::{Path, PathBuf};

use gdal::Dataset;

use crate::error::{Error, Result};

thread_local! {
    static FAILURES: Cell<u64> = const { Cell::new(0) };
    static LAST: RefCell<String> = const { RefCell::new(String::new()) };
}

/// Called by the error handler for whatever is worse than a warning.
pub(crate) fn note_failure(message: &str) {
    FAILURES.set(FAILURES.get() + 1);
    LAST.with_borrow_mut(|last| message.clone_into(last));
}

/// What GDAL failed at on this thread while `work` ran, though it may have answered that all is well: decoders of fax
/// go on over broken rows.
pub(crate) fn failure_during<R>(work: impl FnOnce() -> R) -> (R, Option<String>) {
    let before = FAILURES.get();
    let result = work();
    let failed = FAILURES.get() > before;
    (result, failed.then(|| LAST.with_borrow(Clone::clone)))
}

/// Runs what answers for itself: what GDAL tells meanwhile is no failure of a file that is written. A file that opens
/// may have metadata that GDAL cannot read.
pub fn unheard<R>(work: impl FnOnce() -> R) -> R {
    let before = FAILURES.get();
    let result = work();
    FAILURES.set(before);
    result
}

/// Watches the writing of one dataset on this thread.
pub struct Written {
    path: PathBuf,
    failures_before: u64,
}

impl Written {
    /// Begins before the dataset is created. `path` is named in messages.
    pub fn watch(path: &Path) -> Written {
        crate::hear_gdal();
        Written { path: path.to_owned(), failures_before: FAILURES.get() }
    }

    /// Closes the dataset.
    ///
    /// # Errors
    /// When GDAL failed at anything since [`Written::watch`]; a full disk is named as such.
    pub fn close(self, dataset: Dataset) -> Result<()> {
        let closed = dataset.close();
        self.nothing_failed()?;
        closed.map_err(|e| failed_to_write(&self.path, &e.to_string()))
    }

    /// Whether all went well on this thread.
    ///
    /// # Errors
    /// As [`Written::close`].
    pub fn nothing_failed(&self) -> Result<()> {
        if FAILURES.get() > self.failures_before {
            return Err(failed_to_write(&self.path, &LAST.with_borrow(Clone::clone)));
        }
        Ok(())
    }
}

/// Bytes that are free on the disk of a folder; `None` when it cannot be asked.
pub fn free_disk_bytes(folder: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    Some(disk.f_bavail.saturating_mul(disk.f_frsize))
}

/// What GDAL said, or that the disk is full when it is.
pub fn failed_to_write(path: &Path, said: &str) -> Error {
    const FULL_BELOW_BYTES: u64 = 4 << 20;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match free_disk_bytes(folder) {
        Some(free) if free < FULL_BELOW_BYTES => {
            let full = std::io::Error::new(std::io::ErrorKind::StorageFull, "the disk is full");
            Error::io(path, "write", full)
        }
        _ => Error::gdal(path, said),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_on_the_way_is_not_lost() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.tif");
        let create = || {
            let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
            driver.create_with_band_type::<u8, _>(&path, 8, 8, 1).expect("created")
        };
        let watch = Written::watch(&path);
        assert!(watch.close(create()).is_ok());
        let watch = Written::watch(&path);
        let dataset = create();
        let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
        assert!(driver.create_with_band_type::<u8, _>(folder.path().join("absent/b.tif"), 8, 8, 1).is_err());
        assert!(watch.close(dataset).is_err());
    }
}
