//! `autoref-stream cloud`: point clouds cleaned, gridded and described, in streams.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_cloud::io::stem;
use autoref_cloud::{info, io, params};
use autoref_raster::bounded;
use autoref_raster::crs::Crs;
use autoref_raster::memory_plan::SMALLEST_BUDGET_BYTES;
use clap::{Args, Subcommand};

use crate::cli::prepare;
use crate::cli::values::Bytes;

/// Clean, grid and describe point clouds (LAS, LAZ, COPC, PLY, E57, text) of any size in bounded memory.
#[derive(Args, Debug)]
pub struct CloudArgs {
    #[command(subcommand)]
    command: CloudCommand,
}

#[derive(Subcommand, Debug)]
enum CloudCommand {
    Clean(Box<super::cloud_clean::CleanArgs>),
    Grid(Box<super::cloud_grid::GridArgs>),
    Info(InfoArgs),
}

/// Say what clouds are: format, points, extent, reference system, dimensions, classes.
#[derive(Args, Debug)]
pub struct InfoArgs {
    /// The clouds.
    #[arg(required = true, value_name = "IN")]
    clouds: Vec<PathBuf>,
    /// Map coordinates less the cloud's. Default: what the file says.
    #[arg(long, value_name = "E,N,H", allow_hyphen_values = true)]
    shift: Option<String>,
    /// Print one JSON document.
    #[arg(long)]
    json: bool,
}

/// Means that all cloud commands share.
#[derive(Args, Debug)]
pub struct MeansArgs {
    /// Map coordinates less the clouds' own: what was taken off before they were written. Default: what a file says.
    #[arg(long, value_name = "E,N,H", allow_hyphen_values = true, help_heading = "Reading")]
    pub shift: Option<String>,
    /// Coordinate reference system of clouds that name none (EPSG code, WKT, PROJ string or a file with one).
    #[arg(long, value_name = "CRS", help_heading = "Reading")]
    pub crs: Option<String>,
    /// Bound on the peak resident memory: bytes, or with K, M or G. At least 112M.
    #[arg(long, value_name = "SIZE", default_value = "512M", help_heading = "Resources")]
    pub memory: Bytes,
    /// Number of working threads. Default: one for each core.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1024), help_heading = "Resources")]
    pub threads: Option<u64>,
    /// Folder for temporary tiles, which are removed in any case. Default: the output's folder.
    #[arg(long, value_name = "DIR", help_heading = "Resources")]
    pub scratch: Option<PathBuf>,
    /// Replace existing outputs.
    #[arg(long, help_heading = "Writing")]
    pub overwrite: bool,
    /// Print what was done as one JSON document.
    #[arg(long, help_heading = "Writing")]
    pub json: bool,
}

impl MeansArgs {
    pub fn shift(&self) -> anyhow::Result<Option<[f64; 3]>> {
        Ok(self.shift.as_deref().map(|text| params::shift("--shift", text)).transpose()?)
    }

    /// Checks memory and clouds, starts the threads.
    pub fn begin(&self, clouds: &[PathBuf]) -> anyhow::Result<Begun> {
        if self.memory.0 < SMALLEST_BUDGET_BYTES {
            bail!("--memory is {} bytes; give 112M or more", self.memory.0);
        }
        autoref_raster::initialise_gdal(64 << 20);
        // Fails only when a pool exists already, which then serves.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(prepare::threads(self.threads)).build_global();
        let asked = self.crs.as_deref().map(Crs::parse).transpose()?;
        let mut of_clouds = asked.clone();
        let mut first: Option<(&Path, String)> =
            self.crs.as_deref().map(|text| (Path::new("--crs"), label(text, asked.as_ref())));
        for cloud in clouds {
            let (header, _) = io::open(cloud)?;
            let Some(text) = header.crs else { continue };
            let crs = Crs::parse(&text).ok();
            // What is not understood gives way to --crs.
            if crs.is_none() && asked.is_some() {
                continue;
            }
            let label = label(&text, crs.as_ref());
            of_clouds = of_clouds.or(crs);
            match &first {
                Some((other, known)) if *known != label => bail!(
                    "{}: its reference system is {}, that of {} is {}; give clouds of one system at a time",
                    cloud.display(),
                    short(&label),
                    other.display(),
                    short(known)
                ),
                Some(_) => {}
                None => first = Some((cloud, label)),
            }
        }
        Ok(Begun { asked, of_clouds })
    }
}

/// A reference system as a person reads it: code and name, and the unit where it is not the metre.
fn crs_words(text: &str) -> String {
    let Ok(crs) = Crs::parse(text) else { return text.to_string() };
    let unit = (!crs.is_geographic() && crs.metres_per_unit() != 1.0).then(|| format!(", in {}", crs.unit_name()));
    format!("{}{}", crs.title(), unit.unwrap_or_default())
}

/// The reference systems of a run.
pub struct Begun {
    /// That of --crs.
    pub asked: Option<Crs>,
    /// What the clouds are in, by themselves or by --crs.
    pub of_clouds: Option<Crs>,
}

/// By what reference systems are compared: heights that codes name beside the map make no difference.
fn label(text: &str, crs: Option<&Crs>) -> String {
    match text.strip_prefix("EPSG:").and_then(|codes| codes.split_once('+')) {
        Some((code, _)) => format!("EPSG:{code}"),
        None => crs.map_or_else(|| text.to_string(), Crs::label),
    }
}

/// A reference system by its name, where it has no code.
fn short(label: &str) -> &str {
    if label.contains('[') { label.split('"').nth(1).unwrap_or(label) } else { label }
}

/// A camera's place for each cloud.
pub enum Cameras {
    One([f64; 3]),
    /// Names of clouds, without folder and extension, and their cameras.
    Table(PathBuf, Vec<(String, [f64; 3])>),
}

impl Cameras {
    /// `E,N,H`, a table with the columns cloud, E, N, H, or a MicMac orientation with a `<Centre>`.
    pub fn read(text: &str) -> anyhow::Result<Cameras> {
        let path = Path::new(text);
        if !path.exists() {
            if !text.contains(',') {
                bail!("--range-from {text}: there is no such file; give E,N,H, or the name of a table cloud,E,N,H");
            }
            let numbers = params::numbers("--range-from", text, "E,N,H, or the name of a table cloud,E,N,H");
            return Ok(Cameras::One(numbers?));
        }
        let content = bounded::read_to_string(path, "a table of cameras", bounded::TEXT_BYTES)?;
        if let Some((_, rest)) = content.split_once("<Centre>") {
            let words = rest.split('<').next().unwrap_or_default().split_whitespace().collect::<Vec<_>>().join(",");
            return Ok(Cameras::One(params::numbers("--range-from", &words, "with a centre of three numbers")?));
        }
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(content.as_bytes());
        let heads: Vec<String> = reader.headers()?.iter().map(str::to_ascii_lowercase).collect();
        let column = |name: &str| {
            heads
                .iter()
                .position(|head| head == name)
                .with_context(|| format!("{}: no column `{name}`; the head must be cloud,E,N,H", path.display()))
        };
        let columns = [column("cloud")?, column("e")?, column("n")?, column("h")?];
        let mut rows = Vec::new();
        for (number, row) in reader.records().enumerate() {
            let row = row.with_context(|| format!("{}: row {}", path.display(), number + 2))?;
            let field = |index: usize| row.get(columns[index]).unwrap_or_default();
            let mut camera = [0.0; 3];
            for (axis, value) in camera.iter_mut().enumerate() {
                let text = field(axis + 1);
                *value = text
                    .parse()
                    .ok()
                    .filter(|value: &f64| value.is_finite())
                    .with_context(|| format!("{}: row {}: `{text}` is no number", path.display(), number + 2))?;
            }
            rows.push((stem(Path::new(field(0))), camera));
        }
        Ok(Cameras::Table(path.to_path_buf(), rows))
    }

    pub fn of(&self, cloud: &Path) -> anyhow::Result<[f64; 3]> {
        match self {
            Cameras::One(camera) => Ok(*camera),
            Cameras::Table(path, rows) => {
                let wanted = stem(cloud);
                rows.iter().find(|(name, _)| *name == wanted).map(|(_, camera)| *camera).with_context(|| {
                    format!("{}: no row for the cloud {wanted}; add cloud,E,N,H of its camera", path.display())
                })
            }
        }
    }
}

pub fn run(args: &CloudArgs) -> anyhow::Result<ExitCode> {
    match &args.command {
        CloudCommand::Clean(args) => super::cloud_clean::run(args),
        CloudCommand::Grid(args) => super::cloud_grid::run(args),
        CloudCommand::Info(args) => run_info(args),
    }
}

fn run_info(args: &InfoArgs) -> anyhow::Result<ExitCode> {
    let shift = args.shift.as_deref().map(|text| params::shift("--shift", text)).transpose()?;
    let mut all = Vec::new();
    for cloud in &args.clouds {
        let mut info = info::info(cloud, shift)?;
        let is_code = |text: &str| text.starts_with("EPSG:");
        info.crs = info.crs.map(|text| match Crs::parse(&text) {
            Ok(crs) if !is_code(&text) => crs.label(),
            _ => text,
        });
        all.push(info);
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&serde_json::json!({ "clouds": all }))?);
        return Ok(ExitCode::SUCCESS);
    }
    for info in all {
        println!("{}: {}, {} points", info.path.display(), info.format, info.points);
        if let (Some(min), Some(max)) = (info.min, info.max) {
            for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
                println!("  {name} {:.3} … {:.3}", min[axis], max[axis]);
            }
        }
        if let Some(density) = info.points_per_m2 {
            println!("  {density:.3} points a square metre of its rectangle");
        }
        println!("  reference system: {}", info.crs.as_deref().map_or_else(|| "none named".into(), crs_words));
        println!("  dimensions: {}", info.dimensions.join(", "));
        let classes: Vec<String> = info.classes.iter().map(|(class, count)| format!("{class}: {count}")).collect();
        if !classes.is_empty() {
            println!("  classes: {}", classes.join(", "));
        }
        if info.invalid > 0 {
            println!("  {} points have coordinates that are not finite", info.invalid);
        }
        info.notes.iter().for_each(|note| println!("  note: {note}"));
    }
    Ok(ExitCode::SUCCESS)
}
