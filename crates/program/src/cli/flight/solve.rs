//! `flight solve`: interior → pairs → ties → relative → gcp → cameras, stage by stage.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, bail};
use autoref_flight::Error;
use autoref_flight::adjust::{AdjustOptions, GroundPoint, RoughPose, adjust, on_ground};
use autoref_flight::read::{Reconstruction, colmap, tables};
use autoref_flight::world::World;
use autoref_raster::atomic;

use super::document::CamerasDocument;
use super::engine::Program;
use super::project::{
    OrderedFrames, Project, absolute, default_ground_m, default_image_px, ordered_frames, point_args, read_project,
};
use super::refine::refined;
use super::relative::{Flight, GroundPlane, MadeBy, Oriented};
use super::stage::Stage;
use super::stage_documents::{Found, GcpStage, InteriorStage, PairsStage, RelativeStage, TiesStage};
use super::stages::{After, Record};
use super::ties::PairTies;
use super::{
    camera_tables, footprints, frames, image_size, interior, lists, micmac, page, plausible, runs, stage_pages,
};
use crate::cli::progress::Steps;

/// σ of ties that were laid upon each other in the frames, at the least. Windows agree to some hundredths of a pixel;
/// what lens and relief make of them, in which all image points of a tie agree, is not in their residuals: taken at
/// their word, cameras of a drawn flight without grain lay 1.6 of their deviations off.
const LEAST_LAID_PX: f64 = 0.1;

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
    /// The last stage to work; the next run goes on from there.
    #[arg(long, value_enum, default_value_t = Stage::Cameras, value_name = "STAGE")]
    until: Stage,
    #[command(flatten)]
    force: plausible::ForceArgs,
    /// Work every stage anew.
    #[arg(long)]
    overwrite: bool,
    /// Print cameras.json, or what the stage of --until found, on standard output.
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

impl Engine {
    /// What runs COLMAP's commands; `None` where MicMac does it all.
    fn of_colmap(self) -> Option<Program> {
        match self {
            Engine::Colmap => Some(Program::Colmap),
            Engine::Pycolmap => Some(Program::Pycolmap),
            Engine::Micmac => None,
        }
    }
}

/// A project that can be worked: its frames are there and can be used.
struct Ready<'a> {
    args: &'a SolveArgs,
    project: Project,
    base: PathBuf,
    frames: OrderedFrames,
    colmap_folder: PathBuf,
    /// Frames that match the pattern.
    listed: usize,
    /// A line about each frame or mask that is not used.
    left_out: Vec<String>,
    out: PathBuf,
    /// Where the GCPs are; without them the positions of the table place the block.
    points: Option<lists::PointArgs>,
    /// The points, or the positions, as far as they are known without a reconstruction.
    control: Option<lists::Control>,
    record: Record,
}

pub fn solve(args: &SolveArgs) -> Result<ExitCode> {
    let ready = Ready::of(args)?;
    let found = ready.work()?;
    if args.json {
        crate::out::product(&(serde_json::to_string_pretty(&found)? + "\n"));
    } else if let Found::Cameras(document) = &found {
        document.say(&[]);
        println!("{}", ready.out.join("cameras.json").display());
    } else {
        println!("{}", ready.record.page(args.until).display());
    }
    Ok(ExitCode::SUCCESS)
}

impl<'a> Ready<'a> {
    fn of(args: &'a SolveArgs) -> Result<Self> {
        if args.until == Stage::Ties && args.engine.of_colmap().is_none() {
            bail!("MicMac makes ties and relative orientation in one run; --until relative");
        }
        let (project, base) = read_project(&args.project)?;
        let points = point_args(&project, &base);
        let mut control = match &points {
            Some(points) => points.load_first()?,
            None => None,
        };
        let mut frames = ordered_frames(&project, &base)?;
        if args.engine != Engine::Pycolmap {
            frames.refuse_blanks(&args.project, "rename the frames, or solve with --engine pycolmap")?;
        }
        let crs = frames.rows_on_map(&project, &base, control.as_ref())?;
        match (&points, &control, &project.rough) {
            (Some(points), Some(known), _) => {
                known.named_checks(points)?;
                if args.until == Stage::Cameras && known.points.iter().all(|point| point.seen.is_empty()) {
                    let why = known
                        .no_image_points
                        .as_ref()
                        .map_or(String::new(), |why| format!(" (as image points: {why})"));
                    bail!(
                        "{}: says of no point where it was seen{why}; name [gcps] observations (flight click makes them), or \
                         leave [gcps] out: a [rough] table places the block then",
                        points.gcps.display()
                    );
                }
            }
            (Some(_), None, _) => {}
            (None, ..) if args.engine == Engine::Micmac => bail!(
                "{}: no [gcps]: MicMac places a block by GCPs; name a list, or leave out --engine micmac",
                args.project.display()
            ),
            (None, _, Some(rough)) => {
                control = Some(lists::Control::of_positions(&frames.rows, crs, &base.join(&rough.table))?);
            }
            (None, _, None) => bail!(
                "{}: neither [gcps] nor [rough]: nothing places the block; name a list of GCPs or a table of positions",
                args.project.display()
            ),
        }
        // What lies outside its CRS is refused before the frames are matched.
        if let Some(known) = &control {
            known.world()?;
        }
        let names: Vec<&str> = frames.names.iter().map(String::as_str).collect();
        let lost = match &project.rough {
            Some(rough) => camera_tables::unmatched(&frames.rows, &base.join(&rough.table), &names)?,
            None => None,
        };
        let listed = frames.names.len();
        std::fs::create_dir_all(&args.output).map_err(|e| Error::io(&args.output, "create", e))?;
        let out = absolute(&args.output)?;
        let title = args.project.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let record = Record::new(&out, title, args.until)?;
        let mut left_out;
        (frames.names, left_out) =
            frames::usable(&frames.folder, &frames.names, &|name, grey| record.picture(name, grey))?;
        if let Some(first) = frames.names.first() {
            let [w, h] = image_size(&frames.folder.join(first), None)?.map(|v| v as usize);
            left_out.extend(frames.masks.leave_out_misfits(&frames.names, (w, h))?);
        }
        left_out.extend(lost);
        left_out.iter().for_each(|note| eprintln!("warning: {note}"));
        if frames.names.len() < 2 {
            bail!(
                "{}: {} of {listed} frames can be used; two or more are needed",
                frames.folder.display(),
                frames.names.len()
            );
        }
        let colmap_folder = frames::for_colmap(&frames.folder, &frames.names, &out)?;
        Ok(Ready { args, project, base, frames, colmap_folder, listed, left_out, out, points, control, record })
    }

    /// All stages up to the one asked for; what the last of them found.
    fn work(&self) -> Result<Found> {
        let (project, record) = (&self.project, &self.record);
        let OrderedFrames { folder, masks, names, rows } = &self.frames;
        let flight = Flight {
            project,
            folder,
            colmap_folder: &self.colmap_folder,
            masks,
            out: &self.out,
            ordered: names.iter().map(String::as_str).collect(),
            size_px: image_size(&folder.join(&names[0]), None)?,
            anew: self.args.overwrite,
            engine: self.args.engine.of_colmap().unwrap_or(Program::Colmap),
            near: Vec::new(),
        };
        let found = InteriorStage::of(&flight, self.listed, &self.left_out);
        let page = stage_pages::interior(&found, &record.pictures(flight.size_px));
        if record.put(Stage::Interior, &found, &page)? == After::Ends {
            return Ok(Found::Interior(found));
        }

        let plane = self.control.as_ref().and_then(|known| ground_plane(project, known, rows, &flight));
        let plan = runs::plan(project, &flight.ordered, rows, plane.as_ref().map(|p| (p, &flight)));
        let found = PairsStage::of(&plan, &flight.ordered);
        if record.put(Stage::Pairs, &found, &stage_pages::pairs(&found))? == After::Ends {
            return Ok(Found::Pairs(found));
        }
        let flight = Flight { near: plan.pairs.clone(), ..flight };

        let (oriented, ties) = match self.args.engine.of_colmap() {
            Some(_) => match self.by_colmap(&flight, plane.as_ref())? {
                ByColmap::Ends(found) => return Ok(Found::Ties(found)),
                ByColmap::Oriented(oriented, ties) => (refined(oriented, folder)?, ties),
            },
            None => {
                let model = micmac::oriented(&self.args.project, (project, &self.base), &self.frames, &self.out)?;
                (Oriented::new(model, MadeBy::Micmac), None)
            }
        };
        let found = RelativeStage::of(&oriented, &flight.ordered, self.listed);
        write_model(&self.out.join("relative"), &oriented.model)?;
        if record.put(Stage::Relative, &found, &stage_pages::relative(&found))? == After::Ends {
            return Ok(Found::Relative(found));
        }
        self.on_the_ground(&flight, &plan, &oriented, ties)
    }

    /// Ties and relative orientation by COLMAP and the rough table.
    fn by_colmap(&self, flight: &Flight<'_>, plane: Option<&GroundPlane>) -> Result<ByColmap> {
        let tied = match plane.zip(self.control.as_ref()) {
            Some((plane, control)) => {
                let listed = flight.listed(plane);
                let (ground, _) =
                    self.ground(control, &control.world_of_table(&flight.ordered, &self.frames.rows)?, &listed)?;
                flight.tied(plane, &ground)?
            }
            None => None,
        };
        let matched = flight.matched(tied)?;
        let found = TiesStage::of(&matched, &flight.ordered, flight.size_px);
        let page = stage_pages::ties(&found, &matched.verified, &self.record.pictures(flight.size_px));
        if self.record.put(Stage::Ties, &found, &page)? == After::Ends {
            return Ok(ByColmap::Ends(found));
        }
        let pairs = matched.all.as_ref().map(|ties| ties.statistics(&flight.ordered));
        let oriented = flight.relative(matched)?;
        // What warped neighbours share is nothing of a block that was made without them.
        let pairs = pairs.filter(|_| oriented.by != MadeBy::MapperOfPlainFrames);
        Ok(ByColmap::Oriented(oriented, pairs))
    }

    /// The GCPs in the world's frame, and what is to be said of them; none where positions place the block.
    fn ground(
        &self,
        control: &lists::Control,
        world: &World,
        model: &Reconstruction,
    ) -> Result<(Vec<GroundPoint>, Vec<String>)> {
        let Some(points) = &self.points else { return Ok((Vec::new(), Vec::new())) };
        let mut ground = control.in_world(world, model, points)?;
        let notes = plausible::within_frames(&mut ground, model, &points.gcps.display().to_string())?;
        Ok((ground, notes))
    }

    /// The rough table's file.
    fn table(&self) -> Option<PathBuf> {
        self.project.rough.as_ref().map(|rough| self.base.join(&rough.table))
    }

    /// The points, now that there is a reconstruction, and what is to be said of their frames.
    fn control(&self, model: &Reconstruction) -> Result<(lists::Control, Vec<String>)> {
        let Some(points) = &self.points else {
            return Ok((self.control.clone().unwrap_or_default(), vec![camera_tables::NO_GCPS.to_string()]));
        };
        let mut control = points.load(Some(model))?;
        let ground_m = self.project.gcps.as_ref().map_or(default_ground_m(), |gcps| gcps.sigma_ground_m);
        for p in &mut control.points {
            p.sigma = p.sigma_or(ground_m).map(Some);
        }
        let notes = control.notes(model, points, &self.out.join("relative"))?;
        Ok((control, notes))
    }

    /// The datum by GCPs or positions, and the adjustment of everything.
    fn on_the_ground(
        &self,
        flight: &Flight<'_>,
        plan: &runs::Plan,
        oriented: &Oriented,
        ties: Option<Vec<PairTies>>,
    ) -> Result<Found> {
        let (project, record, rows) = (&self.project, &self.record, &self.frames.rows);
        let model = &oriented.model;
        let image_px = project.gcps.as_ref().map_or(default_image_px(), |gcps| gcps.sigma_image_px);
        let (control, mut notes) = self.control(model)?;
        let world = control.world()?;
        let (ground, astray) = self.ground(&control, &world, model)?;
        notes.extend(astray);
        let by_micmac = self.args.engine.of_colmap().is_none();
        let mut rough = match by_micmac {
            false => table_poses(project, rows, model, &world),
            true => micmac::held(model, &world),
        };
        let placed = on_ground(model, &ground, &rough)?;
        let found = GcpStage::of(&placed, &ground, model, &world, control.crs_label());
        let page = stage_pages::gcp(&found, &record.pictures(flight.size_px));
        if record.put(Stage::Gcp, &found, &page)? == After::Ends {
            return Ok(Found::Gcp(Box::new(found)));
        }

        let (list, table) = (self.points.as_ref().map(|p| p.gcps.as_path()), self.table());
        let hung = plausible::upside_down(placed.upside_down, [list, table.as_deref()], &self.args.force)?;
        let turned = if by_micmac { None } else { footprints::let_go_of_turned(&mut rough, model, &placed.similarity) };
        let untied = ties.as_ref().and_then(|ties| runs::untied(plan, &flight.ordered, ties));

        // MicMac has compensated the interior with the poses.
        let interior = if by_micmac { Vec::new() } else { interior(&project.adjust.free, "adjust.free")? };
        let usual = AdjustOptions::default();
        let least_sigma_tie_px = if oriented.laid > 0 { LEAST_LAID_PX } else { usual.least_sigma_tie_px };
        let options = AdjustOptions { sigma_image_px: image_px, interior, rough, least_sigma_tie_px, ..usual };
        let steps = Steps::new("adjusting", 0);
        let mut found = adjust(model, &ground, &options)?;
        drop(steps);
        found.notes.extend(hung.into_iter().chain(turned).chain(untied).chain(notes));
        let (poses, places) = (found.photographs.iter().map(|p| &p.pose), ground.iter().map(|p| &p.xyz));
        found.notes.extend(plausible::below_ground(poses, places, &world));
        found.notes.extend(self.left_out.iter().cloned());
        if by_micmac {
            found.notes.push(micmac::note());
        }
        let names = &self.frames.names;
        let lost = names.iter().filter(|n| model.find(n).is_none()).map(|n| format!("{n}: not registered"));
        found.notes.extend(lost);
        let differences = || footprints::rough_differences(&found, model, rows, &world);
        let document = CamerasDocument {
            pairs: ties,
            lines: Some(runs::results(&plan.lines, &flight.ordered, (&found, model), &world)),
            rough_differences: project.rough.as_ref().map(|_| differences()),
            ..CamerasDocument::of(&found, model, &world, self.listed, control.crs_label())
        };
        let ground = footprints::footprints(&found, model, &world, control.crs.as_ref());
        atomic::write(&self.out.join("footprints.geojson"), (ground.to_string() + "\n").as_bytes())?;
        atomic::write(&self.out.join("flight.html"), page::page(&document, record.title()).as_bytes())?;
        let text = serde_json::to_string_pretty(&document)? + "\n";
        atomic::write(&self.out.join("cameras.json"), text.as_bytes())?;
        record.contents(Stage::Cameras)?;
        Ok(Found::Cameras(Box::new(document)))
    }
}

/// How far COLMAP's stages went.
enum ByColmap {
    /// Ties were all that was asked for.
    Ends(TiesStage),
    /// The block, and the ties of each pair; `None` where frames were matched as they are.
    Oriented(Oriented, Option<Vec<PairTies>>),
}

/// COLMAP's text model of a block.
fn write_model(folder: &Path, model: &Reconstruction) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create", e))?;
    // MicMac's cameras may have distortions that COLMAP's have not; its own files are there.
    for (name, content) in colmap::text_model(model).into_iter().flatten() {
        atomic::write(&folder.join(name), &content)?;
    }
    Ok(())
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
            if let Some(i) = model.find(&row.name) {
                rough[i] = camera_tables::rough_pose(row, world, r.sigma_m, 2f64.to_radians());
            }
        }
    }
    rough
}

/// The height of the ground as far as it matters to what is warped over it: to between a half and one percent of the
/// height of the cameras above, so that most changes of the list of GCPs leave the stages that were made.
fn rounded_ground_m(ground_m: f64, cameras_m: f64) -> f64 {
    const SHARE: f64 = 0.01;
    const LEAST_M: f64 = 1e-3;
    let step_m = (SHARE * (cameras_m - ground_m).abs()).max(LEAST_M).log2().floor().exp2();
    (ground_m / step_m).round() * step_m
}

/// What warps neighbours onto each other; `None` when focal length, a place or a direction is not known.
fn ground_plane(
    project: &Project,
    control: &lists::Control,
    rows: &[tables::CameraRow],
    flight: &Flight<'_>,
) -> Option<GroundPlane> {
    let (table, f_px) = (project.rough.as_ref()?, project.camera.f_px?);
    let world = control.world_of_table(&flight.ordered, rows).ok()?;
    let names = &flight.ordered;
    let of_frames = runs::rows_of(names, rows);
    let above = of_frames.iter().flatten().map(|row| row.xyz[2] * world.units_m()[1]).collect();
    // The world's heights are those of the map at the table's middle.
    let ground_m = match table.ground_m {
        Some(stated_m) => stated_m,
        None => rounded_ground_m(control.ground_m()?, frames::median(above)?),
    };
    let stated = of_frames.into_iter().map(|row| {
        let row = row?;
        // A pitch that is one for all frames is less sure than what a table says of each.
        let sigma_deg: f64 = if row.pose(None).is_some() { 2.0 } else { 5.0 };
        Some(RoughPose {
            pose: world.pose_to_world(&row.pose(table.pitch_deg)?)?,
            sigma_m: camera_tables::position_sigmas(row, table.sigma_m),
            sigma_rad: sigma_deg.to_radians(),
        })
    });
    let rough = runs::filled(&stated.collect::<Vec<_>>())?;
    Some(GroundPlane::of_table(names, (rough, table.sigma_m), (f_px, flight.size_px), ground_m))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ground_is_as_high_as_it_matters() {
        for (ground_m, cameras_m) in [(61.3, 622.9), (-4.2, 38.0), (1804.6, 4350.0), (100.0, 100.0)] {
            let rounded_m = rounded_ground_m(ground_m, cameras_m);
            assert!((rounded_m - ground_m).abs() <= 0.005 * (cameras_m - ground_m), "{rounded_m} of {ground_m}");
        }
        assert_eq!(rounded_ground_m(61.3, 622.9), rounded_ground_m(61.9, 622.9), "a GCP more or less");
    }
}
