//! FLIGHT.toml, and the chain that it describes: features, matches, relative orientation (COLMAP), adjustment.

use autoref_raster::bounded;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::Error;
use autoref_flight::adjust::{AdjustOptions, RoughPose, adjust};
use autoref_flight::read::{Reconstruction, same_image, tables};
use autoref_flight::world::World;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::engine::Program;
use super::relative::{Flight, GroundPlane};
use super::{document, footprints, frames, image_size, interior, lists, micmac, page, runs, views};

/// Solve a flight: cameras.json with positions, directions, interior, residuals and check points.
#[derive(Debug, clap::Args)]
pub struct SolveArgs {
    /// The project file.
    project: PathBuf,
    /// The folder of the results; stages whose inputs have not changed are taken from it.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// What makes the relative orientation.
    #[arg(long, value_enum, default_value_t = Engine::Colmap)]
    engine: Engine,
    /// Work every stage anew.
    #[arg(long)]
    overwrite: bool,
    /// Print cameras.json on standard output.
    #[arg(long)]
    pub(super) json: bool,
}

/// Programs that orient frames to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Engine {
    /// The program `colmap`, or pycolmap where there is none.
    Colmap,
    /// Python's pycolmap, version 4.
    Pycolmap,
    /// MicMac's `mm3d`, where it is installed.
    Micmac,
}

/// FLIGHT.toml. Paths are taken from the file's folder.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Project {
    /// CRS of table and GCPs: an EPSG code, WKT, PROJ string, or `local`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crs: Option<String>,
    pub frames: Frames,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masks: Option<MaskPart>,
    #[serde(default)]
    pub camera: CameraPart,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rough: Option<Rough>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gcps: Option<Gcps>,
    #[serde(default)]
    pub pairs: Pairs,
    #[serde(default)]
    pub adjust: Adjust,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Frames {
    pub folder: PathBuf,
    /// Names with `*`.
    pub pattern: Vec<String>,
}

/// Masks have 0 where a frame is not to be used, and its size.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaskPart {
    /// The folder of `NAME_Masq.tif`, as `mask` writes them. Default: beside the frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folder: Option<PathBuf>,
    /// One for all frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub global: Option<PathBuf>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraPart {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_px: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pp_px: Option<[f64; 2]>,
    /// What `f_px` is worth.
    #[serde(default)]
    pub focal: Focal,
}

/// What a focal length is worth in the relative orientation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Focal {
    /// Known: it stays as it is.
    #[default]
    Held,
    /// A start, as EXIF has it.
    Rough,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rough {
    pub table: PathBuf,
    #[serde(default = "default_rough_m")]
    pub sigma_m: f64,
    /// Elevation of the view where the table has none (-20: 20° below the horizon).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pitch_deg: Option<f64>,
    /// Height of the ground that neighbours are warped over. Default: the median of the GCPs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ground_m: Option<f64>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Gcps {
    pub list: PathBuf,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observations: Option<PathBuf>,
    /// 1σ on the ground; a list that states its own has the last word.
    #[serde(default = "default_ground_m")]
    pub sigma_ground_m: f64,
    #[serde(default = "default_image_px")]
    pub sigma_image_px: f64,
    /// Points kept out of the fit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub check: Vec<String>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Pairs {
    /// Frames to each side along the line, in the order of the table (or of the names).
    pub neighbours: usize,
    /// Frames of other lines that each is compared with: those that see most of the same ground.
    pub across: usize,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Adjust {
    /// Interior parameters that are adjusted; `f=20` within 20 px.
    pub free: Vec<String>,
    pub features: usize,
    pub seed: u32,
}

impl Default for Pairs {
    fn default() -> Self {
        Pairs { neighbours: 3, across: 4 }
    }
}

impl Default for Adjust {
    fn default() -> Self {
        Adjust { free: vec!["f".into(), "k1".into()], features: 6000, seed: 1 }
    }
}

pub fn default_rough_m() -> f64 {
    200.0
}
pub fn default_ground_m() -> f64 {
    25.0
}
pub fn default_image_px() -> f64 {
    5.0
}

fn matches_pattern(name: &str, pattern: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or("");
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let parts: Vec<&str> = parts.collect();
    for (i, part) in parts.iter().enumerate() {
        if i + 1 == parts.len() {
            return rest.ends_with(part);
        }
        match rest.find(part) {
            Some(at) => rest = &rest[at + part.len()..],
            None => return false,
        }
    }
    rest.is_empty()
}

pub fn frames_in(folder: &Path, patterns: &[String]) -> Result<Vec<String>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "read the folder", e))?;
    let mut names: Vec<String> = entries
        .flatten()
        .filter(|e| e.path().is_file())
        .map(|e| e.file_name().to_string_lossy().into_owned())
        .filter(|n| patterns.iter().any(|p| matches_pattern(n, p)) && !views::is_mask(n))
        .collect();
    names.sort();
    Ok(names)
}

pub fn absolute(path: &Path) -> Result<PathBuf> {
    std::fs::canonicalize(path).map_err(|e| Error::io(path, "find", e).into())
}

/// The project and the folder that its paths start from.
pub fn read_project(path: &Path) -> Result<(Project, PathBuf)> {
    let text = bounded::read_to_string(path, "a project of a flight", bounded::TEXT_BYTES)?;
    let project =
        toml::from_str(&text).map_err(|e| Error::format(path, "the file", e.to_string().trim().replace('\n', " ")))?;
    Ok((project, path.parent().unwrap_or(Path::new(".")).to_path_buf()))
}

/// The frames in the order of the table, which is that of the flight, else of the names; and the table.
pub struct OrderedFrames {
    pub folder: PathBuf,
    pub masks: views::Masks,
    pub names: Vec<String>,
    pub rows: Vec<tables::CameraRow>,
}

pub fn ordered_frames(project: &Project, base: &Path) -> Result<OrderedFrames> {
    let folder = absolute(&base.join(&project.frames.folder))?;
    let names = frames_in(&folder, &project.frames.pattern)?;
    if names.len() < 2 {
        bail!("{}: {} frames match; two or more are needed", folder.display(), names.len());
    }
    let rows = match &project.rough {
        Some(r) => tables::cameras(&base.join(&r.table))?,
        None => Vec::new(),
    };
    let mut order: Vec<usize> = Vec::new();
    for row in &rows {
        if let Some(i) = same_image(&row.name, names.iter().map(String::as_str)).filter(|i| !order.contains(i)) {
            order.push(i);
        }
    }
    // A frame that the table lacks goes behind the one before it by name.
    for i in 0..names.len() {
        if !order.contains(&i) {
            let at = i.checked_sub(1).and_then(|before| order.iter().position(|k| *k == before));
            order.insert(at.map_or(if rows.is_empty() { order.len() } else { 0 }, |at| at + 1), i);
        }
    }
    let names = order.into_iter().map(|i| names[i].clone()).collect();
    let part = project.masks.clone().unwrap_or_default();
    let masks = views::Masks::new(
        part.folder.map_or(Ok(folder.clone()), |f| absolute(&base.join(f)))?,
        part.global.map(|f| absolute(&base.join(f))).transpose()?,
    );
    Ok(OrderedFrames { folder, masks, names, rows })
}

/// Where the project has its GCPs.
pub fn point_args(project: &Project, base: &Path) -> Option<lists::PointArgs> {
    let gcps = project.gcps.as_ref()?;
    Some(lists::PointArgs {
        gcps: base.join(&gcps.list),
        observations: gcps.observations.as_ref().map(|o| base.join(o)),
        crs: project.crs.clone(),
        check: gcps.check.clone(),
        sigma_ground: None,
        sigma_image: gcps.sigma_image_px,
    })
}

pub fn solve(args: &SolveArgs) -> Result<ExitCode> {
    let (project, base) = read_project(&args.project)?;
    let mut ordered = ordered_frames(&project, &base)?;
    let listed = ordered.names.len();
    let mut left_out;
    (ordered.names, left_out) = frames::usable(&ordered.folder, &ordered.names);
    if let Some(first) = ordered.names.first() {
        let [w, h] = image_size(&ordered.folder.join(first), None)?.map(|v| v as usize);
        left_out.extend(ordered.masks.leave_out_misfits(&ordered.names, (w, h))?);
    }
    let OrderedFrames { folder, masks, names, rows } = &ordered;
    left_out.iter().for_each(|note| eprintln!("warning: {note}"));
    if names.len() < 2 {
        bail!("{}: {} of {listed} frames can be used; two or more are needed", folder.display(), names.len());
    }
    std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, "create", e))?;
    let out = absolute(&args.output)?;

    let (Some(gcps), Some(points)) = (&project.gcps, point_args(&project, &base)) else {
        bail!("{}: no [gcps]: the block cannot be placed; name a list", args.project.display())
    };
    let flight = Flight {
        project: &project,
        folder,
        masks,
        out: &out,
        ordered: names.iter().map(String::as_str).collect(),
        size_px: image_size(&folder.join(&names[0]), None)?,
        anew: args.overwrite,
        engine: match args.engine {
            Engine::Pycolmap => Program::Pycolmap,
            Engine::Colmap | Engine::Micmac => Program::Colmap,
        },
        near: Vec::new(),
    };
    let plane = ground_plane(&project, &points, rows, &flight);
    let (lines, near) = runs::lines_and_pairs(&project, &flight.ordered, rows, plane.as_ref().map(|p| (p, &flight)));
    let flight = Flight { near, ..flight };
    let (model, pairs) = match args.engine {
        Engine::Colmap | Engine::Pycolmap => by_colmap(&flight, plane.as_ref(), &points)?,
        Engine::Micmac => (micmac::oriented(&args.project, (&project, &base), &ordered, &out)?, None),
    };
    let mut control = points.load(Some(&model))?;
    for p in &mut control.points {
        p.sigma.get_or_insert([gcps.sigma_ground_m; 3]);
    }
    let notes = control.notes(&model, &points, &out.join("sparse"))?;
    let world = control.world()?;
    let ground = control.in_world(&world, &model, &points)?;
    let rough = match args.engine {
        Engine::Colmap | Engine::Pycolmap => table_poses(&project, rows, &model, &world),
        Engine::Micmac => micmac::held(&model, &world),
    };
    let free = match args.engine {
        Engine::Colmap | Engine::Pycolmap => interior(&project.adjust.free)?,
        // Compensated with the poses.
        Engine::Micmac => Vec::new(),
    };
    let options =
        AdjustOptions { sigma_image_px: gcps.sigma_image_px, interior: free, rough, ..AdjustOptions::default() };
    let mut found = adjust(&model, &ground, &options)?;
    found.notes.extend(notes);
    found.notes.extend(left_out);
    if args.engine == Engine::Micmac {
        found.notes.push(micmac::note());
    }
    let lost = names.iter().filter(|n| model.find(n).is_none()).map(|n| format!("{n}: not registered"));
    found.notes.extend(lost);
    let mut document = document::adjustment(&found, &model, &world, listed, control.crs_label());
    if let Some(pairs) = pairs {
        document["pairs"] = pairs;
    }
    document["lines"] = runs::document(&lines, &flight.ordered, &document);
    if project.rough.is_some() {
        document["rough_differences"] = footprints::rough_differences(&found, &model, rows, &world);
    }
    let ground = footprints::footprints(&found, &model, &world, control.crs.as_ref());
    autoref_raster::atomic::write(&out.join("footprints.geojson"), (ground.to_string() + "\n").as_bytes())?;
    let title = args.project.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    autoref_raster::atomic::write(&out.join("flight.html"), page::page(&document, &title).as_bytes())?;
    let text = serde_json::to_string_pretty(&document)? + "\n";
    autoref_raster::atomic::write(&out.join("cameras.json"), text.as_bytes())?;
    if args.json {
        print!("{text}");
    } else {
        document::say(&document);
        println!("{}", out.join("cameras.json").display());
    }
    Ok(ExitCode::SUCCESS)
}

/// Ties, relative orientation, and the ties of each pair, by COLMAP and the rough table.
fn by_colmap(
    flight: &Flight<'_>,
    plane: Option<&GroundPlane>,
    points: &lists::PointArgs,
) -> Result<(Reconstruction, Option<serde_json::Value>)> {
    let tied = match plane {
        Some(plane) => {
            let control = points.load(None)?;
            let ground = control.in_world(&control.world()?, &flight.listed(plane), points)?;
            flight.tied(plane, &ground)?
        }
        None => None,
    };
    let pairs = plane.zip(tied.as_ref()).map(|(plane, tied)| tied.ties.statistics(&plane.views));
    Ok((flight.relative(tied)?, pairs))
}

/// What the rough table says of each photograph of a model, in the world's frame.
fn table_poses(
    project: &Project,
    rows: &[tables::CameraRow],
    model: &Reconstruction,
    world: &World,
) -> Vec<Option<RoughPose>> {
    let mut rough: Vec<Option<RoughPose>> = vec![None; model.photographs.len()];
    if let Some(r) = &project.rough {
        for row in rows {
            // A table without pitch says where, not how far down: its positions count alone.
            let (Some(i), Some(pose)) = (model.find(&row.name), row.pose(Some(0.0))) else { continue };
            let stated = row.pose(None).is_some();
            rough[i] = world.pose_to_world(&pose).map(|pose| RoughPose {
                pose,
                sigma_m: Vector3::repeat(r.sigma_m),
                sigma_rad: if stated { 2f64.to_radians() } else { f64::INFINITY },
            });
        }
    }
    rough
}

/// What warps neighbours onto each other; `None` when focal length, a place or a direction is not known.
fn ground_plane(
    project: &Project,
    points: &lists::PointArgs,
    rows: &[tables::CameraRow],
    flight: &Flight<'_>,
) -> Option<GroundPlane> {
    let (table, f_px) = (project.rough.as_ref()?, project.camera.f_px?);
    let control = points.load(None).ok()?;
    let world = control.world().ok()?;
    let mut heights: Vec<f64> = control.points.iter().map(|p| p.xyz[2]).collect();
    heights.sort_by(f64::total_cmp);
    let height = table.ground_m.or_else(|| heights.get(heights.len() / 2).copied())?;
    let first = control.points.first()?.xyz;
    let ground_m = world.to_world([first[0], first[1], height])?.z;
    let names = &flight.ordered;
    let stated = runs::rows_of(names, rows).into_iter().map(|row| {
        let row = row?;
        // A pitch that is one for all frames is less sure than what a table says of each.
        let sigma_deg: f64 = if row.pose(None).is_some() { 2.0 } else { 5.0 };
        Some(RoughPose {
            pose: world.pose_to_world(&row.pose(table.pitch_deg)?)?,
            sigma_m: Vector3::repeat(table.sigma_m),
            sigma_rad: sigma_deg.to_radians(),
        })
    });
    let rough = runs::filled(&stated.collect::<Vec<_>>())?;
    Some(GroundPlane::of_table(names, rough, f_px, ground_m, flight.size_px))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every key of the documented example is one that is read, and every default that it shows is the program's.
    #[test]
    fn the_documented_project_is_read() {
        let page = include_str!("../../../../../docs/flight.md");
        let example = page.split("```toml").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
        let project: Project = toml::from_str(example).expect("the example is a project");
        let (pairs, adjust) = (Pairs::default(), Adjust::default());
        assert_eq!((project.pairs.neighbours, project.pairs.across), (pairs.neighbours, pairs.across));
        assert_eq!((project.adjust.features, project.adjust.seed), (adjust.features, adjust.seed));
        let gcps = project.gcps.as_ref().expect("it has GCPs");
        assert_eq!((gcps.sigma_ground_m, gcps.sigma_image_px), (default_ground_m(), default_image_px()));
        let shown: toml::Table = toml::from_str(example).expect("TOML");
        let whole: toml::Table = toml::from_str(&toml::to_string(&project).expect("TOML")).expect("TOML");
        for (part, keys) in whole.iter().filter_map(|(part, keys)| Some((part, keys.as_table()?))) {
            for key in keys.keys() {
                assert!(shown[part].get(key).is_some(), "{part}.{key} is not documented");
            }
        }
    }
}
