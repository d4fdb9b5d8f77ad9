//! How differences hang together over distance, and what that makes of the error of a mean.
//!
//! The empirical variogram is G. Matheron's, 1963, over pairs of differences on stable ground within three NMAD of the
//! median. Two spherical models are fitted to it. The variance of a mean is the mean covariance over all pairs of its
//! cells (T. Rolstad, T. Haug and B. Denby, *Spatially integrated geodetic glacier mass balance and its uncertainty
//! based on geostatistical analysis*, 2009; R. Hugonnet and others, *Uncertainty analysis of digital elevation models
//! by spatial inference from stable terrain*, 2022), here over a sample of the cells, not over a circle of equal area.

use serde::Serialize;

use crate::error::Result;
use crate::stream::{self, Means};
use crate::window::{TileGrid, Window};

use super::{Buffers, Observed};

/// Column, row and difference of a cell.
type Cell = (i64, i64, f64);

/// One class of distance.
#[derive(Clone, Debug, Serialize)]
pub struct Bin {
    pub lag_m: f64,
    pub semivariance_m2: f64,
    pub pairs: u64,
}

/// The empirical variogram and the sum of two spherical models that was fitted to it.
#[derive(Clone, Debug, Serialize)]
pub struct Variogram {
    pub bins: Vec<Bin>,
    pub sills_m2: [f64; 2],
    pub ranges_m: [f64; 2],
}

fn spherical(h: f64, range: f64) -> f64 {
    if h >= range { 1.0 } else { 1.5 * h / range - 0.5 * (h / range).powi(3) }
}

impl Variogram {
    /// Of the fitted model.
    pub fn semivariance(&self, lag_m: f64) -> f64 {
        (0..2).map(|i| self.sills_m2[i] * spherical(lag_m, self.ranges_m[i])).sum()
    }

    /// The standard error of the mean of `n` cells, of which `places` are a sample, and the number of independent cells
    /// that would have the same. `None` where too few pairs of stable ground tell how differences hang together.
    pub fn mean_error(&self, n: u64, places: &[(u64, u64)], cell_m: (f64, f64)) -> Option<(f64, f64)> {
        let total: f64 = self.sills_m2.iter().sum();
        if self.bins.is_empty() {
            return None;
        }
        if n == 0 || total <= 0.0 {
            return Some((0.0, n as f64));
        }
        let variance: f64 = (0..2)
            .map(|i| {
                let (sill, range) = (self.sills_m2[i], self.ranges_m[i]);
                let area = n as f64 * cell_m.0 * cell_m.1;
                let own = sill / n as f64;
                let others = if range * range * 3.2 < 0.05 * area {
                    near_sum(range, cell_m) / n as f64
                } else {
                    pair_mean(places, range, cell_m)
                };
                own + sill * others
            })
            .sum();
        Some((variance.sqrt(), (total / variance).min(n as f64)))
    }
}

/// Sum of the correlations of a cell with all others around it, where the range is short.
fn near_sum(range: f64, cell_m: (f64, f64)) -> f64 {
    let (across, down) = ((range / cell_m.0) as i64, (range / cell_m.1) as i64);
    if across.max(down) > 400 {
        // The integral of the correlation over the plane.
        return 0.2 * std::f64::consts::PI * range * range / (cell_m.0 * cell_m.1);
    }
    let mut sum = 0.0;
    for y in -down..=down {
        for x in -across..=across {
            if (x, y) != (0, 0) {
                sum += 1.0 - spherical((x as f64 * cell_m.0).hypot(y as f64 * cell_m.1), range);
            }
        }
    }
    sum
}

/// Mean correlation over all pairs of a sample.
fn pair_mean(places: &[(u64, u64)], range: f64, cell_m: (f64, f64)) -> f64 {
    let (mut sum, mut pairs) = (0.0, 0u64);
    for (i, a) in places.iter().enumerate() {
        for b in &places[i + 1..] {
            let (x, y) = (a.0 as f64 - b.0 as f64, a.1 as f64 - b.1 as f64);
            sum += 1.0 - spherical((x * cell_m.0).hypot(y * cell_m.1), range);
            pairs += 1;
        }
    }
    if pairs == 0 { 0.0 } else { sum / pairs as f64 }
}

/// Side of the windows that are looked at for short distances.
const WINDOW_PX: u64 = 48;
/// How many of them, at most, along each axis.
const WINDOWS: u64 = 14;
/// Cells of each window that are paired with those of all others, at least.
const FAR: usize = 12;
/// And of all windows together, where few are to be had.
const FAR_OF_ALL: usize = 2000;
/// Classes of distance for each doubling.
const PER_DOUBLING: f64 = 2.0;
const BINS: usize = 64;

#[derive(Clone)]
struct Pairs {
    sums: [f64; BINS],
    lags: [f64; BINS],
    counts: [u64; BINS],
}

impl Pairs {
    const NONE: Pairs = Pairs { sums: [0.0; BINS], lags: [0.0; BINS], counts: [0; BINS] };

    fn add(&mut self, lag: &Lag, difference: f64) {
        self.sums[lag.bin] += 0.5 * difference * difference;
        self.lags[lag.bin] += lag.metres;
        self.counts[lag.bin] += 1;
    }

    fn merge(&mut self, other: &Pairs) {
        for bin in 0..BINS {
            self.sums[bin] += other.sums[bin];
            self.lags[bin] += other.lags[bin];
            self.counts[bin] += other.counts[bin];
        }
    }
}

/// How far two cells are apart.
#[derive(Clone, Copy)]
struct Lag {
    cells: f64,
    metres: f64,
    bin: usize,
}

impl Lag {
    fn new(columns: f64, rows: f64, cell_m: (f64, f64)) -> Lag {
        let cells = columns.hypot(rows);
        let bin = ((cells.log2() * PER_DOUBLING + 0.5) as usize).min(BINS - 1);
        Lag { cells, metres: (columns * cell_m.0).hypot(rows * cell_m.1), bin }
    }
}

/// Estimates the variogram on the ground outside all zones.
pub(super) fn estimate(observed: &Observed<'_>, (median, nmad): (f64, f64), means: Means) -> Result<Variogram> {
    let grid = &observed.scan.grid;
    let (mx, my) = observed.scan.unit.metres_per_unit(grid.centre().1);
    let cell_m = (grid.step_x.abs() * mx, grid.step_y.abs() * my);
    let size = (WINDOW_PX.min(grid.width), WINDOW_PX.min(grid.height));
    let count = ((grid.width / size.0).clamp(1, WINDOWS), (grid.height / size.1).clamp(1, WINDOWS));
    let place = |index: u64, count: u64, whole: u64, size: u64| {
        if count == 1 { (whole - size) / 2 } else { index * (whole - size) / (count - 1) }
    };
    // Tiles of one cell each: a way to number the windows.
    let numbers = TileGrid::new(count.0, count.1, 1, 1, 0);
    let state = || (Vec::new(), Buffers::default());
    let limit = 3.0 * nmad.max(1e-9);
    // Within a window the same few lags come again and again.
    let window = 0..WINDOW_PX * WINDOW_PX;
    let near: Vec<Lag> = window.map(|at| Lag::new((at % WINDOW_PX) as f64, (at / WINDOW_PX) as f64, cell_m)).collect();
    let parts = stream::gather(&numbers, means.threads, state, |(found, buffers), number| {
        let (x, y) = (place(number.x, count.0, grid.width, size.0), place(number.y, count.1, grid.height, size.1));
        let mut cells: Vec<Cell> = Vec::new();
        observed.cells(Window::new(x, y, size.0, size.1), buffers, |cell| {
            let value = f64::from(cell.difference) - median;
            if cell.zones.is_empty() && value.abs() <= limit {
                cells.push((cell.x as i64, cell.y as i64, value));
            }
        })?;
        let mut within = Pairs::NONE;
        // A part of the cells with all others of their window.
        let step = (cells.len() / 160).max(1);
        for (i, a) in cells.iter().enumerate().step_by(step) {
            for (j, b) in cells.iter().enumerate() {
                if i != j {
                    let at = (a.1 - b.1).unsigned_abs() * WINDOW_PX + (a.0 - b.0).unsigned_abs();
                    within.add(&near[at as usize], a.2 - b.2);
                }
            }
        }
        let wanted = FAR.max(FAR_OF_ALL / (count.0 * count.1) as usize);
        let base = cells.len().div_ceil(step);
        let step = (cells.len() / wanted).max(1);
        let few = cells.into_iter().step_by(step).take(wanted).collect();
        found.push((number.y * count.0 + number.x, within, base, few));
        Ok(())
    })?;
    let mut windows: Vec<(u64, Pairs, usize, Vec<Cell>)> = parts.into_iter().flat_map(|(found, _)| found).collect();
    windows.sort_by_key(|(number, ..)| *number);
    let mut pairs = Pairs::NONE;
    let (mut base, mut far) = (0, Vec::new());
    for (_, within, cells, few) in windows {
        pairs.merge(&within);
        base += cells;
        far.extend(few);
    }
    let mut shares = vec![[0u32; BINS]; far.len()];
    for (i, a) in far.iter().enumerate() {
        for (j, b) in far.iter().enumerate().skip(i + 1) {
            let lag = Lag::new((a.0 - b.0) as f64, (a.1 - b.1) as f64, cell_m);
            if lag.cells > WINDOW_PX as f64 {
                pairs.add(&lag, a.2 - b.2);
                shares[i][lag.bin] += 1;
                shares[j][lag.bin] += 1;
            }
        }
    }
    let reach = (grid.width as f64 * cell_m.0).hypot(grid.height as f64 * cell_m.1) / 2.0;
    // Pairs share their cells: a class rests on as many values as its cells that take an equal part (near, the cells
    // that are paired with all of their window count fourfold, since they meet all others).
    let values = |bin: usize| {
        let parts = shares.iter().map(|of_cell| f64::from(of_cell[bin]));
        let (sum, squares) = parts.fold((0.0, 0.0), |(sum, squares), part| (sum + part, squares + part * part));
        if squares > 0.0 { sum * sum / squares } else { 4.0 * base as f64 }
    };
    let (bins, values): (Vec<Bin>, Vec<f64>) = (0..BINS)
        .filter(|&i| pairs.counts[i] >= 50)
        .map(|i| {
            let n = pairs.counts[i];
            let (lag_m, semivariance_m2) = (pairs.lags[i] / n as f64, pairs.sums[i] / n as f64);
            (Bin { lag_m, semivariance_m2, pairs: n }, values(i).min(n as f64))
        })
        .filter(|(bin, _)| bin.lag_m <= reach)
        .unzip();
    Ok(fit(bins, &values, cell_m.0.min(cell_m.1)))
}

/// Two models are believed when they fit so much better than one, in squared standard deviations of the classes: by
/// chance the best of all pairs of ranges is better by some of them.
const BELIEVED: f64 = 16.0;

/// One spherical model, or two where the classes tell, by weighted least squares, sills not negative, over all pairs of
/// ranges of a ladder. `values` says how many independent values each class rests on.
fn fit(bins: Vec<Bin>, values: &[f64], cell_m: f64) -> Variogram {
    let longest = bins.iter().map(|b| b.lag_m).fold(cell_m, f64::max);
    let mut ranges = vec![cell_m * 0.999];
    while ranges[ranges.len() - 1] < longest {
        ranges.push(ranges[ranges.len() - 1] * 1.25);
    }
    let mut best = [(f64::INFINITY, [0.0; 2], [cell_m; 2]); 2];
    for (i, &short) in ranges.iter().enumerate() {
        for &long in &ranges[i + 1..] {
            let (mut m, mut r) = ([[0.0; 2]; 2], [0.0; 2]);
            for bin in &bins {
                let weight = 1.0 / bin.lag_m.sqrt();
                let f = [spherical(bin.lag_m, short), spherical(bin.lag_m, long)];
                for a in 0..2 {
                    r[a] += weight * f[a] * bin.semivariance_m2;
                    for b in 0..2 {
                        m[a][b] += weight * f[a] * f[b];
                    }
                }
            }
            let determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
            let both =
                [(r[0] * m[1][1] - r[1] * m[0][1]) / determinant, (r[1] * m[0][0] - r[0] * m[1][0]) / determinant];
            for sills in [both, [r[0] / m[0][0], 0.0], [0.0, r[1] / m[1][1]]] {
                if !sills.iter().all(|s| s.is_finite() && *s >= 0.0) {
                    continue;
                }
                let misfit: f64 = bins
                    .iter()
                    .map(|bin| {
                        let model = sills[0] * spherical(bin.lag_m, short) + sills[1] * spherical(bin.lag_m, long);
                        (model - bin.semivariance_m2).powi(2) / bin.lag_m.sqrt()
                    })
                    .sum();
                let of_kind = &mut best[usize::from(sills.iter().all(|s| *s > 0.0))];
                if misfit < of_kind.0 * (1.0 - 1e-9) {
                    *of_kind = (misfit, sills, [short, long]);
                }
            }
        }
    }
    // A class's mean of squares is known as well as its different values allow.
    let chi2 = |&(_, sills, ranges): &(f64, [f64; 2], [f64; 2])| -> f64 {
        let terms = bins.iter().zip(values).map(|(bin, independent)| {
            let model: f64 = (0..2).map(|i| sills[i] * spherical(bin.lag_m, ranges[i])).sum();
            (model - bin.semivariance_m2).powi(2) * independent / (2.0 * model.max(f64::MIN_POSITIVE).powi(2))
        });
        terms.sum()
    };
    let [one, two] = best;
    let (_, sills_m2, ranges_m) = if two.0 < one.0 && chi2(&one) - chi2(&two) > BELIEVED { two } else { one };
    Variogram { bins, sills_m2, ranges_m }
}
