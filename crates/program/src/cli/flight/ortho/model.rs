//! The elevation model under a frame.

use std::path::Path;

use anyhow::Result;
use autoref_elevation::grid::Grid;
use autoref_elevation::model::Model;
use autoref_flight::Error;
use autoref_flight::ortho::Surface;
use autoref_raster::crs::Crs;
use autoref_raster::error::Error as RasterError;
use autoref_raster::masked::has_mask;
use autoref_raster::window::Window;
use gdal::Dataset;
use gdal::raster::{Buffer, ResampleAlg};

use super::super::worlds::height_unit_m;

/// The model's part that matters, and what it is called: easting, northing and height in metres, whatever its CRS
/// counts in.
pub(in crate::cli) struct Dem {
    dataset: Dataset,
    pub grid: Grid,
    /// Metres in a unit of the CRS's easting and northing.
    pub unit_m: f64,
    pub(super) crs: Option<Crs>,
    /// A height in metres is the stored number times the first plus the second.
    metres: (f64, f64),
    /// What the elevation commands make of its cells.
    model: Model,
}

/// The grid with its corner and its cells in another unit.
pub(super) fn scaled(grid: &Grid, factor: f64) -> Grid {
    Grid {
        x0: grid.x0 * factor,
        y0: grid.y0 * factor,
        step_x: grid.step_x * factor,
        step_y: grid.step_y * factor,
        ..*grid
    }
}

pub(super) fn open(path: &Path) -> Result<Dataset> {
    let dataset = Dataset::open(path).map_err(|e| RasterError::gdal(path, e))?;
    autoref_raster::jpeg_end::check(path)?;
    Ok(dataset)
}

/// In units of the map; no model of the ground is as fine.
const LEAST_CELL: f64 = 1e-6;

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
        if grid.step_x.abs().min(grid.step_y.abs()) < LEAST_CELL {
            return Err(RasterError::unsupported(
                path,
                format!("an elevation model with cells of {:e} x {:e}", grid.step_x.abs(), grid.step_y.abs()),
                "look at its georeference with gdalinfo",
            )
            .into());
        }
        // What the elevation commands make of scale, offset and unit.
        let model = Model::open(path)?;
        let (factor, offset) = model.metres();
        let unit_m = crs.as_ref().map_or(1.0, Crs::metres_per_unit);
        let metres = match (&crs, model.unit_name()) {
            (Some(crs), None) if unit_m != 1.0 => {
                tracing::warn!(
                    "{}: names no unit of its heights: they are taken to be in that of its map, {}; name their unit with \
                     gdal_edit.py -units",
                    path.display(),
                    crs.unit_name()
                );
                (factor * unit_m, offset * unit_m)
            }
            _ => (factor, offset),
        };
        Ok(Dem { dataset, grid: scaled(&grid, unit_m), unit_m, crs, metres, model })
    }

    /// A place in metres as the CRS counts it.
    pub(super) fn in_units(&self, place_m: [f64; 3]) -> [f64; 3] {
        let height_m = self.crs.as_ref().map_or(1.0, height_unit_m);
        [place_m[0] / self.unit_m, place_m[1] / self.unit_m, place_m[2] / height_m]
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
        if has_mask(path, &band)? {
            let there: Buffer<u8> = band
                .open_mask_band()
                .and_then(|mask| mask.read_as(from.0, from.1, size, how))
                .map_err(|e| RasterError::gdal(path, e))?;
            heights.iter_mut().zip(there.data()).filter(|(_, t)| **t == 0).for_each(|(h, _)| *h = f32::NAN);
        }
        for h in &mut heights {
            if self.model.is_void(f64::from(*h)) {
                *h = f32::NAN;
            }
            if self.metres != (1.0, 0.0) {
                *h = (f64::from(*h) * self.metres.0 + self.metres.1) as f32;
            }
        }
        let g = &self.grid;
        let step = [g.step_x * window.width as f64 / size.0 as f64, g.step_y * window.height as f64 / size.1 as f64];
        let corner = [g.x0 + g.step_x * window.x as f64, g.y0 + g.step_y * window.y as f64];
        Surface::new(heights, size.0, corner, step)
            .ok_or_else(|| Error::no_result(format!("{}: no cell has a height", path.display()), "give another").into())
    }

    /// The cells of a box of the map in metres, with a margin, cut at the model's border.
    pub(super) fn window(&self, bounds: [f64; 4], margin: f64) -> Window {
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
