//! Normalised correlation of a mark at every place of a picture at once.
//!
//! Drawn marks are flat nearly everywhere: a row of one is a few runs of one value. The sums that the correlation needs are
//! differences of running sums there, two look-ups a run instead of a product for each of its values; what is left, edges
//! and thin lines, is added value by value. A learned mark is edges all over and costs what its values cost.

use super::kernel::{Kernel, widest};
use super::search::FLAT;
use super::template::Template;
use super::window::Grey;

/// Places taken together: their sums stay in registers while the mark is gone through.
const LANES: usize = 16;
/// Stretches of one value up to this long are not worth a run.
const SHORT: usize = 3;

/// Values of one row of a mark, all of one weight.
struct Run {
    /// Running sums before the first value and after the last, from the sums of the template's corner.
    first: usize,
    end: usize,
    weight: f32,
    /// Weight times the first value.
    product: f32,
}

/// Where values of a run change: what lies between here and the run's end.
struct Step {
    at: usize,
    end: usize,
    /// Weight times the change.
    product: f32,
}

/// One value of a mark.
struct Cell {
    at: usize,
    weight: f32,
    /// Weight times value; for a value drawn over a run, times its difference from the run's.
    product: f32,
}

/// A template, or a sector of one, taken apart for pictures of one stride.
struct Outline {
    /// How much it counts in the mark's score, by its sum of weights.
    share: f32,
    /// 1 / sum of weights.
    even: f32,
    runs: Vec<Run>,
    steps: Vec<Step>,
    /// In no run.
    cells: Vec<Cell>,
    /// Drawn over a run.
    over: Vec<Cell>,
}

impl Outline {
    fn of(whole: &Template, part: &Template, share: f32, stride: usize) -> Outline {
        let [left, top] = [0, 1].map(|k| (whole.reference[k] - part.reference[k]) as usize);
        let even = 1.0 / part.weight_sum;
        let mut outline =
            Outline { share: share * even, even, runs: vec![], steps: vec![], cells: vec![], over: vec![] };
        for j in 0..part.height {
            let (values, weights) = (&part.values[j * part.width..], &part.weights[j * part.width..][..part.width]);
            let mut x = 0;
            for even in weights.chunk_by(|a, b| a == b) {
                if even[0] != 0.0 {
                    outline.add_even((top + j) * stride + left + x, &values[x..x + even.len()], even[0]);
                }
                x += even.len();
            }
        }
        outline
    }

    /// Neighbouring values of one row that share a weight, the first at `first`.
    fn add_even(&mut self, first: usize, values: &[f32], weight: f32) {
        // Long stretches of one value start anew; short ones are drawn over the stretch they lie in.
        let mut starts: Vec<(usize, f32)> = vec![];
        let mut x = 0;
        for stretch in values.chunk_by(|a, b| a == b) {
            if stretch.len() > SHORT && starts.last().is_none_or(|s| s.1 != stretch[0]) {
                starts.push((if starts.is_empty() { 0 } else { x }, stretch[0]));
            }
            x += stretch.len();
        }
        let cell = |i: usize, weight: f32, product: f32| Cell { at: first + i, weight, product };
        let Some((_, value)) = starts.first() else {
            self.cells.extend(values.iter().enumerate().map(|(i, v)| cell(i, weight, weight * v)));
            return;
        };
        let end = first + values.len();
        self.runs.push(Run { first, end, weight, product: weight * value });
        for two in starts.windows(2) {
            self.steps.push(Step { at: first + two[1].0, end, product: weight * (two[1].1 - two[0].1) });
        }
        for (k, &(start, value)) in starts.iter().enumerate() {
            let end = starts.get(k + 1).map_or(values.len(), |next| next.0);
            let others = (start..end).filter(|i| values[*i] != value);
            self.over.extend(others.map(|i| cell(i, 0.0, weight * (values[i] - value))));
        }
    }

    /// Adds this part's share of the score to [`LANES`] places, the first with the template's corner at `corner`.
    #[inline(always)]
    fn add_scores(&self, picture: &Picture, corner: usize, out: &mut [f32; LANES]) {
        let (mut s1, mut s2, mut st) = ([0.0f32; LANES], [0.0f32; LANES], [0.0f32; LANES]);
        let (values, sums, squares) = (&picture.values[corner..], &picture.sums[corner..], &picture.squares[corner..]);
        for r in &self.runs {
            let (a, b) = (lanes(sums, r.first), lanes(sums, r.end));
            let (c, d) = (lanes(squares, r.first), lanes(squares, r.end));
            for i in 0..LANES {
                let sum = b[i] - a[i];
                s1[i] += r.weight * sum;
                s2[i] += r.weight * (d[i] - c[i]);
                st[i] += r.product * sum;
            }
        }
        for s in &self.steps {
            let (a, b) = (lanes(sums, s.at), lanes(sums, s.end));
            for i in 0..LANES {
                st[i] += s.product * (b[i] - a[i]);
            }
        }
        for c in &self.cells {
            let v = lanes(values, c.at);
            for i in 0..LANES {
                s1[i] += c.weight * v[i];
                s2[i] += c.weight * v[i] * v[i];
                st[i] += c.product * v[i];
            }
        }
        for c in &self.over {
            let v = lanes(values, c.at);
            for i in 0..LANES {
                st[i] += c.product * v[i];
            }
        }
        for i in 0..LANES {
            let mean = s1[i] * self.even;
            let variance = (s2[i] * self.even - mean * mean).max(0.0) + FLAT * FLAT;
            out[i] += self.share * st[i] / variance.sqrt();
        }
    }
}

#[inline(always)]
fn lanes(values: &[f32], at: usize) -> [f32; LANES] {
    *values[at..].first_chunk().expect("rows end in room for the lanes")
}

/// Values about their mean, and sums of them and of their squares from the start of each row up to each value.
struct Picture {
    /// Values from one row to the next: one more than the picture is wide, for the sums, and room to read all lanes.
    stride: usize,
    values: Vec<f32>,
    sums: Vec<f32>,
    squares: Vec<f32>,
}

impl Picture {
    fn of(grey: &Grey) -> Picture {
        let mean = grey.data.iter().map(|v| f64::from(*v)).sum::<f64>() / grey.data.len() as f64;
        let stride = grey.width + 1 + LANES;
        let [mut values, mut sums, mut squares] = [(); 3].map(|()| vec![0.0f32; stride * grey.height]);
        for (y, row) in grey.data.chunks_exact(grey.width).enumerate() {
            let (values, sums, squares) =
                (&mut values[y * stride..], &mut sums[y * stride..], &mut squares[y * stride..]);
            // Summed in double precision: small differences of long sums are wanted.
            let (mut sum, mut square) = (0.0f64, 0.0f64);
            for (x, v) in row.iter().enumerate() {
                let v = f64::from(*v) - mean;
                sum += v;
                square += v * v;
                values[x] = v as f32;
                sums[x + 1] = sum as f32;
                squares[x + 1] = square as f32;
            }
        }
        Picture { stride, values, sums, squares }
    }
}

/// Scores of the template, as [`super::search::score_at`] gives them, with its reference value on each value of the picture from
/// (x, y) on, `width` × `height` of them, row by row; −1 where the template does not lie inside.
pub fn correlate(grey: &Grey, t: &Template, [x, y]: [i64; 2], width: usize, height: usize) -> Vec<f32> {
    let mut scores = vec![-1.0f32; width * height];
    // Places of the template's corner, first and end, along both axes.
    let range = |from: i64, count: usize, reference: i64, size: usize, room: usize| {
        let first = (from - reference).max(0);
        (first as usize, (from - reference + count as i64).min(room as i64 - size as i64 + 1).max(first) as usize)
    };
    let (left, right) = range(x, width, t.reference[0], t.width, grey.width);
    let (top, bottom) = range(y, height, t.reference[1], t.height, grey.height);
    if left == right || top == bottom {
        return scores;
    }
    let picture = Picture::of(grey);
    let outlines: Vec<Outline> = if t.parts.is_empty() {
        vec![Outline::of(t, t, 1.0, picture.stride)]
    } else {
        t.parts.iter().map(|(share, part)| Outline::of(t, part, *share, picture.stride)).collect()
    };
    let first = (left as i64 + t.reference[0] - x) as usize;
    for corner in top..bottom {
        let row = (corner as i64 + t.reference[1] - y) as usize * width;
        let out = &mut scores[row + first..][..right - left];
        widest(Row { picture: &picture, outlines: &outlines, corner: corner * picture.stride + left, out });
    }
    scores
}

/// A row of places, the first with the template's corner at `corner`.
struct Row<'a> {
    picture: &'a Picture,
    outlines: &'a [Outline],
    corner: usize,
    out: &'a mut [f32],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (k, out) in self.out.chunks_mut(LANES).enumerate() {
            let mut sum = [0.0f32; LANES];
            for outline in self.outlines {
                outline.add_scores(self.picture, self.corner + k * LANES, &mut sum);
            }
            out.copy_from_slice(&sum[..out.len()]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::search::score_at;
    use crate::film::template::{Model, draw};
    use crate::film::types::MarkKind;

    fn is_the_single_scores(kind: MarkKind, px_per_mm: f64) {
        let template = draw(&Model::Drawn(kind), [px_per_mm, 1.0, -1.0, -px_per_mm], 1.0, None).expect("has contrast");
        let (width, height) = (template.width + 21, template.height + 9);
        // Grain around two levels, as the opaque frame and the image beside it.
        let data: Vec<f32> = (0..width * height)
            .map(|i| {
                let grain = ((i as u32).wrapping_mul(2_654_435_761) >> 24) as f32 / 255.0;
                if i % width < width / 2 { 0.07 + 0.01 * grain } else { 0.4 + 0.5 * grain }
            })
            .collect();
        let grey = Grey { width, height, data, origin: [0, 0], factor: 1 };
        // Also beyond the picture, as a place near its edge asks.
        let (from, wide, high) = ([-3, 2], width + 5, height + 1);
        let scores = correlate(&grey, &template, from, wide, high);
        for (n, dense) in scores.into_iter().enumerate() {
            let (x, y) = (from[0] + (n % wide) as i64, from[1] + (n / wide) as i64);
            // Sectors alone may still lie inside where the whole template does not.
            let inside = |at: i64, k: usize, size: usize, room: usize| {
                (0..=room as i64 - size as i64).contains(&(at - template.reference[k]))
            };
            let whole = inside(x, 0, template.width, width) && inside(y, 1, template.height, height);
            let one = if whole { score_at(&grey, &template, x, y).expect("it lies inside") } else { -1.0 };
            assert!((one - f64::from(dense)).abs() < 1e-3, "({x}, {y}): {one} and {dense}");
        }
    }

    #[test]
    fn the_dense_scores_are_the_single_ones() {
        is_the_single_scores(MarkKind::Cross { arm_mm: 0.5, line_mm: 0.1, gap_mm: 0.0, lines_deg: 0.0 }, 20.0);
        is_the_single_scores(MarkKind::Dot { diameter_mm: 0.3, ring_diameter_mm: None, ring_line_mm: None }, 30.0);
        is_the_single_scores(MarkKind::Notch { width_mm: 3.0, depth_mm: 2.0 }, 6.0);
    }
}
