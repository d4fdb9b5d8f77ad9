//! The error function and the standard normal distribution.
//!
//! M. Abramowitz, I. Stegun, "Handbook of Mathematical Functions", 1964, 7.1.26: the error function is good to 1.5e-7
//! and the distribution to 7.5e-8, absolutely. The share beyond so many standard deviations is good to a relative 5e-5
//! at three of them and to 1e-2 at eight. (26.2.17 is the same polynomial, its coefficients rounded once more.)

use std::f64::consts::FRAC_1_SQRT_2;

/// The 97.5 % quantile of the distribution: 95 % lie within so many standard deviations.
pub const WITHIN_95: f64 = 1.959_964;

/// What the argument of the error function is multiplied with for [`erfc_over_exp`].
pub const P: f64 = 0.327_591_1;

/// 1 − erf(x) over exp(−x²), of x ≥ 0, which is given as [`P`]·x: for kernels that have the exponential from elsewhere.
#[inline(always)]
pub fn erfc_over_exp(p_x: f64) -> f64 {
    let t = 1.0 / (1.0 + p_x);
    t * (0.254_829_592 + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))))
}

/// The error function; odd by construction, so that what is blurred with it shifts no centroid.
pub fn erf(x: f64) -> f64 {
    let a = x.abs();
    if a > 4.5 {
        return x.signum();
    }
    (1.0 - erfc_over_exp(P * a) * (-a * a).exp()).copysign(x)
}

/// The share of the standard normal distribution below `z`. The lower tail keeps its digits.
pub fn below(z: f64) -> f64 {
    let a = z.abs() * FRAC_1_SQRT_2;
    let tail = 0.5 * erfc_over_exp(P * a) * (-a * a).exp();
    if z > 0.0 { 1.0 - tail } else { tail }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_what_scipy_has() {
        // scipy.special.erf, SciPy 1.17.1.
        let erfs = [
            (0.1, 0.112_462_916_018_284_9),
            (0.5, 0.520_499_877_813_046_5),
            (-1.0, -0.842_700_792_949_714_8),
            (2.0, 0.995_322_265_018_952_7),
            (4.4, 0.999_999_999_510_829),
            (5.0, 1.0),
        ];
        for (x, truth) in erfs {
            assert!((erf(x) - truth).abs() < 1.5e-7, "{x}: {}", erf(x));
        }
        // scipy.stats.norm.cdf.
        let shares = [
            (0.0, 0.5),
            (0.25, 0.598_706_325_682_923_7),
            (-0.5, 0.308_537_538_725_986_9),
            (1.0, 0.841_344_746_068_542_9),
            (1.959_963_985, 0.975_000_000_026_881_6),
            (-2.5, 6.209_665_325_776_132e-3),
            (3.0, 0.998_650_101_968_369_9),
            (-4.0, 3.167_124_183_311_986e-5),
            (-7.0, 1.279_812_543_885_835e-12),
        ];
        for (z, truth) in shares {
            assert!((below(z) - truth).abs() < 7.5e-8, "{z}: {}", below(z));
            assert!((below(z) / truth - 1.0).abs() < 1e-2, "{z}: {}", below(z));
        }
    }
}
