//! Lists as text.

use std::collections::{HashMap, HashSet};

use quick_xml::escape::{escape, partial_escape};
use serde_json::{Map, Value, json};

use super::losses::{KOF_NAME, all_or_none, extra, has_a_meaning};
use super::{ListFormat, Survey};
use crate::gcp::odm::{CHECK_PREFIX, is_crs_line};
use crate::gcp::{Gcp, GcpRole};
use autoref_raster::cells::{csv_text, quoted};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// What MicMac's own tools write where nothing is known, metres.
const UNKNOWN_SIGMA_M: f64 = 1.0;

pub(super) fn write(survey: &Survey, format: ListFormat) -> Result<String> {
    Ok(match format {
        ListFormat::GeoJson => geojson(survey),
        ListFormat::Kof => kof(survey),
        ListFormat::Odm => odm(survey)?,
        ListFormat::Qgis => qgis(survey),
        ListFormat::MetashapeCsv => metashape_csv(survey),
        ListFormat::MetashapeXml => metashape_xml(survey),
        ListFormat::Pix4d => pix4d(survey),
        ListFormat::MicMac => micmac(survey),
        _ => csv(survey),
    })
}

/// A field of a table: numbers as they are, texts never a formula.
fn field(text: &str) -> String {
    if text.parse::<f64>().is_ok() { quoted(text) } else { csv_text(text) }
}

fn optional(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

fn is_check(gcp: &Gcp) -> bool {
    gcp.role == GcpRole::Check
}

fn role(gcp: &Gcp) -> &'static str {
    if is_check(gcp) { "check" } else { "control" }
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
            let seen = |s: &crate::gcp::raw::Seen| json!({"image": s.image, "x": s.at.x, "y": s.at.y});
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
        let name = crs.epsg().map_or_else(|| crs.wkt().to_string(), |code| format!("urn:ogc:def:crs:EPSG::{code}"));
        collection.insert("crs".into(), json!({"type": "name", "properties": {"name": name}}));
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

/// A number in at most so many columns, with as many of its decimals as fit. `None` when it does not fit.
pub(super) fn fitting(value: f64, width: usize) -> Option<String> {
    let exact = value.to_string();
    if exact.len() <= width {
        return Some(exact);
    }
    (0..width).rev().map(|decimals| format!("{value:.decimals$}")).find(|text| text.len() <= width)
}

/// Records "05" in the columns of the specification: name 5–14, northing 25–36, easting 38–48, height 50–57.
fn kof(survey: &Survey) -> String {
    let mut text = String::from(" 00 Oppdrag      Dato     Ver\n");
    for gcp in survey.gcps() {
        let name: String = gcp.name.chars().take(KOF_NAME).collect();
        let number = |value: f64, width: usize| fitting(value, width).unwrap_or_default();
        let height = gcp.height.map_or(String::new(), |h| number(h, 8));
        let row = format!(
            " 05 {name:<10}          {:>12} {:>11} {height:>8}",
            number(gcp.northing, 12),
            number(gcp.easting, 11)
        );
        text.push_str(&(row.trim_end().to_owned() + "\n"));
    }
    text
}

fn odm(survey: &Survey) -> Result<String> {
    let crs = survey.crs.as_ref().expect("refused without a CRS");
    let header = match crs.epsg() {
        Some(code) => format!("EPSG:{code}"),
        None => crs.proj_string().ok_or_else(|| {
            Error::usage(
                format!("OpenDroneMap's list cannot hold the CRS {}", crs.title()),
                "give --crs with an EPSG code",
            )
        })?,
    };
    let mut text = header + "\n";
    let seen = survey.points.iter().any(|p| !p.pixels.is_empty());
    for point in &survey.points {
        let gcp = &point.gcp;
        let label = format!("{}{}", if is_check(gcp) { CHECK_PREFIX } else { "" }, gcp.name);
        if !seen {
            let height = gcp.height.map_or(String::new(), |h| format!("\t{h}"));
            text.push_str(&format!("{}\t{}\t{}{height}\n", csv_text(&label), gcp.easting, gcp.northing));
        }
        for at in &point.pixels {
            text.push_str(&format!(
                "{}\t{}\t{}\t{}\t{}\t{}\t{label}\n",
                gcp.easting,
                gcp.northing,
                gcp.height.unwrap_or(f64::NAN),
                at.at.x - 0.5,
                at.at.y - 0.5,
                at.image.as_deref().unwrap_or("image")
            ));
        }
    }
    Ok(text)
}

/// Check points and points without pixels are switched off, so that QGIS does not use them.
fn qgis(survey: &Survey) -> String {
    let mut text = survey.crs.as_ref().map_or(String::new(), |crs| format!("#CRS: {}\n", crs.wkt()));
    text.push_str("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual,name,role\n");
    for point in &survey.points {
        let gcp = &point.gcp;
        let at = Survey::first_seen(point);
        let source = at.map_or(",".to_owned(), |s| format!("{},{}", s.at.x, -s.at.y));
        let enable = u8::from(at.is_some() && !is_check(gcp));
        text.push_str(&format!(
            "{},{},{source},{enable},0,0,0,{},{}\n",
            gcp.easting,
            gcp.northing,
            quoted(&gcp.name),
            role(gcp)
        ));
    }
    text
}

fn metashape_csv(survey: &Survey) -> String {
    let mut text = survey.crs.as_ref().map_or(String::new(), |crs| format!("#CoordinateSystem: {}\n", crs.wkt()));
    text.push_str("#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m),Enabled\n");
    for gcp in survey.gcps() {
        text.push_str(&format!(
            "{},{},{},{},{},{}\n",
            csv_text(&gcp.name),
            gcp.easting,
            gcp.northing,
            optional(gcp.height),
            optional(gcp.sigma_m),
            u8::from(!is_check(gcp))
        ));
    }
    text
}

fn metashape_xml(survey: &Survey) -> String {
    let mut text =
        String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.2.0\">\n  <chunk>\n");
    let mut cameras: Vec<&str> = Vec::new();
    let mut numbers: HashMap<&str, usize> = HashMap::new();
    let mut locations = String::new();
    for (id, point) in survey.points.iter().enumerate() {
        let mut marker = String::new();
        for seen in &point.pixels {
            let Some(image) = seen.image.as_deref() else { continue };
            let camera = *numbers.entry(image).or_insert_with(|| {
                cameras.push(image);
                cameras.len() - 1
            });
            marker.push_str(&format!(
                "            <location camera_id=\"{camera}\" pinned=\"true\" x=\"{}\" y=\"{}\"/>\n",
                seen.at.x, seen.at.y
            ));
        }
        if !marker.is_empty() {
            locations.push_str(&format!("          <marker marker_id=\"{id}\">\n{marker}          </marker>\n"));
        }
    }
    if !cameras.is_empty() {
        text.push_str("    <cameras>\n");
        for (id, name) in cameras.iter().enumerate() {
            text.push_str(&format!("      <camera id=\"{id}\" label=\"{}\"/>\n", escape(*name)));
        }
        text.push_str("    </cameras>\n");
    }
    text.push_str("    <markers>\n");
    for (id, gcp) in survey.gcps().enumerate() {
        let height = gcp.height.map_or(String::new(), |z| format!(" z=\"{z}\""));
        let sigma = gcp.sigma_m.map_or(String::new(), |s| format!(" sx=\"{s}\" sy=\"{s}\""));
        let sigma_height = gcp.sigma_height_m.map_or(String::new(), |s| format!(" sz=\"{s}\""));
        text.push_str(&format!(
            "      <marker id=\"{id}\" label=\"{}\">\n        <reference x=\"{}\" y=\"{}\"{height}{sigma}{sigma_height} \
             enabled=\"{}\"/>\n      </marker>\n",
            escape(gcp.name.as_str()),
            gcp.easting,
            gcp.northing,
            !is_check(gcp)
        ));
    }
    text.push_str("    </markers>\n");
    if !locations.is_empty() {
        text.push_str(&format!(
            "    <frames>\n      <frame id=\"0\">\n        <markers>\n{locations}        </markers>\n      </frame>\n    </frames>\n"
        ));
    }
    if let Some(crs) = &survey.crs {
        text.push_str(&format!("    <reference>{}</reference>\n", partial_escape(crs.wkt())));
    }
    text + "  </chunk>\n</document>\n"
}

fn pix4d(survey: &Survey) -> String {
    let accuracies = all_or_none(survey, ListFormat::Pix4d);
    let is_degrees = survey.crs.as_ref().is_some_and(Crs::is_geographic);
    let mut text = String::new();
    for gcp in survey.gcps() {
        let height = gcp.height.expect("refused without a height");
        // A first line that begins as a CRS does would be one.
        let name = match csv_text(&gcp.name) {
            name if is_crs_line(&name) => format!("\"{name}\""),
            name => name,
        };
        // Pix4D's rule: label, latitude, longitude; of a map X, Y.
        let [first, second] = if is_degrees { [gcp.northing, gcp.easting] } else { [gcp.easting, gcp.northing] };
        text.push_str(&format!("{name},{first},{second},{height}"));
        if let (true, Some(sigma), Some(sigma_height)) = (accuracies, gcp.sigma_m, gcp.sigma_height_m) {
            text.push_str(&format!(",{sigma},{sigma_height}"));
        }
        text.push('\n');
    }
    text
}

fn micmac(survey: &Survey) -> String {
    let mut text = String::from("<?xml version=\"1.0\" ?>\n<DicoAppuisFlottant>\n");
    for gcp in survey.gcps() {
        let height = gcp.height.expect("refused without a height");
        let sigma = gcp.sigma_m.unwrap_or(UNKNOWN_SIGMA_M);
        let sigma_height = gcp.sigma_height_m.unwrap_or(UNKNOWN_SIGMA_M);
        text.push_str(&format!(
            "     <OneAppuisDAF>\n          <Pt>{} {} {height}</Pt>\n          <NamePt>{}</NamePt>\n          \
             <Incertitude>{sigma} {sigma} {sigma_height}</Incertitude>\n     </OneAppuisDAF>\n",
            gcp.easting,
            gcp.northing,
            escape(gcp.name.as_str())
        ));
    }
    text + "</DicoAppuisFlottant>\n"
}
