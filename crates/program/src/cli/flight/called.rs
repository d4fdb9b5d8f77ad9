//! Names, and patterns of them.

/// Whether a name is one of a pattern, in which `*` stands for any letters.
pub fn matches_pattern(name: &str, pattern: &str) -> bool {
    let mut parts = pattern.split('*');
    let first = parts.next().unwrap_or("");
    let Some(mut rest) = name.strip_prefix(first) else { return false };
    let parts: Vec<&str> = parts.collect();
    for (i, part) in parts.iter().enumerate() {
        if i + 1 == parts.len() {
            return rest.ends_with(part);
        }
        match rest.find(part) {
            Some(at) => rest = &rest[at + part.len()..],
            None => return false,
        }
    }
    rest.is_empty()
}

/// Whether a point is called so, or as a pattern with `*` says.
pub fn is_called(name: &str, wanted: &str) -> bool {
    name == wanted || matches_pattern(name, wanted)
}
