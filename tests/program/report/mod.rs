//! The report of a run, opened in a real browser where there is one: nothing fails, nothing is fetched, and what a
//! reviewer does by keyboard is what the replay of the patch gives.

use std::path::PathBuf;
use std::process::{Command, Output};

use crate::browser::firefox::Firefox;
use crate::browser::{Browser, Page};
use autoref_synth::{self as synth, Compression, MarkSize, MarkStyle, SynthGcp, SynthSpec, Truth, Visible};
use gdal::raster::Buffer;
use serde_json::Value;

/// A name that would be markup if a page let it.
const EVIL: &str = "<script>document.title='owned'</script><b id=\"evil\">\"'&";

struct Sample {
    folder: tempfile::TempDir,
    truth: Truth,
}

impl Sample {
    /// An image of 2300 × 1700 px; `list` may change the list that the program is given.
    fn new(change: impl FnOnce(&mut SynthSpec), list: impl FnOnce(&mut Vec<SynthGcp>)) -> Sample {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut spec = SynthSpec {
            gcps: synth::random_gcps(14, 66.0, 48.0, 11),
            size_px: Some((2300, 1700)),
            rotation_deg: 7.5,
            visible: Visible::Random(10),
            displacement_px: 0.3,
            mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
            ..SynthSpec::default()
        };
        spec.output.compression = Compression::Deflate;
        change(&mut spec);
        let truth = synth::write(&spec, &folder.path().join("e6.tif")).expect("a sample");
        let mut gcps = spec.gcps.clone();
        list(&mut gcps);
        synth::write_gcp_geojson(&folder.path().join("e6.geojson"), &gcps, Some(32632)).expect("a list");
        Sample { folder, truth }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, extra: &[&str]) -> Output {
        let (image, list) = (self.path("e6.tif"), self.path("e6.geojson"));
        let mut args = vec![image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--quiet"];
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

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

fn count(browser: &mut dyn Page, selector: &str) -> u64 {
    let found = browser.eval(&format!("document.querySelectorAll({}).length", Value::from(selector)));
    found.as_u64().expect("a count")
}

/// Presses keys as a reviewer would: with the focus on a card of the named GCP.
fn focus(browser: &mut dyn Page, gcp: &str) {
    let find = format!(
        "[...document.querySelectorAll('button.card')].find(c => c.querySelector('.name').textContent === {})",
        Value::from(gcp)
    );
    for _ in 0..40 {
        if browser.eval(&format!("document.activeElement === {find}")) == Value::Bool(true) {
            return;
        }
        browser.key("ArrowRight", false);
    }
    panic!("the arrow keys do not reach {gcp}");
}

/// Tabs until a card has the focus, as one without a mouse does.
fn tab_to_cards(browser: &mut dyn Page) {
    for _ in 0..60 {
        browser.key("Tab", false);
        if browser.eval("document.activeElement.classList.contains('card')") == Value::Bool(true) {
            return;
        }
    }
    panic!("the Tab key does not reach the marks");
}

/// A sample with clutter, a name that would be markup, and the name of a visible point whose survey is 0.05 m = 1.7 px
/// off, found all the same: the wrong mark of the tests.
fn with_a_wrong_mark() -> (Sample, String) {
    let sample = Sample::new(|spec| spec.clutter = 30, |list| list[0].name = EVIL.into());
    let wrong = sample.truth.visible().nth(4).expect("ten are visible").name.clone();
    let text = std::fs::read_to_string(sample.path("e6.geojson")).expect("the list");
    let mut list: Value = serde_json::from_str(&text).expect("GeoJSON");
    for feature in list["features"].as_array_mut().expect("features") {
        if feature["properties"]["name"] == wrong.as_str() {
            let easting = number(&feature["geometry"]["coordinates"][0]) + 0.05;
            feature["geometry"]["coordinates"][0] = easting.into();
        }
    }
    std::fs::write(sample.path("e6.geojson"), list.to_string()).expect("writable");
    (sample, wrong)
}

#[test]
fn the_page_is_whole_and_a_review_by_keyboard_replays_to_the_same_numbers() {
    let (sample, wrong) = with_a_wrong_mark();
    let check = sample.truth.visible().nth(7).expect("ten are visible").name.clone();
    let output = sample.run(&["--check", &check]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let result = sample.json();
    let files: Vec<&str> =
        result["files_written"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
    assert!(files.iter().any(|f| f.ends_with("e6.report.html")), "{files:?}");
    let page = std::fs::read_to_string(sample.path("e6.report.html")).expect("the report");
    assert!(!page.contains("<script>document") && page.contains("\\u003cscript>document"));

    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    let matched = result["matches"].as_array().map_or(0, Vec::len) as u64;
    let inside = |points: &Vec<Value>| points.iter().filter(|point| point["reason"] != "outside").count();
    let missing = result["not_found"].as_array().map_or(0, inside) as u64;
    assert_eq!(count(&mut browser, "button.card"), matched + 1 + missing);
    assert!(missing > 0, "the sample has points without marks");
    let shown = browser.eval("document.getElementById('cards').textContent");
    for point in result["not_found"].as_array().into_iter().flatten().filter(|point| point["reason"] != "outside") {
        let detail = point["detail"].as_str().expect("words");
        assert!(shown.as_str().is_some_and(|shown| shown.contains(detail)), "{point} is not on its card");
    }
    assert!(count(&mut browser, "button.card svg image") > matched);
    assert!(count(&mut browser, "button.card svg polygon") >= 2 * matched, "the fitted shapes are drawn");
    assert_eq!(count(&mut browser, "#plots > figure > svg"), 4);
    assert!(count(&mut browser, "#overview-figure line.vector") > matched);
    assert_eq!(count(&mut browser, "#expected-figure > svg"), 1);
    assert_eq!(count(&mut browser, "#points-table tbody tr"), 14);
    assert_eq!(count(&mut browser, "#evil"), 0, "a name became markup");
    assert!(browser.eval("document.title").as_str().is_some_and(|title| title.starts_with("e6.tif")));
    assert!(browser.eval("document.body.textContent").as_str().is_some_and(|text| text.contains(EVIL)));
    let broken = "[...document.querySelectorAll('svg image')].filter(i => !i.getAttribute('href').startsWith('data:image/jpeg')).length";
    assert_eq!(browser.eval(broken), 0);

    if let Some(folder) = std::env::var_os("AUTOREF_SCREENSHOTS").map(PathBuf::from) {
        // For whoever wants to look, and for the picture under docs/.
        std::fs::write(folder.join("report.jpg"), browser.screenshot(0.7)).expect("writable");
        std::fs::write(folder.join("report.pdf"), browser.pdf()).expect("writable");
    }
    accessible(&mut browser);
    review(&mut browser, &sample, &wrong);
}

#[test]
fn firefox_shows_the_same_page_and_its_review_replays() {
    let Some(mut browser) = Firefox::start() else { return };
    let (sample, wrong) = with_a_wrong_mark();
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    assert_eq!(count(&mut browser, "#plots > figure > svg"), 4);
    assert!(
        count(&mut browser, "button.card svg polygon") > 0 && count(&mut browser, "#overview-figure line.vector") > 0
    );
    review(&mut browser, &sample, &wrong);
}

/// Every control has a name, the keyboard reaches all in the order of the page and shows where it is, text is legible.
fn accessible(browser: &mut Browser) {
    let spoken = browser.spoken();
    let named = [
        "button",
        "link",
        "checkbox",
        "combobox",
        "textbox",
        "table",
        "columnheader",
        "figure",
        "image",
        "img",
        "region",
    ];
    let nameless: Vec<_> =
        spoken.iter().filter(|(role, name)| named.contains(&role.as_str()) && name.trim().is_empty()).collect();
    assert!(nameless.is_empty(), "{nameless:?}");
    for (role, least) in [("button", 20), ("table", 1), ("columnheader", 14), ("status", 1), ("figure", 6)] {
        assert!(spoken.iter().filter(|(r, _)| r == role).count() >= least, "{role}");
    }

    // Once around with the Tab key, from the top.
    browser.eval("document.activeElement.blur()");
    browser.eval("window.seen = []");
    for stop in 0..60 {
        browser.key("Tab", false);
        let at = browser.eval(
            "(() => { const a = document.activeElement, s = getComputedStyle(a), last = window.seen[window.seen.length - 1]; \
             if (a === document.body || window.seen.includes(a)) return null; \
             const after = !last || Boolean(last.compareDocumentPosition(a) & Node.DOCUMENT_POSITION_FOLLOWING); window.seen.push(a); \
             return { after, outline: s.outlineStyle !== 'none' && parseFloat(s.outlineWidth) >= 1, what: a.outerHTML.slice(0, 80) }; })()",
        );
        if at.is_null() {
            assert!(stop >= 20, "only {stop} stops");
            break;
        }
        assert!(at["after"] == true && at["outline"] == true, "{at}");
    }

    // WCAG 2.2, 1.4.3: relative luminance of the text against the nearest background that is painted.
    let faint = browser.eval(
        "(() => { const lin = (v) => (v /= 255) <= 0.04045 ? v / 12.92 : Math.pow((v + 0.055) / 1.055, 2.4); \
         const rgb = (c) => c.match(/[0-9.]+/g).map(Number); \
         const lum = (c) => 0.2126 * lin(c[0]) + 0.7152 * lin(c[1]) + 0.0722 * lin(c[2]); const out = []; \
         for (const e of document.querySelectorAll('body *')) { \
           const own = [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim()); \
           if (!own || e.closest('svg, script, noscript, :disabled, [hidden]') || !e.getClientRects().length) continue; \
           let b = e, back = [255, 255, 255]; \
           while (b) { const c = rgb(getComputedStyle(b).backgroundColor); if (c.length < 4 || c[3] > 0) { back = c; break; } b = b.parentElement; } \
           const x = lum(rgb(getComputedStyle(e).color)), y = lum(back), ratio = (Math.max(x, y) + 0.05) / (Math.min(x, y) + 0.05); \
           if (ratio < 4.5) out.push(ratio.toFixed(2) + ' ' + e.outerHTML.slice(0, 80)); } return out; })()",
    );
    assert_eq!(faint, Value::Array(Vec::new()), "text too faint");
}

/// A model of heights in the image's grid at an eighth of its size: level, but for a bowl.
fn write_model(path: &std::path::Path) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("GDAL has it");
    let file = driver.create_with_band_type::<f32, _>(path, 288, 213, 1).expect("created");
    let height = |i: usize| 78.0 + ((i % 288) as f32 - 144.0).powi(2) / 20_000.0;
    let heights = (0..288 * 213).map(height).collect();
    file.rasterband(1)
        .expect("one band")
        .write((0, 0), (288, 213), &mut Buffer::new((288, 213), heights))
        .expect("written");
}

#[test]
fn heights_and_a_chosen_model_are_on_the_page_and_the_replay_solves_the_model_again() {
    let sample = Sample::new(
        |spec| {
            spec.size_px = Some((2304, 1704));
            spec.visible = Visible::Random(12);
        },
        |_| {},
    );
    write_model(&sample.path("dem.tif"));
    let check = sample.truth.visible().nth(7).expect("visible").name.clone();
    let dem = sample.path("dem.tif");
    for model in ["affine", "projective"] {
        let output =
            sample.run(&["--dem", dem.to_str().expect("plain"), "--model", model, "--check", &check, "--overwrite"]);
        assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
        let result = sample.json();
        assert_eq!(result["chosen_model"]["model"], model);
        let Some(mut browser) = Browser::start() else { return };
        browser.open(&sample.path("e6.report.html"));
        assert_eq!(browser.complaints(), Vec::<String>::new());
        let heights = browser.eval("document.querySelector('section[aria-label=Heights]').textContent");
        let heights = heights.as_str().expect("text");
        let chosen = result["heights"]["correction"]["chosen"].as_str().expect("a surface");
        assert!(heights.contains("Surface chosen") && heights.contains(chosen), "{heights}");
        let first = result["heights"]["points"][0]["gcp"].as_str().expect("a name");
        assert!(heights.contains(first), "no {first} in {heights}");
        assert!(browser.eval("document.getElementById('figures').textContent").to_string().contains(model));
        // What the page says of the run as it is.
        let (matches, close) = (result["matches"].as_array().expect("rows"), |a: f64, b: f64| (a - b).abs() <= 1e-9);
        let shown = "(() => { const D = JSON.parse(document.getElementById('data').textContent), M = D.chosen_model.model; \
            const s = Review.evaluate(D.points, Review.initial(D.points), M); return { chosen: s.chosen.rmse, left: s.chosen.leftOutRmse, \
            rmse: s.fit.rmse, rows: D.points.map((p, i) => s.rows[i] && [p.name, s.rows[i].e, s.rows[i].n]).filter((r) => r) }; })()";
        let shown = browser.eval(shown);
        assert!(close(number(&shown["chosen"]), number(&result["chosen_model"]["rmse_m"])), "{shown}");
        assert!(close(number(&shown["left"]), number(&result["chosen_model"]["leave_one_out_rmse_m"])), "{shown}");
        assert!(close(number(&shown["rmse"]), number(&result["rmse_m"])), "{shown}");
        for row in matches.iter().chain(result["check_points"].as_array().expect("rows")) {
            let on_page = shown["rows"].as_array().expect("rows").iter().find(|r| r[0] == row["gcp"]).expect("there");
            assert!(close(number(&on_page[1]), number(&row["residual_e_m"])), "{on_page} against {row}");
            assert!(close(number(&on_page[2]), number(&row["residual_n_m"])), "{on_page} against {row}");
        }
        // A mark less, and again.
        tab_to_cards(&mut browser);
        browser.key("Home", false);
        focus(&mut browser, matches[2]["gcp"].as_str().expect("a name"));
        browser.key("r", false);
        browser.key("s", false);
        let patch = browser.download("e6.patch.json");
        let json = sample.path("e6.autoref.json");
        let args =
            ["solve", json.to_str().expect("plain"), "--patch", patch.to_str().expect("plain"), "--json", "--quiet"];
        let replayed = autoref(&args);
        assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
        let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("one document");
        assert_eq!(replayed["chosen_model"]["model"], model);
        assert!(
            replayed["warnings"].to_string().contains("heights were not compared again"),
            "{}",
            replayed["warnings"]
        );
        let patch: Value = serde_json::from_slice(&std::fs::read(&patch).expect("saved")).expect("JSON");
        assert!(close(number(&replayed["rmse_m"]), number(&patch["shown"]["rmse_m"])), "{}", replayed["rmse_m"]);
        for (i, coefficient) in patch["shown"]["geotransform"].as_array().expect("six").iter().enumerate() {
            let (a, b) = (number(&replayed["geotransform"][i]), number(coefficient));
            // The page's least squares are not nalgebra's: where a northing of millions is known to 1e-9, that is its
            // last digit.
            assert!((a - b).abs() <= 2e-9, "{i}: {a} against {b}");
        }
    }
}

#[test]
fn odd_names_and_long_lists_stay_text() {
    let names = ["\u{202e}drawkcab", "'quoted\"", "", "نقطة ٣", "a\u{0}b", "${D.points}"];
    let sample = Sample::new(
        |_| {},
        |list| {
            for (gcp, name) in list.iter_mut().zip(names) {
                gcp.name = if name.is_empty() { "x".repeat(200) } else { name.replace('\u{0}', " ") };
            }
            // Points far off, which nobody will find.
            for i in 0..480 {
                list.push(SynthGcp {
                    name: format!("far {i}"),
                    easting: list[0].easting + 5000.0 + f64::from(i * i % 977),
                    northing: list[0].northing + 7.0 * f64::from(i),
                    ..list[0].clone()
                });
            }
        },
    );
    let output = sample.run(&["--gsd", "0.03"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(std::fs::metadata(sample.path("e6.report.html")).expect("the report").len() < 3_000_000);
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    assert_eq!(count(&mut browser, "#points-table tbody tr"), 494);
    let wide = browser.eval("document.documentElement.scrollWidth <= window.innerWidth");
    assert_eq!(wide, true, "the page is wider than the window");
    accessible(&mut browser);
}

#[test]
fn an_image_of_one_row_has_a_report_too() {
    let sample = Sample::new(|_| {}, |_| {});
    let source = gdal::Dataset::open(sample.path("e6.tif")).expect("a sample");
    let row = gdal::DriverManager::get_driver_by_name("GTiff")
        .expect("GDAL has it")
        .create_with_band_type::<u8, _>(sample.path("thin.tif"), 2300, 1, 3)
        .expect("created");
    for band in 1..=3 {
        let mut pixels =
            source.rasterband(band).expect("a band").read_as::<u8>((0, 40), (2300, 1), (2300, 1), None).expect("read");
        row.rasterband(band).expect("a band").write((0, 0), (2300, 1), &mut pixels).expect("written");
    }
    drop(row);
    let (image, list) = (sample.path("thin.tif"), sample.path("e6.geojson"));
    let output = autoref(&[image.to_str().expect("plain"), "--gcps", list.to_str().expect("plain"), "--quiet"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("thin.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    assert!(browser.eval("document.getElementById('verdict').textContent").to_string().contains("Not georeferenced"));
    // Where nothing can be written: a folder below a file.
    let below = sample.path("thin.tif").join("out");
    let output = autoref(&[
        image.to_str().expect("plain"),
        "--gcps",
        list.to_str().expect("plain"),
        "--out",
        below.to_str().expect("plain"),
    ]);
    assert_eq!((output.status.code(), stderr(&output).trim_end().lines().count()), (Some(2), 1), "{}", stderr(&output));
}

fn review(browser: &mut dyn Page, sample: &Sample, wrong: &str) {
    let result = sample.json();
    let other = result["matches"][0]["gcp"].as_str().expect("a name").to_string();
    let first = browser.eval("document.querySelector('#figures').textContent");
    tab_to_cards(browser);
    browser.key("Home", false);
    focus(browser, wrong);
    browser.key("r", false);
    let rejected = browser.eval("document.querySelector('#figures').textContent");
    assert_ne!(first, rejected, "the page did not follow");
    browser.key("u", false);
    assert_eq!(browser.eval("document.querySelector('#figures').textContent"), first, "undo");
    browser.key("r", false);
    browser.key("Home", false);
    focus(browser, &other);
    for key in ["ArrowRight", "ArrowRight", "ArrowRight", "ArrowUp"] {
        browser.key(key, true);
    }
    assert!(
        browser
            .eval("document.getElementById('live').textContent")
            .as_str()
            .is_some_and(|t| t.contains(&other) && t.contains("residual") && t.contains("RMSE")),
        "residuals are announced"
    );
    browser.key("s", false);
    let patch_file = browser.download("e6.patch.json");
    let patch: Value = serde_json::from_slice(&std::fs::read(&patch_file).expect("saved")).expect("JSON");
    assert_eq!(patch["edits"].as_array().map(Vec::len), Some(2), "nudges in a row are one move: {patch}");
    assert_eq!(browser.complaints(), Vec::<String>::new());
    // The numbers of the page, all digits.
    let data = "JSON.parse(document.getElementById('data').textContent)";
    let state = browser.eval(&format!(
        "(() => {{ const D = {data}; const s = Review.evaluate(D.points, Review.replayed(D.points, {}, D.hand_variance_px2), null); \
         return {{ geotransform: Fit.geotransform(s.solution.similarity), rmse: s.solution.rmse, \
         rows: D.points.map((p, i) => s.rows[i] && [p.name, s.rows[i].e, s.rows[i].n]) }}; }})()",
        patch["edits"]
    ));
    assert_eq!(state["geotransform"], patch["shown"]["geotransform"]);

    let (json, patch_path) = (sample.path("e6.autoref.json"), patch_file.to_str().expect("plain").to_string());
    let replayed = autoref(&["solve", json.to_str().expect("plain"), "--patch", &patch_path, "--json", "--quiet"]);
    assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
    let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("one document");
    assert_eq!(replayed["patch"]["edits"], patch["edits"], "the audit trail is in the result");
    let warnings = replayed["warnings"].to_string();
    assert!(!warnings.contains("another transform") && !warnings.contains("made from"), "{warnings}");
    let close = |a: f64, b: f64, what: &str| assert!((a - b).abs() <= 1e-9, "{what}: {a} against {b}");
    for i in 0..6 {
        close(number(&replayed["geotransform"][i]), number(&state["geotransform"][i]), "geotransform");
    }
    close(number(&replayed["rmse_m"]), number(&state["rmse"]), "rmse");
    let rows =
        replayed["matches"].as_array().expect("rows").iter().chain(replayed["check_points"].as_array().expect("rows"));
    let mut compared = 0;
    for row in rows {
        let shown =
            state["rows"].as_array().expect("rows").iter().find(|r| r[0] == row["gcp"]).expect("the same points");
        close(number(&row["residual_e_m"]), number(&shown[1]), "dE");
        close(number(&row["residual_n_m"]), number(&shown[2]), "dN");
        compared += 1;
        assert_ne!(row["gcp"], wrong);
    }
    assert_eq!(compared, state["rows"].as_array().expect("rows").iter().filter(|r| !r.is_null()).count());
    assert!(number(&replayed["rmse_m"]) < number(&result["rmse_m"]), "without the blunder the fit is better");
    let nudged =
        replayed["matches"].as_array().expect("rows").iter().find(|r| r["gcp"] == other.as_str()).expect("kept");
    close(number(&nudged["x"]) - number(&result["matches"][0]["x"]), 0.3, "three nudges");
    assert_eq!(nudged["found_by"], "review");
}

#[test]
fn a_refused_run_is_reported_with_reason_and_pictures() {
    // Another site's list: nothing fits.
    let elsewhere = |list: &mut Vec<SynthGcp>| {
        for (i, gcp) in list.iter_mut().enumerate() {
            gcp.easting += 7.0 * (i * i % 11) as f64;
            gcp.northing -= 5.0 * (i * 7 % 13) as f64;
        }
    };
    let sample = Sample::new(|spec| spec.clutter = 20, elsewhere);
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let result = sample.json();
    assert!(result["files_written"].to_string().contains("e6.report.html"));
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    let head = browser.eval("document.getElementById('verdict').textContent");
    let head = head.as_str().expect("text");
    assert!(
        head.contains("Not georeferenced") && head.contains(result["reason"].as_str().expect("a reason")),
        "{head}"
    );
    assert!(
        count(&mut browser, "#cards .card svg image") >= 2,
        "pictures of the best partial pattern, or of candidates"
    );
    // Somebody who knows better may accept the marks, and gets a solution of his own.
    if result["best_pattern"].is_object() {
        tab_to_cards(&mut browser);
        let proposed = result["best_pattern"]["pairs"].as_array().expect("pairs").clone();
        for pair in &proposed {
            let gcp = pair[1].as_u64().expect("an index") as usize;
            browser.key("Home", false);
            focus(&mut browser, result["gcps"][gcp]["name"].as_str().expect("a name"));
            browser.key("a", false);
        }
        browser.key("s", false);
        let patch = browser.download("e6.patch.json");
        let args = [
            "solve",
            sample.path("e6.autoref.json").to_str().expect("plain"),
            "--patch",
            patch.to_str().expect("plain"),
            "--json",
            "--quiet",
        ]
        .map(str::to_string);
        let replayed = autoref(&args.iter().map(String::as_str).collect::<Vec<_>>());
        assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
        let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("one document");
        assert_eq!(replayed["matches"].as_array().map(Vec::len), Some(proposed.len()));
    }
}

#[test]
fn a_hundred_marks_make_a_page_below_three_megabytes_that_prints() {
    let sample = Sample::new(
        |spec| {
            spec.gcps = synth::random_gcps(100, 64.0, 49.0, 5);
            spec.size_px = Some((2200, 1700));
            spec.visible = Visible::All;
        },
        |_| {},
    );
    let output = sample.run(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let result = sample.json();
    assert!(result["matches"].as_array().map_or(0, Vec::len) >= 95);
    let bytes = std::fs::metadata(sample.path("e6.report.html")).expect("the report").len();
    eprintln!("{bytes} bytes; pictures {} s of {} s", result["timings"]["report_s"], result["elapsed_s"]);
    assert!(bytes < 3_000_000, "{bytes} bytes");
    let Some(mut browser) = Browser::start() else { return };
    browser.open(&sample.path("e6.report.html"));
    assert_eq!(browser.complaints(), Vec::<String>::new());
    let pdf = browser.pdf();
    assert!(pdf.starts_with(b"%PDF") && pdf.len() > 20_000, "{} bytes", pdf.len());
}

#[test]
fn without_a_report_nothing_of_it_is_written() {
    let sample = Sample::new(|_| {}, |_| {});
    std::fs::write(sample.path("e6.report.html"), "mine").expect("writable");
    let refused = sample.run(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr(&refused).contains("e6.report.html") && stderr(&refused).contains("--overwrite"),
        "{}",
        stderr(&refused)
    );
    assert_eq!(sample.run(&["--no-report"]).status.code(), Some(0));
    assert_eq!(std::fs::read_to_string(sample.path("e6.report.html")).expect("still there"), "mine");
}

#[test]
fn a_patch_that_does_not_fit_is_one_clear_line() {
    let sample = Sample::new(|_| {}, |_| {});
    assert_eq!(sample.run(&["--no-report"]).status.code(), Some(0));
    let result = sample.path("e6.autoref.json");
    let cases = [
        (
            r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"","edits":[{"gcp":"nobody","action":"reject"}]}"#,
            "nobody",
        ),
        (r#"{"schema":"autoref-stream-patch","schema_version":2,"for":"gcps","source":"","edits":[]}"#, "version 2"),
        (
            r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"fiducials","source":"","edits":[]}"#,
            "fiducial",
        ),
        ("[1, 2", "line 1"),
        (
            r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"other.autoref.json","edits":[],"shown":{"points":5,"rmse_m":0.1,"geotransform":[1,2,3,4,5,6]}}"#,
            "another transform",
        ),
    ];
    for (text, word) in cases {
        let patch = sample.path("p.json");
        std::fs::write(&patch, text).expect("writable");
        let output = autoref(&["solve", result.to_str().expect("plain"), "--patch", patch.to_str().expect("plain")]);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains(word) && message.trim_end().lines().count() == 1, "no `{word}` in: {message}");
    }
    let first = sample.json()["matches"][0]["gcp"].clone();
    let outside = format!(
        r#"{{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"","edits":[{{"gcp":{first},"action":"move","x":-3,"y":5}}]}}"#
    );
    std::fs::write(sample.path("p.json"), outside).expect("writable");
    let output =
        autoref(&["solve", result.to_str().expect("plain"), "--patch", sample.path("p.json").to_str().expect("plain")]);
    let message = stderr(&output);
    assert_eq!((output.status.code(), message.trim_end().lines().count()), (Some(2), 1), "{message}");
    assert!(message.contains("outside the image"), "{message}");
    let no_patch = autoref(&["solve", result.to_str().expect("plain")]);
    assert!(stderr(&no_patch).contains("--patch"), "{}", stderr(&no_patch));
}

#[test]
fn a_replay_delivers_in_the_crs_of_the_run() {
    let sample = Sample::new(|_| {}, |_| {});
    let ran = sample.run(&["--no-report", "--to-crs", "EPSG:32633", "--reproject", "after"]);
    assert_eq!(ran.status.code(), Some(0), "{}", stderr(&ran));
    let result = sample.json();
    assert_eq!(result["delivered"], true);
    let patch = sample.path("p.json");
    let first = result["matches"][0]["gcp"].as_str().expect("a name");
    let text = format!(
        r#"{{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"e6.autoref.json","edits":[{{"gcp":"{first}","action":"accept"}}]}}"#
    );
    std::fs::write(&patch, text).expect("writable");
    let json = sample.path("e6.autoref.json");
    let args = ["solve", json.to_str().expect("plain"), "--patch", patch.to_str().expect("plain"), "--json", "--quiet"];
    let replayed = autoref(&args);
    assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
    let replayed: Value = serde_json::from_slice(&replayed.stdout).expect("one document");
    assert_eq!(replayed["crs"], "EPSG:32633");
    let place = |result: &Value, x: f64, y: f64| {
        let g = |i: usize| number(&result["geotransform"][i]);
        (g(0) + g(1) * x + g(2) * y, g(3) + g(4) * x + g(5) * y)
    };
    for (x, y) in [(0.0, 0.0), (2300.0, 0.0), (1000.0, 1700.0)] {
        let (a, b) = (place(&result, x, y), place(&replayed, x, y));
        assert!((a.0 - b.0).hypot(a.1 - b.1) < 1e-5, "{a:?} against {b:?}");
    }
    let (a, b) = (number(&result["matches"][0]["easting"]), number(&replayed["matches"][0]["easting"]));
    assert!((a - b).abs() < 1e-3, "{a} against {b}");
    // Why points have no mark was seen in the image, which the replay does not look at.
    let reasons = |result: &Value| -> Vec<[String; 3]> {
        let said = |point: &Value| ["name", "reason", "detail"].map(|key| point[key].to_string());
        result["not_found"].as_array().into_iter().flatten().map(said).collect()
    };
    assert!(!reasons(&result).is_empty());
    assert_eq!(reasons(&result), reasons(&replayed));
}
