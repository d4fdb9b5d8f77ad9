//! Files that appear whole or not at all.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};

/// Writes `content` under a temporary name beside `path`, brings it to disk, and renames it.
///
/// # Errors
/// When the system says no; nothing is left behind then.
pub fn write(path: &Path, content: &[u8]) -> Result<()> {
    with_temporary(path, |temporary| {
        let mut file = std::fs::File::create(temporary).map_err(|e| Error::io(path, "create", e))?;
        file.write_all(content).and_then(|()| file.sync_all()).map_err(|e| Error::io(path, "write", e))
    })
}

/// Lets `produce` make a file under a temporary name in the same folder, then renames it to `path`. The extension is kept,
/// since GDAL's drivers look at it.
///
/// # Errors
/// Those of `produce` and of the renaming; the temporary file is removed then.
pub fn with_temporary(path: &Path, produce: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let temporary = temporary_name(path);
    let result = produce(&temporary)
        .and_then(|()| std::fs::rename(&temporary, path).map_err(|e| Error::io(path, "put in place", e)));
    if result.is_err() {
        // It may not exist; the first error is the one to report.
        let _ = std::fs::remove_file(&temporary);
    }
    result
}

fn temporary_name(path: &Path) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let extension = path.extension().map_or(String::new(), |e| format!(".{}", e.to_string_lossy()));
    path.with_file_name(format!(".{stem}.{}.part{extension}", std::process::id()))
}

/// Refuses, before any work, to write over what is there.
///
/// # Errors
/// [`Error::Usage`] naming the first file that exists when `overwrite` is false, or that is a directory; [`Error::Io`]
/// when a folder does not exist.
pub fn check_outputs(paths: &[&Path], overwrite: bool) -> Result<()> {
    for path in paths {
        if path.is_dir() {
            return Err(Error::usage(format!("the output {} is a directory", path.display()), "name a file"));
        }
        if !overwrite && path.exists() {
            return Err(Error::usage(
                format!("the output {} exists", path.display()),
                "give --overwrite to replace it, or --out DIR to write elsewhere",
            ));
        }
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            let missing = std::io::Error::new(std::io::ErrorKind::NotFound, "the folder does not exist");
            return Err(Error::io(folder, "write into", missing));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let path = folder.path().join("a.json");
        let failed = with_temporary(&path, |temporary| {
            std::fs::write(temporary, b"half").map_err(|e| Error::io(temporary, "write", e))?;
            Err(Error::usage("interrupted", "try again"))
        });
        assert!(failed.is_err());
        assert_eq!(std::fs::read_dir(folder.path()).expect("readable").count(), 0);
    }

    #[test]
    fn an_existing_output_is_refused_before_any_work() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        assert!(check_outputs(&[file.path()], false).is_err());
        assert!(check_outputs(&[file.path()], true).is_ok());
    }
}
