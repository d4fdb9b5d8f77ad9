//! Tiles whose place an XML file tells: `tilemapresource.xml` of the Tile Map Service specification (OSGeo, version
//! 1.0.0), as Metashape, Pix4D and gdal2tiles write it.
//!
//! Tiles are `SET/COLUMN/ROW.EXT`, rows counted upwards. The set with the smallest pixels is the raster; the others are
//! its overviews. Tiles that are absent hold nothing.

use std::path::{Path, PathBuf};

use quick_xml::events::{BytesStart, Event};

use crate::bounded;
use crate::coords::GeoTransform;
use crate::error::{Error, Result};

/// What the file is called.
pub const NAME: &str = "tilemapresource.xml";
/// Half the side of the world in Web Mercator, metres.
const MERCATOR_M: f64 = 20_037_508.342_789_244;

/// What the XML says, of the set with the smallest pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct TileMap {
    /// Definition of the CRS; empty when none is named.
    pub crs: String,
    /// Lower left corner of the tile in column 0, row 0.
    origin: (f64, f64),
    tile_px: (u64, u64),
    extension: String,
    set: TileSet,
}

#[derive(Clone, Debug, Default, PartialEq)]
struct TileSet {
    href: String,
    units_per_pixel: f64,
    order: u32,
}

/// Whether the path is such a file.
pub fn is_tile_map(path: &Path) -> bool {
    path.is_file() && path.file_name().is_some_and(|name| name.eq_ignore_ascii_case(NAME))
}

impl TileMap {
    /// # Errors
    /// [`Error::Format`] naming the element that is missing or wrong.
    pub fn read(path: &Path) -> Result<TileMap> {
        let text = bounded::read_to_string(path, "a description of tiles", bounded::TEXT_BYTES)?;
        parse(&text).map_err(|(place, what)| Error::format(path, place, what))
    }

    /// The tiles that are there, with the transform of each, in order of their columns and rows.
    ///
    /// # Errors
    /// [`Error::Io`] when a folder cannot be listed, [`Error::Format`] when the set holds no tile.
    pub fn tiles(&self, path: &Path) -> Result<Vec<(PathBuf, GeoTransform)>> {
        let set = path.parent().unwrap_or(Path::new("")).join(&self.set.href);
        let mut tiles = Vec::new();
        for (column, folder) in numbered(&set, "")? {
            for (row, file) in numbered(&folder, &self.extension)? {
                tiles.push((file, self.transform(column, row)));
            }
        }
        if tiles.is_empty() {
            return Err(Error::format(path, "TileSet", format!("there is no tile in {}", set.display())));
        }
        Ok(tiles)
    }

    fn transform(&self, column: u64, row: u64) -> GeoTransform {
        let step = self.set.units_per_pixel;
        let west = self.origin.0 + (column * self.tile_px.0) as f64 * step;
        let north = self.origin.1 + ((row + 1) * self.tile_px.1) as f64 * step;
        GeoTransform([west, step, 0.0, north, 0.0, -step])
    }
}

/// Entries named by a number, with this extension (none: folders).
fn numbered(folder: &Path, extension: &str) -> Result<Vec<(u64, PathBuf)>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))? {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        let fits = match extension {
            "" => path.is_dir(),
            extension => path.extension().is_some_and(|e| e.eq_ignore_ascii_case(extension)),
        };
        let number = path.file_stem().and_then(|stem| stem.to_str()).and_then(|stem| stem.parse().ok());
        if let (true, Some(number)) = (fits, number) {
            found.push((number, path));
        }
    }
    found.sort();
    Ok(found)
}

type Wrong = (&'static str, String);

fn parse(text: &str) -> std::result::Result<TileMap, Wrong> {
    let mut reader = quick_xml::Reader::from_str(text);
    let (mut crs, mut in_srs) = (String::new(), false);
    let (mut origin, mut format, mut profile) = (None, None, String::new());
    let mut sets: Vec<TileSet> = Vec::new();
    loop {
        match reader.read_event().map_err(|e| ("XML", e.to_string()))? {
            Event::Start(e) | Event::Empty(e) => match e.local_name().as_ref() {
                "SRS" => in_srs = true,
                "Origin" => origin = Some((number(&e, "Origin", "x")?, number(&e, "Origin", "y")?)),
                "TileFormat" => {
                    let side = |name| number(&e, "TileFormat", name).map(|v| v as u64);
                    format = Some(((side("width")?, side("height")?), attribute(&e, "TileFormat", "extension")?));
                }
                "TileSets" => profile = attribute(&e, "TileSets", "profile").unwrap_or_default(),
                "TileSet" => sets.push(TileSet {
                    href: attribute(&e, "TileSet", "href")?,
                    units_per_pixel: number(&e, "TileSet", "units-per-pixel")?,
                    order: number(&e, "TileSet", "order").unwrap_or(0.0) as u32,
                }),
                _ => {}
            },
            Event::Text(words) if in_srs => crs.push_str(words.as_ref()),
            // WKT has quotation marks, and nothing else that XML escapes.
            Event::GeneralRef(entity) if in_srs && entity.as_ref() == "quot" => crs.push('"'),
            Event::End(e) if e.local_name().as_ref() == "SRS" => in_srs = false,
            Event::Eof => break,
            _ => {}
        }
    }
    let (tile_px, extension) = format.ok_or(("TileFormat", "there is none".into()))?;
    let smallest = sets.into_iter().min_by(|a, b| a.units_per_pixel.total_cmp(&b.units_per_pixel));
    let mut set = smallest.ok_or(("TileSet", "there is none".into()))?;
    if !(set.units_per_pixel > 0.0 && set.units_per_pixel.is_finite()) || tile_px.0 == 0 || tile_px.1 == 0 {
        return Err(("TileSet", "pixels and tiles have a size above 0".into()));
    }
    // The profiles that cover the world have a grid of their own, whatever the origin of the image in it.
    let origin = match profile.as_str() {
        "mercator" | "global-mercator" => {
            // Written rounded; over a world of columns that would be pixels.
            set.units_per_pixel = 2.0 * MERCATOR_M / tile_px.0 as f64 / 2f64.powi(set.order as i32);
            (-MERCATOR_M, -MERCATOR_M)
        }
        "geodetic" | "global-geodetic" => (-180.0, -90.0),
        _ => origin.ok_or(("Origin", "there is none".into()))?,
    };
    Ok(TileMap { crs: crs.trim().to_owned(), origin, tile_px, extension, set })
}

fn attribute(e: &BytesStart<'_>, element: &'static str, name: &str) -> std::result::Result<String, Wrong> {
    let found = e.try_get_attribute(name).map_err(|e| (element, e.to_string()))?;
    let value = found.ok_or_else(|| (element, format!("it has no `{name}`")))?;
    Ok(value.value.into_owned())
}

fn number(e: &BytesStart<'_>, element: &'static str, name: &str) -> std::result::Result<f64, Wrong> {
    let text = attribute(e, element, name)?;
    text.trim()
        .parse::<f64>()
        .ok()
        .filter(|v| v.is_finite())
        .ok_or_else(|| (element, format!("`{name}`: `{text}` is no number")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(profile: &str, sets: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?><TileMap version=\"1.0.0\"><Title>a</Title><SRS>EPSG:3857</SRS>\
             <Origin x=\"10.4\" y=\"63.5\"/><TileFormat width=\"256\" height=\"256\" extension=\"png\"/>\
             <TileSets profile=\"{profile}\">{sets}</TileSets></TileMap>"
        )
    }

    const SETS: &str = "<TileSet href=\"15\" units-per-pixel=\"4.77731426696777\" order=\"15\"/>\
                        <TileSet href=\"16\" units-per-pixel=\"2.38865713348389\" order=\"16\"/>";

    #[test]
    fn the_finest_set_has_its_place_in_the_world() {
        let map = parse(&of("mercator", SETS)).expect("whole");
        assert_eq!((map.set.href.as_str(), map.crs.as_str(), map.tile_px), ("16", "EPSG:3857", (256, 256)));
        // Column 34661 of 65536 is east of Greenwich by 1893 tiles.
        let g = map.transform(34_661, 32_768).0;
        let tile_m = 2.0 * MERCATOR_M / 65_536.0;
        assert!((g[0] - 1893.0 * tile_m).abs() < 1e-6 && (g[3] - tile_m).abs() < 1e-6, "{g:?}");
        let map = parse(&of("raster", SETS)).expect("whole");
        assert_eq!(map.transform(0, 0).0[3], 63.5 + 256.0 * 2.388_657_133_483_89);
    }

    #[test]
    fn what_is_missing_is_named() {
        for (text, words) in [
            (of("raster", ""), "TileSet"),
            (of("raster", "<TileSet href=\"1\" units-per-pixel=\"0\" order=\"1\"/>"), "TileSet"),
            (of("raster", "<TileSet units-per-pixel=\"1\" order=\"1\"/>"), "TileSet"),
            (of("raster", SETS).replace("extension", "ending"), "TileFormat"),
            (of("raster", SETS).replace("y=\"63.5\"", "y=\"north\""), "Origin"),
            (of("raster", SETS).replace("</TileSets>", ""), "XML"),
        ] {
            assert_eq!(parse(&text).map_err(|(place, _)| place), Err(words), "{text}");
        }
    }
}
