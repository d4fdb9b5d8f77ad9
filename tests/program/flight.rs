//! `flight …` through the program: drawn frames with known cameras, a stand-in for COLMAP that fails or is killed on
//! demand, and COLMAP itself where it is installed.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint, colmap};
use nalgebra::Vector3;
use serde_json::Value;

use crate::common::{Random, data, large, skipped};

const SIDE: usize = 480;
const F_PX: f64 = 500.0;

pub(super) fn text(path: &Path) -> &str {
    path.to_str().expect("plain")
}

/// Runs the program with `colmap` taken from `bin` alone, or from where the system has it.
pub(super) fn autoref(args: &[&str], bin: Option<&Path>, words: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
    command.args(args).envs(words.iter().copied());
    if let Some(bin) = bin {
        // The shell of the stand-in needs no more.
        command.env("PATH", format!("{}:/bin", bin.display()));
    }
    let output = command.output().expect("the program starts");
    let said = said(&output);
    assert!(!said.contains("panicked"), "{args:?}: {said}");
    output
}

pub(super) fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).trim().to_string()
}

/// The exit code, and all that was said has these words.
#[track_caller]
pub(super) fn expect(output: &Output, code: i32, words: &[&str]) {
    let said = said(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    assert!(words.iter().all(|w| said.contains(w)), "{words:?} in: {said}");
    if code == 2 {
        let lines: Vec<&str> = said.lines().filter(|l| l.starts_with("autoref-stream:")).collect();
        assert_eq!(lines.len(), 1, "one line says what is wrong: {said}");
    }
}

#[track_caller]
pub(super) fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", said(output)))
}

/// Height of the ground: hills of 40 m.
fn ground(x: f64, y: f64) -> f64 {
    12.0 * (x / 61.0).sin() + 10.0 * (y / 43.0).cos() + 6.0 * ((x + 2.0 * y) / 29.0).sin()
}

fn noise(x: f64, y: f64, cell: f64, seed: u64) -> f64 {
    let (u, v) = (x / cell, y / cell);
    let (i, j) = (u.floor(), v.floor());
    let (a, b) = (u - i, v - j);
    let at = |i: f64, j: f64| {
        let key = (i as i64 as u64).wrapping_mul(0x9E37_79B9) ^ (j as i64 as u64).wrapping_mul(0x85EB_CA6B_0000) ^ seed;
        Random::new(key).uniform(-1.0, 1.0)
    };
    let (a, b) = (a * a * (3.0 - 2.0 * a), b * b * (3.0 - 2.0 * b));
    (at(i, j) * (1.0 - a) + at(i + 1.0, j) * a) * (1.0 - b)
        + (at(i, j + 1.0) * (1.0 - a) + at(i + 1.0, j + 1.0) * a) * b
}

fn brightness(x: f64, y: f64) -> u8 {
    let octaves = [(29.0, 30.0), (13.0, 30.0), (5.7, 28.0), (2.9, 24.0)];
    let sum: f64 = octaves.iter().enumerate().map(|(k, (cell, weight))| weight * noise(x, y, *cell, k as u64)).sum();
    (128.0 + sum).clamp(0.0, 255.0) as u8
}

/// Where a ray from the camera meets the ground.
fn meets(camera: &Camera, pose: &Pose, pixel: [f64; 2]) -> Vector3<f64> {
    let d = pose.rotation.transpose() * Vector3::from(camera.ray(pixel).expect("inside the image"));
    let mut at = pose.centre - d * (pose.centre.z / d.z);
    for _ in 0..8 {
        at = pose.centre + d * ((ground(at.x, at.y) - pose.centre.z) / d.z);
    }
    at
}

/// Name, place, and where which frames see it.
type DrawnGcp = (String, Vector3<f64>, Vec<(usize, [f64; 2])>);

/// A line of five frames that look down, 400 m above the ground, with ties and eight GCPs: a truth to compare with.
pub(super) struct Flight {
    pub(super) model: Reconstruction,
    /// Name, place, frame and pixel.
    gcps: Vec<DrawnGcp>,
}

impl Flight {
    fn new() -> Self {
        let mut draw = Random::new(41);
        let side = SIDE as f64;
        let camera = Camera::pinhole("lens", [side, side], F_PX, [side / 2.0, side / 2.0]);
        let mut model = Reconstruction { cameras: vec![camera.clone()], ..Reconstruction::default() };
        for i in 0..5 {
            let centre = Vector3::new(
                1000.0 + 80.0 * f64::from(i),
                2000.0 + draw.uniform(-8.0, 8.0),
                400.0 + draw.uniform(-9.0, 9.0),
            );
            let angles = YawPitchRoll {
                yaw_deg: 90.0 + draw.uniform(-2.0, 2.0),
                pitch_deg: -85.0 + draw.uniform(-2.0, 2.0),
                roll_deg: draw.uniform(-2.0, 2.0),
            };
            let name = format!("f{i}.png");
            model.photographs.push(Photograph { name, camera: 0, pose: Pose::looking(centre, angles) });
        }
        let mut flight = Flight { model, gcps: Vec::new() };
        while flight.model.ties.len() < 150 || flight.gcps.len() < 8 {
            let (x, y) = (draw.uniform(850.0, 1550.0), draw.uniform(1820.0, 2180.0));
            let xyz = Vector3::new(x, y, ground(x, y));
            let inside = |at: &[f64; 2]| at.iter().all(|v| (8.0..side - 8.0).contains(v));
            let project = |p: &Photograph| camera.project(p.pose.to_camera(&xyz).into()).filter(inside);
            let seen: Vec<(usize, [f64; 2])> =
                flight.model.photographs.iter().enumerate().filter_map(|(i, p)| Some((i, project(p)?))).collect();
            if seen.len() < 2 {
                continue;
            }
            if flight.gcps.len() < 8 {
                flight.gcps.push((format!("G{}", flight.gcps.len()), xyz, seen));
            } else {
                flight.model.ties.push(TiePoint { xyz, seen });
            }
        }
        flight
    }

    fn render(&self, folder: &Path) {
        std::fs::create_dir_all(folder).expect("a folder");
        for p in &self.model.photographs {
            let mut pixels = vec![0u8; SIDE * SIDE];
            for (k, grey) in pixels.iter_mut().enumerate() {
                let at = meets(&self.model.cameras[0], &p.pose, [(k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5]);
                *grey = brightness(at.x, at.y);
            }
            write_png(&folder.join(&p.name), &pixels);
        }
    }

    fn gcp_list(&self) -> String {
        let mut list = String::from("local\n");
        for (name, xyz, seen) in &self.gcps {
            for (frame, at) in seen {
                let image = &self.model.photographs[*frame].name;
                writeln!(list, "{:.4} {:.4} {:.4} {:.3} {:.3} {image} {name}", xyz.x, xyz.y, xyz.z, at[0], at[1])
                    .expect("text");
            }
        }
        list
    }

    fn table(&self) -> String {
        let mut draw = Random::new(5);
        let mut table = String::from("name,x,y,z,yaw,pitch,roll\n");
        for p in &self.model.photographs {
            let (c, a) = (p.pose.centre, p.pose.yaw_pitch_roll());
            let mut off = |by: f64| draw.uniform(-by, by);
            writeln!(
                table,
                "{},{:.2},{:.2},{:.2},{:.3},{:.3},{:.3}",
                p.name,
                c.x + off(15.0),
                c.y + off(15.0),
                c.z + off(15.0),
                a.yaw_deg + off(1.0),
                a.pitch_deg + off(1.0),
                a.roll_deg + off(1.0)
            )
            .expect("text");
        }
        table
    }

    /// COLMAP's text model in a frame of its own.
    pub(super) fn write_model(&self, folder: &Path) {
        std::fs::create_dir_all(folder).expect("a folder");
        let by = autoref_flight::Similarity {
            scale: 0.01,
            rotation: *nalgebra::Rotation3::from_euler_angles(0.4, -0.2, 1.1).matrix(),
            shift: Vector3::new(1.0, 2.0, 3.0),
        };
        let mut model = self.model.clone();
        for p in &mut model.photographs {
            p.pose = p.pose.moved(&by);
        }
        for t in &mut model.ties {
            t.xyz = by.apply(&t.xyz);
        }
        for (name, bytes) in colmap::text_model(&model).expect("a plain camera") {
            std::fs::write(folder.join(name), bytes).expect("written");
        }
    }

    /// Largest distance of a camera of the document from the truth.
    pub(super) fn worst_camera_m(&self, document: &Value) -> f64 {
        let cameras = document["cameras"].as_array().expect("cameras");
        let distance = |c: &Value| {
            let p = &self.model.photographs[self.model.find(c["name"].as_str().expect("a name")).expect("known")];
            let at = |k: &str| c[k].as_f64().expect("a number");
            (Vector3::new(at("e"), at("n"), at("h")) - p.pose.centre).norm()
        };
        cameras.iter().map(distance).fold(0.0, f64::max)
    }
}

fn write_program(path: &Path, script: &str) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::write(path, script).expect("written");
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).expect("executable");
}

fn write_png(path: &Path, pixels: &[u8]) {
    let file = std::fs::File::create(path).expect("a new file");
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().and_then(|mut w| w.write_image_data(pixels)).expect("written");
}

/// The keys that others rely on.
#[track_caller]
fn has_the_keys(document: &Value) {
    for key in
        ["frames_registered", "frames_listed", "cameras", "interior", "gcps", "check_points", "reprojection_rms_px"]
    {
        assert!(!document[key].is_null(), "{key}");
    }
    let camera = &document["cameras"][0];
    for key in [
        "name",
        "e",
        "n",
        "h",
        "yaw_deg",
        "pitch_deg",
        "roll_deg",
        "C",
        "R",
        "covariance",
        "f_px",
        "pp_px",
        "distortion",
        "rms_px",
    ] {
        assert!(!camera[key].is_null(), "cameras[0].{key}");
    }
    for key in ["sigma_e", "sigma_n", "sigma_h", "sigma_yaw_deg", "sigma_pitch_deg", "sigma_roll_deg"] {
        assert!(camera[key].as_f64().is_some_and(|s| s > 0.0), "cameras[0].{key}");
    }
}

pub(super) struct Place {
    folder: tempfile::TempDir,
    pub(super) flight: Flight,
}

impl Place {
    pub(super) fn new() -> Self {
        let place = Place { folder: tempfile::tempdir().expect("a temporary folder"), flight: Flight::new() };
        place.write("gcps.txt", &place.flight.gcp_list());
        place.write("table.csv", &place.flight.table());
        place
    }
    pub(super) fn at(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
    pub(super) fn write(&self, name: &str, content: &str) -> PathBuf {
        std::fs::write(self.at(name), content).expect("written");
        self.at(name)
    }
    /// `flight init` on frames that are empty files, or drawn.
    pub(super) fn init(&self) -> PathBuf {
        let toml = self.at("FLIGHT.toml");
        let (frames, table, gcps) = (self.at("frames"), self.at("table.csv"), self.at("gcps.txt"));
        let output = autoref(
            &[
                "flight",
                "init",
                text(&frames),
                "--cameras",
                text(&table),
                "--gcps",
                text(&gcps),
                "-o",
                text(&toml),
                "--crs",
                "local",
                "--f-px",
                "500",
            ],
            None,
            &[],
        );
        expect(&output, 0, &["5 of 5 rows"]);
        toml
    }
    /// A stand-in for COLMAP whose mapper copies the model of the truth.
    pub(super) fn stand_in(&self) -> PathBuf {
        let bin = self.at("bin");
        std::fs::create_dir_all(&bin).expect("a folder");
        self.flight.write_model(&self.at("prepared"));
        // No features anywhere: the frames are left to the matching of frames as they are.
        let driver = gdal::DriverManager::get_driver_by_name("SQLite").expect("there");
        let database = driver.create_vector_only(self.at("featureless.db")).expect("a new file");
        for table in [
            "images (image_id, name)",
            "keypoints (image_id, cols, data)",
            "descriptors (image_id, cols, data)",
            "two_view_geometries (pair_id, rows, data)",
        ] {
            let made = database.execute_sql(format!("CREATE TABLE {table}"), None, gdal::vector::sql::Dialect::DEFAULT);
            made.expect("a table");
        }
        database.close().expect("written");
        let script = format!(
            "#!/bin/sh\ncommand=$1; shift\nwhile [ $# -gt 0 ]; do case \"$1\" in\n--database_path) db=$2;; --output_path) out=$2;;\n\
             esac; shift 2; done\nif [ \"$command\" = \"$STAND_IN_FAILS\" ]; then [ $command = mapper ] || echo half > \"$db\"; exit 3; fi\n\
             if [ \"$command\" = \"$STAND_IN_KILLS\" ]; then kill -9 $PPID; exit 0; fi\n\
             case $command in mapper) mkdir -p \"$out/0\"; cp {0}/* \"$out/0/\";; feature_extractor) cp {1} \"$db\";;\n\
             esac\n",
            self.at("prepared").display(),
            self.at("featureless.db").display()
        );
        write_program(&bin.join("colmap"), &script);
        bin
    }
    pub(super) fn five_frames(&self) {
        std::fs::create_dir_all(self.at("frames")).expect("a folder");
        for p in &self.flight.model.photographs {
            write_png(&self.at("frames").join(&p.name), &vec![100; SIDE * SIDE]);
        }
    }
}

#[test]
fn init_writes_what_solve_reads_and_refuses_what_is_not_there() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let written: toml::Value = toml::from_str(&std::fs::read_to_string(&toml).expect("there")).expect("TOML");
    assert_eq!(written["camera"]["f_px"].as_float(), Some(500.0));
    assert_eq!(
        (written["gcps"]["sigma_ground_m"].as_float(), written["gcps"]["sigma_image_px"].as_float()),
        (Some(25.0), Some(5.0))
    );
    let (frames, table, gcps) = (place.at("frames"), place.at("table.csv"), place.at("gcps.txt"));
    let init = |folder: &Path, table: &Path, gcps: &Path, name: &str| {
        let out = place.at(name);
        autoref(
            &["flight", "init", text(folder), "--cameras", text(table), "--gcps", text(gcps), "-o", text(&out)],
            None,
            &[],
        )
    };
    expect(&init(&frames, &table, &gcps, "FLIGHT.toml"), 2, &["FLIGHT.toml exists", "--overwrite"]);
    expect(&init(&place.at("nowhere"), &table, &gcps, "a.toml"), 2, &["nowhere"]);
    expect(&init(&frames, &table, &place.at("no.txt"), "a.toml"), 2, &["no.txt"]);
    let others = place.write("others.csv", "name,x,y,z\nQ1,1,2,3\n");
    expect(&init(&frames, &others, &gcps, "a.toml"), 2, &["others.csv", "none of its 1 names"]);
    let broken = place.write("broken.csv", "name,x,y,z\nf0,1,two,3\n");
    expect(&init(&frames, &broken, &gcps, "a.toml"), 2, &["broken.csv", "row 2", "`two`"]);
    std::fs::create_dir(place.at("empty")).expect("a folder");
    expect(&init(&place.at("empty"), &table, &gcps, "a.toml"), 2, &["empty", "no frames"]);
    assert!(!place.at("a.toml").exists());
}

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
    expect(
        &autoref(&["flight", "adjust", text(&out), "--gcps", text(&gcps), "--free", "none", "--json"], None, &[]),
        0,
        &[],
    );
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
    let two: String = place
        .flight
        .gcp_list()
        .lines()
        .filter(|l| l.contains("f2.png"))
        .take(2)
        .fold("local\n".into(), |all, l| all + l + "\n");
    expect(&resect("f2.png", &place.write("two.txt", &two), &[]), 1, &["3 are needed"]);
    expect(&resect("f2.png", &gcps, &["--pp-px", "1"]), 2, &["--pp-px"]);
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

#[test]
fn export_writes_what_micmac_reads() {
    let place = Place::new();
    place.five_frames();
    let toml = place.init();
    let folder = place.at("micmac");
    let export = |more: &[&str]| {
        let words = [&["flight", "export", text(&toml), "-o", text(&folder)], more].concat();
        autoref(&words, None, &[])
    };
    expect(&export(&["--pixel-mm", "0.02"]), 0, &[]);
    let read = |name: &str| std::fs::read_to_string(place.at("micmac").join(name)).expect("written");
    assert!(read("MicMac-LocalChantierDescripteur.xml").contains("<CalcName> 10 </CalcName>"), "500 px of 0.02 mm");
    assert_eq!(read("NameCpleVisib.xml").matches("<Cple>").count(), 4 + 3 + 2);
    assert!(read("commands.sh").contains("mm3d GCPBascule '(f0\\.png|"), "{}", read("commands.sh"));
    let checked = Command::new("sh").arg("-n").arg(place.at("micmac").join("commands.sh")).status().expect("a shell");
    assert!(checked.success());
    // The list that it came from and the two that it became say the same.
    let ground = autoref_flight::read::micmac::read_ground_points(&place.at("micmac").join("GCP-S3D.xml"));
    assert_eq!(ground.expect("points").len(), place.flight.gcps.len());
    let adjusted = |list: &str| {
        let list = place.at("micmac").join(list);
        place.flight.write_model(&place.at("prepared"));
        let model = place.at("prepared");
        autoref(&["flight", "adjust", text(&model), "--gcps", text(&list), "--json"], None, &[])
    };
    expect(&adjusted("GCP-S3D.xml"), 0, &[]);
    expect(&export(&[]), 2, &["MicMac-LocalChantierDescripteur.xml", "--overwrite"]);
    expect(&export(&["--overwrite"]), 0, &[]);
    expect(&export(&["--overwrite", "--pixel-mm", "0"]), 2, &["--pixel-mm"]);
}

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
    for command in ["feature_extractor", "matches_importer", "mapper"] {
        let out = format!("failed-{command}");
        expect(&solve(&out, &bin, &[("STAND_IN_FAILS", command)]), 2, &[command, "exit status: 3", ".log"]);
        assert!(!place.at(&out).join("cameras.json").exists());
        expect(&solve(&out, &bin, &[]), 0, &[]);
        assert_eq!(cameras(&out), cameras("whole"), "{command}");
        let out = format!("killed-{command}");
        assert_eq!(solve(&out, &bin, &[("STAND_IN_KILLS", command)]).status.code(), None, "killed");
        expect(&solve(&out, &bin, &[]), 0, &[]);
        assert_eq!(cameras(&out), cameras("whole"), "{command}");
    }
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
    // A mask that cannot be this camera's.
    place.write("mask.pgm", "P5\n1 1\n255\n\u{1}");
    let masked = std::fs::read_to_string(&toml).expect("there") + "\n[masks]\nglobal = \"mask.pgm\"\n";
    let masked = place.write("masked.toml", &masked);
    expect(
        &autoref(&["flight", "solve", text(&masked), "-o", text(&place.at("masked"))], Some(&bin), &[]),
        2,
        &["mask.pgm: the mask has 1 x 1 pixels, the frame f0.png"],
    );
    // Masks of other frames than these: one is left out, all of them stop the run.
    std::fs::create_dir(place.at("masks")).expect("a folder");
    let masked = std::fs::read_to_string(&toml).expect("there") + "\n[masks]\nfolder = \"masks\"\n";
    let masked = place.write("others.toml", &masked);
    let others = || autoref(&["flight", "solve", text(&masked), "-o", text(&place.at("others"))], Some(&bin), &[]);
    place.write("masks/f0_Masq.tif", "P5\n1 1\n255\n\u{1}");
    expect(&others(), 0, &["f0_Masq.tif: left out: the mask has 1 x 1 pixels"]);
    (1..5).for_each(|i| drop(place.write(&format!("masks/f{i}_Masq.tif"), "P5\n1 1\n255\n\u{1}")));
    expect(&others(), 2, &["masks: none of the 5 masks fits the frames of", "autoref-stream mask"]);
    // A frame that went missing is one frame less, and the stages are worked anew.
    std::fs::remove_file(place.at("frames").join("f4.png")).expect("removed");
    let fewer = solve("whole", &bin, &[]);
    assert!(!said(&fewer).contains("features.db: taken"), "{}", said(&fewer));
    for i in 1..4 {
        std::fs::remove_file(place.at("frames").join(format!("f{i}.png"))).expect("removed");
    }
    expect(&solve("one", &bin, &[]), 2, &["frames: 1 frames match"]);
    let typo = place.write("typo.toml", "[frames]\nfolder = \"frames\"\npattern = [\"*.png\"]\nmask = 1\n");
    expect(
        &autoref(&["flight", "solve", text(&typo), "-o", text(&place.at("typo"))], None, &[]),
        2,
        &["typo.toml", "mask"],
    );
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

/// A project whose GCPs are as good as they are drawn, with few features.
fn sharpened(project: &str) -> String {
    project
        .replace("sigma_ground_m = 25.0", "sigma_ground_m = 0.1")
        .replace("sigma_image_px = 5.0", "sigma_image_px = 0.5")
        .replace("features = 6000", "features = 1500")
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
    place.flight.render(&place.at("frames"));
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

/// From drawn frames to cameras, by COLMAP itself; with AUTOREF_LARGE=1 also killed before it checks the ties and
/// resumed: the same cameras.
#[test]
fn frames_become_cameras() {
    if Command::new("colmap").arg("help").output().is_err() {
        skipped("`colmap` is not installed: no frames were solved");
        return;
    }
    let place = Place::new();
    place.flight.render(&place.at("frames"));
    let toml = place.init();
    let sharp = sharpened(&std::fs::read_to_string(&toml).expect("there"));
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
    }
    // Without a table COLMAP's mapper orients them.
    let project = std::fs::read_to_string(&toml).expect("there");
    std::fs::write(&toml, without_table(&project)).expect("written");
    let plain = solve("plain", &[], None);
    expect(&plain, 0, &[]);
    let (document, worst) = (json(&plain), place.flight.worst_camera_m(&json(&plain)));
    assert_eq!(document["frames_registered"], 5);
    assert!(worst < 4.0 && document.get("pairs").is_none(), "{worst:.2} m");
    // COLMAP's binary model, cut at many places.
    let sparse = place.at("plain").join("sparse").join("0");
    let gcps = place.at("gcps.txt");
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let whole = std::fs::read(sparse.join(name)).expect("there");
        for part in [0, 3, 30, 60, 99] {
            std::fs::write(sparse.join(name), &whole[..whole.len() * part / 100]).expect("written");
            let output = autoref(&["flight", "adjust", text(&sparse), "--gcps", text(&gcps)], None, &[]);
            expect(&output, 2, &[name]);
        }
        std::fs::write(sparse.join(name), &whole).expect("written");
    }
}

/// A raster of floats on a plane.
pub(super) fn write_dem(
    path: &Path,
    size: (usize, usize),
    corner: [f64; 2],
    cell: f64,
    height: impl Fn(f64, f64) -> f64,
) {
    let driver = gdal::DriverManager::get_driver_by_name("GTiff").expect("there");
    let mut file = driver.create_with_band_type::<f32, _>(path, size.0, size.1, 1).expect("a new file");
    file.set_geo_transform(&[corner[0], cell, 0.0, corner[1], 0.0, -cell]).expect("kept");
    let at = |k: usize| ((k % size.0) as f64 + 0.5, (k / size.0) as f64 + 0.5);
    let heights = (0..size.0 * size.1).map(|k| height(corner[0] + at(k).0 * cell, corner[1] - at(k).1 * cell) as f32);
    let mut buffer = gdal::raster::Buffer::new(size, heights.collect());
    file.rasterband(1).expect("a band").write((0, 0), size, &mut buffer).expect("written");
    file.close().expect("written");
}

/// First band and last (alpha) of an orthophoto with its geotransform.
fn ortho(path: &Path) -> (Vec<u8>, Vec<u8>, (usize, usize), [f64; 6]) {
    let file = gdal::Dataset::open(path).expect("it opens");
    let size = file.raster_size();
    let read = |b: usize| {
        file.rasterband(b).expect("a band").read_as::<u8>((0, 0), size, size, None).expect("read").data().to_vec()
    };
    (read(1), read(file.raster_count()), size, file.geo_transform().expect("georeferenced"))
}

fn correlation(pairs: &[(f64, f64)]) -> f64 {
    let n = pairs.len() as f64;
    let mean = pairs.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n));
    let sum = |f: &dyn Fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>();
    let (a, b) = (sum(&|p| (p.0 - mean.0).powi(2)), sum(&|p| (p.1 - mean.1).powi(2)));
    sum(&|p| (p.0 - mean.0) * (p.1 - mean.1)) / (a * b).sqrt()
}

#[test]
fn an_orthophoto_shows_the_ground_and_hides_what_the_frame_does_not_see() {
    let place = Place::new();
    place.flight.render(&place.at("frames"));
    place.flight.write_model(&place.at("model"));
    let (frame, dem, cameras) = (place.at("frames").join("f2.png"), place.at("dem.tif"), place.at("cameras.json"));
    // A tower that the frame does not show stands in the model: it covers itself and its shadow, the rest stays as it
    // was.
    let tower = |x: f64, y: f64| f64::from(u8::from((1290.0..1300.0).contains(&x) && (1990.0..2010.0).contains(&y)));
    write_dem(&dem, (400, 250), [800.0, 2250.0], 2.0, ground);
    let towered = place.at("towered.tif");
    write_dem(&towered, (400, 250), [800.0, 2250.0], 2.0, |x, y| ground(x, y) + 120.0 * tower(x, y));
    let adjust = [
        "flight",
        "adjust",
        text(&place.at("model")),
        "--gcps",
        text(&place.at("gcps.txt")),
        "--sigma-ground",
        "0.01",
        "--free",
        "none",
        "-o",
        text(&cameras),
        "--crs",
        "local",
    ]
    .map(str::to_string);
    expect(&autoref(&adjust.each_ref().map(String::as_str), None, &[]), 0, &[]);
    let run = |dem: &Path, name: &str, more: &[&str]| {
        let out = place.at(name);
        let some = [
            "flight",
            "orthorectify",
            text(&frame),
            "--dem",
            text(dem),
            "--cameras",
            text(&cameras),
            "-o",
            text(&out),
            "--json",
        ];
        (autoref(&[&some, more].concat(), None, &[]), out)
    };
    let (output, out) = run(&dem, "a.tif", &[]);
    expect(&output, 0, &[]);
    let gsd = json(&output)["gsd"].as_f64().expect("a number");
    assert!((gsd - 0.8).abs() < 0.1, "{gsd}");
    let (grey, alpha, size, transform) = ortho(&out);
    let truth = |k: usize| {
        (
            transform[0] + transform[1] * ((k % size.0) as f64 + 0.5),
            transform[3] + transform[5] * ((k / size.0) as f64 + 0.5),
        )
    };
    let pairs: Vec<(f64, f64)> = (0..grey.len())
        .filter(|k| alpha[*k] == 255)
        .map(|k| (f64::from(grey[k]), f64::from(brightness(truth(k).0, truth(k).1))))
        .collect();
    let found = correlation(&pairs);
    assert!(found > 0.97 && pairs.len() > SIDE * SIDE * 9 / 10, "{found:.4} of {} pixels", pairs.len());
    // Any tiling, the same bytes.
    let bytes = std::fs::read(&out).expect("there");
    for (name, more) in
        [("b.tif", ["--tile", "64", "--threads", "1"]), ("c.tif", ["--tile", "300", "--memory", "112M"])]
    {
        let (output, other) = run(&dem, name, &more);
        expect(&output, 0, &[]);
        assert!(std::fs::read(other).expect("there") == bytes, "{name}");
    }
    // Behind the tower, seen from the camera at x = 1160, nothing is seen; before it, all.
    let (output, out) = run(&towered, "t.tif", &[]);
    expect(&output, 0, &[]);
    let (_, hidden, size, transform) = ortho(&out);
    let at = |x: f64, y: f64| {
        hidden[((y - transform[3]) / transform[5]) as usize * size.0 + ((x - transform[0]) / transform[1]) as usize]
    };
    assert_eq!((at(1315.0, 2000.0), at(1270.0, 2000.0), at(1315.0, 2060.0)), (0, 255, 255));
    // What cannot be.
    expect(&run(&dem, "a.tif", &[]).0, 2, &["a.tif exists", "--overwrite"]);
    expect(&run(&place.at("no.tif"), "x.tif", &[]).0, 2, &["no.tif"]);
    let far = place.at("far.tif");
    write_dem(&far, (20, 20), [90_000.0, 90_000.0], 2.0, |_, _| 0.0);
    expect(&run(&far, "x.tif", &[]).0, 1, &["far.tif", "none of its rays"]);
    expect(&run(&dem, "x.tif", &["--gsd", "0"]).0, 2, &["--gsd"]);
    let other = place.at("frames").join("q.png");
    std::fs::copy(&frame, &other).expect("copied");
    let x = place.at("x.tif");
    let unknown =
        ["flight", "orthorectify", text(&other), "--dem", text(&dem), "--cameras", text(&cameras), "-o", text(&x)];
    expect(&autoref(&unknown, None, &[]), 2, &["cameras.json", "q.png"]);
    assert!(!place.at("x.tif").exists());
}

/// Two frames of an aerial camera and two of a drone: their orthophotos agree where they overlap.
#[test]
fn orthophotos_of_neighbours_agree() {
    let Some(frames) = data("frames") else { return };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let case = |name: &str, images: [&str; 2], dem: &str, more: &[&str]| {
        let run = |image: &str| {
            let out = folder.path().join(format!("{name}-{image}.tif"));
            let (frame, dem) = (frames.join(name).join(image), frames.join(name).join(dem));
            let some = ["flight", "orthorectify", text(&frame), "--dem", text(&dem), "-o", text(&out)];
            expect(&autoref(&[&some, more].concat(), None, &[]), 0, &[]);
            ortho(&out)
        };
        let (a, b) = (run(images[0]), run(images[1]));
        let cell = a.3[1];
        let off = [((a.3[0] - b.3[0]) / cell).round() as i64, ((b.3[3] - a.3[3]) / cell).round() as i64];
        let mut pairs = Vec::new();
        for k in 0..a.0.len() {
            let (x, y) = ((k % a.2.0) as i64 + off[0], (k / a.2.0) as i64 + off[1]);
            if (0..b.2.0 as i64).contains(&x) && (0..b.2.1 as i64).contains(&y) {
                let other = y as usize * b.2.0 + x as usize;
                if a.1[k] == 255 && b.1[other] == 255 {
                    pairs.push((f64::from(a.0[k]), f64::from(b.0[other])));
                }
            }
        }
        let found = correlation(&pairs);
        eprintln!("{name}: correlation {found:.4} of {} pixels of {cell}", pairs.len());
        assert!(found > 0.75 && pairs.len() > 10_000, "{name}: {found:.3} of {}", pairs.len());
    };
    let table = frames.join("ngi/camera_pos_ori.txt");
    let ngi = ["3324c_2015_1004_05_0182_RGB.tif", "3324c_2015_1004_05_0184_RGB.tif"];
    case("ngi", ngi, "dem.tif", &["--cameras", text(&table), "--f-px", "833.3333", "--gsd", "8"]);
    let (table, camera) = (frames.join("odm/odm_xyz_opk.csv"), frames.join("odm/reconstruction.json"));
    case(
        "odm",
        ["100_0005_0018.tif", "100_0005_0136.tif"],
        "dsm.tif",
        &["--cameras", text(&table), "--camera", text(&camera), "--gsd", "0.6"],
    );
}
