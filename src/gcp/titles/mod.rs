//! The titles of tables that surveyors write, and what they stand for.

mod directions;
mod fold;
// A word to a line would make a file of a thousand lines of it.
#[rustfmt::skip]
mod words;

pub(super) use directions::{Axis, directed};
pub(super) use fold::folded;
pub(super) use words::{
    CHECKS, EASTINGS, ENABLED, HEIGHTS, LATITUDES, LETTER_PAIRS, LONGITUDES, NAMES, NORTHINGS, ROLES, SHORT_HEIGHTS,
    SHORT_SIGMA_HEIGHTS, SIGMA_EASTS, SIGMA_HEIGHTS, SIGMA_NORTHS, SIGMAS, XS, YS,
};

use words::{COORDINATE_ENDINGS, COORDINATE_WORDS, ELLIPSOIDAL, HEIGHT_QUALIFIERS, LEVELS, NO_NAMES};

/// "Easting [m]" and "EASTING_(m)" are "easting"; underscores and hyphens are blanks, accents are left out. A direction
/// in brackets counts as the title's other half: "X (Est)" is "x/est".
pub(super) fn tidy(title: &str) -> String {
    let plain = fold::folded(title.trim_matches(['"', '\'', ' ', '\u{feff}']));
    let (head, inner) = match plain.split_once(['[', '(']) {
        Some((head, rest)) => (head, rest.split([']', ')']).next().unwrap_or_default()),
        None => (plain.as_str(), ""),
    };
    let (head, inner) = (without_share(&spaced(head)), spaced(inner));
    // "Latitude (North)" is a latitude.
    let is_angle = [LONGITUDES, LATITUDES].iter().any(|names| names.contains(&head.as_str()));
    let is_direction = inner.chars().count() > 2 || !inner.is_ascii();
    if is_direction && !is_angle && [EASTINGS, NORTHINGS].iter().any(|names| names.contains(&inner.as_str())) {
        return format!("{head}/{inner}");
    }
    head
}

/// "accuracy 95%" without the share of errors that it holds.
fn without_share(title: &str) -> String {
    if !title.contains('%') {
        return title.to_owned();
    }
    let is_share = |word: &&str| !word.trim_matches('%').bytes().all(|b| b.is_ascii_digit());
    title.split(' ').filter(is_share).collect::<Vec<_>>().join(" ")
}

/// One blank for whatever stands between words.
fn spaced(text: &str) -> String {
    text.replace(['_', '-', '.', ':', ','], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// In order of the names: "northing" before "n". A title such as "X/East" counts as both of its halves, and "E_GNSS" as
/// what stands before the system.
pub(super) fn find(titles: &[String], names: &[&str]) -> Option<usize> {
    // The halves of "Accuracy X/Y" are no coordinates.
    let is_accuracy = |title: &str| ["accuracy", "sigma", "std", "error"].iter().any(|word| title.starts_with(word));
    let whole = |title: &String, name: &str| {
        title == name || (!is_accuracy(title) && title.split('/').any(|half| half.trim() == name))
    };
    let among = |is: &dyn Fn(&String, &str) -> bool| {
        names.iter().find_map(|name| titles.iter().position(|title| is(title, name)))
    };
    // A title that is the word alone wins over one with a system, a unit or another word beside it.
    among(&whole)
        .or_else(|| among(&|title, name| without_system(title) == Some(name)))
        .or_else(|| among(&|title, name| without_unit(title) == Some(name)))
        .or_else(|| among(&|title, name| without_kind(title) == Some(name)))
}

/// The column of the heights: under one of their words, else under one with what they count from ("Höhe ü. NHN",
/// "NAVD88"), else above the ellipsoid.
pub(super) fn find_height(titles: &[String]) -> Option<usize> {
    let level = |title: &String| if is_ellipsoidal(title) { String::new() } else { title.clone() };
    let levels: Vec<String> = titles.iter().map(level).collect();
    let among = |titles: &[String], above: Above| titles.iter().position(|title| is_height(title, above));
    find(&levels, HEIGHTS)
        .or_else(|| among(&levels, Above::Sea))
        .or_else(|| find(titles, HEIGHTS))
        .or_else(|| among(titles, Above::SeaOrEllipsoid))
}

/// Whether a title is that of heights above the sea, or of no certain kind.
pub(super) fn is_level_height(title: &str) -> bool {
    !is_ellipsoidal(title) && (HEIGHTS.contains(&title) || is_height(title, Above::Sea))
}

/// Whether a title is that of heights above the ellipsoid.
pub(super) fn is_ellipsoidal_height(title: &str) -> bool {
    is_ellipsoidal(title) && (is_height(title, Above::SeaOrEllipsoid) || find(&[title.to_owned()], HEIGHTS).is_some())
}

fn is_ellipsoidal(title: &str) -> bool {
    title.split(' ').any(|word| word.starts_with("ell") || ELLIPSOIDAL.contains(&word))
}

/// What heights count from.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Above {
    Sea,
    SeaOrEllipsoid,
}

/// Whether a title has a word for heights, or for what they count from, and nothing else that would make it another
/// thing, as an antenna does.
fn is_height(title: &str, above: Above) -> bool {
    let may_be_ellipsoidal = above == Above::SeaOrEllipsoid;
    let joined = title.replace(' ', "");
    let is_level = |word: &str| LEVELS.contains(&word) || (may_be_ellipsoidal && ELLIPSOIDAL.contains(&word));
    if is_level(title) || is_level(&joined) {
        return true;
    }
    let is_number = |word: &str| word.bytes().all(|b| b.is_ascii_digit());
    let tells = |word: &str| HEIGHTS.contains(&word) || is_level(word) || (may_be_ellipsoidal && word == "ht");
    let words = || title.split([' ', '/']).filter(|word| !word.is_empty());
    words().any(tells) && words().all(|word| tells(word) || is_number(word) || HEIGHT_QUALIFIERS.contains(&word))
}

/// "sigma mm", "easting us ft" and "easting foot us" without their units.
fn without_unit(title: &str) -> Option<&str> {
    const KINDS: [&str; 6] = ["us", "survey", "int", "intl", "international", "usa"];
    let is_unit = |word: &str| {
        matches!(
            word,
            "mm" | "cm"
                | "m"
                | "km"
                | "ft"
                | "feet"
                | "foot"
                | "usft"
                | "ussft"
                | "ftus"
                | "ift"
                | "meter"
                | "metre"
                | "meters"
                | "metres"
        )
    };
    let (mut rest, mut has_unit) = (title, false);
    while let Some((head, word)) = rest.rsplit_once(' ')
        && (KINDS.contains(&word) || (!has_unit && is_unit(word)))
    {
        has_unit |= is_unit(word);
        rest = head;
    }
    has_unit.then_some(rest)
}

/// "coordenada x" and "ost koordinate" without the word for coordinate.
fn without_kind(title: &str) -> Option<&str> {
    let is_kind = |word: &str| COORDINATE_WORDS.contains(&word);
    let first = title.split_once(' ').filter(|(word, _)| is_kind(word)).map(|(_, rest)| rest);
    let last = || title.rsplit_once(' ').filter(|(_, word)| is_kind(word)).map(|(rest, _)| rest);
    let ending =
        || COORDINATE_ENDINGS.iter().find_map(|ending| title.strip_suffix(ending)).filter(|rest| !rest.is_empty());
    first.or_else(last).or_else(ending)
}

/// A title of two words less the one that names what the coordinates were measured with or in.
fn without_system(title: &str) -> Option<&str> {
    let (head, tail) = title.split_once(' ')?;
    let is_datum = |word: &str| matches!(word, "wgs84" | "etrs89" | "euref89" | "nad83" | "nad27");
    let is_way = |word: &str| matches!(word, "gnss" | "gps" | "rtk") || word.starts_with("utm");
    if is_datum(head) || head == "utm" { Some(tail) } else { (is_datum(tail) || is_way(tail)).then_some(head) }
}

/// A column whose title has a word that names points have ("local_id", "GCP_PointNr"): its values must show that it
/// does.
pub(super) fn find_likely_name(titles: &[String]) -> Option<usize> {
    titles.iter().position(|title| {
        let words: Vec<&str> = title.split(' ').collect();
        let is_of_an_image = ["image", "photo", "file", "camera"].iter().any(|word| words.contains(word));
        let ends = ["id", "nr", "name", "pointnr", "punktnr"].contains(words.last().expect("a split has a part"));
        !is_of_an_image && words.len() > 1 && (ends || words[0] == "id")
    })
}

/// Whether a column with this title, which is none of a name's, may hold names all the same: neither measures nor times
/// nor places in images.
pub(super) fn may_name(title: &str) -> bool {
    let tidied = tidy(title);
    let title = std::slice::from_ref(&tidied);
    let is_measure = [EASTINGS, NORTHINGS, XS, YS, LONGITUDES, LATITUDES, SIGMAS, SIGMA_EASTS, SIGMA_NORTHS]
        .iter()
        .any(|names| find(title, names).is_some())
        || find_height(title).is_some();
    !is_measure && !is_role(&tidied) && !tidied.split([' ', '/']).any(|word| NO_NAMES.contains(&word))
}

/// Whether a title is one of those for the horizontal coordinates.
pub(super) fn is_coordinate(title: &str) -> bool {
    let tidied = [tidy(title)];
    [EASTINGS, NORTHINGS, XS, YS, LONGITUDES, LATITUDES].iter().any(|names| find(&tidied, names).is_some())
}

/// Whether a title is a letter that stands for a coordinate beside certain others.
pub(super) fn is_letter(title: &str) -> bool {
    let tidied = tidy(title);
    LETTER_PAIRS.as_flattened().contains(&tidied.as_str()) || SHORT_HEIGHTS.contains(&tidied.as_str())
}

/// Whether a title is that of a role, by any of its words.
pub(super) fn is_role(title: &str) -> bool {
    [ROLES, CHECKS, ENABLED].iter().any(|names| names.contains(&title))
}

/// Whether a word often stands among titles without being that of a coordinate or a name: of times, images, codes.
pub(super) fn is_beside(title: &str) -> bool {
    const OTHERS: [&str; 12] = [
        "code",
        "desc",
        "description",
        "remark",
        "remarks",
        "note",
        "notes",
        "beschreibung",
        "bemerkung",
        "tema",
        "layer",
        "class",
    ];
    let tidied = tidy(title);
    let is_other = |word: &str| OTHERS.contains(&word) || NO_NAMES.contains(&word);
    title.starts_with(['(', '[']) || is_other(&tidied)
}

/// Whether a title is one of those that a table's reader knows.
pub(super) fn is_known(title: &str) -> bool {
    let tidied = [tidy(title)];
    is_coordinate(title)
        || directions::axis(title).is_some()
        || find_height(&tidied).is_some()
        || [NAMES, SIGMAS, SIGMA_EASTS, SIGMA_NORTHS, SIGMA_HEIGHTS].iter().any(|names| find(&tidied, names).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_as_titles_are_compared() {
        for names in [NAMES, EASTINGS, NORTHINGS, XS, YS, HEIGHTS, LONGITUDES, LATITUDES, SHORT_HEIGHTS, ELLIPSOIDAL] {
            let mut seen = std::collections::HashSet::new();
            for name in names {
                assert_eq!(tidy(name), *name, "written otherwise, it is never found");
                assert!(seen.insert(name), "{name} stands twice");
            }
        }
        for level in LEVELS.iter().chain(HEIGHT_QUALIFIERS) {
            assert_eq!(tidy(level), *level, "written otherwise, it is never found");
        }
        for name in EASTINGS {
            assert!(!NORTHINGS.contains(name), "{name} is both");
        }
    }

    #[test]
    fn heights_and_what_they_count_from() {
        for title in [
            "Кота",
            "Höhe ü. NHN",
            "H (NN)",
            "NN-Höhe",
            "Höhe m ü. M.",
            "RH 2000",
            "Kote DVR90",
            "Hoogte t.o.v. NAP",
            "Altitude NGF-IGN69",
            "Elevation NAVD88 (ft)",
            "Высота БС77",
            "H, м",
            "Quota s.l.m.",
            "h_ell",
            "Altitud elipsoidal",
            "正高",
        ] {
            assert!(find_height(&[tidy(title)]).is_some(), "{title}");
        }
        for title in
            ["Antenna height", "Ant. Höhe", "Height of instrument", "Geoid height", "H std", "HDOP", "Name", "m"]
        {
            assert!(find_height(&[tidy(title)]).is_none(), "{title}");
        }
        assert!(is_level_height("z") && !is_level_height("ellipsoidal height") && !is_level_height("code"));
        let both = ["Ellips. Höhe", "Höhe DHHN2016"].map(tidy);
        assert_eq!(find_height(&both), Some(1), "above the sea first");
    }

    #[test]
    fn what_tells_of_a_measurement_names_no_point() {
        for title in ["PDOP", "No. of satellites", "Quality", "Solution status", "Age of corrections", "Ant. Höhe"] {
            assert!(!may_name(title), "{title}");
        }
    }

    #[test]
    fn titles_of_many_languages() {
        for title in [
            "Puntnr",
            "Punt",
            "Nr punktu",
            "Číslo bodu",
            "Mat",
            "Punktkennung",
            "N° point",
            "Nº punto",
            "Pkt.-Nr.",
            "PtNo",
            "Nokta Adı",
            "Номер точки",
            "Όνομα",
            "点号",
            "点番号",
            "점번호",
            "Pisteen numero",
            "Pont",
            "Bod",
        ] {
            assert!(find(&[tidy(title)], NAMES).is_some(), "{title}");
        }
        for (titles, easting) in [
            ("Easting_ft;Northing_ft", 0),
            ("E (m);N (m)", 0),
            ("北坐标;东坐标", 1),
            ("北座標;東座標", 1),
            ("북;동", 1),
            ("Y (Sağa);X (Yukarı)", 0),
            ("Ost-Koordinate;Nord-Koordinate", 0),
            ("Coordenada Este;Coordenada Norte", 0),
            ("Північ;Схід", 1),
            ("Итого;Восток", 1),
            ("Východ;Sever", 0),
            ("Easting US ft;Northing US ft", 0),
        ] {
            let tidied: Vec<String> = titles.split(';').map(tidy).collect();
            assert_eq!(find(&tidied, EASTINGS), Some(easting), "{titles}: {tidied:?}");
        }
        for title in ["X座標", "X坐标", "X좌표", "Souřadnice X", "Coordonnée X", "Ｘ"] {
            assert_eq!(find(&[tidy(title)], XS), Some(0), "{title}");
        }
    }
}
