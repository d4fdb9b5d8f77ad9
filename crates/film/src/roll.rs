//! A roll: many frames in parallel, one file each, to be taken up again where it was left.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::consistency::{Facts, lowered, unlike};
use super::frame::{FindOptions, Finder, find_frame};
use super::types::{FrameResult, FrameStatus, MarkStatus};
use autoref_raster::atomic;
use autoref_raster::bounded;
use autoref_raster::cells::csv_text;
use autoref_raster::error::{Error, Result};
use autoref_raster::fingerprint::{self, Fingerprint};
use autoref_raster::output_folder::OutputFolder;

/// How a roll came out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Summary {
    pub frames: usize,
    pub ok: usize,
    pub doubtful: usize,
    pub failed: usize,
    /// Of these, taken over from an earlier run.
    pub resumed: usize,
}

impl Summary {
    fn count(&mut self, status: &FrameStatus) {
        self.frames += 1;
        match status {
            FrameStatus::Ok => self.ok += 1,
            FrameStatus::Doubtful { .. } => self.doubtful += 1,
            FrameStatus::Failed { .. } => self.failed += 1,
        }
    }
}

/// The frame's file: the result, and what it was computed from.
#[derive(Serialize, Deserialize)]
struct FrameFile {
    #[serde(flatten)]
    result: FrameResult,
    inputs: String,
    /// What was found of the frame by itself, where its roll made it doubtful: a later run starts from that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    alone: Option<FrameResult>,
}

impl FrameFile {
    /// Where the scan is now.
    fn is_at(&mut self, scan: &Path) {
        for result in self.alone.iter_mut().chain([&mut self.result]) {
            result.path = scan.to_path_buf();
        }
    }

    fn by_itself(&self) -> &FrameResult {
        self.alone.as_ref().unwrap_or(&self.result)
    }

    fn write(&self, path: &Path) -> Result<()> {
        let mut json = serde_json::to_vec_pretty(self).expect("a result is plain data");
        json.push(b'\n');
        atomic::write(path, &json)
    }
}

/// Where the result of a scan lies.
pub fn frame_json(folder: &Path, scan: &Path) -> PathBuf {
    let name = scan.file_stem().unwrap_or_default().to_string_lossy();
    folder.join(format!("{name}.fiducials.json"))
}

/// Reads a frame's result.
///
/// # Errors
/// [`Error::Io`] when it cannot be read, [`Error::Format`] when it is no result.
pub fn read_frame(path: &Path) -> Result<FrameResult> {
    read_file(path).map(|f| f.result)
}

fn read_file(path: &Path) -> Result<FrameFile> {
    let text = bounded::read_to_string(path, "a frame's result", bounded::TEXT_BYTES)?;
    serde_json::from_str(&text).map_err(|e| Error::format(path, format!("line {}", e.line()), e.to_string()))
}

/// What the result depends on: the scan's size and time, the camera, the options, the program.
fn inputs(scan: &Path, finder: &Finder, options: &FindOptions, program: &str) -> Option<String> {
    let meta = std::fs::metadata(scan).ok()?;
    let time = meta.modified().ok()?.duration_since(std::time::UNIX_EPOCH).ok()?;
    let means = Fingerprint::of(&format!("{finder:?} {options:?} {program}"));
    Some(format!("{}-{}-{}", meta.len(), time.as_nanos(), means.hex()))
}

/// Examines `scans` into `folder`: one JSON per frame as soon as it is done, then the roll's table `fiducials.csv`.
/// Frames whose JSON is there and whose inputs are unchanged are taken over. A scan that cannot be read is a failed
/// frame.
///
/// Then every frame is held against the roll ([`super::consistency`]); one that is unlike it becomes doubtful, its own
/// verdict is kept under `alone`.
///
/// `progress` is told after every frame: done, and the frame; and once more of frames that the roll made doubtful. At
/// any time one frame per thread is in memory.
///
/// # Errors
/// [`Error::Usage`] for two scans of one name; [`Error::Io`] when the folder cannot be written.
pub fn run(
    scans: &[PathBuf],
    folder: &Path,
    finder: &Finder,
    options: &FindOptions,
    progress: &(dyn Fn(usize, &FrameResult) + Sync),
) -> Result<Summary> {
    refuse_same_names(scans, folder)?;
    let _folder = OutputFolder::make(folder)?;
    let done = AtomicUsize::new(0);
    let resumed = AtomicUsize::new(0);
    let facts = scans
        .par_iter()
        .map(|scan| -> Result<Option<Facts>> {
            let file = frame_json(folder, scan);
            let now = inputs(scan, finder, options, fingerprint::program());
            let before = read_file(&file).ok().filter(|f| now.as_deref() == Some(f.inputs.as_str()));
            let content = if let Some(mut before) = before {
                resumed.fetch_add(1, Ordering::Relaxed);
                if before.result.path != *scan {
                    // The roll was moved, or is named from another folder.
                    before.is_at(scan);
                    before.write(&file)?;
                }
                before
            } else {
                let result = find_frame(finder, scan, options);
                let content = FrameFile { result, inputs: now.unwrap_or_default(), alone: None };
                content.write(&file)?;
                content
            };
            progress(done.fetch_add(1, Ordering::Relaxed) + 1, content.by_itself());
            Ok(Facts::of(&finder.camera, content.by_itself()))
        })
        .collect::<Result<Vec<_>>>()?;
    for (scan, reasons) in scans.iter().zip(unlike(&finder.camera, &facts)) {
        let file = frame_json(folder, scan);
        let before = read_file(&file)?;
        if reasons.is_empty() && before.alone.is_none() {
            continue;
        }
        let own = before.by_itself().clone();
        let now = if reasons.is_empty() {
            FrameFile { result: own, inputs: before.inputs, alone: None }
        } else {
            FrameFile { result: lowered(&own, &reasons), inputs: before.inputs, alone: Some(own) }
        };
        now.write(&file)?;
        if now.alone.is_some() {
            progress(scans.len(), &now.result);
        }
    }
    let mut summary = write_table(scans, folder)?;
    summary.resumed = resumed.into_inner();
    Ok(summary)
}

fn refuse_same_names(scans: &[PathBuf], folder: &Path) -> Result<()> {
    let mut files: Vec<(PathBuf, &PathBuf)> = scans.iter().map(|s| (frame_json(folder, s), s)).collect();
    files.sort();
    match files.windows(2).find(|w| w[0].0 == w[1].0) {
        Some(pair) => Err(Error::usage(
            format!("{} and {} have the same name", pair[0].1.display(), pair[1].1.display()),
            "give them to two runs with an output folder each",
        )),
        None => Ok(()),
    }
}

/// The roll's table: a line per mark, in the order of `scans`, residuals in micrometres. Frames are read back one at a
/// time.
fn write_table(scans: &[PathBuf], folder: &Path) -> Result<Summary> {
    let mut summary = Summary::default();
    atomic::with_temporary(&folder.join("fiducials.csv"), |path| {
        let file = std::fs::File::create(path).map_err(|e| Error::io(path, "create", e))?;
        let mut out = std::io::BufWriter::new(file);
        let failed = |e| Error::io(path, "write", e);
        let mut write = || -> Result<Summary> {
            let mut summary = Summary::default();
            writeln!(
                out,
                "frame,frame_status,mark,mark_status,x_px,y_px,sigma_px,score,residual_x_um,residual_y_um,frame_rmse_um,pixel_um,reason"
            )
            .map_err(failed)?;
            for scan in scans {
                let frame = read_frame(&frame_json(folder, scan))?;
                summary.count(&frame.status);
                table_rows(&frame, &mut out).map_err(failed)?;
            }
            out.flush().map_err(failed)?;
            Ok(summary)
        };
        summary = write()?;
        Ok(())
    })?;
    Ok(summary)
}

fn table_rows(frame: &FrameResult, out: &mut dyn Write) -> std::io::Result<()> {
    let (status, reasons) = match &frame.status {
        FrameStatus::Ok => ("ok", String::new()),
        FrameStatus::Doubtful { reasons } => ("doubtful", reasons.join("; ")),
        FrameStatus::Failed { reasons } => ("failed", reasons.join("; ")),
    };
    let number = |v: Option<f64>, digits: usize| v.map_or(String::new(), |v| format!("{v:.digits$}"));
    let interior = frame.interior.as_ref();
    let (rmse, size) = (number(interior.map(|i| i.rmse_um), 2), number(interior.map(|i| i.pixel_um), 4));
    let name = csv_text(&frame.name);
    if frame.marks.is_empty() {
        writeln!(out, "{name},{status},,,,,,,,,{rmse},{size},{}", csv_text(&reasons))?;
    }
    for m in &frame.marks {
        let mark_status = match m.status {
            MarkStatus::Ok => "ok",
            MarkStatus::Doubtful => "doubtful",
            MarkStatus::Missing => "missing",
        };
        let sigma = m.covariance_px2.map(|c| (0.5 * (c[0] + c[2])).sqrt());
        writeln!(
            out,
            "{name},{status},{},{mark_status},{},{},{},{},{},{},{rmse},{size},{}",
            csv_text(&m.mark),
            number(m.centre.map(|c| c.x), 3),
            number(m.centre.map(|c| c.y), 3),
            number(sigma, 3),
            number(m.score, 3),
            number(m.residual_um.map(|r| r[0]), 2),
            number(m.residual_um.map(|r| r[1]), 2),
            csv_text(m.reason.as_deref().unwrap_or_default()),
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::load_camera;

    #[test]
    fn what_another_build_measured_is_measured_again() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let scan = folder.path().join("a.tif");
        std::fs::write(&scan, "a scan").expect("writable");
        let finder = Finder::new(&load_camera("rmk-cross").expect("built in")).expect("drawn shapes");
        let of = |options: &FindOptions, program: &str| inputs(&scan, &finder, options, program).expect("a file");
        let options = FindOptions::default();
        let one = of(&options, "0.1.0 1000 1s");
        assert_eq!(one, of(&options, "0.1.0 1000 1s"));
        assert_ne!(one, of(&options, "0.1.0 1000 2s"), "a build of the same version");
        assert_ne!(one, of(&FindOptions { pixel_um: Some(20.0), ..options }, "0.1.0 1000 1s"));
    }
}
