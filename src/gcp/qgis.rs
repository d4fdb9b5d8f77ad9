//! GCPs as the `.points` file of QGIS's Georeferencer: an optional line `#CRS: WKT`, a header, then
//! `mapX,mapY,sourceX,sourceY,enable,dX,dY,residual`; files of QGIS 1 and 2 have `pixelX,pixelY` and no CRS, the oldest
//! ones tabs and no header. Source: `QgsGCPList::loadGcps` and `saveGcps` in QGIS.
//!
//! Only the surveyed side is used. A column `name` beyond QGIS's own (QGIS passes over it) gives the names; without it
//! points are numbered by row.

use std::path::Path;

use crate::gcp::Gcp;
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::text::{Line, Separator, number, split};
use autoref_raster::error::{Error, Result};

pub(super) fn is_points(lines: &[Line<'_>]) -> bool {
    lines.iter().take(3).any(|line| {
        let lower = line.text.trim_start_matches('#').trim_start().to_lowercase();
        lower.starts_with("mapx") && (lower.contains("sourcex") || lower.contains("pixelx"))
    })
}

pub(super) fn parse(path: &Path, lines: &[Line<'_>]) -> Result<RawList> {
    let mut crs = CrsClaim::None;
    let mut name_column = None;
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
            name_column = split(content, separator).iter().position(|t| t.eq_ignore_ascii_case("name"));
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
        let [Some(easting), Some(northing), Some(_), Some(_), ref enable @ ..] = numbers[..] else {
            return Err(Error::format(
                path,
                line.place(),
                format!(
                    "`{}` is no point of QGIS: mapX,mapY,sourceX,sourceY,enable are expected",
                    line.text.chars().take(80).collect::<String>()
                ),
            ));
        };
        if enable.first() == Some(&Some(0.0)) {
            disabled += 1;
            continue;
        }
        let name = name_column.and_then(|column| fields.get(column)).filter(|name| !name.is_empty());
        let name = name.cloned().unwrap_or_else(|| (points.len() + 1).to_string());
        points.push(RawPoint::bare(Gcp::control(name, easting, northing), line.place()));
    }
    let mut list = RawList::new(points, crs);
    if disabled > 0 {
        list.notes.push(format!("{}: {disabled} points are switched off and were left out", path.display()));
    }
    Ok(list)
}
