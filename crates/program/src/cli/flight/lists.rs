//! Ground control of flights: points on the ground and where they were seen, from whatever list has them.

use autoref_raster::words::some_of;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use autoref_flight::adjust::{GroundPoint, Role};
use autoref_flight::read::image_points;
use autoref_flight::read::tables::CameraRow;
use autoref_flight::read::{self, Reconstruction, micmac, opensfm, same_image};
use autoref_flight::world::World;
use autoref_raster::bounded;
use autoref_raster::crs::{Coordinate, Crs};
use autoref_stream::gcp::{self, GcpOptions, GcpRole};
use nalgebra::Vector3;

use super::called::is_called;
use super::frames;
use super::worlds::{DATUM_M, height_unit_m, is_wgs84, world_of};

/// GCPs on the ground and in the images.
#[derive(Debug, clap::Args)]
pub struct PointArgs {
    /// GCPs: OpenDroneMap's gcp_list.txt, rows of `x y z px py`, MicMac's XML, OpenSfM's ground_control_points.json, or
    /// any list of points, with --observations.
    #[arg(long, value_name = "LIST")]
    pub gcps: PathBuf,
    #[command(flatten)]
    pub how: PointOptions,
}

/// How the points of a list are read and weighted.
#[derive(Clone, Debug, clap::Args)]
pub struct PointOptions {
    /// Where the GCPs were seen, instead of what the list says of images: a table with name, image, px, py, MicMac's
    /// measurements, or a folder with such files. Those of MMVII are also found beside its MesGCP file.
    #[arg(long, value_name = "FILE")]
    pub observations: Option<PathBuf>,
    /// CRS of the list, or of positions that stand without one; `local` for metric coordinates on a plane.
    #[arg(long, value_name = "CRS")]
    pub crs: Option<String>,
    /// Keep these points out of the fit and compare them afterwards; `C*` names all that begin so.
    #[arg(long, value_delimiter = ',', value_name = "A,B,…")]
    pub check: Vec<String>,
    /// 1σ of GCPs on the ground. Default: what the list says, else 25 m for `adjust`.
    #[arg(long, value_name = "M")]
    pub sigma_ground: Option<f64>,
    /// 1σ of GCPs in the image.
    #[arg(long, value_name = "PX", default_value_t = 1.0)]
    pub sigma_image: f64,
}

/// A point as a list has it.
#[derive(Clone, Debug)]
pub struct ListPoint {
    pub name: String,
    /// In the units of the list's CRS.
    pub xyz: [f64; 3],
    /// 1σ, metres, of each coordinate that the list has it of.
    pub sigma: [Option<f64>; 3],
    pub check: bool,
    pub seen: Vec<(String, [f64; 2])>,
}

impl ListPoint {
    /// What the list says, and `default_m` where it says nothing.
    pub fn sigma_or(&self, default_m: f64) -> [f64; 3] {
        self.sigma.map(|sigma| sigma.unwrap_or(default_m))
    }
}

/// A list with its CRS.
#[derive(Clone, Debug, Default)]
pub struct Control {
    pub points: Vec<ListPoint>,
    pub crs: Option<Crs>,
    /// The system in longitude and latitude that the list's coordinates were in before they came into `crs`.
    pub listed_in: Option<Crs>,
    /// The middle of the cameras' positions, which place the block where there are no points.
    pub cameras_at: Option<[f64; 3]>,
    /// Why the list was not read as one of points in images, where it was another.
    pub no_image_points: Option<String>,
}

/// 1σ of GCPs on the ground where nothing is stated, metres.
pub const DEFAULT_SIGMA_GROUND_M: f64 = 25.0;

/// Positions of cameras that fix a datum.
const LEAST_POSITIONS: usize = 3;

/// The middle of the positions of a camera table, axis by axis, which single rows of elsewhere do not move.
fn middle<'a>(rows: impl Iterator<Item = &'a CameraRow>) -> [f64; 3] {
    let places: Vec<[f64; 3]> = rows.map(|row| row.xyz).collect();
    [0, 1, 2].map(|axis| super::frames::median(places.iter().map(|xyz| xyz[axis]).collect()).unwrap_or(0.0))
}

/// Whether the word means a plane.
pub fn is_local(crs: &str) -> bool {
    crs.trim().eq_ignore_ascii_case("local")
}

impl Control {
    /// A block that only positions of its cameras place, in coordinates of `crs`.
    ///
    /// # Errors
    /// When there are fewer than three rows, which fix no datum, and when `crs` has no place on the Earth for them.
    pub fn of_positions(rows: &[CameraRow], crs: Option<Crs>, table: &Path) -> Result<Self> {
        if rows.len() < LEAST_POSITIONS {
            bail!(
                "{}: {} positions, and no GCPs: {LEAST_POSITIONS} are needed to place a block; name a list of GCPs",
                table.display(),
                rows.len()
            );
        }
        let control = Control { crs, cameras_at: Some(middle(rows.iter())), ..Control::default() };
        control.world().with_context(|| table.display().to_string())?;
        Ok(control)
    }

    /// A place in the coordinates of the list, in the world's frame.
    ///
    /// # Errors
    /// When it lies outside the list's system.
    pub fn place_in_world(&self, world: &World, mut place: [f64; 3], what: &str) -> Result<Vector3<f64>> {
        if let (Some(listed_in), Some(crs)) = (&self.listed_in, &self.crs) {
            let mut at = [Coordinate { x: place[0], y: place[1], height: None }];
            listed_in.transform(&mut at, crs, DATUM_M)?;
            place = [at[0].x, at[0].y, place[2] * height_unit_m(listed_in) / height_unit_m(crs)];
        }
        world.to_world(place).with_context(|| format!("{what} lies outside the CRS of the list"))
    }

    pub fn world(&self) -> Result<World> {
        let n = self.points.len().max(1) as f64;
        let mean = |a: usize| self.points.iter().map(|p| p.xyz[a]).sum::<f64>() / n;
        world_of(self.crs.as_ref(), self.cameras_at.unwrap_or_else(|| [mean(0), mean(1), mean(2)]))
    }

    /// The world about the middle of a camera table's rows of these frames, which stays where it is whatever becomes of
    /// the list.
    ///
    /// # Errors
    /// When they lie outside the CRS.
    pub fn world_of_table(&self, frames: &[&str], rows: &[CameraRow]) -> Result<World> {
        world_of(self.crs.as_ref(), middle(super::runs::rows_of(frames, rows).into_iter().flatten()))
    }

    /// The frames that the list names, in order, each once.
    pub fn frames(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for (image, _) in self.points.iter().flat_map(|p| &p.seen) {
            if !image.is_empty() && !names.contains(image) {
                names.push(image.clone());
            }
        }
        names
    }

    /// Refuses a check point that the list does not have.
    ///
    /// # Errors
    /// With its name.
    pub fn named_checks(&self, args: &PointArgs) -> Result<()> {
        if let Some(lost) = args.how.check.iter().find(|c| self.points.iter().all(|p| !is_called(&p.name, c))) {
            bail!("{}: has no point `{lost}` to check with; name one of its points", args.gcps.display());
        }
        Ok(())
    }

    /// What the list says of frames that the reconstruction does not have.
    ///
    /// # Errors
    /// When it has none of them, or a check point that is asked for is not in the list.
    pub fn notes(&self, model: &Reconstruction, args: &PointArgs, reconstruction: &Path) -> Result<Vec<String>> {
        let list = args.gcps.display();
        self.named_checks(args)?;
        let known = || model.photographs.iter().map(|p| p.name.as_str());
        let frames = self.frames();
        let lost: Vec<String> = frames.iter().filter(|f| same_image(f, known()).is_none()).cloned().collect();
        if lost.is_empty() {
            return Ok(Vec::new());
        }
        if lost.len() == frames.len() {
            bail!(
                "{list}: none of its frames ({}) is in {} ({}); correct the names",
                some_of(&frames),
                reconstruction.display(),
                some_of(&known().collect::<Vec<_>>())
            );
        }
        let note = format!("{list}: frames without a camera, whose points are left out: {}", some_of(&lost));
        eprintln!("autoref-stream: {note}");
        Ok(vec![note])
    }

    pub fn crs_label(&self) -> String {
        self.crs.as_ref().map_or_else(|| "local".into(), Crs::label)
    }

    /// The middle of the points' heights, metres.
    pub fn ground_m(&self) -> Option<f64> {
        let unit_m = self.crs.as_ref().map_or(1.0, height_unit_m);
        frames::median(self.points.iter().map(|p| p.xyz[2]).collect()).map(|height| height * unit_m)
    }

    /// The points in the world's frame, with the photographs that saw them.
    pub fn in_world(&self, world: &World, model: &Reconstruction, args: &PointArgs) -> Result<Vec<GroundPoint>> {
        let names = || model.photographs.iter().map(|p| p.name.as_str());
        let mut points = Vec::new();
        for p in &self.points {
            let Some(xyz) = world.to_world(p.xyz) else {
                bail!("GCP `{}` lies outside the CRS; give --crs, or crs in FLIGHT.toml", p.name)
            };
            let mut seen: Vec<(usize, [f64; 2])> = Vec::new();
            for (image, pixel) in &p.seen {
                let index =
                    if image.is_empty() && model.photographs.len() == 1 { Some(0) } else { same_image(image, names()) };
                let Some(i) = index else { continue };
                match seen.iter().find(|(k, _)| *k == i) {
                    Some((_, other)) if other != pixel => bail!(
                        "`{}` is measured twice in {}, at {other:?} and {pixel:?}; keep the one that is right",
                        p.name,
                        model.photographs[i].name
                    ),
                    Some(_) => {}
                    None => seen.push((i, *pixel)),
                }
            }
            let sigma = args.how.sigma_ground.map_or_else(|| p.sigma_or(DEFAULT_SIGMA_GROUND_M), |s| [s; 3]);
            if !sigma.iter().all(|s| *s > 0.0 && s.is_finite()) {
                bail!("GCP `{}`: its standard deviation must be positive", p.name);
            }
            let check = p.check || args.how.check.iter().any(|c| is_called(&p.name, c));
            let role = if check { Role::Check } else { Role::Control };
            let sigma = world.deviations_of_map(p.xyz, sigma.into());
            points.push(GroundPoint { name: p.name.clone(), xyz, sigma, role, seen });
        }
        Ok(points)
    }
}

impl PointArgs {
    pub fn load(&self, model: Option<&Reconstruction>) -> Result<Control> {
        load(&self.gcps, self.how.observations.as_deref(), self.how.crs.as_deref(), model)
    }

    /// Before there is a reconstruction; `None` of a list whose coordinates are those of one.
    ///
    /// # Errors
    /// When the list cannot be read.
    pub fn load_first(&self) -> Result<Option<Control>> {
        let text = bounded::read(&self.gcps, "a list of points", bounded::DOCUMENT_BYTES)?;
        if needs_reconstruction(&beginning(&text)) { Ok(None) } else { self.load(None).map(Some) }
    }
}

fn beginning(text: &[u8]) -> String {
    String::from_utf8_lossy(&text[..text.len().min(4096)]).into_owned()
}

/// OpenSfM's lists count in the frame of their reconstruction.
fn needs_reconstruction(beginning: &str) -> bool {
    beginning.trim_start().starts_with('{')
        && beginning.contains("\"points\"")
        && !beginning.contains("FeatureCollection")
}

pub fn load(
    list: &Path,
    observations: Option<&Path>,
    crs: Option<&str>,
    model: Option<&Reconstruction>,
) -> Result<Control> {
    let mut control = ground(list, crs, model)?;
    let files = match observations {
        Some(folder) if folder.is_dir() => match measurements_in(folder) {
            found if found.is_empty() => bail!("{}: no XML in it measures points in images", folder.display()),
            found => found,
        },
        Some(file) => vec![file.to_path_buf()],
        None if control.points.iter().any(|p| !p.seen.is_empty()) => Vec::new(),
        None => measurements_beside(list),
    };
    if let Some(file) = files.first() {
        let mut measured: Vec<(String, String, [f64; 2])> = Vec::new();
        for file in &files {
            if file.extension().is_some_and(|e| e == "xml") {
                measured.extend(micmac::read_image_points(file)?);
            } else {
                let rows = image_points::read(file)?.1.into_iter();
                measured.extend(rows.filter_map(|p| Some((p.image, p.name, p.pixel?))));
            }
        }
        // They have the last word: what the list says of images is left out.
        control.points.iter_mut().for_each(|p| p.seen.clear());
        let mut unlisted = Vec::new();
        for (image, name, pixel) in measured {
            match control.points.iter_mut().find(|p| p.name == name) {
                Some(p) => p.seen.push((image, pixel)),
                None => unlisted.push(name),
            }
        }
        unlisted.sort();
        unlisted.dedup();
        if !unlisted.is_empty() {
            let (file, names) = (file.display(), some_of(&unlisted));
            tracing::warn!("{file}: measures points that are not in {}: {names}", list.display());
        }
    }
    if control.points.is_empty() {
        bail!("{}: there are no points", list.display());
    }
    let far = |point: &&ListPoint| !point.xyz.iter().all(|v| v.abs() < read::FARTHEST);
    if let Some(point) = control.points.iter().find(far) {
        let [x, y, z] = point.xyz;
        bail!(
            "{}: the point `{}` lies at ({x:e}, {y:e}, {z:e}), which is no place; correct it",
            list.display(),
            point.name
        );
    }
    let fine = |pixel: &[f64; 2]| pixel.iter().all(|v| v.abs() < read::FARTHEST);
    for point in &control.points {
        if let Some((image, [x, y])) = point.seen.iter().find(|(_, pixel)| !fine(pixel)) {
            bail!(
                "{}: the point `{}` was seen in `{image}` at ({x:e}, {y:e}); correct its pixel",
                observations.unwrap_or(list).display(),
                point.name
            );
        }
    }
    Ok(control)
}

/// Files in a folder that hold points measured in images, in MicMac's forms, by name.
fn measurements_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let is_xml = |path: &PathBuf| path.is_file() && path.extension().is_some_and(|e| e == "xml");
    let mut files: Vec<PathBuf> =
        entries.map(|entry| entry.path()).filter(is_xml).filter(|path| micmac::has_image_points(path)).collect();
    files.sort();
    files
}

/// The measurements that belong to a list of MicMac's, which keeps them in files of their own: one, or MMVII's
/// `MesIm-IMAGE.xml` for every image.
fn measurements_beside(list: &Path) -> Vec<PathBuf> {
    if list.extension().is_none_or(|e| e != "xml") {
        return Vec::new();
    }
    let name = |path: &Path| path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_string();
    // `SaisieAppuisPredic` names them NAME-S3D.xml and NAME-S2D.xml.
    let twin = list.with_file_name(name(list).replace("-S3D", "-S2D"));
    if name(list).contains("-S3D") && twin.is_file() {
        return vec![twin];
    }
    let folder = list.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let found = measurements_in(folder);
    let of_mmvii: Vec<PathBuf> = found.iter().filter(|path| name(path).starts_with("MesIm-")).cloned().collect();
    match (found.len(), of_mmvii.len()) {
        (1, _) => found,
        (_, 1..) => of_mmvii,
        _ => Vec::new(),
    }
}

fn ground(list: &Path, crs: Option<&str>, model: Option<&Reconstruction>) -> Result<Control> {
    let stated = match crs {
        Some(word) if !is_local(word) => Some(Crs::parse(word)?),
        _ => None,
    };
    let text = bounded::read(list, "a list of points", bounded::DOCUMENT_BYTES)?;
    let start = beginning(&text);
    if start.trim_start().starts_with('<')
        && (start.contains("AppuisDAF") || start.contains("DicoAppuis") || start.contains("SetGCP"))
    {
        let points = micmac::read_ground_points(list)?.into_iter().map(|p| ListPoint {
            name: p.name,
            xyz: p.xyz,
            sigma: p.sigma.map_or([None; 3], |sigma| sigma.map(Some)),
            check: false,
            seen: Vec::new(),
        });
        let mut points: Vec<ListPoint> = points.collect();
        if !crs.is_some_and(is_local) {
            settle_places(list, &mut points, stated.as_ref())?;
        }
        return Ok(Control { points, crs: stated, ..Control::default() });
    }
    if needs_reconstruction(&start) {
        let Some(model) = model else { bail!("{}: such a list needs its reconstruction", list.display()) };
        if stated.as_ref().is_some_and(|crs| !is_wgs84(crs)) {
            bail!("{}: longitudes and latitudes of WGS 84, and --crs has no effect; leave it out", list.display());
        }
        return of_opensfm(list, model);
    }
    let measured = match image_points::read(list) {
        Err(error) if image_points::begins_as_list(&start) || image_points::has_pixel_titles(&start) => {
            return Err(error.into());
        }
        other => other,
    };
    let no_image_points = measured.as_ref().err().map(ToString::to_string);
    if let Ok((line, measured)) = measured
        && measured.iter().all(|p| p.xyz.is_some())
    {
        let word = crs.or(line.as_deref());
        let plane = word.is_some_and(is_local);
        let stated = match (stated, line, crs) {
            (Some(crs), _, _) => Some(crs),
            (None, Some(line), None) if !is_local(&line) => {
                let first = || format!("{}: row 1", list.display());
                Some(Crs::parse(&line).with_context(first)?)
            }
            _ => None,
        };
        let mut points = gathered(list, measured)?;
        // A plane of one's own has no order that could be told.
        if !plane {
            settle_places(list, &mut points, stated.as_ref())?;
        }
        return metric(points, stated);
    }
    let plane = crs.is_some_and(is_local);
    let options = GcpOptions { crs: crs.filter(|c| !is_local(c)).map(str::to_string), ..GcpOptions::default() };
    let read = gcp::read(list, &options)?;
    let mut points = Vec::new();
    for g in read.gcps {
        let Some(height) = g.height else {
            bail!("{}: point `{}` has no height; cameras need points in three dimensions", list.display(), g.name)
        };
        let sigma = [g.sigma_m, g.sigma_m, g.sigma_height_m.or(g.sigma_m)];
        let check = g.role == GcpRole::Check;
        let mut at = [Coordinate { x: g.easting, y: g.northing, height: Some(height) }];
        // They were read as metres. Those of a plane stay so.
        if !plane {
            read.working_crs.leave(&mut at)?;
        }
        let xyz = [at[0].x, at[0].y, at[0].height.unwrap_or(height)];
        points.push(ListPoint { name: g.name, xyz, sigma, check, seen: Vec::new() });
    }
    let crs = if plane { None } else { read.crs };
    Ok(Control { points, crs, no_image_points, ..Control::default() })
}

/// Points of all rows that name them.
fn gathered(list: &Path, measured: Vec<image_points::ImagePoint>) -> Result<Vec<ListPoint>> {
    let mut points: Vec<ListPoint> = Vec::new();
    for p in measured {
        let Some(xyz) = p.xyz else { continue };
        match points.iter_mut().find(|q| q.name == p.name) {
            Some(known) if known.xyz != xyz => bail!(
                "{}: `{}` has two places, {:?} and {xyz:?}; give it one, or two names",
                list.display(),
                known.name,
                known.xyz
            ),
            Some(known) => {
                known.seen.extend(p.pixel.map(|pixel| (p.image, pixel)));
                known.check |= p.check;
                known.sigma = std::array::from_fn(|k| known.sigma[k].or(p.sigma[k]));
            }
            None => points.push(ListPoint {
                name: p.name,
                xyz,
                sigma: p.sigma,
                check: p.check,
                seen: p.pixel.map(|pixel| (p.image, pixel)).into_iter().collect(),
            }),
        }
    }
    Ok(points)
}

/// East before north, on the map: what [`gcp::read`] does for lists of other kinds.
fn settle_places(list: &Path, points: &mut [ListPoint], crs: Option<&Crs>) -> Result<()> {
    let mut places: Vec<[f64; 3]> = points.iter().map(|p| p.xyz).collect();
    for note in gcp::settle_places(list, &mut places, crs)? {
        tracing::warn!("{note}; --crs (local of a plane of your own) says how they are meant");
    }
    points.iter_mut().zip(places).for_each(|(point, place)| point.xyz = place);
    Ok(())
}

/// Longitude and latitude become UTM metres.
fn metric(mut points: Vec<ListPoint>, crs: Option<Crs>) -> Result<Control> {
    let Some(geographic) = crs.as_ref().filter(|c| c.is_geographic()).cloned() else {
        return Ok(Control { points, crs, ..Control::default() });
    };
    let Some(first) = points.first() else { return Ok(Control { points, crs, ..Control::default() }) };
    let utm = geographic.utm_zone(first.xyz[0], first.xyz[1])?;
    for p in &mut points {
        let mut at = [Coordinate { x: p.xyz[0], y: p.xyz[1], height: None }];
        geographic.transform(&mut at, &utm, 100.0)?;
        p.xyz = [at[0].x, at[0].y, p.xyz[2] * height_unit_m(&geographic) / height_unit_m(&utm)];
    }
    Ok(Control { points, crs: Some(utm), listed_in: Some(geographic), ..Control::default() })
}

fn of_opensfm(list: &Path, model: &Reconstruction) -> Result<Control> {
    let all = opensfm::ground_control(list, model)?;
    let placed = |p: opensfm::GroundControl| {
        Some(ListPoint { name: p.name, xyz: p.lla?, sigma: [None; 3], check: false, seen: p.seen })
    };
    let points: Vec<ListPoint> = all.into_iter().filter_map(placed).collect();
    if points.is_empty() {
        bail!("{}: no point has a position", list.display());
    }
    metric(points, Some(Crs::from_epsg(4326)?))
}
