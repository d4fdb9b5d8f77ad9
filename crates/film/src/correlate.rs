//! Normalised correlation of a mark at many places of a picture at once.
//!
//! After J. P. Lewis, "Fast template matching", Vision Interface, 1995, with weights: what the mark does not describe
//! (the image beyond the opaque frame, the scanner's glass) takes no part. Correlation does not change when a scan is
//! brightened or stretched, so dark frames need no equalisation first.
//!
//! Drawn marks are flat nearly everywhere: a row of one is a few runs of one value. The sums that the correlation needs
//! are differences of running sums there, two look-ups a run instead of a product for each of its values; what is left,
//! edges and thin lines, is added value by value. A learned mark is edges all over and costs what its values cost.

use super::template::Template;
use super::window::Grey;
use autoref_raster::simd::{Kernel, widest};

/// Standard deviation of grey values, of white, below which a place is called flat: half an 8-bit level.
pub const FLAT: f32 = 0.002;
/// Places taken together: their sums stay in registers while the mark is gone through.
const LANES: usize = 16;
/// Stretches of one value up to this long are not worth a run.
const SHORT: usize = 3;

/// A value of the template, by row and column.
#[derive(Clone, Copy, Debug)]
struct At {
    row: u32,
    column: u32,
}

impl At {
    /// How far behind the value, or the running sum before it, that the template's corner lies on.
    #[inline(always)]
    fn behind(self, stride: usize) -> usize {
        self.row as usize * stride + self.column as usize
    }
}

/// Values of one row of a mark, all of one weight.
#[derive(Clone, Debug)]
struct Run {
    first: At,
    len: usize,
    weight: f32,
    /// Weight times the first value.
    product: f32,
}

/// Where values of a run change: what lies between here and the run's end.
#[derive(Clone, Debug)]
struct Step {
    at: At,
    len: usize,
    /// Weight times the change.
    product: f32,
}

/// One value of a mark.
#[derive(Clone, Debug)]
struct Cell {
    at: At,
    weight: f32,
    /// Weight times value; for a value drawn over a run, times its difference from the run's.
    product: f32,
}

/// A template, or a sector of one, taken apart.
#[derive(Clone, Debug)]
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
    fn of(whole: &Template, part: &Template, share: f32) -> Outline {
        let [left, top] = [0, 1].map(|k| (whole.reference[k] - part.reference[k]) as usize);
        let even = 1.0 / part.weight_sum;
        let mut outline =
            Outline { share: share * even, even, runs: vec![], steps: vec![], cells: vec![], over: vec![] };
        for j in 0..part.height {
            let (values, weights) = (&part.values[j * part.width..], &part.weights[j * part.width..][..part.width]);
            let mut x = 0;
            for even in weights.chunk_by(|a, b| a == b) {
                if even[0] != 0.0 {
                    outline.add_even(top + j, left + x, &values[x..x + even.len()], even[0]);
                }
                x += even.len();
            }
        }
        outline
    }

    /// Neighbouring values of one row that share a weight, from column `first` on.
    fn add_even(&mut self, row: usize, first: usize, values: &[f32], weight: f32) {
        // Long stretches of one value start anew; short ones are drawn over the stretch they lie in.
        let mut starts: Vec<(usize, f32)> = vec![];
        let mut x = 0;
        for stretch in values.chunk_by(|a, b| a == b) {
            if stretch.len() > SHORT && starts.last().is_none_or(|s| s.1 != stretch[0]) {
                starts.push((if starts.is_empty() { 0 } else { x }, stretch[0]));
            }
            x += stretch.len();
        }
        let at = |i: usize| At { row: row as u32, column: (first + i) as u32 };
        let cell = |i: usize, weight: f32, product: f32| Cell { at: at(i), weight, product };
        let Some((_, value)) = starts.first() else {
            self.cells.extend(values.iter().enumerate().map(|(i, v)| cell(i, weight, weight * v)));
            return;
        };
        self.runs.push(Run { first: at(0), len: values.len(), weight, product: weight * value });
        for two in starts.windows(2) {
            let product = weight * (two[1].1 - two[0].1);
            self.steps.push(Step { at: at(two[1].0), len: values.len() - two[1].0, product });
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
        let stride = picture.stride;
        let (values, sums, squares) = (&picture.values[corner..], &picture.sums[corner..], &picture.squares[corner..]);
        for r in &self.runs {
            let (first, end) = (r.first.behind(stride), r.first.behind(stride) + r.len);
            let (a, b) = (lanes(sums, first), lanes(sums, end));
            let (c, d) = (lanes(squares, first), lanes(squares, end));
            for i in 0..LANES {
                let sum = b[i] - a[i];
                s1[i] += r.weight * sum;
                s2[i] += r.weight * (d[i] - c[i]);
                st[i] += r.product * sum;
            }
        }
        for s in &self.steps {
            let at = s.at.behind(stride);
            let (a, b) = (lanes(sums, at), lanes(sums, at + s.len));
            for i in 0..LANES {
                st[i] += s.product * (b[i] - a[i]);
            }
        }
        for c in &self.cells {
            let v = lanes(values, c.at.behind(stride));
            for i in 0..LANES {
                s1[i] += c.weight * v[i];
                s2[i] += c.weight * v[i] * v[i];
                st[i] += c.product * v[i];
            }
        }
        for c in &self.over {
            let v = lanes(values, c.at.behind(stride));
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

/// A template ready to be compared.
#[derive(Clone, Debug)]
pub struct Matcher {
    pub width: usize,
    pub height: usize,
    /// The value whose centre is the reference point.
    reference: [i64; 2],
    /// The whole template, or each of its sectors.
    outlines: Vec<Outline>,
}

impl Matcher {
    /// A template laid out for correlation.
    pub fn of(t: &Template) -> Matcher {
        let outlines = if t.parts.is_empty() {
            vec![Outline::of(t, t, 1.0)]
        } else {
            t.parts.iter().map(|(share, part)| Outline::of(t, part, *share)).collect()
        };
        Matcher { width: t.width, height: t.height, reference: t.reference, outlines }
    }

    /// To be compared with `grey` at places that are asked for row by row.
    pub fn over(&self, grey: &Grey) -> Scores<'_> {
        Scores { matcher: self, picture: Picture::of(grey), width: grey.width, height: grey.height }
    }
}

/// How well a template fits: its correlation with the values under it, or the mean of its sectors' correlations by
/// their shares.
pub struct Scores<'a> {
    matcher: &'a Matcher,
    picture: Picture,
    width: usize,
    height: usize,
}

impl Scores<'_> {
    /// With the template's reference value on the values from (x, y) on along a row; −1 where the template does not lie
    /// inside.
    pub fn row(&self, x: i64, y: i64, out: &mut [f32]) {
        out.fill(-1.0);
        let Matcher { width, height, reference, outlines } = self.matcher;
        let corner = y - reference[1];
        if corner < 0 || corner as usize + height > self.height {
            return;
        }
        // Columns of the template's corner, first and end.
        let first = (x - reference[0]).max(0);
        let end = (x - reference[0] + out.len() as i64).min(self.width as i64 - *width as i64 + 1);
        if first >= end {
            return;
        }
        let out = &mut out[(first + reference[0] - x) as usize..][..(end - first) as usize];
        let corner = corner as usize * self.picture.stride + first as usize;
        widest(Row { picture: &self.picture, outlines, corner, out });
    }

    /// `width` × `height` of them, from (x, y) on, row by row.
    pub fn all(&self, [x, y]: [i64; 2], width: usize, height: usize) -> Vec<f32> {
        let mut scores = vec![-1.0f32; width * height];
        for (j, row) in scores.chunks_exact_mut(width.max(1)).enumerate() {
            self.row(x, y + j as i64, row);
        }
        scores
    }
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
        let mean = grey.data.iter().map(|v| f64::from(*v)).sum::<f64>() / grey.data.len().max(1) as f64;
        let stride = grey.width + 1 + LANES;
        let [mut values, mut sums, mut squares] = [(); 3].map(|()| vec![0.0f32; stride * grey.height]);
        for (y, row) in grey.data.chunks_exact(grey.width.max(1)).enumerate() {
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
    use crate::template::{Model, draw};
    use crate::types::MarkKind;

    /// What a score is, for one place: `None` where the template does not lie inside.
    fn score_at(grey: &Grey, t: &Template, x: i64, y: i64) -> Option<f64> {
        let inside = |at: i64, k: usize, size: usize, room: usize| {
            (0..=room as i64 - size as i64).contains(&(at - t.reference[k]))
        };
        if !inside(x, 0, t.width, grey.width) || !inside(y, 1, t.height, grey.height) {
            return None;
        }
        if !t.parts.is_empty() {
            return t.parts.iter().map(|(share, part)| Some(f64::from(*share) * score_at(grey, part, x, y)?)).sum();
        }
        let (left, top) = ((x - t.reference[0]) as usize, (y - t.reference[1]) as usize);
        let (mut s1, mut s2, mut st) = (0.0f64, 0.0f64, 0.0f64);
        for k in 0..t.values.len() {
            let v = f64::from(grey.at(left + k % t.width, top + k / t.width));
            let (value, weight) = (f64::from(t.values[k]), f64::from(t.weights[k]));
            (s1, s2, st) = (s1 + weight * v, s2 + weight * v * v, st + weight * v * value);
        }
        let n = f64::from(t.weight_sum);
        let variance = (s2 / n - (s1 / n).powi(2)).max(0.0) + f64::from(FLAT * FLAT);
        Some(st / n / variance.sqrt())
    }

    fn are_the_single_scores(kind: MarkKind, px_per_mm: f64) {
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
        let scores = Matcher::of(&template).over(&grey).all(from, wide, high);
        let mut inside = 0;
        for (n, dense) in scores.into_iter().enumerate() {
            let (x, y) = (from[0] + (n % wide) as i64, from[1] + (n / wide) as i64);
            let one = score_at(&grey, &template, x, y);
            inside += usize::from(one.is_some());
            let one = one.unwrap_or(-1.0);
            assert!((one - f64::from(dense)).abs() < 1e-3, "({x}, {y}): {one} and {dense}");
        }
        assert_eq!(inside, 22 * 10);
    }

    #[test]
    fn a_mark_lies_nowhere_in_a_picture_smaller_than_it() {
        let kind = MarkKind::Dot { diameter_mm: 0.3, ring_diameter_mm: None, ring_line_mm: None };
        let template = draw(&Model::Drawn(kind), [30.0, 0.0, 0.0, -30.0], 1.0, None).expect("has contrast");
        for (width, height) in [(0, 0), (0, 5), (5, 0), (3, 2), (template.width, template.height - 1)] {
            let grey = Grey { width, height, data: vec![0.3; width * height], origin: [0, 0], factor: 1 };
            let scores = Matcher::of(&template).over(&grey).all([-4, -4], 60, 60);
            assert!(scores.iter().all(|s| *s == -1.0), "{width} × {height}");
        }
    }

    #[test]
    fn the_dense_scores_are_the_single_ones() {
        are_the_single_scores(MarkKind::Cross { arm_mm: 0.5, line_mm: 0.1, gap_mm: 0.0, lines_deg: 0.0 }, 20.0);
        are_the_single_scores(MarkKind::Dot { diameter_mm: 0.3, ring_diameter_mm: None, ring_line_mm: None }, 30.0);
        are_the_single_scores(MarkKind::Notch { width_mm: 3.0, depth_mm: 2.0 }, 6.0);
    }
}
