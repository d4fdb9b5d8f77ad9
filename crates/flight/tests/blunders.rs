//! Gross errors in drawn sets: none is named where there is none, the right one where there is one.

use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::resect::{ResectOptions, Seen, resect};
use autoref_raster::random::SplitMix64;
use nalgebra::Vector3;

struct Draw(SplitMix64);

impl Draw {
    fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.unit()
    }
    fn normal(&mut self) -> f64 {
        let (u, v) = (self.uniform(1e-12, 1.0), self.uniform(0.0, 1.0));
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }
}

/// Points of an oblique photograph with errors of `px`, and the camera's place.
fn set(draw: &mut Draw, n: usize, px: f64) -> (Camera, Vec<Seen>, Vector3<f64>) {
    let camera = Camera::pinhole("c", [5000.0, 3400.0], 6200.0, [2500.0, 1700.0]);
    let angles = YawPitchRoll {
        yaw_deg: draw.uniform(0.0, 360.0),
        pitch_deg: draw.uniform(-35.0, -5.0),
        roll_deg: draw.uniform(-5.0, 5.0),
    };
    let centre = Vector3::new(0.0, 0.0, draw.uniform(400.0, 3000.0));
    let pose = Pose::looking(centre, angles);
    let mut seen = Vec::new();
    while seen.len() < n {
        let pixel = [draw.uniform(50.0, 4950.0), draw.uniform(50.0, 3350.0)];
        let ray = pose.rotation.transpose() * Vector3::from(camera.ray(pixel).expect("inside"));
        let xyz = centre + ray * draw.uniform(2500.0, 12_000.0);
        let at = [pixel[0] + px * draw.normal(), pixel[1] + px * draw.normal()];
        seen.push(Seen { name: format!("{}", seen.len() + 1), xyz, sigma_m: Vector3::zeros(), pixel: at });
    }
    (camera, seen, centre)
}

#[test]
fn clean_sets_name_no_blunder() {
    let mut draw = Draw(SplitMix64(2));
    let (mut stated, mut understated) = (0, 0);
    let trials = 60;
    for _ in 0..trials {
        let n = 6 + (draw.uniform(0.0, 8.0) as usize);
        let (camera, seen, _) = set(&mut draw, n, 1.0);
        let found = resect(&camera, &seen, &ResectOptions::default()).expect("found");
        stated += usize::from(!found.blunders.is_empty());
        // The list's author said 1 px and clicked to 6.
        let (camera, seen, _) = set(&mut draw, n, 6.0);
        let found = resect(&camera, &seen, &ResectOptions::default()).expect("found");
        understated += usize::from(!found.blunders.is_empty());
    }
    eprintln!("of {trials} clean sets with a blunder named: {stated}, with σ understated {understated}");
    assert!(stated == 0 && understated * 10 <= trials, "{stated} {understated}");
}

#[test]
fn the_wrong_point_is_named() {
    let mut draw = Draw(SplitMix64(3));
    let (mut right, mut also) = (0, 0);
    let trials = 60;
    for _ in 0..trials {
        let (camera, mut seen, centre) = set(&mut draw, 10, 5.0);
        let wrong = draw.uniform(0.0, 10.0) as usize;
        let turn = draw.uniform(0.0, std::f64::consts::TAU);
        seen[wrong].pixel[0] += 150.0 * turn.cos();
        seen[wrong].pixel[1] += 150.0 * turn.sin();
        let found = resect(&camera, &seen, &ResectOptions::default()).expect("found");
        right += usize::from(found.blunders.contains(&wrong));
        also += found.blunders.iter().filter(|b| **b != wrong).count();
        assert_eq!(found.residuals_px.len(), 10);
        // A position that is wrong by 500 m does not make other points look wrong.
        let position = Some((centre + Vector3::new(400.0, 300.0, 0.0), Vector3::repeat(1.0)));
        let held = resect(&camera, &seen, &ResectOptions { position, ..ResectOptions::default() }).expect("found");
        assert_eq!(held.blunders, found.blunders);
    }
    eprintln!("of {trials} wrong points named: {right}, right ones besides: {also}");
    assert!(right * 100 >= trials * 95 && also * 10 <= trials, "{right} {also}");
}

/// Two of ten hide each other where all are judged together.
#[test]
fn several_wrong_points_do_not_hide_each_other() {
    let mut draw = Draw(SplitMix64(5));
    let (trials, mut right) = (24, 0);
    for trial in 0..trials {
        let (camera, mut seen, centre) = set(&mut draw, 10, 0.5);
        let wrong: Vec<usize> = if trial % 2 == 0 { vec![1, 6] } else { vec![0, 4, 8] };
        for i in &wrong {
            let turn = draw.uniform(0.0, std::f64::consts::TAU);
            seen[*i].pixel[0] += 90.0 * turn.cos();
            seen[*i].pixel[1] += 90.0 * turn.sin();
        }
        let options = ResectOptions { sigma_px: 0.5, ..ResectOptions::default() };
        let found = resect(&camera, &seen, &options).expect("found");
        right += usize::from(found.blunders == wrong);
        let sigma = found.covariance.expect("redundant").diagonal().fixed_rows::<3>(3).sum().sqrt();
        assert!(found.blunders != wrong || (found.pose.centre - centre).norm() < 5.0 * sigma, "trial {trial}");
    }
    assert!(right + 1 >= trials, "{right} of {trials}");
}
