//! Names as a format can hold them.

use std::borrow::Cow;
use std::collections::HashMap;

use super::{ListFormat, Survey};
use crate::gcp::{Gcp, text};
use autoref_raster::cells::no_formula;
use autoref_raster::words::counted;

/// Bytes of a text in the table of a Shapefile.
const SHAPEFILE_BYTES: usize = 254;

/// Whether a text of the format comes back with the letter in it.
fn holds(format: ListFormat, letter: char) -> bool {
    use ListFormat::{Csv, FlatGeobuf, GeoJson, GeoPackage, MetashapeCsv, Pix4d, Qgis, Shapefile};
    match format {
        GeoJson => true,
        // A cell may go on over lines; other line ends become the usual one.
        Csv => !matches!(letter, '\r' | '\0' | '\u{1a}'),
        // Their programs read line by line.
        MetashapeCsv | Pix4d | Qgis => !matches!(letter, '\n' | '\r' | '\0' | '\u{1a}'),
        GeoPackage | FlatGeobuf | Shapefile => letter != '\0',
        _ => !letter.is_control() && !matches!(letter, '\u{fffe}' | '\u{ffff}'),
    }
}

/// The name with a blank for each letter that the format has not.
pub(crate) fn held(format: ListFormat, name: &str) -> Cow<'_, str> {
    // OpenDroneMap's rows are cut at tabs, and a quote would open a cell.
    let is_quote = |c: char| format == ListFormat::Odm && c == '"';
    if name.chars().all(|c| holds(format, c) && !is_quote(c)) {
        return Cow::Borrowed(name);
    }
    let letter = |c: char| match c {
        _ if is_quote(c) => '\'',
        _ if !holds(format, c) => ' ',
        _ => c,
    };
    let plain: String = name.chars().map(letter).collect();
    match plain.trim() {
        "" => Cow::Borrowed("_"),
        plain => Cow::Owned(plain.to_owned()),
    }
}

/// Two names that a format with so many letters for a name cannot tell apart: the place of the second, the first, and
/// what both are.
pub(crate) fn one_of_two<'n>(
    format: ListFormat,
    letters: usize,
    names: impl Iterator<Item = &'n str>,
) -> Option<(usize, &'n str, String)> {
    let mut written = HashMap::new();
    names.enumerate().find_map(|(place, name)| {
        let cut: String = held(format, name).chars().take(letters).collect();
        written.insert(cut.clone(), name).map(|other| (place, other, cut))
    })
}

/// What of the names is lost, in plain words.
pub(super) fn lost(survey: &Survey, format: ListFormat) -> Vec<String> {
    let count = |is_lost: &dyn Fn(&Gcp) -> bool| survey.gcps().filter(|gcp| is_lost(gcp)).count();
    let mut lost = Vec::new();
    let mut say = |names: usize, what: &str| {
        if names > 0 {
            lost.push(format!("{what} {}", counted(names, "name", "names")));
        }
    };
    say(count(&|gcp| held(format, &gcp.name) != gcp.name), "letters (line ends, tabs and the like) of");
    if format == ListFormat::Shapefile {
        say(count(&|gcp| gcp.name.len() > SHAPEFILE_BYTES), "letters beyond 254 bytes of");
    }
    lost
}

/// Whether a list without titles could not tell its names from coordinates: where most names are numbers, all must be
/// running ones.
pub(super) fn look_like_coordinates(survey: &Survey) -> bool {
    let is_number = |name: &str| text::number(name).is_some() || text::number(&no_formula(name)).is_some();
    let is_running = |name: &str| name.bytes().all(|b| b.is_ascii_digit());
    let numbers = survey.gcps().filter(|gcp| is_number(&gcp.name)).count();
    numbers * 2 >= survey.points.len() && !survey.gcps().all(|gcp| is_running(&gcp.name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_keep_what_the_format_can_hold() {
        for (format, name, kept) in [
            (ListFormat::Kof, "a\nb", "a b"),
            (ListFormat::Kof, "\t\n", "_"),
            (ListFormat::Csv, "a\nb\tc", "a\nb\tc"),
            (ListFormat::Csv, "a\rb", "a b"),
            (ListFormat::Odm, "\"a\"\tb", "'a' b"),
            (ListFormat::GeoJson, "a\rb", "a\rb"),
            (ListFormat::Kml, "\u{1b}[31m名", "[31m名"),
        ] {
            assert_eq!(held(format, name), kept, "{name:?}");
        }
    }
}
