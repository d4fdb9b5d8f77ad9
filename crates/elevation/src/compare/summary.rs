//! What a comparison says: statistics of groups, volumes of zones.

use serde::Serialize;

use super::variogram::Variogram;

/// Statistics of a group of cells. Differences are A − B, metres.
#[derive(Clone, Debug, Serialize)]
pub struct Statistics {
    pub group: String,
    pub class: String,
    pub n: u64,
    pub mean_m: Option<f64>,
    pub median_m: Option<f64>,
    pub sd_m: Option<f64>,
    pub nmad_m: Option<f64>,
    pub rmse_m: Option<f64>,
    pub min_m: Option<f64>,
    pub max_m: Option<f64>,
    pub share_within: Option<f64>,
    /// By per cent.
    pub percentiles_m: serde_json::Map<String, serde_json::Value>,
}

/// The change of a zone.
#[derive(Clone, Debug, Serialize)]
pub struct Volume {
    pub zone: String,
    pub n: u64,
    /// Of the cells with a difference, each with the size that it has there.
    pub area_m2: f64,
    /// The volume over the area.
    pub mean_m: Option<f64>,
    pub mean_se_m: Option<f64>,
    pub effective_n: Option<f64>,
    pub volume_m3: Option<f64>,
    pub volume_se_m3: Option<f64>,
    pub volume_95_m3: Option<[f64; 2]>,
    /// Of the whole zone, and the share of it that both models cover.
    pub zone_area_m2: f64,
    pub covered_share: Option<f64>,
}

/// What `dem compare` says.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub a: String,
    pub b: String,
    /// What was subtracted from what.
    pub difference: &'static str,
    pub grid: String,
    /// Between A's cells, or `mean`: of those under each of B's.
    pub resampling: &'static str,
    pub heights: String,
    /// What a person should look at.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    pub cells: u64,
    pub common_cells: u64,
    pub within_m: f64,
    pub mean_m: Option<f64>,
    pub median_m: Option<f64>,
    pub sd_m: Option<f64>,
    pub nmad_m: Option<f64>,
    pub rmse_m: Option<f64>,
    /// Of the mean, with the correlation of neighbours.
    /// `None` where too little ground outside the zones tells how differences hang together.
    pub mean_se_m: Option<f64>,
    pub effective_n: Option<f64>,
    pub variogram: Variogram,
    pub statistics: Vec<Statistics>,
    pub volumes: Vec<Volume>,
}

pub(super) const PERCENTS: [f64; 9] = [1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 99.0];
