//! Lists of GCPs as other programs read them, whoever writes them: `gcps convert`, and `--write` with the marks.
//!
//! Numbers are written in the shortest form that reads back to the same double.

use quick_xml::escape::{escape, partial_escape};
use serde_json::{Value, json};

use super::odm::{CHECK_PREFIX, is_crs_line};
use super::units::{accuracy_units, tidied};
use super::{Gcp, GcpRole};
use autoref_raster::cells::{csv_text, quoted};
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;

/// What MicMac's own tools write where the survey says nothing, in the unit of the coordinates.
const UNKNOWN_SIGMA: f64 = 1.0;

/// The accuracies of a point in such a list.
fn accuracies(gcp: &Gcp, crs: Option<&Crs>) -> (Option<f64>, Option<f64>) {
    let (unit, height_unit) = accuracy_units(crs);
    let by = |sigma_m: f64, unit: f64| if unit == 1.0 { sigma_m } else { tidied(sigma_m / unit) };
    (gcp.sigma_m.map(|s| by(s, unit)), gcp.sigma_height_m.map(|s| by(s, height_unit)))
}

/// The name of a point whose height a program demands and the list does not have.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct NoHeight(pub String);

fn height(gcp: &Gcp) -> Result<f64, NoHeight> {
    gcp.height.ok_or_else(|| NoHeight(gcp.name.clone()))
}

pub(crate) fn optional(value: Option<f64>) -> String {
    value.map_or(String::new(), |v| v.to_string())
}

pub(crate) fn is_check(gcp: &Gcp) -> bool {
    gcp.role == GcpRole::Check
}

pub(crate) fn role(gcp: &Gcp) -> &'static str {
    if is_check(gcp) { "check" } else { "control" }
}

/// The `crs` member of GeoJSON's format of 2008, which GDAL and QGIS follow.
pub(crate) fn geojson_crs(crs: &Crs) -> Value {
    let name = crs.epsg().map_or_else(|| crs.wkt().to_string(), |code| format!("urn:ogc:def:crs:EPSG::{code}"));
    json!({"type": "name", "properties": {"name": name}})
}

/// The first line of OpenDroneMap's list: the EPSG code, else a PROJ string. `None` when no PROJ string holds the CRS.
pub(crate) fn odm_crs(crs: &Crs) -> Option<String> {
    crs.epsg().map(|code| format!("EPSG:{code}")).or_else(|| crs.proj_string())
}

/// The name of a point in OpenDroneMap's list.
pub(crate) fn odm_label(gcp: &Gcp) -> String {
    format!("{}{}", if is_check(gcp) { CHECK_PREFIX } else { "" }, gcp.name)
}

/// A row of OpenDroneMap's list: `geo_x geo_y geo_z im_x im_y image label`, cut by tabs.
///
/// Its pixels count from the **centre** of the first pixel: OpenSfM, which reads them, adds 0.5 before anything else
/// (`normalized_image_coordinates`), so that 0.5 is taken off here. A height that is not known is `NaN`, as
/// OpenDroneMap's manual has it.
pub(crate) fn odm_row(gcp: &Gcp, pixel: PixelPoint, image: &str) -> String {
    let height = gcp.height.unwrap_or(f64::NAN);
    let (x, y) = (pixel.x - 0.5, pixel.y - 0.5);
    format!("{}\t{}\t{height}\t{x}\t{y}\t{image}\t{}\n", gcp.easting, gcp.northing, odm_label(gcp))
}

/// What QGIS's `.points` begin with, as `QgsGCPList::saveGcps` has it, and columns that it passes over: name and role.
pub(crate) fn qgis_head(crs: Option<&Crs>) -> String {
    let crs = crs.map_or(String::new(), |crs| format!("#CRS: {}\n", crs.wkt()));
    crs + "mapX,mapY,sourceX,sourceY,enable,dX,dY,residual,name,role\n"
}

/// A row of QGIS's `.points`. Source coordinates count from the outer corner of the first pixel, y upwards, so that
/// they are (x, −y); `off_px` is where the surveyed point lies minus the mark, the same way. Check points and points
/// without pixels are switched off.
pub(crate) fn qgis_row(gcp: &Gcp, pixel: Option<PixelPoint>, off_px: [f64; 2]) -> String {
    let source = pixel.map_or(",".to_owned(), |at| format!("{},{}", at.x, -at.y));
    let enable = u8::from(pixel.is_some() && !is_check(gcp));
    let [dx, dy] = off_px;
    let (easting, northing, length, name) = (gcp.easting, gcp.northing, dx.hypot(dy), quoted(&gcp.name));
    format!("{easting},{northing},{source},{enable},{dx},{dy},{length},{name},{}\n", role(gcp))
}

/// Metashape's reference list. Check points are switched off, which is what makes a marker a check point there.
pub(crate) fn metashape_reference<'a>(gcps: impl Iterator<Item = &'a Gcp>, crs: Option<&Crs>) -> String {
    let mut text = crs.map_or(String::new(), |crs| format!("#CoordinateSystem: {}\n", crs.wkt()));
    text.push_str("#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m),Enabled\n");
    for gcp in gcps {
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

/// A marker of Metashape's: the point, and the images that it is seen in with its place there. The centre of the first
/// pixel is (0.5, 0.5).
pub(crate) struct Marker<'a> {
    pub gcp: &'a Gcp,
    pub seen: Vec<(&'a str, PixelPoint)>,
}

/// Metashape's XML of markers ("Import Markers"): a projection belongs to a camera, which Metashape finds by its
/// label, the image's name.
pub(crate) fn metashape_markers(markers: &[Marker<'_>], crs: Option<&Crs>) -> String {
    let mut text =
        String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.2.0\">\n  <chunk>\n");
    let mut cameras: Vec<&str> = Vec::new();
    let mut locations = String::new();
    let mut numbers = std::collections::HashMap::new();
    for (id, marker) in markers.iter().enumerate().filter(|(_, marker)| !marker.seen.is_empty()) {
        locations.push_str(&format!("          <marker marker_id=\"{id}\">\n"));
        for &(image, at) in &marker.seen {
            let camera = *numbers.entry(image).or_insert_with(|| {
                cameras.push(image);
                cameras.len() - 1
            });
            locations.push_str(&format!(
                "            <location camera_id=\"{camera}\" pinned=\"true\" x=\"{}\" y=\"{}\"/>\n",
                at.x, at.y
            ));
        }
        locations.push_str("          </marker>\n");
    }
    if !cameras.is_empty() {
        let camera = |(id, name): (usize, &&str)| format!("      <camera id=\"{id}\" label=\"{}\"/>\n", escape(*name));
        text.push_str("    <cameras>\n");
        text.extend(cameras.iter().enumerate().map(camera));
        text.push_str("    </cameras>\n");
    }
    text.push_str("    <markers>\n");
    text.extend(markers.iter().enumerate().map(|(id, marker)| metashape_marker(id, marker.gcp)));
    text.push_str("    </markers>\n");
    if !locations.is_empty() {
        text.push_str(&format!(
            "    <frames>\n      <frame id=\"0\">\n        <markers>\n{locations}        </markers>\n      </frame>\n    </frames>\n"
        ));
    }
    if let Some(crs) = crs {
        text.push_str(&format!("    <reference>{}</reference>\n", partial_escape(crs.wkt())));
    }
    text + "  </chunk>\n</document>\n"
}

fn metashape_marker(id: usize, gcp: &Gcp) -> String {
    let height = gcp.height.map_or(String::new(), |z| format!(" z=\"{z}\""));
    let sigma = gcp.sigma_m.map_or(String::new(), |s| format!(" sx=\"{s}\" sy=\"{s}\""));
    let sigma_height = gcp.sigma_height_m.map_or(String::new(), |s| format!(" sz=\"{s}\""));
    format!(
        "      <marker id=\"{id}\" label=\"{}\">\n        <reference x=\"{}\" y=\"{}\"{height}{sigma}{sigma_height} \
         enabled=\"{}\"/>\n      </marker>\n",
        escape(gcp.name.as_str()),
        gcp.easting,
        gcp.northing,
        !is_check(gcp)
    )
}

/// Whether the accuracies of Pix4D's list can be written: they stand in columns without titles, so that all points
/// have both, or none has any.
pub(crate) fn pix4d_has_accuracies<'a>(mut gcps: impl Iterator<Item = &'a Gcp>) -> bool {
    gcps.all(|gcp| gcp.sigma_m.is_some() && gcp.sigma_height_m.is_some())
}

/// Pix4D's list, without a header: `label,x,y,z[,accuracy,accuracy]`, all in one unit; in degrees the latitude first.
///
/// # Errors
/// When a point has no height.
pub(crate) fn pix4d<'a>(gcps: impl Iterator<Item = &'a Gcp> + Clone, crs: Option<&Crs>) -> Result<String, NoHeight> {
    let has_accuracies = pix4d_has_accuracies(gcps.clone());
    let is_degrees = crs.is_some_and(Crs::is_geographic);
    let mut text = String::new();
    for gcp in gcps {
        let height = height(gcp)?;
        // A first line that begins as a CRS does would be one.
        let name = match csv_text(&gcp.name) {
            name if is_crs_line(&name) => format!("\"{name}\""),
            name => name,
        };
        let [first, second] = if is_degrees { [gcp.northing, gcp.easting] } else { [gcp.easting, gcp.northing] };
        text.push_str(&format!("{name},{first},{second},{height}"));
        if let (true, (Some(sigma), Some(sigma_height))) = (has_accuracies, accuracies(gcp, crs)) {
            text.push_str(&format!(",{sigma},{sigma_height}"));
        }
        text.push('\n');
    }
    Ok(text)
}

/// MicMac's ground points, `DicoAppuisFlottant`, all in one unit.
///
/// # Errors
/// When a point has no height.
pub(crate) fn micmac<'a>(gcps: impl Iterator<Item = &'a Gcp>, crs: Option<&Crs>) -> Result<String, NoHeight> {
    let mut text = String::from("<?xml version=\"1.0\" ?>\n<DicoAppuisFlottant>\n");
    for gcp in gcps {
        let (sigma, sigma_height) = accuracies(gcp, crs);
        let (sigma, sigma_height) = (sigma.unwrap_or(UNKNOWN_SIGMA), sigma_height.unwrap_or(UNKNOWN_SIGMA));
        text.push_str(&format!(
            "     <OneAppuisDAF>\n          <Pt>{} {} {}</Pt>\n          <NamePt>{}</NamePt>\n          \
             <Incertitude>{sigma} {sigma} {sigma_height}</Incertitude>\n     </OneAppuisDAF>\n",
            gcp.easting,
            gcp.northing,
            height(gcp)?,
            escape(gcp.name.as_str())
        ));
    }
    Ok(text + "</DicoAppuisFlottant>\n")
}
