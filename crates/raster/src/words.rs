//! Words for messages.

use std::fmt::Display;

/// A count with its noun, and what else changes with it: `1 point is`, `3 points are`.
///
/// ```
/// use autoref_raster::words::counted;
/// assert_eq!(counted(1, "point is", "points are"), "1 point is");
/// assert_eq!(counted(0, "point", "points"), "0 points");
/// ```
pub fn counted<N: Display + PartialEq + From<u8>>(count: N, one: &str, many: &str) -> String {
    let word = if count == N::from(1) { one } else { many };
    format!("{count} {word}")
}
