//! What `--json` prints of an error: `{"error": {"kind", "file", "place", "message", "remedy"}}`.
//!
//! What an error carries as data is taken from it. The rest is read off its line, which is built alike everywhere: the
//! file or the option first, then the row or the like, then what is wrong, and behind the last semicolon the remedy.

use std::borrow::Cow;
use std::path::Path;

use autoref_raster::Error;
use serde_json::{Value, json};

/// The document of an error that was said as `line`. What an error does not have is null.
pub fn document(error: &anyhow::Error, line: &str) -> Value {
    let known = error.chain().find_map(|cause| cause.downcast_ref::<Error>());
    let (kind, file, place, remedy) = known.map_or_else(|| flight(error), parts);
    let (said_file, said_place) = file_and_place(line);
    let file = file.map(|path| path.display().to_string()).or(said_file);
    let place = place.cloned().or(said_place);
    let remedy = remedy.map(Cow::into_owned).or_else(|| remedy_of(line)).or_else(|| of_kind(known?));
    json!({"error": {"kind": kind, "file": file, "place": place, "message": line, "remedy": remedy}})
}

/// What helps against most errors of a kind, where nothing more is known.
fn of_kind(error: &Error) -> Option<String> {
    let remedy = match error {
        Error::Format { .. } => "mend the file at that place, or take another copy",
        Error::Gdal { .. } => "ask gdalinfo or ogrinfo what the file is, or take another copy",
        Error::Io { source, .. } if source.kind() == std::io::ErrorKind::NotFound => "name a file that is there",
        _ => return None,
    };
    Some(remedy.to_string())
}

/// Commands that print a line of JSON for each frame.
const IN_LINES: [&str; 2] = ["fiducials", "mask"];

/// The document as `command` prints it: on one line where its results are.
pub fn text(document: &Value, command: Option<&str>) -> String {
    let in_lines = command.is_some_and(|command| IN_LINES.contains(&command));
    if in_lines {
        return format!("{document}\n");
    }
    format!("{}\n", serde_json::to_string_pretty(document).expect("plain data"))
}

type Parts<'a> = (&'static str, Option<&'a std::path::PathBuf>, Option<&'a String>, Option<Cow<'a, str>>);

fn parts(error: &Error) -> Parts<'_> {
    match error {
        Error::Format { path, place, .. } => ("format", Some(path), Some(place), None),
        Error::Unsupported { path, remedy, .. } => ("unsupported", Some(path), None, Some(remedy.into())),
        Error::Usage { remedy, .. } => ("usage", None, None, Some(remedy.into())),
        Error::CoarseDatum { install, otherwise, .. } => {
            ("usage", None, None, Some(format!("{install}, or {otherwise}").into()))
        }
        Error::Limit { remedy, .. } => ("limit", None, None, Some(remedy.into())),
        Error::Io { path, .. } => ("io", Some(path), None, None),
        Error::Gdal { path, .. } => ("gdal", Some(path), None, None),
        _ => ("other", None, None, None),
    }
}

/// The errors of flights.
fn flight(error: &anyhow::Error) -> Parts<'_> {
    use autoref_flight::Error;
    match error.chain().find_map(|cause| cause.downcast_ref::<Error>()) {
        Some(Error::Raster(inner)) => parts(inner),
        Some(Error::NoResult { remedy, .. }) => ("refused", None, None, Some(remedy.into())),
        Some(_) | None => ("other", None, None, None),
    }
}

/// The file that a line begins with, before a colon or a verb, and the row, frame or option that it names next.
fn file_and_place(line: &str) -> (Option<String>, Option<String>) {
    let (first, rest) = line.split_once(": ").map_or((line, None), |(first, rest)| (first, Some(rest)));
    if is_option(first) {
        return (None, Some(first.to_string()));
    }
    if is_file(first) {
        let next = rest.and_then(|rest| Some(rest.split_once(": ")?.0));
        return (Some(first.to_string()), next.filter(|next| is_place(next)).map(str::to_string));
    }
    // "NAME exists; give --overwrite", "NAME does not fit …": names may hold blanks.
    let blanks = first.char_indices().filter(|(_, letter)| *letter == ' ').map(|(at, _)| at);
    let named = blanks.map(|at| &first[..at]).rfind(|name| is_file(name));
    (named.map(str::to_string), None)
}

fn is_option(word: &str) -> bool {
    word.starts_with("--") && !word.contains(' ')
}

/// There is such a file, or the word can be nothing but the name of one: it has a folder or an ending.
fn is_file(word: &str) -> bool {
    if word.is_empty() || word.starts_with(['-', '`']) || word.contains("://") {
        return false;
    }
    let path = Path::new(word);
    let ending = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    let has_ending = ending.starts_with(|c: char| c.is_ascii_alphabetic()) && ending.len() <= 8;
    let is_name = !word.contains(' ') && (has_ending || word.contains('/'));
    path.exists() || is_name
}

/// A row, a line, a frame or a quoted name, and no sentence.
fn is_place(words: &str) -> bool {
    const FIRST: [&str; 10] =
        ["row ", "line ", "camera ", "frame ", "the frame ", "point ", "the point ", "mark ", "GCP ", "page "];
    words.starts_with('`') && words.ends_with('`') || FIRST.iter().any(|first| words.starts_with(first))
}

/// What stands behind the last semicolon that no brackets and no quotation hold.
fn remedy_of(line: &str) -> Option<String> {
    let is_whole = |text: &str| {
        let count = |letter: char| text.matches(letter).count();
        count('(') == count(')') && count('`') % 2 == 0
    };
    let ends = line.match_indices("; ").map(|(at, _)| &line[at + 2..]);
    ends.filter(|rest| is_whole(rest)).last().map(str::to_string)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_an_object() {
        let error = anyhow::Error::from(Error::format("a.csv", "row 7", "no number")).context("reading the list");
        let said = document(&error, "said");
        let remedy = "mend the file at that place, or take another copy";
        assert_eq!(
            said,
            json!({"error": {"kind": "format", "file": "a.csv", "place": "row 7", "message": "said", "remedy": remedy}})
        );
        let usage = document(&Error::usage("an output exists", "give --overwrite").into(), "said");
        assert_eq!((&usage["error"]["kind"], &usage["error"]["remedy"]), (&json!("usage"), &json!("give --overwrite")));
    }

    #[test]
    fn an_error_among_lines_is_a_line() {
        let error = json!({"error": {"kind": "usage"}});
        for (command, lines) in [(Some("mask"), 1), (Some("fiducials"), 1), (Some("detect"), 5), (None, 5)] {
            assert_eq!(text(&error, command).lines().count(), lines, "{command:?}");
        }
    }

    #[test]
    fn what_a_line_names_is_in_the_object() {
        let parts = |line: &str| {
            let of = &document(&anyhow::anyhow!("{line}"), line)["error"];
            ["file", "place", "remedy"].map(|key| of[key].as_str().unwrap_or("-").to_string())
        };
        assert_eq!(parts("in/a.csv: row 3: `x` is no number (a; b); correct it"), ["in/a.csv", "row 3", "correct it"]);
        assert_eq!(
            parts("out/x.tif exists; give --overwrite to replace it"),
            ["out/x.tif", "-", "give --overwrite to replace it"]
        );
        assert_eq!(parts("a.json: `crs`: \"x\" is no CRS; give another"), ["a.json", "`crs`", "give another"]);
        assert_eq!(parts("--free: `q` is no parameter; there are f, k1"), ["-", "--free", "there are f, k1"]);
        assert_eq!(parts("nothing fits (one; two)"), ["-", "-", "-"]);
        assert_eq!(parts("8.5 px are too few: give more"), ["-", "-", "-"]);
    }
}
