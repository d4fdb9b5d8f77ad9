//! E57 (ASTM E2807): the points of all scans, each moved by its pose. The crate `e57` reads head and XML; the points
//! are read here, since its iterators borrow their reader and keep values without a bound.

use std::fs::File;
use std::io::{Seek, SeekFrom};
use std::path::{Path, PathBuf};

use autoref_raster::crs::Crs;
use e57::{E57Reader, PointCloud, RecordName, Transform};

use super::e57_packets::Packets;
use super::e57_schema::{self as schema, Change, Coding, Filled};
use super::{Format, Header, PointReader, Precision};
use crate::error::{Error, Result};
use crate::schema::{Batch, Kind};
use autoref_raster::words::counted;

/// Each takes some hundred bytes once it is parsed; files of thousands of pictures have tens of thousands.
const MOST_TAGS: usize = 1 << 20;

/// How a scan lies in the file's coordinates.
struct Pose {
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
}

impl Pose {
    fn of(transform: &Transform) -> Result<Self, String> {
        let (q, t) = (&transform.rotation, &transform.translation);
        let norm = [q.w, q.x, q.y, q.z].into_iter().fold(0.0, f64::hypot);
        let translation = [t.x, t.y, t.z];
        if !(norm > 0.0 && norm.is_finite() && translation.iter().all(|value| value.is_finite())) {
            let [w, x, y, z] = [q.w, q.x, q.y, q.z];
            return Err(format!("a pose of rotation ({w}, {x}, {y}, {z}) and translation {translation:?}"));
        }
        // Files give as many digits as they like; a rotation must not scale.
        let [w, x, y, z] = [q.w, q.x, q.y, q.z].map(|value| value / norm);
        let rotation = [
            [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ];
        Ok(Pose { rotation, translation })
    }

    fn turned(&self, v: [f64; 3]) -> [f64; 3] {
        self.rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
    }

    fn moved(&self, v: [f64; 3]) -> [f64; 3] {
        let turned = self.turned(v);
        [0, 1, 2].map(|axis| turned[axis] + self.translation[axis])
    }
}

/// Three attributes, and the one that tells by another number than 0 that they are none.
#[derive(Clone, Copy)]
struct Place {
    attributes: [usize; 3],
    state: Option<usize>,
}

struct Scan {
    /// Where its section begins.
    section: u64,
    points: u64,
    codings: Vec<Coding>,
    pose: Option<Pose>,
    cartesian: Option<Place>,
    /// Range, azimuth, elevation.
    spherical: Option<Place>,
    fields: Vec<Filled>,
    /// Where the record holds a direction, which turns with the pose.
    normal: Option<[(Kind, usize); 3]>,
}

struct ScanReader {
    path: PathBuf,
    packets: Packets,
    scans: std::vec::IntoIter<Scan>,
    scan: Option<Scan>,
    /// Points of the scan at hand that are to come.
    left: u64,
    read: u64,
    /// A record without values.
    blank: Vec<u8>,
    bits: Vec<u64>,
}

/// One line of what the crate says.
fn words(error: &e57::Error) -> String {
    let text = error.to_string();
    // It takes every page that it cannot read for a cut.
    if let Some((_, page)) = text.split_once("invalid checksum").and_then(|(_, rest)| rest.rsplit_once("for page ")) {
        return format!("the checksum of its page {page}, counted from 0, is another: the file is damaged");
    }
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// XML whose parsing would take the memory, or hours: of many tags, of tags of many attributes, of many namespaces.
fn refuse_hostile(xml: &[u8]) -> Result<(), String> {
    const MOST_IN_A_TAG: usize = 1000;
    const MOST_NAMESPACES: usize = 500;
    let count = |bytes: &[u8], byte: u8| bytes.iter().filter(|&&other| other == byte).count();
    let tags = count(xml, b'<');
    if tags > MOST_TAGS {
        return Err(format!("{tags} tags, more than {MOST_TAGS}"));
    }
    let mut namespaces = 0;
    for tag in xml.split(|&byte| byte == b'<').filter(|tag| !tag.starts_with(b"![CDATA[")) {
        if count(tag, b'=') > MOST_IN_A_TAG {
            return Err(format!("a tag of more than {MOST_IN_A_TAG} attributes"));
        }
        namespaces += tag.windows(5).filter(|word| word == b"xmlns").count();
    }
    if namespaces > MOST_NAMESPACES {
        return Err(format!("{namespaces} namespaces, more than {MOST_NAMESPACES}"));
    }
    Ok(())
}

/// Descriptions of thousands of scans are smaller.
const LARGEST_XML_BYTES: u64 = 64 << 20;

/// Head and XML. What lengths the file states is compared with what is there before any memory is taken.
fn parse<'a>(path: &Path, mut file: &'a File, file_bytes: u64) -> Result<E57Reader<&'a File>> {
    let bad = |place: &str, what: String| Error::format(path, place, what);
    let head = e57::Header::read(&mut file).map_err(|error| bad("E57 header", words(&error)))?;
    if head.phys_length > file_bytes {
        let what = format!("{} bytes are stated, the file holds {file_bytes}: it is truncated", head.phys_length);
        return Err(bad("E57 header", what));
    }
    if head.xml_length.saturating_add(head.phys_xml_offset) > file_bytes {
        let what = format!("{} bytes at byte {} of {file_bytes}", head.xml_length, head.phys_xml_offset);
        return Err(bad("E57 header, XML", what));
    }
    if head.xml_length > LARGEST_XML_BYTES {
        let what = format!("{} bytes, and {LARGEST_XML_BYTES} are the limit", head.xml_length);
        return Err(bad("E57 header, XML", what));
    }
    let rewind = |mut file: &File| file.seek(SeekFrom::Start(0)).map_err(|e| Error::io(path, "seek", e));
    rewind(file)?;
    let xml = E57Reader::raw_xml(file).map_err(|error| bad("XML", words(&error)))?;
    refuse_hostile(&xml).map_err(|what| bad("XML", what))?;
    drop(xml);
    rewind(file)?;
    E57Reader::new(file).map_err(|error| bad("XML", words(&error)))
}

pub(super) fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let file_bytes = file.metadata().map_err(|e| Error::io(path, "open", e))?.len();
    let parsed = parse(path, &file, file_bytes)?;
    let mut clouds = parsed.pointclouds();
    let crs = crs_of(path, parsed.coordinate_metadata());
    drop(parsed);
    let count = clouds.len();
    clouds.retain(|cloud| cloud.records > 0);
    let (schema, fields) = schema::schema(&clouds).map_err(|what| Error::format(path, "XML", what))?;
    let mut scans = Vec::new();
    let mut points = 0u64;
    for (number, (cloud, fields)) in clouds.iter().zip(fields).enumerate() {
        let bad = |what: String| Error::format(path, format!("scan {} with points", number + 1), what);
        scans.push(scan_of(cloud, fields, file_bytes).map_err(bad)?);
        points = points.checked_add(cloud.records).ok_or_else(|| bad(format!("{} points", cloud.records)))?;
    }
    let header = Header {
        format: Format::E57,
        points: Some(points),
        precision: precision(&scans),
        crs,
        shift: None,
        intensity: schema::intensity_limits(&clouds),
        colours: None,
        las: None,
        description: format!("E57, {}", counted(count, "scan", "scans")),
        schema,
    };
    let reader = ScanReader {
        path: path.to_path_buf(),
        packets: Packets::new(path, file, file_bytes),
        scans: scans.into_iter(),
        scan: None,
        left: 0,
        read: 0,
        blank: schema::blank(&header.schema),
        bits: Vec::new(),
    };
    Ok((header, Box::new(reader)))
}

/// The reference system, where the metadata name one: some programs write other things there.
fn crs_of(path: &Path, metadata: Option<&str>) -> Option<String> {
    let text = metadata?.trim();
    if text.is_empty() {
        return None;
    }
    let known = text.contains('[') || Crs::parse(text).is_ok();
    if !known {
        tracing::warn!("{}: the coordinate metadata name no reference system: {text:.80}", path.display());
    }
    known.then(|| text.to_string())
}

/// Floats that no pose moves are as fine as floats, all else is as fine as doubles.
fn precision(scans: &[Scan]) -> Precision {
    let is_single = |scan: &Scan| {
        let place = scan.cartesian.filter(|_| scan.pose.is_none() && scan.spherical.is_none());
        place.is_some_and(|place| place.attributes.iter().all(|&axis| scan.codings[axis] == Coding::Single))
    };
    if !scans.is_empty() && scans.iter().all(is_single) { Precision::Single } else { Precision::Double }
}

fn scan_of(cloud: &PointCloud, fields: Vec<Filled>, file_bytes: u64) -> Result<Scan, String> {
    let codings: Vec<Coding> = cloud.prototype.iter().map(|record| Coding::of(&record.data_type)).collect();
    for (coding, record) in codings.iter().zip(&cloud.prototype) {
        if let Coding::Scaled { scale, offset, .. } = coding
            && !(scale.is_finite() && *scale != 0.0 && offset.is_finite())
        {
            return Err(format!("scale {scale} and offset {offset} of {:?}", record.name));
        }
    }
    let bits: u64 = codings.iter().map(|coding| u64::from(coding.width())).sum();
    if bits == 0 {
        return Err("no attribute takes any bits, so that nothing says whether its points are there".into());
    }
    if u128::from(cloud.records) * u128::from(bits) > 8 * u128::from(file_bytes) {
        let most = 8 * file_bytes / bits;
        return Err(format!("{} points are counted, the file holds at most {most}: it is truncated", cloud.records));
    }
    let find = |name: &RecordName| cloud.prototype.iter().position(|record| record.name == *name);
    let place = |names: [RecordName; 3], state: RecordName| -> Option<Place> {
        let attributes = [find(&names[0])?, find(&names[1])?, find(&names[2])?];
        Some(Place { attributes, state: find(&state) })
    };
    let cartesian = place(
        [RecordName::CartesianX, RecordName::CartesianY, RecordName::CartesianZ],
        RecordName::CartesianInvalidState,
    );
    let spherical = place(
        [RecordName::SphericalRange, RecordName::SphericalAzimuth, RecordName::SphericalElevation],
        RecordName::SphericalInvalidState,
    );
    if cartesian.is_none() && spherical.is_none() {
        return Err("it has neither Cartesian nor spherical coordinates".into());
    }
    let pose = cloud.transform.as_ref().map(Pose::of).transpose()?;
    let part = |name: &str| {
        let field = fields.iter().find(|field| field.name == name);
        field.filter(|field| matches!(field.kind, Kind::F32 | Kind::F64)).map(|field| (field.kind, field.offset))
    };
    let normal = match (part("nx"), part("ny"), part("nz")) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    Ok(Scan { section: cloud.file_offset, points: cloud.records, codings, pose, cartesian, spherical, fields, normal })
}

impl Scan {
    fn value(&self, attribute: usize, bits: &[u64]) -> Result<f64, String> {
        let coding = self.codings[attribute];
        coding.value(bits[attribute]).ok_or_else(|| format!("attribute {} is beyond its maximum", attribute + 1))
    }

    /// Coordinates in the file's system; NaN where the scanner saw nothing.
    fn xyz(&self, bits: &[u64]) -> Result<[f64; 3], String> {
        let read = |place: &Option<Place>| -> Result<Option<[f64; 3]>, String> {
            let Some(place) = place else { return Ok(None) };
            // 1 is a direction without a distance, 2 nothing at all.
            if let Some(state) = place.state
                && self.value(state, bits)? != 0.0
            {
                return Ok(None);
            }
            let [a, b, c] = place.attributes;
            Ok(Some([self.value(a, bits)?, self.value(b, bits)?, self.value(c, bits)?]))
        };
        let spherical = || {
            let place = read(&self.spherical)?;
            Ok::<_, String>(place.map(|[range, azimuth, elevation]| {
                let level = range * elevation.cos();
                [level * azimuth.cos(), level * azimuth.sin(), range * elevation.sin()]
            }))
        };
        let local = match read(&self.cartesian)? {
            Some(xyz) => Some(xyz),
            None => spherical()?,
        };
        let Some(local) = local else { return Ok([f64::NAN; 3]) };
        Ok(self.pose.as_ref().map_or(local, |pose| pose.moved(local)))
    }

    /// Writes the values of a point over a blank record.
    fn fill(&self, bits: &[u64], record: &mut [u8]) -> Result<(), String> {
        for field in &self.fields {
            if let Some(invalid) = field.invalid
                && self.value(invalid, bits)? != 0.0
            {
                continue;
            }
            let to = &mut record[field.offset..];
            let coding = self.codings[field.attribute];
            if let (Kind::I64, Change::Keep, Some(whole)) =
                (field.kind, field.change, coding.whole(bits[field.attribute]))
            {
                // Not every one of these is a double.
                to[..8].copy_from_slice(&whole.to_le_bytes());
                continue;
            }
            let value = self.value(field.attribute, bits)?;
            let changed = match field.change {
                Change::Keep => value,
                Change::AddOne => value + 1.0,
                Change::FromByte => value * 257.0,
                // Limits may be those of a display, or rounded.
                Change::Spread { least, most } => {
                    ((value - least) / (most - least) * 65_535.0).round().clamp(0.0, 65_535.0)
                }
            };
            if !schema::put(field.kind, changed, to) {
                return Err(format!("`{}` of {value} is beyond the limits that the file names", field.name));
            }
        }
        if let (Some(pose), Some(normal)) = (&self.pose, self.normal) {
            let turned = pose.turned(normal.map(|(kind, offset)| kind.read(&record[offset..])));
            for ((kind, offset), value) in normal.into_iter().zip(turned) {
                schema::put(kind, value, &mut record[offset..]);
            }
        }
        Ok(())
    }
}

impl ScanReader {
    fn push(&mut self, batch: &mut Batch) -> Result<()> {
        let Some(scan) = &self.scan else { return Ok(()) };
        self.packets.next(&mut self.bits)?;
        self.read += 1;
        let begin = batch.raw.len();
        batch.raw.extend_from_slice(&self.blank);
        let done = scan.xyz(&self.bits).and_then(|xyz| {
            batch.xyz.push(xyz);
            scan.fill(&self.bits, &mut batch.raw[begin..])
        });
        done.map_err(|what| Error::format(&self.path, format!("point {}", self.read), what))
    }
}

impl PointReader for ScanReader {
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()> {
        batch.clear();
        while batch.len() < limit {
            if self.left == 0 {
                let Some(scan) = self.scans.next() else { break };
                self.packets.begin(scan.section, scan.codings.iter().map(|coding| coding.width()))?;
                self.bits.resize(scan.codings.len(), 0);
                self.left = scan.points;
                self.scan = Some(scan);
            }
            self.push(batch)?;
            self.left -= 1;
        }
        Ok(())
    }
}
