//! The cosine transform of a profile of any length, by the crate `rustdct`.
//!
//! A crate of its own, because `rustfft` is compiled into whatever names a type for its numbers, and takes a minute. It
//! imports no other of the house.

#![warn(missing_docs)]

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
