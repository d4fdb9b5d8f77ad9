//! Pictures and measures of one model, by GDAL's own functions, which keep a few rows in memory: hillshade, slope,
//! aspect, roughness, TRI, TPI, colours, contours.
#![allow(unsafe_code)]

use std::ffi::{CString, c_char};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use std::os::unix::ffi::OsStrExt;

use gdal::{Dataset, DatasetOptions, DriverManager, GdalOpenFlags};

use autoref_raster::crs::without_heights;
use autoref_raster::{HeightBand, Written, failed_to_write, is_cut_table, metres_per_value};

use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::gdal_call::{c_string, failure, last_error};
use crate::model::look_through;
use crate::row_cache::{self, RowCache, Use};
use crate::warp::warp_dataset;
use autoref_raster::bounded;

/// What is drawn, with the options of `gdaldem`.
#[derive(Clone, Debug)]
pub struct Drawing<'a> {
    /// `hillshade`, `slope`, `aspect`, `roughness`, `TRI`, `TPI` or `color-relief`.
    pub kind: &'a str,
    /// As `gdaldem` takes them.
    pub options: Vec<String>,
    /// Of `color-relief`.
    pub colours: Option<&'a Path>,
    pub memory_budget_bytes: u64,
}

/// Heights of a model, piece by piece, until `see` has seen enough.
fn look(model: &Path, dataset: &gdal::Dataset, mut see: impl FnMut(f64) -> ControlFlow<()>) -> Result<()> {
    let nodata = dataset.rasterband(1).map_err(|e| Error::gdal(model, e))?.no_data_value();
    look_through(model, dataset, |stored| {
        stored.iter().filter(|v| v.is_finite() && Some(**v) != nodata).try_for_each(|v| see(*v))
    })
}

/// The least and the greatest height.
fn extremes(model: &Path, dataset: &gdal::Dataset) -> Result<(f64, f64)> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    look(model, dataset, |v| {
        (low, high) = (low.min(v), high.max(v));
        ControlFlow::Continue(())
    })?;
    Ok((low, high))
}

/// Refuses a model without any height; looks no further than the first.
///
/// # Errors
/// When there is none, or the model cannot be read.
pub fn check_heights(model: &Path) -> Result<()> {
    let dataset = crate::model::open_dataset(model)?;
    if dataset.raster_count() == 0 {
        return Err(Error::unsupported(model, "it holds no raster", "give an elevation raster"));
    }
    let band = dataset.rasterband(1).map_err(|e| Error::gdal(model, e))?;
    let scale = (band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0));
    let metres_per_value = metres_per_value(&band, Crs::parse(&dataset.projection()).ok().as_ref());
    let rule = HeightBand { nodata: band.no_data_value(), scale, masked: false, metres_per_value, unit_name: None };
    let mut found = false;
    look(model, &dataset, |v| {
        found |= !rule.is_void(v);
        if found { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    if found {
        return Ok(());
    }
    Err(Error::unsupported(model, "no cell has a height", "look at its nodata value with gdalinfo -stats"))
}

/// GDAL's functions would take the pixels of such a model for places.
fn refuse_placed_by_gcps(model: &Path, dataset: &Dataset) -> Result<()> {
    if dataset.gcps().is_empty() || dataset.geo_transform().is_ok() {
        return Ok(());
    }
    Err(Error::unsupported(
        model,
        "an elevation model that only GCPs place",
        "warp it first: gdalwarp MODEL WARPED.tif",
    ))
}

/// Refuses resamplings that an offset of the band makes wrong: they are of heights, and the stored numbers are warped.
///
/// # Errors
/// [`Error::Unsupported`] with the remedy.
pub fn check_resampling(model: &Path, resampling: &str) -> Result<()> {
    let dataset = crate::model::open_dataset(model)?;
    let offset = dataset.rasterband(1).map_err(|e| Error::gdal(model, e))?.offset().unwrap_or(0.0);
    if offset == 0.0 || !["rms", "sum"].contains(&resampling) {
        return Ok(());
    }
    Err(Error::unsupported(
        model,
        format!("--resampling {resampling} of a band with an offset of {offset}"),
        "unscale it first: gdal_translate -unscale",
    ))
}

/// Draws `model` into `out` as a GeoTIFF.
///
/// # Errors
/// GDAL's own words, when it cannot.
pub fn draw(model: &Path, out: &Path, drawing: &Drawing<'_>) -> Result<()> {
    let dataset = crate::model::open_heights(model)?;
    if dataset.raster_count() == 0 {
        return Err(Error::unsupported(model, "it holds no raster", "give an elevation raster"));
    }
    refuse_placed_by_gcps(model, &dataset)?;
    let colours = drawing.colours.map(|table| Colours::read(table, || extremes(model, &dataset))).transpose()?;
    let width = dataset.raster_size().0 as u64;
    let _cache = RowCache::hold(model, &dataset, Use::Copied, drawing.memory_budget_bytes)?;
    let mut options = drawing.options.clone();
    options.extend(
        ["-of", "GTiff", "-co", "COMPRESS=DEFLATE", "-co", "TILED=YES", "-co", "BIGTIFF=IF_SAFER"].map(str::to_string),
    );
    options.extend(["-co".into(), format!("BLOCKYSIZE={}", row_cache::block_rows(width))]);
    let words: Vec<CString> = options.iter().map(|o| c_string(model, o.as_bytes())).collect::<Result<_>>()?;
    let mut pointers: Vec<*mut c_char> = words.iter().map(|w| w.as_ptr().cast_mut()).collect();
    pointers.push(std::ptr::null_mut());
    let name = c_string(out, out.as_os_str().as_bytes())?;
    let kind = c_string(model, drawing.kind.as_bytes())?;
    let colours = colours.as_ref().map(|held| c_string(model, held.name.as_bytes())).transpose()?;
    let plane = plane_of(model, &dataset, drawing.kind)?;
    // SAFETY: the list of options is ended by a null pointer; all strings and the dataset outlive the calls, the
    // options are freed once, and the dataset that is made is closed once and not used again.
    let failed = unsafe {
        gdal_sys::CPLErrorReset();
        let options = gdal_sys::GDALDEMProcessingOptionsNew(pointers.as_mut_ptr(), std::ptr::null_mut());
        if options.is_null() {
            Some(last_error())
        } else {
            let mut usage = 0;
            let made = gdal_sys::GDALDEMProcessing(
                name.as_ptr(),
                dataset.c_dataset(),
                kind.as_ptr(),
                colours.as_ref().map_or(std::ptr::null(), |c| c.as_ptr()),
                options,
                &mut usage,
            );
            gdal_sys::GDALDEMProcessingOptionsFree(options);
            if made.is_null() {
                Some(last_error())
            } else {
                if let Some(plane) = &plane {
                    gdal_sys::GDALSetProjection(made, plane.as_ptr());
                }
                gdal_sys::GDALClose(made);
                failure()
            }
        }
    };
    match failed {
        // Of the model or of the output: GDAL's words do not say.
        Some(text) => Err(failed_to_write(out, &format!("drawing {}: {text}", model.display()))),
        None => Ok(()),
    }
}

/// The CRS of a picture that holds no heights, where the model's own says how heights count: GDAL copies it.
fn plane_of(model: &Path, dataset: &Dataset, kind: &str) -> Result<Option<CString>> {
    let (whole, of_heights) = (dataset.projection(), ["roughness", "TRI", "TPI"].contains(&kind));
    if of_heights {
        return Ok(None);
    }
    let plane = without_heights(model, &whole)?;
    (plane != whole).then(|| c_string(model, plane.as_bytes())).transpose()
}

/// A table of colours in memory, where GDAL finds it under a name of its own: its reader does not survive every file,
/// nor a disk that fails.
struct Colours {
    name: String,
}

impl Colours {
    /// Shares of the range of heights become heights: GDAL would write the range into a file beside the model.
    fn read(path: &Path, extremes: impl FnOnce() -> Result<(f64, f64)>) -> Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        let mut text = bounded::read(path, "a table of colours", bounded::TEXT_BYTES)?;
        check_colours(path, &text)?;
        if text.contains(&b'%') {
            text = in_heights(&String::from_utf8_lossy(&text), extremes()?).into_bytes();
        }
        let name = format!("/vsimem/autoref-colours-{}.txt", COUNT.fetch_add(1, Ordering::Relaxed));
        gdal::vsi::create_mem_file(&name, text).map_err(|e| Error::gdal(path, e))?;
        Ok(Colours { name })
    }
}

impl Drop for Colours {
    fn drop(&mut self) {
        let _ = gdal::vsi::unlink_mem_file(&self.name);
    }
}

/// A table whose heights in per cent of the range are heights.
fn in_heights(text: &str, (low, high): (f64, f64)) -> String {
    let of_line = |line: &str| {
        let share = line.split_once('%').and_then(|(share, rest)| Some((share.trim().parse::<f64>().ok()?, rest)));
        match share {
            Some((share, rest)) => format!("{}{rest}\n", low + (high - low) * share / 100.0),
            None => format!("{line}\n"),
        }
    };
    text.lines().map(of_line).collect()
}

fn check_colours(path: &Path, text: &[u8]) -> Result<()> {
    let text = String::from_utf8_lossy(text);
    let mut rows = 0;
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let words: Vec<&str> =
            line.split(|c: char| c.is_whitespace() || c == ',' || c == ':').filter(|word| !word.is_empty()).collect();
        let is_number = |word: &str| word.parse::<f64>().is_ok();
        let is_height =
            |word: &str| is_number(word.strip_suffix('%').unwrap_or(word)) || word.eq_ignore_ascii_case("nv");
        let is_row = match words[..] {
            [height, name] if name.chars().all(|letter| letter.is_ascii_alphabetic()) => is_height(height),
            [height, ref colour @ ..] => {
                is_height(height) && matches!(colour.len(), 3 | 4) && colour.iter().all(|word| is_number(word))
            }
            [] => false,
        };
        if !is_row {
            let what = format!("`{line}` is no height with red, green and blue");
            return Err(Error::format(path, format!("line {}", number + 1), what));
        }
        rows += 1;
    }
    if rows == 0 {
        return Err(Error::format(path, "table", "there is no colour in it"));
    }
    Ok(())
}

/// The driver whose lines have a table in a file of its own.
const SHAPEFILE: &str = "ESRI Shapefile";

/// The driver of a file of lines, by its extension.
///
/// # Errors
/// When no format is called so.
pub fn line_driver(out: &Path) -> Result<&'static str> {
    let extension = out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    match extension.as_str() {
        "gpkg" => Ok("GPKG"),
        "json" | "geojson" => Ok("GeoJSON"),
        "shp" => Ok(SHAPEFILE),
        other => Err(Error::usage(
            format!("{}: no format of lines is called `{other}`", out.display()),
            "name it .gpkg, .geojson or .shp",
        )),
    }
}

/// Heights that [`contour`] draws lines at, at most.
const MOST_LEVELS: f64 = 100_000.0;

/// Contour lines into a vector file, whose format its extension names (GeoPackage, GeoJSON, Shapefile); tells how many.
/// `interval`, `base` and the lines' heights are in metres, whatever the model's unit.
///
/// # Errors
/// A unit of height that is none of length; an interval that is not positive or cuts the model's heights into more than
/// 100,000 levels; GDAL's own words, when it cannot.
pub fn contour(model: &Path, out: &Path, interval: f64, base: f64, memory_budget_bytes: u64) -> Result<u64> {
    use gdal::spatial_ref::SpatialRef;
    use gdal::vector::{FieldDefn, LayerAccess, LayerOptions, OGRFieldType, OGRwkbGeometryType};
    if !(interval > 0.0 && interval.is_finite()) {
        return Err(Error::usage("--interval is no positive length", "give the height between two lines"));
    }
    let failed = |e: gdal::errors::GdalError| failed_to_write(out, &e.to_string());
    let watch = Written::watch(out);
    refuse_placed_by_gcps(model, &crate::model::open_dataset(model)?)?;
    let source = crate::model::open_metres(model)?;
    let band = source.rasterband(1).map_err(|e| Error::gdal(model, e))?;
    check_levels(model, extremes(model, &source)?, interval)?;
    let _cache = RowCache::hold(model, &source, Use::Followed, memory_budget_bytes)?;
    let driver = DriverManager::get_driver_by_name(line_driver(out)?).map_err(failed)?;
    let mut dataset = driver.create_vector_only(out).map_err(failed)?;
    let wkt = source.projection();
    let reference = if wkt.is_empty() { None } else { Some(SpatialRef::from_wkt(&wkt).map_err(failed)?) };
    let options =
        LayerOptions { name: "contour", srs: reference.as_ref(), ty: OGRwkbGeometryType::wkbLineString, options: None };
    let layer = dataset.create_layer(options).map_err(failed)?;
    for (name, kind) in [("id", OGRFieldType::OFTInteger), ("elev", OGRFieldType::OFTReal)] {
        FieldDefn::new(name, kind).and_then(|field| field.add_to_layer(&layer)).map_err(failed)?;
    }
    let mut words = vec![
        format!("LEVEL_INTERVAL={interval}"),
        format!("LEVEL_BASE={base}"),
        "ID_FIELD=0".to_string(),
        "ELEV_FIELD=1".to_string(),
    ];
    if let Some(nodata) = band.no_data_value() {
        words.push(format!("NODATA={nodata}"));
    }
    let words: Vec<CString> = words.iter().map(|o| c_string(model, o.as_bytes())).collect::<Result<_>>()?;
    let mut pointers: Vec<*mut c_char> = words.iter().map(|w| w.as_ptr().cast_mut()).collect();
    pointers.push(std::ptr::null_mut());
    // SAFETY: band, layer and the list of options, ended by a null pointer, outlive the call, which keeps none of them.
    let error = unsafe {
        gdal_sys::CPLErrorReset();
        let code = gdal_sys::GDALContourGenerateEx(
            band.c_rasterband(),
            layer.c_layer().cast(),
            pointers.as_mut_ptr(),
            None,
            std::ptr::null_mut(),
        );
        (code != gdal_sys::CPLErr::CE_None).then(last_error)
    };
    if let Some(text) = error {
        return Err(failed_to_write(out, &format!("lines of {}: {text}", model.display())));
    }
    let flushed = dataset.flush_cache();
    watch.close(dataset)?;
    flushed.map_err(failed)?;
    if line_driver(out)? == SHAPEFILE && is_cut_table(&out.with_extension("dbf")) {
        return Err(failed_to_write(out, "the table beside it could not be written whole; is the disk full?"));
    }
    // Some drivers cannot count while they write.
    let options = DatasetOptions { open_flags: GdalOpenFlags::GDAL_OF_VECTOR, ..Default::default() };
    let written = Dataset::open_ex(out, options).map_err(failed)?;
    Ok(written.layer(0).map_err(failed)?.feature_count())
}

/// Refuses an interval that would draw lines until the disk is full.
fn check_levels(model: &Path, (low, high): (f64, f64), interval: f64) -> Result<()> {
    // A model without any height has no range, and no lines.
    let levels = (high - low) / interval;
    if levels > MOST_LEVELS {
        let message = format!(
            "{}: heights from {} to {} cut at every {interval} make {levels:.0} levels, and {MOST_LEVELS} is the limit",
            model.display(),
            low,
            high
        );
        return Err(Error::usage(message, "give a larger --interval, or declare the model's nodata value"));
    }
    Ok(())
}

/// Refuses cells that are larger than the whole model, and so many that no raster has them.
///
/// # Errors
/// [`Error::Usage`] with the model's own cells.
pub fn check_resolution(model: &Path, side: f64) -> Result<()> {
    let dataset = crate::model::open_dataset(model)?;
    let Ok(t) = dataset.geo_transform() else { return Ok(()) };
    let (width, height) = dataset.raster_size();
    let (cell_x, cell_y) = (t[1].hypot(t[4]), t[2].hypot(t[5]));
    let longest = (width as f64 * cell_x).max(height as f64 * cell_y);
    let cells = longest / side;
    if cells >= 1.0 && cells <= f64::from(i32::MAX) {
        return Ok(());
    }
    let what = format!("--resolution {side}: {} is {longest} units of the map long", model.display());
    Err(Error::usage(what, format!("its cells are {cell_x} × {cell_y}; give the side of a cell in units of the map")))
}

/// A virtual raster of `source` as `gdalwarp` makes it with these options.
///
/// # Errors
/// GDAL's own words, when it cannot.
pub fn warp(source: &Path, out: &Path, options: &[&str]) -> Result<()> {
    warp_dataset(&crate::model::open_stored(source)?, source, out, options)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_colours_are_heights_with_three_or_four_numbers_or_a_name() {
        let path = Path::new("table.txt");
        for row in ["0 0 0 0", "50% 1,2,3", "nv:0:0:0:0", "12.5 red", "# a remark\n1 2 3 4"] {
            check_colours(path, row.as_bytes()).unwrap_or_else(|e| panic!("{row}: {e}"));
        }
        for row in [",", "::", "1", "red 1 2 3", "1 2 3", "1 2 3 4 5 6", "1 r3d", ""] {
            let said = check_colours(path, row.as_bytes()).expect_err(row).to_string();
            assert!(said.contains("table.txt"), "{said}");
        }
    }
}
