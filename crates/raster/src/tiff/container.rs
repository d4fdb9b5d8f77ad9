//! The container: header, directories and tag values of TIFF (revision 6.0, Adobe 1992) and BigTIFF (2007).
//!
//! Nothing here trusts the file: every position and count is checked against the file's length before anything is
//! allocated, and directories that form a circle end the walk.

use std::collections::HashSet;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crate::chunked::retile_remedy;
use crate::error::{Error, Result};
use crate::words::counted;

/// Tags that the reader looks at.
pub mod tag {
    pub const NEW_SUBFILE_TYPE: u16 = 254;
    pub const SUBFILE_TYPE: u16 = 255;
    pub const IMAGE_WIDTH: u16 = 256;
    pub const IMAGE_LENGTH: u16 = 257;
    pub const BITS_PER_SAMPLE: u16 = 258;
    pub const COMPRESSION: u16 = 259;
    pub const PHOTOMETRIC: u16 = 262;
    pub const FILL_ORDER: u16 = 266;
    pub const STRIP_OFFSETS: u16 = 273;
    pub const SAMPLES_PER_PIXEL: u16 = 277;
    pub const ROWS_PER_STRIP: u16 = 278;
    pub const STRIP_BYTE_COUNTS: u16 = 279;
    pub const MAX_SAMPLE_VALUE: u16 = 281;
    pub const PLANAR_CONFIGURATION: u16 = 284;
    pub const PREDICTOR: u16 = 317;
    pub const TILE_WIDTH: u16 = 322;
    pub const TILE_LENGTH: u16 = 323;
    pub const TILE_OFFSETS: u16 = 324;
    pub const TILE_BYTE_COUNTS: u16 = 325;
    pub const EXTRA_SAMPLES: u16 = 338;
    pub const SAMPLE_FORMAT: u16 = 339;
    pub const JPEG_TABLES: u16 = 347;
    pub const GDAL_METADATA: u16 = 42112;
    pub const GDAL_NODATA: u16 = 42113;
}

/// More directories than this are no image file.
const MAX_DIRECTORIES: usize = 65_536;
/// More values than this in one tag would take over half a gigabyte: 67 million blocks.
pub const MAX_VALUES: u64 = 1 << 26;

/// One tag of a directory: where its values lie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    pub tag: u16,
    /// Field type as the file numbers them (3 is SHORT).
    pub kind: u16,
    pub count: u64,
    /// Position of the first value in the file, be it in the entry itself or elsewhere.
    pub position: u64,
    /// Position of the entry itself.
    pub entry_position: u64,
}

impl Entry {
    /// Bytes of one value; `None` for a type that does not exist.
    pub fn value_bytes(&self) -> Option<u64> {
        Some(match self.kind {
            1 | 2 | 6 | 7 => 1,
            3 | 8 => 2,
            4 | 9 | 11 | 13 => 4,
            5 | 10 | 12 | 16 | 17 | 18 => 8,
            _ => return None,
        })
    }
}

/// One image file directory.
#[derive(Clone, Debug)]
pub struct Directory {
    pub position: u64,
    pub entries: Vec<Entry>,
}

/// Byte order of a file's numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    Little,
    Big,
}

impl ByteOrder {
    /// The unsigned number that up to eight bytes stand for.
    pub fn number(self, bytes: &[u8]) -> u64 {
        let fold = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
        match self {
            ByteOrder::Little => bytes.iter().rev().fold(0, fold),
            ByteOrder::Big => bytes.iter().fold(0, fold),
        }
    }

    /// Whether it is this machine's.
    pub fn is_native(self) -> bool {
        (self == ByteOrder::Little) == cfg!(target_endian = "little")
    }
}

/// An open file and all its directories.
#[derive(Clone, Debug)]
pub struct Directories {
    pub path: PathBuf,
    pub file: Arc<File>,
    pub len: u64,
    pub order: ByteOrder,
    pub big: bool,
    pub list: Vec<Directory>,
    /// Why the walk ended before its regular end.
    pub broken_tail: Option<String>,
}

/// Whether the file begins as a TIFF or BigTIFF.
///
/// # Errors
/// When it cannot be read.
pub fn is_tiff(path: &Path) -> Result<bool> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let mut head = [0; 4];
    match file.read_exact_at(&mut head, 0) {
        Ok(()) => Ok(matches!(&head, b"II*\0" | b"MM\0*" | b"II+\0" | b"MM\0+")),
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        Err(e) => Err(Error::io(path, "read its first bytes", e)),
    }
}

impl Directories {
    /// Reads the header and walks the directories.
    ///
    /// # Errors
    /// When the header or the first directory is broken. A broken later directory ends the walk and is kept as
    /// `broken_tail`.
    pub fn read(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
        let len = file.metadata().map_err(|e| Error::io(path, "ask for its size", e))?.len();
        let (file, path) = (Arc::new(file), path.to_path_buf());
        let (order, big, list) = (ByteOrder::Little, false, Vec::new());
        let mut all = Directories { path, file, len, order, big, list, broken_tail: None };
        let mut next = all.read_header()?;
        let mut seen = HashSet::new();
        while next != 0 {
            if !seen.insert(next) {
                all.broken_tail = Some(format!("the directories form a circle at byte {next}"));
                break;
            }
            if all.list.len() == MAX_DIRECTORIES {
                all.broken_tail = Some(format!("more than {MAX_DIRECTORIES} directories"));
                break;
            }
            match all.read_directory(next) {
                Ok((directory, following)) => {
                    all.list.push(directory);
                    next = following;
                }
                Err(error) if all.list.is_empty() => return Err(error),
                Err(error) => {
                    all.broken_tail = Some(error.to_string());
                    break;
                }
            }
        }
        if all.list.is_empty() {
            return Err(all.format("header", "there is no directory, so no image"));
        }
        if let Some(what) = &all.broken_tail {
            tracing::debug!("{}: {what}", all.path.display());
        }
        Ok(all)
    }

    fn format(&self, place: impl Into<String>, what: impl Into<String>) -> Error {
        Error::format(&self.path, place, what)
    }

    /// `length` bytes at `position`, which may lie anywhere.
    fn bytes(&self, position: u64, length: u64, place: &str) -> Result<Vec<u8>> {
        if position.checked_add(length).is_none_or(|end| end > self.len) {
            let what = format!("{length} bytes at {position} lie beyond the end of the file ({} bytes)", self.len);
            return Err(self.format(place, what));
        }
        let mut bytes = vec![0; length as usize];
        self.file
            .read_exact_at(&mut bytes, position)
            .map_err(|e| Error::io(&self.path, format!("read {length} bytes at {position}"), e))?;
        Ok(bytes)
    }

    /// Position of the first directory.
    fn read_header(&mut self) -> Result<u64> {
        let head = self.bytes(0, self.len.min(16), "header")?;
        if head.len() < 8 {
            return Err(self.format("header", format!("the file ends after {} bytes", head.len())));
        }
        self.order = match &head[..2] {
            b"II" => ByteOrder::Little,
            b"MM" => ByteOrder::Big,
            _ => return Err(self.format("header", "it does not begin with II or MM")),
        };
        match self.order.number(&head[2..4]) {
            42 => Ok(self.order.number(&head[4..8])),
            43 if head.len() == 16 && self.order.number(&head[4..6]) == 8 => {
                self.big = true;
                Ok(self.order.number(&head[8..16]))
            }
            43 => Err(self.format("header", "the BigTIFF header is cut off or its offsets are not of 8 bytes")),
            other => Err(self.format("header", format!("the version number is {other}, not 42 or 43"))),
        }
    }

    fn read_directory(&self, position: u64) -> Result<(Directory, u64)> {
        let place = format!("directory {}", self.list.len());
        let (count_bytes, entry_bytes, offset_bytes) = if self.big { (8, 20, 8) } else { (2, 12, 4) };
        let count = self.order.number(&self.bytes(position, count_bytes, &place)?);
        // A directory has one entry for each tag, and there are 65536 tags.
        if count == 0 || count > 65_536 {
            return Err(self.format(&place, format!("it claims {count} entries")));
        }
        let start = position + count_bytes;
        let table = self.bytes(start, count * entry_bytes, &place)?;
        let half = offset_bytes as usize;
        let mut entries = Vec::with_capacity(count as usize);
        for (index, raw) in table.chunks_exact(entry_bytes as usize).enumerate() {
            let entry_position = start + index as u64 * entry_bytes;
            let mut entry = Entry {
                tag: self.order.number(&raw[..2]) as u16,
                kind: self.order.number(&raw[2..4]) as u16,
                count: self.order.number(&raw[4..4 + half]),
                position: entry_position + 4 + offset_bytes,
                entry_position,
            };
            let inline =
                entry.value_bytes().and_then(|size| size.checked_mul(entry.count)).is_some_and(|b| b <= offset_bytes);
            if !inline {
                entry.position = self.order.number(&raw[4 + half..4 + 2 * half]);
            }
            entries.push(entry);
        }
        // A file that was cut off right here has no further directory.
        let next = match self.bytes(start + count * entry_bytes, offset_bytes, &place) {
            Ok(next) => self.order.number(&next),
            Err(_) => 0,
        };
        Ok((Directory { position, entries }, next))
    }

    /// The directory of the `page`-th full-resolution image: masks and overviews do not count. A file that has nothing
    /// else (a lone overview) counts with what it has.
    ///
    /// # Errors
    /// When there are not that many.
    pub fn page(&self, page: usize) -> Result<usize> {
        let mut full: Vec<usize> = Vec::new();
        for index in 0..self.list.len() {
            if self.role(index)? == Role::Image {
                full.push(index);
            }
        }
        if full.is_empty() {
            full.push(0);
        }
        full.get(page).copied().ok_or_else(|| {
            let broken = self.broken_tail.as_ref().map_or(String::new(), |what| format!(" ({what})"));
            Error::usage(
                format!(
                    "{}: there is no page {page}: the file has {}{broken}",
                    self.path.display(),
                    counted(full.len(), "image", "images")
                ),
                format!("give --page 0 to {}", full.len() - 1),
            )
        })
    }

    /// What a directory is for.
    ///
    /// # Errors
    /// When its subfile tags cannot be read.
    pub fn role(&self, index: usize) -> Result<Role> {
        let kind = self.first(index, tag::NEW_SUBFILE_TYPE)?.unwrap_or(0);
        let old = self.first(index, tag::SUBFILE_TYPE)?.unwrap_or(1);
        Ok(match (kind & 4 != 0, kind & 1 != 0 || old == 2) {
            (true, false) => Role::Mask,
            (true, true) => Role::MaskOverview,
            (false, true) => Role::Overview,
            (false, false) => Role::Image,
        })
    }

    /// The mask that belongs to the image of directory `index`: it follows before the next image.
    ///
    /// # Errors
    /// When a directory cannot be read.
    pub fn mask_of(&self, index: usize) -> Result<Option<usize>> {
        for later in index + 1..self.list.len() {
            match self.role(later)? {
                Role::Mask => return Ok(Some(later)),
                Role::Image => break,
                Role::Overview | Role::MaskOverview => {}
            }
        }
        Ok(None)
    }

    /// The entry of a tag in directory `index`, counted from 0.
    pub fn entry(&self, index: usize, tag: u16) -> Option<&Entry> {
        self.list[index].entries.iter().find(|entry| entry.tag == tag)
    }

    /// The raw bytes of a tag's values; `None` when the tag is absent.
    ///
    /// # Errors
    /// When they do not lie in the file, or the type does not exist.
    pub fn raw(&self, index: usize, tag: u16) -> Result<Option<(Entry, Vec<u8>)>> {
        let Some(&entry) = self.entry(index, tag) else { return Ok(None) };
        let place = format!("directory {index}, tag {tag}");
        let Some(size) = entry.value_bytes() else {
            return Err(self.format(place, format!("its type {} does not exist", entry.kind)));
        };
        if entry.count > MAX_VALUES {
            return Err(Error::Limit {
                what: format!("{}: {place} has {} values", self.path.display(), entry.count),
                needed: entry.count.saturating_mul(8),
                allowed: MAX_VALUES * 8,
                remedy: retile_remedy(&self.path),
            });
        }
        Ok(Some((entry, self.bytes(entry.position, size * entry.count, &place)?)))
    }

    /// Unsigned whole numbers of a tag.
    ///
    /// # Errors
    /// When they do not lie in the file or are of another type.
    pub fn numbers(&self, index: usize, tag: u16) -> Result<Option<Vec<u64>>> {
        let Some((entry, raw)) = self.raw(index, tag)? else { return Ok(None) };
        if !matches!(entry.kind, 1 | 3 | 4 | 7 | 13 | 16 | 18) {
            let what = format!("its type is {}, not an unsigned number", entry.kind);
            return Err(self.format(format!("directory {index}, tag {tag}"), what));
        }
        let size = entry.value_bytes().expect("raw() has checked the type") as usize;
        Ok(Some(raw.chunks_exact(size).map(|value| self.order.number(value)).collect()))
    }

    /// The first number of a tag.
    ///
    /// # Errors
    /// Those of [`Directories::numbers`].
    pub fn first(&self, index: usize, tag: u16) -> Result<Option<u64>> {
        Ok(self.numbers(index, tag)?.and_then(|values| values.first().copied()))
    }

    /// The text of a tag, up to its first zero byte.
    ///
    /// # Errors
    /// When it does not lie in the file.
    pub fn text(&self, index: usize, tag: u16) -> Result<Option<String>> {
        let Some((_, raw)) = self.raw(index, tag)? else { return Ok(None) };
        let end = raw.iter().position(|&byte| byte == 0).unwrap_or(raw.len());
        Ok(Some(String::from_utf8_lossy(&raw[..end]).trim().to_owned()))
    }
}

/// What a directory is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    Image,
    Overview,
    Mask,
    MaskOverview,
}
