//! Coordinates as instruments and field programs write them. Measurements are never reduced here: a file without
//! coordinates is refused with what to export instead.

mod carlson;
mod gsi;
mod jobxml;
mod landxml;
mod sbg;
mod sdr;
mod sima;

use std::path::Path;

use crate::gcp::list_format::ListFormat;
use crate::gcp::raw::{RawList, RawPoint};
use crate::gcp::text::Line;
use autoref_raster::error::{Error, Result};

/// The format of a text, by its content; by the end of its name where that tells more.
pub(super) fn recognised(extension: &str, text: &str) -> Option<ListFormat> {
    let start = text.trim_start();
    let first = start.lines().next().unwrap_or_default();
    if start.starts_with('<') {
        let head: String = start.chars().take(4096).collect();
        return match () {
            () if begins(&head, "LandXML") => Some(ListFormat::LandXml),
            () if begins(&head, "JOBFile") => Some(ListFormat::JobXml),
            () => None,
        };
    }
    match () {
        () if extension == "gsi" || gsi::is_block(first) => Some(ListFormat::Gsi),
        () if extension == "sdr" || first.starts_with("00NMSDR") => Some(ListFormat::Sdr),
        () if matches!(extension, "sim" | "sima") || sima::is_head(first) => Some(ListFormat::Sima),
        () if sbg::is_head(first) => Some(ListFormat::SbgGeo),
        () if matches!(extension, "rw5" | "rw7") || carlson::is_record(first) => Some(ListFormat::Carlson),
        () => None,
    }
}

/// Whether an element of this name begins in the text, with a prefix or without.
fn begins(text: &str, element: &str) -> bool {
    text.match_indices(element).any(|(at, _)| {
        let before = text[..at].rsplit('<').next().unwrap_or_default();
        let is_prefix = |prefix: &str| prefix.chars().all(|c| c.is_alphanumeric() || "._-".contains(c));
        text[..at].contains('<') && (before.is_empty() || before.strip_suffix(':').is_some_and(is_prefix))
    })
}

/// The list in one of the formats of this room; `None` when the format is another.
///
/// # Errors
/// When a record is broken, or none holds a point.
pub(super) fn parse(path: &Path, text: &str, lines: &[Line<'_>], format: ListFormat) -> Option<Result<RawList>> {
    Some(match format {
        ListFormat::Gsi => gsi::parse(path, lines),
        ListFormat::Sdr => sdr::parse(path, text),
        ListFormat::Carlson => carlson::parse(path, lines),
        ListFormat::SbgGeo => sbg::parse(path, lines),
        ListFormat::Sima => sima::parse(path, lines),
        ListFormat::LandXml => landxml::parse(path, text),
        ListFormat::JobXml => jobxml::parse(path, text),
        _ => return None,
    })
}

/// What a number that is none says.
fn no_number(path: &Path, place: &str, text: &str, what: &str) -> Error {
    Error::format(path, place, format!("`{text}` is no number for the {what}; correct or remove the record"))
}

/// Adds stations to the points of which some were seen from them. One whose name is there already, as a point or a
/// station before, is not added again where it lies in the same place.
fn add_stations(points: &mut Vec<RawPoint>, stations: Vec<RawPoint>) {
    let plan = |point: &RawPoint| (point.gcp.easting.to_bits(), point.gcp.northing.to_bits());
    let mut known: std::collections::HashSet<_> =
        points.iter().map(|point| (point.gcp.name.clone(), plan(point))).collect();
    points.extend(stations.into_iter().filter(|station| known.insert((station.gcp.name.clone(), plan(station)))));
}
