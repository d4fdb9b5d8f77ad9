//! The adjustment on drawn blocks: it finds the truth, its covariances cover the errors, and blunders are named.

use autoref_flight::adjust::{AdjustOptions, GroundPoint, adjust};
use autoref_flight::bundle::{
    BundleCamera, BundleFrame, BundlePoint, Ended, Loss, Observation, Options, Problem, Treatment, Trust, factor, solve,
};
use autoref_flight::camera::{Camera, Parameter};
use autoref_flight::complete::{completed, joined};
use autoref_flight::pose::Similarity;
use autoref_flight::read::{Reconstruction, TiePoint};
use autoref_flight::shape::ties_of_poses;
use autoref_flight::start::Track;
use nalgebra::{Rotation3, Vector3};

mod drawn;
mod normalised;
use drawn::{Draw, block, noisy, shaken};
use normalised::Normalised;

/// Numbers that every run draws alike (SplitMix64), uniform and normal.
/// Some frames of a model in a datum of their own, with the ties that two of them see.
fn part(draw: &mut Draw, model: &Reconstruction, frames: std::ops::Range<usize>) -> Reconstruction {
    let mut part = shaken(draw, model);
    part.photographs = part.photographs[frames.clone()].to_vec();
    for t in &mut part.ties {
        t.seen.retain(|(i, _)| frames.contains(i));
        t.seen.iter_mut().for_each(|(i, _)| *i -= frames.start);
    }
    part.ties.retain(|t| t.seen.len() >= 2);
    part
}

/// A mapper's parts become one block, and frames that it left out join it, though a third of their ties are wrong.
#[test]
fn parts_are_joined_and_frames_left_out_are_placed() {
    let mut draw = Draw::new(23);
    let (truth, points) = block(&mut draw, 9, 900, 8);
    let names: Vec<&str> = truth.photographs.iter().map(|p| p.name.as_str()).collect();
    let (mut seen, mut measured) = (truth.clone(), points.clone());
    noisy(&mut draw, &mut seen, &mut measured, 0.5, 0.05);
    let parts = vec![part(&mut draw, &seen, 3..7), part(&mut draw, &seen, 0..5)];
    let joined = joined(parts).expect("a block");
    assert_eq!(joined.photographs.len(), 7);
    // Each tie of two parts is one.
    let of = |names: [&str; 2]| {
        let index = names.map(|name| joined.find(name).expect("joined"));
        joined.ties.iter().filter(|t| index.iter().all(|k| t.seen.iter().any(|(i, _)| i == k))).count()
    };
    assert!(of(["f2", "f5"]) > 20, "{}", of(["f2", "f5"]));
    let mut tracks: Vec<Track> = seen.ties.iter().map(|t| t.seen.clone()).collect();
    for track in tracks.iter_mut().step_by(3) {
        track.iter_mut().filter(|(frame, _)| *frame >= 7).for_each(|(_, at)| at[0] = 1800.0 - at[0]);
    }
    let block = completed(joined, &names, &tracks).expect("completed");
    assert_eq!(block.photographs.len(), 9);
    for p in &mut measured {
        p.seen.iter_mut().for_each(|(i, _)| *i = block.find(names[*i]).expect("placed"));
    }
    let found = adjust(&block, &measured, &AdjustOptions::default()).expect("adjusted");
    for a in &found.photographs {
        let b = &truth.photographs[truth.find(&block.photographs[a.photograph].name).expect("known")];
        let (off, c) = (a.pose.centre - b.pose.centre, a.covariance.expect("the datum is fixed"));
        let sigma = c.diagonal().fixed_rows::<3>(3).map(f64::sqrt);
        assert!(off.component_div(&sigma).amax() < 4.0 && sigma.amax() < 40.0, "{}: {off:?} {sigma:?}", b.name);
    }
    assert!(found.tie_rms_px < 1.0, "{}", found.tie_rms_px);
    // What no tie leads to stays out.
    let few: Vec<Track> = tracks.iter().filter(|t| t.iter().all(|(i, _)| *i < 8)).cloned().collect();
    let block = completed(part(&mut draw, &seen, 0..7), &names, &few).expect("completed");
    assert_eq!(block.photographs.len(), 8);
}

/// A large block is not adjusted for each frame that it grows by, and holds together all the same.
#[test]
fn a_long_line_grows_frame_by_frame() {
    let mut draw = Draw::new(29);
    let (truth, points) = block(&mut draw, 55, 1600, 8);
    let names: Vec<&str> = truth.photographs.iter().map(|p| p.name.as_str()).collect();
    let (mut seen, mut measured) = (truth.clone(), points.clone());
    noisy(&mut draw, &mut seen, &mut measured, 0.5, 0.05);
    let tracks: Vec<Track> = seen.ties.iter().map(|t| t.seen.clone()).collect();
    let block = completed(part(&mut draw, &seen, 0..45), &names, &tracks).expect("completed");
    assert_eq!(block.photographs.len(), 55);
    let found = adjust(&block, &measured, &AdjustOptions::default()).expect("adjusted");
    assert!(found.tie_rms_px < 1.0, "{}", found.tie_rms_px);
}

#[test]
fn exact_measurements_give_the_exact_block() {
    let mut draw = Draw::new(1);
    let (truth, points) = block(&mut draw, 5, 150, 8);
    let start = shaken(&mut draw, &truth);
    let options = AdjustOptions { sigma_tie_px: Some(0.5), ..AdjustOptions::default() };
    let found = adjust(&start, &points, &options).expect("adjusted");
    for (a, b) in found.photographs.iter().zip(&truth.photographs) {
        assert!((a.pose.centre - b.pose.centre).norm() < 1e-3, "{:?}", a.pose.centre - b.pose.centre);
    }
    assert!((found.cameras[0].f_px() - 2107.0).abs() < 1e-4 && found.blunders.is_empty());
}

/// Exact poses in a datum of their own, without ties: the points turn, scale and move the block and do not take it
/// apart, and what is stated of its cameras covers their errors.
#[test]
fn a_block_without_ties_keeps_its_shape() {
    for seed in 0..6 {
        let mut draw = Draw::new(400 + seed);
        let (truth, points) = block(&mut draw, 6, 60, 8);
        let (mut seen, mut measured) = (truth.clone(), points.clone());
        noisy(&mut draw, &mut seen, &mut measured, 0.5, 2.0);
        let mut start = shaken(&mut draw, &truth);
        start.photographs.iter_mut().zip(&truth.photographs).for_each(|(own, true_one)| own.pose = true_one.pose);
        let datum = Similarity {
            scale: 0.013,
            rotation: Rotation3::from_euler_angles(0.3, -1.1, 2.0).into_inner(),
            shift: Vector3::new(3.0, -20.0, 7.0),
        };
        start.photographs.iter_mut().for_each(|p| p.pose = p.pose.moved(&datum));
        start.ties = ties_of_poses(&start);
        assert!(start.ties.iter().all(|t| (2..=8).contains(&t.seen.len())) && start.ties.len() > 50);
        let options = AdjustOptions { sigma_tie_px: Some(1.0), interior: Vec::new(), ..AdjustOptions::default() };
        let found = adjust(&start, &measured, &options).expect("adjusted");
        for (a, b) in found.photographs.iter().zip(&truth.photographs) {
            let (off, c) = (a.pose.centre - b.pose.centre, a.covariance.expect("the datum is fixed"));
            let sigma = c.diagonal().fixed_rows::<3>(3).map(f64::sqrt);
            assert!(off.component_div(&sigma).amax() < 4.5 && sigma.amax() < 20.0, "{seed}: {off:?} {sigma:?}");
        }
    }
}

/// Frames of a rig, each with a twin a decimetre beside it, are tied from station to station all the same.
#[test]
fn stations_of_a_rig_are_tied() {
    let (mut model, _) = block(&mut Draw::new(77), 6, 60, 8);
    let twins = model.photographs.clone().into_iter().map(|mut twin| {
        twin.pose.centre += Vector3::new(0.1, 0.0, 0.0);
        twin.name.push_str("-twin");
        twin
    });
    model.photographs.extend(twins.collect::<Vec<_>>());
    let ties = ties_of_poses(&model);
    let mut station: Vec<usize> = (0..6).collect();
    for tie in &ties {
        let seen: Vec<usize> = tie.seen.iter().map(|(frame, _)| station[frame % 6]).collect();
        let first = seen.iter().copied().min().expect("a tie is seen");
        station.iter_mut().filter(|s| seen.contains(s)).for_each(|s| *s = first);
    }
    assert!(station.iter().all(|s| *s == 0), "{station:?}");
}

/// An interior orientation that is held and wrong is said, though none of its parameters is adjusted.
#[test]
fn a_held_lens_that_is_not_as_stated_is_said() {
    let mut draw = Draw::new(31);
    let (truth, mut points) = block(&mut draw, 6, 600, 8);
    let mut seen = truth.clone();
    noisy(&mut draw, &mut seen, &mut points, 0.5, 0.05);
    let notes = |k1: f64| {
        let mut start = seen.clone();
        start.cameras[0] = start.cameras[0].clone().with(Parameter::K1, k1);
        let options = AdjustOptions { interior: Vec::new(), ..AdjustOptions::default() };
        adjust(&start, &points, &options).expect("adjusted").notes.join("; ")
    };
    let said = |notes: &str| notes.contains("which is held: with");
    assert!(!said(&notes(-0.002)), "{}", notes(-0.002));
    assert!(said(&notes(0.02)), "{}", notes(0.02));
}

/// Rays that are parallel tell nothing of the point, and take nothing from what others tell.
#[test]
fn a_tie_without_depth_costs_no_covariance() {
    let mut draw = Draw::new(3);
    let (truth, mut points) = block(&mut draw, 5, 150, 8);
    let mut start = truth.clone();
    noisy(&mut draw, &mut start, &mut points, 0.5, 1.0);
    let options = AdjustOptions { sigma_tie_px: Some(0.5), ..AdjustOptions::default() };
    let without = adjust(&start, &points, &options).expect("adjusted");
    let camera = &truth.cameras[0];
    let ray = Vector3::from(camera.ray([900.0, 700.0]).expect("inside"));
    let far = truth.photographs[2].pose.centre + truth.photographs[2].pose.rotation.transpose() * ray * 3e9;
    let seen = [2, 3].map(|i| (i, camera.project(truth.photographs[i].pose.to_camera(&far).into()).expect("in front")));
    start.ties.push(TiePoint { xyz: far, seen: seen.to_vec() });
    let with = adjust(&start, &points, &options).expect("adjusted");
    assert!(with.notes.iter().all(|note| !note.contains("singular")), "{:?}", with.notes);
    for (a, b) in with.photographs.iter().zip(&without.photographs) {
        let (a, b) = (a.covariance.expect("stated"), b.covariance.expect("stated"));
        assert!((a - b).norm() < 0.05 * b.norm(), "{a} {b}");
    }
}

#[test]
fn blunders_are_named() {
    let mut draw = Draw::new(7);
    let (truth, mut points) = block(&mut draw, 5, 200, 10);
    let mut start = shaken(&mut draw, &truth);
    noisy(&mut draw, &mut start, &mut points, 0.7, 5.0);
    // One GCP was clicked 25 px off in one photograph, another surveyed 120 m off.
    let wrong = points[3].seen[1].0;
    points[3].seen[1].1[0] += 25.0;
    points[6].xyz.x += 120.0;
    let found = adjust(&start, &points, &AdjustOptions::default()).expect("adjusted");
    let named: Vec<(&str, Option<usize>)> = found.blunders.iter().map(|b| (b.gcp.as_str(), b.photograph)).collect();
    assert!(named.len() == 2 && named.contains(&("G3", Some(wrong))) && named.contains(&("G6", None)), "{named:?}");
    let by = |name: &str| found.blunders.iter().find(|b| b.gcp == name).expect("named").by[0];
    assert!((by("G3") - 25.0).abs() < 5.0 && (by("G6") - 120.0).abs() < 40.0, "{:?}", found.blunders);
}

/// As phones' heights put points of the street above the camera: nothing pulls a point that starts behind its cameras.
#[test]
fn a_gcp_whose_rough_survey_lies_behind_its_cameras_is_placed_by_its_rays() {
    let mut draw = Draw::new(9);
    let (start, mut points) = block(&mut draw, 5, 150, 8);
    let truth = points[2].xyz;
    points[2].xyz += Vector3::new(0.0, -16_000.0, 6000.0);
    points[2].sigma = Vector3::repeat(1e5);
    let found = adjust(&start, &points, &AdjustOptions { interior: Vec::new(), ..AdjustOptions::default() });
    let found = found.expect("adjusted");
    assert_eq!(found.summary.ended, Ended::Converged);
    assert!((found.points[2].xyz - truth).norm() < 10.0, "{:?} is not {truth:?}", found.points[2].xyz);
}

#[test]
fn covariances_cover_the_errors() {
    // Normalised errors of positions, directions, focal length and points over many trials have an RMS of 1.
    let trials = if std::env::var_os("AUTOREF_LARGE").is_some() { 400 } else { 60 };
    let mut draw = Draw::new(11);
    let (truth, points) = block(&mut draw, 4, 60, 8);
    let mut sums = Normalised::default();
    for _ in 0..trials {
        let (mut start, mut seen) = (truth.clone(), points.clone());
        noisy(&mut draw, &mut start, &mut seen, 0.7, 25.0);
        let options = AdjustOptions {
            sigma_image_px: 0.7,
            sigma_tie_px: Some(0.7),
            interior: vec![(Parameter::F, None), (Parameter::K1, None)],
            critical: 1e9,
            ..AdjustOptions::default()
        };
        // Huber at 3σ hardly touches normal errors.
        let found = adjust(&start, &seen, &options).expect("adjusted");
        assert!(sums.add(&found, &truth, &points), "the datum is fixed");
    }
    let rms = sums.rms();
    eprintln!("{trials} trials: normalised errors of directions, positions, interior, points: {rms:.3?}");
    let tolerance = if trials >= 400 { 0.1 } else { 0.2 };
    assert!(rms.iter().all(|r| (r - 1.0).abs() < tolerance), "{rms:?}");
}

#[test]
fn large_blocks_take_seconds() {
    let large: &[(usize, usize)] = &[(100, 200_000), (400, 400_000)];
    let blocks = if std::env::var_os("AUTOREF_LARGE").is_some() { large } else { &[(12, 1200)] };
    for &(frames, ties) in blocks {
        let mut draw = Draw::new(5);
        let (truth, mut points) = block(&mut draw, frames, ties, 12);
        let mut start = shaken(&mut draw, &truth);
        noisy(&mut draw, &mut start, &mut points, 0.7, 25.0);
        let observations: usize = start.ties.iter().map(|t| t.seen.len()).sum();
        let begin = std::time::Instant::now();
        let found = adjust(&start, &points, &AdjustOptions::default()).expect("adjusted");
        eprintln!(
            "{frames} frames, {observations} observations: {:.1} s, {} last iterations, rms {:.3} px",
            begin.elapsed().as_secs_f64(),
            found.summary.iterations,
            found.tie_rms_px
        );
        // Few ties tell their σ less well.
        let tolerance = if ties > 10_000 { 0.05 } else { 0.1 };
        assert!((found.sigma_tie_px - 0.7).abs() < tolerance, "{}", found.sigma_tie_px);
    }
}

/// The problem as JSON, with the cost that was reached.
fn dump(problem: &Problem, cost: f64, f_px: f64) -> String {
    let camera = &problem.cameras[0].camera;
    let rows = |m: &nalgebra::Matrix3<f64>| m.transpose().iter().copied().collect::<Vec<f64>>();
    let frames: Vec<_> = problem
        .frames
        .iter()
        .map(|f| serde_json::json!({"R": rows(&f.pose.rotation), "C": f.pose.centre.as_slice()}))
        .collect();
    let points: Vec<_> = problem
        .points
        .iter()
        .map(|p| serde_json::json!({"xyz": p.xyz.as_slice(), "survey": p.survey.map(|s| [s.0.x, s.0.y, s.0.z, s.1.x])}))
        .collect();
    let observations: Vec<_> = problem
        .observations
        .iter()
        .map(|o| serde_json::json!([o.frame, o.point, o.pixel[0], o.pixel[1], o.sigma_px, o.trust == Trust::Robust]))
        .collect();
    serde_json::json!({
        "f": camera.f_px(), "pp": camera.pp_px(), "k1": camera.get(Parameter::K1), "huber": 1.5, "frames": frames,
        "points": points, "observations": observations, "ours": {"cost": cost, "f": f_px},
    })
    .to_string()
}

/// A small problem that has one minimum: three starts must meet there.
#[test]
fn the_minimum_does_not_depend_on_the_start() {
    let mut draw = Draw::new(3);
    let (truth, mut points) = block(&mut draw, 3, 30, 5);
    let mut start = truth.clone();
    noisy(&mut draw, &mut start, &mut points, 1.0, 10.0);
    let mut costs = Vec::new();
    for k in 0..3 {
        let mut problem = Problem {
            cameras: vec![BundleCamera::held(start.cameras[0].clone()).treat(Parameter::F, Treatment::Free)],
            ..Problem::default()
        };
        for p in &start.photographs {
            let mut pose = p.pose;
            pose.centre += draw.vector(30.0 * f64::from(k));
            pose.rotation = Rotation3::new(draw.vector(0.003 * f64::from(k))).matrix() * pose.rotation;
            problem.frames.push(BundleFrame { camera: 0, pose, position: None, direction: None });
        }
        let ties = start.ties.iter().map(|t| (t.xyz, None, &t.seen));
        let gcps = points.iter().map(|p| (p.xyz, Some((p.xyz, p.sigma)), &p.seen));
        for (j, (xyz, survey, seen)) in ties.chain(gcps).enumerate() {
            problem.points.push(BundlePoint { xyz: xyz + draw.vector(5.0 * f64::from(k)), survey });
            for (frame, pixel) in seen {
                let trust = if survey.is_some() { Trust::Full } else { Trust::Robust };
                problem.observations.push(Observation { frame: *frame, point: j, pixel: *pixel, sigma_px: 1.0, trust });
            }
        }
        let options = Options { loss: Loss::Huber(1.5), least_gain: 1e-15, most_iterations: 200, ..Options::default() };
        // For benches/bundle_scipy.py: the start that is farthest off.
        if let Some(file) = std::env::var_os("AUTOREF_BUNDLE_DUMP").filter(|_| k == 2) {
            let mut solved = problem.clone();
            let ours = solve(&mut solved, &options).expect("solved").cost;
            std::fs::write(file, dump(&problem, ours, solved.cameras[0].camera.f_px())).expect("written");
        }
        costs.push(solve(&mut problem, &options).expect("solved").cost);
        assert!(factor(&problem, options.loss).is_some());
    }
    assert!(costs.iter().all(|c| (c - costs[0]).abs() < 1e-8 * costs[0]), "{costs:?}");
}

/// A point that is wrong by more than its neighbours together can hold back, or two whose names were exchanged, bend no
/// block: they are named, and the cameras stand where they stand without them.
#[test]
fn gross_errors_of_precise_points_bend_nothing() {
    type Fault = fn(&mut [GroundPoint]);
    let faults: [(&[&str], Fault); 4] = [
        (&["G3", "G9"], |points| {
            let other = points[9].xyz;
            points[9].xyz = std::mem::replace(&mut points[3].xyz, other);
        }),
        (&["G4"], |points| points[4].xyz.x += 10_000.0),
        (&["G5"], |points| points[5].xyz.y -= 400.0),
        (&["G6"], |points| points[6].seen[0].1[0] += 700.0),
    ];
    let mut draw = Draw::new(91);
    let (mut model, mut points) = block(&mut draw, 6, 400, 16);
    points.iter_mut().for_each(|p| p.sigma = Vector3::repeat(0.05));
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.05);
    let options = AdjustOptions { sigma_image_px: 0.5, interior: Vec::new(), ..AdjustOptions::default() };
    let clean = adjust(&model, &points, &options).expect("adjusted");
    assert!(clean.blunders.is_empty(), "{:?}", clean.blunders);
    for (names, fault) in faults {
        let mut wrong = points.clone();
        fault(&mut wrong);
        let found = adjust(&model, &wrong, &options).expect("adjusted");
        let mut named: Vec<&str> = found.blunders.iter().map(|b| b.gcp.as_str()).collect();
        named.sort_unstable();
        assert_eq!(named, names);
        for (a, b) in found.photographs.iter().zip(&clean.photographs) {
            let off = (a.pose.centre - b.pose.centre).norm();
            assert!(off < 3.0, "{names:?}: {off} m");
        }
    }
}

/// A frame that looks the other way keeps no GCP from placing the block, and bends nothing.
#[test]
fn a_frame_with_a_wrong_pose_is_set_aside() {
    let mut draw = Draw::new(61);
    for ties in [0, 150] {
        let (truth, mut points) = block(&mut draw, 8, ties, 14);
        let mut model = truth.clone();
        noisy(&mut draw, &mut model, &mut points, 0.3, 0.5);
        let turned = Rotation3::from_axis_angle(&Vector3::y_axis(), 2.5).matrix() * model.photographs[3].pose.rotation;
        model.photographs[3].pose.rotation = turned;
        let options = AdjustOptions { interior: Vec::new(), ..AdjustOptions::default() };
        let found = adjust(&shaken(&mut draw, &model), &points, &options).expect("the others place the block");
        let frames: Vec<usize> = found.photographs.iter().map(|p| p.photograph).collect();
        assert_eq!(frames, [0, 1, 2, 4, 5, 6, 7], "{ties} ties");
        for p in &found.photographs {
            let sigma = p.covariance.expect("fixed").diagonal().fixed_rows::<3>(3).sum().sqrt();
            let off = (p.pose.centre - truth.photographs[p.photograph].pose.centre).norm();
            assert!(off < 4.0 * sigma, "f{}: {off} of {sigma}", p.photograph);
        }
        assert!(found.blunders.is_empty(), "{:?}", found.blunders);
        let named = |note: &&String| note.starts_with("f3: set aside") && note.contains("flight resect");
        assert_eq!((found.notes.len(), found.notes.iter().filter(named).count()), (1, 1), "{:?}", found.notes);
    }
}

/// Where the ties say that a frame stands right, it is its GCPs that were measured wrong.
#[test]
fn a_frame_whose_ties_fit_stays() {
    let mut draw = Draw::new(64);
    let (mut model, mut points) = block(&mut draw, 8, 150, 14);
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.5);
    let wrong = points.iter_mut().flat_map(|p| &mut p.seen).filter(|(frame, _)| *frame == 3);
    wrong.for_each(|(_, at)| at[0] += if at[0] < 900.0 { 600.0 } else { -600.0 });
    let options = AdjustOptions { interior: Vec::new(), ..AdjustOptions::default() };
    let found = adjust(&shaken(&mut draw, &model), &points, &options).expect("adjusted");
    assert_eq!(found.photographs.len(), 8, "{:?}", found.notes);
    assert!(found.blunders.iter().any(|b| b.photograph == Some(3)), "{:?}", found.blunders);
}

/// One frame without any image point, and one with a single one, take no deviation from the others.
#[test]
fn frames_that_nothing_fixes_are_named() {
    let mut draw = Draw::new(62);
    let (truth, mut points) = block(&mut draw, 6, 0, 14);
    let mut model = truth.clone();
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.5);
    let mut left = 1;
    for p in &mut points {
        p.seen.retain(|(frame, _)| match frame {
            0 => false,
            5 => std::mem::take(&mut left) == 1,
            _ => true,
        });
    }
    let options = AdjustOptions { interior: Vec::new(), ..AdjustOptions::default() };
    let found = adjust(&shaken(&mut draw, &model), &points, &options).expect("adjusted");
    let stated: Vec<bool> = found.photographs.iter().map(|p| p.covariance.is_some()).collect();
    assert_eq!(stated, [false, true, true, true, true, false], "{:?}", found.notes);
    assert!(found.points.iter().all(|p| p.covariance.is_some()));
    assert!(found.notes.len() == 1 && found.notes[0].contains(": f0, f5;"), "{:?}", found.notes);
}

/// Each frame has a camera of its own: one without an image point, one with three, leave f and k1 of the others free.
#[test]
fn interiors_that_nothing_fixes_are_held() {
    let mut draw = Draw::new(65);
    let (truth, mut points) = block(&mut draw, 6, 0, 24);
    let mut model = truth.clone();
    model.cameras = (0..6).map(|i| Camera { name: format!("c{i}"), ..truth.cameras[0].clone() }).collect();
    (0..6).for_each(|i| model.photographs[i].camera = i);
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.5);
    let mut left = 0;
    for p in &mut points {
        p.seen.retain(|(frame, _)| {
            left += usize::from(*frame == 5);
            *frame != 0 && (*frame != 5 || left <= 3)
        });
    }
    let found = adjust(&shaken(&mut draw, &model), &points, &AdjustOptions::default()).expect("adjusted");
    let free: Vec<usize> = found.interior_sigmas.iter().map(Vec::len).collect();
    assert_eq!(free, [0, 2, 2, 2, 2, 0], "{:?}", found.notes);
    assert!(found.notes.iter().any(|n| n.contains("is held") && n.contains(": c5;")), "{:?}", found.notes);
    assert!(found.photographs[1..].iter().all(|p| p.covariance.is_some()), "{:?}", found.notes);
}

/// Three GCPs in two photographs each, of which one looks the other way: it is not the GCPs that are missing.
#[test]
fn a_block_that_cannot_be_placed_says_why() {
    let mut draw = Draw::new(63);
    let (mut model, mut points) = block(&mut draw, 3, 0, 3);
    for (p, frames) in points.iter_mut().zip([[0, 1], [1, 2], [0, 1]]) {
        p.seen.retain(|(frame, _)| frames.contains(frame));
        assert_eq!(p.seen.len(), 2);
    }
    let turned = Rotation3::from_axis_angle(&Vector3::y_axis(), 3.0).matrix() * model.photographs[1].pose.rotation;
    model.photographs[1].pose.rotation = turned;
    let said = adjust(&model, &points, &AdjustOptions::default()).expect_err("nothing places it").to_string();
    assert!(said.contains("of 3 GCPs") && said.contains("the rays of 0 meet") && said.contains("that of f1"), "{said}");
    points.truncate(2);
    let said = adjust(&model, &points, &AdjustOptions::default()).expect_err("too few").to_string();
    assert!(said.contains("2 GCPs are seen in two photographs or more; 3 are needed"), "{said}");
}
