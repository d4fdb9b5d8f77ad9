//! The examination of a place that answered: lines, extent, score.

use super::extent::{Lights, NO_FLANKS, Rays, SMALLEST_SADDLE, Seen, extent, quarters, sample_at};
use super::fifth_arm;
use super::fit::{Fit, Start};
use super::grey::Plane;
use super::polish::{FLOOR_PX, POLISH_CELLS, most_skew, plausible, polish_px, polished, score, skew};
use super::response::{RINGS, Steps, direction};
use super::shade::{self, Shade};
use super::view::View;
use super::{Motif, Quarters, Scale, TargetDetector, two_lights};
use crate::candidate::Candidate;
use crate::detector::Detector;
use crate::segment::label::Region;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;
use autoref_raster::{Patch, Pixels};
use std::cell::OnceCell;

/// A fit takes about this many cells in radius; larger targets are halved first.
const FIT_CELLS: f64 = 14.0;

/// Share of the variance that fits to plates of print without a fifth arm leave over at most; cloth leaves more.
const CLEAN: f64 = 0.0025;
/// Before its fit has settled, a quarter need not reach farther than this share of the smallest.
const SHARE: f64 = 0.8;

/// The strongest answer of one scale inside the region, image pixels.
struct Answer {
    scale: Scale,
    response: u8,
    bright: bool,
    direction: f64,
    x: f64,
    y: f64,
}

/// The target that a region is; `None` when it is none.
pub fn examine(detector: &TargetDetector, region: &Region, pixels: &dyn Pixels) -> Option<Candidate> {
    let (seen, score) = look(detector, region, pixels)?;
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

/// The pixels about a region. Most of what answers shows in the nearest of them that it is no target; all of them, many
/// times as many, are fetched only for what is left.
struct Around<'a> {
    detector: &'a TargetDetector,
    region: &'a Region,
    pixels: &'a dyn Pixels,
    near: Patch,
    farther: OnceCell<Patch>,
    all: OnceCell<Patch>,
}

/// Most targets lie within this many pixels of the place that answered.
const FARTHER_PX: u64 = 80;

impl<'a> Around<'a> {
    fn new(detector: &'a TargetDetector, region: &'a Region, pixels: &'a dyn Pixels) -> Around<'a> {
        // What a first fit sees, and how far the rays go that end the most.
        let radius = detector.scales.iter().map(|s| s.radius_px()).fold(0.0, f64::max);
        let view = (1.35 * radius + 0.25 * detector.side_px.0).ceil() as u64;
        let near = part(detector, region, pixels, view.max(detector.halo_px()));
        Around { detector, region, pixels, near, farther: OnceCell::new(), all: OnceCell::new() }
    }

    fn farther(&self) -> &Patch {
        self.farther.get_or_init(|| part(self.detector, self.region, self.pixels, FARTHER_PX))
    }

    fn all(&self) -> &Patch {
        self.all.get_or_init(|| self.pixels.whole())
    }
}

/// The pixels within `reach` of a region and a little more, so that the cells of fits, which are finer than those that
/// answered, lie as they do in all the pixels.
fn part(detector: &TargetDetector, region: &Region, pixels: &dyn Pixels, reach: u64) -> Patch {
    let (whole, cell) = (pixels.window(), 1u64 << detector.levels().max(2));
    let window = region.bounds.grown(reach + 2 * cell, &whole);
    let back = |at: u64, from: u64| at - (at - from) % cell;
    let (x, y) = (back(window.x, whole.x), back(window.y, whole.y));
    pixels.part(&Window::new(x, y, window.right() - x, window.bottom() - y))
}

/// The target at a place; crosses that are found too near a fifth arm are taken without the quarter where it lies.
pub fn look(detector: &TargetDetector, region: &Region, pixels: &dyn Pixels) -> Option<(Seen, f64)> {
    let (seen, score) = best(detector, region, pixels)?;
    let Some(fifth) = detector.fifth.as_ref().filter(|_| score >= detector.min_score && seen.fit.misfit > CLEAN) else {
        return Some((seen, score));
    };
    best(fifth, region, pixels).filter(|(open, _)| fifth_arm::drew(&seen, open)).or(Some((seen, score)))
}

/// The best of the fits at the scales that answer clearly.
fn best(detector: &TargetDetector, region: &Region, pixels: &dyn Pixels) -> Option<(Seen, f64)> {
    let around = Around::new(detector, region, pixels);
    let mut answers = answers(detector, region, &around.near);
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
    // An open cross is one of several at each place, and most places are none.
    let (most, in_vain) = if detector.one_open() { (2 * fifth_arm::WAYS, 1) } else { (3, 3) };
    let mut found = Vec::new();
    for (tried, answer) in answers.iter().take(most).enumerate() {
        if tried >= in_vain && found.is_empty() {
            break;
        }
        found
            .extend(measure(detector, &around, answer, region).map(|seen| (seen, score(seen.fit.misfit, seen.lights))));
    }
    let best = found.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    best.filter(|(seen, _)| !detector.one_open() || fifth_arm::holds(seen))
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
            let steps = Steps::new(&plane, ring);
            let ways = |at| match &detector.quarters {
                Quarters::Clear => Vec::new(),
                Quarters::OneOpen(discs) => discs[scale.ring].look(&plane, at, detector.least_at(scale)),
            };
            let mut best = ((0, true, 0), (0, 0));
            for (column, row) in cells(&plane, ring.reach, region.bounds, size) {
                let seen = match &detector.quarters {
                    Quarters::Clear => steps.strongest(column, row, detector.motif),
                    Quarters::OneOpen(_) => ways((column, row)).first().copied().unwrap_or((0, true, 0)),
                };
                if seen.0 > best.0.0 {
                    best = (seen, (column, row));
                }
            }
            let (first, (column, row)) = best;
            if first.0 < detector.least_at(scale) {
                continue;
            }
            let place = |cell: u64| (cell as f64 + 0.5) * size as f64;
            let (x, y) = (place(plane.x + column as u64), place(plane.y + row as u64));
            let others = ways((column, row)).into_iter().skip(1);
            found.extend(std::iter::once(first).chain(others).map(|(response, bright, sample)| {
                let direction = direction(ring, sample, detector.motif);
                Answer { scale, response, bright, direction, x, y }
            }));
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

fn measure(detector: &TargetDetector, around: &Around<'_>, answer: &Answer, region: &Region) -> Option<Seen> {
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
    if motif == Motif::Saddle
        && radius < shortest_quarter(detector)
        && !quarters_begin(detector, &around.near, &start, radius)
    {
        return None;
    }
    let hopeful = |sketch: &Fit| may_become_plausible(detector, &around.near, sketch);
    let mut view = View::of(&around.near, start, view, FIT_CELLS)?;
    if detector.one_open() {
        fifth_arm::without_open_quarter(&mut view.samples, &view.start);
    }
    let rough = view.fit(detector, hopeful)?;
    let one = whole(detector, around, &rough, answer, region);
    let Some(border) = (!detector.one_open()).then(|| border_across(detector, &view, &rough)).flatten() else {
        return one;
    };
    // Of two lights more is asked than of one: what they explain no better is even.
    let two = in_two_lights(detector, around, &view, &border, answer, region);
    let two = two.filter(|two| one.is_none_or(|one| two.fit.misfit < TWO_BETTER * one.fit.misfit));
    two.or(one.map(|one| unsure_of_light(&one)))
}

/// The border of a shadow across the view of a fit in one light, cells.
fn border_across(detector: &TargetDetector, view: &View, fit: &Fit) -> Option<Shade> {
    let fit = view.in_cells(fit);
    shade::across(&view.samples, &fit.shares(detector.motif, &view.samples), fit.blur)
}

/// A fit in one light where two seem to fall and cannot be told apart: of drawn ones the centre was off by up to a
/// fiftieth of the side.
fn unsure_of_light(seen: &Seen) -> Seen {
    let own = (0.02 * seen.side_px).powi(2);
    let [xx, xy, yy] = seen.fit.covariance;
    Seen { fit: Fit { covariance: [xx + own, xy, yy + own], ..seen.fit }, ..*seen }
}

/// Two lights leave over at most this share of what one leaves.
const TWO_BETTER: f64 = 0.6;

/// Share of the variance that a rough fit in evened light leaves over at most.
const TWO_MOST_LEFT: f64 = 0.15;

/// The target about a rough fit, in even light: its polished fit and extent.
fn whole(
    detector: &TargetDetector,
    around: &Around<'_>,
    rough: &Fit,
    answer: &Answer,
    region: &Region,
) -> Option<Seen> {
    let (motif, radius) = (detector.motif, answer.scale.radius_px());
    // The middle must be where the answer was, or the fit has run to something else; an open cross may answer beside.
    let reach = if detector.one_open() { radius } else { radius / 2.0 };
    let near = region.bounds.grown(reach.ceil() as u64, &around.pixels.window());
    let inside = rough.x >= near.x as f64
        && rough.y >= near.y as f64
        && rough.x <= near.right() as f64
        && rough.y <= near.bottom() as f64;
    if !inside || !plausible(detector, rough) || rough.misfit > 0.5 {
        return None;
    }
    if motif == Motif::Saddle && ends_near(detector, &around.near, rough) {
        return None;
    }
    // Whose quarters end within what is farther off is seen there whole; of the few that pass all the pixels tell more.
    let farthest = FARTHER_PX as f64 / 1.5;
    let (patch, known) = match motif {
        Motif::Saddle => extent(detector, around.farther(), rough)
            .filter(|(side, _)| *side < farthest)
            .map_or((around.all(), None), |known| (around.farther(), Some(known))),
        Motif::Cross => (around.all(), None),
    };
    let (side_px, _) = known.or_else(|| extent(detector, around.all(), rough))?;
    let fit = polished(detector, patch, rough, side_px)?;
    let (side_px, evenness) = extent(detector, around.all(), rough)?;
    Some(Seen { fit, side_px, evenness, lights: Lights::One })
}

/// The target where the border of a shadow crosses it: measured in light that was evened, and fitted whole.
fn in_two_lights(
    detector: &TargetDetector,
    around: &Around<'_>,
    view: &View,
    border: &Shade,
    answer: &Answer,
    region: &Region,
) -> Option<Seen> {
    let motif = detector.motif;
    let in_light = |shade: &Shade| {
        let even = View { samples: shade.evened(&view.samples), ..*view };
        even.fit(detector, |_| true).filter(|fit| fit.misfit <= TWO_MOST_LEFT && plausible(detector, fit))
    };
    // The fit in one light was off, and with it the border.
    let shade = border_across(detector, view, &in_light(border)?)?;
    let rough = in_light(&shade)?;
    let shade = shade.in_unit(view.scale, view.origin);
    // Most of what is no target ends within the view of its rough fit, where light and shade are evened in no time.
    if motif == Motif::Saddle && ends_near(detector, &shade.evened_patch(&around.near), &rough) {
        return None;
    }
    let even = shade.evened_patch(around.all());
    let seen = whole(detector, &Around::new(detector, region, &even), &rough, answer, region)?;
    let start =
        View::of(around.all(), seen.fit.as_start(), polish_px(detector, &seen.fit, seen.side_px), POLISH_CELLS)?;
    let origin = (-start.origin.0 / start.scale, -start.origin.1 / start.scale);
    let border = shade.in_unit(1.0 / start.scale, origin);
    let (fit, _) = two_lights::fit(motif, &start.samples, &start.in_cells(&seen.fit), &border, detector.skew)?;
    let mut fit = start.in_pixels(&fit);
    fit.covariance[0] += FLOOR_PX * FLOOR_PX;
    fit.covariance[2] += FLOOR_PX * FLOOR_PX;
    plausible(detector, &fit).then_some(Seen { fit, lights: Lights::Two, ..seen })
}

/// Whether the four quarters go on outwards from a ring that is smaller than the smallest target, before anything is
/// fitted: most of what answers on the smallest ring ends there.
fn quarters_begin(detector: &TargetDetector, patch: &Patch, start: &Start, radius: f64) -> bool {
    let quarter = std::f64::consts::FRAC_PI_2;
    let turned = |k: u8| start.angles[0] + quarter / 2.0 + f64::from(k) * quarter;
    let on_ring = |k: u8| {
        let (sin, cos) = turned(k).sin_cos();
        sample_at(patch, start.x + radius * cos, start.y + radius * sin, 1.0)
    };
    let [Some(a), Some(b), Some(c), Some(d)] = [0, 1, 2, 3].map(on_ring) else { return true };
    let fit = Fit {
        x: start.x,
        y: start.y,
        angles: start.angles,
        widths: [start.width; 2],
        blur: start.blur,
        ground: (a + b + c + d) / 4.0 - 0.5 * start.height,
        height: start.height,
        covariance: [0.0; 3],
        misfit: 1.0,
    };
    let shortest = SHARE * shortest_quarter(detector);
    let rays = Rays::new(patch, &fit, shortest + 1.0);
    (0..4).all(|k| rays.follow(turned(k), k % 2 == 0, NO_FLANKS, 0.8 * radius) >= shortest)
}

/// How far the quarters of the smallest target reach along their middles.
fn shortest_quarter(detector: &TargetDetector) -> f64 {
    SMALLEST_SADDLE * detector.side_px.0 * std::f64::consts::FRAC_1_SQRT_2
}

/// Whether the robust rounds may still make a target of what least squares see. Blades and leaves make saddles that
/// end within a few pixels or cross askew: four of five answers over grass. Of 4,200 fits to drawn checkers and
/// hourglasses that became candidates none was farther askew or shorter here.
fn may_become_plausible(detector: &TargetDetector, patch: &Patch, sketch: &Fit) -> bool {
    const SLACK: f64 = 0.15;
    if detector.motif == Motif::Cross {
        return !detector.one_open() || sketch.misfit <= fifth_arm::MOST_LEFT;
    }
    let shortest = SHARE * shortest_quarter(detector);
    // Steps that are fine beside so short a way, whatever the ring.
    let rays = Rays { gap: 2.5, step: 0.5, ..Rays::new(patch, sketch, shortest + 0.5) };
    skew(sketch) < most_skew(detector) + SLACK && quarters(&rays).iter().all(|reach| *reach >= shortest)
}

/// Whether a saddle's extent is less than the smallest: rays that get that far need no more pixels to show it.
fn ends_near(detector: &TargetDetector, patch: &Patch, fit: &Fit) -> bool {
    let shortest = shortest_quarter(detector);
    let rays = Rays::new(patch, fit, shortest);
    // A gap may be passed over that ends behind it.
    let rays = Rays { longest: 1.2 * shortest + rays.gap + rays.step, ..rays };
    quarters(&rays).into_iter().fold(f64::INFINITY, f64::min) * std::f64::consts::SQRT_2
        < SMALLEST_SADDLE * detector.side_px.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::profile::Profile;
    use autoref_raster::RasterSource;
    use autoref_raster::memory::MemorySource;
    use std::cell::Cell;

    /// Counts the pixels that are fetched.
    struct Counted(Patch, Cell<u64>);

    impl Pixels for Counted {
        fn window(&self) -> Window {
            self.0.window
        }

        fn part(&self, window: &Window) -> Patch {
            self.1.set(self.1.get() + window.area());
            self.0.part(window)
        }
    }

    fn looked(rgb: impl Fn(f64, f64) -> u16) -> (Option<Seen>, u64) {
        let side = 600;
        let middle = |i: u64| i as f64 + 0.5 - 300.0;
        let rgb = (0..side * side).map(|i| [rgb(middle(i % side), middle(i / side)); 3]).collect();
        let window = Window::new(0, 0, side, side);
        let patch = Patch { window, rgb, valid: vec![true; (side * side) as usize], white: 255 };
        let pixels = Counted(patch, Cell::new(0));
        let profile = Profile::builtin("black-white-checker").expect("shipped");
        let source = MemorySource::rgb8(side, side, vec![0; (3 * side * side) as usize]);
        let detector = TargetDetector::new(profile, source.info(), None).expect("sound");
        let region = Region {
            first: (298, 298),
            bounds: Window::new(298, 298, 4, 4),
            area: 16,
            sum_x: 0,
            sum_y: 0,
            sum_xx: 0,
            sum_xy: 0,
            sum_yy: 0,
            perimeter: 16,
        };
        let seen = look(&detector, &region, &pixels).map(|(seen, _)| seen);
        (seen, pixels.1.get())
    }

    /// Grass answers twelve times in a thousand pixels; each time all the pixels about the place were copied, and a fit
    /// was polished, for what ends within four pixels.
    #[test]
    fn what_ends_within_a_few_pixels_costs_few_pixels() {
        let checker = |half: f64| {
            move |x: f64, y: f64| match x.abs().max(y.abs()) < half {
                true => {
                    if (x > 0.0) == (y > 0.0) {
                        220
                    } else {
                        30
                    }
                }
                false => 120,
            }
        };
        let (target, _) = looked(checker(12.0));
        let target = target.expect("a target of 24 px");
        assert!((target.fit.x - 300.0).hypot(target.fit.y - 300.0) < 0.05, "{target:?}");
        let (none, fetched) = looked(checker(2.5));
        assert!(none.is_none());
        assert!(fetched < 10_000, "{fetched} pixels for a blot of 5 px");
    }
}
