//! What a point or a comma in a number stands for where the number alone leaves it open: "500,000" is half a million or
//! five hundred. The other coordinates of the file say which.

use std::path::Path;

use crate::gcp::text;
use autoref_raster::error::{Error, Result};

/// A cell of a coordinate column, and its row.
pub(super) struct Cell<'a> {
    pub place: String,
    pub text: &'a str,
}

/// The marks of a file's coordinate columns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Marks {
    /// Stands between thousands, also where it stands alone in a number.
    thousands: Option<char>,
    certainty: Certainty,
}

/// Whether the file shows what its marks stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Certainty {
    #[default]
    Shown,
    Guessed,
}

/// What a number says of a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Says {
    Nothing,
    /// Four digits or more without a mark: this file does not group them.
    Ungrouped,
    Decimal(char),
    Thousands(char),
    ThousandsAndDecimal(char, char),
    /// One mark, and three digits after it.
    Either(char),
}

impl Says {
    fn of(text: &str) -> Says {
        if text::number(text).is_none() {
            return Says::Nothing;
        }
        let text = text.trim().trim_matches('"').trim().trim_start_matches(['+', '-']);
        let marks: Vec<(usize, char)> = text.char_indices().filter(|(_, c)| matches!(c, '.' | ',')).collect();
        let digits = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
        match marks[..] {
            [] if text.len() > 3 && digits(text) => Says::Ungrouped,
            [] => Says::Nothing,
            [(at, mark)] => {
                let (whole, rest) = (&text[..at], &text[at + 1..]);
                let groups = digits(whole) && whole.len() <= 3 && !whole.starts_with('0');
                if groups && digits(rest) && rest.len() == 3 { Says::Either(mark) } else { Says::Decimal(mark) }
            }
            [(_, first), .., (_, last)] if first == last => Says::Thousands(first),
            [(_, first), .., (_, last)] => Says::ThousandsAndDecimal(first, last),
        }
    }
}

impl Marks {
    /// Of all coordinates of a file, with what is to be said of it.
    ///
    /// # Errors
    /// [`Error::Format`] with the first number that can be read both ways, when the file shows both.
    pub fn of<'a>(path: &Path, cells: impl Iterator<Item = Cell<'a>>) -> Result<(Marks, Option<String>)> {
        let (mut decimal, mut thousands, mut open) = (Vec::new(), Vec::new(), Vec::new());
        let mut ungrouped = false;
        for cell in cells {
            match Says::of(cell.text) {
                Says::Nothing => {}
                Says::Ungrouped => ungrouped = true,
                Says::Decimal(mark) => keep_first(&mut decimal, mark, cell),
                Says::Thousands(mark) => keep_first(&mut thousands, mark, cell),
                Says::ThousandsAndDecimal(between, last) => {
                    keep_first(&mut decimal, last, Cell { place: cell.place.clone(), ..cell });
                    keep_first(&mut thousands, between, cell);
                }
                Says::Either(mark) => keep_first(&mut open, mark, cell),
            }
        }
        let find = |shown: &'_ [(char, Cell<'a>)], mark: char| shown.iter().position(|(m, _)| *m == mark);
        let mut marks = Marks::default();
        let mut note = None;
        for (mark, cell) in &open {
            let other = if *mark == '.' { ',' } else { '.' };
            let grouped = find(&thousands, *mark).map(|at| &thousands[at].1);
            let as_decimal = find(&decimal, *mark).map(|at| &decimal[at].1);
            let other_decimal = find(&decimal, other).map(|at| &decimal[at].1);
            let both = grouped.zip(as_decimal).map(|(a, b)| (a.text, b.text));
            let unshown = match &open[..] {
                [(_, a), (_, b)] if decimal.is_empty() && thousands.is_empty() => Some((a.text, b.text)),
                _ => None,
            };
            if let Some((a, b)) = both.or(unshown) {
                return Err(read_both_ways(path, cell, a, b));
            }
            let shown = grouped.or(other_decimal.filter(|_| as_decimal.is_none()));
            if let Some(shown) = shown {
                marks.thousands = Some(*mark);
                note = Some(format!(
                    "in `{}` ({}) the {} is taken for a thousands mark, as `{}` shows",
                    cell.text,
                    cell.place,
                    name(*mark),
                    shown.text
                ));
            } else if as_decimal.is_none() && thousands.is_empty() && !ungrouped {
                marks.certainty = Certainty::Guessed;
                note = Some(format!(
                    "in `{}` ({}) and the like the {} is taken for the decimal mark; if it stands between \
                     thousands, write the numbers without it",
                    cell.text,
                    cell.place,
                    name(*mark)
                ));
            }
        }
        Ok((marks, note))
    }

    /// Whether a mark was taken for the decimal one that may stand between thousands.
    pub fn are_guessed(self) -> bool {
        self.certainty == Certainty::Guessed
    }

    /// A number under these marks.
    pub fn number(self, text: &str) -> Option<f64> {
        match (self.thousands, Says::of(text)) {
            (Some(mark), Says::Either(own)) if mark == own => text::number(&text.replace(mark, "")),
            _ => text::number(text),
        }
    }
}

fn keep_first<'a>(shown: &mut Vec<(char, Cell<'a>)>, mark: char, cell: Cell<'a>) {
    if shown.iter().all(|(m, _)| *m != mark) {
        shown.push((mark, cell));
    }
}

fn name(mark: char) -> &'static str {
    if mark == '.' { "point" } else { "comma" }
}

fn read_both_ways(path: &Path, cell: &Cell<'_>, a: &str, b: &str) -> Error {
    Error::format(
        path,
        &cell.place,
        format!(
            "`{}` can be thousands or decimals: `{a}` and `{b}` in the same file contradict each other; write all \
             numbers with one decimal mark and none between thousands",
            cell.text
        ),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(cells: &[&str]) -> Result<(Vec<f64>, Option<String>)> {
        let of = |(i, text): (usize, &&'static str)| Cell { place: format!("row {}", i + 2), text };
        let cells: Vec<&'static str> = cells.iter().map(|c| &*Box::leak(c.to_string().into_boxed_str())).collect();
        let (marks, note) = Marks::of(Path::new("l.csv"), cells.iter().enumerate().map(of))?;
        Ok((cells.iter().map(|cell| marks.number(cell).expect(cell)).collect(), note))
    }

    #[test]
    fn one_number_of_a_file_says_what_its_marks_are() {
        for cells in [["500,000", "4,649,776", "-1,100"], ["500.000", "4.649.776", "-1.100"]] {
            let (values, note) = read(&cells).expect("readable");
            assert_eq!(values, [500_000.0, 4_649_776.0, -1_100.0]);
            assert!(note.is_some_and(|note| note.contains("row 2") && note.contains(cells[1])));
        }
        // The other mark is the decimal one.
        assert_eq!(read(&["500.000", "649.776,25"]).expect("readable").0, [500_000.0, 649_776.25]);
        assert_eq!(read(&["500.000", "12,5"]).expect("readable").0, [500_000.0, 12.5]);
    }

    #[test]
    fn decimals_stay_decimals() {
        for cells in [
            ["105.743", "4649776.125", "92.5"],
            ["105.743", "4649776", "92.676"],
            ["105,743", "0,125", "3"],
            ["105.743", "4,649,776", "92.676"],
        ] {
            let (values, note) = read(&cells).expect("readable");
            assert!((values[0] - 105.743).abs() < 1e-9 && note.is_none(), "{cells:?}: {values:?} {note:?}");
        }
        let (values, note) = read(&["105.743", "92.676"]).expect("readable");
        assert_eq!(values, [105.743, 92.676]);
        assert!(note.is_some_and(|note| note.contains("decimal mark") && note.contains("`105.743` (row 2)")));
    }

    #[test]
    fn a_file_that_shows_both_is_refused() {
        for cells in [["4.649.776", "12.5", "500.000"], ["500,000", "649.776", "1,100"]] {
            let error = read(&cells).expect_err("both").to_string();
            assert!(error.contains("row") && error.contains("thousands or decimals"), "{error}");
        }
    }
}
