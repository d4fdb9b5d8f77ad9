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
    drawn(folder, &[&SMALL, extra].concat())
}

fn drawn(folder: &Path, how: &[&str]) -> Value {
    let args = [&["synth-flight", text(folder)], how].concat();
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

/// Without errors in list and observations, space resection finds every camera where the truth has it, upright and
/// oblique.
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
    let small = ["--size", "112,84", "--f-px", "119", "--samples", "1", "--frames", "2", "--points", "8,4"];
    let with = |at: &Path, extra: &[&str]| drawn(at, &[&effects[..], &small, extra].concat());
    with(&one, &["--threads", "1"]);
    with(&two, &["--threads", "2"]);
    with(&other, &["--seed", "2"]);
    let (one, two, other) = (bytes(&one), bytes(&two), bytes(&other));
    assert_eq!(one.len(), 4 + 5);
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

/// A film camera with marks that a coarse scan shows.
const COARSE_FILM: &str = r#"
name = "coarse-cross"
film_size_mm = [70.0, 70.0]
image_size_mm = [64.0, 64.0]
focal_length_mm = 70.0
y_axis = "down"
upright = true
marks = [
  { name = "1", x_mm = -26.0, y_mm = -26.0, kind = { shape = "cross", arm_mm = 1.5, line_mm = 0.3, gap_mm = 0.0, lines_deg = 0.0 } },
  { name = "2", x_mm = 26.0, y_mm = -26.0, kind = { shape = "cross", arm_mm = 1.5, line_mm = 0.3, gap_mm = 0.0, lines_deg = 0.0 } },
  { name = "3", x_mm = 26.0, y_mm = 26.0, kind = { shape = "cross", arm_mm = 1.5, line_mm = 0.3, gap_mm = 0.0, lines_deg = 0.0 } },
  { name = "4", x_mm = -26.0, y_mm = 26.0, kind = { shape = "cross", arm_mm = 1.5, line_mm = 0.3, gap_mm = 0.0, lines_deg = 0.0 } },
]
"#;

fn grey(path: &Path) -> (usize, Vec<f64>) {
    let set = gdal::Dataset::open(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (w, h) = set.raster_size();
    let band = set.rasterband(1).expect("a band");
    (w, band.read_as::<f64>((0, 0), (w, h), (w, h), None).expect("readable").data().to_vec())
}

/// Of the middle of a frame with the same frame, moved.
fn correlation((w, a): &(usize, Vec<f64>), (v, b): &(usize, Vec<f64>), moved: (usize, usize)) -> f64 {
    let (mut n, mut sums) = (0.0, [0.0; 5]);
    for (x, y) in (100..420).flat_map(|y| (100..420).map(move |x| (x, y))) {
        let (p, q) = (a[y * w + x], b[(y + moved.1) * v + x + moved.0]);
        n += 1.0;
        [p, q, p * p, q * q, p * q].iter().zip(&mut sums).for_each(|(v, sum)| *sum += v);
    }
    let [p, q, pp, qq, pq] = sums.map(|s| s / n);
    (pq - p * q) / ((pp - p * p) * (qq - q * q)).sqrt()
}

/// Scans of film with marks: `fiducials` finds them and makes the frames that the list and the project are of; with
/// AUTOREF_LARGE=1 `flight solve` then finds where the cameras stood.
#[test]
fn scans_of_film_become_the_frames_that_were_rendered() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (film, plain, camera) =
        (folder.path().join("film"), folder.path().join("plain"), folder.path().join("coarse.toml"));
    std::fs::write(&camera, COARSE_FILM).expect("writable");
    let frames = if crate::common::large() { "5" } else { "2" };
    let common = ["--frames", frames, "--samples", "1", "--points", "8,4", "--grain", "1", "--seed", "3"];
    let run = |args: &[&str]| {
        let output = autoref(args);
        assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let said = run(&[&["synth-flight", text(&film), "--film", text(&camera)][..], &common].concat());
    assert!(said.contains("Next: autoref-stream fiducials"), "{said}");
    run(&[&["synth-flight", text(&plain), "--size", "640,640", "--f-px", "700", "--grey"][..], &common].concat());
    let scans: Vec<String> = (1..=frames.parse::<usize>().expect("a number"))
        .map(|i| film.join(format!("scans/L01_{i:04}.tif")).display().to_string())
        .collect();
    let made = film.join("frames");
    let mut args = vec!["fiducials"];
    args.extend(scans.iter().map(String::as_str));
    args.extend([
        "--camera",
        text(&camera),
        "--pixel-um",
        "100",
        "--resample",
        "--resample-mm",
        "0.1",
        "-o",
        text(&made),
    ]);
    run(&args);
    let (resampled, rendered) = (grey(&made.join("L01_0001.resampled.tif")), grey(&plain.join("frames/L01_0001.tif")));
    assert_eq!((resampled.0, rendered.0), (520, 640));
    let here = correlation(&resampled, &rendered, (60, 60));
    assert!(here > 0.8, "{here}");
    for beside in [(59, 60), (61, 60), (60, 59), (60, 61)] {
        assert!(correlation(&resampled, &rendered, beside) < here, "{beside:?}");
    }
    // The list of the film is that of the plain frames, 60 pixels less.
    let places = |at: &Path| -> Vec<[f64; 2]> {
        let list = std::fs::read_to_string(at.join("gcps.txt")).expect("written");
        let number = |word: &str| word.parse::<f64>().expect("a number");
        let row = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
        list.lines().skip(1).map(row).map(|row| [number(&row[3]), number(&row[4])]).collect()
    };
    let (film_places, plain_places) = (places(&film), places(&plain));
    assert!(film_places.len() == plain_places.len() && !film_places.is_empty());
    for (film, plain) in film_places.iter().zip(&plain_places) {
        assert!((0..2).all(|k| (plain[k] - film[k] - 60.0).abs() < 0.002), "{film:?} {plain:?}");
    }
    let project = std::fs::read_to_string(film.join("FLIGHT.toml")).expect("written");
    assert!(project.contains("pp_px = [260.0, 260.0]") && project.contains("f_px = 700.0"), "{project}");
    if !crate::common::large() {
        return;
    }
    let solved = run(&["flight", "solve", text(&film.join("FLIGHT.toml")), "-o", text(&film.join("out")), "--json"]);
    let solved: Value = serde_json::from_str(&solved).expect("JSON");
    assert_eq!(solved["frames_registered"], 5, "{solved}");
}
