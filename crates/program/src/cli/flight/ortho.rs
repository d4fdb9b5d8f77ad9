//! `flight orthorectify`: one frame over an elevation model.

mod draw;
mod model;
mod place;
mod seen;
pub(super) use place::resize;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_elevation::grid::Grid;
use autoref_elevation::output;
use autoref_raster::atomic::Existing;
use autoref_raster::crs::{Crs, without_heights};
use autoref_raster::error::Error as RasterError;
use autoref_raster::refuse_signed_bytes;
use gdal::raster::{GdalDataType, RasterBand};
use serde_json::json;

use super::camera_tables;
use crate::cli::dem::ResourceArgs;
use draw::Job;
pub(in crate::cli) use model::Dem;
use model::{open, scaled};
use place::{Lattice, place, posed};
use seen::{Seen, Seer};

/// Map a frame onto the ground over an elevation model: a Cloud Optimized GeoTIFF in the model's CRS.
#[derive(Debug, clap::Args)]
pub struct OrthorectifyArgs {
    /// The frame.
    frame: PathBuf,
    /// Elevation model, north up; the orthophoto takes its CRS.
    #[arg(long, value_name = "DEM")]
    dem: PathBuf,
    /// Where the frame was taken from: the result of `solve`, `adjust` or `resect`, a reconstruction in map coordinates
    /// (--shift) or about its `reference_lla`, or a camera table. Default: cameras.json beside the frame.
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    angles: camera_tables::AnglesArgs,
    /// With a camera table: the interior, as for `resect`.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Focal length in pixels, in place of the file's.
    #[arg(long, value_name = "PX")]
    f_px: Option<f64>,
    /// Principal point. Default: the file's, else the image's centre.
    #[arg(long, value_name = "X,Y", value_delimiter = ',')]
    pp_px: Option<Vec<f64>>,
    /// Distortion, such as k1=-0.13,k2=0.39. OpenCV's rational k4, k5, k6 are d1, d2, d3.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    distortion: Vec<String>,
    /// CRS of the cameras. Default: what their file says, else the elevation model's.
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// What was taken off the map coordinates of a reconstruction, such as the offset in OpenDroneMap's coords.txt.
    #[arg(long, value_name = "E,N,H", allow_hyphen_values = true)]
    shift: Option<String>,
    /// Pixel size on the ground, in units of the CRS. Default: the median size of the frame's pixels across the view.
    #[arg(long, value_name = "M")]
    gsd: Option<f64>,
    /// The orthophoto. Default: FRAME_ortho.tif.
    #[arg(short, long, value_name = "TIF")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print what was done as JSON.
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    resources: ResourceArgs,
}

pub fn run(args: &OrthorectifyArgs) -> Result<ExitCode> {
    let out = args.checked_output()?;
    output::check(&[&out], Existing::of_flag(args.overwrite))?;
    args.resources.resources().check()?;
    let frame = open(&args.frame)?;
    let (columns, rows) = frame.raster_size();
    let name = args.frame.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let dem = Dem::open(&args.dem)?;
    let (camera, pose, in_frame) = posed(args, &name, [columns as f64, rows as f64], dem.crs.as_ref())?;
    let (world, pose, eye) = place(&dem, &pose, &in_frame)?;
    let resources = args.resources.resources();
    let budget_bytes = resources.memory_budget_bytes;
    let seer = Seer::new(&world, &camera, pose, eye);
    let Seen { bounds, across, surface } = seer.ground(args, &dem, budget_bytes)?;
    let view = seer.view(&surface);
    // Within, all is in metres; the orthophoto is in units of the map.
    let across = across / dem.unit_m;
    let gsd = args.gsd.unwrap_or(across);
    let grid = output_grid(bounds.map(|v| v / dem.unit_m), gsd)?;
    let grid_m = scaled(&grid, dem.unit_m);
    let lattice = Lattice::new(&world, &grid_m)?;
    let oversampling = ((gsd / across).round() as usize).clamp(1, 8);
    let job = Job {
        args,
        view: &view,
        lattice: &lattice,
        grid,
        grid_m,
        oversampling,
        threads: resources.threads,
        tile_px: resources.tile_px.unwrap_or(1024),
        budget_bytes,
    };
    let wkt = &without_heights(&out, dem.crs.as_ref().map_or("", Crs::wkt))?;
    let band = frame.rasterband(1).map_err(|e| RasterError::gdal(&args.frame, e))?;
    let first = kind_of(&args.frame, &band)?;
    drop(frame);
    let seen = match first {
        GdalDataType::UInt8 => job.write::<u8>(&out, wkt, Some(255.0))?,
        GdalDataType::UInt16 => job.write::<u16>(&out, wkt, Some(65535.0))?,
        _ => job.write::<f32>(&out, wkt, None)?,
    };
    if args.json {
        let document = json!({
            "output": out.display().to_string(), "width": grid.width, "height": grid.height, "gsd": gsd,
            "bounds": grid.bounds(), "pixels_seen": seen, "frame": name, "camera": dem.in_units(eye),
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        println!("{}: {} x {} px of {gsd:.4}", out.display(), grid.width, grid.height);
    }
    Ok(ExitCode::SUCCESS)
}

/// The type of a frame's samples; those that an orthophoto of whole or single numbers cannot hold are refused.
fn kind_of(frame: &Path, band: &RasterBand<'_>) -> Result<GdalDataType> {
    refuse_signed_bytes(frame, band)?;
    let kind = band.band_type();
    if kind.is_integer() || kind.is_floating() {
        return Ok(kind);
    }
    let what = format!("samples of type {}", kind.name());
    Err(RasterError::unsupported(frame, what, "bring them to Float32 with gdal_translate -ot").into())
}

impl OrthorectifyArgs {
    /// Where the orthophoto goes, once the numbers make sense.
    fn checked_output(&self) -> Result<PathBuf> {
        if self.pp_px.as_ref().is_some_and(|p| p.len() != 2) {
            bail!("--pp-px: 2 numbers with a comma between them are expected");
        }
        if self.gsd.is_some_and(|g| !(g > 0.0 && g.is_finite())) {
            bail!("--gsd: a positive number is expected");
        }
        Ok(self.output.clone().unwrap_or_else(|| {
            let stem = self.frame.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
            PathBuf::from(format!("{stem}_ortho.tif"))
        }))
    }
}

/// Corners at multiples of the pixel: orthophotos of neighbours share one grid.
fn output_grid(bounds: [f64; 4], gsd: f64) -> Result<Grid> {
    let low = [(bounds[0] / gsd).floor(), (bounds[1] / gsd).floor()];
    let high = [(bounds[2] / gsd).ceil(), (bounds[3] / gsd).ceil()];
    let (width, height) = ((high[0] - low[0]).max(1.0), (high[1] - low[1]).max(1.0));
    if width > 1e6 || height > 1e6 {
        bail!("--gsd {gsd}: {width} x {height} px would come out; give a larger one");
    }
    Ok(Grid {
        x0: low[0] * gsd,
        y0: high[1] * gsd,
        step_x: gsd,
        step_y: -gsd,
        width: width as u64,
        height: height as u64,
    })
}
