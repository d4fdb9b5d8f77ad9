//! Blocks that do not fit what was measured on the ground say so, and why.

use autoref_flight::adjust::{AdjustOptions, AdjustedCamera, Adjustment, GroundPoint, Role, RoughPose, adjust};
use autoref_flight::camera::{Camera, Parameter};
use autoref_flight::pose::{Pose, YawPitchRoll};
use autoref_flight::read::{Photograph, Reconstruction, TiePoint};
use nalgebra::{Rotation3, Vector3};

mod drawn;
use drawn::{Draw, block, noisy, shaken};

/// Lists that are wrong as a whole: no hunt for blunders, one line, and the slip where one explains it.
#[test]
fn lists_that_are_wrong_as_a_whole_are_refused() {
    let mut draw = Draw::new(81);
    let (mut model, mut points) = block(&mut draw, 6, 400, 14);
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.5);
    let start = shaken(&mut draw, &model);
    let said = |change: &dyn Fn(&mut GroundPoint)| {
        let mut wrong = points.clone();
        wrong.iter_mut().for_each(change);
        match adjust(&start, &wrong, &AdjustOptions::default()) {
            Ok(found) => found.notes.join("; "),
            Err(refused) => format!("refused: {refused}"),
        }
    };
    let column = said(&|p| p.xyz.x = 5000.0);
    assert!(column.starts_with("refused: the GCPs lie otherwise than the block has them"), "{column}");
    let feet = said(&|p| p.xyz.z /= 0.3048);
    assert!(feet.contains("if the heights were in feet"), "{feet}");
    let half = said(&|p| p.seen.iter_mut().for_each(|(_, at)| *at = at.map(|v| v / 2.0)));
    assert!(half.contains("in frames of half the size"), "{half}");
    let exchanged = said(&|p| p.xyz = Vector3::new(p.xyz.y, p.xyz.x, p.xyz.z));
    assert!(exchanged.contains("easting and northing exchanged"), "{exchanged}");
    let fine = said(&|_| {});
    assert!(!fine.contains("would fit if") && !fine.contains("half of the"), "{fine}");
}

/// A block of three lines flown straight down, 100 m above ground that rises by `relief_m` to each side of 0; all true.
fn straight_down(draw: &mut Draw, relief_m: f64) -> (Reconstruction, Vec<GroundPoint>) {
    let camera = Camera::pinhole("c", [1500.0, 1200.0], 1480.0, [765.0, 592.0]);
    let mut model = Reconstruction { cameras: vec![camera.clone()], ..Reconstruction::default() };
    for i in 0..18 {
        let (line, along) = (i / 6, i % 6);
        let centre = Vector3::new(25.0 * f64::from(along), 40.0 * f64::from(line), 100.0) + draw.vector(1.0);
        let yaw_deg = if line % 2 == 0 { 90.0 } else { 270.0 } + 2.0 * draw.normal();
        let angles = YawPitchRoll { yaw_deg, pitch_deg: -90.0 + draw.uniform(0.0, 2.0), roll_deg: draw.normal() };
        model.photographs.push(Photograph { name: format!("f{i}"), camera: 0, pose: Pose::looking(centre, angles) });
    }
    let mut points = Vec::new();
    while model.ties.len() < 800 {
        let x = Vector3::new(draw.uniform(-30.0, 155.0), draw.uniform(-30.0, 110.0), draw.uniform(-relief_m, relief_m));
        let all = model.photographs.iter().enumerate();
        let seen: Vec<(usize, [f64; 2])> = all
            .filter_map(|(i, p)| {
                Some((i, camera.project(p.pose.to_camera(&x).into()).filter(|at| camera.contains(*at))?))
            })
            .collect();
        match (seen.len() >= 3, points.len()) {
            (false, _) => {}
            (true, 0..=11) => points.push(GroundPoint {
                name: format!("G{}", points.len()),
                xyz: x,
                sigma: Vector3::repeat(0.02),
                role: Role::Control,
                seen,
            }),
            (true, _) => model.ties.push(TiePoint { xyz: x, seen }),
        }
    }
    (model, points)
}

/// A block flown straight down whose principal point is held where it is not: the lens is said to lack it, and the
/// deviations count it in.
#[test]
fn a_principal_point_that_is_held_and_wrong_is_said() {
    let mut draw = Draw::new(82);
    let (mut model, mut points) = straight_down(&mut draw, 3.0);
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.02);
    let found = |at: [f64; 2], interior: Vec<(Parameter, Option<f64>)>| {
        let mut start = shaken(&mut Draw::new(83), &model);
        start.cameras[0] = start.cameras[0].clone().with(Parameter::Cx, at[0]).with(Parameter::Cy, at[1]);
        let options = AdjustOptions { interior, sigma_image_px: 0.3, ..AdjustOptions::default() };
        adjust(&start, &points, &options).expect("adjusted")
    };
    let plain = vec![(Parameter::F, None), (Parameter::K1, None)];
    let bounded = [plain.clone(), vec![(Parameter::Cx, Some(15.0)), (Parameter::Cy, Some(15.0))]].concat();
    let worst = |found: &Adjustment| {
        let z = |p: &AdjustedCamera| {
            let off = found.model.photographs[p.photograph].pose.centre - model.photographs[p.photograph].pose.centre;
            let variance = p.covariance.expect("determined").diagonal();
            (0..3).map(|k| off[k].abs() / variance[3 + k].sqrt()).fold(0.0, f64::max)
        };
        found.photographs.iter().map(z).fold(0.0, f64::max)
    };
    let held = found([750.0, 600.0], plain.clone());
    assert!(held.notes.iter().any(|note| note.contains("cx, cy")), "{:?}", held.notes);
    assert!(worst(&held) < 5.0, "{}", worst(&held));
    let right = found([765.0, 592.0], plain);
    assert!(right.notes.iter().all(|note| !note.contains("cx, cy")), "{:?}", right.notes);
    let freed = found([750.0, 600.0], bounded);
    assert!(worst(&freed) < 5.0 && (freed.cameras[0].get(Parameter::Cx) - 765.0).abs() < 2.0, "{:?}", freed.cameras);
}

/// Rows of a table that are exchanged, and one that is far off, bend no block that stands on positions alone.
#[test]
fn positions_that_are_grossly_wrong_are_left_out() {
    let mut draw = Draw::new(83);
    let (truth, _) = block(&mut draw, 9, 500, 0);
    let mut start = truth.clone();
    noisy(&mut draw, &mut start, &mut [], 0.5, 0.0);
    let start = shaken(&mut draw, &start);
    let right: Vec<RoughPose> = truth
        .photographs
        .iter()
        .map(|p| {
            let by = draw.vector(0.02);
            let rotation = Rotation3::new(by).matrix() * p.pose.rotation;
            let pose = Pose { rotation, centre: p.pose.centre + draw.vector(5.0) };
            RoughPose { pose, sigma_m: Vector3::repeat(5.0), sigma_rad: 0.035 }
        })
        .collect();
    for wrong in [&[][..], &[4], &[2, 6]] {
        let mut rough = right.clone();
        match wrong {
            [a, b] => (rough[*a].pose.centre, rough[*b].pose.centre) = (right[*b].pose.centre, right[*a].pose.centre),
            _ => wrong.iter().for_each(|i: &usize| rough[*i].pose.centre += Vector3::new(3000.0, 3000.0, 3000.0)),
        }
        let rough = rough.into_iter().map(Some).collect();
        let found = adjust(&start, &[], &AdjustOptions { rough, ..AdjustOptions::default() }).expect("adjusted");
        let named: Vec<usize> =
            (0..9).filter(|i| found.notes.iter().any(|n| n.starts_with(&format!("f{i}: its position")))).collect();
        assert_eq!(named, wrong, "{:?}", found.notes);
        assert!((found.cameras[0].f_px() / 2107.0 - 1.0).abs() < 0.05, "{wrong:?}: {}", found.cameras[0].f_px());
        for (a, b) in found.photographs.iter().zip(&truth.photographs) {
            let off = (a.pose.centre - b.pose.centre).norm();
            assert!(off < 40.0, "{wrong:?} {}: {off} m", b.name);
        }
    }
}

/// Heights above the ellipsoid beside GCPs above the geoid: what all positions are off together bends no block, and is
/// said; positions that are right, one that is wrong and GCPs that are say no such thing.
#[test]
fn positions_of_another_datum_than_the_gcps_are_told() {
    let mut draw = Draw::new(84);
    let (truth, points) = block(&mut draw, 6, 250, 10);
    let (mut start, mut points) = (truth.clone(), points);
    noisy(&mut draw, &mut start, &mut points, 0.3, 0.3);
    let start = shaken(&mut draw, &start);
    let misses: Vec<Vector3<f64>> = (0..6).map(|_| draw.vector(2.0)).collect();
    let found = |offset: Vector3<f64>, wrong: &[(usize, f64)], points: &[GroundPoint]| {
        let place = |i: usize| {
            let by =
                wrong.iter().filter(|(frame, _)| *frame == i).map(|(_, by)| Vector3::repeat(*by)).sum::<Vector3<f64>>();
            let centre = truth.photographs[i].pose.centre + misses[i] + offset + by;
            let pose = Pose { centre, ..truth.photographs[i].pose };
            RoughPose { pose, sigma_m: Vector3::repeat(2.0), sigma_rad: f64::INFINITY }
        };
        let rough = (0..6).map(|i| Some(place(i))).collect();
        adjust(&start, points, &AdjustOptions { rough, ..AdjustOptions::default() }).expect("adjusted")
    };
    let worst = |found: &Adjustment| {
        let off = |(a, b): (&AdjustedCamera, &Photograph)| {
            let covariance = a.covariance.expect("the datum is fixed");
            (0..3)
                .map(|i| (a.pose.centre - b.pose.centre)[i].abs() / covariance[(3 + i, 3 + i)].sqrt())
                .fold(0.0, f64::max)
        };
        found.photographs.iter().zip(&truth.photographs).map(off).fold(0.0, f64::max)
    };
    let told = |found: &Adjustment| found.notes.iter().find(|n| n.contains("where the GCPs put the cameras")).cloned();
    let right = found(Vector3::zeros(), &[], &points);
    assert!(told(&right).is_none() && worst(&right) < 4.0, "{:?} {}", right.notes, worst(&right));
    for (offset, wrong, words) in [
        (Vector3::new(0.0, 0.0, 45.0), &[][..], "m) above where"),
        (Vector3::new(0.0, 0.0, -45.0), &[(2, 300.0)], "m) below where"),
        (Vector3::new(20.0, -30.0, 0.0), &[], "m) beside where"),
    ] {
        let apart = found(offset, wrong, &points);
        let note = told(&apart).unwrap_or_default();
        assert!(note.contains(words), "{offset:?}: {:?}", apart.notes);
        assert!(worst(&apart) < 4.0 && apart.blunders.is_empty(), "{offset:?}: {} {:?}", worst(&apart), apart.blunders);
        let named: Vec<usize> =
            (0..6).filter(|i| apart.notes.iter().any(|n| n.starts_with(&format!("f{i}: its position")))).collect();
        assert_eq!(named, wrong.iter().map(|(frame, _)| *frame).collect::<Vec<_>>(), "{:?}", apart.notes);
    }
    let one = found(Vector3::zeros(), &[(2, 300.0)], &points);
    assert!(told(&one).is_none(), "{:?}", one.notes);
    // Of three GCPs nothing tells whether they are wrong or the positions: that is said, and both count.
    let three = found(Vector3::new(0.0, 0.0, 250.0), &[], &points[..3]);
    let said = told(&three).unwrap_or_default();
    assert!(said.contains("m) above where") && said.contains("nothing tells which of both"), "{:?}", three.notes);
    points[4].xyz.z += 40.0;
    let gcp = found(Vector3::zeros(), &[], &points);
    assert!(told(&gcp).is_none() && gcp.blunders.iter().all(|b| b.gcp == "G4"), "{:?} {:?}", gcp.notes, gcp.blunders);
}

/// GCPs on level ground whose columns are exchanged put the cameras below it. Positions above are no other datum.
#[test]
fn positions_beyond_the_ground_are_of_no_other_datum() {
    let mut draw = Draw::new(85);
    let (mut model, mut points) = straight_down(&mut draw, 0.01);
    model.ties.truncate(40);
    noisy(&mut draw, &mut model, &mut points, 0.3, 0.02);
    let told = |exchanged: bool, up_m: f64| {
        let place = |at: Vector3<f64>| if exchanged { Vector3::new(at.y, at.x, at.z) } else { at };
        let mut points = points.clone();
        points.iter_mut().for_each(|p| p.xyz = place(p.xyz));
        let rough = |p: &Photograph| {
            let pose = Pose { centre: place(p.pose.centre) + Vector3::new(0.0, 0.0, up_m), ..p.pose };
            Some(RoughPose { pose, sigma_m: Vector3::repeat(2.0), sigma_rad: f64::INFINITY })
        };
        let rough = model.photographs.iter().map(rough).collect();
        let start = shaken(&mut Draw::new(86), &model);
        let options = AdjustOptions { rough, interior: Vec::new(), sigma_image_px: 0.3, ..AdjustOptions::default() };
        let found = adjust(&start, &points, &options);
        let notes = found.map_or_else(|refused| vec![refused.to_string()], |found| found.notes);
        notes.into_iter().find(|note| note.contains("where the GCPs put the cameras"))
    };
    assert_eq!(told(true, 0.0), None);
    let datum = told(false, 45.0).expect("45 m");
    assert!(datum.contains("another datum"), "{datum}");
    let other = told(false, 300.0).expect("300 m");
    assert!(other.contains("more than datums differ by"), "{other}");
}
