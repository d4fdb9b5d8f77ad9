//! Tables of text: x, y, z and further columns, separated by semicolons, tabs, commas or blanks, whichever comes first
//! in this order; beside semicolons and tabs a comma is a decimal one.

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::{Path, PathBuf};

use super::{Format, Header, PointReader, Precision};
use crate::error::{Error, Result};
use crate::schema::{Batch, Kind, Schema};

const MOST_LINE_BYTES: u64 = 1 << 16;
const MOST_COLUMNS: usize = 256;

struct TextReader {
    path: PathBuf,
    file: BufReader<File>,
    /// Of x, y and z among the columns.
    axes: [usize; 3],
    columns: usize,
    line: u64,
    bytes: Vec<u8>,
}

/// Calls `take` with each word of a line, up to the first that it does not take.
fn each_word<'a>(line: &'a str, mut take: impl FnMut(&'a str) -> Option<()>) -> Option<()> {
    let mut bare = |word: &'a str| take(word.trim_matches('"'));
    match [';', '\t', ','].into_iter().find(|cut| line.contains(*cut)) {
        // Tables in columns have blanks beside their tabs.
        Some('\t') => line.split('\t').map(str::trim).filter(|word| !word.is_empty()).try_for_each(|word| {
            if word.contains(' ') { word.split_whitespace().try_for_each(&mut bare) } else { bare(word) }
        }),
        // Some programs end every row with the separator.
        Some(cut) => line.strip_suffix(cut).unwrap_or(line).split(cut).try_for_each(|word| bare(word.trim())),
        None => line.split_whitespace().try_for_each(bare),
    }
}

/// The number that a word is.
fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| word.contains(',').then(|| word.replacen(',', ".", 1).parse().ok()).flatten())
}

fn words(line: &str) -> Vec<&str> {
    let mut words = Vec::new();
    each_word(line, |word| {
        words.push(word);
        Some(())
    });
    words
}

/// Appends the numbers of a row, the bytes of each; answers how many. `None` where a word is no number.
fn numbers(line: &str, raw: &mut Vec<u8>) -> Option<usize> {
    let mut count = 0;
    each_word(line, |word| {
        raw.extend_from_slice(&number(word)?.to_le_bytes());
        count += 1;
        Some(())
    })?;
    Some(count)
}

/// What [`numbers`] does, in one pass over the bytes, of nearly every row of nearly every table: plain numbers between
/// blanks or between commas. `None` of all others, whatever they are.
fn plain_numbers(line: &[u8], raw: &mut Vec<u8>) -> Option<usize> {
    let (mut rest, mut count, mut commas) = (line.trim_ascii(), 0, None);
    while !rest.is_empty() {
        let is_sign = |byte: &u8| matches!(byte, b'0'..=b'9' | b'.' | b'-' | b'+' | b'e' | b'E');
        let length = rest.iter().position(|byte| !is_sign(byte)).unwrap_or(rest.len());
        let number: f64 = std::str::from_utf8(&rest[..length]).ok()?.parse().ok()?;
        raw.extend_from_slice(&number.to_le_bytes());
        count += 1;
        let between = &rest[length..];
        if between.is_empty() {
            break;
        }
        rest = between.trim_ascii_start();
        let here = rest.first() == Some(&b',');
        if *commas.get_or_insert(here) != here || (!here && rest.len() == between.len()) {
            return None;
        }
        if here {
            rest = rest[1..].trim_ascii_start();
            // Tabs come before commas; an empty word is left to the rules.
            if rest.is_empty() || line.contains(&b'\t') {
                return None;
            }
        }
    }
    Some(count)
}

/// What follows the sign of a remark, which may be the head of the table.
fn remark(line: &str) -> Option<&str> {
    line.strip_prefix("//").or_else(|| line.strip_prefix('#')).map(|rest| rest.trim_start_matches(['#', '/']).trim())
}

/// Names of x, y and z.
const AXES: [&[&str]; 3] =
    [&["x", "e", "east", "easting"], &["y", "n", "north", "northing"], &["z", "h", "height", "elevation"]];

fn names_all_axes(row: &[&str]) -> bool {
    AXES.iter().all(|axis| row.iter().any(|word| axis.contains(&word.to_ascii_lowercase().as_str())))
}

/// Whether the words name longitude and latitude, or easting and northing: the columns of another kind of table.
fn names_places(row: &[&str]) -> bool {
    let starts = |start: &str| row.iter().any(|word| word.to_ascii_lowercase().starts_with(start));
    (starts("lon") && starts("lat")) || (starts("east") && starts("north"))
}

/// Reads the next line into `bytes`; `false` at the end of the file.
fn read_line(path: &Path, file: &mut BufReader<File>, line: &mut u64, bytes: &mut Vec<u8>) -> Result<bool> {
    bytes.clear();
    let read = file.take(MOST_LINE_BYTES).read_until(b'\n', bytes).map_err(|e| Error::io(path, "read", e))?;
    *line += u64::from(read > 0);
    if read as u64 == MOST_LINE_BYTES || bytes.contains(&0) {
        let what = "this is neither LAS, LAZ, PLY, E57 nor a table of text";
        return Err(Error::format(path, format!("line {line}"), what));
    }
    Ok(read > 0)
}

/// The content of a line; what is no UTF-8 is replaced.
fn text_of(bytes: &mut Vec<u8>) -> &str {
    if let Cow::Owned(text) = String::from_utf8_lossy(bytes) {
        *bytes = text.into_bytes();
    }
    content(bytes)
}

/// The next line with content, in `bytes`.
fn next_line<'a>(
    path: &Path,
    file: &mut BufReader<File>,
    line: &mut u64,
    bytes: &'a mut Vec<u8>,
) -> Result<Option<&'a str>> {
    loop {
        if !read_line(path, file, line, bytes)? {
            return Ok(None);
        }
        if !text_of(bytes).is_empty() {
            return Ok(Some(content(bytes)));
        }
    }
}

/// A line without what surrounds its words.
fn content(bytes: &[u8]) -> &str {
    let text = std::str::from_utf8(bytes).expect("what was no UTF-8 was replaced");
    text.trim_start_matches('\u{feff}').trim()
}

pub(super) fn open(path: &Path) -> Result<(Header, Box<dyn PointReader>)> {
    let file = File::open(path).map_err(|e| Error::io(path, "open", e))?;
    let mut file = BufReader::with_capacity(1 << 20, file);
    let (mut line, mut bytes) = (0, Vec::new());
    let (head, columns) = first_row(path, &mut file, &mut line, &mut bytes)?;
    if !(3..=MOST_COLUMNS).contains(&columns) {
        return Err(Error::format(
            path,
            format!("line {}", line + 1),
            format!("{columns} columns; x, y, z are needed"),
        ));
    }
    let names = names_of(path, head, columns, line)?;
    let axes = axes_among(path, &names)?;
    let header = Header {
        format: Format::Text,
        points: None,
        schema: schema_of(&names, axes),
        precision: Precision::Double,
        crs: None,
        shift: None,
        intensity: None,
        las: None,
        description: format!("text, {columns} columns"),
    };
    Ok((header, Box::new(TextReader { path: path.to_path_buf(), file, axes, columns, line, bytes })))
}

/// The words that stand above the numbers.
struct Head {
    names: Vec<String>,
    /// They stand in a remark, which may be a sentence.
    in_remark: bool,
}

/// Reads up to the first row of numbers, which is the next to be read then. Answers the head above it and how many
/// columns there are; of a table without rows those of the head, or three.
fn first_row(
    path: &Path,
    file: &mut BufReader<File>,
    line: &mut u64,
    bytes: &mut Vec<u8>,
) -> Result<(Option<Head>, usize)> {
    let mut head: Option<Head> = None;
    // Columns that a remark names, none of them x, y and z.
    let mut others: Vec<String> = Vec::new();
    loop {
        let before = (file.stream_position().map_err(|e| Error::io(path, "seek", e))?, *line);
        let Some(text) = next_line(path, file, line, bytes)? else {
            let columns = head.as_ref().map_or(3, |head| head.names.len());
            return Ok((head, columns));
        };
        let row = match remark(text) {
            // Other remarks say nothing of the table, but for what the columns are if not x, y and z.
            Some(rest) if head.is_some() || !names_all_axes(&words(rest)) => {
                if names_places(&words(rest)) {
                    others = words(rest).into_iter().map(str::to_string).collect();
                }
                continue;
            }
            Some(rest) => words(rest),
            None => words(text),
        };
        if row.iter().all(|word| number(word).is_some()) {
            // PTS files begin with the number of points.
            if row.len() == 1 && head.is_none() && row[0].parse::<u64>().is_ok() {
                continue;
            }
            let columns = row.len();
            if head.is_none() && others.len() == columns {
                let what = format!("no columns X, Y and Z among {}", others.join(", "));
                return Err(Error::format(path, "head", what));
            }
            file.seek(std::io::SeekFrom::Start(before.0)).map_err(|e| Error::io(path, "seek", e))?;
            *line = before.1;
            return Ok((head, columns));
        }
        if head.is_some() || row.len() < 3 || row.iter().any(|word| number(word).is_some()) {
            let what = format!("`{text}` is neither a row of numbers nor a head with the columns X, Y and Z");
            return Err(Error::format(path, format!("line {line}"), what));
        }
        // What noise is told by, under the names that tables give it.
        let named = |word: &&str| match word.to_ascii_lowercase().as_str() {
            "class" | "scalar_classification" => "classification".to_string(),
            other => other.to_string(),
        };
        head = Some(Head { names: row.iter().map(named).collect(), in_remark: remark(text).is_some() });
    }
}

/// The names of the columns: those of the head, or x, y, z and numbers. `line` is the one before the first row.
fn names_of(path: &Path, head: Option<Head>, columns: usize, line: u64) -> Result<Vec<String>> {
    // A sentence about x, y and z is no head.
    let head = head.filter(|head| !head.in_remark || head.names.len() == columns);
    let names = head.map_or_else(
        || {
            let axes = ["x", "y", "z"].map(String::from);
            axes.into_iter().chain((4..=columns).map(|number| format!("column_{number}"))).collect()
        },
        |head| head.names,
    );
    if names.len() != columns {
        let what = format!("{columns} numbers below a head of {} columns", names.len());
        return Err(Error::format(path, format!("line {}", line + 1), what));
    }
    Ok(names)
}

/// Which columns x, y and z are; no name may be there twice.
fn axes_among(path: &Path, names: &[String]) -> Result<[usize; 3]> {
    let mut axes = [0; 3];
    for (place, words) in axes.iter_mut().zip(AXES) {
        *place = names.iter().position(|name| words.contains(&name.as_str())).ok_or_else(|| {
            Error::format(path, "head", format!("no column `{}` among {}", words[0].to_uppercase(), names.join(", ")))
        })?;
    }
    if let Some(twice) = (1..names.len()).find(|&index| names[..index].contains(&names[index])) {
        return Err(Error::format(path, "head", format!("the column `{}` is there twice", names[twice])));
    }
    Ok(axes)
}

fn schema_of(names: &[String], axes: [usize; 3]) -> Schema {
    let mut schema = Schema::default();
    for (index, name) in names.iter().enumerate() {
        let axis = axes.iter().position(|&axis| axis == index);
        schema.push(axis.map_or(name.as_str(), |axis| ["x", "y", "z"][axis]), Kind::F64);
    }
    schema
}

impl PointReader for TextReader {
    fn read(&mut self, batch: &mut Batch, limit: usize) -> Result<()> {
        batch.clear();
        while batch.len() < limit && read_line(&self.path, &mut self.file, &mut self.line, &mut self.bytes)? {
            let begin = batch.raw.len();
            if plain_numbers(&self.bytes, &mut batch.raw) != Some(self.columns) {
                batch.raw.truncate(begin);
                let text = text_of(&mut self.bytes);
                if text.is_empty() || remark(text).is_some() {
                    continue;
                }
                if numbers(text, &mut batch.raw) != Some(self.columns) {
                    return Err(Error::format(&self.path, format!("line {}", self.line), mistake(text, self.columns)));
                }
            }
            batch.xyz.push(self.axes.map(|axis| Kind::F64.read(&batch.raw[begin + 8 * axis..])));
        }
        Ok(())
    }
}

/// What is wrong with a row.
fn mistake(text: &str, columns: usize) -> String {
    let row = words(text);
    match row.iter().find(|word| number(word).is_none()) {
        Some(word) if row.len() == columns => format!("`{word}` is no number"),
        _ => format!("{} values, the lines before have {columns}", row.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig { cases: 4000, ..ProptestConfig::default() })]
        /// Where the short way answers, it answers what the rules do.
        #[test]
        fn plain_rows_are_read_by_the_rules(line in "([0-9]{1,3}(\\.[0-9]{0,3})?|-1e3|;|,|\t| |\"|a|é|\u{b}|\r\n){0,12}") {
            let (mut plain, mut full) = (Vec::new(), Vec::new());
            if let Some(count) = plain_numbers(line.as_bytes(), &mut plain) {
                prop_assert_eq!(numbers(line.trim(), &mut full).or(line.trim().is_empty().then_some(0)), Some(count));
                prop_assert_eq!(plain, full);
            }
        }
    }

    /// A head in a remark that names other columns than x, y and z is no reason to take the first three.
    #[test]
    fn columns_of_another_table_are_not_taken_for_coordinates() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("lvis.txt");
        let rows = "1654935003 145 42504.0 311.2 69.4 1500.3\n1654935003 146 42504.1 311.3 69.4 1501.3\n";
        let error = |head: &str| {
            std::fs::write(&path, format!("# exported 2009\n{head}\n{rows}")).expect("a file");
            open(&path).map(|(header, _)| header.schema).err().map(|error| error.to_string())
        };
        let refused = error("# LFID SHOT TIME LONGITUDE_CENTROID LATITUDE_CENTROID ELEVATION_CENTROID");
        assert!(refused.is_some_and(|what| what.contains("LATITUDE_CENTROID")));
        assert_eq!(error("# six columns: height and latitude unknown"), None);
        assert_eq!(error("# points of a scanner that stood here"), None);
    }

    #[test]
    fn usual_rows_are_plain() {
        for line in ["1 2.5 -3e2\r\n", "1\t2.5\t -3e2 \n", "1,2.5,-3e2\n", " 1, 2.5 , -3e2"] {
            let mut raw = Vec::new();
            assert_eq!(plain_numbers(line.as_bytes(), &mut raw), Some(3), "{line}");
            assert_eq!(raw, [1.0, 2.5, -300.0_f64].map(f64::to_le_bytes).concat(), "{line}");
        }
        for line in ["1;2;3", "1,5\t2,5\t3,5", "1,2,3,", "1 2,3", "1,2 3", "\u{feff}1 2 3", "nan 1 2", "1..2", "1,,2"] {
            assert_eq!(plain_numbers(line.as_bytes(), &mut Vec::new()), None, "{line}");
        }
    }
}
