//! LZW as TIFF has it (TIFF 6.0, section 13): most significant bit first, codes of 9 to 12 bits, one code early.
//!
//! Every string in the table is a piece of what was written before, so the table holds only where it begins and how long it
//! is, and a code is one copy within the output (the scheme of Welch, "A technique for high-performance data compression",
//! IEEE Computer 17(6), 1984, with positions in place of prefix links). The copies are unaligned words that may write
//! beyond the string; the next string overwrites that. `weezl` is the slower twin that the tests compare with.
#![allow(unsafe_code)]

const CLEAR: usize = 256;
const END: usize = 257;
const FIRST: usize = 258;
const CODES: usize = 4096;
/// Copies go in words of this many bytes, so that many must be free behind a string.
const WORD: usize = 16;

/// Where a string lies in the output.
#[derive(Clone, Copy, Default)]
struct Entry {
    position: u32,
    length: u32,
}

/// A decoder with its table, used from block to block.
pub struct Decoder {
    table: Box<[Entry; CODES]>,
}

impl Decoder {
    pub fn new() -> Self {
        Decoder { table: Box::new([Entry::default(); CODES]) }
    }

    /// Decodes until `out` is full, the end code comes or the data end, and returns how many bytes of `out` are filled.
    ///
    /// # Errors
    /// In words, when a code comes that does not exist yet.
    ///
    /// # Panics
    /// When `out` has 4 GiB or more.
    pub fn decode(&mut self, data: &[u8], out: &mut [u8]) -> Result<usize, String> {
        assert!(out.len() < u32::MAX as usize, "blocks are bounded far below 4 GiB");
        let mut bits = Bits::new(data);
        let (mut next, mut width) = (FIRST, 9);
        let mut previous: Option<Entry> = None;
        let mut at = 0;
        while at < out.len() {
            let Some(code) = bits.take(width) else { break };
            if code == CLEAR {
                (next, width, previous) = (FIRST, 9, None);
                continue;
            }
            if code == END {
                break;
            }
            // The string that the previous code began ends with the first byte of this one, and lies in the output as such.
            if let Some(Entry { position, length }) = previous
                && next < CODES
            {
                self.table[next] = Entry { position, length: length + 1 };
                next += 1;
                width += usize::from(next + 1 == 1 << width && width < 12);
            }
            let string = if code < CLEAR {
                out[at] = code as u8;
                Entry { position: at as u32, length: 1 }
            } else if code < next {
                let entry = self.table[code];
                let copied = copy(out, entry.position as usize, at, entry.length as usize);
                Entry { position: at as u32, length: copied as u32 }
            } else {
                return Err(format!("LZW: code {code} comes before it exists, after {at} bytes"));
            };
            at += string.length as usize;
            previous = Some(string);
        }
        Ok(at)
    }
}

/// Copies `length` bytes (fewer at the end of `out`) from `from` to `to`, which is behind it, and returns how many. The
/// ranges may overlap by the one byte by which a string can contain its own beginning.
#[inline(always)]
fn copy(out: &mut [u8], from: usize, to: usize, length: usize) -> usize {
    if to + length + WORD > out.len() {
        return copy_at_the_end(out, from, to, length);
    }
    debug_assert!(from < to && from + length <= to + 1);
    // SAFETY: the last word begins below `to + length`, so that it ends below `to + length + WORD`, which lies in `out`;
    // `from < to`, so the words read do too. Both come from one unique borrow, and each word is read before it is written.
    unsafe {
        let base = out.as_mut_ptr();
        let mut done = 0;
        while done < length {
            let word = base.add(from + done).cast::<[u8; WORD]>().read_unaligned();
            base.add(to + done).cast::<[u8; WORD]>().write_unaligned(word);
            done += WORD;
        }
    }
    // Words were read before the first byte of the string was there: the byte of the overlap comes last.
    out[to + length - 1] = out[from + length - 1];
    length
}

#[cold]
fn copy_at_the_end(out: &mut [u8], from: usize, to: usize, length: usize) -> usize {
    let length = length.min(out.len() - to);
    for i in 0..length {
        out[to + i] = out[from + i];
    }
    length
}

/// Codes from the most significant bit on.
struct Bits<'a> {
    data: &'a [u8],
    /// In bits.
    position: usize,
}

impl<'a> Bits<'a> {
    fn new(data: &'a [u8]) -> Self {
        Bits { data, position: 0 }
    }

    /// The next `width` bits, at most 12; `None` when there are not that many.
    #[inline(always)]
    fn take(&mut self, width: usize) -> Option<usize> {
        let byte = self.position / 8;
        let word = match self.data.get(byte..byte + 4) {
            Some(four) => u32::from_be_bytes(four.try_into().expect("four bytes were taken")),
            None => self.tail(byte, width)?,
        };
        let code = (word << (self.position % 8)) >> (32 - width);
        self.position += width;
        Some(code as usize)
    }

    #[cold]
    fn tail(&self, byte: usize, width: usize) -> Option<u32> {
        if self.position + width > self.data.len() * 8 {
            return None;
        }
        let mut four = [0; 4];
        let rest = &self.data[byte..];
        four[..rest.len()].copy_from_slice(rest);
        Some(u32::from_be_bytes(four))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encode(bytes: &[u8]) -> Vec<u8> {
        weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(bytes).expect("encodes anything")
    }

    fn check(bytes: &[u8]) {
        let data = encode(bytes);
        let mut out = vec![0xAA; bytes.len()];
        assert_eq!(Decoder::new().decode(&data, &mut out), Ok(bytes.len()));
        assert_eq!(out, bytes);
        // A shorter output takes the beginning.
        let mut part = vec![0; bytes.len() / 2];
        assert_eq!(Decoder::new().decode(&data, &mut part), Ok(part.len()));
        assert_eq!(part, bytes[..part.len()]);
    }

    #[test]
    fn runs_noise_and_photographs_like_data_come_back() {
        for length in [0, 1, 2, 15, 16, 17, 255, 5000, 300_000] {
            check(&vec![7; length]);
            check(&(0..length).map(|i| (i * i / 7 % 251) as u8).collect::<Vec<_>>());
            let mut seed = 1u32;
            let noise: Vec<u8> = (0..length)
                .map(|_| {
                    seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (seed >> 24) as u8
                })
                .collect();
            check(&noise);
            check(&noise.iter().map(|v| v & 3).collect::<Vec<_>>());
        }
    }

    proptest! {
        #[test]
        fn any_bytes_come_back(bytes in proptest::collection::vec(0u8..6, 0..3000)) {
            check(&bytes);
        }

        #[test]
        fn garbage_agrees_with_weezl(mut data in proptest::collection::vec(any::<u8>(), 0..400)) {
            // Begin with a clear code, as every writer does.
            data.insert(0, 0x80);
            let mut ours = vec![0; 2000];
            let mut theirs = vec![0; 2000];
            let result = weezl::decode::Decoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8)
                .decode_bytes(&data, &mut theirs);
            match Decoder::new().decode(&data, &mut ours) {
                Ok(length) if result.status.is_ok() => prop_assert_eq!(&ours[..length], &theirs[..length]),
                Ok(_) => {}
                Err(_) => prop_assert!(result.status.is_err() || result.consumed_out < ours.len()),
            }
        }
    }
}
