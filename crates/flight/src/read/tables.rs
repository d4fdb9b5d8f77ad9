//! Tables of cameras as text: rough positions with angles.

use std::path::Path;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::model::FARTHEST;
use super::titles::{
    ANGLES, COLUMNS, Heading, NAMES, degrees_of, fields, is_geographic, named_twice, names_angles, no_more_cells,
    separator,
};
use crate::error::{Error, Result, read_text};
use crate::pose::{Pose, YawPitchRoll};

/// What yaw, pitch and roll of a table are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Angles {
    /// The view's: a pitch of 0 is level, -90 straight down ([`YawPitchRoll`]); those of a gimbal.
    #[default]
    View,
    /// The aircraft's that carries the camera: a pitch of 0 looks straight down ([`Pose::under_aircraft`]).
    Aircraft,
}

/// A row of a camera table. Angles are degrees; what the table lacks is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CameraRow {
    pub name: String,
    /// As the table has them: easting, northing, height, or longitude, latitude, height.
    pub xyz: [f64; 3],
    /// The titles say longitude and latitude; directions count from true north.
    pub geographic: bool,
    pub yaw_deg: Option<f64>,
    pub pitch_deg: Option<f64>,
    pub roll_deg: Option<f64>,
    pub omega_phi_kappa_deg: Option<[f64; 3]>,
    pub line: Option<String>,
    /// 1σ of the position in plan and of its height, metres.
    pub sigma_m: [Option<f64>; 2],
    /// The angles come from those of an aircraft of which some were not stated.
    pub taken_level: bool,
}

impl CameraRow {
    /// The row with the view's angles; what is not stated of an aircraft's pitch and roll is level flight.
    #[must_use]
    pub fn with_angles_of_view(mut self, angles: Angles) -> Self {
        let Some(yaw_deg) = self.yaw_deg.filter(|_| angles == Angles::Aircraft) else { return self };
        let stated =
            YawPitchRoll { yaw_deg, pitch_deg: self.pitch_deg.unwrap_or(0.0), roll_deg: self.roll_deg.unwrap_or(0.0) };
        let view = Pose::under_aircraft(Vector3::zeros(), stated).yaw_pitch_roll();
        self.yaw_deg = Some(view.yaw_deg);
        // Straight down the view's yaw says nothing without its roll.
        self.taken_level = self.pitch_deg.is_none() || self.roll_deg.is_none();
        (self.pitch_deg, self.roll_deg) = (Some(view.pitch_deg), Some(view.roll_deg));
        self
    }

    /// Whether the row states the direction whole, and not only a part of it.
    pub fn is_directed(&self) -> bool {
        let angles = [self.yaw_deg, self.pitch_deg, self.roll_deg];
        self.omega_phi_kappa_deg.is_some() || !self.taken_level && angles.iter().all(Option::is_some)
    }

    /// The pose that the row states; `None` when it has no direction. `pitch_deg` stands in for a pitch that is not
    /// there.
    pub fn pose(&self, pitch_deg: Option<f64>) -> Option<Pose> {
        let centre = Vector3::from(self.xyz);
        if let Some(opk) = self.omega_phi_kappa_deg {
            return Some(Pose::from_omega_phi_kappa(centre, opk));
        }
        let angles = YawPitchRoll {
            yaw_deg: self.yaw_deg?,
            pitch_deg: self.pitch_deg.or(pitch_deg)?,
            roll_deg: self.roll_deg.unwrap_or(0.0),
        };
        Some(Pose::looking(centre, angles))
    }
}

/// Reads a camera table: a heading row that names the columns, in any order (docs/flight.md lists the names; angles are
/// degrees unless their titles say gon or rad), or without one rows of `name x y z` with `yaw`, with `omega phi kappa`,
/// or alone; or OpenDroneMap's image geolocation file in longitude and latitude.
///
/// # Errors
/// When a row has no name, a coordinate is missing or no number, or angles are in a unit that is not read.
pub fn cameras(path: &Path) -> Result<Vec<CameraRow>> {
    let text = read_text(path)?;
    let lines = text.trim_start_matches('\u{feff}').lines().enumerate().map(|(i, l)| (i + 1, l.trim()));
    let (comments, mut lines): (Vec<_>, Vec<_>) =
        lines.filter(|(_, l)| !l.is_empty()).partition(|(_, l)| l.starts_with('#'));
    let Some((_, first)) = lines.first().copied() else {
        return Err(Error::format(path, "the table", "is empty"));
    };
    // A heading may be a comment, as Metashape writes it.
    let of_comment = |(_, l): &(usize, &str)| Heading::of(l.trim_start_matches('#').trim_start());
    let heading = match geolocation(path, first)? {
        Some(heading) => heading,
        None => comments.iter().map(of_comment).find(Heading::names_places).unwrap_or_else(|| Heading::of(first)),
    };
    let of_opendronemap = is_crs(first);
    if of_opendronemap || Heading::of(first).names_places() {
        lines.remove(0);
    }
    if let Some((row, _)) = comments.iter().find(|(_, l)| names_angles(l)).filter(|_| !heading.names_places()) {
        let what = "names angles, but no x and y that are known here; call them x and y";
        return Err(Error::format(path, format!("row {row}, the heading,"), what));
    }
    let heads = &heading.heads;
    let cut = separator(lines.first().map_or(first, |(_, l)| l));
    if let Some(twice) = named_twice(heads).filter(|_| heading.names_places()) {
        let what = format!("two columns are called `{twice}`; name each column once");
        return Err(Error::format(path, "the heading", what));
    }
    let place = |keys: &[&str]| heads.iter().position(|h| keys.contains(&h.as_str()));
    let column = |name: &str| COLUMNS.iter().find(|c| c.0 == name).and_then(|c| place(c.1));
    let geographic = is_geographic(heads);
    let (name_at, at): (usize, Vec<Option<usize>>) = if heading.names_places() {
        let name = place(&NAMES).or_else(|| place(&["camera"])).ok_or_else(|| {
            Error::format(path, "the heading", format!("no column names the frames; call one of them `{}`", NAMES[0]))
        })?;
        (name, COLUMNS.iter().map(|c| column(c.0)).collect())
    } else {
        let n = heads.len();
        let opk = n >= 7;
        let known = [Some(1), Some(2), (n > 3).then_some(3), (n > 4 && !opk).then_some(4), None, None];
        let tail = [opk.then_some(4), opk.then_some(5), opk.then_some(6), None, None, None];
        (0, known.into_iter().chain(tail).collect())
    };
    let mut degrees = [1.0; ANGLES.end];
    for (i, factor) in degrees.iter_mut().enumerate().filter(|(i, _)| ANGLES.contains(i) && heading.names_places()) {
        if let Some(field) = at[i].and_then(|c| heading.fields.get(c)) {
            *factor = degrees_of(field).map_err(|what| Error::format(path, "the heading", what))?;
        }
    }
    // OpenDroneMap has further columns without titles.
    let most = if of_opendronemap { usize::MAX } else { heads.len() };
    let columns = Columns { name: name_at, at, cut, geographic, degrees, of_opendronemap, most };
    let mut rows: Vec<CameraRow> = Vec::new();
    let mut firsts = std::collections::HashMap::new();
    for (row, line) in lines {
        let read = columns.row(line).map_err(|what| Error::format(path, format!("row {row}"), what))?;
        if let Some(before) = firsts.insert(read.name.clone(), row) {
            let what = format!("`{}` has row {before} already; a frame has one place: take one of them out", read.name);
            return Err(Error::format(path, format!("row {row}"), what));
        }
        rows.push(read);
    }
    if rows.is_empty() {
        return Err(Error::format(path, "the table", "has no rows"));
    }
    Ok(rows)
}

/// Whether a line is a coordinate reference system, as OpenDroneMap's files begin.
fn is_crs(line: &str) -> bool {
    let line = line.to_lowercase();
    ["epsg:", "+proj=", "+init=", "wgs84 utm", "wgs 84 / utm"].iter().any(|word| line.starts_with(word))
}

/// The columns of OpenDroneMap's image geolocation file, which begins with its system; `None` of other tables. Source:
/// OpenDroneMap's documentation, "Image Geolocation Files".
fn geolocation(path: &Path, first: &str) -> Result<Option<Heading>> {
    let line = first.to_lowercase();
    let geographic = line == "epsg:4326" || line.starts_with("+proj=longlat") && line.contains("wgs84");
    match is_crs(first) {
        false => Ok(None),
        true if geographic => Ok(Some(Heading::of("name lon lat z yaw pitch roll sigma_m sigma_height_m"))),
        true => {
            let what = format!(
                "`{first}`: a camera table counts in the system of the flight (--crs, or crs in FLIGHT.toml); write \
                 `name x y z yaw pitch roll sigma_m sigma_height_m` instead of it, as far as there are columns"
            );
            Err(Error::format(path, "the first line", what))
        }
    }
}

/// Where a camera table has what.
struct Columns {
    name: usize,
    /// As in [`COLUMNS`].
    at: Vec<Option<usize>>,
    cut: Option<char>,
    geographic: bool,
    /// That one of a column's angles counts; 1 of the other columns.
    degrees: [f64; ANGLES.end],
    /// Three angles of 0 are none.
    of_opendronemap: bool,
    /// Cells that a row can have.
    most: usize,
}

impl Columns {
    /// The camera of a line; what is wrong with it as words.
    fn row(&self, line: &str) -> std::result::Result<CameraRow, String> {
        let f = fields(line, self.cut);
        no_more_cells(&f, self.most, self.cut)?;
        let value = |i: usize| -> std::result::Result<Option<f64>, String> {
            let Some(text) = self.at[i].and_then(|c| f.get(c)).filter(|t| !t.is_empty()) else { return Ok(None) };
            let factor = self.degrees.get(i).copied().unwrap_or(1.0);
            let read = decimal(text).ok_or_else(|| format!("`{text}` is no number for {}", COLUMNS[i].0))?;
            Ok(Some(if factor == 1.0 { read } else { read * factor }))
        };
        let name = f.get(self.name).filter(|n| !n.is_empty()).ok_or("the frame has no name")?.clone();
        let (Some(x), Some(y)) = (value(0)?, value(1)?) else { return Err("x or y is missing".into()) };
        let z = value(2)?
            .ok_or_else(|| format!("`{name}` has no height; the table wants one in a column `z` or `height`"))?;
        let xyz = [x, y, z];
        let off_earth = self.geographic && !(x.abs() <= 360.0 && y.abs() <= 90.0);
        if off_earth || xyz.iter().any(|v| v.abs() >= FARTHEST) {
            return Err(format!("`{name}` stands at ({x}, {y}, {z}), which is no place on Earth"));
        }
        let omega_phi_kappa_deg = match (value(6)?, value(7)?, value(8)?) {
            (Some(o), Some(p), Some(k)) => Some([o, p, k]),
            _ => None,
        };
        let none = self.of_opendronemap && (3..6).all(|i| matches!(value(i), Ok(None | Some(0.0))));
        let angle = |i: usize| if none { Ok(None) } else { value(i) };
        Ok(CameraRow {
            name,
            xyz,
            geographic: self.geographic,
            yaw_deg: angle(3)?,
            pitch_deg: angle(4)?,
            roll_deg: angle(5)?,
            omega_phi_kappa_deg,
            line: self.at[LINE].and_then(|c| f.get(c)).filter(|t| !t.is_empty()).cloned(),
            sigma_m: stated_sigmas([value(SIGMA)?, value(SIGMA + 1)?])?,
            taken_level: false,
        })
    }
}

/// The columns of a line's name, and of the first deviation.
const LINE: usize = 9;
const SIGMA: usize = 10;

/// Standard deviations of plan and height as a row states them; that of the height is the other's where it is alone.
fn stated_sigmas([plan, up]: [Option<f64>; 2]) -> std::result::Result<[Option<f64>; 2], String> {
    match [plan, up].into_iter().flatten().find(|sigma| *sigma <= 0.0) {
        Some(sigma) => Err(format!("a standard deviation of {sigma} m; a positive number, or nothing, is expected")),
        None => Ok([plan, up.or(plan)]),
    }
}

/// A finite number, its decimals after a point or a comma.
pub(super) fn decimal(text: &str) -> Option<f64> {
    text.parse().or_else(|_| text.replacen(',', ".", 1).parse()).ok().filter(|v: &f64| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::text_file as file;
    use super::*;

    /// A height that is not there is not 0.
    #[test]
    fn a_table_without_heights_is_refused() {
        for text in ["name,x,y\na.tif,1,2\n", "name,x,y,z\na.tif,1,2,\n", "name,x,y,q\na.tif,1,2,3\n", "a.tif 1 2\n"] {
            let (path, _gone) = file(text);
            assert!(cameras(&path).is_err_and(|e| e.to_string().contains("has no height")), "{text}");
        }
        let (path, _gone) = file("name,lat,lon,Ellipsoidal height\na.tif,1,2,3\n");
        assert_eq!(cameras(&path).expect("read")[0].xyz[2], 3.0);
    }

    #[test]
    fn rows_with_more_cells_than_titles_are_refused() {
        let (path, _gone) = file("name,x,y,z,omega,phi,kappa\na.tif,500000,5,4500000,5,664,0,0,0,0\n");
        assert!(cameras(&path).is_err_and(|e| e.to_string().contains("row 2: 10 cells in 7 columns, as from numbers")));
        let (path, _gone) = file("name,x,x,y,z\na.tif,1,2,3,4\n");
        assert!(cameras(&path).is_err_and(|e| e.to_string().contains("two columns are called `x`")));
    }

    #[test]
    fn titles_are_known_by_their_letters() {
        let (path, _gone) = file("Photo Name,Easting (m),Northing (m),Height [m],Yaw (deg)\na.tif,1,2,3,40\n");
        let rows = cameras(&path).expect("read");
        assert_eq!((rows[0].name.as_str(), rows[0].xyz, rows[0].yaw_deg), ("a.tif", [1.0, 2.0, 3.0], Some(40.0)));
        let (path, _gone) =
            file("# Label,X/East,Y/North,Z/Altitude,Yaw,Pitch,Roll,Error (m)\na.tif,1,2,3,40,5,6,0.1\n");
        let row = &cameras(&path).expect("read")[0];
        assert_eq!((row.xyz, row.yaw_deg, row.omega_phi_kappa_deg), ([1.0, 2.0, 3.0], Some(40.0), None));
        let (path, _gone) = file("# Label,X1,Y1,Z1,Yaw,Pitch,Roll\na.tif,1,2,3,40,5,6\n");
        assert!(cameras(&path).expect_err("angles of what").to_string().contains("row 1, the heading"));
    }

    #[test]
    fn angles_count_in_the_unit_of_their_titles() {
        let titles = |unit: &str| ["omega", "phi", "kappa"].map(|angle| unit.replace('?', angle)).join(",");
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        for (unit, whole) in [
            ("? [gon]", 400.0),
            ("?_gon", 400.0),
            ("? (rad)", std::f64::consts::TAU),
            ("?_rad", std::f64::consts::TAU),
            ("? [deg]", 360.0),
            ("?_deg", 360.0),
            ("? [°]", 360.0),
            ("?", 360.0),
        ] {
            let row = [0.01, -0.02, 0.4].map(|part| (part * whole).to_string()).join(",");
            let (path, _gone) = file(&format!("name,x,y,z,{}\na,1,2,3,{row}\n", titles(unit)));
            let read = cameras(&path).expect("read")[0].omega_phi_kappa_deg.expect("three angles");
            assert!(near(read, [3.6, -7.2, 144.0]), "{unit}: {read:?}");
        }
        let (path, _gone) = file("name,x,y,z,yaw [gon],pitch_rad,roll\na,1,2,3,100,-1,2\n");
        let row = &cameras(&path).expect("read")[0];
        let read = [row.yaw_deg, row.pitch_deg, row.roll_deg].map(|angle| angle.expect("stated"));
        assert!(near(read, [90.0, (-1f64).to_degrees(), 2.0]), "{read:?}");
        // Half of Europe calls a degree so, the other half a gon.
        for (unit, word) in [("?(grad)", "omega(grad)"), ("?_grad", "omega_grad"), ("? [mrad]", "`mrad`")] {
            let (path, _gone) = file(&format!("name,x,y,z,{}\na,1,2,3,4,5,6\n", titles(unit)));
            let said = cameras(&path).expect_err("which").to_string();
            assert!(said.contains("the heading") && said.contains(word) && said.contains("gon or"), "{said}");
        }
    }

    #[test]
    fn geolocation_of_opendronemap_is_a_camera_table() {
        let (path, _gone) = file("EPSG:4326\na.jpg 10.5 60.25 120 30 -80 1.5 0.03 0.05\nb.jpg 10.6 60.25 121 0 0 0\n");
        let rows = cameras(&path).expect("read");
        assert_eq!((rows[0].xyz, rows[0].geographic), ([10.5, 60.25, 120.0], true));
        assert_eq!(
            (rows[0].yaw_deg, rows[0].roll_deg, rows[0].sigma_m),
            (Some(30.0), Some(1.5), [Some(0.03), Some(0.05)])
        );
        // Its angles are 0 where there are none.
        assert_eq!((rows[1].yaw_deg, rows[1].sigma_m, rows.len()), (None, [None; 2], 2));
        for first in ["EPSG:32616", "WGS84 UTM 16N", "+proj=utm +zone=16 +datum=WGS84"] {
            let (path, _gone) = file(&format!("{first}\na.jpg 482751.3 1557416.2 1154.9\n"));
            let said = cameras(&path).expect_err("of which system").to_string();
            assert!(said.contains(first) && said.contains("--crs") && said.contains("name x y z"), "{said}");
        }
    }

    #[test]
    fn an_aircraft_that_states_no_roll_flies_level() {
        let row = |pitch_deg, roll_deg| CameraRow { yaw_deg: Some(30.0), pitch_deg, roll_deg, ..CameraRow::default() };
        let pose = |row: &CameraRow| row.pose(None).expect("a direction").rotation;
        let whole = row(Some(-2.0), Some(0.0)).with_angles_of_view(Angles::Aircraft);
        let part = row(Some(-2.0), None).with_angles_of_view(Angles::Aircraft);
        assert!(whole.is_directed() && !part.is_directed());
        assert!((pose(&whole) - pose(&part)).norm() < 1e-12);
        let level = row(None, Some(2.0)).with_angles_of_view(Angles::Aircraft);
        let stated = row(Some(0.0), Some(2.0)).with_angles_of_view(Angles::Aircraft);
        assert!((pose(&level) - pose(&stated)).norm() < 1e-12);
        let view = row(Some(-20.0), Some(1.0));
        assert_eq!(view.clone().with_angles_of_view(Angles::View), view);
    }

    #[test]
    fn tables_of_cameras() {
        let (path, _gone) = file("name,x,y,z,yaw\nS36 1.png,100,200,3000,12.5\n");
        let rows = cameras(&path).expect("a table");
        assert_eq!(
            (rows[0].name.as_str(), rows[0].xyz, rows[0].yaw_deg),
            ("S36 1.png", [100.0, 200.0, 3000.0], Some(12.5))
        );
        let (path, _gone) = file("'filename' 'x' 'y' 'z' 'omega' 'phi' 'kappa' 'camera'\n'a b' 1 2 3 4 5 6 'dji x'\n");
        let rows = cameras(&path).expect("a table");
        assert_eq!((rows[0].name.as_str(), rows[0].omega_phi_kappa_deg), ("a b", Some([4.0, 5.0, 6.0])));
        let (path, _gone) = file("name,x,y,z\n\"a \"\"b\"\" 'c'.png\",1,2,3\n'd''e \"f\"',1,2,3\n");
        let names: Vec<String> = cameras(&path).expect("a table").into_iter().map(|row| row.name).collect();
        assert_eq!(names, ["a \"b\" 'c'.png", "d'e \"f\""]);
        let (path, _gone) = file("3324 -55094.5 -3727407.0 5258.3 -0.35 0.29 -179.08\n");
        assert_eq!(cameras(&path).expect("a table")[0].omega_phi_kappa_deg, Some([-0.35, 0.29, -179.08]));
        for heading in ["# name,x,y,z,yaw,pitch,roll", "#Label,X/Easting,Y/Northing,Z/Altitude,Yaw,Pitch,Roll"] {
            let text = format!("# a flight\n{heading}\na.jpg,1,2,3,10,-90,0.5\n");
            let (path, _gone) = file(&text);
            let row = &cameras(&path).expect("a table")[0];
            assert_eq!((row.yaw_deg, row.pitch_deg, row.roll_deg), (Some(10.0), Some(-90.0), Some(0.5)), "{heading}");
            assert!(row.omega_phi_kappa_deg.is_none() && !row.geographic);
        }
        let (path, _gone) = file("imageName X Y Z Omega Phi Kappa\na.jpg 1 2 3 4 5 6\n");
        assert_eq!(cameras(&path).expect("a table")[0].omega_phi_kappa_deg, Some([4.0, 5.0, 6.0]));
        let (path, _gone) = file("name;lat;lon;alt\na;78,5;15,25;900\n");
        let row = &cameras(&path).expect("a table")[0];
        assert_eq!((row.xyz, row.geographic), ([15.25, 78.5, 900.0], true));
        let (path, _gone) = file("name,x,y,z\na,1,2,3\nb,1,3,3\na,5,2,3\n");
        assert!(cameras(&path).expect_err("twice").to_string().contains("row 4: `a` has row 2 already"));
        for (text, row) in [("name,x,y,z\na,1,2,3\nb,1e20,3,3\n", "row 3"), ("name,lon,lat,h\na,15,98,5\n", "row 2")] {
            let (path, _gone) = file(text);
            let said = cameras(&path).expect_err("nowhere").to_string();
            assert!(said.contains(row) && said.contains("no place on Earth"), "{said}");
        }
        let (path, _gone) = file("name,x,y\na,1,north\n");
        assert!(cameras(&path).expect_err("no number").to_string().contains("row 2: `north` is no number for y"));
    }
}
