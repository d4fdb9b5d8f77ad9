//! Pairs of GCPs: how many hypotheses each allows, and in what order they are tried.

use crate::matching::Priors;
use crate::matching::draws::Draws;
use crate::matching::field::Field;
use autoref_raster::coords::{MapPoint, PixelPoint};

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

/// The pairs of GCPs in the order of trying, at most [`MOST_PAIRS`], and the number of hypotheses that the priors allow
/// with all.
pub(super) fn gcp_pairs(field: &Field, gcps: &[MapPoint], priors: &Priors) -> (Vec<GcpPair>, f64) {
    let diagonal = field.width_px.hypot(field.height_px);
    let distances = sampled_distances(field.points());
    let share_below = |d: f64| distances.partition_point(|&x| x <= d) as f64 / distances.len() as f64;
    let n = field.points().len() as f64;
    let turn = priors.rotation_deg.map_or(1.0, |(_, half)| (2.0 * half / 360.0).min(1.0));
    let (finest, coarsest) = priors.gsd_m_per_px.unwrap_or((0.0, f64::INFINITY));
    let mut pairs = Vec::new();
    let mut possible = 0.0;
    for a in 0..gcps.len() {
        for b in a + 1..gcps.len() {
            let length_m = (gcps[a].easting - gcps[b].easting).hypot(gcps[a].northing - gcps[b].northing);
            let reach_px = ((length_m / coarsest).max(SMALLEST_BASE_PX), (length_m / finest).min(diagonal));
            if length_m <= 0.0 || reach_px.0 >= reach_px.1 {
                continue;
            }
            // At least a few, where the sample says none.
            let share = (share_below(reach_px.1) - share_below(reach_px.0)).max(1.0 / distances.len() as f64);
            let cost = n * (n - 1.0) * share * turn;
            possible += cost;
            pairs.push(GcpPair { a, b, length_m, reach_px, cost });
            if pairs.len() >= 2 * MOST_PAIRS {
                pairs.select_nth_unstable_by(MOST_PAIRS, |p, q| in_turn(p, q, priors));
                pairs.truncate(MOST_PAIRS);
            }
        }
    }
    pairs.sort_unstable_by(|p, q| in_turn(p, q, priors));
    pairs.truncate(MOST_PAIRS);
    (pairs, possible)
}

/// Which pair is tried first.
fn in_turn(p: &GcpPair, q: &GcpPair, priors: &Priors) -> std::cmp::Ordering {
    if priors.narrow_by_scale() {
        return p.cost.total_cmp(&q.cost).then((p.a, p.b).cmp(&(q.a, q.b)));
    }
    // Every pair costs about the same: a fixed shuffle keeps one bad point from spoiling the start.
    let shuffled = |p: &GcpPair| ((p.a * 7919 + p.b) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    shuffled(p).cmp(&shuffled(q)).then((p.a, p.b).cmp(&(q.a, q.b)))
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
        let mut draws = Draws::new(0x2545_F491_4F6C_DD1D);
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
