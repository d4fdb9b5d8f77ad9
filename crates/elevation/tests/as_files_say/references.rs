//! Where files say that their cells lie: zones without a reference system, units that say nothing, longitudes counted
//! from elsewhere; and how much of a zone two models cover.

use std::path::{Path, PathBuf};

use autoref_elevation::align::{Degree, Method, Outcome};
use autoref_elevation::files::{AlignJob, read_zones};
use gdal::raster::Buffer;
use gdal::spatial_ref::SpatialRef;
use gdal::vector::{FieldDefn, Geometry, LayerAccess, LayerOptions, OGRFieldType, OGRwkbGeometryType};
use gdal::{DriverManager, Metadata};

use super::{compare, resources};

const SIDE: usize = 80;

/// Hills, so much higher; the north-western corner and the side of a cell in the units of the CRS.
fn model(path: &Path, crs: &str, (west, north, cell): (f64, f64, f64), higher_m: f32) -> PathBuf {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
    let mut set = driver.create_with_band_type::<f32, _>(path, SIDE, SIDE, 1).expect("a file");
    set.set_geo_transform(&[west, cell, 0.0, north, 0.0, -cell]).expect("a place");
    set.set_spatial_ref(&SpatialRef::from_definition(crs).expect("PROJ knows it")).expect("a CRS");
    let height = |i: usize| {
        let (x, y) = ((i % SIDE) as f32, (i / SIDE) as f32);
        300.0 + 60.0 * (x / 11.0).sin() * (y / 14.0).cos() + 25.0 * (x / 5.0 + y / 7.0).sin() + higher_m
    };
    let values = (0..SIDE * SIDE).map(height).collect();
    let mut buffer = Buffer::new((SIDE, SIDE), values);
    set.rasterband(1).expect("a band").write((0, 0), (SIDE, SIDE), &mut buffer).expect("written");
    path.to_path_buf()
}

/// A GeoPackage with one square of a kilometre from 500,400 and 8,699,500 to the north-east, in the given system.
fn zones(path: &Path, reference: Option<&SpatialRef>, kind: OGRwkbGeometryType::Type, wkt: &str) -> PathBuf {
    let driver = DriverManager::get_driver_by_name("GPKG").expect("a driver");
    let mut set = driver.create_vector_only(path).expect("a file");
    let options = LayerOptions { name: "zones", srs: reference, ty: kind, options: None };
    let mut layer = set.create_layer(options).expect("a layer");
    FieldDefn::new("name", OGRFieldType::OFTString).and_then(|field| field.add_to_layer(&layer)).expect("a field");
    layer.create_feature(Geometry::from_wkt(wkt).expect("a geometry")).expect("written");
    drop(set);
    path.to_path_buf()
}

const SQUARE: &str = "POLYGON((500400 8699500,501400 8699500,501400 8700500,500400 8700500,500400 8699500))";

/// GeoPackages without a system name an undefined one; that of a building site lies nowhere.
#[test]
fn zones_of_no_system_lie_where_their_numbers_say() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let site = SpatialRef::from_definition(
        "ENGCRS[\"site\",EDATUM[\"peg\"],CS[Cartesian,2],AXIS[\"(E)\",east,\
        ORDER[1],LENGTHUNIT[\"metre\",1]],AXIS[\"(N)\",north,ORDER[2],LENGTHUNIT[\"metre\",1]]]",
    );
    let site = site.expect("PROJ knows it");
    let kind = OGRwkbGeometryType::wkbPolygon;
    let of_none = zones(&at("none.gpkg"), None, kind, SQUARE);
    let of_site = zones(&at("site.gpkg"), Some(&site), kind, SQUARE);
    let a = model(&at("a.tif"), "EPSG:32633", (500_000.0, 8_700_000.0, 10.0), 3.0);
    let b = model(&at("b.tif"), "EPSG:32633", (500_000.0, 8_700_000.0, 10.0), 0.0);
    for (name, zones) in [("none", of_none), ("site", of_site)] {
        let found = compare(&a, &b, Some(&zones), &at(name));
        let volume = &found.volumes[0];
        // 400 m by 500 m of the square lie on both models.
        assert_eq!(volume.n, 40 * 50, "{name}");
        assert!((volume.zone_area_m2 / 1e6 - 1.0).abs() < 1e-9, "{name}: {}", volume.zone_area_m2);
        assert!(volume.covered_share.is_some_and(|share| (share - 0.2).abs() < 1e-9), "{:?}", volume.covered_share);
        let table = std::fs::read_to_string(at(name).join("volumes.csv")).expect("written");
        assert!(table.lines().next().is_some_and(|head| head.ends_with(",zone_area_m2,covered_share")), "{table}");
    }
    let open = "LINESTRING(500400 8699500,501400 8700000,501400 8700500)";
    let two = "MULTILINESTRING((0 0,10 0,10 10),(50 50,60 50,60 60))";
    for (name, wkt) in [("lines.gpkg", open), ("two_lines.gpkg", two)] {
        let lines = zones(&at(name), None, OGRwkbGeometryType::wkbUnknown, wkt);
        let refused = read_zones(&lines, "", [0.0; 4]).expect_err("no polygon").to_string();
        assert!(refused.contains("lines.gpkg") && refused.contains("make polygons of its lines"), "{refused}");
    }
    let closed = SQUARE.replace("POLYGON((", "LINESTRING(").replace("))", ")");
    let closed = zones(&at("closed.gpkg"), None, OGRwkbGeometryType::wkbUnknown, &closed);
    assert!(read_zones(&closed, "", [0.0; 4]).is_ok(), "a closed line is a polygon");
}

/// Models across 180°, zones and lines on its far side: by longitudes of either kind, and from the map of a UTM zone.
#[test]
fn zones_and_lines_count_longitudes_as_they_like() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    // From 179.96° to 180.04°.
    let a = model(&at("a.tif"), "EPSG:4326", (179.96, 60.04, 0.001), 3.0);
    let b = model(&at("b.tif"), "EPSG:4326", (179.96, 60.04, 0.001), 0.0);
    let polygon = OGRwkbGeometryType::wkbPolygon;
    let degrees = SpatialRef::from_definition("EPSG:4326").expect("PROJ knows it");
    let square = |west: f64| {
        let east = west + 0.02;
        format!("POLYGON(({west} 60.01,{east} 60.01,{east} 60.02,{west} 60.02,{west} 60.01))")
    };
    let mut from = degrees.clone();
    from.set_axis_mapping_strategy(gdal::spatial_ref::AxisMappingStrategy::TraditionalGisOrder);
    let map = SpatialRef::from_definition("EPSG:32660").expect("PROJ knows it");
    let way = gdal::spatial_ref::CoordTransform::new(&from, &map).expect("a way");
    // Over 180° on the map.
    let (mut xs, mut ys) = ([179.99, 180.01, 180.01, 179.99], [60.01, 60.01, 60.02, 60.02]);
    way.transform_coords(&mut xs, &mut ys, &mut []).expect("transformed");
    let corners: Vec<String> = (0..5).map(|i| format!("{} {}", xs[i % 4], ys[i % 4])).collect();
    let on_map = format!("POLYGON(({}))", corners.join(","));
    for (name, system, wkt, n) in [
        ("east.gpkg", &degrees, square(-179.99), 200..=200),
        ("west.gpkg", &degrees, square(179.97), 200..=200),
        ("map.gpkg", &map, on_map, 190..=210),
    ] {
        let zones = zones(&at(name), Some(system), polygon, &wkt);
        let found = compare(&a, &b, Some(&zones), &at("out"));
        assert!(n.contains(&found.volumes[0].n), "{name}: {}", found.volumes[0].n);
        assert!(found.volumes[0].covered_share.is_some_and(|share| share > 0.95), "{name}: {:?}", found.volumes[0]);
        assert!(found.warnings.is_empty(), "{name}: {:?}", found.warnings);
    }
    let beside = zones(&at("beside.gpkg"), Some(&degrees), polygon, &square(10.0));
    let found = compare(&a, &b, Some(&beside), &at("out"));
    assert!(found.warnings.iter().any(|note| note.starts_with("zone 1 has no cell")), "{:?}", found.warnings);
    let along = |line: &[(f64, f64)]| autoref_elevation::profile::along(&[&a], line, None).expect("a profile");
    let (as_model, jumping) = (along(&[(179.97, 60.0), (180.03, 60.0)]), along(&[(179.97, 60.0), (-179.97, 60.0)]));
    assert_eq!(as_model.len(), jumping.len());
    for (a, b) in as_model.iter().zip(&jumping) {
        let heights = a.heights_m[0].zip(b.heights_m[0]);
        assert!(heights.is_some_and(|(a, b)| (a - b).abs() < 1e-6), "{a:?}, {b:?}");
    }
}

#[test]
fn a_unit_that_says_nothing_is_none() {
    let folder = tempfile::tempdir().expect("a folder");
    let driver = DriverManager::get_driver_by_name("RST").expect("a driver");
    let source = model(&folder.path().join("m.tif"), "EPSG:32633", (500_000.0, 8_700_000.0, 10.0), 0.0);
    let path = folder.path().join("m.rst");
    let source = gdal::Dataset::open(source).expect("a raster");
    drop(source.create_copy(&driver, &path, &Default::default()).expect("a copy"));
    let written = gdal::Dataset::open(&path).expect("a raster");
    let unit = written.rasterband(1).expect("a band").unit();
    assert_eq!(unit, "unspecified", "{:?}", written.metadata_domains());
    let read = autoref_elevation::model::Model::open(&path).expect("a model");
    assert_eq!((read.unit_name(), read.metres_per_value()), (None, 1.0));
}

/// One file counts longitudes from −180°, the other from 0°.
#[test]
fn longitudes_a_turn_apart_are_one_place() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let cell = 1.0 / 3600.0;
    let a = model(&at("a.tif"), "EPSG:4326", (-20.0, 65.0, cell), 2.0);
    let b = model(&at("b.tif"), "EPSG:4326", (340.0, 65.0, cell), 0.0);
    for (a, b, west) in [(&a, &b, 340.0), (&b, &a, -20.0)] {
        let found = compare(a, b, None, &at("c"));
        assert_eq!(found.statistics[0].n, (SIDE * SIDE) as u64);
        let job = AlignJob {
            a,
            b,
            method: Method::Auto,
            surface: Degree::Linear,
            stable: None,
            resources: resources(),
            scratch: None,
        };
        let found = job.run().expect("aligned");
        let Outcome::Aligned(alignment) = &found.outcome else { panic!("refused") };
        assert!(alignment.shift_m[0].abs() < 0.01 && (alignment.shift_m[2].abs() - 2.0).abs() < 1e-3, "{alignment:?}");
        let out = at("out.tif");
        found.write(alignment, &out).expect("written");
        let placed = gdal::Dataset::open(&out).expect("a raster").geo_transform().expect("a place");
        assert!((placed[0] - west).abs() < 1e-6, "{placed:?}");
    }
}
