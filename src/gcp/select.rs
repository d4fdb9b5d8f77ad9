//! Which points are used, and which of them are kept for checking.

use std::path::Path;

use crate::gcp::raw::RawPoint;
use autoref_raster::error::{Error, Result};

/// A choice of points: a name; a pattern of names with `*` and `?`; or `COLUMN=PATTERN` for an attribute.
pub(super) struct Choice<'a>(pub &'a str);

impl Choice<'_> {
    fn takes(&self, point: &RawPoint) -> bool {
        if point.gcp.name == self.0 {
            return true;
        }
        match self.0.split_once('=') {
            Some((column, pattern)) => point
                .attributes
                .iter()
                .any(|(title, value)| title.eq_ignore_ascii_case(column.trim()) && like(pattern.trim(), value)),
            None => self.0.contains(['*', '?']) && like(self.0, &point.gcp.name),
        }
    }
}

/// Whether a text fits a pattern, letters of either case: `*` any letters, `?` any one.
fn like(pattern: &str, text: &str) -> bool {
    let pattern: Vec<char> = pattern.to_lowercase().chars().collect();
    let text: Vec<char> = text.to_lowercase().chars().collect();
    let (mut p, mut t) = (0, 0);
    let mut star: Option<(usize, usize)> = None;
    while t < text.len() {
        match pattern.get(p) {
            Some('*') => {
                star = Some((p, t));
                p += 1;
            }
            Some(c) if *c == '?' || *c == text[t] => {
                p += 1;
                t += 1;
            }
            // Let the last star take one letter more.
            _ => match star {
                Some((at, from)) => {
                    star = Some((at, from + 1));
                    p = at + 1;
                    t = from + 1;
                }
                None => return false,
            },
        }
    }
    pattern[p..].iter().all(|c| *c == '*')
}

/// Names that an error lists.
const SHOWN: usize = 12;

/// For every point whether one of the choices takes it.
///
/// # Errors
/// When a choice takes no point: it would be a slip.
pub(super) fn chosen(path: &Path, points: &[RawPoint], choices: &[String]) -> Result<Vec<bool>> {
    let mut chosen = vec![false; points.len()];
    for choice in choices {
        let mut any = false;
        for (point, chosen) in points.iter().zip(&mut chosen) {
            if Choice(choice).takes(point) {
                *chosen = true;
                any = true;
            }
        }
        if !any {
            let names = points.iter().map(|p| p.gcp.name.as_str()).take(SHOWN).collect::<Vec<_>>().join(", ");
            let more = match points.len().saturating_sub(SHOWN) {
                0 => String::new(),
                more => format!(" and {more} more"),
            };
            return Err(Error::usage(
                format!("{}: no point is called `{choice}`", path.display()),
                format!("it has {names}{more}; patterns take * and ?, attributes COLUMN=VALUE"),
            ));
        }
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Twelve names of fourteen were shown as if there were no more.
    #[test]
    fn names_that_are_not_shown_are_counted() {
        let points = |n: usize| -> Vec<RawPoint> {
            (0..n).map(|i| RawPoint::bare(crate::gcp::Gcp::control(format!("P{i}"), 0.0, 0.0), "row 1")).collect()
        };
        let said = |n: usize| {
            let chosen = chosen(Path::new("l.csv"), &points(n), &["Q*".to_owned()]);
            chosen.expect_err("no such point").to_string()
        };
        assert!(said(14).contains("P11 and 2 more; patterns"), "{}", said(14));
        assert!(said(12).contains("P11; patterns"), "{}", said(12));
    }

    #[test]
    fn stars_and_question_marks_stand_for_letters() {
        for (pattern, text, fits) in [
            ("C*", "C12", true),
            ("c*", "C12", true),
            ("C?", "C12", false),
            ("*1*2", "C112", true),
            ("*", "", true),
            ("P1", "P12", false),
            ("*GUL", "13GUL", true),
        ] {
            assert_eq!(like(pattern, text), fits, "{pattern} {text}");
        }
    }
}
