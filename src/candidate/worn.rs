//! Worn and blurred marks: judged by what wear and blur leave alone.
//!
//! Paint that is worn to two fifths, or of which blur has left no pixel pure, has lost its colour, its contrast and the
//! evenness of its inside. What it keeps is an outline with an edge all around, sides of one length, a ground beside it
//! that it is darkened and coloured from, and a colour on the line from that ground to the paint. None of these says
//! much alone; their weighted sum does (D. R. Cox, "The regression analysis of binary sequences", 1958).

use nalgebra::Vector3;

use super::Candidate;
use super::examine::{Around, Evidence, candidate, near, settle, unfitted};
use super::fit::Fit;
use super::gates::{Gates, central_moments};
use super::paint_share::{Across, best_fit, plateau, ring_ground};
use super::prototype_options;
use super::scene::Scene;
use super::split::region_of;
use super::whole::{self, Whole};
use crate::profile::Profile;
use crate::profile::colour::lab_from_srgb;
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::Pixels;

/// What a region must have to be asked more: of its sums alone.
const LEAST_FILL: f64 = 0.93;
const MOST_ELONGATION: f64 = 2.2;
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
    /// Of the paint itself, from whose colours rules count.
    pub paint: Classifier,
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

impl Signs {
    /// Logarithm of the odds that it is a mark, less those that let a handful pass in 57 Mpx of the tuning half's bare
    /// photographs under ten profiles. Weights by logistic regression of 10,909 worn (50 and 60 %), blurred and patchy
    /// marks of ten paints, 6 to 20 px, and 1,037 other regions that pass the gates (`benches/paint.py`'s renderer);
    /// judged by weights that others of the photographs taught, it finds nearly all that these find.
    fn score(&self) -> f64 {
        const NOTHING: f64 = -5.9;
        let side_px = (self.fit.sides_px[0] * self.fit.sides_px[1]).sqrt();
        NOTHING + 3.12 * self.contrast.ln()
            - 1.50 * self.fit.rms.max(1e-3).ln()
            - 1.52 * self.fit.edge_sd.max(1e-3).ln()
            - 1.51 * self.unsupported
            - 10.59 * (self.fit.sides_px[0] / self.fit.sides_px[1]).ln().abs()
            - 1.98 * self.elongation
            - 15.98 * self.fit.blur_px / side_px
            - 0.385 * self.off_line
    }
}

impl Worn {
    /// Whether a region may be one mark, from its integers alone.
    pub fn gate(&self, region: &Region) -> bool {
        let (fill, elongation) = compactness(region);
        self.gates.region(region) && fill >= LEAST_FILL && elongation <= MOST_ELONGATION
    }

    /// The candidate of a region that looks like a worn or blurred mark.
    pub fn examine(&self, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
        let evidence = self.measure(region, pixels)?;
        let patch = near(pixels, region);
        let scene = Scene::new(region, &patch, &self.classifier, true)?;
        candidate(evidence, &scene, region, &self.classifier, &self.profile, &self.gates)
    }

    /// What was measured of the region, or of what it grows into, whichever looks more like a mark.
    pub fn measure(&self, region: &Region, pixels: &dyn Pixels) -> Option<Evidence> {
        let patch = near(pixels, region);
        let scene = Scene::new(region, &patch, &self.classifier, true)?;
        let grown = match whole::whole(&scene, plateau(&scene)) {
            Whole::Beaten | Whole::Endless => return None,
            Whole::Is => None,
            Whole::Grown(own) => Some(scene.with_own(own.clone(), &own.or(&scene.other))),
        };
        let around = Around { pixels, classifier: &self.classifier };
        let looks = std::iter::once(&scene).chain(&grown).filter_map(|scene| self.look(scene, region, around));
        looks.max_by(|a, b| a.own_score.partial_cmp(&b.own_score).expect("scores are numbers"))
    }

    fn look(&self, scene: &Scene<'_>, region: &Region, around: Around<'_>) -> Option<Evidence> {
        let (fill, elongation) = compactness(&region_of(&scene.own, scene.patch)?);
        let (paint, ground) = (plateau(scene), ring_ground(scene)?);
        let across = Across::between(&ground, paint);
        let off_line = self.off_line(&ground.mean, &paint);
        let hopeless = across.contrast < LEAST_CONTRAST || off_line > MOST_OFF_LINE;
        if hopeless || fill < LEAST_FILL || elongation > MOST_ELONGATION {
            return None;
        }
        if !prototype_options::passes(scene, &self.paint, &self.profile) {
            return None;
        }
        let shares = across.shares(scene);
        let fit = best_fit(scene, &shares, self.profile.shape, 1.0 / across.contrast, f64::INFINITY)?;
        let (open, unsupported) = whole::unsupported(scene, &shares, &fit);
        let signs = Signs { contrast: across.contrast, fit, unsupported, elongation, off_line };
        let score = signs.score();
        let mut evidence = unfitted(region, paint, &self.classifier, &self.profile);
        evidence.contrast = across.contrast;
        evidence.area_px = scene.own.count() as f64;
        (evidence.own_score, evidence.unsupported) = (Some(score), unsupported);
        let around = Some(around).filter(|_| score >= self.profile.examine.min_score);
        settle(&mut evidence, scene, around, (signs.fit, open), self.profile.shape);
        Some(evidence)
    }

    /// Distance of a colour from the line between ground and paint, in L\*a\*b\*; samples 0..=255. Wear mixes the two
    /// as a picture stores them, to the accuracy that matters here.
    fn off_line(&self, ground: &Vector3<f64>, paint: &Vector3<f64>) -> f64 {
        const STEPS: u32 = 40;
        let lab = |c: Vector3<f64>| lab_from_srgb([c[0], c[1], c[2]].map(|v| (v / 255.0).clamp(0.0, 1.0)));
        let (fresh, seen) = (Vector3::from(self.fresh.map(f64::from)), lab(*paint));
        let mixed = |share: f64| fresh * share + ground * (1.0 - share);
        (1..=STEPS)
            .map(|step| (lab(mixed(f64::from(step) / f64::from(STEPS))) - seen).norm())
            .fold(f64::INFINITY, f64::min)
    }
}

/// Area of a region over that of a rectangle with the same second moments, and the ratio of the larger to the smaller
/// of these.
fn compactness(region: &Region) -> (f64, f64) {
    let [xx, xy, yy] = central_moments(region);
    let (middle, half_gap) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
    let rectangle = 12.0 * (xx * yy - xy * xy).max(1e-6).sqrt();
    (region.area as f64 / rectangle, (middle + half_gap) / (middle - half_gap).max(1e-6))
}
