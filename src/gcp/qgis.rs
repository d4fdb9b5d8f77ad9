//! GCPs as the `.points` file of QGIS's Georeferencer: an optional line `#CRS: WKT`, a header, then
//! `mapX,mapY,sourceX,sourceY,enable,dX,dY,residual`; files of QGIS 1 and 2 have `pixelX,pixelY` and no CRS, the oldest
//! ones tabs and no header. Source: `QgsGCPList::loadGcps` and `saveGcps` in QGIS.
//!
//! A column `name` beyond QGIS's own (QGIS passes over it) gives the names; without it points are numbered by row. With
//! a column `role`, which `gcps convert` writes, points that are switched off are kept: as check points when it says
//! so.

use std::path::Path;

use crate::gcp::raw::{CrsClaim, RawList, RawPoint, Seen};
use crate::gcp::roles::is_check;
use crate::gcp::text::{Line, Separator, number, split};
use crate::gcp::{Gcp, GcpRole};
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};
use autoref_raster::words::counted;

pub(super) fn is_points(lines: &[Line<'_>]) -> bool {
    lines.iter().take(3).any(|line| {
        let lower = line.text.trim_start_matches('#').trim_start().to_lowercase();
        lower.starts_with("mapx") && (lower.contains("sourcex") || lower.contains("pixelx"))
    })
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let mut crs = CrsClaim::None;
    let (mut name_column, mut role_column) = (None, None);
    let mut points = Vec::new();
    let mut disabled = 0;
    for line in lines {
        if let Some(definition) = line.text.strip_prefix("#CRS:") {
            if !definition.trim().is_empty() {
                crs = CrsClaim::read(path, line.place(), definition.trim());
            }
            continue;
        }
        let separator = Separator::Letter(if line.text.contains(',') { ',' } else { '\t' });
        let content = line.text.trim_start_matches('#').trim_start();
        if content.to_lowercase().starts_with("mapx") {
            let titles = split(content, separator);
            let column = |title: &str| titles.iter().position(|t| t.eq_ignore_ascii_case(title));
            (name_column, role_column) = (column("name"), column("role"));
            continue;
        }
        if line.is_comment() {
            continue;
        }
        let mut fields = split(line.text, separator);
        if fields.len() < 4 {
            fields = split(line.text, Separator::Blanks);
        }
        let numbers: Vec<Option<f64>> = fields.iter().take(5).map(|f| number(f)).collect();
        // Our own lists without pixels leave them empty; QGIS takes such points as switched off.
        let unseen = fields.len() >= 4 && fields[2].is_empty() && fields[3].is_empty();
        let numbers: Vec<Option<f64>> =
            if unseen { vec![numbers[0], numbers[1], Some(0.0), Some(0.0)] } else { numbers };
        let [Some(easting), Some(northing), Some(x), Some(y), ref enable @ ..] = numbers[..] else {
            return Err(Error::format(
                path,
                line.place(),
                format!(
                    "`{}` is no point of QGIS: mapX,mapY,sourceX,sourceY,enable are expected",
                    line.text.chars().take(80).collect::<String>()
                ),
            ));
        };
        let role = role_column.and_then(|column| fields.get(column)).filter(|role| !role.is_empty());
        if enable.first() == Some(&Some(0.0)) && role.is_none() {
            disabled += 1;
            continue;
        }
        let name = name_column.and_then(|column| fields.get(column)).filter(|name| !name.is_empty());
        let name = name.cloned().unwrap_or_else(|| (points.len() + 1).to_string());
        let role = if role.is_some_and(|role| is_check(role)) { GcpRole::Check } else { GcpRole::Control };
        let mut point = RawPoint::bare(Gcp { role, ..Gcp::control(name, easting, northing) }, line.place());
        if !unseen {
            point.pixels.push(Seen { image: None, at: PixelPoint { x, y: -y } });
        }
        points.push(point);
    }
    let mut list = RawList::new(points, crs);
    if disabled > 0 {
        list.notes.push(format!(
            "{}: {} switched off and left out",
            path.display(),
            counted(disabled, "point is", "points are")
        ));
    }
    Ok(list)
}
