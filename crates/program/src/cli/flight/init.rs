//! `flight init`: FLIGHT.toml from a folder of frames, and what they say of themselves.

use autoref_raster::words::some_of;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::read::same_image;
use autoref_flight::read::tables::Angles;
use autoref_raster::atomic::Existing;
use autoref_raster::crs::Crs;

use super::frames::Deviations;
use super::project::{
    Adjust, CameraPart, Focal, Frames, Gcps, Pairs, Project, Rough, absolute, default_ground_m, default_image_px,
    default_rough_m, frames_in,
};
use super::{camera_tables, check_output, frames, lists};

/// Write FLIGHT.toml from a folder of frames, a rough camera table and a list of GCPs.
#[derive(Debug, clap::Args)]
pub struct InitArgs {
    /// The folder of the frames.
    folder: PathBuf,
    /// Rough camera table: name, x, y, z and yaw (or omega, phi, kappa). Default: a table written from EXIF's GPS,
    /// where there is one.
    #[arg(long, value_name = "TABLE")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    angles: camera_tables::AnglesArgs,
    /// GCPs.
    #[arg(long, value_name = "LIST")]
    gcps: Option<PathBuf>,
    /// Where the GCPs were seen, when the list does not say.
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// CRS of table and list; `local` for metric coordinates on a plane.
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// Focal length in pixels. Default: of resampled film its camera's, of digital frames EXIF's.
    #[arg(long, value_name = "PX")]
    f_px: Option<f64>,
    /// Principal point. Default: the image's centre.
    #[arg(long, value_name = "X,Y", value_delimiter = ',')]
    pp_px: Option<Vec<f64>>,
    /// The film camera of frames that `fiducials --resample` wrote: a name of its --list-cameras or a TOML file.
    /// Default: the one that the frames name.
    #[arg(long, value_name = "CAMERA")]
    film: Option<String>,
    /// Points that are kept out of the fit and compared afterwards.
    #[arg(long, value_delimiter = ',', value_name = "A,B,…")]
    check: Vec<String>,
    /// 1σ of GCPs on the ground.
    #[arg(long, value_name = "M", default_value_t = default_ground_m())]
    sigma_ground: f64,
    /// 1σ of GCPs in the image.
    #[arg(long, value_name = "PX", default_value_t = default_image_px())]
    sigma_image: f64,
    /// The project file.
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
}

/// 1σ of positions by GPS.
const GPS_M: f64 = 20.0;

const IMAGES: [&str; 6] = ["tif", "tiff", "png", "jpg", "jpeg", "jp2"];

pub fn init(args: &InitArgs) -> Result<ExitCode> {
    check_numbers(args)?;
    check_output(Some(&args.output), Existing::of_flag(args.overwrite))?;
    let folder = absolute(&args.folder)?;
    let pattern = image_pattern(&folder)?;
    let names = frames_in(&folder, &pattern)?;
    if names.is_empty() {
        bail!("{}: there are no frames ({})", folder.display(), IMAGES.join(", "));
    }
    check_sizes(&folder, &names)?;
    check_table(args, &folder, &names)?;
    check_points(args)?;
    let told: Vec<frames::Told> = names.iter().map(|n| frames::told(&folder.join(n))).collect();
    let camera = init_camera(args, &folder.join(&names[0]), &told)?;
    let adjust = init_adjust(args, &folder.join(&names[0]), &camera, &told);
    let (crs, rough) = init_rough(args, &names, &told)?;
    let project = Project {
        crs,
        frames: Frames { folder, pattern },
        masks: None,
        camera,
        rough,
        gcps: init_gcps(args)?,
        pairs: Pairs::default(),
        adjust,
    };
    let text = format!("# A flight of {} frames; `autoref-stream flight solve` takes it.\n", names.len())
        + &toml::to_string(&project)?;
    autoref_raster::atomic::write(&args.output, text.as_bytes())?;
    println!("{}", args.output.display());
    Ok(ExitCode::SUCCESS)
}

/// Refuses a folder whose files are all empty, and tells of single ones, as copies that broke off leave them.
fn check_sizes(folder: &Path, names: &[String]) -> Result<()> {
    let is_empty = |name: &&String| std::fs::metadata(folder.join(name)).is_ok_and(|file| file.len() == 0);
    let empty: Vec<String> = names.iter().filter(is_empty).cloned().collect();
    if empty.len() == names.len() {
        bail!("{}: all {} frames are files of no bytes; copy them again", folder.display(), names.len());
    }
    if !empty.is_empty() {
        eprintln!("files of no bytes, which `flight solve` leaves out: {}; copy them again", some_of(&empty));
    }
    Ok(())
}

/// Refuses numbers of the command line that cannot be.
fn check_numbers(args: &InitArgs) -> Result<()> {
    if args.pp_px.as_ref().is_some_and(|p| p.len() != 2) {
        bail!("--pp-px: 2 numbers with a comma between them are expected");
    }
    for (name, sigma) in [("ground", args.sigma_ground), ("image", args.sigma_image)] {
        if !(sigma > 0.0 && sigma.is_finite()) {
            bail!("--sigma-{name}: a positive number is expected");
        }
    }
    if let Some(f_px) = args.f_px.filter(|f| !(*f > 0.0 && f.is_finite())) {
        bail!("--f-px {f_px}: a positive number of pixels is expected");
    }
    Ok(())
}

/// `*.jpg` and so on: an ending as it is written for every kind of image in the folder.
fn image_pattern(folder: &Path) -> Result<Vec<String>> {
    let all = frames_in(folder, &["*".into()])?;
    let extension = |n: &str| n.rsplit_once('.').map(|(_, e)| e.to_lowercase());
    let mut pattern: Vec<String> = all
        .iter()
        .filter(|n| extension(n).is_some_and(|e| IMAGES.contains(&e.as_str())))
        .filter_map(|n| n.rsplit_once('.').map(|(_, e)| format!("*.{e}")))
        .collect();
    pattern.sort();
    pattern.dedup();
    Ok(pattern)
}

/// Refuses a camera table that names none of the frames or lies outside the CRS; tells how many it names.
fn check_table(args: &InitArgs, folder: &Path, names: &[String]) -> Result<()> {
    let Some(table) = &args.cameras else { return Ok(()) };
    let rows = camera_tables::cameras(table, args.angles.angles())?;
    let known = rows.iter().filter(|r| same_image(&r.name, names.iter().map(String::as_str)).is_some()).count();
    if known == 0 {
        bail!("{}: none of its {} names is a frame of {}", table.display(), rows.len(), folder.display());
    }
    eprintln!("{known} of {} rows of the table are frames", rows.len());
    // A list of GCPs may name the CRS, which is not read here.
    if let Some(word) = args.crs.as_deref().filter(|word| !lists::is_local(word)) {
        let crs = camera_tables::map_of(&rows, Some(Crs::parse(word)?))?;
        camera_tables::in_map(rows, table, crs.as_ref())?;
    }
    Ok(())
}

/// Refuses a list of GCPs that is not there, check points that it does not have, and words about a list without one.
fn check_points(args: &InitArgs) -> Result<()> {
    let Some(list) = &args.gcps else {
        let given = [("check", !args.check.is_empty()), ("observations", args.observations.is_some())];
        return match given.into_iter().find(|(_, given)| *given) {
            Some((option, _)) => bail!("--{option} without a list of points; name it with --gcps"),
            None => Ok(()),
        };
    };
    if !list.is_file() {
        bail!("{}: is not there", list.display());
    }
    if args.check.is_empty() {
        return Ok(());
    }
    let points = lists::PointArgs {
        gcps: list.clone(),
        how: lists::PointOptions {
            observations: args.observations.clone(),
            crs: args.crs.clone(),
            check: args.check.clone(),
            sigma_ground: None,
            sigma_image: args.sigma_image,
        },
    };
    if let Some(known) = points.load_first()? {
        known.named_checks(&points)?;
    }
    Ok(())
}

/// The GCPs of the project.
fn init_gcps(args: &InitArgs) -> Result<Option<Gcps>> {
    let Some(list) = &args.gcps else { return Ok(None) };
    Ok(Some(Gcps {
        list: absolute(list)?,
        observations: args.observations.as_deref().map(absolute).transpose()?,
        sigma_ground_m: args.sigma_ground,
        sigma_image_px: args.sigma_image,
        check: args.check.clone(),
    }))
}

/// Focal lengths of one camera do not differ by more.
const ONE_FOCAL: f64 = 1.03;

/// The camera that the command line, resampled film or EXIF states.
fn init_camera(args: &InitArgs, first: &Path, told: &[frames::Told]) -> Result<CameraPart> {
    let pp_px = args.pp_px.as_ref().map(|p| [p[0], p[1]]);
    if let Some((f_px, of_film)) = frames::film_interior(first, args.film.as_deref(), args.f_px)? {
        return Ok(CameraPart { f_px: Some(f_px), pp_px: pp_px.or(Some(of_film)), focal: Focal::Held });
    }
    if args.f_px.is_some() {
        return Ok(CameraPart { f_px: args.f_px, pp_px, focal: Focal::Held });
    }
    let mut all: Vec<f64> = told.iter().filter_map(|t| t.f_px).collect();
    all.sort_by(f64::total_cmp);
    let f_px = all.get(all.len() / 2).copied();
    if let Some(f_px) = f_px {
        eprintln!("EXIF: focal length {f_px:.1} px");
        let (least, most) = (all[0], all[all.len() - 1]);
        if most > ONE_FOCAL * least {
            eprintln!(
                "EXIF: the frames' focal lengths lie between {least:.1} and {most:.1} px; frames of another zoom are \
                 another camera: leave them out"
            );
        }
    }
    if f_px.is_none() {
        eprintln!("no frame tells its focal length: it is sought with the block; --f-px states it");
    }
    Ok(CameraPart { f_px, pp_px, focal: if f_px.is_some() { Focal::Rough } else { Focal::Held } })
}

/// What is adjusted of the interior: of a lens that nobody has calibrated the principal point too, where GCPs tell it
/// from the tilt of the frames. Flights that look to the side leave it to the lens model.
fn init_adjust(args: &InitArgs, first: &Path, camera: &CameraPart, told: &[frames::Told]) -> Adjust {
    /// Straight down is −90°.
    const STEEP_DEG: f64 = -60.0;
    /// 1σ of the principal point, a share of the width.
    const CENTRED: f64 = 0.01;
    let mut adjust = Adjust::default();
    let pitch_deg = frames::median(told.iter().filter_map(|t| t.angles_deg[1]).collect());
    let tells = args.gcps.is_some() && pitch_deg.is_none_or(|pitch| pitch <= STEEP_DEG);
    let uncalibrated = camera.focal == Focal::Rough && camera.pp_px.is_none();
    if let (true, Some((width, height))) = (tells && uncalibrated, frames::size(first)) {
        let sigma_px = (CENTRED * width.max(height) as f64).ceil();
        adjust.free.extend(["cx", "cy"].map(|name| format!("{name}={sigma_px}")));
    }
    adjust
}

/// The table that the command line names, or one written from the frames' GPS beside the project; and the CRS of the
/// project.
fn init_rough(args: &InitArgs, names: &[String], told: &[frames::Told]) -> Result<(Option<String>, Option<Rough>)> {
    let rough =
        |table: PathBuf, sigma_m: f64| Rough { table, sigma_m, angles: Angles::View, pitch_deg: None, ground_m: None };
    if let Some(table) = &args.cameras {
        let rough = Rough { angles: args.angles.angles(), ..rough(absolute(table)?, default_rough_m()) };
        return Ok((args.crs.clone(), Some(rough)));
    }
    if args.crs.as_deref().is_some_and(lists::is_local) {
        return Ok((args.crs.clone(), None));
    }
    // The positions go into the CRS of the GCPs, in which the table is read.
    let known = match &args.gcps {
        Some(list) => lists::load(list, args.observations.as_deref(), args.crs.as_deref(), None)?.crs,
        None => args.crs.as_deref().map(Crs::parse).transpose()?.filter(|crs| !crs.is_geographic()),
    };
    if let (Some(list), None) = (&args.gcps, &known) {
        let with_place = told.iter().filter(|t| t.place.is_some()).count();
        if with_place > 0 {
            eprintln!(
                "EXIF: {with_place} frames tell where they stood; no table is written, since {} names no CRS: give --crs",
                list.display()
            );
        }
        return Ok((args.crs.clone(), None));
    }
    let stated = known.is_some();
    let deviations = if args.gcps.is_some() { Deviations::LeftOut } else { Deviations::Stated };
    let Some(made) = frames::table(names, told, known, deviations)? else {
        if told.iter().any(|t| t.place.is_some()) {
            eprintln!("EXIF: fewer than two frames tell place and altitude; give --cameras, or points in the frames");
        }
        return Ok((args.crs.clone(), None));
    };
    let frames::RoughTable { text, crs, start_m, fixed, warnings } = made;
    warnings.iter().for_each(|warning| eprintln!("EXIF: {warning}"));
    let stem = args.output.file_stem().unwrap_or_default().to_string_lossy();
    let path = args.output.with_file_name(format!("{stem}_gps.csv"));
    check_output(Some(&path), Existing::of_flag(args.overwrite))?;
    autoref_raster::atomic::write(&path, text.as_bytes())?;
    eprintln!("EXIF: {} positions, in {}", text.lines().count() - 1, path.display());
    if fixed > 0 {
        eprintln!("EXIF: {fixed} of them are fixed by carrier phases (RTK) and state their deviations");
    }
    let project_crs = if stated { args.crs.clone() } else { Some(crs.label()) };
    // GCPs know the ground better than the place of take-off.
    let ground_m = start_m.filter(|_| args.gcps.is_none()).map(|m| (m * 10.0).round() / 10.0);
    Ok((project_crs, Some(Rough { ground_m, ..rough(absolute(&path)?, GPS_M) })))
}
