//! Sets of pixels of a small window, a bit each: what is near, what is deep inside and what hangs together is then
//! found for 64 pixels at a time. Distances are Chebyshev's.

use crate::segment::label::Region;
use autoref_raster::Patch;

/// Pixels of a window, named by their index in row-major order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PixelSet {
    width: usize,
    /// Words of a row.
    stride: usize,
    /// Lowest bit first; those beyond the width are clear.
    words: Vec<u64>,
}

const BITS: usize = u64::BITS as usize;

impl PixelSet {
    /// None of `width` × `height` pixels.
    ///
    /// # Panics
    /// When the window has no column.
    pub fn empty(width: usize, height: usize) -> PixelSet {
        assert!(width > 0, "a window has a column");
        let stride = width.div_ceil(BITS);
        PixelSet { width, stride, words: vec![0; stride * height] }
    }

    /// Those that are marked, rows of `width`.
    pub fn of(marked: &[bool], width: usize) -> PixelSet {
        let mut set = PixelSet::empty(width, marked.len() / width);
        // Nearly always all of a window is there.
        if marked.iter().fold(true, |all, &one| all & one) {
            return set.complement();
        }
        for (words, row) in set.words.chunks_exact_mut(set.stride).zip(marked.chunks_exact(width)) {
            for (word, marked) in words.iter_mut().zip(row.chunks(BITS)) {
                *word = marked.chunks(8).enumerate().fold(0, |word, (k, eight)| word | packed(eight) << (8 * k));
            }
        }
        set
    }

    /// Those whose bit is set, lowest first, in words without gaps between rows.
    pub fn of_bits(bits: &[u64], width: usize, height: usize) -> PixelSet {
        let mut set = PixelSet::empty(width, height);
        let last = set.last_word();
        for (y, row) in set.words.chunks_exact_mut(set.stride).enumerate() {
            for (k, word) in row.iter_mut().enumerate() {
                let (at, shift) = ((y * width + k * BITS) / BITS, (y * width + k * BITS) % BITS);
                let above = if shift == 0 { 0 } else { bits.get(at + 1).map_or(0, |next| next << (BITS - shift)) };
                *word = bits[at] >> shift | above;
            }
            row[set.stride - 1] &= last;
        }
        set
    }

    /// Those of which `wanted` holds.
    pub fn from_fn(width: usize, height: usize, wanted: impl Fn(usize) -> bool) -> PixelSet {
        let mut set = PixelSet::empty(width, height);
        (0..width * height).filter(|&i| wanted(i)).for_each(|i| set.insert(i));
        set
    }

    fn place(&self, i: usize) -> (usize, u64) {
        let (x, y) = (i % self.width, i / self.width);
        (y * self.stride + x / BITS, 1 << (x % BITS))
    }

    /// Whether pixel `i` of the window, row-major, is in it.
    pub fn has(&self, i: usize) -> bool {
        let (word, bit) = self.place(i);
        self.words[word] & bit != 0
    }

    /// Takes pixel `i` in.
    pub fn insert(&mut self, i: usize) {
        let (word, bit) = self.place(i);
        self.words[word] |= bit;
    }

    /// Number of pixels.
    pub fn count(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|&word| word == 0)
    }

    /// Indices, rising.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        self.words.iter().enumerate().flat_map(|(at, &word)| {
            let first = at / self.stride * self.width + at % self.stride * BITS;
            std::iter::successors(Some(word).filter(|&left| left != 0), |&left| {
                Some(left & (left - 1)).filter(|&l| l != 0)
            })
            .map(move |left| first + left.trailing_zeros() as usize)
        })
    }

    /// Calls `act` with every index, rising: in less time than [`PixelSet::iter`] takes.
    pub fn for_each(&self, mut act: impl FnMut(usize)) {
        for (at, &word) in self.words.iter().enumerate() {
            let first = at / self.stride * self.width + at % self.stride * BITS;
            let mut left = word;
            while left != 0 {
                act(first + left.trailing_zeros() as usize);
                left &= left - 1;
            }
        }
    }

    /// The lowest index.
    pub fn first(&self) -> Option<usize> {
        self.iter().next()
    }

    fn with(&self, other: &PixelSet, of: impl Fn(u64, u64) -> u64) -> PixelSet {
        debug_assert!(self.width == other.width && self.words.len() == other.words.len());
        let words = self.words.iter().zip(&other.words).map(|(&a, &b)| of(a, b)).collect();
        PixelSet { words, ..*self }
    }

    /// Pixels of both.
    pub fn and(&self, other: &PixelSet) -> PixelSet {
        self.with(other, |a, b| a & b)
    }

    /// Pixels of either.
    pub fn or(&self, other: &PixelSet) -> PixelSet {
        self.with(other, |a, b| a | b)
    }

    /// Pixels that the other has not.
    pub fn minus(&self, other: &PixelSet) -> PixelSet {
        self.with(other, |a, b| a & !b)
    }

    /// All pixels of the window that are not in it.
    pub fn complement(&self) -> PixelSet {
        let last = self.last_word();
        let word = |(at, &word): (usize, &u64)| if (at + 1).is_multiple_of(self.stride) { !word & last } else { !word };
        PixelSet { words: self.words.iter().enumerate().map(word).collect(), ..*self }
    }

    /// Of a row's last word the bits that are pixels.
    fn last_word(&self) -> u64 {
        u64::MAX >> (self.stride * BITS - self.width)
    }

    /// All pixels no further than `reach_px` from one of it.
    pub fn grown(&self, reach_px: usize) -> PixelSet {
        let mut set = self.clone();
        if self.is_empty() {
            return set;
        }
        // What reaches r on both sides, moved by r + 1 and put together, reaches 2r + 1, also where one side is cut
        // off.
        let last = self.last_word();
        let mut reached = 0;
        while reached < reach_px {
            let step = (reach_px - reached).min(reached + 1).min(BITS - 1);
            if self.stride == 1 {
                set.words.iter_mut().for_each(|word| *word = (*word | *word << step | *word >> step) & last);
            } else {
                for row in set.words.chunks_exact_mut(self.stride) {
                    widen(row, step);
                    row[self.stride - 1] &= last;
                }
            }
            reached += step;
        }
        let (mut reached, mut before) = (0, vec![]);
        while reached < reach_px {
            let step = (reach_px - reached).min(reached + 1);
            let shift = (step * self.stride).min(set.words.len());
            before.clone_from(&set.words);
            set.words[shift..].iter_mut().zip(&before).for_each(|(word, above)| *word |= above);
            set.words.iter_mut().zip(&before[shift..]).for_each(|(word, below)| *word |= below);
            reached += step;
        }
        set
    }

    /// Its pixels further than `reach_px` from every pixel of the window that is not in it.
    pub fn shrunk(&self, reach_px: usize) -> PixelSet {
        self.minus(&self.complement().grown(reach_px))
    }

    /// Its 8-connected piece that holds pixel `start`, which must be in it.
    pub fn piece(&self, start: usize) -> PixelSet {
        debug_assert!(self.has(start));
        let height = self.words.len() / self.stride;
        let mut piece = PixelSet { words: vec![0; self.words.len()], ..*self };
        piece.insert(start);
        let first = start / self.width;
        piece.fill_row(self, first, first);
        // Down and up until nothing changes: a blob takes two rounds, a spiral as many as it has turns.
        loop {
            let mut changed = false;
            (1..height).for_each(|y| changed |= piece.fill_row(self, y, y - 1));
            (1..height).rev().for_each(|y| changed |= piece.fill_row(self, y - 1, y));
            if !changed {
                return piece;
            }
        }
    }

    /// Whether one of its pixels lies in the window's first or last row or column.
    pub fn at_edge(&self) -> bool {
        let any = |row: &[u64]| row.iter().any(|&word| word != 0);
        let last = 1 << (BITS - 1 - (self.stride * BITS - self.width));
        let beside = |row: &[u64]| row[0] & 1 != 0 || row[self.stride - 1] & last != 0;
        let mut rows = self.words.chunks_exact(self.stride);
        self.words.len() >= self.stride
            && (any(&self.words[..self.stride])
                || any(&self.words[self.words.len() - self.stride..])
                || rows.any(beside))
    }

    /// With all pixels of `within` that are 8-connected to it by such as `wanted` holds of. `go_on` sees what each
    /// round adds and all there is by then. `None` where it says no. Few pixels are asked for: those beside what was
    /// reached.
    pub fn spread(
        &self,
        within: &PixelSet,
        wanted: impl Fn(usize) -> bool,
        mut go_on: impl FnMut(&PixelSet, &PixelSet) -> bool,
    ) -> Option<PixelSet> {
        let (mut all, mut asked, mut front) = (self.clone(), self.clone(), self.clone());
        while !front.is_empty() {
            let beside = front.grown(1).and(within).minus(&asked);
            asked = asked.or(&beside);
            front.words.fill(0);
            beside.for_each(|i| {
                if wanted(i) {
                    front.insert(i);
                }
            });
            all = all.or(&front);
            if !go_on(&front, &all) {
                return None;
            }
        }
        Some(all)
    }

    /// Fills the runs of `mask` in row `y` that row `beside` touches or that it holds a part of; whether anything
    /// changed.
    fn fill_row(&mut self, mask: &PixelSet, y: usize, beside: usize) -> bool {
        let row = |y: usize| y * self.stride..(y + 1) * self.stride;
        if self.words[row(beside)].iter().all(|&word| word == 0) {
            return false;
        }
        let mut changed = false;
        let mut touched = self.words[row(beside)].to_vec();
        widen(&mut touched, 1);
        let (mask, own) = (&mask.words[row(y)], &mut self.words[row(y)]);
        // A run may go on in the next word: to the right first, then to the left.
        let mut carried = 0;
        for k in 0..own.len() {
            let seed = (own[k] | touched[k] | carried) & mask[k];
            let filled = fill_runs(seed, mask[k]);
            changed |= filled != own[k];
            own[k] = filled;
            carried = filled >> (BITS - 1);
        }
        for k in (0..own.len().saturating_sub(1)).rev() {
            let seed = own[k] | (own[k + 1] & 1) << (BITS - 1) & mask[k];
            let filled = fill_runs(seed, mask[k]);
            changed |= filled != own[k];
            own[k] = filled;
        }
        changed
    }
}

/// Up to eight marks as bits, the first lowest.
fn packed(marked: &[bool]) -> u64 {
    let bytes: [u8; 8] = match marked.try_into() {
        Ok(eight) => <[bool; 8]>::map(eight, u8::from),
        Err(_) => std::array::from_fn(|i| u8::from(marked.get(i).is_some_and(|set| *set))),
    };
    // Each byte's bit moves to the highest byte, the first to its lowest place.
    u64::from_le_bytes(bytes).wrapping_mul(0x0102_0408_1020_4080) >> 56
}

/// Adds the row itself, moved both ways by `step` columns, of which there are 1 to 63.
fn widen(row: &mut [u64], step: usize) {
    let mut before = 0;
    for k in 0..row.len() {
        let (here, after) = (row[k], row.get(k + 1).copied().unwrap_or(0));
        row[k] = here | here << step | before >> (BITS - step) | here >> step | after << (BITS - step);
        before = here;
    }
}

/// The runs of `mask` that hold a bit of `seed`, which is part of it: each step doubles how far a run is followed.
fn fill_runs(seed: u64, mask: u64) -> u64 {
    let (mut up, mut down, mut open_up, mut open_down) = (seed, seed, mask, mask);
    for step in [1, 2, 4, 8, 16, 32] {
        up |= open_up & up << step;
        open_up &= open_up << step;
        down |= open_down & down >> step;
        open_down &= open_down >> step;
    }
    up | down
}

/// The integers of a set of pixels of a patch; `None` when there are fewer than three. The outline is left at the
/// box's: gates on it are not to be asked.
pub(crate) fn region_of(own: &PixelSet, patch: &Patch) -> Option<Region> {
    let width = patch.window.width;
    let mut region: Option<Region> = None;
    for i in own.iter() {
        let (x, y) = (patch.window.x + i as u64 % width, patch.window.y + i as u64 / width);
        let pixel = Region::of_run(x, x + 1, y);
        match &mut region {
            Some(region) => region.absorb(&pixel, 0),
            None => region = Some(pixel),
        }
    }
    let mut region = region.filter(|r| r.area >= 3)?;
    region.perimeter = 2 * (region.bounds.width + region.bounds.height);
    Some(region)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn window() -> impl Strategy<Value = PixelSet> {
        (1usize..150, 1usize..40, prop::collection::vec(any::<prop::sample::Index>(), 0..60), prop::bool::ANY).prop_map(
            |(width, height, picked, most)| {
                let mut set = PixelSet::empty(width, height);
                picked.iter().for_each(|at| set.insert(at.index(width * height)));
                if most { set.complement() } else { set }
            },
        )
    }

    fn far(set: &PixelSet, i: usize, j: usize) -> usize {
        let (a, b) = ((i % set.width, i / set.width), (j % set.width, j / set.width));
        a.0.abs_diff(b.0).max(a.1.abs_diff(b.1))
    }

    fn all(set: &PixelSet) -> std::ops::Range<usize> {
        0..set.width * set.words.len() / set.stride
    }

    proptest! {
        #[test]
        fn growing_and_shrinking_go_by_distance(set in window(), reach in 0usize..80) {
            let pixels: Vec<usize> = set.iter().collect();
            prop_assert_eq!(pixels.len(), set.count());
            prop_assert!(all(&set).all(|i| set.has(i) == pixels.binary_search(&i).is_ok()));
            let others: Vec<usize> = set.complement().iter().collect();
            let (grown, shrunk) = (set.grown(reach), set.shrunk(reach));
            // All of them would take seconds.
            for i in all(&set).step_by(1 + all(&set).len() / 300) {
                prop_assert_eq!(grown.has(i), pixels.iter().any(|&j| far(&set, i, j) <= reach));
                prop_assert_eq!(shrunk.has(i), set.has(i) && others.iter().all(|&j| far(&set, i, j) > reach));
            }
            prop_assert_eq!(grown.iter().last().is_none_or(|i| i < all(&set).len()), true);
        }

        #[test]
        fn pieces_hang_together(set in window()) {
            let Some(start) = set.first() else { return Ok(()) };
            let piece = set.piece(start);
            // One pixel at a time.
            let mut twin = PixelSet { words: vec![0; set.words.len()], ..set };
            let mut todo = vec![start];
            while let Some(i) = todo.pop() {
                if twin.has(i) {
                    continue;
                }
                twin.insert(i);
                todo.extend(set.iter().filter(|&j| far(&set, i, j) == 1 && !twin.has(j)));
            }
            prop_assert_eq!(piece, twin);
        }

        #[test]
        fn what_spreads_is_what_hangs_together(set in window(), seed: u64) {
            let Some(start) = set.first() else { return Ok(()) };
            let mut one = PixelSet { words: vec![0; set.words.len()], ..set };
            one.insert(start);
            let within = PixelSet::from_fn(set.width, set.words.len() / set.stride, |i| (i as u64 ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 62 != 1);
            let spread = one.spread(&within, |i| set.has(i), |_, _| true);
            prop_assert_eq!(spread, Some(set.and(&within).or(&one).piece(start)));
            prop_assert_eq!(one.spread(&within, |i| set.has(i), |_, _| false), None);
            let height = set.words.len() / set.stride;
            let at_edge = |i: usize| {
            let (column, row) = (i % set.width, i / set.width);
            column == 0 || column + 1 == set.width || row == 0 || row + 1 == height
        };
            prop_assert_eq!(set.at_edge(), set.iter().any(at_edge));
        }

        #[test]
        fn sets_combine(a in window(), seed: u64) {
            let b = PixelSet::from_fn(a.width, a.words.len() / a.stride, |i| (i as u64 ^ seed).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 63 == 1);
            let marked: Vec<bool> = all(&b).map(|i| b.has(i)).collect();
            prop_assert_eq!(&PixelSet::of(&marked, b.width), &b);
            let (every, height) = (vec![true; marked.len()], marked.len() / b.width);
            prop_assert_eq!(PixelSet::of(&every, b.width), PixelSet::from_fn(b.width, height, |_| true));
            let mut bits = vec![0u64; marked.len().div_ceil(BITS)];
            b.iter().for_each(|i| bits[i / BITS] |= 1 << (i % BITS));
            prop_assert_eq!(&PixelSet::of_bits(&bits, b.width, marked.len() / b.width), &b);
            let mut visited = vec![];
            b.for_each(|i| visited.push(i));
            prop_assert_eq!(visited, b.iter().collect::<Vec<_>>());
            for i in all(&a) {
                prop_assert_eq!(a.and(&b).has(i), a.has(i) && b.has(i));
                prop_assert_eq!(a.or(&b).has(i), a.has(i) || b.has(i));
                prop_assert_eq!(a.minus(&b).has(i), a.has(i) && !b.has(i));
            }
        }
    }

    #[test]
    fn a_spiral_is_one_piece() {
        // Walls of one pixel, paths of one pixel, three words wide.
        let (width, height) = (150, 41);
        let mut set = PixelSet::empty(width, height);
        let (mut left, mut top, mut right, mut bottom) = (0, 0, width - 1, height - 1);
        while left + 4 < right && top + 4 < bottom {
            (left..=right).for_each(|x| set.insert(top * width + x));
            (top..=bottom).for_each(|y| set.insert(y * width + right));
            (left..=right).for_each(|x| set.insert(bottom * width + x));
            (top + 2..=bottom).for_each(|y| set.insert(y * width + left));
            set.insert((top + 2) * width + left + 1);
            (left, top, right, bottom) = (left + 2, top + 2, right - 2, bottom - 2);
        }
        assert_eq!(set.piece(0), set);
    }
}
