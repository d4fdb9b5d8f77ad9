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

/// A file as it would be: what is written and cut off is remembered, and the file stays as it is.
pub struct Imagined<'a> {
    file: &'a dyn Store,
    length: u64,
    written: Vec<(u64, Vec<u8>)>,
}

impl<'a> Imagined<'a> {
    /// # Errors
    /// When the system does not tell how long the file is.
    pub fn of(file: &'a dyn Store) -> io::Result<Self> {
        Ok(Imagined { file, length: file.length()?, written: Vec::new() })
    }

    /// The stretches (position, length) of the imagined file, one behind the other; each is the file's as it is, or
    /// written over throughout.
    pub fn stretches(&self) -> Vec<(u64, u64)> {
        let ends = self.written.iter().flat_map(|(at, bytes)| [*at, at + bytes.len() as u64]);
        let mut cuts: Vec<u64> = [0, self.length].into_iter().chain(ends.filter(|&at| at < self.length)).collect();
        cuts.sort_unstable();
        cuts.dedup();
        cuts.windows(2).map(|pair| (pair[0], pair[1] - pair[0])).collect()
    }

    /// Whether what is at a position was written over.
    pub fn is_written(&self, at: u64) -> bool {
        self.written.iter().any(|(from, bytes)| (*from..from + bytes.len() as u64).contains(&at))
    }
}

impl Store for Imagined<'_> {
    fn length(&self) -> io::Result<u64> {
        Ok(self.length)
    }
    fn read_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        if at.checked_add(out.len() as u64).is_none_or(|end| end > self.length) {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        self.file.read_at(at, out)?;
        for (from, bytes) in &self.written {
            for (place, byte) in (*from..).zip(bytes) {
                if let Some(out) = place.checked_sub(at).and_then(|i| out.get_mut(i as usize)) {
                    *out = *byte;
                }
            }
        }
        Ok(())
    }
    fn write_at(&mut self, at: u64, bytes: &[u8]) -> io::Result<()> {
        self.written.push((at, bytes.to_vec()));
        Ok(())
    }
    /// Undoing only cuts off.
    fn set_length(&mut self, length: u64) -> io::Result<()> {
        if length > self.length {
            return Err(io::ErrorKind::Unsupported.into());
        }
        self.length = length;
        Ok(())
    }
    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
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
