//! Even light before pixels are told apart: where a correction of another crate is hooked in, and the thesis's own.
//!
//! Source: the 2017 thesis, equations 10.1–10.3: g = f ∗ box(w/4), then g ∗ box(w/(4·2ⁿ)) until the box is smaller than
//! w/500, w the image's width. As printed the result is added to the image, which doubles the fall of the light; its
//! complement is meant: f + (mean(g) − g). Where we settle: boxes are clipped at the border, empty pixels take no part,
//! and g is computed on cells of whole pixels, at most 512 along a side, and interpolated between their centres, so
//! that a large orthophoto needs no plane of floating-point numbers.

use std::fmt;
use std::sync::Arc;

use autoref_raster::RasterSource;
use autoref_raster::error::Result;
use autoref_raster::window::Window;

use crate::reduce::Reduced;

/// Changes the grey levels of a reduced frame; the source is there for what only the whole scan tells.
type Change = dyn Fn(&dyn RasterSource, &mut Reduced) -> Result<()> + Send + Sync;

/// A correction of light or bands with a name for fingerprints.
#[derive(Clone)]
pub struct Correction {
    pub name: String,
    pub change: Arc<Change>,
}

impl fmt::Debug for Correction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// Cells along the longer side at most.
const CELLS: usize = 512;

/// Means of cells of a reduced frame.
struct Cells {
    step: usize,
    width: usize,
    height: usize,
    values: Vec<f64>,
    weights: Vec<f64>,
}

/// The thesis's correction of light.
///
/// # Errors
/// When a scratch file fails.
pub fn thesis_2017(reduced: &mut Reduced) -> Result<()> {
    let mut cells = cells(reduced)?;
    let width = reduced.grey.width() as f64;
    let mut side = width / 4.0;
    while side >= width / 500.0 && side >= 1.0 {
        cells.blur(side);
        side /= 2.0;
    }
    let total: f64 = cells.weights.iter().sum();
    if total == 0.0 {
        return Ok(());
    }
    let mean = cells.values.iter().zip(&cells.weights).map(|(v, w)| v * w).sum::<f64>() / total;
    change_levels(reduced, |x, y, level| level + mean - cells.at(x, y))
}

/// Gives every pixel the level that `level(x, y, level)` says, rounded to 0…255.
///
/// # Errors
/// When a scratch file fails.
pub fn change_levels(reduced: &mut Reduced, level: impl Fn(usize, usize, f64) -> f64) -> Result<()> {
    let width = reduced.grey.width();
    for y in 0..reduced.grey.height() {
        let row = Window::new(0, y as u64, width as u64, 1);
        let mut pixels = reduced.grey.read(&row)?;
        for (x, value) in pixels.iter_mut().enumerate() {
            *value = level(x, y, f64::from(*value)).round().clamp(0.0, 255.0) as u8;
        }
        reduced.grey.write(&row, &pixels)?;
    }
    Ok(())
}

fn cells(reduced: &Reduced) -> Result<Cells> {
    let (w, h) = (reduced.grey.width(), reduced.grey.height());
    let step = w.max(h).div_ceil(CELLS).max(1);
    let (width, height) = (w.div_ceil(step), h.div_ceil(step));
    let (mut sums, mut counts) = (vec![0u64; width * height], vec![0u64; width * height]);
    for y in 0..h {
        let row = reduced.grey.read(&Window::new(0, y as u64, w as u64, 1))?;
        for (x, &value) in row.iter().enumerate().filter(|(x, _)| reduced.valid.get(*x, y)) {
            let i = y / step * width + x / step;
            sums[i] += u64::from(value);
            counts[i] += 1;
        }
    }
    let values = sums.iter().zip(&counts).map(|(s, n)| *s as f64 / (*n).max(1) as f64).collect();
    Ok(Cells { step, width, height, values, weights: counts.into_iter().map(|n| n as f64).collect() })
}

impl Cells {
    /// Mean over boxes of `side` pixels, weighted with the pixels that hold something, clipped at the border.
    fn blur(&mut self, side: f64) {
        let r = (side / self.step as f64 / 2.0).floor() as usize;
        if r == 0 {
            return;
        }
        let product: Vec<f64> = self.values.iter().zip(&self.weights).map(|(v, w)| v * w).collect();
        let (sums, weights) = (self.boxes(&product, r), self.boxes(&self.weights, r));
        self.values = sums.iter().zip(&weights).map(|(s, w)| if *w > 0.0 { s / w } else { 0.0 }).collect();
    }

    fn boxes(&self, values: &[f64], r: usize) -> Vec<f64> {
        let (w, h) = (self.width, self.height);
        let line = |length: usize, at: &dyn Fn(usize) -> f64, put: &mut dyn FnMut(usize, f64)| {
            let mut before = vec![0.0; length + 1];
            (0..length).for_each(|i| before[i + 1] = before[i] + at(i));
            (0..length).for_each(|i| put(i, before[(i + r + 1).min(length)] - before[i.saturating_sub(r)]));
        };
        let mut across = vec![0.0; w * h];
        for y in 0..h {
            line(w, &|x| values[y * w + x], &mut |x, sum| across[y * w + x] = sum);
        }
        let mut out = vec![0.0; w * h];
        for x in 0..w {
            line(h, &|y| across[y * w + x], &mut |y, sum| out[y * w + x] = sum);
        }
        out
    }

    /// Interpolated between the centres of the cells.
    fn at(&self, x: usize, y: usize) -> f64 {
        let place = |v: usize, n: usize| {
            let at = ((v as f64 + 0.5) / self.step as f64 - 0.5).clamp(0.0, (n - 1) as f64);
            (at as usize, (at as usize + 1).min(n - 1), at.fract())
        };
        let ((x0, x1, fx), (y0, y1, fy)) = (place(x, self.width), place(y, self.height));
        let row = |y: usize| self.values[y * self.width + x0] * (1.0 - fx) + self.values[y * self.width + x1] * fx;
        row(y0) * (1.0 - fy) + row(y1) * fy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bits::BitMask;
    use crate::plane::Plane;

    fn reduced(width: usize, height: usize, level: impl Fn(usize, usize) -> u8) -> Reduced {
        let pixels: Vec<u8> = (0..width * height).map(|i| level(i % width, i / width)).collect();
        let mut grey = Plane::new(width, height, 1 << 20).expect("a plane");
        grey.write(&Window::whole(width as u64, height as u64), &pixels).expect("written");
        let valid = BitMask::from_fn(width, height, |_, _| true);
        Reduced {
            grey,
            valid,
            width: width as u64,
            height: height as u64,
            factor: 1,
            white_steps: 255.0,
            smooth: false,
        }
    }

    #[test]
    fn a_slope_of_light_is_evened_and_texture_stays() {
        let texture = |x: usize, y: usize| ((x * 7 + y * 13) % 11) as f64 * 3.0;
        let mut image = reduced(600, 400, |x, y| (40.0 + 0.2 * x as f64 + texture(x, y)) as u8);
        thesis_2017(&mut image).expect("evened");
        let mean = |x: u64| {
            let pixels = image.grey.read(&Window::new(x, 150, 55, 55)).expect("read");
            pixels.iter().map(|v| f64::from(*v)).sum::<f64>() / pixels.len() as f64
        };
        let (left, right) = (mean(150), mean(400));
        assert!((left - right).abs() < 5.0, "{left} {right}");
        let row = image.grey.read(&Window::new(300, 200, 22, 1)).expect("read");
        let (low, high) = (row.iter().min().expect("pixels"), row.iter().max().expect("pixels"));
        assert!(high - low > 25, "{low} {high}");
    }

    #[test]
    fn an_even_image_stays_as_it_is() {
        let mut image = reduced(700, 30, |_, _| 90);
        thesis_2017(&mut image).expect("evened");
        let all = image.grey.read(&Window::whole(700, 30)).expect("read");
        assert!(all.iter().all(|v| *v == 90));
    }
}
