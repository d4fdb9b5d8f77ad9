//! Foreground bits of a window.

mod element;
pub mod morphology;

pub use element::{Element, LONGEST_SIDE_PX};

use crate::window::Window;

/// One bit a pixel, rows padded to whole 64-bit words, least significant bit first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    window: Window,
    words_per_row: usize,
    words: Vec<u64>,
}

impl Mask {
    /// All background.
    pub fn new(window: Window) -> Self {
        let mut mask = Mask { window, words_per_row: 0, words: Vec::new() };
        mask.reset(window);
        mask
    }

    /// Makes this the all-background mask of another window, keeping the allocation.
    pub fn reset(&mut self, window: Window) {
        self.window = window;
        self.words_per_row = (window.width as usize).div_ceil(64);
        self.words.clear();
        self.words.resize(self.words_per_row * window.height as usize, 0);
    }

    /// The pixels that it has bits of, image coordinates.
    pub fn window(&self) -> Window {
        self.window
    }

    /// Words of the row at image row `y`.
    pub fn row(&self, y: u64) -> &[u64] {
        let start = (y - self.window.y) as usize * self.words_per_row;
        &self.words[start..start + self.words_per_row]
    }

    /// The same, to be changed; bits beyond the width must stay clear.
    pub fn row_mut(&mut self, y: u64) -> &mut [u64] {
        let start = (y - self.window.y) as usize * self.words_per_row;
        &mut self.words[start..start + self.words_per_row]
    }

    /// The bit at an image position, which must lie in the window.
    pub fn get(&self, x: u64, y: u64) -> bool {
        let column = (x - self.window.x) as usize;
        self.row(y)[column / 64] >> (column % 64) & 1 == 1
    }

    /// Makes the bit at an image position, which must lie in the window, foreground (true) or background.
    pub fn set(&mut self, x: u64, y: u64, value: bool) {
        let column = (x - self.window.x) as usize;
        let word = &mut self.row_mut(y)[column / 64];
        *word = *word & !(1 << (column % 64)) | (u64::from(value) << (column % 64));
    }

    /// Number of foreground pixels.
    pub fn count(&self) -> u64 {
        self.words.iter().map(|w| u64::from(w.count_ones())).sum()
    }

    /// The `len` bits of image row `y` from column `x` on; further bits of the last word are zero.
    ///
    /// # Panics
    /// When `bits` has fewer than `ceil(len / 64)` words.
    pub fn get_bits(&self, x: u64, y: u64, len: u64, bits: &mut [u64]) {
        let column = (x - self.window.x) as usize;
        let (first, shift) = (column / 64, (column % 64) as u32);
        let row = self.row(y);
        let used = (len as usize).div_ceil(64);
        for (i, word) in bits[..used].iter_mut().enumerate() {
            let next = row.get(first + i + 1).copied().unwrap_or(0);
            *word = row[first + i] >> shift | if shift == 0 { 0 } else { next << (64 - shift) };
        }
        if !len.is_multiple_of(64) {
            bits[used - 1] &= u64::MAX >> (64 - len % 64);
        }
    }

    /// Sets `len` bits of image row `y` from column `x` on to the first `len` bits of `bits`, whose further bits must
    /// be zero. The row must be background there.
    pub fn put_bits(&mut self, x: u64, y: u64, len: u64, bits: &[u64]) {
        let column = (x - self.window.x) as usize;
        let (first, shift) = (column / 64, (column % 64) as u32);
        let used = (len as usize).div_ceil(64);
        let row = self.row_mut(y);
        if shift == 0 {
            row[first..first + used].iter_mut().zip(bits).for_each(|(to, from)| *to |= from);
            return;
        }
        for (i, &word) in bits[..used].iter().enumerate() {
            if word == 0 {
                continue;
            }
            row[first + i] |= word << shift;
            let spill = word >> (64 - shift);
            if spill != 0 {
                row[first + i + 1] |= spill;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_of_a_row_come_back_from_any_column() {
        let mut mask = Mask::new(Window::new(10, 3, 300, 2));
        (0..300).filter(|x| x * x % 7 < 3).for_each(|x| mask.set(10 + x, 4, true));
        for (from, len) in [(0, 300), (1, 64), (63, 65), (64, 128), (70, 1), (130, 170), (236, 64)] {
            let mut bits = vec![u64::MAX; 5];
            mask.get_bits(10 + from, 4, len, &mut bits);
            for i in 0..len.next_multiple_of(64) {
                let set = bits[i as usize / 64] >> (i % 64) & 1 == 1;
                assert_eq!(set, i < len && mask.get(10 + from + i, 4), "{from} {len} {i}");
            }
        }
    }
}
