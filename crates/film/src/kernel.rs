//! Loops compiled twice: once for any processor, once for those with AVX2, of which the machine takes the faster one.
//! Products and sums are not contracted, so that both give the same bits.

// One call of a function that is only for machines with AVX2.
#![allow(unsafe_code)]

/// A loop with what it works on. `run` and what it calls in its loops must be `#[inline(always)]`: only then are they compiled anew.
pub(super) trait Kernel {
    type Output;

    fn run(self) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

/// Runs the kernel with the widest registers there are; where [`autoref_raster::simd::Kernels`] asks for it as for any processor.
pub(super) fn widest<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if autoref_raster::simd::Kernels::wanted() == autoref_raster::simd::Kernels::Widest
        && is_x86_feature_detected!("avx2")
    {
        // SAFETY: the machine has AVX2.
        return unsafe { run_avx2(kernel) };
    }
    kernel.run()
}
