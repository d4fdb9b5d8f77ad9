//! Entropy of the grey levels in a disc about every pixel.
//!
//! H = −Σ pᵢ log₂ pᵢ over the histogram of the disc, which is clipped at the image's border: with n pixels and counts
//! c, H = log₂ n − Σ c·log₂ c / n. A histogram slides along each row; the sum is kept as an integer of 2⁻⁴⁰ bit, so
//! that it does not depend on the path and no error builds up. The values are those of
//! `skimage.filters.rank.entropy(image, disk(7))` within 1e-9 bit.

use rayon::prelude::*;

/// Radius of the thesis's disc of 15 px.
pub const RADIUS_PX: usize = 7;

const FRACTION_BITS: u32 = 40;

/// Half width of each row of the disc dx² + dy² ≤ r², from the top down.
fn half_widths(radius: usize) -> Vec<usize> {
    let r = radius as i64;
    (-r..=r).map(|dy| (0..=r).rev().find(|dx| dx * dx + dy * dy <= r * r).unwrap_or(0) as usize).collect()
}

/// c·log₂ c for every count that a disc can have.
struct Table {
    /// (c + 1)·log₂(c + 1) − c·log₂ c.
    steps: Vec<i64>,
    logs: Vec<f64>,
}

impl Table {
    fn new(pixels: usize) -> Self {
        let scale = (1u64 << FRACTION_BITS) as f64;
        let term = |c: usize| if c < 2 { 0 } else { (c as f64 * (c as f64).log2() * scale).round() as i64 };
        Table {
            steps: (0..=pixels).map(|c| term(c + 1) - term(c)).collect(),
            logs: (0..=pixels).map(|n| if n == 0 { 0.0 } else { (n as f64).log2() }).collect(),
        }
    }

    fn entropy(&self, sum: i64, count: usize) -> f32 {
        let scale = (1u64 << FRACTION_BITS) as f64;
        (self.logs[count] - sum as f64 / scale / count as f64).max(0.0) as f32
    }
}

/// Entropy, in bits, of the disc of `radius` px about each pixel of rows `rows` of an 8-bit image of `width` × `height`
/// pixels, row-major.
///
/// # Panics
/// When `image` is not `width · height` long, `rows` is not inside it, or the disc has over 65,535 pixels (radius 144).
pub fn entropy(image: &[u8], width: usize, height: usize, radius: usize, rows: std::ops::Range<usize>) -> Vec<f32> {
    assert_eq!(image.len(), width * height, "one sample a pixel");
    assert!(rows.end <= height && radius <= 144);
    let halves = half_widths(radius);
    let pixels: usize = halves.iter().map(|half| 2 * half + 1).sum();
    let disc = Disc { table: Table::new(pixels), halves, image, width, height };
    let mut out = vec![0.0; width * rows.len()];
    // Two rows at a time: a flat row waits for its own counters, and the other fills the time.
    out.par_chunks_mut(2 * width.max(1)).enumerate().for_each(|(i, out)| {
        let y = rows.start + 2 * i;
        let (first, second) = out.split_at_mut(width);
        if second.is_empty() {
            disc.rows([y], [first]);
        } else {
            disc.rows([y, y + 1], [first, second]);
        }
    });
    out
}

struct Disc<'a> {
    table: Table,
    halves: Vec<usize>,
    image: &'a [u8],
    width: usize,
    height: usize,
}

/// The histogram of the disc about one pixel of a row.
struct Histogram<'a> {
    bins: [u16; 256],
    /// The rows that the disc meets, with its half width there.
    lines: Vec<(&'a [u8], usize)>,
    sum: i64,
    count: usize,
}

impl Histogram<'_> {
    #[inline(always)]
    fn add(&mut self, table: &Table, value: u8) {
        let bin = &mut self.bins[usize::from(value)];
        self.sum += table.steps[usize::from(*bin)];
        *bin += 1;
    }

    #[inline(always)]
    fn remove(&mut self, table: &Table, value: u8) {
        let bin = &mut self.bins[usize::from(value)];
        *bin -= 1;
        self.sum -= table.steps[usize::from(*bin)];
    }

    /// Line `i` goes on to pixel `x`, away from the image's border.
    #[inline(always)]
    fn step(&mut self, table: &Table, i: usize, x: usize) {
        let (line, half) = self.lines[i];
        let (entering, leaving) = (line[x + half], line[x - half - 1]);
        if entering != leaving {
            self.add(table, entering);
            self.remove(table, leaving);
        }
    }

    /// All lines go on to pixel `x`, anywhere.
    fn step_at_border(&mut self, table: &Table, x: usize, width: usize) {
        for i in 0..self.lines.len() {
            let (line, half) = self.lines[i];
            if x + half < width {
                self.add(table, line[x + half]);
                self.count += 1;
            }
            if x > half {
                self.remove(table, line[x - half - 1]);
                self.count -= 1;
            }
        }
    }
}

impl<'a> Disc<'a> {
    /// The histogram before the first pixel of row `y`: all that lies within half a width to the right, less the column
    /// that the first step adds.
    fn before(&self, y: usize) -> Histogram<'a> {
        let radius = self.halves.len() / 2;
        let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(self.height));
        let line = |row: usize| (&self.image[row * self.width..(row + 1) * self.width], self.halves[row + radius - y]);
        let lines: Vec<(&[u8], usize)> = (top..bottom).map(line).collect();
        let mut histogram = Histogram { bins: [0; 256], lines: lines.clone(), sum: 0, count: 0 };
        for (line, half) in lines {
            for &value in &line[..half.min(self.width)] {
                histogram.add(&self.table, value);
                histogram.count += 1;
            }
        }
        histogram
    }

    /// `N` rows at once; their histograms go from left to right.
    fn rows<const N: usize>(&self, at: [usize; N], mut out: [&mut [f32]; N]) {
        let radius = self.halves.len() / 2;
        let mut histograms = at.map(|y| self.before(y));
        let shared = histograms.iter().map(|h| h.lines.len()).min().unwrap_or(0);
        let inner = radius + 1..self.width.saturating_sub(radius).max(radius + 1);
        for x in 0..self.width {
            if inner.contains(&x) {
                for i in 0..shared {
                    histograms.iter_mut().for_each(|h| h.step(&self.table, i, x));
                }
                for histogram in &mut histograms {
                    (shared..histogram.lines.len()).for_each(|i| histogram.step(&self.table, i, x));
                }
            } else {
                histograms.iter_mut().for_each(|h| h.step_at_border(&self.table, x, self.width));
            }
            for (histogram, out) in histograms.iter().zip(&mut out) {
                out[x] = self.table.entropy(histogram.sum, histogram.count);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn by_definition(image: &[u8], width: usize, height: usize, radius: usize, x: usize, y: usize) -> f64 {
        let (mut histogram, mut n) = ([0u32; 256], 0u32);
        let r = radius as i64;
        for dy in -r..=r {
            for dx in -r..=r {
                let (xx, yy) = (x as i64 + dx, y as i64 + dy);
                let inside = (0..width as i64).contains(&xx) && (0..height as i64).contains(&yy);
                if dx * dx + dy * dy <= r * r && inside {
                    histogram[usize::from(image[yy as usize * width + xx as usize])] += 1;
                    n += 1;
                }
            }
        }
        let part = |&c: &u32| if c == 0 { 0.0 } else { f64::from(c) / f64::from(n) };
        -histogram.iter().map(part).filter(|p| *p > 0.0).map(|p| p * p.log2()).sum::<f64>()
    }

    #[test]
    fn the_disc_of_15_px_has_149() {
        assert_eq!(half_widths(RADIUS_PX).iter().map(|half| 2 * half + 1).sum::<usize>(), 149);
    }

    #[test]
    fn every_pixel_is_its_definition_borders_included() {
        for (width, height, radius) in [(40, 23, 7), (5, 9, 7), (1, 30, 7), (16, 2, 3), (15, 15, 7), (21, 4, 0)] {
            let image: Vec<u8> = (0..width * height).map(|i| (i * i % 97 + i / 31 % 5 * 20) as u8).collect();
            let whole = entropy(&image, width, height, radius, 0..height);
            for y in 0..height {
                for x in 0..width {
                    let expected = by_definition(&image, width, height, radius, x, y);
                    assert!((f64::from(whole[y * width + x]) - expected).abs() < 1e-6, "{width}×{height} at {x}, {y}");
                }
            }
            let part = entropy(&image, width, height, radius, height / 3..height);
            assert_eq!(part, whole[height / 3 * width..]);
        }
    }
}
