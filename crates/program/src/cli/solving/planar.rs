//! Planar transforms beside or in the place of the weighted similarity.

use autoref_raster::coords::GeoTransform;
use autoref_solve::absolute::PointPair;
use autoref_solve::reliability::Reliability;
use autoref_solve::{Pair, planar};
use autoref_stream::result::{ChosenModel, MatchRow, PlanarModel, RunResult, SimilarityModel, Warning};

use super::super::document::{flag_far, to_look_at};
use super::model::{enter_model, rows};
use super::solver::SolverArg;

/// An affine transform takes the similarity's place in the outputs; a projective one is reported.
pub(super) fn planar_model(result: &mut RunResult, pairs: &[Pair], kind: planar::Kind) {
    let fit = match planar::fit(pairs, kind, planar::Weighting::Stated) {
        Ok(fit) => fit,
        Err(why) => {
            result.warn(format!("{} points do not support this --model ({why}); the similarity is used", pairs.len()));
            return;
        }
    };
    result.warnings.extend(fit.warnings.iter().cloned().map(Warning::Said));
    let model = PlanarModel {
        matrix: rows(&fit.matrix()),
        rmse_m: fit.rmse_m,
        leave_one_out_rmse_m: fit.leave_one_out_rmse_m,
        similarity_rmse_m: result.solved().map(|solved| solved.fit.rmse_m),
        residuals_m: fit.residuals_m.clone(),
        leave_one_out_m: fit.leave_one_out_m.clone(),
    };
    let model = match kind {
        planar::Kind::Affine => ChosenModel::Affine(model),
        planar::Kind::Projective => ChosenModel::Projective(model),
    };
    enter_model(result, model);
    if kind == planar::Kind::Projective {
        result.warn("a geotransform cannot hold a projective transform: the outputs are the similarity's");
        return;
    }
    let at = |x: f64, y: f64| fit.apply(autoref_raster::coords::PixelPoint { x, y });
    // Far arms, so that eastings of millions do not round the coefficients.
    const ARM: f64 = 65_536.0;
    let (Some(origin), Some(right), Some(down)) = (at(0.0, 0.0), at(ARM, 0.0), at(0.0, ARM)) else { return };
    let transform = GeoTransform::through(origin, right, down, (ARM, ARM));
    enter_planar(result, transform, &fit.residuals_m, fit.leave_one_out_m.as_deref());
    if let Some(solved) = result.solved_mut() {
        enter_reliability(&mut solved.matches, fit.reliability.as_deref());
    }
    look_again(result);
    result.warn("the affine transform is written");
}

/// Which points fit badly, by the transform that is written.
fn look_again(result: &mut RunResult) {
    result.warnings.retain(|warning| !matches!(warning, Warning::LookAt { .. }));
    let look_at = to_look_at(result);
    result.warnings.extend(look_at);
}

/// What each point says of itself; nothing where nothing is redundant.
fn enter_reliability(rows: &mut [MatchRow], reliability: Option<&[Reliability]>) {
    for (i, row) in rows.iter_mut().enumerate() {
        let own = reliability.map(|all| all[i]);
        row.redundancy = own.map(|own| own.redundancy);
        row.detectable_blunder_m = own.and_then(|own| own.detectable_blunder_m);
        row.outlier = own.is_some_and(|own| own.misfit);
    }
}

/// The similarity by another solver than the weighted one takes its place in the outputs. Every point counts alike.
pub(super) fn planar_solver(result: &mut RunResult, pairs: &[Pair], solver: SolverArg) {
    let flat = flat(pairs);
    let (space, sigma0) = match solver.in_space(&flat) {
        Ok(solved) if solved.0.rotation[(2, 2)] > 0.0 => solved,
        Ok(_) => {
            result.warn(format!("{}: the points are a mirror image; the similarity is used", solver.solver().name()));
            return;
        }
        Err(why) => {
            let few = pairs.len();
            result.warn(format!(
                "{few} points do not support --solver {} ({why}); the similarity is used",
                solver.solver().name()
            ));
            return;
        }
    };
    let (r, s, t) = (&space.rotation, space.scale, &space.translation);
    let transform = GeoTransform([t.x, s * r[(0, 0)], -s * r[(0, 1)], t.y, s * r[(1, 0)], -s * r[(1, 1)]]);
    let g = transform.0;
    let residuals: Vec<[f64; 2]> = space.residuals.iter().map(|r| [r.x, r.y]).collect();
    let left_out = leave_one_out(&flat, solver);
    let rotation_deg = r[(1, 0)].atan2(r[(0, 0)]).to_degrees();
    let model = SimilarityModel {
        solver: solver.solver(),
        matrix: [[g[1], g[2], g[0]], [g[4], g[5], g[3]], [0.0, 0.0, 1.0]],
        scale_m_per_px: s,
        rotation_deg,
        rmse_m: space.rmse,
        sigma0_m: sigma0,
        similarity_rmse_m: result.solved().map(|solved| solved.fit.rmse_m),
        residuals_m: residuals.clone(),
        leave_one_out_m: left_out.clone(),
    };
    enter_model(result, ChosenModel::Similarity(model));
    if let Some(solved) = result.solved_mut() {
        solved.fit.scale_m_per_px = s;
        solved.fit.rotation_deg = rotation_deg;
    }
    enter_planar(result, transform, &residuals, left_out.as_deref());
    look_again(result);
    result.warn(format!(
        "the similarity by {} is written, in which every point counts alike; expected errors, redundancy and outliers are \
         those of the weighted one",
        solver.solver().name()
    ));
}

/// What each point is off, surveyed − computed, when the others alone are solved; `None` when one cannot be left out.
fn leave_one_out(points: &[PointPair], solver: SolverArg) -> Option<Vec<[f64; 2]>> {
    /// Two points are exact whatever they are: what they say of a third is no test of them.
    const FEWEST: usize = 4;
    let off = |left_out: usize| {
        let others: Vec<PointPair> =
            points.iter().enumerate().filter(|(i, _)| *i != left_out).map(|(_, point)| *point).collect();
        let (space, _) = solver.in_space(&others).ok()?;
        let computed = space.rotation * points[left_out].model * space.scale + space.translation;
        let off = points[left_out].target - computed;
        Some([off.x, off.y])
    };
    (points.len() >= FEWEST).then(|| (0..points.len()).map(off).collect()).flatten()
}

/// Marks as (x, −y, 0) in pixels and GCPs as (easting, northing, 0) in metres.
pub fn flat(pairs: &[Pair]) -> Vec<PointPair> {
    pairs
        .iter()
        .map(|p| PointPair {
            model: nalgebra::Vector3::new(p.pixel.x, -p.pixel.y, 0.0),
            target: nalgebra::Vector3::new(p.map.easting, p.map.northing, 0.0),
        })
        .collect()
}

/// A planar transform takes the similarity's place in the result.
fn enter_planar(
    result: &mut RunResult,
    transform: GeoTransform,
    residuals_m: &[[f64; 2]],
    leave_one_out_m: Option<&[[f64; 2]]>,
) {
    let Some(solved) = result.solved_mut() else { return };
    solved.geotransform = transform;
    let n = residuals_m.len() as f64;
    let rms = |axis: usize| (residuals_m.iter().map(|r| r[axis].powi(2)).sum::<f64>() / n).sqrt();
    let (rms_e, rms_n) = (rms(0), rms(1));
    let fit = &mut solved.fit;
    (fit.rmse_e_m, fit.rmse_n_m, fit.rmse_m) = (rms_e, rms_n, rms_e.hypot(rms_n));
    let scale = fit.scale_m_per_px;
    fit.rmse_px = fit.rmse_m / scale;
    for (i, (row, residual)) in solved.matches.iter_mut().zip(residuals_m).enumerate() {
        (row.residual_e_m, row.residual_n_m) = (residual[0], residual[1]);
        row.residual_px = residual[0].hypot(residual[1]) / scale;
        row.leave_one_out_m = leave_one_out_m.map(|left_out| left_out[i][0].hypot(left_out[i][1]));
    }
    // What is tested is what is written.
    for row in &mut solved.check_points {
        let computed = transform.apply(autoref_raster::coords::PixelPoint { x: row.x, y: row.y });
        (row.residual_e_m, row.residual_n_m) = (row.easting - computed.easting, row.northing - computed.northing);
        row.residual_px = row.residual_e_m.hypot(row.residual_n_m) / scale;
    }
    flag_far(&mut solved.check_points);
}
