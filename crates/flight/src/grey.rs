//! Frames in grey, as features are sought in them: their contrast even, and neighbours warped onto each other.

use autoref_raster::bilinear::by_weights;
use nalgebra::Matrix3;

use crate::ground_plane::mapped;

/// Contrast is made even over squares of this size to each side.
const CONTRAST_PX: usize = 40;
/// The standard deviation of grey values that it is made even to, and what is added to the one found: noise stays
/// small.
const CONTRAST: f32 = 45.0;
const LEAST_CONTRAST: f32 = 2.0;

/// How a frame is laid out in grey: at most so wide or high.
#[derive(Clone, Copy)]
pub struct Layout {
    /// Pixels of this.
    pub width: usize,
    /// Likewise.
    pub height: usize,
    /// Pixels of this per pixel of the frame, along its rows and its columns: both sizes are whole, so that the two
    /// differ a little.
    pub scale: [f64; 2],
}

/// A frame in grey.
pub struct Grey {
    /// Its size, and how it lies over the frame.
    pub layout: Layout,
    pixels: Vec<u8>,
}

impl Layout {
    /// Of a frame of this size (pixels), at most `largest_px` wide or high.
    pub fn of((w, h): (usize, usize), largest_px: usize) -> Self {
        let scale = (largest_px as f64 / w.max(h).max(1) as f64).min(1.0);
        let [width, height] = [w, h].map(|s| ((s as f64 * scale).round() as usize).max(1));
        Layout { width, height, scale: [width as f64 / w.max(1) as f64, height as f64 / h.max(1) as f64] }
    }

    /// As the frame is.
    pub fn whole((width, height): (usize, usize)) -> Self {
        Layout { width, height, scale: [1.0; 2] }
    }

    /// From a place in this (pixels) to the one in the frame.
    pub fn to_frame(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x / self.scale[0], y / self.scale[1]]
    }

    /// From a place in the frame (pixels) to the one in this.
    pub fn of_frame(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [x * self.scale[0], y * self.scale[1]]
    }
}

impl Grey {
    /// Of grey values row by row.
    pub fn new(layout: Layout, pixels: Vec<u8>) -> Self {
        Grey { layout, pixels }
    }

    /// Row by row.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Means over squares, at most `longest_px` wide or high.
    pub fn smaller(&self, longest_px: usize) -> Grey {
        let Layout { width, height, scale } = self.layout;
        let ratio = (longest_px as f64 / width.max(height) as f64).min(1.0);
        let [to_width, to_height] = [width, height].map(|s| ((s as f64 * ratio).round() as usize).max(1));
        let span = |k: usize, from: usize, to: usize| (k * from / to, ((k + 1) * from / to).max(k * from / to + 1));
        let mean = |k: usize| {
            let (left, right) = span(k % to_width, width, to_width);
            let (top, bottom) = span(k / to_width, height, to_height);
            let rows = (top..bottom).map(|y| &self.pixels[y * width + left..y * width + right]);
            let sum: u64 = rows.flatten().map(|v| u64::from(*v)).sum();
            (sum / ((right - left) * (bottom - top)) as u64) as u8
        };
        let [across, down] = [to_width as f64 / width as f64, to_height as f64 / height as f64];
        let layout = Layout { width: to_width, height: to_height, scale: [scale[0] * across, scale[1] * down] };
        Grey { layout, pixels: (0..to_width * to_height).map(mean).collect() }
    }

    /// Bilinear, at pixels of this image; `None` outside.
    fn at(&self, [x, y]: [f64; 2]) -> Option<f32> {
        let (x, y) = (x - 0.5, y - 0.5);
        let Layout { width, height, .. } = self.layout;
        if !(x >= 0.0 && y >= 0.0 && x <= (width - 1) as f64 && y <= (height - 1) as f64) {
            return None;
        }
        let (i, j) = ((x as usize).min(width.saturating_sub(2)), (y as usize).min(height.saturating_sub(2)));
        let (a, b) = ((x - i as f64) as f32, (y - j as f64) as f32);
        let p = |i: usize, j: usize| f32::from(self.pixels[j.min(height - 1) * width + i.min(width - 1)]);
        let row = |j: usize| [p(i, j), p(i + 1, j)];
        Some(by_weights([row(j), row(j + 1)], [a, b]))
    }

    /// This frame as the one that `to` lays out would show the ground, `to_this` taking its pixels here; and the share
    /// of it that is seen.
    pub fn warped(&self, to: Layout, to_this: &Matrix3<f64>) -> (Grey, f64) {
        let mut pixels = vec![0u8; to.width * to.height];
        let mut seen = 0usize;
        for (k, grey) in pixels.iter_mut().enumerate() {
            let at = to.to_frame([k % to.width, k / to.width].map(|v| v as f64 + 0.5));
            if let Some(value) = mapped(to_this, at).and_then(|place| self.at(self.layout.of_frame(place))) {
                *grey = value.round() as u8;
                seen += 1;
            }
        }
        let share = seen as f64 / pixels.len() as f64;
        (Grey { layout: to, pixels }, share)
    }
}

/// Grey values with the mean and the standard deviation of the square around each made the same everywhere.
pub fn even_contrast(pixels: &[u8], width: usize, height: usize) -> Vec<u8> {
    // Sums over all pixels above and to the left: 3200² · 255² fits 64 bits.
    let mut sums = vec![[0u64; 2]; (width + 1) * (height + 1)];
    for y in 0..height {
        let mut row = [0u64; 2];
        for x in 0..width {
            let v = u64::from(pixels[y * width + x]);
            row = [row[0] + v, row[1] + v * v];
            let above = sums[y * (width + 1) + x + 1];
            sums[(y + 1) * (width + 1) + x + 1] = [above[0] + row[0], above[1] + row[1]];
        }
    }
    let even = |k: usize| {
        let (x, y) = (k % width, k / width);
        let (left, top) = (x.saturating_sub(CONTRAST_PX), y.saturating_sub(CONTRAST_PX));
        let (right, bottom) = ((x + CONTRAST_PX + 1).min(width), (y + CONTRAST_PX + 1).min(height));
        let corner = |x: usize, y: usize| sums[y * (width + 1) + x];
        let sum = |c: usize| {
            let inside =
                corner(right, bottom)[c] + corner(left, top)[c] - corner(right, top)[c] - corner(left, bottom)[c];
            inside as f64 / ((right - left) * (bottom - top)) as f64
        };
        let mean = sum(0);
        let deviation = (sum(1) - mean * mean).max(0.0).sqrt() as f32;
        let value = 128.0 + CONTRAST * (f32::from(pixels[k]) - mean as f32) / (deviation + LEAST_CONTRAST);
        value.round().clamp(0.0, 255.0) as u8
    };
    (0..pixels.len()).map(even).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_of_a_smaller_frame_are_those_of_the_frame() {
        // 3648 rows come to 2133, not to 2133.3.
        let layout = Layout::of((5472, 3648), 3200);
        let far = layout.to_frame([layout.width as f64, layout.height as f64]);
        assert!((far[0] - 5472.0).abs() < 1e-9 && (far[1] - 3648.0).abs() < 1e-9, "{far:?}");
        let pixels = vec![0; layout.width * layout.height];
        let smaller = Grey::new(layout, pixels).smaller(500).layout;
        let far = smaller.of_frame([5472.0, 3648.0]);
        assert!(
            (far[0] - smaller.width as f64).abs() < 1e-9 && (far[1] - smaller.height as f64).abs() < 1e-9,
            "{far:?}"
        );
    }

    #[test]
    fn contrast_is_even_where_the_light_is_not() {
        let (width, height) = (300, 120);
        // The same pattern, in half the light and half the contrast to the right.
        let value = |x: usize, y: usize| {
            let light = if x < 150 { 1.0 } else { 0.5 };
            (light * (120.0 + 40.0 * ((x * 7 + y * 13) as f64 * 0.3).sin())) as u8
        };
        let pixels: Vec<u8> = (0..width * height).map(|k| value(k % width, k / width)).collect();
        let even = even_contrast(&pixels, width, height);
        let deviation = |from: usize| {
            let part: Vec<f64> = (0..height)
                .flat_map(|y| (from..from + 60).map(move |x| (x, y)))
                .map(|(x, y)| f64::from(even[y * width + x]))
                .collect();
            let mean = part.iter().sum::<f64>() / part.len() as f64;
            (part.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / part.len() as f64).sqrt()
        };
        let (left, right) = (deviation(20), deviation(220));
        assert!((left / right - 1.0).abs() < 0.1, "{left} {right}");
    }
}
