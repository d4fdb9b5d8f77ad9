//! Streaming a scene into a GeoTIFF through GDAL, in windows that follow the file's blocks.

use autoref_raster::Written;
use std::path::{Path, PathBuf};

use gdal::DriverManager;
use gdal::raster::{Buffer, ColorInterpretation, GdalType, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;
use rayon::prelude::*;

use super::scene::{Sample, Scene};
use super::spec::{BigTiff, Border, Compression, FileLayout, Interleave, Output, SynthSpec};
use super::truth::Truth;
use autoref_raster::atomic::{Transaction, refuse_left_behind};
use autoref_raster::error::{Error, Result};
use autoref_raster::protected::refuse_input;
use autoref_raster::window::{TileGrid, Window};

/// Pixels drawn as one piece of work, about.
const CHUNK_PX: u64 = 1 << 18;

/// Decoded bytes above which the file becomes a BigTIFF; a little below 4 GiB, for the directory.
const CLASSIC_LIMIT: u64 = 4_200_000_000;

/// Told pixels done, pixels in all.
pub type Progress<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// Where the truth of a picture lies: `NAME.tif` → `NAME.truth.json`.
pub fn truth_path(image: &Path) -> PathBuf {
    image.with_extension("truth.json")
}

/// Draws the scene of `spec` into the GeoTIFF `path` and its truth beside it ([`truth_path`]). Both appear whole, or
/// not at all. At any time a few pieces of a quarter of a megapixel are in memory, and GDAL's block cache.
///
/// # Errors
/// [`Error::Usage`] for a spec that contradicts itself or an existing output without `overwrite`, [`Error::Io`] and
/// [`Error::Gdal`] when reading photographs or writing fails.
pub fn write(spec: &SynthSpec, path: &Path) -> Result<Truth> {
    write_with_progress(spec, path, &|_, _| {})
}

/// As [`write`](fn@write), telling how far it is after every piece.
///
/// # Errors
/// As [`write`](fn@write).
pub fn write_with_progress(spec: &SynthSpec, path: &Path, progress: Progress) -> Result<Truth> {
    check(spec)?;
    let truth_file = truth_path(path);
    if !spec.output.overwrite {
        for file in [path, &truth_file] {
            refuse_existing(file)?;
        }
    }
    for file in [path, &truth_file] {
        refuse_input(file)?;
    }
    if let Some(folder) = path.parent().filter(|f| !f.as_os_str().is_empty() && !f.is_dir()) {
        return Err(Error::usage(format!("{}: no such folder", folder.display()), "create it first"));
    }
    let scene = Scene::new(spec)?;
    let mut files = Transaction::new();
    files.stage(path, |part| match spec.output.bits {
        8 => stream::<u8>(&scene, spec, part, progress),
        _ => stream::<u16>(&scene, spec, part, progress),
    })?;
    files.stage_bytes(&truth_file, &scene.truth().to_json())?;
    files.commit()?;
    Ok(scene.truth().clone())
}

pub(crate) fn refuse_existing(path: &Path) -> Result<()> {
    if path.exists() {
        return Err(Error::usage(format!("{}: exists already", path.display()), "use --overwrite or another name"));
    }
    refuse_left_behind(path)
}

fn check(spec: &SynthSpec) -> Result<()> {
    let o = &spec.output;
    let refuse = |what: &str, remedy: &str| Err(Error::usage(what, remedy));
    match o.layout {
        FileLayout::Tiles(n) if n == 0 || n % 16 != 0 || n > 4096 => {
            return refuse("tiles must be a multiple of 16 pixels, up to 4096", "use 256 or 512");
        }
        FileLayout::Strips(0) => return refuse("strips of 0 rows", "use 1 or more"),
        FileLayout::Tiles(_) | FileLayout::Strips(_) => {}
    }
    match (o.bits, o.compression) {
        (8, Compression::Jpeg(q)) if !(1..=100).contains(&q) => refuse("JPEG quality is 1 to 100", "use 75 to 95"),
        (16, Compression::Jpeg(_)) => refuse("JPEG holds 8 bits a sample", "use 8 bits or another compression"),
        (8 | 16, _) => Ok(()),
        _ => refuse("samples are 8 or 16 bits", "use one of them"),
    }
}

fn creation_options(o: &Output, bands: usize, bytes: u64) -> Result<RasterCreationOptions> {
    let mut list: Vec<(&str, String)> = vec![];
    match o.layout {
        FileLayout::Tiles(n) => {
            list.extend([("TILED", "YES".into()), ("BLOCKXSIZE", n.to_string()), ("BLOCKYSIZE", n.to_string())]);
        }
        FileLayout::Strips(rows) => list.push(("BLOCKYSIZE", rows.to_string())),
    }
    let name = match o.compression {
        Compression::None => "NONE",
        Compression::Deflate => "DEFLATE",
        Compression::Lzw => "LZW",
        Compression::Zstd => "ZSTD",
        Compression::Packbits => "PACKBITS",
        Compression::Jpeg(_) => "JPEG",
    };
    list.push(("COMPRESS", name.into()));
    if let Compression::Jpeg(quality) = o.compression {
        list.push(("JPEG_QUALITY", quality.to_string()));
    }
    if o.predictor && matches!(o.compression, Compression::Deflate | Compression::Lzw | Compression::Zstd) {
        list.push(("PREDICTOR", "2".into()));
    }
    let chunky = o.interleave == Interleave::Pixel;
    list.push(("INTERLEAVE", if chunky { "PIXEL" } else { "BAND" }.into()));
    let ycbcr = matches!(o.compression, Compression::Jpeg(_)) && bands == 3 && chunky;
    list.push(("PHOTOMETRIC", if ycbcr { "YCBCR" } else { "RGB" }.into()));
    if bands == 4 {
        list.push(("ALPHA", "YES".into()));
    }
    let big = o.big_tiff == BigTiff::Always || bytes > CLASSIC_LIMIT;
    list.push(("BIGTIFF", if big { "YES" } else { "NO" }.into()));
    if o.compression != Compression::None {
        list.push(("NUM_THREADS", rayon::current_num_threads().to_string()));
    }
    let mut options = RasterCreationOptions::new();
    for (key, value) in list {
        options.set_name_value(key, &value).map_err(|e| Error::gdal("creation options", e))?;
    }
    Ok(options)
}

/// The windows in the order of the file: a run of tiles, or rows of strips.
fn windows(width: u64, height: u64, layout: FileLayout) -> TileGrid {
    match layout {
        FileLayout::Tiles(n) => TileGrid::new(width, height, n * (CHUNK_PX / (n * n)).max(1), n, 0),
        FileLayout::Strips(rows) => {
            let fitting = (CHUNK_PX / width).max(1);
            let rows = if fitting >= rows { fitting / rows * rows } else { fitting };
            TileGrid::new(width, height, width, rows, 0)
        }
    }
}

/// The file, with what it says of its place and of pixels that hold nothing.
fn create<T: Sample + GdalType>(scene: &Scene, spec: &SynthSpec, path: &Path, bands: usize) -> Result<gdal::Dataset> {
    let (width, height) = (scene.width(), scene.height());
    let bytes = width * height * bands as u64 * std::mem::size_of::<T>() as u64;
    let gdal = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let driver = DriverManager::get_driver_by_name("GTiff").map_err(gdal)?;
    let options = creation_options(&spec.output, bands, bytes)?;
    let mut dataset = driver
        .create_with_band_type_with_options::<T, _>(path, width as usize, height as usize, bands, &options)
        .map_err(gdal)?;
    if spec.output.georeferenced {
        dataset.set_geo_transform(&scene.truth().geotransform.0).map_err(gdal)?;
        if let Some(code) = spec.output.epsg {
            dataset.set_spatial_ref(&SpatialRef::from_epsg(code).map_err(gdal)?).map_err(gdal)?;
        }
    }
    for b in 1..=bands {
        let mut band = dataset.rasterband(b).map_err(gdal)?;
        if let Border::Nodata { value, .. } = spec.border {
            let scale = f64::from(T::SCALE);
            band.set_no_data_value(Some(f64::from(value) * scale)).map_err(gdal)?;
        }
        if b == 4 {
            band.set_color_interpretation(ColorInterpretation::AlphaBand).map_err(gdal)?;
        }
    }
    Ok(dataset)
}

/// Draws pieces in parallel and writes them in order, drawing the next while the last are written.
fn stream<T: Sample + GdalType + 'static>(
    scene: &Scene,
    spec: &SynthSpec,
    path: &Path,
    progress: Progress,
) -> Result<()> {
    let alpha = matches!(spec.border, Border::Alpha { .. });
    let gdal = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let mut dataset = create::<T>(scene, spec, path, if alpha { 4 } else { 3 })?;
    let (width, height) = (scene.width(), scene.height());
    let grid = windows(width, height, spec.output.layout);
    let batch = 2 * rayon::current_num_threads() as u64;
    std::thread::scope(|scope| {
        let (sender, receiver) = crossbeam_channel::bounded::<Vec<(Window, Vec<Buffer<T>>)>>(1);
        let writer = scope.spawn(move || -> Result<()> {
            let written = Written::watch(path);
            let mut done = 0;
            for pieces in receiver {
                for (window, planes) in pieces {
                    for (b, mut plane) in planes.into_iter().enumerate() {
                        let mut band = dataset.rasterband(b + 1).map_err(gdal)?;
                        let at = (window.x as isize, window.y as isize);
                        let size = (window.width as usize, window.height as usize);
                        band.write(at, size, &mut plane).map_err(gdal)?;
                    }
                    done += window.area();
                    progress(done, width * height);
                }
            }
            // Closing flushes what is left; a full disk shows here.
            dataset.flush_cache().map_err(gdal)?;
            written.close(dataset)
        });
        let mut drawn = Ok(());
        for first in (0..grid.len()).step_by(batch as usize) {
            let pieces: Result<Vec<_>> = (first..(first + batch).min(grid.len()))
                .into_par_iter()
                .map(|id| {
                    let window = grid.tile(id).core;
                    Ok((window, planes::<T>(scene, window, alpha)?))
                })
                .collect();
            match pieces {
                Ok(pieces) => {
                    if sender.send(pieces).is_err() {
                        // The writer has failed and hung up; its error is told below.
                        break;
                    }
                }
                Err(e) => {
                    drawn = Err(e);
                    break;
                }
            }
        }
        drop(sender);
        let written = writer.join().expect("the writer returns its errors and does not panic");
        drawn.and(written)
    })
}

/// A window as one buffer per band.
fn planes<T: Sample + GdalType>(scene: &Scene, window: Window, alpha: bool) -> Result<Vec<Buffer<T>>> {
    let pixels = scene.render::<T>(window)?;
    let shape = (window.width as usize, window.height as usize);
    let mut planes: Vec<Buffer<T>> =
        (0..3).map(|b| Buffer::new(shape, pixels.iter().skip(b).step_by(3).copied().collect())).collect();
    if alpha {
        let opaque = T::from_scaled(255.0 * T::SCALE);
        let values = (window.y..window.bottom())
            .flat_map(|y| (window.x..window.right()).map(move |x| (x, y)))
            .map(|(x, y)| if scene.is_valid(x, y) { opaque } else { T::default() })
            .collect();
        planes.push(Buffer::new(shape, values));
    }
    Ok(planes)
}
