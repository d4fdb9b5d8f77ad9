//! A run that is told to end leaves nothing; one that cannot write says so before it computes.

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::common::skipped;

const PROGRAM: &str = env!("CARGO_BIN_EXE_autoref-stream");
/// A picture that takes far longer than any test.
const LONG: [&str; 6] = ["synth", "--random-gcps", "6", "--size", "60000,60000", "--quiet"];

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder").flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

#[test]
fn an_interrupted_run_leaves_nothing() {
    for (signal, number) in [("-TERM", 15), ("-INT", 2)] {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let mut run = Command::new(PROGRAM)
            .args(LONG)
            .arg("a.tif")
            .current_dir(folder.path())
            .stdout(Stdio::null())
            .spawn()
            .expect("the program starts");
        let began = Instant::now();
        while !names(folder.path()).iter().any(|name| name.contains(".part")) {
            assert!(began.elapsed() < Duration::from_secs(60), "no part was begun");
            std::thread::sleep(Duration::from_millis(20));
        }
        let told = Command::new("kill").args([signal, &run.id().to_string()]).status().expect("kill is there");
        assert!(told.success());
        let status = run.wait().expect("it ends");
        assert_eq!(status.signal(), Some(number), "it ends as any program does: {status:?}");
        assert_eq!(names(folder.path()), Vec::<String>::new(), "{signal}");
    }
}

#[test]
fn a_folder_that_cannot_be_written_into_is_refused_at_once() {
    let mounted = Command::new("unshare").args(["-m", "true"]).output();
    if !mounted.is_ok_and(|run| run.status.success()) {
        return skipped("folders that are read-only: nothing can be mounted here");
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    std::fs::create_dir(folder.path().join("o")).expect("a folder");
    for output in ["o/a.tif", "o/new/a.tif"] {
        let line = format!("exec '{PROGRAM}' {} {output}", LONG.join(" "));
        let script = format!("mount --bind o o && mount -o remount,bind,ro o && {line}");
        let began = Instant::now();
        let run = Command::new("unshare")
            .args(["-m", "bash", "-c", &script])
            .current_dir(folder.path())
            .output()
            .expect("a shell starts");
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!((run.status.code(), said.lines().count()), (Some(2), 1), "{said}");
        assert!(said.contains("write into"), "{said}");
        assert!(began.elapsed() < Duration::from_secs(20), "it was asked before the first pixel");
    }
}
