//! How far points lie beside the line that fits them best.

use nalgebra::{Matrix3, Vector3};

/// Points whose root mean square beside their line is within so many standard deviations lie beside it by chance.
pub(crate) const BY_CHANCE: f64 = 2.0;

/// Root mean squares along the line that fits points best, and across it where they spread most.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Spread {
    pub along: f64,
    pub across: f64,
}

pub(crate) fn spread(points: &[Vector3<f64>]) -> Spread {
    let n = points.len().max(1) as f64;
    let mean = points.iter().sum::<Vector3<f64>>() / n;
    let about: Matrix3<f64> = points.iter().map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut moments: [f64; 3] = about.symmetric_eigenvalues().into();
    moments.sort_by(f64::total_cmp);
    let root = |moment: f64| (moment.max(0.0) / n).sqrt();
    Spread { along: root(moments[2]), across: root(moments[1]) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_in_a_row_have_no_width() {
        let row: Vec<Vector3<f64>> = (0..5).map(|i| Vector3::new(100.0 * f64::from(i), 0.0, 500.0)).collect();
        assert!(spread(&row).across < 1e-6);
        let two: Vec<Vector3<f64>> =
            row.iter().flat_map(|p| [p - Vector3::y() * 30.0, p + Vector3::y() * 30.0]).collect();
        assert!((spread(&two).across - 30.0).abs() < 1e-6);
    }
}
