//! The orientation by MicMac, where it is installed: its files are written, its commands are run, its result is read.

use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Result, bail};
use autoref_flight::Error;
use autoref_flight::adjust::RoughPose;
use autoref_flight::read::{self, Reconstruction};
use autoref_flight::world::World;
use autoref_raster::atomic;
use nalgebra::Vector3;

use super::export;
use super::project::{OrderedFrames, Project};

/// What `commands.sh` calls its last result.
const RESULT: &str = "Ori-Compensated";
/// What MicMac's poses are taken to be worth: it states no standard deviations.
const POSE_M: f64 = 1.0;
const POSE_DEG: f64 = 0.02;

/// Runs MicMac on a flight in `out`/micmac; its cameras in the coordinates of the GCPs.
///
/// # Errors
/// When `mm3d` is not there or fails, and when it leaves no orientation.
pub fn oriented(
    file: &Path,
    (project, base): (&Project, &Path),
    flight: &OrderedFrames,
    out: &Path,
) -> Result<Reconstruction> {
    let mut there = Command::new("mm3d");
    there.arg("-help").stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    match there.status() {
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            bail!(
                "`mm3d` is not there; install MicMac and put its bin folder on the PATH, or leave out --engine micmac for COLMAP"
            )
        }
        Err(e) => bail!("mm3d cannot be run: {e}"),
        Ok(_) => {}
    }
    let folder = out.join("micmac");
    match std::fs::remove_dir_all(&folder) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => return Err(Error::io(&folder, "remove", e).into()),
        _ => std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, "create", e))?,
    }
    for (name, text) in export::files(file, (project, base), flight, export::PIXEL_MM)? {
        atomic::write(&folder.join(name), text.as_bytes())?;
    }
    // MicMac reads frames and masks in its own folder only.
    for name in &flight.names {
        let (from, to) = (flight.folder.join(name), folder.join(name));
        #[cfg(unix)]
        std::os::unix::fs::symlink(&from, &to).map_err(|e| Error::io(&to, "create", e))?;
        #[cfg(not(unix))]
        std::fs::copy(&from, &to).map_err(|e| Error::io(&to, "create", e))?;
    }
    let names: Vec<&str> = flight.names.iter().map(String::as_str).collect();
    for mask in flight.masks.for_micmac(&names, &folder) {
        flight.masks.write_for_micmac(&flight.folder, &mask)?;
    }
    let log = out.join("micmac.log");
    autoref_raster::protected::refuse_input(&log)?;
    let words = std::fs::File::create(&log).map_err(|e| Error::io(&log, "create", e))?;
    let twin = words.try_clone().map_err(|e| Error::io(&log, "write", e))?;
    eprintln!("micmac …");
    let mut run = Command::new("sh");
    run.arg("commands.sh").current_dir(&folder).stdin(Stdio::null()).stdout(words).stderr(twin);
    autoref_raster::child::ends_with_us(&mut run);
    match run.status() {
        Ok(status) if status.success() => {}
        Ok(status) => bail!("mm3d ended with {status}; {} has its words", log.display()),
        Err(e) => bail!("sh cannot be run: {e}"),
    }
    read::reconstruction(&folder.join(RESULT))
        .map_err(|e| anyhow::anyhow!("MicMac left no orientation: {e}; {} has its words", log.display()))
}

/// MicMac's poses as observations, in the order of its photographs.
pub fn held(model: &Reconstruction, world: &World) -> Vec<Option<RoughPose>> {
    let of = |p: &read::Photograph| {
        let pose = world.pose_to_world(&p.pose)?;
        Some(RoughPose { pose, sigma_m: Vector3::repeat(POSE_M), sigma_rad: POSE_DEG.to_radians() })
    };
    model.photographs.iter().map(of).collect()
}

/// What a result by MicMac cannot say.
pub fn note() -> String {
    format!(
        "oriented by MicMac, whose poses count with {POSE_M} m and {POSE_DEG}\u{b0}: standard deviations are no better than these"
    )
}
