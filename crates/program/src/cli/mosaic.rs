//! Many rasters joined into one.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use autoref_elevation::mosaic::{Choice, MosaicJob, Surface, WIDEST_BLEND_PX, companions};
use autoref_elevation::output;
use autoref_raster::atomic::Existing;
use autoref_raster::protected::protect;
use clap::{Args, ValueEnum};

use crate::cli::dem::{ResamplingArg, ResourceArgs};
use autoref_raster::words::counted;

/// Join rasters into one Cloud Optimized GeoTIFF, cell by cell from the source that is best there.
#[derive(Args, Debug)]
pub struct MosaicArgs {
    /// The sources.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// The mosaic.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Which source a cell is taken from: min:PATTERN (smallest value of a companion raster; {stem} is the source's
    /// name), first, last, newest, nearest, median or feather.
    #[arg(long, value_name = "RULE", default_value = "first")]
    choose: Choice,
    /// Write which source won: its number from 1 on, 0 where none.
    #[arg(long, alias = "index", value_name = "FILE")]
    write_index: Option<PathBuf>,
    /// Take the sources from such a raster instead of choosing.
    #[arg(long, value_name = "FILE", conflicts_with = "write_index")]
    use_index: Option<PathBuf>,
    /// Even out brightness between sources, from their overlaps: a gain, an offset and a smooth surface for each band.
    #[arg(long)]
    balance: bool,
    /// The surfaces of --balance: none (gains and offsets alone), linear or quadratic.
    #[arg(long, value_enum, value_name = "DEGREE", default_value = "quadratic", requires = "balance")]
    balance_surface: SurfaceArg,
    /// The source that --balance leaves as it is, so that the others take on its brightness.
    #[arg(long, value_name = "FILE", requires = "balance")]
    balance_to: Option<PathBuf>,
    /// A page (HTML) that shows how sources differ in their overlaps before and after --balance.
    #[arg(long, value_name = "FILE", requires = "balance")]
    balance_page: Option<PathBuf>,
    /// Let sources run into each other at seams, across so many cells (0: sharp). Median and feather have no seams.
    #[arg(long, value_name = "CELLS", default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=WIDEST_BLEND_PX))]
    blend: u64,
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

/// The degree of the surfaces.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum SurfaceArg {
    None,
    Linear,
    Quadratic,
}

impl From<SurfaceArg> for Surface {
    fn from(arg: SurfaceArg) -> Surface {
        match arg {
            SurfaceArg::None => Surface::None,
            SurfaceArg::Linear => Surface::Linear,
            SurfaceArg::Quadratic => Surface::Quadratic,
        }
    }
}

pub fn run(args: &MosaicArgs) -> anyhow::Result<ExitCode> {
    companions(&args.inputs, &args.choose).iter().for_each(|path| protect(path));
    let outputs = std::iter::once(&args.out).chain(&args.write_index).chain(&args.balance_page);
    let outputs: Vec<&Path> = outputs.map(PathBuf::as_path).collect();
    output::check(&outputs, Existing::of_flag(args.overwrite))?;
    let job = MosaicJob {
        inputs: &args.inputs,
        out: &args.out,
        choice: args.choose.clone(),
        resampling: args.resampling.into(),
        resolution: args.resolution,
        write_index: args.write_index.as_deref(),
        use_index: args.use_index.as_deref(),
        balance: args.balance.then(|| args.balance_surface.into()),
        balance_to: args.balance_to.as_deref(),
        blend_px: args.blend,
        page: args.balance_page.as_deref(),
        resources: args.resources.resources(),
    };
    let made = job.run()?;
    if made.filled_cells == 0 {
        eprintln!("autoref-stream: no source has data: no cell of the mosaic is filled");
    }
    let balanced = made.balance.iter().flat_map(|balance| &balance.notes);
    made.notes.iter().chain(balanced).for_each(|note| eprintln!("autoref-stream: {note}"));
    if args.json {
        println!("{}", serde_json::to_string_pretty(&made)?);
        return Ok(ExitCode::SUCCESS);
    }
    println!(
        "Mosaic               {}, {} x {} cells, {} filled",
        counted(made.sources.len(), "source", "sources"),
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
