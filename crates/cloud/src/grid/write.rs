//! Planes as Cloud Optimized GeoTIFFs, with holes filled.

use std::path::{Path, PathBuf};

use autoref_raster::atomic::Transaction;
use autoref_raster::{Written, failed_to_write, set_unit};
use gdal::raster::{Buffer, GdalType, RasterCreationOptions};
use gdal::{Dataset, DriverManager, Metadata};

use super::place::Place;
use super::plane::Plane;
use super::{Frame, Manner, Options, Stat};
use crate::error::{Error, Result};
use crate::io::stem;

/// Rows that are written at a time at most: whole tiles of a GeoTIFF.
const ROWS: usize = 256;
/// Rows of the lowest tile of a GeoTIFF, of which the others are multiples.
const LEAST_ROWS: usize = 16;
/// Bytes of a cell that is written: as read and as numbers of two planes, filled, as the file has it, in GDAL's cache.
const WRITTEN_BYTES: u64 = 64;
/// Bytes of a cell that only holes are filled from: as read and as a number.
const LOOKED_AT_BYTES: u64 = 16;
/// What GDAL and PDAL take for elevation models.
const NODATA: f64 = -9999.0;

/// So many steps from it on, GDAL tells a float from it.
const BESIDE_STEPS: usize = 16;

/// What is in a band.
enum Content {
    /// A statistic as measured.
    Plane(usize),
    /// A statistic with its holes filled.
    Filled(usize),
    /// 0 a measured cell, 1 a filled one, 2 an empty one.
    Flag,
    Count,
}

/// The files that a cloud's grids get: `STEM_DIMENSION_STAT.tif`, and `STEM_DIMENSION_filled.tif`.
pub fn output_paths(cloud: &Path, folder: &Path, options: &Options) -> Vec<PathBuf> {
    let stem = stem(cloud);
    let mut paths = Vec::new();
    for dimension in &options.dimensions {
        for (name, _) in &options.stats {
            paths.push(folder.join(format!("{stem}_{}_{name}.tif", dimension.name)));
        }
        if fills(options) {
            paths.push(folder.join(format!("{stem}_{}_filled.tif", dimension.name)));
        }
    }
    paths
}

fn fills(options: &Options) -> bool {
    options.fill_cells > 0 && options.stats.iter().any(|(_, stat)| *stat != Stat::Count)
}

/// Bytes that one row takes when it is written, and those of the rows that its holes are filled from.
fn row_bytes(frame: &Frame, options: &Options) -> (u64, u64) {
    let columns = frame.columns as u64;
    let reach = if fills(options) { 2 * options.fill_cells as u64 } else { 0 };
    (columns * WRITTEN_BYTES, columns * reach * LOOKED_AT_BYTES)
}

/// Bytes that the lowest piece of a grid takes when it is written.
pub(super) fn least_bytes(frame: &Frame, options: &Options) -> u64 {
    let (row, reach) = row_bytes(frame, options);
    row * LEAST_ROWS as u64 + reach
}

/// Rows that are written at a time, for so many bytes: whole tiles.
fn rows_together(frame: &Frame, options: &Options, bytes: u64) -> usize {
    let (row, reach) = row_bytes(frame, options);
    let rows = (bytes.saturating_sub(reach) / row.max(1)).min(ROWS as u64) as usize;
    (rows / LEAST_ROWS * LEAST_ROWS).max(LEAST_ROWS)
}

/// Writes all grids of a cloud, all of them or none, with so many bytes for a piece.
pub(super) fn write(
    cloud: &Path,
    folder: &Path,
    frame: &Frame,
    planes: &mut [Vec<Plane>],
    options: &Options,
    (place, bytes): (&Place, u64),
) -> Result<(Vec<PathBuf>, Vec<u64>)> {
    let stem = stem(cloud);
    let together = rows_together(frame, options, bytes);
    let mut files = Transaction::new();
    let mut with_points = Vec::new();
    for (dimension, planes) in options.dimensions.iter().zip(planes) {
        with_points.push(count_cells(frame, &planes[0]).map_err(|e| scratch(options, e))?);
        let target = |name: &str| folder.join(format!("{stem}_{}_{name}.tif", dimension.name));
        let grid = Grid { frame, planes, options, place, dimension: &dimension.name, together };
        for (index, (name, stat)) in options.stats.iter().enumerate() {
            let content = if *stat == Stat::Count { Content::Count } else { Content::Plane(index + 1) };
            files.stage(&target(name), |path| grid.write(path, &[(content, name.clone())]))?;
        }
        if fills(options) {
            let mut bands = Vec::new();
            let valued = options.stats.iter().enumerate().filter(|(_, (_, stat))| *stat != Stat::Count);
            for (index, (name, _)) in valued {
                bands.push((Content::Filled(index + 1), format!("{name}, holes filled")));
            }
            bands.insert(1, (Content::Flag, "0 measured, 1 filled, 2 empty".into()));
            bands.insert(2, (Content::Count, "count".into()));
            files.stage(&target("filled"), |path| grid.write(path, &bands))?;
        }
    }
    let paths = output_paths(cloud, folder, options);
    files.commit()?;
    Ok((paths, with_points))
}

fn scratch(options: &Options, error: std::io::Error) -> Error {
    Error::io(&options.scratch, "read scratch data from", error)
}

fn count_cells(frame: &Frame, counts: &Plane) -> std::io::Result<u64> {
    let mut cells = 0;
    for row in (0..frame.rows).step_by(LEAST_ROWS) {
        let rows = LEAST_ROWS.min(frame.rows - row);
        cells += counts.read(row, rows)?.iter().filter(|&&count| count > 0.0).count() as u64;
    }
    Ok(cells)
}

struct Grid<'a> {
    frame: &'a Frame,
    planes: &'a [Plane],
    options: &'a Options,
    place: &'a Place,
    dimension: &'a str,
    /// Rows that are written at a time.
    together: usize,
}

impl Grid<'_> {
    fn write(&self, path: &Path, bands: &[(Content, String)]) -> Result<()> {
        let failed = |e: gdal::errors::GdalError| failed_to_write(path, &e.to_string());
        let plain = path.with_extension("plain.tif");
        // Places and times need more digits than a single has.
        let made = match self.dimension {
            "x" | "y" | "gps_time" => {
                let beside = (0..BESIDE_STEPS).fold(NODATA, |value, _| value.next_up());
                self.write_plain::<f64>(&plain, bands, beside, |value| value)
            }
            _ => {
                let beside = (0..BESIDE_STEPS).fold(NODATA as f32, |value, _| value.next_up());
                self.write_plain::<f32>(&plain, bands, beside, |value| value as f32)
            }
        };
        let made = made.and_then(|()| {
            let cog = DriverManager::get_driver_by_name("COG").map_err(failed)?;
            let source = Dataset::open(&plain).map_err(failed)?;
            let settings = RasterCreationOptions::from_iter([
                "COMPRESS=DEFLATE",
                "BIGTIFF=IF_SAFER",
                "NUM_THREADS=1",
                "RESAMPLING=NEAREST",
            ]);
            let watch = Written::watch(path);
            let copy = source.create_copy(&cog, path, &settings).map_err(failed)?;
            watch.close(copy)
        });
        let _ = std::fs::remove_file(&plain);
        made
    }

    /// A value that would be read as nothing becomes `beside`.
    fn write_plain<T: GdalType + Copy + PartialEq>(
        &self,
        path: &Path,
        bands: &[(Content, String)],
        beside: T,
        cast: impl Fn(f64) -> T,
    ) -> Result<()> {
        let failed = |e: gdal::errors::GdalError| failed_to_write(path, &e.to_string());
        let watch = Written::watch(path);
        let driver = DriverManager::get_driver_by_name("GTiff").map_err(failed)?;
        let tile_rows = format!("BLOCKYSIZE={}", self.together);
        let settings = RasterCreationOptions::from_iter([
            "TILED=YES",
            "BIGTIFF=IF_SAFER",
            "INTERLEAVE=BAND",
            "COMPRESS=ZSTD",
            &tile_rows,
        ]);
        let (columns, rows) = (self.frame.columns, self.frame.rows);
        let mut file = driver
            .create_with_band_type_with_options::<T, _>(path, columns, rows, bands.len(), &settings)
            .map_err(failed)?;
        let cell = self.frame.cell_m;
        file.set_geo_transform(&[self.frame.west, cell, 0.0, self.frame.north, 0.0, -cell]).map_err(failed)?;
        let is_height =
            |content: &Content| self.dimension == "z" && matches!(content, Content::Plane(_) | Content::Filled(_));
        let some_heights = bands.iter().any(|(content, _)| is_height(content));
        let wkt = if some_heights { &self.place.wkt } else { &self.place.plane };
        if let Some(wkt) = wkt {
            file.set_projection(wkt).map_err(failed)?;
        }
        file.set_metadata_item("DIMENSION", self.dimension, "").map_err(failed)?;
        for (index, (content, name)) in bands.iter().enumerate() {
            let mut band = file.rasterband(index + 1).map_err(failed)?;
            band.set_description(name).map_err(failed)?;
            // A band without a unit would have that of the vertical axis.
            let other = (some_heights && self.place.wkt != self.place.plane).then_some("unitless");
            if let Some(unit) = if is_height(content) { self.place.height_unit } else { other } {
                set_unit(path, &band, unit)?;
            }
            // All bands of a GeoTIFF share one value for nothing; counts and flags never take it.
            band.set_no_data_value(Some(NODATA)).map_err(failed)?;
            for begin in (0..rows).step_by(self.together) {
                let count = self.together.min(rows - begin);
                let values = self.rows(content, begin, count).map_err(|e| scratch(self.options, e))?;
                let void = cast(NODATA);
                let stored = |value: f64| match cast(value) {
                    _ if value.is_nan() => void,
                    stored if stored == void => beside,
                    stored => stored,
                };
                let values: Vec<T> = values.into_iter().map(stored).collect();
                let mut buffer = Buffer::new((columns, count), values);
                band.write((0, begin as isize), (columns, count), &mut buffer).map_err(failed)?;
            }
        }
        watch.close(file)
    }

    fn rows(&self, content: &Content, begin: usize, count: usize) -> std::io::Result<Vec<f64>> {
        match content {
            Content::Plane(plane) => self.planes[*plane].read(begin, count),
            Content::Count => self.planes[0].read(begin, count),
            Content::Filled(plane) => self.filled(&self.planes[*plane], begin, count),
            Content::Flag => {
                let counts = self.planes[0].read(begin, count)?;
                // Which statistic is filled makes no difference to where.
                let first = 1 + self.options.stats.iter().position(|(_, stat)| *stat != Stat::Count).unwrap_or(0);
                let filled = self.filled(&self.planes[first], begin, count)?;
                let flag = |(count, value): (&f64, &f64)| match (*count > 0.0, value.is_nan()) {
                    (true, _) => 0.0,
                    (false, false) => 1.0,
                    (false, true) => 2.0,
                };
                Ok(counts.iter().zip(&filled).map(flag).collect())
            }
        }
    }

    /// Cells without a value get the mean of their neighbours in the window, weighed by inverse distance.
    fn filled(&self, plane: &Plane, begin: usize, count: usize) -> std::io::Result<Vec<f64>> {
        let reach = self.options.fill_cells;
        let first = begin.saturating_sub(reach);
        let last = (begin + count + reach).min(self.frame.rows);
        let values = plane.read(first, last - first)?;
        let columns = self.frame.columns;
        let mut out = values[(begin - first) * columns..(begin - first + count) * columns].to_vec();
        for row in 0..count {
            for column in 0..columns {
                if !out[row * columns + column].is_nan() {
                    continue;
                }
                let centre = row + begin - first;
                let (mut sum, mut weights) = (0.0, 0.0);
                for y in centre.saturating_sub(reach)..(centre + reach + 1).min(last - first) {
                    for x in column.saturating_sub(reach)..(column + reach + 1).min(columns) {
                        let value = values[y * columns + x];
                        if !value.is_nan() {
                            let weight = self.weight(x.abs_diff(column), y.abs_diff(centre));
                            sum += weight * value;
                            weights += weight;
                        }
                    }
                }
                if weights > 0.0 {
                    out[row * columns + column] = sum / weights;
                }
            }
        }
        Ok(out)
    }

    fn weight(&self, columns: usize, rows: usize) -> f64 {
        match self.options.manner {
            Manner::Snapped => ((columns * columns + rows * rows) as f64).sqrt().powf(-self.options.power),
            Manner::Pdal => 1.0 / columns.max(rows) as f64,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Noise;

    #[test]
    fn pieces_of_wide_grids_are_as_high_as_memory_allows() {
        let frame = |columns: usize| Frame { columns, rows: 9000, west: 0.0, north: 0.0, cell_m: 0.1 };
        let stats = vec![("mean".to_string(), Stat::Mean)];
        let of = |columns: usize, fill_cells: usize, bytes: u64| {
            let options = Options {
                cell_m: 0.1,
                stats: stats.clone(),
                dimensions: Vec::new(),
                fill_cells,
                power: 1.0,
                manner: Manner::Snapped,
                noise: Noise::LeaveOut,
                shift: None,
                camera: None,
                memory_bytes: 0,
                scratch: PathBuf::new(),
                crs_wkt: None,
            };
            (rows_together(&frame(columns), &options, bytes), least_bytes(&frame(columns), &options))
        };
        assert_eq!(of(5000, 3, 432 << 20).0, ROWS);
        let (rows, least) = of(100_000, 0, 432 << 20);
        assert_eq!((rows, least), (64, 16 * 64 * 100_000));
        assert_eq!(of(100_000, 0, least).0, LEAST_ROWS);
        assert!(of(100_000, 100, 1 << 30).1 > 320_000_000, "holes are filled from 200 rows more");
    }
}
