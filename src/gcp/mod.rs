//! Reading lists of ground control points.
//!
//! ```
//! use autoref_stream::gcp::{self, GcpOptions, GcpRole};
//! let folder = tempfile::tempdir().expect("a temporary folder");
//! let file = folder.path().join("points.csv");
//! std::fs::write(&file, "Navn;Nord;Øst;role\nP1;7032516,80;570406,86;\nP2;7032503,48;570413,37;check\n").expect("writable");
//! let options = GcpOptions { crs: Some("EPSG:25832".into()), ..GcpOptions::default() };
//! let list = gcp::read(&file, &options)?;
//! assert_eq!((list.gcps[0].easting, list.gcps[0].northing), (570406.86, 7032516.80));
//! assert_eq!(list.gcps[1].role, GcpRole::Check);
//! # Ok::<(), autoref_raster::Error>(())
//! ```

mod accuracy_list;
mod angle;
mod attributes;
mod columns;
mod confidence;
pub mod convert;
mod csv_list;
mod degrees;
mod dxf;
mod elsewhere;
mod geojson;
mod headerless;
mod heights;
mod hemispheres;
mod idx;
mod image_crs;
mod instruments;
mod kof;
mod list_format;
mod marked_rows;
mod marks;
mod metres;
pub mod odm;
mod ogr;
mod options;
mod order;
mod packed;
mod place;
pub(crate) mod programs;
mod qgis;
mod raw;
mod read;
mod recognise;
mod remarks;
mod roles;
mod said_of_columns;
mod select;
mod sheet;
mod statistics;
pub(crate) mod text;
mod title_cells;
mod titled;
mod titles;
mod tracks;
pub(crate) mod units;
mod wkt;
mod working_crs;
mod xml;

pub use elsewhere::leading_digits;
pub use options::{GcpOptions, ImageGeoreference};
pub use read::{GcpList, read, settle_places};
pub use working_crs::{Delivered, Reproject, WorkingCrs};

use serde::{Deserialize, Serialize};

use autoref_raster::coords::MapPoint;

/// A surveyed point.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Gcp {
    pub name: String,
    pub easting: f64,
    pub northing: f64,
    pub height: Option<f64>,
    /// 1σ of the survey in each of easting and northing, metres.
    pub sigma_m: Option<f64>,
    /// 1σ of the height, metres.
    pub sigma_height_m: Option<f64>,
    pub role: GcpRole,
}

/// Whether a point takes part in the fit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum GcpRole {
    #[default]
    Control,
    /// Kept out of matching and fit; compared afterwards.
    Check,
}

impl Gcp {
    /// A control point without height or stated accuracy.
    pub fn control(name: impl Into<String>, easting: f64, northing: f64) -> Self {
        Gcp {
            name: name.into(),
            easting,
            northing,
            height: None,
            sigma_m: None,
            sigma_height_m: None,
            role: GcpRole::Control,
        }
    }

    /// A two-dimensional normal error is longer than so many of its deviations once in 1,400 times.
    pub const REACH: f64 = 3.8;

    /// How far from its listed place a mark may lie by the stated accuracy alone, metres; 0 where none is stated.
    pub fn reach_m(&self) -> f64 {
        self.sigma_m.map_or(0.0, |sigma_m| Self::REACH * sigma_m)
    }

    /// Where it lies in plan.
    pub fn position(&self) -> MapPoint {
        MapPoint { easting: self.easting, northing: self.northing }
    }
}
