//! The units of a scan (blocks of all components that belong together) to samples in the planes.
#![allow(unsafe_code)]

use super::entropy::{self, Bits, Codes, NotDecoded};
use super::{Frame, Kernel, Shape, transform};

/// The units of a scan, from its first to its last.
pub struct Units<'a> {
    bits: Bits<'a>,
    frame: &'a Frame,
    shape: &'a Shape,
    codes: Vec<Codes<'a>>,
    last_dc: [i32; 3],
    done: usize,
}

impl<'a> Units<'a> {
    /// `codes` are those of the frame's components.
    pub fn new(bits: Bits<'a>, frame: &'a Frame, shape: &'a Shape, codes: Vec<Codes<'a>>) -> Self {
        Units { bits, frame, shape, codes, last_dc: [0; 3], done: 0 }
    }

    /// Whether all that was read was in the stream.
    pub fn sound(&self) -> bool {
        self.bits.sound()
    }

    /// One row of units into the half of the planes that `slot` says.
    ///
    /// # Errors
    /// When a restart marker is missing, or a code or a value is none of the tables.
    pub fn row(&mut self, kernel: Kernel, slot: usize, planes: &mut [Vec<u8>; 3]) -> Result<(), NotDecoded> {
        match kernel {
            Kernel::Scalar => self.row_by(kernel, slot, planes),
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the kernel is only chosen where the processor has AVX2 and BMI2.
            Kernel::Avx2 => unsafe { self.row_avx2(slot, planes) },
        }
    }

    /// The same code, and shifts that cost less.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,bmi2")]
    fn row_avx2(&mut self, slot: usize, planes: &mut [Vec<u8>; 3]) -> Result<(), NotDecoded> {
        self.row_by(Kernel::Avx2, slot, planes)
    }

    #[inline(always)]
    fn row_by(&mut self, kernel: Kernel, slot: usize, planes: &mut [Vec<u8>; 3]) -> Result<(), NotDecoded> {
        let (frame, shape) = (self.frame, self.shape);
        // Blocks of a unit: their component and place in it.
        let mut places = Vec::with_capacity(6);
        for (c, component) in frame.components.iter().enumerate() {
            places.extend((0..component.down).flat_map(|v| (0..component.across).map(move |h| (c, h, v))));
        }
        for unit in 0..shape.units {
            if frame.restart > 0 && self.done > 0 && self.done.is_multiple_of(frame.restart) {
                self.bits.restart((self.done / frame.restart - 1) as u8 % 8)?;
                self.last_dc = [0; 3];
            }
            self.done += 1;
            for two in places.chunks(2) {
                let mut coefficients = [[0i16; 64]; 2];
                let mut last = [0; 2];
                for (i, (c, ..)) in two.iter().enumerate() {
                    let (codes, dc) = (&self.codes[*c], &mut self.last_dc[*c]);
                    last[i] = entropy::block(&mut self.bits, codes, dc, &mut coefficients[i])?;
                }
                let start = |&(c, h, v): &(usize, usize, usize)| {
                    let component = &frame.components[c];
                    let (row, stride) = (8 * (slot * component.down + v), shape.stride(component));
                    (row * stride + 8 * (unit * component.across + h), stride)
                };
                let pixels = transform::two_blocks(kernel, &coefficients, last);
                for (place, block) in two.iter().zip(&pixels) {
                    let (from, stride) = start(place);
                    transform::put(block, &mut planes[place.0][from..], stride);
                }
            }
        }
        Ok(())
    }
}
