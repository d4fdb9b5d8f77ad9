//! The files of a rendered flight: frames, rough table, list of points, project, truth.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use autoref_flight::render::{Cover, Exposure, FrameRenderer, Landscape};
use autoref_flight::{Camera, Parameter};
use autoref_raster::atomic;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::{ReaderChoice, Written};
use autoref_synth::rng::Rng;
use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};
use nalgebra::{Rotation3, Vector3};
use serde_json::json;

use super::control::Point;

/// Rows that are rendered before they are written.
const BAND_ROWS: usize = 64;
/// Most pixels of an image of the ground that are held.
const MOST_COVER_PX: u64 = 200_000_000;

/// Writes a frame as tiled TIFF, whole or not at all.
pub fn write_frame(frame: &FrameRenderer<'_>, path: &Path) -> Result<()> {
    let (width, height) = (frame.camera.size_px[0] as usize, frame.camera.size_px[1] as usize);
    atomic::with_temporary(path, |temporary| {
        let failed = |e: gdal::errors::GdalError| autoref_raster::failed_to_write(path, &e.to_string());
        let watch = Written::watch(path);
        let mut options = RasterCreationOptions::new();
        for (name, value) in [("TILED", "YES"), ("COMPRESS", "DEFLATE"), ("PREDICTOR", "2"), ("BIGTIFF", "IF_SAFER")] {
            options.set_name_value(name, value).map_err(failed)?;
        }
        let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
        let dataset = driver
            .create_with_band_type_with_options::<u8, _>(temporary, width, height, frame.bands, &options)
            .map_err(failed)?;
        for top in (0..height).step_by(BAND_ROWS) {
            let rows = BAND_ROWS.min(height - top);
            let pixels = frame.rows(top, top + rows);
            for band in 0..frame.bands {
                let values = pixels.iter().skip(band).step_by(frame.bands).copied().collect();
                let mut buffer = Buffer::new((width, rows), values);
                let mut target = dataset.rasterband(band + 1).map_err(failed)?;
                target.write((0, top as isize), (width, rows), &mut buffer).map_err(failed)?;
            }
        }
        watch.close(dataset)
    })?;
    Ok(())
}

/// Writes the heights of a drawn landscape at the centres of its cells.
pub fn write_model(landscape: &Landscape, path: &Path) -> Result<()> {
    let (heights, columns, corner, step) = landscape.surface.cells();
    let rows = heights.len() / columns;
    atomic::with_temporary(path, |temporary| {
        let failed = |e: gdal::errors::GdalError| autoref_raster::failed_to_write(path, &e.to_string());
        let watch = Written::watch(path);
        let mut options = RasterCreationOptions::new();
        for (name, value) in [("TILED", "YES"), ("COMPRESS", "DEFLATE"), ("PREDICTOR", "3")] {
            options.set_name_value(name, value).map_err(failed)?;
        }
        let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
        let mut dataset = driver
            .create_with_band_type_with_options::<f32, _>(temporary, columns, rows, 1, &options)
            .map_err(failed)?;
        dataset.set_geo_transform(&[corner[0], step[0], 0.0, corner[1], 0.0, step[1]]).map_err(failed)?;
        let mut buffer = Buffer::new((columns, rows), heights.to_vec());
        dataset.rasterband(1).and_then(|mut band| band.write((0, 0), (columns, rows), &mut buffer)).map_err(failed)?;
        watch.close(dataset)
    })?;
    Ok(())
}

/// Reads an image of the ground whole; `unit_m` is a unit of its map in metres, in which the cover counts.
///
/// # Errors
/// When it has no georeference, is too large, or cannot be read.
pub fn read_cover(path: &Path, unit_m: f64) -> Result<Cover> {
    let source = autoref_raster::open(path, ReaderChoice::Auto, 0, 64 << 20)?;
    let info = source.info();
    if info.width * info.height > MOST_COVER_PX {
        bail!(
            "{}: {} x {} pixels; at most {MOST_COVER_PX} are held; cut it or make it coarser (gdal_translate -outsize)",
            path.display(),
            info.width,
            info.height
        );
    }
    let Some(transform) = info.geotransform else {
        bail!("{}: it has no georeference; give an orthophoto that lies on the map", path.display());
    };
    // The inverse of an affine map, by three places.
    let pixel = |e: f64, n: f64| transform.invert(MapPoint { easting: e, northing: n });
    let origin = transform.apply(PixelPoint { x: 0.0, y: 0.0 });
    let (e0, n0) = (origin.easting, origin.northing);
    let Some((east, north)) = pixel(e0 + 1.0, n0).zip(pixel(e0, n0 + 1.0)) else {
        bail!("{}: its georeference is singular", path.display());
    };
    let row = |east: f64, north: f64| [-east * e0 - north * n0, east / unit_m, north / unit_m];
    let ([x0, xe, xn], [y0, ye, yn]) = (row(east.x, north.x), row(east.y, north.y));
    let to_pixel = [x0, xe, xn, y0, ye, yn];
    let bands = if info.bands >= 3 { 3 } else { 1 };
    let (width, height) = (info.width as usize, info.height as usize);
    let white = f32::from(info.white.max(1));
    let mut data = Vec::with_capacity(width * height * bands);
    for top in (0..info.height).step_by(256) {
        let window = autoref_raster::window::Window::new(0, top, info.width, 256.min(info.height - top));
        let patch = autoref_raster::read_patch(source.as_ref(), window)?;
        for rgb in &patch.rgb {
            data.extend(rgb.iter().take(bands).map(|v| (255.0 * f32::from(*v) / white).min(255.0) as u8));
        }
    }
    Ok(Cover { data, width, height, bands, to_pixel, gsd_m: transform.scale() * unit_m })
}

/// Names of what is written beside the frames: the rough table, the points, the project, the truth.
pub const BESIDE: [&str; 4] = ["table.csv", "gcps.txt", "FLIGHT.toml", "truth.json"];
/// And of the elevation model of a drawn landscape.
pub const MODEL: &str = "dem.tif";

/// What is written beside the frames.
pub struct Flight<'a> {
    pub camera: &'a Camera,
    /// Added to the pixels of the list.
    pub offset_px: [f64; 2],
    pub exposures: &'a [Exposure],
    pub names: &'a [String],
    pub control: &'a [Point],
    pub ground_m: f64,
    /// Of GCPs on the ground and in the image.
    pub sigmas: [f64; 2],
    /// Of the rough table: metres and degrees.
    pub table_errors: [f64; 2],
    pub seed: u64,
}

impl Flight<'_> {
    /// Writes `table.csv`, `gcps.txt`, `FLIGHT.toml` and `truth.json`; all of them or none.
    pub fn write(&self, folder: &Path) -> Result<Vec<PathBuf>> {
        let mut transaction = atomic::Transaction::new();
        for (name, text) in BESIDE.into_iter().zip([self.table(), self.list(), self.project(), self.truth()]) {
            transaction.stage_bytes(&folder.join(name), text.as_bytes())?;
        }
        let paths = transaction.paths();
        transaction.commit()?;
        Ok(paths)
    }

    /// Positions and directions with errors.
    fn table(&self) -> String {
        let mut rng = Rng::new(self.seed, 0x7ab1e, 0);
        let mut text = String::from("name,x,y,z,yaw,pitch,roll\n");
        for (exposure, name) in self.exposures.iter().zip(self.names) {
            let mut shake = |sigma: f64| sigma * rng.normal();
            let turn = Vector3::from_fn(|_, _| shake(self.table_errors[1].to_radians()));
            let mut pose = exposure.pose;
            pose.rotation = Rotation3::new(turn).matrix() * pose.rotation;
            pose.centre += Vector3::from_fn(|_, _| shake(self.table_errors[0]));
            let (c, a) = (pose.centre, pose.yaw_pitch_roll());
            let row = format!("{:.2},{:.2},{:.2},{:.4},{:.4},{:.4}", c.x, c.y, c.z, a.yaw_deg, a.pitch_deg, a.roll_deg);
            writeln!(text, "{name},{row}").expect("a string takes all writes");
        }
        text
    }

    /// Points and observations as OpenDroneMap lists them.
    fn list(&self) -> String {
        let mut text = String::from("local\n");
        for point in self.control {
            let [x, y, z] = point.listed;
            for (frame, [u, v]) in &point.seen {
                let (frame, name) = (&self.names[*frame], &point.name);
                let (u, v) = (u + self.offset_px[0], v + self.offset_px[1]);
                writeln!(text, "{x:.3} {y:.3} {z:.3} {u:.3} {v:.3} {frame} {name}").expect("a string takes all writes");
            }
        }
        text
    }

    fn project(&self) -> String {
        let checks: Vec<&str> = self.control.iter().filter(|p| p.check).map(|p| p.name.as_str()).collect();
        let [cx, cy] = self.camera.pp_px();
        format!(
            "# A rendered flight; `truth.json` has what is right.\ncrs = \"local\"\n\n[frames]\nfolder = \"frames\"\npattern = [\"*.tif\"]\n\n\
             [camera]\nf_px = {:?}\npp_px = [{cx:?}, {cy:?}]\n\n[rough]\ntable = \"table.csv\"\nsigma_m = {:?}\nground_m = {:.1}\n\n\
             [gcps]\nlist = \"gcps.txt\"\nsigma_ground_m = {:?}\nsigma_image_px = {:?}\ncheck = {checks:?}\n",
            self.camera.f_px(),
            self.table_errors[0].max(1.0),
            self.ground_m,
            self.sigmas[0].max(0.001),
            self.sigmas[1].max(0.01),
        )
    }

    fn truth(&self) -> String {
        let lens: serde_json::Map<String, serde_json::Value> = Parameter::ALL
            .into_iter()
            .filter(|p| !matches!(p, Parameter::F | Parameter::Aspect | Parameter::Cx | Parameter::Cy))
            .filter(|p| self.camera.get(*p) != 0.0)
            .map(|p| (p.name().to_owned(), self.camera.get(p).into()))
            .collect();
        let images: Vec<serde_json::Value> = self
            .exposures
            .iter()
            .zip(self.names)
            .map(|(exposure, name)| {
                let (pose, angles) = (&exposure.pose, exposure.pose.yaw_pitch_roll());
                let rows: Vec<Vec<f64>> = pose.rotation.row_iter().map(|row| row.iter().copied().collect()).collect();
                json!({"name": name, "C": pose.centre.as_slice(), "R": rows, "yaw_deg": angles.yaw_deg,
                    "pitch_deg": angles.pitch_deg, "roll_deg": angles.roll_deg})
            })
            .collect();
        let points: Vec<serde_json::Value> =
            self.control.iter().map(|p| json!({"name": p.name, "check": p.check, "xyz": p.truth})).collect();
        let document = json!({
            "crs": "local",
            "pixels": "from the outer corner of the first pixel",
            "size_px": self.camera.size_px,
            "f_px": self.camera.f_px(),
            "pp_px": self.camera.pp_px(),
            "distortion": lens,
            "images": images,
            "points": points,
        });
        serde_json::to_string_pretty(&document).expect("plain data") + "\n"
    }
}
