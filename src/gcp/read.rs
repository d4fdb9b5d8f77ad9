//! Lists of GCPs as files: GeoJSON, CSV with a header, Norwegian KOF.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::gcp::{Gcp, GcpRole, accuracy_list, csv_list, geojson, kof};
use crate::georef::crs::Crs;

/// What the caller says about the list.
#[derive(Clone, Debug, Default)]
pub struct GcpOptions {
    /// CRS of the coordinates, overriding what the file says.
    pub crs: Option<String>,
    /// CRS to bring them into before anything is fitted.
    pub to_crs: Option<String>,
    /// Use only these points.
    pub names: Vec<String>,
    /// Keep these out of the fit.
    pub check: Vec<String>,
    /// A table of the survey's errors, point by point.
    pub accuracy: Option<PathBuf>,
}

/// A list as it will be used: projected coordinates in metres.
#[derive(Clone, Debug)]
pub struct GcpList {
    pub gcps: Vec<Gcp>,
    pub crs: Option<Crs>,
    /// What was assumed or looks odd, in plain words.
    pub notes: Vec<String>,
}

/// A point as the file has it.
pub(super) struct RawPoint {
    pub gcp: Gcp,
    /// "row 7", "feature 3".
    pub place: String,
}

/// What a format's reader returns.
pub(super) struct RawList {
    pub points: Vec<RawPoint>,
    pub crs: Option<Crs>,
    /// The format says longitude, latitude when nothing else is said (GeoJSON).
    pub may_be_degrees: bool,
    pub notes: Vec<String>,
}

/// Reads a list; the format follows from the file's name and, failing that, its content.
///
/// # Errors
/// When the file cannot be read, is of no known format, has a row that is no point (the message names it), two points
/// of one name, or fewer than two points; when its coordinates cannot be brought into a projected CRS.
pub fn read(path: &Path, options: &GcpOptions) -> Result<GcpList> {
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
    let text = decode(bytes);
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let raw = match extension.as_str() {
        "geojson" | "json" => geojson::parse(path, &text)?,
        "kof" => kof::parse(path, &text)?,
        _ if text.trim_start().starts_with('{') => geojson::parse(path, &text)?,
        _ => csv_list::parse(path, &text)?,
    };
    finish(path, raw, options)
}

/// UTF-8 with or without a byte order mark; else Latin-1, as old survey software writes.
pub(super) fn decode(bytes: Vec<u8>) -> String {
    match String::from_utf8(bytes) {
        Ok(text) => text.trim_start_matches('\u{feff}').to_string(),
        Err(error) => error.into_bytes().into_iter().map(char::from).collect(),
    }
}

fn finish(path: &Path, raw: RawList, options: &GcpOptions) -> Result<GcpList> {
    let RawList { mut points, crs, may_be_degrees, mut notes } = raw;
    check_points(path, &points, &mut notes)?;
    if !options.names.is_empty() {
        require_known(path, &points, &options.names)?;
        points.retain(|p| options.names.contains(&p.gcp.name));
    }
    require_known(path, &points, &options.check)?;
    for point in &mut points {
        if options.check.contains(&point.gcp.name) {
            point.gcp.role = GcpRole::Check;
        }
    }
    if points.len() < 2 {
        return Err(Error::format(
            path,
            "the list",
            format!("{} point(s) to use; an orientation needs at least 2, a believable match 4 or more", points.len()),
        ));
    }
    let stated = options.crs.as_deref().map(Crs::parse).transpose()?.or(crs);
    let degrees = points.iter().all(|p| p.gcp.easting.abs() <= 180.0 && p.gcp.northing.abs() <= 90.0);
    let source = match stated {
        None if may_be_degrees && degrees => Some(Crs::from_epsg(4326)?),
        None => {
            notes.push(format!(
                "{} names no coordinate reference system: its coordinates are taken as local metres; give --crs",
                path.display()
            ));
            None
        }
        stated => stated,
    };
    let mut gcps: Vec<Gcp> = points.into_iter().map(|p| p.gcp).collect();
    if let Some(table) = &options.accuracy {
        notes.extend(accuracy_list::apply(table, &mut gcps)?);
    }
    let crs = project(path, &mut gcps, source, options.to_crs.as_deref(), &mut notes)?;
    Ok(GcpList { gcps, crs, notes })
}

/// Duplicate names are an error, duplicate places a note.
fn check_points(path: &Path, points: &[RawPoint], notes: &mut Vec<String>) -> Result<()> {
    let mut names = std::collections::HashMap::new();
    let mut places = std::collections::HashMap::new();
    for point in points {
        let gcp = &point.gcp;
        if !gcp.easting.is_finite() || !gcp.northing.is_finite() {
            return Err(Error::format(path, &point.place, format!("point `{}` has no finite coordinates", gcp.name)));
        }
        if let Some(first) = names.insert(gcp.name.as_str(), &point.place) {
            return Err(Error::format(
                path,
                &point.place,
                format!("the name `{}` was used before, in {first}; names must differ", gcp.name),
            ));
        }
        if let Some(other) = places.insert((gcp.easting.to_bits(), gcp.northing.to_bits()), &gcp.name) {
            notes.push(format!("points `{other}` and `{}` have the same coordinates", gcp.name));
        }
    }
    Ok(())
}

fn require_known(path: &Path, points: &[RawPoint], names: &[String]) -> Result<()> {
    match names.iter().find(|name| !points.iter().any(|p| p.gcp.name == **name)) {
        None => Ok(()),
        Some(name) => Err(Error::usage(
            format!("{}: no point is called `{name}`", path.display()),
            format!("it has {}", points.iter().map(|p| p.gcp.name.as_str()).take(12).collect::<Vec<_>>().join(", ")),
        )),
    }
}

/// Into metres: geographic coordinates are projected, feet refused unless a CRS to project to is given.
fn project(
    path: &Path,
    gcps: &mut [Gcp],
    source: Option<Crs>,
    to_crs: Option<&str>,
    notes: &mut Vec<String>,
) -> Result<Option<Crs>> {
    let target = to_crs.map(Crs::parse).transpose()?;
    let Some(source) = source else {
        return match target {
            None => Ok(None),
            Some(_) => Err(Error::usage(
                format!("{}: --to-crs needs to know where the coordinates come from", path.display()),
                "give --crs too",
            )),
        };
    };
    let target = match target {
        Some(target) => target,
        None if source.is_geographic() => {
            let n = gcps.len() as f64;
            let mean = |f: fn(&Gcp) -> f64| gcps.iter().map(f).sum::<f64>() / n;
            let utm = Crs::utm_of(mean(|g| g.easting), mean(|g| g.northing))?;
            notes.push(format!(
                "{}: longitude and latitude were projected to {} ({}), the UTM zone of their mean",
                path.display(),
                utm.label(),
                utm.name()
            ));
            utm
        }
        None => source.clone(),
    };
    if target.is_geographic() {
        return Err(Error::usage(
            format!("{} counts in degrees, in which nothing can be fitted", target.label()),
            "give a projected --to-crs",
        ));
    }
    if (target.metres_per_unit() - 1.0).abs() > 1e-12 {
        notes.push(format!(
            "{} counts in {} ({} m): figures called metres are in that unit; --to-crs gives metres",
            target.label(),
            target.unit_name(),
            target.metres_per_unit()
        ));
    }
    if target != source {
        let mut points: Vec<(f64, f64)> = gcps.iter().map(|g| (g.easting, g.northing)).collect();
        source.project(&mut points, &target)?;
        for (gcp, (easting, northing)) in gcps.iter_mut().zip(points) {
            (gcp.easting, gcp.northing) = (easting, northing);
        }
    }
    Ok(Some(target))
}
