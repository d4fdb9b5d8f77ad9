//! Values by their rank, in the total order of IEEE 754 (`total_cmp`): positive not-a-numbers come last.

use std::cmp::Ordering;

/// Numbers that have a rank.
pub trait Ranked: Copy {
    /// Which of two comes first.
    fn order(&self, other: &Self) -> Ordering;
}

impl Ranked for f64 {
    fn order(&self, other: &f64) -> Ordering {
        self.total_cmp(other)
    }
}

impl Ranked for f32 {
    fn order(&self, other: &f32) -> Ordering {
        self.total_cmp(other)
    }
}

impl Ranked for u8 {
    fn order(&self, other: &u8) -> Ordering {
        self.cmp(other)
    }
}

/// The median; the mean of the two in the middle when their number is even.
///
/// # Panics
/// On an empty list.
pub fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    let is_even = values.len().is_multiple_of(2);
    let (below, high, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    let low = below.iter().copied().max_by(f64::total_cmp).filter(|_| is_even);
    low.map_or(*high, |low| 0.5 * (low + *high))
}

/// The median; the upper of the two in the middle when their number is even, so that it is always one of the values.
/// `None` of none. The values change their order.
pub fn upper_median<T: Ranked>(values: &mut [T]) -> Option<T> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, T::order).1)
}

/// The upper median, and the upper median of the distances from it, which the values become. `None` of none.
pub fn upper_median_and_distance(values: &mut [f64]) -> Option<(f64, f64)> {
    let median = upper_median(values)?;
    values.iter_mut().for_each(|v| *v = (*v - median).abs());
    Some((median, upper_median(values)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_of_odd_and_even_counts() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(median(vec![7.0]), 7.0);
    }

    #[test]
    fn upper_median_is_one_of_the_values() {
        assert_eq!(upper_median(&mut [3.0f32, 1.0, 2.0]), Some(2.0));
        assert_eq!(upper_median(&mut [4u8, 1, 2, 3]), Some(3));
        assert_eq!(upper_median(&mut [1.0, f64::NAN]).map(f64::is_nan), Some(true));
        assert_eq!(upper_median::<f64>(&mut []), None);
        assert_eq!(upper_median_and_distance(&mut [4.0, 0.0, 1.0]), Some((1.0, 1.0)));
    }
}
