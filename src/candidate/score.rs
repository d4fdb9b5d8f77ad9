//! How likely it is that what the examination measured is a mark.

use super::evidence::{Evidence, GroundSeen};
use super::fit::Fit;
use super::gates::Gates;
use crate::profile::{Profile, Shape};

/// Log-likelihood ratio of "mark" against "something else of this colour", natural logarithm.
///
/// Two measurements, the contrast with the ground beside it and what the fit leaves over, each as a logarithm; their
/// joint distribution is taken as Gaussian for marks (50,000 planted under all conditions of the benchmark) and for
/// clutter (1,068 regions of this colour in eight real photographs). Beyond the mark's own mean more contrast or a
/// better fit does not count further. A candidate that no shape could be fitted to (no ground around it) has ratio 0.
pub fn score(evidence: &Evidence, profile: &Profile, gates: &Gates) -> f64 {
    let Some(fit) = &evidence.fit else { return 0.0 };
    if !is_of_size(fit, profile, gates) {
        return f64::from(-50);
    }
    if let Some(score) = evidence.own_score {
        return score;
    }
    Populations::of(evidence.ground).score(evidence.contrast, fit.rms, evidence.unsupported)
}

/// Whether a shape is as large and as wide as marks are. One that is not has no likelihood as a mark; the margin is the
/// fit's own uncertainty.
pub(super) fn is_of_size(fit: &Fit, profile: &Profile, gates: &Gates) -> bool {
    let (low, high) = gates.mark_side_px();
    let side = (fit.sides_px[0] * fit.sides_px[1]).sqrt();
    let (short, long) = (fit.sides_px[0].min(fit.sides_px[1]), fit.sides_px[0].max(fit.sides_px[1]));
    (0.6 * low..=1.25 * high + 1.0).contains(&side) && (long <= 2.0 * short || profile.shape == Shape::Cross)
}

/// From better than any fit to as bad as none, rising.
fn ln_rms_steps() -> impl Iterator<Item = f64> {
    (0..=40).map(|i| -4.0 + 0.1 * f64::from(i))
}

/// A Gaussian over (ln contrast, ln rms).
struct Population {
    mean: [f64; 2],
    /// Variances and covariance: 00, 01, 11.
    covariance: [f64; 3],
}

/// Marks and what else has their colour, as one of the looks sees them.
pub(super) struct Populations {
    mark: Population,
    clutter: Population,
}

pub(super) const RING_LOOK: Populations = Populations {
    mark: Population { mean: [3.23, -3.45], covariance: [0.126, -0.071, 0.107] },
    clutter: Population { mean: [0.99, -1.40], covariance: [0.212, -0.082, 0.280] },
};
/// Both of what the ring's look turned down: 137 marks and 157 regions of clutter.
const LOCAL_LOOK: Populations = Populations {
    mark: Population { mean: [3.015, -3.106], covariance: [0.076, -0.048, 0.148] },
    clutter: Population { mean: [1.881, -1.586], covariance: [0.159, -0.064, 0.282] },
};

impl Populations {
    pub(super) fn of(ground: GroundSeen) -> &'static Populations {
        match ground {
            GroundSeen::Ring => &RING_LOOK,
            GroundSeen::Local => &LOCAL_LOOK,
        }
    }

    /// Less for so many sides of an outline that no edge supports.
    pub(super) fn score(&self, contrast: f64, rms: f64, unsupported: f64) -> f64 {
        // A side without an edge is worth as much as most of what a mark gains by its contrast.
        const PER_SIDE: f64 = 4.0;
        self.likelihood_ratio(contrast, rms) - PER_SIDE * unsupported
    }

    pub(super) fn likelihood_ratio(&self, contrast: f64, rms: f64) -> f64 {
        self.logarithmic_ratio()(contrast.max(0.1).ln(), rms.max(1e-4).ln())
    }

    /// Of the logarithms of a contrast and a root mean square.
    fn logarithmic_ratio(&self) -> impl Fn(f64, f64) -> f64 {
        let (mark, clutter) = (self.mark.log_density(), self.clutter.log_density());
        let [most_contrast, least_rms] = self.mark.mean;
        move |ln_contrast, ln_rms| {
            let at = [ln_contrast.min(most_contrast), ln_rms.max(least_rms)];
            mark(at) - clutter(at)
        }
    }

    /// The score that the best of fits would give at this contrast. Most clutter is dropped by it before the costly
    /// fit.
    pub(super) fn best_possible_score(&self, contrast: f64) -> f64 {
        let ln_contrast = contrast.max(0.1).ln();
        let ratio = self.logarithmic_ratio();
        ln_rms_steps().map(|ln_rms| ratio(ln_contrast, ln_rms)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// What a fit may leave over at most to reach `min_score` at this contrast.
    pub(super) fn largest_rms(&self, contrast: f64, min_score: f64) -> f64 {
        let ln_contrast = contrast.max(0.1).ln();
        let ratio = self.logarithmic_ratio();
        let enough = |ln_rms: &f64| ratio(ln_contrast, *ln_rms) >= min_score;
        ln_rms_steps().filter(enough).last().map_or(0.0, f64::exp)
    }
}

impl Population {
    /// At (ln contrast, ln rms). What all places share is worked out once: every region asks at 41 places.
    fn log_density(&self) -> impl Fn([f64; 2]) -> f64 {
        let ([a, b, c], mean) = (self.covariance, self.mean);
        let det = a * c - b * b;
        let (half_ln_det, ln_tau) = (0.5 * det.ln(), std::f64::consts::TAU.ln());
        move |at| {
            let (x, y) = (at[0] - mean[0], at[1] - mean[1]);
            -0.5 * (c * x * x - 2.0 * b * x * y + a * y * y) / det - half_ln_det - ln_tau
        }
    }
}
