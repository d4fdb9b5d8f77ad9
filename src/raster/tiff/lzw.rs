//! LZW as TIFF has it (TIFF 6.0, section 13): most significant bit first, codes of 9 to 12 bits, one code early.
//!
//! Strings of up to seven bytes, which are most of a photograph's, stand in the table themselves and are written as one
//! word. Every longer string is a piece of what was written before, so the table holds where it begins and how long it is, and
//! the code is one copy within the output (the scheme of Welch, "A technique for high-performance data compression", IEEE
//! Computer 17(6), 1984, without its prefix links). Words may be written beyond the string; the next string overwrites that.
//! `weezl` is the slower twin that the tests compare with.
#![allow(unsafe_code)]

const CLEAR: usize = 256;
const END: usize = 257;
const FIRST: usize = 258;
const CODES: usize = 4096;
/// Copies go in words of this many bytes, so that many must be free behind a string.
const WORD: usize = 16;
/// Longest string that stands in the table.
const SHORT: u32 = 7;
const BYTES: u64 = (1 << 56) - 1;

/// Where a long string lies in the output.
#[derive(Clone, Copy, Default)]
struct Place {
    position: u32,
    length: u32,
}

/// A decoder with its tables, used from block to block.
pub struct Decoder {
    /// The first seven bytes of each string, the first in the lowest place, and its length on top: more than [`SHORT`] where
    /// it is in `long`.
    short: Box<[u64; CODES]>,
    long: Box<[Place; CODES]>,
}

/// The string that was written last.
#[derive(Clone, Copy)]
struct Last {
    short: u64,
    place: Place,
}

impl Decoder {
    pub fn new() -> Self {
        let mut short = Box::new([0; CODES]);
        for (byte, entry) in short[..CLEAR].iter_mut().enumerate() {
            *entry = byte as u64 | 1 << 56;
        }
        Decoder { short, long: Box::new([Place::default(); CODES]) }
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
        let mut last: Option<Last> = None;
        let mut at = 0;
        while at < out.len() {
            let Some(code) = bits.take(width) else { break };
            if code == CLEAR {
                (next, width, last) = (FIRST, 9, None);
                continue;
            }
            if code == END {
                break;
            }
            if let Some(last) = last
                && next < CODES
            {
                // A code that is made by this very step begins as the last string did.
                let begins = if code == next { last.short } else { self.short[code] };
                self.add(next, last, begins as u8);
                next += 1;
                width += usize::from(next + 1 == 1 << width && width < 12);
            }
            if code >= next {
                return Err(format!("LZW: code {code} comes before it exists, after {at} bytes"));
            }
            let short = self.short[code];
            let mut length = (short >> 56) as usize;
            if length <= SHORT as usize && at + 8 <= out.len() {
                out[at..at + 8].copy_from_slice(&short.to_le_bytes());
            } else if length <= SHORT as usize {
                length = length.min(out.len() - at);
                out[at..at + length].copy_from_slice(&short.to_le_bytes()[..length]);
            } else {
                let place = self.long[code];
                length = copy(out, place.position as usize, at, place.length as usize);
            }
            last = Some(Last { short, place: Place { position: at as u32, length: length as u32 } });
            at += length;
        }
        Ok(at)
    }

    /// The string `last` and one byte more becomes entry `code`. It lies in the output where `last` does: the byte is the
    /// one behind it.
    #[inline(always)]
    fn add(&mut self, code: usize, last: Last, byte: u8) {
        let Place { position, length } = last.place;
        if length < SHORT {
            let bytes = last.short & BYTES | u64::from(byte) << (8 * length);
            self.short[code] = bytes | u64::from(length + 1) << 56;
        } else {
            self.short[code] = last.short & BYTES | u64::from(SHORT + 1) << 56;
            self.long[code] = Place { position, length: length + 1 };
        }
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
                // Data that end without an end code leave weezl holding its last string back.
                Ok(length) if result.status.is_ok() => {
                    prop_assert!(length >= result.consumed_out);
                    prop_assert_eq!(&ours[..result.consumed_out], &theirs[..result.consumed_out]);
                }
                Ok(_) => {}
                Err(_) => prop_assert!(result.status.is_err() || result.consumed_out < ours.len()),
            }
        }
    }
}
