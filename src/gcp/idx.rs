//! Leica's IDX, the file of coordinates of its field controllers: between `POINTS(PointNo, PointID, East, …)` and
//! `END POINTS` a table whose rows end in semicolons.

use std::path::Path;

use crate::gcp::csv_list;
use crate::gcp::raw::RawList;
use crate::gcp::text::Line;
use autoref_raster::error::{Error, Result};

/// The list of such a file; `None` for others.
pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Option<Result<RawList>> {
    let is_idx = lines.first()?.text == "HEADER" && lines.get(1)?.text.starts_with("VERSION");
    is_idx.then(|| table(path, lines))
}

fn table(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    if let Some(line) = lines.iter().find(|line| line.text.starts_with("LINEAR") && !line.text.contains("MET")) {
        let what = format!("`{}`: lengths that are not in metres are not read; export in metres", line.text);
        return Err(Error::format(path, line.place(), what));
    }
    let titles = |line: &Line<'_>| {
        line.text
            .strip_prefix("POINTS")
            .and_then(|rest| rest.trim().strip_prefix('(')?.strip_suffix(')'))
            .map(str::to_owned)
    };
    let Some((at, titles)) = lines.iter().enumerate().find_map(|(at, line)| Some((at, titles(line)?))) else {
        let what = "this IDX holds no table of points (`POINTS(…)`); export the coordinates";
        return Err(Error::format(path, "the file", what));
    };
    let rows = lines[at + 1..].iter().take_while(|line| !line.text.starts_with("END"));
    // The number of a record is no name.
    let named: Vec<&str> =
        titles.split(',').map(|title| if title.trim() == "PointNo" { "record" } else { title }).collect();
    let mut table = vec![(lines[at].row, named.join(","))];
    table.extend(rows.map(|line| (line.row, line.text.trim_end_matches(';').replace(", \"", ",\""))));
    let table: Vec<Line<'_>> = table.iter().map(|(row, text)| Line { row: *row, text, is_point: false }).collect();
    csv_list::parse(path, &table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text::lines;

    const FILE: &str = "HEADER\n VERSION 1.20\n UNITS\n  LINEAR METRE\n END UNITS\nEND HEADER\nDATABASE\n\
        POINTS(PointNo, PointID, East, North, Elevation, Code, Date, CLASS)\n\
        1, \"A1\", 597966.2000, 6643165.9000, 45.2000, \"GCP\", 03-MAY-2024/08:24:00.0, MEAS;\n\
        2, \"A 2\", 598066.2000, 6643265.9000, 46.2000, \"GCP\", 03-MAY-2024/08:24:00.0, MEAS;\nEND POINTS\nEND DATABASE\n";

    #[test]
    fn the_table_of_points_is_read() {
        let list = parse(Path::new("a.idx"), &lines(FILE)).expect("an IDX").expect("readable");
        let found: Vec<_> = list.points.iter().map(|p| (p.gcp.name.as_str(), p.gcp.easting, p.gcp.height)).collect();
        assert_eq!(found, [("A1", 597_966.2, Some(45.2)), ("A 2", 598_066.2, Some(46.2))]);
        let error =
            |text: String| parse(Path::new("a.idx"), &lines(&text)).expect("IDX").err().expect("refused").to_string();
        assert!(error(FILE.replace("METRE", "FOOT")).contains("export in metres"));
        assert!(error(FILE.replace("POINTS(", "LINES(")).contains("no table of points"));
        assert!(parse(Path::new("a.csv"), &lines("name,e,n\n")).is_none());
    }
}
