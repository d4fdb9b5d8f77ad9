//! From coarse to fine: where the shift may be, and the fit that ends there.

use autoref_raster::ranks::upper_median_and_distance;
use nalgebra::{DMatrix, DVector};

use crate::error::Result;
use crate::grid::Grid;
use crate::resample::{Interpolation, Resampled};
use crate::source::{Heights as _, MemoryHeights, Patch};
use crate::stream::{self, Means};

use super::covariance::{covariance, score_block_px};
use super::fit;
use super::method::{Method, Options};
use super::pair::Pair;
use super::parameters::{Free, SHIFTS, State};
use super::pyramid::{Level, SEARCH_CELLS, level_of_degree, pyramid};
use super::sums::{Flats, Gather, SLOPES, Sums};
use super::surface::Degree;
use super::weighing::Weighing;
use super::{nuth_kaab, spread};

/// Fewest common cells of a fit.
const FEWEST_CELLS: u64 = 50;
/// A shift less certain than this, in cells, is none.
const WORST_SHIFT_PX: f64 = 0.5;
/// Residuals are not taken for better than this, metres: the last place of a 32-bit height.
const FLOOR_M: f64 = 1e-4;
/// Places at which one shift is tried.
const SEARCH_SAMPLES: usize = 800;
/// Candidate shifts that are followed up.
const CANDIDATES: usize = 3;

/// What was fitted, in cells of the template.
pub struct Fitted {
    pub state: State,
    pub covariance: DMatrix<f64>,
    /// Share of the common cells with any weight.
    pub share: f64,
    pub common: u64,
    pub iterations: u32,
}

/// What a search ends with.
pub enum Found {
    Fitted(Box<Fitted>),
    Nothing(String),
}

/// Finds the state that brings the two models together.
///
/// # Errors
/// When a model cannot be read.
pub fn run(full: &Pair<'_>, options: &Options<'_>, flats: Flats) -> Result<Found> {
    let levels = pyramid(full, options)?;
    let mut free = Free::of(options.method);
    let weighing = if options.method == Method::Lzd { Weighing::Clip } else { Weighing::Biweight };
    let fitter = Fitter { full, flats, weighing, means: options.means };
    let nothing = |why: &str| Ok(Found::Nothing(why.into()));
    let flat = if free.moves && !options.method.bends() { FLAT_OR_TILTED } else { FLAT };

    let Some(state) = fitter.descend(&levels, starts(full, &levels, options)?, free)? else {
        let sloping =
            fit::pass(&levels[0].pair(full), &State::default(), Gather::Residuals, flats, options.means)?.sloping;
        return nothing(match sloping < FEWEST_CELLS {
            true if free.moves => FEW,
            true => FEW_COMMON,
            false => ONE_ASPECT,
        });
    };
    if options.method == Method::Tilt {
        free = free.with(options.surface);
    }
    let state = State { surface: state.surface.of_degree(free.surface), ..state };
    let (settled, step) = if options.method == Method::NuthKaab {
        let (state, iterations) = nuth_kaab::iterate(full, state, options.means)?;
        let sums = fit::scatter(full, &state, flats, options.means)?;
        (Settled { state, sums, iterations }, Step::Left)
    } else {
        let Some(near) = fitter.settle(full, state, free, NEAR)? else { return nothing(flat) };
        let mut start = anchored(&near, &full.template.grid());
        if options.method == Method::Auto {
            free = free.with(fitter.degree(
                &level_of_degree(full, &levels[0], options)?,
                start,
                &near,
                options.surface,
            )?);
            start.surface = start.surface.of_degree(free.surface);
        }
        let Some(settled) = fitter.settle(full, start, free, FINE)? else { return nothing(flat) };
        (settled, Step::Taken)
    };
    let Some(end) = fitter.finish(full, &settled, free, step)? else { return nothing(flat) };
    let uncertain = free.moves && (end.worst_shift_px.is_nan() || end.worst_shift_px > WORST_SHIFT_PX);
    if uncertain {
        return nothing(flat);
    }
    Ok(Found::Fitted(Box::new(Fitted {
        state: end.state,
        covariance: end.covariance,
        share: end.sums.used as f64 / end.sums.common.max(1) as f64,
        common: end.sums.common,
        iterations: settled.iterations,
    })))
}

const FEW: &str =
    "too few cells with a slope are common to both models; --method bias gives the height alone, without a shift";
const FEW_COMMON: &str = "fewer than 50 cells with heights are common to both models";
const ONE_ASPECT: &str = "the common ground slopes in one direction only, along which a shift and a height are the \
                          same; --method bias gives the height alone";
const FLAT: &str =
    "the common ground is too flat, or too unlike, for a shift to be known; --method bias or tilt does without";
/// Of methods without a tilt: one that is there counts as unlike ground.
const FLAT_OR_TILTED: &str = "the common ground is too flat, too unlike, or tilted too much, for a shift to be known; \
                              --method auto fits a tilt too, bias or tilt does without a shift";

/// Where to begin: where the files say, and where the coarsest level fits best.
///
/// Places are those of the smaller model, which may lie anywhere on the larger one and half of its size beyond: of the
/// larger one's places few would meet the other.
fn starts(full: &Pair<'_>, levels: &[Level], options: &Options<'_>) -> Result<Vec<State>> {
    let mut starts = vec![State::default()];
    let Some(level) = levels.last().filter(|_| options.method.moves()) else { return Ok(starts) };
    let area = |grid: &Grid| (grid.step_x * grid.step_y).abs() * (grid.width * grid.height) as f64;
    let swapped = area(&level.other.grid()) < area(&level.template.grid());
    let (small, large) = if swapped { (&level.other, &level.template) } else { (&level.template, &level.other) };
    let samples = steep_cells(full, small);
    if samples.len() < 20 {
        return Ok(starts);
    }
    let grid = small.grid();
    let reach = Reach::of(&grid, &large.grid());
    let (width, height) = (grid.width as usize, grid.height as usize);
    let (columns, rows) = ((reach.x.1 - reach.x.0) as usize, (reach.y.1 - reach.y.0) as usize);
    let patch = Patch { x: reach.x.0, y: reach.y.0, width: width + columns, height: height + rows };
    let mut other = Vec::new();
    Resampled::new(large, grid, (0.0, 0.0), Interpolation::Bilinear).read(patch, &mut other)?;
    let score = |dy: usize| {
        let mut scores: Vec<(f64, (i64, i64))> = Vec::new();
        let mut differences = Vec::with_capacity(samples.len());
        for dx in 0..=columns {
            differences.clear();
            let differs = |&(x, y, height): &(usize, usize, f64)| height - other[(y + dy) * patch.width + x + dx];
            differences.extend(samples.iter().map(differs).filter(|difference| !difference.is_nan()));
            let share = differences.len() as f64 / samples.len() as f64;
            if differences.len() >= 20
                && share >= 0.25
                && let Some((_, spread)) = upper_median_and_distance(&mut differences)
            {
                // Little overlap fits by chance more easily.
                scores.push((spread * (1.5 - 0.5 * share), (dx as i64 + reach.x.0, dy as i64 + reach.y.0)));
            }
        }
        scores
    };
    let mut scores = stream::each(rows + 1, options.means.threads, score).concat();
    // Of equals those come first that lie further up, then further left.
    scores.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken: Vec<(i64, i64)> = Vec::new();
    for (_, (dx, dy)) in scores {
        if taken.iter().all(|&(x, y)| (x - dx).abs().max((y - dy).abs()) > 4) {
            taken.push((dx, dy));
            let sign = if swapped { -1.0 } else { 1.0 };
            let shift = (sign * dx as f64 * grid.step_x, sign * dy as f64 * grid.step_y);
            starts.push(State { shift, ..State::default() });
        }
        if taken.len() == CANDIDATES {
            break;
        }
    }
    Ok(starts)
}

/// How far the smaller model is moved over the larger one, in its own cells: from … to, both included.
struct Reach {
    x: (i64, i64),
    y: (i64, i64),
}

impl Reach {
    fn of(small: &Grid, large: &Grid) -> Reach {
        let half = (small.width.min(small.height) / 2).clamp(2, SEARCH_CELLS / 2) as f64;
        let along = |small: [f64; 2], large: [f64; 2], step: f64| {
            let (low, high) = ((large[0] - small[0]).min(0.0), (large[1] - small[1]).max(0.0));
            let (from, to) = ((low / step).min(high / step) - half, (low / step).max(high / step) + half);
            let most = SEARCH_CELLS as i64;
            ((from.round() as i64).max(-most), (to.round() as i64).min(most))
        };
        let (s, l) = (small.bounds(), large.bounds());
        Reach { x: along([s[0], s[2]], [l[0], l[2]], small.step_x), y: along([s[1], s[3]], [l[1], l[3]], small.step_y) }
    }
}

/// Cells that slope more than most, and their heights.
fn steep_cells(full: &Pair<'_>, model: &MemoryHeights) -> Vec<(usize, usize, f64)> {
    let (grid, z) = (model.grid(), model.values());
    let (width, height) = (grid.width as usize, grid.height as usize);
    let mut stable = vec![1u32; width];
    let mut cells = Vec::new();
    for y in 1..height.saturating_sub(1) {
        if let Some(zones) = full.stable {
            let north = grid.y0 + (y as f64 + 0.5) * grid.step_y;
            zones.row(north, grid.x0 + 0.5 * grid.step_x, grid.step_x, &mut stable);
        }
        for x in (1..width.saturating_sub(1)).filter(|&x| stable[x] != 0) {
            let at = y * width + x;
            let gradient = (z[at + 1] - z[at - 1]).hypot(z[at + width] - z[at - width]);
            if gradient > 0.0 && !z[at].is_nan() {
                cells.push((gradient, x, y));
            }
        }
    }
    cells.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    cells.truncate((cells.len() * 7).div_ceil(10));
    // Evenly over the ground, not only the steepest.
    cells.sort_by_key(|&(_, x, y)| (y, x));
    let step = cells.len().div_ceil(SEARCH_SAMPLES).max(1);
    cells.iter().step_by(step).map(|&(_, x, y)| (x, y, z[y * width + x])).collect()
}

/// The nearest state whose shift is whole 64ths of a cell, and whose heights are of the scatter's power of two. How a
/// fit comes near its end depends on how coarse the search began, which memory decides; from a place that all ways
/// share it ends in the same bits.
fn anchored(near: &Settled, grid: &Grid) -> State {
    /// A power of two: its multiples are exact.
    const PART: f64 = 1.0 / 64.0;
    let scale = near.sums.scales(FLOOR_M).iter().copied().fold(f64::INFINITY, f64::min);
    let scale = if scale.is_finite() { scale.clamp(1e-2, 1e3).log2().round().exp2() } else { 1.0 };
    let nearest = |value: f64, unit: f64| (value / (unit * PART)).round() * (unit * PART);
    let mut state = near.state;
    state.shift = (nearest(state.shift.0, grid.step_x), nearest(state.shift.1, grid.step_y));
    state.surface.coefficients.iter_mut().for_each(|value| *value = nearest(*value, scale));
    state
}

/// Index of the smallest misfit.
fn least(candidates: &[(State, f64)]) -> usize {
    (0..candidates.len()).min_by(|&a, &b| candidates[a].1.total_cmp(&candidates[b].1)).unwrap_or(0)
}

/// When a fit has settled.
#[derive(Clone, Copy)]
struct Precision {
    step_px: f64,
    passes: u32,
}

const COARSE: Precision = Precision { step_px: 1e-3, passes: 30 };
/// Before and after the state is brought to a place of its own ([`anchored`]); the same whether the models are held or
/// streamed. A last step with the full curvature follows.
const NEAR: Precision = Precision { step_px: 1e-3, passes: 30 };
const FINE: Precision = Precision { step_px: 1e-4, passes: 30 };

struct Settled {
    state: State,
    sums: Sums,
    iterations: u32,
}

/// Share of what smoothing takes away of the bias of rough ground that may still be left.
const ROUGH_SHARE: f64 = 0.4;

/// Whether the last step is taken, or only the covariance is wanted.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Step {
    Taken,
    Left,
}

/// The end of a fit.
struct End {
    state: State,
    covariance: DMatrix<f64>,
    worst_shift_px: f64,
    sums: Sums,
}

/// What became of a candidate at a level.
enum Followed {
    /// Where it came to, and its misfit.
    Settled(State, f64),
    /// The equations have no solution here.
    Unsettled(State),
    /// The models have no cell in common there.
    Nowhere,
}

struct Fitter<'a> {
    full: &'a Pair<'a>,
    flats: Flats,
    weighing: Weighing,
    means: Means,
}

impl Fitter<'_> {
    /// Through all levels, several candidates side by side. Those that meet go on as one; below the coarsest level only
    /// the first start, which is where the files say the models are, and the best of the others are followed.
    fn descend(&self, levels: &[Level], starts: Vec<State>, free: Free) -> Result<Option<State>> {
        let mut candidates: Vec<(State, f64)> = starts.into_iter().map(|state| (state, f64::INFINITY)).collect();
        for (index, level) in levels.iter().enumerate().rev() {
            let pair = level.pair(self.full);
            let grid = level.template.grid();
            let means = self.means.shared_out(grid.width, grid.height);
            let fitter = Fitter { means, ..*self };
            let ends =
                stream::each(candidates.len(), self.means.threads, |k| fitter.follow(&pair, candidates[k], free));
            let mut settled: Vec<(State, f64)> = Vec::new();
            for end in ends {
                match end? {
                    Followed::Settled(state, misfit) => {
                        let near = |other: &State| {
                            let x = (other.shift.0 - state.shift.0) / grid.step_x;
                            let y = (other.shift.1 - state.shift.1) / grid.step_y;
                            x.hypot(y) < 0.2
                        };
                        if !settled.iter().any(|(other, _)| near(other)) {
                            settled.push((state, misfit));
                        }
                    }
                    // Too coarse to tell: the next level may.
                    Followed::Unsettled(state) if index > 0 => settled.push((state, f64::INFINITY)),
                    Followed::Unsettled(_) | Followed::Nowhere => {}
                }
            }
            candidates = settled;
            if candidates.len() > 1 {
                let best = 1 + least(&candidates[1..]);
                candidates = vec![candidates[0], candidates[best]];
            }
        }
        // The second must be clearly better: the first is where the files say the models are.
        let better = candidates.len() > 1 && candidates[1].1 < 0.98 * candidates[0].1;
        Ok(candidates.get(usize::from(better)).map(|(state, _)| *state))
    }

    /// One candidate at one level.
    fn follow(&self, pair: &Pair<'_>, (mut state, misfit): (State, f64), free: Free) -> Result<Followed> {
        if misfit.is_infinite() {
            state.surface.coefficients[0] = super::spread::of(pair, &state, self.means)?.median;
            if !state.surface.coefficients[0].is_finite() {
                return Ok(Followed::Nowhere);
            }
        }
        let end = self.settle_centred(pair, state, free)?;
        Ok(end.map_or(Followed::Unsettled(state), |end| Followed::Settled(end.state, end.sums.misfit())))
    }

    /// Iterates until the shift stands still. `None` where the equations have no solution.
    fn settle(&self, pair: &Pair<'_>, start: State, free: Free, precision: Precision) -> Result<Option<Settled>> {
        let mut state = start;
        let mut sums = fit::scatter(pair, &state, self.flats, self.means)?;
        if sums.sloping < FEWEST_CELLS {
            return Ok(None);
        }
        for iteration in 1..=precision.passes {
            let scales = sums.scales(FLOOR_M);
            let gather = Gather::Normal { scales, weighing: self.weighing };
            sums = fit::pass(pair, &state, gather, self.flats, self.means)?;
            let Some(step) = solve(&sums, free) else { return Ok(None) };
            let moved = apply(&mut state, &step, &pair.template.grid());
            let scale = scales.iter().copied().fold(f64::INFINITY, f64::min);
            let still = moved < precision.step_px && step[SHIFTS].abs() < precision.step_px * scale.max(1e-2);
            if still || iteration == precision.passes {
                return Ok(Some(Settled { state, sums, iterations: iteration }));
            }
        }
        Ok(None)
    }

    /// The same where the models are in memory, begun again where most differences lie as long as that fits better.
    ///
    /// A fit that begins far off, or with a height that changed ground has drawn to its side, takes the residuals that
    /// it meets for scatter: wide enough to keep the changed ground for good, and with it the wrong height. The shift
    /// is right to a part of a cell by then, so that the differences show where the ground is that has not changed.
    fn settle_centred(&self, pair: &Pair<'_>, start: State, free: Free) -> Result<Option<Settled>> {
        const MOST_RESTARTS: u32 = 4;
        /// What is narrower by less is no other ground, and what is less better no better fit.
        const NARROWER: f64 = 0.8;
        const BETTER: f64 = 0.95;
        let Some(mut best) = self.settle(pair, start, free, COARSE)? else { return Ok(None) };
        let mut here = spread::of(pair, &best.state, self.means)?;
        for _ in 0..MOST_RESTARTS {
            let mut again = (best.state, here);
            if free.surface > Degree::Level {
                // A tilt may be that of the changed ground.
                let level = State { surface: best.state.surface.of_degree(Degree::Level), ..best.state };
                let spread = spread::of(pair, &level, self.means)?;
                if spread.scale_densest < again.1.scale_densest {
                    again = (level, spread);
                }
            }
            let (mut state, at) = again;
            if at.scale_densest.is_nan() || at.scale_densest >= NARROWER * here.scale_zero {
                break;
            }
            state.surface.coefficients[0] += at.densest;
            state.surface = state.surface.of_degree(best.state.surface.degree);
            let Some(settled) = self.settle(pair, state, free, COARSE)? else { break };
            let next = spread::of(pair, &settled.state, self.means)?;
            if next.scale_zero >= BETTER * here.scale_zero {
                break;
            }
            (best, here) = (settled, next);
        }
        Ok(Some(best))
    }

    /// The degree of the surface that is there, as it shows at one coarseness beside the scatter of the cells
    /// themselves, to which a fit came near; no higher than `highest`.
    fn degree(&self, level: &Level, start: State, near: &Settled, highest: Degree) -> Result<Degree> {
        let pair = &level.pair(self.full);
        let scales = near.sums.scales(FLOOR_M);
        let mut degree = highest;
        while degree > Degree::Level {
            let free = Free { moves: true, surface: degree };
            let start = State { surface: start.surface.of_degree(degree), ..start };
            if let Some(settled) = self.settle(pair, start, free, COARSE)?
                && let Some(end) = self.finish(pair, &settled, free, Step::Taken)?
                && degree_matters(&end, &scales, &near.sums)
            {
                break;
            }
            degree = degree.lower();
        }
        Ok(degree)
    }

    /// A last step with the full curvature, and what it is worth.
    fn finish(&self, pair: &Pair<'_>, settled: &Settled, free: Free, last: Step) -> Result<Option<End>> {
        let grid = pair.template.grid();
        let (start, residuals) = (settled.state, &settled.sums);
        if residuals.sloping < FEWEST_CELLS {
            return Ok(None);
        }
        let block_px = score_block_px(&grid);
        let scales: [f64; SLOPES] = residuals.scales(FLOOR_M);
        let gather = Gather::Scores { scales, weighing: self.weighing, block_px };
        let sums = fit::pass(pair, &start, gather, self.flats, self.means)?;
        let Some(mut covariance) = covariance(&sums, free, &grid, block_px) else { return Ok(None) };
        let mut state = start;
        let step = solve(&sums, free);
        if let (true, Some(step), Some(rough)) = (free.moves, &step, sums.rough_step()) {
            let left = [rough[0] - step[0], rough[1] - step[1]].map(|px| ROUGH_SHARE * px);
            add_square(&mut covariance, left);
            if last == Step::Left {
                // What another method found is no surer than it agrees.
                add_square(&mut covariance, [step[0], step[1]]);
            }
        }
        if last == Step::Taken {
            let Some(step) = step else { return Ok(None) };
            // Far from its end the full curvature can point anywhere.
            if step[0].abs().max(step[1].abs()) < 0.1 {
                apply(&mut state, &step, &grid);
            }
        }
        let shift = covariance.view((0, 0), (2, 2)).symmetric_eigenvalues();
        let worst_shift_px = shift.iter().fold(0.0, |worst: f64, v| worst.max(v.abs())).sqrt();
        Ok(Some(End { state, covariance, worst_shift_px, sums }))
    }
}

/// Adds an error of the shift that no scatter shows, cells.
fn add_square(covariance: &mut DMatrix<f64>, error: [f64; SHIFTS]) {
    for (row, column) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        covariance[(row, column)] += error[row] * error[column];
    }
}

/// Whether the terms of the surface's own degree are there beyond chance (one in a thousand), and are worth a tenth of
/// the residuals' own scatter.
fn degree_matters(end: &End, scales: &[f64; SLOPES], residuals: &Sums) -> bool {
    let surface = &end.state.surface;
    let (degree, first) = (surface.degree, surface.degree.lower().terms());
    // χ² of as many terms.
    let chi2 = match degree {
        Degree::Level | Degree::Linear => 13.8,
        Degree::Quadratic => 16.3,
        Degree::Cubic => 18.5,
    };
    let count = degree.terms() - first;
    let terms = DVector::from_column_slice(&surface.coefficients[first..][..count]);
    let variance = end.covariance.view((SHIFTS + first, SHIFTS + first), (count, count)).clone_owned();
    let Some(inverse) = variance.try_inverse() else { return terms.norm() > FLOOR_M };
    let counts = residuals.residuals.iter().map(|h| h.total);
    let typical = scales.iter().zip(counts).max_by_key(|(_, count)| *count).map_or(0.0, |(scale, _)| *scale);
    (terms.transpose() * inverse * &terms)[(0, 0)] > chi2 && surface.rms_from(degree) > typical / 10.0
}

/// The step of the free parameters; those held stay zero.
fn solve(sums: &Sums, free: Free) -> Option<Vec<f64>> {
    let (first, n) = (free.first(), free.count());
    let matrix = DMatrix::from_fn(n, n, |i, j| sums.matrix(first + i, first + j));
    let right = DVector::from_fn(n, |i, _| sums.right(first + i));
    let scale: Vec<f64> = (0..n).map(|i| matrix[(i, i)].abs().sqrt()).collect();
    if scale.iter().any(|s| s.is_nan() || *s <= 0.0) {
        return None;
    }
    // Equal diagonals, so that the test of the pivots means the same for cells and metres.
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] / (scale[i] * scale[j]));
    let lu = scaled.lu();
    if lu.determinant().abs() < 1e-10 {
        return None;
    }
    let solution = lu.solve(&DVector::from_fn(n, |i, _| right[i] / scale[i]))?;
    let mut step = vec![0.0; sums.parameters()];
    for (i, value) in step[first..][..n].iter_mut().enumerate() {
        *value = solution[i] / scale[i];
    }
    step.iter().all(|v| v.is_finite()).then_some(step)
}

/// Takes a step; returns how far it went, in cells. Steps of more than two cells are shortened: the gradient reaches no
/// further.
fn apply(state: &mut State, step: &[f64], grid: &Grid) -> f64 {
    const LONGEST_PX: f64 = 2.0;
    let length = step[0].hypot(step[1]);
    let share = if length > LONGEST_PX { LONGEST_PX / length } else { 1.0 };
    state.shift.0 += share * step[0] * grid.step_x;
    state.shift.1 += share * step[1] * grid.step_y;
    for (value, change) in state.surface.coefficients.iter_mut().zip(&step[SHIFTS..]) {
        *value += share * change;
    }
    share * length
}
