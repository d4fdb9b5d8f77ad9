//! Which coordinate comes first, where a file does not say.

use std::path::Path;

use gdal::spatial_ref::SpatialRef;

use crate::gcp::options::ImageGeoreference;
use crate::gcp::place;
use crate::gcp::raw::{ColumnOrder, RawPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// What else shows where the points lie.
#[derive(Clone, Copy, Default)]
pub(super) struct Shown<'a> {
    /// The CRS that is asked for.
    pub target: Option<&'a Crs>,
    pub image: Option<&'a ImageGeoreference>,
}

/// East first or north first: the CRS's area of use decides, else the size of the numbers. What is not certain is said;
/// a wrong order mirrors the pattern, which is never matched.
///
/// # Errors
/// [`Error::Format`] for degrees without titles that could stand in either order.
pub(super) fn settle(
    path: &Path,
    points: &mut [RawPoint],
    order: ColumnOrder,
    crs: Option<&Crs>,
    shown: Shown<'_>,
    notes: &mut Vec<String>,
) -> Result<()> {
    match (order, crs) {
        (ColumnOrder::Stated, _) => Ok(()),
        (ColumnOrder::LatitudeFirst, Some(crs)) if crs.is_geographic() => {
            let could_be = |lon: f64, lat: f64| crs.covers(lon, lat) != Some(false);
            if all(points, &could_be) && !all(points, &|x, y| could_be(y, x)) {
                return Ok(());
            }
            swap(points);
            notes.push(format!("{}: of degrees the latitude comes first, as Pix4D has it", path.display()));
            Ok(())
        }
        (ColumnOrder::Untitled, Some(crs)) if crs.is_geographic() => settle_degrees(path, points, crs, shown, notes),
        (order, Some(crs)) => by_area(path, points, order, crs, shown, notes),
        (order, None) => {
            by_size(path, points, order, notes);
            Ok(())
        }
    }
}

fn all(points: &[RawPoint], test: &dyn Fn(f64, f64) -> bool) -> bool {
    points.iter().all(|p| test(p.gcp.easting, p.gcp.northing))
}

fn swap(points: &mut [RawPoint]) {
    for point in points {
        std::mem::swap(&mut point.gcp.easting, &mut point.gcp.northing);
    }
}

fn north_first(path: &Path, order: ColumnOrder) -> String {
    let what = if order == ColumnOrder::Ruled { "coordinates" } else { "columns" };
    format!("{}: northing comes before easting in its {what}", path.display())
}

/// Programs write degrees without titles in both orders, and nearly every pair is a place on Earth in both.
fn settle_degrees(
    path: &Path,
    points: &mut [RawPoint],
    crs: &Crs,
    shown: Shown<'_>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let own = shown.image.and_then(|image| Crs::parse(&image.crs_wkt).ok());
    let are_wrong = |points: &[RawPoint]| {
        let others = [shown.target, own.as_ref()].into_iter().flatten().filter(|other| !other.is_local());
        place::are_exchanged(points, crs, shown.image)
            || others.into_iter().any(|other| place::are_exchanged_for(points, crs, other))
    };
    let as_it_stands = are_wrong(points);
    swap(points);
    let exchanged = are_wrong(points);
    match (as_it_stands, exchanged) {
        (true, false) => notes.push(format!("{}: latitude comes before longitude in its columns", path.display())),
        (false, true) => swap(points),
        _ => {
            swap(points);
            return Err(either_way(path, points));
        }
    }
    Ok(())
}

/// What to say of degrees without titles.
pub(super) fn either_way(path: &Path, points: &[RawPoint]) -> Error {
    let (place, shown) = match points.first() {
        Some(p) => (p.place.as_str(), format!("{} and {}", p.gcp.easting, p.gcp.northing)),
        None => ("the list", "the coordinates".to_owned()),
    };
    let what = format!(
        "{shown} are degrees, and nothing shows which is the latitude: write the titles `name,lat,lon,height` (or \
         `name,lon,lat,height`) above the rows; `gcps convert --from pix4d` takes the latitude first"
    );
    Error::format(path, place, what)
}

/// # Errors
/// [`Error::Format`] where both orders could be and the CRS itself calls its northing X.
fn by_area(
    path: &Path,
    points: &mut [RawPoint],
    order: ColumnOrder,
    crs: &Crs,
    shown: Shown<'_>,
    notes: &mut Vec<String>,
) -> Result<()> {
    let covers = |x: f64, y: f64| crs.covers(x, y);
    let as_is = all(points, &|x, y| covers(x, y) != Some(false));
    let other = all(points, &|x, y| covers(y, x) != Some(false));
    if !as_is && other {
        swap(points);
        notes.push(format!("{}, by the area of use of {}", north_first(path, order), crs.title()));
        return Ok(());
    }
    if !(as_is && other) || order == ColumnOrder::Ruled {
        return Ok(());
    }
    let placed = shown.image.is_some_and(|image| image.transform.is_some());
    if order == ColumnOrder::Assumed && !placed && x_counts_north(crs) {
        let what = format!(
            "X is the northing in {} and the easting elsewhere, and both could be here; call the columns `easting` and \
             `northing`",
            crs.title()
        );
        return Err(Error::format(path, "the header", what));
    }
    notes.push(format!(
        "{}: its columns were taken as east, north; both orders would lie in the area of use of {}",
        path.display(),
        crs.title()
    ));
    Ok(())
}

/// Whether the authority calls the axis X that counts north, as Poland's and Austria's surveyors do.
fn x_counts_north(crs: &Crs) -> bool {
    let json = crs.epsg().and_then(|code| SpatialRef::from_epsg(code).ok()?.to_projjson().ok());
    let system: Option<serde_json::Value> = json.and_then(|json| serde_json::from_str(&json).ok());
    let Some(system) = system else { return false };
    let plan = system.get("components").and_then(|parts| parts.get(0)).unwrap_or(&system);
    let axes = plan.pointer("/coordinate_system/axis").and_then(|axes| axes.as_array());
    axes.into_iter().flatten().any(|axis| {
        let is = |key: &str, word: &str| axis[key].as_str().is_some_and(|said| said.eq_ignore_ascii_case(word));
        is("abbreviation", "x") && is("direction", "north")
    })
}

fn by_size(path: &Path, points: &mut [RawPoint], order: ColumnOrder, notes: &mut Vec<String>) {
    let utm = |e: f64, n: f64| (100_000.0..1_000_000.0).contains(&e) && (1_000_000.0..10_000_000.0).contains(&n);
    if all(points, &|x, y| utm(y, x)) {
        swap(points);
        notes.push(format!("{}, by the size of the numbers", north_first(path, order)));
    } else if order != ColumnOrder::Ruled && !all(points, &utm) {
        notes.push(format!("{}: its columns do not say which is which and were taken as east, north", path.display()));
    }
}
