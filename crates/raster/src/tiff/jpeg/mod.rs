//! Baseline JPEG blocks of a TIFF, as orthophotos have them: eight bits, Huffman codes, one scan, grey or three
//! components of which the last two may have half the width or half of both sides (ITU-T T.81, 1992; TIFF Technical
//! Note 2, 1995).
//!
//! Decoded in strips of one row of blocks, which stay in the nearest caches until they are pixels, straight into the
//! caller's buffer. The pixels are those of libjpeg with its default settings, to the last bit. What is not of this
//! kind, or is broken, is not decoded here at all ([`NotDecoded`]): the caller has another decoder for it.
//!
//! `entropy` reads codes, `units` goes through the scan, `transform` and `colour` have the arithmetic with its scalar
//! and vector kernels.

mod colour;
mod entropy;
mod transform;
mod units;

pub use entropy::NotDecoded;
use entropy::{Bits, Codes, Table};
use units::Units;

/// Which kernel to take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Avx2,
}

impl Kernel {
    /// All that this processor has, the fastest last.
    pub fn all() -> Vec<Self> {
        let mut all = vec![Kernel::Scalar];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2") {
            all.push(Kernel::Avx2);
        }
        all
    }

    /// The fastest; the scalar one where [`crate::simd::Kernels`] asks for it.
    pub fn best() -> Self {
        let all = Self::all();
        if crate::simd::Kernels::wanted() == crate::simd::Kernels::Scalar { all[0] } else { all[all.len() - 1] }
    }
}

/// What the pixels of a block are to be.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    pub width: usize,
    /// From the top; the stream may have more.
    pub rows: usize,
    /// 1 or 3 samples a pixel.
    pub samples: usize,
    /// Three components are luma and chroma and become RGB; else they stay what they are.
    pub ycbcr: bool,
}

/// Tables and buffers, kept from block to block.
pub struct Decoder {
    kernel: Kernel,
    huffman: [Vec<Option<Table>>; 2],
    /// Of the present block: which tables it has defined.
    defined: [[bool; 4]; 2],
    steps: [Option<[u16; 64]>; 4],
    buffers: Buffers,
}

#[derive(Default)]
struct Buffers {
    /// Of each component, two rows of units: the present one and the one before.
    planes: [Vec<u8>; 3],
    /// One row of chroma as wide as the picture, and room for the sums on the way.
    wide: [Vec<u8>; 2],
    sums: Vec<i16>,
}

/// What the header of the frame says of a component.
#[derive(Clone, Copy, Default)]
struct Component {
    id: u8,
    /// Blocks in a unit, across and down.
    across: usize,
    down: usize,
    steps: usize,
    dc: usize,
    ac: usize,
}

struct Frame {
    height: usize,
    components: Vec<Component>,
    /// Units between restart markers; 0 when there are none.
    restart: usize,
}

impl Decoder {
    /// One that has read no tables yet.
    pub fn new(kernel: Kernel) -> Self {
        let slots = || (0..4).map(|_| None).collect();
        Decoder {
            kernel,
            huffman: [slots(), slots()],
            defined: [[false; 4]; 2],
            steps: [None; 4],
            buffers: Buffers::default(),
        }
    }

    /// Fills `out` with the pixels of a block, interleaved. `tables` is a stream of tables only (tag 347).
    ///
    /// # Errors
    /// When the block is no baseline JPEG of the wanted form, or broken. `out` may then hold anything.
    ///
    /// # Panics
    /// When `out` has not `width · rows · samples` bytes.
    pub fn decode(
        &mut self,
        tables: Option<&[u8]>,
        data: &[u8],
        wanted: Wanted,
        out: &mut [u8],
    ) -> Result<(), NotDecoded> {
        assert_eq!(out.len(), wanted.width * wanted.rows * wanted.samples, "a buffer of the block's size");
        if !matches!(wanted.samples, 1 | 3) {
            return Err(NotDecoded);
        }
        (self.defined, self.steps) = ([[false; 4]; 2], [None; 4]);
        if let Some(tables) = tables
            && self.headers(tables, wanted)?.is_some()
        {
            return Err(NotDecoded);
        }
        let (frame, scan) = self.headers(data, wanted)?.ok_or(NotDecoded)?;
        self.scan(&frame, scan, wanted, out)
    }

    /// Reads segments up to the scan, and answers it with the frame; `None` when the stream ends before one.
    fn headers<'d>(&mut self, data: &'d [u8], wanted: Wanted) -> Result<Option<(Frame, &'d [u8])>, NotDecoded> {
        let mut rest = data.strip_prefix(&[0xFF, 0xD8]).ok_or(NotDecoded)?;
        let mut frame: Option<Frame> = None;
        let mut restart = 0;
        loop {
            let [0xFF, marker, behind @ ..] = rest else { return Err(NotDecoded) };
            match marker {
                0xD9 => return Ok(None),
                0xFF => {
                    rest = &rest[1..];
                    continue;
                }
                _ => {}
            }
            let (length, _) = behind.split_first_chunk::<2>().ok_or(NotDecoded)?;
            let length = usize::from(u16::from_be_bytes(*length));
            let (segment, next) = behind.split_at_checked(length).ok_or(NotDecoded)?;
            let segment = segment.get(2..).ok_or(NotDecoded)?;
            rest = next;
            match marker {
                0xDB => self.quantisation(segment)?,
                0xC4 => self.codes(segment)?,
                0xC0 | 0xC1 if frame.is_none() => frame = Some(frame_header(segment, wanted)?),
                0xDD => restart = usize::from(u16::from_be_bytes(segment.try_into().map_err(|_| NotDecoded)?)),
                0xDA => {
                    let mut frame = frame.ok_or(NotDecoded)?;
                    frame.restart = restart;
                    scan_header(segment, &mut frame.components)?;
                    return Ok(Some((frame, rest)));
                }
                // Adobe's marker says in its own way what the components are.
                0xEE => return Err(NotDecoded),
                0xE0..=0xEF | 0xFE => {}
                _ => return Err(NotDecoded),
            }
        }
    }

    fn quantisation(&mut self, mut segment: &[u8]) -> Result<(), NotDecoded> {
        while let Some((&head, rest)) = segment.split_first() {
            let slot = self.steps.get_mut(usize::from(head & 15)).ok_or(NotDecoded)?;
            let bytes = if head >> 4 == 0 { 1 } else { 2 };
            let (values, rest) = rest.split_at_checked(64 * bytes).ok_or(NotDecoded)?;
            let value = |k: usize| match bytes {
                1 => u16::from(values[k]),
                _ => u16::from_be_bytes([values[2 * k], values[2 * k + 1]]),
            };
            *slot = Some(std::array::from_fn(value));
            segment = rest;
        }
        Ok(())
    }

    fn codes(&mut self, mut segment: &[u8]) -> Result<(), NotDecoded> {
        while let Some((&head, rest)) = segment.split_first() {
            let (kind, slot) = (usize::from(head >> 4), usize::from(head & 15));
            if kind > 1 || slot > 3 {
                return Err(NotDecoded);
            }
            let counts = rest.get(..16).ok_or(NotDecoded)?;
            let length = 16 + counts.iter().map(|c| usize::from(*c)).sum::<usize>();
            let (spec, rest) = rest.split_at_checked(length).ok_or(NotDecoded)?;
            let table = &mut self.huffman[kind][slot];
            // Most blocks of a file have the same.
            if !table.as_ref().is_some_and(|table| table.is(spec)) {
                *table = Some(Table::new(spec)?);
            }
            self.defined[kind][slot] = true;
            segment = rest;
        }
        Ok(())
    }

    /// Decodes the scan, a row of units at a time, and writes the pixels whose chroma is known.
    fn scan(&mut self, frame: &Frame, data: &[u8], wanted: Wanted, out: &mut [u8]) -> Result<(), NotDecoded> {
        let shape = Shape::new(frame, wanted);
        let buffers = &mut self.buffers;
        for (plane, component) in buffers.planes.iter_mut().zip(&frame.components) {
            plane.resize(2 * 8 * component.down * shape.stride(component), 0);
        }
        buffers.wide.iter_mut().for_each(|row| row.resize(2 * shape.chroma_width, 0));
        buffers.sums.resize(shape.chroma_width + 2, 0);
        let mut codes = Vec::with_capacity(3);
        for component in &frame.components {
            if !self.defined[0][component.dc] || !self.defined[1][component.ac] {
                return Err(NotDecoded);
            }
            codes.push(Codes {
                dc: self.huffman[0][component.dc].as_ref().ok_or(NotDecoded)?,
                ac: self.huffman[1][component.ac].as_ref().ok_or(NotDecoded)?,
                places: entropy::places(self.steps[component.steps].as_ref().ok_or(NotDecoded)?),
            });
        }
        let mut units = Units::new(Bits::new(data), frame, &shape, codes);
        let mut written = 0;
        for row in 0..shape.unit_rows {
            units.row(self.kernel, row % 2, &mut buffers.planes)?;
            // The last row needs the chroma below it, unless there is none.
            let known =
                if row + 1 == shape.unit_rows { shape.height } else { (row + 1) * shape.unit_height - shape.late };
            let until = known.min(wanted.rows);
            for y in written..until {
                let pixels = &mut out[y * wanted.width * wanted.samples..][..wanted.width * wanted.samples];
                shape.write(self.kernel, y, wanted, buffers, pixels);
            }
            written = until.max(written);
            if written == wanted.rows {
                // What is left of the stream is of no interest, but what was read must have been there.
                return if units.sound() { Ok(()) } else { Err(NotDecoded) };
            }
        }
        Err(NotDecoded)
    }
}

fn frame_header(segment: &[u8], wanted: Wanted) -> Result<Frame, NotDecoded> {
    let [8, h1, h0, w1, w0, count, components @ ..] = segment else { return Err(NotDecoded) };
    let (height, width) = (u16::from_be_bytes([*h1, *h0]), u16::from_be_bytes([*w1, *w0]));
    let (height, width) = (usize::from(height), usize::from(width));
    let components: Vec<Component> = components
        .chunks_exact(3)
        .map(|c| Component {
            id: c[0],
            across: usize::from(c[1] >> 4),
            down: usize::from(c[1] & 15),
            steps: usize::from(c[2]),
            ..Component::default()
        })
        .collect();
    let as_wanted = width == wanted.width && height >= wanted.rows && height > 0 && wanted.rows > 0;
    if !as_wanted || components.len() != wanted.samples || usize::from(*count) != wanted.samples {
        return Err(NotDecoded);
    }
    let mut frame = Frame { height, components, restart: 0 };
    match frame.components.as_mut_slice() {
        // A single component is not interleaved: its units are blocks, whatever it says.
        [grey] => (grey.across, grey.down) = (1, 1),
        [luma, chroma @ ..] => {
            let sizes = matches!((luma.across, luma.down), (1, 1) | (2, 1) | (2, 2));
            // Three components may say by their names that they are no luma and chroma.
            let named = [luma.id, chroma[0].id, chroma[1].id] == *b"RGB";
            // Of so few samples libjpeg repeats each instead.
            let few = luma.across == 2 && width <= 4;
            if !sizes || few || chroma.iter().any(|c| (c.across, c.down) != (1, 1)) || (named && wanted.ycbcr) {
                return Err(NotDecoded);
            }
        }
        [] => return Err(NotDecoded),
    }
    if frame.components.iter().any(|c| c.steps > 3) {
        return Err(NotDecoded);
    }
    Ok(frame)
}

/// One scan of all components in their order.
fn scan_header(segment: &[u8], components: &mut [Component]) -> Result<(), NotDecoded> {
    let (head, spectrum) = segment.split_at_checked(1 + 2 * components.len()).ok_or(NotDecoded)?;
    if usize::from(head[0]) != components.len() || spectrum != [0, 63, 0] {
        return Err(NotDecoded);
    }
    for (component, chosen) in components.iter_mut().zip(head[1..].as_chunks::<2>().0) {
        (component.dc, component.ac) = (usize::from(chosen[1] >> 4), usize::from(chosen[1] & 15));
        if component.id != chosen[0] || component.dc > 3 || component.ac > 3 {
            return Err(NotDecoded);
        }
    }
    Ok(())
}

/// Sizes of a block's units and planes.
struct Shape {
    /// Units of the picture, across and down.
    units: usize,
    unit_rows: usize,
    unit_height: usize,
    height: usize,
    chroma_width: usize,
    chroma_height: usize,
    /// Luma samples to one of chroma.
    across: usize,
    down: usize,
    /// Rows at the bottom of a unit that wait for the next.
    late: usize,
}

impl Shape {
    fn new(frame: &Frame, wanted: Wanted) -> Shape {
        let (across, down) = (frame.components[0].across, frame.components[0].down);
        Shape {
            units: wanted.width.div_ceil(8 * across),
            unit_rows: frame.height.div_ceil(8 * down),
            unit_height: 8 * down,
            height: frame.height,
            chroma_width: wanted.width.div_ceil(across),
            chroma_height: frame.height.div_ceil(down),
            across,
            down,
            late: usize::from(down == 2),
        }
    }

    /// Samples from one row of a plane to the next.
    fn stride(&self, component: &Component) -> usize {
        self.units * 8 * component.across
    }

    /// One row of pixels.
    fn write(&self, kernel: Kernel, y: usize, wanted: Wanted, buffers: &mut Buffers, pixels: &mut [u8]) {
        let Buffers { planes, wide, sums } = buffers;
        let luma_stride = self.units * 8 * self.across;
        let luma = &planes[0][y % (2 * self.unit_height) * luma_stride..][..wanted.width];
        if wanted.samples == 1 {
            pixels.copy_from_slice(luma);
            return;
        }
        // Chroma has eight rows a unit.
        let chroma_row = |row: usize| row % 16 * self.units * 8..row % 16 * self.units * 8 + self.chroma_width;
        let near = y / self.down;
        let far = match y % 2 {
            0 => near.saturating_sub(1),
            _ => (near + 1).min(self.chroma_height - 1),
        };
        for (plane, wide) in planes[1..].iter().zip(wide.iter_mut()) {
            let row = &plane[chroma_row(near)];
            match (self.across, self.down) {
                (1, _) => wide[..row.len()].copy_from_slice(row),
                (_, 1) => colour::widened(kernel, row, wide),
                _ => colour::widened_between(kernel, row, &plane[chroma_row(far)], sums, wide),
            }
        }
        let all = [luma, &wide[0][..wanted.width], &wide[1][..wanted.width]];
        if wanted.ycbcr {
            colour::to_rgb(kernel, all, pixels);
        } else {
            for (i, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *pixel = all.map(|plane| plane[i]);
            }
        }
    }
}

#[cfg(test)]
mod tests;
