//! What a LAS record holds: the fields of its point format, the extra bytes that are described, and those that nobody
//! described.

use super::las_header::{EXTRA_BYTES_RECORD, LasHeader, RECORD_BYTES, f64_at, text_of};
use crate::schema::{Field, Kind, Schema, array};

/// Describes extra bytes that hold in full what the point format has whole numbers for.
pub(super) const IN_FULL: &str = "in full; rounded in its place";
/// Behind the name of such bytes: some programs refuse files in which extra bytes have a name of the point format.
pub(super) const FULL: &str = "_full";
/// Where a description has its words.
const WORDS: std::ops::Range<usize> = 160..192;

/// One record of the extra bytes.
struct Extra<'a> {
    description: &'a [u8],
    /// `None` for bytes that are not described.
    kind: Option<Kind>,
    /// Values of that kind, one behind the other; of bytes that are not described their number.
    count: usize,
    offset: usize,
}

impl LasHeader {
    /// The fields of the point format, then the extra bytes. Names are given once: a second one becomes `name_2`.
    pub fn schema(&self) -> Schema {
        let mut fields = self.point_fields();
        for extra in self.extras() {
            let Some(kind) = extra.kind else { continue };
            let mut name = text_of(&extra.description[4..36]);
            if text_of(&extra.description[WORDS]) == IN_FULL {
                // The rounded numbers say nothing more.
                name.truncate(name.strip_suffix(FULL).map_or(name.len(), str::len));
                fields.retain(|field| field.name != name.to_ascii_lowercase());
            }
            for index in 0..extra.count {
                let mut field = Field::plain(
                    if extra.count > 1 { format!("{name}_{index}") } else { name.clone() },
                    kind,
                    extra.offset + index * kind.size(),
                );
                field.interpret(extra.description, index);
                fields.push(field);
            }
        }
        // The coordinates are no fields of LAS, and yet they have their names.
        let mut axes = Schema::default();
        ["x", "y", "z"].into_iter().for_each(|axis| axes.push(axis, Kind::F64));
        let mut schema = Schema { fields: axes.fields, stride: self.record_bytes };
        schema.fields.extend(fields);
        schema.name_once();
        schema.fields.drain(..3);
        schema
    }

    /// The fields of the point format alone.
    pub(super) fn point_fields(&self) -> Vec<Field> {
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
        fields
    }

    /// What is described of the extra bytes, as far as records reach.
    fn extras(&self) -> Vec<Extra<'_>> {
        let mut extras = Vec::new();
        let Some(vlr) = self.vlr("LASF_Spec", 4) else { return extras };
        let mut offset = RECORD_BYTES[usize::from(self.point_format)];
        for description in vlr.content.chunks_exact(EXTRA_BYTES_RECORD) {
            let (kind, count) = match description[2] {
                0 => (None, usize::from(description[3])),
                // Pairs and triples, which later versions of LAS call deprecated.
                code @ 1..=30 => (Kind::from_las_code((code - 1) % 10 + 1), usize::from((code - 1) / 10 + 1)),
                _ => break,
            };
            let bytes = count * kind.map_or(1, Kind::size);
            if offset + bytes > self.record_bytes {
                break;
            }
            extras.push(Extra { description, kind, count, offset });
            offset += bytes;
        }
        extras
    }

    /// The descriptions of extra bytes that records reach, and how many bytes they describe.
    pub(super) fn described_extra(&self) -> (&[u8], usize) {
        let extras = self.extras();
        let bytes = extras.iter().map(|extra| extra.count * extra.kind.map_or(1, Kind::size)).sum();
        let content = self.vlr("LASF_Spec", 4).map_or(&[][..], |vlr| &vlr.content[..extras.len() * EXTRA_BYTES_RECORD]);
        (content, bytes)
    }

    /// What a format of named values, such as PLY, does not carry of the records, in words.
    pub(super) fn without_names(&self) -> Vec<String> {
        let extras = self.extras();
        let described: usize = extras.iter().filter_map(|extra| Some(extra.kind?.size() * extra.count)).sum();
        let bytes = self.record_bytes - RECORD_BYTES[usize::from(self.point_format)] - described;
        let mut lost = Vec::new();
        if bytes > 0 {
            lost.push(format!("{bytes} bytes of each point that the file does not describe"));
        }
        if matches!(self.point_format, 4 | 5 | 9 | 10) {
            lost.push("waveforms".into());
        }
        lost
    }
}

impl Field {
    /// Takes scale, offset and the number that stands for no value from a description of extra bytes.
    fn interpret(&mut self, description: &[u8], index: usize) {
        let options = description[3];
        if options & 0x01 != 0 {
            self.no_data = Some(array(&description[40 + 8 * index..]));
        }
        if options & 0x08 != 0 {
            self.scale = f64_at(description, 112 + 8 * index);
        }
        if options & 0x10 != 0 {
            self.shift = f64_at(description, 136 + 8 * index);
        }
    }
}

/// One description of an extra dimension, 192 bytes.
pub(super) fn describe_extra(name: &str, kind: Kind, words: &str) -> Vec<u8> {
    let mut bytes = vec![0; EXTRA_BYTES_RECORD];
    bytes[2] = kind.las_code();
    let name = &name.as_bytes()[..name.len().min(32)];
    bytes[4..4 + name.len()].copy_from_slice(name);
    bytes[WORDS.start..WORDS.start + words.len()].copy_from_slice(words.as_bytes());
    bytes
}
