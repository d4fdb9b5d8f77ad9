//! Rendered flights: the files say one thing, other commands find the truth again, and bad requests are one line.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("plain")
}

const SMALL: [&str; 10] = ["--size", "160,120", "--f-px", "170", "--samples", "1", "--frames", "3", "--points", "8,4"];

fn rendered(folder: &Path, extra: &[&str]) -> Value {
    let mut args = vec!["synth-flight", text(folder)];
    args.extend(SMALL);
    args.extend(extra);
    let output = autoref(&args);
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    let truth = std::fs::read_to_string(folder.join("truth.json")).expect("written");
    serde_json::from_str(&truth).expect("JSON")
}

fn bytes(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = Vec::new();
    for inner in [folder.to_path_buf(), folder.join("frames")] {
        for entry in std::fs::read_dir(&inner).expect("a folder") {
            let path = entry.expect("readable").path();
            if path.is_file() {
                let name = path.file_name().expect("a name").to_string_lossy().into_owned();
                files.push((name, std::fs::read(&path).expect("readable")));
            }
        }
    }
    files.sort();
    files
}

/// Without errors in list and observations, space resection finds every camera where the truth has it, upright and oblique.
#[test]
fn resection_finds_the_cameras_of_the_truth() {
    for (pitch, seed) in [("-90", "4"), ("-25", "9")] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let errors = ["--sigma-ground", "0", "--sigma-image", "0", "--distortion", "k1=-0.03", "--pp-offset", "3,-2"];
        let mut extra = vec!["--pitch", pitch, "--seed", seed, "--base", "500", "--grey"];
        extra.extend(errors);
        let truth = rendered(folder.path(), &extra);
        let images = truth["images"].as_array().expect("a list");
        assert_eq!(images.len(), 3);
        let pp = truth["pp_px"].as_array().expect("two numbers");
        let pp = format!("{},{}", pp[0], pp[1]);
        let list = folder.path().join("gcps.txt");
        for image in images {
            let frame = folder.path().join("frames").join(image["name"].as_str().expect("a name"));
            let resected = autoref(&[
                "flight",
                "resect",
                text(&frame),
                "--gcps",
                text(&list),
                "--f-px",
                "170",
                "--pp-px",
                &pp,
                "--distortion",
                "k1=-0.03",
                "--json",
            ]);
            // Too few of the points may lie in a frame at the end of the line.
            let seen = std::fs::read_to_string(&list).expect("written");
            let count = seen.lines().filter(|line| line.contains(image["name"].as_str().expect("a name"))).count();
            if count < 4 {
                continue;
            }
            assert_eq!(resected.status.code(), Some(0), "{}", String::from_utf8_lossy(&resected.stderr));
            let found: Value = serde_json::from_slice(&resected.stdout).expect("JSON");
            for (key, axis) in [("e", 0), ("n", 1), ("h", 2)] {
                let off = found[key].as_f64().expect("a number") - image["C"][axis].as_f64().expect("a number");
                // The list has millimetres on the ground and thousandths of a pixel.
                assert!(off.abs() < 1.0, "pitch {pitch}: {key} is {off} m off");
            }
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_whatever_the_threads() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let [one, two, other] = ["one", "two", "other"].map(|name| folder.path().join(name));
    let effects = ["--pitch", "-20", "--haze", "20", "--clouds", "0.3", "--glint", "--lines", "2"];
    let with = |at: &Path, extra: &[&str]| rendered(at, &[&effects[..], extra].concat());
    with(&one, &["--threads", "1"]);
    with(&two, &["--threads", "2"]);
    with(&other, &["--seed", "2"]);
    let (one, two, other) = (bytes(&one), bytes(&two), bytes(&other));
    assert_eq!(one.len(), 6 + 5);
    assert!(one == two, "threads change the files");
    assert!(one.iter().zip(&other).all(|(a, b)| a.0 == b.0) && one != other);
}

/// A model and an image of the ground of one's own: seen straight down, the picture is the image.
#[test]
fn an_orthophoto_over_a_model_is_what_the_frame_shows() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let model = folder.path().join("dem.tif");
    let mut file = driver.create_with_band_type::<f32, _>(&model, 100, 100, 1).expect("writable");
    file.set_geo_transform(&[1_000.0, 20.0, 0.0, 5_000.0, 0.0, -20.0]).expect("writable");
    file.rasterband(1)
        .and_then(|mut band| {
            band.write((0, 0), (100, 100), &mut gdal::raster::Buffer::new((100, 100), vec![50f32; 10_000]))
        })
        .expect("writable");
    file.close().expect("closed");
    // Dark west of easting 2000, bright east of it.
    let image = folder.path().join("ortho.tif");
    let mut file = driver.create_with_band_type::<u8, _>(&image, 400, 400, 1).expect("writable");
    file.set_geo_transform(&[1_000.0, 5.0, 0.0, 5_000.0, 0.0, -5.0]).expect("writable");
    let halves: Vec<u8> = (0..160_000).map(|k| if k % 400 < 200 { 40 } else { 200 }).collect();
    file.rasterband(1)
        .and_then(|mut band| band.write((0, 0), (400, 400), &mut gdal::raster::Buffer::new((400, 400), halves)))
        .expect("writable");
    file.close().expect("closed");
    let out = folder.path().join("flight");
    rendered(
        &out,
        &[
            "--dem",
            text(&model),
            "--image",
            text(&image),
            "--height",
            "600",
            "--heading",
            "0",
            "--jitter",
            "0,0",
            "--grain",
            "0",
            "--vignetting",
            "0",
            "--grey",
            "--overwrite",
        ],
    );
    let frame = gdal::Dataset::open(out.join("frames/L01_0002.tif")).expect("a frame");
    let band = frame.rasterband(1).and_then(|b| b.read_band_as::<u8>()).expect("readable");
    let at = |x: usize, y: usize| i32::from(band.data()[y * 160 + x]);
    // Heading north, the frame's top is north and its middle the middle of the model, at 600/170 m a pixel.
    let light = f64::from(at(150, 60)) / 200.0;
    assert!(light > 0.5);
    for y in [10, 60, 110] {
        assert!((at(70, y) - (40.0 * light).round() as i32).abs() <= 1, "row {y}: {}", at(70, y));
        assert!((at(90, y) - at(150, 60)).abs() <= 1, "row {y}: {}", at(90, y));
    }
    // The edge is at column 80.
    assert!((at(79, 60) - at(70, 60)).abs() <= 60 && (at(81, 60) - at(150, 60)).abs() <= 60);
}

#[test]
fn requests_that_make_no_sense_are_one_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("flight");
    for (extra, words) in [
        (&["--size", "10,10"][..], "--size"),
        (&["--clouds", "2"], "--clouds"),
        (&["--pitch", "10"], "--pitch"),
        (&["--distortion", "q=1"], "--distortion"),
        (&["--distortion", "k1=-40"], "folds"),
        (&["--sigma-image=-1"], "--sigma-image"),
        (&["--base", "90000", "--points", "3,0"], "bring the frames nearer together"),
        (&["--dem", "nothing.tif"], "nothing.tif"),
    ] {
        let mut args: Vec<&str> = vec!["synth-flight", text(&out), "--frames", "3", "--samples", "1"];
        args.extend(extra);
        let output = autoref(&args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{extra:?}: {said}");
        assert!(said.contains(words), "{extra:?}: {said}");
        assert!(!out.join("frames").exists(), "{extra:?} wrote frames");
    }
}
