//! What files say of their cells is heeded: alpha bands, masks, scale and offset, units; and what is written says it.

#[path = "as_files_say/borders.rs"]
mod borders;
#[path = "as_files_say/joining.rs"]
mod joining;
#[path = "as_files_say/references.rs"]
mod references;
#[path = "as_files_say/sparse.rs"]
mod sparse;
#[path = "as_files_say/stretched.rs"]
mod stretched;
#[path = "as_files_say/unlike.rs"]
mod unlike;
#[path = "as_files_say/zeros.rs"]
mod zeros;

use std::path::{Path, PathBuf};

use autoref_elevation::align::{Degree, Method, Outcome};
use autoref_elevation::compare::CompareJob;
use autoref_elevation::derive;
use autoref_elevation::files::{AlignJob, Resources};
use autoref_elevation::gradient::{self, Picture};
use autoref_elevation::mosaic::{Choice, MosaicJob};
use autoref_elevation::resample::Interpolation;
use gdal::raster::{Buffer, ColorInterpretation, GdalType};
use gdal::spatial_ref::SpatialRef;
use gdal::{Dataset, DriverManager};

const SIDE: usize = 120;
const MEMORY: u64 = 256 << 20;

fn create<T: GdalType>(path: &Path, size: (usize, usize), bands: usize, crs: &str, transform: [f64; 6]) -> Dataset {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
    let mut set = driver.create_with_band_type::<T, _>(path, size.0, size.1, bands).expect("a file");
    set.set_geo_transform(&transform).expect("a place");
    let reference = SpatialRef::from_definition(crs).expect("PROJ knows it");
    set.set_spatial_ref(&reference).expect("a CRS");
    set
}

fn put<T: GdalType + Copy>(set: &Dataset, band: usize, values: Vec<T>) {
    let size = set.raster_size();
    set.rasterband(band).expect("a band").write((0, 0), size, &mut Buffer::new(size, values)).expect("written");
}

fn read(path: &Path, band: usize) -> Vec<f64> {
    let set = Dataset::open(path).expect("a raster");
    let size = set.raster_size();
    set.rasterband(band).expect("a band").read_as::<f64>((0, 0), size, size, None).expect("values").data().to_vec()
}

/// Hills, moved by so many cells.
fn hills(dx: f64, dy: f64) -> Vec<f32> {
    let height = |x: f64, y: f64| {
        500.0 + 60.0 * (x / 11.0).sin() * (y / 14.0).cos() + 25.0 * (x / 5.0 + y / 7.0).sin() + 0.4 * x
    };
    (0..SIDE * SIDE).map(|i| height((i % SIDE) as f64 + dx, (i / SIDE) as f64 + dy) as f32).collect()
}

fn model(path: &Path, crs: &str, values: Vec<f32>, step_y: f64) -> PathBuf {
    let top = if step_y < 0.0 { 8_700_000.0 } else { 8_700_000.0 - SIDE as f64 * step_y };
    let set = create::<f32>(path, (SIDE, SIDE), 1, crs, [500_000.0, 10.0, 0.0, top, 0.0, step_y]);
    put(&set, 1, values);
    path.to_path_buf()
}

fn resources() -> Resources {
    Resources { tile_px: None, threads: 2, memory_budget_bytes: MEMORY }
}

fn compare(a: &Path, b: &Path, zones: Option<&Path>, folder: &Path) -> autoref_elevation::compare::Summary {
    std::fs::create_dir_all(folder).expect("a folder");
    let job = CompareJob {
        a,
        b,
        zones,
        resampling: Interpolation::Bilinear,
        slope_limits: &[0.0, 10.0],
        within_m: 1.0,
        outliers: None,
        resources: resources(),
    };
    job.run(folder).expect("compared")
}

#[test]
fn scaled_heights_are_heights() {
    let folder = tempfile::tempdir().expect("a folder");
    let b = model(&folder.path().join("b.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let a = folder.path().join("a.tif");
    let set = create::<i16>(&a, (SIDE, SIDE), 1, "EPSG:32633", [500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]);
    put(&set, 1, hills(0.0, 0.0).iter().map(|z| ((f64::from(*z) + 2.0 - 400.0) / 0.02).round() as i16).collect());
    let mut band = set.rasterband(1).expect("a band");
    band.set_scale(0.02).and_then(|()| band.set_offset(400.0)).expect("labelled");
    drop(set);
    let found = compare(&a, &b, None, &folder.path().join("c"));
    assert!((found.mean_m.expect("cells") - 2.0).abs() < 1e-3, "{:?}", found.mean_m);
}

/// The mean of a model over coarser cells differs from the model by nothing, whatever the ratio of the cells.
#[test]
fn finer_cells_are_compared_as_means_of_any_ratio() {
    let folder = tempfile::tempdir().expect("a folder");
    let rough = |x: usize, y: usize| ((x * 7919 + y * 104_729 + x * y * 31) % 211) as f64;
    let fine = (0..SIDE * SIDE).map(|i| rough(i % SIDE, i / SIDE) as f32).collect();
    let a = model(&folder.path().join("a.tif"), "EPSG:32633", fine, -10.0);
    for ratio in [1.5, 2.5, 3.0] {
        let side = (SIDE as f64 / ratio) as usize;
        let share = |k: usize, cell: usize| {
            let (low, high) = (k as f64 * ratio, (k + 1) as f64 * ratio);
            (high.min(cell as f64 + 1.0) - low.max(cell as f64)).max(0.0) / ratio
        };
        let under = |k: usize| (k as f64 * ratio) as usize..((k + 1) as f64 * ratio).ceil() as usize;
        // Along one axis, with ground that rises within a cell as its neighbours do.
        let along = |k: usize, at: &dyn Fn(usize) -> f64| -> f64 {
            let (low, high) = (k as f64 * ratio, (k + 1) as f64 * ratio);
            let part = |cell: usize| {
                let (before, after) = (cell.saturating_sub(1), (cell + 1).min(SIDE - 1));
                let slope = (at(after) - at(before)) / (after - before) as f64;
                let middle = (low.max(cell as f64) + high.min(cell as f64 + 1.0)) / 2.0 - cell as f64 - 0.5;
                share(k, cell) * (at(cell) + middle * slope)
            };
            under(k).map(part).sum()
        };
        let mean = |x: usize, y: usize| along(y, &|row| along(x, &|column| rough(column, row)));
        let b = folder.path().join("b.tif");
        let step = 10.0 * ratio;
        let set = create::<f32>(&b, (side, side), 1, "EPSG:32633", [500_000.0, step, 0.0, 8_700_000.0, 0.0, -step]);
        put(&set, 1, (0..side * side).map(|i| mean(i % side, i / side) as f32).collect());
        drop(set);
        let found = compare(&a, &b, None, &folder.path().join(format!("c{ratio}")));
        let sd = found.sd_m.expect("cells");
        assert!(sd < 1e-4 && found.mean_m.is_some_and(|m| m.abs() < 1e-4), "{ratio}: {sd}");
    }
}

#[test]
fn heights_of_a_resampled_model_are_in_the_unit_that_is_written() {
    let folder = tempfile::tempdir().expect("a folder");
    // State plane feet beside UTM metres, around one place of North Carolina.
    let utm = [500_000.0, 10.0, 0.0, 3_900_000.0, 0.0, -10.0];
    let b = folder.path().join("b.tif");
    let set = create::<f32>(&b, (SIDE, SIDE), 1, "EPSG:26917+5703", utm);
    put(&set, 1, hills(0.0, 0.0));
    drop(set);
    let a = folder.path().join("a.tif");
    let warped = folder.path().join("warped.tif");
    let options = ["-of", "GTiff", "-t_srs", "EPSG:2264+6360", "-novshift", "-r", "cubic", "-dstnodata", "-9999"];
    derive::warp(&b, &warped, &options).expect("warped");
    let (size, transform) = {
        let set = Dataset::open(&warped).expect("a raster");
        (set.raster_size(), set.geo_transform().expect("a place"))
    };
    let set = create::<f32>(&a, size, 1, "EPSG:2264+6360", transform);
    set.rasterband(1).expect("a band").set_no_data_value(Some(-9999.0)).expect("labelled");
    let feet = |z: &f64| if *z == -9999.0 { *z as f32 } else { (*z / 0.304_800_609_6) as f32 };
    put(&set, 1, read(&warped, 1).iter().map(feet).collect());
    drop(set);
    let out = folder.path().join("out.tif");
    let job = AlignJob {
        a: &a,
        b: &b,
        method: Method::Lzd,
        surface: Degree::Linear,
        stable: None,
        resources: resources(),
        scratch: None,
    };
    let found = job.run().expect("aligned");
    let Outcome::Aligned(alignment) = &found.outcome else { panic!("{:?}", found.outcome) };
    found.write(alignment, &out).expect("written");
    let highest = read(&out, 1).into_iter().fold(f64::MIN, f64::max);
    assert!((400.0..700.0).contains(&highest), "{highest}");
    let again = compare(&out, &b, None, &folder.path().join("c"));
    assert!(again.mean_m.expect("cells").abs() < 1.0, "{:?}", again.mean_m);
    let difference = Dataset::open(folder.path().join("c/difference.tif")).expect("a raster");
    assert_eq!(difference.rasterband(1).expect("a band").unit(), "m");
}

#[test]
fn cells_count_in_every_zone_that_they_lie_in() {
    let folder = tempfile::tempdir().expect("a folder");
    let b = model(&folder.path().join("b.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let raised = hills(0.0, 0.0).iter().map(|z| z + 3.0).collect();
    let a = model(&folder.path().join("a.tif"), "EPSG:32633", raised, -10.0);
    let square = |name: &str, from: f64, to: f64| {
        let (x0, x1) = (500_000.0 + from, 500_000.0 + to);
        let (y0, y1) = (8_700_000.0 - to, 8_700_000.0 - from);
        format!(
            "{{\"type\":\"Feature\",\"properties\":{{\"name\":\"{name}\"}},\"geometry\":{{\"type\":\"Polygon\",\
             \"coordinates\":[[[{x0},{y0}],[{x1},{y0}],[{x1},{y1}],[{x0},{y1}],[{x0},{y0}]]]}}}}"
        )
    };
    let zones = folder.path().join("zones.geojson");
    let crs = "\"crs\":{\"type\":\"name\",\"properties\":{\"name\":\"urn:ogc:def:crs:EPSG::32633\"}}";
    let features = [square("one", 100.0, 700.0), square("two", 400.0, 900.0), square("far", 5000.0, 6000.0)].join(",");
    std::fs::write(&zones, format!("{{\"type\":\"FeatureCollection\",{crs},\"features\":[{features}]}}"))
        .expect("written");
    let found = compare(&a, &b, Some(&zones), &folder.path().join("c"));
    let counts: Vec<u64> = found.volumes.iter().map(|v| v.n).collect();
    assert_eq!(counts, [60 * 60, 50 * 50, 0]);
    assert!((found.volumes[0].volume_m3.expect("cells") - 3.0 * 600.0 * 600.0).abs() < 10.0);
    assert!(found.volumes[2].volume_m3.is_none() && found.volumes[2].mean_m.is_none(), "nothing is known of it");
}

#[test]
fn aspects_do_not_depend_on_how_rows_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let north_up = model(&folder.path().join("n.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let turned = hills(0.0, 0.0).chunks_exact(SIDE).rev().flatten().copied().collect();
    let south_up = model(&folder.path().join("s.tif"), "EPSG:32633", turned, 10.0);
    assert!(!gradient::needs_true_sides(&north_up, Picture::Aspect).expect("a model"));
    assert!(gradient::needs_true_sides(&south_up, Picture::Aspect).expect("a model"));
    // GDAL's aspect divides by no side of a cell.
    let oblong = model(&folder.path().join("o.tif"), "EPSG:32633", hills(0.0, 0.0), -25.0);
    let needs =
        [Picture::Aspect, Picture::SlopeDegrees].map(|p| gradient::needs_true_sides(&oblong, p).expect("a model"));
    assert_eq!(needs, [true, false]);
    let (plain, own) = (folder.path().join("a.tif"), folder.path().join("b.tif"));
    let drawing = derive::Drawing { kind: "aspect", options: Vec::new(), colours: None, memory_budget_bytes: MEMORY };
    derive::draw(&north_up, &plain, &drawing).expect("drawn");
    let (kernel, edges) = (gradient::Kernel::Horn, gradient::Edges::LeftOut);
    gradient::draw(&south_up, &own, Picture::Aspect, kernel, edges, 2).expect("drawn");
    let (plain, own) = (read(&plain, 1), read(&own, 1));
    for row in 1..SIDE - 1 {
        for column in 1..SIDE - 1 {
            let (a, b) = (plain[row * SIDE + column], own[(SIDE - 1 - row) * SIDE + column]);
            let apart = (a - b).rem_euclid(360.0);
            assert!(apart.min(360.0 - apart) < 0.5, "{row} {column}: {a} {b}");
        }
    }
}

#[test]
fn lines_are_counted_whatever_their_format() {
    let folder = tempfile::tempdir().expect("a folder");
    let hills = model(&folder.path().join("b.tif"), "EPSG:32633", hills(0.0, 0.0), -10.0);
    let count = |name: &str| derive::contour(&hills, &folder.path().join(name), 20.0, 0.0, MEMORY).expect("lines");
    assert!(count("a.gpkg") > 5);
    assert_eq!(count("b.gpkg"), count("b.geojson"));
    let endless =
        derive::contour(&hills, &folder.path().join("c.gpkg"), 1e-6, 0.0, MEMORY).expect_err("millions of levels");
    assert!(endless.to_string().contains("--interval"), "{endless}");
    assert!(!folder.path().join("c.gpkg").exists());
}

fn mosaic(inputs: &[PathBuf], out: &Path) {
    mosaic_by(Choice::First, inputs, out);
}

fn mosaic_by(choice: Choice, inputs: &[PathBuf], out: &Path) {
    joined(choice, Interpolation::Bilinear, None, inputs, out).expect("joined");
}

fn joined(
    choice: Choice,
    resampling: Interpolation,
    resolution: Option<f64>,
    inputs: &[PathBuf],
    out: &Path,
) -> autoref_raster::Result<autoref_elevation::mosaic::Made> {
    let job = MosaicJob { choice, resolution, resampling, ..joining::job(inputs, out) };
    job.run()
}

/// Blocks of the files and of the tiles are smaller where there are many bands: every cell still comes to its place.
#[test]
fn a_raster_that_gcps_place_is_told_the_way_to_a_grid() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("scan.tif");
    let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
    let set = driver.create_with_band_type::<u8, _>(&path, 20, 10, 1).expect("a file");
    let corner = |pixel: f64, line: f64| gdal::Gcp {
        id: String::new(),
        info: String::new(),
        pixel,
        line,
        x: 500_000.0 + pixel,
        y: 6_600_000.0 - line,
        z: 0.0,
    };
    let corners = vec![corner(0.0, 0.0), corner(20.0, 0.0), corner(0.0, 10.0)];
    set.set_gcps(corners, &SpatialRef::from_epsg(32632).expect("PROJ knows it")).expect("labelled");
    drop(set);
    let refused = joined(Choice::First, Interpolation::Bilinear, None, &[path], &folder.path().join("m.tif"))
        .expect_err("no grid")
        .to_string();
    assert!(refused.contains("scan.tif") && refused.contains("GCPs") && refused.contains("gdalwarp"), "{refused}");
}

#[test]
fn a_mosaic_of_many_bands_has_every_cell() {
    const BANDS: usize = 37;
    let folder = tempfile::tempdir().expect("a folder");
    let value = |band: usize, x: usize, y: usize| (band * 1000 + (x * 7 + y * 13) % 997) as u16;
    let inputs: Vec<PathBuf> = [0usize, 150]
        .map(|x0| {
            let path = folder.path().join(format!("{x0}.tif"));
            let set = create::<u16>(&path, (170, 130), BANDS, "EPSG:32633", [x0 as f64, 1.0, 0.0, 130.0, 0.0, -1.0]);
            for band in 1..=BANDS {
                let cells = (0..170 * 130).map(|i| value(band, x0 + i % 170, i / 170)).collect();
                put(&set, band, cells);
            }
            path
        })
        .to_vec();
    let out = folder.path().join("all.tif");
    let made = joined(Choice::Last, Interpolation::Bilinear, None, &inputs, &out).expect("joined");
    assert_eq!((made.width, made.height, made.bands), (320, 130, BANDS));
    for band in [1, 2, 19, BANDS] {
        for (i, cell) in read(&out, band).into_iter().enumerate() {
            assert_eq!(cell, f64::from(value(band, i % 320, i / 320)), "band {band}, cell {i}");
        }
    }
}

/// Four bytes a side, one colour; the left half is transparent or masked.
/// Bands that are no colours: what is nodata in the first is filled by another source, and no mean takes it.
#[test]
fn the_first_of_other_bands_decides() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, values: [i16; 2]| {
        let path = folder.path().join(name);
        let mut set = create::<i16>(&path, (1, 1), 2, "EPSG:32633", [500_000.0, 1.0, 0.0, 40.0, 0.0, -1.0]);
        for band in 0..2 {
            let mut plane = set.rasterband(band + 1).expect("a band");
            plane.set_no_data_value(Some(-32_768.0)).expect("set");
            plane.write((0, 0), (1, 1), &mut Buffer::new((1, 1), vec![values[band]])).expect("written");
        }
        set.flush_cache().expect("written");
        path
    };
    let inputs = [write("a.tif", [-32_768, 3]), write("b.tif", [500, 9])];
    let out = folder.path().join("m.tif");
    for choice in [Choice::First, Choice::Median, Choice::Feather] {
        mosaic_by(choice.clone(), &inputs, &out);
        let set = Dataset::open(&out).expect("a mosaic");
        let first = set.rasterband(1).expect("a band").read_as::<i16>((0, 0), (1, 1), (1, 1), None).expect("read");
        assert_eq!(first.data(), [500], "{choice:?}");
    }
}

/// A colour with a band of 0 is there where 0 in all bands is nothing.
#[test]
fn colours_are_nodata_as_a_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, colours: [[u8; 3]; 3], nodata: f64| {
        let path = folder.path().join(name);
        let mut set = create::<u8>(&path, (3, 1), 3, "EPSG:32633", [500_000.0, 1.0, 0.0, 40.0, 0.0, -1.0]);
        for band in 0..3 {
            let mut plane = set.rasterband(band + 1).expect("a band");
            plane.set_no_data_value(Some(nodata)).expect("set");
            let values = colours.map(|colour| colour[band]).to_vec();
            plane.write((0, 0), (3, 1), &mut Buffer::new((3, 1), values)).expect("written");
        }
        set.flush_cache().expect("written");
        path
    };
    let read = |path: &Path| {
        let set = Dataset::open(path).expect("a mosaic");
        let band = |b: usize| {
            let band = set.rasterband(b + 1).expect("a band");
            band.read_as::<u8>((0, 0), (3, 1), (3, 1), None).expect("read").data().to_vec()
        };
        let bands = [0, 1, 2].map(band);
        [0, 1, 2].map(|cell| [0, 1, 2].map(|b: usize| bands[b][cell]))
    };
    let above = [[0, 200, 50], [200, 0, 50], [0, 0, 0]];
    let inputs = [write("a.tif", above, 0.0), write("b.tif", [[7, 7, 7]; 3], 0.0)];
    let out = folder.path().join("m.tif");
    mosaic(&inputs, &out);
    assert_eq!(read(&out), [[0, 200, 50], [200, 0, 50], [7, 7, 7]]);
    mosaic_by(Choice::Median, &inputs, &out);
    assert_eq!(read(&out)[2], [7, 7, 7]);
    // Black that another file does not call nothing is moved by one.
    mosaic(&[inputs[0].clone(), write("c.tif", [[0, 0, 0]; 3], 255.0)], &out);
    assert_eq!(read(&out), [[0, 200, 50], [200, 0, 50], [1, 0, 0]]);
}

fn picture(path: &Path, x0: f64, bands: usize, value: u8, half: bool) -> PathBuf {
    let set = create::<u8>(path, (40, 40), bands, "EPSG:32633", [x0, 1.0, 0.0, 40.0, 0.0, -1.0]);
    let there = |i: usize| if half && i % 40 < 20 { 0 } else { 255 };
    for band in 1..=bands {
        let alpha = bands == 4 && band == 4;
        put(&set, band, (0..1600).map(|i| if alpha { there(i) } else { value }).collect());
        if alpha {
            let mut band = set.rasterband(band).expect("a band");
            band.set_color_interpretation(ColorInterpretation::AlphaBand).expect("labelled");
        }
    }
    if bands == 3 {
        set.rasterband(1).expect("a band").create_mask_band(true).expect("a mask");
        let band = set.rasterband(1).expect("a band");
        let mut mask = band.open_mask_band().expect("a mask");
        mask.write((0, 0), (40, 40), &mut Buffer::new((40, 40), (0..1600).map(there).collect())).expect("written");
    }
    path.to_path_buf()
}

#[test]
fn what_is_transparent_or_masked_never_wins() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("mosaic.tif");
    for bands in [3, 4] {
        let first = picture(&folder.path().join(format!("a{bands}.tif")), 0.0, bands, 50, true);
        let second = picture(&folder.path().join(format!("b{bands}.tif")), 10.0, bands, 90, false);
        mosaic(&[first, second], &out);
        let values = read(&out, 1);
        // Of the first only its right half; before the second begins there is nothing.
        let at = |x: usize| values[5 * 50 + x];
        assert_eq!([at(15), at(25), at(45)], [90.0, 50.0, 90.0], "{bands} bands");
        let joined = Dataset::open(&out).expect("a raster");
        let band = joined.rasterband(1).expect("a band");
        let mask = band.open_mask_band().expect("a mask").read_as::<u8>((0, 0), (50, 40), (50, 40), None);
        let mask = mask.expect("values").data().to_vec();
        assert_eq!([mask[5 * 50 + 4], mask[5 * 50 + 15], mask[5 * 50 + 45]], [0, 255, 255], "{bands} bands");
    }
}

#[test]
fn the_opacity_of_what_is_not_there_is_no_part_of_a_median_or_a_mean() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("mosaic.tif");
    let inputs = [("a", 50, false), ("b", 90, true), ("c", 90, true)]
        .map(|(name, value, half)| picture(&folder.path().join(format!("{name}.tif")), 0.0, 4, value, half));
    for choice in [Choice::Median, Choice::Feather] {
        mosaic_by(choice, &inputs, &out);
        let (colour, opacity) = (read(&out, 1), read(&out, 4));
        assert_eq!((colour[5 * 40 + 10], opacity[5 * 40 + 10]), (50.0, 255.0));
        assert_eq!(opacity[5 * 40 + 30], 255.0);
    }
}

#[test]
fn drawings_of_a_scaled_model_are_those_of_its_heights() {
    let folder = tempfile::tempdir().expect("a folder");
    let (plain, scaled) = (folder.path().join("plain.tif"), folder.path().join("scaled & stored.tif"));
    let stored: Vec<i16> = hills(0.0, 0.0).iter().map(|z| ((f64::from(*z) - 400.0) / 0.02).round() as i16).collect();
    model(&plain, "EPSG:32633", stored.iter().map(|v| (f64::from(*v) * 0.02 + 400.0) as f32).collect(), -10.0);
    let set = create::<i16>(&scaled, (SIDE, SIDE), 1, "EPSG:32633", [500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]);
    put(&set, 1, stored);
    let mut band = set.rasterband(1).expect("a band");
    band.set_scale(0.02).and_then(|()| band.set_offset(400.0)).expect("labelled");
    drop(set);
    let drawing = derive::Drawing { kind: "slope", options: Vec::new(), colours: None, memory_budget_bytes: MEMORY };
    let drawn = [&plain, &scaled].map(|model| {
        let out = folder.path().join("slope.tif");
        derive::draw(model, &out, &drawing).expect("drawn");
        read(&out, 1)
    });
    let apart = drawn[0].iter().zip(&drawn[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(apart < 1e-3, "{apart}");
    let lines = [&plain, &scaled]
        .map(|model| derive::contour(model, &folder.path().join("lines.gpkg"), 50.0, 0.0, MEMORY).expect("lines"));
    assert!(lines[0] > 0 && lines[0] == lines[1], "{lines:?}");
}

#[test]
fn contours_of_a_model_in_feet_lie_at_metres() {
    use gdal::vector::LayerAccess;
    let folder = tempfile::tempdir().expect("a folder");
    let (metres, feet) = (folder.path().join("m.tif"), folder.path().join("ft.tif"));
    model(&metres, "EPSG:32633", hills(0.0, 0.0), -10.0);
    let in_feet: Vec<f64> = hills(0.0, 0.0).iter().map(|z| f64::from(*z) / 0.3048).collect();
    let set = create::<f64>(&feet, (SIDE, SIDE), 1, "EPSG:32633", [500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]);
    put(&set, 1, in_feet);
    autoref_raster::set_height_unit(&feet, &set, "ft").expect("labelled");
    drop(set);
    let heights = [&metres, &feet].map(|model| {
        let out = model.with_extension("geojson");
        derive::contour(model, &out, 20.0, 5.0, MEMORY).expect("lines");
        let lines = Dataset::open(&out).expect("a file of lines");
        let mut layer = lines.layer(0).expect("a layer");
        let mut heights: Vec<f64> =
            layer.features().map(|line| line.field_as_double(1).expect("a field").expect("a height")).collect();
        heights.sort_by(f64::total_cmp);
        heights
    });
    assert!(heights[0].len() > 5 && heights[0].iter().all(|z| (z - 5.0) % 20.0 == 0.0), "{:?}", heights[0]);
    assert_eq!(heights[0], heights[1]);
}

/// A raster of one band from its left edge on, as `value` has it at its columns and rows.
fn strip<T: GdalType + Copy>(path: &Path, x0: f64, columns: usize, value: impl Fn(usize, usize) -> T) -> PathBuf {
    let set = create::<T>(path, (columns, 30), 1, "EPSG:32633", [x0, 10.0, 0.0, 300.0, 0.0, -10.0]);
    put(&set, 1, (0..columns * 30).map(|i| value(i % columns, i / columns)).collect());
    path.to_path_buf()
}

/// Tiles that abut leave no gap, whatever the mosaic's cells are; and their outer cells stay.
#[test]
fn tiles_that_abut_leave_no_gap_between_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("mosaic.tif");
    let plane = |x: usize, y: usize| (2 * x + 3 * y) as f32;
    let left = strip(&folder.path().join("l.tif"), 1000.0, 25, plane);
    let right = strip(&folder.path().join("r.tif"), 1250.0, 25, |x, y| plane(x + 25, y));
    // Of another phase, and beside the others: it sets the cells.
    let phase = strip(&folder.path().join("p.tif"), 504.0, 5, |_, _| 0.0f32);
    for resampling in [Interpolation::Bilinear, Interpolation::Cubic, Interpolation::Nearest] {
        let cases =
            [(None, vec![phase.clone(), left.clone(), right.clone()]), (Some(7.0), vec![left.clone(), right.clone()])];
        for (resolution, inputs) in cases {
            let made = joined(Choice::First, resampling, resolution, &inputs, &out).expect("joined");
            let [x0, step, ..] = made.geotransform;
            let (values, top) = (read(&out, 1), made.geotransform[3]);
            for i in 0..values.len() {
                let (column, row) = (i as u64 % made.width, i as u64 / made.width);
                let x = (x0 + (column as f64 + 0.5) * step - 1000.0) / 10.0;
                let y = (top - (row as f64 + 0.5) * step).mul_add(-0.1, 30.0);
                let inside = (0.0..50.0).contains(&x) && (0.0..30.0).contains(&y);
                let expected = 2.0 * (x - 0.5) + 3.0 * (y - 0.5);
                // Half a cell from an edge on nothing lies beyond to interpolate with.
                if inside {
                    assert!(
                        (values[i] - expected).abs() < 2.6,
                        "{resampling:?} {resolution:?}: {} at {x} {y}",
                        values[i]
                    );
                }
            }
        }
    }
}

/// Whole numbers of 32 bits stay what they are, and classes of a palette are not mixed.
#[test]
fn samples_keep_their_type_and_palettes_their_classes() {
    use gdal::raster::{ColorEntry, ColorTable, PaletteInterpretation};
    let folder = tempfile::tempdir().expect("a folder");
    let out = folder.path().join("mosaic.tif");
    let large = strip(&folder.path().join("i.tif"), 0.0, 20, |x, y| (1 << 24) + (20 * y + x) as i32);
    mosaic(std::slice::from_ref(&large), &out);
    assert_eq!(read(&out, 1), read(&large, 1));
    let unsigned = strip(&folder.path().join("u.tif"), 0.0, 20, |x, _| u32::MAX - 1 - x as u32);
    let set = Dataset::open_ex(
        &unsigned,
        gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() },
    );
    let set = set.expect("a raster");
    set.rasterband(1).expect("a band").set_no_data_value(Some(f64::from(u32::MAX))).expect("labelled");
    drop(set);
    mosaic(std::slice::from_ref(&unsigned), &out);
    assert_eq!(read(&out, 1), read(&unsigned, 1));
    let classes = |name: &str, x0: f64| {
        let path = strip(&folder.path().join(name), x0, 20, |x, y| if (x + y) % 2 == 0 { 1u8 } else { 3 });
        let flags = gdal::GdalOpenFlags::GDAL_OF_UPDATE;
        let set = Dataset::open_ex(&path, gdal::DatasetOptions { open_flags: flags, ..Default::default() })
            .expect("a raster");
        let mut table = ColorTable::new(PaletteInterpretation::Rgba);
        (0..4).for_each(|i| table.set_color_entry(i, &ColorEntry::rgba(60 * i as i16, 0, 0, 255)));
        set.rasterband(1).expect("a band").set_color_table(&table);
        path
    };
    let inputs = [classes("c.tif", 0.0), classes("d.tif", 104.0)];
    joined(Choice::Last, Interpolation::Bilinear, Some(7.0), &inputs, &out).expect("joined");
    assert!(!read(&out, 1).contains(&2.0), "no source has this class");
    for choice in [Choice::Median, Choice::Feather] {
        let refused = joined(choice, Interpolation::Nearest, None, &inputs, &out).expect_err("mixed").to_string();
        assert!(refused.contains("c.tif") && refused.contains("palette"), "{refused}");
    }
}

/// The error of a mean of white noise is σ/√n, whatever the draw; where nothing tells it, it is not stated.
#[test]
fn the_error_of_a_mean_is_that_of_its_noise_or_is_not_stated() {
    let folder = tempfile::tempdir().expect("a folder");
    let flat = model(&folder.path().join("b.tif"), "EPSG:32633", vec![100.0; SIDE * SIDE], -10.0);
    let noisy = |seed: u64| {
        let mut random = autoref_raster::random::SplitMix64(seed);
        let values = (0..SIDE * SIDE).map(|_| 100.0 + random.normal() as f32).collect();
        model(&folder.path().join("a.tif"), "EPSG:32633", values, -10.0)
    };
    let expected = 1.0 / SIDE as f64;
    for seed in 1..=12 {
        let found = compare(&noisy(seed), &flat, None, &folder.path().join("c"));
        let stated = found.mean_se_m.expect("there are pairs");
        assert!((stated / expected - 1.0).abs() < 0.2, "seed {seed}: {stated} for {expected}");
    }
    let everywhere = folder.path().join("all.geojson");
    let ring = "[[499000,8690000],[510000,8690000],[510000,8701000],[499000,8701000],[499000,8690000]]";
    let nothing = r#"{"type":"Feature","properties":{},"geometry":null}"#;
    let polygon = format!(
        r#"{{"type":"Feature","properties":{{"name":"all"}},"geometry":{{"type":"Polygon","coordinates":[{ring}]}}}}"#
    );
    let text = format!(
        r#"{{"type":"FeatureCollection","crs":{{"type":"name","properties":{{"name":"urn:ogc:def:crs:EPSG::32633"}}}},"features":[{nothing},{polygon}]}}"#
    );
    std::fs::write(&everywhere, text).expect("writable");
    let found = compare(&noisy(1), &flat, Some(&everywhere), &folder.path().join("z"));
    assert_eq!((found.mean_se_m, found.effective_n), (None, None));
    let volume = found.volumes.iter().find(|volume| volume.zone == "all").expect("the area");
    assert!(volume.volume_m3.is_some() && volume.volume_95_m3.is_none() && volume.mean_se_m.is_none());
}
