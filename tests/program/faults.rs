//! What goes wrong while files are written and read: a full disk, a kill, a folder that takes no files, an input that
//! ends before its end. One line and exit code 2; no output is half written, no part file stays, no input changes;
//! after a kill the next run clears up. Every command of `commands::CASES` with AUTOREF_LARGE=1; in `make test` one in
//! four, under one fault each in turn.

use std::collections::BTreeMap;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use super::commands::{CASES, Case, command, everything, files_below, surround};
use crate::common::{large, skipped};

/// What happens to the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// No file can grow beyond so many bytes; the writer is told.
    FullAt(u64),
    /// The first byte beyond kills the process.
    KilledAt(u64),
    /// The folder of the outputs is a file.
    NoFolder,
    /// The folder of the outputs can be read only.
    ReadOnly,
    /// The disk of the outputs has so many KiB.
    SmallDisk(u64),
}

/// `make test` takes one command in so many.
const QUICK_EACH: usize = 4;

/// Files by name below a folder.
pub(super) type Contents = BTreeMap<PathBuf, Vec<u8>>;

pub(super) fn contents(folder: &Path, leave_out: &[&str]) -> Contents {
    let kept = |path: &PathBuf| !leave_out.iter().any(|name| path.starts_with(folder.join(name)));
    let read =
        |path: PathBuf| (path.strip_prefix(folder).expect("below").to_owned(), std::fs::read(&path).expect("readable"));
    files_below(folder).into_iter().filter(kept).map(read).collect()
}

fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// Whether the system lets us mount (in a name space of our own).
fn can_mount() -> bool {
    let tried = Command::new("unshare").args(["-m", "true"]).output();
    tried.is_ok_and(|run| run.status.success())
}

/// Runs the case under the fault. `o/` holds afterwards what lay in it in the run's own view.
fn run(dir: &Path, case: &Case, fault: Option<Fault>) -> Output {
    let arguments = case.arguments();
    let words: Vec<String> = arguments.iter().map(|word| quoted(word)).collect();
    let line = format!("{} {}", quoted(env!("CARGO_BIN_EXE_autoref-stream")), words.join(" "));
    let shell = |script: String, before: &[&str]| {
        let mut all: Vec<&str> = before.to_vec();
        all.extend(["bash", "-c", &script]);
        let mut command = Command::new(all[0]);
        surround(command.args(&all[1..]), dir);
        command.output().expect("a shell starts")
    };
    match fault {
        None | Some(Fault::NoFolder) => command(dir).args(&arguments).output().expect("the program starts"),
        Some(Fault::FullAt(bytes)) => {
            shell(format!("trap '' XFSZ; exec {line}"), &["prlimit", &format!("--fsize={bytes}")])
        }
        Some(Fault::KilledAt(bytes)) => {
            shell(format!("exec {line}"), &["prlimit", &format!("--fsize={bytes}"), "--core=0"])
        }
        Some(Fault::ReadOnly) => {
            shell(format!("mount --bind o o && mount -o remount,bind,ro o && exec {line}"), &["unshare", "-m"])
        }
        Some(Fault::SmallDisk(kib)) => shell(
            format!(
                "mkdir -p k && mount --bind o k && mount -t tmpfs -o size={kib}k none o && {{ {line}; code=$?; \
                 cp -a o/. k/; exit $code; }}"
            ),
            &["unshare", "-m"],
        ),
    }
}

/// A command as it runs without a fault.
pub(super) struct Clean {
    written: Contents,
    /// Files that have a clock in them, or that differ from run to run for another good reason.
    different: Vec<PathBuf>,
}

impl Clean {
    pub(super) fn of(dir: &Path, case: &Case) -> Clean {
        let out = dir.join("o");
        let once = || {
            let _ = std::fs::remove_dir_all(&out);
            std::fs::create_dir(&out).expect("a folder");
            let run = run(dir, case, None);
            let said = String::from_utf8_lossy(&run.stderr).into_owned();
            assert!(matches!(run.status.code(), Some(0 | 1)), "{}: {said}", case.line);
            contents(&out, &[])
        };
        let written = once();
        let clock = |name: &Path| {
            name.extension().is_some_and(|end| ["json", "html", "gpkg"].iter().any(|clocked| end == *clocked))
        };
        let again = if large() { once() } else { written.clone() };
        let different = written.iter().filter(|(name, bytes)| clock(name) || again.get(*name) != Some(bytes));
        Clean { different: different.map(|(name, _)| name.clone()).collect(), written }
    }

    fn sizes(&self) -> Vec<u64> {
        let mut sizes: Vec<u64> = self.written.values().map(|bytes| bytes.len() as u64).collect();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }

    /// What is wrong with what lies in `o/` after a run that failed: what is there must be whole.
    pub(super) fn faults(&self, left: &Contents) -> Vec<String> {
        let mut faults = Vec::new();
        for (name, bytes) in left {
            let Some(right) = self.written.get(name) else {
                faults.push(format!("left {}, {} bytes", name.display(), bytes.len()));
                continue;
            };
            // How far a flight went: the words of COLMAP, and the contents of its stages.
            if name.extension().is_some_and(|end| end == "log") {
                continue;
            }
            let whole = if name.ends_with("stages/index.html") {
                bytes.ends_with(b"</html>\n")
            } else if self.different.contains(name) {
                let end = |all: &[u8]| all[all.len().saturating_sub(2)..].to_vec();
                bytes.len() * 10 > right.len() * 9 && end(bytes) == end(right)
            } else {
                bytes == right
            };
            if !whole {
                faults.push(format!("{} has {} of {} bytes", name.display(), bytes.len(), right.len()));
            }
        }
        faults
    }
}

/// What is wrong with what a run that had to fail has said.
fn wrong(output: &Output, fault: Fault) -> Vec<String> {
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let mut faults = Vec::new();
    let lines: Vec<&str> = said.lines().filter(|line| line.starts_with("autoref-stream:")).collect();
    // Written as clocks have it, a document may be a few bytes shorter than it was; small files fit on a small disk.
    let fitted =
        matches!(fault, Fault::KilledAt(_) | Fault::SmallDisk(_)) && matches!(output.status.code(), Some(0 | 1));
    let killed = matches!(fault, Fault::KilledAt(_)) && output.status.signal().is_some();
    if fitted || killed {
        return faults;
    }
    if output.status.code() != Some(2) {
        faults.push(format!("{:?}", output.status));
    }
    // GDAL's own words to standard error begin like this.
    if lines.len() != 1 || said.contains("panicked") || said.lines().any(|line| line.starts_with("ERROR ")) {
        faults.push(format!("not one line: {said}"));
    } else if !["o/", ": o", " o ", "tmp/"].iter().any(|name| lines[0].contains(name)) {
        faults.push(format!("names no output: {said}"));
    }
    if std::env::var_os("AUTOREF_SAY").is_some() {
        eprintln!("    {}", said.trim_end());
    }
    faults
}

/// Faults of a case, by the sizes of what it writes.
fn faults_of(clean: &Clean, mounts: bool) -> Vec<Fault> {
    let sizes = clean.sizes();
    let largest = *sizes.last().expect("something is written");
    let mut faults = vec![
        Fault::FullAt(0),
        Fault::FullAt(largest.saturating_sub(largest / 16 + 1)),
        Fault::KilledAt(largest / 2),
        Fault::NoFolder,
    ];
    if large() {
        let steps =
            sizes.iter().flat_map(|size| [1, size / 3, size.saturating_sub(size / 16 + 1)]).chain([largest * 9 / 10]);
        let steps: std::collections::BTreeSet<u64> =
            steps.filter(|at| (1..largest.saturating_sub(1)).contains(at)).collect();
        faults.extend(steps.iter().flat_map(|at| [Fault::FullAt(*at), Fault::KilledAt(*at)]));
        faults.push(Fault::KilledAt(0));
    }
    if mounts {
        faults.push(Fault::ReadOnly);
        let total: u64 = clean.written.values().map(|bytes| (bytes.len() as u64).div_ceil(4096) * 4).sum();
        faults.push(Fault::SmallDisk((total / 8 * 4).max(4)));
    }
    faults
}

#[test]
fn what_cannot_be_written_leaves_nothing_half_done() {
    let place = everything();
    let dir = &place.at("");
    let out = dir.join("o");
    let mounts = can_mount();
    if !mounts {
        skipped("folders that are read-only or full: nothing can be mounted here");
    }
    if Command::new("prlimit").arg("--version").output().is_err() {
        return skipped("prlimit is absent");
    }
    let only = std::env::var("AUTOREF_CASE").ok();
    let chosen = |number: usize, case: &Case| match &only {
        Some(word) => case.line.contains(word),
        None => large() || (number.is_multiple_of(QUICK_EACH) && !case.is_slow()),
    };
    let (mut count, mut commands, mut bad) = (0, 0, Vec::new());
    for (number, case) in CASES.iter().enumerate().filter(|(number, case)| chosen(*number, case)) {
        commands += 1;
        let clean = Clean::of(dir, case);
        let inputs = contents(dir, &["o", "tmp", "k"]);
        let all = faults_of(&clean, mounts);
        let asked = if large() { &all[..] } else { &all[number / QUICK_EACH % all.len()..][..1] };
        for &fault in asked {
            let _ = std::fs::remove_dir_all(&out).or_else(|_| std::fs::remove_file(&out));
            if fault == Fault::NoFolder {
                std::fs::write(&out, "").expect("writable");
            } else {
                std::fs::create_dir(&out).expect("a folder");
            }
            let ran = run(dir, case, Some(fault));
            let mut faults = wrong(&ran, fault);
            if fault == Fault::NoFolder {
                std::fs::remove_file(&out).expect("still a file");
                std::fs::create_dir(&out).expect("a folder");
            }
            let killed = matches!(fault, Fault::KilledAt(_));
            let left = contents(&out, &[]);
            if killed {
                // A part file may lie there; the next run removes it.
                let hidden = |name: &Path| name.components().any(|c| c.as_os_str().to_string_lossy().starts_with('.'));
                let seen = left.into_iter().filter(|(name, _)| !hidden(name)).collect();
                faults.extend(clean.faults(&seen));
                let next = run(dir, case, None);
                if !matches!(next.status.code(), Some(0 | 1)) {
                    faults.push(format!("the next run: {}", String::from_utf8_lossy(&next.stderr)));
                }
                let left = contents(&out, &[]);
                faults.extend(clean.faults(&left).into_iter().map(|what| format!("after the next run: {what}")));
                if left.len() < clean.written.len() {
                    faults.push(format!("the next run wrote {} files", left.len()));
                }
            } else {
                faults.extend(clean.faults(&left));
                let scratch = files_below(&dir.join("tmp"));
                if !scratch.is_empty() {
                    faults.push(format!("left {scratch:?}"));
                }
            }
            let _ = std::fs::remove_dir_all(dir.join("tmp"));
            std::fs::create_dir(dir.join("tmp")).expect("a folder");
            if contents(dir, &["o", "tmp", "k"]) != inputs {
                faults.push("an input changed".into());
            }
            count += 1;
            bad.extend(faults.into_iter().map(|what| format!("{} under {fault:?}: {what}", case.line)));
        }
    }
    let _ = std::fs::remove_dir_all(&out);
    eprintln!("{commands} commands, {count} faults, {} things wrong", bad.len());
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}
