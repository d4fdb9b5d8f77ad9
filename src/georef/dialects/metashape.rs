//! Agisoft Metashape's pair of files: the reference list of markers (CSV), and markers with their projections (XML,
//! "Import Markers").

use std::path::Path;

use super::{TiePoints, write_file};
use crate::gcp::programs::{self, Marker};
use autoref_raster::error::Result;

/// Writes the reference list.
///
/// # Errors
/// When the file cannot be written.
pub fn write_reference(path: &Path, tie_points: &TiePoints) -> Result<()> {
    write_file(path, &programs::metashape_reference(tie_points.gcps(), tie_points.crs.as_ref()))
}

/// Writes the markers.
///
/// # Errors
/// When the file cannot be written.
pub fn write_markers(path: &Path, tie_points: &TiePoints) -> Result<()> {
    let image = tie_points.image_name.as_str();
    let pairs = tie_points.pairs.iter();
    let markers: Vec<Marker<'_>> =
        pairs.map(|pair| Marker { gcp: &pair.gcp, seen: vec![(image, pair.pixel)] }).collect();
    write_file(path, &programs::metashape_markers(&markers, tie_points.crs.as_ref()))
}
