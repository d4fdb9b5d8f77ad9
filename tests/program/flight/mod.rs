//! `flight init|adjust|resect|export` through the program, and what the other tests of flights are made of: drawn
//! frames with known cameras, and a stand-in for COLMAP that fails or is killed on demand.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint, colmap};
use nalgebra::Vector3;
use serde_json::Value;

use crate::common::{Random, data};

pub(super) const SIDE: usize = 480;
pub(super) const F_PX: f64 = 500.0;

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
pub(super) fn ground(x: f64, y: f64) -> f64 {
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

pub(super) fn brightness(x: f64, y: f64) -> u8 {
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

    pub(super) fn render(&self, folder: &Path) {
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

pub(super) fn write_program(path: &Path, script: &str) {
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
pub(super) fn has_the_keys(document: &Value) {
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
    assert_eq!(poses.is_empty(), !found["notes"].to_string().contains("three points allow"), "{found}");
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
    let twice = places.clone() + "f0.png,1,2,3\n";
    expect(&adjusted(&twice), 2, &["places.csv", "`f0.png` has row 2 already"]);
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
