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

    pub fn clear(&mut self) {
        self.values.clear();
    }

    /// Smooths a patch of this width.
    pub fn take(&mut self, patch: &[f64], width: usize) {
        let narrow = width - 2 * REACH_PX;
        let rows = patch.len() / width;
        self.along.clear();
        self.along.resize(rows * narrow, 0.0);
        for (out, row) in self.along.chunks_exact_mut(narrow).zip(patch.chunks_exact(width)) {
            for (k, weight) in WEIGHTS.iter().enumerate() {
                out.iter_mut().zip(&row[k..]).for_each(|(sum, value)| *sum += weight * value);
            }
        }
        self.values.clear();
        self.values.resize((rows - 2 * REACH_PX) * narrow, 0.0);
        for (row, out) in self.values.chunks_exact_mut(narrow).enumerate() {
            for (k, weight) in WEIGHTS.iter().enumerate() {
                let line = &self.along[(row + k) * narrow..][..narrow];
                out.iter_mut().zip(line).for_each(|(sum, value)| *sum += weight * value);
            }
        }
    }
}

/// Takes so many cells off each side of a patch.
pub fn crop(patch: &mut Vec<f64>, width: usize, cells: usize) {
    let (rows, narrow) = (patch.len() / width - 2 * cells, width - 2 * cells);
    for row in 0..rows {
        let from = (row + cells) * width + cells;
        patch.copy_within(from..from + narrow, row * narrow);
    }
    patch.truncate(rows * narrow);
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
            let mut inner = patch;
            crop(&mut inner, width, REACH_PX);
            (smooth.values().to_vec(), inner)
        };
        let (smooth, inner) = of(&|x, y| 3.0 * x as f64 - 7.0 * y as f64);
        assert_eq!(smooth.len(), (width - 4) * (rows - 4));
        assert!(smooth.iter().zip(&inner).all(|(a, b)| (a - b).abs() < 1e-12));
        let (smooth, inner) = of(&|x, _| if x.is_multiple_of(2) { 1.0 } else { -1.0 });
        assert!(smooth.iter().all(|v| v.abs() < 1e-12) && inner.iter().all(|v| v.abs() == 1.0));
    }
}
