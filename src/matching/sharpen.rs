//! Does a pattern hide a sharper one? Marks that were moved, or paint beside a point, make with true ones a loose
//! pattern that is no accident either; most of the true ones agree far more closely without them.

use crate::matching::Pattern;
use crate::matching::bar::Bar;
use crate::matching::evidence::CLOSEST_PX;
use crate::matching::far::root_mean_square;
use crate::matching::names::log10_choose;
use crate::matching::pairs::GcpPair;
use crate::matching::predictions::spread_from_pair;
use crate::matching::screening::Screening;
use crate::matching::search::{Hypothesis, REFINED_PER_PAIR, Search};
use crate::matching::settle::{FEWEST_NEAR, centre_and_spread, tolerance_px};
use autoref_solve::Similarity;
use autoref_solve::similarity::Pair;

/// Candidates that may be GCPs, the nearest to their places.
const MOST_COUPLES: usize = 64;
/// Hypotheses that are settled.
const SETTLED: usize = 4;
/// Where chance puts a candidate this often, nothing is gained by looking farther.
const CHANCE_HIT: f64 = 0.3;
/// A pattern is sharper when it is so many decades less likely an accident.
const SHARPER_LOG10: f64 = 1.0;

/// A candidate that may be a GCP.
type Couple = (usize, usize);

/// A field in which the priors allow no more hypotheses is searched whole: there a loose pattern of few may be far from
/// the sharp one.
const SEARCHED_WHOLE: f64 = 300_000.0;

/// Marks agree too closely for chance when it would produce less than one such core in so many patterns.
const CORE_LOG10: f64 = -3.0;
/// Closenesses that a core may be chosen by.
const CORE_LEVELS: f64 = 10.0;
/// The mean square of a core's distances from its middle, as a part of the whole pattern's.
const LEAST_EXTENT: f64 = 0.4;
/// Marks do not agree more closely.
const LEAST_OFF_PX: f64 = 0.1;

/// What a pair, taken as exact, tells: how surprising the hits are, the couples hit, the similarity.
type Told = (f64, Vec<Couple>, Similarity);

impl Search<'_> {
    /// The pattern that pairs of marks tell, each taken as exact, where it is less likely an accident than this one: of
    /// the marks near the places of this one, and of all marks where they are few.
    pub(super) fn sharper(&self, pattern: &Pattern, pairs: &[GcpPair], possible: f64) -> Option<Pattern> {
        let mut told = Vec::new();
        if possible <= SEARCHED_WHOLE {
            self.told_by_all(pairs, &mut told);
        } else {
            let couples = self.near_places(pattern);
            for (i, one) in couples.iter().enumerate() {
                couples[i + 1..].iter().for_each(|other| keep(&mut told, self.agreeing(&couples, *one, *other)));
            }
        }
        let settled = told.into_iter().filter_map(|(_, hit, similarity)| self.settle(similarity, hit));
        settled
            .filter(|sharper| self.possible(&sharper.similarity))
            .filter(|sharper| {
                sharper.log10_false_alarms < pattern.log10_false_alarms - SHARPER_LOG10
                    || self.log10_core_by_chance(sharper, pattern).is_some_and(|chance| chance <= CORE_LOG10)
            })
            .min_by(|s, t| s.log10_false_alarms.total_cmp(&t.log10_false_alarms))
    }

    /// Were all marks of a pattern off by its noise: how many such cores of them would agree as closely by chance,
    /// log₁₀. `None` for what is no core: half of the marks or fewer, or a cluster, which says nothing of an image that
    /// is bent.
    fn log10_core_by_chance(&self, core: &Pattern, pattern: &Pattern) -> Option<f64> {
        let of = |pattern: &Pattern| pattern.pairs.iter().map(|&(c, g)| self.pair(c, g)).collect::<Vec<Pair>>();
        let (close, loose) = (of(core), of(pattern));
        let (k, m) = (close.len() as f64, loose.len() as f64);
        let mean_square = |pairs: &[Pair]| centre_and_spread(pairs).1 / pairs.len() as f64;
        if 2.0 * k <= m || k >= m || mean_square(&close) < LEAST_EXTENT * mean_square(&loose) {
            return None;
        }
        let off_px = |pair: &Pair| {
            let p = core.similarity.invert(pair.map);
            (p.x - pair.pixel.x).hypot(p.y - pair.pixel.y)
        };
        let farthest_px = close.iter().map(off_px).fold(LEAST_OFF_PX, f64::max);
        let noise_px = root_mean_square(&pattern.similarity, &loose);
        let by_chance = -(-farthest_px * farthest_px / (2.0 * noise_px * noise_px)).exp_m1();
        // The pair that tells, the others that agree with it, and how closely.
        let choices =
            log10_choose(loose.len(), 2) + log10_choose(loose.len() - 2, close.len() - 2) + CORE_LEVELS.log10();
        Some(choices + (k - 2.0) * by_chance.log10())
    }

    fn told_by_all(&self, pairs: &[GcpPair], told: &mut Vec<Told>) {
        let points = self.field.points();
        let couples: Vec<Couple> = (0..self.gcps.len()).flat_map(|k| (0..points.len()).map(move |c| (c, k))).collect();
        let bar = || Bar::of(REFINED_PER_PAIR);
        let close = |pair| self.try_pair_within(CLOSEST_PX, pair, (Screening::EVERY_LOOK, bar()), u64::MAX).0;
        let mut best: Vec<(&GcpPair, Hypothesis)> = Vec::new();
        for pair in pairs {
            best.extend(close(pair).into_iter().map(|hypothesis| (pair, hypothesis)));
            // A stable sort: equals stay in the order of trying.
            best.sort_by(|s, t| t.1.score.total_cmp(&s.1.score));
            best.truncate(4 * SETTLED);
        }
        for (pair, hypothesis) in best {
            let (one, other) = ((hypothesis.i as usize, pair.a), (hypothesis.j as usize, pair.b));
            keep(told, self.agreeing(&couples, one, other));
        }
    }

    /// Candidates near the places of the GCPs, as far as the pattern may be wrong there.
    fn near_places(&self, pattern: &Pattern) -> Vec<Couple> {
        let fitted: Vec<Pair> = pattern.pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
        let (centre, spread) = centre_and_spread(&fitted);
        let mut couples: Vec<(f64, Couple)> = Vec::new();
        for (k, gcp) in self.gcps.iter().enumerate() {
            let place = pattern.similarity.invert(*gcp);
            let unsure_px = tolerance_px(pattern.noise_px, fitted.len(), centre, spread, place);
            let reach_px = unsure_px.max(4.0 * self.tolerance_px).min(self.chance_radius_px(CHANCE_HIT));
            self.field.around(place, reach_px, |c, p| {
                let distance_px = (p.x - place.x).hypot(p.y - place.y);
                if distance_px <= reach_px && self.allows(c, k) {
                    couples.push((distance_px / reach_px, (c, k)));
                }
            });
        }
        couples.sort_by(|s, t| s.0.total_cmp(&t.0).then(s.1.cmp(&t.1)));
        couples.truncate(MOST_COUPLES);
        let mut couples: Vec<Couple> = couples.into_iter().map(|couple| couple.1).collect();
        couples.sort_by_key(|couple| (couple.1, couple.0));
        couples
    }

    /// The couples that lie as closely as marks do where two of them, taken as exact, put them; how surprising that is,
    /// and the similarity through the two.
    fn agreeing(&self, couples: &[Couple], one: Couple, other: Couple) -> Option<Told> {
        if one.0 == other.0 || one.1 == other.1 {
            return None;
        }
        let points = self.field.points();
        let (a, b) = (self.gcps[one.1], self.gcps[other.1]);
        let similarity = Similarity::through([points[one.0], points[other.0]], [a, b])?;
        let (mut hit, mut surprise): (Vec<Couple>, f64) = (Vec::new(), 0.0);
        for &(c, k) in couples {
            let (place, p) = (similarity.invert(self.gcps[k]), points[c]);
            let radius_px = CLOSEST_PX * spread_from_pair(a, b, self.gcps[k]);
            if (p.x - place.x).hypot(p.y - place.y) <= radius_px && !hit.iter().any(|h| h.0 == c || h.1 == k) {
                hit.push((c, k));
                let area_px2 = std::f64::consts::PI * radius_px * radius_px;
                surprise -= (-(-self.field.density_at(c) * area_px2).exp_m1()).ln();
            }
        }
        Some((surprise, hit, similarity))
    }
}

/// The most surprising, each once.
fn keep(best: &mut Vec<Told>, told: Option<Told>) {
    let Some(told) = told.filter(|told| told.1.len() >= FEWEST_NEAR) else { return };
    if !best.iter().any(|known| known.1 == told.1) {
        best.push(told);
        best.sort_by(|s, t| t.0.total_cmp(&s.0));
        best.truncate(SETTLED);
    }
}
