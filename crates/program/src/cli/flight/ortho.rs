//! `flight orthorectify`: one frame over an elevation model.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use autoref_elevation::grid::Grid;
use autoref_elevation::output::{self, Form};
use autoref_flight::ortho::{Place, Surface, View};
use autoref_flight::read::{self, same_image, tables};
use autoref_flight::world::World;
use autoref_flight::{Camera, Error, Pose};
use autoref_raster::atomic::Existing;
use autoref_raster::bounded;
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::error::{Error as RasterError, Result as RasterResult};
use autoref_raster::window::Window;
use gdal::Dataset;
use gdal::raster::{Buffer, ColorInterpretation, GdalDataType, GdalType, RasterCreationOptions, ResampleAlg};
use nalgebra::{Matrix3, Vector3};
use serde_json::json;

use super::{camera_file, check_output, lists, set_interior};
use crate::cli::dem::ResourceArgs;

/// Map a frame onto the ground over an elevation model: a Cloud Optimized GeoTIFF in the model's CRS.
#[derive(Debug, clap::Args)]
pub struct OrthorectifyArgs {
    /// The frame.
    frame: PathBuf,
    /// Elevation model, north up; the orthophoto takes its CRS.
    #[arg(long, value_name = "DEM")]
    dem: PathBuf,
    /// Where the frame was taken from: the result of `solve`, `adjust` or `resect`, any reconstruction in map
    /// coordinates, or a camera table. Default: cameras.json beside the frame.
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    /// With a camera table: the interior, as for `resect`.
    #[arg(long, value_name = "FILE")]
    camera: Option<PathBuf>,
    /// Focal length in pixels, in place of the file's.
    #[arg(long, value_name = "PX")]
    f_px: Option<f64>,
    /// Principal point. Default: the file's, else the image's centre.
    #[arg(long, value_name = "X,Y", value_delimiter = ',')]
    pp_px: Option<Vec<f64>>,
    /// Distortion, such as k1=-0.13,k2=0.39.
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    distortion: Vec<String>,
    /// CRS of the cameras. Default: what their file says, else the elevation model's.
    #[arg(long, value_name = "CRS")]
    crs: Option<String>,
    /// Pixel size on the ground, in units of the CRS. Default: the median size of the frame's pixels across the view.
    #[arg(long, value_name = "M")]
    gsd: Option<f64>,
    /// The orthophoto. Default: FRAME_ortho.tif.
    #[arg(short, long, value_name = "TIF")]
    output: Option<PathBuf>,
    /// Replace an existing output.
    #[arg(long)]
    overwrite: bool,
    /// Print what was done as JSON.
    #[arg(long)]
    pub(super) json: bool,
    #[command(flatten)]
    resources: ResourceArgs,
}

/// The model's part that matters, and what it is called.
pub(in crate::cli) struct Dem {
    dataset: Dataset,
    pub grid: Grid,
    crs: Option<Crs>,
}

fn open(path: &Path) -> Result<Dataset> {
    Dataset::open(path).map_err(|e| RasterError::gdal(path, e).into())
}

impl Dem {
    pub fn open(path: &Path) -> Result<Self> {
        let dataset = open(path)?;
        let (columns, rows) = dataset.raster_size();
        let transform = dataset.geo_transform().map_err(|_| {
            RasterError::unsupported(path, "an elevation model without georeference", "give one that lies on the map")
        })?;
        let grid = Grid::new(&autoref_raster::coords::GeoTransform(transform), columns as u64, rows as u64);
        let grid = grid.ok_or_else(|| {
            RasterError::unsupported(path, "a rotated elevation model", "warp it to north up with gdalwarp")
        })?;
        let crs = match dataset.spatial_ref().and_then(|s| s.to_wkt()) {
            Ok(wkt) if !wkt.is_empty() => Some(Crs::parse(&wkt)?),
            _ => None,
        };
        if crs.as_ref().is_some_and(Crs::is_geographic) {
            let remedy = "project it first (gdalwarp -t_srs)";
            return Err(RasterError::unsupported(path, "an elevation model in degrees", remedy).into());
        }
        Ok(Dem { dataset, grid, crs })
    }

    /// Heights of a window, thinned to at most `most` cells.
    pub fn surface(&self, path: &Path, window: Window, most: u64) -> Result<Surface> {
        let thin = ((window.area() as f64 / most as f64).sqrt().ceil() as u64).max(1);
        let size = (window.width.div_ceil(thin) as usize, window.height.div_ceil(thin) as usize);
        let band = self.dataset.rasterband(1).map_err(|e| RasterError::gdal(path, e))?;
        let from = ((window.x as isize, window.y as isize), (window.width as usize, window.height as usize));
        let how = (thin > 1).then_some(ResampleAlg::NearestNeighbour);
        let mut heights = band
            .read_as::<f32>(from.0, from.1, size, how)
            .map_err(|e| RasterError::gdal(path, e))?
            .into_shape_and_vec()
            .1;
        let nodata = band.no_data_value().map(|v| v as f32);
        for h in &mut heights {
            if Some(*h) == nodata || !h.is_finite() {
                *h = f32::NAN;
            }
        }
        let g = &self.grid;
        let step = [g.step_x * window.width as f64 / size.0 as f64, g.step_y * window.height as f64 / size.1 as f64];
        let corner = [g.x0 + g.step_x * window.x as f64, g.y0 + g.step_y * window.y as f64];
        Surface::new(heights, size.0, corner, step)
            .ok_or_else(|| Error::no_result(format!("{}: no cell has a height", path.display()), "give another").into())
    }

    /// The cells of a box of the map, with a margin, cut at the model's border.
    fn window(&self, bounds: [f64; 4], margin: f64) -> Window {
        let g = &self.grid;
        let column = |x: f64| (x - g.x0) / g.step_x;
        let row = |y: f64| (y - g.y0) / g.step_y;
        let cut = |a: f64, b: f64, n: u64| {
            let (low, high) = (a.min(b) - margin, a.max(b) + margin);
            let low = (low.floor().max(0.0) as u64).min(n - 1);
            (low, (high.ceil().max(0.0) as u64).clamp(low + 1, n))
        };
        let (x0, x1) = cut(column(bounds[0]), column(bounds[2]), g.width);
        let (y0, y1) = cut(row(bounds[1]), row(bounds[3]), g.height);
        Window::new(x0, y0, x1 - x0, y1 - y0)
    }
}

/// The frame's camera and pose in map coordinates, and the CRS that its file states.
fn posed(args: &OrthorectifyArgs, name: &str, size: [f64; 2]) -> Result<(Camera, Pose, Option<String>)> {
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
    let table = file.extension().and_then(|e| e.to_str()).is_some_and(|e| ["csv", "txt", "tsv"].contains(&e))
        && file.file_name().and_then(|n| n.to_str()).is_none_or(|n| !known.contains(&n));
    let (mut camera, pose, crs) = if table {
        let rows = tables::cameras(&file)?;
        let Some(i) = same_image(name, rows.iter().map(|r| r.name.as_str())) else {
            bail!("{}: has no row of `{name}`", file.display())
        };
        let Some(pose) = rows[i].pose(None) else {
            bail!("{}: the row of `{name}` states no direction (yaw and pitch, or omega, phi, kappa)", file.display())
        };
        let camera = match &args.camera {
            Some(path) => camera_file(path, name)?,
            None if args.f_px.is_some() => Camera::pinhole(name, size, 1.0, [size[0] / 2.0, size[1] / 2.0]),
            None => bail!("{}: a table has no interior; give --f-px or --camera", file.display()),
        };
        (camera, pose, None)
    } else {
        let model = read::reconstruction(&file)?;
        let Some(i) = model.find(name) else { bail!("{}: has no frame `{name}`", file.display()) };
        let text = bounded::read_to_string(&file, "cameras", bounded::DOCUMENT_BYTES).unwrap_or_default();
        let stated = serde_json::from_str::<serde_json::Value>(&text).ok();
        let crs = stated.and_then(|d| d.get("crs")?.as_str().map(str::to_string));
        (model.cameras[model.photographs[i].camera].clone(), model.photographs[i].pose, crs)
    };
    set_interior(&mut camera, args.f_px, args.pp_px.as_deref(), &args.distortion)?;
    if camera.size_px != size {
        // The camera of a frame of another size: the same lens, other pixels.
        let (across, down) = (size[0] / camera.size_px[0], size[1] / camera.size_px[1]);
        if (across / down - 1.0).abs() > 1e-3 || camera.polynomial.is_some() {
            bail!(
                "{}: is {} x {} px, its camera {} x {}; give the frame that was measured",
                args.frame.display(),
                size[0],
                size[1],
                camera.size_px[0],
                camera.size_px[1]
            );
        }
        use autoref_flight::Parameter::{Cx, Cy, F};
        for p in [F, Cx, Cy] {
            camera.set(p, camera.get(p) * across);
        }
        camera.size_px = size;
    }
    Ok((camera, pose, crs))
}

/// The world about the camera in the model's CRS, the pose in it, and the camera's place in the map.
fn place(dem: &Dem, pose: &Pose, crs: Option<&str>) -> Result<(World, Pose, [f64; 3])> {
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
    let there = [at[0].x, at[0].y, eye[2]];
    // Both stand on the same point of the ellipsoid: their tangent frames are one.
    let posed = lists::world_of(Some(&from), eye)?.pose_to_world(pose);
    let posed = posed.with_context(|| format!("the camera lies outside {}", from.title()))?;
    Ok((lists::world_of(Some(target), there)?, posed, there))
}

/// Places of the map in the world, exact at nodes of the output's grid and at two heights, linear between.
struct Lattice {
    nodes: Vec<[Vector3<f64>; 2]>,
    columns: usize,
}

const NODE_PX: f64 = 64.0;
const NODE_HEIGHT_M: f64 = 1000.0;

impl Lattice {
    fn new(world: &World, grid: &Grid) -> Result<Self> {
        let count = |n: u64| (n as f64 / NODE_PX).ceil() as usize + 1;
        let (columns, rows) = (count(grid.width), count(grid.height));
        let mut nodes = Vec::with_capacity(columns * rows);
        for j in 0..rows {
            for i in 0..columns {
                let x = grid.x0 + grid.step_x * NODE_PX * i as f64;
                let y = grid.y0 + grid.step_y * NODE_PX * j as f64;
                let at =
                    |h: f64| world.to_world([x, y, h]).context("the orthophoto leaves the CRS; give a nearer model");
                nodes.push([at(0.0)?, at(NODE_HEIGHT_M)?]);
            }
        }
        Ok(Lattice { nodes, columns })
    }

    fn at(&self, column: f64, row: f64, h: f64) -> Vector3<f64> {
        let (u, v) = (column / NODE_PX, row / NODE_PX);
        let (i, j) = (u.floor(), v.floor());
        let (a, b) = (u - i, v - j);
        let k = j as usize * self.columns + i as usize;
        let t = h / NODE_HEIGHT_M;
        let node = |k: usize| self.nodes[k][0] * (1.0 - t) + self.nodes[k][1] * t;
        (node(k) * (1.0 - a) + node(k + 1) * a) * (1.0 - b)
            + (node(k + self.columns) * (1.0 - a) + node(k + self.columns + 1) * a) * b
    }
}

/// Where the frame's rays meet the ground: the box of the map, and the median ground size of a pixel across the view.
fn footprint(view: &View<'_>, grid_axes: &Matrix3<f64>) -> Option<([f64; 4], f64)> {
    const RAYS: usize = 48;
    let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    let mut sizes = Vec::new();
    let size = view.camera.size_px;
    for j in 0..=RAYS {
        for i in 0..=RAYS {
            let pixel = [size[0] * i as f64 / RAYS as f64, size[1] * j as f64 / RAYS as f64];
            let Some(ray) = view.camera.ray(pixel) else { continue };
            let d = grid_axes.transpose() * (view.pose.rotation.transpose() * Vector3::from(ray));
            let Some(at) = view.surface.meets(view.eye, d.into(), view.sag) else { continue };
            bounds = [bounds[0].min(at[0]), bounds[1].min(at[1]), bounds[2].max(at[0]), bounds[3].max(at[1])];
            let distance = (Vector3::from(at) - Vector3::from(view.eye)).norm();
            sizes.push(distance * ray[2] / view.camera.f_px());
        }
    }
    sizes.sort_by(f64::total_cmp);
    let middle = *sizes.get(sizes.len() / 2)?;
    // Between the rays the outline may reach further.
    let more = [(bounds[2] - bounds[0]) / RAYS as f64, (bounds[3] - bounds[1]) / RAYS as f64];
    Some(([bounds[0] - more[0], bounds[1] - more[1], bounds[2] + more[0], bounds[3] + more[1]], middle))
}

pub fn run(args: &OrthorectifyArgs) -> Result<ExitCode> {
    if args.pp_px.as_ref().is_some_and(|p| p.len() != 2) {
        bail!("--pp-px: 2 numbers with a comma between them are expected");
    }
    if args.gsd.is_some_and(|g| !(g > 0.0 && g.is_finite())) {
        bail!("--gsd: a positive number is expected");
    }
    let out = args.output.clone().unwrap_or_else(|| {
        let stem = args.frame.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        PathBuf::from(format!("{stem}_ortho.tif"))
    });
    check_output(Some(&out), Existing::of_flag(args.overwrite))?;
    let frame = open(&args.frame)?;
    let (columns, rows) = frame.raster_size();
    let name = args.frame.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let (camera, pose, stated) = posed(args, &name, [columns as f64, rows as f64])?;
    let dem = Dem::open(&args.dem)?;
    let (world, pose, eye) = place(&dem, &pose, args.crs.as_deref().or(stated.as_deref()))?;
    let sag = if matches!(world, World::Flat { .. }) { 0.0 } else { 0.5 / 6_371_000.0 };
    let axes = world.grid(eye).unwrap_or_else(Matrix3::identity);
    let reach = camera.reach();
    let no_ground = || {
        Error::no_result(
            format!("{}: none of its rays meets {}", args.frame.display(), args.dem.display()),
            "check the CRS, the camera's position and direction, and the area of the model",
        )
    };
    let resources = args.resources.resources();
    let budget = resources.memory_budget_bytes;
    // The outline from a thinned model, then the model where it matters: below the frame and between it and the camera.
    let all = Window::new(0, 0, dem.grid.width, dem.grid.height);
    let coarse = dem.surface(&args.dem, all, 4_000_000)?;
    let view = View { camera: &camera, pose, eye, surface: &coarse, sag, reach };
    let (bounds, across) = footprint(&view, &axes).ok_or_else(no_ground)?;
    let dem_bounds = dem.grid.bounds();
    let bounds = [
        bounds[0].max(dem_bounds[0]),
        bounds[1].max(dem_bounds[1]),
        bounds[2].min(dem_bounds[2]),
        bounds[3].min(dem_bounds[3]),
    ];
    let with_eye = [bounds[0].min(eye[0]), bounds[1].min(eye[1]), bounds[2].max(eye[0]), bounds[3].max(eye[1])];
    let part = dem.window(with_eye, 4.0);
    let needed = part.area() * 4;
    if needed > budget / 3 {
        return Err(RasterError::Limit {
            what: format!("{}: the part between camera and footprint", args.dem.display()),
            needed,
            allowed: budget / 3,
            remedy: "raise --memory, or thin the model with gdal_translate -outsize".into(),
        }
        .into());
    }
    drop(coarse);
    let surface = dem.surface(&args.dem, part, u64::MAX)?;
    let view = View { camera: &camera, pose, eye, surface: &surface, sag, reach };
    let gsd = args.gsd.unwrap_or(across / dem.crs.as_ref().map_or(1.0, Crs::metres_per_unit));
    // Corners at multiples of the pixel: orthophotos of neighbours share one grid.
    let low = [(bounds[0] / gsd).floor(), (bounds[1] / gsd).floor()];
    let high = [(bounds[2] / gsd).ceil(), (bounds[3] / gsd).ceil()];
    let (width, height) = ((high[0] - low[0]).max(1.0), (high[1] - low[1]).max(1.0));
    if width > 1e6 || height > 1e6 {
        bail!("--gsd {gsd}: {width} x {height} px would come out; give a larger one");
    }
    let grid = Grid {
        x0: low[0] * gsd,
        y0: high[1] * gsd,
        step_x: gsd,
        step_y: -gsd,
        width: width as u64,
        height: height as u64,
    };
    let lattice = Lattice::new(&world, &grid)?;
    let oversampling = ((gsd / across).round() as usize).clamp(1, 8);
    let job = Job {
        args,
        view: &view,
        lattice: &lattice,
        grid,
        oversampling,
        threads: resources.threads,
        tile_px: resources.tile_px.unwrap_or(1024),
        budget,
    };
    let wkt = dem.crs.as_ref().map_or("", Crs::wkt);
    let first = frame.rasterband(1).map_err(|e| RasterError::gdal(&args.frame, e))?.band_type();
    drop(frame);
    let seen = match first {
        GdalDataType::UInt8 => job.write::<u8>(&out, wkt, Some(255.0))?,
        GdalDataType::UInt16 => job.write::<u16>(&out, wkt, Some(65535.0))?,
        _ => job.write::<f32>(&out, wkt, None)?,
    };
    if seen == 0 {
        eprintln!("autoref-stream: no pixel of the orthophoto is seen by the frame");
    }
    if args.json {
        let document = json!({
            "output": out.display().to_string(), "width": grid.width, "height": grid.height, "gsd": gsd,
            "bounds": grid.bounds(), "pixels_seen": seen, "frame": name, "camera": eye,
        });
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        println!("{}: {} x {} px of {gsd:.4}", out.display(), grid.width, grid.height);
    }
    Ok(ExitCode::SUCCESS)
}

struct Job<'a> {
    args: &'a OrthorectifyArgs,
    view: &'a View<'a>,
    lattice: &'a Lattice,
    grid: Grid,
    /// Samples a side in a pixel.
    oversampling: usize,
    threads: usize,
    tile_px: u64,
    budget: u64,
}

/// A number of the frame and back; rounding where the type is whole.
trait Sample: GdalType + Copy + Default + Send {
    const NONE: Self;
    fn of(v: f32) -> Self;
}

impl Sample for u8 {
    const NONE: Self = 0;
    fn of(v: f32) -> Self {
        v.round().clamp(0.0, 255.0) as u8
    }
}
impl Sample for u16 {
    const NONE: Self = 0;
    fn of(v: f32) -> Self {
        v.round().clamp(0.0, 65535.0) as u16
    }
}
impl Sample for f32 {
    const NONE: Self = f32::NAN;
    fn of(v: f32) -> Self {
        v
    }
}

impl Job<'_> {
    /// Writes the orthophoto with an alpha band of `alpha` where it is seen, or without one with NaN where it is not.
    fn write<T: Sample>(&self, out: &Path, wkt: &str, alpha: Option<f32>) -> Result<u64> {
        let frame = open(&self.args.frame)?;
        let bands = (1..=frame.raster_count()).filter(|b| {
            let interpretation = frame.rasterband(*b).map(|b| b.color_interpretation());
            !matches!(interpretation, Ok(ColorInterpretation::AlphaBand))
        });
        let bands: Vec<usize> = bands.collect();
        drop(frame);
        let form = Form {
            grid: self.grid,
            wkt,
            bands: bands.len() + usize::from(alpha.is_some()),
            nodata: alpha.is_none().then_some(f64::NAN),
            predictor: if alpha.is_some() { 2 } else { 3 },
            threads: self.threads,
        };
        let mut seen = 0u64;
        autoref_raster::atomic::with_temporary(out, |temporary| {
            let plain = temporary.with_extension("plain.tif");
            let result = self
                .stream::<T>(&plain, &form, &bands, alpha, &mut seen)
                .and_then(|()| cloud_optimised(&plain, temporary, self.threads));
            let _ = std::fs::remove_file(&plain);
            result
        })?;
        Ok(seen)
    }

    fn stream<T: Sample>(
        &self,
        plain: &Path,
        form: &Form<'_>,
        bands: &[usize],
        alpha: Option<f32>,
        seen: &mut u64,
    ) -> RasterResult<()> {
        let dataset = output::create::<T>(plain, form)?;
        if alpha.is_some() {
            let mut band = dataset.rasterband(form.bands).map_err(|e| RasterError::gdal(plain, e))?;
            band.set_color_interpretation(ColorInterpretation::AlphaBand).map_err(|e| RasterError::gdal(plain, e))?;
        }
        output::produce(
            &self.grid,
            self.tile_px,
            self.threads,
            || None,
            |source: &mut Option<Dataset>, window| {
                if source.is_none() {
                    let path = &self.args.frame;
                    *source = Some(Dataset::open(path).map_err(|e| RasterError::gdal(path, e))?);
                }
                let Some(frame) = source.as_ref() else { return Ok((Vec::new(), 0)) };
                let mut values = vec![T::NONE; window.area() as usize * form.bands];
                let count = self.tile::<T>(frame, bands, alpha, window, window, &mut values)?;
                Ok((values, count))
            },
            |window, (values, count)| {
                *seen += count;
                output::put(plain, &dataset, window, &values)
            },
        )?;
        output::finish(plain, dataset)
    }

    /// Fills `part` of the tile `whole`; a part that needs too much of the frame at once is done in halves.
    fn tile<T: Sample>(
        &self,
        frame: &Dataset,
        bands: &[usize],
        alpha: Option<f32>,
        whole: Window,
        part: Window,
        values: &mut [T],
    ) -> RasterResult<u64> {
        let n = self.oversampling;
        let mut places: Vec<[f32; 2]> = Vec::with_capacity(part.area() as usize * n * n);
        let mut bounds = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
        for y in part.y..part.bottom() {
            for x in part.x..part.right() {
                for k in 0..n * n {
                    let column = x as f64 + ((k % n) as f64 + 0.5) / n as f64;
                    let row = y as f64 + ((k / n) as f64 + 0.5) / n as f64;
                    let map = [self.grid.x0 + self.grid.step_x * column, self.grid.y0 + self.grid.step_y * row];
                    let place = self.view.at(map[0], map[1], |h| self.lattice.at(column, row, h));
                    let pixel = if let Place::Pixel(p) = place { [p[0] as f32, p[1] as f32] } else { [f32::NAN; 2] };
                    if !pixel[0].is_nan() {
                        bounds = [
                            bounds[0].min(pixel[0]),
                            bounds[1].min(pixel[1]),
                            bounds[2].max(pixel[0]),
                            bounds[3].max(pixel[1]),
                        ];
                    }
                    places.push(pixel);
                }
            }
        }
        if bounds[0] > bounds[2] {
            return Ok(0);
        }
        let (columns, rows) = frame.raster_size();
        let low = |v: f32| (f64::from(v) - 3.0).floor().max(0.0) as usize;
        let (x0, y0) = (low(bounds[0]), low(bounds[1]));
        let (x1, y1) = ((bounds[2] as usize + 4).min(columns), (bounds[3] as usize + 4).min(rows));
        let size = (x1 - x0, y1 - y0);
        let most = self.budget / 4 / self.threads.max(1) as u64;
        if (size.0 * size.1 * bands.len() * 4) as u64 > most && part.area() > 1 {
            let halves = if part.width >= part.height {
                let w = part.width / 2;
                [
                    Window::new(part.x, part.y, w, part.height),
                    Window::new(part.x + w, part.y, part.width - w, part.height),
                ]
            } else {
                let h = part.height / 2;
                [
                    Window::new(part.x, part.y, part.width, h),
                    Window::new(part.x, part.y + h, part.width, part.height - h),
                ]
            };
            drop(places);
            let mut seen = 0;
            for half in halves {
                seen += self.tile(frame, bands, alpha, whole, half, values)?;
            }
            return Ok(seen);
        }
        let path = &self.args.frame;
        let failed = |e| RasterError::gdal(path, e);
        let mut planes = Vec::new();
        for b in bands {
            let band = frame.rasterband(*b).map_err(failed)?;
            let read: Buffer<f32> = band.read_as((x0 as isize, y0 as isize), size, size, None).map_err(failed)?;
            planes.push((read.into_shape_and_vec().1, band.no_data_value().map(|v| v as f32)));
        }
        let area = whole.area() as usize;
        let mut count = 0;
        for (index, samples) in places.chunks_exact(n * n).enumerate() {
            let (x, y) = (part.x + index as u64 % part.width, part.y + index as u64 / part.width);
            let at = ((y - whole.y) * whole.width + x - whole.x) as usize;
            let mut visible = false;
            for (k, (plane, nodata)) in planes.iter().enumerate() {
                let (mut sum, mut weight) = (0.0f32, 0.0f32);
                for p in samples.iter().filter(|p| !p[0].is_nan()) {
                    if let Some(v) = cubic(plane, size, [p[0] - x0 as f32, p[1] - y0 as f32], *nodata) {
                        sum += v;
                        weight += 1.0;
                    }
                }
                if weight > 0.0 {
                    values[k * area + at] = T::of(sum / weight);
                    visible = true;
                }
            }
            if visible {
                count += 1;
                if let Some(opaque) = alpha {
                    values[planes.len() * area + at] = T::of(opaque);
                }
            }
        }
        Ok(count)
    }
}

/// Keys' cubic convolution (1981, a = −1/2) at a place that counts from the outer corner; the nearest pixel beside
/// nodata. Beyond the window's border its last pixels go on: windows reach further than the kernel except at the
/// frame's own border.
fn cubic(plane: &[f32], size: (usize, usize), at: [f32; 2], nodata: Option<f32>) -> Option<f32> {
    let valid = |v: f32| !v.is_nan() && Some(v) != nodata;
    let (u, v) = (at[0] - 0.5, at[1] - 0.5);
    let (i, j) = (u.floor(), v.floor());
    let weights = |t: f32| {
        let (t2, t3) = (t * t, t * t * t);
        [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3]
    };
    let (wx, wy) = (weights(u - i), weights(v - j));
    let clamp = |v: f32, n: usize| (v.max(0.0) as usize).min(n - 1);
    let pixel = |x: f32, y: f32| plane[clamp(y, size.1) * size.0 + clamp(x, size.0)];
    let (mut sum, mut low, mut high) = (0.0, f32::MAX, f32::MIN);
    for (b, wy) in wy.iter().enumerate() {
        for (a, wx) in wx.iter().enumerate() {
            let value = pixel(i + a as f32 - 1.0, j + b as f32 - 1.0);
            if !valid(value) {
                let nearest = pixel((u + 0.5).floor(), (v + 0.5).floor());
                return valid(nearest).then_some(nearest);
            }
            (low, high) = (low.min(value), high.max(value));
            sum += wx * wy * value;
        }
    }
    // No ringing beside edges.
    Some(sum.clamp(low, high))
}

/// The tiled copy as a Cloud Optimized GeoTIFF with overviews.
fn cloud_optimised(plain: &Path, out: &Path, threads: usize) -> RasterResult<()> {
    let failed = |e: gdal::errors::GdalError| RasterError::gdal(out, e);
    let source = Dataset::open(plain).map_err(failed)?;
    let threads = format!("NUM_THREADS={}", threads.max(1));
    let options = RasterCreationOptions::from_iter([
        "COMPRESS=DEFLATE",
        "PREDICTOR=YES",
        "BIGTIFF=IF_SAFER",
        "RESAMPLING=AVERAGE",
        &threads,
    ]);
    let driver = gdal::DriverManager::get_driver_by_name("COG").map_err(failed)?;
    let watch = autoref_raster::Written::watch(out);
    let copy = source.create_copy(&driver, out, &options).map_err(failed)?;
    watch.close(copy)
}
