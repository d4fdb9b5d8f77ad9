//! Names that coded targets bear, and the GCPs that they name ([`super::labels`]).
//!
//! Names only forbid: a mark that bears one is never another GCP's. The evidence of a pattern is counted from places
//! alone, and a hit that names forbid is none, so that it is never stronger than without names. What names take away is
//! rivals, and with them the guard against figures that repeat; therefore they are heeded only when they cannot agree
//! by accident.
//!
//! The accident: numbers that have nothing to do with the labels, dealt at random among the marks. Of K marks with
//! names, n lie where an alignment of image and list puts some GCP, and A of them where it puts their own; an alignment
//! has that many with a probability of at most C(n, A)·(K − A)!/K!, and the list allows L alignments that put A marks
//! on GCPs at all (a regular grid has many). Names are heeded when L·C(n, A)·(K − A)!/K! is below the limit on false
//! alarms.

use serde::{Deserialize, Serialize};

use crate::matching::Pattern;
use crate::matching::search::Search;
use autoref_raster::coords::PixelPoint;
use autoref_solve::Similarity;

/// Up to this many marks with names and as many GCPs the alignments are counted one by one.
const MOST_COUNTED: usize = 24;

/// How the names of coded targets agree with a pattern.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NamesAgree {
    /// Marks that bear the name of a GCP.
    pub named: usize,
    /// Of these, paired with the GCP that they name.
    pub agree: usize,
    /// Of these, where the pattern expects another GCP.
    pub contradict: usize,
    /// log₁₀ of the number of alignments that would agree as well if the numbers had nothing to do with the labels.
    pub log10_false_alarms: f64,
}

impl Search<'_> {
    /// Whether a mark may be a GCP: names forbid some pairs.
    #[inline]
    pub fn allows(&self, candidate: usize, gcp: usize) -> bool {
        self.names.as_ref().is_none_or(|names| names.allow(candidate, gcp))
    }

    /// Whether a mark bears the name of the GCP.
    pub(super) fn bears_name_of(&self, candidate: usize, gcp: usize) -> bool {
        self.names.as_ref().is_some_and(|names| names.of[candidate] == Some(gcp))
    }

    /// The nearest candidate within `reach_px` that may be the GCP.
    #[inline]
    pub fn nearest_allowed(&self, p: PixelPoint, reach_px: f64, gcp: usize) -> Option<(usize, f64)> {
        match &self.names {
            None => self.field.nearest(p, reach_px),
            Some(names) => self.field.nearest_of(p, reach_px, |candidate| names.allow(candidate, gcp)),
        }
    }

    /// How the names agree with a pattern; `None` without names.
    pub fn names_agree(&self, pattern: &Pattern) -> Option<NamesAgree> {
        let names = self.names.as_ref()?;
        let named: Vec<(usize, usize)> = names.pairs().collect();
        let agreeing: Vec<(usize, usize)> = named.iter().filter(|pair| pattern.pairs.contains(pair)).copied().collect();
        let reach_px = self.named_reach_px(pattern.noise_px);
        let expects_another = |&&(candidate, gcp): &&(usize, usize)| {
            !agreeing.iter().any(|pair| pair.0 == candidate)
                && self.expected_at(&pattern.similarity, candidate, reach_px).any(|other| other != gcp)
        };
        let contradict = named.iter().filter(expects_another).count();
        let agree = agreeing.len();
        // The same number on several marks is so much likelier to be on the right one.
        let copies: f64 = agreeing
            .iter()
            .map(|pair| named.iter().filter(|other| other.1 == pair.1).count() as f64)
            .map(f64::log10)
            .sum();
        let chance = log10_choose(agree + contradict, agree) + log10_factorial(named.len() - agree)
            - log10_factorial(named.len());
        let of = |alignments: f64| alignments.log10() + chance + copies;
        let most = most_alignments(named.len(), self.gcps.len(), agree);
        let counted = named.len() <= MOST_COUNTED && self.gcps.len() <= MOST_COUNTED && agree > 2;
        let log10_false_alarms = if counted { of(self.alignments(&named, agree, reach_px)) } else { of(most) };
        Some(NamesAgree { named: named.len(), agree, contradict, log10_false_alarms })
    }

    /// Marks this far from where a GCP is expected are there: generous, so that contradictions are not overlooked.
    fn named_reach_px(&self, noise_px: f64) -> f64 {
        (2.0 * self.tolerance_px).max(4.0 * noise_px).max(self.field.usual_place_px() / 2.0)
    }

    /// GCPs that the similarity puts within reach of a candidate.
    fn expected_at(&self, similarity: &Similarity, candidate: usize, reach_px: f64) -> impl Iterator<Item = usize> {
        let (similarity, p) = (*similarity, self.field.points()[candidate]);
        (0..self.gcps.len()).filter(move |&gcp| {
            let q = similarity.invert(self.gcps[gcp]);
            (p.x - q.x).hypot(p.y - q.y) < reach_px
        })
    }

    /// Alignments that put at least `agree` of the marks on GCPs, whichever. Every one is met once for each two of
    /// those marks.
    fn alignments(&self, named: &[(usize, usize)], agree: usize, reach_px: f64) -> f64 {
        let points = |k: usize| self.field.points()[named[k].0];
        let mut met = 0usize;
        let two = (0..named.len()).flat_map(|i| (i + 1..named.len()).map(move |j| (i, j)));
        for (i, j) in two {
            for (a, b) in (0..self.gcps.len()).flat_map(|a| (0..self.gcps.len()).map(move |b| (a, b))) {
                let through = || Similarity::through([points(i), points(j)], [self.gcps[a], self.gcps[b]]);
                let Some(similarity) = (a != b).then(through).flatten().filter(|s| self.possible(s)) else { continue };
                let mut on_a_point = 0;
                for (k, &(candidate, _)) in named.iter().enumerate() {
                    if on_a_point + named.len() - k < agree {
                        break;
                    }
                    on_a_point += usize::from(self.expected_at(&similarity, candidate, reach_px).next().is_some());
                }
                met += usize::from(on_a_point >= agree);
            }
        }
        // The one that was found is among them, whatever its noise.
        (met as f64 / (agree * (agree - 1) / 2) as f64).max(1.0)
    }
}

/// Two marks on two points fix an alignment; one with `agree` marks on points is fixed by as many pairs of them.
fn most_alignments(named: usize, gcps: usize, agree: usize) -> f64 {
    let pairs = |n: usize| (n * n.saturating_sub(1)) as f64 / 2.0;
    (2.0 * pairs(named) * pairs(gcps) / pairs(agree).max(1.0)).max(1.0)
}

fn log10_factorial(n: usize) -> f64 {
    (2..=n).map(|k| (k as f64).log10()).sum()
}

/// log₁₀ of n over k.
pub(super) fn log10_choose(n: usize, k: usize) -> f64 {
    log10_factorial(n) - log10_factorial(k) - log10_factorial(n - k)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chances_are_those_of_cards_dealt_at_random() {
        // All of five cards right: 1 in 120. At least two of five: at most C(5, 2)/(5·4).
        assert!((log10_factorial(0) - log10_factorial(5) + 120f64.log10()).abs() < 1e-12);
        assert!((log10_choose(5, 2) - 1.0).abs() < 1e-12);
        assert_eq!(most_alignments(9, 9, 9), 72.0);
    }
}
