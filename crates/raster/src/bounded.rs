//! Reading files that must be small: never more than so many bytes, never a pipe or a device.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::sidecars::parts_of;

/// What a text that people write by hand may have: profiles, patches, tables of errors, descriptions of cameras.
pub const TEXT_BYTES: u64 = 16 << 20;
/// What a document that the program wrote may have: a result with a hundred thousand candidates has some 50 MB.
pub const DOCUMENT_BYTES: u64 = 512 << 20;

/// The bytes of a file that is `what`, at most `most_bytes`.
///
/// # Errors
/// [`Error::Io`] when it cannot be read to its end, [`Error::Unsupported`] for a pipe or a device, which may never end,
/// [`Error::Limit`] when it is larger.
pub fn read(path: &Path, what: &str, most_bytes: u64) -> Result<Vec<u8>> {
    refuse_endless(path)?;
    let file = File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let mut bytes = Vec::new();
    let stated = file.metadata().map_or(0, |m| m.len());
    // One byte more than is allowed tells a file that grows while it is read.
    file.take(most_bytes + 1).read_to_end(&mut bytes).map_err(|e| Error::io(path, "read", e))?;
    // A list that ends early would pass for a whole one of fewer rows.
    if (bytes.len() as u64) < stated.min(most_bytes) {
        let what = format!("the file ended after {} of {stated} bytes", bytes.len());
        return Err(Error::io(path, "read", std::io::Error::new(std::io::ErrorKind::UnexpectedEof, what)));
    }
    if bytes.len() as u64 > most_bytes {
        let needed = std::fs::metadata(path).map_or(bytes.len() as u64, |m| m.len().max(bytes.len() as u64));
        return Err(Error::Limit {
            what: format!("{}: {what}", path.display()),
            needed,
            allowed: most_bytes,
            remedy: "is this the right file?".into(),
        });
    }
    Ok(bytes)
}

/// The same as text.
///
/// # Errors
/// Those of [`read`]; [`Error::Io`] when it is no UTF-8.
pub fn read_to_string(path: &Path, what: &str, most_bytes: u64) -> Result<String> {
    String::from_utf8(read(path, what, most_bytes)?)
        .map_err(|e| Error::io(path, "read", std::io::Error::new(std::io::ErrorKind::InvalidData, e.utf8_error())))
}

/// Refuses what can be read for ever or makes a reader wait: pipes, sockets, devices, in the place of the file or of
/// one that is read with it. What is not there is left to the caller.
///
/// # Errors
/// [`Error::Unsupported`].
pub fn refuse_endless(path: &Path) -> Result<()> {
    let parts = parts_of(path).iter().map(|end| path.with_extension(end));
    for file in std::iter::once(path.to_path_buf()).chain(parts) {
        if std::fs::metadata(&file).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
            let what = "a pipe or a device in place of a file";
            return Err(Error::unsupported(&file, what, "save what comes out of it as a file and name that"));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_larger_or_endless_is_refused() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let file = folder.path().join("a.txt");
        std::fs::write(&file, "12345").expect("writable");
        assert_eq!(read(&file, "a list", 5).expect("small enough"), b"12345");
        let large = read(&file, "a list", 4).expect_err("five bytes");
        assert!(matches!(large, Error::Limit { needed: 5, allowed: 4, .. }), "{large}");
        assert!(matches!(read(&folder.path().join("none"), "a list", 4), Err(Error::Io { .. })));
        std::fs::write(&file, [0xFF, 0xFE]).expect("writable");
        assert!(matches!(read_to_string(&file, "a list", 4), Err(Error::Io { .. })));
        #[cfg(unix)]
        assert!(matches!(read(Path::new("/dev/zero"), "a list", 4), Err(Error::Unsupported { .. })));
    }
}
