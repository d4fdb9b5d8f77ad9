//! `autoref-stream plan`: is the pattern of the marks good enough, before anybody flies?

use std::fmt::Write;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::bail;
use autoref_raster::coords::MapPoint;
use autoref_raster::{self as raster, ReaderChoice};
use autoref_stream::gcp::{self, GcpOptions, GcpRole};
use autoref_stream::planning::{self, PaintRank, Plan, PlanRequest};
use clap::Args;

use crate::cli::progress::{Busy, Telling};
use crate::cli::values::{Gsd, MarkSize};

/// Before the flight: is the pattern of the marks unique, how well will it hold the image, how large must a mark be,
/// and which paint stands out?
///
/// Exit codes: 0 all is well, 1 a change is advised, 2 error.
#[derive(Args, Debug)]
#[command(name = "plan")]
pub struct PlanArgs {
    /// Planned points: GeoJSON, CSV with a header, or KOF.
    pub gcps: PathBuf,
    /// How many marks may be lost (hidden, driven over, outside the image).
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(0..=20))]
    pub lose: u64,
    /// Ground size of a pixel of the flight, metres: 0.03 (±10 %), 0.03±5%, or 0.02..0.05. With it the scale counts as
    /// known.
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub gsd: Option<Gsd>,
    /// Side or diameter of the marks that are planned, in metres (0.3m) or pixels.
    #[arg(long, value_name = "SIZE")]
    pub mark_size: Option<MarkSize>,
    /// The image's top will point north within DEG degrees.
    #[arg(long, value_name = "DEG", num_args = 0..=1, default_missing_value = "15")]
    pub north_up: Option<f64>,
    /// How near to a point another must come to pass for it, metres. Default: 12 pixels, or 0.25 % of the area's
    /// diagonal.
    #[arg(long, value_name = "M")]
    pub tolerance: Option<f64>,
    /// 1σ of a coordinate of one mark in the finished orthophoto, metres. Default: 1.5 pixels.
    #[arg(long, value_name = "M")]
    pub noise: Option<f64>,
    /// An older image of the place: ranks the paints by how far they are from the colours of the ground.
    #[arg(long, value_name = "FILE")]
    pub image: Option<PathBuf>,
    /// CRS of the list. Default: what the list says.
    #[arg(long, value_name = "CRS")]
    pub crs: Option<String>,
    /// Bring the points into this CRS first.
    #[arg(long, value_name = "CRS")]
    pub to_crs: Option<String>,
    /// Use only these points.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',')]
    pub names: Vec<String>,
    /// Print one JSON document instead of words.
    #[arg(long)]
    pub json: bool,
    /// Print nothing but errors.
    #[arg(long)]
    pub quiet: bool,
}

pub fn run(args: &PlanArgs) -> anyhow::Result<ExitCode> {
    for (flag, value) in [("--tolerance", args.tolerance), ("--noise", args.noise)] {
        if value.is_some_and(|v| !(v > 0.0 && v.is_finite())) {
            bail!("{flag} takes a positive length in metres");
        }
    }
    if args.north_up.is_some_and(|d| !(0.0..=180.0).contains(&d)) {
        bail!("--north-up takes degrees from 0 to 180");
    }
    let options = GcpOptions {
        crs: args.crs.clone(),
        to_crs: args.to_crs.clone(),
        names: args.names.clone(),
        ..GcpOptions::default()
    };
    let list = gcp::read(&args.gcps, &options)?;
    // Check points take no part in the pattern.
    let points: Vec<(String, MapPoint)> =
        list.gcps.iter().filter(|g| g.role == GcpRole::Control).map(|g| (g.name.clone(), g.position())).collect();
    let request = PlanRequest {
        lose: args.lose as usize,
        gsd_m: args.gsd.map(|g| (g.0, g.1)),
        north_up_deg: args.north_up,
        tolerance_m: args.tolerance,
        noise_m: args.noise,
    };
    // What can be refused is refused before the search.
    if matches!(args.mark_size, Some(MarkSize::Metres(..))) && args.gsd.is_none() {
        bail!("--mark-size in metres says nothing without --gsd");
    }
    let image = args.image.as_ref().map(|image| raster::open(image, ReaderChoice::Auto, 0, 64 << 20)).transpose()?;
    let busy =
        Busy::new("trying every way of laying the pattern on itself", Telling::silent_if(args.quiet || args.json));
    let mut plan = planning::plan(&points, &request);
    drop(busy);
    plan.advice.extend(mark_advice(args, &plan));
    let busy = args
        .image
        .as_ref()
        .map(|_| Busy::new("looking at the ground's colours", Telling::silent_if(args.quiet || args.json)));
    let paints = image.map_or(Ok(Vec::new()), |image| planning::rank_paints(image.as_ref()))?;
    drop(busy);
    if args.json {
        let document = serde_json::json!({
            "program": format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
            "gcp_file": args.gcps.display().to_string(),
            "plan": plan,
            "paints": paints,
            "notes": list.notes,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.quiet {
        print!("{}", words(&plan, &paints, &list.notes));
    }
    Ok(if plan.advice.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// Whether the planned marks are large enough.
fn mark_advice(args: &PlanArgs, plan: &Plan) -> Option<String> {
    let size = args.mark_size?;
    // A single size was widened by a quarter on both sides: what is painted is the middle.
    let middle = |low: f64, high: f64| (low + high) / 2.0;
    let side_px = match (size, plan.mark) {
        (MarkSize::Pixels(low, high), _) => middle(low, high),
        (MarkSize::Metres(low, high), mark) => middle(low, high) / mark?.gsd_m,
    };
    (side_px < planning::SMALLEST_MARK_PX).then(|| {
        let metres = plan.mark.map_or(String::new(), |m| format!(" = {:.2} m", m.smallest_m));
        format!("marks of {side_px:.1} px are too small: paint at least {} px{metres}", planning::SMALLEST_MARK_PX)
    })
}

fn words(plan: &Plan, paints: &[PaintRank], notes: &[String]) -> String {
    let mut out = String::new();
    let mut line = |label: &str, value: String| writeln!(out, "{label:<20}{value}").expect("a string takes all writes");
    line("Points", format!("{}, of which {} may be lost", plan.points, plan.lose));
    line(
        "Pattern",
        match (plan.enough_points, plan.unique) {
            (false, _) => "too few points".into(),
            (true, true) => format!("unique under rotation, scale and mirroring, to {:.2} m", plan.tolerance_m),
            (true, false) => format!("ambiguous, to {:.2} m", plan.tolerance_m),
        },
    );
    if let Some(mark) = &plan.mark {
        line(
            "Marks",
            format!(
                "at least {:.2} m ({} px) wide at {:.3} m per pixel, {:.2} m ({} px) to be on the safe side; square or round \
                 makes no difference",
                mark.smallest_m,
                planning::SMALLEST_MARK_PX,
                mark.gsd_m,
                mark.comfortable_m,
                planning::COMFORTABLE_MARK_PX
            ),
        );
    }
    if let Some(strength) = &plan.strength {
        for corner in &strength.corners {
            let error = match (corner.error_95_m, corner.error_95_after_loss_m) {
                (Some(all), Some(left)) => format!("; 95 % within {all:.3} m, {left:.3} m"),
                _ => String::new(),
            };
            line(
                "Corner",
                format!(
                    "{}: error {:.2} times that of one mark, {:.2} after the worst loss{error}",
                    corner.direction, corner.factor, corner.factor_after_loss
                ),
            );
        }
    }
    paint_words(paints, &mut line);
    for note in notes {
        line("Note", crate::printable(note));
    }
    for advice in &plan.advice {
        line("Advice", advice.clone());
    }
    out
}

/// So many paints are told one by one.
const TOLD_PAINTS: usize = 6;

/// The paints that stand out most, and those that would need a rim.
fn paint_words(paints: &[PaintRank], line: &mut impl FnMut(&str, String)) {
    for paint in paints.iter().filter(|paint| paint.rim_sides == 0.0).take(TOLD_PAINTS) {
        line(
            "Paint",
            format!(
                "{}: {:.4} % of the ground would pass for it; all but 0.01 % is {:.1} times the limit away or more",
                paint.profile,
                100.0 * paint.ground_share,
                paint.margin_p0001
            ),
        );
    }
    for (rim, width) in [(0.5, "half as wide as the mark"), (1.0, "as wide as the mark")] {
        let like = |p: &&PaintRank| p.rim_sides == rim;
        let names: Vec<String> = paints
            .iter()
            .filter(like)
            .map(|p| format!("{} ({:.1} % of the ground)", p.profile, 100.0 * p.ground_share))
            .collect();
        if !names.is_empty() {
            line("Paint", format!("only with a dark rim {width} all around: {}", names.join(", ")));
        }
    }
}
