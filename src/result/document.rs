//! The flat JSON object of a result, with its keys in the order in which they are written. Every key is here; which of
//! them hold a value follows from the outcome, and an object that contradicts itself is not read.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{
    ChosenModel, FitFigures, ImageInfo, MatchRow, PriorGeoreference, Reading, RefusedRun, RunOutcome, RunPattern,
    RunResult, SCHEMA_VERSION, SolvedRun, Status, Timings, Warning,
};
use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::matching::diagnosis::Diagnosis;
use crate::matching::{Effort, NamesAgree, Pattern};
use crate::pipeline::colour_search::ColourSearch;
use crate::pipeline::heights::HeightResult;
use crate::pipeline::reasons::NotFound;
use crate::pipeline::second_pass::SecondPass;
use autoref_raster::coords::GeoTransform;
use autoref_raster::memory_plan::ScanPlan;
use autoref_solve::Solution;
use autoref_solve::accuracy::{AccuracyStatement, CornerError};

/// Lists that an older program did not write are empty when it is read.
#[derive(Serialize, Deserialize)]
pub(super) struct Document<'a> {
    schema_version: u32,
    program: String,
    status: Status,
    reason: Option<String>,
    #[serde(default)]
    advice: Vec<String>,
    image: Option<ImageInfo>,
    gcp_file: String,
    options: serde_json::Value,
    geotransform: Option<GeoTransform>,
    crs: Option<String>,
    rmse_m: Option<f64>,
    rmse_e_m: Option<f64>,
    rmse_n_m: Option<f64>,
    rmse_px: Option<f64>,
    scale_m_per_px: Option<f64>,
    rotation_deg: Option<f64>,
    gcps_listed: usize,
    #[serde(default)]
    gcps: Cow<'a, [Gcp]>,
    #[serde(default)]
    delivered: bool,
    gcps_in_image: Option<usize>,
    candidates_found: usize,
    /// 0 or null when the logarithm says more than a double can hold.
    false_alarms: Option<f64>,
    log10_false_alarms: Option<f64>,
    #[serde(default)]
    matches: Cow<'a, [MatchRow]>,
    #[serde(default)]
    check_points: Cow<'a, [MatchRow]>,
    accuracy: Option<AccuracyStatement>,
    #[serde(default)]
    expected_errors: Vec<CornerError>,
    #[serde(default)]
    not_found: Vec<NotFound>,
    #[serde(default)]
    outside: Vec<String>,
    solution: Option<Solution>,
    runner_up: Option<Pattern>,
    best_pattern: Option<Pattern>,
    search: Option<Effort>,
    #[serde(default)]
    search_cut: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    names: Option<NamesAgree>,
    prior_georeference: Option<PriorGeoreference>,
    #[serde(default)]
    diagnoses: Vec<Diagnosis>,
    #[serde(default)]
    heights: Option<HeightResult>,
    #[serde(default)]
    chosen_model: Option<ChosenModel>,
    #[serde(default)]
    warnings: Vec<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    run_pattern: Option<RunPattern>,
    patch: Option<autoref_review::PatchFile>,
    #[serde(default)]
    candidates: Cow<'a, [Candidate]>,
    #[serde(default)]
    files_written: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    files_standing: Vec<String>,
    reading: Option<Reading>,
    #[serde(skip_serializing_if = "Option::is_none")]
    second_pass: Option<SecondPass>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    colour_search: Option<ColourSearch>,
    memory_plan: Option<ScanPlan>,
    #[serde(default)]
    timings: Timings,
    peak_memory_bytes: Option<u64>,
    elapsed_s: f64,
}

/// Why an object is no result.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Contradiction {
    #[error("missing field `{0}`: a result with the status \"solved\" has it")]
    Missing(&'static str),
    #[error("field `{0}` holds a value, and the status is \"refused\"")]
    Unexpected(&'static str),
}

impl<'a> Document<'a> {
    pub(super) fn of(result: &'a RunResult) -> Self {
        let solved = result.solved();
        let refused = result.refused();
        let fit = solved.map(|solved| solved.fit);
        Document {
            schema_version: SCHEMA_VERSION,
            program: result.program.clone(),
            status: result.status(),
            reason: refused.map(|refused| refused.reason.clone()),
            advice: result.advice.clone(),
            image: result.image.clone(),
            gcp_file: result.gcp_file.clone(),
            options: result.options.clone(),
            geotransform: result.geotransform(),
            crs: result.crs.clone(),
            rmse_m: fit.map(|fit| fit.rmse_m),
            rmse_e_m: fit.map(|fit| fit.rmse_e_m),
            rmse_n_m: fit.map(|fit| fit.rmse_n_m),
            rmse_px: fit.map(|fit| fit.rmse_px),
            scale_m_per_px: fit.map(|fit| fit.scale_m_per_px),
            rotation_deg: fit.map(|fit| fit.rotation_deg),
            gcps_listed: result.gcps_listed,
            gcps: Cow::Borrowed(&result.gcps),
            delivered: result.delivered,
            gcps_in_image: solved.map(|solved| solved.gcps_in_image),
            candidates_found: result.candidates_found,
            false_alarms: result.log10_false_alarms.map(|log10| 10f64.powf(log10)),
            log10_false_alarms: result.log10_false_alarms,
            matches: Cow::Borrowed(result.matches()),
            check_points: Cow::Borrowed(result.check_points()),
            accuracy: solved.and_then(|solved| solved.accuracy.clone()),
            expected_errors: solved.map_or_else(Vec::new, |solved| solved.expected_errors.clone()),
            not_found: solved.map_or_else(Vec::new, |solved| solved.not_found.clone()),
            outside: solved.map_or_else(Vec::new, |solved| solved.outside.clone()),
            solution: solved.and_then(|solved| solved.solution.clone()),
            runner_up: result.runner_up.clone(),
            best_pattern: result.best_pattern().cloned(),
            search: result.search.clone(),
            search_cut: result.search_cut,
            names: solved.and_then(|solved| solved.names),
            prior_georeference: result.prior_georeference.clone(),
            diagnoses: result.diagnoses.clone(),
            heights: solved.and_then(|solved| solved.heights.clone()),
            chosen_model: solved.and_then(|solved| solved.chosen_model.clone()),
            warnings: result.warnings.iter().map(ToString::to_string).collect(),
            run_pattern: result.run_pattern,
            patch: result.patch.clone(),
            candidates: Cow::Borrowed(&result.candidates),
            files_written: result.files_written.clone(),
            files_standing: result.files_standing.clone(),
            reading: result.reading.clone(),
            second_pass: result.second_pass.clone(),
            colour_search: result.colour_search.clone(),
            memory_plan: result.memory_plan.clone(),
            timings: result.timings,
            peak_memory_bytes: result.peak_memory_bytes,
            elapsed_s: result.elapsed_s,
        }
    }

    fn outcome(&mut self) -> Result<RunOutcome, Contradiction> {
        match self.status {
            Status::Solved => {
                if self.heights.as_ref().is_some_and(|heights| !heights.correction.has_its_choice()) {
                    return Err(Contradiction::Missing("heights.correction.fits of the chosen model"));
                }
                let need = |value: Option<f64>, name| value.ok_or(Contradiction::Missing(name));
                Ok(RunOutcome::Solved(Box::new(SolvedRun {
                    geotransform: self.geotransform.ok_or(Contradiction::Missing("geotransform"))?,
                    fit: FitFigures {
                        rmse_m: need(self.rmse_m, "rmse_m")?,
                        rmse_e_m: need(self.rmse_e_m, "rmse_e_m")?,
                        rmse_n_m: need(self.rmse_n_m, "rmse_n_m")?,
                        rmse_px: need(self.rmse_px, "rmse_px")?,
                        scale_m_per_px: need(self.scale_m_per_px, "scale_m_per_px")?,
                        rotation_deg: need(self.rotation_deg, "rotation_deg")?,
                    },
                    solution: self.solution.take(),
                    chosen_model: self.chosen_model.take(),
                    matches: std::mem::take(&mut self.matches).into_owned(),
                    check_points: std::mem::take(&mut self.check_points).into_owned(),
                    gcps_in_image: self.gcps_in_image.ok_or(Contradiction::Missing("gcps_in_image"))?,
                    not_found: std::mem::take(&mut self.not_found),
                    outside: std::mem::take(&mut self.outside),
                    names: self.names.take(),
                    accuracy: self.accuracy.take(),
                    expected_errors: std::mem::take(&mut self.expected_errors),
                    heights: self.heights.take(),
                })))
            }
            Status::Refused => {
                let unexpected = [
                    ("geotransform", self.geotransform.is_some()),
                    ("solution", self.solution.is_some()),
                    ("matches", !self.matches.is_empty()),
                    ("check_points", !self.check_points.is_empty()),
                ];
                if let Some((name, _)) = unexpected.into_iter().find(|(_, there)| *there) {
                    return Err(Contradiction::Unexpected(name));
                }
                let reason = self.reason.take().unwrap_or_else(|| "it was not solved".into());
                Ok(RunOutcome::Refused(Box::new(RefusedRun { reason, best_pattern: self.best_pattern.take() })))
            }
        }
    }
}

impl TryFrom<Document<'_>> for RunResult {
    type Error = Contradiction;

    fn try_from(mut document: Document<'_>) -> Result<Self, Contradiction> {
        let outcome = document.outcome()?;
        Ok(RunResult {
            outcome,
            program: document.program,
            advice: document.advice,
            image: document.image,
            gcp_file: document.gcp_file,
            options: document.options,
            crs: document.crs,
            gcps_listed: document.gcps_listed,
            gcps: document.gcps.into_owned(),
            delivered: document.delivered,
            candidates_found: document.candidates_found,
            candidates: document.candidates.into_owned(),
            log10_false_alarms: document.log10_false_alarms,
            runner_up: document.runner_up,
            search: document.search,
            search_cut: document.search_cut,
            prior_georeference: document.prior_georeference,
            diagnoses: document.diagnoses,
            warnings: document.warnings.into_iter().map(Warning::Said).collect(),
            run_pattern: document.run_pattern,
            patch: document.patch,
            files_written: document.files_written,
            files_standing: document.files_standing,
            reading: document.reading,
            second_pass: document.second_pass,
            colour_search: document.colour_search,
            memory_plan: document.memory_plan,
            timings: document.timings,
            peak_memory_bytes: document.peak_memory_bytes,
            elapsed_s: document.elapsed_s,
        })
    }
}
