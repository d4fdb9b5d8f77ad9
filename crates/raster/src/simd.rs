//! Which kernels run: the widest that the machine has, or the scalar twins.

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
    /// [`Kernels::Scalar`] where the environment variable `AUTOREF_KERNELS` is `scalar`: so that the scalar twins can be tested
    /// and timed as the program's own path. Read once.
    pub fn wanted() -> Kernels {
        static WANTED: LazyLock<Kernels> = LazyLock::new(|| match std::env::var("AUTOREF_KERNELS") {
            Ok(word) if word == "scalar" => Kernels::Scalar,
            _ => Kernels::Widest,
        });
        *WANTED
    }
}
