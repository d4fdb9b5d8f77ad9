//! `autoref-stream mask`: which ground of a frame is worth matching.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_raster::memory_plan::SMALLEST_BUDGET_BYTES;
use autoref_raster::output_folder::OutputFolder;
use autoref_raster::{Error, ReaderChoice};
use autoref_terrain::batch::mask_frame;
use autoref_terrain::clean::Cleaning;
use autoref_terrain::given::Given;
use autoref_terrain::options::{Extras, Method, Options};
use autoref_terrain::report::Report;
use autoref_terrain::shapes::{self, Lesson, Shape};
use autoref_terrain::sheet::Sheet;
use autoref_terrain::teach::teach;
use autoref_terrain::write::MaskCompression;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::mask_camera::CameraArgs;
use super::mask_light::{BandingArg, LightingArg, corrections};
use crate::cli::prepare::threads;
use crate::cli::values::Bytes;

/// Mask the ground that image matching can use: without water, clouds, sky, featureless snow, film borders and text.
///
/// Writes NAME_Masq.tif (1 bit, 1 = use) and NAME_Masq.xml as MicMac reads them, NAME_Masq.json, and masks.html with
/// all frames. Exit codes: 0 every frame has a mask, 2 a frame could not be read (the others have theirs).
#[derive(Args, Debug)]
pub struct MaskArgs {
    /// The frames: files, or folders of them.
    #[arg(required = true)]
    frames: Vec<PathBuf>,
    /// Folder for the masks.
    #[arg(short, long = "out", value_name = "DIR", default_value = "masks")]
    output: PathBuf,
    /// How the ground is told from the rest.
    #[arg(long, value_enum, default_value_t = MethodArg::Auto)]
    method: MethodArg,
    /// Print every frame's result as one line of JSON.
    #[arg(long)]
    json: bool,
    /// Leave frames alone that are done and unchanged.
    #[arg(long)]
    resume: bool,
    /// Replace masks that are there.
    #[arg(long)]
    overwrite: bool,

    /// A rectangle of a class (keep: ground, glacier, foreground, background …; mask: water, clouds, sky, snow …),
    /// pixels.
    #[arg(long, value_name = "CLASS=X,Y,W,H@FRAME", value_parser = shapes::parse_sample, help_heading = "Teaching")]
    sample: Vec<Shape>,
    /// Rectangles and polygons of classes in a TOML or GeoJSON file.
    #[arg(long, value_name = "FILE", help_heading = "Teaching")]
    samples: Vec<PathBuf>,
    /// A frame and a mask of it: 1 keep, 0 mask, 255 unknown.
    #[arg(long, value_name = "FRAME=MASK.tif", value_parser = shapes::parse_lesson, help_heading = "Teaching")]
    teach: Vec<Lesson>,

    /// Polygons (TOML or GeoJSON) or a mask (raster) joined to the mask of every frame: fiducials, text, film border.
    #[arg(long, value_name = "FILE", help_heading = "By hand")]
    global: Vec<PathBuf>,
    /// Corrections (TOML or GeoJSON, such as masks.html saves); they have the last word.
    #[arg(long, value_name = "FILE", help_heading = "By hand")]
    mend: Vec<PathBuf>,
    #[command(flatten)]
    camera: CameraArgs,

    /// Even out the light before pixels are told apart.
    #[arg(long, value_enum, default_value_t = LightingArg::None, help_heading = "Method")]
    lighting: LightingArg,
    /// Remove bands that the scanner left along its rows or columns.
    #[arg(long, value_enum, default_value_t = BandingArg::Off, help_heading = "Method")]
    banding: BandingArg,

    /// Pixels that one pixel of the analysis stands for, along a side. Default: 4; auto takes 1 below 1500 px, 2 below
    /// 3000 px.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=16), help_heading = "Method")]
    reduce: Option<u8>,
    /// Nearest neighbours that vote (thesis-2017); odd. Default: 3.
    #[arg(short, long, value_name = "N", help_heading = "Method")]
    k: Option<usize>,
    /// Entropy, bit, above which a pixel is kept (threshold). Default: 4.
    #[arg(long, value_name = "BIT", help_heading = "Method")]
    threshold: Option<f64>,
    /// Discs of the closings, px of the analysis (thesis-2017, threshold). Default: 3,6,9,…,30.
    #[arg(long, value_name = "PX,…", value_delimiter = ',', help_heading = "Method")]
    closings: Option<Vec<usize>>,
    /// Disc of the dilations and erosions, px of the analysis (thesis-2017, threshold). Default: 15.
    #[arg(long, value_name = "PX", help_heading = "Method")]
    disc: Option<usize>,
    /// Erosions between the dilations (thesis-2017, threshold). Default: 2.
    #[arg(long, value_name = "N", help_heading = "Method")]
    erosions: Option<usize>,
    /// Areas under this share of the image change class. Default: 0.02; auto 0.0025.
    #[arg(long, value_name = "SHARE", help_heading = "Method")]
    least_area: Option<f64>,

    /// How masks are compressed.
    #[arg(long, value_enum, default_value_t = CompressArg::G4, help_heading = "Outputs")]
    compress: CompressArg,
    /// Write NAME_Prob.tif: the probability of ground, 0…255 (auto).
    #[arg(long, help_heading = "Outputs")]
    probability: bool,
    /// Write NAME_Class.tif (auto: votes), NAME_Entropy.tif, NAME_Scatter.svg; with thesis-2017 NAME_Distance.tif too.
    #[arg(long, help_heading = "Outputs")]
    explain: bool,
    /// Write FRAME.EXT.png too, as COLMAP names masks.
    #[arg(long, help_heading = "Outputs")]
    colmap: bool,

    /// Side of the tiles that frames are read in, px. Default: 1024.
    #[arg(long, value_name = "PX", help_heading = "Running")]
    tile: Option<u64>,
    /// Bound of the resident memory.
    #[arg(long, value_name = "SIZE", default_value = "512M", help_heading = "Running")]
    memory: Bytes,
    /// Worker threads. Default: one per core.
    #[arg(long, value_name = "N", help_heading = "Running")]
    threads: Option<u64>,
    /// No progress bar.
    #[arg(long, help_heading = "Running")]
    quiet: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum MethodArg {
    Auto,
    #[value(name = "thesis-2017")]
    Thesis2017,
    Threshold,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum CompressArg {
    G4,
    Deflate,
}

impl MaskArgs {
    fn options(&self) -> anyhow::Result<Options> {
        if self.memory.0 < SMALLEST_BUDGET_BYTES {
            bail!("--memory must be 112M or more");
        }
        if self.tile.is_some_and(|tile| !(64..=16_384).contains(&tile)) {
            bail!("--tile must be between 64 and 16384 px");
        }
        self.refuse_options_of_other_methods()?;
        let (threshold, k) = (self.threshold.unwrap_or(4.0), self.k.unwrap_or(3));
        let closings = self.closings.clone().unwrap_or_else(|| (1..=10).map(|i| 3 * i).collect());
        let (disc, erosions) = (self.disc.unwrap_or(15), self.erosions.unwrap_or(2));
        if !(0.0..=8.0).contains(&threshold) {
            bail!("--threshold must be between 0 and 8 bits");
        }
        if k == 0 || k.is_multiple_of(2) || k > 99 {
            bail!("--k must be odd and below 100, so that every vote has a majority");
        }
        if closings.iter().chain([&disc]).any(|size| !(1..=255).contains(size)) || erosions > 20 {
            bail!("--closings and --disc must be between 1 and 255 px, --erosions at most 20");
        }
        let share = |default: f64| self.least_area.unwrap_or(default);
        if !(0.0..=0.5).contains(&share(0.0)) {
            bail!("--least-area must be between 0 and 0.5 of the image");
        }
        if self.threads == Some(0) {
            bail!("--threads must be 1 or more");
        }
        Ok(Options {
            method: match self.method {
                MethodArg::Auto => Method::Auto,
                MethodArg::Thesis2017 => Method::Thesis2017,
                MethodArg::Threshold => Method::Threshold,
            },
            reduce: self.reduce.map_or(0, usize::from),
            neighbours: k,
            threshold_bit: threshold,
            cleaning: Cleaning { closings, disc, erosions, least_area_share: share(0.02) },
            auto_area_share: share(0.0025),
            compression: match self.compress {
                CompressArg::G4 => MaskCompression::CcittG4,
                CompressArg::Deflate => MaskCompression::Deflate,
            },
            extras: Extras { probability: self.probability, explain: self.explain, colmap: self.colmap },
            corrections: corrections(self.lighting, self.banding),
            tile_px: self.tile.unwrap_or(0),
            memory_budget_bytes: self.memory.0,
            reader: ReaderChoice::Auto,
            overwrite: self.overwrite,
            resume: self.resume,
        })
    }

    /// An option that would change nothing is a mistake about the method.
    fn refuse_options_of_other_methods(&self) -> anyhow::Result<()> {
        use MethodArg::{Auto, Thesis2017, Threshold};
        let given = [
            ("-k", self.k.is_some(), &[Thesis2017][..]),
            ("--threshold", self.threshold.is_some(), &[Threshold]),
            ("--closings", self.closings.is_some(), &[Thesis2017, Threshold]),
            ("--disc", self.disc.is_some(), &[Thesis2017, Threshold]),
            ("--erosions", self.erosions.is_some(), &[Thesis2017, Threshold]),
            ("--probability", self.probability, &[Auto]),
        ];
        let name = |method: MethodArg| method.to_possible_value().expect("no method is hidden").get_name().to_string();
        let idle = given.iter().find(|(_, given, methods)| *given && !methods.contains(&self.method));
        if let Some((option, _, methods)) = idle {
            let methods: Vec<String> = methods.iter().map(|method| name(*method)).collect();
            bail!(
                "{option} does nothing with --method {}; it is of --method {}",
                name(self.method),
                methods.join(" and ")
            );
        }
        Ok(())
    }

    fn given(&self) -> anyhow::Result<Given> {
        let mut given = Given { samples: self.sample.clone(), lessons: self.teach.clone(), ..Given::default() };
        for path in &self.samples {
            given.samples.extend(shapes::read(path)?);
        }
        for path in &self.mend {
            given.mended.extend(shapes::read(path)?);
        }
        for path in &self.global {
            let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
            if ["toml", "json", "geojson"].contains(&extension.as_str()) {
                given.global.extend(shapes::read(path)?);
            } else if given.global_mask.replace(path.clone()).is_some() {
                bail!("--global: one mask at most; {} is the second", path.display());
            }
        }
        Ok(given)
    }
}

/// Says of which frames shapes are that are not among those of this run: their names may have changed.
fn tell_of_no_frame(option: &str, shapes: &[Shape], frames: &[PathBuf]) {
    let mut elsewhere: Vec<&str> = shapes
        .iter()
        .filter(|shape| !frames.iter().any(|frame| shape.is_of(frame)))
        .filter_map(|shape| shape.frame.as_deref())
        .collect();
    elsewhere.sort_unstable();
    elsewhere.dedup();
    if let [first, rest @ ..] = &elsewhere[..] {
        let more = if rest.is_empty() { String::new() } else { format!(" and {} more", rest.len()) };
        tracing::warn!("{option}: what was drawn in {first}{more} is of no frame of this run");
    }
}

/// Files as they are; of folders the images in them, by name.
fn all_frames(given: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let image = |path: &Path| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        ["tif", "tiff", "jpg", "jpeg", "png", "jp2", "vrt"].contains(&extension.as_str())
    };
    let mut frames = Vec::new();
    for path in given {
        if path.is_dir() {
            let failed = || format!("{}: cannot list the folder", path.display());
            let entries =
                std::fs::read_dir(path).with_context(failed)?.collect::<Result<Vec<_>, _>>().with_context(failed)?;
            let mut found: Vec<PathBuf> =
                entries.into_iter().map(|e| e.path()).filter(|p| p.is_file() && image(p)).collect();
            if found.is_empty() {
                bail!("{}: no image in this folder; give TIFF, JPEG or PNG files", path.display());
            }
            found.sort();
            let others: Vec<PathBuf> = found.iter().filter(|path| !is_output(path, &found)).cloned().collect();
            frames.extend(others);
        } else {
            frames.push(path.clone());
        }
    }
    let stem = |path: &PathBuf| path.file_stem().map(|s| s.to_os_string());
    for (i, frame) in frames.iter().enumerate() {
        if let Some(other) = frames[..i].iter().find(|other| stem(other) == stem(frame)) {
            bail!(
                "{} and {} would have the same mask; give them one after another with other --out",
                other.display(),
                frame.display()
            );
        }
    }
    Ok(frames)
}

/// Was it written beside the frames by an earlier run?
fn is_output(path: &Path, all: &[PathBuf]) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let ends = ["_Masq.tif", "_Prob.tif", "_Class.tif", "_Entropy.tif", "_Distance.tif"];
    let of_frame = |stem: &str| path.with_file_name(format!("{stem}_Masq.json")).is_file();
    let for_colmap = |frame: &str| all.iter().any(|other| other.file_name().is_some_and(|name| name == frame));
    // `fiducials --resample` writes a mask beside each frame.
    let of_resampled = |stem: &str| path.with_file_name(format!("{stem}.resampled.tif")).is_file();
    name.strip_suffix(".mask.tif").is_some_and(of_resampled)
        || ends.iter().filter_map(|end| name.strip_suffix(end)).any(of_frame)
        || name.strip_suffix(".png").is_some_and(for_colmap)
}

pub fn run(args: &MaskArgs) -> anyhow::Result<ExitCode> {
    let options = args.options()?;
    let given = args.given()?;
    let frames = all_frames(&args.frames)?;
    if args.method == MethodArg::Threshold && !(given.samples.is_empty() && given.lessons.is_empty()) {
        tracing::warn!("--method threshold learns nothing; of what teaches only the ground to be kept counts");
    }
    let camera = args.camera.prepare()?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads(args.threads)).build()?;
    pool.install(|| {
        tell_of_no_frame("--mend", &given.mended, &frames);
        tell_of_no_frame("--global", &given.global, &frames);
        let taught = teach(&frames, &given, &options)?;
        let _folder = OutputFolder::make(&args.output)?;
        let bar = if args.quiet || args.json { ProgressBar::hidden() } else { ProgressBar::new(frames.len() as u64) };
        bar.set_style(ProgressStyle::with_template("{bar:30} {pos}/{len} {eta} {msg}").expect("a sound template"));
        let (mut failed, mut sheet) = (0, Sheet::new(&args.output, &given.mended));
        for frame in &frames {
            bar.set_message(frame.file_name().unwrap_or_default().to_string_lossy().into_owned());
            let shown = match &camera {
                None => Ok(given.clone()),
                Some(camera) => camera
                    .of(frame)
                    .map(|shapes| Given { global: [&given.global[..], &shapes[..]].concat(), ..given.clone() }),
            };
            match shown.and_then(|given| mask_frame(frame, &args.output, &taught, &given, &options)) {
                Ok(done) => {
                    sheet.add(&done)?;
                    tell(args, &bar, &done.report)?;
                }
                Err(error) => {
                    failed += 1;
                    tell_error(args, &bar, frame, &error)?;
                }
            }
            bar.inc(1);
        }
        bar.finish_and_clear();
        sheet.finish()?;
        Ok(ExitCode::from(if failed > 0 { 2 } else { 0 }))
    })
}

fn tell(args: &MaskArgs, bar: &ProgressBar, report: &Report) -> anyhow::Result<()> {
    if args.json {
        println!("{}", serde_json::to_string(report)?);
    } else if !args.quiet {
        let words = report.warnings.iter().map(|w| format!("; {w}")).collect::<String>();
        let (keep, unsure) = (100.0 * report.keep_share, 100.0 * report.unsure_share);
        bar.suspend(|| {
            println!(
                "{}: {}, {keep:.1} % kept, {unsure:.1} % unsure{words}",
                report.mask.display(),
                report.status.name()
            );
        });
    }
    Ok(())
}

fn tell_error(args: &MaskArgs, bar: &ProgressBar, frame: &Path, error: &Error) -> anyhow::Result<()> {
    let text = error.to_string();
    let named = if text.contains(&*frame.to_string_lossy()) { text } else { format!("{}: {text}", frame.display()) };
    if args.json {
        let line = serde_json::json!({ "frame": frame.to_string_lossy(), "status": "error", "error": named });
        println!("{line}");
    }
    bar.suspend(|| eprintln!("autoref-stream: {named}"));
    Ok(())
}
