//! The error type of the crate. What is an answer (no datum, too few points) is data of the result where it can be.

use std::path::{Path, PathBuf};

use autoref_raster::bounded;

/// What went wrong. Every message is one line that names the file or the point, and the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file, a request or the system, as everywhere in the house.
    #[error(transparent)]
    Raster(#[from] autoref_raster::Error),
    /// It ran, and the data carry no result.
    #[error("{what}; {remedy}")]
    NoResult { what: String, remedy: String },
}

/// What this library returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// [`autoref_raster::Error::Format`].
    pub fn format(path: impl Into<PathBuf>, place: impl Into<String>, what: impl Into<String>) -> Self {
        Error::Raster(autoref_raster::Error::format(path, place, what))
    }
    /// [`autoref_raster::Error::Usage`].
    pub fn usage(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::Raster(autoref_raster::Error::usage(what, remedy))
    }
    /// [`autoref_raster::Error::Io`]; `action` is a verb phrase.
    pub fn io(path: impl Into<PathBuf>, action: impl Into<String>, source: std::io::Error) -> Self {
        Error::Raster(autoref_raster::Error::io(path, action, source))
    }
    /// [`Error::NoResult`].
    pub fn no_result(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::NoResult { what: what.into(), remedy: remedy.into() }
    }
}

/// The bytes of a file whole, as the other readers of documents bound them.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    Ok(bounded::read(path, "a description of a flight", bounded::DOCUMENT_BYTES)?)
}

/// A text file whole, in UTF-16 where its first two bytes say so; what is no UTF-8 is taken as Latin-1.
pub(crate) fn read_text(path: &Path) -> Result<String> {
    let text = decoded(read_bytes(path)?);
    // Old programs end lines with a carriage return alone.
    if text.contains('\n') || !text.contains('\r') { Ok(text) } else { Ok(text.replace('\r', "\n")) }
}

fn decoded(bytes: Vec<u8>) -> String {
    let wide = |of: fn([u8; 2]) -> u16| {
        let units: Vec<u16> = bytes[2..].chunks_exact(2).map(|pair| of([pair[0], pair[1]])).collect();
        String::from_utf16_lossy(&units)
    };
    if bytes.starts_with(&[0xFF, 0xFE]) {
        return wide(u16::from_le_bytes);
    }
    if bytes.starts_with(&[0xFE, 0xFF]) {
        return wide(u16::from_be_bytes);
    }
    String::from_utf8(bytes).unwrap_or_else(|e| e.into_bytes().iter().map(|b| char::from(*b)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_old_programs_are_lines() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("t.csv");
        for (written, read) in [("a\rb\r", "a\nb\n"), ("a\r\nb\r\n", "a\r\nb\r\n"), ("a\n", "a\n")] {
            std::fs::write(&path, written).expect("writable");
            assert_eq!(read_text(&path).expect("text"), read);
        }
    }

    #[test]
    fn text_is_read_in_the_encodings_of_spreadsheets() {
        let text = "name,x\nTück,1\n";
        let wide = |mark: [u8; 2], of: fn(u16) -> [u8; 2]| -> Vec<u8> {
            mark.into_iter().chain(text.encode_utf16().flat_map(of)).collect()
        };
        assert_eq!(decoded(wide([0xFF, 0xFE], u16::to_le_bytes)), text);
        assert_eq!(decoded(wide([0xFE, 0xFF], u16::to_be_bytes)), text);
        assert_eq!(decoded(text.into()), text);
        assert_eq!(decoded(b"T\xFCck".to_vec()), "Tück");
    }
}
