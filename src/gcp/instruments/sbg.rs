//! SBG GEO, Sweden's field program (`.geo`, "SBG Object Text"): statements, each perhaps with a block between `begin`
//! and `end`.
//!
//! After the files that open programs read and write: `PointList` holds `Point "NAME",N,E,H,"CODE",…`, north first, the
//! height empty where none was measured; lines have vertices of their own under the same word, which are no points of
//! the list; `FileInfo "Coordinate System","Sweref 99 15 45 / RH2000 (…)"` names the system.

use std::path::Path;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::{self, Line, Separator, split};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// Whether a line is the first of such a file.
pub(super) fn is_head(line: &str) -> bool {
    line.starts_with("FileHeader") && line.contains("SBG Object Text")
}

/// What follows a statement's word, cut.
fn arguments(line: &str, word: &str) -> Option<Vec<String>> {
    let rest = line.strip_prefix(word)?;
    let is_word = rest.is_empty() || rest.starts_with([' ', '\t', '"']);
    is_word.then(|| split(rest.trim(), Separator::Letter(',')))
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let mut points = Vec::new();
    let mut system = None;
    // The words of the blocks that are open, and the last statement, whose block may begin.
    let (mut blocks, mut last): (Vec<&str>, &str) = (Vec::new(), "");
    for line in lines {
        let word = line.text.split([' ', '\t', '"']).next().unwrap_or_default();
        match word {
            "begin" => blocks.push(last),
            "end" => drop(blocks.pop()),
            "FileInfo" => {
                let said = arguments(line.text, word).unwrap_or_default();
                if let [key, value, ..] = &said[..]
                    && key == "Coordinate System"
                    && !value.is_empty()
                {
                    system = Some((line.place(), value.clone()));
                }
            }
            "Point" if blocks == ["PointList"] => {
                points.push(point(path, line, &arguments(line.text, word).unwrap_or_default())?);
            }
            _ => {}
        }
        last = word;
    }
    if points.is_empty() {
        let what = "this file of SBG GEO holds no points (`Point` in its `PointList`); export the points, or KOF";
        return Err(Error::format(path, "the file", what));
    }
    let known = system.as_ref().and_then(|(_, name)| crs(name));
    let note = match (&known, &system) {
        (Some(crs), Some((_, name))) => Some(format!("{}: its system `{name}` is {}", path.display(), crs.title())),
        (None, Some((place, name))) => {
            Some(format!("{}: {place}: the system `{name}` is not known by this name; give --crs", path.display()))
        }
        _ => None,
    };
    let mut list = RawList::new(points, known.map_or(CrsClaim::None, CrsClaim::Known));
    list.notes.extend(note);
    Ok(list)
}

fn point(path: &Path, line: &Line<'_>, fields: &[String]) -> Result<RawPoint> {
    let place = line.place();
    let field = |index: usize| fields.get(index).map(String::as_str).unwrap_or_default();
    let number = |index: usize, what: &str| {
        text::number(field(index)).ok_or_else(|| no_number(path, &place, field(index), what))
    };
    if field(0).is_empty() {
        return Err(Error::format(path, place, "the point has no name; correct or remove the record"));
    }
    let height = if field(3).is_empty() { None } else { Some(number(3, "height")?) };
    let gcp = Gcp { height, ..Gcp::control(field(0), number(2, "easting")?, number(1, "northing")?) };
    Ok(RawPoint::bare(gcp, place))
}

/// The system of the plan: "Sweref 99 15 45 / RH2000 (SWEN17)".
fn crs(name: &str) -> Option<Crs> {
    /// The zones of SWEREF 99 from EPSG:3006 on.
    const ZONES: [&str; 13] =
        ["TM", "1200", "1330", "1500", "1630", "1800", "1415", "1545", "1715", "1845", "2015", "2145", "2315"];
    let plan = name.split('/').next()?.to_uppercase().replace(' ', "");
    let zone = ZONES.iter().position(|zone| plan.strip_prefix("SWEREF99") == Some(zone))?;
    Crs::from_epsg(3006 + zone as u32).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "FileHeader \"SBG Object Text v2.01\",\"Coordinate Document\",\"UTF-8\"\nbegin\n\
        \tFileInfo \"Coordinate System\",\"Sweref 99 15 45 / RH2000 (SWEN17)\"\nend\nPointList \nbegin\n\
        \tPoint \"101\",6165575.706,147391.005,41.936,,,\n\tbegin\n\t\tAttributeList\n\t\tbegin\n\
        \t\t\tAttribute \"UB\",\"20200101\"\n\t\tend\n\tend\n\tPoint \"Brunn, norr\",6165500.5,147300.25,,\"GCP\",,\nend\n\
        LineList\nbegin\n\tLine \"1\",1,\n\tbegin\n\t\tPointList\n\t\tbegin\n\
        \t\t\tPoint \"01\",6165570.816,147382.844,41.94,,,\n\t\tend\n\tend\nend\n";

    #[test]
    fn points_are_north_first_and_vertices_of_lines_are_none() {
        let list = parse(Path::new("a.geo"), &text::lines(FILE)).expect("readable");
        let found: Vec<_> = list.points.iter().map(|p| (p.gcp.name.as_str(), p.gcp.easting, p.gcp.northing)).collect();
        assert_eq!(found, [("101", 147_391.005, 6_165_575.706), ("Brunn, norr", 147_300.25, 6_165_500.5)]);
        assert_eq!([list.points[0].gcp.height, list.points[1].gcp.height], [Some(41.936), None]);
        assert!(matches!(&list.crs, CrsClaim::Known(crs) if crs.name().contains("15 45")), "{:?}", list.notes);
    }

    #[test]
    fn what_is_missing_is_said() {
        let error = |text: &str| parse(Path::new("a.geo"), &text::lines(text)).err().expect("refused").to_string();
        assert!(error("FileHeader \"SBG Object Text v2.01\"\nPointList\n").contains("no points"));
        let broken = error(&FILE.replace("147391.005", "x"));
        assert!(broken.contains("row 7") && broken.contains("easting"), "{broken}");
        let other = FILE.replace("Sweref 99 15 45 / RH2000 (SWEN17)", "Kommunens eget");
        let list = parse(Path::new("a.geo"), &text::lines(&other)).expect("readable");
        assert!(matches!(list.crs, CrsClaim::None) && list.notes[0].contains("Kommunens eget"));
    }
}
