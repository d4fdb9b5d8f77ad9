//! One model minus another: statistics by class and zone, volumes, and how sure they are.

mod density;
mod extent;
mod groups;
mod lags;
mod moments;
mod observed;
mod page;
mod preview;
mod scan;
mod select;
mod summary;
mod tables;
mod variogram;

pub use page::write_page;
pub use summary::{Statistics, Summary, Volume};
pub use variogram::Variogram;

use std::collections::BinaryHeap;
use std::path::Path;

use autoref_raster::random::mix;
use autoref_raster::ranks::upper_median;

use crate::couple::{Couple, open_couple};
use crate::error::{Error, Result};
use crate::files::{Resources, SMALLEST_BUDGET_BYTES, read_zones};
use crate::kept::Room;
use crate::output::{self, Cut, Form};
use crate::resample::Interpolation;
use crate::source::Heights;
use crate::stream::{self, Means};
use crate::zeros::Zeros;

use extent::Extent;
use groups::Groups;
use moments::{Moments, Term};
use observed::{Observed, Record, Recorder};
use scan::{Buffers, Cell, OnGrid, Scan};
use select::{Distribution, Pass, Question};
use summary::PERCENTS;
use tables::write_tables;

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

/// Cells of a zone that stand for it in sums over pairs.
const WITNESSES: usize = 1000;

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
    zeros: Zeros,
}

impl First {
    fn see(&mut self, cell: &Cell<'_>, within_m: f64) {
        self.moments.add(&Term::of(cell.difference, within_m));
        let z = f64::from(cell.height);
        self.heights = Some(self.heights.map_or((z, z), |(low, high)| (low.min(z), high.max(z))));
        // Where A is 0 the difference is B's height, to the last bit.
        self.zeros.see(f64::from(cell.difference + cell.height), z);
        let key = (hash(cell.x, cell.y), cell.x, cell.y);
        Self::keep(&mut self.witnesses, 0, key);
        for zone in cell.zones {
            Self::keep(&mut self.witnesses, *zone as usize + 1, key);
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
        self.zeros.merge(other.zeros);
        self.heights = match (self.heights, other.heights) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (a, b) => a.or(b),
        };
        for (index, heap) in other.witnesses.into_iter().enumerate() {
            heap.into_iter().for_each(|key| Self::keep(&mut self.witnesses, index, key));
        }
    }

    /// A value near the median: that of the cells of the map.
    fn centre(&self) -> f32 {
        let mut differences: Vec<f32> = self.samples.iter().map(|sample| sample.1).collect();
        upper_median(&mut differences).unwrap_or(0.0)
    }

    fn places(&self, index: usize) -> Vec<(u64, u64)> {
        let keys = self.witnesses.get(index).map(|heap| heap.clone().into_sorted_vec()).unwrap_or_default();
        keys.into_iter().map(|(_, x, y)| (x, y)).collect()
    }
}

/// What a worker counts.
struct Counts {
    moments: Vec<Moments>,
    extents: Vec<Extent>,
}

/// Groups, their moments, how they are spread.
struct Classes {
    groups: Groups,
    moments: Vec<Moments>,
    distributions: Vec<Distribution>,
    /// By zone, where the size of cells changes from row to row.
    extents: Option<Vec<Extent>>,
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
        let zones = self.zones.map(|path| read_zones(path, couple.b.wkt(), couple.b.grid().bounds())).transpose()?;
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
        let room = Room { held_cells: self.resources.kept_cells(), scratch: Some(folder) };
        let mut scan = Scan {
            grid,
            unit: couple.b.ground_unit(),
            a: OnGrid::new(&couple.a, grid, self.resampling),
            b: &couple.b,
            zones: zones.as_ref(),
            slope_limits: self.slope_limits,
            limits: (f64::NEG_INFINITY, f64::INFINITY),
        };
        if let Some(limit) = self.outliers {
            let moments = self.first(&scan, means)?.moments;
            let (mean, sd) = moments.mean().zip(moments.sd()).ok_or_else(nothing)?;
            scan.limits = (mean - limit * sd, mean + limit * sd);
        }
        let recorder = Recorder::new(&scan, &room);
        let first = self.write_difference(&scan, &recorder, &couple, means, &folder.join("difference.tif"))?;
        let observed = recorder.finish(&scan);
        let heights = first.heights.ok_or_else(nothing)?;
        let groups = Groups::new(self.slope_limits, heights, zones.as_ref());
        let classes = self.classes(&observed, groups, first.centre(), means)?;
        let summary = self.summary(&couple, &observed, &first, &classes, means)?;
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

    fn write_difference(
        &self,
        scan: &Scan<'_>,
        recorder: &Recorder,
        couple: &Couple,
        means: Means,
        path: &Path,
    ) -> Result<First> {
        const NODATA: f64 = -9999.0;
        let grid = scan.grid;
        let wkt = autoref_raster::crs::without_heights(self.b, couple.b.wkt())?;
        let form = Form { grid, wkt: &wkt, bands: 1, nodata: Some(NODATA), predictor: 3, threads: means.threads };
        let dataset = output::create::<f32>(path, &form)?;
        autoref_raster::set_height_unit(path, &dataset, "m")?;
        let sampling = preview::Sampling::of(grid.width, grid.height);
        let parts = output::produce(
            &grid,
            Cut::of_one_band(1024),
            means.threads,
            || (First::default(), Buffers::default()),
            |(first, buffers), window| {
                let cells = window.area() as usize;
                let mut values = vec![NODATA as f32; cells];
                let mut records = vec![Record::NONE; if recorder.keeps() { cells } else { 0 }];
                scan.cells(window, buffers, |cell| {
                    first.see(&cell, self.within_m);
                    if let Some(number) = sampling.number(cell.x, cell.y) {
                        first.samples.push((number, cell.difference, cell.height));
                    }
                    let at = ((cell.y - window.y) * window.width + cell.x - window.x) as usize;
                    values[at] = cell.difference;
                    if let Some(record) = records.get_mut(at) {
                        *record = Record::of(&cell);
                    }
                })?;
                recorder.put(window, &records);
                Ok(values)
            },
            |window, values| output::put(path, &dataset, window, values),
        )?;
        output::finish(path, dataset)?;
        let mut whole = First::default();
        parts.into_iter().for_each(|(part, _)| whole.merge(part));
        Ok(whole)
    }

    fn classes(&self, observed: &Observed<'_>, groups: Groups, centre: f32, means: Means) -> Result<Classes> {
        let grid = &observed.scan.grid;
        let tiles = means.tiles(grid.width, grid.height);
        let count = groups.names.len();
        let varies = observed.scan.unit.varies();
        let zones = observed.scan.zones.filter(|_| varies).map_or(0, |zones| zones.names().len());
        let state = || Counts { moments: vec![Moments::default(); count], extents: vec![Extent::default(); zones] };
        let state = || (state(), Buffers::default());
        let visit = |pass, window, (counts, buffers): &mut (Counts, Buffers), sink: select::Sink<'_>| {
            let Counts { moments, extents } = counts;
            let (mut of_row, mut cell_m2, mut own) = (u64::MAX, 0.0, Vec::new());
            observed.cells(window, buffers, |cell| {
                if pass == Pass::First && zones > 0 && !cell.zones.is_empty() {
                    if cell.y != of_row {
                        (of_row, cell_m2) = (cell.y, observed.scan.cell_m2(cell.y));
                    }
                    cell.zones.iter().for_each(|zone| extents[*zone as usize].add(cell.difference, cell_m2));
                }
                groups.list(&cell, &mut own);
                if pass == Pass::First {
                    let term = Term::of(cell.difference, self.within_m);
                    own.iter().for_each(|&group| moments[group].add(&term));
                }
                sink(&own, cell.difference);
            })
        };
        let question = Question { groups: count, shares: &PERCENTS.map(|p| p / 100.0), centre };
        let (distributions, parts) = select::distributions(&question, means.threads, &tiles, state, visit)?;
        let mut whole = state().0;
        for (part, _) in &parts {
            whole.moments.iter_mut().zip(&part.moments).for_each(|(a, b)| a.merge(b));
            whole.extents.iter_mut().zip(&part.extents).for_each(|(a, b)| a.merge(b));
        }
        let Counts { moments, extents } = whole;
        Ok(Classes { groups, moments, distributions, extents: varies.then_some(extents) })
    }

    fn summary(
        &self,
        couple: &Couple,
        observed: &Observed<'_>,
        first: &First,
        classes: &Classes,
        means: Means,
    ) -> Result<Summary> {
        let scan = observed.scan;
        let stable_group = if scan.zones.is_some() { classes.groups.names.len() - 1 } else { 0 };
        // Where more than half of the cells are equal the NMAD is 0 and says nothing about the others.
        let nmad = classes.nmad(stable_group).filter(|nmad| *nmad > 0.0);
        let scatter = nmad.or_else(|| classes.moments[stable_group].sd()).unwrap_or(0.0);
        let spread = (classes.distributions[stable_group].median, scatter);
        let (mx, my) = scan.unit.metres_per_unit(scan.grid.centre().1);
        let cell_m = (scan.grid.step_x.abs() * mx, scan.grid.step_y.abs() * my);
        let variogram = variogram::fit(lags::classes(observed, cell_m, spread, means)?, cell_m.0.min(cell_m.1));
        let mean_error = |n: u64, zone: Option<u32>| {
            let places = first.places(zone.map_or(0, |zone| zone as usize + 1));
            variogram.mean_error(n, &places, cell_m, || density::share_beside(observed, &places, zone))
        };
        let zone_areas_m2 = scan.zones.map_or_else(Vec::new, |zones| zones.areas_m2(&scan.unit));
        let volumes = zone_areas_m2.into_iter().enumerate();
        let volumes = volumes.map(|(zone, zone_area_m2)| {
            let n = classes.moments[classes.groups.first_zone + zone].n;
            Ok(classes.volume(zone, zone_area_m2, cell_m, mean_error(n, Some(zone as u32))?))
        });
        let volumes: Vec<Volume> = volumes.collect::<Result<_>>()?;
        let empty = volumes.iter().filter(|v| v.n == 0);
        let empty = crate::turns::notes_of_empty(empty.map(|v| (v.zone.clone(), v.zone_area_m2 > 0.0)));
        let statistics: Vec<Statistics> =
            (0..classes.groups.names.len()).map(|group| classes.statistics(group)).collect();
        let (mean_se_m, effective_n) = mean_error(classes.moments[0].n, None)?.unzip();
        let all = &statistics[0];
        Ok(Summary {
            a: self.a.display().to_string(),
            b: self.b.display().to_string(),
            difference: "A - B",
            grid: "B".into(),
            resampling: scan.a.way(self.resampling),
            heights: couple.heights.to_string(),
            warnings: [couple.doubtful_units.clone(), first.zeros.notes(all.n, self.a, self.b), empty].concat(),
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
    /// The volume between the models over a zone; `error` is the standard error of its mean with the effective number
    /// of cells.
    fn volume(&self, zone: usize, zone_area_m2: f64, cell_m: (f64, f64), error: Option<(f64, f64)>) -> Volume {
        let group = self.groups.first_zone + zone;
        let moments = &self.moments[group];
        let (area_m2, volume) = match &self.extents {
            Some(extents) => (extents[zone].area_m2(), extents[zone].volume_m3()),
            None => {
                let area = moments.n as f64 * cell_m.0 * cell_m.1;
                (area, moments.mean().unwrap_or(0.0) * area)
            }
        };
        // A zone without a cell has not stayed as it was: nothing is known of it.
        let known = |value: f64| (moments.n > 0).then_some(value);
        Volume {
            zone: self.groups.names[group].1.clone(),
            n: moments.n,
            area_m2,
            mean_m: known(volume / area_m2),
            mean_se_m: error.and_then(|(se_m, _)| known(se_m)),
            effective_n: error.map(|(_, effective_n)| effective_n),
            volume_m3: known(volume),
            volume_se_m3: error.and_then(|(se_m, _)| known(se_m * area_m2)),
            volume_95_m3: error.filter(|_| moments.n > 0).map(|(se_m, _)| {
                let reach = 1.96 * se_m * area_m2;
                [volume - reach, volume + reach]
            }),
            zone_area_m2,
            // Cells count as a whole.
            covered_share: (zone_area_m2 > 0.0).then(|| (area_m2 / zone_area_m2).min(1.0)),
        }
    }

    fn nmad(&self, group: usize) -> Option<f64> {
        Some(1.4826 * self.distributions[group].median_distance).filter(|v| v.is_finite())
    }

    fn statistics(&self, group: usize) -> Statistics {
        let moments = &self.moments[group];
        let Distribution { quantiles, median, .. } = &self.distributions[group];
        // No difference has no sign.
        let unsigned = |value: f32| f64::from(value) + 0.0;
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
            median_m: Some(*median + 0.0).filter(|q| q.is_finite()),
            sd_m: moments.sd(),
            nmad_m: self.nmad(group),
            rmse_m: moments.rmse(),
            min_m: moments.low.map(unsigned),
            max_m: moments.high.map(unsigned),
            share_within: (moments.n > 0).then(|| moments.within as f64 / moments.n as f64),
            percentiles_m,
        }
    }
}
