//! Tables of colours: three numbers or one `#RRGGBB` a row.

use std::fmt;
use std::path::Path;

use crate::gcp::text::decode;
use crate::profile::colour::srgb_from_lab;
use crate::profile::srgb_of_hex;
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// Most colours of a table.
const MOST: usize = 4_000_000;
/// Largest table.
const TABLE_BYTES: u64 = 256 << 20;

/// Colours as a table has them.
#[derive(Clone, Debug)]
pub struct ColourTable {
    /// sRGB 0..=1.
    pub colours: Vec<[f64; 3]>,
    /// The row of each, counted from 1.
    pub rows: Vec<usize>,
    pub values: ColourValues,
    /// What the numbers look like that they were not taken for.
    pub note: Option<&'static str>,
}

/// What the numbers of a table are taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ColourValues {
    Unit,
    Bytes,
    Hex,
    Lab,
}

impl fmt::Display for ColourValues {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            ColourValues::Unit => "red, green, blue of 0 to 1",
            ColourValues::Bytes => "red, green, blue of 0 to 255",
            ColourValues::Hex => "#RRGGBB",
            ColourValues::Lab => "L*a*b*",
        })
    }
}

/// Where a row has its colour.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Columns {
    Rgb([usize; 3]),
    Lab([usize; 3]),
    Hex(usize),
}

/// Reads a table of colours: red, green, blue a row, of 0 to 1 or of 0 to 255, or `#RRGGBB`, with or without titles;
/// commas, semicolons, tabs or spaces between; in any encoding that a list may have. With titles, the columns named
/// red/r, green/g, blue/b are taken, or that named hex, or L, a, b (L*, a*, b*). A table is of 0 to 1 when no value in
/// it is above 1, but for what reckoning adds.
///
/// # Errors
/// [`Error::Format`] naming the row that is no colour; [`Error::Limit`] above four million rows.
pub fn read_colours(path: &Path) -> Result<ColourTable> {
    let bytes = bounded::read(path, "a table of colours", TABLE_BYTES)?;
    let text = decode(&bytes).ok_or_else(|| Error::format(path, "row 1", "is no table of text"))?;
    let (mut colours, mut rows): (Vec<[f64; 3]>, Vec<usize>) = Default::default();
    let mut titled = false;
    let (mut columns, mut divider) = (None, None);
    for (index, line) in text.lines().enumerate() {
        let line = line.trim_start_matches('\u{feff}').trim();
        let wrong = |what: String| Error::format(path, format!("row {}", index + 1), what);
        let first = line.split([',', ';', '\t', ' ']).next().map(plain);
        let begins_with_colour = first.is_some_and(|cell| srgb_of_hex(&cell).is_some());
        // Of hexadecimal colours one with a slip begins as a comment does.
        let comment = if matches!(columns, Some(Columns::Hex(_))) { "# " } else { "#" };
        if line.is_empty() || (line.starts_with(comment) && !begins_with_colour) {
            continue;
        }
        let cells = cells(line, *divider.get_or_insert_with(|| Divider::of(line)));
        let is_title = |cell: &String| cell.parse::<f64>().is_err() && srgb_of_hex(cell).is_none();
        if columns.is_none() && cells.iter().all(is_title) {
            columns = Some(titles(&cells).ok_or_else(|| wrong(unknown_titles(&cells)))?);
            titled = true;
            continue;
        }
        let untitled = if begins_with_colour { Columns::Hex(0) } else { Columns::Rgb([0, 1, 2]) };
        let columns = *columns.get_or_insert(untitled);
        let expected = if columns == Columns::Hex(0) { 1 } else { 3 };
        if !titled && cells.len() != expected {
            let of = if expected == 1 { "one #RRGGBB is" } else { "red, green and blue are" };
            return Err(wrong(format!("{} where {of} expected", counted(cells.len(), "value", "values"))));
        }
        colours.push(colour(&cells, columns, titled).map_err(wrong)?);
        rows.push(index + 1);
        if colours.len() > MOST {
            return Err(Error::Limit {
                what: format!("{}: colours", path.display()),
                needed: MOST as u64 + 1,
                allowed: MOST as u64,
                remedy: "thin the table out".into(),
            });
        }
    }
    Ok(scaled(colours, rows, columns))
}

/// Shares of one that were reckoned may come out so large; of bytes no table of a paint is as dark.
const A_LITTLE_ABOVE_ONE: f64 = 1.5;

/// The table with its colours as sRGB 0..=1.
fn scaled(mut colours: Vec<[f64; 3]>, rows: Vec<usize>, columns: Option<Columns>) -> ColourTable {
    let mut all = colours.iter().flatten();
    let (values, by) = match columns {
        Some(Columns::Hex(_)) => (ColourValues::Hex, 255.0),
        Some(Columns::Lab(_)) => (ColourValues::Lab, 1.0),
        _ if all.any(|v| *v > A_LITTLE_ABOVE_ONE) => (ColourValues::Bytes, 255.0),
        _ => (ColourValues::Unit, 1.0),
    };
    // Samples of 8 bits have no fractions, and marks in the sun reach beyond 100.
    let like_shares = values == ColourValues::Bytes
        && colours.iter().flatten().all(|v| *v <= 100.0)
        && colours.iter().flatten().any(|v| v.fract() != 0.0);
    let note = like_shares.then_some(
        "the values have fractions and none is above 100, as percentages have: of these, give hundredths (0 to 1)",
    );
    colours.iter_mut().flatten().for_each(|v| *v = (*v / by).min(1.0));
    ColourTable { colours, rows, values, note }
}

/// The colour of a row; of red, green and blue as they are written.
fn colour(cells: &[String], columns: Columns, titled: bool) -> std::result::Result<[f64; 3], String> {
    let cell = |column: usize| cells.get(column).map_or("", String::as_str);
    let number = |column: usize, from: f64, to: f64| {
        cell(column).parse::<f64>().ok().filter(|v| (from..=to).contains(v)).ok_or(column)
    };
    match columns {
        Columns::Hex(column) => {
            let text = cell(column);
            let with_sign = if text.starts_with('#') { text.to_owned() } else { format!("#{text}") };
            let colour = srgb_of_hex(&with_sign).ok_or_else(|| format!("`{text}` is no #RRGGBB"))?;
            Ok(colour.map(f64::from))
        }
        Columns::Lab([l, a, b]) => {
            let lab = number(l, 0.0, 100.0)
                .and_then(|l| Ok([l, number(a, -128.0, 128.0)?, number(b, -128.0, 128.0)?]))
                .map_err(|column| format!("`{}` is no value of L* (0 to 100), a* or b* (-128 to 128)", cell(column)))?;
            Ok(srgb_from_lab(lab))
        }
        Columns::Rgb(columns) => {
            let mut rgb = [0.0; 3];
            for (value, column) in rgb.iter_mut().zip(columns) {
                *value = number(column, 0.0, 255.0).map_err(|column| {
                    let is_negative = cell(column).parse::<f64>().is_ok_and(|v| v < 0.0);
                    let hint = "; L*a*b* is read where the columns are titled L, a and b";
                    let hint = if is_negative && !titled { hint } else { "" };
                    format!("`{}` is no value of 0 to 1 or 0 to 255{hint}", cell(column))
                })?;
            }
            Ok(rgb)
        }
    }
}

/// What divides the cells of a table: that of its first row.
#[derive(Clone, Copy)]
enum Divider {
    Character(char),
    Blanks,
}

impl Divider {
    fn of(line: &str) -> Divider {
        let words = || line.split_whitespace();
        // Commas among blanks are decimal ones where every word is a number with them.
        let is_number = |word: &str| !word.starts_with(',') && plain(&word.replace(',', ".")).parse::<f64>().is_ok();
        match [';', '\t'].into_iter().find(|divider| line.contains(*divider)) {
            Some(divider) => Divider::Character(divider),
            None if line.contains(',') && !(words().count() >= 3 && words().all(is_number)) => Divider::Character(','),
            None if words().count() >= 3 => Divider::Blanks,
            None => Divider::Character(','),
        }
    }
}

fn plain(cell: &str) -> String {
    cell.trim().trim_matches('"').to_owned()
}

/// What stands between the dividers. A decimal comma is one where semicolons, tabs or blanks divide.
fn cells(line: &str, divider: Divider) -> Vec<String> {
    match divider {
        Divider::Character(',') => line.split(',').map(plain).collect(),
        Divider::Character(divider) => line.split(divider).map(|cell| plain(&cell.replace(',', "."))).collect(),
        Divider::Blanks => line.split_whitespace().map(|cell| plain(&cell.replace(',', "."))).collect(),
    }
}

fn titles(cells: &[String]) -> Option<Columns> {
    let column =
        |names: [&str; 2]| cells.iter().position(|cell| names.iter().any(|name| cell.eq_ignore_ascii_case(name)));
    let three = |names: [[&str; 2]; 3]| Some([column(names[0])?, column(names[1])?, column(names[2])?]);
    three([["red", "r"], ["green", "g"], ["blue", "b"]])
        .map(Columns::Rgb)
        .or_else(|| cells.iter().position(|cell| cell.eq_ignore_ascii_case("hex")).map(Columns::Hex))
        .or_else(|| three([["L*", "L"], ["a*", "a"], ["b*", "b"]]).map(Columns::Lab))
}

fn unknown_titles(cells: &[String]) -> String {
    let given: Vec<&str> = cells.iter().map(String::as_str).collect();
    format!(
        "no columns red, green and blue in `{}`: the titles red, green, blue (or r, g, b), hex, and L, a, b are read",
        autoref_raster::words::some_of(&given)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_bytes(bytes: &[u8]) -> Result<ColourTable> {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), bytes).expect("writable");
        read_colours(file.path())
    }

    fn read(text: &str) -> Result<ColourTable> {
        read_bytes(text.as_bytes())
    }

    fn same(found: &ColourTable, expected: &[[f64; 3]], within: f64) -> bool {
        let pairs = || found.colours.iter().flatten().zip(expected.iter().flatten());
        found.colours.len() == expected.len() && pairs().all(|(one, other)| (one - other).abs() < within)
    }

    #[test]
    fn tables_as_people_have_them() {
        let expected = [[1.0, 0.2, 0.4], [0.6, 0.8, 0.0]];
        for (text, values) in [
            ("255,51,102\n153,204,0\n", ColourValues::Bytes),
            ("255 51 102\n153 204 0\n", ColourValues::Bytes),
            ("255, 51, 102\r\n153, 204, 0\r\n", ColourValues::Bytes),
            ("255 ,51 ,102\n153 ,204 ,0\n", ColourValues::Bytes),
            ("name,r,g,b\nroof mark 3,255,51,102\nb,153,204,0\n", ColourValues::Bytes),
            ("1.0000001,0.2,0.4\n0.6,0.8,0\n", ColourValues::Unit),
            ("1 0,2 0,4\n0,6 0,8 0\n", ColourValues::Unit),
            ("r;g;b\n255;51;102\n153;204;0\n", ColourValues::Bytes),
            ("\u{feff}Blue\tGreen\tname\tRed\n102\t51\ta\t255\n0\t204\tb\t153\n", ColourValues::Bytes),
            ("1;0,2;0,4\n0,6;0,8;0\n", ColourValues::Unit),
            ("# from a raw image\n1 0.2 0.4\n\n0.6 0.8 0\n", ColourValues::Unit),
            ("#FF3366\n#99cc00\n", ColourValues::Hex),
            ("# paint\nname,Hex\na,#ff3366\nb,99CC00\n", ColourValues::Hex),
            ("hex;name\n\"#ff3366\";a\n#99cc00;b\n", ColourValues::Hex),
        ] {
            let found = read(text).unwrap_or_else(|e| panic!("{text}: {e}"));
            assert!(same(&found, &expected, 1e-12) && found.values == values, "{text}: {found:?}");
            let wide: Vec<u8> = [0xFEFF].into_iter().chain(text.encode_utf16()).flat_map(u16::to_le_bytes).collect();
            assert!(same(&read_bytes(&wide).expect("UTF-16"), &expected, 1e-12), "{text}");
        }
        let lab = read("L*,a*,b*\n53.2408,80.0925,67.2032\n100,0,0\n").expect("L*a*b*");
        assert!(same(&lab, &[[1.0, 0.0, 0.0], [1.0; 3]], 2e-3) && lab.values == ColourValues::Lab, "{lab:?}");
    }

    #[test]
    fn values_that_look_like_percentages_are_noted() {
        let noted = |text: &str| read(text).expect("a table").note.is_some();
        assert!(noted("93.33,38.04,9.02\n90.6,37.25,9\n"));
        assert!(!noted("93,38,9\n90,37,9\n") && !noted("193.33,38.04,9.02\n") && !noted("0.93,0.38,0.09\n"));
    }

    #[test]
    fn what_is_no_table_of_colours_is_refused_with_its_row() {
        for (text, what) in [
            ("1,2\n", "row 1: 2 values"),
            ("1,2,3\n4,5,300\n", "row 2: `300`"),
            ("1,2,3\n4,x,5\n", "row 2: `x`"),
            ("x,y,z\n1,2,3\n", "row 1: no columns red, green and blue in `x, y, z`: the titles red"),
            ("57.1,-3.2,20\n", "row 1: `-3.2` is no value of 0 to 1 or 0 to 255; L*a*b* is read where"),
            ("hex\n#12345\n", "row 2: `#12345`"),
            ("#123456\n1,2,3\n", "row 2: 3 values where one #RRGGBB is expected"),
        ] {
            let error = read(text).expect_err(text).to_string();
            assert!(error.contains(what), "{text}: {error}");
        }
    }
}
