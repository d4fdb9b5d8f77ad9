//! Rolls through the program: time and memory over many frames, scans of every kind and quality, resuming, exit codes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use assert_cmd::assert::Assert;

fn large() -> bool {
    std::env::var_os("AUTOREF_LARGE").is_some()
}

fn program() -> assert_cmd::Command {
    assert_cmd::Command::cargo_bin("autoref-stream").expect("built")
}

fn draw(folder: &Path, camera: &str, more: &[&str]) {
    program().arg("synth-film").arg(folder).args(["--camera", camera]).args(more).assert().success();
}

fn examine(scans: &[PathBuf], out: &Path, camera: &str, more: &[&str]) -> Assert {
    program().arg("fiducials").args(scans).args(["--camera", camera, "--quiet", "-o"]).arg(out).args(more).assert()
}

fn said(run: &Assert) -> String {
    String::from_utf8(run.get_output().stdout.clone()).expect("text")
}

fn peak_mib(said: &str) -> f64 {
    let (before, _) = said.split_once(" MiB at most").expect("says its memory");
    before.rsplit(' ').next().and_then(|v| v.parse().ok()).expect("a number")
}

/// Time and memory of frames as they come from a scanner. The full size only with `AUTOREF_LARGE=1`, the limit of time only in
/// an optimised build.
#[test]
fn memory_does_not_grow_with_the_roll_and_a_frame_takes_a_moment() {
    let folder = tempfile::tempdir().expect("a folder");
    let (pixel_um, counts): (_, &[usize]) = if large() { ("13.77", &[1, 20, 200]) } else { ("45", &[1, 12]) };
    for (layout, tiles) in [("tiles", "512"), ("strips", "0")] {
        let drawn = folder.path().join(layout);
        draw(&drawn, "svalbard-zeiss-1936", &["--pixel-um", pixel_um, "--tiles", tiles]);
        let frame = drawn.join("svalbard-zeiss-1936-1.tif");
        let mut peaks = vec![];
        for &count in counts {
            let roll = folder.path().join(format!("roll-{layout}-{count}"));
            std::fs::create_dir(&roll).expect("new");
            for k in 0..count {
                std::fs::hard_link(&frame, roll.join(format!("f{k:03}.tif"))).expect("the same file system");
            }
            let started = Instant::now();
            let text =
                said(&examine(&[roll], &folder.path().join("out"), "svalbard-zeiss-1936", &["--threads", "1"]).code(0));
            let each_s = started.elapsed().as_secs_f64() / count as f64;
            println!("{layout}, {count} frames: {each_s:.3} s a frame, {:.0} MiB", peak_mib(&text));
            assert!(text.starts_with(&format!("{count} frames: {count} OK")), "{text}");
            assert!(peak_mib(&text) <= 128.0, "{text}");
            assert!(cfg!(debug_assertions) || !large() || each_s <= 0.3, "{each_s} s a frame");
            peaks.push(peak_mib(&text));
            std::fs::remove_dir_all(folder.path().join("out")).expect("written");
        }
        let growth = peaks.last().expect("one run") - peaks[0];
        assert!(growth < 8.0, "{growth} MiB more for {counts:?} frames");
    }
}
