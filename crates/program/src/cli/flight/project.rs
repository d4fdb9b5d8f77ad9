//! FLIGHT.toml, and the chain that it describes: features, matches, relative orientation (COLMAP), adjustment.

use autoref_raster::atomic::Existing;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::{Context, Result, bail};
use autoref_flight::Error;
use autoref_flight::adjust::{AdjustOptions, RoughPose, adjust};
use autoref_flight::read::{self, colmap, same_image, tables};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::{check_output, document, image_size, interior, lists};

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
struct Project {
    /// CRS of table and GCPs: an EPSG code, WKT, PROJ string, or `local`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    crs: Option<String>,
    frames: Frames,
    #[serde(default)]
    camera: CameraPart,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rough: Option<Rough>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    gcps: Option<Gcps>,
    #[serde(default)]
    pairs: Pairs,
    #[serde(default)]
    adjust: Adjust,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Frames {
    folder: PathBuf,
    /// Names with `*`.
    pattern: Vec<String>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraPart {
    #[serde(default, skip_serializing_if = "Option::is_none")]
    f_px: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pp_px: Option<[f64; 2]>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rough {
    table: PathBuf,
    #[serde(default = "default_rough_m")]
    sigma_m: f64,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Gcps {
    list: PathBuf,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    observations: Option<PathBuf>,
    /// 1σ on the ground; a list that states its own has the last word.
    #[serde(default = "default_ground_m")]
    sigma_ground_m: f64,
    #[serde(default = "default_image_px")]
    sigma_image_px: f64,
    /// Points kept out of the fit.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    check: Vec<String>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Pairs {
    /// Frames to each side along the order of the names (or of the table).
    neighbours: usize,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Adjust {
    /// Interior parameters that are adjusted; `f=20` within 20 px.
    free: Vec<String>,
    features: usize,
    seed: u32,
}

impl Default for Pairs {
    fn default() -> Self {
        Pairs { neighbours: 3 }
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
        .filter(|n| patterns.iter().any(|p| matches_pattern(n, p)))
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
        camera: CameraPart { f_px: args.f_px, pp_px: args.pp_px.as_ref().map(|p| [p[0], p[1]]) },
        rough: match &args.cameras {
            Some(t) => Some(Rough { table: absolute(t)?, sigma_m: default_rough_m() }),
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

/// FNV-1a over everything that a stage depends on.
struct Hash(u64);

impl Hash {
    fn new(word: &str) -> Self {
        let mut h = Hash(0xcbf2_9ce4_8422_2325);
        h.bytes(word.as_bytes());
        h
    }
    fn bytes(&mut self, bytes: &[u8]) {
        for b in bytes {
            self.0 = (self.0 ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    fn file(&mut self, path: &Path) -> Result<()> {
        let bytes = std::fs::read(path).map_err(|e| Error::io(path, "read", e))?;
        self.bytes(&bytes);
        Ok(())
    }
    fn hex(&self) -> String {
        format!("{:016x}", self.0)
    }
}

/// A stage of COLMAP: done when its stamp bears the hash of its inputs.
struct Stages<'a> {
    folder: &'a Path,
    anew: bool,
}

impl Stages<'_> {
    /// Runs `work` towards `NAME.part`, which becomes `NAME` when it succeeds.
    fn run(&self, name: &str, hash: &str, work: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
        let (target, stamp) = (self.folder.join(name), self.folder.join(format!("{name}.stamp")));
        if !self.anew && target.exists() && std::fs::read_to_string(&stamp).is_ok_and(|s| s.trim() == hash) {
            eprintln!("{name}: taken from before");
            return Ok(target);
        }
        let part = self.folder.join(format!("{name}.part"));
        for old in [&part, &target, &stamp] {
            let gone = if old.is_dir() { std::fs::remove_dir_all(old) } else { std::fs::remove_file(old) };
            if let Err(e) = gone
                && e.kind() != std::io::ErrorKind::NotFound
            {
                return Err(Error::io(old, "remove", e).into());
            }
        }
        eprintln!("{name} …");
        work(&part)?;
        std::fs::rename(&part, &target).map_err(|e| Error::io(&part, "rename", e))?;
        autoref_raster::atomic::write(&stamp, hash.as_bytes())?;
        Ok(target)
    }
}

fn no_pair() -> Error {
    Error::no_result(
        "COLMAP found no two frames that fit together",
        "check the focal length and the neighbours, or raise adjust.features",
    )
}

fn says(log: &Path, words: &str) -> bool {
    std::fs::read(log).is_ok_and(|text| String::from_utf8_lossy(&text).contains(words))
}

fn colmap_run(log: &Path, arguments: &[(&str, String)], command: &str) -> Result<()> {
    let file = std::fs::File::create(log).map_err(|e| Error::io(log, "create", e))?;
    let twin = file.try_clone().map_err(|e| Error::io(log, "write", e))?;
    let mut run = Command::new("colmap");
    run.arg(command).env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null()).stdout(file).stderr(twin);
    for (key, value) in arguments {
        run.arg(format!("--{key}")).arg(value);
    }
    match run.status() {
        Ok(status) if status.success() => Ok(()),
        // It says so and fails when no two frames fit together.
        Ok(status) if status.code() == Some(1) && says(log, "failed to create") => Err(no_pair().into()),
        Ok(status) => bail!(
            "colmap {command} ended with {status}; {} has its words; run the command again to resume",
            log.display()
        ),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            bail!(
                "`colmap` is not there; install it (Debian, Ubuntu: apt-get install colmap) and run the command again"
            )
        }
        Err(e) => bail!("colmap cannot be run: {e}"),
    }
}

pub fn solve(args: &SolveArgs) -> Result<ExitCode> {
    let text = std::fs::read_to_string(&args.project).map_err(|e| Error::io(&args.project, "read", e))?;
    let project: Project = toml::from_str(&text)
        .map_err(|e| Error::format(&args.project, "the file", e.to_string().trim().replace('\n', " ")))?;
    let base = args.project.parent().unwrap_or(Path::new("."));
    let folder = absolute(&base.join(&project.frames.folder))?;
    let names = frames(&folder, &project.frames.pattern)?;
    if names.len() < 2 {
        bail!("{}: {} frames match; two or more are needed", folder.display(), names.len());
    }
    std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, "create", e))?;
    let out = absolute(&args.output)?;
    // The order of the table is that of the flight, else the names are.
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

    let model = relative(&project, args, &folder, &out, &names, &order)?;
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
    let document = document::adjustment(&found, &model, &world, names.len(), control.crs_label());
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

/// Features, matches and relative orientation by COLMAP, each kept.
fn relative(
    project: &Project,
    args: &SolveArgs,
    folder: &Path,
    out: &Path,
    names: &[String],
    order: &[usize],
) -> Result<read::Reconstruction> {
    let stages = Stages { folder: out, anew: args.overwrite };
    let size = image_size(&folder.join(&names[0]), None)?;
    let pp = project.camera.pp_px.unwrap_or([size[0] / 2.0, size[1] / 2.0]);
    // One thread throughout: with more, the order of images and of random draws differs from run to run.
    let list = out.join("frames.txt");
    let ordered: Vec<&str> = order.iter().map(|i| names[*i].as_str()).collect();
    autoref_raster::atomic::write(&list, (ordered.join("\n") + "\n").as_bytes())?;

    let mut hash = Hash::new(&format!("{:?} {} {ordered:?}", project.camera, project.adjust.features));
    for name in names {
        hash.file(&folder.join(name))?;
    }
    let text = |p: &Path| p.display().to_string();
    let features = stages.run("features.db", &hash.hex(), |part| {
        let mut a = vec![
            ("database_path", text(part)),
            ("image_path", text(folder)),
            ("image_list_path", text(&list)),
            ("ImageReader.single_camera", "1".into()),
            ("ImageReader.camera_model", "SIMPLE_RADIAL".into()),
            ("SiftExtraction.use_gpu", "0".into()),
            ("SiftExtraction.num_threads", "1".into()),
            ("SiftExtraction.max_num_features", project.adjust.features.to_string()),
        ];
        if let Some(f) = project.camera.f_px {
            a.push(("ImageReader.camera_params", format!("{f},{},{},0", pp[0], pp[1])));
        }
        colmap_run(&out.join("features.log"), &a, "feature_extractor")
    })?;

    let mut pairs = String::new();
    for (i, a) in ordered.iter().enumerate() {
        for b in ordered.iter().skip(i + 1).take(project.pairs.neighbours) {
            pairs += &format!("{a} {b}\n");
        }
    }
    let pair_list = out.join("pairs.txt");
    autoref_raster::atomic::write(&pair_list, pairs.as_bytes())?;
    hash.bytes(pairs.as_bytes());
    let matches = stages.run("matches.db", &hash.hex(), |part| {
        std::fs::copy(&features, part).map_err(|e| Error::io(&features, "copy", e))?;
        let a = [
            ("database_path", text(part)),
            ("match_list_path", text(&pair_list)),
            ("match_type", "pairs".into()),
            ("SiftMatching.use_gpu", "0".into()),
            ("SiftMatching.num_threads", "1".into()),
        ];
        colmap_run(&out.join("matches.log"), &a, "matches_importer")
    })?;

    let held = if project.camera.f_px.is_some() { "0" } else { "1" };
    hash.bytes(&project.adjust.seed.to_le_bytes());
    let sparse = stages.run("sparse", &hash.hex(), |part| {
        std::fs::create_dir_all(part).map_err(|e| Error::io(part, "create", e))?;
        let a = [
            ("database_path", text(&matches)),
            ("image_path", text(folder)),
            ("output_path", text(part)),
            ("random_seed", project.adjust.seed.to_string()),
            // More threads change the order of sums, and so the last digits.
            ("Mapper.num_threads", "1".into()),
            ("Mapper.ba_refine_focal_length", held.into()),
            ("Mapper.ba_refine_principal_point", "0".into()),
        ];
        colmap_run(&out.join("mapper.log"), &a, "mapper")
    })?;
    let best = colmap::model_folder(&sparse).ok_or_else(no_pair)?;
    colmap::read(&best).context("COLMAP's model")
}
