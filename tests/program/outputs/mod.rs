//! One result, all outputs: every one read back by its own rules, and nothing half-written when something fails.

use std::path::{Path, PathBuf};
use std::process::{Command, Output as Ran};

use crate::common::python::python_with;
use autoref_raster::coords::{GeoTransform, PixelPoint};
use autoref_stream::result::RunResult;
use gdal::Metadata;
use gdal::raster::{Buffer, RasterCreationOptions};

const TURNED: GeoTransform = GeoTransform([570_000.25, 0.03, -0.004, 7_032_000.5, -0.004, -0.03]);
const NORTH_UP: GeoTransform = GeoTransform([570_000.25, 0.03, 0.0, 7_032_000.5, 0.0, -0.03]);
const SIZE: (usize, usize) = (700, 500);

/// A folder with an image and the result of a run on it.
struct Sample {
    folder: tempfile::TempDir,
    transform: GeoTransform,
}

impl Sample {
    /// A 16-bit image whose values are a slope: what a pixel holds tells where it was.
    fn new(transform: GeoTransform) -> Sample {
        let folder = tempfile::tempdir().expect("a temporary folder");
        slope(&folder.path().join("e6.tif"), "GTiff", SIZE, &["TILED=YES", "COMPRESS=DEFLATE"]);
        let sample = Sample { folder, transform };
        sample.write_result(Some("EPSG:25832"));
        sample
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// As a run writes it, with matches and a check point.
    fn write_result(&self, crs: Option<&str>) {
        let row = |name: &str, x: f64, y: f64| {
            let map = self.transform.apply(PixelPoint { x, y });
            serde_json::json!({
                "gcp": name, "x": x, "y": y, "easting": map.easting + 0.011, "northing": map.northing - 0.007,
                "height": 12.345, "survey_sigma_m": 0.01, "residual_e_m": 0.011, "residual_n_m": -0.007, "residual_px": 0.4,
                "score": 9.5, "found_by": "scan", "outlier": false,
            })
        };
        let result = serde_json::json!({
            "schema_version": 1, "program": "autoref-stream 0.1.0", "status": "solved", "advice": [],
            "image": {"path": self.path("e6.tif"), "width": SIZE.0, "height": SIZE.1, "bands": 1, "reader": "native",
                      "description": ""},
            "gcp_file": "e6.csv", "options": {"page": 0}, "geotransform": self.transform, "crs": crs, "rmse_m": 0.013,
            "rmse_e_m": 0.011, "rmse_n_m": 0.007, "rmse_px": 0.4, "scale_m_per_px": 0.03, "rotation_deg": 0.0,
            "gcps_listed": 5, "gcps_in_image": 5, "candidates_found": 9,
            "matches": [row("P1", 100.123456789, 50.1 + 0.2), row("P-ø 2", 620.5, 60.25), row("P3", 333.333, 450.0625)],
            "check_points": [row("K9", 512.75, 222.125)],
            "not_found": [], "outside": [], "warnings": [], "candidates": [], "files_written": [],
            "timings": {"open_s": 0.0, "scan_s": 0.0, "examine_s": 0.0, "match_s": 0.0, "rematch_s": 0.0, "write_s": 0.0},
            "elapsed_s": 0.1,
        });
        std::fs::write(self.path("e6.autoref.json"), result.to_string()).expect("written");
    }

    fn apply(&self, extra: &[&str]) -> Ran {
        let result = self.path("e6.autoref.json");
        let mut args = vec!["apply", result.to_str().expect("plain")];
        args.extend(extra);
        autoref(&args)
    }

    fn names(&self) -> Vec<String> {
        names(self.folder.path())
    }
}

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .expect("readable")
        .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn autoref(args: &[&str]) -> Ran {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn stderr(output: &Ran) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn succeeded(output: &Ran) {
    assert_eq!(output.status.code(), Some(0), "{}", stderr(output));
}

/// Exit code 2 and one line with these words.
fn refused(output: &Ran, words: &[&str]) {
    let message = stderr(output);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    for word in words {
        assert!(message.contains(word), "no `{word}` in: {message}");
    }
}

/// Value of the slope at a pixel position.
fn slope_at(p: PixelPoint) -> f64 {
    1000.0 + 40.0 * p.x + 25.0 * p.y
}

fn slope(path: &Path, driver: &str, size: (usize, usize), options: &[&str]) {
    autoref_raster::initialise_gdal(0);
    let driver = gdal::DriverManager::get_driver_by_name(driver).expect("there");
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let dataset =
        driver.create_with_band_type_with_options::<u16, _>(path, size.0, size.1, 1, &options).expect("created");
    let values = (0..size.0 * size.1)
        .map(|i| slope_at(PixelPoint { x: (i % size.0) as f64 + 0.5, y: (i / size.0) as f64 + 0.5 }).round() as u16)
        .collect();
    let mut band = dataset.rasterband(1).expect("there");
    band.write((0, 0), size, &mut Buffer::new(size, values)).expect("written");
    dataset.close().expect("written");
}

fn transform_of(path: &Path) -> GeoTransform {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    GeoTransform(dataset.geo_transform().expect("georeferenced"))
}

/// Largest distance in pixels of the first over the image.
fn difference_px(a: &GeoTransform, b: &GeoTransform) -> f64 {
    a.differs_px(b)
}

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

/// The value under every pixel of the copy is that of the image at the same place on the map: bilinear interpolation
/// keeps a slope, so a shift of a hundredth of a pixel would show.
fn warped_copy_agrees(sample: &Sample) {
    let path = sample.path("e6.warp.tif");
    let transform = transform_of(&path);
    assert_eq!((transform.0[2], transform.0[4]), (0.0, 0.0), "north is up");
    let dataset = gdal::Dataset::open(&path).expect("GDAL opens it");
    assert_eq!(dataset.raster_count(), 2, "one band and alpha");
    let crs = autoref_raster::crs::Crs::parse(&dataset.projection()).expect("a CRS");
    assert_eq!(crs.label(), "EPSG:25832");
    let (width, height) = dataset.raster_size();
    let band = |number| dataset.rasterband(number).expect("there").read_band_as::<u16>().expect("readable");
    let (values, alpha) = (band(1), band(2));
    let mut compared = 0;
    for row in (0..height).step_by(7) {
        for column in (0..width).step_by(7) {
            let map = transform.apply(PixelPoint { x: column as f64 + 0.5, y: row as f64 + 0.5 });
            let pixel = sample.transform.invert(map).expect("not singular");
            let (x, y) = (SIZE.0 as f64, SIZE.1 as f64);
            if (2.0..x - 2.0).contains(&pixel.x) && (2.0..y - 2.0).contains(&pixel.y) {
                let difference = f64::from(values[(row, column)]) - slope_at(pixel);
                // A hundredth of a pixel is 0.4, rounding to whole numbers 0.5 in source and copy.
                assert!(difference.abs() <= 1.01, "{difference} at {pixel:?}");
                assert!(alpha[(row, column)] > 0, "covered");
                compared += 1;
            } else if !(-1.0..x + 1.0).contains(&pixel.x) || !(-1.0..y + 1.0).contains(&pixel.y) {
                assert_eq!(alpha[(row, column)], 0, "not covered at {pixel:?}");
            }
        }
    }
    assert!(compared > 5000, "{compared}");
    drop(dataset);
    is_valid_cog(&path);
}

/// By GDAL's own script when Python has it, always by the rules themselves.
fn is_valid_cog(path: &Path) {
    use autoref_raster::tiff::container::{Directories, tag};
    let script = ["-m", "osgeo_utils.samples.validate_cloud_optimized_geotiff", path.to_str().expect("plain")];
    match Command::new("python3").args(script).output() {
        Ok(output) if !String::from_utf8_lossy(&output.stderr).contains("ModuleNotFoundError") => {
            let said = String::from_utf8_lossy(&output.stdout).into_owned();
            assert!(output.status.success() && said.contains("is a valid cloud"), "{said}{}", stderr(&output));
        }
        _ => crate::common::skipped("GDAL's validate_cloud_optimized_geotiff is not installed"),
    }
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    assert_eq!(dataset.metadata_item("LAYOUT", "IMAGE_STRUCTURE").as_deref(), Some("COG"));
    let file = Directories::read(path).expect("a TIFF");
    assert!(file.list.len() > 1, "it has overviews");
    // Directories in order at the front; the image's first, then smaller and smaller ones; pixels in the opposite
    // order.
    let mut last = (0, u64::MAX, u64::MAX);
    for (index, directory) in file.list.iter().enumerate() {
        let numbers = |tag| file.numbers(index, tag).expect("readable").expect("tiled");
        let width = numbers(tag::IMAGE_WIDTH)[0];
        let offsets = numbers(tag::TILE_OFFSETS);
        let first = offsets.iter().copied().filter(|&at| at > 0).min().expect("it has pixels");
        assert!(directory.position > last.0 && width < last.1 && first < last.2, "directory {index} is out of order");
        last = (directory.position, width, first);
        assert!(numbers(tag::TILE_WIDTH)[0] <= 512);
    }
    assert!(last.1 <= 512, "the smallest overview is one block");
    let all_before = file.list.iter().all(|directory| directory.position < last.2);
    assert!(all_before, "every directory comes before every pixel");
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
fn every_compression_and_border_makes_a_cog() {
    let sample = Sample::new(TURNED);
    for compress in ["none", "lzw", "deflate", "zstd"] {
        succeeded(&sample.apply(&["--write", "warp", "--overwrite", "--compress", compress]));
        warped_copy_agrees(&sample);
    }
    succeeded(&sample.apply(&[
        "--write",
        "warp",
        "--overwrite",
        "--border",
        "7",
        "--resolution",
        "0.06",
        "--resampling",
        "near",
    ]));
    let dataset = gdal::Dataset::open(sample.path("e6.warp.tif")).expect("opens");
    assert_eq!(dataset.raster_count(), 1);
    assert_eq!(dataset.rasterband(1).expect("there").no_data_value(), Some(7.0));
    let transform = transform_of(&sample.path("e6.warp.tif"));
    assert!((transform.0[1] - 0.06).abs() < 1e-12);
    drop(dataset);
    // 16 bits and one band: JPEG cannot, and says so before any work.
    let before = sample.names();
    refused(&sample.apply(&["--write", "warp", "--overwrite", "--compress", "jpeg"]), &["JPEG", "UInt16", "deflate"]);
    refused(&sample.apply(&["--write", "warp", "--overwrite", "--border", "70000"]), &["70000", "UInt16"]);
    refused(&sample.apply(&["--write", "warp", "--overwrite", "--memory", "20M"]), &["--memory"]);
    assert_eq!(before, sample.names());
    // Eight bits in three bands.
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut dataset = driver.create_with_band_type::<u8, _>(sample.path("e6.tif"), SIZE.0, SIZE.1, 3).expect("created");
    for band in 1..=3 {
        let mut band = dataset.rasterband(band).expect("there");
        band.fill(90.0, None).expect("filled");
    }
    dataset.set_metadata_item("AREA_OR_POINT", "Area", "").expect("settable");
    dataset.close().expect("written");
    for compress in ["jpeg", "webp"] {
        succeeded(&sample.apply(&["--write", "warp", "--overwrite", "--compress", compress, "--quality", "90"]));
        let dataset = gdal::Dataset::open(sample.path("e6.warp.tif")).expect("opens");
        let band = dataset.rasterband(1).expect("there");
        let (width, height) = band.size();
        let centre = band.read_as::<u8>((width as isize / 2, height as isize / 2), (1, 1), (1, 1), None).expect("read");
        assert!(centre[(0, 0)].abs_diff(90) <= 3, "{compress}: {centre:?}");
        let mask = band.open_mask_band().expect("a mask");
        let corner = mask.read_as::<u8>((0, 0), (1, 1), (1, 1), None).expect("read");
        assert_eq!(corner[(0, 0)], 0, "{compress}: the corner is not covered");
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

#[test]
fn existing_outputs_are_refused_before_any_work() {
    let sample = Sample::new(TURNED);
    let before = std::fs::read(sample.path("e6.tif")).expect("there");
    std::fs::write(sample.path("e6.warp.tif"), "mine").expect("written");
    let names = sample.names();
    refused(&sample.apply(&["--write", "world,tags,warp"]), &["e6.warp.tif", "exists", "--overwrite"]);
    assert_eq!(names, sample.names());
    assert!(before == std::fs::read(sample.path("e6.tif")).expect("there"));
    assert_eq!(std::fs::read_to_string(sample.path("e6.warp.tif")).expect("there"), "mine");
    refused(&sample.apply(&["--write", "wolrd"]).tap_one_line(), &["wolrd"]);
}

trait OneLine {
    fn tap_one_line(self) -> Self;
}

impl OneLine for Ran {
    /// clap adds usage hints below its message.
    fn tap_one_line(mut self) -> Self {
        let end = self.stderr.iter().position(|&b| b == b'\n').unwrap_or(self.stderr.len());
        self.stderr.truncate(end);
        self
    }
}

#[test]
fn a_failing_output_takes_the_others_back() {
    let sample = Sample::new(TURNED);
    // The image is cut off: the warper fails in the middle, after world file and tags have been prepared.
    let path = sample.path("e6.tif");
    let whole = std::fs::read(&path).expect("there");
    let mut broken = whole.clone();
    let at = broken.len() / 2;
    broken[at..at + 2000].fill(0xFF);
    std::fs::write(&path, &broken).expect("written");
    std::fs::write(sample.path("e6.tfw"), "old").expect("written");
    let names = sample.names();
    let output = sample.apply(&["--write", "world,vrt,tags,warp", "--overwrite"]);
    refused(&output, &["e6"]);
    assert_eq!(names, sample.names(), "nothing new, no temporary files");
    assert_eq!(std::fs::read_to_string(sample.path("e6.tfw")).expect("there"), "old", "what was replaced is back");
    assert!(broken == std::fs::read(&path).expect("there"), "the image was touched");
}

/// A full disk: a small tmpfs, which only root may mount.
#[test]
fn a_full_disk_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=600k", "tmpfs"]).arg(&disk).output();
    if !mount.is_ok_and(|output| output.status.success()) {
        crate::common::skipped("a tmpfs cannot be mounted here");
        return;
    }
    let _unmount = Unmount(disk.clone());
    let sample = Sample::new(TURNED);
    let out = disk.to_str().expect("plain");
    let output = sample.apply(&["--write", "world,aux,warp", "--compress", "none", "--out", out]);
    refused(&output, &["e6.warp.tif"]);
    assert!(names(&disk).is_empty(), "{:?}", names(&disk));
    // Tags: the image itself lies on the disk, filled to the last byte.
    let image = disk.join("e6.tif");
    std::fs::copy(sample.path("e6.tif"), &image).expect("it fits");
    // Memory is given out in pages: none is half full.
    let file = std::fs::OpenOptions::new().write(true).open(&image).expect("writable");
    file.set_len(file.metadata().expect("there").len().next_multiple_of(65_536)).expect("it fits");
    let before = std::fs::read(&image).expect("there");
    let filler = vec![1u8; 1 << 20];
    let _ = std::fs::write(disk.join("filler"), filler);
    let output = sample.apply(&[image.to_str().expect("plain"), "--write", "tags"]);
    refused(&output, &["e6.tif", "No space left"]);
    assert!(before == std::fs::read(&image).expect("there"), "the image is as it was");
}

struct Unmount(PathBuf);

impl Drop for Unmount {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn what_must_not_be_written_to_is_not() {
    let sample = Sample::new(TURNED);
    let path = sample.path("e6.tif");
    let mut permissions = std::fs::metadata(&path).expect("there").permissions();
    permissions.set_readonly(true);
    std::fs::set_permissions(&path, permissions).expect("settable");
    if std::fs::OpenOptions::new().write(true).open(&path).is_ok() {
        crate::common::skipped("root writes to read-only files");
    } else {
        refused(&sample.apply(&["--write", "tags"]), &["e6.tif", "open for writing"]);
    }
    refused(&sample.apply(&["absent.tif", "--write", "tags"]), &["absent.tif"]);
    refused(&sample.apply(&["absent.tif", "--write", "warp"]), &["absent.tif"]);
    assert_eq!(sample.names(), ["e6.autoref.json", "e6.tif"]);
}

/// A float32 model with a slope, in `size` pixels.
fn elevation_model(path: &Path, size: (usize, usize), own: Option<GeoTransform>) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut dataset = driver.create_with_band_type::<f32, _>(path, size.0, size.1, 1).expect("created");
    let heights = (0..size.0 * size.1).map(|i| (i % size.0) as f32 * 0.1).collect();
    let mut band = dataset.rasterband(1).expect("there");
    band.write((0, 0), size, &mut Buffer::new(size, heights)).expect("written");
    if let Some(own) = own {
        dataset.set_geo_transform(&own.0).expect("settable");
    }
    dataset.close().expect("written");
}

#[test]
fn the_elevation_model_gets_the_same_outputs() {
    let sample = Sample::new(TURNED);
    let dem = sample.path("dem.tif");
    let name = dem.to_str().expect("plain").to_string();
    // Half as many pixels over the same ground.
    elevation_model(&dem, (SIZE.0 / 2, SIZE.1 / 2), None);
    refused(&sample.apply(&["--to", &name]), &["dem.tif", "not known", "--same-extent"]);
    refused(&sample.apply(&[&name]), &["350 × 250", "--to"]);
    succeeded(&sample.apply(&["--to", &name, "--same-extent", "--write", "world,aux,gcps,warp,tags"]));
    let read = transform_of(&dem);
    for (x, y) in [(0.0, 0.0), (700.0, 0.0), (0.0, 500.0), (123.0, 321.0)] {
        let (a, b) = (TURNED.apply(PixelPoint { x, y }), read.apply(PixelPoint { x: x / 2.0, y: y / 2.0 }));
        assert!((a.easting - b.easting).hypot(a.northing - b.northing) < 1e-8, "{a:?} {b:?}");
    }
    let warped = gdal::Dataset::open(sample.path("dem.warp.tif")).expect("opens");
    let band = warped.rasterband(1).expect("there");
    assert_eq!((warped.raster_count(), band.no_data_value()), (1, Some(-9999.0)), "heights have no alpha");
    let gcps = gdal::Dataset::open(sample.path("dem.gcps.vrt")).expect("opens");
    let first = &gcps.gcps()[0];
    assert!((first.pixel() - 100.123456789 / 2.0).abs() < 1e-9);
    // A shape that cannot have the same extent.
    elevation_model(&sample.path("odd.tif"), (SIZE.0 / 2, SIZE.1), None);
    let odd = sample.path("odd.tif");
    refused(&sample.apply(&["--to", odd.to_str().expect("plain"), "--same-extent"]), &["odd.tif", "shape"]);
}

#[test]
fn a_model_in_the_photogrammetrys_own_system_is_carried_through_it() {
    let sample = Sample::new(TURNED);
    let text = std::fs::read_to_string(sample.path("e6.autoref.json")).expect("there");
    let mut result: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    // Local coordinates: the image's pixels are 0.5 units, the model's 2, and the model begins 10 pixels up and left.
    result["prior_georeference"] = serde_json::json!({
        "geotransform": [100.0, 0.5, 0.0, 900.0, 0.0, -0.5], "crs": null, "moved_m": null,
    });
    std::fs::write(sample.path("e6.autoref.json"), result.to_string()).expect("written");
    let dem = sample.path("dem.tif");
    let own = GeoTransform([100.0 - 20.0, 2.0, 0.0, 900.0 + 20.0, 0.0, -2.0]);
    elevation_model(&dem, (240, 170), Some(own));
    let name = dem.to_str().expect("plain").to_string();
    succeeded(&sample.apply(&["--to", &name]));
    let read = transform_of(&dem);
    for (x, y) in [(0.0, 0.0), (240.0, 0.0), (0.0, 170.0)] {
        let in_image = PixelPoint { x: (x - 10.0) * 4.0, y: (y - 10.0) * 4.0 };
        let (a, b) = (TURNED.apply(in_image), read.apply(PixelPoint { x, y }));
        assert!((a.easting - b.easting).hypot(a.northing - b.northing) < 1e-8, "{a:?} {b:?}");
    }
    // Now its own georeference is covered by ours: a second time would move it twice.
    refused(&sample.apply(&["--to", &name, "--overwrite"]), &["dem.tif", "covered"]);
}

/// Cuts an image into tiles with a world file each, as photogrammetry programs deliver them.
fn cut(image: &Path, folder: &Path, side: u64, whole: &GeoTransform) -> Vec<(PathBuf, GeoTransform)> {
    std::fs::create_dir(folder).expect("a folder");
    let source = gdal::Dataset::open(image).expect("opens");
    let (width, height) = source.raster_size();
    let (bands, driver) = (source.raster_count(), gdal::DriverManager::get_driver_by_name("GTiff").expect("there"));
    let mut tiles = Vec::new();
    for y in (0..height).step_by(side as usize) {
        for x in (0..width).step_by(side as usize) {
            let size = ((width - x).min(side as usize), (height - y).min(side as usize));
            let path = folder.join(format!("tile_{}_{}.tif", y / side as usize, x / side as usize));
            let tile = driver.create_with_band_type::<u8, _>(&path, size.0, size.1, bands).expect("created");
            for number in 1..=bands {
                let pixels = source
                    .rasterband(number)
                    .and_then(|band| band.read_as::<u8>((x as isize, y as isize), size, size, None))
                    .expect("read");
                let mut pixels = pixels;
                tile.rasterband(number).expect("there").write((0, 0), size, &mut pixels).expect("written");
            }
            tile.close().expect("written");
            let g = whole.0;
            let corner = whole.apply(PixelPoint { x: x as f64, y: y as f64 });
            let own = GeoTransform([corner.easting, g[1], g[2], corner.northing, g[4], g[5]]);
            let text = autoref_stream::georef::sidecar::world_file(&own);
            std::fs::write(path.with_extension("tfw"), text).expect("written");
            tiles.push((path, own));
        }
    }
    tiles
}

#[test]
fn tiles_with_world_files_are_one_raster() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let text = |path: PathBuf| path.to_str().expect("plain").to_string();
    let size =
        ["--size", "1500,1100", "--extent-m", "40,30", "--random-gcps", "12", "--visible", "10", "--gsd", "0.03"];
    let marks = ["--rotation", "6", "--mark-size", "14", "--seed", "5"];
    let (whole, list) = (text(at("e6.tif")), text(at("e6.geojson")));
    let mut synth = vec!["synth", &whole, "--write-gcps", &list];
    synth.extend(size.iter().chain(&marks));
    succeeded(&autoref(&synth));
    succeeded(&autoref(&[&whole, "--gcps", &list, "--quiet"]));
    let expected = RunResult::read(&at("e6.autoref.json")).expect("written").geotransform().expect("solved");
    // Local coordinates with another origin and unit.
    let local = GeoTransform([1000.0, 0.5, 0.0, 5000.0, 0.0, -0.5]);
    let tiles = cut(Path::new(&whole), &at("tiles"), 400, &local);
    let before: Vec<Vec<u8>> = tiles.iter().map(|(path, _)| std::fs::read(path).expect("there")).collect();
    let dir = text(at("tiles"));
    succeeded(&autoref(&[&dir, "--gcps", &list, "--quiet", "--prior", "none"]));
    let result = RunResult::read(&at("tiles.autoref.json")).expect("written");
    let image = result.image.as_ref().expect("described");
    assert_eq!((image.width, image.height), (1500, 1100));
    let solved = result.geotransform().expect("solved");
    assert_eq!(solved, expected, "tiles or not, the same answer");
    assert!(difference_px(&solved, &transform_of(&at("tiles.vrt"))) < 1e-6);
    assert_eq!(gdal::Dataset::open(at("tiles.vrt")).expect("opens").raster_size(), (1500, 1100));
    // Everything else from the result; world files and tags go to every tile.
    let json = text(at("tiles.autoref.json"));
    refused(&autoref(&["apply", &json, "--write", "world"]), &["tfw", "exists"]);
    succeeded(&autoref(&["apply", &json, "--write", "warp,gcps,tags,aux", "--quiet"]));
    is_valid_cog(&at("tiles.warp.tif"));
    for (path, own) in &tiles {
        let corner = local.invert(own.apply(PixelPoint { x: 0.0, y: 0.0 })).expect("not singular");
        let g = solved.0;
        let map = solved.apply(corner);
        let new = GeoTransform([map.easting, g[1], g[2], map.northing, g[4], g[5]]);
        assert!(difference_px(&new, &transform_of(path)) < 1e-6, "{}", path.display());
        std::fs::remove_file(autoref_stream::georef::sidecar::aux_path(path)).expect("written above");
        assert!(difference_px(&new, &transform_of(path)) < 1e-6, "{} by its tags", path.display());
    }
    // Rotated as they are now, the tiles still lie on one grid.
    assert_eq!(autoref_raster::size(&at("tiles"), 0).expect("a mosaic"), (1500, 1100));
    let names: Vec<String> = tiles.iter().map(|(path, _)| text(path.clone())).collect();
    let mut undo = vec!["undo", "--quiet"];
    undo.extend(names.iter().map(String::as_str));
    succeeded(&autoref(&undo));
    for ((path, _), before) in tiles.iter().zip(&before) {
        assert!(*before == std::fs::read(path).expect("there"), "{}", path.display());
    }
    tiles_that_do_not_fit(&at("tiles"), &at("tiles.txt"));
}

/// GDAL's own tiler cuts the image into 40 tiles of a tile map: the folder and its XML give the candidates of the one
/// file.
#[test]
fn forty_tiles_by_xml_are_the_image() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("plain").to_string();
    let (whole, list) = (at("e6.tif"), at("e6.geojson"));
    let shape =
        ["--size", "2048,1280", "--extent-m", "54,34", "--random-gcps", "14", "--visible", "11", "--gsd", "0.03"];
    let mut synth = vec!["synth", &whole, "--write-gcps", &list, "--georeferenced", "--seed", "8", "--mark-size", "14"];
    synth.extend(shape);
    succeeded(&autoref(&synth));
    let tiles = at("tiles");
    let tiler =
        Command::new("gdal2tiles.py").args(["-q", "-p", "raster", "-z", "3", "-w", "none", &whole, &tiles]).output();
    let Ok(cut) = tiler else {
        return crate::common::skipped("gdal2tiles.py is absent");
    };
    assert!(cut.status.success(), "{}", String::from_utf8_lossy(&cut.stderr));
    let xml = at("tiles/tilemapresource.xml");
    let detect = |image: &str| {
        let out = at("list.csv");
        succeeded(&autoref(&["detect", image, "-o", &out, "--overwrite"]));
        std::fs::read(&out).expect("written")
    };
    let one = detect(&whole);
    assert!(one.iter().filter(|byte| **byte == b'\n').count() > 8);
    assert!(detect(&tiles) == one && detect(&xml) == one, "other candidates by tiles");
    // Solved as one raster, where the XML says that it lies.
    succeeded(&autoref(&[&xml, "--gcps", &list, "--quiet"]));
    // A tile that is not there holds nothing; a description that is broken is named.
    std::fs::remove_file(at("tiles/3/2/3.png")).expect("there");
    assert_eq!(autoref_raster::size(Path::new(&tiles), 0).expect("a mosaic"), (2048, 1280));
    std::fs::write(&xml, "<TileMap><TileSets/></TileMap>").expect("written");
    refused(&autoref(&["detect", &tiles]), &["tilemapresource.xml", "TileFormat"]);
}

/// One clear line that names the tile.
fn tiles_that_do_not_fit(folder: &Path, list: &Path) {
    let line = || {
        let message = autoref_raster::size(folder, 0).expect_err("it does not fit").to_string();
        assert!(!message.contains('\n'), "{message}");
        message
    };
    let world = folder.join("tile_1_1.tfw");
    let original = std::fs::read_to_string(&world).expect("there");
    let mut lines: Vec<String> = original.lines().map(String::from).collect();
    lines[4] = (lines[4].parse::<f64>().expect("a number") + 0.2).to_string();
    std::fs::write(&world, lines.join("\n")).expect("written");
    let message = line();
    assert!(message.contains("tile_1_1.tif") && message.contains("no whole number"), "{message}");
    std::fs::remove_file(&world).expect("there");
    assert!(line().contains("no georeference of its own"), "{}", line());
    std::fs::write(&world, original).expect("written");
    std::fs::write(list, "# three of them\ntiles/tile_0_0.tif\n\ntiles/tile_0_1.tif\ntiles/tile_1_1.tif\n")
        .expect("written");
    assert_eq!(autoref_raster::size(list, 0).expect("a mosaic"), (800, 800));
    std::fs::write(list, "tiles/tile_0_0.tif\ntiles/none.tif\n").expect("written");
    let message = autoref_raster::size(list, 0).expect_err("absent").to_string();
    assert!(message.contains("line 2") && message.contains("none.tif"), "{message}");
    std::fs::remove_file(list).expect("there");
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

/// 2 GB on demand, 0.1 GB always.
#[test]
fn warping_stays_within_the_budget() {
    let sample = Sample::new(TURNED);
    let side = if crate::common::large() { 26_000 } else { 6_000 };
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let options = RasterCreationOptions::from_iter(["TILED=YES", "BIGTIFF=IF_SAFER"]);
    let dataset = driver
        .create_with_band_type_with_options::<u8, _>(sample.path("e6.tif"), side, side, 3, &options)
        .expect("created");
    for band in 1..=3 {
        dataset.rasterband(band).expect("there").fill(90.0, None).expect("filled");
    }
    dataset.close().expect("written");
    let text = std::fs::read_to_string(sample.path("e6.autoref.json")).expect("there");
    let mut result: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    result["image"]["width"] = side.into();
    result["image"]["height"] = side.into();
    std::fs::write(sample.path("e6.autoref.json"), result.to_string()).expect("written");
    let output = sample.apply(&["--write", "warp", "--memory", "176M", "--threads", "8", "--json"]);
    succeeded(&output);
    let said: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one document");
    let peak = said["peak_memory_bytes"].as_u64().expect("measured");
    eprintln!("warping {:.1} GB: peak {:.0} MiB of 176", (side * side * 3) as f64 / 1e9, peak as f64 / 1_048_576.0);
    assert!(peak < 176 << 20, "{peak} bytes");
    is_valid_cog(&sample.path("e6.warp.tif"));
}
