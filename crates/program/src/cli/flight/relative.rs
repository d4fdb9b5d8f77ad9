//! Ties and relative orientation: COLMAP's commands, each a stage that is kept, and the start from a rough table where
//! they end.

use autoref_raster::ranks::upper_median;
use autoref_raster::words::some_of;
use std::hash::Hasher;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use autoref_flight::adjust::{GroundPoint, RoughPose};
use autoref_flight::ground_plane::Interior;
use autoref_flight::pose::turn;
use autoref_flight::read::{Photograph, Reconstruction, colmap};
use autoref_flight::{Camera, Error, Pose, complete, start};
use autoref_raster::atomic::Part;
use autoref_raster::fingerprint::{self, Fingerprint};

use super::engine::{Program, no_pair};
use super::project::{Focal, Project};
use super::ties::{self, Ties};
use super::views::{Masks, View};

/// A flight's frames in the order in which it took them.
pub struct Flight<'a> {
    pub project: &'a Project,
    pub folder: &'a Path,
    /// The same frames as COLMAP can read them.
    pub colmap_folder: &'a Path,
    pub masks: &'a Masks,
    pub out: &'a Path,
    pub ordered: Vec<&'a str>,
    pub size_px: [f64; 2],
    pub anew: bool,
    pub engine: Program,
    /// Frames that are compared with each other, by their numbers, the smaller first.
    pub near: Vec<(usize, usize)>,
}

/// Where the frames are thought to stand, in the order of the flight, and the height of the ground below them, in the
/// world's frame.
pub struct GroundPlane {
    pub views: Vec<View>,
    /// What the rough table says.
    pub rough: Vec<RoughPose>,
    pub f_px: f64,
    pub ground_m: f64,
    /// 1σ of a position against the plane at least: a receiver knows its own place better than anybody the ground's.
    least_sigma_m: f64,
}

/// Frames of the smallest part that COLMAP's mapper keeps.
const LEAST_PART: &str = "3";

/// What makes a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MadeBy {
    /// Ties between warped neighbours, the rough table and GCPs, where there are any, together.
    Table,
    /// COLMAP's mapper, of the ties that there are.
    Mapper,
    /// COLMAP's mapper, of frames matched as they are where warped neighbours had joined fewer.
    MapperOfPlainFrames,
    Micmac,
}

impl MadeBy {
    pub fn words(self) -> &'static str {
        match self {
            MadeBy::Table => "ties, the rough table and GCPs, where there are any",
            MadeBy::Mapper => "COLMAP's mapper",
            MadeBy::MapperOfPlainFrames => "COLMAP's mapper, of frames matched as they are",
            MadeBy::Micmac => "MicMac",
        }
    }
}

/// Where a larger share of the frames is not joined, they are matched once more as they are: directions of the table
/// that are wrong, or frames that were turned, warp neighbours away from each other.
const MOST_LOST: f64 = 0.05;
/// How far relief moves ground that the plane stands for, where the poses are known.
const RELIEF_PX: f64 = 80.0;
/// A frame that was placed farther from its rough pose, in standard deviations, was placed wrongly.
const MOST_SIGMAS: f64 = 4.0;

impl GroundPlane {
    /// From the rough table alone; `least_sigma_m` is what its positions are worth against the plane at best.
    pub fn of_table(
        names: &[&str],
        (rough, least_sigma_m): (Vec<RoughPose>, f64),
        (f_px, size_px): (f64, [f64; 2]),
        ground_m: f64,
    ) -> Self {
        let mut away: Vec<f64> = rough
            .iter()
            .map(|r| {
                let above = (r.pose.centre.z - ground_m).abs();
                // Along the view, or five heights off where it looks at the horizon.
                above / (-r.pose.rotation[(2, 2)]).clamp(0.2, 1.0)
            })
            .collect();
        let distance = upper_median(&mut away).unwrap_or(1.0).max(1.0);
        let most_px = (0.25 * size_px[0].max(size_px[1])).max(200.0);
        let view = |(name, rough): (&&str, &RoughPose)| {
            // Three standard deviations of both frames' positions and directions together.
            let sigma_px = f_px
                * (rough.sigma_m.max().max(least_sigma_m) / distance).hypot(rough.sigma_rad)
                * std::f64::consts::SQRT_2;
            let window_px = (3.0 * sigma_px).clamp(RELIEF_PX, most_px);
            View { name: (*name).to_string(), pose: rough.pose, window_px }
        };
        let views = names.iter().zip(&rough).map(view).collect();
        GroundPlane { views, rough, f_px, ground_m, least_sigma_m }
    }

    /// The frames where they were placed, unless that is far from what the table says.
    pub fn placed(&self, block: &Reconstruction) -> Self {
        let moved = |(view, rough): (&View, &RoughPose)| {
            let pose = block.photographs.iter().find(|p| p.name == view.name).map(|p| p.pose);
            let far = |pose: &Pose| {
                let turn = turn(&pose.rotation, &rough.pose.rotation).norm();
                let sigma_m = rough.sigma_m.map(|s| s.max(self.least_sigma_m));
                let away = (pose.centre - rough.pose.centre).component_div(&sigma_m).norm();
                away > MOST_SIGMAS || turn > MOST_SIGMAS * rough.sigma_rad
            };
            match pose.filter(|pose| !far(pose)) {
                Some(pose) => View { name: view.name.clone(), pose, window_px: RELIEF_PX },
                None => view.clone(),
            }
        };
        let views = self.views.iter().zip(&self.rough).map(moved).collect();
        GroundPlane { views, rough: self.rough.clone(), ..*self }
    }
}

/// Ties between warped neighbours.
pub struct Tied {
    /// All that were matched.
    ties: Ties,
    /// Those that agree with the relative orientation of their two frames.
    verified: Ties,
    /// COLMAP's database of them, and the hash of what it is made of.
    matches: (PathBuf, Fingerprint),
    /// The block that they and the rough table agree on.
    placed: Result<Reconstruction>,
}

/// Ties of a flight, its frames warped onto each other or as they are.
pub struct Matched {
    /// All between warped neighbours; `None` where frames were matched as they are.
    pub all: Option<Ties>,
    /// Those that agree with the relative orientation of their two frames.
    pub verified: Ties,
    matches: (PathBuf, Fingerprint),
    /// The block of warped neighbours that they and the rough table agree on.
    placed: Option<Result<Reconstruction>>,
}

/// A block of cameras, and what made it.
pub struct Oriented {
    pub model: Reconstruction,
    pub by: MadeBy,
    /// Image points that were laid upon each other in the frames.
    pub laid: usize,
}

impl Oriented {
    pub fn new(model: Reconstruction, by: MadeBy) -> Self {
        Oriented { model, by, laid: 0 }
    }
}

impl<'a> Flight<'a> {
    pub fn pp_px(&self) -> [f64; 2] {
        self.project.camera.pp_px.unwrap_or([self.size_px[0] / 2.0, self.size_px[1] / 2.0])
    }

    fn hash(&self) -> Result<Fingerprint> {
        let project = self.project;
        let mut hash = Fingerprint::of(&format!("{:?} {} {:?}", project.camera, project.adjust.features, self.ordered));
        if self.engine == Program::Pycolmap {
            hash.write(b"pycolmap");
        }
        for name in &self.ordered {
            hash.file(&self.folder.join(name))?;
        }
        Ok(hash)
    }

    fn stages(&self) -> Stages<'a> {
        Stages { folder: self.out, anew: self.anew }
    }

    /// The ties between neighbours warped onto each other where the rough table has them, and again where that block
    /// has them. `None` when there are none.
    pub fn tied(&self, table: &GroundPlane, ground: &[GroundPoint]) -> Result<Option<Tied>> {
        let Some(first) = self.tied_once(table, ground, "rough_")? else { return Ok(None) };
        let Ok(block) = &first.placed else { return Ok(Some(first)) };
        let again = self.tied_once(&table.placed(block), ground, "")?;
        Ok(again.filter(|again| again.frames() >= first.frames()).or(Some(first)))
    }

    fn tied_once(&self, plane: &GroundPlane, ground: &[GroundPoint], stage: &str) -> Result<Option<Tied>> {
        let near = &self.near;
        let mut hash = self.hash()?;
        for mask in self.masks.files(&self.ordered) {
            hash.file(&mask)?;
        }
        // What follows from the ties goes by what they are; they alone are the program's own work.
        hash.write(format!("{} {near:?} {}", plane.ground_m, fingerprint::program()).as_bytes());
        // To a millimetre and a hundredth of a second: sums over threads differ in the last digits.
        let rounded = |v: &f64, unit: f64| (v / unit).round() as i64;
        for view in &plane.views {
            let place: Vec<i64> = view.pose.centre.iter().map(|v| rounded(v, 1e-3)).collect();
            let turn: Vec<i64> = view.pose.rotation.iter().map(|v| rounded(v, 5e-8)).collect();
            hash.write(format!("{} {place:?} {turn:?} {}", view.name, view.window_px).as_bytes());
        }
        let job = ties::Job {
            frames: self.folder,
            masks: self.masks,
            views: &plane.views,
            pairs: near,
            interior: Interior { f_px: plane.f_px, pp_px: self.pp_px() },
            ground_m: plane.ground_m,
            features: self.project.adjust.features,
        };
        let folder = self.stages().run(&format!("{stage}ties"), &hash.hex(), |part| {
            let log = self.out.join(format!("{stage}ties.log"));
            ties::make(part, &job, &|a, command| self.engine.run(&log, a, command))
        })?;
        let ties = ties::read(&folder)?;
        if ties.count() == 0 {
            return Ok(None);
        }
        let matches = self.matches(Some(&folder), stage)?;
        let verified = ties.verified(&matches.0, &self.ordered)?;
        let placed = self.placed(plane, &verified, ground);
        Ok(Some(Tied { ties, verified, matches, placed }))
    }

    /// Features (or the ties given) and what of their matches agrees with a relative orientation, by COLMAP, each kept.
    fn matches(&self, ties: Option<&Path>, stage: &str) -> Result<(PathBuf, Fingerprint)> {
        let (stages, project, pp) = (self.stages(), self.project, self.pp_px());
        let list = self.out.join("frames.txt");
        autoref_raster::atomic::write(&list, (self.ordered.join("\n") + "\n").as_bytes())?;
        let mut hash = self.hash()?;
        if let Some(ties) = ties {
            hash.file(&ties.join("ties.json"))?;
        } else {
            self.masks.files(&self.ordered).iter().try_for_each(|mask| hash.file(mask))?;
        }
        let text = |p: &Path| p.display().to_string();
        // One thread throughout: with more, the order of images and of random draws differs from run to run.
        let features = stages.run(&format!("{stage}features.db"), &hash.hex(), |part| {
            let mut a = vec![
                ("database_path", text(part)),
                ("image_path", text(self.colmap_folder)),
                ("image_list_path", text(&list)),
                ("ImageReader.single_camera", "1".into()),
                ("ImageReader.camera_model", "SIMPLE_RADIAL".into()),
            ];
            if let Some(f) = project.camera.f_px {
                a.push(("ImageReader.camera_params", format!("{f},{},{},0", pp[0], pp[1])));
            }
            let command = match ties {
                Some(ties) => {
                    a.push(("import_path", text(&ties.join("features"))));
                    "feature_importer"
                }
                None => {
                    let masks = self.out.join("colmap_masks");
                    if self.masks.write_for_colmap(self.folder, &self.ordered, &masks)? {
                        a.push(("ImageReader.mask_path", text(&masks)));
                    }
                    a.push(("SiftExtraction.use_gpu", "0".into()));
                    a.push(("SiftExtraction.num_threads", "1".into()));
                    a.push(("SiftExtraction.max_num_features", project.adjust.features.to_string()));
                    "feature_extractor"
                }
            };
            self.engine.run(&self.out.join(format!("{stage}features.log")), &a, command)
        })?;

        let pairs: String =
            self.near.iter().map(|(a, b)| format!("{} {}\n", self.ordered[*a], self.ordered[*b])).collect();
        let pair_list = self.out.join("pairs.txt");
        autoref_raster::atomic::write(&pair_list, pairs.as_bytes())?;
        hash.write(pairs.as_bytes());
        let matches = stages.run(&format!("{stage}matches.db"), &hash.hex(), |part| {
            std::fs::copy(&features, part).map_err(|e| Error::io(&features, "copy", e))?;
            let (list, form) = match ties {
                Some(ties) => (ties.join("matches.txt"), "raw"),
                None => (pair_list.clone(), "pairs"),
            };
            let a = [
                ("database_path", text(part)),
                ("match_list_path", text(&list)),
                ("match_type", form.into()),
                ("SiftMatching.use_gpu", "0".into()),
                ("SiftMatching.num_threads", "1".into()),
            ];
            self.engine.run(&self.out.join(format!("{stage}matches.log")), &a, "matches_importer")
        })?;
        Ok((matches, hash))
    }

    /// The relative orientation: the block that ties and rough table agree on when it has all frames, else that of
    /// COLMAP's mapper unless it has fewer; where both lack frames, that of frames matched as they are if it has more.
    ///
    /// # Errors
    /// When COLMAP is missing or fails; [`no_pair`]'s when no two frames fit together.
    pub fn relative(&self, matched: Matched) -> Result<Oriented> {
        let (matches, hash) = matched.matches;
        let all = self.ordered.len();
        let warped = match matched.placed {
            Some(Ok(model)) if model.photographs.len() == all => return Ok(Oriented::new(model, MadeBy::Table)),
            None => return Ok(Oriented::new(self.grown("sparse", &matches, hash)?, MadeBy::Mapper)),
            Some(placed) => larger(self.grown("sparse", &matches, hash), placed),
        };
        let joined = match &warped {
            Ok(block) => block.model.photographs.len(),
            Err(error) if is_no_result(error) => 0,
            Err(_) => return warped,
        };
        if (all - joined) as f64 <= MOST_LOST * all as f64 {
            return warped;
        }
        let (matches, hash) = self.matches(None, "plain_")?;
        match self.grown("plain_sparse", &matches, hash) {
            Ok(model) if model.photographs.len() > joined => Ok(Oriented::new(model, MadeBy::MapperOfPlainFrames)),
            Err(error) if !is_no_result(&error) => Err(error),
            Ok(_) | Err(_) => warped,
        }
    }

    /// Ties between warped neighbours where there are some, else between the frames as they are.
    ///
    /// # Errors
    /// When COLMAP is missing or fails.
    pub fn matched(&self, tied: Option<Tied>) -> Result<Matched> {
        Ok(match tied {
            Some(Tied { ties, verified, matches, placed }) => {
                Matched { all: Some(ties), verified, matches, placed: Some(placed) }
            }
            None => {
                let matches = self.matches(None, "")?;
                let verified = Ties::of_plain_frames(&matches.0, &self.ordered)?;
                Matched { all: None, verified, matches, placed: None }
            }
        })
    }

    /// The block that COLMAP's mapper grows, its parts joined and frames that it left out placed by their ties; `stage`
    /// is where it is kept.
    fn grown(&self, stage: &str, matches: &Path, mut hash: Fingerprint) -> Result<Reconstruction> {
        let (stages, project) = (self.stages(), self.project);
        let text = |p: &Path| p.display().to_string();
        let held = if project.camera.f_px.is_some() && project.camera.focal == Focal::Held { "0" } else { "1" };
        hash.write(&project.adjust.seed.to_le_bytes());
        hash.write(LEAST_PART.as_bytes());
        let sparse = stages.run(stage, &hash.hex(), |part| {
            std::fs::create_dir_all(part).map_err(|e| Error::io(part, "create", e))?;
            let a = [
                ("database_path", text(matches)),
                ("image_path", text(self.colmap_folder)),
                ("output_path", text(part)),
                ("random_seed", project.adjust.seed.to_string()),
                // More threads change the order of sums, and so the last digits.
                ("Mapper.num_threads", "1".into()),
                ("Mapper.min_model_size", LEAST_PART.into()),
                ("Mapper.ba_refine_focal_length", held.into()),
                ("Mapper.ba_refine_principal_point", "0".into()),
            ];
            self.engine.run(&self.out.join("mapper.log"), &a, "mapper")
        })?;
        let folders = colmap::model_folders(&sparse);
        let (largest, others) = folders.split_first().ok_or_else(no_pair)?;
        let mut parts = vec![colmap::read(largest).context("COLMAP's model")?];
        // A part that cannot be read takes nothing from the others.
        parts.extend(others.iter().filter_map(|part| colmap::read(part).ok()));
        let grown = parts.iter().map(|part| part.photographs.len()).max().unwrap_or(0);
        let mut block = complete::joined(parts).ok_or_else(no_pair)?;
        let joined = block.photographs.len();
        if joined < self.ordered.len() {
            let tracks = Ties::of_plain_frames(matches, &self.ordered)?.tracks();
            block = complete::completed(block.clone(), &self.ordered, &tracks).unwrap_or(block);
        }
        let names = |from: usize, to: usize| -> Vec<String> {
            block.photographs[from..to].iter().map(|p| p.name.clone()).collect()
        };
        let said = [
            (names(grown, joined), "joined from a part that COLMAP's mapper left apart"),
            (names(joined, block.photographs.len()), "placed by their ties, after COLMAP's mapper had left them out"),
        ];
        let said = said.into_iter().filter(|(names, _)| !names.is_empty());
        let said: Vec<String> = said.map(|(names, what)| format!("{}: {what}", some_of(&names))).collect();
        block.notes.extend(said);
        Ok(block)
    }

    /// The block from the rough table, `ground` being seen in the frames by their order.
    fn placed(&self, plane: &GroundPlane, ties: &Ties, ground: &[GroundPoint]) -> Result<Reconstruction> {
        let names: Vec<String> = plane.views.iter().map(|v| v.name.clone()).collect();
        let start: Vec<Pose> = plane.views.iter().map(|v| v.pose).collect();
        let camera = &self.listed(plane).cameras[0];
        Ok(start::from_rough(&names, camera, &start, &plane.rough, &ties.tracks(), ground)?)
    }

    /// All frames where the table has them.
    pub fn listed(&self, plane: &GroundPlane) -> Reconstruction {
        let camera = Camera::pinhole("film", self.size_px, plane.f_px, self.pp_px());
        let photographs =
            plane.views.iter().map(|v| Photograph { name: v.name.clone(), camera: 0, pose: v.pose }).collect();
        Reconstruction { cameras: vec![camera], photographs, ..Reconstruction::default() }
    }
}

impl Tied {
    /// Frames that the rough table and the ties place.
    fn frames(&self) -> usize {
        self.placed.as_ref().map_or(0, |p| p.photographs.len())
    }
}

/// Of the block that COLMAP grew and the one from the rough table the one with more frames.
///
/// # Errors
/// When neither is there: what COLMAP said.
fn larger(grown: Result<Reconstruction>, placed: Result<Reconstruction>) -> Result<Oriented> {
    let from_table = |model| Oriented::new(model, MadeBy::Table);
    match (grown, placed) {
        (Ok(grown), Ok(placed)) if placed.photographs.len() > grown.photographs.len() => Ok(from_table(placed)),
        (Ok(model), _) => Ok(Oriented::new(model, MadeBy::Mapper)),
        (Err(error), placed) if is_no_result(&error) => placed.map(from_table).map_err(|_| error),
        (Err(error), _) => Err(error),
    }
}

/// Whether COLMAP ran, and found nothing that fits together.
fn is_no_result(error: &anyhow::Error) -> bool {
    matches!(error.downcast_ref::<Error>(), Some(Error::NoResult { .. }))
}

/// Removes a file or a folder, if it is there.
fn remove(old: &Path) -> Result<()> {
    autoref_raster::protected::refuse_inputs_below(old)?;
    match if old.is_dir() { std::fs::remove_dir_all(old) } else { std::fs::remove_file(old) } {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(old, "remove", e).into()),
        _ => Ok(()),
    }
}

/// A stage of COLMAP: done when its stamp bears the hash of its inputs.
struct Stages<'a> {
    folder: &'a Path,
    anew: bool,
}

impl Stages<'_> {
    /// Runs `work` towards `.NAME.part`, which becomes `NAME` when it succeeds, and goes when it does not.
    fn run(&self, name: &str, hash: &str, work: impl FnOnce(&Path) -> Result<()>) -> Result<PathBuf> {
        let (target, stamp) = (self.folder.join(name), self.folder.join(format!("{name}.stamp")));
        if !self.anew && target.exists() && std::fs::read_to_string(&stamp).is_ok_and(|s| s.trim() == hash) {
            eprintln!("{name}: taken from before");
            return Ok(target);
        }
        let part = self.folder.join(format!(".{name}.part"));
        // SQLite keeps a journal beside a database.
        let parts = ["", "-journal", "-wal", "-shm"].map(|end| self.folder.join(format!(".{name}.part{end}")));
        parts.iter().chain([&target, &stamp]).try_for_each(|old| remove(old))?;
        eprintln!("{name} …");
        let _making = Part::of(&part);
        if let Err(error) = work(&part) {
            parts.iter().for_each(|old| drop(remove(old)));
            return Err(error);
        }
        std::fs::rename(&part, &target).map_err(|e| Error::io(&part, "rename", e))?;
        autoref_raster::atomic::write(&stamp, hash.as_bytes())?;
        Ok(target)
    }
}
