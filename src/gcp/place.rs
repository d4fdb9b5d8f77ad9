//! Whether a list lies where its CRS is used, and where the image says it is: exchanged columns, a wrong CRS and slips
//! of a digit show here, before a pixel is read.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::options::{GcpOptions, ImageGeoreference};
use crate::gcp::raw::RawPoint;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::error::{Error, Result};
use autoref_raster::units::FOOT_M;
use autoref_raster::words::first_of;

/// No coordinate on Earth is larger, in metres, feet or degrees.
const LARGEST_COORDINATE: f64 = 1e9;
/// The image's own place tells exchanged columns when they bring the points this near, ...
const NEAR_DEG: f64 = 1.0;
/// ... and, as they stand, the points lie this far off.
const FAR_DEG: f64 = 5.0;

const MILLIMETRES: &str = "they would lie in it if they were millimetres, brought to metres";
const FEET: &str = "they would lie in it if they were feet, brought to metres";
const MINUS: &str = "they would lie in it with a minus sign before both coordinates";
const MINUS_EXCHANGED: &str = "they would lie in it with a minus sign before both coordinates, and these exchanged";
const OTHER_ZONE: &str = "by their size they are metres of another zone, or of the other hemisphere";

/// Sets aside what lies outside the CRS's area of use, or refuses when nothing lies inside; exchanges the columns where
/// that mends it and the caller asked for it.
///
/// # Errors
/// [`Error::Format`] with the remedy: numbers that are no coordinates, columns that are exchanged, a CRS that is not
/// theirs.
pub(super) fn check(
    path: &Path,
    points: &mut Vec<RawPoint>,
    (crs, target): (Option<&Crs>, Option<&Crs>),
    options: &GcpOptions,
    notes: &mut Vec<String>,
) -> Result<()> {
    let Some(crs) = crs else {
        if options.fix_axes {
            notes.push(format!(
                "{}: --fix-axes exchanged nothing: without a CRS nothing shows the order",
                path.display()
            ));
        }
        return refuse_absurd(path, points);
    };
    let shown_in = if are_exchanged(points, crs, options.image.as_ref()) {
        Some(crs.clone())
    } else {
        // The outputs lie in the CRS that is asked for, the image in its own.
        let own = options.image.as_ref().and_then(|image| Crs::parse(&image.crs_wkt).ok());
        let others = [target.cloned(), own].into_iter().flatten();
        others.filter(|other| !other.is_local()).find(|other| are_exchanged_for(points, crs, other))
    };
    let shown_in = shown_in.as_ref();
    let axes = if crs.is_geographic() { "longitude and latitude" } else { "easting and northing" };
    if options.fix_axes && !points.is_empty() && shown_in.is_none() {
        let fits_exchanged = points.iter().all(|p| crs.covers(p.gcp.northing, p.gcp.easting) == Some(true));
        let why = if fits_exchanged {
            let title = crs.title();
            format!("exchanged nothing: both orders lie in {title}; exchange the columns' titles if they are wrong")
        } else {
            "found nothing to exchange".into()
        };
        notes.push(format!("{}: --fix-axes {why}", path.display()));
    } else if let Some(shown_in) = shown_in {
        if !options.fix_axes {
            return Err(exchanged(path, points.len(), shown_in, axes));
        }
        points.iter_mut().for_each(|p| std::mem::swap(&mut p.gcp.easting, &mut p.gcp.northing));
        notes.push(format!("{}: {axes} were exchanged in all points (--fix-axes)", path.display()));
    }
    if !options.keep_outside {
        set_aside(path, points, crs, options.image.as_ref(), notes)?;
    }
    refuse_absurd(path, points)
}

fn refuse_absurd(path: &Path, points: &[RawPoint]) -> Result<()> {
    let absurd = |v: f64| v.abs() > LARGEST_COORDINATE;
    match points.iter().find(|p| absurd(p.gcp.easting) || absurd(p.gcp.northing)) {
        Some(p) => Err(Error::format(
            path,
            &p.place,
            format!(
                "point `{}` lies at {:e}, {:e}, which is nowhere; correct or remove the row",
                p.gcp.name, p.gcp.easting, p.gcp.northing
            ),
        )),
        None => Ok(()),
    }
}

/// Whether all points lie wrong as they stand and right with their coordinates exchanged, by the CRS's area of use or
/// by the image's own place.
pub(super) fn are_exchanged(points: &[RawPoint], crs: &Crs, image: Option<&ImageGeoreference>) -> bool {
    if points.is_empty() {
        return false;
    }
    let all = |covers: &dyn Fn(f64, f64) -> bool| points.iter().all(|p| covers(p.gcp.easting, p.gcp.northing));
    if all(&|e, n| crs.covers(e, n) == Some(false)) {
        return all(&|e, n| crs.covers(n, e) == Some(true));
    }
    let Some(image) = image else { return false };
    if are_exchanged_on(points, crs, image) {
        return true;
    }
    let Some(centre) = centre_of(image) else { return false };
    let away = |e: f64, n: f64| {
        let (longitude, latitude) = crs.longitude_latitude(e, n)?;
        let turn = (longitude - centre.0 + 180.0).rem_euclid(360.0) - 180.0;
        Some((turn * centre.1.to_radians().cos()).hypot(latitude - centre.1))
    };
    all(&|e, n| away(e, n).is_none_or(|deg| deg > FAR_DEG)) && all(&|e, n| away(n, e).is_some_and(|deg| deg < NEAR_DEG))
}

/// Whether all points lie on the image with their coordinates exchanged, and none as it stands. Told only in the
/// image's own CRS.
fn are_exchanged_on(points: &[RawPoint], crs: &Crs, image: &ImageGeoreference) -> bool {
    if !Crs::parse(&image.crs_wkt).is_ok_and(|own| own.label() == crs.label()) {
        return false;
    }
    let holds = |easting: f64, northing: f64| image.holds(crs, MapPoint { easting, northing });
    points.iter().all(|p| {
        let (e, n) = (p.gcp.easting, p.gcp.northing);
        holds(e, n) == Some(false) && holds(n, e) == Some(true)
    })
}

/// Whether all degrees lie outside the area of use of the CRS that is asked for, and inside when they are exchanged.
pub(super) fn are_exchanged_for(points: &[RawPoint], crs: &Crs, target: &Crs) -> bool {
    let covers = |e: f64, n: f64| {
        let (longitude, latitude) = crs.longitude_latitude(e, n)?;
        target.covers_degrees(longitude, latitude)
    };
    crs.is_geographic()
        && points.iter().all(|p| {
            let (e, n) = (p.gcp.easting, p.gcp.northing);
            covers(e, n) == Some(false) && covers(n, e) == Some(true)
        })
}

/// What to think of where the pattern of the list is not found: degrees that no other place confirms, or coordinates of
/// the size that the other one has in UTM.
pub(super) fn may_be_exchanged(path: &Path, gcps: &[Gcp], crs: Option<&Crs>, options: &GcpOptions) -> Option<String> {
    let name = path.display();
    match crs {
        Some(crs) if crs.is_geographic() && options.to_crs.is_none() => {
            let could_be =
                |gcp: &Gcp| gcp.easting.abs() <= 90.0 && crs.covers(gcp.northing, gcp.easting) != Some(false);
            let placed = options.image.as_ref().is_some_and(|image| image.transform.is_some());
            (!placed && gcps.iter().all(could_be)).then(|| {
                format!(
                    "{name}: latitude and longitude may be exchanged: exchange the columns, or give --fix-axes with the \
                     --to-crs of the survey, which shows it"
                )
            })
        }
        None => {
            let is_utm = |e: f64, n: f64| (1e5..1e6).contains(&e) && (1e6..1e7).contains(&n);
            if gcps.iter().all(|gcp| is_utm(gcp.easting, gcp.northing)) {
                return None;
            }
            Some(if gcps.iter().all(|gcp| is_utm(gcp.northing, gcp.easting)) {
                format!(
                    "{name}: by the size of the numbers easting and northing may be exchanged: exchange the titles, or \
                     give --crs and --fix-axes"
                )
            } else {
                format!(
                    "{name}: local coordinates do not show whether easting and northing are exchanged, as they are \
                     where x counts north: exchange the titles (or name the columns easting, northing) and try again"
                )
            })
        }
        Some(_) => None,
    }
}

/// Longitude and latitude of the middle of an image.
fn centre_of(image: &ImageGeoreference) -> Option<(f64, f64)> {
    let MapPoint { easting, northing } = image.middle()?;
    Crs::parse(&image.crs_wkt).ok()?.longitude_latitude(easting, northing)
}

fn all_lie(points: usize) -> String {
    if points == 1 { "the only point lies".to_owned() } else { format!("all {points} points lie") }
}

fn exchanged(path: &Path, points: usize, crs: &Crs, axes: &str) -> Error {
    Error::format(
        path,
        "the coordinates",
        format!(
            "{} where they cannot be in {}, and right with {axes} exchanged; exchange the columns, or give --fix-axes",
            all_lie(points),
            crs.title()
        ),
    )
}

fn set_aside(
    path: &Path,
    points: &mut Vec<RawPoint>,
    crs: &Crs,
    image: Option<&ImageGeoreference>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let outside = |p: &RawPoint| crs.covers(p.gcp.easting, p.gcp.northing) == Some(false);
    let names: Vec<String> = points.iter().filter(|p| outside(p)).map(|p| p.gcp.name.clone()).collect();
    if names.is_empty() {
        return Ok(());
    }
    refuse_elsewhere(path, points, crs, image, ", or --force outside-area")?;
    points.retain(|p| !outside(p));
    notes.push(format!(
        "{}: set aside, outside the area of use of {}: {} (--force outside-area keeps them)",
        path.display(),
        crs.title(),
        first_of(&names, 8)
    ));
    Ok(())
}

/// For a list that is written again as it is: what shows that the CRS is not that of the coordinates is refused, and
/// single points outside its area of use are named.
///
/// # Errors
/// [`Error::Format`] with the remedy.
pub(super) fn refuse_known_mistakes(
    path: &Path,
    points: &[RawPoint],
    crs: &Crs,
    notes: &mut Vec<String>,
) -> Result<()> {
    let axes = if crs.is_geographic() { "longitude and latitude" } else { "easting and northing" };
    if are_exchanged(points, crs, None) {
        let title = crs.title();
        let what = format!(
            "{} where they cannot be in {title}, and right with {axes} exchanged; exchange the columns",
            all_lie(points.len())
        );
        return Err(Error::format(path, "the coordinates", what));
    }
    refuse_elsewhere(path, points, crs, None, "")?;
    refuse_absurd(path, points)?;
    let outside = |p: &&RawPoint| crs.covers(p.gcp.easting, p.gcp.northing) == Some(false);
    let names: Vec<String> = points.iter().filter(outside).map(|p| p.gcp.name.clone()).collect();
    if !names.is_empty() {
        let title = crs.title();
        notes.push(format!("{}: outside the area of use of {title}: {}", path.display(), first_of(&names, 8)));
    }
    Ok(())
}

/// Refuses points of which none lies in the CRS's area of use; `way_out` is what else the caller may do.
///
/// # Errors
/// [`Error::Format`] with what would bring them there.
pub(super) fn refuse_elsewhere(
    path: &Path,
    points: &[RawPoint],
    crs: &Crs,
    image: Option<&ImageGeoreference>,
    way_out: &str,
) -> Result<()> {
    if points.is_empty() || points.iter().any(|p| crs.covers(p.gcp.easting, p.gcp.northing) != Some(false)) {
        return Ok(());
    }
    let how = inside_otherwise(points, crs, image);
    // To keep feet where they lie as metres would help nobody.
    let is_drawing = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("dxf"));
    let is_of_other_unit = [MILLIMETRES, FEET].iter().any(|unit| how.as_deref() == Some(*unit));
    let remedy = if is_drawing && is_of_other_unit {
        "scale the drawing to metres, or set its unit ($INSUNITS)".to_owned()
    } else if how.as_deref() == Some(MILLIMETRES) {
        "call the columns `Easting (mm)` and `Northing (mm)`".to_owned()
    } else if how.as_deref() == Some(MINUS) {
        "write both with a minus sign".to_owned()
    } else if how.as_deref() == Some(MINUS_EXCHANGED) {
        "write easting = −Y (westing) and northing = −X (southing), under these titles".to_owned()
    } else if how.as_deref() == Some(FEET) && !way_out.is_empty() {
        "call the columns `Easting (US ft)` and `Northing (US ft)`, or `(ift)` where they are international feet, or \
         give a --crs that counts in feet"
            .to_owned()
    } else {
        format!("give the --crs that they are in{way_out}")
    };
    Err(Error::format(
        path,
        "the coordinates",
        format!(
            "{} outside the area of use of {}{}; {remedy}",
            all_lie(points.len()),
            crs.title(),
            how.map_or(String::new(), |how| format!(" ({how})"))
        ),
    ))
}

/// What would bring all points into the CRS's area of use, or onto the image: feet, millimetres, the zone's number
/// before the eastings, leading digits left out.
pub(super) fn inside_otherwise(points: &[RawPoint], crs: &Crs, image: Option<&ImageGeoreference>) -> Option<String> {
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
        let title = crs.title();
        let own = title.split("zone ").nth(1).map(|rest| rest.split(|c: char| !c.is_ascii_digit()).next());
        return match own {
            Some(Some(own)) if own == zone.to_string() => {
                Some(format!("they would lie in it without the zone's number {zone} before the eastings"))
            }
            Some(_) => Some(format!("the {zone} before the eastings is another zone's number")),
            None => None,
        };
    }
    if let Some(image) = image
        && let Some((e, n)) = centre_in(image, crs)
    {
        let count = points.len() as f64;
        let mean = |of: &dyn Fn(&RawPoint) -> f64| points.iter().map(of).sum::<f64>() / count;
        let wanted = (e - mean(&|p| p.gcp.easting), n - mean(&|p| p.gcp.northing));
        let (corner, middle) = (image.transform?.apply(PixelPoint { x: 0.0, y: 0.0 }), image.middle()?);
        let reach = (corner.easting - middle.easting).hypot(corner.northing - middle.northing);
        if let Some(digits) = leading_digits(wanted, reach.min(2_000.0)) {
            return Some(format!("they would lie on the image with {digits}"));
        }
    }
    if all(&|e, n| (-e, -n)) {
        return Some(MINUS.to_string());
    }
    if all(&|e, n| (-n, -e)) {
        return Some(MINUS_EXCHANGED.to_string());
    }
    let feet = |e: f64, n: f64| (e * FOOT_M, n * FOOT_M);
    if all(&feet) {
        // Where every number is one that metres have in some zone of UTM, as its edges are narrow, that is likelier.
        let is_of_zones = |p: &RawPoint| UTM_E.contains(&p.gcp.easting) && UTM_N.contains(&p.gcp.northing);
        if crs.title().contains("UTM zone") && points.iter().all(is_of_zones) {
            return Some(OTHER_ZONE.to_string());
        }
        return Some(FEET.to_string());
    }
    // A hundred kilometres. What is less in millimetres lies at the corner of a zone, on the equator.
    let far = points.iter().all(|p| p.gcp.easting.abs().max(p.gcp.northing.abs()) >= LEAST_MM);
    (far && all(&|e, n| (e / 1000.0, n / 1000.0))).then(|| MILLIMETRES.to_string())
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
