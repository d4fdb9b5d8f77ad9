//! The Python that other programs' libraries are asked with.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A Python that has `module`: the one of AUTOREF_PYTHON (`make test` makes it), or the system's. `None` says so first.
pub fn python_with(module: &str) -> Option<PathBuf> {
    let imports = |python: &Path| {
        let import = format!("import {module}");
        Command::new(python).args(["-c", &import]).output().is_ok_and(|output| output.status.success())
    };
    let given = std::env::var_os("AUTOREF_PYTHON").map(PathBuf::from);
    let python = given.into_iter().chain([PathBuf::from("python3")]).find(|python| imports(python));
    if python.is_none() {
        super::skipped(format!("Python's {module} is not installed"));
    }
    python
}
