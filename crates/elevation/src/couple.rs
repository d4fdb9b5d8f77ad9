//! Two models brought together: one CRS, one vertical datum, metres.

use std::fmt;
use std::path::Path;

use gdal::spatial_ref::SpatialRef;

use crate::crs::{Accuracy, Coordinate, Crs, DEFAULT_DATUM_ACCURACY_M, same_plane};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::lift::Lift;
use crate::model::{Model, how_to_name_crs};
use crate::source::Heights as _;

/// Both models, A brought to B's CRS and vertical datum.
pub struct Couple {
    pub a: Model,
    pub b: Model,
    /// A is seen through a projection: its cells are resampled.
    pub projected: bool,
    pub heights: HeightDatum,
    /// Models whose heights are taken for metres though their map counts in something else, as words.
    pub doubtful_units: Vec<String>,
    _warped: Option<tempfile::TempPath>,
}

/// Models whose heights are taken for metres though their map counts in something else.
fn doubtful_units(a: &Model, b: &Model) -> Vec<String> {
    [("A", a), ("B", b)].into_iter().filter_map(|(letter, model)| model.doubtful_unit(letter)).collect()
}

/// What the heights of a couple count from.
#[derive(Clone, Debug, PartialEq)]
pub enum HeightDatum {
    /// Neither file says.
    Unnamed,
    /// One for both.
    Common(String),
    /// A's heights were brought to B's datum.
    Lifted { from: String, to: String, range_m: (f64, f64), accuracy: Accuracy, lattice_error_m: f64 },
}

impl HeightDatum {
    /// Were A's heights changed?
    pub fn lifted(&self) -> bool {
        matches!(self, HeightDatum::Lifted { .. })
    }
}

impl fmt::Display for HeightDatum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            HeightDatum::Unnamed => f.write_str("neither file names a vertical datum: both are taken to have the same"),
            HeightDatum::Common(datum) => write!(f, "above {datum}"),
            HeightDatum::Lifted { from, to, range_m: (low, high), accuracy, lattice_error_m } => {
                write!(f, "above {to}; A's were above {from} and had {low:+.3} to {high:+.3} m added (PROJ")?;
                match accuracy {
                    Accuracy::Metres(metres) => write!(f, ", good to {metres} m by the authority's word")?,
                    Accuracy::Unstated => f.write_str(", nobody says how good")?,
                    Accuracy::Exact => {}
                }
                if *lattice_error_m > 0.002 {
                    write!(f, "; interpolated, off by up to {lattice_error_m:.3} m")?;
                }
                f.write_str(")")
            }
        }
    }
}

/// A place counts as the same when it moves by less than this share of a cell.
const SAME_PLACE_PX: f64 = 1e-6;
/// Two datums are one where heights differ by less, metres.
const SAME_HEIGHT_M: f64 = 1e-4;

/// Opens two models and brings A into B's CRS, and its heights to B's vertical datum, where they differ.
///
/// # Errors
/// When one cannot be opened, one alone names its unit, its CRS or its vertical datum, or PROJ has no way between them
/// that is good enough with the grids that are installed: the message names the grid.
pub fn open_couple(a: &Path, b: &Path) -> Result<Couple> {
    let (ma, mb) = (Model::open(a)?, Model::open(b)?);
    check_units(&ma, &mb)?;
    check_named(&ma, &mb)?;
    let doubtful_units = doubtful_units(&ma, &mb);
    let (va, vb) = (vertical(ma.wkt()), vertical(mb.wkt()));
    if va.is_some() != vb.is_some() {
        let (with, without) = if va.is_some() { (a, b) } else { (b, a) };
        let named = va.or(vb).unwrap_or_default();
        return Err(Error::usage(
            format!("{}: missing vertical datum, while {} has {named}", without.display(), with.display()),
            "name it in the CRS (gdal_edit.py -a_srs EPSG:horizontal+vertical), or take it from the other",
        ));
    }
    let common = vb.clone().map_or(HeightDatum::Unnamed, HeightDatum::Common);
    let (from, to) = match (ma.crs(), mb.crs()) {
        (Some(from), Some(to)) if from.wkt() != to.wkt() && !same_reference(ma.wkt(), mb.wkt()) => {
            (from.clone(), to.clone())
        }
        _ => {
            let a = in_turn_of(ma, &mb);
            return Ok(Couple { a, b: mb, projected: false, heights: common, doubtful_units, _warped: None });
        }
    };
    let both = |what: String| format!("{} and {}: {what}", a.display(), b.display());
    let together = |e: Error| match e {
        // Models have no list whose datum could be given otherwise.
        Error::CoarseDatum { what, install, .. } => {
            let otherwise = "bring one model to the other's datum first".into();
            Error::CoarseDatum { what: both(what), install, otherwise }
        }
        Error::Usage { what, remedy } => Error::usage(both(what), remedy),
        other => other,
    };
    let (ma, warped) = if stays(&ma.grid(), &from, &to).map_err(together)? {
        (ma, None)
    } else {
        let warped = warp(a, mb.wkt(), &cells_of(&ma, &mb))?;
        (Model::open(&warped)?.in_unit_of(&ma), Some(warped))
    };
    let (Some(va), Some(vb)) = (va, vb) else {
        return Ok(Couple {
            a: in_turn_of(ma, &mb),
            b: mb,
            projected: warped.is_some(),
            heights: common,
            doubtful_units,
            _warped: warped,
        });
    };
    let lift = Lift::of(&ma.grid(), &from, &to).map_err(together)?;
    let (low, high) = lift.range_m();
    let (a, heights) = if low.abs().max(high.abs()) < SAME_HEIGHT_M {
        (ma, common)
    } else {
        let heights = HeightDatum::Lifted {
            from: va,
            to: vb,
            range_m: (low, high),
            accuracy: lift.accuracy(),
            lattice_error_m: lift.worst_error_m(),
        };
        (ma.lifted(lift), heights)
    };
    let a = in_turn_of(a, &mb);
    Ok(Couple { a, b: mb, projected: warped.is_some(), heights, doubtful_units, _warped: warped })
}

/// By how much longitudes of one place may differ.
pub(crate) const TURN_DEGREES: f64 = 360.0;

/// A where B counts its longitudes: files count them from −180° or from 0°, so that one place may differ by a turn.
fn in_turn_of(a: Model, b: &Model) -> Model {
    let degrees = |model: &Model| model.crs().is_some_and(Crs::counts_degrees);
    if !(degrees(&a) && degrees(b)) || a.grid().overlap(&b.grid()).is_some() {
        return a;
    }
    let turned = |turn: &f64| Grid { x0: a.grid().x0 + turn, ..a.grid() }.overlap(&b.grid()).is_some();
    match [TURN_DEGREES, -TURN_DEGREES].into_iter().find(turned) {
        Some(turn) => a.moved_east(turn),
        None => a,
    }
}

/// Do the map coordinates of a grid stay what they are in the other system?
fn stays(grid: &Grid, from: &Crs, to: &Crs) -> Result<bool> {
    if same_plane(from, to) {
        return Ok(true);
    }
    let [west, south, east, north] = grid.bounds();
    let (x, y) = grid.centre();
    let places = [(x, y), (west, south), (west, north), (east, south), (east, north)];
    let mut moved = places.map(|(x, y)| Coordinate { x, y, height: Some(0.0) });
    from.transform(&mut moved[..1], to, DEFAULT_DATUM_ACCURACY_M)?;
    if from.transform(&mut moved[1..], to, DEFAULT_DATUM_ACCURACY_M).is_err() {
        // A corner may lie where the other system does not reach.
        return Ok(false);
    }
    Ok(places.iter().zip(&moved).all(|((x, y), m)| {
        (m.x - x).abs() < SAME_PLACE_PX * grid.step_x.abs() && (m.y - y).abs() < SAME_PLACE_PX * grid.step_y.abs()
    }))
}

/// A virtual raster of A in another CRS; heights stay as they are.
fn warp(a: &Path, wkt: &str, more: &[String]) -> Result<tempfile::TempPath> {
    let file = tempfile::Builder::new().prefix("autoref-elevation.").suffix(".vrt").tempfile();
    let path = file.map_err(|e| Error::io(std::env::temp_dir(), "make a temporary file in", e))?.into_temp_path();
    let source = a.canonicalize().map_err(|e| Error::io(a, "find", e))?;
    let options = [
        "-of",
        "VRT",
        "-t_srs",
        wkt,
        "-r",
        "cubic",
        "-overwrite",
        "-dstnodata",
        "-9999",
        "-ot",
        "Float32",
        "-novshift",
        // Every cell by PROJ itself: the usual interpolation between places may be off by an eighth of a cell.
        "-et",
        "0",
        // Heights between A's cells, nothing smoothed: GDAL would take a kernel of another width in every block.
        "-wo",
        "XSCALE=1",
        "-wo",
        "YSCALE=1",
    ];
    let options: Vec<&str> = options.into_iter().chain(more.iter().map(String::as_str)).collect();
    crate::derive::warp(&source, &path, &options)?;
    Ok(path)
}

/// Sides of the cells of A in B's CRS: as long as A's on the ground, the shorter one where the axes may be turned
/// against each other; GDAL would make them square in degrees. Where B's longitudes run over 180°, those of A would
/// jump there and span the whole Earth: the part of B with as much again on each side.
fn cells_of(a: &Model, b: &Model) -> Vec<String> {
    const METRES_PER_DEGREE: f64 = 111_319.5;
    let [west, south, east, north] = b.grid().bounds();
    let is_geographic = |model: &Model| model.crs().is_some_and(Crs::is_geographic);
    let (mx, my) = a.ground_unit().metres_per_unit(a.grid().centre().1);
    let [wide_m, high_m] = [a.grid().step_x.abs() * mx, a.grid().step_y.abs() * my];
    let shorter_m = wide_m.min(high_m);
    let sides = match (is_geographic(a), is_geographic(b)) {
        (true, true) => [a.grid().step_x.abs(), a.grid().step_y.abs()],
        (false, true) => {
            let shrunk = ((south + north) / 2.0).to_radians().cos().max(1e-3);
            [shorter_m / METRES_PER_DEGREE / shrunk, shorter_m / METRES_PER_DEGREE]
        }
        (_, false) => [shorter_m / b.ground_unit().metres_per_unit(b.grid().centre().1).0; 2],
    };
    let numbers = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>();
    let mut options = vec!["-tr".to_string()];
    options.extend(numbers(&sides));
    if is_geographic(b) && !is_geographic(a) && (west < -180.0 || east > 180.0) {
        let (wide, high) = (east - west, north - south);
        options.push("-te".into());
        options.extend(numbers(&[west - wide, (south - high).max(-90.0), east + wide, (north + high).min(90.0)]));
    }
    options
}

fn same_reference(a: &str, b: &str) -> bool {
    match (SpatialRef::from_wkt(a), SpatialRef::from_wkt(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// The vertical datum that a CRS names: that of its vertical part, or the ellipsoid of a three-dimensional one.
pub fn vertical(wkt: &str) -> Option<String> {
    let reference = SpatialRef::from_wkt(wkt).ok()?;
    let named = reference.get_attr_value("VERT_CS|VERT_DATUM", 0).ok().flatten();
    named.or_else(|| (reference.axes_count() == 3).then(|| "the ellipsoid".to_string()))
}

/// Refuses two models of which one names a CRS and the other none.
///
/// # Errors
/// In that case.
pub fn check_named(a: &Model, b: &Model) -> Result<()> {
    let (without, with, crs) = match (a.crs(), b.crs()) {
        (None, Some(crs)) => (a, b, crs),
        (Some(crs), None) => (b, a, crs),
        _ => return Ok(()),
    };
    Err(Error::usage(
        format!("{}: no CRS, while {} has {}", without.path().display(), with.path().display(), crs.label()),
        how_to_name_crs(without.path()),
    ))
}

/// Refuses models whose map positions are not those of the first.
///
/// # Errors
/// When one of them has another CRS, or none where the first has one.
pub fn check_one_map(models: &[Model]) -> Result<()> {
    let Some((first, others)) = models.split_first() else { return Ok(()) };
    for other in others {
        check_named(first, other)?;
        let (Some(from), Some(to)) = (first.crs(), other.crs()) else { continue };
        if !same_reference(first.wkt(), other.wkt()) && !stays(&first.grid(), from, to).unwrap_or(false) {
            return Err(Error::usage(
                format!("{}: another CRS than that of {}", other.path().display(), first.path().display()),
                "bring it there with gdalwarp -t_srs",
            ));
        }
    }
    Ok(())
}

fn check_units(a: &Model, b: &Model) -> Result<()> {
    let (with, without) = match (a.unit_name(), b.unit_name()) {
        (Some(_), None) if a.metres_per_value() != 1.0 => (a, b),
        (None, Some(_)) if b.metres_per_value() != 1.0 => (b, a),
        _ => return Ok(()),
    };
    Err(Error::usage(
        format!(
            "{}: heights in {}, and {} names no unit",
            with.path().display(),
            with.unit_name().unwrap_or("?"),
            without.path().display()
        ),
        "name it with gdal_edit.py -units m (or ft)",
    ))
}
