//! LAS and LAZ: records of a LAS source are kept byte for byte, only the class is written over; other sources become
//! point format 6 or 7 of LAS 1.4, what these do not know goes to extra bytes.

use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use autoref_raster::crs::Crs;
use laz::{LasZipCompressor, LazItemRecordBuilder, LazVlr};

use super::las_header::{self, LasHeader, VLR_HEADER_BYTES, Vlr};
use super::{Format, OutPoint, PointWriter, Precision, Target};
use crate::error::{Error, Result};
use crate::schema::{Field, Kind};

enum Sink {
    Plain(BufWriter<File>),
    Packed(Box<LasZipCompressor<'static, BufWriter<File>>>),
}

/// How a point of another format becomes a record.
struct Recipe {
    class: Option<Field>,
    gps_time: Option<Field>,
    colours: Option<[Field; 3]>,
    /// What the point format knows, and where it goes.
    known: Vec<(Field, Place)>,
    extra: Vec<Field>,
}

/// Where a whole number lies in a record of point format 6, 7 or 8.
#[derive(Clone, Copy)]
struct Place {
    byte: usize,
    bytes: usize,
    /// Bits to the right of it, and how many it has.
    right: u32,
    bits: u32,
    signed: bool,
    /// The number is the value divided by this.
    unit: f64,
}

impl Place {
    const fn word(byte: usize, bytes: usize) -> Place {
        Place { byte, bytes, right: 0, bits: 8 * bytes as u32, signed: false, unit: 1.0 }
    }

    const fn bits(byte: usize, right: u32, bits: u32) -> Place {
        Place { byte, bytes: 1, right, bits, signed: false, unit: 1.0 }
    }

    fn numbers(&self) -> Bits {
        if self.signed { Bits::Signed(self.bits) } else { Bits::Unsigned(self.bits) }
    }
}

/// What point formats 6 to 8 know, by the names that other formats give it (without underscores).
const KNOWN: [(&[&str], Place); 14] = [
    (&["intensity", "grey", "gray"], Place::word(12, 2)),
    (&["returnnumber"], Place::bits(14, 0, 4)),
    (&["numberofreturns"], Place::bits(14, 4, 4)),
    (&["synthetic"], Place::bits(15, 0, 1)),
    (&["keypoint"], Place::bits(15, 1, 1)),
    (&["withheld"], Place::bits(15, 2, 1)),
    (&["overlap"], Place::bits(15, 3, 1)),
    (&["scannerchannel"], Place::bits(15, 4, 2)),
    (&["scandirectionflag"], Place::bits(15, 6, 1)),
    (&["edgeofflightline"], Place::bits(15, 7, 1)),
    (&["userdata"], Place::word(17, 1)),
    (&["scanangle", "scananglerank"], Place { signed: true, unit: 0.006, ..Place::word(18, 2) }),
    (&["pointsourceid"], Place::word(20, 2)),
    (&["nir", "infrared"], Place::word(36, 2)),
];

/// A name as it is compared: CloudCompare writes `scalar_` before it.
fn plain_name(name: &str) -> String {
    name.strip_prefix("scalar_").unwrap_or(name).replace('_', "")
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
    min: [i32; 3],
    max: [i32; 3],
}

pub(super) fn create(path: &Path, named: &Path, target: &Target<'_>, format: Format) -> Result<Box<dyn PointWriter>> {
    let plan = match &target.source.las {
        Some(las) => keep(named, las, target)?,
        None => make(named, target)?,
    };
    let Plan { mut head, mut vlrs, point_format, record_bytes, scale, offset, recipe } = plan;
    let packed = if format == Format::Laz {
        let base = las_header::RECORD_BYTES[usize::from(point_format)];
        let extra = (record_bytes - base) as u16;
        let items = LazItemRecordBuilder::default_for_point_format_id(point_format, extra)
            .map_err(|e| Error::unsupported(path, format!("packing: {e}"), "write .las"))?;
        let vlr = LazVlr::from_laz_items(items);
        let mut content = Vec::new();
        vlr.write_to(&mut content).map_err(|e| Error::io(path, "write", e))?;
        vlrs.push(vlr_of(LazVlr::USER_ID, LazVlr::RECORD_ID, LazVlr::DESCRIPTION, content));
        Some(vlr)
    } else {
        None
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
    let file = File::create(path).map_err(|e| Error::io(path, "create", e))?;
    let mut file = BufWriter::with_capacity(1 << 20, file);
    file.write_all(&head).map_err(io)?;
    for vlr in &vlrs {
        file.write_all(&vlr.header).and_then(|()| file.write_all(&vlr.content)).map_err(io)?;
    }
    let sink = match packed {
        None => Sink::Plain(file),
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
        min: [i32::MAX; 3],
        max: [i32::MIN; 3],
    }))
}

struct Plan {
    head: Vec<u8>,
    vlrs: Vec<Vlr>,
    point_format: u8,
    record_bytes: usize,
    scale: [f64; 3],
    offset: [f64; 3],
    recipe: Option<Recipe>,
}

/// The plan for a LAS source: everything as it came, but for what belongs to packing, indices and waveforms in the
/// file.
fn keep(path: &Path, las: &LasHeader, target: &Target<'_>) -> Result<Plan> {
    let mut head = las.raw.clone();
    // Version 1.0 has a mark before its points that later versions do not.
    head[25] = las.minor.max(2);
    if head.len() >= 235 {
        put(&mut head, 227, &[0; 8]);
    }
    if las.minor == 4 {
        put(&mut head, 235, &[0; 12]);
    }
    let mut vlrs: Vec<Vlr> =
        las.vlrs.iter().filter(|vlr| vlr.user_id != LazVlr::USER_ID && vlr.user_id != "copc").cloned().collect();
    let mut record_bytes = las.record_bytes;
    if target.with_range {
        record_bytes += 8;
        let described = las_header::describe_extra("range", Kind::F64);
        match vlrs.iter_mut().find(|vlr| vlr.user_id == "LASF_Spec" && vlr.record_id == 4) {
            Some(vlr) => {
                let content = [vlr.content.as_slice(), &described].concat();
                *vlr = vlr_of("LASF_Spec", 4, "extra bytes", content);
            }
            None => {
                // Bytes that nobody described must be named before ours.
                let undescribed = las.record_bytes - las_header::RECORD_BYTES[usize::from(las.point_format)];
                let mut content = Vec::new();
                if undescribed > 0 {
                    content = las_header::describe_extra("undescribed", Kind::U8);
                    content[2] = 0;
                    content[3] = undescribed.min(255) as u8;
                }
                content.extend(described);
                vlrs.push(vlr_of("LASF_Spec", 4, "extra bytes", content));
            }
        }
    }
    add_crs(path, &mut head, &mut vlrs, target)?;
    let offset = [0, 1, 2].map(|axis| las.offset[axis] + target.shift[axis]);
    Ok(Plan { head, vlrs, point_format: las.point_format, record_bytes, scale: las.scale, offset, recipe: None })
}

/// The plan for other sources.
fn make(path: &Path, target: &Target<'_>) -> Result<Plan> {
    let schema = &target.source.schema;
    let named = |names: &[&str]| {
        names.iter().find_map(|name| schema.fields.iter().find(|field| plain_name(&field.name) == *name)).cloned()
    };
    let colours = match (named(&["red", "r"]), named(&["green", "g"]), named(&["blue", "b"])) {
        (Some(red), Some(green), Some(blue)) => Some([red, green, blue]),
        _ => None,
    };
    let class = named(&["classification", "class"]);
    let gps_time = named(&["gpstime"]);
    // The near infrared has room beside colours only.
    let has_room = |place: &Place| place.byte < 30 || colours.is_some();
    let known: Vec<(Field, Place)> = KNOWN
        .into_iter()
        .filter(|(_, place)| has_room(place))
        .filter_map(|(names, place)| Some((named(names)?, place)))
        .collect();
    let mut taken = vec!["x".to_string(), "y".into(), "z".into()];
    taken.extend([&class, &gps_time].into_iter().flatten().map(|field| field.name.clone()));
    taken.extend(colours.iter().flatten().map(|field| field.name.clone()));
    taken.extend(known.iter().map(|(field, _)| field.name.clone()));
    if target.with_range {
        taken.push("range".into());
    }
    let extra: Vec<Field> = schema.fields.iter().filter(|field| !taken.contains(&field.name)).cloned().collect();

    let with_nir = known.iter().any(|(_, place)| place.byte == 36);
    let point_format = if with_nir { 8 } else { 6 + usize::from(colours.is_some()) };
    let mut record_bytes = las_header::RECORD_BYTES[point_format];
    let mut described = Vec::new();
    for field in &extra {
        record_bytes += field.kind.size();
        described.extend(las_header::describe_extra(&field.name, field.kind));
    }
    if target.with_range {
        record_bytes += 8;
        described.extend(las_header::describe_extra("range", Kind::F64));
    }
    if described.len() > 65_535 {
        let what = format!("{} further dimensions in LAS", extra.len());
        return Err(Error::unsupported(path, what, "name the output .ply"));
    }
    let mut vlrs = Vec::new();
    if !described.is_empty() {
        vlrs.push(vlr_of("LASF_Spec", 4, "extra bytes", described));
    }
    let mut head = vec![0; 375];
    head[..4].copy_from_slice(b"LASF");
    head[24..26].copy_from_slice(&[1, 4]);
    put(&mut head, 26, b"OTHER");
    put(&mut head, 58, b"autoref-stream");
    put(&mut head, 94, &375u16.to_le_bytes());
    // The coordinate reference system is WKT.
    head[6] = 0x10;
    add_crs(path, &mut head, &mut vlrs, target)?;
    let extent = (0..3).map(|axis| target.max[axis] - target.min[axis]).fold(0.0, f64::max);
    let scale = [step(extent, target.source.precision); 3];
    if !matches!(target.source.precision, Precision::Steps(_)) && scale[0] > COARSEST_STEP {
        let [low, high] = [target.min, target.max].map(|at| at.map(|v| format!("{v:.6e}")).join(", "));
        let what = format!("coordinates from ({low}) to ({high}): LAS would round them all to {}", scale[0]);
        let remedy = "drop the stray points (--z or --crop, with --drop noise), or name the output .ply";
        return Err(Error::unsupported(path, what, remedy));
    }
    let offset =
        [0, 1, 2].map(|axis| ((target.min[axis] + target.max[axis]) / 2.0).round() + target.shift[axis].round());
    let recipe = Recipe { class, gps_time, colours, known, extra };
    Ok(Plan { head, vlrs, point_format: point_format as u8, record_bytes, scale, offset, recipe: Some(recipe) })
}

/// Coarser steps than this would harm what was given in full: they are taken from 2,000 km on.
const COARSEST_STEP: f64 = 1e-3;

/// The power of ten in which coordinates are counted: a tenth of a millimetre where that is fine enough and fits.
fn step(extent: f64, precision: Precision) -> f64 {
    if let Precision::Steps(steps) = precision {
        return steps[0];
    }
    let least = if extent > 0.0 { (extent / 2e9).log10().ceil() } else { -9.0 };
    let wanted = if extent < 400.0 { -7.0 } else { -4.0 };
    10f64.powi(least.max(wanted) as i32)
}

/// The reference system of the source, where its records do not hold it yet, or the one that was given.
fn add_crs(path: &Path, head: &mut [u8], vlrs: &mut Vec<Vlr>, target: &Target<'_>) -> Result<()> {
    let wkt = match (&target.source.las, &target.source.crs) {
        (Some(las), _) if las.crs().is_some() => None,
        (None, Some(named)) => Some(match Crs::parse(named) {
            Ok(crs) => crs.wkt().to_string(),
            // WKT that PROJ does not understand goes on as it came.
            Err(_) if named.contains('[') => named.clone(),
            Err(error) => return Err(error),
        }),
        _ => target.crs_wkt.map(str::to_string),
    };
    let Some(wkt) = wkt else { return Ok(()) };
    if wkt.len() >= 65_000 {
        let what = format!("a reference system of {} bytes of WKT", wkt.len());
        return Err(Error::unsupported(path, what, "name the output .ply"));
    }
    head[6] |= 0x10;
    let content = [wkt.as_bytes(), &[0]].concat();
    vlrs.push(vlr_of("LASF_Projection", 2112, "OGC coordinate system WKT", content));
    Ok(())
}

fn vlr_of(user_id: &str, record_id: u16, description: &str, content: Vec<u8>) -> Vlr {
    let mut header = vec![0; VLR_HEADER_BYTES];
    put(&mut header, 2, user_id.as_bytes());
    put(&mut header, 18, &record_id.to_le_bytes());
    put(&mut header, 20, &(content.len() as u16).to_le_bytes());
    put(&mut header, 22, &description.as_bytes()[..description.len().min(32)]);
    Vlr { user_id: user_id.into(), record_id, header, content }
}

fn put(bytes: &mut [u8], at: usize, what: &[u8]) {
    bytes[at..at + what.len()].copy_from_slice(what);
}

/// Numbers that so many bits hold.
#[derive(Clone, Copy)]
enum Bits {
    Unsigned(u32),
    Signed(u32),
}

/// The value of a field as a whole number of `unit`.
///
/// # Errors
/// When it has not so many bits.
fn whole(path: &Path, field: &Field, raw: &[u8], unit: f64, bits: Bits) -> Result<i64> {
    let value = field.value(raw);
    let number = (value / unit).round();
    let span = |bits: u32| (1u64 << bits) as f64;
    let (bits, least, most) = match bits {
        Bits::Signed(bits) => (bits, -span(bits) / 2.0, span(bits) / 2.0 - 1.0),
        Bits::Unsigned(bits) => (bits, 0.0, span(bits) - 1.0),
    };
    if !(least..=most).contains(&number) {
        let what = format!("`{}` of {value} in the {bits} bits that LAS has for it", field.name);
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
            let number = whole(&self.path, field, point.raw, place.unit, place.numbers())?;
            let mask = (1u64 << place.bits) - 1;
            let mut word = [0; 8];
            word[..place.bytes].copy_from_slice(&self.record[place.byte..place.byte + place.bytes]);
            let kept = u64::from_le_bytes(word) & !(mask << place.right);
            let word = kept | ((number as u64 & mask) << place.right);
            put(&mut self.record, place.byte, &word.to_le_bytes()[..place.bytes]);
        }
        self.record[16] = match (point.class, &recipe.class) {
            (Some(class), _) => class,
            (None, Some(field)) => whole(&self.path, field, point.raw, 1.0, Bits::Unsigned(8))? as u8,
            (None, None) => 0,
        };
        let time = recipe.gps_time.as_ref().map_or(0.0, |field| field.value(point.raw));
        put(&mut self.record, 22, &time.to_le_bytes());
        if let Some(colours) = &recipe.colours {
            for (index, field) in colours.iter().enumerate() {
                // Eight bits are spread over sixteen, as the specification asks.
                let spread = if matches!(field.kind, Kind::U8) { 257.0 } else { 1.0 };
                let value = whole(&self.path, field, point.raw, 1.0 / spread, Bits::Unsigned(16))? as u16;
                put(&mut self.record, 30 + 2 * index, &value.to_le_bytes());
            }
        }
        for field in &recipe.extra {
            self.record.extend_from_slice(&point.raw[field.offset..field.offset + field.kind.size()]);
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
            }
            .map_err(|e| Error::io(&self.path, "write", e))?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<u64> {
        let path = self.path.clone();
        let io = |e| Error::io(&path, "write", e);
        let mut file = match self.sink {
            Sink::Plain(file) => file,
            Sink::Packed(mut packer) => {
                packer.done().map_err(io)?;
                packer.into_inner()
            }
        };
        let head = &mut self.head;
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
            let bound = |steps: i32| {
                if self.written == 0 { 0.0 } else { f64::from(steps) * self.scale[axis] + self.offset[axis] }
            };
            put(head, 179 + 16 * axis, &bound(self.max[axis]).to_le_bytes());
            put(head, 187 + 16 * axis, &bound(self.min[axis]).to_le_bytes());
        }
        file.flush().map_err(io)?;
        file.seek(SeekFrom::Start(0)).and_then(|_| file.write_all(head)).and_then(|()| file.flush()).map_err(io)?;
        file.get_ref().sync_all().map_err(io)?;
        Ok(self.written)
    }
}
