//! LAS, LAZ and COPC: records of a LAS source are kept byte for byte, only the class is written over (COPC raises old
//! point formats to new ones); other sources become point format 6 to 8 of LAS 1.4, what these do not know goes to
//! extra bytes.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use laz::{LasZipCompressor, LazItemRecordBuilder, LazVlr, LazVlrBuilder};

use super::copc::{self, Builder};
use super::las_header::{self, VLR_HEADER_BYTES};
use super::las_plan::{self, Bits, Fractions, Place, Plan, Recipe, put, vlr_of};
use super::{Format, OutPoint, PointWriter, Target};
use crate::error::{Error, Result};
use crate::schema::{Field, Kind};
use crate::tiles::Scratch;

enum Sink {
    Plain(BufWriter<File>),
    Packed(Box<LasZipCompressor<'static, BufWriter<File>>>),
    Indexed(Box<Builder>),
}

struct LasWriter {
    path: PathBuf,
    sink: Sink,
    head: Vec<u8>,
    point_format: u8,
    scale: [f64; 3],
    /// Of the file, less the shift: added to steps it gives the source's coordinates.
    local_offset: [f64; 3],
    offset: [f64; 3],
    /// `None` for LAS sources.
    recipe: Option<Recipe>,
    with_range: bool,
    record: Vec<u8>,
    written: u64,
    returns: [u64; 15],
    /// The source does not say what its times count from.
    says_times: bool,
    /// Some of them are beyond a week, and some within.
    beyond_week: bool,
    within_week: bool,
    min: [i32; 3],
    max: [i32; 3],
}

/// GPS times that are none of the week, and such as LAS writes with bit 0 of its global encoding: seconds since 1980
/// less 10⁹. Larger ones count from elsewhere.
const STANDARD_TIMES_S: std::ops::Range<f64> = 604_800.000_001..1e9;

pub(super) fn create(path: &Path, named: &Path, target: &Target<'_>, format: Format) -> Result<Box<dyn PointWriter>> {
    let mut plan = match &target.source.las {
        Some(las) if format == Format::Copc => las_plan::index(named, las, target)?,
        Some(las) => las_plan::keep(named, las, target)?,
        None => las_plan::make(named, target, &target.source.schema)?,
    };
    if format == Format::Copc && target.source.las.is_none() {
        plan.vlrs.insert(0, vlr_of(copc::USER_ID, 1, "COPC info", vec![0; copc::INFO_BYTES]));
    }
    let Plan { mut head, mut vlrs, point_format, record_bytes, scale, offset, recipe } = plan;
    let packed = if format == Format::Las {
        None
    } else {
        let base = las_header::RECORD_BYTES[usize::from(point_format)];
        let extra = (record_bytes - base) as u16;
        let items = LazItemRecordBuilder::default_for_point_format_id(point_format, extra)
            .map_err(|e| Error::unsupported(path, format!("packing: {e}"), "write .las"))?;
        let builder = LazVlrBuilder::new(items);
        let vlr = if format == Format::Copc { builder.with_variable_chunk_size() } else { builder }.build();
        let mut content = Vec::new();
        vlr.write_to(&mut content).map_err(|e| Error::io(path, "write", e))?;
        vlrs.push(vlr_of(LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, content));
        Some(vlr)
    };
    let bytes: usize = vlrs.iter().map(|vlr| VLR_HEADER_BYTES + vlr.content.len()).sum();
    let points_offset = head.len() + bytes;
    put(&mut head, 96, &(points_offset as u32).to_le_bytes());
    put(&mut head, 100, &(vlrs.len() as u32).to_le_bytes());
    head[104] = point_format | if packed.is_some() { 0x80 } else { 0 };
    put(&mut head, 105, &(record_bytes as u16).to_le_bytes());
    for axis in 0..3 {
        put(&mut head, 131 + 8 * axis, &scale[axis].to_le_bytes());
        put(&mut head, 155 + 8 * axis, &offset[axis].to_le_bytes());
    }

    let io = |e| Error::io(path, "write", e);
    // COPC reads a number again that the packer has written.
    let file = File::options().read(true).write(true).create(true).truncate(true).open(path);
    let file = file.map_err(|e| Error::io(path, "create", e))?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    file.write_all(&head).map_err(io)?;
    for vlr in &vlrs {
        file.write_all(&vlr.header).and_then(|()| file.write_all(&vlr.content)).map_err(io)?;
    }
    let sink = match packed {
        None => Sink::Plain(file),
        Some(vlr) if format == Format::Copc => {
            let scratch = Scratch::new(target.scratch)?;
            let (path, begin) = (named.to_path_buf(), points_offset as u64);
            Sink::Indexed(Box::new(Builder::new(path, file, vlr, begin, scratch, target.memory_bytes)?))
        }
        Some(vlr) => Sink::Packed(Box::new(
            LasZipCompressor::new(file, vlr).map_err(|e| Error::unsupported(path, e.to_string(), "write .las"))?,
        )),
    };
    Ok(Box::new(LasWriter {
        path: named.to_path_buf(),
        sink,
        head,
        point_format,
        scale,
        local_offset: [0, 1, 2].map(|axis| offset[axis] - target.shift[axis]),
        offset,
        recipe,
        with_range: target.with_range,
        record: Vec::new(),
        written: 0,
        returns: [0; 15],
        says_times: target.source.las.is_none(),
        beyond_week: false,
        within_week: false,
        min: [i32::MAX; 3],
        max: [i32::MIN; 3],
    }))
}

/// The value of a field as a whole number for its place.
///
/// # Errors
/// When it has not so many bits, or is a fraction of a number that is counted.
fn whole(path: &Path, field: &Field, raw: &[u8], place: &Place) -> Result<i64> {
    let value = field.value(raw);
    let number = (value / place.unit).round();
    let span = |bits: u32| (1u64 << bits) as f64;
    let (bits, least, most) = match place.numbers() {
        Bits::Signed(bits) => (bits, -span(bits) / 2.0, span(bits) / 2.0 - 1.0),
        Bits::Unsigned(bits) => (bits, 0.0, span(bits) - 1.0),
    };
    if place.fractions == Fractions::Rounded && !number.is_nan() {
        return Ok(number.clamp(least, most) as i64);
    }
    if !(least..=most).contains(&number) {
        let what = format!("`{}` of {value} in the {bits} bits that LAS has for it", field.name);
        return Err(Error::unsupported(path, what, "name the output .ply"));
    }
    // Angles are rounded to their steps; counts are not.
    if place.unit == 1.0 && number != value {
        let what = format!("`{}` of {value} in LAS, which has whole numbers for it", field.name);
        return Err(Error::unsupported(path, what, "name the output .ply"));
    }
    Ok(number as i64)
}

impl LasWriter {
    /// Steps of a coordinate.
    fn steps(&self, xyz: [f64; 3]) -> Result<[i32; 3]> {
        let mut steps = [0; 3];
        for axis in 0..3 {
            let count = ((xyz[axis] - self.local_offset[axis]) / self.scale[axis]).round();
            if !(count >= f64::from(i32::MIN) && count <= f64::from(i32::MAX)) {
                let what = format!("the coordinate {} does not fit LAS with steps of {}", xyz[axis], self.scale[axis]);
                return Err(Error::unsupported(&self.path, what, "name the output .ply, or crop the cloud first"));
            }
            steps[axis] = count as i32;
        }
        Ok(steps)
    }

    fn fill_record(&mut self, point: &OutPoint<'_>) -> Result<[i32; 3]> {
        self.record.clear();
        let Some(recipe) = &self.recipe else {
            self.record.extend_from_slice(point.raw);
            let steps = [0, 4, 8].map(|at| i32::from_le_bytes(crate::schema::array(&point.raw[at..])));
            if let Some(class) = point.class {
                if self.point_format < 6 {
                    self.record[15] = (self.record[15] & 0xe0) | (class & 31);
                } else {
                    self.record[16] = class;
                }
            }
            return Ok(steps);
        };
        let steps = self.steps(point.xyz)?;
        self.record.resize(las_header::RECORD_BYTES[usize::from(self.point_format)], 0);
        for axis in 0..3 {
            put(&mut self.record, 4 * axis, &steps[axis].to_le_bytes());
        }
        // The only return of a pulse, unless the source knows better.
        self.record[14] = 0x11;
        for (field, place) in &recipe.known {
            if place.fractions == Fractions::Rounded && field.value(point.raw).is_nan() {
                // 0 says that there is none.
                continue;
            }
            let number = match whole(&self.path, field, point.raw, place) {
                Err(_) if place.fractions == Fractions::BesideInFull => 0,
                number => number?,
            };
            let mask = (1u64 << place.bits) - 1;
            let mut word = [0; 8];
            word[..place.bytes].copy_from_slice(&self.record[place.byte..place.byte + place.bytes]);
            let kept = u64::from_le_bytes(word) & !(mask << place.right);
            let word = kept | ((number as u64 & mask) << place.right);
            put(&mut self.record, place.byte, &word.to_le_bytes()[..place.bytes]);
        }
        self.record[16] = match (point.class, &recipe.class) {
            (Some(class), _) => class,
            (None, Some(field)) => whole(&self.path, field, point.raw, &Place::word(16, 1))? as u8,
            (None, None) => 0,
        };
        let time = recipe.gps_time.as_ref().map_or(0.0, |field| field.value(point.raw));
        if self.says_times {
            self.beyond_week |= STANDARD_TIMES_S.contains(&time.abs());
            self.within_week |= time != 0.0 && time.abs() < STANDARD_TIMES_S.start;
        }
        put(&mut self.record, 22, &time.to_le_bytes());
        if let Some(colours) = &recipe.colours {
            for (index, field) in colours.iter().enumerate() {
                // Eight bits are spread over sixteen, as the specification asks.
                let spread = if matches!(field.kind, Kind::U8) { 257.0 } else { 1.0 };
                let place = Place { unit: 1.0 / spread, ..Place::word(30 + 2 * index, 2) };
                let value = whole(&self.path, field, point.raw, &place)? as u16;
                put(&mut self.record, 30 + 2 * index, &value.to_le_bytes());
            }
        }
        for field in &recipe.extra {
            self.record.extend_from_slice(&point.raw[field.offset..field.offset + field.kind.size()]);
        }
        if let Some(from) = recipe.tail {
            self.record.extend_from_slice(&point.raw[from..]);
        }
        Ok(steps)
    }
}

impl PointWriter for LasWriter {
    fn write(&mut self, points: &[OutPoint<'_>]) -> Result<()> {
        for point in points {
            let steps = self.fill_record(point)?;
            if self.with_range {
                self.record.extend_from_slice(&point.range.unwrap_or(f64::NAN).to_le_bytes());
            }
            for axis in 0..3 {
                self.min[axis] = self.min[axis].min(steps[axis]);
                self.max[axis] = self.max[axis].max(steps[axis]);
            }
            let number = usize::from(self.record[14] & if self.point_format < 6 { 7 } else { 15 });
            if let Some(count) = number.checked_sub(1).and_then(|index| self.returns.get_mut(index)) {
                *count += 1;
            }
            self.written += 1;
            match &mut self.sink {
                Sink::Plain(file) => file.write_all(&self.record),
                Sink::Packed(packer) => packer.compress_one(&self.record),
                Sink::Indexed(builder) => {
                    builder.push(&self.record)?;
                    Ok(())
                }
            }
            .map_err(|e| Error::io(&self.path, "write", e))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64> {
        let path = self.path.clone();
        let io = |e| Error::io(&path, "write", e);
        let bound = |steps: i32, axis: usize| {
            if self.written == 0 { 0.0 } else { f64::from(steps) * self.scale[axis] + self.offset[axis] }
        };
        let [min, max] = [self.min, self.max].map(|steps| [0, 1, 2].map(|axis| bound(steps[axis], axis)));
        // Steps may count against an axis.
        let [min, max] = [f64::min, f64::max].map(|of| [0, 1, 2].map(|axis| of(min[axis], max[axis])));
        let (mut file, indexed) = match self.sink {
            Sink::Plain(file) => (file, None),
            Sink::Packed(mut packer) => {
                packer.done().map_err(io)?;
                (packer.into_inner(), None)
            }
            Sink::Indexed(builder) => {
                let built = builder.build(copc::Steps { scale: self.scale, offset: self.offset }, min, max)?;
                (built.file, Some((built.info, built.hierarchy_offset)))
            }
        };
        let head = &mut self.head;
        // A receiver that counts on over the end of the week has times on both sides of it.
        head[6] |= u8::from(self.beyond_week && !self.within_week);
        if let Some((_, hierarchy)) = indexed {
            put(head, 235, &hierarchy.to_le_bytes());
            put(head, 243, &1u32.to_le_bytes());
        }
        let short = u32::try_from(self.written).unwrap_or(0);
        let old_format = self.point_format < 6;
        put(head, 107, &(if old_format { short } else { 0 }).to_le_bytes());
        for index in 0..5 {
            let count = u32::try_from(self.returns[index]).unwrap_or(0);
            put(head, 111 + 4 * index, &(if old_format { count } else { 0 }).to_le_bytes());
        }
        if head[25] == 4 {
            put(head, 247, &self.written.to_le_bytes());
            for (index, count) in self.returns.iter().enumerate() {
                put(head, 255 + 8 * index, &count.to_le_bytes());
            }
        } else if self.written > u64::from(u32::MAX) {
            let what = format!("{} points in LAS 1.{}", self.written, head[25]);
            return Err(Error::unsupported(&path, what, "name the output .ply"));
        }
        for axis in 0..3 {
            put(head, 179 + 16 * axis, &max[axis].to_le_bytes());
            put(head, 187 + 16 * axis, &min[axis].to_le_bytes());
        }
        file.flush().map_err(io)?;
        file.seek(SeekFrom::Start(0)).and_then(|_| file.write_all(head)).map_err(io)?;
        if let Some((info, _)) = indexed {
            file.seek(SeekFrom::Current(VLR_HEADER_BYTES as i64)).and_then(|_| file.write_all(&info)).map_err(io)?;
        }
        file.flush().map_err(io)?;
        file.get_ref().sync_all().map_err(io)?;
        Ok(self.written)
    }
}
