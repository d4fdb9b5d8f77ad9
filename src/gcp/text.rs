//! What all text formats share: encodings, lines, columns, numbers.

use std::path::Path;

use chardetng::{EncodingDetector, Iso2022JpDetection, Utf8Detection};
use encoding_rs::{Encoding, WINDOWS_1250, WINDOWS_1252, WINDOWS_1254, WINDOWS_1257};

use crate::gcp::titles;
use autoref_raster::error::{Error, Result};
use autoref_raster::tiff::container::ByteOrder;

/// Text of a file: UTF-8 or UTF-16 with or without a byte order mark, else the encoding of a country, told by its
/// letters, as old survey software and Excel write; line ends of any system. `None` for files that are no text.
pub(crate) fn decode(bytes: &[u8]) -> Option<String> {
    let wide = |pairs: &[u8], order: ByteOrder| -> String {
        let units = pairs.chunks_exact(2).map(|pair| {
            let pair = [pair[0], pair[1]];
            match order {
                ByteOrder::Big => u16::from_be_bytes(pair),
                ByteOrder::Little => u16::from_le_bytes(pair),
            }
        });
        char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    let text = match bytes {
        [0xEF, 0xBB, 0xBF, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [0xFF, 0xFE, rest @ ..] => wide(rest, ByteOrder::Little),
        [0xFE, 0xFF, rest @ ..] => wide(rest, ByteOrder::Big),
        _ => {
            let start = &bytes[..bytes.len().min(4096)];
            let zeros = |parity: usize| start.iter().skip(parity).step_by(2).filter(|b| **b == 0).count();
            // Without a mark: in UTF-16 the letters of a list have a zero as their other byte.
            let half = start.len() / 2;
            match (zeros(0), zeros(1)) {
                (0, 0) => match std::str::from_utf8(bytes) {
                    Ok(text) => text.to_string(),
                    Err(_) => of_a_country(bytes),
                },
                (0, odd) if odd * 10 > half * 8 => wide(bytes, ByteOrder::Little),
                (even, 0) if even * 10 > half * 8 => wide(bytes, ByteOrder::Big),
                _ => return None,
            }
        }
    };
    Some(text.replace("\r\n", "\n").replace('\r', "\n"))
}

/// Titles stand in the first bytes of a file.
const HEAD_BYTES: usize = 16_384;

/// Text of one of the encodings with a byte a letter: Windows-1252 (West), 1250 (Middle Europe), 1251 and KOI8
/// (Cyrillic), …
fn of_a_country(bytes: &[u8]) -> String {
    let mut detector = EncodingDetector::new(Iso2022JpDetection::Deny);
    detector.feed(bytes, true);
    // SIMA is Japan's, and its few letters alone do not show it.
    let is_sima = bytes.starts_with(b"Z00,") || bytes.windows(5).any(|start| start == b"\nA01,");
    let guess = detector.guess(is_sima.then_some(b"jp"), Utf8Detection::Deny);
    // A letter or two in a line of titles tell little of a language: what makes titles of them tells more. The last of
    // equals is taken, the guess.
    let head = &bytes[..bytes.len().min(HEAD_BYTES)];
    let titles_in = |encoding: &'static Encoding| titles_beyond_ascii(&encoding.decode_without_bom_handling(head).0);
    let tried = [WINDOWS_1257, WINDOWS_1250, WINDOWS_1254, WINDOWS_1252, guess];
    let best = tried.into_iter().max_by_key(|encoding| titles_in(encoding)).unwrap_or(guess);
    best.decode_without_bom_handling(bytes).0.into_owned()
}

/// How many cells at the top of a list are titles that need letters beyond ASCII.
fn titles_beyond_ascii(text: &str) -> usize {
    const HEAD: usize = 40;
    let cells = text.lines().take(HEAD).flat_map(|line| line.split([';', '\t', ',', '|']));
    cells.filter(|cell| !cell.is_ascii() && titles::is_known(cell.trim())).count()
}

/// The text whose bytes in UTF-8 were taken for letters each, as of drawings that do not say their encoding; any other
/// text as it is.
pub(super) fn of_utf8_bytes(text: String) -> String {
    let bytes: Option<Vec<u8>> = text.chars().map(|letter| u8::try_from(u32::from(letter)).ok()).collect();
    bytes.filter(|bytes| !bytes.is_ascii()).and_then(|bytes| String::from_utf8(bytes).ok()).unwrap_or(text)
}

/// A line that holds something.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    /// Counted from 1, blank lines and comments included.
    pub row: usize,
    pub text: &'a str,
    /// A point whose name begins as remarks do ([`super::marked_rows`]).
    pub is_point: bool,
}

impl Line<'_> {
    /// Where it stands, for messages.
    pub fn place(&self) -> String {
        format!("row {}", self.row)
    }

    /// Whether it holds no point by the ways of lists.
    pub fn is_comment(&self) -> bool {
        // Excel is told by the last what stands between the columns.
        let tells_excel = || {
            self.text.chars().count() == 5 && self.text.get(..4).is_some_and(|word| word.eq_ignore_ascii_case("sep="))
        };
        !self.is_point && (self.text.starts_with(['#', '!']) || self.text.starts_with("//") || tells_excel())
    }
}

/// The lines that are not blank, trimmed. A quoted cell may go on over several lines, which are one then.
pub(super) fn lines(text: &str) -> Vec<Line<'_>> {
    let ends: Vec<usize> = text.match_indices('\n').map(|(at, _)| at).chain([text.len()]).collect();
    let mut found = Vec::new();
    let (mut row, mut start) = (0, 0);
    while row < ends.len() {
        let last = last_row(text, start, &ends[row..]);
        // Old systems end a text with Ctrl-Z.
        let line = text[start..ends[row + last]].trim_matches('\u{1a}').trim();
        // Excel pads empty rows with separators.
        if !line.trim_matches([';', ',', '\t', '|', ' ', '"', '\n']).is_empty() {
            found.push(Line { row: row + 1, text: line, is_point: false });
        }
        start = ends[row + last] + 1;
        row += last + 1;
    }
    found
}

/// How many rows further the record that begins at `start` ends: further than its own row when a cell's quote is closed
/// there.
fn last_row(text: &str, start: usize, ends: &[usize]) -> usize {
    const MOST_ROWS: usize = 50;
    let (mut quote, mut from) = (Quote::Closed, start);
    for (row, &end) in ends.iter().take(MOST_ROWS).enumerate() {
        if is_open_after(&text[from..end], quote) {
            quote = Quote::Open;
        } else {
            return row;
        }
        from = end + 1;
    }
    0
}

/// Whether a line begins within a quoted cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Quote {
    Closed,
    Open,
}

/// Whether a quote that began a cell is open at the end of the line.
pub(super) fn is_open_after(line: &str, before: Quote) -> bool {
    let mut open = before == Quote::Open;
    let mut begin = true;
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        match letter {
            // Two are one that is meant.
            '"' if open && letters.peek() == Some(&'"') => drop(letters.next()),
            '"' if open => open = false,
            '"' if begin => open = true,
            _ => {}
        }
        begin = matches!(letter, ',' | ';' | '\t' | '|') || (begin && letter == ' ');
    }
    open
}

/// What stands between two columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Letter(char),
    Blanks,
}

pub(super) const SEPARATORS: [Separator; 5] = [
    Separator::Letter(';'),
    Separator::Letter('\t'),
    Separator::Letter(','),
    Separator::Letter('|'),
    Separator::Blanks,
];

pub(super) fn split(line: &str, separator: Separator) -> Vec<String> {
    let Separator::Letter(letter) = separator else {
        return line.split_whitespace().map(|field| field.trim_matches('"').to_string()).collect();
    };
    let mut reader = csv::ReaderBuilder::new()
        .has_headers(false)
        .delimiter(letter as u8)
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

/// Cut at tabs and at two or more blanks.
pub(super) fn at_wide_gaps(text: &str) -> Vec<String> {
    let parts = text.split('\t').flat_map(|part| part.split("  "));
    parts.map(|part| part.trim().trim_matches('"').to_owned()).filter(|part| !part.is_empty()).collect()
}

/// A number as people write it: decimal point or comma, blanks, apostrophes, points or commas between thousands.
///
/// A single comma or point is the decimal one; of two kinds the last.
pub(super) fn number(text: &str) -> Option<f64> {
    const GAPS: [char; 5] = ['\u{a0}', '\u{202f}', '\'', '’', ' '];
    let text = text.trim().trim_matches('"').trim();
    // Gaps stand between thousands only: "86 7032516" is two numbers.
    let whole = text.find(['.', ',']).map_or(text, |at| &text[..at]);
    if text[whole.len()..].contains(GAPS) || whole.split(GAPS).skip(1).any(|group| group.len() != 3) {
        return None;
    }
    let plain = text.replace(GAPS, "");
    let commas = plain.matches(',').count();
    let points = plain.matches('.').count();
    // Between thousands a mark stands every three digits: "12..5" and "1,2,3" are slips of the hand.
    let grouped = |mark: char, whole: &str| {
        let mut groups = whole.trim_start_matches(['+', '-']).split(mark);
        let digits = |group: &str| group.bytes().all(|b| b.is_ascii_digit());
        groups.next().is_some_and(|first| (1..=3).contains(&first.len()) && digits(first))
            && groups.all(|group| group.len() == 3 && digits(group))
    };
    let sound = match (commas, points) {
        (0, 0 | 1) | (1, 0) => true,
        (0, _) => grouped('.', &plain),
        (_, 0) => grouped(',', &plain),
        _ if plain.rfind(',') > plain.rfind('.') => grouped('.', &plain[..plain.rfind(',')?]),
        _ => grouped(',', &plain[..plain.rfind('.')?]),
    };
    if !sound {
        return None;
    }
    let canonical = match (commas, points) {
        (0, _) if points > 1 => plain.replace('.', ""),
        (0, _) => plain,
        (1, 0) => plain.replace(',', "."),
        (_, 0) => plain.replace(',', ""),
        _ if plain.rfind(',') > plain.rfind('.') => plain.replace('.', "").replace(',', "."),
        _ => plain.replace(',', ""),
    };
    // `parse` takes "inf" and "nan", which are names rather than coordinates.
    let looks = canonical.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    canonical.parse().ok().filter(|value: &f64| looks && value.is_finite())
}

/// A row of a table, cut.
pub(super) type Row<'a> = (&'a Line<'a>, Vec<String>);

/// A quote that opens a cell and is not closed takes the columns behind it into the cell.
pub(super) fn refuse_open_quote(path: &Path, line: &Line<'_>) -> Result<()> {
    if !is_open_after(line.text, Quote::Closed) {
        return Ok(());
    }
    Err(Error::format(path, line.place(), "a quote (\") opens a cell and is not closed; close it, or take it away"))
}

/// A row with more cells than there are titles was cut where it should not be.
pub(super) fn refuse_more_cells(
    path: &Path,
    (line, fields): &Row<'_>,
    titles: usize,
    separator: Separator,
) -> Result<()> {
    let cells = fields.iter().rposition(|field| !field.is_empty()).map_or(0, |at| at + 1);
    if cells <= titles {
        return Ok(());
    }
    let cause = match separator {
        Separator::Letter(',') => {
            "numbers with decimal commas, or other commas in a cell: quote such cells, or put semicolons between the \
             columns"
        }
        Separator::Letter(_) => "the separator within a cell: quote such cells",
        Separator::Blanks => "blanks within a cell: put semicolons between the columns",
    };
    let what = format!("{cells} cells under {titles} titles, as from {cause}; a column of its own needs a title");
    Err(Error::format(path, line.place(), what))
}

/// Rows of a table are short: titles are compared with every word of every language.
const LONGEST_ROW_BYTES: usize = 1 << 15;

/// Refuses rows that no table of points has.
///
/// # Errors
/// [`Error::Limit`] naming the row.
pub(super) fn refuse_long_rows(path: &Path, text: &str) -> Result<()> {
    match text.lines().enumerate().find(|(_, line)| line.len() > LONGEST_ROW_BYTES) {
        None => Ok(()),
        Some((at, line)) => Err(Error::Limit {
            what: format!("{}: bytes in row {} of a table", path.display(), at + 1),
            needed: line.len() as u64,
            allowed: LONGEST_ROW_BYTES as u64,
            remedy: "give a list with a row for each point".into(),
        }),
    }
}

/// Lists are small; what is larger is another file.
pub(super) const LARGEST_LIST_BYTES: u64 = 32 << 20;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings_of_countries_are_told_by_their_letters() {
        for (encoding, text) in [
            (encoding_rs::WINDOWS_1252, "Navn;Øst;Nord;Høyde\nBrønn;1,5;2,5;3\n"),
            (encoding_rs::WINDOWS_1252, "Punkt;Rechtswert;Hochwert;Höhe\nStraße;1,5;2,5;3\n"),
            (encoding_rs::WINDOWS_1252, "Nom;Est;Nord;Altitude\nÉglise;1,5;2,5;3\nChâteau;1;2;3\n"),
            (encoding_rs::WINDOWS_1250, "Nazwa;Wschód;Północ;Wysokość\nP1;1,5;2,5;3\n"),
            (encoding_rs::WINDOWS_1250, "Číslo bodu;Souřadnice Y;Souřadnice X;Výška\n1;1,5;2,5;3\n"),
            (encoding_rs::WINDOWS_1251, "Название;Восток;Север;Высота\nР1;1,5;2,5;3\n"),
        ] {
            let (bytes, _, lossy) = encoding.encode(text);
            assert!(!lossy);
            assert_eq!(decode(&bytes).as_deref(), Some(text), "{}", encoding.name());
        }
    }

    #[test]
    fn bytes_of_utf8_become_letters_again() {
        let taken = |text: &str| text.bytes().map(char::from).collect::<String>();
        for text in ["Brønn 1", "点2", "P1", "Öst, 3"] {
            assert_eq!(of_utf8_bytes(taken(text)), text);
            assert_eq!(of_utf8_bytes(text.to_owned()), text);
        }
    }

    #[test]
    fn byte_order_marks_and_latin_letters_are_read() {
        let text = "navn;øst\nP1;1,5\n";
        let utf16 = |big: bool| -> Vec<u8> {
            text.encode_utf16().flat_map(|u| if big { u.to_be_bytes() } else { u.to_le_bytes() }).collect()
        };
        let with = |mark: &[u8], body: Vec<u8>| [mark, &body].concat();
        let latin1: Vec<u8> = text.chars().map(|c| c as u8).collect();
        for bytes in [
            text.as_bytes().to_vec(),
            with(&[0xEF, 0xBB, 0xBF], text.as_bytes().to_vec()),
            with(&[0xFF, 0xFE], utf16(false)),
            with(&[0xFE, 0xFF], utf16(true)),
            utf16(false),
            utf16(true),
            latin1,
            text.replace('\n', "\r\n").into_bytes(),
            text.replace('\n', "\r").into_bytes(),
        ] {
            assert_eq!(decode(&bytes).as_deref(), Some(text));
        }
        assert_eq!(decode(b"SQLite format 3\0\x10\0\x01\x01\0 \0\0"), None);
    }

    #[test]
    fn a_quoted_cell_goes_on_over_lines() {
        let rows = |text: &str| lines(text).iter().map(|l| (l.row, l.text.to_owned())).collect::<Vec<_>>();
        assert_eq!(rows("a,\"b\nc\"\nd\n"), [(1, "a,\"b\nc\"".to_owned()), (3, "d".to_owned())]);
        // A quote that is never closed, and one within a cell, end with their lines.
        assert_eq!(rows("\"a\nb\n"), [(1, "\"a".to_owned()), (2, "b".to_owned())]);
        assert_eq!(rows("63\u{b0}25'48\"\nb\n\u{1a}").len(), 2);
    }

    #[test]
    fn numbers_as_people_write_them() {
        for (text, value) in [
            ("7032516.80", 7032516.80),
            ("7032516,80", 7032516.80),
            ("7 032 516,80", 7032516.80),
            ("7'032'516.80", 7032516.80),
            ("7,032,516.80", 7032516.80),
            ("7.032.516,80", 7032516.80),
            ("-1e3", -1000.0),
            ("\"12,5\"", 12.5),
        ] {
            assert_eq!(number(text), Some(value), "{text}");
        }
        for text in ["", "P1", "nan", "inf", "1-2", "12m", "86 7032516", "80,3 1", "12..5", "1,2,3", "1.2.3,4"] {
            assert_eq!(number(text), None, "{text}");
        }
    }
}
