//! The adjustment of the 2-D similarity by pairs of unlike weight, with everything a surveyor asks of it.
//!
//! The report's page repeats the fit (`src/report/page/solve.js`) and must get the same bits.

use nalgebra::{Matrix2, Matrix4, SMatrix};
use serde::{Deserialize, Serialize};

use crate::reliability::{Noise, Reliability};
use crate::similarity::{Pair, Similarity, Unsolvable, centres, fit, length, residual, upright};
use crate::weights::{self, LEAST_SIGMA_PX, prior_variances};
use autoref_raster::coords::{GeoTransform, Handedness, PixelPoint};
use autoref_raster::ranks::median;

/// What is known of one pair after the fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairResult {
    /// Surveyed − computed, metres.
    pub residual_e_m: f64,
    /// Likewise.
    pub residual_n_m: f64,
    /// Length of the residual in pixels.
    pub residual_px: f64,
    /// Weight in the fit, 1 for an average pair; lowered for outliers.
    pub weight: f64,
    /// Surveyed − computed when this pair is left out of the fit, metres; `None` with two pairs.
    pub leave_one_out_e_m: Option<f64>,
    /// Likewise.
    pub leave_one_out_n_m: Option<f64>,
    /// How much of an error in this pair its own residual shows: 0 nothing, 1 all.
    pub redundancy: f64,
    /// Smallest error of this point that a test would notice, metres; `None` when nothing would.
    pub detectable_blunder_m: Option<f64>,
    /// The residual is more than robust noise or the others' noise allows: look at this point.
    pub outlier: bool,
}

/// A solved similarity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Solution {
    /// The transform, image → map.
    pub similarity: Similarity,
    /// The same as GDAL writes it, about pixel corners.
    pub geotransform: GeoTransform,
    /// Ground size of a pixel, metres.
    pub scale_m_per_px: f64,
    /// Of the image's x axis, anticlockwise from east, degrees in (−180, 180].
    pub rotation_deg: f64,
    /// √(mean(dE² + dN²)) over all pairs of the fit, unweighted, metres.
    pub rmse_m: f64,
    /// The part of it in easting, √(mean dE²).
    pub rmse_e_m: f64,
    /// The part of it in northing, √(mean dN²).
    pub rmse_n_m: f64,
    /// `rmse_m` in pixels.
    pub rmse_px: f64,
    /// Standard deviation of a coordinate of unit weight, metres; from the residuals, `None` without redundancy.
    pub sigma0_m: Option<f64>,
    /// Covariance of (a_re, a_im, easting and northing at the weighted centre), scaled by `sigma0_m`²; without it by
    /// the mean variance that is stated of marks and survey, zero when nothing is.
    pub covariance: [[f64; 4]; 4],
    /// The point the covariance's translation refers to: weighted centre of the marks, pixels.
    pub centre: PixelPoint,
    /// In the order of the pairs of the fit.
    pub pairs: Vec<PairResult>,
    /// Why the points may not support the fit, in plain words.
    pub warnings: Vec<String>,
}

impl Solution {
    /// Predicted 1σ of easting and northing (the larger principal axis) of a pixel's map position, metres.
    pub fn sigma_at_m(&self, p: PixelPoint) -> f64 {
        let jacobian = jacobian(p, self.centre, self.similarity.mirrored);
        let covariance = Matrix4::from_fn(|r, c| self.covariance[r][c]);
        let c: Matrix2<f64> = jacobian * covariance * jacobian.transpose();
        c.symmetric_eigenvalues().max().max(0.0).sqrt()
    }
}

/// Derivatives of (easting, northing) by (a_re, a_im, e_c, n_c) at a pixel, about a centre.
fn jacobian(p: PixelPoint, centre: PixelPoint, mirrored: Handedness) -> SMatrix<f64, 2, 4> {
    let (x, y) = upright(p.x - centre.x, p.y - centre.y, mirrored);
    SMatrix::<f64, 2, 4>::new(x, -y, 1.0, 0.0, y, x, 0.0, 1.0)
}

/// Weighted least squares of the 2-D similarity.
///
/// A pair's weight is 1/σ², with σ² from the mark's centre covariance (brought to metres), the survey's σ and a common
/// part that the residuals show ([`crate::weights`]), relative to the average; without any of these all weights are
/// equal. Pairs with a residual longer than 4.5 robust standard deviations are down-weighted (Huber) and
/// marked `outlier`, and so are those that the others' noise puts there once in a thousand fits; none is dropped.
///
/// # Errors
/// [`Unsolvable`] with fewer than two different points.
pub fn solve(pairs: &[Pair]) -> Result<Solution, Unsolvable> {
    solve_as(pairs, Handedness::AsIs)
}

/// [`solve`] for an image that is known to be mirrored, or not.
///
/// # Errors
/// Those of [`solve`].
pub fn solve_as(pairs: &[Pair], mirrored: Handedness) -> Result<Solution, Unsolvable> {
    if pairs.len() < 2 {
        return Err(Unsolvable::TooFewPoints);
    }
    let uniform = vec![1.0; pairs.len()];
    let fit = |weights: &[f64]| fit(pairs, weights, mirrored);
    let first = fit(&uniform).ok_or(Unsolvable::Degenerate)?;
    let base = weights::of_pairs(pairs, &first);
    let mut weights = base.clone();
    let mut similarity = fit(&weights).ok_or(Unsolvable::Degenerate)?;
    if pairs.len() > 3 {
        for _ in 0..20 {
            let next = huber_weights(pairs, &similarity, &base);
            let change = next.iter().zip(&weights).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            weights = next;
            similarity = fit(&weights).ok_or(Unsolvable::Degenerate)?;
            if change < 1e-9 {
                break;
            }
        }
    }
    Ok(describe(pairs, &weights, &base, similarity))
}

/// Robust standard deviation of a coordinate of unit weight: the median of the weighted residual lengths, by the
/// Rayleigh distribution's 1.1774.
fn robust_sigma(lengths: &[f64], points: usize) -> f64 {
    // Four parameters swallow part of the residuals.
    let swallowed = (points as f64 / (points as f64 - 2.0)).sqrt();
    median(lengths.to_vec()) / 1.1774 * swallowed
}

fn huber_weights(pairs: &[Pair], similarity: &Similarity, base: &[f64]) -> Vec<f64> {
    let lengths: Vec<f64> = pairs
        .iter()
        .zip(base)
        .map(|(pair, w)| {
            let (e, n) = residual(similarity, pair);
            length(e, n) * w.sqrt()
        })
        .collect();
    // No mark is measured, and no point surveyed, so well that less tells a wrong one.
    let sigma = robust_sigma(&lengths, pairs.len()).max(LEAST_SIGMA_PX * similarity.scale_m_per_px());
    // 3.72 σ is the length that a two-dimensional normal residual exceeds once in a thousand; the σ itself comes from
    // the median of few residuals, hence the margin.
    let limit = 4.5 * sigma;
    lengths.iter().zip(base).map(|(length, w)| if *length > limit { w * limit / length } else { *w }).collect()
}

fn describe(pairs: &[Pair], weights: &[f64], base: &[f64], similarity: Similarity) -> Solution {
    let total: f64 = weights.iter().sum();
    let (centre, _) = centres(pairs, weights, total);
    let spread: f64 = pairs
        .iter()
        .zip(weights)
        .map(|(pair, w)| w * ((pair.pixel.x - centre.x).powi(2) + (pair.pixel.y - centre.y).powi(2)))
        .sum();
    let residuals: Vec<(f64, f64)> = pairs.iter().map(|pair| residual(&similarity, pair)).collect();
    let n = pairs.len() as f64;
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| residuals.iter().map(f).sum::<f64>();
    let rmse_e_m = (sum(&|r| r.0 * r.0) / n).sqrt();
    let rmse_n_m = (sum(&|r| r.1 * r.1) / n).sqrt();
    let rmse_m = rmse_e_m.hypot(rmse_n_m);
    let freedom = 2.0 * n - 4.0;
    let weighted: f64 = residuals.iter().zip(weights).map(|(r, w)| w * (r.0 * r.0 + r.1 * r.1)).sum();
    let sigma0_m = (freedom > 0.0).then(|| (weighted / freedom).sqrt());
    // Without redundancy only what is stated of marks and survey tells the noise.
    let stated = || {
        let prior = prior_variances(pairs, similarity.scale_m_per_px());
        prior.iter().sum::<f64>() / n
    };
    let variance = sigma0_m.map_or_else(stated, |s| s * s);
    let mut covariance = [[0.0; 4]; 4];
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] = variance / if i < 2 { spread } else { total };
    }
    let scale = similarity.scale_m_per_px();
    let is_lowered = |i: usize| weights[i] < 0.999 * base[i];
    let noise = Noise { points: pairs.len(), freedom, weighted, sigma0_m, scale_m_per_px: scale };
    let results = (0..pairs.len())
        .map(|i| {
            let (e, no) = residuals[i];
            let arm = (pairs[i].pixel.x - centre.x).powi(2) + (pairs[i].pixel.y - centre.y).powi(2);
            // Leverage of a point of a similarity: the same for both coordinates.
            let leverage = weights[i] * (1.0 / total + arm / spread);
            let Reliability { redundancy, detectable_blunder_m, misfit } =
                Reliability::of(&noise, weights[i], leverage, residuals[i]);
            let is_tested = Reliability::is_tested(redundancy);
            PairResult {
                residual_e_m: e,
                residual_n_m: no,
                residual_px: e.hypot(no) / scale,
                weight: weights[i],
                leave_one_out_e_m: is_tested.then(|| e / redundancy),
                leave_one_out_n_m: is_tested.then(|| no / redundancy),
                redundancy,
                detectable_blunder_m,
                outlier: is_lowered(i) || misfit,
            }
        })
        .collect();
    let mut solution = Solution {
        similarity,
        geotransform: similarity.geotransform(),
        scale_m_per_px: scale,
        rotation_deg: similarity.rotation_deg(),
        rmse_m,
        rmse_e_m,
        rmse_n_m,
        rmse_px: rmse_m / scale,
        sigma0_m,
        covariance,
        centre,
        pairs: results,
        warnings: Vec::new(),
    };
    solution.warnings = warnings(pairs, &solution);
    solution
}

/// What a surveyor should hear about the geometry, in plain words.
fn warnings(pairs: &[Pair], solution: &Solution) -> Vec<String> {
    let mut warnings = Vec::new();
    if solution.similarity.mirrored.is_mirrored() {
        warnings.push("the image is mirrored; its georeference turns it back, which not every program can read".into());
    }
    if pairs.len() == 2 {
        warnings.push("only 2 points: the residuals are zero by construction and say nothing about accuracy".into());
    } else if pairs.len() == 3 {
        warnings.push("only 3 points: the accuracy rests on 2 redundant measurements".into());
    }
    let n = pairs.len() as f64;
    let centred: Vec<(f64, f64)> =
        pairs.iter().map(|p| (p.pixel.x - solution.centre.x, p.pixel.y - solution.centre.y)).collect();
    let moment = |f: &dyn Fn(&(f64, f64)) -> f64| centred.iter().map(f).sum::<f64>() / n;
    let m =
        Matrix2::new(moment(&|d| d.0 * d.0), moment(&|d| d.0 * d.1), moment(&|d| d.0 * d.1), moment(&|d| d.1 * d.1));
    let eigenvalues = m.symmetric_eigenvalues();
    let (small, large) = (eigenvalues.min().max(0.0).sqrt(), eigenvalues.max().sqrt());
    if pairs.len() > 2 && small < 0.05 * large {
        warnings.push("the points lie almost on one line: errors across it show badly".into());
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::coords::MapPoint;
    use autoref_raster::random::SplitMix64;

    /// Seven marks good to 0.3 px, the first of them off by so many.
    fn flagged(random: &mut SplitMix64, off_px: f64) -> [bool; 7] {
        let truth = Similarity::through(
            [PixelPoint { x: 0.0, y: 0.0 }, PixelPoint { x: 1000.0, y: 0.0 }],
            [MapPoint { easting: 5000.0, northing: 9000.0 }, MapPoint { easting: 5025.0, northing: 9016.0 }],
        )
        .expect("two places");
        let pairs: Vec<Pair> = (0..7)
            .map(|i| {
                let place = PixelPoint { x: 3000.0 * random.unit(), y: 2000.0 * random.unit() };
                let direction = 2.0 * std::f64::consts::PI * random.unit();
                let (x, y) = if i == 0 { (off_px * direction.cos(), off_px * direction.sin()) } else { (0.0, 0.0) };
                let pixel =
                    PixelPoint { x: place.x + x + 0.3 * random.normal(), y: place.y + y + 0.3 * random.normal() };
                Pair { pixel, covariance_px2: None, map: truth.apply(place), survey_sigma_m: None }
            })
            .collect();
        let solution = solve(&pairs).expect("seven places");
        std::array::from_fn(|i| solution.pairs[i].outlier)
    }

    #[test]
    fn one_wrong_mark_among_seven_is_named_and_right_ones_seldom() {
        let mut random = SplitMix64(5);
        let rounds = 400;
        let named = (0..rounds).filter(|_| flagged(&mut random, 8.0)[0]).count();
        assert!(named > rounds * 9 / 10, "{named}");
        let blamed = (0..rounds).filter(|_| flagged(&mut random, 0.0).contains(&true)).count();
        assert!(blamed < rounds / 25, "{blamed}");
    }
}
