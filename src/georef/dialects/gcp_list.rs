//! OpenDroneMap's `gcp_list.txt`: the CRS, then `geo_x geo_y geo_z im_x im_y image label`, cut by tabs.
//!
//! Its pixels count from the **centre** of the first pixel: OpenSfM, which reads them, adds 0.5 before anything else
//! (`normalized_image_coordinates`), so that 0.5 is taken off here. A height that is not known is `NaN`, as
//! OpenDroneMap's manual has it. Labels of check points begin with `CHK-`.

use std::path::Path;

use super::{TiePoints, write_file};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

use crate::gcp::odm::CHECK_PREFIX;

/// Writes the list.
///
/// # Errors
/// When the file cannot be written; without a CRS, which OpenDroneMap demands.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut text = header(tie_points.crs.as_ref())?;
    text.push('\n');
    if let Some(pair) = tie_points.pairs.iter().find(|pair| !pair.check && pair.name.starts_with(CHECK_PREFIX)) {
        return Err(Error::usage(
            format!(
                "`{}` is a control point, and gcp_list.txt has check points by names with {CHECK_PREFIX}",
                pair.name
            ),
            "rename it in the list of points, or leave gcp-list out of --write",
        ));
    }
    for pair in &tie_points.pairs {
        text.push_str(&format!(
            "{}\t{}\t{}\t{}\t{}\t{}\t{}{}\n",
            pair.easting,
            pair.northing,
            pair.height.unwrap_or(f64::NAN),
            pair.pixel.x - 0.5,
            pair.pixel.y - 0.5,
            tie_points.image_name,
            if pair.check { CHECK_PREFIX } else { "" },
            pair.name
        ));
    }
    write_file(path, &text)
}

/// The EPSG code, else a PROJ string.
///
/// # Errors
/// When there is no CRS, or none that a PROJ string can hold.
pub(super) fn header(crs: Option<&Crs>) -> Result<String> {
    const REMEDY: &str = "give --crs with an EPSG code, or leave gcp-list out of --write";
    let Some(crs) = crs else {
        return Err(Error::usage("OpenDroneMap's gcp_list.txt needs a CRS, and the points have none", REMEDY));
    };
    crs.epsg().map(|code| Ok(format!("EPSG:{code}"))).unwrap_or_else(|| {
        crs.proj_string().ok_or_else(|| {
            Error::usage(format!("OpenDroneMap's gcp_list.txt cannot hold the CRS {}", crs.title()), REMEDY)
        })
    })
}
