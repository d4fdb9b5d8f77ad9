//! Maps of the plane near a place.

/// A place and its derivatives: `[row][column]`.
pub(super) type Linear = ([f64; 2], [[f64; 2]; 2]);

/// `None` where the derivatives are those of a fold.
pub(super) fn inverse([[a, b], [c, d]]: [[f64; 2]; 2]) -> Option<[[f64; 2]; 2]> {
    let determinant = a * d - b * c;
    let of = [[d / determinant, -b / determinant], [-c / determinant, a / determinant]];
    of.iter().flatten().all(|v| v.is_finite()).then_some(of)
}
