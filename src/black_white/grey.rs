//! Grey levels of a window and their halvings.
//!
//! Everything here is integer arithmetic on pixels in an order that the image fixes, not the tile: cell (X, Y) of level
//! k is the average of the pixels `[X·2ᵏ, (X+1)·2ᵏ) × [Y·2ᵏ, (Y+1)·2ᵏ)` of the image, whatever window they were read
//! in.

use autoref_raster::window::Window;
use autoref_raster::{Block, Patch, RasterInfo, Samples};

/// Grey bytes of a rectangle of cells of one level, in cell coordinates of the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plane {
    pub x: u64,
    pub y: u64,
    pub width: usize,
    pub height: usize,
    pub data: Vec<u8>,
}

/// Weights of ITU-R BT.601 in 256ths.
const LUMA: [u32; 3] = [77, 150, 29];

/// Grey of 16-bit samples on the scale of bytes, by the fixed rule of the colour path: `(255·v + white/2) / white`.
fn byte(colour: [u16; 3], white: u16) -> u8 {
    if white == 255 {
        // The rule leaves bytes as they are.
        return luma([colour[0].into(), colour[1].into(), colour[2].into()]);
    }
    luma(colour.map(|v| ((255 * u32::from(v) + u32::from(white) / 2) / u32::from(white)).min(255)))
}

#[inline(always)]
fn luma([red, green, blue]: [u32; 3]) -> u8 {
    ((red * LUMA[0] + green * LUMA[1] + blue * LUMA[2] + 128) >> 8) as u8
}

/// Grey on the scale of bytes, not rounded, for fits.
pub fn level(colour: [u16; 3], white: u16) -> f64 {
    const WEIGHTS: [f64; 3] = [LUMA[0] as f64, LUMA[1] as f64, LUMA[2] as f64];
    let sum = f64::from(colour[0]) * WEIGHTS[0] + f64::from(colour[1]) * WEIGHTS[1] + f64::from(colour[2]) * WEIGHTS[2];
    (sum * 255.0 / 256.0 / f64::from(white)).min(255.0)
}

/// Mean grey of the cell of `size` × `size` pixels, counted in cells from the patch's corner, on the scale of bytes,
/// for fits; `None` when a pixel of it is not there.
pub fn mean_of_cell(patch: &Patch, (u, v): (u64, u64), size: u64) -> Option<f64> {
    let mut sum = 0.0;
    for y in v * size..(v + 1) * size {
        for x in u * size..(u + 1) * size {
            let i = (y * patch.window.width + x) as usize;
            if !patch.valid[i] {
                return None;
            }
            sum += level(patch.rgb[i], patch.white);
        }
    }
    Some(sum / (size * size) as f64)
}

impl Plane {
    /// Level 0 of a block. What holds nothing (sparse block, nodata, zero alpha) is black.
    pub fn of_block(block: &Block, info: &RasterInfo) -> Plane {
        let window = block.window;
        let (width, height) = (window.width as usize, window.height as usize);
        let mut data = vec![0u8; width * height];
        for piece in block.pieces.iter().filter(|piece| !piece.empty) {
            let part = piece.window.intersect(&window);
            for y in part.y..part.bottom() {
                let first = (y - window.y) as usize * width + (part.x - window.x) as usize;
                let row = piece.row(part.x, y, part.width);
                let out = &mut data[first..first + part.width as usize];
                match row.samples {
                    Samples::U8(samples) => grey_row(samples, row.pixel_stride, info, out),
                    Samples::U16(samples) => grey_row(samples, row.pixel_stride, info, out),
                }
            }
        }
        Plane { x: window.x, y: window.y, width, height, data }
    }

    /// Level 0 of a part of a patch; `window` must lie in it.
    pub fn of_patch(patch: &Patch, window: Window) -> Plane {
        let (width, height) = (window.width as usize, window.height as usize);
        let mut data = Vec::with_capacity(width * height);
        for y in window.y..window.bottom() {
            let first = ((y - patch.window.y) * patch.window.width + window.x - patch.window.x) as usize;
            let pixels = patch.rgb[first..first + width].iter().zip(&patch.valid[first..first + width]);
            if patch.white == 255 {
                data.extend(
                    pixels.map(|(c, &valid)| if valid { luma([c[0].into(), c[1].into(), c[2].into()]) } else { 0 }),
                );
            } else {
                data.extend(pixels.map(|(c, &valid)| if valid { byte(*c, patch.white) } else { 0 }));
            }
        }
        Plane { x: window.x, y: window.y, width, height, data }
    }

    /// The next level: only cells all of whose four parts are here.
    pub fn halved(&self) -> Plane {
        let (x, y) = (self.x.div_ceil(2), self.y.div_ceil(2));
        let (skip_x, skip_y) = ((2 * x - self.x) as usize, (2 * y - self.y) as usize);
        let width = self.width.saturating_sub(skip_x) / 2;
        let height = self.height.saturating_sub(skip_y) / 2;
        let mut data = Vec::with_capacity(width * height);
        for row in 0..height {
            let at = (skip_y + 2 * row) * self.width + skip_x;
            let (upper, lower) = (&self.data[at..at + 2 * width], &self.data[at + self.width..][..2 * width]);
            data.extend(upper.chunks_exact(2).zip(lower.chunks_exact(2)).map(|(a, b)| {
                let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
                ((sum + 2) >> 2) as u8
            }));
        }
        Plane { x, y, width, height, data }
    }

    /// Values of a row, from the left.
    pub fn row(&self, row: usize) -> &[u8] {
        &self.data[row * self.width..(row + 1) * self.width]
    }
}

fn grey_row<T: Copy + Into<u16>>(samples: &[T], stride: usize, info: &RasterInfo, out: &mut [u8]) {
    let nodata = info.nodata_sample();
    for (i, out) in out.iter_mut().enumerate() {
        let pixel = &samples[i * stride..];
        let colour: [u16; 3] = info.rgb.map(|band| pixel[band].into());
        let clear = info.alpha.is_some_and(|band| pixel[band].into() == 0);
        *out = if clear || nodata.is_some_and(|n| colour == [n; 3]) { 0 } else { byte(colour, info.white) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_do_not_depend_on_the_window() {
        let pixel = |x: u64, y: u64| (x * 37 + y * 101 + x * y) as u8;
        let plane = |x0: u64, y0: u64, width: usize, height: usize| Plane {
            x: x0,
            y: y0,
            width,
            height,
            data: (0..width * height).map(|i| pixel(x0 + (i % width) as u64, y0 + (i / width) as u64)).collect(),
        };
        let whole = plane(0, 0, 41, 33).halved().halved();
        for (x0, y0) in [(0, 0), (1, 2), (3, 7), (6, 5)] {
            let part = plane(x0, y0, 25, 22).halved().halved();
            assert!(part.width >= 4 && part.height >= 4);
            for (row, column) in (0..part.height).flat_map(|r| (0..part.width).map(move |c| (r, c))) {
                let (x, y) = (part.x as usize + column, part.y as usize + row);
                assert_eq!(part.row(row)[column], whole.row(y)[x]);
            }
        }
    }

    #[test]
    fn grey_of_wide_samples_follows_the_fixed_rule() {
        assert_eq!(byte([4095; 3], 4095), 255);
        assert_eq!(byte([100, 100, 100], 255), 100);
        assert!((level([65_535; 3], 65_535) - 255.0).abs() < 1e-9);
    }
}
