//! Differences of cells by how far they are apart: the classes of the empirical variogram.
//!
//! Windows are spread over the stable ground. Within a window a part of the cells is paired with all others of it.
//! Between windows γ = E\[v²\] − E\[v v′\]: the mean square of all cells, so that rough and smooth ground side by side
//! are not taken for a correlation, less the mean product of the cells of a sample; of windows far from each other of
//! all their cells, which is the product of the means.

use super::observed::Observed;
use super::scan::Buffers;
use super::variogram::{Bin, LagClasses};
use crate::error::Result;
use crate::stream::{self, Means};
use crate::window::{TileGrid, Window};

/// Column, row and difference of a cell.
type Cell = (i64, i64, f64);

/// Side of the windows that are looked at.
const WINDOW_PX: u64 = 48;
/// How many of them, at most, along each axis.
const WINDOWS: u64 = 14;
/// Cells of each window that are paired with all others of it, about.
const BASE: usize = 160;
/// Cells of each window that are paired with those of others, at least.
const FAR: usize = 12;
/// And of all windows together, where few are to be had.
const FAR_OF_ALL: usize = 2000;
/// Windows whose middles are farther apart than this have one distance.
const ONE_DISTANCE_PX: f64 = 4.0 * WINDOW_PX as f64;
/// Classes of distance for each doubling.
const PER_DOUBLING: f64 = 2.0;
const BINS: usize = 64;
/// Fewer pairs are no class.
const FEWEST_PAIRS: f64 = 50.0;

/// Sums over pairs, class by class.
#[derive(Clone)]
struct Pairs {
    /// Of half the squared differences of `differing` pairs.
    squares: [f64; BINS],
    differing: [f64; BINS],
    /// Of the products of `multiplied` pairs.
    products: [f64; BINS],
    multiplied: [f64; BINS],
    /// Of the distances of both.
    lags: [f64; BINS],
    /// How many there are, whatever they weigh.
    pairs: [f64; BINS],
}

impl Pairs {
    const NONE: Pairs = Pairs {
        squares: [0.0; BINS],
        differing: [0.0; BINS],
        products: [0.0; BINS],
        multiplied: [0.0; BINS],
        lags: [0.0; BINS],
        pairs: [0.0; BINS],
    };

    /// So many pairs, and the sum of their squared differences.
    fn add_differences(&mut self, lag: &Lag, (count, squares): (f64, f64), weight: f64) {
        self.squares[lag.bin] += weight * 0.5 * squares;
        self.differing[lag.bin] += weight * count;
        self.lags[lag.bin] += weight * count * lag.metres;
        self.pairs[lag.bin] += count;
    }

    fn add_products(&mut self, lag: &Lag, mean: f64, count: f64) {
        self.products[lag.bin] += count * mean;
        self.multiplied[lag.bin] += count;
        self.lags[lag.bin] += count * lag.metres;
        self.pairs[lag.bin] += count;
    }

    fn merge(&mut self, other: &Pairs) {
        for bin in 0..BINS {
            self.squares[bin] += other.squares[bin];
            self.differing[bin] += other.differing[bin];
            self.products[bin] += other.products[bin];
            self.multiplied[bin] += other.multiplied[bin];
            self.lags[bin] += other.lags[bin];
            self.pairs[bin] += other.pairs[bin];
        }
    }

    fn count(&self, bin: usize) -> f64 {
        self.differing[bin] + self.multiplied[bin]
    }

    /// Of a class, with the mean square of all cells; without the pairs of `other`.
    fn semivariance_without(&self, other: &Pairs, bin: usize, square: f64) -> f64 {
        let multiplied = self.multiplied[bin] - other.multiplied[bin];
        let squares = self.squares[bin] - other.squares[bin];
        let products = self.products[bin] - other.products[bin];
        (squares + multiplied * square - products) / (self.count(bin) - other.count(bin))
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

/// What one window tells.
struct Part {
    number: u64,
    within: Pairs,
    /// Cells that are paired with all others of the window.
    base: usize,
    sample: Vec<Cell>,
    /// Of all cells: how many, their mean and the sum of their squares.
    count: f64,
    mean: f64,
    squares: f64,
    /// Column and row.
    middle: (f64, f64),
}

const SIDE: usize = WINDOW_PX as usize;
/// Columns by which two cells of a window are apart, to either side.
const ACROSS: usize = 2 * SIDE - 1;

/// Pairs within a window by the columns and rows that they are apart: rows of cells at a time, without asking which
/// class a pair belongs to.
struct Apart {
    origin: (i64, i64),
    /// Row by row; 0 where there is none.
    values: Vec<f64>,
    /// 1 where there is a cell, else 0.
    there: Vec<f64>,
    /// For each number of rows, from the most columns to the left on.
    squares: Vec<f64>,
    counts: Vec<f64>,
}

impl Apart {
    fn new(window: Window, cells: &[Cell]) -> Apart {
        let origin = (window.x as i64, window.y as i64);
        let (mut values, mut there) = (vec![0.0; SIDE * SIDE], vec![0.0; SIDE * SIDE]);
        for &(x, y, value) in cells {
            let at = (y - origin.1) as usize * SIDE + (x - origin.0) as usize;
            (values[at], there[at]) = (value, 1.0);
        }
        Apart { origin, values, there, squares: vec![0.0; SIDE * ACROSS], counts: vec![0.0; SIDE * ACROSS] }
    }

    /// Pairs a cell with all of the window.
    fn pair(&mut self, &(x, y, value): &Cell) {
        let (column, row) = ((x - self.origin.0) as usize, (y - self.origin.1) as usize);
        let rows = self.values.chunks_exact(SIDE).zip(self.there.chunks_exact(SIDE));
        for (other, (values, there)) in rows.enumerate() {
            let from = other.abs_diff(row) * ACROSS + SIDE - 1 - column;
            let sums = self.squares[from..][..SIDE].iter_mut().zip(&mut self.counts[from..][..SIDE]);
            for ((square, count), (other, there)) in sums.zip(values.iter().zip(there)) {
                let difference = other - value;
                *square += there * difference * difference;
                *count += there;
            }
        }
    }

    /// Adds the pairs to the classes of `near`; a cell is no pair with itself.
    fn join(&self, near: &[Lag], weight: f64, into: &mut Pairs) {
        for rows in 0..SIDE {
            for across in (0..ACROSS).filter(|&across| rows > 0 || across != SIDE - 1) {
                let (at, columns) = (rows * ACROSS + across, across.abs_diff(SIDE - 1));
                if self.counts[at] > 0.0 {
                    into.add_differences(&near[rows * SIDE + columns], (self.counts[at], self.squares[at]), weight);
                }
            }
        }
    }
}

/// How the windows lie in the grid.
struct Layout {
    count: (u64, u64),
    size: (u64, u64),
    whole: (u64, u64),
    /// Of cells of one window, by rows and columns that they are apart: the same few come again and again.
    near: Vec<Lag>,
    /// Cells of each window's sample.
    wanted: usize,
}

impl Layout {
    fn new(whole: (u64, u64), cell_m: (f64, f64)) -> Layout {
        let size = (WINDOW_PX.min(whole.0), WINDOW_PX.min(whole.1));
        let count = ((whole.0 / size.0).clamp(1, WINDOWS), (whole.1 / size.1).clamp(1, WINDOWS));
        let window = 0..WINDOW_PX * WINDOW_PX;
        let near = window.map(|at| Lag::new((at % WINDOW_PX) as f64, (at / WINDOW_PX) as f64, cell_m)).collect();
        let wanted = FAR.max(FAR_OF_ALL / (count.0 * count.1) as usize);
        Layout { count, size, whole, near, wanted }
    }

    fn window(&self, number: Window) -> Window {
        let place = |index: u64, count: u64, whole: u64, size: u64| {
            if count == 1 { (whole - size) / 2 } else { index * (whole - size) / (count - 1) }
        };
        let x = place(number.x, self.count.0, self.whole.0, self.size.0);
        let y = place(number.y, self.count.1, self.whole.1, self.size.1);
        Window::new(x, y, self.size.0, self.size.1)
    }

    fn part(&self, number: u64, window: Window, cells: Vec<Cell>) -> Part {
        let mut within = Pairs::NONE;
        // Each window weighs as much as it has cells, as in the mean square of all.
        let step = (cells.len() / BASE).max(1);
        let base = cells.len().div_ceil(step);
        let weight = BASE as f64 / base.max(1) as f64;
        let mut apart = Apart::new(window, &cells);
        cells.iter().step_by(step).for_each(|cell| apart.pair(cell));
        apart.join(&self.near, weight, &mut within);
        let count = cells.len() as f64;
        let (sum, squares) = cells.iter().fold((0.0, 0.0), |(s, q), cell| (s + cell.2, q + cell.2 * cell.2));
        let mean = sum / count.max(1.0);
        let middle = (window.x as f64 + window.width as f64 / 2.0, window.y as f64 + window.height as f64 / 2.0);
        let step = (cells.len() / self.wanted).max(1);
        let sample = cells.into_iter().step_by(step).take(self.wanted).collect();
        Part { number, within, base, sample, count, mean, squares, middle }
    }
}

/// Gathers the classes on the ground outside all zones, and within three NMAD of the median.
pub(super) fn classes(
    observed: &Observed<'_>,
    cell_m: (f64, f64),
    (median, nmad): (f64, f64),
    means: Means,
) -> Result<LagClasses> {
    let grid = &observed.scan.grid;
    let layout = Layout::new((grid.width, grid.height), cell_m);
    // Tiles of one cell each: a way to number the windows.
    let numbers = TileGrid::new(layout.count.0, layout.count.1, 1, 1, 0);
    let state = || (Vec::new(), Buffers::default());
    let limit = 3.0 * nmad.max(1e-9);
    let found = stream::gather(&numbers, means.threads, state, |(found, buffers), number| {
        let window = layout.window(number);
        let mut cells: Vec<Cell> = Vec::new();
        observed.cells(window, buffers, |cell| {
            let value = f64::from(cell.difference) - median;
            if cell.zones.is_empty() && value.abs() <= limit {
                cells.push((cell.x as i64, cell.y as i64, value));
            }
        })?;
        found.push(layout.part(number.y * layout.count.0 + number.x, window, cells));
        Ok(())
    })?;
    let mut parts: Vec<Part> = found.into_iter().flat_map(|(found, _)| found).filter(|part| part.count > 0.0).collect();
    parts.sort_by_key(|part| part.number);
    let reach_m = (grid.width as f64 * cell_m.0).hypot(grid.height as f64 * cell_m.1) / 2.0;
    Ok(join(&parts, cell_m, reach_m))
}

/// The classes of all windows' cells, up to a distance.
fn join(parts: &[Part], cell_m: (f64, f64), reach_m: f64) -> LagClasses {
    // What each window has a part in.
    let mut own: Vec<Pairs> = parts.iter().map(|part| part.within.clone()).collect();
    let mut all = Pairs::NONE;
    own.iter().for_each(|within| all.merge(within));
    // How often each cell of the samples takes part, and all cells of each window.
    let mut cell_parts: Vec<Vec<[u32; BINS]>> = parts.iter().map(|part| vec![[0; BINS]; part.sample.len()]).collect();
    let mut window_parts = vec![[0.0f64; BINS]; parts.len()];
    for (i, a) in parts.iter().enumerate() {
        for (j, b) in parts.iter().enumerate().skip(i) {
            let middles = Lag::new(a.middle.0 - b.middle.0, a.middle.1 - b.middle.1, cell_m);
            let mut between = Pairs::NONE;
            if i != j && middles.cells > ONE_DISTANCE_PX {
                between.add_products(&middles, a.mean * b.mean, a.count * b.count);
                window_parts[i][middles.bin] += b.count;
                window_parts[j][middles.bin] += a.count;
            } else {
                for (k, one) in a.sample.iter().enumerate() {
                    let from = if i == j { k + 1 } else { 0 };
                    for (l, other) in b.sample.iter().enumerate().skip(from) {
                        let lag = Lag::new((one.0 - other.0) as f64, (one.1 - other.1) as f64, cell_m);
                        if lag.cells > WINDOW_PX as f64 {
                            between.add_products(&lag, one.2 * other.2, 1.0);
                            cell_parts[i][k][lag.bin] += 1;
                            cell_parts[j][l][lag.bin] += 1;
                        }
                    }
                }
            }
            all.merge(&between);
            own[i].merge(&between);
            if i != j {
                own[j].merge(&between);
            }
        }
    }
    // Pairs share their cells: a class rests on as many values as its cells that take an equal part (near, the cells
    // that are paired with all of their window count fourfold, since they meet all others).
    let base: usize = parts.iter().map(|part| part.base).sum();
    let values = |bin: usize| {
        let samples = cell_parts.iter().flatten().map(|of_cell| (1.0, f64::from(of_cell[bin])));
        let windows = parts.iter().zip(&window_parts).map(|(part, of_window)| (part.count, of_window[bin]));
        let (sum, squares) = samples
            .chain(windows)
            .fold((0.0, 0.0), |(sum, squares), (n, part)| (sum + n * part, squares + n * part * part));
        if squares > 0.0 { sum * sum / squares } else { 4.0 * base as f64 }
    };
    let kept: Vec<usize> =
        (0..BINS).filter(|&i| all.pairs[i] >= FEWEST_PAIRS && all.lags[i] / all.count(i) <= reach_m).collect();
    let (count, squares) = parts.iter().fold((0.0, 0.0), |(n, sum), part| (n + part.count, sum + part.squares));
    let bin = |&i: &usize| Bin {
        lag_m: all.lags[i] / all.count(i),
        semivariance_m2: all.semivariance_without(&Pairs::NONE, i, squares / count),
        pairs: all.pairs[i] as u64,
    };
    let left_out = |(own, part): (&Pairs, &Part)| {
        let square = (squares - part.squares) / (count - part.count);
        // A class of one window alone cannot do without it.
        let out = |i: usize| if all.count(i) - own.count(i) >= 1.0 { own } else { &Pairs::NONE };
        kept.iter().map(|&i| all.semivariance_without(out(i), i, square)).collect()
    };
    LagClasses {
        bins: kept.iter().map(bin).collect(),
        values: kept.iter().map(|&i| values(i).min(all.pairs[i])).collect(),
        without: own.iter().zip(parts).map(left_out).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::super::variogram::{self, Variogram};
    use super::*;
    use autoref_raster::random::{SplitMix64, mix};

    /// Differences without any correlation, rough in some windows and smooth in others, and the whole window off by
    /// `lean` of the roughness.
    fn fitted(seed: u64, lean: f64, rough_cells: usize) -> Variogram {
        let whole = (2000, 1600);
        let cell_m = (10.0, 10.0);
        let layout = Layout::new(whole, cell_m);
        let mut random = SplitMix64(seed);
        let mut normal = move || (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
        let mut parts = Vec::new();
        for number in 0..layout.count.0 * layout.count.1 {
            let (x, y) = (number % layout.count.0, number / layout.count.0);
            let window = layout.window(Window::new(x, y, 1, 1));
            let rough = if number % 3 == 0 { 6.0 } else { 1.0 };
            let off = lean * normal();
            let mut cells = Vec::new();
            for row in window.y..window.bottom() {
                cells.extend(
                    (window.x..window.x + window.width).map(|x| (x as i64, row as i64, rough * normal() + off)),
                );
            }
            // Rough ground may have few cells.
            let share = if number % 3 == 0 { rough_cells as f64 / cells.len() as f64 } else { 1.0 };
            let kept = |cell: &Cell| mix(seed ^ (cell.0 << 32 | cell.1) as u64) as f64 <= share * u64::MAX as f64;
            parts.push(layout.part(number, window, cells.into_iter().filter(kept).collect()));
        }
        variogram::fit(join(&parts, cell_m, 20_000.0), 10.0)
    }

    #[test]
    fn rough_and_smooth_ground_side_by_side_are_no_correlation() {
        for (seed, rough_cells) in [(0, 2304), (1, 2304), (2, 2304), (3, 69), (4, 69), (5, 300)] {
            let found = fitted(seed, 0.0, rough_cells);
            let (_, independent) =
                found.mean_error(3_000_000, &[], (10.0, 10.0), || Ok(1.0)).expect("no cell is read").expect("classes");
            assert!(independent > 1_000_000.0, "{seed}: {independent}, {:?} {:?}", found.sills_m2, found.ranges_m);
        }
    }

    #[test]
    fn windows_that_lean_as_a_whole_are_one() {
        for seed in 0..6 {
            let found = fitted(seed, 1.0, 2304);
            // Variance 1 of the leaning beside 12.7 of the noise.
            let long = found.ranges_m.iter().zip(found.sills_m2).filter(|(range, _)| **range > 300.0);
            let sill: f64 = long.map(|(_, sill)| sill).sum();
            assert!((0.6..1.5).contains(&sill), "{seed}: {:?} {:?}", found.sills_m2, found.ranges_m);
        }
    }
}
