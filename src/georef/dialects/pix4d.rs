//! Pix4D's pair of files, both without a header: ground control points (Pix4D's "Tie points import format") and marks
//! (`image,label,x,y`). Pixels are written as GDAL counts them.

use std::path::Path;

use super::{TiePoints, no_height, write_file};
use crate::gcp::programs;
use autoref_raster::cells::csv_text;
use autoref_raster::error::Result;

/// Writes both files. The accuracies are there when every point has both.
///
/// # Errors
/// When a file cannot be written, or a point has no height.
pub fn write(gcps: &Path, marks: &Path, tie_points: &TiePoints) -> Result<()> {
    let ground =
        programs::pix4d(tie_points.gcps(), tie_points.crs.as_ref()).map_err(|name| no_height("Pix4D", name))?;
    let image_name = csv_text(&tie_points.image_name);
    let mut image = String::new();
    for pair in &tie_points.pairs {
        image.push_str(&format!("{image_name},{},{},{}\n", csv_text(&pair.gcp.name), pair.pixel.x, pair.pixel.y));
    }
    write_file(gcps, &ground)?;
    write_file(marks, &image)
}
