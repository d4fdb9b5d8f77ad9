//! How a line of titles is cut where its rows have fewer cells: `Point ID` cut at its blank is two titles over one
//! column, and every cell behind it would stand under another's title.

use std::path::Path;

use crate::gcp::columns::{Columns, columns};
use crate::gcp::text::{self, Line, Row, Separator, number};
use crate::gcp::titles::{NAMES, find, is_beside, is_coordinate, is_known, tidy};
use crate::gcp::units::Unit;
use autoref_raster::error::{Error, Result};

/// How sure it is that the cells stand under their own titles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    Certain,
    /// The height has no cell in any row.
    Open,
    /// A coordinate has none, or stands where no coordinate does.
    Wrong,
}

/// Columns under titles of which there are as many as cells; `None` where they are right as they are.
///
/// # Errors
/// [`Error::Format`] with both counts, where cells are sure to stand under others' titles and no cut helps.
pub(super) fn settled(
    path: &Path,
    line: &Line<'_>,
    columns_as_cut: &Columns,
    separator: Separator,
    rows: &[Row<'_>],
) -> Result<Option<Columns>> {
    let titles = &columns_as_cut.titles;
    let cells = cells(rows);
    // Where separators show every cell, those that are empty are so.
    let shows_all = |(_, row): &Row<'_>| row.len() >= titles.len();
    let is_shown = match separator {
        Separator::Blanks => false,
        Separator::Letter('\t') => rows.iter().any(shows_all),
        Separator::Letter(_) => true,
    };
    if rows.is_empty() || cells >= titles.len() || is_shown {
        return Ok(None);
    }
    let fit = fit(columns_as_cut, rows, cells);
    let parts = parts_of_titles(titles) || (separator == Separator::Blanks && has_other_words(columns_as_cut));
    if fit == Fit::Certain && !parts {
        return Ok(None);
    }
    // A height without a cell is no sign of cells that are shifted.
    let is_shifted = fit == Fit::Wrong || (parts && separator == Separator::Blanks);
    let better = others(line, titles, separator)
        .into_iter()
        .filter(|cut| is_shifted && cut.len() == cells)
        .find_map(|cut| columns(cut).filter(|other| self::fit(other, rows, cells) == Fit::Certain));
    // Behind titles between wide gaps the last cells of rows may be empty.
    let is_whole = |other: &Columns| {
        self::fit(other, rows, cells) == Fit::Certain && !parts_of_titles(&other.titles) && !has_other_words(other)
    };
    let wide = || others(line, titles, separator).into_iter().take(1).find_map(|cut| columns(cut).filter(is_whole));
    let better = better.or_else(|| wide().filter(|_| is_shifted && separator == Separator::Blanks));
    if better.is_some() {
        return Ok(better);
    }
    let is_cut = separator == Separator::Blanks;
    let is_padded = separator == Separator::Letter('\t') && titles.iter().any(String::is_empty);
    let is_unsure = fit == Fit::Open && !titles.iter().all(|title| is_word(title));
    if !((is_cut && (parts || is_unsure || fit == Fit::Wrong)) || (is_padded && fit == Fit::Wrong)) {
        return Ok(None);
    }
    let why = if is_cut { "blanks within a title" } else { "tabs between them that the rows do not have" };
    let what = format!(
        "{} titles over {cells} cells in every row, as from {why}: put semicolons between the columns, in the header too",
        titles.len()
    );
    Err(Error::format(path, line.place(), what))
}

/// Whether a line that was cut at blanks is one of titles rather than a remark in which words of directions stand: most
/// of its words are titles, and the rows have a cell for each.
pub(super) fn are_titles(line: &Line<'_>, found: &Columns, rows: &[Row<'_>]) -> bool {
    let titles = &found.titles;
    let known = titles.iter().filter(|title| is_word(title) || is_beside(title)).count();
    let (cells, is_remark) = (cells(rows), line.is_comment());
    // "Northing" is a title wherever it stands, "north" may be a word of a sentence.
    const LONGEST_DIRECTION: usize = 5;
    let is_title = |at: usize| tidy(&titles[at]).chars().count() > LONGEST_DIRECTION;
    if cells == titles.len() && known > 2 && is_title(found.easting) && is_title(found.northing) {
        return true;
    }
    if known * 2 < titles.len() || (is_remark && known * 2 == titles.len()) {
        return false;
    }
    if rows.is_empty() || known == titles.len() {
        return true;
    }
    let fits = cells == titles.len() || settled(Path::new(""), line, found, Separator::Blanks, rows).is_ok();
    (fits || !is_remark) && !contradicts(found, rows)
}

/// Six digits under the northing and seven under the easting: the titles are no titles of theirs.
fn contradicts(found: &Columns, rows: &[Row<'_>]) -> bool {
    let value = |cells: &[String], at: usize| cells.get(at).and_then(|cell| number(cell)).map_or(0.0, f64::abs);
    rows.iter().all(|(_, cells)| {
        (1e6..1e7).contains(&value(cells, found.easting)) && (1e5..1e6).contains(&value(cells, found.northing))
    })
}

/// Of the row that has most.
fn cells(rows: &[Row<'_>]) -> usize {
    let filled = |(_, cells): &Row<'_>| cells.iter().rposition(|cell| !cell.is_empty()).map_or(0, |at| at + 1);
    rows.iter().map(filled).max().unwrap_or(0)
}

fn fit(columns: &Columns, rows: &[Row<'_>], cells: usize) -> Fit {
    let places = [columns.easting, columns.northing];
    let is_missing =
        |at: usize| at >= cells || rows.iter().all(|(_, row)| columns.number(&row[at.min(row.len() - 1)]).is_none());
    if places.into_iter().any(is_missing) {
        return Fit::Wrong;
    }
    // What stands behind the first column and before the coordinates is no coordinate itself.
    const SMALLEST_COORDINATE: f64 = 10_000.0;
    let is_place = |cell: &String| {
        number(cell).is_some_and(|value| value.abs() >= SMALLEST_COORDINATE || cell.contains(['.', ',']))
    };
    let first = places[0].min(places[1]);
    let before = (1..first).filter(|&at| !is_measured(&columns.titles[at]));
    let mut shifted = before.filter(|&at| rows.iter().all(|(_, row)| row.get(at).is_some_and(is_place)));
    match columns.height {
        _ if shifted.next().is_some() => Fit::Wrong,
        Some(height) if height >= cells => Fit::Open,
        _ => Fit::Certain,
    }
}

/// Whether numbers with decimals are to be expected under a title.
fn is_measured(title: &str) -> bool {
    is_known(title) && find(&[tidy(title)], NAMES).is_none()
}

fn is_word(title: &str) -> bool {
    is_known(title) || crate::gcp::titles::is_role(&tidy(title))
}

/// Whether a word that is no title stands between the first title and the last coordinate's.
fn has_other_words(columns: &Columns) -> bool {
    let last = columns.easting.max(columns.northing);
    columns.titles[..last].iter().skip(1).any(|title| !is_word(title) && !is_beside(title))
}

/// Whether titles among these are parts of one: a bracket, or a unit.
fn parts_of_titles(titles: &[String]) -> bool {
    titles.iter().skip(1).any(|title| title.starts_with(['(', '[']) || is_unit(title))
}

/// A unit that is no letter of a coordinate.
fn is_unit(title: &str) -> bool {
    title.len() > 1 && Unit::of_word(title).is_some()
}

/// The other ways to cut a line of titles.
fn others(line: &Line<'_>, titles: &[String], separator: Separator) -> Vec<Vec<String>> {
    let filled: Vec<String> = titles.iter().filter(|title| !title.is_empty()).cloned().collect();
    let mut cuts = Vec::new();
    if separator == Separator::Blanks {
        let text = line.text.trim_start_matches(['#', '!', '/']).trim();
        cuts.push(text::at_wide_gaps(text));
    }
    cuts.push(filled.clone());
    cuts.push(joined(&filled));
    cuts
}

/// Brackets, units and second words of a title with the word before them.
fn joined(titles: &[String]) -> Vec<String> {
    let mut whole: Vec<String> = Vec::new();
    for title in titles {
        match whole.last_mut() {
            Some(before) if is_part(before, title) => *before = format!("{before} {title}"),
            _ => whole.push(title.clone()),
        }
    }
    whole
}

fn is_part(before: &str, title: &str) -> bool {
    let is_name = |title: &str| find(&[tidy(title)], NAMES).is_some();
    let both = format!("{before} {title}");
    let is_open = before.matches(['(', '[']).count() > before.matches([')', ']']).count();
    let is_place = |title: &str| is_coordinate(title) || is_measured(title);
    is_open
        || title.starts_with(['(', '['])
        || is_unit(title)
        || (is_name(before) && is_name(title))
        || is_name(&both)
        || (is_known(&both) && !(is_place(before) && is_place(title)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text::{lines, split};

    fn titles(text: &str, separator: Separator) -> Result<Option<Vec<String>>> {
        let lines = lines(text);
        let rows: Vec<Row<'_>> = lines[1..].iter().map(|line| (line, split(line.text, separator))).collect();
        let as_cut = columns(split(lines[0].text, separator)).expect("both coordinates");
        Ok(settled(Path::new("l.txt"), &lines[0], &as_cut, separator, &rows)?.map(|columns| columns.titles))
    }

    #[test]
    fn titles_with_blanks_are_whole_again() {
        let rows = "P1  500100.123  6600200.234  100.123\nP2  500200.1  6600300.2  101.1\n";
        for (header, whole) in [
            ("Point ID   Easting   Northing   Elevation", ["Point ID", "Easting", "Northing", "Elevation"]),
            ("Point ID Easting Northing Elevation", ["Point ID", "Easting", "Northing", "Elevation"]),
            ("Pt  Easting (m)  Northing (m)  Height (m)", ["Pt", "Easting (m)", "Northing (m)", "Height (m)"]),
            ("Pt Easting (US ft) Northing (US ft) H", ["Pt", "Easting (US ft)", "Northing (US ft)", "H"]),
            ("Point    Name     X    Y    Z", ["Point Name", "X", "Y", "Z"]),
            ("Punkt Nr    Rechtswert   Hochwert   Hoehe   Code", ["Punkt Nr", "Rechtswert", "Hochwert", "Hoehe"]),
            ("Pt  X Easting  Y Northing  Ortho Height", ["Pt", "X Easting", "Y Northing", "Ortho Height"]),
        ] {
            let found = titles(&format!("{header}\n{rows}"), Separator::Blanks);
            let found = found.unwrap_or_else(|e| panic!("{header}: {e}")).expect(header);
            assert_eq!(found[..4], whole, "{header}");
        }
        let tabbed = rows.replace("  ", "\t");
        for header in ["Target\tName\tX\tY\tZ", "Name\t\tX\t\tY\t\tZ"] {
            let found = titles(&format!("{header}\n{tabbed}"), Separator::Letter('\t')).expect("readable");
            assert_eq!(found.expect(header).len(), 4, "{header}");
        }
    }

    #[test]
    fn cells_that_are_empty_at_the_end_of_rows_stay_so() {
        for text in [
            "name x y z\nP1 1.5 2.5\nP2 3.5 4.5\n",
            "name x y z code\nP1 1.5 2.5 3.5\n",
            "Point ID E N H Code\nA 17 500100.1 6600200.1 10.1\n",
            "name lat lon E N H Code\nA 59.1 10.1 500100.1 6600200.1 10.1\n",
            "id code x y z remark\n1 7 500100.1 6600200.1 10.1\n",
        ] {
            assert_eq!(titles(text, Separator::Blanks).unwrap_or_else(|e| panic!("{text}: {e}")), None, "{text}");
        }
        for text in [
            "Name,,E,N,H\nP1,,500100.1,6600200.1\n",
            "Name,Point,E,N,H\nA,P1,500100.1,6600200.1\n",
            "ID,Name,E,N,H\n1,101,500100.1,6600200.1,\n",
            "Name,,E,N,H\nP1,7,500100.1,6600200.1\n",
            "Point Number,Point Name,X,Y,Z\n1,101,500100.1,6600200.1,\n",
            "ID,Name,Longitude,Latitude,Height\n1,101,10.1,59.1,\n",
        ] {
            assert_eq!(titles(text, Separator::Letter(',')).expect("readable"), None, "{text}");
        }
        for text in [
            "Name\tID\tEasting\tNorthing\tElevation\nP1\t101\t500100.1\t6600200.1\t\n",
            "Name\tID\tEasting\tNorthing\tElevation\nP1\t101\t500100.1\t6600200.1\n",
        ] {
            assert_eq!(titles(text, Separator::Letter('\t')).expect("readable"), None, "{text}");
        }
    }

    #[test]
    fn where_no_cut_helps_both_counts_are_said() {
        let text = "My new points E N H\nP1 500100.1 6600200.1 10.1\n";
        let error = titles(text, Separator::Blanks).expect_err("shifted").to_string();
        assert!(error.contains("6 titles over 4 cells") && error.contains("semicolons"), "{error}");
    }
}
