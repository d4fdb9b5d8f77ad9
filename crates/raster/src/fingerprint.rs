//! Fingerprints: whether what a result was made of has changed. FNV-1a (G. Fowler, L. C. Noll, K.-P. Vo, 1991), 64
//! bits: the same in every run and on every machine, as the standard library's hasher is not.

use std::hash::Hasher;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};

/// A fingerprint in the making.
#[derive(Clone, Debug)]
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Fingerprint(0xcbf2_9ce4_8422_2325)
    }
}

impl Fingerprint {
    /// Of a text alone.
    pub fn of(text: &str) -> Fingerprint {
        let mut fingerprint = Fingerprint::default();
        fingerprint.write(text.as_bytes());
        fingerprint
    }

    /// Adds what a file holds.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read.
    pub fn file(&mut self, path: &Path) -> Result<()> {
        let failed = |e| Error::io(path, "read", e);
        let mut file = std::fs::File::open(path).map_err(failed)?;
        let mut piece = vec![0; 1 << 16];
        loop {
            match file.read(&mut piece).map_err(failed)? {
                0 => return Ok(()),
                count => self.write(&piece[..count]),
            }
        }
    }

    /// Sixteen hexadecimal digits.
    pub fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}

impl Hasher for Fingerprint {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of the authors' test vectors.
    #[test]
    fn known_texts_have_known_fingerprints() {
        assert_eq!(Fingerprint::of("").hex(), "cbf29ce484222325");
        assert_eq!(Fingerprint::of("a").hex(), "af63dc4c8601ec8c");
        assert_eq!(Fingerprint::of("foobar").hex(), "85944171f73967e8");
    }

    #[test]
    fn a_file_counts_as_its_bytes() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a");
        std::fs::write(&path, "foobar").expect("writable");
        let mut of_file = Fingerprint::default();
        of_file.file(&path).expect("readable");
        assert_eq!(of_file.hex(), Fingerprint::of("foobar").hex());
        assert!(Fingerprint::default().file(&folder.path().join("none")).is_err());
    }
}
