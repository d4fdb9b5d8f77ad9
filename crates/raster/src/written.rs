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

/// Whether a dBase table has fewer bytes than its head counts, or none that can be read: GDAL says nothing of one that
/// it could not write whole.
pub fn is_cut_table(table: &Path) -> bool {
    use std::io::Read;
    const LEAST_HEAD: u64 = 33;
    let mut start = [0; 12];
    let head = std::fs::File::open(table).and_then(|mut file| {
        file.read_exact(&mut start)?;
        file.metadata()
    });
    let Ok(metadata) = head else { return true };
    let [_, _, _, _, r0, r1, r2, r3, h0, h1, l0, l1] = start;
    let rows = u64::from(u32::from_le_bytes([r0, r1, r2, r3]));
    let (head, row) = (u64::from(u16::from_le_bytes([h0, h1])), u64::from(u16::from_le_bytes([l0, l1])));
    // The head is written last, and may have gone with the rest.
    head < LEAST_HEAD || metadata.len() < head + rows * row
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_was_cut_is_seen() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("a.dbf");
        let is_cut = |bytes: &[u8]| {
            std::fs::write(&file, bytes).expect("written");
            is_cut_table(&file)
        };
        let mut table = vec![3, 126, 11, 28, 2, 0, 0, 0, 65, 0, 10, 0];
        table.resize(65 + 2 * 10, b' ');
        assert!(!is_cut(&table));
        let mut without_head = table.clone();
        without_head[8..12].fill(0);
        assert!(is_cut(&without_head));
        assert!(is_cut(&table[..84]) && is_cut(&table[..5]) && is_cut(&[]));
        assert!(is_cut_table(&folder.path().join("absent.dbf")));
    }

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
