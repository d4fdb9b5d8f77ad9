//! From planes to pixels as libjpeg does it: chroma interpolated by triangles ("fancy upsampling"), YCbCr to RGB in
//! fixed point (ITU-R BT.601 over the full range, as in JFIF 1.02), to the last bit.
#![allow(unsafe_code)]

use super::Kernel;

// Of 2^16: 1.402 − 1, 1.772 − 2, −0.34414, 1 − 0.71414. What is taken away or added keeps them within sixteen bits.
const RED: i32 = 26345;
const BLUE: i32 = -14942;
const GREEN_CB: i32 = -22554;
const GREEN_CR: i32 = 18734;

/// Twice as many samples across: three quarters of each and a quarter of its neighbour.
pub fn widened(kernel: Kernel, row: &[u8], out: &mut [u8]) {
    match kernel {
        Kernel::Scalar => widen(row, out),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the kernel is only chosen where the processor has AVX2.
        Kernel::Avx2 => unsafe { avx2::widen(row, out) },
    }
}

/// Twice as many samples across and down: the row nearer to `far` of the two that `near` becomes. `sums` is room for as
/// many numbers as the row has samples, and two.
pub fn widened_between(kernel: Kernel, near: &[u8], far: &[u8], sums: &mut [i16], out: &mut [u8]) {
    match kernel {
        Kernel::Scalar => widen_between(near, far, sums, out),
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the kernel is only chosen where the processor has AVX2.
        Kernel::Avx2 => unsafe { avx2::widen_between(near, far, sums, out) },
    }
}

/// One row of pixels from its luma and chroma.
pub fn to_rgb(kernel: Kernel, planes: [&[u8]; 3], rgb: &mut [u8]) {
    let done = match kernel {
        Kernel::Scalar => 0,
        #[cfg(target_arch = "x86_64")]
        // SAFETY: the kernel is only chosen where the processor has AVX2.
        Kernel::Avx2 => unsafe { avx2::to_rgb(planes, rgb) },
    };
    for (i, pixel) in rgb.as_chunks_mut::<3>().0.iter_mut().enumerate().skip(done) {
        *pixel = rgb_of([planes[0][i], planes[1][i], planes[2][i]]);
    }
}

/// The reference.
fn rgb_of([y, cb, cr]: [u8; 3]) -> [u8; 3] {
    let (y, cb, cr) = (i32::from(y), i32::from(cb) - 128, i32::from(cr) - 128);
    let rounded = |sum: i32| (sum + 32768) >> 16;
    [y + cr + rounded(RED * cr), y - cr + rounded(GREEN_CB * cb + GREEN_CR * cr), y + 2 * cb + rounded(BLUE * cb)]
        .map(|v| v.clamp(0, 255) as u8)
}

#[inline(always)]
fn widen(row: &[u8], out: &mut [u8]) {
    let last = row.len() - 1;
    let wide = |i: usize| u16::from(row[i]);
    (out[0], out[2 * last + 1]) = (row[0], row[last]);
    for i in 0..last {
        out[2 * i + 1] = ((3 * wide(i) + wide(i + 1) + 2) >> 2) as u8;
    }
    for i in 1..=last {
        out[2 * i] = ((3 * wide(i) + wide(i - 1) + 1) >> 2) as u8;
    }
}

#[inline(always)]
fn widen_between(near: &[u8], far: &[u8], sums: &mut [i16], out: &mut [u8]) {
    let n = near.len();
    let (far, sums) = (&far[..n], &mut sums[..n + 2]);
    for i in 0..n {
        sums[i + 1] = 3 * i16::from(near[i]) + i16::from(far[i]);
    }
    (sums[0], sums[n + 1]) = (sums[1], sums[n]);
    for (i, pair) in out.as_chunks_mut::<2>().0[..n].iter_mut().enumerate() {
        let (before, here, behind) = (sums[i], 3 * sums[i + 1], sums[i + 2]);
        *pair = [((here + before + 8) >> 4) as u8, ((here + behind + 7) >> 4) as u8];
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use super::{BLUE, GREEN_CB, GREEN_CR, RED};

    /// The same code for wider registers.
    #[target_feature(enable = "avx2")]
    pub fn widen(row: &[u8], out: &mut [u8]) {
        super::widen(row, out);
    }

    /// Twin of [`super::widen_between`].
    #[target_feature(enable = "avx2")]
    pub fn widen_between(near: &[u8], far: &[u8], sums: &mut [i16], out: &mut [u8]) {
        super::widen_between(near, far, sums, out);
    }

    /// Twin of the loop over [`super::rgb_of`], sixteen pixels at a time. Answers how many it did.
    #[target_feature(enable = "avx2")]
    pub fn to_rgb(planes: [&[u8]; 3], rgb: &mut [u8]) -> usize {
        let [luma, cb, cr] = planes.map(|plane| plane.as_chunks::<16>().0);
        let mut done = 0;
        for (((luma, cb), cr), out) in luma.iter().zip(cb).zip(cr).zip(rgb.as_chunks_mut::<48>().0) {
            let middle = _mm256_set1_epi16(128);
            let y = wide(luma);
            let (cb, cr) = (_mm256_sub_epi16(wide(cb), middle), _mm256_sub_epi16(wide(cr), middle));
            let red = _mm256_add_epi16(_mm256_add_epi16(y, cr), share(cr, RED as i16));
            let blue = _mm256_add_epi16(_mm256_add_epi16(y, _mm256_add_epi16(cb, cb)), share(cb, BLUE as i16));
            let green = _mm256_add_epi16(_mm256_sub_epi16(y, cr), green_share(cb, cr));
            store(bytes(red), bytes(green), bytes(blue), out);
            done += 16;
        }
        done
    }

    #[target_feature(enable = "avx2")]
    fn wide(samples: &[u8; 16]) -> __m256i {
        // SAFETY: sixteen bytes are 128 bits; an unaligned load is asked for.
        _mm256_cvtepu8_epi16(unsafe { _mm_loadu_si128(samples.as_ptr().cast()) })
    }

    /// v · factor / 2^16, rounded: (2·v·factor >> 16) + 1, halved, is the same.
    #[target_feature(enable = "avx2")]
    fn share(v: __m256i, factor: i16) -> __m256i {
        let twice = _mm256_mulhi_epi16(_mm256_add_epi16(v, v), _mm256_set1_epi16(factor));
        _mm256_srai_epi16::<1>(_mm256_add_epi16(twice, _mm256_set1_epi16(1)))
    }

    #[target_feature(enable = "avx2")]
    fn green_share(cb: __m256i, cr: __m256i) -> __m256i {
        let factors = _mm256_set1_epi32((GREEN_CB & 0xFFFF) | GREEN_CR << 16);
        let half = _mm256_set1_epi32(32768);
        let of = |pairs| _mm256_srai_epi32::<16>(_mm256_add_epi32(_mm256_madd_epi16(pairs, factors), half));
        _mm256_packs_epi32(of(_mm256_unpacklo_epi16(cb, cr)), of(_mm256_unpackhi_epi16(cb, cr)))
    }

    /// Clamped to 0…255.
    #[target_feature(enable = "avx2")]
    fn bytes(v: __m256i) -> __m128i {
        _mm256_castsi256_si128(_mm256_permute4x64_epi64::<0b1000>(_mm256_packus_epi16(v, v)))
    }

    /// Which byte of a plane goes to each of the sixteen bytes of the third `part` of 48, or none.
    const fn places(part: usize, plane: usize) -> [i8; 16] {
        let mut places = [-1; 16];
        let mut i = 0;
        while i < 16 {
            if (16 * part + i) % 3 == plane {
                places[i] = ((16 * part + i) / 3) as i8;
            }
            i += 1;
        }
        places
    }

    const PLACES: [[[i8; 16]; 3]; 3] = [
        [places(0, 0), places(0, 1), places(0, 2)],
        [places(1, 0), places(1, 1), places(1, 2)],
        [places(2, 0), places(2, 1), places(2, 2)],
    ];

    #[target_feature(enable = "avx2")]
    fn store(red: __m128i, green: __m128i, blue: __m128i, out: &mut [u8; 48]) {
        for (part, out) in out.as_chunks_mut::<16>().0.iter_mut().enumerate() {
            let placed = |plane: usize, samples| {
                // SAFETY: sixteen bytes are 128 bits; an unaligned load is asked for.
                let places = unsafe { _mm_loadu_si128(PLACES[part][plane].as_ptr().cast()) };
                _mm_shuffle_epi8(samples, places)
            };
            let all = _mm_or_si128(_mm_or_si128(placed(0, red), placed(1, green)), placed(2, blue));
            // SAFETY: sixteen bytes are 128 bits; an unaligned store is asked for.
            unsafe { _mm_storeu_si128(out.as_mut_ptr().cast(), all) };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn all_kernels_convert_all_colours_alike() {
        for y in 0..=255u8 {
            let (mut cb, mut cr) = (Vec::new(), Vec::new());
            for i in 0..65536u32 {
                cb.push((i >> 8) as u8);
                cr.push(i as u8);
            }
            let luma = vec![y; cb.len()];
            let expected: Vec<u8> = cb.iter().zip(&cr).flat_map(|(cb, cr)| rgb_of([y, *cb, *cr])).collect();
            for kernel in Kernel::all() {
                let mut rgb = vec![0; 3 * luma.len()];
                to_rgb(kernel, [&luma, &cb, &cr], &mut rgb);
                assert!(rgb == expected, "{kernel:?} at luma {y}");
            }
        }
    }

    #[test]
    fn rgb_is_within_one_level_of_the_definition() {
        for (y, cb, cr) in
            [(0u8, 0u8, 0u8), (255, 255, 255), (128, 128, 128), (90, 200, 30), (17, 3, 250), (200, 60, 140)]
        {
            let (l, b, r) = (f64::from(y), f64::from(cb) - 128.0, f64::from(cr) - 128.0);
            let exact = [l + 1.402 * r, l - 0.344136 * b - 0.714136 * r, l + 1.772 * b].map(|v| v.clamp(0.0, 255.0));
            for (got, exact) in rgb_of([y, cb, cr]).into_iter().zip(exact) {
                assert!((f64::from(got) - exact).abs() < 0.51, "{y} {cb} {cr}");
            }
        }
    }

    proptest! {
        #[test]
        fn all_kernels_widen_alike(rows in prop::collection::vec(any::<(u8, u8)>(), 1..200)) {
            let (near, far): (Vec<u8>, Vec<u8>) = rows.into_iter().unzip();
            let n = near.len();
            let of = |kernel| {
                let (mut sums, mut between, mut beside) = (vec![0; n + 2], vec![0; 2 * n], vec![0; 2 * n]);
                widened_between(kernel, &near, &far, &mut sums, &mut between);
                widened(kernel, &near, &mut beside);
                (between, beside)
            };
            for kernel in Kernel::all() {
                prop_assert_eq!(of(kernel), of(Kernel::Scalar));
            }
            prop_assert_eq!(of(Kernel::Scalar).1[0], near[0]);
        }
    }
}
