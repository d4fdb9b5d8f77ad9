//! A corrected copy of an elevation model, streamed.

use autoref_raster::Written;
use std::path::Path;

use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;

use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::Result;
use autoref_raster::window::Window;
use autoref_raster::{ElevationModel, set_height_unit};
use autoref_solve::heights::HeightCorrection;

/// Pixels that are held at a time.
const CHUNK_PX: u64 = 1 << 20;
/// Where the model names no value for pixels without a height.
const NODATA: f64 = -9999.0;

/// How the copy is placed.
pub struct CopyPlace<'a> {
    /// From the model's pixels to the positions in which `correction` counts.
    pub to_positions: GeoTransform,
    /// The copy's georeference.
    pub geotransform: GeoTransform,
    pub crs_wkt: Option<&'a str>,
}

/// Metres in a unit of the vertical axis of a CRS; `None` where it has none.
fn axis_unit(wkt: Option<&str>) -> Option<f64> {
    Crs::parse(wkt?).ok()?.height_metres_per_unit()
}

/// Writes `model` + `correction` to `path` as a GeoTIFF of 32-bit floats, in the model's unit of height, which the band
/// names, or in that of the vertical axis of the copy's CRS. A few rows at a time are held, so memory does
/// not depend on the model's size. Pixels without a height stay without. To make it appear whole or not at all is the
/// caller's part ([`autoref_raster::atomic`]).
///
/// # Errors
/// When the model cannot be read or the copy cannot be written.
pub fn write_corrected(
    model: &ElevationModel,
    correction: &HeightCorrection,
    place: &CopyPlace<'_>,
    path: &Path,
) -> Result<()> {
    let failed = |e: gdal::errors::GdalError| autoref_raster::failed_to_write(path, &e.to_string());
    let (width, height) = model.size();
    let options = RasterCreationOptions::from_iter(["COMPRESS=DEFLATE", "PREDICTOR=3", "BIGTIFF=IF_SAFER"]);
    let written = Written::watch(path);
    let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
    let mut copy = driver
        .create_with_band_type_with_options::<f32, _>(path, width as usize, height as usize, 1, &options)
        .map_err(failed)?;
    copy.set_geo_transform(&place.geotransform.0).map_err(failed)?;
    if let Some(wkt) = place.crs_wkt.filter(|wkt| !wkt.is_empty()) {
        copy.set_spatial_ref(&SpatialRef::from_wkt(wkt).map_err(failed)?).map_err(failed)?;
    }
    let nodata = model.nodata().unwrap_or(NODATA);
    let mut band = copy.rasterband(1).map_err(failed)?;
    band.set_no_data_value(Some(nodata)).map_err(failed)?;
    let metres_per_unit = match axis_unit(place.crs_wkt) {
        Some(metres) => metres,
        None => {
            if let Some(name) = &model.band().unit_name {
                set_height_unit(path, &copy, name)?;
            }
            model.band().metres_per_value
        }
    };
    let rows_at_a_time = (CHUNK_PX / width.max(1)).clamp(1, height);
    for y in (0..height).step_by(rows_at_a_time as usize) {
        let rows = rows_at_a_time.min(height - y);
        let mut values = Vec::with_capacity((width * rows) as usize);
        // Very wide rows are read in pieces, too.
        for row in y..y + rows {
            for x in (0..width).step_by(CHUNK_PX as usize) {
                let window = Window::new(x, row, CHUNK_PX.min(width - x), 1);
                for (i, h) in model.read_f64_window(window)?.into_iter().enumerate() {
                    let pixel = PixelPoint { x: (x + i as u64) as f64 + 0.5, y: row as f64 + 0.5 };
                    let corrected = h + correction.at(place.to_positions.apply(pixel));
                    let stored = corrected / metres_per_unit;
                    values.push(if stored.is_finite() { stored as f32 } else { nodata as f32 });
                }
            }
        }
        let size = (width as usize, rows as usize);
        band.write((0, y as isize), size, &mut Buffer::new(size, values)).map_err(failed)?;
    }
    copy.flush_cache().map_err(failed)?;
    written.close(copy)
}
