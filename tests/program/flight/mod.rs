//! `flight init|adjust|resect|export` through the program, and what the other tests of flights are made of: drawn
//! frames with known cameras, and a stand-in for COLMAP that fails or is killed on demand.

mod adjust;
mod feet;
mod files;
mod resect;
mod scans;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use crate::common::Random;
use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint, colmap};
use nalgebra::Vector3;
use serde_json::Value;

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
    // Nothing finer than eight pixels: COLMAP describes every feature that it sees, whatever it keeps.
    let octaves = [(29.0, 30.0), (14.0, 30.0), (9.0, 30.0), (6.0, 24.0)];
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

    /// Draws these of the five frames.
    pub(super) fn render(&self, folder: &Path, frames: &[usize]) {
        std::fs::create_dir_all(folder).expect("a folder");
        for p in frames.iter().map(|&i| &self.model.photographs[i]) {
            let mut pixels = vec![0u8; SIDE * SIDE];
            for (k, grey) in pixels.iter_mut().enumerate() {
                let at = meets(&self.model.cameras[0], &p.pose, [(k % SIDE) as f64 + 0.5, (k / SIDE) as f64 + 0.5]);
                *grey = brightness(at.x, at.y);
            }
            write_png(&folder.join(&p.name), SIDE, &pixels);
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

/// A square picture in grey.
pub(super) fn write_png(path: &Path, side: usize, pixels: &[u8]) {
    let file = std::fs::File::create(path).expect("a new file");
    let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), side as u32, side as u32);
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
            write_png(&self.at("frames").join(&p.name), SIDE, &vec![100; SIDE * SIDE]);
        }
    }
}
