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
