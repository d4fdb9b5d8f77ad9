//! GCPs as a table with a header: columns in any order, under the names that surveyors use; comma, semicolon, tab or
//! blanks between them, decimal commas where the separator is another.

use std::path::Path;

use crate::error::{Error, Result};
use crate::gcp::read::{RawList, RawPoint};
use crate::gcp::{Gcp, GcpRole};
use crate::georef::crs::Crs;

pub(super) const NAMES: [&str; 14] = [
    "name",
    "id",
    "point",
    "pt",
    "gcp",
    "label",
    "navn",
    "punkt",
    "punktnavn",
    "nr",
    "no",
    "number",
    "pointid",
    "gcp_id",
];
const EASTINGS: [&str; 12] =
    ["easting", "east", "e", "x", "øst", "ost", "utm_e", "x_easting", "e_m", "easting_m", "rechtswert", "rw"];
const NORTHINGS: [&str; 12] =
    ["northing", "north", "n", "y", "nord", "utm_n", "y_northing", "n_m", "northing_m", "hochwert", "hw", "nor"];
const HEIGHTS: [&str; 12] =
    ["height", "h", "z", "elevation", "elev", "alt", "altitude", "høyde", "hoyde", "height_m", "kote", "z_m"];
const LONGITUDES: [&str; 4] = ["lon", "long", "longitude", "lng"];
const LATITUDES: [&str; 2] = ["lat", "latitude"];
const SIGMAS: [&str; 5] = ["sigma_m", "sigma", "accuracy", "accuracy_m", "std"];
const SIGMA_HEIGHTS: [&str; 3] = ["sigma_height_m", "sigma_h", "accuracy_z"];
const ROLES: [&str; 3] = ["role", "type", "use"];

struct Columns {
    name: Option<usize>,
    easting: usize,
    northing: usize,
    height: Option<usize>,
    sigma: Option<usize>,
    sigma_height: Option<usize>,
    role: Option<usize>,
    geographic: bool,
}

pub(super) fn parse(path: &Path, text: &str) -> Result<RawList> {
    let mut lines = text
        .lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .filter(|(_, line)| !line.is_empty() && !line.starts_with('#'));
    let Some((header_row, header)) = lines.next() else {
        return Err(Error::format(path, "row 1", "the file holds no header and no points"));
    };
    let separator = separator(header);
    let titles: Vec<String> =
        split(header, separator).into_iter().map(|t| t.trim_matches('"').trim().to_lowercase()).collect();
    let columns = columns(path, header_row, &titles)?;
    let mut points = Vec::new();
    for (row, line) in lines {
        points.push(point(path, row, &split(line, separator), &columns, separator)?);
    }
    let crs = columns.geographic.then(|| Crs::from_epsg(4326)).transpose()?;
    Ok(RawList { points, crs, may_be_degrees: false, notes: Vec::new() })
}

pub(super) fn separator(header: &str) -> char {
    // The one that cuts the header most often; blanks only when there is nothing else.
    [';', '\t', ','].into_iter().find(|&c| header.contains(c)).unwrap_or(' ')
}

pub(super) fn split(line: &str, separator: char) -> Vec<String> {
    if separator == ' ' {
        return line.split_whitespace().map(str::to_string).collect();
    }
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .delimiter(separator as u8)
        .trim(csv::Trim::All)
        .flexible(true)
        .from_reader(line.as_bytes());
    reader
        .records()
        .next()
        .and_then(std::result::Result::ok)
        .map(|record| record.iter().map(str::to_string).collect())
        .unwrap_or_default()
}

fn columns(path: &Path, row: usize, titles: &[String]) -> Result<Columns> {
    let find = |names: &[&str]| {
        // In order of the names: "northing" before "n".
        names.iter().find_map(|name| {
            titles.iter().position(|t| t == name || t.split(['[', '(']).next().is_some_and(|head| head.trim() == *name))
        })
    };
    let (longitude, latitude) = (find(&LONGITUDES), find(&LATITUDES));
    let geographic = longitude.is_some() && latitude.is_some();
    let (easting, northing) = if geographic { (longitude, latitude) } else { (find(&EASTINGS), find(&NORTHINGS)) };
    let (Some(easting), Some(northing)) = (easting, northing) else {
        let missing = if easting.is_none() { "easting" } else { "northing" };
        return Err(Error::format(
            path,
            format!("row {row}"),
            format!(
                "no column for the {missing} in the header `{}`; name one easting and one northing",
                titles.join(",")
            ),
        ));
    };
    Ok(Columns {
        name: find(&NAMES),
        easting,
        northing,
        height: find(&HEIGHTS),
        sigma: find(&SIGMAS),
        sigma_height: find(&SIGMA_HEIGHTS),
        role: find(&ROLES),
        geographic,
    })
}

fn point(path: &Path, row: usize, fields: &[String], columns: &Columns, separator: char) -> Result<RawPoint> {
    let place = format!("row {row}");
    let text = |column: usize| fields.get(column).map(|t| t.trim()).filter(|t| !t.is_empty());
    let number = |column: usize, what: &str| -> Result<Option<f64>> {
        let Some(text) = text(column) else { return Ok(None) };
        parse_number(text, separator)
            .map(Some)
            .ok_or_else(|| Error::format(path, &place, format!("`{text}` is no number for the {what}")))
    };
    let required = |column: usize, what: &str| -> Result<f64> {
        number(column, what)?.ok_or_else(|| Error::format(path, &place, format!("the {what} is missing")))
    };
    let optional = |column: Option<usize>, what: &str| column.map_or(Ok(None), |c| number(c, what));
    let gcp = Gcp {
        name: columns.name.and_then(text).map_or_else(|| row.to_string(), str::to_string),
        easting: required(columns.easting, "easting")?,
        northing: required(columns.northing, "northing")?,
        height: optional(columns.height, "height")?,
        sigma_m: optional(columns.sigma, "accuracy")?,
        sigma_height_m: optional(columns.sigma_height, "accuracy of the height")?,
        role: match columns.role.and_then(text).map(str::to_lowercase).as_deref() {
            Some("check" | "checkpoint" | "check point") => GcpRole::Check,
            _ => GcpRole::Control,
        },
    };
    Ok(RawPoint { gcp, place })
}

/// A decimal point, or a decimal comma where commas do not separate columns.
pub(super) fn parse_number(text: &str, separator: char) -> Option<f64> {
    let plain = text.trim_matches('"').replace(['\u{a0}', '\u{202f}', '\''], "");
    let value = match plain.parse::<f64>() {
        Ok(value) => value,
        Err(_) if separator != ',' || text.starts_with('"') => plain.replace(',', ".").parse().ok()?,
        Err(_) => return None,
    };
    value.is_finite().then_some(value)
}
