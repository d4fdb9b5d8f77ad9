//! What `fiducials` writes besides its JSON and table.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use autoref_film::tables::PixelOrigin;
use autoref_film::{Camera, FindOptions, FrameResult, InteriorModel, contact_sheet, micmac, replay, tables};
use autoref_raster::atomic;
use autoref_raster::coords::Handedness;
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

/// Applies the patch to `frames`, which were looked at with `options`, then writes what was asked for into `dir`.
pub fn write_outputs(
    dir: &Path,
    camera: &Camera,
    frames: &mut [FrameResult],
    options: &FindOptions,
    args: &FilmOutputArgs,
) -> anyhow::Result<()> {
    if let Some(path) = &args.patch {
        replay(dir, camera, frames, options, path)?;
    }
    if args.exports {
        export(dir, camera, frames, options.model, args)?;
    }
    if args.resampling.resample {
        super::film_resample::resample_roll(dir, camera, frames, &args.resampling)?;
    }
    Ok(())
}

/// What a review of these scans has saved.
///
/// # Errors
/// When it cannot be read, is of another review, or names a frame that is none of them.
pub fn patch_of(path: &Path, scans: &[PathBuf]) -> anyhow::Result<PatchFile> {
    let edits = PatchFile::read(path, Subject::Fiducials)?;
    let is_there =
        |name: &str| scans.iter().any(|scan| scan.file_stem().is_some_and(|stem| stem.to_string_lossy() == name));
    if let Some((frame, _)) = edits.edits.iter().filter_map(replay::names).find(|(name, _)| !is_there(name)) {
        bail!("{}: frame {frame} is not in this roll", path.display());
    }
    Ok(edits)
}

/// Which side of the film most frames of a roll show; `None` where none was solved.
fn side_of_roll(frames: &[FrameResult]) -> Option<Handedness> {
    let solved: Vec<Handedness> = frames.iter().filter_map(|f| Some(f.interior.as_ref()?.mirrored)).collect();
    let mirrored = solved.iter().filter(|side| side.is_mirrored()).count();
    (!solved.is_empty()).then(|| Handedness::from(2 * mirrored > solved.len()))
}

fn replay(
    dir: &Path,
    camera: &Camera,
    frames: &mut [FrameResult],
    options: &FindOptions,
    path: &Path,
) -> anyhow::Result<()> {
    let scans: Vec<PathBuf> = frames.iter().map(|frame| frame.path.clone()).collect();
    let edits = patch_of(path, &scans)?;
    // The scans of a roll lie alike: a frame that could not be solved does as the others.
    let options = FindOptions { mirrored: options.mirrored.or(side_of_roll(frames)), ..options.clone() };
    for frame in frames.iter_mut() {
        if let Some(next) = replay::replay(camera, frame, &edits, &options)? {
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
