//! Entropy of the grey levels in a disc about every pixel.
//!
//! H = −Σ pᵢ log₂ pᵢ over the histogram of the disc, which is clipped at the image's border: with n pixels and counts c,
//! H = log₂ n − Σ c·log₂ c / n. A histogram slides along each row; the sum is kept as an integer of 2⁻⁴⁰ bit, so that it
//! does not depend on the path and no error builds up. The values are those of
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
    terms: Vec<i64>,
    logs: Vec<f64>,
}

impl Table {
    fn new(pixels: usize) -> Self {
        let scale = (1u64 << FRACTION_BITS) as f64;
        let term = |c: usize| if c < 2 { 0 } else { (c as f64 * (c as f64).log2() * scale).round() as i64 };
        Table {
            // One more at the end: differences reach up to the largest count.
            terms: (0..=pixels + 1).map(term).collect(),
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
    let table = Table::new(pixels);
    let mut out = vec![0.0; width * rows.len()];
    out.par_chunks_mut(width.max(1)).enumerate().for_each_init(
        || [0u16; 256],
        |histogram, (i, out)| slide(image, width, height, &halves, &table, rows.start + i, histogram, out),
    );
    out
}

/// One row: the histogram goes from left to right.
#[allow(clippy::too_many_arguments)] // One call, all of it plain data.
fn slide(
    image: &[u8],
    width: usize,
    height: usize,
    halves: &[usize],
    table: &Table,
    y: usize,
    histogram: &mut [u16; 256],
    out: &mut [f32],
) {
    let radius = halves.len() / 2;
    histogram.fill(0);
    let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(height));
    let lines: Vec<(&[u8], usize)> =
        (top..bottom).map(|row| (&image[row * width..(row + 1) * width], halves[row + radius - y])).collect();
    let terms = &table.terms[..];
    let mut sum = 0i64;
    let mut count = 0usize;
    // Before the first pixel: all that lies within half a width to the right, less the column that the first step adds.
    for (line, half) in &lines {
        for &value in &line[..(*half).min(width)] {
            let bin = &mut histogram[usize::from(value)];
            sum += terms[usize::from(*bin) + 1] - terms[usize::from(*bin)];
            *bin += 1;
            count += 1;
        }
    }
    let inner = radius + 1..width.saturating_sub(radius).max(radius + 1);
    for x in 0..width {
        if inner.contains(&x) {
            for &(line, half) in &lines {
                let (entering, leaving) = (line[x + half], line[x - half - 1]);
                if entering == leaving {
                    // Flat ground would wait for its own counter again and again.
                    continue;
                }
                let bin = &mut histogram[usize::from(entering)];
                let c = usize::from(*bin);
                *bin += 1;
                sum += terms[c + 1] - terms[c];
                let bin = &mut histogram[usize::from(leaving)];
                let c = usize::from(*bin);
                *bin -= 1;
                sum += terms[c - 1] - terms[c];
            }
        } else {
            for &(line, half) in &lines {
                if x + half < width {
                    let bin = &mut histogram[usize::from(line[x + half])];
                    sum += terms[usize::from(*bin) + 1] - terms[usize::from(*bin)];
                    *bin += 1;
                    count += 1;
                }
                if x > half {
                    let bin = &mut histogram[usize::from(line[x - half - 1])];
                    sum += terms[usize::from(*bin) - 1] - terms[usize::from(*bin)];
                    *bin -= 1;
                    count -= 1;
                }
            }
        }
        out[x] = table.entropy(sum, count);
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
