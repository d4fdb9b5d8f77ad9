//! What is said of a table beside its points: a coordinate reference system in a remark or above the titles, a row of
//! units below them.

use std::collections::BTreeMap;

use crate::gcp::columns::Columns;
use crate::gcp::text::{Line, Row};
use crate::gcp::units::Unit;
use autoref_raster::crs::Crs;

/// Definitions that are looked up, of all that a text may hold.
const MOST: usize = 8;

/// The system that the lines name, when it is one; with what is to be said of it.
///
/// # Errors
/// What to say when they name several.
pub(super) fn system<'a>(lines: impl Iterator<Item = &'a Line<'a>>) -> Result<Option<(Crs, String)>, String> {
    let mut found: BTreeMap<String, (Crs, String)> = BTreeMap::new();
    for (definition, place) in
        lines.flat_map(|line| definitions(line.text).into_iter().map(|d| (d, line.place()))).take(MOST)
    {
        // A vertical system alone, or a number of something else, is none.
        if let Ok(crs) = Crs::parse(&definition) {
            found.entry(crs.label()).or_insert((crs, place));
        }
    }
    let mut each = found.into_values();
    match (each.next(), each.next()) {
        (None, _) => Ok(None),
        (Some((crs, place)), None) => {
            let note =
                format!("{place} names {}: it is taken for the list's CRS unless --crs says another", crs.title());
            Ok(Some((crs, note)))
        }
        (Some((one, place)), Some((other, at))) => {
            Err(format!("{place} names {} and {at} {}, so neither was taken; give --crs", one.title(), other.title()))
        }
    }
}

/// The definitions in a line: codes of EPSG, or, where there is none, a datum and its UTM zone.
fn definitions(text: &str) -> Vec<String> {
    let codes = codes(text);
    if codes.is_empty() { zone(text).into_iter().collect() } else { codes }
}

/// "EPSG:25832", "EPSG 25832", "epsg = 25832+5941".
fn codes(text: &str) -> Vec<String> {
    let lower = text.to_ascii_lowercase();
    let after = |(at, word): (usize, &str)| {
        let rest = lower[at + word.len()..].trim_start_matches([' ', ':', '=', '#', '-', '\t']);
        let code: String = rest.chars().take_while(|c| c.is_ascii_digit() || *c == '+').collect();
        let code = code.trim_end_matches('+');
        let parts = || code.split('+');
        let sound = parts().count() <= 2 && parts().all(|part| (4..=6).contains(&part.len()));
        sound.then(|| format!("EPSG:{code}"))
    };
    lower.match_indices("epsg").filter_map(after).collect()
}

/// "ETRS89 / UTM zone 32N", in the words of several languages.
fn zone(text: &str) -> Option<String> {
    const DATUMS: [(&str, &str); 8] = [
        ("etrs89", "ETRS89"),
        ("euref89", "ETRS89"),
        ("wgs84", "WGS 84"),
        ("nad83", "NAD83"),
        ("nad27", "NAD27"),
        ("ed50", "ED50"),
        ("sirgas2000", "SIRGAS 2000"),
        ("gda94", "GDA94"),
    ];
    let plain: String = text.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
    let mut named = DATUMS.iter().filter(|(word, _)| plain.contains(word));
    let (_, datum) = named.next().filter(|_| named.next().is_none())?;
    let mut zones = plain.match_indices("utm").filter_map(|(at, word)| {
        let rest = &plain[at + word.len()..];
        let words = ["zone", "sone", "zon", "fuseau", "huso", "fuso", "strefa", "zona"];
        let rest = words.iter().find_map(|word| rest.strip_prefix(word)).unwrap_or(rest);
        let number: String = rest.chars().take_while(char::is_ascii_digit).collect();
        let side = rest[number.len()..].chars().next().filter(|c| matches!(c, 'n' | 's'));
        (1..=60).contains(&number.parse::<u8>().ok()?).then_some((number, side))
    });
    let (number, side) = zones.next().filter(|_| zones.next().is_none())?;
    // Europe and North America lie north of the equator.
    let side = side.or((!matches!(*datum, "WGS 84" | "SIRGAS 2000" | "GDA94")).then_some('n'))?;
    Some(format!("{datum} / UTM zone {number}{}", side.to_ascii_uppercase()))
}

/// Takes a row of units below the titles away, and writes them behind the titles that have none; says so.
pub(super) fn take_units(columns: &mut Columns, rows: &mut Vec<Row<'_>>) -> Option<String> {
    let (line, cells) = rows.first()?;
    let inner = |column: usize| cells.get(column).map(|cell| cell.trim().trim_matches(['[', ']', '(', ')']).trim());
    let is_angle =
        |word: &str| matches!(word.to_lowercase().as_str(), "°" | "deg" | "degree" | "degrees" | "grad" | "dd");
    let is_unit = |column: usize| {
        inner(column)
            .is_some_and(|word| if columns.geographic { is_angle(word) } else { Unit::of_word(word).is_some() })
    };
    if !is_unit(columns.easting) || !is_unit(columns.northing) {
        return None;
    }
    let measured = [Some(columns.easting), Some(columns.northing), columns.height, columns.sigma_height]
        .into_iter()
        .chain(columns.sigma)
        .flatten();
    let units: Vec<(usize, String)> = measured
        .filter_map(|column| Some((column, inner(column).filter(|word| Unit::of_word(word).is_some())?.to_owned())))
        .filter(|(column, _)| Unit::of_title(&columns.titles[*column]).is_none())
        .collect();
    let note = format!("{} holds the units of the columns", line.place());
    for (column, unit) in units {
        let title = columns.titles[column].trim();
        columns.titles[column] = format!("{title} ({unit})");
    }
    rows.remove(0);
    Some(note)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn definitions_in_remarks() {
        for (text, wanted) in [
            ("# EPSG:25832", vec!["EPSG:25832"]),
            ("Koordinatensystem: ETRS89 / UTM 32N (EPSG 25832)", vec!["EPSG:25832"]),
            ("EPSG: 25832+5941 and epsg=7837", vec!["EPSG:25832+5941", "EPSG:7837"]),
            ("ETRS89 / UTM zone 32N", vec!["ETRS89 / UTM zone 32N"]),
            ("Lage: EUREF89 UTM sone 33", vec!["ETRS89 / UTM zone 33N"]),
            ("WGS 84, UTM-Zone 32", vec![]),
            ("WGS 84, UTM-Zone 32 S", vec!["WGS 84 / UTM zone 32S"]),
            ("ETRS89 and WGS84, UTM 32N", vec![]),
            ("EPSG 12, points of 2024", vec![]),
        ] {
            assert_eq!(definitions(text), wanted, "{text}");
        }
    }

    #[test]
    fn two_systems_are_none() {
        let lines = |texts: [&'static str; 2]| texts.map(|text| Line { row: 1, text, is_point: false });
        let one = lines(["# EPSG:25832", "# ETRS89 / UTM zone 32N, heights EPSG:5941"]);
        let (crs, note) = system(one.iter()).expect("one").expect("named");
        assert_eq!(crs.label(), "EPSG:25832");
        assert!(note.contains("row 1 names"), "{note}");
        let two = lines(["# EPSG:25832", "# EPSG:25833"]);
        assert!(system(two.iter()).expect_err("two").contains("neither"));
    }
}
