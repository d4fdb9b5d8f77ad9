//! How the rows of tables are cut, and what their columns are called.

pub(super) fn separator(line: &str) -> Option<char> {
    [';', '\t', ','].into_iter().find(|c| line.contains(*c))
}

/// Cuts a row at its separator, else at blanks; quotes of either kind hold a field together, two are one of it.
pub(super) fn fields(line: &str, cut: Option<char>) -> Vec<String> {
    let mut all = Vec::new();
    let mut field = String::new();
    let mut quote = None;
    let mut any = false;
    let mut letters = line.chars().peekable();
    while let Some(c) = letters.next() {
        match (quote, c) {
            (Some(q), c) if c == q && letters.peek() == Some(&q) => field.extend(letters.next()),
            (Some(q), c) if c == q => quote = None,
            (Some(_), c) => field.push(c),
            (None, '"' | '\'') if field.trim().is_empty() => (quote, any) = (Some(c), true),
            (None, c) if cut.map_or(c.is_whitespace(), |s| c == s) => {
                if cut.is_some() || any || !field.is_empty() {
                    all.push(std::mem::take(&mut field).trim().to_string());
                }
                any = false;
            }
            (None, c) => field.push(c),
        }
    }
    if cut.is_some() || any || !field.trim().is_empty() {
        all.push(field.trim().to_string());
    }
    all
}

/// A row with more cells than columns was cut where it should not be; what is wrong as words.
pub(super) fn no_more_cells(fields: &[String], columns: usize, cut: Option<char>) -> Result<(), String> {
    let cells = fields.iter().rposition(|field| !field.is_empty()).map_or(0, |at| at + 1);
    if cells <= columns {
        return Ok(());
    }
    let cause = match cut {
        Some(',') => "numbers with decimal commas: quote them, or put semicolons between the columns",
        Some(_) => "the separator within a cell: quote such cells",
        None => "blanks within a cell: quote such cells",
    };
    Err(format!("{cells} cells in {columns} columns, as from {cause}"))
}

/// A title that two columns have.
pub(super) fn named_twice(heads: &[String]) -> Option<&String> {
    heads.iter().enumerate().find(|(at, head)| !head.is_empty() && heads[..*at].contains(head)).map(|(_, head)| head)
}

/// Titles of the column that names the frames, as [`title`] has them.
pub(super) const NAMES: [&str; 18] = [
    "name",
    "filename",
    "file",
    "image",
    "images",
    "frame",
    "frames",
    "photo",
    "photos",
    "label",
    "id",
    "img",
    "imagename",
    "photoname",
    "framename",
    "photoid",
    "imageid",
    "sourcefile",
];
/// Of these the ones that may stand beside the name of a point.
pub(super) const IMAGES: [&str; 10] =
    ["image", "images", "frame", "frames", "photo", "photos", "img", "imagename", "photoname", "filename"];
const LONGITUDES: [&str; 5] = ["lon", "long", "longitude", "x/longitude", "gpslongitude"];
const LATITUDES: [&str; 4] = ["lat", "latitude", "y/latitude", "gpslatitude"];
pub(super) const COLUMNS: [(&str, &[&str]); 12] = [
    (
        "x",
        &[
            "x",
            "e",
            "easting",
            "east",
            "lon",
            "long",
            "longitude",
            "x/longitude",
            "x/easting",
            "x/east",
            "xm",
            "øst",
            "ost",
            "gpslongitude",
        ],
    ),
    (
        "y",
        &[
            "y",
            "n",
            "northing",
            "north",
            "lat",
            "latitude",
            "y/latitude",
            "y/northing",
            "y/north",
            "ym",
            "nord",
            "gpslatitude",
        ],
    ),
    (
        "z",
        &[
            "z",
            "h",
            "height",
            "alt",
            "altitude",
            "elevation",
            "z/altitude",
            "z/height",
            "zm",
            "høyde",
            "hoyde",
            "hoehe",
            "höhe",
            "elev",
            "heightm",
            "altitudem",
            "ellipsoidalheight",
            "ellipsoidheight",
            "ellheight",
            "heightellipsoidal",
            "orthometricheight",
            "absolutealtitude",
            "gpsaltitude",
            "gpsheight",
        ],
    ),
    ("yaw", &["yaw", "heading", "azimuth", "azimut", "direction"]),
    ("pitch", &["pitch", "elevationangle"]),
    ("roll", &["roll"]),
    ("omega", &["omega"]),
    ("phi", &["phi"]),
    ("kappa", &["kappa"]),
    ("line", &["line", "strip", "flightline", "run"]),
    ("sigma_m", &["sigmam", "sigma"]),
    ("sigma_height_m", &["sigmaheightm", "sigmah", "sigmaheight"]),
];

pub(super) const PIXEL_X: [&str; 7] = ["px", "u", "imx", "pixelx", "imagex", "col", "column"];
pub(super) const PIXEL_Y: [&str; 7] = ["py", "v", "imy", "pixely", "imagey", "row", "line"];

/// The columns of angles in [`COLUMNS`], from yaw to kappa.
pub(super) const ANGLES: std::ops::Range<usize> = 3..9;

/// A title without case, blanks, lines and unit: `Photo Name` is `photoname`, `Yaw (deg)` is `yaw`. Radians of what is
/// no angle stay, so that nobody takes them for degrees.
fn title(text: &str) -> String {
    title_and_unit(text).0
}

/// A title as [`title`] has it, and the unit that it states: in brackets, or of an angle behind its name.
pub(super) fn title_and_unit(text: &str) -> (String, String) {
    let lower = text.to_lowercase();
    let tidy = |words: &str| words.chars().filter(|c| !matches!(c, ' ' | '_' | '-' | '#')).collect::<String>();
    let is_angle = |bare: &str| COLUMNS[ANGLES].iter().any(|(_, titles)| titles.contains(&bare));
    if let Some((bare, unit)) = lower.split_once(['(', '[']) {
        let (bare, unit) = (tidy(bare), unit.trim_end_matches([')', ']', ' ']).trim());
        if is_angle(&bare) || !unit.contains("rad") {
            return (bare, unit.to_string());
        }
    }
    let whole = tidy(&lower);
    let angles = COLUMNS[ANGLES].iter().flat_map(|(_, titles)| *titles);
    let longest = angles.filter(|name| whole.starts_with(**name)).max_by_key(|name| name.len());
    match longest.and_then(|name| Some((name, whole.strip_prefix(name)?))).filter(|(_, unit)| is_unit(unit)) {
        Some((name, unit)) => ((*name).to_string(), unit.to_string()),
        None => (whole, String::new()),
    }
}

const DEGREES: [&str; 6] = ["", "deg", "degs", "degree", "degrees", "decimaldegrees"];
const GON: [&str; 2] = ["gon", "gons"];
const RADIANS: [&str; 4] = ["rad", "rads", "radian", "radians"];
/// `grad` is a gon to some, a degree to others.
const GRAD: [&str; 5] = ["grad", "grads", "grade", "grader", "gradians"];

fn is_unit(unit: &str) -> bool {
    [&DEGREES[..], &GON, &RADIANS, &GRAD].iter().any(|units| units.contains(&unit))
}

/// Degrees that one of a column's angles counts, by its title; what is wrong with the unit as words.
pub(super) fn degrees_of(field: &str) -> Result<f64, String> {
    let (_, unit) = title_and_unit(field);
    let bare: String = unit.chars().filter(|c| c.is_alphabetic()).collect();
    match bare.as_str() {
        u if RADIANS.contains(&u) => Ok(1f64.to_degrees()),
        u if GON.contains(&u) => Ok(0.9),
        u if GRAD.contains(&u) => Err(format!(
            "`{}`: `{unit}` is a gon (0.9 degrees) to some, a degree to others; write gon or deg",
            field.trim()
        )),
        u if !DEGREES.contains(&u) && ["rad", "gon", "mil", "min", "sec"].iter().any(|word| u.contains(word)) => {
            Err(format!("`{}`: angles in `{unit}` are not read; give deg, gon or rad", field.trim()))
        }
        _ => Ok(1.0),
    }
}

pub(super) fn titles_of(line: &str) -> Vec<String> {
    fields(line, separator(line)).iter().map(|field| title(field)).collect()
}

/// Titles of columns.
pub(super) struct Heading {
    pub(super) heads: Vec<String>,
    /// As the line has them.
    pub(super) fields: Vec<String>,
}

impl Heading {
    pub(super) fn of(line: &str) -> Self {
        Heading { heads: titles_of(line), fields: fields(line, separator(line)) }
    }

    /// Whether there are an x and a y among them.
    pub(super) fn names_places(&self) -> bool {
        (0..2).all(|i| column_at(&self.heads, i).is_some())
    }
}

/// Whether a comment is a heading of angles, without which their numbers would be taken for others.
pub(super) fn names_angles(comment: &str) -> bool {
    let heads = titles_of(comment);
    let all = |titles: [&str; 3]| titles.iter().all(|title| heads.iter().any(|head| head == title));
    all(["yaw", "pitch", "roll"]) || all(["omega", "phi", "kappa"])
}

/// Whether titles name longitude and latitude, and nothing that is a place on a map.
pub(super) fn is_geographic(heads: &[String]) -> bool {
    let any = |titles: &[&str]| heads.iter().any(|h| titles.contains(&h.as_str()));
    any(&LONGITUDES) && any(&LATITUDES) && !any(&["x", "e", "easting"])
}

pub(super) fn column_at(heads: &[String], i: usize) -> Option<usize> {
    heads.iter().position(|h| COLUMNS[i].1.contains(&h.as_str()))
}
