//! The two models of a fit, and the cells of the one in those of the other.

use crate::error::Result;
use crate::footprint::{Buffers, Footprints};
use crate::grid::{Grid, GroundUnit};
use crate::resample::{Interpolation, Resampled, Scratch};
use crate::source::{Heights, Patch};
use crate::window::Window;
use crate::zones::Zones;

/// The two models of a fit, on grids of one CRS. `template` has the coarser cells; `other` is brought onto its grid.
pub struct Pair<'a> {
    pub template: &'a dyn Heights,
    pub other: &'a dyn Heights,
    pub unit: GroundUnit,
    /// Cells of the other along one of the template, when they are so much finer that means are taken; else 1.
    pub finer: u64,
    /// Where the ground is known to be stable.
    pub stable: Option<&'a Zones>,
    /// Middle and half size of the area over which tilts count, the same for all levels of a pyramid.
    pub frame: Frame,
}

/// The other model in the cells of the template, moved by a shift.
pub enum Moved<'a> {
    Between(Resampled<'a, dyn Heights + 'a>),
    Means(Footprints<'a, dyn Heights + 'a>),
}

/// Buffers of [`Moved::read_with`].
#[derive(Default)]
pub struct MovedBuffers {
    between: Scratch,
    means: Buffers,
}

impl<'a> Moved<'a> {
    /// The other model on the template's grid, shifted by (x, y) in units of the CRS.
    pub fn of(pair: &Pair<'a>, shift: (f64, f64)) -> Self {
        let grid = pair.template.grid();
        if pair.finer > 1 {
            Moved::Means(Footprints::new(pair.other, grid, shift))
        } else {
            Moved::Between(Resampled::new(pair.other, grid, shift, Interpolation::Lagrange).mended())
        }
    }

    /// # Errors
    /// When the other model cannot be read.
    pub fn read_with(&self, patch: Patch, buffers: &mut MovedBuffers, out: &mut Vec<f64>) -> Result<()> {
        match self {
            Moved::Between(other) => other.read_with(patch, &mut buffers.between, out),
            Moved::Means(other) => other.read_with(patch, &mut buffers.means, out),
        }
    }
}

/// Where normalised coordinates run from −1 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    pub x: f64,
    pub y: f64,
    pub half_x: f64,
    pub half_y: f64,
}

impl Frame {
    /// Of the whole grid.
    pub fn of(grid: &Grid) -> Frame {
        let (x, y) = grid.centre();
        let half = |step: f64, count: u64| step.abs() * count as f64 / 2.0;
        Frame { x, y, half_x: half(grid.step_x, grid.width), half_y: half(grid.step_y, grid.height) }
    }
}

/// 1 where the ground counts as stable, else 0, for each cell of `core`.
pub fn mark_stable(pair: &Pair<'_>, grid: &Grid, core: Window, out: &mut Vec<u32>) {
    out.clear();
    out.resize((core.width * core.height) as usize, 1);
    if let Some(zones) = pair.stable {
        for (row, line) in out.chunks_exact_mut(core.width as usize).enumerate() {
            let y = grid.y0 + ((core.y + row as u64) as f64 + 0.5) * grid.step_y;
            zones.row(y, grid.x0 + (core.x as f64 + 0.5) * grid.step_x, grid.step_x, line);
        }
    }
}
