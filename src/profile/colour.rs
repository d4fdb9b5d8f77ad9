//! Colours and distances between them.
//!
//! sRGB to CIE XYZ after IEC 61966-2-1 (white point D65), XYZ to L\*a\*b\* after CIE 15:2004. The three distances are
//! those of the 2016 prototype: Euclidean, standardised Euclidean and Mahalanobis (P. C. Mahalanobis, "On the
//! generalised distance in statistics", 1936).

use autoref_raster::srgb::{linear_from_srgb, srgb_from_linear};
use nalgebra::{Matrix3, Vector3};

/// White point D65, 2° observer.
const WHITE: [f64; 3] = [0.950_47, 1.0, 1.088_83];

/// XYZ over the white point's, from linear red, green, blue. Every coefficient is positive, so that each output rises
/// with each input: the table builder relies on it.
pub(crate) fn xyz_from_linear(c: [f64; 3]) -> [f64; 3] {
    [
        (0.412_456_4 * c[0] + 0.357_576_1 * c[1] + 0.180_437_5 * c[2]) / WHITE[0],
        (0.212_672_9 * c[0] + 0.715_152_2 * c[1] + 0.072_175_0 * c[2]) / WHITE[1],
        (0.019_333_9 * c[0] + 0.119_192_0 * c[1] + 0.950_304_1 * c[2]) / WHITE[2],
    ]
}

/// Below it [`lab_f`] is a straight line, which meets the cube root without a bend.
pub(crate) const LAB_KNEE: f64 = 216.0 / 24_389.0;

/// The compressive function of L\*a\*b\*, rising everywhere.
pub(crate) fn lab_f(t: f64) -> f64 {
    const KAPPA: f64 = 24_389.0 / 27.0;
    if t > LAB_KNEE { t.cbrt() } else { (KAPPA * t + 16.0) / 116.0 }
}

/// [`lab_f`] within [`LAB_F_NEAR`] of itself, relatively, in a fraction of the time: a table of colours asks it
/// millions of times whether the exact answer matters. One step of Halley's method from a third of the exponent.
pub(crate) fn lab_f_near(t: f64) -> f64 {
    if t <= LAB_KNEE {
        return lab_f(t);
    }
    // Thirds of the bits, with what makes 1 come out as 1 but for 3 %.
    let y = f64::from_bits(t.to_bits() / 3 + 0x2a9f_7893_782d_a1ce);
    let cube = y * y * y;
    y * (cube + 2.0 * t) / (2.0 * cube + t)
}

/// Relative error of [`lab_f_near`] at most.
pub(crate) const LAB_F_NEAR: f64 = 4e-5;

pub(crate) fn lab_from_f(f: [f64; 3]) -> Vector3<f64> {
    Vector3::new(116.0 * f[1] - 16.0, 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2]))
}

/// sRGB in 0..=1 to L\*a\*b\*.
pub fn lab_from_srgb(rgb: [f64; 3]) -> Vector3<f64> {
    lab_from_f(xyz_from_linear(rgb.map(linear_from_srgb)).map(lab_f))
}

/// L\*a\*b\* to sRGB in 0..=1, clipped.
pub fn srgb_from_lab(lab: [f64; 3]) -> [f64; 3] {
    let y = (lab[0] + 16.0) / 116.0;
    let f = [y + lab[1] / 500.0, y, y - lab[2] / 200.0];
    let xyz = nalgebra::Vector3::from_fn(|i, _| {
        let t = f[i].powi(3);
        let linear = if t > LAB_KNEE { t } else { (116.0 * f[i] - 16.0) * 27.0 / 24_389.0 };
        linear * WHITE[i]
    });
    #[rustfmt::skip]
    let inverse = Matrix3::new(
        3.240_454_2, -1.537_138_5, -0.498_531_4,
        -0.969_266_0, 1.876_010_8, 0.041_556_0,
        0.055_643_4, -0.204_025_9, 1.057_225_2,
    );
    let linear: [f64; 3] = (inverse * xyz).into();
    linear.map(|v| srgb_from_linear(v.clamp(0.0, 1.0)))
}

/// The space that distances are taken in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Space {
    /// CIE L\*a\*b\*.
    #[default]
    Lab,
    /// sRGB samples in 0..=1.
    Rgb,
}

impl Space {
    /// A colour, sRGB, in this space.
    pub fn convert(self, rgb: [f64; 3]) -> Vector3<f64> {
        match self {
            Space::Lab => lab_from_srgb(rgb),
            Space::Rgb => Vector3::from(rgb),
        }
    }
}

/// How distances are taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Metric {
    #[default]
    Mahalanobis,
    /// Each axis over its own standard deviation.
    Standardised,
    Euclidean,
}

/// One colour cloud, ready for use: its mean and the inverse covariance that the metric asks for.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    pub mean: Vector3<f64>,
    pub weight: Matrix3<f64>,
    /// Half sides, per axis, of the box around the ellipsoid of distance 1.
    pub reach: Vector3<f64>,
}

impl Cloud {
    /// `None` when the covariance is not finite, symmetric positive definite.
    pub fn new(mean: [f64; 3], covariance: [[f64; 3]; 3], metric: Metric) -> Option<Cloud> {
        let full = Matrix3::from_fn(|r, c| covariance[r][c]);
        let used = match metric {
            Metric::Mahalanobis => full,
            Metric::Standardised => Matrix3::from_diagonal(&full.diagonal()),
            Metric::Euclidean => Matrix3::identity(),
        };
        let symmetric = (0..3).all(|r| (0..3).all(|c| (used[(r, c)] - used[(c, r)]).abs() <= 1e-9 * used.norm()));
        if !used.iter().all(|v| v.is_finite()) || !symmetric || !mean.iter().all(|v| v.is_finite()) {
            return None;
        }
        let weight = used.cholesky()?.inverse();
        // A nearly flat cloud inverts to noise.
        let eigen = used.symmetric_eigenvalues();
        if eigen.min() <= 1e-12 * eigen.max() || !weight.iter().all(|v| v.is_finite()) {
            return None;
        }
        Some(Cloud { mean: Vector3::from(mean), weight, reach: used.diagonal().map(f64::sqrt) })
    }

    /// Squared distance of a colour in the cloud's space. Written out, so that the order of the operations is ours.
    pub fn distance2(&self, colour: &Vector3<f64>) -> f64 {
        let d = [colour[0] - self.mean[0], colour[1] - self.mean[1], colour[2] - self.mean[2]];
        let w = &self.weight;
        let diagonal = w[(0, 0)] * d[0] * d[0] + w[(1, 1)] * d[1] * d[1] + w[(2, 2)] * d[2] * d[2];
        diagonal + 2.0 * (w[(0, 1)] * d[0] * d[1] + w[(0, 2)] * d[0] * d[2] + w[(1, 2)] * d[1] * d[2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_near_root_is_near() {
        for i in 0..200_000 {
            let t = f64::from(i) * 6e-6;
            let (near, exact) = (lab_f_near(t), lab_f(t));
            assert!((near / exact - 1.0).abs() < 0.9 * LAB_F_NEAR, "{t}: {near} for {exact}");
        }
    }

    #[test]
    fn lab_of_known_colours() {
        // Values from the CIE formulas as published by B. Lindbloom for sRGB primaries, D65.
        for (rgb, lab) in [
            ([1.0, 1.0, 1.0], [100.0, 0.0, 0.0]),
            ([1.0, 0.0, 0.0], [53.24, 80.09, 67.20]),
            ([0.0, 1.0, 0.0], [87.73, -86.18, 83.18]),
            ([0.0, 0.0, 1.0], [32.30, 79.19, -107.86]),
            ([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]),
        ] {
            let got = lab_from_srgb(rgb);
            for i in 0..3 {
                assert!((got[i] - lab[i]).abs() < 0.02, "{rgb:?}: {got:?}");
            }
        }
    }

    #[test]
    fn there_and_back() {
        for rgb in [[0.9, 0.4, 0.1], [0.02, 0.01, 0.03], [0.2, 0.5, 0.9], [1.0, 1.0, 1.0]] {
            let lab = lab_from_srgb(rgb);
            let back = srgb_from_lab([lab[0], lab[1], lab[2]]);
            assert!((0..3).all(|i| (back[i] - rgb[i]).abs() < 1e-5), "{rgb:?}: {back:?}");
        }
    }

    #[test]
    fn metrics_agree_where_they_must() {
        let covariance = [[4.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 1.0]];
        let at = Vector3::new(3.0, -1.0, 2.0);
        let d = |m| Cloud::new([1.0, 2.0, 3.0], covariance, m).map(|c| c.distance2(&at));
        assert_eq!(d(Metric::Mahalanobis), d(Metric::Standardised));
        assert_eq!(d(Metric::Euclidean), Some(14.0));
        assert!((d(Metric::Mahalanobis).unwrap_or(0.0) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_flat_or_broken_cloud_is_refused() {
        assert!(Cloud::new([0.0; 3], [[0.0; 3]; 3], Metric::Mahalanobis).is_none());
        assert!(
            Cloud::new([0.0; 3], [[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]], Metric::Mahalanobis).is_none()
        );
        assert!(Cloud::new([f64::NAN, 0.0, 0.0], [[1.0; 3]; 3], Metric::Euclidean).is_none());
        assert!(
            Cloud::new([0.0; 3], [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], Metric::Mahalanobis).is_none()
        );
    }
}
