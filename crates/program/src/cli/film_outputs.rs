//! What `fiducials` writes besides its JSON and table.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use autoref_film::tables::PixelOrigin;
use autoref_film::{Camera, FrameResult, InteriorModel, contact_sheet, micmac, replay, tables};
use autoref_raster::atomic;
use autoref_review::{PatchFile, Subject};
use clap::ValueEnum;

#[derive(clap::Args, Debug)]
pub struct FilmOutputArgs {
    /// Write MicMac's Ori-InterneScan, a CSV and a GeoJSON per frame, and the contact sheet.
    #[arg(long, help_heading = "Outputs")]
    pub exports: bool,
    /// From where pixels count in the XML and CSV of --exports: the first pixel's outer corner (GDAL) or its centre
    /// (numpy, OpenCV).
    #[arg(long, value_enum, default_value_t = PixelsFrom::Corner, requires = "exports", help_heading = "Outputs")]
    pub pixels_from: PixelsFrom,
    /// Replay what a contact sheet saved; writes NAME.reviewed.json.
    #[arg(long, value_name = "FILE", help_heading = "Outputs")]
    pub patch: Option<PathBuf>,
    #[command(flatten)]
    pub resampling: super::film_resample::ResampleArgs,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum PixelsFrom {
    Corner,
    Centre,
}

/// Applies the patch to `frames`, then writes what was asked for into `dir`.
pub fn write_outputs(
    dir: &Path,
    camera: &Camera,
    frames: &mut [FrameResult],
    model: InteriorModel,
    args: &FilmOutputArgs,
) -> anyhow::Result<()> {
    if let Some(path) = &args.patch {
        replay(dir, camera, frames, model, path)?;
    }
    if args.exports {
        export(dir, camera, frames, model, args)?;
    }
    if args.resampling.resample {
        super::film_resample::resample_roll(dir, camera, frames, &args.resampling)?;
    }
    Ok(())
}

/// What a review of the frames has saved.
///
/// # Errors
/// When it cannot be read, or is of another review.
pub fn patch(path: &Path) -> anyhow::Result<PatchFile> {
    Ok(PatchFile::read(path, Subject::Fiducials)?)
}

fn replay(
    dir: &Path,
    camera: &Camera,
    frames: &mut [FrameResult],
    model: InteriorModel,
    path: &Path,
) -> anyhow::Result<()> {
    let edits = patch(path)?;
    let mut named = edits.edits.iter().filter_map(replay::names);
    if let Some((frame, _)) = named.find(|(name, _)| frames.iter().all(|f| f.name != *name)) {
        bail!("{}: frame {frame} is not in this roll", path.display());
    }
    for frame in frames.iter_mut() {
        if let Some(next) = replay::replay(camera, frame, &edits, model)? {
            let json = serde_json::to_vec_pretty(&next).context("a result is plain data")?;
            atomic::write(&dir.join(format!("{}.reviewed.json", next.name)), &json)?;
            *frame = next;
        }
    }
    Ok(())
}

fn export(
    dir: &Path,
    camera: &Camera,
    frames: &[FrameResult],
    model: InteriorModel,
    args: &FilmOutputArgs,
) -> anyhow::Result<()> {
    let origin = match args.pixels_from {
        PixelsFrom::Corner => PixelOrigin::Corner,
        PixelsFrom::Centre => PixelOrigin::Centre,
    };
    let ori = dir.join("Ori-InterneScan");
    std::fs::create_dir_all(&ori).with_context(|| format!("{}: cannot make it", ori.display()))?;
    atomic::write(&ori.join("MeasuresCamera.xml"), micmac::camera_xml(camera).as_bytes())?;
    atomic::write(&dir.join("id_fiducial.txt"), micmac::names(camera).as_bytes())?;
    atomic::write(&dir.join("fiducials_hipp.csv"), tables::hipp_csv(camera, frames, origin).as_bytes())?;
    atomic::write(&dir.join("inner_orientation.csv"), tables::orientations_csv(camera, frames).as_bytes())?;
    atomic::write(&dir.join("roll_marks.csv"), tables::roll_marks_csv(camera, frames).as_bytes())?;
    for frame in frames {
        let measures = ori.join(format!("MeasuresIm-{}.xml", micmac::file_name(frame)));
        match micmac::image_xml(frame, origin) {
            Some(xml) => atomic::write(&measures, xml.as_bytes())?,
            // One of an earlier run would be believed.
            None if measures.exists() => {
                std::fs::remove_file(&measures).with_context(|| format!("{}: cannot remove it", measures.display()))?;
            }
            None => {}
        }
        let to = |end: &str| dir.join(format!("{}.{end}", frame.name));
        atomic::write(&to("measures.csv"), tables::measures_csv(frame, origin).as_bytes())?;
        atomic::write(&to("geojson"), tables::geojson(frame).as_bytes())?;
    }
    contact_sheet::write_sheet(&dir.join("contact_sheet.html"), camera, frames, model)?;
    Ok(())
}
