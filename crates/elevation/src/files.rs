//! From files to files: `dem align`.

use std::path::Path;

use gdal::raster::GdalDataType;
use gdal::spatial_ref::SpatialRef;
use gdal::vector::LayerAccess;
use gdal::{Dataset, DatasetOptions, GdalOpenFlags};

use crate::align::{self, Alignment, Method, Outcome};
use crate::error::{Error, Result};
use crate::grid::Grid;
use crate::model::Model;
use crate::output::{self, Form};
use crate::source::{Heights, Patch};
use crate::stream::Means;
use crate::zones::{Ring, Zones};

/// The smallest `--memory` that is accepted.
pub const SMALLEST_BUDGET_BYTES: u64 = 112 << 20;

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

    /// Cells of two models together that are held whole, four bytes each: a fifth of the budget.
    pub fn held_cells(&self) -> u64 {
        self.memory_budget_bytes / 5 / 4
    }
}

/// Both models, brought to one CRS.
pub struct Couple {
    pub a: Model,
    pub b: Model,
    /// A is seen through a projection: its cells are resampled.
    pub projected: bool,
    _warped: Option<tempfile::TempPath>,
}

/// Opens two models and brings A into B's CRS where they differ.
///
/// # Errors
/// When one cannot be opened, their units or vertical datums do not go together, or PROJ has no way between them.
pub fn open_couple(a: &Path, b: &Path) -> Result<Couple> {
    let (ma, mb) = (Model::open(a)?, Model::open(b)?);
    check_units(&ma, &mb)?;
    let (va, vb) = (vertical(ma.wkt()), vertical(mb.wkt()));
    match (&va, &vb) {
        (Some(x), None) | (None, Some(x)) => {
            let (with, without) = if va.is_some() { (a, b) } else { (b, a) };
            return Err(Error::usage(
                format!("{}: missing vertical datum, while {} has {x}", without.display(), with.display()),
                "name it in the CRS (gdal_edit.py -a_srs EPSG:horizontal+vertical), or take it from the other",
            ));
        }
        _ => {}
    }
    let same = match (ma.crs(), mb.crs()) {
        (Some(x), Some(y)) => x.wkt() == y.wkt() || same_reference(ma.wkt(), mb.wkt()),
        // What names no CRS is taken to have that of the other.
        _ => true,
    };
    if same {
        return Ok(Couple { a: ma, b: mb, projected: false, _warped: None });
    }
    let (Some(from), Some(to)) = (ma.crs(), mb.crs()) else { return Err(Error::usage("no CRS", "give one")) };
    let (x, y) = ma.grid().centre();
    let mut probe = [crate::crs::Coordinate { x, y, height: Some(0.0) }];
    from.transform(&mut probe, to, crate::crs::DEFAULT_DATUM_ACCURACY_M)?;
    if va != vb {
        return Err(Error::usage(
            format!("{}: heights above {}, those of {} above {}", a.display(), text(&va), b.display(), text(&vb)),
            "bring one to the other first: gdalwarp -s_srs … -t_srs … with both vertical CRSs named",
        ));
    }
    let warped = warp(a, mb.wkt())?;
    let ma = Model::open(&warped)?;
    Ok(Couple { a: ma, b: mb, projected: true, _warped: Some(warped) })
}

fn text(vertical: &Option<String>) -> &str {
    vertical.as_deref().unwrap_or("an unnamed datum")
}

/// A virtual raster of A in another CRS.
fn warp(a: &Path, wkt: &str) -> Result<tempfile::TempPath> {
    let file = tempfile::Builder::new().prefix("autoref-elevation.").suffix(".vrt").tempfile();
    let path = file.map_err(|e| Error::io(std::env::temp_dir(), "make a temporary file in", e))?.into_temp_path();
    let source = a.canonicalize().map_err(|e| Error::io(a, "find", e))?;
    let options = ["-of", "VRT", "-t_srs", wkt, "-r", "cubic", "-overwrite", "-dstnodata", "-9999", "-ot", "Float32"];
    crate::derive::warp(&source, &path, &options)?;
    Ok(path)
}

fn same_reference(a: &str, b: &str) -> bool {
    match (SpatialRef::from_wkt(a), SpatialRef::from_wkt(b)) {
        (Ok(a), Ok(b)) => a == b,
        _ => false,
    }
}

/// The vertical datum that a CRS names: that of its vertical part, or the ellipsoid of a three-dimensional one.
pub fn vertical(wkt: &str) -> Option<String> {
    let reference = SpatialRef::from_wkt(wkt).ok()?;
    let named = reference.get_attr_value("VERT_CS|VERT_DATUM", 0).ok().flatten();
    named.or_else(|| (reference.axes_count() == 3).then(|| "the ellipsoid".to_string()))
}

fn check_units(a: &Model, b: &Model) -> Result<()> {
    let (with, without) = match (a.unit_name(), b.unit_name()) {
        (Some(_), None) if a.metres_per_value() != 1.0 => (a, b),
        (None, Some(_)) if b.metres_per_value() != 1.0 => (b, a),
        _ => return Ok(()),
    };
    Err(Error::usage(
        format!(
            "{}: heights in {}, and {} names no unit",
            with.path().display(),
            with.unit_name().unwrap_or("?"),
            without.path().display()
        ),
        "name it with gdal_edit.py -units m (or ft)",
    ))
}

/// Reads polygons of a vector file into a CRS; the name of each is its attribute `name`, `id` or the like, or its number.
///
/// # Errors
/// When the file cannot be read, or holds no polygon.
pub fn read_zones(path: &Path, wkt: &str) -> Result<Zones> {
    Ok(Zones::new(read_areas(path, wkt)?))
}

/// Polygons of any vector file with their names and rings, in the CRS of `wkt` where both it and the file name one.
///
/// # Errors
/// When the file cannot be read, holds no polygon, or cannot be transformed.
pub fn read_areas(path: &Path, wkt: &str) -> Result<Vec<(String, Vec<Ring>)>> {
    autoref_raster::bounded::refuse_endless(path)?;
    let failed = |e: gdal::errors::GdalError| Error::gdal(path, e);
    let flags = GdalOpenFlags::GDAL_OF_VECTOR | GdalOpenFlags::GDAL_OF_VERBOSE_ERROR;
    let dataset = Dataset::open_ex(path, DatasetOptions { open_flags: flags, ..Default::default() }).map_err(failed)?;
    let mut areas: Vec<(String, Vec<Ring>)> = Vec::new();
    let target = (!wkt.is_empty()).then(|| crate::crs::Crs::parse(wkt)).transpose()?;
    for mut layer in dataset.layers() {
        let own = layer.spatial_ref().and_then(|s| s.to_wkt().ok()).map(|w| crate::crs::Crs::parse(&w)).transpose()?;
        for feature in layer.features() {
            let Some(geometry) = feature.geometry() else { continue };
            let mut rings = Vec::new();
            collect_rings(geometry, &mut rings);
            if let (Some(from), Some(to)) = (&own, &target) {
                for ring in &mut rings {
                    let mut points: Vec<_> =
                        ring.iter().map(|&(x, y)| crate::crs::Coordinate { x, y, height: None }).collect();
                    from.transform(&mut points, to, crate::crs::DEFAULT_DATUM_ACCURACY_M)?;
                    *ring = points.iter().map(|p| (p.x, p.y)).collect();
                }
            }
            if rings.is_empty() {
                continue;
            }
            let named = feature.fields().find(|(key, _)| {
                ["name", "id", "glacier", "line", "zone"].contains(&key.to_ascii_lowercase().as_str())
            });
            let name = named.and_then(|(_, value)| value.and_then(|v| v.into_string()));
            areas.push((name.unwrap_or_else(|| (areas.len() + 1).to_string()), rings));
        }
    }
    if areas.is_empty() {
        return Err(Error::format(path, "layers", "no polygon in it"));
    }
    Ok(areas)
}

fn collect_rings(geometry: &gdal::vector::Geometry, rings: &mut Vec<Ring>) {
    let parts = geometry.geometry_count();
    for index in 0..parts {
        collect_rings(&geometry.get_geometry(index), rings);
    }
    if parts == 0 {
        let mut points = Vec::new();
        geometry.get_points(&mut points);
        if points.len() >= 3 {
            rings.push(points.iter().map(|p| (p.0, p.1)).collect());
        }
    }
}

/// `dem align`, from files.
pub struct AlignJob<'a> {
    pub a: &'a Path,
    pub b: &'a Path,
    pub method: Method,
    pub stable: Option<&'a Path>,
    pub resources: Resources,
}

/// What was found, and with which models.
pub struct AlignedFiles {
    pub couple: Couple,
    pub outcome: Outcome,
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
        let stable = self.stable.map(|path| read_zones(path, couple.b.wkt())).transpose()?;
        let means = self.resources.means(&[&couple.a, &couple.b]);
        let options = align::Options {
            method: self.method,
            stable: stable.as_ref(),
            unit: couple.b.ground_unit(),
            means,
            memory_cells: self.resources.memory_cells(),
            held_cells: self.resources.held_cells(),
        };
        let outcome = align::align(&couple.a, &couple.b, &options).map_err(named)?;
        Ok(AlignedFiles { couple, outcome, means })
    }
}

impl AlignedFiles {
    /// Writes A with its new place and heights; the cells are A's own, unless A had to be brought into another CRS.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&self, alignment: &Alignment, out: &Path) -> Result<()> {
        let (a, unit) = (&self.couple.a, self.couple.b.ground_unit());
        let old = a.grid();
        let grid = Grid { x0: old.x0 + alignment.shift.0, y0: old.y0 + alignment.shift.1, ..old };
        let nodata = a.nodata().filter(|v| v.is_finite()).unwrap_or(-9999.0);
        let wkt = if a.wkt().is_empty() { self.couple.b.wkt() } else { a.wkt() };
        let form = Form { grid, wkt, bands: 1, nodata: Some(nodata), predictor: 3, threads: self.means.threads };
        crate::atomic::with_temporary(out, |path| {
            if a.kind() == GdalDataType::Float64 {
                self.copy::<f64>(path, &form, alignment, nodata, |v| v, unit)
            } else {
                self.copy::<f32>(path, &form, alignment, nodata, |v| v as f32, unit)
            }
        })
    }

    fn copy<T: gdal::raster::GdalType + Copy + Send>(
        &self,
        path: &Path,
        form: &Form<'_>,
        alignment: &Alignment,
        nodata: f64,
        cast: impl Fn(f64) -> T + Sync,
        unit: crate::grid::GroundUnit,
    ) -> Result<()> {
        let (a, grid) = (&self.couple.a, form.grid);
        let dataset = output::create::<T>(path, form)?;
        output::produce(
            &grid,
            1024,
            self.means.threads,
            Vec::new,
            |heights: &mut Vec<f64>, window| {
                let (width, height) = (window.width as usize, window.height as usize);
                a.read(Patch { x: window.x as i64, y: window.y as i64, width, height }, heights)?;
                let values = heights.iter().enumerate().map(|(i, z)| {
                    let x = grid.x0 + ((window.x + (i % width) as u64) as f64 + 0.5) * grid.step_x;
                    let y = grid.y0 + ((window.y + (i / width) as u64) as f64 + 0.5) * grid.step_y;
                    let corrected = (z + alignment.height_at(x, y, &unit)) / a.metres_per_value();
                    cast(if corrected.is_nan() { nodata } else { corrected })
                });
                Ok(values.collect::<Vec<T>>())
            },
            |window, values| output::put(path, &dataset, window, &values),
        )?;
        output::finish(path, dataset)
    }
}
