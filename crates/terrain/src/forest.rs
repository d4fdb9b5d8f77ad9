//! A random forest of small trees on features of one byte.
//!
//! Source: L. Breiman, Random Forests, 2001, with the split chosen among a few features by Gini impurity. Where we
//! differ: samples carry whole-number weights, and all draws come from one fixed generator, so that a forest taught
//! twice with the same samples is the same. Counts are integers; nothing depends on the number of threads.

use autoref_raster::random::SplitMix64;
use rayon::prelude::*;

/// A taught pixel.
#[derive(Clone, Copy, Debug)]
pub struct Example<const N: usize> {
    pub features: [u8; N],
    pub keep: bool,
    pub weight: u32,
}

/// Size of a forest.
#[derive(Clone, Copy, Debug)]
pub struct Growth {
    pub trees: usize,
    pub depth: usize,
    /// Features that each split chooses among.
    pub tried: usize,
    /// Least number of examples in a leaf. With 60, water of photographs that did not teach is found more often than
    /// with 4: small leaves learn one frame's water by heart.
    pub leaf: usize,
}

impl Default for Growth {
    fn default() -> Self {
        Growth { trees: 40, depth: 11, tried: 7, leaf: 60 }
    }
}

#[derive(Clone, Copy)]
struct Node {
    feature: u16,
    /// At most this goes left.
    limit: u8,
    leaf: bool,
    /// The left child, the right one follows it; of a leaf the probability of keep in 65,535ths.
    next: u32,
}

struct Tree(Vec<Node>);

/// Trees that vote.
pub struct Forest<const N: usize> {
    trees: Vec<Tree>,
}

/// Uniform below `n`.
fn below(draws: &mut SplitMix64, n: usize) -> usize {
    ((u128::from(draws.next_u64()) * n as u128) >> 64) as usize
}

impl<const N: usize> Forest<N> {
    /// Grows a forest; `None` when a class has no example.
    pub fn grow(examples: &[Example<N>], growth: Growth) -> Option<Self> {
        let keeps = examples.iter().filter(|example| example.keep).count();
        if keeps == 0 || keeps == examples.len() {
            return None;
        }
        let columns = Columns::of(examples);
        let tree = |seed: usize| {
            let mut draws = SplitMix64(seed as u64 + 1);
            // Each example as often as it is drawn, times its weight.
            let mut drawn = vec![0u32; examples.len()];
            for _ in 0..examples.len() {
                drawn[below(&mut draws, examples.len())] += 1;
            }
            let mut rows: Vec<Row> = drawn
                .iter()
                .zip(examples)
                .enumerate()
                .filter(|(_, (times, _))| **times > 0)
                .map(|(i, (times, e))| Row { example: i as u32, weight: times * e.weight, keep: e.keep })
                .collect();
            let mut nodes = vec![Node { feature: 0, limit: 0, leaf: true, next: 0 }];
            split(&columns, &mut rows, 0, growth.depth, growth, &mut draws, &mut nodes);
            Tree(nodes)
        };
        Some(Forest { trees: (0..growth.trees).into_par_iter().map(tree).collect() })
    }

    /// Probability of keep, 0…255.
    pub fn keep(&self, features: &[u8; N]) -> u8 {
        let votes: u32 = self.trees.iter().map(|tree| tree.vote(features)).sum();
        let whole = 65_535 * self.trees.len() as u32;
        ((u64::from(votes) * 255 + u64::from(whole) / 2) / u64::from(whole)) as u8
    }
}

impl Tree {
    fn vote(&self, features: &[u8]) -> u32 {
        let mut node = &self.0[0];
        while !node.leaf {
            let right = usize::from(features[usize::from(node.feature)] > node.limit);
            node = &self.0[node.next as usize + right];
        }
        node.next
    }
}

/// The examples feature by feature: a node looks at few features of many examples.
struct Columns<const N: usize>([Vec<u8>; N]);

impl<const N: usize> Columns<N> {
    fn of(examples: &[Example<N>]) -> Self {
        Columns(std::array::from_fn(|feature| examples.iter().map(|example| example.features[feature]).collect()))
    }
}

/// An example that a tree was given, its weight times how often it was drawn.
#[derive(Clone, Copy)]
struct Row {
    example: u32,
    weight: u32,
    keep: bool,
}

fn split<const N: usize>(
    columns: &Columns<N>,
    rows: &mut [Row],
    at: usize,
    depth: usize,
    growth: Growth,
    draws: &mut SplitMix64,
    nodes: &mut Vec<Node>,
) {
    let mut all = [0u64; 2];
    rows.iter().for_each(|row| all[usize::from(row.keep)] += u64::from(row.weight));
    let total = all[0] + all[1];
    let best = if depth == 0 || all[0] == 0 || all[1] == 0 || rows.len() < 2 * growth.leaf {
        None
    } else {
        best_split(columns, rows, all, growth, draws)
    };
    let Some((feature, limit)) = best else {
        nodes[at] = Node { feature: 0, limit: 0, leaf: true, next: (all[1] * 65_535 / total.max(1)) as u32 };
        return;
    };
    let column = &columns.0[feature];
    let left = partition(rows, |row| column[row.example as usize] <= limit);
    let next = nodes.len();
    nodes[at] = Node { feature: feature as u16, limit, leaf: false, next: next as u32 };
    let empty = Node { feature: 0, limit: 0, leaf: true, next: 0 };
    nodes.extend([empty, empty]);
    let (low, high) = rows.split_at_mut(left);
    split(columns, low, next, depth - 1, growth, draws, nodes);
    split(columns, high, next + 1, depth - 1, growth, draws, nodes);
}

/// Those that `goes_left` come first, in their order; how many they are.
fn partition<T: Copy>(rows: &mut [T], goes_left: impl Fn(&T) -> bool) -> usize {
    let (left, right): (Vec<T>, Vec<T>) = rows.iter().partition(|row| goes_left(row));
    rows[..left.len()].copy_from_slice(&left);
    rows[left.len()..].copy_from_slice(&right);
    left.len()
}

fn best_split<const N: usize>(
    columns: &Columns<N>,
    rows: &[Row],
    all: [u64; 2],
    growth: Growth,
    draws: &mut SplitMix64,
) -> Option<(usize, u8)> {
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    let mut best: Option<(f64, usize, u8)> = None;
    for tried in 0..growth.tried.min(N) {
        order.swap(tried, tried + below(draws, N - tried));
        let feature = order[tried];
        let (mut weights, mut counts) = ([[0u64; 2]; 256], [0usize; 256]);
        let column = &columns.0[feature];
        for row in rows {
            let value = usize::from(column[row.example as usize]);
            weights[value][usize::from(row.keep)] += u64::from(row.weight);
            counts[value] += 1;
        }
        let (mut low, mut count) = ([0u64; 2], 0);
        for limit in 0..255usize {
            low = [low[0] + weights[limit][0], low[1] + weights[limit][1]];
            count += counts[limit];
            if counts[limit] == 0 || count < growth.leaf || rows.len() - count < growth.leaf {
                continue;
            }
            let high = [all[0] - low[0], all[1] - low[1]];
            let purity = |side: [u64; 2]| {
                let [a, b] = side.map(|v| v as f64);
                (a * a + b * b) / (a + b).max(1.0)
            };
            let score = purity(low) + purity(high);
            if best.is_none_or(|(top, ..)| score > top) {
                best = Some((score, feature, limit as u8));
            }
        }
    }
    let [a, b] = all.map(|v| v as f64);
    let (score, feature, limit) = best?;
    (score > (a * a + b * b) / (a + b) * (1.0 + 1e-12)).then_some((feature, limit))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn examples(seed: u64, n: usize) -> Vec<Example<5>> {
        let mut draws = SplitMix64(seed);
        let one = |_| {
            let features: [u8; 5] = std::array::from_fn(|_| draws.next_u64() as u8);
            let keep = (u32::from(features[0]) + u32::from(features[3]) > 256) ^ (features[4] < 40);
            Example { features, keep, weight: 1 }
        };
        (0..n).map(one).collect()
    }

    #[test]
    fn it_learns_what_no_single_feature_tells() {
        let growth = Growth { tried: 3, leaf: 4, ..Growth::default() };
        let forest = Forest::grow(&examples(7, 4000), growth).expect("two classes");
        let unseen = examples(8, 1000);
        let right = unseen.iter().filter(|e| (forest.keep(&e.features) > 127) == e.keep).count();
        assert!(right > 900, "{right} of 1000");
        let again = Forest::grow(&examples(7, 4000), growth).expect("two classes");
        assert!(unseen.iter().all(|e| again.keep(&e.features) == forest.keep(&e.features)));
    }

    #[test]
    fn one_class_grows_nothing() {
        let mut examples = examples(3, 50);
        examples.iter_mut().for_each(|e| e.keep = true);
        assert!(Forest::grow(&examples, Growth::default()).is_none());
    }
}
