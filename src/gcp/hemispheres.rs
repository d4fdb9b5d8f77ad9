//! Titles that say on which side of Greenwich or the equator degrees count: `Longitude (W)`, `South Latitude`.

use super::angle::Letter;
use super::titles::folded;

/// Whether the title of an axis of degrees says that they count westwards or southwards.
pub(super) fn counts_backwards(title: &str, axis: Letter) -> bool {
    const WEST: [&str; 6] = ["west", "western", "ouest", "oeste", "ovest", "vest"];
    const SOUTH: [&str; 6] = ["south", "southern", "sud", "sur", "syd", "sor"];
    let (words, letter, forwards) = match axis {
        Letter::Latitude => (&SOUTH, "s", ["n", "north"]),
        _ => (&WEST, "w", ["e", "east"]),
    };
    let plain = folded(title).replace('ø', "o");
    let mut found = plain.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty());
    let is_named = found.clone().any(|word| words.contains(&word));
    // The s of "(DD MM SS.s)" counts seconds: a letter stands alone in its brackets.
    let bracket = plain.split_once(['(', '[']).and_then(|(_, rest)| rest.split_once([')', ']']));
    let is_letter = bracket.is_some_and(|(within, _)| within.trim() == letter);
    // "(E/W)" and "(+E, -W)" leave it to the sign.
    (is_named || is_letter) && !found.any(|word| forwards.contains(&word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn west_and_south_count_backwards() {
        for (title, axis) in [
            ("Longitude (W)", Letter::Longitude),
            ("West Longitude", Letter::Longitude),
            ("lon_west", Letter::Longitude),
            ("Lat [S]", Letter::Latitude),
            ("Breite (Süd)", Letter::Latitude),
        ] {
            assert!(counts_backwards(title, axis), "{title}");
        }
        for title in
            ["Longitude", "Longitude (E)", "Longitude (E/W)", "Longitude (+E, -W)", "WGS84 Longitude", "Lon (d m s)"]
        {
            assert!(!counts_backwards(title, Letter::Longitude), "{title}");
        }
        for title in [
            "Latitude (N/S)",
            "Latitude (DD MM SS.s)",
            "Latitude (DDMMSS.S)",
            "Latitude (d m s)",
            "Lat [ddmmss.ss]",
            "Latitude (W)",
        ] {
            assert!(!counts_backwards(title, Letter::Latitude), "{title}");
        }
    }
}
