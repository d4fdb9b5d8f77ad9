//! Lists as text.

use std::collections::{HashMap, HashSet};

use serde_json::{Map, Value, json};

use super::losses::{extra, has_a_meaning};
use super::{ListFormat, Survey, kof};
use crate::gcp::programs::{self, Marker, optional, role};
use crate::gcp::raw::{RawPoint, Seen};
use autoref_raster::cells::{csv_text, quoted};
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

pub(super) fn write(survey: &Survey, format: ListFormat) -> Result<String> {
    Ok(match format {
        ListFormat::GeoJson => geojson(survey),
        ListFormat::Kof => kof::write(survey),
        ListFormat::Odm => odm(survey)?,
        ListFormat::Qgis => qgis(survey),
        ListFormat::MetashapeCsv => programs::metashape_reference(survey.gcps(), survey.crs.as_ref()),
        ListFormat::MetashapeXml => metashape_xml(survey),
        ListFormat::Pix4d => {
            programs::pix4d(survey.gcps(), survey.crs.as_ref()).expect("lists without heights were refused")
        }
        ListFormat::MicMac => {
            programs::micmac(survey.gcps(), survey.crs.as_ref()).expect("lists without heights were refused")
        }
        _ => csv(survey),
    })
}

/// A field of a table: numbers as they are, texts never a formula.
fn field(text: &str) -> String {
    if text.parse::<f64>().is_ok() { quoted(text) } else { csv_text(text) }
}

fn geojson(survey: &Survey) -> String {
    let mut features = Vec::new();
    for point in &survey.points {
        let gcp = &point.gcp;
        let mut properties = Map::new();
        for (title, value) in extra(point).filter(|(title, _)| !has_a_meaning(title)) {
            properties.insert(title.clone(), json!(value));
        }
        properties.insert("name".into(), json!(gcp.name));
        properties.insert("role".into(), json!(role(gcp)));
        for (title, value) in [("sigma_m", gcp.sigma_m), ("sigma_height_m", gcp.sigma_height_m)] {
            if let Some(value) = value {
                properties.insert(title.into(), json!(value));
            }
        }
        if !point.pixels.is_empty() {
            let seen = |s: &Seen| json!({"image": s.image, "x": s.at.x, "y": s.at.y});
            properties.insert("pixels".into(), point.pixels.iter().map(seen).collect());
        }
        let mut coordinates = vec![gcp.easting, gcp.northing];
        coordinates.extend(gcp.height);
        features.push(json!({
            "type": "Feature",
            "properties": properties,
            "geometry": {"type": "Point", "coordinates": coordinates},
        }));
    }
    let mut collection = Map::new();
    collection.insert("type".into(), json!("FeatureCollection"));
    // Longitude and latitude of WGS 84 are what GeoJSON says without the member of 2008.
    if let Some(crs) = survey.crs.as_ref().filter(|crs| crs.epsg() != Some(4326)) {
        collection.insert("crs".into(), programs::geojson_crs(crs));
    }
    collection.insert("features".into(), Value::Array(features));
    serde_json::to_string_pretty(&Value::Object(collection)).expect("no map keys but strings") + "\n"
}

fn csv(survey: &Survey) -> String {
    let mut titles: Vec<&str> = vec!["name", "easting", "northing", "height"];
    let sigma = survey.any(|g| g.sigma_m.is_some());
    let sigma_height = survey.any(|g| g.sigma_height_m.is_some());
    let seen = survey.points.iter().any(|p| !p.pixels.is_empty());
    let image = survey.points.iter().filter_map(Survey::first_seen).any(|s| s.image.is_some());
    titles.extend(sigma.then_some("sigma_m"));
    titles.extend(sigma_height.then_some("sigma_height_m"));
    titles.push("role");
    titles.extend(survey.crs.is_some().then_some("crs"));
    titles.extend(seen.then_some(["pixel_x", "pixel_y"]).into_iter().flatten());
    titles.extend(image.then_some("image"));
    let own = titles.len();
    let mut known: HashSet<&str> = titles.iter().copied().collect();
    let mut meant: HashMap<&str, bool> = HashMap::new();
    for point in &survey.points {
        for (title, _) in extra(point) {
            if !*meant.entry(title).or_insert_with(|| has_a_meaning(title)) && known.insert(title) {
                titles.push(title);
            }
        }
    }
    let mut text = titles.iter().map(|t| field(t)).collect::<Vec<_>>().join(",") + "\n";
    let crs = survey.crs.as_ref().map(Crs::label).unwrap_or_default();
    for point in &survey.points {
        let (gcp, at) = (&point.gcp, Survey::first_seen(point));
        // Of columns with one title the first.
        let further: HashMap<&str, &str> =
            point.attributes.iter().rev().map(|(t, v)| (t.as_str(), v.as_str())).collect();
        let value = |(i, title): (usize, &&str)| match *title {
            title if i >= own => further.get(title).copied().unwrap_or_default().to_owned(),
            "name" => gcp.name.clone(),
            "easting" => gcp.easting.to_string(),
            "northing" => gcp.northing.to_string(),
            "height" => optional(gcp.height),
            "sigma_m" => optional(gcp.sigma_m),
            "sigma_height_m" => optional(gcp.sigma_height_m),
            "role" => role(gcp).into(),
            "crs" => crs.clone(),
            "pixel_x" => optional(at.map(|s| s.at.x)),
            "pixel_y" => optional(at.map(|s| s.at.y)),
            _ => at.and_then(|s| s.image.clone()).unwrap_or_default(),
        };
        let fields: Vec<String> = titles.iter().enumerate().map(|column| field(&value(column))).collect();
        text.push_str(&(fields.join(",") + "\n"));
    }
    text
}

fn odm(survey: &Survey) -> Result<String> {
    let crs = survey.crs.as_ref().expect("refused without a CRS");
    let mut text = programs::odm_crs(crs).ok_or_else(|| {
        Error::usage(format!("OpenDroneMap's list cannot hold the CRS {}", crs.title()), "give --crs with an EPSG code")
    })?;
    text.push('\n');
    let seen = survey.points.iter().any(|p| !p.pixels.is_empty());
    for point in &survey.points {
        let gcp = &point.gcp;
        if !seen {
            let height = gcp.height.map_or(String::new(), |h| format!("\t{h}"));
            let label = csv_text(&programs::odm_label(gcp));
            text.push_str(&format!("{label}\t{}\t{}{height}\n", gcp.easting, gcp.northing));
        }
        let image = |at: &Seen| programs::odm_row(gcp, at.at, at.image.as_deref().unwrap_or("image"));
        text.extend(point.pixels.iter().map(image));
    }
    Ok(text)
}

fn qgis(survey: &Survey) -> String {
    let row =
        |point: &RawPoint| programs::qgis_row(&point.gcp, Survey::first_seen(point).map(|seen| seen.at), [0.0; 2]);
    let mut text = programs::qgis_head(survey.crs.as_ref());
    text.extend(survey.points.iter().map(row));
    text
}

fn metashape_xml(survey: &Survey) -> String {
    fn named(seen: &Seen) -> Option<(&str, PixelPoint)> {
        Some((seen.image.as_deref()?, seen.at))
    }
    let markers: Vec<Marker<'_>> = survey
        .points
        .iter()
        .map(|point| Marker { gcp: &point.gcp, seen: point.pixels.iter().filter_map(named).collect() })
        .collect();
    programs::metashape_markers(&markers, survey.crs.as_ref())
}
