//! The transform in every output that carries it, read by GDAL, by rasterio and by the program.

use std::process::Command;

use super::warped::warped_copy_agrees;
use super::{NORTH_UP, Sample, TURNED, autoref, difference_px, refused, stderr, succeeded, transform_of};
use crate::common::python::python_with;
use autoref_raster::coords::GeoTransform;
use autoref_stream::result::RunResult;

#[test]
fn every_output_that_carries_the_transform_says_the_same() {
    for transform in [TURNED, NORTH_UP] {
        let sample = Sample::new(transform);
        let before = std::fs::read(sample.path("e6.tif")).expect("there");
        succeeded(&sample.apply(&["--write", "world,aux,vrt,gcps,warp", "--json"]));
        assert!(before == std::fs::read(sample.path("e6.tif")).expect("there"), "only tags touch the image");
        let mut read: Vec<(&str, GeoTransform)> =
            vec![("aux", transform_of(&sample.path("e6.tif"))), ("vrt", transform_of(&sample.path("e6.vrt")))];
        // Each of the others alone beside a bare copy.
        let alone = sample.path("alone");
        std::fs::create_dir(&alone).expect("a folder");
        std::fs::copy(sample.path("e6.tif"), alone.join("e6.tif")).expect("copied");
        std::fs::copy(sample.path("e6.tfw"), alone.join("e6.tfw")).expect("copied");
        read.push(("world", transform_of(&alone.join("e6.tif"))));
        std::fs::remove_file(alone.join("e6.tfw")).expect("there");
        succeeded(&sample.apply(&[alone.join("e6.tif").to_str().expect("plain"), "--write", "tags"]));
        read.push(("tags", transform_of(&alone.join("e6.tif"))));
        for (name, found) in &read {
            assert!(difference_px(&transform, found) < 1e-6, "{name}: {found:?} is not {transform:?}");
        }
        succeeded(&autoref(&["undo", alone.join("e6.tif").to_str().expect("plain")]));
        assert!(before == std::fs::read(alone.join("e6.tif")).expect("there"), "undone byte for byte");
        assert!(autoref(&["undo", alone.join("e6.tif").to_str().expect("plain")]).status.code() == Some(2));
        warped_copy_agrees(&sample);
        gcps_come_back(&sample);
    }
}

/// Exactly the pairs of pixel and surveyed point, through GDAL.
fn gcps_come_back(sample: &Sample) {
    let dataset = gdal::Dataset::open(sample.path("e6.gcps.vrt")).expect("GDAL opens it");
    assert!(dataset.geo_transform().is_err(), "tie points, no transform");
    let result = RunResult::read(&sample.path("e6.autoref.json")).expect("our own");
    let gcps = dataset.gcps();
    assert_eq!(gcps.len(), result.matches().len(), "check points are left out");
    for (gcp, row) in gcps.iter().zip(result.matches()) {
        assert_eq!(gcp.id(), row.gcp);
        let read = (gcp.pixel(), gcp.line(), gcp.x(), gcp.y(), Some(gcp.z()));
        assert_eq!(read, (row.x, row.y, row.easting, row.northing, row.height));
    }
    let crs = dataset.gcp_projection().expect("a CRS");
    assert_eq!(autoref_raster::crs::Crs::parse(&crs).expect("WKT").label(), "EPSG:25832");
}

#[test]
fn a_result_reads_back_to_itself() {
    let sample = Sample::new(TURNED);
    let result = RunResult::read(&sample.path("e6.autoref.json")).expect("our own");
    let again = sample.path("again.json");
    std::fs::write(&again, result.to_json()).expect("written");
    assert_eq!(RunResult::read(&again).expect("our own").to_json(), result.to_json());
    for (text, words) in [
        ("{\"schema_version\": 99}", "schema version 99"),
        ("{}", "no result of a run"),
        ("{\"schema_version\": 1", "line 1"),
        ("{\"schema_version\": 1}", "missing field"),
        (&result.to_json().replace("\"rmse_e_m\": 0.011", "\"rmse_e_m\": null"), "missing field `rmse_e_m`"),
        (&result.to_json().replace("\"solved\"", "\"refused\""), "field `geotransform` holds a value"),
    ] {
        std::fs::write(&again, text).expect("written");
        let output = autoref(&["apply", again.to_str().expect("plain")]);
        refused(&output, &["again.json", words]);
    }
}

#[test]
fn local_coordinates_need_no_crs() {
    let sample = Sample::new(TURNED);
    sample.write_result(None);
    succeeded(&sample.apply(&["--write", "world,aux,vrt,gcps,warp,tags"]));
    for name in ["e6.tif", "e6.vrt"] {
        assert!(difference_px(&TURNED, &transform_of(&sample.path(name))) < 1e-6, "{name}");
    }
    std::fs::remove_file(sample.path("e6.tif.aux.xml")).expect("there");
    assert!(difference_px(&TURNED, &transform_of(&sample.path("e6.tif"))) < 1e-6, "through the tags");
    assert!(gdal::Dataset::open(sample.path("e6.warp.tif")).expect("opens").projection().is_empty());
}

#[test]
fn rasterio_reads_every_output_alike() {
    let Some(python) = python_with("rasterio") else { return };
    for transform in [TURNED, NORTH_UP] {
        let sample = Sample::new(transform);
        for alone in ["world", "tags"] {
            std::fs::create_dir(sample.path(alone)).expect("a folder");
            std::fs::copy(sample.path("e6.tif"), sample.path(alone).join("e6.tif")).expect("copied");
            let copy = sample.path(alone).join("e6.tif");
            succeeded(&sample.apply(&[copy.to_str().expect("plain"), "--write", alone]));
        }
        succeeded(&sample.apply(&["--write", "aux,vrt,gcps,warp"]));
        let script = crate::common::root().join("tests/python/check_outputs.py");
        let output = Command::new(&python).arg(script).arg(sample.folder.path()).output().expect("Python starts");
        let said = format!("{}{}", String::from_utf8_lossy(&output.stdout), stderr(&output));
        eprintln!("{}", said.trim_end());
        assert!(output.status.success(), "{said}");
    }
}
