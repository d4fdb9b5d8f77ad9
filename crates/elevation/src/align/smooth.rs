//! The template, smoothed, whose gradient tells the shift.
//!
//! A model that is moved by a part of a cell is interpolated, and what varies from cell to cell then comes to lie a
//! little off its place: a systematic error, to which the scatter of residuals is blind. Seen through a smooth
//! gradient those variations have no say: on ground whose amplitudes fall with the power 1.9 of the frequency the bias
//! is a sixth to a quarter of that without, and the standard error a tenth larger.

/// Half the width of the smoothing.
pub const REACH_PX: usize = 2;
const WEIGHTS: [f64; 2 * REACH_PX + 1] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

/// A smoothed patch, and the buffer that it is made with.
#[derive(Default)]
pub struct Smooth {
    values: Vec<f64>,
    along: Vec<f64>,
}

impl Smooth {
    /// Row by row; [`REACH_PX`] narrower on each side than what it was made of. NaN beside NaN.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Takes all values out.
    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Smooths a patch of this width.
    pub fn take(&mut self, patch: &[f64], width: usize) {
        let narrow = width - 2 * REACH_PX;
        let rows = patch.len() / width;
        self.along.resize(rows * narrow, 0.0);
        for (out, row) in self.along.chunks_exact_mut(narrow).zip(patch.chunks_exact(width)) {
            weigh(out, |k| &row[k..][..narrow]);
        }
        self.values.resize((rows - 2 * REACH_PX) * narrow, 0.0);
        for (row, out) in self.values.chunks_exact_mut(narrow).enumerate() {
            weigh(out, |k| &self.along[(row + k) * narrow..][..narrow]);
        }
    }
}

/// The weighed sums of neighbours along one axis.
fn weigh<'c>(out: &mut [f64], neighbours: impl Fn(usize) -> &'c [f64]) {
    let [a, b, c, d, e] = std::array::from_fn(neighbours);
    let [p, q, r, s, t] = WEIGHTS;
    let cells = a.iter().zip(b).zip(c).zip(d.iter().zip(e));
    out.iter_mut().zip(cells).for_each(|(sum, (((a, b), c), (d, e)))| *sum = p * a + q * b + r * c + s * d + t * e);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn planes_stay_and_the_finest_stripes_go() {
        let (width, rows) = (11, 9);
        let of = |height: &dyn Fn(usize, usize) -> f64| {
            let patch: Vec<f64> = (0..width * rows).map(|i| height(i % width, i / width)).collect();
            let mut smooth = Smooth::default();
            smooth.take(&patch, width);
            let rows = patch.chunks(width).skip(REACH_PX).take(rows - 2 * REACH_PX);
            let inner = rows.flat_map(|row| row[REACH_PX..width - REACH_PX].to_vec());
            (smooth.values().to_vec(), inner.collect::<Vec<f64>>())
        };
        let (smooth, inner) = of(&|x, y| 3.0 * x as f64 - 7.0 * y as f64);
        assert_eq!(smooth.len(), (width - 4) * (rows - 4));
        assert!(smooth.iter().zip(&inner).all(|(a, b)| (a - b).abs() < 1e-12));
        let (smooth, inner) = of(&|x, _| if x.is_multiple_of(2) { 1.0 } else { -1.0 });
        assert!(smooth.iter().all(|v| v.abs() < 1e-12) && inner.iter().all(|v| v.abs() == 1.0));
    }
}
