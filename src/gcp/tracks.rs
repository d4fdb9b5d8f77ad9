//! Files with a place for every moment of a receiver: read as lists they would give thousands of points of one mark.

use std::path::Path;

use crate::gcp::text::{Line, number};
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// What to do with one.
const REMEDY: &str = "take the mean of the places on each mark, with its name, or export the points from the field \
                      program";

/// Refuses RTKLIB's solutions (`.pos`, with and without their head) and the messages of receivers (NMEA).
///
/// # Errors
/// [`Error::Format`] with the remedy.
pub(super) fn refuse(path: &Path, lines: &[Line<'_>]) -> Result<()> {
    const HEAD: usize = 40;
    let told = |line: &&Line<'_>, what: String| {
        Err(Error::format(path, line.place(), format!("{what}, and no list of points: {REMEDY}")))
    };
    if let Some(line) = lines.iter().take(HEAD).find(|line| is_head_of_solution(line.text)) {
        let rows = lines.iter().filter(|line| !line.text.starts_with('%') && !line.is_comment()).count();
        return told(
            &line,
            format!("this is RTKLIB's solution, {} of a receiver by the time", counted(rows, "place", "places")),
        );
    }
    let mut rows = lines.iter().filter(|line| !line.is_comment() && !line.text.starts_with('%'));
    let firsts: Vec<&Line<'_>> = rows.by_ref().take(3).collect();
    match firsts.first() {
        Some(first) if firsts.iter().all(|line| is_epoch(line.text)) => {
            let count = firsts.len() + rows.count();
            told(
                first,
                format!("this is RTKLIB's solution, {} of a receiver by the time", counted(count, "place", "places")),
            )
        }
        Some(first) if firsts.iter().all(|line| is_message(line.text)) => {
            told(first, "these are the messages of a receiver (NMEA)".to_owned())
        }
        _ => Ok(()),
    }
}

/// `%  GPST  latitude(deg) longitude(deg) …`, or the same from the centre of the Earth or from a base.
fn is_head_of_solution(line: &str) -> bool {
    const FIRST: [&str; 4] = ["latitude(deg", "latitude(d'\"", "x-ecef(m)", "e-baseline(m)"];
    line.starts_with('%') && FIRST.iter().any(|title| line.contains(title))
}

/// `2019/05/01 08:00:00.000 59.9139 10.7522 …`, or the week and its seconds, with eleven columns behind the place.
fn is_epoch(line: &str) -> bool {
    const COLUMNS: usize = 15;
    let cells: Vec<&str> = line.split([' ', '\t', ',', ';']).filter(|cell| !cell.is_empty()).collect();
    let all_numbers = |cells: &[&str]| cells.iter().all(|cell| number(cell).is_some());
    let parts = |cell: &str, mark: char| {
        let parts: Vec<&str> = cell.split(mark).collect();
        parts.len() == 3 && parts.iter().all(|part| number(part).is_some())
    };
    let is_week = |cell: &str| cell.len() == 4 && number(cell).is_some();
    // The seconds of a week, then latitude and longitude.
    let values = || cells.iter().filter_map(|cell| number(cell)).collect::<Vec<f64>>();
    let moves = |v: &[f64]| v[1] < 604_800.0 && v[2].abs() <= 90.0 && v[3].abs() <= 360.0;
    let by_date = cells.len() >= 5 && parts(cells[0], '/') && parts(cells[1], ':') && all_numbers(&cells[2..]);
    let by_week = cells.len() == COLUMNS && is_week(cells[0]) && all_numbers(&cells) && moves(&values());
    by_date || by_week
}

/// `$GPGGA,…*5F`
fn is_message(line: &str) -> bool {
    let word = line.split(',').next().unwrap_or_default();
    let is_word = word.len() == 6 && word.starts_with("$G") && word.bytes().skip(1).all(|b| b.is_ascii_uppercase());
    is_word && line.matches(',').count() > 4
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text::lines;

    fn refused(text: &str) -> Option<String> {
        refuse(Path::new("a.pos"), &lines(text)).err().map(|error| error.to_string())
    }

    const ROWS: &str = "2019/05/01 08:00:00.000 59.9139 10.7522 45.2 1 10 0.01 0.01 0.02 0 0 0 0.00 10.0\n\
                        2019/05/01 08:00:01.000 59.9139 10.7523 45.2 1 10 0.01 0.01 0.02 0 0 0 0.00 10.0\n";

    #[test]
    fn a_place_for_every_moment_is_no_list() {
        for head in ["latitude(deg) longitude(deg)  height(m)", "x-ecef(m) y-ecef(m) z-ecef(m)"] {
            let said = refused(&format!("% program   : RTKLIB ver.2.4.3\n%  GPST  {head}   Q  ns\n{ROWS}"));
            assert!(said.is_some_and(|s| s.contains("row 2") && s.contains("2 places") && s.contains("mean")));
        }
        let weeks = ROWS.replace("2019/05/01 08:00:0", "2051 28800");
        let messages = "$GPGGA,080000.00,5954.834,N,01045.132,E,4,10,1.0,45.2,M,40.0,M,1.0,0000*5F\n".repeat(2);
        for (text, word) in [(ROWS.to_owned(), "RTKLIB"), (weeks, "RTKLIB"), (messages, "NMEA")] {
            assert!(refused(&text).is_some_and(|s| s.contains("row 1") && s.contains(word)), "{text}");
        }
    }

    #[test]
    fn lists_with_dates_and_many_columns_are_lists() {
        for text in [
            "P1 597966.2 6643165.9 45.2 2019/05/01 08:00:00\n",
            "name,lat,lon,time\nA,59.9139,10.7522,2019/05/01 08:00:00\n",
            "2051 597966.2 6643165.9 45.2 1 2 3 4 5 6 7 8 9 10 11\n",
            "$GPS01,597966.2,6643165.9,45.2\n",
        ] {
            assert_eq!(refused(text), None);
        }
    }
}
