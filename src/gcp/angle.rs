//! Angles as people write them, and the letters of direction beside them.

use crate::gcp::text::number;

/// What a letter of direction says of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Letter {
    /// E, W, and the Ø of Øst.
    Longitude,
    /// N and S.
    Latitude,
    /// O is east in German (Ost), west in French (Ouest), Spanish and Italian.
    EastOrWest,
}

/// The letter before or behind an angle.
pub(super) fn letter(text: &str) -> Option<Letter> {
    let upper = text.trim().to_uppercase();
    let of = |c: char| match c {
        'N' | 'S' => Some(Letter::Latitude),
        'E' | 'W' | 'Ø' => Some(Letter::Longitude),
        'O' => Some(Letter::EastOrWest),
        _ => None,
    };
    [upper.chars().next(), upper.chars().next_back()].into_iter().flatten().find_map(of)
}

/// An angle: decimal degrees, or degrees, minutes and seconds with signs, colons, blanks or letters of direction.
pub(super) fn angle(text: &str) -> Option<f64> {
    const SIGNS: [char; 10] = ['°', 'º', '˚', '\'', '′', '’', '"', '″', '”', ':'];
    let upper = text.trim().trim_matches('"').trim().to_uppercase();
    // Degrees have no thousands: what stands after a blank are minutes.
    if !upper.contains([' ', '\'', '’', '\u{a0}'])
        && let Some(value) = number(&upper)
    {
        return Some(value);
    }
    let negative = upper.starts_with(['-', 'S', 'W']) || upper.ends_with(['S', 'W']);
    let bare =
        upper.trim_start_matches(['+', '-', 'N', 'S', 'E', 'W']).trim_end_matches(['N', 'S', 'E', 'W', 'Ø', 'O']);
    let known = |c: char| c.is_ascii_digit() || matches!(c, '.' | ',' | ' ' | '\u{a0}') || SIGNS.contains(&c);
    let letters = upper.chars().filter(|c| "NSEWØO".contains(*c)).count();
    if !bare.chars().all(known) || letters > 1 {
        return None;
    }
    let parts: Vec<&str> =
        bare.split(|c: char| !(c.is_ascii_digit() || c == '.' || c == ',')).filter(|part| !part.is_empty()).collect();
    let (last, whole) = parts.split_last()?;
    if parts.len() > 3 || whole.iter().any(|part| part.contains(['.', ','])) {
        return None;
    }
    let values: Vec<f64> =
        whole.iter().chain([last]).map(|part| part.replace(',', ".").parse().ok()).collect::<Option<_>>()?;
    if values[1..].iter().any(|part| *part >= 60.0) {
        return None;
    }
    let value = values.iter().rev().fold(0.0, |sum, part| sum / 60.0 + part);
    Some(if negative { -value } else { value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_in_degrees_minutes_and_seconds() {
        let close = |text: &str, value: f64| assert!((angle(text).expect(text) - value).abs() < 1e-12, "{text}");
        close("63.4305", 63.4305);
        close("63°25'48.36\"N", 63.4301);
        close("10° 23' 42\" W", -10.395);
        close("63 25.5 N", 63.425);
        for text in
            ["3:00:15.6", "3 00 15.6", "E 3 00 15,6", "3°00'15.6\"", "+3 00 15.6", "N3 0 15.6", "3\u{a0}00 15.6"]
        {
            close(text, 3.0 + 15.6 / 3600.0);
        }
        for text in ["W3.25", "W 3 15", "-3:15", "3.25S", "-3.25", "-3 15 00", "3,25 W", "s3°15'"] {
            close(text, -3.25);
        }
        close("E3 00.75", 3.0125);
        close("63 025.5", 63.425);
        for text in ["63°75'N", "north", "63.5°25'", "3 00 15 6", "", "E", "3-00-15", "N E 3 00", "NE3", "3 00 15.6 m"]
        {
            assert_eq!(angle(text), None, "{text}");
        }
    }

    #[test]
    fn letters_say_which_axis() {
        assert_eq!(letter("42.5 E"), Some(Letter::Longitude));
        assert_eq!(letter("n42.5"), Some(Letter::Latitude));
        assert_eq!(letter("3°15'O"), Some(Letter::EastOrWest));
        assert_eq!(letter("-3.25"), None);
    }
}
