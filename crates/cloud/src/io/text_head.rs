//! What stands above the rows of a table of text: names of the columns, remarks, and how many rows there are.

use std::fs::File;
use std::io::{BufReader, Seek};
use std::path::Path;

use super::text_line::{has_decimal_commas, has_quoted_commas, has_thousands, next_line, number, words};
use crate::error::{Error, Result};
use crate::schema::{Kind, Schema};

/// What follows the sign of a remark, which may be the head of the table.
pub(super) fn remark(line: &str) -> Option<&str> {
    line.strip_prefix("//").or_else(|| line.strip_prefix('#')).map(|rest| rest.trim_start_matches(['#', '/']).trim())
}

/// What helps where commas could be either.
pub(super) const DECIMAL_COMMAS: &str = "write decimal points, or semicolons between the columns";

/// What helps where numbers are grouped.
pub(super) const NO_THOUSANDS: &str = "write the numbers without them";

/// Names of x, y and z; where several are there, the first counts.
const AXES: [&[&str]; 3] = [
    &["x", "e", "east", "easting", "rechtswert", "ostwert", "est", "este"],
    &["y", "n", "north", "northing", "hochwert", "nordwert", "nord", "norte"],
    // The last is `höhe` in Latin-1, as spreadsheets save it.
    &["z", "h", "height", "elevation", "elev", "altitude", "hoehe", "höhe", "h\u{fffd}he"],
];

/// The name of a column without its unit, which is metres: `X [m]`.
fn bare_name(word: &str) -> String {
    let name = word.to_lowercase();
    let bare = ["[m]", "(m)"].into_iter().find_map(|unit| name.strip_suffix(unit)).map(str::trim_end);
    bare.filter(|bare| !bare.is_empty()).map_or_else(|| name.clone(), str::to_string)
}

fn names_all_axes(row: &[&str]) -> bool {
    AXES.iter().all(|axis| row.iter().any(|word| axis.contains(&bare_name(word).as_str())))
}

/// Whether the words name longitude and latitude, or easting and northing: the columns of another kind of table.
fn names_places(row: &[&str]) -> bool {
    let starts = |start: &str| row.iter().any(|word| word.to_ascii_lowercase().starts_with(start));
    (starts("lon") && starts("lat")) || (starts("east") && starts("north"))
}

/// The words that stand above the numbers.
struct Names {
    words: Vec<String>,
    /// They stand in a remark, which may be a sentence.
    in_remark: bool,
}

/// A line that says how many rows follow, as PTS files have it before each scan and CloudCompare on request.
#[derive(Clone, Copy, Debug)]
pub(super) struct Count {
    pub rows: u64,
    pub line: u64,
}

impl Count {
    pub(super) fn of(text: &str, line: u64) -> Option<Count> {
        text.parse().ok().map(|rows| Count { rows, line })
    }
}

/// All that stands above the first row.
pub(super) struct Head {
    names: Option<Names>,
    pub(super) count: Option<Count>,
    pub(super) columns: usize,
    /// The columns of colour and intensity that a PTS file does not name.
    unnamed: &'static [&'static str],
}

impl Head {
    /// Whether nothing says what the columns are, of which the first may be a number of the point.
    pub(super) fn may_begin_with_numbers(&self) -> bool {
        let is_named = self.names.as_ref().is_some_and(|names| !names.in_remark || names.words.len() == self.columns);
        !is_named && self.unnamed.is_empty() && self.columns >= 4
    }
}

/// What the columns behind x, y and z of a PTS file are: intensity, red, green and blue, or some of them.
fn columns_of_pts(path: &Path, row: &[&str]) -> &'static [&'static str] {
    const ALL: [&str; 4] = ["intensity", "red", "green", "blue"];
    let is_colour = |word: &&str| word.parse::<u8>().is_ok();
    let is_pts = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("pts"));
    match row.len() {
        4 if is_pts => &ALL[..1],
        6 if is_pts && row[3..].iter().all(is_colour) => &ALL[1..],
        7 if is_pts && row[4..].iter().all(is_colour) => &ALL,
        _ => &[],
    }
}

/// Reads up to the first row of numbers, which is the next to be read then. A table without rows has the columns of its
/// head, or three.
pub(super) fn read(path: &Path, file: &mut BufReader<File>, line: &mut u64, bytes: &mut Vec<u8>) -> Result<Head> {
    let mut names: Option<Names> = None;
    let mut count: Option<Count> = None;
    // Columns that a remark names, none of them x, y and z.
    let mut others: Vec<String> = Vec::new();
    loop {
        let before = (file.stream_position().map_err(|e| Error::io(path, "seek", e))?, *line);
        let Some(text) = next_line(path, file, line, bytes)? else {
            let columns = names.as_ref().map_or(3, |names| names.words.len());
            return Ok(Head { names, count, columns, unnamed: &[] });
        };
        let row = match remark(text) {
            // Other remarks say nothing of the table, but for what the columns are if not x, y and z.
            Some(rest) if names.is_some() || !names_all_axes(&words(rest)) => {
                if names_places(&words(rest)) {
                    others = words(rest).into_iter().map(str::to_string).collect();
                }
                continue;
            }
            Some(rest) => words(rest),
            None => words(text),
        };
        if remark(text).is_none() && has_quoted_commas(text) && words(&text.replace('"', "")).len() > 2 {
            let what = format!("`{text}` has commas within quotes: {DECIMAL_COMMAS}");
            return Err(Error::format(path, format!("line {line}"), what));
        }
        if row.iter().all(|word| number(word).is_some()) {
            if let ([word], None | Some(Count { rows: 0, .. })) = (&row[..], count) {
                count = Count::of(word, *line);
                if count.is_some() {
                    continue;
                }
            }
            if row.len() == 1 && count.is_some() {
                let what = "two numbers alone begin a PTX file, whose points stand in the axes of the scanner: \
                            save them as PTS, E57 or LAS";
                return Err(Error::format(path, format!("line {line}"), what));
            }
            let columns = row.len();
            if names.is_none() && others.len() == columns {
                let what = format!("no columns X, Y and Z among {}", others.join(", "));
                return Err(Error::format(path, "head", what));
            }
            let unnamed = columns_of_pts(path, &row);
            file.seek(std::io::SeekFrom::Start(before.0)).map_err(|e| Error::io(path, "seek", e))?;
            *line = before.1;
            return Ok(Head { names, count, columns, unnamed });
        }
        if names.is_some() || row.len() < 3 || row.iter().any(|word| number(word).is_some()) {
            let what = if has_decimal_commas(text) {
                format!("`{text}` has decimal commas between blanks: {DECIMAL_COMMAS}")
            } else if has_thousands(text) {
                format!("`{text}` has marks between thousands: {NO_THOUSANDS}")
            } else if names.is_some() {
                format!("`{text}` is no row of numbers: leave columns of words out")
            } else {
                format!("`{text}` is neither a row of numbers nor a head with the columns X, Y and Z")
            };
            return Err(Error::format(path, format!("line {line}"), what));
        }
        // What noise is told by, under the names that tables give it.
        let named = |word: &&str| match bare_name(word) {
            name if name == "class" || name == "scalar_classification" => "classification".to_string(),
            other => other,
        };
        names = Some(Names { words: row.iter().map(named).collect(), in_remark: remark(text).is_some() });
    }
}

/// The names of the columns: those of the head, or x, y, z and numbers. `line` is the one before the first row.
pub(super) fn names_of(path: &Path, head: Head, line: u64) -> Result<Vec<String>> {
    let Head { names, columns, unnamed, .. } = head;
    // A sentence about x, y and z is no head.
    let named = names.filter(|names| !names.in_remark || names.words.len() == columns);
    let names = named.map_or_else(
        || {
            let numbered = (4..=columns).skip(unnamed.len()).map(|number| format!("column_{number}"));
            ["x", "y", "z"].iter().chain(unnamed).map(|name| name.to_string()).chain(numbered).collect()
        },
        |names| names.words,
    );
    if names.len() != columns {
        let what = format!("{columns} numbers below a head of {} columns", names.len());
        return Err(Error::format(path, format!("line {}", line + 1), what));
    }
    Ok(names)
}

/// Which columns x, y and z are; no name may be there twice.
pub(super) fn axes_among(path: &Path, names: &[String]) -> Result<[usize; 3]> {
    let mut axes = [0; 3];
    for (place, words) in axes.iter_mut().zip(AXES) {
        *place = words.iter().find_map(|word| names.iter().position(|name| name == word)).ok_or_else(|| {
            Error::format(path, "head", format!("no column `{}` among {}", words[0].to_uppercase(), names.join(", ")))
        })?;
    }
    if let Some(twice) = (1..names.len()).find(|&index| names[..index].contains(&names[index])) {
        return Err(Error::format(path, "head", format!("the column `{}` is there twice", names[twice])));
    }
    Ok(axes)
}

pub(super) fn schema_of(names: &[String], axes: [usize; 3]) -> Schema {
    let mut schema = Schema::default();
    for (index, name) in names.iter().enumerate() {
        let axis = axes.iter().position(|&axis| axis == index);
        schema.push(axis.map_or(name.as_str(), |axis| ["x", "y", "z"][axis]), Kind::F64);
    }
    schema
}
