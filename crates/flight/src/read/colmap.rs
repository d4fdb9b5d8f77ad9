//! COLMAP's models: `cameras`, `images`, `points3D` as text or binary, of COLMAP 3 and 4 (there with `rigs` and
//! `frames`, whose poses the images repeat).
//!
//! Source: COLMAP's documentation, "Output Format", and its camera models. COLMAP's pixels are ours: the centre of the
//! first pixel is (0.5, 0.5).

use std::collections::HashMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::model::{Photograph, Reconstruction, TiePoint};
use crate::camera::{Camera, Parameter, Projection};
use crate::error::{Error, Result, read_bytes, read_text};
use crate::pose::Pose;

/// Name, number of parameters, in the order of COLMAP's ids.
const MODELS: [(&str, usize); 18] = [
    ("SIMPLE_PINHOLE", 3),
    ("PINHOLE", 4),
    ("SIMPLE_RADIAL", 4),
    ("RADIAL", 5),
    ("OPENCV", 8),
    ("OPENCV_FISHEYE", 8),
    ("FULL_OPENCV", 12),
    ("FOV", 5),
    ("SIMPLE_RADIAL_FISHEYE", 4),
    ("RADIAL_FISHEYE", 5),
    ("THIN_PRISM_FISHEYE", 12),
    ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    ("SIMPLE_DIVISION", 4),
    ("DIVISION", 5),
    ("SIMPLE_FISHEYE", 3),
    ("FISHEYE", 4),
    ("EUCM", 6),
    ("EQUIRECTANGULAR", 2),
];
/// What to do about a model that is not read.
const REMEDY: &str = "run COLMAP with OPENCV or SIMPLE_RADIAL, a fisheye with OPENCV_FISHEYE";

/// Whether a file is called like one of a model's.
pub fn is_name(path: &Path) -> bool {
    path.file_stem()
        .is_some_and(|stem| ["cameras", "images", "points3D", "rigs", "frames"].iter().any(|name| stem == *name))
}

/// The folder of a model: itself, or the largest of `sparse/0`, `0`, `1`, … below.
pub fn model_folder(path: &Path) -> Option<PathBuf> {
    model_folders(path).into_iter().next()
}

/// The folders of models: itself, or all that it holds, the one with the most images first.
pub fn model_folders(path: &Path) -> Vec<PathBuf> {
    if holds_model(path) {
        return vec![path.to_path_buf()];
    }
    let weight = |p: &Path| {
        ["bin", "txt"]
            .iter()
            .filter_map(|e| std::fs::metadata(p.join(format!("images.{e}"))).ok())
            .map(|m| m.len())
            .max()
            .unwrap_or(0)
    };
    let mut found: Vec<PathBuf> = [path.to_path_buf(), path.join("sparse")]
        .iter()
        .filter_map(|p| std::fs::read_dir(p).ok())
        .flat_map(|d| d.flatten().map(|e| e.path()))
        .filter(|p| holds_model(p))
        .collect();
    found.sort();
    found.sort_by_key(|p| std::cmp::Reverse(weight(p)));
    found
}

fn holds_model(path: &Path) -> bool {
    let there = |e: &&str| path.join(format!("cameras.{e}")).is_file() && path.join(format!("images.{e}")).is_file();
    ["bin", "txt"].iter().any(there)
}

/// A camera of a COLMAP model.
///
/// # Errors
/// The reason as words when the model is unknown or not supported.
pub fn camera(name: &str, model: &str, size: [f64; 2], p: &[f64]) -> Result<Camera, String> {
    use Parameter::{Aspect, D1, D2, D3, K1, K2, K3, K4, P1, P2};
    let count = MODELS.iter().find(|m| m.0 == model).ok_or(format!("the model `{model}` is not known; {REMEDY}"))?.1;
    if p.len() != count || p.iter().any(|v| !v.is_finite()) || p[0] <= 0.0 {
        return Err(format!("{model} has {count} parameters, the first a positive focal length"));
    }
    let single = |f: f64, x: f64, y: f64| Camera::pinhole(name, size, f, [x, y]);
    let double = || Camera::pinhole(name, size, p[0], [p[2], p[3]]).with(Aspect, p[1] / p[0]);
    let fish = |c: Camera| Camera { projection: Projection::Fisheye, ..c };
    Ok(match model {
        "SIMPLE_PINHOLE" => single(p[0], p[1], p[2]),
        "PINHOLE" => double(),
        "SIMPLE_RADIAL" => single(p[0], p[1], p[2]).with(K1, p[3]),
        "RADIAL" => single(p[0], p[1], p[2]).with(K1, p[3]).with(K2, p[4]),
        "OPENCV" => double().with(K1, p[4]).with(K2, p[5]).with(P1, p[6]).with(P2, p[7]),
        "OPENCV_FISHEYE" => fish(double().with(K1, p[4]).with(K2, p[5]).with(K3, p[6]).with(K4, p[7])),
        "FULL_OPENCV" => {
            let c = double().with(K1, p[4]).with(K2, p[5]).with(P1, p[6]).with(P2, p[7]).with(K3, p[8]);
            c.with(D1, p[9]).with(D2, p[10]).with(D3, p[11])
        }
        "SIMPLE_RADIAL_FISHEYE" => fish(single(p[0], p[1], p[2]).with(K1, p[3])),
        "RADIAL_FISHEYE" => fish(single(p[0], p[1], p[2]).with(K1, p[3]).with(K2, p[4])),
        _ => return Err(format!("the model {model} is not supported; {REMEDY}")),
    })
}

/// Reads a model's folder, binary when both forms are there.
///
/// # Errors
/// When a file is missing, broken, or holds a camera that is not supported.
pub fn read(folder: &Path) -> Result<Reconstruction> {
    raw(folder, Parts::All)?.join(folder)
}

/// Reads the cameras of a model's folder, whose other files need not be there.
///
/// # Errors
/// Those of [`read`].
pub fn cameras(folder: &Path) -> Result<Vec<Camera>> {
    Ok(raw(folder, Parts::Cameras)?.cameras.into_iter().map(|c| c.1).collect())
}

/// What is read of a model.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Parts {
    All,
    Cameras,
}

fn raw(folder: &Path, parts: Parts) -> Result<Raw> {
    if folder.join("cameras.bin").is_file() { binary(folder, parts) } else { text(folder, parts) }
}

/// Id, name, camera, quaternion and translation, points in the image.
type RawImage = (u64, String, u64, [f64; 7], Vec<[f64; 2]>);
/// Position, and the images and their points that see it.
type RawPoint = ([f64; 3], Vec<(u64, u64)>);

#[derive(Default)]
struct Raw {
    cameras: Vec<(u64, Camera)>,
    images: Vec<RawImage>,
    points: Vec<RawPoint>,
}

impl Raw {
    fn join(self, folder: &Path) -> Result<Reconstruction> {
        let cameras: HashMap<u64, usize> = self.cameras.iter().enumerate().map(|(i, c)| (c.0, i)).collect();
        let mut images: Vec<_> = self.images;
        images.sort_by(|a, b| a.1.cmp(&b.1));
        let index: HashMap<u64, usize> = images.iter().enumerate().map(|(i, m)| (m.0, i)).collect();
        let mut photographs = Vec::new();
        for (id, name, camera, p, _) in &images {
            let camera = *cameras
                .get(camera)
                .ok_or_else(|| Error::format(folder, format!("image {id}"), format!("camera {camera} is not there")))?;
            let q = Quaternion::new(p[0], p[1], p[2], p[3]);
            if !(q.norm() > 0.5 && q.norm() < 2.0) {
                return Err(Error::format(folder, format!("image {id}"), "its quaternion is not of length 1"));
            }
            let rotation = *UnitQuaternion::from_quaternion(q).to_rotation_matrix().matrix();
            let centre = -(rotation.transpose() * Vector3::new(p[4], p[5], p[6]));
            photographs.push(Photograph { name: name.clone(), camera, pose: Pose { rotation, centre } });
        }
        let mut ties = Vec::with_capacity(self.points.len());
        for (xyz, track) in self.points {
            let mut seen = Vec::with_capacity(track.len());
            for (image, point) in track {
                let at = index.get(&image).and_then(|i| Some((*i, *images[*i].4.get(point as usize)?)));
                seen.push(at.ok_or_else(|| {
                    // Either file may be the one that was cut.
                    let what = match index.get(&image) {
                        None => format!("names the image {image}, which `images` lacks"),
                        Some(_) => format!("names the point {point} of image {image}, which `images` lacks"),
                    };
                    Error::format(
                        folder,
                        "points3D",
                        format!("{what}: one of both files is cut short or of another model"),
                    )
                })?);
            }
            ties.push(TiePoint { xyz: Vector3::from(xyz), seen });
        }
        let cameras = self.cameras.into_iter().map(|c| c.1).collect();
        Ok(Reconstruction { cameras, photographs, ties, ..Reconstruction::default() })
    }
}

struct Bytes<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N]> {
        let end = self.at + N;
        let part = self.bytes.get(self.at..end).and_then(|b| b.try_into().ok());
        self.at = end;
        part.ok_or_else(|| Error::format(self.path, format!("byte {}", end - N), "the file ends too early"))
    }
    fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.take()?))
    }
    fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.take()?))
    }
    fn f64(&mut self) -> Result<f64> {
        let value = f64::from_le_bytes(self.take()?);
        if value.is_finite() {
            return Ok(value);
        }
        Err(Error::format(self.path, format!("byte {}", self.at - 8), "a number is not finite"))
    }
    /// A count of things that take `least` bytes each.
    fn count(&mut self, least: usize) -> Result<usize> {
        let n = self.u64()?;
        if n > (self.bytes.len() / least) as u64 {
            return Err(Error::format(
                self.path,
                format!("byte {}", self.at - 8),
                format!("{n} entries are announced, which the file is too short for; it ends too early"),
            ));
        }
        Ok(n as usize)
    }
}

fn binary(folder: &Path, parts: Parts) -> Result<Raw> {
    let mut raw = Raw::default();
    let load = |name: &str| {
        let path = folder.join(name);
        read_bytes(&path).map(|b| (path, b))
    };
    let (path, bytes) = load("cameras.bin")?;
    let mut b = Bytes { path: &path, bytes: &bytes, at: 0 };
    for _ in 0..b.count(24)? {
        let id = u64::from(b.u32()?);
        let model = b.u32()? as usize;
        let size = [b.u64()? as f64, b.u64()? as f64];
        let (name, count) = *MODELS.get(model).ok_or_else(|| {
            Error::format(&path, format!("camera {id}"), format!("model {model} is not known; {REMEDY}"))
        })?;
        let parameters: Vec<f64> = (0..count).map(|_| b.f64()).collect::<Result<_>>()?;
        let camera = camera(&id.to_string(), name, size, &parameters)
            .map_err(|e| Error::format(&path, format!("camera {id}"), e))?;
        raw.cameras.push((id, camera));
    }
    if parts == Parts::Cameras {
        return Ok(raw);
    }
    let (path, bytes) = load("images.bin")?;
    let mut b = Bytes { path: &path, bytes: &bytes, at: 0 };
    for _ in 0..b.count(64)? {
        let id = u64::from(b.u32()?);
        let mut p = [0.0; 7];
        for v in &mut p {
            *v = b.f64()?;
        }
        let camera = u64::from(b.u32()?);
        let mut name = Vec::new();
        loop {
            match b.take::<1>()? {
                [0] => break,
                [c] => name.push(c),
            }
        }
        let count = b.count(24)?;
        let mut points = Vec::with_capacity(count);
        for _ in 0..count {
            points.push([b.f64()?, b.f64()?]);
            b.u64()?;
        }
        raw.images.push((id, String::from_utf8_lossy(&name).into_owned(), camera, p, points));
    }
    if folder.join("points3D.bin").is_file() {
        let (path, bytes) = load("points3D.bin")?;
        let mut b = Bytes { path: &path, bytes: &bytes, at: 0 };
        for _ in 0..b.count(51)? {
            b.u64()?;
            let xyz = [b.f64()?, b.f64()?, b.f64()?];
            b.take::<3>()?;
            b.take::<8>()?; // the error, −1 or NaN before it is computed
            let count = b.count(8)?;
            let track = (0..count).map(|_| Ok((u64::from(b.u32()?), u64::from(b.u32()?)))).collect::<Result<_>>()?;
            raw.points.push((xyz, track));
        }
    }
    Ok(raw)
}

fn text(folder: &Path, parts: Parts) -> Result<Raw> {
    let mut raw = Raw::default();
    let numbers = |path: &Path, row: usize, words: &[&str]| -> Result<Vec<f64>> {
        let parse = |w: &&str| w.parse::<f64>().ok().filter(|v| v.is_finite());
        words
            .iter()
            .map(|w| parse(w).ok_or_else(|| Error::format(path, format!("row {row}"), format!("`{w}` is no number"))))
            .collect()
    };
    let short = |path: &Path, row: usize| Error::format(path, format!("row {row}"), "the row is too short");

    let path = folder.join("cameras.txt");
    for (row, line) in rows(&read_text(&path)?) {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.len() < 5 {
            return Err(short(&path, row));
        }
        let head = numbers(&path, row, &[words[0], words[2], words[3]])?;
        let camera = camera(words[0], words[1], [head[1], head[2]], &numbers(&path, row, &words[4..])?)
            .map_err(|e| Error::format(&path, format!("row {row}"), e))?;
        raw.cameras.push((head[0] as u64, camera));
    }

    if parts == Parts::Cameras {
        return Ok(raw);
    }
    let path = folder.join("images.txt");
    let content = read_text(&path)?;
    // Rows come in pairs; the second is empty when the image has no points.
    let mut lines = content.lines().enumerate().filter(|(_, l)| !l.starts_with('#'));
    while let Some((row, line)) = lines.next() {
        let words: Vec<&str> = line.split_whitespace().collect();
        if words.is_empty() {
            continue;
        }
        if words.len() < 10 {
            return Err(short(&path, row + 1));
        }
        let head = numbers(&path, row + 1, &words[..9])?;
        // A name may have blanks: it is all that follows nine words.
        let name = (0..9).fold(line.trim_start(), |rest, _| {
            rest.split_once(char::is_whitespace).map_or("", |(_, rest)| rest.trim_start())
        });
        let name = name.trim_end().to_string();
        let mut points = Vec::new();
        if let Some((row, line)) = lines.next() {
            let words: Vec<&str> = line.split_whitespace().collect();
            if !words.len().is_multiple_of(3) {
                return Err(Error::format(
                    &path,
                    format!("row {}", row + 1),
                    "a point is x, y and the number of its tie; the file ends too early",
                ));
            }
            for p in numbers(&path, row + 1, &words)?.chunks_exact(3) {
                points.push([p[0], p[1]]);
            }
        }
        let pose = std::array::from_fn(|i| head[i + 1]);
        raw.images.push((head[0] as u64, name, head[8] as u64, pose, points));
    }

    let path = folder.join("points3D.txt");
    if path.is_file() {
        for (row, line) in rows(&read_text(&path)?) {
            let words: Vec<&str> = line.split_whitespace().collect();
            if words.len() < 8 {
                return Err(short(&path, row));
            }
            let xyz = numbers(&path, row, &words[1..4])?;
            let track = numbers(&path, row, &words[8..])?;
            let track = track.chunks_exact(2).map(|t| (t[0] as u64, t[1] as u64)).collect();
            raw.points.push(([xyz[0], xyz[1], xyz[2]], track));
        }
    }
    Ok(raw)
}

fn rows(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, l)| (i + 1, l.trim())).filter(|(_, l)| !l.is_empty() && !l.starts_with('#'))
}

/// COLMAP's name and parameters of a camera; what no model of COLMAP holds is an error.
///
/// # Errors
/// The reason as words.
pub fn parameters(camera: &Camera) -> Result<(&'static str, Vec<f64>), String> {
    use Parameter::{Aspect, B1, B2, D1, D2, D3, Dx, Dy, K1, K2, K3, K4, K5, K6, P1, P2};
    let g = |p| camera.get(p);
    let [cx, cy] = camera.pp_px();
    let (f, fy) = (camera.f_px(), camera.f_px() * g(Aspect));
    let zero = |list: &[Parameter]| list.iter().all(|p| g(*p) == 0.0);
    if camera.has_plane_maps() || !zero(&[K5, K6, B1, B2, Dx, Dy]) {
        return Err("its distortion is of no model of COLMAP's".into());
    }
    match camera.projection {
        Projection::Fisheye if zero(&[D1, D2, D3, P1, P2]) => {
            Ok(("OPENCV_FISHEYE", vec![f, fy, cx, cy, g(K1), g(K2), g(K3), g(K4)]))
        }
        Projection::Equisolid | Projection::Stereographic | Projection::Orthographic | Projection::Equirectangular => {
            Err(format!("its projection ({}) is of no model of COLMAP's", camera.projection.name()))
        }
        Projection::Fisheye => Err("its distortion is of no model of COLMAP's".into()),
        Projection::Perspective if camera.is_simple_radial() => Ok(("SIMPLE_RADIAL", vec![f, cx, cy, g(K1)])),
        Projection::Perspective if zero(&[K3, K4, D1, D2, D3]) => {
            Ok(("OPENCV", vec![f, fy, cx, cy, g(K1), g(K2), g(P1), g(P2)]))
        }
        Projection::Perspective if zero(&[K4]) => {
            Ok(("FULL_OPENCV", vec![f, fy, cx, cy, g(K1), g(K2), g(P1), g(P2), g(K3), g(D1), g(D2), g(D3)]))
        }
        Projection::Perspective => Err("its distortion is of no model of COLMAP's".into()),
    }
}

/// The three files of a text model.
///
/// # Errors
/// When a camera is of no model of COLMAP's.
pub fn text_model(model: &Reconstruction) -> Result<[(&'static str, Vec<u8>); 3]> {
    let (mut cameras, mut images, mut points) = (Vec::new(), Vec::new(), Vec::new());
    const WRITTEN: &str = "a vector takes what is written";
    for (i, camera) in model.cameras.iter().enumerate() {
        let (name, values) = parameters(camera)
            .map_err(|e| Error::usage(format!("camera `{}`: {e}", camera.name), "adjust with a simpler model"))?;
        let values: Vec<String> = values.iter().map(f64::to_string).collect();
        writeln!(cameras, "{} {name} {} {} {}", i + 1, camera.size_px[0], camera.size_px[1], values.join(" "))
            .expect(WRITTEN);
    }
    let mut seen: Vec<Vec<(usize, [f64; 2])>> = vec![Vec::new(); model.photographs.len()];
    for (j, tie) in model.ties.iter().enumerate() {
        let mut track = String::new();
        for (image, at) in &tie.seen {
            track += &format!(" {} {}", image + 1, seen[*image].len());
            seen[*image].push((j + 1, *at));
        }
        let [x, y, z]: [f64; 3] = tie.xyz.into();
        writeln!(points, "{} {x} {y} {z} 128 128 128 0{track}", j + 1).expect(WRITTEN);
    }
    for (i, p) in model.photographs.iter().enumerate() {
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(p.pose.rotation));
        let t = -(p.pose.rotation * p.pose.centre);
        let (q, c) = (q.quaternion(), p.camera + 1);
        writeln!(images, "{} {} {} {} {} {} {} {} {c} {}", i + 1, q.w, q.i, q.j, q.k, t.x, t.y, t.z, p.name)
            .expect(WRITTEN);
        let row: Vec<String> = seen[i].iter().map(|(j, at)| format!("{} {} {j}", at[0], at[1])).collect();
        writeln!(images, "{}", row.join(" ")).expect(WRITTEN);
    }
    Ok([("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", points)])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As other programs write the rows: aligned, with tabs, with blanks in names.
    #[test]
    fn names_are_all_that_follows_nine_words() {
        let folder = tempfile::tempdir().expect("a folder");
        let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("writable");
        put("cameras.txt", "1 PINHOLE 200 100 150 150 100 50\n");
        put("points3D.txt", "");
        put("images.txt", "  1 1 0 0 0 0 0 0  1   left wing.jpg\n\n2\t1\t0\t0\t0\t1\t0\t0\t1\tb.jpg \n\n");
        let model = read(folder.path()).expect("a model");
        let names: Vec<&str> = model.photographs.iter().map(|p| p.name.as_str()).collect();
        assert_eq!(names, ["b.jpg", "left wing.jpg"], "by name");
    }

    #[test]
    fn models_that_are_not_read_have_a_remedy() {
        for (name, count) in MODELS {
            let parameters = vec![100.0; count];
            let size = [200.0, 200.0];
            match camera("1", name, size, &parameters) {
                Ok(read) => assert_eq!(read.size_px, size, "{name}"),
                Err(said) => assert!(said.contains(name) && said.contains("run COLMAP with"), "{said}"),
            }
        }
        for name in ["FISHEYE", "SIMPLE_FISHEYE", "DIVISION", "SIMPLE_DIVISION", "EUCM", "EQUIRECTANGULAR"] {
            assert!(MODELS.iter().any(|m| m.0 == name), "{name}");
        }
        assert!(camera("1", "NEW", [200.0; 2], &[1.0]).expect_err("unknown").contains("run COLMAP with"));
    }
}
