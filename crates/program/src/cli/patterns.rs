//! Topological point patterns: their options for every command that matches, and `autoref-stream patterns`.

mod picture;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::bail;
use autoref_raster::atomic::Existing;
use autoref_stream::candidate::Candidate;
use autoref_stream::gcp::{self, GcpList, GcpOptions};
use autoref_stream::georef::candidate_list;
use autoref_stream::matching::tpp::{Anchors, Space, Thresholds};
use autoref_stream::matching::{MatchOutcome, Matcher, Pattern, Priors, TppMatcher};
use serde_json::{Value, json};

use crate::cli::values::Gsd;
use crate::out::write_text;

/// What `--thresholds` tries, for radii and for angles; 0.21 was the preset of the thesis's program, 0.05 what it then
/// used.
const TRIED: [f64; 6] = [0.01, 0.02, 0.05, 0.1, 0.15, 0.21];

/// The matcher of the 2016 thesis.
#[derive(clap::Args, Debug)]
pub struct PatternArgs {
    /// Largest difference of radii, in units of the distance to the nearest neighbour.
    #[arg(long, value_name = "R", default_value_t = 0.05, help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_radius: f64,
    /// Largest difference of angles, in radians.
    #[arg(
        long,
        value_name = "RAD",
        default_value_t = 0.05,
        help_heading = "Topological point patterns (--matcher tpp)"
    )]
    pub tpp_angle: f64,
    /// Fewest matched points of a proposal.
    #[arg(long, value_name = "N", default_value_t = 5, help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_minimum: usize,
    /// When no pattern of --tpp-minimum points is believed, try with one point fewer, and so on down to N (at least 3).
    #[arg(long, value_name = "N", help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_least: Option<usize>,
    /// One anchor, the candidate of this number in the list (from 0), instead of all.
    #[arg(
        long,
        value_name = "N",
        conflicts_with = "tpp_random",
        help_heading = "Topological point patterns (--matcher tpp)"
    )]
    pub tpp_anchor: Option<usize>,
    /// So many anchors drawn at random instead of all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_random: Option<u64>,
    /// Seed of --tpp-random.
    #[arg(
        long,
        value_name = "SEED",
        default_value_t = 1,
        requires = "tpp_random",
        help_heading = "Topological point patterns (--matcher tpp)"
    )]
    pub tpp_seed: u64,
    /// Patterns in space: elevations of candidates against heights of GCPs. Needs --gsd.
    #[arg(long, help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_heights: bool,
    /// Leave out image points farther from their anchor than any GCP from its own.
    #[arg(long, help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_image_limit: bool,
    /// Leave out GCPs farther from their anchor than any image point from its own.
    #[arg(long, help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_gcp_limit: bool,
    /// Leave out points farther from the anchor than this, in units of the distance to its neighbour.
    #[arg(long, value_name = "R", help_heading = "Topological point patterns (--matcher tpp)")]
    pub tpp_distance: Option<f64>,
}

impl PatternArgs {
    /// The matcher that was asked for.
    pub fn matcher(&self, gsd: Option<Gsd>, max_false_alarms: f64) -> anyhow::Result<TppMatcher> {
        for (flag, value) in [
            ("--tpp-radius", Some(self.tpp_radius)),
            ("--tpp-angle", Some(self.tpp_angle)),
            ("--tpp-distance", self.tpp_distance),
        ] {
            if value.is_some_and(|v| v.is_nan() || v <= 0.0) {
                bail!("{flag} takes a positive number");
            }
        }
        if let Some(least) = self.tpp_least.filter(|least| *least >= self.tpp_minimum) {
            bail!(
                "--tpp-least {least} has no effect: --tpp-minimum is {} already; give fewer points, or leave it out",
                self.tpp_minimum
            );
        }
        let space = match (self.tpp_heights, gsd) {
            (false, _) => Space::Plane,
            (true, Some(gsd)) => Space::Solid { gsd_m: (gsd.0 + gsd.1) / 2.0 },
            (true, None) => bail!("--tpp-heights compares metres with pixels: give --gsd"),
        };
        let anchors = match (self.tpp_anchor, self.tpp_random) {
            (Some(index), _) => Anchors::One(index),
            (None, Some(count)) => Anchors::Random { count: count as usize, seed: self.tpp_seed },
            (None, None) => Anchors::All,
        };
        Ok(TppMatcher {
            near: Thresholds { radius: self.tpp_radius, angle: self.tpp_angle },
            minimum_matches: self.tpp_minimum,
            least_matches: self.tpp_least.unwrap_or(self.tpp_minimum),
            anchors,
            space,
            max_distance: self.tpp_distance.unwrap_or(f64::INFINITY),
            image_limit: self.tpp_image_limit,
            gcp_limit: self.tpp_gcp_limit,
            max_false_alarms,
        })
    }
}

/// Match two lists by topological point patterns, the way of the 2016 thesis, and show how: which anchors, which
/// points, with which thresholds.
///
/// Exit codes: 0 a pattern is believed, 1 none is, 2 error.
#[derive(clap::Args, Debug)]
#[command(name = "patterns")]
pub struct Args {
    /// CSV with the columns x and y, and elevation for --tpp-heights.
    pub candidates: PathBuf,
    /// Surveyed points, in any form that the main job reads.
    #[arg(long, value_name = "FILE")]
    pub gcps: PathBuf,
    /// CRS of the list. Default: what the list says.
    #[arg(long, value_name = "CRS")]
    pub crs: Option<String>,
    /// Use only these points.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',')]
    pub names: Vec<String>,
    /// Ground size of a pixel, metres: 0.03 (±10 %), 0.03±5%, or 0.02..0.05.
    #[arg(long, value_name = "M", allow_negative_numbers = true)]
    pub gsd: Option<Gsd>,
    /// No pattern is believed when chance alone would produce more that are as good.
    #[arg(long, value_name = "P", default_value_t = 1e-4)]
    pub max_false_alarms: f64,
    #[command(flatten)]
    pub patterns: PatternArgs,
    /// Try 36 pairs of thresholds, from 0.01 to 0.21, and print how many points agree in one pattern and how many
    /// are matched in the end.
    #[arg(long)]
    pub thresholds: bool,
    /// Draw the two patterns on each other, as SVG.
    #[arg(short, long, value_name = "FILE")]
    pub output: Option<PathBuf>,
    /// Replace an existing picture.
    #[arg(long)]
    pub overwrite: bool,
    /// Print one JSON document instead of words.
    #[arg(long)]
    pub json: bool,
    /// Print nothing but errors.
    #[arg(long)]
    pub quiet: bool,
}

pub fn run(args: &Args) -> anyhow::Result<ExitCode> {
    if !(args.max_false_alarms > 0.0 && args.max_false_alarms <= 1.0) {
        bail!("--max-false-alarms {} is not between 0 and 1", args.max_false_alarms);
    }
    let existing = Existing::of_flag(args.overwrite);
    if let Some(output) = &args.output {
        autoref_raster::atomic::check_outputs(&[output], existing)?;
    }
    let matcher = args.patterns.matcher(args.gsd, args.max_false_alarms)?;
    let options = GcpOptions { crs: args.crs.clone(), names: args.names.clone(), ..GcpOptions::default() };
    let list = gcp::read(&args.gcps, &options)?;
    let candidates = candidate_list::read_csv(&args.candidates)?;
    check_points(args, &list, &candidates)?;
    let priors = Priors { gsd_m_per_px: args.gsd.map(|g| (g.0, g.1)), ..Priors::default() };
    let outcome = matcher.find(&candidates, &list.gcps, &priors);
    let (pattern, believed) = match &outcome {
        MatchOutcome::Solved(solved) => (Some(&solved.pattern), Some(&solved.pattern)),
        MatchOutcome::NoMatch(evidence) => (evidence.best.as_ref(), None),
    };
    let pairs = believed.map_or(&[][..], |pattern| &pattern.pairs);
    let overlay = matcher.overlay(&candidates, &list.gcps, pairs);
    if let (Some(output), Some(overlay)) = (&args.output, &overlay) {
        let picture = picture::draw(overlay, &candidates, &list.gcps);
        write_text(output, picture.as_bytes(), existing)?;
    }
    let thresholds = if args.thresholds { tried(&matcher, &candidates, &list, &priors) } else { Vec::new() };
    let name = |gcp: usize| list.gcps[gcp].name.as_str();
    let document = json!({
        "program": format!("autoref-stream {}", env!("CARGO_PKG_VERSION")),
        "status": if believed.is_some() { "solved" } else { "refused" },
        "reason": match &outcome { MatchOutcome::NoMatch(evidence) => Some(&evidence.reason), MatchOutcome::Solved(_) => None },
        "candidates": candidates.len(),
        "gcps": list.gcps.len(),
        "matched": pattern.map(|p| p.pairs.iter().map(|&(c, g)| json!({"candidate": c, "gcp": name(g)})).collect::<Vec<_>>()),
        "scale_m_per_px": pattern.map(|p| p.similarity.scale_m_per_px()),
        "rotation_deg": pattern.map(|p| p.similarity.rotation_deg()),
        "log10_false_alarms": pattern.map(|p| p.log10_false_alarms),
        "anchors": overlay.as_ref().map(|o| json!({
            "candidate": o.anchors.0, "gcp": name(o.anchors.1), "others_that_agree": o.pairs.len(),
        })),
        "thresholds": thresholds,
        "files_written": args.output.iter().filter(|_| overlay.is_some()).map(|path| path.to_string_lossy()).collect::<Vec<_>>(),
    });
    if args.json {
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else if !args.quiet {
        print!("{}", words(&document, believed));
    }
    Ok(ExitCode::from(u8::from(believed.is_none())))
}

/// Whether there is enough to make patterns of.
fn check_points(args: &Args, list: &GcpList, candidates: &[Candidate]) -> anyhow::Result<()> {
    if let Some(index) = args.patterns.tpp_anchor.filter(|&index| index >= candidates.len()) {
        bail!("{}: --tpp-anchor {index}, but there are {} candidates", args.candidates.display(), candidates.len());
    }
    if !args.patterns.tpp_heights {
        return Ok(());
    }
    let elevations = candidates.iter().filter(|c| c.elevation_m.is_some()).count();
    let heights = list.gcps.iter().filter(|g| g.height.is_some()).count();
    for (count, file, what) in
        [(elevations, &args.candidates, "candidates have an elevation"), (heights, &args.gcps, "points have a height")]
    {
        if count < 3 {
            bail!("{}: only {count} {what}; patterns in space need three: leave out --tpp-heights", file.display());
        }
    }
    Ok(())
}

/// One row for each pair of thresholds.
fn tried(matcher: &TppMatcher, candidates: &[Candidate], list: &GcpList, priors: &Priors) -> Vec<Value> {
    let pairs = TRIED.iter().flat_map(|&radius| TRIED.map(|angle| Thresholds { radius, angle }));
    let row = |near: Thresholds| {
        let matcher = TppMatcher { near, ..matcher.clone() };
        let outcome = matcher.find(candidates, &list.gcps, priors);
        let (pattern, status) = match &outcome {
            MatchOutcome::Solved(solved) => (Some(&solved.pattern), "solved"),
            MatchOutcome::NoMatch(evidence) => (evidence.best.as_ref(), "refused"),
        };
        json!({
            "radius": near.radius, "angle_rad": near.angle, "status": status,
            "agree": matcher.overlay(candidates, &list.gcps, &[]).map_or(0, |o| o.pairs.len() + 1),
            "matched": pattern.map_or(0, |p| p.pairs.len()),
            "log10_false_alarms": pattern.map(|p| p.log10_false_alarms),
        })
    };
    pairs.map(row).collect()
}

fn words(document: &Value, believed: Option<&Pattern>) -> String {
    use std::fmt::Write;
    let mut out = String::new();
    let mut line = |label: &str, value: String| writeln!(out, "{label:<12}{value}").expect("a string takes all writes");
    line("Points", format!("{} in the image, {} listed", document["candidates"], document["gcps"]));
    match believed {
        Some(p) => line(
            "Solved",
            format!(
                "{} points matched; {:.6} m per pixel, {:.4}°; chance alone would produce 10^{:.1} such patterns",
                p.pairs.len(),
                p.similarity.scale_m_per_px(),
                p.similarity.rotation_deg(),
                p.log10_false_alarms
            ),
        ),
        None => line("Refused", document["reason"].as_str().unwrap_or("no two patterns agree").into()),
    }
    if let Some(anchors) = document["anchors"].as_object() {
        line(
            "Anchors",
            format!(
                "candidate {} and {}: {} other points agree",
                anchors["candidate"],
                anchors["gcp"].as_str().unwrap_or_default(),
                anchors["others_that_agree"]
            ),
        );
    }
    for row in document["thresholds"].as_array().into_iter().flatten() {
        let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        line(
            "Thresholds",
            format!(
                "radius {:.2}, angle {:.2}: {:>3} agree in one pattern, {:>3} matched, {}",
                number("radius"),
                number("angle_rad"),
                row["agree"],
                row["matched"],
                row["status"].as_str().unwrap_or_default()
            ),
        );
    }
    for file in document["files_written"].as_array().into_iter().flatten() {
        line("Written", file.as_str().unwrap_or_default().into());
    }
    out
}
