//! How wide residuals scatter.

use super::weighing::CLIP;

/// Counts of absolute residuals, 64 buckets for each power of two.
#[derive(Clone)]
pub struct AbsHistogram {
    counts: Box<[u64; BUCKETS]>,
    pub total: u64,
}

const ABS_SHIFT: u32 = 17;
const BUCKETS: usize = 1 << (31 - ABS_SHIFT);

impl Default for AbsHistogram {
    fn default() -> Self {
        let counts = vec![0; BUCKETS].into_boxed_slice().try_into().expect("as many as there are buckets");
        AbsHistogram { counts, total: 0 }
    }
}

impl AbsHistogram {
    /// Counts a value by its magnitude.
    #[inline]
    pub fn add(&mut self, value: f64) {
        self.counts[((value as f32).to_bits() >> ABS_SHIFT) as usize % BUCKETS] += 1;
        self.total += 1;
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: &Self) {
        if other.total > 0 {
            self.counts.iter_mut().zip(other.counts.iter()).for_each(|(a, b)| *a += b);
            self.total += other.total;
        }
    }

    fn filled(&self) -> Filled {
        let counts = self.counts.iter().enumerate().filter(|(_, count)| **count > 0);
        Filled(counts.map(|(bucket, &count)| (bucket as u32, count)).collect())
    }

    /// The median of the magnitudes.
    pub fn median(&self) -> f64 {
        self.filled().median_below(f64::INFINITY)
    }

    /// Standard deviation of the core: 1.4826 times the median, then that of the values within three of it, again.
    pub fn scale(&self) -> f64 {
        let filled = self.filled();
        let mut scale = 1.4826 * filled.median_below(f64::INFINITY);
        for _ in 0..20 {
            let next = filled.median_below(CLIP * scale) / TRUNCATED_MEDIAN;
            if !(next > 0.0 && next < scale * (1.0 - 1e-6)) {
                break;
            }
            scale = next;
        }
        scale
    }
}

/// The buckets that hold residuals, from small to large, and how many.
struct Filled(Vec<(u32, u64)>);

impl Filled {
    fn edge(bucket: u32) -> f64 {
        f64::from(f32::from_bits(bucket << ABS_SHIFT))
    }

    /// The median of the values up to `limit`.
    fn median_below(&self, limit: f64) -> f64 {
        let below = &self.0[..self.0.partition_point(|&(bucket, _)| Self::edge(bucket) < limit)];
        let rank = 0.5 * below.iter().map(|(_, count)| count).sum::<u64>() as f64;
        let mut before = 0.0;
        for &(bucket, count) in below {
            if before + count as f64 >= rank {
                let (low, high) = (Self::edge(bucket), Self::edge(bucket + 1));
                // Exact zeros are zeros.
                return if bucket == 0 { 0.0 } else { low + (high - low) * (rank - before) / count as f64 };
            }
            before += count as f64;
        }
        0.0
    }
}

/// Median of |z| of normal values with |z| ≤ 3.
const TRUNCATED_MEDIAN: f64 = 0.672_0;
