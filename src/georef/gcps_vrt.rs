//! Tie points as GDAL knows them: a virtual raster that refers to the image and has a list of GCPs instead of a
//! transform.
//!
//! GDAL's own writer cuts pixels to four decimals; the list is written here, so that the points come back exactly.

use std::path::Path;

use quick_xml::escape::escape;

use crate::gcp::programs::is_check;
use crate::georef::dialects::TiePoints;
use crate::georef::sidecar;
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};

/// Writes the VRT. Check points are left out, since every program that reads the list would fit through them.
///
/// # Errors
/// When there are no points, GDAL cannot open the image, or the file cannot be written.
pub fn write(image: &Path, page: usize, vrt: &Path, points: &TiePoints) -> Result<()> {
    let controls: Vec<_> = points.pairs.iter().filter(|pair| !is_check(&pair.gcp)).collect();
    if controls.is_empty() {
        return Err(Error::usage("the result holds no matched points", "choose another --write"));
    }
    sidecar::write_plain_vrt(image, page, vrt)?;
    let text = bounded::read_to_string(vrt, "a VRT", bounded::TEXT_BYTES)?;
    let mut list = String::from("  <GCPList");
    if let Some(crs) = &points.crs {
        let mapping = autoref_raster::crs::axis_mapping(crs);
        list.push_str(&format!(" Projection=\"{}\" dataAxisToSRSAxisMapping=\"{mapping}\"", escape(crs.wkt())));
    }
    list.push_str(">\n");
    for pair in controls {
        let height = pair.gcp.height.map_or(String::new(), |z| format!(" Z=\"{z}\""));
        list.push_str(&format!(
            "    <GCP Id=\"{}\" Pixel=\"{}\" Line=\"{}\" X=\"{}\" Y=\"{}\"{height} />\n",
            escape(&pair.gcp.name),
            pair.pixel.x,
            pair.pixel.y,
            pair.gcp.easting,
            pair.gcp.northing
        ));
    }
    list.push_str("  </GCPList>\n");
    // GDAL writes the root element on one line, and after it what is in no particular order.
    let Some(end) = text.find("<VRTDataset").and_then(|start| text[start..].find('>').map(|at| start + at + 1)) else {
        return Err(Error::gdal(vrt, "its VRT has no root element"));
    };
    let (head, rest) = text.split_at(end);
    std::fs::write(vrt, format!("{head}\n{list}{}", rest.trim_start_matches('\n')))
        .map_err(|e| Error::io(vrt, "write", e))
}
