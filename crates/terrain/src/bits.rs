//! One bit a pixel: the masks that the cleaning works on.

/// What a pixel of a mask is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bit {
    /// In most masks: keep.
    Set,
    Clear,
}

impl std::ops::Not for Bit {
    type Output = Bit;

    fn not(self) -> Bit {
        match self {
            Bit::Set => Bit::Clear,
            Bit::Clear => Bit::Set,
        }
    }
}

/// A mask of `width` × `height` pixels, row-major, each row in whole words of 64 pixels; true = keep.
///
/// Bits beyond the width are always clear.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitMask {
    width: usize,
    height: usize,
    row_words: usize,
    words: Vec<u64>,
}

impl BitMask {
    /// An all-clear mask.
    pub fn new(width: usize, height: usize) -> Self {
        let row_words = width.div_ceil(64);
        BitMask { width, height, row_words, words: vec![0; row_words * height] }
    }

    /// The mask of the pixels that `keep` says yes to; `keep` is given x, y.
    pub fn from_fn(width: usize, height: usize, mut keep: impl FnMut(usize, usize) -> bool) -> Self {
        let mut mask = BitMask::new(width, height);
        for y in 0..height {
            for x in 0..width {
                if keep(x, y) {
                    mask.set(x, y, true);
                }
            }
        }
        mask
    }

    /// Width, pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Bytes that a mask of this size holds.
    pub fn bytes_for(width: u64, height: u64) -> u64 {
        width.div_ceil(64) * 8 * height
    }

    /// Whether the pixel in column `x` and row `y` is set.
    pub fn get(&self, x: usize, y: usize) -> bool {
        debug_assert!(x < self.width && y < self.height);
        self.words[y * self.row_words + x / 64] >> (x % 64) & 1 == 1
    }

    /// Sets the pixel in column `x` and row `y`, or clears it.
    pub fn set(&mut self, x: usize, y: usize, value: bool) {
        debug_assert!(x < self.width && y < self.height);
        let word = &mut self.words[y * self.row_words + x / 64];
        *word = *word & !(1 << (x % 64)) | u64::from(value) << (x % 64);
    }

    /// The words of a row, pixel 0 in the lowest bit of the first.
    pub fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.row_words..(y + 1) * self.row_words]
    }

    /// The same, to be changed; bits beyond the width must stay clear.
    pub fn row_mut(&mut self, y: usize) -> &mut [u64] {
        &mut self.words[y * self.row_words..(y + 1) * self.row_words]
    }

    pub(crate) fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    /// Number of set pixels.
    pub fn count(&self) -> u64 {
        self.words.iter().map(|word| u64::from(word.count_ones())).sum()
    }

    /// Share of set pixels, 0…1; 0 of an empty mask.
    pub fn share(&self) -> f64 {
        self.count() as f64 / ((self.width * self.height) as f64).max(1.0)
    }

    /// Turns every pixel over.
    pub fn invert(&mut self) {
        let last = last_word(self.width);
        for row in self.words.chunks_exact_mut(self.row_words.max(1)) {
            row.iter_mut().for_each(|word| *word = !*word);
            if let Some(word) = row.last_mut() {
                *word &= last;
            }
        }
    }

    /// Keeps only what `other` has too.
    ///
    /// # Panics
    /// When the sizes differ.
    pub fn and(&mut self, other: &BitMask) {
        assert_eq!((self.width, self.height), (other.width, other.height), "masks of one size");
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= b);
    }

    /// Makes the pixels `start..end` of row `y` set or clear.
    pub fn fill_run(&mut self, y: usize, start: usize, end: usize, bit: Bit) {
        debug_assert!(end <= self.width && y < self.height);
        let row = self.row_mut(y);
        let mut x = start;
        while x < end {
            let (word, first) = (x / 64, x % 64);
            let count = (64 - first).min(end - x);
            let bits = if count == 64 { !0 } else { ((1u64 << count) - 1) << first };
            row[word] = match bit {
                Bit::Set => row[word] | bits,
                Bit::Clear => row[word] & !bits,
            };
            x += count;
        }
    }

    /// Calls `run(start, end)` for every run of pixels of row `y` that are set, or clear.
    pub fn runs(&self, y: usize, bit: Bit, mut run: impl FnMut(usize, usize)) {
        let row = self.row(y);
        let mut x = 0;
        while x < self.width {
            let start = next(row, x, self.width, bit);
            if start >= self.width {
                return;
            }
            let end = next(row, start, self.width, !bit);
            run(start, end);
            x = end;
        }
    }
}

/// The first pixel from `from` on that is set, or clear, or `width`.
fn next(row: &[u64], from: usize, width: usize, bit: Bit) -> usize {
    let flip = match bit {
        Bit::Set => 0,
        Bit::Clear => !0,
    };
    let mut word = from / 64;
    let mut bits = (row[word] ^ flip) & (!0u64 << (from % 64));
    loop {
        if bits != 0 {
            return (word * 64 + bits.trailing_zeros() as usize).min(width);
        }
        word += 1;
        if word >= row.len() {
            return width;
        }
        bits = row[word] ^ flip;
    }
}

/// The bits of a row's last word that are pixels.
pub(crate) fn last_word(width: usize) -> u64 {
    if width.is_multiple_of(64) { !0 } else { (1 << (width % 64)) - 1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_counts_and_inversion_agree_with_pixels() {
        for width in [1, 63, 64, 65, 130] {
            let keep = |x: usize, y: usize| (x * 7 + y * 13) % 11 < 5 || (70..129).contains(&x);
            let mut mask = BitMask::from_fn(width, 3, keep);
            for (bit, value) in [(Bit::Set, true), (Bit::Clear, false)] {
                let mut seen = vec![!value; width];
                mask.runs(1, bit, |a, b| seen[a..b].iter_mut().for_each(|s| *s = value));
                assert!((0..width).all(|x| seen[x] == keep(x, 1)));
            }
            let set = mask.count();
            mask.invert();
            assert_eq!(set + mask.count(), width as u64 * 3);
            mask.fill_run(2, 0, width, Bit::Set);
            assert!((0..width).all(|x| mask.get(x, 2)) && mask.get(0, 0) != keep(0, 0));
        }
    }
}
