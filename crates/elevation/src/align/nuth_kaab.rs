//! The shift from the cosine of the aspect: Nuth and Kääb 2011, equations 2 to 4.
//!
//! dh / tan α is a cosine of the aspect whose amplitude and phase are the shift. As there, the medians of classes of
//! aspect are fitted, here 72 of them; the height is the median difference, here of the cells within three standard
//! deviations of it, lest changed ground draws it to its side.

use crate::window::Window;
use nalgebra::{Matrix3, Vector3};

use crate::error::Result;
use crate::histogram::FloatHistogram;
use crate::source::Patch;
use crate::stream::{self, Means};

use super::block::{Gradient, SIDE};
use super::fit::apart;
use super::pair::{Moved, MovedBuffers, Pair, mark_stable};
use super::parameters::State;
use super::spread;
use super::surface::Degree;

const ASPECTS: usize = 72;
const BITS: u32 = 14;
/// Gentler ground tells little, and its quotient is all noise.
const LEAST_TANGENT: f64 = 0.05;
const MOST_PASSES: u32 = 20;
const STILL_PX: f64 = 1e-3;
/// Fewest cells of a class of aspect.
const FEWEST: u64 = 20;
/// Of large models every [`apart`]-th row is looked at until a step is below this; then all of them.
const ROUGH_PX: f64 = 0.02;
/// Changed ground that lies in a few aspects would take their medians with it: where less than this share of the cells
/// lies within so many standard deviations of the core, the others take no part.
const MOSTLY: f64 = 0.95;
const KEPT: f64 = 3.0;

/// Iterates from `start` until the shift stands still. The height of every step is the median difference of the one
/// before.
///
/// # Errors
/// When a model cannot be read.
pub fn iterate(pair: &Pair<'_>, start: State, means: Means) -> Result<(State, u32)> {
    let grid = pair.template.grid();
    let mut state = start;
    state.surface = state.surface.of_degree(Degree::Level);
    let mut rows_apart = apart(&grid);
    let first = step(pair, &state, means, (rows_apart, f64::INFINITY))?;
    state.surface.coefficients[0] += first.height_m;
    let mut reach_m = first.reach_m;
    for pass in 1..=MOST_PASSES {
        let step = step(pair, &state, means, (rows_apart, reach_m))?;
        reach_m = step.reach_m;
        state.surface.coefficients[0] += step.height_m;
        let Some((east_m, north_m)) = step.shift_m else {
            if rows_apart == 1 {
                return Ok((state, pass));
            }
            rows_apart = 1;
            continue;
        };
        let (mx, my) = pair.unit.metres_per_unit(pair.frame.y);
        state.shift.0 += east_m / mx;
        state.shift.1 += north_m / my;
        let moved_px = (east_m / mx / grid.step_x).hypot(north_m / my / grid.step_y);
        if rows_apart == 1 && moved_px < STILL_PX {
            return Ok((state, pass));
        }
        if moved_px < ROUGH_PX {
            rows_apart = 1;
        }
    }
    Ok((state, MOST_PASSES))
}

/// What a pass over both models says.
struct Step {
    /// Metres towards east and north by which the other model is to be read further on; `None` where too few aspects
    /// are there.
    shift_m: Option<(f64, f64)>,
    /// Median of the differences left, of those that are no changed ground.
    height_m: f64,
    /// Farther from it lies changed ground, where there is any.
    reach_m: f64,
}

/// Classes of directions, from west over south, without an arc tangent for every cell.
struct Aspects {
    /// Where each class of a quarter begins, as [`Aspects::share`].
    begins: [f64; QUARTER + 1],
    /// The class in which each step of the share begins.
    first: [u8; Aspects::STEPS + 1],
}

/// Classes of a quarter.
const QUARTER: usize = ASPECTS / 4;

impl Aspects {
    const STEPS: usize = 256;

    fn new() -> Self {
        let begins = std::array::from_fn(|class| {
            let (across, along) = (class as f64 / QUARTER as f64 * std::f64::consts::FRAC_PI_2).sin_cos();
            // The last one is never reached.
            if class == QUARTER { f64::INFINITY } else { Self::share(along, across) }
        });
        let class_at = |share: f64| begins.iter().rposition(|&begin| begin <= share).unwrap_or(0) as u8;
        Aspects { begins, first: std::array::from_fn(|step| class_at(step as f64 / Self::STEPS as f64)) }
    }

    /// Rises with the angle from 0 to 1 over a quarter.
    fn share(along: f64, across: f64) -> f64 {
        across / (along + across)
    }

    /// The class of a direction, which must not be (0, 0). Without a branch: directions come in no order that a
    /// processor could guess.
    #[inline]
    fn of(&self, east: f64, north: f64) -> usize {
        /// By signs: east below and above 0, north below and above 0. West belongs to the first quarter.
        const QUARTERS: [u8; 16] = [0, 0, 2, 0, 1, 0, 1, 0, 3, 3, 2, 0, 0, 0, 0, 0];
        let sign = |value: f64| usize::from(value < 0.0) | usize::from(value > 0.0) << 1;
        let quarter = usize::from(QUARTERS[sign(east) | sign(north) << 2]);
        let (along, across) = if quarter % 2 == 0 { (east.abs(), north.abs()) } else { (north.abs(), east.abs()) };
        let share = Self::share(along, across);
        let first = usize::from(self.first[(share * Self::STEPS as f64) as usize]);
        // Classes are wider than steps.
        quarter * QUARTER + first + usize::from(self.begins[first + 1] <= share)
    }
}

/// What a worker gathers, and its buffers.
struct Worker {
    classes: Vec<FloatHistogram<BITS>>,
    differences: FloatHistogram<{ spread::BITS }>,
    aspects: Aspects,
    scratch: MovedBuffers,
    template: Vec<f64>,
    other: Vec<f64>,
    stable: Vec<u32>,
}

impl Worker {
    fn new() -> Self {
        Worker {
            classes: vec![FloatHistogram::default(); ASPECTS],
            differences: FloatHistogram::default(),
            aspects: Aspects::new(),
            scratch: MovedBuffers::default(),
            template: Vec::new(),
            other: Vec::new(),
            stable: Vec::new(),
        }
    }

    /// Looks at all cells of a window; differences beyond `reach_m` say nothing about the shift.
    fn look(
        &mut self,
        pair: &Pair<'_>,
        state: &State,
        other: &Moved<'_>,
        (core, reach_m): (Window, f64),
    ) -> Result<()> {
        let grid = pair.template.grid();
        let (width, height) = (core.width as usize, core.height as usize);
        let stride = width + 2;
        // Slopes need the neighbours, differences do not.
        let around = Patch { x: core.x as i64 - 1, y: core.y as i64 - 1, width: stride, height: height + 2 };
        pair.template.read(around, &mut self.template)?;
        other.read_with(core.into(), &mut self.scratch, &mut self.other)?;
        mark_stable(pair, &grid, core, &mut self.stable);
        let t = &self.template;
        let mut gradient = Gradient::NONE;
        for row in 0..height {
            let y = grid.y0 + ((core.y + row as u64) as f64 + 0.5) * grid.step_y;
            let (mx, my) = pair.unit.metres_per_unit(y);
            let (per_x, per_y) = (1.0 / (mx * grid.step_x), 1.0 / (my * grid.step_y));
            for column in (0..width).step_by(SIDE) {
                let count = SIDE.min(width - column);
                let (at, inside) = ((row + 1) * stride + column + 1, row * width + column);
                gradient.take(t, at, stride, count);
                let (east, north) = (gradient.x.map(|x| x * per_x), gradient.y.map(|y| y * per_y));
                let mut differences = [f64::NAN; SIDE];
                let heights = t[at..][..count].iter().zip(&self.other[inside..][..count]);
                differences.iter_mut().zip(heights).for_each(|(d, (t, o))| *d = t - o - state.surface.coefficients[0]);
                let tangents: [f64; SIDE] = std::array::from_fn(|k| (east[k] * east[k] + north[k] * north[k]).sqrt());
                let quotients: [f64; SIDE] = std::array::from_fn(|k| differences[k] / tangents[k]);
                let stable = &self.stable[inside..][..count];
                for k in (0..count).filter(|&k| stable[k] != 0 && !differences[k].is_nan()) {
                    self.differences.add(differences[k] as f32);
                    let tells = tangents[k] > LEAST_TANGENT && !quotients[k].is_nan();
                    if tells && differences[k].abs() <= reach_m {
                        self.classes[self.aspects.of(east[k], north[k])].add(quotients[k] as f32);
                    }
                }
            }
        }
        Ok(())
    }
}

/// A pass over every `rows_apart`-th row of the models, counted from the first: the same rows for any tiling.
fn step(pair: &Pair<'_>, state: &State, means: Means, (rows_apart, reach_m): (u64, f64)) -> Result<Step> {
    let grid = pair.template.grid();
    let other = Moved::of(pair, state.shift);
    let tiles = means.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, Worker::new, |worker, core| {
        if pair.template.holds_nothing(core.into()) {
            return Ok(());
        }
        if rows_apart == 1 {
            return worker.look(pair, state, &other, (core, reach_m));
        }
        let first = core.y.next_multiple_of(rows_apart);
        for y in (first..core.bottom()).step_by(rows_apart as usize) {
            worker.look(pair, state, &other, (Window::new(core.x, y, core.width, 1), reach_m))?;
        }
        Ok(())
    })?;
    let mut classes = vec![FloatHistogram::<BITS>::default(); ASPECTS];
    let mut differences = FloatHistogram::<{ spread::BITS }>::default();
    for part in &parts {
        differences.merge(&part.differences);
        classes.iter_mut().zip(&part.classes).for_each(|(a, b)| a.merge(b));
    }
    let differences = differences.filled();
    let (height_m, scale_m) = differences.core().unwrap_or((0.0, 0.0));
    let kept = differences.share_within(height_m, KEPT * scale_m);
    let reach_m = if kept < MOSTLY { KEPT * scale_m } else { f64::INFINITY };
    Ok(Step { shift_m: cosine(&classes), height_m, reach_m })
}

/// Least squares of median = east·cos + north·sin + constant over the classes.
fn cosine(classes: &[FloatHistogram<BITS>]) -> Option<(f64, f64)> {
    let (mut matrix, mut right, mut filled) = (Matrix3::zeros(), Vector3::zeros(), 0);
    let classes = classes.iter().map(FloatHistogram::filled).enumerate();
    for (index, class) in classes.filter(|(_, class)| class.total() >= FEWEST) {
        let direction = ((index as f64 + 0.5) / ASPECTS as f64 - 0.5) * std::f64::consts::TAU;
        let row = Vector3::new(direction.cos(), direction.sin(), 1.0);
        matrix += row * row.transpose();
        right += row * class.quantile(0.5)?;
        filled += 1;
    }
    if filled < ASPECTS / 4 {
        return None;
    }
    let solution = matrix.lu().solve(&right)?;
    Some((solution[0], solution[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_of_aspect_are_those_of_the_arc_tangent() {
        let aspects = Aspects::new();
        for k in 0..72_000 {
            let angle = (f64::from(k) + 0.5) / 72_000.0 * std::f64::consts::TAU - std::f64::consts::PI;
            for length in [1e-3, 0.3, 40.0] {
                let (north, east) = (length * angle.sin(), length * angle.cos());
                let turn = north.atan2(east) / std::f64::consts::TAU + 0.5;
                assert_eq!(aspects.of(east, north), (turn * ASPECTS as f64) as usize, "{angle}");
            }
        }
        // West is the end of the circle and its beginning: either class is right.
        let on_axes = [(-1.0, 0.0), (0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, -0.0)];
        assert_eq!(on_axes.map(|(east, north)| aspects.of(east, north)), [0, 18, 36, 54, 0]);
    }
}
