//! The result of a run: everything that was asked, seen, solved and written. `docs/formats.md` documents its JSON,
//! `docs/result.schema.json` is the JSON Schema of it.

mod chosen_model;
mod document;
mod misfit;
mod twins;
mod warning;

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::candidate::{Candidate, Code};
use crate::gcp::Gcp;
use crate::matching::{Effort, NamesAgree, Pattern};
use crate::pipeline::georeference::FoundBy;
use autoref_raster::bounded;
use autoref_raster::coords::GeoTransform;
use autoref_raster::error::{Error, Result};
use autoref_solve::{Similarity, Solution};

pub use chosen_model::{ChosenModel, PlanarModel, SimilarityModel, Solver, SpatialModel, SpatialResidual};
pub use misfit::{LEAST_MISFIT_PX, Misfit, Survey, residual_rms_px};
pub use twins::Twins;
pub use warning::Warning;

/// Version of the layout; it grows when a field changes its meaning.
pub const SCHEMA_VERSION: u32 = 1;

/// "solved" or "refused".
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    Solved,
    Refused,
}

/// A run: what was asked and seen, and what came of it. As JSON it is one flat object; what an outcome does not
/// have is `null` there, and no number is ever NaN or infinite.
#[derive(Clone, Debug, Deserialize)]
#[serde(try_from = "document::Document<'_>")]
pub struct RunResult {
    /// Name and version of the program.
    pub program: String,
    pub outcome: RunOutcome,
    /// What would help.
    pub advice: Vec<String>,
    /// `None` when candidates were solved without an image.
    pub image: Option<ImageInfo>,
    pub gcp_file: String,
    pub options: serde_json::Value,
    /// "EPSG:n", WKT, or `None` for local coordinates.
    pub crs: Option<String>,
    pub gcps_listed: usize,
    /// The whole list as it was used in the fit, in the order of the file.
    pub gcps: Vec<Gcp>,
    /// `gcps` and `solution` are in the metres of the fit, `geotransform` and the matches in other units or another
    /// CRS.
    pub delivered: bool,
    pub candidates_found: usize,
    pub candidates: Vec<Candidate>,
    /// log₁₀ of the patterns as good as the best that chance alone would produce.
    pub log10_false_alarms: Option<f64>,
    pub runner_up: Option<Pattern>,
    pub search: Option<Effort>,
    /// `--time-limit` ended the search before its work was done.
    pub search_cut: bool,
    pub prior_georeference: Option<PriorGeoreference>,
    /// Mistakes in the list of GCPs that would explain what was seen; none was corrected.
    pub diagnoses: Vec<crate::matching::diagnosis::Diagnosis>,
    pub warnings: Vec<Warning>,
    /// Of a replay: what [`RunResult::log10_false_alarms`] speaks of.
    pub run_pattern: Option<RunPattern>,
    /// The review that was replayed, whole: who reads the result sees what was changed by hand.
    pub patch: Option<autoref_review::PatchFile>,
    pub files_written: Vec<String>,
    /// Of a refused run: files of earlier runs that hold a georeference still.
    pub files_standing: Vec<String>,
    pub reading: Option<Reading>,
    /// What the self-taught second pass did, when there was one.
    pub second_pass: Option<crate::pipeline::second_pass::SecondPass>,
    /// Objects that look like marks in any colour, when nothing was solved by the profile's.
    pub colour_search: Option<crate::pipeline::colour_search::ColourSearch>,
    pub memory_plan: Option<autoref_raster::memory_plan::ScanPlan>,
    pub timings: Timings,
    pub peak_memory_bytes: Option<u64>,
    pub elapsed_s: f64,
}

/// What came of a run.
#[derive(Clone, Debug)]
pub enum RunOutcome {
    Solved(Box<SolvedRun>),
    Refused(Box<RefusedRun>),
}

/// A georeference with all that speaks for it.
#[derive(Clone, Debug)]
pub struct SolvedRun {
    /// GDAL's six numbers; pixel corners.
    pub geotransform: GeoTransform,
    pub fit: FitFigures,
    /// The similarity in the metres of the fit; `None` after the transform was carried to another raster.
    pub solution: Option<Solution>,
    /// The transform of `--model` or `--solver`, beside the similarity or in its place.
    pub chosen_model: Option<ChosenModel>,
    pub matches: Vec<MatchRow>,
    pub check_points: Vec<MatchRow>,
    /// GCPs that the transform puts inside the image.
    pub gcps_in_image: usize,
    /// GCPs inside the image of which no mark was found.
    pub not_found: Vec<crate::pipeline::reasons::NotFound>,
    /// GCPs that lie outside the image.
    pub outside: Vec<String>,
    /// How the names of coded targets agree with the match, when they were heeded.
    pub names: Option<NamesAgree>,
    /// What may be claimed of the accuracy; `None` until it is stated.
    pub accuracy: Option<autoref_solve::accuracy::AccuracyStatement>,
    /// Expected errors in the image's corners; empty when nothing is known of them.
    pub expected_errors: Vec<autoref_solve::accuracy::CornerError>,
    /// What was solved of an elevation model.
    pub heights: Option<crate::pipeline::heights::HeightResult>,
}

/// Residuals and size of the transform that is written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitFigures {
    /// √(mean(dE² + dN²)), unweighted, metres.
    pub rmse_m: f64,
    pub rmse_e_m: f64,
    pub rmse_n_m: f64,
    pub rmse_px: f64,
    pub scale_m_per_px: f64,
    /// Anticlockwise from east.
    pub rotation_deg: f64,
}

impl From<&Solution> for FitFigures {
    fn from(solution: &Solution) -> Self {
        FitFigures {
            rmse_m: solution.rmse_m,
            rmse_e_m: solution.rmse_e_m,
            rmse_n_m: solution.rmse_n_m,
            rmse_px: solution.rmse_px,
            scale_m_per_px: solution.scale_m_per_px,
            rotation_deg: solution.rotation_deg,
        }
    }
}

/// Why nothing is claimed.
#[derive(Clone, Debug)]
pub struct RefusedRun {
    /// In plain words.
    pub reason: String,
    /// The best partial pattern.
    pub best_pattern: Option<Pattern>,
}

/// The pattern that a run found, and what a review left of it: the chance of a false alarm is the run's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunPattern {
    /// Its control points.
    pub points: usize,
    /// Those whose marks stayed as the run had found them.
    pub kept: usize,
    /// Whether chance makes it as rarely as the run asked for.
    pub believed: bool,
}

/// What was read.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ImageInfo {
    pub path: String,
    pub width: u64,
    pub height: u64,
    pub bands: usize,
    pub reader: String,
    pub description: String,
    /// The image from the folder of the result, where that is another than its own (`--out`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub from_result: Option<String>,
}

/// One GCP with the mark that is it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MatchRow {
    pub gcp: String,
    pub x: f64,
    pub y: f64,
    pub easting: f64,
    pub northing: f64,
    pub height: Option<f64>,
    /// 1σ of the survey in each of easting and northing, metres.
    pub survey_sigma_m: Option<f64>,
    /// The same of its height.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub survey_sigma_height_m: Option<f64>,
    /// Surveyed − computed.
    pub residual_e_m: f64,
    pub residual_n_m: f64,
    pub residual_px: f64,
    pub covariance_px2: Option<[f64; 3]>,
    pub score: Option<f64>,
    /// Which look gave the centre.
    pub found_by: FoundBy,
    pub leave_one_out_m: Option<f64>,
    pub redundancy: Option<f64>,
    pub detectable_blunder_m: Option<f64>,
    pub outlier: bool,
    /// What a coded target says of itself.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub code: Option<Code>,
}

/// A georeference that the image already had.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PriorGeoreference {
    pub geotransform: GeoTransform,
    pub crs: Option<String>,
    /// How far the new georeference moves the image's centre, metres; null when the CRSs differ.
    pub moved_m: Option<f64>,
    /// The same of the corner that moves farthest.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub corner_moved_m: Option<f64>,
}

/// How much was read.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Reading {
    pub blocks_in_file: u64,
    /// Decoded during the scan.
    pub blocks_decoded: u64,
    pub blocks_skipped: u64,
    pub bytes_read: u64,
    /// Decoded for windows of their own: marks that straddle tiles, and the refinement.
    pub window_blocks_decoded: u64,
    pub window_bytes_read: u64,
}

/// Wall-clock seconds of the stages.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Timings {
    pub open_s: f64,
    pub scan_s: f64,
    pub examine_s: f64,
    pub match_s: f64,
    pub rematch_s: f64,
    /// Pictures of the report.
    pub report_s: f64,
    pub write_s: f64,
}

impl Serialize for RunResult {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        document::Document::of(self).serialize(serializer)
    }
}

/// What a file is that was given for a result and is no text.
fn no_text(bytes: &[u8]) -> String {
    const REMEDY: &str = "give the NAME.autoref.json that a run has written";
    let is_image = match bytes {
        [0xFF, 0xD8, ..] | [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => true,
        other => other.starts_with(b"\x89PNG") || other.get(4..8) == Some(b"jP  "),
    };
    format!("it is {}, no result; {REMEDY}", if is_image { "an image" } else { "no text" })
}

impl RunResult {
    /// Adds a remark, in plain words.
    pub fn warn(&mut self, words: impl Into<Warning>) {
        self.warnings.push(words.into());
    }

    /// Whether it was solved.
    pub fn status(&self) -> Status {
        match self.outcome {
            RunOutcome::Solved(_) => Status::Solved,
            RunOutcome::Refused(_) => Status::Refused,
        }
    }

    /// `None` of a refused run.
    pub fn solved(&self) -> Option<&SolvedRun> {
        match &self.outcome {
            RunOutcome::Solved(solved) => Some(solved),
            RunOutcome::Refused(_) => None,
        }
    }

    /// Likewise, to be changed.
    pub fn solved_mut(&mut self) -> Option<&mut SolvedRun> {
        match &mut self.outcome {
            RunOutcome::Solved(solved) => Some(solved),
            RunOutcome::Refused(_) => None,
        }
    }

    /// `None` of a solved run.
    pub fn refused(&self) -> Option<&RefusedRun> {
        match &self.outcome {
            RunOutcome::Refused(refused) => Some(refused),
            RunOutcome::Solved(_) => None,
        }
    }

    /// The georeference of a solved run.
    pub fn geotransform(&self) -> Option<GeoTransform> {
        self.solved().map(|solved| solved.geotransform)
    }

    /// Width and height of the image, pixels: as it was read, or as `--size` gave them. `None` of candidates alone.
    pub fn size_px(&self) -> Option<(f64, f64)> {
        // What was asked is on record, for a replay too.
        let asked = || serde_json::from_value(self.options.pointer("/priors/image_size_px")?.clone()).ok();
        self.image.as_ref().map(|image| (image.width as f64, image.height as f64)).or_else(asked)
    }

    /// Likewise; without an image, how far the candidates reach.
    pub fn extent_px(&self) -> (f64, f64) {
        self.size_px().unwrap_or_else(|| {
            let reach = |(w, h): (f64, f64), c: &Candidate| (w.max(c.centre.x), h.max(c.centre.y));
            self.candidates.iter().fold((1.0, 1.0), reach)
        })
    }

    /// Control points with their marks; none when the run was refused.
    pub fn matches(&self) -> &[MatchRow] {
        self.solved().map_or(&[], |solved| &solved.matches)
    }

    /// Check points with their marks; none when the run was refused.
    pub fn check_points(&self) -> &[MatchRow] {
        self.solved().map_or(&[], |solved| &solved.check_points)
    }

    /// The best partial pattern of a refused run.
    pub fn best_pattern(&self) -> Option<&Pattern> {
        self.refused()?.best_pattern.as_ref()
    }

    /// The transform that places GCPs in the image: the solution's, or that of a refused run's best pattern.
    pub fn similarity(&self) -> Option<Similarity> {
        match &self.outcome {
            RunOutcome::Solved(solved) => solved.solution.as_ref().map(|s| s.similarity),
            RunOutcome::Refused(refused) => refused.best_pattern.as_ref().map(|p| p.similarity),
        }
    }

    /// Reads a document that a run has written.
    ///
    /// # Errors
    /// [`Error::Io`] when the file cannot be read, [`Error::Format`] when it is no such document,
    /// [`Error::Unsupported`] when it is of a later version.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = bounded::read(path, "a result", bounded::DOCUMENT_BYTES)?;
        let text = String::from_utf8(bytes).map_err(|e| Error::format(path, "its content", no_text(e.as_bytes())))?;
        let place = |e: &serde_json::Error| format!("line {}, column {}", e.line(), e.column());
        // What the parser expects next helps nobody who named another file.
        if !text.trim_start().starts_with('{') {
            let what = "no JSON, so no result of a run; name the NAME.autoref.json that a run wrote";
            return Err(Error::format(path, "line 1", what));
        }
        let value: serde_json::Value =
            serde_json::from_str(&text).map_err(|e| Error::format(path, place(&e), format!("no JSON: {e}")))?;
        match value.get("schema_version").and_then(serde_json::Value::as_u64) {
            None => return Err(Error::format(path, "schema_version", "it is missing: this is no result of a run")),
            Some(version) if version > u64::from(SCHEMA_VERSION) => {
                let what = format!("a result of schema version {version}");
                return Err(Error::unsupported(path, what, "use the program that wrote it, or a later one"));
            }
            Some(_) => {}
        }
        serde_json::from_str(&text).map_err(|e| Error::format(path, place(&e), e.to_string()))
    }

    /// The document as text.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("no map keys but strings, no failing serialiser");
        text.push('\n');
        text
    }
}
