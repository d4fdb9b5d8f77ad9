//! The other GCPs as a hypothesis about a pair of them predicts them, most certain first.
//!
//! A long list is laid out for few hypotheses: most of them are dropped by their first looks, so that the surest
//! targets alone are put in order, and the others when a hypothesis asks for them.

use std::sync::OnceLock;

use crate::matching::bitmap::WORTHLESS_PROBABILITY;
use crate::matching::pairs::GcpPair;
use crate::matching::predictions::spread_from_pair;
use crate::matching::search::Search;
use autoref_raster::coords::MapPoint;
use autoref_raster::simd::{Kernel, widest};

/// Another GCP as seen from a pair: its offset from `a`, and tolerance.
#[derive(Clone, Copy)]
pub(super) struct Target {
    pub gcp: usize,
    pub east: f64,
    pub north: f64,
    pub radius_px: f64,
    pub bitmap: usize,
}

/// The targets of a pair, the surest first.
pub(super) struct Targets<'s> {
    layout: Layout<'s>,
    surest: Vec<Target>,
    /// What comes after them, in no order.
    others: Vec<InTurn>,
    /// All, once somebody asks for more than the surest.
    all: OnceLock<Vec<Target>>,
}

/// A GCP by its place among the targets: its radius, then its index.
type InTurn = u64;

impl Search<'_> {
    /// The targets of a pair, so many of the surest put in order.
    pub(super) fn targets(&self, pair: &GcpPair, tolerance_px: f64, surest: usize) -> Targets<'_> {
        let layout = Layout { search: self, ends: (self.gcps[pair.a], self.gcps[pair.b]), tolerance_px };
        let mut order = layout.in_turn(pair);
        let others = if order.len() > surest.max(1) {
            order.select_nth_unstable(surest.max(1) - 1);
            order.split_off(surest.max(1))
        } else {
            Vec::new()
        };
        order.sort_unstable();
        let surest = order.into_iter().map(|of| layout.target(of)).collect();
        Targets { layout, surest, others, all: OnceLock::new() }
    }
}

impl Targets<'_> {
    pub fn len(&self) -> usize {
        self.surest.len() + self.others.len()
    }

    /// So many of the surest, or all when there are fewer.
    #[inline]
    pub fn first(&self, most: usize) -> &[Target] {
        let most = most.min(self.len());
        if most <= self.surest.len() { &self.surest[..most] } else { &self.all()[..most] }
    }

    /// All of them.
    pub fn all(&self) -> &[Target] {
        if self.others.is_empty() {
            return &self.surest;
        }
        self.all.get_or_init(|| {
            let mut others = self.others.clone();
            others.sort_unstable();
            self.surest.iter().copied().chain(others.into_iter().map(|of| self.layout.target(of))).collect()
        })
    }

    /// Those that are `kept`; `None` where all are.
    pub fn only(&self, kept: impl Fn(&Target) -> bool) -> Option<Self> {
        let all = self.all();
        (!all.iter().all(&kept)).then(|| Targets {
            layout: self.layout,
            surest: all.iter().filter(|target| kept(target)).copied().collect(),
            others: Vec::new(),
            all: OnceLock::new(),
        })
    }
}

/// What lays GCPs out as targets of a pair.
#[derive(Clone, Copy)]
struct Layout<'s> {
    search: &'s Search<'s>,
    /// The pair.
    ends: (MapPoint, MapPoint),
    tolerance_px: f64,
}

impl Layout<'_> {
    /// The GCPs that may be in the image, and are not hit by chance more often than a hit says anything.
    fn in_turn(&self, pair: &GcpPair) -> Vec<InTurn> {
        let (field, gcps) = (&self.search.field, self.search.gcps);
        // Farther from the pair than the image is long it cannot be in the image.
        let reach_m = field.width_px.hypot(field.height_px) * pair.length_m / pair.reach_px.0;
        // 1 − exp(−density · area) is the probability of a chance hit.
        let worthless_px2 = -(-WORTHLESS_PROBABILITY).ln_1p() / (std::f64::consts::PI * field.density());
        let most_px = self.search.bitmaps.last().map_or(0.0, |bitmap| bitmap.radius_px);
        let mut radii_px = vec![0.0; gcps.len()];
        let (ends, tolerance_px) = (self.ends, self.tolerance_px);
        widest(Radii { gcps, ends, tolerance_px, limits: (reach_m, worthless_px2), radii_px: &mut radii_px });
        (radii_px[pair.a], radii_px[pair.b]) = (f64::INFINITY, f64::INFINITY);
        // Numbers are sorted sooner than targets. Bits of positive numbers are in the order of the numbers.
        let in_turn = |(gcp, radius_px): (usize, f64)| u64::from((radius_px as f32).to_bits()) << 32 | gcp as u64;
        radii_px.into_iter().enumerate().filter(|(_, radius_px)| *radius_px <= most_px).map(in_turn).collect()
    }

    fn target(&self, of: InTurn) -> Target {
        let gcp = (of & 0xFFFF_FFFF) as usize;
        let ((a, b), at) = (self.ends, self.search.gcps[gcp]);
        let radius_px = self.tolerance_px * spread_from_pair(a, b, at);
        let bitmap = self.search.bitmaps.iter().position(|bitmap| bitmap.radius_px >= radius_px);
        Target {
            gcp,
            east: at.easting - a.easting,
            north: at.northing - a.northing,
            radius_px,
            bitmap: bitmap.expect("none is wider than the last bitmap's radius"),
        }
    }
}

/// The tolerance of each GCP, pixels; infinite where it is no target.
struct Radii<'a> {
    gcps: &'a [MapPoint],
    ends: (MapPoint, MapPoint),
    tolerance_px: f64,
    /// From the first end, metres; and the square of a tolerance, pixels, from which on a hit says nothing.
    limits: (f64, f64),
    radii_px: &'a mut [f64],
}

impl Kernel for Radii<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Radii { gcps, ends: (a, b), tolerance_px, limits: (reach_m, worthless_px2), radii_px } = self;
        for (gcp, radius) in gcps.iter().zip(radii_px) {
            let (east, north) = (gcp.easting - a.easting, gcp.northing - a.northing);
            let radius_px = tolerance_px * spread_from_pair(a, b, *gcp);
            let is_near = east * east + north * north < reach_m * reach_m;
            let is_telling = radius_px * radius_px < worthless_px2;
            *radius = if is_near & is_telling { radius_px } else { f64::INFINITY };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate::Candidate;
    use crate::matching::Priors;
    use autoref_raster::coords::PixelPoint;
    use autoref_raster::random::SplitMix64;

    #[test]
    fn the_surest_are_the_first_of_all() {
        let mut random = SplitMix64(3);
        let mut unit = || random.unit();
        let mut place = |_| PixelPoint { x: 2000.0 * unit(), y: 1500.0 * unit() };
        let candidates: Vec<Candidate> = (0..40).map(&mut place).map(Candidate::at).collect();
        let map = |p: PixelPoint| MapPoint { easting: 0.05 * p.x, northing: 0.05 * p.y };
        let gcps: Vec<MapPoint> = (0..300).map(&mut place).map(map).collect();
        let all: Vec<&Candidate> = candidates.iter().collect();
        let priors =
            Priors { image_size_px: Some((2000.0, 1500.0)), gsd_m_per_px: Some((0.04, 0.06)), ..Priors::default() };
        let (search, pairs, _) = Search::new(&all, &gcps, &priors, 0.0).expect("hypotheses are possible");
        let in_order = |targets: &[Target]| targets.iter().map(|target| target.gcp).collect::<Vec<_>>();
        let mut many = 0;
        for pair in pairs.iter().step_by(997) {
            let some = search.targets(pair, search.tolerance_px, 20);
            let whole = search.targets(pair, search.tolerance_px, usize::MAX);
            assert_eq!(some.len(), whole.len());
            assert_eq!(in_order(some.first(20)), in_order(whole.first(20)));
            assert_eq!(in_order(some.all()), in_order(whole.all()));
            assert!(whole.all().is_sorted_by(|s, t| s.radius_px as f32 <= t.radius_px as f32));
            assert!(whole.all().iter().all(|t| ![pair.a, pair.b].contains(&t.gcp)));
            many += usize::from(whole.len() > 100);
        }
        assert!(many > 10, "{many} pairs have more than a hundred targets");
    }
}
