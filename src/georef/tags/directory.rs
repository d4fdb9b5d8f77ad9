//! A new directory with new geographic tags, behind the end of the file.

use std::os::unix::fs::FileExt;

use super::journal::Patch;
use super::keys::{GEO_TAGS, GeoTag, Values};
use autoref_raster::error::{Error, Result};
use autoref_raster::tiff::container::{ByteOrder, Directories};

/// A disk sector: what lies in one is written whole or not at all.
const SECTOR_BYTES: u64 = 512;

/// What is appended, what is switched, and where the directories lie.
pub struct Rebuilt {
    pub appended: Vec<u8>,
    pub pointer: Patch,
    /// (position, length) of every directory in the file.
    pub directories: Vec<(u64, u64)>,
}

/// Sizes that differ between TIFF and BigTIFF.
#[derive(Clone, Copy)]
pub struct Shape {
    count_bytes: u64,
    pub entry_bytes: u64,
    offset_bytes: u64,
}

impl Shape {
    pub const CLASSIC: Shape = Shape { count_bytes: 2, entry_bytes: 12, offset_bytes: 4 };
    const BIG: Shape = Shape { count_bytes: 8, entry_bytes: 20, offset_bytes: 8 };

    fn of(big: bool) -> Self {
        if big { Self::BIG } else { Self::CLASSIC }
    }

    fn directory_bytes(self, entries: usize) -> u64 {
        self.count_bytes + entries as u64 * self.entry_bytes + self.offset_bytes
    }
}

/// Copies directory `index` behind the end of the file, with `tags` instead of its geographic ones. What the other
/// entries point to stays where it is, and so does the next directory.
///
/// The pointer that is switched must lie in one disk sector. When that of a later page does not, the directory that
/// holds it is copied as well, and so on back to the header, whose pointer is aligned.
///
/// # Errors
/// [`Error::Limit`] when a classic TIFF would grow beyond 4 GiB; [`Error::Io`].
pub fn rebuild(file: &Directories, index: usize, tags: &[GeoTag]) -> Result<Rebuilt> {
    let shape = Shape::of(file.big);
    let mut first = index;
    while !in_one_sector(pointer_at(file, shape, first), shape.offset_bytes) {
        first -= 1;
    }
    let mut out = Appender::new(file.order, shape, file.len);
    out.align();
    let geo: Vec<Vec<u8>> = tags.iter().map(|tag| out.entry(tag)).collect();
    let mut tables = Vec::new();
    for directory in first..=index {
        let mut entries = raw_entries(file, shape, directory)?;
        if directory == index {
            entries.retain(|(tag, _)| !GEO_TAGS.contains(tag));
            entries.extend(tags.iter().map(|tag| tag.tag).zip(geo.iter().cloned()));
            // Stable, so that a file with a tag twice keeps their order.
            entries.sort_by_key(|(tag, _)| *tag);
        }
        tables.push(entries);
    }
    let after = next_of(file, shape, index)?;
    out.align();
    let start = out.position();
    let mut position = start;
    for (number, entries) in tables.iter().enumerate() {
        let end = (position + shape.directory_bytes(entries.len())).next_multiple_of(8);
        let next = if number + 1 == tables.len() { after } else { end };
        out.directory(entries, next);
        out.align();
        position = end;
    }
    let new_length = out.position();
    // The undo record comes on top: a kilobyte or two.
    if !file.big && new_length + 65_536 > u64::from(u32::MAX) {
        return Err(Error::Limit {
            what: format!("{}: tags in place would make this classic TIFF longer than 4 GiB", file.path.display()),
            needed: new_length + 65_536,
            allowed: u64::from(u32::MAX),
            remedy: "use --write aux, or make a BigTIFF of it: gdal_translate -co BIGTIFF=YES".into(),
        });
    }
    let at = pointer_at(file, shape, first);
    let number = |value: u64| offset_bytes(file.order, shape, value);
    let pointer = Patch { at, old: number(file.list[first].position), new: number(start) };
    let directories = file.list.iter().map(|d| (d.position, shape.directory_bytes(d.entries.len()))).collect();
    Ok(Rebuilt { appended: out.bytes, pointer, directories })
}

/// Where the position of directory `index` is written.
fn pointer_at(file: &Directories, shape: Shape, index: usize) -> u64 {
    match index.checked_sub(1) {
        None => shape.offset_bytes,
        Some(before) => {
            let before = &file.list[before];
            before.position + shape.directory_bytes(before.entries.len()) - shape.offset_bytes
        }
    }
}

fn in_one_sector(at: u64, length: u64) -> bool {
    at / SECTOR_BYTES == (at + length - 1) / SECTOR_BYTES
}

fn raw_entries(file: &Directories, shape: Shape, index: usize) -> Result<Vec<(u16, Vec<u8>)>> {
    let directory = &file.list[index];
    let mut table = vec![0; directory.entries.len() * shape.entry_bytes as usize];
    let at = directory.position + shape.count_bytes;
    file.file
        .read_exact_at(&mut table, at)
        .map_err(|e| Error::io(&file.path, format!("read directory {index} at {at}"), e))?;
    let rows = table.chunks_exact(shape.entry_bytes as usize);
    Ok(directory.entries.iter().map(|entry| entry.tag).zip(rows.map(<[u8]>::to_vec)).collect())
}

/// Position of the directory after `index`; 0 when there is none, or the file is cut off right there.
fn next_of(file: &Directories, shape: Shape, index: usize) -> Result<u64> {
    let directory = &file.list[index];
    let at = directory.position + shape.directory_bytes(directory.entries.len()) - shape.offset_bytes;
    if at + shape.offset_bytes > file.len {
        return Ok(0);
    }
    let mut bytes = vec![0; shape.offset_bytes as usize];
    file.file
        .read_exact_at(&mut bytes, at)
        .map_err(|e| Error::io(&file.path, format!("read directory {index}'s end at {at}"), e))?;
    Ok(file.order.number(&bytes))
}

fn offset_bytes(order: ByteOrder, shape: Shape, value: u64) -> Vec<u8> {
    ordered(order, value, shape.offset_bytes as usize)
}

/// The low `length` bytes of a number in a byte order.
pub fn ordered(order: ByteOrder, value: u64, length: usize) -> Vec<u8> {
    match order {
        ByteOrder::Little => value.to_le_bytes()[..length].to_vec(),
        ByteOrder::Big => value.to_be_bytes()[8 - length..].to_vec(),
    }
}

/// Bytes that will lie behind the end of the file.
pub struct Appender {
    order: ByteOrder,
    shape: Shape,
    start: u64,
    pub bytes: Vec<u8>,
}

impl Appender {
    /// For a file that is `start` bytes long.
    pub fn new(order: ByteOrder, shape: Shape, start: u64) -> Self {
        Appender { order, shape, start, bytes: Vec::new() }
    }

    /// Where the next byte goes, from the start of the file.
    pub fn position(&self) -> u64 {
        self.start + self.bytes.len() as u64
    }

    /// Fills up with zeros to a multiple of eight bytes.
    pub fn align(&mut self) {
        while !self.position().is_multiple_of(8) {
            self.bytes.push(0);
        }
    }

    /// The entry of a tag; values that do not fit into it are appended.
    pub fn entry(&mut self, tag: &GeoTag) -> Vec<u8> {
        let number = |value: u64, length| ordered(self.order, value, length);
        let (kind, count, mut raw): (u64, usize, Vec<u8>) = match &tag.values {
            Values::Shorts(values) => (3, values.len(), values.iter().flat_map(|&v| number(u64::from(v), 2)).collect()),
            Values::Doubles(values) => (12, values.len(), values.iter().flat_map(|v| number(v.to_bits(), 8)).collect()),
            Values::Ascii(values) => (2, values.len(), values.clone()),
            Values::Bytes(values) => (1, values.len(), values.clone()),
            Values::Longs(values) => (4, values.len(), values.iter().flat_map(|&v| number(u64::from(v), 4)).collect()),
            Values::Rationals(values) => {
                (5, values.len(), values.as_flattened().iter().flat_map(|&v| number(u64::from(v), 4)).collect())
            }
        };
        let offset_bytes = self.shape.offset_bytes as usize;
        let mut entry = number(u64::from(tag.tag), 2);
        entry.extend(number(kind, 2));
        entry.extend(number(count as u64, offset_bytes));
        if raw.len() <= offset_bytes {
            raw.resize(offset_bytes, 0);
            entry.extend(raw);
        } else {
            self.align();
            entry.extend(ordered(self.order, self.position(), offset_bytes));
            self.bytes.extend(raw);
        }
        entry
    }

    /// A directory of these entries, in order of their tags, with the position of the one after it (0: none).
    pub fn directory(&mut self, entries: &[(u16, Vec<u8>)], next: u64) {
        let count = ordered(self.order, entries.len() as u64, self.shape.count_bytes as usize);
        self.bytes.extend(count);
        for (_, entry) in entries {
            self.bytes.extend(entry);
        }
        self.bytes.extend(offset_bytes(self.order, self.shape, next));
    }
}
