//! The whole mark: before a centre is believed, what colour found is grown to the edge that the picture shows.
//!
//! The colour test only says where to look. Where a part of a mark lies beyond its limit, the part has a centre of its
//! own, and a fit to it knows nothing of the rest. So the pixels connected to the region that look more like its paint
//! than like the ground beside it are its mark too; the ground is measured again around what has grown until nothing
//! changes.

use nalgebra::{Matrix3, Vector3};

use super::fit::Fit;
use super::kernels::Form;
use super::pixel_set::PixelSet;
use super::scene::{Ground, RING_PX, Scene};

/// Rounds of growing; the ground changes little after the second.
const ROUNDS: usize = 3;
/// A region that grows by less than this share is whole.
pub(super) const LEAST_GROWTH: f64 = 0.12;

/// What a region is of its mark.
pub(super) enum Whole {
    /// All of it.
    Is,
    /// A part: these pixels of the patch are the mark.
    Grown(PixelSet),
    /// A part of a mark for which a larger region stands.
    Beaten,
    /// What it is a part of does not end inside the patch.
    Endless,
}

/// Grows the region of a scene. `plateau` is its paint's colour.
pub(super) fn whole(scene: &Scene<'_>, plateau: Vector3<f64>) -> Whole {
    let before = scene.own.count();
    let mut own = scene.own.clone();
    let Some(start) = own.first().map(|first| own.piece(first)).filter(|_| !own.at_edge()) else { return Whole::Is };
    let mut grew = false;
    for _ in 0..ROUNDS {
        let Some(ground) = ground_around(scene, &own) else { return Whole::Is };
        let noise = ground.covariance + Matrix3::identity() * 9.0;
        let Some(inverse) = noise.cholesky().map(|c| c.inverse()) else { return Whole::Is };
        let step = plateau - ground.mean;
        let direction = inverse * step;
        let contrast2 = direction.dot(&step);
        // Nothing to be told from the ground.
        if contrast2 < 9.0 {
            return Whole::Is;
        }
        let (direction, origin) = (direction / contrast2, direction.dot(&ground.mean) / contrast2);
        let like = |i: usize| {
            // Across the direction too it must be nearer to the paint: a white line beside a mark is brighter than
            // both.
            let colour = scene.colour(i);
            scene.own.has(i)
                || scene.one_along(i, direction, origin) > 0.5
                    && (colour - plateau).norm_squared() < (colour - ground.mean).norm_squared()
        };
        let runs_away = |set: &PixelSet| set.count() as f64 > 1.5 * before as f64;
        let mut open = false;
        let ends = |front: &PixelSet, all: &PixelSet| {
            open |= front.at_edge();
            !(open && (grew || runs_away(all)))
        };
        let Some(next) = start.spread(&scene.valid, like, ends) else { return Whole::Endless };
        let next = next.or(&scene.own);
        if open {
            return if grew || runs_away(&next) { Whole::Endless } else { Whole::Is };
        }
        let done = next == own;
        own = next;
        grew = true;
        if done {
            break;
        }
    }
    if (own.count() as f64) < before as f64 * (1.0 + LEAST_GROWTH) {
        return Whole::Is;
    }
    let mut left = scene.other.and(&own);
    while let Some(first) = left.first() {
        let piece = scene.other.piece(first);
        left = left.minus(&piece);
        let other = piece.count();
        if other > before || other == before && Some(first) < scene.own.first() {
            return Whole::Beaten;
        }
    }
    Whole::Grown(own)
}

/// Ground in the ring around a set, clear of paint that is not connected to it.
fn ground_around(scene: &Scene<'_>, own: &PixelSet) -> Option<Ground> {
    let near = own.grown(RING_PX.0 - 1);
    let ring = near.grown(RING_PX.1 + 1 - RING_PX.0).minus(&near).and(&scene.valid);
    let clear = ring.minus(&scene.other.minus(own).grown(2));
    scene.statistics(&clear).or_else(|| scene.statistics(&ring))
}

/// What the sides of a fitted outline that no edge supports leave open of its centre, px² (xx, xy, yy): where the
/// picture shows no step from paint to ground across a side, or holds nothing there, the mark may go on, or end before.
/// The second answer is how many of four sides those are.
pub(super) fn unsupported(scene: &Scene<'_>, shares: &[f64], fit: &Fit) -> ([f64; 3], f64) {
    /// Steps of less than this share of the paint's contrast are doubtful.
    const STEP: f64 = 0.6;
    let side = (fit.sides_px[0] * fit.sides_px[1]).sqrt();
    let beyond = 1.0 + 1.5 * fit.blur_px;
    let reach = beyond + 2.0;
    let (sin, cos) = fit.angle_rad.sin_cos();
    let turns = if fit.form == Form::Disc { 8 } else { 4 };
    let mut sums = vec![[0.0f64; 4]; turns];
    // Beyond these sides nodata hides the ground.
    let mut void = vec![false; turns];
    let hidden = scene.beside_other().minus(&scene.own);
    (0..scene.width * scene.height).for_each(|i| {
        let (x, y) = ((i % scene.width) as f64 + 0.5 - fit.x, (i / scene.width) as f64 + 0.5 - fit.y);
        let (u, v) = (x * cos + y * sin, y * cos - x * sin);
        // How far outside the outline, and of which side.
        let (out, k) = if fit.form == Form::Disc {
            let eighth = (v.atan2(u) / std::f64::consts::FRAC_PI_4).round().rem_euclid(8.0);
            (u.hypot(v) - fit.sides_px[0] / 2.0, eighth as usize)
        } else {
            let (a, b) = (u.abs() - fit.sides_px[0] / 2.0, v.abs() - fit.sides_px[1] / 2.0);
            // Beside a corner is beside no side.
            if a.min(b) > -0.5 {
                return;
            }
            if a > b { (a, if u > 0.0 { 0 } else { 2 }) } else { (b, if v > 0.0 { 1 } else { 3 }) }
        };
        let (inner, outer) = ((-2.0 - beyond..=-0.5).contains(&out), (beyond..=reach).contains(&out));
        if !scene.valid.has(i) {
            void[k] |= outer;
        } else if !hidden.has(i) && (inner || outer) {
            let at = usize::from(outer) * 2;
            sums[k][at] += shares[i];
            sums[k][at + 1] += 1.0;
        }
    });
    let (mut open, mut sides) = ([0.0; 3], 0.0);
    for (k, [inside, n, outside, m]) in sums.into_iter().enumerate() {
        if n < 1.0 || (m < 1.0 && !void[k]) {
            continue;
        }
        let step = if m < 1.0 { 0.0 } else { inside / n - outside / m };
        let missing = ((STEP - step) / STEP).clamp(0.0, 1.0);
        if missing == 0.0 {
            continue;
        }
        sides += missing * 4.0 / turns as f64;
        let angle = fit.angle_rad + k as f64 * std::f64::consts::TAU / turns as f64;
        let variance = (0.25 * side * missing).powi(2);
        let (s, c) = angle.sin_cos();
        open[0] += variance * c * c;
        open[1] += variance * c * s;
        open[2] += variance * s * s;
    }
    (open, sides)
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{SIDE, inside, patch};
    use super::*;
    use autoref_raster::Patch;

    #[test]
    fn a_part_grows_to_the_edge_that_the_picture_shows() {
        let patch = patch(|_, _| 1.0);
        let part = inside(18..24, 18..30);
        let scene = Scene::of_pixels(&patch, part.clone(), &part);
        let Whole::Grown(own) = whole(&scene, Vector3::new(250.0, 100.0, 10.0)) else { panic!("it is half a mark") };
        assert_eq!(own, inside(18..30, 18..30));
        let all = inside(18..30, 18..30);
        let scene = Scene::of_pixels(&patch, all.clone(), &all);
        assert!(matches!(whole(&scene, Vector3::new(250.0, 100.0, 10.0)), Whole::Is));
    }

    #[test]
    fn a_side_beyond_which_there_is_nothing_is_open() {
        let own = inside(18..30, 18..30);
        let shares: Vec<f64> = (0..SIDE * SIDE).map(|i| if own.has(i) { 1.0 } else { 0.0 }).collect();
        let fit = Fit {
            form: Form::Rectangle,
            x: 24.0,
            y: 24.0,
            sides_px: [12.0; 2],
            angle_rad: 0.0,
            blur_px: 0.5,
            height: 1.0,
            scatter_px2: [0.01, 0.0, 0.01],
            chi2: 1.0,
            rms: 0.0,
            rms_inside: 0.0,
            hidden: 0.0,
            edge_sd: 0.0,
        };
        let mut patch = patch(|_, _| 1.0);
        let seen = |patch: &Patch| unsupported(&Scene::of_pixels(patch, own.clone(), &own), &shares, &fit);
        assert_eq!(seen(&patch), ([0.0; 3], 0.0));
        // Nodata right of the mark: it may go on there.
        (0..SIDE * SIDE).filter(|i| i % SIDE >= 30).for_each(|i| patch.valid[i] = false);
        let (open, sides) = seen(&patch);
        assert!((sides - 1.0).abs() < 1e-9 && open[0] > 8.0 && open[2] < 1e-9, "{open:?}, {sides}");
    }

    #[test]
    fn a_smaller_part_gives_way_to_a_larger() {
        let patch = patch(|_, _| 1.0);
        let (small, large) = (inside(18..21, 18..30), inside(23..30, 18..30));
        let scene = Scene::of_pixels(&patch, small.clone(), &small.or(&large));
        assert!(matches!(whole(&scene, Vector3::new(250.0, 100.0, 10.0)), Whole::Beaten));
    }
}
