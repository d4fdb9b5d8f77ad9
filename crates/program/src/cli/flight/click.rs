//! A page in which GCPs are clicked on frames.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::world::World;
use autoref_flight::{Camera, Error, Pose, read};
use autoref_raster::atomic::{self, Existing};
use serde::Serialize;

use super::project::{OrderedFrames, Project, ordered_frames, point_args, read_project};
use super::{check_output_in, frames, image_size, lists, runs, views};
use autoref_raster::markup::escaped;

const PAGE: &str = include_str!("click.html");
/// Frames are shown at most this wide or high.
pub const LARGEST_PX: usize = 8000;

/// Write a page in which GCPs are clicked on the frames; it saves the list that [gcps] observations names.
#[derive(Debug, clap::Args)]
pub struct ClickArgs {
    /// The project file.
    project: PathBuf,
    /// The folder of the page and of the frames that it shows.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Cameras that say where GCPs are to be seen: cameras.json of an earlier solution. Default: the rough table.
    #[arg(long, value_name = "JSON")]
    cameras: Option<PathBuf>,
    /// Replace an existing page.
    #[arg(long)]
    overwrite: bool,
}

/// Where each frame is thought to stand, in the world's frame, and its camera.
type Thought = Vec<Option<(Pose, Camera)>>;

/// The folder of the frames as the page shows them.
pub const SHOWN: &str = "click_frames";

pub fn click(args: &ClickArgs) -> Result<ExitCode> {
    let page = args.output.join("click.html");
    check_output_in(&args.output, &page, Existing::of_flag(args.overwrite))?;
    let (project, base) = read_project(&args.project)?;
    let mut frames = ordered_frames(&project, &base)?;
    if args.cameras.is_none() {
        let list = point_args(&project, &base).map(|points| points.load(None)).transpose()?;
        frames.rows_on_map(&project, &base, list.as_ref())?;
    }
    let OrderedFrames { folder, names, rows, .. } = frames;
    let (names, left_out) = frames::usable(&folder, &names, &|_, _| Ok(()))?;
    left_out.iter().for_each(|note| eprintln!("warning: {note}"));
    let (Some(first), Some(points)) = (names.first(), point_args(&project, &base)) else {
        bail!("{}: there are no frames, or no [gcps] to click; name a list", args.project.display())
    };
    let control = points.load(None)?;
    let world = control.world()?;
    let size_px = image_size(&folder.join(first), None)?;
    let thought = match &args.cameras {
        Some(path) => of_solution(path, &names, &world)?,
        None => of_table(&project, &names, &rows, &world, size_px),
    };
    // Not `frames`: a project in this folder would take the pictures for its own.
    let shown = args.output.join(SHOWN);
    std::fs::create_dir_all(&shown).map_err(|e| Error::io(&shown, "create", e))?;
    for (i, name) in names.iter().enumerate() {
        views::write_png(&views::plain(&folder, name, LARGEST_PX)?, &shown.join(format!("{i}.png")))?;
    }
    let data = ClickData {
        frames: names.iter().enumerate().map(|(i, name)| ShownFrame::of(i, name, size_px)).collect(),
        points: control.points.iter().map(|p| PointToClick { name: p.name.clone() }).collect(),
        marks: marks(&control, &names, &thought, &world),
        zoom: None,
        saved: "observations.csv",
        then: None,
    };
    let title = args.project.file_stem().unwrap_or_default().to_string_lossy();
    write_page(&page, &format!("{title}: GCPs on frames"), &data)?;
    println!("{}", page.display());
    Ok(ExitCode::SUCCESS)
}

/// What the page shows, and asks for.
#[derive(Debug, Serialize)]
pub struct ClickData {
    pub frames: Vec<ShownFrame>,
    pub points: Vec<PointToClick>,
    pub marks: Vec<ExpectedMark>,
    /// Pixels of the screen for one of the frame. With it, points are clicked in turn: a click in the detail first
    /// enlarges, then places and goes on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub zoom: Option<f64>,
    /// Name of the file that the page saves.
    pub saved: &'static str,
    /// What to do with that file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub then: Option<String>,
}

/// A frame and its picture beside the page; width and height in pixels of the frame's file.
#[derive(Debug, Serialize)]
pub struct ShownFrame {
    name: String,
    src: String,
    width: f64,
    height: f64,
}

/// A point that is to be clicked.
#[derive(Debug, Serialize)]
pub struct PointToClick {
    pub name: String,
}

/// A point in a frame, pixels: where it is to be expected, and where it was measured already.
#[derive(Debug, Serialize)]
pub struct ExpectedMark {
    /// Its number in the list of points.
    #[serde(rename = "p")]
    pub point: usize,
    /// Its number in the list of frames.
    #[serde(rename = "f")]
    pub frame: usize,
    pub predicted: Option<[f64; 2]>,
    pub at: Option<[f64; 2]>,
}

impl ShownFrame {
    /// The frame of this number in the folder [`SHOWN`].
    pub fn of(number: usize, name: &str, [width, height]: [f64; 2]) -> Self {
        ShownFrame { name: name.into(), src: format!("{SHOWN}/{number}.png"), width, height }
    }
}

/// Writes the page.
///
/// # Errors
/// When the file cannot be written.
pub fn write_page(page: &Path, title: &str, data: &ClickData) -> Result<()> {
    // Nothing in the data ends the script that holds it.
    let data = serde_json::to_string(data)?.replace('<', "\\u003c");
    let text = PAGE.replace("@@TITLE@@", &escaped(title)).replace("@@DATA@@", &data);
    Ok(atomic::write(page, text.as_bytes())?)
}

/// Points in frames where they were measured or are to be expected.
fn marks(control: &lists::Control, names: &[String], thought: &Thought, world: &World) -> Vec<ExpectedMark> {
    let mut all = Vec::new();
    for (p, point) in control.points.iter().enumerate() {
        let at = world.to_world(point.xyz);
        for (f, frame) in thought.iter().enumerate() {
            let predicted = frame.as_ref().zip(at).and_then(|((pose, camera), x)| {
                camera.project(pose.to_camera(&x).into()).filter(|pixel| camera.contains(*pixel))
            });
            let known = || names.iter().map(String::as_str);
            let seen = point.seen.iter().find(|(image, _)| read::same_image(image, known()) == Some(f));
            if predicted.is_some() || seen.is_some() {
                all.push(ExpectedMark { point: p, frame: f, predicted, at: seen.map(|s| s.1) });
            }
        }
    }
    all
}

fn of_solution(path: &Path, names: &[String], world: &World) -> Result<Thought> {
    let model = read::reconstruction(path)?;
    let of = |name: &String| {
        let frame = &model.photographs[model.find(name)?];
        Some((world.pose_to_world(&frame.pose)?, model.cameras[frame.camera].clone()))
    };
    Ok(names.iter().map(of).collect())
}

fn of_table(
    project: &Project,
    names: &[String],
    rows: &[read::tables::CameraRow],
    world: &World,
    size_px: [f64; 2],
) -> Thought {
    let Some(f_px) = project.camera.f_px else { return vec![None; names.len()] };
    let pp_px = project.camera.pp_px.unwrap_or(size_px.map(|s| s / 2.0));
    let camera = Camera::pinhole("film", size_px, f_px, pp_px);
    let pitch = project.rough.as_ref().and_then(|r| r.pitch_deg);
    let listed: Vec<&str> = names.iter().map(String::as_str).collect();
    runs::rows_of(&listed, rows)
        .into_iter()
        .map(|row| Some((world.pose_to_world(&row?.pose(pitch)?)?, camera.clone())))
        .collect()
}
