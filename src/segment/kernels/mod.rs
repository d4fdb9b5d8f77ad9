//! The colour prefilter: which pixels of a row may be paint, at memory speed. [`scalar`] is the reference, [`x86_64`]
//! its AVX2 twin; both answer the same bits, and tests compare them at every length and offset.
#![allow(unsafe_code)]

pub mod scalar;
#[cfg(target_arch = "x86_64")]
pub mod x86_64;

/// Bounds on one pixel's samples and on their differences. A pixel passes when every sample lies in `low..=high` and
/// each saturating difference in its own range. Everything the exact table accepts passes (see `Classifier`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    pub low: [u8; 3],
    pub high: [u8; 3],
    /// Of `max(0, r − g)`, `max(0, g − b)`, `max(0, b − r)`.
    pub fall_low: [u8; 3],
    pub fall_high: [u8; 3],
    /// Of `max(0, g − r)`, `max(0, b − g)`, `max(0, r − b)`.
    pub rise_low: [u8; 3],
    pub rise_high: [u8; 3],
}

impl Bounds {
    /// Bounds that nothing passes; the start of a union.
    pub const NOTHING: Bounds = Bounds {
        low: [255; 3],
        high: [0; 3],
        fall_low: [255; 3],
        fall_high: [0; 3],
        rise_low: [255; 3],
        rise_high: [0; 3],
    };

    /// Widens the bounds until `colour` passes.
    pub fn admit(&mut self, colour: [u8; 3]) {
        for i in 0..3 {
            let fall = colour[i].saturating_sub(colour[(i + 1) % 3]);
            let rise = colour[(i + 1) % 3].saturating_sub(colour[i]);
            self.low[i] = self.low[i].min(colour[i]);
            self.high[i] = self.high[i].max(colour[i]);
            self.fall_low[i] = self.fall_low[i].min(fall);
            self.fall_high[i] = self.fall_high[i].max(fall);
            self.rise_low[i] = self.rise_low[i].min(rise);
            self.rise_high[i] = self.rise_high[i].max(rise);
        }
    }

    /// The smallest bounds that hold both.
    pub fn union(&self, other: &Bounds) -> Bounds {
        let low = |a: [u8; 3], b: [u8; 3]| [a[0].min(b[0]), a[1].min(b[1]), a[2].min(b[2])];
        let high = |a: [u8; 3], b: [u8; 3]| [a[0].max(b[0]), a[1].max(b[1]), a[2].max(b[2])];
        Bounds {
            low: low(self.low, other.low),
            high: high(self.high, other.high),
            fall_low: low(self.fall_low, other.fall_low),
            fall_high: high(self.fall_high, other.fall_high),
            rise_low: low(self.rise_low, other.rise_low),
            rise_high: high(self.rise_high, other.rise_high),
        }
    }

    /// Least and largest `colour[i] − colour[i + 1]` that passes; `None` when none does.
    pub fn difference(&self, i: usize) -> Option<(i32, i32)> {
        let [fall_low, fall_high, rise_low, rise_high] =
            [self.fall_low, self.fall_high, self.rise_low, self.rise_high].map(|v| i32::from(v[i]));
        // A fall is no rise: where one must be, the other is none.
        let least = if fall_low > 0 { fall_low } else { -rise_high };
        let most = if rise_low > 0 { -rise_low } else { fall_high };
        (least <= most).then_some((least, most))
    }

    /// Whether a colour lies within all bounds.
    pub fn passes(&self, colour: [u8; 3]) -> bool {
        (0..3).all(|i| {
            let fall = colour[i].saturating_sub(colour[(i + 1) % 3]);
            let rise = colour[(i + 1) % 3].saturating_sub(colour[i]);
            (self.low[i]..=self.high[i]).contains(&colour[i])
                && (self.fall_low[i]..=self.fall_high[i]).contains(&fall)
                && (self.rise_low[i]..=self.rise_high[i]).contains(&rise)
        })
    }
}

/// The test of [`Bounds`] made ready for pixels of one kind: rows are short.
#[derive(Clone, Debug)]
pub struct Prefilter {
    bounds: Bounds,
    /// Sample indices in a pixel.
    rgb: [usize; 3],
    /// `None` when nothing can pass.
    #[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
    glance: Option<Glance>,
}

/// A test that most pixels fail, on pixels of three samples as they lie: the differences of the first sample from the
/// second and of the second from the third, halved. `avg(a, !b)` is `(256 + a − b) / 2`, so that one byte holds both
/// signs.
///
/// By how far into a pixel 32 bytes begin: the least halved difference, and how much more there may be.
#[derive(Clone, Debug)]
#[cfg_attr(not(target_arch = "x86_64"), allow(dead_code))]
struct Glance {
    low: [[u8; 32]; 3],
    width: [[u8; 32]; 3],
}

impl Glance {
    fn new(rgb: [usize; 3], bounds: &Bounds) -> Option<Glance> {
        let channel = |sample: usize| rgb.iter().position(|s| *s == sample);
        let (mut low, mut high) = ([0u8; 3], [255u8; 3]);
        for sample in 0..2 {
            // A sample that no band is made of says nothing.
            let (Some(this), Some(next)) = (channel(sample), channel(sample + 1)) else { continue };
            let (least, most) = if next == (this + 1) % 3 {
                bounds.difference(this)?
            } else {
                let (least, most) = bounds.difference(next)?;
                (-most, -least)
            };
            (low[sample], high[sample]) = (((256 + least) / 2) as u8, ((256 + most) / 2) as u8);
        }
        let phases = |of: &dyn Fn(usize) -> u8| -> [[u8; 32]; 3] {
            std::array::from_fn(|phase| std::array::from_fn(|i| of((phase + i) % 3)))
        };
        Some(Glance { low: phases(&|i| low[i]), width: phases(&|i| high[i] - low[i]) })
    }
}

impl Prefilter {
    /// `rgb` are the sample indices in a pixel.
    pub fn new(rgb: [usize; 3], bounds: Bounds) -> Prefilter {
        Prefilter { bounds, rgb, glance: Glance::new(rgb, &bounds) }
    }

    /// Writes one bit a pixel: does it pass? Every word of `bits` is overwritten, unused high bits are zero.
    ///
    /// Uses AVX2 where the machine has it, the pixels are 3 or 4 samples wide and [`autoref_raster::simd::Kernels`]
    /// asks for the widest.
    pub fn row(&self, samples: &[u8], stride: usize, len: usize, bits: &mut [u64]) {
        #[cfg(target_arch = "x86_64")]
        if autoref_raster::simd::Kernels::wanted() == autoref_raster::simd::Kernels::Widest
            && matches!(stride, 3 | 4)
            && is_x86_feature_detected!("avx2")
        {
            // SAFETY: the machine has AVX2, as just asked.
            unsafe { x86_64::prefilter(self, samples, stride, len, bits) };
            return;
        }
        scalar::prefilter(samples, stride, self.rgb, 0..len, &self.bounds, bits);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_raster::random::xorshift;

    fn noise(len: usize, seed: u64) -> Vec<u8> {
        let mut state = seed | 1;
        (0..len).map(|_| (xorshift(&mut state) >> 32) as u8).collect()
    }

    #[test]
    fn the_kernels_agree_at_every_length_offset_and_order() {
        let mut bounds = Bounds::NOTHING;
        for colour in [[200, 90, 30], [255, 200, 120], [90, 40, 10]] {
            bounds.admit(colour);
        }
        for stride in [3usize, 4, 5, 1] {
            for rgb in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
                let rgb = if stride == 1 { [0; 3] } else { rgb };
                for len in (0..70).chain([127, 128, 129, 200, 515]) {
                    for offset in [0usize, 1, 2, 7] {
                        let data = noise(offset + len * stride, (len * 31 + offset * 7 + stride) as u64);
                        let words = len.div_ceil(64);
                        let (mut fast, mut slow) = (vec![u64::MAX; words], vec![u64::MAX; words]);
                        Prefilter::new(rgb, bounds).row(&data[offset..], stride, len, &mut fast);
                        scalar::prefilter(&data[offset..], stride, rgb, 0..len, &bounds, &mut slow);
                        assert_eq!(fast, slow, "stride {stride} len {len} offset {offset}");
                    }
                }
            }
        }
    }

    /// Where nearly nothing passes, 64 pixels are passed over at a glance: one that passes, or nearly, at every place.
    #[test]
    fn a_single_pixel_is_seen_wherever_it_lies() {
        let colours = [[200u8, 90, 30], [10, 180, 200], [40, 60, 250], [128, 128, 128], [255, 0, 255], [0, 255, 0]];
        for (c, colour) in colours.into_iter().enumerate() {
            let mut bounds = Bounds::NOTHING;
            bounds.admit(colour);
            bounds.admit(colour.map(|v| v.saturating_add(9)));
            bounds.admit(colour.map(|v| v.saturating_sub(c as u8)));
            for rgb in [[0, 1, 2], [2, 1, 0], [1, 2, 0], [0, 0, 0], [0, 0, 1], [2, 0, 2]] {
                let test = Prefilter::new(rgb, bounds);
                for place in 0..200 {
                    for (near, ground) in [(0i16, 77), (1, 130), (-1, 0), (2, 255), (-3, 128)] {
                        let mut data = vec![ground; 3 * 200];
                        for (i, v) in colour.into_iter().enumerate() {
                            data[3 * place + rgb[i]] = (i16::from(v) + near * (i as i16 - 1)).clamp(0, 255) as u8;
                        }
                        let (mut fast, mut slow) = ([u64::MAX; 4], [u64::MAX; 4]);
                        test.row(&data, 3, 200, &mut fast);
                        scalar::prefilter(&data, 3, rgb, 0..200, &bounds, &mut slow);
                        assert_eq!(fast, slow, "{colour:?} {rgb:?} at {place}, {near} beside, on {ground}");
                    }
                }
            }
        }
        let mut bits = [u64::MAX; 4];
        Prefilter::new([0, 1, 2], Bounds::NOTHING).row(&[7; 600], 3, 200, &mut bits);
        assert_eq!(bits, [0; 4]);
    }
}
