//! A source of a mosaic: what is known of it, and where it lies.

use std::path::{Path, PathBuf};

use gdal::raster::{ColorInterpretation, GdalDataType};
use gdal::{Dataset, Metadata};

use crate::coords::GeoTransform;
use crate::error::{Error, Result};
use crate::grid::{Grid, GroundUnit};
use crate::model::open_dataset;
use crate::window::Window;
use autoref_raster::masked;

use super::form::{self, BandForm};

/// One raster.
pub struct Source {
    pub path: PathBuf,
    /// North up, however the file's rows run.
    pub grid: Grid,
    /// The file's first row is the southernmost.
    from_south: bool,
    pub bands: usize,
    pub kind: GdalDataType,
    /// What each band says of its values.
    pub forms: Vec<BandForm>,
    /// An alpha band or a mask says which cells are there.
    pub masked: bool,
    /// Its coordinates are said to be those of cells' centres; GDAL counts from corners all the same.
    pub is_point: bool,
    /// Red, green, blue and alpha of the numbers of a palette.
    pub palette: Vec<[i16; 4]>,
    pub wkt: String,
    /// Of its map coordinates.
    unit: GroundUnit,
    /// Its cells are cells of the mosaic.
    pub on_grid: bool,
    /// Sorts by time.
    pub date: String,
    pub dated_by: DatedBy,
    /// What its cells cost.
    pub companion: Option<Box<Source>>,
    /// The same a whole turn away, where the mosaic runs around the Earth and this lies over its end.
    pub again: Vec<Source>,
}

/// What says a source's date.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DatedBy {
    Metadata,
    Name,
    /// When the file was written.
    File,
}

/// Cells that lie this near to cells of the mosaic are taken to be them, in cells.
pub(super) const SNAP_PX: f64 = 0.01;

impl Source {
    pub(super) fn open(path: &Path) -> Result<Source> {
        if path.is_dir() {
            return Err(Error::format(path, "path", "is a directory; name the rasters in it"));
        }
        let dataset = open_dataset(path)?;
        if dataset.raster_count() == 0 {
            return Err(Error::unsupported(path, "it holds no raster", "leave it out"));
        }
        let transform = dataset.geo_transform().map_err(|_| match dataset.gcps() {
            [] => Error::unsupported(path, "a raster without a georeference", "give it one with gdal_edit.py"),
            _ => Error::unsupported(path, "a raster that GCPs place, on no grid", "bring it onto one with gdalwarp"),
        })?;
        let (width, height) = dataset.raster_size();
        let grid = Grid::new(&GeoTransform(transform), width as u64, height as u64).filter(|g| g.step_x > 0.0);
        let from_south = grid.is_some_and(|g| g.step_y > 0.0);
        let grid = grid.map(|g| if from_south { turned_over(&g) } else { g }).ok_or_else(|| {
            Error::unsupported(path, "a rotated or mirrored geotransform", "bring it north up with gdalwarp")
        })?;
        let band = dataset.rasterband(1).map_err(|e| Error::gdal(path, e))?;
        autoref_raster::refuse_signed_bytes(path, &band)?;
        let (date, dated_by) = date_of(path, &dataset);
        Ok(Source {
            forms: form::of_bands(path, &dataset)?,
            masked: masked::has_mask(path, &band)?,
            is_point: dataset.metadata_item("AREA_OR_POINT", "").as_deref() == Some("Point"),
            palette: form::palette_of(&band),
            path: path.to_path_buf(),
            grid,
            from_south,
            bands: dataset.raster_count(),
            kind: band.band_type(),
            unit: unit_of(&dataset),
            wkt: dataset.projection(),
            on_grid: true,
            date,
            dated_by,
            companion: None,
            again: Vec::new(),
        })
    }

    /// Whether the bands are colours of one picture: red, green and blue in 8 or 16 bits.
    pub fn is_picture(&self) -> bool {
        use ColorInterpretation::{BlueBand, GreenBand, RedBand};
        let wanted = [RedBand, GreenBand, BlueBand];
        let small = matches!(self.kind, GdalDataType::UInt8 | GdalDataType::UInt16);
        small && self.bands >= 3 && self.forms.iter().zip(wanted).all(|(form, wanted)| form.colour == wanted)
    }

    /// The bands that say whether a cell holds anything: all colours of a picture, else the first.
    pub fn deciding_bands(&self) -> Vec<usize> {
        let end = if self.is_picture() { self.bands } else { 1 };
        (0..end).filter(|band| !self.forms[*band].is_alpha()).collect()
    }

    /// Whether a window of the mosaic has a cell of this source.
    pub fn meets(&self, mosaic: &Grid, window: Window) -> bool {
        let [west, south, east, north] = self.grid.bounds();
        let left = mosaic.x0 + window.x as f64 * mosaic.step_x;
        let top = mosaic.y0 + window.y as f64 * mosaic.step_y;
        let right = left + window.width as f64 * mosaic.step_x;
        let bottom = top + window.height as f64 * mosaic.step_y;
        let here = west < right && east > left && south < top && north > bottom;
        here || self.again.iter().any(|again| again.meets(mosaic, window))
    }

    /// The cells that a window of the mosaic needs, with neighbours.
    pub(super) fn part(&self, mosaic: &Grid, window: Window) -> Option<Window> {
        let along = |first: u64, count: u64, from: (f64, f64), own: (f64, f64), size: u64| {
            // Cells that meet cells need no others, whose blocks would be decoded for nothing.
            let neighbours = if self.on_grid { -SNAP_PX } else { 2.0 * (from.1 / own.1).max(1.0) + 1.0 };
            let a = (from.0 + first as f64 * from.1 - own.0) / own.1 - neighbours;
            let b = (from.0 + (first + count) as f64 * from.1 - own.0) / own.1 + neighbours;
            let low = a.floor().clamp(0.0, size as f64) as u64;
            let high = b.ceil().clamp(0.0, size as f64) as u64;
            (high > low).then_some((low, high - low))
        };
        let g = &self.grid;
        let (x, width) = along(window.x, window.width, (mosaic.x0, mosaic.step_x), (g.x0, g.step_x), g.width)?;
        let (y, height) = along(window.y, window.height, (mosaic.y0, mosaic.step_y), (g.y0, g.step_y), g.height)?;
        Some(Window::new(x, y, width, height))
    }

    /// Where a window of the grid lies in the file.
    pub(super) fn in_file(&self, part: Window) -> Window {
        let y = if self.from_south { self.grid.height - part.bottom() } else { part.y };
        Window { y, ..part }
    }

    /// Brings the rows of a window from the file's order into the grid's.
    pub(super) fn order_rows(&self, values: &mut [f64], width: usize) {
        let height = values.len() / width.max(1);
        for row in (0..height / 2).filter(|_| self.from_south) {
            let (above, below) = values.split_at_mut((height - 1 - row) * width);
            above[row * width..][..width].swap_with_slice(&mut below[..width]);
        }
    }

    /// Of each cell's centre, with the length of a unit of x there, in units of y.
    fn each(&self, mosaic: &Grid, window: Window, mut see: impl FnMut(f64, f64, f64) -> f64) -> Vec<f64> {
        let mut out = Vec::with_capacity(window.area() as usize);
        for row in window.y..window.bottom() {
            let y = mosaic.y0 + (row as f64 + 0.5) * mosaic.step_y;
            let ratio = match self.unit {
                GroundUnit::Projected { .. } | GroundUnit::Stretched(_) => 1.0,
                GroundUnit::Geographic { .. } => {
                    let (across, along) = self.unit.metres_per_unit(y);
                    across / along
                }
            };
            for column in window.x..window.right() {
                out.push(see(mosaic.x0 + (column as f64 + 0.5) * mosaic.step_x, y, ratio));
            }
        }
        out
    }

    /// From the source's centre, in units of y.
    pub fn distances(&self, mosaic: &Grid, window: Window) -> Vec<f64> {
        let (x0, y0) = self.grid.centre();
        let mut all = self.each(mosaic, window, |x, y, ratio| (ratio * (x - x0)).hypot(y - y0));
        for again in &self.again {
            let other = again.distances(mosaic, window);
            all.iter_mut().zip(other).for_each(|(distance, other)| *distance = distance.min(other));
        }
        all
    }

    /// From the nearest edge of the source's grid, in units of y; negative beyond it.
    pub fn edge_distances(&self, mosaic: &Grid, window: Window) -> Vec<f64> {
        let [west, south, east, north] = self.grid.bounds();
        let mut all =
            self.each(mosaic, window, |x, y, ratio| (ratio * (x - west).min(east - x)).min(y - south).min(north - y));
        for again in &self.again {
            let other = again.edge_distances(mosaic, window);
            all.iter_mut().zip(other).for_each(|(distance, other)| *distance = distance.max(other));
        }
        all
    }

    /// Brings the grid to the mosaic's where it is nearly there.
    pub(super) fn snap(&mut self, mosaic: &Grid) {
        let (x, y) = ((self.grid.x0 - mosaic.x0) / mosaic.step_x, (self.grid.y0 - mosaic.y0) / mosaic.step_y);
        let same = |a: f64, b: f64, cells: u64| (a / b - 1.0).abs() * (cells as f64) < SNAP_PX;
        let near = |v: f64| (v - v.round()).abs() < SNAP_PX;
        self.on_grid = near(x)
            && near(y)
            && same(self.grid.step_x, mosaic.step_x, self.grid.width)
            && same(self.grid.step_y, mosaic.step_y, self.grid.height);
        if self.on_grid {
            self.grid.x0 = mosaic.x0 + x.round() * mosaic.step_x;
            self.grid.y0 = mosaic.y0 + y.round() * mosaic.step_y;
            (self.grid.step_x, self.grid.step_y) = (mosaic.step_x, mosaic.step_y);
        }
    }
}

/// The same cells, the rows counted from the other side.
fn turned_over(grid: &Grid) -> Grid {
    Grid { y0: grid.y0 + grid.step_y * grid.height as f64, step_y: -grid.step_y, ..*grid }
}

/// Degrees where the CRS counts in them; of others the length of the unit plays no part.
fn unit_of(dataset: &Dataset) -> GroundUnit {
    let geographic = dataset.spatial_ref().is_ok_and(|reference| reference.is_geographic());
    if geographic { GroundUnit::WGS84 } else { GroundUnit::METRES }
}

/// A date that sorts: of the metadata, else eight digits of the name, else the file's own.
fn date_of(path: &Path, dataset: &Dataset) -> (String, DatedBy) {
    const DAY: std::time::Duration = std::time::Duration::from_secs(86_400);
    let day = |time: std::time::SystemTime| {
        let ((year, month, day), _) = autoref_raster::dates::civil(time);
        format!("{year:04}{month:02}{day:02}")
    };
    // It is tomorrow already where the sun rises first.
    let latest = day(std::time::SystemTime::now() + DAY);
    let digits = |text: &str| text.chars().filter(char::is_ascii_digit).collect::<String>();
    let plausible = |run: &str| {
        let number = |range: std::ops::Range<usize>| run[range].parse::<u32>().unwrap_or(0);
        (1850..2200).contains(&number(0..4)) && (1..=12).contains(&number(4..6)) && (1..=31).contains(&number(6..8))
    };
    for (key, domain) in [("TIFFTAG_DATETIME", ""), ("ACQUISITIONDATETIME", "IMAGERY"), ("ACQUISITION_DATE", "")] {
        if let Some(value) = dataset.metadata_item(key, domain) {
            let value = digits(&value);
            // A camera whose clock was never set writes zeros.
            if value.len() >= 8 && plausible(&value) {
                return (value, DatedBy::Metadata);
            }
        }
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let mut runs = name.split(|c: char| !c.is_ascii_digit());
    // What lies ahead is a number of another kind.
    if let Some(run) = runs.rfind(|run| run.len() == 8 && plausible(run) && *run <= latest.as_str()) {
        return (run.to_string(), DatedBy::Name);
    }
    let modified = std::fs::metadata(path).and_then(|m| m.modified()).ok();
    (day(modified.unwrap_or(std::time::UNIX_EPOCH)), DatedBy::File)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A camera whose clock was never set writes zeros.
    #[test]
    fn a_date_that_is_none_leaves_the_word_to_the_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("north_20230514.tif");
        let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
        for (said, date) in [("0000:00:00 00:00:00", "20230514"), ("2021:07:03 10:00:00", "20210703100000")] {
            let mut made = driver.create_with_band_type::<u8, _>(&path, 2, 2, 1).expect("made");
            made.set_metadata_item("TIFFTAG_DATETIME", said, "").expect("set");
            made.close().expect("written");
            assert_eq!(date_of(&path, &Dataset::open(&path).expect("opens")).0, date);
        }
        for (name, by) in [
            ("x_20230514.tif", DatedBy::Name),
            ("x_21511230.tif", DatedBy::File),
            ("x_18491231.tif", DatedBy::File),
            ("x_18500101.tif", DatedBy::Name),
        ] {
            let path = folder.path().join(name);
            driver.create_with_band_type::<u8, _>(&path, 2, 2, 1).and_then(Dataset::close).expect("written");
            assert_eq!(date_of(&path, &Dataset::open(&path).expect("opens")).1, by, "{name}");
        }
    }
}
