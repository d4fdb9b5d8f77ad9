//! `autoref-stream fiducials`: fiducial marks and interior orientation of scanned film.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_film::{self, FindOptions, Finder, FrameResult, FrameStatus, InteriorModel, Method, learn, roll};
use autoref_raster::atomic::Existing;
use autoref_raster::memory_plan;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};

use super::everywhere;
use super::fiducials_page::{self, At};
use super::film_outputs;
use autoref_raster::words::counted;

/// Find the fiducial marks of scanned film frames and solve their interior orientation.
///
/// Writes one JSON per frame and the roll's table, fiducials.csv, into the output folder. A run that was stopped goes
/// on where it was. Exit codes: 0 every frame is OK, 1 a frame needs a person, 2 error.
#[derive(Args, Debug)]
pub struct FiducialsArgs {
    /// The scans: files, or folders of them.
    #[arg(required_unless_present = "list_cameras")]
    frames: Vec<PathBuf>,
    /// The camera: a name of --list-cameras or a TOML file.
    #[arg(long, value_name = "NAME|FILE", required_unless_present = "list_cameras")]
    camera: Option<String>,
    /// Name the cameras that come with the program.
    #[arg(long)]
    list_cameras: bool,
    /// Folder for the results.
    #[arg(short, long = "out", value_name = "DIR", default_value = "fiducials")]
    output: PathBuf,
    /// Print every frame's result as one line of JSON. A frame that its roll makes doubtful has a second line, which
    /// counts.
    #[arg(long)]
    json: bool,

    /// Size of a scanned pixel on the film, micrometres. Default: from the sizes of film and scan.
    #[arg(long, value_name = "UM", help_heading = "Finding")]
    pixel_um: Option<f64>,
    /// How the frames are turned in the scans. Default: found, upright where the marks do not tell.
    #[arg(long, value_enum, help_heading = "Finding")]
    turn: Option<Turn>,
    /// Whether the scans show the film from the wrong side. Default: found, as for --turn.
    #[arg(long, value_name = "true|false", help_heading = "Finding")]
    mirrored: Option<bool>,
    /// Side of the search boxes as a share of the frame's longer side; they grow when marks are not found.
    #[arg(long, value_name = "SHARE", default_value_t = 0.10, help_heading = "Finding")]
    box_share: f64,
    /// How marks are found; thesis-2017 is for three-toothed marks and there for comparison.
    #[arg(long, value_enum, default_value_t = FinderName::Correlation, help_heading = "Finding")]
    finder: FinderName,
    /// Transform of the interior orientation; with three marks it is a similarity.
    #[arg(long, value_enum, default_value_t = Model::Affine, help_heading = "Checking")]
    model: Model,
    /// How far a mark may lie from where the other marks put it, micrometres on the film; never below 1.5 pixels.
    #[arg(long, value_name = "UM", default_value_t = 40.0, help_heading = "Checking")]
    agreement_um: f64,
    /// Learn templates of the marks from these scans instead of examining them: writes a camera file with them into the
    /// output folder.
    #[arg(long, help_heading = "Learning")]
    learn: bool,
    /// Where a mark lies in the first scan, pixels, or the file that the page of --page saved; repeat for two or more.
    /// Default: the camera's own shapes find them.
    #[arg(long = "at", value_name = "MARK=X,Y|FILE", value_parser = At::parse, requires = "learn", help_heading = "Learning")]
    at: Vec<At>,
    /// Write a page, click.html, in which the marks of the first scan are clicked, into the output folder, and learn
    /// nothing yet.
    #[arg(long, requires = "learn", conflicts_with = "at", help_heading = "Learning")]
    page: bool,
    /// Width and height of the templates, millimetres on the film.
    #[arg(long, value_name = "W,H", value_parser = parse_size, default_value = "8,5", help_heading = "Learning")]
    window_mm: [f64; 2],
    /// Frames at a time. Default: one per core.
    #[arg(long, value_name = "N", help_heading = "Running")]
    threads: Option<usize>,
    /// No progress bar.
    #[arg(long, help_heading = "Running")]
    quiet: bool,
    #[command(flatten)]
    outputs: super::film_outputs::FilmOutputArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FinderName {
    Correlation,
    #[value(name = "thesis-2017")]
    Thesis2017,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Turn {
    #[value(name = "0")]
    Upright,
    #[value(name = "90")]
    Right,
    #[value(name = "180")]
    Down,
    #[value(name = "270")]
    Left,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Model {
    Similarity,
    Affine,
    Projective,
}

impl FiducialsArgs {
    /// What was written, in words or as the document of `--json`.
    fn tell_written(&self, words: &str) {
        if self.json {
            print!("{}", everywhere::files_written());
        } else {
            println!("{words}");
        }
    }

    fn options(&self) -> anyhow::Result<FindOptions> {
        if self.pixel_um.is_some_and(|v| !(0.5..=500.0).contains(&v)) {
            bail!("--pixel-um must be between 0.5 and 500 micrometres");
        }
        if !(0.01..=0.5).contains(&self.box_share) {
            bail!("--box-share must be between 0.01 and 0.5");
        }
        if !(1.0..=1000.0).contains(&self.agreement_um) {
            bail!("--agreement-um must be between 1 and 1000 micrometres");
        }
        Ok(FindOptions {
            method: match self.finder {
                FinderName::Correlation => Method::Correlation,
                FinderName::Thesis2017 => Method::Thesis2017,
            },
            pixel_um: self.pixel_um,
            model: match self.model {
                Model::Similarity => InteriorModel::Similarity,
                Model::Affine => InteriorModel::Affine,
                Model::Projective => InteriorModel::Projective,
            },
            turn_deg: self.turn.map(|t| match t {
                Turn::Upright => 0.0,
                Turn::Right => 90.0,
                Turn::Down => 180.0,
                Turn::Left => 270.0,
            }),
            mirrored: self.mirrored.map(autoref_raster::coords::Handedness::from),
            box_share: self.box_share,
            agreement_um: self.agreement_um,
            ..FindOptions::default()
        })
    }
}

/// The cameras that come with the program: product of the command, as lines or as JSON.
fn list_cameras(json: bool) -> anyhow::Result<()> {
    let cameras = autoref_film::builtin_cameras();
    if json {
        let named =
            cameras.iter().map(|camera| serde_json::json!({"name": camera.name, "description": camera.description}));
        let document = serde_json::json!({"cameras": named.collect::<Vec<_>>()});
        println!("{}", serde_json::to_string_pretty(&document)?);
        return Ok(());
    }
    for camera in cameras {
        println!("{:<22} {}", camera.name, camera.description);
    }
    Ok(())
}

pub fn run(args: &FiducialsArgs) -> anyhow::Result<ExitCode> {
    if args.list_cameras {
        list_cameras(args.json)?;
        return Ok(ExitCode::SUCCESS);
    }
    let options = args.options()?;
    let camera = autoref_film::load_camera(args.camera.as_deref().context("give --camera NAME or FILE")?)?;
    let scans = scans(&args.frames)?;
    if args.page {
        let named = (&camera, args.camera.as_deref().unwrap_or_default());
        // A page is written anew: what was clicked lies in the file that it saved.
        let page = fiducials_page::write(&args.output, &scans[0], named, &options, Existing::Replace)?;
        args.tell_written(&format!("{}: click the marks, save, then say --learn --at FILE", page.display()));
        return Ok(ExitCode::SUCCESS);
    }
    if args.learn {
        let pointed = fiducials_page::pointed(&args.at, &scans[0])?;
        let (file, count) = learn::learn_files(&scans, &camera, &pointed, args.window_mm, &options, &args.output)?;
        args.tell_written(&format!(
            "learned from {}; use --camera {}",
            counted(count, "scan", "scans"),
            file.display()
        ));
        return Ok(ExitCode::SUCCESS);
    }
    let finder = Finder::new(&camera)?;
    // What can be refused is refused before the first frame.
    args.outputs.resampling.options()?;
    if let Some(path) = &args.outputs.patch {
        film_outputs::patch_of(path, &scans)?;
    }
    if let Some(n) = args.threads {
        if n == 0 {
            bail!("0 threads can do nothing; use 1 or more");
        }
        rayon::ThreadPoolBuilder::new().num_threads(n).build_global().context("cannot start the threads")?;
    }
    let bar = if args.quiet || args.json { ProgressBar::hidden() } else { ProgressBar::new(scans.len() as u64) };
    let style = "{bar:40} {pos}/{len} frames  {elapsed} of about {duration}";
    bar.set_style(ProgressStyle::with_template(style).context("the progress bar's template")?);
    let summary = roll::run(&scans, &args.output, &finder, &options, &|done, frame| {
        bar.set_position(done as u64);
        if args.json {
            println!("{}", serde_json::to_string(frame).expect("a result is plain data"));
        } else if !frame.is_ok() {
            bar.suspend(|| println!("{}", line(frame)));
        }
    })?;
    bar.finish_and_clear();
    let outputs = &args.outputs;
    // Of frames as a review leaves them.
    let mut reviewed = None;
    if outputs.exports || outputs.resampling.resample || outputs.patch.is_some() {
        let read = |scan: &PathBuf| roll::read_frame(&roll::frame_json(&args.output, scan));
        let mut frames = scans.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        super::film_outputs::write_outputs(&args.output, &camera, &mut frames, &options, outputs)?;
        reviewed = outputs.patch.as_ref().map(|_| Verdicts::of(&frames));
    }
    let verdicts = reviewed.unwrap_or(Verdicts { ok: summary.ok, doubtful: summary.doubtful, failed: summary.failed });
    if !args.json {
        let memory = memory_plan::peak_resident_bytes()
            .map_or(String::new(), |bytes| format!(", {:.0} MiB at most", bytes as f64 / 1_048_576.0));
        let Verdicts { ok, doubtful, failed } = verdicts;
        println!(
            "{}: {ok} OK, {doubtful} doubtful, {failed} failed ({} from an earlier run){memory}; results in {}",
            counted(summary.frames, "frame", "frames"),
            summary.resumed,
            args.output.display()
        );
    }
    Ok(if verdicts.ok == summary.frames { ExitCode::SUCCESS } else { ExitCode::from(1) })
}

/// How many frames are what.
struct Verdicts {
    ok: usize,
    doubtful: usize,
    failed: usize,
}

impl Verdicts {
    fn of(frames: &[FrameResult]) -> Verdicts {
        let count = |is: fn(&FrameStatus) -> bool| frames.iter().filter(|frame| is(&frame.status)).count();
        Verdicts {
            ok: count(|status| matches!(status, FrameStatus::Ok)),
            doubtful: count(|status| matches!(status, FrameStatus::Doubtful { .. })),
            failed: count(|status| matches!(status, FrameStatus::Failed { .. })),
        }
    }
}

fn line(frame: &FrameResult) -> String {
    match &frame.status {
        FrameStatus::Ok => format!("{}: OK", frame.name),
        FrameStatus::Doubtful { reasons } => format!("{}: doubtful: {}", frame.name, reasons.join("; ")),
        FrameStatus::Failed { reasons } => format!("{}: failed: {}", frame.name, reasons.join("; ")),
    }
}

/// Was it written beside the scans by an earlier run?
fn is_output(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let of_scan = |stem: &str| path.with_file_name(format!("{stem}.fiducials.json")).is_file();
    [".resampled.tif", ".mask.tif"].iter().filter_map(|end| name.strip_suffix(end)).any(of_scan)
}

/// The files, folders replaced by the images in them that no run wrote, in order of name.
fn scans(paths: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let mut all = vec![];
    for path in paths {
        if !path.is_dir() {
            // GDAL has names for what lies in archives and files.
            let is_name_of_gdal = path.starts_with("/vsi") || path.to_string_lossy().contains([':', '<']);
            if !path.exists() && !is_name_of_gdal {
                bail!("{}: there is no such file; name scans or a folder of them", path.display());
            }
            all.push(path.clone());
            continue;
        }
        let list = std::fs::read_dir(path).with_context(|| format!("{}: cannot list it", path.display()))?;
        let known = ["tif", "tiff", "jpg", "jpeg", "png", "jp2", "vrt"];
        let mut inside: Vec<PathBuf> = list
            .filter_map(|e| e.ok().map(|e| e.path()))
            .filter(|p| p.file_name().is_some_and(|n| !n.to_string_lossy().starts_with('.')))
            .filter(|p| !is_output(p))
            .filter(|p| p.extension().and_then(|e| e.to_str()).is_some_and(|e| known.contains(&&*e.to_lowercase())))
            .collect();
        if inside.is_empty() {
            bail!("{}: no scan (tif, jpg, png, jp2) in this folder", path.display());
        }
        inside.sort();
        all.extend(inside);
    }
    Ok(all)
}

fn parse_size(text: &str) -> Result<[f64; 2], String> {
    let wrong = || format!("\"{text}\" is not W,H in millimetres, 0.2 to 100 each");
    let (w, h) = text.split_once(',').ok_or_else(wrong)?;
    let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| (0.2..=100.0).contains(v)).ok_or_else(wrong);
    Ok([number(w)?, number(h)?])
}
