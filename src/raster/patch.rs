//! Small windows copied together, for everything that looks at one mark at a time.

use crate::raster::{Block, Patch, RasterInfo, Samples};
use crate::window::Window;

impl Block {
    /// Copies the pixels of `window`, which must lie in the block: red, green and blue as `info` names them, and
    /// whether the pixel holds anything (nodata in all colour bands or zero alpha mean no).
    pub fn patch(&self, window: Window, info: &RasterInfo) -> Patch {
        debug_assert!(self.window.contains_window(&window));
        let mut patch = Patch {
            window,
            rgb: vec![[0; 3]; window.area() as usize],
            valid: vec![false; window.area() as usize],
            white: info.white,
        };
        for piece in &self.pieces {
            let part = piece.window.intersect(&window);
            if part.is_empty() {
                continue;
            }
            for y in part.y..part.bottom() {
                let start = ((y - window.y) * window.width + (part.x - window.x)) as usize;
                let (rgb, valid) = (&mut patch.rgb[start..], &mut patch.valid[start..]);
                if piece.empty {
                    empty_row(info, &mut rgb[..part.width as usize], &mut valid[..part.width as usize]);
                    continue;
                }
                let row = piece.row(part.x, y, part.width);
                for i in 0..row.len {
                    let at = i * row.pixel_stride;
                    let sample = |band: usize| match row.samples {
                        Samples::U8(samples) => u16::from(samples[at + band]),
                        Samples::U16(samples) => samples[at + band],
                    };
                    rgb[i] = info.rgb.map(sample);
                    valid[i] = holds_something(info, rgb[i], info.alpha.map(sample));
                }
            }
        }
        patch
    }
}

/// Whether a pixel of these samples is more than nodata or full transparency.
pub fn holds_something(info: &RasterInfo, rgb: [u16; 3], alpha: Option<u16>) -> bool {
    alpha != Some(0) && info.nodata.is_none_or(|nodata| rgb.iter().any(|&v| f64::from(v) != nodata))
}

/// What a block that is absent from the file reads as: the nodata value, or zero.
fn empty_row(info: &RasterInfo, rgb: &mut [[u16; 3]], valid: &mut [bool]) {
    let value = info.nodata.filter(|v| (0.0..=65535.0).contains(v)).map_or(0, |v| v as u16);
    rgb.fill([value; 3]);
    valid.fill(holds_something(info, [value; 3], info.alpha.map(|_| 0)));
}
