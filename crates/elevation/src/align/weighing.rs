//! How residuals are weighed by their scale.

/// How a residual is weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Weighing {
    /// Beaton and Tukey's biweight, 1974, with 95 % efficiency for normal noise.
    Biweight,
    /// All residuals within three standard deviations alike.
    Clip,
}

const BIWEIGHT: f64 = 4.685;
pub(super) const CLIP: f64 = 3.0;

impl Weighing {
    /// Weight and derivative of (weight · residual), both for unit scale.
    #[inline]
    pub(super) fn at(self, z: f64) -> (f64, f64) {
        match self {
            Weighing::Biweight => {
                let u2 = (z / BIWEIGHT).powi(2);
                if u2 >= 1.0 { (0.0, 0.0) } else { ((1.0 - u2).powi(2), (1.0 - u2) * (1.0 - 5.0 * u2)) }
            }
            Weighing::Clip if z.abs() <= CLIP => (1.0, 1.0),
            Weighing::Clip => (0.0, 0.0),
        }
    }
}
