//! World file and `.aux.xml` beside images of formats in which GDAL passes these over.

use std::path::Path;

use super::{NORTH_UP, SIZE, Sample, TURNED, autoref, difference_px, slope, stderr, succeeded, transform_of};
use autoref_raster::coords::GeoTransform;

const DRONE: GeoTransform = GeoTransform([570_004.0, 0.03, 0.0, 7_032_008.0, 0.0, -0.03]);

/// The sample's image in another format, with a georeference of its own.
fn translated(sample: &Sample, driver: &str, name: &str) {
    autoref_raster::initialise_gdal(0);
    let of = |name| gdal::DriverManager::get_driver_by_name(name).expect("there");
    let source = gdal::Dataset::open(sample.path("e6.tif")).expect("written");
    let mut placed = source.create_copy(&of("MEM"), "", &Default::default()).expect("copied");
    placed.set_geo_transform(&DRONE.0).expect("set");
    placed.set_spatial_ref(&gdal::spatial_ref::SpatialRef::from_epsg(25832).expect("known")).expect("set");
    // A virtual raster needs a file to refer to.
    let placed = match driver {
        "VRT" => placed.create_copy(&of("GTiff"), sample.path("placed.tif"), &Default::default()).expect("copied"),
        _ => placed,
    };
    placed.create_copy(&of(driver), sample.path(name), &Default::default()).expect("copied").close().expect("written");
}

fn near(path: &Path, expected: &GeoTransform) {
    let found = transform_of(path);
    assert!(difference_px(&found, expected) < 1e-3, "{}: {found:?}", path.display());
}

/// A run said that the image's georeference was overridden, and GDAL read the old one.
#[test]
fn where_gdal_passes_over_an_aux_xml_a_vrt_is_written_and_named() {
    let (driver, name, vrt) = ("HFA", "a.img", "a.vrt");
    let sample = Sample::new(TURNED);
    translated(&sample, driver, name);
    let image = sample.path(name);
    // The driver of HFA writes an .aux.xml of its own.
    let ran = sample.apply(&[image.to_str().expect("plain"), "--overwrite"]);
    succeeded(&ran);
    near(&image, &DRONE);
    near(&sample.path(vrt), &TURNED);
    let said = String::from_utf8_lossy(&ran.stdout);
    assert!(
        said.contains("GDAL and QGIS do not take") && said.contains(&format!("open {}", sample.path(vrt).display())),
        "{said}"
    );
}

/// GDAL reads the tags of a TIFF before a world file.
#[test]
fn a_world_file_that_has_no_effect_is_told() {
    let sample = Sample::new(NORTH_UP);
    translated(&sample, "GTiff", "t.tif");
    let image = sample.path("t.tif");
    let image = image.to_str().expect("plain");
    let said = |write: &str| {
        let ran = sample.apply(&[image, "--write", write, "--overwrite"]);
        succeeded(&ran);
        String::from_utf8_lossy(&ran.stdout).into_owned()
    };
    assert!(said("world").contains("add aux to --write"));
    near(&sample.path("t.tif"), &DRONE);
    assert!(!said("world,aux").contains("Note"));
    near(&sample.path("t.tif"), &NORTH_UP);
    // Without tags the world file counts.
    slope(&sample.path("plain.tif"), "GTiff", SIZE, &[]);
    let plain = sample.path("plain.tif");
    let ran = sample.apply(&[plain.to_str().expect("plain"), "--write", "world"]);
    assert!(!String::from_utf8_lossy(&ran.stdout).contains("Note"), "{}", stderr(&ran));
}

/// A run on such an image, and one on the virtual raster that it wrote, see the georeference that the image came with.
#[test]
fn runs_again_see_what_the_image_came_with() {
    let sample = Sample::new(TURNED);
    let drawn = sample.path("drawn.tif");
    let gcps = autoref_synth::random_gcps(9, 24.0, 18.0, 4);
    let spec = autoref_synth::SynthSpec { gcps, gsd_m: 0.05, ..Default::default() };
    let truth = autoref_synth::write(&spec, &drawn).expect("a sample");
    let own = GeoTransform([truth.geotransform.0[0] + 3.0, 0.05, 0.0, truth.geotransform.0[3] - 7.0, 0.0, -0.05]);
    let list = sample.path("l.csv");
    let rows: String = spec.gcps.iter().map(|g| format!("{},{},{}\n", g.name, g.easting, g.northing)).collect();
    std::fs::write(&list, format!("name,easting,northing\n{rows}")).expect("writable");
    let of = |name| gdal::DriverManager::get_driver_by_name(name).expect("there");
    let source = gdal::Dataset::open(&drawn).expect("drawn");
    let mut copy = source.create_copy(&of("HFA"), sample.path("a.img"), &Default::default()).expect("copied");
    copy.set_geo_transform(&own.0).expect("set");
    copy.set_spatial_ref(&gdal::spatial_ref::SpatialRef::from_epsg(25832).expect("known")).expect("set");
    copy.close().expect("written");
    let run = |image: &str| -> serde_json::Value {
        let image = sample.path(image);
        let ran = autoref(&[
            image.to_str().expect("plain"),
            "--gcps",
            list.to_str().expect("plain"),
            "--no-report",
            "--overwrite",
            "--json",
            "--second-pass=never",
        ]);
        succeeded(&ran);
        serde_json::from_slice(&ran.stdout).expect("one document")
    };
    let first = run("a.img");
    let warnings = first["warnings"].to_string();
    assert!(!warnings.contains("overridden") && warnings.contains("a.vrt"), "{warnings}");
    assert!(first["files_written"].to_string().contains("a.vrt"), "{}", first["files_written"]);
    near(&sample.path("a.img"), &own);
    for image in ["a.img", "a.vrt"] {
        let again = run(image);
        let prior = |document: &serde_json::Value| document["prior_georeference"]["geotransform"].clone();
        assert_eq!(prior(&again), prior(&first), "{image}");
    }
}
