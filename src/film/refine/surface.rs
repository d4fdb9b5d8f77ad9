//! The drawn mark under the pixels of a scan.

use std::ops::Range;

use crate::film::template::{Linear, Model, invert};
use crate::film::window::blur;

/// Places drawn per pixel along each axis.
const FINE: usize = 4;
/// Blur of scanner and emulsion, pixels.
const BLUR_PX: f64 = 0.7;

/// What the mark says about a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Say {
    Nothing,
    /// The opaque frame: value and derivatives are 0.
    Opaque,
    Shaped,
}

/// The mark drawn finely and blurred, looked up between its values. Pixels lie [`FINE`] values apart, so that all of one row fall alike
/// between values [`FINE`] apart: these are kept side by side, and a row of pixels is a row of each of four neighbours.
pub(super) struct Surface {
    /// Fine values along a side.
    width: usize,
    /// Of the reference point along both axes, in fine values.
    reference: f64,
    /// Values of one row of one plane. Plane (p, q) holds the values at (p + FINE·column, q + FINE·row).
    columns: usize,
    rows: usize,
    values: Vec<f32>,
    /// Between a value, the next, and those below.
    says: Vec<Say>,
}

/// A row of pixels on the surface.
pub(super) struct Under<'a> {
    pub says: &'a [Say],
    /// Left and right above, left and right below.
    corners: [&'a [f32]; 4],
    fraction: [f64; 2],
}

/// Where pixels fall between the drawn values: the value before the first pixel and the fraction of the way to the next.
#[derive(Clone, Copy)]
pub(super) struct Phase {
    first: i64,
    fraction: f64,
}

/// What is drawn at one fine place: the mark's value, and whether it is known.
type Ink = (f32, bool);

impl Surface {
    pub fn new(model: &Model, linear: Linear, radius_mm: f64) -> Option<Surface> {
        let inverse = invert(linear)?;
        let px_per_mm = (linear[0] * linear[3] - linear[1] * linear[2]).abs().sqrt();
        let half = ((radius_mm * px_per_mm + 3.0) * FINE as f64).ceil() as usize;
        let width = 2 * half + 1;
        let pen = model.pen();
        let ink = |x: usize, y: usize| -> Ink {
            let (dx, dy) = ((x as f64 - half as f64) / FINE as f64, (y as f64 - half as f64) / FINE as f64);
            let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
            let sample = pen.sample(u, v);
            let known = u * u + v * v <= radius_mm * radius_mm && sample.is_some_and(|(_, w)| w > 0.3);
            (sample.map_or(0.0, |(value, _)| value), known)
        };
        let even_tells = model.thinnest_mm() * px_per_mm * FINE as f64 >= THICK * LATTICE as f64;
        let (mut drawn, known) = if even_tells { by_lattice(width, ink) } else { place_by_place(width, ink) };
        blur(&mut drawn, width, width, BLUR_PX * FINE as f64);
        let columns = width / FINE + 2;
        let mut surface = Surface {
            width,
            reference: half as f64,
            columns,
            rows: columns,
            values: vec![0.0; FINE * FINE * columns * columns],
            says: vec![Say::Nothing; FINE * FINE * columns * columns],
        };
        for j in 0..width {
            let row = &drawn[j * width..][..width];
            for p in 0..FINE {
                let to = surface.place(p, j);
                let out = &mut surface.values[to..][..width / FINE + 1];
                for (k, i) in (p..width).step_by(FINE).enumerate() {
                    out[k] = row[i];
                }
            }
            // Of the outermost values one neighbour is missing.
            if j < 1 || j + 3 > width {
                continue;
            }
            let below = &drawn[(j + 1) * width..][..width];
            for i in (1..width - 2).filter(|i| known[j * width + i]) {
                let to = surface.place(i, j);
                let shaped = row[i] != 0.0 || row[i + 1] != 0.0 || below[i] != 0.0 || below[i + 1] != 0.0;
                surface.says[to] = if shaped { Say::Shaped } else { Say::Opaque };
            }
        }
        Some(surface)
    }

    fn place(&self, i: usize, j: usize) -> usize {
        (((j % FINE) * FINE + i % FINE) * self.rows + j / FINE) * self.columns + i / FINE
    }

    /// How far it reaches along both axes, pixels.
    pub fn half_px(&self) -> f64 {
        self.reference / FINE as f64
    }

    /// Along one axis, for pixels from `first` on under a mark centred on `centre`.
    pub fn phase(&self, first: usize, centre: f64) -> Phase {
        let at = self.reference + (first as f64 + 0.5 - centre) * FINE as f64;
        Phase { first: at.floor() as i64, fraction: at - at.floor() }
    }

    /// The `count` pixels of the `n`-th row, both counted from the first of the phases. `None` beyond the surface; of a row that
    /// begins or ends beyond it, pixels there say nothing.
    pub fn under(&self, x: Phase, y: Phase, n: usize, count: usize) -> Option<(usize, Under<'_>)> {
        let j = usize::try_from(y.first + (n * FINE) as i64).ok().filter(|j| j + 1 < self.width)?;
        // Pixels before the surface.
        let before = (-x.first).max(0).unsigned_abs().div_ceil(FINE as u64) as usize;
        let i = usize::try_from(x.first + (before * FINE) as i64).ok()?;
        let room = self.columns.saturating_sub(i / FINE + 1);
        let count = count.saturating_sub(before).min(room);
        let row = |di: usize, dj: usize| &self.values[self.place(i + di, j + dj)..][..count];
        let under = Under {
            says: &self.says[self.place(i, j)..][..count],
            corners: [row(0, 0), row(1, 0), row(0, 1), row(1, 1)],
            fraction: [x.fraction, y.fraction],
        };
        Some((before, under))
    }
}

impl Under<'_> {
    /// Value and derivatives per pixel under the pixels `span`.
    #[inline(always)]
    pub fn marks(&self, span: Range<usize>, [values, right, down]: [&mut [f64]; 3]) {
        let [fx, fy] = self.fraction;
        let n = span.len();
        let [above, next, below, last] = self.corners.map(|row| &row[span.clone()][..n]);
        let (values, right, down) = (&mut values[..n], &mut right[..n], &mut down[..n]);
        for k in 0..n {
            let [a, b, c, d] = [above[k], next[k], below[k], last[k]].map(f64::from);
            values[k] = (a * (1.0 - fx) + b * fx) * (1.0 - fy) + (c * (1.0 - fx) + d * fx) * fy;
            right[k] = ((b - a) * (1.0 - fy) + (d - c) * fy) * FINE as f64;
            down[k] = ((c - a) * (1.0 - fx) + (d - b) * fx) * FINE as f64;
        }
    }
}

/// Places from one of the lattice to the next.
const LATTICE: usize = 4;
/// What is so many steps thick covers a place of the lattice wherever it lies, dots as well.
const THICK: f64 = 1.5;
/// How many steps of the lattice around a square must be alike before it is taken for alike: edges that meet at right angles or, as a
/// notch's, a little sharper reach no square between without covering a place of the lattice so far around.
const AROUND: usize = 2;

fn place_by_place(width: usize, ink: impl Fn(usize, usize) -> Ink) -> (Vec<f32>, Vec<bool>) {
    (0..width * width).map(|n| ink(n % width, n / width)).unzip()
}

/// The same for shapes with edges but no finer detail: only where an edge may be near is every place looked at.
fn by_lattice(width: usize, ink: impl Fn(usize, usize) -> Ink) -> (Vec<f32>, Vec<bool>) {
    let count = width.div_ceil(LATTICE);
    let lattice: Vec<Ink> = (0..count * count).map(|n| ink(n % count * LATTICE, n / count * LATTICE)).collect();
    let inner = AROUND..count.saturating_sub(AROUND + 1);
    let alike = |x: usize, y: usize| {
        let here = lattice[y * count + x];
        let row = |j: usize| &lattice[j * count + x - AROUND..=j * count + x + 1 + AROUND];
        inner.contains(&x)
            && inner.contains(&y)
            && (y - AROUND..=y + 1 + AROUND).all(|j| row(j).iter().all(|v| *v == here))
    };
    let (mut values, mut known) = (vec![0.0f32; width * width], vec![false; width * width]);
    for y in 0..count {
        for x in 0..count {
            let even = alike(x, y).then(|| lattice[y * count + x]);
            for j in y * LATTICE..((y + 1) * LATTICE).min(width) {
                for i in x * LATTICE..((x + 1) * LATTICE).min(width) {
                    (values[j * width + i], known[j * width + i]) = even.unwrap_or_else(|| ink(i, j));
                }
            }
        }
    }
    (values, known)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::camera::builtin_cameras;

    /// Every mark of the built-in cameras at several sizes and turns.
    #[test]
    fn what_the_lattice_leaves_out_is_as_if_looked_at() {
        for camera in builtin_cameras() {
            let model = Model::of(&camera.marks[0].kind).expect("drawn");
            for (px_per_mm, turn) in [(25.0f64, 0.3f64), (54.0, 0.01), (73.0, 1.2)] {
                let (s, c) = turn.sin_cos();
                let inverse = invert([px_per_mm * c, -px_per_mm * s, px_per_mm * s, px_per_mm * c]).expect("a turn");
                let (half, pen) = ((1.5 * model.radius_mm() * px_per_mm * FINE as f64) as usize, model.pen());
                let ink = |x: usize, y: usize| {
                    let (dx, dy) = ((x as f64 - half as f64) / FINE as f64, (y as f64 - half as f64) / FINE as f64);
                    let (u, v) = (inverse[0] * dx + inverse[1] * dy, inverse[2] * dx + inverse[3] * dy);
                    let sample = pen.sample(u, v);
                    (sample.map_or(0.0, |s| s.0), sample.is_some())
                };
                let thick = model.thinnest_mm() * px_per_mm * FINE as f64 >= THICK * LATTICE as f64;
                let width = 2 * half + 1;
                let same = place_by_place(width, ink) == by_lattice(width, ink);
                assert!(same || !thick, "{} at {px_per_mm} px a millimetre", camera.name);
            }
        }
    }
}
