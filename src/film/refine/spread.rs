//! The median of many magnitudes.

/// Powers of two told apart, up to 2¹, and parts of each.
const POWERS: u64 = 24;
const PARTS_BITS: u32 = 6;
/// Places of the bits of a double: its exponent and the first bits after.
const SHIFT: u32 = 52 - PARTS_BITS;
const HIGHEST: u64 = (1024 << PARTS_BITS) - 1;
const LOWEST: u64 = HIGHEST + 1 - (POWERS << PARTS_BITS);
const BINS: usize = (POWERS << PARTS_BITS) as usize;

/// Magnitudes of residuals, counted into bins of a few per cent so that only those of one bin are sorted.
#[derive(Default)]
pub(super) struct Magnitudes {
    all: Vec<f64>,
    counts: Vec<u32>,
    bin: Vec<f64>,
}

impl Magnitudes {
    pub fn clear(&mut self) {
        self.all.clear();
    }

    /// How far the values are from `zero`.
    #[inline(always)]
    pub fn extend<V: Copy + Into<f64>>(&mut self, values: &[V], zero: f64) {
        let start = self.all.len();
        self.all.resize(start + values.len(), 0.0);
        for (to, v) in self.all[start..].iter_mut().zip(values) {
            *to = ((*v).into() - zero).abs();
        }
    }

    /// The upper one of an even number; 0 of none.
    pub fn median(&mut self) -> f64 {
        if self.all.is_empty() {
            return 0.0;
        }
        self.counts.clear();
        self.counts.resize(BINS, 0);
        let counts: &mut [u32; BINS] = self.counts.as_mut_slice().try_into().expect("as many as bins");
        for v in &self.all {
            counts[bin(*v)] += 1;
        }
        let mut before = 0;
        let mut middle = self.all.len() / 2;
        let mut wanted = 0;
        for (k, count) in self.counts.iter().enumerate() {
            if before + *count as usize > middle {
                wanted = k;
                break;
            }
            before += *count as usize;
        }
        middle -= before;
        self.bin.clear();
        for v in &self.all {
            if bin(*v) == wanted {
                self.bin.push(*v);
            }
        }
        *self.bin.select_nth_unstable_by(middle, f64::total_cmp).1
    }
}

/// Doubles that are not negative are ordered as their bits are.
#[inline(always)]
fn bin(magnitude: f64) -> usize {
    ((magnitude.to_bits() >> SHIFT).clamp(LOWEST, HIGHEST) - LOWEST) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_that_of_the_sorted_list() {
        let mut of = Magnitudes::default();
        for n in [1usize, 2, 3, 10, 1_001, 5_000] {
            for scale in [0.0, 1e-12, 1e-3, 0.2, 7.0, 1e9] {
                let values: Vec<f64> = (0..n)
                    .map(|i| scale * (f64::from((i as u32).wrapping_mul(2_654_435_761) >> 12) / 1e6 - 0.5))
                    .collect();
                of.clear();
                of.extend(&values, 0.0);
                let mut sorted: Vec<f64> = values.iter().map(|v| v.abs()).collect();
                sorted.sort_unstable_by(f64::total_cmp);
                assert_eq!(of.median(), sorted[n / 2], "{n} values of {scale}");
            }
        }
    }
}
