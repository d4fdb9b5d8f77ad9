//! A review by keyboard: what the page shows is what the replay of its patch gives.

use std::path::PathBuf;

use super::{EVIL, Sample, accessible, autoref, count, focus, number, stderr, tab_to_cards, with_a_wrong_mark};
use crate::browser::firefox::Firefox;
use crate::browser::{Browser, Page};
use autoref_synth::{SynthGcp, Visible};
use gdal::raster::Buffer;
use serde_json::Value;

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
    let wrong = sample.survey_off(4, 0.07);
    // Of two check points one is far off; one alone is held against nothing.
    let far = sample.survey_off(6, 0.12);
    let check = format!("{},{far}", sample.truth.visible().nth(7).expect("visible").name);
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
            rmse: s.fit.rmse, rows: D.points.map((p, i) => s.rows[i] && { name: p.name, ...s.rows[i] }).filter((r) => r) }; })()";
        let shown = browser.eval(shown);
        assert!(close(number(&shown["chosen"]), number(&result["chosen_model"]["rmse_m"])), "{shown}");
        assert!(close(number(&shown["left"]), number(&result["chosen_model"]["leave_one_out_rmse_m"])), "{shown}");
        assert!(close(number(&shown["rmse"]), number(&result["rmse_m"])), "{shown}");
        for row in matches.iter().chain(result["check_points"].as_array().expect("rows")) {
            let on_page =
                shown["rows"].as_array().expect("rows").iter().find(|r| r["name"] == row["gcp"]).expect("there");
            let both = [
                ("e", "residual_e_m"),
                ("n", "residual_n_m"),
                ("redundancy", "redundancy"),
                ("detectable", "detectable_blunder_m"),
            ];
            for (shown, written) in both.map(|(shown, written)| (&on_page[shown], &row[written])) {
                assert!(shown.is_null() == written.is_null(), "{on_page} against {row}");
                assert!(shown.is_null() || close(number(shown), number(written)), "{on_page} against {row}");
            }
            assert_eq!(on_page["outlier"], row["outlier"], "{on_page} against {row}");
            assert_eq!(row["outlier"], row["gcp"] == wrong.as_str() || row["gcp"] == far.as_str(), "{row}");
        }
        let look_at = format!("look at {wrong}, {far}: mark or survey may be wrong");
        assert_eq!(result["warnings"].to_string().matches(&look_at).count(), 1, "{}", result["warnings"]);
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
    // What the run said of its own fit is not said of another.
    let said = "[document.getElementById('verdict').textContent.includes('The replay judges this fit'), \
                [...document.querySelectorAll('.of-run')].some(p => p.offsetHeight > 0)]";
    assert_eq!(browser.eval(said), serde_json::json!([true, true]));
    browser.key("u", false);
    assert_eq!(browser.eval("document.querySelector('#figures').textContent"), first, "undo");
    assert_eq!(browser.eval(said), serde_json::json!([false, false]));
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
