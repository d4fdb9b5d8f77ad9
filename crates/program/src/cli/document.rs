//! The document of a run, put together from what the search found.

use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use autoref_raster::RasterInfo;
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::crs::{Coordinate, Crs, DEFAULT_DATUM_ACCURACY_M};
use autoref_raster::memory_plan;
use autoref_raster::words::counted;
use autoref_stream::candidate::{Candidate, least_whole_area_px};
use autoref_stream::gcp::GcpList;
use autoref_stream::georef::shown::Found;
use autoref_stream::matching::diagnosis::Diagnosis;
use autoref_stream::matching::{Effort, Evidence, Pattern, SearchEnd};
use autoref_stream::pipeline::georeference::{FoundMark, Orientation, Outcome, Run};
use autoref_stream::pipeline::reasons::reasons;
use autoref_stream::result::{
    FitFigures, ImageInfo, LEAST_MISFIT_PX, MatchRow, PriorGeoreference, Reading, RefusedRun, RunOutcome, RunResult,
    SolvedRun, Status, Timings, Warning,
};

use crate::cli::overridden::Overridden;

/// A result under construction.
pub struct Document {
    pub result: RunResult,
}

impl Document {
    pub fn new(list: &GcpList, gcp_file: &Path, outcome: &Outcome, candidates: Vec<Candidate>) -> Self {
        let (came_of_it, evidence) = match outcome {
            Outcome::Solved(orientation) => {
                let solved = solved(orientation, list, &candidates);
                (RunOutcome::Solved(Box::new(solved)), Searched::of_solved(orientation))
            }
            Outcome::Refused(evidence) => {
                let refused = RefusedRun { reason: evidence.reason.clone(), best_pattern: evidence.best.clone() };
                (RunOutcome::Refused(Box::new(refused)), Searched::of_refused(evidence))
            }
        };
        let mut result = RunResult {
            program: format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
            outcome: came_of_it,
            advice: evidence.advice,
            image: None,
            gcp_file: gcp_file.display().to_string(),
            options: serde_json::Value::Null,
            crs: list.crs.as_ref().map(autoref_raster::crs::Crs::label),
            gcps_listed: list.gcps.len(),
            gcps: list.gcps.clone(),
            delivered: !list.working_crs.is_plain(),
            candidates_found: candidates.len(),
            candidates,
            log10_false_alarms: evidence.log10_false_alarms,
            runner_up: evidence.runner_up,
            search_cut: evidence.search.ended == SearchEnd::TimeLimit,
            search: Some(evidence.search),
            prior_georeference: None,
            diagnoses: evidence.diagnoses,
            warnings: list.notes.iter().cloned().map(Warning::Said).collect(),
            run_pattern: None,
            patch: None,
            files_written: Vec::new(),
            files_standing: Vec::new(),
            reading: None,
            second_pass: None,
            colour_search: None,
            memory_plan: None,
            timings: Timings::default(),
            peak_memory_bytes: None,
            elapsed_s: 0.0,
        };
        if let Outcome::Solved(orientation) = outcome {
            let notes = fit_notes(&result, orientation, list);
            result.warnings.extend(notes);
        }
        if let Some(effort) = result.search.as_ref().filter(|effort| effort.ended == SearchEnd::TimeLimit) {
            let said = format!(
                "--time-limit ended the search after {} of {:.3e} hypotheses",
                effort.hypotheses_tried, effort.hypotheses_possible
            );
            result.warn(said);
        }
        Document { result }
    }

    pub(super) fn describe_reading(
        &mut self,
        info: &RasterInfo,
        run: &Run,
        all: autoref_raster::ReadStats,
        open_s: f64,
    ) {
        self.result.image = Some(ImageInfo {
            path: info.path.display().to_string(),
            width: info.width,
            height: info.height,
            bands: info.bands,
            reader: info.reader.to_string(),
            description: info.description.clone(),
            from_result: None,
        });
        let scan = run.scan.scan_reads;
        self.result.reading = Some(Reading {
            blocks_in_file: info.blocks,
            blocks_decoded: scan.blocks_decoded,
            blocks_skipped: scan.blocks_skipped,
            bytes_read: scan.bytes_read,
            window_blocks_decoded: all.blocks_decoded - scan.blocks_decoded,
            window_bytes_read: all.bytes_read - scan.bytes_read,
        });
        let timings = &mut self.result.timings;
        timings.open_s = open_s;
        timings.scan_s = run.scan.timings.scan_s;
        timings.examine_s = run.scan.timings.examine_s;
        timings.match_s = run.match_s;
        timings.rematch_s = run.rematch_s;
    }

    /// An existing georeference is reported, with how far the new one moves the image; not one that an earlier run has
    /// `written`. `found`: where GDAL finds the new one.
    pub(super) fn prior(&mut self, info: &RasterInfo, written: Option<GeoTransform>, list: &GcpList, found: &Found) {
        let Some(old) = info.geotransform.filter(|old| written != Some(*old)) else { return };
        let size = (info.width, info.height);
        let here = list.crs.as_ref().filter(|crs| !crs.is_geographic()).and_then(|crs| {
            let of_image = Crs::parse(info.crs_wkt.as_deref()?).ok()?;
            if of_image.label() == crs.label() { Some(old) } else { brought(&old, size, &of_image, crs) }
        });
        let per_unit = list.crs.as_ref().map_or(1.0, |crs| crs.metres_per_unit());
        let change =
            self.result.geotransform().zip(here).map(|(new, here)| Overridden::between(&here, &new, size, per_unit));
        if self.result.solved().is_some() {
            let said = match &change {
                Some(change) => Some(change.note(found)),
                None => Overridden::plain(found).map(str::to_owned),
            };
            self.result.warnings.extend(said.map(Warning::Said));
        }
        self.result.prior_georeference = Some(PriorGeoreference {
            geotransform: old,
            crs: info.crs_wkt.clone(),
            moved_m: change.as_ref().map(|change| change.centre_moved_m),
            corner_moved_m: change.as_ref().map(|change| change.corner_moved_m),
        });
    }

    pub fn finish(&mut self, started: Instant) {
        self.result.peak_memory_bytes = memory_plan::peak_resident_bytes();
        self.result.elapsed_s = started.elapsed().as_secs_f64();
    }

    pub fn exit_code(&self) -> ExitCode {
        match self.result.status() {
            Status::Solved => ExitCode::SUCCESS,
            Status::Refused => ExitCode::from(1),
        }
    }
}

/// What the search leaves on record, whether it was believed or not.
struct Searched {
    advice: Vec<String>,
    log10_false_alarms: Option<f64>,
    runner_up: Option<Pattern>,
    search: Effort,
    diagnoses: Vec<Diagnosis>,
}

impl Searched {
    fn of_solved(orientation: &Orientation) -> Self {
        Searched {
            advice: orientation.diagnoses.iter().map(|d| d.message.clone()).collect(),
            log10_false_alarms: Some(orientation.evidence.pattern.log10_false_alarms),
            runner_up: orientation.evidence.runner_up.clone(),
            search: orientation.evidence.effort.clone(),
            diagnoses: orientation.diagnoses.clone(),
        }
    }

    fn of_refused(evidence: &Evidence) -> Self {
        Searched {
            advice: evidence.advice.clone(),
            log10_false_alarms: evidence.best.as_ref().map(|p| p.log10_false_alarms),
            runner_up: evidence.runner_up.clone(),
            search: evidence.effort.clone(),
            diagnoses: evidence.diagnoses.clone(),
        }
    }
}

/// A georeference in another system, by three corners of the image.
fn brought(old: &GeoTransform, (width, height): (u64, u64), from: &Crs, to: &Crs) -> Option<GeoTransform> {
    let size = (width as f64, height as f64);
    let corners = [(0.0, 0.0), (size.0, 0.0), (0.0, size.1)].map(|(x, y)| old.apply(PixelPoint { x, y }));
    let mut places = corners.map(|p| Coordinate { x: p.easting, y: p.northing, height: None });
    from.transform(&mut places, to, DEFAULT_DATUM_ACCURACY_M).ok()?;
    let [origin, right, down] = places.map(|p| MapPoint { easting: p.x, northing: p.y });
    Some(GeoTransform::through(origin, right, down, size))
}

fn solved(orientation: &Orientation, list: &GcpList, candidates: &[Candidate]) -> SolvedRun {
    let solution = &orientation.solution;
    let matches = orientation
        .marks
        .iter()
        .zip(&solution.pairs)
        .map(|(mark, pair)| {
            let mut row = row(mark, orientation, list);
            row.leave_one_out_m = pair.leave_one_out_e_m.zip(pair.leave_one_out_n_m).map(|(e, n)| e.hypot(n));
            row.redundancy = Some(pair.redundancy);
            row.detectable_blunder_m = pair.detectable_blunder_m;
            row.outlier = pair.outlier;
            row
        })
        .collect();
    let name = |&i: &usize| list.gcps[i].name.clone();
    SolvedRun {
        geotransform: solution.geotransform,
        fit: FitFigures::from(solution),
        chosen_model: None,
        matches,
        check_points: check_rows(orientation, list),
        gcps_in_image: orientation.marks.len() + orientation.check_marks.len() + orientation.not_found.len(),
        not_found: reasons(None, orientation, &list.gcps, candidates).unwrap_or_default(),
        outside: orientation.outside.iter().map(name).collect(),
        names: orientation.evidence.names,
        accuracy: None,
        expected_errors: Vec::new(),
        heights: None,
        solution: Some(solution.clone()),
    }
}

fn check_rows(orientation: &Orientation, list: &GcpList) -> Vec<MatchRow> {
    let mut rows: Vec<MatchRow> = orientation.check_marks.iter().map(|mark| row(mark, orientation, list)).collect();
    flag_far(&mut rows);
    rows
}

/// Check points that are much farther off than the others are flagged; they count all the same.
pub fn flag_far(rows: &mut [MatchRow]) {
    /// So many times the deviation that half of them have.
    const TIMES: f64 = 4.5;
    let mut lengths_px: Vec<f64> = rows.iter().map(|row| row.residual_px).collect();
    lengths_px.sort_by(f64::total_cmp);
    // The half of a pair is its better one.
    let Some(half) = lengths_px.get(lengths_px.len().saturating_sub(1) / 2) else { return };
    let limit_px = (TIMES * half / 1.1774).max(LEAST_MISFIT_PX);
    rows.iter_mut().for_each(|row| row.outlier = row.residual_px > limit_px);
}

/// The points of the fit and of the test that fit badly.
pub fn to_look_at(result: &RunResult) -> Option<Warning> {
    let checks = result.solved().map_or(&[][..], |solved| &solved.check_points);
    let all = result.matches().iter().chain(checks);
    let points: Vec<String> = all.filter(|row| row.outlier).map(|row| row.gcp.clone()).collect();
    (!points.is_empty()).then_some(Warning::LookAt { points })
}

/// What a person should know of the fit.
fn fit_notes(result: &RunResult, orientation: &Orientation, list: &GcpList) -> Vec<Warning> {
    let mut notes: Vec<Warning> = orientation.solution.warnings.iter().cloned().map(Warning::Said).collect();
    notes.extend(to_look_at(result));
    notes.extend(near_misses(&result.candidates, orientation, list));
    notes.extend(other_pattern(orientation).map(Warning::Said));
    notes
}

/// A second pattern of other marks that would be believed, were it alone: old marks beside new ones. One that lies on
/// the marks of the first is a row or a grid that repeats itself, and was told apart.
fn other_pattern(orientation: &Orientation) -> Option<String> {
    const BELIEVED_LOG10: f64 = -4.0;
    let best = &orientation.evidence.pattern;
    let other = orientation.evidence.runner_up.as_ref().filter(|other| other.log10_false_alarms <= BELIEVED_LOG10)?;
    let is_joined = |candidate: usize| best.pairs.iter().any(|pair| pair.0 == candidate);
    let shared = other.pairs.iter().filter(|pair| is_joined(pair.0)).count();
    (2 * shared < other.pairs.len()).then(|| {
        format!(
            "{} of this list fit other marks of the image, too, and would be believed if these were all (10^{:.1}): where \
             marks of two surveys are in the image, look whether those found are the right ones",
            counted(other.pairs.len(), "point", "points"),
            other.log10_false_alarms
        )
    })
}

/// GCPs without a mark where it must be, but with one not far off: mark or survey may be wrong, and by how much.
fn near_misses(candidates: &[Candidate], orientation: &Orientation, list: &GcpList) -> Vec<Warning> {
    const NEAR_PX: f64 = 60.0;
    let solution = &orientation.solution;
    let all = || orientation.marks.iter().chain(&orientation.check_marks);
    let taken = |c: &Candidate| all().any(|found| found.mark.centre == c.centre);
    let least_area_px = least_whole_area_px(all().map(|found| &found.mark));
    let is_whole = |c: &Candidate| c.area_px.is_none_or(|area| area >= least_area_px);
    orientation
        .not_found
        .iter()
        .filter_map(|&gcp| {
            let place = solution.similarity.invert(list.gcps[gcp].position());
            let distance = |c: &Candidate| (c.centre.x - place.x).hypot(c.centre.y - place.y);
            let off_px = candidates
                .iter()
                .filter(|c| !taken(c) && is_whole(c))
                .map(distance)
                .filter(|d| *d < NEAR_PX)
                .min_by(f64::total_cmp)?;
            let (point, off_m) = (&list.gcps[gcp], off_px * solution.scale_m_per_px);
            let within_sigma_m = point.sigma_m.filter(|_| off_m <= point.reach_m());
            Some(Warning::NearMiss { gcp: point.name.clone(), off_px, off_m, within_sigma_m })
        })
        .collect()
}

fn row(found: &FoundMark, orientation: &Orientation, list: &GcpList) -> MatchRow {
    let gcp = &list.gcps[found.gcp];
    let computed = orientation.solution.similarity.apply(found.mark.centre);
    let (e, n) = (gcp.easting - computed.easting, gcp.northing - computed.northing);
    MatchRow {
        gcp: gcp.name.clone(),
        x: found.mark.centre.x,
        y: found.mark.centre.y,
        easting: gcp.easting,
        northing: gcp.northing,
        height: gcp.height,
        survey_sigma_m: gcp.sigma_m,
        survey_sigma_height_m: gcp.sigma_height_m,
        residual_e_m: e,
        residual_n_m: n,
        residual_px: e.hypot(n) / orientation.solution.scale_m_per_px,
        covariance_px2: found.mark.covariance_px2,
        score: found.mark.score,
        found_by: found.found_by,
        leave_one_out_m: None,
        redundancy: None,
        detectable_blunder_m: None,
        outlier: false,
        code: found.mark.code.clone(),
    }
}
