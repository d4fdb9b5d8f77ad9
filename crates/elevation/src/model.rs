//! Elevation models in files: band 1 of whatever GDAL opens, as heights in metres.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use gdal::raster::GdalDataType;
use gdal::{Dataset, DatasetOptions, GdalOpenFlags, Metadata};

use crate::coords::GeoTransform;
use crate::crs::Crs;
use crate::error::{Error, Result};
use crate::grid::{Grid, GroundUnit, Stretch};
use crate::lift::Lift;
use crate::source::{Heights, Patch};
use crate::warp::warp_dataset;
use autoref_raster::markup::escaped;
use autoref_raster::tiff::FloatTiff;
use autoref_raster::{HeightBand, masked, metres_per_value};

/// Heights of a file. Several threads read at once, each with a dataset of its own.
pub struct Model {
    path: PathBuf,
    grid: Grid,
    crs: Option<Crs>,
    /// Worked out when it is asked for.
    ground_unit: OnceLock<GroundUnit>,
    wkt: String,
    kind: GdalDataType,
    block: (usize, usize),
    /// What the stored values mean.
    band: HeightBand,
    /// From the file's vertical datum to the one that is asked for.
    lift: Option<Lift>,
    pool: Mutex<Vec<Dataset>>,
    /// The cells without GDAL, where that is possible.
    floats: Option<FloatTiff>,
}

impl Model {
    /// Opens band 1 of `path`.
    ///
    /// # Errors
    /// When GDAL cannot open it, it has no georeference, or a rotated one.
    pub fn open(path: &Path) -> Result<Model> {
        autoref_raster::initialise_gdal(32 << 20);
        if path.is_dir() {
            return Err(Error::format(path, "path", "is a directory, not an elevation model"));
        }
        let dataset = open_dataset(path)?;
        if dataset.raster_count() == 0 {
            return Err(Error::unsupported(path, "it holds no raster", "give an elevation raster"));
        }
        let (width, height) = dataset.raster_size();
        let Ok(transform) = dataset.geo_transform() else {
            return Err(Error::unsupported(
                path,
                "an elevation model without a georeference",
                "give it one with gdal_edit.py -a_ullr and -a_srs",
            ));
        };
        let Some(grid) = Grid::new(&GeoTransform(transform), width as u64, height as u64) else {
            return Err(Error::unsupported(
                path,
                "a rotated or singular geotransform",
                "resample it to north up with gdalwarp",
            ));
        };
        let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
        let wkt = dataset.projection();
        let crs = if wkt.is_empty() { None } else { Some(Crs::parse(&wkt)?) };
        let [_, south, _, north] = grid.bounds();
        // Grids that are registered on the poles reach half a cell beyond.
        let reach = 90.0 + grid.step_y.abs();
        if let Some(crs) = crs.as_ref().filter(|crs| crs.is_geographic() && !crs.counts_degrees()) {
            return Err(Error::unsupported(
                path,
                format!("longitudes and latitudes in {}", crs.unit_name()),
                "bring it to a CRS in degrees or metres with gdalwarp",
            ));
        }
        let degrees = crs.as_ref().is_some_and(Crs::counts_degrees);
        if degrees && !(south >= -reach && north <= reach) {
            let what = format!("latitudes from {south} to {north} degrees");
            return Err(Error::unsupported(path, what, how_to_name_crs(path)));
        }
        let (kind, block) = (band.band_type(), band.block_size());
        let band = HeightBand::of(path, &band, crs.as_ref())?;
        let is_plain = kind == GdalDataType::Float32 && dataset.driver().short_name() == "GTiff" && path.is_file();
        let floats = is_plain.then(|| FloatTiff::open(path)).flatten();
        let floats = floats.filter(|floats| floats.size() == (grid.width, grid.height));
        let pool = Mutex::new(vec![dataset]);
        let path = path.to_path_buf();
        Ok(Model { path, grid, crs, ground_unit: OnceLock::new(), wkt, kind, block, band, lift: None, pool, floats })
    }

    /// The same cells in the unit of height of another model.
    pub fn in_unit_of(self, other: &Model) -> Model {
        let (metres_per_value, unit_name) = (other.band.metres_per_value, other.band.unit_name.clone());
        Model { band: HeightBand { metres_per_value, unit_name, ..self.band }, ..self }
    }

    /// The same cells so much farther east, in units of the map.
    pub fn moved_east(self, by: f64) -> Model {
        Model { grid: Grid { x0: self.grid.x0 + by, ..self.grid }, ground_unit: OnceLock::new(), ..self }
    }

    /// The same heights above another vertical datum.
    pub fn lifted(self, lift: Lift) -> Model {
        Model { lift: Some(lift), ..self }
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `None` when the file says none.
    pub fn crs(&self) -> Option<&Crs> {
        self.crs.as_ref()
    }

    /// As the file has it; empty when it has none.
    pub fn wkt(&self) -> &str {
        &self.wkt
    }

    /// The value that stands for no height.
    pub fn nodata(&self) -> Option<f64> {
        self.band.nodata
    }

    /// How heights are stored.
    pub fn kind(&self) -> GdalDataType {
        self.kind
    }

    /// Size of the file's blocks.
    pub fn block(&self) -> (usize, usize) {
        self.block
    }

    /// A height in metres is the stored number times the first plus the second.
    pub fn metres(&self) -> (f64, f64) {
        (self.band.scale.0 * self.band.metres_per_value, self.band.scale.1 * self.band.metres_per_value)
    }

    /// Metres in a unit of the heights.
    pub fn metres_per_value(&self) -> f64 {
        self.band.metres_per_value
    }

    /// What the file calls its unit of height, when it says.
    pub fn unit_name(&self) -> Option<&str> {
        self.band.unit_name.as_deref()
    }

    /// Words for heights that are taken for metres though the map counts in something else; the model goes by `name`.
    pub fn doubtful_unit(&self, name: &str) -> Option<String> {
        let crs = self.crs().filter(|crs| !crs.is_geographic() && crs.metres_per_unit() != 1.0)?;
        self.unit_name().is_none().then(|| {
            format!(
                "{name} names no unit of its heights, and its map counts in {}: they are taken for metres; name their \
                 unit with gdal_edit.py -units (ft where they are feet)",
                crs.unit_name()
            )
        })
    }

    /// What a unit of the horizontal axes is on the ground. Without a CRS a unit is a metre.
    pub fn ground_unit(&self) -> GroundUnit {
        *self.ground_unit.get_or_init(|| match &self.crs {
            Some(crs) if crs.is_geographic() => GroundUnit::WGS84,
            Some(crs) => Stretch::of(&self.grid, crs)
                .map_or(GroundUnit::Projected { metres_per_unit: crs.metres_per_unit() }, GroundUnit::Stretched),
            None => GroundUnit::METRES,
        })
    }

    /// Runs `job` with a dataset that no other thread has.
    ///
    /// # Errors
    /// Those of `job`, and when another dataset cannot be opened.
    pub fn with_dataset<R>(&self, job: impl FnOnce(&Dataset) -> Result<R>) -> Result<R> {
        let idle = self.pool.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let dataset = match idle {
            Some(dataset) => dataset,
            None => open_dataset(&self.path)?,
        };
        let result = job(&dataset);
        self.pool.lock().unwrap_or_else(PoisonError::into_inner).push(dataset);
        result
    }

    /// Stored values of a window that lies in the raster, as `T`: without unit, without change of datum.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn read_stored<T: Copy + gdal::raster::GdalType>(
        &self,
        (x, y): (u64, u64),
        (width, height): (usize, usize),
        out: &mut [T],
    ) -> Result<()> {
        self.with_dataset(|dataset| {
            let band = dataset.rasterband(1).map_err(|e| Error::gdal(&self.path, e))?;
            band.read_into_slice((x as isize, y as isize), (width, height), (width, height), out, None)
                .map_err(|e| Error::gdal(&self.path, format!("rows {y}..{}: {e}", y + height as u64)))
        })
    }

    /// Whether a stored value stands for "no height".
    pub fn is_void(&self, value: f64) -> bool {
        self.band.is_void(value)
    }

    /// Stored values of a window that lies in the raster, NaN where an alpha band or a mask leaves a cell out.
    fn read_there(&self, at: (u64, u64), size: (usize, usize), out: &mut [f64]) -> Result<()> {
        // Where a file holds no block, GDAL has its nodata value. What is broken GDAL tells, or reads all the same.
        let empty = f64::from(self.band.nodata.unwrap_or(0.0) as f32);
        let read = self.floats.as_ref().is_some_and(|floats| floats.read(at, size, empty, out).is_ok());
        if !read {
            self.read_stored(at, size, out)?;
        }
        if !self.band.masked {
            return Ok(());
        }
        self.with_dataset(|dataset| {
            let band = dataset.rasterband(1).map_err(|e| Error::gdal(&self.path, e))?;
            masked::leave_out(&self.path, &band, (at.0 as isize, at.1 as isize), size, out)
        })
    }
}

impl Heights for Model {
    fn grid(&self) -> Grid {
        self.grid
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        let (width, height) = (self.grid.width as i64, self.grid.height as i64);
        out.clear();
        let left = patch.x.clamp(0, width);
        let right = (patch.x + patch.width as i64).clamp(left, width);
        let top = patch.y.clamp(0, height);
        let bottom = (patch.y + patch.height as i64).clamp(top, height);
        let (columns, rows) = ((right - left) as usize, (bottom - top) as usize);
        out.resize(patch.width * patch.height, f64::NAN);
        if columns == 0 || rows == 0 {
            return Ok(());
        }
        if columns == patch.width && rows == patch.height {
            self.read_there((left as u64, top as u64), (columns, rows), out)?;
        } else {
            let mut inside = vec![0.0; columns * rows];
            self.read_there((left as u64, top as u64), (columns, rows), &mut inside)?;
            for (row, line) in inside.chunks_exact(columns).enumerate() {
                let from = ((top - patch.y) as usize + row) * patch.width + (left - patch.x) as usize;
                out[from..from + columns].copy_from_slice(line);
            }
        }
        self.band.to_metres(out);
        if let Some(lift) = &self.lift {
            for (row, line) in (patch.y..).zip(out.chunks_exact_mut(patch.width)) {
                for (column, value) in (patch.x..).zip(line) {
                    *value += lift.at(column as f64 + 0.5, row as f64 + 0.5);
                }
            }
        }
        Ok(())
    }

    fn holds_nothing(&self, patch: Patch) -> bool {
        let (width, height) = (self.grid.width as i64, self.grid.height as i64);
        let [left, right] = [patch.x, patch.x + patch.width as i64].map(|x| x.clamp(0, width));
        let [top, bottom] = [patch.y, patch.y + patch.height as i64].map(|y| y.clamp(0, height));
        if left == right || top == bottom {
            return true;
        }
        let there = ((left as u64, top as u64), ((right - left) as usize, (bottom - top) as usize));
        let void = self.band.nodata.is_some_and(|nodata| self.is_void(f64::from(nodata as f32)));
        void && self.floats.as_ref().is_some_and(|floats| floats.is_sparse(there.0, there.1))
    }
}

/// How a raster gets the CRS that it lacks: an ASCII grid by a file beside it, for GDAL does not write into it.
pub fn how_to_name_crs(path: &Path) -> String {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    if ["asc", "grd", "txt", "agr"].contains(&extension.as_str()) {
        format!("name it: gdalsrsinfo -o wkt_esri CRS > {}", path.with_extension("prj").display())
    } else {
        format!("name it: gdal_edit.py -a_srs CRS {}", path.display())
    }
}

/// Opens a raster for reading; GDAL's reason in one line.
///
/// # Errors
/// When GDAL cannot open it.
pub fn open_dataset(path: &Path) -> Result<Dataset> {
    open_named(path, path)
}

/// Cells that are read at a time, about.
const CELLS_AT_A_TIME: usize = 1 << 20;

/// What a raster's first band stores, in pieces of whole blocks, until `see` has seen enough.
pub(crate) fn look_through(
    path: &Path,
    dataset: &Dataset,
    mut see: impl FnMut(&[f64]) -> ControlFlow<()>,
) -> Result<()> {
    let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
    let ((width, height), (across, down)) = (band.size(), band.block_size());
    let (across, down) = (across.clamp(1, width.max(1)), down.clamp(1, height.max(1)));
    // A block that lies in two pieces would be decoded twice.
    let blocks = (CELLS_AT_A_TIME / (across * down)).max(1);
    let side = blocks.min(width.div_ceil(across));
    let (piece_width, piece_height) = (side * across, (blocks / side).max(1) * down);
    for y in (0..height).step_by(piece_height) {
        for x in (0..width).step_by(piece_width) {
            let size = (piece_width.min(width - x), piece_height.min(height - y));
            let at = (x as isize, y as isize);
            let stored = band.read_as::<f64>(at, size, size, None).map_err(|e| Error::gdal(path, e))?;
            if see(stored.data()).is_break() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Opens a model for GDAL's own functions, which know nothing of a band's scale and offset, and compute with what is no
/// height but by a file's nodata value: through a virtual raster that applies the former and leaves out the latter.
///
/// # Errors
/// As [`open_dataset`].
pub fn open_heights(path: &Path) -> Result<Dataset> {
    open_times(path, 1.0)
}

/// As [`open_heights`], with heights in metres whatever their unit.
///
/// # Errors
/// As [`open_dataset`]; a unit that is none of length.
pub fn open_metres(path: &Path) -> Result<Dataset> {
    let dataset = open_dataset(path)?;
    let Ok(band) = dataset.rasterband(1) else { return Ok(dataset) };
    let crs = Crs::parse(&dataset.projection()).ok();
    open_times(path, HeightBand::of(path, &band, crs.as_ref())?.metres_per_value)
}

/// Heights of a model times a factor.
fn open_times(path: &Path, factor: f64) -> Result<Dataset> {
    /// Nothing on Earth is as high.
    const VOID: f64 = -1e30;
    let (dataset, name) = without_voids(path)?;
    let Ok(band) = dataset.rasterband(1) else { return Ok(dataset) };
    let (ratio, offset) = (factor * band.scale().unwrap_or(1.0), factor * band.offset().unwrap_or(0.0));
    if (ratio, offset) == (1.0, 0.0) {
        return Ok(dataset);
    }
    let nodata = band.no_data_value().map_or(String::new(), |v| format!("<NODATA>{}</NODATA>", number(v)));
    let source = format!("{nodata}<ScaleOffset>{offset:.17e}</ScaleOffset><ScaleRatio>{ratio:.17e}</ScaleRatio>");
    let band = virtual_band(&dataset, 1, "Float64", (VOID, ""), (&name, &source));
    open_named(Path::new(&virtual_raster(&dataset, &band)), path)
}

/// Opens a model as it is stored, for GDAL's own functions; cells without a height are those of its nodata value.
///
/// # Errors
/// As [`open_dataset`].
pub fn open_stored(path: &Path) -> Result<Dataset> {
    Ok(without_voids(path)?.0)
}

/// Values that stand for "no height" beside a declared one, at most.
const MOST_VOIDS: usize = 4;

/// A model in which the nodata value tells all cells without a height, and what GDAL calls it. One that GCPs place is
/// left as it is: they say more than a virtual raster would keep.
fn without_voids(path: &Path) -> Result<(Dataset, String)> {
    let dataset = open_dataset(path)?;
    let name = path.to_string_lossy().into_owned();
    let Ok(band) = dataset.rasterband(1) else { return Ok((dataset, name)) };
    if !dataset.gcps().is_empty() {
        return Ok((dataset, name));
    }
    let scale = (band.scale().unwrap_or(1.0), band.offset().unwrap_or(0.0));
    let (nodata, masked) = (band.no_data_value(), masked::has_mask(path, &band)?);
    let metres_per_value = metres_per_value(&band, Crs::parse(&dataset.projection()).ok().as_ref());
    let rule = HeightBand { nodata, scale, masked, metres_per_value, unit_name: None };
    let voids = undeclared_voids(path, &dataset, &rule)?;
    let kind = band.band_type();
    let (kind, nodata) = match (nodata, &voids[..]) {
        (_, []) if !masked => return Ok((dataset, name)),
        (Some(nodata), _) => (kind, nodata),
        // It is declared, and nothing else changes.
        (None, [void]) if !masked && void.is_finite() => (kind, *void),
        (None, _) if kind.is_floating() => (kind, f64::NAN),
        (None, _) if kind.bits() <= 16 => (GdalDataType::Float32, f64::NAN),
        (None, _) => (GdalDataType::Float64, f64::NAN),
    };
    let (mut dataset, mut name) =
        if masked { without_masked(path, &dataset, &kind.name(), nodata)? } else { (dataset, name) };
    // A source leaves out one value: one virtual raster over another.
    for void in voids {
        let xml = xml_without(&name, &dataset, (&kind.name(), nodata), void);
        (dataset, name) = (open_named(Path::new(&xml), path)?, xml);
    }
    Ok((dataset, name))
}

/// A warped virtual raster on the model's own grid, in which cells that its mask leaves out have the nodata value. It
/// lies in GDAL's memory until the program ends.
fn without_masked(path: &Path, dataset: &Dataset, kind: &str, nodata: f64) -> Result<(Dataset, String)> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let (width, height) = dataset.raster_size();
    let t = dataset.geo_transform().map_err(|e| Error::gdal(path, e))?;
    if t[2] != 0.0 || t[4] != 0.0 || t[1] <= 0.0 || t[5] >= 0.0 {
        let what = "a mask on a grid that is not north up";
        return Err(Error::unsupported(path, what, "bring it north up first with gdalwarp"));
    }
    let name = format!("/vsimem/autoref-heights-{}.vrt", COUNT.fetch_add(1, Ordering::Relaxed));
    let [west, south, east, north] =
        [t[0], t[3] + height as f64 * t[5], t[0] + width as f64 * t[1], t[3]].map(|v| format!("{v:.17e}"));
    let (columns, rows, nodata) = (width.to_string(), height.to_string(), number(nodata));
    let grid = ["-te", &west, &south, &east, &north, "-ts", &columns, &rows];
    let options = ["-of", "VRT", "-r", "near", "-et", "0", "-novshift", "-ot", kind, "-dstnodata", &nodata];
    warp_dataset(dataset, path, Path::new(&name), &[&options[..], &grid].concat())?;
    Ok((open_named(Path::new(&name), path)?, name))
}

/// What stands for "no height" in the cells and is not what the file declares.
///
/// # Errors
/// When there are too many such values, or the model cannot be read.
fn undeclared_voids(path: &Path, dataset: &Dataset, rule: &HeightBand) -> Result<Vec<f64>> {
    let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
    let kind = band.band_type();
    // Such numbers are all heights but the declared one.
    if rule.nodata.is_some() && !kind.is_floating() && kind.bits() <= 16 && rule.scale == (1.0, 0.0) {
        return Ok(Vec::new());
    }
    let same = |a: f64, b: f64| a == b || (a.is_nan() && b.is_nan());
    let is_declared = |v: f64| rule.nodata.is_some_and(|d| same(v, d) || same(v, f64::from(d as f32)));
    let mut voids: Vec<f64> = Vec::new();
    look_through(path, dataset, |stored| {
        for &v in stored.iter().filter(|v| rule.is_void(**v)) {
            if !is_declared(v) && !voids.iter().any(|known| same(*known, v)) {
                voids.push(v);
            }
            if voids.len() > MOST_VOIDS {
                return ControlFlow::Break(());
            }
        }
        ControlFlow::Continue(())
    })?;
    if voids.len() > MOST_VOIDS {
        let some = voids.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
        return Err(Error::unsupported(
            path,
            format!("many values that are no heights ({some}, …)"),
            "write one nodata value in their place first (gdal_calc.py)",
        ));
    }
    Ok(voids)
}

/// A virtual raster of all bands, whose first is of a kind and has a nodata value, which stands in place of `void`.
fn xml_without(name: &str, dataset: &Dataset, (kind, nodata): (&str, f64), void: f64) -> String {
    let how = format!("<NODATA>{}</NODATA>", number(void));
    let bands = (1..=dataset.raster_count()).filter_map(|index| {
        let band = dataset.rasterband(index).ok()?;
        let (offset, scale) = (band.offset().unwrap_or(0.0), band.scale().unwrap_or(1.0));
        let unit = escaped(&band.unit());
        let said = format!("<UnitType>{unit}</UnitType><Offset>{offset:.17e}</Offset><Scale>{scale:.17e}</Scale>");
        let (own_kind, own_nodata) = (band.band_type().name(), band.no_data_value().unwrap_or(nodata));
        let (kind, nodata) = if index == 1 { (kind, nodata) } else { (own_kind.as_str(), own_nodata) };
        Some(virtual_band(dataset, index, kind, (nodata, &said), (name, &how)))
    });
    virtual_raster(dataset, &bands.collect::<String>())
}

fn number(v: f64) -> String {
    if v.is_nan() { "nan".into() } else { format!("{v:.17e}") }
}

fn virtual_raster(dataset: &Dataset, within: &str) -> String {
    let (width, height) = dataset.raster_size();
    let place = dataset.geo_transform().map_or(String::new(), |t| {
        format!("<GeoTransform>{}</GeoTransform>", t.map(|v| format!("{v:.17e}")).join(","))
    });
    let reference = escaped(&dataset.projection());
    format!(
        "<VRTDataset rasterXSize=\"{width}\" rasterYSize=\"{height}\"><SRS>{reference}</SRS>{place}{within}</VRTDataset>"
    )
}

/// A band that is made of one of a stored raster: its nodata and what else is said of it, and where it comes from.
fn virtual_band(
    dataset: &Dataset,
    index: usize,
    kind: &str,
    (nodata, said): (f64, &str),
    (stored, how): (&str, &str),
) -> String {
    let (width, height) = dataset.raster_size();
    let whole = format!("xOff=\"0\" yOff=\"0\" xSize=\"{width}\" ySize=\"{height}\"");
    let (nodata, stored) = (number(nodata), escaped(stored));
    format!(
        "<VRTRasterBand dataType=\"{kind}\" band=\"{index}\"><NoDataValue>{nodata}</NoDataValue>{said}<ComplexSource>\
         <SourceFilename relativeToVRT=\"0\">{stored}</SourceFilename><SourceBand>{index}</SourceBand><SrcRect {whole}/>\
         <DstRect {whole}/>{how}</ComplexSource></VRTRasterBand>"
    )
}

/// What is decoded at once of a raster; a file of a kilobyte can name a block of gigabytes.
const LARGEST_BLOCK_BYTES: u64 = 512 << 20;

fn open_named(name: &Path, path: &Path) -> Result<Dataset> {
    let flags = GdalOpenFlags::GDAL_OF_READONLY
        | GdalOpenFlags::GDAL_OF_RASTER
        | GdalOpenFlags::GDAL_OF_INTERNAL
        | GdalOpenFlags::GDAL_OF_VERBOSE_ERROR;
    autoref_raster::jpeg_end::check(path)?;
    let options = DatasetOptions { open_flags: flags, ..Default::default() };
    let opened = autoref_raster::unheard(|| Dataset::open_ex(name, options)).map_err(|e| {
        use gdal::errors::GdalError;
        let text = match &e {
            GdalError::CplError { msg, .. } | GdalError::NullPointer { msg, .. } if !msg.is_empty() => msg.clone(),
            GdalError::NullPointer { .. } => "no driver recognises this file".into(),
            other => other.to_string(),
        };
        let name = path.display().to_string();
        let said = text.strip_prefix(&format!("{name}: ")).or(text.strip_prefix(&format!("{name}, ")));
        Error::gdal(path, said.unwrap_or(&text))
    })?;
    if let Ok(band) = opened.rasterband(1) {
        autoref_raster::refuse_signed_bytes(path, &band)?;
        let by_pixel = opened.metadata_item("INTERLEAVE", "IMAGE_STRUCTURE").is_some_and(|way| way == "PIXEL");
        let (across, down) = band.block_size();
        let bands = if by_pixel { opened.raster_count() } else { 1 };
        let needed = [across, down, bands]
            .into_iter()
            .fold(u64::from(band.band_type().bytes()), |bytes, count| bytes.saturating_mul(count as u64));
        if needed > LARGEST_BLOCK_BYTES {
            return Err(Error::Limit {
                what: format!("{}: one block of {across} x {down} cells", path.display()),
                needed,
                allowed: LARGEST_BLOCK_BYTES,
                remedy: format!("cut it anew: gdal_translate -co TILED=YES {} tiled.tif", path.display()),
            });
        }
    }
    Ok(opened)
}
