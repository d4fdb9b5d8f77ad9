//! AVX2: eight pixels at a time, one in each 32-bit lane.

use std::arch::x86_64::*;

use super::Bounds;

/// Twin of [`super::scalar::prefilter`] over the whole row, for pixels of 3 or 4 samples.
///
/// # Safety
/// The machine must have AVX2.
///
/// # Panics
/// When `stride` is neither 3 nor 4, or the slices are too short for `len`.
#[target_feature(enable = "avx2")]
pub unsafe fn prefilter(samples: &[u8], stride: usize, rgb: [usize; 3], len: usize, bounds: &Bounds, bits: &mut [u64]) {
    assert!(stride == 3 || stride == 4);
    assert!(rgb.iter().all(|&b| b < stride));
    // Four pixels of each 128-bit half become [r g b 0]; 128 in a shuffle mask gives zero.
    let lanes = |order: [usize; 3]| -> [i8; 32] {
        std::array::from_fn(|i| {
            let (pixel, sample) = (i % 16 / 4, i % 4);
            if sample == 3 { -128 } else { (pixel * stride + order[sample]) as i8 }
        })
    };
    let plain = load_mask(&lanes(rgb));
    let turned = load_mask(&lanes([rgb[1], rgb[2], rgb[0]]));
    let spread = |v: [u8; 3]| _mm256_set1_epi32(i32::from_le_bytes([v[0], v[1], v[2], 0]));
    let (low, high) = (spread(bounds.low), spread(bounds.high));
    let (fall_low, fall_high) = (spread(bounds.fall_low), spread(bounds.fall_high));
    let (rise_low, rise_high) = (spread(bounds.rise_low), spread(bounds.rise_high));
    let half = 4 * stride;
    // The second load of a group of eight reads 16 bytes from its fifth pixel on, which the last pixels of a slice that
    // ends here do not have.
    let safe_groups = if samples.len() >= half + 16 { (samples.len() - half - 16) / (2 * half) + 1 } else { 0 };
    let words = (len / 64).min(safe_groups / 8);
    let word_at = |samples: &[u8], first: usize| {
        let mut found = 0u64;
        for group in 0..8 {
            let at = first + group * 2 * half;
            assert!(at + half + 16 <= samples.len());
            // SAFETY: both 16-byte loads end inside the slice, as just asserted.
            let raw = unsafe {
                let p = samples.as_ptr().add(at);
                _mm256_inserti128_si256(
                    _mm256_castsi128_si256(_mm_loadu_si128(p.cast())),
                    _mm_loadu_si128(p.add(half).cast()),
                    1,
                )
            };
            let a = _mm256_shuffle_epi8(raw, plain);
            let b = _mm256_shuffle_epi8(raw, turned);
            let fall = _mm256_subs_epu8(a, b);
            let rise = _mm256_subs_epu8(b, a);
            let outside = |v, lo, hi| _mm256_or_si256(_mm256_subs_epu8(lo, v), _mm256_subs_epu8(v, hi));
            let bad = _mm256_or_si256(
                outside(a, low, high),
                _mm256_or_si256(outside(fall, fall_low, fall_high), outside(rise, rise_low, rise_high)),
            );
            let good = _mm256_cmpeq_epi32(bad, _mm256_setzero_si256());
            let eight = _mm256_movemask_ps(_mm256_castsi256_ps(good)) as u32 as u64;
            found |= eight << (8 * group);
        }
        found
    };
    for (w, word) in bits[..words].iter_mut().enumerate() {
        *word = word_at(samples, w * 16 * half);
    }
    // The last pixels go through a copy with room behind them.
    let mut rest = [0u8; 64 * 4 + 16];
    for (w, word) in bits[..len.div_ceil(64)].iter_mut().enumerate().skip(words) {
        let pixels = (len - w * 64).min(64);
        rest[..pixels * stride].copy_from_slice(&samples[w * 64 * stride..][..pixels * stride]);
        *word = word_at(&rest, 0) & (u64::MAX >> (64 - pixels));
    }
}

#[target_feature(enable = "avx2")]
fn load_mask(mask: &[i8; 32]) -> __m256i {
    // SAFETY: the array holds the 32 bytes that the unaligned load reads.
    unsafe { _mm256_loadu_si256(mask.as_ptr().cast()) }
}
