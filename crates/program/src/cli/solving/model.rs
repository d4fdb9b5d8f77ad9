//! The transform that was asked for, in the result.

use autoref_raster::coords::GeoTransform;
use autoref_stream::result::{ChosenModel, RunResult, SolvedRun};

/// Enters the transform that was asked for beside the similarity.
pub(super) fn enter_model(result: &mut RunResult, model: ChosenModel) {
    if let Some(solved) = result.solved_mut() {
        solved.chosen_model = Some(model);
    }
}

/// The affine transform, or the similarity of another solver, that stands in the place of the weighted similarity.
pub fn written_affine(result: &RunResult) -> Option<GeoTransform> {
    result.solved()?.chosen_model.as_ref()?.written()
}

/// The transform that was asked for beside or instead of the similarity.
pub fn model_line(solved: &SolvedRun) -> Option<String> {
    let model = solved.chosen_model.as_ref()?;
    let name = model.name();
    Some(match model {
        ChosenModel::Affine(planar) | ChosenModel::Projective(planar) => format!("{name}: RMSE {:.4} m", planar.rmse_m),
        ChosenModel::Similarity(by) => format!("{name} by {}: RMSE {:.4} m", by.solver.name(), by.rmse_m),
        ChosenModel::SevenParameter(by) => {
            let [roll, pitch, yaw] = by.roll_pitch_yaw_deg;
            format!(
                "{name} by {}: RMSE {:.4} m, heights {:.4} m; roll {roll:.5}°, pitch {pitch:.5}°, yaw {yaw:.5}°",
                by.solver.name(),
                by.rmse_m,
                by.rmse_h_m
            )
        }
    })
}

pub(super) fn rows(matrix: &nalgebra::Matrix3<f64>) -> [[f64; 3]; 3] {
    std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)]))
}
