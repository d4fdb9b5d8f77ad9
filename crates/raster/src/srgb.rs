//! The transfer function of sRGB (IEC 61966-2-1).

/// One sRGB sample in 0..=1 to linear light.
pub fn linear_from_srgb(v: f64) -> f64 {
    if v <= 0.040_45 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

/// Linear light to an sRGB sample, not clipped.
pub fn srgb_from_linear(v: f64) -> f64 {
    if v <= 0.003_130_8 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}

/// [`linear_from_srgb`] of the 256 bytes.
pub fn linear_of_bytes() -> &'static [f64; 256] {
    static TABLE: std::sync::LazyLock<[f64; 256]> =
        std::sync::LazyLock::new(|| std::array::from_fn(|v| linear_from_srgb(v as f64 / 255.0)));
    &TABLE
}
