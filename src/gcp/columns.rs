//! Where the columns of a table are, and a point from the cells under them.

use std::path::Path;

use crate::gcp::angle::{Letter, angle, letter};
use crate::gcp::marks::{Cell, Marks};
use crate::gcp::packed::{self, Packed};
use crate::gcp::raw::{ColumnOrder, RawList, RawPoint, Seen};
use crate::gcp::roles::{self, Said};
use crate::gcp::text::{self, Row};
use crate::gcp::titles::{
    Axis, CHECKS, EASTINGS, ENABLED, HEIGHTS, LATITUDES, LETTER_PAIRS, LONGITUDES, NAMES, NORTHINGS, ROLES,
    SHORT_HEIGHTS, SHORT_SIGMA_HEIGHTS, SIGMA_EASTS, SIGMA_HEIGHTS, SIGMA_NORTHS, SIGMAS, XS, YS, directed, find,
    find_height, find_likely_name, is_ellipsoidal_height, is_level_height, may_name, tidy,
};
use crate::gcp::units::{TitledUnits, Unit};
use crate::gcp::{Gcp, GcpRole, heights};
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
    /// How degrees, minutes and seconds are one number, where a title says that they are.
    pub packed: Option<Packed>,
    pub order: ColumnOrder,
    /// Of easting, northing and height.
    pub marks: Marks,
}

/// Which columns are the coordinates.
#[derive(Clone, Copy, Debug)]
struct Plan {
    easting: usize,
    northing: usize,
    geographic: bool,
    order: ColumnOrder,
}

impl Plan {
    /// Longitude and latitude.
    fn of_degrees(tidied: &[String]) -> Option<Plan> {
        let (easting, northing) = pair(tidied, LONGITUDES, LATITUDES)?;
        Some(Plan { easting, northing, geographic: true, order: ColumnOrder::Stated })
    }

    /// Easting and northing in words.
    fn of_words(tidied: &[String]) -> Option<Plan> {
        let (easting, northing) = pair(tidied, EASTINGS, NORTHINGS)?;
        Some(Plan { easting, northing, geographic: false, order: ColumnOrder::Stated })
    }

    /// X and Y, and letters of other languages.
    fn of_letters(titles: &[String], tidied: &[String]) -> Option<Plan> {
        let (easting, northing, order) = if let Some((x, y)) = pair(tidied, XS, YS) {
            // "Y (E)" and "X (N)" say more than their letters do.
            match directed(titles) {
                Some((said, [Axis::East, _])) if said == (x, y) || said == (y, x) => {
                    (said.0, said.1, ColumnOrder::Stated)
                }
                _ => (x, y, ColumnOrder::Assumed),
            }
        } else if let Some((e, n)) = LETTER_PAIRS.iter().find_map(|[e, n]| pair(tidied, &[e], &[n])) {
            (e, n, ColumnOrder::Stated)
        } else {
            let ((e, n), axes) = directed(titles)?;
            (e, n, if axes[0] == Axis::East { ColumnOrder::Stated } else { ColumnOrder::Assumed })
        };
        Some(Plan { easting, northing, geographic: false, order })
    }
}

fn pair(tidied: &[String], a: &[&str], b: &[&str]) -> Option<(usize, usize)> {
    find(tidied, a).zip(find(tidied, b)).filter(|(a, b)| a != b)
}

/// The columns that titles name, when both coordinates are among them.
pub(super) fn columns(titles: Vec<String>) -> Option<Columns> {
    let tidied: Vec<String> = titles.iter().map(|t| tidy(t)).collect();
    let plan =
        Plan::of_words(&tidied).or_else(|| Plan::of_degrees(&tidied)).or_else(|| Plan::of_letters(&titles, &tidied))?;
    Some(columns_of(titles, &tidied, plan))
}

fn columns_of(titles: Vec<String>, tidied: &[String], plan: Plan) -> Columns {
    let Plan { easting, northing, geographic, order } = plan;
    let find = |names: &[&str]| find(tidied, names);
    let is_free = |i: &usize| *i != easting && *i != northing;
    // Beside titles that are words, a letter is something else.
    let letters = || find(SHORT_HEIGHTS).filter(|_| tidied[easting].len() == 1 && tidied[northing].len() == 1);
    // Tables with two sets of coordinates have a height beside each.
    let beside =
        || Some(easting.max(northing) + 1).filter(|&at| tidied.get(at).is_some_and(|title| is_level_height(title)));
    // The height beside coordinates of a map is theirs.
    let has_map = || Plan::of_words(tidied).or_else(|| Plan::of_letters(&titles, tidied)).is_some();
    let above_ellipsoid = || {
        Some(easting.max(northing) + 1)
            .filter(|&at| geographic && tidied.get(at).is_some_and(|title| is_ellipsoidal_height(title)) && has_map())
    };
    let height = beside().or_else(above_ellipsoid).or_else(|| find_height(tidied)).or_else(letters).filter(is_free);
    let name = find(NAMES).filter(|i| is_free(i) && Some(*i) != height);
    // MicMac calls the name N, before X, Y and Z.
    let micmac = || tidied.iter().position(|title| title == "n").filter(|_| order == ColumnOrder::Assumed);
    // Turkish nokta no; elsewhere a level.
    let turkish = || (tidied[0] == "nn" && height.is_some_and(|at| at != 0)).then_some(0).filter(is_free);
    let name = name.or_else(micmac).or_else(turkish);
    // One of them alone may be a serial number or a signal's height; MicMac's Ix and Iy without Iz may be pixels.
    let both = [find(SIGMA_EASTS), find(SIGMA_NORTHS)];
    let is_pixel = |at: &Option<usize>| at.is_some_and(|at| tidied[at] == "ix") && find(&["iz"]).is_none();
    let both = if both.contains(&None) || is_pixel(&both[0]) { [None; 2] } else { both };
    let short = || find(SHORT_SIGMA_HEIGHTS).filter(|_| both[0].is_some());
    let twice = |i: &usize| tidied.iter().filter(|title| **title == tidied[*i]).count() > 1;
    let doubled = [Some(easting), Some(northing), name, height].into_iter().flatten().find(twice);
    Columns {
        name,
        likely_name: find_likely_name(tidied).filter(is_free),
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
        packed: [easting, northing].into_iter().filter(|_| geographic).find_map(|at| Packed::of(&titles[at])),
        order,
        titles,
        marks: Marks::default(),
    }
}

impl Columns {
    /// Without titles, and with the first two columns for the coordinates.
    pub(super) fn untitled() -> Columns {
        Columns {
            doubled: None,
            titles: Vec::new(),
            name: None,
            likely_name: None,
            easting: 0,
            northing: 1,
            height: None,
            sigma: [None; 2],
            sigma_height: None,
            role: None,
            check: None,
            enabled: None,
            crs: None,
            crs_name: None,
            geographic: false,
            packed: None,
            order: ColumnOrder::Untitled,
            marks: Marks::default(),
        }
    }

    /// The same with the other coordinates of the table: those of a map beside degrees, or degrees beside those.
    pub(super) fn other(&self) -> Option<Columns> {
        let tidied: Vec<String> = self.titles.iter().map(|t| tidy(t)).collect();
        let plan = match self.geographic {
            true => Plan::of_letters(&self.titles, &tidied),
            false => Plan::of_degrees(&tidied),
        };
        let taken = [self.easting, self.northing];
        let plan = plan.filter(|plan| !taken.contains(&plan.easting) && !taken.contains(&plan.northing))?;
        Some(columns_of(self.titles.clone(), &tidied, plan))
    }

    /// The system that a column names in the same words in all rows; why its words are no help.
    pub(super) fn named_system(&self, rows: &[Row<'_>]) -> std::result::Result<Option<Crs>, String> {
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

    /// Where no title is one of a name's: the column whose title may be one, else the first column that may hold names,
    /// if its values tell the points apart; says so.
    pub(super) fn guess_name(&mut self, rows: &[Row<'_>]) -> Option<String> {
        if self.name.is_some() {
            return None;
        }
        let likely = self.likely_name.filter(|&column| tells_apart(column, rows));
        let taken = self.used();
        let mut left = (0..self.titles.len()).filter(|column| !taken.contains(column));
        let is_free = |column: &usize| may_name(&self.titles[*column]) && tells_apart(*column, rows);
        self.name =
            likely.or_else(|| left.find(|column| is_free(column) && (*column == 0 || !measures(*column, rows))));
        let title = self.titles[self.name?].trim();
        Some(match title {
            "" => format!("names are taken from column {}, which has no title", self.name? + 1),
            title => format!("names are taken from the column `{title}`"),
        })
    }

    /// Without titles: where the first column says the same of many rows, and one behind it, before the coordinates,
    /// tells them apart, that one has the names; says so. `kept` are the places of the columns in the file.
    pub(super) fn name_among_codes(&mut self, rows: &[Row<'_>], kept: &[usize]) -> Option<String> {
        let name = self.name.filter(|name| *name < self.easting)?;
        let said: std::collections::HashSet<&str> =
            rows.iter().filter_map(|(_, cells)| cells.get(name)).map(|cell| cell.trim()).collect();
        if rows.len() < 2 || said.len() * 2 > rows.len() {
            return None;
        }
        let other = (name + 1..self.easting).rev().find(|column| tells_apart(*column, rows))?;
        self.name = Some(other);
        Some(format!("names are taken from column {}: those of column {} repeat", kept[other] + 1, kept[name] + 1))
    }

    /// The columns that say something of a point.
    fn used(&self) -> Vec<usize> {
        [Some(self.easting), Some(self.northing), self.name, self.height]
            .into_iter()
            .chain(self.sigma)
            .chain([self.sigma_height, self.role, self.check, self.enabled, self.crs, self.crs_name])
            .flatten()
            .collect()
    }

    /// Columns of which a point holds all that they say.
    fn carried(&self) -> impl Iterator<Item = usize> {
        [Some(self.easting), Some(self.northing), self.name, self.height, self.role, self.check, self.enabled, self.crs]
            .into_iter()
            .chain(self.sigma)
            .chain([self.sigma_height])
            .flatten()
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

    /// A coordinate whose mark may stand between thousands, where nothing shows it.
    pub(super) fn open_mark(&self, rows: &[Row<'_>]) -> Option<String> {
        let (line, cells) = rows.first().filter(|_| self.marks.are_guessed())?;
        Some(format!("`{}` ({})", cells.get(self.easting)?, line.place()))
    }

    /// The number in a cell of a coordinate.
    pub(super) fn number(&self, cell: &str) -> Option<f64> {
        match self.packed {
            Some(packed) => packed.angle(cell),
            None if self.geographic => angle(cell),
            None => self.marks.number(cell),
        }
    }

    /// How angles were taken, where a title or the values let think of minutes and seconds in one number.
    pub(super) fn told_of_angles(&self, rows: &[Row<'_>]) -> Option<String> {
        let [longitude, latitude] =
            [self.easting, self.northing].map(|at| self.titles.get(at).map_or("", |t| t.trim()));
        if let Some(packed) = self.packed {
            return Some(format!(
                "`{longitude}` and `{latitude}` were taken as degrees, minutes and seconds in one number, {}",
                packed.written()
            ));
        }
        let columns = [self.easting, self.northing];
        let texts = rows.iter().flat_map(|(_, cells)| columns.into_iter().filter_map(|at| cells.get(at)));
        (self.geographic && packed::could_be_packed(texts.map(String::as_str))).then(|| {
            format!(
                "`{longitude}` and `{latitude}` were taken as decimal degrees; if they are degrees, minutes and seconds in \
                 one number, say so in the title: `{longitude} (DDD.MMSS)`"
            )
        })
    }

    /// What the titles say of all points.
    pub(super) fn tell(&self, list: &mut RawList) {
        list.read = self.carried().map(|column| self.titles[column].clone()).collect();
        list.order = self.order;
        list.titled_degrees = self.geographic;
        let title = |column: usize| self.titles[column].as_str();
        list.units = TitledUnits::of(title(self.easting), title(self.northing), self.height.map(title));
    }

    /// Which column was taken for what, when a reader of the file could think otherwise: no title is one of a name's,
    /// or a title that was passed over has such a word in it ("Høyde-navn").
    pub(super) fn unclear(&self) -> Option<String> {
        let mut used = self.used();
        used.extend(self.other().into_iter().flat_map(|other| [other.easting, other.northing]));
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
            Some(titled("name", self.name).unwrap_or_else(|| "names: none, so the points are numbered from 1".into())),
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
        let row = TitledRow { columns: self, path, place: &place, fields };
        let [east, north] = if self.geographic { ["longitude", "latitude"] } else { ["easting", "northing"] };
        let height = match self.height.and_then(|c| row.text(c)) {
            Some(text) if heights::says_none(text) => Some(f64::NAN),
            Some(text) => Some(self.marks.number(text).ok_or_else(|| row.no_number(text, "height"))?),
            None => None,
        };
        let gcp = Gcp {
            name: without_apostrophe(self.name.and_then(|c| row.text(c)).unwrap_or(number)).to_string(),
            easting: row.coordinate(self.easting, east, Letter::Longitude)?,
            northing: row.coordinate(self.northing, north, Letter::Latitude)?,
            height,
            sigma_m: match (row.sigma_m(self.sigma[0], "accuracy")?, row.sigma_m(self.sigma[1], "accuracy")?) {
                (Some(e), Some(n)) => Some(((e * e + n * n) / 2.0).sqrt()),
                (one, other) => one.or(other),
            },
            sigma_height_m: row.sigma_m(self.sigma_height, "accuracy of the height")?,
            role: row.role(),
        };
        let attributes: Vec<(String, String)> =
            self.titles.iter().cloned().zip(fields.iter().map(|field| without_apostrophe(field).to_owned())).collect();
        Ok(RawPoint { pixels: seen(&attributes), ..RawPoint { attributes, ..RawPoint::bare(gcp, place) } })
    }
}

/// One row under its columns.
struct TitledRow<'a> {
    columns: &'a Columns,
    path: &'a Path,
    place: &'a str,
    fields: &'a [String],
}

impl<'a> TitledRow<'a> {
    /// What stands in a column; `None` where nothing does.
    fn text(&self, column: usize) -> Option<&'a str> {
        self.fields.get(column).map(|t| t.trim()).filter(|t| !t.is_empty())
    }

    fn wrong(&self, what: String) -> Error {
        Error::format(self.path, self.place, what)
    }

    fn no_number(&self, text: &str, what: &str) -> Error {
        let remedy = match angle(text) {
            Some(_) if self.columns.packed.is_some() => {
                "its title says degrees, minutes and seconds in one number, and minutes and seconds end at 59: \
                 correct the value or the title"
            }
            Some(_) if what != "height" => "it is an angle: call the columns `lon` and `lat`",
            _ if text::number(text.trim_end_matches(char::is_alphabetic)).is_some() => {
                "write the unit into the title, as in `Height (m)`"
            }
            _ => "correct or remove the row",
        };
        self.wrong(format!("`{text}` is no number for the {what}; {remedy}"))
    }

    fn missing(&self, what: &str) -> Error {
        let titles = self.columns.titles.len();
        let mut filled = self.fields.iter().filter(|field| !field.is_empty());
        match (filled.next(), filled.next()) {
            (Some(one), None) if titles > 1 => {
                let shown: String = one.chars().take(60).collect();
                self.wrong(format!(
                    "`{shown}` is one cell under {titles} titles: other marks between the columns than in the header, or a \
                     line end within a cell, which needs quotes; correct or remove the row"
                ))
            }
            _ => self.wrong(format!("the {what} is missing; complete or remove the row")),
        }
    }

    fn coordinate(&self, column: usize, what: &str, own: Letter) -> Result<f64> {
        // What counts larger steps is no coordinate, and refused as such.
        const ROUNDED: std::ops::RangeInclusive<f64> = 10.0..=1e6;
        let text = self.text(column).ok_or_else(|| self.missing(what))?;
        let geographic = self.columns.geographic;
        if geographic {
            self.columns.refuse_other_letter(self.path, self.place, (column, text), own)?;
        }
        let value = self.columns.number(text).ok_or_else(|| self.no_number(text, what))?;
        match rounded_to(text).filter(|unit| ROUNDED.contains(unit) && !geographic) {
            Some(unit) => Err(self.wrong(format!(
                "`{text}` is rounded to {unit}, as spreadsheets show large numbers; give the {what} its decimals (format \
                 the cells as numbers and save again)"
            ))),
            // A letter in the cell says it for itself.
            None if value > 0.0 && letter(text).is_none() && self.columns.is_backwards(column) => Ok(-value),
            None => Ok(value),
        }
    }

    /// A standard deviation; zero is what programs write for "unknown".
    fn sigma_m(&self, column: Option<usize>, what: &str) -> Result<Option<f64>> {
        let Some((column, text)) = column.and_then(|c| Some((c, self.text(c)?))) else { return Ok(None) };
        let sigma = text::number(text).ok_or_else(|| self.no_number(text, what))?;
        if sigma < 0.0 {
            return Err(self.wrong(format!("the {what} {sigma} is negative; it is a standard deviation")));
        }
        let unit = self.columns.titles.get(column).and_then(|title| Unit::of_accuracy(title));
        let unit_m = unit.map_or(1.0, |unit| unit.metres);
        Ok((sigma > 0.0).then(|| sigma * unit_m / self.columns.sigmas(column)))
    }

    fn role(&self) -> GcpRole {
        let says = |column: Option<usize>, of: fn(&str) -> Said| {
            column.and_then(|c| self.text(c)).is_some_and(|text| of(text) == Said::Role(GcpRole::Check))
        };
        let check = says(self.columns.role, roles::of_role)
            || says(self.columns.check, roles::of_check)
            || says(self.columns.enabled, roles::of_enabled);
        if check { GcpRole::Check } else { GcpRole::Control }
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

/// What the last digit of a number with an exponent counts: 1000 of `5.98E+05`.
fn rounded_to(text: &str) -> Option<f64> {
    let (digits, power) = text.trim().trim_matches('"').split_once(['e', 'E'])?;
    let decimals = digits.rsplit_once(['.', ',']).map_or(0, |(_, decimals)| decimals.len());
    Some(10f64.powi(power.parse::<i32>().ok()?.saturating_sub(i32::try_from(decimals).ok()?)))
}

/// Whether every row has another value in this column; rows that are alike in all their cells are one.
fn tells_apart(column: usize, rows: &[Row<'_>]) -> bool {
    let mut seen = std::collections::HashMap::new();
    !rows.is_empty()
        && rows.iter().all(|(_, cells)| {
            let name = cells.get(column).map(|name| name.trim()).filter(|name| !name.is_empty());
            name.is_some_and(|name| seen.insert(name, cells).is_none_or(|before| before == cells))
        })
}

/// Whether a column holds numbers only, as those of names do that stand first or under a title of theirs.
fn measures(column: usize, rows: &[Row<'_>]) -> bool {
    rows.iter().all(|(_, cells)| cells.get(column).is_some_and(|cell| text::number(cell).is_some()))
}

/// The columns `pixel_x`, `pixel_y` and `image` of our own tables.
fn seen(attributes: &[(String, String)]) -> Vec<Seen> {
    let text = |title: &str| attributes.iter().find(|(t, _)| t == title).map(|(_, text)| text.trim());
    let value = |title: &str| text(title).and_then(text::number);
    let image = text("image").filter(|name| !name.is_empty()).map(str::to_owned);
    let at = value("pixel_x").zip(value("pixel_y")).map(|(x, y)| PixelPoint { x, y });
    at.map(|at| Seen { image, at }).into_iter().collect()
}
