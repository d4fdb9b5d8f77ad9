//! Frames that show what lies beside and behind the camera: all of it counts, in resections and in blocks.

use autoref_flight::adjust::{AdjustOptions, GroundPoint, Role, adjust};
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint};
use autoref_flight::resect::{ResectOptions, Resection, Seen, resect};
use autoref_flight::{Camera, Projection};
use nalgebra::Vector3;

#[allow(dead_code)]
mod drawn;
use drawn::{Draw, noisy, shaken};

const SIGMA_PX: f64 = 0.3;
const SIGMA_M: f64 = 0.02;

/// A picture of all directions, and a fisheye that shows 114° off its axis.
fn cameras() -> [Camera; 2] {
    let camera = |projection, size, f_px, pp| Camera { projection, ..Camera::pinhole("c", size, f_px, pp) };
    let all_round = 1000.0 / std::f64::consts::PI;
    [
        camera(Projection::Equirectangular, [2000.0, 1000.0], all_round, [1000.0, 500.0]),
        camera(Projection::Fisheye, [2000.0, 2000.0], 500.0, [1003.0, 998.0]),
    ]
}

fn level(draw: &mut Draw, pitch_deg: f64) -> YawPitchRoll {
    YawPitchRoll { yaw_deg: draw.uniform(0.0, 360.0), pitch_deg, roll_deg: 3.0 * draw.normal() }
}

/// Points around a camera, every other one behind it, as they were measured; and where the camera is.
fn photograph(draw: &mut Draw, camera: &Camera, count: usize) -> (Vec<Seen>, Vector3<f64>) {
    let centre = Vector3::new(5000.0, 6000.0, 120.0);
    let pitch_deg = if camera.projection == Projection::Fisheye { -60.0 } else { 3.0 };
    let pose = Pose::looking(centre, level(draw, pitch_deg));
    let mut seen: Vec<Seen> = Vec::new();
    while seen.len() < count {
        let off = Vector3::new(150.0 * draw.normal(), 150.0 * draw.normal(), draw.uniform(-120.0, -80.0));
        let local = pose.to_camera(&(centre + off));
        let at = camera.project(local.into()).filter(|at| camera.contains(*at));
        let Some(at) = at.filter(|_| (local.z < 0.0) == (seen.len() % 2 == 1)) else { continue };
        let pixel = at.map(|v| v + SIGMA_PX * draw.normal());
        let xyz = centre + off + draw.vector(SIGMA_M);
        seen.push(Seen { name: format!("P{}", seen.len()), xyz, sigma_m: Vector3::repeat(SIGMA_M), pixel });
    }
    (seen, centre)
}

fn resected(camera: &Camera, seen: &[Seen]) -> Resection {
    resect(camera, seen, &ResectOptions { sigma_px: SIGMA_PX, ..ResectOptions::default() })
        .expect("the points fix a pose")
}

/// Σ of (error / σ)² of the place's three numbers.
fn squares(found: &Resection, centre: &Vector3<f64>) -> f64 {
    let variance = found.covariance.expect("the points have some to spare").diagonal();
    (0..3).map(|k| (found.pose.centre[k] - centre[k]).powi(2) / variance[3 + k]).sum()
}

#[test]
fn points_behind_the_camera_fix_a_pose_like_others() {
    let mut draw = Draw::new(91);
    for camera in cameras() {
        let (mut sum, mut count) = (0.0, 0.0);
        for points in [4, 4, 6, 10, 10] {
            let (seen, centre) = photograph(&mut draw, &camera, points);
            let found = resected(&camera, &seen);
            let of_true = squares(&found, &centre);
            assert!(found.blunders.is_empty() || points <= 6, "{:?} {points}: {:?}", camera.projection, found.blunders);
            assert!(of_true < 30.0 || !found.alternatives.is_empty(), "{:?} {points}: {of_true}", camera.projection);
            (sum, count) = if points == 10 { (sum + of_true, count + 3.0) } else { (sum, count) };
            if points < 10 {
                continue;
            }
            // One that lies behind is named like one in front.
            for wrong in [6, 7] {
                let mut spoiled = seen.clone();
                spoiled[wrong].pixel[1] += 60.0;
                assert_eq!(resected(&camera, &spoiled).blunders, [wrong], "{:?}", camera.projection);
            }
        }
        let normalised = f64::sqrt(sum / count);
        assert!((0.3..1.8).contains(&normalised), "{:?}: {normalised}", camera.projection);
    }
}

/// A line of frames that see ties and GCPs all round.
fn block(draw: &mut Draw, camera: &Camera) -> (Reconstruction, Vec<GroundPoint>) {
    let mut model = Reconstruction { cameras: vec![camera.clone()], ..Reconstruction::default() };
    for i in 0..5 {
        let centre = Vector3::new(20.0 * f64::from(i), 3.0 * draw.normal(), 30.0 + draw.normal());
        let pitch_deg = if camera.projection == Projection::Fisheye { -60.0 } else { 2.0 * draw.normal() };
        let pose = Pose::looking(centre, level(draw, pitch_deg));
        model.photographs.push(Photograph { name: format!("f{i}"), camera: 0, pose });
    }
    let reach = camera.reach();
    let mut points = Vec::new();
    while model.ties.len() < 120 || points.len() < 8 {
        let x = Vector3::new(draw.uniform(-30.0, 110.0), draw.uniform(-50.0, 50.0), draw.uniform(0.0, 8.0));
        let frames = model.photographs.iter().enumerate();
        let seen: Vec<(usize, [f64; 2])> =
            frames.filter_map(|(i, p)| Some((i, camera.shows(p.pose.to_camera(&x).into(), &reach)?))).collect();
        if seen.len() < 3 {
            continue;
        }
        if points.len() < 8 {
            let (name, sigma) = (format!("G{}", points.len()), Vector3::repeat(SIGMA_M));
            points.push(GroundPoint { name, xyz: x, sigma, role: Role::Control, seen });
        } else {
            model.ties.push(TiePoint { xyz: x, seen });
        }
    }
    (model, points)
}

#[test]
fn a_block_of_frames_that_see_all_round_stands_where_it_was() {
    let mut draw = Draw::new(92);
    for camera in cameras() {
        let (truth, mut points) = block(&mut draw, &camera);
        let mut measured = truth.clone();
        noisy(&mut draw, &mut measured, &mut points, SIGMA_PX, SIGMA_M);
        // Of one GCP an image point behind a camera is wrong.
        let behind = |p: &GroundPoint| {
            let is_behind = |(i, _): &(usize, [f64; 2])| truth.photographs[*i].pose.to_camera(&p.xyz).z < 0.0;
            p.seen.iter().position(is_behind).filter(|_| p.seen.len() > 3)
        };
        let wrong = points.iter().enumerate().find_map(|(k, p)| Some((k, behind(p)?)));
        let (gcp, wrong) = wrong.expect("some lie behind a camera");
        let (name, frame) = (points[gcp].name.clone(), points[gcp].seen[wrong].0);
        points[gcp].seen[wrong].1[1] -= 25.0;
        let options = AdjustOptions { sigma_image_px: SIGMA_PX, ..AdjustOptions::default() };
        let found = adjust(&shaken(&mut draw, &measured), &points, &options).expect("an adjustment");
        assert_eq!((found.ties, found.dropped_ties), (truth.ties.len(), 0), "{:?}", camera.projection);
        let named: Vec<_> = found.blunders.iter().map(|b| (b.gcp.as_str(), b.photograph)).collect();
        assert_eq!(named, [(name.as_str(), Some(frame))], "{:?}", camera.projection);
        let mut sum = 0.0;
        for (p, q) in found.photographs.iter().zip(&truth.photographs) {
            let variance = p.covariance.expect("all is fixed").diagonal();
            let off = p.pose.centre - q.pose.centre;
            sum += (0..3).map(|k| off[k] * off[k] / variance[3 + k]).sum::<f64>();
        }
        let normalised = (sum / 15.0).sqrt();
        assert!((0.3..1.8).contains(&normalised), "{:?}: {normalised}", camera.projection);
        assert!((found.sigma_tie_px / SIGMA_PX - 1.0).abs() < 0.2, "{:?}: {}", camera.projection, found.sigma_tie_px);
    }
}
