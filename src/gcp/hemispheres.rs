//! Titles that say on which side of Greenwich or the equator degrees count: `Longitude (W)`, `South Latitude`.

use super::titles::folded;

/// Whether a title of longitudes or latitudes says that its degrees count westwards or southwards.
pub(super) fn counts_backwards(title: &str) -> bool {
    const WEST_AND_SOUTH: [&str; 14] = [
        "w", "west", "western", "ouest", "oeste", "ovest", "vest", "s", "south", "southern", "sud", "sur", "syd", "sor",
    ];
    let is_between = |c: char| !c.is_alphanumeric();
    // "(E/W)" and "(+E, -W)" leave it to the sign.
    let is_forwards = |word: &str| ["e", "n", "east", "north"].contains(&word);
    let plain = folded(title).replace('ø', "o");
    let words: Vec<&str> = plain.split(is_between).collect();
    words.iter().any(|word| WEST_AND_SOUTH.contains(word)) && !words.iter().any(|word| is_forwards(word))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn west_and_south_count_backwards() {
        for title in ["Longitude (W)", "West Longitude", "Lat [S]", "Breite (Süd)", "lon_west"] {
            assert!(counts_backwards(title), "{title}");
        }
        for title in
            ["Longitude", "Longitude (E)", "Longitude (E/W)", "Longitude (+E, -W)", "Latitude (N/S)", "WGS84 Longitude"]
        {
            assert!(!counts_backwards(title), "{title}");
        }
    }
}
