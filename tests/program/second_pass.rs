//! A paint that the profile does not know well: poorly seen at first, better when the marks have taught it.

use std::process::Command;

use autoref_synth::{self as synth, MarkSize, MarkStyle, SynthSpec};
use serde_json::Value;

fn run(folder: &std::path::Path, extra: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .arg(folder.join("a.tif"))
        .arg("--gcps")
        .arg(folder.join("a.geojson"))
        .args(["--json", "--overwrite"])
        .args(extra)
        .output()
        .expect("the program starts");
    serde_json::from_slice(&output.stdout)
        .unwrap_or_else(|e| panic!("{e}: {}", String::from_utf8_lossy(&output.stderr)))
}

fn sample(folder: &std::path::Path) {
    let spec = SynthSpec {
        gcps: synth::random_gcps(12, 40.0, 30.0, 5),
        size_px: Some((1301, 1001)),
        clutter: 20,
        mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
        ..SynthSpec::default()
    };
    synth::write(&spec, &folder.join("a.tif")).expect("a sample");
    synth::write_gcp_geojson(&folder.join("a.geojson"), &spec.gcps, Some(32632)).expect("a list");
}

#[test]
fn a_second_pass_is_reported_and_never_worse() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    sample(folder.path());
    let first = run(folder.path(), &[]);
    assert_eq!(first["status"], "solved", "{}", first["reason"]);
    assert!(first.get("second_pass").is_none(), "not asked for");
    let second = run(folder.path(), &["--second-pass"]);
    assert_eq!(second["status"], "solved");
    let report = &second["second_pass"];
    assert_eq!(report["taught_by"], "matched marks");
    let matched = |v: &Value| v["matches"].as_array().map_or(0, Vec::len);
    assert!(matched(&second) >= matched(&first));
    // Orange is what it learned.
    let colour: Vec<f64> = report["mean_srgb"].as_array().expect("three").iter().filter_map(Value::as_f64).collect();
    assert!(colour[0] > 0.6 && colour[2] < 0.4, "{colour:?}");
}

/// Marks of 14 px. What the user forbids is not taken by the search over colours either; the refusal names it.
#[test]
fn a_size_and_a_rule_hold_in_the_search_over_colours_too() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    sample(folder.path());
    for forbidding in [["--mark-size", "100"], ["--gate", "area > 5000"]] {
        let result = run(folder.path(), &[&["--paint", "#FF6E14", "--no-report"], &forbidding[..]].concat());
        assert_eq!(result["status"], "refused", "{forbidding:?}");
        let advice = result["advice"].as_array().expect("advice");
        let said = |line: &Value| line.as_str().is_some_and(|line| line.contains(forbidding[0]));
        assert!(advice.iter().any(|line| said(line) && line.to_string().contains("left them out")), "{advice:?}");
        let left_out = &result["colour_search"]["left_out"][0];
        assert!(left_out["objects"].as_u64().is_some_and(|n| n >= 8), "{left_out}");
    }
}

/// What no evidence would satisfy stays refused; the second pass runs by itself and says what it did.
#[test]
fn a_refusal_is_followed_by_a_second_pass() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    sample(folder.path());
    let result = run(folder.path(), &["--profile", "orange", "--max-false-alarms", "1e-300"]);
    assert_eq!(result["status"], "refused");
    let report = &result["second_pass"];
    assert_eq!(report["adopted"], false, "{report}");
    assert!(report["marks"].as_u64().is_some_and(|n| n >= 3), "{report}");
}

/// Paint worn until hardly a third of it is left: the shipped profile finds too few marks for a pattern, they teach
/// their colours, and the second scan finds the rest.
#[test]
fn a_worn_paint_is_refused_and_then_solved() {
    for (seed, fading) in [(1, 0.7), (1, 0.74)] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let spec = SynthSpec {
            gcps: synth::random_gcps(12, 40.0, 30.0, seed),
            size_px: Some((1301, 1001)),
            clutter: 10,
            mark: MarkStyle { size: MarkSize::Px(14.0), fading, ..MarkStyle::default() },
            seed,
            ..SynthSpec::default()
        };
        let truth = synth::write(&spec, &folder.path().join("a.tif")).expect("a sample");
        synth::write_gcp_geojson(&folder.path().join("a.geojson"), &spec.gcps, Some(32632)).expect("a list");
        let result = run(folder.path(), &[]);
        let report = &result["second_pass"];
        println!("seed {seed}: {report}");
        assert_eq!(result["status"], "solved", "{}", result["reason"]);
        assert_eq!((&report["adopted"], &report["matched_before"]), (&true.into(), &0.into()), "{report}");
        let rows = result["matches"].as_array().expect("a list");
        assert!(rows.len() >= 5 && report["matched_after"] == rows.len(), "{report}");
        assert!(report["candidates_after"].as_u64() > report["candidates_before"].as_u64(), "{report}");
        for row in rows {
            let gcp = truth.gcps.iter().find(|g| g.name == row["gcp"]).expect("a name of the list");
            let off = (row["x"].as_f64().expect("x") - gcp.x).hypot(row["y"].as_f64().expect("y") - gcp.y);
            // The mark, and not a spot beside it.
            assert!(off < 3.0, "{} is {off:.2} px off", gcp.name);
        }
    }
}
