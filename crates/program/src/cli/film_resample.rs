//! `fiducials --resample`: every frame of a roll on the film's own grid.

use autoref_raster::atomic::Existing;
use std::path::{Path, PathBuf};

use anyhow::bail;
use autoref_film::resample::banding::Banding;
use autoref_film::resample::kernel::Kernel;
use autoref_film::resample::lighting::{self, Lighting};
use autoref_film::resample::{self, Light, ResampleOptions};
use autoref_film::{Camera, FrameResult, scan};
use autoref_raster::fingerprint::{Fingerprint, size_and_time};
use autoref_raster::words::counted;
use clap::ValueEnum;

/// Frames of a roll that its light is taken from, evenly picked: more do not change it and would only be read.
const LIGHT_FRAMES: usize = 60;

#[derive(clap::Args, Debug)]
pub struct ResampleArgs {
    /// Write every frame with an orientation on the film's own grid, with a mask of marks, boxes and what the scan does
    /// not show.
    #[arg(long, help_heading = "Resampling")]
    pub resample: bool,
    /// Pixel size of --resample, millimetres.
    #[arg(long, value_name = "MM", default_value_t = 0.0135, requires = "resample", help_heading = "Resampling")]
    pub resample_mm: f64,
    /// Interpolation.
    #[arg(long, value_enum, default_value_t = KernelName::Cubic, requires = "resample", help_heading = "Resampling")]
    pub kernel: KernelName,
    /// Mask this much around every mark, millimetres.
    #[arg(long, value_name = "MM", default_value_t = 3.0, requires = "resample", help_heading = "Resampling")]
    pub mask_marks_mm: f64,
    /// Mask a box (text, clock, counter): two opposite corners in the camera's millimetres; repeat for more. The
    /// camera's file can name them too (masked_mm).
    #[arg(long, value_name = "X,Y,X,Y", value_parser = parse_box, allow_hyphen_values = true, requires = "resample", help_heading = "Resampling")]
    pub mask_box: Vec<Box4>,
    /// Even out the light: of every frame by itself, or of the roll (three frames or more), which does not mistake
    /// ground for shadow.
    #[arg(long, value_enum, default_value_t = LightingName::Off, requires = "resample", help_heading = "Resampling")]
    pub lighting: LightingName,
    /// Remove bands that the scanner left along its rows or columns.
    #[arg(long, value_enum, default_value_t = BandingName::Off, requires = "resample", help_heading = "Resampling")]
    pub banding: BandingName,
    /// Replace resampled frames that are there and were made otherwise.
    #[arg(long, help_heading = "Resampling")]
    pub overwrite: bool,
}

/// Two opposite corners.
#[derive(Clone, Copy, Debug)]
pub struct Box4(pub [f64; 4]);

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum KernelName {
    Bilinear,
    Cubic,
    Lanczos,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LightingName {
    Off,
    Frame,
    Roll,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum BandingName {
    Off,
    Rows,
    Columns,
    Both,
}

impl ResampleArgs {
    pub fn options(&self) -> anyhow::Result<ResampleOptions> {
        if !(0.0005..=1.0).contains(&self.resample_mm) {
            bail!("--resample-mm must be between 0.0005 and 1");
        }
        if !(0.0..=50.0).contains(&self.mask_marks_mm) {
            bail!("--mask-marks-mm must be between 0 and 50");
        }
        Ok(ResampleOptions {
            pixel_mm: self.resample_mm,
            kernel: match self.kernel {
                KernelName::Bilinear => Kernel::Bilinear,
                KernelName::Cubic => Kernel::Cubic,
                KernelName::Lanczos => Kernel::Lanczos,
            },
            mask_radius_mm: self.mask_marks_mm,
            boxes_mm: self.mask_box.iter().map(|b| b.0).collect(),
            banding: match self.banding {
                BandingName::Off => Banding::Off,
                BandingName::Rows => Banding::Rows,
                BandingName::Columns => Banding::Columns,
                BandingName::Both => Banding::Both,
            },
        })
    }
}

/// Writes `NAME.resampled.tif` and `NAME.mask.tif` for every frame with an orientation. Outputs that are there and
/// differ stop it before any work; frames that fail are told when the others are done.
pub fn resample_roll(dir: &Path, camera: &Camera, frames: &[FrameResult], args: &ResampleArgs) -> anyhow::Result<()> {
    let options = args.options()?;
    let solved: Vec<&FrameResult> = frames.iter().filter(|f| f.interior.is_some()).collect();
    let light = match args.lighting {
        LightingName::Off => "as scanned".to_string(),
        LightingName::Frame => "frame".into(),
        // The roll is part of what the light is.
        LightingName::Roll => format!("roll of {} ({})", solved.len(), states(&solved)),
    };
    let mut missing = Vec::new();
    for frame in solved.iter().copied() {
        let Some(interior) = &frame.interior else { continue };
        let outputs = outputs(dir, frame);
        let description = resample::description(&frame.path, camera, interior, &options, &light);
        if !resample::is_done(&outputs[0], &outputs[1], &description, Existing::of_flag(args.overwrite))? {
            missing.push((frame, interior, outputs, description));
        }
    }
    if missing.len() < solved.len() {
        tracing::info!("{} frames are resampled already", solved.len() - missing.len());
    }
    if missing.is_empty() {
        return Ok(());
    }
    let of_roll = if args.lighting == LightingName::Roll { Some(roll_light(camera, &solved, &options)?) } else { None };
    let mut failed = Vec::new();
    for (frame, interior, [image, mask], description) in &missing {
        let light = match (&of_roll, args.lighting) {
            (Some(roll), _) => Light::OfRoll(roll),
            (None, LightingName::Frame) => Light::OfFrame,
            (None, _) => Light::AsScanned,
        };
        let done = scan::open_scan(&frame.path).and_then(|source| {
            resample::resample(source.as_ref(), camera, interior, &options, light, description, [image, mask])
        });
        if let Err(error) = done {
            failed.push(error.to_string());
        }
    }
    if !failed.is_empty() {
        bail!("{} not resampled: {}", counted(failed.len(), "frame was", "frames were"), failed.join("; "));
    }
    Ok(())
}

/// What tells a roll's scans and orientations from others.
fn states(frames: &[&FrameResult]) -> String {
    let of = |frame: &&FrameResult| format!("{} {:?}", size_and_time(&frame.path), frame.interior);
    Fingerprint::of(&frames.iter().map(of).collect::<String>()).hex()
}

fn outputs(dir: &Path, frame: &FrameResult) -> [PathBuf; 2] {
    ["resampled", "mask"].map(|end| dir.join(format!("{}.{end}.tif", frame.name)))
}

fn roll_light(camera: &Camera, frames: &[&FrameResult], options: &ResampleOptions) -> anyhow::Result<Lighting> {
    let every = frames.len().div_ceil(LIGHT_FRAMES).max(1);
    let mut cells = Vec::new();
    for frame in frames.iter().step_by(every) {
        let Some(interior) = &frame.interior else { continue };
        let read = scan::open_scan(&frame.path)
            .and_then(|source| resample::frame_cells(source.as_ref(), camera, interior, options));
        match read {
            Ok(one) => cells.push(one),
            Err(error) => tracing::warn!("{}: not used for the roll's light: {error}", frame.name),
        }
    }
    match lighting::of_roll(&cells) {
        Some(light) => Ok(light),
        None => bail!(
            "the light of {} cannot be told from the ground; use --lighting frame",
            counted(cells.len(), "frame", "frames")
        ),
    }
}

pub fn parse_box(text: &str) -> Result<Box4, String> {
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|v| v.trim().parse().ok().filter(|v: &f64| v.is_finite())).collect();
    let four: Option<[f64; 4]> = numbers.and_then(|v| v.try_into().ok());
    four.map(Box4).ok_or_else(|| format!("\"{text}\" is not X,Y,X,Y in millimetres"))
}
