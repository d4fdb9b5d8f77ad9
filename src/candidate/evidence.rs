//! What the examination measures of a region: by how far it stands out, what a fit leaves over, where its centre lies.

use nalgebra::Vector3;

use super::fit::Fit;
use super::gates::centroid;
use super::jpeg_fit::{Refined, refine};
use super::local::Local;
use super::paint_share::{Across, best_fit};
use super::scene::{RING_PX, Scene};
use super::uncertainty::Place;
use crate::profile::{Profile, Shape};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::Pixels;
use autoref_raster::coords::PixelPoint;

/// 98 % of the marks that the look at the ring misses stand out more, and 85 % of what has a mark's colour but is none
/// less.
pub(super) const LEAST_CONTRAST: f64 = 4.0;

/// What the centre of a likely mark is refined from; without it, shape and score are all that is asked for.
#[derive(Clone, Copy)]
pub(super) struct Around<'a> {
    pub pixels: &'a dyn Pixels,
    pub classifier: &'a Classifier,
}

/// The ground that paint is seen against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GroundSeen {
    /// The whole ring around it, as one ground.
    Ring,
    /// What is right beside each pixel.
    Local,
}

/// What the examination measured; [`super::score::score`] turns it into one number.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Mahalanobis distance of the paint from the ground beside it.
    pub contrast: f64,
    /// Relative squared colour distance of the mark's plateau from the profile: 1 is the profile's limit.
    pub colour: f64,
    pub fit: Option<Fit>,
    /// The fit to the coefficients of a JPEG, where the patch shows one.
    pub refined: Option<Refined>,
    /// Stands out so little that no fit, however good, could raise its score to the profile's limit: not fitted.
    pub hopeless: bool,
    /// What contrast and fit are seen against.
    pub ground: GroundSeen,
    /// By a look with a score of its own.
    pub own_score: Option<f64>,
    pub area_px: f64,
    /// Sides of the outline, of four, that no edge in the picture supports.
    pub unsupported: f64,
    /// Colour of the mark where it is least mixed, sRGB.
    pub paint: [u8; 3],
    pub centre: (f64, f64),
    pub covariance_px2: [f64; 3],
}

/// How many times the region the mark is.
pub(super) fn growth(evidence: &Evidence, region: &Region) -> f64 {
    (evidence.area_px / region.area as f64).max(1.0)
}

/// What is known before anything is compared with the ground.
pub(super) fn unfitted(region: &Region, plateau: Vector3<f64>, classifier: &Classifier, profile: &Profile) -> Evidence {
    let byte = [plateau[0], plateau[1], plateau[2]].map(|v| v.clamp(0.0, 255.0) / 255.0);
    let limit2 = profile.colour.limit * profile.colour.limit;
    let area_px = region.area as f64;
    // An unfitted region's centroid is as uncertain as its outline: each of about 4·√area border pixels moves by ±½.
    let loose = 0.25f64.max(area_px * 0.004);
    Evidence {
        contrast: 0.0,
        colour: classifier.reference().nearest2(byte) / limit2,
        fit: None,
        refined: None,
        hopeless: false,
        ground: GroundSeen::Ring,
        own_score: None,
        area_px,
        unsupported: 0.0,
        paint: byte.map(|v| (v * 255.0).round() as u8),
        centre: centroid(region),
        covariance_px2: [loose, 0.0, loose],
    }
}

/// Centre and covariance by the best fit and what its edges leave open; with `around`, by the fits in linear light and
/// to the coefficients of a JPEG too.
pub(super) fn settle(
    evidence: &mut Evidence,
    scene: &Scene<'_>,
    around: Option<Around<'_>>,
    (best, open): (Fit, [f64; 3]),
    shape: Shape,
) {
    let window = &scene.patch.window;
    let mut place = Place::of(&best);
    if let Some(around) = around {
        let mut spread = [0.0; 3];
        if let Some(other) = fit_in_linear_light(scene, evidence.ground, shape) {
            (place, spread) = place.averaged_with(&best, &other);
        }
        evidence.refined = scene.ring_ground().and_then(|ground| {
            refine(scene, &around.pixels.whole(), around.classifier, &best, (scene.plateau(), ground))
        });
        if let Some(refined) = &evidence.refined {
            place = place.refined(&best, spread, refined);
        }
    }
    evidence.centre = (window.x as f64 + place.x, window.y as f64 + place.y);
    evidence.covariance_px2 = std::array::from_fn(|k| place.covariance_px2[k] + open[k]);
    evidence.fit = Some(best);
}

/// The fit to shares of paint in linear light, in which lenses mix; it weighs bright and dark ground otherwise.
fn fit_in_linear_light(scene: &Scene<'_>, ground: GroundSeen, shape: Shape) -> Option<Fit> {
    let scene = scene.in_linear_light();
    let plateau = scene.plateau();
    let (shares, contrast) = match ground {
        GroundSeen::Local => {
            let seen = Local::of(&scene, plateau, RING_PX)?;
            (seen.shares(), seen.contrast)
        }
        GroundSeen::Ring => {
            let across = Across::between(scene.ring_ground()?, plateau);
            (across.shares(&scene), across.contrast)
        }
    };
    best_fit(&scene, &shares, shape, 1.0 / contrast.max(1.0), f64::INFINITY)
}

/// Centre and outline of what was fitted.
pub(crate) fn outline_of(evidence: Evidence) -> Option<(PixelPoint, Vec<PixelPoint>)> {
    let centre = PixelPoint { x: evidence.centre.0, y: evidence.centre.1 };
    Some((centre, evidence.fit?.outline(centre)))
}
