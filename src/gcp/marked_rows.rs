//! Rows that begin as remarks do and look like points: points that were commented out, or points whose names begin
//! with `#` or `!`.
//!
//! Who comments a point out leaves its name as it is, like those of the other points, and often a blank before it.
//! Names that begin with a mark go on with a number (`#1`), and either all points have such names or the others have
//! letters.

use crate::gcp::text::{Line, SEPARATORS, Separator, number, split};

/// Rows that a message names.
const NAMED: usize = 4;
/// Cells of a point: a name and two coordinates.
const LEAST_CELLS: usize = 3;
/// Rows of titles and units.
const MOST_TITLES: usize = 2;

/// The lines with the points among them told, and what is to be said of it.
pub(super) struct Told<'a> {
    pub lines: Vec<Line<'a>>,
    pub note: Option<String>,
    /// Rows that were taken for remarks, in words.
    pub remarks: Option<String>,
}

/// A row of the table, or one that looks like it behind its mark.
struct Cells {
    /// Behind the mark, if any.
    name: String,
    /// Whether the cells behind the first are numbers; `None` of empty ones.
    numbers: Vec<Option<bool>>,
}

impl Cells {
    /// `None` where fewer than two cells behind the first are numbers.
    fn of(text: &str, separator: Separator) -> Option<Cells> {
        let cells = split(text, separator);
        let (name, rest) = cells.split_first()?;
        let is_number = |cell: &String| (!cell.is_empty()).then(|| number(cell).is_some());
        let numbers: Vec<Option<bool>> = rest.iter().map(is_number).collect();
        let coordinates = numbers.iter().filter(|is_number| **is_number == Some(true)).count();
        (coordinates >= 2).then(|| Cells { name: name.trim().to_owned(), numbers })
    }

    /// Numbers where the other has them; cells at the end may be left out of either.
    fn is_like(&self, other: &Cells) -> bool {
        let agree = |(one, two): (&Option<bool>, &Option<bool>)| one.is_none() || two.is_none() || one == two;
        let shorter = self.numbers.len().min(other.numbers.len());
        let enough = shorter >= LEAST_CELLS || self.numbers.len() == other.numbers.len();
        enough && self.numbers.iter().zip(&other.numbers).all(agree)
    }
}

fn is_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Tells points whose names begin as remarks do from remarks.
pub(super) fn told<'a>(lines: &[Line<'a>]) -> Told<'a> {
    let nothing = || Told { lines: lines.to_vec(), note: None, remarks: None };
    if !lines.iter().any(Line::is_comment) {
        return nothing();
    }
    let behind = |line: &Line<'a>| line.text.trim_start_matches(['#', '!', '/']);
    let unmarked = || lines.iter().filter(|line| !line.is_comment());
    let cut = |separator: Separator| {
        let points: Vec<Cells> = unmarked().filter_map(|line| Cells::of(line.text, separator)).collect();
        let row = |(at, line): (usize, &Line<'a>)| {
            let cells = Cells::of(behind(line).trim_start(), separator).filter(|_| line.is_comment())?;
            (points.is_empty() || points.iter().any(|point| cells.is_like(point))).then_some((at, cells))
        };
        // What stands above titles speaks of the file.
        let first = lines.iter().position(|line| !line.is_comment());
        let first = first.filter(|at| Cells::of(lines[*at].text, separator).is_none()).unwrap_or(0);
        let marked: Vec<(usize, Cells)> = lines.iter().enumerate().skip(first).filter_map(row).collect();
        (marked, points)
    };
    // Cut as most other points are; without any only titles and units may stand there, or the points are of a form that
    // is not known here. Of equals the first.
    let mut cuts: Vec<_> = SEPARATORS.into_iter().map(cut).collect();
    cuts.sort_by_key(|(marked, points)| std::cmp::Reverse((points.len(), marked.len())));
    let (marked, points) = cuts.swap_remove(0);
    if marked.is_empty() || (points.is_empty() && unmarked().count() > MOST_TITLES) {
        return nothing();
    }
    let is_name = |(at, cells): &(usize, Cells)| {
        let line = &lines[*at];
        let has_mark = line.text.starts_with(['#', '!']) && line.text.len() == behind(line).len() + 1;
        let may_be = is_digits(&cells.name) || (points.is_empty() && number(&cells.name).is_none());
        has_mark && !behind(line).starts_with(char::is_whitespace) && may_be
    };
    // Numbers there are names without a mark, or coordinates.
    let may_be_names = !points.iter().any(|point| number(&point.name).is_some());
    let (named, left): (Vec<_>, Vec<_>) = marked.into_iter().partition(|row| may_be_names && is_name(row));
    let mut told = lines.to_vec();
    named.iter().for_each(|(at, _)| told[*at].is_point = true);
    let of_names = (!named.is_empty()).then(|| {
        let rows = rows(lines, &named);
        format!("{rows} as remarks do: taken for points with such names; a blank behind the mark makes a remark")
    });
    let remarks = (!left.is_empty()).then(|| {
        let rows = rows(lines, &left);
        format!(
            "{rows} as remarks do: taken for points that are commented out; where they are points, quote their names"
        )
    });
    let notes: Vec<String> = of_names.into_iter().chain(remarks.clone()).collect();
    Told { lines: told, note: (!notes.is_empty()).then(|| notes.join("; ")), remarks }
}

/// "rows 2, 3 and 5 begin with `#`".
fn rows(lines: &[Line<'_>], marked: &[(usize, Cells)]) -> String {
    let mark = lines[marked[0].0].text.chars().next().unwrap_or('#');
    let rows: Vec<String> = marked.iter().map(|(at, _)| lines[*at].row.to_string()).collect();
    match &rows[..] {
        [row] => format!("row {row} begins with `{mark}`"),
        [first @ .., last] if rows.len() <= NAMED => {
            format!("rows {} and {last} begin with `{mark}`", first.join(", "))
        }
        _ => format!("rows {} and {} more begin with `{mark}`", rows[..NAMED - 1].join(", "), rows.len() - NAMED + 1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcp::text::lines;

    fn of(text: &str) -> (Vec<usize>, Option<String>) {
        let told = told(&lines(text));
        let points = told.lines.iter().filter(|line| !line.is_comment() && line.text.starts_with(['#', '!']));
        (points.map(|line| line.row).collect(), told.note)
    }

    #[test]
    fn names_with_a_mark_are_points() {
        let titles = "name,easting,northing,height\n";
        for (text, rows) in [
            ("#0,500021.8,5999994.7,100\n#1,500016.1,5999986.1,101\nG4,500002.5,5999991.2,104\n", vec![2, 3]),
            ("#0,500021.8,5999994.7,100\n#1,500016.1,5999986.1,101\n", vec![2, 3]),
            ("!A,500021.8,5999994.7,100\n!B,500016.1,5999986.1,\n", vec![2, 3]),
        ] {
            let (found, note) = of(&format!("{titles}{text}"));
            assert_eq!(found, rows, "{text}");
            assert!(note.expect(text).contains("rows 2 and 3 begin with"), "{text}");
        }
        assert_eq!(of("#1 500021.8 5999994.7\n#2 500016.1 5999986.1\nN3 500002.5 5999991.2\n").0, [1, 2]);
        assert_eq!(of("#1;500021,8;5999994,7\n#2;500016,1;5999986,1\n").0, [1, 2]);
    }

    #[test]
    fn points_that_are_commented_out_stay_so_and_are_named() {
        let titles = "name,easting,northing,height\n";
        for row in ["# G5,500021.8,5999994.7,100", "#G5,500021.8,5999994.7,12", "//G5,500021.8,5999994.7,12"] {
            let (found, note) = of(&format!("{titles}G4,500002.5,5999991.2,104\n{row}\n"));
            assert!(found.is_empty() && note.expect(row).contains("row 3 begins with"), "{row}");
        }
        // Of points with numbers for names.
        let (found, note) = of(&format!("{titles}1,500002.5,5999991.2,104\n#2,500021.8,5999994.7,100\n"));
        assert!(found.is_empty() && note.expect("said").contains("commented out"));
    }

    #[test]
    fn one_list_may_have_both() {
        let (found, note) = of("#1,500021.8,5999994.7\n#2,500016.1,5999986.1\n# 3,500002.5,5999991.2\n");
        let note = note.expect("said");
        assert!(found == [1, 2] && note.contains("rows 1 and 2") && note.contains("; row 3 begins"), "{note}");
    }

    #[test]
    fn of_other_remarks_nothing_is_said() {
        let text = "# EPSG:25832\n# surveyed 2024 05 12\n#Label,X/East,Y/North,Z/Altitude\nG4,500002.5,5999991.2,104\n\
                    # Total error,,,,0.02\n# 12 points of 2\n";
        assert_eq!(of(text), (Vec::new(), None));
        assert_eq!(of("name,easting,northing\nG4,500002.5,5999991.2\n"), (Vec::new(), None));
    }
}
