//! One streamed pass over both models: the normal equations of shift and surface, robustly weighted.
//!
//! The linearised model is that of the least-squares z-difference (K. Rosenholm and K. Torlegård, *Three-dimensional
//! absolute orientation of stereo models using digital elevation models*, 1988), of whose seven parameters the shift
//! and the two tilts are kept, and a surface of the second or third degree on request. Where it differs: the estimating
//! equations take the gradient of the template, which no interpolation has touched and whose noise has nothing in
//! common with that of the other model, so that noise does not draw the shift; that gradient is smoothed, for where
//! the ground is rough from cell to cell no interpolation is true ([`super::smooth`]); and the matrix is the mixed
//! product of both models' gradients, which noise does not enlarge.

use crate::error::Result;
use crate::footprint::{Buffers, Footprints};
use crate::grid::{Grid, GroundUnit};
use crate::resample::{Interpolation, Resampled, Scratch};
use crate::source::{Heights, Patch};
use crate::stream::{self, BLOCK_PX, Means};
use crate::window::Window;
use crate::zones::Zones;
use autoref_raster::exact_sum::ExactSum;

use super::block::{Partial, View};
use super::residuals::AbsHistogram;
use super::smooth::{REACH_PX, Smooth};
use super::surface::{Degree, Surface};

/// East and north (in cells of the template, along its axes) come before the terms of the surface.
pub const SHIFTS: usize = 2;

/// Number of slope classes.
pub const SLOPES: usize = 8;
/// The middle of each class: how much a residual there tells about the shift.
pub const SLOPE_TANGENTS: [f64; SLOPES] = [0.015, 0.05, 0.11, 0.22, 0.4, 0.65, 1.0, 1.5];

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
    pub fn of(grid: &Grid) -> Frame {
        let (x, y) = grid.centre();
        let half = |step: f64, count: u64| step.abs() * count as f64 / 2.0;
        Frame { x, y, half_x: half(grid.step_x, grid.width), half_y: half(grid.step_y, grid.height) }
    }
}

/// Where the other model is read, and the surface that is left between the two.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// The template's X meets the other's X + shift; units of the CRS.
    pub shift: (f64, f64),
    /// template − other, in the normalised coordinates of [`Frame`].
    pub surface: Surface,
}

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

/// What a pass does beside the histograms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gather {
    /// Nothing.
    Residuals,
    /// Nothing, of every n-th row of blocks: how wide residuals scatter.
    Scatter { blocks_apart: u64 },
    /// Normal equations with the weights.
    Normal { scales: [f64; SLOPES], weighing: Weighing },
    /// Normal equations with the derivative of the weighed residual, and the scores block by block, for the covariance.
    Scores { scales: [f64; SLOPES], weighing: Weighing, block_px: u64 },
}

impl Gather {
    pub(super) fn solves(&self) -> bool {
        matches!(self, Gather::Normal { .. } | Gather::Scores { .. })
    }
}

/// Cells that say much of the whole: how wide residuals scatter, roughly where the shift lies. Of larger models every
/// n-th part is looked at, n at most [`MOST_APART`].
const ENOUGH_CELLS: u64 = 1_000_000;
const MOST_APART: u64 = 16;

/// Every how many-th row, or row of blocks, is looked at.
pub(super) fn apart(grid: &Grid) -> u64 {
    (grid.width.saturating_mul(grid.height) / ENOUGH_CELLS).clamp(1, MOST_APART)
}

/// The scatter of the residuals, from as many cells as say it well.
///
/// # Errors
/// When a model cannot be read.
pub fn scatter(pair: &Pair<'_>, state: &State, flats: Flats, means: Means) -> Result<Sums> {
    let blocks_apart = apart(&pair.template.grid());
    if blocks_apart > 1 {
        let sums = pass(pair, state, Gather::Scatter { blocks_apart }, flats, means)?;
        // Common ground may lie in a few rows.
        if sums.sloping >= ENOUGH_CELLS / MOST_APART {
            return Ok(sums);
        }
    }
    pass(pair, state, Gather::Residuals, flats, means)
}

/// Whether cells without any slope take part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flats {
    /// Water and filled holes tell nothing about a shift.
    LeftOut,
    Kept,
}

/// What a pass gathers. Sums are exact, so that joining them in any order gives the same bits.
#[derive(Clone)]
pub struct Sums {
    /// Shifts, and terms of the surface.
    parameters: usize,
    matrix: Vec<ExactSum>,
    right: Vec<ExactSum>,
    /// Matrix (row by row) and right-hand side of the shift with the template's gradient as it is.
    rough: [ExactSum; ROUGH],
    /// By slope class.
    pub residuals: Vec<AbsHistogram>,
    /// Cells that both models have (and that lie on stable ground, where that is given).
    pub common: u64,
    /// Of them, those with a slope.
    pub sloping: u64,
    /// Of them, those whose weight is not zero.
    pub used: u64,
    /// Scores by block, fixed point, `parameters` for each.
    scores: Vec<i128>,
    /// Matrices by block, fixed point, where there are few blocks; else empty.
    matrices: Vec<i128>,
}

/// Of more blocks none weighs enough to be told from the others.
const BLOCKS_APART: usize = 2048;

/// Of the shift's own equations: four of the matrix, two of the right-hand side.
pub(super) const ROUGH: usize = 6;

/// Units of a score: 2⁻⁵⁰.
const SCORE_UNIT: f64 = (1u64 << 50) as f64;

impl Sums {
    fn new(parameters: usize, blocks: usize) -> Self {
        Sums {
            parameters,
            matrix: vec![ExactSum::default(); parameters * parameters],
            right: vec![ExactSum::default(); parameters],
            rough: Default::default(),
            residuals: vec![AbsHistogram::default(); SLOPES],
            common: 0,
            sloping: 0,
            used: 0,
            scores: vec![0; parameters * blocks],
            matrices: vec![0; if blocks <= BLOCKS_APART { parameters * parameters * blocks } else { 0 }],
        }
    }

    pub fn merge(&mut self, other: &Sums) {
        self.matrix.iter_mut().zip(&other.matrix).for_each(|(a, b)| a.merge(b));
        self.right.iter_mut().zip(&other.right).for_each(|(a, b)| a.merge(b));
        self.rough.iter_mut().zip(&other.rough).for_each(|(a, b)| a.merge(b));
        self.residuals.iter_mut().zip(&other.residuals).for_each(|(a, b)| a.merge(b));
        self.common += other.common;
        self.sloping += other.sloping;
        self.used += other.used;
        self.scores.iter_mut().zip(&other.scores).for_each(|(a, b)| *a += b);
        self.matrices.iter_mut().zip(&other.matrices).for_each(|(a, b)| *a += b);
    }

    /// How many parameters the equations are of.
    pub fn parameters(&self) -> usize {
        self.parameters
    }

    /// An element of the normal equations' matrix.
    pub fn matrix(&self, row: usize, column: usize) -> f64 {
        self.matrix[row * self.parameters + column].value()
    }

    /// An element of their right-hand side.
    pub fn right(&self, row: usize) -> f64 {
        self.right[row].value()
    }

    /// The step of the shift, cells, by the template's gradient as it is, after a pass for scores. From the step that
    /// the smoothed gradient tells it differs by what interpolation makes of rough ground. `None` where the equations
    /// have no solution.
    pub fn rough_step(&self) -> Option<[f64; SHIFTS]> {
        let [xx, xy, yx, yy, x, y] = self.rough.each_ref().map(ExactSum::value);
        let determinant = xx * yy - xy * yx;
        let step = [(yy * x - xy * y) / determinant, (xx * y - yx * x) / determinant];
        step.iter().all(|v| v.is_finite()).then_some(step)
    }

    /// Scores of the blocks, row by row, [`Sums::parameters`] for each.
    pub fn block_scores(&self) -> Vec<f64> {
        self.scores.iter().map(|v| *v as f64 / SCORE_UNIT).collect()
    }

    /// What each block adds to the matrix of the normal equations, row by row; empty where there are many blocks.
    pub fn block_matrices(&self) -> Vec<f64> {
        self.matrices.iter().map(|v| *v as f64 / SCORE_UNIT).collect()
    }

    /// Standard deviation of the residuals in each slope class; a class with few cells has that of all.
    ///
    /// `floor`: what a scale is at least. No class counts as more than ten times as precise as all together.
    pub fn scales(&self, floor: f64) -> [f64; SLOPES] {
        const ENOUGH: u64 = 200;
        let mut all = AbsHistogram::default();
        self.residuals.iter().for_each(|h| all.merge(h));
        let overall = all.scale();
        std::array::from_fn(|class| {
            let own = &self.residuals[class];
            let scale = if own.total >= ENOUGH { own.scale() } else { overall };
            scale.max(overall / 10.0).max(floor)
        })
    }

    /// How badly the models fit where they slope: scales of the classes, weighed by their tangents and counts.
    pub fn misfit(&self) -> f64 {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (histogram, tangent) in self.residuals.iter().zip(SLOPE_TANGENTS) {
            sum += histogram.median() * tangent * histogram.total as f64;
            weight += tangent * histogram.total as f64;
        }
        if weight > 0.0 { sum / weight } else { f64::INFINITY }
    }
}

/// Buffers of a worker.
struct Worker {
    sums: Sums,
    scratch: MovedBuffers,
    template: Vec<f64>,
    smooth: Smooth,
    other: Vec<f64>,
    stable: Vec<u32>,
}

/// One pass over all cells of the template.
///
/// # Errors
/// When a model cannot be read.
pub fn pass(pair: &Pair<'_>, state: &State, gather: Gather, flats: Flats, means: Means) -> Result<Sums> {
    match state.surface.degree {
        Degree::Level => pass_of::<{ SHIFTS + 1 }>(pair, state, gather, flats, means),
        Degree::Linear => pass_of::<{ SHIFTS + 3 }>(pair, state, gather, flats, means),
        Degree::Quadratic => pass_of::<{ SHIFTS + 6 }>(pair, state, gather, flats, means),
        Degree::Cubic => pass_of::<{ SHIFTS + 10 }>(pair, state, gather, flats, means),
    }
}

/// The same with `N` parameters.
fn pass_of<const N: usize>(pair: &Pair<'_>, state: &State, gather: Gather, flats: Flats, means: Means) -> Result<Sums> {
    let grid = pair.template.grid();
    let blocks = match gather {
        Gather::Scores { block_px, .. } => (grid.width.div_ceil(block_px) * grid.height.div_ceil(block_px)) as usize,
        _ => 0,
    };
    let pass = Pass::<N> { pair, grid, state, gather, flats, other: Moved::of(pair, state.shift) };
    let worker = || Worker {
        sums: Sums::new(N, blocks),
        scratch: MovedBuffers::default(),
        template: Vec::new(),
        smooth: Smooth::default(),
        other: Vec::new(),
        stable: Vec::new(),
    };
    let tiles = means.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, worker, |worker, core| {
        if pair.template.holds_nothing(core.into()) {
            return Ok(());
        }
        let Gather::Scatter { blocks_apart } = gather else { return pass.look(worker, core) };
        // The same rows for any tiling.
        let rows_apart = BLOCK_PX * blocks_apart;
        for y in (core.y.next_multiple_of(rows_apart)..core.bottom()).step_by(rows_apart as usize) {
            pass.look(worker, Window::new(core.x, y, core.width, BLOCK_PX.min(core.bottom() - y)))?;
        }
        Ok(())
    })?;
    let mut whole = Sums::new(N, blocks);
    parts.iter().for_each(|part| whole.merge(&part.sums));
    Ok(whole)
}

/// A pass under way, with `N` parameters.
struct Pass<'a, const N: usize> {
    pair: &'a Pair<'a>,
    grid: Grid,
    state: &'a State,
    gather: Gather,
    flats: Flats,
    other: Moved<'a>,
}

impl<const N: usize> Pass<'_, N> {
    /// Gathers what a window tells.
    fn look(&self, worker: &mut Worker, core: Window) -> Result<()> {
        let (pair, grid) = (self.pair, &self.grid);
        let around = |cells: usize| Patch {
            x: core.x as i64 - cells as i64,
            y: core.y as i64 - cells as i64,
            width: core.width as usize + 2 * cells,
            height: core.height as usize + 2 * cells,
        };
        let patch = around(1);
        // Smoothing takes more cells.
        let margin = if self.gather.solves() { 1 + REACH_PX } else { 1 };
        let wide = around(margin);
        pair.template.read(wide, &mut worker.template)?;
        if self.gather.solves() {
            worker.smooth.take(&worker.template, wide.width);
        } else {
            worker.smooth.clear();
        }
        self.other.read_with(patch, &mut worker.scratch, &mut worker.other)?;
        mark_stable(pair, grid, core, &mut worker.stable);
        let (template, smooth, other) = (&worker.template, worker.smooth.values(), &worker.other);
        let view = View { pair, grid, core, template, margin, smooth, other };
        for y in (0..core.height).step_by(BLOCK_PX as usize) {
            for x in (0..core.width).step_by(BLOCK_PX as usize) {
                let block = Window::new(x, y, BLOCK_PX.min(core.width - x), BLOCK_PX.min(core.height - y));
                let sums = &mut worker.sums;
                let partial: Partial<N> =
                    view.block(block, self.state, (self.gather, self.flats), &worker.stable, sums);
                let index = match self.gather {
                    Gather::Scores { block_px, .. } => {
                        let across = grid.width.div_ceil(block_px);
                        Some(((core.y + y) / block_px * across + (core.x + x) / block_px) as usize)
                    }
                    _ => None,
                };
                sums.take(&partial, index);
            }
        }
        Ok(())
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

impl Sums {
    fn take<const N: usize>(&mut self, partial: &Partial<N>, block: Option<usize>) {
        for (sum, &term) in self.matrix.iter_mut().zip(partial.matrix.as_flattened()) {
            sum.add(term);
        }
        for (sum, &term) in self.right.iter_mut().zip(&partial.right) {
            sum.add(term);
        }
        for (sum, &term) in self.rough.iter_mut().zip(&partial.rough) {
            sum.add(term);
        }
        if let Some(block) = block {
            for (score, &term) in self.scores[block * N..][..N].iter_mut().zip(&partial.right) {
                *score += (term * SCORE_UNIT) as i128;
            }
            if let Some(own) = self.matrices.get_mut(block * N * N..(block + 1) * N * N) {
                for (sum, &term) in own.iter_mut().zip(partial.matrix.as_flattened()) {
                    *sum += (term * SCORE_UNIT) as i128;
                }
            }
        }
    }
}
