//! What the system does to a run in the middle of it: a kill between the files that it puts in place, a disk that
//! cannot be read any further, an input that became shorter while it was read. The faults are put in by `strace`, call
//! by call. Every command of `commands::CASES` with AUTOREF_LARGE=1; in `make test` one in sixteen.

use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Output};

use super::commands::{CASES, Case, everything, surround};
use super::faults::{Clean, contents};
use crate::common::{large, skipped};

/// `make test` takes one command in so many.
const QUICK_EACH: usize = 16;
/// A run puts fewer files in place.
const MOST_FILES: usize = 24;

/// Runs the case with what `strace` puts in.
fn run_with(dir: &Path, case: &Case, fault: &[&str]) -> Output {
    run_words(dir, &case.arguments(), fault)
}

pub(super) fn run_words(dir: &Path, words: &[String], fault: &[&str]) -> Output {
    let mut command = Command::new("strace");
    command.args(["-f", "-qq", "-o", "/dev/null"]).args(fault).arg(env!("CARGO_BIN_EXE_autoref-stream"));
    surround(command.args(words), dir);
    command.output().expect("strace starts")
}

pub(super) fn can_trace() -> bool {
    let tried = Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).output();
    let can = tried.is_ok_and(|run| run.status.success());
    if !can {
        skipped("strace is absent, or may not trace here");
    }
    can
}

/// Commands that this run asks, each with what it writes without a fault.
fn asked(dir: &Path, turn: usize) -> impl Iterator<Item = (&'static Case, Clean)> {
    let only = std::env::var("AUTOREF_CASE").ok();
    let chosen = move |number: usize, case: &Case| match &only {
        Some(word) => case.line.contains(word),
        None => large() || (number % QUICK_EACH == turn && !case.is_slow()),
    };
    let chosen = CASES.iter().enumerate().filter(move |(number, case)| chosen(*number, case));
    chosen.map(move |(_, case)| (case, Clean::of(dir, case)))
}

fn empty(folder: &Path) {
    let _ = std::fs::remove_dir_all(folder);
    std::fs::create_dir(folder).expect("a folder");
}

#[test]
fn a_kill_between_the_files_of_a_run_leaves_each_of_them_whole() {
    if !can_trace() {
        return;
    }
    let place = everything();
    let (dir, out, scratch) = (&place.at(""), place.at("o"), place.at("tmp"));
    let (mut kills, mut bad) = (0, Vec::new());
    for (case, clean) in asked(dir, 1) {
        for number in 1..=MOST_FILES {
            empty(&out);
            let fault = format!("inject=rename,renameat,renameat2,link,linkat:signal=KILL:when={number}");
            let ran = run_with(dir, case, &["-e", &fault]);
            let killed = ran.status.signal().is_some() || ran.status.code() == Some(137);
            // Parts, which the next run removes.
            let hidden = |name: &Path| name.components().any(|c| c.as_os_str().to_string_lossy().starts_with('.'));
            let seen = contents(&out, &[]).into_iter().filter(|(name, _)| !hidden(name)).collect();
            let mut faults = clean.faults(&seen);
            if killed {
                kills += 1;
                let next = super::commands::command(dir).args(case.arguments()).output().expect("the program starts");
                if !matches!(next.status.code(), Some(0 | 1)) {
                    faults.push(format!("the next run: {}", String::from_utf8_lossy(&next.stderr)));
                }
                faults.extend(
                    clean.faults(&contents(&out, &[])).into_iter().map(|what| format!("after the next run: {what}")),
                );
            }
            empty(&scratch);
            bad.extend(faults.into_iter().map(|what| format!("{} killed at file {number}: {what}", case.line)));
            if !killed {
                break;
            }
        }
    }
    let _ = std::fs::remove_dir_all(&out);
    eprintln!("{kills} kills, {} things wrong", bad.len());
    assert!(kills > 0 && bad.is_empty(), "{}", bad.join("\n"));
}

/// Bad sectors from the n-th reading of the input on, and an end of the file that came before.
const READINGS: [&str; 4] = ["error=EIO:when=1+", "error=EIO:when=3+", "retval=0:when=2+", "retval=0:when=4+"];

#[test]
fn an_input_that_cannot_be_read_to_its_end_is_named() {
    if !can_trace() {
        return;
    }
    let place = everything();
    let (dir, out, scratch) = (&place.at(""), place.at("o"), place.at("tmp"));
    let (mut count, mut reached, mut bad) = (0, 0, Vec::new());
    for (at, (case, clean)) in asked(dir, 2).enumerate() {
        let inputs = contents(dir, &["o", "tmp", "k"]);
        let all = case.inputs.iter().enumerate().flat_map(|input| READINGS.iter().enumerate().map(move |r| (input, r)));
        for ((number, input), (turn, reading)) in all {
            // Bad sectors and an early end, each sooner or later in turn.
            if !large() && (at + number + [0, 1, 1, 0][turn]) % 2 == 1 {
                continue;
            }
            empty(&out);
            let fault = format!("inject=read,pread64,readv,preadv:{reading}");
            let ran = run_with(dir, case, &["-P", input, "-e", &fault]);
            let said = String::from_utf8_lossy(&ran.stderr).into_owned();
            // What is found without a frame that cannot be read is a result like any other.
            let of_frames = case.line.starts_with("fiducials") || said.contains(": left out: ");
            let mut faults = if of_frames { Vec::new() } else { clean.faults(&contents(&out, &[])) };
            match ran.status.code() {
                // The fault came after the last reading; or all that was read is a whole list of fewer points.
                Some(0 | 1) => {}
                Some(2) => {
                    reached += 1;
                    let lines: Vec<&str> = said.lines().filter(|line| line.starts_with("autoref-stream:")).collect();
                    let stem = Path::new(input).file_name().expect("a file").to_string_lossy();
                    let folder = Path::new(input).parent().filter(|folder| *folder != Path::new(""));
                    let named = |line: &str| {
                        line.contains(&*stem) || folder.is_some_and(|folder| line.contains(&*folder.to_string_lossy()))
                    };
                    if lines.len() != 1 || said.lines().any(|line| line.starts_with("ERROR ")) {
                        faults.push(format!("not one line: {said}"));
                    } else if !named(lines[0]) {
                        faults.push(format!("does not name the input: {said}"));
                    }
                }
                _ => faults.push(format!("{:?}: {said}", ran.status)),
            }
            if contents(dir, &["o", "tmp", "k"]) != inputs {
                faults.push("an input changed".into());
            }
            empty(&scratch);
            count += 1;
            bad.extend(faults.into_iter().map(|what| format!("{} with {input} under {reading}: {what}", case.line)));
        }
    }
    let _ = std::fs::remove_dir_all(&out);
    eprintln!("{count} faults, {reached} of them reached, {} things wrong", bad.len());
    assert!(reached > 0 && bad.is_empty(), "{}", bad.join("\n"));
}
