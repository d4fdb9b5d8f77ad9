//! The warped copy: its pixels, compressions, borders and memory.

use super::{SIZE, Sample, TURNED, is_valid_cog, refused, slope_at, succeeded, transform_of};
use autoref_raster::coords::PixelPoint;
use gdal::Metadata;
use gdal::raster::RasterCreationOptions;

/// The value under every pixel of the copy is that of the image at the same place on the map: bilinear interpolation
/// keeps a slope, so a shift of a hundredth of a pixel would show.
pub(super) fn warped_copy_agrees(sample: &Sample) {
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
