//! A file of these bytes, with the ending that tells a reader what it is.

use std::io::Write;

/// In memory, gone when dropped. The first byte chooses the ending, so that one corpus serves all dialects.
#[allow(dead_code)] // clouds have one ending a target
pub fn file(data: &[u8], endings: &[&str]) -> Option<tempfile::NamedTempFile> {
    let (choice, bytes) = data.split_first()?;
    let ending = endings[usize::from(*choice) % endings.len()];
    let mut file = tempfile::Builder::new().suffix(ending).tempfile_in("/dev/shm").expect("memory for a small file");
    file.write_all(bytes).expect("memory for a small file");
    Some(file)
}

/// The bytes as a point cloud of this ending, read to the end or refused.
#[allow(dead_code)] // one target a reader
pub fn cloud(data: &[u8], ending: &str) {
    use autoref_cloud::{io, schema::Batch};
    /// More than any file of these sizes holds; a header that promises more must not make the reader go on.
    const MOST_POINTS: usize = 1 << 16;
    let mut file = tempfile::Builder::new().suffix(ending).tempfile_in("/dev/shm").expect("memory for a small file");
    file.write_all(data).expect("memory for a small file");
    let Ok((_, mut reader)) = io::open(file.path()) else { return };
    let mut batch = Batch { xyz: Vec::new(), raw: Vec::new() };
    let mut points = 0;
    while points < MOST_POINTS && reader.read(&mut batch, 4096).is_ok() && !batch.is_empty() {
        points += batch.len();
    }
}
