//! What a feature says of itself, as text.

use std::collections::BTreeSet;
use std::path::Path;

use gdal::vector::{Feature, FieldValue};

use crate::gcp::columns::columns;
use crate::gcp::raw::{RawList, RawPoint};
use crate::gcp::units::Unit;
use crate::gcp::{said_of_columns, titles};
use autoref_raster::error::{Error, Result};

/// Titles without which a table has no points; features have their coordinates in a geometry.
const PLACEHOLDERS: [&str; 2] = ["easting", "northing"];

/// What the attributes of all features say: under which titles their heights stand, and how they were read.
#[derive(Default)]
pub(super) struct Told {
    titles: BTreeSet<String>,
    others: bool,
    roles: BTreeSet<said_of_columns::UnclearRole>,
    notes: BTreeSet<String>,
    /// Numbers of features that are no points, and what they are.
    no_points: Vec<(usize, String)>,
}

/// Of several points in one feature none can be named: points are not passed over.
pub(super) fn no_single_point(path: &Path, number: usize) -> Error {
    let what = "it must be a point, it is a MultiPoint of several or none; give each point its own feature";
    Error::format(path, format!("feature {number}"), what)
}

/// Features that are named in one note.
const NAMED: usize = 5;

impl Told {
    /// A point, and the title of the attribute that its height is.
    pub(super) fn height(&mut self, point: &RawPoint, title: Option<String>) {
        match title.filter(|_| point.gcp.height.is_some()) {
            Some(title) => drop(self.titles.insert(title)),
            None => self.others |= point.gcp.height.is_some(),
        }
    }

    /// A feature that is no point: a boundary or a track beside the points, an element without a place.
    pub(super) fn no_point(&mut self, number: usize, what: impl Into<String>) {
        self.no_points.push((number, what.into()));
    }

    /// Hands the unit of all heights to the list, and what is to be said.
    ///
    /// # Errors
    /// A list without points has features of another kind.
    pub(super) fn tell(self, path: &Path, list: &mut RawList) -> Result<()> {
        if let (Some((number, what)), true) = (self.no_points.first(), list.points.is_empty()) {
            let said = format!("it must be a point, it has {what}; give a layer of points");
            return Err(Error::format(path, format!("feature {number}"), said));
        }
        let mut titles = self.titles.into_iter().filter(|_| !self.others);
        if let (Some(title), None) = (titles.next(), titles.next()) {
            list.units.height = Unit::of_title(&title).map(|unit| (unit, title));
        }
        let named = self.no_points.iter().take(NAMED).map(|(number, what)| format!("feature {number} ({what})"));
        let named: Vec<String> = named.collect();
        let more = match self.no_points.len().saturating_sub(NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let passed = (!named.is_empty()).then(|| format!("passed over, no points: {}{more}", named.join(", ")));
        let notes = self.notes.into_iter().chain(said_of_columns::of_roles(&self.roles)).chain(passed);
        list.notes.extend(notes.map(|what| format!("{}: {what}", path.display())));
        Ok(())
    }
}

/// The point of a feature at `place`: its attributes go through the same reading as a table's, with the geometry for
/// the coordinates. With the title that its height was read under.
///
/// # Errors
/// Those of a table's row.
pub(super) fn point(
    path: &Path,
    place: String,
    (titles, own): (&[String], &[String]),
    (x, y): (f64, f64),
    number: &str,
    told: &mut Told,
) -> Result<(RawPoint, Option<String>)> {
    let mut row: Vec<String> = own.iter().cloned().chain([x.to_string(), y.to_string()]).collect();
    // Columns that repeat the coordinates must not win over the geometry.
    let unlike = |(i, title): (usize, &String)| match titles::is_coordinate(title) {
        true => format!("attribute {i}"),
        false => title.clone(),
    };
    let seen = titles.iter().enumerate().map(unlike).chain(PLACEHOLDERS.map(str::to_string)).collect();
    let columns = columns(seen).expect("the placeholders are among the titles");
    // Layers have attributes of any kind; words under a height or an accuracy say nothing of either.
    let of_numbers = columns.sigma.into_iter().chain([columns.height, columns.sigma_height]).flatten();
    for column in of_numbers.filter(|&column| column < own.len()) {
        if !row[column].is_empty() && columns.number(&row[column]).is_none() {
            told.notes.insert(format!("`{}` under `{}` is no number: not read", row[column], titles[column]));
            row[column].clear();
        }
    }
    let mut point = columns.point(path, place, &row, number)?;
    point.attributes = titles.iter().cloned().zip(own.iter().cloned()).collect();
    // No spreadsheet wrote an apostrophe here.
    if let Some(name) = columns.name.and_then(|column| own.get(column)).filter(|name| !name.is_empty()) {
        point.gcp.name.clone_from(name);
    }
    (point.gcp.easting, point.gcp.northing) = (x, y);
    told.roles.extend(columns.unclear_roles(&row));
    told.notes.extend(columns.told_of_accuracies());
    let title = columns.height.and_then(|at| titles.get(at)).cloned();
    Ok((point, title))
}

/// The values of a feature as text, empty where none was set.
pub(super) fn fields(feature: &Feature<'_>) -> Vec<String> {
    let set = |i: usize| feature.field_as_string(i).ok().flatten().is_some_and(|text| !text.is_empty());
    // A number that was never set reads as 0, as text it is empty.
    let value = |i: usize| if set(i) { text(feature.field(i).ok().flatten()) } else { String::new() };
    (0..feature.field_count()).map(value).collect()
}

fn text(value: Option<FieldValue>) -> String {
    match value {
        Some(FieldValue::StringValue(text)) => text.trim().to_string(),
        Some(FieldValue::IntegerValue(value)) => value.to_string(),
        Some(FieldValue::Integer64Value(value)) => value.to_string(),
        Some(FieldValue::RealValue(value)) => value.to_string(),
        _ => String::new(),
    }
}
