//! Where a frame stands over its elevation model, and what ground it sees.

use std::convert::Infallible;
use std::path::Path;

use anyhow::{Context, Result, bail};
use autoref_cloud::params;
use autoref_elevation::grid::Grid;
use autoref_flight::read::tables::Angles;
use autoref_flight::read::{self, same_image};
use autoref_flight::world::World;
use autoref_flight::{Camera, Pose, SizeOf};
use autoref_raster::bilinear::by_weights;
use autoref_raster::crs::{Coordinate, Crs};
use nalgebra::Vector3;

use super::super::{camera_file, camera_tables, lists, set_interior, worlds};
use super::OrthorectifyArgs;
use super::model::Dem;

/// What the coordinates of a pose are.
pub(super) enum Frame {
    /// The map's, in this CRS; in the elevation model's where none is stated.
    Map(Option<String>),
    /// East, north, up about a longitude, latitude and height.
    Tangent([f64; 3]),
}

/// The frame's camera and pose, and what its coordinates are.
pub(super) fn posed(
    args: &OrthorectifyArgs,
    name: &str,
    size: [f64; 2],
    model_crs: Option<&Crs>,
) -> Result<(Camera, Pose, Frame)> {
    let beside = args.frame.with_file_name("cameras.json");
    let file = match &args.cameras {
        Some(file) => file.clone(),
        None if beside.is_file() => beside,
        None => bail!(
            "{}: its camera is not known; give --cameras with the result of `flight solve`, `adjust` or `resect`",
            args.frame.display()
        ),
    };
    let known = ["cameras.txt", "images.txt", "points3D.txt"];
    let is_table = file
        .extension()
        .and_then(|e| e.to_str())
        .is_some_and(|e| ["csv", "txt", "tsv"].iter().any(|known| e.eq_ignore_ascii_case(known)))
        && file.file_name().and_then(|n| n.to_str()).is_none_or(|n| !known.contains(&n));
    let (mut camera, pose, frame) = if is_table {
        posed_by_table(args, &file, name, size, model_crs)?
    } else {
        posed_by_reconstruction(args, &file, name, model_crs)?
    };
    // What the options state is in pixels of this frame.
    if camera.size_px != size {
        resize(&mut camera, &args.frame, size)?;
    }
    set_interior(&mut camera, &args.frame, args.f_px, args.pp_px.as_deref(), &args.distortion)?;
    Ok((camera, pose, frame))
}

/// From the row of a camera table.
fn posed_by_table(
    args: &OrthorectifyArgs,
    file: &Path,
    name: &str,
    size: [f64; 2],
    model_crs: Option<&Crs>,
) -> Result<(Camera, Pose, Frame)> {
    if args.shift.is_some() {
        bail!("--shift is of a reconstruction; write the map coordinates into {}", file.display());
    }
    let rows = camera_tables::cameras(file, args.angles.angles())?;
    let Some(i) = same_image(name, rows.iter().map(|r| r.name.as_str())) else {
        bail!("{}: has no row of `{name}`", file.display())
    };
    // Degrees are brought to the model's map; whatever their CRS is called, they are those of WGS 84.
    let stated = args.crs.as_deref().filter(|_| rows[i].geographic).map(Crs::parse).transpose()?;
    if stated.is_some_and(|crs| !worlds::is_wgs84(&crs)) {
        bail!(
            "{}: longitudes and latitudes, which are taken as those of WGS 84, and --crs has no effect; leave it out",
            file.display()
        );
    }
    let frame = Frame::Map(args.crs.clone().filter(|_| !rows[i].geographic));
    let row = &camera_tables::on_map(vec![rows[i].clone()], file, model_crs)?[0];
    let Some(pose) = row.pose(None) else {
        bail!("{}: the row of `{name}` states no direction (yaw and pitch, or omega, phi, kappa)", file.display())
    };
    if !row.is_directed() {
        tracing::warn!("{}: the row of `{name}` states no roll; the frame is taken to lie level", file.display());
    }
    let camera = match &args.camera {
        Some(path) => camera_file(path, name)?,
        None if args.f_px.is_some() => Camera::pinhole(name, size, 1.0, [size[0] / 2.0, size[1] / 2.0]),
        None => bail!("{}: a table has no interior; give --f-px or --camera", file.display()),
    };
    Ok((camera, pose, frame))
}

/// From a reconstruction that has the frame.
fn posed_by_reconstruction(
    args: &OrthorectifyArgs,
    file: &Path,
    name: &str,
    model_crs: Option<&Crs>,
) -> Result<(Camera, Pose, Frame)> {
    let model = read::reconstruction(file)?;
    let of_tables = [("--camera", args.camera.is_some()), ("--angles", args.angles.angles() == Angles::Aircraft)];
    if let Some((option, _)) = of_tables.into_iter().find(|(_, is_given)| *is_given) {
        bail!("{option} is of a camera table, and {} is a reconstruction; leave it out", file.display());
    }
    let Some(i) = model.find(name) else { bail!("{}: has no frame `{name}`", file.display()) };
    // Who names a CRS says that the coordinates are the map's.
    let on_map = args.shift.is_some() || args.crs.is_some() || model_crs.is_none_or(Crs::is_local);
    let about = model.reference_lla.filter(|_| !on_map);
    let frame = about.map_or_else(|| Frame::Map(args.crs.clone().or(model.crs.clone())), Frame::Tangent);
    let mut pose = model.photographs[i].pose;
    if let Some(text) = &args.shift {
        pose.centre += Vector3::from(params::numbers("--shift", text, "E,N,H")?);
        if pose.centre.iter().any(|v| v.abs() > read::FARTHEST) {
            bail!(
                "--shift {text}: the camera would stand at ({:e}, {:e}, {:e})",
                pose.centre.x,
                pose.centre.y,
                pose.centre.z
            );
        }
    } else if about.is_some() {
        tracing::warn!(
            "{}: its coordinates are taken as east, north and up about its reference_lla; OpenDroneMap's are map \
             coordinates less an offset (the second line of its coords.txt): give that with --shift E,N,0",
            file.display()
        );
    }
    Ok((model.cameras[model.photographs[i].camera].clone(), pose, frame))
}

/// A scan may be this much smaller than the film on it, whose edges are cut.
const CUT: f64 = 0.9;

/// The camera of a frame of another size: the same lens, other pixels. A scan is larger than its film, and its pixels
/// are what they are.
pub(in crate::cli::flight) fn resize(camera: &mut Camera, of: &Path, size: [f64; 2]) -> Result<()> {
    use autoref_flight::Parameter::{Cx, Cy, F};
    let (across, down) = (size[0] / camera.size_px[0], size[1] / camera.size_px[1]);
    let holds = match camera.size_of {
        SizeOf::Image => (across / down - 1.0).abs() <= 1e-3,
        SizeOf::Film => across >= CUT && down >= CUT,
    };
    if !holds {
        bail!(
            "{}: is {} x {} px, its camera {} x {}; give the frame that was measured",
            of.display(),
            size[0],
            size[1],
            camera.size_px[0],
            camera.size_px[1]
        );
    }
    if camera.size_of == SizeOf::Image {
        for p in [F, Cx, Cy] {
            camera.set(p, camera.get(p) * across);
        }
        for maps in [&mut camera.before, &mut camera.after] {
            maps.iter_mut().for_each(|map| *map = map.moved(across, [1.0; 2], [0.0; 2]));
        }
    }
    camera.size_px = size;
    Ok(())
}

/// The world about the camera in the model's CRS, the pose in it, and the camera's place in the map, all in metres.
pub(super) fn place(dem: &Dem, pose: &Pose, frame: &Frame) -> Result<(World, Pose, [f64; 3])> {
    let crs = match frame {
        Frame::Map(crs) => crs.as_deref(),
        Frame::Tangent(about) => return place_tangent(dem, pose, *about),
    };
    let eye: [f64; 3] = pose.centre.into();
    let Some(target) = dem.crs.as_ref().filter(|_| crs.is_none_or(|c| !lists::is_local(c))) else {
        let world = World::flat(eye);
        let posed = world.pose_to_world(pose).context("a plane has every place")?;
        return Ok((world, posed, eye));
    };
    let from = match crs {
        Some(word) => Crs::parse(word).with_context(|| format!("the CRS of the cameras, `{word}`; give --crs"))?,
        None => target.clone(),
    };
    if from.is_geographic() {
        bail!("{}: cameras in degrees; give their table in a projected CRS", from.title());
    }
    let mut at = [Coordinate { x: eye[0], y: eye[1], height: None }];
    from.transform(&mut at, target, 100.0)?;
    let there = [at[0].x * dem.unit_m, at[0].y * dem.unit_m, eye[2] * worlds::height_unit_m(&from)];
    // Both stand on the same point of the ellipsoid: their tangent frames are one.
    let posed = worlds::world_of(Some(&from), eye)?.pose_to_world(pose);
    let posed = posed.with_context(|| format!("the camera lies outside {}", from.title()))?;
    Ok((worlds::metric_world_of(target, there)?, posed, there))
}

/// The same of a pose in the tangent plane about a longitude, latitude and height.
fn place_tangent(dem: &Dem, pose: &Pose, about: [f64; 3]) -> Result<(World, Pose, [f64; 3])> {
    let target = dem.crs.as_ref().context("a tangent frame is placed on a map")?;
    let mut at = [Coordinate { x: about[0], y: about[1], height: None }];
    Crs::from_epsg(4326)?.transform(&mut at, target, 100.0)?;
    let world = worlds::metric_world_of(target, [at[0].x * dem.unit_m, at[0].y * dem.unit_m, about[2]])?;
    let outside = || format!("the camera lies outside {}", target.title());
    let posed = world.pose_of_tangent(about, pose).with_context(outside)?;
    let eye = world.to_map(&posed.centre).with_context(outside)?;
    // About the camera itself, as with poses on the map.
    let there = worlds::metric_world_of(target, eye)?;
    let posed = world.pose_to_map(&posed).and_then(|pose| there.pose_to_world(&pose)).with_context(outside)?;
    Ok((there, posed, eye))
}

/// Places of the map in the world, exact at nodes of the output's grid and at two heights, linear between.
pub(super) struct Lattice {
    nodes: Vec<[Vector3<f64>; 2]>,
    columns: usize,
}

const NODE_PX: f64 = 64.0;
const NODE_HEIGHT_M: f64 = 1000.0;

impl Lattice {
    /// # Errors
    /// Where the grid leaves the map.
    pub fn new(world: &World, grid: &Grid) -> Result<Self> {
        Self::of_nodes(grid, |place| {
            world.to_world(place).context("the orthophoto leaves the CRS; give a nearer model")
        })
    }

    /// The same; nothing is seen where the grid leaves the map.
    pub fn reaching_out(world: &World, grid: &Grid) -> Self {
        let nowhere = Vector3::repeat(f64::NAN);
        let all = Self::of_nodes(grid, |place| Ok::<_, Infallible>(world.to_world(place).unwrap_or(nowhere)));
        all.unwrap_or_else(|never| match never {})
    }

    fn of_nodes<E>(grid: &Grid, to_world: impl Fn([f64; 3]) -> Result<Vector3<f64>, E>) -> Result<Self, E> {
        let count = |n: u64| (n as f64 / NODE_PX).ceil() as usize + 1;
        let (columns, rows) = (count(grid.width), count(grid.height));
        let mut nodes = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let x = grid.x0 + grid.step_x * NODE_PX * i as f64;
                let y = grid.y0 + grid.step_y * NODE_PX * j as f64;
                nodes.push([to_world([x, y, 0.0])?, to_world([x, y, NODE_HEIGHT_M])?]);
            }
        }
        Ok(Lattice { nodes, columns })
    }

    pub fn at(&self, column: f64, row: f64, h: f64) -> Vector3<f64> {
        let (u, v) = (column / NODE_PX, row / NODE_PX);
        let (i, j) = (u.floor(), v.floor());
        let (a, b) = (u - i, v - j);
        let k = j as usize * self.columns + i as usize;
        let t = h / NODE_HEIGHT_M;
        let node = |k: usize| self.nodes[k][0] * (1.0 - t) + self.nodes[k][1] * t;
        let row = |k: usize| [node(k), node(k + 1)];
        by_weights([row(k), row(k + self.columns)], [a, b])
    }
}
