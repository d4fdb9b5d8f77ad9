//! Paths in JSON and for a shell. In JSON, names that are not UTF-8 are told with replacement characters, as everywhere
//! in messages; `serde` alone refuses them.
//!
//! ```
//! #[derive(serde::Serialize)]
//! struct Report {
//!     #[serde(serialize_with = "autoref_raster::path_text::one")]
//!     frame: std::path::PathBuf,
//! }
//! let json = serde_json::to_string(&Report { frame: "a/b.tif".into() })?;
//! assert_eq!(json, r#"{"frame":"a/b.tif"}"#);
//! # Ok::<(), serde_json::Error>(())
//! ```

use std::path::Path;

use serde::{Serialize, Serializer};

/// A path as text.
///
/// # Errors
/// The serializer's own.
pub fn one<P: AsRef<Path>, S: Serializer>(path: &P, serializer: S) -> Result<S::Ok, S::Error> {
    path.as_ref().to_string_lossy().serialize(serializer)
}

/// One that may be there.
///
/// # Errors
/// The serializer's own.
pub fn some<P: AsRef<Path>, S: Serializer>(path: &Option<P>, serializer: S) -> Result<S::Ok, S::Error> {
    path.as_ref().map(|path| path.as_ref().to_string_lossy()).serialize(serializer)
}

/// Several.
///
/// # Errors
/// The serializer's own.
pub fn many<P: AsRef<Path>, S: Serializer>(paths: &[P], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_seq(paths.iter().map(|path| path.as_ref().to_string_lossy()))
}

/// A path as a shell takes it.
pub fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=,".contains(c);
    if !text.is_empty() && text.chars().all(plain) {
        return text;
    }
    format!("'{}'", text.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;
    use std::path::PathBuf;

    #[test]
    fn paths_are_quoted_for_the_shell() {
        assert_eq!(quoted(Path::new("/a/b.tif")), "/a/b.tif");
        assert_eq!(quoted(Path::new("a b's.tif")), r"'a b'\''s.tif'");
    }

    #[derive(Serialize)]
    struct Paths {
        #[serde(serialize_with = "one")]
        one: PathBuf,
        #[serde(serialize_with = "some")]
        some: Option<PathBuf>,
        #[serde(serialize_with = "many")]
        many: Vec<PathBuf>,
    }

    #[test]
    fn names_that_are_no_utf_8_are_told() {
        let odd = PathBuf::from(OsStr::from_bytes(b"l\xf8.tif"));
        let paths = Paths { one: odd.clone(), some: Some(odd.clone()), many: vec![odd, "b".into()] };
        let json = serde_json::to_string(&paths).expect("text");
        assert_eq!(json, "{\"one\":\"l\u{fffd}.tif\",\"some\":\"l\u{fffd}.tif\",\"many\":[\"l\u{fffd}.tif\",\"b\"]}");
    }
}
