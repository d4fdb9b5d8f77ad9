//! Whether a JPEG is whole. Decoders fill what is missing of one that was cut off with grey, and only warn.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::error::{Error, Result};

const START_OF_IMAGE: [u8; 2] = [0xFF, 0xD8];
const START_OF_SCAN: u8 = 0xDA;
const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];
/// Segments before the picture, at most.
const MOST_SEGMENTS: usize = 10_000;
const CHUNK_BYTES: u64 = 1 << 16;

/// Where the compressed picture begins; `None` of what is no JPEG, and where the segments before the picture are
/// broken, which the decoder tells.
fn start_of_scan(file: &mut File) -> std::io::Result<Option<u64>> {
    let mut begin = [0; 2];
    file.read_exact(&mut begin)?;
    if begin != START_OF_IMAGE {
        return Ok(None);
    }
    let mut at = 2;
    for _ in 0..MOST_SEGMENTS {
        let mut head = [0; 4];
        file.seek(SeekFrom::Start(at))?;
        file.read_exact(&mut head)?;
        at += match head {
            [0xFF, START_OF_SCAN, ..] => return Ok(Some(at)),
            // Fill bytes, and markers without a segment.
            [0xFF, 0xFF, ..] => 1,
            [0xFF, 0x01 | 0xD0..=0xD8, ..] => 2,
            [0xFF, _, high, low] => 2 + u64::from(u16::from_be_bytes([high, low])),
            _ => return Ok(None),
        };
    }
    Ok(None)
}

/// Whether the marker of the end stands anywhere behind `start`; searched from the end, where it is in whole files.
fn ends_behind(file: &mut File, start: u64) -> std::io::Result<bool> {
    let mut end = file.metadata()?.len();
    let mut chunk = Vec::new();
    while end > start {
        let begin = end.saturating_sub(CHUNK_BYTES).max(start);
        file.seek(SeekFrom::Start(begin))?;
        chunk.clear();
        // One byte more: the marker may lie across two chunks.
        file.take(end - begin + 1).read_to_end(&mut chunk)?;
        if chunk.windows(2).any(|pair| pair == END_OF_IMAGE) {
            return Ok(true);
        }
        end = begin;
    }
    Ok(false)
}

/// Refuses a JPEG that was cut off: within its compressed data the bytes of the end marker cannot stand.
///
/// # Errors
/// In that case. What is no JPEG, or cannot be read, is left to the decoder.
pub fn check(path: &Path) -> Result<()> {
    let whole = File::open(path).and_then(|mut file| match start_of_scan(&mut file)? {
        Some(start) => ends_behind(&mut file, start),
        None => Ok(true),
    });
    if whole.unwrap_or(true) {
        return Ok(());
    }
    Err(Error::format(path, "the end", "the JPEG is cut off: the rest of the picture is missing; copy the file again"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_was_cut_off_is_told_from_a_whole_one() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("a.jpg");
        // A thumbnail with an end of its own, the picture, and what some cameras append.
        let head = b"\xFF\xD8\xFF\xE1\x00\x06\xFF\xD9ab\xFF\xDA\x00\x02";
        let data = [0x55; 200_000];
        let judged = |bytes: &[u8]| {
            std::fs::write(&path, bytes).expect("a file");
            check(&path).is_ok()
        };
        let whole = [&head[..], &data, &END_OF_IMAGE].concat();
        assert!(judged(&whole));
        assert!(judged(&[&whole[..], &[7; 70_000]].concat()));
        assert!(!judged(&whole[..whole.len() - 1]));
        assert!(!judged(&whole[..1000]));
        assert!(judged(b"\xFF\xD8 something else"));
    }
}
