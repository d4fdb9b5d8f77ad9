//! The kinds of outputs, as the command line names them.

use std::fmt;
use std::str::FromStr;

/// One kind of output: `--write KIND,…`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    World,
    Aux,
    Vrt,
    Tags,
    Warp,
    Exif,
    Gcps,
    Points,
    GcpList,
    GeoJson,
    Csv,
    MicMac,
    Metashape,
    Pix4d,
}

impl Output {
    /// All of them, in the order in which they are written.
    pub const ALL: [Output; 14] = [
        Output::World,
        Output::Aux,
        Output::Vrt,
        Output::Tags,
        Output::Warp,
        Output::Exif,
        Output::Gcps,
        Output::Points,
        Output::GcpList,
        Output::GeoJson,
        Output::Csv,
        Output::MicMac,
        Output::Metashape,
        Output::Pix4d,
    ];

    /// As the command line names it.
    pub fn name(self) -> &'static str {
        match self {
            Output::World => "world",
            Output::Aux => "aux",
            Output::Vrt => "vrt",
            Output::Tags => "tags",
            Output::Warp => "warp",
            Output::Exif => "exif",
            Output::Gcps => "gcps",
            Output::Points => "points",
            Output::GcpList => "gcp-list",
            Output::GeoJson => "geojson",
            Output::Csv => "csv",
            Output::MicMac => "micmac",
            Output::Metashape => "metashape",
            Output::Pix4d => "pix4d",
        }
    }

    /// One line for the help.
    pub fn describe(self) -> &'static str {
        match self {
            Output::World => "world file (no CRS)",
            Output::Aux => "GDAL's .aux.xml: transform and CRS",
            Output::Vrt => "GDAL virtual raster with transform and CRS",
            Output::Tags => "GeoTIFF tags in the image itself; `autoref-stream undo` takes them back",
            Output::Warp => "north-up Cloud Optimized GeoTIFF",
            Output::Exif => "copy of a JPEG with place, direction and transform in its EXIF",
            Output::Gcps => "GDAL virtual raster with the tie points",
            Output::Points => "QGIS Georeferencer .points",
            Output::GcpList => "OpenDroneMap gcp_list.txt",
            Output::GeoJson => "marks, GCPs and residuals as GeoJSON",
            Output::Csv => "tie points as CSV",
            Output::MicMac => "MicMac appuis and mesures XML",
            Output::Metashape => "Agisoft Metashape markers",
            Output::Pix4d => "Pix4D GCPs and marks",
        }
    }
}

impl fmt::Display for Output {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Output {
    type Err = String;
    fn from_str(text: &str) -> std::result::Result<Self, String> {
        Output::ALL.into_iter().find(|kind| kind.name().eq_ignore_ascii_case(text.trim())).ok_or_else(|| {
            let names: Vec<&str> = Output::ALL.iter().map(|kind| kind.name()).collect();
            format!("`{text}` is no kind of output; choose from {}", names.join(", "))
        })
    }
}
