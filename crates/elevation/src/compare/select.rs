//! Exact quantiles of many groups in two streamed passes: a histogram, then the values of the buckets that matter.

use std::collections::BTreeSet;

use crate::error::Result;
use crate::histogram::{from_order_key, order_key};
use crate::stream;
use crate::window::{TileGrid, Window};

/// Leading bits of the first pass.
const BITS: u32 = 14;
/// Different values that are held at most; beyond, a bucket is split once more and interpolated.
const MOST_VALUES: u64 = 6_000_000;
/// Bits of that split.
const SPLIT_BITS: u32 = 10;

/// What takes the values: group and value.
pub type Sink<'a> = &'a mut dyn FnMut(usize, f32);

/// How often the values were shown before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pass {
    First,
    Second,
}

/// The quantiles `shares` of each group, by linear interpolation between the neighbouring values (type 7 of R. Hyndman
/// and Y. Fan, *Sample quantiles in statistical packages*, 1996), NaN for an empty group; and the workers' states after
/// the first pass. `visit` shows all values of a window.
///
/// Exact up to six million different values in the buckets that matter, else good to 2⁻¹⁵ of the value.
pub fn quantiles<S: Send>(
    groups: usize,
    shares: &[f64],
    threads: usize,
    tiles: &TileGrid,
    state: impl Fn() -> S + Sync,
    visit: impl Fn(Pass, Window, &mut S, Sink<'_>) -> Result<()> + Sync,
) -> Result<(Vec<Vec<f64>>, Vec<S>)> {
    let parts = stream::gather(
        tiles,
        threads,
        || (vec![Vec::<u64>::new(); groups], state()),
        |(counts, state), window| {
            visit(Pass::First, window, state, &mut |group, value| {
                let own = &mut counts[group];
                if own.is_empty() {
                    own.resize(1 << BITS, 0);
                }
                own[(order_key(value) >> (32 - BITS)) as usize] += 1;
            })
        },
    )?;
    let mut counts: Vec<Vec<u64>> = vec![Vec::new(); groups];
    let mut states = Vec::new();
    for (part, state) in parts {
        states.push(state);
        for (all, own) in counts.iter_mut().zip(part) {
            if all.is_empty() {
                *all = own;
            } else {
                all.iter_mut().zip(&own).for_each(|(a, b)| *a += b);
            }
        }
    }
    let wanted: Vec<Vec<Rank>> = counts.iter().map(|own| ranks(own, shares)).collect();
    let mut held = 0;
    let mut flags = vec![Vec::new(); groups];
    for (group, list) in wanted.iter().enumerate().filter(|(_, list)| !list.is_empty()) {
        flags[group] = vec![false; 1 << BITS];
        let buckets: BTreeSet<u32> = list.iter().flat_map(Rank::buckets).collect();
        for bucket in buckets {
            flags[group][bucket as usize] = true;
            held += counts[group][bucket as usize];
        }
    }
    drop(counts);
    // Values that repeat cost nothing, but nobody knows before: all are counted.
    let drop = if held > MOST_VALUES { 32 - BITS - SPLIT_BITS } else { 0 };
    let parts = stream::gather(
        tiles,
        threads,
        || (Tally::default(), state()),
        |(tally, state), window| {
            visit(Pass::Second, window, state, &mut |group, value| {
                let key = order_key(value);
                if flags[group].get((key >> (32 - BITS)) as usize) == Some(&true) {
                    tally.add((group as u64) << 32 | u64::from(key >> drop));
                }
            })
        },
    )?;
    let sorted = Tally::merged(parts.into_iter().map(|(tally, _)| tally));
    let value_of = |key: u32| match drop {
        0 => f64::from(from_order_key(key)),
        drop => f64::from(from_order_key((key << drop) | (1 << (drop - 1)))),
    };
    let find = |group: usize, bucket: u32, within: u64| {
        let low = (group as u64) << 32 | u64::from((bucket << (32 - BITS)) >> drop);
        let high = low + (1 << (32 - BITS) >> drop);
        let begin = sorted.partition_point(|(key, _)| *key < low);
        let mut before = 0;
        for &(key, count) in sorted[begin..].iter().take_while(|(key, _)| *key < high) {
            before += count;
            if within < before {
                return value_of(key as u32);
            }
        }
        f64::NAN
    };
    let of_group = |(group, list): (usize, &Vec<Rank>)| {
        if list.is_empty() {
            return vec![f64::NAN; shares.len()];
        }
        let value = |rank: &Rank| {
            let low = find(group, rank.low.0, rank.low.1);
            let high = find(group, rank.high.0, rank.high.1);
            low + (high - low) * rank.share
        };
        list.iter().map(value).collect()
    };
    Ok((wanted.iter().enumerate().map(of_group).collect(), states))
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

/// Two neighbouring values, each as bucket and rank within it, and how far from the first to the second.
struct Rank {
    low: (u32, u64),
    high: (u32, u64),
    share: f64,
}

impl Rank {
    fn buckets(&self) -> [u32; 2] {
        [self.low.0, self.high.0]
    }
}

fn ranks(counts: &[u64], shares: &[f64]) -> Vec<Rank> {
    let total: u64 = counts.iter().sum();
    if total == 0 {
        return Vec::new();
    }
    let place = |rank: u64| {
        let mut before = 0;
        for (bucket, &count) in counts.iter().enumerate() {
            if rank < before + count {
                return (bucket as u32, rank - before);
            }
            before += count;
        }
        (0, 0)
    };
    let rank_of = |share: &f64| {
        let rank = share * (total - 1) as f64;
        let low = rank.floor() as u64;
        Rank { low: place(low), high: place((low + 1).min(total - 1)), share: rank - low as f64 }
    };
    shares.iter().map(rank_of).collect()
}
