//! How differences hang together over distance, and what that makes of the error of a mean.
//!
//! The empirical variogram is G. Matheron's, 1963, over pairs of differences on stable ground within three NMAD of the
//! median. Two spherical models are fitted to it. The variance of a mean is the mean covariance over all pairs of its
//! cells (T. Rolstad, T. Haug and B. Denby, *Spatially integrated geodetic glacier mass balance and its uncertainty
//! based on geostatistical analysis*, 2009; R. Hugonnet and others, *Uncertainty analysis of digital elevation models
//! by spatial inference from stable terrain*, 2022), here over a sample of the cells, not over a circle of equal area.

use serde::Serialize;

use crate::error::Result;

/// One class of distance.
#[derive(Clone, Debug, Serialize)]
pub struct Bin {
    pub lag_m: f64,
    pub semivariance_m2: f64,
    pub pairs: u64,
}

/// The classes of distance that hold enough pairs.
pub(super) struct LagClasses {
    pub bins: Vec<Bin>,
    /// How many independent values each rests on.
    pub values: Vec<f64>,
    /// The semivariances of all classes where one window is left out, window by window.
    pub without: Vec<Vec<f64>>,
}

/// The empirical variogram and the sum of two spherical models that was fitted to it.
#[derive(Clone, Debug, Serialize)]
pub struct Variogram {
    pub bins: Vec<Bin>,
    pub sills_m2: [f64; 2],
    pub ranges_m: [f64; 2],
}

fn spherical(h: f64, range: f64) -> f64 {
    if h >= range { 1.0 } else { 1.5 * h / range - 0.5 * (h / range).powi(3) }
}

impl Variogram {
    /// Of the fitted model.
    pub fn semivariance(&self, lag_m: f64) -> f64 {
        (0..2).map(|i| self.sills_m2[i] * spherical(lag_m, self.ranges_m[i])).sum()
    }

    /// The standard error of the mean of `n` cells, of which `places` are a sample, and the number of independent cells
    /// that would have the same. `None` where too few pairs of stable ground tell how differences hang together.
    /// `beside` is asked for the share of the cells about a cell that are there, too.
    ///
    /// # Errors
    /// Those of `beside`.
    pub fn mean_error(
        &self,
        n: u64,
        places: &[(u64, u64)],
        cell_m: (f64, f64),
        beside: impl FnOnce() -> Result<f64>,
    ) -> Result<Option<(f64, f64)>> {
        let total: f64 = self.sills_m2.iter().sum();
        if self.bins.is_empty() {
            return Ok(None);
        }
        if n == 0 || total <= 0.0 {
            return Ok(Some((0.0, n as f64)));
        }
        let area = n as f64 * cell_m.0 * cell_m.1;
        let is_short = |range: f64| range * range * 3.2 < 0.05 * area;
        let share = if self.ranges_m.iter().any(|range| is_short(*range)) { beside()? } else { 1.0 };
        let variance: f64 = (0..2)
            .map(|i| {
                let (sill, range) = (self.sills_m2[i], self.ranges_m[i]);
                let own = sill / n as f64;
                let others = if is_short(range) {
                    share * near_sum(range, cell_m) / n as f64
                } else {
                    pair_mean(places, range, cell_m)
                };
                own + sill * others
            })
            .sum();
        Ok(Some((variance.sqrt(), (total / variance).min(n as f64))))
    }
}

/// Sum of the correlations of a cell with all others around it, were they all there, where the range is short.
fn near_sum(range: f64, cell_m: (f64, f64)) -> f64 {
    let (across, down) = ((range / cell_m.0) as i64, (range / cell_m.1) as i64);
    if across.max(down) > 400 {
        // The integral of the correlation over the plane.
        return 0.2 * std::f64::consts::PI * range * range / (cell_m.0 * cell_m.1);
    }
    let mut sum = 0.0;
    for y in -down..=down {
        for x in -across..=across {
            if (x, y) != (0, 0) {
                sum += 1.0 - spherical((x as f64 * cell_m.0).hypot(y as f64 * cell_m.1), range);
            }
        }
    }
    sum
}

/// Mean correlation over all pairs of a sample.
fn pair_mean(places: &[(u64, u64)], range: f64, cell_m: (f64, f64)) -> f64 {
    let (mut sum, mut pairs) = (0.0, 0u64);
    for (i, a) in places.iter().enumerate() {
        for b in &places[i + 1..] {
            let (x, y) = (a.0 as f64 - b.0 as f64, a.1 as f64 - b.1 as f64);
            sum += 1.0 - spherical((x * cell_m.0).hypot(y * cell_m.1), range);
            pairs += 1;
        }
    }
    if pairs == 0 { 0.0 } else { sum / pairs as f64 }
}

/// Two models are believed when they fit so much better than one, in squared standard deviations of the classes: by
/// chance the best of all pairs of ranges is better by some of them. And when the sill of the second is so many times
/// (this, its root) the deviation that leaving out each of the windows gives it: where rough and smooth ground lie side
/// by side classes are known worse than their values say.
const BELIEVED: f64 = 16.0;
/// From a millimetre to the Moon.
const MOST_RANGES: usize = 128;
/// Fewer windows tell no deviation.
const FEWEST_WINDOWS: usize = 16;

/// A fit of two spherical models, of which one may have no sill.
#[derive(Clone, Copy)]
struct Fitted {
    misfit: f64,
    sills: [f64; 2],
    ranges: [f64; 2],
}

impl Fitted {
    fn at(&self, lag_m: f64) -> f64 {
        (0..2).map(|i| self.sills[i] * spherical(lag_m, self.ranges[i])).sum()
    }

    /// Squared standard deviations by which the classes miss it: a class's mean of squares is known as well as its
    /// different values allow.
    fn chi2(&self, classes: &LagClasses) -> f64 {
        let terms = classes.bins.iter().zip(&classes.values).map(|(bin, independent)| {
            let model = self.at(bin.lag_m);
            (model - bin.semivariance_m2).powi(2) * independent / (2.0 * model.max(f64::MIN_POSITIVE).powi(2))
        });
        terms.sum()
    }

    /// Whether both sills stand out from what leaving out single windows makes of them (J. W. Tukey's jackknife).
    fn stands_out(&self, classes: &LagClasses) -> bool {
        let n = classes.without.len() as f64;
        if classes.without.len() < FEWEST_WINDOWS {
            return true;
        }
        let lags: Vec<f64> = classes.bins.iter().map(|bin| bin.lag_m).collect();
        let solved: Vec<[f64; 2]> = classes.without.iter().map(|part| both_sills(&lags, part, self.ranges)).collect();
        (0..2).all(|k| {
            let mean = solved.iter().map(|sills| sills[k]).sum::<f64>() / n;
            let variance = (n - 1.0) / n * solved.iter().map(|sills| (sills[k] - mean).powi(2)).sum::<f64>();
            self.sills[k].powi(2) > BELIEVED * variance
        })
    }
}

/// The sums of a weighted least squares of two spherical models: its matrix and its right side.
fn normal(lags: &[f64], semivariances: &[f64], ranges: [f64; 2]) -> ([[f64; 2]; 2], [f64; 2]) {
    let (mut m, mut r) = ([[0.0; 2]; 2], [0.0; 2]);
    for (lag_m, semivariance) in lags.iter().zip(semivariances) {
        let weight = 1.0 / lag_m.sqrt();
        let f = ranges.map(|range| spherical(*lag_m, range));
        for a in 0..2 {
            r[a] += weight * f[a] * semivariance;
            for b in 0..2 {
                m[a][b] += weight * f[a] * f[b];
            }
        }
    }
    (m, r)
}

fn both_sills(lags: &[f64], semivariances: &[f64], ranges: [f64; 2]) -> [f64; 2] {
    let (m, r) = normal(lags, semivariances, ranges);
    let determinant = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    [(r[0] * m[1][1] - r[1] * m[0][1]) / determinant, (r[1] * m[0][0] - r[0] * m[1][0]) / determinant]
}

/// One spherical model, or two where the classes tell, by weighted least squares, sills not negative, over all pairs of
/// ranges of a ladder.
pub(super) fn fit(classes: LagClasses, cell_m: f64) -> Variogram {
    let bins = &classes.bins;
    let longest = bins.iter().map(|b| b.lag_m).fold(cell_m, f64::max);
    let mut ladder = vec![cell_m * 0.999];
    // Sides that are none make no ladder.
    while ladder[ladder.len() - 1] < longest && ladder.len() < MOST_RANGES {
        ladder.push(ladder[ladder.len() - 1] * 1.25);
    }
    let lags: Vec<f64> = bins.iter().map(|bin| bin.lag_m).collect();
    let semivariances: Vec<f64> = bins.iter().map(|bin| bin.semivariance_m2).collect();
    let mut best = [Fitted { misfit: f64::INFINITY, sills: [0.0; 2], ranges: [cell_m; 2] }; 2];
    for (i, &short) in ladder.iter().enumerate() {
        for &long in &ladder[i + 1..] {
            let ranges = [short, long];
            let (m, r) = normal(&lags, &semivariances, ranges);
            let both = both_sills(&lags, &semivariances, ranges);
            for sills in [both, [r[0] / m[0][0], 0.0], [0.0, r[1] / m[1][1]]] {
                if !sills.iter().all(|s| s.is_finite() && *s >= 0.0) {
                    continue;
                }
                let mut fitted = Fitted { misfit: 0.0, sills, ranges };
                fitted.misfit = bins
                    .iter()
                    .map(|bin| (fitted.at(bin.lag_m) - bin.semivariance_m2).powi(2) / bin.lag_m.sqrt())
                    .sum();
                let of_kind = &mut best[usize::from(sills.iter().all(|s| *s > 0.0))];
                if fitted.misfit < of_kind.misfit * (1.0 - 1e-9) {
                    *of_kind = fitted;
                }
            }
        }
    }
    let [one, two] = best;
    let believed =
        two.misfit < one.misfit && one.chi2(&classes) - two.chi2(&classes) > BELIEVED && two.stands_out(&classes);
    let Fitted { sills, ranges, .. } = if believed { two } else { one };
    Variogram { bins: classes.bins, sills_m2: sills, ranges_m: ranges }
}
