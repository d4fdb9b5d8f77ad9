//! The transform that `--model` or `--solver` asked for.

use autoref_raster::coords::GeoTransform;
use serde::{Deserialize, Serialize};

/// A transform beside the weighted similarity, or in its place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "model")]
pub enum ChosenModel {
    /// Written in place of the similarity.
    #[serde(rename = "affine")]
    Affine(PlanarModel),
    /// Reported beside it: no geotransform holds a projective transform.
    #[serde(rename = "projective")]
    Projective(PlanarModel),
    /// The similarity by a solver to which every point counts alike; written in place of the weighted one.
    #[serde(rename = "similarity")]
    Similarity(SimilarityModel),
    /// In space, reported beside the similarity.
    #[serde(rename = "7-parameter")]
    SevenParameter(SpatialModel),
}

/// A planar transform by least squares. Residuals are surveyed − computed, metres east and north, in the order of the
/// result's matches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanarModel {
    /// (x, y, 1) in pixels to (easting, northing, w).
    pub matrix: [[f64; 3]; 3],
    pub rmse_m: f64,
    /// With every point computed by a fit to the others; `None` when one cannot be left out.
    pub leave_one_out_rmse_m: Option<f64>,
    pub similarity_rmse_m: Option<f64>,
    pub residuals_m: Vec<[f64; 2]>,
    pub leave_one_out_m: Option<Vec<[f64; 2]>>,
}

/// A similarity by another solver than the weighted one; residuals as in [`PlanarModel`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SimilarityModel {
    pub solver: Solver,
    pub matrix: [[f64; 3]; 3],
    pub scale_m_per_px: f64,
    /// Anticlockwise from east.
    pub rotation_deg: f64,
    pub rmse_m: f64,
    /// Of a coordinate, where the solver has one.
    pub sigma0_m: Option<f64>,
    pub similarity_rmse_m: Option<f64>,
    pub residuals_m: Vec<[f64; 2]>,
    /// `None` when one cannot be left out.
    #[serde(default)]
    pub leave_one_out_m: Option<Vec<[f64; 2]>>,
}

/// Seven parameters in space, in metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpatialModel {
    pub solver: Solver,
    /// What is transformed, in words.
    pub from: String,
    pub scale: f64,
    pub rotation: [[f64; 3]; 3],
    pub roll_pitch_yaw_deg: [f64; 3],
    pub translation_m: [f64; 3],
    pub rmse_m: f64,
    pub rmse_e_m: f64,
    pub rmse_n_m: f64,
    pub rmse_h_m: f64,
    pub sigma0_m: Option<f64>,
    pub residuals: Vec<SpatialResidual>,
}

/// Surveyed − computed, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpatialResidual {
    pub gcp: String,
    pub e_m: f64,
    pub n_m: f64,
    pub h_m: f64,
}

/// Who solved it, as JSON names them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Solver {
    Horn,
    HornHilden,
    Umeyama,
    UmeyamaHornScale,
    Kraus,
}

impl Solver {
    /// As JSON has it.
    pub fn name(self) -> &'static str {
        match self {
            Solver::Horn => "Horn",
            Solver::HornHilden => "HornHilden",
            Solver::Umeyama => "Umeyama",
            Solver::UmeyamaHornScale => "UmeyamaHornScale",
            Solver::Kraus => "Kraus",
        }
    }
}

impl ChosenModel {
    /// As `--model` and JSON name it.
    pub fn name(&self) -> &'static str {
        match self {
            ChosenModel::Affine(_) => "affine",
            ChosenModel::Projective(_) => "projective",
            ChosenModel::Similarity(_) => "similarity",
            ChosenModel::SevenParameter(_) => "7-parameter",
        }
    }

    /// The transform that stands in the place of the weighted similarity; `None` of one that is reported beside it.
    pub fn written(&self) -> Option<GeoTransform> {
        let [e, n, _] = match self {
            ChosenModel::Affine(model) => model.matrix,
            ChosenModel::Similarity(model) => model.matrix,
            ChosenModel::Projective(_) | ChosenModel::SevenParameter(_) => return None,
        };
        Some(GeoTransform([e[2], e[0], e[1], n[2], n[0], n[1]]))
    }

    /// Of a transform that is written: what each point is off when it is computed by the others.
    pub fn written_leave_one_out_m(&self) -> Option<&[[f64; 2]]> {
        match self {
            ChosenModel::Affine(model) => model.leave_one_out_m.as_deref().or(Some(&[])),
            ChosenModel::Similarity(model) => model.leave_one_out_m.as_deref().or(Some(&[])),
            ChosenModel::Projective(_) | ChosenModel::SevenParameter(_) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read_back_strictly() {
        let model = ChosenModel::Affine(PlanarModel {
            matrix: [[0.03, 0.001, 5e5], [0.002, -0.03, 6e6], [0.0, 0.0, 1.0]],
            rmse_m: 0.01,
            leave_one_out_rmse_m: None,
            similarity_rmse_m: Some(0.02),
            residuals_m: vec![[0.01, -0.01]],
            leave_one_out_m: None,
        });
        let text = serde_json::to_string(&model).expect("plain data");
        assert!(text.starts_with(r#"{"model":"affine","matrix":[["#), "{text}");
        assert_eq!(serde_json::from_str::<ChosenModel>(&text).expect("its own"), model);
        assert!(serde_json::from_str::<ChosenModel>(&text.replace("affine", "afine")).is_err());
        assert_eq!(model.written(), Some(GeoTransform([5e5, 0.03, 0.001, 6e6, 0.002, -0.03])));
        assert_eq!(model.written_leave_one_out_m(), Some(&[][..]));
    }
}
