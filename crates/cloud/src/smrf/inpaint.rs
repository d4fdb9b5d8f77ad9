//! Holes in surfaces, filled as if springs joined neighbouring cells (D'Errico, *inpaint_nans*, 2004, method 4, as
//! Pingel et al. use it): the heights with the least sum of squared differences between the four neighbours.
//!
//! The normal equations are solved by conjugate gradients (Hestenes & Stiefel 1952), preconditioned by one V-cycle over
//! ever coarser surfaces (Braess, *Towards algebraic multigrid for elliptic problems of second order*, 1995: cells
//! joined in fours, the coarse springs about half as stiff as Galerkin's), smoothed by Chebyshev's polynomial in
//! Jacobi's sweeps. All sums run in a fixed order, so that threads change nothing.

use std::ops::AddAssign;

use rayon::prelude::*;

use super::surface::Surface;

/// The residual, relative to the right-hand side's, at which a solution is good enough.
const TOLERANCE: f64 = 1e-9;
/// A bound that only rounding can reach: ten to forty steps are usual.
const MOST_STEPS: usize = 2000;
/// Damping of Jacobi's sweeps before and after each coarser surface: the inverse roots of Chebyshev's polynomial on the
/// eigenvalues from 0.6 to 2, which are what a coarser surface does not see.
const SWEEPS: [f32; 2] = [1.2422, 0.5571];
/// Damping and number of the sweeps on the coarsest surface.
const LAST_SWEEPS: [f32; 16] = [0.8; 16];
/// Stiffness of coarse springs, relative to Galerkin's: least steps on lidar ground with holes. 0.6 takes a seventh
/// more where holes are 1,000 cells wide, 0.5 a twentieth more where they are small.
const COARSE: f32 = 0.55;
/// Rows of one piece of work at least.
const BAND_ROWS: usize = 16;
/// Sums that run side by side.
const LANES: usize = 8;

/// Gives every NaN cell of `surface` a height. A surface without any known cell stays as it is.
pub fn inpaint(surface: &mut Surface) {
    let unknown: Vec<bool> = surface.values.iter().map(|value| value.is_nan()).collect();
    let open = unknown.iter().filter(|open| **open).count();
    if open == 0 || open == unknown.len() {
        return;
    }
    let known = unknown.len() - open;
    let sum: f64 = surface.values.iter().filter(|value| !value.is_nan()).sum();
    // Heights count from their mean, so that the tolerance does not depend on the datum.
    let origin = sum / known as f64;
    for value in &mut surface.values {
        *value = if value.is_nan() { 0.0 } else { *value - origin };
    }
    // On a thread of the pool: to hand it thousands of short pieces from outside costs more than the pieces.
    rayon::scope(|_| solve(surface, &unknown));
    surface.values.iter_mut().for_each(|value| *value += origin);
}

/// Springs of a surface: to the east, to the south, and all of a cell together.
trait Springs: Sync {
    fn size(&self) -> (usize, usize);
    /// Zero where the eastern neighbour is known or missing.
    fn east(&self, x: usize, y: usize) -> f32;
    fn south(&self, x: usize, y: usize) -> f32;
    /// Zero where the cell itself is known.
    fn diagonal_row(&self, y: usize) -> &[f32];

    /// What the neighbours of a row's cells pull, where `z` is zero at known cells. At those cells it means nothing.
    fn pull_row(&self, z: &[f32], y: usize, pull: &mut [f32]);
}

/// The finest surface: all springs are alike.
struct Fine {
    columns: usize,
    rows: usize,
    /// How many neighbours an open cell has, known or not; zero at known cells.
    diagonal: Vec<f32>,
}

impl Fine {
    fn new(columns: usize, rows: usize, unknown: &[bool]) -> Fine {
        let beside = |cell: usize| {
            let (x, y) = (cell % columns, cell / columns);
            [x > 0, x + 1 < columns, y > 0, y + 1 < rows].into_iter().filter(|there| *there).count() as f32
        };
        let diagonal = unknown.iter().enumerate().map(|(cell, open)| if *open { beside(cell) } else { 0.0 });
        Fine { columns, rows, diagonal: diagonal.collect() }
    }

    fn is_open(&self, x: usize, y: usize) -> bool {
        self.diagonal[y * self.columns + x] > 0.0
    }
}

impl Springs for Fine {
    fn size(&self) -> (usize, usize) {
        (self.columns, self.rows)
    }
    fn east(&self, x: usize, y: usize) -> f32 {
        f32::from(u8::from(x + 1 < self.columns && self.is_open(x, y) && self.is_open(x + 1, y)))
    }
    fn south(&self, x: usize, y: usize) -> f32 {
        f32::from(u8::from(y + 1 < self.rows && self.is_open(x, y) && self.is_open(x, y + 1)))
    }
    fn diagonal_row(&self, y: usize) -> &[f32] {
        &self.diagonal[y * self.columns..][..self.columns]
    }
    fn pull_row(&self, z: &[f32], y: usize, pull: &mut [f32]) {
        sum_beside(z, (self.columns, self.rows), y, pull);
    }
}

/// The sum of the values to the west, east, north and south of each cell of a row.
fn sum_beside<T: Copy + Default + AddAssign>(z: &[T], (columns, rows): (usize, usize), y: usize, sum: &mut [T]) {
    let row = &z[y * columns..][..columns];
    sum[0] = T::default();
    sum[1..].copy_from_slice(&row[..columns - 1]);
    let mut add = |values: &[T]| sum.iter_mut().zip(values).for_each(|(sum, value)| *sum += *value);
    add(&row[1..]);
    if y > 0 {
        add(&z[(y - 1) * columns..][..columns]);
    }
    if y + 1 < rows {
        add(&z[(y + 1) * columns..][..columns]);
    }
}

/// A coarser surface with its own vectors.
struct Level {
    columns: usize,
    rows: usize,
    east: Vec<f32>,
    south: Vec<f32>,
    diagonal: Vec<f32>,
    right: Vec<f32>,
    z: Vec<f32>,
    spare: Vec<f32>,
}

struct Matrix<'a> {
    columns: usize,
    rows: usize,
    east: &'a [f32],
    south: &'a [f32],
    diagonal: &'a [f32],
}

impl Springs for Matrix<'_> {
    fn size(&self) -> (usize, usize) {
        (self.columns, self.rows)
    }
    fn east(&self, x: usize, y: usize) -> f32 {
        self.east[y * self.columns + x]
    }
    fn south(&self, x: usize, y: usize) -> f32 {
        self.south[y * self.columns + x]
    }
    fn diagonal_row(&self, y: usize) -> &[f32] {
        &self.diagonal[y * self.columns..][..self.columns]
    }
    fn pull_row(&self, z: &[f32], y: usize, pull: &mut [f32]) {
        let (columns, first) = (self.columns, y * self.columns);
        let (row, east) = (&z[first..][..columns], &self.east[first..][..columns]);
        pull[0] = 0.0;
        for (pull, (spring, z)) in pull[1..].iter_mut().zip(east.iter().zip(row)) {
            *pull = spring * z;
        }
        let mut add = |springs: &[f32], z: &[f32]| {
            pull.iter_mut().zip(springs.iter().zip(z)).for_each(|(pull, (spring, z))| *pull += spring * z);
        };
        add(east, &row[1..]);
        if y > 0 {
            add(&self.south[first - columns..][..columns], &z[first - columns..][..columns]);
        }
        if y + 1 < self.rows {
            add(&self.south[first..][..columns], &z[first + columns..][..columns]);
        }
    }
}

/// Joins cells in fours.
fn coarser(springs: &impl Springs) -> Level {
    let (columns, rows) = springs.size();
    let (wide, tall) = (columns.div_ceil(2), rows.div_ceil(2));
    let cells = wide * tall;
    let mut level = Level {
        columns: wide,
        rows: tall,
        east: vec![0.0; cells],
        south: vec![0.0; cells],
        diagonal: vec![0.0; cells],
        right: vec![0.0; cells],
        z: vec![0.0; cells],
        spare: vec![0.0; cells],
    };
    let rows_of = |values| rayon::slice::ParallelSliceMut::par_chunks_mut(values, wide);
    let bands = rows_of(&mut level.east[..]).zip(rows_of(&mut level.south[..])).zip(rows_of(&mut level.diagonal[..]));
    bands.enumerate().with_min_len(BAND_ROWS).for_each(|(row, ((east, south), diagonal))| {
        for column in 0..wide {
            let (mut right, mut down, mut all, mut within) = (0.0, 0.0, 0.0, 0.0);
            for y in 2 * row..(2 * row + 2).min(rows) {
                for x in 2 * column..(2 * column + 2).min(columns) {
                    all += springs.diagonal_row(y)[x];
                    *(if x % 2 == 0 { &mut within } else { &mut right }) += springs.east(x, y);
                    *(if y % 2 == 0 { &mut within } else { &mut down }) += springs.south(x, y);
                }
            }
            east[column] = COARSE * right;
            south[column] = COARSE * down;
            diagonal[column] = COARSE * (all - 2.0 * within);
        }
    });
    level
}

/// One sweep of Jacobi's method from `z` into `next`.
fn sweep(springs: &impl Springs, right: &[f32], z: &[f32], next: &mut [f32], damping: f32) {
    let columns = springs.size().0;
    let rows = next.par_chunks_mut(columns).enumerate().with_min_len(BAND_ROWS);
    rows.for_each_init(
        || vec![0.0; columns],
        |pull, (y, next)| {
            springs.pull_row(z, y, pull);
            let (right, z) = (&right[y * columns..][..columns], &z[y * columns..][..columns]);
            let pulled = right.iter().zip(pull.iter()).zip(z.iter().zip(springs.diagonal_row(y)));
            for (next, ((right, pull), (z, diagonal))) in next.iter_mut().zip(pulled) {
                let moved = z + damping * ((right + pull) / diagonal - z);
                *next = if *diagonal > 0.0 { moved } else { 0.0 };
            }
        },
    );
}

/// One V-cycle: an answer `z` to the springs pulled by `right`.
fn cycle(springs: &impl Springs, right: &[f32], z: &mut Vec<f32>, spare: &mut Vec<f32>, levels: &mut [Level]) {
    let columns = springs.size().0;
    let sweeps: &[f32] = if levels.is_empty() { &LAST_SWEEPS } else { &SWEEPS };
    z.par_chunks_mut(columns).enumerate().with_min_len(BAND_ROWS).for_each(|(y, row)| {
        let right = &right[y * columns..][..columns];
        for (z, (right, diagonal)) in row.iter_mut().zip(right.iter().zip(springs.diagonal_row(y))) {
            *z = if *diagonal > 0.0 { sweeps[0] * right / diagonal } else { 0.0 };
        }
    });
    for damping in &sweeps[1..] {
        sweep(springs, right, z, spare, *damping);
        std::mem::swap(z, spare);
    }
    let Some((level, below)) = levels.split_first_mut() else { return };
    restrict(springs, right, z, level);
    {
        let Level { columns, rows, east, south, diagonal, right, z, spare } = &mut *level;
        let matrix = Matrix { columns: *columns, rows: *rows, east, south, diagonal };
        cycle(&matrix, right, z, spare, below);
    }
    let (wide, coarse) = (level.columns, &level.z);
    z.par_chunks_mut(columns).enumerate().with_min_len(BAND_ROWS).for_each(|(y, row)| {
        let coarse = &coarse[y / 2 * wide..][..wide];
        let diagonal = springs.diagonal_row(y).chunks(2);
        for ((cells, diagonal), coarse) in row.chunks_mut(2).zip(diagonal).zip(coarse) {
            for (z, diagonal) in cells.iter_mut().zip(diagonal) {
                *z += if *diagonal > 0.0 { *coarse } else { 0.0 };
            }
        }
    });
    for damping in SWEEPS {
        sweep(springs, right, z, spare, damping);
        std::mem::swap(z, spare);
    }
}

/// The residual of `z`, summed up in fours.
fn restrict(springs: &impl Springs, right: &[f32], z: &[f32], level: &mut Level) {
    let (columns, rows) = springs.size();
    let coarse = level.right.par_chunks_mut(level.columns).enumerate().with_min_len(BAND_ROWS);
    coarse.for_each_init(
        || vec![0.0; columns],
        |pull, (row, sums)| {
            sums.fill(0.0);
            for y in 2 * row..(2 * row + 2).min(rows) {
                springs.pull_row(z, y, pull);
                let (right, z) = (&right[y * columns..][..columns], &z[y * columns..][..columns]);
                for (pull, (right, (z, diagonal))) in
                    pull.iter_mut().zip(right.iter().zip(z.iter().zip(springs.diagonal_row(y))))
                {
                    *pull = if *diagonal > 0.0 { right + *pull - diagonal * z } else { 0.0 };
                }
                for (sum, residuals) in sums.iter_mut().zip(pull.chunks(2)) {
                    residuals.iter().for_each(|residual| *sum += residual);
                }
            }
        },
    );
}

/// The springs' matrix times `x` at the open cells, and the dot product of both, to which known cells add nothing.
fn times(fine: &Fine, x: &[f64], result: &mut [f64]) -> f64 {
    let (columns, _) = fine.size();
    let rows = result.par_chunks_mut(columns).enumerate().with_min_len(BAND_ROWS);
    let pieces: Vec<f64> = rows
        .map(|(y, result)| {
            sum_beside(x, fine.size(), y, result);
            let x = &x[y * columns..][..columns];
            for (result, (x, count)) in result.iter_mut().zip(x.iter().zip(fine.diagonal_row(y))) {
                *result = if *count > 0.0 { f64::from(*count) * x - *result } else { 0.0 };
            }
            dot_row(result, x)
        })
        .collect();
    pieces.iter().sum()
}

/// The products' sum, in one order.
fn dot_row<A: Copy + Into<f64>>(a: &[A], b: &[f64]) -> f64 {
    let (many_a, rest_a) = a.as_chunks::<LANES>();
    let (many_b, rest_b) = b.as_chunks::<LANES>();
    let mut sums = [0.0; LANES];
    for (a, b) in many_a.iter().zip(many_b) {
        for (sum, (a, b)) in sums.iter_mut().zip(a.iter().zip(b)) {
            *sum += (*a).into() * b;
        }
    }
    sums.iter().sum::<f64>() + rest_a.iter().zip(rest_b).map(|(a, b)| (*a).into() * b).sum::<f64>()
}

fn dot<A: Copy + Into<f64> + Sync>(columns: usize, a: &[A], b: &[f64]) -> f64 {
    let pieces: Vec<f64> =
        a.par_chunks(columns).zip(b.par_chunks(columns)).with_min_len(BAND_ROWS).map(|(a, b)| dot_row(a, b)).collect();
    pieces.iter().sum()
}

fn add(columns: usize, target: &mut [f64], factor: f64, other: &[f64]) {
    target.par_chunks_mut(columns).zip(other.par_chunks(columns)).with_min_len(BAND_ROWS).for_each(
        |(target, other)| {
            target.iter_mut().zip(other).for_each(|(target, other)| *target += factor * other);
        },
    );
}

/// Open cells of `surface` are zero at the begin.
fn solve(surface: &mut Surface, unknown: &[bool]) {
    let (columns, rows) = (surface.columns, surface.rows);
    let fine = Fine::new(columns, rows, unknown);
    let mut levels: Vec<Level> = Vec::new();
    let (mut wide, mut tall) = (columns, rows);
    while wide * tall > 8 {
        let level = match levels.last() {
            None => coarser(&fine),
            Some(Level { columns, rows, east, south, diagonal, .. }) => {
                coarser(&Matrix { columns: *columns, rows: *rows, east, south, diagonal })
            }
        };
        (wide, tall) = (level.columns, level.rows);
        levels.push(level);
    }
    // With zeros at the open cells, the residual is what the known cells pull.
    let mut residual = vec![0.0; surface.values.len()];
    times(&fine, &surface.values, &mut residual);
    residual.par_iter_mut().for_each(|value| *value = -*value);
    let enough = dot(columns, &residual, &residual) * TOLERANCE * TOLERANCE;
    let mut direction = vec![0.0; residual.len()];
    let mut product = vec![0.0; residual.len()];
    let mut right = vec![0f32; residual.len()];
    let mut z = vec![0f32; residual.len()];
    let mut spare = vec![0f32; residual.len()];
    let mut before = 0.0;
    for step in 0..MOST_STEPS {
        let norm = dot(columns, &residual, &residual);
        if norm <= enough {
            break;
        }
        let size = norm.sqrt();
        // Scaled to one, so that single precision serves to the end.
        right.par_iter_mut().zip(&residual).for_each(|(right, residual)| *right = (residual / size) as f32);
        cycle(&fine, &right, &mut z, &mut spare, &mut levels);
        let now = dot(columns, &z, &residual) * size;
        let keep = if step == 0 { 0.0 } else { now / before };
        before = now;
        direction
            .par_iter_mut()
            .zip(&z)
            .for_each(|(direction, z)| *direction = f64::from(*z) * size + keep * *direction);
        let curvature = times(&fine, &direction, &mut product);
        if curvature <= 0.0 || !curvature.is_finite() {
            break;
        }
        let length = now / curvature;
        add(columns, &mut surface.values, length, &direction);
        add(columns, &mut residual, -length, &product);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The cell's value, as often as it has neighbours, less theirs.
    fn residual_of(values: &[f64], cell: usize, x: usize, y: usize, columns: usize, rows: usize) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        let mut add = |other: usize| {
            sum += values[other];
            count += 1.0;
        };
        if x > 0 {
            add(cell - 1);
        }
        if x + 1 < columns {
            add(cell + 1);
        }
        if y > 0 {
            add(cell - columns);
        }
        if y + 1 < rows {
            add(cell + columns);
        }
        count * values[cell] - sum
    }

    #[test]
    fn planes_and_hollows() {
        // A hole in a plane is the plane again.
        let (columns, rows) = (40, 30);
        let plane = |cell: usize| 500.0 + 2.0 * (cell % columns) as f64 - 0.5 * (cell / columns) as f64;
        let mut values: Vec<f64> = (0..columns * rows).map(plane).collect();
        for y in 5..25 {
            values[y * columns + 7..y * columns + 33].fill(f64::NAN);
        }
        let mut surface = Surface { columns, rows, values };
        inpaint(&mut surface);
        for (cell, value) in surface.values.iter().enumerate() {
            assert!((value - plane(cell)).abs() < 1e-5, "cell {cell}: {value} for {}", plane(cell));
        }
        // One known cell makes everything level; none leaves everything open.
        let mut level = Surface { columns, rows, values: vec![f64::NAN; columns * rows] };
        inpaint(&mut level);
        assert!(level.values[0].is_nan());
        level.values[77] = 12.0;
        inpaint(&mut level);
        assert!(level.values.iter().all(|value| (value - 12.0).abs() < 1e-6));
    }

    #[test]
    fn few_cells_far_apart_are_the_springs_rest() {
        for (columns, rows) in [(301, 203), (1, 500), (900, 4), (2, 2)] {
            let mut surface = Surface { columns, rows, values: vec![f64::NAN; columns * rows] };
            for (index, cell) in (0..columns * rows).step_by((columns * rows / 9).max(1)).enumerate() {
                surface.values[cell] = 4000.0 + 37.0 * (index * 7 % 5) as f64;
            }
            let known = surface.clone();
            inpaint(&mut surface);
            for cell in 0..columns * rows {
                let value = surface.values[cell];
                if known.values[cell].is_nan() {
                    let off = residual_of(&surface.values, cell, cell % columns, cell / columns, columns, rows);
                    assert!(off.abs() < 1e-6, "{columns} × {rows}, cell {cell}: pulled by {off}");
                } else {
                    assert!((value - known.values[cell]).abs() < 1e-9);
                }
            }
        }
    }
}
