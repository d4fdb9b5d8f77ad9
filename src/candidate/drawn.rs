//! Drawn patches for the tests of this room.

use autoref_raster::Patch;
use autoref_raster::window::Window;

use super::pixel_set::PixelSet;

pub(super) const SIDE: usize = 48;

/// A patch of [`SIDE`] × [`SIDE`] pixels, each of the colour that its number has.
pub(super) fn patch_of(colour: impl Fn(usize) -> [f64; 3]) -> Patch {
    let rgb = (0..SIDE * SIDE).map(|i| colour(i).map(|v| v.round() as u16)).collect();
    Patch { window: Window::new(0, 0, SIDE as u64, SIDE as u64), rgb, valid: vec![true; SIDE * SIDE], white: 255 }
}

/// Colour of orange paint, or of grey ground with a grain that the pixel's number decides.
pub(super) fn colour(i: usize, is_paint: bool) -> [f64; 3] {
    let grain = ((i * 7919) % 5) as f64 - 2.0;
    if is_paint { [250.0, 100.0, 10.0] } else { [110.0 + grain, 105.0 - grain, 95.0 + grain] }
}

/// A square of paint of 12 px about the middle, each pixel through `light`.
pub(super) fn patch(light: impl Fn(f64, f64) -> f64) -> Patch {
    patch_of(|i| {
        let (x, y) = ((i % SIDE) as f64 + 0.5, (i / SIDE) as f64 + 0.5);
        colour(i, (x - 24.0).abs() < 6.0 && (y - 24.0).abs() < 6.0).map(|v| v * light(x, y))
    })
}

/// The pixels of some columns and rows.
pub(super) fn inside(x: std::ops::Range<usize>, y: std::ops::Range<usize>) -> PixelSet {
    PixelSet::from_fn(SIDE, SIDE, |i| x.contains(&(i % SIDE)) && y.contains(&(i / SIDE)))
}
