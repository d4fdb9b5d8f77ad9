//! `dem` and `mosaic` from the command line, on models that are drawn here.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gdal::DriverManager;
use gdal::raster::Buffer;
use gdal::spatial_ref::SpatialRef;
use serde_json::Value;

use crate::browser::{Browser, Page};

pub(super) fn autoref(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(arguments).output().expect("the program runs")
}

pub(super) fn document(output: &Output) -> Value {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("JSON")
}

pub(super) fn write(path: &Path, corner: (f64, f64), size: (usize, usize), height: impl Fn(f64, f64) -> f64) {
    write_on(path, &[corner.0, 10.0, 0.0, corner.1, 0.0, -10.0], size, Some(25833), height);
}

/// Heights at places that are told in tenths of a cell from the corner, downwards negative.
pub(super) fn write_on(
    path: &Path,
    transform: &[f64; 6],
    size: (usize, usize),
    epsg: Option<u32>,
    height: impl Fn(f64, f64) -> f64,
) {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let mut dataset = driver.create_with_band_type::<f32, _>(path, size.0, size.1, 1).expect("writable");
    dataset.set_geo_transform(transform).expect("a geotransform");
    if let Some(code) = epsg {
        dataset.set_spatial_ref(&SpatialRef::from_epsg(code).expect("known")).expect("a CRS");
    }
    let mut band = dataset.rasterband(1).expect("a band");
    band.set_no_data_value(Some(-9999.0)).expect("a value");
    let values = (0..size.0 * size.1)
        .map(|i| height((i % size.0) as f64 * 10.0 + 5.0, (i / size.0) as f64 * -10.0 - 5.0) as f32)
        .collect();
    band.write((0, 0), size, &mut Buffer::new(size, values)).expect("writable");
}

pub(super) fn hills(east: f64, north: f64) -> f64 {
    300.0
        + 40.0 * (east / 130.0 + (north / 210.0).sin()).sin()
        + 25.0 * (north / 90.0).cos()
        + 60.0 * ((east - north) / 610.0).sin()
}

fn read(path: &Path) -> (Vec<f64>, [f64; 6]) {
    let dataset = gdal::Dataset::open(path).expect("readable");
    let band = dataset.rasterband(1).expect("a band").read_band_as::<f32>().expect("values");
    (band.data().iter().map(|v| f64::from(*v)).collect(), dataset.geo_transform().expect("a geotransform"))
}

pub(super) fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

pub(super) struct Folder(tempfile::TempDir);

impl Folder {
    pub(super) fn new() -> Self {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }

    pub(super) fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

pub(super) const CORNER: (f64, f64) = (500_000.0, 8_700_000.0);

#[test]
fn a_moved_model_comes_back_with_its_own_cells() {
    let folder = Folder::new();
    let (a, b, out) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("out.tif"));
    write(&b, CORNER, (150, 120), hills);
    write(&a, (CORNER.0 + 230.0, CORNER.1 - 140.0), (150, 120), |e, n| hills(e, n) + 2.0);
    let arguments = ["dem", "align", text(&a), "--to", text(&b), "-o", text(&out), "--json"];
    let found = document(&autoref(&arguments));
    for (key, truth) in
        [("shift_e_m", -230.0), ("shift_n_m", 140.0), ("shift_h_m", -2.0), ("shift_x_px", -23.0), ("shift_y_px", -14.0)]
    {
        let value = found[key].as_f64().expect(key);
        assert!((value - truth).abs() < 0.01, "{key}: {value}");
    }
    for key in ["covariance_m2", "nmad_before_m", "nmad_after_m", "stable_share"] {
        assert!(!found[key].is_null(), "{key}");
    }
    // Heights are A's, lowered, at the place of B: nothing was resampled.
    let (values, transform) = read(&out);
    let (original, _) = read(&a);
    assert!((transform[0] - CORNER.0).abs() < 0.01 && (transform[3] - CORNER.1).abs() < 0.01, "{transform:?}");
    assert!(values.iter().zip(&original).all(|(v, o)| (v - o + 2.0).abs() < 0.01));
    let refused = autoref(&arguments);
    assert_eq!(refused.status.code(), Some(2), "the output exists");
    // The tiling changes nothing.
    let whole = document(&autoref(&[&arguments[..], &["--overwrite", "--tile", "32", "--threads", "3"]].concat()));
    assert_eq!(whole, found);
}

#[test]
fn flat_ground_is_refused_and_bad_input_named() {
    let folder = Folder::new();
    let (flat, hilly, out) = (folder.at("flat.tif"), folder.at("b.tif"), folder.at("out.tif"));
    write(&flat, CORNER, (80, 80), |_, _| 7.0);
    write(&hilly, CORNER, (80, 80), hills);
    let quiet = autoref(&["dem", "align", text(&flat), "--to", text(&hilly), "-o", text(&out), "--quiet"]);
    assert!(quiet.status.code() == Some(1) && quiet.stdout.is_empty(), "{quiet:?}");
    assert!(String::from_utf8_lossy(&quiet.stderr).contains("not aligned"), "{quiet:?}");
    let output = autoref(&["dem", "align", text(&flat), "--to", text(&hilly), "-o", text(&out), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(!out.exists());
    let far = folder.at("far.tif");
    write(&far, (100_000.0, 8_000_000.0), (80, 80), hills);
    let void = folder.at("void.tif");
    write(&void, CORNER, (80, 80), |_, _| -9999.0);
    for bad in [&far, &void] {
        for command in ["align", "compare"] {
            let arguments = match command {
                "align" => vec!["dem", "align", text(bad), "--to", text(&hilly), "-o", text(&out)],
                _ => vec!["dem", "compare", text(bad), text(&hilly), "-o", text(&out)],
            };
            let output = autoref(&arguments);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{command}: {said}");
            assert!(said.lines().count() == 1 && said.contains(".tif"), "{command}: {said}");
        }
    }
    let nameless = folder.at("nameless.tif");
    write_on(&nameless, &[CORNER.0, 10.0, 0.0, CORNER.1, 0.0, -10.0], (80, 80), None, hills);
    let (model, second, lines) = (text(&hilly), text(&nameless), folder.at("lines.gpkg"));
    for arguments in [
        vec!["dem", "align", second, "--to", model, "-o", text(&out)],
        vec!["dem", "compare", model, second, "-o", text(&out)],
        vec!["dem", "profile", model, second, "--line", "500100,8699900 500200,8699800"],
        vec!["mosaic", model, second, "-o", text(&out)],
        vec!["dem", "contour", text(&void), "-o", text(&lines), "--interval", "10"],
        vec!["dem", "slope", text(&void), "-o", text(&out)],
    ] {
        let output = autoref(&arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains("no CRS") && said.contains("-a_srs") || said.contains("no cell has a height"), "{said}");
    }
    assert_eq!(std::fs::read_dir(folder.0.path()).expect("readable").count(), 5, "something was left behind");
}

#[test]
fn coarse_geographic_cells_meet_a_projected_model() {
    // Ten seconds of arc at 78° north: cells of 60 m by 310 m.
    const STEP_DEG: f64 = 10.0 / 3600.0;
    let folder = Folder::new();
    let (degrees, metres, out) = (folder.at("degrees.tif"), folder.at("metres.tif"), folder.at("out.tif"));
    let ground = |east: f64, north: f64| {
        let (e, n) = ((east - CORNER.0) / 1000.0, (north - CORNER.1) / 1000.0);
        300.0 + 90.0 * (e / 0.7 + (n / 1.1).sin()).sin() + 70.0 * (n / 0.6 + 0.4 * e).cos()
    };
    let transform = [CORNER.0, 30.0, 0.0, CORNER.1, 0.0, -30.0];
    write_on(&metres, &transform, (420, 420), Some(25833), |e, n| ground(CORNER.0 + 3.0 * e, CORNER.1 + 3.0 * n));
    let system = |code| {
        let mut reference = SpatialRef::from_epsg(code).expect("known");
        reference.set_axis_mapping_strategy(gdal::spatial_ref::AxisMappingStrategy::TraditionalGisOrder);
        reference
    };
    let to_map = gdal::spatial_ref::CoordTransform::new(&system(4258), &system(25833)).expect("a transformation");
    let corner = (15.005, 78.365);
    write_on(&degrees, &[corner.0, STEP_DEG, 0.0, corner.1, 0.0, -STEP_DEG], (180, 36), Some(4258), |x, y| {
        let (mut x, mut y) = ([corner.0 + x / 10.0 * STEP_DEG], [corner.1 + y / 10.0 * STEP_DEG]);
        to_map.transform_coords(&mut x, &mut y, &mut []).expect("near");
        ground(x[0], y[0])
    });
    for (a, b) in [(&degrees, &metres), (&metres, &degrees)] {
        let found =
            document(&autoref(&["dem", "align", text(a), "--to", text(b), "-o", text(&out), "--overwrite", "--json"]));
        for key in ["shift_e_m", "shift_n_m"] {
            let (value, error) =
                (found[key].as_f64().expect(key), found[&key.replace("_m", "_se_m")].as_f64().expect(key));
            assert!(value.abs() < 1.0 && value.abs() < 3.0 * error + 0.05, "{key}: {value} ± {error}");
        }
    }
}

#[test]
fn a_comparison_has_statistics_and_volumes() {
    let folder = Folder::new();
    let (a, b, zones, out) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("z.geojson"), folder.at("out"));
    write(&b, CORNER, (100, 100), hills);
    // A tenth of the ground has lost 10 m.
    write(&a, CORNER, (100, 100), |e, n| hills(e, n) - if e < 100.0 { 10.0 } else { 0.0 });
    let ring = "[[500000,8700000],[500100,8700000],[500100,8699000],[500000,8699000],[500000,8700000]]";
    let json = format!(
        r#"{{"type":"FeatureCollection","crs":{{"type":"name","properties":{{"name":"EPSG:25833"}}}},"features":[{{"type":"Feature",
        "properties":{{"name":"ice"}},"geometry":{{"type":"Polygon","coordinates":[{ring}]}}}}]}}"#
    );
    std::fs::write(&zones, json).expect("writable");
    let arguments = ["dem", "compare", text(&a), text(&b), "-o", text(&out), "--zones", text(&zones), "--json"];
    let found = document(&autoref(&arguments));
    assert_eq!(found["common_cells"], 10_000);
    assert!((found["mean_m"].as_f64().expect("a number") + 1.0).abs() < 1e-3, "{found}");
    assert!((found["volumes"][0]["volume_m3"].as_f64().expect("a number") + 1e6).abs() < 100.0, "{found}");
    let (difference, _) = read(&out.join("difference.tif"));
    assert!(difference.iter().enumerate().all(|(i, d)| (d + if i % 100 < 10 { 10.0 } else { 0.0 }).abs() < 1e-3));
    for name in ["report.html", "statistics.csv", "volumes.csv", "variogram.csv", "summary.json"] {
        assert!(out.join(name).exists(), "{name}");
    }
    let again = document(&autoref(&[&arguments[..], &["--overwrite", "--tile", "16", "--threads", "3"]].concat()));
    assert_eq!(again, found);
}

#[test]
fn the_nearest_view_wins_and_known_gains_come_back() {
    let folder = Folder::new();
    let scene = |e: f64, n: f64| 100.0 + 40.0 * (e / 37.0).sin() + 30.0 * (n / 53.0).cos();
    let sources: Vec<PathBuf> = (0..3).map(|i| folder.at(&format!("s{i}.tif"))).collect();
    let truth = [(1.0, 0.0), (1.25, -8.0), (0.8, 15.0)];
    for (i, path) in sources.iter().enumerate() {
        let shift = 400.0 * i as f64;
        let (gain, offset) = truth[i];
        write(path, (CORNER.0 + shift, CORNER.1), (100, 90), |e, n| gain * scene(e + shift, n) + offset);
        let range = path.with_file_name(format!("s{i}_range.tif"));
        write(&range, (CORNER.0 + shift, CORNER.1), (100, 90), |e, n| {
            ((e + shift) * 7.0 + n * 3.0 + 100.0 * i as f64).sin()
        });
    }
    let names: Vec<&str> = sources.iter().map(|p| text(p)).collect();
    let (out, index) = (folder.at("m.tif"), folder.at("i.tif"));
    let options = ["-o", text(&out), "--choose", "min:{stem}_range.tif", "--write-index", text(&index)];
    let made = document(&autoref(&[&["mosaic"][..], &names[..], &options[..], &["--json"]].concat()));
    assert_eq!((made["width"].as_u64(), made["height"].as_u64()), (Some(180), Some(90)));
    let (mosaic, numbers) = (read(&out).0, read(&index).0);
    for (cell, number) in numbers.iter().enumerate() {
        let (x, y) = ((cell % 180) as f64, (cell / 180) as f64);
        let (e, n) = (x * 10.0 + 5.0, -y * 10.0 - 5.0);
        let cost = |i: usize| ((e * 7.0 + n * 3.0 + 100.0 * i as f64).sin() as f32).to_bits();
        let inside = (0..3).filter(|&i| (40.0 * i as f64..40.0 * i as f64 + 100.0).contains(&x));
        let best = inside.min_by(|&a, &b| f32::from_bits(cost(a)).total_cmp(&f32::from_bits(cost(b)))).expect("one");
        assert_eq!(*number as usize, best + 1, "cell {x}, {y}");
        let (gain, offset) = truth[best];
        assert!((mosaic[cell] - gain * scene(e, n) - offset).abs() < 1e-3);
    }
    let first = std::fs::read(&out).expect("readable");
    let again =
        [&["mosaic"][..], &names[..], &options[..], &["--overwrite", "--tile", "100", "--threads", "3"]].concat();
    assert!(autoref(&again).status.success());
    assert!(first == std::fs::read(&out).expect("readable"), "the tiling changed the file");
    let balanced = folder.at("balanced.tif");
    let made =
        document(&autoref(&[&["mosaic"][..], &names[..], &["-o", text(&balanced), "--balance", "--json"]].concat()));
    let gains: Vec<f64> = (0..3).map(|i| made["balance"]["gains"][i][0].as_f64().expect("a number")).collect();
    for i in 1..3 {
        let (found, expected) = (gains[0] / gains[i], truth[i].0 / truth[0].0);
        assert!((found / expected - 1.0).abs() < 0.01, "gain {i}: {found} for {expected}");
    }
    for overlap in made["balance"]["overlaps"].as_array().expect("a list") {
        assert!(overlap["rms_after"].as_f64() < Some(0.05), "{overlap}");
    }
}

#[test]
fn smooth_surfaces_are_evened_out_and_seams_blended() {
    let folder = Folder::new();
    let scene = |e: f64, n: f64| 100.0 + 20.0 * (e / 97.0).sin() + 15.0 * (n / 73.0).cos();
    let sources: Vec<PathBuf> = (0..2).map(|i| folder.at(&format!("s{i}.tif"))).collect();
    write(&sources[0], CORNER, (160, 150), scene);
    write(&sources[1], (CORNER.0 + 480.0, CORNER.1), (160, 150), |e, n| {
        let (u, v) = (e / 800.0 - 1.0, n / 750.0 + 1.0);
        1.1 * scene(e + 480.0, n) - 6.0 + 9.0 * u - 5.0 * v * v
    });
    let names = [text(&sources[0]), text(&sources[1])];
    let out = folder.at("m.tif");
    let balanced = |options: &[&str]| {
        let fixed = ["-o", text(&out), "--overwrite", "--json", "--balance", "--balance-to", names[0]];
        document(&autoref(&[&["mosaic"][..], &names[..], &fixed[..], options].concat()))
    };
    let page = folder.at("m.html");
    let rms = |made: &Value| made["balance"]["overlaps"][0]["rms_after"].as_f64().expect("a number");
    let (none, smooth) =
        (balanced(&["--balance-surface", "none"]), balanced(&["--choose", "last", "--balance-page", text(&page)]));
    assert!(rms(&smooth) < 0.2 * rms(&none), "{} of {}", rms(&smooth), rms(&none));
    assert_eq!(
        (smooth["balance"]["gains"][0][0].as_f64(), smooth["balance"]["offsets"][0][0].as_f64()),
        (Some(1.0), Some(0.0))
    );
    assert!(std::fs::read_to_string(&page).expect("a page").contains("<svg"));

    let jump = |row: &[f64]| row.windows(2).map(|w| (w[1] - w[0]).abs()).fold(0.0, f64::max);
    let plain = |options: &[&str]| {
        let fixed = ["-o", text(&out), "--overwrite"];
        assert!(autoref(&[&["mosaic"][..], &names[..], &fixed[..], options].concat()).status.success());
        let values = read(&out).0;
        (jump(&values[60 * 208..61 * 208]), std::fs::read(&out).expect("readable"))
    };
    let (sharp, blended) = (plain(&[]), plain(&["--blend", "40"]));
    assert!(blended.0 < 0.7 * sharp.0, "{} of {}", blended.0, sharp.0);
    assert!(blended.1 == plain(&["--blend", "40", "--tile", "64", "--threads", "3"]).1, "the tiling changed the file");
    let stranger =
        autoref(&["mosaic", names[0], "-o", text(&out), "--overwrite", "--balance", "--balance-to", names[1]]);
    assert_eq!(stranger.status.code(), Some(2));
}

#[test]
fn geographic_cells_have_their_true_sides() {
    let folder = Folder::new();
    let (plane, degrees) = (folder.at("plane.tif"), folder.at("degrees.tif"));
    // The same ground in metres and in degrees at 60° north, where a degree of longitude is 55.8 km.
    write(&plane, CORNER, (60, 50), |e, n| 0.3 * e + 0.2 * n + 5.0 * (e / 70.0).sin());
    let (mx, my) = (55_799.98, 111_412.24);
    {
        let (values, _) = read(&plane);
        let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
        let mut dataset = driver.create_with_band_type::<f32, _>(&degrees, 60, 50, 1).expect("writable");
        let north = 60.0 + 250.0 / my;
        dataset.set_geo_transform(&[10.0, 10.0 / mx, 0.0, north, 0.0, -10.0 / my]).expect("a geotransform");
        dataset.set_spatial_ref(&SpatialRef::from_epsg(4326).expect("known")).expect("a CRS");
        let mut band = dataset.rasterband(1).expect("a band");
        band.set_no_data_value(Some(-9999.0)).expect("a value");
        let values = values.iter().map(|v| *v as f32).collect();
        band.write((0, 0), (60, 50), &mut Buffer::new((60, 50), values)).expect("writable");
    }
    let kinds: [(&[&str], f64); 6] = [
        (&["slope"], 0.01),
        (&["slope", "--percent", "--alg", "zevenbergen-thorne"], 0.01),
        (&["aspect"], 0.03),
        (&["hillshade"], 1.0),
        (&["hillshade", "--multidirectional", "--z", "2"], 1.0),
        (&["hillshade", "--az", "20", "--alt", "60", "--compute-edges"], 1.0),
    ];
    for (kind, allowed) in kinds {
        let mut seen = Vec::new();
        for model in [&plane, &degrees] {
            let out = folder.at("out.tif");
            let arguments = [&["dem", kind[0], text(model), "-o", text(&out), "--overwrite"], &kind[1..]].concat();
            let output = autoref(&arguments);
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            seen.push(read(&out).0);
        }
        let most = seen[0].iter().zip(&seen[1]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(most <= allowed, "{kind:?}: {most}");
        assert!(seen[0].iter().any(|v| *v != seen[0][0]), "{kind:?} is not level");
    }
}

#[test]
fn a_page_has_a_map_and_bad_tables_of_colours_are_named() {
    let folder = Folder::new();
    let (a, b, out) = (folder.at("a.tif"), folder.at("b.tif"), folder.at("out"));
    write(&b, CORNER, (90, 70), hills);
    // Two thirds are equal: the median deviation is 0, the error of the mean is not.
    write(&a, CORNER, (90, 70), |e, n| hills(e, n) + if e > 600.0 { (e / 40.0).sin() } else { 0.0 });
    let summary = document(&autoref(&["dem", "compare", text(&a), text(&b), "-o", text(&out), "--json"]));
    assert_eq!(summary["nmad_m"], 0.0);
    assert!(summary["mean_se_m"].as_f64().is_some_and(|error| error > 1e-3), "{}", summary["mean_se_m"]);
    let page = std::fs::read_to_string(out.join("report.html")).expect("a page");
    for word in ["id=\"swipe\"", "const DATA = {", "\"width\":90", "id=\"profile\""] {
        assert!(page.contains(word), "{word}");
    }
    assert!(!page.contains("http://") && !page.contains("https://"), "readable without a network");
    if let Some(mut browser) = Browser::start() {
        browser.open(&out.join("report.html"));
        // The middle of the map, which has heights.
        let told = browser.eval(
            "(() => { const r = map.getBoundingClientRect(); map.dispatchEvent(new MouseEvent('mousemove', \
             { clientX: r.left + r.width / 2, clientY: r.top + r.height / 2 })); return readout.textContent; })()",
        );
        assert!(told.as_str().is_some_and(|told| told.contains("A − B")), "{told}");
        assert_eq!(browser.complaints(), Vec::<String>::new());
    }
    let table = folder.at("colours.txt");
    for (content, word) in [("not a table\n", "line 1"), ("# nothing\n", "no colour"), ("100 1 2\n", "line 1")] {
        std::fs::write(&table, content).expect("writable");
        let picture = folder.at("colour.tif");
        let output = autoref(&["dem", "colour", text(&a), "--table", text(&table), "-o", text(&picture)]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(word), "{said}");
        assert!(!picture.exists());
    }
    std::fs::write(&table, "0 0 0 255\n300 green\n50% 1 2 3 4\n1000,255,0,0\nnv 0 0 0\n").expect("writable");
    let output = autoref(&["dem", "colour", text(&a), "--table", text(&table), "-o", text(&folder.at("c.tif"))]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // Nothing is left beside the model, and a share of the range is the height that it says.
    assert!(!folder.at("a.tif.aux.xml").exists());
    let (heights, _) = read(&a);
    let (low, high) = heights.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let ramp = format!("{low} 0 0 0\n{} 100 0 0\n{high} 200 0 0\n", low + (high - low) / 4.0);
    let drawn = |table_text: &str, name: &str| {
        std::fs::write(&table, table_text).expect("writable");
        let out = folder.at(name);
        let output = autoref(&["dem", "colour", text(&a), "--table", text(&table), "-o", text(&out)]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        read(&out).0
    };
    assert_eq!(drawn("0% 0 0 0\n25% 100 0 0\n100% 200 0 0\n", "share.tif"), drawn(&ramp, "height.tif"));
}

/// GDAL's warper brings the same heights to the ellipsoid by itself: the two ways must meet.
#[test]
fn heights_above_a_geoid_meet_those_above_the_ellipsoid() {
    let folder = Folder::new();
    let (geoid, ellipsoid, elsewhere) = (folder.at("geoid.tif"), folder.at("ellipsoid.tif"), folder.at("utm.tif"));
    write(&geoid, (0.0, 0.0), (200, 160), hills);
    let step = 0.001;
    let set = |path: &Path, crs: &str| {
        let mut dataset = gdal::Dataset::open_ex(
            path,
            gdal::DatasetOptions { open_flags: gdal::GdalOpenFlags::GDAL_OF_UPDATE, ..Default::default() },
        )
        .expect("writable");
        dataset.set_geo_transform(&[11.0, step, 0.0, 47.0, 0.0, -step]).expect("a geotransform");
        dataset.set_spatial_ref(&SpatialRef::from_definition(crs).expect("known")).expect("a CRS");
    };
    set(&geoid, "EPSG:4326+5773");
    let warp = |options: &[&str], from: &Path, to: &Path| {
        let done = Command::new("gdalwarp").arg("-q").args(options).args([from, to]).status().expect("GDAL's programs");
        assert!(done.success());
    };
    warp(&["-t_srs", "EPSG:4979"], &geoid, &ellipsoid);
    let (out, aligned) = (folder.at("compared"), folder.at("aligned.tif"));
    let found = document(&autoref(&["dem", "compare", text(&geoid), text(&ellipsoid), "-o", text(&out), "--json"]));
    let heights = found["heights"].as_str().expect("a sentence");
    assert!(heights.contains("EGM96") && heights.contains("added"), "{heights}");
    let figure = |key: &str| found[key].as_f64().expect(key);
    assert!(figure("mean_m").abs() < 0.001 && figure("rmse_m") < 0.002, "{found:#}");
    assert_eq!(figure("common_cells"), 200.0 * 160.0, "seen cell for cell, not resampled");
    // What is written counts from B's datum, and says so.
    let shift =
        document(&autoref(&["dem", "align", text(&geoid), "--to", text(&ellipsoid), "-o", text(&aligned), "--json"]));
    assert!(shift["shift_h_m"].as_f64().expect("a shift").abs() < 0.001, "{shift:#}");
    let written = gdal::Dataset::open(&aligned).expect("readable").spatial_ref().expect("a CRS");
    assert_eq!(written.axes_count(), 3);
    assert!(written.get_attr_value("VERT_CS|VERT_DATUM", 0).ok().flatten().is_none(), "no geoid any more");
    let undulation = read(&aligned).0[0] - read(&geoid).0[0];
    assert!((40.0..55.0).contains(&undulation), "{undulation} m in the Alps");
    // Another projection beside: the geoid's heights go along unchanged, and are brought up after.
    warp(&["-t_srs", "EPSG:32632+5773", "-tr", "80", "80", "-r", "cubic"], &geoid, &elsewhere);
    let out = folder.at("projected");
    let found = document(&autoref(&["dem", "compare", text(&elsewhere), text(&ellipsoid), "-o", text(&out), "--json"]));
    assert!(found["median_m"].as_f64().expect("a median").abs() < 1.0, "{found:#}");
    // No grid for this one is shipped with PROJ: it is named, nothing is written.
    set(&geoid, "EPSG:4937");
    set(&elsewhere, "EPSG:4258+5941");
    let out = folder.at("refused");
    let refused = autoref(&["dem", "compare", text(&elsewhere), text(&geoid), "-o", text(&out)]);
    let message = String::from_utf8_lossy(&refused.stderr);
    if !message.is_empty() {
        assert_eq!(refused.status.code(), Some(2), "{message}");
        assert!(message.contains("NN2000") && message.contains("utm.tif") && message.contains("projsync"), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
        assert!(!out.exists());
    }
}

/// NaN is no height to drawings and to coarser cells, whatever value the model declares for that.
#[test]
fn nan_is_no_height_beside_a_nodata_value() {
    let folder = Folder::new();
    let hole = |height: f64| {
        move |east: f64, north: f64| match (east as i64 / 10, north as i64 / -10) {
            (11, 9) => height,
            _ => hills(east, north),
        }
    };
    let (nan, nodata) = (folder.at("nan.tif"), folder.at("nodata.tif"));
    write(&nan, CORNER, (24, 20), hole(f64::NAN));
    write(&nodata, CORNER, (24, 20), hole(-9999.0));
    let drawn = |command: &[&str], model: &Path| {
        let out = folder.at("out.tif");
        let words = [&["dem"], command, &[text(model), "-o", text(&out), "--overwrite"]].concat();
        let output = autoref(&words);
        assert!(output.status.success(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
        read(&out).0
    };
    for command in [
        &["slope"][..],
        &["hillshade", "--compute-edges"],
        &["roughness"],
        &["resample", "--resolution", "20", "--resampling", "average"],
        &["resample", "--resolution", "30", "--resampling", "cubic"],
    ] {
        let (a, b) = (drawn(command, &nan), drawn(command, &nodata));
        assert!(a.iter().all(|v| !v.is_nan()) && a == b, "{command:?}");
    }
}

/// Two models of one plane differ by nothing, also where the finer one covers only a part of a cell, and the document
/// says how it came onto the other's grid. A difference that is no whole number of steps is not cut.
#[test]
fn cells_that_are_covered_in_part_are_compared_at_their_middle() {
    let folder = Folder::new();
    let (fine, coarse, out) = (folder.at("fine.tif"), folder.at("coarse.tif"), folder.at("out"));
    let plane = |east: f64, north: f64| 0.8 * east - 0.5 * north;
    let (x0, y0) = (CORNER.0 + 44.0, CORNER.1 - 26.0);
    write_on(&fine, &[x0, 10.0, 0.0, y0, 0.0, -10.0], (152, 140), Some(25833), |east, north| {
        plane(east + 44.0, north - 26.0) + 0.1
    });
    // Ten times as wide: `write_on` counts tenths of a cell.
    write_on(&coarse, &[CORNER.0, 100.0, 0.0, CORNER.1, 0.0, -100.0], (20, 18), Some(25833), |east, north| {
        plane(10.0 * east, 10.0 * north)
    });
    let told = document(&autoref(&[
        "dem",
        "compare",
        text(&fine),
        text(&coarse),
        "-o",
        text(&out),
        "--json",
        "--resampling",
        "nearest",
    ]));
    assert_eq!(told["resampling"], "mean");
    let number = |key: &str| told[key].as_f64().expect("a number");
    assert!((number("mean_m") - 0.1).abs() < 2e-5 && number("sd_m") < 2e-3, "{told}");
    assert!((number("rmse_m") - 0.1).abs() < 2e-5, "{told}");
}
