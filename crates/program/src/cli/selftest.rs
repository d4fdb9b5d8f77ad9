//! `autoref-stream selftest`: what would the detector find on this image?

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::bail;
use autoref_stream::pipeline::picture::{Unusual, unusual};
use autoref_stream::profile::{self, Profile};
use autoref_stream::segment::reference::PaintTest;
use autoref_stream::selftest::{self, Selftest, SelftestOptions, WANTED_RECALL};
use autoref_synth::plant::Cell;
use autoref_synth::{Paint, Shape};
use clap::Args;

use crate::cli::args::{DEFAULT_PROFILE, MarkArgs, ReadArgs};
use crate::cli::prepare;
use crate::cli::progress::{Bar, Telling};
use crate::cli::values::{Gsd, MarkSize};
use autoref_raster::RasterSource;
use autoref_raster::words::counted;

/// Plant marks into an image as it is read (the file is not touched), run the detector, and say what it finds of them.
///
/// Exit codes: 0 some size is found in 99 of 100 cases, 1 none is, 2 error.
#[derive(Args, Debug)]
#[command(name = "selftest")]
pub struct SelftestArgs {
    /// The image: any raster that GDAL opens.
    pub image: PathBuf,
    /// Sides or diameters to try, in pixels. Default: from 5 to 30, as far as the profile takes them.
    #[arg(long, value_name = "PX,…", value_delimiter = ',', help_heading = "Planted marks")]
    pub sizes: Vec<f64>,
    /// Marks of each size.
    #[arg(long, value_name = "N", default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..=100_000), help_heading = "Planted marks")]
    pub marks: u64,
    /// Colour in full sun: a name or #rrggbb. Default: the profile's. What the default profile does not take is looked
    /// for as `--paint` of the main job does.
    #[arg(long, value_name = "COLOUR", help_heading = "Planted marks")]
    pub paint: Option<Paint>,
    /// Square, disc, cross, checker, cross-plate or hourglass. Default: the profile's, a square when it takes any.
    #[arg(long, value_name = "SHAPE", value_parser = shape, help_heading = "Planted marks")]
    pub shape: Option<Shape>,
    /// Standard deviation of the blur, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 0.9, help_heading = "Planted marks")]
    pub blur: f64,
    /// Largest share of ground that shines through the paint; every mark draws its own below it.
    #[arg(long, value_name = "SHARE", default_value_t = 0.2, help_heading = "Planted marks")]
    pub fading: f64,
    /// Quality of the JPEG that the marks go through; 0 for none. Images of more than 8 bits have none.
    #[arg(long, value_name = "Q", default_value_t = 90, value_parser = clap::value_parser!(u8).range(0..=100), help_heading = "Planted marks")]
    pub jpeg: u8,
    /// Another seed plants the marks elsewhere.
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Planted marks")]
    pub seed: u64,
    /// Ground size of a pixel in metres; with it sizes are given in metres too.
    #[arg(long, value_name = "M", help_heading = "Marks")]
    pub gsd: Option<Gsd>,
    #[command(flatten)]
    pub profile: MarkArgs,
    /// Print one JSON document instead of the table.
    #[arg(long)]
    pub json: bool,
    /// No progress bar, no table.
    #[arg(long)]
    pub quiet: bool,
    #[command(flatten)]
    pub read: ReadArgs,
}

fn shape(text: &str) -> Result<Shape, String> {
    let wrong = || format!("no shape is called `{text}`; use square, disc, cross, checker, cross-plate or hourglass");
    let shape = serde_json::from_value(serde_json::Value::String(text.to_lowercase())).map_err(|_| wrong())?;
    if shape == Shape::Bar { Err(wrong()) } else { Ok(shape) }
}

pub fn run(args: &SelftestArgs) -> anyhow::Result<ExitCode> {
    let marks = marks(args)?;
    let conditions = conditions(args, &marks)?;
    let prepared = prepare::open(&args.image, &args.read, &marks, args.gsd)?;
    let info = prepared.source.info().clone();
    let range_px = Profile::load(&marks.profile)?.side_range_px(args.gsd.map(Gsd::middle_m))?;
    let sizes_px = sizes(args, range_px)?;
    let bar = Bar::new(&info, Telling::silent_if(args.quiet || args.json));
    // What is above the smallest budget is shared with tiles and cache.
    let spare = args.read.memory.0.saturating_sub(autoref_raster::memory_plan::SMALLEST_BUDGET_BYTES);
    let chip_budget_bytes = (spare / 4 + (2 << 20)).min(64 << 20);
    let options = SelftestOptions {
        sizes_px,
        marks_per_size: args.marks as usize,
        conditions,
        seed: args.seed,
        chip_budget_bytes,
    };
    let halo_px = prepared.detector.as_detector().halo_px();
    let planner = |info: &autoref_raster::RasterInfo| {
        let baseline_bytes = autoref_raster::memory_plan::baseline_bytes();
        autoref_raster::memory_plan::plan(
            info,
            halo_px,
            &autoref_raster::memory_plan::PlanOptions { baseline_bytes, ..prepared.options.clone() },
        )
    };
    let result = selftest::selftest(&prepared.source, prepared.detector.as_detector(), &planner, &options, &bar)?;
    bar.finish();
    let may_help = if result.advice.is_none() { may_help(prepared.source.as_ref(), &marks)? } else { Vec::new() };
    if args.json {
        let document = serde_json::json!({
            "program": format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
            "image": args.image.display().to_string(),
            "profile": marks.profile,
            "selftest": result,
            "may_help": may_help,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.quiet {
        print!("{}", words(&result, args.gsd.map(Gsd::middle_m), &may_help));
    }
    Ok(if result.advice.is_some() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// The marks to look for: those of the profile, or of a paint that nobody's default profile takes.
fn marks(args: &SelftestArgs) -> anyhow::Result<MarkArgs> {
    let Some(Paint(colour)) = args.paint.filter(|_| args.profile.profile == DEFAULT_PROFILE) else {
        return Ok(args.profile.clone());
    };
    if PaintTest::new(&Profile::load(DEFAULT_PROFILE)?)?.is_paint(colour) {
        return Ok(args.profile.clone());
    }
    let profile = Profile::of_paint(colour).name;
    if !(args.quiet || args.json) {
        println!("Looked for as with --paint \"{profile}\": the profile {DEFAULT_PROFILE} does not take this colour");
    }
    Ok(MarkArgs { profile, ..args.profile.clone() })
}

/// What helps where no size is found: in a grey picture no paint and no size does.
fn may_help(source: &dyn RasterSource, marks: &MarkArgs) -> anyhow::Result<Vec<String>> {
    let unusual = unusual(source)?;
    let larger = match (unusual.contains(&Unusual::Grey), Profile::load(&marks.profile)?.is_target()) {
        (true, false) => None,
        (_, true) => Some("use larger marks".to_owned()),
        (false, false) => Some("use another paint or larger marks".to_owned()),
    };
    Ok(larger.into_iter().chain(unusual.iter().filter_map(|unusual| unusual.advice(&marks.profile))).collect())
}

/// How the marks are painted: as in the benchmark, but for what was asked.
fn conditions(args: &SelftestArgs, marks: &MarkArgs) -> anyhow::Result<Cell> {
    if !(0.0..1.0).contains(&args.fading) {
        bail!("--fading takes a share from 0 to below 1");
    }
    if !(0.2..=10.0).contains(&args.blur) {
        bail!("--blur takes 0.2 to 10 pixels");
    }
    let profile = Profile::load(&marks.profile)?;
    if profile.tag.is_some() {
        bail!("the self-test paints no coded targets; docs/decisions/coded-targets.md has what was measured of them");
    }
    let shape = args.shape.unwrap_or(match profile.shape {
        profile::Shape::Disc => Shape::Disc,
        // The cross of a profile without a colour is looked for on a plate.
        profile::Shape::Cross if profile.is_target() => Shape::CrossPlate,
        profile::Shape::Cross => Shape::Cross,
        profile::Shape::Checker => Shape::Checker,
        profile::Shape::Hourglass => Shape::Hourglass,
        profile::Shape::Any | profile::Shape::Square | profile::Shape::Tag => Shape::Square,
    });
    let dark = Cell::base().second;
    let (paint, second) = match (profile.is_target(), shape) {
        (false, _) => (profile.fresh_paint(), dark),
        // Plate and cross. Checkers and hourglasses are their own negatives, turned by 90 degrees.
        (true, Shape::CrossPlate) => (dark, Paint::WHITE.0),
        (true, _) => (Paint::WHITE.0, dark),
    };
    Ok(Cell {
        label: profile.name.clone(),
        paint: args.paint.map_or(paint, |paint| paint.0),
        second,
        disc: shape == Shape::Disc,
        figure: (!matches!(shape, Shape::Square | Shape::Disc)).then_some(shape),
        blur_px: args.blur,
        fading: args.fading,
        quality: args.jpeg,
        ..Cell::base()
    })
}

fn sizes(args: &SelftestArgs, range_px: (f64, f64)) -> anyhow::Result<Vec<f64>> {
    const LADDER: [f64; 8] = [5.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 30.0];
    if let Some(bad) = args.sizes.iter().find(|s| !(2.0..=200.0).contains(*s)) {
        bail!("--sizes {bad}: sizes are 2 to 200 pixels");
    }
    if args.sizes.len() > 40 {
        bail!("--sizes takes at most 40 sizes");
    }
    if !args.sizes.is_empty() {
        return Ok(args.sizes.clone());
    }
    let (low, high) = match args.profile.mark_size {
        Some(MarkSize::Pixels(low, high)) => (low, high),
        _ => range_px,
    };
    let ladder: Vec<f64> = LADDER.into_iter().filter(|s| (low..=high).contains(s)).collect();
    Ok(if ladder.is_empty() { vec![(low + high) / 2.0] } else { ladder })
}

fn words(result: &Selftest, gsd_m: Option<f64>, may_help: &[String]) -> String {
    let mut out = String::new();
    let mut line = |text: String| writeln!(out, "{text}").expect("a string takes all writes");
    line(format!(
        "{:>8} {:>6} {:>8} {:>16} {:>9} {:>9} {:>14}",
        "side px", "marks", "found", "95 % interval", "RMSE px", "median px", "bias x, y px"
    ));
    for row in &result.rows {
        let px = |v: Option<f64>| v.map_or("–".into(), |v| format!("{v:.3}"));
        line(format!(
            "{:>8} {:>6} {:>6.1} % {:>7.1}–{:>6.1} % {:>9} {:>9} {:>+7.3}{:>+7.3}",
            row.side_px,
            row.marks,
            100.0 * row.recall,
            100.0 * row.recall_95.0,
            100.0 * row.recall_95.1,
            px(row.rmse_px),
            px(row.median_px),
            row.bias_px[0],
            row.bias_px[1]
        ));
    }
    let (low, high) = result.false_per_megapixel_95;
    line(format!(
        "False finds: {} in {:.1} megapixels beside the marks, {:.3} per megapixel (95 % interval {low:.3}–{high:.3}); real marks count as such",
        result.false_finds, result.clear_megapixels, result.false_per_megapixel
    ));
    if result.exposure < 0.9 {
        line(format!(
            "The image's brightest samples reach {:.0} % of full white, and the paint was dimmed alike; stretching the image may help",
            100.0 * result.exposure
        ));
    }
    if result.marks_missing > 0 {
        line(format!(
            "{} fewer than asked for: image or --memory have no room for more",
            counted(result.marks_missing, "mark", "marks")
        ));
    }
    let percent = 100.0 * WANTED_RECALL;
    line(match &result.advice {
        Some(advice) => {
            let metres = gsd_m.map_or(String::new(), |gsd| format!(" = {:.2} m", gsd * advice.side_px));
            let surely = if advice.sure { ", surely" } else { "; more --marks would narrow it" };
            format!("Smallest size found in {percent} % of the cases: {} px{metres}{surely}", advice.side_px)
        }
        None => format!("No size tried was found in {percent} % of the cases: {}", may_help.join("; ")),
    });
    out
}
