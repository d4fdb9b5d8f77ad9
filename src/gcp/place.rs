//! Whether a list lies where its CRS is used, and where the image says it is: exchanged columns, a wrong CRS and slips
//! of a digit show here, before a pixel is read.

use std::path::Path;

use crate::gcp::elsewhere::{Elsewhere, Titles, in_brackets};
use crate::gcp::options::{GcpOptions, ImageGeoreference};
use crate::gcp::raw::RawPoint;
use crate::gcp::{Gcp, image_crs};
use autoref_raster::coords::MapPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::first_of;

/// No coordinate on Earth is larger, in metres, feet or degrees.
const LARGEST_COORDINATE: f64 = 1e9;
/// The image's own place tells exchanged columns when they bring the points this near, ...
const NEAR_DEG: f64 = 1.0;
/// ... and, as they stand, the points lie this far off.
const FAR_DEG: f64 = 5.0;

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
    if options.keep_outside {
        notes.extend(kept_outside(path, points, crs, options.image.as_ref()));
    } else {
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
            if let Some(hint) = not_local(path, gcps, options.image.as_ref()) {
                return Some(hint);
            }
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

/// That coordinates which were said to be local are those of the image's CRS in another unit.
fn not_local(path: &Path, gcps: &[Gcp], image: Option<&ImageGeoreference>) -> Option<String> {
    let crs = image_crs::system_of(image?).ok().filter(|crs| !crs.is_local() && !crs.is_geographic())?;
    let points: Vec<RawPoint> = gcps.iter().map(|gcp| RawPoint::bare(gcp.clone(), "")).collect();
    let is_outside = |p: &RawPoint| crs.covers(p.gcp.easting, p.gcp.northing) == Some(false);
    let how = Elsewhere::of(&points, &crs, image).filter(Elsewhere::is_of_large_numbers)?;
    let title = crs.title();
    points.iter().all(is_outside).then(|| {
        format!(
            "{}: in the image's CRS, {title}, {how}: {}, and leave --crs local out",
            path.display(),
            how.remedy(path, Titles::MayNameUnits)
        )
    })
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
    refuse_elsewhere(path, points, crs, image, (Titles::MayNameUnits, ", or --force outside-area"))?;
    points.retain(|p| !outside(p));
    notes.push(format!(
        "{}: set aside, outside the area of use of {}: {} (--force outside-area keeps them)",
        path.display(),
        crs.title(),
        first_of(&names, 8)
    ));
    Ok(())
}

/// What is said of points that stay though they lie outside: what is written with them may lie nowhere.
fn kept_outside(path: &Path, points: &[RawPoint], crs: &Crs, image: Option<&ImageGeoreference>) -> Option<String> {
    let is_outside = |p: &&RawPoint| crs.covers(p.gcp.easting, p.gcp.northing) == Some(false);
    let (name, title) = (path.display(), crs.title());
    let outside: Vec<String> = points.iter().filter(is_outside).map(|p| p.gcp.name.clone()).collect();
    if outside.is_empty() {
        return None;
    }
    if outside.len() < points.len() {
        let names = first_of(&outside, 8);
        return Some(format!("{name}: outside the area of use of {title}, and kept (--force outside-area): {names}"));
    }
    let how = Elsewhere::of(points, crs, image);
    let remedy = how.as_ref().map_or(String::new(), |how| format!("; {}", how.remedy(path, Titles::MayNameUnits)));
    Some(format!(
        "{name}: {} outside the area of use of {title}{}, and --force outside-area keeps them: what is written lies \
         there too{remedy}",
        all_lie(points.len()),
        in_brackets(&how)
    ))
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
    refuse_elsewhere(path, points, crs, None, (Titles::AreNone, ""))?;
    refuse_absurd(path, points)?;
    let outside = |p: &&RawPoint| crs.covers(p.gcp.easting, p.gcp.northing) == Some(false);
    let names: Vec<String> = points.iter().filter(outside).map(|p| p.gcp.name.clone()).collect();
    if !names.is_empty() {
        let title = crs.title();
        notes.push(format!("{}: outside the area of use of {title}: {}", path.display(), first_of(&names, 8)));
    }
    Ok(())
}

/// Refuses points of which none lies in the CRS's area of use. `titles`: whether those of a table's columns are read
/// again, so that they may name a unit; `way_out` is what else the caller may do where nothing else helps.
///
/// # Errors
/// [`Error::Format`] with what would bring them there.
pub(super) fn refuse_elsewhere(
    path: &Path,
    points: &[RawPoint],
    crs: &Crs,
    image: Option<&ImageGeoreference>,
    (titles, way_out): (Titles, &str),
) -> Result<()> {
    if points.is_empty() || points.iter().any(|p| crs.covers(p.gcp.easting, p.gcp.northing) != Some(false)) {
        return Ok(());
    }
    let how = Elsewhere::of(points, crs, image);
    let remedy = match &how {
        Some(how) => how.remedy(path, titles),
        None => format!("give the --crs that they are in{way_out}"),
    };
    Err(Error::format(
        path,
        "the coordinates",
        format!("{} outside the area of use of {}{}; {remedy}", all_lie(points.len()), crs.title(), in_brackets(&how)),
    ))
}
