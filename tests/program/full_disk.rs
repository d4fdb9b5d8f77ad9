//! A full disk is one line that names the output and what helps, whichever of GDAL's drivers writes.

use std::path::{Path, PathBuf};
use std::process::Command;

use gdal::DriverManager;
use gdal::raster::Buffer;

use crate::common::skipped;

const SIDE: usize = 300;

struct Disk(PathBuf);

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

/// Rough ground, which packs badly and has many contour lines.
fn model(path: &Path, seed: u64) {
    let driver = DriverManager::get_driver_by_name("GTiff").expect("a driver");
    let mut set = driver.create_with_band_type::<f32, _>(path, SIDE, SIDE, 1).expect("a file");
    set.set_geo_transform(&[500_000.0, 10.0, 0.0, 8_700_000.0, 0.0, -10.0]).expect("a place");
    let mut dice = autoref_raster::random::SplitMix64(seed);
    let height = |i: usize| {
        let (x, y) = ((i % SIDE) as f64, (i / SIDE) as f64);
        (300.0 + 60.0 * (x / 11.0).sin() * (y / 14.0).cos() + 3.0 * dice.normal()) as f32
    };
    let mut buffer = Buffer::new((SIDE, SIDE), (0..SIDE * SIDE).map(height).collect());
    set.rasterband(1).expect("a band").write((0, 0), (SIDE, SIDE), &mut buffer).expect("written");
}

#[test]
fn a_full_disk_is_called_so() {
    let folder = tempfile::tempdir().expect("a folder");
    let disk = folder.path().join("small");
    std::fs::create_dir(&disk).expect("a folder");
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=100k", "tmpfs"]).arg(&disk).output();
    if !mount.is_ok_and(|output| output.status.success()) {
        return skipped("a tmpfs cannot be mounted here");
    }
    let disk = Disk(disk);
    model(&folder.path().join("a.tif"), 1);
    model(&folder.path().join("b.tif"), 2);
    let mut dice = autoref_raster::random::SplitMix64(3);
    let points: String =
        (0..40_000).map(|_| format!("{} {} {}\n", 300.0 * dice.unit(), 300.0 * dice.unit(), dice.normal())).collect();
    std::fs::write(folder.path().join("cloud.xyz"), points).expect("written");
    for line in [
        "dem contour a.tif -o small/k.geojson --interval 10",
        "dem contour a.tif -o small/k.shp --interval 10",
        "dem contour a.tif -o small/k.gpkg --interval 10",
        "dem align a.tif --to b.tif -o small/aligned.tif",
        "dem compare a.tif b.tif -o small/compared",
        "dem slope a.tif -o small/slope.tif",
        "dem resample a.tif -o small/m_{res}.tif --resolution 11",
        "mosaic a.tif b.tif -o small/mosaic.tif",
        "cloud grid cloud.xyz -o small/grids --cell 1",
        "cloud grid cloud.xyz -o small/grids --cell 1 --scratch .",
    ] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_autoref-stream"));
        let ran = command.current_dir(folder.path()).args(line.split(' ')).output().expect("it runs");
        let said = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert_eq!((ran.status.code(), said.lines().count()), (Some(2), 1), "{line}: {said}");
        let full = said.contains("the disk is full") || said.contains("No space left") || said.contains("kB free");
        assert!(full && said.contains("make room there") && said.contains("small/"), "{line}: {said}");
        assert!(!said.contains(".part"), "{line}: {said}");
        let left: Vec<_> = std::fs::read_dir(&disk.0).expect("a folder").flatten().map(|e| e.path()).collect();
        assert!(left.is_empty(), "{line}: {left:?}");
    }
}
