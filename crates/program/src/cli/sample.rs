//! `autoref-stream sample`: learn a profile from marks that somebody points at.

use std::path::PathBuf;

use anyhow::{Result, bail};
use autoref_raster::Patch;
use autoref_raster::atomic;
use autoref_raster::coords::PixelPoint;
use autoref_stream::candidate::patch::median;
use autoref_stream::learn::{DEFAULT_REACH_PX, LearnOptions, RoughRule, learn, learn_with};
use autoref_stream::profile::Profile;
use autoref_stream::profile::colour::lab_from_srgb;

use super::common::SampleArgs;
use super::positions::{Mark, PositionArgs, patch_around};

/// Learn a mark profile from marks in an image and write it as TOML.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image.
    image: PathBuf,
    #[command(flatten)]
    positions: PositionArgs,
    /// How far around a mark to look, pixels; at least the mark's own size.
    #[arg(long, value_name = "PX", default_value_t = DEFAULT_REACH_PX)]
    reach_px: u64,
    /// Name of the new profile.
    #[arg(long, default_value = "taught")]
    name: String,
    /// Also learn a box in RGB that paint must be in first: the middle share of the marks' values in each band (0.75; 1 is
    /// smallest to largest), or so many standard deviations about their mean (1.5sd).
    #[arg(long, value_name = "SHARE|Ksd", value_parser = parse_rough)]
    rough_box: Option<RoughRule>,
    /// Also learn kernel densities of L*, a*, b*, and drop candidates that are improbable by them.
    #[arg(long)]
    density: bool,
    /// Where to write the profile; standard output when absent.
    #[arg(short, long, value_name = "TOML")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print the profile as one JSON document on standard output, instead of TOML when no file is named.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    samples: SampleArgs,
}

/// "0.75" or "1.5sd".
fn parse_rough(text: &str) -> Result<RoughRule, String> {
    let wrong =
        || format!("\"{text}\" is neither a share above 0 and at most 1 nor a number of standard deviations (1.5sd)");
    let rule = match text.trim().strip_suffix("sd") {
        Some(k) => RoughRule::Sigma(k.trim().parse().map_err(|_| wrong())?),
        None => RoughRule::Middle(text.trim().parse().map_err(|_| wrong())?),
    };
    let (RoughRule::Sigma(value) | RoughRule::Middle(value)) = rule;
    let most = if matches!(rule, RoughRule::Middle(_)) { 1.0 } else { f64::MAX };
    if value > 0.0 && value <= most { Ok(rule) } else { Err(wrong()) }
}

/// A listed mark that nothing is learned from.
#[derive(Debug, serde::Serialize)]
struct LeftOut {
    name: String,
    reason: String,
}

pub fn run(args: &Args) -> Result<()> {
    if let Some(path) = &args.output
        && path.exists()
        && !args.overwrite
    {
        bail!("{} exists; give --overwrite to replace it", path.display());
    }
    let source = args.samples.open(&args.image, 64 << 20)?;
    let found = args.positions.positions(source.info())?;
    let reach_px = args.reach_px.clamp(8, 2048);
    let marks = found
        .marks
        .into_iter()
        .map(|mark| Ok((patch_around(source.as_ref(), mark.at, reach_px)?, mark)))
        .collect::<Result<Vec<_>>>()?;
    let (marks, left_out) = sift(marks);
    if marks.is_empty() {
        bail!(
            "{}: no point of the list can be learned from; {}: {}",
            args.image.display(),
            left_out[0].name,
            left_out[0].reason
        );
    }
    let profile = learn_with(&args.name, &marks, &LearnOptions { rough_box: args.rough_box, density: args.density })?;
    report(&profile, &found.outside, &left_out);
    match &args.output {
        Some(path) => atomic::write(path, profile.to_toml().as_bytes())?,
        None if args.json => {}
        None => print!("{}", profile.to_toml()),
    }
    if args.json {
        let files: Vec<String> = args.output.iter().map(|path| path.display().to_string()).collect();
        let document = serde_json::json!({
            "files_written": files,
            "profile": profile,
            "outside": found.outside,
            "left_out": left_out,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    }
    Ok(())
}

/// Largest distance in a\*b\* of a listed mark's colour from the median of all marks. Paint in shade and sun, fresh and worn, is
/// within it; a car or a bush over the point is not.
const LIKE_THE_OTHERS: f64 = 30.0;

/// Leaves out listed marks that do not stand out, or have another colour than most: nobody saw them. What was pointed at
/// stays, and fails loudly.
fn sift(marks: Vec<(Patch, Mark)>) -> (Vec<(Patch, PixelPoint)>, Vec<LeftOut>) {
    let mut left_out = Vec::new();
    let mut kept = Vec::new();
    for (patch, mark) in marks {
        let alone = learn("alone", &[(patch.clone(), mark.at)]);
        let colour = match &alone {
            Ok(profile) => profile.learned.as_ref().map(|l| lab_from_srgb(l.mean_srgb)),
            Err(error) if mark.listed => {
                let reason = error.to_string();
                left_out.push(LeftOut { name: mark.name, reason });
                continue;
            }
            Err(_) => None,
        };
        kept.push((patch, mark, colour));
    }
    let middle = |axis: usize| median(kept.iter().filter_map(|(_, _, c)| c.map(|c| c[axis])).collect());
    // Of two marks neither is the odd one.
    if kept.iter().filter(|(_, _, c)| c.is_some()).count() >= 3 {
        let (a, b) = (middle(1), middle(2));
        kept.retain(|(_, mark, colour)| {
            let off = colour.map_or(0.0, |c| (c[1] - a).hypot(c[2] - b));
            let odd = mark.listed && off > LIKE_THE_OTHERS;
            if odd {
                let reason = format!("the colour there is {off:.0} units of a*b* from that of the other marks");
                left_out.push(LeftOut { name: mark.name.clone(), reason });
            }
            !odd
        });
    }
    (kept.into_iter().map(|(patch, mark, _)| (patch, mark.at)).collect(), left_out)
}

fn report(profile: &Profile, outside: &[String], left_out: &[LeftOut]) {
    if !outside.is_empty() {
        eprintln!("outside the image: {}", outside.join(", "));
    }
    for mark in left_out {
        eprintln!("{} is left out: {}", mark.name, mark.reason);
    }
    let Some(l) = &profile.learned else { return };
    let [r, g, b] = l.mean_srgb.map(|v| (v * 255.0).round());
    eprintln!("{} marks, {} pixels of paint, mean colour {r} {g} {b}", l.marks, l.pixels);
    eprintln!("side {:.1} to {:.1} px, median {:.1}", l.side_px_min, l.side_px_max, l.side_px_median);
    eprintln!(
        "colour limit {:.2}; the nearest 1 % of the ground beside the marks is within {:.2}, {:.2} % of it would be taken for paint",
        profile.colour.limit,
        l.background_distance_p01,
        100.0 * l.background_share
    );
}
