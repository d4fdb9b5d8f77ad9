//! The examination of a place that answered: lines, extent, score.

use super::fit::{Fit, Sample, Start, fit};
use super::grey::{Plane, level, mean_of_cell};
use super::response::{RINGS, direction};
use super::{Motif, Scale, TargetDetector};
use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::segment::label::Region;
use autoref_raster::Patch;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;

/// Arms and quarters are followed this far from the middle, in sides of the largest target.
pub const REACH_SIDES: f64 = 0.75;
/// A fit takes about this many cells in radius; larger targets are halved first.
const FIT_CELLS: f64 = 14.0;
/// The last fit of a target that is believed may take this many.
const POLISH_CELLS: f64 = 24.0;

/// What the fit cannot see of its own error: rounding to bytes and JPEG move both edges of a bar alike (measured on
/// planted targets in `tests/core/targets.rs`).
const FLOOR_PX: f64 = 0.0075;

/// The strongest answer of one scale inside the region, image pixels.
struct Answer {
    scale: Scale,
    response: u8,
    bright: bool,
    direction: f64,
    x: f64,
    y: f64,
}

/// Measurements of one target, image pixels.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    pub fit: Fit,
    pub side_px: f64,
    /// Shortest over longest arm (or quarter).
    pub evenness: f64,
}

pub fn examine(detector: &TargetDetector, region: &Region, patch: &Patch) -> Option<Candidate> {
    let (seen, score) = look(detector, region, patch)?;
    if score.is_nan() || score < detector.min_score {
        return None;
    }
    Some(Candidate {
        centre: PixelPoint { x: seen.fit.x, y: seen.fit.y },
        covariance_px2: Some(seen.fit.covariance),
        score: Some(score),
        area_px: Some(seen.side_px * seen.side_px),
        size_px: Some([seen.side_px; 2]),
        elevation_m: None,
        code: None,
        paint: None,
    })
}

/// The best of the fits at the scales that answer clearly.
pub fn look(detector: &TargetDetector, region: &Region, patch: &Patch) -> Option<(Seen, f64)> {
    let mut answers = answers(detector, region, patch);
    // The fit is stable from about 1.7 bar widths; saddles are best seen on the largest ring that still answers.
    let strongest = answers.iter().map(|a| a.response).max()?;
    answers.retain(|a| 4 * u32::from(a.response) >= 3 * u32::from(strongest));
    answers.sort_by(|a, b| {
        let rank = |a: &Answer| (a.response, a.scale.radius_px());
        let (one, two) = (rank(a), rank(b));
        match detector.motif {
            Motif::Cross => two.0.cmp(&one.0).then(two.1.total_cmp(&one.1)),
            Motif::Saddle => two.1.total_cmp(&one.1).then(two.0.cmp(&one.0)),
        }
    });
    answers
        .iter()
        .take(3)
        .filter_map(|answer| measure(detector, patch, answer, region))
        .map(|seen| {
            let score = score(&seen.fit);
            (seen, score)
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))
}

/// Keeps the best of candidates that are the same target: nearer to each other than a third of their side.
pub fn once_each(list: Vec<Candidate>) -> Vec<Candidate> {
    let mut order: Vec<usize> = (0..list.len()).collect();
    let score = |i: usize| list[i].score.unwrap_or(f64::NEG_INFINITY);
    order.sort_by(|&a, &b| score(b).total_cmp(&score(a)).then(a.cmp(&b)));
    let side = |i: usize| list[i].size_px.map_or(0.0, |s| s[0]);
    // A grid of cells as large as the largest target: neighbours lie in the nine cells about a place.
    let cell = (0..list.len()).map(side).fold(1.0, f64::max);
    let key = |i: usize| ((list[i].centre.x / cell).floor() as i64, (list[i].centre.y / cell).floor() as i64);
    let mut kept: std::collections::HashMap<(i64, i64), Vec<usize>> = std::collections::HashMap::new();
    let mut stays = vec![false; list.len()];
    for i in order {
        let (kx, ky) = key(i);
        let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (kx + dx, ky + dy)));
        let taken = near.filter_map(|k| kept.get(&k)).flatten().any(|&j| {
            let (a, b) = (list[i].centre, list[j].centre);
            (a.x - b.x).hypot(a.y - b.y) < side(i).max(side(j)) / 3.0
        });
        if !taken {
            stays[i] = true;
            kept.entry((kx, ky)).or_default().push(i);
        }
    }
    list.into_iter().zip(stays).filter(|(_, stays)| *stays).map(|(c, _)| c).collect()
}

fn answers(detector: &TargetDetector, region: &Region, patch: &Patch) -> Vec<Answer> {
    let window = region.bounds.grown(detector.halo_px() + (2 << detector.levels()), &patch.window);
    let mut plane = Plane::of_patch(patch, window);
    let mut found = Vec::new();
    for level in 0..=detector.levels() {
        if level > 0 {
            plane = plane.halved();
        }
        let size = 1u64 << level;
        for &scale in detector.scales.iter().filter(|s| s.level == level) {
            let ring = &RINGS[scale.ring];
            let best = cells(&plane, ring.reach, region.bounds, size)
                .map(|(column, row)| (direction(&plane, ring, column, row, detector.motif), column, row))
                .reduce(|a, b| if b.0.0 > a.0.0 { b } else { a });
            let Some(((response, bright, direction), column, row)) = best else { continue };
            if response < detector.least {
                continue;
            }
            let place = |cell: u64| (cell as f64 + 0.5) * size as f64;
            let (x, y) = (place(plane.x + column as u64), place(plane.y + row as u64));
            found.push(Answer { scale, response, bright, direction, x, y });
        }
    }
    found
}

/// Columns and rows of the cells that meet `bounds` and are a ring's reach from the plane's edge.
fn cells(plane: &Plane, reach: usize, bounds: Window, size: u64) -> impl Iterator<Item = (usize, usize)> {
    let range = |from: u64, to: u64, start: u64, len: usize| {
        let first = ((from / size).saturating_sub(start) as usize).max(reach);
        let last = ((to.div_ceil(size)).saturating_sub(start) as usize).min(len.saturating_sub(reach));
        first..last.max(first)
    };
    let columns = range(bounds.x, bounds.right(), plane.x, plane.width);
    range(bounds.y, bounds.bottom(), plane.y, plane.height).flat_map(move |row| columns.clone().map(move |c| (c, row)))
}

fn measure(detector: &TargetDetector, patch: &Patch, answer: &Answer, region: &Region) -> Option<Seen> {
    let motif = detector.motif;
    let radius = answer.scale.radius_px();
    let quarter = std::f64::consts::FRAC_PI_2;
    let height = if answer.bright { 1.0 } else { -1.0 } * f64::from(answer.response) * 1.2;
    let first = match motif {
        Motif::Cross => answer.direction,
        Motif::Saddle => answer.direction - quarter / 2.0,
    };
    let start = Start {
        x: answer.x,
        y: answer.y,
        angles: [first, first + quarter],
        width: if motif == Motif::Cross { radius / 1.7 } else { radius / 2.0 },
        blur: (radius / 8.0).max(0.8),
        height,
    };
    let view = if motif == Motif::Cross { 1.35 } else { 1.25 } * radius;
    let rough = fit_at(detector, patch, start, view, FIT_CELLS)?;
    // The middle must be where the answer was, or the fit has run to something else.
    let near = region.bounds.grown((radius / 2.0).ceil() as u64, &patch.window);
    let inside = rough.x >= near.x as f64
        && rough.y >= near.y as f64
        && rough.x <= near.right() as f64
        && rough.y <= near.bottom() as f64;
    if !inside || !plausible(detector, &rough) || rough.misfit > 0.5 {
        return None;
    }
    let (side_px, evenness) = extent(detector, patch, &rough)?;
    let again = Start {
        x: rough.x,
        y: rough.y,
        angles: rough.angles,
        width: (rough.widths[0] * rough.widths[1]).sqrt(),
        blur: rough.blur,
        height: rough.height,
    };
    // As much of the target as is surely its own: arms to two widths (letters may stand beside them farther out),
    // quarters to 0.7 of the way.
    let view = match motif {
        Motif::Cross => (2.0 * again.width).min(0.45 * side_px),
        Motif::Saddle => (0.35 * side_px).min(48.0),
    };
    let mut fit = fit_at(detector, patch, again, view.max(3.0), POLISH_CELLS)?;
    fit.covariance[0] += FLOOR_PX * FLOOR_PX;
    fit.covariance[2] += FLOOR_PX * FLOOR_PX;
    plausible(detector, &fit).then_some(Seen { fit, side_px, evenness })
}

/// Two lines that cross at an angle that such targets have, with enough contrast.
fn plausible(detector: &TargetDetector, fit: &Fit) -> bool {
    let between = (fit.angles[1] - fit.angles[0]).rem_euclid(std::f64::consts::PI);
    let skew = (between - std::f64::consts::FRAC_PI_2).abs();
    let (low, high) = detector.side_px;
    let width = (fit.widths[0] * fit.widths[1]).sqrt();
    let bars = detector.motif == Motif::Saddle || (low / 12.0..=high / 3.0).contains(&width);
    skew < 3.0 * detector.skew.min(0.35) && fit.height.abs() >= f64::from(detector.least) && bars
}

/// Fits inside a disc of `view` pixels about the start; answers in image pixels.
fn fit_at(detector: &TargetDetector, patch: &Patch, start: Start, view: f64, most_cells: f64) -> Option<Fit> {
    let mut size = 1u64;
    while view / size as f64 > most_cells {
        size *= 2;
    }
    let scale = size as f64;
    let samples = samples(patch, (start.x, start.y), view, size);
    // A target cut by the image's edge or by nodata is no target.
    if (samples.len() as f64) < 0.75 * std::f64::consts::PI * (view / scale).powi(2) {
        return None;
    }
    let (ox, oy) = (patch.window.x as f64, patch.window.y as f64);
    let in_cells = Start {
        x: (start.x - ox) / scale,
        y: (start.y - oy) / scale,
        width: start.width / scale,
        blur: (start.blur / scale).max(0.4),
        ..start
    };
    let found = fit(detector.motif, &samples, in_cells, detector.skew)?;
    Some(Fit {
        x: ox + found.x * scale,
        y: oy + found.y * scale,
        widths: found.widths.map(|w| w * scale),
        blur: found.blur * scale,
        covariance: found.covariance.map(|v| v * scale * scale),
        ..found
    })
}

/// Means of whole cells of `size` pixels within `view` of a place, in cells from the patch's corner.
fn samples(patch: &Patch, at: (f64, f64), view: f64, size: u64) -> Vec<Sample> {
    let (width, height) = (patch.window.width / size, patch.window.height / size);
    let (cx, cy) = ((at.0 - patch.window.x as f64) / size as f64, (at.1 - patch.window.y as f64) / size as f64);
    let reach = view / size as f64;
    let range = |c: f64, len: u64| (c - reach).max(0.0) as u64..((c + reach).ceil().max(0.0) as u64).min(len);
    let mut out = Vec::new();
    for (v, u) in range(cy, height).flat_map(|v| range(cx, width).map(move |u| (v, u))) {
        let (x, y) = (u as f64 + 0.5, v as f64 + 0.5);
        if (x - cx).hypot(y - cy) > reach {
            continue;
        }
        out.extend(mean_of_cell(patch, (u, v), size).map(|level| Sample { x, y, level }));
    }
    out
}

/// Side of the target and shortest over longest arm or quarter: rays from the middle are followed while they stay on
/// their side of the middle level.
///
/// Along each arm of a cross both flanks are followed too: the arm ends with its plate. Of a saddle's quarters the pair
/// that ends first counts, because ground of the other pair's brightness does not end it.
fn extent(detector: &TargetDetector, patch: &Patch, fit: &Fit) -> Option<(f64, f64)> {
    let longest = REACH_SIDES * detector.side_px.1;
    let width = (fit.widths[0] * fit.widths[1]).sqrt();
    let mid = fit.ground + 0.5 * fit.height;
    let step = (width / 8.0).clamp(0.5, 4.0);
    let bright = |x: f64, y: f64| sample_at(patch, x, y, step).map(|v| (v > mid) == (fit.height > 0.0));
    let follow = |direction: f64, on: bool, flanks: f64, from: f64| {
        let (sin, cos) = direction.sin_cos();
        let mut last = from;
        let mut r = from;
        while r <= longest {
            let (x, y) = (fit.x + r * cos, fit.y + r * sin);
            let beside = |side: f64| flanks == 0.0 || bright(x - side * sin, y + side * cos) == Some(!on);
            let good = bright(x, y) == Some(on) && beside(flanks) && beside(-flanks);
            if good {
                last = r;
            } else if r - last > 2.0 * step.max(0.08 * r) {
                break;
            }
            r += step;
        }
        last
    };
    let half_turn = std::f64::consts::PI;
    let (low, high) = detector.side_px;
    match detector.motif {
        Motif::Cross => {
            // Flanks two thirds of a width out: beyond the blurred border, before a letter's tape in most cases.
            let arms = [0, 1].map(|i| {
                let from = 0.5 * width;
                let flank = 0.5 * fit.widths[i] + (1.2 * fit.blur).max(0.2 * width);
                let from = from + flank;
                [fit.angles[i], fit.angles[i] + half_turn].map(|a| follow(a, true, flank, from))
            });
            let mut arms: Vec<f64> = arms.concat();
            arms.sort_by(f64::total_cmp);
            // A letter of tape beside an arm hides its end; the two longest and the shortest tell.
            let side = arms[1] + arms[2].max(arms[3] * 0.8);
            let possible = arms[0] > 1.15 * width && (0.7 * low..=1.4 * high).contains(&side);
            possible.then(|| (side, arms[0] / arms[3]))
        }
        Motif::Saddle => {
            let middle = (fit.angles[0] + fit.angles[1]) / 2.0;
            let from = fit.blur.max(1.0);
            let reach =
                |turn: f64, on: bool| [middle + turn, middle + turn + half_turn].map(|a| follow(a, on, 0.0, from));
            let (one, two) = (reach(0.0, true), reach(half_turn / 2.0, false));
            let least = |pair: [f64; 2]| pair[0].min(pair[1]);
            // Half a diagonal is side/√2.
            let side = std::f64::consts::SQRT_2 * least(one).min(least(two));
            let even = |pair: [f64; 2]| least(pair) / pair[0].max(pair[1]);
            let evenness = even(one).max(even(two));
            (0.6 * low..=1.5 * high).contains(&side).then_some((side, evenness))
        }
    }
}

/// Mean of the pixels in a square of about `size` about a place; `None` outside the patch or on nothing.
fn sample_at(patch: &Patch, x: f64, y: f64, size: f64) -> Option<f64> {
    let half = ((size - 1.0) / 2.0).max(0.0);
    let column = |v: f64, start: u64, len: u64| {
        let index = (v - start as f64).floor();
        (index >= 0.0 && index < len as f64).then_some(index as u64)
    };
    let (w, h) = (patch.window.width, patch.window.height);
    let (x0, x1) = (column(x - half, patch.window.x, w)?, column(x + half, patch.window.x, w)?);
    let (y0, y1) = (column(y - half, patch.window.y, h)?, column(y + half, patch.window.y, h)?);
    let (mut sum, mut n) = (0.0, 0.0);
    for i in (y0..=y1).flat_map(|v| (x0..=x1).map(move |u| (v * w + u) as usize)) {
        if !patch.valid[i] {
            return None;
        }
        sum += level(patch.rgb[i], patch.white);
        n += 1.0;
    }
    Some(sum / n)
}

/// Log-likelihood ratio of "target" against "something else that answered", natural logarithm.
///
/// The measurement is the logarithm of the share of variance that the model leaves over, taken as Gaussian for both.
/// Clutter: 2,866 places that answered on 54 megapixels of photographs (`tools/target_scores.rs`). Targets: 911 planted
/// ones have −6.8 ± 0.6, the cloth of six real plates −4.3 to −4.9; the population covers both. A fit better than the
/// mean does not count further.
fn score(fit: &Fit) -> f64 {
    const TARGET: (f64, f64) = (-6.0, 1.2);
    const CLUTTER: (f64, f64) = (-1.4, 0.75);
    let at = fit.misfit.max(1e-6).ln().max(TARGET.0);
    let log_density = |(mean, sd): (f64, f64)| -0.5 * ((at - mean) / sd).powi(2) - sd.ln();
    log_density(TARGET) - log_density(CLUTTER)
}
