//! GCPs as a table: comma, semicolon, tab or blanks between the columns.
//!
//! With a header the columns may stand in any order, under the titles that surveyors use. Without one (Pix4D, total
//! stations) they are: a name, unless every column is a number and the first is no running one; two coordinates; a
//! height; accuracies, one or two (plan, height) or three (of each coordinate). Which of the coordinates is the easting
//! is decided later, by the CRS and the values.

use std::path::Path;

use crate::gcp::angle::{Letter, angle, letter};
use crate::gcp::marks::{Cell, Marks};
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::text::{self, Line, SEPARATORS, Separator, split};
use crate::gcp::titles::{
    CHECKS, EASTINGS, ENABLED, HEIGHTS, LATITUDES, LONGITUDES, NAMES, NORTHINGS, ROLES, SHORT_SIGMA_HEIGHTS,
    SIGMA_EASTS, SIGMA_HEIGHTS, SIGMA_NORTHS, SIGMAS, XS, YS, find, find_likely_name, tidy,
};
use crate::gcp::units::{TitledUnits, Unit};
use crate::gcp::{Gcp, GcpRole, headerless, heights};
use autoref_raster::cells::without_apostrophe;
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

/// Where the columns of a table are.
pub(super) struct Columns {
    pub titles: Vec<String>,
    pub name: Option<usize>,
    /// Names, if its values tell the points apart.
    pub likely_name: Option<usize>,
    pub easting: usize,
    pub northing: usize,
    pub height: Option<usize>,
    /// Of the plan; two for one of each coordinate.
    pub sigma: [Option<usize>; 2],
    pub sigma_height: Option<usize>,
    pub role: Option<usize>,
    pub check: Option<usize>,
    pub enabled: Option<usize>,
    pub crs: Option<usize>,
    /// Emlid's: the system's name, as people say it.
    pub crs_name: Option<usize>,
    /// A title that stands over two columns, one of which would be taken.
    pub doubled: Option<String>,
    pub geographic: bool,
    pub order: ColumnOrder,
    /// Of easting, northing and height.
    pub marks: Marks,
}

/// A row of a table, cut.
pub(super) type Row<'a> = (&'a Line<'a>, Vec<String>);

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let Some(first) = lines.iter().find(|line| !line.is_comment()) else {
        return Err(Error::format(
            path,
            "row 1",
            "the file holds no points; a header and one line for each are expected",
        ));
    };
    match header(lines) {
        Some((at, separator, columns)) => with_header(path, lines, at, separator, columns),
        None if has_numbers(first.text) => headerless::parse(path, lines),
        None => refuse_open_quote(path, first).and(Err(no_header(path, first))),
    }
}

/// Whether a line names both coordinates.
pub(super) fn is_header(line: Line<'_>) -> bool {
    header(&[line]).is_some()
}

/// The line among the first ones that names both coordinates; it may be a comment, as in Metashape's exports.
fn header(lines: &[Line<'_>]) -> Option<(usize, Separator, Columns)> {
    lines.iter().take(12).enumerate().find_map(|(at, line)| {
        let titles = line.text.trim_start_matches(['#', '!', '/']).trim();
        SEPARATORS.iter().find_map(|&separator| {
            let columns = columns(split(titles, separator))?;
            Some((at, separator, columns))
        })
    })
}

fn has_numbers(line: &str) -> bool {
    SEPARATORS.iter().any(|&separator| split(line, separator).iter().filter(|f| angle(f).is_some()).count() >= 2)
}

fn no_header(path: &Path, line: &Line<'_>) -> Error {
    let shown: String = line.text.chars().take(80).collect();
    let titles = SEPARATORS.iter().map(|&s| split(line.text, s)).max_by_key(Vec::len).unwrap_or_default();
    let titles: Vec<String> = titles.iter().map(|t| tidy(t)).collect();
    let missing = if find(&titles, &[EASTINGS, XS, LONGITUDES].concat()).is_none() { "easting" } else { "northing" };
    Error::format(
        path,
        line.place(),
        format!("no column for the {missing} in the header `{shown}`; name one easting and one northing"),
    )
}

/// The columns that titles name, when both coordinates are among them.
pub(super) fn columns(titles: Vec<String>) -> Option<Columns> {
    let tidied: Vec<String> = titles.iter().map(|t| tidy(t)).collect();
    let find = |names: &[&str]| find(&tidied, names);
    let pair = |a: &[&str], b: &[&str]| find(a).zip(find(b)).filter(|(a, b)| a != b);
    let (easting, northing, geographic, order) = if let Some((e, n)) = pair(EASTINGS, NORTHINGS) {
        (e, n, false, ColumnOrder::Stated)
    } else if let Some((e, n)) = pair(LONGITUDES, LATITUDES) {
        (e, n, true, ColumnOrder::Stated)
    } else {
        let (x, y) = pair(XS, YS)?;
        (x, y, false, ColumnOrder::Assumed)
    };
    let (name, height) = (find(NAMES).filter(|i| *i != easting && *i != northing), find(HEIGHTS));
    // MicMac calls the name N, before X, Y and Z.
    let micmac = || tidied.iter().position(|title| title == "n").filter(|_| order == ColumnOrder::Assumed);
    let name = name.or_else(micmac);
    // One of them alone may be a serial number or a signal's height; MicMac's Ix and Iy without Iz may be pixels.
    let both = [find(SIGMA_EASTS), find(SIGMA_NORTHS)];
    let is_pixel = |at: &Option<usize>| at.is_some_and(|at| tidied[at] == "ix") && find(&["iz"]).is_none();
    let both = if both.contains(&None) || is_pixel(&both[0]) { [None; 2] } else { both };
    let short = || find(SHORT_SIGMA_HEIGHTS).filter(|_| both[0].is_some());
    let twice = |i: &usize| tidied.iter().filter(|title| **title == tidied[*i]).count() > 1;
    let doubled = [Some(easting), Some(northing), name, height].into_iter().flatten().find(twice);
    Some(Columns {
        name,
        likely_name: find_likely_name(&tidied).filter(|i| *i != easting && *i != northing),
        easting,
        northing,
        height,
        doubled: doubled.map(|i| titles[i].trim().to_owned()),
        sigma: find(SIGMAS).map_or(both, |one| [Some(one), None]),
        sigma_height: find(SIGMA_HEIGHTS).or_else(short),
        role: find(ROLES),
        check: find(CHECKS),
        enabled: find(ENABLED),
        crs: find(&["crs"]),
        crs_name: find(&["cs name"]),
        geographic,
        order,
        titles,
        marks: Marks::default(),
    })
}

fn with_header(
    path: &Path,
    lines: &[Line<'_>],
    at: usize,
    separator: Separator,
    mut columns: Columns,
) -> Result<RawList> {
    if let Some(title) = &columns.doubled {
        let what = format!("two columns are called `{title}`; remove or rename the one that is not meant");
        return Err(Error::format(path, lines[at].place(), what));
    }
    let rows: Vec<Row<'_>> = lines[at + 1..]
        .iter()
        .filter(|line| !line.is_comment())
        .map(|line| (line, split(line.text, separator)))
        .collect();
    for row in &rows {
        refuse_open_quote(path, row.0)?;
        refuse_more_cells(path, row, columns.titles.len(), separator)?;
    }
    let guessed = columns.guess_name(&rows);
    let of_marks = columns.settle_marks(path, &rows)?;
    let mut points = Vec::new();
    for (line, fields) in &rows {
        points.push(columns.point(path, line.place(), fields, &line.row.to_string())?);
    }
    let mut stated = coordinate_system_comment(path, &lines[..at])?;
    if let (CrsClaim::None, Some(column), Some(point)) = (&stated, columns.crs, points.first())
        && let Some((_, definition)) = point.attributes.get(column).filter(|(_, text)| !text.trim().is_empty())
    {
        stated = CrsClaim::read(path, point.place.clone(), definition);
    }
    let mut no_system = None;
    if let CrsClaim::None = stated {
        match columns.named_system(&rows) {
            Ok(crs) => stated = crs.map_or(CrsClaim::None, CrsClaim::Known),
            Err(why) => no_system = Some(why),
        }
    }
    let crs = match stated {
        CrsClaim::None if columns.geographic => CrsClaim::Known(Crs::from_epsg(4326)?),
        stated => stated,
    };
    let mut list = RawList::new(points, crs);
    columns.tell(&mut list);
    list.notes
        .extend(of_marks.into_iter().chain(guessed).chain(no_system).map(|what| format!("{}: {what}", path.display())));
    list.notes.extend(columns.unclear().map(|what| format!("{}: {what}", path.display())));
    if let Some(skipped) = lines[..at].iter().find(|line| !line.is_comment()) {
        list.notes.push(format!(
            "{}: row {} and what is above the header was passed over",
            path.display(),
            skipped.row
        ));
    }
    Ok(list)
}

/// A quote that opens a cell and is not closed takes the columns behind it into the cell.
pub(super) fn refuse_open_quote(path: &Path, line: &Line<'_>) -> Result<()> {
    if !text::is_open_after(line.text, text::Quote::Closed) {
        return Ok(());
    }
    Err(Error::format(path, line.place(), "a quote (\") opens a cell and is not closed; close it, or take it away"))
}

/// A row with more cells than there are titles was cut where it should not be.
fn refuse_more_cells(path: &Path, (line, fields): &Row<'_>, titles: usize, separator: Separator) -> Result<()> {
    let cells = fields.iter().rposition(|field| !field.is_empty()).map_or(0, |at| at + 1);
    if cells <= titles {
        return Ok(());
    }
    let cause = match separator {
        Separator::Letter(',') => {
            "numbers with decimal commas, or other commas in a cell: quote such cells, or put semicolons between the \
             columns"
        }
        Separator::Letter(_) => "the separator within a cell: quote such cells",
        Separator::Blanks => "blanks within a cell: put semicolons between the columns",
    };
    let what = format!("{cells} cells under {titles} titles, as from {cause}; a column of its own needs a title");
    Err(Error::format(path, line.place(), what))
}

/// Metashape writes "#CoordinateSystem: WKT" above its header.
fn coordinate_system_comment(path: &Path, lines: &[Line<'_>]) -> Result<CrsClaim> {
    for line in lines.iter().filter(|line| line.is_comment()) {
        let content = line.text.trim_start_matches(['#', '!', '/']).trim();
        let Some((key, value)) = content.split_once(':') else { continue };
        let key = key.to_lowercase().replace([' ', '_'], "");
        if matches!(key.as_str(), "coordinatesystem" | "crs") && !value.trim().is_empty() {
            return Ok(CrsClaim::read(path, line.place(), value.trim().trim_matches('"')));
        }
    }
    Ok(CrsClaim::None)
}

impl Columns {
    /// The system that a column names in the same words in all rows; why its words are no help.
    fn named_system(&self, rows: &[Row<'_>]) -> std::result::Result<Option<Crs>, String> {
        let Some(column) = self.crs_name else { return Ok(None) };
        let title = self.titles[column].trim();
        let said = |row: &Row<'_>| row.1.get(column).map_or("", |text| text.trim()).to_owned();
        let names: std::collections::BTreeSet<String> = rows.iter().map(said).filter(|name| !name.is_empty()).collect();
        let mut names = names.iter();
        let (Some(name), other) = (names.next(), names.next()) else { return Ok(None) };
        if let Some(other) = other {
            return Err(format!("the column `{title}` names `{name}` and `{other}`, so neither was taken; give --crs"));
        }
        match Crs::parse(name) {
            // Beside degrees the same tables have coordinates of the map.
            Ok(crs) if crs.is_geographic() == self.geographic => Ok(Some(crs)),
            Ok(_) => Err(format!("the column `{title}` names `{name}`, which is not what its coordinates count in")),
            Err(_) => Err(format!("the column `{title}` names `{name}`, which PROJ does not know; give --crs")),
        }
    }

    /// Takes the column whose title may be a name's, if its values tell the points apart; says so.
    fn guess_name(&mut self, rows: &[Row<'_>]) -> Option<String> {
        let likely = self.likely_name.filter(|_| self.name.is_none())?;
        let mut seen = std::collections::HashSet::new();
        let differs = rows.iter().all(|(_, fields)| {
            let name = fields.get(likely).filter(|name| !name.trim().is_empty());
            name.is_some_and(|name| seen.insert(name))
        });
        self.name = differs.then_some(likely);
        differs.then(|| format!("names are taken from the column `{}`", self.titles[likely].trim()))
    }

    /// Finds out what points and commas in the coordinates stand for; says what is not plain.
    pub(super) fn settle_marks(&mut self, path: &Path, rows: &[Row<'_>]) -> Result<Option<String>> {
        if self.geographic {
            return Ok(None); // degrees have no thousands
        }
        let columns = [Some(self.easting), Some(self.northing), self.height];
        let cells = rows.iter().flat_map(|(line, fields)| {
            let texts = columns.into_iter().flatten().filter_map(|column| fields.get(column));
            texts.map(|text| Cell { place: line.place(), text })
        });
        let (marks, note) = Marks::of(path, cells)?;
        self.marks = marks;
        Ok(note)
    }

    /// What the titles say of all points.
    pub(super) fn tell(&self, list: &mut RawList) {
        list.order = self.order;
        list.titled_degrees = self.geographic;
        let title = |column: usize| self.titles[column].as_str();
        list.units = TitledUnits::of(title(self.easting), title(self.northing), self.height.map(title));
    }

    /// Which column was taken for what, when a reader of the file could think otherwise: no title is one of a name's,
    /// or a title that was passed over has such a word in it ("Høyde-navn").
    fn unclear(&self) -> Option<String> {
        let used: Vec<usize> = [Some(self.easting), Some(self.northing), self.name, self.height]
            .into_iter()
            .chain(self.sigma)
            .chain([self.sigma_height, self.role, self.check, self.enabled, self.crs, self.crs_name])
            .flatten()
            .collect();
        let telling = |title: &str| {
            let known = [NAMES, EASTINGS, NORTHINGS, HEIGHTS];
            tidy(title).split([' ', '/']).any(|word| word.len() > 2 && known.iter().any(|names| names.contains(&word)))
        };
        let passed_over: Vec<&str> = (0..self.titles.len())
            .filter(|i| !used.contains(i))
            .map(|i| self.titles[i].as_str())
            .filter(|title| telling(title))
            .collect();
        if self.name.is_some() && passed_over.is_empty() {
            return None;
        }
        let titled = |what: &str, column: Option<usize>| column.map(|i| format!("{what} `{}`", self.titles[i].trim()));
        let taken = [
            titled("easting", Some(self.easting)),
            titled("northing", Some(self.northing)),
            titled("height", self.height),
            Some(titled("name", self.name).unwrap_or_else(|| "names: none, so the rows' numbers are used".into())),
        ];
        let taken: Vec<String> = taken.into_iter().flatten().collect();
        let passed = if passed_over.is_empty() {
            String::new()
        } else {
            format!("; not understood: `{}`", passed_over.join("`, `"))
        };
        Some(format!("columns were taken as {}{passed}", taken.join(", ")))
    }

    /// One point from the fields of a row; `number` stands in for a name.
    pub(super) fn point(&self, path: &Path, place: String, fields: &[String], number: &str) -> Result<RawPoint> {
        let text = |column: usize| fields.get(column).map(|t| t.trim()).filter(|t| !t.is_empty());
        let no_number = |text: &str, what: &str| {
            Error::format(path, &place, format!("`{text}` is no number for the {what}; correct or remove the row"))
        };
        let required = |column: usize, what: &str, own: Letter| -> Result<f64> {
            let Some(text) = text(column) else {
                return Err(Error::format(path, &place, format!("the {what} is missing; complete or remove the row")));
            };
            if self.geographic {
                self.refuse_other_letter(path, &place, (column, text), own)?;
            }
            let value = if self.geographic { angle(text) } else { self.marks.number(text) };
            value.ok_or_else(|| no_number(text, what))
        };
        let height = match self.height.and_then(text) {
            Some(text) if heights::says_none(text) => Some(f64::NAN),
            Some(text) => Some(self.marks.number(text).ok_or_else(|| no_number(text, "height"))?),
            None => None,
        };
        let optional = |column: Option<usize>, what: &str| match column.and_then(text) {
            Some(text) => text::number(text).map(Some).ok_or_else(|| no_number(text, what)),
            None => Ok(None),
        };
        let unit = |column: Option<usize>| {
            let titled = column.and_then(|c| Unit::of_accuracy(self.titles.get(c)?));
            titled.map_or(1.0, |unit| unit.metres)
        };
        let sigma = |column: Option<usize>, what: &str| match optional(column, what)? {
            Some(sigma) if sigma < 0.0 => {
                Err(Error::format(path, &place, format!("the {what} {sigma} is negative; it is a standard deviation")))
            }
            // Zero is what programs write for "unknown".
            sigma => Ok(sigma.filter(|s| *s > 0.0).map(|s| s * unit(column))),
        };
        let said = |column: Option<usize>| column.and_then(text).map(str::to_lowercase);
        let yes = |text: &str| matches!(text, "1" | "true" | "yes" | "y" | "x" | "ja" | "j" | "check");
        let check = said(self.role).is_some_and(|role| is_check(&role))
            || said(self.check).is_some_and(|text| yes(&text))
            // A marker that is switched off in Metashape is a check point.
            || said(self.enabled).is_some_and(|text| matches!(text.as_str(), "0" | "false" | "no"));
        let [east, north] = if self.geographic { ["longitude", "latitude"] } else { ["easting", "northing"] };
        let gcp = Gcp {
            name: without_apostrophe(self.name.and_then(text).unwrap_or(number)).to_string(),
            easting: required(self.easting, east, Letter::Longitude)?,
            northing: required(self.northing, north, Letter::Latitude)?,
            height,
            sigma_m: match (sigma(self.sigma[0], "accuracy")?, sigma(self.sigma[1], "accuracy")?) {
                (Some(e), Some(n)) => Some(((e * e + n * n) / 2.0).sqrt()),
                (one, other) => one.or(other),
            },
            sigma_height_m: sigma(self.sigma_height, "accuracy of the height")?,
            role: if check { GcpRole::Check } else { GcpRole::Control },
        };
        let attributes: Vec<(String, String)> =
            self.titles.iter().cloned().zip(fields.iter().map(|field| without_apostrophe(field).to_owned())).collect();
        Ok(RawPoint { pixels: seen(&attributes), ..RawPoint { attributes, ..RawPoint::bare(gcp, place) } })
    }
}

impl Columns {
    /// A letter of direction that is of the other axis, or of no certain one.
    fn refuse_other_letter(&self, path: &Path, place: &str, (column, text): (usize, &str), own: Letter) -> Result<()> {
        let title = self.titles.get(column).map_or("", |title| title.trim());
        let what = match letter(text) {
            Some(Letter::EastOrWest) => {
                format!("the O of `{text}` is east in some languages and west in others; write E or W")
            }
            Some(other) if other != own => format!(
                "`{text}` stands under `{title}`, and its letter belongs to the other coordinate; exchange the titles, \
                 or correct the letter"
            ),
            _ => return Ok(()),
        };
        Err(Error::format(path, place, what))
    }
}

/// The columns `pixel_x`, `pixel_y` and `image` of our own tables.
fn seen(attributes: &[(String, String)]) -> Vec<Seen> {
    let text = |title: &str| attributes.iter().find(|(t, _)| t == title).map(|(_, text)| text.trim());
    let value = |title: &str| text(title).and_then(text::number);
    let image = text("image").filter(|name| !name.is_empty()).map(str::to_owned);
    let at = value("pixel_x").zip(value("pixel_y")).map(|(x, y)| PixelPoint { x, y });
    at.map(|at| Seen { image, at }).into_iter().collect()
}

/// Words for a point that is kept out of the fit, as in Pix4D's and Metashape's lists.
pub(super) fn is_check(role: &str) -> bool {
    let role = role.to_lowercase().replace(['_', '-', ' '], "");
    matches!(role.as_str(), "check" | "checkpoint" | "3dcheckpoint" | "cp" | "kontrollpunkt" | "kontroll")
}
