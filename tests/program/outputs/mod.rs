//! One result, all outputs: every one read back by its own rules, and nothing half-written when something fails.

mod beside;
mod elevation_model;
mod exif;
mod failures;
mod tiles;
mod transform;
mod warped;

use std::path::{Path, PathBuf};
use std::process::{Command, Output as Ran};

use autoref_raster::coords::{GeoTransform, PixelPoint};
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
