//! Weights of the pairs of a fit: what is stated of each, what the residuals show of all, and how far they bear the
//! statements out.
//!
//! The variance of a pair is k·centre + survey + common. The common part is what nobody states: errors of the survey,
//! deformation of the orthophoto. It is the one with which the squared residuals of a fit with equal weights, each over
//! its pair's variance, sum up to their degrees of freedom (R. C. Paule and J. Mandel, "Consensus values and weighting
//! factors", J. Res. Natl. Bur. Stand. 87(5), 1982). The difference to them: their residuals are those of the weighted
//! fit, in which two pairs with all of the weight leave nothing over and hide the common part.
//!
//! Centres on rough ground may lie far better than stated. Taken at its word such a statement swallows the common part,
//! and the few other pairs decide alone, by the errors of their survey. So the residuals choose between three k.

use crate::similarity::{Pair, Similarity, residual};

/// No coordinate is known better, pixels.
pub(crate) const LEAST_SIGMA_PX: f64 = 0.02;
/// What the centres' covariances may have to be multiplied with, and how likely that is before any residual is seen.
const SHARES: [(f64, f64); 3] = [(1.0, 0.8), (0.1, 0.1), (0.01, 0.1)];
/// Halvings of the interval that the common part lies in; each is one bit.
const HALVINGS: usize = 60;

/// Variance of a coordinate as it is stated, m².
#[derive(Clone, Copy, PartialEq)]
struct Stated {
    centre: f64,
    survey: f64,
}

fn stated(pairs: &[Pair], scale: f64) -> Vec<Stated> {
    let of_pair = |pair: &Pair| Stated {
        centre: pair.covariance_px2.map_or(0.0, |c| (c[0] + c[2]) / 2.0 * scale * scale),
        survey: pair.survey_sigma_m.map_or(0.0, |s| s * s),
    };
    pairs.iter().map(of_pair).collect()
}

/// A-priori variance of a coordinate of each pair, m²: centre and survey, what is known of them.
pub(crate) fn prior_variances(pairs: &[Pair], scale: f64) -> Vec<f64> {
    stated(pairs, scale).into_iter().map(|s| s.centre + s.survey).collect()
}

/// Weights of mean 1; `equal` is the fit with equal weights.
pub(crate) fn of_pairs(pairs: &[Pair], equal: &Similarity) -> Vec<f64> {
    let square = |pair: &Pair| {
        let (e, n) = residual(equal, pair);
        e * e + n * n
    };
    of_residuals(pairs, equal.scale_m_per_px(), 4, || pairs.iter().map(square).collect())
}

/// Weights of mean 1 from the squared residuals, m², of a fit of some transform with equal weights, of so many
/// parameters; `scale` is the ground size of a pixel, metres.
pub(crate) fn of_residuals(
    pairs: &[Pair],
    scale: f64,
    parameters: usize,
    squares: impl FnOnce() -> Vec<f64>,
) -> Vec<f64> {
    let stated = stated(pairs, scale);
    let freedom = 2 * pairs.len() as i64 - parameters as i64;
    if freedom <= 0 || stated.iter().all(|s| *s == stated[0]) {
        return vec![1.0; pairs.len()];
    }
    let squares = squares();
    let floor = (LEAST_SIGMA_PX * scale).powi(2);
    // The parameters swallow part of the residuals.
    let swallowed = 2.0 * pairs.len() as f64 / freedom as f64;
    let mut best = (f64::NEG_INFINITY, Vec::new());
    for (share, odds) in SHARES {
        let own = stated.iter().map(|s| (share * s.centre + s.survey).max(floor));
        let variances = with_common(own.collect(), &squares, freedom as f64);
        let terms = variances.iter().zip(&squares).map(|(v, r2)| v.ln() + swallowed * r2 / (2.0 * v));
        let likelihood = odds.ln() - terms.fold(0.0, |sum, term| sum + term);
        if likelihood > best.0 {
            best = (likelihood, variances);
        }
    }
    let weights: Vec<f64> = best.1.iter().map(|v| 1.0 / v).collect();
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    weights.into_iter().map(|w| w / mean).collect()
}

/// The variances with the common part that the squared residuals ask for.
fn with_common(own: Vec<f64>, squares: &[f64], freedom: f64) -> Vec<f64> {
    // Above its estimate, the more so the fewer the residuals: what few say of the common part is coarse, and too small
    // a value gives single points more weight than they deserve, and the expected errors too much trust.
    let expected = freedom / (1.0 + 4.0 / freedom);
    let sum = |common: f64| own.iter().zip(squares).fold(0.0, |sum, (v, r2)| sum + r2 / (v + common));
    // With the upper end alone as variance the sum is as expected: it is no smaller than the common part.
    let (mut low, mut high) = (0.0, squares.iter().fold(0.0, |sum, r2| sum + r2) / expected);
    if sum(0.0) <= expected {
        return own;
    }
    for _ in 0..HALVINGS {
        let middle = (low + high) / 2.0;
        if sum(middle) > expected {
            low = middle;
        } else {
            high = middle;
        }
    }
    own.iter().map(|v| v + high).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::{MapPoint, PixelPoint};

    /// Ten pairs of a map in metres at 0.03 m per pixel, with survey errors of about `survey_m`; `sigma_px` is stated
    /// of each centre, all lie where they should.
    fn pairs(survey_m: f64, sigma_px: impl Fn(usize) -> f64) -> Vec<Pair> {
        let at = |i: usize| ((i * 37 % 100) as f64 * 30.0, (i * 61 % 100) as f64 * 30.0);
        let error = |i: usize, k: usize| survey_m * (((i * k) % 11) as f64 / 5.0 - 1.0) * 1.6;
        let pair = |i: usize| {
            let (x, y) = at(i);
            Pair {
                pixel: PixelPoint { x, y },
                map: MapPoint { easting: 0.03 * x + error(i, 5), northing: -0.03 * y + error(i, 7) },
                covariance_px2: Some([sigma_px(i).powi(2), 0.0, sigma_px(i).powi(2)]),
                survey_sigma_m: None,
            }
        };
        (1..=10).map(pair).collect()
    }

    fn weights(pairs: &[Pair]) -> Vec<f64> {
        of_pairs(pairs, &crate::similarity::fit_equal_weights(pairs).expect("ten places"))
    }

    fn ratio(weights: &[f64]) -> f64 {
        let largest = weights.iter().fold(0.0, |a: f64, b| a.max(*b));
        largest / weights.iter().fold(f64::INFINITY, |a: f64, b| a.min(*b))
    }

    #[test]
    fn two_good_centres_do_not_decide_alone_where_the_survey_errs() {
        let weights = weights(&pairs(0.008, |i| if i < 3 { 0.02 } else { 0.4 }));
        assert!(ratio(&weights) < 2.0, "{weights:?}");
    }

    #[test]
    fn centres_that_err_as_stated_weigh_as_stated() {
        let mut pairs = pairs(0.0, |i| if i < 6 { 0.03 } else { 1.0 });
        for (i, pair) in pairs.iter_mut().enumerate() {
            let sigma = pair.covariance_px2.expect("stated")[0].sqrt();
            pair.pixel.x += sigma * [1.1, -0.7, 0.4][i % 3];
            pair.pixel.y -= sigma * [0.3, 1.2, -1.0, -0.6][i % 4];
        }
        let weights = weights(&pairs);
        assert!(ratio(&weights) > 6.0, "{weights:?}");
    }

    #[test]
    fn equal_statements_weigh_alike() {
        assert!(weights(&pairs(0.01, |_| 0.1)).iter().all(|w| *w == 1.0));
    }

    #[test]
    fn the_common_part_makes_the_sum_as_expected() {
        let own = vec![1e-6, 4e-6, 1e-4, 1e-6, 2e-6];
        let squares = [1e-4, 2e-4, 5e-5, 3e-4, 1e-4];
        let variances = with_common(own.clone(), &squares, 6.0);
        let sum: f64 = variances.iter().zip(&squares).map(|(v, r2)| r2 / v).sum();
        assert!((sum - 6.0 / (1.0 + 4.0 / 6.0)).abs() < 1e-9, "{sum}");
        assert_eq!(with_common(own.clone(), &[0.0; 5], 6.0), own);
    }
}
