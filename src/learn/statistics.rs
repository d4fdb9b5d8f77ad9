//! What a sample of colours looks like in numbers: Tables 4.2 and 4.3 of the 2016 thesis.

use serde::Serialize;

use crate::profile::colour::lab_from_srgb;

/// A sample in both spaces.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SampleStatistics {
    pub samples: u64,
    /// sRGB 0..=1.
    pub rgb: ColourStatistics,
    /// L\*a\*b\* (D65).
    pub lab: ColourStatistics,
}

/// Channel by channel: red, green, blue, or L\*, a\*, b\*.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ColourStatistics {
    pub mean: [f64; 3],
    pub minimum: [f64; 3],
    pub maximum: [f64; 3],
    /// Divided by n − 1.
    pub covariance: [[f64; 3]; 3],
    /// Pearson's coefficients; `None` where a channel does not vary.
    pub correlation: [[Option<f64>; 3]; 3],
}

impl SampleStatistics {
    /// Of colours in sRGB 0..=1; `None` of fewer than two.
    pub fn new(srgb: &[[f64; 3]]) -> Option<Self> {
        let lab: Vec<[f64; 3]> = srgb.iter().map(|c| lab_from_srgb(*c).into()).collect();
        Some(SampleStatistics {
            samples: srgb.len() as u64,
            rgb: ColourStatistics::new(srgb)?,
            lab: ColourStatistics::new(&lab)?,
        })
    }
}

impl ColourStatistics {
    fn new(values: &[[f64; 3]]) -> Option<Self> {
        if values.len() < 2 {
            return None;
        }
        let n = values.len() as f64;
        let fold =
            |start: f64, f: fn(f64, f64) -> f64| std::array::from_fn(|c| values.iter().map(|v| v[c]).fold(start, f));
        let mean: [f64; 3] = std::array::from_fn(|c| values.iter().map(|v| v[c]).sum::<f64>() / n);
        let covariance: [[f64; 3]; 3] = std::array::from_fn(|r| {
            std::array::from_fn(|c| values.iter().map(|v| (v[r] - mean[r]) * (v[c] - mean[c])).sum::<f64>() / (n - 1.0))
        });
        let correlation = std::array::from_fn(|r| {
            std::array::from_fn(|c| {
                let spread = (covariance[r][r] * covariance[c][c]).sqrt();
                (spread > 1e-12).then(|| (covariance[r][c] / spread).clamp(-1.0, 1.0))
            })
        });
        let (minimum, maximum) = (fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max));
        Some(ColourStatistics { mean, minimum, maximum, covariance, correlation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// NumPy's `cov` and `corrcoef` of the same four colours.
    #[test]
    fn as_numpy_has_it() {
        let colours = [[0.9, 0.5, 0.1], [0.8, 0.45, 0.2], [1.0, 0.6, 0.05], [0.7, 0.3, 0.15]];
        let s = SampleStatistics::new(&colours).expect("four").rgb;
        assert!((s.mean[1] - 0.4625).abs() < 1e-12 && s.minimum == [0.7, 0.3, 0.05] && s.maximum == [1.0, 0.6, 0.2]);
        let expected = [
            [0.016666666666666666, 0.015833333333333335, -0.006666666666666667],
            [0.015833333333333335, 0.015625, -0.005416666666666667],
            [-0.006666666666666667, -0.005416666666666667, 0.004166666666666667],
        ];
        for r in 0..3 {
            for c in 0..3 {
                assert!((s.covariance[r][c] - expected[r][c]).abs() < 1e-12, "{r} {c}: {}", s.covariance[r][c]);
            }
        }
        assert!((s.correlation[0][1].expect("varies") - 0.98115578).abs() < 1e-7);
        assert!(SampleStatistics::new(&colours[..1]).is_none());
    }
}
