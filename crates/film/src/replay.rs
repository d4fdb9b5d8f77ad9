//! What a reviewer of the contact sheet changed, replayed on the frames.

use super::check::agreement;
use super::frame::FindOptions;
use super::interior::{Observation, residual_um, solve};
use super::types::{Camera, FrameResult, FrameStatus, MarkStatus};
use autoref_raster::coords::{Handedness, PixelPoint};
use autoref_raster::error::{Error, Result};
use autoref_review::HAND_VARIANCE_PX2;
use autoref_review::{Action, Edit, PatchFile, Target};

/// The frame and the mark that an edit is about; `None` for edits of GCPs, which a patch for fiducial marks has not.
pub fn names(edit: &Edit) -> Option<(&str, &str)> {
    match &edit.target {
        Target::Fiducial { frame, mark } => Some((frame, mark)),
        Target::Gcp { .. } => None,
    }
}

/// Applies the edits that name this frame and solves again with the marks that are then OK. Marks that nobody touched
/// keep what the program said of them. `options` are those that the frames were looked at with; a frame that was not
/// solved has their handedness. `None` when no edit names the frame.
///
/// # Errors
/// [`Error::Usage`] when an edit names a mark that the camera has not, accepts one that has no place, or picks.
pub fn replay(
    camera: &Camera,
    frame: &FrameResult,
    patch: &PatchFile,
    options: &FindOptions,
) -> Result<Option<FrameResult>> {
    let mine = |e| names(e).filter(|(of, _)| *of == frame.name).map(|(_, mark)| (e, mark));
    let mut edits = patch.edits.iter().filter_map(mine).peekable();
    if edits.peek().is_none() {
        return Ok(None);
    }
    let mut next = frame.clone();
    for (edit, name) in edits {
        let place = edit.target.to_string();
        if let (Some(was), Some(found)) = (edit.was, frame.marks.iter().find(|m| m.mark == name)) {
            shows(found.centre, was).map_err(|is| {
                let what = format!("{place}: the page had shown it at {:.1}, {:.1}, and {is}", was[0], was[1]);
                Error::usage(what, "use the patch with its own roll, or remove `was` from it to replay it all the same")
            })?;
        }
        let mark = next.marks.iter_mut().find(|m| m.mark == name);
        let mark =
            mark.ok_or_else(|| Error::usage(format!("{place}: no such mark"), "use the patch with its own roll"))?;
        match (edit.action, edit.x, edit.y) {
            (Action::Move, Some(x), Some(y)) => {
                mark.centre = Some(PixelPoint { x, y });
                mark.covariance_px2 = Some([HAND_VARIANCE_PX2, 0.0, HAND_VARIANCE_PX2]);
                mark.score = None;
                (mark.status, mark.reason) = (MarkStatus::Ok, Some("placed by hand".into()));
            }
            (Action::Accept, ..) if mark.centre.is_some() => {
                (mark.status, mark.reason) = (MarkStatus::Ok, Some("accepted by hand".into()));
            }
            (Action::Reject, ..) => {
                (mark.status, mark.reason) = (MarkStatus::Doubtful, Some("rejected by hand".into()));
            }
            (Action::NotVisible, ..) => {
                (mark.status, mark.centre, mark.reason) = (MarkStatus::Missing, None, Some("not visible".into()));
            }
            (Action::Pick, ..) => {
                return Err(Error::usage(format!("{place}: fiducial marks have no list to pick from"), "use move"));
            }
            _ => return Err(Error::usage(format!("{place}: it has no place to accept"), "place it first")),
        }
    }
    resolve(camera, &mut next, options);
    Ok(Some(next))
}

/// Whether a mark is where a page had shown it; else in words where it is.
fn shows(centre: Option<PixelPoint>, was: [f64; 2]) -> std::result::Result<(), String> {
    /// Another version of the program may measure a mark so much otherwise.
    const FAR_PX: f64 = 3.0;
    match centre {
        Some(at) if (at.x - was[0]).hypot(at.y - was[1]) <= FAR_PX => Ok(()),
        Some(at) => Err(format!("the roll has it at {:.1}, {:.1}", at.x, at.y)),
        None => Err("the roll has it nowhere".into()),
    }
}

/// A hand can err too: marks that a review calls good are compared with each other as found ones are.
fn contradictions(camera: &Camera, frame: &FrameResult, mirrored: Handedness, options: &FindOptions) -> Vec<String> {
    let film = camera.film_points();
    let used: Vec<usize> = (0..frame.marks.len().min(film.len()))
        .filter(|&k| frame.marks[k].status == MarkStatus::Ok && frame.marks[k].centre.is_some())
        .collect();
    let points: Vec<([f64; 2], PixelPoint)> =
        used.iter().filter_map(|&k| Some((film[k], frame.marks[k].centre?))).collect();
    let pixel_um = frame.interior.as_ref().map_or(f64::INFINITY, |interior| interior.pixel_um);
    let tolerance_px = (options.agreement_um / pixel_um).max(options.agreement_px);
    agreement(&points, mirrored, tolerance_px)
        .iter()
        .zip(&used)
        .filter_map(|(compared, &k)| Some(format!("{}: {}", frame.marks[k].mark, compared.reason.as_ref()?)))
        .collect()
}

fn resolve(camera: &Camera, frame: &mut FrameResult, options: &FindOptions) {
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
    let unsolved = options.mirrored.unwrap_or(Handedness::AsIs);
    let mirrored = frame.interior.as_ref().map_or(unsolved, |i| i.mirrored);
    frame.interior = solve(camera, &used, options.model, mirrored);
    for m in &mut frame.marks {
        m.residual_um = match (&frame.interior, m.centre, place(&m.mark)) {
            (Some(interior), Some(c), Some(mm)) => residual_um(interior, mm, c),
            _ => None,
        };
    }
    let short = format!("{} of {} marks after review", used.len(), camera.marks.len());
    frame.status = match (&frame.interior, used.len()) {
        (None, _) => FrameStatus::Failed { reasons: vec![short] },
        (Some(_), 0..=2) => FrameStatus::Doubtful { reasons: vec![short] },
        (Some(_), n) if n < camera.marks.len() => FrameStatus::Doubtful { reasons: vec![short] },
        (Some(_), _) => FrameStatus::Ok,
    };
    let contradictions = contradictions(camera, frame, mirrored, options);
    if frame.interior.is_some() && !contradictions.is_empty() {
        frame.status = FrameStatus::Doubtful { reasons: contradictions };
    }
    frame.notes.push("reviewed by hand".into());
}
