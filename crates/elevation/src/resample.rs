//! Heights between the cells of a grid without rotation: rows and columns apart.

use crate::error::Result;
use crate::grid::Grid;
use crate::source::{Heights, Patch};

/// How a height is made of its neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interpolation {
    Nearest,
    #[default]
    Bilinear,
    /// Keys, *Cubic convolution interpolation for digital image processing*, 1981, with a = −1/2.
    Cubic,
    /// The cubic through the four nearest cells (Lagrange): it bends at the cells, but draws a shift that is sought on
    /// rough ground by two fifths of what Keys's does.
    Lagrange,
}

/// Positions nearer to a cell's centre than this are that cell: grids that agree do so up to rounding.
const SNAP_PX: f64 = 1e-6;

/// Along one axis: cell `i` of the target lies at cell `offset + i·ratio` of the source, both counted from centres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisMap {
    offset: f64,
    ratio: f64,
}

/// Four neighbours, the first of them, and their weights; neighbours of weight zero do not count.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Taps {
    first: i64,
    weights: [f64; 4],
}

impl AxisMap {
    /// `shift` in source cells is added to every position.
    fn new(target: (f64, f64), source: (f64, f64), shift: f64) -> Self {
        let ratio = target.1 / source.1;
        let offset = (target.0 - source.0) / source.1 + 0.5 * ratio - 0.5 + shift;
        // A ratio that is one up to rounding must not drift over a long row.
        let ratio = if (ratio - 1.0).abs() < 1e-9 { 1.0 } else { ratio };
        AxisMap { offset, ratio }
    }

    fn taps(&self, index: i64, interpolation: Interpolation) -> Taps {
        let (mut cell, mut f) = if self.ratio == 1.0 {
            // One phase along the whole axis, to the last bit.
            (self.offset.floor() + index as f64, self.offset - self.offset.floor())
        } else {
            let position = self.offset + index as f64 * self.ratio;
            (position.floor(), position - position.floor())
        };
        if f > 1.0 - SNAP_PX {
            cell += 1.0;
            f = 0.0;
        } else if f < SNAP_PX {
            f = 0.0;
        }
        let weights = match interpolation {
            _ if f == 0.0 => [0.0, 1.0, 0.0, 0.0],
            Interpolation::Nearest if f < 0.5 => [0.0, 1.0, 0.0, 0.0],
            Interpolation::Nearest => [0.0, 0.0, 1.0, 0.0],
            Interpolation::Bilinear => [0.0, 1.0 - f, f, 0.0],
            Interpolation::Cubic => {
                let (f2, f3) = (f * f, f * f * f);
                [
                    -0.5 * f3 + f2 - 0.5 * f,
                    1.5 * f3 - 2.5 * f2 + 1.0,
                    -1.5 * f3 + 2.0 * f2 + 0.5 * f,
                    0.5 * f3 - 0.5 * f2,
                ]
            }
            Interpolation::Lagrange => [
                f * (f - 1.0) * (2.0 - f) / 6.0,
                (f + 1.0) * (f - 1.0) * (f - 2.0) / 2.0,
                (f + 1.0) * f * (2.0 - f) / 2.0,
                (f + 1.0) * f * (f - 1.0) / 6.0,
            ],
        };
        // Far outside, where a float has no place in an index, there is nothing to read anyway.
        Taps { first: cell.clamp(-4e15, 4e15) as i64 - 1, weights }
    }
}

/// A source seen on another grid, moved by a shift.
pub struct Resampled<'a, H: Heights + ?Sized> {
    source: &'a H,
    target: Grid,
    x: AxisMap,
    y: AxisMap,
    interpolation: Interpolation,
    voids: Voids,
}

/// What a cell without a height does to the places around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Voids {
    /// No place that is interpolated from it has a height.
    Spread,
    /// It gets the height of the plane through its neighbours, for its neighbours' sake.
    Mended,
}

impl<'a, H: Heights + ?Sized> Resampled<'a, H> {
    /// The cell at X of `target` gets the height of `source` at X + (`shift_x`, `shift_y`), in units of the CRS.
    pub fn new(source: &'a H, target: Grid, shift: (f64, f64), interpolation: Interpolation) -> Self {
        let s = source.grid();
        let x = AxisMap::new((target.x0, target.step_x), (s.x0, s.step_x), shift.0 / s.step_x);
        let y = AxisMap::new((target.y0, target.step_y), (s.y0, s.step_y), shift.1 / s.step_y);
        Resampled { source, target, x, y, interpolation, voids: Voids::Spread }
    }

    /// The same, with single cells without a height bridged: places nearest to one have no height, but others do,
    /// though they are interpolated from it.
    pub fn mended(self) -> Self {
        Resampled { voids: Voids::Mended, ..self }
    }

    /// As [`Heights::read`], with buffers that are used again.
    ///
    /// # Errors
    /// When the source cannot be read.
    pub fn read_with(&self, patch: Patch, scratch: &mut Scratch, out: &mut Vec<f64>) -> Result<()> {
        // Every cell is written below.
        out.resize(patch.width * patch.height, f64::NAN);
        if out.is_empty() {
            return Ok(());
        }
        let taps = |map: &AxisMap, from: i64, count: usize, into: &mut Vec<Taps>| {
            into.clear();
            into.extend((0..count as i64).map(|i| map.taps(from + i, self.interpolation)));
        };
        taps(&self.x, patch.x, patch.width, &mut scratch.columns);
        taps(&self.y, patch.y, patch.height, &mut scratch.rows);
        let (mut left, mut right) = span(&scratch.columns);
        let (mut top, mut bottom) = span(&scratch.rows);
        let s = self.source.grid();
        if right < 0 || bottom < 0 || left >= s.width as i64 || top >= s.height as i64 {
            out.fill(f64::NAN);
            return Ok(());
        }
        if self.voids == Voids::Mended {
            // Of a cell's neighbours the same ones for any patch.
            (left, right, top, bottom) = (left - 1, right + 1, top - 1, bottom + 1);
        }
        let part = Patch { x: left, y: top, width: (right - left + 1) as usize, height: (bottom - top + 1) as usize };
        self.source.read(part, &mut scratch.cells)?;
        scratch.holes.clear();
        if self.voids == Voids::Mended && any_nan(&scratch.cells) {
            mend(&mut scratch.cells, part.width, &mut scratch.holes);
        }
        self.interpolate(patch, part, scratch, out);
        if !scratch.holes.is_empty() {
            scratch.nearest.clear();
            scratch.nearest.extend(scratch.columns.iter().map(|column| (column.nearest() - left) as usize));
            for (line, row) in out.chunks_exact_mut(patch.width).zip(&scratch.rows) {
                let holes = &scratch.holes[(row.nearest() - top) as usize * part.width..][..part.width];
                for (value, &column) in line.iter_mut().zip(&scratch.nearest) {
                    if holes[column] {
                        *value = f64::NAN;
                    }
                }
            }
        }
        Ok(())
    }

    /// From the cells of `part` in the scratch to the places of `patch`.
    fn interpolate(&self, patch: Patch, part: Patch, scratch: &mut Scratch, out: &mut [f64]) {
        let (left, top) = (part.x, part.y);
        let whole = |taps: &[Taps]| taps.iter().all(|t| t.weights == [0.0, 1.0, 0.0, 0.0]);
        if self.x.ratio == 1.0 && self.y.ratio == 1.0 && whole(&scratch.columns) && whole(&scratch.rows) {
            let offset = (scratch.columns[0].first + 1 - left) as usize;
            for (row, line) in out.chunks_exact_mut(patch.width).enumerate() {
                let from = (scratch.rows[row].first + 1 - top) as usize * part.width + offset;
                line.copy_from_slice(&scratch.cells[from..from + patch.width]);
            }
            return;
        }
        // Along the rows first, each row of the source once.
        let (cells, columns) = (&scratch.cells, &scratch.columns);
        let along = &mut scratch.along;
        along.resize(part.height * patch.width, 0.0);
        let one_phase = (self.x.ratio == 1.0).then(|| (columns[0].first - left, columns[0].weights));
        for (line, row) in along.chunks_exact_mut(patch.width).zip(cells.chunks_exact(part.width)) {
            if let Some((start, weights)) = one_phase {
                weigh(line, &weights, |k| &row[(start + k as i64) as usize..][..patch.width]);
                continue;
            }
            for (value, taps) in line.iter_mut().zip(columns) {
                let mut sum = 0.0;
                for (k, &w) in taps.weights.iter().enumerate() {
                    if w != 0.0 {
                        sum += w * row[(taps.first - left + k as i64) as usize];
                    }
                }
                *value = sum;
            }
        }
        for (line, taps) in out.chunks_exact_mut(patch.width).zip(&scratch.rows) {
            weigh(line, &taps.weights, |k| {
                &along[(taps.first - top + k as i64) as usize * patch.width..][..patch.width]
            });
        }
    }
}

/// The sums of neighbours along one axis, all with the same weights; neighbours of weight zero are not asked for.
fn weigh<'c>(line: &mut [f64], weights: &[f64; 4], neighbours: impl Fn(usize) -> &'c [f64]) {
    if let [true, true, true, true] = weights.map(|w| w != 0.0) {
        let ([a, b, c, d], [p, q, r, s]) = (std::array::from_fn(neighbours), *weights);
        let cells = a.iter().zip(b).zip(c.iter().zip(d));
        line.iter_mut().zip(cells).for_each(|(value, ((a, b), (c, d)))| *value = p * a + q * b + r * c + s * d);
        return;
    }
    line.fill(0.0);
    for (k, &w) in weights.iter().enumerate().filter(|(_, w)| **w != 0.0) {
        line.iter_mut().zip(neighbours(k)).for_each(|(value, &cell)| *value += w * cell);
    }
}

/// Whether a cell has no height; in blocks, which a processor looks at several cells at a time.
fn any_nan(cells: &[f64]) -> bool {
    cells.chunks(64).any(|block| block.iter().fold(false, |found, z| found | z.is_nan()))
}

/// Gives cells without a height that of the plane through those of their eight neighbours that have one, at least four;
/// `holes` says where there was none.
fn mend(cells: &mut [f64], width: usize, holes: &mut Vec<bool>) {
    const FEWEST: f64 = 4.0;
    holes.clear();
    holes.extend(cells.iter().map(|z| z.is_nan()));
    let height = cells.len() / width;
    for y in (1..height.saturating_sub(1)).filter(|y| holes[y * width..][..width].contains(&true)) {
        for x in (1..width.saturating_sub(1)).filter(|x| holes[y * width + x]) {
            // Sums of 1, x, y, x², xy, y², z, xz, yz.
            let mut s = [0.0; 9];
            for (dy, dx) in (0..9).filter(|i| *i != 4).map(|i| (i / 3, i % 3)) {
                let at = (y + dy - 1) * width + x + dx - 1;
                if !holes[at] {
                    let (u, v, z) = (dx as f64 - 1.0, dy as f64 - 1.0, cells[at]);
                    let terms = [1.0, u, v, u * u, u * v, v * v, z, u * z, v * z];
                    s.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
                }
            }
            // The plane's height in the middle, by Cramer's rule.
            let [n, u, v, uu, uv, vv, z, uz, vz] = s;
            let (a, b, c) = (uu * vv - uv * uv, v * uv - u * vv, u * uv - v * uu);
            let determinant = n * a + u * b + v * c;
            if n >= FEWEST && determinant.abs() > 0.5 {
                cells[y * width + x] = (z * a + uz * b + vz * c) / determinant;
            }
        }
    }
}

impl<H: Heights + ?Sized> Heights for Resampled<'_, H> {
    fn grid(&self) -> Grid {
        self.target
    }

    fn read(&self, patch: Patch, out: &mut Vec<f64>) -> Result<()> {
        self.read_with(patch, &mut Scratch::default(), out)
    }
}

/// Buffers of [`Resampled::read_with`].
#[derive(Default)]
pub struct Scratch {
    columns: Vec<Taps>,
    rows: Vec<Taps>,
    cells: Vec<f64>,
    along: Vec<f64>,
    /// Cells without a height that were mended, or could not be.
    holes: Vec<bool>,
    /// The cell of the part that counts most in each column.
    nearest: Vec<usize>,
}

impl Taps {
    /// The cell that counts most.
    fn nearest(&self) -> i64 {
        let most = (0..4).max_by(|&a, &b| self.weights[a].total_cmp(&self.weights[b]).then(b.cmp(&a)));
        self.first + most.unwrap_or(1) as i64
    }
}

/// First and last cell that is needed.
fn span(taps: &[Taps]) -> (i64, i64) {
    let ends = taps.iter().map(|t| {
        let used = |k: &usize| t.weights[*k] != 0.0;
        let first = (0..4).find(used).unwrap_or(1) as i64;
        let last = (0..4).rfind(used).unwrap_or(1) as i64;
        (t.first + first, t.first + last)
    });
    ends.fold((i64::MAX, i64::MIN), |(low, high), (a, b)| (low.min(a), high.max(b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::MemoryHeights;

    fn surface(width: u64, height: u64) -> MemoryHeights {
        let grid = Grid { x0: 100.0, y0: 50.0, step_x: 2.0, step_y: -2.0, width, height };
        // Cubic convolution is exact for planes and parabolas.
        let values = (0..height).flat_map(|y| (0..width).map(move |x| (x * x) as f64 - 3.0 * y as f64)).collect();
        MemoryHeights::new(grid, values)
    }

    #[test]
    fn parabolas_are_met_between_the_cells() {
        let source = surface(12, 10);
        let target = Grid { x0: 100.0, y0: 50.0, step_x: 1.0, step_y: -1.0, width: 24, height: 20 };
        let moved = Resampled::new(&source, target, (0.7, -0.3), Interpolation::Cubic);
        let mut out = Vec::new();
        moved.read(Patch { x: 6, y: 6, width: 8, height: 8 }, &mut out).expect("memory");
        for (i, value) in out.iter().enumerate() {
            let (x, y) = (6.5 + (i % 8) as f64 + 0.7, 6.5 + (i / 8) as f64 + 0.3);
            let (x, y) = (x / 2.0 - 0.5, y / 2.0 - 0.5);
            assert!((value - (x * x - 3.0 * y)).abs() < 1e-9, "{i}: {value}");
        }
    }

    #[test]
    fn single_voids_are_bridged_and_stay_voids() {
        let plane = |x: u64, y: u64| 3.0 * x as f64 - 2.0 * y as f64 + 100.0;
        let grid = Grid { x0: 0.0, y0: 0.0, step_x: 1.0, step_y: 1.0, width: 24, height: 20 };
        let hole = |x: u64, y: u64| (x * 7 + y * 3).is_multiple_of(11);
        let value = |x: u64, y: u64| if hole(x, y) { f64::NAN } else { plane(x, y) };
        let source = MemoryHeights::new(grid, (0..20).flat_map(|y| (0..24).map(move |x| value(x, y))).collect());
        let patch = Patch { x: 3, y: 3, width: 16, height: 12 };
        let moved = || Resampled::new(&source, grid, (0.3, -0.2), Interpolation::Lagrange);
        let (mut spread, mut mended) = (Vec::new(), Vec::new());
        moved().read(patch, &mut spread).expect("memory");
        moved().mended().read(patch, &mut mended).expect("memory");
        for (i, z) in mended.iter().enumerate() {
            let (x, y) = (3 + i as u64 % 16, 3 + i as u64 / 16);
            if hole(x, y) {
                assert!(z.is_nan());
            } else {
                assert!((z - plane(x, y) - 3.0 * 0.3 - 2.0 * 0.2).abs() < 1e-9, "{x} {y}: {z}");
            }
        }
        assert!(spread.iter().filter(|z| !z.is_nan()).count() < mended.len() / 4);
        // Any window is a part of the whole.
        let mut part = Vec::new();
        moved().mended().read(Patch { x: 8, y: 7, width: 3, height: 2 }, &mut part).expect("memory");
        for (i, z) in part.iter().enumerate() {
            assert_eq!(z.to_bits(), mended[(4 + i / 3) * 16 + 5 + i % 3].to_bits());
        }
    }

    #[test]
    fn the_same_grid_is_a_copy_and_windows_agree() {
        let source = surface(9, 7);
        let same = Resampled::new(&source, source.grid(), (0.0, 0.0), Interpolation::Cubic);
        let mut whole = Vec::new();
        same.read(Patch { x: 0, y: 0, width: 9, height: 7 }, &mut whole).expect("memory");
        assert_eq!(whole, source.values());
        let moved = Resampled::new(&source, source.grid(), (0.5, 0.25), Interpolation::Cubic);
        moved.read(Patch { x: 0, y: 0, width: 9, height: 7 }, &mut whole).expect("memory");
        let mut part = Vec::new();
        moved.read(Patch { x: 3, y: 2, width: 4, height: 3 }, &mut part).expect("memory");
        for (i, value) in part.iter().enumerate() {
            let expected = whole[(2 + i / 4) * 9 + 3 + i % 4];
            assert_eq!(value.to_bits(), expected.to_bits());
        }
    }
}
