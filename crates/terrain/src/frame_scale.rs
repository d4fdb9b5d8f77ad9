//! What a frame's windows measure, and the scale of the whole frame.

use autoref_raster::error::Result;
use autoref_raster::window::Window;
use rayon::prelude::*;

use crate::features::{FrameScale, HALO_PX, Measured, Surroundings, Tally, measure};
use crate::plane::Plane;
use crate::reduce::Reduced;

/// Side of the windows in which features are computed, px at the reduced scale.
pub const CORE_PX: u64 = 256;

/// Features of the pixels of `window`, `margin` more on every side, mirrored at the frame's border.
///
/// # Errors
/// When the plane cannot be read.
pub fn measured(plane: &Plane, window: &Window, margin: usize) -> Result<(Measured, Vec<u8>)> {
    let around = HALO_PX + margin;
    let (w, h) = (window.width as usize + 2 * around, window.height as usize + 2 * around);
    let pixels = plane.mirrored(window.x as i64 - around as i64, window.y as i64 - around as i64, w, h)?;
    let inner = (HALO_PX..h - HALO_PX).flat_map(|y| &pixels[y * w + HALO_PX..(y + 1) * w - HALO_PX]).copied().collect();
    Ok((measure(&Surroundings { pixels, width: w, height: h }), inner))
}

/// The scale of a frame, from windows of 64 px that are spread over it, the same for every tiling.
///
/// # Errors
/// When the plane cannot be read.
pub fn frame_scale(reduced: &Reduced) -> Result<FrameScale> {
    let (width, height) = (reduced.grey.width() as u64, reduced.grey.height() as u64);
    let (w, h) = (width.min(64), height.min(64));
    let places = |length: u64, side: u64| -> Vec<u64> {
        let count = length.div_ceil(side).min(14);
        (0..count).map(|i| if count == 1 { 0 } else { (length - side) * i / (count - 1) }).collect()
    };
    let rows = places(height, h);
    let windows: Vec<Window> =
        rows.iter().flat_map(|&y| places(width, w).into_iter().map(move |x| Window::new(x, y, w, h))).collect();
    let mut tally = Tally::default();
    for some in windows.chunks(2 * rayon::current_num_threads()) {
        let done: Vec<Result<_>> = some.par_iter().map(|window| measured(&reduced.grey, window, 0)).collect();
        for one in done {
            let (measured, grey) = one?;
            tally.add(&measured, &grey);
        }
    }
    Ok(tally.scale())
}
