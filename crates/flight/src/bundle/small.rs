//! Products and factors of small matrices, spelled out: the compiler unrolls them, and nothing is copied.

use nalgebra::{Matrix3, SMatrix, SVector};

/// a b.
#[inline(always)]
pub(super) fn times<const R: usize, const K: usize, const C: usize>(
    a: &SMatrix<f64, R, K>,
    b: &SMatrix<f64, K, C>,
) -> SMatrix<f64, R, C> {
    let mut out = SMatrix::zeros();
    for c in 0..C {
        for k in 0..K {
            for r in 0..R {
                out[(r, c)] += a[(r, k)] * b[(k, c)];
            }
        }
    }
    out
}

/// aᵀ b of matrices with two rows. nalgebra's product is a call for each column.
#[inline(always)]
pub(super) fn across<const R: usize, const C: usize>(
    a: &SMatrix<f64, 2, R>,
    b: &SMatrix<f64, 2, C>,
) -> SMatrix<f64, R, C> {
    let mut out = SMatrix::zeros();
    for c in 0..C {
        for r in 0..R {
            out[(r, c)] = a[(0, r)] * b[(0, c)] + a[(1, r)] * b[(1, c)];
        }
    }
    out
}

/// A lower triangle whose product with its transpose is a symmetric matrix.
pub(super) struct Lower<const N: usize>(SMatrix<f64, N, N>);

impl<const N: usize> Lower<N> {
    /// Of the lower triangle of a matrix; `None` where it is not positive definite.
    #[inline(always)]
    pub fn of(matrix: &SMatrix<f64, N, N>) -> Option<Self> {
        let mut l = *matrix;
        for j in 0..N {
            for k in 0..j {
                let factor = l[(j, k)];
                for r in j..N {
                    l[(r, j)] -= factor * l[(r, k)];
                }
            }
            if l[(j, j)].is_nan() || l[(j, j)] <= 0.0 {
                return None;
            }
            let root = l[(j, j)].sqrt();
            l[(j, j)] = root;
            for r in j + 1..N {
                l[(r, j)] /= root;
            }
        }
        Some(Lower(l))
    }

    /// The entry of row and column `i`.
    pub fn diagonal(&self, i: usize) -> f64 {
        self.0[(i, i)]
    }

    /// x of L Lᵀ x = b.
    #[inline(always)]
    pub fn solve(&self, b: &SVector<f64, N>) -> SVector<f64, N> {
        let (l, mut x) = (&self.0, *b);
        for i in 0..N {
            x[i] /= l[(i, i)];
            for r in i + 1..N {
                x[r] -= x[i] * l[(r, i)];
            }
        }
        for i in (0..N).rev() {
            let mut known = 0.0;
            for r in i + 1..N {
                known += l[(r, i)] * x[r];
            }
            x[i] = (x[i] - known) / l[(i, i)];
        }
        x
    }

    /// The inverse of L Lᵀ.
    #[inline(always)]
    pub fn inverse(&self) -> SMatrix<f64, N, N> {
        let mut out = SMatrix::<f64, N, N>::zeros();
        for c in 0..N {
            let mut unit = SVector::zeros();
            unit[c] = 1.0;
            out.set_column(c, &self.solve(&unit));
        }
        out
    }
}

/// One step of Newton towards the nearest rotation: rounding must not add up over iterations.
pub(super) fn tidy(r: Matrix3<f64>) -> Matrix3<f64> {
    times(&r, &(Matrix3::identity() * 3.0 - times(&r.transpose(), &r))) * 0.5
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix4, Vector4};

    use super::*;

    #[test]
    fn a_factor_solves_what_it_was_made_of() {
        let b = Matrix4::from_fn(|r, c| f64::from(u8::from(r == c)) + (3.0 * r as f64 + 7.0 * c as f64).sin());
        let m = b * b.transpose();
        let mut lower = m;
        lower.fill_upper_triangle(f64::NAN, 1);
        let factor = Lower::of(&lower).expect("positive definite");
        let x = Vector4::new(1.0, -2.0, 0.5, 3.0);
        assert!((factor.solve(&(m * x)) - x).norm() < 1e-12);
        assert!((times(&factor.inverse(), &m) - Matrix4::identity()).norm() < 1e-12);
        assert!(Lower::of(&-m).is_none() && Lower::of(&(m * f64::NAN)).is_none());
    }
}
