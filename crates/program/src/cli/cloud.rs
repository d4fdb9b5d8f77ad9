//! `autoref-stream cloud`: point clouds cleaned, gridded and described, in streams.

use std::path::PathBuf;
use std::process::ExitCode;

use autoref_cloud::{info, params};
use autoref_raster::crs::Crs;
use autoref_raster::words::with_decimals;
use clap::{Args, Subcommand};

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

/// A reference system as a person reads it: code and name, and the unit where it is not the metre.
fn crs_words(text: &str) -> String {
    let Ok(crs) = Crs::parse(text) else { return text.to_string() };
    let unit = (!crs.is_geographic() && crs.metres_per_unit() != 1.0).then(|| format!(", in {}", crs.unit_name()));
    format!("{}{}", crs.title(), unit.unwrap_or_default())
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
                println!("  {name} {} … {}", with_decimals(min[axis], 3), with_decimals(max[axis], 3));
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
