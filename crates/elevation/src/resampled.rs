//! A model at coarser or finer cells, by GDAL's warper, on a grid of multiples of their side.

use std::path::Path;

use gdal::raster::GdalDataType;

use crate::error::{Error, Result};
use crate::model::open_stored;
use crate::warp::warp_dataset;

/// A bound that lies so near to a multiple of the side, in cells, is one.
const ON_GRID: f64 = 1e-6;

/// Writes `model` at square cells of `side` map units as a GeoTIFF. Cells beyond its border, which a grid of multiples
/// of the side may have, and cells without a height have no height: a whole-number model that declares no nodata value
/// becomes floating then.
///
/// # Errors
/// Files that cannot be read or written, in GDAL's own words where it says them.
pub fn resample(model: &Path, out: &Path, side: f64, resampling: &str, threads: usize) -> Result<()> {
    let dataset = open_stored(model)?;
    let t = dataset.geo_transform().map_err(|e| Error::gdal(model, e))?;
    let [west, south, east, north] = bounds(t, dataset.raster_size());
    let down = |v: f64| (v / side + ON_GRID).floor() * side;
    let up = |v: f64| (v / side - ON_GRID).ceil() * side;
    let extent = [down(west), down(south), up(east), up(north)];
    // A turned model leaves corners of its extent empty. Of an extent on the grid GDAL's own `-tap` would make another,
    // as numbers such as 0.1 round.
    let is_turned = t[2] != 0.0 || t[4] != 0.0;
    let is_beyond = is_turned
        || [west, south, east, north].iter().zip(extent).any(|(own, wide)| (own - wide).abs() > ON_GRID * side);
    let band = dataset.rasterband(1).map_err(|e| Error::gdal(model, e))?;
    let kind = band.band_type();
    let mut words: Vec<String> = ["-of", "GTiff", "-r", resampling, "-wo"].map(String::from).into();
    words.push(format!("NUM_THREADS={threads}"));
    for option in ["COMPRESS=DEFLATE", "TILED=YES", "BIGTIFF=IF_SAFER"] {
        words.extend(["-co".to_string(), option.to_string()]);
    }
    words.extend(["-overwrite".to_string(), "-tr".to_string(), side.to_string(), side.to_string(), "-te".to_string()]);
    words.extend(extent.map(|bound| bound.to_string()));
    if band.no_data_value().is_none() && is_beyond {
        let wide = match kind {
            _ if kind.is_floating() => kind,
            _ if kind.bits() <= 16 => GdalDataType::Float32,
            _ => GdalDataType::Float64,
        };
        words.extend(["-ot".to_string(), wide.name(), "-dstnodata".to_string(), "nan".to_string()]);
    }
    warp_dataset(&dataset, model, out, &words.iter().map(String::as_str).collect::<Vec<_>>())
}

/// West, south, east and north of a raster, which may be turned.
fn bounds(t: [f64; 6], (width, height): (usize, usize)) -> [f64; 4] {
    let (width, height) = (width as f64, height as f64);
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)]
        .map(|(x, y)| (t[0] + x * t[1] + y * t[2], t[3] + x * t[4] + y * t[5]));
    let least = |of: fn(&(f64, f64)) -> f64| corners.iter().map(of).fold(f64::INFINITY, f64::min);
    let most = |of: fn(&(f64, f64)) -> f64| corners.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
    [least(|c| c.0), least(|c| c.1), most(|c| c.0), most(|c| c.1)]
}
