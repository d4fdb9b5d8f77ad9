//! The main job: an image and a list of GCPs in, a georeference out.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use anyhow::Context;
use autoref_raster::RasterInfo;
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::coords::GeoTransform;
use autoref_raster::error::Error;
use autoref_raster::memory_plan;
use autoref_raster::path_text::quoted;
use autoref_raster::protected::same_file;
use autoref_stream::gcp::{self, GcpList};
use autoref_stream::georef::output::Output;
use autoref_stream::georef::standing::standing;
use autoref_stream::georef::write::WriteRequest;
use autoref_stream::georef::{beneath, dialects};
use autoref_stream::matching::{Matcher, Priors, RobustMatcher, TimeLimit};
use autoref_stream::pipeline::MarkDetector;
use autoref_stream::pipeline::colour_search::{ColourSearch, MOST_CLUSTERS, colour_search};
use autoref_stream::pipeline::georeference::{Job, Orientation, Outcome, Refine, Run, georeference};
use autoref_stream::pipeline::picture::unusual;
use autoref_stream::pipeline::reasons::reasons;
use autoref_stream::pipeline::second_pass::{SecondPass, look_closer, second_pass};
use autoref_stream::profile::Profile;
use autoref_stream::report::Gathered;
use autoref_stream::result::{LEAST_MISFIT_PX, RunResult, Warning, residual_rms_px};
use clap::Args;

use crate::cli::args::{GcpArgs, MarkArgs, MatchArgs, PaintArg, ReadArgs};
use crate::cli::document::Document;
use crate::cli::prepare::{self, Prepared, Shared};
use crate::cli::progress::{Bar, Telling};
use crate::cli::recorded_image::from_result;
use crate::cli::report::{self, ReportArgs, Watch};
use crate::cli::solving::{self, SolvingArgs};
use crate::cli::summary::{Detail, summary};
use crate::cli::values::word_of;
use crate::cli::working_crs;
use crate::cli::write::{self, WriteArgs};
use crate::cli::{accuracy, diagnosis};

/// Flags of the main job.
#[derive(Args, Debug)]
pub struct RunArgs {
    #[command(flatten)]
    pub look: LookArgs,
    #[command(flatten)]
    pub write: WriteArgs,
    #[command(flatten)]
    pub report: ReportArgs,
    /// Learn the marks from what was found and look again: never; when points stay unmatched or nothing is solved; or
    /// always, by a second scan. Without a word it is `always`.
    #[arg(long, value_enum, value_name = "WHEN", default_value = "auto", default_missing_value = "always", num_args = 0..=1,
        require_equals = true, help_heading = "Marks")]
    pub second_pass: SecondPassArg,
}

/// What a look at the image needs that finds the marks, matches and solves.
#[derive(Args, Debug)]
pub struct LookArgs {
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
    /// Print the result as one JSON document on standard output; all else goes to stderr.
    #[arg(long, help_heading = "Output")]
    pub json: bool,
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
pub fn first_look(args: &LookArgs) -> anyhow::Result<RunResult> {
    autoref_raster::initialise_gdal(memory_plan::cache_share_bytes(args.read.memory.0));
    let image = args.image.as_deref().context("no image: name one")?;
    let gcp_file = args.gcps.path()?;
    let marks = args.paint.of(&args.marks);
    let Prepared { source, written, detector, plan, asked, .. } =
        prepare::open(image, &args.read, &marks, args.matching.gsd)?;
    let list = gcp::read(gcp_file, &args.gcps.options(Some(source.info())))?;
    args.solving.check(Existing::Keep)?;
    let info = source.info();
    let priors = prepare::priors((info, written), &args.matching);
    let matcher = prepare::matcher(
        &args.matching,
        prepare::OwnWord::of((info, written), &args.matching),
        Shared { chances: priors.len(), part: 1 },
        &args.matching.limit(),
    )?;
    let bar = Bar::new(info, Telling::silent_if(args.quiet || args.json));
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
        asked: &asked,
    })?;
    bar.finish();
    let mut document = Document::new(&list, gcp_file, &run.outcome, run.scan.candidates);
    args.solving.apply(&mut document.result, &run.outcome, &list, &solving::ImagePlace::of(info, written))?;
    Ok(document.result)
}

pub fn run(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let started = Instant::now();
    autoref_raster::initialise_gdal(memory_plan::cache_share_bytes(args.look.read.memory.0));
    let image = args.look.image.as_deref().context("no image: name one")?;
    let gcp_file = args.look.gcps.path()?;
    let marks = args.look.paint.of(&args.look.marks);
    let opening = tracing::info_span!("open").entered();
    let Prepared { source, written, detector, plan, asked, .. } =
        prepare::open(image, &args.look.read, &marks, args.look.matching.gsd)?;
    let list = gcp::read(gcp_file, &args.look.gcps.options(Some(source.info())))?;
    accuracy::check_nssda(&args.look.gcps.accuracy, &list)?;
    drop(opening);
    let _folder = args.write.folder()?;
    let Outputs { request, json, report } = args.outputs(image, &list)?;
    let open_s = started.elapsed().as_secs_f64();
    let info = source.info();
    let priors = prepare::priors((info, written), &args.look.matching);
    let looks = args.looks(&detector)?;
    let time_limit = args.look.matching.limit();
    let own = prepare::OwnWord::of((info, written), &args.look.matching);
    let matchers = Matchers::of((&args.look.matching, own), priors.len(), list.gcps.len(), looks, &time_limit)?;
    let bar = Bar::new(info, Telling::silent_if(args.look.quiet || args.look.json));
    let watch = Watch::new(&bar, source.as_ref(), detector.as_detector(), &args.report);
    let refiner = detector.relaxed();
    let job = Job {
        source: source.as_ref(),
        plan: &plan,
        detector: detector.as_detector(),
        refiner: refiner.as_detector(),
        gcps: &list.gcps,
        matcher: matchers.first.as_ref(),
        priors: &priors,
        progress: &watch,
        refine: args.look.refine.choice(),
        asked: &asked,
    };
    let mut looked = Looked { run: georeference(&job)?, second: None, colours: None };
    if looks == Looks::WithOtherColours {
        let learned = Job { matcher: matchers.learned.as_ref(), ..job };
        let in_any_hue = Job { matcher: matchers.in_any_hue.as_ref(), ..job };
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
    advise(&mut document.result, colours, &list.hints, (source.as_ref(), &marks))?;
    document.result.memory_plan = Some(plan.clone());
    let place = solving::ImagePlace::of(info, written);
    let dem = args.look.solving.apply(&mut document.result, &run.outcome, &list, &place)?;
    accuracy::state(&mut document.result, &list, &args.look.gcps.accuracy, (info.width as f64, info.height as f64));
    working_crs::deliver(&mut document.result, &list, place.size_px)?;
    document.result.warnings.extend(plan.notes.iter().cloned().map(Warning::Said));
    say_where_it_lies(&mut document, &request, (info, written), &list)?;
    let report_started = Instant::now();
    let gathered = tracing::info_span!("report").in_scope(|| watch.gather(&mut document.result))?;
    document.result.timings.report_s = report_started.elapsed().as_secs_f64();
    bar.finish();
    // Its caches make room for what writing needs.
    drop(source);
    let report = report.as_deref().zip(gathered.as_ref());
    let telling = Telling::silent_if(args.look.quiet || args.look.json);
    write_outputs(&request, &json, report, &mut document, started, telling, dem)?;
    print(&document.result, Printing { json: args.look.json, quiet: args.look.quiet });
    Ok(document.exit_code())
}

/// Says what becomes of the georeference that the image had, and which file has the new one. `info`: the image as it
/// came; `written`: what an earlier run has put over that.
fn say_where_it_lies(
    document: &mut Document,
    request: &WriteRequest,
    (info, written): (&RasterInfo, Option<GeoTransform>),
    list: &GcpList,
) -> Result<(), Error> {
    // A note is not worth the run.
    let found = request.found(&document.result).unwrap_or(autoref_stream::georef::shown::Found::Unknown);
    document.prior(info, written, list, &found);
    if let Some(image) = &mut document.result.image {
        image.from_result = from_result(&info.path, &request.base);
    }
    if document.result.solved().is_some() {
        // First, since a brief summary has the first notes only.
        let to_open = request.what_to_open(&found)?.map(Warning::Said);
        document.result.warnings.splice(..0, to_open);
    } else {
        say_what_stands(&mut document.result, &request.image, &standing(request, written.as_ref()));
    }
    Ok(())
}

/// A refused run replaces no georeference: what an earlier one wrote stays in force, right or not.
fn say_what_stands(result: &mut RunResult, image: &Path, files: &[PathBuf]) {
    result.files_standing = files.iter().map(|file| file.display().to_string()).collect();
    if files.is_empty() {
        return;
    }
    let (tagged, beside): (Vec<&PathBuf>, Vec<&PathBuf>) = files.iter().partition(|file| same_file(file, image));
    let removed = (!beside.is_empty()).then(|| "remove these files if it is wrong".to_owned());
    let undone = tagged.first().map(|image| format!("autoref-stream undo {} takes back its tags", quoted(image)));
    let remedy: Vec<String> = removed.into_iter().chain(undone).collect();
    let said = format!(
        "what an earlier run wrote stays as it is, and so does the georeference in it: {}; {}",
        result.files_standing.join(", "),
        remedy.join("; ")
    );
    result.warnings.insert(0, Warning::Said(said));
}

/// How often a run may look at the image.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Looks {
    One,
    /// Colours can be learned from the image for a second pass, and looked for in any hue: more chances for an
    /// accident.
    WithOtherColours,
}

/// What a run will write.
struct Outputs {
    request: WriteRequest,
    json: PathBuf,
    report: Option<PathBuf>,
}

impl RunArgs {
    /// Asked before the image is looked at, so that nothing is found for nothing.
    ///
    /// # Errors
    /// When an output cannot be written, or is there and is to be kept.
    fn outputs(&self, image: &Path, list: &GcpList) -> anyhow::Result<Outputs> {
        let mut request = self.write.request(
            image,
            self.look.read.page,
            self.look.read.memory.0,
            prepare::threads(self.look.read.threads),
        )?;
        request.datum_accuracy_m = self.look.gcps.working_crs.datum_accuracy;
        request.check_local(list.crs.as_ref())?;
        if request.wants(Output::Exif) {
            request.check_place(list.crs.as_ref(), &working_crs::places(list)?)?;
        }
        dialects::check(&request.kinds, image, list.crs.as_ref(), &list.gcps)?;
        let json = beneath::result_path(&request.base);
        let report = self.report.wanted().then(|| report::path(&json));
        let existing = Existing::of_flag(self.write.overwrite);
        let outputs: Vec<&Path> = [Some(&json), report.as_ref()].into_iter().flatten().map(PathBuf::as_path).collect();
        atomic::check_outputs(&outputs, existing)?;
        self.look.solving.check(existing)?;
        Ok(Outputs { request, json, report })
    }

    /// # Errors
    /// When a second pass is asked for that cannot be.
    fn looks(&self, detector: &MarkDetector) -> Result<Looks, Error> {
        let cannot = match (detector, self.look.refine) {
            (_, RefineArg::Never) => "with --refine never the image is looked at once",
            (MarkDetector::Paint(_), _) if self.second_pass == SecondPassArg::Never => return Ok(Looks::One),
            (MarkDetector::Paint(_), _) => return Ok(Looks::WithOtherColours),
            _ => "marks of this profile are found by their shape, and a second pass learns colours",
        };
        if self.second_pass == SecondPassArg::Always {
            let message = format!("--second-pass=always has no effect: {cannot}");
            return Err(Error::usage(message, "leave --second-pass out"));
        }
        Ok(Looks::One)
    }
}

/// A matcher for each look. Where other colours are looked for, the first has half of the false alarms that are
/// allowed, the second a quarter, all clusters of colour together the last; else the first has all. Later looks match
/// the strongest candidates only: of the work each may do a quarter of what the first may, of a long list, whose
/// hypotheses cost more, an eighth.
struct Matchers {
    first: Box<dyn Matcher>,
    learned: Box<dyn Matcher>,
    in_any_hue: Box<dyn Matcher>,
}

impl Matchers {
    fn of(
        (matching, own): (&MatchArgs, prepare::OwnWord),
        priors: usize,
        gcps: usize,
        looks: Looks,
        time_limit: &TimeLimit,
    ) -> anyhow::Result<Matchers> {
        let of =
            |chances, part| prepare::matcher(matching, own, Shared { chances: priors * chances, part }, time_limit);
        let later = RobustMatcher::later_part(gcps);
        let first = of(if looks == Looks::One { 1 } else { 2 }, 1)?;
        let in_any_hue = of(4 * MOST_CLUSTERS, later * MOST_CLUSTERS as u64)?;
        Ok(Matchers { first, learned: of(4, later)?, in_any_hue })
    }
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
    let (matching, forced) = ((&args.look.matching, time_limit), &args.look.gcps.working_crs.force);
    tracing::info_span!("gross-error diagnosis").in_scope(|| {
        diagnosis::examine(&mut run.outcome, &run.scan.candidates, list, priors, known, matching, forced);
    });
}

/// Adds what the search over colours found, and what is unusual about a picture that was refused.
fn advise(
    result: &mut RunResult,
    colours: Option<ColourSearch>,
    hints: &[String],
    (source, marks): (&dyn autoref_raster::RasterSource, &MarkArgs),
) -> anyhow::Result<()> {
    let profile = &marks.profile;
    // A mistake in the list is likelier than paint of another colour.
    if result.refused().is_some() {
        result.advice.splice(0..0, hints.iter().cloned());
    }
    if let Some(search) = &colours {
        let paints = search.advice(profile);
        if paints.is_empty() {
            result.advice.extend(other_sizes(result, marks));
        }
        result.advice.extend(paints);
        result.warnings.extend(search.note(profile).map(Warning::Said));
    }
    result.colour_search = colours;
    if result.refused().is_some() {
        result.advice.extend(unusual(source)?.iter().filter_map(|unusual| unusual.advice(profile)));
    }
    Ok(())
}

/// Which marks were not looked for, where nothing that was found is explained by the list.
fn other_sizes(result: &RunResult, marks: &MarkArgs) -> Option<String> {
    /// log₁₀ of how many such patterns chance produces: with less the marks are found.
    const HARDLY: f64 = -1.0;
    /// With fewer candidates the refusal itself names the sizes.
    const FEWEST: usize = 3;
    let best = result.refused()?.best_pattern.as_ref();
    let is_explained = !result.diagnoses.is_empty();
    if marks.mark_size.is_some() || is_explained || result.candidates_found < FEWEST {
        return None;
    }
    let (low, high) = Profile::load(&marks.profile).ok()?.side_range_px(None).ok()?;
    best.is_none_or(|best| best.log10_false_alarms > HARDLY).then(|| {
        format!("marks smaller than {low:.0} px or larger than {high:.0} px are not looked for: give their --mark-size")
    })
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

fn options(args: &RunArgs, job: &Job<'_>) -> serde_json::Value {
    serde_json::json!({
        "profile": args.look.paint.of(&args.look.marks).profile,
        "second_pass": word_of(args.second_pass),
        "refine": word_of(args.look.refine),
        "mark_size": args.look.marks.mark_size.map(|size| size.to_string()),
        "priors": job.priors,
        "max_false_alarms": args.look.matching.max_false_alarms,
        "allow_mirrored": args.look.matching.allow_mirrored,
        "tile": args.look.read.tile,
        "threads": args.look.read.threads,
        "memory_budget_bytes": args.look.read.memory.0,
        "reader": args.look.read.reader.choice().name(),
        "page": args.look.read.page,
        "white": job.source.info().white,
        "halo_px": job.detector.halo_px(),
        "check": args.look.gcps.check,
        "accuracy": args.look.gcps.accuracy.accuracy,
        "accuracy_class_m": args.look.gcps.accuracy.accuracy_class,
        "names": args.look.gcps.names,
        "write": args.write.write.iter().map(|kind| kind.name()).collect::<Vec<_>>(),
    })
}

/// All outputs and the JSON that lists them appear together, or nothing does.
fn write_outputs(
    request: &WriteRequest,
    json: &Path,
    report: Option<(&Path, &Gathered)>,
    document: &mut Document,
    started: Instant,
    telling: Telling,
    dem: Option<solving::DemCopy>,
) -> anyhow::Result<()> {
    let writing = Instant::now();
    let _span = tracing::info_span!("write").entered();
    let mut transaction = Transaction::new();
    if document.result.solved().is_some() {
        let bar = write::WarpBar::new(request, telling);
        let warnings = request.stage(&document.result, &mut transaction, &|done| bar.set(done))?;
        document.result.warnings.extend(warnings.into_iter().map(Warning::Said));
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

/// What the command line says of printing.
#[derive(Clone, Copy, Debug)]
pub struct Printing {
    /// The document on standard output; the summary goes to stderr then.
    pub json: bool,
    /// No summary.
    pub quiet: bool,
}

/// The summary a surveyor reads, or the document.
pub fn print(result: &RunResult, Printing { json, quiet }: Printing) {
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
