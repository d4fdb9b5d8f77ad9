//! `autoref-stream cloud clean`: the chain of steps, in the order in which they are written.

mod reports;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, bail};
use autoref_cloud::clean::{self, CleanReport, Invalid, Plan, Step};
use autoref_cloud::crop::{Crop, Polygon, Ring};
use autoref_cloud::{io, isolated, page, params, smrf};
use autoref_raster::atomic::{self, Existing, Transaction};
use autoref_raster::crs::Crs;
use autoref_raster::error::Error;
use autoref_raster::fingerprint::Fingerprint;
use autoref_raster::output_folder::OutputFolder;
use clap::Args;
use serde_json::Value;

use super::cloud_cameras::Cameras;
use super::cloud_means::{Begun, MeansArgs};
use autoref_cloud::io::stem;
use reports::{Identity, Parameters, WrittenReport, beside, document, finished, print};

/// Classify noise and ground, step by step in the order written; every step is done only when it is asked for.
///
/// Noise gets class 7, ground class 2, what is neither class 1; points are removed only by --drop. Beside each output
/// NAME.clean.json and NAME.clean.html say what every step took.
#[derive(Args, Debug)]
#[command(
    after_help = "Example, as in the thesis of 2017:\n  autoref-stream cloud clean S36_3292.ply -o clean/S36_3292.laz --shift 600000,8600000,0 \\\n    --z -50,716 --range-from cameras.csv --outliers k=8,m=2 --ground --drop noise,object\n\nExit codes: 0 done, 2 error."
)]
pub struct CleanArgs {
    /// The clouds; each is cleaned alone.
    #[arg(required = true, value_name = "IN")]
    clouds: Vec<PathBuf>,
    /// Output: a .laz, .copc.laz, .las or .ply file, or a folder (always for several clouds), which then gets NAME.laz.
    #[arg(short, long = "out", value_name = "OUT")]
    output: PathBuf,
    /// In a folder: write NAME.copc.laz, LAZ with an octree that viewers load piece by piece.
    #[arg(long)]
    copc: bool,

    /// Keep heights from MIN to MAX.
    #[arg(long, value_name = "MIN,MAX", allow_hyphen_values = true, help_heading = "Steps")]
    z: Vec<String>,
    /// Keep points nearer to the camera than its height over z = 0 divided by the sine of the elevation angle. A place
    /// in map coordinates, a table with the columns cloud,E,N,H, or a MicMac orientation.
    #[arg(long, value_name = "E,N,H|FILE", allow_hyphen_values = true, help_heading = "Steps")]
    range_from: Vec<String>,
    /// Smallest angle under which the camera may see a point at z = 0, degrees.
    #[arg(long, value_name = "DEG", default_value_t = 10.0, requires = "range_from", help_heading = "Steps")]
    elevation_angle: f64,
    /// Keep points inside the polygons of a vector file, which are brought into the clouds' reference system.
    #[arg(long, value_name = "FILE", help_heading = "Steps")]
    crop: Vec<String>,
    /// Statistical outliers: mean distance to the k nearest at or above mean + m standard deviations.
    #[arg(long, value_name = "k=8,m=2", num_args = 0..=1, default_missing_value = "", help_heading = "Steps")]
    outliers: Vec<String>,
    /// Radius outliers: fewer than min others nearer than r metres.
    #[arg(long, value_name = "r=1,min=2", num_args = 0..=1, default_missing_value = "", help_heading = "Steps")]
    radius: Vec<String>,
    /// Low points by the extended local minimum: `elm`, or cell=10,threshold=1 (metres).
    #[arg(long, value_name = "elm|cell=10,threshold=1", num_args = 0..=1, default_missing_value = "elm", help_heading = "Steps")]
    low: Vec<String>,
    /// Points alone below the local lower envelope or in isolated clusters: radius of the neighbourhood in metres (0:
    /// from the density), how low and alone they must be, most points of a cluster.
    #[arg(long, value_name = "r=0,m=0.35,min=5", num_args = 0..=1, default_missing_value = "", help_heading = "Steps")]
    isolated: Vec<String>,
    /// Ground by SMRF; lengths in metres, slopes as rise over run.
    #[arg(
        long,
        value_name = "cell=2,slope=0.45,window=6,threshold=0.10,scaling=3.80,low_slope=500,net=0",
        num_args = 0..=1,
        default_missing_value = "",
        help_heading = "Steps"
    )]
    ground: Vec<String>,

    /// Leave classes out of the output: noise (what the steps before --ground found), object (what --ground found not
    /// to be ground).
    #[arg(long, value_name = "noise,object", value_delimiter = ',', help_heading = "Writing")]
    drop: Vec<String>,
    /// Leave points out whose coordinates are not finite, instead of refusing the cloud.
    #[arg(long, help_heading = "Reading")]
    skip_invalid: bool,
    /// Keep what an interrupted run of the same command has finished.
    #[arg(long, help_heading = "Writing")]
    resume: bool,
    /// Write no NAME.clean.html.
    #[arg(long, help_heading = "Writing")]
    no_report: bool,
    /// Points of a tile at most; results do not depend on it. Default: what the memory allows.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=1_000_000_000), help_heading = "Resources")]
    tile: Option<u64>,
    #[command(flatten)]
    means: MeansArgs,
}

/// A step as written; ranges need the cloud's camera.
enum Written {
    Step(Step),
    Range(Cameras),
}

impl CleanArgs {
    /// Refuses classes that no step finds.
    fn check_drop(&self) -> anyhow::Result<()> {
        let asks = |class: &str| self.drop.iter().any(|name| name.trim() == class);
        let of_noise = [&self.z, &self.range_from, &self.crop, &self.outliers, &self.radius, &self.low, &self.isolated];
        if asks("noise") && of_noise.iter().all(|step| step.is_empty()) {
            bail!(
                "--drop noise has no effect: no step finds noise, and points that the cloud itself calls noise stay; add a \
                 step such as --outliers, or leave noise out of --drop"
            );
        }
        if asks("object") && self.ground.is_empty() {
            bail!(
                "--drop object has no effect where --ground is not given; give --ground, or leave object out of --drop"
            );
        }
        Ok(())
    }

    /// Names and values of the steps in the order of the command line.
    fn in_order(&self) -> Vec<(&'static str, String)> {
        // The parser has the places of the values; the derived struct does not.
        let matches = super::everywhere::command().get_matches();
        let clean = matches.subcommand_matches("cloud").and_then(|cloud| cloud.subcommand_matches("clean"));
        let lists: [(&'static str, &[String]); 8] = [
            ("z", &self.z),
            ("range_from", &self.range_from),
            ("crop", &self.crop),
            ("outliers", &self.outliers),
            ("radius", &self.radius),
            ("low", &self.low),
            ("isolated", &self.isolated),
            ("ground", &self.ground),
        ];
        let mut steps = Vec::new();
        for (name, values) in lists {
            let places: Vec<usize> =
                clean.and_then(|clean| clean.indices_of(name)).map_or_else(Vec::new, Iterator::collect);
            for (at, value) in values.iter().enumerate() {
                steps.push((places.get(at).copied().unwrap_or(usize::MAX), name, value.clone()));
            }
        }
        steps.sort_by_key(|(place, _, _)| *place);
        steps.into_iter().map(|(_, name, value)| (name, value)).collect()
    }

    /// The steps as written; polygons are brought into `crs`, that of the clouds.
    fn steps(&self, crs: Option<&Crs>) -> anyhow::Result<Vec<Written>> {
        self.in_order().into_iter().map(|(name, value)| self.step(name, &value, crs)).collect()
    }

    fn step(&self, name: &str, value: &str, crs: Option<&Crs>) -> anyhow::Result<Written> {
        let step = match name {
            "z" => {
                let [min_m, max_m] = params::numbers("--z", value, "MIN,MAX")?;
                if min_m > max_m {
                    bail!("--z: {min_m} is above {max_m}; write --z MIN,MAX");
                }
                Step::Crop(Crop::Height { min_m, max_m })
            }
            "range_from" => return Ok(Written::Range(Cameras::read(value)?)),
            "crop" => Step::Crop(Crop::Polygon(polygons(Path::new(value), crs)?)),
            "outliers" => {
                let [k, m] = params::read("--outliers", value, [("k", 8.0), ("m", 2.0)])?;
                let neighbours = params::whole("--outliers", "k", k, 1)?;
                if neighbours > 1000 {
                    bail!("--outliers: k is {k}; give at most 1000");
                }
                Step::Outliers { neighbours, multiplier: m }
            }
            "radius" => {
                let [r, min] = params::read("--radius", value, [("r", 1.0), ("min", 2.0)])?;
                let least = params::whole("--radius", "min", min, 1)?;
                if least > 1000 {
                    bail!("--radius: min is {min}; give at most 1000");
                }
                Step::Radius { radius_m: params::positive("--radius", "r", r)?, least }
            }
            "low" => {
                let value = if value == "elm" { "" } else { value };
                let [cell, gap] = params::read("--low", value, [("cell", 10.0), ("threshold", 1.0)])?;
                Step::Low {
                    cell_m: params::positive("--low", "cell", cell)?,
                    gap_m: params::positive("--low", "threshold", gap)?,
                }
            }
            "isolated" => Step::Isolated(isolated::Options::read(value)?),
            _ => Step::Ground(smrf::Options::read(value)?),
        };
        Ok(Written::Step(step))
    }

    /// Where each cloud goes, and the folder that was made for them.
    fn targets(&self) -> anyhow::Result<(Vec<PathBuf>, Option<OutputFolder>)> {
        let named = io::format_of(&self.output).is_ok() && !self.output.is_dir();
        if named && self.clouds.len() == 1 {
            if self.copc && io::format_of(&self.output)? != io::Format::Copc {
                bail!("--copc: name the output .copc.laz, not {}", self.output.display());
            }
            return Ok((vec![self.output.clone()], None));
        }
        let extension = self.output.extension();
        if named || (extension.is_some() && !self.output.is_dir()) {
            // A folder may have a dot in its name, but not the extension of a cloud.
            io::format_of(&self.output)?;
            bail!("--out {}: several clouds need a folder", self.output.display());
        }
        let folder = OutputFolder::make(&self.output)?;
        let end = if self.copc { "copc.laz" } else { "laz" };
        let targets: Vec<PathBuf> =
            self.clouds.iter().map(|cloud| self.output.join(format!("{}.{end}", stem(cloud)))).collect();
        for (index, target) in targets.iter().enumerate() {
            if let Some(other) = targets[..index].iter().position(|other| other == target) {
                let (a, b) = (&self.clouds[other], &self.clouds[index]);
                bail!(
                    "{} and {} would both become {}; clean them one by one",
                    a.display(),
                    b.display(),
                    target.display()
                );
            }
        }
        Ok((targets, Some(folder)))
    }
}

pub fn run(args: &CleanArgs) -> anyhow::Result<ExitCode> {
    for name in &args.drop {
        if !["noise", "object"].contains(&name.trim()) {
            bail!("--drop: `{name}` is no class; choose among noise and object");
        }
    }
    args.check_drop()?;
    let Begun { asked, of_clouds } = args.means.begin(&args.clouds)?;
    let written = args.steps(of_clouds.as_ref())?;
    let (targets, _folder) = args.targets()?;
    let mut plan = Plan {
        steps: Vec::new(),
        drop_noise: args.drop.iter().any(|name| name.trim() == "noise"),
        drop_objects: args.drop.iter().any(|name| name.trim() == "object"),
        shift: args.means.shift()?,
        invalid: if args.skip_invalid { Invalid::LeaveOut } else { Invalid::Refuse },
        memory_bytes: args.means.memory.0,
        tile_points: args.tile.map(|points| points as usize),
        scratch: PathBuf::new(),
        crs_wkt: asked.map(|crs| crs.wkt().to_string()),
    };
    let parameters = Parameters {
        steps: args.in_order(),
        elevation_angle: args.elevation_angle,
        drop: args.drop.clone(),
        shift: plan.shift,
        crs: args.means.crs.clone(),
        skip_invalid: args.skip_invalid,
    };
    let mut todo = Vec::new();
    for (cloud, target) in args.clouds.iter().zip(&targets) {
        let steps = steps_of(cloud, &written, args.elevation_angle)?;
        let identity = Identity::of(cloud, &parameters, &steps)?;
        let done = if args.resume { finished(target, &identity)? } else { None };
        if done.is_none() {
            let same = std::fs::canonicalize(target).ok().zip(std::fs::canonicalize(cloud).ok());
            if same.is_some_and(|(a, b)| a == b) {
                bail!("{}: the output is the input; name another", target.display());
            }
            let page = beside(target, "html");
            let mut outputs = vec![target.as_path()];
            let report = beside(target, "json");
            outputs.push(&report);
            if !args.no_report {
                outputs.push(&page);
            }
            atomic::check_outputs(&outputs, Existing::of_flag(args.means.overwrite))?;
        }
        todo.push((cloud, target, steps, identity, done));
    }
    let mut reports = Vec::new();
    for (cloud, target, steps, identity, done) in todo {
        if let Some(report) = done {
            if !args.means.json {
                println!("{}: unchanged, kept {}", cloud.display(), target.display());
            }
            reports.push(report);
            continue;
        }
        plan.steps = steps;
        let folder = target.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        plan.scratch = args.means.scratch.clone().unwrap_or_else(|| folder.to_path_buf());
        let (report, written) = one(cloud, target, &plan, &identity, args)?;
        if !args.means.json {
            print(&report);
        }
        reports.push(written);
    }
    if args.means.json {
        println!("{}", serde_json::to_string_pretty(&document(reports))?);
    }
    Ok(ExitCode::SUCCESS)
}

/// The steps for one cloud; ranges are from its own camera.
fn steps_of(cloud: &Path, written: &[Written], elevation_angle: f64) -> anyhow::Result<Vec<Step>> {
    let step = |step: &Written| {
        Ok(match step {
            Written::Step(step) => step.clone(),
            Written::Range(cameras) => Step::Crop(Crop::range(cameras.of(cloud)?, elevation_angle)?),
        })
    };
    written.iter().map(step).collect()
}

/// Cleans a cloud: what became of it, and the report as it is written beside the output.
fn one(
    cloud: &Path,
    target: &Path,
    plan: &Plan,
    identity: &Identity,
    args: &CleanArgs,
) -> anyhow::Result<(CleanReport, Value)> {
    let mut outputs = Transaction::new();
    let (mut report, mut output_bytes, mut content): (Option<CleanReport>, u64, _) = (None, 0, Fingerprint::default());
    outputs.stage(target, |temporary| {
        report = Some(clean::clean(cloud, temporary, target, plan)?);
        output_bytes = std::fs::metadata(temporary).map_err(|e| Error::io(target, "look at", e))?.len();
        content.file(temporary)
    })?;
    let report = report.context("the cloud was cleaned")?;
    let mut files_written = vec![target.to_path_buf(), beside(target, "json")];
    if !args.no_report {
        outputs.stage_bytes(&beside(target, "html"), page::page(&report).as_bytes())?;
        files_written.push(beside(target, "html"));
    }
    let written = serde_json::to_value(WrittenReport {
        report: &report,
        identity,
        files_written: files_written.iter().map(|path| path.to_string_lossy().into_owned()).collect(),
        output_bytes,
        output_fingerprint: content.hex(),
    })?;
    outputs.stage_bytes(&beside(target, "json"), serde_json::to_string_pretty(&written)?.as_bytes())?;
    outputs.commit()?;
    Ok((report, written))
}

/// All polygons of a vector file, in the reference system of the clouds.
fn polygons(path: &Path, crs: Option<&Crs>) -> anyhow::Result<Polygon> {
    if !path.exists() {
        bail!("--crop {}: there is no such file", path.display());
    }
    let areas = autoref_elevation::files::read_polygons(path, crs.map_or("", Crs::wkt)).map_err(|e| match e {
        Error::Gdal { .. } => anyhow::anyhow!(
            "--crop {}: GDAL knows no vector file in it; give GeoPackage, GeoJSON or a shapefile",
            path.display()
        ),
        other => anyhow::Error::from(other).context("--crop"),
    })?;
    let corners = |ring: Vec<(f64, f64)>| -> Ring { ring.into_iter().map(|(x, y)| [x, y]).collect() };
    let polygons = areas.into_iter().flat_map(|(_, polygons)| polygons);
    Ok(Polygon::new(polygons.map(|rings| rings.into_iter().map(corners).collect()).collect()))
}
