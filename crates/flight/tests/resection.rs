//! Blunders of single frames: named where they are, and only there.

use autoref_flight::camera::Camera;
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::resect::{Focal, ResectOptions, Resection, Seen, resect, three_points};
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

/// How a drawn photograph was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Taken {
    /// Straight down from 100 m, points known to 2 cm, pixels to 0.5.
    Down,
    /// The same with the points on a cylinder through the camera, where three points and their neighbours say least.
    OverCylinder,
    /// To the side from 3000 m, points known to 25 m.
    Sideways,
}

/// A drawn photograph: its points as measured, and the true place.
fn photograph(random: &mut Random, taken: Taken, count: usize) -> (Camera, Vec<Seen>, Vector3<f64>, f64) {
    let (f, height, relief, sigma_px, sigma_m) = match taken {
        Taken::Down | Taken::OverCylinder => (3000.0, 100.0, 15.0, 0.5, 0.02),
        Taken::Sideways => (3500.0, 3000.0, 500.0, 1.0, 25.0),
    };
    let camera = Camera::pinhole("drawn", [4000.0, 3000.0], f, [2000.0, 1500.0]);
    let centre = Vector3::new(500.0, 800.0, height + random.uniform(-8.0, 8.0));
    let pitch_deg = if taken == Taken::Sideways { random.uniform(-35.0, -20.0) } else { random.uniform(-90.0, -85.0) };
    let angles = YawPitchRoll { yaw_deg: random.uniform(0.0, 360.0), pitch_deg, roll_deg: 3.0 * random.normal() };
    let pose = Pose::looking(centre, angles);
    let axis = random.uniform(0.0, std::f64::consts::TAU);
    let mut seen: Vec<Seen> = Vec::new();
    while seen.len() < count {
        let ground = random.uniform(-relief / 2.0, relief / 2.0);
        let xyz = if taken == Taken::OverCylinder {
            let about = axis + std::f64::consts::PI + [0.6, 2.6, 4.4][seen.len() % 3] + 0.2 * random.normal();
            let radius = 30.0;
            let level = Vector3::new(axis.cos() + about.cos(), axis.sin() + about.sin(), 0.0) * radius;
            Vector3::new(centre.x, centre.y, ground) + level
        } else {
            let top = if taken == Taken::Sideways { 900.0 } else { 60.0 };
            let pixel = [random.uniform(60.0, 3940.0), random.uniform(top, 2940.0)];
            let ray = pose.rotation.transpose() * Vector3::from(camera.ray(pixel).expect("inside"));
            if ray.z > -0.02 {
                continue;
            }
            centre + ray * ((ground - centre.z) / ray.z)
        };
        let Some(at) = camera.project(pose.to_camera(&xyz).into()).filter(|at| camera.contains(*at)) else { continue };
        let pixel = at.map(|v| v + sigma_px * random.normal());
        let off = Vector3::new(random.normal(), random.normal(), random.normal()) * sigma_m;
        let sigma_m = Vector3::repeat(sigma_m);
        seen.push(Seen { name: format!("P{}", seen.len()), xyz: xyz + off, sigma_m, pixel });
    }
    (camera, seen, centre, sigma_px)
}

/// Whether the stated deviations cover the true place, five times over; nothing is claimed where none are stated.
fn covers(found: &Resection, centre: &Vector3<f64>) -> bool {
    let Some(covariance) = &found.covariance else { return true };
    (0..3).all(|k| (found.pose.centre[k] - centre[k]).abs() <= 5.0 * covariance[(3 + k, 3 + k)].sqrt())
}

/// Poses that stand elsewhere with a small deviation are never stated alone: where few points fit several poses, the
/// right one is stated, or another one is said to be possible.
#[test]
fn few_points_hide_no_other_pose() {
    let mut random = Random::new(71);
    for (taken, count, draws) in [
        (Taken::Down, 4, 60),
        (Taken::OverCylinder, 4, 60),
        (Taken::Sideways, 4, 60),
        (Taken::Sideways, 6, 40),
        (Taken::Down, 3, 60),
        (Taken::Sideways, 3, 60),
    ] {
        let (mut alone, mut lost, mut several) = (0, 0, 0);
        for _ in 0..draws {
            let (camera, seen, centre, sigma_px) = photograph(&mut random, taken, count);
            let options = ResectOptions { sigma_px, ..ResectOptions::default() };
            let found = match resect(&camera, &seen, &options) {
                Ok(found) => found,
                Err(refused) => {
                    assert!(refused.to_string().contains("one line"), "{taken:?} {count}: {refused}");
                    continue;
                }
            };
            several += usize::from(!found.alternatives.is_empty());
            let off = |pose: &Pose| (pose.centre - centre).norm();
            let nearer = found.alternatives.iter().any(|a| off(&a.pose) < off(&found.pose));
            alone += usize::from(!covers(&found, &centre) && found.alternatives.is_empty());
            lost += usize::from(!covers(&found, &centre) && !nearer);
        }
        println!(
            "{taken:?}, {count} points: of {draws} {several} with others, {alone} wrong alone, {lost} without the truth"
        );
        assert!(alone == 0, "{taken:?} {count}: {alone} of {draws} stated wrong, alone");
        assert!(50 * lost <= draws, "{taken:?} {count}: {lost} of {draws} lists lack the truth");
        assert!(count <= 3 || 4 * several <= draws, "{taken:?} {count}: {several} of {draws} have others");
    }
}

/// Every pose that three points fit exactly is listed, or lies within the deviations that are stated of one that is.
#[test]
fn three_points_list_every_pose_that_fits_them() {
    let camera = Camera::pinhole("c", [2000.0, 1500.0], 1500.0, [1003.0, 747.0]);
    let options = ResectOptions { sigma_px: 0.2, ..ResectOptions::default() };
    let lost = |places: [[f64; 3]; 3], pixels: [[f64; 2]; 3]| {
        let point = |i: usize| Seen {
            name: i.to_string(),
            xyz: places[i].into(),
            sigma_m: Vector3::repeat(0.01),
            pixel: pixels[i],
        };
        let found = resect(&camera, &[0, 1, 2].map(point), &options).expect("a pose");
        let rays = pixels.map(|pixel| camera.ray(pixel).expect("inside").into());
        let exact = three_points(&places.map(Vector3::from), &rays);
        let others = found.alternatives.iter().map(|a| (a.pose.centre, a.covariance));
        let listed: Vec<_> = others.chain([(found.pose.centre, found.covariance)]).collect();
        let is_listed = |at: &Vector3<f64>| {
            listed.iter().any(|(centre, covariance)| {
                let sigma = |k: usize| covariance.map_or(0.0, |q| q[(3 + k, 3 + k)].sqrt());
                (centre - at).norm() < 5.0 || (0..3).all(|k| (at[k] - centre[k]).abs() <= 3.0 * sigma(k))
            })
        };
        let lost: Vec<Vector3<f64>> = exact.iter().map(|p| p.centre).filter(|c| !is_listed(c)).collect();
        (exact.len(), lost)
    };
    let places = [[5525.8325, 6425.0105, 130.4738], [5340.3388, 5944.6813, 194.8372], [4594.3962, 6202.7373, 78.4809]];
    assert_eq!(lost(places, [[142.640, 1448.847], [495.569, 658.927], [1755.587, 1231.923]]), (4, vec![]));
    let mut random = Random::new(81);
    let mut fours = 0;
    for _ in 0..40 {
        let angles = YawPitchRoll { yaw_deg: random.uniform(0.0, 360.0), pitch_deg: -86.0, roll_deg: 0.0 };
        let pose = Pose::looking(Vector3::new(5000.0, 6000.0, 1000.0), angles);
        let pixels: [[f64; 2]; 3] =
            std::array::from_fn(|_| [random.uniform(50.0, 1950.0), random.uniform(50.0, 1450.0)]);
        let place = |pixel: [f64; 2], height: f64| {
            let ray = pose.rotation.transpose() * Vector3::from(camera.ray(pixel).expect("inside"));
            (pose.centre + ray * ((height - pose.centre.z) / ray.z)).into()
        };
        let places: [[f64; 3]; 3] = pixels.map(|pixel| place(pixel, random.uniform(0.0, 200.0)));
        let (exact, lost) = lost(places, pixels);
        fours += usize::from(exact == 4);
        assert!(lost.is_empty(), "{places:?} {pixels:?}: {lost:?}");
    }
    assert!(fours >= 5, "{fours}");
}

/// Four points that leave the focal length open state more than one pose, or a deviation that holds.
#[test]
fn a_sought_focal_length_hides_no_other_pose() {
    let mut random = Random::new(72);
    let draws = 25;
    let mut alone = 0;
    for _ in 0..draws {
        let (camera, seen, centre, sigma_px) = photograph(&mut random, Taken::Down, 4);
        let options = ResectOptions { sigma_px, focal: Focal::Sought, ..ResectOptions::default() };
        let found = resect(&camera, &seen, &options).expect("a pose");
        alone += usize::from(!covers(&found, &centre) && found.alternatives.is_empty());
    }
    assert!(alone == 0, "{alone} of {draws}");
}

/// One of four points is wrong, and nothing says which: that is said.
#[test]
fn one_wrong_point_of_four_is_no_pose() {
    let mut random = Random::new(73);
    let draws = 40;
    let mut alone = 0;
    for _ in 0..draws {
        let (camera, mut seen, centre, sigma_px) = photograph(&mut random, Taken::Down, 4);
        seen[random.below(4)].pixel[0] += random.uniform(30.0, 200.0);
        let options = ResectOptions { sigma_px, ..ResectOptions::default() };
        let found = resect(&camera, &seen, &options).expect("a pose");
        let silent = found.alternatives.is_empty() && found.widened <= 1.0;
        alone += usize::from(!covers(&found, &centre) && silent);
    }
    assert!(20 * alone <= draws, "{alone} of {draws}");
}

/// Points that are surveyed along a line are on it within their errors, and those tell nothing of the turn about it;
/// a known place does.
#[test]
fn points_on_a_line_but_for_their_errors_are_said_to_be() {
    let mut random = Random::new(74);
    let camera = Camera::pinhole("c", [4000.0, 3000.0], 3000.0, [2000.0, 1500.0]);
    let centre = Vector3::new(500.0, 800.0, 100.0);
    let pose = Pose::looking(centre, YawPitchRoll { yaw_deg: 40.0, pitch_deg: -87.0, roll_deg: 1.0 });
    for count in [3, 4, 10] {
        let seen: Vec<Seen> = (0..count)
            .map(|i| {
                let along = f64::from(2 * i) / f64::from(count - 1) - 1.0;
                let xyz = Vector3::new(500.0 + 40.0 * along, 800.0 + 20.0 * along, 0.0);
                let at = camera.project(pose.to_camera(&xyz).into()).expect("in front");
                let pixel = at.map(|v| v + 0.5 * random.normal());
                let off = Vector3::new(random.normal(), random.normal(), random.normal()) * 0.02;
                Seen { name: i.to_string(), xyz: xyz + off, sigma_m: Vector3::repeat(0.02), pixel }
            })
            .collect();
        let options = ResectOptions { sigma_px: 0.5, ..ResectOptions::default() };
        let refused = resect(&camera, &seen, &options).expect_err("the pose is open").to_string();
        assert!(refused.contains("one line") && refused.contains("--position"), "{refused}");
        let position = Some((centre, Vector3::repeat(0.1)));
        let found = resect(&camera, &seen, &ResectOptions { position, ..options }).expect("the place fixes the turn");
        assert!((found.pose.centre - centre).norm() < 1.0, "{:?}", found.pose.centre);
    }
}

/// Ten points that fix the pose, and a position 100 m off: it is left out, and one that is right counts. Three points
/// have none to spare, and the position rules.
#[test]
fn a_wrong_position_does_not_drag_a_pose_that_the_points_fix() {
    let camera = Camera::pinhole("drawn", [4000.0, 3000.0], 3500.0, [2000.0, 1500.0]);
    let mut random = Random::new(58);
    for turn in 0..6 {
        let seen = net(&camera, &mut random, 0.7);
        let (sin, cos) = (f64::from(turn) * 60f64.to_radians()).sin_cos();
        let placed = |east: f64, north: f64, points: usize| {
            let position = Some((Vector3::new(east, north, 0.0), Vector3::repeat(1.0)));
            let options = ResectOptions { sigma_px: 0.7, position, ..ResectOptions::default() };
            resect(&camera, &seen[..points], &options).expect("a pose")
        };
        let alone = resect(&camera, &seen, &ResectOptions { sigma_px: 0.7, ..ResectOptions::default() });
        let alone = alone.expect("ten points fix a pose");
        let found = placed(100.0 * cos, 100.0 * sin, 10);
        let off_m = found.position_off_m.expect("it is left out");
        assert!((off_m - 100.0).abs() < 20.0 && found.blunders.is_empty(), "{turn}: {off_m} {:?}", found.blunders);
        assert!((found.pose.centre - alone.pose.centre).norm() < 1e-3, "{turn}: {}", found.pose.centre);
        let right = placed(0.5 * cos, 0.5 * sin, 10);
        assert!(right.position_off_m.is_none() && right.pose.centre.norm() < 3.0, "{turn}: {}", right.pose.centre);
        let few = placed(100.0 * cos, 100.0 * sin, 3);
        assert!(few.position_off_m.is_none(), "{turn}: three points");
    }
}

/// Pixels of a copy of half or twice the size are told from points that are wrong.
#[test]
fn pixels_of_a_copy_of_another_size_are_named() {
    let camera = Camera::pinhole("drawn", [4000.0, 3000.0], 3500.0, [2000.0, 1500.0]);
    let mut random = Random::new(64);
    let options = ResectOptions { sigma_px: 0.7, ..ResectOptions::default() };
    for _ in 0..3 {
        let seen = net(&camera, &mut random, 0.7);
        let of_copy = |factor: f64| -> Vec<Seen> {
            seen.iter().map(|s| Seen { pixel: s.pixel.map(|v| v * factor), ..s.clone() }).collect()
        };
        let told = |seen: &[Seen]| resect(&camera, seen, &options).ok().and_then(|found| found.pixels_times);
        assert_eq!(told(&seen), None);
        assert_eq!(told(&of_copy(0.5)), Some(2.0));
        // Height for northing is another slip.
        let mut exchanged = seen.clone();
        exchanged.iter_mut().for_each(|s| s.xyz.swap_rows(1, 2));
        assert_eq!(told(&exchanged), None);
    }
}
