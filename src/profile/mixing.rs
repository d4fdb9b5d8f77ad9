//! Where the shipped colour clouds come from: a mixing model, not one photograph.
//!
//! A pixel of a mark is paint seen through wear, light and blur: the paint's reflectance, mixed in linear light with
//! 0–40 % of a ground that shines through (fading), lit by full sun to open shade (which is dimmer and bluer), mixed
//! again with up to a quarter of ground by the blur of the border, and exposed. The cloud is the mean and covariance of
//! that population in L\*a\*b\*; `tools/derive_profiles.rs` prints the TOML of every shipped profile from it.

use nalgebra::{Matrix3, Vector3};

use super::CloudSpec;
use super::colour::lab_from_srgb;
use autoref_raster::srgb::{linear_from_srgb, srgb_from_linear};

/// Reflectances of common grounds, linear red, green, blue: asphalt old and new, concrete, gravel, grass green and dry,
/// soil brown and red, sand, snow-bright lime.
pub const GROUNDS: [[f64; 3]; 10] = [
    [0.08, 0.08, 0.08],
    [0.16, 0.16, 0.155],
    [0.36, 0.35, 0.33],
    [0.28, 0.26, 0.23],
    [0.07, 0.11, 0.035],
    [0.26, 0.24, 0.12],
    [0.14, 0.10, 0.065],
    [0.24, 0.13, 0.075],
    [0.42, 0.34, 0.23],
    [0.62, 0.61, 0.58],
];

/// How much varies.
#[derive(Clone, Copy, Debug)]
pub struct Mixing {
    /// Smallest and largest share of ground that shines through the paint.
    pub fading: (f64, f64),
    /// Largest share of ground mixed in by blur.
    pub max_blur_share: f64,
    /// Dimmest light, as a share of full sun.
    pub min_light: f64,
}

impl Default for Mixing {
    fn default() -> Self {
        Mixing { fading: (0.0, 0.4), max_blur_share: 0.25, min_light: 0.25 }
    }
}

/// Radical inverse of `i` (J. H. Halton, 1960): evenly spread numbers without a random generator.
fn halton(mut i: u32, base: u32) -> f64 {
    let (mut f, mut out) = (1.0, 0.0);
    while i > 0 {
        f /= f64::from(base);
        out += f * f64::from(i % base);
        i /= base;
    }
    out
}

/// `count` sRGB colours (0..=1) of pixels of a mark in any of `paints` (sRGB 0..=255 in full sun).
pub fn population(paints: &[[u8; 3]], mixing: Mixing, count: u32) -> Vec<[f64; 3]> {
    (1..=count)
        .map(|i| {
            let paint =
                paints[(halton(i, 2) * paints.len() as f64) as usize].map(|v| linear_from_srgb(f64::from(v) / 255.0));
            let ground = GROUNDS[(halton(i, 3) * GROUNDS.len() as f64) as usize];
            let fading = mixing.fading.0 + (mixing.fading.1 - mixing.fading.0) * halton(i, 5);
            let blur = mixing.max_blur_share * halton(i, 7).powi(2);
            let light = mixing.min_light.powf(halton(i, 11).powi(2));
            // Open shade is lit by the sky: at a quarter of the sun's light blue loses a fifth less than red.
            let shade = (1.0 - light) / 0.75;
            let tint = [1.0 - 0.10 * shade, 1.0, 1.0 + 0.12 * shade];
            let own = (1.0 - fading) * (1.0 - blur);
            std::array::from_fn(|c| {
                let reflectance = own * paint[c] + (1.0 - own) * ground[c];
                srgb_from_linear((reflectance * light * tint[c]).clamp(0.0, 1.0))
            })
        })
        .collect()
}

/// Mean and covariance of the population in L\*a\*b\*.
pub fn cloud(colours: &[[f64; 3]]) -> CloudSpec {
    let lab: Vec<Vector3<f64>> = colours.iter().map(|c| lab_from_srgb(*c)).collect();
    let n = lab.len() as f64;
    let mean = lab.iter().fold(Vector3::zeros(), |s: Vector3<f64>, v| s + v) / n;
    let scatter = lab.iter().fold(Matrix3::zeros(), |s: Matrix3<f64>, v| s + (v - mean) * (v - mean).transpose()) / n;
    CloudSpec {
        mean: [mean[0], mean[1], mean[2]],
        covariance: std::array::from_fn(|r| std::array::from_fn(|c| scatter[(r, c)])),
    }
}
