//! The last fit of a target, and what is asked of it: lines that cross as such targets' do, and a score.

use super::extent::Lights;
use super::fifth_arm;
use super::fit::Fit;
use super::shade::{self, Fall};
use super::view::View;
use super::{Motif, TargetDetector};
use autoref_raster::Patch;

/// The last fit of a target that is believed may take this many.
pub(super) const POLISH_CELLS: f64 = 24.0;

/// What the fit cannot see of its own error: rounding to bytes and JPEG move both edges of a bar alike (measured on
/// planted targets in `tests/core/targets.rs`).
pub(super) const FLOOR_PX: f64 = 0.0075;

/// The fit to as much of the target as is surely its own: arms to two widths (letters may stand beside them farther
/// out), quarters to 0.7 of the way.
pub(super) fn polished(detector: &TargetDetector, patch: &Patch, rough: &Fit, side_px: f64) -> Option<Fit> {
    let again = rough.as_start();
    let mut view = View::of(patch, again, polish_px(detector, rough, side_px), POLISH_CELLS)?;
    let mut floor = FLOOR_PX * FLOOR_PX;
    if detector.one_open() {
        fifth_arm::without_strip(&mut view.samples, &view.start, rough.ground + 0.5 * rough.height);
        floor += (fifth_arm::TAPER * again.width).powi(2);
    }
    let mut fit = view.fit(detector, |_| true)?;
    // Where it lies to the last tenth of a pixel is asked of what will be a candidate.
    if !detector.one_open() && score(fit.misfit, Lights::One) >= detector.min_score {
        let (even, fall) = in_falling_light(detector, &view, fit);
        fit = at_its_middle(detector, patch, even, fall.as_ref(), polish_px(detector, rough, side_px));
    }
    fit.covariance[0] += floor;
    fit.covariance[2] += floor;
    plausible(detector, &fit).then_some(fit)
}

/// The fit to the middle alone where that to more of the target lies elsewhere: of cloth that is wrinkled, of lines
/// that are bent and where something lies on a target the middle tells most. The largest view with which all smaller
/// ones agree (after O. V. Lepski, "On a problem of adaptive estimation in Gaussian white noise", 1991); how far the
/// next larger is off is what is not known.
fn at_its_middle(detector: &TargetDetector, patch: &Patch, fit: Fit, fall: Option<&Fall>, view_px: f64) -> Fit {
    /// Chi-square of two degrees of freedom; deviations of fits to few cells are themselves uncertain.
    const APART: f64 = 16.0;
    /// A fit that moves farther, in radii of its view, has run to something else.
    const FARTHEST: f64 = 0.3;
    // Nearer to the middle than half a width, at its corners two thirds, a cross has no edges.
    let edges = if detector.motif == Motif::Cross { 0.8 * fit.as_start().width } else { 0.0 };
    let least = (3.0 * fit.blur).max(LEAST_MIDDLE_PX).max(edges);
    let inner = |halvings: i32| {
        let radius = view_px * 0.5f64.powi(halvings);
        let mut view = (radius >= least).then(|| View::of(patch, fit.as_start(), radius, POLISH_CELLS)).flatten()?;
        if let Some(fall) = fall {
            let origin = (-view.origin.0 / view.scale, -view.origin.1 / view.scale);
            view.samples = fall.in_unit(1.0 / view.scale, origin).evened(&view.samples);
        }
        let is_near = |inner: &Fit| (inner.x - fit.x).hypot(inner.y - fit.y) < FARTHEST * radius;
        view.fit(detector, |_| true).filter(|inner| is_near(inner) && plausible(detector, inner))
    };
    let smaller: Vec<Fit> = [2, 1].into_iter().filter_map(inner).collect();
    let views: Vec<Fit> = smaller.into_iter().chain([fit]).collect();
    let agree = |a: &Fit, b: &Fit| {
        let (dx, dy) = (a.x - b.x, a.y - b.y);
        let [xx, xy, yy] = std::array::from_fn(|i| a.covariance[i] + b.covariance[i]);
        (yy * dx * dx - 2.0 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy) < APART
    };
    let disagrees = |k: &usize| views[..*k].iter().any(|smaller| !agree(smaller, &views[*k]));
    let Some(first) = (1..views.len()).find(disagrees) else { return fit };
    let (taken, next) = (&views[first - 1], &views[first]);
    let apart = (taken.x - next.x).powi(2) + (taken.y - next.y).powi(2);
    let [xx, xy, yy] = taken.covariance;
    Fit { x: taken.x, y: taken.y, covariance: [xx + apart, xy, yy + apart], ..fit }
}

/// The middle of a target that is looked at by itself reaches this far.
const LEAST_MIDDLE_PX: f64 = 4.5;

/// How far from the middle the last fit sees.
pub(super) fn polish_px(detector: &TargetDetector, rough: &Fit, side_px: f64) -> f64 {
    let view = match detector.motif {
        Motif::Cross => (2.0 * rough.as_start().width).min(0.45 * side_px),
        Motif::Saddle => (0.35 * side_px).min(48.0),
    };
    view.max(3.0)
}

/// The fit where the light falls off across the target, with the fall in pixels; the same where it does not.
fn in_falling_light(detector: &TargetDetector, view: &View, fit: Fit) -> (Fit, Option<Fall>) {
    let mut best = (fit, None);
    for _ in 0..2 {
        let cells = view.in_cells(&best.0);
        let shares = cells.shares(detector.motif, &view.samples);
        let Some(fall) = shade::fall(&view.samples, &shares, (cells.x, cells.y)) else { break };
        let even = View { samples: fall.evened(&view.samples), ..*view };
        let Some(found) = even.fit(detector, |_| true) else { break };
        // What falling light explains is no evidence of a target: roofs and leaves are explained by it, too.
        best = (Fit { misfit: fit.misfit, ..found }, Some(fall.in_unit(view.scale, view.origin)));
    }
    best
}

/// Two lines that cross at an angle that such targets have, with enough contrast.
pub(super) fn plausible(detector: &TargetDetector, fit: &Fit) -> bool {
    let (low, high) = detector.side_px;
    let width = (fit.widths[0] * fit.widths[1]).sqrt();
    let bars = detector.motif == Motif::Saddle || (low / 12.0..=high / 3.0).contains(&width);
    skew(fit) < most_skew(detector) && fit.height.abs() >= f64::from(detector.least) && bars
}

/// How far the angle between the lines is from a right one, radians.
pub(super) fn skew(fit: &Fit) -> f64 {
    let between = (fit.angles[1] - fit.angles[0]).rem_euclid(std::f64::consts::PI);
    (between - std::f64::consts::FRAC_PI_2).abs()
}

pub(super) fn most_skew(detector: &TargetDetector) -> f64 {
    3.0 * detector.skew.min(0.35)
}

/// Log-likelihood ratio of "target" against "something else that answered", natural logarithm.
///
/// The measurement is the logarithm of the share of variance that the model leaves over, taken as Gaussian for both.
/// Clutter: 2,866 places that answered on 54 megapixels of photographs (`tools/target_scores.rs`). Targets: 911 planted
/// ones have −6.8 ± 0.6, the cloth of six real plates −4.3 to −4.9; the population covers both. A fit better than the
/// mean does not count further.
pub(super) fn score(misfit: f64, lights: Lights) -> f64 {
    const TARGET: (f64, f64) = (-6.0, 1.2);
    const CLUTTER: (f64, f64) = (-1.4, 0.75);
    // What is free in two lights fits more of what is no target, and few targets lie so.
    const TWO_LIGHTS: f64 = 6.0;
    let at = misfit.max(1e-6).ln().max(TARGET.0);
    let log_density = |(mean, sd): (f64, f64)| -0.5 * ((at - mean) / sd).powi(2) - sd.ln();
    let price = match lights {
        Lights::One => 0.0,
        Lights::Two => TWO_LIGHTS,
    };
    log_density(TARGET) - log_density(CLUTTER) - price
}
