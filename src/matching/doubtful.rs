//! Far marks that chance may as well have put where the others expect them, though the whole image would turn by them.
//!
//! A GCP that the others place roughly may have a false candidate beside its place, and the more of them lie so far
//! out, the likelier one has. Where several far marks are found they place each other.

use autoref_raster::coords::{Handedness, MapPoint, PixelPoint};
use autoref_solve::similarity::Pair;
use autoref_solve::{Similarity, solve_as};

use crate::matching::Pattern;
use crate::matching::search::Search;
use crate::matching::settle::centre_and_spread;

/// A pair lies far from the others when the square of its distance from their middle is more than the sum of theirs.
pub(super) const FAR_ARM: f64 = 1.0;
/// A far mark is that of its GCP when that is so many times likelier than that chance put a candidate there; where
/// others lie as far out they bear it out.
const LEAST_ODDS: f64 = 50.0;
const LEAST_ODDS_AMONG_OTHERS: f64 = 10.0;
/// Fewer others do not place one.
const FEWEST_OTHERS: usize = 5;
/// The deviation of marks is hardly less.
const LEAST_NOISE_PX: f64 = 0.2;

/// What marks are found among.
pub(crate) struct Ground<'a> {
    /// The GCPs in the image, found or not.
    pub gcps: &'a [MapPoint],
    pub mirrored: Handedness,
    /// Candidates per px² about a place.
    pub density: &'a dyn Fn(PixelPoint) -> f64,
}

/// Index of the far pair that is least likely right, when that is not much likelier than that it is wrong. Only those
/// that `may_be_asked` are.
pub(crate) fn doubtful_far(pairs: &[Pair], ground: &Ground<'_>, may_be_asked: impl Fn(usize) -> bool) -> Option<usize> {
    if pairs.len() <= FEWEST_OTHERS {
        return None;
    }
    let arms = arms(pairs);
    let far: Vec<usize> = (0..pairs.len()).filter(|&i| arms[i] > FAR_ARM).collect();
    let least_odds = if far.len() > 1 { LEAST_ODDS_AMONG_OTHERS } else { LEAST_ODDS };
    far.iter()
        .filter(|&&i| may_be_asked(i))
        .filter_map(|&i| Some((i, odds(pairs, i, (arms[i], far.len()), ground)?)))
        .filter(|(_, odds)| *odds < least_odds)
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(i, _)| i)
}

/// For every pair the square of its distance from the middle of the others over the sum of the squares of theirs.
fn arms(pairs: &[Pair]) -> Vec<f64> {
    let (centre, all) = centre_and_spread(pairs);
    // Leaving one out moves the middle of the rest away from it.
    let others = pairs.len() as f64 / (pairs.len() as f64 - 1.0);
    let arm = |own: f64| own * others * others / (all - own * others).max(f64::MIN_POSITIVE);
    pairs.iter().map(|pair| arm(square(pair.pixel, centre))).collect()
}

/// How much likelier a far pair is right than wrong: the density of marks where the others expect it (a bivariate t
/// distribution, since the others' noise comes from as few residuals), by the share of far GCPs that have a mark, over
/// the density of candidates.
fn odds(pairs: &[Pair], asked: usize, (arm, far): (f64, usize), ground: &Ground<'_>) -> Option<f64> {
    let others: Vec<Pair> = pairs.iter().enumerate().filter(|(i, _)| *i != asked).map(|(_, pair)| *pair).collect();
    let similarity = solve_as(&others, ground.mirrored).ok()?.similarity;
    let n = others.len() as f64;
    let freedom = 2.0 * n - 4.0;
    let left: f64 = others.iter().map(|pair| off_px(&similarity, pair).powi(2)).sum();
    let noise2 = (left / freedom).max(LEAST_NOISE_PX * LEAST_NOISE_PX);
    let density_of = |variance: f64| {
        let tail = 1.0 + off_px(&similarity, &pairs[asked]).powi(2) / (freedom * variance);
        tail.powf(-(freedom + 2.0) / 2.0) / (2.0 * std::f64::consts::PI * variance)
    };
    let variance = noise2 * (1.0 + 1.0 / n + arm);
    // A point whose stated accuracy is poor may lie farther off; one that lies well is doubted no more for it.
    let stated_px = pairs[asked].survey_sigma_m.map_or(0.0, |sigma_m| sigma_m / similarity.scale_m_per_px());
    let density = density_of(variance).max(density_of(variance + stated_px * stated_px));
    let place = similarity.invert(pairs[asked].map);
    Some(share_found(&others, &similarity, far, ground) * density / (ground.density)(place))
}

/// The share of far GCPs that have a mark.
fn share_found(others: &[Pair], similarity: &Similarity, far: usize, ground: &Ground<'_>) -> f64 {
    let (centre, spread) = centre_and_spread(others);
    let is_far = |gcp: &&MapPoint| square(similarity.invert(**gcp), centre) > FAR_ARM * spread;
    let expected = ground.gcps.iter().filter(is_far).count();
    (far as f64 / expected.max(1) as f64).min(1.0)
}

fn square(p: PixelPoint, centre: PixelPoint) -> f64 {
    (p.x - centre.x).powi(2) + (p.y - centre.y).powi(2)
}

fn off_px(similarity: &Similarity, pair: &Pair) -> f64 {
    square(similarity.invert(pair.map), pair.pixel).sqrt()
}

impl Search<'_> {
    /// The pattern without doubtful far marks; `None` when there are none. A mark with the GCP's own name is not asked.
    /// That the whole pattern is no accident stays true without them.
    pub(super) fn without_doubtful_far(&self, pattern: &Pattern) -> Option<Pattern> {
        let in_image = |gcp: &&MapPoint| self.field.contains(pattern.similarity.invert(**gcp));
        let gcps: Vec<MapPoint> = self.gcps.iter().filter(in_image).copied().collect();
        let density = |p: PixelPoint| self.field.density_near(p);
        let ground = Ground { gcps: &gcps, mirrored: Handedness::AsIs, density: &density };
        let mut taken = pattern.pairs.clone();
        loop {
            let pairs: Vec<Pair> = taken.iter().map(|&(candidate, gcp)| self.pair(candidate, gcp)).collect();
            let is_unnamed = |i: usize| !self.bears_name_of(taken[i].0, taken[i].1);
            let Some(doubtful) = doubtful_far(&pairs, &ground, is_unnamed) else { break };
            taken.remove(doubtful);
        }
        let mut sure = (taken.len() < pattern.pairs.len()).then(|| self.weighed(taken)).flatten()?;
        sure.log10_false_alarms = sure.log10_false_alarms.min(pattern.log10_false_alarms);
        sure.log10_whole_false_alarms = sure.log10_whole_false_alarms.min(pattern.log10_whole_false_alarms);
        Some(sure)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 0.03 m a pixel, north up.
    fn map_of(p: PixelPoint) -> MapPoint {
        MapPoint { easting: 0.03 * p.x, northing: -0.03 * p.y }
    }

    /// A mark that lies so far from its place.
    fn pair((x, y): (f64, f64), off_px: (f64, f64)) -> Pair {
        let pixel = PixelPoint { x: x + off_px.0, y: y + off_px.1 };
        Pair { pixel, covariance_px2: None, map: map_of(PixelPoint { x, y }), survey_sigma_m: None }
    }

    /// Six marks in a corner, with `far` ones; of fourteen GCPs far away all lie in the image.
    fn doubtful(far: &[Pair], candidates_per_px2: f64) -> Option<usize> {
        let corner = [(80.0, 90.0), (420.0, 130.0), (700.0, 60.0), (190.0, 480.0), (520.0, 560.0), (760.0, 380.0)];
        let off = [(0.2, -0.1), (-0.2, 0.1), (0.1, 0.2), (0.0, -0.2), (-0.2, 0.0), (0.2, 0.1)];
        let mut pairs: Vec<Pair> = corner.into_iter().zip(off).map(|(at, off)| pair(at, off)).collect();
        pairs.extend_from_slice(far);
        let others = (0..14).map(|k| PixelPoint { x: 1400.0 + 110.0 * f64::from(k), y: 1900.0 - 90.0 * f64::from(k) });
        let gcps: Vec<MapPoint> = pairs.iter().map(|pair| pair.map).chain(others.skip(far.len()).map(map_of)).collect();
        let density = |_: PixelPoint| candidates_per_px2;
        doubtful_far(&pairs, &Ground { gcps: &gcps, mirrored: Handedness::AsIs, density: &density }, |_| true)
    }

    #[test]
    fn one_far_mark_among_much_clutter_is_doubted_and_among_little_is_not() {
        let near_its_place = pair((2800.0, 1800.0), (1.1, 0.9));
        assert_eq!(doubtful(&[near_its_place], 5e-5), Some(6));
        assert_eq!(doubtful(&[near_its_place], 1e-6), None);
        assert_eq!(doubtful(&[], 5e-5), None);
    }

    #[test]
    fn far_marks_that_place_each_other_are_not_doubted() {
        let far = [pair((2800.0, 1800.0), (0.1, 0.2)), pair((2500.0, 300.0), (0.2, -0.1))];
        assert_eq!(doubtful(&far, 5e-5), None);
        // One of them beside its place, where the other and the corner do not put it.
        let far = [pair((2800.0, 1800.0), (0.1, 0.2)), pair((2500.0, 300.0), (4.0, -3.0))];
        assert!(doubtful(&far, 5e-5).is_some());
    }
}
