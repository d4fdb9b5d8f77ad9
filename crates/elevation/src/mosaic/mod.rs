//! Many rasters joined into one: which source wins is decided cell by cell, tile by tile.

mod alike;
mod balance;
mod blend;
mod choose;
mod companion;
mod distance;
mod form;
mod graph;
mod layout;
mod mix;
mod page;
mod read;
mod reduce;
mod rule;
mod source;
mod turn;

pub use balance::{Balance, Balancing, DifferenceMap, Overlap, Surface};
pub use blend::WIDEST_BLEND_PX;
pub use companion::companions;
pub use rule::Choice;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use gdal::raster::GdalDataType;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::files::Resources;
use crate::grid::Grid;
use crate::output::{self, Cut, Form};
use crate::resample::Interpolation;
use crate::window::Window;
use autoref_raster::cloud_optimised::{self, Overviews};
use autoref_raster::words::counted;
use form::range;
use read::Opened;
use source::Source;

/// `mosaic`.
pub struct MosaicJob<'a> {
    pub inputs: &'a [PathBuf],
    pub out: &'a Path,
    pub choice: Choice,
    pub resampling: Interpolation,
    /// Side of a cell; that of the first source when `None`.
    pub resolution: Option<f64>,
    pub write_index: Option<&'a Path>,
    pub use_index: Option<&'a Path>,
    pub balance: Option<Surface>,
    /// The source that balancing leaves as it is; one of `inputs`.
    pub balance_to: Option<&'a Path>,
    /// Cells across which neighbours run into each other at a seam; 0 for a sharp one.
    pub blend_px: u64,
    /// A page that shows the overlaps before and after balancing.
    pub page: Option<&'a Path>,
    pub resources: Resources,
}

/// What was made.
#[derive(Clone, Debug, Serialize)]
pub struct Made {
    pub sources: Vec<MadeSource>,
    pub width: u64,
    pub height: u64,
    pub geotransform: [f64; 6],
    pub bands: usize,
    pub filled_cells: u64,
    /// What was joined though sources say different things of it, and what was left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub balance: Option<Balance>,
}

/// A source, with the number that it has in the index raster.
#[derive(Clone, Debug, Serialize)]
pub struct MadeSource {
    pub number: usize,
    pub path: String,
    pub resampled: bool,
    pub cells: u64,
}

/// A tile: bands after each other, and the numbers of the sources.
struct Tile {
    values: Vec<f64>,
    index: Vec<u32>,
}

/// What a worker keeps.
struct Worker {
    opened: Opened,
    /// How many cells each source gave, and at the end how many cells hold anything.
    cells: Vec<u64>,
    /// How many cells of each source have no value in its companion.
    uncosted: Vec<u64>,
    /// The largest number that an index names.
    largest: u32,
    /// The window that is written: what is read around it is counted elsewhere.
    core: Window,
}

impl Worker {
    fn new(sources: usize) -> Self {
        let core = Window::new(0, 0, 0, 0);
        Worker { opened: Opened::default(), cells: vec![0; sources + 1], uncosted: vec![0; sources], largest: 0, core }
    }
}

/// The same of all workers.
#[derive(Default)]
struct Counts {
    cells: Vec<u64>,
    uncosted: Vec<u64>,
}

impl MosaicJob<'_> {
    /// Joins the sources.
    ///
    /// # Errors
    /// When a source cannot be read, the sources do not go together, or the output cannot be written.
    pub fn run(&self) -> Result<Made> {
        self.resources.check()?;
        self.check_rules()?;
        let (sources, grid) = layout::open_all(self.inputs, &self.choice, self.resolution)?;
        let index = self.use_index.map(|path| layout::open_index(path, &sources[0], &grid)).transpose()?;
        let one_turn = turn::note_of_one_turn(&sources, &grid);
        let mut balance = match self.balance {
            Some(surface) => {
                if let Some(what) = &one_turn {
                    return Err(Error::usage(
                        format!("--balance: {what}"),
                        "leave --balance away, or cut that source with gdal_translate -projwin so that it ends there",
                    ));
                }
                let balancing = Balancing { surface, reference: self.reference()? };
                let threads = self.threads(&sources);
                let reading =
                    balance::Reading { sources: &sources, grid: &grid, interpolation: self.resampling, threads };
                Some(balance::estimate(&reading, balancing)?)
            }
            None => None,
        };
        self.check(&sources[0])?;
        let clipped = AtomicU64::new(0);
        let whole = Whole {
            job: self,
            sources: &sources,
            grid,
            index: index.as_ref(),
            balance: balance.as_ref(),
            clipped: &clipped,
        };
        let mut files = crate::atomic::Transaction::new();
        let mut counts = Counts::default();
        let targets: Vec<PathBuf> = [self.out].into_iter().chain(self.write_index).map(Path::to_owned).collect();
        files.stage_all(&targets, |parts| {
            let (path, index) = (&parts[0], parts.get(1).map(PathBuf::as_path));
            let plain = path.with_extension("plain.tif");
            let made = whole.write_as_sources(&plain, index).and_then(|made| {
                // Where nothing is missing a mask says nothing.
                if made.cells.last() == Some(&(grid.width * grid.height)) {
                    remove_mask(&plain);
                }
                cloud_optimised::copy(&plain, path, Overviews::Cubic, self.threads(&sources))?;
                counts = made;
                Ok(())
            });
            // It is not wanted any more; when it is not there something else is the error.
            let _ = std::fs::remove_file(&plain);
            remove_mask(&plain);
            made
        })?;
        if let Some(balance) = &mut balance {
            balance.tell_clipped(clipped.into_inner(), counts.cells[sources.len()]);
        }
        if let (Some(path), Some(balance)) = (self.page, &balance) {
            let footprints: Vec<_> = sources.iter().map(|s| (s.path.as_path(), s.grid)).collect();
            files.stage_bytes(path, page::text(&footprints, &grid, balance).as_bytes())?;
        }
        files.commit()?;
        let mut notes = alike::notes(&sources);
        notes.extend(one_turn);
        notes.extend(alike::note_of_dates(&sources).filter(|_| self.choice == Choice::Newest));
        notes.extend(companion::without_companion(&sources, &grid, &counts.uncosted));
        Ok(Made {
            notes,
            sources: sources
                .iter()
                .enumerate()
                .map(|(i, s)| MadeSource {
                    number: i + 1,
                    path: s.path.display().to_string(),
                    resampled: !s.on_grid,
                    cells: counts.cells[i],
                })
                .collect(),
            width: grid.width,
            height: grid.height,
            geotransform: grid.transform().0,
            bands: sources[0].bands,
            filled_cells: counts.cells[sources.len()],
            balance,
        })
    }

    /// Refuses rules that do not go together.
    fn check_rules(&self) -> Result<()> {
        match (&self.choice, self.write_index) {
            (Choice::Median | Choice::Feather, Some(_)) => Err(Error::usage(
                "--write-index with --choose median or feather, which mix all sources in a cell",
                "leave one of them away",
            )),
            _ => Ok(()),
        }
    }

    /// Refuses what the samples of the sources do not allow.
    fn check(&self, first: &Source) -> Result<()> {
        use GdalDataType::{Float32, Float64, Int16, Int32, UInt8, UInt16, UInt32};
        if ![UInt8, UInt16, Int16, UInt32, Int32, Float32, Float64].contains(&first.kind) {
            let what = format!("samples of type {}", first.kind.name());
            let remedy = "bring them to another type with gdal_translate -ot (Float64 holds 53 bits)";
            return Err(Error::unsupported(&first.path, what, remedy));
        }
        let needed = 4 * self.tile_bytes(first.bands, self.halo_px());
        if needed > self.resources.memory_budget_bytes {
            let (what, remedy) = match self.blend_px {
                0 => (format!("{}: {} bands", first.path.display(), first.bands), "give more --memory, or fewer bands"),
                blend => {
                    (format!("--blend {blend} of {} bands", first.bands), "give a narrower --blend, or more --memory")
                }
            };
            let allowed = self.resources.memory_budget_bytes;
            return Err(Error::Limit { what, needed, allowed, remedy: remedy.into() });
        }
        let mixes = match self.choice {
            Choice::Median => Some("--choose median"),
            Choice::Feather => Some("--choose feather"),
            _ if self.blend_px > 0 => Some("--blend"),
            _ if self.balance.is_some() => Some("--balance"),
            _ => None,
        };
        match mixes.filter(|_| !first.palette.is_empty()) {
            Some(option) => Err(Error::unsupported(
                &first.path,
                format!("a palette, whose numbers {option} would mix"),
                "choose by first, last, newest, nearest or min, or bring it to colours with gdal_translate -expand rgb",
            )),
            None => Ok(()),
        }
    }

    fn reference(&self) -> Result<Option<usize>> {
        let Some(path) = self.balance_to else { return Ok(None) };
        let whole = |path: &Path| std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        let wanted = whole(path);
        self.inputs.iter().position(|input| whole(input) == wanted).map(Some).ok_or_else(|| {
            Error::usage(
                format!("{} is to be balanced to, and is none of the sources", path.display()),
                "name it among the sources, too",
            )
        })
    }

    /// Tiles that are narrower where there are many bands.
    fn cut(&self, bands: usize) -> Cut {
        let block_px = output::block_px(bands);
        // Feathers see far around their tile, which is therefore small: no tile changes a cell.
        let most = if self.choice == Choice::Feather { 256 } else { 1024 };
        let wanted = self.resources.tile_px.unwrap_or(512).min(most);
        let affordable = (MOST_TILE_BYTES / 8 / bands as u64 / block_px).max(block_px);
        Cut { tile_px: wanted.min(affordable), block_px }
    }

    /// What a worker holds.
    fn worker_bytes(&self, bands: usize) -> u64 {
        // The tile on its way to the file, and what is read of two sources.
        (24 << 20) + 4 * self.tile_bytes(bands, 0) + 4 * self.tile_bytes(bands, self.halo_px())
    }

    /// Cells around a tile that have a say.
    fn halo_px(&self) -> u64 {
        let feather = if self.choice == Choice::Feather { mix::REACH_PX } else { 0 };
        blend::halo_px(self.blend_px).max(feather)
    }

    /// The values of a tile and of so many cells around it.
    fn tile_bytes(&self, bands: usize, halo_px: u64) -> u64 {
        let cut = self.cut(bands);
        let width = cut.tile_px.next_multiple_of(cut.block_px) + 2 * halo_px;
        width * (cut.block_px + 2 * halo_px) * bands as u64 * 8
    }

    fn threads(&self, sources: &[Source]) -> usize {
        // Tile, sources and companions, and the datasets that stay open; a tile that is blended sees its surroundings.
        let each = self.worker_bytes(sources[0].bands);
        let spare = self.resources.memory_budget_bytes.saturating_sub(128 << 20);
        self.resources.threads.clamp(1, (spare / each).max(1) as usize)
    }
}

/// The values of a tile, in double precision.
const MOST_TILE_BYTES: u64 = 4 << 20;

/// What a file of a kind holds of a number.
fn stored(kind: GdalDataType, value: f64) -> f64 {
    let (least, most) = range(kind);
    match kind {
        GdalDataType::Float64 => value,
        GdalDataType::Float32 => f64::from(value as f32),
        _ => value.round().clamp(least, most),
    }
}

/// The number next to another, of those that a kind holds; of floats the first that GDAL tells from it.
fn beside(kind: GdalDataType, value: f64) -> f64 {
    /// Floats that are ten steps apart are still equal to GDAL.
    const STEPS: usize = 16;
    let most = range(kind).1;
    let towards = |value: f64| if value > 0.0 { value.next_down() } else { value.next_up() };
    let towards_f32 = |value: f32| if value > 0.0 { value.next_down() } else { value.next_up() };
    match kind {
        GdalDataType::Float64 => (0..STEPS).fold(value, |value, _| towards(value)),
        GdalDataType::Float32 => f64::from((0..STEPS).fold(value as f32, |value, _| towards_f32(value))),
        _ if value < most => value + 1.0,
        _ => value - 1.0,
    }
}

/// The mask lies beside the plain file, if there is one.
fn remove_mask(plain: &Path) {
    let mut name = plain.as_os_str().to_owned();
    name.push(".msk");
    let _ = std::fs::remove_file(name);
}

/// Everything that a tile needs.
struct Whole<'a> {
    job: &'a MosaicJob<'a>,
    sources: &'a [Source],
    grid: Grid,
    index: Option<&'a Source>,
    balance: Option<&'a Balance>,
    /// Cells that balancing brings beyond the limits of the sample type.
    clipped: &'a AtomicU64,
}

impl Whole<'_> {
    /// Writes the mosaic in the samples of its sources.
    fn write_as_sources(&self, path: &Path, index: Option<&Path>) -> Result<Counts> {
        let kind = self.sources[0].kind;
        let (least, most) = range(kind);
        match kind {
            GdalDataType::UInt8 => self.write::<u8>(path, index, |v| v.round().clamp(least, most) as u8),
            GdalDataType::UInt16 => self.write::<u16>(path, index, |v| v.round().clamp(least, most) as u16),
            GdalDataType::Int16 => self.write::<i16>(path, index, |v| v.round().clamp(least, most) as i16),
            GdalDataType::UInt32 => self.write::<u32>(path, index, |v| v.round().clamp(least, most) as u32),
            GdalDataType::Int32 => self.write::<i32>(path, index, |v| v.round().clamp(least, most) as i32),
            GdalDataType::Float64 => self.write::<f64>(path, index, |v| v),
            _ => self.write::<f32>(path, index, |v| v as f32),
        }
    }

    /// Returns what was counted.
    fn write<T: gdal::raster::GdalType + Copy + Send + 'static>(
        &self,
        path: &Path,
        index_path: Option<&Path>,
        cast: impl Fn(f64) -> T + Sync,
    ) -> Result<Counts> {
        let first = &self.sources[0];
        let threads = self.job.threads(self.sources);
        let float = matches!(first.kind, GdalDataType::Float32 | GdalDataType::Float64);
        let nodata = alike::nodata_of(self.sources);
        let void = nodata.unwrap_or(0.0);
        let deciding = first.deciding_bands();
        let form = Form {
            grid: self.grid,
            wkt: &first.wkt,
            bands: first.bands,
            nodata,
            predictor: if float { 3 } else { 2 },
            threads,
        };
        let mut dataset = output::create::<T>(path, &form)?;
        let masked = alike::describe(self.sources, path, &mut dataset, nodata)?;
        let index_form = Form { bands: 1, nodata: Some(0.0), predictor: 2, ..form };
        let index = index_path.map(|p| output::create::<u32>(p, &index_form).map(|d| (p, d))).transpose()?;
        let count = self.sources.len();
        let states = output::produce(
            &self.grid,
            self.job.cut(first.bands),
            threads,
            || Worker::new(count),
            |worker, window| {
                worker.core = window;
                let Some(mut tile) = self.tile(worker, window)? else { return Ok(None) };
                self.part_from_nodata(&mut tile, nodata, &deciding);
                if let Some(balance) = self.balance {
                    let clipped = balance.clipped(&tile.values, &tile.index, window, range(first.kind));
                    self.clipped.fetch_add(clipped, Ordering::Relaxed);
                }
                for (cell, &number) in tile.index.iter().enumerate() {
                    if number > 0 {
                        worker.cells[number as usize - 1] += 1;
                    }
                    worker.cells[count] += u64::from(holds(&tile.values, tile.index.len(), cell, &deciding));
                }
                let values: Vec<T> = tile.values.iter().map(|&v| cast(if v.is_nan() { void } else { v })).collect();
                let area = window.area() as usize;
                let there = |cell| if holds(&tile.values, area, cell, &deciding) { 255 } else { 0 };
                let mask: Vec<u8> = (0..area).map(there).collect();
                Ok(Some((values, tile.index, mask)))
            },
            |window, made| {
                let Some((values, numbers, mask)) = made else { return Ok(()) };
                output::put(path, &dataset, window, values)?;
                if masked {
                    output::put_mask(path, &dataset, window, mask)?;
                }
                if let Some((path, dataset)) = &index {
                    output::put(path, dataset, window, numbers)?;
                }
                Ok(())
            },
        )?;
        output::finish(path, dataset)?;
        if let Some((path, dataset)) = index {
            output::finish(path, dataset)?;
        }
        self.check_numbers(states.iter().map(|state| state.largest).max().unwrap_or(0))?;
        let mut counts = Counts { cells: vec![0; count + 1], uncosted: vec![0; count] };
        for state in &states {
            counts.cells.iter_mut().zip(&state.cells).for_each(|(a, b)| *a += b);
            counts.uncosted.iter_mut().zip(&state.uncosted).for_each(|(a, b)| *a += b);
        }
        Ok(counts)
    }

    /// Refuses an index of other sources.
    fn check_numbers(&self, largest: u32) -> Result<()> {
        let count = self.sources.len();
        let Some(index) = self.index.filter(|_| largest as usize > count) else { return Ok(()) };
        let what = format!("source {largest} is named in it, of {}", counted(count, "source", "sources"));
        let remedy = "name the sources that the index was written with, in the same order";
        Err(Error::unsupported(&index.path, what, remedy))
    }

    /// Moves what would be read as "nothing", since the sources differ in nodata or a mean met it, to the next number:
    /// every value of a band, of a picture the first band of a colour.
    fn part_from_nodata(&self, tile: &mut Tile, nodata: Option<f64>, deciding: &[usize]) {
        let Some(nodata) = nodata.filter(|value| !value.is_nan()) else { return };
        let first = &self.sources[0];
        let (stored, beside) = (|value: f64| stored(first.kind, value), beside(first.kind, nodata));
        let nodata = stored(nodata);
        let area = tile.index.len();
        if first.is_picture() {
            for cell in 0..area {
                if deciding.iter().all(|band| stored(tile.values[band * area + cell]) == nodata) {
                    tile.values[deciding[0] * area + cell] = beside;
                }
            }
        } else {
            tile.values.iter_mut().filter(|value| stored(**value) == nodata).for_each(|value| *value = beside);
        }
    }

    fn tile(&self, worker: &mut Worker, window: Window) -> Result<Option<Tile>> {
        let blended = !matches!(self.job.choice, Choice::Median | Choice::Feather) || self.index.is_some();
        if self.job.blend_px > 0 && blended { self.blended(worker, window) } else { self.chosen(worker, window) }
    }

    /// Each cell from the source that wins there.
    fn chosen(&self, worker: &mut Worker, window: Window) -> Result<Option<Tile>> {
        let near: Vec<usize> = (0..self.sources.len()).filter(|&i| self.sources[i].meets(&self.grid, window)).collect();
        if near.is_empty() {
            return Ok(None);
        }
        let area = window.area() as usize;
        let bands = self.sources[0].bands;
        let mut tile = Tile { values: vec![f64::NAN; area * bands], index: vec![0; area] };
        if let Some(index) = self.index {
            self.by_index(worker, index, &near, window, &mut tile)?;
        } else {
            match &self.job.choice {
                Choice::Median => self.median(worker, &near, window, &mut tile)?,
                Choice::Feather => self.feather(worker, &near, window, &mut tile)?,
                choice => self.choose(worker, choice, &near, window, &mut tile)?,
            }
        }
        Ok(Some(tile))
    }

    /// All bands of a source, balanced.
    fn read(&self, worker: &mut Worker, number: usize, window: Window) -> Result<Vec<f64>> {
        let source = &self.sources[number];
        let mut values = worker.opened.read(source, &self.grid, window, self.job.resampling)?;
        if let Some(balance) = self.balance {
            let area = window.area() as usize;
            for (at, value) in values.iter_mut().enumerate().filter(|(_, v)| !v.is_nan()) {
                let (band, cell) = (at / area, at as u64 % area as u64);
                let x = (window.x + cell % window.width) as f64 + 0.5;
                let y = (window.y + cell / window.width) as f64 + 0.5;
                let balanced = balance.correct(number, band, (x, y), *value);
                *value = balanced;
            }
        }
        Ok(values)
    }
}

/// Whether a cell holds anything in one of the bands that decide: black paint has no red, and is there.
fn holds(values: &[f64], area: usize, cell: usize, deciding: &[usize]) -> bool {
    deciding.iter().any(|band| !values[band * area + cell].is_nan())
}
