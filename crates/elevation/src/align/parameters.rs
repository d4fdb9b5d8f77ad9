//! What a fit looks for: a shift, and the terms of a surface.

use super::method::Method;
use super::surface::{Degree, Surface};

/// East and north (in cells of the template, along its axes) come before the terms of the surface.
pub const SHIFTS: usize = 2;

/// Where the other model is read, and the surface that is left between the two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// The template's X meets the other's X + shift; units of the CRS.
    pub shift: (f64, f64),
    /// template − other, in the normalised coordinates of [`super::pair::Frame`].
    pub surface: Surface,
}

/// What is fitted: a shift or none, and a surface. The parameters that are free lie side by side.
#[derive(Clone, Copy)]
pub(super) struct Free {
    pub moves: bool,
    pub surface: Degree,
}

impl Free {
    /// What a method adjusts at the most.
    pub fn of(method: Method) -> Free {
        let surface = match method {
            Method::Auto | Method::Tilt => Degree::Linear,
            Method::NuthKaab | Method::Lzd | Method::Bias => Degree::Level,
        };
        Free { moves: method.moves(), surface }
    }

    /// The same with another surface.
    pub fn with(self, surface: Degree) -> Free {
        Free { surface, ..self }
    }

    /// The first unknown that is free: shifts stand before the surface.
    pub fn first(self) -> usize {
        if self.moves { 0 } else { SHIFTS }
    }

    /// How many unknowns are free.
    pub fn count(self) -> usize {
        SHIFTS + self.surface.terms() - self.first()
    }
}
