//! The cosine transform of any length, for the profiles of [`super::banding`], by the crate `rustdct`.

use rustdct::{DctPlanner, TransformType2And3};
use std::sync::Arc;

fn plan(length: usize) -> Arc<dyn TransformType2And3<f64>> {
    DctPlanner::new().plan_dct2(length)
}

/// D(u) = Σ f(x) · cos(π u (x + ½) / n): the Fourier transform of the profile continued as in a mirror, so that its
/// ends make no step.
pub fn cosine(f: &[f64]) -> Vec<f64> {
    let mut all = f.to_vec();
    plan(f.len()).process_dct2(&mut all);
    all
}

/// The profile whose [`cosine`] transform is `d`: f(x) = (D(0) + 2 Σ D(u) cos(π u (x + ½) / n)) / n.
pub fn cosine_back(d: &[f64]) -> Vec<f64> {
    let mut all = d.to_vec();
    plan(d.len()).process_dct3(&mut all);
    all.iter_mut().for_each(|v| *v *= 2.0 / d.len() as f64);
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn the_transform_is_the_sum_and_turns_back() {
        for n in [1usize, 2, 7, 64, 131] {
            let f: Vec<f64> = (0..n).map(|i| ((i * i * 37 + 11) % 101) as f64 - 50.0).collect();
            let d = cosine(&f);
            for (u, v) in d.iter().enumerate() {
                let sum: f64 =
                    f.iter().enumerate().map(|(x, f)| f * (PI * u as f64 * (x as f64 + 0.5) / n as f64).cos()).sum();
                assert!((v - sum).abs() < 1e-8, "{n} {u}: {v} {sum}");
            }
            let back = cosine_back(&d);
            assert!(back.iter().zip(&f).all(|(a, b)| (a - b).abs() < 1e-9), "{n}");
        }
    }
}
