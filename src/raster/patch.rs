//! Copying a small window together.

use super::{Block, Patch, RasterInfo, RasterSource, Samples};
use crate::error::Result;
use crate::window::Window;

/// Reads `window` and copies it together.
///
/// # Errors
/// Those of [`RasterSource::read`].
pub fn read_patch(source: &dyn RasterSource, window: Window) -> Result<Patch> {
    Ok(source.read(window)?.to_patch(source.info()))
}

impl Block {
    /// The pixels in one array, red, green, blue as the file has them. Pixels without content (zero alpha, all colour
    /// bands at the nodata value) are marked as such and keep their values.
    pub fn to_patch(&self, info: &RasterInfo) -> Patch {
        let fill = info.fill_value();
        let (width, count) = (self.window.width as usize, self.window.area() as usize);
        let mut patch =
            Patch { window: self.window, rgb: vec![[fill; 3]; count], valid: vec![false; count], white: info.white };
        for piece in self.pieces.iter().filter(|piece| !piece.empty) {
            let (x, len) = (piece.window.x, piece.window.width);
            for y in piece.window.y..piece.window.bottom() {
                let first = (y - self.window.y) as usize * width + (x - self.window.x) as usize;
                let row = piece.row(x, y, len);
                let range = first..first + len as usize;
                let (rgb, valid) = (&mut patch.rgb[range.clone()], &mut patch.valid[range]);
                match row.samples {
                    Samples::U8(samples) => copy_row(samples, row.pixel_stride, info, rgb, valid),
                    Samples::U16(samples) => copy_row(samples, row.pixel_stride, info, rgb, valid),
                }
            }
        }
        patch
    }
}

fn copy_row<T: Copy + Into<u16>>(
    samples: &[T],
    stride: usize,
    info: &RasterInfo,
    rgb: &mut [[u16; 3]],
    valid: &mut [bool],
) {
    let nodata = info.nodata_sample();
    for (i, (rgb, valid)) in rgb.iter_mut().zip(valid).enumerate() {
        let pixel = &samples[i * stride..];
        *rgb = info.rgb.map(|band| pixel[band].into());
        let transparent = info.alpha.is_some_and(|band| pixel[band].into() == 0);
        *valid = !transparent && nodata.is_none_or(|value| *rgb != [value; 3]);
    }
}
