//! Grids of what points carry: every cell takes the points nearer to its centre than a radius, as PDAL's `writers.gdal`
//! does; holes are filled by inverse distance (Shepard, *A two-dimensional interpolation function for
//! irregularly-spaced data*, 1968).
//!
//! Sums are whole numbers of fixed steps, so that the order of points changes nothing. Rows are worked on in strips
//! that fit the memory; points near the border of strips go to both.

mod accumulate;
mod place;
mod plane;
mod write;

use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::crop;
use crate::error::{Error, Result};
use crate::io::{self, Header};
use crate::schema::{Batch, Field};
use crate::tiles::Scratch;

use accumulate::Strip;
use autoref_raster::words::{counted, in_short, with_decimals};
use place::Place;
use plane::{Plane, PointFile};
pub use write::output_paths;

const BATCH: usize = 1 << 14;
const BASE_BYTES: u64 = 80 << 20;
/// Larger values are none: sums in whole steps of 128 bits would not hold them, nor singles most of their squares. No
/// whole number of 64 bits is so large.
const MOST_VALUE: f64 = 1e20;

/// What is made of the points of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stat {
    Mean,
    Median,
    Min,
    Max,
    Count,
    /// With divisor n.
    Deviation,
    /// Weighted by the inverse distance to the centre.
    Idw,
}

impl Stat {
    /// # Errors
    /// When no statistic has that name.
    pub fn read(name: &str) -> Result<Stat> {
        Ok(match name.trim().to_ascii_lowercase().as_str() {
            "mean" => Stat::Mean,
            "median" => Stat::Median,
            "min" => Stat::Min,
            "max" => Stat::Max,
            "count" => Stat::Count,
            "stdev" | "std" | "stddev" => Stat::Deviation,
            "idw" => Stat::Idw,
            other => {
                let remedy = "choose among mean, median, min, max, count, stdev and idw";
                return Err(Error::usage(format!("--stat: `{other}` is no statistic"), remedy));
            }
        })
    }
}

/// A value of the points to be gridded.
#[derive(Clone, Debug, PartialEq)]
pub struct Dimension {
    pub name: String,
    pub radius_m: f64,
}

/// Where cells begin, and how holes are weighed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Manner {
    /// Edges on multiples of the cell; Euclidean distances.
    Snapped,
    /// Edges from the cloud's least x and y; the larger of both differences of cells.
    Pdal,
}

/// Which points count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Noise {
    /// Classes 7 and 18 are left out, and points that are flagged as withheld, which LAS calls deleted.
    LeaveOut,
    Keep,
}

/// How clouds are gridded.
#[derive(Clone, Debug)]
pub struct Options {
    pub cell_m: f64,
    /// With the names that files get.
    pub stats: Vec<(String, Stat)>,
    pub dimensions: Vec<Dimension>,
    /// Cells to each side of a hole that fill it; 0 fills none.
    pub fill_cells: usize,
    /// Exponent of the inverse distance.
    pub power: f64,
    pub manner: Manner,
    pub noise: Noise,
    /// Map coordinates less the file's; `None` takes what the file says.
    pub shift: Option<[f64; 3]>,
    /// For the dimension `range` when the cloud has none.
    pub camera: Option<[f64; 3]>,
    pub memory_bytes: u64,
    pub scratch: PathBuf,
    /// WKT for clouds that have no reference system.
    pub crs_wkt: Option<String>,
}

/// Where the cells lie.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Frame {
    pub columns: usize,
    pub rows: usize,
    pub west: f64,
    pub north: f64,
    pub cell_m: f64,
}

impl Frame {
    fn new(min: [f64; 2], max: [f64; 2], cell: f64, manner: Manner) -> Option<Frame> {
        let (west, south) = match manner {
            Manner::Snapped => ((min[0] / cell).floor() * cell, (min[1] / cell).floor() * cell),
            Manner::Pdal => (min[0], min[1]),
        };
        let count = |extent: f64| {
            let cells = (extent / cell).floor() + 1.0;
            (cells < f64::from(i32::MAX)).then_some(cells as usize)
        };
        let (columns, rows) = (count(max[0] - west)?, count(max[1] - south)?);
        Some(Frame { columns, rows, west, north: south + rows as f64 * cell, cell_m: cell })
    }

    /// Centre of a column, or of a row.
    fn x(&self, column: usize) -> f64 {
        self.west + (column as f64 + 0.5) * self.cell_m
    }
    fn y(&self, row: usize) -> f64 {
        // From the south, so that edges on multiples of the cell stay there to the last bit.
        let south = self.north - self.rows as f64 * self.cell_m;
        south + ((self.rows - 1 - row) as f64 + 0.5) * self.cell_m
    }
    /// Rows whose centre may lie within `radius` of `y`.
    fn rows_near(&self, y: f64, radius: f64) -> std::ops::Range<usize> {
        near((self.north - y) / self.cell_m, radius / self.cell_m, self.rows)
    }
    fn columns_near(&self, x: f64, radius: f64) -> std::ops::Range<usize> {
        near((x - self.west) / self.cell_m, radius / self.cell_m, self.columns)
    }
}

/// One cell more than needed on both sides: the distance has the last word.
fn near(at: f64, reach: f64, count: usize) -> std::ops::Range<usize> {
    let low = (at - reach - 1.5).max(0.0) as usize;
    let high = ((at + reach + 1.5).max(0.0) as usize).min(count);
    low.min(high)..high
}

/// Where a dimension's value comes from.
enum Source {
    X,
    Y,
    Z,
    Range([f64; 3]),
    Field(Field),
    Grey([Field; 3]),
}

impl Source {
    fn find(path: &Path, name: &str, header: &Header, options: &Options) -> Result<Source> {
        let schema = &header.schema;
        let any = |names: &[&str]| names.iter().find_map(|name| schema.field(name)).cloned();
        let found = match name {
            "x" => Some(Source::X),
            "y" => Some(Source::Y),
            "z" => Some(Source::Z),
            "range" if options.camera.is_some() => options.camera.map(Source::Range),
            "intensity" => {
                any(&["intensity", "scalar_intensity", "grey", "gray"]).map(Source::Field).or_else(|| {
                    match (any(&["red", "r"]), any(&["green", "g"]), any(&["blue", "b"])) {
                        (Some(red), Some(green), Some(blue)) => Some(Source::Grey([red, green, blue])),
                        _ => None,
                    }
                })
            }
            name => any(&[name, &format!("scalar_{name}")]).map(Source::Field),
        };
        found.ok_or_else(|| {
            let mut names: Vec<&str> = vec!["x", "y", "z"];
            names.extend(schema.fields.iter().map(|field| field.name.as_str()));
            names.dedup();
            let remedy = match name {
                "range" => "give --range-from E,N,H".to_string(),
                _ => format!("it has {}", names.join(", ")),
            };
            Error::usage(format!("{}: --dimension: it carries no `{name}`", path.display()), remedy)
        })
    }

    /// NaN for none.
    fn value(&self, map: [f64; 3], raw: &[u8]) -> f64 {
        let value = match self {
            Source::X => map[0],
            Source::Y => map[1],
            Source::Z => map[2],
            Source::Range(camera) => crop::distance(map, *camera),
            Source::Field(field) => field.value(raw),
            Source::Grey(fields) => fields.iter().map(|field| field.value(raw)).sum::<f64>() / 3.0,
        };
        if value.abs() <= MOST_VALUE { value } else { f64::NAN }
    }
}

/// What was written for a cloud.
#[derive(Clone, Debug, Serialize)]
pub struct GridReport {
    #[serde(serialize_with = "autoref_raster::path_text::one")]
    pub input: PathBuf,
    pub points: u64,
    /// Noise, withheld points, and points that have no value at all.
    pub points_left_out: u64,
    /// Of these, flagged as withheld; one of class 7 or 18 counts as noise.
    pub points_withheld: u64,
    /// For each dimension: points without a value of it (NaN, what the file declares for none, beyond 10²⁰).
    pub points_without_value: Vec<u64>,
    /// In which coordinates, and so cells, count.
    pub unit: String,
    /// What is to be known of the grids.
    pub notes: Vec<String>,
    pub frame: Frame,
    pub crs: Option<String>,
    pub strips: usize,
    pub cells_with_points: Vec<u64>,
    #[serde(serialize_with = "autoref_raster::path_text::many")]
    pub files_written: Vec<PathBuf>,
    pub seconds: f64,
}

/// Bytes in the unit that leaves a digit or more before the point.
fn amount(bytes: u64) -> String {
    let (unit, name) = [(1e9, "GB"), (1e6, "MB"), (1e3, "kB")]
        .into_iter()
        .find(|(unit, _)| bytes as f64 >= *unit)
        .unwrap_or((1.0, "bytes"));
    let value = bytes as f64 / unit;
    if value < 10.0 && unit > 1.0 { format!("{value:.1} {name}") } else { format!("{value:.0} {name}") }
}

/// Refuses a grid whose planes the disk does not hold: one point far away is enough for that.
fn check_scratch(path: &Path, frame: &Frame, options: &Options, (dimensions, unit): (usize, &str)) -> Result<()> {
    const VALUE_BYTES: u64 = 8;
    let cells = (frame.columns as u64).saturating_mul(frame.rows as u64);
    let planes = (dimensions * (1 + options.stats.len())) as u64;
    let needed = cells.saturating_mul(planes * VALUE_BYTES);
    match autoref_raster::free_disk_bytes(&options.scratch) {
        Some(free) if needed > free => Err(Error::usage(
            format!(
                "{}: {} × {} cells of {} {unit} would take {} of scratch data; the disk of {} has {} free",
                path.display(),
                frame.columns,
                frame.rows,
                frame.cell_m,
                amount(needed),
                options.scratch.display(),
                amount(free)
            ),
            "make room there or name another disk, raise --cell, or take out points that lie far away \
             (cloud clean --crop)",
        )),
        _ => Ok(()),
    }
}

/// What a cloud held.
#[derive(Default)]
struct Held {
    points: u64,
    /// Of these, left out as noise, and as withheld.
    noise: u64,
    withheld: u64,
    left_over: Option<String>,
}

/// Reads all points of a cloud in map coordinates.
fn each_point(path: &Path, options: &Options, mut each: impl FnMut([f64; 3], &[u8]) -> Result<()>) -> Result<Held> {
    let (header, mut reader) = io::open(path)?;
    let shift = options.shift.or(header.shift).unwrap_or([0.0; 3]);
    let noted = |name: &str| header.schema.field(name).filter(|_| options.noise == Noise::LeaveOut);
    let (class, withheld) = (noted("classification"), noted("withheld"));
    let mut batch = Batch::default();
    let mut held = Held::default();
    loop {
        reader.read(&mut batch, BATCH)?;
        if batch.is_empty() {
            held.left_over = reader.left_over()?;
            return Ok(held);
        }
        for (index, xyz) in batch.xyz.iter().enumerate() {
            held.points += 1;
            let raw = batch.record(&header.schema, index);
            if !xyz.iter().all(|value| value.is_finite()) {
                let [x, y, z] = xyz.map(in_short);
                let what = format!(
                    "the coordinates ({x}, {y}, {z}) are not finite; clean it first with cloud clean --skip-invalid"
                );
                return Err(Error::format(path, format!("point {}", held.points), what));
            }
            if class.is_some_and(|field| matches!(field.value(raw) as u8, 7 | 18)) {
                held.noise += 1;
                continue;
            }
            if withheld.is_some_and(|field| field.value(raw) == 1.0) {
                held.withheld += 1;
                continue;
            }
            each([0, 1, 2].map(|axis| xyz[axis] + shift[axis]), raw)?;
        }
    }
}

/// What gridding goes through once the frame is known.
struct Work<'a> {
    path: &'a Path,
    options: &'a Options,
    frame: Frame,
    sources: &'a [Source],
    /// Rows whose cells fit the memory.
    most_rows: usize,
    /// Values that the medians of one dimension may hold at a time.
    median_entries: usize,
    scratch: Scratch,
    /// For each dimension: the counts, then each statistic.
    planes: Vec<Vec<Plane>>,
    /// Strips that were worked on.
    strips: usize,
}

/// Files of points that are open at a time.
const MOST_FILES: usize = 256;

/// Points that lack all values, and those that lack that of each dimension.
struct Lacking {
    all: u64,
    each: Vec<u64>,
}

impl Lacking {
    fn notes(&self, options: &Options) -> Vec<String> {
        let lacking = options.dimensions.iter().zip(&self.each).filter(|(_, count)| **count > 0);
        lacking
            .map(|(dimension, count)| {
                format!("{} no value of {}", counted(*count, "point has", "points have"), dimension.name)
            })
            .collect()
    }
}

/// A strip's medians take more memory than there is: how much at least.
struct Full(u64);

impl Work<'_> {
    fn make_planes(&mut self) -> Result<()> {
        for _ in self.sources {
            let stats = 0..=self.options.stats.len();
            let row: Result<Vec<Plane>> = stats.map(|_| Plane::new(&mut self.scratch, self.frame.columns)).collect();
            self.planes.push(row?);
        }
        Ok(())
    }

    /// Rows of strips whose medians fit the memory where points lie evenly.
    fn rows_for_medians(&self, points: u64) -> usize {
        if !self.options.stats.iter().any(|(_, stat)| *stat == Stat::Median) {
            return self.frame.rows;
        }
        let reach = self.options.dimensions.iter().map(|dimension| dimension.radius_m).fold(0.0, f64::max);
        let cells = std::f64::consts::PI * (reach / self.frame.cell_m).powi(2);
        let entries = points as f64 * cells.max(1.0);
        let strips = (1.2 * entries / self.median_entries.max(1) as f64).ceil().max(1.0);
        ((self.frame.rows as f64 / strips) as usize).max(1)
    }

    fn new_strip(&self, rows: &std::ops::Range<usize>) -> Vec<Strip> {
        let new = |_| Strip::new(self.frame, rows.clone(), self.options, self.median_entries);
        self.sources.iter().map(new).collect()
    }

    fn take(&self, strip: &mut [Strip], place: [f64; 2], values: &[f64]) -> std::result::Result<(), Full> {
        let all = strip.iter_mut().zip(values).zip(&self.options.dimensions);
        for ((strip, &value), dimension) in all.filter(|((_, value), _)| !value.is_nan()) {
            strip.add(place, value, dimension.radius_m).map_err(Full)?;
        }
        Ok(())
    }

    fn finish(&mut self, strip: Vec<Strip>) -> Result<()> {
        self.strips += 1;
        for (strip, planes) in strip.into_iter().zip(&mut self.planes) {
            strip.finish(&self.options.stats, planes).map_err(|e| self.scratch.error("write scratch data to", e))?;
        }
        Ok(())
    }

    /// Hands over the points that have a value, NaN for those that they lack; answers how many lack which.
    fn each_valid(&self, mut each: impl FnMut([f64; 2], &[f64]) -> Result<()>) -> Result<Lacking> {
        let mut values = vec![0.0; self.sources.len()];
        let mut lacking = Lacking { all: 0, each: vec![0; self.sources.len()] };
        each_point(self.path, self.options, |map, raw| {
            values.iter_mut().zip(self.sources).for_each(|(value, source)| *value = source.value(map, raw));
            lacking.each.iter_mut().zip(&values).for_each(|(count, value)| *count += u64::from(value.is_nan()));
            if values.iter().all(|value| value.is_nan()) {
                lacking.all += 1;
                return Ok(());
            }
            each([map[0], map[1]], &values)
        })?;
        Ok(lacking)
    }

    /// All rows at once; answers which values lack, or `None` where the medians do not fit.
    fn whole(&mut self) -> Result<Option<Lacking>> {
        let mut strip = self.new_strip(&(0..self.frame.rows));
        let mut full = false;
        let read = self.each_valid(|place, values| {
            self.take(&mut strip, place, values).map_err(|Full(needed)| {
                full = true;
                self.too_many(needed)
            })
        });
        if full {
            return Ok(None);
        }
        let invalid = read?;
        self.finish(strip)?;
        Ok(Some(invalid))
    }

    /// Strip by strip, over files of points; answers which values lack.
    fn by_strips(&mut self, strip_rows: usize) -> Result<Lacking> {
        let rows = self.frame.rows;
        let strip_rows = strip_rows.max(rows.div_ceil(MOST_FILES));
        let strips = rows.div_ceil(strip_rows);
        let reach = self.options.dimensions.iter().map(|dimension| dimension.radius_m).fold(0.0, f64::max);
        let numbers = 2 + self.sources.len();
        let mut files: Vec<PointFile> =
            (0..strips).map(|_| PointFile::new(&self.options.scratch, numbers)).collect::<Result<_>>()?;
        let invalid = self.each_valid(|place, values| {
            let near = self.frame.rows_near(place[1], reach);
            for strip in near.start / strip_rows..near.end.div_ceil(strip_rows).min(strips) {
                files[strip].push(&place, values)?;
            }
            Ok(())
        })?;
        for (number, mut file) in files.into_iter().enumerate() {
            let begin = number * strip_rows;
            self.strip(begin..(begin + strip_rows).min(rows), &mut file)?;
        }
        Ok(invalid)
    }

    /// Some rows; halves of them where their cells or medians do not fit.
    fn strip(&mut self, rows: std::ops::Range<usize>, file: &mut PointFile) -> Result<()> {
        let middle = rows.start + rows.len() / 2;
        if rows.len() > self.most_rows {
            self.strip(rows.start..middle, file)?;
            return self.strip(middle..rows.end, file);
        }
        let mut strip = self.new_strip(&rows);
        let mut full = false;
        let read = file.each(|record| {
            self.take(&mut strip, [record[0], record[1]], &record[2..]).map_err(|Full(needed)| {
                full = true;
                self.too_many(needed)
            })
        });
        if full && rows.len() > 1 {
            drop(strip);
            self.strip(rows.start..middle, file)?;
            return self.strip(middle..rows.end, file);
        }
        read?;
        self.finish(strip)
    }

    /// All planes, at once where they fit; answers which values lack.
    fn run(&mut self, points: u64) -> Result<Lacking> {
        self.make_planes()?;
        let strip_rows = self.most_rows.min(self.rows_for_medians(points));
        match if strip_rows == self.frame.rows { self.whole()? } else { None } {
            Some(lacking) => Ok(lacking),
            None => self.by_strips(strip_rows),
        }
    }

    fn too_many(&self, needed: u64) -> Error {
        Error::Limit {
            what: format!("{}: the median of so many points in a row of cells", self.path.display()),
            needed,
            allowed: self.median_entries as u64 * 16,
            remedy: "raise --memory, or leave median out".into(),
        }
    }
}

/// Where the points lie that count.
struct Extent {
    min: [f64; 2],
    max: [f64; 2],
}

fn extent(path: &Path, options: &Options) -> Result<(Extent, Held)> {
    let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let held = each_point(path, options, |map, _| {
        for axis in 0..2 {
            min[axis] = min[axis].min(map[axis]);
            max[axis] = max[axis].max(map[axis]);
        }
        Ok(())
    })?;
    if min[0] > max[0] {
        let what = if held.points == 0 {
            "there are none; leave the file out"
        } else {
            "all of them are noise or withheld; take them in with --keep-noise"
        };
        return Err(Error::format(path, "points", what));
    }
    Ok((Extent { min, max }, held))
}

/// Grids one cloud into `folder`; files appear whole or not at all.
///
/// # Errors
/// Bad input, a cloud in degrees, dimensions that the cloud does not carry, a grid without bounds, a full disk.
pub fn grid(path: &Path, folder: &Path, options: &Options) -> Result<GridReport> {
    let began = std::time::Instant::now();
    let (mut header, _) = io::open(path)?;
    let asked = options.crs_wkt.as_deref();
    let mut notes: Vec<String> = header.settle_crs(asked, "grids have none").into_iter().collect();
    header.refuse_degrees(path, asked, "a grid")?;
    let find = |dimension: &Dimension| Source::find(path, &dimension.name, &header, options);
    let sources: Vec<Source> = options.dimensions.iter().map(find).collect::<Result<_>>()?;
    let place = Place::of(&header, options, &mut notes);
    let (Extent { min, max }, Held { points, noise, withheld, left_over }) = extent(path, options)?;
    notes.extend(left_over);
    if withheld > 0 {
        let are = counted(withheld, "point is", "points are");
        notes.push(format!("{are} flagged as withheld and left out; --keep-noise takes them in"));
    }
    let too_wide = |needed: u64| Error::Limit {
        what: format!(
            "{}: a grid of {} × {} {}",
            path.display(),
            with_decimals(max[0] - min[0], 0),
            with_decimals(max[1] - min[1], 0),
            place.unit
        ),
        needed,
        allowed: options.memory_bytes,
        remedy: "raise --cell or --memory, or clean the cloud first".into(),
    };
    let frame = Frame::new(min, max, options.cell_m, options.manner).ok_or_else(|| too_wide(u64::MAX))?;
    check_scratch(path, &frame, options, (sources.len(), &place.unit))?;
    let budget = options.memory_bytes.saturating_sub(BASE_BYTES).max(16 << 20);
    let cell_bytes = Strip::cell_bytes(&options.stats) * sources.len() as u64;
    let row_bytes = frame.columns as u64 * cell_bytes;
    // A quarter is for medians, and another for what sorts them.
    let medians = options.stats.iter().any(|(_, stat)| *stat == Stat::Median);
    let for_cells = if medians { budget / 2 } else { budget / 4 * 3 };
    let strip_rows = (for_cells / row_bytes.max(1)).min(frame.rows as u64) as usize;
    if strip_rows == 0 {
        return Err(too_wide(row_bytes * 2 + BASE_BYTES));
    }
    let least_bytes = write::least_bytes(&frame, options);
    if least_bytes > budget {
        return Err(too_wide(least_bytes + BASE_BYTES));
    }
    let mut work = Work {
        path,
        options,
        frame,
        sources: &sources,
        most_rows: strip_rows,
        median_entries: (budget / 4 / 16) as usize / sources.len().max(1),
        scratch: Scratch::new(&options.scratch)?,
        planes: Vec::new(),
        strips: 0,
    };
    let lacking = work.run(points)?;
    let Work { mut planes, strips, .. } = work;
    notes.extend(lacking.notes(options));
    for note in &notes {
        tracing::warn!("{}: {note}", path.display());
    }
    let (files_written, cells_with_points) =
        write::write(path, folder, &frame, &mut planes, options, (&place, budget))?;
    Ok(GridReport {
        input: path.to_path_buf(),
        points,
        points_left_out: noise + withheld + lacking.all,
        points_withheld: withheld,
        points_without_value: lacking.each,
        unit: place.unit,
        notes,
        frame,
        crs: header.crs,
        strips,
        cells_with_points,
        files_written,
        seconds: began.elapsed().as_secs_f64(),
    })
}
