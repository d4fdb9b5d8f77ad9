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

/// A number with so many decimals, and one that is far too large for them as a power of ten.
///
/// ```
/// use autoref_raster::words::with_decimals;
/// assert_eq!(with_decimals(2.25, 3), "2.250");
/// assert_eq!(with_decimals(-1e300, 3), "-1e300");
/// ```
pub fn with_decimals(value: f64, decimals: usize) -> String {
    if is_huge(value) { format!("{value:e}") } else { format!("{value:.decimals$}") }
}

/// A number with all its digits, and one that is far too large for them as a power of ten.
pub fn in_short(value: f64) -> String {
    if is_huge(value) { format!("{value:e}") } else { value.to_string() }
}

fn is_huge(value: f64) -> bool {
    const MOST: f64 = 1e15;
    value.is_finite() && value.abs() >= MOST
}

/// The first names of a list, and how many more there are.
///
/// ```
/// use autoref_raster::words::some_of;
/// assert_eq!(some_of(&["a", "b"]), "a, b");
/// assert_eq!(some_of(&["a", "b", "c", "d", "e", "f", "g"]), "a, b, c, d, e and 2 more");
/// ```
pub fn some_of<S: AsRef<str>>(names: &[S]) -> String {
    first_of(names, 5)
}

/// So many first names, and how many more there are.
pub fn first_of<S: AsRef<str>>(names: &[S], shown: usize) -> String {
    let first: Vec<&str> = names.iter().take(shown).map(AsRef::as_ref).collect();
    let first = first.join(", ");
    if names.len() > shown { format!("{first} and {} more", names.len() - shown) } else { first }
}
