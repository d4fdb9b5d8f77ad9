//! What `fiducials` writes: the files for other programs read back by their formats, the contact sheet in a real
//! browser, and the resampled frames against GDAL and against known truth.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::browser::{Browser, Page};
use autoref_film::drawn::{FilmGround, FilmScene, FilmSpec};
use autoref_film::interior::{Observation, solve};
use autoref_film::resample::banding::Banding;
use autoref_film::resample::kernel::Kernel;
use autoref_film::resample::{self, Light, ResampleOptions, lighting};
use autoref_film::{
    Camera, FrameResult, FrameStatus, InteriorModel, InteriorOrientation, MarkStatus, contact_sheet, load_camera,
};
use autoref_raster::coords::{Handedness, PixelPoint};
use serde_json::Value;

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

/// Runs the program and insists on the exit code.
fn run(args: &[&str], code: i32) -> String {
    let output = autoref(args);
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
    said
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&text(path)).expect("JSON")
}

fn plain(path: &Path) -> &str {
    path.to_str().expect("a plain path")
}

/// Frames of a camera in `scans`, results in `out`.
struct Roll {
    folder: tempfile::TempDir,
    camera: Camera,
}

impl Roll {
    fn new(camera: &str, pixel_um: &str, extra: &[&str]) -> Roll {
        let folder = tempfile::tempdir().expect("a folder");
        let scans = folder.path().join("scans");
        let mut args = vec!["synth-film", plain(&scans), "--camera", camera, "--pixel-um", pixel_um, "--tiles", "256"];
        args.extend(extra);
        run(&args, 0);
        Roll { folder, camera: load_camera(camera).expect("built in") }
    }

    fn scans(&self) -> PathBuf {
        self.folder.path().join("scans")
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join("out").join(name)
    }

    fn fiducials(&self, extra: &[&str], code: i32) -> String {
        let (scans, out) = (self.scans(), self.folder.path().join("out"));
        let mut args = vec!["fiducials", plain(&scans), "--camera", &self.camera.name, "--quiet", "-o", plain(&out)];
        args.extend(self.lie());
        args.extend(extra);
        run(&args, code)
    }

    /// How the frames lie, where neither marks nor camera file tell.
    fn lie(&self) -> &'static [&'static str] {
        if self.camera.name == "rmk-cross" { &["--turn", "0", "--mirrored", "false"] } else { &[] }
    }

    fn frame(&self, name: &str) -> FrameResult {
        serde_json::from_str(&text(&self.out(&format!("{name}.fiducials.json")))).expect("a frame's result")
    }

    fn truth(&self, name: &str) -> Vec<(String, [f64; 2])> {
        let truth = json(&self.scans().join(format!("{name}.truth.json")));
        let mark = |m: &Value| {
            let at = |k: &str| m[k].as_f64().expect("a number");
            (m["mark"].as_str().expect("a name").to_owned(), [at("x"), at("y")])
        };
        truth["marks"].as_array().expect("marks").iter().map(mark).collect()
    }
}

/// Elements of an XML document as (depth, name, text), in order; the parser must be content with all of it.
fn elements(xml: &str) -> Vec<(usize, String, String)> {
    use quick_xml::events::Event;
    assert!(xml.starts_with("<?xml version=\"1.0\""), "{xml}");
    let mut reader = quick_xml::Reader::from_str(xml);
    let (mut seen, mut open): (Vec<(usize, String, String)>, Vec<usize>) = (vec![], vec![]);
    loop {
        match reader.read_event().expect("well-formed") {
            Event::Start(e) => {
                let name = std::str::from_utf8(e.name().into_inner().as_ref()).expect("UTF-8").to_owned();
                seen.push((open.len(), name, String::new()));
                open.push(seen.len() - 1);
            }
            Event::End(_) => {
                open.pop();
            }
            Event::Text(t) => {
                if let Some(&k) = open.last() {
                    seen[k].2 += t.trim();
                }
            }
            Event::Eof => return seen,
            _ => {}
        }
    }
}

/// A `MesureAppuiFlottant1Im` at `depth`: name of the image, and points by name. Order and nesting are checked.
fn measures(all: &[(usize, String, String)], depth: usize) -> (String, Vec<(String, [f64; 2])>) {
    assert_eq!((all[0].0, all[0].1.as_str()), (depth, "MesureAppuiFlottant1Im"));
    assert_eq!((all[1].0, all[1].1.as_str()), (depth + 1, "NameIm"));
    assert_eq!((all.len() - 2) % 3, 0, "{all:?}");
    let points = all[2..].chunks(3).map(|group| {
        let names: Vec<(usize, &str)> = group.iter().map(|e| (e.0 - depth, e.1.as_str())).collect();
        assert_eq!(names, [(1, "OneMesureAF1I"), (2, "NamePt"), (2, "PtIm")]);
        let xy: Vec<f64> = group[2].2.split(' ').map(|v| v.parse().expect("a number")).collect();
        (group[1].2.clone(), [xy[0], xy[1]])
    });
    (all[1].2.clone(), points.collect())
}

/// Least squares affine from `from` to `to` by the normal equations, as MicMac's `ElAffin2D::L2Fit` on points paired by
/// name; gives the function.
fn affine(from: &[[f64; 2]], to: &[[f64; 2]]) -> impl Fn([f64; 2]) -> [f64; 2] + use<> {
    let design = nalgebra::DMatrix::from_fn(from.len(), 3, |i, k| if k < 2 { from[i][k] } else { 1.0 });
    let fit = |axis: usize| {
        let right = nalgebra::DVector::from_fn(to.len(), |i, _| to[i][axis]);
        let normal = design.transpose() * &design;
        normal.lu().solve(&(design.transpose() * right)).expect("three points off a line")
    };
    let (x, y) = (fit(0), fit(1));
    move |p| [x[0] * p[0] + x[1] * p[1] + x[2], y[0] * p[0] + y[1] * p[1] + y[2]]
}

/// The files of one roll, for a camera whose y runs up and one whose y runs down.
#[test]
fn files_for_other_programs_read_back_as_their_formats_say() {
    for (camera, pixel_um, name) in
        [("wild-15-4", "80", "wild-15-4-1"), ("svalbard-zeiss-1936", "50", "svalbard-zeiss-1936-1")]
    {
        let roll = Roll::new(camera, pixel_um, &["--frames", "2"]);
        roll.fiducials(&["--exports"], 0);
        let truth = roll.truth(name);

        // The camera: millimetres from the upper left corner of the marks, y down.
        let (_, film) = measures(&elements(&text(&roll.out("Ori-InterneScan/MeasuresCamera.xml"))), 0);
        let names: Vec<&String> = film.iter().map(|p| &p.0).collect();
        assert!(
            names.iter().zip(&roll.camera.marks).all(|(a, b)| **a == b.name) && names.len() == roll.camera.marks.len()
        );
        for (p, m) in film.iter().zip(&roll.camera.marks) {
            let (first, first_mark) = (&film[0], &roll.camera.marks[0]);
            let up = if camera == "wild-15-4" { -1.0 } else { 1.0 };
            assert!(
                (p.1[0] - first.1[0] - (m.x_mm.expect("there") - first_mark.x_mm.expect("there"))).abs() < 1e-9,
                "x in mm"
            );
            assert!(
                (p.1[1] - first.1[1] - up * (m.y_mm.expect("there") - first_mark.y_mm.expect("there"))).abs() < 1e-9,
                "y down"
            );
        }
        for k in 0..2 {
            assert_eq!(film.iter().map(|p| p.1[k]).fold(f64::MAX, f64::min), 0.0);
        }

        // The image: pixels, within a set, named by the scan with its extension.
        let xml = elements(&text(&roll.out(&format!("Ori-InterneScan/MeasuresIm-{name}.tif.xml"))));
        assert_eq!((xml[0].0, xml[0].1.as_str()), (0, "SetOfMesureAppuisFlottants"));
        let (image, pixels) = measures(&xml[1..], 1);
        assert_eq!(image, format!("{name}.tif"));
        assert_eq!(pixels.len(), truth.len());
        for (mark, at) in &truth {
            let found = pixels.iter().find(|p| p.0 == *mark).expect("every mark");
            assert!((found.1[0] - at[0]).hypot(found.1[1] - at[1]) < 0.6, "{found:?} {at:?}");
        }
        // What ReSampFid makes of both files puts the marks of the truth where the certificate has them.
        let pairs: Vec<([f64; 2], [f64; 2])> =
            pixels.iter().map(|p| (p.1, film.iter().find(|f| f.0 == p.0).expect("paired by name").1)).collect();
        let (px, mm): (Vec<[f64; 2]>, Vec<[f64; 2]>) = pairs.into_iter().unzip();
        let to_mm = affine(&px, &mm);
        for (mark, at) in &truth {
            let (is, should) = (to_mm(*at), film.iter().find(|f| f.0 == *mark).expect("named").1);
            assert!((is[0] - should[0]).hypot(is[1] - should[1]) < 0.05, "{mark}: {is:?} {should:?}");
        }
        assert_eq!(text(&roll.out("id_fiducial.txt")).lines().collect::<Vec<_>>(), names);

        tables_read_back(&roll, name, &pixels);
    }
}

fn tables_read_back(roll: &Roll, name: &str, pixels: &[(String, [f64; 2])]) {
    let frame = roll.frame(name);
    let number = |s: &str| s.parse::<f64>().expect("a number");
    // spymicmac.
    let mut csv = csv::Reader::from_path(roll.out(&format!("{name}.measures.csv"))).expect("written");
    let head: Vec<String> = csv.headers().expect("a head").iter().map(str::to_owned).collect();
    assert_eq!(head, ["gcp", "im_col", "im_row", "residual_x_um", "residual_y_um"]);
    for (row, mark) in csv.records().map(|r| r.expect("a row")).zip(&frame.marks) {
        let c = mark.centre.expect("found");
        let r = mark.residual_um.expect("solved");
        assert_eq!((&row[0], number(&row[1]), number(&row[2])), (mark.mark.as_str(), c.x, c.y));
        assert!((number(&row[3]) - r[0]).abs() < 6e-4 && (number(&row[4]) - r[1]).abs() < 6e-4);
    }
    // hipp: pairs of y and x at its places, the principal point last.
    let mut csv = csv::Reader::from_path(roll.out("fiducials_hipp.csv")).expect("written");
    let head: Vec<String> = csv.headers().expect("a head").iter().map(str::to_owned).collect();
    let middle = ["midside_left", "midside_top", "midside_right", "midside_bottom"];
    let corner = ["corner_top_left", "corner_top_right", "corner_bottom_right", "corner_bottom_left"];
    let (places, marks): (Vec<&str>, Vec<&str>) = if roll.camera.marks.len() == 8 {
        (middle.iter().chain(&corner).copied().collect(), vec!["P5", "P7", "P6", "P8", "P3", "P4", "P1", "P2"])
    } else {
        (middle.to_vec(), vec!["LEFT", "TOP", "RIGHT", "BOTTOM"])
    };
    let wanted: Vec<String> = std::iter::once("fileName".to_string())
        .chain(places.iter().chain(&["principal_point"]).flat_map(|p| [format!("{p}_y"), format!("{p}_x")]))
        .collect();
    assert_eq!(head, wanted);
    let rows: Vec<csv::StringRecord> = csv.records().map(|r| r.expect("a row")).collect();
    assert_eq!(rows.len(), 2);
    let row = rows.iter().find(|r| r[0].ends_with(&format!("{name}.tif"))).expect("a row per frame");
    for (k, mark) in marks.iter().enumerate() {
        let at = pixels.iter().find(|p| p.0 == *mark).expect("named").1;
        assert_eq!((number(&row[2 + 2 * k]), number(&row[1 + 2 * k])), (at[0], at[1]), "{mark}");
    }
    let principal = [number(&row[row.len() - 1]), number(&row[row.len() - 2])];
    assert!(
        (principal[0] / frame.width as f64 - 0.5).abs() < 0.02
            && (principal[1] / frame.height as f64 - 0.5).abs() < 0.02
    );
    // GeoJSON as GDAL reads it.
    let dataset = gdal::Dataset::open(roll.out(&format!("{name}.geojson"))).expect("GDAL reads it");
    let mut layer = gdal::vector::LayerAccess::features(&mut dataset.layer(0).expect("a layer")).count();
    assert_eq!(layer, frame.marks.len());
    let features = json(&roll.out(&format!("{name}.geojson")));
    for (f, m) in features["features"].as_array().expect("features").iter().zip(&frame.marks) {
        let c = m.centre.expect("found");
        assert_eq!(f["geometry"]["coordinates"], serde_json::json!([c.x, -c.y]));
        assert_eq!((&f["properties"]["x_px"], &f["properties"]["mark"]), (&c.x.into(), &m.mark.as_str().into()));
        layer -= 1;
    }
    assert_eq!(layer, 0);
    // JSON: pixel → millimetres by the matrix gives the residuals.
    let raw = json(&roll.out(&format!("{name}.fiducials.json")));
    let h: Vec<f64> =
        raw["inner"]["pixel_to_mm"].as_array().expect("a matrix").iter().map(|v| v.as_f64().expect("there")).collect();
    for (m, calibrated) in raw["marks"].as_array().expect("marks").iter().zip(&roll.camera.marks) {
        let (x, y) = (m["centre"]["x"].as_f64().expect("there"), m["centre"]["y"].as_f64().expect("there"));
        let dx = 1e3 * (h[0] * x + h[1] * y + h[2] - calibrated.x_mm.expect("there"));
        let dy = 1e3 * (h[3] * x + h[4] * y + h[5] - calibrated.y_mm.expect("there"));
        assert!((dx - m["residual_um"][0].as_f64().expect("there")).abs() < 1e-6);
        assert!((dy - m["residual_um"][1].as_f64().expect("there")).abs() < 1e-6);
    }
}

#[test]
fn pixels_can_count_from_centres_and_a_frame_without_orientation_has_no_measures() {
    let roll = Roll::new("rmk-cross", "100", &[]);
    roll.fiducials(&["--exports"], 0);
    let xml = roll.out("Ori-InterneScan/MeasuresIm-rmk-cross-1.tif.xml");
    let corner = measures(&elements(&text(&xml))[1..], 1).1;
    roll.fiducials(&["--exports", "--pixels-from", "centre"], 0);
    let centre = measures(&elements(&text(&xml))[1..], 1).1;
    for (a, b) in corner.iter().zip(&centre) {
        assert!((a.1[0] - b.1[0] - 0.5).abs() < 1e-9 && (a.1[1] - b.1[1] - 0.5).abs() < 1e-9);
    }
    // The scan is replaced by an empty one: the measures of the earlier run must not stay.
    let scan = roll.scans().join("rmk-cross-1.tif");
    std::fs::write(&scan, b"II*\0 no TIFF").expect("writable");
    roll.fiducials(&["--exports"], 1);
    assert!(!xml.exists());
    assert_eq!(text(&roll.out("rmk-cross-1.measures.csv")).lines().count(), 1);
}

/// What the page asked for besides itself, its pictures, and what it carries; and what it said on the console.
fn complaints(browser: &mut Browser, page: &Path) -> Vec<String> {
    let own = format!("file://{}/", page.with_extension("").display());
    browser.complaints().into_iter().filter(|c| !(c.starts_with(&own) && c.ends_with(".jpg"))).collect()
}

/// Presses keys with the focus on a mark of a frame.
fn on(browser: &mut Browser, frame: &str, mark: &str, keys: &[(&str, bool)]) {
    let aim = format!(
        "(() => {{ const f = Sheet.frames.find(f => f.name === {}); f.marks.find(m => m.mark === {}).e.focus(); }})()",
        Value::from(frame),
        Value::from(mark)
    );
    browser.eval(&aim);
    for (key, shift) in keys {
        browser.key(key, *shift);
    }
}

#[test]
fn a_review_of_the_contact_sheet_replays_to_the_same_numbers() {
    let models = ["affine", "projective", "similarity"];
    for model in if crate::common::large() { &models[..] } else { &models[..1] } {
        // Dark and cropped frames among them; the names order them.
        let roll = Roll::new("wild-15-4", "80", &["--frames", "3"]);
        std::fs::write(roll.scans().join("broken<b>#1.tif"), b"II*\0 no TIFF").expect("writable");
        roll.fiducials(&["--exports", "--model", model], 1);
        let page = roll.out("contact_sheet.html");
        let Some(mut browser) = Browser::start() else { return };
        browser.open(&page);
        assert_eq!(complaints(&mut browser, &page), Vec::<String>::new());
        let first = browser.eval("document.querySelector('section h3').textContent");
        assert!(first.as_str().expect("text").starts_with("broken<b>#1"), "worst first: {first}");
        let rmse = browser.eval("Sheet.frames.filter(f => f.status === 'ok').map(f => f.worst)");
        let rmse: Vec<f64> = rmse.as_array().expect("numbers").iter().map(|v| v.as_f64().expect("there")).collect();
        assert!(rmse.len() == 3 && rmse.windows(2).all(|w| w[0] >= w[1]), "{rmse:?}");

        // The keyboard alone reaches every mark: Tab into the sheet, then arrows.
        for _ in 0..20 {
            browser.key("Tab", false);
            if browser.eval("document.activeElement.classList.contains('m')") == Value::Bool(true) {
                break;
            }
        }
        browser.key("ArrowDown", false);
        browser.key("ArrowRight", false);
        let label = browser.eval("document.activeElement.getAttribute('aria-label')");
        assert!(label.as_str().expect("a label").starts_with("wild-15-4-"), "{label}");

        let (a, b) = ("wild-15-4-1", "wild-15-4-2");
        on(&mut browser, a, "P1", &[("ArrowLeft", true), ("ArrowLeft", true), ("ArrowDown", true)]);
        on(&mut browser, a, "P2", &[("r", false)]);
        on(&mut browser, a, "P3", &[("v", false), ("u", false)]);
        on(&mut browser, a, "P4", &[("r", false), ("a", false)]);
        on(&mut browser, b, "P5", &[("v", false)]);
        browser.key("s", false);
        let patch = browser.download("fiducials.patch.json");
        let saved = json(&patch);
        assert_eq!(saved["edits"].as_array().map(Vec::len), Some(5), "nudges in a row are one step: {saved}");
        let shown = browser.eval(
            "Object.fromEntries(Sheet.frames.map(f => [f.name, { ...Sheet.evaluate(f), \
             places: Object.fromEntries(f.marks.map(m => [m.mark, Sheet.held(f, m)])) }]))",
        );
        assert_eq!(complaints(&mut browser, &page), Vec::<String>::new());

        let said = roll.fiducials(&["--patch", plain(&patch), "--model", model], 1);
        assert!(said.contains("4 frames"), "{said}");
        assert!(!roll.out("wild-15-4-3.reviewed.json").exists(), "nobody touched this frame");
        for name in [a, b] {
            let reviewed: FrameResult =
                serde_json::from_str(&text(&roll.out(&format!("{name}.reviewed.json")))).expect("a result");
            let inner = reviewed.interior.as_ref().expect("solved");
            let shown = &shown[name];
            let close = |a: f64, b: &Value, what: &str| {
                let b = b.as_f64().unwrap_or_else(|| panic!("{what}: {b}"));
                assert!((a - b).abs() <= 1e-9, "{model} {name} {what}: {a} against {b}");
            };
            assert_eq!(shown["n"].as_u64(), Some(inner.marks.len() as u64));
            close(inner.rmse_um, &shown["rmse_um"], "RMSE");
            for m in reviewed.marks.iter().filter(|m| m.centre.is_some()) {
                let r = m.residual_um.expect("solved");
                close(r[0], &shown["residual_um"][&m.mark][0], "residual x");
                close(r[1], &shown["residual_um"][&m.mark][1], "residual y");
                let c = m.centre.expect("placed");
                close(c.x, &shown["places"][&m.mark]["x"], "x");
                close(c.y, &shown["places"][&m.mark]["y"], "y");
            }
        }
        let before = roll.frame(a);
        let after: FrameResult = serde_json::from_str(&text(&roll.out("wild-15-4-1.reviewed.json"))).expect("a result");
        let (p, q) = (before.marks[0].centre.expect("found"), after.marks[0].centre.expect("placed"));
        assert!((q.x - p.x + 0.2).abs() < 1e-9 && (q.y - p.y - 0.1).abs() < 1e-9, "{p:?} {q:?}");
        assert_eq!(after.marks[1].status, MarkStatus::Doubtful);
        assert_eq!(after.marks[2].status, MarkStatus::Ok, "undone");
    }
}

/// Each mark is clicked twice, to enlarge and to place, two pixels off; what the page saves teaches the camera.
#[test]
fn marks_of_a_new_camera_are_clicked_in_a_page_and_learned() {
    let roll = Roll::new("rmk-cross", "60", &["--frames", "1"]);
    let (first, page) = ("rmk-cross-1", roll.out("click.html"));
    let said = roll.fiducials(&["--learn", "--page"], 0);
    assert!(said.contains("click.html") && said.contains("--at"), "{said}");
    assert!(!text(&page).contains("http"));
    let marks = roll.truth(first);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&page);
    let said: Vec<String> = browser.complaints().into_iter().filter(|c| !c.ends_with("click_frames/0.png")).collect();
    assert_eq!(said, Vec::<String>::new());
    let started = std::time::Instant::now();
    while browser.eval("image(0).complete && image(0).naturalWidth > 0") != Value::Bool(true) {
        assert!(started.elapsed().as_secs() < 30, "the scan is not shown");
    }
    let click = "(x, y) => { const r = detail.getBoundingClientRect(), k = detail.clientWidth / detail.width; \
                 const at = i => ([x, y][i] - focus[i]) * zoom + 256; detail.dispatchEvent(new MouseEvent('click', \
                 { clientX: r.left + detail.clientLeft + at(0) * k, clientY: r.top + detail.clientTop + at(1) * k })); }";
    for (k, (mark, [x, y])) in marks.iter().enumerate() {
        assert_eq!(browser.eval("data.points[now.p].name"), Value::from(mark.as_str()), "in the camera's order");
        let off = [1.4, -1.4][k % 2];
        for _ in 0..2 {
            browser.eval(&format!("({click})({}, {})", x + off, y - 1.4));
        }
    }
    assert_eq!(browser.eval("by('count').textContent"), Value::from("4 of 4 marks, not saved"));
    let saved = browser.eval("text()");
    browser.key("s", false);
    let then = browser.eval("by('then').textContent");
    assert!(then.as_str().is_some_and(|t| t.contains("--camera rmk-cross --learn --at clicks.csv")), "{then}");
    let clicks = roll.folder.path().join("clicks.csv");
    std::fs::write(&clicks, saved.as_str().expect("a table")).expect("writable");
    let said = roll.fiducials(&["--learn", "--at", plain(&clicks), "--window-mm", "5,5"], 0);
    assert!(said.contains("learned from 1 scans"), "{said}");
    let learned = std::fs::read_dir(roll.folder.path().join("out")).expect("there");
    let learned = learned.filter_map(|e| Some(e.ok()?.path())).find(|p| p.extension().is_some_and(|e| e == "toml"));
    let (learned, scan) = (learned.expect("a camera"), roll.scans().join(format!("{first}.tif")));
    let out = roll.folder.path().join("found");
    let way = ["--turn", "0", "--mirrored", "false", "--quiet"];
    run(&[&["fiducials", plain(&scan), "--camera", plain(&learned), "-o", plain(&out)][..], &way].concat(), 0);
    let found = json(&out.join(format!("{first}.fiducials.json")));
    for (mark, (name, [x, y])) in found["marks"].as_array().expect("a list").iter().zip(marks) {
        let at = |axis: &str| mark["centre"][axis].as_f64().expect("found");
        assert!((at("x") - x).hypot(at("y") - y) < 1.0, "{mark} {name}");
    }
}

#[test]
fn patches_for_something_else_are_refused_in_one_line() {
    let roll = Roll::new("rmk-cross", "100", &[]);
    let head =
        r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"fiducials","source":"fiducials.csv","edits":["#;
    let cases = [
        (r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"","edits":[]}"#.into(), "GCPs"),
        (format!(r#"{head}{{"frame":"nobody","mark":"A","action":"reject"}}]}}"#), "nobody"),
        (format!(r#"{head}{{"frame":"rmk-cross-1","mark":"nobody","action":"reject"}}]}}"#), "nobody"),
        (format!(r#"{head}{{"frame":"rmk-cross-1","mark":"nobody","action":"move","x":1}}]}}"#), "needs x and y"),
        (
            format!(
                r#"{head}{{"frame":"rmk-cross-1","mark":"{}","action":"pick","candidate":0}}]}}"#,
                roll.camera.marks[0].name
            ),
            "pick",
        ),
        (
            format!(
                r#"{head}{{"frame":"rmk-cross-1","mark":"{}","action":"reject","was":[1.0,2.0]}}]}}"#,
                roll.camera.marks[0].name
            ),
            "had shown it at 1.0, 2.0",
        ),
    ];
    for (patch, word) in cases {
        let file = roll.folder.path().join("p.json");
        std::fs::write(&file, patch).expect("writable");
        let said = roll.fiducials(&["--patch", plain(&file)], 2);
        assert!(said.contains(word) && said.trim_end().lines().count() == 1, "no `{word}` in: {said}");
    }
}

/// 1,000 frames; `AUTOREF_LARGE=1` gives every one chips of its own, else a hundred have.
#[test]
fn a_sheet_of_a_thousand_frames_opens_at_once() {
    let roll = Roll::new("svalbard-zeiss-1936", "50", &[]);
    roll.fiducials(&[], 0);
    let first = roll.frame("svalbard-zeiss-1936-1");
    let chips = if std::env::var_os("AUTOREF_LARGE").is_some() { 1000 } else { 100 };
    let frames: Vec<FrameResult> = (0..1000)
        .map(|k| {
            let mut frame = first.clone();
            frame.name = format!("S36_{k:04}");
            if k >= chips {
                frame.path = roll.out("gone.tif");
            }
            for m in &mut frame.marks {
                m.centre = m.centre.map(|c| PixelPoint { x: c.x + (k % 7) as f64, y: c.y });
            }
            if k % 20 == 0 {
                frame.status = FrameStatus::Doubtful { reasons: vec!["for the test".into()] };
            }
            frame
        })
        .collect();
    let page = roll.out("contact_sheet.html");
    let started = std::time::Instant::now();
    contact_sheet::write_sheet(&page, &roll.camera, &frames, InteriorModel::Affine).expect("written");
    let made_s = started.elapsed().as_secs_f64();
    let bytes = std::fs::metadata(&page).expect("there").len();
    let Some(mut browser) = Browser::start() else { return };
    let started = std::time::Instant::now();
    browser.open(&page);
    let sections = browser.eval("document.querySelectorAll('section').length");
    let open_s = started.elapsed().as_secs_f64();
    assert_eq!(sections, Value::from(1000));
    assert_eq!(complaints(&mut browser, &page), Vec::<String>::new());
    let asked = |browser: &mut Browser| browser.complaints().iter().filter(|c| c.ends_with(".jpg")).count();
    let count_beyond = |browser: &mut Browser, before: usize| {
        let started = std::time::Instant::now();
        loop {
            let now = asked(browser);
            if now > before {
                return now;
            }
            assert!(started.elapsed().as_secs() < 20, "no picture is asked for");
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
    };
    let near = count_beyond(&mut browser, 0);
    println!(
        "1,000 frames: made in {made_s:.1} s, page {bytes} bytes, open in {open_s:.2} s, {near} pictures asked for"
    );
    assert!(open_s < 5.0, "{open_s} s");
    assert!((1..60).contains(&near), "pictures are asked for as they come into view: {near}");
    // Far down, others are.
    browser.eval("document.querySelectorAll('section')[90].scrollIntoView()");
    count_beyond(&mut browser, near);
    if let Some(path) = std::env::var_os("AUTOREF_SCREENSHOT") {
        browser.eval("scrollTo(0, 0); Sheet.frames[0].marks[0].e.focus()");
        std::thread::sleep(std::time::Duration::from_millis(500));
        std::fs::write(path, browser.view()).expect("writable");
    }
}

/// A grey TIFF as numbers.
fn pixels(path: &Path) -> (usize, usize, Vec<f64>) {
    let dataset = gdal::Dataset::open(path).expect("written");
    let band = dataset.rasterband(1).expect("a band");
    let (w, h) = dataset.raster_size();
    (w, h, band.read_as::<f64>((0, 0), (w, h), (w, h), None).expect("readable").data().to_vec())
}

/// Every kernel, at a pixel size below and above the scan's, against gdalwarp on the same grid.
#[test]
fn resampled_frames_are_those_of_gdalwarp() {
    if Command::new("gdalwarp").arg("--version").output().is_err() {
        crate::common::skipped("gdalwarp is absent");
        return;
    }
    let roll = Roll::new("wild-15-4", "100", &["--archive", "--seed", "2"]);
    let name = "wild-15-4-2";
    // A widened Lanczos is weighed otherwise by GDAL 3.6 (docs/limitations.md): not compared.
    for (kernel, pixel_mm) in [("bilinear", 0.09), ("cubic", 0.09), ("lanczos", 0.09), ("cubic", 0.25)] {
        let size = pixel_mm.to_string();
        let scan = roll.scans().join(format!("{name}.tif"));
        let out = roll.folder.path().join("out");
        let args = ["fiducials", plain(&scan), "--camera", "wild-15-4", "--quiet", "-o", plain(&out), "--resample"];
        let output = autoref(&[&args[..], &["--resample-mm", &size, "--kernel", kernel, "--overwrite"]].concat());
        assert!(output.status.code().is_some_and(|c| c < 2), "{}", String::from_utf8_lossy(&output.stderr));
        let frame = roll.frame(name);
        let inner = frame.interior.expect("solved");
        let (w, h, ours) = pixels(&roll.out(&format!("{name}.resampled.tif")));

        // The scan with the orientation as its geotransform (the camera's y runs up, as GDAL's).
        let g = inner.pixel_to_mm;
        let vrt = roll.folder.path().join("scan.vrt");
        let made = Command::new("gdal_translate").args(["-q", "-of", "VRT"]).arg(&scan).arg(&vrt).status();
        assert!(made.expect("gdal_translate").success());
        let transform = format!(
            "<GeoTransform>{:e}, {:e}, {:e}, {:e}, {:e}, {:e}</GeoTransform>",
            g[2], g[0], g[1], g[5], g[3], g[4]
        );
        let xml = text(&vrt).replacen("<VRTRasterBand", &(transform + "<VRTRasterBand"), 1);
        std::fs::write(&vrt, xml).expect("writable");
        let (low, _) = roll.camera.film_box();
        let (right, bottom) = (low[0] + w as f64 * pixel_mm, low[1] + h as f64 * pixel_mm);
        let extent = [low[0], -bottom, right, -low[1]].map(|v| format!("{v:.12}"));
        let warped = roll.folder.path().join("warped.tif");
        let scale = format!("{:.9}", inner.pixel_um / 1e3 / pixel_mm);
        let mut warp = Command::new("gdalwarp");
        warp.args(["-q", "-overwrite", "-et", "0", "-r", kernel, "-ts"]).args([w.to_string(), h.to_string()]);
        warp.args(["-wo", &format!("XSCALE={scale}"), "-wo", &format!("YSCALE={scale}"), "-te"]).args(&extent);
        assert!(warp.arg(&vrt).arg(&warped).status().expect("gdalwarp").success());
        let (gw, gh, theirs) = pixels(&warped);
        assert_eq!((gw, gh), (w, h));
        let (_, _, mask) = pixels(&roll.out(&format!("{name}.mask.tif")));
        // At the rim of the scan GDAL weighs differently.
        let rim = (8.0 * inner.pixel_um / 1e3 / pixel_mm).ceil() as usize + 8;
        let (mut count, mut off, mut worst) = (0usize, 0usize, 0.0f64);
        let white = if theirs.iter().any(|v| *v > 255.0) { 65_535.0 } else { 255.0 };
        for y in rim..h - rim {
            for x in rim..w - rim {
                let i = y * w + x;
                if mask[i] > 0.0 {
                    let difference = (ours[i] - theirs[i]).abs() * 255.0 / white;
                    count += 1;
                    off += usize::from(difference > 1.0);
                    worst = worst.max(difference);
                }
            }
        }
        println!("{kernel} {pixel_mm} mm: {count} pixels, {off} differ by more than 1 of 255, at most {worst:.2}");
        assert!(count > 100_000 && off * 10_000 < count && worst <= 3.0, "{kernel} {pixel_mm}");
    }
}

#[test]
fn resampled_frames_are_masked_kept_and_never_replaced_in_silence() {
    let roll = Roll::new("rmk-cross", "100", &[]);
    let name = "rmk-cross-1";
    let (image, mask) = (roll.out(&format!("{name}.resampled.tif")), roll.out(&format!("{name}.mask.tif")));
    let common = ["--resample", "--resample-mm", "0.1", "--mask-box", "-20,10,-5,30"];
    roll.fiducials(&common, 0);
    let (w, h, values) = pixels(&mask);
    let (low, high) = roll.camera.film_box();
    assert_eq!([w, h], [0, 1].map(|k| ((high[k] - low[k]) / 0.1).round() as usize));
    let marks = roll.camera.film_points();
    let inside = |[x, y]: [f64; 2]| {
        // The camera's y runs up.
        marks.iter().any(|m| (m[0] - x).hypot(m[1] - y) < 3.0)
            || (-20.0..=-5.0).contains(&x) && (-30.0..=-10.0).contains(&y)
    };
    let (mut terrain, mut wrong) = (0, 0);
    for (i, v) in values.iter().enumerate() {
        let at = [low[0] + ((i % w) as f64 + 0.5) * 0.1, low[1] + ((i / w) as f64 + 0.5) * 0.1];
        terrain += usize::from(*v > 0.0);
        wrong += usize::from((*v > 0.0) == inside(at));
    }
    assert!(wrong < 20 && terrain > w * h / 2, "{wrong} pixels of the mask are wrong, {terrain} terrain");
    let made = std::fs::read(&image).expect("there");
    let time = |p: &Path| std::fs::metadata(p).and_then(|m| m.modified()).expect("a time");
    let before = time(&image);
    roll.fiducials(&common, 0);
    assert_eq!(time(&image), before, "what is done is kept");
    // Another pixel size, and somebody's own file.
    let said = roll.fiducials(&["--resample", "--resample-mm", "0.2"], 2);
    assert!(
        said.contains("resampled.tif") && said.contains("--overwrite") && said.trim_end().lines().count() == 1,
        "{said}"
    );
    assert_eq!(std::fs::read(&image).expect("there"), made);
    std::fs::write(&image, "mine").expect("writable");
    roll.fiducials(&common, 2);
    assert_eq!(text(&image), "mine");
    roll.fiducials(&[&common[..], &["--overwrite"]].concat(), 0);
    assert_eq!(std::fs::read(&image).expect("there"), made);
    let left: Vec<String> = std::fs::read_dir(roll.folder.path().join("out"))
        .expect("a folder")
        .map(|e| e.expect("an entry").file_name().to_string_lossy().into_owned())
        .filter(|n| n.contains(".part") || n.contains(".before"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
    for (extra, word) in
        [("--mask-box=1,2,3", "X,Y,X,Y"), ("--mask-marks-mm=-1", "between"), ("--lighting=roll", "--lighting frame")]
    {
        let said = roll.fiducials(&["--resample", "--resample-mm", "0.1", "--overwrite", extra], 2);
        assert!(said.contains(word), "{said}");
    }
}

/// A frame of a camera without turn, resampled by the library at the scan's own pixel size; values of white.
fn resampled(spec: &FilmSpec, ground: &FilmGround, options: &ResampleOptions, light: Light) -> (usize, Vec<f64>) {
    let (scene, inner) = scene(spec, ground);
    let folder = tempfile::tempdir().expect("a folder");
    let (image, mask) = (folder.path().join("a.tif"), folder.path().join("b.tif"));
    resample::resample(&scene, &spec.camera, &inner, options, light, "{}", [&image, &mask]).expect("writable");
    let (w, _, values) = pixels(&image);
    (w, values.into_iter().map(|v| v / 65_535.0).collect())
}

fn scene(spec: &FilmSpec, ground: &FilmGround) -> (FilmScene, InteriorOrientation) {
    let scene = FilmScene::new(spec, ground).expect("drawable");
    let marks: Vec<Observation> = scene
        .truth()
        .marks
        .iter()
        .zip(&spec.camera.marks)
        .map(|(t, m)| Observation {
            name: m.name.clone(),
            mm: [m.x_mm.expect("calibrated"), m.y_mm.expect("calibrated")],
            pixel: PixelPoint { x: t.x, y: t.y },
            covariance_px2: [0.01, 0.0, 0.01],
        })
        .collect();
    let inner = solve(&spec.camera, &marks, InteriorModel::Affine, Handedness::AsIs).expect("solved");
    (scene, inner)
}

/// A landscape of noise; with `AUTOREF_LARGE=1` more of them, and photographs from above where they are there. None of
/// these repeats within a frame of 2,000 px: what a small photograph repeats along whole rows is a band.
fn grounds(first: u64) -> Vec<(&'static str, FilmGround, Vec<u64>)> {
    let large = std::env::var_os("AUTOREF_LARGE").is_some();
    let mut all = vec![("noise", FilmGround::default(), (first..first + if large { 4 } else { 1 }).collect())];
    let data = crate::common::root().join("../shared/data");
    let names = ["film/japan_1936_42/Z17-X114848-Y51988.png", "photos/savanna_oam.tif", "photos/river_town_oam.tif"];
    let paths: Vec<PathBuf> = names.iter().map(|n| data.join(n)).filter(|p| large && p.exists()).collect();
    if !paths.is_empty() {
        all.push(("photographs", FilmGround::open(&paths).expect("readable"), (first..first + 4).collect()));
    }
    all
}

fn grey16(seed: u64) -> (FilmSpec, ResampleOptions) {
    let camera = load_camera("rmk-cross").expect("built in");
    let mut spec = FilmSpec::plain(&camera, 100.0, seed);
    (spec.bits, spec.noise, spec.vignette) = (16, 0.004, 0.0);
    let options = ResampleOptions {
        pixel_mm: 0.1,
        kernel: Kernel::Cubic,
        mask_radius_mm: 3.0,
        boxes_mm: vec![],
        banding: Banding::Off,
    };
    (spec, options)
}

/// Means of squares of 64 pixels that lie clear of marks and border, and their standard deviations.
fn squares(w: usize, values: &[f64]) -> Vec<(f64, f64)> {
    let h = values.len() / w;
    let (mut all, margin) = (vec![], 64);
    for y in (margin..h - margin - 64).step_by(64) {
        for x in (margin..w - margin - 64).step_by(64) {
            let square: Vec<f64> = (0..64 * 64).map(|k| values[(y + k / 64) * w + x + k % 64]).collect();
            let mean = square.iter().sum::<f64>() / 4096.0;
            all.push((mean, (square.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / 4096.0).sqrt()));
        }
    }
    all
}

/// Relative spread of `a` over `b`, square by square: 0 when they differ by one factor.
fn spread(a: &[(f64, f64)], b: &[(f64, f64)], black: f64) -> f64 {
    let ratios: Vec<f64> = a.iter().zip(b).map(|(a, b)| (a.0 - black) / (b.0 - black)).collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    (ratios.iter().map(|r| (r / mean - 1.0).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt()
}

#[test]
fn known_vignette_is_evened_out_and_contrast_stays() {
    for (name, ground, seeds) in grounds(5) {
        for seed in seeds {
            let [before, frame_after, roll_after, kept_frame, kept_roll] = vignette(&ground, seed);
            println!(
                "{name} {seed}, vignette 0.5: light varies by {before:.4} before, {frame_after:.4} (frame), \
                 {roll_after:.4} (roll of 6); contrast kept: {kept_frame:.4}, {kept_roll:.4}"
            );
            assert!(before > 0.06 && frame_after < 0.75 * before, "{name} {seed}");
            // Six photographs may share what is bright and dark.
            let at_most = if name == "noise" { 0.6 } else { 0.75 };
            assert!(roll_after < at_most * before, "{name} {seed}");
            assert!([kept_frame, kept_roll].iter().all(|k| (k - 1.0).abs() < 0.06), "{name} {seed}");
        }
    }
}

/// How much the light varies before, after `--lighting frame` and after `roll`, and the contrast that these two keep.
fn vignette(ground: &FilmGround, seed: u64) -> [f64; 5] {
    let (clean, options) = grey16(seed);
    let mut dim = clean.clone();
    dim.vignette = 0.5;
    let (w, even) = resampled(&clean, ground, &options, Light::AsScanned);
    let even = squares(w, &even);
    // What the opaque frame lets through is not light of the image.
    let black = 0.03;
    let before = spread(&squares(w, &resampled(&dim, ground, &options, Light::AsScanned).1), &even, black);
    let of_frame = squares(w, &resampled(&dim, ground, &options, Light::OfFrame).1);
    let cells: Vec<_> = (seed..seed + 6)
        .map(|seed| {
            let mut one = dim.clone();
            one.seed = seed;
            let (scene, inner) = scene(&one, ground);
            resample::frame_cells(&scene, &one.camera, &inner, &options).expect("in memory")
        })
        .collect();
    let roll = lighting::of_roll(&cells).expect("six frames");
    let of_roll = squares(w, &resampled(&dim, ground, &options, Light::OfRoll(&roll)).1);
    let (frame_after, roll_after) = (spread(&of_frame, &even, black), spread(&of_roll, &even, black));
    // Contrast within squares, relative to their brightness, is that of the even frame.
    let contrast = |s: &[(f64, f64)]| s.iter().map(|(m, d)| d / (m - black)).sum::<f64>() / s.len() as f64;
    let kept = |after: &[(f64, f64)]| contrast(after) / contrast(&even);
    [before, frame_after, roll_after, kept(&of_frame), kept(&of_roll)]
}

#[test]
fn known_bands_are_removed_and_the_ground_stays() {
    for (name, ground, seeds) in grounds(8) {
        for seed in seeds {
            let bands = Bands::new(&ground, seed);
            let (before, across) = (bands.left(Banding::Off), bands.left(Banding::Columns));
            assert!(before > 0.01 && across > 0.9 * before);
            for which in [Banding::Rows, Banding::Both] {
                let (after, of_clean) = (bands.left(which), bands.rms(&bands.clean, which));
                println!(
                    "{name} {seed}, {which:?}: bands {before:.5} of white before, {after:.5} after; a frame without \
                     bands changes by {of_clean:.5}; wrong direction leaves {across:.5}"
                );
                // Photographs may have more of their own along the rows than the bands.
                let at_most = if name == "noise" { 0.4 } else { 0.95 };
                assert!(after < at_most * before, "{name} {seed}: {before} {after}");
                assert!(of_clean < 0.01 * before, "{name} {seed}: ground is taken for bands: {of_clean}");
            }
        }
    }
}

/// One frame without bands and with.
struct Bands<'a> {
    ground: &'a FilmGround,
    options: ResampleOptions,
    clean: FilmSpec,
    banded: FilmSpec,
    /// The frame without bands, nothing removed.
    still: Vec<f64>,
}

impl<'a> Bands<'a> {
    fn new(ground: &'a FilmGround, seed: u64) -> Bands<'a> {
        let (mut clean, options) = grey16(seed);
        clean.rotation_deg = 0.4;
        let mut banded = clean.clone();
        banded.banding = 0.02;
        let (_, still) = resampled(&clean, ground, &options, Light::AsScanned);
        Bands { ground, options, clean, banded, still }
    }

    /// What is left of the bands when `which` are removed.
    fn left(&self, which: Banding) -> f64 {
        self.rms(&self.banded, which)
    }

    /// Bands are what differs from the frame without them, inside the ground that they are measured on.
    fn rms(&self, spec: &FilmSpec, banding: Banding) -> f64 {
        let options = ResampleOptions { banding, ..self.options.clone() };
        let (w, values) = resampled(spec, self.ground, &options, Light::AsScanned);
        let h = values.len() / w;
        let inside: Vec<usize> = (80..h - 80).flat_map(|y| (80..w - 80).map(move |x| y * w + x)).collect();
        let sum: f64 = inside.iter().map(|&i| (values[i] - self.still[i]).powi(2)).sum();
        (sum / inside.len() as f64).sqrt()
    }
}

/// JPEG, PNG and one compressed strip give what the same pixels give in tiles.
#[test]
fn scans_that_stream_give_the_same_frame_as_tiles() {
    let roll = Roll::new("rmk-cross", "80", &[]);
    let tiled = roll.scans().join("rmk-cross-1.tif");
    let other = roll.folder.path().join("other");
    std::fs::create_dir(&other).expect("writable");
    let resample = ["--resample", "--resample-mm", "0.08", "--overwrite"];
    roll.fiducials(&resample, 0);
    for (name, format, options) in
        [("a.png", "PNG", vec![]), ("b.tif", "GTiff", vec!["-co", "COMPRESS=DEFLATE", "-co", "BLOCKYSIZE=100000"])]
    {
        let to = other.join(name);
        let made =
            Command::new("gdal_translate").args(["-q", "-of", format]).args(&options).arg(&tiled).arg(&to).status();
        if !made.is_ok_and(|s| s.success()) {
            crate::common::skipped("gdal_translate is absent");
            return;
        }
        let out = roll.folder.path().join("other-out");
        let args = ["fiducials", plain(&to), "--camera", "rmk-cross", "--quiet", "-o", plain(&out)];
        run(&[&args[..], roll.lie(), &resample].concat(), 0);
        let ours = pixels(&out.join(format!("{}.resampled.tif", name.split('.').next().expect("a stem"))));
        assert!(ours == pixels(&roll.out("rmk-cross-1.resampled.tif")), "{name}");
    }
}

/// The numbers of the tables and of the JSON against least squares written out here.
#[test]
fn tables_of_the_interior_orientation_are_those_of_an_independent_calculation() {
    let roll = Roll::new("wild-15-4", "80", &["--frames", "3", "--seed", "4"]);
    roll.fiducials(&["--exports"], 0);
    let cell = |row: &csv::StringRecord, k: usize| row[k].parse::<f64>().unwrap_or_else(|_| panic!("{row:?} {k}"));
    let read = |name: &str| -> Vec<csv::StringRecord> {
        let mut csv = csv::Reader::from_path(roll.out(name)).expect("written");
        csv.records().map(|r| r.expect("a row")).collect()
    };
    let rows = read("inner_orientation.csv");
    assert_eq!(rows.len(), 3);
    let film: Vec<[f64; 2]> =
        roll.camera.marks.iter().map(|m| [m.x_mm.expect("there"), m.y_mm.expect("there")]).collect();
    let n = film.len();
    let size = |r: &[f64; 2]| r[0].hypot(r[1]);
    let rms = |all: &[[f64; 2]]| (all.iter().map(|r| size(r).powi(2)).sum::<f64>() / all.len() as f64).sqrt();
    let mut by_mark: Vec<Vec<[f64; 2]>> = vec![vec![]; n];
    for row in &rows {
        let frame = roll.frame(&row[0]);
        let px: Vec<[f64; 2]> = frame.marks.iter().map(|m| m.centre.map(|c| [c.x, c.y]).expect("found")).collect();
        let off = |f: &dyn Fn([f64; 2]) -> [f64; 2], i: usize| [0, 1].map(|k| 1e3 * (f(px[i])[k] - film[i][k]));
        let all = affine(&px, &film);
        let residuals: Vec<[f64; 2]> = (0..n).map(|i| off(&all, i)).collect();
        let without = |i: usize| {
            let keep = |v: &[[f64; 2]]| [&v[..i], &v[i + 1..]].concat();
            affine(&keep(&px), &keep(&film))
        };
        let left_out: Vec<[f64; 2]> = (0..n).map(|i| off(&without(i), i)).collect();
        let close = |k: usize, should: f64| {
            let is = cell(row, k);
            assert!((is - should).abs() < 6e-4, "column {k} of {row:?}: {should}");
        };
        assert_eq!((&row[1], &row[2], &row[3], &row[4]), ("ok", "affine", "8", "10"));
        close(5, rms(&residuals));
        close(6, rms(&residuals) * (n as f64 / 10.0).sqrt());
        close(7, residuals.iter().map(size).fold(0.0, f64::max));
        close(8, rms(&left_out));
        let inner = frame.interior.as_ref().expect("solved");
        for (i, r) in residuals.iter().enumerate() {
            let (said, out) = (frame.marks[i].residual_um.expect("solved"), inner.leave_one_out_um[i].expect("enough"));
            assert!((said[0] - r[0]).hypot(said[1] - r[1]) < 1e-6 && size(&left_out[i]) > size(r));
            assert!((out[0] - left_out[i][0]).hypot(out[1] - left_out[i][1]) < 1e-6, "{out:?} {:?}", left_out[i]);
            by_mark[i].push(*r);
        }
        // Film and scanner are drawn without shear, certificates are 3 µm off: a few ten ppm.
        assert!(cell(row, 12).abs() < 100.0 && cell(row, 13).abs() < 100.0 && (cell(row, 9) / 80.0 - 1.0).abs() < 1e-3);
    }
    for (row, (mark, residuals)) in read("roll_marks.csv").iter().zip(roll.camera.marks.iter().zip(&by_mark)) {
        assert_eq!((&row[0], &row[1], &row[2], &row[3], &row[4]), (mark.name.as_str(), "3", "3", "0", "0"));
        for k in 0..2 {
            let mean = residuals.iter().map(|r| r[k]).sum::<f64>() / 3.0;
            let sd = (residuals.iter().map(|r| (r[k] - mean).powi(2)).sum::<f64>() / 2.0).sqrt();
            assert!((cell(row, 5 + k) - mean).abs() < 6e-4 && (cell(row, 7 + k) - sd).abs() < 6e-4, "{row:?}");
        }
        assert!((cell(row, 9) - rms(residuals)).abs() < 6e-4);
        assert!((cell(row, 10) - residuals.iter().map(size).fold(0.0, f64::max)).abs() < 6e-4);
    }
}

/// Covariances by moving every coordinate a little and solving again, for all models; and what can be left out.
#[test]
fn covariances_are_those_of_propagated_errors_and_leaving_out_needs_redundancy() {
    let camera = load_camera("wild-15-4").expect("built in");
    let sigma_px = 0.1;
    let at = |mm: [f64; 2], k: usize| {
        // A turned scan with residuals of about 0.05 px, well below the stated precision.
        let (x, y) = (2900.0 + 11.9 * mm[0] - 0.4 * mm[1], 2850.0 - 0.4 * mm[0] - 11.9 * mm[1]);
        PixelPoint { x: x + 0.03 * ((k * 7 % 5) as f64 - 2.0), y: y + 0.03 * ((k * 3 % 5) as f64 - 2.0) }
    };
    let marks: Vec<Observation> = camera
        .marks
        .iter()
        .enumerate()
        .map(|(k, m)| {
            let mm = [m.x_mm.expect("there"), m.y_mm.expect("there")];
            let covariance_px2 = [sigma_px * sigma_px, 0.0, sigma_px * sigma_px];
            Observation { name: m.name.clone(), mm, pixel: at(mm, k), covariance_px2 }
        })
        .collect();
    for (model, free) in [(InteriorModel::Similarity, 4), (InteriorModel::Affine, 6), (InteriorModel::Projective, 8)] {
        let inner = solve(&camera, &marks, model, Handedness::AsIs).expect("solved");
        // Similarity: a = h0, b = −h1, X₀, Y₀; the others: h0 and on.
        let free_of =
            |h: &[f64; 9]| -> Vec<f64> { if free == 4 { vec![h[0], -h[1], h[2], h[5]] } else { h[..free].to_vec() } };
        let step = 1e-4;
        let mut propagated = vec![vec![0.0; free]; free];
        for i in 0..marks.len() {
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut next = marks.clone();
                    // An error of a millimetre coordinate: the program takes a pixel's error for one on the film.
                    next[i].mm[axis] += by;
                    free_of(&solve(&camera, &next, model, Handedness::AsIs).expect("solved").pixel_to_mm)
                };
                let (up, down) = (moved(step), moved(-step));
                let sigma_mm = sigma_px * inner.pixel_um / 1e3;
                let d: Vec<f64> = up.iter().zip(&down).map(|(a, b)| (a - b) / (2.0 * step) * sigma_mm).collect();
                for a in 0..free {
                    for b in 0..free {
                        propagated[a][b] += d[a] * d[b];
                    }
                }
            }
        }
        for a in 0..free {
            for b in 0..free {
                let unit = (propagated[a][a] * propagated[b][b]).sqrt();
                let off = (inner.covariance[a][b] - propagated[a][b]).abs() / unit;
                assert!(off < 0.01, "{model:?} {a} {b}: {} {}", inner.covariance[a][b], propagated[a][b]);
            }
        }
        // One mark fewer than the model needs to be left out: the corners are enough for a similarity and an affine
        // only.
        let four = solve(&camera, &marks[..4], model, Handedness::AsIs).expect("solved");
        assert!(four.leave_one_out_um.iter().all(Option::is_some) && four.leave_one_out_rmse_um.is_some());
        assert_ne!(four.model, InteriorModel::Projective, "four marks leave a projective unchecked");
        let two = solve(&camera, &marks[..2], model, Handedness::AsIs).expect("solved");
        assert!(two.leave_one_out_um.iter().all(Option::is_none) && two.leave_one_out_rmse_um.is_none());
    }
}
