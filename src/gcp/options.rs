//! What the caller says about a list.

use std::path::PathBuf;

use crate::gcp::working_crs::Reproject;
use autoref_raster::coords::GeoTransform;
use autoref_raster::crs::DEFAULT_DATUM_ACCURACY_M;

/// What the caller says about the list.
#[derive(Clone, Debug)]
pub struct GcpOptions {
    /// CRS of the coordinates, overriding what the file says; `local` for local metres.
    pub crs: Option<String>,
    /// CRS to bring them, or the result, into.
    pub to_crs: Option<String>,
    pub reproject: Reproject,
    /// Worst accuracy of a change of datum that is taken, metres.
    pub datum_accuracy_m: f64,
    /// Layer of a file with several.
    pub layer: Option<String>,
    /// Use only these points: names, patterns with `*` and `?`, or `COLUMN=PATTERN`.
    pub names: Vec<String>,
    /// Keep these out of the fit, in the same words.
    pub check: Vec<String>,
    /// What the image says of itself, for lists that name no CRS.
    pub image: Option<ImageGeoreference>,
    /// A table of the survey's errors, point by point.
    pub accuracy: Option<PathBuf>,
    /// Exchange easting and northing where all points show that they are exchanged; else that is an error.
    pub fix_axes: bool,
    /// Keep points outside the CRS's area of use, which are set aside otherwise.
    pub keep_outside: bool,
}

impl Default for GcpOptions {
    fn default() -> Self {
        GcpOptions {
            crs: None,
            to_crs: None,
            reproject: Reproject::Before,
            datum_accuracy_m: DEFAULT_DATUM_ACCURACY_M,
            layer: None,
            names: Vec::new(),
            check: Vec::new(),
            image: None,
            accuracy: None,
            fix_axes: false,
            keep_outside: false,
        }
    }
}

/// A georeference that the image already has.
#[derive(Clone, Debug)]
pub struct ImageGeoreference {
    pub crs_wkt: String,
    /// `None` when it does not say where it lies.
    pub transform: Option<GeoTransform>,
    pub size_px: (u64, u64),
}
