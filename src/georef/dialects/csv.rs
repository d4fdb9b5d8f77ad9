//! The tie points as a table with a header, in our own pixel convention; `--gcps` reads it back.

use std::path::Path;

use super::{TiePoints, write_file};
use autoref_raster::cells::csv_text;
use autoref_raster::error::Result;

/// Writes the table. Columns: `name`, `pixel_x`, `pixel_y`, `easting`, `northing`, `height`, `sigma_m`, `residual_e_m`,
/// `residual_n_m`, `role` ("control" or "check"), `crs`.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut text =
        String::from("name,pixel_x,pixel_y,easting,northing,height,sigma_m,residual_e_m,residual_n_m,role,crs\n");
    let optional = |value: Option<f64>| value.map_or(String::new(), |v| v.to_string());
    let crs = tie_points.crs.as_ref().map(|crs| csv_text(&crs.label())).unwrap_or_default();
    for pair in &tie_points.pairs {
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{},{},{crs}\n",
            csv_text(&pair.name),
            pair.pixel.x,
            pair.pixel.y,
            pair.easting,
            pair.northing,
            optional(pair.height),
            optional(pair.sigma_m),
            pair.residual_e_m,
            pair.residual_n_m,
            if pair.check { "check" } else { "control" },
        ));
    }
    write_file(path, &text)
}
