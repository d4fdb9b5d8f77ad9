//! What `--method auto` looks at: texture and brightness about every pixel, measured against the rest of its frame.
//!
//! Logarithms of the local standard deviation, of the mean gradient and of the mean Laplacian over windows of 5, 15 and
//! 33 px; entropy of discs of 15 and 7 px and its mean; least value, opening and closing of the finest of them, which
//! keep the edges of textured ground sharp; and mean brightness. One byte each, ⅟₂₈ octave or ⅟₂₈ bit a step.
//!
//! A frame that was scanned with another contrast shifts the logarithms by a constant. So what texture measures is
//! taken relative to the frame's own 90th percentile, and brightness as its rank in the frame ([`FrameScale`]).
//!
//! All sums are of integers, and the image is mirrored at its border before anything is computed: the values do not
//! depend on the window they are computed in.

use crate::entropy::entropy;

/// Number of features of a pixel.
pub const FEATURES: usize = PLANES + 4;

/// Planes that are measured; [`FrameScale::apply`] makes the features of them.
pub const PLANES: usize = 26;

/// Pixels around a window that its features depend on.
pub const HALO_PX: usize = 28;

/// Steps of an octave, or of a bit of entropy.
const STEPS: f32 = 28.0;

/// log₂(1.2): a deviation of 0.2 grey levels.
const LEAST_DEVIATION: u8 = (0.263 * STEPS) as u8;

/// Radii of the windows.
const RADII: [usize; 3] = [2, 7, 16];

// Order of the planes.
const DEVIATION: usize = 0;
const GRADIENT: usize = 3;
const LAPLACIAN: usize = 6;
const MEAN: usize = 9;
const ENTROPY: usize = 12;
const SHAPED: usize = 15;
const RATIO: usize = 24;

/// An image with its mirrored surroundings: `width` × `height` pixels, of which the outer [`HALO_PX`] are not asked
/// for.
pub struct Surroundings {
    pub pixels: Vec<u8>,
    pub width: usize,
    pub height: usize,
}

/// Measurements of the pixels inside the halo, a plane each, row-major.
pub struct Measured {
    pub planes: Vec<Vec<u8>>,
    pub width: usize,
    pub height: usize,
}

impl Measured {
    /// Are the surroundings neither flat, nor black, nor white?
    pub fn shows_something(&self, i: usize) -> bool {
        self.planes[DEVIATION + 1][i] > LEAST_DEVIATION && (3..=252).contains(&self.planes[MEAN][i])
    }

    /// How the Laplacian's mean in windows of 5 px compares with the gradient's, ⅟₂₈ octave a step, 128 where they are
    /// equal.
    pub fn fineness(&self) -> &[u8] {
        &self.planes[RATIO]
    }

    /// Do all pixels of the window of 15 px have one level?
    pub fn is_flat(&self, i: usize) -> bool {
        self.planes[DEVIATION + 1][i] == 0
    }
}

/// Values on the pixels of [`Surroundings`]; only those far enough from its border mean anything.
struct Field {
    width: usize,
    height: usize,
}

impl Field {
    /// Sums over windows of (2r + 1)², of the pixels at least r from the border; zero elsewhere.
    fn sums(&self, values: &[u32], r: usize) -> Vec<u32> {
        let (w, h) = (self.width, self.height);
        let mut across = vec![0u32; w * h];
        for (row, out) in values.chunks_exact(w).zip(across.chunks_exact_mut(w)) {
            let mut sum: u32 = row[..2 * r].iter().sum();
            for x in r..w - r {
                sum += row[x + r];
                out[x] = sum;
                sum -= row[x - r];
            }
        }
        let mut out = vec![0u32; w * h];
        let mut column = vec![0u32; w];
        for y in 0..h {
            let entering = &across[y * w..(y + 1) * w];
            column.iter_mut().zip(entering).for_each(|(c, v)| *c += v);
            if y >= 2 * r {
                out[(y - r) * w..(y - r + 1) * w].copy_from_slice(&column);
                let leaving = &across[(y - 2 * r) * w..(y - 2 * r + 1) * w];
                column.iter_mut().zip(leaving).for_each(|(c, v)| *c -= v);
            }
        }
        out
    }

    /// Least or greatest over windows of (2r + 1)².
    fn extreme(&self, values: &[u8], r: usize, pick: impl Fn(u8, u8) -> u8 + Copy) -> Vec<u8> {
        let (w, h) = (self.width, self.height);
        let mut across = values.to_vec();
        let mut lines = [vec![0; w], vec![0; w]];
        for row in across.chunks_exact_mut(w) {
            doubled(row, r, pick, &mut lines);
        }
        // The same down the columns, whole rows at a time.
        let mut have = 1;
        let mut down = across;
        while have < 2 * r + 1 {
            let step = have.min(2 * r + 1 - have);
            let moved = step * w;
            // As many rows at a time as they are moved by: those that are written and those that are read lie apart.
            for from in (0..(h - step) * w).step_by(moved) {
                let (written, read) = down[from..].split_at_mut(moved);
                written.iter_mut().zip(read).for_each(|(a, b)| *a = pick(*a, *b));
            }
            have += step;
        }
        let mut out = values.to_vec();
        if h > 2 * r {
            out[r * w..(h - r) * w].copy_from_slice(&down[..(h - 2 * r) * w]);
        }
        out
    }
}

/// `row[x]` becomes the extreme of `row[x - r ..= x + r]`, for x at least r from both ends.
fn doubled(row: &mut [u8], r: usize, pick: impl Fn(u8, u8) -> u8, [line, next]: &mut [Vec<u8>; 2]) {
    line.copy_from_slice(row);
    let mut have = 1;
    while have < 2 * r + 1 {
        let step = have.min(2 * r + 1 - have);
        next.copy_from_slice(line);
        next.iter_mut().zip(&line[step..]).for_each(|(a, b)| *a = pick(*a, *b));
        std::mem::swap(line, next);
        have += step;
    }
    let end = row.len() - r;
    row[r..end].copy_from_slice(&line[..end - r]);
}

fn quantised(value: f32) -> u8 {
    (value * STEPS + 0.5) as u8
}

/// Difference of two logarithms, 128 where they are equal.
fn ratio(a: u8, b: u8) -> u8 {
    (i16::from(a) - i16::from(b) + 128).clamp(0, 255) as u8
}

/// Measures the pixels of `image` that are at least [`HALO_PX`] from its border.
///
/// # Panics
/// When `image` is not larger than the halo on both sides.
pub fn measure(image: &Surroundings) -> Measured {
    let (w, h) = (image.width, image.height);
    assert!(w > 2 * HALO_PX && h > 2 * HALO_PX && image.pixels.len() == w * h);
    let field = Field { width: w, height: h };
    let grey: Vec<u32> = image.pixels.iter().map(|&v| u32::from(v)).collect();
    let squares: Vec<u32> = grey.iter().map(|v| v * v).collect();
    let (mut gradient, mut laplacian) = (vec![0u32; w * h], vec![0u32; w * h]);
    for y in 1..h - 1 {
        for x in 1..w - 1 {
            let i = y * w + x;
            let (left, right, up, down) = (grey[i - 1], grey[i + 1], grey[i - w], grey[i + w]);
            gradient[i] = left.abs_diff(right) + up.abs_diff(down);
            laplacian[i] = (left + right + up + down).abs_diff(4 * grey[i]);
        }
    }
    let mut planes: Vec<Vec<u8>> = vec![Vec::new(); PLANES];
    let mean_log = |sums: &[u32], count: f32| -> Vec<u8> {
        sums.iter().map(|&sum| quantised((1.0 + sum as f32 / count).log2())).collect()
    };
    for (i, &r) in RADII.iter().enumerate() {
        let count = ((2 * r + 1) * (2 * r + 1)) as u32;
        let (sum, square) = (field.sums(&grey, r), field.sums(&squares, r));
        planes[DEVIATION + i] = sum
            .iter()
            .zip(&square)
            .map(|(&sum, &square)| {
                let scaled = u64::from(count) * u64::from(square) - u64::from(sum) * u64::from(sum);
                quantised((1.0 + (scaled as f32).sqrt() / count as f32).log2())
            })
            .collect();
        planes[MEAN + i] = sum.iter().map(|sum| ((2 * sum + count) / (2 * count)) as u8).collect();
        planes[GRADIENT + i] = mean_log(&field.sums(&gradient, r), count as f32);
        planes[LAPLACIAN + i] = mean_log(&field.sums(&laplacian, r), count as f32);
    }
    for (i, (radius, mean)) in [(7, 0), (7, 7), (3, 3)].into_iter().enumerate() {
        let bits: Vec<u32> =
            entropy(&image.pixels, w, h, radius, 0..h).iter().map(|bit| (bit * 1024.0 + 0.5) as u32).collect();
        let count = ((2 * mean + 1) * (2 * mean + 1)) as f32;
        let sums = field.sums(&bits, mean);
        planes[ENTROPY + i] = sums.iter().map(|&sum| quantised(sum as f32 / count / 1024.0)).collect();
    }
    for (i, (plane, r)) in [(GRADIENT, 5), (DEVIATION, 5), (GRADIENT + 1, 9)].into_iter().enumerate() {
        let least = field.extreme(&planes[plane], r, u8::min);
        let opened = field.extreme(&least, r, u8::max);
        let greatest = field.extreme(&planes[plane], r, u8::max);
        planes[SHAPED + 3 * i + 2] = field.extreme(&greatest, r, u8::min);
        planes[SHAPED + 3 * i + 1] = opened;
        planes[SHAPED + 3 * i] = least;
    }
    for (i, (a, b)) in [(LAPLACIAN, GRADIENT), (DEVIATION + 2, GRADIENT)].into_iter().enumerate() {
        planes[RATIO + i] = planes[a].iter().zip(&planes[b]).map(|(&a, &b)| ratio(a, b)).collect();
    }
    let (inner_width, inner_height) = (w - 2 * HALO_PX, h - 2 * HALO_PX);
    for plane in &mut planes {
        let cut = |y: usize| &plane[(y + HALO_PX) * w + HALO_PX..][..inner_width];
        *plane = (0..inner_height).flat_map(cut).copied().collect();
    }
    Measured { planes, width: inner_width, height: inner_height }
}

/// Histograms of what was measured on a frame's pixels that show something.
pub struct Tally {
    histograms: Vec<[u64; 256]>,
}

impl Default for Tally {
    fn default() -> Self {
        Tally { histograms: vec![[0; 256]; PLANES] }
    }
}

impl Tally {
    /// Adds the pixels of `measured` whose surroundings are neither flat nor black nor white. `grey` are the pixels'
    /// own values.
    pub fn add(&mut self, measured: &Measured, grey: &[u8]) {
        for (i, &level) in grey.iter().enumerate() {
            if measured.planes[DEVIATION + 1][i] > LEAST_DEVIATION && (3..=252).contains(&level) {
                for (histogram, plane) in self.histograms.iter_mut().zip(&measured.planes) {
                    histogram[usize::from(plane[i])] += 1;
                }
            }
        }
    }

    /// Number of pixels that were counted.
    pub fn pixels(&self) -> u64 {
        self.histograms[0].iter().sum()
    }

    /// The scale of the frame.
    pub fn scale(&self) -> FrameScale {
        let total = self.pixels();
        let percentile = |histogram: &[u64; 256]| {
            let mut below = 0;
            (0..256).find(|&v| {
                below += histogram[v];
                below * 10 >= total * 9
            })
        };
        let high =
            |plane: usize| if total == 0 { 128 } else { percentile(&self.histograms[plane]).unwrap_or(255) as u8 };
        let rank = |plane: usize| -> [u8; 256] {
            let mut below = 0;
            std::array::from_fn(|v| {
                let here = self.histograms[plane][v];
                let rank = if total == 0 { v as u64 } else { (2 * below + here) * 255 / (2 * total) };
                below += here;
                rank as u8
            })
        };
        FrameScale { high: std::array::from_fn(high), brightness: [rank(MEAN), rank(MEAN + 1), rank(MEAN + 2)] }
    }
}

/// What a frame's measurements are taken relative to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameScale {
    high: [u8; PLANES],
    brightness: [[u8; 256]; 3],
}

impl FrameScale {
    /// The features of pixel `i`.
    pub fn apply(&self, measured: &Measured, i: usize) -> [u8; FEATURES] {
        std::array::from_fn(|f| match f {
            MEAN..ENTROPY => self.brightness[f - MEAN][usize::from(measured.planes[f][i])],
            RATIO..PLANES => measured.planes[f][i],
            0..PLANES => (i16::from(measured.planes[f][i]) - i16::from(self.high[f]) + 192).clamp(0, 255) as u8,
            // As they are, too: how bright, how rough.
            _ => measured.planes[[MEAN, MEAN + 1, ENTROPY, GRADIENT][f - PLANES]][i],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, at: impl Fn(usize, usize) -> u8) -> Surroundings {
        let pixels = (0..width * height).map(|i| at(i % width, i / width)).collect();
        Surroundings { pixels, width, height }
    }

    fn texture(x: usize, y: usize) -> u8 {
        ((x * 31 + y * 17) % 23 * (1 + x / 40) + (x * y) % 7 * 5) as u8
    }

    #[test]
    fn a_window_measures_what_the_whole_measures() {
        let whole = measure(&image(150, 120, texture));
        let (x0, y0) = (30, 21);
        let part = measure(&image(90, 80, |x, y| texture(x + x0, y + y0)));
        for (all, some) in whole.planes.iter().zip(&part.planes) {
            for y in 0..part.height {
                for x in 0..part.width {
                    assert_eq!(some[y * part.width + x], all[(y + y0) * whole.width + x + x0]);
                }
            }
        }
    }

    #[test]
    fn deviation_mean_and_extremes_are_their_definitions() {
        let source = image(90, 90, texture);
        let measured = measure(&source);
        let at = |x: usize, y: usize| f64::from(source.pixels[y * 90 + x]);
        let (x, y, r) = (6, 7, 7);
        let window = || (0..15usize).flat_map(|j| (0..15usize).map(move |i| (i, j)));
        let value = |(i, j): (usize, usize)| at(x + HALO_PX + i - r, y + HALO_PX + j - r);
        let mean = window().map(value).sum::<f64>() / 225.0;
        let variance = window().map(|p| (value(p) - mean).powi(2)).sum::<f64>() / 225.0;
        let i = y * measured.width + x;
        assert_eq!(measured.planes[MEAN + 1][i], mean.round() as u8);
        let expected = ((1.0 + variance.sqrt()).log2() * f64::from(STEPS)).round();
        assert!((f64::from(measured.planes[DEVIATION + 1][i]) - expected).abs() <= 1.0);
        let least = (0..11)
            .flat_map(|dy| (0..11).map(move |dx| (dx, dy)))
            .filter(|&(dx, dy)| x + dx >= 5 && y + dy >= 5)
            .map(|(dx, dy)| measured.planes[GRADIENT][(y + dy - 5) * measured.width + x + dx - 5])
            .min();
        assert!(measured.planes[SHAPED][i] <= least.expect("there are pixels"));
    }

    #[test]
    fn contrast_does_not_matter_to_texture() {
        let scaled = |gain: usize| {
            let source = image(120, 110, |x, y| (20 + (x * 31 + y * 17) % 23 * gain * (1 + x / 50)) as u8);
            let measured = measure(&source);
            let inner: Vec<u8> = (0..measured.height)
                .flat_map(|y| source.pixels[(y + HALO_PX) * 120 + HALO_PX..][..measured.width].to_vec())
                .collect();
            let mut tally = Tally::default();
            tally.add(&measured, &inner);
            tally.scale().apply(&measured, 5 * measured.width + 5)
        };
        let (low, high) = (scaled(1), scaled(3));
        for f in DEVIATION..MEAN {
            assert!(low[f].abs_diff(high[f]) < 12, "{f}: {} {}", low[f], high[f]);
        }
    }
}
