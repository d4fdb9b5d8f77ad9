//! What is written as a result is what `docs/result.schema.json` says, by another program's judgement.

use std::path::{Path, PathBuf};
use std::process::Command;

use autoref_synth::{self as synth, MarkSize, MarkStyle, SynthSpec, Visible};
use serde_json::Value;

use crate::common::python::python_with;

fn schema() -> PathBuf {
    crate::common::root().join("docs/result.schema.json")
}

/// Runs the program and returns the document that it printed.
fn document(folder: &Path, args: &[&str], exit: i32) -> Value {
    let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
    let output = command.args(args).arg("--json").current_dir(folder).output().expect("the program starts");
    assert_eq!(output.status.code(), Some(exit), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("one document")
}

/// Results of every kind: solved, refused, with check points, with another transform, with heights, from candidates,
/// replayed.
fn documents(folder: &Path) -> Vec<Value> {
    let spec = SynthSpec {
        gcps: synth::random_gcps(12, 22.0, 16.0, 3),
        size_px: Some((800, 600)),
        rotation_deg: 5.0,
        visible: Visible::Random(9),
        mark: MarkStyle { size: MarkSize::Px(12.0), ..MarkStyle::default() },
        ..SynthSpec::default()
    };
    synth::write(&spec, &folder.join("e6.tif")).expect("a sample");
    synth::write_gcp_geojson(&folder.join("e6.geojson"), &spec.gcps, Some(32632)).expect("a list");
    let job = ["e6.tif", "--gcps", "e6.geojson", "--quiet", "--overwrite", "--no-report"];
    let with = |extra: &[&'static str]| [&job[..], extra].concat();
    let mut all = vec![
        document(folder, &with(&["--gsd", "0.2", "--second-pass=never"]), 1),
        document(folder, &with(&["--model", "affine", "--second-pass"]), 0),
        document(folder, &with(&["--solver", "kraus", "--model", "7-parameter", "--to-crs", "EPSG:25832"]), 0),
    ];
    let solved = document(folder, &with(&["--check", "G1", "--check", "G2", "--nssda"]), 0);
    let matched = solved["matches"].as_array().expect("rows");
    let first = matched[0]["gcp"].as_str().expect("a name");
    let patch = serde_json::json!({
        "schema": "autoref-stream-patch", "schema_version": 1, "for": "gcps", "source": "e6.autoref.json",
        "edits": [{"gcp": first, "action": "reject", "note": "half covered"}],
    });
    std::fs::write(folder.join("e6.patch.json"), patch.to_string()).expect("written");
    all.push(document(folder, &["solve", "e6.autoref.json", "--patch", "e6.patch.json", "--quiet"], 0));
    let mut table = String::from("x,y,elevation\n");
    for row in matched {
        let height = row["height"].as_f64().expect("a height") + 0.02;
        table += &format!("{},{},{height}\n", row["x"], row["y"]);
    }
    std::fs::write(folder.join("marks.csv"), table).expect("written");
    let of_list = document(folder, &["solve", "marks.csv", "--gcps", "e6.geojson", "--quiet"], 0);
    assert!(of_list["heights"].is_object(), "{}", of_list["heights"]);
    all.extend([solved, of_list]);
    all
}

#[test]
fn every_kind_of_result_agrees_with_the_published_schema() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let all = documents(folder.path());
    let rules: Value = serde_json::from_slice(&std::fs::read(schema()).expect("published")).expect("JSON");
    let published = rules["properties"].as_object().expect("properties");
    for document in &all {
        let written = document.as_object().expect("an object");
        for key in written.keys() {
            assert!(published.contains_key(key), "`{key}` is written and not in the schema");
        }
        for key in rules["required"].as_array().expect("a list") {
            assert!(written.contains_key(key.as_str().expect("a name")), "{key} is required and not written");
        }
    }
    let Some(python) = python_with("jsonschema") else { return };
    let write = |name: String, document: &Value| {
        let path = folder.path().join(name);
        std::fs::write(&path, document.to_string()).expect("written");
        path
    };
    let judge = |paths: &[PathBuf]| {
        let script = crate::common::root().join("tests/python/check_schema.py");
        Command::new(&python).arg(script).arg(schema()).args(paths).output().expect("Python starts")
    };
    let paths: Vec<PathBuf> = all.iter().enumerate().map(|(i, d)| write(format!("{i}.json"), d)).collect();
    let said = judge(&paths);
    assert!(said.status.success(), "{}", String::from_utf8_lossy(&said.stdout));
    // A document that contradicts itself does not agree.
    for (key, value) in [("status", "refused".into()), ("rmse_m", Value::Null), ("unheard_of", 1.into())] {
        let mut broken = all.last().expect("solved").clone();
        broken[key] = value;
        assert!(!judge(&[write("broken.json".into(), &broken)]).status.success(), "{key}");
    }
}
