//! GCPs as GeoJSON: Point features (or MultiPoints of one), 2-D or 3-D, with or without the `crs` member of the 2008
//! format.
//!
//! RFC 7946 (H. Butler et al., "The GeoJSON Format", 2016) says longitude, latitude; many survey programs write
//! projected coordinates all the same, so that is decided by the values.

use std::path::Path;

use serde_json::Value;

use crate::gcp::attributes::{self, Told};
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::roles::is_check;
use crate::gcp::titles::{NAMES, find, tidy};
use crate::gcp::{Gcp, GcpRole};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};

pub(super) fn parse(path: &Path, text: &str) -> Result<RawList> {
    let document: Value = serde_json::from_str(text).map_err(|e| {
        Error::format(path, format!("line {}, column {}", e.line(), e.column()), format!("it is not valid JSON: {e}"))
    })?;
    let features: Vec<&Value> = match document["type"].as_str() {
        Some("FeatureCollection") => document["features"]
            .as_array()
            .ok_or_else(|| Error::format(path, "`features`", "a FeatureCollection needs a list of features"))?
            .iter()
            .collect(),
        Some("Feature") => vec![&document],
        other => {
            return Err(Error::format(
                path,
                "`type`",
                format!("expected a FeatureCollection of points, found {}", other.unwrap_or("no type")),
            ));
        }
    };
    // Of our own output only the surveyed points: not the marks, not the residual vectors.
    let ours = |f: &Value| !matches!(f["properties"]["layer"].as_str(), Some("mark" | "residual"));
    let (mut points, mut told) = (Vec::new(), Told::default());
    for (index, feature) in features.iter().enumerate().filter(|(_, feature)| ours(feature)) {
        let found = feature["geometry"]["type"].as_str().unwrap_or("no geometry");
        let Some(coordinates) = coordinates(&feature["geometry"]) else {
            if found == "MultiPoint" {
                return Err(attributes::no_single_point(path, index + 1));
            }
            told.no_point(index + 1, found);
            continue;
        };
        let (point, title) = point(path, index, feature, coordinates, &mut told)?;
        told.height(&point, title);
        points.push(point);
    }
    let mut list = RawList::new(points, stated_system(path, &document["crs"]));
    told.tell(path, &mut list)?;
    list.may_be_degrees = true;
    list.order = ColumnOrder::Ruled;
    Ok(list)
}

/// Of the `crs` member of 2008: a name, or a code of EPSG's as older writers have it. Other members are not understood,
/// and must not be passed over.
fn stated_system(path: &Path, member: &Value) -> CrsClaim {
    let (place, properties) = ("`crs`".to_owned(), &member["properties"]);
    let code = match &properties["code"] {
        Value::Number(code) => Some(code.to_string()),
        Value::String(code) => Some(code.trim().trim_start_matches("EPSG:").to_owned()),
        _ => None,
    };
    let is_epsg = member["type"].as_str().is_some_and(|kind| kind.eq_ignore_ascii_case("epsg"));
    match (&properties["name"], code) {
        _ if member.is_null() => CrsClaim::None,
        (Value::String(name), _) => CrsClaim::read(path, place, name),
        (_, Some(code)) if is_epsg => CrsClaim::read(path, place, &format!("EPSG:{code}")),
        _ => {
            let what = format!("`{member}` is not understood: a name or a code of EPSG's is; --crs overrides it");
            CrsClaim::Unclear(Error::format(path, place, what))
        }
    }
}

/// The property whose key is one of a name's titles ("punkt", "label").
fn titled(properties: &Value) -> &Value {
    let keys: Vec<&String> = properties.as_object().into_iter().flatten().map(|(key, _)| key).collect();
    let tidied: Vec<String> = keys.iter().map(|key| tidy(key)).collect();
    find(&tidied, NAMES).map_or(&Value::Null, |at| &properties[keys[at].as_str()])
}

/// Those of a point, or of the only point of several; GIS programs write either.
fn coordinates(geometry: &Value) -> Option<&Value> {
    match geometry["type"].as_str() {
        Some("Point") => Some(&geometry["coordinates"]),
        Some("MultiPoint") => match geometry["coordinates"].as_array().map(Vec::as_slice) {
            Some([one]) => Some(one),
            _ => None,
        },
        _ => None,
    }
}

fn point(
    path: &Path,
    index: usize,
    feature: &Value,
    coordinates: &Value,
    told: &mut Told,
) -> Result<(RawPoint, Option<String>)> {
    let place = format!("feature {}", index + 1);
    let properties = &feature["properties"];
    let name = [&properties["name"], &properties["id"], &properties["Name"], titled(properties), &feature["id"]]
        .into_iter()
        .find_map(|value| match value {
            Value::String(text) if !text.trim().is_empty() => Some(text.trim().to_string()),
            Value::Number(number) => Some(number.to_string()),
            _ => None,
        })
        .unwrap_or_else(|| (index + 1).to_string());
    let coordinates: Vec<f64> =
        coordinates.as_array().map(|values| values.iter().map_while(Value::as_f64).collect()).unwrap_or_default();
    if !(2..=4).contains(&coordinates.len()) {
        return Err(Error::format(path, place, format!("point `{name}` needs two or three numbers as coordinates")));
    }
    let keyed: Vec<(&String, &Value)> = properties.as_object().into_iter().flatten().collect();
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_string);
    let said = |value: &Value| match value {
        Value::Null | Value::Array(_) | Value::Object(_) => String::new(),
        value => text(value),
    };
    let titles: Vec<String> = keyed.iter().map(|(key, _)| (*key).clone()).collect();
    let cells: Vec<String> = keyed.iter().map(|(_, value)| said(value)).collect();
    let place_of_it = (coordinates[0], coordinates[1]);
    let (mut read, mut title) =
        attributes::point(path, place.clone(), (&titles, &cells), place_of_it, &(index + 1).to_string(), told)?;
    if ["role", "type", "use"].iter().filter_map(|key| properties[*key].as_str()).any(is_check) {
        read.gcp.role = GcpRole::Check;
    }
    if let Some(height) = coordinates.get(2) {
        (read.gcp.height, title) = (Some(*height), None);
    }
    let number = |key: &str| properties[key].as_f64();
    let attributes = keyed.into_iter().map(|(key, value)| (key.clone(), text(value))).collect();
    let image = properties["image"].as_str().map(str::to_owned);
    let own = number("x").zip(number("y")).filter(|_| properties["layer"] == "gcp").map(|(x, y)| (image, x, y));
    let listed =
        properties["pixels"].as_array().into_iter().flatten().filter_map(|seen| {
            Some((seen["image"].as_str().map(str::to_owned), seen["x"].as_f64()?, seen["y"].as_f64()?))
        });
    let pixels = own.into_iter().chain(listed).map(|(image, x, y)| Seen { image, at: PixelPoint { x, y } }).collect();
    Ok((RawPoint { gcp: Gcp { name, ..read.gcp }, place, attributes, pixels }, title))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(crs: &str, properties: &str) -> Result<RawList> {
        let feature = format!(
            r#"{{"type":"Feature","geometry":{{"type":"Point","coordinates":[500100.1,6600200.2]}},"properties":{properties}}}"#
        );
        let text = format!(r#"{{"type":"FeatureCollection"{crs},"features":[{feature}]}}"#);
        parse(Path::new("l.geojson"), &text)
    }

    #[test]
    fn properties_are_read_as_columns_are() {
        for (properties, role) in [
            (r#"{"Type":"Check"}"#, GcpRole::Check),
            (r#"{"Role":"check point"}"#, GcpRole::Check),
            (r#"{"check":"yes"}"#, GcpRole::Check),
            (r#"{"checkpoint":true}"#, GcpRole::Check),
            (r#"{"check":1}"#, GcpRole::Check),
            (r#"{"enabled":false}"#, GcpRole::Check),
            (r#"{"type":"GCP","check":null}"#, GcpRole::Control),
        ] {
            assert_eq!(read("", properties).expect("readable").points[0].gcp.role, role, "{properties}");
        }
        let list =
            read("", r#"{"Name":"P1","sigma_m":"0.02","Elev_ft":"12,5","Vertical accuracy":0.03}"#).expect("readable");
        let gcp = &list.points[0].gcp;
        assert_eq!((gcp.name.as_str(), gcp.height, gcp.sigma_m), ("P1", Some(12.5), Some(0.02)));
        assert_eq!(gcp.sigma_height_m, Some(0.03));
        assert_eq!(list.units.height.expect("a unit").0.metres, 0.3048);
    }

    #[test]
    fn the_member_crs_is_read_or_said_to_be_unclear() {
        for crs in [
            r#","crs":{"type":"EPSG","properties":{"code":25832}}"#,
            r#","crs":{"type":"EPSG","properties":{"code":"25832"}}"#,
            r#","crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::25832"}}"#,
        ] {
            let CrsClaim::Known(found) = read(crs, "{}").expect("readable").crs else { panic!("{crs}") };
            assert_eq!(found.epsg(), Some(25832), "{crs}");
        }
        for (crs, is_unclear) in
            [(r#","crs":null"#, false), (r#","crs":{"type":"link","properties":{"href":"x"}}"#, true)]
        {
            let claim = read(crs, "{}").expect("readable").crs;
            assert_eq!(matches!(claim, CrsClaim::Unclear(_)), is_unclear, "{crs}");
        }
    }
}
