//! What the result may claim of its accuracy: flags, and the lines of the summary.

use std::path::PathBuf;

use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::error::Error;
use autoref_solve::accuracy::{self, CheckError, CornerError, ErrorModel, StatementOptions};
use autoref_solve::{Pair, planar};
use autoref_stream::gcp::{GcpList, GcpRole};
use autoref_stream::pipeline::reasons::Reason;
use autoref_stream::result::{ChosenModel, MatchRow, Misfit, RunResult, SolvedRun, Warning};
use clap::Args;

use crate::cli::lengths::length;

/// Survey errors and the statement.
#[derive(Args, Debug, Clone, Default)]
pub struct AccuracyArgs {
    /// Survey errors (1σ, metres) point by point: CSV with `name` and `sigma`, or `sigma_e`, `sigma_n`, `sigma_h`.
    /// Weights of the fit and part of the accuracy statement.
    #[arg(long, value_name = "FILE", help_heading = "Accuracy")]
    pub accuracy: Option<PathBuf>,
    /// The ASPRS accuracy class that the result is to meet, RMSE in metres. Default: the smallest that it does meet.
    #[arg(long, value_name = "M", value_parser = positive, help_heading = "Accuracy")]
    pub accuracy_class: Option<f64>,
    /// Add the accuracy at 95 % confidence after the NSSDA.
    #[arg(long, help_heading = "Accuracy")]
    pub nssda: bool,
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.trim().trim_end_matches('m').trim().parse::<f64>().ok();
    number.filter(|v| *v > 0.0 && v.is_finite()).ok_or_else(|| format!("`{text}` is no positive length in metres"))
}

/// Refuses a figure of check points where there are none.
pub fn check_nssda(args: &AccuracyArgs, list: &GcpList) -> Result<(), Error> {
    if args.nssda && !list.gcps.iter().any(|gcp| gcp.role == GcpRole::Check) {
        return Err(Error::usage(
            "--nssda has no effect: no point is a check point",
            "name some with --check, or leave out --nssda",
        ));
    }
    Ok(())
}

/// Adds statement and expected errors to a solved result. `size_px` is the image's.
pub fn state(result: &mut RunResult, list: &GcpList, args: &AccuracyArgs, size_px: (f64, f64)) {
    let Some(solved) = result.solved_mut() else { return };
    let Some(solution) = &solved.solution else { return };
    let similarity = solution.similarity;
    let checks: Vec<CheckError> = solved
        .check_points
        .iter()
        .map(|row| {
            let gcp = list.gcps.iter().find(|gcp| gcp.name == row.gcp);
            CheckError {
                name: row.gcp.clone(),
                // Residuals are surveyed − computed.
                easting_m: -row.residual_e_m,
                northing_m: -row.residual_n_m,
                height_m: None,
                survey_sigma_m: gcp.and_then(|gcp| gcp.sigma_m),
                survey_sigma_height_m: gcp.and_then(|gcp| gcp.sigma_height_m),
            }
        })
        .collect();
    let written = solved.chosen_model.as_ref().and_then(ChosenModel::written_leave_one_out_m);
    let leave_one_out: Vec<(f64, f64)> = match written {
        // What is written, not the similarity beside it.
        Some(left_out) => left_out.iter().map(|&[e, n]| (e, n)).collect(),
        None => solution.pairs.iter().filter_map(|pair| pair.leave_one_out_e_m.zip(pair.leave_one_out_n_m)).collect(),
    };
    let options =
        StatementOptions { class_h_m: args.accuracy_class, class_v_m: args.accuracy_class, nssda: args.nssda };
    let mut statement = accuracy::statement(&checks, &leave_one_out, &options);
    statement.reservations.extend(untested(solved, list));
    solved.accuracy = Some(statement);
    solved.expected_errors = error_model(solved).map_or_else(Vec::new, |errors| errors.corners(&similarity, size_px));
    let misfit = Misfit::of(result);
    if let (Some(misfit), Some(solved)) = (&misfit, result.solved_mut()) {
        let scale_m_per_px = solved.fit.scale_m_per_px;
        for corner in &mut solved.expected_errors {
            let place = corner.corner.place(size_px);
            let with = |expected_m: f64| misfit.with_m(expected_m, place, scale_m_per_px);
            let expected = &mut corner.expected;
            (expected.transform_95_m, expected.point_95_m) = (with(expected.transform_95_m), with(expected.point_95_m));
        }
    }
    let rmse_m = result.solved().map_or(0.0, |solved| solved.fit.rmse_m);
    let bend = list.working_crs.bend().filter(|bend| bend.explains(rmse_m));
    let note = match (bend, misfit) {
        (Some(bend), None | Some(Misfit::Departs { .. })) => Some(bend.note()),
        (_, misfit) => misfit.map(|misfit| misfit.note()),
    };
    result.warnings.extend(note.map(Warning::Said));
}

/// What is written says so much of its errors; `None` when nothing is known of the noise.
pub fn error_model(solved: &SolvedRun) -> Option<ErrorModel> {
    match &solved.chosen_model {
        Some(ChosenModel::Affine(_)) => of_affine(&solved.matches),
        _ => ErrorModel::new(solved.solution.as_ref()?),
    }
}

/// What the affine transform through these marks says of its errors.
fn of_affine(rows: &[MatchRow]) -> Option<ErrorModel> {
    let pair = |row: &MatchRow| Pair {
        pixel: PixelPoint { x: row.x, y: row.y },
        covariance_px2: row.covariance_px2,
        map: MapPoint { easting: row.easting, northing: row.northing },
        survey_sigma_m: row.survey_sigma_m,
    };
    let pairs: Vec<Pair> = rows.iter().map(pair).collect();
    let fit = planar::fit(&pairs, planar::Kind::Affine, planar::Weighting::Stated).ok()?;
    ErrorModel::of_affine(&fit, &pairs)
}

/// Check points that lie in the image and are in no figure: a test is as good as what it leaves out.
fn untested(solved: &SolvedRun, list: &GcpList) -> Option<String> {
    let is_check = |name: &str| list.gcps.iter().any(|gcp| gcp.name == name && gcp.role == GcpRole::Check);
    let inside = solved.not_found.iter().filter(|point| point.reason != Reason::Outside);
    let names: Vec<&str> = inside.map(|point| point.name.as_str()).filter(|name| is_check(name)).collect();
    let all = names.len() + solved.check_points.len();
    (!names.is_empty()).then(|| {
        format!(
            "{} of {all} check points in the image are not in the figures, since no mark was found where theirs must be: {}",
            names.len(),
            names.join(", ")
        )
    })
}

/// The lines of the summary.
pub fn lines(solved: &SolvedRun, line: &mut impl FnMut(&str, String)) {
    let Some(statement) = &solved.accuracy else { return };
    if let Some(h) = &statement.figures.horizontal {
        let survey = h
            .rmse_h2_m
            .map_or(String::new(), |s| format!(", with the survey's own {} RMSE_H {}", length(s), length(h.rmse_h_m)));
        line("Check points", format!("{} kept out of the fit, RMSE {}{survey}", h.check_points, length(h.rmse_h1_m)));
    }
    let by_size = |a: &&CornerError, b: &&CornerError| a.expected.point_95_m.total_cmp(&b.expected.point_95_m);
    let corners = solved.expected_errors.iter();
    if let (Some(best), Some(worst)) = (corners.clone().min_by(by_size), corners.max_by(by_size)) {
        let at = |c: &CornerError| format!("{} in the {} corner", length(c.expected.point_95_m), c.direction);
        line("Expected error", format!("of a point, 95 %: {}, {}", at(best), at(worst)));
    }
    for sentence in &statement.sentences {
        line("Accuracy", sentence.clone());
    }
    for reservation in &statement.reservations {
        line("  but", reservation.clone());
    }
}
