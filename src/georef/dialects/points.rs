//! The `.points` file of QGIS's Georeferencer. Check points are switched off.

use std::path::Path;

use super::{TiePoint, TiePoints, write_file};
use crate::gcp::programs;
use autoref_raster::error::Result;

/// Writes the file; dX, dY and the residual are in pixels, where the surveyed point lies minus the mark.
///
/// # Errors
/// When the file cannot be written.
pub fn write(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let off_px = |pair: &TiePoint| {
        let surveyed = tie_points.transform.and_then(|transform| transform.invert(pair.gcp.position()));
        surveyed.map_or([0.0; 2], |at| [at.x - pair.pixel.x, pair.pixel.y - at.y])
    };
    let mut text = programs::qgis_head(tie_points.crs.as_ref());
    text.extend(tie_points.pairs.iter().map(|pair| programs::qgis_row(&pair.gcp, Some(pair.pixel), off_px(pair))));
    write_file(path, &text)
}
