//! Marks with holes and bitten edges: where paint has come off, the ground shows, sharply, and all the rest is as
//! painted.
//!
//! A fit takes the holes for what it leaves over, the more so the better the paint stands out. Here they are told from
//! the mark by its convex hull: paint is laid down as a square or a disc, so what the hull holds and colour does not is
//! gone. The fit is asked of the other pixels only.

use super::evidence::{Evidence, growth, settle, unfitted};
use super::gates::compactness;
use super::hull::{convex_hull, edges};
use super::looks::{Looks, SLACK};
use super::paint_share::{Across, best_fit};
use super::pixel_set::{PixelSet, region_of};
use super::scene::Scene;
use super::score::RING_LOOK;
use super::whole;

/// Of fewer pixels any speck is as compact.
const LEAST_AREA_PX: usize = 40;
/// Pieces so near, and so much smaller together, are of one mark that a crack runs through: in a crowd of marks each
/// stands for itself.
const CRACK_PX: usize = 2;
const CRACKED_OFF: f64 = 0.5;
/// Fewer pixels are the steps of a slanting edge.
const LEAST_HOLE_PX: usize = 3;
/// Share of the hull that is gone: with less the other looks do, with more anything round is left.
const GONE: std::ops::RangeInclusive<f64> = 0.005..=0.45;
/// The hull fills so much of a rectangle with its moments, and is so long at most.
const LEAST_FILL: f64 = 0.9;
const MOST_ELONGATION: f64 = 1.5;
/// What is left must be as even as this, as a share of the contrast.
const MOST_INSIDE: f64 = 0.16;
/// It must stand out by so many deviations of its ground.
const LEAST_CONTRAST: f64 = 5.0;
/// Nobody sees where a bitten edge ran: so much of a side stays open, for all of it gone.
const OPEN_OF_SIDE: f64 = 0.1;
/// What the chance of leaving pixels out costs: at once, and the more of them.
const COST: f64 = 1.0;
const COST_OF_GONE: f64 = 5.0;

impl Looks<'_> {
    /// The evidence of a mark of which some has come off. `first` is what the other looks found.
    pub(super) fn pierced(&self, scene: &Scene<'_>, first: &Evidence) -> Option<Evidence> {
        if first.contrast < LEAST_CONTRAST || scene.own.count() < LEAST_AREA_PX {
            return None;
        }
        let across = Across::between(scene.ring_ground()?, scene.plateau());
        let painted = with_cracked_off(scene)?;
        if across.contrast < LEAST_CONTRAST || painted.at_edge() {
            return None;
        }
        let laid = hull_of(&painted, scene.width, scene.height);
        let holes = large_pieces(laid.minus(&painted));
        let gone = holes.count() as f64 / laid.count() as f64;
        let region = region_of(&laid, scene.patch).filter(|region| self.gates.shape(region))?;
        let (fill, elongation) = compactness(&region);
        if !GONE.contains(&gone) || fill < LEAST_FILL || elongation > MOST_ELONGATION {
            return None;
        }
        // Blur takes a pixel more all around.
        let unseen = holes.grown(1).and(&laid.grown(1));
        let seen = scene.with_own(laid.clone(), &laid.or(&scene.other)).without(&unseen);
        let cost = COST + COST_OF_GONE * gone;
        let shares = across.shares(&seen);
        let rms_limit = SLACK * RING_LOOK.largest_rms(across.contrast, self.least() + cost);
        let fit = best_fit(&seen, &shares, self.profile.shape, 1.0 / across.contrast, rms_limit)?;
        if fit.rms_inside > MOST_INSIDE {
            return None;
        }
        let (mut open, unsupported) = whole::unsupported(&seen, &shares, &fit);
        let bitten = (OPEN_OF_SIDE * gone).powi(2) * fit.sides_px[0] * fit.sides_px[1];
        (open[0], open[2]) = (open[0] + bitten, open[2] + bitten);
        let mut evidence = unfitted(self.region, scene.plateau(), self.classifier, self.profile);
        evidence.contrast = across.contrast;
        evidence.area_px = laid.count() as f64;
        evidence.unsupported = unsupported;
        evidence.own_score = Some(RING_LOOK.score(across.contrast, fit.rms, unsupported) - cost);
        // The blocks of a JPEG hold the holes.
        settle(&mut evidence, &seen, None, (fit, open), self.profile.shape);
        Some(evidence).filter(|found| self.score(found) - growth(found, self.region).ln() >= self.least())
    }
}

/// The own paint with the smaller pieces that cracks part from it. `None` where a larger piece stands for the mark.
pub(super) fn with_cracked_off(scene: &Scene<'_>) -> Option<PixelSet> {
    let own = scene.own.count();
    let mut all = scene.own.clone();
    let mut near = scene.other.and(&scene.own.grown(CRACK_PX));
    while let Some(first) = near.first() {
        let piece = scene.other.piece(first);
        near = near.minus(&piece);
        let other = piece.count();
        if other > own || other == own && Some(first) < scene.own.first() {
            return None;
        }
        all = all.or(&piece);
    }
    let cracked_off = (all.count() - own) as f64;
    Some(if cracked_off <= CRACKED_OFF * own as f64 { all } else { scene.own.clone() })
}

/// The pixels whose middles lie in the convex hull of a set's.
fn hull_of(set: &PixelSet, width: usize, height: usize) -> PixelSet {
    let mut points = Vec::with_capacity(set.count());
    set.for_each(|i| points.push(((i % width) as i64, (i / width) as i64)));
    let rows = points.iter().map(|p| p.1).fold((i64::MAX, 0), |(top, bottom), y| (top.min(y), bottom.max(y)));
    let hull = convex_hull(points);
    let mut filled = PixelSet::empty(width, height);
    for y in rows.0..=rows.1 {
        // Where the row crosses the hull.
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in edges(&hull).filter(|(a, b)| (a.1.min(b.1)..=a.1.max(b.1)).contains(&y)) {
            let ends = if a.1 == b.1 {
                [a.0 as f64, b.0 as f64]
            } else {
                [a.0 as f64 + (b.0 - a.0) as f64 * (y - a.1) as f64 / (b.1 - a.1) as f64; 2]
            };
            left = left.min(ends[0]).min(ends[1]);
            right = right.max(ends[0]).max(ends[1]);
        }
        // A corner may come out a rounding error beside itself.
        for x in (left - 1e-9).ceil() as i64..=(right + 1e-9).floor() as i64 {
            filled.insert(y as usize * width + x as usize);
        }
    }
    filled.or(set)
}

/// The pieces of a set that are no mere steps of an edge.
fn large_pieces(set: PixelSet) -> PixelSet {
    let (mut left, mut large) = (set.clone(), set);
    while let Some(first) = left.first() {
        let piece = left.piece(first);
        left = left.minus(&piece);
        if piece.count() < LEAST_HOLE_PX {
            large = large.minus(&piece);
        }
    }
    large
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{inside, patch};
    use super::*;

    #[test]
    fn the_hull_of_what_is_left_of_a_square_is_the_square() {
        let square = inside(18..30, 18..30);
        let holes = inside(20..23, 21..24).or(&inside(27..30, 24..27));
        let laid = hull_of(&square.minus(&holes), 48, 48);
        assert_eq!(laid, square);
        assert_eq!(large_pieces(laid.minus(&square.minus(&holes))), holes);
        let turned = PixelSet::from_fn(48, 48, |i| (i % 48).abs_diff(24) + (i / 48).abs_diff(24) <= 9);
        assert_eq!(hull_of(&turned.minus(&inside(22..25, 22..25)), 48, 48), turned);
    }

    #[test]
    fn cracked_pieces_are_of_the_largest() {
        let patch = patch(|_, _| 1.0);
        let (large, small) = (inside(18..26, 18..30), inside(27..30, 18..30));
        let of = |own: &PixelSet| with_cracked_off(&Scene::of_pixels(&patch, own.clone(), &large.or(&small)));
        assert_eq!(of(&large), Some(large.or(&small)));
        assert_eq!(of(&small), None);
    }
}
