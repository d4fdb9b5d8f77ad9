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

/// Buckets of a page, by their last bits.
const PAGE_BITS: u32 = 10;

type Page = Box<[u64; 1 << PAGE_BITS]>;

/// Counts of values by the leading `BITS` bits of their order key, more than ten. Values lie close together: pages of
/// buckets are there once one of theirs came.
#[derive(Clone)]
pub struct FloatHistogram<const BITS: u32> {
    pages: Vec<Option<Page>>,
}

impl<const BITS: u32> Default for FloatHistogram<BITS> {
    fn default() -> Self {
        FloatHistogram { pages: vec![None; 1 << (BITS - PAGE_BITS)] }
    }
}

impl<const BITS: u32> FloatHistogram<BITS> {
    /// Counts a value.
    #[inline]
    pub fn add(&mut self, value: f32) {
        let bucket = (order_key(value) >> (32 - BITS)) as usize;
        let page = self.pages[bucket >> PAGE_BITS].get_or_insert_with(|| Box::new([0; 1 << PAGE_BITS]));
        page[bucket & ((1 << PAGE_BITS) - 1)] += 1;
    }

    /// Adds another's counts.
    pub fn merge(&mut self, other: &Self) {
        for (mine, theirs) in self.pages.iter_mut().zip(&other.pages) {
            match (mine, theirs) {
                (Some(mine), Some(theirs)) => mine.iter_mut().zip(theirs.iter()).for_each(|(a, b)| *a += b),
                (mine @ None, Some(theirs)) => *mine = Some(theirs.clone()),
                (_, None) => {}
            }
        }
    }

    /// The buckets that hold values.
    pub fn filled(&self) -> Filled<BITS> {
        let pages = (0u32..).zip(&self.pages).filter_map(|(number, page)| Some((number << PAGE_BITS, page.as_ref()?)));
        let buckets = pages.flat_map(|(first, page)| (first..).zip(page.iter()).filter(|(_, count)| **count > 0));
        let buckets: Vec<(u32, u64)> = buckets.map(|(bucket, &count)| (bucket, count)).collect();
        let total = buckets.iter().map(|(_, count)| count).sum();
        Filled { buckets, total }
    }
}

/// Buckets of a [`FloatHistogram`] that hold values, in their order, and how many.
pub struct Filled<const BITS: u32> {
    buckets: Vec<(u32, u64)>,
    total: u64,
}

/// A run of them.
#[derive(Clone, Copy)]
struct Run<'a, const BITS: u32> {
    buckets: &'a [(u32, u64)],
    total: u64,
}

impl<const BITS: u32> Filled<BITS> {
    /// How many values there are.
    pub fn total(&self) -> u64 {
        self.total
    }

    fn all(&self) -> Run<'_, BITS> {
        Run { buckets: &self.buckets, total: self.total }
    }

    /// The quantile, interpolated within its bucket: good to a part of the bucket's relative width. `None` when empty.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        self.all().quantile(share)
    }

    /// The median distance from `centre`, to the resolution of the buckets.
    pub fn median_distance(&self, centre: f64) -> f64 {
        self.all().median_distance(centre)
    }

    /// The mean of the values at most `reach` from `centre`, to the resolution of the buckets; `None` where there are
    /// none.
    pub fn mean_within(&self, centre: f64, reach: f64) -> Option<f64> {
        let kept = self.all().within(centre, reach);
        let off = |&(bucket, count): &(u32, u64)| (middle::<BITS>(bucket) - centre) * count as f64;
        (kept.total > 0).then(|| centre + kept.buckets.iter().map(off).sum::<f64>() / kept.total as f64)
    }

    /// The share of the values at most `reach` from `centre`, to the resolution of the buckets; 1 when empty.
    pub fn share_within(&self, centre: f64, reach: f64) -> f64 {
        if self.total == 0 { 1.0 } else { self.all().within(centre, reach).total as f64 / self.total as f64 }
    }

    /// The shortest interval that holds half of the values: its middle and half its length, to the resolution of the
    /// buckets. It lies where most values are, however far the others lie to one side (P. Rousseeuw, *Least median of
    /// squares regression*, 1984). `None` when empty.
    pub fn shortest_half(&self) -> Option<(f64, f64)> {
        let half = self.total.div_ceil(2);
        let filled = &self.buckets;
        let (mut best, mut end, mut inside) = (None, 0, 0);
        for &(first, count) in filled {
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
            let (low, (from, to)) = (f64::from(edges::<BITS>(first).0), edges::<BITS>(last));
            let high = f64::from(to) - spare * (f64::from(to) - f64::from(from));
            if best.is_none_or(|(_, shortest)| (high - low) / 2.0 < shortest) {
                best = Some(((low + high) / 2.0, (high - low) / 2.0));
            }
            inside -= count;
        }
        best
    }

    /// Median and standard deviation of the core: of the values within three standard deviations of their median, found
    /// from [`Filled::shortest_half`] on until they stay the same. Values that lie apart to one side draw neither.
    /// `None` when empty.
    pub fn core(&self) -> Option<(f64, f64)> {
        /// Of normal values within three standard deviations the median of |z|.
        const TRUNCATED_MEDIAN: f64 = 0.672_0;
        const MOST_TURNS: usize = 20;
        let (mut middle, half) = self.shortest_half()?;
        let mut scale = half / 0.674_5;
        for _ in 0..MOST_TURNS {
            let kept = self.all().within(middle, 3.0 * scale);
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
}

impl<'a, const BITS: u32> Run<'a, BITS> {
    /// The buckets whose middles lie at most `reach` from `centre`.
    fn within(self, centre: f64, reach: f64) -> Run<'a, BITS> {
        let from = self.buckets.partition_point(|&(bucket, _)| middle::<BITS>(bucket) - centre < -reach);
        let to = self.buckets.partition_point(|&(bucket, _)| middle::<BITS>(bucket) - centre <= reach);
        let buckets = &self.buckets[from..to.max(from)];
        Run { buckets, total: buckets.iter().map(|(_, count)| count).sum() }
    }

    fn quantile(self, share: f64) -> Option<f64> {
        if self.total == 0 {
            return None;
        }
        let rank = share.clamp(0.0, 1.0) * (self.total - 1) as f64;
        let mut before = 0;
        let &(bucket, count) = self.buckets.iter().find(|(_, count)| {
            before += count;
            (rank as u64) < before
        })?;
        let (low, high) = edges::<BITS>(bucket);
        let within = (rank - (before - count) as f64 + 0.5) / count as f64;
        let (low, high) = (f64::from(low), f64::from(high));
        let value = low + (high - low) * within.clamp(0.0, 1.0);
        Some(if value.abs() > 1e-30 && value.is_finite() { value } else { 0.0 })
    }

    fn median_distance(self, centre: f64) -> f64 {
        // The bucket of the exact zeros holds them and the smallest numbers there are.
        let from_centre = |bucket: u32| {
            let middle = middle::<BITS>(bucket);
            if middle.abs() < 1e-30 { -centre } else { middle - centre }
        };
        let above = self.buckets.partition_point(|&(bucket, _)| from_centre(bucket) < 0.0);
        let (below, above) = self.buckets.split_at(above);
        // Outwards from the centre, the nearer bucket of both sides first.
        let (mut below, mut above) = (below.iter().rev().peekable(), above.iter().peekable());
        let half = self.total.div_ceil(2);
        let mut before = 0;
        loop {
            let down = below.peek().map_or(f64::INFINITY, |(bucket, _)| -from_centre(*bucket));
            let up = above.peek().map_or(f64::INFINITY, |(bucket, _)| from_centre(*bucket));
            let next = if down < up { below.next() } else { above.next().or_else(|| below.next()) };
            let Some((_, count)) = next else { return f64::NAN };
            before += count;
            if before >= half {
                // A distance of nothing has no sign.
                return down.min(up) + 0.0;
            }
        }
    }
}

/// Smallest and largest value of a bucket.
fn edges<const BITS: u32>(bucket: u32) -> (f32, f32) {
    let low = bucket << (32 - BITS);
    (from_order_key(low), from_order_key(low | ((1u64 << (32 - BITS)) - 1) as u32))
}

fn middle<const BITS: u32>(bucket: u32) -> f64 {
    let (low, high) = edges::<BITS>(bucket);
    (f64::from(low) + f64::from(high)) / 2.0
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
        let (middle, half) = histogram.filled().shortest_half().expect("not empty");
        assert!((middle - 10.0).abs() < 0.3 && (half - 5.0 / 7.0).abs() < 0.01, "{middle}, {half}");
        let (median, scale) = histogram.filled().core().expect("not empty");
        assert!((median - 10.0).abs() < 0.01 && scale < 0.8, "{median}, {scale}");
        assert_eq!(FloatHistogram::<20>::default().filled().core(), None);
        let mut equal = FloatHistogram::<20>::default();
        (0..5).for_each(|_| equal.add(0.0));
        assert!(equal.filled().median_distance(0.0).is_sign_positive());
        assert!(
            equal.filled().core().is_some_and(|(median, scale)| median == 0.0 && scale < 1e-30),
            "{:?}",
            equal.filled().core()
        );
    }

    #[test]
    fn quantiles_are_good_to_a_bucket() {
        let mut histogram = FloatHistogram::<16>::default();
        for i in 0..10_001 {
            histogram.add((i as f32 - 5000.0) / 100.0);
        }
        for share in [0.1, 0.25, 0.5, 0.9] {
            let exact = -50.0 + 100.0 * share;
            let found = histogram.filled().quantile(share).expect("not empty");
            assert!((found - exact).abs() <= 0.01 + 0.01 * f64::abs(exact), "{share}: {found} for {exact}");
        }
    }
}
