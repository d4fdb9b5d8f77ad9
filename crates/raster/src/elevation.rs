//! Elevation models: any raster as `f64`, read in windows.

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use gdal::Dataset;
use gdal::raster::{ColorInterpretation, GdalDataType};

use super::gdal::{Facts, GdalName, initialise_gdal};
use crate::coords::{GeoTransform, MapPoint, PixelPoint};
use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::height_band::HeightBand;
use crate::masked;
use crate::path_text::quoted;
use crate::window::Window;

/// A raster of heights (band 1 of any type), sampled by position. Heights are in metres: scale, offset and unit of the
/// band are applied, and cells that a nodata value, an alpha band or a mask leaves out have none.
pub struct ElevationModel {
    name: GdalName,
    dataset: Mutex<Dataset>,
    width: u64,
    height: u64,
    facts: Facts,
    band: HeightBand,
}

impl ElevationModel {
    /// Opens the band of `path`, any format and type that GDAL reads.
    ///
    /// # Errors
    /// When GDAL cannot open it, it holds no raster, or a picture's bands, or its heights are in a unit that is none of
    /// length.
    pub fn open(path: &Path) -> Result<Self> {
        initialise_gdal(32 << 20);
        if path.is_dir() {
            return Err(Error::format(path, "path", "is a directory, not an elevation model"));
        }
        let name = GdalName::new(path, 0);
        let dataset = name.open()?;
        if dataset.raster_count() == 0 {
            return Err(Error::unsupported(path, "it holds no raster", "give an elevation raster"));
        }
        refuse_pictures(path, &dataset)?;
        let (width, height) = dataset.raster_size();
        let facts = Facts::of(&dataset);
        // A CRS that PROJ cannot read has no unit of height to tell; who needs the CRS is told elsewhere.
        let crs = facts.crs_wkt.as_deref().and_then(|wkt| Crs::parse(wkt).ok());
        let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
        let band = HeightBand::of(path, &band, crs.as_ref())?;
        Ok(ElevationModel {
            name,
            dataset: Mutex::new(dataset),
            width: width as u64,
            height: height as u64,
            facts,
            band,
        })
    }

    /// Size in pixels.
    pub fn size(&self) -> (u64, u64) {
        (self.width, self.height)
    }

    /// Pixel corners to the model's CRS; `None` without a georeference.
    pub fn geotransform(&self) -> Option<GeoTransform> {
        self.facts.geotransform
    }

    /// The value that stands for "no height".
    pub fn nodata(&self) -> Option<f64> {
        self.facts.nodata
    }

    /// What the stored values mean.
    pub fn band(&self) -> &HeightBand {
        &self.band
    }

    /// WKT of its CRS.
    pub fn crs_wkt(&self) -> Option<&str> {
        self.facts.crs_wkt.as_deref()
    }

    /// Heights of `window` in metres, row-major; pixels without a height are NaN.
    ///
    /// # Errors
    /// When the window does not lie in the raster or cannot be read.
    pub fn read_f64_window(&self, window: Window) -> Result<Vec<f64>> {
        if window.is_empty() || !Window::whole(self.width, self.height).contains_window(&window) {
            return Err(Error::usage(
                format!("{}: window {window:?} does not lie in the raster", self.name.path.display()),
                format!("ask for pixels within {} x {}", self.width, self.height),
            ));
        }
        let mut heights = vec![0.0; window.area() as usize];
        let size = (window.width as usize, window.height as usize);
        let dataset = self.dataset.lock().unwrap_or_else(PoisonError::into_inner);
        let band = dataset.rasterband(1).map_err(|e| Error::gdal(&self.name.path, e))?;
        band.read_into_slice((window.x as isize, window.y as isize), size, size, &mut heights, None)
            .map_err(|e| Error::gdal(&self.name.path, e))?;
        if self.band.masked {
            let at = (window.x as isize, window.y as isize);
            masked::leave_out(&self.name.path, &band, at, size, &mut heights)?;
        }
        drop(dataset);
        self.band.to_metres(&mut heights);
        Ok(heights)
    }

    /// The height at a position of the model's own pixels, bilinear between pixel centres. Within the outer half pixel
    /// the nearest centres count; `None` outside the raster and where one of the pixels used has no height.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn at_pixel(&self, p: PixelPoint) -> Result<Option<f64>> {
        let inside = p.x >= 0.0 && p.y >= 0.0 && p.x <= self.width as f64 && p.y <= self.height as f64;
        if !inside {
            return Ok(None);
        }
        let (x0, x1, fx) = neighbours(p.x, self.width);
        let (y0, y1, fy) = neighbours(p.y, self.height);
        let window = Window::new(x0, y0, x1 - x0 + 1, y1 - y0 + 1);
        let heights = self.read_f64_window(window)?;
        let value = |x: u64, y: u64| heights[((y - y0) * window.width + x - x0) as usize];
        // A neighbour of weight zero does not count, so that its lack of a height does no harm.
        let mix = |a: f64, b: f64, f: f64| match f {
            0.0 => a,
            _ => a + (b - a) * f,
        };
        let upper = mix(value(x0, y0), value(x1, y0), fx);
        let height = match fy {
            0.0 => upper,
            _ => mix(upper, mix(value(x0, y1), value(x1, y1), fx), fy),
        };
        Ok(Some(height).filter(|h| h.is_finite()))
    }

    /// The height at a map position in the model's CRS. `None` outside, and when the model has no georeference.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn at_map(&self, m: MapPoint) -> Result<Option<f64>> {
        match self.facts.geotransform.and_then(|g| g.invert(m)) {
            Some(p) => self.at_pixel(p),
            None => Ok(None),
        }
    }
}

/// Refuses photographs: several bands of colours or of bytes. Of other rasters of several bands (bathymetry with its
/// uncertainty) the first holds the heights.
fn refuse_pictures(path: &Path, dataset: &Dataset) -> Result<()> {
    let of_band = |number: usize| {
        let band = dataset.rasterband(number).ok()?;
        let colour = band.color_interpretation();
        (colour != ColorInterpretation::AlphaBand).then(|| (colour, band.band_type()))
    };
    let bands: Vec<_> = (1..=dataset.raster_count()).filter_map(of_band).collect();
    let is_coloured = bands.iter().any(|(colour, _)| *colour == ColorInterpretation::RedBand);
    if bands.len() <= 1 || !(is_coloured || bands.iter().all(|(_, kind)| *kind == GdalDataType::UInt8)) {
        return Ok(());
    }
    let remedy = format!(
        "give the elevation model, or the band with the heights: gdal_translate -b 1 {} heights.tif",
        quoted(path)
    );
    Err(Error::unsupported(path, format!("{} bands, as a picture has, as an elevation model", bands.len()), remedy))
}

/// The two pixels whose centres lie around `position`, and how far it is from the first to the second (0..1).
fn neighbours(position: f64, size: u64) -> (u64, u64, f64) {
    let from_centre = (position - 0.5).clamp(0.0, (size - 1) as f64);
    let first = from_centre.floor();
    let second = (first as u64 + 1).min(size - 1);
    (first as u64, second, from_centre - first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_are_hit_and_the_border_is_clamped() {
        assert_eq!(neighbours(0.5, 4), (0, 1, 0.0));
        assert_eq!(neighbours(0.0, 4), (0, 1, 0.0));
        assert_eq!(neighbours(1.25, 4), (0, 1, 0.75));
        assert_eq!(neighbours(4.0, 4), (3, 3, 0.0));
        assert_eq!(neighbours(0.7, 1), (0, 0, 0.0));
    }
}
