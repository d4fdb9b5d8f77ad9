//! The main job from the command line: an image and a list in, a georeference out, or one clear reason why not.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_raster::coords::PixelPoint;
use autoref_synth::{
    self as synth, Background, Compression, FileLayout, MarkSize, MarkStyle, SynthSpec, Truth, Visible,
};
use serde_json::Value;

/// A folder with a sample image, its list and its truth.
struct Sample {
    folder: tempfile::TempDir,
    truth: Truth,
}

impl Sample {
    fn new(change: impl FnOnce(&mut SynthSpec)) -> Sample {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let gcps = synth::random_gcps(14, 36.0, 26.0, 11);
        let mut spec = SynthSpec {
            gcps,
            size_px: Some((1250, 930)),
            rotation_deg: 7.5,
            visible: Visible::Random(9),
            mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
            ..SynthSpec::default()
        };
        spec.output.compression = Compression::Deflate;
        change(&mut spec);
        let truth = synth::write(&spec, &folder.path().join("e6.tif")).expect("a sample");
        synth::write_gcp_geojson(&folder.path().join("e6.geojson"), &spec.gcps, Some(32632)).expect("a list");
        Sample { folder, truth }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, extra: &[&str]) -> Output {
        let (image, list) = (self.path("e6.tif"), self.path("e6.geojson"));
        let mut args = vec![image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain")];
        args.extend(extra);
        autoref(&args)
    }

    fn json(&self) -> Value {
        let text = std::fs::read_to_string(self.path("e6.autoref.json")).expect("the result was written");
        serde_json::from_str(&text).expect("one JSON document")
    }
}

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Every match must be the GCP it says, within 0.5 px, and nearly all within 0.25.
fn check_against_truth(result: &Value, truth: &Truth) {
    let matches = result["matches"].as_array().expect("a list");
    let mut close = 0;
    for row in matches {
        let gcp = truth.gcps.iter().find(|g| g.name == row["gcp"]).expect("a name of the list");
        assert!(gcp.visible, "{} has no mark", gcp.name);
        let error = (row["x"].as_f64().expect("x") - gcp.x).hypot(row["y"].as_f64().expect("y") - gcp.y);
        assert!(error < 0.5, "{} is off by {error} px", gcp.name);
        close += usize::from(error <= 0.25);
    }
    assert!(close * 100 >= matches.len() * 95, "{close} of {} within 0.25 px", matches.len());
}

#[test]
fn an_orthophoto_and_a_list_become_a_georeference() {
    let sample = Sample::new(|_| {});
    let before = std::fs::read(sample.path("e6.tif")).expect("the sample");
    let output = sample.run(&["--tile", "512"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(before == std::fs::read(sample.path("e6.tif")).expect("still there"), "the input was touched");
    let result = sample.json();
    assert_eq!(result["status"], "solved");
    assert_eq!(result["crs"], "EPSG:32632");
    assert_eq!(result["matches"].as_array().map(Vec::len), Some(sample.truth.visible().count()));
    check_against_truth(&result, &sample.truth);
    assert!((result["scale_m_per_px"].as_f64().expect("a number") - 0.03).abs() < 1e-5);
    assert!((result["rotation_deg"].as_f64().expect("a number") - 7.5).abs() < 0.01);
    assert!(result["false_alarms"].as_f64().expect("a number") < 1e-6);
    assert!(result["peak_memory_bytes"].as_u64().expect("measured") < 512 << 20);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    for word in ["Matched", "RMSE", "Verdict", "e6.tfw"] {
        assert!(text.contains(word), "no `{word}` in\n{text}");
    }
    assert!((6..=8).contains(&text.lines().count()), "{text}");
    gdal_agrees(&sample, &result);
}

/// GDAL puts every mark's pixel where the JSON's transform puts it, to a millionth of a pixel.
fn gdal_agrees(sample: &Sample, result: &Value) {
    let numbers: Vec<f64> = serde_json::from_value(result["geotransform"].clone()).expect("six numbers");
    let expected = autoref_raster::coords::GeoTransform(numbers.try_into().expect("six numbers"));
    let through_aux = transform_of(&sample.path("e6.tif"));
    // The world file alone, beside a copy without the .aux.xml.
    std::fs::create_dir(sample.path("w")).expect("a folder");
    std::fs::copy(sample.path("e6.tif"), sample.path("w/e6.tif")).expect("copied");
    std::fs::copy(sample.path("e6.tfw"), sample.path("w/e6.tfw")).expect("copied");
    let through_world = transform_of(&sample.path("w/e6.tif"));
    for row in result["matches"].as_array().expect("a list") {
        let pixel = PixelPoint { x: row["x"].as_f64().expect("x"), y: row["y"].as_f64().expect("y") };
        for read in [through_aux, through_world] {
            let back = expected.invert(read.apply(pixel)).expect("not singular");
            assert!((back.x - pixel.x).hypot(back.y - pixel.y) < 1e-6, "{back:?} is not {pixel:?}");
        }
        let surveyed = expected.apply(pixel);
        let residual =
            (row["easting"].as_f64().expect("e") - surveyed.easting, row["residual_e_m"].as_f64().expect("r"));
        assert!((residual.0 - residual.1).abs() < 1e-6, "residual = surveyed − computed");
    }
    let dataset = gdal::Dataset::open(sample.path("e6.tif")).expect("GDAL opens it");
    assert!(dataset.projection().contains("UTM zone 32N"), "{}", dataset.projection());
}

fn transform_of(path: &Path) -> autoref_raster::coords::GeoTransform {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    autoref_raster::coords::GeoTransform(dataset.geo_transform().expect("it is georeferenced"))
}

/// The image with its columns in reverse order.
fn turn_over(path: &Path) {
    let dataset = gdal::Dataset::open(path).expect("GDAL opens it");
    let (width, height) = dataset.raster_size();
    let bands: Vec<gdal::raster::Buffer<u8>> = (1..=dataset.raster_count())
        .map(|band| dataset.rasterband(band).and_then(|b| b.read_band_as()).expect("readable"))
        .collect();
    drop(dataset);
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let turned = driver.create_with_band_type::<u8, _>(path, width, height, bands.len()).expect("writable");
    for (i, mut band) in bands.into_iter().enumerate() {
        band.data_mut().chunks_mut(width).for_each(<[u8]>::reverse);
        turned.rasterband(i + 1).and_then(|mut b| b.write((0, 0), (width, height), &mut band)).expect("writable");
    }
    turned.close().expect("closed");
}

#[test]
fn a_mirrored_image_is_solved_on_request_only() {
    let mut sample = Sample::new(|_| {});
    turn_over(&sample.path("e6.tif"));
    let refused = sample.run(&["--quiet"]);
    assert_eq!(refused.status.code(), Some(1), "{}", stderr(&refused));
    assert!(!sample.path("e6.tfw").exists());
    assert!(sample.json()["advice"].to_string().contains("mirrored"), "{}", sample.json()["advice"]);
    let output = sample.run(&["--allow-mirrored", "--overwrite", "--report"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(String::from_utf8_lossy(&output.stdout).contains("the image is mirrored"));
    let width = 1250.0;
    sample.truth.gcps.iter_mut().for_each(|gcp| gcp.x = width - gcp.x);
    let result = sample.json();
    assert_eq!(result["matches"].as_array().map(Vec::len), Some(sample.truth.visible().count()));
    check_against_truth(&result, &sample.truth);
    gdal_agrees(&sample, &result);
    // A replay of a review without changes gives the same transform.
    let json = sample.path("e6.autoref.json");
    let patch = serde_json::json!({"schema": "autoref-stream-patch", "schema_version": 1, "for": "gcps",
        "source": "e6.autoref.json", "edits": []});
    std::fs::write(sample.path("p.json"), patch.to_string()).expect("written");
    let replayed = autoref(&[
        "solve",
        json.to_str().expect("plain"),
        "--patch",
        sample.path("p.json").to_str().expect("plain"),
        "--json",
    ]);
    let again: Value = serde_json::from_slice(&replayed.stdout).unwrap_or_else(|_| panic!("{}", stderr(&replayed)));
    assert_eq!(again["geotransform"], result["geotransform"]);
}

#[test]
fn json_on_stdout_is_exactly_one_document() {
    let sample = Sample::new(|_| {});
    let output = sample.run(&["--json"]);
    let result: Value = serde_json::from_slice(&output.stdout).expect("one document and nothing else");
    assert_eq!(result["status"], "solved");
    assert_eq!(result["gcps_listed"], 14);
}

#[test]
fn out_writes_elsewhere_with_a_vrt() {
    let sample = Sample::new(|_| {});
    let out = sample.path("results");
    let output = sample.run(&["--out", out.to_str().expect("plain"), "--quiet"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let mut names: Vec<String> = std::fs::read_dir(&out)
        .expect("the folder was made")
        .map(|entry| entry.expect("readable").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["e6.autoref.json", "e6.report.html", "e6.tfw", "e6.tif.aux.xml", "e6.vrt"]);
    let text = std::fs::read_to_string(out.join("e6.autoref.json")).expect("written");
    let result: Value = serde_json::from_str(&text).expect("a document");
    let numbers: Vec<f64> = serde_json::from_value(result["geotransform"].clone()).expect("six numbers");
    assert_eq!(transform_of(&out.join("e6.vrt")).0.to_vec(), numbers);
    assert!(!sample.path("e6.tfw").exists(), "nothing beside the image");
}

#[test]
fn an_existing_output_is_an_error_before_any_work() {
    let sample = Sample::new(|_| {});
    std::fs::write(sample.path("e6.tfw"), "mine").expect("writable");
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("e6.tfw") && stderr(&output).contains("--overwrite"), "{}", stderr(&output));
    assert_eq!(std::fs::read_to_string(sample.path("e6.tfw")).expect("still there"), "mine");
    assert!(!sample.path("e6.autoref.json").exists());
    assert_eq!(sample.run(&["--overwrite"]).status.code(), Some(0));
}

#[test]
fn an_image_without_marks_is_refused_with_a_reason() {
    let sample = Sample::new(|spec| spec.visible = Visible::Random(0));
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let result = sample.json();
    assert_eq!(result["status"], "refused");
    assert!(result["reason"].as_str().is_some_and(|reason| !reason.is_empty()));
    assert!(!sample.path("e6.tfw").exists() && !sample.path("e6.tif.aux.xml").exists(), "no georeference");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(text.contains("Not solved") && text.contains("candidates"), "{text}");
}

#[test]
fn check_points_stay_out_of_the_fit() {
    let sample = Sample::new(|spec| spec.visible = Visible::All);
    let names: Vec<&str> = sample.truth.visible().take(2).map(|g| g.name.as_str()).collect();
    let output = sample.run(&["--check", &names.join(",")]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let result = sample.json();
    let of = |key: &str| -> Vec<String> {
        let rows = result[key].as_array().expect("a list").iter();
        rows.map(|row| row["gcp"].as_str().expect("a name").to_string()).collect()
    };
    let mut checked = of("check_points");
    checked.sort();
    let mut expected = names.clone();
    expected.sort_unstable();
    assert_eq!(checked, expected);
    assert!(of("matches").iter().all(|name| !names.contains(&name.as_str())));
}

#[test]
fn detect_and_solve_do_the_job_in_two_steps() {
    let sample = Sample::new(|_| {});
    let (image, list) = (sample.path("e6.tif"), sample.path("c.csv"));
    let detected = autoref(&["detect", image.to_str().expect("plain"), "-o", list.to_str().expect("plain")]);
    assert_eq!(detected.status.code(), Some(0), "{}", stderr(&detected));
    let gcps = sample.path("e6.geojson");
    let args = ["solve", list.to_str().expect("plain"), "--gcps", gcps.to_str().expect("plain"), "--size", "1250,930"];
    let solved = autoref(&[&args[..], &["--json"]].concat());
    assert_eq!(solved.status.code(), Some(0), "{}", stderr(&solved));
    let result: Value = serde_json::from_slice(&solved.stdout).expect("one document");
    check_against_truth(&result, &sample.truth);
    assert!(!sample.path("c.autoref.json").exists(), "without -o nothing is written");
}

#[test]
fn bad_input_is_one_line_that_names_the_file() {
    let sample = Sample::new(|_| {});
    let folder = sample.folder.path();
    let write = |name: &str, content: &[u8]| {
        std::fs::write(folder.join(name), content).expect("writable");
        folder.join(name)
    };
    let whole = std::fs::read(sample.path("e6.tif")).expect("the sample");
    let list = sample.path("e6.geojson");
    let one_point = br#"{"type":"FeatureCollection","features":[{"type":"Feature","geometry":{"type":"Point","coordinates":[570000,7000000]},"properties":{"name":"A"}}]}"#;
    let cases: Vec<(PathBuf, PathBuf, &str)> = vec![
        (sample.path("e6.tif"), folder.join("absent.geojson"), "absent.geojson"),
        (sample.path("e6.tif"), write("one.geojson", one_point), "one.geojson"),
        (sample.path("e6.tif"), write("bad.csv", b"name,easting,northing\nA,1,2\nB,x,4\n"), "row 3"),
        (sample.path("e6.tif"), write("empty.csv", b""), "empty.csv"),
        (write("cut.tif", &whole[..whole.len() / 2]), list.clone(), "cut.tif"),
        (write("text.tif", b"this is no picture\n"), list.clone(), "text.tif"),
        (write("nothing.tif", b""), list.clone(), "nothing.tif"),
        (folder.to_path_buf(), list.clone(), "directory"),
        (folder.join("absent.tif"), list.clone(), "absent.tif"),
    ];
    let out = folder.join("out/results");
    let out_args = ["--quiet", "--out", out.to_str().expect("plain")];
    for (image, gcps, word) in cases {
        let input = [image.to_str().expect("plain"), "--gcps", gcps.to_str().expect("plain")];
        let output = autoref(&[&input[..], &out_args].concat());
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{image:?} {gcps:?}: {message}");
        assert!(message.contains(word), "no `{word}` in: {message}");
        assert_eq!(message.trim_end().lines().count(), 1, "more than one line: {message}");
        assert!(!message.contains("panicked"), "{message}");
        assert!(!folder.join("out").exists(), "a folder is left: {message}");
    }
    let leftovers = std::fs::read_dir(folder).expect("readable").filter_map(|entry| {
        let name = entry.expect("readable").file_name().to_string_lossy().into_owned();
        (name.contains(".part") || name.ends_with(".tfw") || name.ends_with(".autoref.json")).then_some(name)
    });
    assert_eq!(leftovers.collect::<Vec<_>>(), Vec::<String>::new());
}

#[test]
fn too_little_memory_is_refused_with_numbers() {
    let sample = Sample::new(|_| {});
    let output = sample.run(&["--memory", "64M"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(stderr(&output).contains("112M"), "{}", stderr(&output));
}

#[test]
fn memory_stays_within_the_smallest_budget() {
    for layout in [FileLayout::Tiles(512), FileLayout::Strips(16)] {
        let sample = Sample::new(|spec| {
            // More bytes than the budget.
            spec.size_px = Some((7200, 5600));
            spec.gsd_m = 0.01;
            spec.output.layout = layout;
            // Ground of one colour: drawing and packing another takes longer than the run.
            (spec.background, spec.noise_sigma) = (Background::Flat([112, 108, 96]), 0.0);
        });
        let output = sample.run(&["--memory", "112M"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let peak = sample.json()["peak_memory_bytes"].as_u64().expect("measured");
        assert!(peak <= 112 << 20, "{} MiB", peak >> 20);
    }
}

#[test]
fn every_list_format_gives_the_same_run() {
    let sample = Sample::new(|_| {});
    let rows: Vec<_> = sample.truth.gcps.iter().collect();
    let csv: String = std::iter::once("h;Navn;Nord;Øst\n".to_string())
        .chain(rows.iter().map(|g| format!(";{};{};{}\n", g.name, decimal_comma(g.northing), decimal_comma(g.easting))))
        .collect();
    let kof: String =
        rows.iter().enumerate().map(|(i, g)| format!("{i} {} {} {} 0\n", g.name, g.northing, g.easting)).collect();
    let mut results = Vec::new();
    for (name, text) in [("a.csv", csv), ("a.kof", kof)] {
        let list = sample.path(name);
        std::fs::write(&list, text).expect("writable");
        let image = sample.path("e6.tif");
        let args = [image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--crs", "EPSG:32632"];
        let output = autoref(&[&args[..], &["--overwrite"]].concat());
        assert_eq!(output.status.code(), Some(0), "{name}: {}", stderr(&output));
        results.push(sample.json()["geotransform"].clone());
    }
    sample.run(&["--overwrite"]);
    results.push(sample.json()["geotransform"].clone());
    assert!(results.iter().all(|r| *r == results[0]), "{results:?}");
}

fn decimal_comma(value: f64) -> String {
    value.to_string().replace('.', ",")
}

#[test]
fn a_profile_says_where_the_time_went() {
    let sample = Sample::new(|_| {});
    let profile = sample.path("profile.json");
    let at = profile.to_str().expect("plain");
    for _ in 0..2 {
        // The second run replaces the first one's profile.
        let output = sample.run(&["--profile-json", at, "--quiet", "--overwrite", "--second-pass=never"]);
        assert!(output.status.code() != Some(2), "{}", stderr(&output));
    }
    let document: Value = serde_json::from_slice(&std::fs::read(&profile).expect("written")).expect("JSON");
    let seconds = |path: &str, key: &str| {
        let spans = document["spans"].as_array().expect("a list");
        let span = spans.iter().find(|span| span["path"] == path);
        span.unwrap_or_else(|| panic!("no {path} in {document}"))[key].as_f64().expect("a number")
    };
    let whole = seconds("command", "open_s");
    for path in ["open", "scan", "scan/read and classify", "scan/segment", "scan/examine", "scan/merge", "match"] {
        let stage = seconds(&format!("command/{path}"), "busy_s");
        assert!(stage >= 0.0 && seconds(&format!("command/{path}"), "count") >= 1.0, "{path}");
    }
    assert!(seconds("command/scan", "open_s") <= whole && whole <= document["elapsed_s"].as_f64().expect("a number"));
    // Nothing else is written over, and a list is no profile.
    let list = sample.path("e6.geojson");
    let before = std::fs::read(&list).expect("there");
    let output = sample.run(&["--profile-json", list.to_str().expect("plain"), "--quiet"]);
    assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
    assert_eq!(std::fs::read(&list).expect("there"), before);
    let said = stderr(&sample.run(&["-v", "--overwrite", "--second-pass=never"]));
    assert!(said.contains("read and classify") && said.contains("s in threads"), "{said}");
}

/// A refused picture says what is unusual about it, and the option that it names helps.
#[test]
fn twelve_bits_in_sixteen_are_named_and_then_solved() {
    let fixtures = crate::common::root().join("fixtures");
    let folder = tempfile::tempdir().expect("a folder");
    let (image, list) = (folder.path().join("b12.tif"), fixtures.join("field.geojson"));
    let options = ["-q", "-ot", "UInt16", "-scale", "0", "255", "0", "4080"];
    let made = Command::new("gdal_translate").args(options).arg(fixtures.join("field.tif")).arg(&image).output();
    assert!(made.expect("GDAL's programs are there").status.success());
    let run = |extra: &[&str]| {
        let mut args = vec![image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--no-report"];
        args.extend(["--overwrite", "--quiet", "--json"]);
        args.extend(extra);
        let output = autoref(&args);
        (output.status.code(), serde_json::from_slice::<Value>(&output.stdout).expect("one document"))
    };
    let (code, refused) = run(&[]);
    assert_eq!(code, Some(1), "{refused}");
    let advice = refused["advice"].to_string();
    assert!(advice.contains("--white 4095") && !advice.contains("grey"), "{advice}");
    let (code, solved) = run(&["--white", "4080"]);
    assert_eq!((code, solved["matches"].as_array().map(Vec::len)), (Some(0), Some(9)), "{}", solved["reason"]);
}
