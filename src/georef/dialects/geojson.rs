//! Marks, surveyed points and residual vectors as one GeoJSON, told apart by the property `layer`.
//!
//! The coordinates are in the CRS of the result, which the `crs` member of the 2008 format names (GDAL and QGIS follow
//! it).

use std::path::Path;

use serde_json::{Map, Value, json};

use super::{TiePoint, TiePoints, write_file};
use crate::gcp::programs;
use autoref_raster::error::Result;

/// Writes the collection: features of `layer` "gcp" (where it was surveyed), "mark" (where the transform puts the mark)
/// and "residual" (the line from the mark to the surveyed point).
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut features = Vec::new();
    for pair in &tie_points.pairs {
        let mut surveyed = vec![pair.gcp.easting, pair.gcp.northing];
        surveyed.extend(pair.gcp.height);
        features.push(feature("gcp", pair, json!({"type": "Point", "coordinates": surveyed})));
        if let Some(transform) = tie_points.transform {
            let mark = transform.apply(pair.pixel);
            let mark = json!([mark.easting, mark.northing]);
            features.push(feature("mark", pair, json!({"type": "Point", "coordinates": mark})));
            let line = json!([mark, [pair.gcp.easting, pair.gcp.northing]]);
            features.push(feature("residual", pair, json!({"type": "LineString", "coordinates": line})));
        }
    }
    let mut collection = Map::new();
    collection.insert("type".into(), json!("FeatureCollection"));
    if let Some(crs) = &tie_points.crs {
        collection.insert("crs".into(), programs::geojson_crs(crs));
    }
    collection.insert("features".into(), Value::Array(features));
    let text = serde_json::to_string_pretty(&Value::Object(collection)).expect("no map keys but strings");
    write_file(path, &(text + "\n"))
}

fn feature(layer: &str, pair: &TiePoint, geometry: Value) -> Value {
    let mut properties = json!({
        "layer": layer,
        "name": pair.gcp.name,
        "role": programs::role(&pair.gcp),
        "x": pair.pixel.x,
        "y": pair.pixel.y,
        "residual_e_m": pair.residual_e_m,
        "residual_n_m": pair.residual_n_m,
        "residual_m": pair.residual_e_m.hypot(pair.residual_n_m),
    });
    if let Some(sigma_m) = pair.gcp.sigma_m {
        properties["sigma_m"] = json!(sigma_m);
    }
    if let Some(sigma_m) = pair.gcp.sigma_height_m {
        properties["sigma_height_m"] = json!(sigma_m);
    }
    json!({"type": "Feature", "properties": properties, "geometry": geometry})
}
