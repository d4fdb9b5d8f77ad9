//! This program's `cameras.json`, or the one camera of a resection. Whoever edits or writes one is told what it cannot
//! mean: nothing in it is guessed or passed over.

use std::path::Path;

use autoref_raster::crs::Crs;
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;
use serde_json::Value;

use super::json::{number, triple};
use super::model::{Photograph, Reconstruction};
use crate::camera::{Camera, PARAMETERS, Parameter, Projection, SizeOf};
use crate::error::{Error, Result};
use crate::plane::{HIGHEST_POWER, PlaneMap};
use crate::pose::{Pose, orthonormal};

/// R times its transpose may be off from one by so much: digits that were rounded, and no scale or shear.
const ROUNDED: f64 = 1e-3;

/// The cameras of a document.
pub(super) fn read(path: &Path, root: &Value) -> Result<Reconstruction> {
    check_crs(path, root)?;
    let crs = root.get("crs").and_then(Value::as_str).map(str::to_string);
    let mut result = Reconstruction { crs, ..Reconstruction::default() };
    let all = match root.get("cameras") {
        Some(list) => list.as_array().map_or(&[][..], Vec::as_slice),
        None => std::slice::from_ref(root),
    };
    for (i, c) in all.iter().enumerate() {
        let name = c.get("name").and_then(Value::as_str).unwrap_or_default().to_string();
        let place = if name.is_empty() { format!("camera {}", i + 1) } else { format!("camera `{name}`") };
        let pose = Pose { rotation: rotation(path, c, &place)?, centre: Vector3::from(triple(path, c, "C", &place)?) };
        let camera = interior(path, c, &name, &place)?;
        let same = |k: &Camera| Camera { name: camera.name.clone(), ..k.clone() } == camera;
        let at = result.cameras.iter().position(same).unwrap_or_else(|| {
            result.cameras.push(camera.clone());
            result.cameras.len() - 1
        });
        result.photographs.push(Photograph { name, camera: at, pose });
    }
    debug_assert_eq!(PARAMETERS, Parameter::ALL.len());
    Ok(result)
}

/// Refuses a system that nobody knows: the coordinates would be taken for those of another.
fn check_crs(path: &Path, root: &Value) -> Result<()> {
    let Some(crs) = root.get("crs").filter(|crs| !crs.is_null()) else { return Ok(()) };
    let known = crs.as_str().is_some_and(|word| word.eq_ignore_ascii_case("local") || Crs::parse(word).is_ok());
    if known {
        return Ok(());
    }
    let what = format!("{crs} is no CRS that is known; give an EPSG code (\"EPSG:25833\"), WKT, or \"local\"");
    Err(Error::format(path, "`crs`", what))
}

fn rotation(path: &Path, c: &Value, place: &str) -> Result<Matrix3<f64>> {
    let rows = c.get("R").and_then(Value::as_array);
    let rows: Option<Vec<Vec<f64>>> = rows
        .and_then(|r| r.iter().map(|row| row.as_array().and_then(|l| l.iter().map(Value::as_f64).collect())).collect());
    let rows = rows.filter(|r| r.len() == 3 && r.iter().all(|row| row.len() == 3));
    let rows = rows.ok_or_else(|| Error::format(path, place, "`R`: 3 rows of 3 numbers are expected"))?;
    let stated = Matrix3::from_fn(|r, k| rows[r][k]);
    let off = (stated * stated.transpose() - Matrix3::identity()).abs().max();
    let what = match (off < ROUNDED, stated.determinant() > 0.0) {
        (true, true) => return Ok(orthonormal(&stated)),
        (true, false) => "mirrors; change the sign of one of its rows".into(),
        (false, _) => format!(
            "is no rotation: R times its transpose is off from one by {off:.3}; give three unit rows at right angles"
        ),
    };
    Err(Error::format(path, place, format!("`R` {what}")))
}

fn interior(path: &Path, c: &Value, name: &str, place: &str) -> Result<Camera> {
    let pair = |key: &str| -> Result<Option<[f64; 2]>> {
        let Some(value) = c.get(key) else { return Ok(None) };
        let list: Option<Vec<f64>> = value.as_array().and_then(|l| l.iter().map(Value::as_f64).collect());
        let two = list.and_then(|l| l.try_into().ok());
        two.map(Some).ok_or_else(|| Error::format(path, place, format!("`{key}`: 2 numbers are expected")))
    };
    let f = number(path, c, "f_px", place)?;
    let pp = pair("pp_px")?.ok_or_else(|| Error::format(path, place, "`pp_px`: 2 numbers are expected"))?;
    let size = pair("size_px")?.unwrap_or([pp[0] * 2.0, pp[1] * 2.0]);
    if f <= 0.0 {
        let what = format!("`f_px` is {f}; a positive number of pixels is expected");
        return Err(Error::format(path, place, what));
    }
    if size.iter().any(|side| *side <= 0.0) {
        let what = format!("`size_px` is [{}, {}]; give width and height of the frame in pixels", size[0], size[1]);
        return Err(Error::format(path, place, what));
    }
    let mut camera = Camera::pinhole(name, size, f, pp);
    if let Some(value) = c.get("size_of") {
        camera.size_of = SizeOf::deserialize(value)
            .map_err(|_| Error::format(path, place, format!("`size_of` is {value}; `image` or `film` is expected")))?;
    }
    for (key, value) in c.get("distortion").and_then(Value::as_object).into_iter().flatten() {
        match key.as_str() {
            "projection" => {
                camera.projection = value.as_str().and_then(Projection::by_name).ok_or_else(|| {
                    let known = Projection::ALL.map(Projection::name).join(", ");
                    let what = format!("the projection {value} is not known; there are {known}");
                    Error::format(path, place, what)
                })?;
                continue;
            }
            "before" => {
                camera.before = plane_maps(path, key, value, place)?;
                continue;
            }
            "after" => {
                camera.after = plane_maps(path, key, value, place)?;
                continue;
            }
            _ => {}
        }
        let is_term = |p: &Parameter| !matches!(p, Parameter::F | Parameter::Cx | Parameter::Cy);
        let Some(parameter) = Parameter::by_name(key).filter(is_term) else {
            let known: Vec<&str> = Parameter::ALL.iter().filter(|p| is_term(p)).map(|p| p.name()).collect();
            let what = format!("`{key}` is no term of a distortion; there are {}", known.join(", "));
            return Err(Error::format(path, place, what));
        };
        let Some(term) = value.as_f64() else {
            return Err(Error::format(path, place, format!("`{key}` is {value}; a number is expected")));
        };
        camera.set(parameter, term);
    }
    Ok(camera)
}

/// What moves the plane before or behind the lens's terms.
fn plane_maps(path: &Path, key: &str, value: &Value, place: &str) -> Result<Vec<PlaneMap>> {
    let refuse =
        |what: String| Error::format(path, place, format!("`{key}`: {what}; write it as `flight adjust` does"));
    let maps = Vec::<PlaneMap>::deserialize(value).map_err(|e| refuse(e.to_string()))?;
    match maps.iter().all(PlaneMap::is_sound) {
        true => Ok(maps),
        false => Err(refuse(format!("a scale is not positive, or a power is above {HIGHEST_POWER}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn camera(key: &str, value: Value) -> Value {
        let mut c = json!({
            "name": "f1.tif", "C": [1.0, 2.0, 3.0], "R": [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]],
            "f_px": 400.0, "pp_px": [200.0, 150.0], "size_px": [400.0, 300.0], "distortion": {"k1": -0.3},
        });
        c[key] = value;
        json!({"crs": "local", "cameras": [c]})
    }

    #[test]
    fn what_a_camera_cannot_be_is_refused_by_name() {
        let path = Path::new("cameras.json");
        let whole = read(path, &camera("f_px", json!(410.0))).expect("a camera");
        assert_eq!((whole.cameras[0].f_px(), whole.cameras[0].get(Parameter::K1)), (410.0, -0.3));
        let mirrored = json!([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]);
        for (key, value, words) in [
            ("R", json!([[1.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0, 0.0, -1.0]]), "no rotation"),
            ("R", mirrored, "mirrors"),
            ("R", json!([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), "no rotation"),
            ("distortion", json!({"K1": -0.3}), "`K1` is no term of a distortion"),
            ("distortion", json!({"k1": "a"}), "a number is expected"),
            ("distortion", json!({"projection": "spherical"}), "projection"),
            ("distortion", json!({"before": [{"polynomial": {"centre_px": [0.0, 0.0], "scale_px": 1.0}}]}), "`terms`"),
            ("distortion", json!({"after": [{"undo": {"centre_px": [0, 0], "scale_px": 0, "terms": []}}]}), "a scale"),
            (
                "distortion",
                json!({"before": [{"polynomial": {"centre_px": [0, 0], "scale_px": 1, "terms": [[42, 0, 1, 0]]}}]}),
                "a power is above 41",
            ),
            ("size_px", json!([0.0, 0.0]), "`size_px` is [0, 0]"),
            ("size_px", json!([400.0]), "2 numbers"),
            ("size_of", json!("plate"), "`film` is expected"),
            ("f_px", json!(0.0), "positive"),
        ] {
            let said = read(path, &camera(key, value)).map(|_| ()).expect_err(words).to_string();
            assert!(said.starts_with("cameras.json: camera `f1.tif`: ") && said.contains(words), "{said}");
        }
        for crs in [json!("EPSG:1"), json!("nowhere"), json!(25833)] {
            let mut document = camera("f_px", json!(400.0));
            document["crs"] = crs;
            let said = read(path, &document).map(|_| ()).expect_err("no CRS").to_string();
            assert!(said.starts_with("cameras.json: `crs`: ") && said.contains("is no CRS"), "{said}");
        }
    }
}
