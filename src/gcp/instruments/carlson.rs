//! Carlson RW5 (TDS raw data): records cut by commas, of which SP holds a stored point, OC an occupied one.
//!
//! After Carlson's description of the format: `SP,PN101,N 7031894.724,E 569834.260,EL47.211,--note`, and OC with OP for
//! PN; `MO` says the unit of lengths (UN0 feet, UN1 metres, UN2 US survey feet). A point that was stored and occupied
//! is one. What SurvCE measured by satellites stands as longitude and
//! latitude in GPS records, and on the job's grid in the remark `--GS` after them, with the fields of SP.

use std::path::Path;

use super::no_number;
use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::{self, Line};
use crate::gcp::units::{TitledUnits, Unit};
use autoref_raster::error::{Error, Result};

/// Whether a line is a record that only this format has.
pub(super) fn is_record(line: &str) -> bool {
    line.starts_with("JB,NM") || line.starts_with("SP,PN")
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let (mut points, mut occupied) = (Vec::new(), Vec::new());
    let mut unit = None;
    // Of the points before.
    let mut counts_in = None;
    for line in lines {
        let place = line.place();
        let (record, note) = match line.text.strip_prefix("--") {
            // Only this remark holds a point.
            Some(remark) if remark.starts_with("GS,") => (remark, ""),
            Some(_) => continue,
            None => line.text.split_once("--").unwrap_or((line.text, "")),
        };
        let record = record.split_once("--").map_or(record, |(record, _)| record);
        let mut fields = record.split(',').map(str::trim);
        let kind = fields.next().unwrap_or_default();
        let fields: Vec<&str> = fields.collect();
        let field = |head: &str| fields.iter().find_map(|field| field.strip_prefix(head)).map(str::trim);
        if kind == "MO" {
            unit = match field("UN") {
                Some("0") => Unit::of_word("ft"),
                Some("1") => Unit::of_word("m"),
                Some("2") => Unit::of_word("us ft"),
                _ => unit,
            };
        }
        let head = match kind {
            "SP" | "GS" => "PN",
            // Stations may be occupied that have a name only.
            "OC" if field("N ").is_some() && field("E ").is_some() => "OP",
            _ => continue,
        };
        if *counts_in.get_or_insert(unit) != unit {
            let what = "its lengths count in another unit (MO) than those before; export the job in one unit";
            return Err(Error::format(path, place, what));
        }
        let number = |head: &str, what: &str| {
            let text = field(head).unwrap_or_default();
            text::number(text).ok_or_else(|| no_number(path, &place, text, what))
        };
        let name = field(head).filter(|name| !name.is_empty());
        let Some(name) = name else {
            return Err(Error::format(
                path,
                place,
                format!("the point has no name ({head}); correct or remove the record"),
            ));
        };
        let height = field("EL").filter(|text| !text.is_empty()).map(|_| number("EL", "height")).transpose()?;
        let gcp = Gcp { height, ..Gcp::control(name, number("E ", "easting")?, number("N ", "northing")?) };
        let attributes = vec![("note".to_owned(), note.trim().to_owned())];
        let point = RawPoint { attributes, ..RawPoint::bare(gcp, place) };
        if kind == "OC" { occupied.push(point) } else { points.push(point) }
    }
    if points.is_empty() {
        return Err(Error::format(
            path,
            "the file",
            "this raw data holds no stored points (records SP), only measurements; export the coordinates of the job",
        ));
    }
    super::add_stations(&mut points, occupied);
    let mut list = RawList::new(points, CrsClaim::None);
    list.units = unit.map_or_else(TitledUnits::default, |unit| TitledUnits::all(unit, "UN"));
    Ok(list)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(content: &str) -> Result<RawList> {
        parse(Path::new("a.rw5"), &text::lines(content))
    }

    #[test]
    fn stored_points_and_those_on_the_grid() {
        let content = "JB,NMjob\nMO,AD0,UN1,SF1.0\n--Record 1\nSP,PN101,N 7031894.724,E 569834.26,EL47.211,--GCP\n\
                       GPS,PN7,LA63.24,LN10.23,EL5\n--GS,PN7,N 7031900.1,E 569840.2,EL48.1,--nail\n";
        let list = read(content).expect("readable");
        let places: Vec<_> = list.points.iter().map(|p| (p.gcp.name.as_str(), p.gcp.easting, p.gcp.northing)).collect();
        assert_eq!(places, [("101", 569_834.26, 7_031_894.724), ("7", 569_840.2, 7_031_900.1)]);
        assert_eq!(list.points[0].gcp.height, Some(47.211));
        assert_eq!(list.points[0].attributes[0].1, "GCP");
        let error = read("JB,NMjob\nSS,OP1,FP2,AR10.0,ZE90.0,SD5.0\n").err().expect("polar").to_string();
        assert!(error.contains("records SP"), "{error}");
        let content = "JB,NMjob\nOC,OP1,N 7031500,E 569500,EL1,--\nSP,PN2,N 7031600,E 569600,EL2,--\nOC,OP2,N 7031600,E 569600,EL2,--\nOC,OP1,N 7031500,E 569500,EL1,--\nOC,OP9\n";
        let list = read(content).expect("readable");
        assert_eq!(list.points.iter().map(|p| p.gcp.name.as_str()).collect::<Vec<_>>(), ["2", "1"], "once each");
        let two = "MO,UN1\nMO,UN1\nSP,PN1,N 5,E 6\nMO,UN0\nSP,PN2,N 5,E 6\n";
        let error = read(two).err().expect("two units").to_string();
        assert!(error.contains("row 5") && error.contains("another unit"), "{error}");
        assert!(read("SP,PN1,N 5,EL3\n").err().expect("no easting").to_string().contains("easting"));
    }
}
