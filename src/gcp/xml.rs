//! GCPs in XML: the markers that Metashape exports, and MicMac's `DicoAppuisFlottant`.
//!
//! Sources: an export of Metashape (`document/chunk/markers/marker/reference`), and
//! `include/XML_GEN/ParamChantierPhotogram.xml` of MicMac. In Metashape a marker that is switched off is a check point;
//! where it was seen stands apart, in `frames/frame/markers/marker/location`, by the numbers of marker and camera.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use quick_xml::Reader;
use quick_xml::events::{BytesStart, Event};

use crate::gcp::raw::{CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::text::number;
use crate::gcp::{Gcp, GcpRole};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};

/// The dialects of XML that are read here; all others are OGR's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Dialect {
    Metashape,
    MicMac,
}

pub(super) fn dialect(text: &str) -> Option<Dialect> {
    let start: String = text.chars().take(4096).collect();
    if text.contains("<OneAppuisDAF>") {
        return Some(Dialect::MicMac);
    }
    (start.contains("<document") && text.contains("<marker")).then_some(Dialect::Metashape)
}

pub(super) fn parse(path: &Path, text: &str, dialect: Dialect) -> Result<RawList> {
    match dialect {
        Dialect::Metashape => metashape(path, text),
        Dialect::MicMac => micmac(path, text),
    }
}

/// Lines of bytes, counted from 1. Asked for one place after another, it counts each line once.
pub(super) struct Lines<'a> {
    text: &'a str,
    position: usize,
    line: usize,
}

impl<'a> Lines<'a> {
    pub(super) fn of(text: &'a str) -> Lines<'a> {
        Lines { text, position: 0, line: 1 }
    }

    pub(super) fn row(&mut self, position: u64) -> String {
        let end = (position as usize).min(self.text.len());
        if end < self.position {
            *self = Lines::of(self.text);
        }
        self.line += self.text.as_bytes()[self.position..end].iter().filter(|b| **b == b'\n').count();
        self.position = end;
        format!("row {}", self.line)
    }
}

pub(super) fn broken(path: &Path, text: &str, reader: &Reader<&[u8]>, error: impl std::fmt::Display) -> Error {
    let place = Lines::of(text).row(reader.error_position());
    Error::format(path, place, format!("the XML is broken: {error}"))
}

pub(super) fn attribute(start: &BytesStart<'_>, name: &str) -> Option<String> {
    let attribute = start.attributes().flatten().find(|a| a.key.as_ref() == name)?;
    // An entity that the document defines for itself stays as it is written.
    Some(unescaped(&attribute.value))
}

/// The name of an element without its prefix.
pub(super) fn local_name<'a>(start: &'a BytesStart<'_>) -> &'a str {
    let name = start.name().into_inner();
    name.rsplit(':').next().unwrap_or(name)
}

fn unescaped(text: &str) -> String {
    quick_xml::escape::unescape(text).map_or_else(|_| text.to_owned(), Cow::into_owned)
}

/// The words of a text, of a section without markup, or of an entity (`&quot;`), which comes as an event of its own
/// between two texts.
pub(super) fn words(event: &Event<'_>) -> String {
    match event {
        Event::Text(content) => unescaped(content.as_ref()),
        Event::CData(content) => content.as_ref().to_owned(),
        Event::GeneralRef(entity) => unescaped(&format!("&{};", entity.as_ref())),
        _ => String::new(),
    }
}

fn metashape(path: &Path, text: &str) -> Result<RawList> {
    let mut reader = Reader::from_str(text);
    let mut elements: Vec<String> = Vec::new();
    let mut points: Vec<RawPoint> = Vec::new();
    let mut label: Option<String> = None;
    let mut sightings = Sightings::default();
    let (mut crs, mut definition) = (CrsClaim::None, String::new());
    let mut without = 0;
    let mut lines = Lines::of(text);
    loop {
        let event = reader.read_event().map_err(|e| broken(path, text, &reader, e))?;
        let mut place = || lines.row(reader.buffer_position());
        match &event {
            Event::Start(start) | Event::Empty(start) => {
                let name = start.name().as_ref().to_string();
                let parent = elements.last().map_or("", String::as_str);
                sightings.take(start, &name, &elements);
                if name == "marker" && parent == "markers" && !elements.iter().any(|e| e == "frame") {
                    label = attribute(start, "label");
                    sightings.point = attribute(start, "id").map(|id| (id, points.len()));
                    without += usize::from(matches!(event, Event::Empty(_)) && label.is_some());
                } else if name == "reference" && parent == "marker" {
                    let name = label.clone().unwrap_or_else(|| (points.len() + 1).to_string());
                    match marker(path, &place(), start, name)? {
                        Some(point) => points.push(point),
                        None => without += 1,
                    }
                }
                if matches!(event, Event::Start(_)) {
                    elements.push(name);
                }
            }
            Event::Text(_) | Event::GeneralRef(_) | Event::CData(_)
                if elements.ends_with(&["chunk".into(), "reference".into()]) =>
            {
                definition += &words(&event);
            }
            Event::End(_) => {
                if !definition.trim().is_empty() {
                    crs = CrsClaim::read(path, place(), definition.trim());
                    definition.clear();
                }
                elements.pop();
            }
            Event::Eof => break,
            _ => {}
        }
    }
    sightings.give(&mut points);
    let mut list = RawList::new(points, crs);
    if without > 0 {
        list.notes
            .push(format!("{}: {without} markers have no surveyed coordinates and were left out", path.display()));
    }
    Ok(list)
}

/// Where markers were seen, by the numbers that the document gives to cameras and markers.
#[derive(Default)]
struct Sightings {
    /// Label of each camera by its number.
    cameras: HashMap<String, String>,
    /// The marker that is being read: its number, and its place among the points if it becomes one.
    point: Option<(String, usize)>,
    points: HashMap<String, usize>,
    /// The marker of the frame that is being read.
    marker: Option<String>,
    /// Numbers of marker and camera, place in the image.
    locations: Vec<(String, String, PixelPoint)>,
}

impl Sightings {
    fn take(&mut self, start: &BytesStart<'_>, name: &str, elements: &[String]) {
        let parent = elements.last().map_or("", String::as_str);
        match (name, parent) {
            ("camera", "cameras" | "group") => {
                self.cameras.extend(attribute(start, "id").zip(attribute(start, "label")));
            }
            ("reference", "marker") => self.points.extend(self.point.take()),
            ("marker", "markers") => self.marker = attribute(start, "marker_id"),
            ("location", "marker") => {
                let at = |key| attribute(start, key).as_deref().and_then(number);
                if let (Some(marker), Some(camera), Some(x), Some(y)) =
                    (self.marker.clone(), attribute(start, "camera_id"), at("x"), at("y"))
                {
                    self.locations.push((marker, camera, PixelPoint { x, y }));
                }
            }
            _ => {}
        }
    }

    fn give(self, points: &mut [RawPoint]) {
        for (marker, camera, at) in self.locations {
            if let Some(point) = self.points.get(&marker).and_then(|index| points.get_mut(*index)) {
                point.pixels.push(Seen { image: self.cameras.get(&camera).cloned(), at });
            }
        }
    }
}

fn marker(path: &Path, place: &str, start: &BytesStart<'_>, name: String) -> Result<Option<RawPoint>> {
    let value = |key: &str| -> Result<Option<f64>> {
        let Some(text) = attribute(start, key) else { return Ok(None) };
        number(&text).map(Some).ok_or_else(|| {
            Error::format(path, place, format!("marker `{name}`: `{text}` is no number for {key}; correct it"))
        })
    };
    let (Some(easting), Some(northing)) = (value("x")?, value("y")?) else { return Ok(None) };
    let off = attribute(start, "enabled").is_some_and(|text| matches!(text.as_str(), "0" | "false"));
    let gcp = Gcp {
        height: value("z")?,
        sigma_m: value("sx")?.filter(|s| *s > 0.0),
        sigma_height_m: value("sz")?.filter(|s| *s > 0.0),
        role: if off { GcpRole::Check } else { GcpRole::Control },
        ..Gcp::control(name, easting, northing)
    };
    Ok(Some(RawPoint::bare(gcp, place)))
}

fn micmac(path: &Path, text: &str) -> Result<RawList> {
    let mut reader = Reader::from_str(text);
    let (mut element, mut content) = (String::new(), String::new());
    let mut points = Vec::new();
    let (mut name, mut position, mut sigma) = (None::<String>, None::<Vec<f64>>, None::<Vec<f64>>);
    let mut lines = Lines::of(text);
    loop {
        let event = reader.read_event().map_err(|e| broken(path, text, &reader, e))?;
        let place = lines.row(reader.buffer_position());
        match event {
            Event::Start(start) => {
                element = start.name().as_ref().to_string();
                content.clear();
            }
            Event::Text(_) | Event::GeneralRef(_) | Event::CData(_) => content += &words(&event),
            Event::End(end) => {
                let content = std::mem::take(&mut content).trim().to_string();
                let numbers = || -> Result<Option<Vec<f64>>> {
                    let values: Option<Vec<f64>> = content.split_whitespace().map(number).collect();
                    values.filter(|v| v.len() == 3).map(Some).ok_or_else(|| {
                        Error::format(
                            path,
                            &place,
                            format!("`{content}` are not three numbers for {element}; correct it"),
                        )
                    })
                };
                match element.as_str() {
                    "NamePt" if !content.is_empty() => name = Some(content),
                    "Pt" if !content.is_empty() => position = numbers()?,
                    "Incertitude" if !content.is_empty() => sigma = numbers()?,
                    _ => {}
                }
                element.clear();
                if end.name().as_ref() == "OneAppuisDAF" {
                    let (Some(at), name) = (position.take(), name.take()) else {
                        return Err(Error::format(path, &place, "a point without Pt; three numbers are expected"));
                    };
                    // MicMac's files carry 1 1 1 or 10 10 10 where nothing is known.
                    let known = |s: &f64| *s > 0.0 && *s < 1.0;
                    let sigma = sigma.take();
                    let gcp = Gcp {
                        height: Some(at[2]),
                        sigma_m: sigma.as_ref().map(|s| s[0].max(s[1])).filter(known),
                        sigma_height_m: sigma.as_ref().map(|s| s[2]).filter(known),
                        ..Gcp::control(name.unwrap_or_else(|| (points.len() + 1).to_string()), at[0], at[1])
                    };
                    points.push(RawPoint::bare(gcp, place));
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    let mut list = RawList::new(points, CrsClaim::None);
    list.units.accuracies_as_coordinates = true;
    Ok(list)
}
