//! Patterns grown outwards from a short base, for fields so dense that one look from a pair tells nothing.
//!
//! Where tens of thousands of candidates lie a few marks apart, a long pair of GCPs has billions of hypotheses, and a
//! short one predicts the other GCPs so loosely that somebody is everywhere. A short pair and its nearest neighbour,
//! however, predict the next one closely, and so on: each mark that is taken in narrows the place of the next. Chance
//! hypotheses die after three or four looks, by the sequential probability ratio test (A. Wald, "Sequential tests of
//! statistical hypotheses", 1945; for verification O. Chum and J. Matas, "Optimal randomized RANSAC", 2008). What
//! survives is settled and weighed as every other pattern; nothing is believed because it grew.

use crate::matching::Pattern;
use crate::matching::pairs::GcpPair;
use crate::matching::search::{Search, Tried};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::similarity::fit_equal_weights;

/// From so many candidates on patterns are grown.
pub(super) const GROWN_FROM: usize = 30_000;
/// Pairs of GCPs that are grown from, the cheapest that can tell anything.
const MOST_BASES: usize = 24;
/// Patterns of one base that are settled.
const SETTLED_PER_BASE: usize = 6;
/// Share of the GCPs inside the image that have their mark, as the test assumes.
const SEEN: f64 = 0.8;
/// A place that chance fills this often is passed over.
const LOOSE: f64 = 0.5;
/// Candidates at one predicted place that are followed, the nearest.
const FOLLOWED: usize = 3;
/// Given up below this logarithm of the ratio of likelihoods: a third miss at the start, or one for every hit gained.
const HOPELESS: f64 = -4.0;
/// Not settled below this one.
const PROMISING: f64 = 8.0;
/// GCPs that a pattern grows to; more leave no doubt.
const MOST_GROWN: usize = 24;

/// A candidate taken for a GCP.
type Couple = (u32, u32);

/// A pattern that grows: the sums of a least-squares similarity pixels = t + z·map, as complex numbers with north and
/// up along the imaginary axis.
#[derive(Clone, Copy)]
struct Shoot {
    n: f64,
    map: (f64, f64),
    pixel: (f64, f64),
    map_square: f64,
    cross: (f64, f64),
    log_ratio: f64,
    couples: [Couple; MOST_GROWN],
    len: usize,
}

impl Shoot {
    fn new() -> Shoot {
        let zero = (0.0, 0.0);
        let couples = [(0, 0); MOST_GROWN];
        Shoot { n: 0.0, map: zero, pixel: zero, map_square: 0.0, cross: zero, log_ratio: 0.0, couples, len: 0 }
    }

    /// `map`: east and north of the base's first GCP, metres.
    #[inline]
    fn with(mut self, candidate: u32, gcp: u32, map: (f64, f64), p: PixelPoint) -> Shoot {
        let (x, y) = (p.x, -p.y);
        self.n += 1.0;
        self.map = (self.map.0 + map.0, self.map.1 + map.1);
        self.pixel = (self.pixel.0 + x, self.pixel.1 + y);
        self.map_square += map.0 * map.0 + map.1 * map.1;
        // conj(map) · pixel
        self.cross = (self.cross.0 + map.0 * x + map.1 * y, self.cross.1 + map.0 * y - map.1 * x);
        self.couples[self.len] = (candidate, gcp);
        self.len += 1;
        self
    }

    /// Where the pattern expects a GCP, and the spread of that relative to the error of one mark.
    #[inline]
    fn expects(&self, map: (f64, f64)) -> (PixelPoint, f64) {
        let mean = (self.map.0 / self.n, self.map.1 / self.n);
        let square = self.map_square - self.n * (mean.0 * mean.0 + mean.1 * mean.1);
        let (px, py) = (self.pixel.0 / self.n, self.pixel.1 / self.n);
        let cross =
            (self.cross.0 - self.n * (mean.0 * px + mean.1 * py), self.cross.1 - self.n * (mean.0 * py - mean.1 * px));
        let z = (cross.0 / square, cross.1 / square);
        let arm = (map.0 - mean.0, map.1 - mean.1);
        let place = PixelPoint { x: px + z.0 * arm.0 - z.1 * arm.1, y: -(py + z.0 * arm.1 + z.1 * arm.0) };
        (place, (1.0 + 1.0 / self.n + (arm.0 * arm.0 + arm.1 * arm.1) / square).sqrt())
    }

    fn holds(&self, candidate: usize) -> bool {
        self.couples[..self.len].iter().any(|couple| couple.0 as usize == candidate)
    }
}

/// A GCP to grow to: its index, east and north of the base's first GCP in metres.
type Goal = (u32, (f64, f64));

impl Search<'_> {
    /// Patterns grown from the bases that can tell anything, for about `budget` hypotheses, and the number of those
    /// tried.
    pub fn grown(&self, pairs: &[GcpPair], budget: u64) -> (Vec<Pattern>, u64) {
        let mut bases: Vec<(&GcpPair, Vec<Goal>)> = Vec::new();
        let mut cheapest: Vec<&GcpPair> = pairs.iter().collect();
        cheapest.sort_by_key(|pair| pair.hypotheses());
        for pair in cheapest {
            let goals = self.goals(pair);
            if self.can_tell(pair, &goals) {
                bases.push((pair, goals));
            }
            if bases.len() == MOST_BASES {
                break;
            }
        }
        let (mut patterns, mut tried): (Vec<Pattern>, u64) = (Vec::new(), 0);
        for (pair, goals) in bases {
            if tried >= budget {
                break;
            }
            let left = budget - tried;
            let (shoots, n) = self.grow_pair(pair, &goals, pair.worth(left));
            tried += n;
            patterns.extend(shoots.iter().filter_map(|shoot| self.settle_shoot(shoot)));
            // As in the search: far below what chance can do nothing better is looked for.
            if patterns.iter().any(|pattern| pattern.log10_false_alarms < -12.0) || left < pair.hypotheses() {
                break;
            }
        }
        (patterns, tried)
    }

    /// The other GCPs, the nearest to the base first.
    fn goals(&self, pair: &GcpPair) -> Vec<Goal> {
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        let offset = |p: MapPoint| (p.easting - a.easting, p.northing - a.northing);
        let to_b = offset(b);
        let from_middle = |o: (f64, f64)| (o.0 - to_b.0 / 2.0).hypot(o.1 - to_b.1 / 2.0);
        let others = (0..self.gcps.len()).filter(|k| *k != pair.a && *k != pair.b);
        let mut goals: Vec<Goal> = others.map(|k| (k as u32, offset(self.gcps[k]))).collect();
        goals.sort_by(|s, t| from_middle(s.1).total_cmp(&from_middle(t.1)).then(s.0.cmp(&t.0)));
        goals
    }

    /// Whether the true hypothesis would stand out among all chance ones, were all marks inside the image there.
    fn can_tell(&self, pair: &GcpPair, goals: &[Goal]) -> bool {
        let to_b = self.map_offset(pair);
        // In map units: the spread does not depend on the scale.
        let at = |map: (f64, f64)| PixelPoint { x: map.0, y: -map.1 };
        let mut shoot = Shoot::new().with(0, 0, (0.0, 0.0), at((0.0, 0.0))).with(0, 0, to_b, at(to_b));
        let mut gain = 0.0;
        for &(gcp, map) in goals {
            let (_, spread) = shoot.expects(map);
            let chance = self.chance_of_hit(self.tolerance_px * spread);
            if chance < LOOSE && shoot.len < MOST_GROWN {
                gain += SEEN * (-chance.ln() - 1.0);
                shoot = shoot.with(0, gcp, map, at(map));
            }
        }
        gain > (pair.hypotheses().max(1) as f64).ln()
    }

    fn map_offset(&self, pair: &GcpPair) -> (f64, f64) {
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        (b.easting - a.easting, b.northing - a.northing)
    }

    fn chance_of_hit(&self, radius_px: f64) -> f64 {
        let density = self.field.density();
        -(-density * std::f64::consts::PI * radius_px * radius_px).exp_m1()
    }

    /// The best patterns that grow from one base, best first, and the number of hypotheses tried.
    fn grow_pair(&self, pair: &GcpPair, goals: &[Goal], budget: u64) -> (Vec<Shoot>, u64) {
        let to_b = self.map_offset(pair);
        let from_point = |i: usize| {
            let (mut shoots, mut tried) = (Vec::new(), Tried::default());
            let seed = Shoot::new().with(i as u32, pair.a as u32, (0.0, 0.0), self.field.points()[i]);
            self.ends_of(pair, i, |j, to| {
                tried.hypotheses += 1;
                self.follow(seed.with(j as u32, pair.b as u32, to_b, to), goals, &mut shoots);
            });
            keep_best(&mut shoots);
            (shoots, tried)
        };
        let (shoots, tried) = self.over_chosen_points(pair, budget, from_point, keep_best);
        (shoots, tried.hypotheses)
    }

    /// Takes in one GCP after the other as long as it is more likely a pattern than not.
    fn follow(&self, mut shoot: Shoot, goals: &[Goal], done: &mut Vec<Shoot>) {
        for (k, &(gcp, map)) in goals.iter().enumerate() {
            if shoot.len == MOST_GROWN {
                break;
            }
            let (place, spread) = shoot.expects(map);
            let radius_px = self.tolerance_px * spread;
            let chance = self.chance_of_hit(radius_px);
            if chance > LOOSE || !self.field.contains(place) {
                continue;
            }
            let mut hits = [(f64::INFINITY, 0usize); FOLLOWED];
            self.field.around(place, radius_px, |i, q| {
                let mut hit = ((q.x - place.x).powi(2) + (q.y - place.y).powi(2), i);
                if hit.0 <= radius_px * radius_px && !shoot.holds(i) && self.allows(i, gcp as usize) {
                    for kept in &mut hits {
                        if hit < *kept {
                            std::mem::swap(&mut hit, kept);
                        }
                    }
                }
            });
            if hits[0].0.is_infinite() {
                shoot.log_ratio += ((1.0 - SEEN) / (1.0 - chance)).ln();
                if shoot.log_ratio < HOPELESS {
                    return;
                }
                continue;
            }
            shoot.log_ratio += (SEEN / chance).ln();
            for &(_, i) in hits[1..].iter().filter(|hit| hit.0.is_finite()) {
                self.follow(shoot.with(i as u32, gcp, map, self.field.points()[i]), &goals[k + 1..], done);
            }
            let nearest = hits[0].1;
            shoot = shoot.with(nearest as u32, gcp, map, self.field.points()[nearest]);
        }
        if shoot.log_ratio >= PROMISING {
            done.push(shoot);
            if done.len() >= 4 * SETTLED_PER_BASE {
                keep_best(done);
            }
        }
    }

    fn settle_shoot(&self, shoot: &Shoot) -> Option<Pattern> {
        let mut pairs: Vec<(usize, usize)> =
            shoot.couples[..shoot.len].iter().map(|&(c, g)| (c as usize, g as usize)).collect();
        pairs.sort_by_key(|pair| pair.1);
        let fitted: Vec<_> = pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
        self.settle(fit_equal_weights(&fitted)?, pairs)
    }
}

fn keep_best(shoots: &mut Vec<Shoot>) {
    // A total order, so that the result does not depend on which thread came first.
    shoots
        .sort_by(|s, t| t.log_ratio.total_cmp(&s.log_ratio).then_with(|| s.couples[..s.len].cmp(&t.couples[..t.len])));
    shoots.truncate(SETTLED_PER_BASE);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Candidate;
    use crate::matching::Priors;
    use autoref_raster::coords::GeoTransform;
    use autoref_raster::random::Mmix;

    const SIDE_PX: f64 = 1100.0;

    /// A candidate every 19 px, 12 GCPs, and the first `marked` of them with their marks as the first candidates.
    fn dense_field(marked: usize) -> (Vec<Candidate>, Vec<MapPoint>) {
        let mut draws = Mmix(marked as u64 + 5);
        let mut anywhere =
            || PixelPoint { x: 20.0 + (SIDE_PX - 40.0) * draws.unit(), y: 20.0 + (SIDE_PX - 40.0) * draws.unit() };
        let transform = GeoTransform([570_000.0, 0.024, 0.018, 7_032_000.0, 0.018, -0.024]);
        let places: Vec<PixelPoint> = (0..12).map(|_| anywhere()).collect();
        let gcps = places.iter().map(|p| transform.apply(*p)).collect();
        let clutter: Vec<PixelPoint> = (0..3300).map(|_| anywhere()).collect();
        let near = |p: &PixelPoint| PixelPoint { x: p.x + 0.3, y: p.y - 0.2 };
        let points = places[..marked].iter().map(near).chain(clutter);
        let (covariance_px2, score, area_px, size_px, elevation_m) = (None, None, None, None, None);
        let candidate = |centre| Candidate {
            centre,
            covariance_px2,
            score,
            area_px,
            size_px,
            elevation_m,
            code: None,
            paint: None,
        };
        (points.map(candidate).collect(), gcps)
    }

    fn grown(marked: usize) -> Vec<Pattern> {
        let (candidates, gcps) = dense_field(marked);
        let priors =
            Priors { gsd_m_per_px: Some((0.027, 0.033)), image_size_px: Some((SIDE_PX, SIDE_PX)), ..Priors::default() };
        let candidates: Vec<&Candidate> = candidates.iter().collect();
        let (search, pairs, _) = Search::new(&candidates, &gcps, &priors, 0.0).expect("hypotheses");
        search.grown(&pairs, 3_000_000).0
    }

    #[test]
    fn marks_in_a_dense_field_are_grown_and_those_that_are_not_there_are_not() {
        let best = |patterns: Vec<Pattern>| {
            patterns.into_iter().min_by(|s, t| s.log10_false_alarms.total_cmp(&t.log10_false_alarms))
        };
        let found = best(grown(12)).expect("twelve marks of twelve");
        assert!(found.log10_false_alarms < -6.0, "{}", found.log10_false_alarms);
        assert!(found.pairs.iter().filter(|(candidate, gcp)| candidate == gcp).count() >= 11, "{:?}", found.pairs);
        assert!(best(grown(0)).is_none_or(|accident| accident.log10_false_alarms > -4.0));
    }

    #[test]
    fn a_shoot_expects_what_least_squares_fit() {
        let mut draws = Mmix(3);
        let transform = GeoTransform([500.0, 0.3, 0.1, 900.0, 0.1, -0.3]);
        let mut shoot = Shoot::new();
        let mut pairs = Vec::new();
        for k in 0..5 {
            let p = PixelPoint { x: 900.0 * draws.unit(), y: 700.0 * draws.unit() };
            let map = transform.apply(PixelPoint { x: p.x + draws.unit(), y: p.y + draws.unit() });
            shoot = shoot.with(k, k, (map.easting - 500.0, map.northing - 900.0), p);
            pairs.push(autoref_solve::Pair { pixel: p, covariance_px2: None, map, survey_sigma_m: None });
        }
        // Fitted from map to pixels here, from pixels to the map there: equal to first order of the residuals.
        let similarity = fit_equal_weights(&pairs).expect("five pairs");
        for (east, north) in [(0.0, 0.0), (100.0, -60.0), (-80.0, 40.0)] {
            let (place, spread) = shoot.expects((east, north));
            let p = similarity.invert(MapPoint { easting: 500.0 + east, northing: 900.0 + north });
            assert!((place.x - p.x).hypot(place.y - p.y) < 0.02, "{place:?} {p:?}");
            assert!(spread > 1.0);
        }
    }
}
