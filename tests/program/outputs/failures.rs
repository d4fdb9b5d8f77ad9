//! What fails leaves everything as it was.

use std::path::PathBuf;
use std::process::{Command, Output as Ran};

use super::{Sample, TURNED, names, refused};

#[test]
fn existing_outputs_are_refused_before_any_work() {
    let sample = Sample::new(TURNED);
    let before = std::fs::read(sample.path("e6.tif")).expect("there");
    std::fs::write(sample.path("e6.warp.tif"), "mine").expect("written");
    let names = sample.names();
    refused(&sample.apply(&["--write", "world,tags,warp"]), &["e6.warp.tif", "exists", "--overwrite"]);
    assert_eq!(names, sample.names());
    assert!(before == std::fs::read(sample.path("e6.tif")).expect("there"));
    assert_eq!(std::fs::read_to_string(sample.path("e6.warp.tif")).expect("there"), "mine");
    refused(&sample.apply(&["--write", "wolrd"]).tap_one_line(), &["wolrd"]);
}

trait OneLine {
    fn tap_one_line(self) -> Self;
}

impl OneLine for Ran {
    /// clap adds usage hints below its message.
    fn tap_one_line(mut self) -> Self {
        let end = self.stderr.iter().position(|&b| b == b'\n').unwrap_or(self.stderr.len());
        self.stderr.truncate(end);
        self
    }
}

#[test]
fn a_failing_output_takes_the_others_back() {
    let sample = Sample::new(TURNED);
    // The image is cut off: the warper fails in the middle, after world file and tags have been prepared.
    let path = sample.path("e6.tif");
    let whole = std::fs::read(&path).expect("there");
    let mut broken = whole.clone();
    let at = broken.len() / 2;
    broken[at..at + 2000].fill(0xFF);
    std::fs::write(&path, &broken).expect("written");
    std::fs::write(sample.path("e6.tfw"), "old").expect("written");
    let names = sample.names();
    let output = sample.apply(&["--write", "world,vrt,tags,warp", "--overwrite"]);
    refused(&output, &["e6"]);
    assert_eq!(names, sample.names(), "nothing new, no temporary files");
    assert_eq!(std::fs::read_to_string(sample.path("e6.tfw")).expect("there"), "old", "what was replaced is back");
    assert!(broken == std::fs::read(&path).expect("there"), "the image was touched");
}

/// A full disk: a small tmpfs, which only root may mount.
#[test]
fn a_full_disk_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=600k", "tmpfs"]).arg(&disk).output();
    if !mount.is_ok_and(|output| output.status.success()) {
        crate::common::skipped("a tmpfs cannot be mounted here");
        return;
    }
    let _unmount = Unmount(disk.clone());
    let sample = Sample::new(TURNED);
    let out = disk.to_str().expect("plain");
    let output = sample.apply(&["--write", "world,aux,warp", "--compress", "none", "--out", out]);
    refused(&output, &["e6.warp.tif"]);
    assert!(names(&disk).is_empty(), "{:?}", names(&disk));
    // Tags: the image itself lies on the disk, filled to the last byte.
    let image = disk.join("e6.tif");
    std::fs::copy(sample.path("e6.tif"), &image).expect("it fits");
    // Memory is given out in pages: none is half full.
    let file = std::fs::OpenOptions::new().write(true).open(&image).expect("writable");
    file.set_len(file.metadata().expect("there").len().next_multiple_of(65_536)).expect("it fits");
    let before = std::fs::read(&image).expect("there");
    let filler = vec![1u8; 1 << 20];
    let _ = std::fs::write(disk.join("filler"), filler);
    let output = sample.apply(&[image.to_str().expect("plain"), "--write", "tags"]);
    refused(&output, &["e6.tif", "No space left"]);
    assert!(before == std::fs::read(&image).expect("there"), "the image is as it was");
}

struct Unmount(PathBuf);

impl Drop for Unmount {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn what_must_not_be_written_to_is_not() {
    let sample = Sample::new(TURNED);
    let path = sample.path("e6.tif");
    let mut permissions = std::fs::metadata(&path).expect("there").permissions();
    permissions.set_readonly(true);
    std::fs::set_permissions(&path, permissions).expect("settable");
    if std::fs::OpenOptions::new().write(true).open(&path).is_ok() {
        crate::common::skipped("root writes to read-only files");
    } else {
        refused(&sample.apply(&["--write", "tags"]), &["e6.tif", "open for writing"]);
    }
    refused(&sample.apply(&["absent.tif", "--write", "tags"]), &["absent.tif"]);
    refused(&sample.apply(&["absent.tif", "--write", "warp"]), &["absent.tif"]);
    assert_eq!(sample.names(), ["e6.autoref.json", "e6.tif"]);
}
