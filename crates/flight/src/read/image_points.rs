//! Points measured in images, as text: OpenDroneMap's lists, rows for one image, tables with titles.

use std::path::Path;

use super::model::FARTHEST;
use super::tables::decimal;
use super::titles::{IMAGES, PIXEL_X, PIXEL_Y, column_at, fields, is_geographic, no_more_cells, separator, titles_of};
use crate::error::{Error, Result, read_text};

/// A point measured in an image, with its place on the ground when the list has it.
#[derive(Clone, Debug, PartialEq)]
pub struct ImagePoint {
    /// Empty when the list belongs to one image.
    pub image: String,
    pub name: String,
    pub xyz: Option<[f64; 3]>,
    /// `None` of a row that has a point and no place in an image.
    pub pixel: Option<[f64; 2]>,
    /// The list says that the point is to be compared, not used: a column `role`, or a name that begins with `CHK-`.
    pub check: bool,
    /// 1σ on the ground, metres, of each coordinate that the list has it of.
    pub sigma: [Option<f64>; 3],
}

/// What names of check points begin with, as OpenDroneMap has it.
const CHECK_PREFIX: &str = "CHK-";

/// The name without what says that it is a check point, and whether it is one.
fn name_and_role(name: &str, role: &str) -> (String, bool) {
    const CHECKS: [&str; 6] = ["check", "checkpoint", "3dcheckpoint", "cp", "kontrollpunkt", "kontroll"];
    let role: String = role.to_lowercase().chars().filter(|c| c.is_alphanumeric()).collect();
    let prefixed = name.strip_prefix(CHECK_PREFIX).filter(|rest| !rest.is_empty());
    (prefixed.unwrap_or(name).to_string(), prefixed.is_some() || CHECKS.contains(&role.as_str()))
}

/// Reads points measured in images from text: OpenDroneMap's `gcp_list.txt` (a CRS, then `x y z px py image [name]`),
/// rows of `x y z px py` for one image with or without a heading, or a table with the columns `name`, `image`, `px`,
/// `py` (`u`, `v`). Pixels count from the outer corner of the first pixel; under the CRS of an OpenDroneMap list from
/// its centre, and half a pixel is added. Returns the CRS line when there is one.
///
/// # Errors
/// When a row is no point; the message names it.
pub fn read(path: &Path) -> Result<(Option<String>, Vec<ImagePoint>)> {
    let text = read_text(path)?;
    let lines: Vec<(usize, &str)> = text
        .trim_start_matches('\u{feff}')
        .lines()
        .enumerate()
        .map(|(i, l)| (i + 1, l.trim()))
        .filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
        .collect();
    let Some((_, first)) = lines.first() else { return Err(Error::format(path, "the list", "is empty")) };
    let heads = titles_of(first);
    let place = |keys: &[&str]| heads.iter().position(|h| keys.contains(&h.as_str()));
    match (place(&PIXEL_X), place(&PIXEL_Y)) {
        (Some(px), Some(py)) => {
            let points = rows_under_titles(path, &heads, [px, py], &lines)?;
            let earth = is_geographic(&heads).then(|| "EPSG:4326".to_string());
            Ok((earth, points))
        }
        _ => rows_in_order(path, &lines),
    }
}

/// The rows of a table whose titles name its columns, those of the pixel among them.
fn rows_under_titles(
    path: &Path,
    heads: &[String],
    [px, py]: [usize; 2],
    lines: &[(usize, &str)],
) -> Result<Vec<ImagePoint>> {
    let cut = separator(lines[0].1);
    let place = |keys: &[&str]| heads.iter().position(|h| keys.contains(&h.as_str()));
    let (image, role) = (place(&IMAGES), place(&["role", "type", "use"]));
    let name = place(&["name", "gcp", "point", "label", "id", "gcpname"]);
    let (plan, up) = (place(&["sigmam", "sigma"]), place(&["sigmaheightm", "sigmah"]));
    let ground = (column_at(heads, 0), column_at(heads, 1), column_at(heads, 2));
    let mut points: Vec<ImagePoint> = Vec::new();
    for (row, line) in &lines[1..] {
        let f = fields(line, cut);
        no_more_cells(&f, heads.len(), cut).map_err(|what| Error::format(path, format!("row {row}"), what))?;
        let value = |c: usize| number(path, *row, &f, c);
        let xyz = match ground {
            (Some(x), Some(y), Some(z)) => Some([value(x)?, value(y)?, value(z)?]),
            _ => None,
        };
        on_a_map(path, *row, xyz)?;
        let word = |c: Option<usize>| c.and_then(|c| f.get(c)).cloned().unwrap_or_default();
        let name = match word(name) {
            n if n.is_empty() => named(&points, xyz),
            n => n,
        };
        let (name, check) = name_and_role(&name, &word(role));
        let stated = |c: Option<usize>| c.filter(|c| f.get(*c).is_some_and(|t| !t.is_empty())).map(&value).transpose();
        let (plan, up) = (stated(plan)?, stated(up)?);
        let sigma = [plan, plan, up.or(plan)];
        let is_open = |c: usize| f.get(c).is_none_or(|t| matches!(t.to_lowercase().as_str(), "" | "-" | "nan"));
        let pixel = if is_open(px) && is_open(py) { None } else { Some([value(px)?, value(py)?]) };
        points.push(ImagePoint { image: word(image), name, xyz, pixel, check, sigma });
    }
    Ok(points)
}

/// Rows of `x y z px py [image [name]]` under a CRS, a heading of any words, or nothing.
fn rows_in_order(path: &Path, lines: &[(usize, &str)]) -> Result<(Option<String>, Vec<ImagePoint>)> {
    let numeric = |line: &str| {
        let f = split(line);
        f.len() >= 5 && f[..5].iter().all(|w| w.parse::<f64>().is_ok())
    };
    let crs = (!numeric(lines[0].1)).then(|| lines[0].1.to_string());
    // Five words or more may be titles or the name of a CRS (`ETRS89 / UTM zone 32N`), which has a number in it.
    let of_titles = |l: &str| split(l).len() >= 5 && !l.contains(|c: char| c.is_ascii_digit() || "+[".contains(c));
    let heading = crs.as_deref().is_some_and(of_titles);
    // OpenDroneMap counts from the centre of the first pixel; `local` is our own word, and counts as we do.
    let of_odm = crs.as_deref().is_some_and(|l| !heading && !l.eq_ignore_ascii_case("local"));
    let first_px = if of_odm { 0.5 } else { 0.0 };
    let mut points: Vec<ImagePoint> = Vec::new();
    for (row, line) in &lines[usize::from(crs.is_some())..] {
        let f = split(line);
        if f.len() < 5 {
            return Err(Error::format(path, format!("row {row}"), "`x y z px py [image [name]]` is expected"));
        }
        let v: Vec<f64> = (0..5).map(|c| number(path, *row, &f, c)).collect::<Result<_>>()?;
        let xyz = Some([v[0], v[1], v[2]]);
        on_a_map(path, *row, xyz)?;
        let (name, check) = name_and_role(&f.get(6).cloned().unwrap_or_else(|| named(&points, xyz)), "");
        let (image, pixel) = (f.get(5).cloned().unwrap_or_default(), Some([v[3] + first_px, v[4] + first_px]));
        points.push(ImagePoint { image, name, xyz, pixel, check, sigma: [None; 3] });
    }
    if points.is_empty() {
        return Err(Error::format(path, "the list", "has no rows"));
    }
    Ok((crs.filter(|_| !heading), points))
}

/// Refuses a place beyond all maps.
fn on_a_map(path: &Path, row: usize, xyz: Option<[f64; 3]>) -> Result<()> {
    match xyz.filter(|xyz| !xyz.iter().all(|v| v.abs() < FARTHEST)) {
        Some([x, y, z]) => {
            let what = format!("the point lies at ({x:e}, {y:e}, {z:e}), which is no place; correct it");
            Err(Error::format(path, format!("row {row}"), what))
        }
        None => Ok(()),
    }
}

/// Whether the titles of a table name places in images.
pub fn has_pixel_titles(text: &str) -> bool {
    let mut lines = text.trim_start_matches('\u{feff}').lines().map(str::trim);
    let Some(first) = lines.find(|l| !l.is_empty() && !l.starts_with('#')) else { return false };
    let heads = titles_of(first);
    [PIXEL_X, PIXEL_Y].iter().all(|titles| heads.iter().any(|h| titles.contains(&h.as_str())))
}

/// Whether a list begins as OpenDroneMap's do: a CRS alone in its first line, and under it nothing, or rows that go on
/// behind three coordinates.
pub fn begins_as_list(text: &str) -> bool {
    let mut lines =
        text.trim_start_matches('\u{feff}').lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('#'));
    let Some(first) = lines.next().map(str::to_lowercase) else { return false };
    let alone =
        first == "local" || first.starts_with("epsg:") || first.starts_with("+proj") || first.starts_with("wgs84");
    alone && lines.next().is_none_or(|row| split(row).len() >= 5)
}

fn split(line: &str) -> Vec<String> {
    let at_tabs = fields(line, Some('\t'));
    if at_tabs.len() >= 5 {
        return at_tabs;
    }
    let blank = fields(line, None);
    if blank.len() >= 5 { blank } else { fields(line, separator(line)) }
}

fn number(path: &Path, row: usize, f: &[String], c: usize) -> Result<f64> {
    let text = f.get(c).map_or("", String::as_str);
    decimal(text)
        .ok_or_else(|| Error::format(path, format!("row {row}"), format!("`{text}` in column {} is no number", c + 1)))
}

/// Unnamed rows of one place are one point; a place not seen yet gets the next number.
fn named(points: &[ImagePoint], xyz: Option<[f64; 3]>) -> String {
    if let Some(known) = points.iter().find(|p| xyz.is_some() && p.xyz == xyz) {
        return known.name.clone();
    }
    let mut places: Vec<&str> = points.iter().map(|p| p.name.as_str()).collect();
    places.sort_unstable();
    places.dedup();
    (places.len() + 1).to_string()
}

#[cfg(test)]
mod tests {
    use super::super::text_file as file;
    use super::*;

    #[test]
    fn lists_of_image_points() {
        let (path, _gone) = file("EPSG:25833\n1 2 3 10.5 20.5 a.jpg P1\n1 2 3 11 21 b.jpg P1\n");
        let (crs, points) = read(&path).expect("a list");
        assert_eq!((crs.as_deref(), points.len(), points[1].image.as_str()), (Some("EPSG:25833"), 2, "b.jpg"));
        for named in ["ETRS89 / UTM zone 32N", "WGS 84 / UTM zone 33N", "Amersfoort / RD New"] {
            let text = format!("{named}\n1 2 3 10.5 20.5 a.jpg P1\n");
            let (path, _gone) = file(&text);
            let (crs, points) = read(&path).expect("a list");
            assert_eq!((crs.as_deref(), points[0].pixel), (Some(named), Some([11.0, 21.0])));
        }
        let (path, _gone) = file("Est Nord Alt Sp Zl Bild\n1 2 3 10.5 20.5 a.jpg\n");
        let (crs, points) = read(&path).expect("a list");
        assert_eq!((crs, points[0].pixel), (None, Some([10.5, 20.5])));
        let (path, _gone) =
            file("name;x;y;z;image;px;py;role;sigma_m\nA;1,5;2;3;a.jpg;863,25;5;check;0,05\nCHK-B;1;2;3;a.jpg;1;2;;\n");
        let (_, points) = read(&path).expect("a list");
        assert_eq!((points[0].pixel, points[0].sigma, points[0].check), (Some([863.25, 5.0]), [Some(0.05); 3], true));
        assert_eq!((points[1].name.as_str(), points[1].check, points[1].sigma), ("B", true, [None; 3]));
        let (path, _gone) = file("x\ty\tz\tx\ty\n1\t2\t3\t4\t5\n1\t2\t4\t4\t6\n");
        let (crs, points) = read(&path).expect("a list");
        assert_eq!((crs, points[1].name.as_str(), points[1].pixel), (None, "2", Some([4.0, 6.0])));
        let (path, _gone) =
            file("name,lon,lat,h,image,px,py,sigma_height_m\nA,10,60,3,a.jpg,5,6,0.1\nB,10,61,4,a.jpg,-,,\n");
        let (crs, points) = read(&path).expect("a list");
        assert_eq!((crs.as_deref(), points[0].sigma), (Some("EPSG:4326"), [None, None, Some(0.1)]));
        assert_eq!((points[1].pixel, points.len()), (None, 2));
    }

    #[test]
    fn titles_name_the_columns() {
        let (path, _gone) = file("GCP Name,Images,Pixel X,Pixel_Y\nP1,a.tif,10.5,20\n");
        let (_, points) = read(&path).expect("read");
        let first = &points[0];
        assert_eq!((&*first.name, &*first.image, first.pixel), ("P1", "a.tif", Some([10.5, 20.0])));
        let (path, _gone) = file("name,image,px,py\nP,a.tif,10,5,20,5\n");
        assert!(read(&path).is_err_and(|e| e.to_string().contains("6 cells in 4 columns")));
    }
}
