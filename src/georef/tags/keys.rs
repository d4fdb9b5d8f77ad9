//! The GeoTIFF tags of a georeference (OGC 19-008r4, GeoTIFF 1.1).
//!
//! The transform is written here, to the last bit. The keys of the CRS come from GDAL, which knows every projection
//! method and compound systems: it makes a file of one pixel in memory, and its three tags are taken over.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

use gdal::raster::RasterCreationOptions;
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DatasetOptions, DriverManager, GdalOpenFlags, Metadata};

use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

pub const MODEL_PIXEL_SCALE: u16 = 33_550;
pub const INTERGRAPH_MATRIX: u16 = 33_920;
pub const MODEL_TIEPOINT: u16 = 33_922;
pub const MODEL_TRANSFORMATION: u16 = 34_264;
pub const GEO_KEY_DIRECTORY: u16 = 34_735;
pub const GEO_DOUBLE_PARAMS: u16 = 34_736;
pub const GEO_ASCII_PARAMS: u16 = 34_737;

/// Every tag that says where an image lies; all of them are replaced together.
pub const GEO_TAGS: [u16; 7] = [
    MODEL_PIXEL_SCALE,
    INTERGRAPH_MATRIX,
    MODEL_TIEPOINT,
    MODEL_TRANSFORMATION,
    GEO_KEY_DIRECTORY,
    GEO_DOUBLE_PARAMS,
    GEO_ASCII_PARAMS,
];

/// GTRasterTypeGeoKey.
const RASTER_TYPE_KEY: u16 = 1025;
const PIXEL_IS_POINT: u16 = 2;

/// Values of a tag, in no byte order yet.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    Shorts(Vec<u16>),
    Doubles(Vec<f64>),
    Ascii(Vec<u8>),
    Bytes(Vec<u8>),
    Longs(Vec<u32>),
    /// Numerators and denominators.
    Rationals(Vec<[u32; 2]>),
}

/// A tag to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct GeoTag {
    pub tag: u16,
    pub values: Values,
}

/// Whether map positions refer to pixel corners or centres.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RasterType {
    #[default]
    PixelIsArea,
    PixelIsPoint,
}

impl RasterType {
    /// What the values of a GeoKeyDirectory say. Area when they do not say.
    pub fn of_keys(directory: &[u64]) -> Self {
        let point = directory
            .get(4..)
            .unwrap_or_default()
            .chunks_exact(4)
            .any(|key| key == [u64::from(RASTER_TYPE_KEY), 0, 1, u64::from(PIXEL_IS_POINT)]);
        if point { RasterType::PixelIsPoint } else { RasterType::PixelIsArea }
    }
}

/// All tags of a georeference, in order of their numbers; and what is lost of the CRS, in words, when GeoTIFF keys
/// cannot hold all of it.
///
/// # Errors
/// When GDAL cannot put the CRS into GeoTIFF keys at all.
pub fn geo_tags(
    transform: &GeoTransform,
    crs: Option<&Crs>,
    raster_type: RasterType,
) -> Result<(Vec<GeoTag>, Option<String>)> {
    let mut tags = transform_tags(transform, raster_type);
    let (keys, lost) = crs_tags(crs, raster_type)?;
    tags.extend(keys);
    tags.sort_by_key(|tag| tag.tag);
    Ok((tags, lost))
}

/// Pixel scale and tie point when north is up, else the matrix.
fn transform_tags(transform: &GeoTransform, raster_type: RasterType) -> Vec<GeoTag> {
    let g = transform.0;
    let origin = match raster_type {
        RasterType::PixelIsArea => PixelPoint { x: 0.0, y: 0.0 },
        RasterType::PixelIsPoint => PixelPoint { x: 0.5, y: 0.5 },
    };
    let origin = transform.apply(origin);
    let doubles = |tag, values: &[f64]| GeoTag { tag, values: Values::Doubles(values.to_vec()) };
    if g[2] == 0.0 && g[4] == 0.0 && g[1] > 0.0 && g[5] < 0.0 {
        return vec![
            doubles(MODEL_PIXEL_SCALE, &[g[1], -g[5], 0.0]),
            doubles(MODEL_TIEPOINT, &[0.0, 0.0, 0.0, origin.easting, origin.northing, 0.0]),
        ];
    }
    let rows = [
        [g[1], g[2], 0.0, origin.easting],
        [g[4], g[5], 0.0, origin.northing],
        [0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ];
    vec![doubles(MODEL_TRANSFORMATION, rows.as_flattened())]
}

fn crs_tags(crs: Option<&Crs>, raster_type: RasterType) -> Result<(Vec<GeoTag>, Option<String>)> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    autoref_raster::initialise_gdal(0);
    let number = COUNTER.fetch_add(1, Ordering::Relaxed);
    let path = PathBuf::from(format!("/vsimem/autoref-keys-{}-{number}.tif", std::process::id()));
    let result = one_pixel(&path, crs, raster_type).and_then(|()| {
        let bytes = gdal::vsi::get_vsi_mem_file_bytes_owned(&path)?;
        // Taken out of the memory file system by the call above; put back for GDAL to read.
        gdal::vsi::create_mem_file(&path, bytes.clone())?;
        let lost = crs.map(|crs| lost(&path, crs)).transpose()?.flatten();
        Ok((bytes, lost))
    });
    for name in [path.clone(), PathBuf::from(format!("{}.aux.xml", path.display()))] {
        // The .aux.xml exists only for systems that the keys cannot hold.
        let _ = gdal::vsi::unlink_mem_file(&name);
    }
    let label = crs.map_or_else(|| "local coordinates".into(), |crs| crs.name().to_string());
    let (bytes, lost) = result.map_err(|e| Error::gdal(&path, format!("cannot put {label} into GeoTIFF keys: {e}")))?;
    if lost.as_deref() == Some("") {
        return Err(Error::usage(
            format!("GeoTIFF keys cannot hold the CRS {label}"),
            "use --write aux or vrt, or give --to-crs",
        ));
    }
    let tags = tags_of_memory(&bytes).ok_or_else(|| Error::gdal(&path, "its one-pixel file cannot be read"))?;
    Ok((tags, lost))
}

fn one_pixel(path: &std::path::Path, crs: Option<&Crs>, raster_type: RasterType) -> gdal::errors::Result<()> {
    let driver = DriverManager::get_driver_by_name("GTiff")?;
    let options = RasterCreationOptions::from_iter(["ENDIANNESS=LITTLE", "BIGTIFF=NO"]);
    let mut dataset = driver.create_with_band_type_with_options::<u8, _>(path, 1, 1, 1, &options)?;
    if raster_type == RasterType::PixelIsPoint {
        dataset.set_metadata_item("AREA_OR_POINT", "Point", "")?;
    }
    dataset.set_geo_transform(&[0.0, 1.0, 0.0, 0.0, 0.0, -1.0])?;
    if let Some(crs) = crs {
        dataset.set_projection(crs.wkt())?;
    }
    dataset.close()
}

/// What the keys lose of a CRS: nothing, all of it (an empty text), or something (in words).
fn lost(path: &std::path::Path, crs: &Crs) -> gdal::errors::Result<Option<String>> {
    // Without its .aux.xml.
    let options = DatasetOptions {
        open_flags: GdalOpenFlags::GDAL_OF_READONLY | GdalOpenFlags::GDAL_OF_RASTER,
        allowed_drivers: Some(&["GTiff"]),
        sibling_files: Some(&["none"]),
        ..Default::default()
    };
    let dataset = Dataset::open_ex(path, options)?;
    let read = dataset.projection();
    if read.is_empty() {
        return Ok(Some(String::new()));
    }
    let (asked, read) = (SpatialRef::from_wkt(crs.wkt())?, SpatialRef::from_wkt(&read)?);
    if asked == read {
        return Ok(None);
    }
    let name = |reference: &SpatialRef| reference.name().unwrap_or_default();
    Ok(Some(format!("GeoTIFF keys hold {} only as {}; add --write aux to keep it whole", name(&asked), name(&read))))
}

/// The three key tags of a small classic little-endian TIFF in memory.
fn tags_of_memory(bytes: &[u8]) -> Option<Vec<GeoTag>> {
    let u16_at = |at: usize| Some(u16::from_le_bytes(bytes.get(at..at + 2)?.try_into().ok()?));
    let u32_at = |at: usize| Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?) as usize);
    let directory = u32_at(4)?;
    let mut tags = Vec::new();
    for index in 0..usize::from(u16_at(directory)?) {
        let entry = directory + 2 + 12 * index;
        let (tag, count) = (u16_at(entry)?, u32_at(entry + 4)?);
        let value_bytes = match tag {
            GEO_KEY_DIRECTORY => 2,
            GEO_DOUBLE_PARAMS => 8,
            GEO_ASCII_PARAMS => 1,
            _ => continue,
        };
        let length = count.checked_mul(value_bytes)?;
        let at = if length <= 4 { entry + 8 } else { u32_at(entry + 8)? };
        let raw = bytes.get(at..at.checked_add(length)?)?;
        let values = match tag {
            GEO_KEY_DIRECTORY => {
                Values::Shorts(raw.chunks_exact(2).map(|v| u16::from_le_bytes([v[0], v[1]])).collect())
            }
            GEO_DOUBLE_PARAMS => Values::Doubles(
                raw.chunks_exact(8).map(|v| f64::from_le_bytes(v.try_into().expect("eight bytes"))).collect(),
            ),
            _ => Values::Ascii(raw.to_vec()),
        };
        tags.push(GeoTag { tag, values });
    }
    Some(tags)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn north_up_takes_scale_and_tie_point_and_all_else_the_matrix() {
        let up = GeoTransform([570_000.0, 0.03, 0.0, 7_032_000.0, 0.0, -0.03]);
        let tags = transform_tags(&up, RasterType::PixelIsPoint);
        assert_eq!(tags[0].values, Values::Doubles(vec![0.03, 0.03, 0.0]));
        assert_eq!(tags[1].values, Values::Doubles(vec![0.0, 0.0, 0.0, 570_000.015, 7_031_999.985, 0.0]));
        let turned = GeoTransform([570_000.0, 0.03, 0.01, 7_032_000.0, 0.01, -0.03]);
        assert_eq!(transform_tags(&turned, RasterType::PixelIsArea)[0].tag, MODEL_TRANSFORMATION);
        // South up: scales are positive by definition, so it takes the matrix.
        let south_up = GeoTransform([0.0, 0.03, 0.0, 0.0, 0.0, 0.03]);
        assert_eq!(transform_tags(&south_up, RasterType::PixelIsArea)[0].tag, MODEL_TRANSFORMATION);
    }

    #[test]
    fn keys_of_an_epsg_code_name_it() {
        let crs = Crs::from_epsg(25832).expect("known");
        let (tags, lost) = crs_tags(Some(&crs), RasterType::PixelIsPoint).expect("GDAL knows it");
        assert_eq!(lost, None);
        let Values::Shorts(keys) = &tags[0].values else { panic!("{tags:?}") };
        assert!(keys.chunks_exact(4).any(|key| key == [3072, 0, 1, 25832]), "{keys:?}");
        let numbers: Vec<u64> = keys.iter().map(|&v| u64::from(v)).collect();
        assert_eq!(RasterType::of_keys(&numbers), RasterType::PixelIsPoint);
    }
}
