//! `flight adjust`: a model on the ground, its blunders, and what is wrong with its input.

use std::path::Path;

use super::{Flight, Place, autoref, expect, has_the_keys, json, said, text};
use nalgebra::Vector3;
use serde_json::Value;

#[test]
fn adjust_brings_a_model_to_the_ground() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let (model, gcps, out) = (place.at("model"), place.at("gcps.txt"), place.at("cameras.json"));
    let arguments = [
        "flight",
        "adjust",
        text(&model),
        "--gcps",
        text(&gcps),
        "--sigma-ground",
        "0.05",
        "--check",
        "G2,G5",
        "-o",
        text(&out),
        "--json",
    ];
    let output = autoref(&arguments, None, &[]);
    expect(&output, 0, &[]);
    let document = json(&output);
    has_the_keys(&document);
    assert!(place.flight.worst_camera_m(&document) < 0.05, "{}", place.flight.worst_camera_m(&document));
    let checks: Vec<&str> =
        document["check_points"].as_array().expect("a list").iter().filter_map(|c| c["name"].as_str()).collect();
    assert_eq!(checks, ["G2", "G5"]);
    assert!(document["blunders"].as_array().is_some_and(Vec::is_empty), "{}", document["blunders"]);
    assert_eq!(serde_json::from_slice::<Value>(&std::fs::read(&out).expect("written")).expect("JSON"), document);
    expect(&autoref(&arguments, None, &[]), 2, &["cameras.json exists", "--overwrite"]);
    // cameras.json is a reconstruction too; without ties, GCPs alone hold it.
    let again =
        autoref(&["flight", "adjust", text(&out), "--gcps", text(&gcps), "--free", "none", "--json"], None, &[]);
    expect(&again, 0, &[]);
    let notes = json(&again)["notes"].to_string();
    assert!(notes.contains("its interior orientation is held, and standard deviations take it for exact"), "{notes}");
}

#[test]
fn adjust_names_the_wrong_gcp_and_frame() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let mut flight = Flight::new();
    let (frame, pixel) = &mut flight.gcps[3].2[1];
    pixel[0] += 14.0;
    let wrong = flight.model.photographs[*frame].name.clone();
    flight.gcps[6].1.z += 30.0;
    let list = place.write("wrong.txt", &flight.gcp_list());
    let output = autoref(
        &["flight", "adjust", text(&place.at("model")), "--gcps", text(&list), "--sigma-ground", "0.5", "--json"],
        None,
        &[],
    );
    expect(&output, 0, &[]);
    let document = json(&output);
    let named: Vec<(&str, Option<&str>)> = document["blunders"]
        .as_array()
        .expect("a list")
        .iter()
        .map(|b| (b["gcp"].as_str().expect("a name"), b["frame"].as_str()))
        .collect();
    assert!(named.len() == 2 && named.contains(&("G3", Some(&wrong))) && named.contains(&("G6", None)), "{named:?}");
    let output = autoref(
        &["flight", "adjust", text(&place.at("model")), "--gcps", text(&list), "--sigma-ground", "0.5"],
        None,
        &[],
    );
    expect(&output, 0, &[&format!("blunder: GCP G3 in {wrong}"), "blunder: GCP G6 on the ground"]);
}

/// A point measured on another one's mark, its survey so rough that any pixel of the frame agrees with it: the other
/// rays tell, and nothing runs away.
#[test]
fn a_ray_that_passes_the_others_is_named_however_rough_the_survey() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let several: Vec<usize> = (0..8).filter(|k| place.flight.gcps[*k].2.len() >= 3).collect();
    assert!(several.len() >= 4, "{several:?}");
    for k in several {
        let mut flight = Flight::new();
        flight.gcps[k].2.truncate(3);
        let (frame, right) = flight.gcps[k].2[1];
        let in_frame = |gcp: &super::DrawnGcp| gcp.2.iter().find(|(f, _)| *f == frame).map(|seen| seen.1);
        let far = |at: &[f64; 2]| (at[0] - right[0]).hypot(at[1] - right[1]) > 60.0;
        let Some(other) = flight.gcps.iter().filter_map(in_frame).find(far) else { continue };
        flight.gcps[k].2[1].1 = other;
        let list = place.write("wrong.txt", &flight.gcp_list());
        let model = place.at("model");
        let words = ["flight", "adjust", text(&model), "--gcps", text(&list), "--json"];
        let output = autoref(&[&words[..], &["--sigma-ground", "400", "--sigma-image", "0.2"]].concat(), None, &[]);
        expect(&output, 0, &[]);
        let document = json(&output);
        let named: Vec<(&str, &str)> = document["blunders"]
            .as_array()
            .expect("a list")
            .iter()
            .map(|b| (b["gcp"].as_str().expect("a name"), b["frame"].as_str().expect("an image point")))
            .collect();
        assert_eq!(named, [(flight.gcps[k].0.as_str(), flight.model.photographs[frame].name.as_str())]);
        assert_eq!(document["ended"], "converged");
        let worst = document["gcp_statistics"]["d"]["max"].as_f64().expect("GCPs");
        assert!(worst < 1.0 && place.flight.worst_camera_m(&document) < 1.0, "G{k}: {worst} m");
    }
}

#[test]
fn adjust_says_what_is_wrong_with_its_input() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let (model, gcps) = (place.at("model"), place.at("gcps.txt"));
    let adjust = |model: &Path, gcps: &Path, more: &[&str]| {
        autoref(&[&["flight", "adjust", text(model), "--gcps", text(gcps), "--json"], more].concat(), None, &[])
    };
    // One frame that nobody knows is a note, a list of such frames is an error.
    let one = place.write("one.txt", &(place.flight.gcp_list() + "1100 2000 5 10 10 other.png G9\n"));
    let output = adjust(&model, &one, &[]);
    expect(&output, 0, &["other.png"]);
    assert!(json(&output)["notes"].to_string().contains("other.png"));
    let all = place.write("all.txt", &place.flight.gcp_list().replace(" f", " g"));
    let output = adjust(&model, &all, &[]);
    expect(&output, 2, &["all.txt", "g0.png"]);
    assert!(json(&output)["error"]["message"].as_str().is_some_and(|m| m.contains("all.txt")));
    expect(&adjust(&model, &gcps, &["--check", "G77"]), 2, &["gcps.txt", "G77"]);
    expect(&adjust(&model, &gcps, &["--free", "q9"]), 2, &["q9"]);
    expect(&adjust(&place.at("nothing"), &gcps, &[]), 2, &["nothing"]);
    expect(&adjust(&model, &place.at("nothing.txt"), &[]), 2, &["nothing.txt"]);
    let far = place.write("far.txt", &(place.flight.gcp_list() + "1e300 2000 5 10 10 f0.png G9\n"));
    let row = format!("row {}", place.flight.gcp_list().lines().count() + 1);
    expect(&adjust(&model, &far, &[]), 2, &["far.txt", &row, "1e300", "no place"]);
    // A point above a camera that looks down is seen nowhere: no number of pixels says by how much it is wrong.
    let above = place.write("above.txt", &(place.flight.gcp_list() + "1100 2000 90000 240 240 f2.png G9\n"));
    let output = autoref(&["flight", "adjust", text(&model), "--gcps", text(&above)], None, &[]);
    expect(&output, 0, &["blunder: GCP G9 in f2.png: the camera looks away from it"]);
    assert!(!said(&output).contains("(-"), "{}", said(&output));
    assert!(json(&adjust(&model, &above, &[]))["blunders"][0]["by_px"].is_null());
    // Two GCPs do not place a block: it ran, and there is no result.
    let few: String = place
        .flight
        .gcp_list()
        .lines()
        .filter(|l| !l.contains("G") || l.ends_with("G0") || l.ends_with("G1"))
        .fold(String::new(), |all, l| all + l + "\n");
    let output = adjust(&model, &place.write("few.txt", &few), &[]);
    expect(&output, 1, &["3 are needed"]);
    assert_eq!(json(&output)["error"]["kind"], "refused");
    // Truncated in the middle of a row, of every file.
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        let cut = place.at(&format!("cut-{name}"));
        place.flight.write_model(&cut);
        let whole = std::fs::read(cut.join(name)).expect("there");
        std::fs::write(cut.join(name), &whole[..whole.len() * 7 / 10]).expect("written");
        let output = adjust(&cut, &gcps, &[]);
        assert!(matches!(output.status.code(), Some(0 | 2)), "{name}: {}", said(&output));
        if output.status.code() == Some(2) {
            expect(&output, 2, &["cut-"]);
        }
    }
}

/// A table without directions, and one without the whole direction, fix where cameras stand.
#[test]
fn positions_count_alone() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let (mut places, mut partly) = (String::from("name,x,y,z\n"), String::from("name,x,y,z,yaw,pitch\n"));
    for p in &place.flight.model.photographs {
        let (c, a) = (p.pose.centre, p.pose.yaw_pitch_roll());
        places += &format!("{},{},{},{}\n", p.name, c.x, c.y, c.z);
        partly += &format!("{},{},{},{},{},{}\n", p.name, c.x, c.y, c.z, a.yaw_deg + 40.0, a.pitch_deg);
    }
    let (model, gcps) = (place.at("model"), place.at("gcps.txt"));
    let adjusted = |table: &str| {
        let table = place.write("places.csv", table);
        let words = ["flight", "adjust", text(&model), "--gcps", text(&gcps), "--cameras", text(&table), "--json"];
        autoref(&[&words[..], &["--sigma-position", "0.01", "--sigma-ground", "20"]].concat(), None, &[])
    };
    for table in [&places, &partly] {
        let output = adjusted(table);
        expect(&output, 0, &[]);
        let document = json(&output);
        let sigma = document["cameras"][0]["sigma_e"].as_f64().expect("a number");
        assert!(place.flight.worst_camera_m(&document) < 0.05 && sigma < 0.02, "{sigma}: {table}");
    }
    expect(&adjusted("name,x,y,z\nother.png,1,2,3\n"), 2, &["places.csv", "none of its names (other.png)"]);
    // Two directions of one frame: alike, and another.
    let both = |yaw_deg: f64| {
        place.flight.model.photographs.iter().fold(
            "name,x,y,z,omega,phi,kappa,yaw,pitch,roll\n".into(),
            |all: String, p| {
                let (c, a, [o, f, k]) = (p.pose.centre, p.pose.yaw_pitch_roll(), p.pose.omega_phi_kappa());
                let view = format!("{},{},{}", a.yaw_deg + yaw_deg, a.pitch_deg, a.roll_deg);
                format!("{all}{},{},{},{},{o},{f},{k},{view}\n", p.name, c.x, c.y, c.z)
            },
        )
    };
    expect(&adjusted(&both(0.0)), 0, &[]);
    expect(&adjusted(&both(90.0)), 2, &["places.csv", "`f0.png`", "90.0 degrees apart"]);
    let twice = places.clone() + "f0.png,1,2,3\n";
    expect(&adjusted(&twice), 2, &["places.csv", "`f0.png` has row 2 already"]);
}

/// Without GCPs the positions of the table place the block, and the result says so.
#[test]
fn positions_alone_place_a_block() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let (model, table) = (place.at("model"), place.write("table.csv", &place.flight.table()));
    let adjust = |more: &[&str]| autoref(&[&["flight", "adjust", text(&model), "--json"], more].concat(), None, &[]);
    let output = adjust(&["--cameras", text(&table)]);
    expect(&output, 0, &[]);
    let document = json(&output);
    assert!(document["notes"].to_string().contains("no GCPs"), "{}", document["notes"]);
    let sigma_m = document["cameras"][2]["sigma_e"].as_f64().expect("a number");
    let worst_m = place.flight.worst_camera_m(&document);
    assert!((2.0..30.0).contains(&sigma_m) && worst_m < 4.0 * sigma_m, "{worst_m} m, stated {sigma_m} m");
    // One row is 900 m off; the others tell, and it pulls at nothing.
    let wrong: String = place.flight.table().lines().fold(String::new(), |all, line| {
        let mut cells: Vec<String> = line.split(',').map(str::to_string).collect();
        if cells[0] == place.flight.model.photographs[2].name {
            cells[1] = (cells[1].parse::<f64>().expect("a number") + 900.0).to_string();
        }
        all + &cells.join(",") + "\n"
    });
    let output = adjust(&["--cameras", text(&place.write("wrong.csv", &wrong))]);
    expect(&output, 0, &[]);
    let (document, name) = (json(&output), &place.flight.model.photographs[2].name);
    let notes = document["notes"].to_string();
    assert!(notes.contains(&format!("{name}: its position in the table is")), "{notes}");
    assert!(
        place.flight.worst_camera_m(&document) < 2.0 * worst_m + 10.0,
        "{}",
        place.flight.worst_camera_m(&document)
    );
    expect(&adjust(&[]), 2, &["--gcps"]);
    expect(&adjust(&["--cameras", text(&table), "--check", "G1"]), 2, &["--check without a list of points"]);
    let two: String = place.flight.table().lines().take(3).fold(String::new(), |all, line| all + line + "\n");
    let two = place.write("two.csv", &two);
    expect(&adjust(&["--cameras", text(&two)]), 2, &["two.csv", "2 positions", "3 are needed"]);
}

/// Positions whose columns are exchanged are those of a mirror image: a block of frames that look down would look up.
#[test]
fn exchanged_positions_hang_a_block_upside_down() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let model = place.at("model");
    let adjusted = |exchanged: bool, directed: bool, more: &[&str]| {
        let heading = if directed { "name,x,y,z,yaw,pitch,roll\n" } else { "name,x,y,z\n" };
        let rows = place.flight.model.photographs.iter().map(|p| {
            let (c, a) = (p.pose.centre, p.pose.yaw_pitch_roll());
            let [x, y] = if exchanged { [c.y, c.x] } else { [c.x, c.y] };
            let direction = format!(",{},{},{}", a.yaw_deg, a.pitch_deg, a.roll_deg);
            format!("{},{x},{y},{}{}\n", p.name, c.z, if directed { direction.as_str() } else { "" })
        });
        let table = place.write("table.csv", &rows.fold(heading.into(), |all: String, row| all + &row));
        let words = ["flight", "adjust", text(&model), "--cameras", text(&table), "--crs", "local"];
        autoref(&[&words[..], &["--sigma-position", "0.5", "--json"], more].concat(), None, &[])
    };
    for directed in [false, true] {
        let right = adjusted(false, directed, &[]);
        expect(&right, 0, &[]);
        let is_told = |document: &Value| document["notes"].to_string().contains("correct what mirrors it");
        assert!(!is_told(&json(&right)), "{}", json(&right)["notes"]);
        let mirrored = adjusted(true, directed, &[]);
        expect(&mirrored, 1, &["table.csv: its positions", "easting and northing", "--force upside-down"]);
        assert!(!said(&mirrored).contains("were these frames turned"), "{}", said(&mirrored));
        let forced = adjusted(true, directed, &["--force", "upside-down"]);
        assert!(!said(&forced).contains("or go on with --force"), "{}", said(&forced));
    }
}

/// In EPSG:3413 at 45° east the map's x leads south, and its y east: what errs by 30 m in x is said to.
#[test]
fn a_wrong_survey_is_said_along_the_axes_of_the_map() {
    let place = Place::new();
    place.flight.write_model(&place.at("model"));
    let mut flight = Flight::new();
    // At 70° north, where the map has the scale of the ground.
    flight.gcps.iter_mut().for_each(|gcp| gcp.1 += Vector3::new(2_186_900.0, -2_000.0, 0.0));
    let k = (0..flight.gcps.len()).max_by_key(|k| flight.gcps[*k].2.len()).expect("eight");
    flight.gcps[k].1.x += 30.0;
    let list = place.write("polar.txt", &flight.gcp_list().replacen("local", "EPSG:3413", 1));
    let model = place.at("model");
    let words = ["flight", "adjust", text(&model), "--gcps", text(&list), "--sigma-ground", "0.05", "--free", "none"];
    let output = autoref(&[&words[..], &["--json"]].concat(), None, &[]);
    expect(&output, 0, &[]);
    let document = json(&output);
    let blunder = &document["blunders"][0];
    assert_eq!(blunder["gcp"].as_str(), Some(flight.gcps[k].0.as_str()), "{}", document["blunders"]);
    let by = |axis: usize| blunder["by_m"][axis].as_f64().expect("metres");
    assert!((by(0) - 30.0).abs() < 2.0 && by(1).abs() < 2.0 && by(2).abs() < 2.0, "{blunder}");
}
