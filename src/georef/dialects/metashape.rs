//! Agisoft Metashape's pair of files: the reference list of markers (CSV), and markers with their projections (XML,
//! "Import Markers"). The centre of the first pixel is (0.5, 0.5) there too. Check points are switched off, which is
//! what makes a marker a check point in Metashape.

use std::path::Path;

use quick_xml::escape::escape;

use super::{TiePoints, write_file};
use autoref_raster::cells::csv_text;
use autoref_raster::error::Result;

/// Writes both files.
///
/// # Errors
/// When a file cannot be written.
pub fn write(reference: &Path, markers: &Path, tie_points: &TiePoints) -> Result<()> {
    write_file(reference, &reference_list(tie_points))?;
    write_file(markers, &marker_document(tie_points))
}

fn reference_list(tie_points: &TiePoints) -> String {
    let mut text = String::new();
    if let Some(crs) = &tie_points.crs {
        text.push_str(&format!("#CoordinateSystem: {}\n", crs.wkt()));
    }
    text.push_str("#Label,X/Easting,Y/Northing,Z/Altitude,Accuracy_(m),Enabled\n");
    let optional = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
    for pair in &tie_points.pairs {
        text.push_str(&format!(
            "{},{},{},{},{},{}\n",
            csv_text(&pair.name),
            pair.easting,
            pair.northing,
            optional(pair.height),
            optional(pair.sigma_m),
            u8::from(!pair.check)
        ));
    }
    text
}

fn marker_document(tie_points: &TiePoints) -> String {
    let mut text =
        String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<document version=\"1.2.0\">\n  <chunk>\n");
    // Projections belong to a camera; Metashape finds it by its label, the image's name.
    text.push_str(&format!(
        "    <cameras>\n      <camera id=\"0\" label=\"{}\"/>\n    </cameras>\n    <markers>\n",
        escape(tie_points.image_name.as_str())
    ));
    for (id, pair) in tie_points.pairs.iter().enumerate() {
        let height = pair.height.map_or(String::new(), |z| format!(" z=\"{z}\""));
        let mut sigma = pair.sigma_m.map_or(String::new(), |s| format!(" sx=\"{s}\" sy=\"{s}\""));
        sigma += &pair.sigma_height_m.map_or(String::new(), |s| format!(" sz=\"{s}\""));
        text.push_str(&format!(
            "      <marker id=\"{id}\" label=\"{}\">\n        <reference x=\"{}\" y=\"{}\"{height}{sigma} enabled=\"{}\"/>\n      \
             </marker>\n",
            escape(pair.name.as_str()),
            pair.easting,
            pair.northing,
            !pair.check
        ));
    }
    text.push_str("    </markers>\n    <frames>\n      <frame id=\"0\">\n        <markers>\n");
    for (id, pair) in tie_points.pairs.iter().enumerate() {
        text.push_str(&format!(
            "          <marker marker_id=\"{id}\">\n            <location camera_id=\"0\" pinned=\"true\" x=\"{}\" y=\"{}\"/>\n          \
             </marker>\n",
            pair.pixel.x, pair.pixel.y
        ));
    }
    text.push_str("        </markers>\n      </frame>\n    </frames>\n");
    if let Some(crs) = &tie_points.crs {
        text.push_str(&format!("    <reference>{}</reference>\n", escape(crs.wkt())));
    }
    text.push_str("  </chunk>\n</document>\n");
    text
}
