//! The search through pairs: which hypotheses there are, in what order, and what each of them hits.

use std::sync::OnceLock;

use crate::candidate::Candidate;
use crate::matching::Priors;
use crate::matching::bitmap::Bitmap;
use crate::matching::distances::Distances;
use crate::matching::evidence::{CLOSEST_PX, log10_of_levels, log10_tail};
use crate::matching::field::Field;
use crate::matching::labels::Names;
use crate::matching::pairs::{GcpPair, gcp_pairs};
use crate::matching::screening::Screening;
use crate::matching::targets::{Target, Targets};
use autoref_raster::coords::{MapPoint, PixelPoint};
use autoref_solve::Similarity;

/// Search tolerance for the error of one mark, pixels; it grows with the distance from the pair. The orthophoto's own
/// errors are in it, not only the marks'.
const SEARCH_TOLERANCE_PX: (f64, f64) = (1.5, 5.0);
/// How often a chance candidate may lie within the tolerance: where they crowd, the tolerance gives way.
const CHANCE_HIT: f64 = 0.02;
/// Hypotheses of one GCP pair that are refined.
pub(super) const REFINED_PER_PAIR: usize = 6;
/// From so many candidates on, pairs of GCPs are weighed before they are tried.
const CROWD: usize = 3000;
/// Looks at other GCPs of which one takes as long as the rest of a hypothesis.
pub(super) const LOOKS_OF_ONE: u64 = 16;
/// How often a search that tries pairs in a random order may miss a pattern that could be believed.
const PATTERN_MISSED: f64 = 0.01;
/// From so many points on hypotheses of a known scale are dropped too that hit nothing with their first looks, ...
pub(super) const LONG: usize = 60;
/// ... few enough that a pattern is noticed by one in so many of its pairs.
const PAIRS_BY_BUDGET: usize = 4;
/// So many points in the box about a pair's first end for each that may be at the other make it worth the sorting of
/// all distances.
const MOSTLY_OTHERS: f64 = 4.0;
/// No hypothesis must hit more than this to be scored.
pub(super) const MOST_DEMANDED: usize = 4;
/// More hits than this leave no doubt.
const MOST_HITS: usize = 32;

/// What a hypothesis must hit to be scored.
#[derive(Clone, Copy)]
pub(super) struct Demand {
    pub fewest: usize,
    pub first_looks: usize,
}

/// From the first GCP of a pair to the second, metres.
#[derive(Clone, Copy)]
pub(super) struct Span {
    east: f64,
    north: f64,
    square: f64,
}

impl Span {
    /// The factor z of pixels = from + z · (map offset), real and imaginary part: z = (to − from) / (b − a), with up
    /// along the imaginary axis.
    #[inline(always)]
    pub fn factor(self, from: PixelPoint, to: PixelPoint) -> (f64, f64) {
        let (x, y) = (to.x - from.x, -(to.y - from.y));
        ((x * self.east + y * self.north) / self.square, (y * self.east - x * self.north) / self.square)
    }
}

/// A target that a candidate may be near.
#[derive(Clone, Copy)]
pub(super) struct MayHit {
    /// Its place in the order of the targets.
    pub target: usize,
    /// How surprising a hit is where candidates lie as densely as in the whole field: most of it is.
    pub surprise: f64,
}

/// −ln of how often chance puts a candidate within a radius, where so many lie on a px².
fn surprise(density: f64, radius_px: f64) -> f64 {
    -(-(-density * (std::f64::consts::PI * radius_px * radius_px)).exp_m1()).ln()
}

/// What was done: a hypothesis at a time, and the looks that all of them took.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Tried {
    pub hypotheses: u64,
    pub looks: u64,
}

impl std::ops::Add for Tried {
    type Output = Tried;

    fn add(self, other: Tried) -> Tried {
        Tried { hypotheses: self.hypotheses + other.hypotheses, looks: self.looks + other.looks }
    }
}

/// A pair of GCPs laid on two candidates.
#[derive(Clone, Copy)]
pub(super) struct Laid {
    /// The candidates, by index.
    pub ends: (usize, usize),
    /// Where the first is.
    pub from: PixelPoint,
    /// See [`Span::factor`].
    pub z: (f64, f64),
}

impl Laid {
    /// Where a target is then.
    #[inline(always)]
    pub fn place(&self, target: &Target) -> PixelPoint {
        let Laid { from, z, .. } = self;
        PixelPoint {
            x: from.x + z.0 * target.east - z.1 * target.north,
            y: from.y - (z.0 * target.north + z.1 * target.east),
        }
    }
}

#[derive(Clone, Copy)]
pub(super) struct Hypothesis {
    pub score: f64,
    pub i: u32,
    pub j: u32,
}

pub(super) struct Search<'a> {
    pub field: Field,
    pub(super) bitmaps: Vec<Bitmap>,
    pub gcps: &'a [MapPoint],
    pub(super) priors: &'a Priors,
    pub log10_tests: f64,
    /// Search tolerance in this field, pixels.
    pub tolerance_px: f64,
    /// What coded targets say of themselves, where it is heeded.
    pub names: Option<Names>,
    /// Worked out when the first pair asks for it.
    distances: OnceLock<Option<Distances>>,
}

impl<'a> Search<'a> {
    /// The field ready for searching, the pairs of GCPs in order of trying, and the number of hypotheses that the
    /// priors allow; `None` when they allow none.
    pub fn new(
        candidates: &[&Candidate],
        gcps: &'a [MapPoint],
        priors: &'a Priors,
        log10_searches: f64,
    ) -> Option<(Search<'a>, Vec<GcpPair>, f64)> {
        let side = |c: &&Candidate| c.size_px.map_or(0.0, |[w, h]| w.max(h));
        let field = Field::new(candidates.iter().map(|c| c.centre).collect(), priors.image_size_px)
            .with_sizes(candidates.iter().map(side).collect());
        let (pairs, possible) = gcp_pairs(&field, gcps, priors);
        if pairs.is_empty() {
            return None;
        }
        // Of few marks narrow priors leave less than one by chance; one test is made all the same.
        let possible = possible.max(1.0);
        let bitmaps = Bitmap::all(&field);
        let density = field.density();
        let (least, most) = SEARCH_TOLERANCE_PX;
        let tolerance_px = (CHANCE_HIT / (std::f64::consts::PI * density)).sqrt().clamp(least, most);
        let log10_tests = possible.log10() + log10_searches;
        let distances = OnceLock::new();
        let search = Search { field, bitmaps, gcps, priors, log10_tests, tolerance_px, names: None, distances };
        let pairs = search.telling_first(pairs);
        Some((search, pairs, possible))
    }

    /// So many pairs of GCPs in a random order that one of them is noticed, but for one case in a hundred, if there is
    /// a pattern to be believed (after M. A. Fischler and R. C. Bolles, "Random sample consensus", 1981): both its
    /// marks are in the image, and one of the first looks hits a third (after J. Matas and O. Chum, "Randomized RANSAC
    /// with T(d,d) test", 2004; theirs asks all looks to hit). As many first looks as make the search shortest; all
    /// pairs and all looks where the order is not random.
    pub fn screening(&self, log10_limit: f64, pairs: usize) -> Screening {
        let whole = Screening { pairs, first_looks: Screening::EVERY_LOOK };
        let in_random_order = !self.priors.narrow_by_scale();
        if self.gcps.len() < 3 || (!in_random_order && self.gcps.len() < LONG) {
            return whole;
        }
        // The fewest marks that could ever be believed: each as near as can be, all points in the image.
        let density = self.field.density();
        let closest = -(-density * std::f64::consts::PI * 1.5 * CLOSEST_PX * CLOSEST_PX).exp_m1();
        let chances = vec![closest; self.gcps.len() - 2];
        let believed = |hits: &usize| self.log10_tests + log10_of_levels() + log10_tail(&chances, *hits) <= log10_limit;
        let Some(hits) = (1..=chances.len()).find(believed) else { return whole };
        if in_random_order {
            return Screening::shortest(hits, chances.len(), pairs, PATTERN_MISSED);
        }
        // The budget may end before all pairs were tried.
        let marks = hits + 2;
        let first_looks =
            Screening::of_all_pairs(hits, chances.len(), marks * (marks - 1) / 2 / PAIRS_BY_BUDGET, PATTERN_MISSED);
        Screening { pairs, first_looks }
    }

    /// With names, which forbid pairs.
    #[must_use]
    pub fn heeding(mut self, names: Option<Names>) -> Self {
        self.names = names;
        self
    }

    /// Whether the priors allow a similarity.
    pub fn possible(&self, similarity: &Similarity) -> bool {
        let scale = similarity.scale_m_per_px();
        let off = |centre: f64| (similarity.rotation_deg() - centre).rem_euclid(360.0);
        self.priors.gsd_m_per_px.is_none_or(|(low, high)| (low..=high).contains(&scale))
            && self.priors.rotation_deg.is_none_or(|(centre, half)| off(centre).min(360.0 - off(centre)) <= half)
    }

    /// In a crowd the cheapest pairs tell nothing: seen from a short base the other GCPs may be anywhere, and somebody
    /// is everywhere. Pairs whose true hypothesis would stand out among all chance ones come first, then the rest, both
    /// in the order in which they came.
    fn telling_first(&self, pairs: Vec<GcpPair>) -> Vec<GcpPair> {
        if self.field.points().len() < CROWD || pairs.len() * self.gcps.len() > 20_000_000 {
            return pairs;
        }
        let (mut telling, rest): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|pair| {
            // Less what choosing the hits costs, and a fifth for marks that are covered.
            let surprise = |t: &Target| surprise(self.field.density(), t.radius_px);
            let targets = self.targets(pair, self.tolerance_px, usize::MAX);
            let worth: f64 = targets.all().iter().map(|t| (surprise(t) - 1.0).max(0.0)).sum::<f64>() * 0.8;
            worth > pair.cost.max(1.0).ln()
        });
        telling.extend(rest);
        telling
    }

    /// Calls `visit` with every point that the priors allow at the second end of a pair when `i` is at the first.
    #[inline]
    pub fn ends_of(&self, pair: &GcpPair, i: usize, mut visit: impl FnMut(usize, PixelPoint)) {
        if !self.allows(i, pair.a) {
            return;
        }
        let from = self.field.points()[i];
        let (left, right, up, down) = self.sector(pair);
        self.field.in_box((from.x + left, from.x + right), (from.y + up, from.y + down), |j, to| {
            if i != j && self.allows(j, pair.b) && self.may_span(pair, from, to) {
                visit(j, to);
            }
        });
    }

    /// Calls `visit` with all points at the two ends of a pair that the priors allow, in no order.
    pub fn all_ends(&self, pair: &GcpPair, mut visit: impl FnMut((usize, usize))) {
        let points = self.field.points();
        let distances = self.is_ring(pair).then(|| self.distances.get_or_init(|| Distances::of(points)).as_ref());
        let Some(distances) = distances.flatten() else {
            (0..points.len()).for_each(|i| self.ends_of(pair, i, |j, _| visit((i, j))));
            return;
        };
        distances.between(pair.reach_px, |i, j| {
            if self.allows(i, pair.a) && self.allows(j, pair.b) && self.may_span(pair, points[i], points[j]) {
                visit((i, j));
            }
        });
    }

    /// Whether the second ends lie in so narrow a ring about the first that the box about it mostly holds others.
    fn is_ring(&self, pair: &GcpPair) -> bool {
        let (left, right, up, down) = self.sector(pair);
        let (width, height) = ((right - left).min(self.field.width_px), (down - up).min(self.field.height_px));
        let points = self.field.points().len() as f64;
        points * width * height * self.field.density() > MOSTLY_OTHERS * (points + pair.cost)
    }

    /// Fewer further hits than this could never be believed, however close they are.
    pub(super) fn fewest_hits(&self, targets: &Targets<'_>, tolerance_px: f64) -> usize {
        let density = self.field.density();
        let closest = |t: &Target| {
            let radius = t.radius_px / tolerance_px * CLOSEST_PX;
            -(-density * std::f64::consts::PI * radius * radius).exp_m1()
        };
        let probabilities: Vec<f64> = targets.first(MOST_DEMANDED).iter().map(closest).collect();
        // A hypothesis sees only the GCPs in the image; the tail over the surest few is the most favourable case.
        (1..=probabilities.len())
            .find(|&hits| self.log10_tests + log10_tail(&probabilities[..hits], hits) <= -1.0)
            .unwrap_or(probabilities.len() + 1)
            .min(MOST_DEMANDED)
    }

    /// Whether the priors allow points at these places to be a pair.
    #[inline]
    pub(super) fn may_span(&self, pair: &GcpPair, from: PixelPoint, to: PixelPoint) -> bool {
        let (low, high) = pair.reach_px;
        let (x, y) = (to.x - from.x, to.y - from.y);
        let d2 = x * x + y * y;
        d2 >= low * low
            && d2 <= high * high
            && (self.priors.rotation_deg.is_none() || self.turned_right(self.span(pair).factor(from, to)))
    }

    pub(super) fn span(&self, pair: &GcpPair) -> Span {
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        let (east, north) = (b.easting - a.easting, b.northing - a.northing);
        Span { east, north, square: east * east + north * north }
    }

    /// Bounds of `to − from`, pixels, that scale and rotation priors allow: left, right, up, down.
    pub(super) fn sector(&self, pair: &GcpPair) -> (f64, f64, f64, f64) {
        let (low, high) = pair.reach_px;
        let Some((centre, half)) = self.priors.rotation_deg.filter(|(_, half)| *half < 90.0) else {
            return (-high, high, -high, high);
        };
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        // Seen in the image, a map direction is turned back by the image's rotation; pixel y runs down.
        let direction = (b.northing - a.northing).atan2(b.easting - a.easting) - centre.to_radians();
        let half = half.to_radians();
        let mut angles = vec![direction - half, direction + half];
        let quarter = std::f64::consts::FRAC_PI_2;
        let first = ((direction - half) / quarter).ceil() as i64;
        let last = ((direction + half) / quarter).floor() as i64;
        angles.extend((first..=last).map(|k| k as f64 * quarter));
        let mut bounds = (f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY);
        for angle in angles {
            for radius in [low, high] {
                let (x, y) = (radius * angle.cos(), -radius * angle.sin());
                bounds = (bounds.0.min(x), bounds.1.max(x), bounds.2.min(y), bounds.3.max(y));
            }
        }
        bounds
    }

    /// Whether the rotation prior allows map → pixel factor z; the image's rotation is its negative.
    fn turned_right(&self, (z_re, z_im): (f64, f64)) -> bool {
        self.priors.rotation_deg.is_none_or(|(centre, half)| {
            let rotation = (-z_im).atan2(z_re).to_degrees();
            let off = (rotation - centre).rem_euclid(360.0);
            off.min(360.0 - off) <= half
        })
    }

    /// How many targets a hypothesis puts into the field.
    pub(super) fn inside(&self, laid: Laid, targets: &[Target]) -> usize {
        targets.iter().map(|target| usize::from(self.field.contains(laid.place(target)))).sum()
    }

    /// The candidate that a hypothesis has for a target.
    #[inline]
    pub(super) fn hit(&self, laid: Laid, target: &Target) -> Option<usize> {
        let p = laid.place(target);
        let (candidate, _) =
            self.field.contains(p).then(|| self.nearest_allowed(p, target.radius_px, target.gcp))??;
        (candidate != laid.ends.0 && candidate != laid.ends.1).then_some(candidate)
    }

    /// A target that a candidate may be near.
    pub(super) fn may_hit(&self, targets: &[Target], target: usize) -> MayHit {
        MayHit { target, surprise: surprise(self.field.density(), targets[target].radius_px) }
    }

    /// Sum of the hits' surprise less that of choosing them, or `None` when too few are hit. A candidate counts for one
    /// GCP only, and for little where candidates crowd: otherwise the best hypotheses would be those that squeeze all
    /// GCPs into one clump. `may_hit` are in the order of the targets; `inside` of these are in the field.
    pub(super) fn verify(
        &self,
        laid: Laid,
        targets: &[Target],
        (may_hit, inside): (&[MayHit], usize),
        demand: Demand,
    ) -> Option<f64> {
        let Demand { fewest, first_looks } = demand;
        let (mut hits, mut surprising) = (0usize, 0.0);
        let mut hit = [u32::MAX; MOST_HITS];
        for here in may_hit {
            if hits == MOST_HITS || (hits == 0 && here.target >= first_looks) {
                break;
            }
            let target = &targets[here.target];
            if let Some(candidate) = self.hit(laid, target)
                && !hit[..hits].contains(&(candidate as u32))
            {
                hit[hits] = candidate as u32;
                hits += 1;
                // Most of the field is as dense as the whole.
                let density = self.field.density_at(candidate);
                surprising += match density == self.field.density() {
                    true => here.surprise,
                    false => surprise(density, target.radius_px),
                };
            }
        }
        (hits >= fewest).then(|| surprising - hits as f64 * cost_of_choice(hits, inside))
    }
}

/// What it costs, for each of so many hits, to have chosen them among the targets in the field: −ln of the chance.
pub(super) fn cost_of_choice(hits: usize, inside: usize) -> f64 {
    (std::f64::consts::E * inside.max(hits) as f64 / hits as f64).ln()
}

pub(super) fn keep_best(hypotheses: &mut Vec<Hypothesis>) {
    // A total order, so that the result does not depend on which thread came first.
    hypotheses.sort_by(|s, t| t.score.total_cmp(&s.score).then((s.i, s.j).cmp(&(t.i, t.j))));
    hypotheses.truncate(REFINED_PER_PAIR);
}
