//! Cleaning a mask of pixels that were classified one by one.

use crate::area::flip_small;
use crate::bits::{Bit, BitMask};
use crate::morphology::{Kernel, close, dilate, erode};

/// Sizes of the thesis's cleaning, at the reduced scale.
///
/// Source: the 2017 thesis, equations 10.6–10.8, as listed in `docs/masks.md`.
#[derive(Clone, Debug, PartialEq)]
pub struct Cleaning {
    /// Closings one after another, px.
    pub closings: Vec<usize>,
    /// The dilation, the two erosions and the last dilation, px.
    pub disc: usize,
    pub erosions: usize,
    /// Areas under this share of the image change class.
    pub least_area_share: f64,
}

impl Default for Cleaning {
    fn default() -> Self {
        Cleaning { closings: (1..=10).map(|i| 3 * i).collect(), disc: 15, erosions: 2, least_area_share: 0.02 }
    }
}

/// Closings, dilation, small background to foreground, erosions, small foreground to background, dilation.
pub fn clean(mut mask: BitMask, options: &Cleaning) -> BitMask {
    for &size in &options.closings {
        mask = close(mask, &Kernel::ellipse(size));
    }
    let disc = Kernel::ellipse(options.disc);
    mask = dilate(&mask, &disc);
    flip_small(&mut mask, Bit::Clear, options.least_area_share);
    for _ in 0..options.erosions {
        mask = erode(mask, &disc);
    }
    flip_small(&mut mask, Bit::Set, options.least_area_share);
    dilate(&mask, &disc)
}
