//! `autoref-stream cloud grid`: rasters of what points carry.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_cloud::grid::{self, Dimension, Manner, Noise, Options, Stat};
use autoref_cloud::params;
use autoref_raster::atomic::{self, Existing};
use autoref_raster::output_folder::OutputFolder;
use clap::Args;

use super::cloud_cameras::Cameras;
use super::cloud_means::MeansArgs;
use autoref_raster::words::counted;

/// Grid clouds: one Cloud Optimized GeoTIFF for each dimension and statistic, and one with its holes filled.
///
/// Files are named STEM_DIMENSION_STAT.tif and STEM_DIMENSION_filled.tif; the latter has the filled statistic, a flag
/// (0 measured, 1 filled, 2 empty), the count, and further filled statistics.
#[derive(Args, Debug)]
#[command(
    after_help = "Example, as in the thesis of 2017:\n  autoref-stream cloud grid clean/*.laz -o grids --cell 2 --stat mean,count --dimension intensity,z,range --radius z=2.828,range=1.414"
)]
pub struct GridArgs {
    /// The clouds; each gets its own grids.
    #[arg(required = true, value_name = "IN")]
    clouds: Vec<PathBuf>,
    /// Folder of the rasters; made when it is missing.
    #[arg(short, long = "out", value_name = "DIR")]
    output: PathBuf,
    /// Side of a cell, metres.
    #[arg(long, value_name = "M", default_value_t = 2.0)]
    cell: f64,
    /// mean, median, min, max, count, stdev, idw.
    #[arg(long, value_name = "STAT,…", value_delimiter = ',', default_value = "mean,count")]
    stat: Vec<String>,
    /// What is gridded: x, y, z, range, intensity, red, or any dimension of the clouds.
    #[arg(long, value_name = "NAME,…", value_delimiter = ',', default_value = "z")]
    dimension: Vec<String>,
    /// Points count that are nearer to a cell's centre: metres, or by dimension as z=2.828,range=1.414. Default: √2
    /// cells for z, √½ cells for everything else; with --like-pdal √2 cells for all.
    #[arg(long, value_name = "R|NAME=R,…")]
    radius: Option<String>,
    /// Window that fills holes: its width in cells when odd (5 is 5 × 5), cells to each side when even (2 is 5 × 5, as
    /// PDAL's window_size); 0 fills none. Default: 5.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=201))]
    fill: Option<u16>,
    /// Exponent of the inverse distance, in idw and when holes are filled. Default: 1.
    #[arg(long, value_name = "P")]
    power: Option<f64>,
    /// Begin the cells at the cloud's least x and y, fill with PDAL's weights, take every class.
    #[arg(long)]
    like_pdal: bool,
    /// Take points of the classes 7 and 18 (noise) and those flagged as withheld, too.
    #[arg(long)]
    keep_noise: bool,
    /// The camera for the dimension range: a place in map coordinates, a table cloud,E,N,H, or a MicMac orientation.
    #[arg(long, value_name = "E,N,H|FILE", allow_hyphen_values = true)]
    range_from: Option<String>,
    #[command(flatten)]
    means: MeansArgs,
}

impl GridArgs {
    fn dimensions(&self) -> anyhow::Result<Vec<Dimension>> {
        let form = "--radius R, or --radius z=R,range=R";
        let mut general = None;
        let mut own: Vec<(String, f64)> = Vec::new();
        for part in self.radius.iter().flat_map(|text| text.split(',')) {
            let (name, number) = part.split_once('=').map_or((None, part), |(name, number)| (Some(name), number));
            let value: f64 = number
                .trim()
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
                .with_context(|| format!("--radius: `{}` is no number; write {form}", number.trim()))?;
            let value = params::positive("--radius", "radius", value)?;
            match name {
                Some(name) => own.push((name.trim().to_ascii_lowercase(), value)),
                None => general = Some(value),
            }
        }
        let mut dimensions: Vec<Dimension> = Vec::new();
        for name in &self.dimension {
            let name = name.trim().to_ascii_lowercase();
            if name.is_empty() || dimensions.iter().any(|dimension| dimension.name == name) {
                bail!("--dimension: `{name}` is empty or given twice; write --dimension z,intensity,range");
            }
            let wide = if self.like_pdal || name == "z" { 2f64.sqrt() } else { 0.5f64.sqrt() };
            let found = own.iter().find(|(own, _)| *own == name).map(|(_, radius)| *radius);
            let radius_m = found.or(general).unwrap_or(wide * self.cell);
            dimensions.push(Dimension { name, radius_m });
        }
        if let Some((name, _)) = own.iter().find(|(own, _)| dimensions.iter().all(|dimension| dimension.name != *own)) {
            bail!("--radius: `{name}` is not gridded; add it to --dimension");
        }
        if let Some(dimension) = dimensions.iter().find(|dimension| dimension.radius_m > 1000.0 * self.cell) {
            bail!("--radius: {} m are more than 1000 cells; give a smaller one", dimension.radius_m);
        }
        Ok(dimensions)
    }
}

/// Width of the window that fills holes, cells.
const USUAL_FILL: u16 = 5;
/// Inverse distances without a power.
const PLAIN_POWER: f64 = 1.0;

impl GridArgs {
    /// The window that fills holes; an error where it would change nothing.
    fn fill_for(&self, stats: &[(String, Stat)]) -> anyhow::Result<usize> {
        if self.fill.is_some() && stats.iter().all(|(_, stat)| *stat == Stat::Count) {
            bail!(
                "--fill has no effect: no --stat but count is asked for, and counts are not filled; leave --fill out"
            );
        }
        Ok(usize::from(self.fill.unwrap_or(USUAL_FILL)))
    }

    /// The power of inverse distances; an error where it would change nothing.
    fn power_for(&self, stats: &[(String, Stat)]) -> anyhow::Result<f64> {
        let Some(power) = self.power else { return Ok(PLAIN_POWER) };
        if !(power > 0.0 && power <= 10.0) {
            bail!("--power: {power} is not above 0 and at most 10; 1 to 3 are usual");
        }
        // A window of one cell has no other cell in it, and counts are not filled.
        let fills = self.fill.unwrap_or(USUAL_FILL) > 1 && stats.iter().any(|(_, stat)| *stat != Stat::Count);
        if (!fills || self.like_pdal) && stats.iter().all(|(_, stat)| *stat != Stat::Idw) {
            bail!(
                "--power has no effect: no --stat is idw, and holes are {}; add idw to --stat, or leave --power out",
                if fills { "filled with PDAL's weights" } else { "not filled" }
            );
        }
        Ok(power)
    }
}

/// Coordinates of maps have no finer digits.
const LEAST_CELL: f64 = 1e-9;

pub fn run(args: &GridArgs) -> anyhow::Result<ExitCode> {
    params::positive("--cell", "cell", args.cell)?;
    if args.cell < LEAST_CELL {
        bail!(
            "--cell: {} is no side of a cell that a file can tell from the next; give at least {LEAST_CELL}",
            args.cell
        );
    }
    let mut stats = Vec::new();
    for name in &args.stat {
        let name = name.trim().to_ascii_lowercase();
        if stats.iter().any(|(known, _)| *known == name) {
            bail!("--stat: `{name}` is given twice");
        }
        let stat = Stat::read(&name)?;
        stats.push((name, stat));
    }
    let power = args.power_for(&stats)?;
    let fill = args.fill_for(&stats)?;
    let cameras = args.range_from.as_deref().map(Cameras::read).transpose()?;
    let dimensions = args.dimensions()?;
    if args.range_from.is_some() && dimensions.iter().all(|dimension| dimension.name != "range") {
        bail!("--range-from has no effect: `range` is not gridded; add it to --dimension, or leave --range-from out");
    }
    let crs_wkt = args.means.begin(&args.clouds)?.asked.map(|crs| crs.wkt().to_string());
    let _folder = OutputFolder::make(&args.output)?;
    let mut options = Options {
        cell_m: args.cell,
        stats,
        dimensions,
        fill_cells: if fill % 2 == 1 { fill / 2 } else { fill },
        power,
        manner: if args.like_pdal { Manner::Pdal } else { Manner::Snapped },
        noise: if args.like_pdal || args.keep_noise { Noise::Keep } else { Noise::LeaveOut },
        shift: args.means.shift()?,
        camera: None,
        memory_bytes: args.means.memory.0,
        scratch: args.means.scratch.clone().unwrap_or_else(|| args.output.clone()),
        crs_wkt,
    };
    let mut all: Vec<PathBuf> = Vec::new();
    for cloud in &args.clouds {
        let paths = grid::output_paths(cloud, &args.output, &options);
        if let Some(twice) = paths.iter().find(|path| all.contains(path)) {
            bail!("two clouds would both become {}; grid them into folders of their own", twice.display());
        }
        let borrowed: Vec<&Path> = paths.iter().map(PathBuf::as_path).collect();
        atomic::check_outputs(&borrowed, Existing::of_flag(args.means.overwrite))?;
        all.extend(paths);
    }
    let mut reports = Vec::new();
    for cloud in &args.clouds {
        options.camera = cameras.as_ref().map(|cameras| cameras.of(cloud)).transpose()?;
        let report = grid::grid(cloud, &args.output, &options)?;
        if !args.means.json {
            println!(
                "{}: {}, {} × {} cells of {} {}, {}",
                cloud.display(),
                counted(report.points, "point", "points"),
                report.frame.columns,
                report.frame.rows,
                report.frame.cell_m,
                report.unit,
                counted(report.files_written.len(), "file", "files")
            );
        }
        reports.push(report);
    }
    if args.means.json {
        let told: Vec<_> = all.iter().map(|path| path.to_string_lossy()).collect();
        println!("{}", serde_json::to_string_pretty(&serde_json::json!({ "files_written": told, "clouds": reports }))?);
    }
    Ok(ExitCode::SUCCESS)
}
