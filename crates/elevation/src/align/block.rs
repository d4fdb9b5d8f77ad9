//! What the cells of a block tell about shift and surface: the inner loop of a pass.

use crate::grid::Grid;
use crate::stream::BLOCK_PX;
use crate::window::Window;

use super::pair::Pair;
use super::parameters::{SHIFTS, State};
use super::sums::{Flats, Gather, Partial, ROUGH, SLOPES, Sums};
use super::surface::terms;

/// Upper limits of the slope classes, as tangents; the last has none.
const SLOPE_LIMITS: [f64; SLOPES - 1] = [0.03, 0.07, 0.15, 0.3, 0.5, 0.8, 1.2];

/// Squared height differences between neighbours that count as none.
const LEVEL: f64 = 1e-18;

/// Cells along a block.
pub const SIDE: usize = BLOCK_PX as usize;

/// A tile of both models with at least one cell around it.
pub struct View<'a> {
    pub pair: &'a Pair<'a>,
    pub grid: &'a Grid,
    pub core: Window,
    pub template: &'a [f64],
    /// Cells around the tile that the template has.
    pub margin: usize,
    /// The template smoothed; empty where nothing is solved for.
    pub smooth: &'a [f64],
    pub other: &'a [f64],
}

/// Cells of one row of a block, before any is asked whether it counts: whole rows are quicker.
struct Line {
    difference: [f64; SIDE],
    template: Gradient,
    smooth: Gradient,
    other: Gradient,
}

/// Height differences along the axes of a grid, metres a cell, of some cells of one row.
#[derive(Clone, Copy)]
pub struct Gradient {
    pub x: [f64; SIDE],
    pub y: [f64; SIDE],
}

impl Gradient {
    pub const NONE: Gradient = Gradient { x: [0.0; SIDE], y: [0.0; SIDE] };

    /// Takes that of `count` cells from `at` on, in rows of `stride`.
    #[inline(always)]
    pub fn take(&mut self, cells: &[f64], at: usize, stride: usize, count: usize) {
        let halves = |out: &mut [f64; SIDE], distance: usize| {
            let (before, after) = (&cells[at - distance..][..count], &cells[at + distance..][..count]);
            out.iter_mut().zip(after.iter().zip(before)).for_each(|(half, (a, b))| *half = (a - b) / 2.0);
        };
        halves(&mut self.x, 1);
        halves(&mut self.y, stride);
    }

    #[inline]
    fn at(&self, cell: usize) -> [f64; 2] {
        [self.x[cell], self.y[cell]]
    }
}

/// How a residual of a slope class is weighed, by its scale.
struct Scales {
    inverse: [f64; SLOPES],
    inverse2: [f64; SLOPES],
}

impl Scales {
    fn of(gather: Gather) -> Scales {
        let scales = match gather {
            Gather::Residuals | Gather::Scatter { .. } => [1.0; SLOPES],
            Gather::Normal { scales, .. } | Gather::Scores { scales, .. } => scales,
        };
        Scales { inverse: scales.map(|s| 1.0 / s), inverse2: scales.map(|s| 1.0 / (s * s)) }
    }
}

impl Line {
    const NONE: Line =
        Line { difference: [0.0; SIDE], template: Gradient::NONE, smooth: Gradient::NONE, other: Gradient::NONE };

    /// Takes `count` cells of the tile from a row and a column on.
    #[inline(always)]
    fn take(&mut self, view: &View<'_>, (row, column): (usize, usize), count: usize, gather: Gather) {
        let width = view.core.width as usize;
        let place = |margin: usize| ((row + margin) * (width + 2 * margin) + column + margin, width + 2 * margin);
        let ((at, stride), (of_template, wide)) = (place(1), place(view.margin));
        let cells = view.template[of_template..][..count].iter().zip(&view.other[at..][..count]);
        self.difference.iter_mut().zip(cells).for_each(|(difference, (t, o))| *difference = t - o);
        self.template.take(view.template, of_template, wide, count);
        self.other.take(view.other, at, stride, count);
        if gather.solves() {
            self.smooth.take(view.smooth, at, stride, count);
        }
    }
}

impl View<'_> {
    /// Gathers what the cells of `block`, a part of the tile, tell.
    pub fn block<const N: usize>(
        &self,
        block: Window,
        state: &State,
        (gather, flats): (Gather, Flats),
        stable: &[u32],
        sums: &mut Sums,
    ) -> Partial<N> {
        let (grid, frame) = (self.grid, &self.pair.frame);
        let (width, count) = (self.core.width as usize, block.width as usize);
        let scales = Scales::of(gather);
        let coefficients = &state.surface.coefficients;
        let mut partial = Partial { matrix: [[0.0; N]; N], right: [0.0; N], rough: [0.0; ROUGH] };
        let u: [f64; SIDE] = std::array::from_fn(|k| {
            let x = grid.x0 + ((self.core.x + block.x + k as u64) as f64 + 0.5) * grid.step_x;
            (x - frame.x) / frame.half_x
        });
        let mut line = Line::NONE;
        let (mut common, mut sloping, mut used) = (0, 0, 0);
        for row in block.y..block.bottom() {
            let y = grid.y0 + ((self.core.y + row) as f64 + 0.5) * grid.step_y;
            let v = (y - frame.y) / frame.half_y;
            let (mx, my) = self.pair.unit.metres_per_unit(y);
            let (per_x, per_y) = (1.0 / (mx * grid.step_x), 1.0 / (my * grid.step_y));
            let (row, column) = (row as usize, block.x as usize);
            line.take(self, (row, column), count, gather);
            let stable = &stable[row * width + column..][..count];
            for k in (0..count).filter(|&k| stable[k] != 0 && !line.difference[k].is_nan()) {
                let ([tx, ty], [ox, oy]) = (line.template.at(k), line.other.at(k));
                let complete = !(tx + ty + ox + oy).is_nan();
                if flats == Flats::LeftOut && !complete {
                    continue;
                }
                common += 1;
                let level = complete && (tx * tx + ty * ty <= LEVEL || ox * ox + oy * oy <= LEVEL);
                if level && flats == Flats::LeftOut {
                    continue;
                }
                sloping += 1;
                let mut left = terms::<N, SHIFTS>(u[k], v);
                let surface: f64 = coefficients.iter().zip(&left[SHIFTS..]).map(|(c, term)| c * term).sum();
                let residual = line.difference[k] - surface;
                let class = if complete { slope_class((tx * per_x).powi(2) + (ty * per_y).powi(2)) } else { 0 };
                sums.residuals[class].add(residual.abs());
                let (weighing, derivative) = match gather {
                    Gather::Residuals | Gather::Scatter { .. } => continue,
                    Gather::Normal { weighing, .. } => (weighing, false),
                    Gather::Scores { weighing, .. } => (weighing, true),
                };
                let (weight, slope) = weighing.at(residual * scales.inverse[class]);
                if weight == 0.0 && slope == 0.0 {
                    continue;
                }
                used += 1;
                let (weight, slope) = (weight * scales.inverse2[class], slope * scales.inverse2[class]);
                // Without neighbours there is a height, no gradient.
                let (rough, other) = if complete { ([tx, ty], [ox, oy]) } else { ([0.0; 2], [0.0; 2]) };
                // Beside a hole nothing is smooth.
                let smooth = line.smooth.at(k);
                let smooth = if complete && !(smooth[0] + smooth[1]).is_nan() { smooth } else { rough };
                let mut right = left;
                (left[0], left[1], right[0], right[1]) = (smooth[0], smooth[1], other[0], other[1]);
                let curvature = if derivative { slope } else { weight };
                if derivative {
                    partial.add_rough(rough, other, curvature, weight * residual);
                }
                partial.add(&left, &right, curvature, weight * residual);
            }
        }
        sums.common += common;
        sums.sloping += sloping;
        sums.used += used;
        partial
    }
}

/// Counted, not searched: a processor need not guess where the search ends.
#[inline]
fn slope_class(tangent2: f64) -> usize {
    SLOPE_LIMITS.iter().map(|limit| usize::from(tangent2 >= limit * limit)).sum()
}
