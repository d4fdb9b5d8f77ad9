//! Fingerprints: whether what a result was made of has changed. XXH3 (Y. Collet, 2019), 64 bits: the same in every run
//! and on every machine, as the standard library's hasher is not, and faster than a disk.

use std::hash::Hasher;
use std::io::Read;
use std::path::Path;
use std::sync::LazyLock;

use twox_hash::XxHash3_64;

use crate::error::{Error, Result};

/// A fingerprint in the making.
#[derive(Clone, Default)]
pub struct Fingerprint(XxHash3_64);

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
        format!("{:016x}", self.0.finish())
    }
}

impl Hasher for Fingerprint {
    fn finish(&self) -> u64 {
        self.0.finish()
    }

    fn write(&mut self, bytes: &[u8]) {
        self.0.write(bytes);
    }
}

/// Size and time of a file, which change with what it holds; empty when it is not there.
pub fn size_and_time(path: &Path) -> String {
    let time = |data: &std::fs::Metadata| data.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok();
    std::fs::metadata(path).map(|data| format!("{} {:?}", data.len(), time(&data))).unwrap_or_default()
}

/// The program that runs: its version, and size and time of its file. A version alone says the same of all that is
/// built between two releases, and a number that somebody must raise is forgotten.
pub fn program() -> &'static str {
    static PROGRAM: LazyLock<String> = LazyLock::new(|| {
        let file = std::env::current_exe().map(|exe| size_and_time(&exe)).unwrap_or_default();
        format!("{} {file}", env!("CARGO_PKG_VERSION"))
    });
    &PROGRAM
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_program_is_more_than_its_version() {
        let exe = std::env::current_exe().expect("a test is a program");
        let bytes = std::fs::metadata(exe).expect("it runs").len();
        assert!(program().starts_with(env!("CARGO_PKG_VERSION")) && program().contains(&bytes.to_string()));
        assert_eq!(size_and_time(Path::new("no such file")), "");
    }

    /// What the author's library says.
    #[test]
    fn known_texts_have_known_fingerprints() {
        assert_eq!(Fingerprint::of("").hex(), "2d06800538d394c2");
        assert_eq!(Fingerprint::of("a").hex(), "e6c632b61e964e1f");
        assert_eq!(Fingerprint::of("foobar").hex(), "d78fda63144c5c84");
        assert_eq!(Fingerprint::of(&"abc".repeat(300)).hex(), "c830818b7d87adb0");
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
