//! GCPs for the scene: a plain CSV reader, a GeoJSON writer, and sets made up for the demo.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::rng::Rng;
use autoref_raster::error::{Error, Result};

/// A surveyed point. Easting and northing in metres of some projected CRS.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SynthGcp {
    pub name: String,
    pub easting: f64,
    pub northing: f64,
    pub height: Option<f64>,
}

/// Reads a CSV file with a header that names `name`, `easting`, `northing` and perhaps `height`, in any order.
///
/// # Errors
/// [`Error::Io`], or [`Error::Format`] naming the line.
pub fn read_gcp_csv(path: &Path) -> Result<Vec<SynthGcp>> {
    let text = autoref_raster::bounded::read(path, "a list of GCPs", autoref_raster::bounded::TEXT_BYTES)?;
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(text.as_slice());
    let wrong = |line: u64, what: String| Error::format(path, format!("line {line}"), what);
    let header = reader.headers().map_err(|e| wrong(1, e.to_string()))?.clone();
    let find = |name: &str| header.iter().position(|h| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(name));
    let need = |name: &str| find(name).ok_or_else(|| wrong(1, format!("the header has no column {name:?}")));
    let (name, easting, northing, height) = (need("name")?, need("easting")?, need("northing")?, find("height"));
    let mut gcps: Vec<SynthGcp> = vec![];
    for row in reader.records() {
        let row = row.map_err(|e| wrong(e.position().map_or(0, csv::Position::line), e.to_string()))?;
        let line = row.position().map_or(0, csv::Position::line);
        let number = |column: usize| -> Result<f64> {
            let text = row.get(column).unwrap_or("");
            match text.parse::<f64>() {
                Ok(value) if value.is_finite() => Ok(value),
                _ => Err(wrong(line, format!("{text:?} in column {:?} is no number", &header[column]))),
            }
        };
        let gcp = SynthGcp {
            name: row.get(name).unwrap_or("").to_string(),
            easting: number(easting)?,
            northing: number(northing)?,
            height: height.filter(|&c| !row.get(c).unwrap_or("").is_empty()).map(number).transpose()?,
        };
        if gcps.iter().any(|g| g.name == gcp.name) {
            return Err(wrong(line, format!("{:?} is listed twice", gcp.name)));
        }
        gcps.push(gcp);
    }
    Ok(gcps)
}

/// The points as a GeoJSON FeatureCollection, with the old `crs` member when an EPSG code is given.
///
/// # Errors
/// When the file cannot be written.
pub fn write_gcp_geojson(path: &Path, gcps: &[SynthGcp], epsg: Option<u32>) -> Result<()> {
    let features: Vec<_> = gcps
        .iter()
        .map(|g| {
            let mut position = vec![g.easting, g.northing];
            position.extend(g.height);
            serde_json::json!({
                "type": "Feature",
                "properties": { "name": g.name },
                "geometry": { "type": "Point", "coordinates": position },
            })
        })
        .collect();
    let mut collection = serde_json::json!({ "type": "FeatureCollection" });
    if let Some(code) = epsg {
        collection["crs"] =
            serde_json::json!({ "type": "name", "properties": { "name": format!("urn:ogc:def:crs:EPSG::{code}") } });
    }
    collection["features"] = features.into();
    let mut text = serde_json::to_vec_pretty(&collection).expect("plain numbers and strings always serialise");
    text.push(b'\n');
    autoref_raster::atomic::write(path, &text)
}

/// `n` points in an irregular pattern that fills a rectangle of `width_m` × `height_m` about a place in Trondheim
/// (EPSG:32632), named G1, G2, …, no two nearer than 0.4 of their mean spacing.
pub fn random_gcps(n: usize, width_m: f64, height_m: f64, seed: u64) -> Vec<SynthGcp> {
    let mut rng = Rng::new(seed, 1, 0);
    let mut spacing = 0.4 * (width_m * height_m / n.max(1) as f64).sqrt();
    let mut places: Vec<(f64, f64)> = vec![];
    let mut misses = 0;
    while places.len() < n {
        let p = (rng.range(0.0, width_m), rng.range(0.0, height_m));
        if places.iter().all(|q| (p.0 - q.0).hypot(p.1 - q.1) >= spacing) {
            places.push(p);
        } else {
            // Long thin rectangles cannot hold points so far apart: ask for less rather than try for ever.
            misses += 1;
            if misses % 1000 == 0 {
                spacing *= 0.8;
            }
        }
    }
    let round = |v: f64| (v * 1000.0).round() / 1000.0;
    places
        .iter()
        .enumerate()
        .map(|(i, (e, n))| SynthGcp {
            name: format!("G{}", i + 1),
            easting: round(570_200.0 - width_m / 2.0 + e),
            northing: round(7_032_500.0 - height_m / 2.0 + n),
            height: Some(round(rng.range(74.0, 82.0))),
        })
        .collect()
}
