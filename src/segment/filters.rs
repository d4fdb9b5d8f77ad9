//! Filters of the mask that need to see beyond a tile's core: median, closing and opening with a disc, bounded filling of
//! holes.
//!
//! Each filter is local: the bits inside the core depend only on bits at most [`MaskFilters::halo_px`] away, so any
//! tiling gives the same mask. Beyond the raster's edge there is nothing: background for the median and for dilation, and
//! no obstacle for erosion, so that a mark on the edge is not eaten. Holes are filled only inside regions no larger than
//! the largest mark, because filling without a bound is not local.

use super::mask::Mask;
use crate::candidate::Gates;
use crate::profile::{Filters, Profile};
use crate::window::Window;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MaskFilters {
    filters: Filters,
    /// Longest side of a region whose holes are filled.
    max_side_px: u64,
}

impl MaskFilters {
    pub fn from_profile(profile: &Profile, gates: &Gates) -> MaskFilters {
        MaskFilters { filters: profile.filters, max_side_px: gates.max_side_px() }
    }

    /// No filter is on; [`MaskFilters::apply`] does nothing.
    pub fn is_identity(&self) -> bool {
        self.filters == Filters::default()
    }

    /// How far beyond the core the mask must be known.
    pub fn halo_px(&self) -> u64 {
        let f = &self.filters;
        let fill = if f.fill_holes { self.max_side_px + 2 } else { 0 };
        u64::from(f.median) + 2 * u64::from(f.closing_radius_px) + fill + 2 * u64::from(f.opening_radius_px)
    }

    /// Filters the mask of a read window in place, in the order median, closing, filling, opening. What comes out is right
    /// at least [`MaskFilters::halo_px`] inside the window, and up to edges that are the raster's.
    pub fn apply(&self, mask: &mut Mask) {
        let f = &self.filters;
        if f.median {
            *mask = median3(mask);
        }
        if f.closing_radius_px > 0 {
            *mask = closed(mask, f.closing_radius_px);
        }
        if f.fill_holes {
            fill_holes(mask, self.max_side_px);
        }
        if f.opening_radius_px > 0 {
            let shrunk = complement(&dilate(&complement(mask), f.opening_radius_px));
            *mask = dilate(&shrunk, f.opening_radius_px);
        }
    }
}

/// Bits of word `i` of a row moved by `k` columns: bit `j` is column `64·i + j + k`, 0 outside.
fn shifted(row: &[u64], i: usize, k: i64) -> u64 {
    let start = 64 * i as i64 + k;
    let (word, bit) = (start.div_euclid(64), start.rem_euclid(64) as u32);
    let at = |w: i64| usize::try_from(w).ok().and_then(|w| row.get(w)).copied().unwrap_or(0);
    if bit == 0 { at(word) } else { at(word) >> bit | at(word + 1) << (64 - bit) }
}

/// Clears the padding bits of the last word of each row.
fn trim(mask: &mut Mask) {
    let window = mask.window();
    let used = window.width % 64;
    if used == 0 {
        return;
    }
    for y in window.y..window.bottom() {
        if let Some(last) = mask.row_mut(y).last_mut() {
            *last &= (1 << used) - 1;
        }
    }
}

/// Dilation, then erosion, with a disc.
pub(crate) fn closed(mask: &Mask, radius_px: u32) -> Mask {
    complement(&dilate(&complement(&dilate(mask, radius_px)), radius_px))
}

pub(crate) fn complement(mask: &Mask) -> Mask {
    let mut out = mask.clone();
    let window = mask.window();
    for y in window.y..window.bottom() {
        out.row_mut(y).iter_mut().for_each(|w| *w = !*w);
    }
    trim(&mut out);
    out
}

/// Dilation with the disc of all pixels whose centres are within `radius` of its own.
fn dilate(mask: &Mask, radius: u32) -> Mask {
    let window = mask.window();
    let r = i64::from(radius);
    let mut out = Mask::new(window);
    for y in window.y..window.bottom() {
        let row = out.row_mut(y);
        for dy in -r..=r {
            let Some(v) = y.checked_add_signed(dy).filter(|v| (window.y..window.bottom()).contains(v)) else {
                continue;
            };
            let from = mask.row(v);
            if from.iter().all(|&w| w == 0) {
                continue;
            }
            let half = ((r * r - dy * dy) as f64).sqrt().floor() as i64;
            for (i, to) in row.iter_mut().enumerate() {
                for k in -half..=half {
                    *to |= shifted(from, i, k);
                }
            }
        }
    }
    trim(&mut out);
    out
}

/// Majority of 3 × 3.
fn median3(mask: &Mask) -> Mask {
    let window = mask.window();
    let mut out = Mask::new(window);
    for y in window.y..window.bottom() {
        let rows: Vec<&[u64]> =
            (y.saturating_sub(1).max(window.y)..(y + 2).min(window.bottom())).map(|v| mask.row(v)).collect();
        for (i, to) in out.row_mut(y).iter_mut().enumerate() {
            // Bit-sliced count of up to nine ones.
            let mut count = [0u64; 4];
            for bits in rows.iter().flat_map(|row| (-1..=1).map(|k| shifted(row, i, k))) {
                let mut carry = bits;
                for digit in &mut count {
                    (*digit, carry) = (*digit ^ carry, *digit & carry);
                }
            }
            // Five or more: 8 or 9, or 4 with anything below.
            *to = count[3] | count[2] & (count[0] | count[1]);
        }
    }
    trim(&mut out);
    out
}

/// Fills 4-connected holes of 8-connected regions whose bounding box is at most `max_side_px` on each side.
fn fill_holes(mask: &mut Mask, max_side_px: u64) {
    let window = mask.window();
    let mut seen = Mask::new(window);
    let mut fills: Vec<(u64, u64)> = Vec::new();
    for y in window.y + 1..window.bottom().saturating_sub(1) {
        for i in 0..mask.row(y).len() {
            // A hole's first pixel in raster order has foreground to its left and above it.
            let (here, above) = (mask.row(y)[i], mask.row(y - 1)[i]);
            let mut starts = !here & above & shifted(mask.row(y), i, -1);
            while starts != 0 {
                let x = window.x + 64 * i as u64 + u64::from(starts.trailing_zeros());
                starts &= starts - 1;
                if x + 1 >= window.right() || seen.get(x, y) {
                    continue;
                }
                let Some(hole) = bounded_set(mask, (x, y), false, max_side_px) else { continue };
                for &(u, v) in &hole {
                    seen.set(u, v, true);
                }
                if bounded_set(mask, (x - 1, y), true, max_side_px).is_some() {
                    fills.extend(hole);
                }
            }
        }
    }
    for (x, y) in fills {
        mask.set(x, y, true);
    }
}

/// The set of equal pixels connected to `start` (8-connected foreground, 4-connected background); `None` when it is larger
/// than `max_side_px` on a side, or background that touches the window's edge.
fn bounded_set(mask: &Mask, start: (u64, u64), foreground: bool, max_side_px: u64) -> Option<Vec<(u64, u64)>> {
    let window = mask.window();
    let mut set = std::collections::BTreeSet::from([start]);
    let mut todo = vec![start];
    let mut bounds = Window::new(start.0, start.1, 1, 1);
    while let Some((x, y)) = todo.pop() {
        bounds = bounds.union(&Window::new(x, y, 1, 1));
        if bounds.width > max_side_px || bounds.height > max_side_px {
            return None;
        }
        for (dx, dy) in [(-1i64, 0i64), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
            let diagonal = dx != 0 && dy != 0;
            let (u, v) = (x.wrapping_add_signed(dx), y.wrapping_add_signed(dy));
            if !window.contains(u, v) {
                if !foreground && !diagonal {
                    return None;
                }
                continue;
            }
            if (foreground || !diagonal) && mask.get(u, v) == foreground && set.insert((u, v)) {
                todo.push((u, v));
            }
        }
    }
    Some(set.into_iter().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn picture(rows: &[&str]) -> Mask {
        let mut mask = Mask::new(Window::whole(rows[0].len() as u64, rows.len() as u64));
        for (y, row) in rows.iter().enumerate() {
            for (x, c) in row.bytes().enumerate() {
                mask.set(x as u64, y as u64, c == b'#');
            }
        }
        mask
    }

    fn all(median: bool, closing: u32, opening: u32, fill: bool, max_side_px: u64) -> MaskFilters {
        let filters = Filters { median, closing_radius_px: closing, opening_radius_px: opening, fill_holes: fill };
        MaskFilters { filters, max_side_px }
    }

    #[test]
    fn holes_are_filled_up_to_the_bound() {
        let ring = ["#####...", "#...#...", "#.#.#...", "#...#...", "#####...", "........"];
        let mut mask = picture(&ring);
        all(false, 0, 0, true, 5).apply(&mut mask);
        assert_eq!(mask.count(), 25);
        let mut mask = picture(&ring);
        all(false, 0, 0, true, 4).apply(&mut mask);
        assert_eq!(mask, picture(&ring));
    }

    #[test]
    fn median_and_discs_do_what_they_say() {
        let mut mask = picture(&["......", ".###..", ".###..", ".###..", "......", "....#."]);
        all(true, 0, 0, false, 60).apply(&mut mask);
        assert_eq!(mask, picture(&["......", "..#...", ".###..", "..#...", "......", "......"]));
        let mut mask = picture(&[".......", ".##.##.", ".##.##.", ".##.##.", "......."]);
        all(false, 1, 0, false, 60).apply(&mut mask);
        assert!(mask.get(3, 2));
        let mut mask = picture(&["#......", "...###.", "...###.", "...###.", "......."]);
        all(false, 0, 1, false, 60).apply(&mut mask);
        assert!(!mask.get(1, 0) && mask.get(4, 2) && !mask.get(3, 1));
    }

    proptest! {
        /// Any window with enough halo gives the bits that the whole picture gives.
        #[test]
        fn filters_are_local(
            seed in any::<u64>(), density in 2u64..9, median: bool, closing in 0u32..3, opening in 0u32..3, fill: bool,
            x in 0u64..90, y in 0u64..40,
        ) {
            let filters = all(median, closing, opening, fill, 7);
            let whole = Window::whole(130, 60);
            let mut state = seed | 1;
            let mut source = Mask::new(whole);
            for (v, u) in (0..60).flat_map(|v| (0..130).map(move |u| (v, u))) {
                state ^= state << 13; state ^= state >> 7; state ^= state << 17;
                source.set(u, v, (state >> 33) % 10 < density);
            }
            let mut reference = source.clone();
            filters.apply(&mut reference);
            let core = Window::new(x, y, 37, 19).intersect(&whole);
            let read = core.grown(filters.halo_px(), &whole);
            let mut part = Mask::new(read);
            for (v, u) in (read.y..read.bottom()).flat_map(|v| (read.x..read.right()).map(move |u| (v, u))) {
                part.set(u, v, source.get(u, v));
            }
            filters.apply(&mut part);
            for (v, u) in (core.y..core.bottom()).flat_map(|v| (core.x..core.right()).map(move |u| (v, u))) {
                prop_assert_eq!(part.get(u, v), reference.get(u, v), "{} {}", u, v);
            }
        }
    }
}
