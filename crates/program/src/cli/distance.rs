//! `autoref-stream distance`: the distance of every pixel's colour from the paint, to see what the detector sees.

use std::path::{Path, PathBuf};

use anyhow::Result;
use autoref_raster::atomic::Existing;
use autoref_raster::crs::without_heights;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, Written, atomic};
use autoref_stream::profile::Profile;
use autoref_stream::segment::classify::Classifier;
use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;

use crate::cli::args::{PaintArg, SampleArgs};

/// Write the colour distance under a profile as a one-band 32-bit float GeoTIFF.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The image.
    image: PathBuf,
    /// A shipped profile or a TOML file.
    #[arg(long, default_value = "orange", value_name = "NAME|FILE")]
    profile: String,
    #[command(flatten)]
    paint: PaintArg,
    /// Divide by the profile's limit: up to 1 is paint. Without it the distance is in standard deviations.
    #[arg(long)]
    normalised: bool,
    /// Where to write.
    #[arg(short, long, value_name = "TIF")]
    output: PathBuf,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print what was done as one JSON document on standard output.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    samples: SampleArgs,
}

pub fn run(args: &Args) -> Result<()> {
    autoref_elevation::output::check(&[&args.output], Existing::of_flag(args.overwrite))?;
    let profile = Profile::load(args.paint.paint.as_deref().unwrap_or(&args.profile))?;
    let source = args.samples.open(&args.image, 128 << 20)?;
    let info = source.info();
    let classifier = Classifier::new(&profile, info.sample, info.white, info.rgb, info.alpha, info.nodata)?;
    let unit = if args.normalised { 1.0 / profile.colour.limit } else { 1.0 };

    atomic::with_temporary(&args.output, |partial| write(partial, source.as_ref(), &classifier, unit))?;
    if args.json {
        let document = serde_json::json!({"files_written": [args.output.display().to_string()]});
        println!("{}", serde_json::to_string_pretty(&document)?);
    }
    Ok(())
}

/// Streams the distances into a GeoTIFF at `path`.
fn write(path: &Path, source: &dyn RasterSource, classifier: &Classifier, unit: f64) -> autoref_raster::Result<()> {
    let failed = |e: gdal::errors::GdalError| autoref_raster::failed_to_write(path, &e.to_string());
    let info = source.info();
    let written = Written::watch(path);
    let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
    let options = RasterCreationOptions::from_iter(["COMPRESS=DEFLATE", "BIGTIFF=IF_SAFER", "TILED=YES"]);
    let (width, height) = (info.width, info.height);
    let mut file = driver
        .create_with_band_type_with_options::<f32, _>(path, width as usize, height as usize, 1, &options)
        .map_err(failed)?;
    if let Some(transform) = info.geotransform {
        file.set_geo_transform(&transform.0).map_err(failed)?;
    }
    if let Some(wkt) = &info.crs_wkt {
        let plane = without_heights(path, wkt)?;
        file.set_spatial_ref(&SpatialRef::from_wkt(&plane).map_err(failed)?).map_err(failed)?;
    }
    let mut band = file.rasterband(1).map_err(failed)?;
    band.set_no_data_value(Some(f64::NAN)).map_err(failed)?;
    // Bands of rows that a bounded amount of memory holds, in multiples of the output's tiles.
    let columns = width.min(8192);
    let rows = 256u64;
    for y in (0..height).step_by(rows as usize) {
        for x in (0..width).step_by(columns as usize) {
            let window = Window::new(x, y, columns.min(width - x), rows.min(height - y));
            let patch = source.read(window)?.to_patch(info);
            let distance = |i: usize| {
                let colour = patch.rgb[i].map(|v| f64::from(classifier.to_byte(v)) / 255.0);
                if patch.valid[i] { (classifier.reference().nearest2(colour).sqrt() * unit) as f32 } else { f32::NAN }
            };
            let size = (window.width as usize, window.height as usize);
            let mut values = Buffer::new(size, (0..patch.rgb.len()).map(distance).collect());
            band.write((x as isize, y as isize), size, &mut values).map_err(failed)?;
        }
    }
    written.close(file)
}
