//! `flight resect`: one frame placed by its points.

use std::path::Path;
use std::process::Command;

use super::{Flight, Place, autoref, expect, json, text};
use crate::common::data;
use autoref_raster::crs::{Coordinate, Crs};
use nalgebra::Vector3;
use serde_json::Value;

#[test]
fn resect_places_a_frame_and_names_the_blunder() {
    let place = Place::new();
    let gcps = place.at("gcps.txt");
    let resect = |frame: &str, gcps: &Path, more: &[&str]| {
        let some = ["flight", "resect", frame, "--gcps", text(gcps), "--f-px", "500", "--size", "480,480", "--json"];
        autoref(&[&some, more].concat(), None, &[])
    };
    let output = resect("f2.png", &gcps, &[]);
    expect(&output, 0, &[]);
    for size in ["-480,480", "0,0", "480.5,480", "1e9,480"] {
        let size = format!("--size={size}");
        let words = ["flight", "resect", "f2.png", "--gcps", text(&gcps), "--f-px", "500", &size];
        expect(&autoref(&words, None, &[]), 2, &["--size", "whole pixels"]);
    }
    let document = json(&output);
    let truth = place.flight.model.photographs[2].pose;
    let off = |d: &Value| {
        (Vector3::from_iterator((0..3).map(|i| d["C"][i].as_f64().expect("a number"))) - truth.centre).norm()
    };
    assert!(off(&document) < 0.1 && document["blunders"].as_array().is_some_and(Vec::is_empty), "{document}");
    for key in ["name", "e", "n", "h", "yaw_deg", "pitch_deg", "roll_deg", "C", "R", "f_px", "rms_px"] {
        assert!(!document[key].is_null(), "{key}");
    }
    let mut flight = Flight::new();
    let gcp = flight.gcps.iter_mut().find(|g| g.2.iter().any(|s| s.0 == 2)).expect("seen");
    gcp.2.iter_mut().find(|s| s.0 == 2).expect("seen").1[1] += 60.0;
    let wrong = gcp.0.clone();
    let list = place.write("wrong.txt", &flight.gcp_list());
    let document = json(&resect("f2.png", &list, &[]));
    assert!(document["blunders"] == serde_json::json!([wrong]) && off(&document) < 1.0, "{document}");
    expect(&resect("f9.png", &gcps, &[]), 1, &["f9.png", "gcps.txt"]);
    // A point that is measured twice in one frame, at two places.
    let once = place.flight.gcp_list();
    let row = once.lines().find(|l| l.contains("f2.png")).expect("a point of the frame");
    let again: Vec<String> =
        row.split(' ').enumerate().map(|(i, word)| if i == 3 { "7".into() } else { word.into() }).collect();
    let twice = place.write("twice.txt", &format!("{once}{}\n", again.join(" ")));
    expect(&resect("f2.png", &twice, &[]), 2, &["is measured twice in f2.png"]);
    let two: String = place
        .flight
        .gcp_list()
        .lines()
        .filter(|l| l.contains("f2.png"))
        .take(2)
        .fold("local\n".into(), |all, l| all + l + "\n");
    expect(&resect("f2.png", &place.write("two.txt", &two), &[]), 1, &["3 are needed"]);
    expect(&resect("f2.png", &gcps, &["--pp-px", "1"]), 2, &["--pp-px"]);
    for sigma in ["0", "nan", "-1"] {
        let at = ["--position", "0,0,100", &format!("--sigma-position={sigma}")];
        expect(&resect("f2.png", &gcps, &at), 2, &["--sigma-position"]);
    }
}

/// What a list says of its points counts where one frame is placed too: check points, accuracies, and three points that
/// several poses see.
#[test]
fn resect_heeds_what_the_list_says() {
    let place = Place::new();
    let table = |sigma: &dyn Fn(usize) -> &'static str, off_m: &dyn Fn(usize) -> f64, check: Option<usize>| {
        let mut text = String::from("name,x,y,z,image,px,py,role,sigma_m\n");
        let seen = place.flight.gcps.iter().filter_map(|(name, xyz, seen)| {
            let at = seen.iter().find(|(frame, _)| *frame == 2)?.1;
            Some((name, xyz, at))
        });
        for (i, (name, xyz, at)) in seen.enumerate() {
            let role = if check == Some(i) { "check" } else { "control" };
            let x = xyz.x + off_m(i);
            let row = format!("{name},{x},{},{},f2.png,{},{},{role},{}\n", xyz.y, xyz.z, at[0], at[1], sigma(i));
            text.push_str(&row);
        }
        place.write("points.csv", &text)
    };
    let resect = |list: &Path| {
        let frame = ["f2.png", "--f-px", "500", "--size", "480,480", "--json", "--sigma-image", "0.1"];
        let output = autoref(&[&["flight", "resect", "--gcps", text(list)][..], &frame].concat(), None, &[]);
        expect(&output, 0, &[]);
        json(&output)
    };
    let truth = place.flight.model.photographs[2].pose.centre;
    let off =
        |d: &Value| (Vector3::from_iterator((0..3).map(|i| d["C"][i].as_f64().expect("a number"))) - truth).norm();
    // Two of six are coarse, say so, and are 20 m off.
    let coarse = |i: usize| i % 3 == 1;
    let found =
        resect(&table(&|i| if coarse(i) { "20" } else { "0.02" }, &|i| if coarse(i) { 20.0 } else { 0.0 }, None));
    assert!(off(&found) < 1.0 && found["blunders"] == serde_json::json!([]), "{found}");
    // A wrong check point takes no part, and shows what it misses.
    let found = resect(&table(&|_| "", &|i| if i == 1 { 50.0 } else { 0.0 }, Some(1)));
    assert!(off(&found) < 0.1 && found["blunders"] == serde_json::json!([]), "{found}");
    let check = &found["check_points"][0];
    assert!(check["d_px"].as_f64().expect("a number") > 5.0, "{found}");
    let three: String = std::fs::read_to_string(table(&|_| "", &|_| 0.0, None))
        .expect("written")
        .lines()
        .take(4)
        .fold(String::new(), |all, line| all + line + "\n");
    let found = resect(&place.write("three.csv", &three));
    let poses = found["alternatives"].as_array().expect("a list");
    let nearest = poses.iter().chain([&found]).map(off).fold(f64::INFINITY, f64::min);
    assert!(nearest < 1.0, "one of them is right: {found}");
    assert_eq!(poses.is_empty(), !found["notes"].to_string().contains("alternatives"), "{found}");
}

/// Ten points clicked in a photograph of a glacier, one of them 150 px off.
#[test]
fn the_wrong_point_of_kronebreen_is_named() {
    let Some(list) = data("oblique_svalbard/KR1_2014.txt") else { return };
    let interior = ["--f-px", "6248", "--pp-px", "2575.84,1473.41", "--distortion", "k1=-0.1322,k2=0.3939,k3=-0.8149"];
    let held = ["--position", "447618.893,8759606.114,410.523", "--sigma-position", "20"];
    for (case, more) in [("position held", [&interior[..], &held[..]].concat()), ("free", interior.to_vec())] {
        let some = ["flight", "resect", "KR1_2014.JPG", "--gcps", text(&list), "--size", "5184,3456", "--json"];
        let output = autoref(&[&some, &more[..]].concat(), None, &[]);
        expect(&output, 0, &[]);
        let document = json(&output);
        let blunders: Vec<&str> =
            document["blunders"].as_array().expect("a list").iter().filter_map(Value::as_str).collect();
        assert_eq!(blunders, ["4"], "{case}: {document}");
        assert_eq!(document["gcps"].as_array().map(Vec::len), Some(10));
    }
}

/// Lists that other programs wrote another way round: told, mended where only one reading can be, or refused.
#[test]
fn resect_tells_what_cannot_be() {
    let place = Place::new();
    let list = |name: &str, crs: &str, of: &dyn Fn([f64; 3], [f64; 2]) -> ([f64; 3], [f64; 2])| {
        let mut text = format!("{crs}\n");
        for (gcp, xyz, seen) in &place.flight.gcps {
            if let Some((_, at)) = seen.iter().find(|(frame, _)| *frame == 2) {
                let ([x, y, z], [px, py]) = of([xyz.x, xyz.y, xyz.z], *at);
                text.push_str(&format!("{x} {y} {z} {px} {py} f2.png {gcp}\n"));
            }
        }
        place.write(name, &text)
    };
    let resect = |list: &Path| {
        let some = ["flight", "resect", "f2.png", "--gcps", text(list), "--f-px", "500", "--size", "480,480", "--json"];
        autoref(&some, None, &[])
    };
    let truth = place.flight.model.photographs[2].pose.centre;
    let off = |d: &Value, origin: [f64; 3]| {
        let at = (0..3).map(|i| d["C"][i].as_f64().expect("a number") - origin[i]);
        (Vector3::from_iterator(at) - truth).norm()
    };
    let (east, north) = (500_000.0, 6_600_000.0);
    let swapped =
        list("swapped.txt", "EPSG:32633", &|[x, y, z], [px, py]| ([y + north, x + east, z], [px - 0.5, py - 0.5]));
    let output = resect(&swapped);
    expect(&output, 0, &["swapped.txt", "northing comes before easting"]);
    assert!(off(&json(&output), [east, north, 0.0]) < 0.5, "{}", json(&output));
    let geocentric =
        list("ecef.txt", "EPSG:32633", &|[x, y, z], at| ([3_744_360.0 + x, -4_371_868.0 + y, -2_740_228.0 + z], at));
    expect(&resect(&geocentric), 2, &["ecef.txt", "centre of the Earth"]);
    let elsewhere = list("elsewhere.txt", "EPSG:32633", &|[x, y, z], at| ([9e6 + x, 9e6 + y, z], at));
    expect(&resect(&elsewhere), 2, &["elsewhere.txt", "outside the area of use of EPSG:32633", "--crs"]);
    let upwards = list("upwards.txt", "local", &|xyz, [px, py]| (xyz, [px, -py]));
    expect(&resect(&upwards), 2, &["upwards.txt", "lie outside their frames", "counts upwards"]);
    let larger = list("larger.txt", "local", &|xyz, [px, py]| (xyz, [4.0 * px, 4.0 * py]));
    expect(&resect(&larger), 2, &["larger.txt", "lie outside their frames", "480 x 480 px"]);
    let first = std::cell::Cell::new(true);
    let one = list("one.txt", "local", &|xyz, at| (xyz, if first.replace(false) { [900.0, at[1]] } else { at }));
    let output = resect(&one);
    expect(&output, 0, &["one.txt: 1 of", "are left out"]);
    let document = json(&output);
    assert!(off(&document, [0.0; 3]) < 0.2 && document["notes"][0].to_string().contains("left out"), "{document}");
    let mirrored = list("mirrored.txt", "local", &|xyz, [px, py]| (xyz, [px, 480.0 - py]));
    let output = resect(&mirrored);
    if output.status.code() == Some(0) {
        let notes = json(&output)["notes"].to_string();
        assert!(notes.contains("below all points") || notes.contains("do not trust"), "{notes}");
    }
}

/// A file that `--camera` names is that camera, or refused: what lies beside it is another's.
#[test]
fn a_camera_file_is_read_or_refused() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let (model, gcps) = (place.at("model"), place.at("gcps.txt"));
    let resect = |camera: &Path| {
        let some = ["flight", "resect", "f2.png", "--gcps", text(&gcps), "--camera", text(camera), "--json"];
        autoref(&some, None, &[])
    };
    let own = place.at("cameras.json");
    let some = ["flight", "adjust", text(&model), "--gcps", text(&gcps), "--free", "none", "-o", text(&own)];
    expect(&autoref(&some, None, &[]), 0, &[]);
    let output = resect(&own);
    expect(&output, 0, &[]);
    let (f_px, truth) = (json(&output)["f_px"].as_f64(), place.flight.model.cameras[0].f_px());
    assert!(f_px.is_some_and(|f| (f - truth).abs() < 1e-6), "{f_px:?}");
    // OpenDroneMap's file of the same name has cameras and no frames.
    let lens = |width: u32| {
        format!(
            r#"{{"v2 a": {{"projection_type": "brown", "width": {width}, "height": 480, "focal_x": 1.25, "focal_y": 1.25}}}}"#
        )
    };
    std::fs::create_dir(place.at("odm")).expect("a folder");
    let output = resect(&place.write("odm/cameras.json", &lens(480)));
    expect(&output, 0, &[]);
    assert_eq!(json(&output)["f_px"].as_f64(), Some(600.0));
    let odm = place.at("odm/cameras.json");
    let some = ["flight", "adjust", text(&odm), "--gcps", text(&gcps)];
    expect(&autoref(&some, None, &[]), 2, &["cameras.json", "no frames", "--camera,"]);
    expect(&resect(&place.write("odm/cameras.json", &lens(0))), 2, &["cameras.json", "`v2 a`", "width"]);
    // A calibration that is not read, beside an orientation whose camera is.
    std::fs::create_dir(place.at("Ori")).expect("a folder");
    let calibration = |model: &str| {
        format!(
            "<CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv><PP>240 240</PP><F>500</F>\
             <SzIm>480 480</SzIm><CalibDistortion>{model}</CalibDistortion></CalibrationInternConique>"
        )
    };
    place.write("Ori/AutoCal.xml", &calibration("<ModNoDist/>"));
    place.write(
        "Ori/Orientation-f2.png.xml",
        "<OrientationConique><FileInterne>AutoCal.xml</FileInterne><Externe><Centre>0 0 0</Centre><ParamRotation>\
         <CodageMatr><L1>1 0 0</L1><L2>0 1 0</L2><L3>0 0 1</L3></CodageMatr></ParamRotation></Externe>\
         </OrientationConique>",
    );
    expect(&resect(&place.at("Ori/Orientation-f2.png.xml")), 0, &[]);
    // A frame of half the size is of the same lens; of another shape it is of another camera.
    let halves: String = place.flight.gcp_list().lines().fold(String::new(), |all, line| {
        let words: Vec<String> = line
            .split(' ')
            .enumerate()
            .map(|(i, word)| match word.parse::<f64>() {
                Ok(px) if i == 3 || i == 4 => (px / 2.0).to_string(),
                _ => word.to_string(),
            })
            .collect();
        all + &words.join(" ") + "\n"
    });
    let halves = place.write("halves.txt", &halves);
    let of_size = |size: &str| {
        let some =
            ["flight", "resect", "f2.png", "--gcps", text(&halves), "--camera", text(&own), "--size", size, "--json"];
        autoref(&some, None, &[])
    };
    let output = of_size("240,240");
    expect(&output, 0, &[]);
    let f_px = json(&output)["f_px"].as_f64();
    assert!(f_px.is_some_and(|f| (f - truth / 2.0).abs() < 1e-6), "{f_px:?}");
    expect(&of_size("240,120"), 2, &["240 x 120", "480 x 480"]);
    // MicMac's calibration in the folder of a frame is taken, and named.
    std::fs::create_dir(place.at("beside")).expect("a folder");
    place.write("beside/AutoCal_f.xml", &calibration("<ModNoDist/>"));
    let beside = |frame: &str| {
        Command::new(env!("CARGO_BIN_EXE_autoref-stream"))
            .args(["flight", "resect", frame, "--gcps", text(&gcps), "--size", "480,480", "--json"])
            .current_dir(place.at("beside"))
            .output()
            .expect("the program starts")
    };
    for output in ["f2.png", "./f2.png"].map(beside) {
        expect(&output, 0, &[]);
        let document = json(&output);
        assert!(document["f_px"] == 500.0 && document["notes"].to_string().contains("AutoCal_f.xml"), "{document}");
    }
    let grid = place.write("Ori/Grid.xml", &calibration("<ModGrid/>"));
    expect(&resect(&grid), 2, &["Grid.xml", "<ModGrid>", "FraserBasic"]);
}

/// OpenSfM's list has longitudes and latitudes: the frame is placed on their map, as by any other list of such.
#[test]
fn opensfms_points_are_on_the_map() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (east, north, up, f_px) = (574_800.0, 5_317_000.0, 1500.0, 2400.0);
    let at = [(-300.0, -200.0, 510.0), (280.0, -150.0, 620.0), (250.0, 190.0, 540.0), (-260.0, 210.0, 600.0)];
    let [utm, lon_lat] = [32632, 4326].map(|code| Crs::from_epsg(code).expect("known"));
    let points = at.iter().enumerate().map(|(i, (e, n, h))| {
        let mut place = [Coordinate { x: east + e, y: north + n, height: None }];
        utm.transform(&mut place, &lon_lat, 10.0).expect("within");
        let [x, y] = [e / (up - h), -n / (up - h)].map(|tangent| tangent * f_px / 3000.0);
        serde_json::json!({
            "id": format!("P{i}"),
            "position": {"longitude": place[0].x, "latitude": place[0].y, "altitude": h},
            "observations": [{"shot_id": "a.jpg", "projection": [x, y]}],
        })
    });
    let list = folder.path().join("ground_control_points.json");
    let points: Vec<Value> = points.collect();
    std::fs::write(&list, serde_json::json!({"points": points}).to_string()).expect("writable");
    let resect = |more: &[&str]| {
        let some =
            ["flight", "resect", "a.jpg", "--gcps", text(&list), "--f-px", "2400", "--size", "3000,2000", "--json"];
        autoref(&[&some, more].concat(), None, &[])
    };
    let output = resect(&[]);
    expect(&output, 0, &[]);
    let document = json(&output);
    assert!(document["crs"].to_string().contains("32632"), "{document}");
    let off = |key: &str, truth: f64| (document[key].as_f64().expect("a number") - truth).abs();
    // A metre of the map is 0.9996 of one on the ground.
    assert!(off("e", east) < 0.5 && off("n", north) < 0.5 && off("h", up) < 1.0, "{document}");
    expect(&resect(&["--crs", "EPSG:2263"]), 2, &["WGS 84", "--crs has no effect"]);
}
