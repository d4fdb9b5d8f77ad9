//! From files to files: `dem align`.

use std::path::Path;

use gdal::raster::GdalDataType;
use gdal::vector::LayerAccess;
use gdal::{Dataset, DatasetOptions, GdalOpenFlags};

use crate::align::{self, Alignment, Degree, Method, Outcome};
use crate::couple::{Couple, open_couple};
use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::kept::Room;
use crate::model::Model;
use crate::output::{self, Cut, Form};
use crate::source::Heights;
use crate::stream::Means;
use crate::turns;
use crate::zones::{Ring, Zones};

/// The smallest `--memory` that is accepted.
pub const SMALLEST_BUDGET_BYTES: u64 = 112 << 20;

/// Decoded blocks of models that are kept, at least.
const LEAST_BLOCK_CACHE_BYTES: u64 = 8 << 20;

/// What a command may take.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Side of the tiles; chosen from the layout of the files when `None`.
    pub tile_px: Option<u64>,
    pub threads: usize,
    pub memory_budget_bytes: u64,
}

impl Resources {
    /// # Errors
    /// [`Error::Limit`] below the smallest budget.
    pub fn check(&self) -> Result<()> {
        if self.memory_budget_bytes < SMALLEST_BUDGET_BYTES {
            return Err(Error::Limit {
                what: "--memory is below what the libraries need".into(),
                needed: SMALLEST_BUDGET_BYTES,
                allowed: self.memory_budget_bytes,
                remedy: "give --memory 112M or more".into(),
            });
        }
        autoref_raster::initialise_gdal(self.memory_budget_bytes / 4);
        autoref_raster::tiff::bound_float_cache((self.spare_bytes() / 5).max(LEAST_BLOCK_CACHE_BYTES));
        Ok(())
    }

    /// What is left for tiles beside the libraries.
    fn spare_bytes(&self) -> u64 {
        self.memory_budget_bytes.saturating_sub(96 << 20)
    }

    /// Tiles and threads for models of this layout: whole strips of wide files, squares of others.
    pub fn means(&self, models: &[&Model]) -> Means {
        const BYTES_PER_CELL: u64 = 64;
        const WORKER_BYTES: u64 = 24 << 20;
        let threads = self.threads.max(1) as u64;
        let threads = threads.min(self.spare_bytes() / 2 / (WORKER_BYTES + (4 << 20))).max(1);
        let cells = (self.spare_bytes() / 2 / threads / BYTES_PER_CELL).clamp(1 << 14, 1 << 18);
        let side = (cells as f64).sqrt() as u64;
        if let Some(tile_px) = self.tile_px {
            return Means::square(tile_px.min(side.max(256) * 4), threads as usize);
        }
        let strips = models.iter().any(|m| m.block().0 as u64 == m.grid().width && m.grid().width > 2048);
        if strips {
            let width = models.iter().map(|m| m.grid().width).max().unwrap_or(side);
            let across = width.min(cells / 16);
            return Means { tile_px: across, tile_rows_px: (cells / across).max(16), threads: threads as usize };
        }
        Means::square(side, threads as usize)
    }

    /// Cells of a model that a search may hold.
    pub fn memory_cells(&self) -> u64 {
        (self.spare_bytes() / 2 / 110).clamp(60_000, 1_500_000)
    }

    /// Cells of four bytes that a comparison keeps of what its first pass saw: it holds no model beside them.
    pub fn kept_cells(&self) -> u64 {
        self.held_cells().max(self.spare_bytes() / 3 / 4)
    }

    /// Cells of two models together that are held whole, four bytes each: a fifth of the budget.
    pub fn held_cells(&self) -> u64 {
        self.memory_budget_bytes / 5 / 4
    }
}

/// Reads polygons of a vector file into the CRS of a model, where it counts its longitudes; the name of each is its
/// attribute `name`, `id` or the like, or its number. `bounds` are the model's. What has no area among polygons is a
/// zone without a cell.
///
/// # Errors
/// When the file cannot be read, or holds no polygon.
pub fn read_zones(path: &Path, wkt: &str, bounds: [f64; 4]) -> Result<Zones> {
    let in_degrees = !wkt.is_empty() && Crs::parse(wkt)?.counts_degrees();
    let areas = read_features(path, wkt)?;
    Ok(if in_degrees { turns::zones_beside(areas, bounds) } else { Zones::new(areas.into_iter().map(flat)) })
}

fn flat((name, polygons): (String, Vec<Vec<Ring>>)) -> (String, Vec<Ring>) {
    (name, polygons.into_iter().flatten().collect())
}

/// Polygons of any vector file with their names and rings, in the CRS of `wkt` where both it and the file name one.
/// Corners that cannot be degrees are taken for map coordinates, whatever a geographic CRS of the file says.
///
/// # Errors
/// When the file cannot be read, holds no polygon, or cannot be transformed.
pub fn read_areas(path: &Path, wkt: &str) -> Result<Vec<(String, Vec<Ring>)>> {
    Ok(read_polygons(path, wkt)?.into_iter().map(flat).collect())
}

/// The same, each polygon of an area with its own rings: they may overlap.
///
/// # Errors
/// Those of [`read_areas`].
pub fn read_polygons(path: &Path, wkt: &str) -> Result<Vec<(String, Vec<Vec<Ring>>)>> {
    let mut areas = read_features(path, wkt)?;
    areas.retain(|(_, polygons)| !polygons.is_empty());
    Ok(areas)
}

/// The same with the features that have no polygon, in layers that hold one.
fn read_features(path: &Path, wkt: &str) -> Result<Vec<(String, Vec<Vec<Ring>>)>> {
    autoref_raster::bounded::refuse_endless(path)?;
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let flags = GdalOpenFlags::GDAL_OF_VECTOR | GdalOpenFlags::GDAL_OF_VERBOSE_ERROR;
    let open_options = autoref_raster::vector_options(path);
    let options = DatasetOptions { open_flags: flags, open_options, ..Default::default() };
    let dataset = Dataset::open_ex(path, options).map_err(failed)?;
    let mut areas: Vec<(String, Vec<Vec<Ring>>)> = Vec::new();
    let mut count = 0;
    let target = (!wkt.is_empty()).then(|| Crs::parse(wkt)).transpose()?;
    for mut layer in dataset.layers() {
        let own = crs_of_layer(path, &layer)?;
        let (before, first) = (count, areas.len());
        for feature in layer.features() {
            let mut polygons: Vec<Vec<Ring>> = Vec::new();
            if let Some(geometry) = feature.geometry().filter(|_| crate::labels::has_geometry(&feature)) {
                collect_polygons(geometry, &mut polygons);
                // Texts and lines beside areas are no zones.
                if polygons.is_empty() && !geometry.is_empty() && !geometry.geometry_name().contains("POLYGON") {
                    continue;
                }
            }
            let number = feature.fid().map_or_else(|| "without a number".into(), |id| id.to_string());
            if polygons.iter().flatten().flatten().any(|(x, y)| !(x.is_finite() && y.is_finite())) {
                return Err(Error::format(path, format!("feature {number}"), "a coordinate of a corner is not finite"));
            }
            // GDAL takes GeoJSON that names no system for degrees; coordinates of a map show that they are none.
            let degrees = |&(x, y): &(f64, f64)| x.abs() <= 360.0 && y.abs() <= 90.0;
            let own =
                own.as_ref().filter(|crs| !crs.is_geographic() || polygons.iter().flatten().flatten().all(degrees));
            if let (Some(from), Some(to)) = (own, &target) {
                for polygon in &mut polygons {
                    for ring in polygon.iter_mut() {
                        let mut points: Vec<_> =
                            ring.iter().map(|&(x, y)| crate::crs::Coordinate { x, y, height: None }).collect();
                        from.transform(&mut points, to, crate::crs::DEFAULT_DATUM_ACCURACY_M)?;
                        let before = std::mem::replace(ring, points.iter().map(|p| (p.x, p.y)).collect());
                        if to.counts_degrees() {
                            turns::join(ring, from.is_geographic().then_some(&before));
                        }
                    }
                    if to.counts_degrees() {
                        turns::bring_holes(polygon);
                    }
                }
            }
            count += usize::from(!polygons.is_empty());
            let named = feature.fields().find(|(key, _)| {
                ["name", "id", "glacier", "line", "zone"].contains(&key.to_ascii_lowercase().as_str())
            });
            let name = named.and_then(|(_, value)| value.and_then(|v| v.into_string())).filter(|name| !name.is_empty());
            let unnamed = || if polygons.is_empty() { format!("feature {number}") } else { count.to_string() };
            areas.push((name.unwrap_or_else(unnamed), polygons));
        }
        // Lines or points alone are no zones.
        if count == before {
            areas.truncate(first);
        }
    }
    if areas.is_empty() {
        let what = "no polygon in it; make polygons of its lines or points (Polygonize or Buffer in QGIS), or name \
                    another file";
        return Err(Error::format(path, "layers", what));
    }
    Ok(areas)
}

/// The reference system that a layer names. GeoPackages without one name an undefined one; what belongs to a building
/// site has no place on the Earth: both are none, as a Shapefile without `.prj` has none.
fn crs_of_layer(path: &Path, layer: &gdal::vector::Layer<'_>) -> Result<Option<Crs>> {
    let Some(reference) = layer.spatial_ref() else { return Ok(None) };
    let undefined = reference.name().is_some_and(|name| name.to_ascii_lowercase().starts_with("undefined"));
    if undefined || reference.is_local() {
        return Ok(None);
    }
    let Ok(wkt) = reference.to_wkt() else { return Ok(None) };
    Crs::parse(&wkt).map(Some).map_err(|e| match e {
        Error::Usage { what, .. } => Error::usage(
            format!("{}: layer {}: {what}", path.display(), layer.name()),
            format!("name another: ogr2ogr -a_srs CRS NEW {}", path.display()),
        ),
        other => other,
    })
}

/// The polygons of a geometry, each with its holes; a closed line is one too, an open one is none.
fn collect_polygons(geometry: &gdal::vector::Geometry, polygons: &mut Vec<Vec<Ring>>) {
    let ring = |line: &gdal::vector::Geometry| -> Option<Ring> {
        let mut points = Vec::new();
        line.get_points(&mut points);
        (points.len() >= 3).then(|| points.iter().map(|p| (p.0, p.1)).collect())
    };
    if geometry.is_empty() {
        return;
    }
    let parts = || (0..geometry.geometry_count()).map(|index| geometry.get_geometry(index));
    let is_area = matches!(geometry.geometry_name().as_str(), "POLYGON" | "CURVEPOLYGON" | "TRIANGLE");
    if is_area {
        let own: Vec<Ring> = parts().filter_map(|part| ring(&part)).collect();
        polygons.extend((!own.is_empty()).then_some(own));
    } else if geometry.geometry_count() == 0 {
        polygons.extend(ring(geometry).filter(|ring| ring.first() == ring.last()).map(|ring| vec![ring]));
    } else {
        parts().for_each(|part| collect_polygons(&part, polygons));
    }
}

/// `dem align`, from files.
pub struct AlignJob<'a> {
    pub a: &'a Path,
    pub b: &'a Path,
    pub method: Method,
    pub surface: Degree,
    pub stable: Option<&'a Path>,
    pub resources: Resources,
    /// A folder for decoded copies of large models while the job runs, as [`Room`] says.
    pub scratch: Option<&'a Path>,
}

/// What was found, and with which models.
pub struct AlignedFiles {
    pub couple: Couple,
    pub outcome: Outcome,
    /// Stable areas that lie beside the models.
    pub notes: Vec<String>,
    means: Means,
}

impl AlignJob<'_> {
    /// # Errors
    /// When a file cannot be read or the two do not go together.
    pub fn run(&self) -> Result<AlignedFiles> {
        self.resources.check()?;
        let couple = open_couple(self.a, self.b)?;
        let named = |e: Error| match e {
            Error::Usage { what, remedy } => {
                Error::usage(format!("{} and {}: {what}", self.a.display(), self.b.display()), remedy)
            }
            other => other,
        };
        let bounds = couple.b.grid().bounds();
        let stable = self.stable.map(|path| read_zones(path, couple.b.wkt(), bounds)).transpose()?;
        let notes = stable.iter().flat_map(|zones| turns::note_of_outside(&zones.outside(bounds))).collect();
        let means = self.resources.means(&[&couple.a, &couple.b]);
        let options = align::Options {
            method: self.method,
            surface: self.surface,
            stable: stable.as_ref(),
            unit: couple.b.ground_unit(),
            means,
            memory_cells: self.resources.memory_cells(),
            room: Room { held_cells: self.resources.held_cells(), scratch: self.scratch },
        };
        let mut outcome = align::align(&couple.a, &couple.b, &options).map_err(named)?;
        if let (align::Outcome::Aligned(found), true) = (&mut outcome, couple.projected && self.method.moves()) {
            let grid = couple.b.grid();
            let (mx, my) = couple.b.ground_unit().metres_per_unit(grid.centre().1);
            for (axis, cell_m) in [(0, mx * grid.step_x), (1, my * grid.step_y)] {
                found.covariance_m2[(axis, axis)] += (PROJECTED_PX * cell_m).powi(2);
            }
        }
        Ok(AlignedFiles { couple, outcome, notes, means })
    }
}

/// Interpolating A into B's CRS draws a shift by so much of a cell, whatever the residuals say (measured on drawn
/// landscapes: 0.0009).
const PROJECTED_PX: f64 = 0.001;

impl AlignedFiles {
    /// Writes A with its new place and heights; the cells are A's own, unless A had to be brought into another CRS.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, alignment: &Alignment, out: &Path) -> Result<()> {
        let a = &self.couple.a;
        let old = a.grid();
        let grid = Grid { x0: old.x0 + alignment.shift.0, y0: old.y0 + alignment.shift.1, ..old };
        let nodata = a.nodata().filter(|v| v.is_finite()).unwrap_or(-9999.0);
        // Heights above B's datum belong under B's name for it.
        let lifted = self.couple.heights.lifted();
        let wkt = if a.wkt().is_empty() || lifted { self.couple.b.wkt() } else { a.wkt() };
        // A that was brought into another CRS is in B's, whose unit of height is said there.
        let of_unit = if lifted || self.couple.projected { &self.couple.b } else { a };
        let (metres_per_value, unit) = (of_unit.metres_per_value(), of_unit.unit_name());
        let form = Form { grid, wkt, bands: 1, nodata: Some(nodata), predictor: 3, threads: self.means.threads };
        let stored = |metres: f64| if metres.is_nan() { nodata } else { metres / metres_per_value };
        crate::atomic::with_temporary(out, |path| {
            if a.kind() == GdalDataType::Float64 {
                self.copy::<f64>(path, (&form, unit), alignment, stored)
            } else {
                self.copy::<f32>(path, (&form, unit), alignment, |metres| stored(metres) as f32)
            }
        })
    }

    fn copy<T: gdal::raster::GdalType + Copy + Send>(
        &self,
        path: &Path,
        (form, name_of_unit): (&Form<'_>, Option<&str>),
        alignment: &Alignment,
        stored: impl Fn(f64) -> T + Sync,
    ) -> Result<()> {
        let (a, grid, unit) = (&self.couple.a, form.grid, self.couple.b.ground_unit());
        let dataset = output::create::<T>(path, form)?;
        if let Some(name) = name_of_unit {
            autoref_raster::set_height_unit(path, &dataset, name)?;
        }
        output::produce(
            &grid,
            Cut::of_one_band(1024),
            self.means.threads,
            Vec::new,
            |heights: &mut Vec<f64>, window| {
                a.read(window.into(), heights)?;
                let mut values = Vec::with_capacity(heights.len());
                for (row, line) in (window.y..).zip(heights.chunks_exact(window.width as usize)) {
                    if alignment.tilt.is_none() {
                        values.extend(line.iter().map(|z| stored(z + alignment.shift_m[2])));
                        continue;
                    }
                    let y = grid.y0 + (row as f64 + 0.5) * grid.step_y;
                    values.extend((window.x..).zip(line).map(|(column, z)| {
                        let x = grid.x0 + (column as f64 + 0.5) * grid.step_x;
                        stored(z + alignment.height_at(x, y, &unit))
                    }));
                }
                Ok(values)
            },
            |window, values| output::put(path, &dataset, window, values),
        )?;
        output::finish(path, dataset)
    }
}
