//! The header of LAS 1.0–1.4 and its variable length records (ASPRS, *LAS Specification 1.4 – R15*, 2019).

use std::io::{Read, Seek, SeekFrom};
use std::path::Path;

use crate::error::{Error, Result};
use crate::schema::{Field, Kind, Schema, array};

/// Bytes of a variable length record before its content.
pub(super) const VLR_HEADER_BYTES: usize = 54;
/// Bytes of one description of an extra dimension.
const EXTRA_BYTES_RECORD: usize = 192;
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
}

/// Bytes of a record of each point format without extra bytes.
pub(super) const RECORD_BYTES: [usize; 11] = [20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67];

impl LasHeader {
    /// Reads header and variable length records.
    ///
    /// # Errors
    /// What no reader could make sense of. A wrong number of variable length records is passed over with a note.
    pub fn read(path: &Path, file: &mut (impl Read + Seek), file_bytes: u64) -> Result<LasHeader> {
        let bad = |place: &str, what: String| Error::format(path, format!("LAS header, {place}"), what);
        let mut raw = vec![0; 227];
        file.read_exact(&mut raw).map_err(|_| bad("begin", format!("{file_bytes} bytes are no whole header")))?;
        let (major, minor) = (raw[24], raw[25]);
        if major != 1 || minor > 4 {
            return Err(Error::unsupported(path, format!("LAS {major}.{minor}"), "convert it to LAS 1.4 first"));
        }
        let size = usize::from(u16_at(&raw, 94));
        let least = if minor == 4 { 375 } else { 227 };
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
        if minor == 4 {
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
            raw,
        };
        header.read_vlrs(path, file)?;
        if minor == 4 {
            header.read_records_behind(file, file_bytes);
        }
        Ok(header)
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
                self.notes.push(format!("the extended record `{user_id}` {record_id} of {bytes} bytes is not kept"));
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

    /// WKT, or `EPSG:n` from the GeoTIFF keys.
    pub fn crs(&self) -> Option<String> {
        let wkt = self.vlr("LASF_Projection", 2112).map(|vlr| text_of(&vlr.content));
        // Some programs write a pair of quotation marks for none.
        let wkt = wkt.filter(|text| text.contains(|letter: char| letter.is_ascii_alphanumeric()));
        wkt.or_else(|| {
            let keys = &self.vlr("LASF_Projection", 34_735)?.content;
            let code = |wanted: u16| {
                keys.chunks_exact(8).skip(1).find_map(|key| {
                    let (id, location, value) = (u16_at(key, 0), u16_at(key, 2), u16_at(key, 6));
                    (id == wanted && location == 0 && value > 1000 && value < 32_767).then_some(value)
                })
            };
            // ProjectedCSTypeGeoKey, else GeographicTypeGeoKey.
            code(3072).or_else(|| code(2048)).map(|code| format!("EPSG:{code}"))
        })
    }

    /// The fields of the point format and the described extra bytes.
    pub fn schema(&self) -> Schema {
        let mut fields = vec![Field::plain("intensity", Kind::U16, 12)];
        let packed = |name, offset, right, mask| Field::packed(name, Kind::U8, offset, right, mask);
        if self.point_format < 6 {
            fields.extend([
                packed("return_number", 14, 0, 7),
                packed("number_of_returns", 14, 3, 7),
                packed("scan_direction_flag", 14, 6, 1),
                packed("edge_of_flight_line", 14, 7, 1),
                packed("classification", 15, 0, 31),
                packed("synthetic", 15, 5, 1),
                packed("key_point", 15, 6, 1),
                packed("withheld", 15, 7, 1),
                Field::plain("scan_angle_rank", Kind::I8, 16),
                Field::plain("user_data", Kind::U8, 17),
                Field::plain("point_source_id", Kind::U16, 18),
            ]);
        } else {
            fields.extend([
                packed("return_number", 14, 0, 15),
                packed("number_of_returns", 14, 4, 15),
                packed("synthetic", 15, 0, 1),
                packed("key_point", 15, 1, 1),
                packed("withheld", 15, 2, 1),
                packed("overlap", 15, 3, 1),
                packed("scanner_channel", 15, 4, 3),
                packed("scan_direction_flag", 15, 6, 1),
                packed("edge_of_flight_line", 15, 7, 1),
                Field::plain("classification", Kind::U8, 16),
                Field::plain("user_data", Kind::U8, 17),
                Field { scale: 0.006, ..Field::plain("scan_angle", Kind::I16, 18) },
                Field::plain("point_source_id", Kind::U16, 20),
            ]);
        }
        let (time, colour) = match self.point_format {
            1 | 4 => (Some(20), None),
            2 => (None, Some(20)),
            3 | 5 => (Some(20), Some(28)),
            6 | 9 => (Some(22), None),
            7 | 8 | 10 => (Some(22), Some(30)),
            _ => (None, None),
        };
        fields.extend(time.map(|offset| Field::plain("gps_time", Kind::F64, offset)));
        if let Some(offset) = colour {
            for (index, name) in ["red", "green", "blue"].into_iter().enumerate() {
                fields.push(Field::plain(name, Kind::U16, offset + 2 * index));
            }
        }
        if matches!(self.point_format, 8 | 10) {
            fields.push(Field::plain("nir", Kind::U16, 36));
        }
        self.extra_fields(&mut fields);
        Schema { fields, stride: self.record_bytes }
    }

    fn extra_fields(&self, fields: &mut Vec<Field>) {
        let Some(vlr) = self.vlr("LASF_Spec", 4) else { return };
        let mut offset = RECORD_BYTES[usize::from(self.point_format)];
        for description in vlr.content.chunks_exact(EXTRA_BYTES_RECORD) {
            let (code, options) = (description[2], description[3]);
            let name = text_of(&description[4..36]).to_ascii_lowercase();
            let Some(kind) = Kind::from_las_code(code) else {
                // Undescribed bytes, and the deprecated pairs and triples.
                let bytes = match code {
                    0 => usize::from(options),
                    11..=30 => {
                        let one = Kind::from_las_code((code - 1) % 10 + 1).map_or(0, Kind::size);
                        one * usize::from((code - 1) / 10 + 1)
                    }
                    _ => return,
                };
                offset += bytes;
                continue;
            };
            if offset + kind.size() > self.record_bytes {
                return;
            }
            let mut field = Field::plain(name, kind, offset);
            if options & 0x08 != 0 {
                field.scale = f64_at(description, 112);
            }
            if options & 0x10 != 0 {
                field.shift = f64_at(description, 136);
            }
            offset += kind.size();
            fields.push(field);
        }
    }
}

/// One description of an extra dimension, 192 bytes.
pub(super) fn describe_extra(name: &str, kind: Kind) -> Vec<u8> {
    let mut bytes = vec![0; EXTRA_BYTES_RECORD];
    bytes[2] = kind.las_code();
    let name = &name.as_bytes()[..name.len().min(32)];
    bytes[4..4 + name.len()].copy_from_slice(name);
    bytes
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
