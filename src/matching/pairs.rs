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
    let of_first = |a: usize| {
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
        pairs.map(|pair| in_turn(&pair)).collect::<Vec<(InTurn, f64)>>()
    };
    let (mut order, mut possible): (Vec<InTurn>, f64) = (Vec::new(), 0.0);
    for some in (0..gcps.len()).collect::<Vec<_>>().chunks(FIRSTS_TOGETHER) {
        let pairs: Vec<Vec<(InTurn, f64)>> = some.par_iter().map(|a| of_first(*a)).collect();
        for (in_turn, cost) in pairs.into_iter().flatten() {
            possible += cost;
            order.push(in_turn);
        }
        if order.len() > MOST_PAIRS {
            order.select_nth_unstable(MOST_PAIRS);
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
    distances: Vec<f64>,
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
            distances: sampled_distances(field.points()),
        }
    }

    fn pair(&self, gcps: &[MapPoint], (a, b): (usize, usize)) -> Option<GcpPair> {
        let length_m = (gcps[a].easting - gcps[b].easting).hypot(gcps[a].northing - gcps[b].northing);
        let reach_px =
            ((length_m / self.coarsest).max(SMALLEST_BASE_PX), (length_m / self.finest).min(self.diagonal_px));
        if length_m <= 0.0 || reach_px.0 >= reach_px.1 {
            return None;
        }
        let sampled = self.distances.len() as f64;
        let share_below = |d: f64| self.distances.partition_point(|&x| x <= d) as f64 / sampled;
        // At least a few, where the sample says none.
        let share = (share_below(reach_px.1) - share_below(reach_px.0)).max(1.0 / sampled);
        Some(GcpPair { a, b, length_m, reach_px, cost: self.point_pairs * share * self.turn })
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
    distances.sort_by(f64::total_cmp);
    distances
}
