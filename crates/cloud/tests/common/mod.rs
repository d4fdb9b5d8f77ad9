//! What several tests need.
#![allow(dead_code)]

#[path = "../../../../tests/common/skipped.rs"]
mod skipped;

use std::path::{Path, PathBuf};

use autoref_cloud::clean::{CleanReport, Invalid, Plan, Step, clean};
use autoref_cloud::io;
use autoref_cloud::schema::Batch;

/// The shared material, when it is there.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/clouds").join(name);
    if !path.exists() {
        skipped::skipped(format!("{} is absent", path.display()));
        return None;
    }
    Some(path)
}

pub fn plan(steps: Vec<Step>) -> Plan {
    Plan {
        steps,
        drop_noise: false,
        drop_objects: false,
        shift: None,
        invalid: Invalid::Refuse,
        memory_bytes: 512 << 20,
        tile_points: None,
        scratch: std::env::temp_dir(),
        crs_wkt: None,
    }
}

/// Cleans into a folder of its own and reads the result again: report, coordinates, classes.
pub fn run(input: &Path, plan: &Plan, extension: &str) -> (CleanReport, Vec<[f64; 3]>, Vec<u8>) {
    let folder = tempfile::tempdir().expect("a folder");
    let output = folder.path().join(format!("out.{extension}"));
    let report = clean(input, &output, &output, plan).expect("it is cleaned");
    let (xyz, classes) = read(&output);
    assert_eq!(report.points_kept, xyz.len() as u64);
    (report, xyz, classes)
}

pub fn read(path: &Path) -> (Vec<[f64; 3]>, Vec<u8>) {
    let (header, mut reader) = io::open(path).expect("a cloud");
    let field = header.schema.field("classification").cloned();
    let (mut xyz, mut classes) = (Vec::new(), Vec::new());
    let mut batch = Batch::default();
    loop {
        reader.read(&mut batch, 1000).expect("points");
        if batch.is_empty() {
            return (xyz, classes);
        }
        for index in 0..batch.len() {
            let raw = batch.record(&header.schema, index);
            classes.push(field.as_ref().map_or(0, |field| field.value(raw) as u8));
        }
        xyz.extend_from_slice(&batch.xyz);
    }
}

pub use autoref_raster::random::SplitMix64 as Random;

/// Writes points as binary PLY of doubles.
pub fn write_ply(path: &Path, points: &[[f64; 3]]) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\nend_header\n",
        points.len()
    )
    .into_bytes();
    points.iter().flatten().for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
    std::fs::write(path, bytes).expect("written");
}

/// Hilly ground with a hole, points in the air and below, a dense cluster, doubles.
pub fn landscape(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut random = Random(seed);
    let ground = |x: f64, y: f64| 100.0 + 12.0 * (x / 23.0).sin() + 7.0 * (y / 31.0).cos() + 0.1 * x;
    let mut points: Vec<[f64; 3]> = Vec::new();
    while points.len() < count {
        let (x, y) = (200.0 * random.unit(), 150.0 * random.unit());
        let kind = random.unit();
        if (60.0..110.0).contains(&x) && (40.0..80.0).contains(&y) && kind < 0.97 {
            continue;
        }
        points.push(match kind {
            k if k < 0.80 => [x, y, ground(x, y) + 0.05 * random.unit()],
            k if k < 0.93 => {
                [150.0 + 3.0 * random.unit(), 20.0 + 3.0 * random.unit(), ground(151.0, 21.0) + 2.0 * random.unit()]
            }
            k if k < 0.95 => points.last().copied().unwrap_or([x, y, 100.0]),
            k if k < 0.98 => [x, y, ground(x, y) + 8.0],
            _ => [x, y, ground(x, y) + 300.0 * (random.unit() - 0.5)],
        });
    }
    points
}
