//! What each point of a fit says of itself: how much of its error its residual shows, what error a test would notice,
//! and whether it fits badly.
//!
//! Redundancy numbers and smallest detectable blunders follow W. Baarda, "A testing procedure for use in geodetic
//! networks", 1968, with non-centrality 4.13 (α = 0.1 %, β = 80 %).

use crate::weights::LEAST_SIGMA_PX;

/// Baarda's √λ₀ for a significance of 0.1 % and a power of 80 %.
const BAARDA_SQRT_LAMBDA: f64 = 4.13;

/// A point that is nearer than this, as the others lay it, is none that fits badly, deviations of the best mark.
const LEAST_MISFIT_SIGMAS: f64 = 3.72;

/// A fit as a whole.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Noise {
    pub points: usize,
    /// Redundant coordinates.
    pub freedom: f64,
    /// Weighted sum of the squares of the residuals, m².
    pub weighted: f64,
    /// Standard deviation of a coordinate of unit weight, metres; `None` without redundancy.
    pub sigma0_m: Option<f64>,
    /// Ground size of a pixel.
    pub scale_m_per_px: f64,
}

/// What a fit shows of one point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reliability {
    /// How much of an error in this point its own residual shows: 0 nothing, 1 all.
    pub redundancy: f64,
    /// Smallest error of this point that a test would notice, metres; `None` when nothing would.
    pub detectable_blunder_m: Option<f64>,
    /// The residual is more than the others' noise allows.
    pub misfit: bool,
}

impl Reliability {
    /// Of a point with this leverage, the same for both coordinates, and residual, metres.
    pub(crate) fn of(noise: &Noise, weight: f64, leverage: f64, (e, n): (f64, f64)) -> Self {
        let redundancy = (1.0 - leverage).clamp(0.0, 1.0);
        // Of all points together one in a thousand fits is called so by chance.
        let alarm = -3.0 - (noise.points as f64).log10();
        let is_far = || e.hypot(n) / redundancy > LEAST_MISFIT_SIGMAS * LEAST_SIGMA_PX * noise.scale_m_per_px;
        let misfit = Self::is_tested(redundancy)
            && is_far()
            && log10_misfit(weight * (e * e + n * n) / redundancy, noise.weighted, noise.freedom) <= alarm;
        let detectable_blunder_m = noise
            .sigma0_m
            .map(|sigma0| sigma0 / weight.sqrt())
            .filter(|_| redundancy > 0.02)
            .map(|sigma| BAARDA_SQRT_LAMBDA * sigma / redundancy.sqrt());
        Reliability { redundancy, detectable_blunder_m, misfit }
    }

    /// Whether the residual says anything of a point's error.
    pub(crate) fn is_tested(redundancy: f64) -> bool {
        redundancy > 1e-9
    }
}

/// log₁₀ of the chance that a point is so far from where the others put it, by the others' own noise: the weighted
/// squares that it takes away with it, of the `all` there are, against what is left, F with 2 and ν − 2 degrees of
/// freedom (R. D. Cook and S. Weisberg, "Residuals and Influence in Regression", 1982, the externally studentised
/// residual), whose tail has a closed form. 0 where fewer than four are left.
fn log10_misfit(taken_away: f64, all: f64, freedom: f64) -> f64 {
    const FEWEST: f64 = 6.0;
    if freedom < FEWEST || all <= 0.0 {
        return 0.0;
    }
    (freedom / 2.0 - 1.0) * (1.0 - taken_away / all).max(0.0).log10()
}
