//! What a reviewer of the contact sheet changed, replayed on the frames.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::check::agreement;
use super::frame::FindOptions;
use super::inner::{Observation, residual_um, solve};
use super::types::{Camera, FrameResult, FrameStatus, InnerModel, MarkStatus};
use crate::coords::PixelPoint;
use crate::error::{Error, Result};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmPatch {
    pub schema: String,
    pub schema_version: u32,
    #[serde(rename = "for")]
    pub subject: String,
    pub source: String,
    pub edits: Vec<FilmEdit>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmEdit {
    pub frame: String,
    pub mark: String,
    pub action: FilmAction,
    #[serde(default)]
    pub x: Option<f64>,
    #[serde(default)]
    pub y: Option<f64>,
    #[serde(default)]
    pub note: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FilmAction {
    Accept,
    Reject,
    Move,
    NotVisible,
}

/// Reads a patch file for fiducial marks.
///
/// # Errors
/// When it cannot be read, is for something else, or a `move` has no finite x and y.
pub fn read_patch(path: &Path) -> Result<FilmPatch> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io(path, "read", e))?;
    let patch: FilmPatch =
        serde_json::from_str(&text).map_err(|e| Error::format(path, format!("line {}", e.line()), e.to_string()))?;
    if (patch.schema.as_str(), patch.schema_version, patch.subject.as_str()) != ("autoref-stream-patch", 1, "fiducials")
    {
        let what = format!("{} version {} for {}", patch.schema, patch.schema_version, patch.subject);
        return Err(Error::unsupported(path, what, "give a patch that a contact sheet saved"));
    }
    for (i, edit) in patch.edits.iter().enumerate() {
        let placed = [edit.x, edit.y].iter().all(|v| v.is_some_and(f64::is_finite));
        if edit.action == FilmAction::Move && !placed {
            return Err(Error::format(path, format!("edit {}", i + 1), "move needs x and y"));
        }
    }
    Ok(patch)
}

/// Applies the edits that name this frame and solves again with the marks that are then OK. Marks that nobody touched keep
/// what the program said of them. `None` when no edit names the frame.
///
/// # Errors
/// [`Error::Usage`] when an edit names a mark that the camera has not, or accepts one that has no place.
pub fn replay(
    camera: &Camera,
    frame: &FrameResult,
    patch: &FilmPatch,
    model: InnerModel,
) -> Result<Option<FrameResult>> {
    let mut edits = patch.edits.iter().filter(|e| e.frame == frame.name).peekable();
    if edits.peek().is_none() {
        return Ok(None);
    }
    let mut next = frame.clone();
    for edit in edits {
        let place = format!("{} {}", edit.frame, edit.mark);
        let mark = next.marks.iter_mut().find(|m| m.mark == edit.mark);
        let mark =
            mark.ok_or_else(|| Error::usage(format!("{place}: no such mark"), "use the patch with its own roll"))?;
        match (edit.action, edit.x, edit.y) {
            (FilmAction::Move, Some(x), Some(y)) => {
                mark.centre = Some(PixelPoint { x, y });
                (mark.status, mark.reason) = (MarkStatus::Ok, Some("placed by hand".into()));
            }
            (FilmAction::Accept, ..) if mark.centre.is_some() => {
                (mark.status, mark.reason) = (MarkStatus::Ok, Some("accepted by hand".into()));
            }
            (FilmAction::Reject, ..) => {
                (mark.status, mark.reason) = (MarkStatus::Doubtful, Some("rejected by hand".into()));
            }
            (FilmAction::NotVisible, ..) => {
                (mark.status, mark.centre, mark.reason) = (MarkStatus::Missing, None, Some("not visible".into()));
            }
            _ => return Err(Error::usage(format!("{place}: it has no place to accept"), "place it first")),
        }
    }
    resolve(camera, &mut next, model);
    Ok(Some(next))
}

/// A hand can err too: marks that a review calls good are compared with each other as found ones are.
fn contradictions(camera: &Camera, frame: &FrameResult, mirrored: bool) -> Vec<String> {
    let film = camera.film_points();
    let used: Vec<usize> = (0..frame.marks.len().min(film.len()))
        .filter(|&k| frame.marks[k].status == MarkStatus::Ok && frame.marks[k].centre.is_some())
        .collect();
    let points: Vec<([f64; 2], PixelPoint)> =
        used.iter().filter_map(|&k| Some((film[k], frame.marks[k].centre?))).collect();
    let options = FindOptions::default();
    let pixel_um = frame.inner.as_ref().map_or(f64::INFINITY, |inner| inner.pixel_um);
    let tolerance_px = (options.agreement_um / pixel_um).max(options.agreement_px);
    agreement(&points, mirrored, tolerance_px)
        .iter()
        .zip(&used)
        .filter_map(|(compared, &k)| Some(format!("{}: {}", frame.marks[k].mark, compared.reason.as_ref()?)))
        .collect()
}

fn resolve(camera: &Camera, frame: &mut FrameResult, model: InnerModel) {
    let place = |name: &str| camera.marks.iter().find(|c| c.name == name).and_then(|c| Some([c.x_mm?, c.y_mm?]));
    let used: Vec<Observation> = frame
        .marks
        .iter()
        .filter(|m| m.status == MarkStatus::Ok)
        .filter_map(|m| {
            let covariance_px2 = m.covariance_px2.unwrap_or([0.04, 0.0, 0.04]);
            Some(Observation { name: m.mark.clone(), mm: place(&m.mark)?, pixel: m.centre?, covariance_px2 })
        })
        .collect();
    let mirrored = frame.inner.as_ref().is_some_and(|i| i.mirrored);
    frame.inner = solve(camera, &used, model, mirrored);
    for m in &mut frame.marks {
        m.residual_um = match (&frame.inner, m.centre, place(&m.mark)) {
            (Some(inner), Some(c), Some(mm)) => residual_um(inner, mm, c),
            _ => None,
        };
    }
    let short = format!("{} of {} marks after review", used.len(), camera.marks.len());
    frame.status = match (&frame.inner, used.len()) {
        (None, _) => FrameStatus::Failed { reasons: vec![short] },
        (Some(_), 0..=2) => FrameStatus::Doubtful { reasons: vec![short] },
        (Some(_), n) if n < camera.marks.len() => FrameStatus::Doubtful { reasons: vec![short] },
        (Some(_), _) => FrameStatus::Ok,
    };
    let contradictions = contradictions(camera, frame, mirrored);
    if frame.inner.is_some() && !contradictions.is_empty() {
        frame.status = FrameStatus::Doubtful { reasons: contradictions };
    }
    frame.notes.push("reviewed by hand".into());
}
