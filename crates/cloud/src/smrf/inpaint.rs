//! Holes in surfaces, filled as if springs joined neighbouring cells (D'Errico, *inpaint_nans*, 2004, method 4, as Pingel
//! et al. use it): the heights with the least sum of squared differences between the four neighbours.
//!
//! The normal equations are solved by conjugate gradients (Hestenes & Stiefel 1952), begun with the answer of a surface of
//! half the size. All sums run in a fixed order.

use rayon::prelude::*;

use super::surface::Surface;

/// The residual, relative to the right-hand side's, at which a solution is good enough.
const TOLERANCE: f64 = 1e-9;
/// Unknowns of one piece of work; fixed, because sums are taken piece by piece.
const CHUNK: usize = 1 << 13;
/// Holes this small need no first guess.
const SMALL: usize = 256;
const KNOWN: u32 = u32::MAX;

/// Gives every NaN cell of `surface` a height. A surface without any known cell stays as it is.
pub fn inpaint(surface: &mut Surface) {
    let unknown: Vec<u32> =
        (0..surface.values.len()).filter(|&cell| surface.values[cell].is_nan()).map(|cell| cell as u32).collect();
    if unknown.is_empty() || unknown.len() == surface.values.len() {
        return;
    }
    let guess = first_guess(surface, &unknown);
    let solution = solve(surface, &unknown, guess);
    for (&cell, height) in unknown.iter().zip(solution) {
        surface.values[cell as usize] = height;
    }
}

/// The answer of the surface at half the size, spread out again.
fn first_guess(surface: &Surface, unknown: &[u32]) -> Vec<f64> {
    let (columns, rows) = (surface.columns, surface.rows);
    let (wide, tall) = (columns.div_ceil(2), rows.div_ceil(2));
    if unknown.len() <= SMALL || wide.min(tall) < 2 {
        let known = surface.values.iter().filter(|value| !value.is_nan());
        let (count, sum) = known.fold((0, 0.0), |(count, sum), value| (count + 1, sum + value));
        return vec![sum / f64::from(count); unknown.len()];
    }
    let mut coarse = Surface { columns: wide, rows: tall, values: vec![f64::NAN; wide * tall] };
    for y in 0..tall {
        for x in 0..wide {
            let (mut count, mut sum) = (0, 0.0);
            for row in 2 * y..(2 * y + 2).min(rows) {
                for &value in &surface.row(row)[2 * x..(2 * x + 2).min(columns)] {
                    if !value.is_nan() {
                        count += 1;
                        sum += value;
                    }
                }
            }
            if count > 0 {
                coarse.values[y * wide + x] = sum / f64::from(count);
            }
        }
    }
    inpaint(&mut coarse);
    let between = |at: usize, count: usize| {
        let place = (at as f64 + 0.5) / 2.0 - 0.5;
        let low = (place.floor().max(0.0) as usize).min(count - 1);
        let high = (low + 1).min(count - 1);
        (low, high, (place - low as f64).clamp(0.0, 1.0))
    };
    unknown
        .par_iter()
        .map(|&cell| {
            let (west, east, right) = between(cell as usize % columns, wide);
            let (north, south, down) = between(cell as usize / columns, tall);
            let along = |row: usize| coarse.row(row)[west] * (1.0 - right) + coarse.row(row)[east] * right;
            along(north) * (1.0 - down) + along(south) * down
        })
        .collect()
}

struct Springs<'a> {
    surface: &'a Surface,
    unknown: &'a [u32],
    /// Place of a cell among the unknowns.
    slot: Vec<u32>,
}

impl Springs<'_> {
    /// The neighbours inside the surface.
    fn neighbours(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (columns, rows) = (self.surface.columns, self.surface.rows);
        let (x, y) = (cell % columns, cell / columns);
        let west = (x > 0).then(|| cell - 1);
        let east = (x + 1 < columns).then(|| cell + 1);
        let north = (y > 0).then(|| cell - columns);
        let south = (y + 1 < rows).then(|| cell + columns);
        [west, east, north, south].into_iter().flatten()
    }

    /// What known neighbours pull, and how many neighbours there are.
    fn pull(&self, cell: usize) -> (f64, f64) {
        self.neighbours(cell).fold((0.0, 0.0), |(pull, count), other| {
            let value = self.surface.values[other];
            (if self.slot[other] == KNOWN { pull + value } else { pull }, count + 1.0)
        })
    }

    /// The springs' matrix times `x`; handed over with the dot product of both.
    fn times(&self, x: &[f64], result: &mut [f64]) -> f64 {
        let pieces: Vec<f64> = result
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(piece, result)| {
                let mut dot = 0.0;
                for (at, result) in (piece * CHUNK..).zip(result) {
                    let (mut sum, mut count) = (0.0, 0.0);
                    for other in self.neighbours(self.unknown[at] as usize) {
                        count += 1.0;
                        let slot = self.slot[other];
                        if slot != KNOWN {
                            sum += x[slot as usize];
                        }
                    }
                    *result = count * x[at] - sum;
                    dot += *result * x[at];
                }
                dot
            })
            .collect();
        pieces.iter().sum()
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let pieces: Vec<f64> =
        a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum()).collect();
    pieces.iter().sum()
}

fn add(target: &mut [f64], factor: f64, other: &[f64]) {
    target.par_chunks_mut(CHUNK).zip(other.par_chunks(CHUNK)).for_each(|(target, other)| {
        target.iter_mut().zip(other).for_each(|(target, other)| *target += factor * other);
    });
}

fn solve(surface: &Surface, unknown: &[u32], guess: Vec<f64>) -> Vec<f64> {
    let mut slot = vec![KNOWN; surface.values.len()];
    for (at, &cell) in unknown.iter().enumerate() {
        slot[cell as usize] = at as u32;
    }
    let springs = Springs { surface, unknown, slot };
    let mut x = guess;
    let mut product = vec![0.0; x.len()];
    springs.times(&x, &mut product);
    // Heights count from the mean of the guess, so that the tolerance does not depend on the datum.
    let origin = x.iter().sum::<f64>() / x.len() as f64;
    let mut residual = Vec::with_capacity(x.len());
    let mut scale = 0.0;
    for (at, &cell) in unknown.iter().enumerate() {
        let (pull, _) = springs.pull(cell as usize);
        let known = springs.neighbours(cell as usize).filter(|&other| springs.slot[other] == KNOWN).count();
        let about = pull - origin * known as f64;
        scale += about * about;
        residual.push(pull - product[at]);
    }
    let enough = scale * TOLERANCE * TOLERANCE;
    let mut direction = residual.clone();
    let mut norm = dot(&residual, &residual);
    for _ in 0..4 * x.len() + 100 {
        if norm <= enough {
            break;
        }
        let curvature = springs.times(&direction, &mut product);
        if curvature <= 0.0 {
            break;
        }
        let step = norm / curvature;
        add(&mut x, step, &direction);
        add(&mut residual, -step, &product);
        let next = dot(&residual, &residual);
        let keep = next / norm;
        direction.par_chunks_mut(CHUNK).zip(residual.par_chunks(CHUNK)).for_each(|(direction, residual)| {
            direction
                .iter_mut()
                .zip(residual)
                .for_each(|(direction, residual)| *direction = residual + keep * *direction);
        });
        norm = next;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
