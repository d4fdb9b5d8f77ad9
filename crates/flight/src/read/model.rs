//! What was reconstructed: cameras, photographs and ties.

use nalgebra::Vector3;

use crate::camera::Camera;
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
    /// The CRS whose coordinates and axes the poses are in, or `local`, where the reconstruction states it
    /// (`cameras.json`); else they are Cartesian.
    pub crs: Option<String>,
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
