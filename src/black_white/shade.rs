//! Light that does not fall evenly on a target: the border of a shadow across it, and light that falls off.
//!
//! A saddle's or cross's share `v` of bright is known from the fit in even light, which is off by little or by much. On
//! either side of a border the grey levels are another straight line of `v`. The border is sought over all directions
//! and places (a split of one regression into two: R. E. Quandt, "The estimation of the parameters of a linear
//! regression system obeying two separate regimes", 1958); then levels in the shade are mapped to those in the light.

use super::kernels::Sample;
use crate::candidate::kernels::normal;
use autoref_raster::Patch;

/// Directions in which a border is sought, over half a turn, and places along each.
const DIRECTIONS: usize = 24;
const PLACES: usize = 32;
/// A split leaves over at most this share of what one line leaves.
const FAR_BETTER: f64 = 0.35;
/// Of the cells at least this share lies on either side.
const LEAST_SHARE: f64 = 0.08;
/// What the light is in the shade over that beside it, of bright and of dark (which haze and flare brighten).
const RATIO: std::ops::Range<f64> = 0.08..0.9;
const DARK_RATIO: std::ops::Range<f64> = 0.05..1.15;
/// How far the ratio of the contrasts may be from that of the bright, logarithm: one light falls on both.
const MOST_UNEVEN: f64 = 0.3;

/// Grey level where nothing is bright, and how much brighter the bright is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    pub ground: f64,
    pub height: f64,
}

/// A straight border between light and shade, in the unit of the samples (cells, or pixels of the image).
#[derive(Clone, Copy, Debug)]
pub struct Shade {
    /// Direction towards the shade, radians.
    pub direction: f64,
    /// A place on the border.
    pub x: f64,
    pub y: f64,
    /// Standard deviation of the border's blur.
    pub soft: f64,
    pub lit: Levels,
    pub shaded: Levels,
}

impl Shade {
    /// Share of shade at a place, 0 to 1.
    pub fn share(&self, x: f64, y: f64) -> f64 {
        let (sin, cos) = self.direction.sin_cos();
        normal(((x - self.x) * cos + (y - self.y) * sin) / self.soft).1
    }

    /// What a level would be in the light.
    fn in_light(&self, x: f64, y: f64, level: f64) -> f64 {
        let share = self.share(x, y);
        let ground = self.lit.ground + share * (self.shaded.ground - self.lit.ground);
        let height = self.lit.height + share * (self.shaded.height - self.lit.height);
        (self.lit.ground + self.lit.height * (level - ground) / height).clamp(0.0, 255.0)
    }

    /// The samples as they would be in the light.
    pub fn evened(&self, samples: &[Sample]) -> Vec<Sample> {
        samples.iter().map(|s| Sample { level: self.in_light(s.x, s.y, s.level), ..*s }).collect()
    }

    /// The same of a patch, in grey; the border is given in pixels of the image.
    pub fn evened_patch(&self, patch: &Patch) -> Patch {
        const WHITE: u16 = u16::MAX;
        let width = patch.window.width;
        let grey = |(i, colour): (usize, &[u16; 3])| {
            let (column, row) = (i as u64 % width, i as u64 / width);
            let (x, y) = ((patch.window.x + column) as f64 + 0.5, (patch.window.y + row) as f64 + 0.5);
            let level = self.in_light(x, y, super::grey::level(*colour, patch.white));
            [(level * f64::from(WHITE) / 255.0).round() as u16; 3]
        };
        Patch {
            window: patch.window,
            rgb: patch.rgb.iter().enumerate().map(grey).collect(),
            valid: patch.valid.clone(),
            white: WHITE,
        }
    }

    /// In another unit: a cell of `scale`, counted from `origin`.
    pub fn in_unit(&self, scale: f64, origin: (f64, f64)) -> Shade {
        Shade { x: origin.0 + self.x * scale, y: origin.1 + self.y * scale, soft: self.soft * scale, ..*self }
    }

    /// Whether light and shade are those of one target: both brighter in the light, the bright much.
    fn is_possible(&self) -> bool {
        let (lit, shaded) = (self.lit, self.shaded);
        let ends = |l: Levels| [l.ground, l.ground + l.height];
        let ratios = || ends(shaded).into_iter().zip(ends(lit)).map(|(s, l)| (l, s / l.max(1.0)));
        let bright = ratios().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |r| r.1);
        let dark = ratios().min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |r| r.1);
        lit.height * shaded.height > 0.0
            && RATIO.contains(&(shaded.height / lit.height))
            && RATIO.contains(&bright)
            && DARK_RATIO.contains(&dark)
            && (shaded.height / lit.height / bright).ln().abs() < MOST_UNEVEN
    }
}

/// Sums of a straight line of level against bright share.
#[derive(Clone, Copy, Default)]
struct Sums {
    n: f64,
    v: f64,
    vv: f64,
    l: f64,
    vl: f64,
    ll: f64,
}

impl Sums {
    fn add(&mut self, v: f64, l: f64) {
        self.n += 1.0;
        self.v += v;
        self.vv += v * v;
        self.l += l;
        self.vl += v * l;
        self.ll += l * l;
    }

    fn plus(&self, o: &Sums) -> Sums {
        let [n, v, vv, l, vl, ll] =
            [self.n + o.n, self.v + o.v, self.vv + o.vv, self.l + o.l, self.vl + o.vl, self.ll + o.ll];
        Sums { n, v, vv, l, vl, ll }
    }

    fn minus(&self, o: &Sums) -> Sums {
        let [n, v, vv, l, vl, ll] =
            [self.n - o.n, self.v - o.v, self.vv - o.vv, self.l - o.l, self.vl - o.vl, self.ll - o.ll];
        Sums { n, v, vv, l, vl, ll }
    }

    /// The line, and the sum of squares that it leaves over; `None` where the bright share hardly varies.
    fn line(&self) -> Option<(Levels, f64)> {
        const LEAST_VARIANCE: f64 = 0.03;
        let vv = self.vv - self.v * self.v / self.n;
        if self.n < 8.0 || vv < LEAST_VARIANCE * self.n {
            return None;
        }
        let (vl, ll) = (self.vl - self.v * self.l / self.n, self.ll - self.l * self.l / self.n);
        let height = vl / vv;
        let ground = (self.l - height * self.v) / self.n;
        Some((Levels { ground, height }, (ll - height * vl).max(0.0)))
    }
}

/// The levels on either side of a border, and what both lines leave over.
#[derive(Clone, Copy)]
struct Split {
    direction: f64,
    /// From the samples' mean, along the direction.
    place: f64,
    before: Levels,
    after: Levels,
    left: f64,
}

impl Split {
    fn of(direction: f64, place: f64, before: &Sums, after: &Sums, least: f64) -> Option<Split> {
        if before.n.min(after.n) < least {
            return None;
        }
        let ((one, left_one), (two, left_two)) = (before.line()?, after.line()?);
        Some(Split { direction, place, before: one, after: two, left: left_one + left_two })
    }
}

/// Samples with the sums over them.
struct Field<'a> {
    samples: &'a [Sample],
    values: &'a [f64],
    mean: (f64, f64),
    all: Sums,
}

impl Field<'_> {
    fn least(&self) -> f64 {
        LEAST_SHARE * self.all.n
    }

    /// Each sample's distance along a direction from the mean, with its bright share and level.
    fn along(&self, direction: f64) -> impl Iterator<Item = (f64, f64, f64)> {
        let (sin, cos) = direction.sin_cos();
        let (mx, my) = self.mean;
        self.samples.iter().zip(self.values).map(move |(s, v)| ((s.x - mx) * cos + (s.y - my) * sin, *v, s.level))
    }

    /// The best of the splits at all places in a direction, a step apart.
    fn best_along(&self, direction: f64, reach: f64, step: f64) -> Option<Split> {
        let mut bins = [Sums::default(); PLACES];
        for (d, v, level) in self.along(direction) {
            bins[(((d + reach) / step) as usize).min(PLACES - 1)].add(v, level);
        }
        let mut before = Sums::default();
        let splits = bins[..PLACES - 1].iter().enumerate().filter_map(|(place, bin)| {
            before = before.plus(bin);
            let place = (place + 1) as f64 * step - reach;
            Split::of(direction, place, &before, &self.all.minus(&before), self.least())
        });
        splits.min_by(|a, b| a.left.total_cmp(&b.left))
    }

    fn split(&self, direction: f64, place: f64) -> Option<Split> {
        let mut before = Sums::default();
        self.along(direction).filter(|(d, ..)| *d < place).for_each(|(_, v, level)| before.add(v, level));
        Split::of(direction, place, &before, &self.all.minus(&before), self.least())
    }

    /// The best split about another, on a grid that is made finer twice.
    fn refined(&self, split: Split, turn: f64, step: f64) -> Split {
        const STEPS: i32 = 3;
        let mut best = split;
        for finer in [1.0, 0.3] {
            let from = best;
            let at = |k: i32| finer * f64::from(k) / f64::from(STEPS);
            for (i, k) in (-STEPS..=STEPS).flat_map(|i| (-STEPS..=STEPS).map(move |k| (i, k))) {
                let near = self.split(from.direction + at(i) * turn, from.place + at(k) * step);
                best = near.filter(|near| near.left < best.left).unwrap_or(best);
            }
        }
        best
    }
}

/// The border of a shadow across samples whose bright shares are `values`, where two lights explain the levels far
/// better than one. `blur` is that of the picture.
pub fn across(samples: &[Sample], values: &[f64], blur: f64) -> Option<Shade> {
    let all = samples.iter().zip(values).fold(Sums::default(), |mut sums, (s, v)| {
        sums.add(*v, s.level);
        sums
    });
    let (_, one_light) = all.line()?;
    let mean = (samples.iter().map(|s| s.x).sum::<f64>() / all.n, samples.iter().map(|s| s.y).sum::<f64>() / all.n);
    let reach = samples.iter().map(|s| (s.x - mean.0).hypot(s.y - mean.1)).fold(1.0, f64::max);
    let (turn, step) = (std::f64::consts::PI / DIRECTIONS as f64, 2.0 * reach / PLACES as f64);
    let field = Field { samples, values, mean, all };
    let rough = (0..DIRECTIONS).filter_map(|k| field.best_along(turn * k as f64, reach, step));
    let rough = rough.min_by(|a, b| a.left.total_cmp(&b.left)).filter(|rough| rough.left < FAR_BETTER * one_light)?;
    let found = field.refined(rough, turn, 2.0 * step);
    // The shade is where the target's own contrast is less.
    let (back, lit, shaded) = match found.before.height.abs() >= found.after.height.abs() {
        true => (0.0, found.before, found.after),
        false => (std::f64::consts::PI, found.after, found.before),
    };
    let (sin, cos) = found.direction.sin_cos();
    let (x, y) = (mean.0 + found.place * cos, mean.1 + found.place * sin);
    let shade = Shade { direction: found.direction + back, x, y, soft: blur, lit, shaded };
    shade.is_possible().then_some(shade)
}

/// Light that falls off: the change of light across a unit of length, over the light at the middle.
#[derive(Clone, Copy, Debug)]
pub struct Fall {
    x: f64,
    y: f64,
    by: [f64; 2],
}

impl Fall {
    /// In another unit: a cell of `scale`, counted from `origin`.
    pub fn in_unit(&self, scale: f64, origin: (f64, f64)) -> Fall {
        Fall { x: origin.0 + self.x * scale, y: origin.1 + self.y * scale, by: self.by.map(|b| b / scale) }
    }

    /// The samples as they would be in even light.
    pub fn evened(&self, samples: &[Sample]) -> Vec<Sample> {
        let light = |s: &Sample| (1.0 + self.by[0] * (s.x - self.x) + self.by[1] * (s.y - self.y)).max(0.2);
        samples.iter().map(|s| Sample { level: s.level / light(s), ..*s }).collect()
    }
}

/// Light that falls off across samples whose bright shares are `values`, where that explains the levels better than
/// even light. Gauss–Newton on ground, height and the fall in both directions.
pub fn fall(samples: &[Sample], values: &[f64], (x, y): (f64, f64)) -> Option<Fall> {
    use nalgebra::{Matrix4, Vector4};
    const BETTER: f64 = 0.85;
    let mut p = Vector4::zeros();
    let (mut even, mut left) = (0.0, 0.0);
    for round in 0..5 {
        let (mut h, mut g) = (Matrix4::zeros(), Vector4::zeros());
        left = 0.0;
        for (s, v) in samples.iter().zip(values) {
            let (dx, dy) = (s.x - x, s.y - y);
            let (albedo, light) = (p[0] + p[1] * v, 1.0 + p[2] * dx + p[3] * dy);
            // The first round knows no albedo: even light.
            let by_fall = if round == 0 { 0.0 } else { albedo };
            let j = Vector4::new(light, v * light, by_fall * dx, by_fall * dy);
            let r = s.level - albedo * light;
            h += j * j.transpose();
            g += j * r;
            left += r * r;
        }
        if round == 0 {
            h[(2, 2)] = 1.0;
            h[(3, 3)] = 1.0;
        }
        if round == 1 {
            even = left;
        }
        if round < 4 {
            p += h.cholesky()?.solve(&g);
        }
    }
    (left < BETTER * even).then_some(Fall { x, y, by: [p[2], p[3]] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::window::Window;

    /// A chequer of 28 cells about its middle, 240 on 40, in this light.
    fn chequer(light: impl Fn(f64, f64) -> f64) -> (Vec<Sample>, Vec<f64>) {
        let place = |i: i32| (f64::from(i % 28) + 0.5, f64::from(i / 28) + 0.5);
        let bright = |(x, y): (f64, f64)| f64::from(u8::from((x > 14.0) == (y > 14.0)));
        let places = || (0..28 * 28).map(place);
        let values = places().map(bright).collect();
        let level = |(x, y): (f64, f64)| (40.0 + 200.0 * bright((x, y))) * light(x, y);
        (places().map(|(x, y)| Sample { x, y, level: level((x, y)) }).collect(), values)
    }

    #[test]
    fn a_shadow_is_found_and_its_levels_are_brought_to_the_light() {
        let (samples, values) = chequer(|x, y| if 0.6 * x + 0.8 * y > 22.0 { 0.4 } else { 1.0 });
        let shade = across(&samples, &values, 0.8).expect("a border");
        assert!((shade.direction - 0.8f64.atan2(0.6)).abs() < 0.15, "{shade:?}");
        assert!((shade.shaded.height / shade.lit.height - 0.4).abs() < 0.02, "{shade:?}");
        let clear = |s: &&Sample| (0.6 * s.x + 0.8 * s.y - 22.0).abs() > 3.0;
        let even = shade.evened(&samples);
        for (s, v) in even.iter().zip(&values).filter(|(s, _)| clear(s)) {
            assert!((s.level - (40.0 + 200.0 * v)).abs() < 6.0, "{s:?}");
        }
        // A patch is evened as its cells are, wherever it lies in the image.
        let rgb = samples.iter().map(|s| [s.level.round() as u16; 3]).collect();
        let patch = Patch { window: Window::new(100, 200, 28, 28), rgb, valid: vec![true; 28 * 28], white: 255 };
        let evened = shade.in_unit(1.0, (100.0, 200.0)).evened_patch(&patch);
        for (colour, s) in evened.rgb.iter().zip(&even) {
            assert!((f64::from(colour[0]) / 257.0 - s.level).abs() < 1.5, "{colour:?} {s:?}");
        }
    }

    #[test]
    fn even_light_and_what_no_shadow_does_are_no_shade() {
        let (samples, values) = chequer(|_, _| 1.0);
        assert!(across(&samples, &values, 0.8).is_none());
        let (samples, values) = chequer(|x, _| 1.0 - 0.01 * x);
        assert!(across(&samples, &values, 0.8).is_none(), "light that falls off");
        // Dark that is brighter in the shade than the bright.
        let (mut samples, values) = chequer(|_, _| 1.0);
        for s in samples.iter_mut().filter(|s| s.y > 18.0) {
            s.level = 280.0 - s.level;
        }
        assert!(across(&samples, &values, 0.8).is_none());
    }

    #[test]
    fn light_that_falls_off_is_evened() {
        let (samples, values) = chequer(|x, y| 1.0 + 0.012 * (x - 14.0) - 0.008 * (y - 14.0));
        let fall = fall(&samples, &values, (14.0, 14.0)).expect("a fall");
        assert!((fall.by[0] - 0.012).abs() < 1e-4 && (fall.by[1] + 0.008).abs() < 1e-4, "{fall:?}");
        for (s, v) in fall.evened(&samples).iter().zip(&values) {
            assert!((s.level - (40.0 + 200.0 * v)).abs() < 0.5, "{s:?}");
        }
        let (samples, values) = chequer(|_, _| 0.8);
        assert!(super::fall(&samples, &values, (14.0, 14.0)).is_none());
    }
}
