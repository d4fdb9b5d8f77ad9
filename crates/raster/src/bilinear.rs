//! Bilinear interpolation: the value at a place between four others. Which four, and what lies beyond a border, is the
//! caller's. There are two ways to add up, which differ in the last bits; results hang on them, so every caller keeps
//! its own.
//!
//! `corners` are two rows of two, `at` how far the place lies to the right of the first of a row and below the first
//! row, each in shares of the way to the next.

use std::ops::{Add, Mul, Sub};

/// By the differences: what is equal stays exactly so.
#[inline]
pub fn by_differences<T>(corners: [[T; 2]; 2], at: [T; 2]) -> T
where
    T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>,
{
    let between = |[first, second]: [T; 2], share: T| first + (second - first) * share;
    let [above, below] = corners;
    between([between(above, at[0]), between(below, at[0])], at[1])
}

/// By weights that sum to one, of numbers or vectors: at a corner it is the corner's value exactly.
#[inline]
pub fn by_weights<T, W>(corners: [[T; 2]; 2], at: [W; 2]) -> T
where
    T: Copy + Add<Output = T> + Mul<W, Output = T>,
    W: Copy + From<u8> + Sub<Output = W>,
{
    let between = |[first, second]: [T; 2], share: W| first * (W::from(1) - share) + second * share;
    let [above, below] = corners;
    between([between(above, at[0]), between(below, at[0])], at[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_itself_between_its_corners() {
        let corners = [[1.0, 3.0], [5.0, 7.0]];
        assert_eq!(by_differences(corners, [0.25, 0.5]), 3.5);
        assert_eq!(by_weights(corners, [0.25, 0.5]), 3.5);
        assert_eq!(by_weights(corners, [1.0, 0.0]), 3.0);
        assert_eq!(by_differences(corners, [0.0, 1.0]), 5.0);
        assert_eq!(by_weights([[1.0f32; 2]; 2], [0.5f32, 0.5]), 1.0);
    }
}
