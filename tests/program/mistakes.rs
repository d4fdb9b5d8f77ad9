//! Mistakes that are plain are not written, hostile lists are answered at once, and tables are safe to open.

use std::path::Path;
use std::process::{Command, Output};

use autoref_synth::{SynthSpec, random_gcps};

fn program(folder: &Path, arguments: &[&str]) -> Output {
    let run = Command::new(env!("CARGO_BIN_EXE_autoref-stream")).current_dir(folder).args(arguments).output();
    run.expect("the program starts")
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[track_caller]
fn answers(output: &Output, code: i32, words: &[&str]) {
    let text = said(output);
    assert_eq!(output.status.code(), Some(code), "{text}");
    for word in words {
        assert!(text.contains(word), "no `{word}` in: {text}");
    }
}

/// An image of nine marks and its list, both in zone 32.
fn workplace() -> (tempfile::TempDir, Vec<(String, f64, f64)>) {
    let folder = tempfile::tempdir().expect("a folder");
    let gcps = random_gcps(9, 24.0, 18.0, 4);
    let spec = SynthSpec { gcps: gcps.clone(), size_px: Some((960, 720)), ..SynthSpec::default() };
    autoref_synth::write(&spec, &folder.path().join("a.tif")).expect("a sample");
    let rows = gcps.iter().map(|g| (g.name.clone(), g.easting, g.northing)).collect();
    (folder, rows)
}

fn list(folder: &Path, name: &str, header: &str, rows: impl Iterator<Item = (String, f64, f64)>) {
    let rows: String = rows.map(|(name, a, b)| format!("{name},{a},{b}\n")).collect();
    std::fs::write(folder.join(name), format!("{header}\n{rows}")).expect("writable");
}

const TITLES: &str = "name,easting,northing";
const ZONE_32: [&str; 2] = ["--crs", "EPSG:25832"];

/// What the verdict says of a point is not said again of the same point.
#[test]
fn a_mistyped_row_is_told_once() {
    let (folder, mut rows) = workplace();
    let (name, easting, _) = &mut rows[4];
    // One digit, that of metres.
    *easting += if (*easting as u64) % 10 >= 7 { -7.0 } else { 3.0 };
    let named = format!("{name}: a mistyped digit?");
    list(folder.path(), "l.csv", TITLES, rows.into_iter());
    for more in [&[][..], &["-v"]] {
        let run = program(
            folder.path(),
            &[&["a.tif", "--gcps", "l.csv", "--no-report", "--overwrite"], &ZONE_32[..], more].concat(),
        );
        answers(&run, 0, &["Matched", &named]);
        let text = said(&run);
        assert_eq!(text.matches(&named).count(), 1, "{text}");
        assert!(!text.contains("Look at"), "{text}");
    }
}

#[test]
fn a_wrong_zone_is_refused_unless_it_is_named() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.into_iter());
    answers(&program(dir, &[&["a.tif", "--gcps", "l.csv", "--no-report"], &ZONE_32[..]].concat()), 0, &["Matched"]);
    let before = std::fs::read(dir.join("a.tif.aux.xml")).expect("the georeference");
    let wrong = ["a.tif", "--gcps", "l.csv", "--no-report", "--overwrite", "--crs", "EPSG:25833"];
    answers(&program(dir, &wrong), 1, &["Not solved", "wrong UTM zone", "--force wrong-zone"]);
    // The georeference of the first run stays in force, which no line said; the refused result remembers it.
    let stays = ["stays as it is", "a.tfw, a.tif.aux.xml"];
    answers(&program(dir, &wrong), 1, &stays);
    assert_eq!(std::fs::read(dir.join("a.tif.aux.xml")).expect("still there"), before, "a mistake was written");
    a_review_does_not_mend_a_list(dir);
    assert_eq!(std::fs::read(dir.join("a.tif.aux.xml")).expect("still there"), before, "a replay wrote a mistake");
    // Another mistake's name is no leave, a bare --force no name.
    assert_eq!(program(dir, &[&wrong[..], &["--force", "feet"]].concat()).status.code(), Some(1));
    assert_eq!(program(dir, &[&wrong[..], &["--force"]].concat()).status.code(), Some(2));
    answers(&program(dir, &[&wrong[..], &["--force", "wrong-zone"]].concat()), 0, &["Matched"]);
}

/// A reviewer who accepts every mark of a list in the wrong zone got a georeference 300 km off without a word.
fn a_review_does_not_mend_a_list(dir: &Path) {
    let text = std::fs::read_to_string(dir.join("a.autoref.json")).expect("the refused result");
    let refused: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let pairs = refused["best_pattern"]["pairs"].as_array().expect("proposals");
    let name = |pair: &serde_json::Value| &refused["gcps"][pair[1].as_u64().expect("an index") as usize]["name"];
    let edits: Vec<_> = pairs.iter().map(|pair| serde_json::json!({"gcp": name(pair), "action": "accept"})).collect();
    let patch = serde_json::json!({"schema": "autoref-stream-patch", "schema_version": 1, "for": "gcps",
        "source": "a.autoref.json", "edits": edits});
    std::fs::write(dir.join("a.patch.json"), patch.to_string()).expect("writable");
    let replay = ["solve", "a.autoref.json", "--patch", "a.patch.json", "-o", "r.json", "--overwrite"];
    answers(&program(dir, &replay), 1, &["Not solved", "wrong UTM zone", "--force wrong-zone"]);
    answers(&program(dir, &["apply", "r.json", "--overwrite"]), 2, &["no georeference", "wrong UTM zone"]);
    assert_eq!(program(dir, &[&replay[..], &["--force", "feet"]].concat()).status.code(), Some(1));
    let likely = ["a mistake in the list is likely", "wrong UTM zone"];
    answers(&program(dir, &[&replay[..], &["--force", "wrong-zone"]].concat()), 0, &likely);
    answers(&program(dir, &["apply", "r.json", "--write", "vrt"]), 0, &likely);
    proposals_that_nobody_accepted_are_no_doubts(dir, &patch);
    // A patch of the result that was forced needs no leave a second time.
    let again = ["solve", "r.json", "--patch", "a.patch.json"];
    answers(&program(dir, &again), 0, &likely);
}

/// Their own marks were told as others that lie 0.0 px beside their places, and two points had the chance of nine.
fn proposals_that_nobody_accepted_are_no_doubts(dir: &Path, all: &serde_json::Value) {
    let mut two = all.clone();
    let edits = two["edits"].as_array_mut().expect("a list");
    let points = edits.len();
    edits.truncate(2);
    std::fs::write(dir.join("two.patch.json"), two.to_string()).expect("writable");
    let replay = ["solve", "a.autoref.json", "--patch", "two.patch.json", "--force", "wrong-zone"];
    let run = program(dir, &replay);
    let kept = format!("of its {points} points the review kept 2");
    answers(&run, 0, &["(proposed: not accepted in the review)", &kept]);
    let text = said(&run);
    assert!(!text.contains("displaced") && !text.contains("may be wrong"), "{text}");
}

#[test]
fn exchanged_columns_are_told_before_the_image_is_read_and_mended_on_request() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "x.csv", TITLES, rows.iter().map(|(name, e, n)| (name.clone(), *n, *e)));
    let run =
        |extra: &[&str]| program(dir, &[&["a.tif", "--gcps", "x.csv", "--no-report"], &ZONE_32[..], extra].concat());
    answers(&run(&[]), 2, &["x.csv", "exchanged", "--fix-axes"]);
    assert!(!dir.join("a.autoref.json").exists(), "the image was not looked at");
    answers(&run(&["--fix-axes"]), 0, &["Matched", "were exchanged in all points"]);
}

/// A transform of other coordinates beside an image that has a CRS would be read in that CRS, far off.
#[test]
fn a_list_without_a_crs_lies_on_an_image_that_has_one_or_is_refused() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.iter().cloned());
    let run = |list: &str, extra: &[&str]| {
        program(dir, &[&["a.tif", "--gcps", list, "--no-report", "--overwrite"], extra].concat())
    };
    answers(&run("l.csv", &ZONE_32), 0, &["Matched"]);
    let georeference = || std::fs::read_to_string(dir.join("a.tif.aux.xml")).expect("the georeference");
    let before = georeference();
    std::fs::remove_file(dir.join("a.autoref.json")).expect("a result");
    let moved = |name: &str, by: (f64, f64)| {
        list(dir, name, TITLES, rows.iter().map(|(name, e, n)| (name.clone(), e + by.0, n + by.1)));
    };
    moved("zone.csv", (32e6, 0.0));
    moved("cut.csv", (-500_000.0, -7_000_000.0));
    moved("elsewhere.csv", (-299_400.0, 7_560.0));
    list(dir, "x.csv", TITLES, rows.iter().map(|(name, e, n)| (name.clone(), *n, *e)));
    for (name, word) in [
        ("zone.csv", "zone's number 32"),
        ("cut.csv", "+500000 in all eastings"),
        ("elsewhere.csv", "km from where the image says it is"),
        ("x.csv", "--fix-axes"),
    ] {
        answers(&run(name, &[]), 2, &[name, word]);
        assert!(!dir.join("a.autoref.json").exists(), "{name}: the image was looked at");
    }
    answers(&run("elsewhere.csv", &[]), 2, &["the list names no CRS", "EPSG:25832", "--crs local"]);
    assert_eq!(georeference(), before, "a mistake was written");
    answers(&run("x.csv", &["--fix-axes"]), 0, &["Matched", "taken to be the image's", "were exchanged"]);
    answers(&run("cut.csv", &["--crs", "local", "--write", "world"]), 2, &["add aux"]);
    answers(&run("cut.csv", &["--crs", "local"]), 0, &["Matched"]);
    assert!(georeference().contains("LOCAL_CS"), "{}", georeference());
}

#[test]
fn points_in_nowhere_are_set_aside_by_name() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    let more = [("NOWHERE".to_owned(), 1e308, 1e308), ("AFAR".to_owned(), 4_000_000.0, 7_000_000.0)];
    list(dir, "f.csv", TITLES, rows.iter().cloned().chain(more));
    let run = program(dir, &[&["a.tif", "--gcps", "f.csv", "--no-report"], &ZONE_32[..]].concat());
    answers(&run, 0, &["Matched", "set aside", "NOWHERE, AFAR"]);
    // Without a system, which the run before has given the image, nothing tells where a point may be, but numbers end
    // somewhere.
    std::fs::remove_file(dir.join("a.tif.aux.xml")).expect("the georeference");
    std::fs::remove_file(dir.join("a.tfw")).expect("the world file");
    answers(&program(dir, &["a.tif", "--gcps", "f.csv", "--no-report", "--overwrite"]), 2, &["NOWHERE", "row 11"]);
    // A list that lies elsewhere as a whole has another system.
    list(dir, "e.csv", TITLES, rows.iter().map(|(name, e, n)| (name.clone(), e + 3_000_000.0, *n)));
    let elsewhere = program(dir, &[&["a.tif", "--gcps", "e.csv", "--no-report", "--overwrite"], &ZONE_32[..]].concat());
    answers(&elsewhere, 2, &["e.csv", "outside the area of use", "--crs"]);
}

#[test]
fn unclear_columns_are_told() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "u.csv", "Høyde-navn,easting,northing", rows.into_iter());
    let run = program(dir, &[&["a.tif", "--gcps", "u.csv", "--no-report"], &ZONE_32[..]].concat());
    answers(&run, 0, &["names are taken from the column `Høyde-navn`"]);
    // Beside names, a title with such a word in it is named.
    let text = std::fs::read_to_string(dir.join("u.csv")).expect("the list");
    let text = text.replacen("Høyde-navn", "navn", 1).lines().fold(String::new(), |rows, row| rows + row + ",Bolt\n");
    std::fs::write(dir.join("v.csv"), text.replacen(",Bolt", ",Høyde-navn", 1)).expect("writable");
    let run = program(dir, &[&["a.tif", "--gcps", "v.csv", "--no-report", "--overwrite"], &ZONE_32[..]].concat());
    answers(&run, 0, &["columns were taken as", "name `navn`", "not understood: `Høyde-navn`"]);
}

#[test]
fn endless_and_enormous_inputs_are_refused_at_once() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.into_iter());
    assert!(Command::new("mkfifo").arg(dir.join("pipe")).status().expect("a system with pipes").success());
    for endless in ["/dev/zero", "pipe"] {
        answers(&program(dir, &["a.tif", "--gcps", endless]), 2, &[endless, "a pipe or a device"]);
        answers(&program(dir, &[endless, "--gcps", "l.csv"]), 2, &[endless, "a pipe or a device"]);
        answers(&program(dir, &["detect", "a.tif", "--profile", endless]), 2, &[endless, "a pipe or a device"]);
        answers(&program(dir, &["a.tif", "--gcps", "l.csv", "--accuracy", endless]), 2, &[endless]);
        answers(&program(dir, &["solve", endless, "--gcps", "l.csv"]), 2, &[endless, "a pipe or a device"]);
    }
    let million: String = (0..1_000_000).map(|i| format!("P{i},{},7032000\n", 570_000 + i % 9000)).collect();
    std::fs::write(dir.join("m.csv"), format!("{TITLES}\n{million}")).expect("room");
    answers(&program(dir, &[&["a.tif", "--gcps", "m.csv"], &ZONE_32[..]].concat()), 2, &["m.csv", "at most 50000"]);
    std::fs::write(dir.join("wide.csv"), "a,".repeat(1 << 20)).expect("room");
    answers(&program(dir, &["a.tif", "--gcps", "wide.csv"]), 2, &["wide.csv", "row 1", "a row for each point"]);
    answers(&program(dir, &["a.tif", "--gcps", "l.csv", "--accuracy", "wide.csv"]), 2, &["wide.csv", "row 1"]);
    answers(&program(dir, &["a.tif", "--gcps", "l.csv", "--crs", "none.prj"]), 2, &["none.prj: no such file"]);
    let missing = ["fiducials", "none.tif", "--camera", "wild-15-4", "-o", "film"];
    answers(&program(dir, &missing), 2, &["none.tif: there is no such file"]);
    assert!(!dir.join("film").exists());
    let many = (0..2_500).map(|i| (format!("P{i}"), 570_000.0 + f64::from(i), 7_032_000.0 + f64::from(i * i % 977)));
    list(dir, "many.csv", TITLES, many);
    answers(&program(dir, &[&["a.tif", "--gcps", "many.csv"], &ZONE_32[..]].concat()), 2, &["many.csv", "--names"]);
}

/// Points on a line fit everywhere: the search counts what it does and ends, and a limit of time ends it sooner and
/// says so.
#[test]
fn a_line_of_points_ends_and_a_limit_of_time_is_told() {
    let (folder, _) = workplace();
    let dir = folder.path();
    let line = (0..120).map(|i| (format!("P{i}"), 570_000.0 + 7.3 * f64::from(i), 7_032_000.0 + 2.1 * f64::from(i)));
    list(dir, "line.csv", TITLES, line);
    let mut random = crate::common::Random::new(5);
    let rows: String =
        (0..40).map(|_| format!("{:.2},{:.2}\n", random.uniform(0.0, 6000.0), random.uniform(0.0, 4500.0))).collect();
    std::fs::write(dir.join("c.csv"), format!("x,y\n{rows}")).expect("writable");
    let solve = ["solve", "c.csv", "--gcps", "line.csv", "--crs", "EPSG:25832", "--size", "6000,4500", "--json"];
    let cut = program(dir, &[&solve[..], &["--time-limit", "0"]].concat());
    assert_eq!(cut.status.code(), Some(1), "{}", said(&cut));
    let cut: serde_json::Value = serde_json::from_slice(&cut.stdout).expect("one document");
    assert_eq!(cut["search_cut"], true);
    assert!(cut["warnings"].to_string().contains("--time-limit"), "{}", cut["warnings"]);
}

#[test]
fn a_table_of_candidates_from_a_german_spreadsheet_is_read() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.into_iter());
    answers(&program(dir, &["detect", "a.tif", "-o", "c.csv"]), 0, &[]);
    let text = std::fs::read_to_string(dir.join("c.csv")).expect("the candidates");
    let german = text.replace(',', ";").replace('.', ",").replace('\n', "\r\n");
    std::fs::write(dir.join("de.csv"), format!("\u{feff}{german}")).expect("writable");
    let solve = |table: &str| {
        let run =
            program(dir, &["solve", table, "--gcps", "l.csv", "--crs", "EPSG:25832", "--json", "--gsd", "0.01..0.1"]);
        assert_eq!(run.status.code(), Some(0), "{}", said(&run));
        let json: serde_json::Value = serde_json::from_slice(&run.stdout).expect("one document");
        json["geotransform"].clone()
    };
    assert_eq!(solve("c.csv"), solve("de.csv"));
}

#[test]
fn a_list_is_no_image_and_stands_behind_its_option() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.into_iter());
    answers(
        &program(dir, &["l.csv", "--gcps", "l.csv"]),
        2,
        &["l.csv: this is a list of 9 points, no image", "--gcps"],
    );
    answers(&program(dir, &["a.tif", "l.csv"]), 2, &["give the list with --gcps l.csv"]);
    answers(&program(dir, &["a.tif", "b.tif", "--gcps", "l.csv"]), 2, &["`b.tif` is a second image"]);
    answers(&program(dir, &["a.tif", "--gcps", "l.csv", "--gsd", "2.5ell"]), 2, &["`2.5ell` is no positive length"]);
}

#[test]
fn exchanged_coordinates_are_named_where_nothing_fits() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    // An image without a place and marks of another colour than the default's.
    std::fs::remove_file(dir.join("a.tif.aux.xml")).ok();
    list(dir, "utm.csv", "name,northing,easting", rows.iter().cloned());
    let image = ["a.tif", "--profile", "blue", "--no-report"];
    let job = |list: &str| program(dir, &[&image[..], &["--gcps", list, "--overwrite"]].concat());
    answers(&job("utm.csv"), 1, &["Not solved", "easting and northing may be exchanged"]);
    let degrees = |k: usize| (format!("P{k}"), 10.4 + 0.0001 * k as f64, 63.4 + 0.0001 * (k * k) as f64);
    list(dir, "degrees.csv", "name,lat,lon", (0..8).map(degrees));
    answers(&job("degrees.csv"), 1, &["Not solved", "latitude and longitude may be exchanged", "--fix-axes"]);
    let found =
        program(dir, &[&image[..], &["--gcps", "degrees.csv", "--overwrite", "--to-crs", "EPSG:25832"]].concat());
    answers(&found, 2, &["longitude and latitude exchanged", "--fix-axes"]);
}

#[test]
fn an_image_is_no_result_and_a_list_has_a_format() {
    let (folder, _) = workplace();
    let dir = folder.path();
    answers(&program(dir, &["apply", "a.tif"]), 2, &["a.tif", "an image, no result", ".autoref.json"]);
    answers(&program(dir, &["detect", "a.tif", "-o", "x.foo"]), 2, &["x.foo", ".csv or .geojson"]);
    assert!(!dir.join("x.foo").exists(), "a list of no format was written");
    let unknown = program(dir, &["detect", "a.tif", "--profile", "organe"]);
    answers(&unknown, 2, &["organe", "orange"]);
    assert_eq!(said(&unknown).contains("apriltag"), cfg!(feature = "coded"), "{}", said(&unknown));
}

/// Another image of the same name in the working directory is not touched.
#[test]
fn apply_finds_the_image_beside_the_result() {
    let (folder, rows) = workplace();
    let dir = folder.path();
    list(dir, "l.csv", TITLES, rows.into_iter());
    answers(&program(dir, &[&["a.tif", "--gcps", "l.csv", "--no-report"], &ZONE_32[..]].concat()), 0, &["Matched"]);
    let elsewhere = tempfile::tempdir().expect("a folder");
    std::fs::write(elsewhere.path().join("a.tif"), "no image").expect("writable");
    let result = dir.join("a.autoref.json");
    let apply = program(elsewhere.path(), &["apply", result.to_str().expect("plain"), "--write", "vrt"]);
    answers(&apply, 0, &["a.vrt"]);
    assert!(dir.join("a.vrt").exists() && !elsewhere.path().join("a.vrt").exists());
}

/// After `--out` the documented replay ended where the image is opened: its name was that of the working directory.
#[test]
fn a_review_in_the_folder_of_the_outputs_is_written_there() {
    let (folder, rows) = workplace();
    let (dir, res) = (folder.path(), folder.path().join("res"));
    list(dir, "l.csv", TITLES, rows.into_iter());
    let run = program(dir, &[&["a.tif", "--gcps", "l.csv", "--no-report", "--out", "res"], &ZONE_32[..]].concat());
    answers(&run, 0, &["Matched"]);
    let world = || std::fs::read(res.join("a.tfw")).expect("the georeference");
    let before = world();
    let text = std::fs::read_to_string(res.join("a.autoref.json")).expect("the result");
    let result: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let patch = serde_json::json!({"schema": "autoref-stream-patch", "schema_version": 1, "for": "gcps",
        "source": "a.autoref.json", "edits": [{"gcp": result["matches"][0]["gcp"], "action": "reject"}]});
    std::fs::write(res.join("a.patch.json"), patch.to_string()).expect("writable");
    let next = "autoref-stream apply a.reviewed.json --out . --overwrite";
    let replay = ["solve", "a.autoref.json", "--patch", "a.patch.json", "-o", "a.reviewed.json"];
    answers(&program(&res, &replay), 0, &["Matched", next]);
    let words: Vec<&str> = next.split(' ').skip(1).collect();
    answers(&program(&res, &words), 0, &["a.tfw", "a.vrt"]);
    assert!(world() != before && !dir.join("a.tfw").exists(), "it was written elsewhere");
    std::fs::rename(dir.join("a.tif"), dir.join("b.tif")).expect("moved");
    answers(&program(&res, &words), 2, &["a.reviewed.json: its image", "apply a.reviewed.json IMAGE"]);
}

/// A name that a spreadsheet would calculate is a text in every table, and reads back as it was.
#[test]
fn names_are_no_formulas_in_tables() {
    let (folder, mut rows) = workplace();
    let dir = folder.path();
    rows[0].0 = "=1+1".into();
    rows[1].0 = "-P2".into();
    list(dir, "l.csv", TITLES, rows.iter().cloned());
    let run = program(dir, &[&["a.tif", "--gcps", "l.csv", "--no-report", "--write", "csv"], &ZONE_32[..]].concat());
    answers(&run, 0, &["Matched"]);
    let table = std::fs::read_to_string(dir.join("a.gcps.csv")).expect("the table");
    assert!(table.contains("'=1+1") && table.contains("'-P2"), "{table}");
    let options = autoref_stream::gcp::GcpOptions { crs: Some("EPSG:25832".into()), ..Default::default() };
    let back = autoref_stream::gcp::read(&dir.join("a.gcps.csv"), &options).expect("our own table");
    assert!(["=1+1", "-P2"].iter().all(|name| back.gcps.iter().any(|g| g.name == *name)), "{:?}", back.gcps);
}
