//! The georeference of a JPEG in its EXIF block (CIPA DC-008, Exif 2.32).
//!
//! A copy is written: coded pixels and all other segments byte for byte, and of an EXIF block that is there everything
//! but the old place (a maker's notes keep their positions, since the new directory goes behind the old block). The
//! block gets
//!
//! - what every viewer of photographs reads: latitude and longitude (WGS 84) of the middle of the image, the direction
//!   of its top from true north, the largest expected error of a point in a corner (95 %) and what the change of datum
//!   adds to it;
//! - the GeoTIFF tags of transform and CRS in the first directory, as in a TIFF, which EXIF is: the place of every
//!   pixel.

use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::Path;

use crate::georef::tags::RasterType;
use crate::georef::tags::directory::{Appender, Shape, ordered};
use crate::georef::tags::keys::{GEO_TAGS, GeoTag, Values, geo_tags};
use crate::result::RunResult;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::{Accuracy, Coordinate, Crs};
use autoref_raster::error::{Error, Result};
use autoref_raster::tiff::container::ByteOrder;

/// Square of the first eccentricity.
const WGS84_E2: f64 = 0.006_694_379_990_14;
/// Pointer from the first directory to that of the place.
const GPS_DIRECTORY: u16 = 34_853;
const EXIF_NAME: &[u8; 6] = b"Exif\0\0";
/// A segment counts its own length in two bytes.
const MOST_BLOCK_BYTES: usize = 65_533 - EXIF_NAME.len();
/// Colour profiles and thumbnails come to a few megabytes; beyond this it is no photograph.
const MOST_HEAD_BYTES: usize = 64 << 20;

/// What is written about the place.
#[derive(Clone, Debug)]
pub struct Place {
    transform: GeoTransform,
    crs: Option<Crs>,
    geo: Vec<GeoTag>,
    error_95_m: Option<f64>,
    worst_accuracy_m: f64,
    /// What the tags cannot hold, in words.
    pub lost: Option<String>,
}

impl Place {
    /// The place that a result states. `worst_accuracy_m`: what is demanded of the change of datum to WGS 84.
    ///
    /// # Errors
    /// When GDAL has no GeoTIFF keys for the CRS.
    pub fn of(transform: &GeoTransform, crs: Option<&Crs>, result: &RunResult, worst_accuracy_m: f64) -> Result<Place> {
        let (geo, lost) = geo_tags(transform, crs, RasterType::PixelIsArea)?;
        let corners = result.solved().map_or(&[][..], |solved| &solved.expected_errors);
        let error_95_m = corners.iter().map(|c| c.expected.point_95_m).reduce(f64::max).filter(|e| e.is_finite());
        let crs = crs.filter(|crs| !crs.is_local()).cloned();
        let lost = match crs {
            Some(_) => lost,
            None => Some("EXIF has the transform but neither latitude nor longitude: no CRS is known".into()),
        };
        Ok(Place { transform: *transform, crs, geo, error_95_m, worst_accuracy_m, lost })
    }

    /// The tags of the place of an image of `size_px`, in order of their numbers.
    fn gps_tags(&self, [width, height]: [u32; 2]) -> Result<Option<Vec<GeoTag>>> {
        let Some(crs) = &self.crs else { return Ok(None) };
        let (x, y) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        // The middle, and a place towards the top of the image.
        let mut points = [y, 0.0].map(|y| {
            let map = self.transform.apply(PixelPoint { x, y });
            Coordinate { x: map.easting, y: map.northing, height: None }
        });
        let datum_m = match to_wgs84(crs, &mut points, self.worst_accuracy_m)? {
            Accuracy::Exact => Some(0.0),
            Accuracy::Metres(metres) => Some(metres),
            Accuracy::Unstated => None,
        };
        let [middle, top] = points;
        // Degrees of longitude in those of latitude, by the ellipsoid's two radii of curvature.
        let latitude = middle.y.to_radians();
        let radii = (1.0 - WGS84_E2 * latitude.sin().powi(2)) / (1.0 - WGS84_E2);
        let east = (top.x - middle.x) * latitude.cos() * radii;
        let direction_deg = east.atan2(top.y - middle.y).to_degrees().rem_euclid(360.0);
        let reference = |tag, letter: &[u8]| GeoTag { tag, values: Values::Ascii([letter, b"\0"].concat()) };
        let rationals = |tag, values: Vec<[u32; 2]>| GeoTag { tag, values: Values::Rationals(values) };
        let mut tags = vec![
            GeoTag { tag: 0, values: Values::Bytes(vec![2, 3, 0, 0]) },
            reference(1, if middle.y < 0.0 { b"S" } else { b"N" }),
            rationals(2, sexagesimal(middle.y)),
            reference(3, if middle.x < 0.0 { b"W" } else { b"E" }),
            rationals(4, sexagesimal(middle.x)),
            reference(16, b"T"),
            rationals(17, vec![[(direction_deg * 1e4).round() as u32 % 3_600_000, 10_000]]),
            reference(18, b"WGS-84"),
        ];
        // An error without the part that nobody states would be too small.
        let error_m = self.error_95_m.zip(datum_m).map(|(error, datum)| error + datum);
        let millimetres = |e: f64| (e * 1e3).ceil().min(4e9) as u32;
        tags.extend(error_m.map(|e| rationals(31, vec![[millimetres(e), 1000]])));
        Ok(Some(tags))
    }
}

/// Brings places into longitude and latitude of WGS 84, the datum of EXIF.
///
/// # Errors
/// When the change of datum is worse than `worst_accuracy_m`, or there is none.
fn to_wgs84(crs: &Crs, points: &mut [Coordinate], worst_accuracy_m: f64) -> Result<Accuracy> {
    let wgs84 = Crs::from_epsg(4326)?;
    crs.transform(points, &wgs84, worst_accuracy_m).map_err(|error| {
        match (error, crs.transform(&mut points.to_vec(), &wgs84, f64::INFINITY)) {
            (Error::CoarseDatum { what, install, .. }, Ok(Accuracy::Metres(metres))) => Error::CoarseDatum {
                what: format!("--write exif gives the place in WGS 84: {what}"),
                install,
                otherwise: format!("accept it with --datum-accuracy {metres}, or leave exif out of --write"),
            },
            (error, _) => error,
        }
    })
}

/// Refuses, before any work, a CRS that cannot be brought to WGS 84 well enough around these places.
///
/// # Errors
/// As [`write`]; [`Error::Usage`] when `worst_accuracy_m` is no length.
pub(super) fn check_datum(crs: Option<&Crs>, around: &[Coordinate], worst_accuracy_m: f64) -> Result<()> {
    if worst_accuracy_m.is_nan() || worst_accuracy_m < 0.0 {
        return Err(Error::usage("--datum-accuracy is no length", "give metres, 0 or more"));
    }
    let Some(crs) = crs.filter(|crs| !crs.is_local()) else { return Ok(()) };
    to_wgs84(crs, &mut around.to_vec(), worst_accuracy_m).map(|_| ())
}

/// Degrees, minutes, and seconds to 0.1 mm on the ground (1e-6 of a second is 0.03 mm).
fn sexagesimal(degrees: f64) -> Vec<[u32; 2]> {
    const PARTS: f64 = 1e6;
    let all = (degrees.abs() * 3600.0 * PARTS).round() as u64;
    let (minutes, parts) = (all / (60 * PARTS as u64), all % (60 * PARTS as u64));
    vec![[(minutes / 60) as u32, 1], [(minutes % 60) as u32, 1], [parts as u32, PARTS as u32]]
}

/// Refuses, before any work, what is no JPEG.
///
/// # Errors
/// [`Error::Unsupported`], [`Error::Io`], or [`Error::Format`] for a JPEG that is broken before its pixels.
pub fn check(image: &Path) -> Result<()> {
    Head::read(image).map(|_| ())
}

/// Writes the copy.
///
/// # Errors
/// Those of [`check`]; when the CRS has no relation to WGS 84 that is good enough; [`Error::Limit`] when the block is
/// full.
pub fn write(image: &Path, to: &Path, place: &Place) -> Result<()> {
    let mut head = Head::read(image)?;
    let old = head.exif.map(|at| head.segments.remove(at)).map(|segment| segment.bytes[10..].to_vec());
    let block = block(image, old.as_deref(), &place.geo, place.gps_tags(head.size_px)?)?;
    if block.len() > MOST_BLOCK_BYTES {
        return Err(Error::Limit {
            what: format!("{}: its EXIF block has no room for the georeference", image.display()),
            needed: block.len() as u64,
            allowed: MOST_BLOCK_BYTES as u64,
            remedy: "use --write world,aux".into(),
        });
    }
    let out = File::create(to).map_err(|e| Error::io(to, "create", e))?;
    let mut out = BufWriter::new(out);
    let length = ((block.len() + EXIF_NAME.len() + 2) as u16).to_be_bytes();
    // EXIF stands first by its standard, and so does JFIF by its own: readers take them in this order.
    let jfif = head.segments.iter().take_while(|s| s.bytes[1] == 0xE0).count();
    let mut write = || -> std::io::Result<()> {
        out.write_all(&[0xFF, 0xD8])?;
        head.segments[..jfif].iter().try_for_each(|s| out.write_all(&s.bytes))?;
        for part in [&[0xFF, 0xE1][..], &length, EXIF_NAME, &block] {
            out.write_all(part)?;
        }
        head.segments[jfif..].iter().try_for_each(|s| out.write_all(&s.bytes))?;
        std::io::copy(&mut head.rest, &mut out)?;
        out.flush()
    };
    write().map_err(|e| Error::io(to, "write", e))
}

/// A marker with its length and content.
struct Segment {
    bytes: Vec<u8>,
}

/// What stands before the coded pixels.
struct Head {
    segments: Vec<Segment>,
    /// Which of them is EXIF.
    exif: Option<usize>,
    size_px: [u32; 2],
    /// From the marker of the first scan on.
    rest: Box<dyn Read>,
}

impl Head {
    fn read(image: &Path) -> Result<Head> {
        let io = |e| Error::io(image, "read", e);
        let broken = |place: &str| Error::format(image, place, "the JPEG is broken before its pixels");
        let mut file = BufReader::new(File::open(image).map_err(|e| Error::io(image, "open", e))?);
        let mut start = [0; 2];
        if file.read(&mut start).map_err(io)? < 2 || start != [0xFF, 0xD8] {
            return Err(Error::unsupported(image, "EXIF in a file that is no JPEG", "use --write world,aux"));
        }
        let (mut segments, mut exif, mut size_px, mut total) = (Vec::new(), None, None, 0);
        loop {
            let mut bytes = vec![0; 2];
            file.read_exact(&mut bytes).map_err(|_| broken("where a marker should stand"))?;
            // Any number of fill bytes may stand before a marker.
            while bytes == [0xFF, 0xFF] {
                file.read_exact(&mut bytes[1..]).map_err(|_| broken("where a marker should stand"))?;
            }
            match bytes[..] {
                [0xFF, 0xDA] => {
                    let size_px = size_px.ok_or_else(|| broken("its frame header is missing"))?;
                    let rest = Box::new(std::io::Cursor::new(bytes).chain(file));
                    return Ok(Head { segments, exif, size_px, rest });
                }
                [0xFF, 0x01 | 0xD0..=0xD9] | [0xFF, 0x00] => return Err(broken("a marker that has no place there")),
                [0xFF, _] => {}
                _ => return Err(broken("where a marker should stand")),
            }
            bytes.resize(4, 0);
            file.read_exact(&mut bytes[2..]).map_err(|_| broken("in a segment"))?;
            let length = usize::from(u16::from_be_bytes([bytes[2], bytes[3]]));
            total += length;
            if length < 2 || total > MOST_HEAD_BYTES {
                return Err(broken("the length of a segment"));
            }
            bytes.resize(2 + length, 0);
            file.read_exact(&mut bytes[4..]).map_err(|_| broken("in a segment"))?;
            // Frame headers are C0 to CF without tables (C4), arithmetic conditions (CC) and the reserved C8.
            if matches!(bytes[1], 0xC0..=0xCF) && !matches!(bytes[1], 0xC4 | 0xC8 | 0xCC) && length >= 8 {
                let number = |at: usize| u32::from(u16::from_be_bytes([bytes[at], bytes[at + 1]]));
                size_px = Some([number(7), number(5)]);
            }
            if exif.is_none() && bytes[1] == 0xE1 && bytes[4..].starts_with(EXIF_NAME) {
                exif = Some(segments.len());
            }
            segments.push(Segment { bytes });
        }
    }
}

/// An old block with new directories behind it, or a new one.
fn block(image: &Path, old: Option<&[u8]>, geo: &[GeoTag], gps: Option<Vec<GeoTag>>) -> Result<Vec<u8>> {
    let parsed = match old {
        Some(bytes) => Some(first_directory(bytes).ok_or_else(|| {
            Error::format(image, "its EXIF block", "is broken; take it out first (exiftool -exif:all= FILE)")
        })?),
        None => None,
    };
    let empty = || (ByteOrder::Little, Vec::new(), 0);
    let (order, mut entries, next) = parsed.unwrap_or_else(empty);
    let mut bytes = old.map_or_else(|| b"II*\0\0\0\0\0".to_vec(), <[u8]>::to_vec);
    let mut out = Appender::new(order, Shape::CLASSIC, bytes.len() as u64);
    entries.retain(|(tag, _)| !GEO_TAGS.contains(tag) && *tag != GPS_DIRECTORY);
    let mut add = |out: &mut Appender, tag: &GeoTag| entries.push((tag.tag, out.entry(tag)));
    geo.iter().for_each(|tag| add(&mut out, tag));
    if let Some(tags) = gps {
        let inner: Vec<(u16, Vec<u8>)> = tags.iter().map(|tag| (tag.tag, out.entry(tag))).collect();
        out.align();
        let at = out.position() as u32;
        out.directory(&inner, 0);
        add(&mut out, &GeoTag { tag: GPS_DIRECTORY, values: Values::Longs(vec![at]) });
    }
    entries.sort_by_key(|(tag, _)| *tag);
    out.align();
    let first = ordered(order, out.position(), 4);
    out.directory(&entries, next);
    bytes[4..8].copy_from_slice(&first);
    bytes.extend(out.bytes);
    Ok(bytes)
}

/// Byte order, entries with their tags, and position of the second directory, of a block that starts as a TIFF.
type Parsed = (ByteOrder, Vec<(u16, Vec<u8>)>, u64);

fn first_directory(bytes: &[u8]) -> Option<Parsed> {
    let order = match bytes.get(..4)? {
        b"II*\0" => ByteOrder::Little,
        b"MM\0*" => ByteOrder::Big,
        _ => return None,
    };
    let at = order.number(bytes.get(4..8)?) as usize;
    let count = order.number(bytes.get(at..at.checked_add(2)?)?) as usize;
    let size = Shape::CLASSIC.entry_bytes as usize;
    let end = at + 2 + count * size;
    let table = bytes.get(at + 2..end)?;
    let entries = table.chunks_exact(size).map(|row| (order.number(&row[..2]) as u16, row.to_vec())).collect();
    // Some cameras leave out the pointer when there is no thumbnail.
    let next = bytes.get(end..end + 4).map_or(0, |pointer| order.number(pointer));
    Some((order, entries, next))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_are_split_without_a_sixtieth_second() {
        assert_eq!(sexagesimal(-63.5), [[63, 1], [30, 1], [0, 1_000_000]]);
        assert_eq!(sexagesimal(10.999_999_999_999), [[11, 1], [0, 1], [0, 1_000_000]]);
    }

    #[test]
    fn an_old_block_keeps_all_but_the_place() {
        // Big-endian: model name far away, a place that goes, and a second directory at 90.
        let mut old = b"MM\0*\0\0\0\x08".to_vec();
        old.extend([0, 2]);
        old.extend([1, 16, 0, 2, 0, 0, 0, 6, 0, 0, 0, 60]);
        old.extend([0x88, 0x25, 0, 4, 0, 0, 0, 1, 0, 0, 0, 70]);
        old.extend([0, 0, 0, 90]);
        old.resize(60, 0);
        old.extend(b"KITE7\0");
        old.resize(120, 7);
        let geo = [GeoTag { tag: 33_550, values: Values::Doubles(vec![0.5, 0.5, 0.0]) }];
        let gps = vec![GeoTag { tag: 1, values: Values::Ascii(b"N\0".to_vec()) }];
        let new = block(Path::new("a.jpg"), Some(&old), &geo, Some(gps)).expect("whole");
        assert_eq!(new[8..120], old[8..]);
        let (order, entries, next) = first_directory(&new).expect("a directory");
        assert_eq!((order, next), (ByteOrder::Big, 90));
        assert_eq!(entries.iter().map(|e| e.0).collect::<Vec<_>>(), [272, 33_550, GPS_DIRECTORY]);
        assert_eq!(entries[0].1[8..], [0, 0, 0, 60]);
        for cut in 0..40 {
            assert!(block(Path::new("a.jpg"), Some(&old[..cut]), &geo, None).is_err() || cut >= 34, "{cut}");
        }
    }
}
