//! Rolls through the program: time and memory over many frames, scans of every kind and quality, resuming, exit codes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use assert_cmd::assert::Assert;

fn large() -> bool {
    std::env::var_os("AUTOREF_LARGE").is_some()
}

fn program() -> assert_cmd::Command {
    assert_cmd::Command::cargo_bin("autoref-stream").expect("built")
}

fn draw(folder: &Path, camera: &str, more: &[&str]) {
    program().arg("synth-film").arg(folder).args(["--camera", camera]).args(more).assert().success();
}

fn examine(scans: &[PathBuf], out: &Path, camera: &str, more: &[&str]) -> Assert {
    program().arg("fiducials").args(scans).args(["--camera", camera, "--quiet", "-o"]).arg(out).args(more).assert()
}

fn said(run: &Assert) -> String {
    String::from_utf8(run.get_output().stdout.clone()).expect("text")
}

fn peak_mib(said: &str) -> f64 {
    let (before, _) = said.split_once(" MiB at most").expect("says its memory");
    before.rsplit(' ').next().and_then(|v| v.parse().ok()).expect("a number")
}

/// Seconds of the processor that a run took: the shell counts its children's.
fn examine_timed(roll: &Path, out: &Path, camera: &str) -> (Assert, f64) {
    let run = assert_cmd::Command::new("sh")
        .args(["-c", r#""$0" "$@"; code=$?; times >&2; exit $code"#])
        .arg(assert_cmd::cargo::cargo_bin("autoref-stream"))
        .arg("fiducials")
        .arg(roll)
        .args(["--camera", camera, "--quiet", "--threads", "1", "-o"])
        .arg(out)
        .assert();
    let text = String::from_utf8(run.get_output().stderr.clone()).expect("text");
    let of_children = text.lines().last().expect("two lines of times");
    let seconds = |t: &str| {
        let (minutes, seconds) = t.trim_end_matches('s').split_once('m').expect("as 0m0.00s");
        60.0 * minutes.parse::<f64>().expect("a number") + seconds.parse::<f64>().expect("a number")
    };
    (run, of_children.split_whitespace().map(seconds).sum())
}

/// Time and memory of frames as they come from a scanner. The full size only with `AUTOREF_LARGE=1`, the limit of time
/// only in an optimised build.
#[test]
fn memory_does_not_grow_with_the_roll_and_a_frame_takes_a_moment() {
    let folder = tempfile::tempdir().expect("a folder");
    let (pixel_um, counts): (_, &[usize]) = if large() { ("13.77", &[1, 20, 200]) } else { ("45", &[1, 12]) };
    for (layout, tiles) in [("tiles", "512"), ("strips", "0")] {
        let drawn = folder.path().join(layout);
        draw(&drawn, "svalbard-zeiss-1936", &["--pixel-um", pixel_um, "--tiles", tiles]);
        let frame = drawn.join("svalbard-zeiss-1936-1.tif");
        let mut peaks = vec![];
        for &count in counts {
            let roll = folder.path().join(format!("roll-{layout}-{count}"));
            std::fs::create_dir(&roll).expect("new");
            for k in 0..count {
                std::fs::hard_link(&frame, roll.join(format!("f{k:03}.tif"))).expect("the same file system");
            }
            let started = Instant::now();
            let (run, processor_s) = examine_timed(&roll, &folder.path().join("out"), "svalbard-zeiss-1936");
            let text = said(&run.code(0));
            let [clock_s, each_s] = [started.elapsed().as_secs_f64(), processor_s].map(|s| s / count as f64);
            println!(
                "{layout}, {count} frames: {clock_s:.3} s a frame by the clock, {each_s:.3} s of the processor, {:.0} MiB",
                peak_mib(&text)
            );
            let frames = if count == 1 { "frame" } else { "frames" };
            assert!(text.starts_with(&format!("{count} {frames}: {count} OK")), "{text}");
            assert!(peak_mib(&text) <= 128.0, "{text}");
            assert!(cfg!(debug_assertions) || !large() || each_s <= 0.3, "{each_s} s a frame");
            peaks.push(peak_mib(&text));
            std::fs::remove_dir_all(folder.path().join("out")).expect("written");
        }
        std::fs::remove_dir_all(&drawn).expect("written");
        let growth = peaks.last().expect("one run") - peaks[0];
        assert!(growth < 8.0, "{growth} MiB more for {counts:?} frames");
    }
}

/// A resampled frame costs the same memory however its scan is laid out, also where it can only be read from the top
/// down.
#[test]
fn resampling_holds_no_frame_in_memory() {
    let folder = tempfile::tempdir().expect("a folder");
    // Marks that a coarse scan shows.
    let camera = if large() { "svalbard-zeiss-1936" } else { "wild-15-4" };
    let (pixel_um, mm) = if large() { ("13.77", "0.0135") } else { ("110", "0.11") };
    let drawn = folder.path().join("drawn");
    draw(&drawn, camera, &["--pixel-um", pixel_um, "--tiles", "512"]);
    let tiled = drawn.join(format!("{camera}-1.tif"));
    for (name, format) in
        [("tiles.tif", None), ("strips.tif", Some("GTiff")), ("a.png", Some("PNG")), ("a.jpg", Some("JPEG"))]
    {
        let scan = drawn.join(name);
        match format {
            Some(format) => copy_as(&tiled, &scan, format, &[]),
            None => drop(std::fs::copy(&tiled, &scan).expect("drawn")),
        }
        let out = folder.path().join("out");
        let text = said(
            &examine(std::slice::from_ref(&scan), &out, camera, &["--threads", "1", "--resample", "--resample-mm", mm])
                .code(0),
        );
        println!("{name}: {:.0} MiB with --resample", peak_mib(&text));
        assert!(peak_mib(&text) <= 128.0, "{name}: {text}");
        std::fs::remove_dir_all(&out).expect("written");
        std::fs::remove_file(&scan).expect("copied");
    }
}

fn frame(out: &Path, name: &str) -> serde_json::Value {
    let text = std::fs::read_to_string(out.join(format!("{name}.fiducials.json"))).expect("written");
    serde_json::from_str(&text).expect("a frame's result")
}

fn reasons(out: &Path, name: &str) -> String {
    frame(out, name)["status"]["reasons"].to_string()
}

/// The largest distance of a frame's marks from the truth, pixels.
fn worst_px(out: &Path, scans: &Path, name: &str) -> f64 {
    let truth = std::fs::read_to_string(scans.join(format!("{name}.truth.json"))).expect("written");
    let truth: serde_json::Value = serde_json::from_str(&truth).expect("the truth");
    let found = frame(out, name);
    let at = |m: &serde_json::Value, k: &str| m[k].as_f64();
    let off = |t: &serde_json::Value| {
        let mark = found["marks"].as_array().expect("a list").iter().find(|m| m["mark"] == t["mark"]);
        let centre = &mark.expect("reported")["centre"];
        let (Some(x), Some(y)) = (at(centre, "x"), at(centre, "y")) else { return f64::INFINITY };
        (x - at(t, "x").expect("a number")).hypot(y - at(t, "y").expect("a number"))
    };
    truth["marks"].as_array().expect("a list").iter().map(off).fold(0.0, f64::max)
}

/// One frame of another scanner, one mirrored and one turned among four: each is doubtful and says why, the four stay
/// good, and by itself every one of them is good.
#[test]
fn a_frame_unlike_its_roll_is_doubtful_and_says_why() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, out) = (folder.path().join("scans"), folder.path().join("out"));
    let camera = "svalbard-zeiss-1936";
    draw(&scans, camera, &["--pixel-um", "68", "--frames", "4"]);
    draw(&scans, camera, &["--pixel-um", "69.7", "--seed", "6"]);
    draw(&scans, camera, &["--pixel-um", "68", "--seed", "7", "--mirrored"]);
    draw(&scans, camera, &["--pixel-um", "68", "--seed", "8", "--quarters", "2"]);
    let text = said(&examine(std::slice::from_ref(&scans), &out, camera, &[]).code(1));
    assert!(text.contains("7 frames: 4 OK, 3 doubtful, 0 failed"), "{text}");
    for (k, why) in
        [(6, "µm, those of the roll"), (7, "mirrored, the roll"), (8, "turned by 180°, the roll turned by 0°")]
    {
        let name = format!("{camera}-{k}");
        assert!(reasons(&out, &name).contains(why), "{}", reasons(&out, &name));
        assert_eq!(frame(&out, &name)["alone"]["status"]["verdict"], "ok");
        let marks = frame(&out, &name)["marks"].as_array().expect("a list").clone();
        assert!(marks.iter().all(|m| m["status"] == "doubtful"), "no mark of it is passed as good");
    }
    // Taken up again without the others there is no roll to differ from.
    let few: Vec<PathBuf> = [6, 7].iter().map(|k| scans.join(format!("{camera}-{k}.tif"))).collect();
    let text = said(&examine(&few, &out, camera, &[]).code(0));
    assert!(text.contains("2 frames: 2 OK") && text.contains("(2 from an earlier run)"), "{text}");
}

/// Marks at places that are symmetric to themselves: whoever does not say how the frames lie gets a doubtful frame.
#[test]
fn frames_whose_marks_do_not_tell_how_they_lie_are_doubtful_until_somebody_says() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, out) = (folder.path().join("scans"), folder.path().join("out"));
    draw(&scans, "rmk-cross", &["--pixel-um", "60", "--quarters", "1"]);
    examine(std::slice::from_ref(&scans), &out, "rmk-cross", &[]).code(1);
    let why = reasons(&out, "rmk-cross-1");
    assert!(why.contains("turned by 90°") && why.contains("--turn and --mirrored"), "{why}");
    examine(std::slice::from_ref(&scans), &out, "rmk-cross", &["--turn", "90", "--mirrored", "false"]).code(0);
    assert!(worst_px(&out, &scans, "rmk-cross-1") < 1.0);
}

fn copy_as(from: &Path, to: &Path, driver: &str, options: &[&str]) {
    let source = gdal::Dataset::open(from).expect("readable");
    let mut list = gdal::raster::RasterCreationOptions::new();
    for option in options {
        list.add_string(option).expect("KEY=VALUE");
    }
    let driver = gdal::DriverManager::get_driver_by_name(driver).expect("there");
    source.create_copy(&driver, to, &list).expect("written").close().expect("written");
}

fn grey(path: &Path, side: usize, bands: usize, options: &[&str], value: impl Fn(usize, usize) -> u8) {
    let mut list = gdal::raster::RasterCreationOptions::new();
    for option in options {
        list.add_string(option).expect("KEY=VALUE");
    }
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let dataset = driver.create_with_band_type_with_options::<u8, _>(path, side, side, bands, &list).expect("created");
    let values: Vec<u8> = (0..side * side).map(|k| value(k % side, k / side)).collect();
    for band in 1..=bands {
        let mut buffer = gdal::raster::Buffer::new((side, side), values.clone());
        dataset.rasterband(band).expect("there").write((0, 0), (side, side), &mut buffer).expect("written");
    }
    dataset.close().expect("written");
}

/// Every kind of scan in one roll: what can be read is found in, what cannot is one line, and nothing stops the roll.
#[test]
fn scans_of_every_kind_and_quality_are_one_line_each() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, out) = (folder.path().join("scans"), folder.path().join("out"));
    draw(&scans, "wild-15-4", &["--pixel-um", "100", "--tiles", "256"]);
    let good = scans.join("wild-15-4-1.tif");
    let at = |name: &str| scans.join(name);
    copy_as(&good, &at("jpeg.jpg"), "JPEG", &["QUALITY=90"]);
    copy_as(&good, &at("png.png"), "PNG", &[]);
    copy_as(&good, &at("lzw.tif"), "GTiff", &["COMPRESS=LZW"]);
    {
        let dataset = gdal::Dataset::open(&good).expect("readable");
        let band = dataset.rasterband(1).expect("there");
        let (width, height) = dataset.raster_size();
        let read = band.read_as::<u8>((0, 0), (width, height), (width, height), None).expect("read");
        let values = read.data().to_vec();
        let value = |x: usize, y: usize| values[y.min(height - 1) * width + x.min(width - 1)];
        grey(&at("rgb.tif"), width, 3, &["TILED=YES"], value);
        grey(&at("onebit.tif"), width, 1, &["NBITS=1"], |x, y| u8::from(value(x, y) > 100));
        let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
        let wide = driver.create_with_band_type::<u16, _>(at("words.tif"), width, height, 1).expect("created");
        let mut words =
            gdal::raster::Buffer::new((width, height), values.iter().map(|v| u16::from(*v) * 257).collect());
        wide.rasterband(1).expect("there").write((0, 0), (width, height), &mut words).expect("written");
        wide.close().expect("written");
    }
    grey(&at("black.tif"), 1000, 1, &[], |_, _| 0);
    grey(&at("white.tif"), 1000, 1, &[], |_, _| 255);
    grey(&at("tiny.tif"), 3, 1, &[], |_, _| 90);
    let bytes = std::fs::read(&good).expect("readable");
    std::fs::write(at("truncated.tif"), &bytes[..bytes.len() / 3]).expect("writable");
    std::fs::write(at("empty.tif"), b"").expect("writable");
    std::fs::write(at("text.tif"), b"no picture at all\n").expect("writable");
    draw(folder.path(), "svalbard-zeiss-1936", &["--pixel-um", "70", "--seed", "3"]);
    std::fs::rename(folder.path().join("svalbard-zeiss-1936-3.tif"), at("wrongcamera.tif")).expect("the same folder");

    let text = said(&examine(std::slice::from_ref(&scans), &out, "wild-15-4", &[]).code(1));
    for name in ["wild-15-4-1", "jpeg", "png", "lzw", "rgb", "words"] {
        assert_eq!(frame(&out, name)["status"]["verdict"], "ok", "{name}: {}", reasons(&out, name));
    }
    for name in ["black", "white", "tiny", "truncated", "empty", "text"] {
        assert_eq!(frame(&out, name)["status"]["verdict"], "failed", "{name}: {}", frame(&out, name));
        let lines: Vec<&str> = text.lines().filter(|l| l.starts_with(&format!("{name}: failed: "))).collect();
        assert_eq!(lines.len(), 1, "{name}: {text}");
    }
    assert_ne!(frame(&out, "wrongcamera")["status"]["verdict"], "ok");
    // Grains are gone from a scan of one bit, the marks are not; it is read or refused in a line.
    assert!(out.join("onebit.fiducials.json").exists());
    assert!(text.contains("14 frames: "), "{text}");
}

/// Three of four marks solve with the reservation, two do not pass, none fails.
#[test]
fn cropped_frames_say_what_they_were_solved_with() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, out) = (folder.path().join("scans"), folder.path().join("out"));
    draw(&scans, "svalbard-zeiss-1936", &["--pixel-um", "40"]);
    let whole = gdal::Dataset::open(scans.join("svalbard-zeiss-1936-1.tif")).expect("readable");
    let (width, height) = whole.raster_size();
    let cut = |name: &str, from: (usize, usize), size: (usize, usize)| {
        let read =
            whole.rasterband(1).expect("there").read_as::<u8>((from.0 as isize, from.1 as isize), size, size, None);
        let mut buffer = gdal::raster::Buffer::new(size, read.expect("read").data().to_vec());
        let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
        let path = folder.path().join(name);
        let to = driver.create_with_band_type::<u8, _>(path, size.0, size.1, 1).expect("created");
        to.rasterband(1).expect("there").write((0, 0), size, &mut buffer).expect("written");
        to.close().expect("written");
    };
    cut("three.tif", (200, 0), (width - 200, height));
    cut("two.tif", (200, 200), (width - 200, height - 200));
    cut("none.tif", (300, 300), (width - 600, height - 600));
    let list: Vec<PathBuf> = ["three.tif", "two.tif", "none.tif"].iter().map(|n| folder.path().join(n)).collect();
    let lie = ["--pixel-um", "40", "--turn", "0", "--mirrored", "false"];
    examine(&list, &out, "svalbard-zeiss-1936", &lie).code(1);
    assert_eq!(frame(&out, "three")["status"]["verdict"], "doubtful", "{}", reasons(&out, "three"));
    assert!(reasons(&out, "three").contains("solved with 3 of 4 marks"), "{}", reasons(&out, "three"));
    assert_ne!(frame(&out, "two")["status"]["verdict"], "ok");
    let passed = |name: &str| {
        frame(&out, name)["marks"].as_array().expect("a list").iter().filter(|m| m["status"] == "ok").count()
    };
    assert_eq!((passed("three"), passed("two"), passed("none")), (3, 0, 0));
    assert_eq!(frame(&out, "none")["status"]["verdict"], "failed", "{}", frame(&out, "none"));
}

/// Killed in the middle, the roll goes on where it was: what was done is taken over, nothing is half written.
#[test]
fn a_killed_run_goes_on_where_it_was() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, out) = (folder.path().join("scans"), folder.path().join("out"));
    draw(&scans, "wild-15-4", &["--pixel-um", "60", "--tiles", "256"]);
    let roll = folder.path().join("roll");
    std::fs::create_dir(&roll).expect("new");
    const FRAMES: usize = 20;
    for k in 0..FRAMES {
        std::fs::hard_link(scans.join("wild-15-4-1.tif"), roll.join(format!("f{k:02}.tif"))).expect("one file system");
    }
    let done = || std::fs::read_dir(&out).map_or(0, |list| list.count());
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("autoref-stream"))
        .arg("fiducials")
        .arg(&roll)
        .args(["--camera", "wild-15-4", "--quiet", "--threads", "1", "-o"])
        .arg(&out)
        .stdout(std::process::Stdio::null())
        .spawn()
        .expect("starts");
    let started = Instant::now();
    while done() < 4 && started.elapsed().as_secs() < 120 {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    child.kill().expect("still running");
    child.wait().expect("was started");
    let text = said(&examine(&[roll], &out, "wild-15-4", &[]).code(0));
    assert!(text.contains(&format!("{FRAMES} frames: {FRAMES} OK")), "{text}");
    let (_, taken) = text.split_once(" failed (").expect("says how many were taken over");
    let taken: usize = taken.split(' ').next().and_then(|n| n.parse().ok()).expect("a number");
    assert!((3..FRAMES).contains(&taken), "{text}");
}

/// Templates learned from a roll through the program find the marks of other frames.
#[test]
fn a_template_learned_from_a_roll_finds_the_marks_of_other_frames() {
    let folder = tempfile::tempdir().expect("a folder");
    let (scans, others, out) = (folder.path().join("scans"), folder.path().join("others"), folder.path().join("out"));
    let camera = "svalbard-zeiss-1936";
    draw(&scans, camera, &["--pixel-um", "68", "--frames", "3"]);
    draw(&others, camera, &["--pixel-um", "65", "--frames", "2", "--seed", "20", "--offset-mm", "0.1,-0.1"]);
    // A scan that cannot be read does not stop the learning.
    std::fs::write(scans.join("zz-broken.tif"), b"no picture").expect("writable");
    let learned = folder.path().join("learned");
    // As large as the marks allow that lie 2.2 mm from the film's edge.
    let how = ["--learn", "--window-mm", "7,3.8", "--turn", "0", "--mirrored", "false"];
    let text = said(&examine(&[scans], &learned, camera, &how).code(0));
    let file = learned.join(format!("{camera}-learned.toml"));
    assert!(text.contains("learned from 3 scans") && file.exists(), "{text}");
    let run = examine(
        std::slice::from_ref(&others),
        &out,
        file.to_str().expect("plain"),
        &["--turn", "0", "--mirrored", "false"],
    );
    run.code(0);
    for seed in [20, 21] {
        let worst = worst_px(&out, &others, &format!("{camera}-{seed}"));
        println!("learned template, frame {seed}: largest error {worst:.2} px");
        assert!(worst < 2.0, "{worst} px");
    }
}

/// The marks of a camera clicked two pixels off, each in another direction.
fn clicks_beside(scans: &Path, name: &str) -> Vec<String> {
    let truth = std::fs::read_to_string(scans.join(format!("{name}.truth.json"))).expect("written");
    let truth: serde_json::Value = serde_json::from_str(&truth).expect("the truth");
    let beside = |(k, mark): (usize, &serde_json::Value)| {
        let (sin, cos) = (1.0 + 2.4 * k as f64).sin_cos();
        let at = |axis: &str| mark[axis].as_f64().expect("a number");
        format!("--at={}={:.2},{:.2}", mark["mark"].as_str().expect("a name"), at("x") + 2.0 * cos, at("y") + 2.0 * sin)
    };
    truth["marks"].as_array().expect("a list").iter().enumerate().map(beside).collect()
}

/// What clicks two pixels off teach finds the marks to half a pixel: of notches by their corner, also of three sides
/// only; of rings although the border cuts one of them off.
#[test]
fn clicks_beside_marks_teach_a_camera() {
    for (camera, offset_mm, left_out, marks) in
        [("side-notch", "0,0", 0, 4), ("side-notch", "0,0", 1, 3), ("wild-15-4", "4.2,0", 0, 7)]
    {
        let folder = tempfile::tempdir().expect("a folder");
        let [scans, taught, out] = ["scans", "taught", "out"].map(|name| folder.path().join(name));
        draw(&scans, camera, &["--pixel-um", "90", "--frames", "2", "--offset-mm", offset_mm]);
        let clicks = clicks_beside(&scans, &format!("{camera}-1"));
        let mut how: Vec<&str> = clicks.iter().skip(left_out).map(String::as_str).collect();
        how.extend(["--learn", "--window-mm", "5,5"]);
        examine(std::slice::from_ref(&scans), &taught, camera, &how).code(0);
        let file = taught.join(format!("{camera}-learned.toml"));
        let way = ["--turn", "0", "--mirrored", "false"];
        examine(std::slice::from_ref(&scans), &out, file.to_str().expect("plain"), &way).code(0);
        for name in [1, 2].map(|seed| format!("{camera}-{seed}")) {
            let found = frame(&out, &name);
            assert_eq!(found["inner"]["marks"].as_array().map(Vec::len), Some(marks), "{name}: {}", found["status"]);
            let truth = std::fs::read_to_string(scans.join(format!("{name}.truth.json"))).expect("written");
            let truth: serde_json::Value = serde_json::from_str(&truth).expect("the truth");
            let known = truth["marks"].as_array().expect("a list").iter().skip(left_out);
            for (mark, known) in found["marks"].as_array().expect("a list").iter().zip(known) {
                let number = |of: &serde_json::Value, axis: &str| of[axis].as_f64();
                let Some((x, y)) = number(&mark["centre"], "x").zip(number(&mark["centre"], "y")) else { continue };
                let (kx, ky) = number(known, "x").zip(number(known, "y")).expect("a place");
                assert!((x - kx).hypot(y - ky) < 0.5, "{name}: {mark} at {kx}, {ky}");
            }
        }
    }
}

/// `--json` of what prints lines otherwise.
#[test]
fn cameras_are_listed_as_json() {
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .args(["fiducials", "--list-cameras", "--json"])
        .output()
        .expect("the program starts");
    let document: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one document");
    let cameras = document["cameras"].as_array().expect("cameras");
    let named = |name: &str| cameras.iter().any(|c| c["name"] == name && c["description"].is_string());
    assert!(named("wild-15-4") && named("svalbard-zeiss-1936"), "{document}");
}
