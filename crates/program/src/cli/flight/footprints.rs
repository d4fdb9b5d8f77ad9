//! What a solved flight shows besides its cameras: how far each stands from the rough table, and which ground its frame
//! sees.

use autoref_flight::adjust::{Adjustment, RoughPose};
use autoref_flight::pose::{Similarity, turn};
use autoref_flight::read::tables::CameraRow;
use autoref_flight::read::{Reconstruction, same_image};
use autoref_flight::statistics::Residuals;
use autoref_flight::world::World;
use autoref_flight::{Camera, Pose};
use autoref_raster::crs::{Coordinate, Crs};
use autoref_raster::ranks::upper_median;
use autoref_raster::words::some_of;
use nalgebra::{Matrix2, Vector2, Vector3};
use serde_json::{Value, json};

use super::camera_tables;
use super::document::{FrameDifference, RoughDifferences};

/// Points to a side of a frame.
const SIDE: usize = 12;
/// Ground farther than this many heights is not drawn: beyond it lies the horizon.
const FARTHEST_HEIGHTS: f64 = 15.0;

/// Camera − table, by frame and together, metres on the ground: Δx, Δy, Δz with their signs, and
/// d = √(Δx² + Δy² + Δz²) (thesis of 2017, equation 9.2, which prints the sizes alone).
pub fn rough_differences(
    found: &Adjustment,
    model: &Reconstruction,
    rows: &[CameraRow],
    world: &World,
) -> RoughDifferences {
    let mut all = Vec::new();
    let mut frames = Vec::new();
    for camera in &found.photographs {
        let name = &model.photographs[camera.photograph].name;
        let row = rows.iter().find(|r| same_image(&r.name, std::iter::once(name.as_str())).is_some());
        let (Some(row), Some(at)) = (row, world.to_map(&camera.pose.centre)) else { continue };
        let by = world.ground_metres_of(at, std::array::from_fn(|a| at[a] - row.xyz[a]));
        let turn_deg = camera_tables::rough_pose(row, world, 1.0, 1.0).and_then(|rough| turn_deg(&camera.pose, &rough));
        let [x_m, y_m, z_m] = by;
        let (name, d_m, line) = (name.clone(), Vector3::from(by).norm(), row.line.clone());
        frames.push(FrameDifference { name, x_m, y_m, z_m, d_m, turn_deg, line });
        all.push(by);
    }
    RoughDifferences { frames, statistics: Residuals::of(&all) }
}

/// The turn between a camera and what the table says of it; `None` where the table has no direction.
fn turn_deg(pose: &Pose, rough: &RoughPose) -> Option<f64> {
    let angle = || turn(&pose.rotation, &rough.pose.rotation).norm().to_degrees();
    rough.sigma_rad.is_finite().then(angle)
}

/// Lets go of directions of the table that are far from those of the block on the ground: they are no errors of a few
/// degrees but frames that were turned, or angles of another kind. A note that names the frames.
pub fn let_go_of_turned(rough: &mut [Option<RoughPose>], model: &Reconstruction, by: &Similarity) -> Option<String> {
    /// A table that states degrees is not wrong by so many.
    const FAR_DEG: f64 = 60.0;
    let (mut turned, mut by_deg) = (Vec::new(), Vec::new());
    for (photograph, rough) in model.photographs.iter().zip(rough) {
        let Some(rough) = rough else { continue };
        if let Some(turn) = turn_deg(&photograph.pose.moved(by), rough).filter(|turn| *turn > FAR_DEG) {
            rough.sigma_rad = f64::INFINITY;
            turned.push(photograph.name.clone());
            by_deg.push(turn);
        }
    }
    let median = upper_median(&mut by_deg)?;
    Some(format!(
        "the table's direction of {} of {} frames is {median:.0} degrees off ({}): it does not count; were these frames \
         turned, or are its angles of another kind? Correct them, or leave the columns of directions out",
        turned.len(),
        model.photographs.len(),
        some_of(&turned)
    ))
}

/// A frame's ground on the plane of height `ground_m`, the map's metres, as a ring that is not closed. `map_scale` is
/// that of [`World::map_scale`] at the camera. Empty when the frame sees none.
fn outline(camera: &Camera, map_pose: &Pose, map_scale: &Matrix2<f64>, ground_m: f64) -> Vec<[f64; 2]> {
    let [w, h] = camera.size_px;
    let along = |k: usize| k as f64 / SIDE as f64;
    let sides: [&dyn Fn(f64) -> [f64; 2]; 4] =
        [&|t| [w * t, h], &|t| [w, h * (1.0 - t)], &|t| [w * (1.0 - t), 0.0], &|t| [0.0, h * t]];
    let above = map_pose.centre.z - ground_m;
    if above <= 0.0 {
        return Vec::new();
    }
    let farthest = FARTHEST_HEIGHTS * above;
    let mut sees = false;
    let mut ring = Vec::new();
    for pixel in sides.iter().flat_map(|side| (0..SIDE).map(|k| side(along(k)))) {
        let Some(ray) = camera.ray(pixel) else { continue };
        let ray = map_pose.rotation.transpose() * Vector3::from(ray);
        let level = ray.x.hypot(ray.y);
        let away = if ray.z < 0.0 { level * above / -ray.z } else { f64::INFINITY };
        sees |= away < farthest;
        let reach = away.min(farthest) / level.max(f64::MIN_POSITIVE);
        let ground = if level > 0.0 { Vector2::new(ray.x, ray.y) * reach } else { Vector2::zeros() };
        ring.push((map_pose.centre.xy() + map_scale * ground).into());
    }
    if sees { ring } else { Vec::new() }
}

/// The frames' ground as GeoJSON polygons: longitude and latitude, or local coordinates without a CRS. The plane lies
/// at the median height of the ties.
pub fn footprints(found: &Adjustment, model: &Reconstruction, world: &World, crs: Option<&Crs>) -> Value {
    let [plan_m, height_m] = world.units_m();
    let height = |tie: &Vector3<f64>| Some(world.to_map(tie)?[2] * height_m);
    let mut heights: Vec<f64> = found.model.ties.iter().filter_map(|t| height(&t.xyz)).collect();
    let ground_m = upper_median(&mut heights).unwrap_or(0.0);
    let earth = crs.filter(|c| !c.is_local()).zip(Crs::from_epsg(4326).ok());
    let mut features = Vec::new();
    for photograph in &found.photographs {
        let of = &model.photographs[photograph.photograph];
        let Some(mut pose) = world.pose_to_map(&photograph.pose) else { continue };
        let Some(map_scale) = world.map_scale(pose.centre.into()) else { continue };
        pose.centre = world.metres_of(pose.centre.into()).into();
        let mut ring = outline(&found.cameras[of.camera], &pose, &map_scale, ground_m);
        if let Some((crs, earth)) = &earth {
            let mut places: Vec<Coordinate> =
                ring.iter().map(|p| Coordinate { x: p[0] / plan_m, y: p[1] / plan_m, height: None }).collect();
            if crs.transform(&mut places, earth, 100.0).is_err() {
                continue;
            }
            ring = places.iter().map(|p| [p.x, p.y]).collect();
        }
        let Some(first) = ring.first().copied() else { continue };
        // Counterclockwise, as GeoJSON (RFC 7946) asks.
        let double: f64 = (0..ring.len())
            .map(|i| (ring[i], ring[(i + 1) % ring.len()]))
            .map(|(a, b)| a[0] * b[1] - b[0] * a[1])
            .sum();
        ring.push(first);
        if double < 0.0 {
            ring.reverse();
        }
        let angles = pose.yaw_pitch_roll();
        features.push(json!({
            "type": "Feature",
            "properties": {"name": of.name, "yaw_deg": angles.yaw_deg, "pitch_deg": angles.pitch_deg, "ground_m": ground_m},
            "geometry": {"type": "Polygon", "coordinates": [ring]},
        }));
    }
    json!({"type": "FeatureCollection", "features": features})
}

#[cfg(test)]
mod tests {
    use super::*;
    use autoref_flight::YawPitchRoll;

    fn looking(pitch_deg: f64) -> Pose {
        let angles = YawPitchRoll { yaw_deg: 90.0, pitch_deg, roll_deg: 0.0 };
        Pose::looking(Vector3::new(1000.0, 2000.0, 600.0), angles)
    }

    #[test]
    fn a_frame_that_looks_down_sees_its_size_over_the_focal_length() {
        let camera = Camera::pinhole("c", [1000.0, 500.0], 1000.0, [500.0, 250.0]);
        let ring = outline(&camera, &looking(-90.0), &Matrix2::identity(), 100.0);
        let span = |a: usize| {
            let values = ring.iter().map(|p| p[a]);
            (values.clone().fold(f64::MAX, f64::min), values.fold(f64::MIN, f64::max))
        };
        // 500 m above ground: 500 m across and 250 m along, its top to the east.
        let (x, y) = (span(0), span(1));
        assert!((x.0 - 875.0).abs() < 1e-6 && (x.1 - 1125.0).abs() < 1e-6, "{x:?}");
        assert!((y.0 - 1750.0).abs() < 1e-6 && (y.1 - 2250.0).abs() < 1e-6, "{y:?}");
        // On a map that shows metres twice as long towards east and three times towards north.
        let stretched = outline(&camera, &looking(-90.0), &Matrix2::new(2.0, 0.0, 0.0, 3.0), 100.0);
        let reach = |a: usize, from: f64| stretched.iter().map(|p| (p[a] - from).abs()).fold(0.0, f64::max);
        assert!((reach(0, 1000.0) - 250.0).abs() < 1e-6 && (reach(1, 2000.0) - 750.0).abs() < 1e-6, "{stretched:?}");
    }

    #[test]
    fn ground_ends_before_the_horizon() {
        let camera = Camera::pinhole("c", [1000.0; 2], 1000.0, [500.0; 2]);
        let oblique = outline(&camera, &looking(-20.0), &Matrix2::identity(), 100.0);
        let far = oblique.iter().map(|p| (p[0] - 1000.0).hypot(p[1] - 2000.0)).fold(0.0, f64::max);
        assert!((far - FARTHEST_HEIGHTS * 500.0).abs() < 1e-6, "{far}");
        assert!(outline(&camera, &looking(60.0), &Matrix2::identity(), 100.0).is_empty(), "the sky alone");
        assert!(outline(&camera, &looking(-20.0), &Matrix2::identity(), 700.0).is_empty(), "below the ground");
    }
}
