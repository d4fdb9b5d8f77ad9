//! What the coefficients of a JPEG differ by from a model: rounding, and the texture of the ground.

use super::descent::Trust;
use super::jpeg_planes::Channels;
use super::jpeg_steps::{CELLS, Cells, Cosines, N};

/// Variance of a coefficient by rounded samples.
const SAMPLES: f64 = 0.15;

/// Class of a coefficient: its distance from the constant one.
pub(super) fn class(k: usize) -> usize {
    (((k / N * (k / N) + k % N * (k % N)) as f64).sqrt() + 0.5) as usize
}
const CLASSES: usize = 11;
/// Of each channel and class of coefficients.
pub(super) type Texture = [[f64; CLASSES]; 3];

/// Variance of the ground's texture in each channel and class: what is left over beyond rounding, and before much was
/// seen a spectrum that falls with the third power of the frequency and has the variance of the pixels in the ring.
///
/// `seen` are the blocks: channel, what is left over, the mean square of how much ground is seen.
pub(super) fn texture<'a>(
    seen: impl Iterator<Item = (usize, &'a Cells, f64)>,
    channels: &Channels,
    classes: &[usize; CELLS],
) -> Texture {
    const TRUST: f64 = 4.0;
    let mut sums = [[[0.0f64; 2]; CLASSES]; 3];
    for (channel, left, open) in seen {
        let rounding = &channels.rounding[channel];
        for k in 0..CELLS {
            let sum = &mut sums[channel][classes[k]];
            sum[0] += left[k] * left[k] - rounding[k];
            sum[1] += open;
        }
    }
    std::array::from_fn(|c| {
        std::array::from_fn(|r| {
            // 64 over the sum of the spectrum.
            let expected = 20.0 * channels.spread[c] / (1.0 + (r * r) as f64).powf(1.5);
            let [sum, count] = sums[c][r];
            ((sum + TRUST * expected) / (count + TRUST)).max(0.05)
        })
    })
}

/// What a coefficient differs by from the model's: rounding and the ground's texture.
pub(super) struct Noise<'a> {
    pub channels: &'a Channels,
    pub classes: &'a [usize; CELLS],
    pub texture: &'a Texture,
}

impl Noise<'_> {
    /// Weights of a block's coefficients; robust ones take weight from what lies far off (Student's distribution).
    pub fn weights(&self, channel: usize, left: &Cells, open: f64, trust: Trust) -> Cells {
        const FREEDOM: f64 = 6.0;
        let (rounding, texture) = (&self.channels.rounding[channel], &self.texture[channel]);
        std::array::from_fn(|k| {
            let variance = rounding[k] + texture[self.classes[k]] * open + SAMPLES;
            let z2 = left[k] * left[k] / variance;
            match trust {
                Trust::Robust => (FREEDOM + 1.0) / (FREEDOM + z2) / variance,
                Trust::Even => 1.0 / variance,
            }
        })
    }

    /// Adds to `out` (xx, xy, yy) what a block's rounding and texture add to the centre, on which its coefficients have
    /// such an influence before they are weighed.
    pub fn add_variance(
        &self,
        out: &mut [f64; 3],
        mut influence: [Cells; 2],
        (channel, weights, shown): (usize, &Cells, &Cells),
        cosines: &Cosines,
    ) {
        let through = influence.each_mut().map(|influence| {
            influence.iter_mut().zip(weights).for_each(|(i, w)| *i *= w);
            let mut pixels = cosines.back(influence);
            pixels.iter_mut().zip(shown).for_each(|(p, shown)| *p *= shown);
            cosines.transform(&pixels)
        });
        let (rounding, texture) = (&self.channels.rounding[channel], &self.texture[channel]);
        for (sum, (a, b)) in out.iter_mut().zip([(0, 0), (0, 1), (1, 1)]) {
            *sum += (0..CELLS)
                .map(|k| {
                    (rounding[k] + SAMPLES) * influence[a][k] * influence[b][k]
                        + texture[self.classes[k]] * through[a][k] * through[b][k]
                })
                .sum::<f64>();
        }
    }
}
