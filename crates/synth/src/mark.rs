//! A mark with every choice made, and how it changes a pixel.

use super::paint::Paint;
use super::rng::{Rng, mix, value_noise};
use super::shape::{Figure, Shape};
use super::spec::{MarkStyle, MarkTurn};
use super::truth::Shadow;
use autoref_raster::normal;

/// What hides part of a mark: everything on one side of a line.
#[derive(Clone, Copy, Debug)]
struct Cover {
    normal: (f64, f64),
    /// Distance of the line from the centre along the normal; beyond it the mark is hidden.
    distance: f64,
}

/// A soft-edged dark rectangle over mark and ground.
#[derive(Clone, Copy, Debug)]
struct ShadowPatch {
    centre: (f64, f64),
    axis: (f64, f64),
    half: (f64, f64),
    /// What is left of the light, for each colour: shadows are lit by the sky, so blue loses least.
    light: [f32; 3],
}

/// A mark (or a false object) at its place.
#[derive(Clone, Debug)]
pub(crate) struct Mark {
    pub x: f64,
    pub y: f64,
    pub size_px: f64,
    pub shape: Shape,
    pub turn_deg: f64,
    pub paint: Paint,
    pub fading: f64,
    pub covered: f64,
    pub shadow: Shadow,
    second: Paint,
    blur_px: f64,
    texture: f32,
    seed: u64,
    figure: Figure,
    cover: Option<Cover>,
    patch: Option<ShadowPatch>,
}

impl Mark {
    /// Makes every random choice of one mark from `rng`, in a fixed order.
    pub(crate) fn new(style: &MarkStyle, gsd_m: f64, x: f64, y: f64, mut rng: Rng) -> Self {
        let size_px = style.size.px(gsd_m);
        let random_turn = rng.range(0.0, 360.0);
        let turn_deg = match style.turn {
            MarkTurn::Random => random_turn,
            MarkTurn::Degrees(deg) => deg,
        };
        let paint = style.paints[rng.below(style.paints.len())];
        let figure = Figure::new(style.shape, size_px, turn_deg.to_radians(), style.blur_px);
        let covered = rng.range(0.0, 1.0) * style.cover_max;
        let cover_angle = rng.range(0.0, std::f64::consts::TAU);
        let cover = (covered > 0.0).then(|| Cover::hiding(&figure, covered, cover_angle));
        let in_shadow = rng.chance(style.shadow_share);
        let shadow = match (in_shadow, rng.chance(0.5)) {
            (false, _) => Shadow::None,
            (true, false) => Shadow::Full,
            (true, true) => Shadow::Edge,
        };
        let patch = (shadow != Shadow::None).then(|| ShadowPatch::over(shadow, x, y, size_px, &mut rng));
        Mark {
            x,
            y,
            size_px,
            shape: style.shape,
            turn_deg,
            paint,
            fading: style.fading,
            covered,
            shadow,
            second: style.second_paint,
            blur_px: style.blur_px.max(0.3),
            texture: style.texture as f32,
            seed: mix(rng.next_u64()),
            figure,
            cover,
            patch,
        }
    }

    /// Nothing changes outside this rectangle: x0, y0, x1, y1 in pixels.
    pub(crate) fn bounds(&self) -> [f64; 4] {
        let mut reach = self.figure.reach() + 1.0;
        if let Some(p) = &self.patch {
            let offset = (p.centre.0 - self.x).hypot(p.centre.1 - self.y);
            reach = reach.max(offset + p.half.0.hypot(p.half.1) + 5.0 * self.blur_px);
        }
        [self.x - reach, self.y - reach, self.x + reach, self.y + reach]
    }

    /// Paints the pixel in column `px`, row `py`, whose colour is `rgb` in 8-bit levels. Mixing is linear in the sRGB
    /// values, as resampling programs do it. Returns the share of the pixel that is paint.
    pub(crate) fn paint(&self, px: u64, py: u64, rgb: &mut [f32; 3]) -> f32 {
        let (dx, dy) = (px as f64 + 0.5 - self.x, py as f64 + 0.5 - self.y);
        let (mut all, mut second) = self.figure.coverage(dx, dy);
        if let Some(c) = &self.cover {
            let along = dx * c.normal.0 + dy * c.normal.1;
            let shown = normal::below((c.distance - along) / self.blur_px);
            (all, second) = (all * shown, second * shown);
        }
        let opaque = 1.0 - self.fading;
        let (all, second) = ((all * opaque) as f32, (second * opaque) as f32);
        if all > 0.0 {
            let uneven = 2.0 * value_noise(self.seed, px as f32 / 1.7, py as f32 / 1.7) - 1.0;
            let gain = 1.0 + self.texture * uneven;
            for (band, value) in rgb.iter_mut().enumerate() {
                let first = f32::from(self.paint.0[band]) * gain;
                let other = f32::from(self.second.0[band]) * gain;
                *value = *value * (1.0 - all) + first * (all - second) + other * second;
            }
        }
        if let Some(p) = &self.patch {
            let depth = p.depth(px as f64 + 0.5, py as f64 + 0.5, self.blur_px + 0.5);
            for (value, light) in rgb.iter_mut().zip(p.light) {
                *value *= 1.0 - depth * (1.0 - light);
            }
        }
        all
    }
}

impl Cover {
    /// The line that hides a share of the figure, found among places spread over it.
    ///
    /// The places are a fortieth of the size apart, and the thinnest bar is an eighth: some are always found.
    fn hiding(figure: &Figure, share: f64, angle: f64) -> Self {
        let normal = (angle.cos(), angle.sin());
        let mut along: Vec<f64> = figure.places().iter().map(|p| p.0 * normal.0 + p.1 * normal.1).collect();
        along.sort_by(|a, b| b.total_cmp(a));
        let hidden = (share * along.len() as f64) as usize;
        let distance = along[hidden.min(along.len() - 1)];
        Cover { normal, distance }
    }
}

impl ShadowPatch {
    fn over(shadow: Shadow, x: f64, y: f64, size_px: f64, rng: &mut Rng) -> Self {
        let angle = rng.range(0.0, std::f64::consts::TAU);
        let axis = (angle.cos(), angle.sin());
        let half = (size_px * rng.range(1.5, 3.0), size_px * rng.range(1.5, 4.0));
        // For an edge the patch's side passes within a third of the size of the centre.
        let shift = match shadow {
            Shadow::Edge => half.0 + size_px * rng.range(-0.33, 0.33),
            Shadow::Full | Shadow::None => 0.0,
        };
        let dark = rng.range(0.40, 0.62) as f32;
        ShadowPatch {
            centre: (x + axis.0 * shift, y + axis.1 * shift),
            axis,
            half,
            light: [dark, dark * 1.06, dark * 1.18],
        }
    }

    /// 1 in the shadow, 0 outside, soft over `sigma` pixels.
    fn depth(&self, x: f64, y: f64, sigma: f64) -> f32 {
        let (dx, dy) = (x - self.centre.0, y - self.centre.1);
        let u = dx * self.axis.0 + dy * self.axis.1;
        let v = dy * self.axis.0 - dx * self.axis.1;
        let side = |t: f64, half: f64| normal::below((half - t) / sigma) - normal::below((-half - t) / sigma);
        (side(u, self.half.0) * side(v, self.half.1)) as f32
    }
}
