//! A run on an image that an earlier run has placed says what the first one said.

use std::path::Path;
use std::process::{Command, Output};

use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_synth::{SynthSpec, random_gcps};
use gdal::Dataset;
use gdal::raster::Buffer;
use gdal::spatial_ref::SpatialRef;
use serde_json::Value;

const GSD_M: f64 = 0.04;

fn program(folder: &Path, arguments: &[&str]) -> Output {
    let run = Command::new(env!("CARGO_BIN_EXE_autoref-stream")).current_dir(folder).args(arguments).output();
    run.expect("the program starts")
}

#[track_caller]
fn ran(folder: &Path, arguments: &[&str]) -> Output {
    let output = program(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    output
}

/// The georeference of the photogrammetry: metres off, and not turned as the image is.
fn by_drone(true_origin: MapPoint) -> GeoTransform {
    GeoTransform([true_origin.easting + 3.0, GSD_M, 0.0, true_origin.northing - 7.0, 0.0, -GSD_M])
}

fn ground(m: MapPoint, about: MapPoint) -> f64 {
    120.0 + 0.02 * (m.easting - about.easting) - 0.01 * (m.northing - about.northing)
}

/// `a.tif` of nine marks with the drone's georeference, `l.csv` with heights, `crop.tif` of it from column 100 and row
/// 200 on, 300 × 250 pixels, and `dsm.tif` in the image's grid, 1.5 m too low.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    let gcps = random_gcps(9, 24.0, 18.0, 4);
    let spec = SynthSpec { gcps: gcps.clone(), gsd_m: GSD_M, rotation_deg: 17.0, ..SynthSpec::default() };
    let truth = autoref_synth::write(&spec, &folder.path().join("drawn.tif")).expect("a sample");
    let size = (truth.width as usize, truth.height as usize);
    let about = truth.geotransform.apply(PixelPoint { x: 0.0, y: 0.0 });
    let height = |east, north| ground(MapPoint { easting: east, northing: north }, about);
    let rows: String = gcps
        .iter()
        .map(|g| format!("{},{},{},{:.4}\n", g.name, g.easting, g.northing, height(g.easting, g.northing)))
        .collect();
    std::fs::write(folder.path().join("l.csv"), format!("name,easting,northing,height\n{rows}")).expect("writable");
    let own = by_drone(about);
    copied(folder.path(), own);
    let heights = (0..size.0 * size.1).map(|i| {
        let pixel = PixelPoint { x: (i % size.0) as f64 + 0.5, y: (i / size.0) as f64 + 0.5 };
        (ground(truth.geotransform.apply(pixel), about) - 1.5) as f32
    });
    placed(&folder.path().join("dsm.tif"), size, own, heights.collect());
    let corner = own.apply(PixelPoint { x: 100.0, y: 200.0 });
    let at_crop = GeoTransform([corner.easting, GSD_M, 0.0, corner.northing, 0.0, -GSD_M]);
    placed(&folder.path().join("crop.tif"), (300, 250), at_crop, vec![0.0; 300 * 250]);
    folder
}

/// A raster with a georeference of its own; `values` go row by row.
fn placed(path: &Path, size: (usize, usize), own: GeoTransform, values: Vec<f32>) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut file = driver.create_with_band_type::<f32, _>(path, size.0, size.1, 1).expect("created");
    file.set_geo_transform(&own.0).expect("set");
    file.set_spatial_ref(&SpatialRef::from_epsg(25832).expect("known")).expect("set");
    file.rasterband(1).expect("there").write((0, 0), size, &mut Buffer::new(size, values)).expect("written");
    file.close().expect("written");
}

/// `drawn.tif` as `a.tif`, with this georeference in it.
fn copied(folder: &Path, own: GeoTransform) {
    let from = Dataset::open(folder.join("drawn.tif")).expect("drawn");
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut copy = from.create_copy(&driver, folder.join("a.tif"), &Default::default()).expect("copied");
    copy.set_geo_transform(&own.0).expect("set");
    copy.set_spatial_ref(&SpatialRef::from_epsg(25832).expect("known")).expect("set");
    copy.close().expect("written");
}

fn run(folder: &Path, extra: &[&str]) -> Value {
    let job = ["a.tif", "--gcps", "l.csv", "--no-report", "--overwrite", "--json", "--second-pass=never"];
    serde_json::from_slice(&ran(folder, &[&job, extra].concat()).stdout).expect("one document")
}

/// The crop's world file by the result beside the image.
fn crop(folder: &Path) -> String {
    ran(folder, &["apply", "a.autoref.json", "--to", "crop.tif", "--write", "world", "--out", "o", "--overwrite"]);
    std::fs::read_to_string(folder.join("o/crop.tfw")).expect("written")
}

/// The second run's prior was its own result, and crops of the image were put metres off without a word.
#[test]
fn a_second_run_carries_the_georeference_as_the_first_does() {
    let folder = workplace();
    let first = run(folder.path(), &[]);
    let first_crop = crop(folder.path());
    let says_the_same = |write: &str| {
        let again = run(folder.path(), &["--write", write]);
        assert_eq!(again["prior_georeference"], first["prior_georeference"], "--write {write}");
        assert_eq!(again["warnings"], first["warnings"], "--write {write}");
        assert_eq!(crop(folder.path()), first_crop, "--write {write}");
    };
    says_the_same("aux,tags");
    // What was beneath comes from the image itself.
    std::fs::remove_file(folder.path().join("a.autoref.json")).expect("there");
    std::fs::remove_file(folder.path().join("a.tif.aux.xml")).expect("there");
    says_the_same("tags");
}

/// The answer of the first run bore witness for itself: it narrowed the search of the second, which then stated a
/// smaller chance.
#[test]
fn a_second_run_takes_nothing_from_the_first_for_its_chance() {
    let folder = workplace();
    let run = || {
        let job = ["drawn.tif", "--gcps", "l.csv", "--crs", "EPSG:25832", "--no-report", "--overwrite", "--json"];
        let output = ran(folder.path(), &[&job[..], &["--second-pass=never"]].concat());
        serde_json::from_slice::<Value>(&output.stdout).expect("one document")
    };
    let (first, second) = (run(), run());
    assert!(folder.path().join("drawn.tif.aux.xml").exists(), "the first run wrote its answer");
    assert_eq!(second["options"]["priors"], first["options"]["priors"]);
    assert!(first["options"]["priors"].is_array(), "{}", first["options"]);
}

/// The model has the georeference that the image came with, and was read where the marks are on the map.
#[test]
fn a_second_run_reads_heights_where_the_first_did() {
    let folder = workplace();
    let model = |name| run(folder.path(), &["--dem", "dsm.tif", "--write-dem", name]);
    let (first, second) = (model("first.tif"), model("second.tif"));
    assert_eq!(first["heights"]["frame"], "image", "{}", first["heights"]);
    assert_eq!(second["heights"], first["heights"]);
    assert_eq!(second["heights"]["points"].as_array().map(Vec::len), Some(9));
    let bytes = |name: &str| std::fs::read(folder.path().join(name)).expect("written");
    assert!(bytes("first.tif") == bytes("second.tif"), "the copies differ");
    // A model that got the georeference of the image's run lies on its grid too.
    ran(folder.path(), &["apply", "a.autoref.json", "--to", "dsm.tif", "--write", "aux"]);
    assert_eq!(model("third.tif")["heights"]["frame"], "image");
}
