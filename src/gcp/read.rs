//! Lists of GCPs as files, of any format: recognised, chosen from, and brought into metres.

use std::path::Path;

use crate::gcp::degrees::{
    latitude_first, look_like_degrees, refuse_degrees, refuse_degrees_of_map, refuse_geocentric, refuse_no_degrees,
    within_degrees,
};
use crate::gcp::elsewhere::Titles;
use crate::gcp::options::GcpOptions;
use crate::gcp::order::{self, Shown};
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint};
use crate::gcp::select::chosen;
use crate::gcp::units::Unit;
use crate::gcp::working_crs::WorkingCrs;
use crate::gcp::{Gcp, GcpRole, accuracy_list, heights, image_crs, metres, place, recognise, working_crs};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// Matching weighs every pair of points against every other point.
const MOST_POINTS: usize = 2_000;

/// A list as it will be used: coordinates in metres.
#[derive(Clone, Debug)]
pub struct GcpList {
    /// Easting, northing and height in metres, whatever the CRS counts in; see [`WorkingCrs`].
    pub gcps: Vec<Gcp>,
    /// CRS of the outputs.
    pub crs: Option<Crs>,
    /// From the metres of the fit to the outputs.
    pub working_crs: WorkingCrs,
    /// What was assumed or looks odd, in plain words.
    pub notes: Vec<String>,
    /// What may be wrong with the list where its pattern is not found, with the remedy.
    pub hints: Vec<String>,
}

/// Reads a list; the format follows from the content, and from the file's name where the content leaves it open.
/// `docs/gcp-lists.md` has all of them.
///
/// # Errors
/// When the file cannot be read, is of no known format, has a row that is no point (the message names it), two points
/// of one name, or fewer than two points; when its coordinates cannot be brought into metres as surely as is demanded.
pub fn read(path: &Path, options: &GcpOptions) -> Result<GcpList> {
    let (raw, _) = recognise::parse(path, options.layer.as_deref(), None)?;
    finish(path, raw, options)
}

/// The points with their coordinates in order, the CRS that is stated, and what was said.
pub(super) fn settled(
    path: &Path,
    raw: RawList,
    crs_override: Option<&str>,
    shown: Shown<'_>,
) -> Result<(Vec<RawPoint>, Option<Crs>, Vec<String>)> {
    let RawList { mut points, crs, may_be_degrees, order, titled_degrees, mut notes, open_mark, .. } = raw;
    heights::drop_missing(path, &mut points, &mut notes);
    check_points(path, &mut points, &mut notes)?;
    let degrees = |points: &[RawPoint]| within_degrees(points) || latitude_first(points);
    let stated = match (crs_override, crs) {
        (Some(crs), _) if is_local_word(crs) => None,
        (Some(crs), _) => Some(Crs::parse(crs)?),
        (None, CrsClaim::Unclear(error)) => return Err(error),
        (None, CrsClaim::Known(crs)) => Some(crs),
        (None, CrsClaim::None) if may_be_degrees && degrees(&points) => Some(Crs::from_epsg(4326)?),
        (None, CrsClaim::None) if order == ColumnOrder::LatitudeFirst && look_like_degrees(&points) => {
            Some(Crs::from_epsg(4326)?)
        }
        (None, CrsClaim::None) => None,
    };
    if let Some(crs) = &stated {
        working_crs::refuse_mirror_image(crs, "--crs")?;
    }
    // As the list has them: no order of the columns makes a map of them.
    refuse_geocentric(path, &points)?;
    order::settle(path, &mut points, order, stated.as_ref(), shown, &mut notes)?;
    if let Some(crs) = &stated {
        refuse_no_degrees(path, &points, crs)?;
        if titled_degrees && !crs.is_geographic() && !crs.is_local() && degrees(&points) {
            return Err(titles_of_degrees(path, crs));
        }
        refuse_degrees_of_map(path, &points, crs)?;
        if let Some(cell) = open_mark {
            refuse_thousands(path, &points, crs, &cell)?;
        }
    }
    Ok((points, stated, notes))
}

/// Of a table with coordinates of a map beside degrees those that are meant by the CRS that is given.
pub(super) fn by_the_crs(path: &Path, mut raw: RawList, crs_override: Option<&str>) -> Result<RawList> {
    let Some(mut beside) = raw.beside.take() else { return Ok(raw) };
    let Some(crs) = crs_override.filter(|crs| !is_local_word(crs)).map(Crs::parse).transpose()? else { return Ok(raw) };
    if crs.is_local() || crs.is_geographic() == raw.titled_degrees {
        return Ok(raw);
    }
    let taken = if crs.is_geographic() { "longitude and latitude" } else { "the coordinates beside the degrees" };
    beside.notes.push(format!("{}: by --crs {taken} were taken, of two sets of coordinates", path.display()));
    Ok(*beside)
}

/// No survey lies within a kilometre of the origin of a map: marks with three digits behind them stand between
/// thousands there.
fn refuse_thousands(path: &Path, points: &[RawPoint], crs: &Crs, cell: &str) -> Result<()> {
    const NEAR_ORIGIN: f64 = 1000.0;
    let is_near = |p: &RawPoint| p.gcp.easting.abs() < NEAR_ORIGIN && p.gcp.northing.abs() < NEAR_ORIGIN;
    if crs.is_geographic() || crs.is_local() || !points.iter().all(is_near) {
        return Ok(());
    }
    let what = format!(
        "in {cell} and the like the mark seems to stand between thousands, since nothing lies so near the origin of {}; \
         write the numbers without it",
        crs.title()
    );
    Err(Error::format(path, "the coordinates", what))
}

fn titles_of_degrees(path: &Path, crs: &Crs) -> Error {
    let label = crs.epsg().map_or_else(|| "the projected one".to_string(), |code| format!("EPSG:{code}"));
    Error::format(
        path,
        "the header",
        format!(
            "its titles say longitude and latitude, which are degrees, but {} has none; give --crs EPSG:4326 (or the \
             datum of the survey) for the list, and --to-crs {label} for what is written",
            crs.title()
        ),
    )
}

fn finish(path: &Path, mut raw: RawList, options: &GcpOptions) -> Result<GcpList> {
    raw = by_the_crs(path, raw, options.crs.as_deref())?;
    let (units, drawn_in) = (std::mem::take(&mut raw.units), raw.drawn_in);
    raw.notes.extend(raw.set_aside.take());
    let target = options.to_crs.as_deref().map(Crs::parse).transpose()?;
    let shown = Shown { target: target.as_ref(), image: options.image.as_ref() };
    let (mut points, stated, mut notes) = settled(path, raw, options.crs.as_deref(), shown)?;
    let source = match stated {
        Some(crs) => Some(crs),
        None => unnamed(path, &points, units.plan_unit(path)?.or(drawn_in), options, &mut notes)?,
    };
    if let Some(crs) = &source {
        refuse_no_degrees(path, &points, crs)?;
    }
    metres::of_drawing(path, &mut points, (source.as_ref(), drawn_in), &mut notes)?;
    units.apply(path, &mut points, source.as_ref(), &mut notes)?;
    place::check(path, &mut points, (source.as_ref(), target.as_ref()), options, &mut notes)?;
    let gcps = choose(path, points, options)?;
    if gcps.len() > MOST_POINTS {
        return Err(Error::unsupported(
            path,
            format!("a list of {} points to match; at most {MOST_POINTS} are", gcps.len()),
            "choose those of this image with --names, or cut the list to its area",
        ));
    }
    let hint = place::may_be_exchanged(path, &gcps, source.as_ref(), options);
    let mut list = enter(path, gcps, (source, target), options, notes)?;
    list.hints.extend(hint);
    if let Some(table) = &options.accuracy {
        list.notes.extend(accuracy_list::apply(table, &mut list.gcps)?);
    }
    let stated_in = options.accuracy.as_deref().unwrap_or(path);
    list.notes.extend(accuracy_list::no_survey(stated_in, &list.gcps));
    Ok(list)
}

/// The CRS of a list that names none: the image's, or local metres (`None`); `unit` is what the list says that its
/// coordinates count in.
fn unnamed(
    path: &Path,
    points: &[RawPoint],
    unit: Option<Unit>,
    options: &GcpOptions,
    notes: &mut Vec<String>,
) -> Result<Option<Crs>> {
    if options.crs.as_deref().is_some_and(is_local_word) {
        return Ok(None);
    }
    if let Some(image) = &options.image
        && let Some(crs) = image_crs::adopt(path, points, unit, image, notes)?
    {
        return Ok(Some(crs));
    }
    refuse_degrees(path, points)?;
    notes.push(format!(
        "{} names no coordinate reference system: its coordinates are taken as local metres; give --crs",
        path.display()
    ));
    Ok(None)
}

/// What `--crs` says of coordinates that are local metres.
fn is_local_word(crs: &str) -> bool {
    crs.trim().eq_ignore_ascii_case("local")
}

fn choose(path: &Path, mut points: Vec<RawPoint>, options: &GcpOptions) -> Result<Vec<Gcp>> {
    if !options.names.is_empty() {
        let mut used = chosen(path, &points, &options.names)?.into_iter();
        points.retain(|_| used.next().expect("one for each"));
    }
    let checks = chosen(path, &points, &options.check)?;
    for (point, check) in points.iter_mut().zip(checks) {
        if check {
            point.gcp.role = GcpRole::Check;
        }
    }
    if points.len() < 2 {
        return Err(Error::format(
            path,
            "the list",
            format!(
                "{} to use; an orientation needs at least 2, a believable match 4 or more",
                counted(points.len(), "point", "points")
            ),
        ));
    }
    Ok(points.into_iter().map(|p| p.gcp).collect())
}

fn enter(
    path: &Path,
    mut gcps: Vec<Gcp>,
    (source, target): (Option<Crs>, Option<Crs>),
    options: &GcpOptions,
    mut notes: Vec<String>,
) -> Result<GcpList> {
    let Some(source) = source else {
        return match target {
            None => Ok(GcpList { gcps, crs: None, working_crs: WorkingCrs::local(), notes, hints: Vec::new() }),
            Some(_) => Err(Error::usage(
                format!("{}: --to-crs needs to know where the coordinates come from", path.display()),
                "give the --crs that they are in",
            )),
        };
    };
    if options.datum_accuracy_m.is_nan() || options.datum_accuracy_m < 0.0 {
        return Err(Error::usage("--datum-accuracy is no length", "give metres, 0 or more"));
    }
    let (working_crs, crs) =
        WorkingCrs::enter(path, &mut gcps, source, target, options.reproject, options.datum_accuracy_m, &mut notes)?;
    Ok(GcpList { gcps, crs: Some(crs), working_crs, notes, hints: Vec::new() })
}

/// Duplicate names are an error, duplicate places a note; of rows that are alike in all they say one is enough.
fn check_points(path: &Path, points: &mut Vec<RawPoint>, notes: &mut Vec<String>) -> Result<()> {
    drop_repeated(path, points, notes);
    let mut names = std::collections::HashMap::new();
    let mut places = std::collections::HashMap::new();
    for point in points.iter() {
        let gcp = &point.gcp;
        if !gcp.easting.is_finite() || !gcp.northing.is_finite() {
            return Err(Error::format(path, &point.place, format!("point `{}` has no finite coordinates", gcp.name)));
        }
        if let Some(first) = names.insert(gcp.name.as_str(), &point.place) {
            return Err(Error::format(
                path,
                &point.place,
                format!("the name `{}` was used before, in {first}; rename or remove one", gcp.name),
            ));
        }
        if let Some(other) = places.insert((gcp.easting.to_bits(), gcp.northing.to_bits()), &gcp.name) {
            notes.push(format!("points `{other}` and `{}` have the same coordinates", gcp.name));
        }
    }
    Ok(())
}

/// Keeps the first of rows that say the same.
fn drop_repeated(path: &Path, points: &mut Vec<RawPoint>, notes: &mut Vec<String>) {
    let mut firsts: std::collections::HashMap<&str, &RawPoint> = std::collections::HashMap::new();
    let mut repeats = Vec::new();
    for (index, point) in points.iter().enumerate() {
        let first = firsts.entry(&point.gcp.name).or_insert(point);
        let says_the_same =
            first.gcp == point.gcp && first.attributes == point.attributes && first.pixels == point.pixels;
        if !std::ptr::eq(*first, point) && says_the_same {
            let what = format!("{} says the same as {} and was passed over", point.place, first.place);
            repeats.push((index, what));
        }
    }
    if let Some((_, what)) = repeats.first() {
        let more = match repeats.len() - 1 {
            0 => String::new(),
            more => format!("; likewise {}", counted(more, "other row", "other rows")),
        };
        notes.push(format!("{}: {what}{more}", path.display()));
    }
    let repeats: std::collections::HashSet<usize> = repeats.into_iter().map(|(index, _)| index).collect();
    let mut index = 0..;
    points.retain(|_| !repeats.contains(&index.next().expect("it never ends")));
}

/// Looks at the places of a list that another reader took as east, north, height: north first is exchanged where only
/// that can be, and said.
///
/// # Errors
/// [`Error::Format`] when the places count from the centre of the Earth, are degrees where `crs` has none or none where
/// it has them, or all lie outside its area of use.
pub fn settle_places(path: &Path, places: &mut [[f64; 3]], crs: Option<&Crs>) -> Result<Vec<String>> {
    let point = |(index, &[east, north, height]): (usize, &[f64; 3])| {
        let gcp = Gcp { height: Some(height), ..Gcp::control((index + 1).to_string(), east, north) };
        RawPoint::bare(gcp, "the coordinates")
    };
    let mut points: Vec<RawPoint> = places.iter().enumerate().map(point).collect();
    refuse_geocentric(path, &points)?;
    let mut notes = Vec::new();
    order::settle(path, &mut points, ColumnOrder::Ruled, crs, Shown::default(), &mut notes)?;
    if let Some(crs) = crs {
        refuse_no_degrees(path, &points, crs)?;
        refuse_degrees_of_map(path, &points, crs)?;
        place::refuse_elsewhere(path, &points, crs, None, (Titles::AreNone, ""))?;
    }
    for (place, point) in places.iter_mut().zip(&points) {
        (place[0], place[1]) = (point.gcp.easting, point.gcp.northing);
    }
    Ok(notes)
}
