//! The formats of lists: which there are, and which a file's name says.

use std::path::Path;
use std::str::FromStr;

use autoref_raster::error::Result;

/// A format of lists.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ListFormat {
    GeoJson,
    /// A table with a header.
    Csv,
    Kof,
    /// OpenDroneMap's `gcp_list.txt`.
    Odm,
    /// The `.points` file of QGIS's Georeferencer.
    Qgis,
    /// Metashape's reference list.
    MetashapeCsv,
    /// Metashape's markers.
    MetashapeXml,
    /// `label,x,y,z[,accuracy,accuracy]` without a header.
    Pix4d,
    /// `DicoAppuisFlottant`.
    MicMac,
    GeoPackage,
    Shapefile,
    FlatGeobuf,
    Gml,
    Kml,
    Gpx,
    /// Leica's, read and never written, as all below.
    Gsi,
    /// Sokkia's.
    Sdr,
    /// RW5.
    Carlson,
    /// Japan's.
    Sima,
    /// Sweden's.
    SbgGeo,
    LandXml,
    JobXml,
    /// Read by GDAL, never written.
    OtherVector,
}

impl ListFormat {
    /// Those that can be written.
    pub const WRITTEN: [ListFormat; 15] = [
        ListFormat::GeoJson,
        ListFormat::Csv,
        ListFormat::Kof,
        ListFormat::Odm,
        ListFormat::Qgis,
        ListFormat::MetashapeCsv,
        ListFormat::MetashapeXml,
        ListFormat::Pix4d,
        ListFormat::MicMac,
        ListFormat::GeoPackage,
        ListFormat::Shapefile,
        ListFormat::FlatGeobuf,
        ListFormat::Gml,
        ListFormat::Kml,
        ListFormat::Gpx,
    ];

    /// Those of instruments and field programs, which are read only.
    const OF_INSTRUMENTS: [ListFormat; 7] = [
        ListFormat::Gsi,
        ListFormat::Sdr,
        ListFormat::Carlson,
        ListFormat::Sima,
        ListFormat::SbgGeo,
        ListFormat::LandXml,
        ListFormat::JobXml,
    ];

    /// As the command line has it.
    pub fn name(self) -> &'static str {
        match self {
            ListFormat::GeoJson => "geojson",
            ListFormat::Csv => "csv",
            ListFormat::Kof => "kof",
            ListFormat::Odm => "odm",
            ListFormat::Qgis => "qgis",
            ListFormat::MetashapeCsv => "metashape-csv",
            ListFormat::MetashapeXml => "metashape-xml",
            ListFormat::Pix4d => "pix4d",
            ListFormat::MicMac => "micmac",
            ListFormat::GeoPackage => "gpkg",
            ListFormat::Shapefile => "shp",
            ListFormat::FlatGeobuf => "fgb",
            ListFormat::Gml => "gml",
            ListFormat::Kml => "kml",
            ListFormat::Gpx => "gpx",
            ListFormat::Gsi => "gsi",
            ListFormat::Sdr => "sdr",
            ListFormat::Carlson => "rw5",
            ListFormat::Sima => "sima",
            ListFormat::SbgGeo => "geo",
            ListFormat::LandXml => "landxml",
            ListFormat::JobXml => "jobxml",
            ListFormat::OtherVector => "vector",
        }
    }

    /// For messages.
    pub fn title(self) -> &'static str {
        match self {
            ListFormat::GeoJson => "GeoJSON",
            ListFormat::Csv => "a table",
            ListFormat::Kof => "KOF",
            ListFormat::Odm => "OpenDroneMap's list",
            ListFormat::Qgis => "QGIS's .points",
            ListFormat::MetashapeCsv => "Metashape's reference list",
            ListFormat::MetashapeXml => "Metashape's XML",
            ListFormat::Pix4d => "Pix4D's list",
            ListFormat::MicMac => "MicMac's XML",
            ListFormat::GeoPackage => "GeoPackage",
            ListFormat::Shapefile => "a Shapefile",
            ListFormat::FlatGeobuf => "FlatGeobuf",
            ListFormat::Gml => "GML",
            ListFormat::Kml => "KML",
            ListFormat::Gpx => "GPX",
            ListFormat::Gsi => "Leica's GSI",
            ListFormat::Sdr => "Sokkia's SDR",
            ListFormat::Carlson => "Carlson's RW5",
            ListFormat::Sima => "Japan's SIMA",
            ListFormat::SbgGeo => "SBG GEO",
            ListFormat::LandXml => "LandXML",
            ListFormat::JobXml => "Trimble's JobXML",
            ListFormat::OtherVector => "a vector format of GDAL",
        }
    }

    /// Read and written here, not by GDAL.
    pub(super) fn is_text(self) -> bool {
        use ListFormat::{Csv, GeoJson, Kof, MetashapeCsv, MetashapeXml, MicMac, Odm, Pix4d, Qgis};
        ListFormat::OF_INSTRUMENTS.contains(&self)
            || matches!(self, GeoJson | Csv | Kof | Odm | Qgis | MetashapeCsv | MetashapeXml | Pix4d | MicMac)
    }

    /// Of a file that GDAL reads, by its name.
    pub(super) fn of_vectors(path: &Path) -> Self {
        ListFormat::of_name(path).filter(|format| !format.is_text()).unwrap_or(ListFormat::OtherVector)
    }

    /// By the name of a file that is to be written. `None` when the name leaves it open.
    pub fn of_name(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_lowercase();
        let ends = [
            ("gcp_list.txt", ListFormat::Odm),
            ("metashape.csv", ListFormat::MetashapeCsv),
            ("metashape.xml", ListFormat::MetashapeXml),
            ("pix4d-gcps.csv", ListFormat::Pix4d),
            ("pix4d.csv", ListFormat::Pix4d),
            ("appuis.xml", ListFormat::MicMac),
            (".geojson", ListFormat::GeoJson),
            (".json", ListFormat::GeoJson),
            (".csv", ListFormat::Csv),
            (".kof", ListFormat::Kof),
            (".points", ListFormat::Qgis),
            (".gpkg", ListFormat::GeoPackage),
            (".shp", ListFormat::Shapefile),
            (".fgb", ListFormat::FlatGeobuf),
            (".gml", ListFormat::Gml),
            (".kml", ListFormat::Kml),
            (".gpx", ListFormat::Gpx),
        ];
        ends.iter().find(|(end, _)| name.ends_with(end)).map(|(_, format)| *format)
    }
}

impl FromStr for ListFormat {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let name = text.to_lowercase();
        let plain = match name.as_str() {
            "json" => "geojson",
            "table" | "tsv" | "txt" => "csv",
            "gcp-list" | "gcp_list" | "opendronemap" => "odm",
            "points" => "qgis",
            "metashape" | "photoscan" => "metashape-xml",
            "geopackage" => "gpkg",
            "shapefile" => "shp",
            "flatgeobuf" => "fgb",
            "jxl" => "jobxml",
            "rw7" => "rw5",
            other => other,
        };
        let formats = || ListFormat::WRITTEN.into_iter().chain(ListFormat::OF_INSTRUMENTS);
        formats().find(|format| format.name() == plain).ok_or_else(|| {
            let names = formats().map(ListFormat::name).collect::<Vec<_>>().join(", ");
            format!("`{text}` is no format of lists; there are {names}")
        })
    }
}
