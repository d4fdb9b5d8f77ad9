//! Pairs of GCPs: how many hypotheses each allows, and in what order they are tried.

use rayon::prelude::*;

use crate::matching::Priors;
use crate::matching::field::Field;
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_raster::random::Mmix;

/// Marks of a hypothesis closer together than this say nothing about scale and rotation.
const SMALLEST_BASE_PX: f64 = 16.0;
/// A budget that is enough for less than this share of a pair's hypotheses is spent in part only.
const LEAST_SHARE: f64 = 0.1;

/// GCPs a and b and what a hypothesis about them predicts.
pub(super) struct GcpPair {
    pub a: usize,
    pub b: usize,
    pub length_m: f64,
    /// Pixel distances that the scale allows.
    pub reach_px: (f64, f64),
    /// Pairs of candidates that can be this one.
    pub cost: f64,
}

impl GcpPair {
    /// About as many hypotheses as trying it takes.
    pub fn hypotheses(&self) -> u64 {
        self.cost as u64
    }

    /// What is spent of a budget of hypotheses on this pair: all, or less where even all would look at so few of them
    /// that the true one is hardly among them.
    pub fn worth(&self, budget: u64) -> u64 {
        let share = budget as f64 / self.cost.max(1.0);
        (budget as f64 * (share / LEAST_SHARE).min(1.0)) as u64
    }
}

/// The pairs of GCPs that a search holds: of long lists those that come first.
const MOST_PAIRS: usize = 200_000;
/// First ends whose pairs are laid out together.
const FIRSTS_TOGETHER: usize = 128;

/// A pair of GCPs by its place in the order of trying, least first.
type InTurn = (u64, u32, u32);

/// The pairs of GCPs in the order of trying, at most [`MOST_PAIRS`], and the number of hypotheses that the priors allow
/// with all.
pub(super) fn gcp_pairs(field: &Field, gcps: &[MapPoint], priors: &Priors) -> (Vec<GcpPair>, f64) {
    let allowed = Allowed::of(field, priors);
    let by_cost = priors.narrow_by_scale();
    let of_first = |a: usize, last: InTurn| {
        let pairs = (a + 1..gcps.len()).filter_map(|b| allowed.pair(gcps, (a, b)));
        let in_turn = |pair: &GcpPair| {
            // Bits of positive numbers are in the order of the numbers. Where every pair costs about the same, a fixed
            // shuffle keeps one bad point from spoiling the start.
            let key = match by_cost {
                true => pair.cost.to_bits(),
                false => ((pair.a * 7919 + pair.b) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15),
            };
            ((key, pair.a as u32, pair.b as u32), pair.cost)
        };
        let (mut possible, mut order): (f64, Vec<InTurn>) = (0.0, Vec::new());
        for (in_turn, cost) in pairs.map(|pair| in_turn(&pair)) {
            possible += cost;
            order.extend((in_turn < last).then_some(in_turn));
        }
        (possible, order)
    };
    let (mut order, mut possible): (Vec<InTurn>, f64) = (Vec::new(), 0.0);
    // What comes after the last of those that are held is not held.
    let mut last = (u64::MAX, u32::MAX, u32::MAX);
    for some in (0..gcps.len()).collect::<Vec<_>>().chunks(FIRSTS_TOGETHER) {
        let pairs: Vec<(f64, Vec<InTurn>)> = some.par_iter().map(|a| of_first(*a, last)).collect();
        for (of_first, in_turn) in pairs {
            possible += of_first;
            order.extend(in_turn);
        }
        if order.len() > MOST_PAIRS {
            last = *order.select_nth_unstable(MOST_PAIRS).1;
            order.truncate(MOST_PAIRS);
        }
    }
    order.par_sort_unstable();
    let pair = |&(_, a, b): &InTurn| allowed.pair(gcps, (a as usize, b as usize)).expect("it was allowed before");
    (order.par_iter().map(pair).collect(), possible)
}

/// Which pairs of GCPs the priors allow in a field, and what they cost.
struct Allowed {
    diagonal_px: f64,
    finest: f64,
    coarsest: f64,
    /// Ordered pairs of points.
    point_pairs: f64,
    /// The share of them that the direction of north allows.
    turn: f64,
    distances: Sorted,
}

impl Allowed {
    fn of(field: &Field, priors: &Priors) -> Allowed {
        let n = field.points().len() as f64;
        let turn = priors.rotation_deg.map_or(1.0, |(_, half)| (2.0 * half / 360.0).min(1.0));
        let (finest, coarsest) = priors.gsd_m_per_px.unwrap_or((0.0, f64::INFINITY));
        let diagonal_px = field.width_px.hypot(field.height_px);
        Allowed {
            diagonal_px,
            finest,
            coarsest,
            point_pairs: n * (n - 1.0),
            turn,
            distances: Sorted::of(sampled_distances(field.points())),
        }
    }

    fn pair(&self, gcps: &[MapPoint], (a, b): (usize, usize)) -> Option<GcpPair> {
        let (east, north) = (gcps[a].easting - gcps[b].easting, gcps[a].northing - gcps[b].northing);
        // Two million times of a long list, where `hypot` takes three times as long.
        let length_m = (east * east + north * north).sqrt();
        let reach_px =
            ((length_m / self.coarsest).max(SMALLEST_BASE_PX), (length_m / self.finest).min(self.diagonal_px));
        if length_m <= 0.0 || reach_px.0 >= reach_px.1 {
            return None;
        }
        let sampled = self.distances.values.len() as f64;
        let share_below = |d: f64| self.distances.up_to(d) as f64 / sampled;
        // At least a few, where the sample says none.
        let share = (share_below(reach_px.1) - share_below(reach_px.0)).max(1.0 / sampled);
        Some(GcpPair { a, b, length_m, reach_px, cost: self.point_pairs * share * self.turn })
    }
}

/// Numbers from zero on in their order, with where each of many equal steps begins: two million pairs of a long list
/// are asked for twice each.
struct Sorted {
    values: Vec<f64>,
    steps_per_unit: f64,
    /// How many values lie before each step, and how many there are.
    before: Vec<u32>,
}

impl Sorted {
    const VALUES_PER_STEP: usize = 4;
    const FEW: usize = 16;

    fn of(values: Vec<f64>) -> Sorted {
        let steps = values.len() / Self::VALUES_PER_STEP + 1;
        let largest = values.last().copied().unwrap_or(0.0);
        let steps_per_unit = if largest > 0.0 { steps as f64 / largest } else { 0.0 };
        let mut sorted = Sorted { values, steps_per_unit, before: vec![0; steps + 1] };
        for at in 0..sorted.values.len() {
            let step = sorted.step(sorted.values[at]);
            sorted.before[step + 1] += 1;
        }
        for step in 1..sorted.before.len() {
            sorted.before[step] += sorted.before[step - 1];
        }
        sorted
    }

    /// Grows with the value, so that what lies in a lower step is smaller.
    fn step(&self, value: f64) -> usize {
        ((value * self.steps_per_unit) as usize).min(self.before.len() - 2)
    }

    /// How many values are no larger.
    fn up_to(&self, value: f64) -> usize {
        let step = self.step(value);
        let (from, to) = (self.before[step] as usize, self.before[step + 1] as usize);
        let step = &self.values[from..to];
        // A few are counted sooner than halved.
        match step.len() {
            ..=Self::FEW => from + step.iter().filter(|x| **x <= value).count(),
            _ => from + step.partition_point(|x| *x <= value),
        }
    }
}

/// Sorted distances of pairs of points: all of few, a fixed sample of many.
fn sampled_distances(points: &[PixelPoint]) -> Vec<f64> {
    let distance = |i: usize, j: usize| (points[i].x - points[j].x).hypot(points[i].y - points[j].y);
    let n = points.len();
    let mut distances = Vec::new();
    if n <= 400 {
        for i in 0..n {
            distances.extend((i + 1..n).map(|j| distance(i, j)));
        }
    } else {
        let mut draws = Mmix(0x2545_F491_4F6C_DD1D);
        while distances.len() < 100_000 {
            let (i, j) = (draws.below(n), draws.below(n));
            if i != j {
                distances.push(distance(i, j));
            }
        }
    }
    distances.sort_unstable_by(f64::total_cmp);
    distances
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn values_are_counted_as_one_by_one(
            mut values in prop::collection::vec(0.0..500.0f64, 0..200), clump in prop::collection::vec(99.9..100.1f64, 0..200),
            asked in prop::collection::vec(-1.0..600.0f64, 1..50),
        ) {
            values.extend(clump);
            values.sort_unstable_by(f64::total_cmp);
            let sorted = Sorted::of(values.clone());
            for value in asked.into_iter().chain(values.clone()).chain([f64::INFINITY, 0.0]) {
                prop_assert_eq!(sorted.up_to(value), values.iter().filter(|x| **x <= value).count());
            }
        }
    }
}
