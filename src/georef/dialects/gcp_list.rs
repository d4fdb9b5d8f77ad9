//! OpenDroneMap's `gcp_list.txt`: the CRS, then a row for each mark. Labels of check points begin with `CHK-`.

use std::path::Path;

use super::{TiePoints, write_file};
use crate::gcp::odm::CHECK_PREFIX;
use crate::gcp::programs;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// Writes the list.
///
/// # Errors
/// When the file cannot be written; without a CRS, which OpenDroneMap demands.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut text = header(tie_points.crs.as_ref())?;
    text.push('\n');
    let is_taken = |name: &str| name.starts_with(CHECK_PREFIX);
    if let Some(gcp) = tie_points.gcps().find(|gcp| !programs::is_check(gcp) && is_taken(&gcp.name)) {
        return Err(Error::usage(
            format!(
                "`{}` is a control point, and gcp_list.txt has check points by names with {CHECK_PREFIX}",
                gcp.name
            ),
            "rename it in the list of points, or leave gcp-list out of --write",
        ));
    }
    let row = |pair: &super::TiePoint| programs::odm_row(&pair.gcp, pair.pixel, &tie_points.image_name);
    text.extend(tie_points.pairs.iter().map(row));
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
    programs::odm_crs(crs)
        .ok_or_else(|| Error::usage(format!("OpenDroneMap's gcp_list.txt cannot hold the CRS {}", crs.title()), REMEDY))
}
