//! Cells of exactly 0 where the other model is far above or below: the collar of a file that does not say that its 0
//! stands for no height.

use std::path::Path;

/// Common cells in which one model is exactly 0, and the other is not near it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Zeros {
    pub a: u64,
    pub b: u64,
}

/// The sea of one model lies within this of the other's, metres.
const FAR_M: f64 = 10.0;
/// Fewer of the common cells may be so by chance.
const NOTABLE_SHARE: f64 = 0.005;

impl Zeros {
    #[inline]
    pub(crate) fn see(&mut self, a_m: f64, b_m: f64) {
        self.a += u64::from(a_m == 0.0 && b_m.abs() > FAR_M);
        self.b += u64::from(b_m == 0.0 && a_m.abs() > FAR_M);
    }

    pub(crate) fn merge(&mut self, other: Zeros) {
        self.a += other.a;
        self.b += other.b;
    }

    /// The same with the names exchanged.
    pub(crate) fn exchanged(self) -> Zeros {
        Zeros { a: self.b, b: self.a }
    }

    /// What is to be said of it, of so many common cells.
    pub fn notes(&self, common_cells: u64, a: &Path, b: &Path) -> Vec<String> {
        let note = |(letter, zeros, path): (&str, u64, &Path)| {
            let share = zeros as f64 / common_cells.max(1) as f64;
            (share > NOTABLE_SHARE).then(|| {
                format!(
                    "{letter} is exactly 0 in {:.1} % of the common cells, where the other model is more than {FAR_M} m \
                     off: where 0 stands for no height, say so (gdal_edit.py -a_nodata 0 {})",
                    100.0 * share,
                    path.display()
                )
            })
        };
        [("A", self.a, a), ("B", self.b, b)].into_iter().filter_map(note).collect()
    }
}
