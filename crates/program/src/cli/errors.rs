//! What `--json` prints of an error: `{"error": {"kind", "file", "place", "message", "remedy"}}`.

use autoref_raster::Error;
use serde_json::{Value, json};

/// The document of an error that was said as `line`. What an error does not have is null.
pub fn document(error: &anyhow::Error, line: &str) -> Value {
    let known = error.chain().find_map(|cause| cause.downcast_ref::<Error>());
    let (kind, file, place, remedy) = match known {
        Some(Error::Format { path, place, .. }) => ("format", Some(path), Some(place), None),
        Some(Error::Unsupported { path, remedy, .. }) => ("unsupported", Some(path), None, Some(remedy)),
        Some(Error::Usage { remedy, .. }) => ("usage", None, None, Some(remedy)),
        Some(Error::Limit { remedy, .. }) => ("limit", None, None, Some(remedy)),
        Some(Error::Io { path, .. }) => ("io", Some(path), None, None),
        Some(Error::Gdal { path, .. }) => ("gdal", Some(path), None, None),
        Some(_) => ("other", None, None, None),
        None => flight(error),
    };
    let file = file.map(|path| path.display().to_string());
    json!({"error": {"kind": kind, "file": file, "place": place, "message": line, "remedy": remedy}})
}

type Parts<'a> = (&'static str, Option<&'a std::path::PathBuf>, Option<&'a String>, Option<&'a String>);

/// The errors of flights.
fn flight(error: &anyhow::Error) -> Parts<'_> {
    use autoref_flight::Error;
    match error.chain().find_map(|cause| cause.downcast_ref::<Error>()) {
        Some(Error::Format { path, place, .. }) => ("format", Some(path), Some(place), None),
        Some(Error::Usage { remedy, .. }) => ("usage", None, None, Some(remedy)),
        Some(Error::Io { path, .. }) => ("io", Some(path), None, None),
        Some(Error::NoResult { remedy, .. }) => ("refused", None, None, Some(remedy)),
        Some(_) | None => ("other", None, None, None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_an_object() {
        let error = anyhow::Error::from(Error::format("a.csv", "row 7", "no number")).context("reading the list");
        let said = document(&error, "said");
        assert_eq!(
            said,
            json!({"error": {"kind": "format", "file": "a.csv", "place": "row 7", "message": "said", "remedy": null}})
        );
        let usage = document(&Error::usage("an output exists", "give --overwrite").into(), "said");
        assert_eq!((&usage["error"]["kind"], &usage["error"]["remedy"]), (&json!("usage"), &json!("give --overwrite")));
    }
}
