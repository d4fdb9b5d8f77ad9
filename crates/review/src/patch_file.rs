//! The patch file: what a reviewer changed, in order. Shared by the report of a run (marks of GCPs) and the contact
//! sheet of scanned film (fiducial marks of frames). `docs/report.md` documents the format.

use std::path::Path;

use serde::{Deserialize, Serialize};

use autoref_raster::bounded;
use autoref_raster::error::{Error, Result};

/// What `schema` says in every patch file.
pub const SCHEMA: &str = "autoref-stream-patch";
/// What `schema_version` says; it grows when a field changes its meaning.
pub const SCHEMA_VERSION: u32 = 1;

/// A patch file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PatchFile {
    /// [`SCHEMA`].
    pub schema: String,
    /// [`SCHEMA_VERSION`] of the program that wrote it.
    pub schema_version: u32,
    /// What the edits are about.
    #[serde(rename = "for")]
    pub subject: Subject,
    /// Name (without folder) of the result file that the page was made from.
    pub source: String,
    /// In the order in which they were made.
    pub edits: Vec<Edit>,
    /// What the page showed after the last edit; a replay is compared with it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shown: Option<Shown>,
}

/// What is being reviewed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Subject {
    /// Marks of GCPs in a run's report.
    Gcps,
    /// Fiducial marks in a roll's contact sheet.
    Fiducials,
}

/// One step of the reviewer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Edit {
    /// Whose mark.
    #[serde(flatten)]
    pub target: Target,
    /// What was done to it.
    pub action: Action,
    /// New centre, pixels; with [`Action::Move`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub x: Option<f64>,
    /// Likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub y: Option<f64>,
    /// Index in the result's list of candidates; with [`Action::Pick`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub candidate: Option<usize>,
    /// Where the mark was in the result that the page showed, pixels: a replay refuses a result where it is elsewhere.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub was: Option<[f64; 2]>,
    /// What the reviewer wrote beside it.
    #[serde(default)]
    pub note: String,
}

/// Which mark a step is about.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Target {
    /// The mark of a GCP, by the GCP's name.
    Gcp {
        /// As the list has it.
        gcp: String,
    },
    /// A fiducial mark of a frame, by both names.
    Fiducial {
        /// As the result has it.
        frame: String,
        /// As the camera's file has it.
        mark: String,
    },
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Target::Gcp { gcp } => write!(f, "{gcp}"),
            Target::Fiducial { frame, mark } => write!(f, "{frame} {mark}"),
        }
    }
}

/// What a reviewer may do to a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// The mark is right as it is; takes a rejected or merely proposed one into the fit.
    Accept,
    /// What was found is not the mark.
    Reject,
    /// The centre is at (x, y).
    Move,
    /// Another candidate is the mark.
    Pick,
    /// The mark cannot be seen in the image.
    NotVisible,
}

/// Figures that the page showed when the patch was saved.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// Marks in the fit.
    pub points: usize,
    /// Of the fit, metres; `None` without one.
    pub rmse_m: Option<f64>,
    /// The fit's, as GDAL writes it; `None` without one.
    pub geotransform: Option<[f64; 6]>,
}

impl PatchFile {
    /// Reads and checks a patch file.
    ///
    /// # Errors
    /// When the file cannot be read, is no patch of this version, is for something else than `subject`, or has an edit
    /// that lacks what its action needs; the message names the edit.
    pub fn read(path: &Path, subject: Subject) -> Result<PatchFile> {
        let bytes = bounded::read(path, "a patch", bounded::TEXT_BYTES)?;
        let format = |place: String, what: String| Error::format(path, place, what);
        let patch: PatchFile = serde_json::from_slice(&bytes)
            .map_err(|e| format(format!("line {}", e.line()), format!("no patch file: {e}")))?;
        if patch.schema != SCHEMA || patch.schema_version != SCHEMA_VERSION {
            let found = format!("{} version {}", patch.schema, patch.schema_version);
            return Err(Error::unsupported(
                path,
                found,
                format!("this program reads {SCHEMA} version {SCHEMA_VERSION}"),
            ));
        }
        if patch.subject != subject {
            let words = |s| if s == Subject::Gcps { "GCPs" } else { "fiducial marks" };
            return Err(Error::usage(
                format!("{} is a patch for {}, not for {}", path.display(), words(patch.subject), words(subject)),
                "give it to the command whose page saved it",
            ));
        }
        for (i, edit) in patch.edits.iter().enumerate() {
            edit.check(subject).map_err(|what| format(format!("edit {} ({})", i + 1, edit.target), what))?;
        }
        Ok(patch)
    }

    /// As text, as a page saves it.
    pub fn to_json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).expect("plain fields, no failing serialiser");
        text.push('\n');
        text
    }
}

impl Edit {
    fn check(&self, subject: Subject) -> Result<(), String> {
        if matches!(self.target, Target::Gcp { .. }) != (subject == Subject::Gcps) {
            return Err("names a mark of the other kind".into());
        }
        match (self.action, self.x, self.y, self.candidate) {
            (Action::Move, Some(x), Some(y), _) if x.is_finite() && y.is_finite() => Ok(()),
            (Action::Move, ..) => Err("`move` needs x and y".into()),
            (Action::Pick, _, _, None) => Err("`pick` needs the index of a candidate".into()),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<PatchFile> {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        std::fs::write(file.path(), text).expect("writable");
        PatchFile::read(file.path(), Subject::Gcps)
    }

    #[test]
    fn a_patch_reads_back_and_names_marks_of_both_kinds() {
        let text = r#"{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"e6.autoref.json","edits":[
            {"gcp":"A","action":"move","x":10.5,"y":3.25,"note":""},{"gcp":"<b>","action":"not-visible"}]}"#;
        let patch = read(text).expect("a patch");
        assert_eq!(patch.edits[1].action, Action::NotVisible);
        assert_eq!(read(&patch.to_json()).expect("our own text"), patch);
        let film = r#"{"frame":"1936_12","mark":"left","action":"reject"}"#;
        let edit: Edit = serde_json::from_str(film).expect("an edit");
        assert_eq!(edit.target, Target::Fiducial { frame: "1936_12".into(), mark: "left".into() });
    }

    #[test]
    fn another_schema_or_version_is_not_read() {
        let named = |schema: &str, version: u32| {
            read(&format!(r#"{{"schema":"{schema}","schema_version":{version},"for":"gcps","source":"","edits":[]}}"#))
        };
        assert!(named(SCHEMA, SCHEMA_VERSION).is_ok());
        assert!(named(SCHEMA, SCHEMA_VERSION + 1).is_err() && named("autoref-stream-result", SCHEMA_VERSION).is_err());
    }

    #[test]
    fn what_an_action_lacks_is_said_with_its_place() {
        let with = |edit: &str| {
            read(&format!(
                r#"{{"schema":"autoref-stream-patch","schema_version":1,"for":"gcps","source":"","edits":[{edit}]}}"#
            ))
            .expect_err("not a whole edit")
            .to_string()
        };
        assert!(with(r#"{"gcp":"A7","action":"move","x":1}"#).contains("edit 1 (A7): `move` needs x and y"));
        assert!(with(r#"{"gcp":"A7","action":"pick"}"#).contains("candidate"));
        assert!(with(r#"{"frame":"1","mark":"left","action":"reject"}"#).contains("other kind"));
        assert!(with(r#"{"gcp":"A7","action":"burn"}"#).contains("burn"));
        assert!(read("{}").is_err() && read("no json").is_err());
    }
}
