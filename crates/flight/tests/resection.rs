//! Blunders of single frames: named where they are, and only there.

use autoref_flight::camera::Camera;
use autoref_flight::resect::{ResectOptions, Seen, resect, three_points};
use nalgebra::Vector3;

#[path = "../../../tests/common/random.rs"]
mod random;
use random::Random;

/// Ten points on hills seen obliquely from the side, with errors of `sigma_px` in the image.
fn net(camera: &Camera, random: &mut Random, sigma_px: f64) -> Vec<Seen> {
    let mut seen = Vec::new();
    while seen.len() < 10 {
        // The camera stands at the origin, looks along y and 10° down.
        let ground = Vector3::new(
            random.uniform(-3000.0, 3000.0),
            random.uniform(3000.0, 12_000.0),
            random.uniform(-1500.0, -300.0),
        );
        let (sin, cos) = (-10f64).to_radians().sin_cos();
        let ahead = ground.y * cos + ground.z * sin;
        let below = ground.y * sin - ground.z * cos;
        let Some(p) = camera.project([ground.x, below, ahead]) else { continue };
        if camera.contains(p) {
            let pixel = [p[0] + sigma_px * random.normal(), p[1] + sigma_px * random.normal()];
            seen.push(Seen { name: format!("P{}", seen.len()), xyz: ground, sigma_m: Vector3::zeros(), pixel });
        }
    }
    seen
}

/// Shares of nets, in hundredths, of which a blunder was named, and of which exactly the wrong point was.
fn named(sigma_px: f64, blunder_px: f64) -> (usize, usize) {
    let nets = if std::env::var_os("AUTOREF_LARGE").is_some() { 1000 } else { 40 };
    let camera = Camera::pinhole("drawn", [4000.0, 3000.0], 3500.0, [2000.0, 1500.0]);
    let mut random = Random::new(27);
    let (mut any, mut right) = (0, 0);
    for _ in 0..nets {
        let mut seen = net(&camera, &mut random, sigma_px);
        let wrong = random.below(10);
        let direction = random.uniform(0.0, std::f64::consts::TAU);
        seen[wrong].pixel[0] += blunder_px * direction.cos();
        seen[wrong].pixel[1] += blunder_px * direction.sin();
        let found = resect(&camera, &seen, &ResectOptions::default()).expect("ten points fix a pose");
        any += usize::from(!found.blunders.is_empty());
        right += usize::from(found.blunders == [wrong]);
    }
    println!("σ {sigma_px} px, blunder {blunder_px} px: named {any}, rightly {right} of {nets}");
    (100 * any / nets, 100 * right / nets)
}

#[test]
fn blunders_are_named_and_clean_nets_are_left_alone() {
    assert!(named(1.0, 0.0).0 <= 1);
    assert!(named(1.0, 60.0).1 >= 95);
    // The stated 1 px is three and twenty times too small: the others tell.
    assert!(named(3.0, 0.0).0 <= 10);
    assert!(named(20.0, 0.0).0 <= 10);
    assert!(named(20.0, 400.0).1 >= 85);
}

/// Points that fit five times worse than was stated: the deviations say so, and hold.
#[test]
fn deviations_are_those_of_the_points_and_not_of_what_was_stated() {
    let camera = Camera::pinhole("drawn", [4000.0, 3000.0], 3500.0, [2000.0, 1500.0]);
    let mut random = Random::new(35);
    let (mut squares, mut count) = (0.0, 0);
    for stated in [5.0, 1.0] {
        let (mut widened, mut sum) = (0, 0.0);
        for _ in 0..40 {
            let seen: Vec<Seen> = (0..2).flat_map(|_| net(&camera, &mut random, 5.0)).collect();
            let options = ResectOptions { sigma_px: stated, ..ResectOptions::default() };
            let found = resect(&camera, &seen, &options).expect("twenty points fix a pose");
            widened += usize::from(found.widened > 1.0);
            let variance = found.covariance.expect("redundant").diagonal();
            sum += (0..3).map(|k| found.pose.centre[k].powi(2) / variance[3 + k]).sum::<f64>();
        }
        assert_eq!(widened > 20, stated < 5.0, "stated {stated} px: {widened} of 40");
        (squares, count) = (squares + sum, count + 120);
    }
    let normalised = (squares / f64::from(count)).sqrt();
    assert!((0.8..1.3).contains(&normalised), "{normalised}");
}

/// An isosceles triangle on level ground seen from above, whichever of its points comes first: the true pose is among
/// those found.
#[test]
fn alike_rays_about_a_point_lose_no_pose() {
    let base = [Vector3::new(-30.0, -20.0, 0.0), Vector3::new(0.0, 40.0, 0.0), Vector3::new(30.0, -20.0, 0.0)];
    let eye = Vector3::new(0.0, 0.0, 100.0);
    for turn in 0..3 {
        let world: [Vector3<f64>; 3] = std::array::from_fn(|i| base[(i + turn) % 3]);
        // Down, x to the east.
        let rays = world.map(|p| Vector3::new(p.x - eye.x, -(p.y - eye.y), eye.z - p.z).normalize());
        let poses = three_points(&world, &rays);
        assert!(poses.iter().any(|pose| (pose.centre - eye).norm() < 1e-4), "{turn}: {poses:?}");
        for pose in &poses {
            for (p, ray) in world.iter().zip(&rays) {
                let seen = (pose.rotation * (p - pose.centre)).normalize();
                assert!((seen - ray).norm() < 1e-4, "{turn}: {pose:?}");
            }
        }
    }
}

#[test]
fn points_on_a_line_are_said_to_be() {
    let camera = Camera::pinhole("c", [4000.0, 3000.0], 3000.0, [2000.0, 1500.0]);
    let seen = |place: &dyn Fn(f64) -> [f64; 3], pixel: &dyn Fn(f64) -> [f64; 2]| -> Vec<Seen> {
        let point = |i: i32| {
            let t = f64::from(i);
            Seen { name: i.to_string(), xyz: place(t).into(), sigma_m: Vector3::zeros(), pixel: pixel(t) }
        };
        (0..6).map(point).collect()
    };
    let line = seen(&|t| [10.0 * t, 20.0 * t, 0.0], &|t| [600.0 + 300.0 * t, 1500.0]);
    let place = seen(&|_| [5.0, 5.0, 0.0], &|_| [2000.0, 1500.0]);
    for seen in [line, place] {
        let refused = resect(&camera, &seen, &ResectOptions::default()).expect_err("the pose is open");
        assert!(refused.to_string().contains("one line"), "{refused}");
    }
    let spread = seen(&|t| [10.0 * t, 7.0 * t * t, 0.0], &|t| [9.0 * t, 1.0]);
    if let Err(refused) = resect(&camera, &spread, &ResectOptions::default()) {
        assert!(!refused.to_string().contains("one line"), "{refused}");
    }
}
