//! Results as JSON.

use autoref_flight::adjust::{Adjustment, Blunder, Role};
use autoref_flight::bundle::Ended;
use autoref_flight::pose::angle_sigmas;
use autoref_flight::read::Reconstruction;
use autoref_flight::resect::{Alternative, Resection, Seen};
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use autoref_flight::{Camera, Parameter, Pose, Projection, SizeOf};
use autoref_raster::words::counted;
use nalgebra::{Matrix3, SMatrix, Vector3};
use serde_json::{Map, Value, json};

/// An angle with a larger deviation is not known.
const MOST_SIGMA_DEG: f64 = 60.0;

pub fn number(v: f64) -> Value {
    serde_json::Number::from_f64(v).map_or(Value::Null, Value::Number)
}

pub fn list(v: &[f64]) -> Value {
    v.iter().map(|v| number(*v)).collect()
}

fn rows(m: &Matrix3<f64>) -> Value {
    (0..3).map(|r| list(&[m[(r, 0)], m[(r, 1)], m[(r, 2)]])).collect()
}

fn interior(camera: &Camera) -> Map<String, Value> {
    let mut distortion = Map::new();
    for p in Parameter::ALL.iter().filter(|p| !matches!(p, Parameter::F | Parameter::Cx | Parameter::Cy)) {
        let plain = if *p == Parameter::Aspect { 1.0 } else { 0.0 };
        if camera.get(*p) != plain {
            distortion.insert(p.name().into(), number(camera.get(*p)));
        }
    }
    if camera.projection != Projection::Perspective {
        distortion.insert("projection".into(), camera.projection.name().into());
    }
    for (key, maps) in [("before", &camera.before), ("after", &camera.after)] {
        if !maps.is_empty() {
            // Numbers and words alone, which JSON always holds.
            distortion.insert(key.into(), serde_json::to_value(maps).unwrap_or_default());
        }
    }
    let mut m = Map::new();
    m.insert("f_px".into(), number(camera.f_px()));
    m.insert("pp_px".into(), list(&camera.pp_px()));
    m.insert("size_px".into(), list(&camera.size_px));
    if camera.size_of == SizeOf::Film {
        m.insert("size_of".into(), "film".into());
    }
    m.insert("distortion".into(), Value::Object(distortion));
    m
}

/// A camera in the map: position in the map's units, angles, their standard deviations (metres, degrees), the full
/// covariance (turn in radians, then position in metres).
fn camera(
    name: &str,
    camera: &Camera,
    pose: &Pose,
    cov: Option<&SMatrix<f64, 6, 6>>,
    world: &World,
) -> Map<String, Value> {
    let map = world.pose_to_map(pose).unwrap_or(*pose);
    let grid = world.grid(map.centre.into()).unwrap_or_else(Matrix3::identity);
    let a = map.yaw_pitch_roll();
    let [omega, phi, kappa] = map.omega_phi_kappa();
    let mut m = Map::new();
    m.insert("name".into(), name.into());
    m.insert("e".into(), number(map.centre.x));
    m.insert("n".into(), number(map.centre.y));
    m.insert("h".into(), number(map.centre.z));
    m.insert("yaw_deg".into(), number(a.yaw_deg));
    m.insert("pitch_deg".into(), number(a.pitch_deg));
    m.insert("roll_deg".into(), number(a.roll_deg));
    m.insert("omega_phi_kappa_deg".into(), list(&[omega, phi, kappa]));
    if let Some(c) = cov {
        let place = grid.transpose() * c.fixed_view::<3, 3>(3, 3).into_owned() * grid;
        for (i, key) in ["sigma_e", "sigma_n", "sigma_h"].iter().enumerate() {
            m.insert((*key).into(), number(place[(i, i)].max(0.0).sqrt()));
        }
        let s = angle_sigmas(&map.rotation, &c.fixed_view::<3, 3>(0, 0).into_owned());
        for (value, key) in s.iter().zip(["sigma_yaw_deg", "sigma_pitch_deg", "sigma_roll_deg"]) {
            // One radian of turn is 57.3°: the derivatives are degrees by radians. Straight down, yaw and roll turn
            // about one axis, and neither is known alone.
            m.insert(key.into(), if *value > MOST_SIGMA_DEG { Value::Null } else { number(*value) });
        }
        m.insert("covariance".into(), (0..6).map(|r| list(&(0..6).map(|k| c[(r, k)]).collect::<Vec<_>>())).collect());
    }
    m.insert("C".into(), list(map.centre.as_slice()));
    m.insert("R".into(), rows(&map.rotation));
    m.extend(interior(camera));
    m
}

pub fn in_map(world: &World, at: &Vector3<f64>, v: &Vector3<f64>) -> [f64; 3] {
    let grid = world.to_map(at).and_then(|m| world.grid(m)).unwrap_or_else(Matrix3::identity);
    (grid.transpose() * v).into()
}

pub fn adjustment(found: &Adjustment, model: &Reconstruction, world: &World, listed: usize, crs: String) -> Value {
    let name = |i: usize| model.photographs[i].name.clone();
    let cameras: Vec<Value> = found
        .photographs
        .iter()
        .map(|c| {
            let of = &found.cameras[model.photographs[c.photograph].camera];
            let mut m = camera(&name(c.photograph), of, &c.pose, c.covariance.as_ref(), world);
            m.insert("rms_px".into(), number(c.rms_px));
            m.insert("ties".into(), c.ties.into());
            Value::Object(m)
        })
        .collect();
    let interiors: Vec<Value> = found
        .cameras
        .iter()
        .zip(&found.interior_sigmas)
        .map(|(c, sigmas)| {
            let mut m = Map::new();
            m.insert("name".into(), c.name.clone().into());
            m.extend(interior(c));
            let s: Map<String, Value> = sigmas.iter().map(|(p, s)| (p.name().to_string(), number(*s))).collect();
            m.insert("sigma".into(), Value::Object(s));
            Value::Object(m)
        })
        .collect();
    let points = |role: Role| -> (Vec<Value>, Vec<[f64; 3]>) {
        let mut residuals = Vec::new();
        let all = found.points.iter().filter(|p| p.role == role).map(|p| {
            let r = p.residual.map(|r| in_map(world, &p.xyz, &r));
            residuals.extend(r);
            let at = world.to_map(&p.xyz).unwrap_or_default();
            let sigma = p.covariance.map(|c| list(&[c[(0, 0)].sqrt(), c[(1, 1)].sqrt(), c[(2, 2)].sqrt()]));
            let images: Vec<Value> =
                p.image.iter().map(|(i, r)| json!({"frame": name(*i), "residual_px": list(r)})).collect();
            json!({"name": p.name, "e": number(at[0]), "n": number(at[1]), "h": number(at[2]),
                   "residual_m": r.map(|r| list(&r)), "d_m": r.map(|r| number(r.iter().map(|v| v * v).sum::<f64>().sqrt())),
                   "sigma_m": sigma, "images": images})
        });
        (all.collect(), residuals)
    };
    let (gcps, gcp_residuals) = points(Role::Control);
    let (checks, check_residuals) = points(Role::Check);
    let blunders: Vec<Value> = found.blunders.iter().map(|b| blunder(b, &name)).collect();
    let ended = match found.summary.ended {
        Ended::Converged => "converged",
        Ended::OutOfIterations => "out of iterations",
        Ended::Stuck => "stuck",
        Ended::Left => "out of bounds",
    };
    let [unit_m, height_unit_m] = world.units_m();
    json!({
        "crs": crs,
        "unit_m": unit_m,
        "height_unit_m": height_unit_m,
        "frames_registered": found.photographs.len(),
        "frames_listed": listed,
        "cameras": cameras,
        "interior": interiors,
        "gcps": gcps,
        "check_points": checks,
        "gcp_statistics": Residuals::of(&gcp_residuals),
        "check_point_statistics": Residuals::of(&check_residuals),
        "blunders": blunders,
        "reprojection_rms_px": number(found.tie_rms_px),
        "reprojection_mean_px": number(found.tie_mean_px),
        "sigma_tie_px": number(found.sigma_tie_px),
        "ties": found.ties,
        "ties_left_out": found.dropped_ties,
        "iterations": found.summary.iterations,
        "ended": ended,
        "notes": found.notes,
    })
}

/// A point that errs in a frame, or on the ground.
fn blunder(b: &Blunder, name: &impl Fn(usize) -> String) -> Value {
    match b.photograph {
        Some(i) => {
            let by = if b.by.is_empty() { Value::Null } else { list(&b.by) };
            json!({"gcp": b.gcp, "frame": name(i), "by_px": by, "test": number(b.test)})
        }
        None => json!({"gcp": b.gcp, "frame": null, "by_m": list(&b.by), "test": number(b.test)}),
    }
}

/// Of a frame alone: the points that it was solved from, and those that were kept out. `more` is to be said beside what
/// the resection itself says.
pub fn resection(
    found: &Resection,
    name: &str,
    (seen, checks): (&[Seen], &[Seen]),
    (world, crs): (&World, String),
    more: Vec<String>,
) -> Value {
    let mut m = Map::new();
    m.insert("crs".into(), crs.into());
    let [unit_m, height_unit_m] = world.units_m();
    m.insert("unit_m".into(), number(unit_m));
    m.insert("height_unit_m".into(), number(height_unit_m));
    m.extend(camera(name, &found.camera, &found.pose, found.covariance.as_ref(), world));
    m.insert("rms_px".into(), number(found.rms_px));
    m.insert("sigma0".into(), found.sigma0.map_or(Value::Null, number));
    let other = |a: &Alternative| pose_alone(&camera(name, &a.camera, &a.pose, None, world));
    m.insert("alternatives".into(), found.alternatives.iter().map(other).collect());
    let gcps = seen.iter().zip(&found.residuals_px).enumerate().map(|(i, (s, r))| {
        let d = r.map(|r| r[0].hypot(r[1]));
        json!({"name": s.name, "residual_px": r.map(|r| list(&r)), "d_px": d.map(number), "blunder": found.blunders.contains(&i)})
    });
    m.insert("gcps".into(), gcps.collect());
    m.insert("blunders".into(), found.blunders.iter().map(|i| Value::from(seen[*i].name.clone())).collect());
    let kept_out = checks.iter().map(|s| {
        let at = found.camera.project(found.pose.to_camera(&s.xyz).into());
        let r = at.map(|at| [at[0] - s.pixel[0], at[1] - s.pixel[1]]);
        json!({"name": s.name, "residual_px": r.map(|r| list(&r)), "d_px": r.map(|r| number(r[0].hypot(r[1])))})
    });
    m.insert("check_points".into(), kept_out.collect());
    m.insert("notes".into(), [notes(found), more].concat().into());
    Value::Object(m)
}

/// Where a camera stands and looks, and no more.
fn pose_alone(camera: &Map<String, Value>) -> Value {
    const KEYS: [&str; 6] = ["C", "R", "yaw_deg", "pitch_deg", "roll_deg", "f_px"];
    camera
        .iter()
        .filter(|(key, _)| KEYS.contains(&key.as_str()))
        .map(|(key, value)| (key.clone(), value.clone()))
        .collect()
}

/// What a person should know of a resection.
fn notes(found: &Resection) -> Vec<String> {
    /// Points fit so many times worse than is stated only when something is wrong.
    const MISFIT: f64 = 10.0;
    let mut notes = Vec::new();
    if !found.alternatives.is_empty() {
        notes.push(format!(
            "{} about as good as this one (alternatives), and the standard deviations hold \
             only if this one is right: measure another point, or give --position",
            counted(found.alternatives.len(), "other pose is", "other poses are")
        ));
    }
    if found.covariance.is_none() {
        notes.push(
            "two poses fall together here, and no standard deviations can be stated: measure another point".into(),
        );
    }
    if let Some(sigma0) = found.sigma0.filter(|s| *s > MISFIT) {
        notes.push(format!(
            "the points fit {sigma0:.0} times worse than is stated of them: do not trust the pose; look at the points, the \
             focal length and --position"
        ));
    } else if found.widened > 1.0 {
        notes.push(format!(
            "the points fit {:.1} times worse than is stated of them, which chance does not explain: the standard deviations \
             are as many times as large",
            found.widened
        ));
    }
    notes
}

/// The essence on standard error, without the notes that were said `already`.
pub fn say(document: &Value, already: &[String]) {
    let get = |k: &str| document.get(k).cloned().unwrap_or(Value::Null);
    let fixed = |v: &Value, digits: usize| v.as_f64().map_or("-".into(), |v| format!("{v:.digits$}"));
    let several = |v: &Value, digits: usize| -> String {
        let all = v.as_array().map_or(&[][..], Vec::as_slice);
        all.iter().map(|v| fixed(v, digits)).collect::<Vec<_>>().join(", ")
    };
    let rows = |key: &str| document[key].as_array().cloned().unwrap_or_default();
    if document.get("frames_registered").is_some() {
        let d = |k: &str| fixed(&document[k]["d"]["rms"], 2);
        let points = match rows("gcps").len() + rows("check_points").len() {
            0 => "no GCPs".into(),
            _ => format!(
                "GCPs {} m rms; check points {} m rms; {} blunders",
                d("gcp_statistics"),
                d("check_point_statistics"),
                rows("blunders").len()
            ),
        };
        eprintln!(
            "{} of {} frames; ties {} px rms; {points}",
            get("frames_registered"),
            get("frames_listed"),
            fixed(&document["reprojection_rms_px"], 2),
        );
        for b in rows("blunders") {
            let (gcp, test) = (b["gcp"].as_str().unwrap_or_default(), fixed(&b["test"], 1));
            match b["frame"].as_str() {
                Some(frame) if b["by_px"].is_null() => {
                    eprintln!("blunder: GCP {gcp} in {frame}: the camera looks away from it");
                }
                Some(frame) => {
                    eprintln!("blunder: GCP {gcp} in {frame} by ({}) px, {test} sigma", several(&b["by_px"], 1));
                }
                None => eprintln!("blunder: GCP {gcp} on the ground by ({}) m, {test} sigma", several(&b["by_m"], 2)),
            }
        }
    } else {
        eprintln!(
            "{}: C ({}) ± ({}) yaw {} pitch {} roll {} f {} px; rms {} px",
            document["name"].as_str().unwrap_or_default(),
            several(&document["C"], 3),
            ["sigma_e", "sigma_n", "sigma_h"].map(|k| fixed(&document[k], 3)).join(", "),
            fixed(&document["yaw_deg"], 3),
            fixed(&document["pitch_deg"], 3),
            fixed(&document["roll_deg"], 3),
            fixed(&document["f_px"], 1),
            fixed(&document["rms_px"], 2),
        );
        for g in rows("gcps") {
            let word = if g["blunder"] == true { "  BLUNDER" } else { "" };
            let name = g["name"].as_str().unwrap_or_default();
            eprintln!("  {name}: ({}) px, {} px{word}", several(&g["residual_px"], 1), fixed(&g["d_px"], 1));
        }
        for c in rows("check_points") {
            let name = c["name"].as_str().unwrap_or_default();
            eprintln!("  {name}: ({}) px, {} px  check", several(&c["residual_px"], 1), fixed(&c["d_px"], 1));
        }
        for other in rows("alternatives") {
            let angle = |key: &str| fixed(&other[key], 3);
            let angles = format!("yaw {} pitch {} roll {}", angle("yaw_deg"), angle("pitch_deg"), angle("roll_deg"));
            eprintln!("  or: C ({}) {angles}", several(&other["C"], 3));
        }
    }
    for note in rows("notes").iter().filter_map(Value::as_str).filter(|note| !already.iter().any(|said| said == note)) {
        eprintln!("note: {note}");
    }
}
