//! Connected regions of a mask.

use crate::window::Window;

/// An 8-connected set of foreground pixels, described by integers only, so that merging is exact in any order.
///
/// Sums are over pixel indices (column, row) of the image, not centres: the centroid is `sum / area + 0.5`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Row and column of the first pixel in raster order: the region's identity, whatever the tiling.
    pub first: (u64, u64),
    pub bounds: Window,
    pub area: u64,
    pub sum_x: u128,
    pub sum_y: u128,
    pub sum_xx: u128,
    pub sum_xy: u128,
    pub sum_yy: u128,
    /// Pixel sides between foreground and background (or the raster's edge): the crack length of outline and holes.
    pub perimeter: u64,
}
