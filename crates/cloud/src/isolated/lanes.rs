//! Four numbers side by side: with AVX2 in one register, elsewhere one after the other; the same bits either way.

// Instructions that only machines with AVX2 have.
#![allow(unsafe_code)]

/// How many.
pub const LANES: usize = 4;

/// Arithmetic lane by lane, rounded after every operation.
pub trait Lanes: Copy {
    fn load(values: &[f64; LANES]) -> Self;
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    /// The smaller and the larger of two numbers that are both numbers.
    fn sorted(self, other: Self) -> (Self, Self);
    /// `positive` where a lane is above 0, `other` elsewhere.
    fn choose(self, positive: Self, other: Self) -> Self;
    fn store(self) -> [f64; LANES];

    #[inline(always)]
    fn all(value: f64) -> Self {
        Self::load(&[value; LANES])
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d] = self.store();
        (a + b) + (c + d)
    }
}

/// For any processor.
#[derive(Clone, Copy)]
pub struct Plain([f64; LANES]);

impl Plain {
    #[inline(always)]
    fn zip(self, other: Plain, of: impl Fn(f64, f64) -> f64) -> Plain {
        Plain(std::array::from_fn(|lane| of(self.0[lane], other.0[lane])))
    }
}

impl Lanes for Plain {
    #[inline(always)]
    fn load(values: &[f64; LANES]) -> Plain {
        Plain(*values)
    }
    #[inline(always)]
    fn plus(self, other: Plain) -> Plain {
        self.zip(other, |a, b| a + b)
    }
    #[inline(always)]
    fn minus(self, other: Plain) -> Plain {
        self.zip(other, |a, b| a - b)
    }
    #[inline(always)]
    fn times(self, other: Plain) -> Plain {
        self.zip(other, |a, b| a * b)
    }
    #[inline(always)]
    fn sorted(self, other: Plain) -> (Plain, Plain) {
        (self.zip(other, |a, b| if a < b { a } else { b }), self.zip(other, |a, b| if a > b { a } else { b }))
    }
    #[inline(always)]
    fn choose(self, positive: Plain, other: Plain) -> Plain {
        let of = |lane: usize| if self.0[lane] > 0.0 { positive.0[lane] } else { other.0[lane] };
        Plain(std::array::from_fn(of))
    }
    #[inline(always)]
    fn store(self) -> [f64; LANES] {
        self.0
    }
}

/// What is computed with lanes of either kind.
pub trait Work {
    type Output;

    /// Must be `#[inline(always)]`, as everything in its loops: only then is it compiled for the wider registers.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Runs the work with the widest lanes that the machine has.
pub fn run<W: Work>(work: W) -> W::Output {
    #[cfg(target_arch = "x86_64")]
    {
        use autoref_raster::simd::Kernels;
        if Kernels::wanted() == Kernels::Widest && is_x86_feature_detected!("avx2") {
            // SAFETY: the machine has AVX2.
            return unsafe { avx2::run(work) };
        }
    }
    work.run::<Plain>()
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::{
        __m256d, _CMP_GT_OQ, _mm256_add_pd, _mm256_blendv_pd, _mm256_cmp_pd, _mm256_loadu_pd, _mm256_max_pd,
        _mm256_min_pd, _mm256_mul_pd, _mm256_setzero_pd, _mm256_storeu_pd, _mm256_sub_pd,
    };

    use super::{LANES, Lanes, Work};

    /// Made by [`run`] alone, on machines with AVX2.
    #[derive(Clone, Copy)]
    struct Wide(__m256d);

    #[target_feature(enable = "avx2")]
    pub fn run<W: Work>(work: W) -> W::Output {
        work.run::<Wide>()
    }

    impl Lanes for Wide {
        #[inline(always)]
        fn load(values: &[f64; LANES]) -> Wide {
            // SAFETY: the machine has AVX2, and the array four numbers.
            Wide(unsafe { _mm256_loadu_pd(values.as_ptr()) })
        }
        #[inline(always)]
        fn plus(self, other: Wide) -> Wide {
            // SAFETY: the machine has AVX2.
            Wide(unsafe { _mm256_add_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn minus(self, other: Wide) -> Wide {
            // SAFETY: the machine has AVX2.
            Wide(unsafe { _mm256_sub_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn times(self, other: Wide) -> Wide {
            // SAFETY: the machine has AVX2.
            Wide(unsafe { _mm256_mul_pd(self.0, other.0) })
        }
        #[inline(always)]
        fn sorted(self, other: Wide) -> (Wide, Wide) {
            // SAFETY: the machine has AVX2.
            unsafe { (Wide(_mm256_min_pd(self.0, other.0)), Wide(_mm256_max_pd(self.0, other.0))) }
        }
        #[inline(always)]
        fn choose(self, positive: Wide, other: Wide) -> Wide {
            // SAFETY: the machine has AVX2.
            Wide(unsafe {
                let above = _mm256_cmp_pd::<_CMP_GT_OQ>(self.0, _mm256_setzero_pd());
                _mm256_blendv_pd(other.0, positive.0, above)
            })
        }
        #[inline(always)]
        fn store(self) -> [f64; LANES] {
            let mut values = [0.0; LANES];
            // SAFETY: the machine has AVX2, and the array four numbers.
            unsafe { _mm256_storeu_pd(values.as_mut_ptr(), self.0) };
            values
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct All([f64; LANES], [f64; LANES]);

    impl Work for All {
        type Output = Vec<u64>;

        #[inline(always)]
        fn run<L: Lanes>(self) -> Vec<u64> {
            let (a, b) = (L::load(&self.0), L::load(&self.1));
            let (less, more) = a.sorted(b);
            let results = [a.plus(b), a.minus(b), a.times(b), less, more, a.choose(b, L::all(0.02)), L::all(a.sum())];
            results.iter().flat_map(|lanes| lanes.store()).map(f64::to_bits).collect()
        }
    }

    #[test]
    fn wide_and_plain_lanes_give_the_same_bits() {
        for (a, b) in [
            ([1.1, -2.2, 0.0, 1e300], [3.3, 1e-300, -0.7, 5.0]),
            ([-0.1, f64::INFINITY, 7.0, 0.3], [0.1, 2.0, 7.0, f64::INFINITY]),
        ] {
            assert_eq!(run(All(a, b)), All(a, b).run::<Plain>());
        }
    }
}
