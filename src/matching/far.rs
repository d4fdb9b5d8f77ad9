//! What lies far from a cluster of marks that agree closely must agree with it too: where it does not, chance filled a
//! wide tolerance, and the image's corners would follow it.

use crate::matching::Pattern;
use crate::matching::doubtful::FAR_ARM;
use crate::matching::search::Search;
use crate::matching::settle::{FEWEST_NEAR, centre_and_spread, usual_noise_px};
use autoref_raster::coords::PixelPoint;
use autoref_solve::Similarity;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// Pairs agree when the others, fitted without one, put it within so many of their deviations: F(2, 8) exceeds 18.5
/// once in a thousand.
const AGREEING_SIGMAS: f64 = 6.1;
/// The deviation of marks is hardly less.
const LEAST_NOISE_PX: f64 = 0.2;
/// Marks whose deviation is no larger agree closely.
const CLOSE_PX: f64 = 1.0;

/// Candidate and GCP, by index.
type Taken = (usize, usize);

/// A GCP beside the pairs of others.
struct Beside {
    /// The square of a place's distance from the middle of the others over the sum of the squares of theirs.
    arm: f64,
    /// Where they put the GCP, and how far from there a mark of it agrees with them.
    place: PixelPoint,
    allowed_px: f64,
    /// How far the mark taken lies from there, as a part of what is allowed.
    unlike: f64,
}

impl Search<'_> {
    /// The pattern without what lies far from a cluster that agrees closely and not where the cluster puts it. `None`
    /// when there is nothing of the kind, or too few would be left to say so.
    pub(super) fn without_far(&self, pattern: &Pattern) -> Option<Pattern> {
        let by_neighbours = pattern.log10_false_alarms < pattern.log10_whole_false_alarms - 1.0;
        let mut near = pattern.pairs.clone();
        let mut far = self.drop_worst(&mut near, FAR_ARM, |beside| beside.arm);
        // What makes a pattern of neighbours no accident is how well they agree, so that each of them is asked.
        if by_neighbours {
            self.drop_worst(&mut near, 1.0, |beside| beside.unlike);
        }
        let core: Vec<Pair> = near.iter().map(|&(c, g)| self.pair(c, g)).collect();
        // Marks that hardly agree among themselves say nothing of one far away: some of them may be false.
        if root_mean_square(&fit_equal_weights(&core)?, &core) > CLOSE_PX {
            return None;
        }
        // The nearest first: each that agrees makes the rest surer. Where one does not, another candidate may.
        while let Some((candidate, gcp)) = far.pop() {
            let Some(beside) = self.beside((candidate, gcp), near.iter()) else { continue };
            if beside.unlike <= 1.0 {
                near.push((candidate, gcp));
                continue;
            }
            let other = self.nearest_allowed(beside.place, beside.allowed_px / 2.0, gcp);
            if let Some((candidate, _)) = other
                && !near.iter().any(|pair| self.field.one_place(pair.0, candidate))
            {
                near.push((candidate, gcp));
            }
        }
        near.sort_by_key(|pair| pair.1);
        if near == pattern.pairs || near.len() < FEWEST_NEAR {
            return None;
        }
        let gone = pattern.pairs.len() - near.len();
        let without = self.weighed(near)?;
        // Two that chance seldom puts there are marks of an image that is bent.
        let believed = gone <= 1 || without.log10_false_alarms <= pattern.log10_false_alarms + 1.0;
        (by_neighbours || believed).then_some(without)
    }

    /// Takes away the pair for which `measure` is largest, as long as it exceeds `most` and enough are left; the last
    /// one gone is the last of the list.
    fn drop_worst(&self, pairs: &mut Vec<Taken>, most: f64, measure: impl Fn(&Beside) -> f64) -> Vec<Taken> {
        let mut gone = Vec::new();
        while pairs.len() > FEWEST_NEAR {
            let of = |i: usize| {
                let others = pairs.iter().filter(|other| **other != pairs[i]);
                self.beside(pairs[i], others).map_or(0.0, |beside| measure(&beside))
            };
            let worst = (0..pairs.len()).map(|i| (i, of(i))).max_by(|a, b| a.1.total_cmp(&b.1));
            match worst.filter(|worst| worst.1 > most) {
                Some((i, _)) => gone.push(pairs.remove(i)),
                None => break,
            }
        }
        gone
    }

    /// A pair beside others; `None` of fewer than three.
    fn beside<'p>(&self, (candidate, gcp): Taken, others: impl Iterator<Item = &'p Taken>) -> Option<Beside> {
        let others: Vec<Pair> = others.map(|&(c, g)| self.pair(c, g)).collect();
        if others.len() < 3 {
            return None;
        }
        let similarity = fit_equal_weights(&others)?;
        let (centre, spread) = centre_and_spread(&others);
        let (place, mark) = (similarity.invert(self.gcps[gcp]), self.field.points()[candidate]);
        let arm_of = |p: PixelPoint| ((p.x - centre.x).powi(2) + (p.y - centre.y).powi(2)) / spread;
        let one_px = root_mean_square(&similarity, &others).max(LEAST_NOISE_PX);
        let allowed_px = AGREEING_SIGMAS * one_px * (1.0 + 1.0 / others.len() as f64 + arm_of(place)).sqrt();
        let unlike = (mark.x - place.x).hypot(mark.y - place.y) / allowed_px;
        Some(Beside { arm: arm_of(mark), place, allowed_px, unlike })
    }

    /// A pattern of these pairs, fitted and weighed.
    pub(super) fn weighed(&self, pairs: Vec<Taken>) -> Option<Pattern> {
        let fitted: Vec<Pair> = pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
        let similarity = fit_equal_weights(&fitted)?;
        let noise_px = usual_noise_px(&similarity, &fitted);
        Some(self.weigh(similarity, pairs, noise_px)?.0)
    }
}

/// 1σ of a coordinate, pixels, from the squares of the residuals.
pub(super) fn root_mean_square(similarity: &Similarity, pairs: &[Pair]) -> f64 {
    let square = |pair: &Pair| {
        let p = similarity.invert(pair.map);
        (p.x - pair.pixel.x).powi(2) + (p.y - pair.pixel.y).powi(2)
    };
    (pairs.iter().map(square).sum::<f64>() / (2.0 * pairs.len() as f64 - 4.0).max(1.0)).sqrt()
}
