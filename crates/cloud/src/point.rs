//! A point as the cleaning chain passes it on: in memory and as a record of a scratch file.

use crate::schema::array;

/// Bytes of a point in a scratch file.
pub(crate) const RECORD_BYTES: usize = 32;
const INDEX_BITS: u32 = 48;
const INDEX_MASK: u64 = (1 << INDEX_BITS) - 1;

/// A point in the cleaning chain: place, number in its file, and what the steps found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub xyz: [f64; 3],
    tag: u64,
}

impl Point {
    /// A point that no step has seen; `index` is its place in the file, from 0.
    pub fn new(xyz: [f64; 3], index: u64) -> Point {
        Point { xyz, tag: index & INDEX_MASK }
    }
    /// Its place in the file, from 0.
    pub fn index(&self) -> u64 {
        self.tag & INDEX_MASK
    }
    /// The class that a step gave it; 0 when none did.
    pub fn class(&self) -> u8 {
        (self.tag >> INDEX_BITS) as u8
    }
    /// The number of the step that classified it, from 1; 0 when none did. The top bit says that it is out.
    pub(crate) fn step_byte(&self) -> u8 {
        (self.tag >> 56) as u8
    }
    /// The number of the step that classified it, from 1; 0 when none did.
    pub fn step(&self) -> u8 {
        self.step_byte() & 0x7f
    }
    /// Whether later steps still see it.
    pub fn is_active(&self) -> bool {
        self.step_byte() & 0x80 == 0
    }
    /// Gives it a class; the steps that follow still see it.
    pub fn classify(&mut self, class: u8, step: u8) {
        self.tag = (self.tag & INDEX_MASK) | u64::from(class) << INDEX_BITS | u64::from(step & 0x7f) << 56;
    }
    /// Gives it a class and takes it from the steps that follow.
    pub fn take_out(&mut self, class: u8, step: u8) {
        self.classify(class, step);
        self.tag |= 0x80 << 56;
    }
    /// Takes it from all steps, and leaves its class as it came.
    pub(crate) fn withhold(&mut self) {
        self.tag |= 0x80 << 56;
    }
    pub(crate) fn encode(&self) -> [u8; RECORD_BYTES] {
        let mut bytes = [0; RECORD_BYTES];
        for axis in 0..3 {
            bytes[8 * axis..8 * axis + 8].copy_from_slice(&self.xyz[axis].to_le_bytes());
        }
        bytes[24..].copy_from_slice(&self.tag.to_le_bytes());
        bytes
    }
    pub(crate) fn decode(bytes: &[u8]) -> Point {
        let xyz = [0, 8, 16].map(|at| f64::from_le_bytes(array(&bytes[at..])));
        Point { xyz, tag: u64::from_le_bytes(array(&bytes[24..])) }
    }
}
