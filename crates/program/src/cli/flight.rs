//! `autoref-stream flight …`: from frames to cameras that know where they stood.

mod adjust;
mod called;
mod camera_tables;
pub(super) mod click;
mod document;
mod engine;
mod export;
mod footprints;
mod frames;
mod init;
mod lists;
mod micmac;
pub(in crate::cli) mod ortho;
mod page;
mod plausible;
mod project;
mod refine;
mod relative;
mod runs;
mod solve;
mod stage;
mod stage_documents;
mod stage_line;
mod stage_pages;
mod stages;
mod ties;
pub(super) mod views;
mod worlds;

use autoref_raster::atomic::Existing;
use autoref_raster::words::some_of;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::adjust::{GroundPoint, Role};
use autoref_flight::read::{self, Reconstruction};
use autoref_flight::resect::{Focal, ResectOptions, Seen, resect};
use autoref_flight::world::World;
use autoref_flight::{Camera, Error, Parameter};
use nalgebra::Vector3;
use serde_json::json;

use document::ResectionDocument;

/// Photographs to cameras: relative orientation, bundle adjustment with GCPs, space resection.
#[derive(Debug, clap::Args)]
pub struct FlightArgs {
    #[command(subcommand)]
    command: FlightCommand,
}

#[derive(Debug, clap::Subcommand)]
enum FlightCommand {
    Init(init::InitArgs),
    Solve(solve::SolveArgs),
    Adjust(adjust::AdjustArgs),
    Resect(ResectArgs),
    Orthorectify(ortho::OrthorectifyArgs),
    Export(export::ExportArgs),
    Click(click::ClickArgs),
}

/// Find where one frame was taken from, from three or more GCPs measured in it.
#[derive(Debug, clap::Args)]
struct ResectArgs {
    /// The frame: an image, or only its name as the list has it.
    frame: PathBuf,
    #[command(flatten)]
    points: lists::PointArgs,
    /// The camera: MicMac's AutoCal, Calib or Orientation XML, COLMAP's cameras.txt, or any reconstruction that has the
    /// frame, a cameras.json of this program for one.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Focal length in pixels; without it and without --camera it is sought (four points or more).
    #[arg(long, value_name = "PX")]
    f_px: Option<f64>,
    /// Principal point. Default: the image's centre.
    #[arg(long, value_name = "X,Y", value_delimiter = ',')]
    pp_px: Option<Vec<f64>>,
    /// Distortion, such as k1=-0.13,k2=0.39,p1=0.0008. OpenCV's rational k4, k5, k6 are d1, d2, d3.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    distortion: Vec<String>,
    /// Size of the image, when the image is not there.
    #[arg(long, value_name = "W,H", value_delimiter = ',')]
    size: Option<Vec<f64>>,
    /// Known position, in the coordinates of the list.
    #[arg(long, value_name = "E,N,H", value_delimiter = ',', allow_hyphen_values = true)]
    position: Option<Vec<f64>>,
    /// 1σ of the known position.
    #[arg(long, value_name = "M", default_value_t = 1.0, requires = "position")]
    sigma_position: f64,
    /// Where to write the result as JSON.
    #[arg(short, long, value_name = "JSON")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print the result as one JSON document on standard output.
    #[arg(long)]
    json: bool,
}

impl FlightArgs {
    /// Whether the result is asked for as JSON.
    fn json(&self) -> bool {
        match &self.command {
            FlightCommand::Init(_) | FlightCommand::Export(_) | FlightCommand::Click(_) => false,
            FlightCommand::Solve(args) => args.json,
            FlightCommand::Adjust(args) => args.json,
            FlightCommand::Resect(args) => args.json,
            FlightCommand::Orthorectify(args) => args.json,
        }
    }
}

pub fn run(args: &FlightArgs) -> Result<ExitCode> {
    let done = match &args.command {
        FlightCommand::Init(args) => init::init(args),
        FlightCommand::Export(args) => export::export(args),
        FlightCommand::Click(args) => click::click(args),
        FlightCommand::Solve(args) => solve::solve(args),
        FlightCommand::Adjust(args) => adjust::run(args),
        FlightCommand::Resect(args) => run_resect(args),
        FlightCommand::Orthorectify(args) => ortho::run(args),
    };
    match done {
        Ok(code) => Ok(code),
        // It ran, and the data carry no result.
        Err(error) => match error.downcast_ref::<Error>() {
            Some(no @ Error::NoResult { .. }) => {
                let line = no.to_string();
                crate::out::error_line(&format!("autoref-stream: {}", crate::printable(&line)));
                if args.json() {
                    println!("{}", serde_json::to_string_pretty(&super::errors::document(&error, &line))?);
                }
                Ok(ExitCode::from(1))
            }
            _ => Err(error),
        },
    }
}

/// `f,k1,cx=5` as parameters with their standard deviations; `from` is the option or the key that has them.
fn interior(list: &[String], from: &str) -> Result<Vec<(Parameter, Option<f64>)>> {
    let mut all = Vec::new();
    for item in list.iter().filter(|i| !matches!(i.as_str(), "none" | "")) {
        let (name, sigma) = item.split_once('=').map_or((item.as_str(), None), |(n, s)| (n, Some(s)));
        let Some(parameter) = Parameter::by_name(name) else {
            bail!(
                "{from}: `{name}` is no interior parameter; there are {}",
                Parameter::ALL.map(Parameter::name).join(", ")
            );
        };
        let sigma = match sigma {
            Some(text) => match text.parse::<f64>() {
                Ok(s) if s > 0.0 => Some(s),
                _ => bail!("{from}: `{item}`: the standard deviation must be a positive number"),
            },
            None => None,
        };
        all.push((parameter, sigma));
    }
    Ok(all)
}

/// Standard deviations by their options.
fn check_sigmas(sigmas: &[(&str, Option<f64>)]) -> Result<()> {
    match sigmas.iter().find(|(_, sigma)| sigma.is_some_and(|s| !(s > 0.0 && s.is_finite()))) {
        Some((name, _)) => bail!("--{name}: a positive number is expected"),
        None => Ok(()),
    }
}

fn run_resect(args: &ResectArgs) -> Result<ExitCode> {
    check_resect_numbers(args)?;
    check_output(args.output.as_deref(), Existing::of_flag(args.overwrite))?;
    let name = args.frame.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let FrameCamera { camera, focal, note } = frame_camera(args, &name)?;
    let stub = Reconstruction {
        cameras: vec![camera.clone()],
        photographs: vec![read::Photograph {
            name: name.clone(),
            camera: 0,
            pose: autoref_flight::Pose { rotation: nalgebra::Matrix3::identity(), centre: Vector3::zeros() },
        }],
        ..Reconstruction::default()
    };
    let control = args.points.load(Some(&stub))?;
    let world = control.world()?;
    control.named_checks(&args.points)?;
    let mut points = control.in_world(&world, &stub, &args.points)?;
    let mut notes = plausible::within_frames(&mut points, &stub, &args.points.gcps.display().to_string())?;
    notes.extend(note);
    let (seen, checks) = seen_points(args, &name, (&control, &world), &points)?;
    let options = ResectOptions {
        sigma_px: args.points.how.sigma_image,
        position: match &args.position {
            Some(p) => {
                let at = control.place_in_world(&world, [p[0], p[1], p[2]], "--position")?;
                Some((at, Vector3::repeat(args.sigma_position)))
            }
            None => None,
        },
        focal,
        ..ResectOptions::default()
    };
    let found = resect(&camera, &seen, &options)?;
    let said = notes.clone();
    notes.extend(plausible::below_ground(std::iter::once(&found.pose), seen.iter().map(|s| &s.xyz), &world));
    let (points, on) = ((&seen[..], &checks[..]), (&world, control.crs_label()));
    let document = ResectionDocument::of(&found, &name, points, on, notes);
    finish(&document, args.output.as_deref(), args.json)?;
    if !args.json {
        document.say(&said);
    }
    Ok(ExitCode::SUCCESS)
}

/// No frame is wider or higher, pixels.
const MOST_SIDE_PX: f64 = 1e6;

fn check_resect_numbers(args: &ResectArgs) -> Result<()> {
    for (name, list, count) in [("pp-px", &args.pp_px, 2), ("size", &args.size, 2), ("position", &args.position, 3)] {
        if list
            .as_ref()
            .is_some_and(|l| l.len() != count || !l.iter().all(|v| v.abs() < autoref_flight::read::FARTHEST))
        {
            bail!("--{name}: {count} numbers with commas between them, none beyond all maps, are expected");
        }
    }
    let is_side = |v: &f64| v.fract() == 0.0 && (1.0..=MOST_SIDE_PX).contains(v);
    if let Some(size) = args.size.as_ref().filter(|size| !size.iter().all(is_side)) {
        bail!("--size {},{}: width and height of the frame in whole pixels, from 1 up, are expected", size[0], size[1]);
    }
    check_sigmas(&[
        ("sigma-image", Some(args.points.how.sigma_image)),
        ("sigma-ground", args.points.how.sigma_ground),
        ("sigma-position", Some(args.sigma_position)),
    ])?;
    Ok(())
}

/// The points that the frame is solved from, and those that are kept out.
fn seen_points(
    args: &ResectArgs,
    name: &str,
    (control, world): (&lists::Control, &World),
    points: &[GroundPoint],
) -> Result<(Vec<Seen>, Vec<Seen>)> {
    let (mut seen, mut checks) = (Vec::new(), Vec::new());
    for (p, listed) in points.iter().zip(&control.points) {
        // Where nobody states how good the points are, they are exact.
        let sigma_m = args.points.how.sigma_ground.map_or_else(|| listed.sigma_or(0.0), |s| [s; 3]);
        let sigma_m = world.deviations_of_map(listed.xyz, sigma_m.into());
        let of_role = if p.role == Role::Check { &mut checks } else { &mut seen };
        of_role.extend(p.seen.iter().map(|(_, pixel)| Seen {
            name: p.name.clone(),
            xyz: p.xyz,
            sigma_m,
            pixel: *pixel,
        }));
    }
    if seen.is_empty() && checks.is_empty() {
        let list = args.points.gcps.display();
        return Err(match control.frames().as_slice() {
            [] => {
                let why =
                    control.no_image_points.as_ref().map_or(String::new(), |why| format!(" (as image points: {why})"));
                Error::no_result(format!("{list}: says of no point where it was seen{why}"), "name --observations")
            }
            names => Error::no_result(
                format!("{list}: no point is seen in `{name}`; it has points of {}", some_of(names)),
                "name one of these frames",
            ),
        }
        .into());
    }
    Ok((seen, checks))
}

/// The camera of a frame.
struct FrameCamera {
    camera: Camera,
    focal: Focal,
    note: Option<String>,
}

/// MicMac's calibration in the folder of a frame, where there is one alone.
fn calibration_beside(frame: &Path) -> Option<PathBuf> {
    let folder = frame.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let is_calibration = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        name.ends_with(".xml") && (name.starts_with("AutoCal") || name.starts_with("Calib-"))
    };
    let entries = std::fs::read_dir(folder).ok()?;
    let mut calibrations = entries.flatten().map(|entry| entry.path()).filter(is_calibration);
    calibrations.next().filter(|_| calibrations.next().is_none())
}

fn frame_camera(args: &ResectArgs, name: &str) -> Result<FrameCamera> {
    let beside = calibration_beside(&args.frame).filter(|_| args.camera.is_none() && args.f_px.is_none());
    let note =
        beside.as_ref().map(|file| format!("the camera is that of {}, which lies beside the frame", file.display()));
    if let Some(note) = &note {
        tracing::warn!("{note}");
    }
    let stated = args.size.as_ref().map(|s| [s[0], s[1]]);
    // A frame that GDAL does not read needs no more than its name where the size is known otherwise.
    let seen = if args.frame.is_file() { image_size(&args.frame, None).ok() } else { None };
    if let (Some([w, h]), Some([width, height])) = (stated, seen)
        && [w, h] != [width, height]
    {
        bail!("--size {w},{h}, but {} has {width} × {height} px; leave --size out", args.frame.display());
    }
    let (mut camera, focal) = match args.camera.clone().or(beside) {
        Some(path) => {
            let mut camera = camera_file(&path, name)?;
            if let Some(size) = seen.or(stated) {
                ortho::resize(&mut camera, &args.frame, size)?;
            }
            (camera, Focal::Known)
        }
        None => {
            let size = match seen.or(stated) {
                Some(size) => size,
                None => image_size(&args.frame, args.pp_px.as_deref())?,
            };
            let focal = if args.f_px.is_some() { Focal::Known } else { Focal::Sought };
            let f = args.f_px.unwrap_or(size[0].max(size[1]));
            (Camera::pinhole(name, size, f, [size[0] / 2.0, size[1] / 2.0]), focal)
        }
    };
    set_interior(&mut camera, &args.frame, args.f_px, args.pp_px.as_deref(), &args.distortion)?;
    Ok(FrameCamera { camera, focal, note })
}

/// The interior that the command line states of a frame.
fn set_interior(
    camera: &mut Camera,
    frame: &Path,
    f_px: Option<f64>,
    pp_px: Option<&[f64]>,
    distortion: &[String],
) -> Result<()> {
    if let Some(f) = f_px {
        camera.set(Parameter::F, f);
    }
    if let Some(pp) = pp_px {
        camera.set(Parameter::Cx, pp[0]).set(Parameter::Cy, pp[1]);
    }
    for term in distortion {
        let pair =
            term.split_once('=').and_then(|(n, v)| Some((Parameter::by_name(n.trim())?, v.trim().parse().ok()?)));
        let Some((parameter, value)) = pair else { bail!("--distortion: `{term}` is not like k1=-0.1") };
        camera.set(parameter, value);
    }
    if !(camera.f_px() > 0.0 && camera.values.iter().all(|v| v.is_finite())) {
        bail!(
            "{}: the interior of its camera has a focal length of {} px, which must be positive, as all parameters must be \
             finite; correct --f-px, --pp-px, --distortion, or the camera's file",
            frame.display(),
            camera.f_px()
        );
    }
    Ok(())
}

/// A camera from a file: MicMac's calibration or orientation, or that of a frame of a reconstruction.
fn camera_file(path: &Path, name: &str) -> Result<Camera> {
    // A file that is named is read or refused: what lies beside it may be of another camera.
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("xml")) && path.is_file() {
        return Ok(read::micmac::read_camera_in_pixels(path)?);
    }
    let is_one_of = |names: &[&str]| path.file_name().is_some_and(|n| names.iter().any(|name| n == *name));
    let folder = path.parent().unwrap_or(Path::new(""));
    if is_one_of(&["cameras.txt", "cameras.bin"])
        && path.is_file()
        && !["bin", "txt"].iter().any(|e| folder.join(format!("images.{e}")).exists())
    {
        let cameras = read::colmap::cameras(folder)?;
        return of_frame(&Reconstruction { cameras, ..Reconstruction::default() }, name, path);
    }
    if path.extension().is_some_and(|e| e == "json")
        && path.is_file()
        && let Some(cameras) = read::opensfm::lenses(path)?
    {
        return of_frame(&Reconstruction { cameras, ..Reconstruction::default() }, name, path);
    }
    of_frame(&read::reconstruction(path)?, name, path)
}

fn of_frame(model: &Reconstruction, name: &str, path: &Path) -> Result<Camera> {
    match (model.find(name), model.cameras.as_slice()) {
        (Some(i), _) => Ok(model.cameras[model.photographs[i].camera].clone()),
        (None, [only]) => Ok(only.clone()),
        _ => bail!(
            "{}: has no frame `{name}` and more than one camera; name a file with that of the frame",
            path.display()
        ),
    }
}

pub(super) fn image_size(frame: &Path, pp: Option<&[f64]>) -> Result<[f64; 2]> {
    if frame.is_file() {
        let dataset = gdal::Dataset::open(frame).map_err(|e| autoref_raster::Error::gdal(frame, e))?;
        let (w, h) = dataset.raster_size();
        return Ok([w as f64, h as f64]);
    }
    match pp {
        Some(pp) => Ok([2.0 * pp[0], 2.0 * pp[1]]),
        None => bail!("{}: is not there; give --size W,H, or --camera", frame.display()),
    }
}

pub(super) fn check_output(output: Option<&Path>, existing: Existing) -> Result<()> {
    match output {
        Some(path) => Ok(autoref_raster::atomic::check_outputs(&[path], existing)?),
        None => Ok(()),
    }
}

/// The same of a file in a folder that may still have to be made.
pub(super) fn check_output_in(folder: &Path, path: &Path, existing: Existing) -> Result<()> {
    if folder.is_dir() { check_output(Some(path), existing) } else { Ok(()) }
}

fn finish(document: &impl serde::Serialize, output: Option<&Path>, print: bool) -> Result<()> {
    let text = serde_json::to_string_pretty(document)? + "\n";
    if let Some(path) = output {
        autoref_raster::atomic::write(path, text.as_bytes())?;
    }
    if print {
        crate::out::product(&text);
    } else if let Some(path) = output {
        println!("{}", json!({"written": path.display().to_string()}));
    }
    Ok(())
}
