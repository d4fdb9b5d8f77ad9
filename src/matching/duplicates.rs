//! Points listed twice and marks found in pieces: which of them belong together.
//!
//! The search takes whichever lies nearest, so that a pattern may mix both surveys of a list, or the left half of one
//! mark with the right half of the next, and be tilted by that. Whatever lies close to a pair of the pattern is an
//! alternative to it; the alternatives that agree best with each other, over the whole pattern, are taken. Where two
//! ways of naming the points agree about as well and put the image at different places, the list itself is ambiguous.

use std::collections::HashSet;

use crate::matching::Pattern;
use crate::matching::search::Search;
use autoref_raster::coords::PixelPoint;
use autoref_solve::Similarity;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// Longest bases of the pattern on which alternatives are tried.
const BASES: usize = 24;
/// Alternatives of one pair, the nearest.
const MOST_ALTERNATIVES: usize = 12;
/// Another choice is as good until it is this many times less likely.
const UNLIKELY: f64 = 1000.0;
/// Least error of a coordinate of a mark, pixels.
const LEAST_NOISE_PX: f64 = 0.3;

/// A candidate and a GCP that may be the same, by their indices.
type Couple = (usize, usize);

/// One choice among the alternatives.
struct Choice {
    /// Sum of the squared residuals, each no more than that of a miss, px².
    cost_px2: f64,
    couples: Vec<Couple>,
    similarity: Similarity,
}

impl Search<'_> {
    /// The pattern with the alternatives that agree best, and another one that the list allows as well when there is
    /// one; `None` when nothing has an alternative.
    pub fn told_apart(&self, pattern: &Pattern) -> Option<(Pattern, Option<Pattern>)> {
        let slots = self.alternatives(pattern);
        if slots.iter().all(|slot| slot.len() == 1) {
            return None;
        }
        let mut choices = self.choices(&slots);
        let own: Vec<Vec<Couple>> = pattern.pairs.iter().map(|couple| vec![*couple]).collect();
        choices.insert(0, self.choose(&pattern.similarity, &own)?);
        choices.sort_by(|s, t| s.cost_px2.total_cmp(&t.cost_px2));
        let best = choices.first()?;
        let sharper = self.settle(best.similarity, best.couples.clone())?;
        // A false candidate that only the mixture could take in may drop out; a mark may not.
        if sharper.pairs.len() < pattern.pairs.len() && sharper.log10_false_alarms > pattern.log10_false_alarms {
            return None;
        }
        // With an unknown error of the marks, the likelihood of n pairs falls with the (n − 2)th power of the sum of
        // squares.
        let freedom = (slots.len() as f64 - 2.0).max(1.0);
        let least_px2 = 2.0 * freedom * LEAST_NOISE_PX * LEAST_NOISE_PX;
        let as_good = |choice: &&Choice| {
            choice.cost_px2.max(least_px2) <= best.cost_px2.max(least_px2) * UNLIKELY.powf(1.0 / freedom)
                && choice.couples.iter().zip(&best.couples).all(|(one, other)| one.0 == other.0)
                && self.apart_px(&choice.similarity, &best.similarity, &best.couples) > self.tolerance_px
        };
        let other = choices.iter().find(as_good).and_then(|choice| {
            let settled = self.settle(choice.similarity, choice.couples.clone())?;
            let apart_px = self.apart_px(&settled.similarity, &sharper.similarity, &sharper.pairs);
            (apart_px > self.tolerance_px).then_some(settled)
        });
        Some((sharper, other))
    }

    /// For each pair of the pattern, itself first, what else may be the mark and the point.
    fn alternatives(&self, pattern: &Pattern) -> Vec<Vec<Couple>> {
        let place = |gcp: usize| pattern.similarity.invert(self.gcps[gcp]);
        let reach_px = (4.0 * self.tolerance_px).max(self.field.usual_place_px()).max(6.0 * pattern.noise_px);
        let of = |&(candidate, gcp): &Couple| {
            let predicted = place(gcp);
            let away_px = |p: PixelPoint| (p.x - predicted.x).hypot(p.y - predicted.y);
            let mut marks = vec![candidate];
            self.field.around(predicted, reach_px, |other, p| {
                if away_px(p) < reach_px && pattern.pairs.iter().all(|pair| pair.0 != other) {
                    marks.push(other);
                }
            });
            let points = (0..self.gcps.len()).filter(|&other| {
                let free = pattern.pairs.iter().all(|pair| pair.1 != other);
                other == gcp || (free && away_px(place(other)) < reach_px)
            });
            let residual_px = |&(c, g): &Couple| {
                let (p, q) = (self.field.points()[c], place(g));
                (p.x - q.x).hypot(p.y - q.y)
            };
            let mut all: Vec<Couple> = points.flat_map(|g| marks.iter().map(move |&c| (c, g))).collect();
            all.retain(|&(c, g)| self.allows(c, g));
            let other = |couple: &Couple| *couple != (candidate, gcp);
            all.sort_by(|s, t| {
                let nearer = residual_px(s).total_cmp(&residual_px(t));
                other(s).cmp(&other(t)).then(nearer).then(s.cmp(t))
            });
            all.truncate(MOST_ALTERNATIVES);
            all
        };
        pattern.pairs.iter().map(of).collect()
    }

    /// What the longest bases, with every alternative at their ends, choose at all the other places.
    fn choices(&self, slots: &[Vec<Couple>]) -> Vec<Choice> {
        let at = |i: usize| self.field.points()[slots[i][0].0];
        let mut bases: Vec<(f64, usize, usize)> = Vec::new();
        for i in 0..slots.len() {
            bases.extend((i + 1..slots.len()).map(|j| ((at(i).x - at(j).x).hypot(at(i).y - at(j).y), i, j)));
        }
        bases.sort_by(|s, t| t.0.total_cmp(&s.0).then((s.1, s.2).cmp(&(t.1, t.2))));
        bases.truncate(BASES);
        let (mut all, mut known) = (Vec::new(), HashSet::new());
        for (_, i, j) in bases {
            for (one, other) in slots[i].iter().flat_map(|one| slots[j].iter().map(move |other| (one, other))) {
                let ends = [self.field.points()[one.0], self.field.points()[other.0]];
                let Some(through) = Similarity::through(ends, [self.gcps[one.1], self.gcps[other.1]]) else { continue };
                if let Some(choice) = self.choose(&through, slots)
                    && known.insert(choice.couples.clone())
                {
                    all.push(choice);
                }
            }
        }
        all
    }

    /// The nearest alternative of every pair, twice, each time with a fit through those that are near.
    fn choose(&self, through: &Similarity, slots: &[Vec<Couple>]) -> Option<Choice> {
        let square = |similarity: &Similarity, &(c, g): &Couple| {
            let (p, q) = (self.field.points()[c], similarity.invert(self.gcps[g]));
            (p.x - q.x).powi(2) + (p.y - q.y).powi(2)
        };
        let mut similarity = *through;
        let mut couples = Vec::new();
        let (first_px, miss_px) = (4.0 * self.tolerance_px, 2.0 * self.tolerance_px);
        for near_px in [first_px, miss_px] {
            let nearest = |slot: &Vec<Couple>| {
                let closer = |s: &&Couple, t: &&Couple| square(&similarity, s).total_cmp(&square(&similarity, t));
                *slot.iter().min_by(closer).expect("a pair is its own first alternative")
            };
            couples = slots.iter().map(nearest).collect();
            let near = |couple: &&Couple| square(&similarity, couple) < near_px * near_px;
            let mut fitted: Vec<Pair> = couples.iter().filter(near).map(|&(c, g)| self.pair(c, g)).collect();
            if fitted.len() < 3 {
                fitted = couples.iter().map(|&(c, g)| self.pair(c, g)).collect();
            }
            similarity = fit_equal_weights(&fitted)?;
        }
        let cost_px2 = couples.iter().map(|couple| square(&similarity, couple).min(miss_px * miss_px)).sum();
        Some(Choice { cost_px2, couples, similarity })
    }

    /// The largest distance between what two similarities say of the points of a pattern, pixels.
    fn apart_px(&self, one: &Similarity, other: &Similarity, couples: &[Couple]) -> f64 {
        let apart = |&(_, gcp): &Couple| {
            let (p, q) = (one.invert(self.gcps[gcp]), other.invert(self.gcps[gcp]));
            (p.x - q.x).hypot(p.y - q.y)
        };
        couples.iter().map(apart).fold(0.0, f64::max)
    }
}
