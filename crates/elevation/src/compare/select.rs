//! Quantiles of many groups in two streamed passes: a histogram, then the values of the buckets that matter.

use crate::error::Result;
use crate::histogram::{from_order_key, order_key};
use crate::stream;
use crate::window::{TileGrid, Window};

/// Leading bits of the first pass.
const BITS: u32 = 16;
/// Different values that are held at most; beyond, a bucket is split once more and interpolated.
const MOST_VALUES: u64 = 6_000_000;
/// Bits of that split.
const SPLIT_BITS: u32 = 8;

/// What takes the values: a value and the groups that it belongs to.
pub type Sink<'a> = &'a mut dyn FnMut(&[usize], f32);

/// How often the values were shown before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    First,
    Second,
}

/// How the values of a group are spread; NaN for an empty group.
#[derive(Clone, Debug, PartialEq)]
pub struct Distribution {
    /// One for each share asked for.
    pub quantiles: Vec<f64>,
    pub median: f64,
    /// The median distance from the median.
    pub median_distance: f64,
}

/// What is asked of the values.
pub struct Question<'a> {
    pub groups: usize,
    pub shares: &'a [f64],
    /// A value near the medians: buckets are fine around it. It changes what is held, not what comes out.
    pub centre: f32,
}

/// The quantiles and the median distance from the median of each group, by linear interpolation between the
/// neighbouring values (type 7 of R. Hyndman and Y. Fan, *Sample quantiles in statistical packages*, 1996); and the
/// workers' states after the first pass. `visit` shows all values of a window.
///
/// Exact up to six million different values in the buckets that matter, else good to 2⁻¹⁵ of the distance from
/// `centre`.
///
/// # Errors
/// Those of `visit`.
pub fn distributions<S: Send>(
    question: &Question<'_>,
    threads: usize,
    tiles: &TileGrid,
    state: impl Fn() -> S + Sync,
    visit: impl Fn(Pass, Window, &mut S, Sink<'_>) -> Result<()> + Sync,
) -> Result<(Vec<Distribution>, Vec<S>)> {
    let &Question { groups, shares, centre } = question;
    let parts = stream::gather(
        tiles,
        threads,
        || (vec![Buckets::NONE; groups], state()),
        |(counts, state), window| {
            visit(Pass::First, window, state, &mut |groups, value| {
                let bucket = bucket_of(value, centre);
                groups.iter().for_each(|&group| counts[group].add(bucket));
            })
        },
    )?;
    let mut counts = vec![Buckets::NONE; groups];
    let mut states = Vec::new();
    for (part, state) in parts {
        states.push(state);
        counts.iter_mut().zip(part).for_each(|(all, own)| all.merge(own));
    }
    let plans: Vec<Option<Plan>> = counts.into_iter().map(|own| Plan::of(&own.filled(), shares)).collect();
    let held: u64 = plans.iter().flatten().map(Plan::held).sum();
    // Values that repeat cost nothing, but nobody knows before: all are counted.
    let numbers = if held > MOST_VALUES { Numbers::Split } else { Numbers::Exact };
    let parts = stream::gather(
        tiles,
        threads,
        || (Tally::default(), state()),
        |(tally, state), window| {
            visit(Pass::Second, window, state, &mut |groups, value| {
                let bucket = bucket_of(value, centre);
                for &group in groups {
                    if plans[group].as_ref().is_some_and(|plan| plan.wanted.holds(bucket)) {
                        tally.add((group as u64) << 32 | u64::from(numbers.of(value, centre)));
                    }
                }
            })
        },
    )?;
    let sorted = Tally::merged(parts.into_iter().map(|(tally, _)| tally));
    let of_group = |(group, plan): (usize, &Option<Plan>)| {
        let first = sorted.partition_point(|(number, _)| number >> 32 < group as u64);
        let end = sorted.partition_point(|(number, _)| number >> 32 <= group as u64);
        let values: Vec<(f64, u64)> =
            sorted[first..end].iter().map(|&(number, count)| (numbers.value(number as u32, centre), count)).collect();
        plan.as_ref().map_or_else(
            || Distribution { quantiles: vec![f64::NAN; shares.len()], median: f64::NAN, median_distance: f64::NAN },
            |plan| plan.solve(&values),
        )
    };
    Ok((plans.iter().enumerate().map(of_group).collect(), states))
}

/// Buckets follow the distance from the centre. Rounding keeps the order, so that ranks are those of the values.
fn bucket_of(value: f32, centre: f32) -> u16 {
    (order_key(value - centre) >> (32 - BITS)) as u16
}

/// How many values each bucket holds. A list may have thousands of small zones, so that a small group keeps its values'
/// buckets and not the counts of all.
#[derive(Clone)]
enum Buckets {
    Few(Vec<u16>),
    All(Vec<u64>),
}

impl Buckets {
    const NONE: Buckets = Buckets::Few(Vec::new());
    /// Values of a small group.
    const FEW: usize = 1 << 14;

    #[inline]
    fn add(&mut self, bucket: u16) {
        match self {
            Buckets::All(counts) => counts[bucket as usize] += 1,
            Buckets::Few(values) if values.len() < Self::FEW => values.push(bucket),
            Buckets::Few(_) => {
                self.spread()[bucket as usize] += 1;
            }
        }
    }

    /// As counts of all buckets.
    fn spread(&mut self) -> &mut Vec<u64> {
        if let Buckets::Few(values) = self {
            let mut counts = vec![0u64; 1 << BITS];
            values.iter().for_each(|bucket| counts[*bucket as usize] += 1);
            *self = Buckets::All(counts);
        }
        match self {
            Buckets::All(counts) => counts,
            Buckets::Few(_) => unreachable!("spread above"),
        }
    }

    fn merge(&mut self, other: Buckets) {
        match (&mut *self, other) {
            (Buckets::Few(all), Buckets::Few(own)) if all.len() + own.len() <= Self::FEW => all.extend(own),
            (_, Buckets::Few(own)) => {
                let counts = self.spread();
                own.into_iter().for_each(|bucket| counts[bucket as usize] += 1);
            }
            (_, Buckets::All(own)) => self.spread().iter_mut().zip(own).for_each(|(a, b)| *a += b),
        }
    }

    /// The buckets that hold any, in their order, and how many.
    fn filled(self) -> Vec<(u16, u64)> {
        match self {
            Buckets::Few(mut values) => {
                values.sort_unstable();
                values.chunk_by(|a, b| a == b).map(|run| (run[0], run.len() as u64)).collect()
            }
            Buckets::All(counts) => (0..=u16::MAX).zip(counts).filter(|(_, count)| *count > 0).collect(),
        }
    }
}

/// Buckets of which values are wanted.
enum Wanted {
    /// In their order.
    Few(Vec<u16>),
    /// A bit each.
    All(Vec<u64>),
}

impl Wanted {
    /// So many are sought as fast as a bit.
    const FEW: usize = 8;

    fn of(buckets: Vec<u16>) -> Wanted {
        if buckets.len() <= Self::FEW {
            return Wanted::Few(buckets);
        }
        let mut bits = vec![0u64; (1 << BITS) / 64];
        buckets.iter().for_each(|bucket| bits[*bucket as usize / 64] |= 1 << (bucket % 64));
        Wanted::All(bits)
    }

    #[inline]
    fn holds(&self, bucket: u16) -> bool {
        match self {
            Wanted::Few(buckets) => buckets.contains(&bucket),
            Wanted::All(bits) => bits[bucket as usize / 64] >> (bucket % 64) & 1 == 1,
        }
    }
}

/// How values are counted in the second pass.
#[derive(Clone, Copy)]
enum Numbers {
    /// As they are.
    Exact,
    /// By the leading bits of their distance from the centre.
    Split,
}

impl Numbers {
    const DROPPED: u32 = 32 - BITS - SPLIT_BITS;

    /// A number in the order of the values.
    fn of(self, value: f32, centre: f32) -> u32 {
        match self {
            Numbers::Exact => order_key(value),
            Numbers::Split => order_key(value - centre) >> Self::DROPPED,
        }
    }

    fn value(self, number: u32, centre: f32) -> f64 {
        match self {
            Numbers::Exact => f64::from(from_order_key(number)),
            Numbers::Split => {
                let middle = from_order_key((number << Self::DROPPED) | (1 << (Self::DROPPED - 1)));
                // The bucket of the exact zeros holds them and the smallest numbers there are.
                f64::from(centre) + f64::from(if middle.abs() < 1e-30 { 0.0 } else { middle })
            }
        }
    }
}

/// A place between two neighbouring values: ranks from 0, and how far from the first to the second.
#[derive(Clone, Copy)]
struct Place {
    low: u64,
    high: u64,
    share: f64,
}

impl Place {
    fn of(share: f64, total: u64) -> Place {
        let rank = share * (total - 1) as f64;
        let low = rank.floor() as u64;
        Place { low, high: (low + 1).min(total - 1), share: rank - low as f64 }
    }

    fn between(self, value: impl Fn(u64) -> f64) -> f64 {
        let (low, high) = (value(self.low), value(self.high));
        low + (high - low) * self.share
    }
}

/// What a group needs of the second pass.
struct Plan {
    places: Vec<Place>,
    median: Place,
    /// The buckets whose values are wanted.
    wanted: Wanted,
    /// Of the wanted buckets, in their order: values before it, and in it.
    spans: Vec<(u64, u64)>,
    /// Values that surely lie nearer to the median than its median distance, in buckets that are not wanted.
    nearer: u64,
}

impl Plan {
    /// From the buckets that hold values, in their order; `None` for an empty group.
    fn of(filled: &[(u16, u64)], shares: &[f64]) -> Option<Plan> {
        let total: u64 = filled.iter().map(|(_, count)| count).sum();
        if total == 0 {
            return None;
        }
        let mut wanted = vec![false; filled.len()];
        let places: Vec<Place> = shares.iter().map(|share| Place::of(*share, total)).collect();
        let median = Place::of(0.5, total);
        let mut ranks: Vec<u64> = places.iter().chain([&median]).flat_map(|place| [place.low, place.high]).collect();
        ranks.sort_unstable();
        let mut next = ranks.iter().peekable();
        let mut before = 0;
        for (wanted, (_, count)) in wanted.iter_mut().zip(filled) {
            while next.next_if(|rank| **rank < before + count).is_some() {
                *wanted = true;
            }
            before += count;
        }
        let nearer = want_distances(filled, median, &mut wanted);
        before = 0;
        let (mut spans, mut buckets) = (Vec::new(), Vec::new());
        for (&(bucket, count), wanted) in filled.iter().zip(wanted) {
            if wanted {
                spans.push((before, count));
                buckets.push(bucket);
            }
            before += count;
        }
        Some(Plan { places, median, wanted: Wanted::of(buckets), spans, nearer })
    }

    /// Values of the wanted buckets.
    fn held(&self) -> u64 {
        self.spans.iter().map(|(_, count)| count).sum()
    }

    /// From the wanted values in their order, each with how often it came.
    fn solve(&self, values: &[(f64, u64)]) -> Distribution {
        debug_assert_eq!(self.spans.iter().map(|s| s.1).sum::<u64>(), values.iter().map(|v| v.1).sum::<u64>());
        // Rank of the first value of a kind among the wanted ones.
        let ranks: Vec<u64> = values
            .iter()
            .scan(0, |next, v| {
                let first = *next;
                *next += v.1;
                Some(first)
            })
            .collect();
        let value_at = |rank: u64| {
            let mut among = 0;
            for &(before, count) in &self.spans {
                if rank < before + count {
                    among += rank - before;
                    break;
                }
                among += count;
            }
            values[ranks.partition_point(|first| *first <= among) - 1].0
        };
        let quantiles = self.places.iter().map(|place| place.between(value_at)).collect();
        let median = self.median.between(value_at);
        let mut distances: Vec<(f64, u64)> = values.iter().map(|&(v, count)| ((v - median).abs(), count)).collect();
        // What is wanted for a quantile alone and surely lies farther comes after, and changes nothing; what surely
        // lies nearer is counted where it stands.
        distances.sort_by(|a, b| a.0.total_cmp(&b.0));
        let distance_at = |rank: u64| {
            let mut before = self.nearer;
            for &(distance, count) in &distances {
                before += count;
                if rank < before {
                    return distance;
                }
            }
            f64::NAN
        };
        let median_distance = self.median.between(distance_at);
        debug_assert!(median_distance.is_finite(), "half of the values are counted");
        Distribution { quantiles, median, median_distance }
    }
}

/// Marks the buckets that may hold the values whose distance from the median is the median one. Returns how many values
/// lie surely nearer in buckets that are not wanted.
fn want_distances(filled: &[(u16, u64)], median: Place, wanted: &mut [bool]) -> u64 {
    let edges = |bucket: u16| {
        let low = u32::from(bucket) << (32 - BITS);
        let high = low | ((1 << (32 - BITS)) - 1);
        (f64::from(from_order_key(low)), f64::from(from_order_key(high)))
    };
    // Between what the median lies.
    let (mut before, mut from, mut to) = (0, f64::NAN, f64::NAN);
    for &(bucket, count) in filled {
        let holds = |rank: u64| (before..before + count).contains(&rank);
        if holds(median.low) {
            from = edges(bucket).0;
        }
        if holds(median.high) {
            to = edges(bucket).1;
        }
        before += count;
    }
    // Of each bucket: the least and the most distance of its values, and how many there are. Rounding of a value's
    // distance from the centre is far below a part of a bucket; what it may do at an edge is a millionth.
    let reach: Vec<(f64, f64, u64)> = filled
        .iter()
        .map(|&(bucket, count)| {
            let (low, high) = edges(bucket);
            let slack = 1e-6 * (low.abs().max(high.abs()) + from.abs().max(to.abs()));
            let least = (low - to).max(from - high).max(0.0) - slack;
            let most = (high - from).max(to - low) + slack;
            (least, most, count)
        })
        .collect();
    let distance_of = |rank: u64, mut ends: Vec<(f64, u64)>| {
        ends.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut before = 0;
        let reached = ends.iter().find(|(_, count)| {
            before += count;
            rank < before
        });
        reached.map_or(f64::INFINITY, |(distance, _)| *distance)
    };
    let low = distance_of(median.low, reach.iter().map(|r| (r.0, r.2)).collect());
    let high = distance_of(median.high, reach.iter().map(|r| (r.1, r.2)).collect());
    let mut nearer = 0;
    for (wanted, (least, most, count)) in wanted.iter_mut().zip(reach) {
        if least <= high && most >= low {
            *wanted = true;
        } else if most < low && !*wanted {
            nearer += count;
        }
    }
    nearer
}

/// How often each number came.
#[derive(Default)]
struct Tally {
    pending: Vec<u64>,
    /// In their order.
    counted: Vec<(u64, u64)>,
}

impl Tally {
    /// Numbers that are counted together at least.
    const PENDING: usize = 1 << 19;

    fn add(&mut self, number: u64) {
        self.pending.push(number);
        if self.pending.len() >= Self::PENDING.max(self.counted.len()) {
            self.count();
        }
    }

    fn count(&mut self) {
        self.pending.sort_unstable();
        let new = self.pending.chunk_by(|a, b| a == b).map(|run| (run[0], run.len() as u64));
        self.counted = joined(std::mem::take(&mut self.counted).into_iter(), new);
        self.pending.clear();
    }

    fn merged(all: impl Iterator<Item = Tally>) -> Vec<(u64, u64)> {
        all.fold(Vec::new(), |sum, mut tally| {
            tally.count();
            joined(sum.into_iter(), tally.counted.into_iter())
        })
    }
}

/// Two lists in their order as one.
fn joined(a: impl Iterator<Item = (u64, u64)>, b: impl Iterator<Item = (u64, u64)>) -> Vec<(u64, u64)> {
    let (mut a, mut b) = (a.peekable(), b.peekable());
    let mut all: Vec<(u64, u64)> = Vec::with_capacity(a.size_hint().0);
    loop {
        let next = match (a.peek(), b.peek()) {
            (Some(x), Some(y)) if x.0 <= y.0 => a.next(),
            (Some(_), None) => a.next(),
            _ => b.next(),
        };
        let Some((number, count)) = next else { return all };
        match all.last_mut() {
            Some((last, sum)) if *last == number => *sum += count,
            _ => all.push((number, count)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::SplitMix64;

    /// By sorting.
    fn sorted(mut values: Vec<f64>, share: f64) -> f64 {
        values.sort_by(f64::total_cmp);
        Place::of(share, values.len() as u64).between(|rank| values[rank as usize])
    }

    #[test]
    fn all_is_as_by_sorting() {
        let mut random = SplitMix64(5);
        // Rounded to halves, far from zero, few, one, none.
        let draw = |n: usize, shift: f64, scale: f64, step: f64, random: &mut SplitMix64| -> Vec<f32> {
            let one = |random: &mut SplitMix64| (0..4).map(|_| random.unit() - 0.5).sum::<f64>() * scale + shift;
            (0..n).map(|_| one(random)).map(|v| if step > 0.0 { (v / step).round() * step } else { v } as f32).collect()
        };
        let groups: Vec<Vec<f32>> = vec![
            draw(40_000, 0.3, 2.0, 0.0, &mut random),
            draw(9_999, -4.0, 9.0, 0.5, &mut random),
            draw(10_000, 1000.0, 1.0, 0.0, &mut random),
            draw(2, 5.0, 3.0, 0.0, &mut random),
            vec![7.25],
            Vec::new(),
            vec![-1.5; 300],
        ];
        let shares = [0.01, 0.25, 0.9];
        for centre in [0.0, 0.31, -12.5, 1000.0] {
            let tiles = TileGrid::new(4, 1, 1, 1, 0);
            let question = Question { groups: groups.len(), shares: &shares, centre };
            let visit = |_, window: Window, (): &mut (), sink: Sink<'_>| {
                for (group, values) in groups.iter().enumerate() {
                    values.iter().skip(window.x as usize).step_by(4).for_each(|v| sink(&[group], *v));
                }
                Ok(())
            };
            let (found, _) = distributions(&question, 2, &tiles, || (), visit).expect("memory");
            for (found, values) in found.iter().zip(&groups).filter(|(_, values)| !values.is_empty()) {
                let values: Vec<f64> = values.iter().map(|v| f64::from(*v)).collect();
                let quantiles: Vec<f64> = shares.iter().map(|share| sorted(values.clone(), *share)).collect();
                assert_eq!(found.quantiles, quantiles);
                let median = sorted(values.clone(), 0.5);
                assert_eq!(found.median, median);
                assert_eq!(found.median_distance, sorted(values.iter().map(|v| (v - median).abs()).collect(), 0.5));
            }
            assert!(found[5].median.is_nan() && found[5].median_distance.is_nan());
        }
    }
}
