//! From a hypothesis to a pattern: least squares over all GCPs that have a mark, cleaned, and weighed.

use rayon::prelude::*;

use crate::matching::Pattern;
use crate::matching::pairs::GcpPair;
use crate::matching::predictions::spread_from_pair;
use crate::matching::search::{Hypothesis, Search};
use autoref_raster::coords::PixelPoint;
use autoref_raster::ranks::median;
use autoref_solve::Similarity;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// Fewer pairs than these are weighed against all points in the image.
pub(super) const FEWEST_NEAR: usize = 5;

/// From so many GCPs on the hypotheses are shared out: waking a thread takes as long as refining a few of a
/// short list.
const WORTH_THREADS: usize = 60;

impl Search<'_> {
    /// [`Search::refine`] of each.
    pub fn refine_all(&self, hypotheses: Vec<(&GcpPair, Hypothesis)>) -> Vec<Option<Pattern>> {
        let refined = |(pair, hypothesis): (&GcpPair, Hypothesis)| self.refine(pair, hypothesis);
        if self.gcps.len() < WORTH_THREADS {
            return hypotheses.into_iter().map(refined).collect();
        }
        hypotheses.into_par_iter().map(refined).collect()
    }

    /// A hypothesis as a least-squares pattern with its number of false alarms.
    pub fn refine(&self, pair: &GcpPair, hypothesis: Hypothesis) -> Option<Pattern> {
        let points = self.field.points();
        let ends = [points[hypothesis.i as usize], points[hypothesis.j as usize]];
        let similarity = Similarity::through(ends, [self.gcps[pair.a], self.gcps[pair.b]])?;
        let spread = |k: usize| spread_from_pair(self.gcps[pair.a], self.gcps[pair.b], self.gcps[k]);
        let pairs = self.assign(&similarity, |k, _| self.tolerance_px * spread(k));
        self.settle(similarity, pairs)
    }

    /// The radius of a circle that holds a candidate by chance so often.
    pub(super) fn chance_radius_px(&self, chance: f64) -> f64 {
        let density = self.field.density();
        (chance / (std::f64::consts::PI * density)).sqrt()
    }

    /// From a first list of pairs to the pattern that they and their neighbours settle on, weighed.
    pub fn settle(&self, mut similarity: Similarity, mut pairs: Vec<(usize, usize)>) -> Option<Pattern> {
        // Nobody is taken in whom chance would put there three times in a thousand: a false candidate far from the
        // other pairs would tilt the whole pattern.
        let widest_px = self.chance_radius_px(0.003);
        let mut noise_px = 2.0;
        for _ in 0..16 {
            if pairs.len() < 3 {
                return None;
            }
            if let Some(odd) = self.odd_one_out(&pairs) {
                pairs.remove(odd);
            }
            let fitted: Vec<Pair> = pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
            similarity = fit_equal_weights(&fitted)?;
            noise_px = usual_noise_px(&similarity, &fitted);
            let (centre, spread) = centre_and_spread(&fitted);
            // The noise of few pairs may come out far too small: four neighbours would shut out all that lies far from
            // them.
            let few = 1.0 + 8.0 / (fitted.len() as f64 - 2.0).powi(2);
            let next = self.assign(&similarity, |_, p| {
                tolerance_px(few * noise_px, fitted.len(), centre, spread, p).min(widest_px)
            });
            if next == pairs {
                break;
            }
            pairs = next;
        }
        while let Some(odd) = self.odd_one_out(&pairs) {
            pairs.remove(odd);
            let fitted: Vec<Pair> = pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
            similarity = fit_equal_weights(&fitted)?;
            noise_px = usual_noise_px(&similarity, &fitted);
        }
        let (pattern, near) = self.weigh(similarity, pairs, noise_px)?;
        // What makes it no accident lies close together: what was taken in far from there is one, as often as not.
        let by_neighbours = pattern.log10_false_alarms < pattern.log10_whole_false_alarms - 1.0;
        let pattern = if by_neighbours { self.only(&pattern, near).unwrap_or(pattern) } else { pattern };
        Some(self.without_far(&pattern).unwrap_or(pattern))
    }

    /// The pattern of these of its pairs alone; `None` when they are all, or too few.
    fn only(&self, pattern: &Pattern, near: Vec<(usize, usize)>) -> Option<Pattern> {
        if near.len() == pattern.pairs.len() || near.len() < FEWEST_NEAR {
            return None;
        }
        let without = self.weighed(near)?;
        (without.log10_false_alarms <= pattern.log10_false_alarms + 1.0).then_some(without)
    }

    /// The pair that the others, fitted without it, put farthest beyond where they would look for it.
    fn odd_one_out(&self, pairs: &[(usize, usize)]) -> Option<usize> {
        // Of four pairs any one can be made to look odd.
        if pairs.len() < 5 {
            return None;
        }
        let excess = |i: usize| -> Option<f64> {
            let others: Vec<Pair> =
                pairs.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, &(c, g))| self.pair(c, g)).collect();
            let similarity = fit_equal_weights(&others)?;
            // The noise of few pairs may come out far too small.
            let few = 1.0 + 4.0 / (others.len() as f64 - 2.0);
            let noise_px = few * noise(&similarity, &others).clamp(1.0, 6.0);
            let (centre, spread) = centre_and_spread(&others);
            let (p, q) = (similarity.invert(self.gcps[pairs[i].1]), self.field.points()[pairs[i].0]);
            let allowed = tolerance_px(noise_px, others.len(), centre, spread, p);
            Some((p.x - q.x).hypot(p.y - q.y) / allowed)
        };
        (0..pairs.len())
            .filter_map(|i| excess(i).filter(|e| *e > 1.0).map(|e| (i, e)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(i, _)| i)
    }

    pub fn pair(&self, candidate: usize, gcp: usize) -> Pair {
        let pixel = self.field.points()[candidate];
        Pair { pixel, covariance_px2: None, map: self.gcps[gcp], survey_sigma_m: None }
    }

    /// The nearest candidate to every GCP in the image. Marks found in pieces and points listed twice are one pair
    /// each: the closest.
    fn assign(&self, similarity: &Similarity, radius_px: impl Fn(usize, PixelPoint) -> f64) -> Vec<(usize, usize)> {
        let mut hits: Vec<(f64, usize, usize, PixelPoint)> = (0..self.gcps.len())
            .filter_map(|k| {
                let p = similarity.invert(self.gcps[k]);
                let (candidate, distance) =
                    self.field.contains(p).then(|| self.nearest_allowed(p, radius_px(k, p), k))??;
                Some((distance, candidate, k, p))
            })
            .collect();
        hits.sort_by(|s, t| s.0.total_cmp(&t.0).then(s.2.cmp(&t.2)));
        let twin_px = self.field.usual_place_px();
        let mut taken: Vec<(usize, usize, PixelPoint)> = Vec::new();
        for (_, candidate, k, p) in hits {
            let again = |&(other, _, q): &(usize, usize, PixelPoint)| {
                self.field.one_place(candidate, other) || (p.x - q.x).hypot(p.y - q.y) < twin_px
            };
            if !taken.iter().any(again) {
                taken.push((candidate, k, p));
            }
        }
        let mut pairs: Vec<(usize, usize)> = taken.into_iter().map(|(candidate, k, _)| (candidate, k)).collect();
        pairs.sort_by_key(|pair| pair.1);
        pairs
    }
}

/// How far from its predicted place a mark may be: the length that a two-dimensional normal error of the mark and of
/// the fit through `n` others exceeds once in 1,400.
pub(super) fn tolerance_px(noise_px: f64, n: usize, centre: PixelPoint, spread: f64, p: PixelPoint) -> f64 {
    let arm = (p.x - centre.x).powi(2) + (p.y - centre.y).powi(2);
    3.8 * noise_px * (1.0 + 1.0 / n as f64 + arm / spread).sqrt()
}

/// The noise that marks are looked for with, pixels.
pub(super) fn usual_noise_px(similarity: &Similarity, pairs: &[Pair]) -> f64 {
    noise(similarity, pairs).clamp(0.6, 6.0)
}

/// 1σ of a coordinate, pixels, from the median length of the residuals.
fn noise(similarity: &Similarity, pairs: &[Pair]) -> f64 {
    let lengths: Vec<f64> = pairs
        .iter()
        .map(|pair| {
            let p = similarity.invert(pair.map);
            (p.x - pair.pixel.x).hypot(p.y - pair.pixel.y)
        })
        .collect();
    let n = lengths.len();
    median(lengths) / 1.1774 * (n as f64 / (n as f64 - 2.0).max(0.5)).sqrt()
}

pub(super) fn centre_and_spread(pairs: &[Pair]) -> (PixelPoint, f64) {
    let n = pairs.len() as f64;
    let centre = PixelPoint {
        x: pairs.iter().map(|p| p.pixel.x).sum::<f64>() / n,
        y: pairs.iter().map(|p| p.pixel.y).sum::<f64>() / n,
    };
    let spread = pairs.iter().map(|p| (p.pixel.x - centre.x).powi(2) + (p.pixel.y - centre.y).powi(2)).sum::<f64>();
    (centre, spread.max(1.0))
}
