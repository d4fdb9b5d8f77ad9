//! A frame in the film's own geometry: every frame of a roll gets the same grid of millimetres, as by MicMac's ReSampFid
//! (the bounding box of the marks, x right, y down). Written tile by tile; the scan is read in the windows that tiles need.

use std::path::Path;

use gdal::DriverManager;
use gdal::raster::{Buffer, GdalType, RasterCreationOptions};

use super::types::{Camera, InnerOrientation};
use super::window::{Grey, read_grey};
use crate::coords::PixelPoint;
use crate::error::{Error, Result};
use crate::georef::atomic;
use crate::raster::{RasterSource, SampleType};
use crate::window::Window;

const TILE: usize = 256;

#[derive(Clone, Debug, PartialEq)]
pub struct ResampleOptions {
    pub pixel_mm: f64,
    /// Around every mark this much is masked.
    pub mask_radius_mm: f64,
    /// Text boxes: left, top, right, bottom in millimetres, the camera's origin, y down.
    pub boxes_mm: Vec<[f64; 4]>,
}

/// Writes `image` and its mask (255 terrain, 0 marks, boxes and what lies outside the scan), both grey tiled TIFFs; the
/// mask is written last. Holds a tile and its window of the scan.
///
/// # Errors
/// [`Error::Usage`] for a pixel size that gives no or more than 200,000 pixels a side; those of reading and writing.
pub fn resample(
    source: &dyn RasterSource,
    camera: &Camera,
    inner: &InnerOrientation,
    options: &ResampleOptions,
    image: &Path,
    mask: &Path,
) -> Result<()> {
    let grid = Grid::new(source, camera, inner, options)?;
    atomic::with_temporary(mask, |mask_part| {
        atomic::with_temporary(image, |image_part| match source.info().sample {
            SampleType::U8 => grid.write::<u8>(image_part, mask_part, |v| v.round() as u8),
            SampleType::U16 => grid.write::<u16>(image_part, mask_part, |v| v.round() as u16),
        })
    })
}

struct Grid<'a> {
    source: &'a dyn RasterSource,
    inner: &'a InnerOrientation,
    options: &'a ResampleOptions,
    sign: f64,
    marks: Vec<[f64; 2]>,
    origin: [f64; 2],
    size: [usize; 2],
    /// Scan pixels averaged into one before interpolation, so that coarse grids do not alias.
    factor: u64,
}

impl<'a> Grid<'a> {
    fn new(
        source: &'a dyn RasterSource,
        camera: &Camera,
        inner: &'a InnerOrientation,
        options: &'a ResampleOptions,
    ) -> Result<Self> {
        let marks = camera.film_points();
        let low = [0, 1].map(|k| marks.iter().map(|p| p[k]).fold(f64::MAX, f64::min));
        let high = [0, 1].map(|k| marks.iter().map(|p| p[k]).fold(f64::MIN, f64::max));
        let size = [0, 1].map(|k| ((high[k] - low[k]) / options.pixel_mm).round());
        if !size.iter().all(|v| (1.0..=200_000.0).contains(v)) {
            let what = format!("pixels of {} mm give a frame of {} × {} pixels", options.pixel_mm, size[0], size[1]);
            return Err(Error::usage(what, "use a size near that of the scan, such as 0.0135"));
        }
        let factor = ((options.pixel_mm * 1e3 / inner.pixel_um).floor() as u64).max(1);
        let size = size.map(|v| v as usize);
        Ok(Grid { source, inner, options, sign: camera.y_sign(), marks, origin: low, size, factor })
    }

    fn film(&self, x: usize, y: usize) -> [f64; 2] {
        [(x, self.origin[0]), (y, self.origin[1])].map(|(i, o)| o + (i as f64 + 0.5) * self.options.pixel_mm)
    }

    fn scan(&self, film: [f64; 2]) -> Option<PixelPoint> {
        self.inner.to_pixel([film[0], self.sign * film[1]])
    }

    fn masked(&self, [x, y]: [f64; 2]) -> bool {
        self.marks.iter().any(|m| (m[0] - x).hypot(m[1] - y) <= self.options.mask_radius_mm)
            || self.options.boxes_mm.iter().any(|b| (b[0]..=b[2]).contains(&x) && (b[1]..=b[3]).contains(&y))
    }

    /// The values that a tile needs, with the kernel's reach; `None` when the tile lies outside the scan.
    fn window(&self, x: usize, y: usize, w: usize, h: usize) -> Result<Option<Grey>> {
        let corners: Vec<PixelPoint> = [(x, y), (x + w, y), (x, y + h), (x + w, y + h)]
            .iter()
            .filter_map(|&(x, y)| self.scan(self.film(x, y)))
            .collect();
        let reach = 4.0 * self.factor as f64;
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
        read_grey(self.source, Window::new(x0, y0, x1 - x0, y1 - y0), self.factor).map(Some)
    }

    fn write<T: GdalType + Copy + Default>(&self, image: &Path, mask: &Path, store: fn(f32) -> T) -> Result<()> {
        let failed = |e: gdal::errors::GdalError| Error::gdal(image, e);
        let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
        let options = RasterCreationOptions::from_iter(["TILED=YES", "COMPRESS=DEFLATE", "BIGTIFF=IF_SAFER"]);
        let [width, height] = self.size;
        let out =
            driver.create_with_band_type_with_options::<T, _>(image, width, height, 1, &options).map_err(failed)?;
        let out_mask =
            driver.create_with_band_type_with_options::<u8, _>(mask, width, height, 1, &options).map_err(failed)?;
        let (mut band, mut mask_band) = (out.rasterband(1).map_err(failed)?, out_mask.rasterband(1).map_err(failed)?);
        let white = f32::from(self.source.info().white);
        for (y, x) in (0..height).step_by(TILE).flat_map(|y| (0..width).step_by(TILE).map(move |x| (y, x))) {
            let (w, h) = (TILE.min(width - x), TILE.min(height - y));
            let (mut pixels, mut valid) = (vec![T::default(); w * h], vec![0u8; w * h]);
            if let Some(grey) = self.window(x, y, w, h)? {
                for (i, (p, v)) in pixels.iter_mut().zip(&mut valid).enumerate() {
                    let film = self.film(x + i % w, y + i / w);
                    let Some(value) = self.scan(film).and_then(|at| cubic(&grey, grey.from_scan(at))) else { continue };
                    *p = store(value.clamp(0.0, 1.0) * white);
                    *v = if self.masked(film) { 0 } else { 255 };
                }
            }
            let at = (x as isize, y as isize);
            band.write(at, (w, h), &mut Buffer::new((w, h), pixels)).map_err(failed)?;
            mask_band.write(at, (w, h), &mut Buffer::new((w, h), valid)).map_err(failed)?;
        }
        out.close().map_err(failed)?;
        out_mask.close().map_err(failed)
    }
}

/// Cubic convolution with a = −1/2 (R. G. Keys, Cubic convolution interpolation for digital image processing, 1981) at a place
/// in units of values; at the rim the outermost values go on. `None` outside.
fn cubic(grey: &Grey, [x, y]: [f64; 2]) -> Option<f32> {
    if !(x >= 0.0 && y >= 0.0 && x < grey.width as f64 && y < grey.height as f64) {
        return None;
    }
    let weights = |t: f32| {
        let (t2, t3) = (t * t, t * t * t);
        [-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, -0.5 * t2 + 0.5 * t3]
    };
    let (fx, fy) = ((x - 0.5).floor(), (y - 0.5).floor());
    let (wx, wy) = (weights((x - 0.5 - fx) as f32), weights((y - 0.5 - fy) as f32));
    let clip = |v: f64, k: usize, n: usize| (v as i64 + k as i64 - 1).clamp(0, n as i64 - 1) as usize;
    let row = |j: usize| -> f32 {
        let line = clip(fy, j, grey.height);
        (0..4).map(|i| wx[i] * grey.at(clip(fx, i, grey.width), line)).sum()
    };
    Some((0..4).map(|j| wy[j] * row(j)).sum())
}
