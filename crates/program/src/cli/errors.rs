//! What `--json` prints of an error: `{"error": {"kind", "file", "place", "message", "remedy"}}`.

use autoref_raster::Error;
use serde_json::{Value, json};

/// The document of an error that was said as `line`. What an error does not have is null.
pub fn document(error: &anyhow::Error, line: &str) -> Value {
    let known = error.chain().find_map(|cause| cause.downcast_ref::<Error>());
    let (kind, file, place, remedy) = known.map_or_else(|| flight(error), parts);
    let file = file.map(|path| path.display().to_string());
    json!({"error": {"kind": kind, "file": file, "place": place, "message": line, "remedy": remedy}})
}

type Parts<'a> = (&'static str, Option<&'a std::path::PathBuf>, Option<&'a String>, Option<&'a String>);

fn parts(error: &Error) -> Parts<'_> {
    match error {
        Error::Format { path, place, .. } => ("format", Some(path), Some(place), None),
        Error::Unsupported { path, remedy, .. } => ("unsupported", Some(path), None, Some(remedy)),
        Error::Usage { remedy, .. } => ("usage", None, None, Some(remedy)),
        Error::Limit { remedy, .. } => ("limit", None, None, Some(remedy)),
        Error::Io { path, .. } => ("io", Some(path), None, None),
        Error::Gdal { path, .. } => ("gdal", Some(path), None, None),
        _ => ("other", None, None, None),
    }
}

/// The errors of flights.
fn flight(error: &anyhow::Error) -> Parts<'_> {
    use autoref_flight::Error;
    match error.chain().find_map(|cause| cause.downcast_ref::<Error>()) {
        Some(Error::File(inner)) => parts(inner),
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
