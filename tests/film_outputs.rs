//! What `fiducials` writes: the files for other programs read back by their formats, the contact sheet in a real browser, and
//! the resampled frames against GDAL and against known truth.

mod browser;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_stream::coords::PixelPoint;
use autoref_stream::film::{Camera, FrameResult, FrameStatus, InnerModel, MarkStatus, contact_sheet, load_camera};
use browser::{Browser, Page};
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
        args.extend(extra);
        run(&args, code)
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

/// Least squares affine from `from` to `to` by the normal equations, as MicMac's `ElAffin2D::L2Fit` on points paired by name;
/// gives the function.
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
    for model in ["affine", "similarity", "projective"] {
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
            let inner = reviewed.inner.as_ref().expect("solved");
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
    contact_sheet::write_sheet(&page, &roll.camera, &frames, InnerModel::Affine).expect("written");
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
