//! Worn and blurred marks: judged by what wear and blur leave alone.
//!
//! Paint that is worn to two fifths, or of which blur has left no pixel pure, has lost its colour, its contrast and the
//! evenness of its inside. What it keeps is an outline with an edge all around, sides of one length, and a colour on
//! the line from the ground beside it to the paint. None of these says much alone; their weighted sum does (D. R. Cox,
//! "The regression analysis of binary sequences", 1958).

use nalgebra::Vector3;

use super::Candidate;
use super::evidence::{Around, Evidence, GroundSeen, growth, settle, unfitted};
use super::examine::{Extent, candidate, figure_of, near, open_if_field};
use super::figure::{Figure, middle_if_plain_field};
use super::fit::Fit;
use super::gates::{Gates, compactness};
use super::local::Local;
use super::looks::Looks;
use super::paint_share::{Across, best_fit};
use super::pixel_set::{PixelSet, region_of};
use super::scene::{OwnPaint, RING_PX, Scene};
use super::whole::{self, Whole};
use crate::profile::colour::lab_from_srgb;
use crate::profile::{CentreMode, Profile};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::Pixels;

/// What a region must have to be asked more: of its sums alone.
const LEAST_FILL: f64 = 0.93;
const MOST_ELONGATION: f64 = 2.2;
/// The same of the part of a mark that the mask shows, before it is grown.
const LEAST_PART_FILL: f64 = 0.4;
const MOST_PART_ELONGATION: f64 = 4.5;
/// In deviations of the ground.
const LEAST_CONTRAST: f64 = 6.0;
/// In L\*a\*b\*.
const MOST_OFF_LINE: f64 = 16.0;

/// Finds worn and blurred marks of one paint.
#[derive(Clone)]
pub(crate) struct Worn {
    /// Of the worn paint.
    pub profile: Profile,
    pub classifier: Classifier,
    pub gates: Gates,
    /// The paint where it is not worn, sRGB 0..=255.
    pub fresh: [u8; 3],
}

/// What is asked of a region.
struct Signs {
    /// Deviations of the ground by which the paint stands out.
    contrast: f64,
    fit: Fit,
    /// Sides of four without an edge.
    unsupported: f64,
    /// Ratio of the larger to the smaller second moment.
    elongation: f64,
    /// Distance of the colour from the line between ground and paint, L\*a\*b\*.
    off_line: f64,
}

/// What the signs but the fit must say, above the least score: of 785 drawn marks that were taken none had less than
/// -5.4. What has less is not fitted.
const LEAST_BEFORE_FIT: f64 = -6.5;
/// The same of a region that has not been grown to its mark yet: 2 of 859 marks had less, and four fifths of what else
/// has such a colour.
const LEAST_BEFORE_GROWING: f64 = -8.0;

/// What each sign counts, by logistic regression.
struct Weights {
    /// With none of them; so low that only a handful passes of what is no mark.
    nothing: f64,
    /// Of logarithms: the contrast, what the fit leaves over in all and along the edge, the ratio of the sides.
    contrast: f64,
    rms: f64,
    edge: f64,
    aspect: f64,
    unsupported: f64,
    elongation: f64,
    /// Of the blur as a share of the side.
    blur: f64,
    off_line: f64,
}

/// From 10,909 worn (50 and 60 %), blurred and patchy marks of ten paints, 6 to 20 px, and 1,037 other regions of 57
/// Mpx of bare photographs that pass the gates (`benches/paint.py`'s renderer, its tuning half). Weights that others of
/// the photographs taught find nearly as many.
const WORN: Weights = Weights {
    nothing: -5.9,
    contrast: 3.12,
    rms: -1.50,
    edge: -1.52,
    aspect: -10.59,
    unsupported: -1.51,
    elongation: -1.98,
    blur: -15.98,
    off_line: -0.385,
};

/// From 3,112 marks of white, plain, patchy and blurred, and 842 other regions, against the ground right beside them.
const WITHOUT_HUE: Weights = Weights {
    nothing: -6.2,
    contrast: 0.29,
    rms: -1.82,
    edge: -1.95,
    aspect: -7.45,
    unsupported: -6.60,
    elongation: -1.33,
    blur: -18.24,
    off_line: -0.258,
};

impl Weights {
    /// Logarithm of the odds that it is a mark.
    fn score(&self, signs: &Signs) -> f64 {
        let fit = &signs.fit;
        let side_px = (fit.sides_px[0] * fit.sides_px[1]).sqrt();
        self.before_fit(signs.contrast, signs.elongation, signs.off_line)
            + self.rms * fit.rms.max(1e-3).ln()
            + self.edge * fit.edge_sd.max(1e-3).ln()
            + self.aspect * (fit.sides_px[0] / fit.sides_px[1]).ln().abs()
            + self.unsupported * signs.unsupported
            + self.blur * fit.blur_px / side_px
    }

    /// The part of it that is known before anything is fitted.
    fn before_fit(&self, contrast: f64, elongation: f64, off_line: f64) -> f64 {
        self.nothing + self.contrast * contrast.ln() + self.elongation * elongation + self.off_line * off_line
    }
}

impl Worn {
    /// Whether a region may be one mark, from its integers alone.
    pub fn gate(&self, region: &Region) -> bool {
        let (fill, elongation) = compactness(region);
        self.gates.region(region) && fill >= LEAST_PART_FILL && elongation <= MOST_PART_ELONGATION
    }

    /// The candidate of a region that looks like a worn or blurred mark.
    pub fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        let patch = near(pixels, region);
        let scene = Scene::new(region, &patch, &self.classifier, OwnPaint::Piece)?;
        if self.is_of_worn_paint(&scene) {
            match figure_of(&scene, region, pixels, &self.classifier, &self.profile) {
                Figure::Is(candidate) => return Some(*candidate),
                Figure::Elsewhere => return None,
                Figure::No => {}
            }
        }
        let evidence = self.measure(region, pixels)?;
        candidate(evidence, &scene, region, &self.classifier, &self.profile, &self.gates)
    }

    /// A candidate of the paint that is not worn, with what is open about its centre where worn paint beside it makes
    /// it one of a figure's two fields: the other lies on brighter ground, that shines through.
    pub fn with_field_beside(&self, mut found: Candidate, region: &Region, pixels: &dyn Pixels) -> Candidate {
        /// The border of the candidate's own paint, which is worn paint by its colour.
        const BORDER_PX: usize = 2;
        if self.profile.examine.centre != CentreMode::Fit {
            return found;
        }
        let (patch, area_px) = (near(pixels, region), found.area_px.unwrap_or(0.0));
        let (width, height) = (patch.window.width as usize, patch.window.height as usize);
        let (x, y) = (found.centre.x - patch.window.x as f64, found.centre.y - patch.window.y as f64);
        let is_near = |i: usize| {
            let (dx, dy) = ((i % width) as f64 + 0.5 - x, (i / width) as f64 + 0.5 - y);
            std::f64::consts::PI * (dx * dx + dy * dy) <= area_px
        };
        let paint = PixelSet::of_bits(&self.classifier.paint_bits(&patch.rgb), width, height);
        // Its own paint may be joined to the other field at a corner, and be found in part by its own mask.
        let disc = PixelSet::from_fn(width, height, is_near);
        let own = paint.and(&disc);
        if own.is_empty() {
            return found;
        }
        let scene = Scene::of_pixels(&patch, own.clone(), &own.or(&paint.minus(&disc.grown(BORDER_PX))));
        let mark = Extent { centre: found.centre, area_px, size_px: found.size_px.unwrap_or_default() };
        let trace = |covariance: &[f64; 3]| covariance[0] + covariance[2];
        let open = middle_if_plain_field(&scene).and_then(|middle| open_if_field(&scene, middle, &mark));
        if let (Some(covariance), Some(open)) = (&mut found.covariance_px2, open)
            // Not again what its own mask has shown.
            && 2.0 * trace(covariance) < trace(&open)
        {
            covariance.iter_mut().zip(open).for_each(|(own, open)| *own += open);
        }
        found
    }

    /// Whether the paint stands out from the ground beside it, and lies between it and fresh paint.
    fn is_of_worn_paint(&self, scene: &Scene<'_>) -> bool {
        let (paint, Some(ground)) = (scene.plateau(), scene.ring_ground()) else { return false };
        Across::between(ground, paint).contrast >= LEAST_CONTRAST
            && off_line(self.fresh, &ground.mean, &paint) <= MOST_OFF_LINE
    }

    /// What was measured of the region, or of what it grows into, whichever looks more like a mark.
    pub fn measure(&self, region: &Region, pixels: &dyn Pixels) -> Option<Evidence> {
        let patch = near(pixels, region);
        let scene = Scene::new(region, &patch, &self.classifier, OwnPaint::Piece)?;
        if !self.is_worth_growing(&scene, region) {
            return None;
        }
        let grown = match whole::whole(&scene, scene.plateau()) {
            Whole::Beaten | Whole::Endless => return None,
            Whole::Is => None,
            Whole::Grown(own) => Some(scene.with_own(own.clone(), &own.or(&scene.other))),
        };
        let around = Around { pixels, classifier: &self.classifier };
        let looks = std::iter::once(&scene).chain(&grown).filter_map(|scene| self.look(scene, region, around));
        looks.max_by(by_score)
    }

    /// Whether the region itself has nearly what a mark has.
    fn is_worth_growing(&self, scene: &Scene<'_>, region: &Region) -> bool {
        let Some(ground) = scene.ring_ground() else { return true };
        let paint = scene.plateau();
        let (contrast, elongation) = (Across::between(ground, paint).contrast, compactness(region).1);
        let enough = |off_line: f64| {
            WORN.before_fit(contrast, elongation, off_line) >= self.profile.examine.min_score + LEAST_BEFORE_GROWING
        };
        // The colour, which costs most, can only take away.
        enough(0.0) && enough(off_line(self.fresh, &ground.mean, &paint))
    }

    fn look(&self, scene: &Scene<'_>, region: &Region, around: Around<'_>) -> Option<Evidence> {
        let (fill, elongation) = compactness(&region_of(&scene.own, scene.patch)?);
        let (paint, ground) = (scene.plateau(), scene.ring_ground()?);
        let across = Across::between(ground, paint);
        if across.contrast < LEAST_CONTRAST || fill < LEAST_FILL || elongation > MOST_ELONGATION {
            return None;
        }
        let least = self.profile.examine.min_score + LEAST_BEFORE_FIT;
        let enough = |off_line: f64| WORN.before_fit(across.contrast, elongation, off_line) >= least;
        if !enough(0.0) {
            return None;
        }
        let off_line = off_line(self.fresh, &ground.mean, &paint);
        if off_line > MOST_OFF_LINE || !enough(off_line) {
            return None;
        }
        let seen = Seen {
            contrast: across.contrast,
            shares: across.shares(scene),
            ground: GroundSeen::Ring,
            elongation,
            off_line,
        };
        let looks = Looks { region, classifier: &self.classifier, profile: &self.profile, gates: &self.gates };
        looks.weighed(scene, around, seen, &WORN)
    }
}

/// A scene's paint before anything is fitted.
struct Seen {
    contrast: f64,
    /// Of paint in each pixel.
    shares: Vec<f64>,
    ground: GroundSeen,
    elongation: f64,
    off_line: f64,
}

impl Looks<'_> {
    /// The evidence of white and other paint without a hue that is not even inside: patchy, or all blur. It is seen
    /// against the ground right beside it, as a region or as what that grows into.
    pub(super) fn uneven(&self, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
        const LEAST_FILL: f64 = 0.9;
        const MOST_ELONGATION: f64 = 2.5;
        const LEAST_CONTRAST: f64 = 3.0;
        /// Of fewer pixels any speck at an edge is compact.
        const LEAST_AREA_PX: u64 = 30;
        let grown = match whole::whole(scene, scene.plateau()) {
            Whole::Grown(own) => Some(scene.with_own(own.clone(), &own.or(&scene.other))),
            _ => None,
        };
        let found = std::iter::once(scene).chain(&grown).filter_map(|scene| {
            let region = region_of(&scene.own, scene.patch).filter(|region| self.gates.shape(region))?;
            let (fill, elongation) = compactness(&region);
            if fill < LEAST_FILL || elongation > MOST_ELONGATION || region.area < LEAST_AREA_PX {
                return None;
            }
            let paint = scene.plateau();
            let local = Local::of(scene, paint, RING_PX).filter(|local| local.contrast >= LEAST_CONTRAST)?;
            let off_line = off_line(self.profile.fresh_paint(), &scene.ring_ground()?.mean, &paint);
            let seen = Seen {
                contrast: local.contrast,
                shares: local.shares(),
                ground: GroundSeen::Local,
                elongation,
                off_line,
            };
            self.weighed(scene, around, seen, &WITHOUT_HUE)
        });
        found.filter(|found| self.score(found) - growth(found, self.region).ln() >= self.least()).max_by(by_score)
    }

    /// The evidence of a scene's own pixels by what the signs say together.
    fn weighed(&self, scene: &Scene<'_>, around: Around<'_>, seen: Seen, weights: &Weights) -> Option<Evidence> {
        let shape = self.profile.shape;
        let fit = best_fit(scene, &seen.shares, shape, 1.0 / seen.contrast, f64::INFINITY)?;
        let (open, unsupported) = whole::unsupported(scene, &seen.shares, &fit);
        let Seen { contrast, ground, elongation, off_line, .. } = seen;
        let signs = Signs { contrast, fit, unsupported, elongation, off_line };
        let score = weights.score(&signs);
        let mut evidence = unfitted(self.region, scene.plateau(), self.classifier, self.profile);
        (evidence.contrast, evidence.ground) = (contrast, ground);
        evidence.area_px = scene.own.count() as f64;
        (evidence.own_score, evidence.unsupported) = (Some(score), unsupported);
        settle(&mut evidence, scene, Some(around).filter(|_| score >= self.least()), (signs.fit, open), shape);
        Some(evidence)
    }
}

fn by_score(a: &Evidence, b: &Evidence) -> std::cmp::Ordering {
    let score = |evidence: &Evidence| evidence.own_score.unwrap_or(f64::NEG_INFINITY);
    score(a).total_cmp(&score(b))
}

/// Distance of a colour from the line between ground and fresh paint, in L\*a\*b\*; samples 0..=255. Wear mixes the two
/// as a picture stores them, to the accuracy that matters here.
pub(super) fn off_line(fresh: [u8; 3], ground: &Vector3<f64>, paint: &Vector3<f64>) -> f64 {
    const STEPS: u32 = 40;
    /// Every so many steps are tried first, then those beside the nearest of them.
    const COARSE: u32 = 4;
    let lab = |c: Vector3<f64>| lab_from_srgb([c[0], c[1], c[2]].map(|v| (v / 255.0).clamp(0.0, 1.0)));
    let (fresh, seen) = (Vector3::from(fresh.map(f64::from)), lab(*paint));
    let mixed = |share: f64| fresh * share + ground * (1.0 - share);
    let off = |step: u32| (lab(mixed(f64::from(step) / f64::from(STEPS))) - seen).norm();
    let nearest = |steps: &mut dyn Iterator<Item = u32>| {
        steps.map(|step| (off(step), step)).fold((f64::INFINITY, STEPS), |a, b| if b.0 < a.0 { b } else { a })
    };
    let (far, near) = nearest(&mut (COARSE..=STEPS).step_by(COARSE as usize));
    let beside = near - COARSE + 1..=(near + COARSE - 1).min(STEPS);
    far.min(nearest(&mut beside.filter(|&step| step != near)).0)
}
