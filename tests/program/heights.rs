//! Elevation models against the survey: in the image's grid, in map coordinates, in another CRS, with holes.

use std::path::Path;

use crate::common::Random;
use assert_cmd::Command;
use autoref_raster::ElevationModel;
use autoref_raster::coords::{GeoTransform, MapPoint, PixelPoint};
use gdal::raster::{Buffer, RasterCreationOptions};
use gdal::spatial_ref::SpatialRef;

const SIZE: (f64, f64) = (1600.0, 1200.0);
const GSD: f64 = 0.05;
/// Rotated a little, in UTM 32.
const TRUTH: GeoTransform = GeoTransform([570_000.0, GSD * 0.999, GSD * 0.04, 7_032_000.0, GSD * 0.04, -GSD * 0.999]);

fn ground(m: MapPoint) -> f64 {
    80.0 + 0.02 * (m.easting - 570_000.0) - 0.01 * (m.northing - 7_032_000.0)
}

/// What the model is too low by: a bowl.
fn doming(m: MapPoint) -> f64 {
    let (e, n) = (m.easting - 570_040.0, m.northing - 7_031_970.0);
    1.5 + 2e-4 * (e * e + n * n)
}

/// 14 marks, their list and their candidates among 40 false ones.
fn lists(folder: &Path) -> Vec<(PixelPoint, MapPoint)> {
    let mut random = Random::new(4);
    let marks: Vec<(PixelPoint, MapPoint)> = (0..14)
        .map(|_| PixelPoint { x: random.uniform(50.0, 1550.0), y: random.uniform(50.0, 1150.0) })
        .map(|p| (p, TRUTH.apply(p)))
        .collect();
    let mut list = String::from("name,easting,northing,height\n");
    let mut candidates = String::from("x,y\n");
    for (i, (p, m)) in marks.iter().enumerate() {
        list += &format!("P{i},{:.4},{:.4},{:.4}\n", m.easting, m.northing, ground(*m) + 0.003 * random.normal());
        candidates += &format!("{:.3},{:.3}\n", p.x, p.y);
    }
    for _ in 0..40 {
        candidates += &format!("{:.3},{:.3}\n", random.uniform(0.0, SIZE.0), random.uniform(0.0, SIZE.1));
    }
    std::fs::write(folder.join("list.csv"), list).expect("writable");
    std::fs::write(folder.join("candidates.csv"), candidates).expect("writable");
    marks
}

/// A model whose pixel (x, y) lies at `place(x, y)` on the map; a hole of nodata in one corner.
fn model(
    path: &Path,
    size: (usize, usize),
    gdal_place: Option<(GeoTransform, u32)>,
    place: &dyn Fn(PixelPoint) -> MapPoint,
) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let options = RasterCreationOptions::from_iter(["TILED=YES", "COMPRESS=LZW"]);
    let mut file =
        driver.create_with_band_type_with_options::<f32, _>(path, size.0, size.1, 1, &options).expect("created");
    if let Some((g, epsg)) = gdal_place {
        file.set_geo_transform(&g.0).expect("set");
        file.set_spatial_ref(&SpatialRef::from_epsg(epsg).expect("known")).expect("set");
    }
    let mut heights = Vec::with_capacity(size.0 * size.1);
    for y in 0..size.1 {
        for x in 0..size.0 {
            let m = place(PixelPoint { x: x as f64 + 0.5, y: y as f64 + 0.5 });
            let hole = x < 20 && y < 20;
            heights.push(if hole { -32767.0 } else { (ground(m) - doming(m)) as f32 });
        }
    }
    let mut band = file.rasterband(1).expect("one band");
    band.set_no_data_value(Some(-32767.0)).expect("set");
    band.write((0, 0), size, &mut Buffer::new(size, heights)).expect("written");
}

fn solve(folder: &Path, more: &[&str]) -> serde_json::Value {
    let output = Command::cargo_bin("autoref-stream")
        .expect("built")
        .current_dir(folder)
        .args(["solve", "candidates.csv", "--gcps", "list.csv", "--crs", "EPSG:25832", "--size", "1600,1200"])
        .args(["--gsd", "0.05", "--json"])
        .args(more)
        .output()
        .expect("it runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    println!("{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn check_copy(
    path: &Path,
    marks: &[(PixelPoint, MapPoint)],
    read: &dyn Fn(&ElevationModel, PixelPoint, MapPoint) -> Option<f64>,
) {
    let copy = ElevationModel::open(path).expect("our own file");
    for &(p, m) in marks {
        let height = read(&copy, p, m).expect("the marks lie on it");
        assert!((height - ground(m)).abs() < 0.02, "{height} for {}", ground(m));
    }
    let hole = copy.read_f64_window(autoref_raster::window::Window::new(3, 3, 1, 1)).expect("in the raster");
    assert!(hole[0].is_nan(), "pixels without a height stay without");
}

#[test]
fn a_model_in_the_images_grid_is_read_there_and_corrected() {
    let folder = tempfile::tempdir().expect("a folder");
    let marks = lists(folder.path());
    // The same picture at half the resolution, without a georeference.
    let place = |p: PixelPoint| TRUTH.apply(PixelPoint { x: 2.0 * p.x, y: 2.0 * p.y });
    model(&folder.path().join("dem.tif"), (800, 600), None, &place);
    let result = solve(folder.path(), &["--dem", "dem.tif", "--write-dem", "flat.tif"]);
    let heights = &result["heights"];
    assert_eq!(heights["frame"], "image");
    assert_eq!(heights["correction"]["chosen"], "quadratic");
    assert!(heights["correction"]["fits"][2]["leave_one_out_rms_m"].as_f64().expect("a number") < 0.02);
    check_copy(&folder.path().join("flat.tif"), &marks, &|copy, p, _| {
        copy.at_pixel(PixelPoint { x: p.x / 2.0, y: p.y / 2.0 }).expect("readable")
    });
    // The copy is georeferenced, so its map coordinates serve as well.
    let copy = ElevationModel::open(&folder.path().join("flat.tif")).expect("our own file");
    let (_, m) = marks[3];
    assert!((copy.at_map(m).expect("readable").expect("inside") - ground(m)).abs() < 0.02);
    // Nothing is written over it unasked.
    let again = Command::cargo_bin("autoref-stream")
        .expect("built")
        .current_dir(folder.path())
        .args(["solve", "candidates.csv", "--gcps", "list.csv", "--size", "1600,1200"])
        .args(["--dem", "dem.tif", "--write-dem", "flat.tif"])
        .output()
        .expect("it runs");
    assert_eq!(again.status.code(), Some(2));
}

/// Programs write counted pixels as the georeference of a raster that has none.
#[test]
fn a_model_that_counts_pixels_is_in_the_images_grid() {
    let folder = tempfile::tempdir().expect("a folder");
    lists(folder.path());
    let place = |p: PixelPoint| TRUTH.apply(PixelPoint { x: 4.0 * p.x, y: 4.0 * p.y });
    let path = folder.path().join("dem.tif");
    model(&path, (400, 300), None, &place);
    let text = "<PAMDataset><GeoTransform>0, 1, 0, 0, 0, 1</GeoTransform></PAMDataset>";
    std::fs::write(folder.path().join("dem.tif.aux.xml"), text).expect("writable");
    assert!(ElevationModel::open(&path).expect("ours").geotransform().is_some_and(|own| own.counts_pixels()));
    let heights = solve(folder.path(), &["--dem", "dem.tif"])["heights"].clone();
    assert_eq!((&heights["frame"], heights["points"].as_array().map(Vec::len)), (&"image".into(), Some(14)));
}

/// A model that covers few of the marks may have been placed wrongly: two of fourteen points fit without a word.
#[test]
fn a_model_without_heights_at_most_marks_is_told() {
    let folder = tempfile::tempdir().expect("a folder");
    let marks = lists(folder.path());
    let at = |east: f64| GeoTransform([east, 0.5, 0.0, 7_032_030.0, 0.0, -0.5]);
    let mut east: Vec<f64> = marks.iter().map(|(_, m)| m.easting).collect();
    east.sort_by(f64::total_cmp);
    let warnings = |first: f64| {
        let grid = at(first);
        model(&folder.path().join("dem.tif"), (300, 260), Some((grid, 25832)), &|p| grid.apply(p));
        let heights = &solve(folder.path(), &["--dem", "dem.tif"])["heights"];
        heights["warnings"].to_string()
    };
    let few = warnings((east[10] + east[11]) / 2.0);
    assert!(few.contains("no height at 11 of the 14 points"), "{few}");
    assert!(!warnings(east[0] - 10.0).contains("no height at"));
}

/// Its first band passed for heights.
#[test]
fn a_photograph_is_no_elevation_model() {
    let folder = tempfile::tempdir().expect("a folder");
    lists(folder.path());
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let photo = driver.create_with_band_type::<u8, _>(folder.path().join("photo.tif"), 400, 300, 3).expect("created");
    photo.close().expect("written");
    let output = Command::cargo_bin("autoref-stream")
        .expect("built")
        .current_dir(folder.path())
        .args(["solve", "candidates.csv", "--gcps", "list.csv", "--size", "1600,1200", "--dem", "photo.tif"])
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(["photo.tif", "3 bands", "gdal_translate -b 1"].iter().all(|word| said.contains(word)), "{said}");
}

/// A copy of a model in other numbers: stored values are (height − offset) / scale in the unit.
fn restated(from: &Path, to: &Path, scale: f64, offset: f64, unit: Option<&str>) {
    let model = ElevationModel::open(from).expect("ours");
    let (width, height) = model.size();
    let whole = autoref_raster::window::Window::whole(width, height);
    let stored = model.read_f64_window(whole).expect("readable").into_iter();
    let stored = stored.map(|h| if h.is_nan() { -32768 } else { ((h - offset) / scale).round() as i16 }).collect();
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let size = (width as usize, height as usize);
    let mut copy = driver.create_with_band_type::<i16, _>(to, size.0, size.1, 1).expect("created");
    copy.set_geo_transform(&model.geotransform().expect("placed").0).expect("set");
    copy.set_spatial_ref(&SpatialRef::from_epsg(25832).expect("known")).expect("set");
    let mut band = copy.rasterband(1).expect("one band");
    band.write((0, 0), size, &mut Buffer::new(size, stored)).expect("written");
    match unit {
        Some(unit) => autoref_raster::set_height_unit(to, &copy, unit).expect("named"),
        None => band.set_scale(scale).and_then(|()| band.set_offset(offset)).expect("labelled"),
    }
}

#[test]
fn scale_offset_and_unit_of_a_model_are_heeded() {
    let folder = tempfile::tempdir().expect("a folder");
    let marks = lists(folder.path());
    let path = |name: &str| folder.path().join(name);
    let place = GeoTransform([569_990.0, 0.5, 0.0, 7_032_020.0, 0.0, -0.5]);
    model(&path("dem.tif"), (200, 200), Some((place, 25832)), &|p| place.apply(p));
    restated(&path("dem.tif"), &path("scaled.tif"), 0.01, 40.0, None);
    restated(&path("dem.tif"), &path("feet.tif"), 0.3048, 0.0, Some("ft"));
    let uncorrected = |name: &str, copy: &str| {
        let result = solve(folder.path(), &["--dem", name, "--write-dem", copy]);
        result["heights"]["correction"]["uncorrected_rms_m"].as_f64().expect("a number")
    };
    let plain = uncorrected("dem.tif", "plain-copy.tif");
    // The scaled heights are rounded to centimetres, those in whole feet to 9 cm (1σ).
    assert!((uncorrected("scaled.tif", "scaled-copy.tif") - plain).abs() < 0.01);
    assert!((uncorrected("feet.tif", "feet-copy.tif") - plain).abs() < 0.15);
    check_copy(&path("scaled-copy.tif"), &marks, &|copy, _, m| copy.at_map(m).expect("readable"));
    let feet = ElevationModel::open(&path("feet-copy.tif")).expect("ours");
    assert_eq!(feet.band().unit_name.as_deref(), Some("ft"));
    for (_, m) in marks {
        let height = feet.at_map(m).expect("readable").expect("there");
        assert!((height - ground(m)).abs() < 0.5, "{height} for {}", ground(m));
    }
}

#[test]
fn a_model_in_map_coordinates_may_have_another_crs() {
    let folder = tempfile::tempdir().expect("a folder");
    let marks = lists(folder.path());
    let grid = GeoTransform([569_980.0, 0.5, 0.0, 7_032_030.0, 0.0, -0.5]);
    model(&folder.path().join("dem.tif"), (300, 260), Some((grid, 25832)), &|p| grid.apply(p));
    let result = solve(folder.path(), &["--dem", "dem.tif", "--write-dem", "flat.tif"]);
    assert_eq!(result["heights"]["frame"], "map");
    assert_eq!(result["heights"]["correction"]["chosen"], "quadratic");
    check_copy(&folder.path().join("flat.tif"), &marks, &|copy, _, m| copy.at_map(m).expect("readable"));
    // The same ground in UTM 33, where grids are turned by five degrees.
    let (from, to) = (
        autoref_raster::crs::Crs::from_epsg(25833).expect("a zone"),
        autoref_raster::crs::Crs::from_epsg(25832).expect("a zone"),
    );
    let convert = |m: MapPoint, from: &autoref_raster::crs::Crs, to: &autoref_raster::crs::Crs| {
        let mut p = [autoref_raster::crs::Coordinate { x: m.easting, y: m.northing, height: None }];
        from.transform(&mut p, to, 1.0).expect("a projection");
        MapPoint { easting: p[0].x, northing: p[0].y }
    };
    let corner = convert(MapPoint { easting: 569_960.0, northing: 7_032_060.0 }, &to, &from);
    let grid = GeoTransform([corner.easting - 20.0, 2.0, 0.0, corner.northing + 20.0, 0.0, -2.0]);
    // All cells by one transformation: each costs milliseconds.
    let mut cells: Vec<autoref_raster::crs::Coordinate> = (0..90 * 90)
        .map(|i| grid.apply(PixelPoint { x: f64::from(i % 90) + 0.5, y: f64::from(i / 90) + 0.5 }))
        .map(|m| autoref_raster::crs::Coordinate { x: m.easting, y: m.northing, height: None })
        .collect();
    from.transform(&mut cells, &to, 1.0).expect("a projection");
    model(&folder.path().join("dem33.tif"), (90, 90), Some((grid, 25833)), &|p| {
        let cell = &cells[p.y as usize * 90 + p.x as usize];
        MapPoint { easting: cell.x, northing: cell.y }
    });
    let result = solve(folder.path(), &["--dem", "dem33.tif", "--write-dem", "flat33.tif"]);
    assert_eq!(result["heights"]["position_crs"], "EPSG:25833");
    check_copy(&folder.path().join("flat33.tif"), &marks, &|copy, _, m| {
        copy.at_map(convert(m, &to, &from)).expect("readable")
    });
}

#[test]
fn a_model_that_fits_nowhere_is_refused_in_one_line() {
    let folder = tempfile::tempdir().expect("a folder");
    lists(folder.path());
    model(&folder.path().join("dem.tif"), (300, 260), None, &|p| TRUTH.apply(p));
    let output = Command::cargo_bin("autoref-stream")
        .expect("built")
        .current_dir(folder.path())
        .args(["solve", "candidates.csv", "--gcps", "list.csv", "--size", "1600,1200", "--dem", "dem.tif"])
        .output()
        .expect("it runs");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no georeference"));
}

#[test]
fn other_models_and_every_solver_answer() {
    let folder = tempfile::tempdir().expect("a folder");
    let marks = lists(folder.path());
    model(&folder.path().join("dem.tif"), (1600, 1200), None, &|p| TRUTH.apply(p));
    let mut scales = Vec::new();
    for solver in ["horn", "horn-hilden", "umeyama", "umeyama-horn-scale", "kraus"] {
        let result = solve(folder.path(), &["--dem", "dem.tif", "--model", "7-parameter", "--solver", solver]);
        let model = &result["chosen_model"];
        scales.push(model["scale"].as_f64().expect("a number"));
        assert!(model["rmse_m"].as_f64().expect("a number") < 1.0, "{solver}: {model}");
    }
    assert!(scales.iter().all(|s| (s - 1.0).abs() < 1e-3), "{scales:?}");
    assert!((scales[2] - scales[4]).abs() < 1e-9, "Kraus ends at Umeyama's solution");
    let result = solve(folder.path(), &["--model", "affine"]);
    assert_eq!(result["chosen_model"]["model"], "affine");
    let g: Vec<f64> = serde_json::from_value(result["geotransform"].clone()).expect("six numbers");
    let affine = GeoTransform(g.try_into().expect("six numbers"));
    for (p, m) in marks {
        let at = affine.apply(p);
        assert!((at.easting - m.easting).hypot(at.northing - m.northing) < 0.01);
    }
    assert_eq!(solve(folder.path(), &["--model", "projective"])["chosen_model"]["model"], "projective");
}

/// A model whose cells are half a metre up and down by turns: heights over an area forget it, those at the place do
/// not.
#[test]
fn heights_over_an_area_are_means_of_its_cells() {
    let folder = tempfile::tempdir().expect("a folder");
    lists(folder.path());
    let grid = GeoTransform([569_980.0, 0.5, 0.0, 7_032_030.0, 0.0, -0.5]);
    let path = folder.path().join("dem.tif");
    model(&path, (300, 260), Some((grid, 25832)), &|p| grid.apply(p));
    let options =
        gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..gdal::DatasetOptions::default() };
    let file = gdal::Dataset::open_ex(&path, options).expect("our own");
    let mut band = file.rasterband(1).expect("one band");
    let mut cells = band.read_as::<f32>((0, 0), (300, 260), (300, 260), None).expect("read");
    for (i, height) in cells.data_mut().iter_mut().enumerate() {
        *height += if (i % 300 + i / 300) % 2 == 0 { 0.5 } else { -0.5 };
    }
    band.write((0, 0), (300, 260), &mut cells).expect("written");
    file.close().expect("written");
    let rms = |cells: &str| {
        let result = solve(folder.path(), &["--dem", "dem.tif", "--dem-area", cells]);
        let correction = &result["heights"]["correction"];
        let fits = correction["fits"].as_array().expect("surfaces");
        let quadratic = fits.iter().find(|fit| fit["model"] == "quadratic").expect("determined");
        quadratic["rms_m"].as_f64().expect("a number")
    };
    // At the place the heights between four cells vary by up to half a metre; the mean of 5 × 5 is off by at most a
    // 25th of it.
    let (at_place, over_area) = (rms("1"), rms("5"));
    assert!(at_place > 0.05 && over_area < 0.03, "{at_place} m at the place, {over_area} m over 5 × 5 cells");
}
