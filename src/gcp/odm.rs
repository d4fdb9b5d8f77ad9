//! GCPs as OpenDroneMap's `gcp_list.txt`: a first line with the CRS, then `geo_x geo_y geo_z im_x im_y image [label …]`,
//! one line for each image in which a point was seen. Lists of points under such a first line (`label x y z`) are taken too.
//!
//! Source: the chapter "Ground Control Points" of OpenDroneMap's manual. What is measured in the images is checked but not
//! used: it belongs to the photographs from which an orthophoto was made.

use std::collections::HashMap;
use std::path::Path;

use crate::error::{Error, Result};
use crate::gcp::raw::{ColumnOrder, CrsClaim, RawList, RawPoint};
use crate::gcp::text::{Line, number};
use crate::gcp::{Gcp, csv_list};

/// Whether a first line can be a CRS of such a list.
pub(super) fn is_crs_line(line: &str) -> bool {
    let upper = line.trim().to_uppercase();
    ["EPSG:", "+PROJ", "+INIT", "WGS84", "WGS 84", "ETRS89", "EUREF89", "NAD83", "PUWG", "PROJCS", "PROJCRS", "GEOGCS"]
        .iter()
        .chain(&["GEOGCRS", "COMPD_CS", "COMPOUNDCRS", "URN:OGC", "ESRI:"])
        .any(|start| upper.starts_with(start))
}

/// Whether the rows after the first line look like observations, whatever the first line says.
pub(super) fn has_observations(lines: &[Line<'_>]) -> bool {
    lines
        .iter()
        .skip(1)
        .find(|line| !line.is_comment())
        .is_some_and(|line| observation(&fields(line.text)).is_some() && observation(&fields(lines[0].text)).is_none())
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let crs = CrsClaim::read(path, lines[0].place(), lines[0].text);
    let rows: Vec<Line<'_>> = lines[1..].iter().filter(|line| !line.is_comment()).copied().collect();
    let mut list = if rows.first().is_some_and(|row| observation(&fields(row.text)).is_some()) {
        observations(path, &rows)?
    } else {
        csv_list::parse(path, &rows)?
    };
    list.crs = crs;
    Ok(list)
}

/// At tabs when there are any, since names may hold blanks; else at blanks; else at commas or semicolons.
fn fields(line: &str) -> Vec<&str> {
    let cut = |at: &[char]| -> Vec<&str> { line.split(at).map(str::trim).filter(|f| !f.is_empty()).collect() };
    [cut(&['\t']), cut(&[' ', '\t']), cut(&[',', ';'])]
        .into_iter()
        .max_by_key(|f| (f.len() >= 6, f.len()))
        .unwrap_or_default()
}

struct Observation<'a> {
    ground: [f64; 3],
    label: Option<&'a str>,
}

fn observation<'a>(fields: &[&'a str]) -> Option<Observation<'a>> {
    if fields.len() < 6 {
        return None;
    }
    let mut numbers = [0.0; 5];
    for (value, field) in numbers.iter_mut().zip(fields) {
        *value = number(field)?;
    }
    let [x, y, z, ..] = numbers;
    Some(Observation { ground: [x, y, z], label: fields.get(6).copied() })
}

fn observations(path: &Path, rows: &[Line<'_>]) -> Result<RawList> {
    let mut points: Vec<RawPoint> = Vec::new();
    let mut labelled: HashMap<String, usize> = HashMap::new();
    let mut placed: HashMap<[u64; 3], usize> = HashMap::new();
    let mut unlabelled = 0;
    for row in rows {
        let Observation { ground, label } = observation(&fields(row.text)).ok_or_else(|| {
            Error::format(
                path,
                row.place(),
                format!(
                    "`{}` is no observation: geo_x geo_y geo_z im_x im_y image [label] are expected",
                    row.text.chars().take(80).collect::<String>()
                ),
            )
        })?;
        let key = ground.map(f64::to_bits);
        let seen = match label {
            Some(label) => labelled.get(label),
            None => placed.get(&key),
        };
        if let Some(&seen) = seen {
            let point = &points[seen].gcp;
            if [point.easting, point.northing, point.height.unwrap_or(0.0)] != ground {
                return Err(Error::format(
                    path,
                    row.place(),
                    format!(
                        "`{}` has other coordinates here than in {}; a label is one point",
                        point.name, points[seen].place
                    ),
                ));
            }
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
        labelled.insert(name.clone(), points.len());
        let gcp = Gcp { height: Some(ground[2]), ..Gcp::control(name, ground[0], ground[1]) };
        points.push(RawPoint::bare(gcp, row.place()));
    }
    let mut list = RawList::new(points, CrsClaim::None);
    list.order = ColumnOrder::Assumed;
    if unlabelled > 0 {
        list.notes.push(format!(
            "{}: {unlabelled} points have no label and were numbered in order of appearance",
            path.display()
        ));
    }
    Ok(list)
}
