//! Huffman codes of a baseline scan: bits from the stream, tables, and one block's coefficients (ITU-T T.81, 1992,
//! annex F.2).

/// Bits answered by one look into a table.
const LOOK: u32 = 10;
/// A table's entry holds the coefficient itself, not only how many bits of it follow.
const WHOLE: u32 = 0x80;

/// Index in a block of the k-th coefficient as it is stored, along diagonals.
const ZIGZAG: [u8; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7, 14, 21,
    28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54,
    47, 55, 62, 63,
];

/// What cannot be decoded here: broken data, or more than baseline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotDecoded;

/// One Huffman table.
pub struct Table {
    /// Counts of the codes of 1 to 16 bits and the symbols, as in the stream: says whether another is the same.
    spec: Vec<u8>,
    /// By the next [`LOOK`] bits: length in bits 0 to 5 (0: a longer code), [`WHOLE`], run in 8 to 11, size in 12 to
    /// 15, value in 16 to 31.
    fast: Box<[u32; 1 << LOOK]>,
    /// First code of each length beyond the codes of that length, aligned to 16 bits; of 17 above all.
    beyond: [u32; 18],
    /// What to add to a code of each length for its symbol's index.
    offset: [i32; 17],
}

impl Table {
    /// From the sixteen counts and the symbols of a DHT segment.
    ///
    /// # Errors
    /// When the segment is short, holds more codes of a length than there are, or another number of symbols than its
    /// counts say.
    pub fn new(spec: &[u8]) -> Result<Table, NotDecoded> {
        let (counts, symbols) = spec.split_at_checked(16).ok_or(NotDecoded)?;
        let mut table =
            Table { spec: spec.to_vec(), fast: Box::new([0; 1 << LOOK]), beyond: [u32::MAX; 18], offset: [0; 17] };
        let (mut code, mut index) = (0u32, 0usize);
        for length in 1..=16u32 {
            table.offset[length as usize] = index as i32 - code as i32;
            for _ in 0..counts[length as usize - 1] {
                let symbol = *symbols.get(index).ok_or(NotDecoded)?;
                if code >= 1 << length {
                    return Err(NotDecoded);
                }
                if length <= LOOK {
                    let start = (code << (LOOK - length)) as usize;
                    for bits in start..start + (1 << (LOOK - length)) {
                        table.fast[bits] = entry(bits as u32, length, symbol);
                    }
                }
                code += 1;
                index += 1;
            }
            table.beyond[length as usize] = code << (16 - length);
            code <<= 1;
        }
        if index == symbols.len() { Ok(table) } else { Err(NotDecoded) }
    }

    /// Whether it was made of these bytes of a DHT segment.
    pub fn is(&self, spec: &[u8]) -> bool {
        self.spec == spec
    }

    /// Length and symbol of a code longer than [`LOOK`], from the next sixteen bits.
    #[cold]
    fn long_code(&self, bits: u32) -> Result<(u32, u8), NotDecoded> {
        let length = (LOOK + 1..=16).find(|&length| bits < self.beyond[length as usize]).ok_or(NotDecoded)?;
        let index = (bits >> (16 - length)) as i32 + self.offset[length as usize];
        let symbol = usize::try_from(index).ok().and_then(|index| self.spec[16..].get(index)).ok_or(NotDecoded)?;
        Ok((length, *symbol))
    }
}

fn entry(bits: u32, length: u32, symbol: u8) -> u32 {
    let (run, size) = (u32::from(symbol >> 4), u32::from(symbol & 15));
    let place = run << 8 | size << 12;
    if length + size > LOOK {
        return length | place;
    }
    let raw = bits >> (LOOK - length - size) & ((1 << size) - 1);
    let value = extended(raw, size) as u16;
    (length + size) | WHOLE | place | u32::from(value) << 16
}

/// The number that `size` bits stand for (T.81, F.2.2.1: EXTEND).
#[inline(always)]
fn extended(raw: u32, size: u32) -> i32 {
    if size == 0 {
        return 0;
    }
    if raw >> (size - 1) == 0 { raw as i32 - (1 << size) + 1 } else { raw as i32 }
}

/// The stream's bits, stuffed zeros left out. Beyond its end, or a marker, come zeros, which [`Bits::sound`] tells.
pub struct Bits<'a> {
    /// What has not come into the buffer.
    data: &'a [u8],
    /// The next bits, from the top. Below `count` bits are those that the next filling sets again.
    buffer: u64,
    count: u32,
    /// Bytes of zero that were no data.
    lent: u32,
}

impl<'a> Bits<'a> {
    /// Of the bytes behind the header of a scan.
    pub fn new(data: &'a [u8]) -> Self {
        Bits { data, buffer: 0, count: 0, lent: 0 }
    }

    /// At least 32 bits.
    #[inline(always)]
    fn fill(&mut self) {
        if self.count >= 32 {
            return;
        }
        if let Some(bytes) = self.data.first_chunk::<8>() {
            let word = u64::from_be_bytes(*bytes);
            // Any byte of 255 is a zero byte of the complement.
            let inverse = !word;
            if inverse.wrapping_sub(0x0101_0101_0101_0101) & !inverse & 0x8080_8080_8080_8080 == 0 {
                self.buffer |= word >> self.count;
                self.data = &self.data[((63 - self.count) >> 3) as usize..];
                self.count |= 56;
                return;
            }
        }
        self.fill_slowly();
    }

    #[cold]
    fn fill_slowly(&mut self) {
        while self.count <= 56 {
            let byte = match self.data {
                [0xFF, 0, rest @ ..] => {
                    self.data = rest;
                    0xFF
                }
                [0xFF, ..] | [] => {
                    self.lent += 1;
                    0
                }
                [byte, rest @ ..] => {
                    self.data = rest;
                    *byte
                }
            };
            self.buffer |= u64::from(byte) << (56 - self.count);
            self.count += 8;
        }
    }

    #[inline(always)]
    fn drop_bits(&mut self, count: u32) {
        self.buffer <<= count;
        self.count -= count;
    }

    /// Whether all bits taken so far were data.
    pub fn sound(&self) -> bool {
        self.lent * 8 <= self.count
    }

    /// Goes on behind a restart marker, which must come next.
    ///
    /// # Errors
    /// When the bits before it were not all data or are not all taken, or another marker comes next.
    pub fn restart(&mut self, number: u8) -> Result<(), NotDecoded> {
        if !self.sound() || self.count - self.lent * 8 >= 8 {
            return Err(NotDecoded);
        }
        while self.data.starts_with(&[0xFF, 0xFF]) {
            self.data = &self.data[1..];
        }
        let rest = self.data.strip_prefix(&[0xFF, 0xD0 + number]).ok_or(NotDecoded)?;
        *self = Bits::new(rest);
        Ok(())
    }

    /// One code with what follows it: run and value, the value 0 when no bits follow.
    #[inline(always)]
    fn next(&mut self, table: &Table) -> Result<(usize, i32), NotDecoded> {
        self.fill();
        let entry = table.fast[(self.buffer >> (64 - LOOK)) as usize];
        if entry & WHOLE != 0 {
            self.drop_bits(entry & 63);
            return Ok(((entry >> 8 & 15) as usize, entry as i32 >> 16));
        }
        let (length, run, size) = match entry & 63 {
            0 => {
                let (length, symbol) = table.long_code((self.buffer >> 48) as u32)?;
                (length, u32::from(symbol >> 4), u32::from(symbol & 15))
            }
            length => (length, entry >> 8 & 15, entry >> 12 & 15),
        };
        self.drop_bits(length);
        let raw = if size == 0 { 0 } else { (self.buffer >> (64 - size)) as u32 };
        self.drop_bits(size);
        Ok((run as usize, extended(raw, size)))
    }
}

/// Tables of one component, and its last DC coefficient.
pub struct Codes<'a> {
    pub dc: &'a Table,
    pub ac: &'a Table,
    pub places: [Place; 64],
}

/// Where the k-th coefficient of a block goes, and its step.
#[derive(Clone, Copy)]
pub struct Place {
    step: i16,
    index: u8,
}

/// The places of coefficients with these steps, both along the diagonals.
pub fn places(steps: &[u16; 64]) -> [Place; 64] {
    std::array::from_fn(|k| Place { step: steps[k] as i16, index: ZIGZAG[k] })
}

/// Decodes one block into `coefficients`, which must be zero, each multiplied by its step (wrapping, as all decoders in
/// sixteen bits do). Answers the index along the diagonals of the last one that is not zero.
#[inline(always)]
pub fn block(
    bits: &mut Bits<'_>,
    codes: &Codes<'_>,
    last_dc: &mut i32,
    coefficients: &mut [i16; 64],
) -> Result<usize, NotDecoded> {
    let (run, difference) = bits.next(codes.dc)?;
    if run != 0 {
        return Err(NotDecoded);
    }
    *last_dc = last_dc.wrapping_add(difference);
    coefficients[0] = (*last_dc as i16).wrapping_mul(codes.places[0].step);
    let (mut k, mut last) = (1, 0);
    while k < 64 {
        let (run, value) = bits.next(codes.ac)?;
        k += run;
        if value == 0 {
            if run != 15 {
                break;
            }
            k += 1;
            continue;
        }
        let place = codes.places.get(k).ok_or(NotDecoded)?;
        coefficients[usize::from(place.index & 63)] = (value as i16).wrapping_mul(place.step);
        last = k;
        k += 1;
    }
    Ok(last)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// T.81, table K.3: DC differences of luminance.
    const DC: [u8; 28] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];

    #[test]
    fn codes_short_and_long_are_read_by_hand() {
        let table = Table::new(&DC).expect("a table");
        // 00: size 0. 010 1: size 1, +1. 010 0: -1. 1110 10000: size 5? codes: 100 size 3, 101 size 4, 110 size 5, 1110
        // size 6. 111111110 (9 bits): size 11, then 11 bits of 0: -2047.
        let text = "00 0101 0100 110 10000 111111110 00000000000".replace(' ', "");
        let mut bytes: Vec<u8> =
            text.as_bytes().chunks(8).map(|c| c.iter().fold(0, |b, d| b << 1 | (d - b'0')) << (8 - c.len())).collect();
        bytes.extend([0xFF, 0xD9]);
        let mut bits = Bits::new(&bytes);
        let read: Vec<i32> = (0..5).map(|_| bits.next(&table).expect("a code").1).collect();
        assert_eq!(read, [0, 1, -1, 16, -2047]);
        assert!(bits.sound());
        (0..5).for_each(|_| _ = bits.next(&table));
        assert!(!bits.sound());
    }

    #[test]
    fn stuffed_zeros_are_left_out_and_tables_that_overflow_are_refused() {
        let mut bits = Bits::new(&[0xFF, 0x00, 0x12, 0xFF, 0x00, 0xFF, 0xD3, 0x34, 1, 2, 3, 4, 5, 6, 7, 8, 9]);
        bits.fill();
        assert_eq!(bits.buffer >> 40, 0xFF_12FF);
        bits.drop_bits(20);
        assert!(bits.restart(3).is_ok());
        bits.fill();
        assert_eq!(bits.buffer >> 56, 0x34);
        assert!(bits.restart(0).is_err());
        let mut three_of_one_bit = [0u8; 19];
        three_of_one_bit[0] = 3;
        assert!(Table::new(&three_of_one_bit).is_err());
        assert!(Table::new(&[0; 15]).is_err());
    }
}
