//! What the cells of a strip of rows gather, in whole numbers so that no order of points matters.

use std::ops::Range;

use super::plane::Plane;
use super::{Frame, Options, Stat};

/// Steps of one unit in sums of values.
const STEPS: f64 = (1u64 << 32) as f64;
/// Of inverse distances, as shares of the radius: nearer points count no more, so that sums of a billion units of very
/// many points fit. At a power of 2 that is a thirty-millionth of the radius, at 10 a thirtieth.
const MOST_WEIGHT: f64 = 1e15;
/// Steps of one unit in sums of squares: coarser, so that squares of billions fit.
const SQUARE_STEPS: f64 = (1u64 << 20) as f64;

/// Cells whose results are written at a time.
const FINISH_CELLS: usize = 1 << 18;

fn fixed(value: f64) -> i128 {
    (value * STEPS).round() as i128
}

/// Cells of some rows of the grid, for one dimension.
pub(super) struct Strip {
    frame: Frame,
    rows: Range<usize>,
    power: f64,
    count: Vec<u32>,
    sum: Vec<i128>,
    squares: Vec<[i128; 2]>,
    weighted: Vec<[i128; 2]>,
    /// Points at the very centre: their sum and number.
    centred: Vec<(i128, u32)>,
    min: Vec<f64>,
    max: Vec<f64>,
    /// Cells and values, for medians.
    values: Option<Vec<(u32, f64)>>,
    most_values: usize,
}

fn wants(stats: &[(String, Stat)], stat: Stat) -> bool {
    stats.iter().any(|(_, wanted)| *wanted == stat)
}

impl Strip {
    /// Memory of a cell, its results included.
    pub fn cell_bytes(stats: &[(String, Stat)]) -> u64 {
        let each = |(_, stat): &(String, Stat)| match stat {
            Stat::Mean => 16,
            Stat::Deviation => 32,
            Stat::Idw => 64,
            Stat::Min | Stat::Max | Stat::Median => 8,
            Stat::Count => 0,
        };
        4 + stats.iter().map(each).sum::<u64>()
    }

    /// The given rows of a frame, without points; for medians it keeps `most_values` heights at most.
    pub fn new(frame: Frame, rows: Range<usize>, options: &Options, most_values: usize) -> Strip {
        let cells = rows.len() * frame.columns;
        let stats = &options.stats;
        let sized = |wanted: bool| if wanted { cells } else { 0 };
        Strip {
            frame,
            rows,
            power: options.power,
            count: vec![0; cells],
            sum: vec![0; sized(wants(stats, Stat::Mean))],
            squares: vec![[0; 2]; sized(wants(stats, Stat::Deviation))],
            weighted: vec![[0; 2]; sized(wants(stats, Stat::Idw))],
            centred: vec![(0, 0); sized(wants(stats, Stat::Idw))],
            min: vec![f64::INFINITY; sized(wants(stats, Stat::Min))],
            max: vec![f64::NEG_INFINITY; sized(wants(stats, Stat::Max))],
            values: wants(stats, Stat::Median).then(Vec::new),
            most_values,
        }
    }

    /// Gives a point to the cells whose centre is nearer than `radius`.
    ///
    /// # Errors
    /// The memory in bytes that medians would need at least, when they have more values than the strip may hold.
    pub fn add(&mut self, place: [f64; 2], value: f64, radius: f64) -> Result<(), u64> {
        let rows = self.frame.rows_near(place[1], radius);
        let columns = self.frame.columns_near(place[0], radius);
        for row in rows.start.max(self.rows.start)..rows.end.min(self.rows.end) {
            let dy = self.frame.y(row) - place[1];
            for column in columns.clone() {
                let dx = self.frame.x(column) - place[0];
                let distance = (dx * dx + dy * dy).sqrt();
                if distance < radius {
                    self.take((row - self.rows.start) * self.frame.columns + column, value, distance / radius)?;
                }
            }
        }
        Ok(())
    }

    /// `distance` is a share of the radius: weights are then whole steps, whatever the unit and the power.
    fn take(&mut self, cell: usize, value: f64, distance: f64) -> Result<(), u64> {
        self.count[cell] = self.count[cell].saturating_add(1);
        if let Some(sum) = self.sum.get_mut(cell) {
            *sum = sum.saturating_add(fixed(value));
        }
        if let Some([sum, squares]) = self.squares.get_mut(cell) {
            let steps = (value * SQUARE_STEPS).round() as i128;
            *sum = sum.saturating_add(steps);
            *squares = squares.saturating_add(steps.saturating_mul(steps));
        }
        if let Some([values, weights]) = self.weighted.get_mut(cell) {
            if distance > 0.0 {
                // One weight in both sums: what is rounded off would count with the whole value in one of them.
                let steps = fixed(distance.powf(-self.power).min(MOST_WEIGHT));
                *values = values.saturating_add(fixed(value * (steps as f64 / STEPS)));
                *weights = weights.saturating_add(steps);
            } else {
                let (sum, count) = &mut self.centred[cell];
                *sum = sum.saturating_add(fixed(value));
                *count += 1;
            }
        }
        if let Some(min) = self.min.get_mut(cell) {
            *min = min.min(value);
        }
        if let Some(max) = self.max.get_mut(cell) {
            *max = max.max(value);
        }
        if let Some(values) = &mut self.values {
            if values.len() == self.most_values {
                return Err(values.len() as u64 * 32);
            }
            values.push((cell as u32, value));
        }
        Ok(())
    }

    /// Appends the counts, then each statistic, to the planes; NaN where no point is. Some rows at a time, so that
    /// results take no memory beside the cells.
    ///
    /// # Errors
    /// When the scratch disk takes no more rows of a plane.
    pub fn finish(mut self, stats: &[(String, Stat)], planes: &mut [Plane]) -> std::io::Result<()> {
        let medians = self.values.take().map(|values| {
            let mut medians = vec![f64::NAN; self.count.len()];
            fill_medians(values, &mut medians);
            medians
        });
        let piece = self.frame.columns.max(1) * (FINISH_CELLS / self.frame.columns.max(1)).max(1);
        for begin in (0..self.count.len()).step_by(piece) {
            let cells = begin..(begin + piece).min(self.count.len());
            let counts: Vec<f64> = self.count[cells.clone()].iter().map(|&count| f64::from(count)).collect();
            planes[0].append(&counts)?;
            for ((_, stat), plane) in stats.iter().zip(&mut planes[1..]) {
                match stat {
                    Stat::Count => plane.append(&counts)?,
                    Stat::Median => plane.append(&medians.as_ref().expect("medians were asked for")[cells.clone()])?,
                    stat => {
                        let values: Vec<f64> = cells.clone().map(|cell| self.result(*stat, cell)).collect();
                        plane.append(&values)?;
                    }
                }
            }
        }
        Ok(())
    }

    /// A statistic of a cell, medians and counts excepted; NaN where no point is.
    fn result(&self, stat: Stat, cell: usize) -> f64 {
        let count = self.count[cell];
        if count == 0 {
            return f64::NAN;
        }
        match stat {
            Stat::Mean => self.sum[cell] as f64 / STEPS / f64::from(count),
            Stat::Min => self.min[cell],
            Stat::Max => self.max[cell],
            Stat::Deviation => deviation(self.squares[cell], count),
            Stat::Idw => {
                let ([values, weights], (sum, centred)) = (self.weighted[cell], self.centred[cell]);
                if centred > 0 { sum as f64 / STEPS / f64::from(centred) } else { values as f64 / weights as f64 }
            }
            Stat::Count | Stat::Median => f64::NAN,
        }
    }
}

/// √(n Σv² − (Σv)²) / n, in whole numbers as long as they fit; NaN where the squares themselves do not.
fn deviation([sum, squares]: [i128; 2], count: u32) -> f64 {
    if squares == i128::MAX {
        return f64::NAN;
    }
    let n = i128::from(count);
    let spread = match (squares.checked_mul(n), sum.checked_mul(sum)) {
        (Some(all), Some(mean)) => (all - mean) as f64,
        _ => squares as f64 * n as f64 - sum as f64 * sum as f64,
    };
    spread.max(0.0).sqrt() / n as f64 / SQUARE_STEPS
}

fn fill_medians(mut values: Vec<(u32, f64)>, medians: &mut [f64]) {
    values.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    for run in values.chunk_by(|a, b| a.0 == b.0) {
        let middle = run.len() / 2;
        let median = if run.len() % 2 == 1 { run[middle].1 } else { (run[middle - 1].1 + run[middle].1) / 2.0 };
        medians[run[0].0 as usize] = median;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weighted_means_of_times_keep_their_digits() {
        let frame = Frame { columns: 1, rows: 1, west: 0.0, north: 1.0, cell_m: 1.0 };
        let options = Options {
            cell_m: 1.0,
            stats: vec![("idw".into(), Stat::Idw)],
            dimensions: Vec::new(),
            fill_cells: 0,
            power: 1.0,
            manner: super::super::Manner::Snapped,
            noise: super::super::Noise::LeaveOut,
            shift: None,
            camera: None,
            memory_bytes: 0,
            scratch: std::path::PathBuf::new(),
            crs_wkt: None,
        };
        let mut strip = Strip::new(frame, 0..1, &options, 0);
        let time = 1.3e9 + 0.123_456;
        for place in [[0.1, 0.2], [0.37, 0.93], [0.8, 0.41]] {
            strip.add(place, time, 3.0).expect("no medians");
        }
        let found = strip.result(Stat::Idw, 0);
        assert!((found - time).abs() < 1e-6, "{}", found - time);
    }

    #[test]
    fn deviations_of_values_too_large_to_be_squared_are_none() {
        let of = |values: [f64; 2]| {
            let steps = values.map(|value| (value * SQUARE_STEPS).round() as i128);
            let squares = steps.iter().fold(0i128, |sum, step| sum.saturating_add(step.saturating_mul(*step)));
            deviation([steps.iter().sum(), squares], 2)
        };
        assert!((of([1.6e9, 1.6e9 + 2.0]) - 1.0).abs() < 1e-3);
        assert!(of([1.6e15, 1.6e15 + 2e6]).is_nan());
    }
}
