//! What all text formats share: encodings, lines, columns, numbers.

/// Text of a file: UTF-8 or UTF-16 with or without a byte order mark, else Latin-1, as old survey software writes; line
/// ends of any system. `None` for files that are no text.
pub(super) fn decode(bytes: &[u8]) -> Option<String> {
    let wide = |pairs: &[u8], big: bool| -> String {
        let units = pairs.chunks_exact(2).map(|pair| {
            let pair = [pair[0], pair[1]];
            if big { u16::from_be_bytes(pair) } else { u16::from_le_bytes(pair) }
        });
        char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    let text = match bytes {
        [0xEF, 0xBB, 0xBF, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [0xFF, 0xFE, rest @ ..] => wide(rest, false),
        [0xFE, 0xFF, rest @ ..] => wide(rest, true),
        _ => {
            let start = &bytes[..bytes.len().min(4096)];
            let zeros = |parity: usize| start.iter().skip(parity).step_by(2).filter(|b| **b == 0).count();
            // Without a mark: in UTF-16 the letters of a list have a zero as their other byte.
            let half = start.len() / 2;
            match (zeros(0), zeros(1)) {
                (0, 0) => match std::str::from_utf8(bytes) {
                    Ok(text) => text.to_string(),
                    Err(_) => bytes.iter().copied().map(char::from).collect(),
                },
                (0, odd) if odd * 10 > half * 8 => wide(bytes, false),
                (even, 0) if even * 10 > half * 8 => wide(bytes, true),
                _ => return None,
            }
        }
    };
    Some(text.replace("\r\n", "\n").replace('\r', "\n"))
}

/// A line that holds something.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line<'a> {
    /// Counted from 1, blank lines and comments included.
    pub row: usize,
    pub text: &'a str,
}

impl Line<'_> {
    pub fn place(&self) -> String {
        format!("row {}", self.row)
    }

    pub fn is_comment(&self) -> bool {
        self.text.starts_with(['#', '!']) || self.text.starts_with("//")
    }
}

/// The lines that are not blank, trimmed.
pub(super) fn lines(text: &str) -> Vec<Line<'_>> {
    text.lines()
        .enumerate()
        .map(|(i, line)| Line { row: i + 1, text: line.trim() })
        // Excel pads empty rows with separators.
        .filter(|line| !line.text.trim_matches([';', ',', '\t', ' ', '"']).is_empty())
        .collect()
}

/// What stands between two columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Separator {
    Letter(char),
    Blanks,
}

pub(super) const SEPARATORS: [Separator; 4] =
    [Separator::Letter(';'), Separator::Letter('\t'), Separator::Letter(','), Separator::Blanks];

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

/// An angle: decimal degrees, or degrees, minutes and seconds with signs or letters of direction.
pub(super) fn angle(text: &str) -> Option<f64> {
    if let Some(value) = number(text) {
        return Some(value);
    }
    let upper = text.trim().to_uppercase();
    let negative = upper.starts_with('-') || upper.ends_with(['S', 'W']) || upper.starts_with(['S', 'W']);
    let parts: Vec<f64> = upper
        .split(|c: char| !(c.is_ascii_digit() || c == '.' || c == ','))
        .filter(|part| !part.is_empty())
        .map(|part| part.replace(',', ".").parse().ok())
        .collect::<Option<_>>()?;
    let known = |c: char| c.is_ascii_digit() || ".,+-°º˚'′’\"″” NSEWØO".contains(c);
    let marked = upper.contains(['°', 'º', '˚', '\'', '′']) || upper.ends_with(['N', 'S', 'E', 'W']);
    if !marked
        || !upper.chars().all(known)
        || parts.is_empty()
        || parts.len() > 3
        || parts[1..].iter().any(|p| *p >= 60.0)
    {
        return None;
    }
    let value = parts.iter().rev().fold(0.0, |sum, part| sum / 60.0 + part);
    Some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encodings() {
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
        for text in ["", "P1", "nan", "inf", "1-2", "12m", "86 7032516", "80,3 1"] {
            assert_eq!(number(text), None, "{text}");
        }
    }

    #[test]
    fn angles_in_degrees_minutes_and_seconds() {
        let close = |text: &str, value: f64| assert!((angle(text).expect(text) - value).abs() < 1e-12, "{text}");
        close("63.4305", 63.4305);
        close("63°25'48.36\"N", 63.4301);
        close("10° 23' 42\" W", -10.395);
        close("63 25.5 N", 63.425);
        assert_eq!(angle("63°75'N"), None);
        assert_eq!(angle("north"), None);
    }
}
