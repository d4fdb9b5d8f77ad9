//! A file of these bytes, with the ending that tells a reader what it is.

use std::io::Write;

/// In memory, gone when dropped. The first byte chooses the ending, so that one corpus serves all dialects.
pub fn file(data: &[u8], endings: &[&str]) -> Option<tempfile::NamedTempFile> {
    let (choice, bytes) = data.split_first()?;
    let ending = endings[usize::from(*choice) % endings.len()];
    let mut file = tempfile::Builder::new().suffix(ending).tempfile_in("/dev/shm").expect("memory for a small file");
    file.write_all(bytes).expect("memory for a small file");
    Some(file)
}
