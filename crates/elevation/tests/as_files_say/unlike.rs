//! Fine units of height, bands that are no heights, zones without area, rows from the south.

use super::*;

const PLACE: [f64; 6] = [500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0];

fn update(path: &Path) -> Dataset {
    let flags = gdal::GdalOpenFlags::GDAL_OF_UPDATE;
    let options = gdal::DatasetOptions { open_flags: flags, ..Default::default() };
    Dataset::open_ex(path, options).expect("opens")
}

/// A kilometre is a hundred thousand centimetres, and ground all the same.
#[test]
fn ground_is_ground_in_every_unit() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let high: Vec<f64> = hills(0.0, 0.0).iter().map(|z| f64::from(*z) * 8.0).collect();
    let b = model(&at("b.tif"), "EPSG:32633", high.iter().map(|z| *z as f32).collect(), -10.0);
    autoref_raster::set_height_unit(&b, &update(&b), "m").expect("labelled");
    let lines = |model: &Path, name: &str| derive::contour(model, &at(name), 100.0, 0.0, MEMORY).expect("lines");
    let expected = lines(&b, "m.geojson");
    for (unit, per_metre) in [("dm", 10.0), ("cm", 100.0), ("mm", 1000.0)] {
        let a = at("a.tif");
        let set = create::<i32>(&a, (SIDE, SIDE), 1, "EPSG:32633", PLACE);
        put(&set, 1, high.iter().map(|z| (z * per_metre).round() as i32).collect());
        autoref_raster::set_height_unit(&a, &set, unit).expect("labelled");
        drop(set);
        let found = compare(&a, &b, None, &at("c"));
        assert_eq!(found.common_cells, (SIDE * SIDE) as u64, "{unit}");
        assert!(found.mean_m.is_some_and(|mean| mean.abs() < 0.02), "{unit}: {:?}", found.mean_m);
        derive::check_heights(&a).expect(unit);
        let drawn = lines(&a, &format!("{unit}.geojson"));
        assert!(drawn.abs_diff(expected) < 10, "{unit}: {drawn} and {expected} lines");
    }
}

/// GDAL takes the unit of a band without one from the vertical axis.
#[test]
fn what_is_no_height_has_no_unit_of_height() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let said = |path: &Path| {
        let set = Dataset::open(path).expect("a raster");
        let code = set.spatial_ref().expect("a CRS").auth_code();
        (set.rasterband(1).expect("a band").unit(), code.ok())
    };
    for (crs, code) in [("EPSG:32633+5773", 32_633), ("EPSG:2264+6360", 2264)] {
        let a = model(&at("a.tif"), crs, hills(0.0, 0.0), -10.0);
        for kind in ["hillshade", "slope", "aspect", "TPI"] {
            let drawing = derive::Drawing { kind, options: Vec::new(), colours: None, memory_budget_bytes: MEMORY };
            derive::draw(&a, &at("d.tif"), &drawing).expect("drawn");
            let (unit, found) = said(&at("d.tif"));
            assert_eq!(unit.is_empty(), kind != "TPI", "{crs}, {kind}: `{unit}`");
            assert!(kind == "TPI" || found == Some(code), "{crs}, {kind}");
            assert!(!at("d.tif.aux.xml").exists(), "{kind}: written beside the picture");
        }
        let edges = gradient::Edges::LeftOut;
        gradient::draw(&a, &at("g.tif"), Picture::SlopeDegrees, gradient::Kernel::Horn, edges, 1).expect("drawn");
        assert_eq!(said(&at("g.tif")), (String::new(), Some(code)));
    }
}

#[test]
fn zones_without_area_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let a = model(&at("a.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let square = |west: i32| {
        let east = west + 300;
        format!("[[[{west},8699900],[{east},8699900],[{east},8699600],[{west},8699600],[{west},8699900]]]")
    };
    let of = |name: &str, kind: &str, places: &str| {
        let geometry =
            if kind.is_empty() { "null".into() } else { format!("{{\"type\":\"{kind}\",\"coordinates\":{places}}}") };
        format!("{{\"type\":\"Feature\",\"properties\":{{\"name\":{name}}},\"geometry\":{geometry}}}")
    };
    let features = [
        of("\"first\"", "Polygon", &square(500_100)),
        of("\"peg\"", "Point", "[500500,8699500]"),
        of("\"empty\"", "Polygon", "[]"),
        of("\"flat\"", "Polygon", "[[[500100,8699900],[500400,8699900],[500100,8699900]]]"),
        of("\"lost\"", "", ""),
        of("null", "Polygon", &square(500_600)),
        of("\"far\"", "Polygon", &square(599_999)),
    ];
    let name = "\"crs\":{\"type\":\"name\",\"properties\":{\"name\":\"urn:ogc:def:crs:EPSG::32633\"}}";
    let text = format!("{{\"type\":\"FeatureCollection\",{name},\"features\":[{}]}}", features.join(","));
    std::fs::write(at("z.geojson"), text).expect("writable");
    let found = compare(&a, &a, Some(&at("z.geojson")), &at("c"));
    let rows: Vec<(&str, u64)> = found.volumes.iter().map(|volume| (volume.zone.as_str(), volume.n)).collect();
    // What has no name is numbered among the areas; a point is none.
    let expected = [("first", 900), ("empty", 0), ("flat", 0), ("lost", 0), ("3", 900), ("far", 0)];
    assert_eq!(rows, expected);
    let told = |words: &str| assert!(found.warnings.iter().any(|said| said.contains(words)), "{:?}", found.warnings);
    told("zones empty, flat, lost have no area");
    told("zone far has no cell with heights in both models");
}

/// Rows that run from south to north are read as others are, with their mask, on the grid of the mosaic and between.
#[test]
fn rows_from_the_south_join_a_mosaic() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    let values: Vec<f32> = (0..SIDE * SIDE).map(|i| if i % 131 == 5 { -9999.0 } else { (i % 977) as f32 }).collect();
    let turned: Vec<f32> = values.chunks(SIDE).rev().flatten().copied().collect();
    let inputs = [(-10.0, &values), (10.0, &turned)].map(|(step, values)| {
        let path = model(&at(&format!("{step}.tif")), "EPSG:32633", values.clone(), step);
        let set = update(&path);
        let mut band = set.rasterband(1).expect("a band");
        band.set_no_data_value(Some(-9999.0)).expect("labelled");
        path
    });
    for resolution in [None, Some(7.0), Some(25.0)] {
        let made = inputs.clone().map(|input| {
            let out = at("m.tif");
            joined(Choice::First, Interpolation::Bilinear, resolution, &[input], &out).expect("joined");
            read(&out, 1)
        });
        assert_eq!(made[0], made[1], "{resolution:?}");
        assert!(resolution.is_some() || made[0].iter().zip(&values).all(|(a, b)| *a == f64::from(*b)));
    }
}
