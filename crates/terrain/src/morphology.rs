//! Dilation, erosion and closing of masks with OpenCV's ellipses.
//!
//! A kernel row is one run of pixels; a mask's row is smeared along such a run by shifts of whole words, doubling, and
//! the smeared rows are united. What lies outside the mask takes no part (OpenCV's default border). Results equal
//! `cv2.dilate`, `cv2.erode` and `cv2.morphologyEx(…, MORPH_CLOSE)` with
//! `cv2.getStructuringElement(MORPH_ELLIPSE, (k, k))` bit for bit, even k included: their anchor is k/2, and the kernel
//! is not turned between the two halves of a closing, so that an even closing shifts as OpenCV's does.

use rayon::prelude::*;

use crate::bits::{BitMask, last_word};

/// The rows of a structuring element: columns `first..end` relative to the anchor, for each row relative to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Kernel {
    rows: Vec<(i64, i64, i64)>,
}

impl Kernel {
    /// OpenCV's `MORPH_ELLIPSE` of `size` × `size`, anchor at size/2.
    pub fn ellipse(size: usize) -> Kernel {
        let r = (size / 2) as i64;
        let inverse = if r == 0 { 0.0 } else { 1.0 / (r * r) as f64 };
        let row = |i: i64| {
            let dy = i - r;
            // OpenCV rounds half to even.
            let dx = (r as f64 * (((r * r - dy * dy) as f64) * inverse).sqrt()).round_ties_even() as i64;
            (dy, (r - dx).max(0) - r, (r + dx + 1).min(size as i64) - r)
        };
        Kernel { rows: (0..size as i64).map(row).filter(|(_, first, end)| first < end).collect() }
    }

    /// Is the element set at this offset from the anchor?
    pub fn contains(&self, dx: i64, dy: i64) -> bool {
        self.rows.iter().any(|&(y, first, end)| y == dy && (first..end).contains(&dx))
    }

    /// How far it reaches from the anchor, px.
    pub fn reach(&self) -> usize {
        self.rows.iter().flat_map(|&(y, a, b)| [y.abs(), a.abs(), (b - 1).abs()]).max().unwrap_or(0) as usize
    }
}

/// Pixels whose kernel meets the mask.
pub fn dilate(mask: &BitMask, kernel: &Kernel) -> BitMask {
    let mut out = BitMask::new(mask.width(), mask.height());
    let words = mask.width().div_ceil(64);
    if words == 0 || mask.height() == 0 {
        return out;
    }
    let rows: Vec<&mut [u64]> = (out_rows(&mut out, words)).collect();
    rows.into_par_iter().enumerate().with_min_len(16).for_each_init(
        || (vec![0u64; words], vec![0u64; words]),
        |(smeared, scratch), (y, out)| {
            for &(dy, first, end) in &kernel.rows {
                let from = y as i64 + dy;
                if (0..mask.height() as i64).contains(&from) {
                    smear(mask.row(from as usize), first, end, smeared, scratch);
                    out.iter_mut().zip(smeared.iter()).for_each(|(a, b)| *a |= b);
                }
            }
            if let Some(word) = out.last_mut() {
                *word &= last_word(mask.width());
            }
        },
    );
    out
}

fn out_rows(mask: &mut BitMask, words: usize) -> impl Iterator<Item = &mut [u64]> {
    mask.words_mut().chunks_exact_mut(words)
}

/// Pixels whose kernel lies in the mask wherever it lies in the image. The mask is used up: no more than two are held.
pub fn erode(mut mask: BitMask, kernel: &Kernel) -> BitMask {
    mask.invert();
    let mut out = dilate(&mask, kernel);
    out.invert();
    out
}

/// A dilation, then an erosion with the same kernel.
pub fn close(mask: BitMask, kernel: &Kernel) -> BitMask {
    let dilated = dilate(&mask, kernel);
    drop(mask);
    erode(dilated, kernel)
}

/// `out[x]` = any of `row[x + first .. x + end]`; the run holds the anchor's column, as every ellipse's does.
fn smear(row: &[u64], first: i64, end: i64, out: &mut [u64], scratch: &mut [u64]) {
    debug_assert!(first <= 0 && end > 0);
    out.copy_from_slice(row);
    // Towards lower x, then towards higher x: each by doubling, and neither loses a pixel at the row's ends.
    for (shift, reach) in [(shift_down as fn(&[u64], usize, &mut [u64]), end - 1), (shift_up, -first)] {
        let mut have = 1;
        while have < reach as usize + 1 {
            let step = have.min(reach as usize + 1 - have);
            shift(out, step, scratch);
            out.iter_mut().zip(scratch.iter()).for_each(|(a, b)| *a |= b);
            have += step;
        }
    }
}

/// `out[x] = row[x + by]`.
fn shift_down(row: &[u64], by: usize, out: &mut [u64]) {
    let (words, bits) = (by / 64, by % 64);
    for (i, value) in out.iter_mut().enumerate() {
        let low = row.get(i + words).copied().unwrap_or(0);
        let high = row.get(i + words + 1).copied().unwrap_or(0);
        *value = if bits == 0 { low } else { low >> bits | high << (64 - bits) };
    }
}

/// `out[x] = row[x - by]`.
fn shift_up(row: &[u64], by: usize, out: &mut [u64]) {
    let (words, bits) = (by / 64, by % 64);
    for (i, value) in out.iter_mut().enumerate() {
        let high = i.checked_sub(words).map_or(0, |i| row[i]);
        let low = i.checked_sub(words + 1).map_or(0, |i| row[i]);
        *value = if bits == 0 { high } else { high << bits | low >> (64 - bits) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::xorshift;
    use proptest::prelude::*;

    fn by_definition(mask: &BitMask, kernel: &Kernel, any: bool) -> BitMask {
        let (width, height, reach) = (mask.width() as i64, mask.height() as i64, kernel.reach() as i64);
        BitMask::from_fn(mask.width(), mask.height(), |x, y| {
            let mut inside = (-reach..=reach)
                .flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy)))
                .filter(|&(dx, dy)| kernel.contains(dx, dy))
                .map(|(dx, dy)| (x as i64 + dx, y as i64 + dy))
                .filter(|&(x, y)| (0..width).contains(&x) && (0..height).contains(&y));
            if any {
                inside.any(|(x, y)| mask.get(x as usize, y as usize))
            } else {
                inside.all(|(x, y)| mask.get(x as usize, y as usize))
            }
        })
    }

    #[test]
    fn a_closing_fills_a_hole_and_leaves_the_outline() {
        let square = |x: usize, y: usize| (8..20).contains(&x) && (8..20).contains(&y);
        let whole = BitMask::from_fn(28, 28, square);
        let pierced = BitMask::from_fn(28, 28, |x, y| square(x, y) && (x, y) != (13, 14));
        assert!(close(pierced, &Kernel::ellipse(3)) == whole);
    }

    /// What `cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (k, k))` prints.
    #[test]
    fn ellipses_are_opencvs() {
        let rows = |size: i64| -> Vec<String> {
            let kernel = Kernel::ellipse(size as usize);
            let half = size / 2;
            let bit = |x, y| if kernel.contains(x - half, y - half) { '1' } else { '0' };
            (0..size).map(|y| (0..size).map(|x| bit(x, y)).collect()).collect()
        };
        assert_eq!(rows(3), ["010", "111", "010"]);
        assert_eq!(rows(5), ["00100", "11111", "11111", "11111", "00100"]);
        assert_eq!(rows(6), ["000100", "011111", "111111", "111111", "111111", "011111"]);
        assert_eq!(rows(1), ["1"]);
    }

    proptest! {
        #[test]
        fn both_are_their_definitions(
            width in 1usize..150, height in 1usize..24, size in 1usize..16, seed in any::<u64>(), share in 1u64..16,
        ) {
            let mut state = seed | 1;
            let mask = BitMask::from_fn(width, height, |_, _| xorshift(&mut state) % 16 < share);
            let kernel = Kernel::ellipse(size);
            prop_assert_eq!(dilate(&mask, &kernel), by_definition(&mask, &kernel, true));
            prop_assert_eq!(erode(mask.clone(), &kernel), by_definition(&mask, &kernel, false));
        }
    }
}
