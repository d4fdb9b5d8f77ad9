//! Marks on rough ground: even inside, edges all around, the outline of a square or a disc.
//!
//! The score weighs what a fit leaves over. On rough ground (straw, pebbles, stubble) nearly all of that is the ground
//! beside the mark, and white on it stands out by a few deviations only, though no eye misses it. Here the inside is
//! asked instead. Every limit was chosen on the tuning half of `benches/paint.py`: it takes 20 of 36 marks that the
//! other looks turned down, white and worn, and of 730 other regions that they turned down it takes 2.

use super::evidence::{Around, Evidence, GroundSeen, LEAST_CONTRAST, growth, settle, unfitted};
use super::fit::Fit;
use super::gates::moments_rectangle;
use super::kernels::Form;
use super::local::{Growth, Local};
use super::looks::Looks;
use super::paint_share::{Across, best_fit};
use super::pixel_set::region_of;
use super::scene::{RING_PX, Scene};
use super::whole::{self, Whole};
use crate::segment::label::Region;

/// Logarithm of how much larger the share of marks is than that of other things that pass, of what the other looks
/// turned down.
pub(super) const SCORE: f64 = 5.3;

/// How even an inside and its edges must be, as shares of the paint's contrast.
pub(super) struct Limits {
    most_inside: f64,
    most_edge: f64,
}

/// On ground too rough for the other looks.
pub(super) const ON_ROUGH_GROUND: Limits = Limits { most_inside: 0.075, most_edge: 0.12 };

/// Of whatever a region grows into, which is several more chances to be taken for a mark: on the tuning half this takes
/// 34 of 227 worn, blurred and white marks that everything else turned down, and 1 of some 21,000 other regions.
pub(super) const ANYWHERE: Limits = Limits { most_inside: 0.05, most_edge: 0.09 };
/// It must stand out by so many deviations of its ground.
pub(super) const GOOD_CONTRAST: f64 = 7.0;

/// Whether the pixels of a region fill a square or a disc: what most clutter is not, asked of its sums alone.
pub(super) fn is_compact(region: &Region) -> bool {
    /// Of fewer pixels any handful is compact.
    const LEAST_AREA_PX: u64 = 30;
    /// Share of the area that a square with the same second moments has.
    const LEAST_FILL: f64 = 0.97;
    const MOST_ASPECT: f64 = 1.25;
    let (rectangle_px, [larger, smaller]) = moments_rectangle(region);
    region.area >= LEAST_AREA_PX
        && region.area as f64 >= LEAST_FILL * rectangle_px
        && larger <= MOST_ASPECT * MOST_ASPECT * smaller
}

/// Whether a fit says so: an even inside, sides alike, a full step at every edge, and about as large as what colour
/// found.
pub(super) fn is_even(fit: &Fit, unsupported: f64, area_px: f64, limits: &Limits) -> bool {
    const MOST_UNSUPPORTED: f64 = 0.05;
    /// Colour finds the middle of a blurred mark only: of 12 px with a blur of 2 px, half.
    const LEAST_OF_AREA: f64 = 0.42;
    const MOST_OF_AREA: f64 = 1.2;
    let [a, b] = fit.sides_px;
    let filled = if fit.form == Form::Disc { std::f64::consts::FRAC_PI_4 } else { 1.0 };
    let outline_px = a * b * filled;
    // On ground of nearly its own colour the blurred border of a mark counts as paint: a pixel all around.
    let most_px = (MOST_OF_AREA * outline_px).max((a + 2.0) * (b + 2.0) * filled);
    fit.rms_inside <= limits.most_inside
        && fit.edge_sd <= limits.most_edge
        && unsupported <= MOST_UNSUPPORTED
        && (a / b).ln().abs() <= 0.2
        && (fit.height - 1.0).abs() <= 0.15
        && (LEAST_OF_AREA * outline_px..=most_px).contains(&area_px)
}

/// How a scene's paint stands out, and from which ground: the whole ring, or what is right beside it.
#[derive(Clone, Copy)]
struct Against {
    contrast: f64,
    ground: GroundSeen,
}

impl Looks<'_> {
    /// The evidence of what is even inside and has edges all around, where the ground is too rough for the other looks.
    pub(super) fn on_rough_ground(&self, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
        if !is_compact(self.region) {
            return None;
        }
        let across = Across::between(scene.ring_ground()?, scene.plateau());
        let against = Against { contrast: across.contrast, ground: GroundSeen::Ring };
        if across.contrast < LEAST_CONTRAST {
            return None;
        }
        self.even_in(scene, around, against, &across.shares(scene), &ON_ROUGH_GROUND)
    }

    /// The same of what the region grows into, against the ring and against the ground right beside it, where a mark
    /// stands out well and is evener: one that is worn or blurred, of which colour found the middle or a few specks.
    /// `first` is what the other looks found.
    pub(super) fn even_anywhere(&self, scene: &Scene<'_>, around: Around<'_>, first: &Evidence) -> Option<Evidence> {
        if first.contrast < GOOD_CONTRAST {
            return None;
        }
        let paint = scene.plateau();
        let grown = match whole::whole(scene, paint) {
            Whole::Grown(own) => Some(own),
            _ => None,
        };
        let beside = match Local::of(scene, paint, RING_PX).as_ref().map(Local::grow) {
            Some(Growth::Grown(own)) => Some(own),
            _ => None,
        };
        [Some(scene.own.clone()), grown, beside].into_iter().flatten().find_map(|own| {
            let region = region_of(&own, scene.patch)?;
            if !is_compact(&region) || !self.gates.shape(&region) {
                return None;
            }
            let scene = scene.with_own(own.clone(), &own.or(&scene.other));
            let paint = scene.plateau();
            let against_ring = scene.ring_ground().map(|ground| Across::between(ground, paint)).and_then(|across| {
                let against = Against { contrast: across.contrast, ground: GroundSeen::Ring };
                let seen = across.contrast >= GOOD_CONTRAST;
                seen.then(|| self.even_in(&scene, around, against, &across.shares(&scene), &ANYWHERE)).flatten()
            });
            against_ring.or_else(|| {
                let seen = Local::of(&scene, paint, RING_PX).filter(|seen| seen.contrast >= GOOD_CONTRAST)?;
                let against = Against { contrast: seen.contrast, ground: GroundSeen::Local };
                self.even_in(&scene, around, against, &seen.shares(), &ANYWHERE)
            })
        })
    }

    /// The evidence of a scene's own pixels when they are an even square or disc.
    fn even_in(
        &self,
        scene: &Scene<'_>,
        around: Around<'_>,
        against: Against,
        shares: &[f64],
        limits: &Limits,
    ) -> Option<Evidence> {
        let shape = self.profile.shape;
        let mut evidence = unfitted(self.region, scene.plateau(), self.classifier, self.profile);
        (evidence.contrast, evidence.ground) = (against.contrast, against.ground);
        evidence.area_px = scene.own.count() as f64;
        let fit = best_fit(scene, shares, shape, 1.0 / against.contrast, f64::INFINITY)?;
        let (open, unsupported) = whole::unsupported(scene, shares, &fit);
        if !is_even(&fit, unsupported, evidence.area_px, limits) {
            return None;
        }
        (evidence.own_score, evidence.unsupported) = (Some(SCORE), unsupported);
        settle(&mut evidence, scene, Some(around), (fit, open), shape);
        Some(evidence).filter(|evidence| self.score(evidence) - growth(evidence, self.region).ln() >= self.least())
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{inside, patch};
    use super::super::pixel_set::PixelSet;
    use super::super::pixel_set::region_of;
    use super::*;

    #[test]
    fn squares_and_discs_are_compact_and_lines_and_crosses_are_not() {
        let patch = patch(|_, _| 1.0);
        let compact = |set: &PixelSet| is_compact(&region_of(set, &patch).expect("enough pixels"));
        assert!(compact(&inside(18..30, 18..30)));
        let disc = PixelSet::from_fn(48, 48, |i| ((i % 48) as f64 - 24.0).hypot((i / 48) as f64 - 24.0) < 6.0);
        assert!(compact(&disc));
        assert!(!compact(&inside(18..30, 18..26)), "an oblong");
        assert!(!compact(&inside(18..23, 18..23)), "too few");
        assert!(!compact(&inside(18..30, 22..26).or(&inside(22..26, 18..30))), "a cross");
    }
}
