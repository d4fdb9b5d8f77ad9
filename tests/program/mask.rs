//! `mask` from the command line, on frames that are drawn here: kinds of pixels, bad frames, teaching, mending,
//! resuming.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use gdal::DriverManager;
use gdal::raster::{Buffer, RasterCreationOptions};
use serde_json::Value;

use crate::browser::{Browser, Page};

fn mask(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).arg("mask").args(arguments).output().expect("the program runs")
}

/// The lines that --json prints.
fn lines(output: &Output) -> Vec<Value> {
    let text = String::from_utf8_lossy(&output.stdout);
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Folder(tempfile::tempdir().expect("a temporary folder"))
    }
    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    fn text(&self, name: &str) -> String {
        self.at(name).to_str().expect("UTF-8").to_string()
    }
}

const WIDE: usize = 320;
const TALL: usize = 240;

/// Rough ground on the left, calm water on the right; 0…255.
fn level(x: usize, y: usize) -> f64 {
    let mix = (x as u64 * 73_856_093) ^ (y as u64 * 19_349_663);
    let noise = (mix.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as f64 / f64::from(1 << 24);
    if x < WIDE / 2 { 40.0 + 180.0 * noise } else { 90.0 + 2.0 * noise }
}

fn write<T: gdal::raster::GdalType + Copy>(path: &Path, bands: usize, options: &[&str], cast: impl Fn(f64) -> T) {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let options = RasterCreationOptions::from_iter(options.iter().copied());
    let dataset =
        driver.create_with_band_type_with_options::<T, _>(path, WIDE, TALL, bands, &options).expect("writable");
    for band in 1..=bands {
        let values = (0..WIDE * TALL).map(|i| cast(level(i % WIDE, i / WIDE))).collect();
        let mut buffer = Buffer::new((WIDE, TALL), values);
        dataset.rasterband(band).and_then(|mut b| b.write((0, 0), (WIDE, TALL), &mut buffer)).expect("writable");
    }
}

fn frame(folder: &Folder, name: &str) -> String {
    write::<u8>(&folder.at(name), 1, &[], |v| v as u8);
    folder.text(name)
}

fn read(path: &Path) -> Vec<u8> {
    let dataset = gdal::Dataset::open(path).expect("readable");
    assert_eq!(dataset.raster_size(), (WIDE, TALL), "the frame's size");
    dataset.rasterband(1).and_then(|band| band.read_band_as::<u8>()).expect("values").data().to_vec()
}

const TAUGHT: [&str; 4] = ["--sample", "ground=20,20,60,80@a.tif", "--sample", "water=200,20,60,80@a.tif"];

/// The method that learns in a moment, for what is the same by all; discs that fit a small frame.
const QUICK: [&str; 8] = ["--method", "thesis-2017", "--reduce", "2", "--closings", "3,6", "--disc", "5"];

#[test]
fn each_kind_of_pixel_has_its_mask_and_a_bad_frame_stops_none() {
    let folder = Folder::new();
    let a = frame(&folder, "a.tif");
    write::<u8>(&folder.at("colour.tif"), 3, &["PHOTOMETRIC=RGB"], |v| v as u8);
    write::<u16>(&folder.at("deep.tif"), 1, &[], |v| (v * 250.0) as u16);
    write::<u8>(&folder.at("bits.tif"), 1, &["NBITS=1"], |v| u8::from(v > 120.0));
    write::<u8>(&folder.at("level.tif"), 1, &[], |_| 7);
    std::fs::write(folder.at("empty.tif"), b"").expect("writable");
    std::fs::write(folder.at("words.png"), b"no picture at all").expect("writable");
    let whole = std::fs::read(&a).expect("readable");
    std::fs::write(folder.at("cut.tif"), &whole[..whole.len() / 2]).expect("writable");
    let out = folder.text("masks");
    let frames = ["empty.tif", "a.tif", "words.png", "colour.tif", "cut.tif", "deep.tif", "bits.tif", "level.tif"];
    let paths: Vec<String> = frames.iter().map(|name| folder.text(name)).collect();
    let mut arguments: Vec<&str> = paths.iter().map(String::as_str).collect();
    arguments.extend(["-o", &out, "--json", "--quiet"]);
    arguments.extend(TAUGHT);
    let output = mask(&arguments);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    let said = lines(&output);
    assert_eq!(said.len(), frames.len());
    for (line, name) in said.iter().zip(frames) {
        let bad = ["empty.tif", "words.png", "cut.tif"].contains(&name);
        assert_eq!(line["status"], if bad { "error" } else { "done" }, "{name}: {line}");
        let written = folder.at(&format!("masks/{}_Masq.tif", name.rsplit_once('.').expect("a dot").0));
        assert_eq!(written.exists(), !bad, "{name}");
        if bad {
            assert!(line["error"].as_str().is_some_and(|text| text.contains(name)), "{line}");
            continue;
        }
        for key in ["keep_share", "classes", "unsure_share", "warnings", "mask"] {
            assert!(!line[key].is_null(), "{name}: {key}");
        }
        assert!(read(&written).iter().all(|value| *value <= 1), "{name}");
    }
    for name in ["a", "colour", "deep"] {
        let values = read(&folder.at(&format!("masks/{name}_Masq.tif")));
        let share = |x0: usize| {
            let all = (0..TALL).flat_map(|y| (x0..x0 + 120).map(move |x| y * WIDE + x));
            all.map(|i| f64::from(values[i])).sum::<f64>() / (120 * TALL) as f64
        };
        assert!(share(0) > 0.97 && share(200) < 0.03, "{name}: {} {}", share(0), share(200));
    }
    assert!(said[7]["keep_share"].as_f64().is_some_and(|share| share < 0.01), "nothing to match on one level");
    assert!(folder.at("masks/masks.html").is_file() && folder.at("masks/a_Masq.xml").is_file());
}

#[test]
fn outlines_are_the_mask_and_mend_another_run() {
    let folder = Folder::new();
    let a = frame(&folder, "a.tif");
    let (first, second) = (folder.text("first"), folder.text("second"));
    let taught = [&[a.as_str(), "-o", &first, "--quiet"], &TAUGHT[..], &QUICK].concat();
    assert!(mask(&taught).status.success());
    assert!([0, 1].iter().all(|value| read(&folder.at("first/a_Masq.tif")).contains(value)), "there is an outline");
    let outlines = folder.text("first/a_Masq.geojson");
    // Everything is masked by a global polygon, then mended by the outlines: the first mask comes back.
    let all = folder.text("all.geojson");
    let polygon = format!(
        r#"{{"type":"FeatureCollection","features":[{{"type":"Feature","properties":{{"class":"mask"}},
        "geometry":{{"type":"Polygon","coordinates":[[[0,0],[{WIDE},0],[{WIDE},{TALL}],[0,{TALL}],[0,0]]]}}}}]}}"#
    );
    std::fs::write(&all, polygon).expect("writable");
    let by_all = [a.as_str(), "-o", &second, "--quiet", "--global", &all, "--mend", &outlines];
    let mended = [&by_all, &TAUGHT[..], &QUICK].concat();
    let output = mask(&mended);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(read(&folder.at("first/a_Masq.tif")), read(&folder.at("second/a_Masq.tif")));
    // What lies beside the frame does nothing, and that is said.
    let beside =
        std::fs::read_to_string(&all).expect("there").replace("[0,", "[9000,").replace(&format!("[{WIDE},"), "[9900,");
    std::fs::write(&all, beside).expect("writable");
    let third = folder.text("third");
    let output = mask(&[&[a.as_str(), "-o", &third, "--json", "--global", &all], &TAUGHT[..], &QUICK].concat());
    let said = &lines(&output)[0]["warnings"];
    assert!(said.to_string().contains("--global: feature 1 lies outside the frame"), "{said}");
}

#[test]
fn frames_that_are_done_are_left_alone() {
    let folder = Folder::new();
    let paths = [frame(&folder, "a.tif"), frame(&folder, "b.tif")];
    let out = folder.text("masks");
    let arguments = [&[paths[0].as_str(), &paths[1], "-o", &out, "--json", "--quiet"], &TAUGHT[..], &QUICK].concat();
    assert!(mask(&arguments).status.success());
    assert_eq!(mask(&arguments).status.code(), Some(2), "masks are not replaced without being asked");
    std::fs::remove_file(folder.at("masks/b_Masq.tif")).expect("there");
    let again = mask(&[&arguments[..], &["--resume"]].concat());
    let said = lines(&again);
    assert_eq!((&said[0]["status"], &said[1]["status"]), (&"unchanged".into(), &"done".into()));
    // One byte of a mask is enough.
    let mut bytes = std::fs::read(folder.at("masks/a_Masq.tif")).expect("there");
    *bytes.last_mut().expect("not empty") ^= 1;
    std::fs::write(folder.at("masks/a_Masq.tif"), bytes).expect("writable");
    let again = lines(&mask(&[&arguments[..], &["--resume"]].concat()));
    assert_eq!((&again[0]["status"], &again[1]["status"]), (&"done".into(), &"unchanged".into()));
    // Another option makes another mask.
    let other = mask(&[&arguments[..], &["--resume", "--least-area", "0.01"]].concat());
    assert!(lines(&other).iter().all(|line| line["status"] == "done"));
}

#[test]
fn samples_that_teach_nothing_are_named() {
    let folder = Folder::new();
    let a = frame(&folder, "a.tif");
    let out = folder.text("masks");
    for (arguments, word) in [
        (&["--sample", "ground=300,20,100,100@a.tif"][..], "inside the frame"),
        (&["--sample", "ground=20,20,50,50", "--sample", "water=60,60,50,50"], "60, 60 to 70, 70; draw them apart"),
        (&["--sample", "ground=20,20,0,100@a.tif"], "sample"),
        (&["--sample", "ground=20,20,50,50@z.tif"], "z.tif"),
        (&["--sample", "unicorn=20,20,50,50@a.tif"], "unicorn"),
        (&["--method", "thesis-2017", "--sample", "ground=20,20,50,50@a.tif"], "class"),
        (&["--teach", "a.tif=nowhere.tif"], "tif"),
        (&["--samples", "nowhere.toml"], "nowhere.toml"),
        (&["--memory", "1M"], "112M"),
    ] {
        let in_json = mask(&[&[a.as_str(), "-o", &out, "--json"], arguments].concat());
        let said = lines(&in_json);
        assert!(said.len() == 1 && said[0]["error"]["message"].is_string(), "{arguments:?}: {said:?}");
        let output = mask(&[&[a.as_str(), "-o", &out, "--quiet"], arguments].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {text}");
        assert!(text.contains(word) && !text.contains("panicked"), "{arguments:?}: {text}");
        assert!(!folder.at("masks/a_Masq.tif").exists());
    }
}

#[test]
fn a_camera_masks_its_marks_text_and_border() {
    let folder = Folder::new();
    let driver = DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    // The box of the marks, 174.54 × 174.80 mm, 2 px a millimetre.
    let (w, h) = (349, 350);
    let resampled = folder.text("S36.tif");
    let set = driver.create_with_band_type::<u8, _>(&resampled, w, h, 1).expect("writable");
    let values = (0..w * h).map(|i| 30 + ((i * 7919) % 211) as u8).collect();
    set.rasterband(1).and_then(|mut b| b.write((0, 0), (w, h), &mut Buffer::new((w, h), values))).expect("writable");
    set.close().expect("closed");
    let out = folder.text("masks");
    let a = frame(&folder, "a.tif");
    let camera =
        ["-o", &out, "--camera", "svalbard-zeiss-1936", "--sample", "ground=120,100,90,90@S36.tif", "--explain"];
    let output = mask(&[&[resampled.as_str(), &a][..], &camera, &["--overwrite", "--json"]].concat());
    // The other frame has not the shape of the camera's.
    let said = lines(&output);
    assert_eq!(
        (output.status.code(), &said[0]["status"], &said[1]["status"]),
        (Some(2), &"done".into(), &"error".into())
    );
    assert!(said[1]["error"].as_str().is_some_and(|text| text.contains("a.tif") && text.contains("--fiducials")));
    let read = || {
        let dataset = gdal::Dataset::open(folder.at("masks/S36_Masq.tif")).expect("readable");
        dataset.rasterband(1).and_then(|band| band.read_band_as::<u8>()).expect("values").data().to_vec()
    };
    let at = |mask: &[u8], x: usize, y: usize| mask[y * w + x];
    let values = read();
    // Text left and right, the mark in the middle of the left edge, ground.
    let places = [(20, 10), (330, 10), (2, 174), (175, 175), (175, 40)];
    assert_eq!(places.map(|(x, y)| at(&values, x, y)), [0, 0, 0, 1, 1]);
    assert!(folder.at("masks/S36_Scatter.svg").is_file());
    let page = std::fs::read_to_string(folder.at("masks/masks.html")).expect("a page");
    assert!(page.contains("S36_Scatter.svg"));
    if let Some(mut browser) = Browser::start() {
        browser.open(Path::new(&folder.at("masks/masks.html")));
        // A press would drag what an earlier double-click selected, and cut a stroke of the brush off.
        let own = browser.eval(
            "['mousedown', 'dragstart'].map(kind => document.querySelector('figure svg').dispatchEvent( \
             new MouseEvent(kind, { bubbles: true, cancelable: true })))",
        );
        assert_eq!(own, serde_json::json!([false, false]));
    }
    let boxes =
        [&[resampled.as_str()], &camera[..], &["--overwrite", "--quiet", "--mask-box", "80,60,100,80"]].concat();
    assert!(mask(&boxes).status.success());
    let values = read();
    assert_eq!([(20, 10), (175, 135)].map(|(x, y)| at(&values, x, y)), [1, 0]);
}

#[test]
fn light_that_falls_off_is_evened_before_the_threshold() {
    let folder = Folder::new();
    let a = frame(&folder, "a.tif");
    let ways: [(_, _, &[&str]); 3] =
        [("none", "off", &QUICK), ("frame", "both", &QUICK), ("thesis-2017", "rows", &["--method", "auto"])];
    for (lighting, banding, method) in ways {
        let out = folder.text(lighting);
        let options = ["-o", &out, "--lighting", lighting, "--banding", banding, "--quiet"];
        let output = mask(&[&[a.as_str()], &options[..], &TAUGHT[..], method].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let values = read(&folder.at(&format!("{lighting}/a_Masq.tif")));
        assert_eq!([values[120 * WIDE + 60], values[120 * WIDE + 260]], [1, 0], "{lighting}");
    }
}
