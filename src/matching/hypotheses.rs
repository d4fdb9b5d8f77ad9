//! The most surprising hypotheses about pairs of GCPs: all are tried, or as many as a budget allows.

use std::cell::OnceCell;

use rayon::prelude::*;

use crate::matching::bar::Bar;
use crate::matching::looks::Looking;
use crate::matching::pairs::GcpPair;
use crate::matching::search::{
    Demand, Hypothesis, LOOKS_OF_ONE, MOST_DEMANDED, REFINED_PER_PAIR, Search, Tried, keep_best,
};
use crate::matching::targets::Targets;
use autoref_raster::coords::PixelPoint;

/// From so many hypotheses on, the points of a pair are shared out: waking a thread takes as long as some hundreds of
/// them.
const WORTH_THREADS: u64 = 10_000;
/// Where a first end has fewer second ends, hypotheses with different first ends are looked at together.
const FEW_ENDS: usize = 16;

impl Search<'_> {
    /// The most surprising hypotheses about one pair of GCPs, best first, and what was tried: all, or from evenly
    /// chosen points about as many as `budget` allows. In a crowd a single pair can have billions. For `first_looks`
    /// see [`crate::matching::screening::Screening`].
    pub fn try_pair(&self, pair: &GcpPair, first_looks: usize, budget: u64) -> (Vec<Hypothesis>, Tried) {
        self.try_pair_within(self.tolerance_px, pair, (first_looks, Bar::of(REFINED_PER_PAIR)), budget)
    }

    /// The same of each pair, without what stays below a bar.
    pub fn try_pairs(&self, pairs: &[GcpPair], looks: (usize, &Bar<'_>), budget: u64) -> Vec<(Vec<Hypothesis>, Tried)> {
        match pairs {
            [pair] => vec![self.try_pair_above(pair, looks, pair.worth(budget))],
            pairs => pairs.par_iter().map(|pair| self.try_pair_above(pair, looks, u64::MAX)).collect(),
        }
    }

    fn try_pair_above(
        &self,
        pair: &GcpPair,
        (first_looks, above): (usize, &Bar<'_>),
        budget: u64,
    ) -> (Vec<Hypothesis>, Tried) {
        self.try_pair_within(self.tolerance_px, pair, (first_looks, Bar::under(above, REFINED_PER_PAIR)), budget)
    }

    /// The same with a tolerance for the error of one mark, pixels, and a bar of the pair's own.
    pub fn try_pair_within(
        &self,
        tolerance_px: f64,
        pair: &GcpPair,
        (first_looks, bar): (usize, Bar<'_>),
        budget: u64,
    ) -> (Vec<Hypothesis>, Tried) {
        let targets = self.targets(pair, tolerance_px, first_looks.max(MOST_DEMANDED));
        let fewest = self.fewest_hits(&targets, tolerance_px);
        if targets.len() < fewest {
            return (Vec::new(), Tried::default());
        }
        let demand = Demand { fewest, first_looks };
        if pair.cost < (FEW_ENDS * self.field.points().len()) as f64 && pair.hypotheses() <= budget {
            let mut looking = Looking::new(self, pair, (demand, &bar));
            self.all_ends(pair, |ends| looking.take(&targets, ends));
            return looking.best(&targets);
        }
        let per_point = |i: usize| self.try_point(pair, &targets, (demand, &bar), i);
        self.over_chosen_points(pair, budget, per_point, keep_best)
    }

    /// The best of what `each` finds with points at the first end of a pair, and how many hypotheses it tried: with all
    /// points, or evenly chosen with about as many as the budget of hypotheses allows. They are joined in any order:
    /// `keep_best` must go by a total one.
    pub fn over_chosen_points<T: Send>(
        &self,
        pair: &GcpPair,
        budget: u64,
        each: impl Fn(usize) -> (Vec<T>, Tried) + Send + Sync,
        keep_best: fn(&mut Vec<T>),
    ) -> (Vec<T>, Tried) {
        let points = self.field.points().len();
        let affordable = (budget as f64 / pair.cost.max(1.0) * points as f64).min(points as f64) as usize;
        let chosen = |k: usize| each(k * points / affordable);
        let join = |(mut one, n): (Vec<T>, Tried), (other, m): (Vec<T>, Tried)| {
            one.extend(other);
            keep_best(&mut one);
            (one, n + m)
        };
        let looks = 1 + self.gcps.len() as u64 / LOOKS_OF_ONE;
        if pair.hypotheses().min(budget) * looks < WORTH_THREADS {
            return (0..affordable).map(chosen).fold((Vec::new(), Tried::default()), join);
        }
        (0..affordable).into_par_iter().map(chosen).reduce(|| (Vec::new(), Tried::default()), join)
    }

    /// The same with no other points than these at the two ends of the pair, and without what stays below a bar.
    pub fn try_pair_among(
        &self,
        pair: &GcpPair,
        points: &[usize],
        (first_looks, above): (usize, &Bar<'_>),
    ) -> (Vec<Hypothesis>, Tried) {
        let targets = self.targets(pair, self.tolerance_px, first_looks.max(MOST_DEMANDED));
        let demand = Demand { fewest: self.fewest_hits(&targets, self.tolerance_px), first_looks };
        if targets.len() < demand.fewest {
            return (Vec::new(), Tried::default());
        }
        let bar = Bar::under(above, REFINED_PER_PAIR);
        let mut looking = Looking::new(self, pair, (demand, &bar));
        for &i in points.iter().filter(|i| self.allows(**i, pair.a)) {
            let from = self.field.points()[i];
            let ends = points
                .iter()
                .filter(|&&j| j != i && self.allows(j, pair.b) && self.may_span(pair, from, self.field.points()[j]));
            ends.for_each(|&j| looking.take(&targets, (i, j)));
        }
        looking.best(&targets)
    }

    fn try_point(
        &self,
        pair: &GcpPair,
        targets: &Targets<'_>,
        (demand, bar): (Demand, &Bar<'_>),
        i: usize,
    ) -> (Vec<Hypothesis>, Tried) {
        if !self.allows(i, pair.a) {
            return (Vec::new(), Tried::default());
        }
        let from = self.field.points()[i];
        // Most points have no second end at all.
        let in_reach = OnceCell::new();
        let mut looking = None;
        let (left, right, up, down) = self.sector(pair);
        self.field.in_box((from.x + left, from.x + right), (from.y + up, from.y + down), |j, to| {
            if i == j || !self.allows(j, pair.b) || !self.may_span(pair, from, to) {
                return;
            }
            let fewer = in_reach.get_or_init(|| self.in_reach(pair, targets, from));
            let targets = fewer.as_ref().unwrap_or(targets);
            if targets.len() < demand.fewest {
                return;
            }
            looking.get_or_insert_with(|| Looking::new(self, pair, (demand, bar))).take(targets, (i, j));
        });
        let Some(looking) = looking else { return Default::default() };
        looking.best(in_reach.get().and_then(Option::as_ref).unwrap_or(targets))
    }

    /// The targets that can be in the field at all when `a` is at `from`, whatever the rotation: at the finest scale
    /// they must not lie beyond the farthest corner. `None` where all can.
    fn in_reach<'t>(&self, pair: &GcpPair, targets: &Targets<'t>, from: PixelPoint) -> Option<Targets<'t>> {
        let origin = self.field.origin();
        let (right, bottom) = (origin.x + self.field.width_px, origin.y + self.field.height_px);
        let farthest = (from.x - origin.x).max(right - from.x).hypot((from.y - origin.y).max(bottom - from.y));
        // A hair more, so that rounding decides nothing.
        let farthest_m = farthest * pair.length_m / pair.reach_px.0 * (1.0 + 1e-9);
        targets.only(|t| t.east * t.east + t.north * t.north <= farthest_m * farthest_m)
    }
}
