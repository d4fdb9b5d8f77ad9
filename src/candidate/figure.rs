//! Painted figures that are no square or disc, and whose middle is the point: crosses, chequers of two fields,
//! hourglasses, rings.
//!
//! What they share is symmetry: turned by half a turn about the middle they are themselves, and turned by a quarter
//! they are themselves again (a cross, a ring) or what they left bare (a chequer, an hourglass). Little else in an
//! image is, so no template is needed; and the middle is where the turned picture of the shares of paint meets itself
//! best, to a fraction of a pixel. Squares and discs are left to the fit of an outline ([`super::fit`]): a figure has a
//! hollow.
//!
//! A field of a chequer is a perfect square by itself. So a region is looked at together with paint that touches it.

use nalgebra::Vector2;

use super::Candidate;
use super::evidence::LEAST_CONTRAST;
use super::half_turn::{MOST_MOVED_PX, Picture, SURELY_ALIKE, Turned};
use super::hull::{convex_hull, edges, twice_area};
use super::paint_share::Across;
use super::pierced::with_cracked_off;
use super::pixel_set::{PixelSet, region_of};
use super::scene::Scene;
use super::score::RING_LOOK;
use crate::profile::{Profile, Shape};
use autoref_raster::coords::PixelPoint;

/// Paint so near touches, as a share of the side of a field: the corners of two fields meet where both are
/// half ground, and blur draws them apart. At least and at most so many pixels.
const TOUCH_OF_SIDE: f64 = 0.7;
const TOUCH_PX: (f64, f64) = (2.0, 6.0);
/// The areas of two fields differ by no larger a factor.
const MOST_UNLIKE: f64 = 1.6;
/// Fewer pixels are symmetric by chance.
const LEAST_AREA_PX: usize = 40;
/// Share of its convex hull that a figure fills at most: a square or a disc fills all of it, an hourglass half.
const MOST_FILL: f64 = 0.94;
/// How far beyond the paint the shares are compared.
const BESIDE_PX: usize = 2;
/// Correlation of the shares of paint with themselves turned by half a turn, and by a quarter.
const STRICT: Alike = Alike { half: SURELY_ALIKE, quarter: 0.9 };
/// The same of what leaves so much of its hull bare that no worn square or disc does: crosses sprayed by hand, with
/// irregular arms.
const SPRAYED: Alike = Alike { half: 0.85, quarter: 0.75 };
const MOST_FILL_SPRAYED: f64 = 0.8;
/// The quarter turn is looked at so far out, as a share of the farthest paint: a chequer's corners have nothing to turn
/// into.
const QUARTER_REACH: f64 = 0.7;
/// Where the patch ends before that, at least so far.
const LEAST_QUARTER_REACH: f64 = 0.25;
/// So far from the patch's edge shares are still told, wherever the middle moves.
const SHOWN_PX: f64 = 2.0 * MOST_MOVED_PX + 2.0;

struct Alike {
    half: f64,
    quarter: f64,
}

impl Alike {
    fn is_at_least(&self, least: &Alike) -> bool {
        self.half >= least.half && self.quarter >= least.quarter
    }
}

/// What a region is a part of.
pub(super) enum Figure {
    No,
    Is(Box<Candidate>),
    /// Another region stands for it, it is none that would be believed, or the profile is for other shapes.
    Elsewhere,
}

/// Whether the scene's own paint may be a figure, of the ground right beside it alone: nearly all that has a paint's
/// colour stands out too little, or is a blob that nothing touches.
pub(super) fn may_be_figure(scene: &Scene<'_>) -> bool {
    /// Paint beyond the scene takes a little of the ring away.
    const SLACK: f64 = 0.9;
    let stands_out = || {
        let contrast = |ground| Across::between(ground, scene.plateau()).contrast;
        scene.ring_ground().is_none_or(|ground| contrast(ground) >= SLACK * LEAST_CONTRAST)
    };
    if (scene.own.count() as f64) * (1.0 + MOST_UNLIKE) < LEAST_AREA_PX as f64 || !stands_out() {
        return false;
    }
    let mut touching = scene.other.and(&scene.own.grown(touch_px(&scene.own)));
    while let Some(first) = touching.first() {
        let piece = scene.other.piece(first);
        // How large it is is not seen here.
        if piece.at_edge() {
            return true;
        }
        touching = touching.minus(&piece);
    }
    with_other_field(scene) != scene.own
        || scene.own.count() >= LEAST_AREA_PX && filled(&scene.own, scene.width) <= MOST_FILL
}

/// Whether the scene's own paint, with what touches it, is a figure.
pub(super) fn figure(scene: &Scene<'_>, profile: &Profile) -> Figure {
    let field = with_other_field(scene);
    let alone = field == scene.own;
    let all = if alone { with_cracked_off(scene).unwrap_or(field) } else { field };
    if all.count() < LEAST_AREA_PX || scene.own.at_edge() {
        return Figure::No;
    }
    let fill = filled(&all, scene.width);
    if fill > MOST_FILL {
        return Figure::No;
    }
    // Of a large chequer the patch of one field shows only a part of the other: the middle is where they meet.
    let start = || if all.at_edge() { meeting(&scene.own, &all, scene.width) } else { centroid(&all, scene.width) };
    let whole = scene.with_own(all.clone(), &scene.paint());
    let is_figure = |seen: &Alike| seen.is_at_least(&STRICT);
    let may_be_sprayed = |seen: &Alike| alone && fill <= MOST_FILL_SPRAYED && seen.is_at_least(&SPRAYED);
    let is_alike = |seen: &Alike| is_figure(seen) || may_be_sprayed(seen);
    let Some((seen, candidate)) = symmetric(&whole, &scene.own, start, is_alike) else { return Figure::No };
    let stands = alone || all.first() == scene.own.first();
    let likely = candidate.score.is_some_and(|score| score >= profile.examine.min_score);
    let wanted = matches!(profile.shape, Shape::Any | Shape::Cross);
    if stands && likely && wanted {
        Figure::Is(Box::new(candidate))
    } else if is_figure(&seen) {
        Figure::Elsewhere
    } else {
        Figure::No
    }
}

/// Whether the scene's own paint may be a part of a field that colour found only in part, as it did the other: then the
/// two do not touch.
pub(super) fn may_be_part_of_figure(scene: &Scene<'_>) -> bool {
    /// Of fewer pixels nothing is grown.
    const LEAST_PART_PX: usize = 12;
    let own = scene.own.count();
    // Of a field that is found to a third the other's paint is a side and a half away.
    let reach = (1.5 * (3.0 * own as f64).sqrt()) as usize + 2;
    let stands_out = |ground| Across::between(ground, scene.plateau()).contrast >= LEAST_CONTRAST;
    own >= LEAST_PART_PX
        && !scene.other.and(&scene.own.grown(reach)).is_empty()
        && scene.ring_ground().is_some_and(stands_out)
}

/// The same as [`figure`], of all that is more paint than ground and hangs together with what colour found.
pub(super) fn figure_in_part(scene: &Scene<'_>, profile: &Profile) -> Figure {
    let plateau = scene.plateau();
    let Some(ground) = scene.ring_ground() else { return Figure::No };
    let shares = Across::between(ground, plateau).shares(scene);
    let is_paint = |i: usize| {
        let colour = scene.colour(i);
        shares[i] > 0.5 && (colour - plateau).norm_squared() < (colour - ground.mean).norm_squared()
    };
    let found = scene.paint();
    let Some(paint) = found.spread(&scene.valid, is_paint, |_, _| true) else { return Figure::No };
    let paint = paint.or(&found);
    let Some(first) = scene.own.first() else { return Figure::No };
    let own = paint.piece(first);
    // Of the parts of a field the first stands for it; of a field that colour found whole nothing is new.
    if own == scene.own || found.and(&own).first() != Some(first) {
        return Figure::No;
    }
    let grown = Scene::of_pixels(scene.patch, own, &paint);
    match figure(&grown, profile) {
        // Grown alone it is no field: what colour found of it is looked at as any other region.
        Figure::Elsewhere if with_other_field(&grown) == grown.own => Figure::No,
        found => found,
    }
}

/// The own paint, with the other field where just one piece of about its size touches it. In a crowd of marks each
/// stands for itself.
fn with_other_field(scene: &Scene<'_>) -> PixelSet {
    match &other_fields(&scene.own, &scene.other, touch_px(&scene.own), MOST_UNLIKE)[..] {
        [piece] => scene.own.or(piece),
        _ => scene.own.clone(),
    }
}

/// Pieces of other paint of the own size, but for a factor, so near to it; none where a larger one is too. Specks do
/// not count: ground of the paint's colour has them everywhere.
fn other_fields(own: &PixelSet, other: &PixelSet, reach_px: usize, most_unlike: f64) -> Vec<PixelSet> {
    /// Specks are smaller than the own paint by more than this factor.
    const SPECK: f64 = 6.0;
    let mut near = other.and(&own.grown(reach_px));
    let own = own.count() as f64;
    let mut fields = vec![];
    while let Some(first) = near.first() {
        let piece = other.piece(first);
        near = near.minus(&piece);
        let size = piece.count() as f64;
        if piece.at_edge() || SPECK * size > own {
            if size >= most_unlike * own || !piece.at_edge() && own >= most_unlike * size {
                return vec![];
            }
            fields.push(piece);
        }
    }
    fields
}

/// Of fields of a few pixels blur leaves more or less, and draws them further apart. Larger ones are as large as each
/// other, and show their form: a number beside a mark is no field of it.
const LARGE_PX: usize = 100;
const LEAST_COMMON: f64 = 0.65;

/// Where the middle of a figure lies, from that of the own paint, if this is one of its two fields: paint of about its
/// size lies beside it, the largest such for the other, and of its form, when they are large enough to show one. In
/// pixels to the right and down.
pub(super) fn middle_if_field(scene: &Scene<'_>) -> Option<Vector2<f64>> {
    let fields = fields_beside(scene)?;
    let other = fields.iter().max_by_key(|piece| piece.count())?;
    // Of a cross in four bars two lie across.
    if scene.own.count() < LARGE_PX || fields.len() > 1 {
        return Some((centroid(other, scene.width) - centroid(&scene.own, scene.width)) / 2.0);
    }
    middle_if_alike(scene, other)
}

/// The same where the own paint is large enough to show its form, and just one other piece of paint has it.
pub(super) fn middle_if_plain_field(scene: &Scene<'_>) -> Option<Vector2<f64>> {
    let fields = (scene.own.count() >= LARGE_PX).then(|| fields_beside(scene)).flatten()?;
    let [other] = &fields[..] else { return None };
    middle_if_alike(scene, other)
}

fn middle_if_alike(scene: &Scene<'_>, other: &PixelSet) -> Option<Vector2<f64>> {
    let apart = centroid(other, scene.width) - centroid(&scene.own, scene.width);
    let (common, apart) = common_by_half_turn(scene, other, apart);
    (common > LEAST_COMMON).then_some(apart / 2.0)
}

/// Paint of about the size of the own paint that lies beside it.
fn fields_beside(scene: &Scene<'_>) -> Option<Vec<PixelSet>> {
    const MOST_UNLIKE_PART: f64 = 3.0;
    const NEAR_PX: (f64, f64) = (4.0, 9.0);
    let reach = (scene.own.count() as f64).sqrt().clamp(NEAR_PX.0, NEAR_PX.1);
    if scene.other.and(&scene.own.grown(reach as usize)).is_empty() {
        return None;
    }
    // Ground of the paint's colour may join the other field: what is as different from the own paint as ground is, is
    // no field.
    let (paint, ground) = (scene.plateau(), scene.ring_ground()?.mean);
    let is_paint = |i: usize| {
        let colour = scene.colour(i);
        scene.other.has(i) && (colour - paint).norm_squared() < (colour - ground).norm_squared()
    };
    let other = PixelSet::from_fn(scene.width, scene.height, is_paint);
    let most_unlike = if scene.own.count() >= LARGE_PX { MOST_UNLIKE } else { MOST_UNLIKE_PART };
    Some(other_fields(&scene.own, &other, reach as usize, most_unlike))
}

/// The share of their pixels that the own paint and another set have in common, when half a turn lays one on the other,
/// and how far their middles are apart then, near to what is given: the patch may cut the other set, of which only the
/// pixels of the patch count. Of places where they are as alike the nearest.
fn common_by_half_turn(scene: &Scene<'_>, other: &PixelSet, apart: Vector2<f64>) -> (f64, Vector2<f64>) {
    const REACH_PX: i32 = 2;
    const REACH_OF_CUT_PX: i32 = 10;
    let reach = if other.at_edge() { REACH_OF_CUT_PX } else { REACH_PX };
    let ends = 2.0 * centroid(&scene.own, scene.width);
    let turned: Vec<Vector2<f64>> = scene.own.iter().map(|i| ends - centre_of(i, scene.width)).collect();
    let steps = || (-reach..=reach).map(f64::from);
    let moves = steps().flat_map(|dy| steps().map(move |dx| Vector2::new(dx, dy)));
    let mut best = (0.0, apart);
    let mut best_move = f64::INFINITY;
    for by in moves {
        let to = apart + by;
        let met = turned.iter().filter(|p| has(other, *p + to, scene)).count();
        let shown = turned.iter().filter(|p| has(&scene.valid, *p + to, scene)).count();
        let common = met as f64 / (shown + other.count() - met) as f64;
        if common > best.0 || common == best.0 && by.norm() < best_move {
            (best, best_move) = ((common, to), by.norm());
        }
    }
    best
}

/// How far from a field paint touches it.
fn touch_px(field: &PixelSet) -> usize {
    (TOUCH_OF_SIDE * (field.count() as f64).sqrt()).clamp(TOUCH_PX.0, TOUCH_PX.1) as usize
}

/// The share of its convex hull that a set fills: 1 when all pixels whose middle lies in the hull are there (G. Pick,
/// "Geometrisches zur Zahlenlehre", 1899).
pub(super) fn filled(set: &PixelSet, width: usize) -> f64 {
    // First and last pixel of every row.
    let mut rows: Vec<[(i64, i64); 2]> = Vec::new();
    set.for_each(|i| {
        let p = ((i % width) as i64, (i / width) as i64);
        match rows.last_mut() {
            Some([first, last]) if first.1 == p.1 => *last = p,
            _ => rows.push([p, p]),
        }
    });
    let hull = convex_hull(rows.into_iter().flatten().collect());
    let on_border: i64 = edges(&hull).map(|(a, b)| common_divisor((a.0 - b.0).abs(), (a.1 - b.1).abs())).sum();
    let inside = (twice_area(&hull) + on_border) as f64 / 2.0 + 1.0;
    set.count() as f64 / inside
}

fn common_divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { common_divisor(b, a % b) }
}

/// The middle of what may be a figure, looked for from `start`, and how alike it is to itself; `None` of what is not
/// alike enough.
fn symmetric(
    scene: &Scene<'_>,
    part: &PixelSet,
    start: impl Fn() -> Vector2<f64>,
    is_enough: impl Fn(&Alike) -> bool,
) -> Option<(Alike, Candidate)> {
    let paint = scene.plateau();
    let across = Across::between(scene.ring_ground()?, paint);
    if across.contrast < LEAST_CONTRAST {
        return None;
    }
    let start = start();
    let shares: Vec<f64> = across.shares(scene).into_iter().map(|share| share.clamp(-0.5, 1.5)).collect();
    let picture = Picture { shares: &shares, width: scene.width, height: scene.height };
    // What the patch shows of both sides.
    let shown = |p: &Vector2<f64>| {
        let q = 2.0 * start - p;
        let within = |v: f64, size: usize| (SHOWN_PX..=size as f64 - SHOWN_PX).contains(&v);
        [*p, q].iter().all(|p| within(p.x, scene.width) && within(p.y, scene.height))
    };
    let beside = scene.own.grown(BESIDE_PX).and(&scene.valid);
    let places: Vec<Vector2<f64>> = beside.iter().map(|i| centre_of(i, scene.width)).filter(shown).collect();
    if places.len() < LEAST_AREA_PX {
        return None;
    }
    let (turned, places, holes) = without_holes(&picture, scene, places, start)?;
    if turned.correlation < SPRAYED.half {
        return None;
    }
    let reach = part.iter().map(|i| (centre_of(i, scene.width) - turned.middle).norm()).fold(0.0, f64::max);
    let look_px = (QUARTER_REACH * reach).min(border_distance(scene, turned.middle) - 1.5);
    if look_px < LEAST_QUARTER_REACH * reach {
        return None;
    }
    let by_quarter = |p: Vector2<f64>| {
        let d = p - turned.middle;
        turned.middle + Vector2::new(-d.y, d.x)
    };
    let is_whole = |p: &Vector2<f64>| [*p, by_quarter(*p)].iter().all(|p| !has(&holes, *p, scene));
    let near: Vec<Vector2<f64>> = places_within(scene, turned.middle, look_px).filter(is_whole).collect();
    let quarter = picture.correlation(&near, by_quarter)?;
    let alike = Alike { half: turned.correlation, quarter: quarter.abs() };
    if !is_enough(&alike) {
        return None;
    }
    let score = RING_LOOK.score(across.contrast, (turned.mean_square / 2.0).sqrt(), 0.0);
    let region = region_of(&scene.own, scene.patch)?;
    let window = &scene.patch.window;
    let byte = [paint[0], paint[1], paint[2]].map(|v| v.clamp(0.0, 255.0).round() as u8);
    let candidate = Candidate {
        centre: PixelPoint { x: window.x as f64 + turned.middle.x, y: window.y as f64 + turned.middle.y },
        covariance_px2: Some(picture.covariance_px2(&turned, &places)?),
        score: Some(score),
        area_px: Some(scene.own.count() as f64),
        size_px: Some([region.bounds.width as f64, region.bounds.height as f64]),
        elevation_m: None,
        code: None,
        paint: Some(byte),
    };
    Some((alike, candidate))
}

/// The picture turned by half a turn, the places that were compared, and where paint has come off: pixels that are bare
/// though those which they turn into are painted. They say nothing of the middle, and are left out where they are few.
fn without_holes(
    picture: &Picture<'_>,
    scene: &Scene<'_>,
    places: Vec<Vector2<f64>>,
    start: Vector2<f64>,
) -> Option<(Turned, Vec<Vector2<f64>>, PixelSet)> {
    /// Shares of paint and of ground differ by more.
    const DIFFERENT: f64 = 0.5;
    /// Of the paint, what may have come off.
    const MOST_GONE: f64 = 0.2;
    let turned = picture.turned_half(&places, start)?;
    let mut holes = PixelSet::empty(scene.width, scene.height);
    if turned.correlation >= STRICT.half {
        return Some((turned, places, holes));
    }
    let opposite = |p: Vector2<f64>| 2.0 * turned.middle - p;
    for p in &places {
        let is_bare =
            picture.at(opposite(*p)).zip(picture.at(*p)).is_some_and(|(there, here)| there - here > DIFFERENT);
        if is_bare {
            holes.insert(p.y as usize * scene.width + p.x as usize);
        }
    }
    if holes.count() as f64 > MOST_GONE * scene.own.count() as f64 {
        return Some((turned, places, PixelSet::empty(scene.width, scene.height)));
    }
    // Blur takes a pixel more all around.
    let unseen = holes.grown(1);
    let is_whole = |p: &&Vector2<f64>| [**p, opposite(**p)].iter().all(|p| !has(&unseen, *p, scene));
    let whole: Vec<Vector2<f64>> = places.iter().filter(is_whole).copied().collect();
    let again = (whole.len() >= LEAST_AREA_PX).then(|| picture.turned_half(&whole, turned.middle)).flatten();
    Some(match again {
        Some(again) => (again, whole, unseen),
        None => (turned, places, PixelSet::empty(scene.width, scene.height)),
    })
}

/// Whether the pixel at a place is one of a set.
fn has(set: &PixelSet, p: Vector2<f64>, scene: &Scene<'_>) -> bool {
    let inside = p.x >= 0.0 && p.y >= 0.0 && p.x < scene.width as f64 && p.y < scene.height as f64;
    inside && set.has(p.y as usize * scene.width + p.x as usize)
}

fn centroid(set: &PixelSet, width: usize) -> Vector2<f64> {
    let sum = set.iter().map(|i| centre_of(i, width)).fold(Vector2::zeros(), |sum, p| sum + p);
    sum / set.count() as f64
}

/// Half-way between the part and the rest of a set, where they are nearest to each other.
fn meeting(part: &PixelSet, all: &PixelSet, width: usize) -> Vector2<f64> {
    // Of two sets the nearest pixels lie on their borders: from any other one a neighbour is nearer.
    let border = |set: &PixelSet| set.minus(&set.shrunk(1));
    let rest: Vec<Vector2<f64>> = border(&all.minus(part)).iter().map(|i| centre_of(i, width)).collect();
    let part = border(part);
    let pairs = part.iter().map(|i| centre_of(i, width)).flat_map(|p| rest.iter().map(move |q| (p, *q)));
    let nearest = pairs.min_by(|a, b| (a.0 - a.1).norm_squared().total_cmp(&(b.0 - b.1).norm_squared()));
    nearest.map_or_else(|| centroid(all, width), |(p, q)| (p + q) / 2.0)
}

fn centre_of(i: usize, width: usize) -> Vector2<f64> {
    Vector2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5)
}

/// How far the patch goes on around a place in every direction, pixels.
fn border_distance(scene: &Scene<'_>, p: Vector2<f64>) -> f64 {
    let [w, h] = [scene.width, scene.height].map(|side| side as f64);
    [p.x, p.y, w - p.x, h - p.y].into_iter().fold(f64::INFINITY, f64::min)
}

fn places_within<'s>(
    scene: &'s Scene<'_>,
    middle: Vector2<f64>,
    reach_px: f64,
) -> impl Iterator<Item = Vector2<f64>> + 's {
    scene.valid.iter().map(|i| centre_of(i, scene.width)).filter(move |p| (p - middle).norm() <= reach_px)
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{colour, inside, patch_of};
    use super::*;

    fn filled_by(wanted: impl Fn(f64, f64) -> bool) -> f64 {
        let set = PixelSet::from_fn(48, 48, |i| wanted((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5));
        filled(&set, 48)
    }

    #[test]
    fn squares_and_discs_fill_their_hull_and_figures_do_not() {
        assert_eq!(filled(&inside(18..30, 18..30), 48), 1.0);
        assert!(filled_by(|x, y| x.hypot(y) < 9.0) > 0.93);
        assert!(filled_by(|x, y| (x + y).abs() < 13.0 && (x - y).abs() < 13.0) > 0.9);
        assert!(filled_by(|x, y| x.abs().max(y.abs()) < 12.0 && x.abs().min(y.abs()) < 4.0) < 0.8, "a cross");
        assert!(filled_by(|x, y| x.abs().max(y.abs()) < 10.0 && x * y > 0.0) < 0.75, "a chequer");
        assert!(filled_by(|x, y| (5.0..11.0).contains(&x.hypot(y))) < 0.85, "a ring");
    }

    fn look(wanted: impl Fn(f64, f64) -> bool) -> Figure {
        let set = PixelSet::from_fn(48, 48, |i| wanted((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5));
        let patch = patch_of(|i| colour(i, set.has(i)));
        let first = set.piece(set.first().expect("some"));
        figure(&Scene::of_pixels(&patch, first, &set), &Profile::builtin("orange").expect("shipped"))
    }

    /// A small field beside its like says where the figure's middle would be; alone, or beside much more paint,
    /// nothing.
    #[test]
    fn a_field_tells_the_middle_of_its_figure() {
        let middle = |wanted: &dyn Fn(f64, f64) -> bool| {
            let set = PixelSet::from_fn(48, 48, |i| wanted((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5));
            let patch = patch_of(|i| colour(i, set.has(i)));
            let scene = Scene::of_pixels(&patch, set.piece(set.first().expect("some")), &set);
            middle_if_field(&scene).map(|off| centroid(&scene.own, 48) + off)
        };
        for half in [4.0, 6.0] {
            let apart = |x: f64, y: f64| x.abs().max(y.abs()) < half && x * y > 0.0 && x.hypot(y) > 2.0;
            let found = middle(&apart).expect("two fields");
            assert!((found - Vector2::new(24.0, 24.0)).norm() < 0.1, "{found}");
        }
        // Of fields that the patch cuts too.
        for (half, gap) in [(13.0, 1.2), (19.0, 1.2)] {
            let apart = |x: f64, y: f64| {
                let (x, y) = (x - 4.0, y - 4.0);
                x.abs().max(y.abs()) < half && x * y > 0.0 && x.abs().min(y.abs()) > gap
            };
            let found = middle(&apart).expect("two fields");
            assert!((found - Vector2::new(28.0, 28.0)).norm() < 1.0, "{found}");
        }
        // A square, and a seven of about its size beside it.
        let number = |x: f64, y: f64| {
            let square = (-18.0..-4.0).contains(&x) && y.abs() < 7.0;
            let bar = (-1.0..15.0).contains(&x) && (-11.0..-7.0).contains(&y);
            square || bar || (11.0..15.0).contains(&x) && (-7.0..14.0).contains(&y)
        };
        assert!(middle(&number).is_none());
        let square = |x: f64, y: f64| x.abs().max(y.abs()) < 3.0;
        assert!(middle(&square).is_none());
        assert!(middle(&|x, y| square(x, y) || y > 5.0 && y < 14.0).is_none(), "beside a wall");
        assert!(middle(&|x, y| square(x, y) || (x - 5.0).hypot(y - 5.0) < 1.0).is_none(), "beside a speck");
    }

    #[test]
    fn figures_have_their_middle_and_halves_have_none() {
        let chequer = |x: f64, y: f64| x.abs().max(y.abs()) < 10.0 && x * y > 0.0;
        let apart = |x: f64, y: f64| chequer(x, y) && x.hypot(y) > 2.0;
        let cross = |x: f64, y: f64| x.abs().max(y.abs()) < 12.0 && x.abs().min(y.abs()) < 4.0;
        let ring = |x: f64, y: f64| (5.0..11.0).contains(&x.hypot(y));
        for wanted in [&chequer as &dyn Fn(f64, f64) -> bool, &apart, &cross, &ring] {
            let Figure::Is(found) = look(wanted) else { panic!("{} % filled", 100.0 * filled_by(wanted)) };
            assert!((found.centre.x - 24.0).hypot(found.centre.y - 24.0) < 0.02, "{:?}", found.centre);
        }
        // Paint has come off an arm, and at its end.
        let worn = |x: f64, y: f64| cross(x, y) && (x - 9.0).hypot(y - 1.0) > 2.0 && (x + 1.0).hypot(y + 11.0) > 2.5;
        let Figure::Is(found) = look(worn) else { panic!("a worn cross") };
        assert!((found.centre.x - 24.0).hypot(found.centre.y - 24.0) < 0.1, "{:?}", found.centre);
        for wanted in [
            &(|x: f64, y: f64| x.abs().max(y.abs()) < 6.0) as &dyn Fn(f64, f64) -> bool,
            &|x: f64, y: f64| x.hypot(y) < 9.0,
            // A corner of a wall, and two marks side by side.
            &|x: f64, y: f64| (-10.0..10.0).contains(&x) && (-10.0..10.0).contains(&y) && (x < -4.0 || y > 4.0),
            &|x: f64, y: f64| (x.abs() - 6.0).abs() < 5.6 && y.abs() < 5.6,
        ] {
            assert!(matches!(look(wanted), Figure::No));
        }
    }

    #[test]
    fn a_chequer_that_the_patch_cuts_has_its_middle() {
        // Fields of 24 px of which the patch shows one, and 21 px of the other.
        let field = |i: usize, from: usize| (i % 48).min(i / 48) >= from && (i % 48).max(i / 48) < from + 24;
        let set = PixelSet::from_fn(48, 48, |i| field(i, 3) || field(i, 27));
        let patch = patch_of(|i| colour(i, set.has(i)));
        let upper = PixelSet::from_fn(48, 48, |i| field(i, 3));
        let found = figure(&Scene::of_pixels(&patch, upper, &set), &Profile::builtin("orange").expect("shipped"));
        let Figure::Is(found) = found else { panic!("a field is no mark") };
        assert!((found.centre.x - 27.0).hypot(found.centre.y - 27.0) < 0.05, "{:?}", found.centre);
    }

    #[test]
    fn the_lower_field_of_a_chequer_leaves_it_to_the_upper() {
        let apart = |i: usize| {
            let (x, y) = ((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5);
            x.abs().max(y.abs()) < 10.0 && x * y > 0.0 && x.hypot(y) > 2.0
        };
        let set = PixelSet::from_fn(48, 48, apart);
        let patch = patch_of(|i| colour(i, set.has(i)));
        let lower = set.minus(&set.piece(set.first().expect("some")));
        let found = figure(&Scene::of_pixels(&patch, lower, &set), &Profile::builtin("orange").expect("shipped"));
        assert!(matches!(found, Figure::Elsewhere));
    }
}
