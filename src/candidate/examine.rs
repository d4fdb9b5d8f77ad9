//! The examination: the pixels around a region decide whether it is a mark, and where exactly its centre lies.
//!
//! Colour alone cannot tell a faded mark from a roof tile, but a mark differs from the ground right beside it. The ground is
//! measured in a ring; the direction in colour space that separates paint from that ground best (R. A. Fisher, "The use of
//! multiple measurements in taxonomic problems", 1936) turns the patch into a picture of the share of paint in each pixel,
//! in which texture is weakest; and a blurred shape is fitted to that picture ([`super::fit`]). The answer depends on
//! nothing but the patch, so no tiling can change it.

use nalgebra::{Matrix3, Vector3};

use super::Candidate;
use super::even;
use super::fit::{Fit, Form, Priors, fit, start_cost};
use super::gates::{Gates, centroid};
use super::jpeg_fit::{Refined, refine};
use super::kernels::{Sample, Samples};
use super::local::{Growth, Local};
use super::pixel_set::PixelSet;
use super::scene::{Ground, RING_PX, Scene};
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

/// The fit sees this far outside the region.
const FIT_REACH_PX: usize = 4;
/// And this far inside: deeper pixels of a large mark say nothing about its place.
const FIT_DEPTH_PX: usize = 6;
/// The fit starts from the centroid of what is so near.
const START_REACH_PX: usize = 2;

/// A first fit may leave this much more over than the last may.
const SLACK: f64 = 1.5;

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
    /// Judged by its even inside, on rough ground.
    pub even: bool,
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
    let scene = Scene::new(region, &patch, classifier, profile.filters == Filters::default())?;
    examine_whole(&scene, pixels, region, classifier, profile, gates)
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
    let passes = found.as_ref().is_some_and(|found| looks.score(found) >= profile.examine.min_score);
    if passes || !fits || !even::is_compact(region) {
        return found;
    }
    looks.on_rough_ground(scene, around).or(found)
}

/// By how far paint stands out from the ground and what a fit leaves over.
fn measure_against_ground(looks: &Looks<'_>, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
    let Looks { region, classifier, profile, gates } = *looks;
    let (pixels, around) = (around.pixels, Some(around));
    let mut evidence = measure_scene(scene, around, region, classifier, profile);
    let fits = profile.examine.centre == CentreMode::Fit && profile.filters == Filters::default();
    let wide = (fits && evidence.contrast >= LEAST_CONTRAST).then(|| pixels.whole());
    if worth_another_look(&evidence, profile, gates) {
        evidence = look_again(scene, around, region, classifier, profile)?;
    }
    let Some(wide) = wide else { return Some(evidence) };
    let Some(seen) = Scene::new(region, &wide, classifier, true) else { return Some(evidence) };
    looks.widened(evidence, &seen, around)
}

/// What every look at a region asks for.
struct Looks<'a> {
    region: &'a Region,
    classifier: &'a Classifier,
    profile: &'a Profile,
    gates: &'a Gates,
}

impl Looks<'_> {
    fn score(&self, evidence: &Evidence) -> f64 {
        if evidence.hopeless { f64::NEG_INFINITY } else { score(evidence, self.profile, self.gates) }
    }

    /// The evidence of what is even inside and has edges all around, where the ground is too rough for the other looks.
    fn on_rough_ground(&self, scene: &Scene<'_>, around: Around<'_>) -> Option<Evidence> {
        let (ground, paint) = (ring_ground(scene)?, plateau(scene));
        let across = Across::between(&ground, paint);
        if across.contrast < LEAST_CONTRAST {
            return None;
        }
        let mut evidence = unfitted(self.region, paint, self.classifier, self.profile);
        evidence.contrast = across.contrast;
        let (shares, shape) = (across.shares(scene), self.profile.shape);
        let fit = best_fit(scene, &shares, shape, 1.0 / across.contrast, f64::INFINITY)?;
        let (open, unsupported) = whole::unsupported(scene, &shares, &fit);
        if !even::is_even(&fit, unsupported, evidence.area_px) {
            return None;
        }
        (evidence.even, evidence.unsupported) = (true, unsupported);
        settle(&mut evidence, scene, Some(around), (fit, open), shape);
        Some(evidence).filter(|evidence| self.score(evidence) >= self.profile.examine.min_score)
    }

    /// What has grown must pass the gates that a region passes.
    fn may_be_mark(&self, own: &PixelSet, patch: &Patch) -> bool {
        region_of(own, patch).is_some_and(|region| self.gates.shape(&region))
    }

    /// The evidence of the whole mark that `seen` is a part of, or that with even light; else `first`, with what it leaves open.
    fn widened(&self, first: Evidence, seen: &Scene<'_>, around: Option<Around<'_>>) -> Option<Evidence> {
        let grown = whole::whole(seen, plateau(seen));
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
                    let ((ax, ay), (bx, by)) = (middle(&seen.own, seen.width), middle(&own, seen.width));
                    let (dx, dy) = (ax - bx, ay - by);
                    widen(first, [dx * dx, dx * dy, dy * dy])
                })
            }
        };
        if !may_be_mark {
            return Some(best);
        }
        let mark = seen.with_own(own, &seen.paint());
        let shaded = shadow::grown_into_shade(&mark, plateau(&mark))
            .filter(|own| self.may_be_mark(own, seen.patch))
            .map(|own| seen.with_own(own, &seen.paint()))
            .and_then(|whole| shadow::relit(&whole).map(|relit| (whole, relit)));
        Some(match shaded.or_else(|| shadow::relit(&mark).map(|relit| (mark, relit))) {
            Some((mark, relit)) => self.in_even_light(best, &mark, &relit),
            None => best,
        })
    }

    /// The evidence of a mark in two lights: shape and contrast as even light shows them, the centre by the fit of mark and lights
    /// together. `best` is what was found without heeding the light.
    fn in_even_light(&self, best: Evidence, mark: &Scene<'_>, relit: &Relit) -> Evidence {
        /// How far off the border of the shadow may be moves the centre by so large a share of a side, where only the even light was
        /// fitted.
        const LINE_OF_SIDE: f64 = 0.06;
        /// Share of the squared distance of the two centres that stays in doubt.
        const DOUBT: f64 = 0.25;
        /// Where even light makes no mark of it, the centre lies this share of a side off the fitted part's.
        const PART_OF_SIDE: f64 = 0.15;
        let (even, width, height) = (&relit.even, mark.width, mark.height);
        let paint = PixelSet::of_bits(&self.classifier.paint_bits(&even.rgb), width, height).and(&mark.valid);
        let scene = Scene::of_pixels(even, mark.own.clone(), &paint.or(&mark.own));
        let own = match whole::whole(&scene, plateau(&scene)) {
            Whole::Grown(own) => own,
            _ => scene.own.clone(),
        };
        let scene = Scene::of_pixels(even, own.clone(), &own.or(&scene.other));
        // The blocks of a JPEG hold the uneven light: without them.
        let mut evidence = self.measured(&scene, None);
        // The lit part alone may fit better than the whole does, and is no mark: it is enough that the whole looks like one.
        let likely = self.score(&evidence) >= self.profile.examine.min_score;
        if !likely && !better_fit(&evidence, &best) {
            // Of a mark in two lights it is not known where it ends.
            let open = PART_OF_SIDE * PART_OF_SIDE * best.area_px;
            return widen(best, [open, 0.0, open]);
        }
        let texture = ring_ground(&scene).map(|ground| ground.covariance);
        let joint = evidence
            .fit
            .as_ref()
            .zip(texture)
            .filter(|_| likely)
            .and_then(|(fit, texture)| two_lights::fit(mark, &own, fit, (&relit.border, relit.ratio), texture));
        match joint {
            Some(joint) => {
                let window = &mark.patch.window;
                let at = (window.x as f64 + joint.x, window.y as f64 + joint.y);
                // Two ways to the same centre: where they part, neither is trusted.
                let (dx, dy) = (at.0 - evidence.centre.0, at.1 - evidence.centre.1);
                evidence.centre = at;
                evidence.covariance_px2 = joint.covariance_px2;
                widen(evidence, [dx * dx, dx * dy, dy * dy].map(|d| DOUBT * d))
            }
            None => {
                let line = LINE_OF_SIDE * LINE_OF_SIDE * scene.own.count() as f64;
                widen(evidence, [line, 0.0, line])
            }
        }
    }

    fn measured_once(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Evidence {
        let mut evidence = measure_scene(scene, around, self.region, self.classifier, self.profile);
        evidence.area_px = scene.own.count() as f64;
        evidence
    }

    fn measured(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Evidence {
        let mut evidence = self.measured_once(scene, around);
        if worth_another_look(&evidence, self.profile, self.gates) {
            let again = look_again(scene, around, self.region, self.classifier, self.profile);
            evidence = again.unwrap_or(evidence);
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
    let evidence = measure_scene(scene, Some(Around { pixels, classifier }), region, classifier, profile);
    candidate(evidence, scene, region, classifier, profile, gates)
}

fn candidate(
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
    let score = score(&evidence, profile, gates);
    if score.is_nan() || score < profile.examine.min_score {
        return None;
    }
    let is_even = |fit: &Fit| even::is_even(fit, evidence.unsupported, evidence.area_px);
    if profile.examine.even && !evidence.fit.as_ref().is_some_and(is_even) {
        return None;
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
    let scene = Scene::new(region, &patch, classifier, profile.filters == Filters::default())?;
    measure_whole(&scene, pixels, region, classifier, profile, gates)
}

/// 98 % of the marks that the look at the ring misses stand out more, and 85 % of what has a mark's colour but is none less.
const LEAST_CONTRAST: f64 = 4.0;

/// Turned down, though it stands out a little.
fn worth_another_look(evidence: &Evidence, profile: &Profile, gates: &Gates) -> bool {
    let failed = evidence.hopeless || score(evidence, profile, gates) < profile.examine.min_score;
    failed
        && evidence.contrast >= LEAST_CONTRAST
        && profile.examine.centre == CentreMode::Fit
        && profile.filters == Filters::default()
}

/// The local-background fit ([`super::local`]): against the ground right beside each pixel, the region grown over its whole mark.
/// `None` when the mark is another region's.
fn look_again(
    scene: &Scene<'_>,
    around: Option<Around<'_>>,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
) -> Option<Evidence> {
    let first = plateau(scene);
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
            let paint = plateau(grown);
            (grown, paint, Local::of(grown, paint, RING_PX))
        }
    };
    let mut evidence = unfitted(region, paint, classifier, profile);
    evidence.area_px = scene.own.count() as f64;
    evidence.local = true;
    evidence.hopeless = true;
    if let Some(seen) = seen {
        evidence.contrast = seen.contrast;
        fit_shape(&mut evidence, scene, around, || seen.shares(), profile);
    }
    Some(evidence)
}

/// Without `around` the centre is that of the plain fit: for scores.
pub(super) fn measure_scene(
    scene: &Scene<'_>,
    around: Option<Around<'_>>,
    region: &Region,
    classifier: &Classifier,
    profile: &Profile,
) -> Evidence {
    let plateau = plateau(scene);
    let mut evidence = unfitted(region, plateau, classifier, profile);
    let Some(ground) = ring_ground(scene) else { return evidence };
    let across = Across::between(&ground, plateau);
    evidence.contrast = across.contrast;
    if profile.examine.centre == CentreMode::Fit {
        fit_shape(&mut evidence, scene, around, || across.shares(scene), profile);
    }
    evidence
}

/// The ground in the ring around the region.
fn ring_ground(scene: &Scene<'_>) -> Option<Ground> {
    scene.statistics(&scene.ring(RING_PX)).or_else(|| {
        // Crowded or cut off: whatever is near and not paint.
        scene.statistics(&scene.valid.minus(&scene.own.grown(1)).minus(&scene.other))
    })
}

/// What is known before anything is compared with the ground.
fn unfitted(region: &Region, plateau: Vector3<f64>, classifier: &Classifier, profile: &Profile) -> Evidence {
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
        even: false,
        area_px,
        unsupported: 0.0,
        paint: byte.map(|v| (v * 255.0).round() as u8),
        centre: centroid(region),
        covariance_px2: [loose, 0.0, loose],
    }
}

/// Fits the shape when that can lead to a score that is high enough.
fn fit_shape(
    evidence: &mut Evidence,
    scene: &Scene<'_>,
    around: Option<Around<'_>>,
    shares: impl FnOnce() -> Vec<f64>,
    profile: &Profile,
) {
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
        let likely =
            best.rms <= rms_limit / SLACK && populations.score(contrast, best.rms, evidence.unsupported) >= min_score;
        settle(evidence, scene, around.filter(|_| likely), (best, open), profile.shape);
    }
}

/// Centre and covariance by the best fit and what its edges leave open; with `around`, by the fits in linear light and to the
/// coefficients of a JPEG too.
fn settle(
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
        evidence.refined = ring_ground(scene).and_then(|ground| {
            refine(scene, &around.pixels.whole(), around.classifier, &best, (plateau(scene), &ground))
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
    let plateau = plateau(&scene);
    let (shares, contrast) = if local {
        let seen = Local::of(&scene, plateau, RING_PX)?;
        (seen.shares(), seen.contrast)
    } else {
        let across = Across::between(&ring_ground(&scene)?, plateau);
        (across.shares(&scene), across.contrast)
    };
    best_fit(&scene, &shares, shape, 1.0 / contrast.max(1.0), f64::INFINITY)
}

/// Colour of the paint where it is least mixed: the mean over the deepest pixels of the region.
fn plateau(scene: &Scene<'_>) -> Vector3<f64> {
    // A region two pixels deep has a core of one or a few; three deep, everything from the third ring on.
    let core = [2, 1].into_iter().map(|depth_px| scene.own.shrunk(depth_px)).find(|core| !core.is_empty());
    scene.median_colour(core.as_ref().unwrap_or(&scene.own))
}

/// Fisher's direction from ground to paint.
struct Across {
    direction: Vector3<f64>,
    /// Of the mean ground along it.
    origin: f64,
    /// Mahalanobis distance between the two.
    contrast: f64,
}

impl Across {
    fn between(ground: &Ground, plateau: Vector3<f64>) -> Across {
        // Sensor noise and JPEG: 3 levels, so that flat ground does not make the direction arbitrary.
        let noise = ground.covariance + Matrix3::identity() * 9.0;
        let step = plateau - ground.mean;
        let inverse = noise.cholesky().map_or_else(Matrix3::identity, |c| c.inverse());
        let direction = inverse * step;
        let contrast2 = direction.dot(&step).max(1e-9);
        let origin = direction.dot(&ground.mean) / contrast2;
        Across { direction: direction / contrast2, origin, contrast: contrast2.sqrt() }
    }

    /// Share of paint in each pixel: 0 on the mean ground, 1 on the plateau.
    fn shares(&self, scene: &Scene<'_>) -> Vec<f64> {
        scene.along(self.direction, self.origin)
    }
}

fn best_fit(scene: &Scene<'_>, shares: &[f64], shape: Shape, ground_sd: f64, rms_limit: f64) -> Option<Fit> {
    let mut samples = Samples::default();
    let (mut sum, mut sx, mut sy) = (0.0, 0.0, 0.0);
    let hidden = scene.beside_other().minus(&scene.own);
    let near = |reach_px: usize| scene.own.grown(reach_px).and(&scene.valid).minus(&hidden);
    let middle = |i: usize| ((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
    for i in near(FIT_REACH_PX).minus(&scene.own.shrunk(FIT_DEPTH_PX)).iter() {
        let (x, y) = middle(i);
        samples.push(Sample { x, y, share: shares[i] });
    }
    for i in near(START_REACH_PX).iter() {
        let ((x, y), s) = (middle(i), shares[i].clamp(0.0, 1.0));
        sum += s;
        sx += s * x;
        sy += s * y;
    }
    if sum < 1.0 {
        return None;
    }
    let start = (sx / sum, sy / sum);
    let side = sum.sqrt();
    let aspect = if matches!(shape, Shape::Any | Shape::Square | Shape::Disc) { 0.1 } else { 0.4 };
    let priors =
        Priors { aspect, blur: 0.4, blur_px: 1.2, height: 0.3, slope: 0.02, ground_sd: ground_sd.clamp(0.01, 0.5) };
    // A square's angle repeats after a quarter turn. The form and angle that fit best before any descent are descended
    // from; for the centre it does not matter when a small blurred disc is taken for a square.
    let quarter = std::f64::consts::FRAC_PI_8;
    let starts =
        (0..4).map(|k| (Form::Rectangle, f64::from(k) * quarter, side)).chain([(Form::Disc, 0.0, side * 1.128)]);
    let nearest = |starts: &mut dyn Iterator<Item = (Form, f64, f64)>| {
        starts
            .map(|s| (start_cost(s.0, &samples, start, s.2, s.1, &priors), s))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, s)| s)
    };
    let fitted = |(form, angle, side): (Form, f64, f64)| fit(form, &samples, start, side, angle, priors, rms_limit);
    let allowed = |s: &(Form, f64, f64)| match shape {
        Shape::Square => s.0 == Form::Rectangle,
        Shape::Disc => s.0 == Form::Disc,
        _ => true,
    };
    let chosen = nearest(&mut starts.clone().filter(allowed))?;
    let first = fitted(chosen)?;
    if chosen.0 != Form::Disc || shape == Shape::Disc || first.rms > rms_limit {
        return Some(first);
    }
    // Half covered, a square lies as near to a disc as to itself.
    let square = nearest(&mut starts.filter(|s| s.0 == Form::Rectangle)).and_then(fitted);
    Some(square.filter(|square| square.rms < first.rms).unwrap_or(first))
}

/// Log-likelihood ratio of "mark" against "something else of this colour", natural logarithm.
///
/// Two measurements, the contrast with the ground beside it and what the fit leaves over, each as a logarithm; their joint
/// distribution is taken as Gaussian for marks (50,000 planted under all conditions of the benchmark) and for clutter (1,068
/// regions of this colour in eight real photographs). Beyond the mark's own mean more contrast or a better fit
/// does not count further. A candidate that no shape could be fitted to (no ground around it) has ratio 0.
pub fn score(evidence: &Evidence, profile: &Profile, gates: &Gates) -> f64 {
    let Some(fit) = &evidence.fit else { return 0.0 };
    let (low, high) = gates.mark_side_px();
    let side = (fit.sides_px[0] * fit.sides_px[1]).sqrt();
    // A shape that is not as large as any mark has no likelihood as one; the margin is the fit's own uncertainty.
    if side < 0.6 * low || side > 1.25 * high + 1.0 {
        return f64::from(-50);
    }
    if fit.sides_px[0].max(fit.sides_px[1]) > 2.0 * fit.sides_px[0].min(fit.sides_px[1])
        && profile.shape != Shape::Cross
    {
        return f64::from(-50);
    }
    if evidence.even {
        return even::SCORE;
    }
    Populations::of(evidence.local).score(evidence.contrast, fit.rms, evidence.unsupported)
}

/// From better than any fit to as bad as none, rising.
fn ln_rms_steps() -> impl Iterator<Item = f64> {
    (0..=40).map(|i| -4.0 + 0.1 * f64::from(i))
}

/// A Gaussian over (ln contrast, ln rms).
struct Population {
    mean: [f64; 2],
    /// Variances and covariance: 00, 01, 11.
    covariance: [f64; 3],
}

/// Marks and what else has their colour, as one of the looks sees them.
struct Populations {
    mark: Population,
    clutter: Population,
}

const RING_LOOK: Populations = Populations {
    mark: Population { mean: [3.23, -3.45], covariance: [0.126, -0.071, 0.107] },
    clutter: Population { mean: [0.99, -1.40], covariance: [0.212, -0.082, 0.280] },
};
/// Both of what the ring's look turned down: 137 marks and 157 regions of clutter.
const LOCAL_LOOK: Populations = Populations {
    mark: Population { mean: [3.015, -3.106], covariance: [0.076, -0.048, 0.148] },
    clutter: Population { mean: [1.881, -1.586], covariance: [0.159, -0.064, 0.282] },
};

impl Populations {
    fn of(local: bool) -> &'static Populations {
        if local { &LOCAL_LOOK } else { &RING_LOOK }
    }

    /// Less for so many sides of an outline that no edge supports.
    fn score(&self, contrast: f64, rms: f64, unsupported: f64) -> f64 {
        // A side without an edge is worth as much as most of what a mark gains by its contrast.
        const PER_SIDE: f64 = 4.0;
        self.likelihood_ratio(contrast, rms) - PER_SIDE * unsupported
    }

    fn likelihood_ratio(&self, contrast: f64, rms: f64) -> f64 {
        self.logarithmic_ratio()(contrast.max(0.1).ln(), rms.max(1e-4).ln())
    }

    /// Of the logarithms of a contrast and a root mean square.
    fn logarithmic_ratio(&self) -> impl Fn(f64, f64) -> f64 {
        let (mark, clutter) = (self.mark.log_density(), self.clutter.log_density());
        let [most_contrast, least_rms] = self.mark.mean;
        move |ln_contrast, ln_rms| {
            let at = [ln_contrast.min(most_contrast), ln_rms.max(least_rms)];
            mark(at) - clutter(at)
        }
    }

    /// The score that the best of fits would give at this contrast. Most clutter is dropped by it before the costly fit.
    fn best_possible_score(&self, contrast: f64) -> f64 {
        let ln_contrast = contrast.max(0.1).ln();
        let ratio = self.logarithmic_ratio();
        ln_rms_steps().map(|ln_rms| ratio(ln_contrast, ln_rms)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// What a fit may leave over at most to reach `min_score` at this contrast.
    fn largest_rms(&self, contrast: f64, min_score: f64) -> f64 {
        let ln_contrast = contrast.max(0.1).ln();
        let ratio = self.logarithmic_ratio();
        let enough = |ln_rms: &f64| ratio(ln_contrast, *ln_rms) >= min_score;
        ln_rms_steps().filter(enough).last().map_or(0.0, f64::exp)
    }
}

impl Population {
    /// At (ln contrast, ln rms). What all places share is worked out once: every region asks at 41 places.
    fn log_density(&self) -> impl Fn([f64; 2]) -> f64 {
        let ([a, b, c], mean) = (self.covariance, self.mean);
        let det = a * c - b * b;
        let (half_ln_det, ln_tau) = (0.5 * det.ln(), std::f64::consts::TAU.ln());
        move |at| {
            let (x, y) = (at[0] - mean[0], at[1] - mean[1]);
            -0.5 * (c * x * x - 2.0 * b * x * y + a * y * y) / det - half_ln_det - ln_tau
        }
    }
}
