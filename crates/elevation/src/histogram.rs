//! Histograms whose buckets follow the floating-point numbers: fine where values are small, of equal relative width
//! elsewhere.

/// An unsigned number that orders as the floating-point numbers do; NaN is not asked for.
pub fn order_key(value: f32) -> u32 {
    // Minus zero and zero are one value.
    let bits = (value + 0.0).to_bits();
    if bits >> 31 == 0 { bits | 0x8000_0000 } else { !bits }
}

/// The number that has this key.
pub fn from_order_key(key: u32) -> f32 {
    f32::from_bits(if key >> 31 == 1 { key & 0x7fff_ffff } else { !key })
}

/// Counts of values by the leading `BITS` bits of their order key.
#[derive(Clone)]
pub struct FloatHistogram<const BITS: u32> {
    counts: Vec<u64>,
    total: u64,
}

impl<const BITS: u32> Default for FloatHistogram<BITS> {
    fn default() -> Self {
        FloatHistogram { counts: vec![0; 1 << BITS], total: 0 }
    }
}

impl<const BITS: u32> FloatHistogram<BITS> {
    #[inline]
    pub fn add(&mut self, value: f32) {
        self.counts[(order_key(value) >> (32 - BITS)) as usize] += 1;
        self.total += 1;
    }

    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.counts.iter_mut().zip(&other.counts) {
            *mine += theirs;
        }
        self.total += other.total;
    }

    pub fn total(&self) -> u64 {
        self.total
    }

    pub fn counts(&self) -> &[u64] {
        &self.counts
    }

    /// Smallest and largest value of a bucket.
    pub fn edges(bucket: usize) -> (f32, f32) {
        let low = (bucket as u32) << (32 - BITS);
        (from_order_key(low), from_order_key(low | ((1u64 << (32 - BITS)) - 1) as u32))
    }

    /// The bucket of the value of this rank (from 0), and how many values lie in buckets before it. `None` beyond the
    /// end.
    pub fn bucket_of_rank(&self, rank: u64) -> Option<(usize, u64)> {
        let mut before = 0;
        for (bucket, &count) in self.counts.iter().enumerate() {
            if rank < before + count {
                return Some((bucket, before));
            }
            before += count;
        }
        None
    }

    /// The quantile, interpolated within its bucket: good to a part of the bucket's relative width. `None` when empty.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        if self.total == 0 {
            return None;
        }
        let rank = share.clamp(0.0, 1.0) * (self.total - 1) as f64;
        let (bucket, before) = self.bucket_of_rank(rank as u64)?;
        let (low, high) = Self::edges(bucket);
        let within = (rank - before as f64 + 0.5) / self.counts[bucket] as f64;
        let (low, high) = (f64::from(low), f64::from(high));
        let value = low + (high - low) * within.clamp(0.0, 1.0);
        Some(if value.abs() > 1e-30 && value.is_finite() { value } else { 0.0 })
    }

    /// The mean of the values at most `reach` from `centre`, to the resolution of the buckets; `None` where there are
    /// none.
    pub fn mean_within(&self, centre: f64, reach: f64) -> Option<f64> {
        let (mut sum, mut count) = (0.0, 0u64);
        for (bucket, &here) in self.counts.iter().enumerate().filter(|(_, here)| **here > 0) {
            let (low, high) = Self::edges(bucket);
            let off = (f64::from(low) + f64::from(high)) / 2.0 - centre;
            if off.abs() <= reach {
                sum += off * here as f64;
                count += here;
            }
        }
        (count > 0).then(|| centre + sum / count as f64)
    }

    /// The shortest interval that holds half of the values: its middle and half its length, to the resolution of the
    /// buckets. It lies where most values are, however far the others lie to one side (P. Rousseeuw, *Least median of
    /// squares regression*, 1984). `None` when empty.
    pub fn shortest_half(&self) -> Option<(f64, f64)> {
        let half = self.total.div_ceil(2);
        let filled: Vec<(usize, u64)> = self
            .counts
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(bucket, &count)| (bucket, count))
            .collect();
        let (mut best, mut end, mut inside) = (None, 0, 0);
        for &(first, count) in &filled {
            while inside < half && end < filled.len() {
                inside += filled[end].1;
                end += 1;
            }
            if inside < half {
                break;
            }
            let (last, in_last) = filled[end - 1];
            // The part of the last bucket that is not needed.
            let spare = (inside - half) as f64 / in_last as f64;
            let (low, (from, to)) = (f64::from(Self::edges(first).0), Self::edges(last));
            let high = f64::from(to) - spare * (f64::from(to) - f64::from(from));
            if best.is_none_or(|(_, shortest)| (high - low) / 2.0 < shortest) {
                best = Some(((low + high) / 2.0, (high - low) / 2.0));
            }
            inside -= count;
        }
        best
    }

    /// Median and standard deviation of the core: of the values within three standard deviations of their median, found
    /// from [`FloatHistogram::shortest_half`] on until they stay the same. Values that lie apart to one side draw
    /// neither. `None` when empty.
    pub fn core(&self) -> Option<(f64, f64)> {
        /// Of normal values within three standard deviations the median of |z|.
        const TRUNCATED_MEDIAN: f64 = 0.672_0;
        const MOST_TURNS: usize = 20;
        let (mut middle, half) = self.shortest_half()?;
        let mut scale = half / 0.674_5;
        for _ in 0..MOST_TURNS {
            let kept = self.within(middle, 3.0 * scale);
            let Some(median) = kept.quantile(0.5) else { break };
            let next = kept.median_distance(median) / TRUNCATED_MEDIAN;
            let still = (median - middle).abs() <= 1e-4 * scale && (next - scale).abs() <= 1e-4 * scale;
            (middle, scale) = (median, next);
            if still {
                break;
            }
        }
        Some((middle, scale))
    }

    /// The share of the values at most `reach` from `centre`, to the resolution of the buckets; 1 when empty.
    pub fn share_within(&self, centre: f64, reach: f64) -> f64 {
        if self.total == 0 { 1.0 } else { self.within(centre, reach).total as f64 / self.total as f64 }
    }

    /// The values at most `reach` from `centre`, to the resolution of the buckets.
    fn within(&self, centre: f64, reach: f64) -> Self {
        let mut kept = FloatHistogram::default();
        for (bucket, &count) in self.counts.iter().enumerate().filter(|(_, count)| **count > 0) {
            let (low, high) = Self::edges(bucket);
            if ((f64::from(low) + f64::from(high)) / 2.0 - centre).abs() <= reach {
                kept.counts[bucket] = count;
                kept.total += count;
            }
        }
        kept
    }

    /// The median distance from `centre`, to the resolution of the buckets.
    pub fn median_distance(&self, centre: f64) -> f64 {
        if self.total == 0 {
            return f64::NAN;
        }
        // Walk outwards from the centre, bucket by bucket, by distance of the bucket's middle.
        let mut distances: Vec<(f64, u64)> = self
            .counts
            .iter()
            .enumerate()
            .filter(|(_, count)| **count > 0)
            .map(|(bucket, &count)| {
                let (low, high) = Self::edges(bucket);
                let middle = (f64::from(low) + f64::from(high)) / 2.0;
                // The bucket of the exact zeros holds them and the smallest numbers there are.
                let middle = if middle.abs() < 1e-30 { 0.0 } else { middle };
                ((middle - centre).abs(), count)
            })
            .collect();
        distances.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = self.total.div_ceil(2);
        let mut before = 0;
        for (distance, count) in distances {
            before += count;
            if before >= half {
                return distance;
            }
        }
        f64::NAN
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_keep_the_order_and_come_back() {
        let values = [f32::MIN, -1.0, -1e-30, 0.0, 1e-30, 0.5, 1.0, 1e30];
        for pair in values.windows(2) {
            assert!(order_key(pair[0]) < order_key(pair[1]));
        }
        for value in values {
            assert_eq!(from_order_key(order_key(value)), value);
        }
        assert_eq!(order_key(-0.0), order_key(0.0));
    }

    #[test]
    fn what_lies_apart_draws_no_core() {
        let mut histogram = FloatHistogram::<20>::default();
        // Seven in ten between 9 and 11, three at −30.
        (0..7000).for_each(|i| histogram.add(9.0 + i as f32 / 3500.0));
        (0..3000).for_each(|_| histogram.add(-30.0));
        let (middle, half) = histogram.shortest_half().expect("not empty");
        assert!((middle - 10.0).abs() < 0.3 && (half - 5.0 / 7.0).abs() < 0.01, "{middle}, {half}");
        let (median, scale) = histogram.core().expect("not empty");
        assert!((median - 10.0).abs() < 0.01 && scale < 0.8, "{median}, {scale}");
        assert_eq!(FloatHistogram::<20>::default().core(), None);
        let mut equal = FloatHistogram::<20>::default();
        (0..5).for_each(|_| equal.add(0.0));
        assert!(equal.core().is_some_and(|(median, scale)| median == 0.0 && scale < 1e-30), "{:?}", equal.core());
    }

    #[test]
    fn quantiles_are_good_to_a_bucket() {
        let mut histogram = FloatHistogram::<16>::default();
        for i in 0..10_001 {
            histogram.add((i as f32 - 5000.0) / 100.0);
        }
        for share in [0.1, 0.25, 0.5, 0.9] {
            let exact = -50.0 + 100.0 * share;
            let found = histogram.quantile(share).expect("not empty");
            assert!((found - exact).abs() <= 0.01 + 0.01 * f64::abs(exact), "{share}: {found} for {exact}");
        }
    }
}
