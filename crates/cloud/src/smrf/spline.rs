//! Bicubic splines through the centres of cells, without a knot at the second and the last but one (de Boor, *A
//! Practical Guide to Splines*, 1978): what FITPACK's `regrid` gives without smoothing.

use rayon::prelude::*;

use super::surface::Surface;

/// Non-zero basis functions at a place, and the first one's number.
fn basis(at: f64, count: usize) -> (usize, [f64; 4]) {
    let last = (count - 1) as f64;
    let at = at.clamp(0.0, last);
    // Knots: four at 0, then 2, 3, …, count − 3, then four at count − 1.
    let knot = |index: usize| match index {
        0..=3 => 0.0,
        _ if index < count => (index - 2) as f64,
        _ => last,
    };
    let span = if count == 4 || at < 2.0 { 3 } else { (at as usize + 2).min(count - 1) };
    let mut values = [1.0, 0.0, 0.0, 0.0];
    for degree in 1..4 {
        let mut saved = 0.0;
        for index in 0..degree {
            let (low, high) = (knot(span + 1 + index - degree), knot(span + 1 + index));
            let part = values[index] / (high - low);
            values[index] = saved + (high - at) * part;
            saved = (at - low) * part;
        }
        values[degree] = saved;
    }
    (span - 3, values)
}

/// The matrix of the basis functions at whole places, factored into triangles; it is totally positive, so that no
/// pivots are needed (de Boor & Pinkus 1977). Row i holds columns i − 3 … i + 3.
fn factored(count: usize) -> Vec<[f64; 7]> {
    let mut band = vec![[0.0; 7]; count];
    for (row, band) in band.iter_mut().enumerate() {
        let (first, values) = basis(row as f64, count);
        for (index, value) in values.into_iter().enumerate() {
            if value != 0.0 {
                band[first + index + 3 - row] = value;
            }
        }
    }
    for row in 0..count {
        for below in row + 1..(row + 4).min(count) {
            let factor = band[below][row + 3 - below] / band[row][3];
            band[below][row + 3 - below] = factor;
            for column in row + 1..(row + 4).min(count) {
                let upper = band[row][column + 3 - row];
                if upper != 0.0 && column + 3 >= below && column + 3 - below < 7 {
                    band[below][column + 3 - below] -= factor * upper;
                }
            }
        }
    }
    band
}

/// A surface between the centres of its cells.
pub struct Spline {
    coefficients: Surface,
    /// Column and row of the first coefficient, where these are a part.
    first: (usize, usize),
    /// Columns and rows of the whole surface.
    size: (usize, usize),
}

impl Spline {
    /// # Panics
    /// When there are fewer than four columns or rows.
    pub fn new(surface: Surface) -> Spline {
        let mut surface = surface;
        let (columns, rows) = (surface.columns, surface.rows);
        assert!(columns >= 4 && rows >= 4, "a cubic spline needs four cells each way");
        let band = factored(columns);
        surface.values.par_chunks_mut(columns).for_each(|row| {
            for at in 0..columns {
                for before in at.saturating_sub(3)..at {
                    row[at] -= band[at][before + 3 - at] * row[before];
                }
            }
            for at in (0..columns).rev() {
                for after in at + 1..(at + 4).min(columns) {
                    row[at] -= band[at][after + 3 - at] * row[after];
                }
                row[at] /= band[at][3];
            }
        });
        let band = factored(rows);
        for at in 0..rows {
            for before in at.saturating_sub(3)..at {
                subtract(&mut surface.values, columns, at, before, band[at][before + 3 - at]);
            }
        }
        for at in (0..rows).rev() {
            for after in at + 1..(at + 4).min(rows) {
                subtract(&mut surface.values, columns, at, after, band[at][after + 3 - at]);
            }
            let pivot = band[at][3];
            surface.values[at * columns..(at + 1) * columns].iter_mut().for_each(|value| *value /= pivot);
        }
        Spline { coefficients: surface, first: (0, 0), size: (columns, rows) }
    }

    /// A part of a surface of `size` columns and rows, out of the coefficients from column and row `first`.
    pub fn part(coefficients: Surface, first: (usize, usize), size: (usize, usize)) -> Spline {
        Spline { coefficients, first, size }
    }

    /// A number for each cell.
    pub fn into_coefficients(self) -> Surface {
        self.coefficients
    }

    /// The height at a place in cells, 0 being the outer edge of the first cell.
    pub fn value(&self, column: f64, row: f64) -> f64 {
        let (first_column, across) = basis(column - 0.5, self.size.0);
        let (first_row, down) = basis(row - 0.5, self.size.1);
        let (first_column, first_row) = (first_column - self.first.0, first_row - self.first.1);
        (0..4)
            .map(|y| {
                let row = &self.coefficients.row(first_row + y)[first_column..first_column + 4];
                down[y] * row.iter().zip(across).map(|(c, b)| c * b).sum::<f64>()
            })
            .sum()
    }
}

/// Row `target` less `factor` times row `source`.
fn subtract(values: &mut [f64], columns: usize, target: usize, source: usize, factor: f64) {
    if factor == 0.0 {
        return;
    }
    let (low, high) = values.split_at_mut(target.max(source) * columns);
    let (target, source) = if target > source {
        (&mut high[..columns], &low[source * columns..(source + 1) * columns])
    } else {
        (&mut low[target * columns..(target + 1) * columns], &high[..columns])
    };
    target.iter_mut().zip(source).for_each(|(target, source)| *target -= factor * source);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cubic_surfaces_come_back() {
        for (columns, rows) in [(4, 4), (5, 9), (6, 4), (17, 23)] {
            // Without those knots, a spline reproduces every bicubic surface.
            let height = |x: f64, y: f64| {
                let (x, y) = (x - 3.0, y - 4.0);
                1.0 + x - 0.5 * y * y + 0.03 * x * x * x - 0.02 * x * x * y * y * y
            };
            let mut values = Vec::new();
            for y in 0..rows {
                for x in 0..columns {
                    values.push(height(x as f64, y as f64));
                }
            }
            let spline = Spline::new(Surface { columns, rows, values });
            for step in 0..200 {
                let x = (columns - 1) as f64 * f64::from(step) / 199.0;
                let y = (rows - 1) as f64 * f64::from(step * 37 % 200) / 199.0;
                let (got, wanted) = (spline.value(x + 0.5, y + 0.5), height(x, y));
                assert!(
                    (got - wanted).abs() < 1e-9 * wanted.abs().max(1.0),
                    "{columns}×{rows} at {x}, {y}: {got} {wanted}"
                );
            }
        }
    }
}
