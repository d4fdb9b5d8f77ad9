//! Filters of the mask that need to see beyond a tile's core: median, closing and opening with a disc or an element of
//! one's own, bounded filling of holes.
//!
//! Each filter is local: the bits inside the core depend only on bits at most [`MaskFilters::halo_px`] away, so any
//! tiling gives the same mask. Beyond the raster's edge there is nothing: background for the median and for dilation,
//! and no obstacle for erosion, so that a mark on the edge is not eaten. Holes are filled only inside regions no larger
//! than the largest mark, because filling without a bound is not local.

use autoref_raster::mask::morphology::{closed, fill_holes, median3, opened};
use autoref_raster::mask::{Element, Mask};

use crate::profile::Filters;

/// What a mask goes through before it is labelled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MaskFilters {
    median: bool,
    closing: Option<Element>,
    opening: Option<Element>,
    fill_holes: bool,
    /// Longest side of a region whose holes are filled.
    max_side_px: u64,
}

impl MaskFilters {
    /// `max_side_px` is the longest side of a region whose holes are filled.
    pub fn new(filters: &Filters, max_side_px: u64) -> MaskFilters {
        let element = |own: &Option<Element>, radius_px: u32| {
            own.clone().or_else(|| (radius_px > 0).then(|| Element::disc(radius_px)))
        };
        MaskFilters {
            median: filters.median,
            closing: element(&filters.closing_element, filters.closing_radius_px),
            opening: element(&filters.opening_element, filters.opening_radius_px),
            fill_holes: filters.fill_holes,
            max_side_px,
        }
    }

    /// No filter is on; [`MaskFilters::apply`] does nothing.
    pub fn is_identity(&self) -> bool {
        !self.median && self.closing.is_none() && self.opening.is_none() && !self.fill_holes
    }

    /// How far beyond the core the mask must be known.
    pub fn halo_px(&self) -> u64 {
        let fill = if self.fill_holes { self.max_side_px + 2 } else { 0 };
        let twice = |element: &Option<Element>| element.as_ref().map_or(0, |element| 2 * element.reach_px());
        u64::from(self.median) + twice(&self.closing) + fill + twice(&self.opening)
    }

    /// Filters the mask of a read window in place, in the order median, closing, filling, opening. What comes out is
    /// right at least [`MaskFilters::halo_px`] inside the window, and up to edges that are the raster's.
    pub fn apply(&self, mask: &mut Mask) {
        if self.median {
            *mask = median3(mask);
        }
        if let Some(element) = &self.closing {
            *mask = closed(mask, element);
        }
        if self.fill_holes {
            fill_holes(mask, self.max_side_px);
        }
        if let Some(element) = &self.opening {
            *mask = opened(mask, element);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::xorshift;
    use autoref_raster::window::Window;
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
        let filters = Filters {
            median,
            closing_radius_px: closing,
            opening_radius_px: opening,
            fill_holes: fill,
            ..Filters::default()
        };
        MaskFilters::new(&filters, max_side_px)
    }

    /// A lopsided element: what `scipy.ndimage.binary_dilation`, `binary_closing` and `binary_opening` give.
    #[test]
    fn an_element_of_ones_own_has_its_own_direction() {
        use autoref_raster::mask::morphology::{closed, dilated, opened};
        let hook = Element::try_from(vec!["##.".to_string(), "##.".into(), "...".into()]).expect("an element");
        let mask = picture(&["........", "..#..#..", "..##.#..", "..####..", "........"]);
        assert_eq!(dilated(&mask, &hook), picture(&[".##.##..", ".#####..", ".#####..", ".#####..", "........"]));
        assert_eq!(opened(&mask, &hook), picture(&["........", "........", "..##....", "..##....", "........"]));
        let gap = picture(&[
            "..........",
            "..........",
            "..#.#.##..",
            "..#.####..",
            "..##..#...",
            "..........",
            "..........",
        ]);
        let filled = ["..........", "..........", "..######..", "..######..", "..##..#...", "..........", ".........."];
        assert_eq!(closed(&gap, &hook), picture(&filled));
        let filters = Filters { closing_element: Some(hook), ..Filters::default() };
        assert_eq!(MaskFilters::new(&filters, 9).halo_px(), 2);
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
            x in 0u64..90, y in 0u64..40, own: bool,
        ) {
            let mut filters = all(median, closing, opening, fill, 7);
            if own {
                filters.closing = Some(Element::try_from(vec!["##..".to_string(), "#.##".into()]).expect("an element"));
            }
            let whole = Window::whole(130, 60);
            let mut state = seed | 1;
            let mut source = Mask::new(whole);
            for (v, u) in (0..60).flat_map(|v| (0..130).map(move |u| (v, u))) {
                source.set(u, v, (xorshift(&mut state) >> 33) % 10 < density);
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
