//! The header of LAS 1.0–1.5 and its variable length records (ASPRS, *LAS Specification 1.4 – R15*, 2019).

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::error::{Error, Result};
use crate::schema::array;

/// Bytes of a variable length record before its content.
pub(super) const VLR_HEADER_BYTES: usize = 54;
/// Bytes of one description of an extra dimension.
pub(super) const EXTRA_BYTES_RECORD: usize = 192;
/// No header reaches so far in practice; it bounds what is read for the variable length records.
const MOST_VLR_BYTES: u64 = 64 << 20;

/// A variable length record.
#[derive(Clone, Debug, PartialEq)]
pub struct Vlr {
    pub user_id: String,
    pub record_id: u16,
    /// 54 bytes as they stand in the file.
    pub header: Vec<u8>,
    pub content: Vec<u8>,
}

/// The parts of a LAS header that matter here; the rest stays in `raw`.
#[derive(Clone, Debug, PartialEq)]
pub struct LasHeader {
    /// The header's bytes, up to the first variable length record.
    pub raw: Vec<u8>,
    pub minor: u8,
    pub point_format: u8,
    pub compressed: bool,
    pub record_bytes: usize,
    pub points: u64,
    pub points_offset: u64,
    pub scale: [f64; 3],
    pub offset: [f64; 3],
    pub min: [f64; 3],
    pub max: [f64; 3],
    pub vlrs: Vec<Vlr>,
    /// What was passed over, in words.
    pub notes: Vec<String>,
    /// Extended records that are too large for what is written, in words.
    pub not_kept: Vec<String>,
}

/// Bytes of a record of each point format without extra bytes.
pub(super) const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

impl LasHeader {
    /// Where the points end at the latest: at the extended records or waveforms behind them, or with the file.
    pub(super) fn points_end(&self, file_bytes: u64) -> u64 {
        let behind = |at: usize, there: bool| {
            let begin = if there && self.raw.len() >= at + 8 { u64_at(&self.raw, at) } else { 0 };
            if begin >= self.points_offset { begin } else { u64::MAX }
        };
        let waveforms = behind(227, self.minor >= 3 && self.raw.len() >= 235);
        let extended = behind(235, self.minor >= 4 && self.raw.len() >= 247 && u32_at(&self.raw, 243) > 0);
        file_bytes.min(waveforms).min(extended)
    }

    /// Reads header and variable length records.
    ///
    /// # Errors
    /// What no reader could make sense of. A wrong number of variable length records is passed over with a note.
    pub fn read(path: &Path, file: &mut (impl Read + Seek), file_bytes: u64) -> Result<LasHeader> {
        let bad = |place: &str, what: String| Error::format(path, format!("LAS header, {place}"), what);
        let mut raw = vec![0; 227];
        file.read_exact(&mut raw).map_err(|_| bad("begin", format!("{file_bytes} bytes are no whole header")))?;
        let (major, minor) = (raw[24], raw[25]);
        if major != 1 || minor > 5 {
            let what = format!("LAS {major}.{minor}");
            return Err(match major {
                1 => Error::unsupported(path, what, "convert it to LAS 1.4 first"),
                _ => bad("version", format!("{what} does not exist: the header is damaged")),
            });
        }
        let size = usize::from(u16_at(&raw, 94));
        let least = if minor >= 4 { 375 } else { 227 };
        if size < least || size as u64 > file_bytes {
            return Err(bad("byte 94", format!("a header of {size} bytes")));
        }
        raw.resize(size, 0);
        file.read_exact(&mut raw[227..]).map_err(|e| Error::io(path, "read the LAS header", e))?;

        let format_byte = raw[104];
        let (compressed, point_format) = (format_byte & 0xc0 != 0, format_byte & 0x3f);
        let record_bytes = usize::from(u16_at(&raw, 105));
        let Some(&least) = RECORD_BYTES.get(usize::from(point_format)) else {
            return Err(bad("byte 104", format!("point format {point_format} does not exist")));
        };
        if record_bytes < least {
            let what = format!("records of {record_bytes} bytes, point format {point_format} needs {least}");
            return Err(bad("byte 105", what));
        }
        let mut points = u64::from(u32_at(&raw, 107));
        if minor >= 4 {
            points = match u64_at(&raw, 247) {
                0 => points,
                count => count,
            };
        }
        let scale = triple(&raw, 131);
        let offset = triple(&raw, 155);
        for axis in 0..3 {
            let name = ["x", "y", "z"][axis];
            if !scale[axis].is_finite() || scale[axis] == 0.0 {
                return Err(bad("byte 131", format!("the scale factor of {name} is {}", scale[axis])));
            }
            if !offset[axis].is_finite() {
                return Err(bad("byte 155", format!("the offset of {name} is {}", offset[axis])));
            }
        }
        let bounds: Vec<f64> = (0..6).map(|i| f64_at(&raw, 179 + 8 * i)).collect();
        let points_offset = u64::from(u32_at(&raw, 96));
        if points_offset < size as u64 || points_offset > file_bytes {
            let what = format!("points begin at byte {points_offset}, the file has {file_bytes} bytes");
            return Err(bad("byte 96", what));
        }
        let mut header = LasHeader {
            minor,
            point_format,
            compressed,
            record_bytes,
            points,
            points_offset,
            scale,
            offset,
            max: [bounds[0], bounds[2], bounds[4]],
            min: [bounds[1], bounds[3], bounds[5]],
            vlrs: Vec::new(),
            notes: Vec::new(),
            not_kept: Vec::new(),
            raw,
        };
        header.read_vlrs(path, file)?;
        if minor >= 4 {
            header.read_records_behind(file, file_bytes);
        }
        header.leave_1_5(path)?;
        Ok(header)
    }

    /// LAS 1.5 has the header of 1.4, times of the first and last point, and what GPS times count from behind it.
    fn leave_1_5(&mut self, path: &Path) -> Result<()> {
        /// Times have an offset of their own, in millions of seconds; bit 0 means one of 1000.
        const OWN_OFFSET: u8 = 0x40;
        if self.minor < 5 {
            return Ok(());
        }
        if self.raw[6] & OWN_OFFSET != 0 {
            let offset = self.raw.get(391..393).map_or(0, |bytes| i16::from_le_bytes(array(bytes)));
            if offset != 1000 {
                let what = format!("GPS times that count from {offset} million seconds");
                return Err(Error::unsupported(path, what, "convert it to LAS 1.4 first"));
            }
            self.raw[6] = self.raw[6] & !OWN_OFFSET | 1;
        }
        self.notes.push("LAS 1.5 is read and written as LAS 1.4".into());
        self.minor = 4;
        self.raw[25] = 4;
        self.raw.truncate(375);
        self.raw[94..96].copy_from_slice(&375u16.to_le_bytes());
        Ok(())
    }

    /// The records between header and points, as many as there really are.
    fn read_vlrs(&mut self, path: &Path, file: &mut impl Read) -> Result<()> {
        let stated = u32_at(&self.raw, 100);
        let mut left = self.points_offset - self.raw.len() as u64;
        if left > MOST_VLR_BYTES {
            return Err(Error::format(path, "LAS header, byte 96", format!("{left} bytes between header and points")));
        }
        let mut read = 0;
        while read < stated && left >= VLR_HEADER_BYTES as u64 {
            let mut header = vec![0; VLR_HEADER_BYTES];
            file.read_exact(&mut header).map_err(|e| Error::io(path, "read a variable length record", e))?;
            left -= VLR_HEADER_BYTES as u64;
            let bytes = u64::from(u16_at(&header, 20));
            if bytes > left {
                break;
            }
            let mut content = vec![0; bytes as usize];
            file.read_exact(&mut content).map_err(|e| Error::io(path, "read a variable length record", e))?;
            left -= bytes;
            self.vlrs.push(Vlr { user_id: text_of(&header[2..18]), record_id: u16_at(&header, 18), header, content });
            read += 1;
        }
        if read < stated {
            self.notes.push(format!("the header counts {stated} variable length records, {read} are there"));
        }
        Ok(())
    }

    /// Takes the extended records behind the points that an ordinary record can hold; what cannot be read is passed
    /// over, and what is too large is told.
    fn read_records_behind(&mut self, file: &mut (impl Read + Seek), file_bytes: u64) {
        /// Of all of them together.
        const MOST_BYTES: u64 = 16 << 20;
        let mut left = MOST_BYTES;
        let (mut at, count) = (u64_at(&self.raw, 235), u32_at(&self.raw, 243));
        for _ in 0..count.min(1000) {
            let mut header = [0; 60];
            let inside = at >= 375 && at.checked_add(60).is_some_and(|end| end <= file_bytes);
            if !inside || file.seek(SeekFrom::Start(at)).is_err() || file.read_exact(&mut header).is_err() {
                return;
            }
            let bytes = u64_at(&header, 20);
            let Some(end) = (at + 60).checked_add(bytes).filter(|&end| end <= file_bytes) else { return };
            let (user_id, record_id) = (text_of(&header[2..18]), u16_at(&header, 18));
            // The hierarchy of COPC and waveforms belong to this file.
            let is_own = user_id == "copc" || (user_id == "LASF_Spec" && record_id == 65_535);
            if !is_own && bytes > left.min(65_535) {
                self.not_kept.push(format!("the extended record `{user_id}` {record_id} of {bytes} bytes is not kept"));
            } else if !is_own {
                left -= bytes;
                let mut content = vec![0; bytes as usize];
                if file.read_exact(&mut content).is_err() {
                    return;
                }
                let mut short = header[..20].to_vec();
                short.extend_from_slice(&(bytes as u16).to_le_bytes());
                short.extend_from_slice(&header[28..60]);
                self.vlrs.push(Vlr { user_id, record_id, header: short, content });
            }
            at = end;
        }
    }

    /// The record of a user and number.
    pub fn vlr(&self, user_id: &str, record_id: u16) -> Option<&Vlr> {
        self.vlrs.iter().find(|vlr| vlr.user_id == user_id && vlr.record_id == record_id)
    }
}

/// Text up to the first zero byte.
pub(super) fn text_of(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).trim().to_string()
}

pub(super) fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(array(&bytes[at..]))
}
pub(super) fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(array(&bytes[at..]))
}
pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(array(&bytes[at..]))
}
pub(super) fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(array(&bytes[at..]))
}
fn triple(bytes: &[u8], at: usize) -> [f64; 3] {
    [f64_at(bytes, at), f64_at(bytes, at + 8), f64_at(bytes, at + 16)]
}
