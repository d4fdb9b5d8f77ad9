//! Which kernels run: the widest that the machine has, or the scalar twins; and loops that are compiled for both.

// One call of a function that is only for machines with AVX2.
#![allow(unsafe_code)]

use std::sync::LazyLock;

/// Which kernels are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernels {
    /// The widest registers that the machine has.
    Widest,
    /// The readable reference, for any processor.
    Scalar,
}

impl Kernels {
    /// [`Kernels::Scalar`] where the environment variable `AUTOREF_KERNELS` is `scalar`: so that the scalar twins can
    /// be tested and timed as the program's own path. Read once.
    pub fn wanted() -> Kernels {
        static WANTED: LazyLock<Kernels> = LazyLock::new(|| match std::env::var("AUTOREF_KERNELS") {
            Ok(word) if word == "scalar" => Kernels::Scalar,
            _ => Kernels::Widest,
        });
        *WANTED
    }
}

/// A loop with what it works on, compiled twice: once for any processor, once for those with AVX2. `run` and what it
/// calls in its loops must be `#[inline(always)]`: only then are they compiled anew. Products and sums are not
/// contracted, so that both give the same bits.
pub trait Kernel {
    type Output;

    fn run(self) -> Self::Output;
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn run_avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run()
}

/// Runs the kernel with the widest registers there are; where [`Kernels`] asks for it as for any processor.
pub fn widest<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if Kernels::wanted() == Kernels::Widest && is_x86_feature_detected!("avx2") {
        // SAFETY: the machine has AVX2.
        return unsafe { run_avx2(kernel) };
    }
    kernel.run()
}
