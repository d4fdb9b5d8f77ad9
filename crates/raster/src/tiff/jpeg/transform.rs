//! The inverse cosine transform of libjpeg ("islow": C. Loeffler, A. Ligtenberg and G. Moschytz, "Practical fast 1-D
//! DCT algorithms with 11 multiplications", ICASSP 1989), in integers, so that pixels are those of libjpeg to the last
//! bit. The AVX2 twin transforms two blocks at a time, one in each half of the registers.
#![allow(unsafe_code)]

use super::Kernel;

/// Fixed point of the constants, and the bits kept after the columns.
const CONSTANT_BITS: u32 = 13;
const KEPT_BITS: u32 = 2;

// The constants of the transform, times 2^13.
const C0_298: i32 = 2446;
const C0_390: i32 = 3196;
const C0_541: i32 = 4433;
const C0_765: i32 = 6270;
const C0_899: i32 = 7373;
const C1_175: i32 = 9633;
const C1_501: i32 = 12299;
const C1_847: i32 = 15137;
const C1_961: i32 = 16069;
const C2_053: i32 = 16819;
const C2_562: i32 = 20995;
const C3_072: i32 = 25172;

/// Two blocks of dequantised coefficients to pixels. `last` is the index along the diagonals of the last coefficient of
/// each that is not zero.
#[inline]
pub fn two_blocks(kernel: Kernel, coefficients: &[[i16; 64]; 2], last: [usize; 2]) -> [[u8; 64]; 2] {
    if last == [0, 0] {
        return [[flat(coefficients[0][0]); 64], [flat(coefficients[1][0]); 64]];
    }
    match kernel {
        Kernel::Scalar => [scalar(&coefficients[0]), scalar(&coefficients[1])],
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the kernel is only chosen where the processor has AVX2.
        Kernel::Avx2 => unsafe { avx2::two_blocks(coefficients) },
    }
}

/// A block into a plane, from its first pixel there on.
#[inline]
pub fn put(block: &[u8; 64], plane: &mut [u8], stride: usize) {
    for (row, from) in plane.chunks_mut(stride).zip(block.as_chunks::<8>().0) {
        row[..8].copy_from_slice(from);
    }
}

/// Every pixel of a block of which only the mean is there.
fn flat(dc: i16) -> u8 {
    let column = (i32::from(dc) << KEPT_BITS).clamp(-32768, 32767);
    level((column + (1 << (KEPT_BITS + 2))) >> (KEPT_BITS + 3))
}

fn level(value: i32) -> u8 {
    (value + 128).clamp(0, 255) as u8
}

/// One dimension, up to the last shift.
fn eight(x: [i16; 8]) -> [i32; 8] {
    let wide = |v: i16| i32::from(v);
    let (z2, z3) = (wide(x[2]), wide(x[6]));
    let t2 = z2 * C0_541 + z3 * (C0_541 - C1_847);
    let t3 = z2 * (C0_541 + C0_765) + z3 * C0_541;
    let t0 = wide(x[0].wrapping_add(x[4])) << CONSTANT_BITS;
    let t1 = wide(x[0].wrapping_sub(x[4])) << CONSTANT_BITS;
    let even = [t0 + t3, t1 + t2, t1 - t2, t0 - t3];
    let (o0, o1, o2, o3) = (wide(x[7]), wide(x[5]), wide(x[3]), wide(x[1]));
    let (z3, z4) = (wide(x[7].wrapping_add(x[3])), wide(x[5].wrapping_add(x[1])));
    let a = z3 * (C1_175 - C1_961) + z4 * C1_175;
    let b = z3 * C1_175 + z4 * (C1_175 - C0_390);
    let odd = [
        (o0 * -C0_899 + o3 * (C1_501 - C0_899)).wrapping_add(b),
        (o1 * -C2_562 + o2 * (C3_072 - C2_562)).wrapping_add(a),
        (o1 * (C2_053 - C2_562) + o2 * -C2_562).wrapping_add(b),
        (o0 * (C0_298 - C0_899) + o3 * -C0_899).wrapping_add(a),
    ];
    std::array::from_fn(|i| match i {
        0..4 => even[i].wrapping_add(odd[i]),
        _ => even[7 - i].wrapping_sub(odd[7 - i]),
    })
}

fn shifted(value: i32, bits: u32) -> i32 {
    value.wrapping_add(1 << (bits - 1)) >> bits
}

/// The reference.
fn scalar(coefficients: &[i16; 64]) -> [u8; 64] {
    let mut columns = [[0i16; 8]; 8];
    for c in 0..8 {
        let column = eight(std::array::from_fn(|r| coefficients[8 * r + c]));
        for r in 0..8 {
            columns[r][c] = shifted(column[r], CONSTANT_BITS - KEPT_BITS).clamp(-32768, 32767) as i16;
        }
    }
    let mut pixels = [0; 64];
    for (row, out) in columns.iter().zip(pixels.as_chunks_mut::<8>().0) {
        *out = eight(*row).map(|v| level(shifted(v, CONSTANT_BITS + KEPT_BITS + 3).clamp(-32768, 32767)));
    }
    pixels
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::*;

    /// Rows of two blocks: of the first in the low half of each register, of the second in the high one.
    type Rows = [__m256i; 8];

    /// Twin of [`scalar`] for two blocks.
    #[target_feature(enable = "avx2")]
    pub fn two_blocks(coefficients: &[[i16; 64]; 2]) -> [[u8; 64]; 2] {
        let (one, other) = (&coefficients[0].as_chunks::<8>().0, &coefficients[1].as_chunks::<8>().0);
        let mut rows = [_mm256_setzero_si256(); 8];
        for r in 0..8 {
            // SAFETY: eight numbers of sixteen bits are 128 bits; unaligned loads are asked for.
            rows[r] = unsafe { _mm256_loadu2_m128i(other[r].as_ptr().cast(), one[r].as_ptr().cast()) };
        }
        let rows = transposed(eight::<{ (CONSTANT_BITS - KEPT_BITS) as i32 }>(rows));
        let rows = transposed(eight::<{ (CONSTANT_BITS + KEPT_BITS + 3) as i32 }>(rows));
        let mut pixels = [[0u8; 64]; 2];
        let middle = _mm256_set1_epi8(-128);
        for pair in 0..4 {
            // Saturated to signed bytes and moved up by 128: the same as clamping to 0…255.
            let bytes = _mm256_xor_si256(_mm256_packs_epi16(rows[2 * pair], rows[2 * pair + 1]), middle);
            let (low, high) = (_mm256_castsi256_si128(bytes), _mm256_extracti128_si256::<1>(bytes));
            for (block, half) in pixels.iter_mut().zip([low, high]) {
                let to: &mut [u8; 16] = (&mut block[16 * pair..16 * pair + 16]).try_into().expect("two rows");
                // SAFETY: sixteen bytes are 128 bits; an unaligned store is asked for.
                unsafe { _mm_storeu_si128(to.as_mut_ptr().cast(), half) };
            }
        }
        pixels
    }

    #[target_feature(enable = "avx2")]
    fn pair(low: i32, high: i32) -> __m256i {
        _mm256_set1_epi32((low & 0xFFFF) | high << 16)
    }

    /// Sums of products of two rows with two constants, for the low and the high four columns of each half.
    #[target_feature(enable = "avx2")]
    fn products((low, high): (__m256i, __m256i), constants: __m256i) -> (__m256i, __m256i) {
        (_mm256_madd_epi16(low, constants), _mm256_madd_epi16(high, constants))
    }

    #[target_feature(enable = "avx2")]
    fn interleaved(a: __m256i, b: __m256i) -> (__m256i, __m256i) {
        (_mm256_unpacklo_epi16(a, b), _mm256_unpackhi_epi16(a, b))
    }

    #[target_feature(enable = "avx2")]
    fn plus(a: (__m256i, __m256i), b: (__m256i, __m256i)) -> (__m256i, __m256i) {
        (_mm256_add_epi32(a.0, b.0), _mm256_add_epi32(a.1, b.1))
    }

    #[target_feature(enable = "avx2")]
    fn minus(a: (__m256i, __m256i), b: (__m256i, __m256i)) -> (__m256i, __m256i) {
        (_mm256_sub_epi32(a.0, b.0), _mm256_sub_epi32(a.1, b.1))
    }

    /// Sixteen bits to 32, times 2^13.
    #[target_feature(enable = "avx2")]
    fn scaled(a: __m256i) -> (__m256i, __m256i) {
        const DOWN: i32 = 16 - CONSTANT_BITS as i32;
        let zero = _mm256_setzero_si256();
        let (low, high) = interleaved(zero, a);
        (_mm256_srai_epi32::<DOWN>(low), _mm256_srai_epi32::<DOWN>(high))
    }

    /// One dimension down the columns, rounded and shifted.
    #[target_feature(enable = "avx2")]
    fn eight<const SHIFT: i32>(x: Rows) -> Rows {
        let z = interleaved(x[2], x[6]);
        let t2 = products(z, pair(C0_541, C0_541 - C1_847));
        let t3 = products(z, pair(C0_541 + C0_765, C0_541));
        let t0 = scaled(_mm256_add_epi16(x[0], x[4]));
        let t1 = scaled(_mm256_sub_epi16(x[0], x[4]));
        let even = [plus(t0, t3), plus(t1, t2), minus(t1, t2), minus(t0, t3)];
        let z = interleaved(_mm256_add_epi16(x[7], x[3]), _mm256_add_epi16(x[5], x[1]));
        let a = products(z, pair(C1_175 - C1_961, C1_175));
        let b = products(z, pair(C1_175, C1_175 - C0_390));
        let (outer, inner) = (interleaved(x[7], x[1]), interleaved(x[5], x[3]));
        let odd = [
            plus(products(outer, pair(-C0_899, C1_501 - C0_899)), b),
            plus(products(inner, pair(-C2_562, C3_072 - C2_562)), a),
            plus(products(inner, pair(C2_053 - C2_562, -C2_562)), b),
            plus(products(outer, pair(C0_298 - C0_899, -C0_899)), a),
        ];
        let half = _mm256_set1_epi32(1 << (SHIFT - 1));
        let mut out = x;
        for i in 0..4 {
            let rounded = |(low, high): (__m256i, __m256i)| {
                let low = _mm256_srai_epi32::<SHIFT>(_mm256_add_epi32(low, half));
                let high = _mm256_srai_epi32::<SHIFT>(_mm256_add_epi32(high, half));
                _mm256_packs_epi32(low, high)
            };
            out[i] = rounded(plus(even[i], odd[i]));
            out[7 - i] = rounded(minus(even[i], odd[i]));
        }
        out
    }

    #[target_feature(enable = "avx2")]
    fn transposed(x: Rows) -> Rows {
        let low16 = |a, b| _mm256_unpacklo_epi16(a, b);
        let high16 = |a, b| _mm256_unpackhi_epi16(a, b);
        let (a, b) = ([low16(x[0], x[1]), low16(x[2], x[3])], [low16(x[4], x[5]), low16(x[6], x[7])]);
        let (c, d) = ([high16(x[0], x[1]), high16(x[2], x[3])], [high16(x[4], x[5]), high16(x[6], x[7])]);
        let four = |p: [__m256i; 2], q: [__m256i; 2]| {
            let (p_low, p_high) = (_mm256_unpacklo_epi32(p[0], p[1]), _mm256_unpackhi_epi32(p[0], p[1]));
            let (q_low, q_high) = (_mm256_unpacklo_epi32(q[0], q[1]), _mm256_unpackhi_epi32(q[0], q[1]));
            [
                _mm256_unpacklo_epi64(p_low, q_low),
                _mm256_unpackhi_epi64(p_low, q_low),
                _mm256_unpacklo_epi64(p_high, q_high),
                _mm256_unpackhi_epi64(p_high, q_high),
            ]
        };
        let ([r0, r1, r2, r3], [r4, r5, r6, r7]) = (four(a, b), four(c, d));
        [r0, r1, r2, r3, r4, r5, r6, r7]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_flat_block_is_its_mean() {
        for dc in -2100..2100 {
            let mut block = [0i16; 64];
            block[0] = dc;
            assert_eq!(scalar(&block), [flat(dc); 64], "{dc}");
        }
    }

    #[test]
    fn the_transform_is_near_that_of_the_definition() {
        let mut state = 5u32;
        let mut random = |n: u32| {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            (state >> 8) % n
        };
        for _ in 0..50 {
            let mut block = [0i16; 64];
            for _ in 0..12 {
                block[random(64) as usize] = random(200) as i16 - 100;
            }
            let pixels = scalar(&block);
            let cosine = |u: usize, x: usize| {
                let scale = if u == 0 { 0.5f64.sqrt() } else { 1.0 };
                0.5 * scale * (std::f64::consts::PI * (2.0 * x as f64 + 1.0) * u as f64 / 16.0).cos()
            };
            for (i, pixel) in pixels.iter().enumerate() {
                let sum: f64 = (0..64).map(|k| f64::from(block[k]) * cosine(k / 8, i / 8) * cosine(k % 8, i % 8)).sum();
                assert!((f64::from(*pixel) - (sum + 128.0).clamp(0.0, 255.0)).abs() < 1.0);
            }
        }
    }

    proptest! {
        #[test]
        fn all_kernels_give_the_same_bytes(
            values in prop::collection::vec(any::<i16>(), 128), small in any::<bool>(), kept in 0usize..64,
        ) {
            let mut blocks = [[0i16; 64]; 2];
            for (i, v) in values.iter().enumerate() {
                let v = if small { v % 300 } else { *v };
                blocks[i / 64][i % 64] = if i % 64 <= kept { v } else { 0 };
            }
            for kernel in Kernel::all() {
                prop_assert_eq!(two_blocks(kernel, &blocks, [63, 63]), two_blocks(Kernel::Scalar, &blocks, [63, 63]));
            }
        }
    }
}
