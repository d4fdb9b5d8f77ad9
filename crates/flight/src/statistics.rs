//! Residuals as the thesis prints them (Table 9.1): maximum, minimum, mean and standard deviation (divisor n) of x, y,
//! z and of the distance d.

use serde::Serialize;

/// What values spread over.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub max: f64,
    pub min: f64,
    pub mean: f64,
    pub sd: f64,
    pub rms: f64,
}

impl Spread {
    /// `None` of nothing.
    pub fn of(values: &[f64]) -> Option<Self> {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square = values.iter().map(|v| v * v).sum::<f64>() / n;
        let sd = (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / n).sqrt();
        (!values.is_empty()).then(|| Spread {
            max: values.iter().copied().fold(f64::MIN, f64::max),
            min: values.iter().copied().fold(f64::MAX, f64::min),
            mean,
            sd,
            rms: square.sqrt(),
        })
    }
}

/// The spread of residuals along each axis and of their lengths.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Residuals {
    pub n: usize,
    pub x: Spread,
    pub y: Spread,
    pub z: Spread,
    pub d: Spread,
}

impl Residuals {
    /// Of residuals x, y, z; `None` of nothing.
    pub fn of(list: &[[f64; 3]]) -> Option<Self> {
        let axis = |a: usize| Spread::of(&list.iter().map(|r| r[a]).collect::<Vec<_>>());
        let d: Vec<f64> = list.iter().map(|r| (r[0] * r[0] + r[1] * r[1] + r[2] * r[2]).sqrt()).collect();
        Some(Residuals { n: list.len(), x: axis(0)?, y: axis(1)?, z: axis(2)?, d: Spread::of(&d)? })
    }
    /// mean² + SD² of x, y, z add up to that of d: how far they do not, in the same units.
    pub fn gap(&self) -> f64 {
        let total = |s: &Spread| s.mean * s.mean + s.sd * s.sd;
        (total(&self.x) + total(&self.y) + total(&self.z)).sqrt() - total(&self.d).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Table 9.1: mean and SD of x, y, z, d.
    const TABLE: [(&str, [[f64; 2]; 4]); 4] = [
        ("north", [[-1.63, 53.05], [-6.00, 57.41], [0.79, 15.82], [70.91, 37.03]]),
        ("east", [[-2.67, 68.22], [-1.62, 25.96], [0.43, 22.58], [52.06, 56.01]]),
        ("west", [[-0.12, 17.34], [-0.30, 18.87], [-0.00, 16.97], [28.96, 10.30]]),
        ("south", [[0.18, 29.07], [-2.64, 65.12], [0.35, 19.61], [59.73, 43.70]]),
    ];

    #[test]
    fn table_9_1_is_consistent_and_so_are_we() {
        for (line, [x, y, z, d]) in TABLE {
            let spread = |[mean, sd]: [f64; 2]| Spread { max: 0.0, min: 0.0, mean, sd, rms: 0.0 };
            let printed = Residuals { n: 0, x: spread(x), y: spread(y), z: spread(z), d: spread(d) };
            assert!(printed.gap().abs() < 0.02, "{line}: {}", printed.gap());
        }
        let ours = Residuals::of(&[[1.0, -2.0, 3.0], [-4.0, 0.5, 7.0], [2.5, 2.0, -9.0]]).expect("three");
        assert!(ours.gap().abs() < 1e-12);
        assert_eq!(Residuals::of(&[]), None);
    }
}
