//! A paint that the profile does not know well: poorly seen at first, better when the marks have taught it.

use std::process::Command;

use autoref_stream::synth::{self, MarkSize, MarkStyle, SynthSpec};
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

/// With a profile that takes only a corner of the paint's colours nothing is solved; the second pass runs by itself and
/// says what it did.
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
