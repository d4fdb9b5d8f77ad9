//! Lines of a table of text, and the numbers in them.

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

use crate::error::{Error, Result};

const MOST_LINE_BYTES: usize = 1 << 16;

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
pub(super) fn number(word: &str) -> Option<f64> {
    word.parse().ok().or_else(|| word.contains(',').then(|| word.replacen(',', ".", 1).parse().ok()).flatten())
}

pub(super) fn words(line: &str) -> Vec<&str> {
    let mut words = Vec::new();
    each_word(line, |word| {
        words.push(word);
        Some(())
    });
    words
}

/// Appends the numbers of a row, the bytes of each; answers how many. `None` where a word is no number.
pub(super) fn numbers(line: &str, raw: &mut Vec<u8>) -> Option<usize> {
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
pub(super) fn plain_numbers(line: &[u8], raw: &mut Vec<u8>) -> Option<usize> {
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

/// Whether a row has decimal commas between blanks, where a comma counts as the end of a column.
pub(super) fn has_decimal_commas(line: &str) -> bool {
    let row = || line.split_whitespace();
    line.contains(',') && !line.contains([';', '\t']) && row().count() >= 3 && row().all(|word| number(word).is_some())
}

/// Whether a row would be one of numbers but for marks between thousands: `598'014.0;6'643'213.3;45.1`.
pub(super) fn has_thousands(line: &str) -> bool {
    const GAPS: [char; 7] = ['.', ',', '\'', '’', ' ', '\u{a0}', '\u{202f}'];
    let is_cut = line.contains([';', '\t']);
    let cells: Vec<&str> =
        if is_cut { line.split([';', '\t']).map(str::trim).collect() } else { line.split_ascii_whitespace().collect() };
    let digits = |cell: &str| cell.trim_start_matches(['+', '-']).replace(GAPS, "");
    let is_number = |cell: &&str| !cell.is_empty() && digits(cell).bytes().all(|byte| byte.is_ascii_digit());
    cells.len() >= 3 && cells.iter().all(is_number) && cells.iter().any(|cell| number(cell).is_none())
}

/// Whether a quoted number has a comma in it, where a comma counts as the end of a column.
pub(super) fn has_quoted_commas(line: &str) -> bool {
    !line.contains([';', '\t']) && line.split('"').skip(1).step_by(2).any(|inner| inner.contains(','))
}

/// Reads the next line into `bytes`, without its end, which is LF, CR LF or CR alone; `false` at the end of the file.
pub(super) fn read_line(path: &Path, file: &mut BufReader<File>, line: &mut u64, bytes: &mut Vec<u8>) -> Result<bool> {
    bytes.clear();
    let failed = |e| Error::io(path, "read", e);
    let mut ended = false;
    while !ended && bytes.len() < MOST_LINE_BYTES {
        let there = file.fill_buf().map_err(failed)?;
        if there.is_empty() {
            break;
        }
        let end = there.iter().position(|byte| matches!(byte, b'\n' | b'\r'));
        bytes.extend_from_slice(&there[..end.unwrap_or(there.len())]);
        ended = end.is_some();
        let returned = end.is_some_and(|end| there[end] == b'\r');
        let read = end.map_or(there.len(), |end| end + 1);
        file.consume(read);
        // The line feed behind may be the first byte of the next buffer.
        if returned && file.fill_buf().map_err(failed)?.first() == Some(&b'\n') {
            file.consume(1);
        }
    }
    let read = ended || !bytes.is_empty();
    *line += u64::from(read);
    if bytes.len() >= MOST_LINE_BYTES || bytes.contains(&0) {
        let zeros = bytes.iter().filter(|byte| **byte == 0).count();
        let is_wide =
            bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) || zeros * 5 > bytes.len() * 2;
        let what = match is_wide && bytes.len() < MOST_LINE_BYTES {
            true => "this is a table in UTF-16: save it as text in UTF-8",
            false => "this is no point cloud: neither LAS, LAZ, PLY, E57 nor a table of text",
        };
        return Err(Error::format(path, format!("line {line}"), what));
    }
    Ok(read)
}

/// The content of a line; what is no UTF-8 is replaced.
pub(super) fn text_of(bytes: &mut Vec<u8>) -> &str {
    if let Cow::Owned(text) = String::from_utf8_lossy(bytes) {
        *bytes = text.into_bytes();
    }
    content(bytes)
}

/// The next line with content, in `bytes`.
pub(super) fn next_line<'a>(
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
