//! Smoothing and reduction of 8-bit grey images.

/// Coefficients of the 5-tap Gaussian, σ 1.1, in 256ths.
///
/// OpenCV's bit-exact 8-bit blur rounds exp(−x²/2σ²)/Σ to these by error diffusion, so that they sum to 256.
pub const GAUSSIAN_5_SIGMA_1_1: [u32; 5] = [18, 63, 94, 63, 18];

/// Pixels that [`gaussian`] needs around a window.
pub const GAUSSIAN_HALO_PX: usize = 2;

/// Gaussian 5×5, σ 1.1, of an 8-bit image of `width` × `height` pixels, row-major; the border is mirrored about the
/// outer pixels' centres. Equal bit for bit to OpenCV's `GaussianBlur(image, (5, 5), 1.1)`.
///
/// # Panics
/// When `image` is not `width · height` long.
pub fn gaussian(image: &[u8], width: usize, height: usize) -> Vec<u8> {
    assert_eq!(image.len(), width * height, "one sample a pixel");
    if image.is_empty() {
        return Vec::new();
    }
    let [a, b, c, ..] = GAUSSIAN_5_SIGMA_1_1;
    let mut across = vec![0u16; image.len()];
    for (row, out) in image.chunks_exact(width).zip(across.chunks_exact_mut(width)) {
        let at = |x: i64| u32::from(row[mirror(x, width)]);
        let sum = |x: i64| (a * (at(x - 2) + at(x + 2)) + b * (at(x - 1) + at(x + 1)) + c * at(x)) as u16;
        for (x, value) in out.iter_mut().enumerate().take(2) {
            *value = sum(x as i64);
        }
        for (value, w) in out.iter_mut().skip(2).zip(row.windows(5)) {
            let w: [u32; 5] = [w[0].into(), w[1].into(), w[2].into(), w[3].into(), w[4].into()];
            *value = (a * (w[0] + w[4]) + b * (w[1] + w[3]) + c * w[2]) as u16;
        }
        for x in width.saturating_sub(2)..width {
            out[x] = sum(x as i64);
        }
    }
    let mut blurred = vec![0; image.len()];
    for (y, out) in blurred.chunks_exact_mut(width).enumerate() {
        let row = |dy: i64| {
            let first = mirror(y as i64 + dy, height) * width;
            &across[first..first + width]
        };
        let rows = [row(-2), row(-1), row(0), row(1), row(2)];
        for (x, value) in out.iter_mut().enumerate() {
            let [r0, r1, r2, r3, r4] = rows.map(|row| u32::from(row[x]));
            *value = ((a * (r0 + r4) + b * (r1 + r3) + c * r2 + (1 << 15)) >> 16) as u8;
        }
    }
    blurred
}

/// What [`gaussian`] makes, without rounding, of an image whose rows (or columns) are these values throughout.
pub fn gaussian_line(values: &[f32]) -> Vec<f32> {
    let smoothed = |i: usize| {
        let at = |offset: i64| f64::from(values[mirror(i as i64 + offset, values.len())]);
        let taps = GAUSSIAN_5_SIGMA_1_1.iter().zip(-2..);
        (taps.map(|(weight, offset)| f64::from(*weight) * at(offset)).sum::<f64>() / 256.0) as f32
    };
    (0..values.len()).map(smoothed).collect()
}

/// `−1 → 1`, `n → n − 2`: OpenCV's BORDER_REFLECT_101.
fn mirror(position: i64, length: usize) -> usize {
    if length == 1 {
        return 0;
    }
    let period = 2 * (length as i64 - 1);
    let folded = position.rem_euclid(period);
    folded.min(period - folded) as usize
}

/// Means of `factor` × `factor` pixels, rounded half up; blocks at the right and lower edge average what there is of
/// them. The result has ⌈width/factor⌉ × ⌈height/factor⌉ pixels.
///
/// # Panics
/// When `image` is not `width · height` long, or `factor` is 0 or above 64.
pub fn reduce(image: &[u8], width: usize, height: usize, factor: usize) -> Vec<u8> {
    assert_eq!(image.len(), width * height, "one sample a pixel");
    assert!((1..=64).contains(&factor), "sums of a block fit 32 bits");
    if factor == 1 {
        return image.to_vec();
    }
    let mut reduced = Vec::with_capacity(width.div_ceil(factor) * height.div_ceil(factor));
    let mut sums = vec![0u32; width.div_ceil(factor)];
    for rows in image.chunks(width.max(1) * factor) {
        sums.fill(0);
        for row in rows.chunks_exact(width) {
            for (sum, block) in sums.iter_mut().zip(row.chunks(factor)) {
                *sum += block.iter().map(|&v| u32::from(v)).sum::<u32>();
            }
        }
        let count_rows = rows.len() / width;
        reduced.extend(sums.iter().enumerate().map(|(i, &sum)| {
            let count = (count_rows * factor.min(width - i * factor)) as u32;
            ((2 * sum + count) / (2 * count)) as u8
        }));
    }
    reduced
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The definition: the outer product of the kernel, mirrored, rounded once at 8 + 8 bits.
    fn by_definition(image: &[u8], width: usize, height: usize) -> Vec<u8> {
        let k = GAUSSIAN_5_SIGMA_1_1;
        let mut out = Vec::new();
        for y in 0..height as i64 {
            for x in 0..width as i64 {
                let mut sum = 1 << 15;
                for (j, kj) in k.iter().enumerate() {
                    for (i, ki) in k.iter().enumerate() {
                        let (xx, yy) = (mirror(x + i as i64 - 2, width), mirror(y + j as i64 - 2, height));
                        sum += kj * ki * u32::from(image[yy * width + xx]);
                    }
                }
                out.push((sum >> 16) as u8);
            }
        }
        out
    }

    #[test]
    fn gaussian_is_its_definition_at_every_size() {
        assert_eq!(GAUSSIAN_5_SIGMA_1_1.iter().sum::<u32>(), 256);
        for (width, height) in [(1, 1), (2, 3), (3, 1), (4, 4), (17, 9)] {
            let image: Vec<u8> = (0..width * height).map(|i| (i * i * 37 % 251) as u8).collect();
            assert_eq!(gaussian(&image, width, height), by_definition(&image, width, height));
        }
    }

    #[test]
    fn reduction_rounds_half_up_and_averages_what_there_is() {
        let image = [0, 1, 9, 1, 1, 7, 4, 4, 5];
        assert_eq!(reduce(&image, 3, 3, 2), [1, 8, 4, 5]);
        assert_eq!(reduce(&image, 3, 3, 1), image);
    }
}
