//! How wide residuals scatter.

use super::fit::CLIP;

/// Counts of absolute residuals, 64 buckets for each power of two.
#[derive(Clone)]
pub struct AbsHistogram {
    counts: Vec<u64>,
    pub total: u64,
}

const ABS_SHIFT: u32 = 17;

impl Default for AbsHistogram {
    fn default() -> Self {
        AbsHistogram { counts: vec![0; 1 << (31 - ABS_SHIFT)], total: 0 }
    }
}

impl AbsHistogram {
    pub fn add(&mut self, value: f64) {
        self.counts[((value as f32).to_bits() >> ABS_SHIFT) as usize & ((1 << (31 - ABS_SHIFT)) - 1)] += 1;
        self.total += 1;
    }

    pub fn merge(&mut self, other: &Self) {
        self.counts.iter_mut().zip(&other.counts).for_each(|(a, b)| *a += b);
        self.total += other.total;
    }

    fn edge(bucket: usize) -> f64 {
        f64::from(f32::from_bits((bucket as u32) << ABS_SHIFT))
    }

    /// The quantile of the values up to `limit`.
    fn quantile_below(&self, share: f64, limit: f64) -> f64 {
        let below: u64 = (0..self.counts.len()).take_while(|&i| Self::edge(i) < limit).map(|i| self.counts[i]).sum();
        let rank = share * below as f64;
        let mut before = 0.0;
        for (bucket, &count) in self.counts.iter().enumerate().filter(|(_, c)| **c > 0) {
            if before + count as f64 >= rank {
                let (low, high) = (Self::edge(bucket), Self::edge(bucket + 1));
                // Exact zeros are zeros.
                return if bucket == 0 { 0.0 } else { low + (high - low) * (rank - before) / count as f64 };
            }
            before += count as f64;
        }
        0.0
    }

    pub fn median(&self) -> f64 {
        self.quantile_below(0.5, f64::INFINITY)
    }

    /// Standard deviation of the core: 1.4826 times the median, then that of the values within three of it, again.
    pub fn scale(&self) -> f64 {
        let mut scale = 1.4826 * self.median();
        for _ in 0..20 {
            let next = self.quantile_below(0.5, CLIP * scale) / TRUNCATED_MEDIAN;
            if !(next > 0.0 && next < scale * (1.0 - 1e-6)) {
                break;
            }
            scale = next;
        }
        scale
    }
}

/// Median of |z| of normal values with |z| ≤ 3.
const TRUNCATED_MEDIAN: f64 = 0.672_0;
