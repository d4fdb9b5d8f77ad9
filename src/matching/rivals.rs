//! Before a pattern is believed: does another one explain the same marks, or lay the same GCPs on other marks?
//!
//! The search ends with the first pattern that is rare enough. The number of false alarms guards it against chance, not
//! against repetition: a list may hold the same figure twice, an image may show it twice, and the pair of GCPs that
//! found the first need not belong to the second. Both questions are asked of few points, so that they cost little.

use rayon::prelude::*;

use crate::matching::Pattern;
use crate::matching::bar::Bar;
use crate::matching::pairs::GcpPair;
use crate::matching::repetition::{Repetition, Way};
use crate::matching::robust::{REPETITION_LOG10, RUNNER_UP_GAP};
use crate::matching::screening::Screening;
use crate::matching::search::{Hypothesis, Search, Tried};
use crate::matching::settle::FEWEST_NEAR;
use autoref_raster::random::mix;
use autoref_solve::Similarity;

/// Hypotheses that are refined for each of the two questions.
const REFINED: usize = 12;
/// Hypotheses about the pattern's own GCPs that are tried in any case; half as many as the search took when that is
/// more.
const FEWEST_TRIED: u64 = 200_000;
/// How often a pattern is moved in a list that repeats itself: where the whole list lies in a few pixels, many steps
/// are no other place.
const MOST_MOVES: usize = 32;
/// Marks of the pattern at the two ends of a hypothesis of the first question. A rival that speaks against a pattern
/// explains half of its marks at least; of so many, drawn at random, fewer than two are among these in one case of
/// 600,000 (25 · 2⁻²⁴).
const MOST_MARKS: usize = 24;
/// Pairs of GCPs between which it is asked whether a rival has been found: all of a short list.
const PAIRS_TOGETHER: usize = 2000;
/// Looks that all pairs of GCPs may cost with so few marks. Of a long list pairs drawn at random are tried with all
/// marks where that is shorter, ...
const MOST_LOOKS: u64 = 50_000_000;
/// ... as many as miss a rival of half of the marks in one case of so many.
const RIVAL_MISSED: f64 = 1e-5;

impl Search<'_> {
    /// The most likely rivals of `pattern`, and the number of hypotheses tried. `tried` of the `pairs` have been looked
    /// at by the search, for the work of so many hypotheses with every look.
    pub fn rivals(&self, pattern: &Pattern, pairs: &[GcpPair], tried: (usize, u64)) -> (Vec<Pattern>, u64) {
        let moved = self.moved_on(pattern);
        if moved.iter().any(|rival| self.is_reason_enough(rival, pattern)) {
            return (moved, 0);
        }
        let (mut rivals, few) = self.on_the_same_marks(pattern, pairs);
        let (others, many) = self.of_the_same_gcps(pattern, &pairs[tried.0..], (tried.1 / 2).max(FEWEST_TRIED));
        rivals.extend(others);
        (rivals, few + many)
    }

    /// The pattern moved on and back in a list that repeats itself, until it says something else.
    fn moved_on(&self, pattern: &Pattern) -> Vec<Pattern> {
        let Some(repetition) = Repetition::of(self.gcps, self.priors) else { return Vec::new() };
        let other = |pairs: &Vec<(usize, usize)>| {
            let is_allowed = pairs.iter().all(|&(candidate, gcp)| self.allows(candidate, gcp));
            let rival = is_allowed.then(|| self.weighed(pairs.clone())).flatten()?;
            (self.possible(&rival.similarity) && !self.same_claim(&rival, pattern)).then_some(rival)
        };
        let by = |way: Way| {
            let next = |pairs: &Vec<(usize, usize)>| Some(repetition.moved(pairs, way));
            let moves = std::iter::successors(next(&pattern.pairs), next).take(MOST_MOVES);
            moves.take_while(|pairs| pairs.len() >= FEWEST_NEAR).find_map(|pairs| other(&pairs))
        };
        [Way::On, Way::Back].into_iter().filter_map(by).collect()
    }

    /// Other GCPs laid on the marks of the pattern.
    fn on_the_same_marks(&self, pattern: &Pattern, pairs: &[GcpPair]) -> (Vec<Pattern>, u64) {
        let mut marks: Vec<usize> = pattern.pairs.iter().map(|pair| pair.0).collect();
        let few = marks.len().min(MOST_MARKS);
        let cost = |pairs: usize, marks: usize| (pairs * marks * marks) as u64;
        let mut first_looks = Screening::EVERY_LOOK;
        if cost(pairs.len(), few) * self.gcps.len() as u64 > MOST_LOOKS {
            let others = self.gcps.len() - 2;
            let half = marks.len().div_ceil(2);
            let hits = half.saturating_sub(2).max(1);
            let screening = Screening::shortest(hits, others, pairs.len(), RIVAL_MISSED);
            if cost(screening.pairs, marks.len()) < cost(pairs.len(), few) {
                let mut drawn: Vec<&GcpPair> = pairs.iter().collect();
                drawn.sort_by_cached_key(|pair| mix(((pair.a as u64) << 32) + pair.b as u64));
                drawn.truncate(screening.pairs);
                return self.laid_on(&marks, drawn, screening.first_looks, pattern);
            }
            // Of a rival's marks those among the few that are tried; half of them, where these are drawn.
            let tried = if marks.len() > few { few / 4 } else { half };
            first_looks = Screening::of_all_pairs(hits, others, tried * (tried - 1) / 2, RIVAL_MISSED);
        }
        if marks.len() > few {
            marks.sort_by_cached_key(|&mark| mix(mark as u64));
            marks.truncate(few);
        }
        self.laid_on(&marks, pairs.iter().collect(), first_looks, pattern)
    }

    /// Ends with the first rival that is reason enough: a long list that fits everywhere has thousands.
    fn laid_on<'p>(
        &self,
        marks: &[usize],
        pairs: Vec<&'p GcpPair>,
        first_looks: usize,
        pattern: &Pattern,
    ) -> (Vec<Pattern>, u64) {
        let (mut rivals, mut tried) = (Vec::new(), 0);
        for pairs in pairs.chunks(PAIRS_TOGETHER) {
            let bar = Bar::of(REFINED);
            let among = |pair: &&'p GcpPair| {
                let (found, tried) = self.try_pair_among(pair, marks, (first_looks, &bar));
                found.iter().filter(|h| !self.says(&pattern.similarity, pair, h)).for_each(|h| bar.raise(h.score));
                (*pair, (found, tried))
            };
            let found: Vec<_> = pairs.par_iter().map(among).collect();
            let (more, n) = self.refined(pattern, found.into_iter());
            tried += n;
            rivals.extend(more);
            if rivals.iter().any(|rival| self.is_reason_enough(rival, pattern)) {
                break;
            }
        }
        (rivals, tried)
    }

    /// Whether a rival alone is reason enough to believe neither: something repeats, nearly as unlikely an accident.
    fn is_reason_enough(&self, rival: &Pattern, pattern: &Pattern) -> bool {
        let log10 = pattern.log10_false_alarms;
        let is_near = |rival_log10: f64| rival_log10 <= REPETITION_LOG10 && rival_log10 - log10 < RUNNER_UP_GAP;
        is_near(rival.log10_false_alarms)
            && !self.same_claim(rival, pattern)
            && is_near(self.apart_from(pattern, rival.clone()).log10_false_alarms)
    }

    /// The GCPs of the pattern laid on other marks, by pairs of GCPs that the search has not come to.
    fn of_the_same_gcps(&self, pattern: &Pattern, untried: &[GcpPair], budget: u64) -> (Vec<Pattern>, u64) {
        let joined = |gcp: usize| pattern.pairs.iter().any(|pair| pair.1 == gcp);
        let own = untried.iter().filter(|pair| joined(pair.a) && joined(pair.b));
        let mut spent = 0;
        let affordable: Vec<&GcpPair> = own
            .take_while(|pair| {
                spent += pair.hypotheses();
                spent <= budget
            })
            .collect();
        let found: Vec<_> =
            affordable.into_par_iter().map(|pair| (pair, self.try_pair(pair, Screening::EVERY_LOOK, budget))).collect();
        self.refined(pattern, found.into_iter())
    }

    fn refined<'p>(
        &self,
        pattern: &Pattern,
        found: impl Iterator<Item = (&'p GcpPair, (Vec<Hypothesis>, Tried))>,
    ) -> (Vec<Pattern>, u64) {
        let mut tried = 0;
        let mut best: Vec<(&GcpPair, Hypothesis)> = Vec::new();
        for (pair, (hypotheses, n)) in found {
            tried += n.hypotheses;
            best.extend(
                hypotheses.into_iter().map(|h| (pair, h)).filter(|(p, h)| !self.says(&pattern.similarity, p, h)),
            );
            // A stable sort: equals stay in the order of trying.
            best.sort_by(|s, t| t.1.score.total_cmp(&s.1.score));
            best.truncate(REFINED);
        }
        (best.into_iter().filter_map(|(pair, hypothesis)| self.refine(pair, hypothesis)).collect(), tried)
    }

    /// Whether the hypothesis puts its two GCPs where the similarity does.
    fn says(&self, similarity: &Similarity, pair: &GcpPair, hypothesis: &Hypothesis) -> bool {
        [(pair.a, hypothesis.i), (pair.b, hypothesis.j)].into_iter().all(|(gcp, point)| {
            let (p, q) = (similarity.invert(self.gcps[gcp]), self.field.points()[point as usize]);
            (p.x - q.x).hypot(p.y - q.y) <= 4.0 * self.tolerance_px
        })
    }

    /// Two patterns say the same when one of them has most marks of the other where it expects them: within the noise
    /// of both, and a mark's size where it has another candidate there, which may be another part of the same mark.
    pub fn same_claim(&self, one: &Pattern, other: &Pattern) -> bool {
        let noise_px = 6.0 * (one.noise_px + other.noise_px);
        let expects = |one: &Pattern, other: &Pattern| {
            let expected = |&&(candidate, gcp): &&(usize, usize)| {
                if one.pairs.contains(&(candidate, gcp)) {
                    return true;
                }
                let renamed = one.pairs.iter().any(|pair| pair.0 == candidate);
                let parts_px = if renamed { 0.0 } else { self.field.place_px(candidate) };
                let (p, q) = (one.similarity.invert(self.gcps[gcp]), self.field.points()[candidate]);
                (p.x - q.x).hypot(p.y - q.y) < noise_px + parts_px
            };
            2 * other.pairs.iter().filter(expected).count() > other.pairs.len()
        };
        expects(one, other) || expects(other, one)
    }
}
