//! How likely is it that a pattern is an accident?
//!
//! The a-contrario reasoning of A. Desolneux, L. Moisan and J.-M. Morel, "Meaningful alignments", 2000, and of L.
//! Moisan and B. Stival, "A probabilistic criterion to detect rigid point matches between two images", 2004: under the
//! background model the candidates are a Poisson field of their own local density, without any relation to the GCPs. A
//! hypothesis is an ordered pair of candidates laid on a pair of GCPs; it predicts where all other GCPs must be, each
//! with a tolerance that grows with its distance from the pair. The number of false alarms is
//!
//! NFA = (hypotheses possible) · (tolerance levels) · P[at least as many of the predicted GCPs are hit by chance],
//!
//! the probability a Poisson-binomial tail over the GCPs inside the image. By the union bound the expected number of
//! hypotheses with NFA ≤ ε in a field without the pattern is at most ε. Since the hypotheses are pairs, not fits, no
//! freedom is spent that is not counted; a pattern is given the smallest NFA of its own pairs (of a few of them where
//! these show that chance makes it by the thousand: `weigh.rs`). Where marks agree closely it may go by the GCPs near
//! the pair alone: the limit is shared out among four extents, nine tenths of it to all GCPs together. Where we differ:
//! heterogeneous probabilities (tolerance and density differ from GCP to GCP), and a level set of tolerances instead of
//! the k-th residual.

use std::cell::OnceCell;
use std::f64::consts::SQRT_2;

use crate::matching::field::Field;
use crate::matching::predictions::{Counted, Predictions};
use autoref_raster::coords::{MapPoint, PixelPoint};

/// Tolerance levels tried, pixels: a half for marks that agree to a tenth, then 1 to 11.3 by √2.
pub const LEVELS_PX: [f64; 9] = [0.5, 1.0, SQRT_2, 2.0, 2.0 * SQRT_2, 4.0, 4.0 * SQRT_2, 8.0, 8.0 * SQRT_2];

/// The closest tolerance that a hypothesis is judged by during the search, pixels: one mark in pieces may be centred no
/// better.
pub const CLOSEST_PX: f64 = 1.0;

/// log₁₀ of P[at least `hits` successes] of independent trials of the given probabilities.
pub fn log10_tail(probabilities: &[f64], hits: usize) -> f64 {
    if hits == 0 {
        return 0.0;
    }
    if hits > probabilities.len() {
        return f64::NEG_INFINITY;
    }
    // state[j]: probability of j successes so far, the last one "hits or more". Products of a few dozen probabilities
    // stay far above the smallest double.
    let mut state = vec![0.0; hits + 1];
    state[0] = 1.0;
    for &p in probabilities {
        state[hits] += state[hits - 1] * p;
        for j in (1..hits).rev() {
            state[j] = state[j] * (1.0 - p) + state[j - 1] * p;
        }
        state[0] *= 1.0 - p;
    }
    state[hits].max(f64::MIN_POSITIVE).log10()
}

/// What one hypothesis, tested as a pair, is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairEvidence {
    pub log10_false_alarms: f64,
    /// The same with all GCPs in the image taken together.
    pub log10_whole_false_alarms: f64,
    /// How much less sure than one mark the predictions may be that were counted; infinite when all were.
    pub extent: f64,
    pub hits: usize,
    pub gcps_in_image: usize,
}

/// Tests the exact hypothesis that takes `pixels` to the GCPs `a` and `b`, at one tolerance level.
pub fn pair_evidence(
    field: &Field,
    gcps: &[MapPoint],
    pair: (usize, usize),
    pixels: [PixelPoint; 2],
    level_px: f64,
    log10_tests: f64,
) -> Option<PairEvidence> {
    let predictions = Predictions::of(field, gcps, pair, pixels, level_px, &|_, _| true)?;
    let counted = predictions.counted(field, level_px);
    Some(evidence_of(field, (&predictions, &counted), &Line::through(field, pixels), level_px, log10_tests))
}

/// The same of predictions that are known, those that count among them. Where some candidates cannot be some GCPs every
/// chance is counted as if nothing were forbidden, so that the evidence is never stronger than without.
pub(super) fn evidence_of(
    field: &Field,
    (predictions, counted): (&Predictions, &[Counted]),
    line: &Line,
    level_px: f64,
    log10_tests: f64,
) -> PairEvidence {
    let mut probabilities = Vec::with_capacity(counted.len());
    let mut hit: Vec<usize> = Vec::new();
    // Of each prediction, how far off it may be against one mark's error, and whether it was hit.
    let mut told_by: Vec<(f64, bool)> = Vec::with_capacity(counted.len());
    for &Counted { index, nearest_px, area_share } in counted {
        let prediction = &predictions.of[index];
        let radius = prediction.radius_px(level_px);
        let area_px = std::f64::consts::PI * radius * radius * area_share;
        let by_chance = -(-prediction.density(field) * area_px).exp_m1();
        // Nor is much said by a neighbour where every candidate has one.
        probabilities.push(by_chance.max(field.company(nearest_px).unwrap_or(0.0)));
        // One mark is evidence for one GCP only.
        let is_hit = prediction.hit_at(level_px).is_some_and(|candidate| {
            let new = !hit.iter().any(|other| field.one_place(candidate, *other));
            if new {
                hit.push(candidate);
            }
            new
        });
        told_by.push((prediction.spread, is_hit));
    }
    let circle = |c: &Counted| (predictions.of[c.index].place, predictions.of[c.index].radius_px(level_px));
    let places: Vec<(PixelPoint, f64)> = counted.iter().map(circle).collect();
    count_rows(field, line, &hit, &places, &mut probabilities);
    let (tail, extent) = best_tail(&probabilities, &told_by, level_px);
    let whole = log10_tail(&probabilities, hit.len()) - EXTENTS[0].1.log10();
    PairEvidence {
        log10_false_alarms: log10_tests + log10_of_levels() + tail,
        log10_whole_false_alarms: log10_tests + log10_of_levels() + whole,
        extent,
        hits: hit.len() + 2,
        gcps_in_image: probabilities.len() + 2,
    }
}

/// log₁₀ of the number of tolerances tried, which is a factor of the number of false alarms.
pub(super) fn log10_of_levels() -> f64 {
    (LEVELS_PX.len() as f64).log10()
}

/// Points on a line and clutter in a row meet far more often than their density tells: raises the chances of the
/// predictions in such rows.
fn count_rows(field: &Field, line: &Line, hit: &[usize], places: &[(PixelPoint, f64)], probabilities: &mut [f64]) {
    for strip in &line.strips {
        let (row, half_width_px) = (&strip.row, strip.row.half_width_px);
        let on_it: Vec<usize> = (0..places.len()).filter(|&i| row.holds(places[i].0)).collect();
        if on_it.len() < 2 {
            continue;
        }
        let others = |i: usize| !hit.contains(&i) && line.pixels.iter().all(|p| *p != field.points()[i]);
        if let Some(per_px) = strip.crowd(field, others) {
            for i in on_it {
                let radius = places[i].1;
                let share = (std::f64::consts::FRAC_PI_2 * radius / half_width_px).min(2.0);
                let share = if half_width_px > field.usual_place_px() { share } else { 2.0 };
                probabilities[i] = probabilities[i].max(-(-share * radius * per_px).exp_m1());
            }
        }
    }
}

/// How far from the pair predictions may lie to be counted, by how much less sure they are than one mark; and the share
/// of the limit on accidents that each extent has. A pair of a cluster says little of points far away: their circles
/// hold clutter by chance, and with them all six of six that lie close together are no surprise. All together is what a
/// pattern that spans the image needs, so nearly all of the limit is its own.
pub(super) const EXTENTS: [(f64, f64); 4] = [(f64::INFINITY, 0.9), (6.0, 0.034), (3.5, 0.033), (2.2, 0.033)];

/// Only patterns whose marks agree as closely as this are weighed by their neighbours: among wrong rows of a list a
/// loose fit of a few close together is no surprise.
const NEAR_LEVEL_PX: f64 = 1.5;

/// The extents that a pattern is weighed at with this tolerance.
pub(super) fn extents_at(level_px: f64) -> &'static [(f64, f64)] {
    if level_px <= NEAR_LEVEL_PX { &EXTENTS } else { &EXTENTS[..1] }
}

/// log₁₀ of the probability of as many hits, at the extent where it is least, each over its share of the limit; and
/// that extent.
fn best_tail(probabilities: &[f64], told_by: &[(f64, bool)], level_px: f64) -> (f64, f64) {
    let at = |(extent, share): (f64, f64)| {
        let inside = || (0..probabilities.len()).filter(|&i| told_by[i].0 <= extent);
        let chances: Vec<f64> = inside().map(|i| probabilities[i]).collect();
        let hits = inside().filter(|&i| told_by[i].1).count();
        (log10_tail(&chances, hits) - share.log10(), extent)
    };
    extents_at(level_px).iter().copied().map(at).min_by(|a, b| a.0.total_cmp(&b.0)).expect("there are extents")
}

/// Half-widths of the rows that are looked at, in usual places.
const ROWS: [f64; 3] = [1.0, 4.0, 16.0];

/// A strip of the field along a line.
struct Row {
    from: PixelPoint,
    direction: (f64, f64),
    half_width_px: f64,
    /// Of the line in the field.
    length_px: f64,
}

impl Row {
    fn along(field: &Field, pixels: [PixelPoint; 2], half_width_px: f64) -> Row {
        let [from, to] = pixels;
        let length = (to.x - from.x).hypot(to.y - from.y);
        let direction = ((to.x - from.x) / length, (to.y - from.y) / length);
        // Where the line leaves the field on either side.
        let (origin, mut low, mut high) = (field.origin(), f64::NEG_INFINITY, f64::INFINITY);
        for (start, step, least, most) in [
            (from.x, direction.0, origin.x, origin.x + field.width_px),
            (from.y, direction.1, origin.y, origin.y + field.height_px),
        ] {
            if step != 0.0 {
                let (s, t) = ((least - start) / step, (most - start) / step);
                (low, high) = (low.max(s.min(t)), high.min(s.max(t)));
            }
        }
        Row { from, direction, half_width_px, length_px: (high - low).max(1.0) }
    }

    fn holds(&self, p: PixelPoint) -> bool {
        let across = (p.x - self.from.x) * self.direction.1 - (p.y - self.from.y) * self.direction.0;
        across.abs() < self.half_width_px
    }
}

/// A row and the points that lie on it, sought when first asked for.
struct Strip {
    row: Row,
    members: OnceCell<Vec<usize>>,
}

impl Strip {
    /// Points of the strip for each pixel of its length, when they are more than an even field would put there.
    fn crowd(&self, field: &Field, counts: impl Fn(usize) -> bool) -> Option<f64> {
        let (row, points) = (&self.row, field.points());
        let members = self.members.get_or_init(|| (0..points.len()).filter(|&i| row.holds(points[i])).collect());
        let seen = members.iter().filter(|&&i| counts(i)).count() as f64;
        let expected = field.density() * 2.0 * row.half_width_px * row.length_px;
        (seen > expected + 6.0 * expected.sqrt() + 6.0).then_some(seen / row.length_px)
    }
}

/// The line through the two pixels of a hypothesis, with its strips: the same at every tolerance level.
pub(super) struct Line {
    pixels: [PixelPoint; 2],
    strips: Vec<Strip>,
}

impl Line {
    pub fn through(field: &Field, pixels: [PixelPoint; 2]) -> Self {
        let strip = |widths: f64| {
            let row = Row::along(field, pixels, widths * field.usual_place_px());
            Strip { row, members: OnceCell::new() }
        };
        Line { pixels, strips: ROWS.map(strip).into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tail_of_equal_probabilities_is_binomial() {
        // P[X ≥ 2], X ~ B(4, 0.1) = 0.0523.
        assert!((log10_tail(&[0.1; 4], 2) - 0.0523f64.log10()).abs() < 1e-12);
        assert_eq!(log10_tail(&[0.5; 3], 0), 0.0);
        assert_eq!(log10_tail(&[0.5; 3], 4), f64::NEG_INFINITY);
    }

    #[test]
    fn a_point_surveyed_twice_is_one_witness() {
        let pixel = |x: f64, y: f64| PixelPoint { x, y };
        let marks = [(100.0, 100.0), (900.0, 150.0), (400.0, 700.0), (700.0, 500.0)];
        let field = Field::new(marks.iter().map(|&(x, y)| pixel(x, y)).collect(), Some((1000.0, 800.0)));
        let list = |twice: bool| -> Vec<MapPoint> {
            let copies: &[f64] = if twice { &[0.0, 0.3] } else { &[0.0] };
            let all = marks.iter().flat_map(|&(x, y)| copies.iter().map(move |d| (x + d, y)));
            all.map(|(x, y)| MapPoint { easting: x, northing: -y }).collect()
        };
        let of = |gcps: &[MapPoint], pair| {
            pair_evidence(&field, gcps, pair, [pixel(100.0, 100.0), pixel(900.0, 150.0)], 2.0, 3.0).expect("two points")
        };
        let (once, twice) = (of(&list(false), (0, 1)), of(&list(true), (0, 2)));
        assert_eq!((once.hits, once.gcps_in_image), (4, 4));
        assert_eq!(once, twice);
    }

    /// Whichever of the two comes first in the list.
    #[test]
    fn of_two_surveys_of_a_point_the_one_with_a_mark_speaks() {
        let pixel = |x: f64, y: f64| PixelPoint { x, y };
        let marks = [(100.0, 100.0), (900.0, 150.0), (400.0, 700.0), (700.0, 500.0)];
        let points = marks.iter().map(|&(x, y)| pixel(x, y)).collect();
        let field = Field::new(points, Some((1000.0, 800.0))).with_sizes(vec![13.0; 4]);
        // The survey that has the marks, and one that is 12 px off.
        let list = |copies: [f64; 2]| -> Vec<MapPoint> {
            let all = marks.iter().flat_map(|&(x, y)| copies.map(|d| (x + d, y)));
            all.map(|(x, y)| MapPoint { easting: x, northing: -y }).collect()
        };
        let of = |gcps: &[MapPoint], pair| {
            pair_evidence(&field, gcps, pair, [pixel(100.0, 100.0), pixel(900.0, 150.0)], 1.0, 3.0).expect("two points")
        };
        let (first, last) = (of(&list([0.0, 12.0]), (0, 2)), of(&list([12.0, 0.0]), (1, 3)));
        assert_eq!((first.hits, last.hits, last.gcps_in_image), (4, 4, 4));
        assert!((first.log10_false_alarms - last.log10_false_alarms).abs() < 1e-9, "{first:?}, {last:?}");
    }

    #[test]
    fn far_points_do_not_hide_a_cluster() {
        // Four of four near points hit, which chance seldom does; fourteen far away whose circles always hold
        // something.
        let mut told_by = vec![(1.5, true); 4];
        told_by.extend([(20.0, true); 8]);
        told_by.extend([(20.0, false); 6]);
        let chances: Vec<f64> = told_by.iter().map(|t| if t.0 > 2.0 { 0.7 } else { 1e-3 }).collect();
        let (tail, extent) = best_tail(&chances, &told_by, 1.0);
        assert!(tail < -9.0 && extent <= 6.0, "{tail} at {extent}");
        // Without the cluster nothing is gained.
        let far: Vec<(f64, bool)> = told_by[4..].to_vec();
        assert!(best_tail(&chances[4..], &far, 1.0).0 > -1.0);
        let shares: f64 = EXTENTS.iter().map(|e| e.1).sum();
        assert!((shares - 1.0).abs() < 1e-9, "the limit on false alarms is shared out whole");
    }
}
