//! Reading lists of ground control points.

mod accuracy_list;
mod csv_list;
mod geojson;
mod kof;
mod read;

pub use read::{GcpList, GcpOptions, read};

use serde::{Deserialize, Serialize};

use crate::coords::MapPoint;

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

    pub fn position(&self) -> MapPoint {
        MapPoint { easting: self.easting, northing: self.northing }
    }
}
