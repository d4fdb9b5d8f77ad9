//! The command line: raw flags here, validated types in the library.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

pub mod accuracy;
pub mod apply;
pub mod args;
pub mod chips;
pub mod cloud;
mod cloud_cameras;
mod cloud_clean;
mod cloud_grid;
mod cloud_means;
pub mod compare_solvers;
pub mod dem;
pub mod detect;
pub mod diagnosis;
pub mod distance;
mod document;
pub mod errors;
pub mod everywhere;
pub mod fiducials;
mod fiducials_page;
pub mod film_outputs;
mod film_resample;
pub mod flight;
pub mod gcps;
pub mod inputs;
mod lengths;
pub mod mask;
mod mask_camera;
mod mask_light;
pub mod mosaic;
pub mod option_errors;
mod overridden;
pub mod patterns;
pub mod plan;
pub mod positions;
mod prepare;
mod progress;
mod recorded_image;
pub mod replay;
pub mod report;
pub mod run;
pub mod sample;
pub mod selftest;
pub mod shell;
pub mod solve;
pub mod solving;
pub mod stage_times;
mod summary;
pub mod synth;
pub mod synth_film;
pub mod synth_flight;
pub mod undo;
mod values;
pub mod without_effect;
pub mod working_crs;
pub mod write;

/// Georeferences very large rasters from painted marks, without a click.
///
/// Finds the marks in the image, works out which surveyed point each of them is from the pattern alone, solves the
/// orientation and writes it beside the image with a statement of its accuracy, or says why it will not.
#[derive(Parser, Debug)]
#[command(
    name = "autoref-stream",
    version,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true,
    max_term_width = 110,
    after_help = "Examples:\n  autoref-stream e6.tif --gcps e6.geojson --tile 4096\n  autoref-stream e6.tif --gcps list.csv --crs EPSG:25832 --gsd 0.03 --out results\n\nExit codes: 0 solved, 1 ran but not solved (only the JSON and the report were written), 2 error."
)]
pub struct Cli {
    #[command(subcommand)]
    pub command: Option<Command>,

    #[command(flatten)]
    pub run: run::RunArgs,

    /// Say more on stderr: -v what is done, -vv every step (RUST_LOG has the last word).
    #[arg(short, long, global = true, action = clap::ArgAction::Count, help_heading = "Messages")]
    pub verbose: u8,

    /// Write where the time went, stage by stage, as JSON; an older profile is replaced.
    #[arg(long, global = true, value_name = "FILE", help_heading = "Messages")]
    pub profile_json: Option<std::path::PathBuf>,
}

#[derive(Subcommand, Debug)]
pub enum Command {
    /// Find the marks in an image and write the candidates as CSV or GeoJSON.
    Detect(Box<detect::DetectArgs>),
    /// Match a list of candidates to a list of GCPs and solve the orientation; needs no image.
    Solve(Box<args::SolveArgs>),
    Synth(Box<synth::SynthArgs>),
    Sample(sample::Args),
    Chips(chips::Args),
    Distance(distance::Args),
    Apply(Box<apply::ApplyArgs>),
    Undo(undo::UndoArgs),
    Completions(shell::CompletionsArgs),
    Man(shell::ManArgs),
    Mask(Box<mask::MaskArgs>),
    Plan(plan::PlanArgs),
    Selftest(selftest::SelftestArgs),
    Fiducials(Box<fiducials::FiducialsArgs>),
    SynthFilm(synth_film::SynthFilmArgs),
    SynthFlight(Box<synth_flight::Args>),
    Dem(Box<dem::DemArgs>),
    Mosaic(Box<mosaic::MosaicArgs>),
    Flight(Box<flight::FlightArgs>),
    Cloud(cloud::CloudArgs),
    Gcps(gcps::GcpsArgs),
    CompareSolvers(Box<compare_solvers::CompareArgs>),
    Patterns(patterns::Args),
}

pub fn dispatch(cli: Cli) -> anyhow::Result<ExitCode> {
    match cli.command {
        Some(Command::Detect(args)) => detect::run(&args),
        Some(Command::Solve(args)) => solve::run(&args),
        Some(Command::Synth(args)) => synth::run(*args).map(|()| ExitCode::SUCCESS),
        Some(Command::Sample(args)) => sample::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Chips(args)) => chips::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Distance(args)) => distance::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Apply(args)) => apply::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Undo(args)) => undo::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Completions(args)) => shell::completions(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Man(args)) => shell::man(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Mask(args)) => mask::run(&args),
        Some(Command::Plan(args)) => plan::run(&args),
        Some(Command::Fiducials(args)) => fiducials::run(&args),
        Some(Command::Selftest(args)) => selftest::run(&args),
        Some(Command::Dem(args)) => dem::run(&args),
        Some(Command::Mosaic(args)) => mosaic::run(&args),
        Some(Command::SynthFilm(args)) => synth_film::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::SynthFlight(args)) => synth_flight::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::Flight(args)) => flight::run(&args),
        Some(Command::Cloud(args)) => cloud::run(&args),
        Some(Command::Gcps(args)) => gcps::run(&args).map(|()| ExitCode::SUCCESS),
        Some(Command::CompareSolvers(args)) => compare_solvers::run(&args),
        Some(Command::Patterns(args)) => patterns::run(&args),
        None => run::run(&cli.run),
    }
}

/// Where messages go, and the clock of the stages when `--verbose` or `--profile-json` asks for it.
pub fn init_log(cli: &Cli) -> Option<stage_times::StageTimes> {
    use tracing_subscriber::{filter::Targets, prelude::*};
    let default = ["warn", "info", "debug"][usize::from(cli.verbose.min(2))];
    let named = std::env::var("RUST_LOG").ok().filter(|text| !text.trim().is_empty());
    let asked = named.and_then(|text| text.parse::<Targets>().ok());
    let filter = asked.unwrap_or_else(|| default.parse().expect("a level by its name"));
    let colours = std::io::IsTerminal::is_terminal(&std::io::stderr());
    let messages =
        tracing_subscriber::fmt::layer().with_writer(std::io::stderr).with_ansi(colours).event_format(Message);
    let times = (cli.verbose > 0 || cli.profile_json.is_some()).then(stage_times::StageTimes::new);
    let clock = times.clone().map(|times| times.with_filter(tracing::level_filters::LevelFilter::INFO));
    tracing_subscriber::registry().with(messages.with_filter(filter)).with(clock).init();
    times
}

/// A message with its level. Spans are for the clock: a message does not repeat in which stage it was said.
struct Message;

impl<S, N> tracing_subscriber::fmt::FormatEvent<S, N> for Message
where
    S: tracing::Subscriber + for<'a> tracing_subscriber::registry::LookupSpan<'a>,
    N: for<'a> tracing_subscriber::fmt::FormatFields<'a> + 'static,
{
    fn format_event(
        &self,
        context: &tracing_subscriber::fmt::FmtContext<'_, S, N>,
        mut writer: tracing_subscriber::fmt::format::Writer<'_>,
        event: &tracing::Event<'_>,
    ) -> std::fmt::Result {
        let level = *event.metadata().level();
        match (writer.has_ansi_escapes(), level) {
            (true, tracing::Level::ERROR) => write!(writer, "\x1b[31m{level:>5}\x1b[0m ")?,
            (true, tracing::Level::WARN) => write!(writer, "\x1b[33m{level:>5}\x1b[0m ")?,
            (true, _) => write!(writer, "\x1b[2m{level:>5}\x1b[0m ")?,
            (false, _) => write!(writer, "{level:>5} ")?,
        }
        tracing_subscriber::fmt::FormatFields::format_fields(context, writer.by_ref(), event)?;
        writeln!(writer)
    }
}

/// The arguments with `--second-pass WHEN` as one word: alone it means `always`, and must not swallow the image.
pub fn joined(arguments: impl Iterator<Item = std::ffi::OsString>) -> Vec<std::ffi::OsString> {
    let mut joined: Vec<std::ffi::OsString> = Vec::new();
    for argument in arguments {
        match joined.last_mut() {
            Some(last)
                if last == "--second-pass" && ["never", "auto", "always"].iter().any(|when| argument == **when) =>
            {
                last.push("=");
                last.push(argument);
            }
            _ => joined.push(argument),
        }
    }
    joined
}

#[cfg(test)]
mod second_pass_words {
    #[test]
    fn the_bare_option_does_not_swallow_the_image() {
        let joined = |words: &[&str]| super::joined(words.iter().map(Into::into));
        assert_eq!(joined(&["x", "--second-pass", "never", "a.tif"]), ["x", "--second-pass=never", "a.tif"]);
        assert_eq!(joined(&["x", "--second-pass", "a.tif"]), ["x", "--second-pass", "a.tif"]);
        assert_eq!(joined(&["x", "--second-pass"]), ["x", "--second-pass"]);
    }
}
