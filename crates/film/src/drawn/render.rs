//! Drawing film: tones by geometry, ground by photographs, then damage, exposure and the scanner.

use std::sync::Arc;

use super::{Exposed, FilmGround, FilmMark, FilmSpec, GreyPhoto};
use crate::interior::Pose;
use crate::template::{Model, invert};
use crate::types::Camera;
use autoref_raster::bilinear::by_differences;
use autoref_raster::coords::PixelPoint;
use autoref_raster::window::Window;
use autoref_synth::rng::{Rng, ValueNoise, hash2};

/// Light through the opaque frame, of white: film is never quite black.
const OPAQUE: f32 = 0.07;
/// Lines and dots that the camera exposes.
const BRIGHT: f32 = 0.78;
/// Light where the scanner sees no film.
const GLASS: f32 = 0.95;

/// Something on the film that is not the picture.
#[derive(Clone, Debug)]
pub(super) enum Damage {
    /// A line between two places of the scan.
    Scratch { from: [f32; 2], to: [f32; 2], half_px: f32, light: f32 },
    /// A speck: light is what it shows, dark or bright.
    Speck { at: [f32; 2], radius_px: f32, light: f32 },
    /// A box with lettering.
    Text { x: f32, y: f32, width: f32, height: f32, paper: f32, ink: f32, seed: u64 },
}

impl Damage {
    pub(super) fn random(spec: &FilmSpec, camera: &Camera, pose: &Pose, width: u64, height: u64) -> Vec<Damage> {
        let mut r = Rng::new(spec.seed, 0xf3, 0);
        let (w, h) = (width as f64, height as f64);
        let unit = pose.px_per_mm();
        let mut all = vec![];
        let marks = camera.film_points();
        for k in 0..spec.scratches {
            // Along the film's transport, mostly; every sixth runs by a mark.
            let mut from = [r.range(0.0, w), r.range(0.0, h)];
            if k % 6 == 0 {
                let p = pose.apply(marks[r.below(marks.len())]);
                from = [p.x + 2.0 * unit * r.normal(), p.y + 2.0 * unit * r.normal()];
            }
            let angle = if r.chance(0.6) { 0.05 * r.normal() } else { r.range(0.0, std::f64::consts::TAU) };
            let length = unit * r.range(1.0, 40.0);
            let (s, c) = angle.sin_cos();
            all.push(Damage::Scratch {
                from: [(from[0] - 0.5 * length * c) as f32, (from[1] - 0.5 * length * s) as f32],
                to: [(from[0] + 0.5 * length * c) as f32, (from[1] + 0.5 * length * s) as f32],
                half_px: r.range(0.3, 1.5) as f32,
                light: if r.chance(0.8) { r.range(0.5, 1.0) as f32 } else { 0.02 },
            });
        }
        for k in 0..spec.dust {
            let mut at = [r.range(0.0, w), r.range(0.0, h)];
            if k % 40 == 0 {
                let p = pose.apply(marks[r.below(marks.len())]);
                at = [p.x + 1.5 * unit * r.normal(), p.y + 1.5 * unit * r.normal()];
            }
            all.push(Damage::Speck {
                at: at.map(|v| v as f32),
                radius_px: r.range(0.7, 5.0) as f32,
                light: if r.chance(0.6) { r.range(0.5, 1.0) as f32 } else { 0.02 },
            });
        }
        for _ in 0..spec.text_boxes {
            let (bw, bh) = (unit * r.range(8.0, 30.0), unit * r.range(2.0, 6.0));
            let along = r.range(0.05, 0.95);
            let edge = unit * r.range(0.5, 4.0);
            let (x, y) = match r.below(4) {
                0 => (along * w, edge),
                1 => (along * w, h - edge - bh),
                2 => (edge, along * h),
                _ => (w - edge - bw, along * h),
            };
            let dark = r.chance(0.5);
            let text = Damage::Text {
                x: x as f32,
                y: y as f32,
                width: bw as f32,
                height: bh as f32,
                paper: if dark { 0.05 } else { 0.85 },
                ink: if dark { 0.9 } else { 0.1 },
                seed: r.next_u64(),
            };
            // Archives write beside marks, not over them.
            let clear = |p: PixelPoint| {
                let (dx, dy) = ((x - p.x).max(p.x - x - bw), (y - p.y).max(p.y - y - bh));
                dx.max(dy) > 3.5 * unit
            };
            if marks.iter().all(|mm| clear(pose.apply(*mm))) {
                all.push(text);
            }
        }
        all
    }

    /// Left, top, right, bottom.
    fn bounds(&self) -> [f32; 4] {
        match *self {
            Damage::Scratch { from, to, half_px, .. } => {
                let m = half_px + 1.5;
                [from[0].min(to[0]) - m, from[1].min(to[1]) - m, from[0].max(to[0]) + m, from[1].max(to[1]) + m]
            }
            Damage::Speck { at, radius_px, .. } => {
                let m = radius_px + 1.5;
                [at[0] - m, at[1] - m, at[0] + m, at[1] + m]
            }
            Damage::Text { x, y, width, height, .. } => [x, y, x + width, y + height],
        }
    }

    /// Coverage 0 to 1 and light at a place.
    fn at(&self, x: f32, y: f32) -> (f32, f32) {
        let soft = |inside_px: f32| (inside_px + 0.5).clamp(0.0, 1.0);
        match *self {
            Damage::Scratch { from, to, half_px, light } => {
                let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
                let t = (((x - from[0]) * dx + (y - from[1]) * dy) / (dx * dx + dy * dy).max(1e-6)).clamp(0.0, 1.0);
                let d = (x - from[0] - t * dx).hypot(y - from[1] - t * dy);
                (soft(half_px - d), light)
            }
            Damage::Speck { at, radius_px, light } => (soft(radius_px - (x - at[0]).hypot(y - at[1])), light),
            Damage::Text { x: left, y: top, height, paper, ink, seed, .. } => {
                let cell = height / 9.0;
                let (i, j) = (((x - left) / cell) as i64, ((y - top) / cell) as i64);
                let letter = i / 6;
                let inside = i % 6 < 4 && (2..7).contains(&j) && hash2(seed, i % 6 + 7 * letter, j) % 5 < 3;
                (1.0, if inside { ink } else { paper })
            }
        }
    }
}

/// The noise that drawn ground is a sum of, each finer than the one before.
type Octaves = [ValueNoise; 4];

/// What lies under the marks of one frame.
enum Picture {
    Noise,
    Photo(Arc<GreyPhoto>),
    Exposed(Exposed),
}

/// Everything that a pixel depends on.
pub(super) struct Painter {
    spec: FilmSpec,
    pose: Pose,
    inverse: [f64; 4],
    models: Vec<Model>,
    places: Vec<PixelPoint>,
    /// Scan → shape of every mark.
    to_shape: Vec<[f64; 4]>,
    /// Around every mark, pixels: how far its drawing, and the opaque tongue it stands on, are looked for. Beyond
    /// `bound_mm` along both axes of the shape there is neither.
    reach_px: Vec<f64>,
    bound_mm: Vec<f64>,
    tongue_mm: Vec<f64>,
    damage: Vec<Damage>,
    picture: Picture,
    image: [f64; 4],
    /// Upper left corner of the film, millimetres.
    film: [f64; 2],
    shift: [i64; 2],
    /// Of each turn, the places about a pixel.
    kernels: Vec<[(f64, f64); PLACES]>,
}

impl Painter {
    pub(super) fn new(
        spec: &FilmSpec,
        pose: Pose,
        models: Vec<Model>,
        places: Vec<PixelPoint>,
        damage: Vec<Damage>,
        ground: &FilmGround,
    ) -> Painter {
        let mut r = Rng::new(spec.seed, 0xf4, 0);
        let camera = &spec.camera;
        let linears: Vec<[f64; 4]> = camera.turns_deg().iter().map(|t| pose.shape_linear(*t)).collect();
        let to_shape = linears.iter().map(|l| invert(*l).expect("a pose is regular")).collect();
        let tongue_mm: Vec<f64> =
            models.iter().map(|m| if m.shows_image() { 0.0 } else { 1.15 * m.radius_mm() + 0.5 }).collect();
        let bound_mm: Vec<f64> = models
            .iter()
            .zip(&tongue_mm)
            .map(|(m, t)| {
                let (half, out, inward) = m.reach_mm();
                half.max(out).max(inward).max(*t)
            })
            .collect();
        // A tongue is drawn out to twice its mark; without one there is nothing beyond the bound, however it is turned.
        let unit = pose.px_per_mm();
        let reach_px = (0..models.len())
            .map(|k| match tongue_mm[k] {
                0.0 => 1.5 * bound_mm[k] * unit + 4.0,
                _ => 3.0 * models[k].radius_mm() * unit + 8.0,
            })
            .collect();
        let (centre, size) = (camera.film_centre(), camera.image_size_mm.unwrap_or(camera.film_size_mm));
        let image = [
            centre[0] - 0.5 * size[0],
            centre[1] - 0.5 * size[1],
            centre[0] + 0.5 * size[0],
            centre[1] + 0.5 * size[1],
        ];
        let picture = match ground {
            FilmGround::Exposed(exposed) => Picture::Exposed(exposed.clone()),
            FilmGround::Photos(photos) if !photos.is_empty() => Picture::Photo(photos[r.below(photos.len())].clone()),
            FilmGround::Photos(_) | FilmGround::Noise => Picture::Noise,
        };
        Painter {
            spec: spec.clone(),
            inverse: invert(pose.linear).expect("a pose is regular"),
            pose,
            models,
            places,
            to_shape,
            reach_px,
            bound_mm,
            tongue_mm,
            damage,
            picture,
            image,
            film: [0, 1].map(|k| centre[k] - 0.5 * camera.film_size_mm[k]),
            shift: [r.below(20_000) as i64, r.below(20_000) as i64],
            kernels: kernels(),
        }
    }

    pub(super) fn truth(&self, width: u64, height: u64) -> Vec<FilmMark> {
        let unit = self.pose.px_per_mm();
        let camera = &self.spec.camera;
        let turns = camera.turns_deg();
        (0..self.places.len())
            .map(|k| {
                let p = self.places[k];
                let (half, out, inward) = self.models[k].reach_mm();
                let l = self.pose.shape_linear(turns[k]);
                let inside = [(-half, -out), (half, -out), (-half, inward), (half, inward)].iter().all(|(u, v)| {
                    let (x, y) = (p.x + l[0] * u + l[1] * v, p.y + l[2] * u + l[3] * v);
                    x >= 0.0 && y >= 0.0 && x <= width as f64 && y <= height as f64
                });
                let critical = self.models[k].point_radius_mm().unwrap_or(self.models[k].radius_mm()) * unit;
                let damaged = self.damage.iter().any(|d| {
                    let near = |x: f32, y: f32| d.at(x, y).0 > 0.0;
                    let steps = 24;
                    let b = d.bounds();
                    let (x, y) = (p.x as f32, p.y as f32);
                    let c = critical as f32;
                    x + c > b[0]
                        && x - c < b[2]
                        && y + c > b[1]
                        && y - c < b[3]
                        && (0..steps * steps).any(|s| {
                            let f = |i: i32| (i as f32 + 0.5) / steps as f32 * 2.0 - 1.0;
                            let (dx, dy) = (f(s % steps) * c, f(s / steps) * c);
                            dx.hypot(dy) <= c && near(x + dx, y + dy)
                        })
                });
                let through = self.models[k].point_radius_mm().is_some();
                let hole_contrast = through
                    .then(|| self.spec.gain * f64::from((self.ground(p.x, p.y, &mut self.octaves()) - OPAQUE).abs()));
                FilmMark {
                    mark: camera.marks[k].name.clone(),
                    x: p.x,
                    y: p.y,
                    complete: inside,
                    damaged,
                    hole_contrast,
                }
            })
            .collect()
    }

    /// The octaves of drawn ground.
    fn octaves(&self) -> Octaves {
        [0, 2, 4, 6].map(|k| ValueNoise::new(self.spec.seed ^ k))
    }

    /// The exposed image at a place of the scan, fixed to the film, without edges.
    fn ground(&self, x: f64, y: f64, octaves: &mut Octaves) -> f32 {
        let (dx, dy) = (x - self.pose.offset[0], y - self.pose.offset[1]);
        let unit = self.pose.px_per_mm();
        let film = [self.inverse[0] * dx + self.inverse[1] * dy, self.inverse[2] * dx + self.inverse[3] * dy];
        let (u, v) = (film[0] * unit, film[1] * unit);
        let value = match &self.picture {
            Picture::Exposed(exposed) => exposed.at(film),
            Picture::Photo(photo) => {
                let (i, j) = (u.floor(), v.floor());
                let (fx, fy) = ((u - i) as f32, (v - j) as f32);
                let fold = |k: i64, n: usize| {
                    let m = k.rem_euclid(2 * n as i64) as usize;
                    if m < n { m } else { 2 * n - 1 - m }
                };
                let (x0, y0) = (i as i64 + self.shift[0], j as i64 + self.shift[1]);
                let [left, right] = [x0, x0 + 1].map(|x| fold(x, photo.width));
                let line = |y: i64| {
                    let row = &photo.data[fold(y, photo.height) * photo.width..][..photo.width];
                    [f32::from(row[left]), f32::from(row[right])]
                };
                by_differences([line(y0), line(y0 + 1)], [fx, fy]) / 255.0
            }
            Picture::Noise => {
                let [first, second, third, fourth] = octaves;
                let part = |noise: &mut ValueNoise, k: u32| {
                    let s = f64::from(1 << k) / 400.0;
                    noise.at((u * s) as f32, (v * s) as f32) / (k + 1) as f32
                };
                (part(first, 0) + part(second, 2) + part(third, 4) + part(fourth, 6)) / 1.68
            }
        };
        let size = [self.image[2] - self.image[0], self.image[3] - self.image[1]];
        let centre = [0.5 * (self.image[0] + self.image[2]), 0.5 * (self.image[1] + self.image[3])];
        let r2 = (((film[0] - centre[0]) / size[0]).powi(2) + ((film[1] - centre[1]) / size[1]).powi(2)) * 2.0;
        // Where no light fell there is still the film's fog above the opaque frame.
        OPAQUE + 0.03 + (0.04 + 0.82 * value) * (1.0 - self.spec.vignette as f32 * r2.min(1.0) as f32)
    }

    /// Light of the film at a place: what the geometry says, `None` where the image shows.
    fn tone(&self, x: f64, y: f64, near: &[usize]) -> Option<f32> {
        for &k in near {
            let (dx, dy) = (x - self.places[k].x, y - self.places[k].y);
            let s = &self.to_shape[k];
            let (u, v) = (s[0] * dx + s[1] * dy, s[2] * dx + s[3] * dy);
            // The tongue goes on outwards without end.
            if u.abs() > self.bound_mm[k] || v > self.bound_mm[k] {
                continue;
            }
            match (&self.models[k], self.models[k].sample(u, v)) {
                (Model::Learned(_), Some((value, _))) => return Some(value),
                (model, Some((value, _))) if value > 0.5 => {
                    return if model.shows_image() { None } else { Some(BRIGHT) };
                }
                (_, Some(_)) => return Some(OPAQUE),
                (_, None) => {}
            }
            let r = self.tongue_mm[k];
            if u * u + v * v < r * r || (u.abs() < r && v < 0.0) {
                return Some(OPAQUE);
            }
        }
        let (dx, dy) = (x - self.pose.offset[0], y - self.pose.offset[1]);
        let film = [self.inverse[0] * dx + self.inverse[1] * dy, self.inverse[2] * dx + self.inverse[3] * dy];
        let inside = |b: &[f64; 4]| film[0] > b[0] && film[0] < b[2] && film[1] > b[1] && film[1] < b[3];
        if inside(&self.image) {
            return None;
        }
        let ([left, top], [width, height]) = (self.film, self.spec.camera.film_size_mm);
        Some(if inside(&[left, top, left + width, top + height]) { OPAQUE } else { GLASS })
    }

    pub(super) fn render(&self, window: Window) -> Vec<u16> {
        let (width, height) = (window.width as usize, window.height as usize);
        let mut light = vec![0.0f32; width * height];
        let mut octaves = self.octaves();
        for y in 0..height {
            let cy = (window.y + y as u64) as f64 + 0.5;
            // Marks near this row.
            let row: Vec<usize> =
                (0..self.places.len()).filter(|k| (self.places[*k].y - cy).abs() < self.reach_px[*k]).collect();
            let mut near: Vec<usize> = vec![];
            // What a stretch of 16 pixels shows where it is the same all over.
            let mut even: Option<Option<f32>> = None;
            for x in 0..width {
                let cx = (window.x + x as u64) as f64 + 0.5;
                if x % 16 == 0 {
                    near.clear();
                    near.extend(
                        row.iter().copied().filter(|k| (self.places[*k].x - cx).abs() < self.reach_px[*k] + 16.0),
                    );
                    even = if near.is_empty() { self.even(cx, cy) } else { None };
                }
                light[y * width + x] = match even {
                    Some(tone) => tone.unwrap_or_else(|| self.ground(cx, cy, &mut octaves)),
                    None => self.pixel(cx, cy, &near, &mut octaves),
                };
            }
        }
        self.damage_window(window, &mut light);
        self.expose(window, &light)
    }

    /// What the 16 pixels from (x, y) on show, away from marks, where no edge of image or film comes near them.
    fn even(&self, x: f64, y: f64) -> Option<Option<f32>> {
        const HALF_PX: f64 = 7.5;
        // Half the stretch, the corners that a pixel looks at, and some.
        const CLEAR_PX: f64 = 12.0;
        let (dx, dy) = (x + HALF_PX - self.pose.offset[0], y - self.pose.offset[1]);
        let at = [self.inverse[0] * dx + self.inverse[1] * dy, self.inverse[2] * dx + self.inverse[3] * dy];
        let clear_mm = CLEAR_PX / self.pose.px_per_mm();
        let size = self.spec.camera.film_size_mm;
        let clear = |k: usize| {
            let edges = [self.image[k], self.image[k + 2], self.film[k], self.film[k] + size[k]];
            edges.iter().all(|edge| (at[k] - edge).abs() > clear_mm)
        };
        (clear(0) && clear(1)).then(|| self.tone(x + HALF_PX, y, &[]))
    }

    fn pixel(&self, x: f64, y: f64, near: &[usize], octaves: &mut Octaves) -> f32 {
        let middle = self.tone(x, y, near);
        const CORNERS: [(f64, f64); 4] = [(-1.7, -1.7), (1.7, -1.7), (-1.7, 1.7), (1.7, 1.7)];
        let learned = near.iter().any(|k| matches!(self.models[*k], Model::Learned(_)));
        let even = learned || CORNERS.iter().all(|(dx, dy)| self.tone(x + dx, y + dy, near) == middle);
        if even && !self.is_thin(near) {
            return middle.unwrap_or_else(|| self.ground(x, y, octaves));
        }
        let ground = self.ground(x, y, octaves);
        let shown = |&(dx, dy): &(f64, f64)| self.tone(x + dx, y + dy, near).unwrap_or(ground);
        let turn = hash2(0x51, x.floor() as i64, y.floor() as i64) as usize % TURNS;
        self.kernels[turn].iter().map(shown).sum::<f32>() / PLACES as f32
    }

    /// Lines thinner than the corners' distance could pass between them.
    fn is_thin(&self, near: &[usize]) -> bool {
        near.iter().any(|k| {
            let model = &self.models[*k];
            !model.shows_image() && model.detail_mm() * self.pose.px_per_mm() < 5.0
        })
    }

    fn damage_window(&self, window: Window, light: &mut [f32]) {
        let (x0, y0) = (window.x as f32, window.y as f32);
        for d in &self.damage {
            let b = d.bounds();
            let clip = |v: f32, from: f32, n: u64| (v - from).clamp(0.0, n as f32) as usize;
            let (left, right) = (clip(b[0].floor(), x0, window.width), clip(b[2].ceil(), x0, window.width));
            let (top, bottom) = (clip(b[1].floor(), y0, window.height), clip(b[3].ceil(), y0, window.height));
            for y in top..bottom {
                for x in left..right {
                    let (cover, value) = d.at(x0 + x as f32 + 0.5, y0 + y as f32 + 0.5);
                    let at = &mut light[y * window.width as usize + x];
                    *at += cover * (value - *at);
                }
            }
        }
    }

    fn expose(&self, window: Window, light: &[f32]) -> Vec<u16> {
        let spec = &self.spec;
        let white = if spec.bits == 16 { 65_535.0f32 } else { 255.0 };
        let (gain, sigma) = (spec.gain as f32, spec.noise as f32);
        let width = window.width as usize;
        let bands: Vec<f32> = (window.y..window.bottom())
            .map(|y| spec.banding as f32 * ((y as f32 * 0.031).sin() + 0.5 * (y as f32 * 0.19).sin()))
            .collect();
        light
            .iter()
            .enumerate()
            .map(|(i, v)| {
                let (x, y) = (window.x + (i % width) as u64, window.y + (i / width) as u64);
                let h = hash2(spec.seed ^ 0x6e01, x as i64, y as i64);
                // Sum of four uniform numbers: variance 1/3.
                let bits = |k: u32| ((h >> (16 * k)) & 0xffff) as f32 / 65_536.0;
                let normal = (bits(0) + bits(1) + bits(2) + bits(3) - 2.0) * 1.732;
                // A dark exposure has less grain too.
                let value = v * gain + bands[i / width] + sigma * normal * (0.3 + 0.7 * gain.min(1.0));
                (value * white + 0.5).clamp(0.0, white) as u16
            })
            .collect()
    }
}

/// Places that a pixel looks at.
const PLACES: usize = 64;

/// Turns of the places within half a turn.
const TURNS: usize = 16;

/// A Gaussian of σ 0.7 px as places that count alike, each with its opposite, on a spiral of the golden angle: the edge
/// of a straight line, however it lies, passes them one after another. On a lattice it would move by the lattice's
/// step. One spiral for all pixels would move a line that lies along rows or columns by some hundredths of a pixel, in
/// every pixel alike: each pixel has one of these, turned otherwise.
fn kernels() -> Vec<[(f64, f64); PLACES]> {
    const SIGMA_PX: f64 = 0.7;
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let turned = |turn: usize| {
        let turn = std::f64::consts::PI * turn as f64 / TURNS as f64;
        std::array::from_fn(|index| {
            let (k, side) = ((index / 2) as f64, if index % 2 == 0 { 1.0 } else { -1.0 });
            let radius = side * SIGMA_PX * (-2.0 * (1.0 - 2.0 * (k + 0.5) / PLACES as f64).ln()).sqrt();
            // Half a turn holds all directions, as each has its opposite.
            let angle = 0.5 * golden * k + turn;
            (radius * angle.cos(), radius * angle.sin())
        })
    };
    (0..TURNS).map(turned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawn::{FilmScene, FilmSpec};
    use crate::load_camera;
    use autoref_raster::RasterSource;

    #[test]
    fn a_window_is_the_same_however_it_is_asked_for() {
        let camera = load_camera("svalbard-zeiss-1936").expect("built in");
        let scene = FilmScene::new(&FilmSpec::archive(&camera, 60.0, 7), &FilmGround::Noise).expect("drawable");
        let m = &scene.truth().marks[0];
        let big = Window::new((m.x as u64).saturating_sub(60), (m.y as u64).saturating_sub(20), 120, 60);
        let small = Window::new(big.x + 31, big.y + 17, 40, 30);
        let (a, b) = (scene.render(big), scene.render(small));
        for y in 0..30usize {
            for x in 0..40usize {
                assert_eq!(b[y * 40 + x], a[(y + 17) * 120 + x + 31]);
            }
        }
        assert!(scene.info().width > 2500);
    }
}
