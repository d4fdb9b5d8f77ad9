//! A fine model seen in coarser cells: means over each cell's own footprint, wherever it comes to lie.
//!
//! Means over whole blocks, interpolated between them, draw a shift towards the blocks' own lattice by some thousandths
//! of a cell where the ground is rougher than the cells; footprints have no lattice.

use crate::error::Result;
use crate::grid::Grid;
use crate::source::{CELLS_AT_A_TIME, Heights, Patch};

/// A source in the cells of another grid, moved by a shift.
pub struct Footprints<'a, H: Heights + ?Sized> {
    source: &'a H,
    target: Grid,
    x: Axis,
    y: Axis,
    within: Within,
}

/// How the ground lies within a cell of the source.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Within {
    Level,
    /// It rises as the cell's neighbours do.
    Sloping,
}

/// Along one axis: cell `i` of the target covers `from + i·step` and the `width` after it, in cells of the source.
#[derive(Clone, Copy, Debug)]
struct Axis {
    from: f64,
    step: f64,
    width: f64,
}

/// Cells of the source under one of the target: the first, and its and the next ones' shares, at `at` in a list; where
/// the footprint begins, from the first's own beginning. `lean` is the share of the first and of the last cell times
/// how far the middle of what is covered of it lies from its own, in cells of the source.
#[derive(Clone, Copy, Debug)]
struct Cover {
    first: i64,
    begins: f64,
    at: usize,
    count: usize,
    lean: [f64; 2],
}

/// Shares below this are rounding.
const LEAST_SHARE: f64 = 1e-9;

impl Axis {
    fn new(target: (f64, f64), source: (f64, f64), shift: f64) -> Self {
        let step = target.1 / source.1;
        let (from, width) = ((target.0 + shift - source.0) / source.1, step.abs());
        Axis { from: if step < 0.0 { from - width } else { from }, step, width }
    }

    fn covers(&self, first: i64, count: usize, shares: &mut Vec<f64>, covers: &mut Vec<Cover>) {
        shares.clear();
        covers.clear();
        for index in first..first + count as i64 {
            let low = self.from + index as f64 * self.step;
            let high = low + self.width;
            // Far outside, where a float has no place in an index, there is nothing to read anyway.
            let cell = |edge: f64| edge.clamp(-4e15, 4e15) as i64;
            let (start, end) = (cell(low.floor()), cell(high.ceil()));
            let share = |c: i64| (high.min(c as f64 + 1.0) - low.max(c as f64)) / self.width;
            let at = shares.len();
            let first = (start..end).find(|&c| share(c) > LEAST_SHARE).unwrap_or(start);
            shares.extend((first..end).map(share).take_while(|share| *share > LEAST_SHARE));
            let count = shares.len() - at;
            let begins = low - first as f64;
            let last = count.saturating_sub(1);
            let lean = |k: usize| {
                let (own, ends) = (k as f64, begins + self.width);
                let middle = (begins.max(own) + ends.min(own + 1.0)) / 2.0 - (own + 0.5);
                let lean = shares.get(at + k).map_or(0.0, |share| share * middle);
                if lean.abs() > LEAST_SHARE { lean } else { 0.0 }
            };
            covers.push(Cover { first, begins, at, count, lean: [lean(0), if last > 0 { lean(last) } else { 0.0 }] });
        }
    }
}

impl Cover {
    /// What the first and the last cell add to a sum of shares, since the ground rises within them; `at` is the height
    /// of a cell, counted from the first, NaN where there is none.
    fn rise(&self, at: impl Fn(i64) -> f64) -> f64 {
        let slope = |k: i64| {
            let (before, here, after) = (at(k - 1), at(k), at(k + 1));
            match (before.is_nan(), after.is_nan()) {
                (false, false) => 0.5 * (after - before),
                (true, false) => after - here,
                (false, true) => here - before,
                (true, true) => 0.0,
            }
        };
        let last = self.count as i64 - 1;
        let ends = [0, last].into_iter().zip(self.lean).filter(|(_, lean)| *lean != 0.0);
        ends.map(|(k, lean)| lean * slope(k)).sum()
    }
}

/// Buffers of [`Footprints::read_with`].
#[derive(Default)]
pub struct Buffers {
    columns: Vec<Cover>,
    column_shares: Vec<f64>,
    rows: Vec<Cover>,
    row_shares: Vec<f64>,
    cells: Vec<f64>,
    along: Vec<(f64, f64)>,
    /// The same sums where the ground slopes within cells; right where nothing is missing.
    sloping: Vec<f64>,
    /// Footprints of which not all has heights.
    pub partial: Vec<Partial>,
}

/// A footprint of which not all has heights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Partial {
    /// In the list of heights.
    pub index: usize,
    /// Where the middle of the part that has them lies, from the cell's, in cells to the right and down.
    pub off_px: [f64; 2],
}

/// A footprint without heights on a smaller share than this is whole.
const WHOLE: f64 = 1e-6;

impl<'a, H: Heights + ?Sized> Footprints<'a, H> {
    /// The cell at X of `target` gets the mean of `source` over the cell's area moved by (`shift_x`, `shift_y`), in
    /// units of the CRS; NaN where less than half of it has heights.
    pub fn new(source: &'a H, target: Grid, shift: (f64, f64)) -> Self {
        let s = source.grid();
        let x = Axis::new((target.x0, target.step_x), (s.x0, s.step_x), shift.0);
        let y = Axis::new((target.y0, target.step_y), (s.y0, s.step_y), shift.1);
        Footprints { source, target, x, y, within: Within::Level }
    }

    /// The same, with ground that rises within the source's cells as their neighbours do, wherever a footprint has
    /// heights all over: the part of a cell that it covers lies higher or lower than the cell (second-order
    /// conservative remapping, P. W. Jones 1999). A footprint that has them in part takes cells as level.
    pub fn sloping(self) -> Self {
        Footprints { within: Within::Sloping, ..self }
    }

    /// As [`Heights::read`], with buffers that are used again. Few rows of the source are held at a time.
    ///
    /// # Errors
    /// When the source cannot be read.
    pub fn read_with(&self, patch: Patch, buffers: &mut Buffers, out: &mut Vec<f64>) -> Result<()> {
        out.clear();
        out.resize(patch.width * patch.height, f64::NAN);
        if out.is_empty() {
            return Ok(());
        }
        let Buffers { columns, column_shares, rows, row_shares, cells, along, sloping, partial } = buffers;
        partial.clear();
        self.x.covers(patch.x, patch.width, column_shares, columns);
        self.y.covers(patch.y, patch.height, row_shares, rows);
        let around = i64::from(self.within == Within::Sloping);
        let widened = |(first, end): (i64, i64)| (first - around, end + around);
        let (left, right) = widened(span(columns));
        let s = self.source.grid();
        if right <= 0 || left >= s.width as i64 {
            return Ok(());
        }
        let width = (right - left) as usize;
        let rows_at_a_time = ((CELLS_AT_A_TIME / width) as f64 / self.y.width).max(1.0) as usize;
        for (band, lines) in out.chunks_mut(rows_at_a_time * patch.width).enumerate() {
            let from = band * rows_at_a_time;
            let covers = &rows[from..from + lines.len() / patch.width];
            let (top, bottom) = widened(span(covers));
            if bottom <= 0 || top >= s.height as i64 {
                continue;
            }
            self.source.read(Patch { x: left, y: top, width, height: (bottom - top) as usize }, cells)?;
            along.clear();
            sloping.clear();
            for row in cells.chunks_exact(width) {
                along.extend(columns.iter().map(|cover| {
                    let from = (cover.first - left) as usize;
                    gathered(&row[from..from + cover.count], &column_shares[cover.at..])
                }));
                if self.within == Within::Sloping {
                    let level = &along[sloping.len()..];
                    sloping.extend(columns.iter().zip(level).map(|(cover, (sum, _))| {
                        let at = |k: i64| row[(cover.first - left + k) as usize];
                        sum + cover.rise(at)
                    }));
                }
            }
            for (row, (line, cover)) in lines.chunks_exact_mut(patch.width).zip(covers).enumerate() {
                let first_index = (from + row) * patch.width;
                let first = (cover.first - top) as usize * patch.width;
                for (x, value) in line.iter_mut().enumerate() {
                    let (mut sum, mut whole) = (0.0, 0.0);
                    for (k, share) in row_shares[cover.at..cover.at + cover.count].iter().enumerate() {
                        let (part, there) = along[first + k * patch.width + x];
                        sum += share * part;
                        whole += share * there;
                    }
                    if whole >= 0.5 {
                        *value = sum / whole;
                    }
                    if whole >= 1.0 - WHOLE && self.within == Within::Sloping {
                        let shares = row_shares[cover.at..cover.at + cover.count].iter().enumerate();
                        let sum: f64 = shares.map(|(k, share)| share * sloping[first + k * patch.width + x]).sum();
                        let at = |k: i64| {
                            let index = ((cover.first - top + k) * patch.width as i64) as usize + x;
                            if along[index].1 >= 1.0 - WHOLE { sloping[index] } else { f64::NAN }
                        };
                        *value = (sum + cover.rise(at)) / whole;
                    }
                    if (0.5..1.0 - WHOLE).contains(&whole) {
                        let shares = (&column_shares[columns[x].at..], &row_shares[cover.at..]);
                        let from = (cover.first - top) as usize * width + (columns[x].first - left) as usize;
                        let middle = self.middle_of((&cells[from..], width), (&columns[x], cover), shares);
                        partial.push(Partial { index: first_index + x, off_px: middle });
                    }
                }
            }
        }
        Ok(())
    }
}

impl<H: Heights + ?Sized> Footprints<'_, H> {
    /// Where the mean of a footprint belongs that has heights in part, from the footprint's middle, in cells of the
    /// target: heights belong to the middles of cells, of which a footprint may end within one. `cells` are the
    /// source's from its first on, with their stride.
    fn middle_of(
        &self,
        (cells, stride): (&[f64], usize),
        (columns, rows): (&Cover, &Cover),
        (column_shares, row_shares): (&[f64], &[f64]),
    ) -> [f64; 2] {
        let place = |k: usize, cover: &Cover, width: f64| (k as f64 + 0.5 - cover.begins) / width;
        let (mut x, mut y, mut all) = (0.0, 0.0, 0.0);
        for (j, row_share) in row_shares[..rows.count].iter().enumerate() {
            for (i, column_share) in column_shares[..columns.count].iter().enumerate() {
                if !cells[j * stride + i].is_nan() {
                    let share = row_share * column_share;
                    x += share * place(i, columns, self.x.width);
                    y += share * place(j, rows, self.y.width);
                    all += share;
                }
            }
        }
        // Shares run as the source's cells do, which may be against the target's.
        [self.x.step.signum() * (x / all - 0.5), self.y.step.signum() * (y / all - 0.5)]
    }
}

/// The weighted sum of the heights that are there, and their share.
fn gathered(cells: &[f64], shares: &[f64]) -> (f64, f64) {
    let (mut sum, mut there) = (0.0, 0.0);
    for (&value, &share) in cells.iter().zip(shares) {
        if !value.is_nan() {
            sum += share * value;
            there += share;
        }
    }
    (sum, there)
}

/// The first cell that is needed, and the one after the last.
fn span(covers: &[Cover]) -> (i64, i64) {
    let ends = covers.iter().map(|cover| (cover.first, cover.first + cover.count as i64));
    ends.fold((i64::MAX, i64::MIN), |(low, high), (a, b)| (low.min(a), high.max(b)))
}

impl<H: Heights + ?Sized> Heights for Footprints<'_, H> {
    fn grid(&self) -> Grid {
        self.target
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        self.read_with(patch, &mut Buffers::default(), out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::MemoryHeights;

    #[test]
    fn planes_keep_their_heights_and_windows_agree() {
        let grid = Grid { x0: 10.0, y0: 90.0, step_x: 0.7, step_y: -0.9, width: 60, height: 50 };
        let place = |i: u64, j: u64| (10.0 + 0.7 * (i as f64 + 0.5), 90.0 - 0.9 * (j as f64 + 0.5));
        let plane = |x: f64, y: f64| 2.0 * x - 3.0 * y;
        let values = (0..50).flat_map(|j| (0..60).map(move |i| place(i, j))).map(|(x, y)| plane(x, y)).collect();
        let fine = MemoryHeights::new(grid, values);
        // Whole cells of the source, or not; north up, or south up.
        for (step_x, step_y, y0) in [(2.1, -2.7, 84.0), (2.3, -3.1, 84.0), (2.3, 3.1, 60.0)] {
            let target = Grid { x0: 13.0, y0, step_x, step_y, width: 9, height: 6 };
            let coarse = Footprints::new(&fine, target, (0.4, -0.3));
            let (mut whole, mut part) = (Vec::new(), Vec::new());
            coarse.read(Patch { x: 0, y: 0, width: 9, height: 6 }, &mut whole).expect("memory");
            for (index, value) in whole.iter().enumerate() {
                let (i, j) = ((index % 9) as f64 + 0.5, (index / 9) as f64 + 0.5);
                let expected = plane(13.0 + i * step_x + 0.4, y0 + j * step_y - 0.3);
                // Cells are taken as level: a footprint's end within one is off by a part of its own rise.
                let most = if step_x == 2.1 { 0.7 } else { 0.5 };
                assert!((value - expected).abs() < most, "{index}: {value} for {expected}");
            }
            coarse.read(Patch { x: 2, y: 3, width: 4, height: 2 }, &mut part).expect("memory");
            for (k, value) in part.iter().enumerate() {
                assert_eq!(value.to_bits(), whole[(3 + k / 4) * 9 + 2 + k % 4].to_bits());
            }
        }
    }

    /// A cell that the source covers by three fifths: its mean is that of a plane at the middle of that part.
    #[test]
    fn the_middle_of_a_part_is_told() {
        let grid = Grid { x0: 4.0, y0: 10.0, step_x: 1.0, step_y: -1.0, width: 16, height: 7 };
        let values = (0..7).flat_map(|j| (0..16).map(move |i| f64::from(i) + 4.5 + 10.0 * (9.5 - f64::from(j))));
        let memory = MemoryHeights::new(grid, values.collect());
        for (y0, step_y) in [(10.0, -10.0), (0.0, 10.0)] {
            let target = Grid { x0: 0.0, y0, step_x: 10.0, step_y, width: 2, height: 1 };
            let (mut out, mut buffers) = (Vec::new(), Buffers::default());
            let coarse = Footprints::new(&memory, target, (0.0, 0.0));
            coarse.read_with(Patch { x: 0, y: 0, width: 2, height: 1 }, &mut buffers, &mut out).expect("memory");
            // Rows from 10 down to 3 have heights: their middle is 6.5.
            let down = if step_y < 0.0 { -0.15 } else { 0.15 };
            assert_eq!(buffers.partial.len(), 1, "of the first three fifths of seven tenths are too little");
            let Partial { index, off_px } = buffers.partial[0];
            assert!(index == 1 && off_px[0].abs() < 1e-12 && (off_px[1] - down).abs() < 1e-12, "{off_px:?}");
            assert!((out[1] - (15.0 + 10.0 * 6.5)).abs() < 1e-9, "{out:?}");
        }
    }

    #[test]
    fn half_of_a_footprint_must_have_heights() {
        let grid = Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: -1.0, width: 4, height: 2 };
        let nan = f64::NAN;
        let memory = MemoryHeights::new(grid, vec![1.0, 3.0, nan, nan, nan, nan, nan, 5.0]);
        let target = Grid { step_x: 2.0, step_y: -2.0, width: 3, height: 1, ..grid };
        let mut out = Vec::new();
        let coarse = Footprints::new(&memory, target, (0.0, 0.0));
        coarse.read(Patch { x: 0, y: 0, width: 3, height: 1 }, &mut out).expect("memory");
        assert_eq!(out[0], 2.0);
        assert!(out[1].is_nan() && out[2].is_nan());
    }
}
