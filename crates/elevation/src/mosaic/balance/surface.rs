//! Surfaces of brightness over a source: their degree, and the coordinates that they are of.

use serde::Serialize;

use super::super::source::Source;
use crate::grid::Grid;

/// The degree of the surfaces beside gains and offsets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub enum Surface {
    /// Gains and offsets alone.
    None,
    /// A plane.
    Linear,
    /// A polynomial of the second degree.
    #[default]
    Quadratic,
}

impl Surface {
    /// Numbers that a surface has.
    pub(super) fn terms(self) -> usize {
        match self {
            Surface::None => 0,
            Surface::Linear => 2,
            Surface::Quadratic => 5,
        }
    }
}

/// How brightness is evened out.
#[derive(Clone, Copy, Debug, Default)]
pub struct Balancing {
    pub surface: Surface,
    /// The number, from 0 on, of a source that is left as it is.
    pub reference: Option<usize>,
}

pub(super) const TERMS: usize = 5;

/// Where a source lies, in cells of the mosaic: its centre, and half its sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    pub centre: (f64, f64),
    pub half: (f64, f64),
}

impl Frame {
    /// Of a source, in cells of the mosaic.
    pub fn of(source: &Source, mosaic: &Grid) -> Frame {
        let centre = source.grid.centre();
        let half = |size: u64, step: f64, own: f64| (size as f64 * step / own / 2.0).abs().max(0.5);
        Frame {
            centre: ((centre.0 - mosaic.x0) / mosaic.step_x, (centre.1 - mosaic.y0) / mosaic.step_y),
            half: (
                half(source.grid.width, source.grid.step_x, mosaic.step_x),
                half(source.grid.height, source.grid.step_y, mosaic.step_y),
            ),
        }
    }

    /// What the coefficients of a surface are multiplied with.
    #[inline]
    pub fn basis(&self, (x, y): (f64, f64)) -> [f64; TERMS] {
        let (u, v) = ((x - self.centre.0) / self.half.0, (y - self.centre.1) / self.half.1);
        [u, v, u * u - 1.0 / 3.0, u * v, v * v - 1.0 / 3.0]
    }
}

#[inline]
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
