//! The `.points` file of QGIS's Georeferencer, as `QgsGCPList::saveGcps` writes it: source coordinates count from the
//! outer corner of the first pixel, y upwards, so that they are (x, −y). Check points are switched off (`enable` 0). A
//! last column, which QGIS passes over, keeps the names.

use std::path::Path;

use super::{TiePoints, write_file};
use autoref_raster::cells::quoted;
use autoref_raster::coords::MapPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::Result;

/// Writes the file; dX, dY and the residual are in pixels, where the surveyed point lies minus the mark.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let mut text = String::new();
    if let Some(crs) = &tie_points.crs {
        text.push_str(&format!("#CRS: {}\n", Crs::wkt(crs)));
    }
    text.push_str("mapX,mapY,sourceX,sourceY,enable,dX,dY,residual,name\n");
    for pair in &tie_points.pairs {
        let surveyed = MapPoint { easting: pair.easting, northing: pair.northing };
        let (dx, dy) = tie_points
            .transform
            .and_then(|transform| transform.invert(surveyed))
            .map_or((0.0, 0.0), |pixel| (pixel.x - pair.pixel.x, pair.pixel.y - pixel.y));
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{}\n",
            pair.easting,
            pair.northing,
            pair.pixel.x,
            -pair.pixel.y,
            u8::from(!pair.check),
            dx,
            dy,
            dx.hypot(dy),
            quoted(&pair.name)
        ));
    }
    write_file(path, &text)
}
