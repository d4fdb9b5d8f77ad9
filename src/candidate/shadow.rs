//! The border of a shadow that crosses a mark: where it lies, how much darker it is beyond, and the patch with even
//! light.

use std::cell::OnceCell;

use nalgebra::Vector3;

use super::kernels::exp_of_negative;
use super::pixel_set::PixelSet;
use super::scene::{Ground, RING_PX, Scene};
use super::whole::LEAST_GROWTH;
use autoref_raster::Patch;

/// The patch with even light, where the border of a shadow crosses the region: the paint has two brightnesses, parted
/// by a line. The line and its width follow from paint and ground together, the ratio of the two lights, band by band,
/// from the paint alone; everything beyond the line is divided by the ratio. `None` where the light is even already.
pub(super) fn relit(scene: &Scene<'_>) -> Option<Relit> {
    /// Lights that differ by less are one.
    const LEAST_RATIO: f64 = 1.25;
    /// Least share of the region on either side.
    const LEAST_SHARE: f64 = 0.05;
    /// Even light must explain nearly all of what differs: of marks in two lights it leaves up to a tenth, of worn,
    /// mixed or even ones over a quarter.
    const MOST_LEFT_OVER: f64 = 0.18;
    // The outermost pixels are mixed with ground. A part in shadow may be no deeper than three pixels.
    let core = Some(scene.own.shrunk(1)).filter(|core| core.count() >= 20)?;
    let mut seen: Vec<Seen> = Vec::with_capacity(core.count());
    core.for_each(|i| {
        let colour = scene.colour(i);
        seen.push(((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5, colour.sum() / 3.0, colour));
    });
    if !differ(&seen, LEAST_RATIO, LEAST_SHARE) {
        return None;
    }
    // No line explains the paint better than this one.
    let first = Line::through(&seen, Grid::FINE).filter(|first| first.left_over(&seen) <= MOST_LEFT_OVER)?;
    let paint = first.lights_of(&seen)?.1;
    // The border runs on over the ground: there is more of it than of the paint, and it is seen on both sides of the
    // mark.
    let line = lit_ground(scene, &first, 2.0)
        .and_then(|ground| Line::through(&lights(scene, paint, ground.mean), Grid::COARSE));
    // The paint alone is asked whether that is its border too.
    let own = |line: &Line| line.left_over(&seen) <= MOST_LEFT_OVER && line.parts(&seen) >= LEAST_SHARE;
    let line = line.into_iter().chain([first]).find(own)?;
    let (dark, lit) = line.lights_of(&seen)?;
    let all = (dark.sum() / lit.sum()).clamp(0.05, 1.0);
    if all > 1.0 / LEAST_RATIO {
        return None;
    }
    // A band that the paint hardly has tells nothing of the light in it.
    let of_band = |c: usize| if lit[c] > 60.0 { (dark[c] / lit[c]).clamp(0.7 * all, 1.4 * all) } else { all };
    let ratio: [f64; 3] = std::array::from_fn(of_band);
    let mut patch = scene.patch.clone();
    let white = f64::from(patch.white);
    for (i, rgb) in patch.rgb.iter_mut().enumerate() {
        let light = line.light((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
        for c in 0..3 {
            let lit = f64::from(rgb[c]) / (ratio[c] + (1.0 - ratio[c]) * light);
            rgb[c] = lit.round().min(white) as u16;
        }
    }
    Some(Relit { even: patch, border: line, ratio })
}

/// The pixels of a mark with those connected to them that are its paint in a shadow: of which, whatever the light on
/// them, paint makes up more than ground. `None` where there are none, or no end of them.
pub(super) fn grown_into_shade(scene: &Scene<'_>, paint: Vector3<f64>) -> Option<PixelSet> {
    /// A mark is at most so many times the part that was found of it.
    const MOST_GROWTH: usize = 4;
    /// Darker paint than this cannot be told from what is black.
    const LEAST_LIGHT: f64 = 0.2;
    /// Squared sine of the angle between two colours, below which one is the other in a weaker light: white and grey.
    const LEAST_APART: f64 = 0.03;
    let ground = scene.statistics(&scene.ring(RING_PX))?.mean;
    if 1.0 - paint.dot(&ground).powi(2) / (paint.norm_squared() * ground.norm_squared()) < LEAST_APART {
        return None;
    }
    let like = |i: usize| {
        let (of_paint, of_ground) = mixture(scene.colour(i), paint, ground);
        of_paint > of_ground && (LEAST_LIGHT..1.2).contains(&(of_paint + of_ground))
    };
    let before = scene.own.count();
    // Most have no pixel beside them that is like them.
    let reach = OnceCell::new();
    let near = |i| reach.get_or_init(|| scene.own.grown((2.0 * (before as f64).sqrt()).ceil() as usize)).has(i);
    let start = scene.own.piece(scene.own.first().filter(|_| !scene.own.at_edge())?);
    let within = scene.own.or(&scene.valid);
    let grown = start.spread(
        &within,
        |i| scene.own.has(i) || like(i) && near(i),
        |front, all| all.count() <= MOST_GROWTH * before && !front.at_edge(),
    )?;
    let grown = grown.or(&scene.own);
    let after = grown.count();
    (after <= MOST_GROWTH * before && after as f64 > before as f64 * (1.0 + LEAST_GROWTH)).then_some(grown)
}

/// How much of two colours it takes to make a third: not below 0 each, by least squares.
fn mixture(colour: Vector3<f64>, paint: Vector3<f64>, ground: Vector3<f64>) -> (f64, f64) {
    let (pp, pg, gg) = (paint.dot(&paint), paint.dot(&ground), ground.dot(&ground));
    let det = pp * gg - pg * pg;
    let (p, g) = (colour.dot(&paint), colour.dot(&ground));
    let (of_paint, of_ground) = ((gg * p - pg * g) / det, (pp * g - pg * p) / det);
    match (of_paint > 0.0, of_ground > 0.0) {
        (true, true) => (of_paint, of_ground),
        (true, false) => (p / pp, 0.0),
        _ => (0.0, g / gg),
    }
}

/// A mark in two lights.
pub(super) struct Relit {
    /// The patch, with the darker part divided by the ratio of the lights.
    pub even: Patch,
    pub border: Line,
    /// Of the light in the shadow to that beside it, band by band.
    pub ratio: [f64; 3],
}

/// A pixel's middle, x and y, its brightness and colour.
type Seen = (f64, f64, f64, Vector3<f64>);

/// The border of a shadow.
pub(super) struct Line {
    /// Towards the light.
    pub direction: (f64, f64),
    pub offset: f64,
    pub width: f64,
}

impl Line {
    /// Light from 0 in the shadow to 1.
    fn light(&self, x: f64, y: f64) -> f64 {
        ramp(self.out(x, y) / self.width)
    }

    fn out(&self, x: f64, y: f64) -> f64 {
        x * self.direction.0 + y * self.direction.1 - self.offset
    }

    /// Share of the brightness's variance that the line does not explain, the best pair of lights being a regression.
    fn left_over(&self, seen: &[Seen]) -> f64 {
        let lights = seen.iter().map(|s| (self.light(s.0, s.1), s.2));
        let (left, total) = unexplained(lights);
        if total > 0.0 { left / total } else { 1.0 }
    }

    /// Colours of the paint in the shadow and in the light: a regression on the light, so that few pixels of a side are
    /// enough.
    fn lights_of(&self, seen: &[Seen]) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        let (mut of_dark, mut of_lit) = (Vector3::<f64>::zeros(), Vector3::<f64>::zeros());
        for (x, y, _, colour) in seen {
            let lit = self.light(*x, *y);
            let dark = 1.0 - lit;
            (aa, ab, bb) = (aa + dark * dark, ab + dark * lit, bb + lit * lit);
            of_dark += colour * dark;
            of_lit += colour * lit;
        }
        let det = aa * bb - ab * ab;
        let at = |v: Vector3<f64>| v.map(|v| v.max(0.0));
        (det > 1e-6 * (aa + bb).powi(2) && aa > 0.5 && bb > 0.5)
            .then(|| (at((of_dark * bb - of_lit * ab) / det), at((of_lit * aa - of_dark * ab) / det)))
    }

    /// The smaller share of the pixels on either side.
    fn parts(&self, seen: &[Seen]) -> f64 {
        let lit = seen.iter().filter(|s| self.out(s.0, s.1) > 0.0).count() as f64 / seen.len() as f64;
        lit.min(1.0 - lit)
    }

    /// The line that explains the brightnesses best: every direction is tried and every place near the middle, with a
    /// sharp border, then the best made finer. `None` where the best sharp border leaves more unexplained than the grid
    /// allows.
    fn through(seen: &[Seen], grid: Grid) -> Option<Line> {
        let n = seen.len() as f64;
        let (cx, cy) = (seen.iter().map(|s| s.0).sum::<f64>() / n, seen.iter().map(|s| s.1).sum::<f64>() / n);
        /// So many pixels tell a line.
        const ENOUGH: usize = 700;
        let each = seen.len().div_ceil(ENOUGH).max(1);
        let about: Vec<[f64; 3]> = seen.iter().step_by(each).map(|s| [s.0 - cx, s.1 - cy, s.2]).collect();
        let (angle, off, total) = sharp_border(&about, grid)?;
        let cost = |angle: f64, off: f64, width: f64| {
            let (sin, cos) = angle.sin_cos();
            unexplained(about.iter().map(|[x, y, b]| (ramp((x * cos + y * sin - off) / width), *b))).0
        };
        let mut best = [0.6, 1.2, 2.4].map(|width| (cost(angle, off, width), angle, off, width));
        best.sort_by(|a, b| a.0.total_cmp(&b.0));
        let [mut best, ..] = best;
        if best.0 > grid.most_left_over * total {
            return None;
        }
        let (mut turn, mut slide, mut stretch) = (0.1f64, 0.25f64, 1.4f64);
        // The fit of mark and lights together makes it finer still.
        while slide > 0.03 {
            let (_, a, o, w) = best;
            let mut better = false;
            let tries = [(a + turn, o, w), (a - turn, o, w), (a, o + slide, w), (a, o - slide, w)];
            for (a, o, w) in tries.into_iter().chain([(a, o, (w * stretch).min(6.0)), (a, o, (w / stretch).max(0.4))]) {
                let cost = cost(a, o, w);
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
        cost.is_finite().then_some(Line { direction: (cos, sin), offset: off + cx * cos + cy * sin, width })
    }
}

/// Angle and offset of the sharp border that leaves least of the brightnesses unexplained, of pixels about their
/// middle, and the sum of squares of all brightnesses about their mean. One histogram of brightness an angle holds the
/// sums on both sides of all offsets. `None` where every border leaves more than the grid allows.
fn sharp_border(about: &[[f64; 3]], grid: Grid) -> Option<(f64, f64, f64)> {
    let n = about.len() as f64;
    let far = about.iter().map(|[x, y, _]| x.hypot(*y)).fold(0.0, f64::max);
    let reach = far * grid.reach;
    let all = about.iter().map(|p| p[2]).sum::<f64>();
    let total = about.iter().map(|p| p[2] * p[2]).sum::<f64>() - all * all / n;
    let steps = (far / grid.step_px).ceil();
    let mut best = ((1.0 - grid.most_left_over) * total, None);
    let mut bins = vec![[0.0f64; 2]; 2 * steps as usize + 2];
    // Half a turn: which side is lit, the sums tell.
    for k in 0..grid.angles / 2 {
        let angle = f64::from(k) * std::f64::consts::TAU / f64::from(grid.angles);
        let (sin, cos) = angle.sin_cos();
        bins.fill([0.0; 2]);
        for [x, y, b] in about {
            let bin = &mut bins[((x * cos + y * sin) / grid.step_px + steps).max(0.0) as usize];
            bin[0] += 1.0;
            bin[1] += b;
        }
        let (mut below, mut sum) = (0.0, 0.0);
        for (i, bin) in bins.iter().enumerate() {
            below += bin[0];
            sum += bin[1];
            let off = (i as f64 + 1.0 - steps) * grid.step_px;
            if off.abs() > reach || below == 0.0 || below == n {
                continue;
            }
            let step = (all - sum) / (n - below) - sum / below;
            let explained = step * step * below * (n - below) / n;
            if explained > best.0 {
                let lit_above = (angle, off, total);
                let lit_below = (angle + std::f64::consts::PI, -off, total);
                best = (explained, Some(if step > 0.0 { lit_above } else { lit_below }));
            }
        }
    }
    best.1
}

/// Which lines are tried first.
#[derive(Clone, Copy)]
struct Grid {
    angles: u32,
    step_px: f64,
    /// Share of the pixels' own reach that the line may lie off their middle.
    reach: f64,
    /// Share of the brightness's variance that the best sharp border may leave unexplained.
    most_left_over: f64,
}

impl Grid {
    const FINE: Grid = Grid { angles: 32, step_px: 0.5, reach: 1.0, most_left_over: 0.4 };
    /// For many pixels about the mark, through which the line goes.
    const COARSE: Grid = Grid { angles: 16, step_px: 1.0, reach: 0.4, most_left_over: 1.0 };
}

/// Sum of squares of what a line in the first does not explain of the second, and all of it. The light lies on the
/// bright side.
fn unexplained(pairs: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let (mut n, mut s1, mut s2, mut b1, mut b2, mut sb) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (l, b) in pairs {
        n += 1.0;
        s1 += l;
        s2 += l * l;
        b1 += b;
        b2 += b * b;
        sb += l * b;
    }
    let (total, var, both) = (b2 - b1 * b1 / n, s2 - s1 * s1 / n, sb - s1 * b1 / n);
    (if var > 1e-6 && both > 0.0 { (total - both * both / var).max(0.0) } else { total }, total)
}

/// Whether so small a share of the pixels in a light weaker by this ratio could make brightnesses differ so much.
fn differ(seen: &[Seen], ratio: f64, share: f64) -> bool {
    let n = seen.len() as f64;
    let mean = seen.iter().map(|s| s.2).sum::<f64>() / n;
    let variance = seen.iter().map(|s| (s.2 - mean).powi(2)).sum::<f64>() / n;
    let least = (1.0 - 1.0 / ratio).powi(2) * share * (1.0 - share) * mean * mean;
    variance >= least
}

/// The ground in the light so far from the border, in the ring around the mark.
pub(super) fn lit_ground(scene: &Scene<'_>, line: &Line, clear_px: f64) -> Option<Ground> {
    let ring = scene.ring(RING_PX);
    let out = |i: usize| line.out((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5);
    scene.statistics(&PixelSet::from_fn(scene.width, scene.height, |i| ring.has(i) && out(i) > clear_px))
}

/// The light on each pixel about the mark, which is 1 where the two colours were seen: what it takes of both of them to
/// make the pixel's colour (non-negative least squares).
fn lights(scene: &Scene<'_>, paint: Vector3<f64>, ground: Vector3<f64>) -> Vec<Seen> {
    let hidden = scene.beside_other().minus(&scene.own);
    let mut seen = Vec::new();
    scene.own.grown(RING_PX.1).and(&scene.valid).minus(&hidden).for_each(|i| {
        let colour = scene.colour(i);
        let (of_paint, of_ground) = mixture(colour, paint, ground);
        let light = of_paint + of_ground;
        if light.is_finite() {
            seen.push(((i % scene.width) as f64 + 0.5, (i / scene.width) as f64 + 0.5, light.min(2.0), colour));
        }
    });
    seen
}

/// From 0 to 1 about 0, as a blurred edge: the logistic function that lies nearest to the normal distribution's.
#[inline]
pub(super) fn ramp(v: f64) -> f64 {
    let e = exp_of_negative(-1.702 * v.abs());
    (if v < 0.0 { e } else { 1.0 }) / (1.0 + e)
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{inside, patch};
    use super::*;

    #[test]
    fn half_a_shadow_is_taken_out_and_even_light_is_left_alone() {
        let shaded = patch(|x, y| if x + 0.3 * y > 31.0 { 0.4 } else { 1.0 });
        let own = inside(18..30, 18..30);
        let scene = Scene::of_pixels(&shaded, own.clone(), &own);
        let even = relit(&scene).expect("two brightnesses").even;
        // Away from the shadow's border all paint has one colour again.
        for i in own.iter().filter(|i| ((i % 48) as f64 + 0.3 * (i / 48) as f64 - 30.4).abs() > 2.5) {
            assert!(even.rgb[i][0].abs_diff(250) < 14, "{i}: {:?}", even.rgb[i]);
        }
        let lit = patch(|_, _| 1.0);
        assert!(relit(&Scene::of_pixels(&lit, own.clone(), &own)).is_none());
    }
}
