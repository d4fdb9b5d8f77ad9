//! `flight solve` through the program: resumed after a failure and a kill, stage by stage, by COLMAP itself where it is
//! installed, and by pycolmap.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_flight::read::Photograph;
use serde_json::Value;

use super::flight::{F_PX, Place, autoref, expect, has_the_keys, json, said, text, write_program};
use crate::common::{large, skipped};

#[test]
fn solve_resumes_after_a_failure_and_a_kill_at_every_stage() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let bin = place.stand_in();
    let solve = |out: &str, bin: &Path, words: &[(&str, &str)]| {
        autoref(&["flight", "solve", text(&toml), "-o", text(&place.at(out)), "--json"], Some(bin), words)
    };
    let whole = solve("whole", &bin, &[]);
    expect(&whole, 0, &[]);
    let document = json(&whole);
    has_the_keys(&document);
    assert_eq!((&document["frames_registered"], &document["frames_listed"]), (&5.into(), &5.into()));
    let cameras = |out: &str| std::fs::read(place.at(out).join("cameras.json")).expect("written");
    // Fails and is killed at one stage after the other: each run goes on to the stage that the one before left undone.
    for command in ["feature_extractor", "matches_importer", "mapper"] {
        expect(&solve("broken", &bin, &[("STAND_IN_FAILS", command)]), 2, &[command, "exit status: 3", ".log"]);
        assert_eq!(solve("broken", &bin, &[("STAND_IN_KILLS", command)]).status.code(), None, "killed");
        assert!(!place.at("broken").join("cameras.json").exists(), "{command}");
        if large() {
            expect(&solve("broken", &bin, &[]), 0, &[]);
            assert_eq!(cameras("broken"), cameras("whole"), "{command}");
            std::fs::remove_dir_all(place.at("broken")).expect("written");
        }
    }
    expect(&solve("broken", &bin, &[]), 0, &[]);
    assert_eq!(cameras("broken"), cameras("whole"));
    every_stage_says_what_it_found(&place, &toml, &bin);
    let again = solve("whole", &bin, &[]);
    expect(&again, 0, &["ties: taken from before", "features.db: taken from before", "sparse: taken from before"]);
    assert_eq!(again.stdout, whole.stdout);
    // COLMAP is not there.
    std::fs::create_dir(place.at("bare")).expect("a folder");
    let none = solve("none", &place.at("bare"), &[("AUTOREF_PYTHON", "no-such-python")]);
    if Path::new("/bin/colmap").exists() {
        // Where /bin is /usr/bin, COLMAP itself answers: these frames have nothing to match.
        expect(&none, 1, &["no two frames"]);
    } else {
        expect(&none, 2, &["`colmap` is not there, nor pycolmap", "apt-get install colmap"]);
    }
    let missing = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .args(["flight", "solve", text(&toml), "-o", text(&place.at("none")), "--overwrite"])
        .env("PATH", place.at("bare"))
        .env_remove("AUTOREF_PYTHON")
        .output()
        .expect("the program starts");
    expect(&missing, 2, &["`colmap` is not there, nor pycolmap", "apt-get install colmap", "pip install pycolmap"]);
    masks_that_do_not_fit_are_named(&place, &toml, &bin);
    // A frame that went missing is one frame less, and the stages are worked anew.
    std::fs::remove_file(place.at("frames").join("f4.png")).expect("removed");
    let fewer = solve("whole", &bin, &[]);
    assert!(!said(&fewer).contains("features.db: taken"), "{}", said(&fewer));
    for i in 1..4 {
        std::fs::remove_file(place.at("frames").join(format!("f{i}.png"))).expect("removed");
    }
    expect(&solve("one", &bin, &[]), 2, &["frames: 1 frame matches"]);
    let typo = place.write("typo.toml", "[frames]\nfolder = \"frames\"\npattern = [\"*.png\"]\nmask = 1\n");
    expect(
        &autoref(&["flight", "solve", text(&typo), "-o", text(&place.at("typo"))], None, &[]),
        2,
        &["typo.toml", "mask"],
    );
}

fn masks_that_do_not_fit_are_named(place: &Place, toml: &Path, bin: &Path) {
    // A mask that cannot be this camera's.
    place.write("mask.pgm", "P5\n1 1\n255\n\u{1}");
    let masked = std::fs::read_to_string(toml).expect("there") + "\n[masks]\nglobal = \"mask.pgm\"\n";
    let masked = place.write("masked.toml", &masked);
    expect(
        &autoref(&["flight", "solve", text(&masked), "-o", text(&place.at("masked"))], Some(bin), &[]),
        2,
        &["mask.pgm: the mask has 1 x 1 pixels, the frame f0.png"],
    );
    // Masks of other frames than these: one is left out, all of them stop the run.
    std::fs::create_dir(place.at("masks")).expect("a folder");
    let masked = std::fs::read_to_string(toml).expect("there") + "\n[masks]\nfolder = \"masks\"\n";
    let masked = place.write("others.toml", &masked);
    let others = || autoref(&["flight", "solve", text(&masked), "-o", text(&place.at("others"))], Some(bin), &[]);
    place.write("masks/f0_Masq.tif", "P5\n1 1\n255\n\u{1}");
    expect(&others(), 0, &["f0_Masq.tif: left out: the mask has 1 x 1 pixels"]);
    (1..5).for_each(|i| drop(place.write(&format!("masks/f{i}_Masq.tif"), "P5\n1 1\n255\n\u{1}")));
    expect(&others(), 2, &["masks: none of the 5 masks fits the frames of", "autoref-stream mask"]);
}

/// Nothing of a run that was killed goes on beside the next one.
#[cfg(target_os = "linux")]
#[test]
fn colmap_ends_with_the_run_that_started_it() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let (bin, told) = (place.stand_in(), place.at("pid"));
    write_program(&bin.join("colmap"), &format!("#!/bin/sh\necho $$ > {}\nexec sleep 300\n", text(&told)));
    let mut run = Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
        .args(["flight", "solve", text(&toml), "-o", text(&place.at("out")), "--quiet"])
        .env("PATH", format!("{}:/bin:/usr/bin", bin.display()))
        .spawn()
        .expect("the program starts");
    let until = |done: &dyn Fn() -> bool| {
        let by = std::time::Instant::now() + std::time::Duration::from_secs(60);
        while !done() && std::time::Instant::now() < by {
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
        done()
    };
    let pid = || std::fs::read_to_string(&told).unwrap_or_default().trim().parse::<u32>().ok();
    assert!(until(&|| pid().is_some()), "COLMAP was started");
    let process = PathBuf::from(format!("/proc/{}/comm", pid().expect("told")));
    run.kill().expect("it runs");
    run.wait().expect("killed");
    assert!(until(&|| std::fs::read_to_string(&process).map_or(true, |name| name.trim() != "sleep")), "it goes on");
}

/// Stage by stage, each with a document and a page; the last is what a run in one go gives.
fn every_stage_says_what_it_found(place: &Place, toml: &Path, bin: &Path) {
    let out = place.at("stages");
    let stages = out.join("stages");
    for (number, stage) in ["interior", "pairs", "ties", "relative", "gcp"].into_iter().enumerate() {
        let arguments = ["flight", "solve", text(toml), "-o", text(&out), "--until", stage, "--json"];
        let output = autoref(&arguments, Some(bin), &[]);
        expect(&output, 0, &[]);
        let found = json(&output);
        assert_eq!(found["stage"], stage);
        let file = std::fs::read(stages.join(format!("{stage}.json"))).expect("written");
        assert_eq!(serde_json::from_slice::<Value>(&file).expect("JSON"), found);
        let page = std::fs::read_to_string(stages.join(format!("{stage}.html"))).expect("written");
        assert!(page.starts_with("<!doctype html>") && page.contains(&format!("{stage}.json")), "{page}");
        let contents = std::fs::read_to_string(stages.join("index.html")).expect("written");
        assert_eq!(contents.matches("not yet").count(), 5 - number, "{contents}");
        assert!(!out.join("cameras.json").exists());
        let frames = |key: &str| found[key].as_array().map_or(0, Vec::len);
        match stage {
            "interior" => assert_eq!((frames("frames"), &found["focal"]), (5, &"held".into())),
            "pairs" => assert_eq!((frames("frames"), frames("pairs"), frames("lines")), (5, 9, 1)),
            "ties" => assert_eq!((frames("frames"), frames("pairs")), (5, 0)),
            "relative" => {
                assert_eq!((&found["frames_registered"], &found["made_by"]), (&5.into(), &"COLMAP's mapper".into()));
                assert!(found["reprojection_rms_px"].as_f64() < Some(0.1), "{found}");
                let model = autoref_flight::read::reconstruction(&out.join("relative")).expect("COLMAP's text model");
                assert_eq!(model.photographs.len(), 5);
            }
            _ => {
                let worst = found["gcp_statistics"]["d"]["max"].as_f64().expect("control points");
                assert!(worst < 1.0, "{worst} m after seven parameters of a true block");
            }
        }
    }
    let arguments = ["flight", "solve", text(toml), "-o", text(&out), "--json"];
    expect(&autoref(&arguments, Some(bin), &[]), 0, &["sparse: taken from before"]);
    let cameras = |out: &Path| std::fs::read(out.join("cameras.json")).expect("written");
    assert_eq!(cameras(&out), cameras(&place.at("whole")));
    let picture = std::fs::read(stages.join("frames/f0.png.png")).expect("a small picture");
    assert!(picture.starts_with(b"\x89PNG"));
}

/// A row of a camera table, its yaw half a turn off if it is of one of the frames.
fn turned(row: &str, frames: &[&str]) -> String {
    let mut cells: Vec<String> = row.split(',').map(str::to_string).collect();
    if frames.contains(&cells[0].as_str()) {
        cells[4] = format!("{:.3}", cells[4].parse::<f64>().expect("a yaw") + 180.0);
    }
    cells.join(",") + "\n"
}

/// A table whose yaw is half a turn off in some frames, as where somebody turned the pictures, does not count there.
#[test]
fn directions_of_turned_frames_are_named_and_let_go_of() {
    let place = Place::new();
    place.five_frames();
    let (toml, bin) = (place.init(), place.stand_in());
    let table = std::fs::read_to_string(place.at("table.csv")).expect("there");
    let solve = || {
        let output =
            autoref(&["flight", "solve", text(&toml), "-o", text(&place.at("out")), "--json"], Some(&bin), &[]);
        expect(&output, 0, &[]);
        json(&output)
    };
    let is_told = |document: &Value| document["notes"].to_string().contains("the table's direction of");
    let turns = |document: &Value| -> Vec<f64> {
        let frames = document["rough_differences"]["frames"].as_array().expect("a list");
        frames.iter().map(|f| f["turn_deg"].as_f64().expect("a direction")).collect()
    };
    let right = solve();
    assert!(!is_told(&right) && turns(&right).iter().all(|turn| *turn < 5.0), "{}", right["notes"]);
    place.write("table.csv", &table.lines().map(|row| turned(row, &["f1.png", "f3.png"])).collect::<String>());
    let found = solve();
    let notes = found["notes"].to_string();
    assert!(notes.contains("of 2 of 5 frames is 17") && notes.contains("(f1.png, f3.png)"), "{notes}");
    assert_eq!(turns(&found).iter().filter(|turn| **turn > 160.0).count(), 2, "{:?}", turns(&found));
    assert!(place.flight.worst_camera_m(&found) < 1.0, "{} m", place.flight.worst_camera_m(&found));
}

/// Where there are no GCPs, the positions of the table place the block, each with the deviation that its row states.
#[test]
fn positions_place_a_block_without_gcps() {
    let place = Place::new();
    place.five_frames();
    let (toml, bin) = (place.init(), place.stand_in());
    let mut project: toml::Table = std::fs::read_to_string(&toml).expect("there").parse().expect("TOML");
    project.remove("gcps").expect("GCPs");
    let bare = place.write("bare.toml", &project.to_string());
    let solve = |toml: &Path| autoref(&["flight", "solve", text(toml), "-o", text(&place.at("out"))], Some(&bin), &[]);
    expect(&solve(&bare), 0, &["5 of 5 frames", "no GCPs", "in no standard deviation"]);
    let document = || -> Value {
        serde_json::from_slice(&std::fs::read(place.at("out/cameras.json")).expect("written")).expect("JSON")
    };
    let found = document();
    assert!(found["gcps"].as_array().is_some_and(Vec::is_empty), "{}", found["gcps"]);
    // The table is up to 15 m off along each axis, and nothing else says where the block is.
    assert!(place.flight.worst_camera_m(&found) < 26.0, "{} m", place.flight.worst_camera_m(&found));
    let sigma_m = |found: &Value| found["cameras"][0]["sigma_h"].as_f64().expect("a deviation");
    let loose_m = sigma_m(&found);
    let rows: String = place
        .flight
        .model
        .photographs
        .iter()
        .map(|p| {
            let (c, a) = (p.pose.centre, p.pose.yaw_pitch_roll());
            let (yaw, pitch, roll) = (a.yaw_deg, a.pitch_deg, a.roll_deg);
            format!("{},{:.4},{:.4},{:.4},{yaw},{pitch},{roll},0.02,0.03\n", p.name, c.x, c.y, c.z)
        })
        .collect();
    place.write("table.csv", &format!("name,x,y,z,yaw,pitch,roll,sigma_m,sigma_height_m\n{rows}"));
    expect(&solve(&bare), 0, &["no GCPs"]);
    let found = document();
    assert!(place.flight.worst_camera_m(&found) < 0.1, "{} m", place.flight.worst_camera_m(&found));
    assert!(sigma_m(&found) < 0.05 && loose_m > 5.0, "{} and {loose_m} m", sigma_m(&found));
    // The northing first: on a plane of one's own the block hangs upside down, in a real CRS only one order can be.
    let north_first = |[east, north]: [f64; 2]| -> String {
        let row = |p: &Photograph| {
            let c = p.pose.centre;
            format!("{},{:.4},{:.4},{:.4},0.5,0.5\n", p.name, c.y + north, c.x + east, c.z)
        };
        let rows: String = place.flight.model.photographs.iter().map(row).collect();
        format!("name,x,y,z,sigma_m,sigma_height_m\n{rows}")
    };
    place.write("table.csv", &north_first([0.0; 2]));
    expect(&solve(&bare), 1, &["table.csv: its positions", "easting and northing", "--force upside-down"]);
    place.write("table.csv", &north_first([4e5, 7e6]));
    project.insert("crs".into(), "EPSG:25833".into());
    let utm = place.write("utm.toml", &project.to_string());
    expect(&solve(&utm), 0, &["table.csv: all its positions lie in", "only with the northing first"]);
    let east_m = document()["cameras"][0]["e"].as_f64().expect("an easting");
    assert!((east_m - 4e5 - place.flight.model.photographs[0].pose.centre.x).abs() < 2.0, "{east_m}");
    place.write("table.csv", "name,x,y,z,sigma_m\nf0.png,1,2,3,0\n");
    expect(&solve(&bare), 2, &["table.csv", "row 2", "a standard deviation of 0 m"]);
    place.write("table.csv", "name,x,y,z\nf0.png,1,2,3\nf1.png,1,9,3\n");
    expect(&solve(&bare), 2, &["table.csv: 2 positions, and no GCPs: 3 are needed"]);
    let out = place.at("micmac");
    let by_micmac = ["flight", "solve", text(&bare), "-o", text(&out), "--engine", "micmac"];
    expect(&autoref(&by_micmac, None, &[]), 2, &["bare.toml: no [gcps]: MicMac places a block by GCPs"]);
    project.remove("rough").expect("a table");
    let lost = place.write("lost.toml", &project.to_string());
    expect(&solve(&lost), 2, &["lost.toml: neither [gcps] nor [rough]"]);
}

/// The same commands by an interpreter of Python, of which only what it is asked and how it ends is looked at here.
#[test]
fn pycolmap_is_asked_what_colmap_is() {
    let place = Place::new();
    place.five_frames();
    let (toml, bin) = (place.init(), place.stand_in());
    let python = |name: &str, script: &str| {
        let path = place.at(name);
        write_program(&path, &format!("#!/bin/sh\n{script}\n"));
        text(&path).to_string()
    };
    let solve = |out: &str, engine: &str, python: &str| {
        let out = place.at(out);
        let arguments = ["flight", "solve", text(&toml), "-o", text(&out), "--engine", engine];
        autoref(&arguments, Some(&bin), &[("AUTOREF_PYTHON", python)])
    };
    let cameras = |out: &str| std::fs::read(place.at(out).join("cameras.json")).expect("written");
    expect(&solve("colmap", "colmap", "no-such-python"), 0, &[]);
    let whole =
        python("python-whole", &format!("[ \"$1\" = -c ] || exit 5; shift 2; exec {}/colmap \"$@\"", bin.display()));
    expect(&solve("pycolmap", "pycolmap", &whole), 0, &[]);
    assert_eq!(cameras("pycolmap"), cameras("colmap"));
    let old = python("python-old", "echo pycolmap 3.1 is older than version 4; exit 72");
    expect(&solve("old", "pycolmap", &old), 2, &["pycolmap 3.1 is older", "pip install --upgrade pycolmap"]);
    for without in [python("python-without", "exit 71"), "no-such-python".to_string()] {
        expect(&solve("without", "pycolmap", &without), 2, &["pycolmap is not there", "AUTOREF_PYTHON"]);
    }
    let broken = python("python-broken", "exit 3");
    expect(&solve("broken", "pycolmap", &broken), 2, &["pycolmap's feature_extractor", "exit status: 3", ".log"]);
}

/// A project whose GCPs are as good as they are drawn, with few features and pairs.
fn sharpened(project: &str) -> String {
    project
        .replace("sigma_ground_m = 25.0", "sigma_ground_m = 0.1")
        .replace("sigma_image_px = 5.0", "sigma_image_px = 0.5")
        .replace("features = 6000", "features = 1500")
        .replace("neighbours = 3", "neighbours = 2")
}

fn without_table(project: &str) -> String {
    let (before, after) = project.split_once("[rough]").expect("there is a table");
    format!("{before}[{}", after.split_once("\n[").expect("another part").1)
}

/// Drawn frames become cameras by pycolmap too, with a table and without.
#[test]
fn frames_become_cameras_by_pycolmap() {
    let python = std::env::var("AUTOREF_PYTHON").unwrap_or_else(|_| "python3".into());
    let there = Command::new(&python).args(["-c", "import pycolmap"]).output();
    if !there.is_ok_and(|output| output.status.success()) {
        skipped("no pycolmap in AUTOREF_PYTHON: no frames were solved by it");
        return;
    }
    let place = Place::new();
    place.flight.render(&place.at("frames"), &[0, 1, 2, 3, 4]);
    let toml = place.init();
    let sharp = sharpened(&std::fs::read_to_string(&toml).expect("there"));
    for project in [&sharp, &without_table(&sharp)] {
        std::fs::write(&toml, project).expect("written");
        let out = place.at("out");
        let arguments =
            ["flight", "solve", text(&toml), "-o", text(&out), "--engine", "pycolmap", "--overwrite", "--json"];
        let output = autoref(&arguments, None, &[]);
        expect(&output, 0, &[]);
        let document = json(&output);
        assert_eq!(document["frames_registered"], 5);
        let worst = place.flight.worst_camera_m(&document);
        assert!(worst < 4.0, "{worst:.2} m");
    }
}

/// Killed in the middle by COLMAP itself: what was done before is kept, and the end is the same. The stand-in of
/// [`Place::stand_in`] is killed at every stage.
fn killed_and_resumed(place: &Place, document: &Value, solve: impl Fn(&str, &[(&str, &str)], Option<&Path>) -> Output) {
    let bin = place.at("killer");
    std::fs::create_dir_all(&bin).expect("a folder");
    let script =
        "#!/bin/sh\nif [ \"$1\" = matches_importer ]; then kill -9 $PPID; exit 0; fi\nexec \"$COLMAP\" \"$@\"\n";
    write_program(&bin.join("colmap"), script);
    let path = std::env::var("PATH").unwrap_or_default();
    let real = std::env::split_paths(&path).map(|p| p.join("colmap")).find(|p| p.is_file()).expect("it answered");
    assert_eq!(solve("killed", &[("COLMAP", text(&real))], Some(&bin)).status.code(), None, "killed");
    let resumed = solve("killed", &[], None);
    expect(&resumed, 0, &["rough_ties: taken from before", "rough_features.db: taken from before"]);
    let again = json(&resumed);
    assert_eq!(again["frames_registered"], document["frames_registered"]);
    let cameras = |document: &Value| document["cameras"].as_array().expect("cameras").clone();
    for (a, b) in cameras(&again).into_iter().zip(cameras(document)) {
        for axis in ["e", "n", "h"] {
            let apart = a[axis].as_f64().expect("a number") - b[axis].as_f64().expect("a number");
            assert!(apart.abs() < 1e-3, "{axis} of {}: {apart:.6} m", a["name"]);
        }
    }
}

/// Drawn frames, their project, and its text with GCPs as good as they are drawn; `None` where COLMAP is not there.
fn drawn() -> Option<(Place, PathBuf, String)> {
    if Command::new("colmap").arg("help").output().is_err() {
        skipped("`colmap` is not installed: no frames were solved");
        return None;
    }
    let place = Place::new();
    place.flight.render(&place.at("frames"), &[0, 1, 2, 3, 4]);
    let toml = place.init();
    let sharp = sharpened(&std::fs::read_to_string(&toml).expect("there"));
    Some((place, toml, sharp))
}

/// Where the table's directions warp neighbours away from each other, frames are matched as they are; COLMAP's files
/// that are cut anywhere are refused.
#[test]
fn frames_of_which_the_table_has_wrong_directions_are_matched_as_they_are() {
    let Some((place, toml, sharp)) = drawn() else { return };
    // So sure of its positions, the table leaves little room to find what is elsewhere.
    std::fs::write(&toml, sharp.replace("sigma_m = 200.0", "sigma_m = 10.0")).expect("written");
    let table = std::fs::read_to_string(place.at("table.csv")).expect("there");
    place.write("table.csv", &table.lines().map(|row| turned(row, &["f1.png", "f3.png"])).collect::<String>());
    let output = autoref(&["flight", "solve", text(&toml), "-o", text(&place.at("out")), "--json"], None, &[]);
    expect(&output, 0, &["plain_features.db"]);
    let document = json(&output);
    assert!(document["notes"].to_string().contains("the table's direction of 2 of 5 frames"), "{}", document["notes"]);
    assert_eq!(document["frames_registered"], 5);
    let worst = place.flight.worst_camera_m(&document);
    assert!(worst < 4.0 && document.get("pairs").is_none(), "{worst:.2} m");
    let stage = std::fs::read_to_string(place.at("out/stages/relative.json")).expect("written");
    assert!(stage.contains("of frames matched as they are"), "{stage}");
    // COLMAP's binary model, cut at many places; at one of them by the program too.
    let sparse = place.at("out").join("plain_sparse").join("0");
    let gcps = place.at("gcps.txt");
    for (name, asked) in [("cameras.bin", 0), ("images.bin", 30), ("points3D.bin", 99)] {
        let whole = std::fs::read(sparse.join(name)).expect("there");
        for part in [0, 3, 30, 60, 99] {
            std::fs::write(sparse.join(name), &whole[..whole.len() * part / 100]).expect("written");
            let refused = autoref_flight::read::reconstruction(&sparse).expect_err("cut").to_string();
            assert!(refused.contains(name), "{part} %: {refused}");
            if part == asked {
                let output = autoref(&["flight", "adjust", text(&sparse), "--gcps", text(&gcps)], None, &[]);
                expect(&output, 2, &[name]);
            }
        }
        std::fs::write(sparse.join(name), &whole).expect("written");
    }
}

/// From drawn frames to cameras, by COLMAP itself; with AUTOREF_LARGE=1 also without a table, and killed before it
/// checks the ties and resumed: the same cameras.
#[test]
fn frames_become_cameras() {
    let Some((place, toml, sharp)) = drawn() else { return };
    let list = sharp.replace("sigma_ground_m = 0.1", "sigma_ground_m = 0.1\ncheck = [\"G1\", \"G6\"]");
    std::fs::write(&toml, list).expect("written");
    let solve = |out: &str, words: &[(&str, &str)], bin: Option<&Path>| {
        autoref(&["flight", "solve", text(&toml), "-o", text(&place.at(out)), "--json"], bin, words)
    };
    let output = solve("out", &[], None);
    expect(&output, 0, &[]);
    let document = json(&output);
    has_the_keys(&document);
    assert_eq!((&document["frames_registered"], &document["frames_listed"]), (&5.into(), &5.into()));
    assert!(document["reprojection_rms_px"].as_f64().is_some_and(|r| r < 1.0), "{}", document["reprojection_rms_px"]);
    let pairs = document["pairs"].as_array().expect("a list");
    let tied = |pair: &Value| pair["frames"].as_array().map_or(0, Vec::len) == 2 && pair["ties"].as_u64() > Some(20);
    assert!(pairs.iter().filter(|pair| tied(pair)).count() >= 4, "{pairs:?}");
    let lines = document["lines"].as_array().expect("a list");
    let frames = |line: &Value| line["frames"].as_array().map_or(0, Vec::len);
    assert_eq!(lines.iter().map(frames).collect::<Vec<_>>(), [5], "{lines:?}");
    assert_eq!(lines[0]["gcp_statistics"], document["gcp_statistics"]);
    let differences = document["rough_differences"]["frames"].as_array().expect("a list");
    assert!(differences.len() == 5 && differences.iter().all(|d| d["d_m"].as_f64() < Some(30.0)), "{differences:?}");
    let outlines: Value =
        serde_json::from_slice(&std::fs::read(place.at("out").join("footprints.geojson")).expect("written"))
            .expect("JSON");
    for (feature, camera) in
        outlines["features"].as_array().expect("a list").iter().zip(&place.flight.model.photographs)
    {
        assert_eq!(feature["properties"]["name"], camera.name.as_str());
        assert_eq!(feature["geometry"]["coordinates"][0].as_array().map(Vec::len), Some(49), "{feature}");
    }
    let page = std::fs::read_to_string(place.at("out").join("flight.html")).expect("written");
    assert!(page.contains("G1") && page.contains("f4.png") && page.contains("rough table"));
    let worst = place.flight.worst_camera_m(&document);
    let check = document["check_point_statistics"]["d"]["rms"].as_f64().expect("check points");
    let f = document["cameras"][0]["f_px"].as_f64().expect("a number");
    assert!(worst < 4.0 && check < 1.0 && (f / F_PX - 1.0).abs() < 0.01, "{worst:.2} m, {check:.2} m, f {f:.2}");
    if large() {
        killed_and_resumed(&place, &document, solve);
        // Without a table COLMAP's mapper orients them.
        let project = std::fs::read_to_string(&toml).expect("there");
        std::fs::write(&toml, without_table(&project)).expect("written");
        let plain = solve("plain", &[], None);
        expect(&plain, 0, &[]);
        let (document, worst) = (json(&plain), place.flight.worst_camera_m(&json(&plain)));
        assert_eq!(document["frames_registered"], 5);
        assert!(worst < 4.0 && document.get("pairs").is_none(), "{worst:.2} m");
    }
}
