//! Blind matching by pairs: hypothesise, verify, refine, weigh.
//!
//! An ordered pair of candidates laid on a pair of GCPs fixes a similarity. Pairs of GCPs are taken in order of how many
//! pairs of candidates can be theirs (short ones first when the scale is roughly known: few candidates lie at the right
//! distance), and every hypothesis predicts where the other GCPs must be, most certain first, so that most are dropped
//! after a few looks into an occupancy bitmap. The best of each GCP pair are refined to a least-squares pattern, whose
//! worth is its number of false alarms ([`super::evidence`]), not its residuals. `docs/decisions/matcher.md` argues the
//! choice.

use rayon::prelude::*;

use crate::candidate::Candidate;
use crate::coords::{MapPoint, PixelPoint};
use crate::gcp::{Gcp, GcpRole};
use crate::matching::bitmap::{Bitmap, WORTHLESS_PROBABILITY};
use crate::matching::evidence::{LEVELS_PX, log10_tail, pair_evidence, spread_from_pair};
use crate::matching::explain::explain;
use crate::matching::field::Field;
use crate::matching::{Effort, MatchOutcome, Matcher, Pattern, Priors, Solved};
use crate::solve::Similarity;
use crate::solve::similarity::{Pair, fit_equal_weights};

/// Marks of a hypothesis closer together than this say nothing about scale and rotation.
const SMALLEST_BASE_PX: f64 = 16.0;
/// Search tolerance for the error of one mark, pixels; it grows with the distance from the pair.
const SEARCH_TOLERANCE_PX: f64 = 5.0;
/// Hypotheses of one GCP pair that are refined.
const REFINED_PER_PAIR: usize = 6;
/// More hits than this leave no doubt.
const MOST_HITS: usize = 32;
/// How much rarer (log₁₀) the best pattern must be than one that says something else.
const RUNNER_UP_GAP: f64 = 2.0;
/// Above this many candidates the best-scored are tried alone first.
const GUIDED_ABOVE: usize = 6000;
const GUIDED_FIRST: usize = 2000;

/// The default matcher.
#[derive(Clone, Debug)]
pub struct RobustMatcher {
    /// A pattern is believed when chance alone would produce no more than this many.
    pub max_false_alarms: f64,
    /// The search ends here, found or not.
    pub budget_hypotheses: u64,
    /// How often the caller may call with other priors: each is a chance for an accident, and counted.
    pub tries: f64,
}

impl Default for RobustMatcher {
    fn default() -> Self {
        RobustMatcher { max_false_alarms: 1e-4, budget_hypotheses: 150_000_000, tries: 1.0 }
    }
}

impl Matcher for RobustMatcher {
    fn find(&self, candidates: &[Candidate], gcps: &[Gcp], priors: &Priors) -> MatchOutcome {
        let (control, positions) = control_points(gcps);
        let found = self.search_guided(candidates, &positions, priors);
        self.decide(found, candidates, &control, &positions, priors)
    }
}

/// Indices and positions of the points that take part.
pub(super) fn control_points(gcps: &[Gcp]) -> (Vec<usize>, Vec<MapPoint>) {
    let control: Vec<usize> = (0..gcps.len()).filter(|&i| gcps[i].role == GcpRole::Control).collect();
    let positions = control.iter().map(|&i| gcps[i].position()).collect();
    (control, positions)
}

impl RobustMatcher {
    /// Believes the best pattern, or says why not.
    pub(super) fn decide(
        &self,
        found: Found,
        candidates: &[Candidate],
        control: &[usize],
        positions: &[MapPoint],
        priors: &Priors,
    ) -> MatchOutcome {
        let restore = |pattern: Pattern| Pattern {
            pairs: pattern.pairs.iter().map(|&(c, g)| (c, control[g])).collect(),
            ..pattern
        };
        let (best, runner_up) = (found.best.map(restore), found.runner_up.map(restore));
        let limit = self.max_false_alarms.log10();
        if let Some(pattern) = &best
            && pattern.log10_false_alarms <= limit
            && gap(pattern, runner_up.as_ref()) >= RUNNER_UP_GAP
        {
            return MatchOutcome::Solved(Box::new(Solved {
                pattern: pattern.clone(),
                runner_up,
                effort: found.effort,
            }));
        }
        let mirrored = self.mirrored(candidates, positions, priors);
        MatchOutcome::NoMatch(Box::new(explain(
            candidates.len(),
            control,
            best,
            runner_up,
            found.effort,
            limit,
            mirrored,
        )))
    }
}

fn gap(best: &Pattern, runner_up: Option<&Pattern>) -> f64 {
    runner_up.map_or(f64::INFINITY, |other| other.log10_false_alarms.min(0.0) - best.log10_false_alarms)
}

/// The best two patterns of a search.
#[derive(Default)]
pub(super) struct Found {
    pub best: Option<Pattern>,
    pub runner_up: Option<Pattern>,
    pub effort: Effort,
}

impl Found {
    pub fn take(&mut self, pattern: Pattern) {
        let better = |one: &Pattern, other: &Option<Pattern>| {
            other.as_ref().is_none_or(|o| one.log10_false_alarms < o.log10_false_alarms)
        };
        if better(&pattern, &self.best) {
            let old = self.best.replace(pattern);
            let best = self.best.as_ref().expect("just placed");
            if self.runner_up.as_ref().is_some_and(|r| same_claim(r, best)) {
                self.runner_up = None;
            }
            if let Some(old) = old.filter(|old| !same_claim(old, best))
                && better(&old, &self.runner_up)
            {
                self.runner_up = Some(old);
            }
        } else if self.best.as_ref().is_some_and(|best| !same_claim(best, &pattern))
            && better(&pattern, &self.runner_up)
        {
            self.runner_up = Some(pattern);
        }
    }
}

/// Two patterns say the same when they put most of their GCPs at the same places: within the sum of their tolerances, so
/// that two candidates on one mark do not make two claims.
fn same_claim(one: &Pattern, other: &Pattern) -> bool {
    let tolerance = 6.0 * (one.noise_px + other.noise_px) + 12.0;
    let shared = one.pairs.iter().filter(|(c, g)| other.pairs.iter().any(|(d, h)| g == h && c == d)).count();
    if 2 * shared > one.pairs.len().min(other.pairs.len()) {
        return true;
    }
    // Different candidates, perhaps of the same marks: compare the transforms where the patterns are.
    let middle = PixelPoint { x: 0.0, y: 0.0 };
    let (a, b) = (one.similarity, other.similarity);
    let there = b.invert(a.apply(middle));
    (there.x - middle.x).hypot(there.y - middle.y) < tolerance
        && (a.scale_m_per_px() / b.scale_m_per_px()).ln().abs() < 0.002
        && (a.rotation_deg() - b.rotation_deg()).abs() < 0.1
}

/// GCPs a and b and what a hypothesis about them predicts.
pub(super) struct GcpPair {
    a: usize,
    b: usize,
    length_m: f64,
    /// Pixel distances that the scale allows.
    reach_px: (f64, f64),
    cost: f64,
}

/// Another GCP as seen from a pair: its offset from `a`, and tolerance.
struct Target {
    east: f64,
    north: f64,
    radius_px: f64,
    bitmap: usize,
}

#[derive(Clone, Copy)]
struct Hypothesis {
    score: f64,
    i: u32,
    j: u32,
}

pub(super) struct Search<'a> {
    field: Field,
    bitmaps: Vec<Bitmap>,
    gcps: &'a [MapPoint],
    priors: &'a Priors,
    log10_tests: f64,
}

impl RobustMatcher {
    /// All candidates, or first the best-scored of very many.
    fn search_guided(&self, candidates: &[Candidate], gcps: &[MapPoint], priors: &Priors) -> Found {
        let points = |indices: &[usize]| indices.iter().map(|&i| candidates[i].centre).collect::<Vec<_>>();
        let all: Vec<usize> = (0..candidates.len()).collect();
        if candidates.len() <= GUIDED_ABOVE || candidates.iter().any(|c| c.score.is_none()) {
            return self.search(points(&all), gcps, priors, self.tries.log10());
        }
        let mut ranked = all.clone();
        let score = |i: usize| candidates[i].score.unwrap_or(f64::NEG_INFINITY);
        ranked.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
        ranked.truncate(GUIDED_FIRST);
        // Two searches are two chances for an accident.
        let two = (2.0 * self.tries).log10();
        let mut first = self.search(points(&ranked), gcps, priors, two);
        let limit = self.max_false_alarms.log10();
        if first.best.as_ref().is_some_and(|best| best.log10_false_alarms <= limit) {
            for pattern in first.best.iter_mut().chain(first.runner_up.iter_mut()) {
                pattern.pairs.iter_mut().for_each(|pair| pair.0 = ranked[pair.0]);
            }
            return first;
        }
        self.search(points(&all), gcps, priors, two)
    }

    fn search(&self, points: Vec<PixelPoint>, gcps: &[MapPoint], priors: &Priors, log10_searches: f64) -> Found {
        let mut found = Found::default();
        if points.len() < 3 || gcps.len() < 3 {
            return found;
        }
        let Some((search, pairs, possible)) = Search::new(points, gcps, priors, log10_searches) else { return found };
        found.effort.hypotheses_possible = possible;
        // One decade below the limit there is nothing left to weigh.
        let decided = self.max_false_alarms.log10() - 1.0;
        for pair in &pairs {
            let (hypotheses, tried) = search.try_pair(pair);
            found.effort.hypotheses_tried += tried;
            for hypothesis in hypotheses {
                if let Some(pattern) = search.refine(pair, hypothesis) {
                    found.take(pattern);
                }
            }
            if found.best.as_ref().is_some_and(|best| best.log10_false_alarms <= decided) {
                break;
            }
            if found.effort.hypotheses_tried >= self.budget_hypotheses {
                found.effort.budget_spent = true;
                break;
            }
        }
        found
    }

    /// Whether the pattern is there when the image is mirrored.
    fn mirrored(&self, candidates: &[Candidate], gcps: &[MapPoint], priors: &Priors) -> bool {
        let width =
            priors.image_size_px.map(|s| s.0).or_else(|| candidates.iter().map(|c| c.centre.x).max_by(f64::total_cmp));
        let Some(width) = width else { return false };
        let flipped: Vec<Candidate> = candidates
            .iter()
            .map(|c| Candidate { centre: PixelPoint { x: width - c.centre.x, y: c.centre.y }, ..c.clone() })
            .collect();
        // A direction of north means nothing in a mirror.
        let priors = Priors { rotation_deg: None, ..priors.clone() };
        let matcher = RobustMatcher { budget_hypotheses: self.budget_hypotheses / 4, ..self.clone() };
        let found = matcher.search_guided(&flipped, gcps, &priors);
        found.best.is_some_and(|best| {
            best.log10_false_alarms <= self.max_false_alarms.log10()
                && gap(&best, found.runner_up.as_ref()) >= RUNNER_UP_GAP
        })
    }
}

/// The pairs of GCPs in the order of trying, and the number of hypotheses that the priors allow.
fn gcp_pairs(field: &Field, gcps: &[MapPoint], priors: &Priors) -> (Vec<GcpPair>, f64) {
    let diagonal = field.width_px.hypot(field.height_px);
    let distances = sampled_distances(field.points());
    let share_below = |d: f64| distances.partition_point(|&x| x <= d) as f64 / distances.len() as f64;
    let n = field.points().len() as f64;
    let turn = priors.rotation_deg.map_or(1.0, |(_, half)| (2.0 * half / 360.0).min(1.0));
    let (finest, coarsest) = priors.gsd_m_per_px.unwrap_or((0.0, f64::INFINITY));
    let mut pairs = Vec::new();
    let mut possible = 0.0;
    for a in 0..gcps.len() {
        for b in a + 1..gcps.len() {
            let length_m = (gcps[a].easting - gcps[b].easting).hypot(gcps[a].northing - gcps[b].northing);
            let reach_px = ((length_m / coarsest).max(SMALLEST_BASE_PX), (length_m / finest).min(diagonal));
            if length_m <= 0.0 || reach_px.0 >= reach_px.1 {
                continue;
            }
            // At least a few, where the sample says none.
            let share = (share_below(reach_px.1) - share_below(reach_px.0)).max(1.0 / distances.len() as f64);
            let cost = n * (n - 1.0) * share * turn;
            possible += cost;
            pairs.push(GcpPair { a, b, length_m, reach_px, cost });
        }
    }
    if priors.gsd_m_per_px.is_some() {
        pairs.sort_by(|p, q| p.cost.total_cmp(&q.cost));
    } else {
        // Every pair costs the same: a fixed shuffle keeps one bad point from spoiling the start.
        pairs.sort_by_key(|p| ((p.a * 7919 + p.b) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
    }
    (pairs, possible)
}

/// Sorted distances of pairs of points: all of few, a fixed sample of many.
fn sampled_distances(points: &[PixelPoint]) -> Vec<f64> {
    let distance = |i: usize, j: usize| (points[i].x - points[j].x).hypot(points[i].y - points[j].y);
    let n = points.len();
    let mut distances = Vec::new();
    if n <= 400 {
        for i in 0..n {
            distances.extend((i + 1..n).map(|j| distance(i, j)));
        }
    } else {
        let mut state = 0x2545_F491_4F6C_DD1Du64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as usize % n
        };
        while distances.len() < 100_000 {
            let (i, j) = (next(), next());
            if i != j {
                distances.push(distance(i, j));
            }
        }
    }
    distances.sort_by(f64::total_cmp);
    distances
}

impl<'a> Search<'a> {
    /// The field ready for searching, the pairs of GCPs in order of trying, and the number of hypotheses that the priors
    /// allow; `None` when they allow none.
    pub fn new(
        points: Vec<PixelPoint>,
        gcps: &'a [MapPoint],
        priors: &'a Priors,
        log10_searches: f64,
    ) -> Option<(Search<'a>, Vec<GcpPair>, f64)> {
        let field = Field::new(points, priors.image_size_px);
        let (pairs, possible) = gcp_pairs(&field, gcps, priors);
        if possible < 1.0 {
            return None;
        }
        let bitmaps = Bitmap::all(&field);
        let search = Search { field, bitmaps, gcps, priors, log10_tests: possible.log10() + log10_searches };
        Some((search, pairs, possible))
    }

    /// The most surprising hypotheses about one pair of GCPs, best first, and how many were tried.
    fn try_pair(&self, pair: &GcpPair) -> (Vec<Hypothesis>, u64) {
        let targets = self.targets(pair);
        let fewest = self.fewest_hits(&targets);
        if targets.len() < fewest {
            return (Vec::new(), 0);
        }
        let per_point = |i: usize| self.try_point(pair, &targets, fewest, i);
        let (mut all, tried) = (0..self.field.points().len()).into_par_iter().map(per_point).reduce(
            || (Vec::new(), 0),
            |(mut one, n), (other, m)| {
                one.extend(other);
                keep_best(&mut one);
                (one, n + m)
            },
        );
        keep_best(&mut all);
        (all, tried)
    }

    /// Other GCPs as a hypothesis about `pair` predicts them, most certain first.
    fn targets(&self, pair: &GcpPair) -> Vec<Target> {
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        let density = self.field.points().len() as f64 / self.field.area_px2();
        // Farther from the pair than the image is long it cannot be in the image.
        let reach_m = self.field.width_px.hypot(self.field.height_px) * pair.length_m / pair.reach_px.0;
        let mut targets: Vec<Target> = (0..self.gcps.len())
            .filter(|&k| k != pair.a && k != pair.b)
            .filter_map(|k| {
                let gcp = self.gcps[k];
                let (east, north) = (gcp.easting - a.easting, gcp.northing - a.northing);
                let radius_px = SEARCH_TOLERANCE_PX * spread_from_pair(a, b, gcp);
                let probability = -(-density * std::f64::consts::PI * radius_px * radius_px).exp_m1();
                let bitmap = self.bitmaps.iter().position(|m| m.radius_px >= radius_px)?;
                (probability < WORTHLESS_PROBABILITY && east.hypot(north) < reach_m).then_some(Target {
                    east,
                    north,
                    radius_px,
                    bitmap,
                })
            })
            .collect();
        targets.sort_by(|s, t| s.radius_px.total_cmp(&t.radius_px));
        targets
    }

    /// Fewer further hits than this could never be believed, however close they are.
    fn fewest_hits(&self, targets: &[Target]) -> usize {
        let density = self.field.points().len() as f64 / self.field.area_px2();
        let closest = |t: &Target| {
            let radius = t.radius_px / SEARCH_TOLERANCE_PX * LEVELS_PX[0];
            -(-density * std::f64::consts::PI * radius * radius).exp_m1()
        };
        let probabilities: Vec<f64> = targets.iter().map(closest).collect();
        // A hypothesis sees only the GCPs in the image; the tail over the surest few is the most favourable case.
        (1..=probabilities.len())
            .find(|&hits| self.log10_tests + log10_tail(&probabilities[..hits], hits) <= -1.0)
            .unwrap_or(probabilities.len() + 1)
            .clamp(1, 4)
    }

    fn try_point(&self, pair: &GcpPair, targets: &[Target], fewest: usize, i: usize) -> (Vec<Hypothesis>, u64) {
        let (low, high) = pair.reach_px;
        let from = self.field.points()[i];
        let (a, b) = (self.gcps[pair.a], self.gcps[pair.b]);
        let (de, dn) = (b.easting - a.easting, b.northing - a.northing);
        let square = de * de + dn * dn;
        let mut best = Vec::new();
        let mut tried = 0;
        let (left, right, up, down) = self.sector(pair);
        self.field.in_box((from.x + left, from.x + right), (from.y + up, from.y + down), |j, to| {
            let (x, y) = (to.x - from.x, -(to.y - from.y));
            let d2 = x * x + y * y;
            if i == j || d2 < low * low || d2 > high * high {
                return;
            }
            // Pixels = from + z · (map offset), z = (to − from) / (b − a).
            let (z_re, z_im) = ((x * de + y * dn) / square, (y * de - x * dn) / square);
            if !self.turned_right(z_re, z_im) {
                return;
            }
            tried += 1;
            if let Some(score) = self.verify(from, (z_re, z_im), targets, fewest) {
                best.push(Hypothesis { score, i: i as u32, j: j as u32 });
                if best.len() >= 4 * REFINED_PER_PAIR {
                    keep_best(&mut best);
                }
            }
        });
        keep_best(&mut best);
        (best, tried)
    }

    /// Bounds of `to − from`, pixels, that scale and rotation priors allow: left, right, up, down.
    fn sector(&self, pair: &GcpPair) -> (f64, f64, f64, f64) {
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
    fn turned_right(&self, z_re: f64, z_im: f64) -> bool {
        self.priors.rotation_deg.is_none_or(|(centre, half)| {
            let rotation = (-z_im).atan2(z_re).to_degrees();
            let off = (rotation - centre).rem_euclid(360.0);
            off.min(360.0 - off) <= half
        })
    }

    /// Sum of the hits' surprise less that of choosing them, or `None` when too few are hit. A candidate counts for one
    /// GCP only, and for little where candidates crowd: otherwise the best hypotheses would be those that squeeze all GCPs
    /// into one clump.
    fn verify(&self, from: PixelPoint, z: (f64, f64), targets: &[Target], fewest: usize) -> Option<f64> {
        let (mut hits, mut inside, mut surprise) = (0usize, 0usize, 0.0);
        let mut hit = [u32::MAX; MOST_HITS];
        for (k, target) in targets.iter().enumerate() {
            if hits + (targets.len() - k) < fewest || hits == MOST_HITS {
                break;
            }
            let p = PixelPoint {
                x: from.x + z.0 * target.east - z.1 * target.north,
                y: from.y - (z.0 * target.north + z.1 * target.east),
            };
            if !self.field.contains(p) {
                continue;
            }
            inside += 1;
            if !self.bitmaps[target.bitmap].may_hold(p) {
                continue;
            }
            if let Some((candidate, _)) = self.field.nearest(p, target.radius_px)
                && !hit[..hits].contains(&(candidate as u32))
            {
                hit[hits] = candidate as u32;
                hits += 1;
                let area = std::f64::consts::PI * target.radius_px * target.radius_px;
                surprise -= (-(-self.field.density_at(candidate) * area).exp_m1()).ln();
            }
        }
        (hits >= fewest).then(|| surprise - hits as f64 * (std::f64::consts::E * inside as f64 / hits as f64).ln())
    }

    /// A hypothesis as a least-squares pattern with its number of false alarms.
    fn refine(&self, pair: &GcpPair, hypothesis: Hypothesis) -> Option<Pattern> {
        let points = self.field.points();
        let ends = [points[hypothesis.i as usize], points[hypothesis.j as usize]];
        let similarity = Similarity::through(ends, [self.gcps[pair.a], self.gcps[pair.b]])?;
        let spread = |k: usize| spread_from_pair(self.gcps[pair.a], self.gcps[pair.b], self.gcps[k]);
        let pairs = self.assign(&similarity, |k, _| SEARCH_TOLERANCE_PX * spread(k));
        self.settle(similarity, pairs)
    }

    /// From a first list of pairs to the pattern that they and their neighbours settle on, weighed.
    pub fn settle(&self, mut similarity: Similarity, mut pairs: Vec<(usize, usize)>) -> Option<Pattern> {
        // Nobody is taken in whom chance would put there three times in a thousand: a false candidate far from the other
        // pairs would tilt the whole pattern.
        let density = self.field.points().len() as f64 / self.field.area_px2();
        let widest_px = (0.003 / (std::f64::consts::PI * density)).sqrt();
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
            noise_px = noise(&similarity, &fitted).clamp(0.6, 6.0);
            let (centre, spread) = centre_and_spread(&fitted);
            let next =
                self.assign(&similarity, |_, p| tolerance_px(noise_px, fitted.len(), centre, spread, p).min(widest_px));
            if next == pairs {
                break;
            }
            pairs = next;
        }
        while let Some(odd) = self.odd_one_out(&pairs) {
            pairs.remove(odd);
            let fitted: Vec<Pair> = pairs.iter().map(|&(c, g)| self.pair(c, g)).collect();
            similarity = fit_equal_weights(&fitted)?;
            noise_px = noise(&similarity, &fitted).clamp(0.6, 6.0);
        }
        self.weigh(similarity, pairs, noise_px)
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

    fn pair(&self, candidate: usize, gcp: usize) -> Pair {
        let pixel = self.field.points()[candidate];
        Pair { pixel, covariance_px2: None, map: self.gcps[gcp], survey_sigma_m: None }
    }

    /// The nearest candidate to every GCP in the image, each candidate once.
    fn assign(&self, similarity: &Similarity, radius_px: impl Fn(usize, PixelPoint) -> f64) -> Vec<(usize, usize)> {
        let mut hits: Vec<(f64, usize, usize)> = (0..self.gcps.len())
            .filter_map(|k| {
                let p = similarity.invert(self.gcps[k]);
                let (candidate, distance) =
                    self.field.contains(p).then(|| self.field.nearest(p, radius_px(k, p)))??;
                Some((distance, candidate, k))
            })
            .collect();
        hits.sort_by(|s, t| s.0.total_cmp(&t.0).then(s.2.cmp(&t.2)));
        let mut taken = std::collections::HashSet::new();
        hits.retain(|(_, candidate, _)| taken.insert(*candidate));
        let mut pairs: Vec<(usize, usize)> = hits.into_iter().map(|(_, candidate, k)| (candidate, k)).collect();
        pairs.sort_by_key(|pair| pair.1);
        pairs
    }

    /// The smallest number of false alarms over the pattern's own pairs and the tolerance levels.
    fn weigh(&self, similarity: Similarity, pairs: Vec<(usize, usize)>, noise_px: f64) -> Option<Pattern> {
        let mut bases: Vec<(f64, usize, usize)> = Vec::new();
        for i in 0..pairs.len() {
            for j in i + 1..pairs.len() {
                let (p, q) = (self.field.points()[pairs[i].0], self.field.points()[pairs[j].0]);
                bases.push(((p.x - q.x).hypot(p.y - q.y), i, j));
            }
        }
        bases.sort_by(|s, t| t.0.total_cmp(&s.0).then((s.1, s.2).cmp(&(t.1, t.2))));
        bases.truncate(48);
        let mut best: Option<(f64, usize)> = None;
        for (_, i, j) in bases {
            let ends = [self.field.points()[pairs[i].0], self.field.points()[pairs[j].0]];
            for level in LEVELS_PX {
                let evidence =
                    pair_evidence(&self.field, self.gcps, (pairs[i].1, pairs[j].1), ends, level, self.log10_tests);
                if let Some(e) = evidence.filter(|e| best.is_none_or(|b| e.log10_false_alarms < b.0)) {
                    best = Some((e.log10_false_alarms, e.gcps_in_image));
                }
            }
        }
        let gcps_in_image = self.gcps.iter().filter(|g| self.field.contains(similarity.invert(**g))).count();
        best.map(|(log10_false_alarms, _)| Pattern { pairs, similarity, log10_false_alarms, noise_px, gcps_in_image })
    }
}

fn keep_best(hypotheses: &mut Vec<Hypothesis>) {
    // A total order, so that the result does not depend on which thread came first.
    hypotheses.sort_by(|s, t| t.score.total_cmp(&s.score).then((s.i, s.j).cmp(&(t.i, t.j))));
    hypotheses.truncate(REFINED_PER_PAIR);
}

/// How far from its predicted place a mark may be: the length that a two-dimensional normal error of the mark and of the
/// fit through `n` others exceeds once in 1,400.
fn tolerance_px(noise_px: f64, n: usize, centre: PixelPoint, spread: f64, p: PixelPoint) -> f64 {
    let arm = (p.x - centre.x).powi(2) + (p.y - centre.y).powi(2);
    3.8 * noise_px * (1.0 + 1.0 / n as f64 + arm / spread).sqrt()
}

/// 1σ of a coordinate, pixels, from the median length of the residuals.
fn noise(similarity: &Similarity, pairs: &[Pair]) -> f64 {
    let mut lengths: Vec<f64> = pairs
        .iter()
        .map(|pair| {
            let p = similarity.invert(pair.map);
            (p.x - pair.pixel.x).hypot(p.y - pair.pixel.y)
        })
        .collect();
    lengths.sort_by(f64::total_cmp);
    let n = lengths.len();
    let median = (lengths[(n - 1) / 2] + lengths[n / 2]) / 2.0;
    median / 1.1774 * (n as f64 / (n as f64 - 2.0).max(0.5)).sqrt()
}

fn centre_and_spread(pairs: &[Pair]) -> (PixelPoint, f64) {
    let n = pairs.len() as f64;
    let centre = PixelPoint {
        x: pairs.iter().map(|p| p.pixel.x).sum::<f64>() / n,
        y: pairs.iter().map(|p| p.pixel.y).sum::<f64>() / n,
    };
    let spread = pairs.iter().map(|p| (p.pixel.x - centre.x).powi(2) + (p.pixel.y - centre.y).powi(2)).sum::<f64>();
    (centre, spread.max(1.0))
}
