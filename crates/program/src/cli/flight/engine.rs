//! COLMAP's commands, by the program of that name or by Python's pycolmap.

use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::Duration;

use anyhow::{Result, bail};
use autoref_flight::Error;

use crate::cli::progress::Steps;

/// What runs the commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Program {
    /// The program `colmap`; pycolmap where there is none.
    Colmap,
    /// Python's pycolmap, version 4, in the interpreter `python3` or the one that `AUTOREF_PYTHON` names.
    Pycolmap,
}

/// The commands for pycolmap.
const SCRIPT: &str = include_str!("pycolmap.py");
/// How [`SCRIPT`] ends without pycolmap, and with one that is too old.
const NOT_THERE: i32 = 71;
const TOO_OLD: i32 = 72;

/// Options of version 3.8 that later versions call otherwise.
const RENAMED: [(&str, &str); 4] = [
    ("SiftExtraction.use_gpu", "FeatureExtraction.use_gpu"),
    ("SiftExtraction.num_threads", "FeatureExtraction.num_threads"),
    ("SiftMatching.use_gpu", "FeatureMatching.use_gpu"),
    ("SiftMatching.num_threads", "FeatureMatching.num_threads"),
];

impl Program {
    /// Runs a command of COLMAP, its words going to `log`.
    ///
    /// # Errors
    /// When neither program is there, or the command fails; [`no_pair`]'s when no two frames fit together.
    pub fn run(self, log: &Path, arguments: &[(&str, String)], command: &str) -> Result<()> {
        let by_colmap = match self {
            Program::Colmap => by_colmap(log, arguments, command)?,
            Program::Pycolmap => None,
        };
        if let Some(status) = by_colmap {
            return judged(status, log, &format!("colmap {command}"));
        }
        let mut python = Command::new(std::env::var_os("AUTOREF_PYTHON").unwrap_or_else(|| "python3".into()));
        python.args(["-c", SCRIPT]);
        match (started(python, log, arguments, command)?.map(|status| (status, status.code())), self) {
            (Some((_, Some(TOO_OLD))), _) => bail!(
                "{}; update it (pip install --upgrade pycolmap) and run the command again",
                std::fs::read_to_string(log).unwrap_or_default().trim()
            ),
            (None | Some((_, Some(NOT_THERE))), Program::Colmap) => bail!(
                "`colmap` is not there, nor pycolmap in python3; install one (Debian, Ubuntu: apt-get install colmap; conda: conda \
                 install colmap; pip install pycolmap, and AUTOREF_PYTHON if it is in an environment) and run the command again"
            ),
            (None | Some((_, Some(NOT_THERE))), Program::Pycolmap) => bail!(
                "pycolmap is not there; install it (pip install pycolmap), name its interpreter in AUTOREF_PYTHON if it is in an \
                 environment, and run the command again"
            ),
            (Some((status, _)), _) => judged(status, log, &format!("pycolmap's {command}")),
        }
    }
}

/// By the program `colmap`, with the names of 3.8, and with the later ones where it does not know those. `None` without
/// such a program.
fn by_colmap(log: &Path, arguments: &[(&str, String)], command: &str) -> Result<Option<ExitStatus>> {
    let first = started(Command::new("colmap"), log, arguments, command)?;
    if first.is_none_or(|status| status.success()) || !says(log, "unrecognised option") {
        return Ok(first);
    }
    let later = |key: &str| RENAMED.iter().find(|r| r.0 == key).map(|r| r.1);
    let renamed: Vec<(&str, String)> = arguments.iter().map(|(k, v)| (later(k).unwrap_or(k), v.clone())).collect();
    started(Command::new("colmap"), log, &renamed, command)
}

/// Runs a program to its end; `None` when it is not there.
fn started(mut run: Command, log: &Path, arguments: &[(&str, String)], command: &str) -> Result<Option<ExitStatus>> {
    autoref_raster::protected::refuse_input(log)?;
    let file = std::fs::File::create(log).map_err(|e| Error::io(log, "create", e))?;
    let twin = file.try_clone().map_err(|e| Error::io(log, "write", e))?;
    let program = run.get_program().display().to_string();
    run.arg(command).env("QT_QPA_PLATFORM", "offscreen").stdin(Stdio::null()).stdout(file).stderr(twin);
    for (key, value) in arguments {
        run.arg(format!("--{key}")).arg(value);
    }
    autoref_raster::child::ends_with_us(&mut run);
    let mut child = match run.spawn() {
        Ok(child) => child,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(e) => bail!("{program} cannot be run: {e}"),
    };
    let steps = Steps::new(command, 0);
    let mut wait = FIRST_LOOK;
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Ok(Some(status)),
            Ok(None) => {}
            Err(e) => bail!("{program} cannot be waited for: {e}"),
        }
        std::thread::sleep(wait);
        wait = (2 * wait).min(LONGEST_LOOK);
        if wait == LONGEST_LOOK
            && let Some((done, of)) = std::fs::read(log).ok().and_then(|text| counted(&String::from_utf8_lossy(&text)))
        {
            steps.at(done, of);
        }
    }
}

/// Between two looks at a command that runs.
const FIRST_LOOK: Duration = Duration::from_millis(1);
const LONGEST_LOOK: Duration = Duration::from_millis(256);

/// How far a command is by its own words: the last `[3/9]` of a line.
fn counted(log: &str) -> Option<(u64, u64)> {
    log.lines().rev().find_map(|line| {
        let (done, of) = line.rsplit_once('[')?.1.split_once(']')?.0.split_once('/')?;
        Some((done.trim().parse().ok()?, of.trim().parse().ok()?))
    })
}

fn judged(status: ExitStatus, log: &Path, what: &str) -> Result<()> {
    match status.code() {
        Some(0) => Ok(()),
        // It says so and fails when no two frames fit together.
        Some(1) if says(log, "failed to create") => Err(no_pair().into()),
        _ => bail!("{what} ended with {status}; {} has its words; run the command again to resume", log.display()),
    }
}

fn says(log: &Path, words: &str) -> bool {
    std::fs::read(log).is_ok_and(|text| String::from_utf8_lossy(&text).contains(words))
}

/// No two frames fit together.
pub fn no_pair() -> Error {
    Error::no_result(
        "COLMAP found no two frames that fit together",
        "check the focal length, the neighbours and the directions of the rough table (pitch -90 looks straight down), or raise adjust.features",
    )
}

#[cfg(test)]
mod tests {
    use super::counted;

    #[test]
    fn a_log_says_how_far_its_command_is() {
        assert_eq!(
            counted("Processed file [2/14]\n  Features: 10521\nProcessed file [3/14]\n  Name: r[0].png\n"),
            Some((3, 14))
        );
        assert_eq!(counted("I20260101 feature.cc:1] Processed file [1/2]"), Some((1, 2)));
        assert_eq!(counted("Importing matches\na - b\n"), None);
    }
}
