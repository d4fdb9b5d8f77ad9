//! Titles with a letter and a direction ("Y (E)", "Rechtswert Y", "X北座標"), or with what the coordinates count in
//! ("E LV95", "Map N"), which are no title of a list of words.

use super::fold::folded;
use super::words::{COORDINATE_WORDS, EASTINGS, NORTHINGS};
use crate::gcp::units::Unit;

/// What a title says of a coordinate of the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::gcp) enum Axis {
    East,
    North,
    /// Letters that are north and east in some countries.
    X,
    Y,
}

/// Words of systems, and of how coordinates came about, beside which a letter stays what it is.
const SYSTEMS: [&str; 37] = [
    "utm",
    "zone",
    "etrs89",
    "euref89",
    "wgs84",
    "nad83",
    "nad27",
    "gda94",
    "gda2020",
    "mga",
    "mga94",
    "mga2020",
    "lv95",
    "lv03",
    "ch1903",
    "rgf93",
    "l93",
    "lambert",
    "lambert93",
    "osgb36",
    "os",
    "bng",
    "itm",
    "rd",
    "gk",
    "mgi",
    "sweref99",
    "tm35fin",
    "sjtsk",
    "pl2000",
    "ed50",
    "local",
    "map",
    "grid",
    "plane",
    "projected",
    "measured",
];
/// Words that say that it is a number.
const KINDS: [&str; 4] = ["wert", "value", "deger", "position"];

/// The axis, when the title holds one and nothing that is not known.
pub(in crate::gcp) fn axis(title: &str) -> Option<Axis> {
    // A part of a WKT is no title.
    let is_cut = |open: char, close: char| title.matches(open).count() != title.matches(close).count();
    if is_cut('[', ']') || is_cut('(', ')') {
        return None;
    }
    let plain = folded(title).replace(['(', ')', '[', ']', '_', '-', '.', ':', ',', '/', '"', '\''], " ");
    let (mut letter, mut direction) = (None, None);
    for word in plain.split_whitespace().flat_map(halves) {
        let found = match word {
            "x" | "х" => (&mut letter, Axis::X),
            "y" | "у" => (&mut letter, Axis::Y),
            _ if EASTINGS.contains(&word) => (&mut direction, Axis::East),
            _ if NORTHINGS.contains(&word) => (&mut direction, Axis::North),
            _ if is_beside(word) => continue,
            _ => return None,
        };
        // Two of a kind contradict each other, or are a title of both.
        if found.0.replace(found.1).is_some_and(|before| before != found.1) {
            return None;
        }
    }
    direction.or(letter)
}

/// A letter that stands before a word of another script without a blank: "x北座標".
fn halves(word: &str) -> impl Iterator<Item = &str> {
    let cut = match word.chars().nth(1) {
        Some(second) if word.starts_with(['x', 'y']) && !second.is_ascii() => 1,
        _ => 0,
    };
    let (letter, rest) = word.split_at(cut);
    [letter, rest].into_iter().filter(|part| !part.is_empty())
}

fn is_beside(word: &str) -> bool {
    let system = word.trim_end_matches(|c: char| c.is_ascii_digit());
    let is_zone = matches!(system, "utm" | "gk" | "cc" | "") && word.len() <= 5;
    is_zone
        || SYSTEMS.contains(&word)
        || KINDS.contains(&word)
        || COORDINATE_WORDS.contains(&word)
        || Unit::of_word(word).is_some()
}

/// The only two columns whose titles say an easting and a northing, or only X and Y; the easting, or X, first.
pub(in crate::gcp) fn directed(titles: &[String]) -> Option<((usize, usize), [Axis; 2])> {
    let axes: Vec<Option<Axis>> = titles.iter().map(|title| axis(title)).collect();
    let only = |wanted: Axis| {
        let mut at = axes.iter().enumerate().filter(|(_, axis)| **axis == Some(wanted)).map(|(at, _)| at);
        at.next().filter(|_| at.next().is_none())
    };
    [[Axis::East, Axis::North], [Axis::X, Axis::Y]]
        .into_iter()
        .find_map(|pair| Some((only(pair[0]).zip(only(pair[1]))?, pair)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_with_directions_and_systems() {
        for (title, wanted) in [
            ("Y (E)", Some(Axis::East)),
            ("X [N]", Some(Axis::North)),
            ("Rechtswert Y", Some(Axis::East)),
            ("X-Hochwert", Some(Axis::North)),
            ("Y东坐标", Some(Axis::East)),
            ("X(m) 北", Some(Axis::North)),
            ("Восток Y", Some(Axis::East)),
            ("EUREF89 UTM32 Øst", Some(Axis::East)),
            ("N-LV95", Some(Axis::North)),
            ("X_L93", Some(Axis::X)),
            ("Y (CC49)", Some(Axis::Y)),
            ("X error", None),
            ("Base easting", None),
            ("N/E", None),
            ("EAST]", None),
            ("UTM zone", None),
            ("Easting RMS", None),
            ("", None),
        ] {
            assert_eq!(axis(title), wanted, "{title}");
        }
    }
}
