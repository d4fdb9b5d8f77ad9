//! The undo record at the end of an edited file, and what is done with it.
//!
//! An edit appends (new directory, then the record), waits until that is on disk, and only then switches what points to
//! the directory: at most eight bytes inside one disk sector, by one write. A crash before the switch leaves the old
//! image with unused bytes after it; after it, the new image. The record is plain JSON, so that a person can undo by
//! hand what a later program no longer understands; a footer of 32 bytes finds it from the file's end.
//! `docs/formats.md` has the layout.

use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::store::{Imagined, Store};
use autoref_raster::error::{Error, Result};

/// Last bytes of an edited file.
const MAGIC: &[u8; 16] = b"autoref-undo-v1\n";
const FOOTER_BYTES: u64 = 32;
/// A record of directories and patches is a few kilobytes.
const MAX_RECORD_BYTES: u64 = 1 << 20;
/// How much of the old file's beginning and end is watched for changes.
const WATCHED_BYTES: u64 = 65_536;
/// More directories than this are not watched one by one.
const WATCHED_DIRECTORIES: usize = 256;
/// How far from the end a buried record is looked for, to say why it is not at the end.
const SEARCHED_BYTES: u64 = 4 << 20;

/// Bytes that are exchanged in place.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Patch {
    pub at: u64,
    #[serde(with = "hex")]
    pub old: Vec<u8>,
    #[serde(with = "hex")]
    pub new: Vec<u8>,
}

impl Patch {
    /// Whether the file's bytes may be there without another program: the new ones; the old ones, when a crash came
    /// between the steps of an earlier undo; or a mixture of both, when it came in the middle of more bytes than are
    /// written whole.
    fn may_be(&self, now: &[u8]) -> bool {
        let mixed = || now.iter().zip(self.old.iter().zip(&self.new)).all(|(now, (old, new))| now == old || now == new);
        now == self.new || now == self.old || (now.len() > 8 && mixed())
    }
}

/// A part of the old file that another program must not have changed when it is restored.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Watched {
    at: u64,
    length: u64,
    crc32: u32,
}

/// The record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Record {
    what: String,
    pub program: String,
    /// Length of the file before the edit.
    pub old_length: u64,
    /// Where this record begins.
    record_at: u64,
    /// Of the bytes from `old_length` to `record_at`.
    appended_crc32: u32,
    /// In the order in which they are made; undone in the opposite order.
    pub patches: Vec<Patch>,
    /// Checksums of parts of the old file, as they are with all patches undone.
    watched: Vec<Watched>,
}

/// An edit, ready to be made.
#[derive(Clone, Debug)]
pub struct Plan {
    pub old_length: u64,
    /// New values and directories, the record and the footer.
    pub appended: Vec<u8>,
    pub patches: Vec<Patch>,
}

impl Plan {
    /// Adds the undo record to what is appended. `directories` are (position, length) of the directories in the file.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn new(
        store: &dyn Store,
        mut appended: Vec<u8>,
        patches: Vec<Patch>,
        directories: &[(u64, u64)],
    ) -> io::Result<Plan> {
        let old_length = store.length()?;
        let head = (0, old_length.min(WATCHED_BYTES));
        let tail_length = (old_length - head.1).min(WATCHED_BYTES);
        let tail = (old_length - tail_length, tail_length);
        let later = directories.iter().filter(|d| d.0 + d.1 > head.1).take(WATCHED_DIRECTORIES).copied();
        let mut watched = Vec::new();
        for (at, length) in [head, tail].into_iter().chain(later) {
            if length > 0 && at + length <= old_length {
                watched.push(Watched { at, length, crc32: checksum_with_old(store, at, length, &patches)? });
            }
        }
        let record = Record {
            what: "undo record: cut the file to old_length bytes and put every patch's old bytes back".into(),
            program: format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
            old_length,
            record_at: old_length + appended.len() as u64,
            appended_crc32: libdeflater::crc32(&appended),
            patches: patches.clone(),
            watched,
        };
        let record = serde_json::to_vec(&record).expect("no map keys but strings, no failing serialiser");
        appended.extend_from_slice(&record);
        appended.extend_from_slice(&(record.len() as u64).to_le_bytes());
        appended.extend_from_slice(&libdeflater::crc32(&record).to_le_bytes());
        appended.extend_from_slice(&1u32.to_le_bytes());
        appended.extend_from_slice(MAGIC);
        Ok(Plan { old_length, appended, patches })
    }

    /// Makes the edit.
    ///
    /// # Errors
    /// When the system says no (a full disk, most likely); the file is as it was before then, as far as the system lets
    /// us.
    pub fn apply(&self, store: &mut dyn Store) -> io::Result<()> {
        if store.length()? != self.old_length {
            return Err(io::Error::other("another program has changed it meanwhile"));
        }
        let done = self.append_and_switch(store);
        if done.is_err() {
            // The first error is the one to report. Restoring what was never switched changes nothing.
            let _ = restore(store, self.old_length, &self.patches);
        }
        done
    }

    /// Takes the edit back, right after it was made.
    ///
    /// # Errors
    /// When the system says no.
    pub fn revert(&self, store: &mut dyn Store) -> io::Result<()> {
        restore(store, self.old_length, &self.patches)
    }

    fn append_and_switch(&self, store: &mut dyn Store) -> io::Result<()> {
        store.write_at(self.old_length, &self.appended)?;
        store.sync()?;
        for patch in &self.patches {
            store.write_at(patch.at, &patch.new)?;
            store.sync()?;
        }
        Ok(())
    }
}

/// Puts the old bytes back, and only when they are on disk cuts the file off.
fn restore(store: &mut dyn Store, old_length: u64, patches: &[Patch]) -> io::Result<()> {
    let mut current = Vec::new();
    for patch in patches.iter().rev() {
        current.resize(patch.old.len(), 0);
        store.read_at(patch.at, &mut current)?;
        if current != patch.old {
            store.write_at(patch.at, &patch.old)?;
            store.sync()?;
        }
    }
    store.set_length(old_length)?;
    store.sync()
}

/// What the undo record at the end of a file says, once everything it says has been checked.
///
/// # Errors
/// [`Error::Usage`] when there is none, or when another program has changed the file since; [`Error::Format`] when the
/// record contradicts itself; [`Error::Io`].
pub fn read(path: &Path, store: &dyn Store) -> Result<Record> {
    let io = |action: &str| {
        let action = action.to_string();
        move |e| Error::io(path, action, e)
    };
    let length = store.length().map_err(io("ask for its size"))?;
    let Some((size, crc)) = footer(store, length).map_err(io("read its end"))? else {
        return Err(no_record(path, store, length));
    };
    let broken = |what: &str| Error::format(path, "the undo record", what.to_string());
    if size > MAX_RECORD_BYTES || size + FOOTER_BYTES > length {
        return Err(broken("its length is impossible"));
    }
    let record_at = length - FOOTER_BYTES - size;
    let mut text = vec![0; size as usize];
    store.read_at(record_at, &mut text).map_err(io("read its undo record"))?;
    if libdeflater::crc32(&text) != crc {
        return Err(broken("its checksum is wrong"));
    }
    let record: Record = serde_json::from_slice(&text).map_err(|e| broken(&format!("it is no JSON of ours: {e}")))?;
    let sane = record.old_length <= record_at
        && record.patches.iter().all(|patch| {
            patch.old.len() == patch.new.len()
                && patch.at.checked_add(patch.old.len() as u64).is_some_and(|end| end <= record.old_length)
        })
        && record.watched.iter().all(|w| {
            w.length <= MAX_RECORD_BYTES && w.at.checked_add(w.length).is_some_and(|end| end <= record.old_length)
        });
    if !sane || record.record_at != record_at {
        return Err(changed(path, "bytes were added or taken away"));
    }
    if record_at - record.old_length > MAX_RECORD_BYTES {
        return Err(broken("it appended more than an edit does"));
    }
    let mut appended = vec![0; (record_at - record.old_length) as usize];
    store.read_at(record.old_length, &mut appended).map_err(io("read what was appended"))?;
    if libdeflater::crc32(&appended) != record.appended_crc32 {
        return Err(changed(path, "the directory with the tags is not what was written"));
    }
    for patch in &record.patches {
        let mut now = vec![0; patch.old.len()];
        store.read_at(patch.at, &mut now).map_err(io("read a patch"))?;
        if !patch.may_be(&now) {
            return Err(changed(path, &format!("{} bytes at {} point elsewhere", now.len(), patch.at)));
        }
    }
    for watched in &record.watched {
        let crc32 = checksum_with_old(store, watched.at, watched.length, &record.patches)
            .map_err(io("read what must be unchanged"))?;
        if crc32 != watched.crc32 {
            let place = format!("the {} bytes at {} are not what they were", watched.length, watched.at);
            return Err(changed(path, &place));
        }
    }
    Ok(record)
}

/// Restores the file of which `record` was read.
///
/// # Errors
/// When the system says no; the image is the new or the old one then, and the undoing can be repeated.
pub fn undo(store: &mut dyn Store, record: &Record) -> io::Result<()> {
    restore(store, record.old_length, &record.patches)
}

/// Takes back all edits of a file as it would be: their records, the last one first.
///
/// # Errors
/// As [`read`], for each of them.
pub fn undo_all(path: &Path, imagined: &mut Imagined<'_>) -> Result<Vec<Record>> {
    let io = |e| Error::io(path, "read", e);
    let mut all = Vec::new();
    loop {
        let record = read(path, imagined)?;
        undo(imagined, &record).map_err(io)?;
        let more_below = has_record(imagined, record.old_length).map_err(io)?;
        all.push(record);
        if !more_below {
            return Ok(all);
        }
    }
}

/// Whether a file that is `length` bytes long would end with an undo record.
///
/// # Errors
/// When it cannot be read.
pub fn has_record(store: &dyn Store, length: u64) -> io::Result<bool> {
    Ok(footer(store, length)?.is_some())
}

/// Length and checksum of the record, when a file of this length ends with one.
fn footer(store: &dyn Store, length: u64) -> io::Result<Option<(u64, u32)>> {
    if length < FOOTER_BYTES {
        return Ok(None);
    }
    let mut bytes = [0; FOOTER_BYTES as usize];
    store.read_at(length - FOOTER_BYTES, &mut bytes)?;
    if &bytes[16..] != MAGIC {
        return Ok(None);
    }
    let size = u64::from_le_bytes(bytes[..8].try_into().expect("eight bytes"));
    let crc = u32::from_le_bytes(bytes[8..12].try_into().expect("four bytes"));
    Ok(Some((size, crc)))
}

fn no_record(path: &Path, store: &dyn Store, length: u64) -> Error {
    let searched = length.min(SEARCHED_BYTES);
    let mut end = vec![0; searched as usize];
    let buried = store.read_at(length - searched, &mut end).is_ok()
        && end.windows(MAGIC.len()).any(|window| window == MAGIC.as_slice());
    if buried {
        return changed(path, "it has written behind the undo record");
    }
    Error::usage(
        format!("{}: there is nothing to undo: no undo record at the end of the file", path.display()),
        "only tags that --write tags has put into a file can be taken back",
    )
}

fn changed(path: &Path, how: &str) -> Error {
    Error::usage(
        format!("{}: another program has changed the file since its tags were written: {how}", path.display()),
        "nothing was undone; to be rid of the georeference, write another",
    )
}

/// CRC-32 of a part of the file as it is when all patches are undone.
fn checksum_with_old(store: &dyn Store, at: u64, length: u64, patches: &[Patch]) -> io::Result<u32> {
    let mut bytes = vec![0; length as usize];
    store.read_at(at, &mut bytes)?;
    for patch in patches {
        for (offset, &byte) in (patch.at..).zip(&patch.old) {
            if (at..at + length).contains(&offset) {
                bytes[(offset - at) as usize] = byte;
            }
        }
    }
    Ok(libdeflater::crc32(&bytes))
}

/// Bytes as hexadecimal text.
mod hex {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub fn serialize<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
        let text: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        serializer.serialize_str(&text)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
        let text = String::deserialize(deserializer)?;
        let digits: Option<Vec<u8>> = text.chars().map(|c| c.to_digit(16).map(|d| d as u8)).collect();
        let digits = digits.filter(|d| d.len() % 2 == 0).ok_or_else(|| D::Error::custom("no hexadecimal bytes"))?;
        Ok(digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect())
    }
}
