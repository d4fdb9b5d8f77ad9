//! Luma and colour differences around a mark on the JPEG's grid, and what of them is not correlated.

use nalgebra::Vector3;

use super::fit::Fit;
use super::jpeg_steps::{CELLS, Cells, N, TO_YCC, Tables};
use super::scene::{Ground, Scene};
use autoref_raster::Patch;

/// Columns and rows of a block of chroma at half resolution.
const MACRO: usize = 16;
/// A mark that reaches over more of them keeps the fit to pixels.
const MOST_MACROS: i64 = 8;
/// Blocks of which fewer cells were seen do not count.
const LEAST_SEEN: usize = 44;

/// Luma and colour differences around a mark, on the JPEG's grid.
pub(super) struct Planes {
    pub width: usize,
    pub height: usize,
    /// At full resolution.
    pub luma: Vec<f64>,
    pub seen: Vec<bool>,
    /// At half resolution.
    pub chroma: [Vec<f64>; 2],
    pub half_seen: Vec<bool>,
}

/// Linear combinations of luma and colour differences whose ground texture is not correlated: each less what those
/// before it tell of it. What rounding adds to each is kept with it.
pub(super) struct Channels {
    /// Second less first; third less first, third less second.
    less: [f64; 3],
    /// Variance of the ground's pixels.
    pub spread: [f64; 3],
    /// Variance of each coefficient by rounding.
    pub rounding: [Cells; 3],
}

impl Channels {
    pub fn new(ground: &Ground, tables: &Tables) -> Channels {
        /// Variance of pixels by noise and rounding, which tells nothing of the other channels.
        const NOISE: f64 = 9.0;
        let v = TO_YCC * ground.covariance * TO_YCC.transpose();
        let (first, second) = (v[(0, 1)] / (v[(0, 0)] + NOISE), v[(0, 2)] / (v[(0, 0)] + NOISE));
        let rest = v[(1, 1)] - first * v[(0, 1)];
        let between = v[(1, 2)] - first * v[(0, 2)];
        let third = between / (rest + NOISE);
        let last = v[(2, 2)] - second * v[(0, 2)] - third * between;
        let own = |q: f64| q * q / 12.0;
        // Luma averaged over 2 × 2 pixels has a quarter of the noise, at twice the frequency.
        let below = |k: usize| own(tables.luma[k / N / 2 * N + k % N / 2]) / 4.0;
        Channels {
            less: [first, second, third],
            spread: [v[(0, 0)], rest, last].map(|v| v.max(0.1)),
            rounding: [
                tables.luma.map(own),
                std::array::from_fn(|k| own(tables.chroma[k]) + first.powi(2) * below(k)),
                std::array::from_fn(|k| {
                    own(tables.chroma[k]) * (1.0 + third.powi(2)) + (second - third * first).powi(2) * below(k)
                }),
            ],
        }
    }

    pub fn of(&self, ycc: Vector3<f64>) -> [f64; 3] {
        let b = ycc[1] - self.less[0] * ycc[0];
        [ycc[0], b, ycc[2] - self.less[1] * ycc[0] - self.less[2] * b]
    }

    /// Puts the channels in the place of the colour differences.
    pub fn apply(&self, planes: &mut Planes) {
        let luma = half(&planes.luma, planes.width, planes.height);
        let [blue, red] = &mut planes.chroma;
        for ((y, b), r) in luma.iter().zip(blue).zip(red) {
            [_, *b, *r] = self.of(Vector3::new(*y, *b, *r));
        }
    }
}

/// Means over 2 × 2 pixels.
pub(super) fn half(plane: &[f64], width: usize, height: usize) -> Vec<f64> {
    let mut out = Vec::with_capacity(width * height / 4);
    for rows in plane.chunks_exact(2 * width) {
        let (upper, lower) = rows.split_at(width);
        out.extend(upper.chunks_exact(2).zip(lower.chunks_exact(2)).map(|(u, l)| (u[0] + u[1] + l[0] + l[1]) / 4.0));
    }
    out
}

/// First cell and length of the blocks that hold a stretch, in pixels of the image; `None` of too many.
fn span(at: f64, reach: f64) -> Option<(i64, usize)> {
    let m = MACRO as f64;
    let (from, to) = (((at - reach) / m).floor() as i64, ((at + reach) / m).ceil() as i64);
    (to - from <= MOST_MACROS).then_some((from * MACRO as i64, (to - from) as usize * MACRO))
}

/// The planes around a fitted mark and where their corner lies in the image.
pub(super) fn planes(scene: &Scene<'_>, around: &Patch, paint: &[bool], fit: &Fit) -> Option<(Planes, (i64, i64))> {
    let inner = &scene.patch.window;
    let [a, b] = fit.sides_px;
    let (sin, cos) = fit.angle_rad.sin_cos();
    let spare = 2.5 * fit.blur_px + 1.0;
    let (x, width) = span(inner.x as f64 + fit.x, (a * cos.abs() + b * sin.abs()) / 2.0 + spare)?;
    let (y, height) = span(inner.y as f64 + fit.y, (a * sin.abs() + b * cos.abs()) / 2.0 + spare)?;
    let outer = &around.window;
    let scale = 255.0 / f64::from(around.white);
    // With a rim of one pixel, for the interpolation of chroma.
    let (w, h) = (width + 2, height + 2);
    let mut all = vec![Vector3::zeros(); w * h];
    let mut seen = vec![false; w * h];
    let hidden = scene.beside_other().minus(&scene.own);
    for i in 0..w * h {
        let (u, v) = (x + (i % w) as i64 - 1, y + (i / w) as i64 - 1);
        let (Ok(u), Ok(v)) = (u64::try_from(u), u64::try_from(v)) else { continue };
        if !outer.contains(u, v) {
            continue;
        }
        let j = (v - outer.y) as usize * outer.width as usize + (u - outer.x) as usize;
        let clear = if inner.contains(u, v) {
            let k = (v - inner.y) as usize * scene.width + (u - inner.x) as usize;
            !hidden.has(k)
        } else {
            !paint[j]
        };
        all[i] = TO_YCC * Vector3::from(around.rgb[j].map(|v| f64::from(v) * scale));
        seen[i] = around.valid[j] && clear;
    }
    let core = |i: usize| (i / width + 1) * w + i % width + 1;
    let (luma, core_seen) = (0..width * height).map(|i| (all[core(i)][0], seen[core(i)])).unzip();
    let (chroma, half_seen) = chroma(&all, &seen, (width, height));
    Some((Planes { width, height, luma, seen: core_seen, chroma, half_seen }, (x, y)))
}

/// Colour differences at half resolution, as the file has them, and which are known; `all` and `seen` have a rim of a
/// pixel.
fn chroma(all: &[Vector3<f64>], seen: &[bool], (width, height): (usize, usize)) -> ([Vec<f64>; 2], Vec<bool>) {
    // libjpeg interpolates with weights of 3/4 and 1/4; these four undo that exactly.
    const UNDO: [f64; 4] = [-0.25, 0.75, 0.75, -0.25];
    let w = width + 2;
    let count = width * height / 4;
    let mut out = [vec![0.0; count], vec![0.0; count]];
    let mut known = vec![true; count];
    for i in 0..count {
        let first = 2 * (i / (width / 2)) * w + 2 * (i % (width / 2));
        for (dy, y) in UNDO.iter().enumerate() {
            for (dx, x) in UNDO.iter().enumerate() {
                let j = first + dy * w + dx;
                known[i] &= seen[j];
                out[0][i] += x * y * all[j][1];
                out[1][i] += x * y * all[j][2];
            }
        }
    }
    (out, known)
}

pub(super) fn block(plane: &[f64], width: usize, b: usize) -> Cells {
    let (x, y) = (b % (width / N) * N, b / (width / N) * N);
    let mut out = [0.0; CELLS];
    for (row, cells) in out.chunks_exact_mut(N).enumerate() {
        cells.copy_from_slice(&plane[(y + row) * width + x..][..N]);
    }
    out
}

/// The blocks of which enough is seen: their numbers, and 1 for each cell that is.
pub(super) fn seen_blocks(seen: &[bool], width: usize) -> impl Iterator<Item = (usize, Cells)> {
    let mask: Vec<f64> = seen.iter().map(|&s| f64::from(u8::from(s))).collect();
    let blocks = (0..seen.len() / CELLS).map(move |b| (b, block(&mask, width, b)));
    blocks.filter(|(_, mask)| mask.iter().filter(|&&m| m > 0.0).count() >= LEAST_SEEN)
}
