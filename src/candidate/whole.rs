//! The whole mark: before a centre is believed, what colour found is grown to the edge that the picture shows.
//!
//! The colour test only says where to look. Where a part of a mark lies beyond its limit, the part has a centre of its own, and a
//! fit to it knows nothing of the rest. So the pixels connected to the region that look more like its paint than like the ground
//! beside it are its mark too; the ground is measured again around what has grown until nothing changes. A mark that the border
//! of a shadow crosses is lit evenly first ([`relit`]).

use nalgebra::{Matrix3, Vector3};

use super::fit::{Fit, Form};
use super::patch::{Ground, Scene};
use super::pixel_set::PixelSet;
use autoref_raster::Patch;

/// Rounds of growing; the ground changes little after the second.
const ROUNDS: usize = 3;
/// A region that grows by less than this share is whole.
const LEAST_GROWTH: f64 = 0.12;
/// The ring of ground around what has grown starts and ends so far outside.
const RING_PX: (usize, usize) = (4, 9);

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
    if at_edge(&own, scene) {
        return Whole::Is;
    }
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
        let shares = scene.along(direction / contrast2, direction.dot(&ground.mean) / contrast2);
        let like = |i: usize| {
            // Across the direction too it must be nearer to the paint: a white line beside a mark is brighter than both.
            let colour = scene.colour(i);
            shares[i] > 0.5 && (colour - plateau).norm_squared() < (colour - ground.mean).norm_squared()
        };
        let connected = scene.own.or(&PixelSet::from_fn(scene.width, scene.height, like)).and(&scene.valid);
        let Some(start) = scene.own.first() else { return Whole::Is };
        let next = connected.piece(start).or(&scene.own);
        if at_edge(&next, scene) {
            return if grew { Whole::Endless } else { runs_away(&next, before) };
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

fn runs_away(next: &PixelSet, before: usize) -> Whole {
    if next.count() as f64 > 1.5 * before as f64 { Whole::Endless } else { Whole::Is }
}

fn at_edge(set: &PixelSet, scene: &Scene<'_>) -> bool {
    let (width, height) = (scene.width, scene.height);
    set.iter().any(|i| i % width == 0 || i % width + 1 == width || i < width || i / width + 1 == height)
}

/// Ground in the ring around a set, clear of paint that is not connected to it.
fn ground_around(scene: &Scene<'_>, own: &PixelSet) -> Option<Ground> {
    let near = own.grown(RING_PX.0 - 1);
    let ring = near.grown(RING_PX.1 + 1 - RING_PX.0).minus(&near).and(&scene.valid);
    let clear = ring.minus(&scene.other.minus(own).grown(2));
    scene.statistics(&clear).or_else(|| scene.statistics(&ring))
}

/// What the sides of a fitted outline that no edge supports leave open of its centre, px² (xx, xy, yy): where the picture shows no
/// step from paint to ground across a side, the mark may go on there, or end before.
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
    let hidden = scene.beside_other().minus(&scene.own);
    scene.valid.minus(&hidden).for_each(|i| {
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
        if inner || outer {
            let at = usize::from(outer) * 2;
            sums[k][at] += shares[i];
            sums[k][at + 1] += 1.0;
        }
    });
    let (mut open, mut sides) = ([0.0; 3], 0.0);
    for (k, [inside, n, outside, m]) in sums.into_iter().enumerate() {
        if n < 1.0 || m < 1.0 {
            continue;
        }
        let step = inside / n - outside / m;
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

/// The patch with even light, where the border of a shadow crosses the region: the paint has two brightnesses, parted by a line. The
/// line, its width and the ratio of the two lights, band by band, follow from the paint alone; everything beyond the line is
/// divided by the ratio. `None` where the light is even already.
pub(super) fn relit(scene: &Scene<'_>) -> Option<Patch> {
    /// Lights that differ by less are one.
    const LEAST_RATIO: f64 = 1.25;
    /// Least share of the region on either side.
    const LEAST_SHARE: f64 = 0.08;
    // Pixels that the border is mixed into have a brightness of their own.
    let core = [2, 1].into_iter().map(|depth_px| scene.own.shrunk(depth_px)).find(|core| core.count() >= 20)?;
    let mut seen: Vec<Seen> = Vec::with_capacity(core.count());
    core.for_each(|i| {
        let colour = scene.colour(i);
        seen.push(((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5, colour.sum() / 3.0, colour));
    });
    let mut sorted: Vec<f64> = seen.iter().map(|s| s.2).collect();
    sorted.sort_by(f64::total_cmp);
    let at = |q: f64| sorted[((sorted.len() - 1) as f64 * q).round() as usize];
    if at(0.92) < LEAST_RATIO * at(0.08).max(1.0) {
        return None;
    }
    let line = Line::through(&seen)?;
    let (lit, dark): (Vec<Seen>, Vec<Seen>) =
        seen.iter().copied().filter(|s| line.out(s.0, s.1).abs() > 1.0).partition(|s| line.out(s.0, s.1) > 0.0);
    let least = (LEAST_SHARE * seen.len() as f64).max(3.0) as usize;
    if lit.len() < least || dark.len() < least {
        return None;
    }
    let middle = |side: &[Seen], c: usize| super::patch::median(side.iter().map(|s| s.3[c]).collect());
    let pairs: [(f64, f64); 3] = std::array::from_fn(|c| (middle(&lit, c), middle(&dark, c)));
    let all = (pairs.iter().map(|p| p.1).sum::<f64>() / pairs.iter().map(|p| p.0).sum::<f64>()).clamp(0.05, 1.0);
    if all > 1.0 / LEAST_RATIO {
        return None;
    }
    // A band that the paint hardly has tells nothing of the light in it.
    let ratio = pairs.map(|(lit, dark)| if lit > 60.0 { (dark / lit).clamp(0.7 * all, 1.4 * all) } else { all });
    // Even light must explain most of what differs: a mark of two paints is not made one.
    if line.left_over > 0.35 {
        return None;
    }
    let mut patch = scene.patch.clone();
    let white = f64::from(patch.white);
    for (i, rgb) in patch.rgb.iter_mut().enumerate() {
        let light = line.light((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
        for c in 0..3 {
            let lit = f64::from(rgb[c]) / (ratio[c] + (1.0 - ratio[c]) * light);
            rgb[c] = lit.round().min(white) as u16;
        }
    }
    Some(patch)
}

/// A pixel's middle, x and y, its brightness and colour.
type Seen = (f64, f64, f64, Vector3<f64>);

/// The border of a shadow.
struct Line {
    /// Towards the light.
    direction: (f64, f64),
    offset: f64,
    width: f64,
    /// Share of the brightness's variance that the line does not explain.
    left_over: f64,
}

impl Line {
    /// Light from 0 in the shadow to 1.
    fn light(&self, x: f64, y: f64) -> f64 {
        ramp(self.out(x, y) / self.width)
    }

    fn out(&self, x: f64, y: f64) -> f64 {
        x * self.direction.0 + y * self.direction.1 - self.offset
    }

    /// The line that explains the brightnesses best: every direction and width is tried, then the best made finer.
    fn through(seen: &[Seen]) -> Option<Line> {
        let n = seen.len() as f64;
        let (cx, cy) = (seen.iter().map(|s| s.0).sum::<f64>() / n, seen.iter().map(|s| s.1).sum::<f64>() / n);
        let mean = seen.iter().map(|s| s.2).sum::<f64>() / n;
        let total: f64 = seen.iter().map(|s| (s.2 - mean).powi(2)).sum();
        let reach = seen.iter().map(|s| (s.0 - cx).hypot(s.1 - cy)).fold(0.0, f64::max);
        let try_one = |angle: f64, off: f64, width: f64| {
            let (sin, cos) = angle.sin_cos();
            // Brightness is linear in the light: the best pair of lights is a regression.
            let (mut s1, mut s2, mut sb) = (0.0, 0.0, 0.0);
            for s in seen {
                let l = ramp(((s.0 - cx) * cos + (s.1 - cy) * sin - off) / width);
                s1 += l;
                s2 += l * l;
                sb += l * (s.2 - mean);
            }
            let var = s2 - s1 * s1 / n;
            // The light lies on the bright side.
            if var > 1e-6 && sb > 0.0 { total - sb * sb / var } else { total }
        };
        let mut best: (f64, f64, f64, f64) = (f64::INFINITY, 0.0, 0.0, 1.2);
        let steps = (reach * 2.0).ceil() as i32;
        for k in 0..32 {
            let angle = f64::from(k) * std::f64::consts::TAU / 32.0;
            for j in -steps..=steps {
                let off = f64::from(j) * 0.5;
                let cost = try_one(angle, off, 1.2);
                if cost < best.0 {
                    best = (cost, angle, off, 1.2);
                }
            }
        }
        let (mut turn, mut slide, mut stretch) = (0.1f64, 0.25f64, 1.4f64);
        for _ in 0..24 {
            let (_, a, o, w) = best;
            let mut better = false;
            let tries = [(a + turn, o, w), (a - turn, o, w), (a, o + slide, w), (a, o - slide, w)];
            for (a, o, w) in tries.into_iter().chain([(a, o, (w * stretch).min(6.0)), (a, o, (w / stretch).max(0.4))]) {
                let cost = try_one(a, o, w);
                if cost < best.0 {
                    best = (cost, a, o, w);
                    better = true;
                }
            }
            if !better {
                (turn, slide, stretch) = (turn / 2.0, slide / 2.0, f64::sqrt(stretch));
            }
        }
        let (cost, angle, off, width) = best;
        let (sin, cos) = angle.sin_cos();
        (total > 0.0).then(|| Line {
            direction: (cos, sin),
            offset: off + cx * cos + cy * sin,
            width,
            left_over: cost / total,
        })
    }
}

/// From 0 to 1 about 0, as a blurred edge.
fn ramp(v: f64) -> f64 {
    if v < -4.0 {
        return 0.0;
    }
    if v > 4.0 {
        return 1.0;
    }
    // The logistic function that lies nearest to the normal distribution's.
    1.0 / (1.0 + (-1.702 * v).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::window::Window;

    const SIDE: u64 = 48;

    /// A square of paint of 12 px about the middle on grey ground, each pixel through `light`.
    fn patch(light: impl Fn(f64, f64) -> f64) -> Patch {
        let at = |i: u64| ((i % SIDE) as f64 + 0.5, (i / SIDE) as f64 + 0.5);
        let rgb = (0..SIDE * SIDE)
            .map(|i| {
                let (x, y) = at(i);
                let paint = (x - 24.0).abs() < 6.0 && (y - 24.0).abs() < 6.0;
                let grain = ((i * 7919) % 5) as f64 - 2.0;
                let colour = if paint { [250.0, 100.0, 10.0] } else { [110.0 + grain, 105.0 - grain, 95.0 + grain] };
                colour.map(|v| (v * light(x, y)).round() as u16)
            })
            .collect();
        Patch { window: Window::new(0, 0, SIDE, SIDE), rgb, valid: vec![true; (SIDE * SIDE) as usize], white: 255 }
    }

    fn inside(x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> PixelSet {
        let side = SIDE as usize;
        PixelSet::from_fn(side, side, |i| x.contains(&(i % side)) && y.contains(&(i / side)))
    }

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
    fn a_smaller_part_gives_way_to_a_larger() {
        let patch = patch(|_, _| 1.0);
        let (small, large) = (inside(18..21, 18..30), inside(23..30, 18..30));
        let scene = Scene::of_pixels(&patch, small.clone(), &small.or(&large));
        assert!(matches!(whole(&scene, Vector3::new(250.0, 100.0, 10.0)), Whole::Beaten));
    }

    #[test]
    fn half_a_shadow_is_taken_out_and_even_light_is_left_alone() {
        let shaded = patch(|x, y| if x + 0.3 * y > 31.0 { 0.4 } else { 1.0 });
        let own = inside(18..30, 18..30);
        let scene = Scene::of_pixels(&shaded, own.clone(), &own);
        let even = relit(&scene).expect("two brightnesses");
        // Away from the shadow's border all paint has one colour again.
        for i in own.iter().filter(|i| ((i % 48) as f64 + 0.3 * (i / 48) as f64 - 30.4).abs() > 2.5) {
            assert!(even.rgb[i][0].abs_diff(250) < 14, "{i}: {:?}", even.rgb[i]);
        }
        let lit = patch(|_, _| 1.0);
        assert!(relit(&Scene::of_pixels(&lit, own.clone(), &own)).is_none());
    }
}
