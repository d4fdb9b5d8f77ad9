//! The files that a run reads, which no output of it may replace.
//!
//! The program names its inputs once, before it does anything ([`protect`]); every writer of [`crate::atomic`] asks
//! [`refuse_input`] for the file that it is about to put in place. Files are told apart by device and inode, links
//! followed, so that no second name hides one. What a raster refers to, the parts of a virtual one above all, is an
//! input as well ([`crate::referred`]).

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::error::{Error, Result};
use crate::referred::referred;
use crate::sidecars::companions;

/// What an input is known by, and how the user named it.
struct Input {
    device: u64,
    inode: u64,
    path: PathBuf,
    /// The input that refers to it, where it is none that was named.
    whole: Option<PathBuf>,
    /// Whether what it refers to is in the list, too.
    followed: bool,
}

impl Input {
    /// The inode of a file that was removed goes to the next one that is made.
    fn is_in_place(&self) -> bool {
        std::fs::metadata(&self.path).is_ok_and(|found| (found.dev(), found.ino()) == (self.device, self.inode))
    }
}

static INPUTS: Mutex<Vec<Input>> = Mutex::new(Vec::new());

/// From now on no output replaces the regular file at `path`. What is no regular file, or not there, needs no
/// protection.
pub fn protect(path: &Path) {
    let Ok(found) = std::fs::metadata(path) else { return };
    if found.is_file() {
        let input =
            Input { device: found.dev(), inode: found.ino(), path: path.to_owned(), whole: None, followed: false };
        INPUTS.lock().unwrap_or_else(PoisonError::into_inner).push(input);
    }
}

/// Adds what the inputs refer to. It takes opening them, so it is done once something would be replaced.
fn follow() {
    let locked = || INPUTS.lock().unwrap_or_else(PoisonError::into_inner);
    let fresh = |input: &mut Input| (!std::mem::replace(&mut input.followed, true)).then(|| input.path.clone());
    let waiting: Vec<PathBuf> = locked().iter_mut().filter_map(fresh).collect();
    for path in waiting {
        let parts = referred(&path).into_iter().filter_map(|part| {
            let found = std::fs::metadata(&part).ok()?;
            let whole = Some(path.clone());
            Some(Input { device: found.dev(), inode: found.ino(), path: part, whole, followed: true })
        });
        let parts: Vec<Input> = parts.collect();
        locked().extend(parts);
    }
}

/// Whether two names are of one file, links followed. Names of files that are not there are compared by their folder.
pub fn same_file(a: &Path, b: &Path) -> bool {
    if let (Ok(x), Ok(y)) = (std::fs::metadata(a), std::fs::metadata(b)) {
        return (x.dev(), x.ino()) == (y.dev(), y.ino());
    }
    let place = |path: &Path| {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some((folder.canonicalize().ok()?, path.file_name()?.to_owned()))
    };
    place(a).is_some_and(|a| place(b) == Some(a))
}

/// Refuses an output that is a protected input, or a file that one refers to, under whatever name.
///
/// # Errors
/// [`Error::Usage`] naming both.
pub fn refuse_input(output: &Path) -> Result<()> {
    let Ok(found) = std::fs::metadata(output) else { return Ok(()) };
    if found.is_file() {
        follow();
    }
    let inputs = INPUTS.lock().unwrap_or_else(PoisonError::into_inner);
    let is_output = |input: &&Input| (input.device, input.inode) == (found.dev(), found.ino()) && input.is_in_place();
    match inputs.iter().find(is_output) {
        None => Ok(()),
        Some(Input { whole: None, path, .. }) => Err(is_input(output, path)),
        Some(Input { whole: Some(whole), .. }) => {
            let what = format!("the output {} is a part of the input {}", output.display(), whole.display());
            Err(Error::usage(what, KEPT))
        }
    }
}

/// Refuses an output with which an input, or what belongs to one, would go: it lies beside it as its companion.
///
/// # Errors
/// [`Error::Usage`] naming both.
pub fn refuse_inputs_beside(output: &Path) -> Result<()> {
    let beside = companions(output);
    if beside.is_empty() {
        return Ok(());
    }
    follow();
    let inputs = INPUTS.lock().unwrap_or_else(PoisonError::into_inner);
    let belongs = |companion: &Path, found: Option<(u64, u64)>, input: &Input| {
        let is_input = found == Some((input.device, input.inode));
        // There may be thousands of inputs; few are called so.
        let name = companion.file_name().unwrap_or_default().as_encoded_bytes();
        let alike = || name.starts_with(input.path.file_stem().unwrap_or_default().as_encoded_bytes());
        let is_own = || companions(&input.path).iter().any(|own| same_file(own, companion));
        (is_input && input.is_in_place()) || (alike() && is_own())
    };
    for companion in beside {
        let found = std::fs::metadata(&companion).ok().map(|found| (found.dev(), found.ino()));
        if let Some(input) = inputs.iter().find(|input| belongs(&companion, found, input)) {
            let whose = if same_file(&companion, &input.path) {
                "an input of this command".to_string()
            } else {
                format!("of the input {}", input.path.display())
            };
            let what = format!("{}, {whose}, would belong to the output {}", companion.display(), output.display());
            return Err(Error::usage(what, "name another output"));
        }
    }
    Ok(())
}

/// [`refuse_input`] for an output that is a folder, and for all that lies in it.
///
/// # Errors
/// Those of [`refuse_input`]; [`Error::Io`] when a folder cannot be listed.
pub fn refuse_inputs_below(output: &Path) -> Result<()> {
    // A link to a folder is replaced, not what it leads to.
    if std::fs::symlink_metadata(output).is_ok_and(|found| found.is_dir()) {
        let listed = |e| Error::io(output, "list", e);
        for entry in std::fs::read_dir(output).map_err(listed)? {
            refuse_inputs_below(&entry.map_err(listed)?.path())?;
        }
    }
    refuse_input(output)
}

const KEPT: &str = "name another output; an input is never written over, --overwrite or not";

/// The refusal, in words.
pub fn is_input(output: &Path, input: &Path) -> Error {
    let what = if output == input {
        format!("the output {} is an input of this command", output.display())
    } else {
        format!("the output {} is the input {}", output.display(), input.display())
    };
    Error::usage(what, KEPT)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_holds_an_input_is_no_output() {
        let folder = tempfile::tempdir().expect("a folder");
        let deep = folder.path().join("out/deep");
        std::fs::create_dir_all(&deep).expect("folders");
        let (input, link) = (folder.path().join("survey.csv"), deep.join("other.csv"));
        std::fs::write(&input, "a").expect("writable");
        std::fs::hard_link(&input, &link).expect("links");
        assert!(refuse_inputs_below(&folder.path().join("out")).is_ok());
        protect(&input);
        assert!(refuse_inputs_below(&folder.path().join("out")).is_err());
        assert!(refuse_inputs_below(&folder.path().join("out/none")).is_ok());
    }

    #[test]
    fn an_input_that_is_gone_lends_its_inode_to_no_refusal() {
        let folder = tempfile::tempdir().expect("a folder");
        let (input, link) = (folder.path().join("gone.csv"), folder.path().join("out.csv"));
        std::fs::write(&input, "a").expect("writable");
        // A second name keeps the inode, as a new file that was given it would.
        std::fs::hard_link(&input, &link).expect("links");
        protect(&input);
        assert!(refuse_input(&link).is_err());
        std::fs::remove_file(&input).expect("there");
        assert!(refuse_input(&link).is_ok());
    }

    #[test]
    fn no_name_hides_an_input() {
        let folder = tempfile::tempdir().expect("a folder");
        let at = |name: &str| folder.path().join(name);
        std::fs::write(at("list.csv"), "a").expect("writable");
        std::fs::hard_link(at("list.csv"), at("hard.csv")).expect("links");
        std::os::unix::fs::symlink(at("list.csv"), at("soft.csv")).expect("links");
        std::fs::write(at("other.csv"), "a").expect("writable");
        protect(&at("list.csv"));
        for name in ["list.csv", "hard.csv", "soft.csv"] {
            assert!(refuse_input(&at(name)).is_err(), "{name}");
            assert!(crate::atomic::write(&at(name), b"lost").is_err(), "{name}");
            assert!(crate::atomic::check_outputs(&[&at(name)], crate::atomic::Existing::Replace).is_err(), "{name}");
        }
        assert!(refuse_input(&at("other.csv")).is_ok() && refuse_input(&at("new.csv")).is_ok());
        assert_eq!(std::fs::read_to_string(at("list.csv")).expect("there"), "a");
        assert!(same_file(&at("new.csv"), &folder.path().join("./new.csv")));
        assert!(!same_file(&at("new.csv"), &at("newer.csv")));
    }
}
