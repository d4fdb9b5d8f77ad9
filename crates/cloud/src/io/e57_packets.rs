//! The binary part of E57: pages with checksums, in them packets, in these the packed bits of each attribute.

use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::schema::array;

const PAGE_BYTES: usize = 1024;
/// A page without its checksum.
const CONTENT_BYTES: usize = PAGE_BYTES - 4;
/// Programs write as many values of each attribute into a packet; a file that does not must not fill the memory.
const MOST_AHEAD_BYTES: usize = 16 << 20;

/// CRC-32C (Castagnoli) of a byte and of the seven before it.
const CHECKSUMS: [[u32; 256]; 8] = {
    let mut tables = [[0; 256]; 8];
    let mut byte = 0;
    while byte < 256 {
        let mut value = byte as u32;
        let mut bit = 0;
        while bit < 8 {
            value = if value & 1 == 1 { (value >> 1) ^ 0x82f6_3b78 } else { value >> 1 };
            bit += 1;
        }
        tables[0][byte] = value;
        byte += 1;
    }
    let mut table = 1;
    while table < 8 {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[table - 1][byte];
            tables[table][byte] = (before >> 8) ^ tables[0][(before & 0xff) as usize];
            byte += 1;
        }
        table += 1;
    }
    tables
};

/// CRC-32C, eight bytes a step.
fn checksum(bytes: &[u8]) -> u32 {
    let mut value = !0u32;
    let mut words = bytes.chunks_exact(8);
    for word in &mut words {
        let mixed = u64::from_le_bytes(array(word)) ^ u64::from(value);
        value = (0..8).fold(0, |sum, at| sum ^ CHECKSUMS[7 - at][(mixed >> (8 * at)) as usize & 0xff]);
    }
    !words
        .remainder()
        .iter()
        .fold(value, |value, &byte| (value >> 8) ^ CHECKSUMS[0][((value ^ u32::from(byte)) & 0xff) as usize])
}

/// A file without the checksums that end its pages; each is compared when its page is read.
struct Pages {
    path: PathBuf,
    file: BufReader<File>,
    pages: u64,
    page: Box<[u8; PAGE_BYTES]>,
    /// The page at hand.
    loaded: Option<u64>,
    /// Of the next byte, checksums not counted.
    place: u64,
}

impl Pages {
    /// Goes to a place that counts checksums.
    fn seek(&mut self, byte: u64) {
        let page = PAGE_BYTES as u64;
        self.place = byte / page * CONTENT_BYTES as u64 + (byte % page).min(CONTENT_BYTES as u64);
    }

    fn load(&mut self, page: u64) -> Result<()> {
        if self.loaded == Some(page) {
            return Ok(());
        }
        let place = || format!("page {} of {}", page + 1, self.pages);
        if page >= self.pages {
            return Err(Error::format(&self.path, place(), "the file ends before: it is truncated"));
        }
        let follows = self.loaded.is_some_and(|loaded| loaded + 1 == page);
        self.loaded = None;
        if !follows {
            let begin = SeekFrom::Start(page * PAGE_BYTES as u64);
            self.file.seek(begin).map_err(|e| Error::io(&self.path, "seek", e))?;
        }
        self.file.read_exact(&mut self.page[..]).map_err(|e| Error::io(&self.path, "read", e))?;
        // Big-endian, against the rule for all other numbers of the format.
        if checksum(&self.page[..CONTENT_BYTES]) != u32::from_be_bytes(array(&self.page[CONTENT_BYTES..])) {
            let what = "its checksum is another: the file is damaged";
            return Err(Error::format(&self.path, place(), what));
        }
        self.loaded = Some(page);
        Ok(())
    }

    fn read(&mut self, mut bytes: &mut [u8]) -> Result<()> {
        while !bytes.is_empty() {
            let content = CONTENT_BYTES as u64;
            self.load(self.place / content)?;
            let begin = (self.place % content) as usize;
            let count = bytes.len().min(CONTENT_BYTES - begin);
            let (now, later) = bytes.split_at_mut(count);
            now.copy_from_slice(&self.page[begin..begin + count]);
            bytes = later;
            self.place += count as u64;
        }
        Ok(())
    }
}

/// Values of one attribute, as many bits each.
#[derive(Default)]
struct Stream {
    width: u32,
    bytes: Vec<u8>,
    /// Bits that were taken.
    taken: usize,
}

impl Stream {
    /// Values that are there; without bits they are always there.
    fn values(&self) -> usize {
        (8 * self.bytes.len() - self.taken).checked_div(self.width as usize).unwrap_or(usize::MAX)
    }

    /// The next value, which must be there.
    fn take(&mut self) -> u64 {
        if self.width == 0 {
            return 0;
        }
        let (begin, right) = (self.taken / 8, self.taken % 8);
        let there = &self.bytes[begin..self.bytes.len().min(begin + 16)];
        let mut word = [0; 16];
        word[..there.len()].copy_from_slice(there);
        self.taken += self.width as usize;
        (u128::from_le_bytes(word) >> right) as u64 & (u64::MAX >> (64 - self.width))
    }
}

/// The points of a scan, as the bits of their attributes.
pub(super) struct Packets {
    pages: Pages,
    streams: Vec<Stream>,
    /// Points whose values are all at hand.
    ready: usize,
    /// Where the section of the scan ends, checksums not counted.
    end: u64,
}

impl Packets {
    /// `bytes` is the length of the file.
    pub(super) fn new(path: &Path, file: File, bytes: u64) -> Self {
        let pages = Pages {
            path: path.to_path_buf(),
            file: BufReader::with_capacity(1 << 20, file),
            pages: bytes / PAGE_BYTES as u64,
            page: Box::new([0; PAGE_BYTES]),
            loaded: None,
            place: 0,
        };
        Packets { pages, streams: Vec::new(), ready: 0, end: 0 }
    }

    /// Goes to the scan whose section begins at `byte`, with attributes of these widths in bits.
    pub(super) fn begin(&mut self, byte: u64, widths: impl Iterator<Item = u32>) -> Result<()> {
        self.streams = widths.map(|width| Stream { width, ..Stream::default() }).collect();
        self.ready = 0;
        self.pages.seek(byte);
        let begin = self.pages.place;
        let mut head = [0; 32];
        self.pages.read(&mut head)?;
        if head[0] != 1 {
            let place = format!("section at byte {byte}");
            return Err(Error::format(
                &self.pages.path,
                place,
                format!("points are in sections of type 1, not {}", head[0]),
            ));
        }
        self.end = begin.saturating_add(u64::from_le_bytes(array(&head[8..])));
        self.pages.seek(u64::from_le_bytes(array(&head[16..])));
        Ok(())
    }

    /// The bits of each attribute of the next point.
    pub(super) fn next(&mut self, values: &mut [u64]) -> Result<()> {
        while self.ready == 0 {
            self.read_packet()?;
            self.ready = self.streams.iter().map(Stream::values).min().unwrap_or(0);
        }
        self.ready -= 1;
        for (value, stream) in values.iter_mut().zip(&mut self.streams) {
            *value = stream.take();
        }
        Ok(())
    }

    fn read_packet(&mut self) -> Result<()> {
        const INDEX: u8 = 0;
        const DATA: u8 = 1;
        const IGNORED: u8 = 2;
        let begin = self.pages.place;
        let path = self.pages.path.clone();
        let content = CONTENT_BYTES as u64;
        let byte = begin / content * PAGE_BYTES as u64 + begin % content;
        let bad = |what: String| Error::format(&path, format!("packet at byte {byte}"), what);
        if begin >= self.end {
            return Err(bad("the section of the scan ends before: it holds fewer points than it counts".into()));
        }
        let mut head = [0; 4];
        self.pages.read(&mut head)?;
        let length = usize::from(u16::from_le_bytes([head[2], head[3]])) + 1;
        if !length.is_multiple_of(4) {
            return Err(bad(format!("{length} bytes, which is no multiple of 4")));
        }
        match head[0] {
            DATA => self.read_streams(length).map_err(|error| match error {
                Wrong::Packet(what) => bad(what),
                Wrong::File(error) => error,
            })?,
            INDEX | IGNORED => {}
            other => return Err(bad(format!("type {other}, which E57 has not"))),
        }
        self.pages.place = begin + length as u64;
        Ok(())
    }

    /// Appends what a packet of `length` bytes holds to the streams.
    fn read_streams(&mut self, length: usize) -> Result<(), Wrong> {
        let mut word = [0; 2];
        self.pages.read(&mut word)?;
        let count = usize::from(u16::from_le_bytes(word));
        if count != self.streams.len() {
            return Err(Wrong::Packet(format!("{count} attributes, the scan has {}", self.streams.len())));
        }
        let mut lengths = vec![0; 2 * count];
        self.pages.read(&mut lengths)?;
        let lengths = || lengths.chunks_exact(2).map(|word| usize::from(u16::from_le_bytes(array(word))));
        if 6 + 2 * count + lengths().sum::<usize>() > length {
            return Err(Wrong::Packet(format!("its attributes do not fit into its {length} bytes")));
        }
        for (stream, length) in self.streams.iter_mut().zip(lengths()) {
            stream.bytes.drain(..stream.taken / 8);
            stream.taken %= 8;
            let begin = stream.bytes.len();
            stream.bytes.resize(begin + length, 0);
            self.pages.read(&mut stream.bytes[begin..])?;
        }
        if self.streams.iter().map(|stream| stream.bytes.len()).sum::<usize>() > MOST_AHEAD_BYTES {
            return Err(Wrong::Packet(format!("values of some attributes come over {MOST_AHEAD_BYTES} bytes late")));
        }
        Ok(())
    }
}

/// What is wrong: the packet, or the pages under it.
enum Wrong {
    Packet(String),
    File(Error),
}

impl From<Error> for Wrong {
    fn from(error: Error) -> Self {
        Wrong::File(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_rfc_3720() {
        assert_eq!(checksum(&[0; 32]), 0x8a91_36aa);
        assert_eq!(checksum(&[0xff; 32]), 0x62a8_ab43);
        assert_eq!(checksum(&std::array::from_fn::<u8, 32, _>(|at| at as u8)), 0x46dd_794e);
        assert_eq!(checksum(b"123456789"), 0xe306_9283);
    }

    #[test]
    fn bits_of_any_width_come_back() {
        for width in 1..=64u32 {
            let values: Vec<u64> = (0..40u64).map(|n| n.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (64 - width)).collect();
            let mut bytes = vec![0u8; (40 * width as usize).div_ceil(8)];
            for (number, value) in values.iter().enumerate() {
                for bit in (0..width as usize).filter(|bit| value >> bit & 1 == 1) {
                    let place = number * width as usize + bit;
                    bytes[place / 8] |= 1 << (place % 8);
                }
            }
            let mut stream = Stream { width, bytes, taken: 0 };
            assert!(stream.values() >= 40 && stream.values() < 48, "{width}");
            assert!(values.iter().all(|value| stream.take() == *value), "{width}");
        }
    }

    #[test]
    fn packets_of_no_points_are_passed_over() {
        let mut page = vec![0; 48];
        // Head of the section, an ignored packet of 8 bytes, one of the index of 32, and two values of 16 bits.
        page.extend([1, 0, 0, 0, 0, 0, 0, 0]);
        [32 + 8 + 32 + 12, 80, 0u64].iter().for_each(|word| page.extend(word.to_le_bytes()));
        page.extend([2, 0, 7, 0, 9, 9, 9, 9]);
        page.extend([&[0, 0, 31, 0, 1][..], &[0; 27]].concat());
        page.extend([1, 0, 11, 0, 1, 0, 4, 0, 1, 2, 3, 4]);
        page.resize(CONTENT_BYTES, 0);
        page.extend(checksum(&page).to_be_bytes());
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(file.path(), page).expect("written");
        let mut packets = Packets::new(file.path(), file.reopen().expect("there"), PAGE_BYTES as u64);
        packets.begin(48, [16].into_iter()).expect("a section");
        let mut value = [0];
        for expected in [0x0201, 0x0403] {
            packets.next(&mut value).expect("a point");
            assert_eq!(value, [expected]);
        }
        assert!(packets.next(&mut value).expect_err("no third").to_string().contains("fewer points"));
    }
}
