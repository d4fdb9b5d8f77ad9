//! The one error type of the library. What is no error but an answer (no match, a refused georeference) is an enum with
//! data in the room it belongs to.
//!
//! ```
//! use autoref_raster::Error;
//! let error = Error::format("points.csv", "row 7", "`abc` is no number for the easting");
//! assert_eq!(error.to_string(), "points.csv: row 7: `abc` is no number for the easting");
//! ```

use std::io::ErrorKind;
use std::path::PathBuf;

/// What went wrong, split by whose fault it is: the file's, ours to support, the caller's, the budget's, the system's.
///
/// Every message is one line that names the file, the place in it and, where there is one, the remedy.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file breaks the rules of its own format: truncated, out of range, not what it claims to be.
    #[error("{}: {place}: {what}", path.display())]
    Format {
        path: PathBuf,
        /// Where in the file: "directory 0, tag 324", "row 7", "tile 12".
        place: String,
        what: String,
    },
    /// The file may be right, but it uses something this program does not read or write.
    #[error("{}: not supported: {what}; {remedy}", path.display())]
    Unsupported { path: PathBuf, what: String, remedy: String },
    /// The caller asked for something that cannot be: options that contradict each other, an output that exists.
    #[error("{what}; {remedy}")]
    Usage { what: String, remedy: String },
    /// The best change of datum that is installed is coarser than what was demanded.
    #[error("{what}; {install}, or {otherwise}")]
    CoarseDatum {
        what: String,
        /// How to install a better one.
        install: String,
        /// What helps without it; callers know other ways than the usual one.
        otherwise: String,
    },
    /// It cannot be done within the memory (or other) limit; the numbers say by how much.
    #[error("{what}: needs {needed} bytes, allowed are {allowed}; {remedy}")]
    Limit { what: String, needed: u64, allowed: u64, remedy: String },
    /// The operating system said no.
    #[error("{}: cannot {action}: {source}{}", path.display(), remedy(action, source.kind()))]
    Io {
        path: PathBuf,
        /// A verb phrase: "open", "read 4096 bytes at 17", "rename".
        action: String,
        source: std::io::Error,
    },
    /// GDAL or PROJ said no; its own words are kept.
    #[error("{}: GDAL: {what}", path.display())]
    Gdal { path: PathBuf, what: String },
}

/// What this library returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// [`Error::Format`].
    pub fn format(path: impl Into<PathBuf>, place: impl Into<String>, what: impl Into<String>) -> Self {
        Error::Format { path: path.into(), place: place.into(), what: what.into() }
    }
    /// [`Error::Unsupported`].
    pub fn unsupported(path: impl Into<PathBuf>, what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::Unsupported { path: path.into(), what: what.into(), remedy: remedy.into() }
    }
    /// [`Error::Usage`].
    pub fn usage(what: impl Into<String>, remedy: impl Into<String>) -> Self {
        Error::Usage { what: what.into(), remedy: remedy.into() }
    }
    /// [`Error::Io`]; `action` is a verb phrase.
    pub fn io(path: impl Into<PathBuf>, action: impl Into<String>, source: std::io::Error) -> Self {
        Error::Io { path: path.into(), action: action.into(), source }
    }
    /// GDAL's message may span lines; ours is one.
    pub fn gdal(path: impl Into<PathBuf>, what: impl std::fmt::Display) -> Self {
        let what = what.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        // The binding wraps GDAL's own words into which function returned nothing, or into the error's number.
        let wraps = ["returned a NULL pointer. Error msg: '", ", error msg: '"];
        let inner = wraps.iter().find_map(|wrap| what.split_once(wrap)).map(|(_, inner)| inner.trim_end_matches('\''));
        let path = path.into();
        let what = match inner {
            None => what,
            // GDAL says nothing of a file that is missing or of no format it knows.
            Some("") => match std::fs::metadata(&path) {
                Err(error) if error.kind() == ErrorKind::NotFound => "no such file".to_owned(),
                _ => "no driver recognises this file".to_owned(),
            },
            Some(inner) => inner.to_owned(),
        };
        Error::Gdal { path, what }
    }
}

/// What helps when the system refuses to write; reading has no remedy but another file.
fn remedy(action: &str, kind: ErrorKind) -> &'static str {
    const READS: [&str; 8] = ["read", "open", "find", "list", "look at", "seek", "resolve", "ask for"];
    let writes = action == "open for writing" || !READS.iter().any(|verb| action.starts_with(verb));
    match kind {
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "; make room there, or name an output on another disk",
        ErrorKind::FileTooLarge => "; name an output on a disk that takes larger files, or raise the limit (ulimit -f)",
        ErrorKind::ReadOnlyFilesystem | ErrorKind::PermissionDenied if writes => {
            "; name an output in a folder that can be written"
        }
        ErrorKind::NotADirectory if writes => "; a file stands where a folder must be: name another output",
        _ => "",
    }
}
