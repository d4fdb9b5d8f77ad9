//! Marks planted into real photographs, with centres known to a hundredth of a pixel: what the detection benchmark
//! measures on, and the self-test on the customer's own image.

use super::jpeg::{Chroma, jpeg_round_trip};
use super::shape::{Figure, Shape};
use autoref_raster::random::{unit, xorshift};
use autoref_raster::srgb::{linear_from_srgb, srgb_from_linear};
use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::{Dataset, DriverManager};
use std::sync::atomic::{AtomicU64, Ordering};

/// An 8-bit RGB picture, row-major.
#[derive(Clone)]
pub struct Picture {
    pub width: usize,
    pub height: usize,
    pub rgb: Vec<[u8; 3]>,
}

impl Picture {
    /// The part of the picture from column `x` and row `y`, which must lie in it; clipped at the far edges.
    pub fn crop(&self, x: usize, y: usize, width: usize, height: usize) -> Picture {
        let (width, height) = (width.min(self.width - x), height.min(self.height - y));
        let rows =
            (y..y + height).flat_map(|v| self.rgb[v * self.width + x..v * self.width + x + width].iter().copied());
        Picture { width, height, rgb: rows.collect() }
    }

    /// Through a JPEG of that quality that keeps all chroma.
    ///
    /// # Panics
    /// When a side is above 65,535 pixels.
    pub fn through_full_jpeg(&self, quality: u8) -> Picture {
        let bytes =
            jpeg_round_trip(self.rgb.as_flattened(), self.width as u64, self.height as u64, quality, Chroma::Full);
        let rgb = bytes.expect("a picture encodes").as_chunks::<3>().0.to_vec();
        Picture { rgb, ..*self }
    }

    /// Through a JPEG of that quality, chroma halved both ways by averaging, as cameras and libjpeg do. (An encoder
    /// that takes every second chroma sample instead moves all colour by half a pixel, and every centre with it.)
    ///
    /// # Panics
    /// When GDAL lacks its JPEG driver, or a side is above 65,500 pixels.
    pub fn through_jpeg(&self, quality: u8) -> Picture {
        let (w, h) = (self.width, self.height);
        let memory = DriverManager::get_driver_by_name("MEM").expect("GDAL has it always");
        let source = memory.create_with_band_type::<u8, _>("", w, h, 3).expect("a picture fits in memory");
        for c in 0..3 {
            let mut band = Buffer::new((w, h), self.rgb.iter().map(|p| p[c]).collect());
            source.rasterband(c + 1).and_then(|mut b| b.write((0, 0), (w, h), &mut band)).expect("sizes agree");
        }
        static NAMES: AtomicU64 = AtomicU64::new(0);
        let name = format!("/vsimem/plant-{}.jpg", NAMES.fetch_add(1, Ordering::Relaxed));
        let jpeg = DriverManager::get_driver_by_name("JPEG").expect("GDAL has it always");
        let quality = format!("QUALITY={quality}");
        let options = RasterCreationOptions::from_iter([quality.as_str()]);
        let file = source.create_copy(&jpeg, &name, &options).expect("a picture encodes");
        drop(file);
        let file = Dataset::open(&name).expect("just written");
        let bands: Vec<Vec<u8>> = (1..=3)
            .map(|c| {
                let band = file.rasterband(c).expect("three bands");
                band.read_as::<u8>((0, 0), (w, h), (w, h), None).expect("just encoded").data().to_vec()
            })
            .collect();
        drop(file);
        gdal::vsi::unlink_mem_file(&name).expect("just read");
        let rgb = (0..w * h).map(|i| [bands[0][i], bands[1][i], bands[2][i]]).collect();
        Picture { width: w, height: h, rgb }
    }
}

/// A small generator with a fixed seed, which is not 0.
pub struct Random(pub u64);

impl Random {
    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        unit(xorshift(&mut self.0))
    }
    /// Standard normal (Box–Muller).
    pub fn gauss(&mut self) -> f64 {
        (-2.0 * self.unit().max(1e-300).ln()).sqrt() * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// One set of conditions.
#[derive(Clone, Debug)]
pub struct Cell {
    pub label: String,
    pub side_px: f64,
    pub blur_px: f64,
    /// `None` is any angle.
    pub angle_deg: Option<f64>,
    /// Largest share of ground shining through; each mark draws its own below it.
    pub fading: f64,
    /// Light inside the shadow that covers the mark and its surroundings; 1 is none.
    pub light: f64,
    /// Share of the mark hidden under ground from one side.
    pub cover: f64,
    pub quality: u8,
    /// The JPEG keeps all chroma.
    pub full_chroma: bool,
    pub paint: [u8; 3],
    pub disc: bool,
    /// Mix in linear light, as optics do, instead of in sRGB, as image editors do.
    pub linear: bool,
    /// Standard deviation of the noise on the paint, 8-bit levels.
    pub noise: f64,
    /// A shape of the synthesiser instead of square or disc, in `paint` and `second`.
    pub figure: Option<Shape>,
    pub second: [u8; 3],
}

impl Cell {
    /// The mark from which others differ in one thing at a time.
    pub fn base() -> Cell {
        Cell {
            label: "base".into(),
            side_px: 10.0,
            blur_px: 0.9,
            angle_deg: None,
            fading: 0.2,
            light: 1.0,
            cover: 0.0,
            quality: 90,
            full_chroma: false,
            paint: [255, 110, 20],
            disc: false,
            linear: false,
            noise: 1.5,
            figure: None,
            second: [28, 28, 31],
        }
    }

    /// Side of the window that a mark changes, pixels.
    pub fn window_px(&self) -> usize {
        (self.side_px * 1.5 + 8.0 * self.blur_px).ceil() as usize + 4
    }
}

const FINE: usize = 5;

/// Share of paint in each pixel of a window `size` pixels wide, for a mark centred at (cx, cy) in it.
fn shares(cell: &Cell, size: usize, cx: f64, cy: f64, angle: f64, cover_angle: f64) -> Vec<f64> {
    let (sin, cos) = angle.sin_cos();
    let half = cell.side_px / 2.0;
    let (csin, ccos) = cover_angle.sin_cos();
    // Side of the half plane that hides the wanted share of a square or, nearly, a disc.
    let edge = half - cell.cover * cell.side_px;
    blurred(size, cell.blur_px, |x, y| {
        let (u, v) = (cos * (x - cx) + sin * (y - cy), cos * (y - cy) - sin * (x - cx));
        // Cells on an edge are covered by their share: all or nothing would move edges along the grid to whole cells,
        // and with them the centre by up to a tenth of a pixel.
        let within = |depth: f64| (depth * FINE as f64 + 0.5).clamp(0.0, 1.0);
        let inside =
            if cell.disc { within(half - u.hypot(v)) } else { within(half - u.abs()) * within(half - v.abs()) };
        let open = if cell.cover > 0.0 { within(edge - (ccos * u + csin * v)) } else { 1.0 };
        inside * open
    })
}

/// Share of each pixel of a window that a shape covers: at five times the resolution, each cell by its share, blurred
/// with a Gaussian.
pub fn blurred(size: usize, blur_px: f64, covered: impl Fn(f64, f64) -> f64) -> Vec<f64> {
    let n = size * FINE;
    let mut fine: Vec<f32> = (0..n * n)
        .map(|i| {
            let (x, y) = (((i % n) as f64 + 0.5) / FINE as f64, ((i / n) as f64 + 0.5) / FINE as f64);
            covered(x, y) as f32
        })
        .collect();
    blur(&mut fine, n, blur_px * FINE as f64);
    means(&fine, size)
}

/// Along the rows and then along the columns of n × n values; beyond them lies nothing.
fn blur(fine: &mut [f32], n: usize, sigma: f64) {
    let reach = (3.5 * sigma).ceil() as usize;
    let weight = |k: usize| (-0.5 * ((k as f64 - reach as f64) / sigma).powi(2)).exp() as f32;
    let kernel: Vec<f32> = (0..=2 * reach).map(weight).collect();
    let total: f32 = kernel.iter().sum();
    let mut padded = vec![0f32; n + 2 * reach];
    for row in fine.chunks_exact_mut(n) {
        padded[reach..reach + n].copy_from_slice(row);
        row.fill(0.0);
        for (k, weight) in kernel.iter().enumerate() {
            add(row, &padded[k..k + n], *weight);
        }
        row.iter_mut().for_each(|sum| *sum /= total);
    }
    let rows = fine.to_vec();
    for (i, row) in fine.chunks_exact_mut(n).enumerate() {
        row.fill(0.0);
        for (j, along) in rows.chunks_exact(n).enumerate().take(i + reach + 1).skip(i.saturating_sub(reach)) {
            add(row, along, kernel[j + reach - i]);
        }
        row.iter_mut().for_each(|sum| *sum /= total);
    }
}

fn add(sums: &mut [f32], values: &[f32], weight: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value * weight);
}

/// The mean of each pixel's cells.
fn means(fine: &[f32], size: usize) -> Vec<f64> {
    let n = size * FINE;
    (0..size * size)
        .map(|i| {
            let (x, y) = (i % size * FINE, i / size * FINE);
            let sum: f32 = (0..FINE * FINE).map(|k| fine[(y + k / FINE) * n + x + k % FINE]).sum();
            f64::from(sum) / (FINE * FINE) as f64
        })
        .collect()
}

/// Plants one mark in each square of a grid (none where nothing was photographed) and returns the true centres (pixel
/// corners at whole numbers).
pub fn plant(ground: &Picture, cell: &Cell, random: &mut Random) -> (Picture, Vec<(f64, f64)>) {
    let pitch = cell.window_px() + 28;
    let mut out = ground.clone();
    let mut truth = Vec::new();
    for gy in (8..ground.height.saturating_sub(pitch)).step_by(pitch) {
        for gx in (8..ground.width.saturating_sub(pitch)).step_by(pitch) {
            let x0 = gx + (random.unit() * 14.0) as usize;
            let y0 = gy + (random.unit() * 14.0) as usize;
            if nothing_there(ground, (x0, y0), cell.window_px()) {
                continue;
            }
            // The shadow reaches well beyond the window that the detector looks at.
            if cell.light < 1.0 {
                for (y, x) in (0..pitch).flat_map(|y| (0..pitch).map(move |x| (gy + y, gx + x))) {
                    out.rgb[y * out.width + x] = dim(out.rgb[y * out.width + x], cell.light);
                }
            }
            truth.push(paint_mark(&mut out, cell, (x0, y0), random));
        }
    }
    let picture = if cell.full_chroma { out.through_full_jpeg(cell.quality) } else { out.through_jpeg(cell.quality) };
    (picture, truth)
}

/// Whether a tenth of a window or more is exactly black: beyond the edge of what was photographed, where nobody paints.
fn nothing_there(ground: &Picture, (x0, y0): (usize, usize), side: usize) -> bool {
    let rows = (y0..y0 + side).flat_map(|y| &ground.rgb[y * ground.width + x0..][..side]);
    rows.filter(|c| **c == [0; 3]).count() * 10 >= side * side
}

/// Paints one mark into the window of [`Cell::window_px`] that begins at (x0, y0) and lies in the picture; returns its
/// centre, within half a pixel of the window's middle. Shadow and JPEG are the caller's.
pub fn paint_mark(out: &mut Picture, cell: &Cell, (x0, y0): (usize, usize), random: &mut Random) -> (f64, f64) {
    let size = cell.window_px();
    let middle = size as f64 / 2.0;
    let (cx, cy) = (middle + random.unit() - 0.5, middle + random.unit() - 0.5);
    let turn = cell.angle_deg.map_or(random.unit() * std::f64::consts::TAU, f64::to_radians);
    let side = (random.unit() * 4.0).floor() * std::f64::consts::FRAC_PI_2;
    let (share, second): (Vec<f64>, Vec<f64>) = match cell.figure {
        None => (shares(cell, size, cx, cy, turn, side), vec![0.0; size * size]),
        Some(shape) => {
            let figure = Figure::new(shape, cell.side_px, turn, cell.blur_px);
            let at = |i: usize| figure.coverage((i % size) as f64 + 0.5 - cx, (i / size) as f64 + 0.5 - cy);
            (0..size * size).map(at).unzip()
        }
    };
    let fading = cell.fading * random.unit();
    let (first, other) = (dim(cell.paint, cell.light), dim(cell.second, cell.light));
    for (i, (&covered, &second)) in share.iter().zip(&second).enumerate() {
        let at = (y0 + i / size) * out.width + x0 + i % size;
        let a = covered * (1.0 - fading);
        if covered < 1e-4 {
            continue;
        }
        let inner = (second / covered).min(1.0);
        for c in 0..3 {
            let paint = (1.0 - inner) * f64::from(first[c]) + inner * f64::from(other[c]);
            let (g, p) = (f64::from(out.rgb[at][c]) / 255.0, paint / 255.0);
            let mixed = if cell.linear {
                srgb_from_linear((1.0 - a) * linear_from_srgb(g) + a * linear_from_srgb(p))
            } else {
                (1.0 - a) * g + a * p
            };
            let noise = cell.noise * random.gauss() * covered;
            out.rgb[at][c] = (mixed * 255.0 + noise).round().clamp(0.0, 255.0) as u8;
        }
    }
    (x0 as f64 + cx, y0 as f64 + cy)
}

/// Less light, and bluer: the sky lights a shadow.
fn dim(c: [u8; 3], light: f64) -> [u8; 3] {
    let tint = [1.0 - 0.1 * (1.0 - light), 1.0, 1.0 + 0.12 * (1.0 - light)];
    std::array::from_fn(|i| {
        let v = linear_from_srgb(f64::from(c[i]) / 255.0) * light * tint[i];
        (srgb_from_linear(v.min(1.0)) * 255.0).round().clamp(0.0, 255.0) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_stated_centre_is_the_centroid_of_what_is_drawn() {
        for (disc, angle) in [(false, 0.0), (false, 0.3), (false, std::f64::consts::FRAC_PI_4), (true, 0.0)] {
            let cell = Cell { disc, ..Cell::base() };
            for (cx, cy) in [(15.03, 15.41), (14.57, 15.26), (15.311, 14.879)] {
                let drawn = shares(&cell, 30, cx, cy, angle, 0.0);
                let sum: f64 = drawn.iter().sum();
                let mean = |at: fn(usize) -> usize| {
                    drawn.iter().enumerate().map(|(i, v)| v * (at(i) as f64 + 0.5)).sum::<f64>() / sum
                };
                let (x, y) = (mean(|i| i % 30), mean(|i| i / 30));
                assert!((x - cx).abs() < 0.01 && (y - cy).abs() < 0.01, "{disc} {angle}: {x} {y} for {cx} {cy}");
            }
        }
    }
}
