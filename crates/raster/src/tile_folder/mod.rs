//! A raster delivered as many tiles, each with its own georeference: one raster to us.
//!
//! A folder, a text file that names one tile a line, or the XML file of a tile map ([`tile_map`]). The tiles must have
//! the same bands, CRS and pixels, and lie a whole number of pixels from each other; their common transform may be
//! rotated, so that tiles that were georeferenced by this program still fit together. Where tiles overlap, the later
//! name wins.

use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use quick_xml::escape::escape;

pub mod tile_map;

use super::gdal::GdalName;
use crate::coords::{GeoTransform, PixelPoint};
use crate::error::{Error, Result};
use tile_map::TileMap;

/// What counts as a tile in a folder.
const EXTENSIONS: [&str; 12] = ["tif", "tiff", "jpg", "jpeg", "png", "jp2", "webp", "bmp", "img", "ecw", "asc", "bil"];
/// What counts as a list of tiles.
const LIST_EXTENSIONS: [&str; 2] = ["txt", "lst"];
/// World files are rounded; more than this many pixels off the common grid is another grid.
const OFF_GRID_PX: f64 = 0.05;

/// One tile and where it lies in the whole, in pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    pub path: PathBuf,
    pub x: u64,
    pub y: u64,
    pub width: u64,
    pub height: u64,
}

/// Tiles on one grid.
#[derive(Clone, Debug)]
pub struct TileFolder {
    /// The folder or list.
    pub path: PathBuf,
    pub tiles: Vec<Tile>,
    pub width: u64,
    pub height: u64,
    /// Of the whole, as the tiles say.
    pub geotransform: GeoTransform,
    crs_wkt: String,
    bands: Vec<Band>,
}

#[derive(Clone, Debug, PartialEq)]
struct Band {
    kind: String,
    colour: String,
    nodata: Option<String>,
}

/// A tile as its file says.
struct Opened {
    path: PathBuf,
    size: (u64, u64),
    geotransform: GeoTransform,
    crs_wkt: String,
    bands: Vec<Band>,
}

/// Whether a path is a folder or list of tiles rather than an image.
pub fn is_tile_folder(path: &Path) -> bool {
    path.is_dir() || (path.is_file() && has_extension(path, &LIST_EXTENSIONS)) || tile_map::is_tile_map(path)
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

impl TileFolder {
    /// Opens all tiles of a folder or list and lays them on one grid.
    ///
    /// # Errors
    /// When there are none, or one of them cannot be opened, has no georeference, or does not fit the first; the
    /// message names it.
    pub fn open(path: &Path) -> Result<TileFolder> {
        TileFolder::open_tiles(path).map_err(|error| match path.is_dir() {
            // Somebody may have meant a file in it.
            true => Error::format(path, "this directory as tiles of one raster", error.to_string()),
            false => error,
        })
    }

    fn open_tiles(path: &Path) -> Result<TileFolder> {
        super::initialise_gdal(0);
        let opened = open_all(path)?;
        let Some(first) = opened.first() else {
            return Err(Error::format(path, "tiles", "there are no image files"));
        };
        let mut places = Vec::with_capacity(opened.len());
        for tile in &opened {
            places.push(place(first, tile)?);
        }
        let west = places.iter().map(|p| p.0).min().unwrap_or(0);
        let north = places.iter().map(|p| p.1).min().unwrap_or(0);
        let corner = first.geotransform.apply(PixelPoint { x: west as f64, y: north as f64 });
        let g = first.geotransform.0;
        let tiles: Vec<Tile> = opened
            .iter()
            .zip(&places)
            .map(|(tile, (x, y))| Tile {
                path: tile.path.clone(),
                x: x.abs_diff(west),
                y: y.abs_diff(north),
                width: tile.size.0,
                height: tile.size.1,
            })
            .collect();
        let width = tiles.iter().map(|t| t.x + t.width).max().unwrap_or(0);
        let height = tiles.iter().map(|t| t.y + t.height).max().unwrap_or(0);
        let limit = i32::MAX as u64;
        if width > limit || height > limit {
            let what = format!("the tiles span {width} × {height} pixels; some of them belong elsewhere");
            return Err(Error::format(path, "tiles", what));
        }
        Ok(TileFolder {
            path: path.to_path_buf(),
            tiles,
            width,
            height,
            geotransform: GeoTransform([corner.easting, g[1], g[2], corner.northing, g[4], g[5]]),
            crs_wkt: first.crs_wkt.clone(),
            bands: first.bands.clone(),
        })
    }

    /// The transform of a tile when the whole has `transform`.
    pub fn transform_of(tile: &Tile, transform: &GeoTransform) -> GeoTransform {
        let g = transform.0;
        let corner = transform.apply(PixelPoint { x: tile.x as f64, y: tile.y as f64 });
        GeoTransform([corner.easting, g[1], g[2], corner.northing, g[4], g[5]])
    }

    /// A virtual raster of the whole in GDAL's memory file system, which lives as long as the process.
    ///
    /// # Errors
    /// When GDAL's memory file system refuses it.
    pub fn virtual_file(&self) -> Result<PathBuf> {
        static COUNTER: AtomicU64 = AtomicU64::new(0);
        let number = COUNTER.fetch_add(1, Ordering::Relaxed);
        let name = PathBuf::from(format!("/vsimem/autoref-tiles-{}-{number}.vrt", std::process::id()));
        gdal::vsi::create_mem_file(&name, self.xml().into_bytes()).map_err(|e| Error::gdal(&self.path, e))?;
        Ok(name)
    }

    fn xml(&self) -> String {
        let mut out = format!("<VRTDataset rasterXSize=\"{}\" rasterYSize=\"{}\">\n", self.width, self.height);
        let mut line = |text: String| writeln!(out, "{text}").expect("a string takes all writes");
        if !self.crs_wkt.is_empty() {
            // Eastings first, as GDAL's tiles give them.
            line(format!("  <SRS dataAxisToSRSAxisMapping=\"{}\">{}</SRS>", self.axes(), escape(&self.crs_wkt)));
        }
        let numbers = self.geotransform.0.map(|v| format!("{v:.17e}")).join(", ");
        line(format!("  <GeoTransform>{numbers}</GeoTransform>"));
        for (number, band) in (1..).zip(&self.bands) {
            line(format!("  <VRTRasterBand dataType=\"{}\" band=\"{number}\">", band.kind));
            line(format!("    <ColorInterp>{}</ColorInterp>", band.colour));
            if let Some(value) = &band.nodata {
                line(format!("    <NoDataValue>{value}</NoDataValue>"));
            }
            for tile in &self.tiles {
                let size = format!("xSize=\"{}\" ySize=\"{}\"", tile.width, tile.height);
                line(format!(
                    "    <SimpleSource><SourceFilename relativeToVRT=\"0\">{}</SourceFilename>\
                     <SourceBand>{number}</SourceBand>\
                     <SourceProperties RasterXSize=\"{}\" RasterYSize=\"{}\" DataType=\"{}\" />\
                     <SrcRect xOff=\"0\" yOff=\"0\" {size} /><DstRect xOff=\"{}\" yOff=\"{}\" {size} /></SimpleSource>",
                    escape(tile.path.to_string_lossy().as_ref()),
                    tile.width,
                    tile.height,
                    band.kind,
                    tile.x,
                    tile.y,
                ));
            }
            line("  </VRTRasterBand>".into());
        }
        line("</VRTDataset>".into());
        out
    }

    fn axes(&self) -> &'static str {
        crate::crs::Crs::parse(&self.crs_wkt).map_or("1,2", |crs| crate::crs::axis_mapping(&crs))
    }
}

/// All tiles of a folder, a list or a tile map.
fn open_all(path: &Path) -> Result<Vec<Opened>> {
    let xml = if path.is_dir() { path.join(tile_map::NAME) } else { path.to_path_buf() };
    if tile_map::is_tile_map(&xml) {
        let map = TileMap::read(&xml)?;
        let crs_wkt = match map.crs.as_str() {
            "" => String::new(),
            definition => crate::crs::Crs::parse(definition)?.wkt().to_owned(),
        };
        let open = |(file, geotransform): (PathBuf, GeoTransform)| {
            let file = std::fs::canonicalize(&file).map_err(|e| Error::io(&file, "resolve", e))?;
            let dataset = GdalName::new(&file, 0).open()?;
            described(file, &dataset, geotransform, crs_wkt.clone())
        };
        return map.tiles(&xml)?.into_iter().map(open).collect();
    }
    let names = if path.is_dir() { in_folder(path)? } else { in_list(path)? };
    names.into_iter().map(open_tile).collect()
}

fn in_folder(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list", e))? {
        let path = entry.map_err(|e| Error::io(folder, "list", e))?.path();
        let hidden = path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
        if !hidden && path.is_file() && has_extension(&path, &EXTENSIONS) {
            names.push(std::fs::canonicalize(&path).map_err(|e| Error::io(&path, "resolve", e))?);
        }
    }
    names.sort();
    Ok(names)
}

fn in_list(list: &Path) -> Result<Vec<PathBuf>> {
    let text = crate::bounded::read_to_string(list, "a list of tiles", crate::bounded::TEXT_BYTES)?;
    let folder = list.parent().unwrap_or(Path::new(""));
    let mut names = Vec::new();
    for (number, line) in (1..).zip(text.trim_start_matches('\u{feff}').lines()) {
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let path = folder.join(line);
        if !path.is_file() {
            let what = format!("there is no file `{line}`; a list of tiles names one a line");
            return Err(Error::format(list, format!("line {number}"), what));
        }
        names.push(std::fs::canonicalize(&path).map_err(|e| Error::io(&path, "resolve", e))?);
    }
    Ok(names)
}

/// A tile that tells its place itself.
fn open_tile(path: PathBuf) -> Result<Opened> {
    let dataset = GdalName::new(&path, 0).open()?;
    let Ok(geotransform) = dataset.geo_transform() else {
        let what = "it has no georeference of its own (tags, world file or .aux.xml), so its place is unknown";
        return Err(Error::unsupported(
            path,
            format!("as a tile: {what}"),
            "list the tiles in a text file, one a line",
        ));
    };
    let crs_wkt = dataset.projection();
    described(path, &dataset, GeoTransform(geotransform), crs_wkt)
}

/// A tile whose place is known.
fn described(path: PathBuf, dataset: &::gdal::Dataset, geotransform: GeoTransform, crs_wkt: String) -> Result<Opened> {
    let (width, height) = dataset.raster_size();
    let mut bands = Vec::new();
    for number in 1..=dataset.raster_count() {
        let band = dataset.rasterband(number).map_err(|e| Error::gdal(&path, e))?;
        let nodata = band.no_data_value().map(|v| if v.is_nan() { "nan".into() } else { v.to_string() });
        bands.push(Band { kind: band.band_type().name(), colour: band.color_interpretation().name(), nodata });
    }
    let size = (width as u64, height as u64);
    Ok(Opened { path, size, geotransform, crs_wkt, bands })
}

/// Columns and rows from the first tile's corner to this one's.
fn place(first: &Opened, tile: &Opened) -> Result<(i64, i64)> {
    let differs = |what: &str| {
        let other = first.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let remedy = "give a folder or list with the tiles of one raster only";
        Err(Error::unsupported(&tile.path, format!("as a tile beside {other}: {what}"), remedy))
    };
    if tile.bands != first.bands {
        return differs("it has other bands or nodata values");
    }
    if tile.crs_wkt != first.crs_wkt {
        return differs("it has another CRS");
    }
    let (a, b) = (first.geotransform.0, tile.geotransform.0);
    // Over the tile's whole width, the pixels must not drift off the grid.
    let reach = tile.size.0.max(tile.size.1) as f64;
    let drift = [1, 2, 4, 5].iter().map(|&i| (a[i] - b[i]).abs() * reach).fold(0.0, f64::max);
    let Some(corner) = first.geotransform.invert(tile.geotransform.apply(PixelPoint { x: 0.0, y: 0.0 })) else {
        return differs("the transform of that one has no inverse");
    };
    if drift > OFF_GRID_PX * first.geotransform.scale() {
        return differs("its pixels are of another size or direction");
    }
    let (x, y) = (corner.x.round(), corner.y.round());
    if (corner.x - x).abs() > OFF_GRID_PX || (corner.y - y).abs() > OFF_GRID_PX {
        let off = format!("it lies {:.3} columns and {:.3} rows from it, no whole number", corner.x, corner.y);
        return differs(&off);
    }
    if x.abs().max(y.abs()) > f64::from(i32::MAX) {
        return differs("it lies too far away");
    }
    Ok((x as i64, y as i64))
}
