//! GCPs as a table: comma, semicolon, tab or blanks between the columns.
//!
//! With a header the columns may stand in any order, under the titles that surveyors use. Without one (Pix4D, total
//! stations) they are: a name, unless every column is a number and the first is no running one; two coordinates; a
//! height; accuracies, one or two (plan, height) or three (of each coordinate). Which of the coordinates is the easting
//! is decided later, by the CRS and the values.

use std::path::Path;

use crate::gcp::angle::angle;
use crate::gcp::headerless::Labels;
use crate::gcp::raw::{ColumnOrder, RawList};
use crate::gcp::text::{self, Line, SEPARATORS, refuse_open_quote, split};
use crate::gcp::titles::{EASTINGS, LONGITUDES, XS, find, tidy};
use crate::gcp::{headerless, marked_rows, titled, wkt};
use autoref_raster::error::{Error, Result};

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    parse_with(path, lines, Labels::Shown)
}

/// Pix4D's: without titles the first column is the label, and of degrees the latitude comes first.
pub(super) fn parse_pix4d(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let mut list = parse_with(path, lines, Labels::First)?;
    if list.order == ColumnOrder::Untitled {
        list.order = ColumnOrder::LatitudeFirst;
    }
    Ok(list)
}

fn parse_with(path: &Path, lines: &[Line<'_>], labels: Labels) -> Result<RawList> {
    let told = marked_rows::told(lines);
    let none = "the file holds no points; a header and one line for each are expected";
    let no_points = || {
        let what = told.remarks.as_ref().map_or(none.to_owned(), |rows| format!("{none}: {rows}"));
        Error::format(path, "row 1", what)
    };
    let mut list = parse_told(path, &told.lines, labels, &no_points)?;
    if list.points.is_empty() && told.remarks.is_some() {
        return Err(no_points());
    }
    list.notes.extend(told.note.iter().map(|what| format!("{}: {what}", path.display())));
    Ok(list)
}

fn parse_told(path: &Path, lines: &[Line<'_>], labels: Labels, no_points: &dyn Fn() -> Error) -> Result<RawList> {
    let Some(first) = lines.iter().find(|line| !line.is_comment()) else { return Err(no_points()) };
    match titled::parse(path, lines).or_else(|| wkt::parse(path, lines)) {
        Some(list) => list,
        None if has_numbers(first.text) => headerless::parse(path, lines, labels),
        None => refuse_open_quote(path, first).and(Err(no_header(path, first))),
    }
}

fn has_numbers(line: &str) -> bool {
    // "5'334'320.91" is a number and no angle.
    let is_value = |field: &str| text::number(field).is_some() || angle(field).is_some();
    SEPARATORS.iter().any(|&separator| split(line, separator).iter().filter(|f| is_value(f)).count() >= 2)
}

fn no_header(path: &Path, line: &Line<'_>) -> Error {
    let shown: String = line.text.chars().take(80).collect();
    let titles = SEPARATORS.iter().map(|&s| split(line.text, s)).max_by_key(Vec::len).unwrap_or_default();
    let titles: Vec<String> = titles.iter().map(|t| tidy(t)).collect();
    let missing = if find(&titles, &[EASTINGS, XS, LONGITUDES].concat()).is_none() { "easting" } else { "northing" };
    Error::format(
        path,
        line.place(),
        format!("no column for the {missing} in the header `{shown}`; name one easting and one northing"),
    )
}
