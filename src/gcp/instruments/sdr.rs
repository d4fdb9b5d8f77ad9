//! Sokkia SDR33 (and SDR20): records of fixed columns, of which 08 holds a point's coordinates and 02 a station's.
//!
//! A record begins with its type (two digits) and how it came about (two letters). In 08 of SDR33 five fields of 16
//! columns follow: point, northing, easting, height, description; in SDR20 the point has 4 and each number 10. In 02
//! the height of the instrument stands before the description. A station that is a point too is one. The
//! head, 00, ends in a row of digits: the second is the unit of lengths (1 metres), the fifth the order of coordinates
//! (1 northing, 2 easting first).

use std::path::Path;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint};
use crate::gcp::text;
use autoref_raster::error::{Error, Result};

/// Columns of a record's type and origin, of a point's name, of each number.
#[derive(Clone, Copy, Debug)]
struct Widths {
    name: usize,
    number: usize,
}

const SDR33: Widths = Widths { name: 16, number: 16 };
const SDR20: Widths = Widths { name: 4, number: 10 };
const HEAD: usize = 4;

/// The coordinate that comes first.
#[derive(Clone, Copy, Debug)]
enum First {
    Northing,
    Easting,
}

/// What the head says of coordinates.
struct Settings {
    first: First,
}

impl Settings {
    fn read(path: &Path, content: &str) -> Result<Settings> {
        const FEWEST_DIGITS: usize = 5;
        let head = content.lines().find(|line| line.starts_with("00NM")).unwrap_or_default();
        let is_settings = |word: &&str| word.len() >= FEWEST_DIGITS && word.bytes().all(|byte| byte.is_ascii_digit());
        let digits = head.split_whitespace().next_back().filter(is_settings).unwrap_or("11111").as_bytes();
        if digits[1] != b'1' {
            let what =
                "the head says that lengths are not in metres, and which foot is meant nowhere; export in metres";
            return Err(Error::format(path, "the head", what));
        }
        Ok(Settings { first: if digits[4] == b'2' { First::Easting } else { First::Northing } })
    }
}

pub(super) fn parse(path: &Path, content: &str) -> Result<RawList> {
    let head = Settings::read(path, content)?;
    let widths = if content.trim_start().starts_with("00NMSDR2") { SDR20 } else { SDR33 };
    let (mut points, mut stations) = (Vec::new(), Vec::new());
    let holds_a_place = |line: &str| line.starts_with("08") || line.starts_with("02");
    for (at, line) in content.lines().enumerate().filter(|(_, line)| holds_a_place(line)) {
        let place = format!("row {}", at + 1);
        let letters: Vec<char> = line.chars().collect();
        let field = |from: usize, width: usize| -> String {
            letters.iter().skip(from).take(width).collect::<String>().trim().to_owned()
        };
        let coordinate = |index: usize| field(HEAD + widths.name + index * widths.number, widths.number);
        let number = |index: usize, what: &str| {
            let text = coordinate(index);
            text::number(&text).ok_or_else(|| no_number(path, &place, &text, what))
        };
        let is_station = line.starts_with("02");
        if is_station && (coordinate(0).is_empty() || coordinate(1).is_empty()) {
            continue; // not placed yet
        }
        let name = field(HEAD, widths.name);
        if name.is_empty() {
            return Err(Error::format(path, place, "the point has no name; correct or remove the record"));
        }
        let (northing, easting) = match head.first {
            First::Northing => (number(0, "northing")?, number(1, "easting")?),
            First::Easting => (number(1, "northing")?, number(0, "easting")?),
        };
        let height = if coordinate(2).is_empty() { None } else { Some(number(2, "height")?) };
        let point = RawPoint::bare(Gcp { height, ..Gcp::control(name, easting, northing) }, place);
        if is_station { stations.push(point) } else { points.push(point) }
    }
    if points.is_empty() {
        return Err(Error::format(
            path,
            "the file",
            "this Sokkia SDR holds no coordinates (records 08), only measurements; export coordinates from the \
             instrument",
        ));
    }
    super::add_stations(&mut points, stations);
    let mut list = RawList::new(points, CrsClaim::None);
    // An instrument can be set to write the easting first.
    list.order = ColumnOrder::Ruled;
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn records_of_coordinates() {
        let record = |name: &str| {
            format!("08KI{name:>16}{:>16}{:>16}{:>16}{:<16}\n", "7031894.724", "569834.260", "47.211", "GCP")
        };
        let list = parse(Path::new("a.sdr"), &format!("00NMSDR33\n{}09F1 1\n", record("P 1"))).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing), ("P 1", 569_834.26, 7_031_894.724));
        assert_eq!((gcp.height, list.points.len()), (Some(47.211), 1));
        let head = "00NMSDR33 V04-04.02     01-Jan-26 12:00 11";
        let list = parse(Path::new("a.sdr"), &format!("{head}1121\n{}", record("P 1"))).expect("readable");
        assert_eq!(list.points[0].gcp.easting, 7_031_894.724, "easting first");
        let error = parse(Path::new("a.sdr"), &format!("00NMSDR33 121111\n{}", record("P 1"))).err().expect("feet");
        assert!(error.to_string().contains("export in metres"), "{error}");
        let short = format!("00NMSDR20\n08TP{:>4}{:>10}{:>10}{:>10}\n", 12, 894.724, 834.26, "");
        let list = parse(Path::new("a.sdr"), &short).expect("readable");
        assert_eq!((list.points[0].gcp.name.as_str(), list.points[0].gcp.height), ("12", None));
        let error = parse(Path::new("a.sdr"), "00NMSDR33\n09F1 1\n").err().expect("polar").to_string();
        assert!(error.contains("records 08"), "{error}");
        let station = record("S 1").replacen("08KI", "02TP", 1).replace("GCP", "1.55");
        let same = record("P 1").replacen("08KI", "02TP", 1);
        let text = format!("00NMSDR33\n{same}{station}{}02TP{:>16}\n", record("P 1"), "S 2");
        let list = parse(Path::new("a.sdr"), &text).expect("a point that is a station, and a station");
        assert_eq!(list.points.iter().map(|p| p.gcp.name.as_str()).collect::<Vec<_>>(), ["P 1", "S 1"]);
        let error = parse(Path::new("a.sdr"), "00NMSDR33\n08KI  P1 7031894.724 569834.260\n").err().expect("blanks");
        assert!(error.to_string().contains("row 2"), "{error}");
    }
}
