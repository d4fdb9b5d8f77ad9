//! The drawn mark under the pixels of a scan.

use std::ops::Range;

use super::drawing::{Drawing, LATTICE, THICK};
use crate::template::{Linear, Model, invert};
use crate::window::gaussian;
use autoref_raster::simd::{Kernel, widest};

/// Places drawn per pixel along each axis.
const FINE: usize = 4;
/// Parts of a place along each axis, of which a mark may cover some.
const PARTS: usize = 4;
/// Blur of a good scanner and emulsion, pixels. Learned marks have it already.
pub(super) const SHARP_PX: f64 = 0.7;

/// What the mark says about a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Say {
    Nothing,
    /// The opaque frame: value and derivatives are 0.
    Opaque,
    Shaped,
}

/// Neighbouring columns of which the mark says the same.
#[derive(Clone, Copy, Debug)]
struct Run {
    first: u32,
    end: u32,
    say: Say,
}

/// The mark drawn finely and blurred, looked up between its values. Pixels lie [`FINE`] values apart, so that all of
/// one row fall alike between values [`FINE`] apart: these are kept side by side, and a row of pixels is a row of each
/// of four neighbours.
pub(super) struct Surface {
    /// Fine values along both axes.
    size: [usize; 2],
    /// The fine value that the reference point is at.
    reference: [usize; 2],
    /// Values of one row of one plane. Plane (p, q) holds the values at (p + FINE·column, q + FINE·row).
    columns: usize,
    rows: usize,
    values: Vec<f32>,
    /// What is said between a value, the next, and those below, of every row of every plane; what nothing is said of is
    /// left away.
    runs: Vec<Run>,
    runs_of: Vec<Range<u32>>,
}

/// A row of pixels on the surface.
pub(super) struct Under<'a> {
    pub count: usize,
    runs: &'a [Run],
    /// Column of the first pixel.
    first: usize,
    /// Left and right above, left and right below.
    corners: [&'a [f32]; 4],
    fraction: [f64; 2],
}

/// Where pixels fall between the drawn values: the value before the first pixel and the fraction of the way to the
/// next.
#[derive(Clone, Copy)]
pub(super) struct Phase {
    first: i64,
    fraction: f64,
}

impl Surface {
    /// `blur_px`: the standard deviation by which a drawn mark is blurred, pixels.
    pub fn new(model: &Model, linear: Linear, radius_mm: f64, blur_px: f64) -> Option<Surface> {
        let inverse = invert(linear)?;
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        let reach = reach_px(model, linear, radius_mm * px_per_mm).map(|px| ((px + 3.0) * FINE as f64).ceil() as usize);
        let (reference, size) = ([reach[0], reach[2]], [reach[0] + reach[1] + 1, reach[2] + reach[3] + 1]);
        let pen = model.pen();
        // Fractions of a place from the middle of place (x, y).
        let point = |x: usize, y: usize, (fx, fy): (f64, f64)| {
            let from = |k: usize, at: f64| (at - reference[k] as f64) / FINE as f64;
            let (dx, dy) = (from(0, x as f64 + fx), from(1, y as f64 + fy));
            let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
            let sample = pen.sample(u, v);
            let known = u * u + v * v <= radius_mm * radius_mm && sample.is_some_and(|(_, w)| w > 0.3);
            (sample.map_or(0.0, |(value, _)| value), known)
        };
        let ink = |x: usize, y: usize| point(x, y, (0.0, 0.0));
        // A line that is a quarter of a pixel too wide leaves its edges over, and a fit that trusts edges that fit
        // takes one of them for the line: what is drawn is how much of each place is covered.
        let covered = |x: usize, y: usize| {
            let (value, known) = ink(x, y);
            let same = |&corner: &(f64, f64)| point(x, y, corner).0 == value;
            if !model.is_drawn() || [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].iter().all(same) {
                return (value, known);
            }
            let part = |k: usize| (k as f64 + 0.5) / PARTS as f64 - 0.5;
            let parts = (0..PARTS * PARTS).map(|k| point(x, y, (part(k % PARTS), part(k / PARTS))).0);
            (parts.sum::<f32>() / (PARTS * PARTS) as f32, known)
        };
        let even_tells = model.thinnest_mm() * px_per_mm * FINE as f64 >= THICK * LATTICE as f64;
        let drawing = if even_tells {
            Drawing::by_lattice(size[0], size[1], covered, ink)
        } else {
            Drawing::place_by_place(size[0], size[1], covered)
        };
        let [columns, rows] = size.map(|n| n / FINE + 2);
        let mut surface = Surface {
            size,
            reference,
            columns,
            rows,
            values: vec![0.0; FINE * FINE * columns * rows],
            runs: vec![],
            runs_of: vec![0..0; FINE * FINE * rows],
        };
        let weights = if model.is_drawn() { gaussian(blur_px * FINE as f64) } else { vec![1.0] };
        widest(Laid { surface: &mut surface, drawing, weights });
        Some(surface)
    }

    /// Deals row `j` of the fine values to its four planes.
    #[inline(always)]
    fn deal(&mut self, row: &[f32], j: usize) {
        let (quads, rest) = row.as_chunks::<FINE>();
        for p in 0..FINE {
            let to = self.place(p, j);
            let out = &mut self.values[to..][..quads.len() + 1];
            for k in 0..quads.len() {
                out[k] = quads[k][p];
            }
            if let Some(last) = rest.get(p) {
                out[quads.len()] = *last;
            }
        }
    }

    /// Takes down what is said along row `j` of the fine values.
    #[inline(always)]
    fn note(&mut self, says: &[Say], j: usize) {
        for p in 0..FINE {
            let start = self.runs.len() as u32;
            let mut run = Run { first: 0, end: 0, say: Say::Nothing };
            for (k, say) in says.iter().skip(p).step_by(FINE).enumerate() {
                if *say != run.say {
                    if run.say != Say::Nothing {
                        self.runs.push(run);
                    }
                    (run.first, run.say) = (k as u32, *say);
                }
                run.end = k as u32 + 1;
            }
            if run.say != Say::Nothing {
                self.runs.push(run);
            }
            let plane = self.plane_row(p, j);
            self.runs_of[plane] = start..self.runs.len() as u32;
        }
    }

    #[inline(always)]
    fn plane_row(&self, i: usize, j: usize) -> usize {
        ((j % FINE) * FINE + i % FINE) * self.rows + j / FINE
    }

    #[inline(always)]
    fn place(&self, i: usize, j: usize) -> usize {
        self.plane_row(i, j) * self.columns + i / FINE
    }

    /// How far it reaches along an axis before the reference point and behind it, pixels.
    pub fn reach_px(&self, axis: usize) -> [f64; 2] {
        [self.reference[axis], self.size[axis] - 1 - self.reference[axis]].map(|n| n as f64 / FINE as f64)
    }

    /// Along an axis, for pixels from `first` on under a mark centred on `centre`.
    pub fn phase(&self, axis: usize, first: usize, centre: f64) -> Phase {
        let at = self.reference[axis] as f64 + (first as f64 + 0.5 - centre) * FINE as f64;
        Phase { first: at.floor() as i64, fraction: at - at.floor() }
    }

    /// The `count` pixels of the `n`-th row, both counted from the first of the phases. `None` beyond the surface; of a
    /// row that begins or ends beyond it, pixels there say nothing.
    pub fn under(&self, x: Phase, y: Phase, n: usize, count: usize) -> Option<(usize, Under<'_>)> {
        let j = usize::try_from(y.first + (n * FINE) as i64).ok().filter(|j| j + 1 < self.size[1])?;
        // Pixels before the surface.
        let before = (-x.first).max(0).unsigned_abs().div_ceil(FINE as u64) as usize;
        let i = usize::try_from(x.first + (before * FINE) as i64).ok()?;
        let room = self.columns.saturating_sub(i / FINE + 1);
        let count = count.saturating_sub(before).min(room);
        let row = |di: usize, dj: usize| &self.values[self.place(i + di, j + dj)..][..count];
        let runs = self.runs_of[self.plane_row(i, j)].clone();
        let under = Under {
            count,
            runs: &self.runs[runs.start as usize..runs.end as usize],
            first: i / FINE,
            corners: [row(0, 0), row(1, 0), row(0, 1), row(1, 1)],
            fraction: [x.fraction, y.fraction],
        };
        Some((before, under))
    }
}

/// How far a mark reaches in the scan to the left, the right, above and below, no further than `radius_px`.
fn reach_px(model: &Model, linear: Linear, radius_px: f64) -> [f64; 4] {
    let (half, out, inward) = model.reach_mm();
    let corners = [(-half, -out), (half, -out), (-half, inward), (half, inward)];
    [(0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)].map(|(axis, sign)| {
        let far = |(u, v): &(f64, f64)| sign * (linear[2 * axis] * u + linear[2 * axis + 1] * v);
        corners.iter().map(far).fold(0.0, f64::max).min(radius_px)
    })
}

/// A drawing, blurred and laid into a surface.
struct Laid<'a> {
    surface: &'a mut Surface,
    drawing: Drawing,
    /// Of the blur, from the middle outwards.
    weights: Vec<f32>,
}

impl Kernel for Laid<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Laid { surface, mut drawing, weights } = self;
        let near = drawing.blur_along(&weights);
        let [width, height] = surface.size;
        let (mut above, mut row, mut says) = (vec![0.0f32; width], vec![0.0f32; width], vec![Say::Nothing; width]);
        for j in 0..height {
            drawing.blur_across(&weights, &near, j, &mut row);
            surface.deal(&row, j);
            // Of the outermost values one neighbour is missing.
            if j >= 2 && j + 1 < height {
                let known = &drawing.known[(j - 1) * width..][..width];
                let (left, right) = ([&above[..width], &row[..width]], [&above[1..width], &row[1..width]]);
                for i in 1..width - 2 {
                    // Without shortcuts, in lanes.
                    let shaped =
                        (left[0][i] != 0.0) | (left[1][i] != 0.0) | (right[0][i] != 0.0) | (right[1][i] != 0.0);
                    let say = if shaped { Say::Shaped } else { Say::Opaque };
                    says[i] = if known[i] { say } else { Say::Nothing };
                }
                surface.note(&says, j - 1);
            }
            std::mem::swap(&mut above, &mut row);
        }
    }
}

impl Under<'_> {
    /// Number of runs.
    pub fn runs(&self) -> usize {
        self.runs.len()
    }

    /// What is said along the `k`-th run, and of which of the pixels; of none where it lies beside them.
    #[inline(always)]
    pub fn run(&self, k: usize) -> (Say, Range<usize>) {
        let run = &self.runs[k];
        let within = |column: u32| (column as usize).saturating_sub(self.first).min(self.count);
        (run.say, within(run.first)..within(run.end))
    }

    /// Value and derivatives per pixel under the pixels `span`.
    #[inline(always)]
    pub fn marks(&self, span: Range<usize>, [values, right, down]: [&mut [f32]; 3]) {
        let (fx, fy) = (self.fraction[0] as f32, self.fraction[1] as f32);
        let n = span.len();
        let above = &self.corners[0][span.clone()][..n];
        let next = &self.corners[1][span.clone()][..n];
        let below = &self.corners[2][span.clone()][..n];
        let last = &self.corners[3][span][..n];
        let (values, right, down) = (&mut values[..n], &mut right[..n], &mut down[..n]);
        for k in 0..n {
            let (a, b, c, d) = (above[k], next[k], below[k], last[k]);
            values[k] = (a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy;
            right[k] = ((b - a) * (1.0 - fy) + (d - c) * fy) * FINE as f32;
            down[k] = ((c - a) * (1.0 - fx) + (d - b) * fx) * FINE as f32;
        }
    }
}
