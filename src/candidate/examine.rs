//! The examination: the pixels around a region decide whether it is a mark, and where exactly its centre lies.
//!
//! Colour alone cannot tell a faded mark from a roof tile, but a mark differs from the ground right beside it. The
//! ground is measured in a ring; the direction in colour space that separates paint from that ground best (R. A.
//! Fisher, "The use of multiple measurements in taxonomic problems", 1936) turns the patch into a picture of the share
//! of paint in each pixel, in which texture is weakest; and a blurred shape is fitted to that picture ([`super::fit`]).
//! The answer depends on nothing but the patch, so no tiling can change it.

use nalgebra::{Vector2, Vector3};

use super::Candidate;
use super::even;
use super::figure::{Figure, figure, figure_in_part, may_be_figure, may_be_part_of_figure, middle_if_field};
use super::fit::Fit;
use super::gates::{Gates, centroid};
use super::jpeg_fit::{Refined, refine};
use super::local::{Growth, Local};
use super::paint_share::{Across, best_fit};
use super::pixel_set::PixelSet;
use super::scene::{OwnPaint, RING_PX, Scene};
use super::score::{Populations, is_of_size, score};
use super::shadow::{self, Relit};
use super::split::region_of;
use super::two_lights;
use super::uncertainty::Place;
use super::whole::{self, Whole};
use crate::profile::{CentreMode, Filters, Profile, Shape};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::{Patch, Pixels};

/// A first fit may leave this much more over than the last may.
pub(super) const SLACK: f64 = 1.5;

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

/// What the centre of a likely mark is refined from; without it, shape and score are all that is asked for.
#[derive(Clone, Copy)]
pub(super) struct Around<'a> {
    pub pixels: &'a dyn Pixels,
    pub classifier: &'a Classifier,
}

/// What the examination measured; [`score`] turns it into one number.
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
    /// Contrast and fit are those of the local-background fit, against local ground.
    pub local: bool,
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

/// How many times the region the mark is.
pub(super) fn growth(evidence: &Evidence, region: &Region) -> f64 {
    (evidence.area_px / region.area as f64).max(1.0)
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

/// What every look at a region asks for.
pub(super) struct Looks<'a> {
    pub region: &'a Region,
    pub classifier: &'a Classifier,
    pub profile: &'a Profile,
    pub gates: &'a Gates,
}

impl Looks<'_> {
    pub(super) fn score(&self, evidence: &Evidence) -> f64 {
        if evidence.hopeless { f64::NEG_INFINITY } else { score(evidence, self.profile, self.gates) }
    }

    pub(super) fn least(&self) -> f64 {
        self.profile.examine.min_score
    }

    /// What has grown must pass the gates that a region passes.
    fn may_be_mark(&self, own: &PixelSet, patch: &Patch) -> bool {
        region_of(own, patch).is_some_and(|region| self.gates.shape(&region))
    }

    /// The evidence of the whole mark that `seen` is a part of, or that with even light; else `first`, with what it
    /// leaves open.
    fn widened(&self, first: Evidence, seen: &Scene<'_>, around: Option<Around<'_>>) -> Option<Evidence> {
        let grown = whole::whole(seen, seen.plateau());
        let own = match &grown {
            Whole::Grown(own) => own.clone(),
            _ => seen.own.clone(),
        };
        let may_be_mark = self.may_be_mark(&own, seen.patch);
        let best = match &grown {
            Whole::Is => first,
            Whole::Beaten => return None,
            Whole::Endless => {
                // What goes on beyond the patch: the centre is that of what colour found of it.
                let open = 0.04 * first.area_px;
                let mut first = widen(first, [open, 0.0, open]);
                first.unsupported = first.unsupported.max(1.0);
                first
            }
            Whole::Grown(_) => {
                let least = self.score(&first).min(self.profile.examine.min_score);
                let grown = may_be_mark.then(|| {
                    let scene = seen.with_own(own.clone(), &own.or(&seen.other));
                    // What was looked at against local ground was grown by it too, and is not asked again.
                    if first.local { self.measured_once(&scene, around) } else { self.measured(&scene, around) }
                });
                grown.filter(|grown| self.score(grown) >= least).unwrap_or_else(|| {
                    // What was measured may be the whole already, by the look at local ground.
                    let ((x, y), window) = (middle(&own, seen.width), &seen.patch.window);
                    let whole = (x + 0.5 + window.x as f64, y + 0.5 + window.y as f64);
                    let open = apart(first.centre.0 - whole.0, first.centre.1 - whole.1);
                    widen(first, open)
                })
            }
        };
        if !may_be_mark {
            return Some(best);
        }
        let mark = seen.with_own(own, &seen.paint());
        let shaded = shadow::grown_into_shade(&mark, mark.plateau())
            .filter(|own| self.may_be_mark(own, seen.patch))
            .map(|own| seen.with_own(own, &seen.paint()))
            .and_then(|whole| shadow::relit(&whole).map(|relit| (whole, relit)));
        Some(match shaded.or_else(|| shadow::relit(&mark).map(|relit| (mark, relit))) {
            Some((mark, relit)) => self.in_even_light(best, &mark, &relit),
            None => best,
        })
    }

    /// The evidence of a mark in two lights: shape and contrast as even light shows them, the centre by the fit of mark
    /// and lights together. `best` is what was found without heeding the light.
    fn in_even_light(&self, best: Evidence, mark: &Scene<'_>, relit: &Relit) -> Evidence {
        /// How far off the border of the shadow may be moves the centre by so large a share of a side, where only the
        /// even light was fitted.
        const LINE_OF_SIDE: f64 = 0.06;
        /// Where even light makes no mark of it, the centre lies this share of a side off the fitted part's.
        const PART_OF_SIDE: f64 = 0.15;
        let (even, width, height) = (&relit.even, mark.width, mark.height);
        let paint = PixelSet::of_bits(&self.classifier.paint_bits(&even.rgb), width, height).and(&mark.valid);
        let scene = Scene::of_pixels(even, mark.own.clone(), &paint.or(&mark.own));
        let own = match whole::whole(&scene, scene.plateau()) {
            Whole::Grown(own) => own,
            _ => scene.own.clone(),
        };
        let scene = Scene::of_pixels(even, own.clone(), &own.or(&scene.other));
        // The blocks of a JPEG hold the uneven light: without them.
        let mut evidence = self.measured(&scene, None);
        // The lit part alone may fit better than the whole does, and is no mark: it is enough that the whole looks like
        // one.
        let likely = self.score(&evidence) >= self.profile.examine.min_score;
        if !likely && !better_fit(&evidence, &best) {
            // Of a mark in two lights it is not known where it ends.
            let open = PART_OF_SIDE * PART_OF_SIDE * best.area_px;
            return widen(best, [open, 0.0, open]);
        }
        let joint = evidence.fit.as_ref().zip(scene.ring_ground()).filter(|_| likely).and_then(|(fit, ground)| {
            two_lights::fit(mark, &own, fit, (&relit.border, relit.ratio), (self.classifier, ground))
        });
        match joint {
            Some(joint) => {
                let window = &mark.patch.window;
                let at = (window.x as f64 + joint.x, window.y as f64 + joint.y);
                // Two ways to the same centre: where they part, neither is trusted.
                let open = apart(at.0 - evidence.centre.0, at.1 - evidence.centre.1);
                evidence.centre = at;
                evidence.covariance_px2 = joint.covariance_px2;
                widen(evidence, open.map(|d| joint.doubt * d))
            }
            None => {
                let line = LINE_OF_SIDE * LINE_OF_SIDE * scene.own.count() as f64;
                widen(evidence, [line, 0.0, line])
            }
        }
    }

    fn measured_once(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Evidence {
        let mut evidence = self.measure_scene(scene, around);
        evidence.area_px = scene.own.count() as f64;
        evidence
    }

    fn measured(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Evidence {
        let mut evidence = self.measured_once(scene, around);
        if worth_another_look(&evidence, self.profile, self.gates) {
            evidence = self.look_again(scene, around).unwrap_or(evidence);
        }
        evidence.area_px = scene.own.count() as f64;
        evidence
    }
}

/// Less is left over.
fn better_fit(one: &Evidence, other: &Evidence) -> bool {
    match (&one.fit, &other.fit) {
        (Some(one), Some(other)) => one.rms < other.rms,
        (one, other) => one.is_some() && other.is_none(),
    }
}

fn widen(mut evidence: Evidence, open_px2: [f64; 3]) -> Evidence {
    for (own, open) in evidence.covariance_px2.iter_mut().zip(open_px2) {
        *own += open;
    }
    evidence
}

/// What two centres that lie so far apart leave open: most of it along the line that joins them.
fn apart(dx: f64, dy: f64) -> [f64; 3] {
    /// Share of the squared distance that is open in every direction: neither centre need lie on that line.
    const ASIDE: f64 = 0.15;
    let aside = ASIDE * (dx * dx + dy * dy);
    [dx * dx + aside, dx * dy, dy * dy + aside]
}

/// Mean of a set's pixels.
fn middle(set: &PixelSet, width: usize) -> (f64, f64) {
    let (mut n, mut x, mut y) = (0.0, 0.0, 0.0);
    set.for_each(|i| {
        n += 1.0;
        x += (i % width) as f64;
        y += (i / width) as f64;
    });
    (x / n, y / n)
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

/// 98 % of the marks that the look at the ring misses stand out more, and 85 % of what has a mark's colour but is none
/// less.
pub(super) const LEAST_CONTRAST: f64 = 4.0;

/// Turned down, though it stands out a little.
fn worth_another_look(evidence: &Evidence, profile: &Profile, gates: &Gates) -> bool {
    let failed = evidence.hopeless || score(evidence, profile, gates) < profile.examine.min_score;
    failed
        && evidence.contrast >= LEAST_CONTRAST
        && profile.examine.centre == CentreMode::Fit
        && profile.filters == Filters::default()
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
        local: false,
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
        if let Some(other) = fit_in_linear_light(scene, evidence.local, shape) {
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
fn fit_in_linear_light(scene: &Scene<'_>, local: bool, shape: Shape) -> Option<Fit> {
    let scene = scene.in_linear_light();
    let plateau = scene.plateau();
    let (shares, contrast) = if local {
        let seen = Local::of(&scene, plateau, RING_PX)?;
        (seen.shares(), seen.contrast)
    } else {
        let across = Across::between(scene.ring_ground()?, plateau);
        (across.shares(&scene), across.contrast)
    };
    best_fit(&scene, &shares, shape, 1.0 / contrast.max(1.0), f64::INFINITY)
}

impl Looks<'_> {
    /// The local-background fit ([`super::local`]): against the ground right beside each pixel, the region grown over
    /// its whole mark. `None` when the mark is another region's.
    fn look_again(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Option<Evidence> {
        let first = scene.plateau();
        let seen = Local::of(scene, first, RING_PX);
        let grown = match seen.as_ref().map_or(Growth::Whole, Local::grow) {
            Growth::Beaten => return None,
            Growth::Whole => None,
            Growth::Grown(own) => {
                let paint = own.or(&scene.other);
                Some(scene.with_own(own, &paint))
            }
        };
        let (scene, paint, seen) = match &grown {
            None => (scene, first, seen),
            Some(grown) => {
                let paint = grown.plateau();
                (grown, paint, Local::of(grown, paint, RING_PX))
            }
        };
        let mut evidence = unfitted(self.region, paint, self.classifier, self.profile);
        evidence.area_px = scene.own.count() as f64;
        evidence.local = true;
        evidence.hopeless = true;
        if let Some(seen) = seen {
            evidence.contrast = seen.contrast;
            self.fit_shape(&mut evidence, scene, around, || seen.shares());
        }
        Some(evidence)
    }

    /// Without `around` the centre is that of the plain fit: for scores.
    pub(super) fn measure_scene(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Evidence {
        let plateau = scene.plateau();
        let mut evidence = unfitted(self.region, plateau, self.classifier, self.profile);
        let Some(ground) = scene.ring_ground() else { return evidence };
        let across = Across::between(ground, plateau);
        evidence.contrast = across.contrast;
        if self.profile.examine.centre == CentreMode::Fit {
            self.fit_shape(&mut evidence, scene, around, || across.shares(scene));
        }
        evidence
    }

    /// Fits the shape when that can lead to a score that is high enough.
    fn fit_shape(
        &self,
        evidence: &mut Evidence,
        scene: &Scene<'_>,
        around: Option<Around<'_>>,
        shares: impl FnOnce() -> Vec<f64>,
    ) {
        let profile = self.profile;
        let populations = Populations::of(evidence.local);
        let (contrast, min_score) = (evidence.contrast, profile.examine.min_score);
        evidence.hopeless = populations.best_possible_score(contrast) < min_score;
        if evidence.hopeless {
            return;
        }
        let rms_limit = SLACK * populations.largest_rms(contrast, min_score);
        let shares = shares();
        if let Some(best) = best_fit(scene, &shares, profile.shape, 1.0 / contrast.max(1.0), rms_limit) {
            let mut open = [0.0; 3];
            // Neither edges nor a better centre raise a score: clutter is not asked for them.
            if populations.likelihood_ratio(contrast, best.rms) >= min_score {
                (open, evidence.unsupported) = whole::unsupported(scene, &shares, &best);
            }
            let likely = best.rms <= rms_limit / SLACK
                && populations.score(contrast, best.rms, evidence.unsupported) >= min_score
                && is_of_size(&best, profile, self.gates);
            settle(evidence, scene, around.filter(|_| likely), (best, open), profile.shape);
        }
    }
}
