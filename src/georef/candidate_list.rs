//! Lists of candidates as files: what `detect` writes and `solve` reads.
//!
//! CSV columns: `x,y` (pixels, (0, 0) the outer corner of the first pixel), then `score`, `cov_xx,cov_xy,cov_yy` (px²),
//! `area` (px), `width,height` (px), `elevation` (m), `probability` (that it is a mark, from the score; not read back),
//! and `code` (`family:number`) when the list holds coded targets. Only `x` and `y` are required when reading; the
//! order is free. Numbers are written in the shortest form that reads back to the same value, so that two lists are
//! equal when their bytes are.

use std::io::Write;
use std::path::Path;

use crate::candidate::{Candidate, Code};
use crate::georef::spreadsheet::Spreadsheet;
use autoref_raster::bounded;
use autoref_raster::coords::PixelPoint;
use autoref_raster::error::{Error, Result};

const COLUMNS: [&str; 10] = ["x", "y", "score", "cov_xx", "cov_xy", "cov_yy", "area", "width", "height", "elevation"];
/// Follows from the score, so that it is written and not read.
const PROBABILITY: &str = "probability";
/// Written after the others when any candidate has one.
const CODE: &str = "code";

/// Writes the list as CSV.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_csv(candidates: &[Candidate], mut out: impl Write) -> std::io::Result<()> {
    let coded = candidates.iter().any(|c| c.code.is_some());
    let code = if coded { format!(",{CODE}") } else { String::new() };
    writeln!(out, "{},{PROBABILITY}{code}", COLUMNS.join(","))?;
    for candidate in candidates {
        let mut fields = fields(candidate).map(|value| value.map_or(String::new(), |v| v.to_string())).to_vec();
        fields.push(candidate.probability().map_or(String::new(), |p| p.to_string()));
        if coded {
            fields.push(candidate.code.as_ref().map_or(String::new(), Code::to_string));
        }
        writeln!(out, "{}", fields.join(","))?;
    }
    Ok(())
}

fn fields(candidate: &Candidate) -> [Option<f64>; 10] {
    let covariance = |i: usize| candidate.covariance_px2.map(|c| c[i]);
    let size = |i: usize| candidate.size_px.map(|s| s[i]);
    [
        Some(candidate.centre.x),
        Some(candidate.centre.y),
        candidate.score,
        covariance(0),
        covariance(1),
        covariance(2),
        candidate.area_px,
        size(0),
        size(1),
        candidate.elevation_m,
    ]
}

/// Writes the list as GeoJSON points in pixel space: y is negated so that the picture is not upside down in a viewer;
/// the properties hold x and y as they are.
///
/// # Errors
/// When `out` cannot be written.
pub fn write_geojson(candidates: &[Candidate], mut out: impl Write) -> std::io::Result<()> {
    // One at a time: thousands of documents take more memory than the scan that found them.
    write!(out, r#"{{"type":"FeatureCollection","features":["#)?;
    for (k, candidate) in candidates.iter().enumerate() {
        let mut properties: serde_json::Map<String, serde_json::Value> = COLUMNS
            .iter()
            .zip(fields(candidate))
            .filter_map(|(name, value)| Some(((*name).to_string(), value?.into())))
            .collect();
        if let Some(probability) = candidate.probability() {
            properties.insert(PROBABILITY.to_string(), probability.into());
        }
        if let Some(code) = &candidate.code {
            properties.insert(CODE.to_string(), code.to_string().into());
        }
        let feature = serde_json::json!({
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [candidate.centre.x, -candidate.centre.y]},
            "properties": properties,
        });
        write!(out, "{}{feature}", if k > 0 { "," } else { "" })?;
    }
    writeln!(out, "]}}")
}

/// Reads a CSV list.
///
/// # Errors
/// When the file cannot be read, lacks `x` or `y`, or has a value that is no number; the message names the row.
pub fn read_csv(path: &Path) -> Result<Vec<Candidate>> {
    let table = Spreadsheet::read(path, "a list of candidates", bounded::DOCUMENT_BYTES)?;
    if table.is_json() {
        return Err(Error::format(path, "begin", "JSON is no list of candidates; write CSV: detect IMAGE -o NAME.csv"));
    }
    let mut reader = table.reader();
    let headers = reader.headers().map_err(|e| csv_error(path, &e))?.clone();
    let column = |name: &str| headers.iter().position(|h| h.trim_start_matches('\u{feff}').eq_ignore_ascii_case(name));
    let (places, code_place) = (COLUMNS.map(column), column(CODE));
    for (name, place) in COLUMNS.iter().zip(places).take(2) {
        if place.is_none() {
            return Err(Error::format(path, "row 1", format!("no column `{name}`; a candidate list needs x and y")));
        }
    }
    let mut candidates = Vec::new();
    for (index, record) in reader.records().enumerate() {
        let record = record.map_err(|e| csv_error(path, &e))?;
        let row = table.row(index);
        let mut values = [None; 10];
        for ((value, place), name) in values.iter_mut().zip(places).zip(COLUMNS) {
            let Some(text) = place.and_then(|i| record.get(i)).filter(|text| !text.is_empty()) else { continue };
            let number = table.number(text).ok_or_else(|| {
                Error::format(path, format!("row {row}"), format!("`{text}` in column `{name}` is not a number"))
            })?;
            *value = Some(number);
        }
        let code = code_place
            .and_then(|i| record.get(i))
            .filter(|text| !text.is_empty())
            .map(|text| text.parse::<Code>().map_err(|what| Error::format(path, format!("row {row}"), what)))
            .transpose()?;
        let [x, y, score, xx, xy, yy, area_px, width, height, elevation_m] = values;
        let (Some(x), Some(y)) = (x, y) else {
            return Err(Error::format(path, format!("row {row}"), "x or y is empty"));
        };
        candidates.push(Candidate {
            centre: PixelPoint { x, y },
            covariance_px2: xx.zip(yy).map(|(xx, yy)| [xx, xy.unwrap_or(0.0), yy]),
            score,
            area_px,
            size_px: width.zip(height).map(|(w, h)| [w, h]),
            elevation_m,
            code,
            paint: None,
        });
    }
    Ok(candidates)
}

fn csv_error(path: &Path, error: &csv::Error) -> Error {
    match error.kind() {
        csv::ErrorKind::Io(e) => Error::io(path, "read", std::io::Error::new(e.kind(), e.to_string())),
        _ => {
            let row = error.position().map_or(1, csv::Position::line);
            Error::format(path, format!("row {row}"), error.to_string())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Candidate {
        Candidate {
            covariance_px2: Some([1e-4, -2.5e-5, 3e-4]),
            score: Some(17.25),
            area_px: Some(96.0),
            ..Candidate::at(PixelPoint { x: 12.345678901234, y: 0.1 + 0.2 })
        }
    }

    #[test]
    fn csv_reads_back_to_the_same_bits() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        write_csv(&[example()], file.as_file()).expect("writable");
        assert_eq!(read_csv(file.path()).expect("our own list"), vec![example()]);
        let plain = std::fs::read_to_string(file.path()).expect("our own list");
        assert!(!plain.contains(CODE), "no column for nothing");
        let coded = Candidate { code: Some(Code { family: "aruco-4x4-50".into(), number: 17 }), ..example() };
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        write_csv(&[example(), coded.clone()], file.as_file()).expect("writable");
        assert_eq!(read_csv(file.path()).expect("our own list"), vec![example(), coded.clone()]);
        let mut json = Vec::new();
        write_geojson(&[coded], &mut json).expect("writable");
        assert!(String::from_utf8_lossy(&json).contains("\"code\":\"aruco-4x4-50:17\""));
    }

    #[test]
    fn tables_of_spreadsheets_read_alike() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("list.csv");
        let wide: Vec<u8> =
            [0xFEFF].into_iter().chain("x;y\n1,5;2\n".encode_utf16()).flat_map(u16::to_le_bytes).collect();
        let tables: [&[u8]; 5] =
            [b"x,y\n1.5,2\n", b"sep=;\nx;y\n1,5;2\n", b"x,y\n\"1,5\",2\n", &wide, b"# H\xf6he\nx\ty\n1,5\t2\n"];
        for table in tables {
            std::fs::write(&path, table).expect("writable");
            let read = read_csv(&path).expect("a list");
            assert_eq!((read.len(), read[0].centre), (1, PixelPoint { x: 1.5, y: 2.0 }));
        }
        std::fs::write(&path, "x,y\n\"1,500\",2\n").expect("writable");
        assert!(read_csv(&path).expect_err("thousands or a decimal comma").to_string().contains("`1,500`"));
    }

    #[test]
    fn a_bad_number_names_its_row_and_column() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), "y,x\n1,2\n3,four\n").expect("writable");
        let message = read_csv(file.path()).expect_err("`four` is no number").to_string();
        assert!(message.contains("row 3") && message.contains("`four`") && message.contains("`x`"), "{message}");
    }
}
