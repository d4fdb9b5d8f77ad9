//! Median and NMAD of the differences that a state leaves, in one pass.

use crate::error::Result;
use crate::histogram::FloatHistogram;
use crate::source::Patch;
use crate::stream::{self, Means};
use crate::zeros::Zeros;

use super::fit::{Moved, MovedBuffers, Pair, State, mark_stable};
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
    let grid = pair.template.grid();
    let other = Moved::of(pair, state.shift);
    struct Worker {
        histogram: FloatHistogram<BITS>,
        zeros: Zeros,
        scratch: MovedBuffers,
        template: Vec<f64>,
        other: Vec<f64>,
        stable: Vec<u32>,
    }
    let worker = || Worker {
        histogram: FloatHistogram::default(),
        zeros: Zeros::default(),
        scratch: MovedBuffers::default(),
        template: Vec::new(),
        other: Vec::new(),
        stable: Vec::new(),
    };
    let tiles = means.tiles(grid.width, grid.height);
    let parts = stream::gather(&tiles, means.threads, worker, |worker, core| {
        let (width, height) = (core.width as usize, core.height as usize);
        let patch = Patch::from(core);
        if pair.template.holds_nothing(patch) {
            return Ok(());
        }
        pair.template.read(patch, &mut worker.template)?;
        other.read_with(patch, &mut worker.scratch, &mut worker.other)?;
        mark_stable(pair, &grid, core, &mut worker.stable);
        let frame = &pair.frame;
        let level = (state.surface.degree == Degree::Level).then_some(state.surface.coefficients[0]);
        for row in 0..height {
            let y = grid.y0 + ((core.y + row as u64) as f64 + 0.5) * grid.step_y;
            let v = (y - frame.y) / frame.half_y;
            for column in 0..width {
                let at = row * width + column;
                let surface = level.unwrap_or_else(|| {
                    let x = grid.x0 + ((core.x + column as u64) as f64 + 0.5) * grid.step_x;
                    state.surface.at((x - frame.x) / frame.half_x, v)
                });
                let difference = worker.template[at] - worker.other[at] - surface;
                if worker.stable[at] != 0 && !difference.is_nan() {
                    worker.histogram.add(difference as f32);
                    worker.zeros.see(worker.template[at], worker.other[at]);
                }
            }
        }
        Ok(())
    })?;
    let mut histogram = FloatHistogram::<BITS>::default();
    let mut zeros = Zeros::default();
    for part in &parts {
        histogram.merge(&part.histogram);
        zeros.merge(part.zeros);
    }
    let filled = histogram.filled();
    let median = filled.quantile(0.5).unwrap_or(f64::NAN);
    let nmad = 1.4826 * filled.median_distance(median);
    let (centre, scale) = filled.core().filter(|(_, scale)| nmad > WIDENED * scale).unwrap_or((median, nmad));
    let mean = filled.mean_within(centre, CLIP * scale).unwrap_or(f64::NAN);
    let (densest, half) = filled.shortest_half().unwrap_or((f64::NAN, f64::NAN));
    let scale_zero = 1.4826 * filled.median_distance(0.0);
    Ok(Spread {
        median,
        nmad,
        mean,
        densest,
        scale_densest: 1.4826 * half,
        scale_zero,
        count: histogram.total(),
        zeros,
    })
}
