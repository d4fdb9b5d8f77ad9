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

/// Pixels of a window that are copied together only as far as they are asked for: most regions are no marks, which
/// their nearest surroundings show.
pub trait Pixels {
    /// All there are.
    fn window(&self) -> Window;
    /// Those inside `window`, clipped to what there is.
    fn part(&self, window: &Window) -> Patch;
    /// All of them.
    fn whole(&self) -> Patch {
        self.part(&self.window())
    }
}

impl Pixels for Patch {
    fn window(&self) -> Window {
        self.window
    }
    fn part(&self, window: &Window) -> Patch {
        self.crop(window)
    }
}

/// A window of a block, which must hold it.
#[derive(Clone, Copy)]
pub struct View<'a> {
    pub block: &'a Block,
    pub window: Window,
    pub info: &'a RasterInfo,
}

impl Pixels for View<'_> {
    fn window(&self) -> Window {
        self.window
    }
    fn part(&self, window: &Window) -> Patch {
        self.block.patch(window.intersect(&self.window), self.info)
    }
}

impl Block {
    /// The pixels in one array, red, green, blue as the file has them. Pixels without content (zero alpha, all colour
    /// bands at the nodata value) are marked as such and keep their values.
    pub fn to_patch(&self, info: &RasterInfo) -> Patch {
        self.patch(self.window, info)
    }

    /// The same of a part of the block; `window` must lie in it.
    pub fn patch(&self, window: Window, info: &RasterInfo) -> Patch {
        debug_assert!(self.window.contains_window(&window));
        let fill = info.fill_value();
        let (width, count) = (window.width as usize, window.area() as usize);
        let mut patch = Patch { window, rgb: vec![[fill; 3]; count], valid: vec![false; count], white: info.white };
        for piece in self.pieces.iter().filter(|piece| !piece.empty) {
            let part = piece.window.intersect(&window);
            let (x, len) = (part.x, part.width);
            if part.is_empty() {
                continue;
            }
            for y in part.y..part.bottom() {
                let first = (y - window.y) as usize * width + (x - window.x) as usize;
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
    if info.alpha.is_none() && nodata.is_none() {
        let [r, g, b] = info.rgb;
        if (stride, info.rgb) == (3, [0, 1, 2]) {
            rgb.as_flattened_mut().iter_mut().zip(samples).for_each(|(to, from)| *to = (*from).into());
        } else {
            for (rgb, pixel) in rgb.iter_mut().zip(samples.chunks(stride)) {
                *rgb = [pixel[r].into(), pixel[g].into(), pixel[b].into()];
            }
        }
        valid.fill(true);
        return;
    }
    for (i, (rgb, valid)) in rgb.iter_mut().zip(valid).enumerate() {
        let pixel = &samples[i * stride..];
        *rgb = info.rgb.map(|band| pixel[band].into());
        let transparent = info.alpha.is_some_and(|band| pixel[band].into() == 0);
        *valid = !transparent && nodata.is_none_or(|value| *rgb != [value; 3]);
    }
}
