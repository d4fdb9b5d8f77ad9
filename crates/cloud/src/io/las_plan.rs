//! What is settled before the first record of LAS, LAZ or COPC is written: header, records before the points, point
//! format, steps, and how points become records.

use std::path::Path;

use autoref_raster::crs::Crs;
use autoref_raster::words::in_short;
use laz::LazVlr;

use super::las_fields::{FULL, IN_FULL, describe_extra};
use super::las_header::{self, LasHeader, VLR_HEADER_BYTES, Vlr};
use super::{Precision, Target, copc};
use crate::error::{Error, Result};
use crate::schema::{Field, Kind, Schema};

/// How a point of another format becomes a record.
pub(super) struct Recipe {
    pub class: Option<Field>,
    pub gps_time: Option<Field>,
    pub colours: Option<[Field; 3]>,
    /// What the point format knows, and where it goes.
    pub known: Vec<(Field, Place)>,
    pub extra: Vec<Field>,
    /// From this byte on a record's bytes go on as they are: extra bytes of a LAS source.
    pub tail: Option<usize>,
}

/// Where a whole number lies in a record of point format 6, 7 or 8.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub byte: usize,
    pub bytes: usize,
    /// Bits to the right of it, and how many it has.
    pub right: u32,
    pub bits: u32,
    pub signed: bool,
    /// The number is the value divided by this.
    pub unit: f64,
    pub fractions: Fractions,
}

/// What becomes of a value that is no whole number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fractions {
    Refused,
    /// Extra bytes hold the value in full: what does not fit the place is left at 0.
    BesideInFull,
    /// The values were spread over all numbers of the place; none is left at 0.
    Rounded,
}

impl Place {
    /// An unsigned number of whole bytes at byte `byte` of the record.
    pub const fn word(byte: usize, bytes: usize) -> Place {
        Place { byte, bytes, right: 0, bits: 8 * bytes as u32, signed: false, unit: 1.0, fractions: Fractions::Refused }
    }

    const fn bits(byte: usize, right: u32, bits: u32) -> Place {
        Place { byte, bytes: 1, right, bits, signed: false, unit: 1.0, fractions: Fractions::Refused }
    }

    /// How many bits its numbers have, and whether one is the sign.
    pub fn numbers(&self) -> Bits {
        if self.signed { Bits::Signed(self.bits) } else { Bits::Unsigned(self.bits) }
    }
}

pub(super) const INTENSITY: usize = 12;

/// What point formats 6 to 8 know, by the names that other formats give it (without underscores).
const KNOWN: [(&[&str], Place); 14] = [
    (&["intensity", "grey", "gray"], Place::word(INTENSITY, 2)),
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

/// The bytes of places for what is measured, intensity and near infrared: other formats have fractions there.
const MEASURED: [usize; 2] = [INTENSITY, 36];

/// A name as it is compared: CloudCompare writes `scalar_` before it, E57 names the extension of LAS.
fn plain_name(name: &str) -> String {
    ["scalar_", "las_"].iter().find_map(|before| name.strip_prefix(before)).unwrap_or(name).replace('_', "")
}

/// Numbers that so many bits hold.
#[derive(Clone, Copy)]
pub(super) enum Bits {
    Unsigned(u32),
    Signed(u32),
}

pub(super) struct Plan {
    pub head: Vec<u8>,
    pub vlrs: Vec<Vlr>,
    pub point_format: u8,
    pub record_bytes: usize,
    pub scale: [f64; 3],
    pub offset: [f64; 3],
    pub recipe: Option<Recipe>,
}

/// The plan for a LAS source: everything as it came, but for what belongs to packing, indices and waveforms in the
/// file.
pub(super) fn keep(path: &Path, las: &LasHeader, target: &Target<'_>) -> Result<Plan> {
    let mut head = las.raw.clone();
    // Version 1.0 has a mark before its points that later versions do not.
    head[25] = las.minor.max(2);
    // Some old headers have the new point formats, whose number only those of 1.4 can say.
    if las.point_format >= 6 && las.minor < 4 {
        as_of_1_4(&mut head);
    }
    if head.len() >= 235 {
        put(&mut head, 227, &[0; 8]);
    }
    if head[25] == 4 {
        put(&mut head, 235, &[0; 12]);
    }
    let mut vlrs: Vec<Vlr> =
        las.vlrs.iter().filter(|vlr| vlr.user_id != LazVlr::USER_ID && vlr.user_id != "copc").cloned().collect();
    let mut record_bytes = las.record_bytes;
    if target.with_range {
        record_bytes += 8;
        describe_range(las, &mut vlrs);
    }
    if las.crs().is_none() {
        add_crs(path, &mut head, &mut vlrs, target)?;
    }
    let offset = [0, 1, 2].map(|axis| las.offset[axis] + target.shift[axis]);
    Ok(Plan { head, vlrs, point_format: las.point_format, record_bytes, scale: las.scale, offset, recipe: None })
}

/// A header of LAS 1.4 and of its size.
fn as_of_1_4(head: &mut Vec<u8>) {
    head.resize(HEADER_BYTES, 0);
    head[25] = 4;
    put(head, 94, &(HEADER_BYTES as u16).to_le_bytes());
}

/// Adds the range behind the extra bytes that a LAS source has.
fn describe_range(las: &LasHeader, vlrs: &mut Vec<Vlr>) {
    let (descriptions, described) = las.described_extra();
    let mut content = descriptions.to_vec();
    // Bytes that nobody described must be named before ours; a description has room for 255.
    let mut left = las.record_bytes - las_header::RECORD_BYTES[usize::from(las.point_format)] - described;
    while left > 0 {
        let bytes = left.min(255);
        let mut undescribed = describe_extra("undescribed", Kind::U8, "");
        undescribed[2..4].copy_from_slice(&[0, bytes as u8]);
        content.extend(undescribed);
        left -= bytes;
    }
    content.extend(describe_extra("range", Kind::F64, ""));
    vlrs.retain(|vlr| !(vlr.user_id == "LASF_Spec" && vlr.record_id == 4));
    vlrs.push(vlr_of("LASF_Spec", 4, "extra bytes", content));
}

/// The plan of a COPC file for a LAS source: point formats 6 to 8 as they came, 0 to 3 raised to these, extra bytes as
/// they are; the reference system as WKT.
pub(super) fn index(path: &Path, las: &LasHeader, target: &Target<'_>) -> Result<Plan> {
    let mut plan = match las.point_format {
        6..=8 => keep(path, las, target)?,
        0..=3 => raise(path, las, target)?,
        other => {
            let what = format!("waveforms (point format {other}) in COPC");
            return Err(Error::unsupported(path, what, "name the output .laz"));
        }
    };
    // The description of the octree stands at byte 375.
    as_of_1_4(&mut plan.head);
    if las.vlr("LASF_Projection", 2112).is_none() && las.crs().is_some() && plan.recipe.is_none() {
        plan.vlrs.retain(|vlr| vlr.user_id != "LASF_Projection");
        add_crs(path, &mut plan.head, &mut plan.vlrs, target)?;
    }
    plan.vlrs.insert(0, vlr_of(copc::USER_ID, 1, "COPC info", vec![0; copc::INFO_BYTES]));
    Ok(plan)
}

/// A LAS source of the old point formats in the new ones.
fn raise(path: &Path, las: &LasHeader, target: &Target<'_>) -> Result<Plan> {
    let base = las_header::RECORD_BYTES[usize::from(las.point_format)];
    let standard = Schema { fields: las.point_fields(), stride: base };
    let mut plan = make(path, target, &standard)?;
    // Number and identity of the file, what GPS time counts from, and who made it.
    put(&mut plan.head, 4, &las.raw[4..8]);
    put(&mut plan.head, 8, &las.raw[8..24]);
    put(&mut plan.head, 26, &las.raw[26..94]);
    plan.head[6] |= 0x10;
    plan.scale = las.scale;
    plan.offset = [0, 1, 2].map(|axis| las.offset[axis] + target.shift[axis]);
    // The range was described as if it were alone.
    plan.vlrs.retain(|vlr| vlr.user_id != "LASF_Spec");
    // Keys that spell out a system without a code are kept: they are all that is known of it.
    let keeps_keys = target.source.crs.is_none() && target.crs_wkt.is_none();
    if keeps_keys {
        plan.head[6] &= !0x10;
    }
    let own = |vlr: &&Vlr| match vlr.user_id.as_str() {
        "LASF_Projection" => keeps_keys,
        user => ![LazVlr::USER_ID, copc::USER_ID].contains(&user),
    };
    plan.vlrs.extend(las.vlrs.iter().filter(own).cloned());
    if target.with_range {
        describe_range(las, &mut plan.vlrs);
    }
    if las.record_bytes > base {
        plan.record_bytes += las.record_bytes - base;
        plan.recipe.as_mut().expect("made with one").tail = Some(base);
    }
    Ok(plan)
}

/// Bytes of the header of LAS 1.4.
const HEADER_BYTES: usize = 375;

/// The plan for a source whose records become new ones; `schema` is what of them goes on.
pub(super) fn make(path: &Path, target: &Target<'_>, schema: &Schema) -> Result<Plan> {
    let named = |names: &[&str]| {
        names.iter().find_map(|name| schema.fields.iter().find(|field| plain_name(&field.name) == *name)).cloned()
    };
    let colours = match (named(&["red", "r"]), named(&["green", "g"]), named(&["blue", "b"])) {
        (Some(red), Some(green), Some(blue)) => {
            Some([red, green, blue].map(|field| spread(field, target.source.colours)))
        }
        _ => None,
    };
    let class = named(&["classification", "class"]);
    let gps_time = named(&["gpstime"]);
    // The near infrared has room beside colours only.
    let has_room = |place: &Place| place.byte < 30 || colours.is_some();
    let mut in_full: Vec<(&str, Field)> = Vec::new();
    let mut known: Vec<(Field, Place)> = Vec::new();
    for (names, mut place) in KNOWN.into_iter().filter(|(_, place)| has_room(place)) {
        let Some(field) = named(names) else { continue };
        if place.byte == INTENSITY && target.source.intensity.is_some() {
            place.fractions = Fractions::Rounded;
            known.push((spread(field, target.source.intensity), place));
            continue;
        }
        // Nothing says before the last point whether all of them are whole.
        if MEASURED.contains(&place.byte) && matches!(field.kind, Kind::F32 | Kind::F64) {
            place.fractions = Fractions::BesideInFull;
            in_full.push((names[0], field.clone()));
        }
        known.push((field, place));
    }
    let mut taken = vec!["x".to_string(), "y".into(), "z".into()];
    taken.extend([&class, &gps_time].into_iter().flatten().map(|field| field.name.clone()));
    taken.extend(colours.iter().flatten().map(|field| field.name.clone()));
    taken.extend(known.iter().map(|(field, _)| field.name.clone()));
    if target.with_range {
        taken.push("range".into());
    }
    let mut extra: Vec<Field> = schema.fields.iter().filter(|field| !taken.contains(&field.name)).cloned().collect();

    let with_nir = known.iter().any(|(_, place)| place.byte == 36);
    let point_format = if with_nir { 8 } else { 6 + usize::from(colours.is_some()) };
    let mut record_bytes = las_header::RECORD_BYTES[point_format];
    let mut described = Vec::new();
    for field in &extra {
        record_bytes += field.kind.size();
        described.extend(describe_extra(&field.name, field.kind, ""));
    }
    for (name, field) in in_full {
        record_bytes += field.kind.size();
        described.extend(describe_extra(&format!("{name}{FULL}"), field.kind, IN_FULL));
        extra.push(field);
    }
    if target.with_range {
        record_bytes += 8;
        described.extend(describe_extra("range", Kind::F64, ""));
    }
    if described.len() > 65_535 {
        let what = format!("{} further dimensions in LAS", extra.len());
        return Err(Error::unsupported(path, what, "name the output .ply"));
    }
    let mut vlrs = Vec::new();
    if !described.is_empty() {
        vlrs.push(vlr_of("LASF_Spec", 4, "extra bytes", described));
    }
    let mut head = begun_head();
    add_crs(path, &mut head, &mut vlrs, target)?;
    let extent = (0..3).map(|axis| target.max[axis] - target.min[axis]).fold(0.0, f64::max);
    let scale = [step(extent, target.source.precision); 3];
    if !matches!(target.source.precision, Precision::Steps(_)) && scale[0] > COARSEST_STEP {
        let [low, high] = [target.min, target.max].map(|at| at.map(|v| format!("{v:.6e}")).join(", "));
        let what = format!("coordinates from ({low}) to ({high}): LAS would round them all to {}", in_short(scale[0]));
        let remedy = "drop the stray points (--z or --crop, with --drop noise), or name the output .ply";
        return Err(Error::unsupported(path, what, remedy));
    }
    let offset =
        [0, 1, 2].map(|axis| ((target.min[axis] + target.max[axis]) / 2.0).round() + target.shift[axis].round());
    let recipe = Recipe { class, gps_time, colours, known, extra, tail: None };
    Ok(Plan { head, vlrs, point_format: point_format as u8, record_bytes, scale, offset, recipe: Some(recipe) })
}

/// A header of LAS 1.4 that says who wrote it and that its coordinate reference system is WKT.
fn begun_head() -> Vec<u8> {
    let mut head = vec![0; HEADER_BYTES];
    head[..4].copy_from_slice(b"LASF");
    head[6] = 0x10;
    head[24..26].copy_from_slice(&[1, 4]);
    put(&mut head, 26, b"OTHER");
    put(&mut head, 58, b"autoref-stream");
    put(&mut head, 94, &(HEADER_BYTES as u16).to_le_bytes());
    head
}

/// Intensities and colours between other limits are spread over the sixteen bits, as the specification asks.
fn spread(field: Field, limits: Option<[f64; 2]>) -> Field {
    let Some([least, most]) = limits else { return field };
    let factor = 65_535.0 / (most - least);
    Field { scale: field.scale * factor, shift: (field.shift - least) * factor, ..field }
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

/// The reference system of the source, or the one that was given.
fn add_crs(path: &Path, head: &mut [u8], vlrs: &mut Vec<Vlr>, target: &Target<'_>) -> Result<()> {
    let wkt = match &target.source.crs {
        Some(named) => Some(match Crs::parse(named) {
            Ok(crs) => crs.wkt().to_string(),
            // WKT that PROJ does not understand goes on as it came.
            Err(_) if named.contains('[') => named.clone(),
            Err(error) => return Err(error),
        }),
        None => target.crs_wkt.map(str::to_string),
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

pub(super) fn vlr_of(user_id: &str, record_id: u16, description: &str, content: Vec<u8>) -> Vlr {
    let mut header = vec![0; VLR_HEADER_BYTES];
    put(&mut header, 2, user_id.as_bytes());
    put(&mut header, 18, &record_id.to_le_bytes());
    put(&mut header, 20, &(content.len() as u16).to_le_bytes());
    put(&mut header, 22, &description.as_bytes()[..description.len().min(32)]);
    Vlr { user_id: user_id.into(), record_id, header, content }
}

pub(super) fn put(bytes: &mut [u8], at: usize, what: &[u8]) {
    bytes[at..at + what.len()].copy_from_slice(what);
}
