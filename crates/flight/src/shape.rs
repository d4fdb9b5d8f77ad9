//! The shape of a block that holds no ties: MicMac's orientations, a cameras.json, models without points. Its poses
//! know how its frames lie to each other; as image points of made points, seen where the poses see them, this counts
//! in an adjustment as measured ties do, while datum and scale stay free.

use autoref_raster::ranks::upper_median;
use nalgebra::Vector3;

use crate::camera::Camera;
use crate::reach::Reach;
use crate::read::{Reconstruction, TiePoint};

/// Places along each side of a frame that rays go through.
const PLACES: usize = 3;
/// How far along a ray the first points are made, in distances to the nearest other frame. Each next one is twice as
/// far: ground as it is seen with much and with little overlap, and far behind it, where frames that share no ground
/// look at the same points; the last is the first beyond so many times the block's extent.
const FIRST_DEPTH: f64 = 2.0;
const EXTENTS: f64 = 2.0;
/// Of a block whose frames nearly all have a twin beside them, as on a rig.
const MOST_DEPTHS: usize = 16;
/// Frames that see one point, at most.
const MOST_FRAMES: usize = 8;

/// Points that the frames of a block see as their poses say; none of fewer than two frames.
pub fn ties_of_poses(model: &Reconstruction) -> Vec<TiePoint> {
    let centres: Vec<Vector3<f64>> = model.photographs.iter().map(|p| p.pose.centre).collect();
    let Some(step) = typical_step(&centres) else { return vec![] };
    let extent = centres.iter().map(|c| (c - centres[0]).norm()).fold(step, f64::max);
    let depths: Vec<f64> = std::iter::successors(Some(FIRST_DEPTH * step), |depth| Some(2.0 * depth))
        .take(MOST_DEPTHS)
        .take_while(|depth| *depth <= 2.0 * EXTENTS * extent)
        .collect();
    let reaches: Vec<Reach> = model.cameras.iter().map(Camera::reach).collect();
    let mut ties = vec![];
    for photograph in &model.photographs {
        let camera = &model.cameras[photograph.camera];
        for place in 0..PLACES * PLACES {
            let share = |k: usize| (k as f64 + 0.5) / PLACES as f64;
            let pixel = [share(place % PLACES) * camera.size_px[0], share(place / PLACES) * camera.size_px[1]];
            let Some(ray) = camera.ray(pixel) else { continue };
            let direction = photograph.pose.rotation.transpose() * Vector3::from(ray);
            for depth in &depths {
                let xyz = photograph.pose.centre + direction * *depth;
                let seen = seen_nearest(model, &reaches, &xyz, &photograph.pose.centre);
                if seen.len() >= 2 {
                    ties.push(TiePoint { xyz, seen });
                }
            }
        }
    }
    ties
}

/// The frames nearest to a place that see a point, and where.
fn seen_nearest(
    model: &Reconstruction,
    reaches: &[Reach],
    xyz: &Vector3<f64>,
    from: &Vector3<f64>,
) -> Vec<(usize, [f64; 2])> {
    let mut all: Vec<(f64, usize, [f64; 2])> = model
        .photographs
        .iter()
        .enumerate()
        .filter_map(|(i, p)| {
            let camera = &model.cameras[p.camera];
            let pixel = camera.shows(p.pose.to_camera(xyz).into(), &reaches[p.camera])?;
            Some(((p.pose.centre - from).norm(), i, pixel))
        })
        .collect();
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    // The nearest half, and of the others some as far as any: what holds a long block straight.
    let half = MOST_FRAMES / 2;
    let rest = all.len().saturating_sub(half);
    let kept = |k: usize| k < half || (k - half) * half / rest.max(1) != (k + 1 - half) * half / rest.max(1);
    all.iter().enumerate().filter(|(k, _)| kept(*k)).map(|(_, (_, i, pixel))| (*i, *pixel)).collect()
}

/// The median distance from a frame to the nearest other one that does not stand where it does.
fn typical_step(centres: &[Vector3<f64>]) -> Option<f64> {
    let nearest = |c: &Vector3<f64>| centres.iter().map(|o| (o - c).norm()).filter(|d| *d > 0.0).min_by(f64::total_cmp);
    let mut steps: Vec<f64> = centres.iter().filter_map(nearest).collect();
    upper_median(&mut steps)
}
