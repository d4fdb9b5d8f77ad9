//! The elevation model beside the image gets the same outputs.

use std::path::Path;

use super::{SIZE, Sample, TURNED, refused, succeeded, transform_of};
use autoref_raster::coords::{GeoTransform, PixelPoint};
use gdal::raster::Buffer;

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
