//! Tables without a header: columns of numbers, with or without a name in front or behind.

use std::path::Path;

use crate::gcp::csv_list::Columns;
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList};
use crate::gcp::text::{self, Line, SEPARATORS, Separator, split};
use autoref_raster::error::{Error, Result};

/// Columns of numbers, with or without a name in front or behind.
pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let rows: Vec<&Line<'_>> = lines.iter().filter(|line| !line.is_comment()).collect();
    let separator = SEPARATORS
        .into_iter()
        .max_by_key(|&separator| {
            // The one under which most rows look like points; of equals the first in the list.
            let good = rows.iter().filter(|line| Shape::of(&split(line.text, separator)).is_some()).count();
            (good, SEPARATORS.len() - SEPARATORS.iter().position(|s| *s == separator).expect("one of them"))
        })
        .expect("there are several");
    let table: Vec<(&Line<'_>, Vec<String>)> = rows.iter().map(|line| (*line, fields(line.text, separator))).collect();
    let Some(shape) = table.iter().find_map(|(_, fields)| Shape::of(fields)) else {
        let line = rows.first().map_or("row 1".into(), |line| line.place());
        return Err(Error::format(path, line, "no point: a name, two coordinates and perhaps a height are expected"));
    };
    let numbered = shape.first_is_a_number && shape.first_is_a_name(&table);
    let columns = shape.columns(numbered, &table);
    let mut points = Vec::new();
    for (line, fields) in &table {
        if fields.len() <= columns.easting.max(columns.northing) {
            return Err(Error::format(
                path,
                line.place(),
                format!("`{}` is no point: {} columns are expected as in the rows before", line.text, shape.fields),
            ));
        }
        let mut point = columns.point(path, line.place(), fields, &line.row.to_string())?;
        point.gcp.name = point.gcp.name.trim_end_matches(':').to_string();
        points.push(point);
    }
    let mut list = RawList::new(points, CrsClaim::None);
    list.order = ColumnOrder::Assumed;
    list.notes.extend(shape.left_over(&columns).map(|what| format!("{}: {what}", path.display())));
    Ok(list)
}

fn fields(line: &str, separator: Separator) -> Vec<String> {
    let fields = split(line, separator);
    match separator {
        // Excel ends rows with separators.
        Separator::Letter(_) if fields.last().is_some_and(|f| f.is_empty()) => {
            let kept = fields.iter().rposition(|f| !f.is_empty()).map_or(0, |at| at + 1);
            fields[..kept].to_vec()
        }
        _ => fields,
    }
}

/// What the first good row of a table without a header looks like.
#[derive(Clone, Copy, Debug)]
struct Shape {
    fields: usize,
    /// Numbers that follow one another.
    first_number: usize,
    numbers: usize,
    first_is_a_number: bool,
}

impl Shape {
    fn of(fields: &[String]) -> Option<Shape> {
        let is_number = |field: &String| text::number(field).is_some();
        // "P1 7032516.8 570406.9 80.3", "1001 GCP 7032516.8 570406.9", "7032516.8 570406.9 P1".
        let (first_number, numbers) = (0..fields.len())
            .map(|at| (at, fields[at..].iter().take_while(|f| is_number(f)).count()))
            .max_by_key(|(at, count)| (*count, usize::MAX - at))?;
        let first_is_a_number = first_number == 0;
        (numbers >= 2).then_some(Shape { fields: fields.len(), first_number, numbers, first_is_a_number })
    }

    /// Whether the first of only numbers is a running number: four or more numbers, or whole numbers beside decimals.
    fn first_is_a_name(&self, table: &[(&Line<'_>, Vec<String>)]) -> bool {
        let whole =
            |field: Option<&String>| field.is_some_and(|f| !f.is_empty() && f.bytes().all(|b| b.is_ascii_digit()));
        let running = table.iter().all(|(_, fields)| whole(fields.first()));
        // Whole numbers throughout: a running number is small beside coordinates.
        let value = |field: Option<&String>| field.and_then(|f| text::number(f)).map_or(0.0, f64::abs);
        let all_whole = table.iter().all(|(_, fields)| fields.iter().take(self.numbers).all(|f| whole(Some(f))));
        let small = table.iter().all(|(_, fields)| {
            value(fields.first()) < 1e4 && value(fields.get(1)) >= 1e4 && value(fields.get(2)) >= 1e4
        });
        let behind = self.first_number + self.numbers;
        // "0.0*" is a number with a mark.
        let is_name = |field: &String| text::number(field.trim_end_matches(['*', '?', '!'])).is_none();
        let named = table.iter().all(|(_, fields)| fields.get(behind).is_some_and(is_name));
        match self.numbers {
            0..=2 => false,
            3 => running && (!all_whole || small) && !named,
            _ => running,
        }
    }

    /// Three columns behind a height are no accuracies but colours, when all their numbers are whole and some large.
    fn has_colours(&self, left: usize, table: &[(&Line<'_>, Vec<String>)]) -> bool {
        let last = self.first_number + self.numbers;
        let whole = |field: &String| field.parse::<u8>().ok();
        let mut most = 0;
        let all = table.iter().all(|(_, fields)| {
            let colours = fields.get(last - 3..last).unwrap_or_default();
            let values: Vec<u8> = colours.iter().filter_map(whole).collect();
            most = most.max(values.iter().copied().max().unwrap_or(0));
            values.len() == 3
        });
        left == 6 && all && most > 20
    }

    /// What of a row no column took.
    fn left_over(&self, columns: &Columns) -> Option<String> {
        let used = [columns.name, Some(columns.easting), Some(columns.northing), columns.height, columns.role];
        let used: Vec<usize> = used.into_iter().chain(columns.sigma).chain([columns.sigma_height]).flatten().collect();
        let left: Vec<String> =
            (0..self.fields).filter(|at| !used.contains(at)).map(|at| (at + 1).to_string()).collect();
        (!left.is_empty()).then(|| format!("there is no header, and column {} was not used", left.join(", ")))
    }

    fn columns(&self, numbered: bool, table: &[(&Line<'_>, Vec<String>)]) -> Columns {
        let first = if numbered { 1 } else { self.first_number };
        let left = self.numbers - usize::from(numbered);
        let behind = self.first_number + self.numbers;
        let name = match () {
            () if numbered => Some(0),
            () if self.first_number > 0 => Some(0),
            () if self.fields > behind => Some(behind),
            () => None,
        };
        let role = (self.fields > behind && name != Some(behind)).then_some(behind);
        let extra = |i: usize| (left > i).then_some(first + i);
        let (sigma, sigma_height) = match left {
            6 if self.has_colours(left, table) => ([None; 2], None),
            6.. => ([extra(3), extra(4)], extra(5)),
            _ => ([extra(3), None], extra(4)),
        };
        Columns {
            doubled: None,
            titles: Vec::new(),
            name,
            likely_name: None,
            easting: first,
            northing: first + 1,
            height: extra(2),
            sigma,
            sigma_height,
            role,
            check: None,
            enabled: None,
            crs: None,
            geographic: false,
            order: ColumnOrder::Assumed,
        }
    }
}
