//! A place in the EXIF of a JPEG.

use std::path::Path;

use super::{SIZE, Sample, TURNED, refused, stderr, succeeded};
use autoref_raster::coords::PixelPoint;
use gdal::Metadata;
use gdal::raster::{Buffer, RasterCreationOptions};

/// What GDAL reads of an EXIF block.
fn exif_of(path: &Path) -> Vec<(String, String)> {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    let items = dataset.metadata_domain("").unwrap_or_default();
    items.iter().filter_map(|item| item.split_once('=')).map(|(k, v)| (k.into(), v.trim().into())).collect()
}

fn exif_numbers(items: &[(String, String)], key: &str) -> Vec<f64> {
    let value = &items.iter().find(|(k, _)| k == key).unwrap_or_else(|| panic!("no {key} in {items:?}")).1;
    value.split(['(', ')', ' ']).filter(|t| !t.is_empty()).map(|t| t.parse().expect("a number")).collect()
}

fn pixels_of(path: &Path) -> Vec<u8> {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    let band = dataset.rasterband(1).expect("there");
    band.read_as::<u8>((0, 0), dataset.raster_size(), dataset.raster_size(), None).expect("readable").data().to_vec()
}

#[test]
fn a_jpeg_takes_its_place_into_its_exif() {
    let sample = Sample::new(TURNED);
    let driver = gdal::DriverManager::get_driver_by_name("JPEG").expect("there");
    let byte = gdal::DriverManager::get_driver_by_name("MEM").expect("there");
    let drawn = byte.create_with_band_type::<u8, _>("", SIZE.0, SIZE.1, 3).expect("created");
    let values: Vec<u8> = (0..SIZE.0 * SIZE.1).map(|i| (i % SIZE.0 / 3) as u8).collect();
    for band in 1..=3 {
        let mut band = drawn.rasterband(band).expect("there");
        band.write((0, 0), SIZE, &mut Buffer::new(SIZE, values.clone())).expect("written");
    }
    let jpeg = sample.path("e6.jpg");
    drawn.create_copy(&driver, &jpeg, &RasterCreationOptions::new()).expect("written").close().expect("written");
    let image = jpeg.to_str().expect("plain");
    let before = std::fs::read(&jpeg).expect("there");
    succeeded(&sample.apply(&[image, "--write", "exif"]));
    assert_eq!(std::fs::read(&jpeg).expect("there"), before, "the input is touched");
    assert_eq!(pixels_of(&jpeg), pixels_of(&sample.path("e6.exif.jpg")));
    let items = exif_of(&sample.path("e6.exif.jpg"));
    let degrees = |key| {
        let parts = exif_numbers(&items, key);
        parts[0] + parts[1] / 60.0 + parts[2] / 3600.0
    };
    let middle = TURNED.apply(PixelPoint { x: 350.0, y: 250.0 });
    let utm = gdal::spatial_ref::SpatialRef::from_epsg(25832).expect("known");
    let mut world = gdal::spatial_ref::SpatialRef::from_epsg(4326).expect("known");
    world.set_axis_mapping_strategy(gdal::spatial_ref::AxisMappingStrategy::TraditionalGisOrder);
    let (mut x, mut y) = ([middle.easting], [middle.northing]);
    let transform = gdal::spatial_ref::CoordTransform::new(&utm, &world).expect("known");
    transform.transform_coords(&mut x, &mut y, &mut []).expect("inside");
    // GDAL prints six digits of a rational: a thousandth of a second, 3 cm.
    assert!((degrees("EXIF_GPSLongitude") - x[0]).abs() < 2e-6, "{items:?}, {x:?}");
    assert!((degrees("EXIF_GPSLatitude") - y[0]).abs() < 2e-6, "{items:?}, {y:?}");
    // The top lies 7.6 degrees east of grid north, which lies east of true north by the convergence of the meridians.
    let convergence_deg = (x[0] - 9.0) * y[0].to_radians().sin();
    let expected = f64::atan2(0.004, 0.03).to_degrees() + convergence_deg;
    let direction = exif_numbers(&items, "EXIF_GPSImgDirection")[0];
    assert!((direction - expected).abs() < 0.01, "{direction} against {expected}");
    // Once more, of the copy: nothing is there twice.
    let again =
        ["--write", "exif", "--out", sample.folder.path().join("again").to_str().expect("plain")].map(String::from);
    let copy = sample.path("e6.exif.jpg");
    let again: Vec<&str> = again.iter().map(String::as_str).collect();
    succeeded(&sample.apply(&[&[copy.to_str().expect("plain")], &again[..]].concat()));
    assert_eq!(exif_of(&sample.path("again/e6.exif.exif.jpg")), items);
    refused(&sample.apply(&["--write", "exif", "--overwrite"]), &["e6.tif", "no JPEG", "--write world,aux"]);
    for (name, bytes) in [("cut.jpg", &before[..60]), ("odd.jpg", b"\xFF\xD8\xFF\xE1\x00\x01")] {
        std::fs::write(sample.path(name), bytes).expect("written");
        let path = sample.path(name);
        let output = sample.apply(&[path.to_str().expect("plain"), "--write", "exif"]);
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    }
}

/// The German system of DHDN differs from WGS 84 by a change of datum that is good to metres only.
#[test]
fn a_coarse_change_of_datum_is_accepted_by_its_option() {
    let sample = Sample::new(TURNED);
    let driver = gdal::DriverManager::get_driver_by_name("JPEG").expect("there");
    let memory = gdal::DriverManager::get_driver_by_name("MEM").expect("there");
    let drawn = memory.create_with_band_type::<u8, _>("", SIZE.0, SIZE.1, 1).expect("created");
    let jpeg = sample.path("e6.jpg");
    drawn.create_copy(&driver, &jpeg, &RasterCreationOptions::new()).expect("written").close().expect("written");
    let text = std::fs::read_to_string(sample.path("e6.autoref.json")).expect("written");
    let mut result: serde_json::Value = serde_json::from_str(&text).expect("a document");
    result["crs"] = "EPSG:2263".into();
    result["geotransform"] = serde_json::json!([980_000.0, 0.1, 0.0, 200_000.0, 0.0, -0.1]);
    std::fs::write(sample.path("e6.autoref.json"), result.to_string()).expect("written");
    let image = jpeg.to_str().expect("plain");
    let said = sample.apply(&[image, "--write", "exif"]);
    refused(&said, &["--write exif", "WGS 84", "accept it with --datum-accuracy"]);
    succeeded(&sample.apply(&[image, "--write", "exif", "--datum-accuracy", "10"]));
    let items = exif_of(&sample.path("e6.exif.jpg"));
    assert!((exif_numbers(&items, "EXIF_GPSLatitude")[0] - 40.7).abs() < 1.0, "{items:?}");
}

/// A camera's EXIF keeps all but the place; the maker's notes keep their positions.
#[test]
fn the_exif_of_a_camera_stays() {
    let Some(photo) = crate::common::data("photos/construction_caliterra.jpg") else { return };
    let sample = Sample::new(TURNED);
    let mut result: serde_json::Value =
        serde_json::from_slice(&std::fs::read(sample.path("e6.autoref.json")).expect("written")).expect("a document");
    let (width, height) = gdal::Dataset::open(&photo).expect("opens").raster_size();
    (result["image"]["width"], result["image"]["height"]) = (width.into(), height.into());
    std::fs::write(sample.path("e6.autoref.json"), result.to_string()).expect("written");
    let out = sample.path("out");
    let photo_name = photo.to_str().expect("plain");
    succeeded(&sample.apply(&[photo_name, "--write", "exif", "--out", out.to_str().expect("plain")]));
    let (old, new) = (exif_of(&photo), exif_of(&out.join("construction_caliterra.exif.jpg")));
    assert!(old.iter().any(|(k, v)| k == "EXIF_GPSLatitude" && v.starts_with("(30)")), "the camera's own place");
    assert!(new.iter().any(|(k, v)| k == "EXIF_GPSLatitude" && v.starts_with("(63)")), "{new:?}");
    let rest = |items: Vec<(String, String)>| -> Vec<_> {
        items.into_iter().filter(|(k, _)| !k.starts_with("EXIF_GPS")).collect()
    };
    assert!(new.iter().any(|(k, _)| k == "EXIF_GPSImgDirection"));
    let (old, new) = (rest(old), rest(new));
    assert!(old.len() > 10, "{old:?}");
    assert_eq!(old, new);
    // The coded pixels are the same bytes.
    let (old, new) = (
        std::fs::read(&photo).expect("there"),
        std::fs::read(out.join("construction_caliterra.exif.jpg")).expect("there"),
    );
    assert_eq!(old[old.len() - 100_000..], new[new.len() - 100_000..]);
}
