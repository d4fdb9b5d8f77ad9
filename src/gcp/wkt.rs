//! Tables with points as text, as QGIS and databases export them: `POINT Z (597966.2 6643165.9 45.2)` in a cell under
//! `WKT`, `geom` and the like. The cell is put apart into columns of its own.

use std::path::Path;

use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList};
use crate::gcp::text::{Line, SEPARATORS, Separator, refuse_open_quote, split};
use crate::gcp::titled;
use crate::gcp::titles::tidy;
use autoref_raster::error::{Error, Result};

const TITLES: [&str; 8] = ["wkt", "geom", "geometry", "the geom", "wkt geom", "shape", "ewkt", "wkb geometry"];

/// A point of a cell: its numbers, and the system that PostGIS writes before it.
struct Point<'a> {
    numbers: Vec<&'a str>,
    srid: Option<&'a str>,
}

fn point(cell: &str) -> Option<Point<'_>> {
    let (srid, shape) = match cell.trim().split_once(';') {
        Some((srid, shape)) => (Some(srid.trim().strip_prefix("SRID=")?), shape),
        None => (None, cell),
    };
    let (word, rest) = shape.trim().strip_suffix(')')?.split_once('(')?;
    let kinds = ["POINT", "POINT Z", "POINTZ", "POINT M", "POINTM", "POINT ZM", "POINTZM"];
    let word = word.trim().to_uppercase();
    if !kinds.contains(&word.as_str()) {
        return None;
    }
    let mut numbers: Vec<&str> = rest.split_whitespace().collect();
    if word.ends_with('M') {
        numbers.pop(); // a measure, no height
    }
    (2..=3).contains(&numbers.len()).then_some(Point { numbers, srid })
}

/// The list of a table whose header names no coordinates but such a column; `None` for other tables.
pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Option<Result<RawList>> {
    let content: Vec<&Line<'_>> = lines.iter().filter(|line| !line.is_comment()).collect();
    let (first, rows) = content.split_first()?;
    let (separator, at, titles) = SEPARATORS.into_iter().filter(|s| *s != Separator::Blanks).find_map(|separator| {
        let titles = split(first.text, separator);
        let at = titles.iter().position(|title| TITLES.contains(&tidy(title).as_str()))?;
        Some((separator, at, titles))
    })?;
    let is_point = |line: &&&Line<'_>| split(line.text, separator).get(at).is_some_and(|cell| point(cell).is_some());
    rows.iter().any(|line| is_point(&line)).then(|| apart(path, (first, rows), (separator, at), titles))
}

fn apart(
    path: &Path,
    (first, rows): (&Line<'_>, &[&Line<'_>]),
    (separator, at): (Separator, usize),
    mut titles: Vec<String>,
) -> Result<RawList> {
    titles.splice(at..=at, ["easting", "northing", "height"].map(str::to_owned));
    let mut table = vec![(first.row, row_of(&titles))];
    let mut system = None;
    for line in rows {
        refuse_open_quote(path, line)?;
        let mut cells = split(line.text, separator);
        let Some(Point { numbers, srid }) = cells.get(at).and_then(|cell| point(cell)) else {
            let shown: String = cells.get(at).map_or(line.text, String::as_str).chars().take(60).collect();
            let what = format!("`{shown}` is no point (`POINT (east north)`); correct or remove the row");
            return Err(Error::format(path, line.place(), what));
        };
        if let Some(srid) = srid {
            let label = format!("EPSG:{srid}");
            if *system.get_or_insert_with(|| (line.place(), label.clone())).1 != label {
                let what = "the points are of several systems; give a list of one";
                return Err(Error::format(path, line.place(), what));
            }
        }
        let own = (0..3).map(|index| numbers.get(index).copied().unwrap_or_default().to_owned());
        let own: Vec<String> = own.collect();
        cells.splice(at..=at, own);
        table.push((line.row, row_of(&cells)));
    }
    let lines: Vec<Line<'_>> = table.iter().map(|(row, text)| Line { row: *row, text, is_point: false }).collect();
    let mut list = titled::parse(path, &lines).expect("its titles name both coordinates")?;
    list.order = ColumnOrder::Ruled;
    list.may_be_degrees = true;
    if let (Some((place, label)), CrsClaim::None) = (system, &list.crs) {
        list.crs = CrsClaim::read(path, place, &label);
    }
    Ok(list)
}

fn row_of(cells: &[String]) -> String {
    let quoted: Vec<String> = cells.iter().map(|cell| format!("\"{}\"", cell.replace('"', "\"\""))).collect();
    quoted.join(";")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text::lines;

    fn read(text: &str) -> Result<RawList> {
        parse(Path::new("a.csv"), &lines(text)).expect("a table of points")
    }

    #[test]
    fn points_as_text_are_read() {
        let qgis =
            "WKT,fid,name\n\"POINT Z (597966.2 6643165.9 45.2)\",1,P1\n\"POINT (597866.2 6643065.9)\",2,\"P, 2\"\n";
        let list = read(qgis).expect("readable");
        let found: Vec<_> = list.points.iter().map(|p| (p.gcp.name.as_str(), p.gcp.easting, p.gcp.height)).collect();
        assert_eq!(found, [("P1", 597_966.2, Some(45.2)), ("P, 2", 597_866.2, None)]);
        let list = read("name|geom\nA|SRID=25832;POINT(597966.2 6643165.9)\nB|SRID=25832;Point(1 2)\n").expect("read");
        assert!(matches!(&list.crs, CrsClaim::Known(crs) if crs.epsg() == Some(25832)));
        let measured = read("geom;name\nPOINT M (1 2 99);A\nPOINT ZM (1 2 3 99);B\n").expect("readable");
        assert_eq!([measured.points[0].gcp.height, measured.points[1].gcp.height], [None, Some(3.0)]);
    }

    #[test]
    fn what_is_no_point_is_named() {
        let error =
            read("WKT,name\n\"POINT (1 2)\",A\n\"LINESTRING (1 2, 3 4)\",B\n").err().expect("a line").to_string();
        assert!(error.contains("row 3") && error.contains("LINESTRING"), "{error}");
        assert!(parse(Path::new("a.csv"), &lines("name,e,n\nA,1,2\n")).is_none());
    }
}
