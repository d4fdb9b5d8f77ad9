//! Marks on ground too rough or too like them for every other look: what is even inside is weighed by all its signs.
//!
//! White on straw, green on leaves, either on ground of its own colour: what a fit leaves over is the ground's texture,
//! and the contrast is small. Most other things that are about as large are uneven inside, long, or of a colour that
//! fresh paint does not have. Each sign is weak; logistic regression weighs them together.

use super::Candidate;
use super::evidence::{Around, Evidence, GroundSeen, growth, settle, unfitted};
use super::examine::{candidate, near};
use super::fit::Fit;
use super::gates::{Gates, compactness};
use super::local::{Growth, Local};
use super::looks::Looks;
use super::paint_share::{Across, best_fit};
use super::pixel_set::region_of;
use super::scene::{OwnPaint, RING_PX, Scene};
use super::whole;
use super::worn::off_line;
use crate::profile::Profile;
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::{Patch, Pixels};

/// Of fewer pixels any speck is even.
const LEAST_AREA_PX: u64 = 20;
const LEAST_FILL: f64 = 0.88;
const MOST_ELONGATION: f64 = 2.5;
/// In deviations of the ground right beside it.
const LEAST_CONTRAST: f64 = 2.5;
/// In deviations of the whole ring: one of a hundred marks that the signs take has less, and half of what else is as
/// compact.
const LEAST_RING_CONTRAST: f64 = 3.5;
/// In L\*a\*b\*; three of a hundred marks that the signs take lie further off.
const MOST_OFF_LINE: f64 = 12.0;
/// What the signs but the fit must say: one of a hundred marks that the signs take has less.
const LEAST_BEFORE_FIT: f64 = -13.5;

/// What each sign counts.
struct Weights {
    /// With none of them.
    nothing: f64,
    /// Of logarithms: the contrast with the ground right beside the paint and with the whole ring, what the fit leaves
    /// over in all and inside, the ratio of the sides.
    contrast: f64,
    ring_contrast: f64,
    rms: f64,
    inside: f64,
    aspect: f64,
    /// Of how far the fitted plateau is off the paint's, as a share.
    height: f64,
    /// Of the ratio of the larger to the smaller second moment.
    elongation: f64,
    /// Of the distance of the colour from the line between ground and paint, L\*a\*b\*.
    off_line: f64,
}

/// From 431 marks of yellow green, yellow, orange and blue, 6 to 20 px, that other looks turned down or that lay in
/// another region, of 6,734 drawn on the tuning half of `benches/paint.py`, and from 8,954 other regions. By weights
/// that the other photographs taught, four in nine of the marks that were lost are found, and 3 other regions on 59
/// Mpx for five paints.
const WITH_HUE: Weights = Weights {
    nothing: -18.45,
    contrast: 4.60,
    ring_contrast: -0.36,
    rms: -1.16,
    inside: -2.99,
    aspect: -6.11,
    height: -3.09,
    elongation: -1.21,
    off_line: -0.336,
};

/// The same for white, from 889 marks of 2,785 and 1,629 other regions: half of those that were lost, and 8 other
/// regions.
const WITHOUT_HUE: Weights = Weights {
    nothing: -5.10,
    contrast: -4.13,
    ring_contrast: 3.61,
    rms: 2.11,
    inside: -5.75,
    aspect: -9.89,
    height: -0.18,
    elongation: -2.79,
    off_line: -0.230,
};

/// Measures a region by its inside alone: the brightest part of what another region stands for, which is a mark only
/// where it is evener than anything else is. `None` for profiles with gates of their own, which may have dropped that
/// region.
pub(crate) fn measure(
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Evidence> {
    let looks = Looks { region, classifier, profile, gates };
    looks.inside_alone(pixels, &near(pixels, region)).map(|(evidence, _)| evidence)
}

/// The candidate of a region that looks like a mark by its inside alone.
pub(crate) fn examine(
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Candidate> {
    let patch = near(pixels, region);
    let (evidence, scene) = Looks { region, classifier, profile, gates }.inside_alone(pixels, &patch)?;
    candidate(evidence, &scene, region, classifier, profile, gates)
}

/// What is known of a set of pixels before anything is fitted.
struct Signs {
    contrast: f64,
    ring_contrast: f64,
    elongation: f64,
    off_line: f64,
}

impl Weights {
    fn before_fit(&self, signs: &Signs) -> f64 {
        self.nothing
            + self.contrast * signs.contrast.ln()
            + self.ring_contrast * signs.ring_contrast.max(0.1).ln()
            + self.elongation * signs.elongation
            + self.off_line * signs.off_line
    }

    /// Logarithm of the odds that it is a mark, less what such a mark may cost in other things.
    fn score(&self, signs: &Signs, fit: &Fit) -> f64 {
        self.before_fit(signs)
            + self.rms * fit.rms.max(1e-3).ln()
            + self.inside * fit.rms_inside.max(0.01).ln()
            + self.aspect * (fit.sides_px[0] / fit.sides_px[1]).ln().abs()
            + self.height * (fit.height - 1.0).abs()
    }
}

impl Looks<'_> {
    fn inside_alone<'a>(&self, pixels: &dyn Pixels, patch: &'a Patch) -> Option<(Evidence, Scene<'a>)> {
        if self.profile.has_own_gates() {
            return None;
        }
        let scene = Scene::new(self.region, patch, self.classifier, OwnPaint::under(&self.profile.filters))?;
        let evidence = self.by_inside(&scene, Around { pixels, classifier: self.classifier })?;
        Some((evidence, scene))
    }

    /// The evidence of the region by its inside, or of what it grows into against the ground right beside it.
    pub(super) fn by_inside(&self, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
        let likely = |found: &Evidence| self.score(found) - growth(found, self.region).ln() >= self.least();
        let (paint, ring) = (scene.plateau(), scene.ring_ground()?);
        if Across::between(ring, paint).contrast < LEAST_RING_CONTRAST
            || off_line(self.profile.fresh_paint(), &ring.mean, &paint) > MOST_OFF_LINE
        {
            return None;
        }
        let local = Local::of(scene, paint, RING_PX)?;
        if let Some(found) = self.weighed_inside(scene, &local, around).filter(likely) {
            return Some(found);
        }
        let Growth::Grown(own) = local.grow() else { return None };
        let grown = scene.with_own(own.clone(), &own.or(&scene.other));
        let local = Local::of(&grown, grown.plateau(), RING_PX)?;
        self.weighed_inside(&grown, &local, around).filter(likely)
    }

    fn weighed_inside(&self, scene: &Scene<'_>, local: &Local<'_>, around: Around<'_>) -> Option<Evidence> {
        let region = region_of(&scene.own, scene.patch).filter(|region| self.gates.shape(region))?;
        let (fill, elongation) = compactness(&region);
        if region.area < LEAST_AREA_PX || fill < LEAST_FILL || elongation > MOST_ELONGATION {
            return None;
        }
        let (paint, ring) = (scene.plateau(), scene.ring_ground()?);
        let signs = Signs {
            contrast: local.contrast,
            ring_contrast: Across::between(ring, paint).contrast,
            elongation,
            off_line: off_line(self.profile.fresh_paint(), &ring.mean, &paint),
        };
        let weights = if self.profile.examine.even { &WITHOUT_HUE } else { &WITH_HUE };
        if local.contrast < LEAST_CONTRAST || weights.before_fit(&signs) < self.least() + LEAST_BEFORE_FIT {
            return None;
        }
        let shares = local.shares();
        let fit = best_fit(scene, &shares, self.profile.shape, 1.0 / local.contrast, f64::INFINITY)?;
        let (open, unsupported) = whole::unsupported(scene, &shares, &fit);
        let score = weights.score(&signs, &fit);
        let mut evidence = unfitted(self.region, paint, self.classifier, self.profile);
        (evidence.contrast, evidence.ground) = (local.contrast, GroundSeen::Local);
        evidence.area_px = scene.own.count() as f64;
        (evidence.own_score, evidence.unsupported) = (Some(score), unsupported);
        settle(&mut evidence, scene, Some(around).filter(|_| score >= self.least()), (fit, open), self.profile.shape);
        Some(evidence)
    }
}
