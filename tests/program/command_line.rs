//! What every command of the program has in common: completions, manual pages, JSON, exit codes.

use std::process::{Command, Output};

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

fn stdout(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn completions_know_commands_and_options() {
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = stdout(&autoref(&["completions", shell]));
        for word in ["autoref-stream", "detect", "undo", "gcps", "to-crs"] {
            assert!(script.contains(word), "{shell}: no {word}");
        }
    }
    assert_eq!(autoref(&["completions", "csh"]).status.code(), Some(2));
}

#[test]
fn manual_pages_are_troff() {
    let page = stdout(&autoref(&["man"]));
    assert!(page.contains(".TH autoref") && page.contains("Exit codes"), "{page}");
    let page = stdout(&autoref(&["man", "detect"]));
    assert!(page.contains("detect") && page.contains("candidates"), "{page}");
    let page = stdout(&autoref(&["man", "dem", "align"]));
    assert!(page.contains(".TH autoref-stream-dem-align") && page.contains("stable"), "{page}");
    let refused = autoref(&["man", "detekt"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("detect"));
}

#[test]
fn every_command_speaks_json() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("plain").to_string();
    let json = |args: &[&str]| -> serde_json::Value {
        serde_json::from_str(&stdout(&autoref(args))).unwrap_or_else(|e| panic!("{args:?}: {e}"))
    };
    let (image, list) = (path("a.tif"), path("a.geojson"));
    let made = json(&[
        "synth",
        &image,
        "--random-gcps",
        "9",
        "--extent-m",
        "30,24",
        "--size",
        "1200,1000",
        "--mark-size",
        "14",
        "--quiet",
        "--write-gcps",
        &list,
        "--json",
    ]);
    assert_eq!(made["files_written"].as_array().map(Vec::len), Some(3));
    let found = json(&["detect", &image, "--json"]);
    let seen = found["candidates"].as_array().expect("a list");
    assert!(seen.len() >= 4 && found["width"] == 1200, "{found}");
    let solved = json(&["--json", &image, "--gcps", &list]);
    assert_eq!(solved["status"], "solved");
    let at = format!("{},{}", solved["matches"][0]["x"], solved["matches"][0]["y"]);
    assert_eq!(json(&["sample", &image, "--at", &at, "--json"])["profile"]["name"], "taught");
    let chips = json(&["chips", &image, "--at", &at, "-o", &path("chips"), "--json"]);
    assert_eq!(chips["files_written"].as_array().map(Vec::len), Some(2));
    let distance = json(&["distance", &image, "-o", &path("d.tif"), "--json"]);
    assert_eq!(distance["files_written"][0], path("d.tif"));
    let applied = json(&["apply", &path("a.autoref.json"), "--write", "csv", "--json"]);
    assert_eq!(applied["files_written"].as_array().map(Vec::len), Some(1));
}

/// Those without a document of their own name the files; with --quiet nothing is said, and errors all the same.
#[test]
fn every_command_names_its_files_and_can_be_quiet() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = |name: &str| folder.path().join(name).to_str().expect("plain").to_string();
    let film = path("film");
    let made =
        stdout(&autoref(&["synth-film", &film, "--camera", "svalbard-zeiss-1936", "--pixel-um", "120", "--json"]));
    let made: serde_json::Value = serde_json::from_str(&made).expect("one document");
    let mut named: Vec<&str> =
        made["files_written"].as_array().expect("a list").iter().filter_map(|f| f.as_str()).collect();
    let mut there: Vec<String> = std::fs::read_dir(&film)
        .expect("made")
        .map(|e| e.expect("readable").path().to_string_lossy().into_owned())
        .collect();
    named.sort_unstable();
    there.sort_unstable();
    assert_eq!(named, there);
    let again = ["synth-film", film.as_str(), "--camera", "svalbard-zeiss-1936", "--pixel-um", "120"];
    let quiet = autoref(&[&again[..], &["--overwrite", "--quiet"]].concat());
    assert!(quiet.status.success() && quiet.stdout.is_empty() && quiet.stderr.is_empty());
    let refused = autoref(&[&again[..], &["--quiet"]].concat());
    assert_eq!(refused.status.code(), Some(2));
    assert!(refused.stdout.is_empty() && !refused.stderr.is_empty());
    let refused = autoref(&[&again[..], &["--json"]].concat());
    let error: serde_json::Value = serde_json::from_slice(&refused.stdout).expect("one document");
    assert!(error["error"]["message"].as_str().is_some_and(|m| m.contains("--overwrite")), "{error}");
    // A text that was asked for is no mere word.
    let colours = path("colours.csv");
    let rows: Vec<String> = (0..60).map(|i| format!("{},{},{}", 250 - i % 5, 100 + i % 7, 10 + i % 11)).collect();
    std::fs::write(&colours, rows.join("\n")).expect("writable");
    let toml = autoref(&["sample", "--colours", &colours, "--quiet"]);
    assert!(stdout(&toml).contains("[colour]") && toml.stderr.is_empty(), "{toml:?}");
}

/// Rows that are not the paint are left out and named; the others teach what they would alone.
#[test]
fn a_table_of_colours_is_of_one_paint() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let paint: Vec<String> = (0..40).map(|i| format!("{},{},{}", 250 - i % 5, 100 + i % 7, 10 + i % 11)).collect();
    let others: Vec<String> = (0..30).map(|i| format!("{},{},{}", 60 + i, 120 + i, 50 + i)).collect();
    let learned = |name: &str, rows: &[String]| {
        std::fs::write(path(name), rows.join("\n")).expect("writable");
        let output = autoref(&["sample", "--colours", &path(name), "--json"]);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let document: serde_json::Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {said}"));
        (document, said)
    };
    let (alone, said) = learned("alone.csv", &paint);
    assert!(said.contains("values taken for red, green, blue of 0 to 255") && !said.contains("left out"), "{said}");
    assert_eq!(
        (alone["left_out"].as_array().map(Vec::len), &alone["values"]),
        (Some(0), &"red, green, blue of 0 to 255".into())
    );
    let (mixed, said) = learned("mixed.csv", &[&paint[..], &others].concat());
    assert!(said.contains("30 rows are left out") && said.contains("row 41, row 42"), "{said}");
    assert_eq!((&mixed["profile"], &mixed["left_out"][29]["name"]), (&alone["profile"], &"row 70".into()));
    let shares: Vec<String> = (0..40).map(|i| format!("{}.5,{},{}", 90 - i % 5, 40 + i % 7, 5 + i % 3)).collect();
    assert!(learned("shares.csv", &shares).1.contains("as percentages have"));
}

/// Windows of 16-bit images that use a part of their range are seen; names that make one file name have files of their
/// own.
#[test]
fn chips_are_seen_and_each_has_its_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name).display().to_string();
    let made = |name: &str, white: u16| {
        let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
        let options = gdal::raster::RasterCreationOptions::from_iter(["PHOTOMETRIC=RGB"]);
        let mut image =
            driver.create_with_band_type_with_options::<u16, _>(path(name), 60, 60, 3, &options).expect("a new file");
        image.set_geo_transform(&[0.0, 1.0, 0.0, 60.0, 0.0, -1.0]).expect("writable");
        let values = (0..3600u32).map(|i| ((i % 60 + i / 60) * u32::from(white) / 118) as u16).collect();
        let mut buffer = gdal::raster::Buffer::new((60, 60), values);
        for band in 1..=3 {
            image.rasterband(band).and_then(|mut band| band.write((0, 0), (60, 60), &mut buffer)).expect("writable");
        }
        image.close().expect("written");
    };
    let chips = |image: &str, more: &[&str]| {
        let (image, out) = (path(image), path("chips"));
        let words = [&["chips", image.as_str(), "-o", &out, "--side-px", "59", "--overwrite", "--json"], more].concat();
        let output = autoref(&words);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        let document: serde_json::Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {said}"));
        (document, said)
    };
    let brightest = || {
        let chip = gdal::Dataset::open(path("chips/001.png")).expect("a chip");
        let values = chip.rasterband(1).and_then(|band| band.read_band_as::<u8>()).expect("values").data().to_vec();
        values.into_iter().max().expect("pixels")
    };
    made("twelve.tif", 4095);
    made("sixteen.tif", 65_535);
    let (_, said) = chips("twelve.tif", &["--at", "30,30"]);
    assert!(brightest() == 255 && said.contains("give --white 4095"), "{} {said}", brightest());
    let (_, said) = chips("twelve.tif", &["--at", "30,30", "--white", "65535"]);
    assert!(brightest() < 20 && said.is_empty(), "{} {said}", brightest());
    let (_, said) = chips("sixteen.tif", &["--at", "30,30"]);
    assert!(brightest() > 250 && said.is_empty(), "{} {said}", brightest());
    let long = "n".repeat(300);
    let list = format!("name,easting,northing\nA/B,20,20\nA:B,30,30\na_b,40,40\ncontact,30,20\n{long},20,30\n");
    std::fs::write(path("list.csv"), list).expect("writable");
    let (document, said) = chips("sixteen.tif", &["--gcps", &path("list.csv")]);
    let files: Vec<(&str, &str)> = document["marks"]
        .as_array()
        .expect("marks")
        .iter()
        .map(|mark| {
            let file = mark["file"].as_str().expect("a file");
            assert!(std::path::Path::new(file).is_file(), "{file}");
            (mark["name"].as_str().expect("a name"), file.rsplit('/').next().expect("a name"))
        })
        .collect();
    assert_eq!(files[..3], [("A/B", "A_B.png"), ("A:B", "A_B-2.png"), ("a_b", "a_b-3.png")]);
    assert_eq!(files[3], ("contact", "contact-2.png"));
    assert!(files[4].0 == long && files[4].1.len() == 154, "{files:?}");
    assert!(said.contains("A:B is in A_B-2.png"), "{said}");
}
