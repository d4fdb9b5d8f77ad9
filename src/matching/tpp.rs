//! Topological point patterns, the matcher of the 2016 thesis, kept for comparison.
//!
//! After Y. Li and R. Briggs, "Automated georeferencing based on topological point pattern matching", 2006: seen from an
//! anchor point, all others have a radius in units of the distance to the anchor's nearest neighbour, and an angle from the
//! direction to it. Patterns of the same anchor in image and list agree whatever shift, rotation and scale. Both lists are
//! sorted and walked together; points whose radius and angle agree within thresholds are matched.
//!
//! Repairs against the thesis's program: angles are taken over the full circle (its remainder by π folds opposite
//! directions together), sorting is by radius and then by the absolute angle from the axis (its eq. 2.8), and every
//! difference of angles, the look-ahead's too, wraps at 2π. The thesis then took the match of the smallest RMSE, which
//! favours few points; here a proposal is settled and weighed like any other hypothesis, and believed only when an accident
//! is unlikely enough. Names of coded targets are not heeded.

use std::f64::consts::TAU;

use rayon::prelude::*;

use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::matching::robust::{Found, RobustMatcher, control_points};
use crate::matching::search::Search;
use crate::matching::{MatchOutcome, Matcher, Priors};
use autoref_raster::coords::PixelPoint;
use autoref_solve::similarity::{Pair, fit_equal_weights};

/// Which image points serve as anchors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Anchors {
    /// Every candidate.
    #[default]
    All,
    /// The candidate of this index only, as the thesis's default did with a random one.
    One(usize),
}

/// The matcher with its thresholds.
#[derive(Clone, Debug)]
pub struct TppMatcher {
    /// Largest difference of radii, in units of the pattern.
    pub radius_threshold: f64,
    /// Largest difference of angles, radians.
    pub angle_threshold: f64,
    /// Fewest matched points (the anchor included) of a proposal.
    pub minimum_matches: usize,
    pub anchors: Anchors,
    /// Points farther from the anchor than this, in units of the pattern, are left out.
    pub max_distance: f64,
    /// Leave out image points farther from their anchor than any GCP from its own.
    pub image_limit: bool,
    /// Leave out GCPs farther from their anchor than any image point from its own.
    pub gcp_limit: bool,
    pub max_false_alarms: f64,
}

impl Default for TppMatcher {
    /// Thresholds of 0.05, which the thesis found by trial; everything else as in its program, with all anchors.
    fn default() -> Self {
        TppMatcher {
            radius_threshold: 0.05,
            angle_threshold: 0.05,
            minimum_matches: 5,
            anchors: Anchors::All,
            max_distance: f64::INFINITY,
            image_limit: false,
            gcp_limit: false,
            max_false_alarms: 1e-4,
        }
    }
}

/// A point as its anchor sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Seen {
    radius: f64,
    /// Anticlockwise from the axis, in [0, 2π).
    angle: f64,
    index: usize,
}

impl Matcher for TppMatcher {
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome {
        let (control, positions) = control_points(gcps);
        let judge = RobustMatcher { max_false_alarms: self.max_false_alarms, ..RobustMatcher::default() };
        let mut found = Found::default();
        let points: Vec<PixelPoint> = candidates.iter().map(|c| c.centre).collect();
        if points.len() >= 3
            && positions.len() >= 3
            && let Some((search, _, possible)) =
                Search::new(&candidates.iter().collect::<Vec<_>>(), &positions, priors, 0.0)
        {
            found.effort.hypotheses_possible = possible;
            let upright: Vec<(f64, f64)> = points.iter().map(|p| (p.x, -p.y)).collect();
            let map: Vec<(f64, f64)> = positions.iter().map(|m| (m.easting, m.northing)).collect();
            let gcp_patterns: Vec<Vec<Seen>> = (0..map.len()).map(|i| self.pattern(&map, i)).collect();
            let anchors: Vec<usize> = match self.anchors {
                Anchors::All => (0..points.len()).collect(),
                Anchors::One(index) => vec![index.min(points.len() - 1)],
            };
            found.effort.hypotheses_tried = (anchors.len() * map.len()) as u64;
            let proposals: Vec<_> = anchors
                .into_par_iter()
                .flat_map_iter(|anchor| {
                    let image = self.pattern(&upright, anchor);
                    let settle = |(g, list): (usize, &Vec<Seen>)| {
                        let mut pairs = self.matched(&image, list);
                        pairs.push((anchor, g));
                        if pairs.len() < self.minimum_matches.max(3) {
                            return None;
                        }
                        let fitted: Vec<Pair> = pairs
                            .iter()
                            .map(|&(c, g)| Pair {
                                pixel: points[c],
                                covariance_px2: None,
                                map: positions[g],
                                survey_sigma_m: None,
                            })
                            .collect();
                        search.settle(fit_equal_weights(&fitted)?, pairs)
                    };
                    gcp_patterns.iter().enumerate().filter_map(settle).collect::<Vec<_>>()
                })
                .collect();
            for pattern in proposals.into_iter().filter(|p| allowed(p.similarity, priors)) {
                found.take(pattern, &search);
            }
        }
        judge.decide(found, candidates.len(), &control)
    }
}

/// Whether scale and rotation agree with what was known before.
fn allowed(similarity: autoref_solve::Similarity, priors: &Priors) -> bool {
    let scale = similarity.scale_m_per_px();
    priors.gsd_m_per_px.is_none_or(|(low, high)| (low..=high).contains(&scale))
        && priors.rotation_deg.is_none_or(|(centre, half)| {
            let off = (similarity.rotation_deg() - centre).rem_euclid(360.0);
            off.min(360.0 - off) <= half
        })
}

/// The smaller way round between two angles.
fn turn(a: f64, b: f64) -> f64 {
    let off = (a - b).rem_euclid(TAU);
    off.min(TAU - off)
}

impl TppMatcher {
    /// All other points as `anchor` sees them, sorted by radius, then by absolute angle from the axis. Empty when all
    /// points lie in one place.
    fn pattern(&self, points: &[(f64, f64)], anchor: usize) -> Vec<Seen> {
        let from = points[anchor];
        let away = |p: (f64, f64)| (p.0 - from.0, p.1 - from.1);
        let others = || (0..points.len()).filter(|&i| away(points[i]) != (0.0, 0.0));
        let length = |i: usize| away(points[i]).0.hypot(away(points[i]).1);
        let Some(nearest) = others().min_by(|&a, &b| length(a).total_cmp(&length(b))) else { return Vec::new() };
        let (unit, axis) = (length(nearest), away(points[nearest]).1.atan2(away(points[nearest]).0));
        let mut seen: Vec<Seen> = others()
            .map(|index| {
                let (dx, dy) = away(points[index]);
                Seen { radius: length(index) / unit, angle: (dy.atan2(dx) - axis).rem_euclid(TAU), index }
            })
            .filter(|s| s.radius <= self.max_distance)
            .collect();
        seen.sort_by(|a, b| a.radius.total_cmp(&b.radius).then(turn(a.angle, 0.0).total_cmp(&turn(b.angle, 0.0))));
        seen
    }

    /// Pairs (image, GCP) of two patterns, walked together.
    fn matched(&self, image: &[Seen], gcps: &[Seen]) -> Vec<(usize, usize)> {
        let reach = |pattern: &[Seen], limit: bool, other: &[Seen]| {
            let farthest = other.last().map_or(0.0, |s| s.radius + self.radius_threshold);
            if limit { pattern.partition_point(|s| s.radius <= farthest) } else { pattern.len() }
        };
        let image = &image[..reach(image, self.image_limit, gcps)];
        let gcps = &gcps[..reach(gcps, self.gcp_limit, image)];
        let close = |a: &Seen, b: &Seen| (a.radius - b.radius).abs() <= self.radius_threshold;
        let (mut i, mut j) = (0, 0);
        let mut pairs = Vec::new();
        while i < image.len() && j < gcps.len() {
            let (a, b) = (&image[i], &gcps[j]);
            let off = turn(a.angle, b.angle);
            if close(a, b) && off <= self.angle_threshold {
                pairs.push((a.index, b.index));
                i += 1;
                j += 1;
            } else if !close(a, b) {
                if a.radius < b.radius { i += 1 } else { j += 1 }
            } else {
                // The radii agree, the angles do not: skip whichever point's successor fits the other one better.
                let ahead = |a: Option<&Seen>, b: Option<&Seen>| match (a, b) {
                    (Some(a), Some(b)) if close(a, b) => turn(a.angle, b.angle),
                    _ => f64::INFINITY,
                };
                let (skip_image, skip_gcp) = (ahead(image.get(i + 1), Some(b)), ahead(Some(a), gcps.get(j + 1)));
                if skip_image.min(skip_gcp) >= off {
                    // Neither helps: the one with the smaller radius has had its chance.
                    if a.radius <= b.radius { i += 1 } else { j += 1 }
                } else if skip_image <= skip_gcp {
                    i += 1;
                } else {
                    j += 1;
                }
            }
        }
        pairs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_agree_whatever_shift_rotation_and_scale() {
        let points = [(0.0, 0.0), (1.0, 0.2), (3.0, -0.01), (-2.0, 4.0), (5.0, 1.0)];
        let (s, angle) = (3.7, 2.9f64);
        let moved: Vec<(f64, f64)> = points
            .iter()
            .map(|p| {
                (s * (angle.cos() * p.0 - angle.sin() * p.1) + 7.0, s * (angle.sin() * p.0 + angle.cos() * p.1) - 2.0)
            })
            .collect();
        let matcher = TppMatcher::default();
        for anchor in 0..points.len() {
            let pairs = matcher.matched(&matcher.pattern(&points, anchor), &matcher.pattern(&moved, anchor));
            assert_eq!(pairs.len(), points.len() - 1, "anchor {anchor}");
            assert!(pairs.iter().all(|(a, b)| a == b), "anchor {anchor}: {pairs:?}");
        }
    }

    #[test]
    fn angles_just_either_side_of_the_axis_are_close() {
        assert!((turn(0.01, TAU - 0.01) - 0.02).abs() < 1e-12);
        let matcher = TppMatcher::default();
        let seen = |angle: f64| vec![Seen { radius: 2.0, angle, index: 0 }];
        assert_eq!(matcher.matched(&seen(0.01), &seen(TAU - 0.01)).len(), 1);
        // Opposite directions are not: folding by π took them for one.
        assert_eq!(matcher.matched(&seen(0.0), &seen(std::f64::consts::PI)).len(), 0);
    }
}
