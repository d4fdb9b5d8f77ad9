//! Scanned film with known truth: frames of a camera with marks at known places, and everything that makes them hard.
//!
//! A [`FilmSpec`] says what to draw, [`FilmScene`] draws any window of it on demand and is a [`RasterSource`], so that
//! a frame of 13,000² pixels costs only the windows that are looked at; [`write_film`] streams it into a TIFF.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use serde::{Deserialize, Serialize};

mod render;

use crate::interior::Pose;
use crate::template::Model;
use crate::types::Camera;
use crate::window::grey_info;
use autoref_raster::bilinear::by_differences;
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::error::{Error, Result};
use autoref_raster::window::Window;
use autoref_raster::{Block, Piece, PieceData, RasterInfo, RasterSource, ReadStats, ReaderChoice, SampleType};
use autoref_synth::rng::Rng;
use render::{Damage, Painter};

/// What the film shows under the marks.
#[derive(Clone, Debug, Default)]
pub enum FilmGround {
    /// A landscape of noise.
    #[default]
    Noise,
    /// A part of one of these grey photographs, drawn by the frame's seed.
    Photos(Vec<Arc<GreyPhoto>>),
    /// The very picture that the camera exposed.
    Exposed(Exposed),
}

/// A picture and its place on the film.
#[derive(Clone, Debug)]
pub struct Exposed {
    pub photo: Arc<GreyPhoto>,
    /// Outer corner of its first pixel, film millimetres, y down.
    pub corner_mm: [f64; 2],
    pub pixel_mm: f64,
}

impl Exposed {
    /// Grey at a place of the film, 0 to 1, bilinear; beyond the picture its border goes on.
    fn at(&self, film_mm: [f64; 2]) -> f32 {
        let GreyPhoto { width, height, data } = self.photo.as_ref();
        let [u, v] = [0, 1].map(|k| (film_mm[k] - self.corner_mm[k]) / self.pixel_mm - 0.5);
        let (i, j) = (u.floor(), v.floor());
        let (fx, fy) = ((u - i) as f32, (v - j) as f32);
        let value = |x: f64, y: f64| {
            let (x, y) = (x.clamp(0.0, *width as f64 - 1.0) as usize, y.clamp(0.0, *height as f64 - 1.0) as usize);
            f32::from(data[y * width + x])
        };
        let line = |y: f64| [value(i, y), value(i + 1.0, y)];
        by_differences([line(j), line(j + 1.0)], [fx, fy]) / 255.0
    }
}

/// A photograph as 8-bit grey.
#[derive(Debug)]
pub struct GreyPhoto {
    pub width: usize,
    pub height: usize,
    pub data: Vec<u8>,
}

impl FilmGround {
    /// Decodes photographs to grey; the scratch cost is their pixels in memory.
    ///
    /// # Errors
    /// Those of [`autoref_raster::open`] and of reading.
    pub fn open(paths: &[PathBuf]) -> Result<FilmGround> {
        paths.iter().map(|p| GreyPhoto::open(p).map(Arc::new)).collect::<Result<Vec<_>>>().map(FilmGround::Photos)
    }
}

impl GreyPhoto {
    /// # Errors
    /// Those of [`autoref_raster::open`] and of reading.
    pub fn open(path: &Path) -> Result<GreyPhoto> {
        let source = autoref_raster::open(path, ReaderChoice::Auto, 0, 64 << 20)?;
        let info = source.info().clone();
        let (width, height) = (info.width as usize, info.height as usize);
        let mut data = vec![0u8; width * height];
        let white = u32::from(info.white.max(1));
        let mut top = 0;
        while top < info.height {
            let band = Window::new(0, top, info.width, 256.min(info.height - top));
            let patch = autoref_raster::read_patch(source.as_ref(), band)?;
            let out = &mut data[top as usize * width..][..patch.rgb.len()];
            for (o, [r, g, b]) in out.iter_mut().zip(&patch.rgb) {
                let luma = 299 * u32::from(*r) + 587 * u32::from(*g) + 114 * u32::from(*b);
                *o = (luma / 1000 * 255 / white).min(255) as u8;
            }
            top = band.bottom();
        }
        Ok(GreyPhoto { width, height, data })
    }
}

/// One frame to draw.
#[derive(Clone, Debug)]
pub struct FilmSpec {
    pub camera: Camera,
    pub seed: u64,
    /// Size of a scanned pixel on the film.
    pub pixel_um: f64,
    /// 8 or 16.
    pub bits: u8,
    /// Quarters of a turn, clockwise.
    pub quarters: u8,
    pub mirrored: Handedness,
    /// Further small turn, degrees clockwise.
    pub rotation_deg: f64,
    /// Shift of the film in the scan, millimetres, right and down.
    pub offset_mm: [f64; 2],
    /// Scanner glass around the film, millimetres.
    pub margin_mm: f64,
    /// σ of each mark about its calibrated place on the film (certificate and film), micrometres.
    pub jitter_um: f64,
    /// Shear of the film, relative.
    pub shear: f64,
    /// Brightness of everything: 1 normal, 0.15 a very dark frame, 2 a saturated one.
    pub gain: f64,
    /// Loss of light in the image's corners, 0 to 1.
    pub vignette: f64,
    /// Amplitude of horizontal bands, of white.
    pub banding: f64,
    /// σ of grain and scanner, of white.
    pub noise: f64,
    /// Numbers of each.
    pub scratches: usize,
    pub dust: usize,
    pub text_boxes: usize,
    /// Cut away from the scan's edges, millimetres: left, top, right, bottom.
    pub crop_mm: [f64; 4],
}

impl FilmSpec {
    /// A clean, upright frame.
    pub fn plain(camera: &Camera, pixel_um: f64, seed: u64) -> FilmSpec {
        FilmSpec {
            camera: camera.clone(),
            seed,
            pixel_um,
            bits: 8,
            quarters: 0,
            mirrored: Handedness::AsIs,
            rotation_deg: 0.0,
            offset_mm: [0.0; 2],
            margin_mm: 0.0,
            jitter_um: 3.0,
            shear: 0.0,
            gain: 1.0,
            vignette: 0.2,
            banding: 0.0,
            noise: 0.01,
            scratches: 0,
            dust: 0,
            text_boxes: 0,
            crop_mm: [0.0; 4],
        }
    }

    /// A frame of an archive: everything at random, an eighth of the frames very dark, a twelfth saturated, a sixteenth
    /// cropped through a mark.
    pub fn archive(camera: &Camera, pixel_um: f64, seed: u64) -> FilmSpec {
        let mut r = Rng::new(seed, 0xf1, 0);
        let mut spec = FilmSpec::plain(camera, pixel_um, seed);
        spec.bits = if r.chance(0.3) { 16 } else { 8 };
        spec.rotation_deg = r.normal().clamp(-2.5, 2.5) * 0.6;
        spec.margin_mm = r.range(0.0, 4.0);
        let shift = 0.15 + 0.4 * spec.margin_mm;
        spec.offset_mm = [r.normal(), r.normal()].map(|v| v.clamp(-2.0, 2.0) * shift);
        spec.pixel_um *= 1.0 + 0.01 * r.normal().clamp(-2.0, 2.0);
        spec.jitter_um = 5.0;
        spec.shear = 1e-4 * r.normal();
        spec.gain = match r.unit() {
            u if u < 0.125 => r.range(0.12, 0.35),
            u if u < 0.208 => r.range(1.5, 2.2),
            _ => r.range(0.7, 1.2),
        };
        spec.vignette = r.range(0.0, 0.6);
        spec.banding = if r.chance(0.3) { r.range(0.003, 0.02) } else { 0.0 };
        spec.noise = r.range(0.004, 0.02);
        spec.scratches = r.below(60);
        spec.dust = 200 + r.below(1500);
        spec.text_boxes = r.below(5);
        if r.chance(1.0 / 16.0) {
            // The mark nearest to one edge is cut, half the time only just.
            spec.crop_mm[r.below(4)] = r.range(2.0, 12.0);
        }
        spec
    }
}

/// Where a mark really is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmMark {
    pub mark: String,
    pub x: f64,
    pub y: f64,
    /// The whole mark lies in the scan.
    pub complete: bool,
    /// A scratch, speck or text box touches what defines its centre.
    pub damaged: bool,
    /// Brightness of the ground at a transparent hole above the opaque frame, of white after exposure; `None` for marks
    /// with light of their own.
    pub hole_contrast: Option<f64>,
}

/// The truth of a frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmTruth {
    pub camera: String,
    pub width: u64,
    pub height: u64,
    pub pixel_um: f64,
    pub quarters: u8,
    pub mirrored: Handedness,
    pub gain: f64,
    pub marks: Vec<FilmMark>,
}

/// A frame with every choice made.
pub struct FilmScene {
    info: RasterInfo,
    painter: Painter,
    truth: FilmTruth,
    /// Blocks of [`BLOCK`] pixels that were read, drawn once; column and row.
    drawn: Mutex<HashMap<(u64, u64), PieceData>>,
}

/// Side of the blocks in which a scene is drawn when it is read, pixels, and how many are kept.
const BLOCK: u64 = 256;
const MOST_BLOCKS: usize = 512;

impl FilmScene {
    /// # Errors
    /// When a learned template of the camera cannot be read.
    pub fn new(spec: &FilmSpec, ground: &FilmGround) -> Result<FilmScene> {
        let camera = &spec.camera;
        let unit = 1e3 / spec.pixel_um;
        let film_size = if spec.quarters.is_multiple_of(2) {
            camera.film_size_mm
        } else {
            [camera.film_size_mm[1], camera.film_size_mm[0]]
        };
        let film_size = film_size.map(|v| v + 2.0 * spec.margin_mm);
        let [left, top, right, bottom] = spec.crop_mm;
        let width = ((film_size[0] - left - right) * unit).round().max(64.0) as u64;
        let height = ((film_size[1] - top - bottom) * unit).round().max(64.0) as u64;
        let middle = PixelPoint {
            x: (0.5 * film_size[0] - left + spec.offset_mm[0]) * unit,
            y: (0.5 * film_size[1] - top + spec.offset_mm[1]) * unit,
        };
        let turn = 90.0 * f64::from(spec.quarters) + spec.rotation_deg;
        let pose = Pose::about(camera.film_centre(), middle, unit, turn, spec.mirrored);
        let models = camera.marks.iter().map(|m| Model::of(&m.kind)).collect::<Result<Vec<_>>>()?;
        let mut rng = Rng::new(spec.seed, 0xf2, 0);
        let centre = camera.film_centre();
        let places: Vec<PixelPoint> = camera
            .film_points()
            .iter()
            .map(|mm| {
                let sheared = [
                    mm[0] + spec.shear * (mm[1] - centre[1]) + spec.jitter_um / 1e3 * rng.normal(),
                    mm[1] + spec.jitter_um / 1e3 * rng.normal(),
                ];
                pose.apply(sheared)
            })
            .collect();
        let damage = Damage::random(spec, camera, &pose, width, height);
        let painter = Painter::new(spec, pose, models, places, damage, ground);
        let truth = FilmTruth {
            camera: camera.name.clone(),
            width,
            height,
            pixel_um: spec.pixel_um,
            quarters: spec.quarters % 4,
            mirrored: spec.mirrored,
            gain: spec.gain,
            marks: painter.truth(width, height),
        };
        let sample = if spec.bits == 16 { SampleType::U16 } else { SampleType::U8 };
        let name = PathBuf::from(format!("{}-{}.tif", camera.name, spec.seed));
        let white = if spec.bits == 16 { 65_535 } else { 255 };
        let info = grey_info(&name, width, height, sample, white);
        Ok(FilmScene { info, painter, truth, drawn: Mutex::default() })
    }

    /// What was drawn where.
    pub fn truth(&self) -> &FilmTruth {
        &self.truth
    }

    /// Grey values of a window, 0 to the white of the sample type.
    pub fn render(&self, window: Window) -> Vec<u16> {
        self.painter.render(window)
    }
}

impl FilmScene {
    fn block(&self, key: (u64, u64), window: Window) -> PieceData {
        let known = self.drawn.lock().expect("nothing panics while it is held").get(&key).cloned();
        known.unwrap_or_else(|| {
            let values = self.render(window);
            let data = match self.info.sample {
                SampleType::U8 => PieceData::U8(Arc::new(autoref_raster::PooledBytes {
                    bytes: values.iter().map(|v| *v as u8).collect(),
                    home: None,
                })),
                SampleType::U16 => PieceData::U16(Arc::new(values)),
            };
            let mut drawn = self.drawn.lock().expect("nothing panics while it is held");
            if drawn.len() == MOST_BLOCKS {
                drawn.clear();
            }
            drawn.insert(key, data.clone());
            data
        })
    }
}

impl RasterSource for FilmScene {
    fn info(&self) -> &RasterInfo {
        &self.info
    }

    fn read(&self, window: Window) -> Result<Block> {
        let mut pieces = vec![];
        for row in window.y / BLOCK..window.bottom().div_ceil(BLOCK) {
            for column in window.x / BLOCK..window.right().div_ceil(BLOCK) {
                let block = Window::new(column * BLOCK, row * BLOCK, BLOCK, BLOCK).intersect(&self.info.bounds());
                let data = self.block((column, row), block);
                let row_stride = block.width as usize;
                pieces.push(Piece { window: block, data, offset: 0, row_stride, pixel_stride: 1, empty: false });
            }
        }
        Ok(Block { window, pieces })
    }

    fn stats(&self) -> ReadStats {
        ReadStats::default()
    }
}

/// Writes a frame as TIFF, uncompressed, in tiles of `tile` pixels or (0) in strips of 16 rows, and its truth beside it
/// (`NAME.truth.json`). Both appear whole or not at all.
///
/// # Errors
/// [`Error::Usage`] for tiles that are no multiple of 16, [`Error::Io`] and [`Error::Gdal`] when writing fails.
pub fn write_film(scene: &FilmScene, path: &Path, tile: u64) -> Result<()> {
    if !tile.is_multiple_of(16) || tile > 4096 {
        return Err(Error::usage(
            "tiles must be a multiple of 16 pixels, up to 4096",
            "use 256 or 512, or 0 for strips",
        ));
    }
    autoref_raster::initialise_gdal(64 << 20);
    autoref_raster::atomic::with_temporary(path, |temporary| write_tiff(scene, temporary, tile))?;
    let json = serde_json::to_vec_pretty(scene.truth()).expect("the truth is plain data");
    autoref_raster::atomic::write(&autoref_synth::truth_path(path), &json)
}

fn write_tiff(scene: &FilmScene, path: &Path, tile: u64) -> Result<()> {
    use gdal::raster::{Buffer, RasterCreationOptions};
    let gdal_error = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let mut options = RasterCreationOptions::new();
    if tile > 0 {
        options.set_name_value("TILED", "YES").map_err(gdal_error)?;
        options.set_name_value("BLOCKXSIZE", &tile.to_string()).map_err(gdal_error)?;
        options.set_name_value("BLOCKYSIZE", &tile.to_string()).map_err(gdal_error)?;
    } else {
        options.set_name_value("BLOCKYSIZE", "16").map_err(gdal_error)?;
    }
    let info = &scene.info;
    let (width, height) = (info.width as usize, info.height as usize);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").map_err(gdal_error)?;
    let mut dataset = match info.sample {
        SampleType::U8 => driver.create_with_band_type_with_options::<u8, _>(path, width, height, 1, &options),
        SampleType::U16 => driver.create_with_band_type_with_options::<u16, _>(path, width, height, 1, &options),
    }
    .map_err(gdal_error)?;
    let mut band = dataset.rasterband(1).map_err(gdal_error)?;
    let rows = if tile > 0 { tile } else { 256 };
    let mut top = 0;
    while top < info.height {
        let window = Window::new(0, top, info.width, rows.min(info.height - top));
        let size = (width, window.height as usize);
        let values = scene.render(window);
        let at = (0, top as isize);
        match info.sample {
            SampleType::U8 => {
                let mut buffer = Buffer::new(size, values.iter().map(|v| *v as u8).collect());
                band.write::<u8>(at, size, &mut buffer).map_err(gdal_error)?;
            }
            SampleType::U16 => band.write::<u16>(at, size, &mut Buffer::new(size, values)).map_err(gdal_error)?,
        }
        top = window.bottom();
    }
    dataset.flush_cache().map_err(gdal_error)
}
