//! All solvers on one set of points, from the command line; `gcps convert` as a command.

use std::path::Path;
use std::process::{Command, Output};

use crate::common::{Random, data};
use autoref_raster::random::SplitMix64;
use serde_json::Value;

fn program(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(arguments).output().expect("it runs")
}

fn document(arguments: &[&str]) -> Value {
    let finished = program(arguments);
    assert_eq!(finished.status.code(), Some(0), "{}", String::from_utf8_lossy(&finished.stderr));
    serde_json::from_slice(&finished.stdout).expect("one document")
}

fn found<'a>(document: &'a Value, space: &str, solver: &str, units: &str) -> &'a Value {
    let list = document["solvers"].as_array().expect("a list");
    list.iter()
        .find(|s| s["space"] == space && s["solver"] == solver && s["units"] == units)
        .unwrap_or_else(|| panic!("no {space} {solver} {units}"))
}

fn near(value: &Value, expected: f64, tolerance: f64) {
    let value = value.as_f64().expect("a number");
    assert!((value - expected).abs() <= tolerance, "{value}, expected {expected}");
}

/// Equations B.23 to B.25 and Table B.23 by the command: units mixed, symmetric scale, fourteen points.
#[test]
fn the_thesiss_tables_by_one_command() {
    let Some(table) = data("thesis/b8_cm.csv") else { return };
    let document = document(&["compare-solvers", table.to_str().expect("UTF-8"), "--json"]);
    assert_eq!((&document["points"], &document["points_in_space"]), (&Value::from(14), &Value::from(14)));
    for solver in ["Horn", "HornHilden", "UmeyamaHornScale"] {
        let mixed = found(&document, "space", solver, "mixed");
        near(&mixed["scale"], 0.032_018_454_468_9, 1e-12);
        near(&mixed["rmse_m"], 0.847_475_468_634_218, 1e-8);
        near(&mixed["rmse_h_m"], 0.844_255_142_341_283, 1e-8);
    }
    near(&found(&document, "space", "Umeyama", "mixed")["rmse_m"], 0.847_466, 1e-6);
    near(&found(&document, "plane", "Similarity", "pixels to metres")["rmse_m"], 0.06410, 5e-6);
    near(&found(&document, "plane", "Umeyama", "pixels to metres")["rmse_m"], 0.06410, 5e-6);
    let metric = found(&document, "space", "Umeyama", "metres");
    for turn in ["roll_deg", "pitch_deg", "yaw_deg"] {
        assert!(metric[turn].as_f64().expect("a number").abs() < 2.0, "{metric}");
    }
    let plane = &found(&document, "plane", "Similarity", "pixels to metres")["analysis"];
    assert_eq!(plane["correlations"]["magnitude_distance_2d"]["n"], 14);
    let p = plane["easting"]["normality"]["p_value"].as_f64().expect("a number");
    assert!((0.0..=1.0).contains(&p), "{p}");
    let path = table.to_str().expect("UTF-8");
    let cut = self::document(&["compare-solvers", path, "--json", "--tail-cut", "0.1"]);
    let cut = &found(&cut, "plane", "Similarity", "pixels to metres")["analysis"]["correlations"];
    assert_eq!(
        (&cut["magnitude_distance_2d"]["n"], &cut["direction_outward"]["n"]),
        (&Value::from(12), &Value::from(14))
    );
    let (least, most) = (metric["min_residual_m"].as_f64(), metric["max_residual_m"].as_f64());
    assert!(least < most, "{metric}");
}

#[test]
fn points_known_only_in_plan_or_height_are_used_for_what_they_know() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let table = folder.path().join("matched.csv");
    let mut text = String::from("name,x,y,elevation,easting,northing,height\n");
    for (i, (x, y)) in [(0, 0), (4000, 100), (200, 3000), (3900, 3100), (2000, 1500), (1000, 2500)].iter().enumerate() {
        let z = 80.0 + f64::from(i as u32 % 3);
        let (e, n) = (570_000.0 + 0.03 * f64::from(*x), 7_032_000.0 - 0.03 * f64::from(*y));
        let (plan, height) = match i {
            4 => (format!("{e},{n}"), String::new()),
            5 => (",".to_owned(), (z + 0.5).to_string()),
            _ => (format!("{e},{n}"), (z + 0.5).to_string()),
        };
        text.push_str(&format!("P{i},{x},{y},{z},{plan},{height}\n"));
    }
    std::fs::write(&table, text).expect("writable");
    let document = document(&["compare-solvers", table.to_str().expect("UTF-8"), "--json"]);
    let partial = found(&document, "space", "KrausPartial", "metres");
    assert_eq!((&partial["plan_only"], &partial["height_only"]), (&Value::from(1), &Value::from(1)));
    near(&partial["rmse_m"], 0.0, 1e-6);
    near(&partial["scale"], 1.0, 1e-9);
    assert_eq!(partial["residuals"][5]["e_m"], Value::Null);
}

/// A table that counts y upwards is a mirror image to a rotation; German spreadsheets write what they write.
#[test]
fn a_mirrored_table_is_called_so_and_spreadsheets_are_read() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let table = folder.path().join("table.csv");
    let solved = |sign: f64| {
        let mut text = String::from("sep=;\nname;x;y;easting;northing\n");
        for (i, (x, y)) in [(10.5, 20.0), (900.0, 40.0), (450.0, 700.25), (80.0, 610.0)].into_iter().enumerate() {
            let (e, n) = (1000.0 + 0.5 * x, 5000.0 - sign * 0.5 * y);
            text.push_str(&format!("P{i};{x};{y};{e};{n}\n").replace('.', ","));
        }
        std::fs::write(&table, text).expect("writable");
        document(&["compare-solvers", table.to_str().expect("UTF-8"), "--json"])
    };
    let right = solved(1.0);
    near(&found(&right, "plane", "Horn", "pixels to metres")["scale"], 0.5, 1e-9);
    let mirrored = solved(-1.0);
    for solver in ["Horn", "HornHilden", "Umeyama", "UmeyamaHornScale", "Kraus"] {
        let told = found(&mirrored, "plane", solver, "pixels to metres");
        assert_eq!(told["reason"], "the points are a mirror image", "{solver}: {told}");
    }
}

/// Old marks at all points and new ones at a few, 1.5 m beside: what is written is told apart from what would be
/// believed alone. A row that fits its own marks turned end for end is no second set of marks.
#[test]
fn a_second_set_of_marks_is_mentioned_and_a_row_turned_round_is_not() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let warned = |points: &[(f64, f64)], marks: &[(f64, f64)]| {
        let mut candidates = String::from("x,y\n");
        marks.iter().for_each(|(e, n)| candidates.push_str(&format!("{},{}\n", 20.0 * e + 100.0, 3000.0 - 20.0 * n)));
        let mut list = String::from("name,easting,northing\n");
        let row = |(i, (e, n)): (usize, &(f64, f64))| format!("P{i},{},{}\n", 570_000.0 + e, 7_032_000.0 + n);
        list.extend(points.iter().enumerate().map(row));
        std::fs::write(at("c.csv"), candidates).expect("writable");
        std::fs::write(at("l.csv"), list).expect("writable");
        let some = ["solve", &at("c.csv"), "--gcps", &at("l.csv"), "--crs", "EPSG:25832", "--gsd", "0.05"];
        let document = document(&[&some[..], &["--size", "3000,3200", "--json"]].concat());
        assert_eq!(document["status"], "solved", "{document}");
        (document["warnings"].to_string(), document["runner_up"].clone())
    };
    let mut random = SplitMix64(12);
    let mut anywhere = |_| (130.0 * random.unit(), 130.0 * random.unit());
    let points: Vec<(f64, f64)> = (0..12).map(&mut anywhere).collect();
    let new = points.iter().step_by(3).chain(&points[1..2]).map(|(e, n)| (e + 1.2, n + 0.9));
    let marks: Vec<(f64, f64)> = points.iter().copied().chain(new).collect();
    let (warnings, other) = warned(&points, &marks);
    assert!(warnings.contains("5 points of this list fit other marks"), "{warnings} {other}");
    let row = (0..9).map(|i| (10.0 * f64::from(i), 5.0));
    let points: Vec<(f64, f64)> = row.chain((0..14).map(anywhere)).collect();
    let (warnings, other) = warned(&points, &points);
    assert!(other["log10_false_alarms"].as_f64().is_some_and(|log10| log10 < -4.0), "{other}");
    assert!(!warnings.contains("fit other marks"), "{warnings}");
}

#[test]
fn bad_tables_and_lists_get_one_line() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(path("a.csv"), "name,x,y,easting,northing\nA,1,2,570000,7032000\nB,1,z,570100,7032000\n")
        .expect("writable");
    std::fs::write(path("b.csv"), "name,x,y\nA,1,2\n").expect("writable");
    std::fs::write(path("c.csv"), "name,left,right\nA,1,2\n").expect("writable");
    for (arguments, words) in [
        (vec!["compare-solvers".to_owned(), path("a.csv")], ["row 3", "`z`"]),
        (vec!["compare-solvers".to_owned(), path("b.csv")], ["row 1", "easting"]),
        (vec!["gcps".into(), "convert".into(), path("c.csv"), "-o".into(), path("b.kof")], ["c.csv", "easting"]),
        (vec!["gcps".into(), "convert".into(), path("a.csv"), "-o".into(), path("b.none")], ["b.none", "--to"]),
    ] {
        let finished = program(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&finished.stderr);
        assert_eq!(finished.status.code(), Some(2), "{said}");
        assert!(words.iter().all(|w| said.contains(w)), "{said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    }
}

#[test]
fn a_list_is_converted_and_its_losses_are_listed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(
        path("a.kof"),
        " 05 P1                   7032516.804  570406.861   80.318\n 05 P2                   7032503.482  570413.367\n",
    )
    .expect("writable");
    let (input, output) = (path("a.kof"), path("a.geojson"));
    let said = document(&["gcps", "convert", &input, "-o", &output, "--crs", "EPSG:25832", "--json"]);
    assert_eq!((&said["lost"], &said["points"]), (&Value::Array(Vec::new()), &Value::from(2)));
    assert_eq!((&said["from"], &said["to"]), (&Value::from("kof"), &Value::from("geojson")));
    assert!(Path::new(&output).exists());
    let again = program(&["gcps", "convert", &input, "-o", &output]);
    assert_eq!(again.status.code(), Some(2), "an output that exists");
    let back = document(&["gcps", "convert", &output, "-o", &path("b.kof"), "--json"]);
    assert!(back["lost"].to_string().contains("crs EPSG:25832"), "{back}");
    let text = program(&["gcps", "convert", &output, "-o", &path("c.kof")]);
    assert!(String::from_utf8_lossy(&text.stdout).contains("Lost: crs EPSG:25832"));
}

/// The expected coordinates are pyproj's.
#[test]
fn a_list_is_brought_into_another_crs() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    std::fs::write(path("a.csv"), "name,easting,northing\nP1,570406.861,7032516.804\nP2,570413.367,7032503.482\n")
        .expect("writable");
    let (input, output) = (path("a.csv"), path("b.geojson"));
    let said = document(&[
        "gcps",
        "convert",
        &input,
        "-o",
        &output,
        "--crs",
        "EPSG:25832",
        "--to-crs",
        "EPSG:25833",
        "--json",
    ]);
    assert_eq!((&said["crs"], &said["lost"]), (&Value::from("EPSG:25833"), &Value::Array(Vec::new())));
    let written: Value = serde_json::from_slice(&std::fs::read(&output).expect("an output")).expect("JSON");
    assert_eq!(written["features"][0]["geometry"]["coordinates"], serde_json::json!([270957.0477, 7039952.2885]));
    let without = program(&["gcps", "convert", &input, "-o", &path("c.csv"), "--to-crs", "EPSG:25833"]);
    let line = String::from_utf8_lossy(&without.stderr);
    assert!(without.status.code() == Some(2) && line.contains("a.csv") && line.contains("--crs"), "{line}");
    assert!(!Path::new(&path("c.csv")).exists());
}

/// `--refine never` keeps the first match; every `--solver` writes a similarity of its own.
#[test]
fn the_first_match_stands_and_solvers_differ_by_their_scale_only() {
    use autoref_synth::{self as synth, MarkSize, MarkStyle, SynthSpec, Visible};
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let spec = SynthSpec {
        gcps: synth::random_gcps(9, 40.0, 30.0, 5),
        size_px: Some((1400, 1100)),
        visible: Visible::All,
        mark: MarkStyle { size: MarkSize::Px(14.0), ..MarkStyle::default() },
        ..SynthSpec::default()
    };
    synth::write(&spec, Path::new(&path("a.tif"))).expect("a sample");
    synth::write_gcp_geojson(Path::new(&path("a.geojson")), &spec.gcps, Some(25832)).expect("a list");
    let (image, list) = (path("a.tif"), path("a.geojson"));
    let run = |extra: &[&str]| {
        let fixed = [&image, "--gcps", &list, "--overwrite", "--no-report", "--json"];
        document(&fixed.iter().copied().chain(extra.iter().copied()).collect::<Vec<_>>())
    };
    let never = run(&["--refine", "never"]);
    let looks = never["matches"].as_array().expect("matches").iter().map(|m| m["found_by"].clone());
    assert!(looks.into_iter().all(|look| look == "scan"), "{never}");
    let plain = run(&[]);
    for solver in ["horn", "horn-hilden", "umeyama", "umeyama-horn-scale", "kraus"] {
        let solved = run(&["--solver", solver]);
        assert_eq!(solved["chosen_model"]["model"], "similarity");
        near(&solved["scale_m_per_px"], plain["scale_m_per_px"].as_f64().expect("a scale"), 1e-5);
        let residuals = solved["matches"].as_array().expect("matches");
        let squares: f64 = residuals
            .iter()
            .map(|m| m["residual_e_m"].as_f64().expect("e").powi(2) + m["residual_n_m"].as_f64().expect("n").powi(2))
            .sum();
        near(&solved["rmse_m"], (squares / residuals.len() as f64).sqrt(), 1e-9);
        // What is stated is of what is written.
        let left_out = residuals.iter().map(|m| m["leave_one_out_m"].as_f64().expect("one can be left out").powi(2));
        let left_out_m = (left_out.sum::<f64>() / residuals.len() as f64).sqrt();
        near(&solved["accuracy"]["figures"]["leave_one_out_m"], left_out_m, 1e-9);
        assert!(left_out_m > solved["rmse_m"].as_f64().expect("a number"), "{solver}");
    }
    let compared = document(&["compare-solvers", &image, "--gcps", &list, "--json"]);
    near(
        &found(&compared, "plane", "Similarity", "pixels to metres")["scale"],
        plain["scale_m_per_px"].as_f64().expect("a scale"),
        1e-9,
    );
    let again = document(&["compare-solvers", &path("a.autoref.json"), "--json"]);
    assert_eq!(again["from"], "result");
}

/// The tables of docs/thesis-comparison.md from the points that the thesis prints; expected by an independent
/// computation (numpy's singular values).
#[test]
fn tables_b12_to_b29_from_the_printed_points() {
    // Table, points, RMSE by the symmetric scale and by Umeyama's, height, least and largest residual.
    let rows = [
        (4, 20, 2.750_045, 2.749_819, 2.748_188, ("P5", 0.614_138), ("P7", 5.583_857)),
        (5, 20, 2.749_881, 2.749_655, 2.748_016, ("P5", 0.608_167), ("P7", 5.584_307)),
        (6, 17, 3.491_746, 3.491_270, 2.754_056, ("P16", 1.528_529), ("P7", 6.529_100)),
        (7, 20, 2.749_881, 2.749_655, 2.748_016, ("P5", 0.608_167), ("P7", 5.584_307)),
        (8, 14, 0.847_475, 0.847_466, 0.844_255, ("P13", 0.121_426), ("NEW1", 2.024_598)),
        (9, 14, 0.847_475, 0.847_466, 0.844_255, ("P13", 0.121_426), ("NEW1", 2.024_598)),
        (10, 7, 2.248_088, 2.247_771, 2.135_586, ("P9", 0.443_646), ("P10", 3.639_065)),
        (11, 14, 0.847_475, 0.847_466, 0.844_255, ("P13", 0.121_426), ("NEW1", 2.024_598)),
    ];
    for (table, points, symmetric, least_squares, height, least, most) in rows {
        let Some(path) = data(&format!("thesis/b{table}_cm.csv")) else { return };
        let document = document(&["compare-solvers", path.to_str().expect("UTF-8"), "--json"]);
        let horn = found(&document, "space", "HornHilden", "mixed");
        assert_eq!(horn["points"], points);
        near(&horn["rmse_m"], symmetric, 1e-6);
        near(&horn["rmse_h_m"], height, 1e-6);
        // Both take the symmetric scale, and their rotations are one.
        near(&found(&document, "space", "Horn", "mixed")["rmse_m"], symmetric, 1e-6);
        near(&found(&document, "space", "Umeyama", "mixed")["rmse_m"], least_squares, 1e-6);
        near(&found(&document, "space", "Kraus", "mixed")["rmse_m"], least_squares, 1e-6);
        near(&horn["min_residual_m"], least.1, 1e-6);
        near(&horn["max_residual_m"], most.1, 1e-6);
        let length = |gcp: &str| {
            let rows = horn["residuals"].as_array().expect("residuals");
            rows.iter().find(|r| r["gcp"] == gcp).and_then(|r| r["length_m"].as_f64()).expect("the point")
        };
        assert!((length(least.0) - least.1).abs() < 1e-6 && (length(most.0) - most.1).abs() < 1e-6, "B.{table}");
    }
}

/// The thesis's way of matching, its picture and its thresholds.
#[test]
fn patterns_are_shown_and_thresholds_tried() {
    let Some(tables) = crate::common::data("thesis") else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (candidates, gcps) = (text(&tables.join("b3_candidates.csv")), text(&tables.join("b1_lerkendal_gcps.csv")));
    let picture = text(&folder.path().join("patterns.svg"));
    let shown = document(&[
        "patterns",
        &candidates,
        "--gcps",
        &gcps,
        "--gsd",
        "0.032",
        "--tpp-heights",
        "-o",
        &picture,
        "--json",
    ]);
    assert_eq!((shown["status"].as_str(), shown["matched"].as_array().map(Vec::len)), (Some("solved"), Some(14)));
    let agree = shown["anchors"]["others_that_agree"].as_u64().expect("a number");
    let drawn = std::fs::read_to_string(&picture).expect("written");
    // A cross for every other GCP and one in the key; a line for every pair that agrees.
    assert_eq!(drawn.matches("stroke=\"#d55e00\"").count(), 20);
    assert_eq!(drawn.matches("stroke=\"#000\"").count() as u64, agree);
    let mut reader = quick_xml::Reader::from_str(&drawn);
    while !matches!(reader.read_event().expect("well-formed"), quick_xml::events::Event::Eof) {}
    let tried = document(&["patterns", &candidates, "--gcps", &gcps, "--thresholds", "--json"]);
    let rows = tried["thresholds"].as_array().expect("a list");
    assert_eq!(rows.len(), 36);
    let of = |radius: f64, angle: f64| {
        let row = rows.iter().find(|r| r["radius"] == radius && r["angle_rad"] == angle).expect("tried");
        row["matched"].as_u64().expect("a number")
    };
    assert_eq!(of(0.05, 0.05), 14);
    // The table of docs/thesis-comparison.md.
    let agree: Vec<u64> = rows.iter().map(|row| row["agree"].as_u64().expect("a number")).collect();
    let table = [
        [7, 7, 7, 7, 7, 8],
        [12, 12, 12, 12, 12, 12],
        [14, 14, 14, 14, 14, 15],
        [14, 15, 15, 15, 15, 15],
        [14, 15, 15, 15, 15, 15],
        [14, 15, 15, 15, 15, 17],
    ];
    assert_eq!(agree, table.as_flattened());
    let refused = |more: &[&str], words: &[&str]| {
        let all = [&["patterns", candidates.as_str(), "--gcps", gcps.as_str()], more].concat();
        let output = program(&all);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.trim_end().lines().count() == 1 && words.iter().all(|w| said.contains(w)), "{said}");
    };
    refused(&["--tpp-heights"], &["--gsd"]);
    refused(&["--tpp-anchor", "294"], &["b3_candidates.csv", "294"]);
    refused(&["--tpp-radius", "0"], &["--tpp-radius", "positive"]);
    refused(&["--max-false-alarms", "2"], &["--max-false-alarms"]);
    refused(&["-o", &picture], &["patterns.svg", "--overwrite"]);
    refused(&["-o", &gcps, "--overwrite"], &["b1_lerkendal_gcps.csv"]);
}

/// Ten marks in the image, each moved by `moved`, and the list of what they are; a true scale of 50 mm.
fn verdict(moved: impl Fn(f64, f64) -> [f64; 2]) -> (String, Value) {
    verdict_by(&[], moved)
}

fn verdict_by(more: &[&str], moved: impl Fn(f64, f64) -> [f64; 2]) -> (String, Value) {
    let folder = tempfile::tempdir().expect("a folder");
    let (mut marks, mut list) = ("x,y\n".to_string(), "name,easting,northing\n".to_string());
    let mut random = Random::new(7);
    for i in 0..10 {
        let (x, y) = (random.uniform(100.0, 4100.0), random.uniform(100.0, 3100.0));
        let [dx, dy] = moved(x, y);
        marks += &format!("{:.3},{:.3}\n", x + dx, y + dy);
        list += &format!("P{i},{:.4},{:.4}\n", 600_000.0 + 0.05 * x, 5_800_000.0 - 0.05 * y);
    }
    let path = |name: &str, text: &str| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).expect("writable");
        path.to_str().expect("plain").to_string()
    };
    let (marks, list) = (path("marks.csv", &marks), path("list.csv", &list));
    let out = path("o.json", "");
    let arguments = ["solve", &marks, "--gcps", &list, "-o", &out, "--overwrite", "--gsd", "0.05"];
    let finished = program(&[&arguments[..], more].concat());
    assert_eq!(finished.status.code(), Some(0), "{}", String::from_utf8_lossy(&finished.stderr));
    let said = [finished.stdout, finished.stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    let line = said.lines().find(|line| line.starts_with("Verdict")).expect("a verdict").to_string();
    (line, serde_json::from_str(&std::fs::read_to_string(out).expect("written")).expect("JSON"))
}

#[test]
fn a_verdict_says_when_points_do_not_fit_as_those_of_an_orthophoto() {
    let wiggle = |x: f64, y: f64, px: f64| [px * (x * 0.37 + y).sin(), px * (y * 0.53 - x).cos()];
    let told = |result: &Value, words: &str| {
        result["warnings"].as_array().expect("warnings").iter().any(|w| w.as_str().is_some_and(|w| w.contains(words)))
    };
    let (line, result) = verdict(|x, y| wiggle(x, y, 0.1));
    assert!(line.contains("agree with each other") && !told(&result, "residuals"), "{line}");
    let (line, result) = verdict(|x, y| [wiggle(x, y, 0.1)[0], 0.0015 * y]);
    assert!(line.contains("stretched") && told(&result, "--model affine"), "{line}");
    let (line, result) = verdict(|x, y| [0.1 * (x * 0.37 + y).sin(), 1.5e-6 * (y - 1000.0) * (y - 1000.0)]);
    assert!(line.contains("the image is bent") && told(&result, "Expected errors count the bend"), "{line}");
    let (line, result) = verdict(|x, y| wiggle(x, y, 3.0));
    assert!(line.contains("fit badly") && told(&result, "parts of marks"), "{line}");
    // What is written is judged, whatever is reported beside it: a projective transform is not.
    for (model, words) in [("projective", "stretched"), ("affine", "agree with each other")] {
        let (line, _) = verdict_by(&["--model", model], |x, y| [wiggle(x, y, 0.1)[0], 0.0015 * y]);
        assert!(line.contains(words), "{model}: {line}");
    }
    let (line, _) = verdict_by(&["--model", "affine"], |x, y| wiggle(x, y, 3.0));
    assert!(line.contains("fit badly"), "{line}");
    // Points that all fit to hundredths of a pixel are right, though one fits worse than the others.
    let drawn = std::cell::Cell::new(0);
    let (line, _) = verdict(|x, y| {
        drawn.set(drawn.get() + 1);
        wiggle(x, y, if drawn.get() == 4 { 0.015 } else { 0.001 })
    });
    assert!(line.contains("agree with each other"), "{line}");
}

/// A lens bends by the cube of the distance from the image's middle: what leaves tenths of a pixel between marks near
/// the middle takes corners many pixels away. Whoever states the size has a middle, also where the marks have another.
#[test]
fn a_bend_of_tenths_is_told_by_what_it_does_to_the_corners() {
    // Marks lie in columns 100 to 4100 and rows 100 to 3100; the corner off most is that at (6000, 4400).
    let lens = |k: f64| {
        move |x: f64, y: f64| {
            let [u, v] = [(x - 3000.0) / 3000.0, (y - 2200.0) / 3000.0];
            let wiggle = [0.02 * (x * 0.37 + y).sin(), 0.02 * (y * 0.53 - x).cos()];
            [k * u * (u * u + v * v) + wiggle[0], k * v * (u * u + v * v) + wiggle[1]]
        }
    };
    let size = ["--size", "6000,4400"];
    for k in [1.0, 3.0] {
        let (line, result) = verdict_by(&size, lens(k));
        assert!(line.contains("bent as by a lens"), "{k}: {line}");
        assert!(k > 1.0 || result["rmse_px"].as_f64().is_some_and(|rmse| rmse < 0.5), "{}", result["rmse_px"]);
        let transform: Vec<f64> = serde_json::from_value(result["geotransform"].clone()).expect("six numbers");
        let [x, y] = [6000.0, 4400.0];
        let [dx, dy] = lens(k)(x, y);
        // The corner of the bent image is this place of the ground.
        let true_m = [600_000.0 + 0.05 * x, 5_800_000.0 - 0.05 * y];
        let at = |row: usize| transform[row] + transform[row + 1] * (x + dx) + transform[row + 2] * (y + dy);
        let off_m = (at(0) - true_m[0]).hypot(at(3) - true_m[1]);
        let corners = result["expected_errors"].as_array().expect("corners");
        let stated = corners.iter().find(|corner| corner["corner"] == "lower-right").expect("all four");
        let stated_m = stated["transform_95_m"].as_f64().expect("known");
        assert!((off_m..3.0 * off_m).contains(&stated_m), "{k}: {off_m} m off, {stated_m} m stated");
    }
    let (line, _) = verdict_by(&size, lens(0.0));
    assert!(line.contains("agree with each other"), "{line}");
}

#[test]
fn two_points_of_one_name_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let table = folder.path().join("t.csv");
    std::fs::write(&table, "name,x,y,easting,northing\nA,1,2,3,4\nB,5,6,7,8\nA,9,9,9,9\n").expect("writable");
    let refused = program(&["compare-solvers", table.to_str().expect("UTF-8")]);
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{said}");
    assert!(said.contains("row 4: a second point is called `A`; give each its own name"), "{said}");
}

/// Twelve marks and no clutter: a mark that is no other point's is the check point's, however far the survey is off.
#[test]
fn a_check_point_that_was_surveyed_wrong_counts_in_the_test() {
    let drawn = std::cell::Cell::new(0);
    let (line, result) = verdict_by(&["--check", "P3,P5,P7"], |x, y| {
        drawn.set(drawn.get() + 1);
        [0.1 * (x * 0.37 + y).sin() + if drawn.get() == 4 { 45.0 } else { 0.0 }, 0.0]
    });
    let rows = result["check_points"].as_array().expect("check points");
    let off = rows.iter().find(|row| row["gcp"] == "P3").unwrap_or_else(|| panic!("P3 is in no figure: {line}"));
    assert!((off["residual_px"].as_f64().expect("a number") - 45.0).abs() < 1.0, "{off}");
    assert!(result["accuracy"]["figures"]["horizontal"]["rmse_h1_m"].as_f64().expect("a number") > 1.0, "{line}");
}
