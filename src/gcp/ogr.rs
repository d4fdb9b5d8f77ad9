//! GCPs in whatever GDAL's vector library (OGR) opens: GeoPackage, Shapefile (also zipped), KML, GPX, GML, DXF, and
//! tables of a spreadsheet.

use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};

use gdal::vector::{Feature, Geometry, LayerAccess, OGRwkbGeometryType, geometry_type_flatten, geometry_type_has_z};
use gdal::{Dataset, DatasetOptions, GdalOpenFlags};

use crate::gcp::attributes::{self, Told};
use crate::gcp::raw::{CrsClaim, RawList, RawPoint};
use crate::gcp::{dxf, sheet};
use autoref_raster::crs::Crs;
use autoref_raster::error::{Error, Result};

pub(super) fn parse(path: &Path, wanted: Option<&str>) -> Result<RawList> {
    autoref_raster::initialise_gdal(0);
    sheet::with_bare_cells(|| read(path, wanted))
}

/// Whether the file begins as Excel's workbooks of before 2007 do (an OLE2 container).
pub(super) fn is_old_workbook(path: &Path) -> bool {
    const OLE2: [u8; 8] = [0xD0, 0xCF, 0x11, 0xE0, 0xA1, 0xB1, 0x1A, 0xE1];
    let mut begin = [0; OLE2.len()];
    std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut begin)).is_ok() && begin == OLE2
}

fn unreadable(path: &Path) -> Error {
    if is_old_workbook(path) {
        return Error::unsupported(path, "an old Excel workbook that GDAL cannot read", "save it as .xlsx or as CSV");
    }
    Error::unsupported(
        path,
        "no list of points that this program or GDAL's OGR reads",
        "give GeoJSON, CSV, KOF, GeoPackage, Shapefile, KML, GPX or an OpenDroneMap list",
    )
}

fn read(path: &Path, wanted: Option<&str>) -> Result<RawList> {
    let zipped = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("zip"));
    // Put before the path, not joined to it: an absolute one would stand alone.
    let in_zip = || {
        let mut name = OsString::from("/vsizip/");
        name.push(path);
        PathBuf::from(name)
    };
    let name = if zipped { in_zip() } else { path.to_path_buf() };
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("kml")) {
        // GDAL holds the whole text.
        autoref_raster::bounded::read(path, "a list", super::text::LARGEST_LIST_BYTES)?;
    }
    let flags = GdalOpenFlags::GDAL_OF_VECTOR | GdalOpenFlags::GDAL_OF_READONLY;
    let open_options = autoref_raster::vector_options(path);
    let options = DatasetOptions { open_flags: flags, open_options, ..Default::default() };
    let dataset = dxf::with_blocks_whole(|| Dataset::open_ex(&name, options)).map_err(|_| unreadable(path))?;
    let driver = dataset.driver().short_name();
    let is_drawing = driver == "DXF";
    let wanted_layer = wanted.filter(|name| !name.eq_ignore_ascii_case(dxf::ENTITIES));
    let titles_of_sheets = sheet::Titles::of(&driver);
    if wanted.is_none()
        && titles_of_sheets == sheet::Titles::Rows
        && let Some(list) = sheet::only_one_with_points(path, &dataset)
    {
        return Ok(list);
    }
    let index = layer(path, &dataset, if is_drawing { Some(dxf::ENTITIES) } else { wanted })?;
    let mut layer = dataset.layer(index).map_err(|e| Error::gdal(path, e))?;
    let crs = match layer.spatial_ref().and_then(|reference| reference.to_wkt().ok()) {
        Some(wkt) if !wkt.is_empty() && !is_undefined(&wkt) => CrsClaim::Known(Crs::parse(&wkt)?),
        _ => CrsClaim::None,
    };
    if is_drawing {
        return dxf::read(path, &mut layer, crs, wanted_layer);
    }
    let titles: Vec<String> = layer.defn().fields().map(|field| field.name()).collect();
    if layer.defn().geometry_type() == OGRwkbGeometryType::wkbNone {
        return sheet::parse(path, &mut layer, titles_of_sheets);
    }
    let (mut points, mut told) = (Vec::new(), Told::default());
    for (i, feature) in layer.features().enumerate() {
        // GDAL hands out a geometry without a name where there is none.
        let geometry = feature.geometry().filter(|geometry| !geometry.geometry_name().is_empty());
        let Some(geometry) = geometry else {
            told.no_point(i + 1, "no geometry");
            continue;
        };
        let Some(at) = only_point(geometry) else {
            if geometry_type_flatten(geometry.geometry_type()) == OGRwkbGeometryType::wkbMultiPoint {
                return Err(attributes::no_single_point(path, i + 1));
            }
            told.no_point(i + 1, geometry.geometry_name());
            continue;
        };
        let (mut point, title) = point(path, i + 1, &feature, at, &titles, &mut told)?;
        told.height(&point, title);
        point.attributes.retain(|(title, _)| !columns_of_driver(&driver).contains(&title.as_str()));
        points.push(point);
    }
    let mut list = RawList::new(points, crs);
    told.tell(path, &mut list)?;
    Ok(list)
}

/// Columns that a driver of GDAL's has of every file: how a viewer shows a place, an identifier of the element. Nobody
/// wrote them about the point.
fn columns_of_driver(driver: &str) -> &'static [&'static str] {
    match driver {
        "KML" | "LIBKML" => &["tessellate", "extrude", "visibility", "drawOrder", "icon"],
        "GML" => &["gml_id"],
        _ => &[],
    }
}

/// What GeoPackage has for coordinates of no known system, and GDAL hands out as one.
fn is_undefined(wkt: &str) -> bool {
    ["Undefined geographic SRS", "Undefined Cartesian SRS"].iter().any(|name| wkt.contains(name))
}

/// The layer that is named, or the only one with points; of GPX's the waypoints.
fn layer(path: &Path, dataset: &Dataset, wanted: Option<&str>) -> Result<usize> {
    let names: Vec<String> = dataset.layers().map(|layer| layer.name()).collect();
    let listed = || names.join(", ");
    if let Some(wanted) = wanted {
        return names.iter().position(|name| name.eq_ignore_ascii_case(wanted)).ok_or_else(|| {
            Error::usage(format!("{}: there is no layer `{wanted}`", path.display()), format!("it has {}", listed()))
        });
    }
    let kinds: Vec<(bool, u64)> = dataset
        .layers()
        .map(|layer| {
            let kind = geometry_type_flatten(layer.defn().geometry_type());
            let may = matches!(
                kind,
                OGRwkbGeometryType::wkbPoint | OGRwkbGeometryType::wkbMultiPoint | OGRwkbGeometryType::wkbUnknown
            ) || layer.defn().geometry_type() == OGRwkbGeometryType::wkbNone;
            (may, layer.feature_count())
        })
        .collect();
    if let Some(waypoints) = names.iter().position(|name| name == "waypoints").filter(|i| kinds[*i].1 > 0) {
        return Ok(waypoints);
    }
    let filled: Vec<usize> = (0..names.len()).filter(|&i| kinds[i].0 && kinds[i].1 > 0).collect();
    match filled.as_slice() {
        [one] => Ok(*one),
        [] => Err(Error::format(path, "the file", format!("no layer with points; it has {}", listed()))),
        _ => Err(Error::usage(
            format!("{}: several layers hold points: {}", path.display(), listed()),
            "name one with --gcp-layer",
        )),
    }
}

/// Easting, northing and, where it has one, height of a point, or of the only point of several.
fn only_point(geometry: &Geometry) -> Option<(f64, f64, Option<f64>)> {
    let (x, y, z) = match geometry_type_flatten(geometry.geometry_type()) {
        OGRwkbGeometryType::wkbPoint if !geometry.is_empty() => geometry.get_point(0),
        OGRwkbGeometryType::wkbMultiPoint if geometry.geometry_count() == 1 => geometry.get_geometry(0).get_point(0),
        _ => return None,
    };
    Some((x, y, geometry_type_has_z(geometry.geometry_type()).then_some(z)))
}

fn point(
    path: &Path,
    number: usize,
    feature: &Feature<'_>,
    (x, y, z): (f64, f64, Option<f64>),
    titles: &[String],
    told: &mut Told,
) -> Result<(RawPoint, Option<String>)> {
    let own = attributes::fields(feature);
    let place = format!("feature {number}");
    let (mut point, title) = attributes::point(path, place, (titles, &own), (x, y), &number.to_string(), told)?;
    if z.is_none() {
        return Ok((point, title));
    }
    point.gcp.height = z;
    Ok((point, None))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ZIP file of one file, stored as it is (PKWARE, APPNOTE.TXT 6.3.3).
    fn zip_of(name: &str, content: &[u8]) -> Vec<u8> {
        let crc = content.iter().fold(u32::MAX, |crc, byte| {
            (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg()))
        });
        let (size, length) = ((content.len() as u32).to_le_bytes(), (name.len() as u16).to_le_bytes());
        let facts =
            [&[20, 0, 0, 0, 0, 0, 0, 0, 0, 0][..], &(!crc).to_le_bytes(), &size, &size, &length, &[0, 0]].concat();
        let local = [&b"PK\x03\x04"[..], &facts, name.as_bytes(), content].concat();
        let central = [&b"PK\x01\x02\x14\0"[..], &facts, &[0; 14], name.as_bytes()].concat();
        let (from, long) = ((local.len() as u32).to_le_bytes(), (central.len() as u32).to_le_bytes());
        let end = [&b"PK\x05\x06\0\0\0\0\x01\0\x01\0"[..], &long, &from, &[0, 0]].concat();
        [local, central, end].concat()
    }

    #[test]
    fn columns_that_only_the_driver_has_are_no_attributes() {
        let folder = tempfile::tempdir().expect("a folder");
        let kml = r#"<?xml version="1.0"?><kml xmlns="http://www.opengis.net/kml/2.2"><Document><name>points</name>
            <Placemark><name>P1</name><visibility>1</visibility><ExtendedData><Data name="kind"><value>nail</value></Data>
            </ExtendedData><Point><extrude>1</extrude><coordinates>10.5,63.25,12</coordinates></Point></Placemark>
            </Document></kml>"#;
        let gml = r#"<?xml version="1.0"?><ogr:FeatureCollection gml:id="all" xmlns:ogr="http://ogr.maptools.org/"
            xmlns:gml="http://www.opengis.net/gml/3.2"><ogr:featureMember><ogr:points gml:id="points.0">
            <ogr:geometryProperty><gml:Point srsName="urn:ogc:def:crs:EPSG::25832" gml:id="points.geom.0">
            <gml:pos>500000 6600000</gml:pos></gml:Point></ogr:geometryProperty><ogr:name>P1</ogr:name>
            <ogr:kind>nail</ogr:kind></ogr:points></ogr:featureMember></ogr:FeatureCollection>"#;
        for (name, text) in [("a.kml", kml), ("b.gml", gml)] {
            let path = folder.path().join(name);
            std::fs::write(&path, text).expect("writable");
            let list = parse(&path, None).expect("a list");
            let titles: Vec<&str> = list.points[0].attributes.iter().map(|(title, _)| title.as_str()).collect();
            let of_driver = ["tessellate", "extrude", "visibility", "drawOrder", "icon", "gml_id"];
            assert!(!titles.iter().any(|title| of_driver.contains(title)), "{name}: {titles:?}");
            assert_eq!(list.points[0].gcp.name, "P1", "{name}");
        }
    }

    /// By its whole path, as by a relative one.
    #[test]
    fn lists_in_zip_files_are_read() {
        let folder = tempfile::tempdir().expect("a folder");
        let zip = folder.path().join("points.zip");
        let text = r#"{"type":"FeatureCollection","features":[{"type":"Feature","properties":{"name":"P1"},
            "geometry":{"type":"Point","coordinates":[10.5,63.25]}}]}"#;
        std::fs::write(&zip, zip_of("points.geojson", text.as_bytes())).expect("writable");
        assert!(zip.is_absolute());
        assert_eq!(parse(&zip, None).expect("a list").points.len(), 1);
    }
}
