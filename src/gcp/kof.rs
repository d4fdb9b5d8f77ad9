//! GCPs as KOF, the coordinate file of Norwegian survey software.
//!
//! A point is a record "05" with fixed columns (counted from 1): 2–3 the record type, 5–14 the point's name, 16–23 the
//! theme code, 25–36 northing, 38–48 easting, 50–57 height. Lines that do not keep to the columns are cut at blanks:
//! type or running number, name, perhaps a theme code, northing, easting, height, as in the files of the 2016 thesis
//! (its Script A.63, which then wrote north for east). Records of other types are passed over.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::number;
use autoref_raster::error::{Error, Result};

pub(super) fn parse(path: &Path, text: &str) -> Result<RawList> {
    let lines: Vec<(usize, &str)> =
        text.lines().enumerate().map(|(i, l)| (i + 1, l)).filter(|(_, l)| !l.trim().is_empty()).collect();
    let standard = lines.iter().any(|(_, line)| record_type(line) == Some("05"));
    let mut points = Vec::new();
    for (row, line) in lines {
        if line.trim_start().starts_with(['#', '!']) || (standard && record_type(line) != Some("05")) {
            continue;
        }
        // The description of the columns that many programs put in front, with or without its hyphen.
        if line.contains("XXXX") && line.contains("YYYY") {
            continue;
        }
        let gcp = fixed_columns(line).or_else(|| at_blanks(line)).ok_or_else(|| {
            Error::format(
                path,
                format!("row {row}"),
                format!("`{}` is no coordinate record: name, northing, easting and height are expected", line.trim()),
            )
        })?;
        if let Some(height) = gcp.height.filter(|height| height.abs() >= NO_HEIGHT) {
            let what = format!(
                "{height} can be no height: of `{}` the columns are others than they seem; keep to those of KOF, or put \
                 the theme code behind the height",
                line.trim()
            );
            return Err(Error::format(path, format!("row {row}"), what));
        }
        points.push(RawPoint::bare(gcp, format!("row {row}")));
    }
    Ok(RawList::new(points, CrsClaim::None))
}

/// Higher than any ground, in feet too.
const NO_HEIGHT: f64 = 100_000.0;
/// No coordinate of a map's northing or easting is smaller.
const SMALLEST_COORDINATE: f64 = 10_000.0;

/// Codes of themes have four digits, and up to seven.
const LARGEST_CODE: f64 = 10_000_000.0;

fn record_type(line: &str) -> Option<&str> {
    line.split_whitespace().next()
}

fn fixed_columns(line: &str) -> Option<Gcp> {
    let letters: Vec<char> = line.chars().collect();
    let column = |from: usize, to: usize| -> String {
        letters.iter().skip(from - 1).take(to + 1 - from).collect::<String>().trim().to_string()
    };
    // A letter between two fields means that the line does not keep to the columns.
    let gap = |at: usize| letters.get(at - 1).is_none_or(|c| c.is_whitespace());
    if column(2, 3) != "05" || ![1, 4, 15, 24, 37, 49].into_iter().all(gap) {
        return None;
    }
    let (northing, easting) = (number(&column(25, 36))?, number(&column(38, 48))?);
    let height = column(50, 57);
    let name = column(5, 14);
    if name.is_empty() {
        return None;
    }
    let height = if height.is_empty() { None } else { Some(number(&height)?) };
    Some(Gcp { height, ..Gcp::control(name, easting, northing) })
}

fn at_blanks(line: &str) -> Option<Gcp> {
    let fields: Vec<&str> = line.split_whitespace().collect();
    let (name, coordinates) = match fields.as_slice() {
        [_, name, north, east] => (name, [Some(*north), Some(*east), None]),
        // A theme code, and no height.
        [_, name, theme, north, east] if is_code(theme) && is_coordinate(north) && is_coordinate(east) => {
            (name, [Some(*north), Some(*east), None])
        }
        [_, name, north, east, height, ..]
            if is_coordinate(north) && is_coordinate(east) && north.contains(['.', ',']) =>
        {
            (name, [Some(*north), Some(*east), Some(*height)])
        }
        [_, name, north, east, height] => (name, [Some(*north), Some(*east), Some(*height)]),
        [_, name, _theme, north, east, height, ..] => (name, [Some(*north), Some(*east), Some(*height)]),
        _ => return None,
    };
    let [north, east, height] = coordinates;
    let height = match height {
        Some(text) => Some(number(text)?),
        None => None,
    };
    Some(Gcp { height, ..Gcp::control(*name, number(east?)?, number(north?)?) })
}

/// A whole number of a theme.
fn is_code(text: &str) -> bool {
    text.bytes().all(|b| b.is_ascii_digit()) && number(text).is_some_and(|code| code < LARGEST_CODE)
}

fn is_coordinate(text: &str) -> bool {
    number(text).is_some_and(|value| value.abs() >= SMALLEST_COORDINATE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Vec<Gcp> {
        parse(Path::new("a.kof"), text).expect("readable").points.into_iter().map(|p| p.gcp).collect()
    }

    #[test]
    fn columns_of_the_specification() {
        let text = " 00 Oppdrag      Dato     Ver\n 05 P 1        5001     7032516.804   570406.861  80.318\n 05 P2                  7032503.482   570413.367\n";
        let found = points(text);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].name.as_str(), found[0].easting, found[0].northing), ("P 1", 570406.861, 7032516.804));
        assert_eq!((found[0].height, found[1].height), (Some(80.318), None));
    }

    #[test]
    fn blanks_as_in_the_thesis() {
        let found = points("1 P1 7032516.8044 570406.8605 80.3184\n2 P2 7032503.4822 570413.3669 80.1282\n");
        assert_eq!((found[1].easting, found[1].northing), (570413.3669, 7032503.4822));
    }

    #[test]
    fn a_theme_code_without_a_height_is_no_northing() {
        for line in [
            "05 P1         7002      7032516.800  570406.900",
            "05 P1 7002 7032516.800 570406.900",
            "05 P1 6100000 7032516.800 570406.900",
            "05 P1 7002 7032516.800 570406.900 80.3",
            "1 P1 7032516.800 570406.900 80.3 7002",
        ] {
            let gcp = &points(line)[0];
            assert_eq!((gcp.northing, gcp.easting), (7032516.8, 570406.9), "{line}");
            assert!(gcp.height.is_none_or(|height| height == 80.3), "{line}");
        }
        let error = parse(Path::new("a.kof"), "05 P1 86 7032516.8 570406.9\n05 P2 7002.5 7032516.8 570406.9\n");
        assert!(error.err().expect("no height").to_string().contains("row 2"));
    }

    #[test]
    fn a_line_that_is_no_point_is_named() {
        let error = parse(Path::new("a.kof"), "1 P1 7032516.8 570406.8 80.3\n2 P2 north east 3\n").err().expect("bad");
        assert!(error.to_string().contains("row 2"), "{error}");
    }
}
