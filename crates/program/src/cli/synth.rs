//! `autoref-stream synth`: a sample orthophoto with known truth.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Context, bail};
use autoref_raster::atomic::{self, Existing};
use autoref_raster::coords::MapPoint;
use autoref_raster::crs::Crs;
use autoref_synth::{
    self, Background, BigTiff, Border, Compression, FileLayout, Interleave, MarkSize, MarkStyle, MarkTurn, Output,
    Paint, Shape, SynthGcp, SynthSpec, Visible,
};
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

/// Make a sample orthophoto of any size with painted marks, and the truth about it beside it (NAME.truth.json).
#[derive(Args, Debug)]
pub struct SynthArgs {
    /// The GeoTIFF to write.
    pub output: PathBuf,

    /// Surveyed points: CSV with a header naming name, easting, northing and perhaps height, in any order.
    #[arg(long, value_name = "FILE", help_heading = "Ground control points", required_unless_present = "random_gcps")]
    pub gcps: Option<PathBuf>,
    /// Make up N points instead, in an irregular pattern.
    #[arg(long, value_name = "N", help_heading = "Ground control points", conflicts_with = "gcps")]
    pub random_gcps: Option<usize>,
    /// Ground covered by --random-gcps, in metres, east by north.
    #[arg(long, value_name = "E,N", default_value = "100,75", help_heading = "Ground control points")]
    pub extent_m: Pair,
    /// Only that many GCPs, drawn at random, have a mark. Default: all that fall inside the image.
    #[arg(long, value_name = "N", help_heading = "Ground control points", conflicts_with = "names")]
    pub visible: Option<usize>,
    /// Only these GCPs have a mark.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', help_heading = "Ground control points")]
    pub names: Option<Vec<String>>,
    /// Also write the GCP list, as GeoJSON.
    #[arg(long, value_name = "FILE", help_heading = "Ground control points")]
    pub write_gcps: Option<PathBuf>,
    /// EPSG code that --write-gcps puts into the list, and --georeferenced into the picture. Default: 32632; for the
    /// picture of a --gcps list, which may lie anywhere, none.
    #[arg(long, value_name = "CODE", help_heading = "Ground control points")]
    pub epsg: Option<u32>,

    /// Width and height in pixels. Default: what the visible GCPs need, with a margin.
    #[arg(long, value_name = "W,H", help_heading = "Image")]
    pub size: Option<Pair>,
    /// Ground size of a pixel, in metres.
    #[arg(long, value_name = "M", default_value_t = 0.03, help_heading = "Image")]
    pub gsd: f64,
    /// Angle of the image's x axis, in degrees anticlockwise from east.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true, help_heading = "Image")]
    pub rotation: f64,
    /// Easting and northing of the image's first corner. Default: the visible GCPs are centred.
    #[arg(long, value_name = "E,N", allow_hyphen_values = true, help_heading = "Image")]
    pub origin: Option<Pair>,
    /// Flip the image left to right, as no orthophoto is.
    #[arg(long, help_heading = "Image")]
    pub mirrored: bool,
    /// Shift the image so that marks straddle multiples of N pixels, one of them a corner.
    #[arg(long, value_name = "N", help_heading = "Image")]
    pub at_tile_corners: Option<u64>,
    /// Every random choice follows from it; the same seed gives the same picture for any number of threads.
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Image")]
    pub seed: u64,

    /// Photographs to lie under the marks, or a folder of them; may be repeated. Default: a landscape is drawn.
    #[arg(long, value_name = "FILE|DIR", help_heading = "Ground")]
    pub photos: Vec<PathBuf>,
    /// One photograph pixel for pixel; the image has its size.
    #[arg(long, value_name = "FILE", help_heading = "Ground", conflicts_with_all = ["photos", "size", "flat"])]
    pub as_is: Option<PathBuf>,
    /// One colour (a paint's name or #rrggbb) instead of a landscape.
    #[arg(long, value_name = "COLOUR", help_heading = "Ground", conflicts_with = "photos")]
    pub flat: Option<Paint>,
    /// σ of the sensor's noise, in 8-bit levels. Photographs bring their own: there only the marks get it.
    #[arg(long, value_name = "LEVELS", default_value_t = 1.5, help_heading = "Ground")]
    pub noise: f64,
    /// Number of false objects in about the colour of the marks.
    #[arg(long, value_name = "N", default_value_t = 0, help_heading = "Ground")]
    pub clutter: usize,
    /// Leave a ragged border of up to so many pixels empty.
    #[arg(long, value_name = "PX", default_value_t = 0, help_heading = "Ground")]
    pub border: u64,
    /// How the border is told from the picture: `alpha`, or the value (0–255) of all bands there.
    #[arg(long, value_name = "alpha|VALUE", default_value = "alpha", help_heading = "Ground")]
    pub border_as: BorderAs,

    /// Side or diameter: 20, 20px or 0.6m.
    #[arg(long, value_name = "SIZE", default_value = "14px", help_heading = "Marks")]
    pub mark_size: MarkSize,
    #[arg(long, value_enum, default_value_t = ShapeArg::Square, help_heading = "Marks")]
    pub shape: ShapeArg,
    /// Paints the marks take at random: orange, orange-faded, pink, green, yellow, blue, white, black, red or #rrggbb.
    /// Default: orange; checkers white, cross plates and the plates of hourglasses black.
    #[arg(long, value_name = "A,B,…", value_delimiter = ',', help_heading = "Marks")]
    pub paint: Vec<Paint>,
    /// Second colour of checkers, cross plates and hourglasses (their triangles). Default: black for checkers, white
    /// for the others.
    #[arg(long, value_name = "PAINT", help_heading = "Marks")]
    pub second_paint: Option<Paint>,
    /// σ of the Gaussian blur, in pixels.
    #[arg(long, value_name = "PX", default_value_t = 0.9, help_heading = "Marks")]
    pub blur: f64,
    /// Share of the ground that shines through the paint, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, help_heading = "Marks")]
    pub fading: f64,
    /// Unevenness of the paint: how far its brightness varies, relative, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.05, help_heading = "Marks")]
    pub texture: f64,
    /// Share of the marks on which a shadow falls, 0 to 1; on half of them its edge.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, help_heading = "Marks")]
    pub shadow: f64,
    /// Hide each mark from one side, up to this share of it, 0 to 1.
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, help_heading = "Marks")]
    pub cover: f64,
    /// Turn all marks by this angle, in degrees. Default: each by its own.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true, help_heading = "Marks")]
    pub turn: Option<f64>,
    /// σ of the distance, in pixels per axis, by which marks lie beside their surveyed points.
    #[arg(long, value_name = "PX", default_value_t = 0.0, help_heading = "Marks")]
    pub displace: f64,

    /// Tiles of N pixels, a multiple of 16, up to 4096.
    #[arg(long, value_name = "N", default_value_t = 512, help_heading = "File")]
    pub tiles: u64,
    /// Strips of N rows instead of tiles.
    #[arg(long, value_name = "ROWS", help_heading = "File")]
    pub strips: Option<u64>,
    #[arg(long, value_enum, default_value_t = CompressionArg::None, help_heading = "File")]
    pub compress: CompressionArg,
    /// Quality of --compress jpeg, 1 to 100.
    #[arg(long, value_name = "Q", default_value_t = 90, help_heading = "File")]
    pub quality: u8,
    /// Store horizontal differences (deflate, lzw, zstd).
    #[arg(long, help_heading = "File")]
    pub predictor: bool,
    /// Bits a sample, 8 or 16.
    #[arg(long, value_name = "N", default_value_t = 8, help_heading = "File")]
    pub bits: u8,
    /// Store the bands one after the other.
    #[arg(long, help_heading = "File")]
    pub planar: bool,
    /// Make a BigTIFF even of a small picture. Without this: above 4.2 GB of pixels.
    #[arg(long, help_heading = "File")]
    pub big_tiff: bool,
    /// Write the true georeference into the file, with the CRS that --epsg names.
    #[arg(long, help_heading = "File")]
    pub georeferenced: bool,
    /// Replace existing outputs.
    #[arg(long, help_heading = "File")]
    pub overwrite: bool,
    /// Print nothing but errors.
    #[arg(long, help_heading = "Messages")]
    pub quiet: bool,
    /// Print what was written as one JSON document on standard output.
    #[arg(long, help_heading = "Messages")]
    pub json: bool,
    /// Threads that draw. Default: one per core.
    #[arg(long, value_name = "N", help_heading = "File")]
    pub threads: Option<usize>,
}

/// Two numbers with a comma (or an x) between.
#[derive(Clone, Copy, Debug)]
pub struct Pair(pub f64, pub f64);

impl FromStr for Pair {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is not two numbers with a comma between");
        let (a, b) = text.split_once([',', 'x']).ok_or_else(wrong)?;
        let number = |t: &str| t.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong);
        Ok(Pair(number(a)?, number(b)?))
    }
}

#[derive(Clone, Copy, Debug)]
pub enum BorderAs {
    Alpha,
    Value(u8),
}

impl FromStr for BorderAs {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "alpha" => Ok(BorderAs::Alpha),
            number => {
                number.parse().map(BorderAs::Value).map_err(|_| format!("{text:?} is neither alpha nor 0 to 255"))
            }
        }
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum ShapeArg {
    Square,
    Disc,
    Cross,
    Checker,
    CrossPlate,
    Hourglass,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum CompressionArg {
    None,
    Deflate,
    Lzw,
    Zstd,
    Packbits,
    Jpeg,
}

/// Where random points lie.
const RANDOM_EPSG: u32 = 32632;

/// Runs the command; the library's errors are one line each.
pub fn run(args: SynthArgs) -> anyhow::Result<()> {
    if let Some(n) = args.threads {
        if n == 0 {
            bail!("0 threads can draw nothing; use 1 or more");
        }
        rayon::ThreadPoolBuilder::new().num_threads(n).build_global().context("cannot start the threads")?;
    }
    bound_gdal_cache(&args)?;
    let spec = spec_of(&args)?;
    if let Some(code) = args.epsg {
        Crs::from_epsg(code)?;
    } else if args.georeferenced && args.gcps.is_some() && !args.quiet {
        eprintln!("the picture is georeferenced without a CRS; --epsg names that of the list");
    }
    if let Some(list) = args.write_gcps.as_deref() {
        let extension = list.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
        if !["geojson", "json"].contains(&extension.as_str()) {
            bail!(
                "--write-gcps {}: GeoJSON is written; name it .geojson (gcps convert makes other lists of it)",
                list.display()
            );
        }
        atomic::check_outputs(&[list], Existing::of_flag(args.overwrite))?;
        if [args.output.as_path(), &autoref_synth::truth_path(&args.output)].contains(&list) {
            bail!("--write-gcps {}: the picture's own file has this name; give another", list.display());
        }
    }
    // Hidden where standard error is no terminal.
    let bar = if args.quiet { ProgressBar::hidden() } else { ProgressBar::new(0) };
    let style = "{bar:40} {percent:>3} %  {elapsed} of about {duration}";
    bar.set_style(ProgressStyle::with_template(style).context("the progress bar's template")?);
    let truth = autoref_synth::write_with_progress(&spec, &args.output, &|done, all| {
        bar.set_length(all);
        bar.set_position(done);
    })?;
    bar.finish_and_clear();
    if let Some(list) = &args.write_gcps {
        autoref_synth::write_gcp_geojson(list, &spec.gcps, Some(args.epsg.unwrap_or(RANDOM_EPSG)))?;
    }
    let seen = truth.visible().count();
    if args.json {
        let truth_path = autoref_synth::truth_path(&args.output);
        let files = [Some(&args.output), Some(&truth_path), args.write_gcps.as_ref()];
        let files: Vec<String> = files.into_iter().flatten().map(|path| path.display().to_string()).collect();
        let document = serde_json::json!({
            "files_written": files,
            "width": truth.width,
            "height": truth.height,
            "gcps": truth.gcps.len(),
            "gcps_visible": seen,
            "false_objects": truth.clutter.len(),
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
        return Ok(());
    }
    if args.quiet {
        return Ok(());
    }
    println!(
        "{}: {} x {} px, {seen} of {} GCPs visible, {} false objects; truth in {}",
        args.output.display(),
        truth.width,
        truth.height,
        truth.gcps.len(),
        truth.clutter.len(),
        autoref_synth::truth_path(&args.output).display()
    );
    Ok(())
}

/// GDAL would take a twentieth of the machine's memory for its blocks. What it needs is room for the blocks of one
/// piece of the picture in all bands, to put pixels together before it compresses them; a strip of many rows is held
/// until its last row is drawn.
fn bound_gdal_cache(args: &SynthArgs) -> anyhow::Result<()> {
    let tall_strips = args.strips.is_some_and(|rows| rows > 16);
    if std::env::var_os("GDAL_CACHEMAX").is_none() {
        let megabytes = if tall_strips { "48" } else { "16" };
        gdal::config::set_config_option("GDAL_CACHEMAX", megabytes).context("cannot bound GDAL's block cache")?;
    }
    if args.strips.is_some_and(|rows| rows > 4096) {
        bail!("strips of more than 4096 rows would be held in memory whole; use fewer rows");
    }
    Ok(())
}

fn gcps_of(args: &SynthArgs) -> anyhow::Result<Vec<SynthGcp>> {
    match (&args.gcps, args.random_gcps) {
        (Some(path), _) => Ok(autoref_synth::read_gcp_csv(path)?),
        (None, Some(n)) => {
            if !(args.extent_m.0 > 0.0 && args.extent_m.1 > 0.0) {
                bail!("--extent-m {},{} covers no ground; give two lengths above 0", args.extent_m.0, args.extent_m.1);
            }
            if n > 10_000 {
                bail!("--random-gcps {n} is more than anyone surveys; 10000 at most");
            }
            Ok(autoref_synth::random_gcps(n, args.extent_m.0, args.extent_m.1, args.seed))
        }
        (None, None) => bail!("no GCPs; give --gcps FILE or --random-gcps N"),
    }
}

fn whole_pixels(pair: Pair) -> anyhow::Result<(u64, u64)> {
    let whole = |v: f64| v >= 1.0 && v.fract() == 0.0 && v <= f64::from(i32::MAX);
    if !(whole(pair.0) && whole(pair.1)) {
        bail!("--size {},{} is no image size; give two whole numbers above 0", pair.0, pair.1);
    }
    Ok((pair.0 as u64, pair.1 as u64))
}

fn spec_of(args: &SynthArgs) -> anyhow::Result<SynthSpec> {
    let background = match (&args.as_is, &args.flat) {
        (Some(photo), _) => Background::AsIs(photo.clone()),
        (None, Some(paint)) => Background::Flat(paint.0),
        (None, None) if args.photos.is_empty() => Background::Landscape,
        (None, None) => Background::Photographs(autoref_synth::photographs(&args.photos)?),
    };
    Ok(SynthSpec {
        gcps: gcps_of(args)?,
        seed: args.seed,
        size_px: args.size.map(whole_pixels).transpose()?,
        gsd_m: args.gsd,
        rotation_deg: args.rotation,
        mirrored: args.mirrored,
        origin: args.origin.map(|o| MapPoint { easting: o.0, northing: o.1 }),
        visible: match (&args.names, args.visible) {
            (Some(names), _) => Visible::Named(names.clone()),
            (None, Some(n)) => Visible::Random(n),
            (None, None) => Visible::All,
        },
        mark: mark_of(args),
        displacement_px: args.displace,
        straddle_px: args.at_tile_corners,
        noise_sigma: args.noise,
        clutter: args.clutter,
        background,
        border: match (args.border, args.border_as) {
            (0, _) => Border::None,
            (width_px, BorderAs::Alpha) => Border::Alpha { width_px },
            (width_px, BorderAs::Value(value)) => Border::Nodata { width_px, value },
        },
        output: output_of(args),
        ..SynthSpec::default()
    })
}

fn mark_of(args: &SynthArgs) -> MarkStyle {
    let (shape, first, second) = match args.shape {
        ShapeArg::Square => (Shape::Square, Paint::ORANGE, Paint::BLACK),
        ShapeArg::Disc => (Shape::Disc, Paint::ORANGE, Paint::BLACK),
        ShapeArg::Cross => (Shape::Cross, Paint::ORANGE, Paint::BLACK),
        ShapeArg::Checker => (Shape::Checker, Paint::WHITE, Paint::BLACK),
        ShapeArg::CrossPlate => (Shape::CrossPlate, Paint::BLACK, Paint::WHITE),
        ShapeArg::Hourglass => (Shape::Hourglass, Paint::BLACK, Paint::WHITE),
    };
    MarkStyle {
        size: args.mark_size,
        shape,
        paints: if args.paint.is_empty() { vec![first] } else { args.paint.clone() },
        second_paint: args.second_paint.unwrap_or(second),
        blur_px: args.blur,
        fading: args.fading,
        texture: args.texture,
        shadow_share: args.shadow,
        cover_max: args.cover,
        turn: args.turn.map_or(MarkTurn::Random, MarkTurn::Degrees),
    }
}

fn output_of(args: &SynthArgs) -> Output {
    Output {
        layout: args.strips.map_or(FileLayout::Tiles(args.tiles), FileLayout::Strips),
        compression: match args.compress {
            CompressionArg::None => Compression::None,
            CompressionArg::Deflate => Compression::Deflate,
            CompressionArg::Lzw => Compression::Lzw,
            CompressionArg::Zstd => Compression::Zstd,
            CompressionArg::Packbits => Compression::Packbits,
            CompressionArg::Jpeg => Compression::Jpeg(args.quality),
        },
        predictor: args.predictor,
        bits: args.bits,
        interleave: if args.planar { Interleave::Band } else { Interleave::Pixel },
        big_tiff: if args.big_tiff { BigTiff::Always } else { BigTiff::Auto },
        georeferenced: args.georeferenced,
        epsg: args.epsg.or_else(|| args.random_gcps.map(|_| RANDOM_EPSG)),
        overwrite: args.overwrite,
    }
}
