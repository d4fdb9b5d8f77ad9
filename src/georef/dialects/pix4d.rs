//! Pix4D's pair of files, both without a header: ground control points (`label,x,y,z[,accuracy,accuracy]`; Pix4D's "Tie
//! points import format") and marks (`image,label,x,y`). Pixels are written as GDAL counts them.

use std::path::Path;

use super::{TiePoints, required_height, write_file};
use autoref_raster::cells::csv_text;
use autoref_raster::crs::Crs;
use autoref_raster::error::Result;

/// Writes both files. The accuracies are there when every point has one.
///
/// # Errors
/// When a file cannot be written, or a point has no height.
pub fn write(gcps: &Path, marks: &Path, tie_points: &TiePoints) -> Result<()> {
    let (mut ground, mut image) = (String::new(), String::new());
    let is_degrees = tie_points.crs.as_ref().is_some_and(Crs::is_geographic);
    let all_have_sigma = tie_points.pairs.iter().all(|pair| pair.sigma_m.is_some());
    for pair in &tie_points.pairs {
        let height = required_height("Pix4D", pair)?;
        let name = csv_text(&pair.name);
        // Pix4D's rule: label, latitude, longitude; of a map X, Y.
        let [first, second] = if is_degrees { [pair.northing, pair.easting] } else { [pair.easting, pair.northing] };
        ground.push_str(&format!("{name},{first},{second},{height}"));
        if let Some(sigma_m) = pair.sigma_m.filter(|_| all_have_sigma) {
            ground.push_str(&format!(",{sigma_m},{}", pair.sigma_height_m.unwrap_or(sigma_m)));
        }
        ground.push('\n');
        image.push_str(&format!("{},{name},{},{}\n", csv_text(&tie_points.image_name), pair.pixel.x, pair.pixel.y));
    }
    write_file(gcps, &ground)?;
    write_file(marks, &image)
}
