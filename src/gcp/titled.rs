//! Tables with a header: the columns stand in any order, under the titles that surveyors use.

use std::collections::BTreeSet;
use std::path::Path;

use crate::gcp::columns::{Columns, columns};
use crate::gcp::raw::{CrsClaim, RawList};
use crate::gcp::text::{Line, Row, SEPARATORS, Separator, number, refuse_more_cells, refuse_open_quote, split};
use crate::gcp::titles::tidy;
use crate::gcp::{remarks, said_of_columns, statistics, title_cells};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// The list under its header; `None` where no line among the first ones names both coordinates.
pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Option<Result<RawList>> {
    let (at, separator, columns) = header(lines)?;
    Some(with_header(path, lines, at, separator, columns))
}

/// Whether a line names both coordinates.
pub(super) fn is_header(line: Line<'_>) -> bool {
    header(&[line]).is_some()
}

/// The line among the first ones that names both coordinates; it may be a comment, as in Metashape's exports.
fn header(lines: &[Line<'_>]) -> Option<(usize, Separator, Columns)> {
    lines.iter().take(12).enumerate().find_map(|(at, line)| {
        let titles = line.text.trim_start_matches(['#', '!', '/']).trim();
        SEPARATORS.iter().find_map(|&separator| {
            let titles = split(titles, separator);
            // "n é 500000.25 4649000.5" is a point's name before its place.
            let coordinates = titles.iter().filter(|title| is_place(title)).count();
            let columns = columns(titles).filter(|_| coordinates < 2)?;
            let is_prose = || {
                let rows = rows_below(&lines[at + 1..], separator);
                separator == Separator::Blanks && !title_cells::are_titles(line, &columns, &rows)
            };
            (!is_prose()).then_some((at, separator, columns))
        })
    })
}

fn rows_below<'a>(lines: &'a [Line<'a>], separator: Separator) -> Vec<Row<'a>> {
    lines.iter().filter(|line| !line.is_comment()).map(|line| (line, split(line.text, separator))).collect()
}

/// Whether a cell is a coordinate rather than a title of digits, as a year is.
fn is_place(cell: &str) -> bool {
    const LONGEST_YEAR: f64 = 9999.0;
    number(cell).is_some_and(|value| value.abs() > LONGEST_YEAR || value.fract() != 0.0)
}

fn with_header(path: &Path, lines: &[Line<'_>], at: usize, separator: Separator, columns: Columns) -> Result<RawList> {
    let below = rows_below(&lines[at + 1..], separator);
    let columns = title_cells::settled(path, &lines[at], &columns, separator, &below)?.unwrap_or(columns);
    // Of two sets of coordinates the CRS that is given may mean the other; one that cannot be read is none.
    let beside = columns.other().and_then(|other| with_columns(path, lines, at, separator, other).ok());
    let mut list = with_columns(path, lines, at, separator, columns)?;
    list.beside = beside.map(Box::new);
    Ok(list)
}

fn with_columns(
    path: &Path,
    lines: &[Line<'_>],
    at: usize,
    separator: Separator,
    mut columns: Columns,
) -> Result<RawList> {
    if let Some(title) = &columns.doubled {
        let what = format!("two columns are called `{title}`; remove or rename the one that is not meant");
        return Err(Error::format(path, lines[at].place(), what));
    }
    let mut rows = rows_below(&lines[at + 1..], separator);
    for row in &rows {
        refuse_open_quote(path, row.0)?;
        refuse_more_cells(path, row, columns.titles.len(), separator)?;
    }
    let of_units = remarks::take_units(&mut columns, &mut rows);
    let of_marks = columns.settle_marks(path, &rows)?;
    let statistics = statistics::set_aside(&columns, &mut rows);
    let guessed = columns.guess_name(&rows);
    let (mut points, mut unclear_roles) = (Vec::new(), BTreeSet::new());
    for (line, fields) in &rows {
        unclear_roles.extend(columns.unclear_roles(fields));
        points.push(columns.point(path, line.place(), fields, &(points.len() + 1).to_string())?);
    }
    let (crs, of_system) = stated_system(path, lines, at, (&columns, &rows))?;
    let mut list = RawList::new(points, crs);
    columns.tell(&mut list);
    list.open_mark = columns.open_mark(&rows);
    let skipped = lines[..at].iter().find(|line| !line.is_comment());
    let above = skipped.map(|line| format!("row {} and what is above the header was passed over", line.row));
    let of_angles = columns.told_of_angles(&rows);
    let notes = [
        of_units,
        of_marks,
        of_angles,
        columns.told_of_hemispheres(),
        columns.told_of_accuracies(),
        said_of_columns::of_roles(&unclear_roles),
        guessed,
        statistics.doubt,
        of_system,
        columns.unclear(),
        above,
    ];
    let notes = notes.into_iter().flatten();
    list.notes.extend(notes.map(|what| format!("{}: {what}", path.display())));
    list.set_aside = statistics.aside.map(|what| format!("{}: {what}", path.display()));
    Ok(list)
}

/// What the table says of its system: above the titles, in a column, in a remark; else degrees are those of WGS 84.
/// With what is to be said of it.
fn stated_system(
    path: &Path,
    lines: &[Line<'_>],
    header: usize,
    (columns, rows): (&Columns, &[Row<'_>]),
) -> Result<(CrsClaim, Option<String>)> {
    let stated = coordinate_system_comment(path, &lines[..header])?;
    if !matches!(stated, CrsClaim::None) {
        return Ok((stated, None));
    }
    let named = columns.crs.and_then(|column| named_in_rows(path, column, rows));
    if let Some(claim) = named {
        return Ok((claim, None));
    }
    if let Some(claim) = zones_in_rows(path, columns, rows) {
        return Ok((claim, None));
    }
    let otherwise = || match columns.geographic {
        true => Ok(CrsClaim::Known(Crs::from_epsg(4326)?)),
        false => Ok(CrsClaim::None),
    };
    match columns.named_system(rows) {
        Ok(Some(crs)) => return Ok((CrsClaim::Known(crs), None)),
        Err(why) => return Ok((otherwise()?, Some(why))),
        Ok(None) => {}
    }
    let beside = lines.iter().enumerate().filter(|(i, line)| *i != header && (*i < header || line.is_comment()));
    Ok(match remarks::system(beside.map(|(_, line)| line)) {
        // A map's system is not that of degrees.
        Ok(Some((crs, note))) if crs.is_geographic() == columns.geographic => (CrsClaim::Known(crs), Some(note)),
        Ok(_) => (otherwise()?, None),
        Err(why) => (otherwise()?, Some(why)),
    })
}

/// The system that a column names in all rows that name one; `None` where none does.
fn named_in_rows(path: &Path, column: usize, rows: &[Row<'_>]) -> Option<CrsClaim> {
    let named = rows.iter().filter_map(|(line, cells)| Some((line, cells.get(column)?.trim())));
    let mut named = named.filter(|(_, text)| !text.is_empty());
    let (first, definition) = named.next()?;
    let claim = CrsClaim::read(path, first.place(), definition);
    let is_same = |text: &str| match &claim {
        _ if text == definition => true,
        CrsClaim::Known(crs) => Crs::parse(text).is_ok_and(|other| other == *crs),
        _ => true,
    };
    let Some((line, other)) = named.find(|(_, text)| !is_same(text)) else { return Some(claim) };
    let what = format!(
        "it names `{other}` for its CRS, and {} `{definition}`; give a list for each, or --crs where one is wrong",
        first.place()
    );
    Some(CrsClaim::Unclear(Error::format(path, line.place(), what)))
}

/// Rows of two zones are of two systems: which is meant, --crs may say.
fn zones_in_rows(path: &Path, columns: &Columns, rows: &[Row<'_>]) -> Option<CrsClaim> {
    const TITLES: [&str; 6] = ["zone", "utm zone", "utmzone", "utm", "sone", "zona"];
    // Bands of UTM have the letters C to X, without I and O.
    let is_band = |band: &str| matches!(band.as_bytes(), [letter] if matches!(letter.to_ascii_uppercase(), b'C'..=b'H' | b'J'..=b'N' | b'P'..=b'X'));
    let is_zone = |text: &str| {
        let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        is_band(&text[number.len()..]) && number.parse::<u8>().is_ok_and(|zone| (1..=60).contains(&zone))
    };
    let column = columns.titles.iter().position(|title| TITLES.contains(&tidy(title).as_str()))?;
    let zones: Vec<(String, &str)> = rows
        .iter()
        .filter_map(|(line, cells)| Some((line.place(), cells.get(column)?.trim())))
        .filter(|(_, zone)| !zone.is_empty())
        .collect();
    let number = |zone: &str| zone.trim_end_matches(|c: char| c.is_ascii_alphabetic()).to_owned();
    let (first, zone) = zones.first().filter(|_| !columns.geographic)?;
    let (place, other) = zones.iter().find(|(_, other)| number(other) != number(zone))?;
    zones.iter().all(|(_, zone)| is_zone(zone)).then(|| {
        let what = format!(
            "its coordinates are of zone {other}, those of {first} of zone {zone}; give a list for each, or --crs where \
             all are of one"
        );
        CrsClaim::Unclear(Error::format(path, place.clone(), what))
    })
}

/// Metashape writes "#CoordinateSystem: WKT" above its header.
fn coordinate_system_comment(path: &Path, lines: &[Line<'_>]) -> Result<CrsClaim> {
    for line in lines.iter().filter(|line| line.is_comment()) {
        let content = line.text.trim_start_matches(['#', '!', '/']).trim();
        let Some((key, value)) = content.split_once(':') else { continue };
        let key = key.to_lowercase().replace([' ', '_'], "");
        if matches!(key.as_str(), "coordinatesystem" | "crs") && !value.trim().is_empty() {
            return Ok(CrsClaim::read(path, line.place(), value.trim().trim_matches('"')));
        }
    }
    Ok(CrsClaim::None)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text;

    #[test]
    fn a_row_whose_name_reads_as_titles_is_no_header() {
        let is_header = |text| is_header(Line { row: 1, text, is_point: false });
        assert!(!is_header("n é\t500000.25\t4649000.5\t100.5"));
        assert!(!is_header("N E 500000 4649000"));
        assert!(is_header("name\tn\té\t2019\t2020"));
    }

    #[test]
    fn a_remark_in_prose_is_no_header() {
        let rows = "P1 500100.1 6600200.2 10.1\nP2 500200.1 6600300.2 11.1\n";
        let is_header = |first: &str| header(&text::lines(&format!("{first}\n{rows}"))).is_some();
        for remark in [
            "# Site: North East quarter",
            "GCP north east survey",
            "# Station East gate, North field",
            "# points to the north and the east of the bridge",
        ] {
            assert!(!is_header(remark), "{remark}");
        }
        for titles in
            ["# name east north height", "name E N H", "Pt code E N", "Point ID East North Height", "# GCP E N"]
        {
            assert!(is_header(titles), "{titles}");
        }
    }
}
