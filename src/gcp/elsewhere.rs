//! What would bring the points of a list, which lie elsewhere, into the area of use of a CRS or onto the image, and
//! what somebody does then.

use std::fmt;
use std::path::Path;

use crate::gcp::options::ImageGeoreference;
use crate::gcp::raw::RawPoint;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::units::FOOT_M;

/// Whether titles of columns stand over the points, which may name a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Titles {
    MayNameUnits,
    AreNone,
}

/// Why all points lie elsewhere.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Elsewhere {
    /// The CRS's own zone stands before the eastings, ...
    ZoneNumber(u32),
    /// ... or that of another zone.
    OtherZoneNumber(u32),
    /// Leading digits are other than the image's, in words.
    Digits(String),
    MinusSigns,
    MinusSignsExchanged,
    OtherZone,
    Feet,
    Millimetres,
}

impl fmt::Display for Elsewhere {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Elsewhere::ZoneNumber(zone) => {
                write!(f, "they would lie in it without the zone's number {zone} before the eastings")
            }
            Elsewhere::OtherZoneNumber(zone) => write!(f, "the {zone} before the eastings is another zone's number"),
            Elsewhere::Digits(digits) => {
                write!(f, "they would lie on the image with {digits}")
            }
            Elsewhere::MinusSigns => f.write_str("they would lie in it with a minus sign before both coordinates"),
            Elsewhere::MinusSignsExchanged => {
                f.write_str("they would lie in it with a minus sign before both coordinates, and these exchanged")
            }
            Elsewhere::OtherZone => {
                f.write_str("by their size they are metres of another zone, or of the other hemisphere")
            }
            Elsewhere::Feet => f.write_str("they would lie in it if they were feet, brought to metres"),
            Elsewhere::Millimetres => f.write_str("they would lie in it if they were millimetres, brought to metres"),
        }
    }
}

/// The reason behind a message, in brackets.
pub(super) fn in_brackets(how: &Option<Elsewhere>) -> String {
    how.as_ref().map_or(String::new(), |how| format!(" ({how})"))
}

impl Elsewhere {
    /// What would bring all points into the CRS's area of use, or onto the image.
    pub fn of(points: &[RawPoint], crs: &Crs, image: Option<&ImageGeoreference>) -> Option<Elsewhere> {
        const ZONE_M: f64 = 1e6;
        const LEAST_MM: f64 = 1e8;
        /// Metres within the zones of UTM, from the equator to 84°; feet of eastings in the middle of a zone are more.
        const UTM_E: std::ops::RangeInclusive<f64> = 1.6e5..=8.4e5;
        const UTM_N: std::ops::RangeInclusive<f64> = 0.0..=1e7;
        // International and US survey feet are the same here.
        let all = |place: &dyn Fn(f64, f64) -> (f64, f64)| {
            points.iter().all(|p| {
                let (e, n) = place(p.gcp.easting, p.gcp.northing);
                crs.covers(e, n) == Some(true)
            })
        };
        let zone = (points.first()?.gcp.easting / ZONE_M).floor();
        if (1.0..=60.0).contains(&zone) && all(&|e, n| (e - zone * ZONE_M, n)) {
            let (title, zone) = (crs.title(), zone as u32);
            let own = title.split("zone ").nth(1).map(|rest| rest.split(|c: char| !c.is_ascii_digit()).next());
            return match own {
                Some(Some(own)) if own == zone.to_string() => Some(Elsewhere::ZoneNumber(zone)),
                Some(_) => Some(Elsewhere::OtherZoneNumber(zone)),
                None => None,
            };
        }
        if let Some(digits) = image.and_then(|image| digits_to(image, points, crs)) {
            return Some(Elsewhere::Digits(digits));
        }
        if all(&|e, n| (-e, -n)) {
            return Some(Elsewhere::MinusSigns);
        }
        if all(&|e, n| (-n, -e)) {
            return Some(Elsewhere::MinusSignsExchanged);
        }
        if all(&|e, n| (e * FOOT_M, n * FOOT_M)) {
            // Where every number is one that metres have in some zone of UTM, as its edges are narrow, that is
            // likelier.
            let is_of_zones = |p: &RawPoint| UTM_E.contains(&p.gcp.easting) && UTM_N.contains(&p.gcp.northing);
            let is_other_zone = crs.title().contains("UTM zone") && points.iter().all(is_of_zones);
            return Some(if is_other_zone { Elsewhere::OtherZone } else { Elsewhere::Feet });
        }
        // A hundred kilometres. What is less in millimetres lies at the corner of a zone, on the equator.
        let far = points.iter().all(|p| p.gcp.easting.abs().max(p.gcp.northing.abs()) >= LEAST_MM);
        (far && all(&|e, n| (e / 1000.0, n / 1000.0))).then_some(Elsewhere::Millimetres)
    }

    /// What to do, such that the list is then read: to keep points where they lie by mistake would help nobody.
    pub fn remedy(&self, path: &Path, titles: Titles) -> String {
        let is_drawing = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("dxf"));
        match self {
            Elsewhere::Feet | Elsewhere::Millimetres if is_drawing => {
                "scale the drawing to metres, or set its unit ($INSUNITS)".to_owned()
            }
            Elsewhere::ZoneNumber(zone) => format!("take the {zone} away from all eastings"),
            Elsewhere::OtherZoneNumber(zone) => {
                format!("take the {zone} away from all eastings, and give the --crs of zone {zone}")
            }
            Elsewhere::Digits(_) => "correct the coordinates so, or give the --crs that they are in".to_owned(),
            Elsewhere::Millimetres => "call the columns `Easting (mm)` and `Northing (mm)`".to_owned(),
            Elsewhere::MinusSigns => "write both with a minus sign".to_owned(),
            Elsewhere::MinusSignsExchanged => {
                "write easting = −Y (westing) and northing = −X (southing), under these titles".to_owned()
            }
            Elsewhere::Feet if titles == Titles::MayNameUnits => {
                "call the columns `Easting (US ft)` and `Northing (US ft)`, or `(ift)` where they are international \
                 feet, or give a --crs that counts in feet"
                    .to_owned()
            }
            Elsewhere::Feet | Elsewhere::OtherZone => "give the --crs that they are in".to_owned(),
        }
    }

    /// Whether the numbers are larger than those of a local system.
    pub fn is_of_large_numbers(&self) -> bool {
        matches!(self, Elsewhere::ZoneNumber(_) | Elsewhere::Feet | Elsewhere::Millimetres)
    }
}

/// The leading digits with which the points would lie on the image, in words.
fn digits_to(image: &ImageGeoreference, points: &[RawPoint], crs: &Crs) -> Option<String> {
    const FARTHEST_M: f64 = 2_000.0;
    let (e, n) = centre_in(image, crs)?;
    let count = points.len() as f64;
    let mean = |of: &dyn Fn(&RawPoint) -> f64| points.iter().map(of).sum::<f64>() / count;
    let wanted = (e - mean(&|p| p.gcp.easting), n - mean(&|p| p.gcp.northing));
    let (corner, middle) = (image.transform?.apply(PixelPoint { x: 0.0, y: 0.0 }), image.middle()?);
    let reach = (corner.easting - middle.easting).hypot(corner.northing - middle.northing);
    leading_digits(wanted, reach.min(FARTHEST_M))
}

/// What, added to all coordinates, is about as much as wanted (east, north) when only leading digits are changed: whole
/// numbers of ten kilometres. In words; `None` where it is not so.
pub fn leading_digits(wanted_m: (f64, f64), agrees_m: f64) -> Option<String> {
    const STEP_M: f64 = 10_000.0;
    let steps = |m: f64| Some((m / STEP_M).round()).filter(|steps| (m - steps * STEP_M).abs() <= agrees_m);
    let (east, north) = (steps(wanted_m.0)? * STEP_M, steps(wanted_m.1)? * STEP_M);
    let said = |by: f64, axis: &str| (by != 0.0).then(|| format!("{by:+.0} in all {axis}"));
    let both: Vec<String> = said(east, "eastings").into_iter().chain(said(north, "northings")).collect();
    (!both.is_empty()).then(|| format!("{}: digits were left out, or put before them", both.join(" and ")))
}

/// The middle of an image in another CRS.
fn centre_in(image: &ImageGeoreference, crs: &Crs) -> Option<(f64, f64)> {
    let MapPoint { easting, northing } = image.middle()?;
    let mut point = [Coordinate { x: easting, y: northing, height: None }];
    Crs::parse(&image.crs_wkt).ok()?.transform(&mut point, crs, f64::INFINITY).ok()?;
    Some((point[0].x, point[0].y))
}
