//! Many rasters joined into one.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use autoref_elevation::mosaic::{Choice, MosaicJob};
use autoref_raster::atomic::{self, Existing};
use clap::Args;

use crate::cli::dem::{ResamplingArg, ResourceArgs};

/// Join rasters into one Cloud Optimized GeoTIFF, cell by cell from the source that is best there.
#[derive(Args, Debug)]
pub struct MosaicArgs {
    /// The sources.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The mosaic.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Which source a cell is taken from: min:PATTERN (smallest value of a companion raster; {stem} is the source's name),
    /// first, last, newest, nearest, median or feather.
    #[arg(long, value_name = "RULE", default_value = "first")]
    choose: Choice,
    /// Write which source won: its number from 1 on, 0 where none.
    #[arg(long, alias = "index", value_name = "FILE")]
    write_index: Option<PathBuf>,
    /// Take the sources from such a raster instead of choosing.
    #[arg(long, value_name = "FILE", conflicts_with = "write_index")]
    use_index: Option<PathBuf>,
    /// Even out brightness between sources: a gain and an offset for each band, from their overlaps.
    #[arg(long)]
    balance: bool,
    /// How sources on other grids are brought onto the mosaic's.
    #[arg(long, value_enum, default_value = "bilinear")]
    resampling: ResamplingArg,
    /// Side of a cell, in map units. Default: that of the first source.
    #[arg(long, value_name = "R")]
    resolution: Option<f64>,
    /// Print what was made as JSON.
    #[arg(long)]
    json: bool,
    /// Replace the outputs when they exist.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    resources: ResourceArgs,
}

pub fn run(args: &MosaicArgs) -> anyhow::Result<ExitCode> {
    let outputs: Vec<&Path> = std::iter::once(&args.out).chain(&args.write_index).map(PathBuf::as_path).collect();
    atomic::check_outputs(&outputs, Existing::of_flag(args.overwrite))?;
    let job = MosaicJob {
        inputs: &args.inputs,
        out: &args.out,
        choice: args.choose.clone(),
        resampling: args.resampling.into(),
        resolution: args.resolution,
        write_index: args.write_index.as_deref(),
        use_index: args.use_index.as_deref(),
        balance: args.balance,
        resources: args.resources.resources(),
    };
    let made = job.run()?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&made)?);
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "Mosaic               {} sources, {} x {} cells, {} filled",
        made.sources.len(),
        made.width,
        made.height,
        made.filled_cells
    );
    if let Some(balance) = &made.balance {
        println!("Overlap              band   RMS before    after   blocks");
        for o in &balance.overlaps {
            println!(
                "  {:>4} {:>4}          {:>4} {:>12.3} {:>8.3} {:>8}",
                o.first, o.second, o.band, o.rms_before, o.rms_after, o.blocks
            );
        }
    }
    println!("Written              {}", args.out.display());
    Ok(ExitCode::SUCCESS)
}
