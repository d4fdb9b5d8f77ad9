//! The contact sheet and the page for clicking, in a real browser; what they save, replayed.

use std::path::Path;

use super::{Roll, json, plain, run, text};
use crate::browser::{Browser, Page};
use autoref_film::{FrameResult, FrameStatus, InteriorModel, MarkStatus, contact_sheet};
use autoref_raster::coords::PixelPoint;
use serde_json::Value;

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
        // Groups are the run's, and the sheet says so. In a narrow window the enlargement keeps its shape.
        let groups = "[...document.querySelectorAll('h2')].map(h => h.textContent).join()";
        assert!(browser.eval(groups).as_str().expect("text").contains("changed here"), "{}", browser.eval(groups));
        browser.widen(400);
        let sides = "(() => { const r = document.querySelector('#zoom .c').getBoundingClientRect(); return [r.width, r.height]; })()";
        assert_eq!(browser.eval(sides), serde_json::json!([320, 320]));
        browser.widen(1280);
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
    assert!(said.contains("learned from 1 scan;"), "{said}");
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
