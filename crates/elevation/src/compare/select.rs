//! Exact quantiles of many groups in two streamed passes: a histogram, then the values of the buckets that matter.

use std::collections::HashMap;

use crate::error::Result;
use crate::histogram::{from_order_key, order_key};
use crate::stream;
use crate::window::{TileGrid, Window};

use super::Buffers;

/// Leading bits of the first pass.
const BITS: u32 = 14;
/// Different values that are held at most; beyond, a bucket is split once more and interpolated.
const MOST_VALUES: u64 = 6_000_000;
/// Bits of that split.
const SPLIT_BITS: u32 = 10;

/// What takes the values: group and value.
pub type Sink<'a> = &'a mut dyn FnMut(usize, f32);

/// The quantiles `shares` of each group, by linear interpolation between the neighbouring values (type 7 of R. Hyndman and
/// Y. Fan, *Sample quantiles in statistical packages*, 1996); NaN for an empty group. `visit` shows all values of a window.
///
/// Exact up to six million different values in the buckets that matter, else good to 2⁻¹⁵ of the value.
pub fn quantiles(
    groups: usize,
    shares: &[f64],
    threads: usize,
    tiles: &TileGrid,
    visit: impl Fn(Window, &mut Buffers, Sink<'_>) -> Result<()> + Sync,
) -> Result<Vec<Vec<f64>>> {
    let parts = stream::gather(
        tiles,
        threads,
        || (HashMap::<usize, Vec<u64>>::new(), Buffers::default()),
        |(counts, buffers), window| {
            visit(window, buffers, &mut |group, value| {
                let own = counts.entry(group).or_insert_with(|| vec![0; 1 << BITS]);
                own[(order_key(value) >> (32 - BITS)) as usize] += 1;
            })
        },
    )?;
    let mut counts: Vec<Vec<u64>> = vec![Vec::new(); groups];
    for (part, _) in parts {
        for (group, own) in part {
            if counts[group].is_empty() {
                counts[group] = own;
            } else {
                counts[group].iter_mut().zip(&own).for_each(|(a, b)| *a += b);
            }
        }
    }
    let wanted: Vec<Vec<Rank>> = counts.iter().map(|own| ranks(own, shares)).collect();
    let mut held = 0;
    let mut buckets: HashMap<(usize, u32), u64> = HashMap::new();
    for (group, list) in wanted.iter().enumerate() {
        for bucket in list.iter().flat_map(Rank::buckets) {
            if buckets.insert((group, bucket), counts[group][bucket as usize]).is_none() {
                held += counts[group][bucket as usize];
            }
        }
    }
    // Values that repeat cost nothing, but nobody knows before: all are counted.
    let drop = if held > MOST_VALUES { 32 - BITS - SPLIT_BITS } else { 0 };
    let mut flags = vec![Vec::new(); groups];
    for &(group, bucket) in buckets.keys() {
        if flags[group].is_empty() {
            flags[group] = vec![false; 1 << BITS];
        }
        flags[group][bucket as usize] = true;
    }
    let parts = stream::gather(
        tiles,
        threads,
        || (HashMap::<(usize, u32), u64>::new(), Buffers::default()),
        |(values, buffers), window| {
            visit(window, buffers, &mut |group, value| {
                let key = order_key(value);
                if flags[group].get((key >> (32 - BITS)) as usize) == Some(&true) {
                    *values.entry((group, key >> drop)).or_default() += 1;
                }
            })
        },
    )?;
    let mut sorted: Vec<std::collections::BTreeMap<u32, u64>> = vec![Default::default(); groups];
    for (part, _) in parts {
        for ((group, key), count) in part {
            *sorted[group].entry(key).or_default() += count;
        }
    }
    let value_of = |key: u32| match drop {
        0 => f64::from(from_order_key(key)),
        drop => f64::from(from_order_key((key << drop) | (1 << (drop - 1)))),
    };
    let find = |group: usize, bucket: u32, within: u64| {
        let (low, high) = ((bucket << (32 - BITS)) >> drop, ((u64::from(bucket) + 1) << (32 - BITS) >> drop));
        let mut before = 0;
        for (&key, &count) in sorted[group].range(low..).take_while(|(key, _)| u64::from(**key) < high) {
            before += count;
            if within < before {
                return value_of(key);
            }
        }
        f64::NAN
    };
    Ok(wanted
        .iter()
        .enumerate()
        .map(|(group, list)| match list.is_empty() {
            true => vec![f64::NAN; shares.len()],
            false => list
                .iter()
                .map(|rank| {
                    let low = find(group, rank.low.0, rank.low.1);
                    let high = find(group, rank.high.0, rank.high.1);
                    low + (high - low) * rank.share
                })
                .collect(),
        })
        .collect())
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
