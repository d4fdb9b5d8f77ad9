//! What a file says beside its samples: georeference wherever it stands, pages, masks, full white, heights.

use std::path::{Path, PathBuf};

use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use autoref_raster::window::Window;
use autoref_raster::{ElevationModel, RasterInfo, ReaderChoice, open, read_patch};
use gdal::raster::{Buffer, GdalType, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DatasetOptions, DriverManager, GdalOpenFlags, Metadata};

const CACHE: u64 = 16 << 20;
const GEOTRANSFORM: [f64; 6] = [570_000.0, 0.25, 0.0, 7_032_000.0, 0.0, -0.25];

fn create<T: GdalType + Copy>(path: &Path, bands: usize, value: T, options: &[&str]) -> Dataset {
    let mut list = RasterCreationOptions::new();
    for option in options {
        let (key, value) = option.split_once('=').expect("KEY=VALUE");
        list.set_name_value(key, value).expect("no zero bytes");
    }
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has GeoTIFF");
    let dataset = driver.create_with_band_type_with_options::<T, _>(path, 40, 30, bands, &list).expect("GDAL creates");
    for band in 1..=bands {
        let mut buffer = Buffer::new((40, 30), vec![value; 1200]);
        dataset.rasterband(band).expect("a band").write((0, 0), (40, 30), &mut buffer).expect("GDAL writes");
    }
    dataset
}

/// What both readers say, which must be the same.
fn info(path: &Path) -> RasterInfo {
    let native = open(path, ReaderChoice::Native, 0, CACHE).expect("readable").info().clone();
    let gdal = open(path, ReaderChoice::Gdal, 0, CACHE).expect("readable").info().clone();
    assert_eq!(native.geotransform, gdal.geotransform);
    assert_eq!(native.crs_wkt, gdal.crs_wkt);
    assert_eq!(native.white, gdal.white);
    assert_eq!(native.nodata, gdal.nodata);
    assert_eq!(native.resolution_m_per_px, gdal.resolution_m_per_px);
    native
}

fn folder() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    (folder, path)
}

#[test]
fn a_georeference_is_that_of_the_pixel_corner_wherever_it_stands() {
    for point in ["Area", "Point"] {
        let (_folder, path) = folder();
        let mut dataset = create::<u8>(&path, 3, 9, &[]);
        dataset.set_metadata_item("AREA_OR_POINT", point, "").expect("GDAL keeps it");
        dataset.set_geo_transform(&GEOTRANSFORM).expect("GDAL keeps it");
        dataset.set_spatial_ref(&SpatialRef::from_epsg(25_832).expect("PROJ knows it")).expect("GDAL keeps it");
        dataset.close().expect("GDAL writes");
        let info = info(&path);
        assert_eq!(info.geotransform, Some(GeoTransform(GEOTRANSFORM)), "{point}");
        assert!(info.crs_wkt.expect("it has one").contains("25832"), "{point}");
    }
}

#[test]
fn a_rotated_georeference_is_read() {
    let (_folder, path) = folder();
    let rotated = [570_000.0, 0.2, 0.05, 7_032_000.0, 0.05, -0.2];
    let mut dataset = create::<u8>(&path, 1, 9, &[]);
    dataset.set_geo_transform(&rotated).expect("GDAL keeps it");
    dataset.close().expect("GDAL writes");
    let got = info(&path).geotransform.expect("it has one").0;
    assert!(got.iter().zip(&rotated).all(|(a, b)| (a - b).abs() < 1e-9), "{got:?}");
}

#[test]
fn a_world_file_refers_to_the_centre_of_the_first_pixel() {
    let (_folder, path) = folder();
    create::<u8>(&path, 1, 9, &[]).close().expect("GDAL writes");
    assert_eq!(info(&path).geotransform, None);
    std::fs::write(path.with_extension("tfw"), "0.25\n0\n0\n-0.25\n570000.125\n7031999.875\n").expect("writable");
    assert_eq!(info(&path).geotransform, Some(GeoTransform(GEOTRANSFORM)));
}

#[test]
fn pages_are_images_and_not_their_overviews() {
    let (_folder, path) = folder();
    create::<u8>(&path, 1, 10, &[]).close().expect("GDAL writes");
    let update = || DatasetOptions { open_flags: GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let mut first = Dataset::open_ex(&path, update()).expect("it opens");
    first.build_overviews("NEAREST", &[2, 4], &[]).expect("GDAL makes overviews");
    first.close().expect("GDAL writes");
    create::<u8>(&path, 1, 20, &["APPEND_SUBDATASET=YES"]).close().expect("GDAL appends");
    for choice in [ReaderChoice::Native, ReaderChoice::Gdal] {
        for (page, value) in [(0, 10), (1, 20)] {
            let source = open(&path, choice, page, CACHE).expect("readable");
            assert_eq!((source.info().width, source.info().height), (40, 30));
            let patch = read_patch(&*source, Window::whole(40, 30)).expect("readable");
            assert!(patch.rgb.iter().all(|&pixel| pixel == [value; 3]), "page {page}");
        }
        let error = open(&path, choice, 2, CACHE).map(|_| ()).expect_err("there are two pages");
        assert!(error.to_string().contains("has 2 images"), "{error}");
    }
}

#[test]
fn a_mask_in_the_file_or_beside_it_makes_pixels_invalid() {
    for internal in ["YES", "NO"] {
        let (_folder, path) = folder();
        gdal::config::set_thread_local_config_option("GDAL_TIFF_INTERNAL_MASK", internal).expect("no zero bytes");
        let dataset = create::<u8>(&path, 3, 77, &["TILED=YES"]);
        let mut band = dataset.rasterband(1).expect("a band");
        band.create_mask_band(true).expect("GDAL makes a mask");
        let mut mask = band.open_mask_band().expect("it was just made");
        let holes = (0..1200).map(|i| if i % 40 < 10 { 0u8 } else { 255 }).collect();
        mask.write((0, 0), (40, 30), &mut Buffer::new((40, 30), holes)).expect("GDAL writes");
        dataset.close().expect("GDAL writes");
        let error = open(&path, ReaderChoice::Native, 0, CACHE).map(|_| ()).expect_err("masks go through GDAL");
        assert!(error.to_string().contains("mask"), "{error}");
        let source = open(&path, ReaderChoice::Auto, 0, CACHE).expect("readable");
        assert_eq!((source.info().reader, source.info().alpha), ("gdal", Some(3)));
        let patch = read_patch(&*source, Window::new(5, 3, 20, 20)).expect("readable");
        assert!(patch.rgb.iter().all(|&pixel| pixel == [77; 3]));
        assert!(patch.valid.iter().enumerate().all(|(i, &valid)| valid == (5 + i % 20 >= 10)), "{internal}");
    }
}

#[test]
fn full_white_follows_the_depth_of_the_camera() {
    for (options, tag, white) in
        [(&["NBITS=12"][..], None, 4095), (&[], Some("4095"), 4095), (&[], Some("4000"), 65_535), (&[], None, 65_535)]
    {
        let (_folder, path) = folder();
        let mut dataset = create::<u16>(&path, 1, 300, options);
        if let Some(value) = tag {
            dataset.set_metadata_item("TIFFTAG_MAXSAMPLEVALUE", value, "").expect("GDAL keeps it");
        }
        dataset.close().expect("GDAL writes");
        let source = open(&path, ReaderChoice::Auto, 0, CACHE).expect("readable");
        assert_eq!(source.info().white, white, "{options:?} {tag:?}");
        if options.is_empty() {
            assert_eq!(info(&path).white, white);
        }
    }
}

#[test]
fn resolution_tags_count_only_where_they_can_mean_the_ground() {
    for (per_unit, expected) in [("25", None), ("0.5", Some(0.02))] {
        let (_folder, path) = folder();
        let mut dataset = create::<u8>(&path, 1, 3, &[]);
        for (key, value) in
            [("TIFFTAG_XRESOLUTION", per_unit), ("TIFFTAG_YRESOLUTION", per_unit), ("TIFFTAG_RESOLUTIONUNIT", "3")]
        {
            dataset.set_metadata_item(key, value, "").expect("GDAL keeps it");
        }
        dataset.close().expect("GDAL writes");
        // 25 dots a centimetre is a scanner's, two centimetres a dot is a drone's.
        assert_eq!(info(&path).resolution_m_per_px, expected);
    }
}

#[test]
fn heights_are_bilinear_between_pixel_centres() {
    let (_folder, path) = folder();
    let mut dataset = create::<f32>(&path, 1, 0.0, &[]);
    let plane: Vec<f32> = (0..1200).map(|i| (i % 40) as f32 + 100.0 * (i / 40) as f32).collect();
    let mut band = dataset.rasterband(1).expect("a band");
    band.write((0, 0), (40, 30), &mut Buffer::new((40, 30), plane)).expect("GDAL writes");
    band.write((20, 20), (1, 1), &mut Buffer::new((1, 1), vec![-9999.0f32])).expect("GDAL writes");
    band.set_no_data_value(Some(-9999.0)).expect("GDAL keeps it");
    dataset.set_geo_transform(&GEOTRANSFORM).expect("GDAL keeps it");
    dataset.close().expect("GDAL writes");
    let model = ElevationModel::open(&path).expect("readable");
    assert_eq!(model.size(), (40, 30));
    let at = |x, y| model.at_pixel(PixelPoint { x, y }).expect("readable");
    assert_eq!(at(0.5, 0.5), Some(0.0));
    assert_eq!(at(3.25, 7.75), Some(2.75 + 725.0));
    assert_eq!(at(0.1, 0.2), Some(0.0));
    assert_eq!(at(40.0, 30.0), Some(39.0 + 2900.0));
    assert_eq!(at(40.1, 3.0), None);
    assert_eq!(at(20.7, 20.7), None);
    assert_eq!(at(19.5, 19.5), Some(19.0 + 1900.0));
    let map = MapPoint { easting: 570_000.0 + 0.25 * 3.25, northing: 7_032_000.0 - 0.25 * 7.75 };
    assert!((model.at_map(map).expect("readable").expect("inside") - 727.75).abs() < 1e-6);
    let row = model.read_f64_window(Window::new(19, 20, 3, 1)).expect("readable");
    assert_eq!((row[0], row[2]), (2019.0, 2021.0));
    assert!(row[1].is_nan());
    assert!(model.read_f64_window(Window::new(39, 0, 2, 1)).is_err());
}

#[test]
fn a_float_image_is_refused_with_the_command_that_converts_it() {
    let (_folder, path) = folder();
    create::<f32>(&path, 1, 0.5, &[]).close().expect("GDAL writes");
    for choice in [ReaderChoice::Auto, ReaderChoice::Gdal] {
        let error = open(&path, choice, 0, CACHE).map(|_| ()).expect_err("no image").to_string();
        assert!(error.contains("Float32") && error.contains("gdal_translate -ot Byte -scale"), "{error}");
    }
    let error = open(&path, ReaderChoice::Native, 0, CACHE).map(|_| ()).expect_err("no image").to_string();
    assert!(error.contains("floating-point samples (tag 339 is 3) by the native reader"), "{error}");
}

#[test]
fn gdals_own_paths_are_given_to_it_as_they_are() {
    let (_folder, path) = folder();
    create::<u8>(&path, 3, 88, &["TILED=YES"]).close().expect("GDAL writes");
    let virtual_path = PathBuf::from(format!("/vsisubfile/0,{}", path.display()));
    let source = open(&virtual_path, ReaderChoice::Auto, 0, CACHE).expect("readable");
    assert_eq!(source.info().reader, "gdal");
    let patch = read_patch(&*source, Window::new(1, 2, 30, 20)).expect("readable");
    assert!(patch.rgb.iter().all(|&pixel| pixel == [88; 3]));
    let error = open(&virtual_path, ReaderChoice::Native, 0, CACHE).map(|_| ()).expect_err("not a local file");
    assert!(error.to_string().contains("local files only"), "{error}");
    let missing = open(Path::new("/vsisubfile/0,/nowhere.tif"), ReaderChoice::Auto, 0, CACHE).map(|_| ());
    assert!(missing.expect_err("there is no such file").to_string().contains("nowhere.tif"));
}

/// A file of a hundred bytes may claim billions of rows.
#[test]
fn a_sparse_strip_of_billions_of_rows_is_refused() {
    let (_folder, path) = folder();
    let rows = i32::MAX as u32;
    // Width, height, bits, no compression, black is zero, one strip at 0, one sample, rows a strip, no bytes.
    let tags: [(u16, u32); 9] =
        [(256, 9_000_000), (257, rows), (258, 8), (259, 1), (262, 1), (273, 0), (277, 1), (278, rows), (279, 0)];
    let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
    bytes.extend((tags.len() as u16).to_le_bytes());
    for (tag, value) in tags {
        bytes.extend(tag.to_le_bytes());
        bytes.extend(4u16.to_le_bytes());
        bytes.extend(1u32.to_le_bytes());
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend([0; 4]);
    std::fs::write(&path, bytes).expect("written");
    let refused = open(&path, ReaderChoice::Native, 0, CACHE).map(|_| ()).expect_err("too many strips").to_string();
    assert!(refused.contains("2147483647 strips"), "{refused}");
}
