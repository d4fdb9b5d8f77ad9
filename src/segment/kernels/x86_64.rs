//! AVX2: 64 pixels of three samples are passed over at a glance or taken apart into planes of 32, pixels of four stay
//! as they are, eight at a time.

use std::arch::x86_64::*;

use super::{Bounds, Glance, Prefilter};

/// Twin of [`super::scalar::prefilter`] over the whole row, for pixels of 3 or 4 samples.
///
/// # Safety
/// The machine must have AVX2.
///
/// # Panics
/// When `stride` is neither 3 nor 4, or the slices are too short for `len`.
#[target_feature(enable = "avx2")]
pub unsafe fn prefilter(test: &Prefilter, samples: &[u8], stride: usize, len: usize, bits: &mut [u64]) {
    assert!(test.rgb.iter().all(|&b| b < stride));
    match stride {
        3 => three_samples(test, samples, len, bits),
        4 => four_samples(samples, test.rgb, len, &test.bounds, bits),
        _ => panic!("pixels of {stride} samples have no kernel"),
    }
}

/// The bounds of one sample and of its differences from the next, in every byte.
struct Limits {
    low: __m256i,
    high: __m256i,
    fall_low: __m256i,
    fall_high: __m256i,
    rise_low: __m256i,
    rise_high: __m256i,
}

impl Limits {
    #[target_feature(enable = "avx2")]
    fn new(bounds: &Bounds, i: usize) -> Limits {
        let every = |v: u8| _mm256_set1_epi8(v as i8);
        Limits {
            low: every(bounds.low[i]),
            high: every(bounds.high[i]),
            fall_low: every(bounds.fall_low[i]),
            fall_high: every(bounds.fall_high[i]),
            rise_low: every(bounds.rise_low[i]),
            rise_high: every(bounds.rise_high[i]),
        }
    }
}

#[target_feature(enable = "avx2")]
fn three_samples(test: &Prefilter, samples: &[u8], len: usize, bits: &mut [u64]) {
    const WORD: usize = 64 * 3;
    // Two rows of a tile of 512 further; what there is none of is not fetched.
    const AHEAD: usize = 3072;
    let Some(glance) = &test.glance else {
        bits[..len.div_ceil(64)].fill(0);
        return;
    };
    let words = len / 64;
    for (w, word) in bits[..words].iter_mut().enumerate() {
        let pixels = &samples[w * WORD..];
        for line in 0..3 {
            _mm_prefetch::<_MM_HINT_T0>(pixels.as_ptr().wrapping_add(AHEAD + 64 * line).cast());
        }
        // The glance sees one byte more than the pixels, which the last ones may not have.
        let seen = pixels.first_chunk::<{ WORD + 1 }>().is_none_or(|pixels| any(glance, pixels));
        *word = if seen { exactly(test, pixels.first_chunk().expect("64 pixels of the row")) } else { 0 };
    }
    if !len.is_multiple_of(64) {
        // The last pixels go through a copy with room behind them.
        let mut rest = [0u8; WORD];
        let left = len - words * 64;
        rest[..left * 3].copy_from_slice(&samples[words * WORD..][..left * 3]);
        bits[words] = exactly(test, &rest) & (u64::MAX >> (64 - left));
    }
}

/// Bits of bytes that begin a pixel, in each 64 of 192 bytes.
const BEGINS: [u64; 3] = [0x9249_2492_4924_9249, 0x4924_9249_2492_4924, 0x2492_4924_9249_2492];

/// Whether any of 64 pixels may pass. The byte behind them is read and says nothing.
#[target_feature(enable = "avx2")]
fn any(glance: &Glance, pixels: &[u8; 193]) -> bool {
    let ones = _mm256_set1_epi8(-1);
    let good = |k: usize| {
        let phase = 32 * k % 3;
        // SAFETY: with k below 6 the 32-byte loads from 32·k and 32·k + 1 end inside the 193 bytes, the others fill
        // arrays of 32 bytes.
        let (a, b, low, width) = unsafe {
            let at = pixels.as_ptr().add(32 * k);
            (
                _mm256_loadu_si256(at.cast()),
                _mm256_loadu_si256(at.add(1).cast()),
                _mm256_loadu_si256(glance.low[phase].as_ptr().cast()),
                _mm256_loadu_si256(glance.width[phase].as_ptr().cast()),
            )
        };
        let halved = _mm256_avg_epu8(a, _mm256_xor_si256(b, ones));
        let above = _mm256_sub_epi8(halved, low);
        let inside = _mm256_cmpeq_epi8(_mm256_min_epu8(above, width), above);
        u64::from(_mm256_movemask_epi8(inside) as u32)
    };
    let words = [good(0) | good(1) << 32, good(2) | good(3) << 32, good(4) | good(5) << 32];
    let both = |k: usize, next: u64| words[k] & (words[k] >> 1 | next << 63) & BEGINS[k];
    both(0, words[1]) | both(1, words[2]) | both(2, 0) != 0
}

/// One bit for each of 64 pixels.
#[inline(never)]
#[target_feature(enable = "avx2")]
fn exactly(test: &Prefilter, pixels: &[u8; 192]) -> u64 {
    let bounds = &test.bounds;
    Planes::new(test.rgb).word(pixels, &[Limits::new(bounds, 0), Limits::new(bounds, 1), Limits::new(bounds, 2)])
}

/// How 16 pixels of three interleaved samples become three planes: sample `c` of pixel `p` is byte `(3p + c) mod 16` of
/// the 16-byte piece `(3p + c) / 16`, and no two pixels share that byte, so two blends gather a plane and a shuffle
/// sorts it.
struct Planes {
    from_second: [__m256i; 3],
    from_third: [__m256i; 3],
    order: [__m256i; 3],
}

/// Rows are short: the masks are made by the compiler. By sample: bytes from the second piece, from the third, the
/// order.
const MASKS: [[[i8; 32]; 3]; 3] = masks();

const fn masks() -> [[[i8; 32]; 3]; 3] {
    let mut masks = [[[0i8; 32]; 3]; 3];
    let mut i = 0;
    while i < 3 * 32 {
        let (c, lane, p) = (i / 32, i % 32 / 16, i % 16);
        let (piece, at) = ((3 * p + c) / 16, (3 * p + c) % 16);
        if piece > 0 {
            masks[c][piece - 1][16 * lane + at] = -1;
        }
        masks[c][2][16 * lane + p] = at as i8;
        i += 1;
    }
    masks
}

impl Planes {
    #[target_feature(enable = "avx2")]
    fn new([r, g, b]: [usize; 3]) -> Planes {
        Planes {
            from_second: [load_mask(&MASKS[r][0]), load_mask(&MASKS[g][0]), load_mask(&MASKS[b][0])],
            from_third: [load_mask(&MASKS[r][1]), load_mask(&MASKS[g][1]), load_mask(&MASKS[b][1])],
            order: [load_mask(&MASKS[r][2]), load_mask(&MASKS[g][2]), load_mask(&MASKS[b][2])],
        }
    }

    /// Red, green and blue of 32 pixels, in order.
    #[target_feature(enable = "avx2")]
    fn split(&self, pixels: &[u8; 96]) -> [__m256i; 3] {
        let piece = |k: usize| {
            // SAFETY: the two 16-byte loads, from 16·k and 48 + 16·k with k below 3, end inside the 96 bytes.
            unsafe {
                let at = pixels.as_ptr().add(16 * k);
                let low = _mm256_castsi128_si256(_mm_loadu_si128(at.cast()));
                _mm256_inserti128_si256(low, _mm_loadu_si128(at.add(48).cast()), 1)
            }
        };
        let (first, second, third) = (piece(0), piece(1), piece(2));
        let plane = |c: usize| {
            let mixed = _mm256_blendv_epi8(first, second, self.from_second[c]);
            let gathered = _mm256_blendv_epi8(mixed, third, self.from_third[c]);
            _mm256_shuffle_epi8(gathered, self.order[c])
        };
        [plane(0), plane(1), plane(2)]
    }

    /// One bit for each of 64 pixels. The differences decide nearly always, so that they are asked first.
    #[target_feature(enable = "avx2")]
    fn word(&self, pixels: &[u8; 192], limits: &[Limits; 3]) -> u64 {
        let (left, right) = pixels.split_at(96);
        // Not by `map`: what has no AVX2 itself cannot take in a closure that has.
        let left = self.split(left.try_into().expect("half of 192 bytes"));
        let right = self.split(right.try_into().expect("half of 192 bytes"));
        let halves = [left, right];
        let too_low = |colour: &[__m256i; 3], i: usize| {
            let (a, b) = (colour[i], colour[(i + 1) % 3]);
            let fall = _mm256_subs_epu8(limits[i].fall_low, _mm256_subs_epu8(a, b));
            _mm256_or_si256(fall, _mm256_subs_epu8(limits[i].rise_low, _mm256_subs_epu8(b, a)))
        };
        let low = |colour: &[__m256i; 3]| {
            _mm256_or_si256(_mm256_or_si256(too_low(colour, 0), too_low(colour, 1)), too_low(colour, 2))
        };
        let clear = |bad: __m256i| _mm256_movemask_epi8(_mm256_cmpeq_epi8(bad, _mm256_setzero_si256())) as u32;
        let bad = [low(&halves[0]), low(&halves[1])];
        if (clear(bad[0]) | clear(bad[1])) == 0 {
            return 0;
        }
        let rest = |colour: &[__m256i; 3], i: usize| {
            let (a, b) = (colour[i], colour[(i + 1) % 3]);
            let limit = &limits[i];
            let sample = _mm256_or_si256(_mm256_subs_epu8(limit.low, a), _mm256_subs_epu8(a, limit.high));
            let fall = _mm256_subs_epu8(_mm256_subs_epu8(a, b), limit.fall_high);
            let rise = _mm256_subs_epu8(_mm256_subs_epu8(b, a), limit.rise_high);
            _mm256_or_si256(sample, _mm256_or_si256(fall, rise))
        };
        let word = |k: usize| {
            let colour = &halves[k];
            let all = _mm256_or_si256(_mm256_or_si256(rest(colour, 0), rest(colour, 1)), rest(colour, 2));
            u64::from(clear(_mm256_or_si256(bad[k], all)))
        };
        word(0) | word(1) << 32
    }
}

#[target_feature(enable = "avx2")]
fn four_samples(samples: &[u8], rgb: [usize; 3], len: usize, bounds: &Bounds, bits: &mut [u64]) {
    let stride = 4;
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
