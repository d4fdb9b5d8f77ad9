//! A mark drawn place by place, and blurred: only where an edge may be near is every place looked at.

use std::ops::Range;

use crate::window::{add_weighted, scale};

/// What is drawn at one fine place: the mark's value, and whether it is known.
pub(super) type Ink = (f32, bool);

/// Places from one of the lattice to the next.
pub(super) const LATTICE: usize = 4;
/// What is so many steps of the lattice thick covers a place of it wherever it lies, dots as well.
pub(super) const THICK: f64 = 1.5;
/// How many steps of the lattice around a square must be alike before it is taken for alike: edges that meet at right
/// angles or, as a notch's, a little sharper reach no square between without covering a place of the lattice so far
/// around.
const AROUND: usize = 2;

/// A picture of a mark.
#[derive(Debug, PartialEq)]
pub(super) struct Drawing {
    /// Places along a row.
    width: usize,
    height: usize,
    pub values: Vec<f32>,
    pub known: Vec<bool>,
    /// Squares of the lattice along a row, and whether they may hold an edge.
    squares: usize,
    uneven: Vec<bool>,
}

impl Drawing {
    /// Drawn at every place (column, row), for want of knowing which squares are even.
    pub fn place_by_place(width: usize, height: usize, ink: impl Fn(usize, usize) -> Ink) -> Drawing {
        let (values, known) = (0..width * height).map(|n| ink(n % width, n / width)).unzip();
        let (squares, rows) = (width.div_ceil(LATTICE), height.div_ceil(LATTICE));
        Drawing { width, height, values, known, squares, uneven: vec![true; squares * rows] }
    }

    /// The same for shapes with edges but no finer detail, where `ink` and `point` agree but at edges; `point` is
    /// quick.
    pub fn by_lattice(
        width: usize,
        height: usize,
        ink: impl Fn(usize, usize) -> Ink,
        point: impl Fn(usize, usize) -> Ink,
    ) -> Drawing {
        let (squares, rows) = (width.div_ceil(LATTICE), height.div_ceil(LATTICE));
        let lattice: Vec<Ink> =
            (0..squares * rows).map(|n| point(n % squares * LATTICE, n / squares * LATTICE)).collect();
        // Where the lattice changes along the rows and across them; a square is even when nothing does that far around.
        let changes = |step: usize| -> Vec<bool> {
            (0..lattice.len()).map(|n| n >= step && lattice[n] != lattice[n - step]).collect()
        };
        let (before, after) = (AROUND - 1, AROUND + 1);
        let along = any_around(&changes(1), before, after, 1);
        let along = any_around(&along, AROUND, AROUND + 1, squares);
        let across = any_around(&changes(squares), before, after, squares);
        let inner = |n: usize, end: usize| (AROUND..end.saturating_sub(AROUND + 1)).contains(&n);
        let uneven = (0..lattice.len())
            .map(|n| along[n] | across[n] | !inner(n % squares, squares) | !inner(n / squares, rows))
            .collect::<Vec<bool>>();
        let (mut values, mut known) = (vec![0.0f32; width * height], vec![false; width * height]);
        for j in 0..height {
            let (row, known) = (&mut values[j * width..][..width], &mut known[j * width..][..width]);
            let first = j / LATTICE * squares;
            for (x, (values, known)) in row.chunks_mut(LATTICE).zip(known.chunks_mut(LATTICE)).enumerate() {
                if uneven[first + x] {
                    for k in 0..values.len() {
                        (values[k], known[k]) = ink(x * LATTICE + k, j);
                    }
                } else {
                    values.fill(lattice[first + x].0);
                    known.fill(lattice[first + x].1);
                }
            }
        }
        Drawing { width, height, values, known, squares, uneven }
    }

    /// Blurs along the rows, from the middle of `weights` outwards, and tells which squares blurring across can change.
    #[inline(always)]
    pub fn blur_along(&mut self, weights: &[f32]) -> Vec<bool> {
        let reach = weights.len() - 1;
        let (width, squares, steps) = (self.width, self.squares, reach.div_ceil(LATTICE));
        let near = any_around(&self.uneven, steps, steps, 1);
        let mut line = vec![0.0f32; width + 2 * reach];
        for (j, row) in self.values.chunks_exact_mut(width).enumerate() {
            let mut from = 0;
            while let Some(span) = next_span(&near[j / LATTICE * squares..][..squares], from, width) {
                from = span.end.div_ceil(LATTICE);
                // The span with what is around it, which blurring does not change: it is even as far as weights reach.
                // Beyond an edge its last value goes on.
                let line = &mut line[..span.len() + 2 * reach];
                let (first, end) = (span.start.saturating_sub(reach), (span.end + reach).min(width));
                let before = reach - (span.start - first);
                line[..before].fill(row[0]);
                line[before..before + end - first].copy_from_slice(&row[first..end]);
                line[before + end - first..].fill(row[width - 1]);
                let out = &mut row[span];
                scale(out, weights[0]);
                for k in 1..weights.len() {
                    add_weighted(out, &line[reach - k..], &line[reach + k..], weights[k]);
                }
            }
        }
        any_around(&near, steps, steps, squares)
    }

    /// Row `j` blurred across the rows where `near` tells so.
    #[inline(always)]
    pub fn blur_across(&self, weights: &[f32], near: &[bool], j: usize, out: &mut [f32]) {
        let (width, squares) = (self.width, self.squares);
        out.copy_from_slice(&self.values[j * width..][..width]);
        let mut from = 0;
        while let Some(span) = next_span(&near[j / LATTICE * squares..][..squares], from, width) {
            from = span.end.div_ceil(LATTICE);
            let start = span.start;
            let out = &mut out[span];
            scale(out, weights[0]);
            for k in 1..weights.len() {
                let (above, below) = (j.saturating_sub(k), (j + k).min(self.height - 1));
                let (above, below) = (&self.values[above * width + start..], &self.values[below * width + start..]);
                add_weighted(out, above, below, weights[k]);
            }
        }
    }
}

/// Whether any of the flags from `before` strides before each to `after` strides behind it is set. Along rows that runs
/// on from the end of one into the next: their first and last squares are all uneven.
fn any_around(flags: &[bool], before: usize, after: usize, stride: usize) -> Vec<bool> {
    let mut out = flags.to_vec();
    for k in 1..=before {
        let shift = (k * stride).min(out.len());
        let (ends, starts) = (&mut out[shift..], flags);
        ends.iter_mut().zip(starts).for_each(|(o, f)| *o |= f);
    }
    for k in 1..=after {
        let shift = (k * stride).min(flags.len());
        out.iter_mut().zip(&flags[shift..]).for_each(|(o, f)| *o |= f);
    }
    out
}

/// The next stretch of marked squares from square `from` on, in places.
#[inline(always)]
fn next_span(marked: &[bool], from: usize, width: usize) -> Option<Range<usize>> {
    let mut first = from;
    while first < marked.len() && !marked[first] {
        first += 1;
    }
    let mut end = first;
    while end < marked.len() && marked[end] {
        end += 1;
    }
    (first < end).then(|| first * LATTICE..(end * LATTICE).min(width))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::builtin_cameras;
    use crate::template::{Model, invert};
    use crate::window::{blur, gaussian};

    /// Every mark of the built-in cameras at several sizes and turns: drawn alike, and blurred alike.
    #[test]
    fn what_the_lattice_leaves_out_is_as_if_looked_at() {
        const FINE: f64 = 4.0;
        for camera in builtin_cameras() {
            let model = Model::of(&camera.marks[0].kind).expect("drawn");
            for (px_per_mm, turn) in [(25.0f64, 0.3f64), (54.0, 0.01), (73.0, 1.2)] {
                let (s, c) = turn.sin_cos();
                let inverse = invert([px_per_mm * c, -px_per_mm * s, px_per_mm * s, px_per_mm * c]).expect("a turn");
                let (half, pen) = ((1.5 * model.radius_mm() * px_per_mm * FINE) as usize, model.pen());
                let ink = |x: usize, y: usize| {
                    let (dx, dy) = ((x as f64 - half as f64) / FINE, (y as f64 - half as f64) / FINE);
                    let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
                    let sample = pen.sample(u, v);
                    (sample.map_or(0.0, |s| s.0), sample.is_some())
                };
                if model.thinnest_mm() * px_per_mm * FINE < THICK * LATTICE as f64 {
                    continue;
                }
                // Wider than high: a part of it that its middle row is in.
                let (width, height) = (2 * half + 1, half + half / 2);
                let (whole, mut quick) =
                    (Drawing::place_by_place(width, height, ink), Drawing::by_lattice(width, height, ink, ink));
                let name = format!("{} at {px_per_mm} px a millimetre", camera.name);
                assert!(whole.values == quick.values && whole.known == quick.known, "{name}");
                let mut blurred = whole.values;
                blur(&mut blurred, width, height, 2.8);
                let weights = gaussian(2.8);
                let near = quick.blur_along(&weights);
                let mut row = vec![0.0; width];
                for j in 0..height {
                    quick.blur_across(&weights, &near, j, &mut row);
                    let off = row.iter().zip(&blurred[j * width..]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                    assert!(off < 1e-5, "{name}: row {j} is off by {off}");
                }
            }
        }
    }
}
