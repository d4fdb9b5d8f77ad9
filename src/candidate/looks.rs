//! The looks at a region: against the ring around it, against the ground right beside each pixel, as a part of a whole
//! mark, in even light.

use super::evidence::{Around, Evidence, GroundSeen, LEAST_CONTRAST, settle, unfitted};
use super::gates::Gates;
use super::local::{Growth, Local};
use super::paint_share::{Across, best_fit};
use super::pixel_set::{PixelSet, region_of};
use super::scene::{RING_PX, Scene};
use super::score::{Populations, is_of_size, score};
use super::shadow::{self, Relit};
use super::two_lights;
use super::whole::{self, Whole};
use crate::profile::{CentreMode, Filters, Profile};
use crate::segment::classify::Classifier;
use crate::segment::label::Region;
use autoref_raster::Patch;

/// A first fit may leave this much more over than the last may.
pub(super) const SLACK: f64 = 1.5;

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
    pub(super) fn widened(&self, first: Evidence, seen: &Scene<'_>, around: Option<Around<'_>>) -> Option<Evidence> {
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
                    match first.ground {
                        GroundSeen::Local => self.measured_once(&scene, around),
                        GroundSeen::Ring => self.measured(&scene, around),
                    }
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

    /// The local-background fit ([`super::local`]): against the ground right beside each pixel, the region grown over
    /// its whole mark. `None` when the mark is another region's.
    pub(super) fn look_again(&self, scene: &Scene<'_>, around: Option<Around<'_>>) -> Option<Evidence> {
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
        evidence.ground = GroundSeen::Local;
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
        let populations = Populations::of(evidence.ground);
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

/// Turned down, though it stands out a little.
pub(super) fn worth_another_look(evidence: &Evidence, profile: &Profile, gates: &Gates) -> bool {
    let failed = evidence.hopeless || score(evidence, profile, gates) < profile.examine.min_score;
    failed
        && evidence.contrast >= LEAST_CONTRAST
        && profile.examine.centre == CentreMode::Fit
        && profile.filters == Filters::default()
}

/// Less is left over.
fn better_fit(one: &Evidence, other: &Evidence) -> bool {
    match (&one.fit, &other.fit) {
        (Some(one), Some(other)) => one.rms < other.rms,
        (one, other) => one.is_some() && other.is_none(),
    }
}

pub(super) fn widen(mut evidence: Evidence, open_px2: [f64; 3]) -> Evidence {
    for (own, open) in evidence.covariance_px2.iter_mut().zip(open_px2) {
        *own += open;
    }
    evidence
}

/// What two centres that lie so far apart leave open: most of it along the line that joins them.
pub(super) fn apart(dx: f64, dy: f64) -> [f64; 3] {
    /// Share of the squared distance that is open in every direction: neither centre need lie on that line.
    const ASIDE: f64 = 0.15;
    let aside = ASIDE * (dx * dx + dy * dy);
    [dx * dx + aside, dx * dy, dy * dy + aside]
}

/// Mean of a set's pixels.
pub(super) fn middle(set: &PixelSet, width: usize) -> (f64, f64) {
    let (mut n, mut x, mut y) = (0.0, 0.0, 0.0);
    set.for_each(|i| {
        n += 1.0;
        x += (i % width) as f64;
        y += (i / width) as f64;
    });
    (x / n, y / n)
}
