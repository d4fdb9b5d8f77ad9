//! `dem` on models of other CRSs, with holes of every kind, and placed by GCPs.

use std::path::Path;

use gdal::DriverManager;
use gdal::raster::Buffer;
use gdal::spatial_ref::{AxisMappingStrategy, CoordTransform, SpatialRef};
use serde_json::Value;

use super::elevation::{CORNER, Folder, autoref, document, hills, text, write, write_on};

/// Heights at places in UTM 33, of a raster in any CRS with such a corner and cells.
fn write_in(path: &Path, epsg: u32, transform: [f64; 6], size: (usize, usize), height: impl Fn(f64, f64) -> f64) {
    let axes = |code: u32| {
        let mut reference = SpatialRef::from_epsg(code).expect("known");
        reference.set_axis_mapping_strategy(AxisMappingStrategy::TraditionalGisOrder);
        reference
    };
    let there = CoordTransform::new(&axes(epsg), &axes(25833)).expect("PROJ knows both");
    write_on(path, &transform, size, Some(epsg), |along, down| {
        let [x, y] = [transform[0] + transform[1] * along / 10.0, transform[3] - transform[5] * down / 10.0];
        let (mut x, mut y) = ([x], [y]);
        there.transform_coords(&mut x, &mut y, &mut []).expect("it lies there");
        height(x[0], y[0])
    });
}

/// A model in another CRS is taken between its cells, whatever the block: nothing is smoothed, and cells are as long as
/// its own both ways.
#[test]
fn heights_of_another_crs_are_those_between_its_cells() {
    let folder = Folder::new();
    let (utm32, utm33, degrees, page) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("d.tif"), folder.at("c"));
    let long = |x: f64, y: f64| 600.0 + 120.0 * (x / 770.0).sin() * (y / 1100.0).cos();
    write_in(&utm32, 25832, [628_000.0, 20.0, 0.0, 8_706_000.0, 0.0, -20.0], (700, 700), long);
    write_in(&utm33, 25833, [500_500.0, 10.0, 0.0, 8_699_500.0, 0.0, -10.0], (300, 300), long);
    let spread = |a: &Path, b: &Path| {
        let found =
            document(&autoref(&["dem", "compare", text(a), text(b), "-o", text(&page), "--overwrite", "--json"]));
        (found["sd_m"].as_f64().expect("a number"), found["common_cells"].as_u64().expect("a number"))
    };
    let (sd_m, cells) = spread(&utm32, &utm33);
    assert!(sd_m < 0.02 && cells > 50_000, "{sd_m} m, {cells} cells");
    // Cells of three seconds of longitude and one of latitude are longer from south to north.
    let short = |x: f64, y: f64| 600.0 + 20.0 * (x / 60.0).sin() * (y / 60.0).cos();
    write_in(&utm33, 25833, [500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0], (500, 500), short);
    write_in(&degrees, 4326, [15.03, 3.0 / 3600.0, 0.0, 78.36, 0.0, -1.0 / 3600.0], (180, 120), short);
    let (sd_m, _) = spread(&utm33, &degrees);
    // A cell's mean differs from the height in its middle by 0.15 m.
    assert!(sd_m < 0.25, "{sd_m} m");
}

/// The same hole written in five ways: the drawings, contour lines and coarser cells leave out the same cells.
#[test]
fn however_a_hole_is_written_it_is_no_ground() {
    let folder = Folder::new();
    let out = folder.at("o.tif");
    let is_hole = |k: usize| (30..50).contains(&(k % 120)) && (40..60).contains(&(k / 120));
    let kinds = ["tag", "mask", "untagged", "infinite", "nan"];
    let mut found: Vec<Vec<u64>> = Vec::new();
    for kind in kinds {
        let model = folder.at(&format!("{kind}.tif"));
        let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
        let mut dataset = driver.create_with_band_type::<f32, _>(&model, 120, 100, 1).expect("writable");
        dataset.set_geo_transform(&[500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]).expect("a geotransform");
        dataset.set_spatial_ref(&SpatialRef::from_epsg(25833).expect("known")).expect("a CRS");
        let mut band = dataset.rasterband(1).expect("a band");
        if kind == "tag" || kind == "nan" {
            band.set_no_data_value(Some(-9999.0)).expect("a value");
        }
        let hole = match kind {
            "tag" => -9999.0,
            "mask" => 0.0,
            "untagged" => -32_768.0,
            "infinite" => f32::INFINITY,
            _ => f32::NAN,
        };
        let height = |k: usize| hills(10.0 * (k % 120) as f64, -10.0 * (k / 120) as f64) as f32;
        let values = (0..12_000).map(|k| if is_hole(k) { hole } else { height(k) }).collect();
        band.write((0, 0), (120, 100), &mut Buffer::new((120, 100), values)).expect("writable");
        if kind == "mask" {
            band.create_mask_band(true).expect("a mask");
            let there = (0..12_000).map(|k| if is_hole(k) { 0u8 } else { 255 }).collect();
            let mut mask = band.open_mask_band().expect("a mask");
            mask.write((0, 0), (120, 100), &mut Buffer::new((120, 100), there)).expect("writable");
        }
        dataset.close().expect("written");
        let mut numbers = Vec::new();
        for words in [&["slope"][..], &["tri"], &["tpi"], &["resample", "--resolution", "30"]] {
            let how = [&["dem", words[0], text(&model), "-o", text(&out), "--overwrite"], &words[1..]].concat();
            assert!(autoref(&how).status.success(), "{kind} {words:?}");
            let drawn = gdal::Dataset::open(&out).expect("readable");
            let band = drawn.rasterband(1).expect("a band");
            let values = band.read_band_as::<f64>().expect("values");
            let nodata = band.no_data_value().expect("a value");
            let there: Vec<f64> =
                values.data().iter().copied().filter(|v| *v != nodata && !(v.is_nan() && nodata.is_nan())).collect();
            let sum: f64 = there.iter().sum();
            numbers.extend([there.len() as u64, (1000.0 * sum).round() as u64]);
        }
        let lines = folder.at("l.geojson");
        let how = ["dem", "contour", text(&model), "-o", text(&lines), "--interval", "20", "--overwrite"];
        assert!(autoref(&how).status.success(), "{kind}");
        let lines: Value = serde_json::from_slice(&std::fs::read(&lines).expect("written")).expect("JSON");
        numbers.push(lines["features"].as_array().expect("lines").len() as u64);
        found.push(numbers);
    }
    for (kind, numbers) in kinds.iter().zip(&found) {
        assert_eq!(numbers, &found[0], "{kind}");
    }
}

/// Four cells of five are missing, here and there: the mean of the others is known nearly as well as that of all, since
/// each has fewer others to err with.
#[test]
fn scattered_holes_leave_the_error_of_a_mean_as_it_is() {
    let folder = Folder::new();
    let (a, b, page) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("c"));
    let random = |x: i64, y: i64, seed: u64| {
        autoref_raster::random::mix(seed ^ (x as u64).wrapping_mul(0x9e37_79b9) ^ (y as u64) << 32) as f64
            / u64::MAX as f64
    };
    let noise: Vec<f64> = (0..400 * 400)
        .map(|k| {
            let around = (-3..=3).flat_map(|j| (-3..=3).map(move |i| (i, j)));
            around.map(|(i, j)| random(k % 400 + i, k / 400 + j, 7) - 0.5).sum::<f64>() / 2.0
        })
        .collect();
    write(&b, CORNER, (400, 400), hills);
    let se_m = |share: f64| {
        write(&a, CORNER, (400, 400), |x, y| {
            let (i, j) = ((x / 10.0) as i64, (-y / 10.0) as i64);
            if random(i, j, 2016) < share { hills(x, y) + noise[(i + 400 * j) as usize] } else { -9999.0 }
        });
        let found =
            document(&autoref(&["dem", "compare", text(&a), text(&b), "-o", text(&page), "--overwrite", "--json"]));
        found["mean_se_m"].as_f64().expect("a deviation")
    };
    let (all, some) = (se_m(1.0), se_m(0.2));
    assert!((0.8..1.4).contains(&(some / all)), "{some} and {all} m");
}

/// Pixels of a model that only GCPs place are no places, and a resampling of heights is none of stored numbers.
#[test]
fn what_would_be_drawn_in_the_wrong_place_or_unit_is_refused() {
    let folder = Folder::new();
    let (model, placed, out) = (folder.at("a.tif"), folder.at("g.vrt"), folder.at("o.tif"));
    write_on(&model, &[0.0, 1.0, 0.0, 0.0, 0.0, 1.0], (40, 40), None, hills);
    let corner = |name: &str, x: u32, y: u32| {
        format!("<GCP Id=\"{name}\" Pixel=\"{x}\" Line=\"{y}\" X=\"{}\" Y=\"{}\"/>", 500_000 + 2 * x, 5_600_000 - 2 * y)
    };
    let gcps = [corner("a", 0, 0), corner("b", 40, 0), corner("c", 0, 40), corner("d", 40, 40)].concat();
    let source = format!("<SourceFilename>{}</SourceFilename><SourceBand>1</SourceBand>", text(&model));
    let vrt = format!(
        "<VRTDataset rasterXSize=\"40\" rasterYSize=\"40\"><GCPList Projection=\"EPSG:25833\">{gcps}</GCPList>\
         <VRTRasterBand dataType=\"Float32\" band=\"1\"><SimpleSource>{source}</SimpleSource></VRTRasterBand></VRTDataset>"
    );
    std::fs::write(&placed, vrt).expect("writable");
    for words in [&["contour", "--interval", "20"][..], &["tri"], &["roughness"]] {
        let lines = folder.at(if words[0] == "contour" { "o.geojson" } else { "o.tif" });
        let refused = autoref(&[&["dem", words[0], text(&placed), "-o", text(&lines)], &words[1..]].concat());
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(
            refused.status.code() == Some(2) && said.contains("GCPs place") && !lines.exists(),
            "{words:?}: {said}"
        );
    }
    write(&model, CORNER, (40, 40), hills);
    let dataset = gdal::Dataset::open_ex(
        &model,
        gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() },
    );
    dataset.expect("writable").rasterband(1).and_then(|mut band| band.set_offset(500.0)).expect("an offset");
    for (how, code) in [("rms", 2), ("sum", 2), ("average", 0)] {
        let run =
            autoref(&["dem", "resample", text(&model), "-o", text(&out), "--resolution", "30", "--resampling", how]);
        assert_eq!(run.status.code(), Some(code), "{how}: {}", String::from_utf8_lossy(&run.stderr));
    }
}

/// Nothing is drawn of a model in which the usual value of "no height" fills every cell and is declared nowhere.
#[test]
fn a_model_without_any_height_is_refused() {
    let folder = Folder::new();
    let (model, out) = (folder.at("a.tif"), folder.at("o.tif"));
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let mut dataset = driver.create_with_band_type::<i16, _>(&model, 40, 40, 1).expect("writable");
    dataset.set_geo_transform(&[500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]).expect("a geotransform");
    dataset.set_spatial_ref(&SpatialRef::from_epsg(25833).expect("known")).expect("a CRS");
    let mut void = Buffer::new((40, 40), vec![-32_768i16; 1600]);
    dataset.rasterband(1).and_then(|mut band| band.write((0, 0), (40, 40), &mut void)).expect("writable");
    drop(dataset);
    for drawing in ["slope", "hillshade", "tri"] {
        let run = autoref(&["dem", drawing, text(&model), "-o", text(&out)]);
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(run.status.code() == Some(2) && said.contains("no cell has a height"), "{drawing}: {said}");
        assert!(!out.exists(), "{drawing}");
    }
}

/// A height that equals another source's nodata value stays a height to GDAL, which takes floats for equal that are ten
/// steps apart.
#[test]
fn a_height_beside_a_nodata_value_is_there() {
    let folder = Folder::new();
    let (a, b, out) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("o.tif"));
    write(&a, CORNER, (20, 20), |_, _| -32_768.0);
    write(&b, (CORNER.0 + 200.0, CORNER.1), (20, 20), |_, _| 5.0);
    let options = || gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() };
    let dataset = gdal::Dataset::open_ex(&b, options()).expect("writable");
    dataset.rasterband(1).and_then(|mut band| band.set_no_data_value(Some(-32_768.0))).expect("a value");
    dataset.close().expect("written");
    let found = document(&autoref(&["mosaic", text(&b), text(&a), "-o", text(&out), "--json"]));
    assert_eq!(found["filled_cells"], 800, "{found}");
    let dataset = gdal::Dataset::open(&out).expect("readable");
    let band = dataset.rasterband(1).expect("a band");
    let mask = band.open_mask_band().expect("a mask");
    let there: Buffer<u8> = mask.read_band_as().expect("values");
    assert!(there.data().iter().all(|v| *v == 255));
}
