//! GCPs as GeoJSON: Point features, 2-D or 3-D, with or without the `crs` member of the 2008 format.
//!
//! RFC 7946 (H. Butler et al., "The GeoJSON Format", 2016) says longitude, latitude; many survey programs write
//! projected coordinates all the same, so that is decided by the values.

use std::path::Path;

use serde_json::Value;

use crate::gcp::columns::is_check;
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint, Seen};
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
    let points = features.iter().enumerate().filter(|(_, f)| ours(f)).map(|(i, f)| point(path, i, f));
    let points = points.collect::<Result<Vec<_>>>()?;
    let crs = match &document["crs"]["properties"]["name"] {
        Value::String(name) => CrsClaim::read(path, "`crs`".into(), name),
        _ => CrsClaim::None,
    };
    let mut list = RawList::new(points, crs);
    list.may_be_degrees = true;
    list.order = ColumnOrder::Ruled;
    Ok(list)
}

/// The property whose key is one of a name's titles ("punkt", "label").
fn titled(properties: &Value) -> &Value {
    let keys: Vec<&String> = properties.as_object().into_iter().flatten().map(|(key, _)| key).collect();
    let tidied: Vec<String> = keys.iter().map(|key| tidy(key)).collect();
    find(&tidied, NAMES).map_or(&Value::Null, |at| &properties[keys[at].as_str()])
}

fn point(path: &Path, index: usize, feature: &Value) -> Result<RawPoint> {
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
    if feature["geometry"]["type"].as_str() != Some("Point") {
        let found = feature["geometry"]["type"].as_str().unwrap_or("no geometry");
        return Err(Error::format(path, place, format!("point `{name}` must be a Point, it is {found}")));
    }
    let coordinates: Vec<f64> = feature["geometry"]["coordinates"]
        .as_array()
        .map(|values| values.iter().map_while(Value::as_f64).collect())
        .unwrap_or_default();
    if !(2..=4).contains(&coordinates.len()) {
        return Err(Error::format(path, place, format!("point `{name}` needs two or three numbers as coordinates")));
    }
    let number = |key: &str| properties[key].as_f64();
    let yes = |value: &Value| value.as_bool() == Some(true) || value.as_i64() == Some(1);
    let check = ["role", "type", "use"].iter().filter_map(|key| properties[*key].as_str()).any(is_check)
        || yes(&properties["check"]);
    let gcp = Gcp {
        name,
        easting: coordinates[0],
        northing: coordinates[1],
        height: coordinates.get(2).copied().or_else(|| number("height")),
        sigma_m: number("sigma_m"),
        sigma_height_m: number("sigma_height_m"),
        role: if check { GcpRole::Check } else { GcpRole::Control },
    };
    let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_string);
    let attributes = properties.as_object().into_iter().flatten().map(|(key, value)| (key.clone(), text(value)));
    let image = properties["image"].as_str().map(str::to_owned);
    let own = number("x").zip(number("y")).filter(|_| properties["layer"] == "gcp").map(|(x, y)| (image, x, y));
    let listed =
        properties["pixels"].as_array().into_iter().flatten().filter_map(|seen| {
            Some((seen["image"].as_str().map(str::to_owned), seen["x"].as_f64()?, seen["y"].as_f64()?))
        });
    let pixels = own.into_iter().chain(listed).map(|(image, x, y)| Seen { image, at: PixelPoint { x, y } }).collect();
    Ok(RawPoint { gcp, place, attributes: attributes.collect(), pixels })
}
