//! What blurred shapes are summed with: the error function, and a rule of quadrature.

use std::f64::consts::FRAC_1_SQRT_2;

/// erf by A. Abramowitz and I. Stegun (Handbook of Mathematical Functions, 1964), 7.1.26; |error| ≤ 1.5e-7, odd by
/// construction, so that it shifts no centroid.
pub(crate) fn erf(x: f64) -> f64 {
    let a = x.abs();
    if a > 4.5 {
        return x.signum();
    }
    let t = 1.0 / (1.0 + 0.327_591_1 * a);
    let poly =
        t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    (1.0 - poly * (-a * a).exp()).copysign(x)
}

/// The standard normal distribution function.
pub(crate) fn normal_cdf(x: f64) -> f64 {
    0.5 * (1.0 + erf(x * FRAC_1_SQRT_2))
}

/// Nodes and weights of the four-point Gauss–Legendre rule on [0, 1].
pub(crate) const GAUSS: [(f64, f64); 4] = [
    (0.069_431_844_202_973_71, 0.173_927_422_568_726_9),
    (0.330_009_478_207_571_9, 0.326_072_577_431_273_1),
    (0.669_990_521_792_428_1, 0.326_072_577_431_273_1),
    (0.930_568_155_797_026_3, 0.173_927_422_568_726_9),
];
