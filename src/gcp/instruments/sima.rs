//! SIMA (Japan's exchange format of surveyors): records cut by commas, of which A01 holds a point.
//!
//! After the description of the common format by the Japanese association of surveying instruments' makers: `Z00` and
//! `Z01` are the head, `A00` to `A99` the block of coordinates, and `A01,1,NAME,X,Y,Z,` a point: its number, its name,
//! X (north), Y (east) and perhaps Z, in metres.

use std::path::Path;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::{self, Line};
use autoref_raster::error::{Error, Result};

/// Whether a line is the first of such a file.
pub(super) fn is_head(line: &str) -> bool {
    line.starts_with("Z00,") || line.starts_with("A00,") || line.starts_with("A01,")
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let mut points = Vec::new();
    for line in lines.iter().filter(|line| line.text.starts_with("A01,")) {
        let place = line.place();
        let fields: Vec<&str> = line.text.split(',').map(str::trim).collect();
        let field = |index: usize| fields.get(index).copied().unwrap_or_default();
        let number = |index: usize, what: &str| {
            text::number(field(index)).ok_or_else(|| no_number(path, &place, field(index), what))
        };
        let name = if field(2).is_empty() { field(1) } else { field(2) };
        if name.is_empty() {
            return Err(Error::format(path, place, "the point has no name; correct or remove the record"));
        }
        let height = if field(5).is_empty() { None } else { Some(number(5, "height (Z)")?) };
        let gcp = Gcp { height, ..Gcp::control(name, number(4, "easting (Y)")?, number(3, "northing (X)")?) };
        points.push(RawPoint::bare(gcp, place));
    }
    if points.is_empty() {
        let what = "this SIMA holds no coordinates (records A01); export the block of coordinates";
        return Err(Error::format(path, "the file", what));
    }
    Ok(RawList::new(points, CrsClaim::None))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_north_first() {
        let read = |content: &str| parse(Path::new("a.sim"), &text::lines(content));
        let content =
            "Z00,\u{5ea7}\u{6a19},,\nA00,\nA01,1,K-1,-36258.114,-11624.52,12.305,\nA01,2,,-36200,-11600,,\nA99,\n";
        let list = read(content).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!(
            (gcp.name.as_str(), gcp.easting, gcp.northing, gcp.height),
            ("K-1", -11_624.52, -36_258.114, Some(12.305))
        );
        assert_eq!((list.points[1].gcp.name.as_str(), list.points[1].gcp.height), ("2", None));
        assert!(read("Z00,x,,\n").err().expect("none").to_string().contains("records A01"));
        let error = read("A01,1,K,5,b,\n").err().expect("no number").to_string();
        assert!(error.contains("row 1") && error.contains("easting"), "{error}");
    }
}
