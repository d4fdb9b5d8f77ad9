//! GCPs as OpenDroneMap's `gcp_list.txt`: a first line with the CRS, then
//! `geo_x geo_y geo_z im_x im_y image [label …]`, one line for each image in which a point was seen. Lists of points
//! under such a first line (`label x y z`) are taken too.
//!
//! Source: the chapter "Ground Control Points" of OpenDroneMap's manual. What is measured in the images is checked but
//! not used: it belongs to the photographs from which an orthophoto was made.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::text::{Line, number};
use crate::gcp::{Gcp, GcpRole, csv_list};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

/// What OpenDroneMap's labels of check points begin with.
pub const CHECK_PREFIX: &str = "CHK-";

/// The name of the check point that a label is of.
fn check_point(label: &str) -> Option<&str> {
    label.strip_prefix(CHECK_PREFIX).filter(|name| !name.is_empty())
}

/// Whether a first line can be a CRS of such a list.
pub(super) fn is_crs_line(line: &str) -> bool {
    let upper = line.trim().to_uppercase();
    // A point may be called `EPSG:1`; but in PROJ strings no CRS has two numbers behind its first comma.
    let mut cells = upper.split(',').skip(1);
    let numbers = [cells.next(), cells.next()].iter().all(|cell| cell.is_some_and(|cell| number(cell).is_some()));
    let is_point = numbers && !upper.starts_with('+');
    !is_point
        && [
            "EPSG:", "+PROJ", "+INIT", "WGS84", "WGS 84", "ETRS89", "EUREF89", "NAD83", "PUWG", "PROJCS", "PROJCRS",
            "GEOGCS",
        ]
        .iter()
        .chain(&["GEOGCRS", "COMPD_CS", "COMPOUNDCRS", "URN:OGC", "ESRI:"])
        .any(|start| upper.starts_with(start))
}

/// Whether the rows look like observations: from the first line on, when they name image files, else after it, whatever
/// it says. Any word may name an image there, but a number is none.
pub(super) fn has_observations(lines: &[Line<'_>]) -> bool {
    let names_an_image = |line: &Line<'_>| {
        observation(&fields(line.text)).is_some_and(|seen| crate::gcp::text::number(&seen.image).is_none())
    };
    let second = lines.iter().skip(1).find(|line| !line.is_comment());
    begins_with_a_row(lines) || (second.is_some_and(names_an_image) && observation(&fields(lines[0].text)).is_none())
}

/// Whether the first line is an observation in an image file: the list names no CRS.
fn begins_with_a_row(lines: &[Line<'_>]) -> bool {
    lines.first().and_then(|line| observation(&fields(line.text)).map(|seen| is_image(&seen.image))) == Some(true)
}

/// Whether a name ends as those of images do.
fn is_image(name: &str) -> bool {
    const IMAGES: [&str; 9] = ["jpg", "jpeg", "tif", "tiff", "png", "dng", "jp2", "bmp", "webp"];
    name.rsplit_once('.').is_some_and(|(_, end)| IMAGES.iter().any(|known| end.eq_ignore_ascii_case(known)))
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let (crs, from) = match begins_with_a_row(lines) {
        true => (CrsClaim::None, 0),
        false => (CrsClaim::read(path, lines[0].place(), lines[0].text), 1),
    };
    let rows: Vec<Line<'_>> = lines[from..].iter().filter(|line| !line.is_comment()).copied().collect();
    let mut list = if rows.first().is_some_and(|row| observation(&fields(row.text)).is_some()) {
        observations(path, &rows)?
    } else {
        let mut list = csv_list::parse(path, &rows)?;
        if list.order == ColumnOrder::Untitled {
            list.order = ColumnOrder::Ruled;
        }
        for point in &mut list.points {
            if let Some(name) = check_point(&point.gcp.name) {
                point.gcp.name = name.to_string();
                point.gcp.role = GcpRole::Check;
            }
        }
        list
    };
    list.crs = crs;
    Ok(list)
}

/// At tabs when there are any, since names may hold blanks; else at blanks; else at semicolons, beside which a comma is
/// a decimal one, or at commas.
fn fields(line: &str) -> Vec<&str> {
    let cut = |at: &[char]| -> Vec<&str> { line.split(at).map(str::trim).filter(|f| !f.is_empty()).collect() };
    let marks = if line.contains(';') { [';'] } else { [','] };
    let ways = [cut(&['\t']), cut(&[' ', '\t']), cut(&marks)];
    let long = || ways.iter().filter(|fields| fields.len() >= 6);
    // "500000.5, 6000000.5, 10, …" has blanks and commas.
    let best = long().find(|fields| observation(fields).is_some()).or_else(|| long().next());
    best.or(ways.iter().max_by_key(|f| f.len())).cloned().unwrap_or_default()
}

struct Observation<'a> {
    place: [f64; 2],
    height: Option<f64>,
    /// OpenDroneMap counts from the centre of the first pixel.
    pixel: PixelPoint,
    image: Cow<'a, str>,
    label: Option<&'a str>,
}

fn observation<'a>(fields: &[&'a str]) -> Option<Observation<'a>> {
    if fields.len() < 6 {
        return None;
    }
    let mut numbers = [None; 5];
    for (value, field) in numbers.iter_mut().zip(fields) {
        *value = number(field);
    }
    // "NaN" stands for a height that is not known.
    let [Some(x), Some(y), z, Some(im_x), Some(im_y)] = numbers else { return None };
    if z.is_none() && !fields[2].eq_ignore_ascii_case("nan") {
        return None;
    }
    let pixel = PixelPoint { x: im_x + 0.5, y: im_y + 0.5 };
    // OpenDroneMap itself cuts at every blank; of a name with blanks the end is known by its letters.
    let end = (5..fields.len()).find(|&at| is_image(fields[at])).unwrap_or(5);
    let image = if end == 5 { Cow::Borrowed(fields[5]) } else { Cow::Owned(fields[5..=end].join(" ")) };
    Some(Observation { place: [x, y], height: z, pixel, image, label: fields.get(end + 1).copied() })
}

fn observations(path: &Path, rows: &[Line<'_>]) -> Result<RawList> {
    let mut points: Vec<RawPoint> = Vec::new();
    let mut labelled: HashMap<String, usize> = HashMap::new();
    let mut placed: HashMap<[u64; 3], usize> = HashMap::new();
    let mut unlabelled = 0;
    for row in rows {
        let Observation { place, height, pixel, image, label } = observation(&fields(row.text)).ok_or_else(|| {
            Error::format(
                path,
                row.place(),
                format!(
                    "`{}` is no observation: geo_x geo_y geo_z im_x im_y image [label] are expected",
                    row.text.chars().take(80).collect::<String>()
                ),
            )
        })?;
        let seen_at = Seen { image: Some(image.into_owned()), at: pixel };
        let key = [place[0].to_bits(), place[1].to_bits(), height.map_or(u64::MAX, f64::to_bits)];
        let seen = match label {
            Some(label) => labelled.get(label),
            None => placed.get(&key),
        };
        if let Some(&seen) = seen {
            let point = &points[seen].gcp;
            if [point.easting, point.northing] != place || point.height != height {
                return Err(Error::format(
                    path,
                    row.place(),
                    format!(
                        "`{}` has other coordinates here than in {}; a label is one point",
                        point.name, points[seen].place
                    ),
                ));
            }
            points[seen].pixels.push(seen_at);
            continue;
        }
        let name = label.map_or_else(
            || {
                unlabelled += 1;
                unlabelled.to_string()
            },
            str::to_string,
        );
        placed.insert(key, points.len());
        if label.is_some() {
            labelled.insert(name.clone(), points.len());
        }
        let (name, role) = match check_point(&name) {
            Some(name) => (name.to_string(), GcpRole::Check),
            None => (name, GcpRole::Control),
        };
        let gcp = Gcp { height, role, ..Gcp::control(name, place[0], place[1]) };
        points.push(RawPoint { pixels: vec![seen_at], ..RawPoint::bare(gcp, row.place()) });
    }
    let mut list = RawList::new(points, CrsClaim::None);
    list.order = ColumnOrder::Ruled;
    if unlabelled > 0 {
        list.notes.push(format!(
            "{}: {} no label: numbered in order of appearance",
            path.display(),
            counted(unlabelled, "point has", "points have")
        ));
    }
    Ok(list)
}
