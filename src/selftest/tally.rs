//! Counting what a detector makes of planted marks.

use crate::candidate::Candidate;
use crate::coords::PixelPoint;
use crate::matching::field::Field;

/// 97.5 % quantile of the standard normal distribution.
const Z_95: f64 = 1.959_964;

/// How many marks were found, and how far from their centres.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Marks planted.
    pub marks: usize,
    /// Found − true of those found, pixels.
    pub errors: Vec<[f64; 2]>,
    /// The same over the standard deviations that the detector states.
    pub normalised: Vec<f64>,
}

/// How far from its centre a mark of the given side may be found, pixels.
pub fn reach_px(side_px: f64) -> f64 {
    (side_px / 2.0).max(2.0)
}

impl Tally {
    /// Counts marks of one side at the true places; a mark is found when a candidate lies within half its side.
    pub fn add(&mut self, truth: &[(f64, f64)], found: &[Candidate], side_px: f64) {
        let field = Field::new(found.iter().map(|c| c.centre).collect(), None);
        for &(x, y) in truth {
            let nearest = field.nearest(PixelPoint { x, y }, reach_px(side_px));
            self.count((x, y), nearest.map(|(i, _)| &found[i]));
        }
    }

    /// Counts one mark and the candidate that is it, if any.
    pub fn count(&mut self, (x, y): (f64, f64), found: Option<&Candidate>) {
        self.marks += 1;
        let Some(best) = found else { return };
        let e = [best.centre.x - x, best.centre.y - y];
        self.errors.push(e);
        if let Some(v) = best.covariance_px2 {
            self.normalised.extend([e[0] / v[0].sqrt(), e[1] / v[2].sqrt()]);
        }
    }

    pub fn found(&self) -> usize {
        self.errors.len()
    }

    /// Share of the marks that were found; 0 without marks.
    pub fn recall(&self) -> f64 {
        self.found() as f64 / self.marks.max(1) as f64
    }

    /// 95 % interval of the recall (E. B. Wilson, "Probable inference, the law of succession, and statistical inference",
    /// 1927); 0 to 1 without marks.
    pub fn recall_95(&self) -> (f64, f64) {
        if self.marks == 0 {
            return (0.0, 1.0);
        }
        let (n, p, z2) = (self.marks as f64, self.recall(), Z_95 * Z_95);
        let middle = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = Z_95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
        ((middle - half).max(0.0), (middle + half).min(1.0))
    }

    /// Mean error of x and y, pixels.
    pub fn bias_px(&self) -> [f64; 2] {
        let n = self.found().max(1) as f64;
        [0, 1].map(|k| self.errors.iter().map(|e| e[k]).sum::<f64>() / n)
    }

    /// Root mean square error per axis, pixels.
    pub fn rmse_px(&self) -> f64 {
        let n = self.found().max(1) as f64;
        (self.errors.iter().map(|e| e[0] * e[0] + e[1] * e[1]).sum::<f64>() / (2.0 * n)).sqrt()
    }

    /// Median of the absolute error of an axis, pixels; `None` when nothing was found.
    pub fn median_px(&self) -> Option<f64> {
        let mut absolute: Vec<f64> = self.errors.iter().flatten().map(|v| v.abs()).collect();
        absolute.sort_by(f64::total_cmp);
        absolute.get(absolute.len() / 2).copied()
    }

    /// Root mean square of error over stated standard deviation: 1 is honest.
    pub fn normalised(&self) -> f64 {
        (self.normalised.iter().map(|v| v * v).sum::<f64>() / self.normalised.len().max(1) as f64).sqrt()
    }
}

/// 95 % interval of a Poisson count (the normal approximation of its cube root, E. B. Wilson and M. M. Hilferty, 1931): exact
/// to a few per cent from zero on.
pub fn poisson_95(count: usize) -> (f64, f64) {
    let bound = |k: f64, z: f64| k * (1.0 - 1.0 / (9.0 * k) + z / (3.0 * k.sqrt())).powi(3);
    let low = if count == 0 { 0.0 } else { bound(count as f64, -Z_95).max(0.0) };
    (low, bound(count as f64 + 1.0, Z_95))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_of_known_counts() {
        // Wilson's interval of 8 in 10, from his formula by hand: 0.490 to 0.943.
        let tally = Tally { marks: 10, errors: vec![[0.0; 2]; 8], normalised: vec![] };
        let (low, high) = tally.recall_95();
        assert!((low - 0.4901).abs() < 1e-3 && (high - 0.9433).abs() < 1e-3, "{low} {high}");
        assert_eq!(Tally::default().recall_95(), (0.0, 1.0));
        // Exact Poisson limits: 0 → 0 and 3.69; 10 → 4.80 and 18.39.
        let (low, high) = poisson_95(0);
        assert!(low == 0.0 && (high - 3.69).abs() < 0.05, "{high}");
        let (low, high) = poisson_95(10);
        assert!((low - 4.80).abs() < 0.05 && (high - 18.39).abs() < 0.05, "{low} {high}");
    }
}
