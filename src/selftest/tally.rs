//! Counting what a detector makes of planted marks.

use std::collections::BTreeMap;

use crate::candidate::Candidate;
use crate::matching::field::Field;
use autoref_raster::coords::PixelPoint;
use autoref_raster::normal::WITHIN_95;
use autoref_raster::ranks::upper_median;

/// Side of the squares of ground whose marks share their troubles (a red roof, a clay court), pixels.
const SQUARE_PX: f64 = 512.0;

/// How many marks were found, and how far from their centres.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    /// Marks planted.
    pub marks: usize,
    /// Found − true of those found, pixels.
    pub errors: Vec<[f64; 2]>,
    /// The same over the standard deviations that the detector states.
    pub normalised: Vec<f64>,
    /// Marks and found ones of every square of ground.
    pub squares: BTreeMap<(i64, i64), [usize; 2]>,
}

/// How far from its centre a mark of the given side may be found, pixels.
pub fn reach_px(side_px: f64) -> f64 {
    (side_px / 2.0).max(2.0)
}

impl Tally {
    /// Counts marks of one side at the true places; a mark is found when a candidate lies within half its side. The
    /// places count from `origin`, which tells their squares of ground from those of other pictures.
    pub fn add(&mut self, origin: (f64, f64), truth: &[(f64, f64)], found: &[Candidate], side_px: f64) {
        let field = Field::new(found.iter().map(|c| c.centre).collect(), None);
        for &(x, y) in truth {
            let nearest = field.nearest(PixelPoint { x, y }, reach_px(side_px));
            self.count(origin, (x, y), nearest.map(|(i, _)| &found[i]));
        }
    }

    /// Counts one mark, at a place from `origin`, and the candidate that is it, if any.
    pub fn count(&mut self, origin: (f64, f64), (x, y): (f64, f64), found: Option<&Candidate>) {
        self.marks += 1;
        let square = |origin: f64, v: f64| ((origin + v) / SQUARE_PX).floor() as i64;
        let [marks, hits] = self.squares.entry((square(origin.0, x), square(origin.1, y))).or_default();
        *marks += 1;
        *hits += usize::from(found.is_some());
        let Some(best) = found else { return };
        let e = [best.centre.x - x, best.centre.y - y];
        self.errors.push(e);
        if let Some(v) = best.covariance_px2 {
            self.normalised.extend([e[0] / v[0].sqrt(), e[1] / v[2].sqrt()]);
        }
    }

    /// Marks that were found.
    pub fn found(&self) -> usize {
        self.errors.len()
    }

    /// Share of the marks that were found; 0 without marks.
    pub fn recall(&self) -> f64 {
        self.found() as f64 / self.marks.max(1) as f64
    }

    /// Variance of the number found, from how the squares of ground differ: C / (C − 1) · Σ (found − recall · marks)²
    /// over C squares, the variance of a ratio of clusters (W. G. Cochran, "Sampling techniques", 3rd edition, 1977,
    /// section 9A.2 and equation 6.13), to which a bootstrap over the squares converges.
    pub fn clustered_variance(&self) -> f64 {
        let (count, recall) = (self.squares.len() as f64, self.recall());
        let square = |[marks, found]: &[usize; 2]| (*found as f64 - recall * *marks as f64).powi(2);
        if count < 2.0 { 0.0 } else { count / (count - 1.0) * self.squares.values().map(square).sum::<f64>() }
    }

    /// How many times the variance is that of as many independent marks, at least 1: marks on one piece of ground tell
    /// less than marks on several.
    pub fn design_effect(&self) -> f64 {
        let independent = self.marks as f64 * self.recall() * (1.0 - self.recall());
        if independent > 0.0 { (self.clustered_variance() / independent).max(1.0) } else { 1.0 }
    }

    /// 95 % interval of the recall (E. B. Wilson, "Probable inference, the law of succession, and statistical
    /// inference",
    /// 1927) of as many marks as are worth these by their [`design_effect`](Self::design_effect) (E. L. Korn, B. I.
    /// Graubard, "Confidence intervals for proportions with small expected number of positive counts estimated from
    /// survey data", 1998); 0 to 1 without marks.
    pub fn recall_95(&self) -> (f64, f64) {
        if self.marks == 0 {
            return (0.0, 1.0);
        }
        let (n, p, z2) = (self.marks as f64 / self.design_effect(), self.recall(), WITHIN_95 * WITHIN_95);
        let middle = (p + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = WITHIN_95 / (1.0 + z2 / n) * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
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
        upper_median(&mut absolute)
    }

    /// Root mean square of error over stated standard deviation: 1 is honest.
    pub fn normalised(&self) -> f64 {
        (self.normalised.iter().map(|v| v * v).sum::<f64>() / self.normalised.len().max(1) as f64).sqrt()
    }
}

/// 95 % interval of a Poisson count (the normal approximation of its cube root, E. B. Wilson and M. M. Hilferty, 1931):
/// exact to a few per cent from zero on.
pub fn poisson_95(count: usize) -> (f64, f64) {
    let bound = |k: f64, z: f64| k * (1.0 - 1.0 / (9.0 * k) + z / (3.0 * k.sqrt())).powi(3);
    let low = if count == 0 { 0.0 } else { bound(count as f64, -WITHIN_95).max(0.0) };
    (low, bound(count as f64 + 1.0, WITHIN_95))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found_at_origin() -> Candidate {
        Candidate::at(PixelPoint { x: 0.0, y: 0.0 })
    }

    #[test]
    fn marks_that_share_their_ground_count_as_fewer() {
        let mut tally = Tally::default();
        // Four squares of ten marks; one square finds none.
        for (i, found) in (0..4).flat_map(|square| (0..10).map(move |_| (square, square > 0))) {
            let candidate = found_at_origin();
            tally.count((600.0 * f64::from(i), 0.0), (1.0, 1.0), found.then_some(&candidate));
        }
        // By hand: recall 0.75; Σ (found − 7.5)² = 3·2.5² + 7.5² = 75, times 4/3; of independent marks 40·0.75·0.25 =
        // 7.5.
        assert!((tally.clustered_variance() - 100.0).abs() < 1e-9);
        assert!((tally.design_effect() - 100.0 / 7.5).abs() < 1e-9);
        let independent = Tally { marks: 40, errors: vec![[0.0; 2]; 30], ..Tally::default() };
        let width = |(low, high): (f64, f64)| high - low;
        assert!(width(tally.recall_95()) > 2.0 * width(independent.recall_95()));
    }

    /// Images of 60 squares of ground of which one in ten is bad: the interval holds the truth as often as it says, the
    /// one that takes marks for independent does not.
    #[test]
    fn the_interval_holds_on_ground_that_differs() {
        let mut random = autoref_synth::plant::Random(77);
        let truth = 0.9 * 0.98 + 0.1 * 0.4;
        let (mut held, mut held_independent) = (0, 0);
        for _ in 0..400 {
            let mut tally = Tally::default();
            for square in 0..60 {
                let chance = if random.unit() < 0.1 { 0.4 } else { 0.98 };
                for _ in 0..8 {
                    let candidate = found_at_origin();
                    let found = random.unit() < chance;
                    tally.count((SQUARE_PX * f64::from(square), 0.0), (1.0, 1.0), found.then_some(&candidate));
                }
            }
            let holds = |(low, high): (f64, f64)| usize::from((low..=high).contains(&truth));
            held += holds(tally.recall_95());
            held_independent += holds(Tally { squares: BTreeMap::new(), ..tally }.recall_95());
        }
        assert!(held >= 360, "{held} of 400");
        assert!(held_independent < 300, "{held_independent} of 400 without the squares");
    }

    #[test]
    fn intervals_of_known_counts() {
        // Wilson's interval of 8 in 10, from his formula by hand: 0.490 to 0.943.
        let tally = Tally { marks: 10, errors: vec![[0.0; 2]; 8], ..Tally::default() };
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
