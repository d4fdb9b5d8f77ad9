//! Rasters written as they are computed: tiles in parallel, blocks in one order, so that the file is the same for any
//! tiling and any number of threads.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Condvar, Mutex, PoisonError};

use gdal::raster::{Buffer, GdalType, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DriverManager};

use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::window::Window;
use autoref_raster::atomic::{self, Existing};
use autoref_raster::{Written, failed_to_write};

/// Side of the blocks in files that are written, of few bands.
pub const FILE_BLOCK_PX: u64 = 256;

/// Side of the blocks of a file with so many bands: tiles hold them all.
pub fn block_px(bands: usize) -> u64 {
    const MOST_VALUES: u64 = 1 << 18;
    let fits = |side: &u64| side * side * bands as u64 <= MOST_VALUES;
    [FILE_BLOCK_PX, 128, 64, 32].into_iter().find(fits).unwrap_or(16)
}

/// How a file that is written is cut up.
#[derive(Clone, Copy, Debug)]
pub struct Cut {
    /// Width of the tiles, brought up to whole blocks.
    pub tile_px: u64,
    /// Side of the file's blocks, and the height of the tiles.
    pub block_px: u64,
}

impl Cut {
    /// Of a file with one band.
    pub fn of_one_band(tile_px: u64) -> Self {
        Cut { tile_px, block_px: FILE_BLOCK_PX }
    }
}

/// Extensions that promise another format than the GeoTIFF that is written.
const OTHER_FORMATS: [&str; 15] =
    ["png", "jpg", "jpeg", "webp", "jp2", "gif", "bmp", "vrt", "img", "asc", "grd", "nc", "hdr", "bil", "xyz"];

/// Whether rasters can be written so: [`atomic::check_outputs`], and no name promises another format than GeoTIFF.
///
/// # Errors
/// When one cannot.
pub fn check(outs: &[&Path], existing: Existing) -> Result<()> {
    for out in outs {
        let extension = out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if OTHER_FORMATS.contains(&extension.as_str()) {
            let what = format!("{}: a GeoTIFF is written, which is not called `.{extension}`", out.display());
            return Err(Error::usage(what, "name it .tif; gdal_translate turns it into other formats"));
        }
    }
    atomic::check_outputs(outs, existing)
}

/// What the file is told of its content.
#[derive(Clone, Copy, Debug)]
pub struct Form<'a> {
    pub grid: Grid,
    /// Empty for none.
    pub wkt: &'a str,
    pub bands: usize,
    pub nodata: Option<f64>,
    /// Two for differences of whole numbers, three for floating point.
    pub predictor: u8,
    pub threads: usize,
}

/// Creates a tiled, compressed GeoTIFF.
///
/// # Errors
/// When GDAL cannot.
pub fn create<T: GdalType>(path: &Path, form: &Form<'_>) -> Result<Dataset> {
    let failed = |e: gdal::errors::GdalError| failed_to_write(path, &e.to_string());
    let predictor = format!("PREDICTOR={}", form.predictor);
    let threads = format!("NUM_THREADS={}", form.threads.max(1));
    let [across, down] = ["X", "Y"].map(|axis| format!("BLOCK{axis}SIZE={}", block_px(form.bands)));
    let options = RasterCreationOptions::from_iter([
        "TILED=YES",
        // A block that holds all bands is read back, decoded and written again for each of them when it leaves GDAL's
        // cache too early, and decoded again for each when overviews are made.
        "INTERLEAVE=BAND",
        &across,
        &down,
        "COMPRESS=DEFLATE",
        "ZLEVEL=1",
        "SPARSE_OK=TRUE",
        "BIGTIFF=IF_SAFER",
        &predictor,
        &threads,
    ]);
    let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
    let (width, height) = (form.grid.width as usize, form.grid.height as usize);
    let mut dataset =
        driver.create_with_band_type_with_options::<T, _>(path, width, height, form.bands, &options).map_err(failed)?;
    dataset.set_geo_transform(&form.grid.transform().0).map_err(failed)?;
    if !form.wkt.is_empty() {
        dataset.set_spatial_ref(&SpatialRef::from_wkt(form.wkt).map_err(failed)?).map_err(failed)?;
    }
    if form.nodata.is_some() {
        for band in 1..=form.bands {
            dataset.rasterband(band).and_then(|mut b| b.set_no_data_value(form.nodata)).map_err(failed)?;
        }
    }
    Ok(dataset)
}

/// Writes all bands of a window; `values` holds band after band.
///
/// # Errors
/// When GDAL cannot.
pub fn put<T: GdalType + Copy>(path: &Path, dataset: &Dataset, window: Window, values: Vec<T>) -> Result<()> {
    let size = (window.width as usize, window.height as usize);
    let put_band = |index: usize, plane: Vec<T>| {
        dataset
            .rasterband(index + 1)
            .and_then(|mut band| {
                band.write((window.x as isize, window.y as isize), size, &mut Buffer::new(size, plane))
            })
            .map_err(|e| failed_to_write(path, &e.to_string()))
    };
    if values.len() == size.0 * size.1 {
        return put_band(0, values);
    }
    values.chunks_exact(size.0 * size.1).enumerate().try_for_each(|(index, plane)| put_band(index, plane.to_vec()))
}

/// Closes the file; what GDAL met while it wrote the last blocks is an error.
///
/// # Errors
/// When GDAL says so; a full disk is named as such.
pub fn finish(path: &Path, mut dataset: Dataset) -> Result<()> {
    let watch = Written::watch(path);
    let flushed = dataset.flush_cache();
    watch.close(dataset)?;
    flushed.map_err(|e| failed_to_write(path, &e.to_string()))
}

/// Windows of whole file blocks, row by row: as wide as a tile and one block high.
fn windows(grid: &Grid, cut: Cut) -> impl Fn(u64) -> Option<Window> + use<> {
    let side = cut.tile_px.max(1).next_multiple_of(cut.block_px).min(grid.width.max(1));
    let (width, height) = (grid.width, grid.height);
    let columns = width.div_ceil(side);
    move |id| {
        let (x, y) = (id % columns * side, id / columns * cut.block_px);
        (y < height).then(|| Window::new(x, y, side.min(width - x), cut.block_px.min(height - y)))
    }
}

struct Line<R> {
    next: u64,
    written: u64,
    ready: BTreeMap<u64, (Window, R)>,
    failed: Option<Error>,
    workers: usize,
}

/// Computes all windows of `grid` on `threads` threads and hands the results to `sink` row by row. Returns the states.
///
/// # Errors
/// The first error of `job` or `sink`.
pub fn produce<S: Send, R: Send>(
    grid: &Grid,
    cut: Cut,
    threads: usize,
    state: impl Fn() -> S + Sync,
    job: impl Fn(&mut S, Window) -> Result<R> + Sync,
    mut sink: impl FnMut(Window, R) -> Result<()>,
) -> Result<Vec<S>> {
    let window_of = windows(grid, cut);
    let threads = threads.max(1);
    let line = Mutex::new(Line { next: 0, written: 0, ready: BTreeMap::new(), failed: None, workers: threads });
    let changed = Condvar::new();
    let lock = || line.lock().unwrap_or_else(PoisonError::into_inner);
    let work = || {
        let mut mine = state();
        loop {
            let (id, window) = {
                let mut line = lock();
                // No further ahead of the file than this, or what is ready would pile up.
                while line.failed.is_none() && line.next >= line.written + 3 * threads as u64 {
                    line = changed.wait(line).unwrap_or_else(PoisonError::into_inner);
                }
                let Some(window) = window_of(line.next).filter(|_| line.failed.is_none()) else { break };
                line.next += 1;
                (line.next - 1, window)
            };
            let result = job(&mut mine, window);
            let mut line = lock();
            match result {
                Ok(result) => {
                    line.ready.insert(id, (window, result));
                }
                Err(error) => {
                    line.failed.get_or_insert(error);
                }
            }
            changed.notify_all();
        }
        lock().workers -= 1;
        changed.notify_all();
        mine
    };
    std::thread::scope(|scope| {
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(work)).collect();
        let mut line = lock();
        loop {
            let written = line.written;
            if line.failed.is_none()
                && let Some((window, result)) = line.ready.remove(&written)
            {
                drop(line);
                let done = sink(window, result);
                line = lock();
                line.written += 1;
                if let Err(error) = done {
                    line.failed.get_or_insert(error);
                }
                changed.notify_all();
                continue;
            }
            if line.workers == 0 {
                break;
            }
            line = changed.wait(line).unwrap_or_else(PoisonError::into_inner);
        }
        let failed = line.failed.take();
        drop(line);
        let states = handles.into_iter().map(|h| h.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)));
        let states: Vec<S> = states.collect();
        failed.map_or(Ok(states), Err)
    })
}

/// The mask of a window: 255 where there is something.
pub(crate) fn put_mask(path: &Path, dataset: &Dataset, window: Window, mask: Vec<u8>) -> Result<()> {
    let (at, size) = ((window.x as isize, window.y as isize), (window.width as usize, window.height as usize));
    dataset
        .rasterband(1)
        .and_then(|band| band.open_mask_band()?.write(at, size, &mut Buffer::new(size, mask)))
        .map_err(|e| failed_to_write(path, &e.to_string()))
}
