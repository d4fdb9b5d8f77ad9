//! The few things that an edit in place does to a file, as a trait, so that tests can stop at any of them.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;

/// A file as the edit sees it.
pub trait Store {
    /// # Errors
    /// When the system says no.
    fn length(&self) -> io::Result<u64>;
    /// Fills `out` from position `at`.
    ///
    /// # Errors
    /// When there are not that many bytes, or the system says no.
    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()>;
    /// # Errors
    /// When the system says no; a part may have been written.
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()>;
    /// Cuts the file off, or lengthens it by zeros.
    ///
    /// # Errors
    /// When the system says no.
    fn set_length(&mut self, length: u64) -> io::Result<()>;
    /// Returns when all that was done before is on disk.
    ///
    /// # Errors
    /// When the system says no.
    fn sync(&mut self) -> io::Result<()>;
}

impl Store for File {
    fn length(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }
    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        self.read_exact_at(out, at)
    }
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.write_all_at(bytes, at)
    }
    fn set_length(&mut self, length: u64) -> io::Result<()> {
        self.set_len(length)
    }
    fn sync(&mut self) -> io::Result<()> {
        self.sync_all()
    }
}
