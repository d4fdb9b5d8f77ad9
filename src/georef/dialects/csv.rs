//! The tie points as a table with a header, in our own pixel convention; `--gcps` reads it back.

use std::path::Path;

use super::{TiePoints, write_file};
use crate::gcp::programs::{optional, role};
use autoref_raster::cells::csv_text;
use autoref_raster::error::Result;

/// Writes the table. Columns: `name`, `pixel_x`, `pixel_y`, `easting`, `northing`, `height`, `sigma_m`,
/// `sigma_height_m`, `residual_e_m`, `residual_n_m`, `role` ("control" or "check"), `crs`.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut text = String::from(
        "name,pixel_x,pixel_y,easting,northing,height,sigma_m,sigma_height_m,residual_e_m,residual_n_m,role,crs\n",
    );
    let crs = tie_points.crs.as_ref().map(|crs| csv_text(&crs.label())).unwrap_or_default();
    for pair in &tie_points.pairs {
        let gcp = &pair.gcp;
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{},{},{},{crs}\n",
            csv_text(&gcp.name),
            pair.pixel.x,
            pair.pixel.y,
            gcp.easting,
            gcp.northing,
            optional(gcp.height),
            optional(gcp.sigma_m),
            optional(gcp.sigma_height_m),
            pair.residual_e_m,
            pair.residual_n_m,
            role(gcp),
        ));
    }
    write_file(path, &text)
}
