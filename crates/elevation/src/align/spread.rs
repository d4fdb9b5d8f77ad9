//! Median and NMAD of the differences that a state leaves, in one pass.

use crate::error::Result;
use crate::histogram::FloatHistogram;
use crate::stream::{self, Means};
use crate::window::Window;
use crate::zeros::Zeros;

use super::pair::{Moved, MovedBuffers, Pair, mark_stable};
use super::parameters::State;
use super::surface::Degree;

/// Of the differences template − other − surface.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    pub median: f64,
    /// 1.4826 times the median distance from the median (J. Höhle and M. Höhle, *Accuracy assessment of digital
    /// elevation models by means of robust statistical methods*, 2009).
    pub nmad: f64,
    /// Of the differences within five NMAD of the median; where changed ground widens the NMAD, within five standard
    /// deviations of the core.
    pub mean: f64,
    /// Where most differences lie: the middle of the shortest interval that holds half of them.
    pub densest: f64,
    /// The standard deviation of normal values that have half this interval's length, and their median distance from 0.
    pub scale_densest: f64,
    pub scale_zero: f64,
    pub count: u64,
    /// With the template as A.
    pub zeros: Zeros,
}

/// Leading bits of a difference: a resolution of a two-thousandth, and interpolation within.
pub const BITS: u32 = 20;

/// How many NMAD from the median a difference counts in the mean.
const CLIP: f64 = 5.0;
/// An NMAD of so many times the core's standard deviation is that of two kinds of ground.
const WIDENED: f64 = 1.25;

/// # Errors
/// When a model cannot be read.
pub fn of(pair: &Pair<'_>, state: &State, means: Means) -> Result<Spread> {
    let [spread] = of_each(pair, [state], means)?;
    Ok(spread)
}

/// The same of several states, in one pass.
///
/// # Errors
/// When a model cannot be read.
pub fn of_each<const N: usize>(pair: &Pair<'_>, states: [&State; N], means: Means) -> Result<[Spread; N]> {
    let grid = pair.template.grid();
    let others = states.map(|state| Moved::of(pair, state.shift));
    let tiles = means.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, Worker::<N>::new, |worker, core| {
        if pair.template.holds_nothing(core.into()) {
            return Ok(());
        }
        pair.template.read(core.into(), &mut worker.template)?;
        mark_stable(pair, &grid, core, &mut worker.stable);
        for (number, (state, other)) in states.iter().zip(&others).enumerate() {
            other.read_with(core.into(), &mut worker.scratch, &mut worker.other)?;
            worker.look(pair, state, core, number);
        }
        Ok(())
    })?;
    Ok(std::array::from_fn(|number| {
        let mut seen = Seen::default();
        parts.iter().for_each(|part| seen.merge(&part.seen[number]));
        seen.spread()
    }))
}

/// What is seen of a state.
#[derive(Default)]
struct Seen {
    differences: FloatHistogram<BITS>,
    zeros: Zeros,
}

impl Seen {
    fn merge(&mut self, other: &Seen) {
        self.differences.merge(&other.differences);
        self.zeros.merge(other.zeros);
    }

    fn spread(&self) -> Spread {
        let filled = self.differences.filled();
        let median = filled.quantile(0.5).unwrap_or(f64::NAN);
        let nmad = 1.4826 * filled.median_distance(median);
        let (centre, scale) = filled.core().filter(|(_, scale)| nmad > WIDENED * scale).unwrap_or((median, nmad));
        let mean = filled.mean_within(centre, CLIP * scale).unwrap_or(f64::NAN);
        let (densest, half) = filled.shortest_half().unwrap_or((f64::NAN, f64::NAN));
        let scale_zero = 1.4826 * filled.median_distance(0.0);
        Spread {
            median,
            nmad,
            mean,
            densest,
            scale_densest: 1.4826 * half,
            scale_zero,
            count: filled.total(),
            zeros: self.zeros,
        }
    }
}

/// What a worker gathers, and its buffers.
struct Worker<const N: usize> {
    seen: [Seen; N],
    scratch: MovedBuffers,
    template: Vec<f64>,
    other: Vec<f64>,
    stable: Vec<u32>,
    differences: Vec<f32>,
}

impl<const N: usize> Worker<N> {
    fn new() -> Self {
        Worker {
            seen: std::array::from_fn(|_| Seen::default()),
            scratch: MovedBuffers::default(),
            template: Vec::new(),
            other: Vec::new(),
            stable: Vec::new(),
            differences: Vec::new(),
        }
    }

    /// Sees the cells of a tile, row by row.
    fn look(&mut self, pair: &Pair<'_>, state: &State, core: Window, number: usize) {
        let (grid, frame, width) = (pair.template.grid(), &pair.frame, core.width as usize);
        let seen = &mut self.seen[number];
        let mut zeros = Zeros::default();
        let rows = self.template.chunks_exact(width).zip(self.other.chunks_exact(width));
        for (row, ((template, other), stable)) in (core.y..).zip(rows.zip(self.stable.chunks_exact(width))) {
            let v = (grid.y0 + (row as f64 + 0.5) * grid.step_y - frame.y) / frame.half_y;
            let cells = template.iter().zip(other);
            self.differences.clear();
            if state.surface.degree == Degree::Level {
                let level = state.surface.coefficients[0];
                self.differences.extend(cells.map(|(t, o)| (t - o - level) as f32));
            } else {
                self.differences.extend((core.x..).zip(cells).map(|(column, (t, o))| {
                    let x = grid.x0 + (column as f64 + 0.5) * grid.step_x;
                    (t - o - state.surface.at((x - frame.x) / frame.half_x, v)) as f32
                }));
            }
            let cells = self.differences.iter().zip(template.iter().zip(other)).zip(stable);
            for ((&difference, (&t, &o)), &stable) in cells {
                if stable != 0 && !difference.is_nan() {
                    seen.differences.add(difference);
                    zeros.see(t, o);
                }
            }
        }
        seen.zeros.merge(zeros);
    }
}
