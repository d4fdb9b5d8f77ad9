//! LZW as TIFF has it (TIFF 6.0, section 13): most significant bit first, codes of 9 to 12 bits, one code early.
//!
//! Strings of up to seven bytes, which are most of a photograph's, stand in the table themselves and are written as one
//! word. Every longer string is a piece of what was written before, so the table holds where it begins and how long it
//! is, and the code is one copy within the output (the scheme of Welch, "A technique for high-performance data
//! compression", IEEE Computer 17(6), 1984, without its prefix links). Words may be written beyond the string; the next
//! string overwrites that.
//!
//! Nine of ten codes of a photograph are short strings after short strings, and are taken in groups of four with one
//! test a code ([`Decoder::run`]); all that is rarer, [`Decoder::step`] takes code by code. `weezl` is the slower twin
//! that the tests compare with.
#![allow(unsafe_code)]

const CLEAR: usize = 256;
const END: usize = 257;
const FIRST: usize = 258;
const CODES: usize = 4096;
/// Copies go in words of this many bytes, so that many must be free behind a string.
const WORD: usize = 16;
/// Longest string that stands in the table.
const SHORT: usize = 7;
const BYTES: u64 = (1 << 56) - 1;
/// Codes that are taken from one word of the data.
const GROUP: usize = 4;

/// Where a long string lies in the output.
#[derive(Clone, Copy, Default)]
struct Place {
    position: u32,
    length: u32,
}

/// A decoder with its tables, used from block to block.
pub struct Decoder {
    /// The first seven bytes of each string, the first in the lowest place and zeros behind the last, and its length on
    /// top: more than [`SHORT`] where it is in `long`, and 0 for codes that have no string, or none yet.
    short: Box<[u64; CODES]>,
    long: Box<[Place; CODES]>,
}

/// Where decoding has come to.
struct State<'a> {
    data: &'a [u8],
    /// Of the next code in the data, in bits.
    bit: usize,
    /// Bits of the next code.
    width: usize,
    /// The code that the next code makes.
    next: usize,
    /// The string that was written last since the table was cleared: as it stands in the table, and where it lies.
    last: Option<(u64, Place)>,
    /// Bytes written.
    at: usize,
}

fn length_of(short: u64) -> usize {
    (short >> 56) as usize
}

impl Decoder {
    /// One whose table holds single bytes.
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
        let mut state = State { data, bit: 0, width: 9, next: FIRST, last: None, at: 0 };
        self.short[FIRST..].fill(0);
        while self.step(&mut state, out)? {
            match state.width {
                9 => self.run::<9>(&mut state, out),
                10 => self.run::<10>(&mut state, out),
                11 => self.run::<11>(&mut state, out),
                _ => self.run::<12>(&mut state, out),
            }
        }
        Ok(state.at)
    }

    /// Takes whole groups of codes of `WIDTH` bits while each is a string of the table that is shorter than [`SHORT`],
    /// as the last one was: the string that each makes then stands in the table too.
    fn run<const WIDTH: usize>(&mut self, state: &mut State, out: &mut [u8]) {
        let Some((mut last, _)) = state.last.filter(|(last, _)| length_of(*last) < SHORT) else { return };
        let (mut bit, mut next, mut at) = (state.bit, state.next, state.at);
        // One before the code with which the width changes, or the table is full.
        let end = if WIDTH == 12 { CODES } else { (1 << WIDTH) - 1 };
        'groups: while next + GROUP <= end && at + 8 * GROUP <= out.len() {
            let Some(word) = state.data[bit / 8..].first_chunk::<8>() else { break };
            let mut word = u64::from_be_bytes(*word) << (bit % 8);
            for _ in 0..GROUP {
                let code = (word >> (64 - WIDTH)) as usize;
                word <<= WIDTH;
                let short = self.short[code];
                let length = length_of(short);
                // 0 is a code without a string, which the step tells from the others.
                if length.wrapping_sub(1) >= SHORT - 1 {
                    break 'groups;
                }
                // Nothing stands behind the string, so that what is above its length is 8 times that.
                self.short[next] = (last + (1 << 56)) | (short & 0xFF) << (last >> 53);
                out[at..at + 8].copy_from_slice(&short.to_le_bytes());
                last = short;
                next += 1;
                at += length;
                bit += WIDTH;
            }
        }
        let length = length_of(last);
        state.last = Some((last, Place { position: (at - length) as u32, length: length as u32 }));
        state.width += usize::from(WIDTH < 12 && next == end);
        (state.bit, state.next, state.at) = (bit, next, at);
    }

    /// Takes one code, whatever it is. False at the end.
    fn step(&mut self, state: &mut State, out: &mut [u8]) -> Result<bool, String> {
        if state.at == out.len() {
            return Ok(false);
        }
        let Some(code) = state.code() else { return Ok(false) };
        if code == CLEAR {
            self.short[FIRST..state.next].fill(0);
            (state.next, state.width, state.last) = (FIRST, 9, None);
            return Ok(true);
        }
        if code == END {
            return Ok(false);
        }
        if let Some(last) = state.last
            && state.next < CODES
        {
            // A code that is made by this very step begins as the last string did.
            let begins = if code == state.next { last.0 } else { self.short[code] };
            self.add(state.next, last, begins as u8);
            state.next += 1;
            state.width += usize::from(state.next + 1 == 1 << state.width && state.width < 12);
        }
        let at = state.at;
        if code >= state.next {
            return Err(format!("LZW: code {code} comes before it exists, after {at} bytes"));
        }
        let short = self.short[code];
        let mut length = length_of(short);
        if length > SHORT {
            let place = self.long[code];
            length = copy(out, place.position as usize, at, place.length as usize);
        } else if at + 8 <= out.len() {
            out[at..at + 8].copy_from_slice(&short.to_le_bytes());
        } else {
            length = length.min(out.len() - at);
            out[at..at + length].copy_from_slice(&short.to_le_bytes()[..length]);
        }
        state.last = Some((short, Place { position: at as u32, length: length as u32 }));
        state.at += length;
        Ok(true)
    }

    /// The string `last` and one byte more becomes entry `code`. It lies in the output where `last` does: the byte is
    /// the one behind it.
    fn add(&mut self, code: usize, (short, Place { position, length }): (u64, Place), byte: u8) {
        if (length as usize) < SHORT {
            let bytes = short & BYTES | u64::from(byte) << (8 * length);
            self.short[code] = bytes | u64::from(length + 1) << 56;
        } else {
            self.short[code] = short & BYTES | (SHORT as u64 + 1) << 56;
            self.long[code] = Place { position, length: length + 1 };
        }
    }
}

impl State<'_> {
    /// The next code; `None` when there are not enough bits for one.
    fn code(&mut self) -> Option<usize> {
        if self.bit + self.width > self.data.len() * 8 {
            return None;
        }
        let rest = &self.data[self.bit / 8..];
        let mut four = [0; 4];
        let some = rest.len().min(4);
        four[..some].copy_from_slice(&rest[..some]);
        let code = (u32::from_be_bytes(four) << (self.bit % 8)) >> (32 - self.width);
        self.bit += self.width;
        Some(code as usize)
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
    // SAFETY: the last word begins below `to + length`, so that it ends below `to + length + WORD`, which lies in
    // `out`; `from < to`, so the words read do too. Both come from one unique borrow, and each word is read before it
    // is written.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn encode(bytes: &[u8]) -> Vec<u8> {
        weezl::encode::Encoder::with_tiff_size_switch(weezl::BitOrder::Msb, 8).encode(bytes).expect("encodes anything")
    }

    fn noise(length: usize) -> Vec<u8> {
        let mut seed = 1u32;
        let mut next = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 24) as u8
        };
        (0..length).map(|_| next()).collect()
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
        // So do data that end early, by a decoder whose table is full of other strings.
        let mut used = Decoder::new();
        assert_eq!(used.decode(&encode(&noise(20_000)), &mut vec![0; 20_000]), Ok(20_000));
        for eighths in 0..8 {
            let written =
                used.decode(&data[..data.len() * eighths / 8], &mut out).expect("a part holds no other codes");
            assert_eq!(out[..written], bytes[..written]);
            assert!(eighths < 2 || bytes.len() < 5000 || written > 0);
        }
    }

    #[test]
    fn runs_noise_and_photographs_like_data_come_back() {
        for length in [0, 1, 2, 15, 16, 17, 255, 5000, 300_000] {
            check(&vec![7; length]);
            check(&(0..length).map(|i| (i * i / 7 % 251) as u8).collect::<Vec<_>>());
            let noise = noise(length);
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
