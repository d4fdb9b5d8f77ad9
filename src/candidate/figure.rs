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

use nalgebra::{Matrix2, Vector2};

use super::Candidate;
use super::examine::LEAST_CONTRAST;
use super::paint_share::{Across, plateau, ring_ground};
use super::pixel_set::PixelSet;
use super::scene::Scene;
use super::score::Populations;
use super::split::region_of;
use crate::profile::{Profile, Shape};
use autoref_raster::coords::PixelPoint;

/// Paint so near touches, as a share of the side of the smaller piece: the corners of two fields meet where both are
/// half ground, and blur draws them apart. At least and at most so many pixels.
const TOUCH_OF_SIDE: f64 = 0.7;
const TOUCH_PX: (f64, f64) = (2.0, 6.0);
/// Fewer pixels are symmetric by chance.
const LEAST_AREA_PX: usize = 40;
/// Share of its convex hull that a figure fills at most: a square or a disc fills all of it, an hourglass half.
const MOST_FILL: f64 = 0.94;
/// How far beyond the paint the shares are compared.
const BESIDE_PX: usize = 2;
/// Correlation of the shares of paint with themselves turned by half a turn, and by a quarter.
const LEAST_HALF: f64 = 0.95;
const LEAST_QUARTER: f64 = 0.9;
/// The quarter turn is looked at so far out, as a share of the farthest paint: a chequer's corners have nothing to turn
/// into.
const QUARTER_REACH: f64 = 0.7;
/// Noise of neighbouring pixels goes together.
const TOGETHER: f64 = 4.0;
/// A standard deviation of the middle is hardly less, pixels.
const LEAST_SIGMA_PX: f64 = 0.03;
const ROUNDS: usize = 8;

/// What a region is a part of.
pub(super) enum Figure {
    No,
    Is(Box<Candidate>),
    /// Another region stands for it, it is none that would be believed, or the profile is for other shapes.
    Elsewhere,
}

/// Whether the scene's own paint, with what touches it, is a figure.
pub(super) fn figure(scene: &Scene<'_>, profile: &Profile) -> Figure {
    let all = with_touching(scene);
    let alone = all == scene.own;
    if all.count() < LEAST_AREA_PX || all.at_edge() || filled(&all, scene.width) > MOST_FILL {
        return Figure::No;
    }
    let whole = scene.with_own(all.clone(), &scene.paint());
    let Some(candidate) = symmetric(&whole) else { return Figure::No };
    let stands = alone || all.first() == scene.own.first();
    let likely = candidate.score.is_some_and(|score| score >= profile.examine.min_score);
    if stands && likely && matches!(profile.shape, Shape::Any | Shape::Cross) {
        Figure::Is(Box::new(candidate))
    } else {
        Figure::Elsewhere
    }
}

/// The own paint and every piece that touches it, or touches one that does.
fn with_touching(scene: &Scene<'_>) -> PixelSet {
    let mut all = scene.own.clone();
    if scene.other.is_empty() {
        return all;
    }
    let touch_px = |pixels: usize| (TOUCH_OF_SIDE * (pixels as f64).sqrt()).clamp(TOUCH_PX.0, TOUCH_PX.1) as usize;
    let mut left = scene.other.and(&all.grown(touch_px(all.count())));
    while let Some(first) = left.first() {
        let piece = scene.other.piece(first);
        left = left.minus(&piece);
        let touch_px = touch_px(all.count().min(piece.count()));
        if !piece.and(&all.grown(touch_px)).is_empty() {
            all = all.or(&piece);
            left = left.or(&scene.other.and(&piece.grown(touch_px))).minus(&all);
        }
    }
    all
}

/// The share of its convex hull that a set fills: 1 when all pixels whose middle lies in the hull are there (G. Pick,
/// "Geometrisches zur Zahlenlehre", 1899; the hull by A. M. Andrew, "Another efficient algorithm for convex hulls in
/// two dimensions", 1979).
fn filled(set: &PixelSet, width: usize) -> f64 {
    // First and last pixel of every row.
    let mut rows: Vec<[i64; 3]> = Vec::new();
    set.for_each(|i| {
        let (x, y) = ((i % width) as i64, (i / width) as i64);
        match rows.last_mut() {
            Some(row) if row[0] == y => row[2] = x,
            _ => rows.push([y, x, x]),
        }
    });
    let cross = |o: [i64; 2], a: [i64; 2], b: [i64; 2]| (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0]);
    let chain = |side: usize, turn: i64| {
        let mut hull: Vec<[i64; 2]> = Vec::new();
        for row in &rows {
            let p = [row[side], row[0]];
            while hull.len() >= 2 && turn * cross(hull[hull.len() - 2], hull[hull.len() - 1], p) <= 0 {
                hull.pop();
            }
            hull.push(p);
        }
        hull
    };
    let mut hull = chain(1, -1);
    hull.extend(chain(2, 1).into_iter().rev());
    let (mut twice_area, mut on_border) = (0i64, 0i64);
    for (a, b) in hull.iter().zip(hull.iter().cycle().skip(1)) {
        twice_area += a[0] * b[1] - b[0] * a[1];
        on_border += common_divisor((a[0] - b[0]).abs(), (a[1] - b[1]).abs());
    }
    let inside = (twice_area.abs() + on_border) as f64 / 2.0 + 1.0;
    set.count() as f64 / inside
}

fn common_divisor(a: i64, b: i64) -> i64 {
    if b == 0 { a } else { common_divisor(b, a % b) }
}

/// The figure's middle, when it is one.
fn symmetric(scene: &Scene<'_>) -> Option<Candidate> {
    let paint = plateau(scene);
    let across = Across::between(&ring_ground(scene)?, paint);
    if across.contrast < LEAST_CONTRAST {
        return None;
    }
    let shares: Vec<f64> = across.shares(scene).into_iter().map(|share| share.clamp(-0.5, 1.5)).collect();
    let picture = Picture { shares: &shares, width: scene.width, height: scene.height };
    let (mut n, mut middle) = (0.0, Vector2::zeros());
    scene.own.for_each(|i| {
        n += 1.0;
        middle += centre_of(i, scene.width);
    });
    middle /= n;
    let places: Vec<Vector2<f64>> =
        scene.own.grown(BESIDE_PX).and(&scene.valid).iter().map(|i| centre_of(i, scene.width)).collect();
    let turned = picture.turned_half(&places, middle)?;
    let reach = scene.own.iter().map(|i| (centre_of(i, scene.width) - turned.middle).norm()).fold(0.0, f64::max);
    let near: Vec<Vector2<f64>> = places_within(scene, turned.middle, QUARTER_REACH * reach).collect();
    let quarter = picture.correlation(&near, |p| {
        let d = p - turned.middle;
        turned.middle + Vector2::new(-d.y, d.x)
    })?;
    if turned.correlation < LEAST_HALF || quarter.abs() < LEAST_QUARTER {
        return None;
    }
    let score = Populations::of(false).score(across.contrast, turned.rms, 0.0);
    let region = region_of(&scene.own, scene.patch)?;
    let window = &scene.patch.window;
    let byte = [paint[0], paint[1], paint[2]].map(|v| v.clamp(0.0, 255.0).round() as u8);
    Some(Candidate {
        centre: PixelPoint { x: window.x as f64 + turned.middle.x, y: window.y as f64 + turned.middle.y },
        covariance_px2: Some(turned.covariance_px2),
        score: Some(score),
        area_px: Some(n),
        size_px: Some([region.bounds.width as f64, region.bounds.height as f64]),
        elevation_m: None,
        code: None,
        paint: Some(byte),
    })
}

fn centre_of(i: usize, width: usize) -> Vector2<f64> {
    Vector2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5)
}

fn places_within<'s>(
    scene: &'s Scene<'_>,
    middle: Vector2<f64>,
    reach_px: f64,
) -> impl Iterator<Item = Vector2<f64>> + 's {
    scene.valid.iter().map(|i| centre_of(i, scene.width)).filter(move |p| (p - middle).norm() <= reach_px)
}

/// Shares of paint, pixel by pixel.
struct Picture<'a> {
    shares: &'a [f64],
    width: usize,
    height: usize,
}

/// A picture that was turned by half a turn onto itself.
struct Turned {
    middle: Vector2<f64>,
    correlation: f64,
    /// Of a share of paint.
    rms: f64,
    covariance_px2: [f64; 3],
}

impl Picture<'_> {
    /// Between the middles of four pixels; `None` outside.
    fn at(&self, p: Vector2<f64>) -> Option<f64> {
        let (x, y) = (p.x - 0.5, p.y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < (self.width - 1) as f64 && y < (self.height - 1) as f64) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = (x - column as f64, y - row as f64);
        let s = |dx: usize, dy: usize| self.shares[(row + dy) * self.width + column + dx];
        Some((s(0, 0) * (1.0 - u) + s(1, 0) * u) * (1.0 - v) + (s(0, 1) * (1.0 - u) + s(1, 1) * u) * v)
    }

    fn slope(&self, p: Vector2<f64>) -> Option<Vector2<f64>> {
        let along = |d: Vector2<f64>| Some((self.at(p + d)? - self.at(p - d)?) / 2.0);
        Some(Vector2::new(along(Vector2::x())?, along(Vector2::y())?))
    }

    /// Correlation of the shares at some places with those where the places come to lie.
    fn correlation(&self, places: &[Vector2<f64>], to: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Option<f64> {
        let pairs: Vec<(f64, f64)> =
            places.iter().map(|p| Some((self.at(*p)?, self.at(to(*p))?))).collect::<Option<_>>()?;
        let n = pairs.len() as f64;
        let (a, b) = (pairs.iter().map(|p| p.0).sum::<f64>() / n, pairs.iter().map(|p| p.1).sum::<f64>() / n);
        let sum = |of: fn(f64, f64) -> f64| pairs.iter().map(|p| of(p.0 - a, p.1 - b)).sum::<f64>();
        let scatter = (sum(|x, _| x * x) * sum(|_, y| y * y)).sqrt();
        (scatter > 0.0).then(|| sum(|x, y| x * y) / scatter)
    }

    /// The middle about which the shares turn onto themselves, by Gauss and Newton from `middle`.
    fn turned_half(&self, places: &[Vector2<f64>], mut middle: Vector2<f64>) -> Option<Turned> {
        let start = middle;
        let mut normal = Matrix2::zeros();
        let mut square = 0.0;
        for _ in 0..ROUNDS {
            normal = Matrix2::zeros();
            square = 0.0;
            let mut right = Vector2::zeros();
            for p in places {
                let q = 2.0 * middle - p;
                let left = self.at(*p)? - self.at(q)?;
                // Moving the middle by one moves the turned place by two.
                let slope = -2.0 * self.slope(q)?;
                normal += slope * slope.transpose();
                right -= slope * left;
                square += left * left;
            }
            let step = normal.cholesky()?.solve(&right);
            middle += step;
            if (middle - start).norm() > 2.0 {
                return None;
            }
            if step.norm() < 1e-4 {
                break;
            }
        }
        let correlation = self.correlation(places, |p| 2.0 * middle - p)?;
        let mean_square = square / places.len() as f64;
        // Each two places are compared twice.
        let inverse = normal.try_inverse()? * (2.0 * TOGETHER * mean_square);
        let least = LEAST_SIGMA_PX * LEAST_SIGMA_PX;
        Some(Turned {
            middle,
            correlation,
            rms: (mean_square / 2.0).sqrt(),
            covariance_px2: [inverse[(0, 0)] + least, inverse[(0, 1)], inverse[(1, 1)] + least],
        })
    }
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

    #[test]
    fn figures_have_their_middle_and_halves_have_none() {
        let chequer = |x: f64, y: f64| x.abs().max(y.abs()) < 10.0 && x * y > 0.0;
        let apart = |x: f64, y: f64| chequer(x, y) && x.abs().min(y.abs()) > 0.6;
        let cross = |x: f64, y: f64| x.abs().max(y.abs()) < 12.0 && x.abs().min(y.abs()) < 4.0;
        let hourglass = |x: f64, y: f64| y.abs() < 11.0 && x.abs() <= y.abs();
        for wanted in [&chequer as &dyn Fn(f64, f64) -> bool, &apart, &cross, &hourglass] {
            let Figure::Is(found) = look(wanted) else { panic!("a figure") };
            assert!((found.centre.x - 24.0).hypot(found.centre.y - 24.0) < 0.02, "{:?}", found.centre);
        }
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
    fn the_lower_field_of_a_chequer_leaves_it_to_the_upper() {
        let apart = |i: usize| {
            let (x, y) = ((i % 48) as f64 - 23.5, (i / 48) as f64 - 23.5);
            x.abs().max(y.abs()) < 10.0 && x * y > 0.0 && x.abs().min(y.abs()) > 0.6
        };
        let set = PixelSet::from_fn(48, 48, apart);
        let patch = patch_of(|i| colour(i, set.has(i)));
        let lower = set.minus(&set.piece(set.first().expect("some")));
        let found = figure(&Scene::of_pixels(&patch, lower, &set), &Profile::builtin("orange").expect("shipped"));
        assert!(matches!(found, Figure::Elsewhere));
    }
}
