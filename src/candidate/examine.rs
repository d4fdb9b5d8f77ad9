//! The examination: the pixels around a region decide whether it is a mark, and where exactly its centre lies.
//!
//! Colour alone cannot tell a faded mark from a roof tile, but a mark differs from the ground right beside it. The
//! ground is measured in a ring; the direction in colour space that separates paint from that ground best (R. A.
//! Fisher, "The use of multiple measurements in taxonomic problems", 1936) turns the patch into a picture of the share
//! of paint in each pixel, in which texture is weakest; and a blurred shape is fitted to that picture ([`super::fit`]).
//! The answer depends on nothing but the patch, so no tiling can change it.

use nalgebra::Vector2;

use super::Candidate;
use super::even;
use super::evidence::{Around, Evidence, LEAST_CONTRAST, growth};
use super::figure::{Figure, figure, figure_in_part, may_be_figure, may_be_part_of_figure, middle_if_field};
use super::fit::Fit;
use super::gates::Gates;
use super::looks::{Looks, apart, middle, widen, worth_another_look};
use super::scene::{OwnPaint, RING_PX, Scene};
use super::score::score;
use crate::profile::{CentreMode, Filters, Profile};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::{Patch, Pixels};

/// How far the looks at the ground reach beyond a region's bounds.
const LOOK_PX: u64 = RING_PX.1 as u64 + 1;
/// Half a block of a JPEG's chroma further: the blocks that the border of a mark lies in are then whole, or nearly.
const BLOCK_PX: u64 = 8;

/// How far a patch must reach beyond a region's bounds.
pub fn patch_margin_px(_profile: &Profile) -> u64 {
    LOOK_PX + BLOCK_PX
}

/// The part of a patch that the looks at the ground see.
pub(super) fn near(pixels: &dyn Pixels, region: &Region) -> Patch {
    pixels.part(&region.bounds.grown(LOOK_PX, &pixels.window()))
}

/// Measures the candidate in `pixels`, which should reach [`patch_margin_px`] beyond the region's bounds (less at the
/// image's edge), and keeps it when it looks like a mark of the profile.
pub fn examine(
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Candidate> {
    let patch = near(pixels, region);
    let scene = Scene::new(region, &patch, classifier, OwnPaint::under(&profile.filters))?;
    match figure_of(&scene, region, pixels, classifier, profile) {
        Figure::Is(candidate) => return Some(*candidate),
        Figure::Elsewhere => return None,
        Figure::No => {}
    }
    examine_whole(&scene, pixels, region, classifier, profile, gates)
}

/// Whether a region is a painted figure, or a part of one; `scene` is what lies near it.
pub(super) fn figure_of(
    scene: &Scene<'_>,
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
) -> Figure {
    let fits = profile.examine.centre == CentreMode::Fit && profile.filters == Filters::default();
    let (seen, in_part) = (fits && may_be_figure(scene), fits && may_be_part_of_figure(scene));
    if !seen && !in_part {
        return Figure::No;
    }
    let patch = pixels.whole();
    let Some(wide) = Scene::new(region, &patch, classifier, OwnPaint::Piece) else { return Figure::No };
    match if seen { figure(&wide, profile) } else { Figure::No } {
        Figure::No if in_part => figure_in_part(&wide, profile),
        found => found,
    }
}

/// The same for a region whose scene is there.
pub(super) fn examine_whole(
    scene: &Scene<'_>,
    pixels: &dyn Pixels,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Candidate> {
    if !super::prototype_options::passes(scene, classifier, profile) {
        return None;
    }
    let evidence = measure_whole(scene, pixels, region, classifier, profile, gates)?;
    candidate(evidence, scene, region, classifier, profile, gates)
}

/// Measures a region, and what it is a part of where it is one. `None` when another region stands for the mark.
fn measure_whole(
    scene: &Scene<'_>,
    pixels: &dyn Pixels,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Evidence> {
    let around = Around { pixels, classifier };
    let looks = Looks { region, classifier, profile, gates };
    let found = measure_against_ground(&looks, scene, around);
    let fits = profile.examine.centre == CentreMode::Fit && profile.filters == Filters::default();
    let passes = found.as_ref().is_some_and(|found| {
        looks.score(found) - growth(found, region).ln() >= looks.least() && is_even_enough(found, profile)
    });
    if passes || !fits {
        return found;
    }
    let even = looks.on_rough_ground(scene, around).or_else(|| looks.even_anywhere(scene, around, found.as_ref()?));
    let uneven = || if profile.examine.even { looks.uneven(scene, around) } else { None };
    let pierced = || looks.pierced(scene, found.as_ref()?);
    even.or_else(uneven).or_else(|| looks.by_inside(scene, around)).or_else(pierced).or(found)
}

/// Whether evidence is of an even inside, where the profile asks for it; a look with a score of its own has settled it.
fn is_even_enough(evidence: &Evidence, profile: &Profile) -> bool {
    let limits = &even::ON_ROUGH_GROUND;
    let is_even = |fit: &Fit| even::is_even(fit, evidence.unsupported, evidence.area_px, limits);
    !profile.examine.even || evidence.own_score.is_some() || evidence.fit.as_ref().is_some_and(is_even)
}

/// By how far paint stands out from the ground and what a fit leaves over.
fn measure_against_ground(looks: &Looks<'_>, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
    let Looks { region, classifier, profile, gates } = *looks;
    let (pixels, around) = (around.pixels, Some(around));
    let mut evidence = looks.measure_scene(scene, around);
    let fits = profile.examine.centre == CentreMode::Fit && profile.filters == Filters::default();
    let wide = (fits && evidence.contrast >= LEAST_CONTRAST).then(|| pixels.whole());
    if worth_another_look(&evidence, profile, gates) {
        evidence = looks.look_again(scene, around)?;
    }
    let Some(wide) = wide else { return Some(evidence) };
    let Some(seen) = Scene::new(region, &wide, classifier, OwnPaint::Piece) else { return Some(evidence) };
    looks.widened(evidence, &seen, around)
}

/// The same for a part of a region, whose neighbours are other marks: it is neither grown nor looked at again.
pub(super) fn examine_part(
    scene: &Scene<'_>,
    pixels: &dyn Pixels,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Candidate> {
    if !super::prototype_options::passes(scene, classifier, profile) {
        return None;
    }
    let looks = Looks { region, classifier, profile, gates };
    let evidence = looks.measure_scene(scene, Some(Around { pixels, classifier }));
    candidate(evidence, scene, region, classifier, profile, gates)
}

pub(super) fn candidate(
    mut evidence: Evidence,
    scene: &Scene<'_>,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Candidate> {
    if evidence.hopeless {
        return None;
    }
    if let Some((x, y)) = super::prototype_options::plain_centre(scene, classifier, profile) {
        evidence.centre = (x, y);
    }
    // A mark of which colour found only a part is as much rarer as the part is smaller: fringes and glints grow many
    // times over.
    let score = score(&evidence, profile, gates) - growth(&evidence, region).ln();
    if score.is_nan() || score < profile.examine.min_score {
        return None;
    }
    if !is_even_enough(&evidence, profile) {
        return None;
    }
    // What looks like one of a figure's two fields may be that, though too small or too worn to show it.
    if profile.examine.centre == CentreMode::Fit {
        let mark = Extent {
            centre: PixelPoint { x: evidence.centre.0, y: evidence.centre.1 },
            area_px: evidence.area_px,
            size_px: [region.bounds.width as f64, region.bounds.height as f64],
        };
        if let Some(open) = middle_if_field(scene).and_then(|middle| open_if_field(scene, middle, &mark)) {
            evidence = widen(evidence, open);
        }
    }
    Some(Candidate {
        centre: PixelPoint { x: evidence.centre.0, y: evidence.centre.1 },
        covariance_px2: Some(evidence.covariance_px2),
        score: Some(score),
        area_px: Some(evidence.area_px),
        size_px: Some([region.bounds.width as f64, region.bounds.height as f64]),
        elevation_m: None,
        code: None,
        paint: Some(evidence.paint),
    })
}

/// Where a mark that was measured lies, and how large it is: its area, and the sides of its bounds.
pub(super) struct Extent {
    pub centre: PixelPoint,
    pub area_px: f64,
    pub size_px: [f64; 2],
}

impl Extent {
    fn holds(&self, x: f64, y: f64) -> bool {
        /// In a square no part's middle lies farther from the square's, as a share of its side.
        const HALF_DIAGONAL: f64 = 0.6;
        let (dx, dy) = (x - self.centre.x, y - self.centre.y);
        let [width, height] = self.size_px;
        dx.hypot(dy) < HALF_DIAGONAL * self.area_px.sqrt() || 2.0 * dx.abs() < width && 2.0 * dy.abs() < height
    }
}

/// What is open about a centre where the scene's own paint may be one of a figure's two fields, whose middle lies so
/// far away, px²; `None` where the other field lies within the mark that was measured.
pub(super) fn open_if_field(scene: &Scene<'_>, to_middle: Vector2<f64>, mark: &Extent) -> Option<[f64; 3]> {
    let ((x, y), window) = (middle(&scene.own, scene.width), &scene.patch.window);
    let other = (x + 0.5 + window.x as f64 + 2.0 * to_middle.x, y + 0.5 + window.y as f64 + 2.0 * to_middle.y);
    (!mark.holds(other.0, other.1)).then(|| apart(to_middle.x, to_middle.y))
}

/// The measurements behind [`examine`]; `None` when the region's paint is not in the patch or belongs to a mark that
/// another region stands for.
pub fn measure(
    region: &Region,
    pixels: &dyn Pixels,
    classifier: &Classifier,
    profile: &Profile,
    gates: &Gates,
) -> Option<Evidence> {
    let patch = near(pixels, region);
    let scene = Scene::new(region, &patch, classifier, OwnPaint::under(&profile.filters))?;
    measure_whole(&scene, pixels, region, classifier, profile, gates)
}
