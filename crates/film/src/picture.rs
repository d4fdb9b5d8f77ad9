//! A mark as one frame shows it, ready to be compared at every decimation.

use std::cell::OnceCell;

use super::correlate::Matcher;
use super::template::{Linear, Model, draw};

/// Coarsest picture: one value for 2⁶ × 2⁶ pixels.
const COARSEST: usize = 6;

/// A mark as one frame shows it, drawn once for every level at which it is compared.
pub struct Picture<'a> {
    pub model: &'a Model,
    pub linear: Linear,
    levels: [OnceCell<Option<Matcher>>; COARSEST + 1],
}

impl<'a> Picture<'a> {
    /// Nothing is drawn yet; `linear` takes millimetres on the film to pixels.
    pub fn new(model: &'a Model, linear: Linear) -> Picture<'a> {
        Picture { model, linear, levels: Default::default() }
    }

    /// Pixels of a millimetre, the root of its area.
    pub fn px_per_mm(&self) -> f64 {
        (self.linear[0] * self.linear[3] - self.linear[1] * self.linear[2]).abs().sqrt()
    }

    /// At one value per `factor` pixels, a power of two up to 64; `None` as for [`draw`].
    pub fn at(&self, factor: u64) -> Option<&Matcher> {
        let level = (factor.trailing_zeros() as usize).min(COARSEST);
        let matcher = || draw(self.model, self.linear, (1u64 << level) as f64, None).map(|t| Matcher::of(&t));
        self.levels[level].get_or_init(matcher).as_ref()
    }
}
