//! Elevation models: aligned, compared, drawn.

mod align;
mod drawings;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_elevation::compare::{CompareJob, Summary};
use autoref_elevation::derive;
use autoref_elevation::files::Resources;
use autoref_elevation::output;
use autoref_elevation::profile;
use autoref_elevation::resample::Interpolation;
use autoref_elevation::resampled;
use autoref_raster::atomic::{self, Existing};
use autoref_raster::cells::csv_text;
use clap::{Args, Subcommand, ValueEnum};

use crate::cli::values::{Bytes, positive, unsigned_zero};
use align::{AlignArgs, align};
use drawings::{ColourArgs, GradientArgs, HillshadeArgs, NeighbourArgs, SlopeArgs, TriArgs};

/// Align, compare and draw elevation models.
#[derive(Args, Debug)]
pub struct DemArgs {
    #[command(subcommand)]
    command: DemCommand,
}

#[derive(Subcommand, Debug)]
enum DemCommand {
    /// Bring one model onto another: shift, height, tilt or a bent surface.
    Align(AlignArgs),
    /// Subtract one model from another: statistics by class and zone, volumes with their errors, a page.
    Compare(CompareArgs),
    /// Hillshade (Horn 1981).
    Hillshade(HillshadeArgs),
    /// Slope, in degrees or per cent.
    Slope(SlopeArgs),
    /// Aspect, in degrees from north by east.
    Aspect(GradientArgs),
    /// Largest difference within 3 x 3 cells.
    Roughness(NeighbourArgs),
    /// Terrain ruggedness index.
    Tri(TriArgs),
    /// Topographic position index.
    Tpi(NeighbourArgs),
    /// Contour lines as GeoPackage, GeoJSON or Shapefile.
    Contour(ContourArgs),
    /// Heights along a line over several models, as CSV.
    Profile(ProfileArgs),
    /// The model at coarser or finer cells.
    Resample(ResampleArgs),
    /// Colours by height, from a table as gdaldem takes it.
    Colour(ColourArgs),
}

/// What a command may take.
#[derive(Args, Debug, Clone)]
pub struct ResourceArgs {
    /// Side of the tiles, in cells. Default: chosen from the files' layout and --memory.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000), help_heading = "Resources")]
    tile: Option<u64>,
    #[command(flatten)]
    workers: WorkerArgs,
}

/// What a command may take that has no tiles.
#[derive(Args, Debug, Clone)]
struct WorkerArgs {
    /// Number of working threads. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024), help_heading = "Resources")]
    threads: Option<u64>,
    #[command(flatten)]
    memory: MemoryArgs,
}

/// What a command may take that works on one thread.
#[derive(Args, Debug, Clone)]
struct MemoryArgs {
    /// Bound on the peak resident memory: bytes, or with K, M or G. At least 112M.
    #[arg(long, value_name = "SIZE", default_value = "512M", help_heading = "Resources")]
    memory: Bytes,
}

impl ResourceArgs {
    pub fn resources(&self) -> Resources {
        Resources { tile_px: self.tile, ..self.workers.resources() }
    }
}

impl WorkerArgs {
    fn resources(&self) -> Resources {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Resources { threads: self.threads.map_or(cores, |n| n as usize), ..self.memory.resources() }
    }
}

impl MemoryArgs {
    fn resources(&self) -> Resources {
        Resources { tile_px: None, threads: 1, memory_budget_bytes: self.memory.0 }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ResamplingArg {
    Nearest,
    Bilinear,
    Cubic,
}

impl From<ResamplingArg> for Interpolation {
    fn from(value: ResamplingArg) -> Self {
        match value {
            ResamplingArg::Nearest => Interpolation::Nearest,
            ResamplingArg::Bilinear => Interpolation::Bilinear,
            ResamplingArg::Cubic => Interpolation::Cubic,
        }
    }
}

#[derive(Args, Debug)]
struct CompareArgs {
    /// Differences are A − B.
    a: PathBuf,
    /// Its grid is the common one.
    b: PathBuf,
    /// Folder of the results.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Polygons with statistics and volumes of their own: glaciers, flight lines.
    #[arg(long, value_name = "FILE")]
    zones: Option<PathBuf>,
    /// How A is brought onto B's grid. Of an A with cells finer than B's by more than 5 % it is the mean over each of
    /// B's cells, whatever is said here.
    #[arg(long, value_enum, default_value = "bilinear")]
    resampling: ResamplingArg,
    /// Lower limits of the slope classes, per cent.
    #[arg(long, value_name = "P,…", value_delimiter = ',', default_value = "0,5,10,25,45")]
    slope_classes: Vec<f64>,
    /// Tell the share of differences within so many metres.
    #[arg(long, value_name = "M", default_value_t = 25.0, value_parser = positive)]
    within: f64,
    /// Leave out differences farther from the mean than so many standard deviations.
    #[arg(long, value_name = "K", value_parser = positive)]
    outliers: Option<f64>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
    /// Replace the folder when it exists.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    resources: ResourceArgs,
}

#[derive(Args, Debug)]
struct ContourArgs {
    /// The model.
    model: PathBuf,
    /// The file of lines: .gpkg, .geojson or .shp.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Height between two lines, metres whatever the model's unit; so is `elev`.
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    interval: f64,
    /// A height at which a line lies, metres.
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_hyphen_values = true)]
    base: f64,
    /// Replace the output when it exists.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    resources: MemoryArgs,
}

#[derive(Args, Debug)]
struct ProfileArgs {
    /// The models.
    #[arg(required = true)]
    models: Vec<PathBuf>,
    /// Positions in the models' CRS, parted by blanks or semicolons: "x,y x,y …".
    #[arg(long, value_name = "X,Y …", allow_hyphen_values = true, value_parser = positions)]
    line: Line,
    /// Metres between two stations, of which there are 5,000,000 at most; the line's corners and its end are stations,
    /// too. Default: a cell of the first model.
    #[arg(long, value_name = "M")]
    step: Option<f64>,
    /// The table. Default: standard output.
    #[arg(short, long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replace the output when it exists.
    #[arg(long)]
    overwrite: bool,
}

/// A line of map positions.
#[derive(Clone, Debug)]
struct Line(Vec<(f64, f64)>);

fn positions(text: &str) -> Result<Line, String> {
    let position = |part: &str| {
        let numbers: Option<Vec<f64>> = part.split(',').map(|v| v.trim().parse().ok()).collect();
        match numbers.as_deref() {
            Some([x, y]) if x.is_finite() && y.is_finite() => Ok((*x, *y)),
            _ => Err(format!("`{part}` is no position; write x,y")),
        }
    };
    let parts = text.split(|c: char| c == ';' || c.is_whitespace()).filter(|part| !part.is_empty());
    let line: Vec<(f64, f64)> = parts.map(position).collect::<Result<_, _>>()?;
    if line.len() < 2 { Err("a line has at least two positions: \"x,y x,y\"".into()) } else { Ok(Line(line)) }
}

/// What `gdalwarp -r` takes.
const WARP_RESAMPLINGS: [&str; 14] = [
    "near",
    "bilinear",
    "cubic",
    "cubicspline",
    "lanczos",
    "average",
    "rms",
    "mode",
    "max",
    "min",
    "med",
    "q1",
    "q3",
    "sum",
];

#[derive(Args, Debug)]
struct ResampleArgs {
    /// The model.
    model: PathBuf,
    /// The GeoTIFF to write; with several resolutions `{res}` in it is each of them.
    #[arg(short, long, value_name = "FILE")]
    out: String,
    /// Sides of the cells, in map units.
    #[arg(long, value_name = "R,…", value_delimiter = ',', required = true, allow_hyphen_values = true)]
    resolution: Vec<f64>,
    /// As gdalwarp names it.
    #[arg(long, value_name = "NAME", default_value = "average", value_parser = WARP_RESAMPLINGS)]
    resampling: String,
    /// Replace the output when it exists.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    resources: WorkerArgs,
}

pub fn run(args: &DemArgs) -> anyhow::Result<ExitCode> {
    match &args.command {
        DemCommand::Align(args) => return align(args),
        DemCommand::Compare(args) => compare(args)?,
        DemCommand::Hillshade(args) => drawings::hillshade(args)?,
        DemCommand::Slope(args) => drawings::slope(args)?,
        DemCommand::Aspect(args) => drawings::aspect(args)?,
        DemCommand::Roughness(args) => drawings::roughness(args)?,
        DemCommand::Tri(args) => drawings::ruggedness(args)?,
        DemCommand::Tpi(args) => drawings::position(args)?,
        DemCommand::Contour(args) => contour(args)?,
        DemCommand::Profile(args) => line(args)?,
        DemCommand::Resample(args) => resample(args)?,
        DemCommand::Colour(args) => drawings::colours(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn compare(args: &CompareArgs) -> anyhow::Result<()> {
    let empty = || std::fs::read_dir(&args.out).is_ok_and(|mut entries| entries.next().is_none());
    if args.out.exists() && !args.overwrite && !empty() {
        bail!("{} exists; give --overwrite to replace it", args.out.display());
    }
    if args.out.file_name().is_none() {
        bail!("{}: is no name for a folder; give one that can be made", args.out.display());
    }
    check_replaceable(&args.out)?;
    if args.slope_classes.iter().any(|v| !v.is_finite()) || !args.slope_classes.is_sorted() {
        bail!("--slope-classes are no rising numbers; write them like 0,5,10,25,45");
    }
    let job = CompareJob {
        a: &args.a,
        b: &args.b,
        zones: args.zones.as_deref(),
        resampling: args.resampling.into(),
        slope_limits: &args.slope_classes,
        within_m: args.within,
        outliers: args.outliers,
        resources: args.resources.resources(),
    };
    let summary = atomic::folder(&args.out, |folder| job.run(folder))?;
    summary.warnings.iter().for_each(|warning| eprintln!("autoref-stream: {warning}"));
    if args.json {
        println!("{}", serde_json::to_string_pretty(&summary)?);
    } else {
        print(&summary, &args.out);
    }
    Ok(())
}

/// What `dem compare` writes into its folder.
const COMPARISON: [&str; 6] =
    ["difference.tif", "report.html", "statistics.csv", "summary.json", "variogram.csv", "volumes.csv"];

/// Refuses to clear a folder that holds anything but an earlier comparison, or an input of the command.
fn check_replaceable(folder: &Path) -> anyhow::Result<()> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        // Not there, or a file: the callers say so.
        Err(_) => return Ok(autoref_raster::protected::refuse_input(folder)?),
    };
    for entry in entries {
        let path = entry.with_context(|| format!("{}: cannot list the folder", folder.display()))?.path();
        autoref_raster::protected::refuse_input(&path)?;
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if path.is_dir() || !COMPARISON.contains(&name.trim_end_matches(".aux.xml")) {
            bail!(
                "{}: {name} in it is not of an earlier comparison, and the folder would be replaced whole; \
                 name another folder with --out",
                folder.display()
            );
        }
    }
    Ok(())
}

fn print(summary: &Summary, folder: &Path) {
    let figure = |value: Option<f64>| value.map_or("–".to_string(), |v| format!("{:.4}", unsigned_zero(v, 4)));
    println!("Differences          A − B, {} cells", summary.common_cells);
    match summary.mean_se_m.zip(summary.effective_n) {
        Some((se_m, n)) => {
            println!("Mean                 {} ± {se_m:.4} m ({n:.0} independent cells)", figure(summary.mean_m));
        }
        None => println!(
            "Mean                 {} m; how well is not known: too little ground outside the zones tells how differences \
             hang together",
            figure(summary.mean_m)
        ),
    }
    println!("Median, NMAD         {} m, {} m", figure(summary.median_m), figure(summary.nmad_m));
    println!("SD, RMSE             {} m, {} m", figure(summary.sd_m), figure(summary.rmse_m));
    println!("Heights              {}", summary.heights);
    for volume in &summary.volumes {
        match volume.volume_m3.zip(volume.volume_se_m3) {
            Some((m3, se_m3)) => {
                println!("Volume               {}: {:.0} ± {se_m3:.0} m³", volume.zone, unsigned_zero(m3, 0))
            }
            None => match volume.volume_m3 {
                Some(m3) => println!(
                    "Volume               {}: {:.0} m³, how well is not known",
                    volume.zone,
                    unsigned_zero(m3, 0)
                ),
                None => println!("Volume               {}: no cell of both models lies in it", volume.zone),
            },
        }
    }
    println!("Written              {}", folder.display());
}

fn contour(args: &ContourArgs) -> anyhow::Result<()> {
    atomic::check_outputs(&[&args.out], Existing::of_flag(args.overwrite))?;
    derive::line_driver(&args.out)?;
    let resources = args.resources.resources();
    resources.check()?;
    derive::check_heights(&args.model)?;
    let memory = resources.memory_budget_bytes;
    let mut lines = 0;
    atomic::with_temporary(&args.out, |path| {
        lines = derive::contour(&args.model, path, args.interval, args.base, memory)?;
        Ok(())
    })?;
    if lines == 0 {
        println!("No line crosses the model: a smaller --interval or another --base may draw some");
    }
    println!("Written              {}", args.out.display());
    Ok(())
}

fn line(args: &ProfileArgs) -> anyhow::Result<()> {
    if let Some(out) = &args.out {
        atomic::check_outputs(&[out], Existing::of_flag(args.overwrite))?;
    }
    let stations = profile::along(&args.models, &args.line.0, args.step)?;
    if stations.iter().all(|station| station.heights_m.iter().all(Option::is_none)) {
        bail!("no model has a height on this line; give it in the CRS of the first model (gdalinfo shows its extent)");
    }
    let mut text = String::from("distance_m,x,y");
    for model in &args.models {
        text.push_str(&format!(",{}", csv_text(&model.display().to_string())));
    }
    text.push('\n');
    for station in stations {
        text.push_str(&format!("{},{},{}", station.distance_m, station.x, station.y));
        for height in station.heights_m {
            text.push_str(&height.map_or(",".to_string(), |h| format!(",{h}")));
        }
        text.push('\n');
    }
    match &args.out {
        Some(out) => atomic::write(out, text.as_bytes())?,
        None => crate::out::product(&text),
    }
    Ok(())
}

fn resample(args: &ResampleArgs) -> anyhow::Result<()> {
    if args.resolution.len() > 1 && !args.out.contains("{res}") {
        bail!("several resolutions and one output; write -o model_{{res}}.tif");
    }
    if args.resolution.iter().any(|r| !(*r > 0.0 && r.is_finite())) {
        bail!("--resolution is no positive length; give sides of cells in map units");
    }
    let outs: Vec<PathBuf> =
        args.resolution.iter().map(|r| PathBuf::from(args.out.replace("{res}", &r.to_string()))).collect();
    output::check(&outs.iter().map(PathBuf::as_path).collect::<Vec<_>>(), Existing::of_flag(args.overwrite))?;
    let resources = args.resources.resources();
    resources.check()?;
    derive::check_heights(&args.model)?;
    derive::check_resampling(&args.model, &args.resampling)?;
    args.resolution.iter().try_for_each(|side| derive::check_resolution(&args.model, *side))?;
    for (out, resolution) in outs.iter().zip(&args.resolution) {
        atomic::with_temporary(out, |path| {
            resampled::resample(&args.model, path, *resolution, &args.resampling, resources.threads)
        })?;
        println!("Written              {}", out.display());
    }
    Ok(())
}
