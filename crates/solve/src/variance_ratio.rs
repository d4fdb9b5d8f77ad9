//! How often chance leaves as little of the squares of residuals.

/// The probability that noise alone leaves at most this share of the squares of a fit when `further` coordinates (an
/// even number) go into more parameters, or leave with points that are not fitted any more, and `freedom` degrees of
/// freedom are left (an even number).
///
/// With σ of a coordinate unknown, x = S₁/S₀ of two nested fits has the distribution of F; with ν degrees of freedom
/// and k further coordinates p = x^(ν/2) · Σ (ν/2)ᵢ (1 − x)ⁱ / i! over i < k/2 (M. Abramowitz, I. Stegun, "Handbook of
/// mathematical functions", 1964, 26.6.4).
pub fn chance_of_share(share: f64, freedom: usize, further: usize) -> f64 {
    let (share, half) = (share.clamp(0.0, 1.0), freedom as f64 / 2.0);
    let (mut term, mut sum) = (1.0, 0.0);
    for i in 0..further / 2 {
        sum += term;
        term *= (half + i as f64) * (1.0 - share) / (i + 1) as f64;
    }
    share.powf(half) * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_chance_is_that_of_f() {
        // F with 2 and 10 degrees of freedom exceeds 4.1028 in 5 of 100 cases, with 8 and 10 it exceeds 3.0717.
        for (f, further) in [(4.1028, 2), (3.0717, 8)] {
            let share = 1.0 / (1.0 + f * further as f64 / 10.0);
            assert!((chance_of_share(share, 10, further) - 0.05).abs() < 2e-5);
        }
    }
}
