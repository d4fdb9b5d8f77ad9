//! The main job: an image and a list of GCPs in, a georeference out.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context;
use autoref_raster::RasterInfo;
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;
use autoref_raster::memory_plan;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::{self, GcpList};
use autoref_stream::georef::dialects;
use autoref_stream::georef::write::{Output, WriteRequest};
use autoref_stream::matching::diagnosis::Diagnosis;
use autoref_stream::matching::{Effort, Evidence, Pattern, Priors, TimeLimit};
use autoref_stream::pipeline::MarkDetector;
use autoref_stream::pipeline::colour_search::{ColourSearch, MOST_CLUSTERS, colour_search};
use autoref_stream::pipeline::georeference::{FoundMark, Job, Orientation, Outcome, Refine, Run, georeference};
use autoref_stream::pipeline::picture::unusual;
use autoref_stream::pipeline::reasons::reasons;
use autoref_stream::pipeline::second_pass::{SecondPass, look_closer, second_pass};
use autoref_stream::report::Gathered;
use autoref_stream::result::{
    FitFigures, ImageInfo, LEAST_MISFIT_PX, MatchRow, PriorGeoreference, Reading, RefusedRun, RunOutcome, RunResult,
    SolvedRun, Status, Timings, residual_rms_px,
};
use clap::Args;

use crate::cli::common::{self, GcpArgs, MarkArgs, MatchArgs, PaintArg, Prepared, ReadArgs, word_of};
use crate::cli::progress::Bar;
use crate::cli::report::{self, ReportArgs, Watch};
use crate::cli::solving::{self, SolvingArgs};
use crate::cli::summary::{Detail, summary};
use crate::cli::working_crs;
use crate::cli::write::{self, WriteArgs};
use crate::cli::{accuracy, diagnosis};

/// Flags of the main job.
#[derive(Args, Debug)]
pub struct RunArgs {
    /// The orthophoto: any raster that GDAL opens.
    // An option only because a subcommand does without; clap demands it otherwise.
    #[arg(required = true)]
    pub image: Option<PathBuf>,
    #[command(flatten)]
    pub gcps: GcpArgs,
    #[command(flatten)]
    pub marks: MarkArgs,
    #[command(flatten)]
    pub paint: PaintArg,
    #[command(flatten)]
    pub matching: MatchArgs,
    #[command(flatten)]
    pub solving: SolvingArgs,
    #[command(flatten)]
    pub write: WriteArgs,
    #[command(flatten)]
    pub report: ReportArgs,
    /// Print the result as one JSON document on standard output; all else goes to stderr.
    #[arg(long, help_heading = "Output")]
    pub json: bool,
    /// Learn the marks from what was found and look again: never; when points stay unmatched or nothing is solved; or
    /// always, by a second scan. Without a word it is `always`.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto", default_missing_value = "always", num_args = 0..=1,
        require_equals = true, help_heading = "Marks")]
    pub second_pass: SecondPassArg,
    /// Look again, in a window of its own, where every point must be: always; or never, so that the first match stands
    /// as it is (the tables of the 2016 thesis). `never` looks no second time in any other way either.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "always", help_heading = "Matching")]
    pub refine: RefineArg,
    /// No progress bar, no summary.
    #[arg(long, help_heading = "Messages")]
    pub quiet: bool,
    #[command(flatten)]
    pub read: ReadArgs,
}

/// When the second pass is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SecondPassArg {
    Never,
    Auto,
    Always,
}

/// Whether points are looked for again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RefineArg {
    Always,
    Never,
}

impl RefineArg {
    fn choice(self) -> Refine {
        match self {
            RefineArg::Always => Refine::Always,
            RefineArg::Never => Refine::Never,
        }
    }
}

/// Scans, matches and solves as [`run`] does at its first look, and writes nothing.
pub fn first_look(args: &RunArgs) -> anyhow::Result<RunResult> {
    autoref_raster::initialise_gdal(memory_plan::cache_share_bytes(args.read.memory.0));
    let image = args.image.as_deref().context("no image: name one")?;
    let gcp_file = args.gcps.path()?;
    let marks = args.paint.of(&args.marks);
    let Prepared { source, detector, plan, .. } = common::prepare(image, &args.read, &marks, args.matching.gsd)?;
    let list = gcp::read(gcp_file, &args.gcps.options(Some(source.info())))?;
    args.solving.check(Existing::Keep)?;
    let info = source.info();
    let priors = common::priors(info, &args.matching);
    let matcher = common::matcher(&args.matching, priors.len(), &args.matching.limit())?;
    let bar = Bar::new(info, args.quiet || args.json);
    let refiner = detector.relaxed();
    let run = georeference(&Job {
        source: source.as_ref(),
        plan: &plan,
        detector: detector.as_detector(),
        refiner: refiner.as_detector(),
        gcps: &list.gcps,
        matcher: matcher.as_ref(),
        priors: &priors,
        progress: &bar,
        refine: args.refine.choice(),
    })?;
    bar.finish();
    let mut document = Document::new(&list, gcp_file, &run.outcome, run.scan.candidates);
    args.solving.apply(&mut document.result, &run.outcome, &list, &solving::ImagePlace::of(info))?;
    Ok(document.result)
}

pub fn run(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let started = Instant::now();
    autoref_raster::initialise_gdal(memory_plan::cache_share_bytes(args.read.memory.0));
    let image = args.image.as_deref().context("no image: name one")?;
    let gcp_file = args.gcps.path()?;
    let marks = args.paint.of(&args.marks);
    let opening = tracing::info_span!("open").entered();
    let Prepared { source, detector, plan, .. } = common::prepare(image, &args.read, &marks, args.matching.gsd)?;
    let list = gcp::read(gcp_file, &args.gcps.options(Some(source.info())))?;
    drop(opening);
    let request = args.write.request(image, args.read.page, args.read.memory.0, common::threads(args.read.threads))?;
    dialects::check(&request.kinds, image, list.crs.as_ref(), &list.gcps)?;
    let json = json_path(&request);
    let report = args.report.wanted().then(|| report::path(&json));
    let existing = Existing::of_flag(args.write.overwrite);
    let outputs: Vec<&Path> = [Some(&json), report.as_ref()].into_iter().flatten().map(PathBuf::as_path).collect();
    atomic::check_outputs(&outputs, existing)?;
    args.solving.check(existing)?;
    let open_s = started.elapsed().as_secs_f64();
    let info = source.info();
    let priors = common::priors(info, &args.matching);
    // Colours can be learned from the image for a second pass, and looked for in any hue: more chances for an accident.
    // The first look has half of what is allowed, the second a quarter, all clusters of colour together the last.
    let learns = matches!(detector, MarkDetector::Paint(_))
        && args.second_pass != SecondPassArg::Never
        && args.refine == RefineArg::Always;
    let time_limit = args.matching.limit();
    let matcher_of = |chances: usize| common::matcher(&args.matching, priors.len() * chances, &time_limit);
    let (matcher, learned_matcher) = (matcher_of(if learns { 2 } else { 1 })?, matcher_of(4)?);
    let cluster_matcher = matcher_of(4 * MOST_CLUSTERS)?;
    let bar = Bar::new(info, args.quiet || args.json);
    let watch = Watch::new(&bar, source.as_ref(), detector.as_detector(), &args.report);
    let refiner = detector.relaxed();
    let job = Job {
        source: source.as_ref(),
        plan: &plan,
        detector: detector.as_detector(),
        refiner: refiner.as_detector(),
        gcps: &list.gcps,
        matcher: matcher.as_ref(),
        priors: &priors,
        progress: &watch,
        refine: args.refine.choice(),
    };
    let mut looked = Looked { run: georeference(&job)?, second: None, colours: None };
    if learns {
        let learned = Job { matcher: learned_matcher.as_ref(), ..job };
        let in_any_hue = Job { matcher: cluster_matcher.as_ref(), ..job };
        looked = looked.again(args.second_pass, &learned, &in_any_hue)?;
    }
    let Looked { mut run, second, colours } = looked;
    diagnose(args, &mut run, &list, (info, &priors[0]), &time_limit);
    let mut document = Document::new(&list, gcp_file, &run.outcome, run.scan.candidates.clone());
    if let (Outcome::Solved(orientation), Some(solved)) = (&run.outcome, document.result.solved_mut()) {
        solved.not_found = reasons(Some(source.as_ref()), orientation, &list.gcps, &run.scan.candidates)?;
    }
    document.result.options = options(args, &job);
    document.describe_reading(info, &run, source.stats(), open_s);
    document.result.second_pass = second;
    advise(&mut document.result, colours, source.as_ref())?;
    document.result.memory_plan = Some(plan.clone());
    let place = solving::ImagePlace::of(info);
    let dem = args.solving.apply(&mut document.result, &run.outcome, &list, &place)?;
    accuracy::state(&mut document.result, &list, &args.gcps.accuracy, (info.width as f64, info.height as f64));
    working_crs::deliver(&mut document.result, &list, place.size_px)?;
    document.result.warnings.extend(plan.notes.iter().cloned());
    document.prior(info, &list);
    let report_started = Instant::now();
    let gathered = tracing::info_span!("report").in_scope(|| watch.gather(&mut document.result))?;
    document.result.timings.report_s = report_started.elapsed().as_secs_f64();
    bar.finish();
    // Its caches make room for what writing needs.
    drop(source);
    let report = report.as_deref().zip(gathered.as_ref());
    write_outputs(&request, &json, report, &mut document, started, args.quiet || args.json, dem)?;
    print(&document.result, args.json, args.quiet);
    Ok(document.exit_code())
}

/// Looks for gross errors of the list.
fn diagnose(
    args: &RunArgs,
    run: &mut Run,
    list: &GcpList,
    (info, priors): (&RasterInfo, &Priors),
    time_limit: &TimeLimit,
) {
    let known = diagnosis::known_place(info, list);
    let (matching, forced) = ((&args.matching, time_limit), &args.gcps.working_crs.force);
    tracing::info_span!("gross-error diagnosis").in_scope(|| {
        diagnosis::examine(&mut run.outcome, &run.scan.candidates, list, priors, known, matching, forced);
    });
}

/// Adds what the search over colours found, and what is unusual about a picture that was refused.
fn advise(
    result: &mut RunResult,
    colours: Option<ColourSearch>,
    source: &dyn autoref_raster::RasterSource,
) -> anyhow::Result<()> {
    if let Some(search) = &colours {
        result.advice.extend(search.advice());
        result.warnings.extend(search.note());
    }
    result.colour_search = colours;
    if result.refused().is_some() {
        result.advice.extend(unusual(source)?.iter().map(ToString::to_string));
    }
    Ok(())
}

/// What the looks at the image gave.
struct Looked {
    run: Run,
    second: Option<SecondPass>,
    colours: Option<ColourSearch>,
}

impl Looked {
    /// Looks again with the colours that the image taught, and where that is refused or fits badly, for paint of any
    /// hue.
    ///
    /// # Errors
    /// When the image cannot be read.
    fn again(self, second_pass_arg: SecondPassArg, learned: &Job<'_>, in_any_hue: &Job<'_>) -> anyhow::Result<Looked> {
        let _span = tracing::info_span!("second pass and colour search").entered();
        let refused = matches!(self.run.outcome, Outcome::Refused(_));
        let (run, second) = if refused || second_pass_arg == SecondPassArg::Always {
            second_pass(learned, self.run)?
        } else {
            look_closer(learned, self.run)?
        };
        match &run.outcome {
            Outcome::Refused(_) => {
                let (run, colours) = colour_search(in_any_hue, run)?;
                Ok(Looked { run, second, colours })
            }
            // The profile may have taken parts of marks of another paint.
            Outcome::Solved(found) if residuals_px(found) >= LEAST_MISFIT_PX => {
                let (other, colours) = colour_search(in_any_hue, run.clone())?;
                let better = matches!(&other.outcome, Outcome::Solved(other)
                    if other.marks.len() >= found.marks.len() && residuals_px(other) < PARTS_LEAVE * residuals_px(found));
                let (run, colours) = if better { (other, colours) } else { (run, None) };
                Ok(Looked { run, second, colours })
            }
            Outcome::Solved(_) => Ok(Looked { run, second, colours: None }),
        }
    }
}

/// Whole marks leave less than this share of the residuals of their parts.
const PARTS_LEAVE: f64 = 0.5;

fn residuals_px(found: &Orientation) -> f64 {
    residual_rms_px(found.solution.pairs.iter().map(|pair| pair.residual_px), 2.0)
}

fn json_path(request: &WriteRequest) -> PathBuf {
    request.base.with_extension("autoref.json")
}

fn options(args: &RunArgs, job: &Job<'_>) -> serde_json::Value {
    serde_json::json!({
        "profile": args.paint.of(&args.marks).profile,
        "second_pass": word_of(args.second_pass),
        "refine": word_of(args.refine),
        "mark_size": args.marks.mark_size.map(|size| size.to_string()),
        "priors": job.priors,
        "max_false_alarms": args.matching.max_false_alarms,
        "allow_mirrored": args.matching.allow_mirrored,
        "tile": args.read.tile,
        "threads": args.read.threads,
        "memory_budget_bytes": args.read.memory.0,
        "reader": args.read.reader.choice().name(),
        "page": args.read.page,
        "white": job.source.info().white,
        "halo_px": job.detector.halo_px(),
        "check": args.gcps.check,
        "accuracy": args.gcps.accuracy.accuracy,
        "accuracy_class_m": args.gcps.accuracy.accuracy_class,
        "names": args.gcps.names,
    })
}

/// All outputs and the JSON that lists them appear together, or nothing does.
fn write_outputs(
    request: &WriteRequest,
    json: &Path,
    report: Option<(&Path, &Gathered)>,
    document: &mut Document,
    started: Instant,
    quiet: bool,
    dem: Option<solving::DemCopy>,
) -> anyhow::Result<()> {
    let writing = Instant::now();
    let _span = tracing::info_span!("write").entered();
    let mut transaction = Transaction::new();
    if document.result.solved().is_some() {
        let bar = write::WarpBar::new(request.wants(Output::Warp) && !quiet);
        let warnings = request.stage(&document.result, &mut transaction, &|done| bar.set(done))?;
        document.result.warnings.extend(warnings);
    }
    if let Some(dem) = dem {
        dem.stage(&document.result, &mut transaction)?;
    }
    let written = transaction.paths();
    document.result.files_written = written
        .iter()
        .map(PathBuf::as_path)
        .chain(report.map(|r| r.0))
        .chain([json])
        .map(|path| path.display().to_string())
        .collect();
    document.result.timings.write_s = writing.elapsed().as_secs_f64();
    document.finish(started);
    if let Some((path, gathered)) = report {
        transaction.stage_bytes(path, report::page(&document.result, gathered, json)?.as_bytes())?;
    }
    transaction.stage_bytes(json, document.result.to_json().as_bytes())?;
    Ok(transaction.commit()?)
}

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
            search_cut: evidence.search.search_cut,
            search: Some(evidence.search),
            prior_georeference: None,
            diagnoses: evidence.diagnoses,
            warnings: list.notes.clone(),
            patch: None,
            files_written: Vec::new(),
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
        if let Some(effort) = result.search.as_ref().filter(|effort| effort.search_cut) {
            result.warnings.push(format!(
                "--time-limit ended the search after {} of {:.3e} hypotheses",
                effort.hypotheses_tried, effort.hypotheses_possible
            ));
        }
        Document { result }
    }

    fn describe_reading(&mut self, info: &RasterInfo, run: &Run, all: autoref_raster::ReadStats, open_s: f64) {
        self.result.image = Some(ImageInfo {
            path: info.path.display().to_string(),
            width: info.width,
            height: info.height,
            bands: info.bands,
            reader: info.reader.to_string(),
            description: info.description.clone(),
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

    /// An existing georeference is reported, with how far the new one moves the image.
    fn prior(&mut self, info: &RasterInfo, list: &GcpList) {
        let Some(old) = info.geotransform else { return };
        let same_crs = match (&info.crs_wkt, &list.crs) {
            (Some(wkt), Some(crs)) if !crs.is_geographic() => {
                Crs::parse(wkt).is_ok_and(|old| old.label() == crs.label())
            }
            _ => false,
        };
        let centre = PixelPoint { x: info.width as f64 / 2.0, y: info.height as f64 / 2.0 };
        let moved_m = self.result.geotransform().filter(|_| same_crs).map(|new| {
            let (a, b) = (old.apply(centre), new.apply(centre));
            (a.easting - b.easting).hypot(a.northing - b.northing)
                * list.crs.as_ref().map_or(1.0, |crs| crs.metres_per_unit())
        });
        if self.result.solved().is_some() {
            self.result.warnings.push(match moved_m {
                Some(moved) => format!("the image's own georeference is overridden; its centre moves by {moved:.3} m"),
                None => "the image's own georeference is overridden".into(),
            });
        }
        self.result.prior_georeference =
            Some(PriorGeoreference { geotransform: old, crs: info.crs_wkt.clone(), moved_m });
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

/// Check points that are much farther off than the others are flagged; they count all the same.
fn check_rows(orientation: &Orientation, list: &GcpList) -> Vec<MatchRow> {
    /// So many times the deviation that half of them have.
    const TIMES: f64 = 4.5;
    let mut rows: Vec<MatchRow> = orientation.check_marks.iter().map(|mark| row(mark, orientation, list)).collect();
    let mut lengths_px: Vec<f64> = rows.iter().map(|row| row.residual_px).collect();
    lengths_px.sort_by(f64::total_cmp);
    // The half of a pair is its better one.
    let Some(half) = lengths_px.get(lengths_px.len().saturating_sub(1) / 2) else { return rows };
    let limit_px = (TIMES * half / 1.1774).max(LEAST_MISFIT_PX);
    rows.iter_mut().for_each(|row| row.outlier = row.residual_px > limit_px);
    rows
}

/// What a person should know of the fit.
fn fit_notes(result: &RunResult, orientation: &Orientation, list: &GcpList) -> Vec<String> {
    let mut notes = orientation.solution.warnings.clone();
    let checks = result.solved().map_or(&[][..], |solved| &solved.check_points);
    let all = result.matches().iter().chain(checks);
    let outliers: Vec<&str> = all.filter(|m| m.outlier).map(|m| m.gcp.as_str()).collect();
    if !outliers.is_empty() {
        notes.push(format!("look at {}: mark or survey may be wrong", outliers.join(", ")));
    }
    notes.extend(near_misses(&result.candidates, orientation, list));
    notes
}

/// How a doubt begins about a point whose mark is missing.
pub const NO_MARK_THERE: &str = "no mark where it must be";

/// GCPs without a mark where it must be, but with one not far off: mark or survey may be wrong, and by how much.
fn near_misses(candidates: &[Candidate], orientation: &Orientation, list: &GcpList) -> Vec<String> {
    const NEAR_PX: f64 = 60.0;
    let solution = &orientation.solution;
    let all = || orientation.marks.iter().chain(&orientation.check_marks);
    let taken = |c: &Candidate| all().any(|found| found.mark.centre == c.centre);
    orientation
        .not_found
        .iter()
        .filter_map(|&gcp| {
            let place = solution.similarity.invert(list.gcps[gcp].position());
            let distance = |c: &Candidate| (c.centre.x - place.x).hypot(c.centre.y - place.y);
            let nearest = candidates
                .iter()
                .filter(|c| !taken(c))
                .map(distance)
                .filter(|d| *d < NEAR_PX)
                .min_by(f64::total_cmp)?;
            Some(format!(
                "{}: {NO_MARK_THERE}, but one {nearest:.1} px = {:.3} m beside it; mark or survey may be wrong",
                list.gcps[gcp].name,
                nearest * solution.scale_m_per_px
            ))
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

/// The summary a surveyor reads, or the document.
pub fn print(result: &RunResult, json: bool, quiet: bool) {
    if json {
        print!("{}", result.to_json());
    }
    if quiet {
        return;
    }
    let detail = if tracing::enabled!(tracing::Level::INFO) { Detail::Full } else { Detail::Brief };
    let text = summary(result, detail);
    if json { eprint!("{text}") } else { print!("{text}") }
}
