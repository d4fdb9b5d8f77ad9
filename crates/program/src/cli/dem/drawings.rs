//! Drawings of one model: hillshade, slope, aspect, indices of roughness, colours by height.

use std::path::{Path, PathBuf};

use autoref_elevation::derive::{self, Drawing};
use autoref_elevation::gradient::{self, Edges, Kernel, Picture};
use autoref_elevation::output;
use autoref_raster::atomic::{self, Existing};
use clap::{Args, ValueEnum};

use super::{MemoryArgs, WorkerArgs};

#[derive(Args, Debug)]
struct DrawArgs {
    /// The model.
    model: PathBuf,
    /// The GeoTIFF to write.
    #[arg(short, long, value_name = "FILE")]
    out: PathBuf,
    /// Replace the output when it exists.
    #[arg(long)]
    overwrite: bool,
}

/// A drawing that looks at the neighbours of a cell.
#[derive(Args, Debug)]
struct EdgeArgs {
    /// Compute the cells at the border and beside cells without a height, too.
    #[arg(long)]
    compute_edges: bool,
}

/// A drawing by GDAL's functions from 3 × 3 cells.
#[derive(Args, Debug)]
pub struct NeighbourArgs {
    #[command(flatten)]
    draw: DrawArgs,
    #[command(flatten)]
    edges: EdgeArgs,
    #[command(flatten)]
    resources: MemoryArgs,
}

impl EdgeArgs {
    /// The option of gdaldem.
    fn option(&self) -> Option<String> {
        self.compute_edges.then(|| "-compute_edges".into())
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum GradientArg {
    Horn,
    ZevenbergenThorne,
}

#[derive(Args, Debug)]
pub struct GradientArgs {
    #[command(flatten)]
    draw: DrawArgs,
    #[command(flatten)]
    edges: EdgeArgs,
    #[command(flatten)]
    resources: WorkerArgs,
    /// How the gradient is taken.
    #[arg(long, value_enum, default_value = "horn")]
    alg: GradientArg,
}

#[derive(Args, Debug)]
pub struct HillshadeArgs {
    #[command(flatten)]
    gradient: GradientArgs,
    /// Where the light comes from, degrees from north by east.
    #[arg(long, alias = "az", value_name = "DEG", default_value_t = 315.0, allow_hyphen_values = true)]
    azimuth: f64,
    /// How high it stands, degrees.
    #[arg(long, alias = "alt", value_name = "DEG", default_value_t = 45.0, allow_hyphen_values = true)]
    altitude: f64,
    /// Heights are multiplied by this.
    #[arg(long, value_name = "Z", default_value_t = 1.0)]
    z: f64,
    /// Light from several directions.
    #[arg(long, conflicts_with = "azimuth")]
    multidirectional: bool,
}

#[derive(Args, Debug)]
pub struct SlopeArgs {
    #[command(flatten)]
    gradient: GradientArgs,
    /// Per cent instead of degrees.
    #[arg(long)]
    percent: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum TriArg {
    Riley,
    Wilson,
}

#[derive(Args, Debug)]
pub struct TriArgs {
    #[command(flatten)]
    draw: NeighbourArgs,
    /// After Riley (terrestrial) or Wilson (bathymetric).
    #[arg(long, value_enum, default_value = "riley")]
    alg: TriArg,
}

#[derive(Args, Debug)]
pub struct ColourArgs {
    #[command(flatten)]
    draw: DrawArgs,
    #[command(flatten)]
    resources: MemoryArgs,
    /// Table of heights and colours, as gdaldem color-relief takes it.
    #[arg(long, value_name = "FILE")]
    table: PathBuf,
}

pub fn slope(args: &SlopeArgs) -> anyhow::Result<()> {
    let mut options = gradient_options(&args.gradient);
    if args.percent {
        options.push("-p".into());
    }
    let picture = if args.percent { Picture::SlopePercent } else { Picture::SlopeDegrees };
    draw_gradient(&args.gradient, "slope", options, picture)
}

pub fn aspect(args: &GradientArgs) -> anyhow::Result<()> {
    draw_gradient(args, "aspect", gradient_options(args), Picture::Aspect)
}

pub fn roughness(args: &NeighbourArgs) -> anyhow::Result<()> {
    draw_neighbours(args, "roughness", Vec::new())
}

pub fn ruggedness(args: &TriArgs) -> anyhow::Result<()> {
    let alg = match args.alg {
        TriArg::Riley => "Riley",
        TriArg::Wilson => "Wilson",
    };
    draw_neighbours(&args.draw, "TRI", vec!["-alg".into(), alg.into()])
}

pub fn position(args: &NeighbourArgs) -> anyhow::Result<()> {
    draw_neighbours(args, "TPI", Vec::new())
}

pub fn colours(args: &ColourArgs) -> anyhow::Result<()> {
    draw(&args.draw, &args.resources, "color-relief", Vec::new(), Some(&args.table))
}

fn gradient_options(args: &GradientArgs) -> Vec<String> {
    let alg = match args.alg {
        GradientArg::Horn => "Horn",
        GradientArg::ZevenbergenThorne => "ZevenbergenThorne",
    };
    vec!["-alg".into(), alg.into()]
}

pub fn hillshade(args: &HillshadeArgs) -> anyhow::Result<()> {
    let mut options = gradient_options(&args.gradient);
    options.extend(["-z".to_string(), args.z.to_string(), "-alt".into(), args.altitude.to_string()]);
    if args.multidirectional {
        options.push("-multidirectional".into());
    } else {
        options.extend(["-az".to_string(), args.azimuth.to_string()]);
    }
    let (altitude_deg, exaggeration) = (args.altitude, args.z);
    let picture = if args.multidirectional {
        Picture::Multidirectional { altitude_deg, exaggeration }
    } else {
        Picture::Hillshade { azimuth_deg: args.azimuth, altitude_deg, exaggeration }
    };
    draw_gradient(&args.gradient, "hillshade", options, picture)
}

/// By GDAL's functions where the sides of cells are in the unit of the heights, else with their true lengths.
fn draw_gradient(args: &GradientArgs, kind: &str, options: Vec<String>, picture: Picture) -> anyhow::Result<()> {
    if picture != Picture::Aspect
        && let Some(doubt) = gradient::doubtful_unit(&args.draw.model)?
    {
        eprintln!("autoref-stream: {doubt}");
    }
    if !gradient::needs_true_sides(&args.draw.model, picture)? {
        let options = options.into_iter().chain(args.edges.option()).collect();
        return draw(&args.draw, &args.resources.memory, kind, options, None);
    }
    output::check(&[&args.draw.out], Existing::of_flag(args.draw.overwrite))?;
    let resources = args.resources.resources();
    resources.check()?;
    derive::check_heights(&args.draw.model)?;
    let kernel = match args.alg {
        GradientArg::Horn => Kernel::Horn,
        GradientArg::ZevenbergenThorne => Kernel::ZevenbergenThorne,
    };
    let edges = if args.edges.compute_edges { Edges::Extrapolated } else { Edges::LeftOut };
    atomic::with_temporary(&args.draw.out, |path| {
        gradient::draw(&args.draw.model, path, picture, kernel, edges, resources.threads)
    })?;
    println!("Written              {}", args.draw.out.display());
    Ok(())
}

/// The same where the edges may be computed.
fn draw_neighbours(args: &NeighbourArgs, kind: &str, options: Vec<String>) -> anyhow::Result<()> {
    let options = options.into_iter().chain(args.edges.option()).collect();
    draw(&args.draw, &args.resources, kind, options, None)
}

fn draw(
    args: &DrawArgs,
    memory: &MemoryArgs,
    kind: &str,
    options: Vec<String>,
    colours: Option<&Path>,
) -> anyhow::Result<()> {
    output::check(&[&args.out], Existing::of_flag(args.overwrite))?;
    let resources = memory.resources();
    resources.check()?;
    derive::check_heights(&args.model)?;
    let memory_budget_bytes = resources.memory_budget_bytes;
    let drawing = Drawing { kind, options, colours, memory_budget_bytes };
    atomic::with_temporary(&args.out, |path| derive::draw(&args.model, path, &drawing))?;
    println!("Written              {}", args.out.display());
    Ok(())
}
