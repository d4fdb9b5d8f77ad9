//! Tables without a header: columns of numbers, with or without a name in front or behind.

use std::path::Path;

use crate::gcp::angle::{Letter, angle, letter};
use crate::gcp::columns::Columns;
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint};
use crate::gcp::roles::is_check;
use crate::gcp::text::{self, Line, Row, SEPARATORS, Separator, refuse_open_quote, split};
use crate::gcp::{remarks, statistics};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// Whether the first column holds names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Labels {
    /// Where its values show it.
    Shown,
    /// By the format's rule, also where they are numbers (Pix4D).
    First,
}

/// Columns of numbers, with or without a name in front or behind.
pub(super) fn parse(path: &Path, lines: &[Line<'_>], labels: Labels) -> Result<RawList> {
    let rows: Vec<&Line<'_>> = lines.iter().filter(|line| !line.is_comment()).collect();
    if let Some(list) = of_angles(path, &rows) {
        return list;
    }
    let separator = SEPARATORS
        .into_iter()
        .max_by_key(|&separator| {
            // The one under which most rows look like points; of equals the first in the list.
            let good = rows.iter().filter(|line| Shape::of(&split(line.text, separator)).is_some()).count();
            (good, SEPARATORS.len() - SEPARATORS.iter().position(|s| *s == separator).expect("one of them"))
        })
        .expect("there are several");
    let mut table: Vec<Row<'_>> = rows.iter().map(|line| (*line, fields(line.text, separator))).collect();
    if separator == Separator::Blanks {
        table = with_thousands(path, table)?;
    }
    for (line, _) in &table {
        refuse_open_quote(path, line)?;
    }
    let kept = drop_empty_columns(&mut table);
    let Some(shape) = Shape::of_table(&table) else {
        let line = rows.first().map_or("row 1".into(), |line| line.place());
        return Err(Error::format(path, line, "no point: a name, two coordinates and perhaps a height are expected"));
    };
    let is_label = labels == Labels::First && shape.numbers > 2;
    let numbered = shape.first_is_a_number && (is_label || shape.first_is_a_name(&table));
    let mut columns = shape.columns(numbered, &table);
    let of_names = columns.name_among_codes(&table, &kept);
    let of_marks = columns.settle_marks(path, &table)?;
    let statistics = statistics::set_aside(&columns, &mut table);
    let mut points = Vec::new();
    for (line, fields) in &table {
        if fields.len() <= columns.easting.max(columns.northing) {
            return Err(Error::format(
                path,
                line.place(),
                format!("`{}` is no point: {} columns are expected as in the rows before", line.text, shape.fields),
            ));
        }
        points.push(columns.point(path, line.place(), fields, &(points.len() + 1).to_string())?);
    }
    if points.iter().all(|point| point.gcp.name.ends_with(':')) {
        points.iter_mut().for_each(|point| point.gcp.name.truncate(point.gcp.name.trim_end_matches(':').len()));
    }
    refuse_no_heights(path, &points, separator)?;
    let (crs, of_system) = match remarks::system(lines.iter().filter(|line| line.is_comment())) {
        Ok(Some((crs, note))) => (CrsClaim::Known(crs), Some(note)),
        Ok(None) => (CrsClaim::None, None),
        Err(why) => (CrsClaim::None, Some(why)),
    };
    let mut list = RawList::new(points, crs);
    list.order = ColumnOrder::Untitled;
    // No title says another.
    list.units.accuracies_as_coordinates = true;
    list.open_mark = columns.open_mark(&table);
    list.set_aside = statistics.aside.map(|what| format!("{}: {what}", path.display()));
    let unnamed = columns.name.is_none().then(|| "no column holds names: the points are numbered from 1".to_owned());
    let notes = [
        of_marks,
        of_system,
        of_names,
        unnamed,
        shape.left_over(&columns, &kept),
        words_of_check_points(&columns, &kept, &table),
        statistics.doubt,
    ];
    list.notes.extend(notes.into_iter().flatten().map(|what| format!("{}: {what}", path.display())));
    Ok(list)
}

/// Two columns of angles that are no plain numbers (`59°54'50.0"N`, `59.9139N`, `59:54:50.0`): their letters say which
/// is which. `None` for other tables.
fn of_angles(path: &Path, rows: &[&Line<'_>]) -> Option<Result<RawList>> {
    let is_angle = |cell: &String| text::number(cell).is_none() && angle(cell).is_some();
    let pair_of = |row: &[String]| row.windows(2).rposition(|cells| cells.iter().all(is_angle));
    let (table, first) = SEPARATORS.into_iter().find_map(|separator| {
        let table: Vec<Row<'_>> = rows.iter().map(|line| (*line, fields(line.text, separator))).collect();
        let first = pair_of(&table.first()?.1)?;
        table.iter().all(|(_, cells)| pair_of(cells) == Some(first)).then_some((table, first))
    })?;
    let letters: Vec<[Option<Letter>; 2]> =
        table.iter().map(|(_, cells)| [letter(&cells[first]), letter(&cells[first + 1])]).collect();
    let is_latitude = |letter: &Option<Letter>| *letter == Some(Letter::Latitude);
    let (easting, northing) = match () {
        () if letters.iter().all(|[a, _]| is_latitude(a)) => (first + 1, first),
        () if letters.iter().all(|[_, b]| is_latitude(b)) => (first, first + 1),
        () => {
            let (line, cells) = &table[0];
            let what = format!(
                "`{}` and `{}` are angles, and nothing shows which is the latitude: write the titles \
                 `name;lat;lon;height` (or `name;lon;lat;height`) above the rows, or N and E behind the angles",
                cells[first],
                cells[first + 1]
            );
            return Some(Err(Error::format(path, line.place(), what)));
        }
    };
    let height = table.iter().all(|(_, cells)| cells.get(first + 2).is_some_and(|cell| text::number(cell).is_some()));
    let columns = Columns {
        name: (first > 0).then_some(0),
        easting,
        northing,
        height: height.then_some(first + 2),
        geographic: true,
        order: ColumnOrder::Stated,
        ..Columns::untitled()
    };
    let points: Result<Vec<RawPoint>> = table
        .iter()
        .enumerate()
        .map(|(index, (line, cells))| columns.point(path, line.place(), cells, &(index + 1).to_string()))
        .collect();
    Some(points.and_then(|points| {
        let mut list = RawList::new(points, CrsClaim::Known(Crs::from_epsg(4326)?));
        list.titled_degrees = true;
        list.notes.push(format!("{}: the letters N and E say which column is the latitude", path.display()));
        Ok(list)
    }))
}

/// Cells cut at blanks of which some are parts of numbers ("500 100,12"): whole again where two blanks or more stand
/// between the columns.
///
/// # Errors
/// [`Error::Format`] where single blanks stand between the columns too.
fn with_thousands<'a>(path: &Path, table: Vec<Row<'a>>) -> Result<Vec<Row<'a>>> {
    if !table.iter().all(|(_, cells)| has_thousands(cells)) {
        return Ok(table);
    }
    let wide = |line: &'a Line<'a>| (line, text::at_wide_gaps(line.text));
    let cut: Vec<Row<'a>> = table.iter().map(|(line, _)| wide(line)).collect();
    let is_number = |cell: &String| !cell.contains(' ') || text::number(cell).is_some();
    if cut.iter().all(|(_, cells)| cells.len() > 2 && cells.iter().skip(1).all(is_number)) {
        return Ok(cut);
    }
    let what =
        "blanks stand between the columns and between the thousands of numbers; put semicolons between the columns";
    Err(Error::format(path, table.first().map_or("row 1".into(), |(line, _)| line.place()), what))
}

/// Whether two numbers or more of a row seem to be put together of groups of three digits, the last with decimals.
fn has_thousands(cells: &[String]) -> bool {
    let is_whole = |cell: &str, longest: usize| cell.len() <= longest && cell.bytes().all(|b| b.is_ascii_digit());
    let is_group = |cell: &str| cell.len() == 3 && is_whole(cell, 3);
    let (mut found, mut most, mut at) = (0, 0, 1);
    while at + 1 < cells.len() {
        let first = &cells[at];
        let groups = cells[at + 1..].iter().take_while(|cell| is_group(cell)).count();
        let last = cells.get(at + 1 + groups).and_then(|cell| cell.split_once(['.', ',']));
        let is_number = !first.is_empty() && is_whole(first, 3) && last.is_some_and(|(whole, _)| is_group(whole));
        found += usize::from(is_number);
        most = if is_number { most.max(groups) } else { most };
        at += if is_number { groups + 2 } else { 1 };
    }
    // A northing of millions has a group between its first and its last; "100 200.5" may be two numbers.
    found > 1 && most > 0
}

/// Takes away the columns in which no row has anything; returns which are left.
fn drop_empty_columns(table: &mut [Row<'_>]) -> Vec<usize> {
    let widest = table.iter().map(|(_, fields)| fields.len()).max().unwrap_or(0);
    let mut filled = vec![false; widest];
    for (_, fields) in table.iter() {
        fields.iter().enumerate().filter(|(_, field)| !field.is_empty()).for_each(|(at, _)| filled[at] = true);
    }
    for (_, fields) in table.iter_mut() {
        let mut is_filled = filled.iter();
        fields.retain(|_| *is_filled.next().expect("as many as the widest row has"));
    }
    (0..widest).filter(|&at| filled[at]).collect()
}

/// What lies beyond all ground in every row is no height: the columns are others than they seem.
fn refuse_no_heights(path: &Path, points: &[RawPoint], separator: Separator) -> Result<()> {
    /// Higher than any ground, in feet too.
    const NO_HEIGHT: f64 = 100_000.0;
    /// Of the Earth: coordinates that count from its centre are refused as such.
    const RADII_M: std::ops::Range<f64> = 6.33e6..6.4e6;
    let is_none = |p: &RawPoint| {
        p.gcp.height.is_some_and(|h| {
            (NO_HEIGHT..1e9).contains(&h.abs()) && !RADII_M.contains(&p.gcp.easting.hypot(p.gcp.northing).hypot(h))
        })
    };
    match points.first() {
        Some(first) if points.iter().all(is_none) => {
            let commas = match separator {
                Separator::Letter(',') => ", or quote numbers with decimal commas",
                _ => "",
            };
            Err(Error::format(
                path,
                &first.place,
                format!(
                    "there is no header, and {}, {} and {} cannot be easting, northing and height; take away what \
                     stands before and between the coordinates{commas}, or give the columns titles",
                    first.gcp.easting,
                    first.gcp.northing,
                    first.gcp.height.expect("all have one")
                ),
            ))
        }
        _ => Ok(()),
    }
}

/// Codes such as `CP` may be a surveyor's own: only a title makes a column one of roles.
fn words_of_check_points(columns: &Columns, kept: &[usize], table: &[Row<'_>]) -> Option<String> {
    let unused = |at: &usize| ![columns.name, Some(columns.easting), Some(columns.northing)].contains(&Some(*at));
    let word = |at: usize| {
        let fields = table.iter().filter_map(move |(_, fields)| fields.get(at));
        fields.filter(|field| is_check(field)).map(String::as_str)
    };
    let at = (0..kept.len()).filter(unused).find(|&at| word(at).next().is_some())?;
    Some(format!(
        "`{}` in column {} of {} rows makes no check point without the title `role`; give the columns titles, or name \
         the check points with --check",
        word(at).next()?,
        kept[at] + 1,
        word(at).count()
    ))
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

    /// Of names some may be numbers: where most rows have a name that is none, these show where the coordinates begin.
    fn of_table(table: &[Row<'_>]) -> Option<Shape> {
        let shapes = || table.iter().filter_map(|(_, fields)| Shape::of(fields));
        let named = || shapes().filter(|shape| !shape.first_is_a_number);
        if named().count() * 2 > table.len() { named().next() } else { shapes().next() }
    }

    /// Whether the first of only numbers is a running number: four or more numbers, or whole numbers beside decimals.
    fn first_is_a_name(&self, table: &[Row<'_>]) -> bool {
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
            3 => running && (!all_whole || small) && (!named || Shape::runs(table)),
            _ => running,
        }
    }

    /// Whether the first column counts upwards in small whole numbers, beside two of decimals: what stands behind them
    /// is a code.
    fn runs(table: &[Row<'_>]) -> bool {
        const MOST: u32 = 9_999;
        let has_decimals = |field: Option<&String>| field.is_some_and(|f| f.contains(['.', ',']));
        let numbers: Vec<u32> = table.iter().filter_map(|(_, fields)| fields.first()?.parse().ok()).collect();
        // Axes of a building have whole numbers, too; they rise in large steps, and lie near zero.
        let is_rising = numbers.windows(2).all(|pair| pair[0] < pair[1]);
        let value = |field: Option<&String>| field.and_then(|f| text::number(f)).map_or(0.0, f64::abs);
        let is_far = |(_, fields): &Row<'_>| (1..3).all(|at| value(fields.get(at)) >= 1e4);
        table.len() > 1
            && numbers.len() == table.len()
            && (numbers.windows(2).all(|pair| pair[1] == pair[0] + 1) || (is_rising && table.iter().all(is_far)))
            && numbers.iter().all(|number| *number <= MOST)
            && table.iter().all(|(_, fields)| (1..3).all(|at| has_decimals(fields.get(at))))
    }

    /// Whole numbers of metres are no accuracies but codes.
    fn is_code(at: usize, table: &[Row<'_>]) -> bool {
        let is_whole = |field: &String| !field.is_empty() && field.bytes().all(|b| b.is_ascii_digit());
        table.iter().all(|(_, fields)| fields.get(at).is_some_and(is_whole))
            && table.iter().any(|(_, fields)| fields.get(at).is_some_and(|field| field.bytes().any(|b| b != b'0')))
    }

    /// Three columns behind a height are no accuracies but colours, when all their numbers are whole and some large.
    fn has_colours(&self, left: usize, table: &[Row<'_>]) -> bool {
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

    /// What of a row no column took; `kept` are the places that the columns have in the file.
    fn left_over(&self, columns: &Columns, kept: &[usize]) -> Option<String> {
        let used = [columns.name, Some(columns.easting), Some(columns.northing), columns.height];
        let used: Vec<usize> = used.into_iter().chain(columns.sigma).chain([columns.sigma_height]).flatten().collect();
        let left: Vec<String> = (0..self.fields.min(kept.len()))
            .filter(|at| !used.contains(at))
            .map(|at| (kept[at] + 1).to_string())
            .collect();
        (!left.is_empty()).then(|| {
            let columns = left.join(", ");
            format!("there is no header, and column {columns} was not used; titles say what columns hold")
        })
    }

    /// How many small whole numbers (a zone, a code) stand before two that alone can be coordinates; before coordinates
    /// with decimals three may be longer (Finland's GT: line, code, point).
    fn codes(first: usize, left: usize, table: &[Row<'_>]) -> usize {
        const SMALLEST_COORDINATE: f64 = 10_000.0;
        const LONGEST_CODE: usize = 8;
        const MOST_CODES: usize = 3;
        let is_code = |field: Option<&String>, longest: usize| {
            field.is_some_and(|f| f.len() <= longest && f.bytes().all(|b| b.is_ascii_digit()))
        };
        let has_decimals = |field: Option<&String>| field.is_some_and(|f| f.contains(['.', ',']));
        let is_coordinate = |field: Option<&String>| {
            field.and_then(|f| text::number(f)).is_some_and(|v| v.abs() >= SMALLEST_COORDINATE)
        };
        let fit = |codes: usize| {
            table.iter().all(|(_, fields)| {
                let at = |i: usize| fields.get(first + i);
                let is_gt = codes == MOST_CODES && (0..2).all(|i| has_decimals(at(codes + i)));
                let longest = if is_gt { LONGEST_CODE } else { 3 };
                (0..codes).all(|i| is_code(at(i), longest)) && is_coordinate(at(codes)) && is_coordinate(at(codes + 1))
            })
        };
        (1..=MOST_CODES).filter(|codes| left >= codes + 2).find(|&codes| fit(codes)).unwrap_or(0)
    }

    fn columns(&self, numbered: bool, table: &[Row<'_>]) -> Columns {
        let first = if numbered { 1 } else { self.first_number };
        let left = self.numbers - usize::from(numbered);
        let behind = self.first_number + self.numbers;
        let name = match () {
            () if numbered => Some(0),
            () if self.first_number > 0 => Some(0),
            () if self.fields > behind => Some(behind),
            () => None,
        };
        let codes = Shape::codes(first, left, table);
        let (first, left) = (first + codes, left - codes);
        let extra = |i: usize| (left > i).then_some(first + i);
        let (sigma, sigma_height) = match left {
            6 if self.has_colours(left, table) => ([None; 2], None),
            4 | 5 if (3..left).all(|at| Shape::is_code(first + at, table)) => ([None; 2], None),
            6.. => ([extra(3), extra(4)], extra(5)),
            _ => ([extra(3), None], extra(4)),
        };
        Columns {
            name,
            easting: first,
            northing: first + 1,
            height: extra(2),
            sigma,
            sigma_height,
            ..Columns::untitled()
        }
    }
}
