//! LandXML: the points of `CgPoints`.
//!
//! A `CgPoint` holds northing, easting and perhaps the height, apart by blanks, whatever the order of the CRS's axes.
//! `Units` says in what (`Metric`, or `Imperial` with its foot), `CoordinateSystem` may name an EPSG code. A point that
//! refers to another by `pntRef` holds nothing of its own.

use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text;
use crate::gcp::units::{TitledUnits, Unit};
use crate::gcp::xml::{Lines, attribute, broken, local_name, words};
use autoref_raster::error::{Error, Result};

/// A point that is being read.
struct Open {
    name: Option<String>,
    code: Option<String>,
    content: String,
}

pub(super) fn parse(path: &Path, content: &str) -> Result<RawList> {
    let mut reader = Reader::from_str(content);
    let mut lines = Lines::of(content);
    let mut points = Vec::new();
    let mut open: Option<Open> = None;
    let (mut crs, mut unit) = (CrsClaim::None, None);
    loop {
        let event = reader.read_event().map_err(|e| broken(path, content, &reader, e))?;
        let mut place = || lines.row(reader.buffer_position());
        match &event {
            Event::Start(start) | Event::Empty(start) => match local_name(start) {
                // Those of other elements that follow say nothing of the points.
                "Metric" | "Imperial" if unit.is_none() => unit = Some(unit_of(path, place(), start)?),
                "CoordinateSystem" => {
                    if let Some(definition) = attribute(start, "epsgCode").and_then(|code| definition(&code)) {
                        crs = CrsClaim::read(path, place(), &definition);
                    }
                }
                "CgPoint" if matches!(event, Event::Start(_)) => {
                    let name = attribute(start, "name").filter(|name| !name.trim().is_empty());
                    open = Some(Open { name, code: attribute(start, "code"), content: String::new() });
                }
                _ => {}
            },
            Event::Text(_) | Event::GeneralRef(_) | Event::CData(_) => {
                if let Some(open) = &mut open {
                    open.content += &words(&event);
                }
            }
            Event::End(end) if end.name().as_ref().ends_with("CgPoint") => {
                let taken = open.take().filter(|open| !open.content.trim().is_empty());
                if let Some(taken) = taken {
                    points.push(point(path, place(), taken, points.len() + 1)?);
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    if points.is_empty() {
        return Err(Error::format(
            path,
            "the file",
            "this LandXML holds no CgPoints with coordinates; export the points of the survey, not only lines and \
             surfaces",
        ));
    }
    let mut list = RawList::new(points, crs);
    list.units = unit.map_or_else(TitledUnits::default, |unit| TitledUnits::all(unit, "Units"));
    Ok(list)
}

/// What an `epsgCode` names: a number, with or without the authority, also as the last part of a URN or an address; 0
/// and less stand for none.
fn definition(code: &str) -> Option<String> {
    let code = code.trim();
    let (authority, number) = code.rsplit_once([':', '/', ' ']).unwrap_or(("", code));
    let is_number = number.parse::<i64>().is_ok() || number.split('+').all(|part| part.parse::<u32>().is_ok());
    match number.parse::<i64>() {
        _ if code.is_empty() => None,
        Ok(..=0) => None,
        _ if is_number && (authority.is_empty() || authority.to_lowercase().contains("epsg")) => {
            Some(format!("EPSG:{number}"))
        }
        _ => Some(code.to_owned()),
    }
}

/// `Metric` is metres unless it says otherwise; of `Imperial` the foot that it names.
fn unit_of(path: &Path, place: String, start: &BytesStart<'_>) -> Result<Unit> {
    let named = attribute(start, "linearUnit").unwrap_or_default();
    let unit = match (local_name(start), named.as_str()) {
        ("Metric", "") => Unit::of_word("m"),
        (_, "USSurveyFoot") => Unit::of_word("us ft"),
        // The schema's foot is the international one.
        ("Imperial", "foot" | "") => Unit::of_word("ft"),
        (_, named) => Unit::of_word(named),
    };
    unit.ok_or_else(|| {
        Error::format(path, place, format!("`{named}` is no unit of lengths that is known; export in metres or feet"))
    })
}

fn point(path: &Path, place: String, open: Open, number: usize) -> Result<RawPoint> {
    let name = open.name.unwrap_or_else(|| number.to_string());
    let numbers: Option<Vec<f64>> = open.content.split_whitespace().map(text::number).collect();
    match numbers.as_deref() {
        Some([northing, easting, rest @ ..]) if rest.len() < 2 => {
            let gcp = Gcp { height: rest.first().copied(), ..Gcp::control(name, *easting, *northing) };
            let attributes = open.code.map(|code| ("code".to_owned(), code)).into_iter().collect();
            Ok(RawPoint { attributes, ..RawPoint::bare(gcp, place) })
        }
        _ => Err(Error::format(
            path,
            place,
            format!("`{}` of point `{name}` are not northing, easting and height; correct it", open.content.trim()),
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(units: &str, points: &str) -> Result<RawList> {
        let text = format!(
            "<?xml version=\"1.0\"?>\n<LandXML><Units>{units}</Units>\n<CoordinateSystem epsgCode=\"25832\"/>\n<CgPoints>\n{points}</CgPoints></LandXML>"
        );
        parse(Path::new("a.xml"), &text)
    }

    #[test]
    fn codes_of_systems_as_they_are_written() {
        for code in ["25833", "EPSG:25833", " epsg 25833", "urn:ogc:def:crs:EPSG::25833"] {
            assert_eq!(definition(code).as_deref(), Some("EPSG:25833"), "{code}");
        }
        assert_eq!(definition("http://www.opengis.net/def/crs/EPSG/0/25833").as_deref(), Some("EPSG:25833"));
        assert!(["0", "", " ", "-1"].iter().all(|code| definition(code).is_none()));
        assert_eq!(definition("25832+5941").as_deref(), Some("EPSG:25832+5941"));
        for other in ["ESRI:102100", "sweref99"] {
            assert_eq!(definition(other).as_deref(), Some(other), "for the parser to judge");
        }
    }

    #[test]
    fn prefixes_and_bare_text() {
        let text = "<lx:LandXML xmlns:lx=\"u\"><lx:CgPoints><lx:CgPoint name=\"1\"><![CDATA[7031894.724 569834.26]]>\
                    </lx:CgPoint></lx:CgPoints></lx:LandXML>";
        assert!(super::super::recognised("xml", text).is_some());
        assert!(super::super::recognised("xml", "<gml note=\"LandXML\"/>").is_none());
        let list = parse(Path::new("a.xml"), text).expect("readable");
        assert_eq!((list.points[0].gcp.easting, list.points.len()), (569_834.26, 1));
    }

    #[test]
    fn points_are_north_first() {
        let points = "<CgPoint name=\"101\" code=\"GCP\">7031894.724 569834.26 47.211</CgPoint>\n<CgPoint pntRef=\"101\"/>\n<CgPoint name=\"B\">7031800 569800</CgPoint>\n";
        let list = read("<Metric linearUnit=\"meter\"/>", points).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.easting, gcp.northing), ("101", 569_834.26, 7_031_894.724));
        assert_eq!((gcp.height, list.points.len(), list.points[1].gcp.height), (Some(47.211), 2, None));
        assert!(matches!(&list.crs, CrsClaim::Known(crs) if crs.label() == "EPSG:25832"));
        let error = read("", "<CgPoint name=\"A\">1 b</CgPoint>\n").err().expect("no number").to_string();
        assert!(error.contains("row 5") && error.contains("`A`"), "{error}");
        let error = read("<Imperial linearUnit=\"mile\"/>", points).err().expect("miles").to_string();
        assert!(error.contains("`mile`") && error.contains("export in metres"), "{error}");
        assert!(read("", "").err().expect("none").to_string().contains("no CgPoints"));
    }
}
