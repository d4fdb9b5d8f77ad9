//! Folders for outputs: there when a file is to lie in them, gone again when none came.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// A folder for outputs. What of it and of the folders above it was made for it, and is still empty when it is dropped,
/// is removed: a run that is refused leaves nothing behind.
#[must_use = "the folder is removed with it"]
#[derive(Debug)]
pub struct OutputFolder {
    /// From the deepest up.
    made: Vec<PathBuf>,
}

impl OutputFolder {
    /// Makes the folder and those above it that are missing.
    ///
    /// # Errors
    ///
    /// [`Error::Io`] where it cannot be made, such as below a file.
    pub fn make(folder: &Path) -> Result<OutputFolder> {
        let missing = |path: &&Path| !path.as_os_str().is_empty() && !path.exists();
        let made = folder.ancestors().take_while(missing).map(Path::to_owned).collect();
        // Dropped, it removes what could be made before the failure.
        let folder_made = OutputFolder { made };
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, "create the output folder", e))?;
        Ok(folder_made)
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        for folder in &self.made {
            // Fails where there are files in it.
            if std::fs::remove_dir(folder).is_err() && folder.exists() {
                return;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_made_and_is_empty_goes_again() {
        let place = tempfile::tempdir().expect("a folder");
        let (above, deep) = (place.path().join("a"), place.path().join("a/b/c"));
        std::fs::create_dir(&above).expect("a folder");
        drop(OutputFolder::make(&deep).expect("made"));
        assert!(above.is_dir() && !above.join("b").exists());
        let made = OutputFolder::make(&deep).expect("made");
        std::fs::write(deep.join("kept"), "").expect("a file");
        drop(made);
        assert!(deep.join("kept").is_file());
    }

    #[test]
    fn a_folder_below_a_file_is_named() {
        let place = tempfile::tempdir().expect("a folder");
        std::fs::write(place.path().join("file"), "").expect("a file");
        let error = OutputFolder::make(&place.path().join("file/b")).expect_err("a file is no folder");
        assert!(error.to_string().contains("file/b"), "{error}");
    }
}
