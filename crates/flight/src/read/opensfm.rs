//! OpenSfM's `reconstruction.json` with its tracks and ground control points.
//!
//! Source: OpenSfM's documentation, "Geometric Models" and "Dataset Structure". Its image coordinates are divided by
//! the larger side and count from the image's centre.

use std::collections::HashMap;
use std::path::Path;

use nalgebra::{Rotation3, Vector3};
use serde_json::Value;

use super::json::{number, triple};
use super::model::{Photograph, Reconstruction, TiePoint};
use super::own;
use crate::camera::{Camera, Parameter, Projection};
use crate::error::{Error, Result, read_text};
use crate::pose::Pose;

fn json(path: &Path) -> Result<Value> {
    serde_json::from_str(&read_text(path)?)
        .map_err(|e| Error::format(path, format!("row {}", e.line()), format!("the JSON is broken: {e}")))
}

/// Reads a reconstruction; OpenSfM's tracks are taken from `tracks.csv` beside it (or from the name with `tracks` for
/// `reconstruction` and `.csv`).
///
/// # Errors
/// When the JSON is of neither kind or is broken.
pub fn read(path: &Path) -> Result<Reconstruction> {
    let root = json(path)?;
    if root.get("cameras").is_some_and(Value::is_array) || root.get("C").is_some() {
        return own::read(path, &root);
    }
    let all: Vec<&Value> = match &root {
        Value::Array(list) => list.iter().collect(),
        one => vec![one],
    };
    let shots = |r: &&Value| r.get("shots").and_then(Value::as_object).map_or(0, serde_json::Map::len);
    let Some(best) = all.iter().max_by_key(|r| shots(r)).filter(|r| shots(r) > 0) else {
        let what = match lenses(path)? {
            Some(_) => "has cameras and no frames; give it as --camera, and where the frames stand as --cameras",
            None => "there are no shots; is this OpenSfM's reconstruction.json?",
        };
        return Err(Error::format(path, "the root", what));
    };
    let mut result = one(path, best)?;
    if all.len() > 1 {
        result.notes.push(format!("{}: the largest of {} reconstructions is used", path.display(), all.len()));
    }
    let file = path.file_stem().map(|s| s.to_string_lossy().replace("reconstruction", "tracks")).unwrap_or_default();
    let tracks = [path.with_file_name("tracks.csv"), path.with_file_name(format!("{file}.csv"))];
    if let Some(tracks) = tracks.iter().find(|p| p.is_file()) {
        result.ties = ties(path, best, tracks, &result)?;
    }
    Ok(result)
}

fn one(path: &Path, root: &Value) -> Result<Reconstruction> {
    let mut result = Reconstruction::default();
    let mut cameras: HashMap<&str, usize> = HashMap::new();
    for (name, c) in root.get("cameras").and_then(Value::as_object).into_iter().flatten() {
        cameras.insert(name, result.cameras.len());
        result.cameras.push(lens(path, name, c)?);
    }
    for (name, shot) in root.get("shots").and_then(Value::as_object).into_iter().flatten() {
        let place = format!("shot `{name}`");
        let camera = shot.get("camera").and_then(Value::as_str).and_then(|c| cameras.get(c));
        let camera = *camera.ok_or_else(|| Error::format(path, &*place, "its camera is not there"))?;
        let rotation = *Rotation3::new(Vector3::from(triple(path, shot, "rotation", &place)?)).matrix();
        let translation = Vector3::from(triple(path, shot, "translation", &place)?);
        let pose = Pose { rotation, centre: -(rotation.transpose() * translation) };
        result.photographs.push(Photograph { name: name.clone(), camera, pose });
    }
    result.photographs.sort_by(|a, b| a.name.cmp(&b.name));
    if let Some(r) = root.get("reference_lla") {
        let get = |k: &str| r.get(k).and_then(Value::as_f64);
        if let (Some(lon), Some(lat)) = (get("longitude"), get("latitude")) {
            result.reference_lla = Some([lon, lat, get("altitude").unwrap_or(0.0)]);
        }
    }
    Ok(result)
}

/// A camera as OpenSfM writes it.
fn lens(path: &Path, name: &str, c: &Value) -> Result<Camera> {
    let place = format!("camera `{name}`");
    let size = [number(path, c, "width", &place)?, number(path, c, "height", &place)?];
    let s = size[0].max(size[1]);
    let kind = c.get("projection_type").and_then(Value::as_str).unwrap_or("perspective");
    let optional = |key: &str| c.get(key).and_then(Value::as_f64).unwrap_or(0.0);
    let f = if c.get("focal_x").is_some() {
        number(path, c, "focal_x", &place)?
    } else {
        number(path, c, "focal", &place)?
    };
    if !(f > 0.0 && size.iter().all(|side| *side > 0.0)) {
        let what = "focal length, width and height must be positive; correct them";
        return Err(Error::format(path, place, what));
    }
    let pp = [size[0] / 2.0 + optional("c_x") * s, size[1] / 2.0 + optional("c_y") * s];
    let mut camera = Camera::pinhole(name, size, f * s, pp);
    camera.set(Parameter::Aspect, c.get("focal_y").and_then(Value::as_f64).map_or(1.0, |fy| fy / f));
    use Parameter::{K1, K2, K3, K4, K5, K6, P1, P2};
    for (key, slot) in [("k1", K1), ("k2", K2), ("k3", K3), ("k4", K4), ("k5", K5), ("k6", K6), ("p1", P1), ("p2", P2)]
    {
        camera.set(slot, optional(key));
    }
    camera.projection = match kind {
        "perspective" | "brown" | "simple_radial" | "radial" => Projection::Perspective,
        "fisheye" | "fisheye_opencv" => Projection::Fisheye,
        other => return Err(Error::format(path, place, format!("the projection `{other}` is not supported"))),
    };
    Ok(camera)
}

/// The cameras of a file that has no frames: OpenSfM's `camera_models.json`, OpenDroneMap's `cameras.json`; `None` of
/// any other JSON.
///
/// # Errors
/// When the JSON is broken, or one of the cameras.
pub fn lenses(path: &Path) -> Result<Option<Vec<Camera>>> {
    let root = json(path)?;
    let is_lens = |c: &Value| c.get("projection_type").is_some() && c.get("width").is_some();
    match root.as_object().filter(|all| !all.is_empty() && all.values().all(is_lens)) {
        Some(all) => all.iter().map(|(name, c)| lens(path, name, c)).collect::<Result<_>>().map(Some),
        None => Ok(None),
    }
}

fn ties(path: &Path, root: &Value, tracks: &Path, result: &Reconstruction) -> Result<Vec<TiePoint>> {
    let shots: HashMap<&str, usize> =
        result.photographs.iter().enumerate().map(|(i, p)| (p.name.as_str(), i)).collect();
    let mut ties: Vec<TiePoint> = Vec::new();
    let mut index: HashMap<String, usize> = HashMap::new();
    for (id, point) in root.get("points").and_then(Value::as_object).into_iter().flatten() {
        let xyz = Vector3::from(triple(path, point, "coordinates", &format!("point {id}"))?);
        index.insert(id.clone(), ties.len());
        ties.push(TiePoint { xyz, seen: Vec::new() });
    }
    for (row, line) in read_text(tracks)?.lines().enumerate() {
        let words: Vec<&str> = line.split('\t').collect();
        if words.len() < 5 {
            continue;
        }
        let (Some(shot), Some(point)) = (shots.get(words[0]), index.get(words[1])) else { continue };
        let (Ok(x), Ok(y)) = (words[3].parse::<f64>(), words[4].parse::<f64>()) else {
            return Err(Error::format(tracks, format!("row {}", row + 1), "an image coordinate is no number"));
        };
        let at = to_pixel(&result.cameras[result.photographs[*shot].camera], [x, y]);
        ties[*point].seen.push((*shot, at));
    }
    ties.retain(|t| t.seen.len() >= 2);
    Ok(ties)
}

/// OpenSfM's image coordinates as pixels.
pub fn to_pixel(camera: &Camera, at: [f64; 2]) -> [f64; 2] {
    let s = camera.size_px[0].max(camera.size_px[1]);
    [at[0] * s + camera.size_px[0] / 2.0, at[1] * s + camera.size_px[1] / 2.0]
}

/// A ground control point of OpenSfM's: name, longitude, latitude, height when surveyed, and where it was seen
/// (pixels).
#[derive(Clone, Debug)]
pub struct GroundControl {
    pub name: String,
    /// Longitude and latitude, degrees, and height, metres; `None` where one of them is missing.
    pub lla: Option<[f64; 3]>,
    pub seen: Vec<(String, [f64; 2])>,
}

/// Reads `ground_control_points.json`.
///
/// # Errors
/// When the JSON is broken.
pub fn ground_control(path: &Path, of: &Reconstruction) -> Result<Vec<GroundControl>> {
    let root = json(path)?;
    let list = root.get("points").and_then(Value::as_array);
    let list = list.ok_or_else(|| Error::format(path, "the root", "there is no list `points`"))?;
    let mut points = Vec::new();
    for (i, p) in list.iter().enumerate() {
        let name = match p.get("id") {
            Some(Value::String(s)) => s.clone(),
            Some(other) => other.to_string(),
            None => (i + 1).to_string(),
        };
        let lla = p.get("position").and_then(|q| {
            let get = |k: &str| q.get(k).and_then(Value::as_f64);
            Some([get("longitude")?, get("latitude")?, get("altitude")?])
        });
        let mut seen = Vec::new();
        for o in p.get("observations").and_then(Value::as_array).into_iter().flatten() {
            let shot = o.get("shot_id").and_then(Value::as_str).unwrap_or_default();
            let at: Option<Vec<f64>> =
                o.get("projection").and_then(Value::as_array).and_then(|l| l.iter().map(Value::as_f64).collect());
            let (Some(index), Some([x, y])) = (of.find(shot), at.and_then(|a| <[f64; 2]>::try_from(a).ok())) else {
                continue;
            };
            let camera = &of.cameras[of.photographs[index].camera];
            seen.push((of.photographs[index].name.clone(), to_pixel(camera, [x, y])));
        }
        points.push(GroundControl { name, lla, seen });
    }
    Ok(points)
}
