//! `autoref-stream flight adjust`: a reconstruction brought to the ground.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::adjust::{AdjustOptions, Adjustment, GroundPoint, Role, RoughPose, TiesFrom, adjust, on_ground};
use autoref_flight::read::tables::CameraRow;
use autoref_flight::read::{self, Reconstruction};
use autoref_flight::shape::ties_of_poses;
use autoref_flight::world::World;
use autoref_raster::atomic::Existing;
use autoref_raster::crs::Crs;
use nalgebra::Vector3;

use super::document::CamerasDocument;
use super::{camera_tables, check_output, check_sigmas, finish, footprints, interior, lists, plausible, worlds};
use crate::cli::progress::Steps;

/// Bring a reconstruction (COLMAP, MicMac, OpenSfM, cameras.json) to the ground by bundle adjustment with GCPs or
/// known positions.
#[derive(Debug, clap::Args)]
pub struct AdjustArgs {
    /// A folder with COLMAP's model or MicMac's orientations, OpenSfM's reconstruction.json, or a cameras.json.
    reconstruction: PathBuf,
    /// GCPs, as of `flight solve`: OpenDroneMap's gcp_list.txt, rows of `x y z px py`, MicMac's XML, OpenSfM's
    /// ground_control_points.json, or any list of points, with --observations. Without it the positions of --cameras
    /// place the block.
    #[arg(long, value_name = "LIST", required_unless_present = "cameras")]
    gcps: Option<PathBuf>,
    #[command(flatten)]
    how: lists::PointOptions,
    /// Interior parameters that are adjusted: f, cx, cy, k1 … p1, p2, b1, b2; `f=20` within 20 px of what is given;
    /// `none`.
    #[arg(long, value_delimiter = ',', default_value = "f,k1", value_name = "LIST")]
    free: Vec<String>,
    /// 1σ of ties in the image. Default: from their residuals, 1 px where a reconstruction holds none.
    #[arg(long, value_name = "PX")]
    sigma_tie: Option<f64>,
    /// Rough camera table whose positions (and directions) count with --sigma-position and --sigma-direction.
    #[arg(long, value_name = "TABLE")]
    cameras: Option<PathBuf>,
    #[command(flatten)]
    angles: camera_tables::AnglesArgs,
    /// 1σ of rough positions whose table states none. Default: 200 m beside GCPs, 20 m where they place the block.
    #[arg(long, value_name = "M", requires = "cameras")]
    sigma_position: Option<f64>,
    /// 1σ of rough directions. Default: 2 degrees.
    #[arg(long, value_name = "DEG", requires = "cameras")]
    sigma_direction: Option<f64>,
    #[command(flatten)]
    force: plausible::ForceArgs,
    /// Where to write cameras.json.
    #[arg(short, long, value_name = "JSON")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print the result as one JSON document on standard output.
    #[arg(long)]
    pub json: bool,
}

/// What a pose's rays are taken to be worth where no ties were measured, pixels.
const SIGMA_OF_POSES_PX: f64 = 1.0;
const NO_TIES: &str = "the reconstruction holds no ties: its poses say how its frames lie to each other, as if ties were \
                       good to --sigma-tie (1 px); its interior orientation is held, and standard deviations take it \
                       for exact: where there is a reconstruction with ties, adjust that one";

const NOTHING_COMMON: &str = "the reconstruction holds no ties, and its frames stand at one place or see nothing in common: \
                              each is placed by its own points";

/// Takes out the figures of ties where all were made of poses.
fn forget_ties(found: &mut Adjustment) {
    (found.ties, found.dropped_ties) = (0, 0);
    (found.tie_rms_px, found.tie_mean_px) = (f64::NAN, f64::NAN);
    for photograph in &mut found.photographs {
        (photograph.ties, photograph.rms_px) = (0, f64::NAN);
    }
}

/// Where the block comes to stand: its points and rough poses in the world's frame, and what is to be said of them.
struct Datum {
    control: lists::Control,
    world: World,
    points: Vec<GroundPoint>,
    rough: Vec<Option<RoughPose>>,
    notes: Vec<String>,
    /// Of the notes, those that the terminal has said already.
    said: Vec<String>,
}

/// 1σ of positions of a table that states none, metres: beside GCPs, and where they place the block alone.
const SIGMA_BESIDE_GCPS_M: f64 = 200.0;
/// 1σ of rough directions, degrees.
const SIGMA_DIRECTION_DEG: f64 = 2.0;
const SIGMA_ALONE_M: f64 = 20.0;

impl Datum {
    fn of(args: &AdjustArgs, model: &Reconstruction) -> Result<Datum> {
        match (&args.gcps, &args.cameras) {
            (Some(list), table) => Datum::of_points(args, list, table.as_deref(), model),
            (None, Some(table)) => Datum::of_positions(args, table, model),
            (None, None) => bail!("neither --gcps nor --cameras: nothing places the block"),
        }
    }

    fn of_points(args: &AdjustArgs, list: &Path, table: Option<&Path>, model: &Reconstruction) -> Result<Datum> {
        let named = lists::PointArgs { gcps: list.to_path_buf(), how: args.how.clone() };
        let control = named.load(Some(model))?;
        let mut notes = control.notes(model, &named, &args.reconstruction)?;
        let world = control.world()?;
        let mut points = control.in_world(&world, model, &named)?;
        notes.extend(plausible::within_frames(&mut points, model, &list.display().to_string())?);
        let mut datum =
            Datum { said: notes.clone(), rough: vec![None; model.photographs.len()], control, world, points, notes };
        match table {
            Some(table) => {
                let rows = camera_tables::cameras(table, args.angles.angles())?;
                let rows = camera_tables::in_map(rows, table, datum.control.crs.as_ref())?;
                datum.weight_by(&rows, table, args, model)?;
            }
            None => datum.rough = kept_datum(&datum, model),
        }
        Ok(datum)
    }

    fn of_positions(args: &AdjustArgs, table: &Path, model: &Reconstruction) -> Result<Datum> {
        let how = &args.how;
        let given = [("observations", how.observations.is_some()), ("check", !how.check.is_empty())];
        let given = given.into_iter().chain([("sigma-ground", how.sigma_ground.is_some())]);
        if let Some((option, _)) = given.into_iter().find(|(_, given)| *given) {
            bail!("--{option} without a list of points; name it with --gcps");
        }
        let rows = camera_tables::cameras(table, args.angles.angles())?;
        let local = how.crs.as_deref().is_some_and(lists::is_local);
        let stated = how.crs.as_deref().filter(|_| !local).map(Crs::parse).transpose()?;
        let crs = if local { None } else { camera_tables::map_of(&rows, stated)? };
        let rows = camera_tables::in_map(rows, table, crs.as_ref())?;
        let of_block = rows.iter().filter(|row| model.find(&row.name).is_some()).cloned().collect::<Vec<_>>();
        let names: Vec<&str> = model.photographs.iter().map(|p| p.name.as_str()).collect();
        camera_tables::unmatched(&rows, table, &names)?;
        let control = lists::Control::of_positions(&of_block, crs, table)?;
        let world = control.world()?;
        let mut datum = Datum {
            rough: vec![None; model.photographs.len()],
            notes: vec![camera_tables::NO_GCPS.to_string()],
            said: Vec::new(),
            points: Vec::new(),
            control,
            world,
        };
        datum.weight_by(&rows, table, args, model)?;
        Ok(datum)
    }

    /// What a camera table says counts with its deviations.
    fn weight_by(&mut self, rows: &[CameraRow], table: &Path, args: &AdjustArgs, model: &Reconstruction) -> Result<()> {
        let names: Vec<&str> = model.photographs.iter().map(|p| p.name.as_str()).collect();
        self.notes.extend(camera_tables::unmatched(rows, table, &names)?);
        let alone = if self.points.is_empty() { SIGMA_ALONE_M } else { SIGMA_BESIDE_GCPS_M };
        let sigma_m = args.sigma_position.unwrap_or(alone);
        let sigma_direction_deg = args.sigma_direction.unwrap_or(SIGMA_DIRECTION_DEG);
        let states_all = |row: &CameraRow| row.sigma_m.iter().all(Option::is_some);
        let needless = [
            (
                "direction",
                args.sigma_direction.is_some() && !rows.iter().any(CameraRow::is_directed),
                "states no direction",
            ),
            ("position", args.sigma_position.is_some() && rows.iter().all(states_all), "states its own in every row"),
        ];
        if let Some((of, _, why)) = needless.into_iter().find(|(_, is, _)| *is) {
            bail!("{}: {why}, and --sigma-{of} has no effect; leave it out", table.display());
        }
        for row in rows {
            if let Some(i) = model.find(&row.name) {
                let sigma_rad = sigma_direction_deg.to_radians();
                self.rough[i] = camera_tables::rough_pose(row, &self.world, sigma_m, sigma_rad);
            }
        }
        Ok(())
    }

    /// Refuses a block that hangs upside down; lets go of directions of a table that the block contradicts.
    fn stand(&mut self, args: &AdjustArgs, model: &Reconstruction) -> Result<()> {
        let placed = on_ground(model, &self.points, &self.rough)?;
        let lists = [args.gcps.as_deref(), args.cameras.as_deref()];
        self.notes.extend(plausible::upside_down(placed.upside_down, lists, &args.force)?);
        if args.cameras.is_some() {
            self.notes.extend(footprints::let_go_of_turned(&mut self.rough, model, &placed.similarity));
        }
        Ok(())
    }
}

/// A block that stands on the Earth already keeps its datum, loosely: in its own frame, or where too few points would
/// fix another.
fn kept_datum(datum: &Datum, model: &Reconstruction) -> Vec<Option<RoughPose>> {
    let fixing = datum.points.iter().filter(|p| p.role == Role::Control && p.seen.len() >= 2).count();
    let kept = |p: &read::Photograph| match model.reference_lla {
        Some(reference) if fixing < 3 => datum.world.pose_of_tangent(reference, &p.pose),
        Some(_) | None => None,
    };
    let loosely = |pose| RoughPose { pose, sigma_m: Vector3::repeat(5.0), sigma_rad: f64::INFINITY };
    model.photographs.iter().map(|p| kept(p).map(loosely)).collect()
}

pub fn run(args: &AdjustArgs) -> Result<ExitCode> {
    check_output(args.output.as_deref(), Existing::of_flag(args.overwrite))?;
    check_sigmas(&[
        ("sigma-tie", args.sigma_tie),
        ("sigma-image", Some(args.how.sigma_image)),
        ("sigma-ground", args.how.sigma_ground),
        ("sigma-position", args.sigma_position),
        ("sigma-direction", args.sigma_direction),
    ])?;
    let interior = interior(&args.free, "--free")?;
    let mut model = read::reconstruction(&args.reconstruction)?;
    model.drop_unused_cameras();
    worlds::straighten(&mut model, &args.reconstruction)?;
    let has_ties = !model.ties.is_empty();
    let mut datum = Datum::of(args, &model)?;
    if !has_ties {
        model.ties = ties_of_poses(&model);
    }
    datum.stand(args, &model)?;
    let Datum { control, world, points, rough, mut notes, said } = datum;
    let (sigma_tie_px, interior) = match (has_ties, model.ties.is_empty()) {
        (true, _) => (args.sigma_tie, interior),
        (false, true) => {
            notes.push(NOTHING_COMMON.to_string());
            (args.sigma_tie, interior)
        }
        (false, false) => {
            notes.push(NO_TIES.to_string());
            (Some(args.sigma_tie.unwrap_or(SIGMA_OF_POSES_PX)), vec![])
        }
    };
    let options = AdjustOptions {
        sigma_image_px: args.how.sigma_image,
        sigma_tie_px,
        ties: if has_ties { TiesFrom::Images } else { TiesFrom::Poses },
        interior,
        rough,
        ..AdjustOptions::default()
    };
    let steps = Steps::new("adjusting", 0);
    let mut found = adjust(&model, &points, &options)?;
    drop(steps);
    if !has_ties {
        forget_ties(&mut found);
    }
    found.notes.extend(notes);
    let (poses, places) = (found.photographs.iter().map(|p| &p.pose), points.iter().map(|p| &p.xyz));
    found.notes.extend(plausible::below_ground(poses, places, &world));
    let listed = model.photographs.len();
    let document = CamerasDocument::of(&found, &model, &world, listed, control.crs_label());
    finish(&document, args.output.as_deref(), args.json)?;
    if !args.json {
        document.say(&said);
    }
    Ok(ExitCode::SUCCESS)
}
