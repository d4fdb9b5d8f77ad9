//! Reading what other programs wrote: cameras, poses, tie points and points measured in images.

mod affinity;
pub mod colmap;
pub mod image_points;
pub mod micmac;
pub mod opensfm;
mod own;
pub mod tables;
mod titles;
pub mod units;

use std::path::Path;

use nalgebra::Vector3;

use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::pose::Pose;

/// No coordinate of a map, nor of a model at any scale that means something, is as large.
pub const FARTHEST: f64 = 1e12;

/// A photograph of a reconstruction.
#[derive(Clone, Debug)]
pub struct Photograph {
    pub name: String,
    /// Index into [`Reconstruction::cameras`].
    pub camera: usize,
    pub pose: Pose,
}

/// A point seen in several photographs.
#[derive(Clone, Debug)]
pub struct TiePoint {
    pub xyz: Vector3<f64>,
    /// Photograph and pixel.
    pub seen: Vec<(usize, [f64; 2])>,
}

/// Cameras and ties that were solved together, in a datum of their own.
#[derive(Clone, Debug, Default)]
pub struct Reconstruction {
    pub cameras: Vec<Camera>,
    pub photographs: Vec<Photograph>,
    pub ties: Vec<TiePoint>,
    /// Longitude, latitude, height of the origin when the world is east, north, up there (OpenSfM).
    pub reference_lla: Option<[f64; 3]>,
    pub notes: Vec<String>,
}

impl Reconstruction {
    /// Takes out cameras that no photograph was taken with, as COLMAP keeps them of images that it left out.
    pub fn drop_unused_cameras(&mut self) {
        let mut place = vec![None; self.cameras.len()];
        self.photographs.iter().for_each(|p| place[p.camera] = Some(0));
        let used = place.iter().map(Option::is_some).collect::<Vec<_>>();
        place.iter_mut().flatten().enumerate().for_each(|(new, place)| *place = new);
        let mut keep = used.iter();
        self.cameras.retain(|_| *keep.next().expect("a word for each camera"));
        for p in &mut self.photographs {
            p.camera = place[p.camera].expect("the photograph was taken with it");
        }
    }

    /// A photograph by its name, with or without folder and extension.
    pub fn find(&self, name: &str) -> Option<usize> {
        same_image(name, self.photographs.iter().map(|p| p.name.as_str()))
    }
}

/// The index of an image by name: whole, else without folders, else without extension when that is unique.
pub fn same_image<'a>(name: &str, names: impl Iterator<Item = &'a str> + Clone) -> Option<usize> {
    let base = |n: &str| n.rsplit(['/', '\\']).next().unwrap_or(n).to_string();
    let stem = |n: &str| {
        let b = base(n);
        let cut = b.rsplit_once('.').map(|(s, _)| s.to_string());
        let stem = cut.filter(|s| !s.is_empty()).unwrap_or(b).to_lowercase();
        // `fiducials --resample` calls the frame of a scan so.
        stem.strip_suffix(".resampled").map_or(stem.clone(), str::to_string)
    };
    if let Some(i) = names.clone().position(|n| n == name) {
        return Some(i);
    }
    let only = |same: &dyn Fn(&str) -> bool| {
        let mut found = names.clone().enumerate().filter(|(_, n)| same(n)).map(|(i, _)| i);
        found.next().filter(|_| found.next().is_none())
    };
    let wanted = base(name);
    only(&|n| base(n) == wanted).or_else(|| {
        let wanted = stem(name);
        only(&|n| stem(n) == wanted)
    })
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_of_no_photograph_go() {
        let camera = |name: &str| Camera::pinhole(name, [100.0, 80.0], 90.0, [50.0, 40.0]);
        let pose = Pose { rotation: nalgebra::Matrix3::identity(), centre: Vector3::zeros() };
        let photograph = |name: &str, camera| Photograph { name: name.into(), camera, pose };
        let mut model = Reconstruction {
            cameras: ["a", "b", "c", "d"].map(camera).to_vec(),
            photographs: vec![photograph("1", 3), photograph("2", 1)],
            ..Reconstruction::default()
        };
        model.drop_unused_cameras();
        let names: Vec<&str> = model.photographs.iter().map(|p| model.cameras[p.camera].name.as_str()).collect();
        assert_eq!((model.cameras.len(), names), (2, vec!["d", "b"]));
    }
}
