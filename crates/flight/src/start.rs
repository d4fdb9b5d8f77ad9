//! A block from a rough table: ties, GCPs and the table's poses adjusted together from far off, wrong ties let go of
//! step by step.
//!
//! It stands where a reconstruction that grows frame by frame cannot: with few points in three frames or more.

use nalgebra::Vector3;

use crate::adjust::{GroundPoint, Role, RoughPose};
use crate::bundle::{BundleCamera, BundleFrame, BundlePoint, Loss, Observation, Options, Problem, Trust, solve};
use crate::camera::Camera;
use crate::error::{Error, Result};
use crate::intersect::intersect;
use crate::pose::Pose;
use crate::read::{Photograph, Reconstruction, TiePoint};

/// A point of the ground in several frames: frame and pixel.
pub type Track = Vec<(usize, [f64; 2])>;

/// One step from the rough poses to the block.
struct Step {
    /// How residuals are weighed.
    sigma_px: f64,
    /// Ties beyond this are let go of.
    most_px: f64,
    /// Whether GCPs in the images may be wrong.
    gcps: Trust,
}

/// Rough poses are wrong by tens of pixels, ties by one. The first steps leave the poses to table and GCPs: thousands
/// of ties, wrong ones among them, would fold a line of near-flat ground where it is weak, far from the table, and a
/// GCP that is let go of there cannot unfold it.
const STEPS: [Step; 7] = [
    Step { sigma_px: 300.0, most_px: 1000.0, gcps: Trust::Full },
    Step { sigma_px: 80.0, most_px: 300.0, gcps: Trust::Full },
    Step { sigma_px: 20.0, most_px: 120.0, gcps: Trust::Full },
    Step { sigma_px: 6.0, most_px: 30.0, gcps: Trust::Full },
    Step { sigma_px: 2.0, most_px: 10.0, gcps: Trust::Full },
    Step { sigma_px: 1.0, most_px: 5.0, gcps: Trust::Robust },
    Step { sigma_px: 0.7, most_px: 3.0, gcps: Trust::Robust },
];
/// σ of a GCP in an image at least, where it counts in full.
const GCP_PX: f64 = 5.0;
/// A frame with fewer ties is not joined to the block.
const LEAST_TIES: usize = 12;

/// The block that ties, GCPs and rough poses agree on, in the world's frame, sought from `start`. `names`, `start` and
/// `rough` go by frame; all are of `camera`, whose interior is held. Frames that too few ties join are left out;
/// `notes` names them.
///
/// # Errors
/// When fewer than two frames are joined, or a number is not finite.
pub fn from_rough(
    names: &[String],
    camera: &Camera,
    start: &[Pose],
    rough: &[RoughPose],
    tracks: &[Track],
    ground: &[GroundPoint],
) -> Result<Reconstruction> {
    let mut poses: Vec<Pose> = start.to_vec();
    let mut live: Vec<&Track> = tracks.iter().filter(|t| t.len() >= 2).collect();
    let mut points = Vec::new();
    let ground: Vec<&GroundPoint> = ground.iter().filter(|p| p.role == Role::Control && !p.seen.is_empty()).collect();
    for Step { sigma_px, most_px, gcps } in STEPS {
        let placed: Vec<(&Track, Vector3<f64>)> =
            live.iter().filter_map(|t| Some((*t, place(camera, &poses, t)?))).collect();
        let mut problem = Problem { cameras: vec![BundleCamera::held(camera.clone())], ..Problem::default() };
        problem.frames = poses
            .iter()
            .zip(rough)
            .map(|(pose, rough)| BundleFrame {
                camera: 0,
                pose: *pose,
                position: Some((rough.pose.centre, rough.sigma_m)),
                direction: rough.sigma_rad.is_finite().then_some((rough.pose.rotation, rough.sigma_rad)),
            })
            .collect();
        let observe = |problem: &mut Problem, seen: &[(usize, [f64; 2])], sigma_px: f64, trust: Trust| {
            let point = problem.points.len() - 1;
            for (frame, pixel) in seen {
                problem.observations.push(Observation { frame: *frame, point, pixel: *pixel, sigma_px, trust });
            }
        };
        for (track, at) in &placed {
            problem.points.push(BundlePoint { xyz: *at, survey: None });
            observe(&mut problem, track, sigma_px, Trust::Robust);
        }
        for p in &ground {
            problem.points.push(BundlePoint { xyz: p.xyz, survey: Some((p.xyz, p.sigma)) });
            let sigma_px = if gcps == Trust::Full { sigma_px.max(GCP_PX) } else { sigma_px };
            observe(&mut problem, &p.seen, sigma_px, gcps);
        }
        // Once the poses are near, what is far off counts for nothing.
        let loss = if sigma_px > 5.0 { Loss::Huber(2.0) } else { Loss::Cauchy(2.0) };
        solve(&mut problem, &Options { loss, most_iterations: 60, least_gain: 1e-6, ..Options::default() })?;
        poses = problem.frames.iter().map(|f| f.pose).collect();
        let mut worst = vec![0.0f64; problem.points.len()];
        for o in &problem.observations {
            let far = problem.residual(o).map_or(f64::INFINITY, |r| r[0].hypot(r[1]));
            worst[o.point] = worst[o.point].max(far);
        }
        let kept: Vec<(&Track, Vector3<f64>)> = placed
            .iter()
            .enumerate()
            .filter(|(i, _)| worst[*i] <= most_px)
            .map(|(i, (track, _))| (*track, problem.points[i].xyz))
            .collect();
        live = kept.iter().map(|k| k.0).collect();
        points = kept;
    }
    block(names, camera, &poses, &points)
}

/// Where the rays of a track meet; wrong poses may let them pass behind each other.
fn place(camera: &Camera, poses: &[Pose], track: &Track) -> Option<Vector3<f64>> {
    let seen: Vec<(usize, Pose)> = track.iter().map(|(i, _)| (0, poses[*i])).collect();
    let pixels: Vec<[f64; 2]> = track.iter().map(|s| s.1).collect();
    intersect(std::slice::from_ref(camera), &seen, &pixels).filter(|x| x.iter().all(|v| v.is_finite()))
}

/// The largest set of frames that ties join, with the ties between them.
fn block(
    names: &[String],
    camera: &Camera,
    poses: &[Pose],
    points: &[(&Track, Vector3<f64>)],
) -> Result<Reconstruction> {
    let n = names.len();
    let mut shared = vec![vec![0usize; n]; n];
    for (track, _) in points {
        for (i, _) in track.iter() {
            for (j, _) in track.iter() {
                shared[*i][*j] += usize::from(i != j);
            }
        }
    }
    let mut group: Vec<usize> = (0..n).collect();
    for i in 0..n {
        for j in 0..i {
            if shared[i][j] >= LEAST_TIES && group[i] != group[j] {
                let (from, to) = (group[i].max(group[j]), group[i].min(group[j]));
                group.iter_mut().for_each(|g| *g = if *g == from { to } else { *g });
            }
        }
    }
    let size = |g: usize| group.iter().filter(|k| **k == g).count();
    let largest = (0..n).max_by_key(|g| (size(*g), n - g)).unwrap_or(0);
    let joined: Vec<usize> = (0..n).filter(|i| group[*i] == largest).collect();
    if joined.len() < 2 {
        return Err(Error::no_result(
            "too few ties between the frames agree with the rough table",
            "check its directions, the focal length and rough.ground_m",
        ));
    }
    let mut notes: Vec<String> = vec!["the ties were placed from the rough table".into()];
    notes.extend((0..n).filter(|i| group[*i] != largest).map(|i| format!("{}: too few ties join it", names[i])));
    let index = |i: &usize| joined.iter().position(|k| k == i);
    let ties = points
        .iter()
        .filter_map(|(track, xyz)| {
            let seen: Vec<(usize, [f64; 2])> = track.iter().filter_map(|(i, p)| Some((index(i)?, *p))).collect();
            (seen.len() >= 2).then_some(TiePoint { xyz: *xyz, seen })
        })
        .collect();
    let photographs =
        joined.iter().map(|i| Photograph { name: names[*i].clone(), camera: 0, pose: poses[*i] }).collect();
    Ok(Reconstruction { cameras: vec![camera.clone()], photographs, ties, notes, ..Reconstruction::default() })
}
