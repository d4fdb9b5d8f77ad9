//! FLIGHT.toml, and the chain that it describes: features, matches, relative orientation (COLMAP), adjustment.

use autoref_raster::atomic::Existing;
use autoref_raster::bounded;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::Error;
use autoref_flight::adjust::{AdjustOptions, RoughPose, adjust};
use autoref_flight::read::{same_image, tables};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::relative::{Flight, GroundPlane};
use super::{check_output, document, footprints, image_size, interior, lists, page, runs, views};

/// Write FLIGHT.toml from a folder of frames, a rough camera table and a list of GCPs.
#[derive(Debug, clap::Args)]
pub struct InitArgs {
    /// The folder of the frames.
    folder: PathBuf,
    /// Rough camera table: name, x, y, z and yaw (or omega, phi, kappa).
    #[arg(long, value_name = "TABLE")]
    cameras: Option<PathBuf>,
    /// GCPs.
    #[arg(long, value_name = "LIST")]
    gcps: Option<PathBuf>,
    /// Where the GCPs were seen, when the list does not say.
    #[arg(long, value_name = "FILE")]
    observations: Option<PathBuf>,
    /// CRS of table and list; `local` for metric coordinates on a plane.
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// Focal length in pixels.
    #[arg(long, value_name = "PX")]
    f_px: Option<f64>,
    /// Principal point. Default: the image's centre.
    #[arg(long, value_name = "X,Y", value_delimiter = ',')]
    pp_px: Option<Vec<f64>>,
    /// The project file.
    #[arg(short, long, value_name = "TOML")]
    output: PathBuf,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
}

/// Solve a flight: cameras.json with positions, directions, interior, residuals and check points.
#[derive(Debug, clap::Args)]
pub struct SolveArgs {
    /// The project file.
    project: PathBuf,
    /// The folder of the results; stages whose inputs have not changed are taken from it.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Work every stage anew.
    #[arg(long)]
    overwrite: bool,
    /// Print cameras.json on standard output.
    #[arg(long)]
    pub(super) json: bool,
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

fn default_rough_m() -> f64 {
    200.0
}
fn default_ground_m() -> f64 {
    25.0
}
fn default_image_px() -> f64 {
    5.0
}

const IMAGES: [&str; 6] = ["tif", "tiff", "png", "jpg", "jpeg", "jp2"];

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

fn frames(folder: &Path, patterns: &[String]) -> Result<Vec<String>> {
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

fn absolute(path: &Path) -> Result<PathBuf> {
    std::fs::canonicalize(path).map_err(|e| Error::io(path, "find", e).into())
}

pub fn init(args: &InitArgs) -> Result<ExitCode> {
    if args.pp_px.as_ref().is_some_and(|p| p.len() != 2) {
        bail!("--pp-px: 2 numbers with a comma between them are expected");
    }
    check_output(Some(&args.output), Existing::of_flag(args.overwrite))?;
    let folder = absolute(&args.folder)?;
    let all = frames(&folder, &["*".into()])?;
    let extension = |n: &str| n.rsplit_once('.').map(|(_, e)| e.to_lowercase());
    let mut pattern: Vec<String> = all
        .iter()
        .filter(|n| extension(n).is_some_and(|e| IMAGES.contains(&e.as_str())))
        .filter_map(|n| n.rsplit_once('.').map(|(_, e)| format!("*.{e}")))
        .collect();
    pattern.sort();
    pattern.dedup();
    let names = frames(&folder, &pattern)?;
    if names.is_empty() {
        bail!("{}: there are no frames ({})", folder.display(), IMAGES.join(", "));
    }
    if let Some(table) = &args.cameras {
        let rows = tables::cameras(table)?;
        let known = rows.iter().filter(|r| same_image(&r.name, names.iter().map(String::as_str)).is_some()).count();
        if known == 0 {
            bail!("{}: none of its {} names is a frame of {}", table.display(), rows.len(), folder.display());
        }
        eprintln!("{known} of {} rows of the table are frames", rows.len());
    }
    if let Some(list) = &args.gcps
        && !list.is_file()
    {
        bail!("{}: is not there", list.display());
    }
    let project = Project {
        crs: args.crs.clone(),
        frames: Frames { folder, pattern },
        masks: None,
        camera: CameraPart { f_px: args.f_px, pp_px: args.pp_px.as_ref().map(|p| [p[0], p[1]]) },
        rough: match &args.cameras {
            Some(t) => Some(Rough { table: absolute(t)?, sigma_m: default_rough_m(), pitch_deg: None, ground_m: None }),
            None => None,
        },
        gcps: match &args.gcps {
            Some(list) => Some(Gcps {
                list: absolute(list)?,
                observations: args.observations.as_deref().map(absolute).transpose()?,
                sigma_ground_m: default_ground_m(),
                sigma_image_px: default_image_px(),
                check: Vec::new(),
            }),
            None => None,
        },
        pairs: Pairs::default(),
        adjust: Adjust::default(),
    };
    let text = format!("# A flight of {} frames; `autoref-stream flight solve` takes it.\n", names.len())
        + &toml::to_string(&project)?;
    autoref_raster::atomic::write(&args.output, text.as_bytes())?;
    println!("{}", args.output.display());
    Ok(ExitCode::SUCCESS)
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
    let names = frames(&folder, &project.frames.pattern)?;
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
    order.extend((0..names.len()).filter(|i| !order.contains(i)).collect::<Vec<_>>());
    let names = order.into_iter().map(|i| names[i].clone()).collect();
    let part = project.masks.clone().unwrap_or_default();
    let masks = views::Masks {
        folder: part.folder.map_or(Ok(folder.clone()), |f| absolute(&base.join(f)))?,
        global: part.global.map(|f| absolute(&base.join(f))).transpose()?,
    };
    Ok(OrderedFrames { folder, masks, names, rows })
}

pub fn solve(args: &SolveArgs) -> Result<ExitCode> {
    let (project, base) = read_project(&args.project)?;
    let OrderedFrames { folder, masks, names, rows } = ordered_frames(&project, &base)?;
    std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, "create", e))?;
    let out = absolute(&args.output)?;

    let Some(gcps) = &project.gcps else {
        bail!("{}: no [gcps]: the block cannot be placed; name a list", args.project.display())
    };
    let points = lists::PointArgs {
        gcps: base.join(&gcps.list),
        observations: gcps.observations.as_ref().map(|o| base.join(o)),
        crs: project.crs.clone(),
        check: gcps.check.clone(),
        sigma_ground: None,
        sigma_image: gcps.sigma_image_px,
    };
    let flight = Flight {
        project: &project,
        folder: &folder,
        masks: &masks,
        out: &out,
        ordered: names.iter().map(String::as_str).collect(),
        size_px: image_size(&folder.join(&names[0]), None)?,
        anew: args.overwrite,
        near: Vec::new(),
    };
    let plane = ground_plane(&project, &points, &rows, &flight);
    let (lines, near) = runs::lines_and_pairs(&project, &flight.ordered, &rows, plane.as_ref().map(|p| (p, &flight)));
    let flight = Flight { near, ..flight };
    let tied = match &plane {
        Some(plane) => {
            let control = points.load(None)?;
            let ground = control.in_world(&control.world()?, &flight.listed(plane), &points)?;
            flight.tied(plane, &ground)?
        }
        None => None,
    };
    let pairs = plane.as_ref().zip(tied.as_ref()).map(|(plane, tied)| tied.ties.statistics(&plane.views));
    let model = flight.relative(tied)?;
    let mut control = points.load(Some(&model))?;
    for p in &mut control.points {
        p.sigma.get_or_insert([gcps.sigma_ground_m; 3]);
    }
    let notes = control.notes(&model, &points, &out.join("sparse"))?;
    let world = control.world()?;
    let ground = control.in_world(&world, &model, &points)?;
    let mut rough: Vec<Option<RoughPose>> = vec![None; model.photographs.len()];
    if let Some(r) = &project.rough {
        for row in &rows {
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
    let options = AdjustOptions {
        sigma_image_px: gcps.sigma_image_px,
        interior: interior(&project.adjust.free)?,
        rough,
        ..AdjustOptions::default()
    };
    let mut found = adjust(&model, &ground, &options)?;
    found.notes.extend(notes);
    let mut document = document::adjustment(&found, &model, &world, names.len(), control.crs_label());
    if let Some(pairs) = pairs {
        document["pairs"] = pairs;
    }
    document["lines"] = runs::document(&lines, &flight.ordered, &document);
    if project.rough.is_some() {
        document["rough_differences"] = footprints::rough_differences(&found, &model, &rows, &world);
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
    let mut rough = Vec::new();
    for row in runs::rows_of(names, rows) {
        let row = row?;
        // A pitch that is one for all frames is less sure than what a table says of each.
        let sigma_deg: f64 = if row.pose(None).is_some() { 2.0 } else { 5.0 };
        rough.push(RoughPose {
            pose: world.pose_to_world(&row.pose(table.pitch_deg)?)?,
            sigma_m: Vector3::repeat(table.sigma_m),
            sigma_rad: sigma_deg.to_radians(),
        });
    }
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
