//! Coordinates that do not fit their system: degrees where it has none, none where it counts in them, and those that
//! count from the centre of the Earth.

use std::path::Path;

use crate::gcp::raw::RawPoint;
use crate::gcp::{Gcp, order};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

pub(super) fn within_degrees(points: &[RawPoint]) -> bool {
    points.iter().all(|p| p.gcp.easting.abs() <= 180.0 && p.gcp.northing.abs() <= 90.0)
}

/// Degrees, when the first number is the latitude.
pub(super) fn latitude_first(points: &[RawPoint]) -> bool {
    points.iter().all(|p| p.gcp.northing.abs() <= 180.0 && p.gcp.easting.abs() <= 90.0)
}

/// Points within one metre of each other are no survey: they are degrees.
pub(super) fn look_like_degrees(points: &[RawPoint]) -> bool {
    let small = points.iter().all(|p| p.gcp.easting.abs() <= 180.0 && p.gcp.northing.abs() <= 180.0);
    let spread = |f: fn(&Gcp) -> f64| {
        let values = points.iter().map(|p| f(&p.gcp));
        values.clone().fold(f64::NEG_INFINITY, f64::max) - values.fold(f64::INFINITY, f64::min)
    };
    points.len() > 1 && small && spread(|g| g.easting) < 1.0 && spread(|g| g.northing) < 1.0
}

/// Degrees without a CRS.
pub(super) fn refuse_degrees(path: &Path, points: &[RawPoint]) -> Result<()> {
    if look_like_degrees(points) {
        return Err(Error::format(
            path,
            "the coordinates",
            "they look like degrees, in which nothing can be fitted; give --crs EPSG:4326, or the CRS they are in",
        ));
    }
    Ok(())
}

/// Degrees without a CRS and without titles, where nothing is fitted but all is written.
pub(super) fn refuse_untitled_degrees(path: &Path, points: &[RawPoint]) -> Result<()> {
    if look_like_degrees(points) {
        return Err(order::either_way(path, points));
    }
    Ok(())
}

/// No latitude is larger than 90 degrees.
///
/// # Errors
/// [`Error::Format`] with the first point that has one.
pub(super) fn refuse_beyond_poles(path: &Path, points: &[RawPoint], crs: &Crs) -> Result<()> {
    let is_degrees = crs.counts_degrees();
    match points.iter().find(|p| is_degrees && p.gcp.northing.abs() > 90.0) {
        Some(bad) => Err(Error::format(
            path,
            &bad.place,
            format!(
                "no latitude is {}; correct it, or exchange the columns of longitude and latitude",
                bad.gcp.northing
            ),
        )),
        None => Ok(()),
    }
}

/// Degrees under a system of metres or feet: beside its origin they would pass for coordinates of it.
pub(super) fn refuse_degrees_of_map(path: &Path, points: &[RawPoint], crs: &Crs) -> Result<()> {
    if crs.is_geographic() || crs.is_local() || !look_like_degrees(points) {
        return Ok(());
    }
    let title = crs.title();
    let what = format!("they look like degrees, but {title} has none; give --crs EPSG:4326, or the CRS they are in");
    Err(Error::format(path, "the coordinates", what))
}

/// A system in degrees has no larger numbers.
pub(super) fn refuse_no_degrees(path: &Path, points: &[RawPoint], crs: &Crs) -> Result<()> {
    if !crs.counts_degrees() || within_degrees(points) {
        return Ok(());
    }
    // A longitude may count from 0 to 360.
    let are_degrees = |e: f64, n: f64| e.abs() <= 360.0 && n.abs() <= 90.0;
    let stands = |p: &&RawPoint| are_degrees(p.gcp.easting, p.gcp.northing);
    // Exchanged columns are another matter.
    if points.iter().all(|p| !stands(&p) && are_degrees(p.gcp.northing, p.gcp.easting)) {
        return Ok(());
    }
    match points.iter().find(|p| !stands(p)) {
        Some(bad) => Err(Error::format(
            path,
            &bad.place,
            format!(
                "{}, {} are no degrees, but {} counts in them; give the --crs that the coordinates are in",
                bad.gcp.easting,
                bad.gcp.northing,
                crs.title()
            ),
        )),
        None => Ok(()),
    }
}

/// The zone of UTM in which a geocentric place lies, to the third of a degree in latitude that an ellipsoid makes.
fn utm_of_geocentric(place: &Gcp) -> Option<Crs> {
    let (x, y, z) = (place.easting, place.northing, place.height?);
    let (longitude, latitude) = (y.atan2(x), z.atan2(x.hypot(y)));
    Crs::from_epsg(4326).ok()?.utm_zone(longitude.to_degrees(), latitude.to_degrees()).ok()
}

/// Coordinates that count from the centre of the Earth are no map's: all lie as far from it as the ground does, and
/// none has a height that ground has.
pub(super) fn refuse_geocentric(path: &Path, points: &[RawPoint]) -> Result<()> {
    const RADII_M: std::ops::Range<f64> = 6.33e6..6.4e6;
    const HIGHEST_M: f64 = 10_000.0;
    let is_geocentric = |p: &RawPoint| {
        p.gcp
            .height
            .is_some_and(|z| z.abs() > HIGHEST_M && RADII_M.contains(&p.gcp.easting.hypot(p.gcp.northing).hypot(z)))
    };
    match points.first() {
        Some(first) if points.iter().all(is_geocentric) => {
            let zone = utm_of_geocentric(&first.gcp).map_or("EPSG:…".to_owned(), |crs| crs.label());
            let what = format!(
                "the coordinates count from the centre of the Earth (geocentric X, Y, Z): bring them to a map first, for \
                 example with `cs2cs EPSG:4978 {zone}`"
            );
            Err(Error::format(path, &first.place, what))
        }
        _ => Ok(()),
    }
}
