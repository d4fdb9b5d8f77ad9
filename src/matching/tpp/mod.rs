//! Topological point patterns, the matcher of the 2016 thesis, kept for comparison.
//!
//! After Y. Li and R. Briggs, "Automated georeferencing based on topological point pattern matching", 2006: seen from
//! an anchor point, all others have a radius in units of the distance to the anchor's nearest neighbour, and a
//! direction from that neighbour's. Patterns of the same anchor in image and list agree whatever shift, rotation and
//! scale. Both lists are sorted and walked together; points whose radius and angle agree within thresholds are matched.
//!
//! Repairs against the thesis's program: angles are taken over the full circle (its remainder by π folds opposite
//! directions together), sorting is by radius and then by the absolute angle from the axis (its eq. 2.8), and every
//! difference of angles, the look-ahead's too, wraps at 2π. The thesis then took the match of the smallest RMSE, which
//! favours few points; here a proposal is settled and weighed like any other hypothesis, and believed only when an
//! accident is unlikely enough. Names of coded targets are not heeded.
//!
//! In three dimensions ([`Space::Solid`], the wish of its section 5.6) radii are lengths in space and directions have
//! an elevation angle. The vertical is the same in image and list, as it is in an orthophoto with its elevation model,
//! so that one neighbour is enough for an axis.

mod pattern;

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::candidate::Candidate;
use crate::gcp::Gcp;
use crate::matching::robust::{Found, RobustMatcher, control_points};
use crate::matching::search::Search;
use crate::matching::{MatchOutcome, Matcher, Pattern, Priors};
use autoref_raster::coords::MapPoint;
use autoref_raster::random::SplitMix64;
use autoref_solve::similarity::{Pair, fit_equal_weights};

pub use pattern::{Seen, Thresholds};

/// Which image points serve as anchors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Anchors {
    /// Every candidate.
    #[default]
    All,
    /// The candidate of this index only.
    One(usize),
    /// So many, drawn without repetition from a generator with this seed; the thesis's default drew one.
    Random { count: usize, seed: u64 },
}

/// What a pattern is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Space {
    /// Places on the map.
    #[default]
    Plane,
    /// Places and heights; elevations of candidates, metres, count this many metres to a pixel. Points without a height
    /// take no part in the patterns.
    Solid { gsd_m: f64 },
}

/// The matcher with its thresholds.
#[derive(Clone, Debug)]
pub struct TppMatcher {
    pub near: Thresholds,
    /// Fewest matched points (the anchor included) of a proposal.
    pub minimum_matches: usize,
    /// When nothing is believed, one match fewer is asked for, and so on down to this; at least three.
    pub least_matches: usize,
    pub anchors: Anchors,
    pub space: Space,
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
            near: Thresholds { radius: 0.05, angle: 0.05 },
            minimum_matches: 5,
            least_matches: 5,
            anchors: Anchors::All,
            space: Space::Plane,
            max_distance: f64::INFINITY,
            image_limit: false,
            gcp_limit: false,
            max_false_alarms: 1e-4,
        }
    }
}

/// Two patterns laid on each other.
#[derive(Clone, Debug)]
pub struct Overlay {
    /// Index of the candidate and of the GCP that are the anchors.
    pub anchors: (usize, usize),
    pub image: Vec<Seen>,
    pub gcps: Vec<Seen>,
    /// Places in `image` and in `gcps` that were matched.
    pub pairs: Vec<(usize, usize)>,
}

/// Points that take part, with the number of each in its list.
struct Points {
    places: Vec<Vector3<f64>>,
    numbers: Vec<usize>,
}

impl Points {
    fn new(all: impl Iterator<Item = Option<Vector3<f64>>>) -> Points {
        let (numbers, places) = all.enumerate().filter_map(|(i, place)| Some((i, place?))).unzip();
        Points { places, numbers }
    }
}

impl Matcher for TppMatcher {
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome {
        let (control, positions) = control_points(gcps);
        let judge = RobustMatcher { max_false_alarms: self.max_false_alarms, ..RobustMatcher::default() };
        let all: Vec<&Candidate> = candidates.iter().collect();
        let decide = |found: Found| judge.decide(found, candidates.len(), (gcps, &control), priors);
        let mut outcome = decide(Found::default());
        let (image, list) = self.points(candidates, gcps, &control);
        if image.places.len() < 3 || list.places.len() < 3 {
            return outcome;
        }
        let Some((search, _, possible)) = Search::new(&all, &positions, priors, 0.0) else { return outcome };
        let patterns = self.patterns(&list);
        let anchors = self.chosen(image.places.len());
        let most = self.minimum_matches.max(3);
        for minimum in (self.least_matches.clamp(3, most)..=most).rev() {
            let mut found = Found::default();
            found.effort.hypotheses_possible = possible;
            found.effort.hypotheses_tried = (anchors.len() * patterns.len()) as u64;
            let settle = |pairs: Vec<(usize, usize)>| settled(&search, candidates, &positions, pairs);
            let proposals: Vec<Pattern> = self
                .proposals(&image, &list, &patterns, &anchors, minimum)
                .into_par_iter()
                .filter_map(settle)
                .collect();
            for pattern in proposals.into_iter().filter(|p| allowed(p.similarity, priors)) {
                found.take(pattern, &search);
            }
            outcome = decide(found);
            if matches!(outcome, MatchOutcome::Solved(_)) {
                break;
            }
        }
        outcome
    }
}

/// The least-squares pattern of a proposal.
fn settled(
    search: &Search,
    candidates: &[Candidate],
    positions: &[MapPoint],
    pairs: Vec<(usize, usize)>,
) -> Option<Pattern> {
    let pair = |&(c, g): &(usize, usize)| Pair {
        pixel: candidates[c].centre,
        covariance_px2: None,
        map: positions[g],
        survey_sigma_m: None,
    };
    let fitted: Vec<Pair> = pairs.iter().map(pair).collect();
    search.settle(fit_equal_weights(&fitted)?, pairs)
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

impl TppMatcher {
    /// Candidates and control points, east, north, up, in one unit each.
    fn points(&self, candidates: &[Candidate], gcps: &[Gcp], control: &[usize]) -> (Points, Points) {
        let up = |height: Option<f64>| match self.space {
            Space::Plane => Some(0.0),
            Space::Solid { .. } => height,
        };
        let gsd_m = if let Space::Solid { gsd_m } = self.space { gsd_m } else { 1.0 };
        let image = candidates.iter().map(|c| Some(Vector3::new(c.centre.x, -c.centre.y, up(c.elevation_m)? / gsd_m)));
        let list = control.iter().map(|&g| {
            let at = gcps[g].position();
            Some(Vector3::new(at.easting, at.northing, up(gcps[g].height)?))
        });
        (Points::new(image), Points::new(list))
    }

    fn patterns(&self, points: &Points) -> Vec<Vec<Seen>> {
        (0..points.places.len()).map(|i| pattern::pattern(&points.places, i, self.max_distance)).collect()
    }

    fn chosen(&self, points: usize) -> Vec<usize> {
        match self.anchors {
            Anchors::All => (0..points).collect(),
            Anchors::One(index) => vec![index.min(points - 1)],
            Anchors::Random { count, seed } => {
                let mut left: Vec<usize> = (0..points).collect();
                let mut random = SplitMix64(seed);
                let mut drawn: Vec<usize> = (0..count.min(points))
                    .map(|_| left.swap_remove((random.unit() * left.len() as f64) as usize))
                    .collect();
                drawn.sort_unstable();
                drawn
            }
        }
    }

    /// Pairs (candidate, control point) of every two patterns that match in `minimum` points or more, anchors included.
    fn proposals(
        &self,
        image: &Points,
        list: &Points,
        patterns: &[Vec<Seen>],
        anchors: &[usize],
        minimum: usize,
    ) -> Vec<Vec<(usize, usize)>> {
        let of_anchor = |&anchor: &usize| {
            let seen = pattern::pattern(&image.places, anchor, self.max_distance);
            let pairs = |(g, other): (usize, &Vec<Seen>)| {
                let numbers = |&(i, j): &(usize, usize)| (image.numbers[seen[i].index], list.numbers[other[j].index]);
                let mut pairs: Vec<_> = self.walk(&seen, other).iter().map(numbers).collect();
                pairs.push((image.numbers[anchor], list.numbers[g]));
                (pairs.len() >= minimum).then_some(pairs)
            };
            patterns.iter().enumerate().filter_map(pairs).collect::<Vec<_>>()
        };
        anchors.par_iter().flat_map_iter(of_anchor).collect()
    }

    fn walk(&self, image: &[Seen], gcps: &[Seen]) -> Vec<(usize, usize)> {
        let reach = |pattern: &[Seen], limit: bool, other: &[Seen]| {
            let farthest = other.last().map_or(0.0, |s| s.radius + self.near.radius);
            if limit { pattern.partition_point(|s| s.radius <= farthest) } else { pattern.len() }
        };
        let image = &image[..reach(image, self.image_limit, gcps)];
        let gcps = &gcps[..reach(gcps, self.gcp_limit, image)];
        pattern::matched(image, gcps, self.near)
    }

    /// The two patterns that agree in most points: of the anchors among `believed` pairs (candidate, GCP), or of all
    /// when there are none. `None` when no two patterns have a point in common.
    pub fn overlay(&self, candidates: &[Candidate], gcps: &[Gcp], believed: &[(usize, usize)]) -> Option<Overlay> {
        let (control, _) = control_points(gcps);
        let (image, list) = self.points(candidates, gcps, &control);
        if image.places.is_empty() {
            return None;
        }
        let patterns = self.patterns(&list);
        let best_of = |anchor: usize| {
            let seen = pattern::pattern(&image.places, anchor, self.max_distance);
            let number = image.numbers[anchor];
            let overlay = |(g, other): (usize, &Vec<Seen>)| {
                let gcp = control[list.numbers[g]];
                let pairs = self.walk(&seen, other);
                let fits = !pairs.is_empty() && (believed.is_empty() || believed.contains(&(number, gcp)));
                fits.then_some((g, pairs))
            };
            let (g, pairs) = patterns.iter().enumerate().filter_map(overlay).max_by_key(|(_, pairs)| pairs.len())?;
            Some((anchor, g, seen, pairs))
        };
        let (anchor, g, mut seen, pairs) =
            self.chosen(image.places.len()).into_iter().filter_map(best_of).max_by_key(|(.., pairs)| pairs.len())?;
        let mut other = patterns.into_iter().nth(g).expect("a pattern for every point");
        seen.iter_mut().for_each(|s| s.index = image.numbers[s.index]);
        other.iter_mut().for_each(|s| s.index = control[list.numbers[s.index]]);
        Some(Overlay { anchors: (image.numbers[anchor], control[list.numbers[g]]), image: seen, gcps: other, pairs })
    }
}
