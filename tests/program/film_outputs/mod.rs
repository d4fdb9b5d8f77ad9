//! What `fiducials` writes: files, pages and frames, each read back by others or against known truth.

mod exports;
mod interior;
mod light;
mod resampled;
mod sheet;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use autoref_film::{Camera, FrameResult, load_camera};
use serde_json::Value;

fn autoref(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_autoref-stream")).args(args).output().expect("the program starts")
}

/// Runs the program and insists on the exit code.
fn run(args: &[&str], code: i32) -> String {
    let output = autoref(args);
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{args:?}: {said}");
    said
}

fn text(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&text(path)).expect("JSON")
}

fn plain(path: &Path) -> &str {
    path.to_str().expect("a plain path")
}

/// Frames of a camera in `scans`, results in `out`.
struct Roll {
    folder: tempfile::TempDir,
    camera: Camera,
}

impl Roll {
    fn new(camera: &str, pixel_um: &str, extra: &[&str]) -> Roll {
        let folder = tempfile::tempdir().expect("a folder");
        let scans = folder.path().join("scans");
        let mut args = vec!["synth-film", plain(&scans), "--camera", camera, "--pixel-um", pixel_um, "--tiles", "256"];
        args.extend(extra);
        run(&args, 0);
        Roll { folder, camera: load_camera(camera).expect("built in") }
    }

    fn scans(&self) -> PathBuf {
        self.folder.path().join("scans")
    }

    fn out(&self, name: &str) -> PathBuf {
        self.folder.path().join("out").join(name)
    }

    fn fiducials(&self, extra: &[&str], code: i32) -> String {
        let (scans, out) = (self.scans(), self.folder.path().join("out"));
        let mut args = vec!["fiducials", plain(&scans), "--camera", &self.camera.name, "--quiet", "-o", plain(&out)];
        args.extend(self.lie());
        args.extend(extra);
        run(&args, code)
    }

    /// How the frames lie, where neither marks nor camera file tell.
    fn lie(&self) -> &'static [&'static str] {
        if self.camera.name == "rmk-cross" { &["--turn", "0", "--mirrored", "false"] } else { &[] }
    }

    fn frame(&self, name: &str) -> FrameResult {
        serde_json::from_str(&text(&self.out(&format!("{name}.fiducials.json")))).expect("a frame's result")
    }

    fn truth(&self, name: &str) -> Vec<(String, [f64; 2])> {
        let truth = json(&self.scans().join(format!("{name}.truth.json")));
        let mark = |m: &Value| {
            let at = |k: &str| m[k].as_f64().expect("a number");
            (m["mark"].as_str().expect("a name").to_owned(), [at("x"), at("y")])
        };
        truth["marks"].as_array().expect("marks").iter().map(mark).collect()
    }
}

/// Least squares affine from `from` to `to` by the normal equations, as MicMac's `ElAffin2D::L2Fit` on points paired by
/// name; gives the function.
fn affine(from: &[[f64; 2]], to: &[[f64; 2]]) -> impl Fn([f64; 2]) -> [f64; 2] + use<> {
    let design = nalgebra::DMatrix::from_fn(from.len(), 3, |i, k| if k < 2 { from[i][k] } else { 1.0 });
    let fit = |axis: usize| {
        let right = nalgebra::DVector::from_fn(to.len(), |i, _| to[i][axis]);
        let normal = design.transpose() * &design;
        normal.lu().solve(&(design.transpose() * right)).expect("three points off a line")
    };
    let (x, y) = (fit(0), fit(1));
    move |p| [x[0] * p[0] + x[1] * p[1] + x[2], y[0] * p[0] + y[1] * p[1] + y[2]]
}

/// A grey TIFF as numbers.
fn pixels(path: &Path) -> (usize, usize, Vec<f64>) {
    let dataset = gdal::Dataset::open(path).expect("written");
    let band = dataset.rasterband(1).expect("a band");
    let (w, h) = dataset.raster_size();
    (w, h, band.read_as::<f64>((0, 0), (w, h), (w, h), None).expect("readable").data().to_vec())
}
