//! Sheets of a spreadsheet, and other tables without geometry that OGR opens: their cells go through the reading of
//! text tables, so that titles may stand under other rows, and numbers may be text.

use std::path::Path;

use gdal::Dataset;
use gdal::vector::LayerAccess;

use crate::gcp::raw::RawList;
use crate::gcp::text::LARGEST_LIST_BYTES;
use crate::gcp::{attributes, csv_list, text};
use autoref_raster::error::{Error, Result};

/// Drivers of spreadsheets, which guess where the titles are and what the cells hold unless they are told.
const SPREADSHEETS: [&str; 3] = ["XLSX", "XLS", "ODS"];

/// Where the titles of a table are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Titles {
    /// The layer's own fields.
    Fields,
    /// In one of the rows.
    Rows,
}

impl Titles {
    /// In what this driver opens.
    pub fn of(driver: &str) -> Titles {
        if SPREADSHEETS.contains(&driver) { Titles::Rows } else { Titles::Fields }
    }
}

/// Lets GDAL hand out the cells of spreadsheets as they are, the row of titles like the others.
///
/// # Errors
/// Those of `work`.
pub(super) fn with_bare_cells<T>(work: impl FnOnce() -> T) -> T {
    let options: Vec<(String, &str)> = SPREADSHEETS
        .iter()
        .flat_map(|driver| {
            [(format!("OGR_{driver}_HEADERS"), "DISABLE"), (format!("OGR_{driver}_FIELD_TYPES"), "STRING")]
        })
        .collect();
    // Should GDAL not take an option, it guesses, and what it guesses is no title.
    for (option, value) in &options {
        let _ = gdal::config::set_thread_local_config_option(option, value);
    }
    let done = work();
    for (option, _) in &options {
        let _ = gdal::config::clear_thread_local_config_option(option);
    }
    done
}

/// The list of a spreadsheet with several filled sheets of which one alone holds points; the others, of notes and
/// measurements, are named. `None` where another number of them does.
pub(super) fn only_one_with_points(path: &Path, dataset: &Dataset) -> Option<RawList> {
    let (mut lists, mut others) = (Vec::new(), Vec::new());
    for mut layer in dataset.layers().filter(|layer| layer.feature_count() > 0) {
        match parse(path, &mut layer, Titles::Rows) {
            Ok(list) => lists.push(list),
            Err(_) => others.push(layer.name()),
        }
    }
    let mut list = lists.pop().filter(|_| lists.is_empty() && !others.is_empty())?;
    list.notes.push(format!("{}: passed over, without a list of points: sheet {}", path.display(), others.join(", ")));
    Some(list)
}

/// # Errors
/// Those of [`csv_list::parse`]; when the cells hold more than a list does.
pub(super) fn parse(path: &Path, layer: &mut impl LayerAccess, titles: Titles) -> Result<RawList> {
    let mut table = Vec::new();
    if titles == Titles::Fields {
        let fields: Vec<String> = layer.defn().fields().map(|field| field.name()).collect();
        push(&mut table, &fields);
    }
    for feature in layer.features() {
        push(&mut table, &attributes::fields(&feature));
        if table.len() as u64 > LARGEST_LIST_BYTES {
            let what = format!("a table of more than {} MiB", LARGEST_LIST_BYTES >> 20);
            return Err(Error::unsupported(path, what, "cut the list to the area of the image"));
        }
    }
    let table = String::from_utf8_lossy(&table);
    csv_list::parse(path, &text::lines(&table))
}

/// A row of quoted cells: a name that begins as remarks do stays one.
fn push(table: &mut Vec<u8>, cells: &[String]) {
    for (at, cell) in cells.iter().enumerate() {
        let plain = cell.replace(['\n', '\r'], " ").replace('"', "\"\"");
        let separator = if at > 0 { ";" } else { "" };
        table.extend(format!("{separator}\"{plain}\"").bytes());
    }
    table.push(b'\n');
}
