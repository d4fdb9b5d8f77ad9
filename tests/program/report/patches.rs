//! Patches without a page: refused in one line, or replayed in the CRS of the run.

use super::{Sample, autoref, number, stderr};
use serde_json::Value;

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
