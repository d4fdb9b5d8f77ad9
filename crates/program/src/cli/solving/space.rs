//! `--model 7-parameter`: the transform in space, beside the similarity.

use autoref_solve::absolute::{self, AbsoluteOrientation, PointPair};
use autoref_stream::gcp::GcpList;
use autoref_stream::pipeline::georeference::Orientation;
use autoref_stream::result::{ChosenModel, RunResult, SpatialModel, SpatialResidual};

use super::model::{enter_model, rows};
use super::solver::SolverArg;

/// Seven parameters in metres: the image points are brought to metres by the similarity first, so that one scale
/// serves planimetry and heights.
pub(super) fn in_space(result: &mut RunResult, orientation: &Orientation, list: &GcpList, solver: SolverArg) {
    let Some(heights) = result.solved().and_then(|solved| solved.heights.as_ref()) else {
        result.warn("--model 7-parameter needs heights: give --dem, and heights in the list");
        return;
    };
    let mut names = Vec::new();
    let points: Vec<PointPair> = orientation
        .marks
        .iter()
        .filter_map(|mark| {
            let gcp = &list.gcps[mark.gcp];
            let row = heights.points.iter().find(|row| row.gcp == gcp.name)?;
            let at = orientation.solution.similarity.apply(mark.mark.centre);
            names.push(gcp.name.clone());
            Some(PointPair {
                model: nalgebra::Vector3::new(at.easting, at.northing, row.model_m),
                target: nalgebra::Vector3::new(gcp.easting, gcp.northing, row.surveyed_m),
            })
        })
        .collect();
    match solver.in_space(&points) {
        Ok((space, sigma0)) => {
            if points.len() < 5 {
                let few = points.len();
                result.warn(format!("only {few} points with heights: seven parameters are hardly checked"));
            }
            enter_model(result, describe(solver, &space, sigma0, &names));
        }
        Err(why) => result.warn(format!(
            "no 7-parameter solution from {} points with heights ({why}): the similarity stands alone",
            points.len()
        )),
    }
}

fn describe(solver: SolverArg, space: &AbsoluteOrientation, sigma0_m: Option<f64>, names: &[String]) -> ChosenModel {
    let by_axis = space.rmse_by_axis();
    let residual = |(gcp, r): (&String, &nalgebra::Vector3<f64>)| SpatialResidual {
        gcp: gcp.clone(),
        e_m: r.x,
        n_m: r.y,
        h_m: r.z,
    };
    ChosenModel::SevenParameter(SpatialModel {
        solver: solver.solver(),
        from: "similarity's easting and northing of the marks, elevation of the model; metres".into(),
        scale: space.scale,
        rotation: rows(&space.rotation),
        roll_pitch_yaw_deg: absolute::roll_pitch_yaw_deg(&space.rotation),
        translation_m: space.translation.into(),
        rmse_m: space.rmse,
        rmse_e_m: by_axis.x,
        rmse_n_m: by_axis.y,
        rmse_h_m: by_axis.z,
        sigma0_m,
        residuals: names.iter().zip(&space.residuals).map(residual).collect(),
    })
}
