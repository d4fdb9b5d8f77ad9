//! The reference kernel.

use std::ops::Range;

use super::Bounds;

/// Bits of the pixels in `range`, which starts at a multiple of 64; the words from there on are overwritten.
pub fn prefilter(
    samples: &[u8],
    stride: usize,
    rgb: [usize; 3],
    range: Range<usize>,
    bounds: &Bounds,
    bits: &mut [u64],
) {
    debug_assert!(range.start.is_multiple_of(64));
    for (word, first) in bits[range.start / 64..].iter_mut().zip(range.clone().step_by(64)) {
        *word = 0;
        for i in first..(first + 64).min(range.end) {
            let pixel = &samples[i * stride..];
            let colour = rgb.map(|b| pixel[b]);
            *word |= u64::from(bounds.passes(colour)) << (i - first);
        }
    }
}
