//! Leica GSI: a block a line, of words of 8 or (after a `*`) 16 digits.
//!
//! After the chapter "Data format" of the TPS1100's user manual: a word is its index (two digits), four signs of which
//! the last is the unit, the sign and the data, and a blank stands behind it; names may hold blanks of their own. Words
//! 11 (point), 81, 82 and 83 (easting, northing, height of the target) make a point, 84 to 86 (of the station) where
//! the block measures no target: else they are those of the station from which the target was seen. Data have no
//! decimal point, and the unit says where it stands; programs that write one mean what they write.

use std::path::Path;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::Line;
use crate::gcp::units::{TitledUnits, Unit};
use autoref_raster::error::{Error, Result};

/// Words of what was measured to a target: directions, distances, difference of heights.
const MEASURED: std::ops::RangeInclusive<u8> = 21..=33;

/// Whether a line begins as a block does: a word for a point (11) or a code (41).
pub(super) fn is_block(line: &str) -> bool {
    let is_data = |b: u8| b.is_ascii_alphanumeric() || b"._-+#/?".contains(&b);
    let sound = |word: &str| {
        word.as_bytes()[2..6].iter().all(|b| b.is_ascii_digit() || *b == b'.')
            && matches!(word.len(), 15 | 23)
            // A name with blanks shows by the word behind it.
            && (word.bytes().skip(7).all(is_data) || words(line).len() > 1)
    };
    let first = fixed(line.strip_prefix('*').unwrap_or(line), width(line)).map(|(word, _)| word);
    first.is_some_and(|first| matches!(Word::of(first), Some(word) if matches!(word.index, 11 | 41)) && sound(first))
}

/// Signs of a word.
fn width(line: &str) -> usize {
    if line.starts_with('*') { 23 } else { 15 }
}

/// The word of this width at the beginning, and what stands behind its blank.
fn fixed(text: &str, width: usize) -> Option<(&str, &str)> {
    let (word, rest) = text.split_at_checked(width)?;
    (rest.is_empty() || rest.starts_with(' ')).then(|| (word, rest.trim_start()))
}

/// The words of a block, by their width where it holds, since names may have blanks; else by the blanks.
fn words(line: &str) -> Vec<Word<'_>> {
    let (mut rest, width) = (line.strip_prefix('*').unwrap_or(line), width(line));
    let mut found = Vec::new();
    while !rest.is_empty() {
        let fits = fixed(rest, width).and_then(|(word, rest)| Some((Word::of(word)?, rest)));
        let (word, behind) = match fits {
            Some((word, behind)) => (Some(word), behind),
            None => {
                let (word, behind) = rest.split_once(char::is_whitespace).unwrap_or((rest, ""));
                (Word::of(word), behind.trim_start())
            }
        };
        found.extend(word);
        rest = behind;
    }
    found
}

#[derive(Clone, Copy, Debug)]
struct Word<'a> {
    index: u8,
    unit: char,
    sign: f64,
    data: &'a str,
}

impl<'a> Word<'a> {
    fn of(text: &'a str) -> Option<Word<'a>> {
        let (head, data) = (text.get(..7)?, text.get(7..)?);
        let sign = match head.as_bytes()[6] {
            b'+' => 1.0,
            b'-' => -1.0,
            _ => return None,
        };
        Some(Word { index: head.get(..2)?.parse().ok()?, unit: head.chars().nth(5)?, sign, data })
    }

    /// The length, and the unit that it counts in.
    fn length(&self) -> Option<(f64, Unit)> {
        let (digits, unit) = match self.unit {
            '0' => (3, "m"),
            '1' => (3, "ft"),
            '6' => (4, "m"),
            '7' => (4, "ft"),
            '8' => (5, "m"),
            _ => return None,
        };
        let data = self.data.trim();
        let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit());
        if let Some((whole, decimals)) = data.split_once('.') {
            let value = self.sign * data.parse::<f64>().ok()?;
            return Some((value, Unit::of_word(unit)?)).filter(|_| is_digits(whole) && is_digits(decimals));
        }
        // Divided as text, so that 569834260 is 569834.26 to the last digit.
        let (whole, rest) = data.split_at_checked(data.len().checked_sub(digits)?)?;
        let value: f64 = format!("{whole}.{rest}").parse().ok()?;
        Some((self.sign * value, Unit::of_word(unit)?)).filter(|_| is_digits(data))
    }
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let (mut points, mut others) = (Vec::new(), 0_usize);
    let mut units: Option<Unit> = None;
    for line in lines {
        let place = line.place();
        let words = words(line.text);
        let find = |index: u8| words.iter().find(|word| word.index == index);
        let measures = words.iter().any(|word| MEASURED.contains(&word.index));
        let [east, north, up] = if find(81).is_some() || measures { [81, 82, 83] } else { [84, 85, 86] };
        let (Some(name), Some(easting), Some(northing)) = (find(11), find(east), find(north)) else {
            others += 1;
            continue;
        };
        let mut length = |word: &Word<'_>, what: &str| {
            let (value, unit) = word.length().ok_or_else(|| no_number(path, &place, word.data, what))?;
            if *units.get_or_insert(unit) != unit {
                return Err(Error::format(
                    path,
                    &place,
                    "its lengths count in another unit than those before; export it in one",
                ));
            }
            Ok(value)
        };
        let (easting, northing) = (length(easting, "easting")?, length(northing, "northing")?);
        let height = find(up).map(|word| length(word, "height")).transpose()?;
        let name = match name.data.trim().trim_start_matches('0').trim_start() {
            "" if name.data.trim().is_empty() => {
                let what = "the point has no name, or its word (11) is not as wide as the others; correct the block";
                return Err(Error::format(path, place, what));
            }
            "" => "0",
            name => name,
        };
        points.push(RawPoint::bare(Gcp { height, ..Gcp::control(name, easting, northing) }, place));
    }
    if points.is_empty() {
        return Err(Error::format(
            path,
            "the file",
            "this Leica GSI holds no coordinates (words 81, 82), only measurements or codes; export coordinates of \
             targets from the instrument",
        ));
    }
    let mut list = RawList::new(points, CrsClaim::None);
    list.units = units.map_or_else(TitledUnits::default, |unit| TitledUnits::all(unit, "the words 81 to 83"));
    if others > 0 {
        list.notes.push(format!("{}: {others} blocks hold no coordinates and were passed over", path.display()));
    }
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text;

    fn read(content: &str) -> Result<RawList> {
        parse(Path::new("a.gsi"), &text::lines(content))
    }

    #[test]
    fn words_of_8_and_16_digits() {
        let wide = "*110001+0000000000000A01 81..10+0000000569834260 82..10+0000007031894724 83..10-0000000000047211\n";
        let list = read(wide).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing), ("A01", 569_834.26, 7_031_894.724));
        assert_eq!(gcp.height, Some(-47.211));
        let narrow = "410001+00000001 42....+00000000\n110002+00000102 81..16+01234567 82..16+00500000\n";
        let list = read(narrow).expect("tenths of a millimetre");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing, gcp.height), ("102", 123.4567, 50.0, None));
        assert!(list.notes[0].contains("1 blocks"), "{:?}", list.notes);
    }

    /// As this test writes it, of a width and with what fills names up.
    fn word(head: &str, data: &str, width: usize, fill: char) -> String {
        let filled: String = std::iter::repeat_n(fill, width - data.len()).collect();
        format!("{head}+{filled}{data}")
    }

    #[test]
    fn names_hold_blanks_and_values_a_point() {
        for (name, fill) in [("P 101", '0'), ("P 101", ' '), ("A1 NORD 3", ' '), ("7 81", '0')] {
            let block = [
                word("110001", name, 16, fill),
                word("81..00", "569834.260", 16, '0'),
                word("82..00", "7031894724", 16, '0'),
            ];
            let list = read(&format!("*{}\n", block.join(" "))).expect("readable");
            let gcp = &list.points[0].gcp;
            assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing), (name, 569_834.26, 7_031_894.724));
        }
        let rest = "81..00+0000000000569834 82..00+0000000000569834";
        let error = read(&format!("*{} {rest}\n", word("110001", "P1", 17, ' '))).err().expect("no name").to_string();
        assert!(error.contains("row 1: the point has no name"), "{error}");
        let slip = format!("{} {} 82..00+00000001\n", word("110001", "1", 8, '0'), word("81..00", "56.98.3", 8, '0'));
        assert!(read(&slip).err().expect("two points").to_string().contains("easting"));
    }

    #[test]
    fn a_measurement_is_not_the_station_it_was_made_from() {
        let station = "84..10+00834000 85..10+00894000 86..10+00047000";
        let content = format!(
            "110001+0000STN1 {station}\n110002+00000101 21.102+19723700 31..00+00045179 {station}\n\
             110003+00000102 21.102+19723700 81..10+00834260 82..10+00894724 {station}\n"
        );
        let list = read(&content).expect("readable");
        let places: Vec<_> = list.points.iter().map(|p| (p.gcp.name.as_str(), p.gcp.easting)).collect();
        assert_eq!(places, [("STN1", 834.0), ("102", 834.26)]);
        assert!(list.notes[0].contains("1 blocks hold no coordinates"), "{:?}", list.notes);
    }

    #[test]
    fn blocks_are_told_from_tables() {
        assert!(
            is_block("110001+00000101 81..10+00834260") && is_block("*110001+0000000000000101 81..10+0000000569834260")
        );
        assert!(is_block("*110001+           P 101 81..10+0000000569834260"), "a name with blanks");
        let table = "110001+ 70406.1 7032516.2 5";
        for line in ["110001 570406 7032516", "110001+5 3", "P1,1,2", "", "*", "11+", "410001;1;2", table] {
            assert!(!is_block(line), "{line}");
        }
    }

    #[test]
    fn what_is_no_point_is_said() {
        let error = read("110001+00000101 21.102+19723700 22.102+10000000\n").err().expect("polar").to_string();
        assert!(error.contains("this Leica GSI holds no coordinates"), "{error}");
        let error = read("110001+00000101 81..10+0083426A 82..10+00894724\n").err().expect("a letter").to_string();
        assert!(error.contains("row 1") && error.contains("easting"), "{error}");
        let mixed = "110001+00000101 81..10+00834260 82..11+00894724\n";
        assert!(read(mixed).err().expect("two units").to_string().contains("another unit"));
    }
}
