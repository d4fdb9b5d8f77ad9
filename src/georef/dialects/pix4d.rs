//! Pix4D's pair of files, both without a header: ground control points (`label,x,y,z[,accuracy,accuracy]`; Pix4D's "Tie
//! points import format") and marks (`image,label,x,y`). Pixels are written as GDAL counts them.

use std::path::Path;

use super::{TiePoints, required_height, write_file};
use autoref_raster::cells::csv_text;
use autoref_raster::error::Result;

/// Writes both files. The accuracies are there when every point has one.
///
/// # Errors
/// When a file cannot be written, or a point has no height.
pub fn write(gcps: &Path, marks: &Path, tie_points: &TiePoints) -> Result<()> {
    let (mut ground, mut image) = (String::new(), String::new());
    let all_have_sigma = tie_points.pairs.iter().all(|pair| pair.sigma_m.is_some());
    for pair in &tie_points.pairs {
        let height = required_height("Pix4D", pair)?;
        let name = csv_text(&pair.name);
        ground.push_str(&format!("{name},{},{},{height}", pair.easting, pair.northing));
        if let Some(sigma_m) = pair.sigma_m.filter(|_| all_have_sigma) {
            ground.push_str(&format!(",{sigma_m},{sigma_m}"));
        }
        ground.push('\n');
        image.push_str(&format!("{},{name},{},{}\n", csv_text(&tie_points.image_name), pair.pixel.x, pair.pixel.y));
    }
    write_file(gcps, &ground)?;
    write_file(marks, &image)
}
