//! One model minus another: statistics by class and zone, volumes, and how sure they are.

mod page;
mod preview;
mod select;
mod variogram;

pub use page::write_page;
pub use variogram::Variogram;

use std::collections::BinaryHeap;
use std::path::Path;

use autoref_raster::random::mix;
use serde::Serialize;

use crate::couple::{Couple, open_couple};
use crate::error::{Error, Result};
use crate::files::{Resources, SMALLEST_BUDGET_BYTES, read_zones};
use crate::grid::{Grid, GroundUnit};
use crate::output::{self, Form};
use crate::resample::{Interpolation, Resampled, Scratch};
use crate::source::{Heights, Means as Averaged, Patch};
use crate::stream::{self, Means};
use crate::window::Window;
use crate::zones::Zones;

/// `dem compare`, from files.
pub struct CompareJob<'a> {
    pub a: &'a Path,
    pub b: &'a Path,
    pub zones: Option<&'a Path>,
    pub resampling: Interpolation,
    /// Limits of the slope classes, per cent, from 0 on.
    pub slope_limits: &'a [f64],
    /// The share of differences within so many metres is told.
    pub within_m: f64,
    /// Leave out differences farther from the mean than so many standard deviations.
    pub outliers: Option<f64>,
    pub resources: Resources,
}

/// Statistics of a group of cells. Differences are A − B, metres.
#[derive(Clone, Debug, Serialize)]
pub struct Statistics {
    pub group: String,
    pub class: String,
    pub n: u64,
    pub mean_m: Option<f64>,
    pub median_m: Option<f64>,
    pub sd_m: Option<f64>,
    pub nmad_m: Option<f64>,
    pub rmse_m: Option<f64>,
    pub min_m: Option<f64>,
    pub max_m: Option<f64>,
    pub share_within: Option<f64>,
    /// By per cent.
    pub percentiles_m: serde_json::Map<String, serde_json::Value>,
}

/// The change of a zone.
#[derive(Clone, Debug, Serialize)]
pub struct Volume {
    pub zone: String,
    pub n: u64,
    pub area_m2: f64,
    pub mean_m: f64,
    pub mean_se_m: f64,
    pub effective_n: f64,
    pub volume_m3: f64,
    pub volume_se_m3: f64,
    pub volume_95_m3: [f64; 2],
}

/// What `dem compare` says.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    pub a: String,
    pub b: String,
    /// What was subtracted from what.
    pub difference: &'static str,
    pub grid: String,
    pub resampling: &'static str,
    pub heights: String,
    pub cells: u64,
    pub common_cells: u64,
    pub within_m: f64,
    pub mean_m: Option<f64>,
    pub median_m: Option<f64>,
    pub sd_m: Option<f64>,
    pub nmad_m: Option<f64>,
    pub rmse_m: Option<f64>,
    /// Of the mean, with the correlation of neighbours.
    pub mean_se_m: f64,
    pub effective_n: f64,
    pub variogram: Variogram,
    pub statistics: Vec<Statistics>,
    pub volumes: Vec<Volume>,
}

const PERCENTS: [f64; 9] = [1.0, 5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 99.0];
const ASPECTS: [&str; 9] = ["N", "NE", "E", "SE", "S", "SW", "W", "NW", "flat"];
/// Most bands of height.
const HEIGHT_BANDS: f64 = 12.0;
/// Units of a difference in sums: 2⁻²⁰ m.
const UNIT: f64 = (1u64 << 20) as f64;
/// Cells of a zone that stand for it in sums over pairs.
const WITNESSES: usize = 1000;

/// Moments that do not depend on the order.
#[derive(Clone, Default)]
struct Moments {
    n: u64,
    sum: i128,
    squares: i128,
    within: u64,
    low: Option<f32>,
    high: Option<f32>,
}

impl Moments {
    fn add(&mut self, value: f32, within_m: f64) {
        let fixed = (f64::from(value) * UNIT) as i64 as i128;
        self.n += 1;
        self.sum += fixed;
        self.squares += fixed * fixed;
        self.within += u64::from(f64::from(value).abs() <= within_m);
        self.low = Some(self.low.map_or(value, |v| v.min(value)));
        self.high = Some(self.high.map_or(value, |v| v.max(value)));
    }

    fn merge(&mut self, other: &Moments) {
        self.n += other.n;
        self.sum += other.sum;
        self.squares += other.squares;
        self.within += other.within;
        self.low = self.low.into_iter().chain(other.low).reduce(f32::min);
        self.high = self.high.into_iter().chain(other.high).reduce(f32::max);
    }

    fn mean(&self) -> Option<f64> {
        (self.n > 0).then(|| self.sum as f64 / UNIT / self.n as f64)
    }

    fn rmse(&self) -> Option<f64> {
        (self.n > 0).then(|| (self.squares as f64 / (UNIT * UNIT) / self.n as f64).sqrt())
    }

    /// Divisor n.
    fn sd(&self) -> Option<f64> {
        let (mean, rmse) = (self.mean()?, self.rmse()?);
        Some((rmse * rmse - mean * mean).max(0.0).sqrt())
    }
}

/// What is known of a cell beside its difference.
struct Cell {
    x: u64,
    y: u64,
    difference: f32,
    slope_percent: f64,
    aspect: Option<usize>,
    height: f64,
    zone: u32,
}

/// Both models on B's grid.
struct Scan<'a> {
    grid: Grid,
    unit: GroundUnit,
    a: Resampled<'a, Averaged<'a, crate::model::Model>>,
    b: &'a crate::model::Model,
    zones: Option<&'a Zones>,
    /// Differences outside are left out.
    limits: (f64, f64),
}

#[derive(Default)]
struct Buffers {
    scratch: Scratch,
    a: Vec<f64>,
    b: Vec<f64>,
    zones: Vec<u32>,
}

impl Scan<'_> {
    /// All common cells of a window, row by row.
    fn cells(&self, window: Window, buffers: &mut Buffers, mut see: impl FnMut(Cell)) -> Result<()> {
        let (width, height) = (window.width as usize, window.height as usize);
        let (x, y) = (window.x as i64, window.y as i64);
        self.a.read_with(Patch { x, y, width, height }, &mut buffers.scratch, &mut buffers.a)?;
        let stride = width + 2;
        self.b.read(Patch { x: x - 1, y: y - 1, width: stride, height: height + 2 }, &mut buffers.b)?;
        buffers.zones.clear();
        buffers.zones.resize(width, 0);
        let (grid, b) = (&self.grid, &buffers.b);
        for row in 0..height {
            let north = grid.y0 + ((window.y + row as u64) as f64 + 0.5) * grid.step_y;
            if let Some(zones) = self.zones {
                let east = grid.x0 + (window.x as f64 + 0.5) * grid.step_x;
                zones.row(north, east, grid.step_x, &mut buffers.zones);
            }
            let (mx, my) = self.unit.metres_per_unit(north);
            let (per_x, per_y) = (0.125 / (mx * grid.step_x), 0.125 / (my * grid.step_y));
            for column in 0..width {
                let at = (row + 1) * stride + column + 1;
                let difference = buffers.a[row * width + column] - b[at];
                if difference.is_nan() || difference < self.limits.0 || difference > self.limits.1 {
                    continue;
                }
                let w = |dy: usize, dx: usize| b[at + dy * stride + dx - stride - 1];
                // Horn, Hill shading and the reflectance map, 1981.
                let east = ((w(0, 2) + 2.0 * w(1, 2) + w(2, 2)) - (w(0, 0) + 2.0 * w(1, 0) + w(2, 0))) * per_x;
                let up = ((w(2, 0) + 2.0 * w(2, 1) + w(2, 2)) - (w(0, 0) + 2.0 * w(0, 1) + w(0, 2))) * per_y;
                let tangent = east.hypot(up);
                let aspect = if tangent.is_nan() {
                    None
                } else if tangent == 0.0 {
                    Some(8)
                } else {
                    // Where the slope looks: downhill, from north by east.
                    let turn = (-east).atan2(-up).rem_euclid(std::f64::consts::TAU) / std::f64::consts::TAU * 8.0;
                    Some((turn + 0.5) as usize % 8)
                };
                see(Cell {
                    x: window.x + column as u64,
                    y: window.y + row as u64,
                    difference: difference as f32,
                    slope_percent: 100.0 * tangent,
                    aspect,
                    height: b[at],
                    zone: buffers.zones[column],
                });
            }
        }
        Ok(())
    }
}

/// Which groups there are, and which a cell belongs to.
struct Groups {
    slope_limits: Vec<f64>,
    height_low: f64,
    height_step: f64,
    names: Vec<(String, String)>,
    first_height: usize,
    first_zone: usize,
}

impl Groups {
    fn new(slope_limits: &[f64], heights: (f64, f64), zones: Option<&Zones>) -> Groups {
        let mut names = vec![("all".to_string(), "all".to_string())];
        for (i, limit) in slope_limits.iter().enumerate() {
            let upper = slope_limits.get(i + 1).map_or("inf".to_string(), |v| format!("{v}%"));
            names.push(("slope".into(), format!("[{limit}%;{upper}[")));
        }
        names.extend(ASPECTS.iter().map(|a| ("aspect".to_string(), (*a).to_string())));
        let range = (heights.1 - heights.0).max(1e-3);
        let rough = range / HEIGHT_BANDS;
        let power = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0].iter().map(|m| m * power).find(|s| *s >= rough).unwrap_or(rough);
        let low = (heights.0 / step).floor() * step;
        let first_height = names.len();
        let bands = ((heights.1 - low) / step).floor() as usize + 1;
        for band in 0..bands {
            let from = low + band as f64 * step;
            names.push(("height".into(), format!("[{from} m;{} m[", from + step)));
        }
        let first_zone = names.len();
        if let Some(zones) = zones {
            names.extend(zones.names().iter().map(|name| ("zone".to_string(), name.clone())));
            names.push(("zone".into(), "outside all zones".into()));
        }
        let slope_limits = slope_limits.to_vec();
        Groups { slope_limits, height_low: low, height_step: step, names, first_height, first_zone }
    }

    fn each(&self, cell: &Cell, mut see: impl FnMut(usize)) {
        see(0);
        if let Some(class) = self.slope_limits.iter().rposition(|limit| cell.slope_percent >= *limit) {
            see(1 + class);
        }
        if let Some(aspect) = cell.aspect {
            see(1 + self.slope_limits.len() + aspect);
        }
        let band = ((cell.height - self.height_low) / self.height_step) as usize;
        see((self.first_height + band).min(self.first_zone - 1));
        if self.first_zone < self.names.len() {
            let outside = self.names.len() - 1;
            see(if cell.zone == 0 { outside } else { self.first_zone + cell.zone as usize - 1 });
        }
    }
}

/// A number that scatters positions.
fn hash(x: u64, y: u64) -> u64 {
    mix(x.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ y.wrapping_mul(0xc2b2_ae3d_27d4_eb4f).rotate_left(31))
}

/// The first pass: what decides the groups, and what stands for the zones.
#[derive(Default)]
struct First {
    moments: Moments,
    heights: Option<(f64, f64)>,
    /// Cells with the smallest hashes, of all ground and of each zone.
    witnesses: Vec<BinaryHeap<(u64, u64, u64)>>,
    /// For the page's map.
    samples: Vec<preview::Sample>,
}

impl First {
    fn see(&mut self, cell: &Cell, within_m: f64) {
        self.moments.add(cell.difference, within_m);
        let z = cell.height;
        self.heights = Some(self.heights.map_or((z, z), |(low, high)| (low.min(z), high.max(z))));
        let key = (hash(cell.x, cell.y), cell.x, cell.y);
        Self::keep(&mut self.witnesses, 0, key);
        if cell.zone > 0 {
            Self::keep(&mut self.witnesses, cell.zone as usize, key);
        }
    }

    fn keep(all: &mut Vec<BinaryHeap<(u64, u64, u64)>>, index: usize, key: (u64, u64, u64)) {
        if all.len() <= index {
            all.resize_with(index + 1, BinaryHeap::new);
        }
        let heap = &mut all[index];
        if heap.len() < WITNESSES {
            heap.push(key);
        } else if heap.peek().is_some_and(|most| key < *most) {
            heap.pop();
            heap.push(key);
        }
    }

    fn merge(&mut self, other: First) {
        self.moments.merge(&other.moments);
        self.samples.extend(other.samples);
        self.heights = match (self.heights, other.heights) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (a, b) => a.or(b),
        };
        for (index, heap) in other.witnesses.into_iter().enumerate() {
            heap.into_iter().for_each(|key| Self::keep(&mut self.witnesses, index, key));
        }
    }

    fn places(&self, index: usize) -> Vec<(u64, u64)> {
        let keys = self.witnesses.get(index).map(|heap| heap.clone().into_sorted_vec()).unwrap_or_default();
        keys.into_iter().map(|(_, x, y)| (x, y)).collect()
    }
}

/// Groups, their moments, quantiles.
struct Classes {
    groups: Groups,
    moments: Vec<Moments>,
    quantiles: Vec<Vec<f64>>,
    nmad: Vec<Option<f64>>,
}

impl CompareJob<'_> {
    /// Writes `difference.tif`, `summary.json`, `statistics.csv`, `volumes.csv`, `variogram.csv` and `report.html` into
    /// `folder`, which exists.
    ///
    /// # Errors
    /// When a file cannot be read or written, or the two models have no cell in common.
    pub fn run(&self, folder: &Path) -> Result<Summary> {
        self.resources.check()?;
        debug_assert!(self.resources.memory_budget_bytes >= SMALLEST_BUDGET_BYTES);
        let couple = open_couple(self.a, self.b)?;
        let zones = self.zones.map(|path| read_zones(path, couple.b.wkt())).transpose()?;
        let means = self.resources.means(&[&couple.a, &couple.b]);
        let grid = couple.b.grid();
        let nothing = || {
            Error::usage(
                format!("{} and {} have no cell with heights in common", self.a.display(), self.b.display()),
                "look at their extents and nodata values with gdalinfo -stats",
            )
        };
        if couple.a.grid().overlap(&grid).is_none() {
            return Err(nothing());
        }
        let cell = |g: &Grid| (g.step_x * g.step_y).abs();
        let ratio = (cell(&grid) / cell(&couple.a.grid())).sqrt().round().max(1.0) as u64;
        let averaged = Averaged::new(&couple.a, ratio);
        let mut scan = Scan {
            grid,
            unit: couple.b.ground_unit(),
            a: Resampled::new(&averaged, grid, (0.0, 0.0), self.resampling),
            b: &couple.b,
            zones: zones.as_ref(),
            limits: (f64::NEG_INFINITY, f64::INFINITY),
        };
        if let Some(limit) = self.outliers {
            let moments = self.first(&scan, means)?.moments;
            let (mean, sd) = moments.mean().zip(moments.sd()).ok_or_else(nothing)?;
            scan.limits = (mean - limit * sd, mean + limit * sd);
        }
        let first = self.write_difference(&scan, &couple, means, &folder.join("difference.tif"))?;
        let heights = first.heights.ok_or_else(nothing)?;
        let classes = self.classes(&scan, Groups::new(self.slope_limits, heights, zones.as_ref()), means)?;
        let summary = self.summary(&couple, &scan, &first, &classes, means)?;
        write_tables(folder, &summary)?;
        let map = preview::Sampling::of(grid.width, grid.height).data(&scan, &first.samples);
        write_page(folder, &summary, &map)?;
        Ok(summary)
    }

    fn first(&self, scan: &Scan<'_>, means: Means) -> Result<First> {
        let tiles = means.tiles(scan.grid.width, scan.grid.height);
        let state = || (First::default(), Buffers::default());
        let parts = stream::gather(&tiles, means.threads, state, |(first, buffers), window| {
            scan.cells(window, buffers, |cell| first.see(&cell, self.within_m))
        })?;
        let mut whole = First::default();
        parts.into_iter().for_each(|(part, _)| whole.merge(part));
        Ok(whole)
    }

    fn write_difference(&self, scan: &Scan<'_>, couple: &Couple, means: Means, path: &Path) -> Result<First> {
        const NODATA: f64 = -9999.0;
        let grid = scan.grid;
        let form =
            Form { grid, wkt: couple.b.wkt(), bands: 1, nodata: Some(NODATA), predictor: 3, threads: means.threads };
        let dataset = output::create::<f32>(path, &form)?;
        let sampling = preview::Sampling::of(grid.width, grid.height);
        let parts = output::produce(
            &grid,
            1024,
            means.threads,
            || (First::default(), Buffers::default()),
            |(first, buffers), window| {
                let mut values = vec![NODATA as f32; window.area() as usize];
                scan.cells(window, buffers, |cell| {
                    first.see(&cell, self.within_m);
                    if let Some(number) = sampling.number(cell.x, cell.y) {
                        first.samples.push((number, cell.difference, cell.height as f32));
                    }
                    values[((cell.y - window.y) * window.width + cell.x - window.x) as usize] = cell.difference;
                })?;
                Ok(values)
            },
            |window, values| output::put(path, &dataset, window, &values),
        )?;
        output::finish(path, dataset)?;
        let mut whole = First::default();
        parts.into_iter().for_each(|(part, _)| whole.merge(part));
        Ok(whole)
    }

    fn classes(&self, scan: &Scan<'_>, groups: Groups, means: Means) -> Result<Classes> {
        let tiles = means.tiles(scan.grid.width, scan.grid.height);
        let count = groups.names.len();
        let state = || (vec![Moments::default(); count], Buffers::default());
        let parts = stream::gather(&tiles, means.threads, state, |(moments, buffers), window| {
            scan.cells(window, buffers, |cell| {
                groups.each(&cell, |group| moments[group].add(cell.difference, self.within_m));
            })
        })?;
        let mut moments = vec![Moments::default(); count];
        for (part, _) in &parts {
            moments.iter_mut().zip(part).for_each(|(a, b)| a.merge(b));
        }
        let shares = PERCENTS.map(|p| p / 100.0);
        let quantiles = select::quantiles(count, &shares, means.threads, &tiles, |window, buffers, sink| {
            scan.cells(window, buffers, |cell| groups.each(&cell, |group| sink(group, cell.difference)))
        })?;
        let medians: Vec<f64> = quantiles.iter().map(|q| q[4]).collect();
        let distances = select::quantiles(count, &[0.5], means.threads, &tiles, |window, buffers, sink| {
            scan.cells(window, buffers, |cell| {
                groups.each(&cell, |group| {
                    sink(group, (f64::from(cell.difference) - medians[group]).abs() as f32);
                });
            })
        })?;
        let nmad = distances.iter().map(|d| Some(1.4826 * d[0]).filter(|v| v.is_finite())).collect();
        Ok(Classes { groups, moments, quantiles, nmad })
    }

    fn summary(
        &self,
        couple: &Couple,
        scan: &Scan<'_>,
        first: &First,
        classes: &Classes,
        means: Means,
    ) -> Result<Summary> {
        let stable_group = if scan.zones.is_some() { classes.groups.names.len() - 1 } else { 0 };
        // Where more than half of the cells are equal the NMAD is 0 and says nothing about the others.
        let nmad = classes.nmad[stable_group].filter(|nmad| *nmad > 0.0);
        let scatter = nmad.or_else(|| classes.moments[stable_group].sd()).unwrap_or(0.0);
        let spread = (classes.quantiles[stable_group][4], scatter);
        let variogram = variogram::estimate(scan, spread, means)?;
        let (mx, my) = scan.unit.metres_per_unit(scan.grid.centre().1);
        let cell_m = (scan.grid.step_x.abs() * mx, scan.grid.step_y.abs() * my);
        let mean_error = |n: u64, index: usize| variogram.mean_error(n, &first.places(index), cell_m);
        let volumes = (0..scan.zones.map_or(0, |z| z.names().len()))
            .map(|zone| {
                let moments = &classes.moments[classes.groups.first_zone + zone];
                let (error, effective) = mean_error(moments.n, zone + 1);
                let area = moments.n as f64 * cell_m.0 * cell_m.1;
                let mean = moments.mean().unwrap_or(0.0);
                let (volume, se) = (mean * area, error * area);
                Volume {
                    zone: classes.groups.names[classes.groups.first_zone + zone].1.clone(),
                    n: moments.n,
                    area_m2: area,
                    mean_m: mean,
                    mean_se_m: error,
                    effective_n: effective,
                    volume_m3: volume,
                    volume_se_m3: se,
                    volume_95_m3: [volume - 1.96 * se, volume + 1.96 * se],
                }
            })
            .collect();
        let statistics: Vec<Statistics> =
            (0..classes.groups.names.len()).map(|group| classes.statistics(group)).collect();
        let (mean_se_m, effective_n) = mean_error(classes.moments[0].n, 0);
        let all = &statistics[0];
        Ok(Summary {
            a: self.a.display().to_string(),
            b: self.b.display().to_string(),
            difference: "A - B",
            grid: "B".into(),
            resampling: match self.resampling {
                Interpolation::Nearest => "nearest",
                Interpolation::Bilinear => "bilinear",
                Interpolation::Cubic => "cubic",
            },
            heights: couple.heights.to_string(),
            cells: scan.grid.width * scan.grid.height,
            common_cells: all.n,
            within_m: self.within_m,
            mean_m: all.mean_m,
            median_m: all.median_m,
            sd_m: all.sd_m,
            nmad_m: all.nmad_m,
            rmse_m: all.rmse_m,
            mean_se_m,
            effective_n,
            variogram,
            statistics,
            volumes,
        })
    }
}

impl Classes {
    fn statistics(&self, group: usize) -> Statistics {
        let moments = &self.moments[group];
        let quantiles = &self.quantiles[group];
        let percentiles_m = PERCENTS
            .iter()
            .zip(quantiles)
            .filter(|(_, q)| q.is_finite())
            .map(|(percent, q)| (format!("{percent}"), serde_json::Value::from(*q)))
            .collect();
        Statistics {
            group: self.groups.names[group].0.clone(),
            class: self.groups.names[group].1.clone(),
            n: moments.n,
            mean_m: moments.mean(),
            median_m: Some(quantiles[4]).filter(|q| q.is_finite()),
            sd_m: moments.sd(),
            nmad_m: self.nmad[group],
            rmse_m: moments.rmse(),
            min_m: moments.low.map(f64::from),
            max_m: moments.high.map(f64::from),
            share_within: (moments.n > 0).then(|| moments.within as f64 / moments.n as f64),
            percentiles_m,
        }
    }
}

fn write_tables(folder: &Path, summary: &Summary) -> Result<()> {
    let put = |name: &str, text: String| {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|e| Error::io(&path, "write", e))
    };
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut text = String::from("group,class,n,mean_m,median_m,sd_m,nmad_m,rmse_m,min_m,max_m,share_within");
    PERCENTS.iter().for_each(|p| text.push_str(&format!(",p{p}_m")));
    text.push('\n');
    for s in &summary.statistics {
        let figures = [s.mean_m, s.median_m, s.sd_m, s.nmad_m, s.rmse_m, s.min_m, s.max_m, s.share_within];
        text.push_str(&format!("{},{},{}", s.group, quoted(&s.class), s.n));
        figures.iter().for_each(|v| text.push_str(&format!(",{}", number(*v))));
        for percent in PERCENTS {
            let value = s.percentiles_m.get(&format!("{percent}")).and_then(serde_json::Value::as_f64);
            text.push_str(&format!(",{}", number(value)));
        }
        text.push('\n');
    }
    put("statistics.csv", text)?;
    let mut text =
        String::from("zone,n,area_m2,mean_m,mean_se_m,effective_n,volume_m3,volume_se_m3,low_95_m3,high_95_m3\n");
    for v in &summary.volumes {
        text.push_str(&format!(
            "{},{},{},{},{},{},{},{},{},{}\n",
            quoted(&v.zone),
            v.n,
            v.area_m2,
            v.mean_m,
            v.mean_se_m,
            v.effective_n,
            v.volume_m3,
            v.volume_se_m3,
            v.volume_95_m3[0],
            v.volume_95_m3[1]
        ));
    }
    put("volumes.csv", text)?;
    let mut text = String::from("lag_m,semivariance_m2,pairs,model_m2\n");
    for bin in &summary.variogram.bins {
        let model = summary.variogram.semivariance(bin.lag_m);
        text.push_str(&format!("{},{},{},{}\n", bin.lag_m, bin.semivariance_m2, bin.pairs, model));
    }
    put("variogram.csv", text)?;
    let json = serde_json::to_string_pretty(summary).map_err(|e| Error::usage(e.to_string(), "report this"))?;
    put("summary.json", json + "\n")
}
