//! FLIGHT.toml, and the frames that it names.

use autoref_raster::crs::Crs;
use autoref_raster::{bounded, protected};
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use autoref_flight::Error;
use autoref_flight::read::tables::{Angles, CameraRow};
use autoref_flight::read::{FARTHEST, same_image};
use serde::{Deserialize, Serialize};

use super::called::matches_pattern;
use super::{camera_tables, interior, lists, views};
use autoref_raster::words::counted;

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
    /// What yaw, pitch and roll of the table are.
    #[serde(default)]
    pub angles: Angles,
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
    let project: Project = toml::from_str(&text).map_err(|e| match valueless(&text) {
        Some((row, key)) => {
            Error::format(path, format!("row {row}"), format!("`{key}` has no value; give one, or remove the row"))
        }
        None => Error::format(path, "the file", e.to_string().trim().replace('\n', " ")),
    })?;
    project.check(path)?;
    Ok((project, path.parent().unwrap_or(Path::new(".")).to_path_buf()))
}

/// The first row whose key has nothing after it, which TOML takes for text without quotes.
fn valueless(text: &str) -> Option<(usize, &str)> {
    let of_row = |(index, line): (usize, &'_ str)| -> Option<(usize, usize)> {
        let (key, value) = line.split_once('=')?;
        let value = value.split('#').next().unwrap_or_default();
        (value.trim().is_empty() && !key.contains(['"', '#'])).then_some((index + 1, key.trim().len()))
    };
    let (row, length) = text.lines().enumerate().find_map(of_row)?;
    Some((row, text.lines().nth(row - 1)?.trim_start().get(..length)?))
}

impl Project {
    /// Whether its coordinates are said to lie on a plane of their own.
    fn is_local(&self) -> bool {
        self.crs.as_deref().is_some_and(lists::is_local)
    }

    /// Refuses values that no stage can work with, before the first begins.
    fn check(&self, path: &Path) -> Result<()> {
        let refuse = |key: &str, what: String| Err(Error::format(path, key, what).into());
        let gcps = self.gcps.as_ref();
        let lengths = [
            ("camera.f_px", self.camera.f_px),
            ("rough.sigma_m", self.rough.as_ref().map(|rough| rough.sigma_m)),
            ("gcps.sigma_ground_m", gcps.map(|gcps| gcps.sigma_ground_m)),
            ("gcps.sigma_image_px", gcps.map(|gcps| gcps.sigma_image_px)),
        ];
        for (key, value) in lengths {
            if let Some(value) = value.filter(|v| !(*v > 0.0 && v.is_finite())) {
                return refuse(key, format!("is {value}; a positive number is expected"));
            }
        }
        let rough = self.rough.as_ref();
        let places = [
            ("camera.pp_px", self.camera.pp_px.map(|pp| pp[0])),
            ("camera.pp_px", self.camera.pp_px.map(|pp| pp[1])),
            ("rough.ground_m", rough.and_then(|rough| rough.ground_m)),
        ];
        for (key, value) in places {
            if let Some(value) = value.filter(|v| v.is_nan() || v.abs() >= FARTHEST) {
                return refuse(key, format!("is {value}, which is no place"));
            }
        }
        if let Some(pitch) = rough.and_then(|rough| rough.pitch_deg).filter(|pitch| !(-90.0..=90.0).contains(pitch)) {
            return refuse(
                "rough.pitch_deg",
                format!("is {pitch}; degrees from -90 (straight down) to 90 are expected"),
            );
        }
        let named = [
            ("frames.folder", Some(&self.frames.folder)),
            ("rough.table", self.rough.as_ref().map(|rough| &rough.table)),
            ("gcps.list", gcps.map(|gcps| &gcps.list)),
            ("gcps.observations", gcps.and_then(|gcps| gcps.observations.as_ref())),
            ("masks.folder", self.masks.as_ref().and_then(|masks| masks.folder.as_ref())),
            ("masks.global", self.masks.as_ref().and_then(|masks| masks.global.as_ref())),
        ];
        for (key, named) in named {
            if named.is_some_and(|named| named.as_os_str().is_empty()) {
                return refuse(key, "is empty; name a file or a folder, or remove the key".into());
            }
        }
        if self.adjust.features == 0 {
            return refuse("adjust.features", "is 0; frames without features have no ties: give some thousands".into());
        }
        if self.pairs.neighbours == 0 && self.pairs.across == 0 {
            return refuse("pairs", "neighbours and across are 0: no frame is compared with another".into());
        }
        interior(&self.adjust.free, &format!("{}: adjust.free", path.display()))?;
        Ok(())
    }
}

/// The frames in the order of the table, which is that of the flight, else of the names; and the table.
pub struct OrderedFrames {
    pub folder: PathBuf,
    pub masks: views::Masks,
    pub names: Vec<String>,
    pub rows: Vec<CameraRow>,
}

impl OrderedFrames {
    /// Refuses names that lists of pairs, in which blanks part one name from the next, cannot hold; `remedy` says what
    /// to do.
    ///
    /// # Errors
    /// With the first such name.
    pub fn refuse_blanks(&self, project: &Path, remedy: &str) -> Result<()> {
        match self.names.iter().find(|name| name.contains(char::is_whitespace)) {
            Some(name) => bail!(
                "{}: the frame `{name}` has a blank in its name, which the lists of COLMAP and MicMac do not hold; {remedy}",
                project.display()
            ),
            None => Ok(()),
        }
    }

    /// Brings longitudes and latitudes of the rough table to the project's map, which its list of GCPs may name, or to
    /// their UTM zone where there is no list. Returns that map.
    ///
    /// # Errors
    /// When there is a list and neither it nor the project names a map.
    pub fn rows_on_map(
        &mut self,
        project: &Project,
        base: &Path,
        control: Option<&lists::Control>,
    ) -> Result<Option<Crs>> {
        let Some(rough) = &project.rough else { return Ok(None) };
        let stated = project.crs.as_deref().filter(|crs| !lists::is_local(crs)).map(Crs::parse).transpose()?;
        let mut crs = control.and_then(|known| known.crs.clone()).or(stated);
        if project.gcps.is_none() && !project.is_local() {
            crs = camera_tables::map_of(&self.rows, crs)?;
        }
        self.rows = camera_tables::in_map(std::mem::take(&mut self.rows), &base.join(&rough.table), crs.as_ref())?;
        Ok(crs)
    }
}

pub fn ordered_frames(project: &Project, base: &Path) -> Result<OrderedFrames> {
    let folder = absolute(&base.join(&project.frames.folder))?;
    let names = frames_in(&folder, &project.frames.pattern)?;
    if names.len() < 2 {
        bail!(
            "{}: {}; two or more are needed",
            folder.display(),
            counted(names.len(), "frame matches", "frames match")
        );
    }
    let rows = match &project.rough {
        Some(r) => camera_tables::cameras(&base.join(&r.table), r.angles)?,
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
    let frames = OrderedFrames { folder, masks, names, rows };
    protect_inputs(project, base, &frames);
    Ok(frames)
}

/// From now on nothing that is written replaces a file that the project names.
fn protect_inputs(project: &Project, base: &Path, frames: &OrderedFrames) {
    let table = project.rough.as_ref().map(|rough| base.join(&rough.table));
    let points = point_args(project, base);
    let lists = points.into_iter().flat_map(|p| [Some(p.gcps), p.how.observations]).flatten();
    let names: Vec<&str> = frames.names.iter().map(String::as_str).collect();
    let pictures = frames.names.iter().map(|name| frames.folder.join(name)).chain(frames.masks.files(&names));
    table.into_iter().chain(lists).chain(pictures).for_each(|path| protected::protect(&path));
}

/// Where the project has its GCPs.
pub fn point_args(project: &Project, base: &Path) -> Option<lists::PointArgs> {
    let gcps = project.gcps.as_ref()?;
    Some(lists::PointArgs {
        gcps: base.join(&gcps.list),
        how: lists::PointOptions {
            observations: gcps.observations.as_ref().map(|o| base.join(o)),
            crs: project.crs.clone(),
            check: gcps.check.clone(),
            sigma_ground: None,
            sigma_image: gcps.sigma_image_px,
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_empty_is_named() {
        let text = "[frames]\nfolder = \"a\"\npattern = [\"*\"]\n[camera]\nf_px =\n";
        assert_eq!(valueless(text), Some((5, "f_px")));
        assert_eq!(valueless("a = \"b = \"\nc = [ # more\n 1]\n"), None);
        let project = |rough: &str| -> Project {
            let text = format!("[frames]\nfolder = \"a\"\npattern = [\"*\"]\n[camera]\n{rough}");
            toml::from_str(&text).expect("a project")
        };
        let path = Path::new("FLIGHT.toml");
        let refused = project("[rough]\ntable = \"\"\n").check(path).expect_err("no table").to_string();
        assert!(refused.contains("rough.table") && refused.contains("remove the key"), "{refused}");
        project("").check(path).expect("nothing is empty");
    }

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
    #[test]
    fn values_that_no_stage_can_work_with_are_refused() {
        let guide = include_str!("../../../../../docs/flight.md");
        let example = guide.split("```toml\n").nth(1).and_then(|rest| rest.split("```").next()).expect("an example");
        let whole: Project = toml::from_str(example).expect("the documented example");
        let said = |change: fn(&mut Project)| {
            let mut project = whole.clone();
            change(&mut project);
            project.check(Path::new("FLIGHT.toml")).map_err(|e| e.to_string())
        };
        assert_eq!(said(|_| ()), Ok(()));
        let refused = |change: fn(&mut Project), key: &str| {
            let what = said(change).expect_err(key);
            assert!(what.contains(key), "{what}");
        };
        refused(|p| p.camera.f_px = Some(f64::NAN), "camera.f_px");
        refused(|p| p.camera.pp_px = Some([900.0, f64::NAN]), "camera.pp_px");
        refused(|p| p.rough.iter_mut().for_each(|r| r.ground_m = Some(-1e300)), "rough.ground_m");
        refused(|p| p.rough.iter_mut().for_each(|r| r.pitch_deg = Some(400.0)), "rough.pitch_deg");
    }
}
