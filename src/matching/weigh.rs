//! A pattern's worth: the smallest number of false alarms over its own pairs and the tolerances.

use crate::matching::Pattern;
use crate::matching::evidence::{LEVELS_PX, Line, PairEvidence, evidence_of};
use crate::matching::far::root_mean_square;
use crate::matching::predictions::spread_from_pair;
use crate::matching::predictions::{Counted, Predictions};
use crate::matching::search::Search;
use crate::matching::settle::FEWEST_NEAR;
use autoref_solve::Similarity;
use autoref_solve::similarity::Pair;

/// Pairs of a pattern that it is weighed by, the longest.
const MOST_BASES: usize = 48;
const FEW_BASES: usize = 4;
/// Where more points lie in the image there are fewer: each holds every point against every other.
const MANY: usize = 60;

/// How many pairs a pattern is weighed by, where so many points lie in the image.
fn bases_for(gcps_in_image: usize) -> usize {
    let square = |n: usize| n * n;
    (MOST_BASES * square(MANY) / square(gcps_in_image.max(MANY))).max(FEW_BASES)
}

/// A pattern that chance would produce ten thousand times over by a first look, at a few of its pairs and at the
/// tolerances of marks that scatter as its own, is weighed no further.
const HOPELESS_LOG10: f64 = 4.0;
const FIRST_BASES: usize = 8;
const FIRST_LEVELS: usize = 3;

/// Candidate and GCP, by index.
type Taken = (usize, usize);

/// Two marks of a pattern, taken as exact, and what they predict.
struct Base {
    gcps: (usize, usize),
    predictions: Predictions,
    line: Line,
}

/// The strongest evidence of a pattern; of equally strong that of the first base, at the closest tolerance.
struct Strongest {
    log10_false_alarms: f64,
    gcps: (usize, usize),
    extent: f64,
    /// The least with all GCPs in the image taken together, whatever the base.
    log10_whole_false_alarms: f64,
}

impl Search<'_> {
    /// The smallest number of false alarms over the pattern's own pairs and the tolerance levels, and the pairs that it
    /// goes by.
    pub(super) fn weigh(
        &self,
        similarity: Similarity,
        pairs: Vec<Taken>,
        noise_px: f64,
    ) -> Option<(Pattern, Vec<Taken>)> {
        let gcps_in_image = self.gcps.iter().filter(|g| self.field.contains(similarity.invert(**g))).count();
        let levels_px = levels_for(pairs.len());
        let bases = self.longest(&pairs, bases_for(gcps_in_image), |_| true);
        let first = self.strongest(&of_every_length(&bases), levels_of(noise_px))?;
        let is_hopeless = first.log10_false_alarms > HOPELESS_LOG10;
        let strongest = if is_hopeless { first } else { self.strongest(&bases, levels_px)? };
        let Strongest { log10_false_alarms: near, gcps: (a, b), extent, log10_whole_false_alarms } = strongest;
        // Of four any one can be a wrong row that happens to fit its neighbours.
        let log10_false_alarms = if pairs.len() < FEWEST_NEAR { log10_whole_false_alarms } else { near };
        let told = |k: usize| k == a || k == b || spread_from_pair(self.gcps[a], self.gcps[b], self.gcps[k]) <= extent;
        let going_by = pairs.iter().copied().filter(|&(_, k)| told(k)).collect();
        let placed: Vec<Pair> = pairs.iter().map(|&(candidate, gcp)| self.pair(candidate, gcp)).collect();
        let deviation_px = root_mean_square(&similarity, &placed);
        let pattern = Pattern {
            pairs,
            similarity,
            log10_false_alarms,
            log10_whole_false_alarms,
            noise_px,
            deviation_px,
            gcps_in_image,
        };
        Some((pattern, going_by))
    }

    /// A rival with the evidence that is its own. Two pairs that it shares with `best`, taken as a base, predict what
    /// `best` does, and find its marks: that speaks for `best` alone.
    pub(super) fn apart_from(&self, best: &Pattern, rival: Pattern) -> Pattern {
        let is_shared = |pair: &Taken| best.pairs.contains(pair);
        if rival.pairs.iter().filter(|pair| is_shared(pair)).count() < 2 {
            return rival;
        }
        let most = bases_for(rival.gcps_in_image);
        let bases = self.longest(&rival.pairs, most, |ends| !ends.iter().all(is_shared));
        let own = self.strongest(&bases, levels_for(rival.pairs.len()));
        let log10 = own.map_or(0.0, |own| match rival.pairs.len() < FEWEST_NEAR {
            true => own.log10_whole_false_alarms,
            false => own.log10_false_alarms,
        });
        Pattern { log10_false_alarms: log10.max(rival.log10_false_alarms), ..rival }
    }

    /// The strongest evidence by these bases at these tolerances; `None` where the GCPs of each are one place.
    fn strongest(&self, bases: &[[Taken; 2]], levels_px: &[f64]) -> Option<Strongest> {
        let mut best: Option<Strongest> = None;
        let mut whole = f64::INFINITY;
        for base in bases.iter().filter_map(|ends| self.base(*ends, levels_px)) {
            for evidence in self.evidence(&base, levels_px) {
                let PairEvidence { log10_false_alarms, log10_whole_false_alarms, extent, .. } = evidence;
                whole = whole.min(log10_whole_false_alarms);
                if best.as_ref().is_none_or(|best| log10_false_alarms < best.log10_false_alarms) {
                    best = Some(Strongest { log10_false_alarms, gcps: base.gcps, extent, log10_whole_false_alarms });
                }
            }
        }
        best.map(|best| Strongest { log10_whole_false_alarms: whole, ..best })
    }

    /// The pairs of a pattern that lie farthest apart, of those that may be taken, the longest first, at most so many.
    fn longest(&self, pairs: &[Taken], most: usize, may: impl Fn(&[Taken; 2]) -> bool) -> Vec<[Taken; 2]> {
        let points = self.field.points();
        let mut longest: Vec<(f64, usize, usize)> = Vec::new();
        for i in 0..pairs.len() {
            for j in i + 1..pairs.len() {
                let (p, q) = (points[pairs[i].0], points[pairs[j].0]);
                longest.push(((p.x - q.x).hypot(p.y - q.y), i, j));
            }
        }
        longest.sort_by(|s, t| t.0.total_cmp(&s.0).then((s.1, s.2).cmp(&(t.1, t.2))));
        longest.into_iter().map(|(_, i, j)| [pairs[i], pairs[j]]).filter(may).take(most).collect()
    }

    /// `None` where the two GCPs are one place.
    fn base(&self, [one, other]: [Taken; 2], levels_px: &[f64]) -> Option<Base> {
        let ends = [one, other].map(|(candidate, _)| self.field.points()[candidate]);
        let gcps = (one.1, other.1);
        let may = |candidate: usize, gcp: usize| self.allows(candidate, gcp);
        let most_px = levels_px.iter().copied().fold(0.0, f64::max);
        let predictions = Predictions::of(&self.field, self.gcps, gcps, ends, most_px, &may)?;
        Some(Base { gcps, predictions, line: Line::through(&self.field, ends) })
    }

    /// The evidence of a base at these tolerances, which grow.
    fn evidence(&self, base: &Base, levels_px: &[f64]) -> Vec<PairEvidence> {
        let Base { predictions, line, .. } = base;
        let mut counted = None;
        let at = |level_px: &f64| {
            // Circles shrink: where all predictions count they count at every closer tolerance.
            let all = counted.take().filter(|counted: &Vec<Counted>| counted.len() == predictions.of.len());
            let now = all.unwrap_or_else(|| predictions.counted(&self.field, *level_px));
            let evidence = evidence_of(&self.field, (predictions, &now), line, *level_px, self.log10_tests);
            counted = Some(now);
            evidence
        };
        let mut evidence: Vec<PairEvidence> = levels_px.iter().rev().map(at).collect();
        evidence.reverse();
        evidence
    }
}

/// Tolerances for so many pairs: three or four that agree more closely than marks are centred are as many parts of
/// marks.
fn levels_for(pairs: usize) -> &'static [f64] {
    if pairs >= FEWEST_NEAR { &LEVELS_PX[..] } else { &LEVELS_PX[1..] }
}

/// A few bases of every length.
fn of_every_length(bases: &[[Taken; 2]]) -> Vec<[Taken; 2]> {
    let few = bases.len().min(FIRST_BASES);
    (0..few).map(|i| bases[i * bases.len() / few]).collect()
}

/// The tolerances that hold most marks of this noise.
fn levels_of(noise_px: f64) -> &'static [f64] {
    let first = LEVELS_PX.partition_point(|level_px| *level_px < 2.0 * noise_px);
    let first = first.min(LEVELS_PX.len() - FIRST_LEVELS);
    &LEVELS_PX[first..first + FIRST_LEVELS]
}
