//! Undoing horizontal differencing (predictor 2: TIFF 6.0, section 14) and byte order.
//!
//! The sum along a row is a prefix sum of step `stride`. The vector kernel adds a register to itself shifted by one,
//! two, four… pixels, then adds the last pixel of the register before (Hillis and Steele, "Data parallel algorithms",
//! CACM 29(12), 1986).
#![allow(unsafe_code)]

use super::container::ByteOrder;
use super::layout::Predictor;

/// Which kernel to take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    Scalar,
    #[cfg(target_arch = "x86_64")]
    Ssse3,
}

impl Kernel {
    /// All that this processor has, the fastest last.
    pub fn all() -> Vec<Self> {
        let mut all = vec![Kernel::Scalar];
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("ssse3") {
            all.push(Kernel::Ssse3);
        }
        all
    }

    /// The fastest; the scalar one where [`crate::simd::Kernels`] asks for it.
    pub fn best() -> Self {
        let all = Self::all();
        if crate::simd::Kernels::wanted() == crate::simd::Kernels::Scalar { all[0] } else { all[all.len() - 1] }
    }
}

/// Turns differences into samples, in place, for rows of `row_bytes` bytes and `stride` samples a pixel.
pub fn undo_u8(kernel: Kernel, bytes: &mut [u8], row_bytes: usize, stride: usize) {
    for row in bytes.chunks_exact_mut(row_bytes) {
        let done = match kernel {
            Kernel::Scalar => 0,
            #[cfg(target_arch = "x86_64")]
            // SAFETY: the kernel is only chosen where the processor has it.
            Kernel::Ssse3 => unsafe { x86::undo_u8(row, stride) },
        };
        scalar(row, stride, done, u8::wrapping_add);
    }
}

/// Turns differences into samples, in place, in one row of native 16-bit samples.
pub fn undo_u16(kernel: Kernel, row: &mut [u16], stride: usize) {
    let done = match kernel {
        Kernel::Scalar => 0,
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the kernel is only chosen where the processor has it.
        Kernel::Ssse3 => unsafe { x86::undo_u16(row, stride) },
    };
    scalar(row, stride, done, u16::wrapping_add);
}

/// Sample by sample, from sample `done` on.
fn scalar<T: Copy>(row: &mut [T], stride: usize, done: usize, add: impl Fn(T, T) -> T) {
    for i in done.max(stride)..row.len() {
        row[i] = add(row[i], row[i - stride]);
    }
}

/// 16-bit samples from the file's bytes, in this machine's order.
pub fn words(bytes: &[u8], out: &mut [u16], order: ByteOrder) {
    let pairs = out.iter_mut().zip(bytes.as_chunks::<2>().0);
    match order {
        ByteOrder::Big => pairs.for_each(|(word, &pair)| *word = u16::from_be_bytes(pair)),
        ByteOrder::Little => pairs.for_each(|(word, &pair)| *word = u16::from_le_bytes(pair)),
    }
}

/// Turns a row of differences of bytes, which lie by their weight with the heaviest first, into numbers (Adobe
/// Photoshop TIFF Technical Note 3, 2005, predictor 3). The bytes are left as sums.
pub fn undo_floats(kernel: Kernel, bytes: &mut [u8], out: &mut [f32]) {
    let count = out.len();
    debug_assert_eq!(bytes.len(), 4 * count, "four bytes a number");
    let row_bytes = bytes.len();
    undo_u8(kernel, bytes, row_bytes, 1);
    let (first, rest) = bytes.split_at(count);
    let (second, rest) = rest.split_at(count);
    let (third, fourth) = rest.split_at(count);
    for ((((value, &a), &b), &c), &d) in out.iter_mut().zip(first).zip(second).zip(third).zip(fourth) {
        *value = f32::from_be_bytes([a, b, c, d]);
    }
}

/// 32-bit numbers from a row of the file's bytes; with `Horizontal` differences of their bits to the number before.
pub fn numbers(bytes: &[u8], out: &mut [f32], order: ByteOrder, predictor: Predictor) {
    let bits = |&quad: &[u8; 4]| match order {
        ByteOrder::Big => u32::from_be_bytes(quad),
        ByteOrder::Little => u32::from_le_bytes(quad),
    };
    let mut sum = 0u32;
    for (value, quad) in out.iter_mut().zip(bytes.as_chunks::<4>().0) {
        let word = bits(quad);
        sum = if predictor == Predictor::Horizontal { sum.wrapping_add(word) } else { word };
        *value = f32::from_bits(sum);
    }
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::*;

    /// For each byte of a register, which byte of the last whole pixel of the one before continues in it.
    fn carry_from(step: usize, pixel: usize) -> [i8; 16] {
        std::array::from_fn(|i| (step - pixel + i % pixel) as i8)
    }

    /// One register's prefix sums: the shifts are in bytes, the adder is that of the sample type.
    macro_rules! prefix {
        ($add:ident, $x:expr, $($shift:literal)*) => {{
            let mut x = $x;
            $( x = $add(x, _mm_slli_si128::<$shift>(x)); )*
            x
        }};
    }

    /// Runs over a row in steps of `$step` bytes (the whole pixels of a register) and returns how many samples are
    /// done. The register after is loaded before this one is stored, because a step of 15 or 12 bytes stores into it.
    macro_rules! run {
        ($row:ident, $sample:ty, $add:ident, $pixel:literal, $step:literal, [$($shift:literal)*]) => {{
            let bytes = size_of_val($row);
            let base = $row.as_mut_ptr().cast::<u8>();
            let carry_from = carry_from($step, $pixel);
            let mut at = 0;
            if bytes >= 16 {
                // SAFETY: every load and store covers 16 bytes from `at`, and `at + 16 <= bytes`; the row is borrowed
                // uniquely.
                unsafe {
                    let carry_from = _mm_loadu_si128(carry_from.as_ptr().cast());
                    let mut carry = _mm_setzero_si128();
                    let mut x = _mm_loadu_si128(base.cast());
                    loop {
                        let more = at + $step + 16 <= bytes;
                        let following = if more { _mm_loadu_si128(base.add(at + $step).cast()) } else { x };
                        let sums = $add(prefix!($add, x, $($shift)*), carry);
                        _mm_storeu_si128(base.add(at).cast(), sums);
                        carry = _mm_shuffle_epi8(sums, carry_from);
                        x = following;
                        at += $step;
                        if !more {
                            break;
                        }
                    }
                    // The register reaches beyond its whole pixels: what lies there is summed already.
                    at += 16 - $step;
                }
            }
            at / size_of::<$sample>()
        }};
    }

    /// Returns how many samples of the row are done.
    #[target_feature(enable = "ssse3")]
    pub unsafe fn undo_u8(row: &mut [u8], stride: usize) -> usize {
        match stride {
            1 => run!(row, u8, _mm_add_epi8, 1, 16, [1 2 4 8]),
            2 => run!(row, u8, _mm_add_epi8, 2, 16, [2 4 8]),
            3 => run!(row, u8, _mm_add_epi8, 3, 15, [3 6 12]),
            4 => run!(row, u8, _mm_add_epi8, 4, 16, [4 8]),
            _ => 0,
        }
    }

    /// Returns how many samples of the row are done.
    #[target_feature(enable = "ssse3")]
    pub unsafe fn undo_u16(row: &mut [u16], stride: usize) -> usize {
        match stride {
            1 => run!(row, u16, _mm_add_epi16, 2, 16, [2 4 8]),
            2 => run!(row, u16, _mm_add_epi16, 4, 16, [4 8]),
            3 => run!(row, u16, _mm_add_epi16, 6, 12, [6 12]),
            4 => run!(row, u16, _mm_add_epi16, 8, 16, [8]),
            _ => 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(len: usize) -> Vec<u8> {
        let mut seed = len as u32 ^ 0x9E37_79B9;
        std::iter::repeat_with(|| {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (seed >> 24) as u8
        })
        .take(len)
        .collect()
    }

    #[test]
    fn the_kernels_agree_at_every_length_offset_and_stride() {
        let fastest = *Kernel::all().last().expect("the scalar one is always there");
        for stride in 1..=6 {
            for pixels in 1..120 {
                let row_bytes = pixels * stride;
                for shift in 0..3 {
                    let mut ours = noise(shift + 3 * row_bytes);
                    let mut plain = ours.clone();
                    let differences = ours.clone();
                    undo_u8(fastest, &mut ours[shift..], row_bytes, stride);
                    undo_u8(Kernel::Scalar, &mut plain[shift..], row_bytes, stride);
                    assert_eq!(ours, plain, "stride {stride}, {pixels} pixels, from {shift}");
                    // The definition: a sample is the sum of the differences up to it.
                    let row = &differences[shift..shift + row_bytes];
                    let last = row.iter().rev().step_by(stride).fold(0u8, |a, &b| a.wrapping_add(b));
                    assert_eq!(plain[shift + row_bytes - 1], last);
                }
                let mut ours: Vec<u16> =
                    noise(2 * row_bytes).as_chunks::<2>().0.iter().map(|&p| u16::from_le_bytes(p)).collect();
                let mut plain = ours.clone();
                undo_u16(fastest, &mut ours, stride);
                undo_u16(Kernel::Scalar, &mut plain, stride);
                assert_eq!(ours, plain, "16 bit, stride {stride}, {pixels} pixels");
            }
        }
    }

    #[test]
    fn byte_order_is_that_of_the_file() {
        let mut out = [0; 2];
        words(&[1, 2, 3, 4], &mut out, ByteOrder::Big);
        assert_eq!(out, [0x0102, 0x0304]);
        words(&[1, 2, 3, 4], &mut out, ByteOrder::Little);
        assert_eq!(out, [0x0201, 0x0403]);
    }
}
