//! Trimble JobXML: the reduced points on the grid.
//!
//! `Reductions/Point` holds what came of all measurements: `Name`, perhaps `Code`, and `Grid` with `North`, `East` and
//! `Elevation`, in metres whatever the program shows. A job without reductions has the points that were typed in, in
//! the records of its field book. Deleted points are none, and what was measured again as a check or when a point was
//! staked out is not the point.

use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::Event;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text;
use crate::gcp::xml::{Lines, broken, words};
use autoref_raster::error::{Error, Result};

/// A point that is being read.
#[derive(Default)]
struct Open {
    name: String,
    code: String,
    deleted: String,
    class: String,
    north: String,
    east: String,
    elevation: String,
}

pub(super) fn parse(path: &Path, content: &str) -> Result<RawList> {
    let mut reader = Reader::from_str(content);
    let mut lines = Lines::of(content);
    let mut elements: Vec<String> = Vec::new();
    let (mut reduced, mut recorded) = (Vec::new(), Vec::new());
    let mut open = Open::default();
    let mut written = String::new();
    loop {
        let event = reader.read_event().map_err(|e| broken(path, content, &reader, e))?;
        match &event {
            Event::Start(start) => {
                let name = start.name().as_ref().to_string();
                if is_point(&elements, &name) {
                    open = Open::default();
                }
                written.clear();
                elements.push(name);
            }
            Event::Text(_) | Event::GeneralRef(_) | Event::CData(_) => written += &words(&event),
            Event::End(_) => {
                let name = elements.pop().unwrap_or_default();
                open.take(&elements, &name, written.trim());
                written.clear();
                if is_point(&elements, &name) {
                    let place = lines.row(reader.buffer_position());
                    let points = if name == "Point" { &mut reduced } else { &mut recorded };
                    points.extend(std::mem::take(&mut open).point(path, place)?);
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    let points = if reduced.is_empty() { latest(recorded) } else { reduced };
    if points.is_empty() {
        return Err(Error::format(
            path,
            "the file",
            "this JobXML holds no points on the grid (Reductions, Point, Grid), only measurements; export it with the \
             reduced coordinates of the job",
        ));
    }
    Ok(RawList::new(points, CrsClaim::None))
}

/// Whether the element below these is a point: reduced, or a record of the field book.
fn is_point(elements: &[String], name: &str) -> bool {
    matches!(
        (elements.last().map(String::as_str), name),
        (Some("Reductions"), "Point") | (Some("FieldBook"), "PointRecord")
    )
}

/// A point that was recorded again is the later one.
fn latest(recorded: Vec<RawPoint>) -> Vec<RawPoint> {
    let mut names = std::collections::HashSet::new();
    let mut points: Vec<RawPoint> =
        recorded.into_iter().rev().filter(|point| names.insert(point.gcp.name.clone())).collect();
    points.reverse();
    points
}

impl Open {
    fn take(&mut self, elements: &[String], name: &str, text: &str) {
        let parent = elements.last().map_or("", String::as_str);
        let field = match (parent, name) {
            ("Point" | "PointRecord", "Name") => &mut self.name,
            ("Point" | "PointRecord", "Code") => &mut self.code,
            ("Point" | "PointRecord", "Deleted") => &mut self.deleted,
            ("Point" | "PointRecord", "Classification") => &mut self.class,
            ("Grid" | "ComputedGrid", "North") => &mut self.north,
            ("Grid" | "ComputedGrid", "East") => &mut self.east,
            ("Grid" | "ComputedGrid", "Elevation") => &mut self.elevation,
            _ => return,
        };
        // What was computed stands in for a place that was not typed in.
        if !text.is_empty() && (parent != "ComputedGrid" || field.is_empty()) {
            text.clone_into(field);
        }
    }

    /// A point that was measured again to be compared.
    fn is_check(&self) -> bool {
        matches!(self.class.as_str(), "Check" | "AsStaked")
    }

    /// `None` for what has no place on the grid, was deleted, or only checked.
    fn point(self, path: &Path, place: String) -> Result<Option<RawPoint>> {
        if self.north.is_empty()
            || self.east.is_empty()
            || self.name.is_empty()
            || self.deleted == "true"
            || self.is_check()
        {
            return Ok(None);
        }
        let number = |text: &str, what: &str| text::number(text).ok_or_else(|| no_number(path, &place, text, what));
        // "?" and nothing stand for no height.
        let height = text::number(&self.elevation);
        let (easting, northing) = (number(&self.east, "East")?, number(&self.north, "North")?);
        let gcp = Gcp { height, ..Gcp::control(self.name, easting, northing) };
        let attributes = vec![("code".to_owned(), self.code)];
        Ok(Some(RawPoint { attributes, ..RawPoint::bare(gcp, place) }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECORD: &str = "<PointRecord ID=\"1\"><Name>A</Name><Grid><North>7031800</North><East>569800</East><Elevation>1</Elevation></Grid></PointRecord>";

    #[test]
    fn reductions_before_records() {
        let point = "<Point><Name>A</Name><Code>GCP</Code><Grid><North>7031894.724</North><East>569834.26</East><Elevation>47.211</Elevation></Grid></Point>";
        let gone = "<Point><Name>B</Name><Deleted>true</Deleted><Grid><North>1</North><East>2</East></Grid></Point>";
        let text =
            format!("<JOBFile><FieldBook>{RECORD}</FieldBook>\n<Reductions>{point}\n{gone}</Reductions></JOBFile>");
        let list = parse(Path::new("a.jxl"), &text).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing), ("A", 569_834.26, 7_031_894.724));
        assert_eq!((gcp.height, list.points.len()), (Some(47.211), 1));
        let text =
            format!("<JOBFile><FieldBook>{RECORD}{}</FieldBook></JOBFile>", RECORD.replace("7031800", "7031801"));
        let list = parse(Path::new("a.jxl"), &text).expect("typed in");
        assert_eq!((list.points.len(), list.points[0].gcp.northing), (1, 7_031_801.0));
        let check =
            RECORD.replace("7031800", "7031802").replace("<Grid>", "<Classification>Check</Classification><Grid>");
        let computed = RECORD.replace("Grid>", "ComputedGrid>").replace("<Name>A", "<Name>B");
        let text = format!("<JOBFile><FieldBook>{RECORD}{check}{computed}</FieldBook></JOBFile>");
        let list = parse(Path::new("a.jxl"), &text).expect("a point, its check, and one that was computed");
        assert_eq!(list.points.iter().map(|p| p.gcp.northing).collect::<Vec<_>>(), [7_031_800.0, 7_031_800.0]);
        let error = parse(Path::new("a.jxl"), "<JOBFile/>").err().expect("none").to_string();
        assert!(error.contains("no points on the grid"), "{error}");
    }
}
