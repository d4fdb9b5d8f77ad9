//! The format of a list follows from its content, and from its name where the content leaves it open.

use std::io::Read;
use std::path::Path;

use crate::gcp::list_format::ListFormat;
use crate::gcp::raw::RawList;
use crate::gcp::text::LARGEST_LIST_BYTES;
use crate::gcp::{csv_list, geojson, idx, instruments, kof, odm, ogr, qgis, text, titled, tracks, xml};
use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};

/// Of which a list may be chosen by name.
const MOST_ROWS: usize = 50_000;
/// Ends of names that are GDAL's.
const OGR: [&str; 18] = [
    "gpkg", "shp", "shz", "zip", "kml", "kmz", "gpx", "gml", "fgb", "dxf", "tab", "mif", "sqlite", "xlsx", "xls",
    "ods", "gdb", "dbf",
];

/// The list as it is, and the format it was read as.
pub(super) fn parse(path: &Path, layer: Option<&str>, from: Option<ListFormat>) -> Result<(RawList, ListFormat)> {
    bounded::refuse_endless(path)?;
    let is_text = from.is_none_or(ListFormat::is_text);
    // Programs name their tables of text `.xls` too, so that Excel opens them.
    let is_of_ogr = |end: &str| OGR.contains(&end) && (end != "xls" || ogr::is_old_workbook(path));
    if is_text && layer.is_none() && !path.is_dir() && !is_of_ogr(&extension(path)) {
        refuse_many(path)?;
        let bytes = bounded::read(path, "a list of points", LARGEST_LIST_BYTES)?;
        if let Some(text) = text::decode(&bytes) {
            // JSON and XML need no lines.
            if !text.trim_start().starts_with(['{', '[', '<']) {
                text::refuse_long_rows(path, &text)?;
            }
            let format = from.unwrap_or_else(|| recognised(path, &text));
            if format.is_text() {
                return Ok((parse_as(path, &text, format)?, format));
            }
        }
    }
    std::fs::metadata(path).map_err(|e| Error::io(path, "read", e))?;
    Ok((ogr::parse(path, layer)?, from.filter(|f| !f.is_text()).unwrap_or_else(|| ListFormat::of_vectors(path))))
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// The format of a text, by its content and then by its name.
fn recognised(path: &Path, text: &str) -> ListFormat {
    let start = text.trim_start();
    let extension = extension(path);
    if matches!(extension.as_str(), "geojson" | "json") || start.starts_with('{') {
        return ListFormat::GeoJson;
    }
    if let Some(format) = instruments::recognised(&extension, text) {
        return format;
    }
    if start.starts_with('<') {
        return match xml::dialect(start) {
            Some(xml::Dialect::Metashape) => ListFormat::MetashapeXml,
            Some(xml::Dialect::MicMac) => ListFormat::MicMac,
            None => ListFormat::of_vectors(path),
        };
    }
    if extension == "kof" {
        return ListFormat::Kof;
    }
    let lines = text::lines(text);
    if extension == "points" || qgis::is_points(&lines) {
        return ListFormat::Qgis;
    }
    let content: Vec<text::Line<'_>> = lines.iter().skip_while(|line| line.is_comment()).copied().collect();
    // "WGS84 Latitude,WGS84 Longitude" begins as the name of a CRS does.
    let is_wkt = |line: &text::Line<'_>| line.text.contains("[\"");
    let has_titles = content.first().is_some_and(|first| !is_wkt(first) && titled::is_header(*first));
    let has_crs = content.first().is_some_and(|first| odm::is_crs_line(first.text));
    if !has_titles && (has_crs || odm::has_observations(&content)) {
        return ListFormat::Odm;
    }
    ListFormat::Csv
}

fn parse_as(path: &Path, text: &str, format: ListFormat) -> Result<RawList> {
    let lines = text::lines(text);
    let content = || lines.iter().skip_while(|line| line.is_comment()).copied().collect::<Vec<_>>();
    if let Some(list) = instruments::parse(path, text, &lines, format) {
        return list;
    }
    match format {
        ListFormat::GeoJson => geojson::parse(path, text),
        ListFormat::MetashapeXml => xml::parse(path, text, xml::Dialect::Metashape),
        ListFormat::MicMac => xml::parse(path, text, xml::Dialect::MicMac),
        ListFormat::Kof => kof::parse(path, text),
        ListFormat::Qgis => qgis::parse(path, &lines),
        ListFormat::Odm if content().is_empty() => {
            Err(Error::format(path, "row 1", "the file holds no points; a CRS and one line for each are expected"))
        }
        ListFormat::Odm => odm::parse(path, &content()),
        ListFormat::Pix4d => csv_list::parse_pix4d(path, &lines),
        _ => {
            tracks::refuse(path, &lines)?;
            idx::parse(path, &lines).unwrap_or_else(|| csv_list::parse(path, &lines))
        }
    }
}

/// What begins a point in a text of one kind.
fn beginnings(first: u8) -> &'static [&'static [u8]] {
    match first {
        b'{' => &[b"\"geometry\""],
        b'<' => &[b"<OneAppuisDAF>", b"<marker id", b"<Placemark", b"<wpt ", b"<CgPoint ", b"<PointRecord"],
        _ => &[b"\n"],
    }
}

/// Each row or feature costs hundreds of bytes when it is read, so that they are counted before, in pieces.
fn refuse_many(path: &Path) -> Result<()> {
    const PIECE_BYTES: usize = 1 << 16;
    /// Titles and remarks.
    const HEAD_ROWS: usize = 20;
    if path.is_dir() {
        return Ok(());
    }
    let mut file = std::fs::File::open(path).map_err(|e| Error::io(path, "read", e))?;
    let mut piece = vec![0; PIECE_BYTES];
    let (mut kept, mut rows, mut kind) = (0, 0, None);
    loop {
        let read = file.read(&mut piece[kept..]).map_err(|e| Error::io(path, "read", e))?;
        if read == 0 {
            break;
        }
        let bytes = &piece[..kept + read];
        if kind.is_none() && bytes.contains(&0) && !matches!(bytes, [0xFF, 0xFE, ..] | [0xFE, 0xFF, ..]) {
            return Ok(()); // no text: GDAL's
        }
        let first = || bytes.iter().find(|b| b.is_ascii_graphic()).copied().unwrap_or(b'\n');
        let words = *kind.get_or_insert_with(|| beginnings(first()));
        for word in words {
            rows += bytes.windows(word.len()).filter(|window| window == word).count();
        }
        // A word may lie across two pieces; one that ends in what is kept was counted.
        let longest = words.iter().map(|word| word.len()).max().unwrap_or(1);
        let tail = bytes.len().min(longest - 1);
        let from = bytes.len() - tail;
        let again = words.iter().map(|word| bytes[from..].windows(word.len()).filter(|window| window == word).count());
        rows -= again.sum::<usize>();
        piece.copy_within(from..from + tail, 0);
        kept = tail;
    }
    if rows <= MOST_ROWS + HEAD_ROWS {
        return Ok(());
    }
    Err(Error::unsupported(
        path,
        format!("a list of {rows} rows; at most {MOST_ROWS} are read"),
        "cut the list to the area of the image",
    ))
}
