//! A frame in the film's own geometry: every frame of a roll gets the same grid of millimetres, as by MicMac's
//! ReSampFid (the bounding box of the camera's marks, x right, y down). Written tile by tile; the scan is read in the
//! windows that tiles need. Bands are taken out of what was read ([`banding`]), light is evened in what is written
//! ([`lighting`]).

pub mod banding;
pub mod kernel;
pub mod lighting;

use autoref_raster::{Written, failed_to_write};
use std::path::{Path, PathBuf};

use gdal::raster::{Buffer, GdalType, RasterCreationOptions};
use gdal::{Dataset, DriverManager, Metadata};

use super::types::{Camera, InteriorOrientation};
use super::window::{Grey, read_grey_valid};
use autoref_raster::atomic::{self, Existing};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::size_and_time;
use autoref_raster::window::Window;
use autoref_raster::{RasterSource, SampleType};
use banding::{Banding, Bands};
use kernel::{Kernel, Sampler};
use lighting::{Cells, Lighting};

const TILE: usize = 256;
/// Pixels of the scan along one of the output beyond which the scan is averaged while it is read, to this many or less.
const WIDEST: f64 = 8.0;
/// Ground that bands are measured on ends this far inside the marks, clear of teeth and border.
const CLEAR_MM: f64 = 4.0;

/// How frames are resampled, and what of them is masked.
#[derive(Clone, Debug, PartialEq)]
pub struct ResampleOptions {
    pub pixel_mm: f64,
    pub kernel: Kernel,
    /// Around every mark this much is masked.
    pub mask_radius_mm: f64,
    /// Text boxes beside those of the camera's file: two opposite corners x, y, x, y in millimetres, the camera's axes.
    pub boxes_mm: Vec<[f64; 4]>,
    pub banding: Banding,
}

/// What evens the light.
#[derive(Clone, Copy, Debug)]
pub enum Light<'a> {
    AsScanned,
    /// A surface of the frame alone.
    OfFrame,
    /// The surface of the roll; black is the frame's own.
    OfRoll(&'a Lighting),
}

/// What a frame's file says of itself, in its TIFF description, so that a roll that was stopped goes on where it was
/// and no picture of an earlier scan is kept.
pub fn description(
    scan: &Path,
    camera: &Camera,
    interior: &InteriorOrientation,
    options: &ResampleOptions,
    light: &str,
) -> String {
    let boxes = [&camera.masked_mm[..], &options.boxes_mm[..]].concat();
    serde_json::json!({
        "program": concat!("autoref-stream ", env!("CARGO_PKG_VERSION")),
        "scan": size_and_time(scan), "camera": camera.name, "marks_mm": camera.film_points(),
        "pixel_mm": options.pixel_mm, "kernel": options.kernel.name(), "mask_radius_mm": options.mask_radius_mm,
        "boxes_mm": boxes,
        "banding": options.banding.name(), "lighting": light,
        "film_of_first_pixel_mm": camera.film_box().0, "pixel_to_mm": interior.pixel_to_mm,
    })
    .to_string()
}

/// Whether `image` and `mask` are there already and made alike. What was made alike of a scan that has changed since,
/// or was copied, is made again.
///
/// # Errors
/// [`Error::Usage`] when one of them is there, is to be kept and differs (or is no such file).
pub fn is_done(image: &Path, mask: &Path, description: &str, existing: Existing) -> Result<bool> {
    if existing == Existing::Replace {
        return Ok(false);
    }
    [image, mask].into_iter().try_for_each(atomic::refuse_left_behind)?;
    if !(image.exists() || mask.exists()) {
        return Ok(false);
    }
    let said = |path: &Path| Dataset::open(path).ok()?.metadata_item("TIFFTAG_IMAGEDESCRIPTION", "");
    let before = [said(image), said(mask)];
    if before.iter().all(|said| said.as_deref() == Some(description)) {
        // A file that was cut short is made again.
        return Ok(ends(image) && ends(mask));
    }
    let there: Vec<(&Path, Option<String>)> =
        [image, mask].into_iter().zip(before).filter(|(path, _)| path.exists()).collect();
    let differs = |(_, said): &(&Path, Option<String>)| said.as_deref().and_then(|said| differing(said, description));
    let is_of_other_scan = |keys: Option<Vec<String>>| keys.is_some_and(|keys| keys.iter().all(|key| key == "scan"));
    if there.iter().map(differs).all(is_of_other_scan) {
        return Ok(false);
    }
    let keys = there.iter().filter_map(differs).find(|keys| !keys.is_empty());
    let differs = keys.map_or(String::new(), |keys| format!(" ({})", keys.join(", ")));
    let there = there.first().map_or(image, |there| there.0);
    Err(Error::usage(
        format!("the output {} exists and was made otherwise{differs}", there.display()),
        "give --overwrite to replace it, or another folder",
    ))
}

/// What two descriptions say otherwise; `None` where the one before is none of ours.
fn differing(before: &str, now: &str) -> Option<Vec<String>> {
    let read = |text: &str| serde_json::from_str::<serde_json::Map<String, serde_json::Value>>(text).ok();
    let (before, now) = (read(before)?, read(now)?);
    Some(now.iter().filter(|(key, value)| before.get(*key) != Some(*value)).map(|(key, _)| key.clone()).collect())
}

/// Whether the last row of a raster can be read.
fn ends(path: &Path) -> bool {
    let last_row = || {
        let dataset = Dataset::open(path).ok()?;
        let (width, height) = dataset.raster_size();
        dataset.rasterband(1).ok()?.read_as::<u16>((0, height as isize - 1), (width, 1), (width, 1), None).ok()
    };
    last_row().is_some()
}

/// Writes `image` and its mask (255 terrain, 0 marks, boxes and what lies outside the scan), both grey tiled TIFFs with
/// `description` in them, together or not at all. Holds a tile and its window of the scan.
///
/// # Errors
/// [`Error::Usage`] for a pixel size that gives no or more than 200,000 pixels a side; those of reading and writing.
pub fn resample(
    source: &dyn RasterSource,
    camera: &Camera,
    interior: &InteriorOrientation,
    options: &ResampleOptions,
    light: Light,
    description: &str,
    [image, mask]: [&Path; 2],
) -> Result<()> {
    let mut grid = Grid::new(source, camera, interior, options)?;
    grid.bands = match grid.ground() {
        Some(region) => banding::find(source, region, options.banding)?,
        None => Bands::default(),
    };
    if options.banding != Banding::Off {
        let [rows, columns] = grid.bands.rms();
        tracing::info!(image = %image.display(), rows, columns, "bands taken away, root mean square of white");
    }
    grid.lighting = match light {
        Light::AsScanned => None,
        Light::OfFrame => lighting::of_frame(&grid.cells(camera)?),
        Light::OfRoll(roll) => Some(roll.with_black(grid.cells(camera)?.black)),
    };
    let targets: [PathBuf; 2] = [mask.to_path_buf(), image.to_path_buf()];
    let mut both = atomic::Transaction::new();
    both.stage_all(&targets, |parts| match source.info().sample {
        SampleType::U8 => grid.write::<u8>(&parts[1], &parts[0], description, |v| v.round() as u8),
        SampleType::U16 => grid.write::<u16>(&parts[1], &parts[0], description, |v| v.round() as u16),
    })?;
    both.commit()
}

/// The cells of one frame, for the light of its roll.
///
/// # Errors
/// As [`resample`].
pub fn frame_cells(
    source: &dyn RasterSource,
    camera: &Camera,
    interior: &InteriorOrientation,
    options: &ResampleOptions,
) -> Result<Cells> {
    Grid::new(source, camera, interior, options)?.cells(camera)
}

struct Grid<'a> {
    source: &'a dyn RasterSource,
    interior: &'a InteriorOrientation,
    options: &'a ResampleOptions,
    /// Film (millimetres, y down) → scan, row by row.
    to_scan: [f64; 9],
    marks: Vec<[f64; 2]>,
    /// Left, top, right, bottom, y down.
    boxes: Vec<[f64; 4]>,
    low: [f64; 2],
    high: [f64; 2],
    size: [usize; 2],
    sampler: Sampler,
    /// Scan pixels averaged into one before interpolation, for very coarse grids.
    factor: u64,
    bands: Bands,
    lighting: Option<Lighting>,
}

impl<'a> Grid<'a> {
    fn new(
        source: &'a dyn RasterSource,
        camera: &Camera,
        interior: &'a InteriorOrientation,
        options: &'a ResampleOptions,
    ) -> Result<Self> {
        let (low, high) = camera.film_box();
        let size = [0, 1].map(|k| ((high[k] - low[k]) / options.pixel_mm).round());
        if !size.iter().all(|v| (1.0..=200_000.0).contains(v)) {
            let what = format!("pixels of {} mm give a frame of {} × {} pixels", options.pixel_mm, size[0], size[1]);
            return Err(Error::usage(what, "use a size near that of the scan, such as 0.0135"));
        }
        let sign = camera.y_sign();
        let inverse = nalgebra::Matrix3::from_row_slice(&interior.pixel_to_mm)
            .try_inverse()
            .ok_or_else(|| Error::usage("the interior orientation is singular", "look at the frame's marks"))?;
        let to_scan: [f64; 9] = std::array::from_fn(|k| inverse[(k / 3, k % 3)] * if k % 3 == 1 { sign } else { 1.0 });
        // Positive on the side of the horizon where the film is.
        let middle = camera.film_centre();
        let side = (to_scan[6] * middle[0] + to_scan[7] * middle[1] + to_scan[8]).signum();
        let to_scan = to_scan.map(|v| v * side);
        let boxes = camera.masked_mm.iter().chain(&options.boxes_mm).map(|b| {
            let (y0, y1) = (sign * b[1], sign * b[3]);
            [b[0].min(b[2]), y0.min(y1), b[0].max(b[2]), y0.max(y1)]
        });
        let ratio = options.pixel_mm * 1e3 / interior.pixel_um;
        let factor = ((2.0 * ratio / WIDEST).floor() as u64).max(1);
        Ok(Grid {
            source,
            interior,
            options,
            to_scan,
            marks: camera.film_points(),
            boxes: boxes.collect(),
            low,
            high,
            size: size.map(|v| v as usize),
            sampler: Sampler::new(options.kernel, ratio / factor as f64),
            factor,
            bands: Bands::default(),
            lighting: None,
        })
    }

    fn film(&self, x: usize, y: usize) -> [f64; 2] {
        [(x, self.low[0]), (y, self.low[1])].map(|(i, o)| o + (i as f64 + 0.5) * self.options.pixel_mm)
    }

    fn scan(&self, [x, y]: [f64; 2]) -> Option<PixelPoint> {
        let h = &self.to_scan;
        let w = h[6] * x + h[7] * y + h[8];
        (w > 1e-12).then(|| PixelPoint { x: (h[0] * x + h[1] * y + h[2]) / w, y: (h[3] * x + h[4] * y + h[5]) / w })
    }

    /// −1 to 1 over the grid.
    fn unit(&self, film: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|k| 2.0 * (film[k] - self.low[k]) / (self.high[k] - self.low[k]) - 1.0)
    }

    fn masked(&self, [x, y]: [f64; 2]) -> bool {
        self.marks.iter().any(|m| (m[0] - x).hypot(m[1] - y) <= self.options.mask_radius_mm)
            || self.boxes.iter().any(|b| (b[0]..=b[2]).contains(&x) && (b[1]..=b[3]).contains(&y))
    }

    fn cells(&self, camera: &Camera) -> Result<Cells> {
        lighting::cells(self.source, camera, self.interior, |film| self.unit(film), |film| self.masked(film))
    }

    /// An upright window of the scan inside the ground, for bands; `None` when there is none.
    fn ground(&self) -> Option<Window> {
        let (low, high) = (self.low.map(|v| v + CLEAR_MM), self.high.map(|v| v - CLEAR_MM));
        let corners = [[low[0], low[1]], [high[0], low[1]], [low[0], high[1]], [high[0], high[1]]];
        let at: Vec<PixelPoint> = corners.iter().filter_map(|c| self.scan(*c)).collect();
        let info = self.source.info();
        let inside = |f: fn(&PixelPoint) -> f64, end: u64| {
            let mut v: Vec<f64> = at.iter().map(f).collect();
            v.sort_by(f64::total_cmp);
            let (from, to) = (v.get(1)?.ceil().max(0.0) as u64, v.get(2)?.floor().clamp(0.0, end as f64) as u64);
            (to > from).then_some((from, to))
        };
        let ((x0, x1), (y0, y1)) = (inside(|p| p.x, info.width)?, inside(|p| p.y, info.height)?);
        Some(Window::new(x0, y0, x1 - x0, y1 - y0))
    }

    /// The values that a tile needs, with the kernel's reach, and which of them hold something, `None` where all do;
    /// nothing when the tile lies outside the scan.
    fn window(&self, x: usize, y: usize, w: usize, h: usize) -> Result<Option<(Grey, Option<Vec<bool>>)>> {
        let corners: Vec<PixelPoint> = [(x, y), (x + w, y), (x, y + h), (x + w, y + h)]
            .iter()
            .filter_map(|&(x, y)| self.scan(self.film(x, y)))
            .collect();
        let reach = (self.sampler.reach() + 2.0) * self.factor as f64;
        let info = self.source.info();
        let span = |f: fn(&PixelPoint) -> f64, end: u64| {
            let (a, b) = corners.iter().map(f).fold((f64::MAX, f64::MIN), |(a, b), v| (a.min(v), b.max(v)));
            ((a - reach).clamp(0.0, end as f64) as u64, (b + reach).ceil().clamp(0.0, end as f64) as u64)
        };
        let ((x0, x1), (y0, y1)) = (span(|p| p.x, info.width), span(|p| p.y, info.height));
        if x1 <= x0 || y1 <= y0 {
            return Ok(None);
        }
        // All tiles average the same groups of pixels.
        let (x0, y0) = (x0 / self.factor * self.factor, y0 / self.factor * self.factor);
        let window = Window::new(x0, y0, x1 - x0, y1 - y0);
        let (mut grey, valid) = read_grey_valid(self.source, window, self.factor)?;
        self.source.release(window);
        self.bands.remove(&mut grey);
        Ok(Some((grey, valid)))
    }

    /// Upper left corners of the tiles, in the order that follows the scan's rows: each strip is decoded for one line
    /// of tiles.
    fn tiles(&self) -> Vec<(usize, usize)> {
        let [width, height] = self.size;
        let across = self.to_scan[0].abs() >= self.to_scan[3].abs();
        let (outer, interior) = if across { (height, width) } else { (width, height) };
        let all = (0..outer).step_by(TILE).flat_map(|o| (0..interior).step_by(TILE).map(move |i| (o, i)));
        all.map(|(o, i)| if across { (i, o) } else { (o, i) }).collect()
    }

    fn write<T: GdalType + Copy + Default>(
        &self,
        image: &Path,
        mask: &Path,
        description: &str,
        store: fn(f32) -> T,
    ) -> Result<()> {
        let failed = |e: gdal::errors::GdalError| failed_to_write(image, &e.to_string());
        let (written, written_mask) = (Written::watch(image), Written::watch(mask));
        let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
        let options = RasterCreationOptions::from_iter(["TILED=YES", "COMPRESS=DEFLATE", "BIGTIFF=IF_SAFER"]);
        let [width, height] = self.size;
        let mut out =
            driver.create_with_band_type_with_options::<T, _>(image, width, height, 1, &options).map_err(failed)?;
        let mut out_mask =
            driver.create_with_band_type_with_options::<u8, _>(mask, width, height, 1, &options).map_err(failed)?;
        for dataset in [&mut out, &mut out_mask] {
            dataset.set_metadata_item("TIFFTAG_IMAGEDESCRIPTION", description, "").map_err(failed)?;
        }
        let (mut band, mut mask_band) = (out.rasterband(1).map_err(failed)?, out_mask.rasterband(1).map_err(failed)?);
        let white = f32::from(self.source.info().white);
        let mut scratch = <[Vec<f32>; 2]>::default();
        for (x, y) in self.tiles() {
            let (w, h) = (TILE.min(width - x), TILE.min(height - y));
            let (mut pixels, mut valid) = (vec![T::default(); w * h], vec![0u8; w * h]);
            if let Some((grey, holds)) = self.window(x, y, w, h)? {
                let holds = holds.as_deref();
                for (i, (p, v)) in pixels.iter_mut().zip(&mut valid).enumerate() {
                    let film = self.film(x + i % w, y + i / w);
                    let Some(at) = self.scan(film) else { continue };
                    let Some(value) = self.sampler.at((&grey, holds), grey.from_scan(at), &mut scratch) else {
                        continue;
                    };
                    let even = self.lighting.as_ref().map_or(value, |l| l.corrected(value, self.unit(film)));
                    *p = store(even.clamp(0.0, 1.0) * white);
                    *v = if self.masked(film) { 0 } else { 255 };
                }
            }
            let at = (x as isize, y as isize);
            band.write(at, (w, h), &mut Buffer::new((w, h), pixels)).map_err(failed)?;
            mask_band.write(at, (w, h), &mut Buffer::new((w, h), valid)).map_err(failed)?;
        }
        written.close(out)?;
        written_mask.close(out_mask)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::types::InteriorModel;
    use autoref_raster::coords::Handedness;
    use autoref_raster::memory::MemorySource;
    use autoref_raster::{Described, RasterInfo};

    /// A scan of 0.1 mm a pixel, the film's origin in its middle.
    fn upright(side: f64) -> InteriorOrientation {
        InteriorOrientation {
            model: InteriorModel::Similarity,
            pixel_to_mm: [0.1, 0.0, -0.05 * side, 0.0, 0.1, -0.05 * side, 0.0, 0.0, 1.0],
            rmse_um: 0.0,
            sigma0_um: None,
            covariance: vec![],
            marks: vec![],
            leave_one_out_um: vec![],
            leave_one_out_rmse_um: None,
            pixel_um: 100.0,
            pixel_xy_um: [100.0; 2],
            rotation_deg: 0.0,
            mirrored: Handedness::AsIs,
        }
    }

    #[test]
    fn what_a_scan_leaves_empty_is_masked_and_mixed_with_nothing() {
        const SIDE: u64 = 80;
        let mark = |name: &str, x: f64, y: f64| {
            format!("{{ name = \"{name}\", x_mm = {x}, y_mm = {y}, kind = {{ shape = \"dot\", diameter_mm = 0.2 }} }}")
        };
        let text = format!(
            "name = \"small\"\nfilm_size_mm = [8.0, 8.0]\ny_axis = \"down\"\nmarks = [{}, {}]",
            mark("A", -3.5, -3.5),
            mark("B", 3.5, 3.5)
        );
        let camera = crate::camera::parse(&text, Path::new("small.toml")).expect("a camera");
        let is_empty = |i: u64| i % SIDE + i / SIDE < 50;
        let rgb = MemorySource::rgb8(
            SIDE,
            SIDE,
            (0..SIDE * SIDE).flat_map(|i| if is_empty(i) { [0, 255, 0] } else { [200, 200, 255] }).collect(),
        );
        let said =
            |bands, nodata, alpha| Described::new(&rgb, RasterInfo { rgb: bands, nodata, alpha, ..rgb.info().clone() });
        let interior = upright(SIDE as f64);
        let folder = tempfile::tempdir().expect("a folder");
        for source in [said([0; 3], Some(0.0), None), said([1; 3], None, Some(2))] {
            for (pixel_mm, kernel) in [(0.05, Kernel::Cubic), (0.1, Kernel::Bilinear), (0.7, Kernel::Lanczos)] {
                let options =
                    ResampleOptions { pixel_mm, kernel, mask_radius_mm: 0.0, boxes_mm: vec![], banding: Banding::Off };
                let [image, mask] = ["image.tif", "mask.tif"].map(|name| folder.path().join(name));
                resample(&source, &camera, &interior, &options, Light::AsScanned, "{}", [&image, &mask])
                    .expect("writable");
                let read = |path: &Path| {
                    let dataset = Dataset::open(path).expect("written");
                    let band = dataset.rasterband(1).expect("a band");
                    (dataset.raster_size().0, band.read_band_as::<u8>().expect("values").data().to_vec())
                };
                let ((width, values), (_, mask)) = (read(&image), read(&mask));
                let mut wrong = 0;
                for (i, (value, shown)) in values.iter().zip(&mask).enumerate() {
                    assert_eq!(*value, if *shown == 255 { 200 } else { 0 }, "{pixel_mm} {kernel:?}: {i}");
                    let at = [i % width, i / width].map(|k| (((k as f64 + 0.5) * pixel_mm + 0.5) / 0.1) as u64);
                    wrong += usize::from(is_empty(at[1] * SIDE + at[0]) == (*shown == 255));
                }
                assert!(wrong * 20 <= values.len(), "{pixel_mm} {kernel:?}: {wrong} of {}", values.len());
                assert!(mask.contains(&255) && mask.contains(&0));
            }
        }
    }
}
