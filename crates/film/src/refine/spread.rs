//! The median of many magnitudes.

/// Powers of two told apart, up to 2¹, and parts of each.
const POWERS: u32 = 24;
const PARTS_BITS: u32 = 6;
/// Places of the bits of a single: its exponent and the first bits after.
const SHIFT: u32 = 23 - PARTS_BITS;
const HIGHEST: u32 = (128 << PARTS_BITS) - 1;
const LOWEST: u32 = HIGHEST + 1 - (POWERS << PARTS_BITS);
const BINS: usize = (POWERS << PARTS_BITS) as usize;

/// Magnitudes of residuals, counted into bins of a hundredth of their size. Within its bin the median is placed by its
/// rank.
#[derive(Default)]
pub(super) struct Magnitudes {
    counts: Vec<u32>,
    total: u32,
}

impl Magnitudes {
    /// Takes all of them out.
    pub fn clear(&mut self) {
        self.counts.clear();
        self.counts.resize(BINS, 0);
        self.total = 0;
    }

    /// Counts how far the values are from `zero`.
    #[inline(always)]
    pub fn count(&mut self, values: &[f32], zero: f32) {
        let counts: &mut [u32; BINS] = self.counts.as_mut_slice().try_into().expect("as many as bins");
        for v in values {
            counts[bin((v - zero).abs())] += 1;
        }
        self.total += values.len() as u32;
    }

    /// 0 of none.
    pub fn median(&self) -> f32 {
        let middle = self.total / 2;
        let mut before = 0;
        for (k, count) in self.counts.iter().enumerate() {
            if before + count > middle {
                let edge = |k: u32| f32::from_bits((LOWEST + k) << SHIFT);
                let (low, high) = (edge(k as u32), edge(k as u32 + 1));
                // What is smaller than the smallest bin is in it.
                let low = if k == 0 { 0.0 } else { low };
                return low + (high - low) * ((middle - before) as f32 + 0.5) / *count as f32;
            }
            before += count;
        }
        0.0
    }
}

/// Singles that are not negative are ordered as their bits are.
#[inline(always)]
fn bin(magnitude: f32) -> usize {
    ((magnitude.to_bits() >> SHIFT).clamp(LOWEST, HIGHEST) - LOWEST) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_that_of_the_sorted_list_to_a_bin() {
        let mut of = Magnitudes::default();
        for n in [1usize, 2, 3, 10, 1_001, 5_000] {
            for scale in [0.0f32, 1e-12, 1e-3, 0.2, 1.9] {
                let values: Vec<f32> = (0..n)
                    .map(|i| scale * (((i as u32).wrapping_mul(2_654_435_761) >> 12) as f32 / 1e6 - 0.5))
                    .collect();
                of.clear();
                of.count(&values, 0.0);
                let mut sorted: Vec<f32> = values.iter().map(|v| v.abs()).collect();
                sorted.sort_unstable_by(f32::total_cmp);
                let (expected, found) = (sorted[sorted.len() / 2], of.median());
                assert!((found - expected).abs() <= 0.016 * expected + 3e-7, "{n} of {scale}: {found} for {expected}");
            }
        }
        of.clear();
        assert_eq!(of.median(), 0.0);
    }

    #[test]
    fn the_median_moves_with_its_rank() {
        // Ten times the same magnitude and one more on either side: within the bin, not at its edge.
        let mut of = Magnitudes::default();
        let mut last = 0.0;
        for above in 0..5 {
            of.clear();
            of.count(&[0.25; 10], 0.0);
            of.count(&[0.5; 4][..above], 0.0);
            let now = of.median();
            assert!(now >= last && (0.25..0.254).contains(&now), "{now}");
            last = now;
        }
    }
}
