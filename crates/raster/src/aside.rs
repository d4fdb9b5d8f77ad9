//! Companions of a file that is replaced go with it, or come back with it.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::parts::{BEFORE, leftovers, temporary_name};
use crate::sidecars::{companions, is_called_companion};

/// Companions of an output under second names, until what replaces it is in place. Dropped before, they come back.
#[must_use = "the companions come back with it"]
#[derive(Default)]
pub(crate) struct Aside {
    /// Where each was, and its second name.
    moved: Vec<(PathBuf, PathBuf)>,
}

impl Aside {
    /// Takes the companions of `output` away, but those that are written with it. A crash afterwards leaves them their
    /// second names, as it does what they belonged to.
    ///
    /// # Errors
    /// When the system says no; all are where they were then.
    pub(crate) fn take(output: &Path, is_written: impl Fn(&Path) -> bool) -> Result<Aside> {
        let mut aside = Aside::default();
        for companion in companions(output).into_iter().filter(|companion| !is_written(companion)) {
            let mut second = temporary_name(&companion).into_os_string();
            second.push(BEFORE);
            let second = PathBuf::from(second);
            match std::fs::rename(&companion, &second) {
                Ok(()) => aside.moved.push((companion, second)),
                // Where the system takes capitals for small letters it was moved under the other name.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(Error::io(&companion, "take away with the file it belongs to", error)),
            }
        }
        Ok(aside)
    }

    /// The files that they belonged to are replaced.
    pub(crate) fn remove(mut self) {
        for (companion, second) in self.moved.drain(..) {
            tracing::warn!("{} was removed with the old file that it belonged to", companion.display());
            // A leftover second name harms nobody; the output itself is good.
            let _ = std::fs::remove_file(second);
        }
    }
}

/// Removes second names of `output` and of its companions that runs which are gone left: there is a new output now.
pub(crate) fn remove_second_names(output: &Path) {
    let is_of = |was: &Path| was == output || is_called_companion(was, output);
    for leftover in leftovers(output).filter(|leftover| leftover.was.as_deref().is_some_and(is_of)) {
        // It may be somebody else's; then it stays.
        let _ = std::fs::remove_file(leftover.path);
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        for (companion, second) in &self.moved {
            // Whatever fails here, the first error is the one that was reported.
            let _ = std::fs::rename(second, companion);
        }
    }
}

/// Refuses an output that is not there but has companions: GDAL would read the new file through them.
///
/// # Errors
/// [`Error::Usage`] naming the first.
pub fn refuse_left_behind(output: &Path) -> Result<()> {
    match companions(output).first() {
        Some(companion) if !output.exists() => Err(Error::usage(
            format!("{} lies beside the output {}, which would be read with it", companion.display(), output.display()),
            "give --overwrite to remove it, or name another output",
        )),
        _ => Ok(()),
    }
}
