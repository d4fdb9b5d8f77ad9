//! `autoref-stream sample`: learn a profile from marks that somebody points at.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use autoref_stream::candidate::patch::patch_from_block;
use autoref_stream::coords::PixelPoint;
use autoref_stream::profile::{DEFAULT_REACH_PX, Profile, learn};
use autoref_stream::raster::{Patch, RasterSource, ReaderChoice, open};
use autoref_stream::window::Window;

/// Learn a mark profile from marks in an image and write it as TOML.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image.
    image: PathBuf,
    /// Position of the middle of a mark, pixels from the upper left corner; repeat for more marks.
    #[arg(long = "at", value_name = "X,Y", value_parser = parse_point)]
    at: Vec<PixelPoint>,
    /// Take the marks from the matches of an earlier run's .autoref.json.
    #[arg(long, value_name = "JSON")]
    result: Option<PathBuf>,
    /// How far around a mark to look, pixels; at least the mark's own size.
    #[arg(long, value_name = "PX", default_value_t = DEFAULT_REACH_PX)]
    reach_px: u64,
    /// Name of the new profile.
    #[arg(long, default_value = "taught")]
    name: String,
    /// Where to write the profile; standard output when absent.
    #[arg(short, long, value_name = "TOML")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print the profile as one JSON document on standard output, instead of TOML when no file is named.
    #[arg(long)]
    json: bool,
}

/// "x,y" in pixels.
pub fn parse_point(text: &str) -> Result<PixelPoint, String> {
    let wrong = || format!("\"{text}\" is not X,Y in pixels");
    let (x, y) = text.split_once(',').ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite() && *v >= 0.0);
    Ok(PixelPoint { x: number(x).ok_or_else(wrong)?, y: number(y).ok_or_else(wrong)? })
}

/// Names and positions of the matches in a result file.
pub fn matches_of(path: &std::path::Path) -> Result<Vec<(String, PixelPoint)>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("{}: cannot read it", path.display()))?;
    let json: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("{}: not a result file", path.display()))?;
    let matches = json["matches"].as_array().map(Vec::as_slice).unwrap_or_default();
    let found: Vec<_> = matches
        .iter()
        .filter_map(|m| {
            let name = m["gcp"].as_str().map_or_else(|| m["gcp"].to_string(), str::to_owned);
            Some((name, PixelPoint { x: m["x"].as_f64()?, y: m["y"].as_f64()? }))
        })
        .collect();
    if found.is_empty() {
        bail!("{}: holds no matches; give positions with --at", path.display());
    }
    Ok(found)
}

/// The pixels around a position, clipped to the image.
pub fn patch_around(source: &dyn RasterSource, at: PixelPoint, reach_px: u64) -> Result<Patch> {
    let info = source.info();
    if at.x >= info.width as f64 || at.y >= info.height as f64 {
        bail!(
            "{}: {},{} lies outside the image, which is {} × {} pixels",
            info.path.display(),
            at.x,
            at.y,
            info.width,
            info.height
        );
    }
    let window = Window::new(at.x as u64, at.y as u64, 1, 1).grown(reach_px, &info.bounds());
    Ok(patch_from_block(&source.read(window)?, info))
}

pub fn run(args: &Args) -> Result<()> {
    if let Some(path) = &args.output
        && path.exists()
        && !args.overwrite
    {
        bail!("{} exists; give --overwrite to replace it", path.display());
    }
    let mut points = args.at.clone();
    if let Some(path) = &args.result {
        points.extend(matches_of(path)?.into_iter().map(|(_, p)| p));
    }
    let source = open(&args.image, ReaderChoice::Auto, 0, 64 << 20)?;
    let reach_px = args.reach_px.clamp(8, 2048);
    let marks = points
        .into_iter()
        .map(|at| Ok((patch_around(source.as_ref(), at, reach_px)?, at)))
        .collect::<Result<Vec<_>>>()?;
    let profile = learn(&args.name, &marks)?;
    report(&profile);
    match &args.output {
        Some(path) => std::fs::write(path, profile.to_toml())
            .with_context(|| format!("{}: cannot write the profile", path.display()))?,
        None if args.json => {}
        None => print!("{}", profile.to_toml()),
    }
    if args.json {
        let files: Vec<String> = args.output.iter().map(|path| path.display().to_string()).collect();
        let document = serde_json::json!({"files_written": files, "profile": profile});
        println!("{}", serde_json::to_string_pretty(&document)?);
    }
    Ok(())
}

fn report(profile: &Profile) {
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
