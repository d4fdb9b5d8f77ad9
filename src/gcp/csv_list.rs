//! GCPs as a table: comma, semicolon, tab or blanks between the columns.
//!
//! With a header the columns may stand in any order, under the names that surveyors use. Without one (Pix4D, total
//! stations) they are: a name, unless every column is a number and the first is no running one; two coordinates; a
//! height; one or two accuracies. Which of the coordinates is the easting is decided later, by the CRS and the values.

use std::path::Path;

use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::text::{self, Line, SEPARATORS, Separator, split};
use crate::gcp::{Gcp, GcpRole};
use autoref_raster::cells::without_apostrophe;
use autoref_raster::coords::PixelPoint;
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

pub(super) const NAMES: &[&str] = &[
    "name",
    "id",
    "point",
    "pt",
    "gcp",
    "label",
    "navn",
    "punkt",
    "punktnavn",
    "punktnr",
    "nr",
    "no",
    "number",
    "pointid",
    "point id",
    "point name",
    "gcp id",
    "gcp name",
    "gcp label",
    "point number",
    "punktnummer",
    "nom",
    "nome",
    "nombre",
    "pktnr",
    "fid",
    "station",
    "nafn",
    "nazwa",
    "namn",
    "nimi",
    "naam",
    "matricule",
    "punto",
    "punktnamn",
    "numer",
    "numero",
    "número",
    "numéro",
    "bezeichnung",
];
/// Titles that say which is which.
const EASTINGS: &[&str] = &[
    "easting",
    "east",
    "e",
    "øst",
    "ost",
    "aust",
    "utm e",
    "x easting",
    "e m",
    "easting m",
    "rechtswert",
    "rw",
    "ostwert",
    "est",
    "este",
    "ø",
    "hoyre",
    "local easting",
    "austur",
    "wschód",
    "wschod",
    "öst",
    "öster",
    "itä",
    "oost",
    "leste",
];
const NORTHINGS: &[&str] = &[
    "northing",
    "north",
    "n",
    "nord",
    "utm n",
    "y northing",
    "n m",
    "northing m",
    "hochwert",
    "hw",
    "nordwert",
    "nor",
    "norte",
    "local northing",
    "norður",
    "północ",
    "polnoc",
    "norr",
    "pohjoinen",
    "noord",
];
/// Titles that do not: x is north in some countries.
const XS: &[&str] = &["x", "geo x", "coord x", "x m", "mapx", "x coordinate", "xcoord", "pos x"];
const YS: &[&str] = &["y", "geo y", "coord y", "y m", "mapy", "y coordinate", "ycoord", "pos y"];
const HEIGHTS: &[&str] = &[
    "height",
    "h",
    "z",
    "elevation",
    "elev",
    "alt",
    "altitude",
    "høyde",
    "hoyde",
    "height m",
    "kote",
    "z m",
    "geo z",
    "ele",
    "höhe",
    "hoehe",
    "quota",
    "cota",
    "ortho height",
    "ellipsoidal height",
    "altitude m",
    "elevation m",
    "høgde",
    "hæð",
    "wysokość",
    "wysokosc",
    "höjd",
    "korkeus",
    "hoogte",
    "altura",
    "elevación",
    "élévation",
    "hauteur",
    "altezza",
];
const LONGITUDES: &[&str] =
    &["lon", "long", "longitude", "lng", "lengdegrad", "longitude deg", "lon deg", "länge", "laenge", "longitud"];
const LATITUDES: &[&str] = &["lat", "latitude", "breddegrad", "latitude deg", "lat deg", "breite", "latitud"];
const SIGMAS: &[&str] = &[
    "sigma m",
    "sigma",
    "accuracy",
    "accuracy m",
    "std",
    "accuracy horz",
    "xy accuracy",
    "horizontal accuracy",
    "hrms",
];
const SIGMA_HEIGHTS: &[&str] =
    &["sigma height m", "sigma h", "accuracy z", "accuracy vert", "z accuracy", "vertical accuracy", "vrms"];
const ROLES: &[&str] = &["role", "type", "use", "point type"];
const CHECKS: &[&str] = &["check", "checkpoint", "check point", "is check", "kontrollpunkt"];
const ENABLED: &[&str] = &["enabled", "enable"];

/// Where the columns of a table are.
pub(super) struct Columns {
    titles: Vec<String>,
    name: Option<usize>,
    easting: usize,
    northing: usize,
    height: Option<usize>,
    sigma: Option<usize>,
    sigma_height: Option<usize>,
    role: Option<usize>,
    check: Option<usize>,
    enabled: Option<usize>,
    crs: Option<usize>,
    /// A title that stands over two columns, one of which would be taken.
    doubled: Option<String>,
    pub geographic: bool,
    pub order: ColumnOrder,
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let Some(first) = lines.iter().find(|line| !line.is_comment()) else {
        return Err(Error::format(
            path,
            "row 1",
            "the file holds no points; a header and one line for each are expected",
        ));
    };
    match header(lines) {
        Some((at, separator, columns)) => with_header(path, lines, at, separator, &columns),
        None if has_numbers(first.text) => headerless(path, lines),
        None => Err(no_header(path, first)),
    }
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
    SEPARATORS.iter().any(|&separator| split(line, separator).iter().filter(|f| text::angle(f).is_some()).count() >= 2)
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

/// "Easting [m]" and "EASTING_(m)" are "easting"; underscores and hyphens are blanks.
pub(super) fn tidy(title: &str) -> String {
    let lower = title.trim_matches(['"', '\'', ' ', '\u{feff}']).to_lowercase();
    let head = lower.split(['[', '(']).next().unwrap_or_default();
    head.replace(['_', '-', '.', ':'], " ").split_whitespace().collect::<Vec<_>>().join(" ")
}

/// In order of the names: "northing" before "n". A title such as "X/East" counts as both of its halves.
pub(super) fn find(titles: &[String], names: &[&str]) -> Option<usize> {
    names.iter().find_map(|name| titles.iter().position(|t| t == name || t.split('/').any(|half| half.trim() == *name)))
}

/// Whether a title is one of those for the horizontal coordinates.
pub(super) fn is_coordinate(title: &str) -> bool {
    let tidied = [tidy(title)];
    [EASTINGS, NORTHINGS, XS, YS, LONGITUDES, LATITUDES].iter().any(|names| find(&tidied, names).is_some())
}

/// Whether a title is that of a role, by any of its words.
pub(super) fn is_role(title: &str) -> bool {
    [ROLES, CHECKS, ENABLED].iter().any(|names| names.contains(&title))
}

/// Whether a title is one of those that a table's reader knows.
pub(super) fn is_known(title: &str) -> bool {
    let tidied = [tidy(title)];
    is_coordinate(title) || [NAMES, HEIGHTS, SIGMAS, SIGMA_HEIGHTS].iter().any(|names| find(&tidied, names).is_some())
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
    let twice = |i: &usize| tidied.iter().filter(|title| **title == tidied[*i]).count() > 1;
    let doubled = [Some(easting), Some(northing), name, height].into_iter().flatten().find(twice);
    Some(Columns {
        name,
        easting,
        northing,
        height,
        doubled: doubled.map(|i| titles[i].trim().to_owned()),
        sigma: find(SIGMAS),
        sigma_height: find(SIGMA_HEIGHTS),
        role: find(ROLES),
        check: find(CHECKS),
        enabled: find(ENABLED),
        crs: find(&["crs"]),
        geographic,
        order,
        titles,
    })
}

fn with_header(path: &Path, lines: &[Line<'_>], at: usize, separator: Separator, columns: &Columns) -> Result<RawList> {
    if let Some(title) = &columns.doubled {
        let what = format!("two columns are called `{title}`; remove or rename the one that is not meant");
        return Err(Error::format(path, lines[at].place(), what));
    }
    let mut points = Vec::new();
    for line in lines[at + 1..].iter().filter(|line| !line.is_comment()) {
        points.push(columns.point(path, line.place(), &split(line.text, separator), &line.row.to_string())?);
    }
    let mut stated = coordinate_system_comment(path, &lines[..at])?;
    if let (CrsClaim::None, Some(column), Some(point)) = (&stated, columns.crs, points.first())
        && let Some((_, definition)) = point.attributes.get(column).filter(|(_, text)| !text.trim().is_empty())
    {
        stated = CrsClaim::read(path, point.place.clone(), definition);
    }
    let crs = match stated {
        CrsClaim::None if columns.geographic => CrsClaim::Known(Crs::from_epsg(4326)?),
        stated => stated,
    };
    let mut list = RawList::new(points, crs);
    list.order = columns.order;
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
    /// Which column was taken for what, when a reader of the file could think otherwise: no title is one of a name's,
    /// or a title that was passed over has such a word in it ("Høyde-navn").
    fn unclear(&self) -> Option<String> {
        let used: Vec<usize> = [Some(self.easting), Some(self.northing), self.name, self.height, self.sigma]
            .into_iter()
            .chain([self.sigma_height, self.role, self.check, self.enabled, self.crs])
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
        let read = |column: usize, what: &str| -> Result<Option<f64>> {
            let Some(text) = text(column) else { return Ok(None) };
            let value = if self.geographic { text::angle(text) } else { text::number(text) };
            value.map(Some).ok_or_else(|| {
                Error::format(path, &place, format!("`{text}` is no number for the {what}; correct or remove the row"))
            })
        };
        let required = |column: usize, what: &str| -> Result<f64> {
            read(column, what)?.ok_or_else(|| {
                Error::format(path, &place, format!("the {what} is missing; complete or remove the row"))
            })
        };
        let optional = |column: Option<usize>, what: &str| column.map_or(Ok(None), |c| read(c, what));
        let sigma = |column: Option<usize>, what: &str| match optional(column, what)? {
            Some(sigma) if sigma < 0.0 => {
                Err(Error::format(path, &place, format!("the {what} {sigma} is negative; it is a standard deviation")))
            }
            // Zero is what programs write for "unknown".
            sigma => Ok(sigma.filter(|s| *s > 0.0)),
        };
        let said = |column: Option<usize>| column.and_then(text).map(str::to_lowercase);
        let yes = |text: &str| matches!(text, "1" | "true" | "yes" | "y" | "x" | "ja" | "j" | "check");
        let check = said(self.role).is_some_and(|role| is_check(&role))
            || said(self.check).is_some_and(|text| yes(&text))
            // A marker that is switched off in Metashape is a check point.
            || said(self.enabled).is_some_and(|text| matches!(text.as_str(), "0" | "false" | "no"));
        let gcp = Gcp {
            name: without_apostrophe(self.name.and_then(text).unwrap_or(number)).to_string(),
            easting: required(self.easting, if self.geographic { "longitude" } else { "easting" })?,
            northing: required(self.northing, if self.geographic { "latitude" } else { "northing" })?,
            height: optional(self.height, "height")?,
            sigma_m: sigma(self.sigma, "accuracy")?,
            sigma_height_m: sigma(self.sigma_height, "accuracy of the height")?,
            role: if check { GcpRole::Check } else { GcpRole::Control },
        };
        let attributes: Vec<(String, String)> =
            self.titles.iter().cloned().zip(fields.iter().map(|field| without_apostrophe(field).to_owned())).collect();
        Ok(RawPoint { pixels: seen(&attributes), ..RawPoint { attributes, ..RawPoint::bare(gcp, place) } })
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

/// Columns of numbers, with or without a name in front or behind.
pub(super) fn headerless(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
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
    let columns = shape.columns(numbered);
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
        let named = table.iter().all(|(_, fields)| fields.len() > behind);
        match self.numbers {
            0..=2 => false,
            3 => running && (!all_whole || small) && !named,
            _ => running,
        }
    }

    fn columns(&self, numbered: bool) -> Columns {
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
        Columns {
            doubled: None,
            titles: Vec::new(),
            name,
            easting: first,
            northing: first + 1,
            height: extra(2),
            sigma: extra(3),
            sigma_height: extra(4),
            role,
            check: None,
            enabled: None,
            crs: None,
            geographic: false,
            order: ColumnOrder::Assumed,
        }
    }
}
