//! Reading what other programs wrote: cameras, poses, tie points and points measured in images.

mod affinity;
pub mod colmap;
pub mod image_points;
mod json;
pub mod micmac;
mod model;
pub mod opensfm;
mod own;
pub mod tables;
mod titles;
pub mod units;

use std::path::Path;

pub use self::model::{FARTHEST, Photograph, Reconstruction, TiePoint, same_image};
use crate::error::{Error, Result};

/// Reads a reconstruction, whatever program made it: a folder with COLMAP's model (text or binary), a folder with
/// MicMac's orientations (`Ori-…`, v1 or MMVII), OpenSfM's `reconstruction.json`, or a `cameras.json` of this program.
///
/// # Errors
/// When nothing that is known lies there, or it is broken.
pub fn reconstruction(path: &Path) -> Result<Reconstruction> {
    let model = any_reconstruction(path)?;
    let mut names: Vec<&str> = model.photographs.iter().map(|p| p.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        let place = format!("the frame `{}`", pair[0]);
        return Err(Error::format(
            path,
            place,
            "two images bear this name; a frame has one place: take one of them out",
        ));
    }
    match model.photographs.iter().find(|p| p.pose.centre.iter().any(|v| v.is_nan() || v.abs() >= FARTHEST)) {
        Some(astray) => Err(Error::format(
            path,
            format!("the frame `{}`", astray.name),
            format!(
                "its camera stands at ({:e}, {:e}, {:e})",
                astray.pose.centre.x, astray.pose.centre.y, astray.pose.centre.z
            ),
        )),
        None => Ok(model),
    }
}

fn any_reconstruction(path: &Path) -> Result<Reconstruction> {
    if path.is_dir() {
        if let Some(folder) = colmap::model_folder(path) {
            return colmap::read(&folder);
        }
        for name in ["reconstruction.json", "opensfm/reconstruction.json", "cameras.json"] {
            if path.join(name).is_file() {
                return reconstruction(&path.join(name));
            }
        }
        if micmac::is_orientation_folder(path) {
            return micmac::read_orientations(path);
        }
        return Err(Error::format(
            path,
            "the folder",
            "holds neither COLMAP's model (cameras, images, points3D as .bin or .txt), nor MicMac's orientations \
             (Orientation-*.xml, Ori-*.xml), nor OpenSfM's reconstruction.json",
        ));
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match path.extension().and_then(|e| e.to_str()).map(str::to_lowercase).as_deref() {
        Some("json") => opensfm::read(path),
        // An orientation stands for its folder, as a file of COLMAP's model does; no other file does.
        Some("xml") if micmac::is_orientation_name(path) && micmac::is_orientation_folder(folder) => {
            micmac::read_orientations(folder)
        }
        _ if !path.exists() => Err(Error::format(path, "the name", "there is no such file or folder")),
        Some("xml") => Err(Error::format(
            path,
            "the name",
            "is none of MicMac's orientations (Orientation-*.xml, Ori-PerspCentral-*.xml); give their folder; XML of Metashape \
             and others is not read: export the block as COLMAP's model",
        )),
        Some("bin" | "txt") if colmap::is_name(path) => colmap::read(folder),
        Some("bin" | "txt") if path.exists() => Err(Error::format(
            path,
            "the name",
            "is none of a COLMAP model's files (cameras, images, points3D as .txt or .bin); give its cameras.txt or its folder",
        )),
        _ => Err(Error::format(
            path,
            "the name",
            "is of no known reconstruction; give the folder of COLMAP's model, of MicMac's orientations, or reconstruction.json",
        )),
    }
}

/// A file of this text, which goes with the second.
#[cfg(test)]
fn text_file(text: &str) -> (std::path::PathBuf, tempfile::TempPath) {
    let file = tempfile::NamedTempFile::new().expect("writable").into_temp_path();
    std::fs::write(&file, text).expect("writable");
    (file.to_path_buf(), file)
}
